//! Reachable sets of moving obstacles: bounded deviations from a prediction.
//!
//! # The set
//! The present state of the obstacle is known; its future is predicted. With the predicted position p̂ and heading ψ, a
//! motion p = p̂ + δ belongs to the set if its acceleration differs from the predicted one by at most the [`MotionBounds`],
//! in the longitudinal and lateral direction of the predicted heading:
//!
//! ```text
//! δ″(s) ∈ R(ψ(s)) · [−longitudinal, longitudinal] × [−lateral, lateral],   δ(0) = δ′(0) = 0,   time s from now
//! ```
//!
//! Two optional bounds reduce the set: a lateral deviation of at most `max_lateral_deviation` (an obstacle that keeps its
//! lane), and velocities that never point backwards (vehicles and bicycles that do not reverse; not for pedestrians). The
//! prediction itself always belongs to the set.
//!
//! # Technique
//! δ(τ) = ∫₀^τ (τ − s) δ″(s) ds, so that the set of all δ(τ) is convex and symmetric, with the support function
//!
//! ```text
//! h(n) = ∫₀^τ (τ − s) ( longitudinal · |cos(ψ(s) − n)| + lateral · |sin(ψ(s) − n)| ) ds
//! ```
//!
//! in the direction n: the support function of an integral of sets (Aumann) is the integral of their support functions. h
//! increases with τ in every direction, so that the set at a time contains those of all earlier times, and the set at the end
//! of a time slice is sufficient for the whole slice. The rectangle in the heading at that time with the half sides h(ψ) and
//! h(ψ + π/2) contains it; for straight motion it is the set. The Minkowski sum of the predicted region and that rectangle
//! covers the obstacle (`Convex::minkowski_sum`).
//!
//! The integral is exact over time intervals in which the heading stays within a narrow band, with the largest |cos| and
//! |sin| of the band: never below h, and equal to it for a constant heading.
//!
//! An obstacle that does not reverse has (p̂′ + δ′)·e(ψ) ≥ 0 at every time, or the velocity of the prediction if that is
//! backwards, so that δ′·e(ψ) ≥ −|p̂′|. In the direction of the last heading, from which no earlier heading differs by more
//! than θ ≤ π/2, this gives δ(τ) ≥ −L − sin θ · ∫|δ′|, with the predicted distance L and
//! |δ′(s)| ≤ s · √(longitudinal² + lateral²).
//!
//! # Weaknesses
//! The body keeps the predicted heading; the set does not contain the rotation of a vehicle that deviates laterally. After a
//! curve the rectangle is larger than the set. Prediction sets of the file remain unchanged. An obstacle leaves the map when
//! its prediction ends, even if it may be late.

use std::f64::consts::{FRAC_PI_2, PI};

use super::convert::Local;

/// Bounds on motions around a prediction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionBounds {
    /// Largest difference from the predicted acceleration in the direction of the predicted heading, m/s².
    pub longitudinal: f64,
    /// Largest difference from the predicted acceleration perpendicular to the predicted heading, m/s².
    pub lateral: f64,
    /// Largest lateral deviation from the prediction, m; infinite if only the accelerations bound it.
    pub max_lateral_deviation: f64,
    /// Whether vehicles and bicycles may move backwards.
    pub vehicles_reverse: bool,
}

impl MotionBounds {
    /// Whether only the prediction itself is within the bounds.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        self.longitudinal == 0.0 && self.lateral == 0.0
    }
}

/// Headings that differ by less share a run, rad: this widens the rectangle by at most 5 % of `longitudinal`.
const BAND: f64 = 0.05;
/// Maximum number of runs; beyond it neighbours are merged pairwise.
const MAX_RUNS: usize = 64;

/// The predicted motion during one time slice.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leg {
    /// End time, s.
    pub(super) end: f64,
    /// Smallest and largest heading, rad; not wrapped over all legs of a prediction.
    pub(super) headings: (f64, f64),
    /// Heading at the end, rad.
    pub(super) heading: f64,
    /// Travelled distance, m.
    pub(super) distance: f64,
}

/// A rectangle around all deviations, m. It contains zero deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach {
    /// Unit vector along the heading.
    pub(super) forward: Local,
    pub(super) ahead: f64,
    pub(super) behind: f64,
    /// Extent to either side.
    pub(super) lateral: f64,
}

/// The set of deviations from a prediction, over time.
#[derive(Debug)]
pub(super) struct Spread<'b> {
    bounds: &'b MotionBounds,
    may_reverse: bool,
    runs: Vec<Run>,
    /// Time since the state was known, s.
    elapsed: f64,
    /// Predicted distance since then, m.
    distance: f64,
}

/// A time interval in which the heading stays within a band.
#[derive(Debug, Clone, Copy)]
struct Run {
    from: f64,
    to: f64,
    headings: (f64, f64),
}

