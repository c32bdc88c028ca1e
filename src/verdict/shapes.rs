//! Geometry of convex polygons and circles for the verdict alone: slow, simple, exact up to rounding.

use crate::geometry::{Point, Pose, Vector, cross};
use crate::map::ConvexPart;
use crate::vehicle::Vehicle;

/// The parts of the vehicle's footprint in the world, counter-clockwise convex polygons.
pub(super) fn footprint_at(vehicle: &Vehicle, rear_axle: &Pose) -> Vec<Vec<Point>> {
    let part = |corners: &Vec<Point>| corners.iter().map(|corner| rear_axle.to_world(*corner)).collect();
    vehicle.footprint.parts().iter().map(part).collect()
}

/// The gap between a counter-clockwise convex polygon and a convex part, m: their distance if they are apart, otherwise minus
/// the depth of their overlap (the least translation that separates them).
pub(super) fn gap(polygon: &[Point], part: &ConvexPart) -> f64 {
    match part {
        ConvexPart::Polygon(other) => {
            let separation = largest_separation(polygon, other).max(largest_separation(other, polygon));
            if separation <= 0.0 { separation } else { outline_distance(polygon, other) }
        }
        ConvexPart::Circle { centre, radius } => {
            let inside = largest_separation(polygon, std::slice::from_ref(centre));
            let to_centre = if inside <= 0.0 { inside } else { distance_to_outline(polygon, *centre) };
            to_centre - radius
        }
    }
}

/// Where and along which direction a polygon and a convex part touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Touch {
    /// As [`gap`], for shapes that overlap; for shapes apart, the distance along the normal.
    pub(super) gap: f64,
    /// Unit vector from the polygon to the part.
    pub(super) normal: Vector,
    /// The middle of the points in contact.
    pub(super) at: Point,
}

/// The contact between a counter-clockwise convex polygon and a convex part that touch: the axis of least overlap. `None` for
/// a polygon without an edge.
pub(super) fn touch(polygon: &[Point], part: &ConvexPart) -> Option<Touch> {
    match part {
        ConvexPart::Polygon(other) => {
            let (of_polygon, of_other) = (least_overlap(polygon, other)?, least_overlap(other, polygon)?);
            let (gap, normal) = if of_polygon.0 >= of_other.0 { of_polygon } else { (of_other.0, -of_other.1) };
            Some(Touch { gap, normal, at: middle_of_contact(polygon, other, normal)? })
        }
        ConvexPart::Circle { centre, radius } => {
            let (inside, outward) = least_overlap(polygon, std::slice::from_ref(centre))?;
            let nearest = |(a, b): (Point, Point)| nearest_on_segment(a, b, *centre);
            let at = edges(polygon).map(nearest).min_by(|p, q| (p - centre).norm().total_cmp(&(q - centre).norm()))?;
            let normal =
                if inside > 0.0 { (centre - at).try_normalize(SHORTEST_EDGE).unwrap_or(outward) } else { outward };
            let to_centre = if inside > 0.0 { (centre - at).norm() } else { inside };
            Some(Touch { gap: to_centre - radius, normal, at })
        }
    }
}

/// The middle of the overlap of the two features that face each other along the normal.
fn middle_of_contact(polygon: &[Point], other: &[Point], normal: Vector) -> Option<Point> {
    /// Corners within this of the foremost one belong to the feature, m.
    const SAME: f64 = 0.01;
    let along = Vector::new(-normal.y, normal.x);
    let origin = polygon.first()?;
    let feature = |points: &[Point], direction: Vector| {
        let foremost = points.iter().map(|p| (p - origin).dot(&direction)).fold(f64::NEG_INFINITY, f64::max);
        let of_feature = points.iter().map(|p| p - origin).filter(|p| p.dot(&direction) >= foremost - SAME);
        let positions = of_feature.map(|p| p.dot(&along));
        let ends = positions.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
        (foremost, ends)
    };
    let (own, (own_from, own_to)) = feature(polygon, normal);
    let (_, (from, to)) = feature(other, -normal);
    Some(origin + normal * own + along * f64::midpoint(own_from.max(from), own_to.min(to)))
}

/// Separating-axis theorem, for the axes of one polygon: the largest distance by which all of `other` lies outside one of the
/// edges of `polygon`; negative if it lies outside no edge.
fn largest_separation(polygon: &[Point], other: &[Point]) -> f64 {
    least_overlap(polygon, other).map_or(f64::NEG_INFINITY, |(separation, _)| separation)
}

