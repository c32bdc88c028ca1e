//! Jerk-limited smoothing of a searched plan, as a quadratic program in time.
//!
//! The jerk is constant between knots `t_k`, a fifth of a second apart at first and farther apart later on, where the plan
//! will be made anew before it is driven. Variables are station `s_k`, speed `v_k` and acceleration `a_k` at the knots:
//!
//! ```text
//! minimise    Σ h_k ( w_s (s_k − ŝ_k)² + w_v (v_k − v̂_k)² + w_a a_k² + w_j j_k² ),   j_k = (a_{k+1} − a_k) / h_k
//! subject to  s_{k+1} = s_k + h v_k + h²/6 (2 a_k + a_{k+1}),   v_{k+1} = v_k + h/2 (a_k + a_{k+1})
//!             s_0, v_0, a_0 given;  v_N = a_N = 0
//!             s(t) ≤ upper,  s(t) ≥ lower  for the blocked intervals;  0 ≤ v_k ≤ cap_k;  −d ≤ a_k ≤ a;  |j_k| ≤ j_max
//! ```
//!
//! `ŝ, v̂` is the searched plan. It passes each blocked interval before or after; that order is kept, and one row for each
//! interval that matters is exact at any time between knots (`corridor`). Caps are tangents at the station that the
//! solution before had at that time, which is an approximation, and soft: so the result is **proved again**
//! ([`super::prove`]).
//!
//! Where no solution within the comfortable jerk can be proved, one within the firm jerk is sought, and told apart. If
//! there is none either the caller keeps the unsmoothed plan.
//!
//! Weak: the search does not know of the jerk limit, so that its plan may brake too late for any smooth one, although
//! another plan might not. The order in which blocked intervals are passed is never changed.

mod corridor;
mod program;

use super::{ProofViolation, SpeedPlan, SpeedProblem, prove};
use crate::trajectory::{SpeedKnot, SpeedProfile};
use program::{Program, Rows};

/// Weights and limits of the smoothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Largest jerk for comfort, m/s³.
    pub jerk: f64,
    /// Largest jerk where that one does not do, m/s³: an emergency's, with an acceleration that is still continuous.
    pub firm_jerk: f64,
    /// Length of the first time steps, s.
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
            firm_jerk: 10.0,
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
pub fn raw_profile(problem: &SpeedProblem, plan: &SpeedPlan) -> Option<SpeedProfile> {
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

/// A smooth profile, proved.
#[derive(Debug, Clone, PartialEq)]
pub struct Smoothed {
    /// The profile.
    pub profile: SpeedProfile,
    /// Whether it needs more than the comfortable jerk.
    pub is_firm: bool,
}

/// Why there is no smooth profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// `no_solution`: the program has none.
    NoSolution,
    /// Its solutions were refuted; the last one for the reason of this code ([`ProofViolation::CODES`]).
    ReverificationFailed(&'static str),
}

impl Failure {
    /// Every code.
    pub fn codes() -> impl Iterator<Item = &'static str> {
        std::iter::once(Self::NoSolution.code()).chain(ProofViolation::CODES)
    }

    /// The stable code used in reports.
    #[must_use]
    pub fn code(self) -> &'static str {
        match self {
            Self::NoSolution => "no_solution",
            Self::ReverificationFailed(code) => code,
        }
    }
}

/// The smoothed profile, starting with `start_acceleration` (m/s²), if one can be proved for `problem`. It is guided by
/// `target_speed_limits`, which may keep a reserve to the problem's own.
///
/// # Errors
/// Why there is none, within the firm jerk.
pub fn smooth_and_prove(
    problem: &SpeedProblem,
    target_speed_limits: &[f64],
    searched: &SpeedProfile,
    start_acceleration: f64,
    settings: &Settings,
) -> Result<Smoothed, Failure> {
    let Some(program) = Program::new(problem, target_speed_limits, searched, start_acceleration, settings) else {
        // it stands and goes on standing: nothing is smoother
        let profile = searched.clone();
        return match prove(problem, &profile) {
            Ok(()) => Ok(Smoothed { profile, is_firm: false }),
            Err(why) => Err(Failure::ReverificationFailed(why.code())),
        };
    };
    let comfortable = solve_and_prove(problem, &program, searched, settings.jerk);
    if let Ok(profile) = comfortable {
        return Ok(Smoothed { profile, is_firm: false });
    }
    let firm = settings.firm_jerk.max(settings.jerk);
    solve_and_prove(problem, &program, searched, firm).map(|profile| Smoothed { profile, is_firm: true })
}

