//! When a cycle ends with the committed plan, without a search for another.
//!
//! Each cycle proves the committed plan again, for the present obstacles and predictions. If that succeeds on the level that it was chosen
//! on, it is as safe as it was. It is also as good, compared with others, if static obstacles, goals, friction and lanes are the same and
//! the traffic moves as predicted: what was ahead then is ahead now. Only two things can make another plan worth it: the part of the road
//! that has come within the horizon since, and the stop at the end of the committed plan, which a new plan would put farther ahead. A cycle
//! ends with the committed plan if
//!
//! * the last search is less than [`LONGEST`] ago: the horizon of the lattice exceeds the stopping distance by two seconds of driving, of
//!   which this is a quarter;
//! * the stop of its proof begins later than in [`BEFORE_STOP`]; or what it has fallen behind unobstructed driving since the search costs
//!   less than leaving it for a path that counts as another one (`hysteresis`), as where it is meant to stop;
//! * it is not on an emergency level, and has a jerk-limited speed profile;
//! * the goal asks for haste as it did then.
//!
//! Weak: a gap that opens unexpectedly is seen by the next search, up to [`LONGEST`] later. One that closes refutes the plan at once, but
//! only if it is less than the margins: the time gap is a wish.

use super::hysteresis::{CommittedPlan, SAME_PATH};
use super::level::Level;
use super::record::Smoothing;
use super::{Planner, Start};

/// Longest time without a search, s.
const LONGEST: f64 = 0.5;
/// Time before the stop of a proof from which on each cycle searches for a plan that goes on, s: that to the next search, and as much for
/// the deceleration to build up.
const BEFORE_STOP: f64 = 2.0 * LONGEST;
/// Rounding of times, s.
const TIME_SLACK: f64 = 1e-6;

/// When the committed plan was last compared with others, and how far it was behind unobstructed driving then.
#[derive(Debug, Clone, Copy)]
pub(super) struct Compared {
    /// s of the run.
    time: f64,
    /// m within the travel-time horizon.
    behind: f64,
    /// Whether the goal asked for haste.
    in_haste: bool,
}

impl Planner<'_> {
    /// Notes that the committed plan won against all others in this cycle.
    pub(super) fn note_comparison(&mut self, start: &Start) {
        let in_haste = self.haste.is_some();
        let compared = self.behind(start).map(|behind| Compared { time: start.point.time, behind, in_haste });
        if let Some(committed) = &mut self.committed {
            committed.compared = compared;
        }
    }

    /// Notes that the committed plan was chosen for another road or task than the present one.
    pub(super) fn forget_comparison(&mut self) {
        if let Some(committed) = &mut self.committed {
            committed.compared = None;
        }
    }

    /// Whether no other plan can be worth leaving the committed one.
    pub(super) fn is_settled(&self, start: &Start) -> bool {
        let Some((plan, Compared { time, behind, in_haste })) =
            self.committed.as_ref().and_then(|c| Some((c, c.compared?)))
        else {
            return false;
        };
        let weights = &self.settings.lattice.weights;
        let costs = |now: f64| weights.travel_time * (now - behind) <= weights.plan_change * SAME_PATH;
        start.on_plan
            && self.haste.is_some() == in_haste
            && start.point.time < time + LONGEST - TIME_SLACK
            && plan.level <= Level::NoMargin
            && matches!(plan.smoothing, Smoothing::Comfortable | Smoothing::Firm)
            && (start.point.time + BEFORE_STOP < plan.proof_begins || self.behind(start).is_some_and(costs))
    }

    /// How far the committed plan is behind unobstructed driving, m; `None` if its lane is gone.
    fn behind(&self, start: &Start) -> Option<f64> {
        let committed = self.committed.as_ref()?;
        let here = committed.trajectory.at(start.point.time);
        let plan = CommittedPlan::new(&committed.trajectory, committed.lead, &here);
        let level = self.levels(start.point.speed).into_iter().find(|l| l.level == committed.level)?;
        let lane = self.lanes.as_ref().ok()?.get(committed.lane?)?;
        Some(self.situation(start, lane, level).behind(start, &plan))
    }
}
