//! When the plan in force is left for another: the one place that decides it.
//!
//! **What is compared.** In every cycle the plan in force is among the candidates: the edge that is being driven is kept
//! as a root of the lattice ([`CommittedPlan::kept`]), and what follows it lies on nodes that stay where they are. Every
//! candidate is compared by its whole cost with every other; one that leaves the plan in force pays for it.
//!
//! **The price** is `planner.lattice.weights.plan_change` for each metre of [`CommittedPlan::departure`], the largest distance
//! beside the plan in force over the way that both have ahead.
//!
//! **Why it can't flicker.** Let A be in force, B another, d between them and p = switching · d. B is taken when
//! cost(B) + p < cost(A); then A is taken again only when cost(A) + p < cost(B). Between the two, the difference of
//! their costs has to change by 2p: what changes by less, however often it turns, changes nothing. The distance is the
//! largest one, not a mean, because two plans that part late are as different to those who watch as two that part now;
//! and because the distance that the metric of plan switches counts from costs half a `switching` at least.
//!
//! **A way not found again.** The search may miss the way in force in a cycle, because its steps are coarser than the plan
//! they would have to find. Then every candidate is another way, and the cheapest of them is taken only if it costs less
//! than going on as planned, which needs no new proof: the plan in force has one up to its rest (`Planner::staying`).
//!
//! **At a stop** there is nothing to choose between: in the final approach a plan is left only for one that soon gets
//! farther by a metre ([`CommittedPlan::is_worth_leaving`]), so that a stop is not re-planned centimetre by centimetre, nor drawn
//! out by one that would creep until the way is free.
//!
//! Weak: where the plan in force was laid through nodes that the present layers leave out, its continuation is only
//! nearly among the candidates, and all of them pay a little. A way blocked since is left at any price.

use crate::geometry::Pose;
use crate::geometry::spiral::{CubicSpiral, PathPoint};
use crate::lattice::refine::Commitment;
use crate::trajectory::{Path, Trajectory, TrajectoryPoint};

/// The plan in force, seen from a point on it.
pub(super) struct CommittedPlan<'a> {
    plan: &'a Trajectory,
    pose: Pose,
    /// Station of that point on the plan's path, m.
    station: f64,
}

/// Distance between compared points, m.
const SPACING: f64 = 5.0;
/// Departures beyond this cost no more, m: a lane's width is another way, and so is more.
const ANOTHER_WAY: f64 = 3.5;
/// A path that departs by less is the way in force found anew, m.
const SAME_WAY: f64 = 0.5;
/// Distance to rest within which a stop counts as the final approach, m.
const FINAL_APPROACH: f64 = 4.0;
/// Less progress than this is not worth leaving the final approach for, m.
const WORTH_MOVING: f64 = 1.0;

impl<'a> CommittedPlan<'a> {
    pub(super) fn new(plan: &'a Trajectory, here: &TrajectoryPoint) -> Self {
        Self { plan, pose: here.pose, station: here.station }
    }

    /// The rest of the edge that is being driven, with where it ends, if it is long enough to be worth keeping.
    pub(super) fn kept(&self) -> Option<(PathPoint, Vec<CubicSpiral>)> {
        /// Shorter rests are left to the fresh root, m.
        const WORTH_KEEPING: f64 = 1.0;
        let (station, _, spiral) = self.plan.path.pieces().take_while(|(s, ..)| *s <= self.station).last()?;
        let from = self.station - station;
        let rest = (spiral.length - from > WORTH_KEEPING).then(|| spiral.part(from, spiral.length))?;
        Some((rest.point_at(&self.pose, rest.length), vec![rest]))
    }

    /// How far a path from here on leaves the plan in force: the largest distance beside it over the way that both have
    /// ahead, m.
    pub(super) fn departure(&self, path: &Path) -> f64 {
        self.commitment(path, 1.0).cost(path)
    }

    /// What a path and its refinements pay for leaving the plan in force, at a price per metre of [`CommittedPlan::departure`].
    pub(super) fn commitment(&self, path: &Path, price: f64) -> Commitment {
        let both = (self.plan.path.length() - self.station).min(path.length());
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count of points
        let points = (both / SPACING).max(0.0) as usize;
        let compared = (1..=points).map(|i| SPACING * i as f64);
        let poses = compared.map(|ahead| (ahead, self.plan.path.at(self.station + ahead).pose)).collect();
        Commitment { poses, price, most: ANOTHER_WAY }
    }

    /// Whether a path from here on is another way than the plan in force, not the same one found anew.
    pub(super) fn is_another_way(&self, path: &Path) -> bool {
        self.departure(path) > SAME_WAY
    }

    /// How far the plan in force was driven since it was taken, m.
    pub(super) fn driven(&self) -> f64 {
        self.station
    }

    /// How far it will have come at a time (s of the run), m from here.
    pub(super) fn progress(&self, time: f64) -> f64 {
        self.plan.at(time).station - self.station
    }

