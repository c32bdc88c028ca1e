//! The top view: map, obstacles over time, goal, plans and the driven footprints.

use super::axes::{Area, nice_step};
use super::motion::{Motion, MotionSample};
use super::outline::{Bounds, footprint, goal_outlines, obstacle_outlines};
use super::refusal;
use super::style;
use super::svg::{Element, Page, Svg, number};
use crate::drive::Run;
use crate::geometry::Point;
use crate::map::{Cell, Lanelet, Motion as ObstacleMotion, Obstacle, ObstacleKind, RoadNetwork};
use crate::planner::{Cycle, Rejection};

/// Time between drawn outlines of an obstacle, s.
const OBSTACLE_SPACING: f64 = 1.0;
/// Maximum number of footprints per run; their spacing follows.
const FOOTPRINTS: f64 = 48.0;
/// Maximum number of committed plans drawn.
const PLANS: usize = 24;
/// Spacing of points of drawn paths, m: smooth at any curvature that a car can drive.
const PATH_SPACING: f64 = 0.5;
/// Smallest distance between time labels of one object, px.
const LABEL_SPACING: f64 = 44.0;

/// The mapping from the world (metres, y up) to an area of the page (pixels, y down). One scale for both axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    /// Visible region of the world, m.
    pub(super) bounds: Bounds,
    /// Area on the page, px.
    pub(super) area: Area,
    /// Pixels per metre.
    pub(super) scale: f64,
}

impl View {
    /// A view that shows all of `bounds` in the middle of `area`.
    pub(super) fn new(bounds: Bounds, area: Area) -> Self {
        let scale = (area.width / bounds.width()).min(area.height / bounds.height());
        Self { bounds: bounds.at_least(area.width / scale, area.height / scale), area, scale }
    }

    /// Position of a world point on the page.
    pub(super) fn page(&self, p: &Point) -> Page {
        let from_top_left = (p.x - self.bounds.min.x, self.bounds.max.y - p.y);
        (self.area.corner.0 + self.scale * from_top_left.0, self.area.corner.1 + self.scale * from_top_left.1)
    }

    /// An open line through points of the world.
    pub(super) fn line(&self, points: &[Point]) -> Element {
        Element::polyline(points.iter().map(|p| self.page(p))).with("fill", "none")
    }

    /// A closed polygon through points of the world.
    pub(super) fn polygon(&self, points: &[Point]) -> Element {
        Element::polygon(points.iter().map(|p| self.page(p)))
    }
}

/// Contents of the top view.
pub(super) struct Scene<'a> {
    /// The run.
    pub(super) run: &'a Run<'a>,
    /// Its motion.
    pub(super) motion: &'a Motion,
    /// Speed at the upper end of the colour scale, m/s.
    pub(super) top_speed: f64,
}

