//! The quadratic program of the smoothing: knots, rows and conversion of the solution to a profile.

use super::Settings;
use super::corridor::{Bound, Corridor};
use crate::convex::{QuadraticProgram, Term, Tuning};
use crate::speed::SpeedProblem;
use crate::trajectory::{SpeedKnot, SpeedProfile};

/// The inequality rows of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rows {
    /// Rows that the raw profile nearly activates. Most other rows are never active.
    Near,
    /// All rows.
    All,
}

/// The data shared by all programs of one smoothing.
pub(super) struct Program<'a> {
    problem: &'a SpeedProblem,
    speed_limits: &'a [f64],
    settings: &'a Settings,
    /// First knot: the end of the wait if the raw profile begins with one.
    start: SpeedKnot,
    /// Times of the knots since `start`, s.
    times: Vec<f64>,
    /// The raw profile at the knots.
    targets: Vec<SpeedKnot>,
    corridor: Corridor,
}

/// Duration of the part with the shortest steps, s. The planner replaces a plan before the vehicle drives beyond it.
const FINE_TIME: f64 = 3.0;
/// Ratio of consecutive steps after that part.
const GROWTH: f64 = 1.1;
/// Longest step, as a multiple of the first step.
const MAX_STEP_RATIO: f64 = 4.0;
/// Long profiles use longer steps, so that they have no more than this many long steps.
const MAX_LONG_STEPS: f64 = 100.0;

/// A speed limit is near if the raw speed is less than this below it, m/s.
const NEAR_SPEED_LIMIT: f64 = 2.0;
/// The bound against reversing is near if the raw speed is below this, m/s.
const NEAR_STANDSTILL: f64 = 3.0;

/// Quadratic (s²/m²) and linear (s/m) weight of the excess over a speed limit.
const EXCESS_WEIGHT: f64 = 100.0;
/// Factor on the station weight of the last knot: the final station matters more than the stations before it.
const END_EMPHASIS: f64 = 100.0;

impl<'a> Program<'a> {
    /// The program for a raw profile. `None` if the profile does not move.
    pub(super) fn new(
        problem: &'a SpeedProblem,
        speed_limits: &'a [f64],
        raw: &SpeedProfile,
        start_acceleration: f64,
        settings: &'a Settings,
    ) -> Option<Self> {
        let knots = raw.knots();
        let first = knots[0];
        let standing = knots.partition_point(|k| k.station <= first.station);
        let start = SpeedKnot { jerk: 0.0, ..if first.speed > 0.0 { first } else { knots[standing - 1] } };
        if first.speed <= 0.0 && standing == knots.len() {
            return None;
        }
        // A vehicle that waits has no acceleration. A vehicle that starts to move keeps its positive acceleration;
        // otherwise each replan during the start would begin at zero acceleration again.
        let starts_at_once = standing == 1;
        let acceleration = if first.speed > 0.0 {
            start_acceleration
        } else if starts_at_once {
            start_acceleration.max(0.0)
        } else {
            0.0
        };
        let times = knot_times(raw.duration() - start.time + settings.extra_time, settings.step);
        let targets = times.iter().map(|t| raw.at(start.time + t)).collect();
        let corridor = Corridor::new(problem, raw);
        Some(Self {
            problem,
            speed_limits,
            settings,
            start: SpeedKnot { acceleration, ..start },
            times,
            targets,
            corridor,
        })
    }

    /// Whether a row of [`Rows::Near`] is stricter than those of [`Rows::All`].
    pub(super) fn is_thinned(&self) -> bool {
        self.corridor.is_thinned()
    }

    /// The solution within a jerk limit (m/s³), with speed limits linearised about a profile. It is not proved.
    pub(super) fn solve(&self, linearised_about: &SpeedProfile, jerk: f64, rows: Rows) -> Option<SpeedProfile> {
        let mut qp = QuadraticProgram::new(3 * self.times.len());
        self.add_objective(&mut qp);
        self.add_dynamics(&mut qp, jerk);
        self.add_bounds(&mut qp, linearised_about, jerk, rows);
        self.add_corridor(&mut qp, rows);
        let quick = qp.solve_tuned(Tuning::Small);
        // without refinement, about one in several hundred feasible programs fails
        let solution = if quick.is_usable() { quick } else { qp.solve() };
        if !solution.is_usable() {
            return None;
        }
        self.profile(&solution.x)
    }

