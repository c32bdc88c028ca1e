//! Hysteresis: the one rule that decides when a new plan replaces the committed one.
//!
//! **Comparison.** In every cycle the committed plan is among the candidates: its present edge is a root of the lattice
//! ([`CommittedPlan::kept`]), and the following edges connect nodes that are fixed to the road. Candidates are compared by
//! their total cost, which includes a cost of leaving the committed plan.
//!
//! **Cost of leaving.** `planner.lattice.weights.plan_change` per metre of [`CommittedPlan::departure`], the largest lateral
//! distance from the committed plan over their common length.
//!
//! **Stability.** Let A be committed, B another plan, d their distance and p = plan_change · d. B replaces A if
//! cost(B) + p < cost(A). A replaces B again only if cost(A) + p < cost(B). Between both switches the difference of the costs
//! must change by 2p, so that smaller fluctuations never cause a switch. The distance is the maximum and not the mean: two
//! plans that separate late differ as much as two that separate now, and every departure that the plan-switch metric counts
//! costs at least half of `plan_change`.
//!
//! **A committed path missing from the candidates.** The search can miss the committed path in a cycle, because its
//! discretisation is coarser than the plan. Then the cheapest candidate replaces the committed plan only if it costs less
//! than keeping it. Keeping it needs no new proof: the plan has one up to its standstill (`Planner::staying`).
//!
//! **At a stop.** In the final approach a new plan must soon get a metre farther
//! ([`CommittedPlan::is_worth_leaving`]). So the planner does not replan a stop by centimetres and does not prolong it by a
//! plan that creeps until the path is free.
//!
//! Weak: if the committed plan passes nodes that the present layers do not contain, its continuation is only approximately
//! among the candidates, and all of them pay a small cost. A committed path that is blocked by now is left at any cost.

use super::candidate::{Situation, TRAVEL_TIME_HORIZON};
use super::choice::Choice;
use super::level::LevelLimits;
use super::record::Rejection;
use super::{Committed, CycleRecord, Planner, Start};
use crate::geometry::Pose;
use crate::geometry::spiral::{CubicSpiral, PathPoint};
use crate::geometry::steps::fitting;
use crate::lattice::rank;
use crate::lattice::refine::Commitment;
use crate::trajectory::{Path, Trajectory, TrajectoryPoint};

/// The committed plan, from a point on it.
pub(super) struct CommittedPlan<'a> {
    plan: &'a Trajectory,
    pose: Pose,
    /// Station of that point on the path of the plan, m.
    station: f64,
    /// Station at which the plan took effect, m.
    begins: f64,
}

/// Distance between compared points, m.
const SPACING: f64 = 5.0;
/// The cost of leaving saturates at this departure, m: about the width of a lane.
const MAX_DEPARTURE: f64 = 3.5;
/// A path with a smaller departure is the committed path, m.
pub(super) const SAME_PATH: f64 = 0.5;
/// Distance to standstill at which the final approach begins, m.
const FINAL_APPROACH: f64 = 4.0;
/// Smallest additional progress for which a plan replaces the final approach, m.
const WORTH_MOVING: f64 = 1.0;

impl<'a> CommittedPlan<'a> {
    /// `begins`: length of the lead, m.
    pub(super) fn new(plan: &'a Trajectory, begins: f64, here: &TrajectoryPoint) -> Self {
        Self { plan, pose: here.pose, station: here.station, begins }
    }

    /// The remainder of the present edge with its end; `None` if it is too short to keep.
    pub(super) fn kept(&self) -> Option<(PathPoint, Vec<CubicSpiral>)> {
        /// Shorter remainders are replanned from the start, m.
        const WORTH_KEEPING: f64 = 1.0;
        let (station, _, spiral) = self.plan.path.pieces().take_while(|(s, ..)| *s <= self.station).last()?;
        let from = self.station - station;
        let remainder = (spiral.length - from > WORTH_KEEPING).then(|| spiral.part(from, spiral.length))?;
        Some((remainder.point_at(&self.pose, remainder.length), vec![remainder]))
    }

    /// Departure of a path from the committed plan: their largest lateral distance over their common length, m.
    pub(super) fn departure(&self, path: &Path) -> f64 {
        self.commitment(path, 1.0).cost(path)
    }

