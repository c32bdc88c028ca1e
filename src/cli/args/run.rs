//! Arguments of `plan` and `drive`. Each value is checked here, so that clap names the flag and the value in its message.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args as ArgGroup;
use clap::builder::{NonEmptyStringValueParser, PathBufValueParser, TypedValueParser};

use crate::drive::{Faults, PredictionMode, Sensor};
use crate::io::settings_file::nearest;
use crate::number;
use crate::simulation;
use crate::verdict::{self, ComfortPreset};

use super::MAX_THREADS;

/// Arguments of `plan`.
#[derive(Debug, ArgGroup)]
pub(in crate::cli) struct PlanArgs {
    #[command(flatten)]
    pub(in crate::cli) inputs: InputArgs,
    #[command(flatten)]
    pub(in crate::cli) outputs: OutputArgs,
}

/// Arguments of `drive`.
#[derive(Debug, ArgGroup)]
pub(in crate::cli) struct DriveArgs {
    #[command(flatten)]
    pub(in crate::cli) inputs: InputArgs,

    /// Friction of the road: dry, wet, ice or a factor for the whole road, or a file of [[friction]] tables
    ///
    /// A factor multiplies the tyres' friction and replaces the friction patches of --config. Each [[friction]] table of a
    /// file is a patch with a `factor` and a `polygon`. The planner assumes the least friction of the road.
    #[arg(long, value_name = "FACTOR|FILE.toml", allow_negative_numbers = true, value_parser = Friction::parse,
          help_heading = "Simulation")]
    pub(in crate::cli) friction: Option<Friction>,

    /// Inject a fault that the planner does not know; repeatable
    ///
    /// delay=S: dead time of the actuators. friction=FACTOR: factor on the friction of the road. mass=FACTOR: factor on the
    /// vehicle's mass. noise=M: standard deviation of the localisation error, m. missed_cycles=N: planning cycles skipped after each
    /// one. Each fault at most once.
    #[arg(long, value_name = "NAME=VALUE", value_parser = fault, help_heading = "Simulation")]
    pub(in crate::cli) inject: Vec<String>,

    /// Random seed of the injected noise, stored in the result
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole(0..=u64::MAX),
          help_heading = "Simulation")]
    pub(in crate::cli) seed: Option<u64>,

    /// Comfort limit preset: safetlp (the vehicle's limits, the default), iso15622, iso11270 or r157
    #[arg(long, value_name = "PRESET", value_parser = comfort, help_heading = "Checks")]
    pub(in crate::cli) comfort: Option<ComfortPreset>,

    /// Simulate the fallback stop of the committed plan every S seconds, or never (`off`); default 0.5
    ///
    /// Each fallback branch starts from the state of the run and follows the proven stop to standstill.
    #[arg(long, value_name = "S|off", value_parser = fallback_interval, allow_negative_numbers = true,
          help_heading = "Checks")]
    pub(in crate::cli) fallbacks: Option<FallbackInterval>,

    #[command(flatten)]
    pub(in crate::cli) outputs: OutputArgs,

    /// Add every planning cycle to the JSON (requires --json), with its candidates, cost terms and rejections; the file becomes large
    #[arg(long, requires = "json", help_heading = "Outputs")]
    pub(in crate::cli) json_cycles: bool,
}

/// What a run reads.
#[derive(Debug, ArgGroup)]
pub(in crate::cli) struct InputArgs {
    /// Scenario file: CommonRoad XML, 2018b or 2020a; `-` reads standard input
    pub(in crate::cli) scenario: PathBuf,

    /// Vehicle: a built-in name, or a folder with vehicle.urdf and dynamics.toml
    #[arg(long, value_name = "NAME|FOLDER", default_value = "bmw_320i", value_parser = NonEmptyStringValueParser::new())]
    pub(in crate::cli) vehicle: String,

    /// Configuration overrides, TOML
    #[arg(long, value_name = "FILE.toml")]
    pub(in crate::cli) config: Option<PathBuf>,

    /// Occupancy grid of ROS in the scenario's coordinates; its occupied cells are obstacles
    #[arg(long, value_name = "FILE.yaml")]
    pub(in crate::cli) grid: Option<PathBuf>,

    /// Planning problem of the scenario, required if the scenario has several
    #[arg(long, value_name = "ID", allow_negative_numbers = true, value_parser = problem)]
    pub(in crate::cli) problem: Option<i64>,

    /// Leave an obstacle of the scenario out; repeatable
    #[arg(long, value_name = "ID", allow_negative_numbers = true, value_parser = obstacle)]
    pub(in crate::cli) without: Vec<i64>,

    /// Leave out the obstacle that is exactly where the planning problem starts, if there is one
    ///
    /// Exports of recordings often contain the recorded vehicle itself.
    #[arg(long)]
    pub(in crate::cli) without_recorded_ego: bool,

