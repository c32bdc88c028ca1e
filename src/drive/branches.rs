//! Forked worlds: from moments of a run, the plan in force is driven to rest without planning again.
//!
//! **When.** Regularly, and wherever the plan changed: where the new trajectory wants the vehicle half a metre or more from
//! where the last one wanted it within the next seconds. A plan that is only drawn out further is no change. A fork of the
//! same trajectory as the last one's, driven in the same world, would come to the same: it is left out. Nor is there one
//! where nothing was proven: no stop is claimed there, and `stop_proven` counts it.
//!
//! **Cost.** At most one regular fork each interval and a fixed number of changes in a run
//! ([`FallbackSettings`](crate::verdict::FallbackSettings)); each is at most [`LONGEST`] of physics, in fact the duration of
//! one plan. FallbackBranches are driven in parallel, in batches that bound the memory, and judged in the order of their cycles: the
//! same bytes for any number of threads.

use rayon::prelude::*;

use crate::map::Scenario;
use crate::planner::{Cycle, Decision};
use crate::simulation::{Log, World};
use crate::trajectory::Trajectory;
use crate::vehicle::Vehicle;
use crate::verdict::{self, Fallback, FallbackBranch, FallbackJudge};

/// Times after a cycle at which the old and the new plan are compared, s.
const COMPARED: [f64; 4] = [0.5, 1.0, 2.0, 3.0];
/// MotionPlanner that are apart by more than this somewhere there are different ones, m.
const CHANGE: f64 = 0.5;
/// Worlds kept at a time.
const BATCH: usize = 32;
/// Longest fork, s: a plan that has not come to rest by then fails.
const LONGEST: f64 = 120.0;
/// Time after the planned stop at which a vehicle rests, s.
const SETTLED: f64 = 0.5;
/// Time after the planned stop by which it has to, s: dead times of actuators are in it.
const OVERDUE: f64 = 2.0;
/// Regular samples may be early by this, s: times of cycles are sums of steps.
const ROUNDING: f64 = 1e-6;

/// FallbackBranches of a run, driven a batch at a time.
pub(super) struct FallbackBranches<'a> {
    judge: FallbackJudge<'a>,
    settings: verdict::Settings,
    waiting: Vec<Waiting>,
    judged: Vec<Fallback>,
    /// Largest deceleration that the plan in force promises, m/s².
    promised: f64,
    /// The trajectory committed in the cycle before.
    before: Option<Trajectory>,
    last_sample: f64,
    /// Whether the plan in force was sampled already.
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
            promised: 0.0,
            before: None,
            last_sample: f64::NEG_INFINITY,
            is_sampled: false,
            changes: 0,
            left_out: 0,
        }
    }

    /// Hears of a cycle, before its trajectory is followed in `world`.
    pub(super) fn consider(&mut self, world: &World, cycle: &Cycle, number: usize) {
        if !self.settings.fallbacks.enabled {
            return;
        }
        if let Decision::NewPlan { deceleration } = cycle.decision {
            self.promised = deceleration;
        }
        let before = self.before.replace(cycle.committed.clone());
        let is_same = before.as_ref().is_some_and(|b| *b == cycle.committed);
        self.is_sampled &= is_same;
        if cycle.decision == Decision::Unproven || self.is_sampled {
            return;
        }
        let is_due = cycle.time - self.last_sample >= self.settings.fallbacks.interval - ROUNDING;
        let is_change = before.as_ref().is_some_and(|b| differ(b, &cycle.committed, cycle.time));
        let inherited = before.map_or(0.0, |b| -b.at(cycle.time).acceleration);
        if !is_due && is_change && self.changes >= self.settings.fallbacks.changes {
            self.left_out += 1;
        } else if is_due || is_change {
            self.changes += usize::from(!is_due);
            self.last_sample = cycle.time;
            self.is_sampled = true;
            let (world, trajectory, promised) = (world.clone(), cycle.committed.clone(), self.promised);
            self.waiting.push(Waiting { world, cycle: number, is_change, trajectory, promised, inherited });
        }
        if self.waiting.len() >= BATCH {
            self.drive();
        }
    }

    /// Drives what waits to rest.
    fn drive(&mut self) {
        let (judge, settings) = (&self.judge, &self.settings);
        let assess = |waiting: Waiting| {
            let Waiting { world, cycle, is_change, trajectory, promised, inherited } = waiting;
            let log = driven(world, &trajectory, settings.standstill_speed);
            let fork = FallbackBranch { cycle, is_change, trajectory: &trajectory, promised, inherited, log: &log };
            judge.assess(&fork)
        };
        self.judged.par_extend(std::mem::take(&mut self.waiting).into_par_iter().map(assess));
    }

    /// What the fallbacks came to, and how many changes of the plan were not sampled.
    pub(super) fn finish(mut self) -> (Vec<Fallback>, usize) {
        self.drive();
        (self.judged, self.left_out)
    }
}

/// Whether two plans want the vehicle at different places soon.
fn differ(old: &Trajectory, new: &Trajectory, time: f64) -> bool {
    let apart = |after: &f64| (old.at(time + after).pose.position - new.at(time + after).pose.position).norm() > CHANGE;
    COMPARED.iter().any(apart)
}

/// Follows the trajectory to its end and a little longer.
fn driven(mut world: World, trajectory: &Trajectory, standstill_speed: f64) -> Log {
    let mut log = Log::default();
    let end = trajectory.end_time().max(world.time()).min(world.time() + LONGEST);
    world.follow(trajectory, end + SETTLED, &mut log);
    if log.samples.last().is_some_and(|s| s.speed.abs() > standstill_speed) {
        world.follow(trajectory, end + OVERDUE, &mut log);
    }
    log
}
