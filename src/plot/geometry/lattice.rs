//! The conformal lattice on a road with obstacles, and the swept footprint of the cheapest path.

use super::{LEGEND, band, dot, framed, label, legend_row, sheet, stroke};
use crate::collision::{Allowance, Blocker, CollisionSettings, CollisionWorld, Margins, SafetyMargins, Sweep};
use crate::geometry::spiral::{CubicSpiral, PathPoint, connect};
use crate::geometry::{Point, Pose, wrap_angle};
use crate::lattice::{EdgeStore, Lattice, LatticeContext, LatticePath, Root, Settings};
use crate::map::Scenario;
use crate::plot::axes::Area;
use crate::plot::outline::{Bounds, obstacle_outlines};
use crate::plot::scene::{View, road, scale_bar};
use crate::plot::svg::{Element, Svg};
use crate::plot::{MARGIN, Mark, style};
use crate::reference::{ReferenceLine, ReferenceSettings};
use crate::route::{RouteOutcome, RouteSettings, plan};
use crate::vehicle::Vehicle;

/// Station of the reference line at which the lattice starts, and its horizon, m.
const START: f64 = 33.0;
const HORIZON: f64 = 75.0;
/// Speed at the start, m/s: it determines the length of the edges.
const SPEED: f64 = 8.0;
/// Clearance at the upper end of the colour scale, m.
const AMPLE_CLEARANCE: f64 = 2.0;

/// The contents of both pictures.
pub(super) struct LatticeScene<'a> {
    scenario: &'a Scenario,
    vehicle: &'a Vehicle,
    world: CollisionWorld,
    reference: ReferenceLine,
    lattice: Lattice,
}

/// A lattice edge.
struct Edge {
    points: Vec<Point>,
    /// Clearance to static obstacles and to the road boundary, m.
    clearance: f64,
    blocked: bool,
}

/// The default margins.
fn margins() -> SafetyMargins {
    CollisionSettings::default().margins()
}

impl<'a> LatticeScene<'a> {
    /// `None` if the scenario's first planning problem has no reference line.
    pub(super) fn new(scenario: &'a Scenario, vehicle: &'a Vehicle) -> Option<Self> {
        let problem = scenario.problems.first()?;
        let look = RouteSettings::default();
        let RouteOutcome::Found(route) = plan(&scenario.network, &problem.initial.centre, &problem.goals, &look) else {
            return None;
        };
        let lane = route.lanes.first()?;
        let settings = ReferenceSettings::default();
        let reference = ReferenceLine::new(&scenario.network, &lane.lanelets, vehicle.width, &settings).ok()?;
        let world = {
            let (network, grid) = (&scenario.network, scenario.occupancy.as_ref());
            let settings = CollisionSettings::default();
            CollisionWorld::new(network, grid, &scenario.obstacles, vehicle, &settings, 0.0).ok()?
        };
        let lattice = Lattice::new(Settings::default()).ok()?;
        Some(Self { scenario, vehicle, world, reference, lattice })
    }