    /// Index of the last knot.
    fn last(&self) -> usize {
        self.times.len() - 1
    }

    /// Length of the step from knot `k`, s.
    fn step(&self, k: usize) -> f64 {
        self.times[k + 1] - self.times[k]
    }

    fn add_objective(&self, qp: &mut QuadraticProgram) {
        let weights = self.settings;
        for (k, target) in self.targets.iter().enumerate() {
            let is_last = k == self.last();
            // the weights refer to a step of the first length
            let share = if is_last { 1.0 } else { self.step(k) / weights.step };
            let emphasis = if is_last { END_EMPHASIS } else { 1.0 };
            qp.add_square(emphasis * share * weights.station_weight, &[(s(k), 1.0)], target.station);
            qp.add_square(share * weights.speed_weight, &[(v(k), 1.0)], target.speed);
            qp.add_square(share * weights.acceleration_weight, &[(a(k), 1.0)], 0.0);
            if !is_last {
                let h = self.step(k);
                qp.add_square(share * weights.jerk_weight, &[(a(k + 1), 1.0 / h), (a(k), -1.0 / h)], 0.0);
            }
        }
    }

    fn add_dynamics(&self, qp: &mut QuadraticProgram, jerk: f64) {
        qp.equal(&[(s(0), 1.0)], self.start.station);
        qp.equal(&[(v(0), 1.0)], self.start.speed);
        qp.equal(&[(a(0), 1.0)], self.start.acceleration);
        for k in 0..self.last() {
            let h = self.step(k);
            let (of_this, of_next) = (h * h / 3.0, h * h / 6.0);
            qp.equal(&[(s(k), 1.0), (v(k), h), (a(k), of_this), (a(k + 1), of_next), (s(k + 1), -1.0)], 0.0);
            qp.equal(&[(v(k), 1.0), (a(k), h / 2.0), (a(k + 1), h / 2.0), (v(k + 1), -1.0)], 0.0);
            qp.between(-jerk * h, &[(a(k + 1), 1.0), (a(k), -1.0)], jerk * h);
        }
        qp.equal(&[(v(self.last()), 1.0)], 0.0);
        qp.equal(&[(a(self.last()), 1.0)], 0.0);
    }

    fn add_bounds(&self, qp: &mut QuadraticProgram, linearised_about: &SpeedProfile, jerk: f64, rows: Rows) {
        let limits = &self.problem.limits;
        // no reversing in the first step
        qp.between(0.0, &[(v(0), 1.0), (a(0), 0.5 * self.step(0))], f64::INFINITY);
        let start = self.start.acceleration;
        for k in 1..self.last() {
            let target = &self.targets[k];
            let is_near = |distance: f64, near: f64| rows == Rows::All || distance < near;
            // the start acceleration may exceed the limits and decays with the jerk limit
            let allowance = (start.abs() - jerk * self.times[k]).max(0.0);
            let lowest = (-limits.aggressive_deceleration).min(if start < 0.0 { -allowance } else { 0.0 });
            let highest = limits.acceleration.max(if start > 0.0 { allowance } else { 0.0 });
            qp.between(lowest, &[(a(k), 1.0)], highest);
            if is_near(target.speed, NEAR_STANDSTILL) {
                // the speed in a step is quadratic in time; these are its Bernstein coefficients, the third is the next
                // knot's
                qp.between(0.0, &[(v(k), 1.0)], f64::INFINITY);
                qp.between(0.0, &[(v(k), 1.0), (a(k), 0.5 * self.step(k))], f64::INFINITY);
            }
            let at = |time: f64| linearised_about.at(self.start.time + time).station;
            let station = at(self.times[k]);
            let between = [k - 1, k + 1].map(|other| at(f64::midpoint(self.times[k], self.times[other])));
            let (limit, slope) = match lowest_between(self.problem, self.speed_limits, between) {
                Some(lowest) => (lowest, 0.0),
                None => linearised_speed_limit(self.problem, self.speed_limits, station),
            };
            if is_near(limit + slope * target.station - target.speed, NEAR_SPEED_LIMIT) {
                // soft, because a start acceleration may raise the speed above a limit; a proof follows
                let excess = qp.add_variable();
                qp.between(0.0, &[(excess, 1.0)], f64::INFINITY);
                qp.add_square(EXCESS_WEIGHT, &[(excess, 1.0)], 0.0);
                qp.add_linear(excess, EXCESS_WEIGHT);
                qp.between(f64::NEG_INFINITY, &[(v(k), 1.0), (s(k), -slope), (excess, -1.0)], limit);
            }
        }
    }

