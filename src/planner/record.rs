//! What a planning cycle leaves behind for reports, pictures and recordings.

use crate::geometry::Point;
use crate::lattice::{CostTerms, EdgeCounts};
use crate::trajectory::{Path, Trajectory};

/// What one planning cycle saw and chose. Everything that pictures, recordings and reports need.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle {
    /// Time of the run at which the cycle ran, s.
    pub time: f64,
    /// The trajectory committed from this time on: the new plan, or the last one when no new plan was proven.
    pub committed: Trajectory,
    /// What was decided.
    pub decision: Decision,
    /// The reference line used, sampled.
    pub reference: Vec<Point>,
    /// The candidates, in a stable order.
    pub candidates: Vec<Candidate>,
    /// Station × time cells blocked on the committed path, as (station interval, time interval): m on the committed
    /// path, s of the run.
    pub blocked: Vec<((f64, f64), (f64, f64))>,
    /// Index of the chosen one in `candidates`; `None` when the last plan goes on.
    pub chosen: Option<usize>,
    /// What became of the lattice edges that were looked at, over all lanes and attempts.
    pub edges: EdgeCounts,
    /// Search expansions of the speed layer, over all candidates.
    pub expansions: usize,
    /// Whether the committed profile is jerk-limited; if not, the searched one stands because no smooth one was proved.
    pub is_smooth: bool,
    /// Whether the committed path is a refined one; if not, the lattice's own stands.
    pub is_refined: bool,
    /// Wall-clock times of the stages, s. Never part of a hash.
    pub stage_seconds: StageSeconds,
}

/// What a cycle decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Decision {
    /// A new plan with its stop proven, under the given deceleration (m/s²) at most.
    NewPlan {
        /// Largest deceleration of the plan and its proof, m/s².
        deceleration: f64,
    },
    /// No new proven plan was found: the last proven plan goes on to its stop.
    KeepLast,
    /// No proven plan has ever been found: braking as hard as the tyres allow.
    Unproven,
}

/// One candidate path.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// The path.
    pub path: Path,
    /// Total cost; a lower bound if rejected.
    pub cost: f64,
    /// Cost by term.
    pub terms: CostTerms,
    /// Why it was rejected; a stable code.
    pub rejected: Option<&'static str>,
}

/// Wall-clock times of the stages of one cycle, s.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StageSeconds {
    /// Reference line.
    pub reference: f64,
    /// Lattice.
    pub lattice: f64,
    /// Collision.
    pub collision: f64,
    /// Speed search.
    pub speed: f64,
    /// Refinement of the chosen path, with its speed search.
    pub refinement: f64,
    /// Smoothing and its proof.
    pub smoothing: f64,
    /// The whole cycle.
    pub total: f64,
}
