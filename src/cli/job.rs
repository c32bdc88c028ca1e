//! A job: arguments resolved, inputs read and checked, outputs known to be writable. Once a job exists, only a fault of the
//! program can stop it.

use std::path::{Path, PathBuf};

use super::Failure;
use super::args::{DriveArgs, FallbackInterval, Friction, InputArgs, OutputArgs, PlanArgs};
use super::engine::Settings;
use crate::io::kind::FileKind;
use crate::io::settings_file::nearest;
use crate::io::{commonroad, files, ros_map, settings_file};
use crate::map::{PlanningProblem, Scenario};
pub(super) use crate::result::Kind;
use crate::simulation;
use crate::vehicle::{self, Vehicle, VehicleError};

/// Everything that a run needs, read and checked.
pub(super) struct Job {
    pub(super) kind: Kind,
    /// Name of the scenario's file, for messages.
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
    /// Whether the JSON lists every planning cycle.
    pub(super) json_cycles: bool,
    pub(super) csv: Option<PathBuf>,
    pub(super) solution: Option<PathBuf>,
    pub(super) svg: Option<PathBuf>,
    pub(super) rrd: Option<PathBuf>,
}

impl Job {
    /// Reads the inputs of a planning cycle and checks its outputs.
    pub(super) fn plan(args: PlanArgs) -> Result<Self, Failure> {
        Self::new(Kind::Plan, args.inputs, Outputs::new(&args.outputs, false), args.outputs.quiet, None, |_| Ok(()))
    }

    /// Reads the inputs of a drive and checks its outputs.
    pub(super) fn drive(args: DriveArgs) -> Result<Self, Failure> {
        let DriveArgs { inputs, outputs, json_cycles, friction, inject, seed, comfort, fallbacks } = args;
        let file = friction.as_ref().and_then(Friction::file).map(Path::to_owned);
        let change = |settings: &mut Settings| {
            if let Some(friction) = friction {
                apply_friction(friction, settings)?;
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
            settings.faults.inject_all(&inject).map_err(|e| Failure::Use(format!("--inject: {e}")))?;
            settings.faults.seed = seed.unwrap_or(settings.faults.seed);
            Ok(())
        };
        Self::new(Kind::Drive, inputs, Outputs::new(&outputs, json_cycles), outputs.quiet, file, change)
    }

    /// Reads the inputs, checks the outputs. Flags have priority over the settings file: `change` applies them.
    fn new(
        kind: Kind,
        args: InputArgs,
        outputs: Outputs,
        quiet: bool,
        friction: Option<PathBuf>,
        change: impl FnOnce(&mut Settings) -> Result<(), Failure>,
    ) -> Result<Self, Failure> {
        let is_stdin = args.scenario == Path::new("-");
        let mut inputs: Vec<PathBuf> = args.config.iter().chain(&args.grid).cloned().chain(friction).collect();
        inputs.extend(Some(&args.scenario).filter(|_| !is_stdin).cloned());
        inputs.extend(args.grid.as_deref().and_then(ros_map::image_of));
        inputs.extend(vehicle::files_of(&args.vehicle));
        outputs.check(&inputs)?;
        let mut settings = args.config.as_deref().map_or(Ok(Settings::default()), settings)?;
        change(&mut settings)?;
        settings.observation.prediction = args.prediction.unwrap_or(settings.observation.prediction);
        if let Some(sensor) = &args.sensor {
            let set = settings.observation.sensor.set(sensor);
            set.map_err(|e| Failure::Use(format!("--sensor {sensor}: {e}")))?;
        }
        // each flag was in its range, so this cannot fail but for settings that exclude each other
        settings.validate().map_err(|e| Failure::Use(e.to_string()))?;
        let vehicle = vehicle::load(&args.vehicle).map_err(|e| wrong_vehicle(&args.vehicle, &e))?;
        if outputs.solution.is_some() && vehicle.commonroad_type.is_none() {
            let reason = format!("--solution needs a vehicle with a CommonRoad type; {} has none", vehicle.name);
            return Err(Failure::Use(reason));
        }
        let (mut scenario, file) = if is_stdin { stdin()? } else { (scenario(&args.scenario)?, args.scenario) };
        if let Some(file) = &args.grid {
            let grid = ros_map::read_file(file).map_err(|e| Input::Grid.failure(file, &e))?;
            scenario.overlay(grid, &file.display().to_string());
        }
        let problem = choose(&scenario, args.problem, &file)?;
        leave_out(&mut scenario, problem, &args.without, args.without_recorded_ego)
            .map_err(|id| Failure::File(format!("--without {id}: {} has no obstacle {id}", file.display())))?;
        Ok(Self {
            kind,
            file,
            scenario,
            problem,
            vehicle,
            seed: settings.faults.seed,
            settings,
            threads: args.threads,
            outputs,
            quiet,
        })
    }

    /// The planning problem to solve.
    pub(super) fn problem(&self) -> &PlanningProblem {
        &self.scenario.problems[self.problem]
    }
}

/// An input that names a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Input {
    Scenario,
    Config,
    Grid,
    Friction,
    Vehicle,
}

