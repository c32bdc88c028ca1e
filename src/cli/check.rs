//! `stopline check`: runs suites and writes reports, or replays a drive.
//!
//! Without `--quiet` the summary of each suite goes to stdout. With `--quiet` stdout has one line per failed drive, and
//! stderr one line per error. With `--json -` stdout has the JSON only, and all text goes to stderr.
//!
//! The first Ctrl-C cancels the run: running drives are finished, the results so far are printed, and no report is written.
//! The second one ends the process at once. While reports are written, which takes milliseconds, Ctrl-C has no effect: no
//! temporary file stays behind.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

use super::args::CheckArgs;
use super::job::check_files;
use super::{Exit, Failure, engine, print, progress, report, say};
use crate::io::files;
use crate::io::kind::FileKind;
use crate::plot::run_svg;
use crate::regression::report::{html, json, junit, markdown};
use crate::regression::{
    DriveError, ErrorKind, Options, Progress, Replay, ReplayError, Status, Suite, SuiteError, Summary, shell_command,
};

/// The largest number of pictures in an HTML report: a picture has about 150 kB.
const MAX_PICTURES: usize = 24;

impl From<SuiteError> for Failure {
    fn from(error: SuiteError) -> Self {
        match error {
            SuiteError::Fault(message) => Self::Fault(message),
            state @ SuiteError::State { .. } => Self::File(format!("--resume {state}")),
            other => Self::file(other),
        }
    }
}

/// Runs the suites, or replays one of their drives.
pub(super) fn run(args: &CheckArgs) -> Result<Exit, Failure> {
    if args.bless {
        return Err(Failure::Use("--bless is now --update-baseline".into()));
    }
    let suites = args.suites.iter().map(load).collect::<Result<Vec<_>, _>>()?;
    let mut inputs: Vec<PathBuf> = suites.iter().flat_map(Suite::inputs).collect();
    inputs.extend(args.resume.iter().chain(&args.report).cloned());
    check_outputs(args, inputs)?;
    check_distinct(args, &suites)?;
    match &args.replay {
        Some(id) => replay(args, &suites, id),
        None => check(args, &suites),
    }
}

/// Reads a suite. A file of another kind is named, with the flag or command that reads it.
fn load(path: &PathBuf) -> Result<Suite, Failure> {
    Suite::load(path).map_err(|error| match FileKind::of(path) {
        None | Some(FileKind::Suite | FileKind::SuiteFolder) => error.into(),
        Some(kind) => {
            let file = path.display();
            Failure::File(format!("{file}: this is {kind}, expected a regression suite in TOML; {}", kind.reader()))
        }
    })
}

/// Whether the JSON report goes to stdout.
fn is_json_on_stdout(args: &CheckArgs) -> bool {
    args.json.as_deref() == Some(Path::new("-"))
}

/// Each output once, none of them an input, all writable. An error names the flag.
fn check_outputs(args: &CheckArgs, mut inputs: Vec<PathBuf>) -> Result<(), Failure> {
    let json = args.json.as_ref().filter(|_| !is_json_on_stdout(args));
    let outputs = [
        ("--json", json),
        ("--junit", args.junit.as_ref()),
        ("--markdown", args.markdown.as_ref()),
        ("--html", args.html.as_ref()),
        ("--svg", args.svg.as_ref()),
        ("--save-config", args.save_config.as_ref()),
    ];
    for (flag, file) in outputs.into_iter().filter_map(|(flag, file)| Some((flag, file?))) {
        if file == Path::new("-") {
            let reason = "only --json prints to stdout with `-`; a file of that name is `./-`";
            return Err(Failure::Use(format!("{flag} -: {reason}")));
        }
        check_files(&[file], &inputs).map_err(|failure| named(flag, failure))?;
        let is_device = std::fs::metadata(file).is_ok_and(|about| !about.is_file() && !about.is_dir());
        inputs.extend(Some(file.clone()).filter(|_| !is_device));
    }
    Ok(())
}

/// The failure with the flag before its message.
fn named(flag: &str, failure: Failure) -> Failure {
    match failure {
        Failure::Use(message) => Failure::Use(format!("{flag} {message}")),
        Failure::File(message) => Failure::File(format!("{flag} {message}")),
        fault @ Failure::Fault(_) => fault,
    }
}

