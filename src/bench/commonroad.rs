//! The score on published scenarios: every planning problem of a set of CommonRoad files, driven in closed loop.
//!
//! A problem counts as reached if the run meets the official goal conditions of the file (position, heading, speed and time window
//! together), touched nothing and stayed on the road: what others call success. Besides, the score has what the verdict checks
//! (comfort, fallbacks, claims), the cycles without a proven plan, and the times of the planning cycles.
//!
//! Every file gets one thread (`workers`). All results but the times are the same for every number of jobs; times are those of
//! an otherwise idle machine only with one job.
//!
//! Weak: a file that others score with another vehicle, or with perfect tracking instead of physics, is an easier or a harder problem
//! there.

use std::path::{Path, PathBuf};

use super::quantile;
use crate::drive::{self, Outcome, Run, Settings};
use crate::io::commonroad;
use crate::map::{PlanningProblem, Scenario};
use crate::planner::Decision;
use crate::vehicle::Vehicle;
use crate::workers;

/// How to drive the files.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Files at a time; the number of cores if not given.
    pub jobs: Option<usize>,
    /// Whether the recorded ego is left out ([`Scenario::recorded_ego`]).
    pub without_recorded_ego: bool,
}

/// What became of a planning problem.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The file.
    pub file: PathBuf,
    /// Its planning problem.
    pub problem: i64,
    /// How the run ended.
    pub outcome: Outcome,
    /// The reason as a stable code, where the outcome alone does not give it.
    pub reason: Option<&'static str>,
    /// The failed checks.
    pub failed: Vec<&'static str>,
    /// Time driven, s.
    pub driven: f64,
    /// The planning cycles.
    pub cycles: Vec<Cycle>,
    /// Hash of the result.
    pub hash: String,
}

/// A planning cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cycle {
    /// Whether its plan has a proof.
    pub is_proven: bool,
    /// Wall-clock time, s.
    pub seconds: f64,
}

/// A file without a result, and the reason.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unread {
    /// The file.
    pub file: PathBuf,
    /// What is wrong with it.
    pub message: String,
}

/// The result.
#[derive(Debug, Clone, Default)]
pub struct Score {
    /// The planning problems, in the order of the files.
    pub problems: Vec<Problem>,
    /// The files that could not be read or driven.
    pub unread: Vec<Unread>,
}

impl Problem {
    fn new(file: &Path, run: &Run<'_>, settings: &Settings) -> Self {
        let cycle = |c: &crate::planner::Cycle| Cycle {
            is_proven: c.plan.decision != Decision::Unproven,
            seconds: c.trace.stage_seconds.total,
        };
        let result = crate::result::RunResult::new(crate::result::Kind::Drive, run, settings, settings.faults.seed);
        Self {
            file: file.to_owned(),
            problem: run.problem.id,
            outcome: run.outcome,
            reason: run.reason,
            failed: run.verdict.failures().map(|c| c.name).collect(),
            driven: run.log.samples.last().map_or(0.0, |last| last.time - run.log.samples[0].time),
            cycles: run.cycles.iter().map(cycle).collect(),
            hash: result.hash,
        }
    }

    /// Whether the run met the goal, touched nothing and stayed on the road.
    #[must_use]
    pub fn is_reached(&self) -> bool {
        let is_there = matches!(self.outcome, Outcome::GoalReached | Outcome::AlreadyAtGoal);
        is_there && !self.failed.iter().any(|check| ["no_contact", "stays_on_road"].contains(check))
    }

    /// Whether it did so with every check passed.
    #[must_use]
    pub fn is_perfect(&self) -> bool {
        self.is_reached() && self.failed.is_empty()
    }

    /// Whether the run touched something, but not at its start.
    #[must_use]
    pub fn is_contact(&self) -> bool {
        self.outcome == Outcome::Collision && self.reason != Some("start_in_collision")
    }

    /// Whether each cycle of a run that touched something claimed a proven stop.
    #[must_use]
    pub fn is_proven_contact(&self) -> bool {
        self.is_contact() && self.cycles.iter().all(|c| c.is_proven)
    }

    /// Quantile of the times of its cycles, s.
    #[must_use]
    pub fn cycle_time(&self, share: f64) -> f64 {
        quantile(&sorted(self.cycles.iter()), share)
    }
}

impl Score {
    /// The number of problems for which something holds.
    #[must_use]
    pub fn count(&self, holds: impl Fn(&Problem) -> bool) -> usize {
        self.problems.iter().filter(|p| holds(p)).count()
    }

    /// Quantile of the times of all cycles, s.
    #[must_use]
    pub fn cycle_time(&self, share: f64) -> f64 {
        quantile(&sorted(self.problems.iter().flat_map(|p| &p.cycles)), share)
    }

    /// The slowest first cycle of a run, s.
    #[must_use]
    pub fn slowest_first_cycle(&self) -> f64 {
        quantile(&sorted(self.problems.iter().filter_map(|p| p.cycles.first())), 1.0)
    }