/// [`largest_separation`] with the outward normal of its edge; `None` for a polygon without an edge.
fn least_overlap(polygon: &[Point], other: &[Point]) -> Option<(f64, Vector)> {
    edges(polygon)
        .filter_map(|(a, b)| (b - a).try_normalize(SHORTEST_EDGE).map(|along| (a, along)))
        .map(|(a, along)| {
            let outward = Vector::new(along.y, -along.x);
            (other.iter().map(|p| (p - a).dot(&outward)).fold(f64::INFINITY, f64::min), outward)
        })
        .reduce(|best, axis| if axis.0 > best.0 { axis } else { best })
}

/// Edges shorter than this (m) have no usable direction.
const SHORTEST_EDGE: f64 = 1e-9;

/// Distance between the outlines of two separate polygons: one of the two nearest points is a vertex.
fn outline_distance(a: &[Point], b: &[Point]) -> f64 {
    let from_vertices =
        |from: &[Point], to: &[Point]| from.iter().map(|p| distance_to_outline(to, *p)).fold(f64::INFINITY, f64::min);
    from_vertices(a, b).min(from_vertices(b, a))
}

/// Distance from a point to a polygon's outline, m.
pub(super) fn distance_to_outline(polygon: &[Point], p: Point) -> f64 {
    edges(polygon).map(|(a, b)| distance_to_segment(a, b, p)).fold(f64::INFINITY, f64::min)
}

fn distance_to_segment(a: Point, b: Point, p: Point) -> f64 {
    (p - nearest_on_segment(a, b, p)).norm()
}

fn nearest_on_segment(a: Point, b: Point, p: Point) -> Point {
    let along = b - a;
    let ratio =
        if along == Vector::zeros() { 0.0 } else { ((p - a).dot(&along) / along.norm_squared()).clamp(0.0, 1.0) };
    a + along * ratio
}

/// Whether a point lies inside a simple polygon of either winding: winding number by signed crossings.
pub(super) fn contains(polygon: &[Point], p: Point) -> bool {
    let winding: i32 = edges(polygon)
        .map(|(a, b)| {
            let side = cross(b - a, p - a);
            i32::from(a.y <= p.y && b.y > p.y && side > 0.0) - i32::from(a.y > p.y && b.y <= p.y && side < 0.0)
        })
        .sum();
    winding != 0
}

fn edges(polygon: &[Point]) -> impl Iterator<Item = (Point, Point)> + '_ {
    polygon.iter().copied().zip(polygon.iter().copied().cycle().skip(1))
}

/// An axis-aligned box, to skip distant shapes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    min: Point,
    max: Point,
}

impl Bounds {
    /// The box around points; it is empty without points.
    pub(super) fn of(points: &[Point]) -> Self {
        let empty = Self {
            min: Point::new(f64::INFINITY, f64::INFINITY),
            max: Point::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
        };
        points.iter().fold(empty, |b, p| Self { min: b.min.inf(p), max: b.max.sup(p) })
    }