    fn add_corridor(&self, qp: &mut QuadraticProgram, rows: Rows) {
        let corridor = &self.corridor;
        let (upper, lower) = match rows {
            Rows::Near => (corridor.near_upper(), corridor.near_lower()),
            Rows::All => (corridor.upper(), corridor.lower()),
        };
        for Bound { time, station } in upper {
            // a bound at the start leaves no space for a margin
            let margin = if *station > self.start.station { corridor.margin() } else { 0.0 };
            qp.between(f64::NEG_INFINITY, &self.station_at(*time), station - margin);
        }
        for Bound { time, station } in lower.iter().filter(|b| b.time > self.start.time) {
            qp.between(station + corridor.margin(), &self.station_at(*time), f64::INFINITY);
        }
        qp.between(f64::NEG_INFINITY, &[(s(self.last()), 1.0)], self.problem.end());
    }

    /// The station at a time of the profile (s), as a linear expression in the variables.
    fn station_at(&self, time: f64) -> [Term; 4] {
        let time = (time - self.start.time).clamp(0.0, self.times[self.last()]);
        let k = self.times.partition_point(|t| *t <= time).clamp(1, self.last()) - 1;
        let (t, h) = (time - self.times[k], self.step(k));
        let of_next = t * t * t / (6.0 * h);
        [(s(k), 1.0), (v(k), t), (a(k), t * t / 2.0 - of_next), (a(k + 1), of_next)]
    }

    /// The profile of a solution. It integrates the jerks from the start state, so that it is consistent despite the
    /// solver's residuals, and ends at the first knot of the final standstill.
    fn profile(&self, x: &[f64]) -> Option<SpeedProfile> {
        let mut knots = Vec::with_capacity(self.times.len() + 1);
        if self.start.time > 0.0 {
            knots.push(SpeedKnot { time: 0.0, ..self.start });
        }
        let slow_from =
            (0..=self.last()).rev().take_while(|k| x[v(*k)] < SOLVED_STANDSTILL).last().unwrap_or(self.last());
        let mut knot = self.start;
        for k in 0..self.last() {
            if knot.speed < SOLVED_STANDSTILL && k >= slow_from {
                break;
            }
            knot.jerk = (x[a(k + 1)] - x[a(k)]) / self.step(k);
            knots.push(knot);
            knot = knot.after(self.step(k));
        }
        if knot.speed > SOLVED_STANDSTILL {
            return None;
        }
        knots.push(SpeedKnot { speed: 0.0, acceleration: 0.0, jerk: 0.0, ..knot });
        SpeedProfile::new(knots)
    }
}

/// Index of the station at knot `k`. The variables are in the order of the knots, so that the matrices are banded.
fn s(k: usize) -> usize {
    3 * k
}
/// Index of the speed at knot `k`.
fn v(k: usize) -> usize {
    3 * k + 1
}
/// Index of the acceleration at knot `k`.
fn a(k: usize) -> usize {
    3 * k + 2
}

/// Times of the knots of a profile of at least `duration` (s), with first steps of `step` (s).
fn knot_times(duration: f64, step: f64) -> Vec<f64> {
    let longest = (MAX_STEP_RATIO * step).max(duration / MAX_LONG_STEPS);
    let (mut time, mut h) = (0.0, step);
    let mut times = vec![time];
    while time < duration {
        if time > FINE_TIME {
            h = (h * GROWTH).min(longest);
        }
        time += h;
        times.push(time);
    }
    times
}

