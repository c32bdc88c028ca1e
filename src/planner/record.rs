//! Records of planning cycles, for reports, pictures and recordings.

use std::fmt;

use super::Level;
use crate::collision::Blocker;
use crate::geometry::Point;
use crate::lattice::{CostTerms, EdgeCounts};
use crate::number::Short;
use crate::speed::smoothing;
use crate::trajectory::{Path, Trajectory};

/// The result of a planning cycle: what to drive until the next one, and what it claims.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Time of the cycle, s of the run.
    pub time: f64,
    /// The trajectory that is committed from this time on: a new one, or the previous one if it was verified.
    pub trajectory: Trajectory,
    /// The decision of the cycle.
    pub decision: Decision,
    /// The level on which the stop of the plan is proven, as of this cycle.
    pub level: Level,
    /// Largest deceleration of the plan and of its proof, m/s².
    pub deceleration: f64,
    /// Whether the stop is proven for all obstacle motions within the bounds of [`crate::planner::Uncertainty`]. If not, it is
    /// proven for the predicted motions only. Always `false` with [`crate::planner::UncertaintyMode::Off`].
    pub is_robust: bool,
    /// Outcome of smoothing the speed profile.
    pub smoothing: Smoothing,
    /// What limits the speed within the next seconds; `None` if the vehicle accelerates freely.
    pub limited_by: Option<Cause>,
    /// What the plan will stop for, or, without a proof, what stands in the way of one. `None` if its end is only the fallback
    /// of a plan that goes on.
    pub stops_for: Option<Cause>,
    /// The first contact to expect on a plan without a proof; `None` if there is none or the plan is proven.
    pub expected_contact: Option<ExpectedContact>,
}

/// How the result of a planning cycle came about, for reports, pictures and recordings.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trace {
    /// Sampled reference line of the chosen lane, m; empty unless a new plan was committed.
    pub reference: Vec<Point>,
    /// The candidate paths, in a deterministic order.
    pub candidates: Vec<Candidate>,
    /// Cells of the committed path that moving obstacles block.
    pub blocked: Vec<BlockedCell>,
    /// Index of the chosen candidate in `candidates`, also of one that evades without a proof; `None` if the previous plan is
    /// kept or the vehicle only brakes.
    pub chosen: Option<usize>,
    /// Counts of lattice edges by outcome, over all lanes and attempts.
    pub edges: EdgeCounts,
    /// Expansions of the speed search, over all candidates.
    pub expansions: usize,
    /// Whether the committed path was refined; if not, it consists of lattice edges.
    pub is_refined: bool,
    /// Wall-clock times of the stages, s. Not part of any hash.
    pub stage_seconds: StageSeconds,
}

/// A planning cycle: its result and how it came about.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle {
    /// The result.
    pub plan: Plan,
    /// How it came about.
    pub trace: Trace,
}

/// A part of a path that a moving obstacle blocks for some time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockedCell {
    /// First and last station on the path, m.
    pub stations: (f64, f64),
    /// Start and end, s of the run.
    pub times: (f64, f64),
    /// Id of the obstacle.
    pub obstacle: i64,
}

impl BlockedCell {
    /// The cell on a path that begins earlier by some metres.
    pub(super) fn moved(&self, by: f64) -> Self {
        Self { stations: (self.stations.0 + by, self.stations.1 + by), ..*self }
    }
}

/// What limits a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// An obstacle, by its id.
    Obstacle(i64),
    /// A cell of the occupancy grid.
    OccupiedCell,
    /// The path leaves the road there.
    RoadBoundary,
    /// The known road ends there.
    RoadEnd,
    /// The goal, its speed or its time window.
    Goal,
    /// The last place for a lane change to the goal.
    LaneChange,
    /// A speed limit of the road.
    SpeedLimit,
    /// A bend of the path.
    Bend,
    /// The cruise speed.
    CruiseSpeed,
}

impl From<Blocker> for Cause {
    fn from(blocker: Blocker) -> Self {
        match blocker {
            Blocker::Obstacle(id) => Self::Obstacle(id),
            Blocker::OccupiedCell => Self::OccupiedCell,
            Blocker::RoadBoundary => Self::RoadBoundary,
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Obstacle(id) => return write!(f, "obstacle {id}"),
            Self::OccupiedCell => "an occupied cell",
            Self::RoadBoundary => "the road boundary",
            Self::RoadEnd => "the end of the road",
            Self::Goal => "the goal",
            Self::LaneChange => "a lane change to the goal",
            Self::SpeedLimit => "the speed limit",
            Self::Bend => "a bend",
            Self::CruiseSpeed => "the cruise speed",
        })
    }
}