/// No suite twice, and no baseline that two suites update: each would remove the entries of the other.
fn check_distinct(args: &CheckArgs, suites: &[Suite]) -> Result<(), Failure> {
    for (i, suite) in suites.iter().enumerate() {
        for other in &suites[..i] {
            if is_same_file(&suite.file, &other.file) {
                return Err(Failure::Use(format!("{}: named twice", suite.file.display())));
            }
            let baselines = suite.baseline_file().zip(other.baseline_file());
            if let Some((file, _)) = baselines.filter(|(a, b)| args.update_baseline && is_same_file(a, b)) {
                let (a, b, file) = (other.file.display(), suite.file.display(), file.display());
                return Err(Failure::Use(format!("--update-baseline: {a} and {b} have the same baseline, {file}")));
            }
        }
    }
    Ok(())
}

fn is_same_file(a: &Path, b: &Path) -> bool {
    let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    real(a) == real(b)
}

fn check(args: &CheckArgs, suites: &[Suite]) -> Result<Exit, Failure> {
    let interrupt = Interrupt::on_ctrl_c()?;
    let options = Options {
        jobs: args.jobs.and_then(|n| std::num::NonZeroUsize::new(n.into())),
        shard: args.shard,
        resume: args.resume.clone(),
        update_baseline: args.update_baseline,
        pictures: if args.html.is_some() { MAX_PICTURES } else { 0 },
        cancel: Some(Arc::clone(&interrupt.cancel)),
    };
    let mut summaries = Vec::new();
    for suite in suites {
        let bar = progress::bar(!args.quiet);
        let watch = |Progress { finished, total, id }: Progress| {
            bar.set_length(total as u64);
            bar.set_position(finished as u64);
            bar.set_message(format!("{finished} of {total} drives, {id}"));
        };
        let summary = suite.run_watched(&options, &watch);
        bar.finish_and_clear();
        let summary = summary?;
        if let (Some(empty), true) = (summary.empty_shard(), args.quiet) {
            say(&format!("warning: {}: {empty}", suite.file.display()));
        }
        summaries.push(summary);
    }
    if !interrupt.begin_reports() {
        show(args, &summaries)?;
        say(&interruption(args, &summaries));
        return Ok(Exit::Interrupted);
    }
    // all reports are tried: one that cannot be written does not affect the others
    let written = write_reports(args, &summaries);
    show(args, &summaries)?;
    written.map(|()| exit(&summaries))
}

/// The handler of Ctrl-C.
struct Interrupt {
    cancel: Arc<AtomicBool>,
    phase: Arc<AtomicU8>,
}

impl Interrupt {
    const DRIVING: u8 = 0;
    const CANCELLED: u8 = 1;
    const REPORTING: u8 = 2;

    fn on_ctrl_c() -> Result<Self, Failure> {
        let (cancel, phase) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU8::new(Self::DRIVING)));
        let this = Self { cancel: Arc::clone(&cancel), phase: Arc::clone(&phase) };
        let handler = move || match Self::change(&phase, Self::CANCELLED) {
            Ok(()) => {
                cancel.store(true, Ordering::SeqCst);
                say("interrupted: finishing the running drives; a second Ctrl-C stops at once");
            }
            Err(Self::CANCELLED) => std::process::exit(Exit::Interrupted as i32),
            Err(_) => {}
        };
        ctrlc::set_handler(handler).map_err(|e| Failure::Fault(format!("cannot handle Ctrl-C: {e}")))?;
        Ok(this)
    }

    /// Whether the run was not cancelled. From then on Ctrl-C has no effect.
    fn begin_reports(&self) -> bool {
        Self::change(&self.phase, Self::REPORTING).is_ok()
    }

    /// Leaves the phase of driving, or returns the phase that it was left for.
    fn change(phase: &AtomicU8, to: u8) -> Result<(), u8> {
        phase.compare_exchange(Self::DRIVING, to, Ordering::SeqCst, Ordering::SeqCst).map(drop)
    }
}

/// Which part of the run is finished, and how to continue.
fn interruption(args: &CheckArgs, summaries: &[Summary]) -> String {
    let drives = || summaries.iter().flat_map(|s| &s.drives);
    let finished = drives().count();
    let total = finished + summaries.iter().map(|s| s.not_driven).sum::<usize>();
    let failed = drives().filter(|d| d.status.is_failure() || d.status == Status::Error).count();
    let next = if args.resume.is_some() {
        let words: Vec<String> = std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect();
        format!("continue with: {}", shell_command(words.iter().map(String::as_str)))
    } else {
        "the results are lost; with --resume STATE they would be stored, and the run could continue".to_owned()
    };
    format!("interrupted: {finished} of {total} drives finished, {failed} failed; no report was written\n{next}")
}

