//! The quadratic program of the smoothing: its knots, its rows, and the profile of its solution.

use super::Settings;
use super::corridor::{Bound, Corridor};
use crate::convex::{QuadraticProgram, Term, Tuning};
use crate::speed::SpeedProblem;
use crate::trajectory::{SpeedKnot, SpeedProfile};

/// Which rows a program has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rows {
    /// Those that the searched plan comes near to: most others never bite.
    Near,
    /// All.
    All,
}

/// What does not change from solution to solution.
pub(super) struct Program<'a> {
    problem: &'a SpeedProblem,
    speed_limits: &'a [f64],
    settings: &'a Settings,
    /// Where it starts: at the end of a wait, if the searched plan begins with one.
    start: SpeedKnot,
    /// Times of the knots since `start`, s.
    times: Vec<f64>,
    /// The searched plan at the knots.
    wanted: Vec<SpeedKnot>,
    corridor: Corridor,
}

/// First steps are short for so long, s: what is driven before the next plans.
const FINE_TIME: f64 = 3.0;
/// Factor from step to step after that.
const GROWTH: f64 = 1.1;
/// Longest step, in first steps,
const LONGEST_STEP: f64 = 4.0;
/// unless the plan is so long that it would take more of those than this.
const MOST_LONG_STEPS: f64 = 100.0;

/// Speed below a cap within which its row is near, m/s.
const NEAR_CAP: f64 = 2.0;
/// Speed below which the row against driving backwards is near, m/s.
const NEAR_REST: f64 = 3.0;

/// Weight of a speed over its cap, in s²/m² and s/m.
const OVER_CAP_WEIGHT: f64 = 100.0;
/// Factor on the station weight of the last knot: where the plan ends matters more than how it gets there.
const END_EMPHASIS: f64 = 100.0;

impl<'a> Program<'a> {
    /// The program for a searched plan; `None` if the plan goes nowhere.
    pub(super) fn new(
        problem: &'a SpeedProblem,
        speed_limits: &'a [f64],
        searched: &SpeedProfile,
        start_acceleration: f64,
        settings: &'a Settings,
    ) -> Option<Self> {
        let knots = searched.knots();
        let first = knots[0];
        let standing = knots.partition_point(|k| k.station <= first.station);
        let start = SpeedKnot { jerk: 0.0, ..if first.speed > 0.0 { first } else { knots[standing - 1] } };
        if first.speed <= 0.0 && standing == knots.len() {
            return None;
        }
        // Who stands and waits has no acceleration left. Who drives off keeps what it has, or a plan made anew before it
        // has come to move would begin from nothing every time.
        let drives_off = standing == 1;
        let acceleration = if first.speed > 0.0 {
            start_acceleration
        } else if drives_off {
            start_acceleration.max(0.0)
        } else {
            0.0
        };
        let times = knot_times(searched.duration() - start.time + settings.extra_time, settings.step);
        let wanted = times.iter().map(|t| searched.at(start.time + t)).collect();
        let corridor = Corridor::new(problem, searched);
        Some(Self {
            problem,
            speed_limits,
            settings,
            start: SpeedKnot { acceleration, ..start },
            times,
            wanted,
            corridor,
        })
    }

    /// Whether some rows of [`Rows::Near`] are stricter than those of [`Rows::All`].
    pub(super) fn is_thinned(&self) -> bool {
        self.corridor.is_thinned()
    }