/// Decision of a cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Decision {
    /// A new plan was committed; its stop is proven.
    NewPlan,
    /// The previous plan continues: its stop was proven again for what is known now, and no new plan was better.
    KeepPrevious,
    /// The previous plan continues: its stop was proven again, it was compared with others a moment ago, and no other plan was looked
    /// for.
    Continue,
    /// No proven plan exists: the committed plan evades or makes the first contact late and slow.
    Unproven,
}

/// The first contact on a plan without a proof.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExpectedContact {
    /// What it is with.
    pub what: Blocker,
    /// Time, s of the run.
    pub time: f64,
    /// Speed of the vehicle, m/s.
    pub speed: f64,
}

impl fmt::Display for ExpectedContact {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "contact with {} expected at {:.2} s at {:.1} m/s", self.what, self.time, Short(self.speed))
    }
}

/// One candidate path.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// The path.
    pub path: Path,
    /// Index of the lane of the route.
    pub lane: usize,
    /// Index of the attempt in this cycle, from 0; each attempt permits more than the one before.
    pub attempt: usize,
    /// Total cost, m of detour. A lower bound without `travel_time` if the candidate has no speed profile.
    pub cost: f64,
    /// Cost by term.
    pub terms: CostTerms,
    /// What stands in its way: the first static blocker, else the first moving one; `None` if it is free or was not searched.
    pub blocked_by: Option<Cause>,
    /// Reason of the rejection; `None` only for the chosen candidate.
    pub rejected: Option<Rejection>,
}

/// Reason why a candidate was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rejection {
    /// `curve_speed_infeasible`: a curve is too tight for the speed that remains after comfortable braking.
    CurveSpeedInfeasible,
    /// `blocked_at_start`: a blocker is so near that not even one station cell is free for the moving vehicle.
    BlockedAtStart,
    /// `cannot_stop`: the stopping distance at the hardest braking of this attempt exceeds the free length.
    CannotStop,
    /// `no_proof`: the speed search was exhausted; no speed profile along the path has a proven stop.
    NoProof,
    /// `no_proof_in_budget`: the speed search reached its limit of expansions without a proven stop.
    NoProofInBudget,
    /// `no_profile`: the speeds of the search do not form a valid profile. This is a fault of the search.
    NoProfile,
    /// `reverification_failed`: an independent check of the raw profile failed. This is a fault of the search.
    ReverificationFailed,
    /// `not_drivable`: the trajectory demands more than the vehicle can follow: grip, speed, steering rate or curvature.
    NotDrivable,
    /// `tube_blocked`: something is within the tracking errors to expect on the plan.
    TubeBlocked,
    /// `higher_cost`: another candidate of the same attempt has a stop and costs less. No speed search ran if the lower bound of
    /// the cost was already higher. In a cycle without a proof the attempt is one to evade: the stop of the cheaper candidate,
    /// the chosen one, needs all that vehicle and road give, without the reserve of a proof.
    HigherCost,
    /// `below_switching_threshold`: the cheapest candidate of its cycle, but its advantage over the committed plan is below
    /// the switching threshold.
    BelowSwitchingThreshold,
}

impl Rejection {
    /// Every reason, in the order of the checks.
    pub const ALL: [Self; 11] = [
        Self::CurveSpeedInfeasible,
        Self::BlockedAtStart,
        Self::CannotStop,
        Self::NoProof,
        Self::NoProofInBudget,
        Self::NoProfile,
        Self::ReverificationFailed,
        Self::NotDrivable,
        Self::TubeBlocked,
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
            Self::NotDrivable => "not_drivable",
            Self::TubeBlocked => "tube_blocked",
            Self::HigherCost => "higher_cost",
            Self::BelowSwitchingThreshold => "below_switching_threshold",
        }
    }

    /// Whether the candidate is infeasible or unproven; `false` for a feasible candidate that was not preferred.
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
        let refused = || {
            let counts = Rejection::ALL.map(|why| (why, self.trace.rejections(why)));
            let counts = counts.iter().filter(|(why, count)| *count > 0 && why.is_refusal());
            counts.map(|(why, count)| format!("{count} {why}")).collect::<Vec<_>>().join(", ")
        };
        let no_proof = || match refused() {
            _ if self.trace.candidates.is_empty() => "no candidate".to_owned(),
            counts if counts.is_empty() => "no candidate has a proven stop".to_owned(),
            counts => format!("no candidate has a proven stop ({counts})"),
        };
        let chosen = || self.trace.chosen.and_then(|i| self.trace.candidates.get(i));
        match self.plan.decision {
            Decision::NewPlan => {
                let deceleration = self.plan.deceleration;
                let what = chosen().map_or_else(String::new, |c| format!(" lane {}, cost {:.2},", c.lane, c.cost));
                let stop =
                    self.plan.trajectory.profile.last().station - self.plan.trajectory.at(self.plan.time).station;
                let robust = if self.plan.is_robust { ", robust" } else { "" };
                let why = self.plan.stops_for.map_or_else(String::new, |cause| format!(" for {cause}"));
                format!("new plan:{what} proven stop at {stop:.1} m{why} with at most {deceleration:.1} m/s²{robust}")
            }
            Decision::KeepPrevious if self.trace.rejections(Rejection::BelowSwitchingThreshold) > 0 => {
                "keep previous plan: the best candidate is below the switching threshold".to_owned()
            }
            Decision::KeepPrevious => format!("keep previous plan: {}", no_proof()),
            Decision::Continue => "continue: the plan holds, and was compared with others a moment ago".to_owned(),
            Decision::Unproven => {
                let contact = match &self.plan.expected_contact {
                    Some(contact) => contact.to_string(),
                    None => "no contact expected".to_owned(),
                };
                let evades = chosen().map_or_else(String::new, |c| {
                    format!("; evades on lane {}, cost {:.2}, without the reserve of a proof", c.lane, c.cost)
                });
                format!("unproven: {contact}{evades}; {}", no_proof())
            }
        }
    }
}

