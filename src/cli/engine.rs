//! Runs a job: the only file of the command line that knows planner, physics, verdict and pictures.

use std::collections::BTreeMap;
use std::path::Path;

use indicatif::ProgressBar;

use super::job::{Job, Kind};
use super::{Failure, json, progress, say};
use crate::bench::quantile;
use crate::drive::{self, Outcome, Run};
use crate::io::{csv, files, solution};
use crate::lattice::EdgeCounts;
use crate::planner::{Cycle, Decision, Rejection, Smoothing, UncertaintyMode};
use crate::simulation::{Log, Sample};
use crate::speed::{smoothing, tail};
use crate::verdict::{self, Metrics};

pub(super) use crate::drive::Settings;

/// What a run comes to.
pub(super) struct Summary {
    /// Whether it is a success: exit code 0.
    pub(super) held: bool,
    pub(super) metrics: Metrics,
    pub(super) planning: Planning,
    /// Deviation of the solution from what was driven, m, if one is asked for.
    pub(super) solution: Option<Solution>,
    pub(super) hash: String,
    pub(super) json: serde_json::Value,
}

/// The solution file and how far it is from what was driven.
pub(super) struct Solution {
    pub(super) xml: String,
    pub(super) max_deviation_m: f64,
}

/// Figures of planning.
pub(super) struct Planning {
    pub(super) cycles: usize,
    pub(super) proven_cycles: usize,
    pub(super) refined_cycles: usize,
    /// Cycles whose plan is proven against all motions within the bounds; `None` if the settings ask for no such proof.
    pub(super) proven_against_set: Option<usize>,
    pub(super) expansions: usize,
    pub(super) candidates: usize,
    /// How many candidates were rejected, by reason, in the order of [`Rejection::ALL`].
    pub(super) rejections: Vec<(Rejection, usize)>,
    /// What became of the lattice edges looked at.
    pub(super) edges: EdgeCounts,
    /// Cycles by what became of the smoothing of the profile in force.
    pub(super) smoothing: BTreeMap<&'static str, usize>,
    /// Cycles whose profile in force is unsmoothed, by reason.
    pub(super) unsmoothed: BTreeMap<&'static str, usize>,
    /// Cycles whose profile in force creeps to its rest.
    pub(super) creeping_cycles: usize,
    pub(super) time_ms: Times,
    /// Of smoothing and its proof alone, in the cycles with a new plan.
    pub(super) smoothing_ms: Times,
}

/// Wall-clock times of the planning cycles, ms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Times {
    pub(super) median: f64,
    pub(super) p99: f64,
    pub(super) max: f64,
}

/// Plans or drives, with a progress bar if somebody watches.
pub(super) fn execute(job: &Job) -> Result<Run<'_>, Failure> {
    let mut pool = rayon::ThreadPoolBuilder::new();
    if let Some(threads) = job.threads {
        pool = pool.num_threads(usize::from(threads));
    }
    let pool = pool.build().map_err(|e| Failure::Fault(format!("no threads: {e}")))?;
    let bar = progress::bar(job.kind == Kind::Drive && !job.quiet);
    let (scenario, problem, vehicle, settings) = (&job.scenario, job.problem(), &job.vehicle, &job.settings);
    let run = pool.install(|| match job.kind {
        Kind::Plan => drive::plan(scenario, problem, vehicle, settings),
        Kind::Drive => drive::drive(scenario, problem, vehicle, settings, &mut |time, end| show(&bar, time, end)),
    });
    bar.finish_and_clear();
    run.map_err(Failure::file)
}

fn show(bar: &ProgressBar, time: f64, end: f64) {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // milliseconds of a run, saturating
    let milliseconds = |seconds: f64| (seconds * 1000.0) as u64;
    bar.set_length(milliseconds(end));
    bar.set_position(milliseconds(time));
    bar.set_message(format!("{time:.1} s of at most {end:.1} s"));
}

/// Everything that is said of a run.
pub(super) fn result_of(job: &Job, run: &Run) -> Summary {
    let metrics = verdict::metrics(run.scenario, run.vehicle, &run.cycles, &run.log, &job.settings.verdict);
    let mut summary = Summary {
        held: held(job.kind, run),
        metrics,
        planning: planning(job, run),
        solution: job.outputs.solution.is_some().then(|| fitted(job, run)).flatten(),
        hash: String::new(),
        json: serde_json::Value::Null,
    };
    json::fill(job, run, &mut summary);
    summary
}

/// A plan is a success when its stop is proven, a drive when it was judged, every check held, and it came to an end that
/// is not a failure in itself.
fn held(kind: Kind, run: &Run) -> bool {
    match kind {
        Kind::Plan => run.outcome == Outcome::Planned,
        Kind::Drive => {
            let failed = matches!(run.outcome, Outcome::NoSafePlan | Outcome::Collision | Outcome::TimedOut);
            !failed && !run.verdict.checks.is_empty() && run.verdict.pass()
        }
    }
}

