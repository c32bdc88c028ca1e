//! The drivable area: the union of the lanelets that cars may use, with its boundary as segments.
//!
//! # Technique
//! Each lanelet is a strip of triangles between its two bounds and not one polygon. So bounds that cross, fold over
//! themselves in a sharp curve, touch, or are exchanged still cover the area between them. The union of the triangles
//! (i_overlay through `geo`, on an integer grid of about the size of the area / 2³⁰, hence relative to a local origin) is
//! inflated by [`INFLATION`], which closes hairline gaps between neighbouring lanelets. The result has outer rings and holes
//! (traffic islands).
//!
//! Sidewalks, bicycle lanes, borders and the like are not part of the area ([`Lanelet::is_drivable`]). A crosswalk or a
//! bicycle lane that crosses the road lies on lanelets of the road, which cover it.
//!
//! # Weakness
//! Gaps wider than 2 · [`INFLATION`] between lanelets that should touch are boundary. For bounds with different numbers of
//! points the strip pairs points by their fraction of the length and may cut a corner at the inner bound.

use geo::{BooleanOps, Coord, LineString, MultiPolygon, Polygon, unary_union};
use parry2d::bounding_volume::Aabb;
use parry2d::partitioning::{Bvh, BvhBuildStrategy, BvhNode};

use super::ROUNDING;
use super::convert::{Local, Origin};
use super::convex::{Convex, box_distance, depth_of};
use crate::geometry::Point;
use crate::map::{Lanelet, RoadNetwork};

/// Inflation of the union of the lanelets, m: it closes gaps up to twice this (1.2 cm). Published maps have gaps of
/// millimetres from rounded coordinates, which must not stop a vehicle. Gaps of centimetres are off the road for the
/// checkers of the CommonRoad project, so they are here.
pub const INFLATION: f64 = 0.006;

/// Largest distance of the inflated boundary from the lanelets, m: √2 · inflation at corners, which are inflated by a square.
/// Checks of footprints add it to their margin, so that inflation closes gaps without widening the road.
pub(super) const OUTSIDE: f64 = INFLATION * std::f64::consts::SQRT_2;

/// The surface covered by the lanelets that cars may use.
#[derive(Debug, Clone)]
pub struct DrivableArea {
    origin: Origin,
    /// Boundary rings, not closed; the area is to their left.
    rings: Vec<Vec<Local>>,
    segments: Vec<Convex>,
    tree: Bvh,
}

impl DrivableArea {
    /// The union of the drivable lanelets of a network.
    #[must_use]
    pub fn new(network: &RoadNetwork) -> Self {
        let bounds = network.lanelets.values().flat_map(|l| l.left.points().iter().chain(l.right.points()));
        Self::with_origin(network, Origin::amid(bounds))
    }

    pub(super) fn with_origin(network: &RoadNetwork, origin: Origin) -> Self {
        let triangles: Vec<Polygon> =
            network.lanelets.values().filter(|l| l.is_drivable()).flat_map(|l| triangle_strip(l, &origin)).collect();
        let rings = rings_of(&inflate(&unary_union(&triangles)));
        let segments: Vec<Convex> =
            rings.iter().flat_map(|ring| edges(ring)).map(|(a, b)| Convex::segment(a, b)).collect();
        let boxes: Vec<Aabb> = segments.iter().map(|s| *s.aabb()).collect();
        let tree = Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes);
        Self { origin, rings, segments, tree }
    }

    /// Whether the area is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }

    /// The boundary rings in world coordinates, not closed: outer ones counter-clockwise, holes clockwise.
    pub fn rings(&self) -> impl Iterator<Item = Vec<Point>> + '_ {
        self.rings.iter().map(|ring| ring.iter().map(|p| self.origin.world(*p)).collect())
    }

    /// Whether the point is in the area, [`INFLATION`] included.
    #[must_use]
    pub fn contains(&self, p: Point) -> bool {
        self.contains_local(self.origin.local(p))
    }

    /// Whether a convex polygon is entirely in the area.
    #[must_use]
    pub fn contains_region(&self, region: &[Point]) -> bool {
        let Some(hull) = Convex::hull_of(region.iter().map(|p| self.origin.local(*p)).collect(), 0.0) else {
            return false;
        };
        self.contains_local(hull.points()[0])
            && self.near(hull.aabb()).all(|segment| segment.distance_to(hull.points()) > 0.0)
    }

    /// Crossing number of the ray from `p` towards +x: odd inside.
    pub(super) fn contains_local(&self, p: Local) -> bool {
        let on_ray = |node: &BvhNode| node.mins().y <= p.y && p.y <= node.maxs().y && p.x <= node.maxs().x;
        let crossed = self.tree.leaves(on_ray).filter(|&leaf| {
            let points = self.segments[leaf as usize].points();
            let (a, b) = (points[0], points[1]);
            (a.y > p.y) != (b.y > p.y) && p.x - a.x < (b.x - a.x) * (p.y - a.y) / (b.y - a.y)
        });
        crossed.count() % 2 == 1
    }

    /// Boundary segments whose boxes meet `aabb`, in an order that depends only on the map.
    pub(super) fn near<'a>(&'a self, aabb: &'a Aabb) -> impl Iterator<Item = &'a Convex> {
        self.tree.intersect_aabb(aabb).map(|leaf| &self.segments[leaf as usize])
    }

    /// The boundary segments.
    pub(super) fn boundary(&self) -> &[Convex] {
        &self.segments
    }

    /// Distance from a convex polygon with the given box to the boundary, at most `cap`, m.
    pub(super) fn boundary_distance(&self, hull: &[Local], aabb: &Aabb, cap: f64) -> f64 {
        let to_box = |node: &BvhNode, _| box_distance(&node.aabb(), aabb) - ROUNDING;
        let to_segment = |leaf: u32, _| Some(self.segments[leaf as usize].distance_to(hull));
        self.tree.find_best(cap, to_box, to_segment).map_or(cap, |(_, distance)| distance)
    }

    /// Depth by which a convex polygon (counter-clockwise) leaves the area, m; `None` if it does not. With corners outside:
    /// their largest distance to the area. With all corners inside: the depth of the boundary in the polygon.
    pub(super) fn depth_outside(&self, corners: &[Local]) -> Option<f64> {
        /// Largest reported depth, m.
        const FAR: f64 = 100.0;
        let aabb = Aabb::from_points_ref(corners);
        let cut = self.near(&aabb).any(|segment| segment.overlaps_polygon(corners));
        let outside = |corner: &Local| {
            let here = Aabb::from_points_ref(&[*corner]);
            (!self.contains_local(*corner)).then(|| self.boundary_distance(&[*corner], &here, FAR))
        };
        let corner_depth = corners.iter().filter_map(outside).reduce(f64::max);
        if !cut {
            return corner_depth;
        }
        let boundary_depth =
            self.near(&aabb).flat_map(|s| s.points()).map(|p| depth_of(corners, *p)).fold(0.0, f64::max);
        Some(corner_depth.unwrap_or(boundary_depth))
    }
}

