//! Jerk-limited smoothing of a searched plan, as a quadratic program in time.
//!
//! Time is cut into equal steps of `h`; the jerk is constant in each. Variables are station `s_k`, speed `v_k`,
//! acceleration `a_k` at the knots and jerk `j_k` in the steps:
//!
//! ```text
//! minimise    Σ w_s (s_k − ŝ_k)² + w_v (v_k − v̂_k)² + w_a a_k² + w_j j_k²
//! subject to  s_{k+1} = s_k + h v_k + h²/2 a_k + h³/6 j_k       (and so for v, a)
//!             s_0, v_0, a_0 given;  v_N = a_N = 0
//!             lower_k ≤ s_k ≤ upper_k;  0 ≤ v_k ≤ cap_k;  −d ≤ a_k ≤ a;  |j_k| ≤ j_max
//! ```
//!
//! `ŝ, v̂` is the searched plan, and the station bounds are the free corridor around it at that time. Caps are tangents
//! at the searched station, which is an approximation: the caller **proves the result again** ([`super::prove`]) and keeps
//! the unsmoothed plan when that fails.

use super::{SpeedPlan, SpeedProblem, prove};
use crate::convex::QuadraticProgram;
use crate::trajectory::{SpeedKnot, SpeedProfile};

/// Weights and limits of the smoothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Largest jerk, m/s³.
    pub jerk: f64,
    /// Length of a time step, s.
    pub step: f64,
    /// Time added after the searched plan's end, so that a gentler one fits, s.
    pub extra_time: f64,
    /// Weight of the station error, 1/m².
    pub station_weight: f64,
    /// Weight of the speed error, s²/m².
    pub speed_weight: f64,
    /// Weight of the acceleration, s⁴/m².
    pub acceleration_weight: f64,
    /// Weight of the jerk, s⁶/m².
    pub jerk_weight: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            jerk: 2.0,
            step: 0.2,
            extra_time: 2.0,
            station_weight: 0.2,
            speed_weight: 1.0,
            acceleration_weight: 0.1,
            jerk_weight: 0.3,
        }
    }
}

/// The searched plan as it stands: constant acceleration between its states.
#[must_use]
pub fn unsmoothed(problem: &SpeedProblem, plan: &SpeedPlan) -> Option<SpeedProfile> {
    let knots = plan.states.iter().enumerate().map(|(i, state)| {
        let acceleration =
            plan.states.get(i + 1).map_or(0.0, |next| (next.speed - state.speed) / (next.time - state.time));
        SpeedKnot {
            time: state.time - problem.start_time,
            station: problem.stations[state.node],
            speed: state.speed,
            acceleration,
            jerk: 0.0,
        }
    });
    SpeedProfile::new(knots.collect())
}

/// The smoothed profile, starting with `start_acceleration`, if one can be proved for `problem`. It is guided by
/// `guide_caps`, which may keep a reserve to the problem's own. Caps and corridor are first read along
/// the searched plan, then along the solution before: a sequential convex program of a few steps.
#[must_use]
pub fn smooth_and_prove(
    problem: &SpeedProblem,
    guide_caps: &[f64],
    searched: &SpeedProfile,
    start_acceleration: f64,
    settings: &Settings,
) -> Option<SpeedProfile> {
    /// A third solution rarely passes where the second did not.
    const SOLUTIONS: usize = 3;
    let mut along = searched.clone();
    for _ in 0..SOLUTIONS {
        let solution = smooth(problem, guide_caps, searched, &along, start_acceleration, settings)?;
        if prove(problem, &solution).is_ok() {
            return Some(solution);
        }
        along = solution;
    }
    None
}

