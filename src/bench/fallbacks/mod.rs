//! Whether proven stops hold: fallback branches over random scenes, all built-in vehicles and several road surfaces.
//!
//! Each scene ([`scenes`]) is driven in closed loop. At every sampled cycle whose plan claims to be proven, the simulation is
//! branched and the committed plan is executed to standstill without planning again; the verdict assesses the branch
//! ([`crate::verdict::FallbackJudge`]). A branch that touches something, leaves the road or stops beyond its planned stop is
//! a *broken proof*: the gravest fault there is. One that brakes harder than the plan said is counted beside it.
//!
//! Results depend on the seed and the settings alone, not on threads. Weak where the scenes are (see there).

pub mod scenes;

use std::collections::BTreeMap;

use rayon::prelude::*;

pub use self::scenes::{Kind, Scene};
use super::Check;
use crate::drive::{self, DriveError, Faults, Settings};
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
    /// Scenes for each pair of vehicle and surface.
    pub scenes: u64,
    /// Number of the first scene.
    pub first: u64,
    /// Time between two branches of an unchanged plan, s.
    pub interval: f64,
    /// Faults unknown to the planner.
    pub faults: Faults,
}

/// How a branch broke its proof.
pub type FailureCode = &'static str;

/// The branches of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneResult {
    /// Vehicle.
    pub vehicle: String,
    /// Surface.
    pub surface: &'static str,
    /// Kind of scene.
    pub kind: Kind,
    /// Number of the scene.
    pub number: u64,
    /// Outcome of the run, or the error that kept it from running.
    pub outcome: String,
    /// Planning cycles.
    pub cycles: usize,
    /// Those that claim a proven stop.
    pub proven: usize,
    /// Branches executed.
    pub branches: usize,
    /// Broken ones by code.
    pub broken: BTreeMap<FailureCode, usize>,
    /// The gravest broken branch in a sentence.
    pub worst: Option<String>,
    /// Whether every cycle was proven and the run still touched something.
    pub is_proven_contact: bool,
}

/// The result of the bench.
#[derive(Debug, Clone, PartialEq)]
pub struct FallbackBench {
    /// One for each scene, by vehicle, surface and number.
    pub scenes: Vec<SceneResult>,
}

/// Codes that break a proof; `braking` is reported beside them.
pub const GRAVE: [FailureCode; 5] = ["contact", "road", "stop", "standstill", "numbers"];

impl FallbackBench {
    /// Branches over all scenes.
    #[must_use]
    pub fn branches(&self) -> usize {
        self.scenes.iter().map(|s| s.branches).sum()
    }

    /// Branches that broke their proof with one of these codes.
    #[must_use]
    pub fn broken(&self, codes: &[FailureCode]) -> usize {
        self.scenes.iter().flat_map(|s| &s.broken).filter(|(code, _)| codes.contains(code)).map(|(_, n)| n).sum()
    }

    /// Scenes in which every cycle claimed a proven stop and the run touched something.
    #[must_use]
    pub fn proven_contacts(&self) -> usize {
        self.scenes.iter().filter(|s| s.is_proven_contact).count()
    }

    /// What has to hold: no broken proof, no contact of a run that was proven throughout.
    #[must_use]
    pub fn checks(&self) -> [Check; 2] {
        let none = |name, value: usize| Check {
            name,
            status: Status::of(value == 0),
            value: value as f64,
            limit: 0.0,
            unit: "count",
        };
        [none("broken_proofs", self.broken(&GRAVE)), none("proven_contacts", self.proven_contacts())]
    }
}

/// Runs the bench; `progress` receives the number of finished scenes.
///
/// # Errors
/// Faults or settings out of their range.
pub fn run(
    vehicles: &[Vehicle],
    settings: &Settings,
    options: &Options,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<FallbackBench, DriveError> {
    let mut settings = settings.clone();
    settings.faults = options.faults;
    settings.verdict.fallbacks.enabled = true;
    settings.verdict.fallbacks.interval = options.interval;
    settings.run.longest = LONGEST;
    settings.validate()?;
    let jobs: Vec<(&Vehicle, Surface, u64)> = vehicles
        .iter()
        .flat_map(|vehicle| SURFACES.map(|surface| (vehicle, surface)))
        .flat_map(|(v, s)| (options.first..options.first + options.scenes).map(move |n| (v, s, n)))
        .collect();
    let done = std::sync::atomic::AtomicUsize::new(0);
    let scenes = jobs
        .into_par_iter()
        .map(|(vehicle, surface, number)| {
            let result = run_scene(vehicle, surface, number, &settings, options);
            progress(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1);
            result
        })
        .collect();
    Ok(FallbackBench { scenes })
}

/// Longest run of a scene, s.
const LONGEST: f64 = 20.0;

fn run_scene(vehicle: &Vehicle, surface: Surface, number: u64, settings: &Settings, options: &Options) -> SceneResult {
    let Scene { kind, scenario } = Scene::new(options.seed, number, vehicle, surface.friction);
    let mut settings = settings.clone();
    settings.simulation.friction_scale = surface.friction;
    let mut result = SceneResult {
        vehicle: vehicle.name.clone(),
        surface: surface.name,
        kind,
        number,
        outcome: String::new(),
        cycles: 0,
        proven: 0,
        branches: 0,
        broken: BTreeMap::new(),
        worst: None,
        is_proven_contact: false,
    };
    let run = match drive::drive(&scenario, &scenario.problems[0], vehicle, &settings, &mut |_, _| ()) {
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
            *result.broken.entry(code).or_default() += 1;
        }
    }
    let gravest =
        run.fallbacks.iter().filter(|f| f.failure().is_some()).reduce(|a, b| if b.is_graver_than(a) { b } else { a });
    result.worst = gravest.map(|f| format!("cycle {} at {:.2} s: {}", f.cycle, f.time, f.event()));
    result.is_proven_contact = run.log.contact.is_some() && result.proven == result.cycles;
    result
}