    /// The solution within a jerk (m/s³), with speed_limits read along `along`. It is not proven.
    pub(super) fn solve(&self, along: &SpeedProfile, jerk: f64, rows: Rows) -> Option<SpeedProfile> {
        let mut qp = QuadraticProgram::new(3 * self.times.len());
        self.add_objective(&mut qp);
        self.add_dynamics(&mut qp, jerk);
        self.add_bounds(&mut qp, along, jerk, rows);
        self.add_corridor(&mut qp, rows);
        let quick = qp.solve_tuned(Tuning::Small);
        // without refinement one program in some hundreds fails that has a solution
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
        for (k, wanted) in self.wanted.iter().enumerate() {
            let is_last = k == self.last();
            // weights are those of a first step
            let share = if is_last { 1.0 } else { self.step(k) / weights.step };
            let emphasis = if is_last { END_EMPHASIS } else { 1.0 };
            qp.add_square(emphasis * share * weights.station_weight, &[(s(k), 1.0)], wanted.station);
            qp.add_square(share * weights.speed_weight, &[(v(k), 1.0)], wanted.speed);
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

    fn add_bounds(&self, qp: &mut QuadraticProgram, along: &SpeedProfile, jerk: f64, rows: Rows) {
        let limits = &self.problem.limits;
        // the first step's, which is that of a start at rest as well
        qp.between(0.0, &[(v(0), 1.0), (a(0), 0.5 * self.step(0))], f64::INFINITY);
        let start = self.start.acceleration;
        for k in 1..self.last() {
            let wanted = &self.wanted[k];
            let is_near = |distance: f64, near: f64| rows == Rows::All || distance < near;
            // the acceleration that the cycle starts with may lie outside and decays at the jerk limit
            let allowance = (start.abs() - jerk * self.times[k]).max(0.0);
            let lowest = (-limits.aggressive_deceleration).min(if start < 0.0 { -allowance } else { 0.0 });
            let highest = limits.acceleration.max(if start > 0.0 { allowance } else { 0.0 });
            qp.between(lowest, &[(a(k), 1.0)], highest);
            if is_near(wanted.speed, NEAR_REST) {
                // the speed over the step is a quadratic whose Bernstein coefficients are these two and the next knot's
                qp.between(0.0, &[(v(k), 1.0)], f64::INFINITY);
                qp.between(0.0, &[(v(k), 1.0), (a(k), 0.5 * self.step(k))], f64::INFINITY);
            }
            let station = along.at(self.start.time + self.times[k]).station;
            let (cap, slope) = cap_line(self.problem, self.speed_limits, station);
            if is_near(cap + slope * wanted.station - wanted.speed, NEAR_CAP) {
                // speed_limits are soft: a start acceleration may carry the speed over one, and a proof follows anyway
                let over = qp.add_variable();
                qp.between(0.0, &[(over, 1.0)], f64::INFINITY);
                qp.add_square(OVER_CAP_WEIGHT, &[(over, 1.0)], 0.0);
                qp.add_linear(over, OVER_CAP_WEIGHT);
                qp.between(f64::NEG_INFINITY, &[(v(k), 1.0), (s(k), -slope), (over, -1.0)], cap);
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
            // at the place itself already: no room for a margin
            let margin = if *station > self.start.station { corridor.margin() } else { 0.0 };
            qp.between(f64::NEG_INFINITY, &self.station_at(*time), station - margin);
        }
        for Bound { time, station } in lower.iter().filter(|b| b.time > self.start.time) {
            qp.between(station + corridor.margin(), &self.station_at(*time), f64::INFINITY);
        }
        qp.between(f64::NEG_INFINITY, &[(s(self.last()), 1.0)], self.problem.end());
    }

    /// The station at a time of the profile, as terms in the variables.
    fn station_at(&self, time: f64) -> [Term; 4] {
        let time = (time - self.start.time).clamp(0.0, self.times[self.last()]);
        let k = self.times.partition_point(|t| *t <= time).clamp(1, self.last()) - 1;
        let (t, h) = (time - self.times[k], self.step(k));
        let of_next = t * t * t / (6.0 * h);
        [(s(k), 1.0), (v(k), t), (a(k), t * t / 2.0 - of_next), (a(k + 1), of_next)]
    }

    /// Integrates the jerks again from the start state, so that the profile is exact whatever the solver's residuals, and
    /// ends it where the speed first vanishes.
    fn profile(&self, x: &[f64]) -> Option<SpeedProfile> {
        let mut knots = Vec::with_capacity(self.times.len() + 1);
        if self.start.time > 0.0 {
            knots.push(SpeedKnot { time: 0.0, ..self.start });
        }
        let slow_from =
            (0..=self.last()).rev().take_while(|k| x[v(*k)] < STANDSTILL_SPEED).last().unwrap_or(self.last());
        let mut knot = self.start;
        for k in 0..self.last() {
            if knot.speed < STANDSTILL_SPEED && k >= slow_from {
                break;
            }
            knot.jerk = (x[a(k + 1)] - x[a(k)]) / self.step(k);
            knots.push(knot);
            knot = knot.after(self.step(k));
        }
        if knot.speed > STANDSTILL_SPEED {
            return None;
        }
        knots.push(SpeedKnot { speed: 0.0, acceleration: 0.0, jerk: 0.0, ..knot });
        SpeedProfile::new(knots)
    }
}

/// Variables stand knot by knot, so that the matrices are banded.
fn s(k: usize) -> usize {
    3 * k
}
fn v(k: usize) -> usize {
    3 * k + 1
}
fn a(k: usize) -> usize {
    3 * k + 2
}

/// Times of the knots of a profile that lasts for `duration` at least.
fn knot_times(duration: f64, step: f64) -> Vec<f64> {
    let longest = (LONGEST_STEP * step).max(duration / MOST_LONG_STEPS);
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

/// Steepest fall of a cap that is followed, 1/s. The braking curve's slope grows without bound towards its end.
const STEEPEST_CAP: f64 = -3.0;

/// The cap near `station` as a line in the station, `v ≤ c + c′ s`: the tangent where speed_limits fall (a braking curve is
/// concave, so its tangent is close above it), the cap itself elsewhere. Returns `(c, c′)`.
fn cap_line(problem: &SpeedProblem, speed_limits: &[f64], station: f64) -> (f64, f64) {
    let nodes = &problem.stations;
    let cells = problem.cells();
    if cells == 0 {
        return (0.0, 0.0);
    }
    let cell = nodes.partition_point(|&n| n <= station).clamp(1, cells) - 1;
    let slope = (speed_limits[cell + 1] - speed_limits[cell]) / (nodes[cell + 1] - nodes[cell]);
    let slope = slope.clamp(STEEPEST_CAP, 0.0);
    let highest = speed_limits[cell].max(speed_limits[cell + 1] - slope * (nodes[cell + 1] - nodes[cell]));
    (highest - slope * nodes[cell], slope)
}

/// Speeds below this at the end of the solution are rest (m/s): the program's own tolerance is 1e-8.
const STANDSTILL_SPEED: f64 = 2e-3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knots_are_fine_at_first_and_few_however_long_the_plan() {
        for duration in [0.1, 2.0, 7.3, 30.0, 300.0, 3000.0] {
            let times = knot_times(duration, 0.2);
            assert!(*times.last().unwrap() >= duration && times.len() < 170, "{duration}: {}", times.len());
            let fine = times.windows(2).take_while(|w| w[0] < FINE_TIME);
            assert!(fine.into_iter().all(|w| (w[1] - w[0] - 0.2).abs() < 1e-9));
            assert!(times.windows(3).all(|w| w[2] - w[1] <= GROWTH * (w[1] - w[0]) + 1e-9));
        }
    }
}
