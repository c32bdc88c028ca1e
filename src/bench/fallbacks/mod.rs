//! Whether proven stops hold: fallback branches over random scenes and maps, all built-in vehicles and several road surfaces.
//!
//! Each random scene ([`scenes`]) and each planning problem of a map is driven in closed loop, on each surface; the planner
//! believes the friction that the road has. At every sampled cycle whose plan claims to be proven, the simulation is
//! branched and the committed plan is executed to standstill without planning again; the verdict assesses the branch
//! ([`crate::verdict::FallbackJudge`]). A branch that touches something, leaves the road by more than [`OFF_ROAD`], stops more than [`BEYOND`] beyond its
//! planned stop, or does not stop, is a *broken proof*: the gravest fault there is. One that stops more than [`SHORT`]
//! before its planned stop, or brakes harder than the plan said, is counted beside it: it is not what was planned, but no danger.
//! A branch is counted once, for its gravest fault.
//!
//! Results depend on the seed, the maps and the settings alone, not on threads. Weak where the scenes are (see there). Cycles
//! without a proof claim nothing and have no branch: a planner that proves nothing breaks nothing. [`SceneResult`] counts
//! both, and without a single branch no check applies.

pub mod scenes;

use std::collections::BTreeMap;

use rayon::prelude::*;

pub use self::scenes::{Kind, Scene};
use super::Check;
use crate::drive::{self, DriveError, Faults, Settings};
use crate::map::{PlanningProblem, Scenario};
use crate::planner::Decision;
use crate::vehicle::Vehicle;
use crate::verdict::Status;

/// A road surface of the bench.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Name used in reports.
    pub name: &'static str,
    /// Factor on the tyres' friction on dry asphalt.
    pub friction: f64,
}

/// The surfaces, as `--friction` names them.
pub const SURFACES: [Surface; 3] = [
    Surface { name: "dry", friction: 1.0 },
    Surface { name: "wet", friction: 0.6 },
    Surface { name: "ice", friction: 0.15 },
];

/// What to run.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Seed of the scenes.
    pub seed: u64,
    /// Random scenes for each pair of vehicle and surface.
    pub scenes: u64,
    /// Number of the first random scene.
    pub first: u64,
    /// Time between two branches of an unchanged plan, s.
    pub interval: f64,
    /// Faults unknown to the planner.
    pub faults: Faults,
}

/// How a branch failed ([`Fallback::failure`](crate::verdict::Fallback::failure)).
pub type FailureCode = &'static str;

/// A map of the bench.
#[derive(Debug, Clone)]
pub struct Map {
    /// Name used in reports.
    pub name: String,
    /// The map, with its planning problems.
    pub scenario: Scenario,
}

/// Where a scene comes from.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Source {
    /// Made from the seed.
    Random(Kind),
    /// A planning problem of the map with this name.
    Map(String),
}

impl Source {
    /// The stable name used in reports: of the kind, or of the map.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Random(kind) => kind.name(),
            Self::Map(name) => name,
        }
    }
}

/// The branches of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneResult {
    /// Vehicle.
    pub vehicle: String,
    /// Surface.
    pub surface: &'static str,
    /// Kind of scene, or map.
    pub source: Source,
    /// Number of the random scene, or the map's planning problem.
    pub number: i64,
    /// Outcome of the run, or the error that kept it from running.
    pub outcome: String,
    /// Planning cycles.
    pub cycles: usize,
    /// Those that claim a proven stop.
    pub proven: usize,
    /// Branches executed.
    pub branches: usize,
    /// Those that failed, by code: [`GRAVE`] ones broke their proof, [`LESSER`] ones did not.
    pub failed: BTreeMap<FailureCode, usize>,
    /// The gravest failed branch in a sentence.
    pub worst: Option<String>,
    /// Farthest stop from the planned one over all branches, m, positive beyond it; `None` if none stopped.
    pub farthest_stop: Option<f64>,
    /// Whether every cycle was proven and the run still touched something.
    pub is_proven_contact: bool,
}

impl SceneResult {
    /// Branches that failed with one of these codes.
    #[must_use]
    pub fn failed(&self, codes: &[FailureCode]) -> usize {
        self.failed.iter().filter(|(code, _)| codes.contains(code)).map(|(_, n)| n).sum()
    }
}

/// The result of the bench.
#[derive(Debug, Clone, PartialEq)]
pub struct FallbackBench {
    /// One for each scene, by vehicle, surface and number; the maps are after the random scenes.
    pub scenes: Vec<SceneResult>,
}

/// Codes that break a proof.
pub const GRAVE: [FailureCode; 5] = ["contact", "road", "beyond", "standstill", "numbers"];
/// Codes that are counted beside them: a stop short of the planned one, harder braking than planned, a plan that begins
/// elsewhere than the vehicle is.
pub const LESSER: [FailureCode; 3] = ["short", "braking", "start"];

/// Excursion from the road that breaks a proof, m. As in the verdict: published lanelets have gaps of centimetres.
pub const OFF_ROAD: f64 = 0.05;
/// Distance beyond the planned stop that breaks a proof, m. The verdict of a run is stricter (0.1 m).
pub const BEYOND: f64 = 0.3;
/// Distance before the planned stop that is counted as short, m.
pub const SHORT: f64 = 0.3;

impl FallbackBench {
    /// Branches over all scenes.
    #[must_use]
    pub fn branches(&self) -> usize {
        self.scenes.iter().map(|s| s.branches).sum()
    }

