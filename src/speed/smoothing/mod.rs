//! Jerk-limited smoothing of a raw profile, as a quadratic program in time.
//!
//! # Problem
//!
//! The jerk is constant between knots `t_k`. The steps `h_k` are 0.2 s at first and grow later, where the planner
//! replaces the plan before the vehicle drives it. Decision variables are station `s_k`, speed `v_k` and acceleration
//! `a_k` at each knot:
//!
//! ```text
//! minimise    Σ h_k ( w_s (s_k − ŝ_k)² + w_v (v_k − v̂_k)² + w_a a_k² + w_j j_k² ),   j_k = (a_{k+1} − a_k) / h_k
//! subject to  s_{k+1} = s_k + h v_k + h²/6 (2 a_k + a_{k+1}),   v_{k+1} = v_k + h/2 (a_k + a_{k+1})
//!             s_0, v_0, a_0 given;  v_N = a_N = 0
//!             s(t) ≤ upper bound,  s(t) ≥ lower bound    for each blocked interval (`corridor`)
//!             0 ≤ v_k ≤ v̄_k + ε_k,  ε_k ≥ 0 penalised    speed limits, soft
//!             −d_max ≤ a_k ≤ a,  |j_k| ≤ j_max
//! ```
//!
//! `ŝ, v̂` is the raw profile; `a` and `d_max` are the limits of [`super::AccelerationLimits`].
//!
//! # Technique
//!
//! The raw profile passes each blocked interval before or after the obstacle. The program keeps that order, which makes
//! each interval one linear bound at one time. Speed limits depend on the station, so the program linearises them about
//! the previous solution: a sequential convex program of at most three steps. If no solution within the comfortable
//! jerk can be proved, a second attempt uses the firm jerk and [`Smoothed::is_firm`] reports it.
//!
//! # Guarantee
//!
//! [`super::prove()`] verifies every result; linearisation and soft limits cannot weaken a plan. If there is no result,
//! the caller keeps the raw profile.
//!
//! # Weakness
//!
//! The search ignores the jerk limit, so the raw profile may brake too late for any smooth profile of the same order,
//! even if another order has one. The program never changes the order in which the vehicle passes obstacles.

mod corridor;
mod program;

use super::{ProofViolation, SpeedPlan, SpeedProblem, prove};
pub use crate::settings::SettingsError;
use crate::settings::{positive, within};
use crate::trajectory::{SpeedKnot, SpeedProfile};
use program::{Program, Rows};

/// Weights and limits of the smoothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Comfortable jerk limit, m/s³.
    pub jerk: f64,
    /// Jerk limit of the second attempt, m/s³: that of an emergency, with continuous acceleration.
    pub firm_jerk: f64,
    /// Length of the first time steps, s.
    pub step: f64,
    /// Time by which a smoothed profile may last longer than the raw one, s.
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

impl Settings {
    /// Checks the range of every value.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        positive("jerk", self.jerk, f64::INFINITY, "m/s³")?;
        positive("firm_jerk", self.firm_jerk, f64::INFINITY, "m/s³")?;
        within("step", self.step, 0.01..=10.0, "s")?;
        within("extra_time", self.extra_time, 0.0..=60.0, "s")?;
        for (name, weight) in [
            ("station_weight", self.station_weight),
            ("speed_weight", self.speed_weight),
            ("acceleration_weight", self.acceleration_weight),
            ("jerk_weight", self.jerk_weight),
        ] {
            within(name, weight, 0.0..=1e6, "")?;
        }
        Ok(())
    }
}

/// The raw profile of a plan, with constant acceleration between its states. `None` if the times do not increase.
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

/// A smoothed and proved profile.
#[derive(Debug, Clone, PartialEq)]
pub struct Smoothed {
    /// The profile.
    pub profile: SpeedProfile,
    /// Whether the profile exceeds the comfortable jerk.
    pub is_firm: bool,
}

/// Why there is no smoothed profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// `no_solution`: the program is infeasible, or the solver failed.
    NoSolution,
    /// The proof of the solutions failed; the code names the violation of the last one ([`ProofViolation::CODES`]).
    ReverificationFailed(&'static str),
    /// `out_of_tube`: the vehicle cannot be relied on to follow the profile, or something is within its tracking errors.
    OutOfTube,
}

impl Failure {
    /// All codes.
    pub fn codes() -> impl Iterator<Item = &'static str> {
        [Self::NoSolution, Self::OutOfTube].map(Self::code).into_iter().chain(ProofViolation::CODES)
    }

    /// The stable code used in reports.
    #[must_use]
    pub fn code(self) -> &'static str {
        match self {
            Self::NoSolution => "no_solution",
            Self::ReverificationFailed(code) => code,
            Self::OutOfTube => "out_of_tube",
        }
    }
}

/// The smoothing with valid settings, so that a [`Failure`] is one of the profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoother {
    settings: Settings,
}

impl Smoother {
    /// Checks the settings.
    ///
    /// # Errors
    /// A setting out of its range.
    pub fn new(settings: Settings) -> Result<Self, SettingsError> {
        settings.validate()?;
        Ok(Self { settings })
    }

