//! Runs a job. The only file of the command line that knows planner, simulation, verdict and pictures.

use std::path::Path;

use indicatif::ProgressBar;

use super::job::{Job, Kind};
use super::{Failure, progress, say};
use crate::drive::{self, Run};
use crate::io::{csv, files, solution};
use crate::result::{self, RunResult};

pub(super) use crate::drive::Settings;

/// Result of a run.
pub(super) struct Summary {
    pub(super) result: RunResult,
    /// The CommonRoad solution, if one is asked for and the vehicle has a type there.
    pub(super) solution: Option<Solution>,
    /// The JSON to write: the result with clock times and the optional parts.
    pub(super) json: serde_json::Value,
}

/// A CommonRoad solution.
pub(super) struct Solution {
    pub(super) xml: String,
    /// Largest distance between the solution and the simulated (or planned) positions, m.
    pub(super) max_deviation_m: f64,
}

/// Plans or drives, with a progress bar on a terminal.
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

/// The result of a run, with everything that its outputs need.
pub(super) fn result_of(job: &Job, run: &Run) -> Summary {
    let result = RunResult::new(job.kind, run, &job.settings, job.seed);
    let solution = job.outputs.solution.is_some().then(|| fitted_solution(job, run)).flatten();
    let mut json = result.json.clone();
    result::json::add_times(&mut json, &result.planning);
    if job.outputs.json_cycles {
        json.insert("cycles".into(), run.cycles.iter().map(result::json::cycle).collect());
    }
    if let Some(solution) = &solution {
        json.insert("solution".into(), serde_json::json!({ "max_deviation_m": solution.max_deviation_m }));
    }
    Summary { result, solution, json: json.into() }
}

fn fitted_solution(job: &Job, run: &Run) -> Option<Solution> {
    /// Rounding of the times of steps, in steps.
    const SLACK: f64 = 1e-6;
    let log = result::driven(job.kind, run);
    let end = log.samples.last().map_or(0.0, |s| s.time);
    #[allow(clippy::cast_possible_truncation)] // a number of steps
    let last_step = (end / run.scenario.time_step + SLACK).floor() as i64;
    let fit = solution::fit(run.scenario, run.problem, run.vehicle, &log, last_step);
    let xml = solution::to_xml(run.scenario, run.problem, run.vehicle, &fit)?;
    Some(Solution { xml, max_deviation_m: fit.max_deviation_m })
}

/// Writes the output files. A recording that cannot be written is a warning.
pub(super) fn write_outputs(job: &Job, run: &Run, summary: &Summary) -> Result<(), Failure> {
    let write = |path: &Option<std::path::PathBuf>, text: &dyn Fn() -> String| match path {
        Some(path) => files::write_atomic(path, text().as_bytes()).map_err(Failure::file),
        None => Ok(()),
    };
    let outputs = &job.outputs;
    if !outputs.json_on_stdout() {
        write(&outputs.json, &|| result::json::text(&summary.json))?;
    }
    write(&outputs.csv, &|| csv::log_to_csv(&result::driven(job.kind, run)))?;
    if let Some(solution) = &summary.solution {
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

/// The job refuses `--rrd` in such a build.
#[cfg(not(feature = "rerun"))]
fn record(_: &Run, path: &Path) {
    say(&format!("warning: {}: not written: no recordings in this build", path.display()));
}