impl Trace {
    /// Number of candidates that were rejected for this reason.
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
            Self::NewPlan => "new_plan",
            Self::KeepPrevious => "keep_previous",
            Self::Continue => "continue",
            Self::Unproven => "unproven",
        }
    }
}

/// Outcome of smoothing a committed speed profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Smoothing {
    /// The profile respects the comfortable jerk limit and passed reverification.
    Comfortable,
    /// No profile within the comfortable jerk limit was proven; this one respects the firm jerk limit and passed
    /// reverification.
    Firm,
    /// The raw profile of the search, which passed reverification. Its acceleration has steps. Contains the reason why
    /// smoothing failed.
    Unsmoothed(smoothing::Failure),
    /// No plan is proven: the raw profile, or full braking.
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
    /// Lattice search, with its static collision checks.
    pub lattice: f64,
    /// Collision checks outside the lattice.
    pub collision: f64,
    /// Speed search of all candidates.
    pub speed: f64,
    /// Refinement of the chosen path, with its speed search.
    pub refinement: f64,
    /// Smoothing of the speed profile, with its proof.
    pub smoothing: f64,
    /// The whole cycle.
    pub total: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rejection_has_a_unique_code() {
        let mut codes: Vec<&str> = Rejection::ALL.iter().map(|r| r.code()).collect();
        assert!(codes.iter().all(|c| c.chars().all(|c| c.is_ascii_lowercase() || c == '_')), "{codes:?}");
        codes.sort_unstable();
        codes.dedup();
        assert_eq!(codes.len(), Rejection::ALL.len());
        assert!(Rejection::ALL.windows(2).all(|w| w[0] < w[1]), "duplicate or out of order");
        assert_eq!(Rejection::ALL[10], Rejection::BelowSwitchingThreshold, "the last reason is missing");
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
            blocked_by: None,
            rejected,
        };
        record.trace.candidates = vec![candidate(Some(Rejection::NoProof), 1.0), candidate(None, 3.214)];
        (record.trace.chosen, record.plan.is_robust) = (Some(1), true);
        let summary = "new plan: lane 1, cost 3.21, proven stop at 18.0 m with at most 1.5 m/s², robust";
        assert_eq!(record.summary(), summary);
        (record.plan.decision, record.trace.chosen) = (Decision::KeepPrevious, None);
        record.trace.candidates = vec![
            candidate(Some(Rejection::NoProof), 1.0),
            candidate(Some(Rejection::BlockedAtStart), 1.0),
            candidate(Some(Rejection::NoProof), 1.0),
        ];
        let summary = "keep previous plan: no candidate has a proven stop (1 blocked_at_start, 2 no_proof)";
        assert_eq!(record.summary(), summary);
        record.trace.candidates.push(candidate(Some(Rejection::BelowSwitchingThreshold), 1.0));
        assert_eq!(record.summary(), "keep previous plan: the best candidate is below the switching threshold");
        (record.plan.decision, record.trace.candidates) = (Decision::Unproven, Vec::new());
        assert_eq!(record.summary(), "unproven: no contact expected; no candidate");
        record.trace.candidates = vec![
            candidate(Some(Rejection::CannotStop), 1.0),
            candidate(Some(Rejection::HigherCost), 4.0),
            candidate(None, 3.214),
        ];
        record.trace.chosen = Some(2);
        let summary = "unproven: no contact expected; evades on lane 1, cost 3.21, without the reserve of a proof; \
                       no candidate has a proven stop (1 cannot_stop)";
        assert_eq!(record.summary(), summary);
    }
}
