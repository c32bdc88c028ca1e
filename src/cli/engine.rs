//! Runs a job: the only file of the command line that knows planner, physics, verdict and pictures.

use std::path::Path;

use indicatif::ProgressBar;

use super::job::{Job, Kind};
use super::{Failure, progress, say};
use crate::drive::{self, Run};
use crate::io::{csv, files, solution};
use crate::result::{self, RunResult, json};

pub(super) use crate::drive::Settings;

/// What a run comes to.
pub(super) struct Summary {
    pub(super) result: RunResult,
    /// Deviation of the solution from what was driven, m, if one is asked for.
    pub(super) solution: Option<Solution>,
    /// The result with all that is asked for, times included.
    pub(super) json: serde_json::Value,
}

/// The solution file and how far it is from what was driven.
pub(super) struct Solution {
    pub(super) xml: String,
    pub(super) max_deviation_m: f64,
}

/// MotionPlanner or drives, with a progress bar if somebody watches.
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
    let result = RunResult::new(job.kind, run, &job.settings, job.seed);
    let solution = job.outputs.solution.is_some().then(|| fitted(job, run)).flatten();
    let mut told = result.json.clone();
    json::add_times(&mut told, &result.planning);
    if job.outputs.json_cycles {
        told.insert("cycles".into(), run.cycles.iter().map(json::cycle).collect());
    }
    if let Some(solution) = &solution {
        told.insert("solution".into(), serde_json::json!({ "max_deviation_m": solution.max_deviation_m }));
    }
    Summary { result, solution, json: told.into() }
}

fn fitted(job: &Job, run: &Run) -> Option<Solution> {
    /// Times of steps are products: allow their rounding.
    const SLACK: f64 = 1e-6;
    let log = result::driven(job.kind, run);
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
    write(&outputs.csv, &|| csv::log_to_csv(&result::driven(job.kind, run)))?;
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
