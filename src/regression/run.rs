//! Runs the drives of a suite in parallel, with the same result for every number of jobs.
//!
//! `workers` runs the drives; their results are in the order of the suite.

use std::num::NonZeroUsize;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use serde_json::{Map, Value};
use sha2::{Digest as _, Sha256};

use super::baseline::Baseline;
use super::compare::{self, Failure, FailureKind};
use super::expand::Case;
use super::state::State;
use super::summary::{DriveError, DriveReport, ErrorKind, Status, Summary};
use super::{Suite, SuiteError};
use crate::drive::{self, Run};
use crate::io::{commonroad, files};
use crate::map::{PlanningProblem, Scenario};
use crate::plot::run_svg;
use crate::result::{Kind, RunResult};
use crate::workers;

/// Largest scenario, bytes; the same limit as in its reader.
const MAX_SCENARIO_BYTES: u64 = 256 << 20;

/// How to run a suite.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// The number of parallel drives; the number of cores if not given.
    pub jobs: Option<NonZeroUsize>,
    /// The part of the suite to run; all of it if not given.
    pub shard: Option<Shard>,
    /// A file that stores finished drives, so that an interrupted run can be resumed.
    pub resume: Option<PathBuf>,
    /// Whether to store the results as the new baseline.
    pub update_baseline: bool,
    /// The largest number of failed drives to draw, in the order of the suite.
    pub pictures: usize,
    /// A flag that cancels the run: no further drive starts, running drives are finished, the baseline is not updated.
    pub cancel: Option<Arc<AtomicBool>>,
}

impl Options {
    fn is_cancelled(&self) -> bool {
        self.cancel.as_ref().is_some_and(|cancel| cancel.load(Ordering::Relaxed))
    }
}

/// Part `index` of `count` parts, counted from 1: every `count`-th drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    pub(super) index: usize,
    pub(super) count: usize,
}

impl Shard {
    /// Part `index` of `count` parts; none unless 1 ≤ index ≤ count.
    #[must_use]
    pub fn new(index: usize, count: usize) -> Option<Self> {
        (1..=count).contains(&index).then_some(Self { index, count })
    }

    fn has(self, position: usize) -> bool {
        position % self.count == self.index - 1
    }
}

impl std::str::FromStr for Shard {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        parts.and_then(|(index, count)| Self::new(index, count)).ok_or_else(|| "expected I/N with 1 ≤ I ≤ N".into())
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

/// The result of a drive.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Measured {
    /// The result in the format `stopline.drive/2`, without wall-clock times.
    pub(super) result: Map<String, Value>,
    /// The hash of each repetition.
    pub(super) hashes: Vec<String>,
}

impl Measured {
    pub(super) fn outcome(&self) -> &str {
        self.text("outcome")
    }

    pub(super) fn hash(&self) -> &str {
        self.text("hash")
    }

    fn text(&self, key: &str) -> &str {
        self.result.get(key).and_then(Value::as_str).unwrap_or_default()
    }
}

/// Progress of a run, after each finished drive.
#[derive(Debug, Clone, Copy)]
pub struct Progress<'a> {
    /// The number of finished drives.
    pub finished: usize,
    /// The number of all drives.
    pub total: usize,
    /// The id of the drive that finished last.
    pub id: &'a str,
}

impl Suite {
    /// Runs the drives and compares them with their expectations. The summary contains failed drives and drives that
    /// could not run; they are not errors.
    ///
    /// # Errors
    /// The baseline or the state file cannot be read or written.
    pub fn run(&self, options: &Options) -> Result<Summary, SuiteError> {
        self.run_watched(options, &|_| {})
    }