    /// How the planner predicts obstacles: recorded (as in the scenario, the default), constant-velocity or lane-following
    #[arg(long, value_name = "MODE", value_parser = prediction, help_heading = "Observation")]
    pub(in crate::cli) prediction: Option<PredictionMode>,

    /// What of the obstacles is in sight, as NAME=VALUE,…; default: all of them
    ///
    /// range=M: largest distance. fov=DEGREES: field of view around the heading. occlusion: obstacles hide each other. delay=S: age
    /// of what is seen. missed=P: probability that an obstacle is missed in a cycle, with seed=N. Each name at most once.
    #[arg(long, value_name = "NAME=VALUE,…", value_parser = sensor, help_heading = "Observation")]
    pub(in crate::cli) sensor: Option<String>,

    /// Planner threads; default: all cores. The result does not depend on it
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole(1..=MAX_THREADS))]
    pub(in crate::cli) threads: Option<u16>,
}

/// What a run writes.
#[derive(Debug, ArgGroup)]
pub(in crate::cli) struct OutputArgs {
    /// Write the result as JSON; `-` prints it to stdout instead of the report
    #[arg(long, value_name = "PATH|-", help_heading = "Outputs", value_parser = output("--json", "JSON", &["json"]))]
    pub(in crate::cli) json: Option<PathBuf>,

    /// Write the simulated states (`plan`: the planned states) as a CSV table
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = output("--csv", "CSV", &["csv"]))]
    pub(in crate::cli) csv: Option<PathBuf>,

    /// Write a CommonRoad solution for the kinematic single-track model
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = output("--solution", "XML", &["xml"]))]
    pub(in crate::cli) solution: Option<PathBuf>,

    /// Write a picture in SVG
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = output("--svg", "SVG", &["svg"]))]
    pub(in crate::cli) svg: Option<PathBuf>,

    /// Write a recording for the Rerun viewer
    #[arg(long, value_name = "PATH", help_heading = "Outputs",
          value_parser = output("--rrd", "a Rerun recording", &["rrd"]))]
    pub(in crate::cli) rrd: Option<PathBuf>,

    /// Print errors only, neither report nor progress bar
    #[arg(long)]
    pub(in crate::cli) quiet: bool,
}

/// File name extensions of common formats. An output with one of them must have that format.
const KNOWN_FORMATS: [&str; 25] = [
    "bmp", "csv", "eps", "gif", "gz", "htm", "html", "jpeg", "jpg", "json", "md", "ods", "parquet", "pdf", "png", "ps",
    "rrd", "svg", "tif", "tiff", "webp", "xls", "xlsx", "xml", "zip",
];

/// Parser of an output's path. It refuses an extension that names another format than the one written.
pub(super) fn output(
    flag: &'static str,
    format: &'static str,
    own: &'static [&'static str],
) -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(move |path| {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        if KNOWN_FORMATS.contains(&extension.as_str()) && !own.contains(&extension.as_str()) {
            let better = path.with_extension(own.first().copied().unwrap_or_default());
            return Err(format!("{flag} writes {format}, not .{extension}; did you mean {}?", better.display()));
        }
        Ok(path)
    })
}

/// How often fallback branches are simulated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::cli) enum FallbackInterval {
    /// Never.
    Off,
    /// With this interval, s.
    Seconds(f64),
}

fn fallback_interval(text: &str) -> Result<FallbackInterval, String> {
    match text {
        "off" => Ok(FallbackInterval::Off),
        seconds => interval(seconds).map(FallbackInterval::Seconds).map_err(|e| format!("{e}, or off")),
    }
}

/// The time between two fallback branches, s.
pub(super) fn interval(text: &str) -> Result<f64, String> {
    let interval = text.parse().unwrap_or(f64::NAN);
    let mut settings = verdict::Settings::default();
    settings.fallbacks.interval = interval;
    settings.validate().map(|()| interval).map_err(|e| format!("expected an interval {}", e.expected))
}

/// Parser of a whole number in a range.
pub(super) fn whole<T>(range: RangeInclusive<T>) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static
where
    T: FromStr + PartialOrd + Display + Clone + Send + Sync + 'static,
{
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or_else(|| format!("expected a whole number from {} to {}", range.start(), range.end()))
    }
}

/// The id of a planning problem.
fn problem(text: &str) -> Result<i64, String> {
    text.parse().map_err(|_| "expected the id of a planning problem, a whole number".into())
}

/// The id of an obstacle.
fn obstacle(text: &str) -> Result<i64, String> {
    text.parse().map_err(|_| "expected the id of an obstacle, a whole number".into())
}

/// Checks a fault without injecting it.
pub(super) fn fault(text: &str) -> Result<String, String> {
    let known = text.split_once('=').map(|(name, _)| name.trim()).unwrap_or(text);
    Faults::default().inject(text).map(|()| text.to_owned()).map_err(|e| suggest(e, known, &Faults::NAMES))
}

