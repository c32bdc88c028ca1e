//! Speed planning along a fixed path, such that every plan ends in a proven standstill.
//!
//! # Problem
//!
//! A [`SpeedProblem`] has *nodes* at stations `s_0 < s_1 < … < s_n` along the path. *Cell* `i` lies between the nodes
//! `i` and `i + 1`; its *blocked intervals* `B_i` are the times at which the vehicle, anywhere in the cell, would touch
//! a moving obstacle. A plan assigns a speed `v_i` and a time `t_i` to the nodes up to a last node `m ≤ n`:
//!
//! ```text
//! find        m;  a_i for each cell i < m;  waiting times w_i for each node i ≤ m
//! such that   v_{i+1}² = v_i² + 2 a_i Δs_i                    constant acceleration in a cell
//!             t_{i+1} = t_i + w_i + 2 Δs_i / (v_i + v_{i+1})
//!             a_i ∈ {a, 0, −d} in the nominal prefix, {a, 0, −d, −d_max} in the stopping proof
//!             w_i = 0 unless v_i = 0
//!             0 ≤ v_i ≤ v̄_i
//!             B_i does not meet the time in cell i, [t_i + w_i, t_{i+1}]
//!             v_m = 0 in a safe state
//! preferring  a nominal prefix that gets far, then early, then fast
//! ```
//!
//! An acceleration that would exceed the speed limit, or stop the vehicle inside the cell, is clipped so that the
//! vehicle reaches the limit or the standstill at the next node. A start above the speed limit is valid while the
//! vehicle brakes as hard as the phase allows.
//!
//! | symbol | in code | unit |
//! |---|---|---|
//! | `Δs_i` | difference of two [`SpeedProblem::stations`] | m |
//! | `v̄_i` | [`SpeedProblem::speed_limits`] | m/s |
//! | `B_i` | [`SpeedProblem::blocked`] | s of the run |
//! | `a`, `d` | comfortable acceleration and deceleration ([`AccelerationLimits`]) | m/s² |
//! | `d_max` | aggressive deceleration | m/s² |
//!
//! A *safe state* is a standstill where stopping is allowed and no obstacle passes until the horizon. A *nominal
//! prefix* is the part of the plan that the vehicle is meant to drive; the *stopping proof* after it is the fallback.
//!
//! # Technique
//!
//! The plan is a path through a lattice of (node, speed, time). [`Strategy::SafeTlp`] searches this lattice by
//! Algorithm 1 of Cserna, Doyle, Gu and Ruml, *Safe Temporal Planning for Urban Driving*; [`Strategy`] lists the
//! methods that the paper and this crate compare with it. [`smoothing`] then turns the raw profile into a jerk-limited
//! one by a quadratic program, and [`prove()`] checks any profile against the problem, with code that it does not share
//! with the searches.
//!
//! # Guarantee
//!
//! SafeTLP finds a plan if the lattice contains one (Theorem 1), and expands at most twice as many states as an
//! exhaustive search (Theorem 2). `tests` checks both against plain enumeration.
//!
//! # Weakness
//!
//! The search detects duplicates on a grid of speed and time ([`Resolution`]), so it is complete for that grid and not
//! for the continuum. SafeTLP minimises no cost: it fixes the nominal trajectory before it looks for proofs. The raw
//! profile has unbounded jerk.

pub mod bounds;
mod lattice;
mod lost;
mod naive;
mod outcome;
mod plan_to_stop;
mod problem;
pub mod profiles;
mod prove;
mod safe_rts;
mod safe_tlp;
pub mod smoothing;
pub mod tail;

pub use lattice::{Budget, ProofOrder};
pub use outcome::{NoPlan, SpeedOutcome, SpeedPlan, SpeedState, Statistics};
pub use problem::{ProblemError, SpeedProblem};
pub use prove::{ProofViolation, prove};
pub(crate) use prove::{first_time_at, last_time_at};

/// A search method on the speed lattice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Strategy {
    /// Best-first search to the last node at any speed. The plan has no stopping proof.
    Naive,
    /// Exhaustive breadth-first search for a standstill with comfortable actions: the conventional method.
    PlanToStop,
    /// Algorithm 1 of the SafeTLP paper. Complete.
    SafeTlp,
    /// Alternates exploration and proofs under a budget. Returns the longest proven prefix.
    SafeRts,
}

impl Strategy {
    /// All strategies.
    pub const ALL: [Self; 4] = [Self::Naive, Self::PlanToStop, Self::SafeTlp, Self::SafeRts];

