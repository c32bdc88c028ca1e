//! The result of a run: whether it passes, its metrics, and both as JSON with a hash.
//!
//! The command line prints it and `regression` stores it. Wall-clock times are separate ([`Planning::time_ms`],
//! [`Planning::smoothing_ms`]): no hash contains them.

pub mod json;

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::bench::quantile;
use crate::drive::{Outcome, Run, Settings};
use crate::lattice::EdgeCounts;
use crate::planner::{Cycle, Decision, NoLane, Rejection, Smoothing, UncertaintyMode};
use crate::simulation::{Log, Sample};
use crate::speed::{smoothing, tail};
use crate::verdict::{self, Metrics};

/// The kind of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A single planning cycle.
    Plan,
    /// The closed loop.
    Drive,
}

/// The result of a run.
#[derive(Debug, Clone)]
pub struct RunResult {
    /// Whether the run passes.
    pub pass: bool,
    /// Metrics of the driven motion.
    pub metrics: Metrics,
    /// Metrics of planning.
    pub planning: Planning,
    /// SHA-256 of the result and of every sampled state, as hexadecimal text: equal hashes mean equal runs to the last bit.
    pub hash: String,
    /// The whole result in the format `stopline.drive/2` or `stopline.plan/2`, without wall-clock times.
    pub json: Map<String, Value>,
}

impl RunResult {
    /// The result of a run that was made with `settings`. The JSON contains `seed`.
    #[must_use]
    pub fn new(kind: Kind, run: &Run, settings: &Settings, seed: u64) -> Self {
        let metrics = verdict::metrics(run.scenario, run.vehicle, &run.cycles, &run.log, &settings.verdict);
        let (pass, planning) = (passes(kind, run), planning(run, settings));
        let samples = driven(kind, run).samples;
        let mut json = json::result(kind, run, seed, (pass, &metrics, &planning), &samples);
        if settings.simulation.friction_scale.to_bits() != 1.0_f64.to_bits() || !settings.friction.is_empty() {
            let road = json!({ "scale": settings.simulation.friction_scale, "patches": settings.friction });
            json.insert("friction".into(), road);
        }
        let hash = json::hash(&json.clone().into(), &samples);
        json.insert("hash".into(), hash.clone().into());
        if let Some(detail) = reason_detail(run) {
            json.insert("reason_detail".into(), detail.into());
        }
        Self { pass, metrics, planning, hash, json }
    }
}

/// Positions and lanelets behind the reason of a run that has no lane to drive on, as a sentence.
pub(crate) fn reason_detail(run: &Run) -> Option<String> {
    let reason = NoLane::ALL.into_iter().find(|reason| Some(reason.code()) == run.reason)?;
    reason.detail(run.scenario, run.problem)
}

/// Metrics of planning.
#[derive(Debug, Clone)]
pub struct Planning {
    /// Cycles planned.
    pub cycles: usize,
    /// Cycles with a proven plan.
    pub proven_cycles: usize,
    /// Cycles whose path was refined.
    pub refined_cycles: usize,
    /// Cycles with a robust plan, proved for the reachable sets of other traffic; `None` if the settings ask for no such proof.
    pub robust_cycles: Option<usize>,
    /// States expanded by the speed search.
    pub expansions: usize,
    /// Evaluated paths.
    pub candidates: usize,
    /// Number of rejected candidates by reason, in the order of [`Rejection::ALL`].
    pub rejections: Vec<(Rejection, usize)>,
    /// Evaluated lattice edges by result.
    pub edges: EdgeCounts,
    /// Cycles by the smoothing of the committed profile.
    pub smoothing: BTreeMap<&'static str, usize>,
    /// Cycles whose committed profile is unsmoothed, by reason.
    pub unsmoothed: BTreeMap<&'static str, usize>,
    /// Cycles whose committed profile creeps to standstill.
    pub creeping_cycles: usize,
    /// Times of whole cycles.
    pub time_ms: Times,
    /// Times of smoothing and its proof alone, in cycles with a new plan.
    pub smoothing_ms: Times,
}

/// Wall-clock times of the planning cycles, ms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Times {
    /// Median.
    pub median: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

/// A plan passes if its stop is proven and it does not start in a collision. A drive passes if it was judged, no check failed,
/// and its outcome is not a failure in itself.
fn passes(kind: Kind, run: &Run) -> bool {
    match kind {
        Kind::Plan => planned_cycle(run).is_some(),
        Kind::Drive => {
            let failed = matches!(run.outcome, Outcome::NoSafePlan | Outcome::Collision | Outcome::TimedOut);
            !failed && !run.verdict.checks.is_empty() && run.verdict.pass()
        }
    }
}