/// The smoothed profile near `searched`, starting with `start_acceleration`, with caps and corridor read along `along`;
/// `None` if the program has no solution. The result is not proven: see the module's text.
#[must_use]
pub fn smooth(
    problem: &SpeedProblem,
    guide_caps: &[f64],
    searched: &SpeedProfile,
    along: &SpeedProfile,
    start_acceleration: f64,
    settings: &Settings,
) -> Option<SpeedProfile> {
    let h = settings.step;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a positive count of steps
    let n = ((searched.duration() + settings.extra_time) / h).ceil() as usize;
    if n > MOST_STEPS {
        return None;
    }
    let layout = Layout { n };
    let mut qp = QuadraticProgram::new(layout.variables());
    add_objective(&mut qp, &layout, searched, settings);
    add_dynamics(&mut qp, &layout, searched, start_acceleration, h);
    add_bounds(&mut qp, &layout, problem, guide_caps, along, start_acceleration, settings);
    let solution = qp.solve();
    if !solution.is_usable() {
        return None;
    }
    profile_of(&layout, &solution.x, searched, start_acceleration, h)
}

/// Plans of more steps than this (40 s of the default step) wait for something far off and will be planned again long
/// before they are driven: not worth a large program.
const MOST_STEPS: usize = 200;

/// Weight of a speed over its cap, in s²/m² and s/m.
const OVER_CAP_WEIGHT: f64 = 100.0;

/// Factor on the station weight of the last knot.
const END_EMPHASIS: f64 = 100.0;

/// Where the variables stand: knot by knot `s, v, a, j`, so that the matrices are banded.
struct Layout {
    /// Number of steps; knots are 0…n.
    n: usize,
}

impl Layout {
    fn variables(&self) -> usize {
        4 * (self.n + 1)
    }
    fn s(&self, k: usize) -> usize {
        4 * k
    }
    fn v(&self, k: usize) -> usize {
        4 * k + 1
    }
    fn a(&self, k: usize) -> usize {
        4 * k + 2
    }
    fn j(&self, k: usize) -> usize {
        4 * k + 3
    }
}

fn add_objective(qp: &mut QuadraticProgram, layout: &Layout, searched: &SpeedProfile, settings: &Settings) {
    for k in 0..=layout.n {
        let wanted = searched.at(k as f64 * settings.step);
        // where the plan ends matters more than how it gets there
        let station_weight = if k == layout.n { END_EMPHASIS } else { 1.0 } * settings.station_weight;
        qp.add_square(station_weight, &[(layout.s(k), 1.0)], wanted.station);
        qp.add_square(settings.speed_weight, &[(layout.v(k), 1.0)], wanted.speed);
        qp.add_square(settings.acceleration_weight, &[(layout.a(k), 1.0)], 0.0);
        qp.add_square(settings.jerk_weight, &[(layout.j(k), 1.0)], 0.0);
    }
}

fn add_dynamics(qp: &mut QuadraticProgram, layout: &Layout, searched: &SpeedProfile, start_acceleration: f64, h: f64) {
    let start = searched.knots()[0];
    qp.equal(&[(layout.s(0), 1.0)], start.station);
    qp.equal(&[(layout.v(0), 1.0)], start.speed);
    qp.equal(&[(layout.a(0), 1.0)], start_acceleration);
    for k in 0..layout.n {
        let (s, v, a, j) = (layout.s(k), layout.v(k), layout.a(k), layout.j(k));
        qp.equal(&[(s, 1.0), (v, h), (a, h * h / 2.0), (j, h * h * h / 6.0), (layout.s(k + 1), -1.0)], 0.0);
        qp.equal(&[(v, 1.0), (a, h), (j, h * h / 2.0), (layout.v(k + 1), -1.0)], 0.0);
        qp.equal(&[(a, 1.0), (j, h), (layout.a(k + 1), -1.0)], 0.0);
    }
    qp.equal(&[(layout.v(layout.n), 1.0)], 0.0);
    qp.equal(&[(layout.a(layout.n), 1.0)], 0.0);
    qp.equal(&[(layout.j(layout.n), 1.0)], 0.0);
}