fn planning(job: &Job, run: &Run) -> Planning {
    let proven = |decision: Decision| !matches!(decision, Decision::Unproven);
    let new_plans = run.cycles.iter().filter(|c| matches!(c.decision, Decision::NewPlan { .. }));
    let mut smoothing: BTreeMap<_, _> = Smoothing::CODES.iter().map(|code| (*code, 0)).collect();
    let mut unsmoothed: BTreeMap<_, _> = smoothing::Failure::codes().map(|code| (code, 0)).collect();
    for cycle in &run.cycles {
        *smoothing.entry(cycle.smoothing.code()).or_default() += 1;
        if let Smoothing::Unsmoothed(why) = cycle.smoothing {
            *unsmoothed.entry(why.code()).or_default() += 1;
        }
    }
    let mut edges = EdgeCounts::default();
    run.cycles.iter().for_each(|c| edges.add(&c.edges));
    let rejected = |why: Rejection| (why, run.cycles.iter().map(|c| c.rejections(why)).sum());
    let comfortable = run.vehicle.comfort.deceleration;
    let creeps = |c: &&Cycle| tail::creeping_time(&c.committed.profile, comfortable) > tail::PATIENCE;
    Planning {
        rejections: Rejection::ALL.map(rejected).to_vec(),
        edges,
        cycles: run.cycles.len(),
        proven_cycles: run.cycles.iter().filter(|c| proven(c.decision)).count(),
        proven_against_set: (job.settings.planner.uncertainty.mode != UncertaintyMode::Off)
            .then(|| run.cycles.iter().filter(|c| c.is_proven_against_set).count()),
        refined_cycles: run.cycles.iter().filter(|c| c.is_refined).count(),
        expansions: run.cycles.iter().map(|c| c.expansions).sum(),
        candidates: run.cycles.iter().map(|c| c.candidates.len()).sum(),
        smoothing,
        unsmoothed,
        creeping_cycles: run.cycles.iter().filter(creeps).count(),
        time_ms: Times::of(run.cycles.iter().map(|c| c.stage_seconds.total)),
        smoothing_ms: Times::of(new_plans.map(|c| c.stage_seconds.smoothing)),
    }
}

impl Times {
    fn of(seconds: impl Iterator<Item = f64>) -> Self {
        let mut times: Vec<f64> = seconds.map(|s| s * 1000.0).collect();
        times.sort_by(f64::total_cmp);
        Self { median: quantile(&times, 0.5), p99: quantile(&times, 0.99), max: quantile(&times, 1.0) }
    }
}

/// What was driven; for a plan, what is planned, as if it were driven exactly.
pub(super) fn driven(kind: Kind, run: &Run) -> Log {
    match kind {
        Kind::Drive => run.log.clone(),
        Kind::Plan => planned(run),
    }
}

fn planned(run: &Run) -> Log {
    /// Time between two samples, s.
    const INTERVAL: f64 = 0.01;
    let Some(cycle) = run.cycles.last().filter(|_| run.outcome == Outcome::Planned) else { return Log::default() };
    let (start, end) = (cycle.committed.start_time, cycle.committed.end_time());
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a plan of seconds
    let count = ((end - start) / INTERVAL).ceil().clamp(0.0, 1e6) as usize;
    let sample = |i: usize| {
        #[allow(clippy::cast_precision_loss)] // at most 1e6
        let p = cycle.committed.at((start + i as f64 * INTERVAL).min(end));
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
            wanted_pose: p.pose,
            wanted_speed: p.speed,
            wanted_station: p.station,
        }
    };
    Log { samples: (0..=count).map(sample).collect(), ..Log::default() }
}

fn fitted(job: &Job, run: &Run) -> Option<Solution> {
    /// Times of steps are products: allow their rounding.
    const SLACK: f64 = 1e-6;
    let log = driven(job.kind, run);
    let end = log.samples.last().map_or(0.0, |s| s.time);
    #[allow(clippy::cast_possible_truncation)] // a run of seconds
    let last_step = (end / run.scenario.time_step + SLACK).floor() as i64;
    let fit = solution::fit(run.scenario, run.problem, run.vehicle, &log, last_step);
    let xml = solution::to_xml(run.scenario, run.problem, run.vehicle, &fit)?;
    Some(Solution { xml, max_deviation_m: fit.max_deviation_m })
}

/// Writes the files that are asked for. A recording that fails does not fail the run.
pub(super) fn write_outputs(job: &Job, run: &Run, result: &Summary) -> Result<(), Failure> {
    let write = |path: &Option<std::path::PathBuf>, text: &dyn Fn() -> String| match path {
        Some(path) => files::write_atomic(path, text().as_bytes()).map_err(Failure::file),
        None => Ok(()),
    };
    let outputs = &job.outputs;
    if !outputs.json_on_stdout() {
        write(&outputs.json, &|| json::text(&result.json))?;
    }
    write(&outputs.csv, &|| csv::log_to_csv(&driven(job.kind, run)))?;
    if let Some(solution) = &result.solution {
        write(&outputs.solution, &|| solution.xml.clone())?;
    }
    write(&outputs.svg, &|| crate::plot::run_svg(run))?;
    if let Some(path) = &outputs.rrd {
        record(run, path);
    }
    Ok(())
}

#[cfg(feature = "rerun")]
fn record(run: &Run, path: &Path) {
    if let Err(error) = crate::recording::write(run, path) {
        say(&format!("warning: {error}"));
    }
}

/// Refused before the run starts.
#[cfg(not(feature = "rerun"))]
fn record(_: &Run, path: &Path) {
    say(&format!("warning: {}: not written: no recordings in this build", path.display()));
}