impl Scene<'_> {
    /// Draws the whole top view.
    pub(super) fn draw(&self, svg: &mut Svg, view: &View) {
        let area = view.area;
        svg.group(&Element::new("clipPath").with("id", "clip-scene"), |svg| {
            svg.add(&Element::rect(area.corner, area.width, area.height).num("rx", 4.0));
        });
        svg.group(&Element::new("g").with("id", "scene").with("clip-path", "url(#clip-scene)"), |svg| {
            svg.add(&Element::rect(area.corner, area.width, area.height).with("fill", style::GROUND));
            road(svg, view, &self.run.scenario.network);
            self.occupied_cells(svg, view);
            self.goal(svg, view);
            self.candidates(svg, view);
            self.obstacles(svg, view);
            self.footprints(svg, view);
            self.driven_path(svg, view);
            self.plans(svg, view);
            self.contact(svg, view);
            self.times(svg, view);
            scale_bar(svg, view);
        });
    }

    fn occupied_cells(&self, svg: &mut Svg, view: &View) {
        let Some(grid) = &self.run.scenario.occupancy else { return };
        svg.group(&Element::new("g").with("id", "occupancy").with("fill", style::STATIC), |svg| {
            let blocks = grid.blocks(|cell| cell == Cell::Occupied);
            for corners in blocks.iter().map(|b| grid.corners(b)).filter(|c| view.bounds.shows(c)) {
                svg.add(&view.polygon(&corners));
            }
        });
    }

    fn goal(&self, svg: &mut Svg, view: &View) {
        let style = Element::new("g").with("id", "goal").with("fill", style::GOAL).with("fill-opacity", "0.16");
        svg.group(&style.with("stroke", style::GOAL).with("stroke-dasharray", "5 3"), |svg| {
            for outline in goal_outlines(self.run).iter().filter(|o| view.bounds.shows(*o)) {
                svg.add(&view.polygon(outline).num("stroke-width", 1.2));
            }
        });
    }

    /// The candidates of the cycle with the most infeasible ones.
    fn candidates(&self, svg: &mut Svg, view: &View) {
        let Some(cycle) = interesting_cycle(&self.run.cycles) else { return };
        let style = Element::new("g").with("id", "candidates").with("stroke", style::CANDIDATE).with("fill", "none");
        svg.group(&style.num("stroke-width", 0.8), |svg| {
            for candidate in &cycle.trace.candidates {
                let points: Vec<Point> =
                    candidate.path.sampled(PATH_SPACING).iter().map(|(_, p)| p.pose.position).collect();
                let line = view.line(&points).with("class", candidate.rejected.map_or("accepted", Rejection::code));
                svg.add(&if refusal(candidate).is_some() { line.with("stroke-dasharray", "3 3") } else { line });
            }
        });
    }

    fn obstacles(&self, svg: &mut Svg, view: &View) {
        let ticks = self.motion.ticks(OBSTACLE_SPACING);
        svg.group(&Element::new("g").with("id", "obstacles"), |svg| {
            for obstacle in &self.run.scenario.obstacles {
                let group = Element::new("g").with("id", &format!("obstacle-{}", obstacle.id));
                if obstacle.is_static() {
                    let outlines = obstacle_outlines(obstacle, 0.0);
                    if outlines.iter().any(|o| view.bounds.shows(o)) {
                        let group = group.with("fill", style::STATIC).with("stroke", style::INK);
                        svg.group(&group, |svg| outlines.iter().for_each(|o| svg.add(&view.polygon(o))));
                    }
                } else {
                    svg.group(&group.with("stroke", moving_colour(obstacle)), |svg| {
                        moving_outlines(svg, view, obstacle, &ticks);
                    });
                }
            }
        });
    }

    fn footprints(&self, svg: &mut Svg, view: &View) {
        let group = Element::new("g").with("id", "driven-footprints").with("stroke", style::INK);
        svg.group(&group.num("stroke-width", 0.7).with("fill-opacity", "0.55"), |svg| {
            for sample in self.prints() {
                let colour = style::hex(style::viridis(sample.speed / self.top_speed));
                for part in footprint(self.run.vehicle, &sample.pose) {
                    svg.add(&view.polygon(&part).with("fill", &colour));
                }
            }
        });
    }

    fn prints(&self) -> Vec<MotionSample> {
        let (from, to) = self.motion.time_range();
        self.motion.thinned(((to - from) / FOOTPRINTS).max(if to - from > 14.0 { 1.0 } else { 0.5 }))
    }

    /// Committed plans from the vehicle to the fallback stop.
    fn plans(&self, svg: &mut Svg, view: &View) {
        let cycles = &self.run.cycles;
        let every = cycles.len().div_ceil(PLANS).max(1);
        let style = Element::new("g").with("id", "committed-plans").with("stroke", style::PLAN);
        svg.group(&style.num("stroke-width", 1.0).with("stroke-opacity", "0.7").with("fill", style::PLAN), |svg| {
            for cycle in cycles.iter().step_by(every) {
                let points = planned_points(cycle);
                svg.add(&view.line(&points));
                if let Some(end) = points.last() {
                    let (x, y) = view.page(end);
                    let dot =
                        Element::new("circle").num("cx", x).num("cy", y).num("r", 2.2).with("class", "proven-stop");
                    svg.add(&dot.with("fill", style::PAPER));
                }
            }
        });
    }

    fn driven_path(&self, svg: &mut Svg, view: &View) {
        let points: Vec<Point> = self.motion.thinned(0.05).iter().map(|s| s.pose.position).collect();
        let line = view.line(&points).with("id", "driven-path").with("stroke", style::DRIVEN);
        svg.add(&line.num("stroke-width", 1.8).with("stroke-linejoin", "round"));
    }

    fn contact(&self, svg: &mut Svg, view: &View) {
        let Some(contact) = self.run.log.contact else { return };
        let Some(sample) = self.motion.at(contact.time) else { return };
        let (x, y) = view.page(&sample.pose.to_world(contact.at_rear_axle_frame));
        let mark = Element::new("circle").with("id", "contact").num("cx", x).num("cy", y).num("r", 7.0);
        svg.add(&mark.with("fill", "none").with("stroke", style::ALARM).num("stroke-width", 2.5));
    }

    /// Time labels below the driven path: at rounded times, with space in between.
    fn times(&self, svg: &mut Svg, view: &View) {
        let (from, to) = self.motion.time_range();
        let step = nice_step((to - from) / 7.0).max(1.0);
        let mut last: Option<Page> = None;
        svg.group(&Element::new("g").with("id", "driven-times"), |svg| {
            for time in self.motion.ticks(step) {
                let Some(sample) = self.motion.at(time) else { continue };
                let below = -0.5 * self.run.vehicle.width;
                let side = view.page(&sample.pose.to_world(Point::new(0.0, below)));
                let place = view.page(&sample.pose.to_world(Point::new(0.0, below - 12.0 / view.scale)));
                if last.is_some_and(|l| (l.0 - place.0).hypot(l.1 - place.1) < LABEL_SPACING) {
                    continue;
                }
                last = Some(place);
                svg.add(&Element::line(side, place).with("stroke", style::DRIVEN).num("stroke-width", 0.8));
                time_label(svg, (place.0, place.1 + 9.0), time, style::DRIVEN);
            }
        });
    }
}