/// A proved solution within a jerk (m/s³). The first one is of the rows that are likely to bite, with speed_limits read along
/// the searched plan; the others are of all rows, with speed_limits read along the solution before: a sequential convex program of
/// a few steps.
fn solve_and_prove(
    problem: &SpeedProblem,
    program: &Program<'_>,
    searched: &SpeedProfile,
    jerk: f64,
) -> Result<SpeedProfile, Failure> {
    let mut along = searched.clone();
    let mut failure = Failure::NoSolution;
    for rows in [Rows::Near, Rows::All, Rows::All] {
        let solution = match program.solve(&along, jerk, rows) {
            Some(solution) => solution,
            None if rows == Rows::Near && program.is_thinned() => continue,
            None => break,
        };
        match prove(problem, &solution) {
            Ok(()) => return Ok(solution),
            Err(why) => failure = Failure::ReverificationFailed(why.code()),
        }
        along = solution;
    }
    Err(failure)
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::super::{Resolution, Strategy, bounds, search};
    use super::*;

    fn searched(problem: &SpeedProblem) -> SpeedProfile {
        let found = search(problem, Strategy::SafeTlp, &Resolution::default()).unwrap();
        raw_profile(problem, &found.proven().expect("a plan")).unwrap()
    }

    fn check(problem: &SpeedProblem, start_acceleration: f64) -> SpeedProfile {
        let searched = searched(problem);
        let settings = Settings::default();
        let smooth = smooth_and_prove(problem, &problem.speed_limits, &searched, start_acceleration, &settings)
            .expect("solvable");
        assert!(!smooth.is_firm);
        let smooth = smooth.profile;
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
    fn who_drives_off_keeps_the_acceleration_it_has_and_who_has_just_stopped_has_none() {
        let problem = empty_road(100.0, 0.0);
        let begins = |acceleration: f64| check(&problem, acceleration).knots()[0].acceleration;
        assert!((begins(0.3) - 0.3).abs() < 1e-9);
        assert_eq!((begins(0.0), begins(-0.5)), (0.0, 0.0));
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
        problem.speed_limits =
            bounds::braking_speed_limits(&problem.stations, 1.4).iter().map(|c| c.min(15.0)).collect();
        let end = check(&problem, 0.0).last().station;
        assert!((end - 60.0).abs() < 0.02, "stops at {end}");
    }

    /// Something crosses 24 m ahead: 10 m/s can be braked to rest in 22.7 m, but not within the comfortable jerk.
    #[test]
    fn where_the_comfortable_jerk_does_not_do_the_firm_one_is_told() {
        let mut problem = empty_road(24.0, 10.0);
        problem.limits.aggressive_deceleration = 2.6;
        let searched = searched(&SpeedProblem {
            limits: crate::speed::AccelerationLimits { aggressive_deceleration: 2.2, ..problem.limits },
            ..problem.clone()
        });
        let smooth = |jerk| {
            let settings = Settings { jerk, firm_jerk: 10.0, ..Settings::default() };
            smooth_and_prove(&problem, &problem.speed_limits, &searched, 0.0, &settings).expect("firm does")
        };
        let (gentle, firm) = (smooth(8.0), smooth(1.0));
        assert!(!gentle.is_firm && firm.is_firm);
        let peak = |s: &Smoothed| s.profile.knots().iter().map(|k| k.jerk.abs()).fold(0.0, f64::max);
        assert!(peak(&gentle) <= 8.0 + 1e-3 && peak(&firm) <= 10.0 + 1e-3 && peak(&firm) > 1.0);
    }

    #[test]
    fn who_waits_first_and_who_stays_are_smooth() {
        let mut problem = empty_road(20.0, 0.0);
        problem.blocked[0] = vec![(0.0, 3.0)];
        let waits = check(&problem, 0.0);
        assert_eq!(waits.at(2.9).station, 0.0);
        assert!(waits.last().station > 19.0);
        let stays =
            SpeedProfile::new(vec![SpeedKnot { time: 0.0, station: 0.0, speed: 0.0, acceleration: 0.0, jerk: 0.0 }]);
        let stays = stays.unwrap();
        let same = smooth_and_prove(&problem, &problem.speed_limits, &stays, -0.2, &Settings::default()).unwrap();
        assert_eq!(same.profile, stays);
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
        let found = smooth_and_prove(&problem, &problem.speed_limits, &short, 0.0, &Settings::default());
        assert_eq!(found, Err(Failure::NoSolution));
    }
}
