//! Convex sets in the plane: hull, overlap, distance.
//!
//! The narrow phase is a separating-axis test and not parry's GJK, because a false negative is not acceptable: GJK returns
//! `NoIntersection` if it has not converged after 100 iterations. The separating-axis test has no iteration, and its only
//! error is rounding, which [`super::swept::SKIN`] covers. The tests compare it with parry's GJK.

use parry2d::bounding_volume::Aabb;

use super::convert::{Local, Origin, vector};
use super::outline::{SweptParts, signs_between};
use super::uncertainty::Reach;
use crate::geometry::Pose;
use crate::map::ConvexPart;

/// A convex polygon (counter-clockwise; a point or a segment is allowed) inflated by a radius: circles, capsules and
/// polygons.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Convex {
    points: Vec<Local>,
    radius: f64,
    aabb: Aabb,
}

impl Convex {
    /// The hull of the points, inflated by `radius`. `None` without points or with a number that is not finite.
    pub(super) fn hull_of(mut points: Vec<Local>, radius: f64) -> Option<Self> {
        let finite = radius.is_finite() && points.iter().all(|p| p.is_finite());
        if points.is_empty() || !finite {
            return None;
        }
        let mut hull = vec![Local::ZERO; points.len() + 1];
        let n = hull_into(&mut points, &mut hull);
        hull.truncate(n);
        let aabb = inflated(&Aabb::from_points_ref(&hull), radius);
        Some(Self { points: hull, radius, aabb })
    }

    /// A part of a static obstacle or of a prediction set, given in world coordinates.
    pub(super) fn of_part(part: &ConvexPart, origin: &Origin) -> Option<Self> {
        match part {
            ConvexPart::Polygon(points) => Self::hull_of(points.iter().map(|p| origin.local(*p)).collect(), 0.0),
            ConvexPart::Circle { centre, radius } => Self::hull_of(vec![origin.local(*centre)], radius.max(0.0)),
        }
    }

    /// The hull of a part (in the frame of its obstacle) at several poses (relative to the origin), inflated by `slack`.
    pub(super) fn moved_through(part: &ConvexPart, poses: &[Pose], slack: f64) -> Option<Self> {
        match part {
            ConvexPart::Polygon(points) => {
                let all = poses.iter().flat_map(|pose| points.iter().map(|p| vector(pose.to_world(*p))));
                Self::hull_of(all.collect(), slack)
            }
            ConvexPart::Circle { centre, radius } => {
                Self::hull_of(poses.iter().map(|p| vector(p.to_world(*centre))).collect(), radius.max(0.0) + slack)
            }
        }
    }