/// Minimum slope of a linearised speed limit, 1/s. The slope of a braking curve is unbounded at its end.
const MIN_SLOPE: f64 = -3.0;

/// The speed limit near a station (m) as a linear function of the station, `v ≤ c + c′ s`: a tangent where the limit
/// falls (a braking curve is concave, so the tangent lies closely above it), constant elsewhere. Returns `(c, c′)` in
/// m/s and 1/s.
fn linearised_speed_limit(problem: &SpeedProblem, speed_limits: &[f64], station: f64) -> (f64, f64) {
    let nodes = &problem.stations;
    let cells = problem.cells();
    if cells == 0 {
        return (0.0, 0.0);
    }
    let cell = nodes.partition_point(|&n| n <= station).clamp(1, cells) - 1;
    let slope = (speed_limits[cell + 1] - speed_limits[cell]) / (nodes[cell + 1] - nodes[cell]);
    let slope = slope.clamp(MIN_SLOPE, 0.0);
    let highest = speed_limits[cell].max(speed_limits[cell + 1] - slope * (nodes[cell + 1] - nodes[cell]));
    (highest - slope * nodes[cell], slope)
}

/// The lowest limit (m/s) inside an interval of stations (m) if it is lower than those at both ends: a short bend between two knots,
/// which no tangent at a knot sees.
fn lowest_between(problem: &SpeedProblem, speed_limits: &[f64], [from, to]: [f64; 2]) -> Option<f64> {
    /// Overlap of the intervals of two knots, m: at round speeds their common end is a node, and rounding must not decide whose it is.
    const OVERLAP: f64 = 0.02;
    /// Depth that counts, m/s: on a plateau, rounding must not decide whether there is a dip.
    const DEPTH: f64 = 0.05;
    let nodes = &problem.stations;
    let inside = nodes.partition_point(|n| *n < from - OVERLAP)..nodes.partition_point(|n| *n <= to + OVERLAP);
    let ends = [inside.start.checked_sub(1)?, inside.end].map(|i| speed_limits.get(i).copied());
    let lowest = speed_limits.get(inside)?.iter().copied().reduce(f64::min)?;
    (lowest + DEPTH < ends[0]?.min(ends[1]?)).then_some(lowest)
}

/// The vehicle stands if its speed at the end of a solution is below this, m/s. The tolerance of the solver is 1e-8.
const SOLVED_STANDSTILL: f64 = 2e-3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_bend_between_two_knots_is_seen_and_a_plateau_or_a_slope_is_none() {
        let mut problem = crate::speed::test_support::empty_road(20.0, 5.0);
        problem.speed_limits.fill(8.0);
        let seen = |limits: &[f64]| lowest_between(&problem, limits, [4.0, 7.0]);
        assert_eq!(seen(&problem.speed_limits), None);
        let with = |change: &dyn Fn(usize, f64) -> f64| -> Vec<f64> {
            problem.stations.iter().enumerate().map(|(i, s)| change(i, *s)).collect()
        };
        let dip = with(&|_, s| if (5.4..5.6).contains(&s) { 3.0 } else { 8.0 });
        assert_eq!(seen(&dip), Some(3.0));
        assert_eq!(seen(&with(&|_, s| 8.0 - 0.1 * s)), None, "a slope has a tangent");
        assert_eq!(seen(&with(&|i, _| 8.0 - 1e-9 * (i % 2) as f64)), None, "rounding");
        assert_eq!(seen(&with(&|_, s| if (9.4..9.6).contains(&s) { 3.0 } else { 8.0 })), None, "beyond");
    }

    #[test]
    fn knots_are_dense_at_first_and_few_for_any_duration() {
        for duration in [0.1, 2.0, 7.3, 30.0, 300.0, 3000.0] {
            let times = knot_times(duration, 0.2);
            assert!(*times.last().unwrap() >= duration && times.len() < 170, "{duration}: {}", times.len());
            let fine = times.windows(2).take_while(|w| w[0] < FINE_TIME);
            assert!(fine.into_iter().all(|w| (w[1] - w[0] - 0.2).abs() < 1e-9));
            assert!(times.windows(3).all(|w| w[2] - w[1] <= GROWTH * (w[1] - w[0]) + 1e-9));
        }
    }
}
