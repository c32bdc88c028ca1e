//! The point of a spiral nearest to a given point: branch and bound, then a safeguarded Newton iteration.
//!
//! With the deviation d(s) = p(s) − q from the query point q, the slope of ½‖d‖² is g = d·t, and g′ = 1 + κ d·n. The
//! search treats each interval in one of three ways:
//! - It discards the interval if it cannot improve on the best distance. The curve lies within max|κ| h²/8 of its chord.
//! - It solves for the minimum if g′ > 0 on the whole interval, by bounds of the curvature and the distances: there is
//!   at most one.
//! - It halves the interval otherwise.
//!
//! The result is the global minimum on the spiral, exact to [`TOLERANCE`]. The search is slowest for a point at the
//! centre of an arc, where all points are equally near: it then stops when the sagitta is below the tolerance, or at the
//! work limit.

use super::{Polynomial, Spiral};
use crate::geometry::quadrature::GAUSS_8;
use crate::geometry::{Point, Pose, Vector};

/// Improvements of the distance below this are ignored, m.
const TOLERANCE: f64 = 1e-9;
/// Largest turning of an initial interval, rad: one eight-point panel is enough for it.
const FIRST_TURNING: f64 = 0.25;
/// Maximum number of initial intervals; reached by spirals that turn more than any road.
const MAX_INITIAL: f64 = 256.0;
/// Work limit: intervals examined in total. Reached only by points at the centre of an arc.
const MAX_INTERVALS: usize = 20_000;

/// A place on the spiral.
#[derive(Clone, Copy)]
struct Place {
    s: f64,
    /// Vector from the query point to here, in the start frame, m.
    away: Vector,
    heading: f64,
}

impl Place {
    fn slope(&self) -> f64 {
        let (sin, cos) = self.heading.sin_cos();
        self.away.x * cos + self.away.y * sin
    }
}

impl<const K: usize> Spiral<K> {
    /// Arc length and distance (m) of the point nearest to `point`, on the spiral that begins at `start`; the first of
    /// several equally near points. The distance exceeds the true minimum by at most 1e-9 m.
    ///
    /// Input that is not finite returns arc length 0 and a distance that is not finite.
    #[must_use]
    pub fn nearest(&self, start: &Pose, point: Point) -> (f64, f64) {
        let search = Search { spiral: self, curvature: self.curvature_polynomial() };
        let local = start.to_local(point).coords;
        let begin = Place { s: 0.0, away: -local, heading: 0.0 };
        let finite = local.norm().is_finite() && self.length.is_finite() && self.turning_bound().is_finite();
        if !finite || self.length <= 0.0 {
            return (0.0, local.norm());
        }
        let best = search.run(begin);
        (best.s, best.away.norm())
    }
}

struct Search<'a, const K: usize> {
    spiral: &'a Spiral<K>,
    curvature: Polynomial<K>,
}

impl<const K: usize> Search<'_, K> {
    /// The place at arc length `to`, integrated from a nearby place.
    fn advanced(&self, from: &Place, to: f64) -> Place {
        let length = self.spiral.length;
        let h = to - from.s;
        let mut away = from.away;
        for (node, weight) in &GAUSS_8 {
            let (sin, cos) = (length * self.curvature.integral((from.s + h * node) / length)).sin_cos();
            away += Vector::new(cos, sin) * (weight * h);
        }
        Place { s: to, away, heading: length * self.curvature.integral(to / length) }
    }

    fn run(&self, begin: Place) -> Place {
        let spiral = self.spiral;
        let first = (spiral.turning_bound() / FIRST_TURNING).ceil().clamp(2.0, MAX_INITIAL);
        let mut best = begin;
        let mut intervals = Vec::with_capacity(64);
        let mut from = begin;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // between 2 and 256
        let count = first as usize;
        for i in 1..=count {
            let to = if i == count { spiral.length } else { spiral.length * i as f64 / first };
            let to = self.advanced(&from, to);
            better(&mut best, to);
            intervals.push((from, to));
            from = to;
        }
        intervals.reverse(); // the earliest on top of the stack, so that it wins among equally near places
        let mut work = 0;
        while let Some((from, to)) = intervals.pop() {
            work += 1;
            if work > MAX_INTERVALS {
                break;
            }
            let h = to.s - from.s;
            let max_curvature = self.max_abs_curvature(from.s, to.s);
            let sagitta = max_curvature * h * h / 8.0;
            let nearest = (to_segment(from.away, to.away) - sagitta).max(0.0);
            if nearest >= best.away.norm() - TOLERANCE {
                continue;
            }
            // |κ d·n| < 1 on the whole interval: g increases
            let farthest = from.away.norm().max(to.away.norm()) + sagitta;
            if max_curvature * farthest < 1.0 {
                if from.slope() < 0.0 && to.slope() > 0.0 {
                    better(&mut best, self.minimum(from, to));
                }
                continue;
            }
            let middle = self.advanced(&from, f64::midpoint(from.s, to.s));
            better(&mut best, middle);
            intervals.push((middle, to));
            intervals.push((from, middle));
        }
        best
    }

    /// An upper bound of |κ| between two arc lengths, tight on short intervals.
    fn max_abs_curvature(&self, from: f64, to: f64) -> f64 {
        let length = self.spiral.length;
        let (a, b) = (from / length, to / length);
        // Taylor expansion about the middle, all terms taken with the same sign
        let half = 0.5 * (b - a);
        let mut coefficients = self.curvature.0;
        let middle = f64::midpoint(a, b);
        // shift to the middle by repeated synthetic division
        for i in 0..K {
            for j in (i..K - 1).rev() {
                coefficients[j] += middle * coefficients[j + 1];
            }
        }
        coefficients.iter().rev().fold(0.0, |sum, c| c.abs() + half * sum)
    }

    /// The one minimum inside an interval on which g increases.
    fn minimum(&self, from: Place, to: Place) -> Place {
        /// Iteration limit; Newton's method needs three or four.
        const STEPS: usize = 60;
        let (mut low, mut high) = (from, to);
        let (left, right) = (from.slope(), to.slope());
        let mut at = self.advanced(&from, from.s + (to.s - from.s) * (left / (left - right)));
        for _ in 0..STEPS {
            let slope = at.slope();
            if slope > 0.0 {
                high = at
            } else {
                low = at
            }
            let (sin, cos) = at.heading.sin_cos();
            let curvature = self.curvature.value(at.s / self.spiral.length);
            let derivative = 1.0 + curvature * (at.away.y * cos - at.away.x * sin);
            let newton = at.s - slope / derivative;
            let inside = newton > low.s && newton < high.s;
            let next = if inside { newton } else { f64::midpoint(low.s, high.s) };
            let step = (next - at.s).abs();
            at = self.advanced(&from, next);
            if step < 1e-10 {
                break;
            }
        }
        at
    }
}