impl Input {
    /// The flag, with a space after it; empty for the scenario, which has none.
    fn flag(self) -> &'static str {
        match self {
            Self::Scenario => "",
            Self::Config => "--config ",
            Self::Grid => "--grid ",
            Self::Friction => "--friction ",
            Self::Vehicle => "--vehicle ",
        }
    }

    fn reads(self, kind: FileKind) -> bool {
        match self {
            Self::Scenario => kind == FileKind::Scenario,
            Self::Config => matches!(kind, FileKind::Settings | FileKind::FrictionPatches),
            Self::Grid => kind == FileKind::OccupancyGrid,
            Self::Friction => kind == FileKind::FrictionPatches,
            Self::Vehicle => matches!(kind, FileKind::Urdf | FileKind::Dynamics | FileKind::VehicleFolder),
        }
    }

    fn expected(self) -> &'static str {
        match self {
            Self::Scenario => "a CommonRoad scenario",
            Self::Config => "settings in TOML",
            Self::Grid => "the YAML file of an occupancy grid",
            Self::Friction => "a TOML file of [[friction]] tables",
            Self::Vehicle => "a built-in name, or a folder with vehicle.urdf and dynamics.toml",
        }
    }

    /// The failure of a reader. A file of another kind is named, with the flag or command that reads it.
    fn failure(self, file: &Path, error: &dyn std::fmt::Display) -> Failure {
        match FileKind::of(file) {
            Some(kind) => self.failure_of_kind(kind, file, error),
            None => Failure::File(format!("{}{error}", self.flag())),
        }
    }

    fn failure_of_kind(self, kind: FileKind, file: &Path, error: &dyn std::fmt::Display) -> Failure {
        let flag = self.flag();
        Failure::File(if self.reads(kind) {
            format!("{flag}{error}")
        } else {
            format!("{flag}{}: this is {kind}, expected {}; {}", file.display(), self.expected(), kind.reader())
        })
    }
}

fn scenario(file: &Path) -> Result<Scenario, Failure> {
    commonroad::read_file(file).map_err(|e| Input::Scenario.failure(file, &e))
}

/// Reads a scenario from standard input, in any form in which a file may be. The name stands for it in messages.
fn stdin() -> Result<(Scenario, PathBuf), Failure> {
    const NAME: &str = "<stdin>";
    let scenario = commonroad::read_from(NAME, std::io::stdin().lock()).map_err(Failure::file)?;
    Ok((scenario, NAME.into()))
}

/// Index of the problem with that id, or of the only one.
fn choose(scenario: &Scenario, id: Option<i64>, file: &Path) -> Result<usize, Failure> {
    let ids = || scenario.problems.iter().map(|p| p.id.to_string()).collect::<Vec<_>>().join(", ");
    match id {
        Some(id) => scenario.problems.iter().position(|p| p.id == id).ok_or_else(|| {
            let name = file.display();
            Failure::File(format!("--problem {id}: {name} has no planning problem {id}; it has {}", ids()))
        }),
        None if scenario.problems.len() == 1 => Ok(0),
        None => Err(Failure::File(format!(
            "{}: has several planning problems; choose one of {} with --problem ID",
            file.display(),
            ids()
        ))),
    }
}

/// Leaves obstacles out of the scenario. The error is the id of one that it does not have.
fn leave_out(scenario: &mut Scenario, problem: usize, without: &[i64], without_ego: bool) -> Result<(), i64> {
    let ego = scenario.recorded_ego(&scenario.problems[problem]).map(|obstacle| obstacle.id).filter(|_| without_ego);
    if let Some(id) = without.iter().find(|id| !scenario.leave_out(**id)) {
        return Err(*id);
    }
    ego.into_iter().for_each(|id| {
        scenario.leave_out(id);
    });
    Ok(())
}

/// A vehicle that cannot be read. An unknown name gets the built-in name that it may stand for.
pub(super) fn wrong_vehicle(typed: &str, error: &VehicleError) -> Failure {
    let VehicleError::Unknown { .. } = error else {
        return Input::Vehicle.failure(Path::new(typed), &format!("{typed}: {error}"));
    };
    let names = vehicle::builtin_names();
    let meant = nearest(&typed.to_lowercase(), names.iter().copied());
    let hint = meant.map_or_else(String::new, |name| format!("; did you mean `{name}`?"));
    Failure::File(format!(
        "--vehicle {typed}: no such vehicle; expected one of {}, or a folder with vehicle.urdf and dynamics.toml{hint}",
        names.join(", ")
    ))
}

