//! How far a moving obstacle may come away from its prediction.
//!
//! # The set
//! What is known is the obstacle's state now; its future is only predicted. With the predicted position p̂ and heading ψ
//! a motion p = p̂ + δ belongs to the set when its acceleration differs from the predicted one by what is within the
//! [`MotionBounds`], taken along and across the predicted heading:
//!
//! ```text
//! δ″(s) ∈ R(ψ(s)) · [−longitudinal, along] × [−across, across],   δ(0) = δ′(0) = 0,   s counted from now
//! ```
//!
//! Where they are asked for, two more bounds make the set smaller: a deviation of `max_lateral_deviation` at most, across the
//! heading of the moment (who keeps its lane), and velocities that never point backwards (who does not reverse:
//! vehicles and bicycles, not pedestrians). They only take motions away; the prediction itself always stays.
//!
//! # Technique
//! δ(τ) = ∫₀^τ (τ − s) δ″(s) ds, so that the set of all δ(τ) is convex and symmetric, with the support function
//!
//! ```text
//! h(n) = ∫₀^τ (τ − s) ( longitudinal · |cos(ψ(s) − n)| + lateral · |sin(ψ(s) − n)| ) ds
//! ```
//!
//! in the direction n: an integral of sets (Aumann) has the integral of their support functions. h grows with τ in every
//! direction, so the set at a time holds those of all times before, and the set at the end of a slice of time is enough
//! for the whole slice. The rectangle in the heading at that time with the half sides h(ψ) and h(ψ + π/2) holds it; on a
//! straight way it is the set. What the obstacle covers is then covered by the Minkowski sum of what the prediction
//! covers and that rectangle (`Convex::spread`).
//!
//! The integral is taken exactly over runs of time in which the heading stays within a narrow band, with the largest
//! |cos| and |sin| of the band: never below h, equal to it where the heading does not change.
//!
//! Not reversing means (p̂′ + δ′)·e(ψ) ≥ 0 at every moment, or the prediction's own velocity where that is backward: so
//! δ′·e(ψ) ≥ −|p̂′|. Along the last heading, which no heading before differed from by more than θ ≤ π/2, this gives
//! δ(τ) ≥ −L − sin θ · ∫|δ′|, with the predicted way L and |δ′(s)| ≤ s · √(longitudinal² + lateral²).
//!
//! # Weakness
//! The body keeps the predicted heading; that a vehicle drifting sideways has turned is not in the set. The rectangle is
//! larger than the set after a bend. Prediction sets of the file are sets already and do not grow. An obstacle leaves
//! the map when its prediction ends, however late it may be.

use std::f64::consts::{FRAC_PI_2, PI};

use super::convert::Local;

/// Bounds on motions around a prediction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionBounds {
    /// Acceleration along the predicted heading beyond the predicted one, either way, m/s².
    pub longitudinal: f64,
    /// Acceleration across the predicted heading beyond the predicted one, either way, m/s².
    pub lateral: f64,
    /// Largest deviation across the predicted heading, m; infinite if only the accelerations bound it.
    pub max_lateral_deviation: f64,
    /// Whether vehicles and bicycles may move backwards.
    pub vehicles_reverse: bool,
}

impl MotionBounds {
    /// Whether nothing but the prediction itself is within the bounds.
    #[must_use]
    pub fn hold_nothing_more(&self) -> bool {
        self.longitudinal == 0.0 && self.lateral == 0.0
    }
}

/// Headings that differ by less share a run, rad: the rectangle is wider by 5 % of `longitudinal` at most.
const BAND: f64 = 0.05;
/// Runs kept at most; then neighbours are merged two by two.
const MOST_RUNS: usize = 64;

/// The predicted motion during one slice of time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leg {
    /// When it ends, s.
    pub(super) end: f64,
    /// Least and largest heading, rad; not wrapped, over all legs of a prediction.
    pub(super) headings: (f64, f64),
    /// Heading at the end, rad.
    pub(super) heading: f64,
    /// Way, m.
    pub(super) way: f64,
}

/// A rectangle around all deviations, m. It always holds the point without deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach {
    /// Unit vector along the heading.
    pub(super) forward: Local,
    pub(super) ahead: f64,
    pub(super) behind: f64,
    /// To either side.
    pub(super) lateral: f64,
}

/// The set of deviations from a prediction, as time goes on.
#[derive(Debug)]
pub(super) struct Spread<'b> {
    bounds: &'b MotionBounds,
    may_reverse: bool,
    runs: Vec<Run>,
    /// Time since the state was known, s.
    elapsed: f64,
    /// Predicted way since then, m.
    way: f64,
}

/// A time in which the heading stays within a band.
#[derive(Debug, Clone, Copy)]
struct Run {
    from: f64,
    to: f64,
    headings: (f64, f64),
}

impl Run {
    /// The run that holds both.
    fn joined(&self, later: &Self) -> Self {
        let headings = (self.headings.0.min(later.headings.0), self.headings.1.max(later.headings.1));
        Self { from: self.from, to: later.to, headings }
    }
}