impl Run {
    /// The run that contains both.
    fn joined(&self, later: &Self) -> Self {
        let headings = (self.headings.0.min(later.headings.0), self.headings.1.max(later.headings.1));
        Self { from: self.from, to: later.to, headings }
    }
}

impl<'b> Spread<'b> {
    /// The set at elapsed time zero: no deviation.
    pub(super) fn new(bounds: &'b MotionBounds, may_reverse: bool) -> Self {
        Self { bounds, may_reverse, runs: Vec::new(), elapsed: 0.0, distance: 0.0 }
    }

    /// Advances to `elapsed` seconds since the state was known; the prediction moves as in `leg` in that time.
    pub(super) fn advance(&mut self, elapsed: f64, leg: &Leg) {
        if elapsed <= self.elapsed {
            return;
        }
        let run = Run { from: self.elapsed, to: elapsed, headings: leg.headings };
        self.elapsed = elapsed;
        self.distance += leg.distance;
        let joined = self.runs.last().map(|last| last.joined(&run)).filter(|j| j.headings.1 - j.headings.0 <= BAND);
        match (joined, self.runs.last_mut()) {
            (Some(joined), Some(last)) => *last = joined,
            _ => self.runs.push(run),
        }
        if self.runs.len() > MAX_RUNS {
            self.runs = self.runs.chunks(2).map(|pair| pair[0].joined(&pair[pair.len() - 1])).collect();
        }
    }

    /// A rectangle around the deviations at every time of the last leg.
    pub(super) fn reach(&self, leg: &Leg) -> Reach {
        let (longitudinal, lateral) = self.supports(leg.heading);
        let (sin, cos) = leg.heading.sin_cos();
        // upper bound of |δ|
        let farthest = 0.5 * self.elapsed * self.elapsed * self.bounds.longitudinal.hypot(self.bounds.lateral);
        let turned_in_leg = (leg.headings.1 - leg.headings.0).min(FRAC_PI_2);
        let in_lane = self.bounds.max_lateral_deviation + farthest * turned_in_leg.sin();
        let turned = self
            .runs
            .iter()
            .fold(0.0_f64, |turned, run| turned.max(run.headings.1 - leg.heading).max(leg.heading - run.headings.0));
        let without_reversing =
            if turned <= FRAC_PI_2 { self.distance + farthest * turned.sin() } else { f64::INFINITY };
        Reach {
            forward: Local::new(cos, sin),
            ahead: longitudinal,
            behind: if self.may_reverse { longitudinal } else { longitudinal.min(without_reversing) },
            lateral: lateral.min(in_lane),
        }
    }

    /// Upper bounds of h(n) and h(n + π/2).
    fn supports(&self, n: f64) -> (f64, f64) {
        let MotionBounds { longitudinal, lateral, .. } = *self.bounds;
        self.runs.iter().fold((0.0, 0.0), |sum, run| {
            let weight = (run.to - run.from) * (self.elapsed - 0.5 * (run.from + run.to));
            let (low, high) = (run.headings.0 - n, run.headings.1 - n);
            let (cos, sin) = (largest_cosine(low, high), largest_cosine(low - FRAC_PI_2, high - FRAC_PI_2));
            (
                sum.0 + weight * (longitudinal * cos + lateral * sin),
                sum.1 + weight * (longitudinal * sin + lateral * cos),
            )
        })
    }
}