/// Reads settings from TOML and checks their ranges.
pub(super) fn settings(file: &Path) -> Result<Settings, Failure> {
    let settings: Settings = read_toml(Input::Config, file)?;
    let wrong = |e| Failure::File(format!("--config {}: {}", file.display(), e));
    settings.validate().map(|()| settings).map_err(wrong)
}

fn read_toml<T: serde::de::DeserializeOwned>(input: Input, file: &Path) -> Result<T, Failure> {
    let text = settings_file::text(file).map_err(|e| input.failure(file, &e))?;
    settings_file::parse(file, &text).map_err(|e| input.failure(file, &e))
}

/// A factor is for the whole road and removes the settings' patches; patches replace those of the settings.
fn apply_friction(friction: Friction, settings: &mut Settings) -> Result<(), Failure> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Patches {
        friction: Vec<simulation::FrictionRegion>,
    }
    match friction {
        Friction::Everywhere(factor) => {
            settings.simulation.friction_scale = factor;
            settings.friction.clear();
        }
        Friction::Patches(file) => {
            let patches = read_toml::<Patches>(Input::Friction, &file)?.friction;
            for (index, patch) in patches.iter().enumerate() {
                patch.validate(index).map_err(|e| Failure::File(format!("--friction {}: {e}", file.display())))?;
            }
            settings.friction = patches;
        }
    }
    Ok(())
}

/// One name for one file, also if the file does not exist yet.
fn real(path: &Path) -> PathBuf {
    let in_real_folder = || {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some(folder.canonicalize().ok()?.join(path.file_name()?))
    };
    path.canonicalize().ok().or_else(in_real_folder).unwrap_or_else(|| path.to_owned())
}

impl Outputs {
    fn new(args: &OutputArgs, json_cycles: bool) -> Self {
        let OutputArgs { json, csv, solution, svg, rrd, quiet: _ } = args;
        let (json, csv, solution) = (json.clone(), csv.clone(), solution.clone());
        Self { json, json_cycles, csv, solution, svg: svg.clone(), rrd: rrd.clone() }
    }

    pub(super) fn json_on_stdout(&self) -> bool {
        self.json.as_deref() == Some(Path::new("-"))
    }

    /// The files to write, with their flags.
    fn files(&self) -> Vec<Output<'_>> {
        let json = self.json.as_ref().filter(|_| !self.json_on_stdout());
        let files = [
            ("--json", json),
            ("--csv", self.csv.as_ref()),
            ("--solution", self.solution.as_ref()),
            ("--svg", self.svg.as_ref()),
            ("--rrd", self.rrd.as_ref()),
        ];
        files.into_iter().filter_map(|(flag, file)| file.map(|file| Output { flag, file })).collect()
    }

    /// Each file once, none of them an input, all writable.
    pub(super) fn check(&self, inputs: &[PathBuf]) -> Result<(), Failure> {
        if self.rrd.is_some() && !cfg!(feature = "rerun") {
            let reason = "--rrd: this stopline was built without recordings (cargo feature `rerun`)";
            return Err(Failure::Use(reason.into()));
        }
        check_outputs(&self.files(), inputs)
    }
}

/// A file to write.
#[derive(Debug, Clone, Copy)]
struct Output<'a> {
    /// The flag that names it; empty if not known.
    flag: &'static str,
    file: &'a Path,
}

impl Output<'_> {
    /// The message with flag and file before it.
    fn named(&self, message: &dyn std::fmt::Display) -> String {
        format!("{} {message}", self.flag).trim_start().to_owned()
    }
}

/// Each output once, none of them an input, all writable.
pub(super) fn check_files(outputs: &[&Path], inputs: &[PathBuf]) -> Result<(), Failure> {
    check_outputs(&outputs.iter().map(|file| Output { flag: "", file }).collect::<Vec<_>>(), inputs)
}

fn check_outputs(outputs: &[Output], inputs: &[PathBuf]) -> Result<(), Failure> {
    if let Some(output) = outputs.iter().find(|output| output.file == Path::new("-")) {
        let reason = "-: only --json prints to stdout with `-`; a file of that name is `./-`";
        return Err(Failure::Use(output.named(&reason)));
    }
    let mut taken: Vec<PathBuf> = inputs.iter().map(|p| real(p)).collect();
    for output in outputs {
        let is_device = std::fs::metadata(output.file).is_ok_and(|about| !about.is_file() && !about.is_dir());
        if taken.contains(&real(output.file)) {
            let reason = format!("{}: named twice, as input or output", output.file.display());
            return Err(Failure::Use(output.named(&reason)));
        }
        if !is_device {
            taken.push(real(output.file));
        }
    }
    let check = |output: &Output| files::check_writable(output.file).map_err(|e| Failure::File(output.named(&e)));
    outputs.iter().try_for_each(check)
}