impl<'b> Spread<'b> {
    /// No time has passed yet: no deviation.
    pub(super) fn new(bounds: &'b MotionBounds, may_reverse: bool) -> Self {
        Self { bounds, may_reverse, runs: Vec::new(), elapsed: 0.0, way: 0.0 }
    }

    /// Lets time go on to `elapsed` seconds since the state was known, during which the prediction moves as in `leg`.
    pub(super) fn advance(&mut self, elapsed: f64, leg: &Leg) {
        if elapsed <= self.elapsed {
            return;
        }
        let run = Run { from: self.elapsed, to: elapsed, headings: leg.headings };
        self.elapsed = elapsed;
        self.way += leg.way;
        let joined = self.runs.last().map(|last| last.joined(&run)).filter(|j| j.headings.1 - j.headings.0 <= BAND);
        match (joined, self.runs.last_mut()) {
            (Some(joined), Some(last)) => *last = joined,
            _ => self.runs.push(run),
        }
        if self.runs.len() > MOST_RUNS {
            self.runs = self.runs.chunks(2).map(|pair| pair[0].joined(&pair[pair.len() - 1])).collect();
        }
    }

    /// Around the deviations at every moment of the leg that was advanced by last.
    pub(super) fn reach(&self, leg: &Leg) -> Reach {
        let (longitudinal, lateral) = self.supports(leg.heading);
        let (sin, cos) = leg.heading.sin_cos();
        // |δ| at most
        let farthest = 0.5 * self.elapsed * self.elapsed * self.bounds.longitudinal.hypot(self.bounds.lateral);
        let turned_in_leg = (leg.headings.1 - leg.headings.0).min(FRAC_PI_2);
        let kept_in_lane = self.bounds.max_lateral_deviation + farthest * turned_in_leg.sin();
        let turned = self
            .runs
            .iter()
            .fold(0.0_f64, |turned, run| turned.max(run.headings.1 - leg.heading).max(leg.heading - run.headings.0));
        let without_reversing = if turned <= FRAC_PI_2 { self.way + farthest * turned.sin() } else { f64::INFINITY };
        Reach {
            forward: Local::new(cos, sin),
            ahead: longitudinal,
            behind: if self.may_reverse { longitudinal } else { longitudinal.min(without_reversing) },
            lateral: lateral.min(kept_in_lane),
        }
    }

    /// h(n) and h(n + π/2), or a little more.
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
            Leg { end, headings, heading: heading(end), way: 0.1 * speed }
        };
        (0..count).map(leg).collect()
    }

    fn spread<'b>(bounds: &'b MotionBounds, may_reverse: bool, legs: &[Leg]) -> Spread<'b> {
        let mut spread = Spread::new(bounds, may_reverse);
        legs.iter().for_each(|leg| spread.advance(leg.end, leg));
        spread
    }

    /// The integral of the module's docs by many small steps.
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
    fn straight_on_it_is_half_the_acceleration_times_the_time_squared() {
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
    fn who_does_not_reverse_stays_ahead_of_where_it_is() {
        let straight = |speed: f64, count: usize| {
            let legs = legs(|_| 0.4, speed, count);
            let reach = spread(&FREE, false, &legs).reach(&legs[count - 1]);
            (reach.ahead, reach.behind)
        };
        let (ahead, behind) = straight(3.0, 40);
        assert!((ahead - 16.0).abs() < 1e-9 && (behind - 12.0).abs() < 1e-9, "{behind}");
        let (ahead, behind) = straight(30.0, 40);
        assert_eq!(ahead, behind, "the acceleration does not suffice to stand still");
        assert!(straight(0.0, 40).1 < 1e-9);
    }

    #[test]
    fn lanes_are_kept_where_that_is_asked_for() {
        let bounds = MotionBounds { max_lateral_deviation: 0.4, ..FREE };
        let ways = legs(|_| 0.4, 10.0, 40);
        assert_eq!(spread(&bounds, true, &ways).reach(&ways[39]).lateral, 0.4);
        assert!((spread(&bounds, true, &ways[..5]).reach(&ways[4]).lateral - 0.0625).abs() < 1e-9, "not yet that far");
    }

    #[test]
    fn the_largest_cosine_is_found_inside_and_at_the_ends() {
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
        fn supports_are_never_below_the_integral_and_little_above(
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
        fn merged_runs_only_make_it_larger(noise in prop::collection::vec(-0.8..0.8f64, 150)) {
            let heading = |t: f64| noise[((t / 0.1 + 1e-6) as usize).min(149)];
            let legs = legs(heading, 5.0, 150);
            let spread = spread(&FREE, true, &legs);
            prop_assert!(spread.runs.len() <= MOST_RUNS);
            let (longitudinal, _) = spread.supports(0.0);
            prop_assert!(longitudinal >= support(|t| noise[((t / 0.1) as usize).min(149)], 15.0, 0.0) - 1e-3);
        }
    }
}