/// Surfaces, bounds, marks and stop lines of the road.
pub(super) fn road(svg: &mut Svg, view: &View, network: &RoadNetwork) {
    let lanelets: Vec<&Lanelet> = network.lanelets.values().filter(|l| view.bounds.shows(&l.outline())).collect();
    svg.group(&Element::new("g").with("id", "road"), |svg| {
        // bounds are below the surfaces: only the outer edge of the road stays visible, not every lane of a junction
        svg.group(&Element::new("g").with("stroke", style::BOUND).num("stroke-width", 2.4), |svg| {
            for line in lanelets.iter().flat_map(|l| [&l.left, &l.right]) {
                svg.add(&view.line(line.points()).with("class", "bound"));
            }
        });
        for drivable in [false, true] {
            for l in lanelets.iter().filter(|l| l.is_drivable() == drivable) {
                let fill = if drivable { style::ROAD } else { style::NON_DRIVABLE };
                let surface = view.polygon(&l.outline()).with("id", &format!("lanelet-{}", l.id));
                // stroked in the same colour: no hairlines between neighbours
                svg.add(&surface.with("fill", fill).with("stroke", fill).num("stroke-width", 0.6));
            }
        }
        for l in lanelets.iter().filter(|l| l.is_drivable()) {
            let centre = view.line(l.centre.points()).with("class", "centre-line").with("stroke", style::CENTRE);
            svg.add(&centre.num("stroke-width", 0.8).with("stroke-dasharray", "2 5"));
        }
        lanelets.iter().for_each(|l| lane_marks(svg, view, l));
    });
    svg.group(&Element::new("g").with("id", "stop-lines").with("stroke", style::STOP_LINE), |svg| {
        let lines = lanelets.iter().filter_map(|l| l.stop_line.map(|line| (l.id, line)));
        for (id, line) in lines {
            let element = Element::line(view.page(&line.start), view.page(&line.end)).num("stroke-width", 2.5);
            svg.add(&element.with("id", &format!("stop-line-{id}")));
        }
    });
}

/// The bounds that a lanelet shares with a neighbour: dashed if both have the same direction, else solid.
fn lane_marks(svg: &mut Svg, view: &View, lanelet: &Lanelet) {
    let sides = [(&lanelet.left, lanelet.adjacent_left), (&lanelet.right, lanelet.adjacent_right)];
    for (line, neighbour) in sides {
        let Some(neighbour) = neighbour else { continue };
        let mark = view.line(line.points()).with("class", "lane-mark").with("stroke", style::LANE_MARK);
        let mark = mark.num("stroke-width", 1.4);
        svg.add(&if neighbour.same_direction { mark.with("stroke-dasharray", "9 7") } else { mark });
    }
}

/// Outlines of a moving obstacle at the times, more opaque with time; time labels at some of them.
fn moving_outlines(svg: &mut Svg, view: &View, obstacle: &Obstacle, ticks: &[f64]) {
    let colour = moving_colour(obstacle);
    let visible: Vec<(f64, Vec<Vec<Point>>)> = ticks
        .iter()
        .map(|t| (*t, obstacle_outlines(obstacle, *t)))
        .filter(|(_, outlines)| outlines.iter().any(|o| view.bounds.shows(o)))
        .collect();
    let middles: Vec<Point> =
        visible.iter().filter_map(|(_, o)| Bounds::around(o.iter().flatten())).map(|b| b.centre()).collect();
    svg.add(&view.line(&middles).num("stroke-width", 0.7).with("stroke-opacity", "0.5"));
    // sets overlap from one second to the next: their opacities add up
    let opacity = if matches!(obstacle.motion, ObstacleMotion::Occupancy(_)) { 0.06 } else { 0.2 };
    // a stopped obstacle, as in a queue, has no time labels
    let ends = middles.first().zip(middles.last()).map(|(a, b)| (view.page(a), view.page(b)));
    let moves = ends.is_some_and(|(a, b)| (a.0 - b.0).hypot(a.1 - b.1) > LABEL_SPACING);
    let mut last: Option<Page> = None;
    for (i, (time, outlines)) in visible.iter().enumerate() {
        let age = (i + 1) as f64 / visible.len() as f64;
        for outline in outlines {
            let shape = view.polygon(outline).with("fill", colour).num("fill-opacity", 0.03 + opacity * age);
            svg.add(&shape.num("stroke-opacity", 0.25 + 0.75 * age).num("stroke-width", 1.1));
        }
        let Some(bounds) = Bounds::around(outlines.iter().flatten()) else { continue };
        let (x, y) = view.page(&Point::new(bounds.centre().x, bounds.max.y));
        if moves && last.is_none_or(|l| (l.0 - x).hypot(l.1 - y) >= 2.0 * LABEL_SPACING) {
            last = Some((x, y));
            time_label(svg, (x, y - 4.0), *time, colour);
        }
    }
}