    /// The Minkowski sum with a rectangle of deviations: the hull of every corner displaced by the corners of the rectangle
    /// that are extreme between the normals of its two edges.
    pub(super) fn minkowski_sum(&self, reach: &Reach) -> Option<Self> {
        let Reach { forward, ahead, behind, lateral } = *reach;
        let moved = |p: Local, out: Local| {
            p + forward * (if out.x > 0.0 { ahead } else { -behind }) + forward.perp() * (out.y * lateral)
        };
        let n = self.points.len();
        // the outward normal of the edge from point i, in the axes of the rectangle
        let outward = |i: usize| {
            let edge = self.points[(i + 1) % n] - self.points[i];
            let outward = Local::new(edge.y, -edge.x);
            Local::new(outward.dot(forward), forward.perp_dot(outward))
        };
        let mut points = Vec::with_capacity(n + 4);
        for (i, p) in self.points.iter().enumerate() {
            if n < 3 {
                // a point has no normals, and those of a segment are opposite
                let corners = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)];
                points.extend(corners.map(|(x, y)| moved(*p, Local::new(x, y))));
            } else {
                points.extend(signs_between(outward((i + n - 1) % n), outward(i)).map(|out| moved(*p, out)));
            }
        }
        // build the hull again: with a rectangle of almost no width, rounding produces edges in any direction, and an edge
        // that is not on the hull would be a wrong separating axis
        Self::hull_of(points, self.radius)
    }

    pub(super) fn segment(a: Local, b: Local) -> Self {
        Self { points: vec![a, b], radius: 0.0, aabb: Aabb::from_points_ref(&[a, b]) }
    }

    pub(super) fn points(&self) -> &[Local] {
        &self.points
    }

    pub(super) fn radius(&self) -> f64 {
        self.radius
    }

    pub(super) fn aabb(&self) -> &Aabb {
        &self.aabb
    }

    /// Distance to the convex polygon `hull`, 0 if they overlap, m.
    pub(super) fn distance_to(&self, hull: &[Local]) -> f64 {
        (polygon_distance(hull, &self.points) - self.radius).max(0.0)
    }

    /// Penetration depth with the convex polygon `hull`, m, 0 if they are apart: the smallest separating displacement over
    /// the normals of their edges (exact for polygons).
    pub(super) fn depth_in(&self, hull: &[Local]) -> f64 {
        let depth = -largest_gap(&self.points, hull).max(largest_gap(hull, &self.points));
        (depth + self.radius).max(0.0)
    }

    /// Whether it shares a point with the convex hull of the swept corners and, if the vehicle has parts, with one of them.
    /// Touching counts.
    pub(super) fn overlaps(&self, shape: &mut SweptCorners) -> bool {
        if beyond_an_edge(&self.points, &shape.corners, self.radius) {
            return false;
        }
        self.reaches_into(shape.hull()) && shape.parts.as_mut().is_none_or(|parts| parts.meet(self))
    }

    /// Whether it shares a point with the convex polygon `hull`; touching counts.
    pub(super) fn overlaps_polygon(&self, hull: &[Local]) -> bool {
        !beyond_an_edge(&self.points, hull, self.radius) && self.reaches_into(hull)
    }

    /// Whether it shares a point with the convex polygon, given that none of the body's edges separates them.
    fn reaches_into(&self, hull: &[Local]) -> bool {
        if beyond_an_edge(hull, &self.points, self.radius) {
            return false;
        }
        self.radius == 0.0 || polygon_distance(hull, &self.points) <= self.radius
    }
}

/// The corners of a footprint at the two ends of a cell. Their hull is built on demand, since the edges of the other shape
/// decide most tests.
#[derive(Debug, Clone)]
pub(super) struct SweptCorners {
    corners: [Local; 8],
    hull: [Local; 9],
    /// Number of vertices of `hull`; 0 while it is not built.
    vertices: usize,
    /// The parts of the vehicle, if it is not a rectangle.
    parts: Option<Box<SweptParts>>,
}

impl SweptCorners {
    pub(super) fn new(corners: [Local; 8]) -> Self {
        Self { corners, hull: [Local::ZERO; 9], vertices: 0, parts: None }
    }

    /// The footprint with the parts of the vehicle inside it.
    pub(super) fn with_parts(self, parts: Option<Box<SweptParts>>) -> Self {
        Self { parts, ..self }
    }

    /// The box around the corners.
    pub(super) fn aabb(&self) -> Aabb {
        Aabb::from_points_ref(&self.corners)
    }

    pub(super) fn hull(&mut self) -> &[Local] {
        if self.vertices == 0 {
            self.vertices = hull_into(&mut self.corners, &mut self.hull);
        }
        &self.hull[..self.vertices]
    }
}

/// The box inflated by `by` on every side.
pub(super) fn inflated(aabb: &Aabb, by: f64) -> Aabb {
    Aabb { mins: aabb.mins - Local::splat(by), maxs: aabb.maxs + Local::splat(by) }
}

/// Whether the boxes share a point.
pub(super) fn boxes_meet(a: &Aabb, b: &Aabb) -> bool {
    a.mins.x <= b.maxs.x && b.mins.x <= a.maxs.x && a.mins.y <= b.maxs.y && b.mins.y <= a.maxs.y
}