    /// Runs the suite as [`Suite::run`] does and calls `watch` after each finished drive, from any thread.
    ///
    /// # Errors
    /// See [`Suite::run`].
    pub fn run_watched(&self, options: &Options, watch: &(dyn Fn(Progress) + Sync)) -> Result<Summary, SuiteError> {
        let began = std::time::Instant::now();
        if options.update_baseline && self.baseline_file.is_none() {
            let message = "`--update-baseline` needs a `baseline` in the suite".into();
            return Err(SuiteError::Wrong { file: self.file.clone(), line: None, message });
        }
        let mut baseline = self.baseline(options.update_baseline)?;
        let state = options.resume.as_deref().map(State::open).transpose()?;
        let selected: Vec<&Case> = (self.cases.iter().enumerate())
            .filter(|(i, _)| options.shard.is_none_or(|shard| shard.has(*i)))
            .map(|(_, case)| case)
            .collect();
        let jobs = options.jobs.map_or_else(workers::cores, NonZeroUsize::get);
        let count = AtomicUsize::new(0);
        let driven = in_parallel(jobs, &selected, options, |case| {
            let Some(driven) = drive_or_recall(case, state.as_ref(), options)? else { return Ok(None) };
            let finished = count.fetch_add(1, Ordering::Relaxed) + 1;
            watch(Progress { finished, total: selected.len(), id: &case.id });
            Ok(Some((*case, driven)))
        })?;
        let not_driven = selected.len() - driven.len();
        let has_baseline = |id: &String| self.cases.iter().any(|c| c.id == *id && !c.expected.tolerances.is_empty());
        let mut stale: Vec<String> = baseline.drives.keys().filter(|id| !has_baseline(id)).cloned().collect();
        if options.update_baseline && not_driven == 0 {
            self.update(&mut baseline, &driven, &stale)?;
            stale.clear();
        }
        let mut drives: Vec<DriveReport> =
            driven.into_iter().map(|(case, driven)| self.report(case, driven, &baseline)).collect();
        self.draw(&mut drives, jobs, options)?;
        Ok(Summary {
            name: self.name.clone(),
            file: self.file.clone(),
            shard: options.shard,
            suite_drives: self.cases.len(),
            drives,
            not_driven,
            stale_in_baseline: stale,
            seconds: began.elapsed().as_secs_f64(),
        })
    }

    /// Stores the results in the baseline. Drives that could not run keep their entry; stale entries are removed.
    fn update(&self, baseline: &mut Baseline, driven: &[(&Case, Driven)], stale: &[String]) -> Result<(), SuiteError> {
        let mut drives = std::mem::take(&mut baseline.drives);
        drives.retain(|id, _| !stale.contains(id));
        for (case, driven) in driven {
            if let (Ok(measured), false) = (&driven.measured, case.expected.tolerances.is_empty()) {
                drives.insert(case.id.clone(), compare::baseline_of(case, measured));
            }
        }
        *baseline = Baseline::new(drives);
        self.baseline_file.as_deref().map_or(Ok(()), |file| baseline.write(file))
    }

    fn report(&self, case: &Case, driven: Driven, baseline: &Baseline) -> DriveReport {
        let before = self.baseline_file.as_ref().map(|_| baseline.drives.get(&case.id));
        let (failures, error, measured) = match driven.measured {
            Ok(measured) => (compare::failures(case, &measured, before), None, Some(measured)),
            Err(error) => (Vec::new(), Some(error), None),
        };
        DriveReport {
            id: case.id.clone(),
            scenario: case.scenario_name.clone(),
            vehicle: case.vehicle.name.clone(),
            seed: case.seed,
            inputs: driven.key,
            config: case.config.to_string(),
            status: status(&failures, error.as_ref(), case.expected.failure.is_some()),
            expected_failure: case.expected.failure.clone(),
            failures,
            error,
            measured,
            picture: None,
        }
    }

