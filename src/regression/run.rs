//! Driving the drives of a suite, side by side, with the same result for any number of jobs.
//!
//! Each worker is a thread pool of its own: a planner that searches as many paths side by side as its pool has threads
//! throws some of that work away, which costs nothing only while other cores idle. So every drive gets one thread as
//! long as there are more drives than jobs. Workers take the next drive from a counter; what they found is put back in
//! the suite's order.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
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

/// Largest scenario, bytes: as its reader has it.
const MAX_SCENARIO_BYTES: u64 = 256 << 20;

/// How a suite is run.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Drives side by side; as many as there are cores if not given.
    pub jobs: Option<NonZeroUsize>,
    /// The part of the suite to drive; all of it if not given.
    pub shard: Option<Shard>,
    /// A file that keeps what is finished, so that an interrupted run goes on.
    pub resume: Option<PathBuf>,
    /// Whether to keep what is found as the new baseline.
    pub bless: bool,
    /// Pictures of failed drives to draw at most, the first ones of the suite.
    pub pictures: usize,
}

/// Part `index` of `count`, counted from 1: every `count`-th drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    /// Part `index` of `count`; none unless 1 ≤ index ≤ count.
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

/// What a drive came to.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Measured {
    /// In the format `stopline.drive/2`, without times of the wall clock.
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

/// A finished drive, and how many there will be.
#[derive(Debug, Clone, Copy)]
pub struct Progress<'a> {
    /// Drives finished.
    pub finished: usize,
    /// Drives in all.
    pub total: usize,
    /// The one finished last.
    pub id: &'a str,
}

impl Suite {
    /// Drives the suite and compares. What drives come to, failed or broken, is in the summary.
    ///
    /// # Errors
    /// The baseline cannot be read or written, or the state file cannot.
    pub fn run(&self, options: &Options) -> Result<Summary, SuiteError> {
        self.run_watched(options, &|_| {})
    }

    /// As [`Suite::run`]; `watch` hears of every finished drive, from any thread.
    ///
    /// # Errors
    /// As [`Suite::run`].
    pub fn run_watched(&self, options: &Options, watch: &(dyn Fn(Progress) + Sync)) -> Result<Summary, SuiteError> {
        let began = std::time::Instant::now();
        let mut baseline = self.baseline(options.bless)?;
        let state = options.resume.as_deref().map(State::open).transpose()?;
        let selected: Vec<&Case> = (self.cases.iter().enumerate())
            .filter(|(i, _)| options.shard.is_none_or(|shard| shard.has(*i)))
            .map(|(_, case)| case)
            .collect();
        let jobs = options.jobs.or_else(|| std::thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get);
        let finished = AtomicUsize::new(0);
        let driven = side_by_side(jobs, &selected, |case| {
            let found = drive_or_recall(case, state.as_ref());
            let finished = finished.fetch_add(1, Ordering::Relaxed) + 1;
            watch(Progress { finished, total: selected.len(), id: &case.id });
            found
        })?;
        let is_kept = |id: &String| self.cases.iter().any(|c| c.id == *id && !c.expected.tolerances.is_empty());
        let stale: Vec<String> = baseline.drives.keys().filter(|id| !is_kept(id)).cloned().collect();
        if options.bless {
            self.bless(&mut baseline, &selected, &driven, &stale)?;
        }
        let mut drives: Vec<DriveReport> =
            selected.iter().zip(driven).map(|(case, found)| self.report(case, found, &baseline)).collect();
        self.draw(&mut drives, options.pictures, jobs)?;
        Ok(Summary {
            name: self.name.clone(),
            file: self.file.clone(),
            shard: options.shard,
            drives,
            stale_in_baseline: if options.bless { Vec::new() } else { stale },
            seconds: began.elapsed().as_secs_f64(),
        })
    }

    /// Keeps what was found. Drives that broke keep what they had, drives that are gone go.
    fn bless(
        &self,
        baseline: &mut Baseline,
        selected: &[&Case],
        driven: &[Found],
        stale: &[String],
    ) -> Result<(), SuiteError> {
        let Some(file) = &self.baseline_file else {
            let message = "`--bless` needs a `baseline` in the suite".into();
            return Err(SuiteError::Wrong { file: self.file.clone(), line: None, message });
        };
        let mut drives = std::mem::take(&mut baseline.drives);
        stale.iter().for_each(|id| drop(drives.remove(id)));
        for (case, found) in selected.iter().zip(driven) {
            if let (Ok(measured), false) = (&found.measured, case.expected.tolerances.is_empty()) {
                drives.insert(case.id.clone(), compare::kept(case, measured));
            }
        }
        *baseline = Baseline::new(drives);
        baseline.write(file)
    }

    fn report(&self, case: &Case, found: Found, baseline: &Baseline) -> DriveReport {
        let kept = self.baseline_file.as_ref().map(|_| baseline.drives.get(&case.id));
        let (failures, error, measured) = match found.measured {
            Ok(measured) => (compare::failures(case, &measured, kept), None, Some(measured)),
            Err(error) => (Vec::new(), Some(error), None),
        };
        DriveReport {
            id: case.id.clone(),
            scenario: case.scenario_name.clone(),
            vehicle: case.vehicle.name.clone(),
            seed: case.seed,
            inputs: found.key,
            config: case.config.to_string(),
            status: status(&failures, error.as_ref(), case.expected.fail.is_some()),
            expected_fail: case.expected.fail.clone(),
            failures,
            error,
            measured,
            picture: None,
        }
    }

