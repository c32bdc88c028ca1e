//! `stopline check`: suites, their reports, replays.

use std::path::{Path, PathBuf};

use super::args::CheckArgs;
use super::job::check_files;
use super::{Exit, Failure, engine, print, progress, report, say};
use crate::io::files;
use crate::plot::run_svg;
use crate::regression::report::{html, json, junit, markdown};
use crate::regression::{ErrorKind, Options, Progress, ReplayError, Status, Suite, SuiteError, Summary};

/// Failed drives whose pictures an HTML report has at most: each is some 150 kB, and nobody looks at more.
const MOST_PICTURES: usize = 24;

impl From<SuiteError> for Failure {
    fn from(error: SuiteError) -> Self {
        match error {
            SuiteError::Fault(message) => Self::Fault(message),
            other => Self::file(other),
        }
    }
}

/// Runs the suites, or replays one of their drives.
pub(super) fn run(args: &CheckArgs) -> Result<Exit, Failure> {
    let suites = args.suites.iter().map(Suite::load).collect::<Result<Vec<_>, _>>()?;
    let mut inputs: Vec<PathBuf> = suites.iter().flat_map(Suite::inputs).collect();
    inputs.extend(args.resume.iter().chain(&args.report).cloned());
    let is_stdout = args.json.as_deref() == Some(Path::new("-"));
    let json = args.json.as_ref().filter(|_| !is_stdout);
    let outputs = [json, args.junit.as_ref(), args.markdown.as_ref(), args.html.as_ref()];
    let replays = [args.svg.as_ref(), args.save_config.as_ref()];
    let outputs: Vec<&Path> = outputs.into_iter().chain(replays).flatten().map(PathBuf::as_path).collect();
    check_files(&outputs, &inputs)?;
    distinct(args, &suites)?;
    match &args.replay {
        Some(id) => replay(args, &suites, id),
        None => check(args, &suites, is_stdout),
    }
}

/// No suite twice, and no baseline written by two of them: each would throw out what the other one keeps.
fn distinct(args: &CheckArgs, suites: &[Suite]) -> Result<(), Failure> {
    for (i, suite) in suites.iter().enumerate() {
        for other in &suites[..i] {
            if same_file(&suite.file, &other.file) {
                return Err(Failure::Use(format!("{}: named twice", suite.file.display())));
            }
            let baselines = suite.baseline_file().zip(other.baseline_file());
            if let Some((file, _)) = baselines.filter(|(a, b)| args.bless && same_file(a, b)) {
                let (a, b) = (other.file.display(), suite.file.display());
                return Err(Failure::Use(format!(
                    "--bless: {a} and {b} keep their figures in one file, {}",
                    file.display()
                )));
            }
        }
    }
    Ok(())
}

fn same_file(a: &Path, b: &Path) -> bool {
    let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    real(a) == real(b)
}

fn check(args: &CheckArgs, suites: &[Suite], is_stdout: bool) -> Result<Exit, Failure> {
    let options = Options {
        jobs: args.jobs.and_then(|n| std::num::NonZeroUsize::new(n.into())),
        shard: args.shard,
        resume: args.resume.clone(),
        bless: args.bless,
        pictures: if args.html.is_some() { MOST_PICTURES } else { 0 },
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
        summaries.push(summary?);
    }
    // every report is tried: one that cannot be written does not take the others with it
    let written = write(args, &summaries, is_stdout);
    if args.quiet {
        for drive in summaries.iter().flat_map(|s| &s.drives) {
            drive.error.iter().for_each(|e| say(&format!("error: {}: {e}", drive.id)));
        }
    } else {
        for summary in &summaries {
            let text = format!("{summary}{:.1} s\n", summary.seconds);
            if is_stdout { text.lines().for_each(say) } else { print(&text)? }
        }
    }
    written.map(|()| exit(&summaries))
}

/// The worst of what happened.
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

fn write(args: &CheckArgs, summaries: &[Summary], is_stdout: bool) -> Result<(), Failure> {
    let mut written = Ok(());
    let mut put = |path: &Option<PathBuf>, text: &dyn Fn() -> Result<String, Failure>| {
        if let Some(path) = path {
            let one = text().and_then(|text| files::write_atomic(path, text.as_bytes()).map_err(Failure::file));
            if let Err(error) = one {
                // the first one is what the program ends with; the others are told
                if written.is_ok() { written = Err(error) } else { say(&format!("error: {error}")) }
            }
        }
    };
    put(&args.junit, &|| junit(summaries).map_err(|e| Failure::Fault(e.to_string())));
    put(&args.markdown, &|| Ok(markdown(summaries)));
    put(&args.html, &|| Ok(html(summaries)));
    if is_stdout {
        return written.and(print(&json(summaries)));
    }
    put(&args.json, &|| Ok(json(summaries)));
    written
}

/// Drives one of them again, tells it as `stopline drive` does, and compares the hash with that of a report.
fn replay(args: &CheckArgs, suites: &[Suite], id: &str) -> Result<Exit, Failure> {
    let has_it = suites.iter().find(|s| s.ids().any(|known| known == id));
    let Some(suite) = has_it.or(suites.first()) else { return Err(Failure::Use("no suite".into())) };
    let mut replay = suite.replay(id).map_err(replay_failure)?;
    if let Some(file) = &args.report {
        replay = replay.as_reported(file).map_err(replay_failure)?;
    }
    let same_inputs = replay.has_reported_inputs().map_err(replay_failure)?;
    let (text, picture, hash, held) = replay
        .drive(|run, result| {
            let picture = args.svg.is_some().then(|| run_svg(run));
            let (hash, held) = (result.hash.clone(), result.pass);
            let summary = engine::Summary { result, solution: None, json: serde_json::Value::Null };
            (report::text(run, &summary), picture, hash, held)
        })
        .map_err(replay_failure)?;
    if let (Some(file), Some(picture)) = (&args.svg, picture) {
        files::write_atomic(file, picture.as_bytes()).map_err(Failure::file)?;
    }
    if let Some(file) = &args.save_config {
        files::write_atomic(file, replay.config().as_bytes()).map_err(Failure::file)?;
        say(&format!("the same by itself: {}", replay.command(file)));
    }
    if !args.quiet {
        print(&text)?;
    }
    match replay.reported_hash() {
        Some(reported) if reported == hash => {
            say("replayed: the hash is that of the report");
            Ok(Exit::Pass)
        }
        Some(reported) => {
            let why = if same_inputs {
                "with the same inputs: another build, or stopline is not deterministic"
            } else {
                "and the inputs are others: program version, scenario, vehicle or seed have changed"
            };
            say(&format!("replayed: the hash is {hash}, in the report {reported}, {why}"));
            Ok(Exit::CheckFailed)
        }
        None => Ok(if held { Exit::Pass } else { Exit::CheckFailed }),
    }
}

fn replay_failure(error: ReplayError) -> Failure {
    match error {
        ReplayError::Unknown { .. } => Failure::Use(error.to_string()),
        ReplayError::Drive(crate::regression::DriveError { kind: ErrorKind::Fault, message }) => {
            Failure::Fault(message)
        }
        other => Failure::file(other),
    }
}
