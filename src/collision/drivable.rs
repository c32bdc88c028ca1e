//! The drivable area: the union of all lanelets, with its boundary as segments.
//!
//! # Technique
//! Each lanelet is cut into the triangles of the ladder between its two bounds, not taken as one outline: bounds that
//! cross, fold over themselves in a sharp bend, touch, or are exchanged then still cover what lies between them. The
//! triangles are united (i_overlay through `geo`, on an integer grid of about the area's size / 2³⁰, hence relative to
//! a local origin), and the union is grown by [`GROWTH`] so that hairline gaps between neighbouring lanelets close.
//! What remains are outer rings and holes (traffic islands).
//!
//! Every lanelet counts as surface, whoever may drive there: a car that crosses a crosswalk does not leave the road.
//!
//! # Weakness
//! Gaps wider than 2 · [`GROWTH`] between lanelets that are meant to touch are boundary. Between bounds with unequal
//! numbers of points the ladder pairs points by their share of the length, and may cut a corner of a bound's inner side.

use geo::{BooleanOps, Coord, LineString, MultiPolygon, Polygon, unary_union};
use parry2d::bounding_volume::Aabb;
use parry2d::partitioning::{Bvh, BvhBuildStrategy, BvhNode};

use super::convert::{Local, Origin};
use super::convex::{Convex, depth_of};
use crate::geometry::Point;
use crate::map::{Lanelet, RoadNetwork};

/// How far the union of the lanelets is grown, m: gaps up to twice this (1.2 cm) close. Real maps have gaps of
/// millimetres from rounded coordinates, which must not stop a car; gaps of centimetres count as off the road for the
/// checkers of the CommonRoad project, so they do here.
pub const GROWTH: f64 = 0.006;

/// By how much the grown boundary may lie outside the lanelets, m: at corners it is grown by a square, so √2 · growth.
/// Checks of footprints add this to their margin, so that the growth closes gaps and widens nothing.
pub(super) const OUTSIDE: f64 = GROWTH * std::f64::consts::SQRT_2;

/// The surface covered by lanelets.
#[derive(Debug, Clone)]
pub struct DrivableArea {
    origin: Origin,
    /// Boundary rings, not closed; the area lies to the left.
    rings: Vec<Vec<Local>>,
    segments: Vec<Convex>,
    tree: Bvh,
}

impl DrivableArea {
    /// The union of all lanelets of a network.
    #[must_use]
    pub fn new(network: &RoadNetwork) -> Self {
        let bounds = network.lanelets.values().flat_map(|l| l.left.points().iter().chain(l.right.points()));
        Self::with_origin(network, Origin::amid(bounds))
    }

    pub(super) fn with_origin(network: &RoadNetwork, origin: Origin) -> Self {
        let triangles: Vec<Polygon> = network.lanelets.values().flat_map(|l| ladder(l, &origin)).collect();
        let rings = rings_of(&grow(&unary_union(&triangles)));
        let segments: Vec<Convex> =
            rings.iter().flat_map(|ring| edges(ring)).map(|(a, b)| Convex::segment(a, b)).collect();
        let boxes: Vec<Aabb> = segments.iter().map(|s| *s.aabb()).collect();
        let tree = Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes);
        Self { origin, rings, segments, tree }
    }

    /// Whether there is no surface at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }

    /// The boundary rings in world coordinates, not closed: outer ones counter-clockwise, holes clockwise.
    pub fn rings(&self) -> impl Iterator<Item = Vec<Point>> + '_ {
        self.rings.iter().map(|ring| ring.iter().map(|p| self.origin.world(*p)).collect())
    }

    /// Whether the point lies on the surface ([`GROWTH`] included).
    #[must_use]
    pub fn contains(&self, p: Point) -> bool {
        self.contains_local(self.origin.local(p))
    }

    /// Whether a convex polygon lies on the surface as a whole: no boundary cuts it or lies within it, and it is inside.
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

    /// Boundary segments whose boxes meet `aabb`, in an order that depends on the map alone.
    pub(super) fn near<'a>(&'a self, aabb: &'a Aabb) -> impl Iterator<Item = &'a Convex> {
        self.tree.intersect_aabb(aabb).map(|leaf| &self.segments[leaf as usize])
    }

    /// The boundary segments.
    pub(super) fn boundary(&self) -> &[Convex] {
        &self.segments
    }

    /// Distance from a convex polygon with the given box to the boundary, `cap` at most, m.
    pub(super) fn boundary_distance(&self, hull: &[Local], aabb: &Aabb, cap: f64) -> f64 {
        super::nearest(&self.tree, &self.segments, hull, aabb, cap)
    }

    /// How far a convex polygon (counter-clockwise) leaves the surface, m; `None` if it does not. For corners outside:
    /// distance to the surface. For boundary that pokes in between corners outside none: its depth in the polygon.
    pub(super) fn depth_outside(&self, corners: &[Local]) -> Option<f64> {
        /// Further off than this is said as this, m.
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
        let poking = self.near(&aabb).flat_map(|s| s.points()).map(|p| depth_of(corners, *p)).fold(0.0, f64::max);
        Some(corner_depth.unwrap_or(poking))
    }
}

/// The triangles between the bounds of a lanelet, counter-clockwise, those without area left out.
fn ladder(lanelet: &Lanelet, origin: &Origin) -> Vec<Polygon> {
    let points = |bound: &[Point]| bound.iter().map(|p| origin.local(*p)).collect::<Vec<_>>();
    let (left, right) = (points(lanelet.left.points()), points(lanelet.right.points()));
    let share = |i: usize, stations: &[f64]| stations[i] / stations[stations.len() - 1];
    let (mut i, mut j) = (0, 0);
    let mut triangles = Vec::with_capacity(left.len() + right.len());
    while i + 1 < left.len() || j + 1 < right.len() {
        // with as many points on both sides, files pair them; else the side that lags behind goes on
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

/// A counter-clockwise triangle; `None` if its area is nothing.
fn triangle(a: Local, b: Local, c: Local) -> Option<Polygon> {
    /// Doubled areas below this are lines, m².
    const NOTHING: f64 = 1e-9;
    let doubled = (b - a).perp_dot(c - a);
    if doubled.abs() < NOTHING {
        return None;
    }
    let points = if doubled > 0.0 { [a, b, c] } else { [a, c, b] };
    Some(polygon(&points))
}

fn polygon(points: &[Local]) -> Polygon {
    Polygon::new(points.iter().map(|p| Coord { x: p.x, y: p.y }).collect(), Vec::new())
}

/// The area and everything within [`GROWTH`] of it: each boundary edge adds a rectangle that reaches this far over it
/// on all sides, so at corners the result goes up to √2 times as far.
fn grow(area: &MultiPolygon) -> MultiPolygon {
    let around = rings_of(area);
    let around = around.iter().flat_map(|ring| edges(ring)).map(|(a, b)| {
        let along = (b - a).normalize_or_zero() * GROWTH;
        let side = along.perp();
        polygon(&[a - along - side, b + along - side, b + along + side, a - along + side])
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

/// The closed ring's edges.
fn edges(ring: &[Local]) -> impl Iterator<Item = (Local, Local)> + '_ {
    ring.iter().zip(ring.iter().cycle().skip(1)).map(|(a, b)| (*a, *b))
}
