//! A job: what was typed, resolved and checked. Once it exists, only the program itself can fail.

use std::path::{Path, PathBuf};

use super::Failure;
use super::args::{FallbackInterval, RunArgs};
use super::engine::Settings;
use crate::io::{commonroad, files, ros_map, settings_file};
use crate::map::{PlanningProblem, Scenario};
pub(super) use crate::result::Kind;
use crate::simulation;
use crate::vehicle::{self, Vehicle};
use crate::verdict::ComfortPreset;

/// Everything needed to run, read and checked.
pub(super) struct Job {
    pub(super) kind: Kind,
    /// The scenario's file, for messages.
    pub(super) file: PathBuf,
    pub(super) scenario: Scenario,
    /// Index of the planning problem.
    problem: usize,
    pub(super) vehicle: Vehicle,
    pub(super) settings: Settings,
    pub(super) seed: u64,
    pub(super) threads: Option<u16>,
    pub(super) outputs: Outputs,
    pub(super) quiet: bool,
}

/// Where results go.
#[derive(Debug, Default)]
pub(super) struct Outputs {
    /// `-` is stdout.
    pub(super) json: Option<PathBuf>,
    /// Whether the JSON tells every planning cycle.
    pub(super) json_cycles: bool,
    pub(super) csv: Option<PathBuf>,
    pub(super) solution: Option<PathBuf>,
    pub(super) svg: Option<PathBuf>,
    pub(super) rrd: Option<PathBuf>,
}

impl Job {
    /// Reads the inputs and checks the outputs.
    pub(super) fn new(kind: Kind, args: RunArgs) -> Result<Self, Failure> {
        let mut inputs = vec![args.scenario.clone()];
        inputs.extend(args.config.iter().chain(&args.grid).cloned());
        let friction = args.friction.as_deref().map(Friction::of);
        inputs.extend(friction.iter().filter_map(Friction::file));
        inputs.extend(args.grid.as_deref().and_then(ros_map::image_of));
        inputs.extend(vehicle::files_of(&args.vehicle));
        let outputs = Outputs {
            json: args.json,
            json_cycles: args.json_cycles,
            csv: args.csv,
            solution: args.solution,
            svg: args.svg,
            rrd: args.rrd,
        };
        outputs.check(&inputs)?;
        let mut scenario = commonroad::read_file(&args.scenario).map_err(Failure::file)?;
        if let Some(file) = &args.grid {
            scenario.overlay(ros_map::read_file(file).map_err(Failure::file)?, &file.display().to_string());
        }
        let problem = choose(&scenario, args.problem, &args.scenario)?;
        let mut settings = args.config.as_deref().map_or(Ok(Settings::default()), settings)?;
        if let Some(friction) = friction {
            friction.apply(&mut settings)?;
        }
        apply(kind, (args.comfort, args.fallbacks), (&args.inject, args.seed), &mut settings)?;
        let vehicle = vehicle::load(&args.vehicle).map_err(Failure::file)?;
        if outputs.solution.is_some() && vehicle.commonroad_type.is_none() {
            let reason = format!("--solution needs a vehicle with a CommonRoad type; {} has none", vehicle.name);
            return Err(Failure::Use(reason));
        }
        Ok(Self {
            kind,
            file: args.scenario,
            scenario,
            problem,
            vehicle,
            seed: settings.faults.seed,
            settings,
            threads: args.threads,
            outputs,
            quiet: args.quiet,
        })
    }

    /// The planning problem to solve.
    pub(super) fn problem(&self) -> &PlanningProblem {
        &self.scenario.problems[self.problem]
    }
}

/// Index of the problem with that id, or of the only one.
fn choose(scenario: &Scenario, id: Option<i64>, file: &Path) -> Result<usize, Failure> {
    let ids = || scenario.problems.iter().map(|p| p.id.to_string()).collect::<Vec<_>>().join(", ");
    match id {
        Some(id) => scenario.problems.iter().position(|p| p.id == id).ok_or_else(|| {
            Failure::File(format!("{}: has no planning problem {id}; it has {}", file.display(), ids()))
        }),
        None if scenario.problems.len() == 1 => Ok(0),
        None => Err(Failure::File(format!(
            "{}: has several planning problems; choose one of {} with --problem ID",
            file.display(),
            ids()
        ))),
    }
}

