//! The chosen path, refined as a whole and evaluated anew like any other candidate.
//!
//! Only the chosen path is refined: which one is chosen stays the lattice's decision, so that refinement brings no
//! flicker of its own. It is committed in the place of the lattice's own if its stop is proven on the same level and its
//! total cost, the delay of its own speed search included, is not greater, and it gets no less far.
//!
//! On the way from another lane nothing is refined: offsets beyond [`OFFSET_SATURATES`] all cost the same, so the costs
//! do not see when the change of lanes happens, and refining it in every cycle would put it off in every cycle.

use std::time::Instant;

use super::candidate::{Evaluation, Proven, delay};
use super::choice::Choice;
use super::{CycleRecord, Level, Planner, Start, allowance_at, committed_plan, context};
use crate::lattice::refine::{Commitment, refined};
use crate::lattice::{LatticePath, OFFSET_SATURATES, rank};

/// A plan that falls behind by less than this is as fast, m.
const ON_TIME: f64 = 0.01;

impl Planner<'_> {
    /// The choice with its path refined, where that checks out; else as it is.
    pub(super) fn refined(&self, start: &Start, level: Level, choice: Choice, record: &mut CycleRecord) -> Choice {
        let begun = Instant::now();
        let better = self.refinement(start, level, &choice, record);
        record.seconds.refinement = begun.elapsed().as_secs_f64();
        match better {
            Some((path, proven, cost)) => Choice { path, proven, cost, is_refined: true, ..choice },
            None => choice,
        }
    }

    fn refinement(
        &self,
        start: &Start,
        level: Level,
        choice: &Choice,
        record: &mut CycleRecord,
    ) -> Option<(LatticePath, Box<Proven>, f64)> {
        let settings = &self.settings.refinement;
        if !settings.enabled {
            return None;
        }
        let lane = self.lanes.as_ref().ok().and_then(|lanes| lanes.get(choice.lane))?;
        if lane.reference.project(start.point.pose.position).l.abs() > OFFSET_SATURATES {
            return None;
        }
        let world = &self.worlds[level.world];
        let weights = &self.settings.lattice.weights;
        let commitment = committed_plan(self.committed.as_ref(), start)
            .map_or_else(Commitment::default, |plan| plan.commitment(&choice.path.path, weights.plan_change));
        let mut path = refined(
            &context(self.vehicle, &lane.reference, world, self.full_speed_curvature(start, level)),
            &choice.path,
            &allowance_at(world, &start.point),
            self.vehicle.front_overhang_from_rear_axle(),
            weights,
            &commitment,
            settings,
        )?;
        path.terms.plan_change = commitment.cost(&path.path);
        let situation = self.situation(start, lane, level);
        match situation.evaluate(&path) {
            Evaluation::Rejected { expansions, .. } => {
                record.expansions += expansions;
                None
            }
            Evaluation::Proven(proven) => {
                record.expansions += proven.expansions;
                let delay = delay(self.settings, situation.free_progress() - proven.progress, &path.terms);
                let cost = path.terms.total() + delay;
                let is_slower = proven.progress + ON_TIME < choice.proven.progress;
                let stands = || proven.proved_again().is_ok();
                (!is_slower && stands() && rank(cost) <= rank(choice.cost)).then_some((path, proven, cost))
            }
        }
    }
}
