//! Refinement of the chosen path, with a speed search and proof like for any other candidate.
//!
//! The planner refines only the chosen path. The choice itself depends on lattice paths alone, so that refinement causes no
//! switches between plans. The refined path replaces the lattice path if its stop is proven on the same level, its total
//! cost including travel time is not higher, and its progress is not less.
//!
//! During a lane change there is no refinement: offsets beyond [`OFFSET_SATURATES`] all cost the same, so that the cost does
//! not depend on when the lane change happens, and refinement would postpone it in every cycle.

use std::time::Instant;

use super::allowance::{Kept, allowance_at};
use super::candidate::{Evaluation, Proven, delay};
use super::choice::Choice;
use super::hysteresis::committed_plan;
use super::level::LevelLimits;
use super::paths::context;
use super::tube::Tube;
use super::{CycleRecord, Planner, Start};
use crate::lattice::refine::{Commitment, refined};
use crate::lattice::{LatticePath, OFFSET_SATURATES, rank};

/// Tolerance of the progress, m.
const ON_TIME: f64 = 0.01;

impl Planner<'_> {
    /// The choice with a refined path if that passes all checks, else the choice itself.
    pub(super) fn refined(
        &self,
        start: &Start,
        level: LevelLimits,
        choice: Choice,
        record: &mut CycleRecord,
    ) -> Choice {
        let begun = Instant::now();
        let better = self.refinement(start, level, &choice, record);
        record.trace.stage_seconds.refinement = begun.elapsed().as_secs_f64();
        match better {
            Some((path, proven, tube, cost)) => Choice { path, proven, tube, cost, is_refined: true, ..choice },
            None => choice,
        }
    }

    fn refinement(
        &self,
        start: &Start,
        level: LevelLimits,
        choice: &Choice,
        record: &mut CycleRecord,
    ) -> Option<(LatticePath, Box<Proven>, Tube, f64)> {
        let settings = &self.settings.refinement;
        if !settings.enabled {
            return None;
        }
        let lane = self.lanes.as_ref().ok().and_then(|lanes| lanes.get(choice.lane))?;
        if lane.reference.project(start.point.pose.position).l.abs() > OFFSET_SATURATES {
            return None;
        }
        // the lattice path bends more than the refined one, so that its tube is wide enough
        let level = LevelLimits { margins: level.margins.at_least(&choice.tube.margins), ..level };
        let world = &self.known.world;
        let allowance = allowance_at(world, &level.margins, &start.point, Kept::Nothing);
        if allowance.no_road_until > 0.0 {
            // the corridor of a refinement is that of the road
            return None;
        }
        let weights = &self.settings.lattice.weights;
        let commitment = committed_plan(self.committed.as_ref(), start)
            .map_or_else(Commitment::default, |plan| plan.commitment(&choice.path.path, weights.plan_change));
        let mut path = refined(
            &context(
                &self.vehicle,
                (&lane.reference, lane.target()),
                (world, level.margins),
                self.full_speed_curvature(start),
            ),
            &choice.path,
            &allowance,
            self.vehicle.front_overhang_from_rear_axle(),
            weights,
            &commitment,
            settings,
        )?;
        path.terms.plan_change = commitment.cost(&path.path);
        let situation = self.situation(start, lane, level);
        match situation.evaluate(&path) {
            Evaluation::Rejected { expansions, .. } => {
                record.trace.expansions += expansions;
                None
            }
            Evaluation::Proven(proven) => {
                record.trace.expansions += proven.expansions;
                self.charge_missed_goal(start, &mut path, &proven.raw_profile);
                let delay = delay(&self.settings, situation.free_progress() - proven.progress, &path.terms);
                let cost = path.terms.total() + delay;
                let is_slower = proven.progress + ON_TIME < choice.proven.progress;
                if is_slower || rank(cost) > rank(choice.cost) || proven.reverify().is_err() {
                    return None;
                }
                let tube = self.tube_of(start, &level, &path, &proven.raw_profile).ok()?;
                Some((path, proven, tube, cost))
            }
        }
    }
}