fn better(best: &mut Place, candidate: Place) {
    if candidate.away.norm_squared() < best.away.norm_squared() {
        *best = candidate;
    }
}

/// Distance of the origin from a segment.
fn to_segment(a: Vector, b: Vector) -> f64 {
    let chord = b - a;
    let square = chord.norm_squared();
    let ratio = if square > 0.0 { (-a.dot(&chord) / square).clamp(0.0, 1.0) } else { 0.0 };
    (a + chord * ratio).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The smallest distance over dense samples, and its possible error.
    fn dense<const K: usize>(spiral: &Spiral<K>, start: &Pose, point: Point) -> (f64, f64) {
        let n = 4000;
        let min = spiral.samples(start, n).map(|(_, p)| (p.pose.position - point).norm()).fold(f64::INFINITY, f64::min);
        (min, spiral.length / n as f64)
    }

    fn check<const K: usize>(spiral: &Spiral<K>, start: &Pose, point: Point) -> Result<(), TestCaseError> {
        let (s, distance) = spiral.nearest(start, point);
        prop_assert!((0.0..=spiral.length).contains(&s));
        let actual = (spiral.point_at(start, s).pose.position - point).norm();
        prop_assert!((actual - distance).abs() < 1e-8, "{actual} at {s}, reported {distance}");
        let (sampled, spacing) = dense(spiral, start, point);
        prop_assert!(distance <= sampled + 2e-9, "{distance}, but a sample is at {sampled}");
        prop_assert!(distance >= sampled - spacing, "{distance}, but no sample is nearer than {sampled}");
        Ok(())
    }

    proptest! {
        #[test]
        fn no_sample_is_nearer(
            turns in prop::array::uniform6(-4.0..4.0f64), length in 2.0..60.0f64, yaw in -3.0..3.0f64,
            x in -0.5..1.5f64, y in -1.0..1.0f64,
        ) {
            let start = Pose::new(5.0, -3.0, yaw);
            let point = start.to_world(Point::new(x * length, y * length));
            check(&Spiral::<6> { knots: turns.map(|t| t / length), length }, &start, point)?;
            check(&Spiral::<4> { knots: std::array::from_fn(|i| turns[i] / length), length }, &start, point)?;
        }

        #[test]
        fn projects_a_laterally_offset_point_to_its_foot(
            turns in prop::array::uniform4(-1.0..1.0f64), length in 5.0..60.0f64, at in 0.0..1.0f64, aside in -0.5..0.5f64,
        ) {
            let spiral = Spiral::<4> { knots: turns.map(|t| t / length), length };
            let start = Pose::new(0.0, 0.0, 0.0);
            let pose = spiral.point_at(&start, at * length).pose;
            let (s, distance) = spiral.nearest(&start, pose.position + pose.left() * aside);
            prop_assert!((s - at * length).abs() < 1e-6);
            prop_assert!((distance - aside.abs()).abs() < 1e-8);
        }
    }

    #[test]
    fn projects_the_centre_of_an_arc_in_bounded_time() {
        let arc = Spiral::<4> { knots: [0.1; 4], length: 25.0 };
        let (_, distance) = arc.nearest(&Pose::new(0.0, 0.0, 0.0), Point::new(0.0, 10.0));
        assert!((distance - 10.0).abs() < 1e-8);
    }

    #[test]
    fn accepts_points_and_spirals_that_are_not_finite() {
        let line = Spiral::<4>::straight(10.0);
        let start = Pose::new(0.0, 0.0, 0.0);
        assert!(line.nearest(&start, Point::new(f64::NAN, 0.0)).1.is_nan());
        assert_eq!(Spiral::<4>::straight(0.0).nearest(&start, Point::new(3.0, 4.0)), (0.0, 5.0));
        assert!(line.nearest(&start, Point::new(1e300, 0.0)).1 > 1e150);
        let _ = Spiral::<4> { knots: [f64::INFINITY; 4], length: 1.0 }.nearest(&start, Point::new(3.0, 4.0));
    }
}
