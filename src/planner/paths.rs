//! The lattice paths of a cycle on one lane.
//!
//! They begin at the start and at the end of the committed edge, and have the cost terms that depend on the lane and on the committed
//! path.

use super::allowance::{Kept, allowance_at, returns_to_road};
use super::arrival::urgency;
use super::hysteresis::committed_plan;
use super::level::LevelLimits;
use super::{Planner, Start};
use crate::collision::{CollisionWorld, SafetyMargins};
use crate::lattice::{EdgeCounts, LatticeContext, LatticePath, Root, Target};
use crate::reference::ReferenceLine;
use crate::vehicle::Vehicle;

/// Fraction of the vehicle's maximum curvature that paths may use; the tracking controller has the remainder.
const CURVATURE_SHARE: f64 = 0.95;
/// Distance to the last station of the goal below which the cost of lane changes rises, m.
const URGENT_DISTANCE: f64 = 80.0;
/// Distance per rise of the cost of a lane change by its base value, m.
const URGENCY_DISTANCE_STEP: f64 = 20.0;

impl Planner<'_> {
    /// Lattice paths on a lane, from the start and from the end of the committed edge, including the cost terms that depend
    /// on the lane and on the committed path. In order of cost.
    pub(super) fn lattice_paths(
        &mut self,
        start: &Start,
        lane: usize,
        level: LevelLimits,
        counts: &mut EdgeCounts,
    ) -> Vec<LatticePath> {
        let speed = start.point.speed;
        let stopping = speed.max(self.cruise.min(speed + 5.0)).powi(2) / (2.0 * self.vehicle.comfort.deceleration);
        let horizon = (stopping + 2.0 * speed).clamp(self.settings.min_horizon, self.settings.max_horizon);
        let world = &self.known.world;
        let roots = self.roots(start, world, &level.margins);
        let full_speed_curvature = self.full_speed_curvature(start);
        let weights = self.settings.lattice.weights;
        let committed_plan = committed_plan(self.committed.as_ref(), start);
        let Some(lane) = self.lanes.as_mut().ok().and_then(|l| l.get_mut(lane)) else { return Vec::new() };
        let context =
            context(&self.vehicle, (&lane.reference, lane.target()), (world, level.margins), full_speed_curvature);
        // the cost of postponing a lane change that the goal requires rises as time and distance run out
        let time_left = lane.goal_deadline - start.point.time;
        let here = lane.reference.project(start.point.pose.position).s;
        let distance_left = lane.goal_missed_at.map_or(f64::INFINITY, |s| s - here);
        let urgency = urgency(time_left) + ((URGENT_DISTANCE - distance_left) / URGENCY_DISTANCE_STEP).max(0.0);
        let mut all = Vec::new();
        for root in &roots {
            let store = &mut lane.edges;
            let found = self.lattice.search(&context, root, speed, horizon, store);
            counts.add(&found.counts);
            for mut path in found.paths {
                path.terms.lane_change = weights.lane_change * f64::from(lane.lane_changes_to_go) * urgency;
                if let Some(committed_plan) = &committed_plan {
                    path.terms.plan_change = weights.plan_change * committed_plan.departure(&path.path);
                }
                all.push(path);
            }
        }
        if roots[0].allowance.is_off_road() {
            all.retain(|path| returns_to_road(world, &path.path, f64::INFINITY, 0.0));
        }
        all.sort_by_key(|p| p.terms.rank());
        all
    }

    /// The curvature with the comfortable lateral acceleration at the start speed, 1/m.
    pub(super) fn full_speed_curvature(&self, start: &Start) -> f64 {
        let comfortable = self.settings.lateral_share * self.vehicle.comfort.lateral_acceleration;
        comfortable / (start.point.speed * start.point.speed)
    }

    fn roots(&self, start: &Start, world: &CollisionWorld, margins: &SafetyMargins) -> Vec<Root> {
        let p = &start.point;
        let allowance = allowance_at(world, margins, p, Kept::Nothing);
        let fresh = Root { pose: p.pose, curvature: p.curvature, kept: Vec::new(), start: p.pose, allowance };
        let kept = committed_plan(self.committed.as_ref(), start).and_then(|plan| plan.kept());
        let kept =
            kept.map(|(end, kept)| Root { pose: end.pose, curvature: end.curvature, kept, start: p.pose, allowance });
        kept.into_iter().chain([fresh]).collect()
    }
}

/// The lattice context of a lane.
pub(super) fn context<'a>(
    vehicle: &Vehicle,
    (reference, target): (&'a ReferenceLine, Option<Target>),
    (world, margins): (&'a CollisionWorld, SafetyMargins),
    full_speed_curvature: f64,
) -> LatticeContext<'a> {
    let (max_curvature, half_width) = (vehicle.max_curvature() * CURVATURE_SHARE, 0.5 * vehicle.width);
    LatticeContext { reference, world, margins, max_curvature, full_speed_curvature, half_width, target }
}
