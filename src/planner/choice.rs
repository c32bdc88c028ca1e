//! The joint choice of path and speed: the cheapest pair with a proven stop.
//!
//! The cost of a path without its speed is a lower bound of the cost of the pair. Candidates are evaluated in the order of
//! this bound, and a path whose bound is not below the best cost needs no speed search. Speed searches run in parallel, as
//! many as there are threads. Results that an earlier result makes unnecessary are dropped and not counted. So the record is
//! that of a sequential evaluation, to the byte, for every number of threads.

use std::sync::OnceLock;

use rayon::prelude::*;

use super::candidate::{Course, Evaluation, Proven, delay};
use super::level::LevelLimits;
use super::record::{Candidate, Cause, Rejection};
use super::tube::{OutOfTube, Tube};
use super::{CycleRecord, Planner, Start};
use crate::collision::SafetyMargins;
use crate::lattice::{LatticePath, rank};

/// A lattice path with what does not depend on the level.
pub(super) struct Prepared {
    pub(super) path: LatticePath,
    course: OnceLock<Course>,
}

impl Prepared {
    pub(super) fn new(path: LatticePath) -> Self {
        Self { path, course: OnceLock::new() }
    }

    /// Drops what depends on the obstacles and their resolution.
    pub(super) fn renew(&mut self) {
        self.course = OnceLock::new();
    }
}

/// A path with its speed, ready to be committed.
pub(super) struct Choice {
    pub(super) lane: usize,
    pub(super) candidate: usize,
    pub(super) path: LatticePath,
    pub(super) proven: Box<Proven>,
    pub(super) tube: Tube,
    pub(super) cost: f64,
    pub(super) is_refined: bool,
}

impl Planner<'_> {
    /// Evaluates the paths of a lane, which are in the order of their cost, and updates the best pair.
    pub(super) fn evaluate_all(
        &self,
        start: &Start,
        lane: usize,
        level: LevelLimits,
        paths: &[Prepared],
        best: &mut Option<Choice>,
        record: &mut CycleRecord,
    ) {
        let Some(on) = self.lanes.as_ref().ok().and_then(|l| l.get(lane)) else { return };
        let situation = self.situation(start, on, level);
        let free = situation.free_progress();
        for group in paths.chunks(rayon::current_num_threads()) {
            let limit = best.as_ref().map(|b| rank(b.cost));
            let evaluate =
                |p: &Prepared| is_worth_it(&p.path, limit).then(|| situation.evaluate_on(&p.path, &p.course));
            let evaluations: Vec<_> = match group {
                [one] => vec![evaluate(one)],
                several => several.par_iter().map(evaluate).collect(),
            };
            for (Prepared { path, .. }, evaluation) in group.iter().zip(evaluations) {
                let evaluation = evaluation.filter(|_| is_worth_it(path, best.as_ref().map(|b| rank(b.cost))));
                let mut note = Candidate {
                    path: path.path.clone(),
                    lane,
                    attempt: record.attempt,
                    cost: path.terms.total(),
                    terms: path.terms,
                    blocked_by: path.blocked_by.map(Cause::from),
                    rejected: None,
                };
                note.rejected = match evaluation {
                    None => Some(Rejection::HigherCost),
                    Some(Evaluation::Rejected { why, expansions, blocked_by }) => {
                        record.trace.expansions += expansions;
                        note.blocked_by = blocked_by.or(note.blocked_by);
                        Some(why)
                    }
                    Some(Evaluation::Proven(proven)) => {
                        record.trace.expansions += proven.expansions;
                        let mut path = path.clone();
                        self.charge_missed_goal(start, &mut path, &proven.raw_profile);
                        note.terms = path.terms;
                        note.terms.travel_time = delay(&self.settings, free - proven.progress, &note.terms);
                        note.cost = note.terms.total();
                        let candidate = record.trace.candidates.len();
                        let (tube, cost) = (Tube::UNKNOWN, note.cost);
                        let pair = Choice { lane, candidate, path, proven, tube, cost, is_refined: false };
                        match self.accepted(start, &level, best.as_ref(), pair) {
                            Ok(pair) => take(best, pair, record),
                            Err(Refused { why: Rejection::TubeBlocked, again: Some((pair, margins)) }) => {
                                let wide = LevelLimits { margins, ..level };
                                let pair = self.evaluated_again(start, &wide, &pair, record);
                                let pair = pair.and_then(|pair| self.accepted(start, &wide, best.as_ref(), pair).ok());
                                pair.map_or(Some(Rejection::TubeBlocked), |pair| {
                                    note.terms.travel_time += pair.cost - note.cost;
                                    note.cost = pair.cost;
                                    take(best, pair, record)
                                })
                            }
                            Err(refused) => Some(refused.why),
                        }
                    }
                };
                record.trace.candidates.push(note);
            }
        }
    }

    /// The pair with its tube, if it costs less than the best one, passes reverification and its tube is free.
    pub(super) fn accepted(
        &self,
        start: &Start,
        level: &LevelLimits,
        best: Option<&Choice>,
        pair: Choice,
    ) -> Result<Choice, Refused> {
        if best.is_some_and(|b| rank(b.cost) <= rank(pair.cost)) {
            return Err(Rejection::HigherCost.into());
        }
        if pair.proven.reverify().is_err() {
            return Err(Rejection::ReverificationFailed.into());
        }
        match self.tube_of(start, level, &pair.path, &pair.proven.raw_profile) {
            Ok(tube) => Ok(Choice { tube, ..pair }),
            Err(OutOfTube::NotDrivable) => Err(Rejection::NotDrivable.into()),
            Err(OutOfTube::Blocked(margins)) => {
                Err(Refused { why: Rejection::TubeBlocked, again: Some((Box::new(pair), margins)) })
            }
        }
    }

    /// The pair with another speed profile, which keeps the margins of a level to all obstacles; `None` without one.
    pub(super) fn evaluated_again(
        &self,
        start: &Start,
        level: &LevelLimits,
        pair: &Choice,
        record: &mut CycleRecord,
    ) -> Option<Choice> {
        let path = self.shortened(start, &level.margins, pair.path.clone());
        let situation = self.situation(start, self.lanes.as_ref().ok()?.get(pair.lane)?, *level);
        let Evaluation::Proven(proven) = situation.evaluate(&path) else { return None };
        record.trace.expansions += proven.expansions;
        let delay_of =
            |proven: &Proven| delay(&self.settings, situation.free_progress() - proven.progress, &path.terms);
        let cost = pair.cost + delay_of(&proven) - delay_of(&pair.proven);
        let Choice { lane, candidate, tube, is_refined, .. } = *pair;
        Some(Choice { lane, candidate, path, proven, tube, cost, is_refined })
    }
}