fn add_bounds(
    qp: &mut QuadraticProgram,
    layout: &Layout,
    problem: &SpeedProblem,
    caps: &[f64],
    along: &SpeedProfile,
    start_acceleration: f64,
    settings: &Settings,
) {
    let limits = &problem.limits;
    for k in 0..layout.n {
        qp.between(-settings.jerk, &[(layout.j(k), 1.0)], settings.jerk);
    }
    for k in 1..=layout.n {
        let t = k as f64 * settings.step;
        let station = along.at(t).station;
        let (lower, upper) = corridor(problem, station, problem.start_time + t, settings.step);
        qp.between(lower, &[(layout.s(k), 1.0)], upper);
        let (cap, slope) = cap_line(problem, caps, station);
        qp.between(0.0, &[(layout.v(k), 1.0)], f64::INFINITY);
        // caps are soft: a start acceleration may carry the speed over one, and a proof follows anyway
        let over = qp.add_variable();
        qp.between(0.0, &[(over, 1.0)], f64::INFINITY);
        qp.add_square(OVER_CAP_WEIGHT, &[(over, 1.0)], 0.0);
        qp.add_linear(over, OVER_CAP_WEIGHT);
        qp.between(f64::NEG_INFINITY, &[(layout.v(k), 1.0), (layout.s(k), -slope), (over, -1.0)], cap);
        // the acceleration that the cycle starts with may lie outside and decays at the jerk limit
        let allowance = (start_acceleration.abs() - settings.jerk * t).max(0.0);
        let lowest = (-limits.aggressive_deceleration).min(if start_acceleration < 0.0 { -allowance } else { 0.0 });
        let highest = limits.acceleration.max(if start_acceleration > 0.0 { allowance } else { 0.0 });
        qp.between(lowest, &[(layout.a(k), 1.0)], highest);
    }
}

/// The free stations around `station` within half a step of `time`: up to the next blocked cell ahead, down to the one
/// behind.
fn corridor(problem: &SpeedProblem, station: f64, time: f64, step: f64) -> (f64, f64) {
    let nodes = &problem.stations;
    let cells = problem.cells();
    if cells == 0 {
        return (nodes[0], nodes[0]);
    }
    let here = nodes.partition_point(|&s| s <= station).clamp(1, cells) - 1;
    let blocked = |i: usize| problem.is_blocked(i, time - 0.5 * step, time + 0.5 * step);
    let upper = (here..cells).find(|&i| blocked(i) && nodes[i] >= station).map_or(problem.end(), |i| nodes[i]);
    let lower = (0..here).rev().find(|&i| blocked(i)).map_or(nodes[0], |i| nodes[i + 1]);
    (lower.min(station), upper.max(station))
}

/// Steepest fall of a cap that is followed, 1/s. The braking curve's slope grows without bound towards its end.
const STEEPEST_CAP: f64 = -3.0;

/// The cap near `station` as a line in the station, `v ≤ c + c′ s`: the tangent where caps fall (a braking curve is
/// concave, so its tangent is close above it), the cap itself elsewhere. Returns `(c, c′)`.
fn cap_line(problem: &SpeedProblem, caps: &[f64], station: f64) -> (f64, f64) {
    let nodes = &problem.stations;
    let cells = problem.cells();
    if cells == 0 {
        return (0.0, 0.0);
    }
    let cell = nodes.partition_point(|&n| n <= station).clamp(1, cells) - 1;
    let slope = (caps[cell + 1] - caps[cell]) / (nodes[cell + 1] - nodes[cell]);
    let slope = slope.clamp(STEEPEST_CAP, 0.0);
    let highest = caps[cell].max(caps[cell + 1] - slope * (nodes[cell + 1] - nodes[cell]));
    (highest - slope * nodes[cell], slope)
}

/// Speeds below this at the end of the solution are rest (m/s): the program's own tolerance is 1e-8.
const AT_REST: f64 = 2e-3;

