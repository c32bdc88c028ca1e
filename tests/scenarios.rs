//! The closed loop on published CommonRoad scenarios. The files are not part of the project; without them the test prints so and
//! passes.
//!
//! Prints the table of outcomes (`cargo test --release --test scenarios -- --nocapture`); `stopline bench commonroad` prints the same
//! with the cycle times.

mod common;

use std::collections::BTreeMap;
use std::path::PathBuf;

use common::{VEHICLE, real_scenarios};
use stopline::bench::commonroad::{Options, Problem, run};
use stopline::drive::{Outcome, Settings};

/// Least number of scenarios in which the goal is reached: two less than on the developers' machine, whose last digits of sines may
/// differ from others.
const GOALS: usize = 65;
/// Largest number of runs with a contact, without those that start in one: one more than on that machine.
const CONTACTS: usize = 3;
/// Largest number of runs with a fallback that does not hold: likewise.
const FALLBACKS: usize = 2;

#[test]
fn every_published_scenario_ends_with_a_verdict() {
    let Some(folder) = real_scenarios() else { return };
    let entries = std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path());
    let mut files: Vec<PathBuf> = entries.filter(|p| p.extension().is_some_and(|e| e == "xml")).collect();
    files.sort();
    assert!(!files.is_empty(), "no scenario in {}", folder.display());
    let score = run(&files, &VEHICLE, &Settings::default(), &Options::default(), &|_| {}).unwrap();
    let mut outcomes: BTreeMap<&str, usize> = BTreeMap::new();
    let mut failures: BTreeMap<&str, usize> = BTreeMap::new();
    for p in &score.problems {
        let (file, outcome) = (p.file.file_stem().unwrap().to_string_lossy(), p.outcome.name());
        let (cycles, reason) = (p.cycles.len(), p.reason.unwrap_or_default());
        println!("{file:<34} {outcome:<15} {:>6.1} s {cycles:>5} cycles  {reason} {}", p.driven, p.failed.join(" "));
        *outcomes.entry(outcome).or_default() += 1;
        p.failed.iter().for_each(|f| *failures.entry(f).or_default() += 1);
        assert!(cycles == 0 || p.driven > 0.0 || !p.failed.is_empty(), "{file} was driven and not judged");
    }
    let perfect = score.count(Problem::is_perfect);
    println!("{} files: {outcomes:?}; goal and every check: {perfect}; failed checks: {failures:?}", files.len());
    assert!(score.unread.is_empty(), "{:?}", score.unread);
    let goals = outcomes.get(Outcome::GoalReached.name()).copied().unwrap_or(0);
    assert!(goals >= GOALS, "{goals} goals reached");
    let contacts = score.count(Problem::is_contact);
    assert!(contacts <= CONTACTS, "{contacts} runs with a contact");
    assert_eq!(score.count(Problem::is_proven_contact), 0, "a run that was proven throughout touched something");
    let broken = failures.get("fallback_stops").copied().unwrap_or(0);
    assert!(broken <= FALLBACKS, "{broken} runs with a fallback that does not hold");
}
