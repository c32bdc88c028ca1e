//! Facts of the start that decide a run before any planning. A plan and a drive of the same problem get the same outcome and
//! reason from here.

use super::{Outcome, Run, Settings, begin, goal_counts, initial_state, latest_end};
use crate::map::{PlanningProblem, Scenario};
use crate::planner::NoLane;
use crate::vehicle::Vehicle;
use crate::verdict::{self, GoalWatch};

/// What the start of a problem decides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Start {
    /// Nothing: planning decides.
    Clear,
    /// There is no lane to plan on.
    NoLane(NoLane),
    /// Every time window of the goal closes before the run can begin.
    GoalTimeIsPast,
    /// The vehicle overlaps an obstacle or an occupied cell.
    InCollision,
    /// The vehicle meets every condition of a goal.
    AtGoal,
}

impl Start {
    /// The first fact that applies, in the order of the variants. `no_lane` comes from the planner.
    pub(super) fn of(
        scenario: &Scenario,
        problem: &PlanningProblem,
        vehicle: &Vehicle,
        settings: &Settings,
        no_lane: Option<NoLane>,
    ) -> Self {
        let watch = GoalWatch::new(scenario, problem);
        let begins = begin(scenario, problem);
        let ends = latest_end(&watch, begins, settings);
        let state = initial_state(problem, vehicle, begins);
        let at_goal = || {
            watch.is_goal(&problem.initial.centre, state.speed, begins)
                && goal_counts(problem, state.speed, begins, ends)
        };
        if let Some(reason) = no_lane {
            Self::NoLane(reason)
        } else if ends <= begins {
            Self::GoalTimeIsPast
        } else if verdict::overlaps(scenario, vehicle, &state, settings.verdict.contact_tolerance) {
            Self::InCollision
        } else if at_goal() {
            Self::AtGoal
        } else {
            Self::Clear
        }
    }

    /// Whether neither a planning cycle nor a simulation makes sense.
    pub(super) fn is_final(self) -> bool {
        matches!(self, Self::NoLane(_) | Self::GoalTimeIsPast)
    }

    /// Sets outcome and reason of a run.
    pub(super) fn explain(self, run: &mut Run<'_>) {
        let (outcome, reason) = match self {
            Self::Clear => return,
            Self::NoLane(reason) => (Outcome::NoSafePlan, Some(reason.code())),
            Self::GoalTimeIsPast => (Outcome::TimedOut, Some("goal_time_is_past")),
            Self::InCollision => (Outcome::Collision, Some("start_in_collision")),
            Self::AtGoal => (Outcome::AlreadyAtGoal, None),
        };
        (run.outcome, run.reason) = (outcome, reason);
    }
}