    fn context(&self) -> LatticeContext<'_> {
        LatticeContext {
            reference: &self.reference,
            world: &self.world,
            margins: margins(),
            max_curvature: self.vehicle.max_curvature(),
            full_speed_curvature: self.vehicle.comfort.lateral_acceleration / (SPEED * SPEED),
            half_width: 0.5 * self.vehicle.width,
            target: None,
        }
    }

    /// The cheapest path of the lattice.
    fn chosen(&self) -> Option<LatticePath> {
        let start = self.reference.offset_pose(START, 0.0)?;
        let allowance = Allowance::NONE;
        let root = Root { pose: start.pose, curvature: start.curvature, kept: vec![], start: start.pose, allowance };
        let mut store = EdgeStore::default();
        self.lattice.search(&self.context(), &root, SPEED, HORIZON, &mut store).paths.into_iter().next()
    }

    /// The nodes of each layer of the path, beginning with its start.
    fn layers(&self, chain: &LatticePath) -> Vec<Vec<PathPoint>> {
        let ends = chain.path.pieces().map(|(_, start, _)| start.position);
        let last = chain.path.at(chain.path.length()).pose.position;
        let stations = ends.chain([last]).map(|p| self.reference.project(p).s);
        #[allow(clippy::cast_possible_truncation)] // a dozen
        let settings = self.lattice.settings();
        let widest = (settings.offset_limit / settings.offset_spacing) as i32;
        let layer = |(i, s): (usize, f64)| {
            let offsets = if i == 0 { 0..=0 } else { -widest..=widest };
            offsets
                .filter_map(|l| self.reference.offset_pose(s, f64::from(l) * settings.offset_spacing))
                .filter(|node| i == 0 || self.is_on_road(&node.pose))
                .collect()
        };
        stations.enumerate().map(layer).collect()
    }

    fn is_on_road(&self, pose: &Pose) -> bool {
        const LENGTH: f64 = 0.05;
        let hit = self.world.probe(pose, &CubicSpiral::straight(LENGTH)).static_hit(&margins(), &Allowance::NONE);
        hit.is_none_or(|hit| hit.what != Blocker::RoadBoundary)
    }

    /// All edges between two layers.
    fn edges<'s>(&'s self, from: &'s [PathPoint], to: &'s [PathPoint]) -> impl Iterator<Item = Edge> + 's {
        from.iter().flat_map(move |a| to.iter().filter_map(move |b| self.edge(a, b)))
    }

    fn edge(&self, from: &PathPoint, to: &PathPoint) -> Option<Edge> {
        let end = Pose { position: from.pose.to_local(to.pose.position), yaw: wrap_angle(to.pose.yaw - from.pose.yaw) };
        if end.position.y.abs() > self.lattice.settings().max_slope * end.position.x {
            return None;
        }
        let spiral = connect(from.curvature, &end, to.curvature).ok()?;
        if spiral.max_abs_curvature() > self.vehicle.max_curvature() {
            return None;
        }
        let mut probe = self.world.probe(&from.pose, &spiral);
        let clearance = probe.clearance(AMPLE_CLEARANCE);
        Some(Edge {
            points: spiral.samples(&from.pose, 40).map(|(_, p)| p.pose.position).collect(),
            clearance: clearance.obstacle.min(clearance.road),
            blocked: probe.static_hit(&margins(), &Allowance::NONE).is_some(),
        })
    }

    fn obstacles(&self, svg: &mut Svg, view: &View) {
        let group = Element::new("g").with("id", "obstacles").with("fill", style::STATIC).with("stroke", style::INK);
        svg.group(&group, |svg| {
            for outline in self.scenario.obstacles.iter().flat_map(|o| obstacle_outlines(o, 0.0)) {
                svg.add(&view.polygon(&outline));
            }
        });
    }

    /// The lattice and the cheapest path.
    pub(super) fn lattice(&self) -> String {
        let about = "nodes at stations × offsets of the reference line; every edge is a cubic spiral whose swept footprint is \
                     checked; the cheapest path passes left, then right";
        let plane = band(0.0, 236.0);
        sheet("A conformal lattice on a slalom", about, plane.height + 2.0 * LEGEND, |svg, top| {
            let plane = Area { corner: (MARGIN, top), ..plane };
            let chain = self.chosen();
            let layers = chain.as_ref().map_or_else(Vec::new, |c| self.layers(c));
            let nodes: Vec<Point> = layers.iter().flatten().map(|n| n.pose.position).collect();
            let bounds = Bounds::around(&nodes).map(|b| b.expanded(2.6));
            let Some(bounds) = bounds else { return };
            let view = View::new(bounds, plane);
            framed(svg, "plane", &view, style::GROUND, |svg| {
                road(svg, &view, &self.scenario.network);
                let edges: Vec<Edge> = layers.windows(2).flat_map(|w| self.edges(&w[0], &w[1])).collect();
                edges_of(svg, &view, &edges);
                self.obstacles(svg, &view);
                for node in &nodes {
                    dot(svg, view.page(node), 1.6, style::PAPER, style::FAINT_INK);
                }
                if let Some(chain) = &chain {
                    let points: Vec<Point> = chain.path.sampled(0.25).iter().map(|(_, p)| p.pose.position).collect();
                    svg.add(&stroke(view.line(&points), style::PAPER, 5.0));
                    svg.add(&stroke(view.line(&points), style::DRIVEN, 3.0).with("id", "chosen"));
                }
                scale_bar(svg, &view);
            });
            let line = |colour, dash, width, text: &str| (Mark::Line(colour, dash, width), text.to_owned());
            let first = [
                line(style::DRIVEN, "", 3.0, "cheapest path"),
                line(style::ALARM, "2 3", 1.0, "blocked edge: collides or leaves the road, margins included"),
                (Mark::Box(style::STATIC, "1"), "parked car".into()),
            ];
            legend_row(svg, (MARGIN, top + plane.height), &first);
            let second = [
                line(style::VIRIDIS_LOW, "", 1.6, "free edge, small clearance"),
                line(style::VIRIDIS_HIGH, "", 1.6, "free edge, clearance of 2 m or more"),
            ];
            legend_row(svg, (MARGIN, top + plane.height + LEGEND - 4.0), &second);
        })
    }

    /// The swept footprint beside the first obstacle.
    pub(super) fn sweep(&self) -> String {
        let about = "cells of half a metre, each the hull of the vehicle's rectangle at its two ends, inflated by ε: they contain \
                     the vehicle at every pose between the samples";
        let plane = band(0.0, 520.0);
        sheet("A swept footprint", about, plane.height + LEGEND, |svg, top| {
            let plane = Area { corner: (MARGIN, top), ..plane };
            let obstacle = self.scenario.obstacles.first().map(|o| obstacle_outlines(o, 0.0).concat());
            let Some(beside) = obstacle.as_ref().and_then(Bounds::around) else { return };
            let Some(chain) = self.chosen() else { return };
            let middle = beside.centre();
            let half = 0.5 * nalgebra::Vector2::new(19.0, 8.2);
            let at = Point::new(middle.x - 1.0, middle.y + 1.6);
            let view = View::new(Bounds { min: at - half, max: at + half }, plane);
            framed(svg, "plane", &view, style::GROUND, |svg| {
                road(svg, &view, &self.scenario.network);
                self.obstacles(svg, &view);
                self.swept(svg, &view, &chain);
                self.one_cell(svg, &view, &chain, middle);
                scale_bar(svg, &view);
            });
            self.close_up(svg, &view, &chain);
            let entries = [
                (Mark::Box(style::PLAN, "0.45"), "swept footprint, all cells".into()),
                (Mark::Line(style::VULNERABLE, "", 1.8), "one cell, its two end poses dashed".into()),
                (Mark::Box(style::REFERENCE, "0.3"), "margin to obstacles, 0.2 m".into()),
                (Mark::Line(style::INK, "", 1.4), "exact: the corners, every 5 cm".into()),
                (Mark::Line(style::DRIVEN, "", 1.8), "rear axle".into()),
                (Mark::Box(style::STATIC, "1"), "parked car".into()),
            ];
            legend_row(svg, (MARGIN, top + plane.height), &entries);
        })
    }

    /// Cells, margins and densely sampled corners. Each of the first two has its opacity as a group: overlaps do not
    /// add up.
    fn swept(&self, svg: &mut Svg, view: &View, chain: &LatticePath) {
        let margins = margins().static_obstacles;
        let flat = |colour, opacity| Element::new("g").with("fill", colour).with("opacity", opacity);
        each_cell(svg, view, chain, &margins, &flat(style::REFERENCE, "0.3"));
        each_cell(svg, view, chain, &Margins::NONE, &flat(style::PLAN, "0.75"));
        for trace in self.corner_traces(chain) {
            svg.add(&stroke(view.line(&trace), style::INK, 1.2));
        }
        let points: Vec<Point> = chain.path.sampled(0.25).iter().map(|(_, p)| p.pose.position).collect();
        svg.add(&stroke(view.line(&points), style::DRIVEN, 1.8));
    }

    /// The cell beside `place` and the rectangles of which it is the hull.
    fn one_cell(&self, svg: &mut Svg, view: &View, chain: &LatticePath, place: Point) {
        let mut before = 0.0;
        let mut cells: Vec<(Vec<Point>, [f64; 2])> = Vec::new();
        for sweep in &chain.sweeps {
            let ends = sweep.stations().windows(2).map(|w| [before + w[0], before + w[1]]);
            cells.extend((0..sweep.cells()).map(|cell| sweep.footprint(cell, &Margins::NONE)).zip(ends));
            before += sweep.length();
        }
        let distance = |(outline, _): &(Vec<Point>, [f64; 2])| {
            Bounds::around(outline).map_or(f64::INFINITY, |b| (b.centre() - place).norm())
        };
        let Some((outline, ends)) = cells.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))) else { return };
        for station in ends {
            let pose = chain.path.at(*station).pose;
            let rectangle = view.polygon(&self.corners().map(|corner| pose.to_world(corner))).with("fill", "none");
            svg.add(&stroke(rectangle, style::VULNERABLE, 0.9).with("stroke-dasharray", "4 3"));
        }
        svg.add(&stroke(view.polygon(outline).with("fill", "none"), style::VULNERABLE, 1.8).with("id", "one-cell"));
    }

    /// Corners of the vehicle in the rear-axle frame, counter-clockwise from rear right.
    fn corners(&self) -> [Point; 4] {
        let front = self.vehicle.front_overhang_from_rear_axle();
        let (rear, side) = (front - self.vehicle.length, 0.5 * self.vehicle.width);
        [(rear, -side), (front, -side), (front, side), (rear, side)].map(|(x, y)| Point::new(x, y))
    }

    /// Densely sampled traces of the vehicle's four corners.
    fn corner_traces(&self, chain: &LatticePath) -> [Vec<Point>; 4] {
        const SPACING: f64 = 0.05;
        let poses = chain.path.sampled(SPACING);
        self.corners().map(|corner| poses.iter().map(|(_, p)| p.pose.to_world(corner)).collect())
    }

    /// An enlarged view of the corner that swings out in the tightest visible curve: there the exact trace is closest
    /// to the edge of the swept footprint.
    fn close_up(&self, svg: &mut Svg, view: &View, chain: &LatticePath) {
        const ZOOM: f64 = 32.0;
        let poses = chain.path.sampled(0.05);
        let visible = poses.iter().map(|(_, p)| p).filter(|p| view.bounds.expanded(-1.5).shows([&p.pose.position]));
        let sharpest = visible.max_by(|a, b| a.curvature.abs().total_cmp(&b.curvature.abs()));
        let Some(sharpest) = sharpest else { return };
        let [_, front_right, front_left, _] = self.corners();
        let outer = if sharpest.curvature > 0.0 { front_right } else { front_left };
        let place = sharpest.pose.to_world(outer);
        let (width, height) = (330.0, 190.0);
        // beside the scale bar
        let bottom = view.area.corner.1 + view.area.height - 14.0;
        let area = Area { corner: (view.area.corner.0 + 130.0, bottom - height), width, height };
        let half = nalgebra::Vector2::new(width, height) / (2.0 * ZOOM * view.scale);
        let window = Bounds { min: place - half, max: place + half };
        let zoomed = View::new(window, area);
        let frame = |corner: (f64, f64), w: f64, h: f64| {
            Element::rect(corner, w, h).with("fill", "none").with("stroke", style::INK).num("stroke-width", 1.2)
        };
        let (x, y) = view.page(&Point::new(window.min.x, window.max.y));
        let (w, h) = (width / ZOOM, height / ZOOM);
        let (left, top) = area.corner;
        for (from, to) in [((x, y + h), (left, top)), ((x + w, y + h), (left + width, top))] {
            svg.add(&Element::line(from, to).with("stroke", style::FAINT_INK).num("stroke-width", 0.7));
        }
        framed(svg, "close-up", &zoomed, style::ROAD, |svg| {
            self.swept(svg, &zoomed, chain);
            let bar = 0.01 * zoomed.scale;
            let (right, bottom) = (left + width - 14.0, bottom - 14.0);
            svg.add(
                &Element::line((right - bar, bottom), (right, bottom))
                    .with("stroke", style::INK)
                    .num("stroke-width", 1.6),
            );
            label(svg, (right - 0.5 * bar, bottom - 6.0), "middle", style::INK, "1 cm");
        });
        svg.add(&frame((x, y), w, h));
        svg.add(&frame(area.corner, width, height));
    }
}