fn prediction(text: &str) -> Result<PredictionMode, String> {
    let names = PredictionMode::ALL.map(PredictionMode::name);
    let unknown = || suggest(format!("expected one of {}", names.join(", ")), text, &names);
    PredictionMode::ALL.into_iter().find(|mode| mode.name() == text).ok_or_else(unknown)
}

/// Checks the properties of a sensor without setting them, first each by itself.
fn sensor(text: &str) -> Result<String, String> {
    for property in text.split(',') {
        let name = property.split_once('=').map_or(property, |(name, _)| name).trim();
        Sensor::default().set(property).map_err(|e| suggest(e, name, &Sensor::NAMES))?;
    }
    Sensor::default().set(text).map(|()| text.to_owned())
}

fn comfort(text: &str) -> Result<ComfortPreset, String> {
    text.parse().map_err(|e| suggest(e, text, &ComfortPreset::ALL.map(ComfortPreset::name)))
}

/// The message with the known name that is nearest to a wrong one, if any is near.
fn suggest(message: String, wrong: &str, known: &[&str]) -> String {
    match nearest(&wrong.to_lowercase(), known.iter().copied()).filter(|name| *name != wrong) {
        Some(name) => format!("{message}; did you mean `{name}`?"),
        None => message,
    }
}

/// Value of `--friction`.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::cli) enum Friction {
    /// A factor for the whole road.
    Everywhere(f64),
    /// A file of friction patches.
    Patches(PathBuf),
}

impl Friction {
    fn parse(text: &str) -> Result<Self, String> {
        let number = || text.parse::<f64>().ok();
        if let Some(factor) = simulation::surface(text).or_else(number) {
            let settings = simulation::Settings { friction_scale: factor, ..simulation::Settings::default() };
            return settings.validate().map(|()| Self::Everywhere(factor)).map_err(|_| Self::expected());
        }
        if let Some(percent) = text.strip_suffix('%').and_then(|p| p.trim().parse::<f64>().ok()) {
            return Err(format!("{}; {text} is the factor {}", Self::expected(), number::exact(percent / 100.0)));
        }
        if names_a_file(text) {
            return Ok(Self::Patches(text.into()));
        }
        Err(suggest(Self::expected(), text, &simulation::SURFACES.map(|(name, _)| name)))
    }

    fn expected() -> String {
        let surfaces = simulation::SURFACES.map(|(name, _)| name).join(", ");
        format!("expected {surfaces}, a factor above 0 and at most 10, or a TOML file of [[friction]] tables")
    }

    /// The file to read, if any.
    pub(in crate::cli) fn file(&self) -> Option<&Path> {
        match self {
            Self::Everywhere(_) => None,
            Self::Patches(file) => Some(file),
        }
    }
}

/// Whether a text is a path: of a file that exists, or with a folder or an extension in it.
fn names_a_file(text: &str) -> bool {
    let path = Path::new(text);
    let has_extension = path.extension().is_some_and(|e| e.to_string_lossy().starts_with(|c: char| c.is_alphabetic()));
    has_extension || text.contains(std::path::is_separator) || path.exists()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_friction_as_surface_factor_or_file() {
        assert_eq!(Friction::parse("wet"), Ok(Friction::Everywhere(0.6)));
        assert_eq!(Friction::parse("0.35"), Ok(Friction::Everywhere(0.35)));
        assert_eq!(Friction::parse("road.toml"), Ok(Friction::Patches("road.toml".into())));
        assert_eq!(Friction::parse("roads/ice"), Ok(Friction::Patches("roads/ice".into())));
        for wrong in ["snow", "60%", "6 %", "-1", "0", "nan", "inf", "1e300", "", "0.6.2"] {
            let message = Friction::parse(wrong).expect_err(wrong);
            assert!(message.contains("dry, wet, ice") && message.contains("at most 10"), "{wrong}: {message}");
        }
        assert!(Friction::parse("60%").unwrap_err().ends_with("60% is the factor 0.6"));
        assert!(Friction::parse("Wett").unwrap_err().ends_with("did you mean `wet`?"));
        assert!(Friction::parse("ICE").unwrap_err().ends_with("did you mean `ice`?"));
    }

    #[test]
    fn parses_fallback_intervals() {
        assert_eq!(fallback_interval("off"), Ok(FallbackInterval::Off));
        assert_eq!(fallback_interval("2"), Ok(FallbackInterval::Seconds(2.0)));
        for wrong in ["0", "-1", "0.001", "nan", "inf", "1e300", "often", ""] {
            assert!(fallback_interval(wrong).expect_err(wrong).contains("from 0.05 to 3600 s"));
        }
    }
}
