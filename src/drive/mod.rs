//! The closed loop: plan, execute a tenth of a second in physics, plan again; then judge.

use crate::map::{PlanningProblem, Scenario};
use crate::planner::Cycle;
use crate::simulation::Log;
use crate::vehicle::Vehicle;
use crate::verdict::Verdict;

/// A finished run (or a single planning cycle, whose log is empty).
#[derive(Debug)]
pub struct Run<'a> {
    /// The scenario it ran on.
    pub scenario: &'a Scenario,
    /// The planning problem.
    pub problem: &'a PlanningProblem,
    /// The vehicle.
    pub vehicle: &'a Vehicle,
    /// The planning cycles, in order of time.
    pub cycles: Vec<Cycle>,
    /// What the rig measured; empty for a single planning cycle.
    pub log: Log,
    /// How it ended.
    pub outcome: Outcome,
    /// The named checks; empty for a single planning cycle.
    pub verdict: Verdict,
}

/// How a run ended. Outcomes are results, never errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The goal was reached.
    GoalReached,
    /// At rest without contact, because the way ends or is blocked.
    StoppedSafely,
    /// No proven plan from the start.
    NoSafePlan,
    /// The vehicle touched something.
    Collision,
    /// The time ran out while driving safely.
    TimedOut,
}

impl Outcome {
    /// The stable name used in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::GoalReached => "goal_reached",
            Self::StoppedSafely => "stopped_safely",
            Self::NoSafePlan => "no_safe_plan",
            Self::Collision => "collision",
            Self::TimedOut => "timed_out",
        }
    }
}
