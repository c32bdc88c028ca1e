//! `stopline bench commonroad`: the files of a folder, the table, the JSON and the CSV of the score.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use crate::bench::commonroad::{Options, Problem, Score, run as measure};
use crate::cli::args::CommonRoadArgs;
use crate::cli::job::{Outputs, settings, wrong_vehicle};
use crate::cli::{Exit, Failure, json as result, print, progress, report};
use crate::drive::Settings;
use crate::io::files;
use crate::vehicle;

/// Finds the files, checks the outputs, measures, writes, reports.
pub(super) fn run(args: CommonRoadArgs) -> Result<Exit, Failure> {
    let outputs = Outputs { json: args.json, csv: args.csv, ..Outputs::default() };
    let inputs: Vec<PathBuf> = args.list.iter().chain(&args.config).cloned().collect();
    outputs.check(&inputs)?;
    let settings = args.config.as_deref().map_or(Ok(Settings::default()), settings)?;
    let vehicle = vehicle::load(&args.vehicle).map_err(|e| wrong_vehicle(&args.vehicle, &e))?;
    let found = scenarios(&args.folder)?;
    let (files, missing) = match &args.list {
        Some(list) => listed(list, &args.folder, found)?,
        None => (found, Vec::new()),
    };
    let options = Options { jobs: args.jobs.map(usize::from), without_recorded_ego: args.without_recorded_ego };
    let bar = progress::bar(!args.quiet);
    bar.set_length(files.len() as u64);
    bar.set_message(format!("of {} files", files.len()));
    let measured = measure(&files, &vehicle, &settings, &options, &|done| bar.set_position(done as u64));
    bar.finish_and_clear();
    let score = measured.map_err(|e| Failure::Fault(format!("no threads: {e}")))?;
    let value = to_json(&score, &missing, settings.run.replan_interval);
    if let Some(path) = outputs.json.as_ref().filter(|_| !outputs.json_on_stdout()) {
        files::write_atomic(path, result::text(&value).as_bytes()).map_err(Failure::file)?;
    }
    if let Some(path) = &outputs.csv {
        files::write_atomic(path, to_csv(&score).as_bytes()).map_err(Failure::file)?;
    }
    if outputs.json_on_stdout() {
        print(&result::text(&value))?;
    } else if !args.quiet {
        print(&text(&score, &missing, &value))?;
    }
    for unread in &score.unread {
        crate::cli::say(&format!("error: {}", unread.message));
    }
    Ok(match () {
        () if !score.unread.is_empty() || !missing.is_empty() => Exit::BadFile,
        () if score.count(Problem::is_proven_contact) > 0 => Exit::CheckFailed,
        () => Exit::Pass,
    })
}

/// The scenarios of a folder and its subfolders, in the order of their paths.
fn scenarios(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let wrong = |what: &dyn std::fmt::Display| {
        Failure::File(format!("{}: {what}; expected a folder of CommonRoad scenarios (*.xml)", folder.display()))
    };
    let mut found = Vec::new();
    for entry in walkdir::WalkDir::new(folder).follow_links(true).sort_by_file_name() {
        let entry = entry.map_err(|e| wrong(&e))?;
        if entry.file_type().is_file() && entry.path().extension().is_some_and(|e| e.eq_ignore_ascii_case("xml")) {
            found.push(entry.into_path());
        }
    }
    if found.is_empty() { Err(wrong(&"has no scenario")) } else { Ok(found) }
}

/// The files with a name in a list, in its order, and the names without a file.
fn listed(list: &Path, folder: &Path, found: Vec<PathBuf>) -> Result<(Vec<PathBuf>, Vec<String>), Failure> {
    let text = std::fs::read_to_string(list);
    let text = text.map_err(|e| Failure::File(format!("--list {}: cannot be read: {e}", list.display())))?;
    let names = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let names: Vec<&str> = names.map(|name| name.strip_suffix(".xml").unwrap_or(name)).collect();
    if names.is_empty() {
        let expected = "expected names of scenarios, one in each line";
        return Err(Failure::File(format!("--list {}: has no name; {expected}", list.display())));
    }
    let of = |name: &&str| found.iter().find(|file| file.file_stem().is_some_and(|stem| stem == *name));
    let files: Vec<PathBuf> = names.iter().filter_map(|name| of(name).cloned()).collect();
    if files.is_empty() {
        let message = format!("none of its {} scenarios is in {}", names.len(), folder.display());
        return Err(Failure::File(format!("--list {}: {message}", list.display())));
    }
    Ok((files, names.iter().filter(|name| of(name).is_none()).map(|name| (*name).to_owned()).collect()))
}

/// The sums of the score with their keys in JSON and their names.
fn sums(score: &Score) -> [(&'static str, &'static str, usize); 8] {
    let cycles = score.slow_cycles(0.0).1;
    let unproven = score.problems.iter().flat_map(|p| &p.cycles).filter(|c| !c.is_proven).count();
    [
        ("problems", "planning problems", score.problems.len()),
        ("reached", "goal reached, no contact, on the road", score.count(Problem::is_reached)),
        ("perfect", "and every check passed", score.count(Problem::is_perfect)),
        ("contacts", "contacts of runs that do not begin in one", score.count(Problem::is_contact)),
        ("proven_contacts", "of these with a proof in every cycle", score.count(Problem::is_proven_contact)),
        ("start_in_collision", "runs that begin in a contact", score.count(|p| p.reason == Some("start_in_collision"))),
        ("cycles", "planning cycles", cycles),
        ("unproven_cycles", "planning cycles without a proof", unproven),
    ]
}