fn time_label(svg: &mut Svg, place: Page, time: f64, colour: &str) {
    let text = Element::new("text").num("x", place.0).num("y", place.1).num("font-size", 10.5);
    let text = text.with("text-anchor", "middle").with("fill", colour).with("stroke", style::GROUND);
    let halo = text.num("stroke-width", 2.5).with("paint-order", "stroke").with("stroke-linejoin", "round");
    svg.add_text(&halo, &format!("{} s", number((10.0 * time).round() / 10.0)));
}

pub(super) fn moving_colour(obstacle: &Obstacle) -> &'static str {
    match obstacle.kind {
        ObstacleKind::Pedestrian | ObstacleKind::Bicycle => style::VULNERABLE,
        _ => style::MOVING,
    }
}

/// The path of the committed plan from the vehicle to its end.
fn planned_points(cycle: &Cycle) -> Vec<Point> {
    let plan = &cycle.plan.trajectory;
    let (from, to) = (plan.at(cycle.plan.time).station, plan.profile.last().station);
    let steps = ((to - from) / PATH_SPACING).ceil().clamp(1.0, 10_000.0);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped above
    let points = (0..=steps as usize).map(|i| plan.path.at(from + (to - from) * i as f64 / steps).pose.position);
    points.collect()
}

/// The cycle with the most infeasible candidates, then with the most candidates, then the earliest.
fn interesting_cycle(cycles: &[Cycle]) -> Option<&Cycle> {
    let score =
        |c: &Cycle| (c.trace.candidates.iter().filter(|k| refusal(k).is_some()).count(), c.trace.candidates.len());
    cycles.iter().rev().max_by_key(|c| score(c)).filter(|c| !c.trace.candidates.is_empty())
}

/// A bar of a rounded length in the lower left corner.
pub(super) fn scale_bar(svg: &mut Svg, view: &View) {
    let length = nice_step(60.0 / view.scale);
    let (left, bottom) = (view.area.corner.0 + 14.0, view.area.corner.1 + view.area.height - 12.0);
    let right = left + length * view.scale;
    svg.group(&Element::new("g").with("id", "scale-bar").with("stroke", style::INK).num("stroke-width", 1.4), |svg| {
        let background = Element::rect((left - 8.0, bottom - 20.0), right - left + 16.0, 27.0).num("rx", 3.0);
        svg.add(&background.with("fill", style::PAPER).with("fill-opacity", "0.75").with("stroke", "none"));
        svg.add(
            &Element::polyline([(left, bottom - 4.0), (left, bottom), (right, bottom), (right, bottom - 4.0)])
                .with("fill", "none"),
        );
        let text = Element::new("text").num("x", 0.5 * (left + right)).num("y", bottom - 5.0).num("font-size", 10.5);
        let text = text.with("text-anchor", "middle").with("fill", style::INK).with("stroke", "none");
        svg.add_text(&text, &format!("{} m", number(length)));
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        let bounds = Bounds { min: Point::new(0.0, -10.0), max: Point::new(100.0, 10.0) };
        View::new(bounds, Area { corner: (20.0, 50.0), width: 1000.0, height: 300.0 })
    }

    #[test]
    fn y_is_up_on_the_page() {
        let (view, road) = (view(), Point::new(50.0, 0.0));
        assert!(view.page(&Point::new(50.0, 3.0)).1 < view.page(&road).1);
        assert!(view.page(&Point::new(53.0, 0.0)).0 > view.page(&road).0);
    }

    #[test]
    fn both_axes_share_one_scale_and_the_action_is_centred() {
        let view = view();
        let (a, b) = (view.page(&Point::new(0.0, 0.0)), view.page(&Point::new(10.0, 10.0)));
        assert!(((b.0 - a.0) + (b.1 - a.1)).abs() < 1e-9, "{a:?} {b:?}");
        assert_eq!(view.page(&Point::new(50.0, 0.0)), (520.0, 200.0));
    }
}