/// The largest |cos| over an interval of angles.
fn largest_cosine(low: f64, high: f64) -> f64 {
    let holds_a_peak = (high / PI).floor() >= (low / PI).ceil();
    if holds_a_peak { 1.0 } else { low.cos().abs().max(high.cos().abs()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FREE: MotionBounds =
        MotionBounds { longitudinal: 2.0, lateral: 0.5, max_lateral_deviation: f64::INFINITY, vehicles_reverse: true };

    /// Legs of 0.1 s at a speed, with headings that follow a function of time.
    fn legs(heading: impl Fn(f64) -> f64, speed: f64, count: usize) -> Vec<Leg> {
        let leg = |i: usize| {
            let (from, end) = (0.1 * i as f64, 0.1 * (i + 1) as f64);
            let inside: Vec<f64> = (0..=10).map(|k| heading(from + 0.1 * (end - from) * f64::from(k))).collect();
            let headings = inside.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), h| (a.min(*h), b.max(*h)));
            Leg { end, headings, heading: heading(end), distance: 0.1 * speed }
        };
        (0..count).map(leg).collect()
    }

    fn spread<'b>(bounds: &'b MotionBounds, may_reverse: bool, legs: &[Leg]) -> Spread<'b> {
        let mut spread = Spread::new(bounds, may_reverse);
        legs.iter().for_each(|leg| spread.advance(leg.end, leg));
        spread
    }

    /// The integral of the module documentation, by many small steps.
    fn support(heading: impl Fn(f64) -> f64, tau: f64, n: f64) -> f64 {
        let steps = 20_000;
        let ds = tau / f64::from(steps);
        let term = |i: i32| {
            let s = (f64::from(i) + 0.5) * ds;
            let turned = heading(s) - n;
            (tau - s) * (FREE.longitudinal * turned.cos().abs() + FREE.lateral * turned.sin().abs()) * ds
        };
        (0..steps).map(term).sum()
    }

    #[test]
    fn straight_motion_deviates_by_half_the_acceleration_times_the_time_squared() {
        for yaw in [0.0, 0.3, FRAC_PI_2, 3.1, -2.0] {
            let legs = legs(|_| yaw, 10.0, 40);
            let reach = spread(&FREE, true, &legs).reach(&legs[39]);
            assert!((reach.ahead - 16.0).abs() < 1e-9 && (reach.lateral - 4.0).abs() < 1e-9, "{reach:?}");
            assert_eq!(reach.ahead, reach.behind);
            assert!((reach.forward - Local::new(yaw.cos(), yaw.sin())).length() < 1e-12);
        }
        let none = Spread::new(&FREE, true).reach(&legs(|_| 1.0, 10.0, 1)[0]);
        assert_eq!((none.ahead, none.behind, none.lateral), (0.0, 0.0, 0.0));
    }

    #[test]
    fn an_obstacle_that_does_not_reverse_stays_ahead_of_its_position() {
        let straight = |speed: f64, count: usize| {
            let legs = legs(|_| 0.4, speed, count);
            let reach = spread(&FREE, false, &legs).reach(&legs[count - 1]);
            (reach.ahead, reach.behind)
        };
        let (ahead, behind) = straight(3.0, 40);
        assert!((ahead - 16.0).abs() < 1e-9 && (behind - 12.0).abs() < 1e-9, "{behind}");
        let (ahead, behind) = straight(30.0, 40);
        assert_eq!(ahead, behind, "the deceleration is too small for a standstill");
        assert!(straight(0.0, 40).1 < 1e-9);
    }

    #[test]
    fn respects_the_largest_lateral_deviation() {
        let bounds = MotionBounds { max_lateral_deviation: 0.4, ..FREE };
        let straight = legs(|_| 0.4, 10.0, 40);
        assert_eq!(spread(&bounds, true, &straight).reach(&straight[39]).lateral, 0.4);
        assert!(
            (spread(&bounds, true, &straight[..5]).reach(&straight[4]).lateral - 0.0625).abs() < 1e-9,
            "the accelerations bound it first"
        );
    }

    #[test]
    fn the_largest_cosine_is_inside_or_at_the_ends() {
        for i in 0..200 {
            for width in [0.0, 0.01, 0.5, 2.0, 4.0] {
                let low = 0.1 * f64::from(i) - 10.0;
                let sampled = (0..=1000).map(|k| (low + width * f64::from(k) / 1000.0).cos().abs()).fold(0.0, f64::max);
                let found = largest_cosine(low, low + width);
                assert!(found >= sampled - 1e-12 && found < sampled + 1e-4, "{low} {width}: {found}, {sampled}");
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn supports_are_tight_upper_bounds_of_the_integral(
            yaw in -4.0..4.0f64, rate in -1.5..1.5f64, bend in -0.3..0.3f64, count in 1..60usize,
        ) {
            let heading = |t: f64| yaw + rate * t + bend * t * t;
            let legs = legs(heading, 8.0, count);
            let spread = spread(&FREE, true, &legs);
            let last = legs[count - 1];
            let (longitudinal, lateral) = spread.supports(last.heading);
            for (found, n) in [(longitudinal, last.heading), (lateral, last.heading + FRAC_PI_2)] {
                let integral = support(heading, last.end, n);
                // a leg of 0.1 s turns by up to 0.5 rad here
                let excess = 0.5 * last.end * last.end * FREE.longitudinal * (BAND + 0.1 * (rate.abs() + 2.0 * bend.abs() * last.end));
                prop_assert!(found >= integral - 1e-6, "{found} {integral}");
                prop_assert!(found <= integral + excess + 1e-6, "{found} {integral} {excess}");
            }
        }

        #[test]
        fn merged_runs_only_enlarge_the_set(noise in prop::collection::vec(-0.8..0.8f64, 150)) {
            let heading = |t: f64| noise[((t / 0.1 + 1e-6) as usize).min(149)];
            let legs = legs(heading, 5.0, 150);
            let spread = spread(&FREE, true, &legs);
            prop_assert!(spread.runs.len() <= MAX_RUNS);
            let (longitudinal, _) = spread.supports(0.0);
            prop_assert!(longitudinal >= support(|t| noise[((t / 0.1) as usize).min(149)], 15.0, 0.0) - 1e-3);
        }
    }
}