    /// Whether a plan that will soon have come to a station (m from here), or have come to rest there, is worth leaving the
    /// plan in force for, close to its stop.
    pub(super) fn is_worth_leaving(&self, soon_at: f64) -> bool {
        let rest = self.plan.profile.last().station - self.station;
        rest >= FINAL_APPROACH || soon_at - rest >= WORTH_MOVING
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{knot, straight};
    use crate::trajectory::SpeedProfile;

    /// Straight on along x in pieces of 20 m, to rest at 60 m.
    fn plan() -> Trajectory {
        let path = Path::new(Pose::new(0.0, 0.0, 0.0), &[CubicSpiral::straight(20.0); 4]).unwrap();
        let profile = SpeedProfile::new(vec![knot(0.0, 0.0, 10.0, 0.0), knot(6.0, 60.0, 0.0, 0.0)]).unwrap();
        Trajectory { start_time: 0.0, path, profile }
    }

    fn seen_from(plan: &Trajectory, station: f64) -> CommittedPlan<'_> {
        CommittedPlan { plan, pose: plan.path.at(station).pose, station }
    }

    fn straight_from(x: f64, y: f64, yaw: f64) -> Path {
        straight(Pose::new(x, y, yaw), 60.0)
    }

    #[test]
    fn the_plan_itself_costs_nothing_however_far_it_is_driven_and_a_parting_way_its_largest_distance() {
        let plan = plan();
        for station in [0.0, 7.3, 19.9, 33.0] {
            let here = seen_from(&plan, station);
            assert!(here.departure(&straight_from(station, 0.0, 0.0)) < 1e-12);
            let (left, right) = (straight_from(station, 0.0, 0.05), straight_from(station, 0.0, -0.05));
            let reach = SPACING * ((80.0 - station).min(60.0) / SPACING).floor();
            assert!((here.departure(&left) - reach * 0.05_f64.sin()).abs() < 1e-9);
            assert_eq!(here.departure(&left), here.departure(&right));
        }
        assert_eq!(seen_from(&plan, 10.0).departure(&straight_from(10.0, 0.0, 0.5)), ANOTHER_WAY);
        // nothing left to compare
        assert_eq!(seen_from(&plan, 79.0).departure(&straight_from(79.0, 0.0, 0.5)), 0.0);
    }

    #[test]
    fn what_is_kept_is_the_rest_of_the_edge_being_driven() {
        let plan = plan();
        let (end, kept) = seen_from(&plan, 27.0).kept().unwrap();
        assert!((kept[0].length - 13.0).abs() < 1e-9 && (end.pose.position.x - 40.0).abs() < 1e-9);
        assert!(seen_from(&plan, 39.5).kept().is_none(), "half a metre is not worth it");
    }

    #[test]
    fn another_way_is_one_that_parts_by_more_than_the_same_way_found_anew() {
        let plan = plan();
        let here = seen_from(&plan, 10.0);
        for side in [-1.0, 1.0] {
            assert!(!here.is_another_way(&straight_from(10.0, side * 0.4, 0.0)));
            assert!(here.is_another_way(&straight_from(10.0, side * 0.6, 0.0)));
        }
    }

    #[test]
    fn progress_counts_from_where_the_plan_is_seen_from_and_ends_at_its_rest() {
        let plan = plan();
        let here = seen_from(&plan, 10.0);
        assert_eq!(here.driven(), 10.0);
        let rests = plan.profile.last().station;
        assert_eq!(here.progress(100.0), rests - 10.0);
        assert!(here.progress(2.0) < here.progress(3.0));
    }

    #[test]
    fn only_real_progress_ends_a_final_approach() {
        let plan = plan();
        let far = seen_from(&plan, 40.0);
        assert!(far.is_worth_leaving(10.0), "twenty metres from rest plans are renewed");
        let near = seen_from(&plan, 57.0);
        assert!(!near.is_worth_leaving(3.5) && !near.is_worth_leaving(0.0));
        assert!(near.is_worth_leaving(4.5));
    }

    /// Two ways whose costs take turns: the choice changes only when their difference has changed by twice the price.
    #[test]
    fn costs_that_waver_by_less_than_twice_the_price_never_change_the_plan() {
        let (a, b) = (straight_from(0.0, 0.0, 0.0), straight_from(0.0, 0.0, 0.02));
        let profile = SpeedProfile::new(vec![knot(0.0, 0.0, 1.0, 0.0), knot(1.0, 50.0, 0.0, 0.0)]).unwrap();
        let switches = |waver: f64, price: f64| {
            let mut committed_plan = &a;
            let mut count = 0;
            for cycle in 0..100 {
                let plan = Trajectory { start_time: 0.0, path: committed_plan.clone(), profile: profile.clone() };
                let here = seen_from(&plan, 0.0);
                let cost_a = price * here.departure(&a);
                let cost_b = waver * f64::from(cycle).sin() + price * here.departure(&b);
                let best = if cost_b < cost_a { &b } else { &a };
                count += usize::from(best != committed_plan);
                committed_plan = best;
            }
            count
        };
        let apart = 60.0 * 0.02_f64.sin();
        assert!(switches(0.99 * apart, 0.0) > 20);
        assert_eq!(switches(0.99 * apart, 1.0), 0);
        assert!(switches(1.5 * apart, 1.0) > 0, "a better way is taken all the same");
    }
}