fn planning(run: &Run, settings: &Settings) -> Planning {
    let proven = |decision: Decision| !matches!(decision, Decision::Unproven);
    let new_plans = run.cycles.iter().filter(|c| c.plan.decision == Decision::NewPlan);
    let mut smoothing: BTreeMap<_, _> = Smoothing::CODES.iter().map(|code| (*code, 0)).collect();
    let mut unsmoothed: BTreeMap<_, _> = smoothing::Failure::codes().map(|code| (code, 0)).collect();
    for cycle in &run.cycles {
        *smoothing.entry(cycle.plan.smoothing.code()).or_default() += 1;
        if let Smoothing::Unsmoothed(why) = cycle.plan.smoothing {
            *unsmoothed.entry(why.code()).or_default() += 1;
        }
    }
    let mut edges = EdgeCounts::default();
    run.cycles.iter().for_each(|c| edges.add(&c.trace.edges));
    let rejected = |why: Rejection| (why, run.cycles.iter().map(|c| c.trace.rejections(why)).sum());
    let comfortable = run.vehicle.comfort.deceleration;
    let creeps = |c: &&Cycle| tail::creeping_time(&c.plan.trajectory.profile, comfortable) > tail::MAX_CREEPING_TIME;
    Planning {
        rejections: Rejection::ALL.map(rejected).to_vec(),
        edges,
        cycles: run.cycles.len(),
        proven_cycles: run.cycles.iter().filter(|c| proven(c.plan.decision)).count(),
        robust_cycles: (settings.planner.uncertainty.mode != UncertaintyMode::Off)
            .then(|| run.cycles.iter().filter(|c| c.plan.is_robust).count()),
        refined_cycles: run.cycles.iter().filter(|c| c.trace.is_refined).count(),
        expansions: run.cycles.iter().map(|c| c.trace.expansions).sum(),
        candidates: run.cycles.iter().map(|c| c.trace.candidates.len()).sum(),
        smoothing,
        unsmoothed,
        creeping_cycles: run.cycles.iter().filter(creeps).count(),
        time_ms: Times::of(run.cycles.iter().map(|c| c.trace.stage_seconds.total)),
        smoothing_ms: Times::of(new_plans.map(|c| c.trace.stage_seconds.smoothing)),
    }
}

impl Times {
    fn of(seconds: impl Iterator<Item = f64>) -> Self {
        let mut times: Vec<f64> = seconds.map(|s| s * 1000.0).collect();
        times.sort_by(f64::total_cmp);
        Self { median: quantile(&times, 0.5), p99: quantile(&times, 0.99), max: quantile(&times, 1.0) }
    }
}

/// The driven motion; for a plan, the planned motion, as if it were driven exactly.
#[must_use]
pub fn driven(kind: Kind, run: &Run) -> Log {
    match kind {
        Kind::Drive => run.log.clone(),
        Kind::Plan => planned(run),
    }
}

/// The cycle of a plan with a proven stop.
fn planned_cycle<'r>(run: &'r Run) -> Option<&'r Cycle> {
    let has_plan = matches!(run.outcome, Outcome::Planned | Outcome::AlreadyAtGoal) && run.is_ever_proven();
    run.cycles.last().filter(|_| has_plan)
}

fn planned(run: &Run) -> Log {
    /// Time between two samples, s.
    const INTERVAL: f64 = 0.01;
    let Some(cycle) = planned_cycle(run) else { return Log::default() };
    let (start, end) = (cycle.plan.trajectory.start_time, cycle.plan.trajectory.end_time());
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a plan of seconds
    let count = ((end - start) / INTERVAL).ceil().clamp(0.0, 1e6) as usize;
    let sample = |i: usize| {
        #[allow(clippy::cast_precision_loss)] // at most 1e6
        let p = cycle.plan.trajectory.at((start + i as f64 * INTERVAL).min(end));
        let (yaw_rate, steering) = (p.speed * p.curvature, run.vehicle.steering_for_curvature(p.curvature));
        Sample {
            time: p.time,
            pose: p.pose,
            speed: p.speed,
            lateral_speed: 0.0,
            yaw_rate,
            acceleration: p.acceleration,
            lateral_acceleration: p.speed * yaw_rate,
            steering,
            commanded_acceleration: p.acceleration,
            commanded_steering: steering,
            reference_pose: p.pose,
            reference_speed: p.speed,
            reference_station: p.station,
        }
    };
    Log { samples: (0..=count).map(sample).collect(), ..Log::default() }
}