/// Integrates the jerks again from the start state, so that the profile is exact whatever the solver's residuals, and
/// ends it where the speed first vanishes.
fn profile_of(
    layout: &Layout,
    x: &[f64],
    searched: &SpeedProfile,
    start_acceleration: f64,
    h: f64,
) -> Option<SpeedProfile> {
    let start = searched.knots()[0];
    let mut knots = Vec::with_capacity(layout.n + 1);
    let mut knot = SpeedKnot { time: 0.0, acceleration: start_acceleration, jerk: x[layout.j(0)], ..start };
    for k in 0..layout.n {
        knot.jerk = x[layout.j(k)];
        knots.push(knot);
        let end_of_speed = x[layout.v(k + 1)..].iter().step_by(4).all(|v| *v < AT_REST);
        if knot.speed < AT_REST && end_of_speed {
            break;
        }
        knot = knot.after(h);
    }
    if knot.time > knots.last()?.time {
        knots.push(knot);
    }
    let last = knots.last_mut()?;
    if last.speed > AT_REST {
        return None;
    }
    *last = SpeedKnot { speed: 0.0, acceleration: 0.0, jerk: 0.0, ..*last };
    SpeedProfile::new(knots)
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::super::{Resolution, Strategy, bounds, search};
    use super::*;

    fn searched(problem: &SpeedProblem) -> SpeedProfile {
        let found = search(problem, Strategy::SafeTlp, &Resolution::default()).unwrap();
        unsmoothed(problem, &found.proven().expect("a plan")).unwrap()
    }

    fn check(problem: &SpeedProblem, start_acceleration: f64) -> SpeedProfile {
        let searched = searched(problem);
        let settings = Settings::default();
        let smooth =
            smooth_and_prove(problem, &problem.caps, &searched, start_acceleration, &settings).expect("solvable");
        assert_eq!(prove(problem, &smooth), Ok(()));
        let jerk = smooth.knots().iter().map(|k| k.jerk.abs()).fold(0.0, f64::max);
        assert!(jerk <= settings.jerk + 1e-3, "jerk {jerk}");
        for pair in smooth.knots().windows(2) {
            let reached = pair[0].after(pair[1].time - pair[0].time);
            assert!((reached.station - pair[1].station).abs() < 1e-3, "{pair:?}");
            assert!((reached.acceleration - pair[1].acceleration).abs() < 0.1, "acceleration jumps at {pair:?}");
        }
        smooth
    }

    #[test]
    fn smoothing_keeps_the_proof_and_the_jerk_limit_from_any_start_speed() {
        for tenth in (0..=100).step_by(5) {
            let v = f64::from(tenth) / 10.0;
            check(&empty_road(100.0, v), 0.0);
            if v > 3.0 {
                check(&empty_road(100.0, v), -1.0);
                check(&empty_road(100.0, v), 1.0);
            }
        }
    }

    #[test]
    fn a_planned_stop_is_met_to_the_centimetre() {
        let mut problem = empty_road(60.0, 10.0);
        problem.caps = bounds::braking_caps(&problem.stations, 1.4).iter().map(|c| c.min(15.0)).collect();
        let end = check(&problem, 0.0).last().station;
        assert!((end - 60.0).abs() < 0.02, "stops at {end}");
    }

    #[test]
    fn an_impossible_start_has_no_smooth_profile() {
        // 10 m/s with 1.5 m of road left
        let problem = SpeedProblem { start_speed: 10.0, ..empty_road(1.5, 10.0) };
        let short = SpeedProfile::new(vec![
            SpeedKnot { time: 0.0, station: 0.0, speed: 10.0, acceleration: -33.3, jerk: 0.0 },
            SpeedKnot { time: 0.3, station: 1.5, speed: 0.0, acceleration: 0.0, jerk: 0.0 },
        ])
        .unwrap();
        assert_eq!(smooth(&problem, &problem.caps, &short, &short, 0.0, &Settings::default()), None);
    }
}