    /// Branches that failed with one of these codes.
    #[must_use]
    pub fn failed(&self, codes: &[FailureCode]) -> usize {
        self.scenes.iter().map(|s| s.failed(codes)).sum()
    }

    /// Scenes in which every cycle claimed a proven stop and the run touched something.
    #[must_use]
    pub fn proven_contacts(&self) -> usize {
        self.scenes.iter().filter(|s| s.is_proven_contact).count()
    }

    /// What has to hold: no broken proof, no contact of a run that was proven throughout. Without a branch nothing was tested,
    /// and neither applies.
    #[must_use]
    pub fn checks(&self) -> [Check; 2] {
        let is_tested = self.branches() > 0;
        let none = |name, value: usize| Check {
            name,
            status: if is_tested { Status::of(value == 0) } else { Status::NotApplicable },
            value: if is_tested { value as f64 } else { f64::NAN },
            limit: 0.0,
            unit: "count",
        };
        [none("broken_proofs", self.failed(&GRAVE)), none("proven_contacts", self.proven_contacts())]
    }
}

/// Runs the bench; `progress` receives the number of finished scenes.
///
/// # Errors
/// Faults or settings out of their range.
pub fn run(
    vehicles: &[Vehicle],
    maps: &[Map],
    settings: &Settings,
    options: &Options,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<FallbackBench, DriveError> {
    let mut settings = settings.clone();
    settings.faults = options.faults;
    settings.verdict.fallbacks.enabled = true;
    settings.verdict.fallbacks.interval = options.interval;
    settings.verdict.road_tolerance = OFF_ROAD;
    settings.verdict.stop_past = BEYOND;
    settings.verdict.stop_short = SHORT;
    settings.run.longest = LONGEST;
    settings.validate()?;
    let numbers = options.first..options.first + options.scenes;
    let problems = maps.iter().flat_map(|map| map.scenario.problems.iter().map(move |p| Job::Map(map, p)));
    let scenes: Vec<Job<'_>> = numbers.map(Job::Random).chain(problems).collect();
    let jobs: Vec<(&Vehicle, Surface, Job<'_>)> = vehicles
        .iter()
        .flat_map(|vehicle| SURFACES.map(|surface| (vehicle, surface)))
        .flat_map(|(vehicle, surface)| scenes.iter().map(move |scene| (vehicle, surface, *scene)))
        .collect();
    let done = std::sync::atomic::AtomicUsize::new(0);
    let scenes = jobs
        .into_par_iter()
        .map(|(vehicle, surface, job)| {
            let result = job.run(vehicle, surface, &settings, options.seed);
            progress(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1);
            result
        })
        .collect();
    Ok(FallbackBench { scenes })
}

/// Longest run of a scene, s. Goals may end it earlier.
const LONGEST: f64 = 20.0;

/// A scene to run.
#[derive(Clone, Copy)]
enum Job<'a> {
    /// The random scene of this number.
    Random(u64),
    Map(&'a Map, &'a PlanningProblem),
}

impl Job<'_> {
    fn run(self, vehicle: &Vehicle, surface: Surface, settings: &Settings, seed: u64) -> SceneResult {
        match self {
            Self::Random(number) => {
                let Scene { kind, scenario } = Scene::new(seed, number, vehicle, surface.friction);
                #[allow(clippy::cast_possible_wrap)] // shown only
                let result = empty(vehicle, surface, Source::Random(kind), number as i64);
                run_scene(result, &scenario, &scenario.problems[0], (vehicle, surface), settings)
            }
            Self::Map(map, problem) => {
                let result = empty(vehicle, surface, Source::Map(map.name.clone()), problem.id);
                run_scene(result, &map.scenario, problem, (vehicle, surface), settings)
            }
        }
    }
}

fn empty(vehicle: &Vehicle, surface: Surface, source: Source, number: i64) -> SceneResult {
    SceneResult {
        vehicle: vehicle.name.clone(),
        surface: surface.name,
        source,
        number,
        outcome: String::new(),
        cycles: 0,
        proven: 0,
        branches: 0,
        failed: BTreeMap::new(),
        worst: None,
        farthest_stop: None,
        is_proven_contact: false,
    }
}

/// Drives a scene and fills in its result.
fn run_scene(
    mut result: SceneResult,
    scenario: &Scenario,
    problem: &PlanningProblem,
    (vehicle, surface): (&Vehicle, Surface),
    settings: &Settings,
) -> SceneResult {
    let mut settings = settings.clone();
    settings.simulation.friction_scale = surface.friction;
    let run = match drive::drive(scenario, problem, vehicle, &settings, &mut |_, _| ()) {
        Ok(run) => run,
        Err(error) => {
            result.outcome = error.to_string();
            return result;
        }
    };
    result.outcome = run.outcome.name().into();
    result.cycles = run.cycles.len();
    result.proven = run.cycles.iter().filter(|c| c.plan.decision != Decision::Unproven).count();
    result.branches = run.fallbacks.len();
    for fallback in &run.fallbacks {
        if let Some(code) = fallback.failure() {
            *result.failed.entry(code).or_default() += 1;
        }
    }
    let gravest =
        run.fallbacks.iter().filter(|f| f.failure().is_some()).reduce(|a, b| if b.is_graver_than(a) { b } else { a });
    result.worst = gravest.map(|f| format!("cycle {} at {:.2} s: {}", f.cycle, f.time, f.event()));
    result.farthest_stop = run.fallbacks.iter().filter_map(|f| f.stop_error).reduce(f64::max);
    result.is_proven_contact = run.log.contact.is_some() && result.proven == result.cycles;
    result
}
