//! The speed layer: how fast to go along a path that is already chosen, so that a stop is always proven.
//!
//! The state is (station, speed, time). Stations are nodes `s_0 < s_1 < … < s_n` along the path; an edge crosses the
//! cell between two nodes at constant acceleration `a`, so that
//!
//! ```text
//! v′² = v² + 2 a Δs        Δt = 2 Δs / (v + v′)
//! ```
//!
//! A cell is *blocked* during the time intervals in which the vehicle, anywhere in that cell, would touch a moving
//! obstacle. The planner searches this lattice by the SafeTLP algorithm (Cserna, Doyle, Gu, Ruml: *Safe Temporal Planning
//! for Urban Driving*, Algorithm 1); [`Strategy`] names the methods that it is compared with, behind the same [`search`].
//! [`smoothing`] makes the result jerk-limited through a quadratic program; [`prove`] checks any profile again, by other
//! code than the search.
//!
//! Weak spots: duplicates are detected on a grid of speed and time (see [`Resolution`]), so completeness holds for that
//! grid and not for the continuum; edges have unbounded jerk until they are smoothed.

pub mod bounds;
mod inevitable_collision;
mod lattice;
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

/// How the speed lattice is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Strategy {
    /// Best-first search to the end of the road at any speed. Proves nothing.
    Naive,
    /// Exhaustive breadth-first search for a stop with comfortable actions: the conventional method.
    PlanToStop,
    /// Algorithm 1 of the paper: complete.
    SafeTlp,
    /// Explores and proves in turns under a budget, and returns the best proven prefix it has.
    SafeRts,
}

impl Strategy {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Naive, Self::PlanToStop, Self::SafeTlp, Self::SafeRts];

    /// Its stable name.
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

/// Searches for a plan of the given strategy. Finding none is an outcome.
///
/// # Errors
/// A problem that makes no sense: see [`ProblemError`].
pub fn search(
    problem: &SpeedProblem,
    strategy: Strategy,
    resolution: &Resolution,
) -> Result<SpeedOutcome, ProblemError> {
    problem.validate()?;
    resolution.validate()?;
    let (plan, statistics, spent) = lattice::with(problem, resolution, |lattice| match strategy {
        Strategy::Naive => Some(naive::search(lattice)),
        Strategy::PlanToStop => plan_to_stop::search(lattice),
        Strategy::SafeTlp => safe_tlp::search(lattice),
        Strategy::SafeRts => safe_rts::search(lattice),
    });
    Ok(match plan {
        Some(plan) if strategy == Strategy::Naive => SpeedOutcome::Unproven { plan, statistics },
        Some(plan) => SpeedOutcome::Proven { plan, statistics },
        None => SpeedOutcome::NoPlan { why: NoPlan::of(problem, spent), statistics },
    })
}

/// A closed time interval `(from, to)`, s of the run.
pub type TimeInterval = (f64, f64);

/// Accelerations of the search; decelerations are positive numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AccelerationLimits {
    /// Comfortable acceleration, m/s².
    pub acceleration: f64,
    /// Comfortable deceleration, m/s².
    pub deceleration: f64,
    /// Deceleration that only stopping proofs may use, m/s², at least the comfortable one.
    pub aggressive_deceleration: f64,
}

/// Discretisation and budgets of the search. Budgets are counts, never times, so that results repeat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resolution {
    /// States at one station within this speed of each other (and of the same time bin) are duplicates, m/s.
    pub speed: f64,
    /// Width of a time bin, s. Ignored where nothing moves, since then time does not matter.
    pub time: f64,
    /// Duration of one waiting action at rest, s.
    pub wait: f64,
    /// Expansions allowed in each of the three phases of SafeTLP (naive search, all proofs together, exhaustive search),
    /// and in all of the other strategies.
    pub expansions: usize,
    /// Memory that a search may use, bytes.
    pub memory: usize,
    /// Whether states at different times are different even where nothing moves, as in the paper's lattice.
    pub always_timed: bool,
    /// Order of the stopping proofs.
    pub proof_order: ProofOrder,
}

impl Default for Resolution {
    fn default() -> Self {
        Self {
            speed: 0.05,
            time: 0.1,
            wait: 0.5,
            expansions: 20_000,
            memory: 64 << 20,
            always_timed: false,
            proof_order: ProofOrder::default(),
        }
    }
}

#[cfg(test)]
pub(crate) mod test_support {
    use super::{AccelerationLimits, SpeedProblem};

    /// The paper's road: `length` metres in half-metre steps, 15 m/s, limit set 4 of Table 1, nothing in the way.
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
