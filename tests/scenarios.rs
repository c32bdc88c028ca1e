//! The closed loop on published CommonRoad scenarios. The files are not part of the project; without them the test prints so and
//! passes.
//!
//! Prints the table of outcomes (`cargo test --release --test scenarios -- --nocapture`).

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use common::{driven, real_scenarios};
use stopline::drive::Outcome;
use stopline::io::commonroad::read_file;

/// Least number of scenarios in which the goal is reached: two less than on the developers' machine, whose last digits of sines may
/// differ from others.
const GOALS: usize = 65;
/// Largest number of runs with a contact, without those that start in one: one more than on that machine.
const CONTACTS: usize = 3;
/// Largest number of runs with a fallback that does not hold: likewise.
const FALLBACKS: usize = 2;
/// Longest time for one scenario, s.
const LONGEST: f64 = 120.0;

/// How one scenario ended.
struct Row {
    file: String,
    outcome: Outcome,
    reason: Option<&'static str>,
    failed: Vec<&'static str>,
    driven: f64,
    cycles: usize,
    took: f64,
}

fn row(file: &Path) -> Row {
    let began = Instant::now();
    let scenario = read_file(file).unwrap_or_else(|e| panic!("{e}"));
    let run = driven(&scenario);
    Row {
        file: file.file_stem().unwrap().to_string_lossy().into_owned(),
        outcome: run.outcome,
        reason: run.reason,
        failed: run.verdict.failures().map(|c| c.name).collect(),
        driven: run.log.samples.last().map_or(0.0, |last| last.time - run.log.samples[0].time),
        cycles: run.cycles.len(),
        took: began.elapsed().as_secs_f64(),
    }
}

/// The scenario files, in order of their names.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    let mut files: Vec<_> = entries.filter(|p| p.extension().is_some_and(|e| e == "xml")).collect();
    files.sort();
    files
}

/// Drives all files, in order of their names. A panic is caught and reported with the name of the file.
///
/// One thread per core, each with a separate pool: a worker of a shared pool would start a second scenario while it waits inside
/// the first one, which would distort the times.
fn all_rows(files: &[PathBuf]) -> Vec<Result<Row, &PathBuf>> {
    let next = AtomicUsize::new(0);
    let work = || {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let mut done = Vec::new();
        while let Some(file) = files.get(next.fetch_add(1, Ordering::Relaxed)) {
            let row = pool.install(|| std::panic::catch_unwind(|| row(file)));
            done.push((file, row.map_err(|_| file)));
        }
        done
    };
    let mut done: Vec<_> = std::thread::scope(|scope| {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let workers: Vec<_> = (0..cores).map(|_| scope.spawn(work)).collect();
        workers.into_iter().flat_map(|w| w.join().unwrap()).collect()
    });
    done.sort_by_key(|(file, _)| *file);
    done.into_iter().map(|(_, row)| row).collect()
}

#[test]
fn every_published_scenario_ends_with_a_verdict() {
    let Some(folder) = real_scenarios() else { return };
    let files = files(&folder);
    let ended = all_rows(&files);
    let panicked: Vec<_> = ended.iter().filter_map(|e| e.as_ref().err()).collect();
    let rows: Vec<_> = ended.iter().filter_map(|e| e.as_ref().ok()).collect();
    for r in &rows {
        let Row { file, outcome, reason, failed, driven, cycles, took } = r;
        let reason = reason.unwrap_or_default();
        let failed = failed.join(" ");
        println!(
            "{file:<34} {:<15} {driven:>6.1} s {cycles:>5} cycles in {took:>6.2} s  {reason} {failed}",
            outcome.name()
        );
    }
    let mut outcomes: BTreeMap<&str, usize> = BTreeMap::new();
    let mut failures: BTreeMap<&str, usize> = BTreeMap::new();
    for r in &rows {
        *outcomes.entry(r.outcome.name()).or_default() += 1;
        r.failed.iter().for_each(|f| *failures.entry(f).or_default() += 1);
    }
    let passed = rows.iter().filter(|r| r.outcome == Outcome::GoalReached && r.failed.is_empty()).count();
    println!(
        "{} files: {outcomes:?}; goal reached and every check passed: {passed}; failed checks: {failures:?}",
        files.len()
    );
    assert!(panicked.is_empty(), "panicked on {panicked:?}");
    assert!(!files.is_empty(), "no scenario in {}", folder.display());
    for r in &rows {
        assert!(r.took < LONGEST, "{} took {:.0} s", r.file, r.took);
        let judged = r.cycles == 0 || r.driven > 0.0 || !r.failed.is_empty();
        assert!(judged, "{} was driven and not judged", r.file);
    }
    let goals = outcomes.get(Outcome::GoalReached.name()).copied().unwrap_or(0);
    assert!(goals >= GOALS, "{goals} goals reached");
    let contacts =
        rows.iter().filter(|r| r.outcome == Outcome::Collision && r.reason != Some("start_in_collision")).count();
    assert!(contacts <= CONTACTS, "{contacts} runs with a contact");
    let broken = failures.get("fallback_stops").copied().unwrap_or(0);
    assert!(broken <= FALLBACKS, "{broken} runs with a fallback that does not hold");
}