/// Prints the summaries; with `--quiet`, one line per failed drive, and errors.
fn show(args: &CheckArgs, summaries: &[Summary]) -> Result<(), Failure> {
    let mut text = String::new();
    if args.quiet {
        for drive in summaries.iter().flat_map(|s| &s.drives) {
            drive.error.iter().for_each(|e| say(&format!("error: {}: {e}", drive.id)));
            let problems = drive.problems();
            if let (Some(first), true) = (problems.first(), drive.status.is_failure()) {
                let more = if problems.len() > 1 { format!("; {} more", problems.len() - 1) } else { String::new() };
                let event = first.lines().next().unwrap_or_default();
                text += &format!("{}: {}: {event}{more}\n", drive.id, drive.status.label());
            }
        }
    } else {
        summaries.iter().for_each(|summary| text += &format!("{summary}{:.1} s\n", summary.seconds));
    }
    if is_json_on_stdout(args) {
        text.lines().for_each(say);
        return Ok(());
    }
    print(&text)
}

/// The exit code for the worst result.
fn exit(summaries: &[Summary]) -> Exit {
    let drives = || summaries.iter().flat_map(|s| &s.drives);
    let has = |kind: ErrorKind| drives().any(|d| d.error.as_ref().is_some_and(|e| e.kind == kind));
    match () {
        () if has(ErrorKind::Fault) => Exit::OwnFault,
        () if has(ErrorKind::Input) => Exit::BadFile,
        () if drives().any(|d| d.status.is_failure() || d.status == Status::Error) => Exit::CheckFailed,
        () => Exit::Pass,
    }
}

fn write_reports(args: &CheckArgs, summaries: &[Summary]) -> Result<(), Failure> {
    let mut written = Ok(());
    let mut write = |flag: &str, path: &Option<PathBuf>, text: &dyn Fn() -> Result<String, Failure>| {
        if let Some(path) = path {
            let put = |text: String| files::write_atomic(path, text.as_bytes()).map_err(Failure::file);
            if let Err(failure) = text().and_then(put) {
                let failure = named(flag, failure);
                // the program ends with the first failure; the others are printed here
                if written.is_ok() { written = Err(failure) } else { say(&format!("error: {failure}")) }
            }
        }
    };
    write("--junit", &args.junit, &|| junit(summaries).map_err(|e| Failure::Fault(e.to_string())));
    write("--markdown", &args.markdown, &|| Ok(markdown(summaries)));
    write("--html", &args.html, &|| Ok(html(summaries)));
    if is_json_on_stdout(args) {
        return written.and(print(&json(summaries)));
    }
    write("--json", &args.json, &|| Ok(json(summaries)));
    written
}

/// Drives one case again, prints its report as `stopline drive` does, and compares the hash with that of a report.
fn replay(args: &CheckArgs, suites: &[Suite], id: &str) -> Result<Exit, Failure> {
    let mut replay = Replay::find(suites, id).map_err(replay_failure)?;
    if let Some(file) = &args.report {
        replay = replay.as_reported(file).map_err(replay_failure)?;
    }
    let is_same_input = replay.has_reported_inputs().map_err(replay_failure)?;
    let (text, picture, hash, pass) = replay
        .drive(|run, result| {
            let picture = args.svg.is_some().then(|| run_svg(run));
            let (hash, pass) = (result.hash.clone(), result.pass);
            let summary = engine::Summary { result, solution: None, json: serde_json::Value::Null };
            (report::text(run, &summary), picture, hash, pass)
        })
        .map_err(replay_failure)?;
    let write = |flag: &str, file: &Path, text: &str| {
        files::write_atomic(file, text.as_bytes()).map_err(|e| named(flag, Failure::file(e)))
    };
    if let (Some(file), Some(picture)) = (&args.svg, picture) {
        write("--svg", file, &picture)?;
    }
    if let Some(file) = &args.save_config {
        write("--save-config", file, replay.config())?;
        say(&format!("the same drive: {}", replay.command(file)));
    }
    if !args.quiet {
        print(&text)?;
    }
    match replay.reported_hash() {
        Some(reported) if reported == hash => {
            say("replayed: the hash equals that of the report");
            Ok(Exit::Pass)
        }
        Some(reported) => {
            let why = if is_same_input {
                "the inputs are the same: another build, or stopline is not deterministic"
            } else {
                "the inputs differ: program version, scenario, vehicle or seed have changed"
            };
            say(&format!("replayed: the hash is {hash}, in the report {reported}; {why}"));
            Ok(Exit::CheckFailed)
        }
        None => Ok(if pass { Exit::Pass } else { Exit::CheckFailed }),
    }
}

fn replay_failure(error: ReplayError) -> Failure {
    match error {
        ReplayError::Unknown { .. } => Failure::Use(format!("--replay: {error}")),
        ReplayError::Report { .. } => Failure::File(format!("--report {error}")),
        ReplayError::Drive(DriveError { kind: ErrorKind::Fault, message }) => Failure::Fault(message),
        other => Failure::file(other),
    }
}