/// The times of the planning cycles with their keys in JSON and their names, ms.
fn times(score: &Score) -> [(&'static str, &'static str, f64); 4] {
    let ms = |seconds: f64| 1e3 * seconds;
    [
        ("median_ms", "median of all cycles", ms(score.cycle_time(0.5))),
        ("p99_ms", "99th percentile of all cycles", ms(score.cycle_time(0.99))),
        ("slowest_ms", "slowest cycle", ms(score.cycle_time(1.0))),
        ("slowest_first_ms", "slowest first cycle of a run", ms(score.slowest_first_cycle())),
    ]
}

fn name(problem: &Problem) -> String {
    problem.file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn text(score: &Score, missing: &[String], value: &Value) -> String {
    let head = ["scenario", "problem", "outcome", "s", "cycles", "unproven", "median ms", "slowest ms", "failed"];
    let row = |p: &Problem| {
        let unproven = p.cycles.iter().filter(|c| !c.is_proven).count();
        let outcome = p.reason.map_or(p.outcome.name().to_owned(), |why| format!("{} ({why})", p.outcome.name()));
        vec![
            name(p),
            p.problem.to_string(),
            outcome,
            format!("{:.1}", p.driven),
            p.cycles.len().to_string(),
            unproven.to_string(),
            format!("{:.2}", 1e3 * p.cycle_time(0.5)),
            format!("{:.2}", 1e3 * p.cycle_time(1.0)),
            p.failed.join(" "),
        ]
    };
    let head = head.map(str::to_owned).to_vec();
    let mut text = report::table(&std::iter::once(head).chain(score.problems.iter().map(row)).collect::<Vec<_>>());
    text.push('\n');
    let counts = sums(score).map(|(_, name, n)| vec![name.to_owned(), n.to_string()]);
    let times = times(score).map(|(_, name, ms)| vec![format!("{name}, ms"), format!("{ms:.2}")]);
    text.push_str(&report::table(&counts.into_iter().chain(times).collect::<Vec<_>>()));
    if !missing.is_empty() {
        let _ = writeln!(text, "not in the folder: {}", missing.join(", "));
    }
    let _ = writeln!(text, "hash: {}", value["hash"].as_str().unwrap_or_default());
    text
}

/// The score. Its hash excludes the times.
fn to_json(score: &Score, missing: &[String], interval: f64) -> Value {
    let problem = |p: &Problem| {
        json!({
            "scenario": name(p),
            "problem": p.problem,
            "outcome": p.outcome.name(),
            "reason": p.reason,
            "reached": p.is_reached(),
            "failed": p.failed,
            "driven_s": p.driven,
            "cycles": p.cycles.len(),
            "unproven_cycles": p.cycles.iter().filter(|c| !c.is_proven).count(),
            "hash": p.hash,
        })
    };
    let unread: Vec<Value> = score.unread.iter().map(|u| json!({ "file": u.file, "message": u.message })).collect();
    let mut value = Map::new();
    value.insert("format".into(), json!("stopline.bench.commonroad/1"));
    value.extend(sums(score).map(|(key, _, n)| (key.to_owned(), json!(n))));
    value.insert("missing".into(), json!(missing));
    value.insert("unread".into(), Value::Array(unread));
    value.insert("runs".into(), score.problems.iter().map(problem).collect());
    let hash = result::hash(&Value::Object(value.clone()), &[]);
    let mut time: Map<String, Value> =
        times(score).map(|(key, _, ms)| (key.to_owned(), json!(ms))).into_iter().collect();
    time.insert("cycles_beyond_interval".into(), json!(score.slow_cycles(interval).0));
    value.insert("time".into(), Value::Object(time));
    value.insert("hash".into(), json!(hash));
    Value::Object(value)
}

/// One row for each planning problem.
fn to_csv(score: &Score) -> String {
    let mut text = String::from(
        "scenario,problem,outcome,reason,reached,failed,driven_s,cycles,unproven_cycles,median_ms,p99_ms,slowest_ms,first_ms\n",
    );
    for p in &score.problems {
        let ms = |seconds: f64| format!("{:.3}", 1e3 * seconds);
        let row = [
            name(p).replace(',', ";"),
            p.problem.to_string(),
            p.outcome.name().to_owned(),
            p.reason.unwrap_or_default().to_owned(),
            p.is_reached().to_string(),
            p.failed.join(" "),
            format!("{:.2}", p.driven),
            p.cycles.len().to_string(),
            p.cycles.iter().filter(|c| !c.is_proven).count().to_string(),
            ms(p.cycle_time(0.5)),
            ms(p.cycle_time(0.99)),
            ms(p.cycle_time(1.0)),
            ms(p.cycles.first().map_or(0.0, |c| c.seconds)),
        ];
        let _ = writeln!(text, "{}", row.join(","));
    }
    text
}