    /// Whether two boxes are at most `margin` metres apart along each axis.
    pub(super) fn near(&self, other: &Self, margin: f64) -> bool {
        self.min.x <= other.max.x + margin
            && other.min.x <= self.max.x + margin
            && self.min.y <= other.max.y + margin
            && other.min.y <= self.max.y + margin
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn square(x: f64, y: f64, half: f64) -> Vec<Point> {
        vec![
            Point::new(x - half, y - half),
            Point::new(x + half, y - half),
            Point::new(x + half, y + half),
            Point::new(x - half, y + half),
        ]
    }

    fn turned(points: &[Point], yaw: f64, x: f64, y: f64) -> Vec<Point> {
        points.iter().map(|p| Pose::new(x, y, yaw).to_world(*p)).collect()
    }

    #[test]
    fn gap_of_squares_side_by_side_corner_to_corner_and_overlapping() {
        let a = square(0.0, 0.0, 1.0);
        assert!((gap(&a, &ConvexPart::Polygon(square(3.0, 0.5, 1.0))) - 1.0).abs() < 1e-12);
        assert!((gap(&a, &ConvexPart::Polygon(square(5.0, 6.0, 1.0))) - 5.0).abs() < 1e-12);
        assert!((gap(&a, &ConvexPart::Polygon(square(1.8, 0.5, 1.0))) + 0.2).abs() < 1e-12);
        assert!((gap(&a, &ConvexPart::Polygon(square(0.0, 0.0, 10.0))) + 11.0).abs() < 1e-12, "one inside the other");
    }

    #[test]
    fn gap_of_a_circle_beside_a_side_off_a_corner_and_inside() {
        let a = square(0.0, 0.0, 1.0);
        let circle = |x, y, radius| ConvexPart::Circle { centre: Point::new(x, y), radius };
        assert!((gap(&a, &circle(2.5, 0.0, 0.5)) - 1.0).abs() < 1e-12);
        assert!((gap(&a, &circle(4.0, 5.0, 0.5)) - 4.5).abs() < 1e-12);
        assert!((gap(&a, &circle(0.9, 0.0, 0.5)) + 0.6).abs() < 1e-12);
    }

    #[test]
    fn crossing_bars_overlap_without_a_corner_inside_the_other() {
        let bar = [Point::new(-5.0, -0.1), Point::new(5.0, -0.1), Point::new(5.0, 0.1), Point::new(-5.0, 0.1)];
        let upright = turned(&bar, std::f64::consts::FRAC_PI_2, 0.0, 0.0);
        assert!(gap(&bar, &ConvexPart::Polygon(upright)) < 0.0);
    }

    #[test]
    fn containment_of_either_winding_and_of_a_concave_outline() {
        let l: Vec<Point> =
            [(0., 0.), (4., 0.), (4., 1.), (1., 1.), (1., 3.), (0., 3.)].map(|(x, y)| Point::new(x, y)).to_vec();
        let clockwise: Vec<Point> = l.iter().rev().copied().collect();
        for outline in [&l, &clockwise] {
            assert!(contains(outline, Point::new(0.5, 2.5)));
            assert!(contains(outline, Point::new(3.5, 0.5)));
            assert!(!contains(outline, Point::new(2.0, 2.0)));
            assert!(!contains(outline, Point::new(-0.5, 0.5)));
        }
    }

    proptest! {
        /// The reference: the smallest distance between points sampled on both outlines.
        #[test]
        fn gap_agrees_with_dense_sampling(x in -6.0..6.0f64, y in -6.0..6.0f64, yaw in -3.2..3.2f64, l in 0.2..3.0f64, w in 0.2..3.0f64) {
            let a = square(0.0, 0.0, 1.0);
            let b = turned(
                &[Point::new(-l, -w), Point::new(l, -w), Point::new(l, w), Point::new(-l, w)], yaw, x, y);
            let dense = |polygon: &[Point]| -> Vec<Point> {
                edges(polygon).flat_map(|(p, q)| (0..200).map(move |i| p + (q - p) * (f64::from(i) / 200.0))).collect()
            };
            let (da, db) = (dense(&a), dense(&b));
            let g = gap(&a, &ConvexPart::Polygon(b.clone()));
            let overlapping = da.iter().any(|p| contains(&b, *p)) || db.iter().any(|p| contains(&a, *p));
            if overlapping {
                prop_assert!(g < 1e-9, "overlapping, but the gap is {g}");
            } else {
                let sampled = da.iter().flat_map(|p| db.iter().map(move |q| (p - q).norm())).fold(f64::INFINITY, f64::min);
                prop_assert!(g <= sampled + 1e-9 && g > sampled - 0.05, "gap {g}, sampled {sampled}");
            }
        }

        #[test]
        fn gap_is_the_same_a_thousand_kilometres_away(x in -6.0..6.0f64, y in -6.0..6.0f64, yaw in -3.2..3.2f64) {
            let (a, b) = (square(0.0, 0.0, 1.0), turned(&square(0.0, 0.0, 1.5), yaw, x, y));
            let far = |p: &[Point]| -> Vec<Point> { p.iter().map(|p| p + Vector::new(1e6, -1e6)).collect() };
            let near_gap = gap(&a, &ConvexPart::Polygon(b.clone()));
            let far_gap = gap(&far(&a), &ConvexPart::Polygon(far(&b)));
            prop_assert!((near_gap - far_gap).abs() < 1e-8, "{near_gap} here, {far_gap} there");
        }
    }
}
