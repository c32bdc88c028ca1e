//! Fallback branches: from moments of a run, the committed plan is followed to standstill without replanning.
//!
//! **When.** At regular times, and where the plan changed: where the new trajectory is half a metre or more from the last one
//! within the next seconds. A trajectory that only reaches farther is no change. A second branch on the same trajectory would
//! give the same result and is left out. A cycle without a proven plan claims no stop and gets no branch; `stop_proven` counts
//! it.
//!
//! **Cost.** At most one regular branch in each interval and a fixed number of changes in a run
//! ([`FallbackSettings`](crate::verdict::FallbackSettings)). A branch simulates the duration of one plan, at most [`LONGEST`].
//! Branches run in parallel, in batches that bound the memory, and are judged in the order of their cycles: the results are
//! the same to the bit for any number of threads.

use rayon::prelude::*;

use crate::map::Scenario;
use crate::planner::{Cycle, Decision};
use crate::simulation::{Log, World};
use crate::trajectory::Trajectory;
use crate::vehicle::Vehicle;
use crate::verdict::{self, Fallback, FallbackBranch, FallbackJudge};

/// Times after a cycle at which the old and the new plan are compared, s.
const COMPARED: [f64; 4] = [0.5, 1.0, 2.0, 3.0];
/// Plans that are farther apart than this at one of these times are different, m.
const CHANGE: f64 = 0.5;
/// Branches kept at a time.
const BATCH: usize = 32;
/// Longest branch, s. A plan that does not end within it fails.
const LONGEST: f64 = 120.0;
/// Time simulated beyond the planned stop, s.
const SETTLED: f64 = 0.5;
/// Time after the planned stop by which the vehicle must stand, s. It includes dead times of the actuators.
const OVERDUE: f64 = 2.0;
/// Regular branches may be early by this, s: times of cycles are rounded sums.
const ROUNDING: f64 = 1e-6;

/// The fallback branches of a run.
pub(super) struct FallbackBranches<'a> {
    judge: FallbackJudge<'a>,
    settings: verdict::Settings,
    waiting: Vec<Waiting>,
    judged: Vec<Fallback>,
    /// The trajectory committed in the cycle before.
    before: Option<Trajectory>,
    last_sample: f64,
    /// Whether the committed plan already has a branch.
    is_sampled: bool,
    changes: usize,
    left_out: usize,
}

struct Waiting {
    world: World,
    cycle: usize,
    is_change: bool,
    trajectory: Trajectory,
    promised: f64,
    inherited: f64,
}

impl<'a> FallbackBranches<'a> {
    pub(super) fn new(scenario: &'a Scenario, vehicle: &'a Vehicle, settings: &verdict::Settings) -> Self {
        Self {
            judge: FallbackJudge::new(scenario, vehicle, settings),
            settings: *settings,
            waiting: Vec::new(),
            judged: Vec::new(),
            before: None,
            last_sample: f64::NEG_INFINITY,
            is_sampled: false,
            changes: 0,
            left_out: 0,
        }
    }

    /// Starts a branch at a cycle if one is due. `world` is the simulation before it follows the trajectory of the cycle.
    pub(super) fn consider(&mut self, world: &World, cycle: &Cycle, number: usize) {
        if !self.settings.fallbacks.enabled {
            return;
        }
        let before = self.before.replace(cycle.plan.trajectory.clone());
        let is_same = before.as_ref().is_some_and(|b| *b == cycle.plan.trajectory);
        self.is_sampled &= is_same;
        if cycle.plan.decision == Decision::Unproven || self.is_sampled {
            return;
        }
        let is_due = cycle.plan.time - self.last_sample >= self.settings.fallbacks.interval - ROUNDING;
        let is_change = before.as_ref().is_some_and(|b| differ(b, &cycle.plan.trajectory, cycle.plan.time));
        let inherited = before.map_or(0.0, |b| -b.at(cycle.plan.time).acceleration);
        if !is_due && is_change && self.changes >= self.settings.fallbacks.changes {
            self.left_out += 1;
        } else if is_due || is_change {
            self.changes += usize::from(!is_due);
            self.last_sample = cycle.plan.time;
            self.is_sampled = true;
            let (world, trajectory, promised) = (world.clone(), cycle.plan.trajectory.clone(), cycle.plan.deceleration);
            self.waiting.push(Waiting { world, cycle: number, is_change, trajectory, promised, inherited });
        }
        if self.waiting.len() >= BATCH {
            self.simulate();
        }
    }

    /// Simulates and judges the waiting branches.
    fn simulate(&mut self) {
        let (judge, settings) = (&self.judge, &self.settings);
        let assess = |waiting: Waiting| {
            let Waiting { world, cycle, is_change, trajectory, promised, inherited } = waiting;
            let log = followed(world, &trajectory, settings.standstill_speed);
            let branch = FallbackBranch { cycle, is_change, trajectory: &trajectory, promised, inherited, log: &log };
            judge.assess(&branch)
        };
        self.judged.par_extend(std::mem::take(&mut self.waiting).into_par_iter().map(assess));
    }

    /// The results, and the number of changes of the plan without a branch.
    pub(super) fn finish(mut self) -> (Vec<Fallback>, usize) {
        self.simulate();
        (self.judged, self.left_out)
    }
}

/// Whether two plans differ within the next seconds.
fn differ(old: &Trajectory, new: &Trajectory, time: f64) -> bool {
    let apart = |after: &f64| (old.at(time + after).pose.position - new.at(time + after).pose.position).norm() > CHANGE;
    COMPARED.iter().any(apart)
}

/// The log of following the trajectory to its end and a little longer.
fn followed(mut world: World, trajectory: &Trajectory, standstill_speed: f64) -> Log {
    let mut log = Log::default();
    let end = trajectory.end_time().max(world.time()).min(world.time() + LONGEST);
    world.follow(trajectory, end + SETTLED, &mut log);
    if log.samples.last().is_some_and(|s| s.speed.abs() > standstill_speed) {
        world.follow(trajectory, end + OVERDUE, &mut log);
    }
    log
}
