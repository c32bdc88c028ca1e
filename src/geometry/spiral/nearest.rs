//! The point of a spiral nearest to a given point: branch and bound, then a safeguarded Newton iteration.
//!
//! With the deviation d(s) = p(s) − q the slope of ½‖d‖² is g = d·t, and g′ = 1 + κ d·n. An interval is
//! - dropped when it cannot beat the best distance so far: it lies within max|κ| h²/8 of its chord;
//! - finished when g′ > 0 on all of it (bounded from the curvature's range and the distances): it has one minimum;
//! - halved otherwise.
//!
//! Global on the spiral and exact to [`TOLERANCE`]. Slowest for a point at the centre of an arc, where everything is
//! equally near: intervals then end where their sagitta is below the tolerance, or with the work limit.

use super::{Polynomial, Spiral};
use crate::geometry::quadrature::GAUSS_8;
use crate::geometry::{Point, Pose, Vector};

/// A distance this much nearer than the best so far is not looked for, m.
const TOLERANCE: f64 = 1e-9;
/// Largest turning of a first interval, rad: short enough for one eight-point panel.
const FIRST_TURNING: f64 = 0.25;
/// First intervals at most; for spirals that wind as no road does.
const MOST_FIRST: f64 = 256.0;
/// Intervals looked at, over all: reached by points at the centre of an arc only.
const MOST_INTERVALS: usize = 20_000;

/// A place on the spiral.
#[derive(Clone, Copy)]
struct Place {
    s: f64,
    /// From the point asked for to here, in the start frame.
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
    /// Arc length and distance of the point of the spiral (begun at `start`) that is nearest to `point`, both in m; the
    /// first of several. Never farther than the true nearest by more than 1e-9 m.
    ///
    /// Not finite input gives the start and a distance that is not finite.
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
    /// The place a little farther on.
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
        let first = (spiral.turning_bound() / FIRST_TURNING).ceil().clamp(2.0, MOST_FIRST);
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
        intervals.reverse(); // the first on top, so that the first of several equally near places is found first
        let mut work = 0;
        while let Some((from, to)) = intervals.pop() {
            work += 1;
            if work > MOST_INTERVALS {
                break;
            }
            let h = to.s - from.s;
            let steepest = self.steepest(from.s, to.s);
            let sagitta = steepest * h * h / 8.0;
            let nearest = (to_segment(from.away, to.away) - sagitta).max(0.0);
            if nearest >= best.away.norm() - TOLERANCE {
                continue;
            }
            // |κ d·n| < 1 on the whole interval: the slope rises
            let farthest = from.away.norm().max(to.away.norm()) + sagitta;
            if steepest * farthest < 1.0 {
                if from.slope() < 0.0 && to.slope() > 0.0 {
                    better(&mut best, self.bottom(from, to));
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

    /// An upper bound of |κ| between two arc lengths: the values at both ends and the curvature's own variation.
    fn steepest(&self, from: f64, to: f64) -> f64 {
        let length = self.spiral.length;
        let (a, b) = (from / length, to / length);
        // Taylor about the middle with all derivatives: exact bound, tight on short intervals
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

    /// The one minimum inside an interval with a rising slope.
    fn bottom(&self, from: Place, to: Place) -> Place {
        /// Newton's method takes three or four.
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
            let bend = self.curvature.value(at.s / self.spiral.length);
            let steepness = 1.0 + bend * (at.away.y * cos - at.away.x * sin);
            let newton = at.s - slope / steepness;
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
    let along = b - a;
    let length = along.norm_squared();
    let ratio = if length > 0.0 { (-a.dot(&along) / length).clamp(0.0, 1.0) } else { 0.0 };
    (a + along * ratio).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The least distance at dense samples, and what it may be off by.
    fn dense<const K: usize>(spiral: &Spiral<K>, start: &Pose, point: Point) -> (f64, f64) {
        let n = 4000;
        let least =
            spiral.samples(start, n).map(|(_, p)| (p.pose.position - point).norm()).fold(f64::INFINITY, f64::min);
        (least, spiral.length / n as f64)
    }

    fn check<const K: usize>(spiral: &Spiral<K>, start: &Pose, point: Point) -> Result<(), TestCaseError> {
        let (s, distance) = spiral.nearest(start, point);
        prop_assert!((0.0..=spiral.length).contains(&s));
        let there = (spiral.point_at(start, s).pose.position - point).norm();
        prop_assert!((there - distance).abs() < 1e-8, "{there} at {s}, said to be {distance}");
        let (least, spacing) = dense(spiral, start, point);
        prop_assert!(distance <= least + 2e-9, "{distance} where {least} was seen");
        prop_assert!(distance >= least - spacing, "{distance} where nothing is nearer than {least}");
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
        fn a_point_beside_the_spiral_comes_back(
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
    fn the_centre_of_an_arc_is_answered_in_bounded_time() {
        let arc = Spiral::<4> { knots: [0.1; 4], length: 25.0 };
        let (_, distance) = arc.nearest(&Pose::new(0.0, 0.0, 0.0), Point::new(0.0, 10.0));
        assert!((distance - 10.0).abs() < 1e-8);
    }

    #[test]
    fn points_and_spirals_that_are_not_finite_are_answered() {
        let line = Spiral::<4>::straight(10.0);
        let start = Pose::new(0.0, 0.0, 0.0);
        assert!(line.nearest(&start, Point::new(f64::NAN, 0.0)).1.is_nan());
        assert_eq!(Spiral::<4>::straight(0.0).nearest(&start, Point::new(3.0, 4.0)), (0.0, 5.0));
        assert!(line.nearest(&start, Point::new(1e300, 0.0)).1 > 1e150);
        let _ = Spiral::<4> { knots: [f64::INFINITY; 4], length: 1.0 }.nearest(&start, Point::new(3.0, 4.0));
    }
}