    /// Pictures of the first failed drives, which are driven again for it.
    fn draw(&self, drives: &mut [DriveReport], most: usize, jobs: usize) -> Result<(), SuiteError> {
        let failed = drives.iter_mut().filter(|d| d.status.is_failure() && d.measured.is_some()).take(most);
        let mut failed: Vec<&mut DriveReport> = failed.collect();
        let cases: Vec<&Case> = failed.iter().filter_map(|d| self.cases.iter().find(|c| c.id == d.id)).collect();
        let pictures =
            side_by_side(jobs, &cases, |case| Ok(case.with_run(&case.settings, |run, _| run_svg(run)).ok()))?;
        for (drive, picture) in failed.iter_mut().zip(pictures) {
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
        (None, _) if is_expected => Status::ExpectedFail,
        (None, _) => Status::Fail,
    }
}

/// What became of a drive, and the hash of its inputs.
struct Found {
    key: String,
    measured: Result<Measured, DriveError>,
}

/// Does `work` on every item, `jobs` at a time, and gives the results in order. The first error ends it.
fn side_by_side<T: Sync, R: Send>(
    jobs: usize,
    items: &[T],
    work: impl Fn(&T) -> Result<R, SuiteError> + Sync,
) -> Result<Vec<R>, SuiteError> {
    let workers = jobs.min(items.len()).max(1);
    let threads = (jobs / workers).max(1);
    let (next, stopped) = (AtomicUsize::new(0), AtomicBool::new(false));
    let results: Mutex<BTreeMap<usize, Result<R, SuiteError>>> = Mutex::new(BTreeMap::new());
    let take_and_work = || {
        while !stopped.load(Ordering::Relaxed) {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else { break };
            let result = work(item);
            if result.is_err() {
                stopped.store(true, Ordering::Relaxed);
            }
            results.lock().unwrap_or_else(std::sync::PoisonError::into_inner).insert(index, result);
        }
    };
    let pools: Result<Vec<_>, _> =
        (0..workers).map(|_| rayon::ThreadPoolBuilder::new().num_threads(threads).build()).collect();
    let pools = pools.map_err(|e| SuiteError::Fault(format!("no threads: {e}")))?;
    std::thread::scope(|scope| {
        for pool in &pools {
            scope.spawn(|| pool.install(take_and_work));
        }
    });
    results.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner).into_values().collect()
}

fn drive_or_recall(case: &Case, state: Option<&State>) -> Result<Found, SuiteError> {
    let key = match key(case, &case.config) {
        Ok(key) => key,
        Err(error) => return Ok(Found { key: String::new(), measured: Err(error) }),
    };
    if let Some(measured) = state.and_then(|s| s.finished(&key)) {
        return Ok(Found { key, measured: Ok(measured.clone()) });
    }
    let measured = case.drive();
    if let (Some(state), Ok(measured)) = (state, &measured) {
        state.keep(&key, measured)?;
    }
    Ok(Found { key, measured })
}

/// Hash of everything that decides what a drive comes to: program, scenario, problem, vehicle, settings, seed,
/// repetitions. SHA-256, hexadecimal.
pub(super) fn key(case: &Case, config: &str) -> Result<String, DriveError> {
    let scenario = files::read(&case.scenario, MAX_SCENARIO_BYTES).map_err(DriveError::input)?;
    let mut hasher = Sha256::new();
    let parts: [&[u8]; 6] = [
        concat!("stopline ", env!("CARGO_PKG_VERSION")).as_bytes(),
        &scenario,
        // shortest texts of numbers that read back the same: all of the vehicle, exactly
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
    /// Drives it as often as it asks for.
    fn drive(&self) -> Result<Measured, DriveError> {
        let scenario = commonroad::read_file(&self.scenario).map_err(DriveError::input)?;
        let problem = self.problem(&scenario)?;
        let mut measured: Option<Measured> = None;
        for _ in 0..self.repetitions {
            let RunResult { hash, json, .. } = self.driven(&scenario, problem, &self.settings, |_, result| result)?;
            measured.get_or_insert_with(|| Measured { result: json, hashes: Vec::new() }).hashes.push(hash);
        }
        measured.ok_or_else(|| DriveError { kind: ErrorKind::Fault, message: "no repetition".into() })
    }

    /// Drives it once and shows the run.
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

    /// A panic, whose message is on stderr already, is this drive's and not the end of the suite.
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
                let told = panic.downcast_ref::<String>().cloned();
                let told = told.or_else(|| panic.downcast_ref::<&str>().map(|s| (*s).to_owned())).unwrap_or_default();
                Err(DriveError { kind: ErrorKind::Fault, message: format!("stopline has a fault: {told}") })
            }
        }
    }
}

/// The command that makes a drive, for a shell.
pub(super) fn command(scenario: &Path, vehicle: &str, problem: Option<i64>, config: &Path, seed: u64) -> String {
    let quoted = |text: &str| {
        let is_plain = text.chars().all(|c| c.is_ascii_alphanumeric() || "._-/=+@,:".contains(c));
        if is_plain && !text.is_empty() { text.to_owned() } else { format!("'{}'", text.replace('\'', "'\\''")) }
    };
    let problem = problem.map_or_else(String::new, |id| format!(" --problem {id}"));
    let (scenario, config) = (scenario.to_string_lossy(), config.to_string_lossy());
    let (scenario, vehicle, config) = (quoted(&scenario), quoted(vehicle), quoted(&config));
    format!("stopline drive {scenario} --vehicle {vehicle}{problem} --config {config} --seed {seed}")
}