    /// Draws the first failed drives. Each one runs again for its picture.
    fn draw(&self, drives: &mut [DriveReport], jobs: usize, options: &Options) -> Result<(), SuiteError> {
        let failed = drives.iter_mut().filter(|d| d.status.is_failure() && d.measured.is_some());
        let mut failed: Vec<&mut DriveReport> = failed.take(options.pictures).collect();
        let cases: Vec<&Case> = failed.iter().filter_map(|d| self.cases.iter().find(|c| c.id == d.id)).collect();
        let draw = |case: &&Case| Ok(Some(case.with_run(&case.settings, |run, _| run_svg(run)).ok()));
        for (drive, picture) in failed.iter_mut().zip(in_parallel(jobs, &cases, options, draw)?) {
            drive.picture = picture;
        }
        Ok(())
    }
}

fn status(failures: &[Failure], error: Option<&DriveError>, is_expected: bool) -> Status {
    match (error, failures) {
        (Some(_), _) => Status::Error,
        (None, []) => Status::Pass,
        (None, [Failure { kind: FailureKind::UnexpectedPass, .. }]) => Status::UnexpectedPass,
        (None, failures) if failures.iter().any(|f| f.kind == FailureKind::UnknownName) => Status::Fail,
        (None, _) if is_expected => Status::ExpectedFailure,
        (None, _) => Status::Fail,
    }
}

/// The result of a drive and the hash of its inputs.
struct Driven {
    key: String,
    measured: Result<Measured, DriveError>,
}

/// Calls `work` for every item, `jobs` at a time, and returns the results in order, without those that are none. An error
/// stops the run and is returned. After a cancellation no further item starts.
fn in_parallel<T: Sync, R: Send>(
    jobs: usize,
    items: &[T],
    options: &Options,
    work: impl Fn(&T) -> Result<Option<R>, SuiteError> + Sync,
) -> Result<Vec<R>, SuiteError> {
    let failed = AtomicBool::new(false);
    let stop = || failed.load(Ordering::Relaxed) || options.is_cancelled();
    let watched = |item: &T| work(item).inspect_err(|_| failed.store(true, Ordering::Relaxed));
    let tried = workers::in_order(jobs, items, &stop, watched);
    let tried = tried.map_err(|e| SuiteError::Fault(format!("cannot start threads: {e}")))?;
    tried.into_iter().filter_map(Result::transpose).collect()
}

/// Drives the case, or takes the stored result of an earlier run; none if the run was cancelled between repetitions.
fn drive_or_recall(case: &Case, state: Option<&State>, options: &Options) -> Result<Option<Driven>, SuiteError> {
    let key = match key(case, &case.config) {
        Ok(key) => key,
        Err(error) => return Ok(Some(Driven { key: String::new(), measured: Err(error) })),
    };
    if let Some(measured) = state.and_then(|s| s.finished(&key)) {
        return Ok(Some(Driven { key, measured: Ok(measured.clone()) }));
    }
    let measured = match case.drive(options) {
        Ok(None) => return Ok(None),
        Ok(Some(measured)) => Ok(measured),
        Err(error) => Err(error),
    };
    if let (Some(state), Ok(measured)) = (state, &measured) {
        state.append_drive(&key, measured)?;
    }
    Ok(Some(Driven { key, measured }))
}