/// The smallest box around both.
pub(super) fn merged(a: &Aabb, b: &Aabb) -> Aabb {
    Aabb { mins: a.mins.min(b.mins), maxs: a.maxs.max(b.maxs) }
}

/// Distance between boxes, m, 0 if they meet.
pub(super) fn box_distance(a: &Aabb, b: &Aabb) -> f64 {
    (a.mins - b.maxs).max(b.mins - a.maxs).max(Local::ZERO).length()
}

/// Convex hull, counter-clockwise, by Andrew's monotone chain. Sorts `points`, writes to `out` (one longer than `points`)
/// and returns the number of vertices. Collinear points are reduced to their extremes: a segment has two vertices.
fn hull_into(points: &mut [Local], out: &mut [Local]) -> usize {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let mut n = 0;
    let mut push = |p: Local, base: usize| {
        while n >= base + 2 && (out[n - 1] - out[n - 2]).perp_dot(p - out[n - 1]) <= 0.0 {
            n -= 1;
        }
        out[n] = p;
        n += 1;
        n
    };
    let mut lower = 0;
    for &p in points.iter() {
        lower = push(p, 0);
    }
    let mut all = lower;
    for &p in points.iter().rev().skip(1) {
        all = push(p, lower - 1);
    }
    // the chain closes on its first point
    if points.len() > 1 { all - 1 } else { all }
}

/// Whether all `points` are beyond one edge of the counter-clockwise `polygon` by more than `gap`. A segment has two edges,
/// one for each side; a point has none.
fn beyond_an_edge(polygon: &[Local], points: &[Local], gap: f64) -> bool {
    let mut from = polygon[polygon.len() - 1];
    for &to in polygon {
        let edge = to - from;
        let outward = Local::new(edge.y, -edge.x);
        let limit = if gap == 0.0 { 0.0 } else { gap * outward.length() };
        if points.iter().all(|p| outward.dot(*p - from) > limit) {
            return true;
        }
        from = to;
    }
    false
}

/// The largest signed distance over the edges of `polygon` by which all `points` are beyond that edge, m. Minus infinity for
/// a point, which has no edge.
fn largest_gap(polygon: &[Local], points: &[Local]) -> f64 {
    let mut largest = f64::NEG_INFINITY;
    let mut from = polygon[polygon.len() - 1];
    for &to in polygon {
        let outward = Local::new(to.y - from.y, from.x - to.x).normalize_or_zero();
        if outward != Local::ZERO {
            let nearest = points.iter().map(|p| outward.dot(*p - from)).fold(f64::INFINITY, f64::min);
            largest = largest.max(nearest);
        }
        from = to;
    }
    largest
}

/// Depth of a point inside a convex counter-clockwise polygon, m; negative outside.
pub(super) fn depth_of(polygon: &[Local], p: Local) -> f64 {
    -largest_gap(polygon, &[p])
}

/// Distance between convex polygons, m, 0 if they overlap. If they are apart, the smallest distance is between a vertex of
/// one and an edge of the other.
fn polygon_distance(a: &[Local], b: &[Local]) -> f64 {
    // without a separating edge they overlap, unless neither has an interior
    if (a.len() >= 3 || b.len() >= 3) && !beyond_an_edge(a, b, 0.0) && !beyond_an_edge(b, a, 0.0) {
        return 0.0;
    }
    vertex_edge_distance_squared(a, b).min(vertex_edge_distance_squared(b, a)).sqrt()
}