    /// The cost of leaving the committed plan for a path and its refinements, with a weight per metre of
    /// [`CommittedPlan::departure`].
    pub(super) fn commitment(&self, path: &Path, weight: f64) -> Commitment {
        let common = (self.plan.path.length() - self.station).min(path.length());
        let compared = (1..=fitting(common, SPACING)).map(|i| SPACING * i as f64);
        let poses = compared.map(|ahead| (ahead, self.plan.path.at(self.station + ahead).pose)).collect();
        Commitment { poses, weight, max_distance: MAX_DEPARTURE }
    }

    /// Whether a path differs from the committed one by more than the discretisation of the search.
    pub(super) fn is_different_path(&self, path: &Path) -> bool {
        self.departure(path) > SAME_PATH
    }

    /// Distance driven on the committed plan since it took effect, m.
    pub(super) fn driven_distance(&self) -> f64 {
        (self.station - self.begins).max(0.0)
    }

    /// Progress of the committed plan from here at a time (s of the run), m.
    pub(super) fn progress(&self, time: f64) -> f64 {
        self.plan.at(time).station - self.station
    }

    /// Whether a plan may replace the committed one, given its station after the travel-time horizon or at its standstill
    /// (m from here). Always, except in the final approach.
    pub(super) fn is_worth_leaving(&self, soon_at: f64) -> bool {
        let to_standstill = self.plan.profile.last().station - self.station;
        to_standstill >= FINAL_APPROACH || soon_at - to_standstill >= WORTH_MOVING
    }
}

impl Planner<'_> {
    /// Whether the choice replaces the committed plan.
    pub(super) fn is_worth_taking(
        &self,
        start: &Start,
        level: LevelLimits,
        choice: &Choice,
        record: &mut CycleRecord,
    ) -> bool {
        let soon = choice.proven.raw_profile.last().station.min(choice.proven.progress);
        let proven = self.committed.as_ref().filter(|c| c.level.is_proven());
        let worth = committed_plan(proven, start).is_none_or(|plan| {
            plan.is_worth_leaving(soon)
                && (!plan.is_different_path(&choice.path.path)
                    || self
                        .staying(start, level, choice, &plan)
                        .is_none_or(|staying| rank(choice.cost) < rank(staying)))
        });
        if !worth {
            record.reject(choice.candidate, Rejection::BelowSwitchingThreshold);
        }
        worth
    }

    /// Cost of keeping the committed plan: the cost of its path when it was chosen, the progress shortfall since then, and
    /// its travel time from here. `None` if its proof brakes harder or is weaker than that of the choice.
    fn staying(&self, start: &Start, level: LevelLimits, choice: &Choice, plan: &CommittedPlan<'_>) -> Option<f64> {
        let is_as_safe = |c: &&Committed| {
            c.level.is_as_safe_as(level.level)
                && c.deceleration <= choice.proven.hardest_deceleration()
                && c.robust >= level.robust
        };
        let committed = self.committed.as_ref().filter(is_as_safe)?;
        let lane = self.lanes.as_ref().ok()?.get(choice.lane)?;
        let weights = &self.settings.lattice.weights;
        let behind = self.situation(start, lane, level).behind(start, plan);
        Some(
            committed.path_cost
                + weights.progress_shortfall * plan.driven_distance()
                + weights.travel_time * behind.max(0.0),
        )
    }
}

impl Situation<'_> {
    /// How far the committed plan is behind unobstructed driving within the travel-time horizon, m.
    pub(super) fn behind(&self, start: &Start, plan: &CommittedPlan<'_>) -> f64 {
        self.free_progress() - plan.progress(start.point.time + TRAVEL_TIME_HORIZON)
    }
}

