//! What a planning cycle leaves behind for reports, pictures and recordings.

use std::fmt;

use crate::geometry::Point;
use crate::lattice::{CostTerms, EdgeCounts};
use crate::speed::smoothing;
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
    /// How smooth the committed profile is, and if not, why.
    pub smoothing: Smoothing,
    /// Whether the committed path is a refined one; if not, the lattice's own stands.
    pub is_refined: bool,
    /// Whether the committed plan's stop is proven for all motions of the traffic within the bounds that the settings give, as
    /// seen when the plan was made; if not, for the predicted motions alone. Never where the settings ask for no such proof.
    pub is_robust: bool,
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
    KeepPrevious,
    /// No proven plan has ever been found: braking as hard as the tyres allow.
    Unproven,
}

/// One candidate path.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// The path.
    pub path: Path,
    /// Index of the lane of the route that it was laid on.
    pub lane: usize,
    /// How many attempts with gentler limits had come before in this cycle.
    pub attempt: usize,
    /// Total cost, m of detour. A lower bound where no speed was found on it: its delay is not known then.
    pub cost: f64,
    /// Cost by term.
    pub terms: CostTerms,
    /// Why it was not taken; `None` for the chosen one alone.
    pub rejected: Option<Rejection>,
}

/// Why a candidate was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rejection {
    /// `curve_speed_infeasible`: it bends more than the speed allows that is left after braking comfortably from here.
    CurveSpeedInfeasible,
    /// `blocked_at_start`: what blocks it is so near that a moving vehicle has not even one cell of way.
    BlockedAtStart,
    /// `cannot_stop`: even the hardest braking of this attempt needs more way than there is.
    CannotStop,
    /// `no_proof`: the search of its speed ended, and no speed profile along it has a proven stop.
    NoProof,
    /// `no_proof_in_budget`: the search spent its expansions before it found a proven stop.
    NoProofInBudget,
    /// `no_profile`: the speeds found do not make a profile; a fault of the search, told and survived.
    NoProfile,
    /// `reverification_failed`: its searched profile failed when it was proved again by other code; a fault of the search, told and
    /// survived.
    ReverificationFailed,
    /// `higher_cost`: another candidate with a proven stop costs less. Where its cost was above that one's before, its speed
    /// was not searched.
    HigherCost,
    /// `below_switching_threshold`: the best of its cycle, and not worth leaving the final approach of the plan in force.
    BelowSwitchingThreshold,
}

impl Rejection {
    /// Every reason, in the order in which they are checked.
    pub const ALL: [Self; 9] = [
        Self::CurveSpeedInfeasible,
        Self::BlockedAtStart,
        Self::CannotStop,
        Self::NoProof,
        Self::NoProofInBudget,
        Self::NoProfile,
        Self::ReverificationFailed,
        Self::HigherCost,
        Self::BelowSwitchingThreshold,
    ];

    /// The stable code used in reports.
    #[must_use]
    pub fn code(self) -> &'static str {
        match self {
            Self::CurveSpeedInfeasible => "curve_speed_infeasible",
            Self::BlockedAtStart => "blocked_at_start",
            Self::CannotStop => "cannot_stop",
            Self::NoProof => "no_proof",
            Self::NoProofInBudget => "no_proof_in_budget",
            Self::NoProfile => "no_profile",
            Self::ReverificationFailed => "reverification_failed",
            Self::HigherCost => "higher_cost",
            Self::BelowSwitchingThreshold => "below_switching_threshold",
        }
    }

    /// Whether the candidate could not be taken; if not, it could, and there was a better one.
    #[must_use]
    pub fn is_refusal(self) -> bool {
        !matches!(self, Self::HigherCost | Self::BelowSwitchingThreshold)
    }
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.code())
    }
}

impl Cycle {
    /// What was committed and why, in one line.
    #[must_use]
    pub fn summary(&self) -> String {
        let rejected = || {
            let counts = Rejection::ALL.map(|why| (why, self.rejections(why)));
            let counts = counts.iter().filter(|(_, count)| *count > 0).map(|(why, count)| format!("{count} {why}"));
            counts.collect::<Vec<_>>().join(", ")
        };
        let no_proof = || match rejected() {
            counts if counts.is_empty() => "no candidate".to_owned(),
            counts => format!("no candidate has a proven stop ({counts})"),
        };
        match self.decision {
            Decision::NewPlan { deceleration } => {
                let candidate = self.chosen.and_then(|i| self.candidates.get(i));
                let what = candidate.map_or_else(String::new, |c| format!(" lane {}, cost {:.2},", c.lane, c.cost));
                let stop = self.committed.profile.last().station - self.committed.at(self.time).station;
                let robust = if self.is_robust { ", robust" } else { "" };
                format!("new plan:{what} proven stop at {stop:.1} m with at most {deceleration:.1} m/s²{robust}")
            }
            Decision::KeepPrevious if self.rejections(Rejection::BelowSwitchingThreshold) > 0 => {
                "keep previous plan: the best candidate is below the switching threshold".to_owned()
            }
            Decision::KeepPrevious => format!("keep previous plan: {}", no_proof()),
            Decision::Unproven => format!("emergency braking: no plan was ever proven, {}", no_proof()),
        }
    }