    /// Cycles that took more than a time (s), and all cycles.
    #[must_use]
    pub fn slow_cycles(&self, seconds: f64) -> (usize, usize) {
        let cycles = || self.problems.iter().flat_map(|p| &p.cycles);
        (cycles().filter(|c| c.seconds > seconds).count(), cycles().count())
    }
}

fn sorted<'a>(cycles: impl Iterator<Item = &'a Cycle>) -> Vec<f64> {
    let mut seconds: Vec<f64> = cycles.map(|c| c.seconds).collect();
    seconds.sort_by(f64::total_cmp);
    seconds
}

/// Drives every planning problem of the files; `progress` receives the number of finished files.
///
/// # Errors
/// Threads that cannot be started. A file that cannot be read or driven is part of the score.
pub fn run(
    files: &[PathBuf],
    vehicle: &Vehicle,
    settings: &Settings,
    options: &Options,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<Score, std::io::Error> {
    let done = std::sync::atomic::AtomicUsize::new(0);
    let work = |file: &PathBuf| {
        let driven = drive_file(file, vehicle, settings, options);
        progress(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1);
        driven.map_err(|message| Unread { file: file.clone(), message })
    };
    let jobs = options.jobs.unwrap_or_else(workers::cores).min(files.len());
    let driven = workers::in_order(jobs, files, &|| false, work).map_err(std::io::Error::other)?;
    let mut score = Score::default();
    for file in driven {
        match file {
            Ok(problems) => score.problems.extend(problems),
            Err(unread) => score.unread.push(unread),
        }
    }
    Ok(score)
}

fn drive_file(file: &Path, vehicle: &Vehicle, settings: &Settings, options: &Options) -> Result<Vec<Problem>, String> {
    let scenario = commonroad::read_file(file).map_err(|e| e.to_string())?;
    let drive = |problem: &PlanningProblem| {
        let without_ego = options.without_recorded_ego.then(|| without_recorded_ego(&scenario, problem)).flatten();
        let scenario = without_ego.as_ref().unwrap_or(&scenario);
        let run = drive::drive(scenario, problem, vehicle, settings, &mut |_, _| ()).map_err(|e| e.to_string())?;
        Ok(Problem::new(file, &run, settings))
    };
    scenario.problems.iter().map(drive).collect()
}

/// The scenario without the recorded ego of a problem; `None` if it has none.
fn without_recorded_ego(scenario: &Scenario, problem: &PlanningProblem) -> Option<Scenario> {
    let ego = scenario.recorded_ego(problem)?.id;
    let mut left = scenario.clone();
    left.leave_out(ego);
    Some(left)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem(outcome: Outcome, failed: &[&'static str], proven: &[bool]) -> Problem {
        let cycle = |is_proven: &bool| Cycle { is_proven: *is_proven, seconds: 0.001 };
        Problem {
            file: "a.xml".into(),
            problem: 1,
            outcome,
            reason: None,
            failed: failed.to_vec(),
            driven: 1.0,
            cycles: proven.iter().map(cycle).collect(),
            hash: String::new(),
        }
    }

    #[test]
    fn a_goal_counts_without_contact_and_on_the_road_only() {
        use Outcome::{Collision, GoalReached, TimedOut};
        let reached = |outcome, failed: &[&'static str]| problem(outcome, failed, &[true]).is_reached();
        assert!(reached(GoalReached, &[]) && reached(GoalReached, &["comfort_jerk"]));
        assert!(!reached(GoalReached, &["no_contact"]) && !reached(GoalReached, &["stays_on_road"]));
        assert!(!reached(TimedOut, &[]) && !reached(Collision, &["no_contact"]));
        assert!(!problem(GoalReached, &["comfort_jerk"], &[true]).is_perfect());
    }

    #[test]
    fn a_contact_at_the_start_or_without_a_proof_is_no_broken_promise() {
        let touched = |proven: &[bool]| problem(Outcome::Collision, &["no_contact"], proven);
        assert!(touched(&[true, true]).is_proven_contact() && !touched(&[true, false]).is_proven_contact());
        let at_start = Problem { reason: Some("start_in_collision"), ..touched(&[true]) };
        assert!(!at_start.is_contact() && !at_start.is_proven_contact());
    }

    #[test]
    fn times_are_those_of_all_cycles() {
        let with = |times: &[f64]| {
            let cycles = times.iter().map(|t| Cycle { is_proven: true, seconds: *t }).collect();
            Problem { cycles, ..problem(Outcome::GoalReached, &[], &[]) }
        };
        let score = Score { problems: vec![with(&[0.5, 0.1]), with(&[0.2, 0.3, 0.4])], unread: Vec::new() };
        assert_eq!((score.cycle_time(0.5), score.cycle_time(1.0), score.slowest_first_cycle()), (0.3, 0.5, 0.5));
        assert_eq!(score.slow_cycles(0.3), (2, 5));
    }
}
