//! What a search of the speed lattice comes to.

use super::SpeedProblem;
use super::lattice::{Budget, REST};

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
    /// States from the root on. Two in a row at the same node mean waiting at rest.
    pub states: Vec<SpeedState>,
    /// Index of the state where the nominal prefix ends and the stopping proof begins.
    pub proof_starts: usize,
}

impl SpeedPlan {
    /// Ends the plan at the first safe rest that it would wait at for `wait` seconds or more. A prefix that ends at a safe
    /// rest is a proven plan as well.
    pub fn end_at_long_wait(&mut self, problem: &SpeedProblem, wait: f64) {
        let leaves = |i: usize| {
            let node = self.states[i].node;
            self.states[i..].iter().take_while(|s| s.node == node).last().map_or(0.0, |s| s.time)
        };
        let end = (0..self.states.len()).find(|&i| {
            let s = &self.states[i];
            s.speed <= REST && leaves(i) - s.time >= wait && problem.is_safe_standstill(s.node, s.time)
        });
        if let Some(end) = end {
            self.states.truncate(end + 1);
            self.proof_starts = self.proof_starts.min(end);
        }
    }
}

/// What a search has done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Statistics {
    /// States expanded, or found lost, in all phases.
    pub expansions: usize,
    /// Stopping proofs attempted; the exhaustive search from the root is not counted.
    pub proofs_tried: usize,
    /// Which of them succeeded and gave the plan, from 1; `None` if none did.
    pub proof_succeeded: Option<usize>,
    /// States in all closed lists.
    pub closed: usize,
    /// Most memory in use for states and lists, bytes.
    pub bytes: usize,
}

/// What a search found. Finding nothing is a result, not an error.
#[derive(Debug, Clone, PartialEq)]
pub enum SpeedOutcome {
    /// A plan that ends at rest in a safe state.
    Proven {
        /// The plan.
        plan: SpeedPlan,
        /// How it was found.
        statistics: Statistics,
    },
    /// A plan of [`super::Strategy::Naive`], which proves nothing.
    Unproven {
        /// The plan.
        plan: SpeedPlan,
        /// How it was found.
        statistics: Statistics,
    },
    /// No plan.
    NoPlan {
        /// Why.
        why: NoPlan,
        /// How that was found out.
        statistics: Statistics,
    },
}

/// Why a search found no plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NoPlan {
    /// Even the hardest braking from the start needs more road than there is.
    CannotStop {
        /// Distance that it needs, m.
        needed: f64,
    },
    /// No state of the searched lattice is safe.
    NoSafeState,
    /// A budget ended the search: a plan may exist all the same.
    BudgetExhausted(Budget),
}

impl NoPlan {
    pub(super) fn of(problem: &SpeedProblem, spent: Option<Budget>) -> Self {
        let needed = problem.start_speed.powi(2) / (2.0 * problem.limits.aggressive_deceleration);
        let room = problem.end() - problem.stations.first().copied().unwrap_or_default();
        match spent {
            // room for rounding, as the search has it
            _ if needed > room + REST => Self::CannotStop { needed },
            Some(budget) => Self::BudgetExhausted(budget),
            None => Self::NoSafeState,
        }
    }
}

impl SpeedOutcome {
    /// How the search went.
    #[must_use]
    pub fn statistics(&self) -> &Statistics {
        match self {
            Self::Proven { statistics, .. } | Self::Unproven { statistics, .. } | Self::NoPlan { statistics, .. } => {
                statistics
            }
        }
    }

    /// Stable code of what the search came to.
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

    /// The plan whose stop is proven.
    #[must_use]
    pub fn proven(self) -> Option<SpeedPlan> {
        match self {
            Self::Proven { plan, .. } => Some(plan),
            Self::Unproven { .. } | Self::NoPlan { .. } => None,
        }
    }
}