/// A pair that is not taken. One whose tube is blocked can be tried again with the margins that it needs.
pub(super) struct Refused {
    why: Rejection,
    again: Option<(Box<Choice>, SafetyMargins)>,
}

impl From<Rejection> for Refused {
    fn from(why: Rejection) -> Self {
        Self { why, again: None }
    }
}

/// Makes the pair the best one.
fn take(best: &mut Option<Choice>, pair: Choice, record: &mut CycleRecord) -> Option<Rejection> {
    if let Some(previous) = best.replace(pair) {
        record.reject(previous.candidate, Rejection::HigherCost);
    }
    None
}

/// Whether a pair with this path can have a rank below `limit`.
fn is_worth_it(path: &LatticePath, limit: Option<i64>) -> bool {
    limit.is_none_or(|limit| rank(path.terms.total()) < limit)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::candidate::fault::ENDS_MOVING;
    use super::super::record::Trace;
    use super::super::{Cycle, Decision, Observation, Settings};
    use super::*;
    use crate::vehicle::State;

    /// The first cycle on one of the maps of the project, with the given number of threads.
    fn first_cycle(map: &str, threads: usize, faulty: bool) -> Cycle {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("maps").join(map);
        let scenario = crate::io::commonroad::read_file(&file).unwrap();
        let vehicle = crate::vehicle::load("bmw_320i").unwrap();
        let problem = &scenario.problems[0];
        let settings = Settings::default();
        let state = State {
            time: 0.0,
            pose: vehicle.rear_axle_of_centre(&problem.initial.centre),
            speed: problem.initial.speed,
            lateral_speed: 0.0,
            acceleration: 0.0,
            yaw_rate: 0.0,
            steering: 0.0,
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            ENDS_MOVING.set(faulty);
            let observation = Observation::of_scenario(&scenario, problem, state);
            Planner::new(scenario.map(), &vehicle, &settings).unwrap().traced_cycle(&observation).unwrap()
        })
    }

    #[test]
    fn a_raw_profile_that_fails_reverification_is_never_committed() {
        let sound = first_cycle("straight_100m.xml", 1, false);
        assert_eq!(sound.plan.decision, Decision::NewPlan);
        assert_eq!(sound.trace.rejections(Rejection::ReverificationFailed), 0);
        let faulty = first_cycle("straight_100m.xml", 1, true);
        assert_eq!(faulty.plan.decision, Decision::Unproven);
        assert!(faulty.trace.rejections(Rejection::ReverificationFailed) > 0 && faulty.trace.chosen.is_none());
    }

    #[test]
    fn the_record_does_not_depend_on_the_number_of_threads() {
        for map in ["slalom.xml", "pedestrian.xml"] {
            let one = first_cycle(map, 1, false);
            for threads in [2, 3, 7] {
                let several = first_cycle(map, threads, false);
                let trace = Trace { stage_seconds: one.trace.stage_seconds, ..several.trace };
                let untimed = Cycle { trace, ..several };
                assert!(untimed == one, "{map} on {threads} threads");
            }
        }
    }
}