    /// The stable name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Naive => "naive",
            Self::PlanToStop => "plan-to-stop",
            Self::SafeTlp => "safetlp",
            Self::SafeRts => "safe-rts",
        }
    }
}

/// Searches for a plan with a strategy. The absence of a plan is an outcome, not an error.
///
/// # Errors
/// [`ProblemError`] if the problem or the resolution is invalid.
pub fn search(
    problem: &SpeedProblem,
    strategy: Strategy,
    resolution: &Resolution,
) -> Result<SpeedOutcome, ProblemError> {
    problem.validate()?;
    resolution.validate()?;
    if let Some(why) = NoPlan::cannot_stop(problem).filter(|_| strategy != Strategy::Naive) {
        return Ok(SpeedOutcome::NoPlan { why, statistics: Statistics::default() });
    }
    let (plan, statistics, exhausted) = lattice::with(problem, strategy, resolution, |lattice| match strategy {
        Strategy::Naive => Some(naive::search(lattice)),
        Strategy::PlanToStop => plan_to_stop::search(lattice),
        Strategy::SafeTlp => safe_tlp::search(lattice),
        Strategy::SafeRts => safe_rts::search(lattice),
    });
    Ok(match plan {
        Some(plan) if strategy == Strategy::Naive => SpeedOutcome::Unproven { plan, statistics },
        Some(plan) => SpeedOutcome::Proven { plan, statistics },
        None => {
            SpeedOutcome::NoPlan { why: exhausted.map_or(NoPlan::NoSafeState, NoPlan::BudgetExhausted), statistics }
        }
    })
}

/// A closed time interval `(from, to)`, s of the run.
pub type TimeInterval = (f64, f64);

/// Acceleration limits of the search. Decelerations are positive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AccelerationLimits {
    /// Comfortable acceleration, m/s².
    pub acceleration: f64,
    /// Comfortable deceleration, m/s².
    pub deceleration: f64,
    /// Deceleration that only stopping proofs may use, m/s²; at least the comfortable one.
    pub aggressive_deceleration: f64,
}

/// Discretisation and budgets of a search. Budgets are counts, never times, so that results are reproducible.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resolution {
    /// Width of a speed bin, m/s. States of one node, speed bin and time bin are duplicates.
    pub speed: f64,
    /// Width of a time bin, s. Without moving obstacles all times share one bin.
    pub time: f64,
    /// Duration of one waiting action at standstill, s.
    pub wait: f64,
    /// Maximum number of expansions: in each of the phases of SafeTLP (all proofs together, exhaustive search), or in the whole
    /// search of the other strategies.
    pub expansions: usize,
    /// Maximum number of expansions in the naive search of SafeTLP, and in the search from the root after proofs that have used up
    /// theirs. If the naive search does not reach the last node, the farthest state replaces the partial goal.
    pub exploration: usize,
    /// Memory limit of a search, bytes.
    pub memory: usize,
    /// Uses time bins even without moving obstacles, as in the paper's lattice.
    pub always_timed: bool,
    /// Expansion order of the stopping proofs.
    pub proof_order: ProofOrder,
}

impl Default for Resolution {
    fn default() -> Self {
        Self {
            speed: 0.05,
            time: 0.1,
            wait: 0.5,
            expansions: 20_000,
            exploration: 20_000,
            memory: 64 << 20,
            always_timed: false,
            proof_order: ProofOrder::default(),
        }
    }
}

#[cfg(test)]
pub(crate) mod test_support {
    use super::{AccelerationLimits, SpeedProblem};

    /// The paper's road: `length` metres in steps of half a metre, 15 m/s, limit set 4 of Table 1, no obstacles.
    pub(crate) fn empty_road(length: f64, start_speed: f64) -> SpeedProblem {
        let cells = (length / 0.5).round() as usize;
        SpeedProblem {
            stations: (0..=cells).map(|i| 0.5 * i as f64).collect(),
            speed_limits: vec![15.0; cells + 1],
            blocked: vec![Vec::new(); cells],
            blocked_at_start: Vec::new(),
            stopping_allowed: vec![true; cells + 1],
            start_speed,
            start_time: 0.0,
            horizon: 30.0,
            limits: AccelerationLimits { acceleration: 1.5, deceleration: 1.5, aggressive_deceleration: 2.2 },
        }
    }
}

#[cfg(test)]
mod tests;