/// SHA-256 of all inputs of a drive, hexadecimal: program, scenario, problem, vehicle, settings, seed, repetitions.
pub(super) fn key(case: &Case, config: &str) -> Result<String, DriveError> {
    let scenario = files::read(&case.scenario, MAX_SCENARIO_BYTES).map_err(DriveError::input)?;
    let mut hasher = Sha256::new();
    let parts: [&[u8]; 6] = [
        concat!("stopline ", env!("CARGO_PKG_VERSION")).as_bytes(),
        &scenario,
        // `Debug` prints every number so that it reads back exactly
        &format!("{:?}", case.vehicle).into_bytes(),
        config.as_bytes(),
        &case.seed.to_le_bytes(),
        &format!("{:?} {}", case.problem, case.repetitions).into_bytes(),
    ];
    for part in parts {
        hasher.update((part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

impl Case {
    /// Drives all repetitions; none if the run is cancelled between two of them.
    fn drive(&self, options: &Options) -> Result<Option<Measured>, DriveError> {
        let scenario = commonroad::read_file(&self.scenario).map_err(DriveError::input)?;
        let problem = self.problem(&scenario)?;
        let mut measured: Option<Measured> = None;
        for _ in 0..self.repetitions {
            if measured.is_some() && options.is_cancelled() {
                return Ok(None);
            }
            let RunResult { hash, json, .. } = self.driven(&scenario, problem, &self.settings, |_, result| result)?;
            measured.get_or_insert_with(|| Measured { result: json, hashes: Vec::new() }).hashes.push(hash);
        }
        Ok(measured)
    }

    /// Drives once and passes the run to `show`.
    pub(super) fn with_run<T>(
        &self,
        settings: &drive::Settings,
        show: impl FnOnce(&Run, RunResult) -> T,
    ) -> Result<T, DriveError> {
        let scenario = commonroad::read_file(&self.scenario).map_err(DriveError::input)?;
        self.driven(&scenario, self.problem(&scenario)?, settings, show)
    }

    fn problem<'a>(&self, scenario: &'a Scenario) -> Result<&'a PlanningProblem, DriveError> {
        let ids = scenario.problems.iter().map(|p| p.id.to_string()).collect::<Vec<_>>().join(", ");
        let file = self.scenario.display();
        match (self.problem, scenario.problems.as_slice()) {
            (Some(id), problems) => problems
                .iter()
                .find(|p| p.id == id)
                .ok_or_else(|| DriveError::input(format!("{file}: has no planning problem {id}; it has {ids}"))),
            (None, [only]) => Ok(only),
            (None, _) => {
                let message = format!("{file}: has several planning problems; choose one of {ids} with `problem`");
                Err(DriveError::input(message))
            }
        }
    }

    /// Drives once. A panic, whose message is already on stderr, is an error of this drive; the suite goes on.
    fn driven<T>(
        &self,
        scenario: &Scenario,
        problem: &PlanningProblem,
        settings: &drive::Settings,
        show: impl FnOnce(&Run, RunResult) -> T,
    ) -> Result<T, DriveError> {
        let work = || -> Result<T, drive::DriveError> {
            let run = drive::drive(scenario, problem, &self.vehicle, settings, &mut |_, _| {})?;
            let result = RunResult::new(Kind::Drive, &run, settings, self.seed);
            Ok(show(&run, result))
        };
        match catch_unwind(AssertUnwindSafe(work)) {
            Ok(result) => result.map_err(DriveError::input),
            Err(panic) => {
                let message = panic.downcast_ref::<String>().map(String::as_str);
                let message = message.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or_default();
                Err(DriveError { kind: ErrorKind::Fault, message: format!("stopline has a fault: {message}") })
            }
        }
    }
}

/// The shell command that drives a case.
pub(super) fn command(scenario: &Path, vehicle: &str, problem: Option<i64>, config: &Path, seed: u64) -> String {
    let (scenario, config, seed) = (scenario.to_string_lossy(), config.to_string_lossy(), seed.to_string());
    let problem = problem.map(|id| id.to_string());
    let mut words = vec!["stopline", "drive", &scenario, "--vehicle", vehicle];
    words.extend(problem.as_deref().into_iter().flat_map(|id| ["--problem", id]));
    words.extend(["--config", &config, "--seed", &seed]);
    shell_command(words)
}

/// The words of a command as one line for a POSIX shell. A word with a NUL byte, which no argument can have, stays as it
/// is.
#[must_use]
pub fn shell_command<'a>(words: impl IntoIterator<Item = &'a str>) -> String {
    let quoted = |word: &'a str| shlex::try_quote(word).unwrap_or(word.into());
    words.into_iter().map(quoted).collect::<Vec<_>>().join(" ")
}