fn vertex_edge_distance_squared(vertices: &[Local], polygon: &[Local]) -> f64 {
    let mut best = f64::INFINITY;
    let mut from = polygon[polygon.len() - 1];
    for &to in polygon {
        let edge = to - from;
        let scale = 1.0 / edge.length_squared().max(f64::MIN_POSITIVE);
        for &p in vertices {
            let ratio = ((p - from).dot(edge) * scale).clamp(0.0, 1.0);
            best = best.min((p - from - edge * ratio).length_squared());
        }
        from = to;
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use parry2d::math::Pose as ParryPose;
    use parry2d::query;
    use parry2d::shape::ConvexPolygon;
    use proptest::prelude::*;

    fn points(n: std::ops::Range<usize>) -> impl Strategy<Value = Vec<Local>> {
        prop::collection::vec((-5.0..5.0f64, -5.0..5.0f64), n)
            .prop_map(|v| v.into_iter().map(|(x, y)| Local::new(x, y)).collect())
    }

    #[test]
    fn a_segment_and_repeated_points_have_a_hull() {
        let (a, b) = (Local::new(0.0, 0.0), Local::new(2.0, 2.0));
        let line = Convex::hull_of(vec![a, Local::new(1.0, 1.0), b, a], 0.0).unwrap();
        assert_eq!(line.points.len(), 2);
        let point = Convex::hull_of(vec![b, b, b], 1.0).unwrap();
        assert!(
            (point.distance_to(&[a, Local::new(1.0, -1.0), Local::new(1.0, 0.0)]) - (5f64.sqrt() - 1.0)).abs() < 1e-12
        );
        assert!(Convex::hull_of(vec![a, Local::new(f64::NAN, 0.0)], 0.0).is_none());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        /// Brute force: the hull of every point displaced by every corner.
        #[test]
        fn minkowski_sum_agrees_with_brute_force(
            body in points(1..9), yaw in prop_oneof![Just(0.0), Just(1.0), -4.0..4.0f64],
            ahead in prop_oneof![Just(1e-17), Just(1e-12), 0.0..9.0f64], behind in prop_oneof![Just(1e-17), 0.0..3.0f64],
            lateral in prop_oneof![Just(0.0), Just(1e-16), 0.0..2.0f64], radius in 0.0..1.0f64,
        ) {
            let forward = Local::new(f64::cos(yaw), f64::sin(yaw));
            let body = Convex::hull_of(body, radius).unwrap();
            let ours = body.minkowski_sum(&Reach { forward, ahead, behind, lateral }).unwrap();
            let corners = [(ahead, lateral), (-behind, lateral), (-behind, -lateral), (ahead, -lateral)];
            let moved = |p: &Local| corners.map(|(x, y)| *p + forward * x + forward.perp() * y);
            let slow = Convex::hull_of(body.points.iter().flat_map(moved).collect(), radius).unwrap();
            for (a, b) in [(&ours, &slow), (&slow, &ours), (&ours, &ours)] {
                let bare = Convex { radius: 0.0, ..b.clone() };
                for p in a.points() {
                    prop_assert!(bare.distance_to(&[*p, *p, *p]) < 1e-9, "{p}");
                }
            }
            let apart = (ours.aabb.mins - slow.aabb.mins).length() + (ours.aabb.maxs - slow.aabb.maxs).length();
            prop_assert!(apart < 1e-9 && ours.radius == radius);
        }

        #[test]
        fn overlap_and_distance_agree_with_parry(a in points(8..9), b in points(3..9), radius in 0.0..2.0f64, shift in 0.0..8.0f64) {
            let b: Vec<Local> = b.into_iter().map(|p| p + Local::new(shift, 0.3 * shift)).collect();
            let mut corners = SweptCorners::new(a.clone().try_into().unwrap());
            let part = Convex::hull_of(b, radius).unwrap();
            let (Some(pa), Some(pb)) = (ConvexPolygon::from_convex_polyline(corners.hull().to_vec()), ConvexPolygon::from_convex_polyline(part.points.clone())) else { return Ok(()) };
            let distance = query::distance(&ParryPose::IDENTITY, &pa, &ParryPose::IDENTITY, &pb).unwrap().distance;
            let ours = polygon_distance(corners.hull(), &part.points);
            // parry's GJK can stop 8e-5 m above the distance
            prop_assert!(ours - 1e-9 < distance && distance < ours + 1e-3, "parry {distance}, ours {ours}");
            if (distance - radius).abs() > 1e-3 {
                prop_assert_eq!(part.overlaps(&mut corners), distance < radius);
            }
        }
    }
}
