//! Results of a search: the plan or the reason for its absence, and statistics.

use super::SpeedProblem;
use super::lattice::{Budget, ROUNDING, STANDSTILL_SPEED};

/// A state of the speed lattice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedState {
    /// Node index.
    pub node: usize,
    /// Speed, m/s.
    pub speed: f64,
    /// Time, s of the run.
    pub time: f64,
}

/// A plan through the speed lattice.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedPlan {
    /// States from the root on. Two consecutive states at one node mean waiting at standstill.
    pub states: Vec<SpeedState>,
    /// Index of the state at which the nominal prefix ends and the stopping proof begins.
    pub proof_starts: usize,
}

impl SpeedPlan {
    /// Truncates the plan at the first safe standstill at which it waits for at least `wait` (s). The result is a
    /// proven plan too, because it ends in a safe state.
    pub fn end_at_long_wait(&mut self, problem: &SpeedProblem, wait: f64) {
        let departure_time = |i: usize| {
            let node = self.states[i].node;
            self.states[i..].iter().take_while(|s| s.node == node).last().map_or(0.0, |s| s.time)
        };
        let end = (0..self.states.len()).find(|&i| {
            let s = &self.states[i];
            s.speed <= STANDSTILL_SPEED
                && departure_time(i) - s.time >= wait
                && problem.is_safe_standstill(s.node, s.time)
        });
        if let Some(end) = end {
            self.states.truncate(end + 1);
            self.proof_starts = self.proof_starts.min(end);
        }
    }
}

/// Effort of a search.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Number of expanded states in all phases, including states recognised as lost.
    pub expansions: usize,
    /// Number of attempted stopping proofs, without the search from the root.
    pub proofs_tried: usize,
    /// Number of the attempt that proved the plan, from 1. `None` if no attempt succeeded.
    pub proof_succeeded: Option<usize>,
    /// Number of states in all closed lists.
    pub closed: usize,
    /// Peak memory of states and lists, bytes.
    pub bytes: usize,
}

/// Result of a search. The absence of a plan is an outcome, not an error.
#[derive(Debug, Clone, PartialEq)]
pub enum SpeedOutcome {
    /// A plan that ends in a safe state.
    Proven {
        /// The plan.
        plan: SpeedPlan,
        /// Effort of the search.
        statistics: Statistics,
    },
    /// A plan of [`super::Strategy::Naive`], without a stopping proof.
    Unproven {
        /// The plan.
        plan: SpeedPlan,
        /// Effort of the search.
        statistics: Statistics,
    },
    /// No plan.
    NoPlan {
        /// The reason.
        why: NoPlan,
        /// Effort of the search.
        statistics: Statistics,
    },
}

/// Why a search found no plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NoPlan {
    /// The stopping distance with the aggressive deceleration exceeds the length of the road.
    CannotStop {
        /// Stopping distance, m.
        needed: f64,
    },
    /// The lattice contains no reachable safe state.
    NoSafeState,
    /// The search exhausted a budget. A plan may exist.
    BudgetExhausted(Budget),
}

impl NoPlan {
    /// [`Self::CannotStop`], if the road is too short.
    pub(super) fn cannot_stop(problem: &SpeedProblem) -> Option<Self> {
        let needed = problem.start_speed.powi(2) / (2.0 * problem.limits.aggressive_deceleration);
        let available = problem.end() - problem.stations.first().copied().unwrap_or_default();
        (needed > available + ROUNDING).then_some(Self::CannotStop { needed })
    }
}

impl SpeedOutcome {
    /// Effort of the search.
    #[must_use]
    pub fn statistics(&self) -> &Statistics {
        match self {
            Self::Proven { statistics, .. } | Self::Unproven { statistics, .. } | Self::NoPlan { statistics, .. } => {
                statistics
            }
        }
    }

    /// The stable code used in reports.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            Self::Proven { .. } => "proven",
            Self::Unproven { .. } => "unproven",
            Self::NoPlan { why: NoPlan::CannotStop { .. }, .. } => "cannot_stop",
            Self::NoPlan { why: NoPlan::NoSafeState, .. } => "no_safe_state",
            Self::NoPlan { why: NoPlan::BudgetExhausted(Budget::Expansions), .. } => "expansion_budget",
            Self::NoPlan { why: NoPlan::BudgetExhausted(Budget::Memory), .. } => "memory_budget",
        }
    }

    /// The proven plan, if there is one.
    #[must_use]
    pub fn proven(self) -> Option<SpeedPlan> {
        match self {
            Self::Proven { plan, .. } => Some(plan),
            Self::Unproven { .. } | Self::NoPlan { .. } => None,
        }
    }
}