/// The triangle strip between the bounds of a lanelet, counter-clockwise, without degenerate triangles.
fn triangle_strip(lanelet: &Lanelet, origin: &Origin) -> Vec<Polygon> {
    let points = |bound: &[Point]| bound.iter().map(|p| origin.local(*p)).collect::<Vec<_>>();
    let (left, right) = (points(lanelet.left.points()), points(lanelet.right.points()));
    let share = |i: usize, stations: &[f64]| stations[i] / stations[stations.len() - 1];
    let (mut i, mut j) = (0, 0);
    let mut triangles = Vec::with_capacity(left.len() + right.len());
    while i + 1 < left.len() || j + 1 < right.len() {
        // files pair the points of bounds with equal counts; else advance the side that is behind
        let left_next = if left.len() == right.len() {
            i <= j
        } else if i + 1 == left.len() {
            false
        } else if j + 1 == right.len() {
            true
        } else {
            share(i + 1, lanelet.left.stations()) <= share(j + 1, lanelet.right.stations())
        };
        let (a, b) = (left[i], right[j]);
        if left_next {
            i += 1;
        } else {
            j += 1;
        }
        triangles.extend(triangle(a, b, if left_next { left[i] } else { right[j] }));
    }
    triangles
}

/// A counter-clockwise triangle; `None` if it is degenerate.
fn triangle(a: Local, b: Local, c: Local) -> Option<Polygon> {
    /// Triangles with a smaller doubled area are degenerate, m².
    const NEGLIGIBLE: f64 = 1e-9;
    let doubled = (b - a).perp_dot(c - a);
    if doubled.abs() < NEGLIGIBLE {
        return None;
    }
    let points = if doubled > 0.0 { [a, b, c] } else { [a, c, b] };
    Some(polygon(&points))
}

fn polygon(points: &[Local]) -> Polygon {
    Polygon::new(points.iter().map(|p| Coord { x: p.x, y: p.y }).collect(), Vec::new())
}

/// The area inflated by [`INFLATION`]: each boundary edge adds a rectangle that extends beyond it by this on all sides, up to
/// √2 times as far at corners.
fn inflate(area: &MultiPolygon) -> MultiPolygon {
    let around = rings_of(area);
    let around = around.iter().flat_map(|ring| edges(ring)).map(|(a, b)| {
        let tangent = (b - a).normalize_or_zero() * INFLATION;
        let side = tangent.perp();
        polygon(&[a - tangent - side, b + tangent - side, b + tangent + side, a - tangent + side])
    });
    let around: Vec<Polygon> = around.collect();
    area.union_with_fill_rule(&unary_union(&around), geo::algorithm::bool_ops::FillRule::NonZero)
}

/// All rings, without the closing point.
fn rings_of(area: &MultiPolygon) -> Vec<Vec<Local>> {
    let ring = |line: &LineString| {
        let mut points: Vec<Local> = line.coords().map(|c| Local::new(c.x, c.y)).collect();
        points.dedup();
        if points.len() > 1 && points[0] == points[points.len() - 1] {
            points.pop();
        }
        points
    };
    area.iter()
        .flat_map(|p| std::iter::once(p.exterior()).chain(p.interiors()))
        .map(ring)
        .filter(|r| r.len() > 2)
        .collect()
}

/// The edges of the closed ring.
fn edges(ring: &[Local]) -> impl Iterator<Item = (Local, Local)> + '_ {
    ring.iter().zip(ring.iter().cycle().skip(1)).map(|(a, b)| (*a, *b))
}