/// Free edges by clearance, ascending, so that edges with more clearance are on top; blocked ones below all.
fn edges_of(svg: &mut Svg, view: &View, edges: &[Edge]) {
    let blocked = Element::new("g").with("id", "blocked-edges").with("stroke", style::ALARM).num("stroke-width", 0.5);
    svg.group(&blocked.with("stroke-dasharray", "2 3").with("stroke-opacity", "0.5"), |svg| {
        edges.iter().filter(|e| e.blocked).for_each(|e| svg.add(&view.line(&e.points)));
    });
    let mut free: Vec<&Edge> = edges.iter().filter(|e| !e.blocked).collect();
    free.sort_by(|a, b| a.clearance.total_cmp(&b.clearance));
    svg.group(&Element::new("g").with("id", "free-edges").num("stroke-width", 0.8), |svg| {
        for edge in free {
            let colour = style::hex(style::viridis(edge.clearance / AMPLE_CLEARANCE));
            svg.add(&view.line(&edge.points).with("stroke", &colour));
        }
    });
}

/// The footprint of each visible cell.
fn each_cell(svg: &mut Svg, view: &View, chain: &LatticePath, margins: &Margins, group: &Element) {
    svg.group(group, |svg| {
        let cells = |sweep: &Sweep| (0..sweep.cells()).map(|cell| sweep.footprint(cell, margins)).collect::<Vec<_>>();
        for outline in chain.sweeps.iter().flat_map(|s| cells(s)).filter(|o| view.bounds.shows(o)) {
            svg.add(&view.polygon(&outline));
        }
    });
}