/// What was typed goes before what a file says.
fn apply(
    kind: Kind,
    (comfort, fallbacks): (Option<ComfortPreset>, Option<FallbackInterval>),
    (inject, seed): (&[String], Option<u64>),
    settings: &mut Settings,
) -> Result<(), Failure> {
    let wrong = |what: &str| Failure::Use(what.to_owned());
    if kind == Kind::Plan && !inject.is_empty() {
        return Err(wrong("--inject: a plan is not driven, so nothing can go wrong with it"));
    }
    settings.verdict.comfort = comfort.unwrap_or(settings.verdict.comfort);
    match fallbacks {
        Some(FallbackInterval::Off) => settings.verdict.fallbacks.enabled = false,
        Some(FallbackInterval::Seconds(interval)) => {
            settings.verdict.fallbacks.enabled = true;
            settings.verdict.fallbacks.interval = interval;
        }
        None => {}
    }
    for fault in inject {
        settings.faults.inject(fault).map_err(|e| wrong(&format!("--inject: {e}")))?;
    }
    settings.faults.seed = seed.unwrap_or(settings.faults.seed);
    settings.validate().map_err(|e| wrong(&e.to_string()))
}

/// Reads settings from TOML and checks their ranges.
fn settings(file: &Path) -> Result<Settings, Failure> {
    let settings: Settings = read_toml(file)?;
    settings.validate().map_err(|e| Failure::File(format!("{}: {e}", file.display())))?;
    Ok(settings)
}

fn read_toml<T: serde::de::DeserializeOwned>(file: &Path) -> Result<T, Failure> {
    let text = settings_file::text(file).map_err(Failure::file)?;
    settings_file::parse(file, &text).map_err(Failure::file)
}

/// What `--friction` asks for.
enum Friction {
    Everywhere(f64),
    Regions(PathBuf),
}

impl Friction {
    fn of(text: &str) -> Self {
        let factor = simulation::surface(text).or_else(|| text.parse().ok());
        factor.map_or_else(|| Self::Regions(text.into()), Self::Everywhere)
    }

    fn file(&self) -> Option<PathBuf> {
        match self {
            Self::Everywhere(_) => None,
            Self::Regions(file) => Some(file.clone()),
        }
    }

    /// Goes before what the settings say: a factor is for all of the road, without their patches; patches are instead of
    /// theirs.
    fn apply(self, settings: &mut Settings) -> Result<(), Failure> {
        #[derive(serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Regions {
            friction: Vec<simulation::FrictionRegion>,
        }
        match self {
            Self::Everywhere(factor) => {
                settings.simulation.friction_scale = factor;
                settings.friction.clear();
                settings.validate().map_err(|e| Failure::Use(format!("--friction: {e}")))
            }
            Self::Regions(file) => {
                let regions = read_toml::<Regions>(&file)?.friction;
                for (index, region) in regions.iter().enumerate() {
                    region.validate(index).map_err(|e| Failure::File(format!("{}: {e}", file.display())))?;
                }
                settings.friction = regions;
                Ok(())
            }
        }
    }
}

/// One name for one file, also where the file does not exist yet.
fn real(path: &Path) -> PathBuf {
    let in_real_folder = || {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some(folder.canonicalize().ok()?.join(path.file_name()?))
    };
    path.canonicalize().ok().or_else(in_real_folder).unwrap_or_else(|| path.to_owned())
}

impl Outputs {
    pub(super) fn json_on_stdout(&self) -> bool {
        self.json.as_deref() == Some(Path::new("-"))
    }

    /// The files to write.
    fn files(&self) -> impl Iterator<Item = &Path> {
        let json = self.json.as_deref().filter(|_| !self.json_on_stdout());
        let others = [&self.csv, &self.solution, &self.svg, &self.rrd];
        json.into_iter().chain(others.into_iter().filter_map(|p| p.as_deref()))
    }

    /// Each file once, none of them an input, all writable.
    pub(super) fn check(&self, inputs: &[PathBuf]) -> Result<(), Failure> {
        if self.rrd.is_some() && !cfg!(feature = "rerun") {
            let reason = "--rrd: this stopline was built without recordings (cargo feature `rerun`)";
            return Err(Failure::Use(reason.into()));
        }
        check_files(&self.files().collect::<Vec<_>>(), inputs)
    }
}

/// Each output once, none of them an input, all writable.
pub(super) fn check_files(outputs: &[&Path], inputs: &[PathBuf]) -> Result<(), Failure> {
    if outputs.contains(&Path::new("-")) {
        let reason = "only --json goes to stdout with `-`; a file of that name is `./-`";
        return Err(Failure::Use(reason.into()));
    }
    let mut taken: Vec<PathBuf> = inputs.iter().map(|p| real(p)).collect();
    for file in outputs {
        let is_device = std::fs::metadata(file).is_ok_and(|about| !about.is_file() && !about.is_dir());
        if taken.contains(&real(file)) {
            return Err(Failure::Use(format!("{}: is named twice, as input or output", file.display())));
        }
        if !is_device {
            taken.push(real(file));
        }
    }
    outputs.iter().try_for_each(|file| files::check_writable(file).map_err(Failure::file))
}