/// The committed plan, if planning starts on it.
pub(super) fn committed_plan<'c>(committed: Option<&'c Committed>, start: &Start) -> Option<CommittedPlan<'c>> {
    committed.filter(|_| start.on_plan).map(|c| CommittedPlan::new(&c.trajectory, c.lead, &start.point))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{knot, straight};
    use crate::trajectory::SpeedProfile;

    /// Straight along x in pieces of 20 m, to standstill at 60 m.
    fn plan() -> Trajectory {
        let path = Path::new(Pose::new(0.0, 0.0, 0.0), &[CubicSpiral::straight(20.0); 4]).unwrap();
        let profile = SpeedProfile::new(vec![knot(0.0, 0.0, 10.0, 0.0), knot(6.0, 60.0, 0.0, 0.0)]).unwrap();
        Trajectory { start_time: 0.0, path, profile }
    }

    fn at_station(plan: &Trajectory, station: f64) -> CommittedPlan<'_> {
        CommittedPlan { plan, pose: plan.path.at(station).pose, station, begins: 0.0 }
    }

    fn straight_from(x: f64, y: f64, yaw: f64) -> Path {
        straight(Pose::new(x, y, yaw), 60.0)
    }

    #[test]
    fn departure_is_zero_for_the_plan_itself_and_else_the_largest_lateral_distance() {
        let plan = plan();
        for station in [0.0, 7.3, 19.9, 33.0] {
            let here = at_station(&plan, station);
            assert!(here.departure(&straight_from(station, 0.0, 0.0)) < 1e-12);
            let (left, right) = (straight_from(station, 0.0, 0.05), straight_from(station, 0.0, -0.05));
            let reach = SPACING * ((80.0 - station).min(60.0) / SPACING).floor();
            assert!((here.departure(&left) - reach * 0.05_f64.sin()).abs() < 1e-9);
            assert_eq!(here.departure(&left), here.departure(&right));
        }
        assert_eq!(at_station(&plan, 10.0).departure(&straight_from(10.0, 0.0, 0.5)), MAX_DEPARTURE);
        // no common length
        assert_eq!(at_station(&plan, 79.0).departure(&straight_from(79.0, 0.0, 0.5)), 0.0);
    }

    #[test]
    fn keeps_the_remainder_of_the_present_edge() {
        let plan = plan();
        let (end, kept) = at_station(&plan, 27.0).kept().unwrap();
        assert!((kept[0].length - 13.0).abs() < 1e-9 && (end.pose.position.x - 40.0).abs() < 1e-9);
        assert!(at_station(&plan, 39.5).kept().is_none(), "half a metre is too short");
    }

    #[test]
    fn paths_differ_above_the_tolerance() {
        let plan = plan();
        let here = at_station(&plan, 10.0);
        for side in [-1.0, 1.0] {
            assert!(!here.is_different_path(&straight_from(10.0, side * 0.4, 0.0)));
            assert!(here.is_different_path(&straight_from(10.0, side * 0.6, 0.0)));
        }
    }

    #[test]
    fn progress_starts_at_the_present_station_and_ends_at_standstill() {
        let plan = plan();
        let here = at_station(&plan, 10.0);
        assert_eq!(here.driven_distance(), 10.0);
        let standstill = plan.profile.last().station;
        assert_eq!(here.progress(100.0), standstill - 10.0);
        assert!(here.progress(2.0) < here.progress(3.0));
    }

    #[test]
    fn only_sufficient_progress_ends_a_final_approach() {
        let plan = plan();
        let far = at_station(&plan, 40.0);
        assert!(far.is_worth_leaving(10.0), "twenty metres before standstill every plan may replace it");
        let near = at_station(&plan, 57.0);
        assert!(!near.is_worth_leaving(3.5) && !near.is_worth_leaving(0.0));
        assert!(near.is_worth_leaving(4.5));
    }

    /// Two paths with alternating costs: the plan changes only if their difference changes by twice the cost of leaving.
    #[test]
    fn cost_fluctuations_below_twice_the_leaving_cost_never_change_the_plan() {
        let (a, b) = (straight_from(0.0, 0.0, 0.0), straight_from(0.0, 0.0, 0.02));
        let profile = SpeedProfile::new(vec![knot(0.0, 0.0, 1.0, 0.0), knot(1.0, 50.0, 0.0, 0.0)]).unwrap();
        let switches = |amplitude: f64, weight: f64| {
            let mut committed_plan = &a;
            let mut count = 0;
            for cycle in 0..100 {
                let plan = Trajectory { start_time: 0.0, path: committed_plan.clone(), profile: profile.clone() };
                let here = at_station(&plan, 0.0);
                let cost_a = weight * here.departure(&a);
                let cost_b = amplitude * f64::from(cycle).sin() + weight * here.departure(&b);
                let best = if cost_b < cost_a { &b } else { &a };
                count += usize::from(best != committed_plan);
                committed_plan = best;
            }
            count
        };
        let apart = 60.0 * 0.02_f64.sin();
        assert!(switches(0.99 * apart, 0.0) > 20);
        assert_eq!(switches(0.99 * apart, 1.0), 0);
        assert!(switches(1.5 * apart, 1.0) > 0, "a better path must replace the plan");
    }
}