    /// How many candidates were rejected for a reason.
    #[must_use]
    pub fn rejections(&self, reason: Rejection) -> usize {
        self.candidates.iter().filter(|c| c.rejected == Some(reason)).count()
    }
}

impl Decision {
    /// The stable name used in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NewPlan { .. } => "new_plan",
            Self::KeepPrevious => "keep_previous",
            Self::Unproven => "unproven",
        }
    }
}

/// What became of the smoothing of a committed profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Smoothing {
    /// Within the comfortable jerk, and proved again.
    Comfortable,
    /// No profile within the comfortable jerk could be proved; this one is within the firm jerk, and was proved again.
    Firm,
    /// The searched profile stands, proved again: its acceleration jumps. Says why no smooth one does.
    Unsmoothed(smoothing::Failure),
    /// NoPlan was ever proven: braking as hard as the tyres allow.
    EmergencyStop,
}

impl Smoothing {
    /// The stable codes used in reports.
    pub const CODES: [&'static str; 4] = ["comfortable", "firm", "unsmoothed", "emergency_stop"];

    /// The stable code used in reports.
    #[must_use]
    pub fn code(self) -> &'static str {
        match self {
            Self::Comfortable => "comfortable",
            Self::Firm => "firm",
            Self::Unsmoothed(_) => "unsmoothed",
            Self::EmergencyStop => "emergency_stop",
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rejection_has_a_code_of_its_own() {
        let mut codes: Vec<&str> = Rejection::ALL.iter().map(|r| r.code()).collect();
        assert!(codes.iter().all(|c| c.chars().all(|c| c.is_ascii_lowercase() || c == '_')), "{codes:?}");
        codes.sort_unstable();
        codes.dedup();
        assert_eq!(codes.len(), Rejection::ALL.len());
        assert!(Rejection::ALL.windows(2).all(|w| w[0] < w[1]), "every one once, in order");
        assert_eq!(Rejection::ALL[8], Rejection::BelowSwitchingThreshold, "the last one is in the list");
    }

    #[test]
    fn the_summary_says_what_was_committed_and_why() {
        use crate::fixtures::{cycle, knot, straight};
        let profile = crate::trajectory::SpeedProfile::new(vec![knot(0.0, 0.0, 8.0, -1.0), knot(8.0, 32.0, 0.0, 0.0)]);
        let path = straight(crate::geometry::Pose::new(0.0, 0.0, 0.0), 40.0);
        let committed = Trajectory { start_time: 0.0, path: path.clone(), profile: profile.unwrap() };
        let mut record = cycle(2.0, committed);
        // after 2 s at 1 m/s² from 8 m/s the vehicle is at 14 m
        assert_eq!(record.summary(), "new plan: proven stop at 18.0 m with at most 1.5 m/s²");
        let candidate = |rejected, cost| Candidate {
            path: path.clone(),
            lane: 1,
            attempt: 0,
            cost,
            terms: CostTerms::default(),
            rejected,
        };
        record.candidates = vec![candidate(Some(Rejection::NoProof), 1.0), candidate(None, 3.214)];
        (record.chosen, record.is_robust) = (Some(1), true);
        let summary = "new plan: lane 1, cost 3.21, proven stop at 18.0 m with at most 1.5 m/s², robust";
        assert_eq!(record.summary(), summary);
        (record.decision, record.chosen) = (Decision::KeepPrevious, None);
        record.candidates = vec![
            candidate(Some(Rejection::NoProof), 1.0),
            candidate(Some(Rejection::BlockedAtStart), 1.0),
            candidate(Some(Rejection::NoProof), 1.0),
        ];
        let summary = "keep previous plan: no candidate has a proven stop (1 blocked_at_start, 2 no_proof)";
        assert_eq!(record.summary(), summary);
        record.candidates.push(candidate(Some(Rejection::BelowSwitchingThreshold), 1.0));
        assert_eq!(record.summary(), "keep previous plan: the best candidate is below the switching threshold");
        (record.decision, record.candidates) = (Decision::Unproven, Vec::new());
        assert_eq!(record.summary(), "emergency braking: no plan was ever proven, no candidate");
    }
}