    /// Smooths a raw profile from `start_acceleration` (m/s²) on and proves the result for `problem`. The program aims at
    /// `target_speed_limits` (m/s at each node), which may lie below the limits of the problem.
    ///
    /// # Errors
    /// [`Failure`] of the attempt with the firm jerk.
    pub fn smooth_and_prove(
        &self,
        problem: &SpeedProblem,
        target_speed_limits: &[f64],
        raw: &SpeedProfile,
        start_acceleration: f64,
    ) -> Result<Smoothed, Failure> {
        let settings = &self.settings;
        let Some(program) = Program::new(problem, target_speed_limits, raw, start_acceleration, settings) else {
            // a permanent standstill needs no smoothing
            let profile = raw.clone();
            return match prove(problem, &profile) {
                Ok(()) => Ok(Smoothed { profile, is_firm: false }),
                Err(why) => Err(Failure::ReverificationFailed(why.code())),
            };
        };
        let comfortable = solve_and_prove(problem, &program, raw, settings.jerk);
        if let Ok(profile) = comfortable {
            return Ok(Smoothed { profile, is_firm: false });
        }
        let firm = settings.firm_jerk.max(settings.jerk);
        solve_and_prove(problem, &program, raw, firm).map(|profile| Smoothed { profile, is_firm: true })
    }
}

/// A proved solution within a jerk limit (m/s³). The first program contains only the rows that are likely to be active,
/// with speed limits linearised about the raw profile. The following ones contain all rows, with speed limits
/// linearised about the previous solution.
fn solve_and_prove(
    problem: &SpeedProblem,
    program: &Program<'_>,
    raw: &SpeedProfile,
    jerk: f64,
) -> Result<SpeedProfile, Failure> {
    let mut linearised_about = raw.clone();
    let mut failure = Failure::NoSolution;
    for rows in [Rows::Near, Rows::All, Rows::All] {
        let solution = match program.solve(&linearised_about, jerk, rows) {
            Some(solution) => solution,
            None if rows == Rows::Near && program.is_thinned() => continue,
            None => break,
        };
        match prove(problem, &solution) {
            Ok(()) => return Ok(solution),
            Err(why) => failure = Failure::ReverificationFailed(why.code()),
        }
        linearised_about = solution;
    }
    Err(failure)
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::super::{Resolution, Strategy, bounds, search};
    use super::*;

    fn raw(problem: &SpeedProblem) -> SpeedProfile {
        let found = search(problem, Strategy::SafeTlp, &Resolution::default()).unwrap();
        raw_profile(problem, &found.proven().expect("a plan")).unwrap()
    }

    /// Smoothing with valid settings up to the speed limits of the problem.
    fn smooth_and_prove(
        problem: &SpeedProblem,
        raw: &SpeedProfile,
        acceleration: f64,
        settings: Settings,
    ) -> Result<Smoothed, Failure> {
        Smoother::new(settings).unwrap().smooth_and_prove(problem, &problem.speed_limits, raw, acceleration)
    }

    fn check(problem: &SpeedProblem, start_acceleration: f64) -> SpeedProfile {
        let raw = raw(problem);
        let settings = Settings::default();
        let smooth = smooth_and_prove(problem, &raw, start_acceleration, settings).expect("solvable");
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
    fn start_from_standstill_keeps_only_a_positive_acceleration() {
        let problem = empty_road(100.0, 0.0);
        let begins = |acceleration: f64| check(&problem, acceleration).knots()[0].acceleration;
        assert!((begins(0.3) - 0.3).abs() < 1e-9);
        assert_eq!((begins(0.0), begins(-0.5)), (0.0, 0.0));
    }

    #[test]
    fn smoothed_profiles_are_proved_and_jerk_limited_for_every_start_speed() {
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

    /// The road ends after 24 m. From 10 m/s the vehicle stops in 22.7 m, but not within the comfortable jerk.
    #[test]
    fn reports_the_firm_jerk_if_the_comfortable_one_has_no_solution() {
        let mut problem = empty_road(24.0, 10.0);
        problem.limits.aggressive_deceleration = 2.6;
        let raw = raw(&SpeedProblem {
            limits: crate::speed::AccelerationLimits { aggressive_deceleration: 2.2, ..problem.limits },
            ..problem.clone()
        });
        let smooth = |jerk| {
            let settings = Settings { jerk, firm_jerk: 10.0, ..Settings::default() };
            smooth_and_prove(&problem, &raw, 0.0, settings).expect("a solution")
        };
        let (gentle, firm) = (smooth(8.0), smooth(1.0));
        assert!(!gentle.is_firm && firm.is_firm);
        let peak = |s: &Smoothed| s.profile.knots().iter().map(|k| k.jerk.abs()).fold(0.0, f64::max);
        assert!(peak(&gentle) <= 8.0 + 1e-3 && peak(&firm) <= 10.0 + 1e-3 && peak(&firm) > 1.0);
    }

    #[test]
    fn smooths_a_profile_that_waits_first_and_keeps_a_permanent_standstill() {
        let mut problem = empty_road(20.0, 0.0);
        problem.blocked[0] = vec![(0.0, 3.0)];
        let waits = check(&problem, 0.0);
        assert_eq!(waits.at(2.9).station, 0.0);
        assert!(waits.last().station > 19.0);
        let stays =
            SpeedProfile::new(vec![SpeedKnot { time: 0.0, station: 0.0, speed: 0.0, acceleration: 0.0, jerk: 0.0 }]);
        let stays = stays.unwrap();
        let same = smooth_and_prove(&problem, &stays, -0.2, Settings::default()).unwrap();
        assert_eq!(same.profile, stays);
    }

    #[test]
    fn impossible_start_has_no_smoothed_profile() {
        // 10 m/s on a road of 1.5 m
        let problem = SpeedProblem { start_speed: 10.0, ..empty_road(1.5, 10.0) };
        let short = SpeedProfile::new(vec![
            SpeedKnot { time: 0.0, station: 0.0, speed: 10.0, acceleration: -33.3, jerk: 0.0 },
            SpeedKnot { time: 0.3, station: 1.5, speed: 0.0, acceleration: 0.0, jerk: 0.0 },
        ])
        .unwrap();
        let found = smooth_and_prove(&problem, &short, 0.0, Settings::default());
        assert_eq!(found, Err(Failure::NoSolution));
    }
}
