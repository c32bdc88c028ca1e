//! Commands and their arguments, as clap parses them.

mod run;

use std::path::PathBuf;

use clap::builder::NonEmptyStringValueParser;
use clap::{Args as ArgGroup, Parser, Subcommand};

use crate::regression::Shard;

pub(super) use run::{DriveArgs, FallbackInterval, Friction, InputArgs, OutputArgs, PlanArgs};

/// The exit codes, at the end of every help text.
const EXIT_CODES: &str = "Exit codes:
  0  the run ended and every check passed
  1  the run ended and a check failed, or no safe plan exists
  2  wrong use of the command line
  3  an input is unreadable or invalid, or an output cannot be written
  4  a fault of the program itself";

/// The exit codes of `check`.
const CHECK_EXIT_CODES: &str = "Exit codes:
  0  every drive met its expectations
  1  a drive did not meet its expectations, or passed although a failure was expected
  2  wrong use of the command line
  3  an input is unreadable or invalid, or an output cannot be written
  4  a fault of the program itself
  130  interrupted by Ctrl-C";

/// Problems of a comparison.
const DEFAULT_PROBLEMS: u32 = 2000;
/// Most problems that can be asked for: about ten minutes.
const MAX_PROBLEMS: u32 = 1_000_000;

/// Most threads that can be asked for.
const MAX_THREADS: u16 = 1024;

/// A local planner for road vehicles that never commits to a trajectory it cannot stop from, and a vehicle simulation that
/// checks whether that was right.
#[derive(Debug, Parser)]
#[command(name = "stopline", version, after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
pub(super) struct Args {
    #[command(subcommand)]
    pub(super) command: Command,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Compute one planning cycle from the initial state, without simulation.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Plan(PlanArgs),
    /// Drive a scenario in closed loop: replan at 10 Hz, simulate the vehicle, check the run.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Drive(DriveArgs),
    /// Run regression suites and write reports that CI systems read.
    #[command(after_help = CHECK_EXIT_CODES, after_long_help = CHECK_EXIT_CODES)]
    Check(CheckArgs),
    /// Compare methods on problems generated from a seed.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Bench(BenchArgs),
    /// Print the completion script of a shell.
    #[command(after_help = COMPLETIONS_HELP, after_long_help = COMPLETIONS_HELP)]
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
    /// Print the manual page, or write the pages of all commands.
    Man {
        /// Write one page per command to this folder (stopline.1, stopline-plan.1, …); it is created if missing.
        #[arg(long, value_name = "FOLDER")]
        out: Option<PathBuf>,
    },
}

/// How a completion script is installed.
const COMPLETIONS_HELP: &str = "Examples:
  bash  stopline completions bash > ~/.local/share/bash-completion/completions/stopline
  zsh   stopline completions zsh > ~/.zfunc/_stopline   (with ~/.zfunc in fpath)
  fish  stopline completions fish > ~/.config/fish/completions/stopline.fish";

/// Arguments of `check`.
#[derive(Debug, ArgGroup)]
pub(super) struct CheckArgs {
    /// Suites: TOML files, or folders with a suite.toml.
    #[arg(required = true, value_name = "SUITE")]
    pub(super) suites: Vec<PathBuf>,

    /// Number of parallel drives; the number of cores if not given. The reports do not depend on it.
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = run::whole(1..=MAX_THREADS))]
    pub(super) jobs: Option<u16>,

    /// Run only part I of N: every Nth drive, beginning with the Ith.
    #[arg(long, value_name = "I/N", allow_hyphen_values = true)]
    pub(super) shard: Option<Shard>,

    /// Store finished drives in this file. After an interruption the same command continues from there.
    ///
    /// Ctrl-C finishes the running drives, prints the results so far and the command to continue, and ends with exit code
    /// 130. A second Ctrl-C stops at once.
    #[arg(long, value_name = "STATE")]
    pub(super) resume: Option<PathBuf>,

    /// Update the baseline: store the metrics of this run in it.
    #[arg(long)]
    pub(super) update_baseline: bool,

    /// The old name of `--update-baseline`, which is refused.
    #[arg(long, hide = true)]
    pub(super) bless: bool,

    /// Replay only this drive and print its report as `drive` does.
    #[arg(long, value_name = "ID",
          conflicts_with_all = ["shard", "resume", "update_baseline", "json", "junit", "markdown", "html"],
          help_heading = "Replay")]
    pub(super) replay: Option<String>,

    /// Take the settings of the drive from a JSON report, and compare the hash with that of the report.
    #[arg(long, value_name = "FILE.json", requires = "replay", help_heading = "Replay")]
    pub(super) report: Option<PathBuf>,

    /// Save the settings of the drive for `drive --config`, and print the command.
    #[arg(long, value_name = "FILE.toml", requires = "replay", help_heading = "Replay")]
    pub(super) save_config: Option<PathBuf>,

    /// Draw the drive as an SVG picture.
    #[arg(long, value_name = "PATH", requires = "replay", help_heading = "Replay", value_parser = run::output("--svg", "SVG", &["svg"]))]
    pub(super) svg: Option<PathBuf>,

    /// Write the complete report as JSON; `-` prints it to stdout, and nothing else.
    #[arg(long, value_name = "PATH|-", help_heading = "Outputs", value_parser = run::output("--json", "JSON", &["json"]))]
    pub(super) json: Option<PathBuf>,

    /// Write the report as JUnit XML.
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = run::output("--junit", "JUnit XML", &["xml"]))]
    pub(super) junit: Option<PathBuf>,

    /// Write a summary as Markdown.
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = run::output("--markdown", "Markdown", &["md"]))]
    pub(super) markdown: Option<PathBuf>,

    /// Write a page with pictures of failed drives.
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = run::output("--html", "HTML", &["html", "htm"]))]
    pub(super) html: Option<PathBuf>,

    /// Print only failed drives, one line each, and errors.
    #[arg(long)]
    pub(super) quiet: bool,
}

/// Arguments of `bench`.
#[derive(Debug, ArgGroup)]
pub(super) struct BenchArgs {
    #[command(subcommand)]
    pub(super) comparison: Comparison,
}

/// The comparison to run.
#[derive(Debug, Subcommand)]
pub(super) enum Comparison {
    /// Compare methods that connect two poses smoothly: spirals, polynomials, the lecture's shooting method.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Spirals(SpiralArgs),
    /// Repeat the experiment of the SafeTLP paper: four speed planners on 104 instances. Takes minutes.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Safetlp(SafeTlpArgs),
    /// Whether proven stops hold: branches over random scenes, maps, vehicles and road surfaces. Takes minutes.
    ///
    /// Broken is a proven stop that touches something, leaves the road by more than 5 cm, or ends more than 0.3 m beyond the planned
    /// stop or not at all. Stops more than 0.3 m short of the planned one and harder braking than planned are counted beside it.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Fallbacks(FallbackArgs),
    /// The score on published scenarios: drive every CommonRoad file of a folder, count goals, contacts and failed checks, measure the
    /// cycle times.
    ///
    /// A problem is reached if the run meets the goal conditions of its file, touches nothing and stays on the road. The exit code is 1
    /// only for a contact of a run that was proven in every cycle.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Commonroad(CommonRoadArgs),
}

/// Arguments of `bench commonroad`.
#[derive(Debug, ArgGroup)]
pub(super) struct CommonRoadArgs {
    /// Folder of scenarios: every *.xml in it and in its subfolders.
    #[arg(value_name = "FOLDER")]
    pub(super) folder: PathBuf,

    /// Only the scenarios with a name in this file: one name in each line, without .xml; # begins a comment.
    #[arg(long, value_name = "FILE")]
    pub(super) list: Option<PathBuf>,

    /// Files at a time; the number of cores if not given. Only the cycle times depend on it: use 1 to measure them.
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = run::whole(1..=MAX_THREADS))]
    pub(super) jobs: Option<u16>,

    /// The vehicle: a built-in name, or a folder.
    #[arg(long, value_name = "NAME|FOLDER", default_value = "bmw_320i", value_parser = NonEmptyStringValueParser::new())]
    pub(super) vehicle: String,

    /// Configuration overrides, TOML.
    #[arg(long, value_name = "FILE.toml")]
    pub(super) config: Option<PathBuf>,

    /// Leave out the obstacle that is exactly where a planning problem starts, if there is one.
    #[arg(long)]
    pub(super) without_recorded_ego: bool,

    /// The score as JSON; `-` prints it on stdout, and nothing else.
    #[arg(long, value_name = "PATH|-", help_heading = "Outputs", value_parser = run::output("--json", "JSON", &["json"]))]
    pub(super) json: Option<PathBuf>,

    /// One row for each planning problem.
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = run::output("--csv", "CSV", &["csv"]))]
    pub(super) csv: Option<PathBuf>,

    /// No report and no progress bar; errors only.
    #[arg(long)]
    pub(super) quiet: bool,
}

/// Arguments of `bench fallbacks`.
#[derive(Debug, ArgGroup)]
pub(super) struct FallbackArgs {
    /// Seed of the scenes.
    #[arg(long, value_name = "N", default_value_t = crate::bench::problems::SEED, allow_negative_numbers = true,
          value_parser = run::whole(0..=u64::MAX))]
    pub(super) seed: u64,

    /// Random scenes for each pair of vehicle and road surface (dry, wet, ice). By an estimate from samples, 40 and the bundled
    /// maps are about 10,000 branches, and take some ten minutes on two cores.
    #[arg(long, value_name = "N", default_value_t = 90, allow_negative_numbers = true,
          value_parser = run::whole(0..=1_000_000_u64))]
    pub(super) scenes: u64,

    /// Number of the first random scene.
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true,
          value_parser = run::whole(0..=1_000_000_000_u64))]
    pub(super) first: u64,

    /// The maps to run besides: every scenario (*.xml) of this folder, or none of them; default: the folder `maps`, if there is one.
    #[arg(long, value_name = "FOLDER|off")]
    pub(super) maps: Option<PathBuf>,

    /// One vehicle only: the name of a built-in one, or a folder.
    #[arg(long, value_name = "NAME|FOLDER", value_parser = NonEmptyStringValueParser::new())]
    pub(super) vehicle: Option<String>,

    /// Time between two branches of an unchanged plan, s.
    #[arg(long, value_name = "S", default_value_t = 0.5, value_parser = run::interval, allow_negative_numbers = true)]
    pub(super) interval: f64,

    /// A fault unknown to the planner; repeatable, each once: delay=S, friction=FACTOR, mass=FACTOR, noise=M, missed_cycles=N.
    #[arg(long, value_name = "NAME=VALUE", value_parser = run::fault)]
    pub(super) inject: Vec<String>,

    /// The result as JSON; `-` prints it on stdout, and nothing else.
    #[arg(long, value_name = "PATH|-", help_heading = "Outputs", value_parser = run::output("--json", "JSON", &["json"]))]
    pub(super) json: Option<PathBuf>,

    /// One row for each scene.
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = run::output("--csv", "CSV", &["csv"]))]
    pub(super) csv: Option<PathBuf>,

    /// No report and no progress bar; errors only.
    #[arg(long)]
    pub(super) quiet: bool,
}

/// Arguments of `bench safetlp`.
#[derive(Debug, ArgGroup)]
pub(super) struct SafeTlpArgs {
    /// Length of the road, m; at most 10 km.
    #[arg(long, value_name = "M", default_value_t = 100.0, value_parser = road_length, allow_negative_numbers = true)]
    pub(super) length: f64,

    /// Length of a step, m. A step that does not divide the road is adjusted to the nearest one that does.
    #[arg(long, value_name = "M", default_value_t = 0.5, value_parser = step_length, allow_negative_numbers = true)]
    pub(super) step: f64,

    /// Width of a time bin, s; 1 ms to 10 s.
    #[arg(long, value_name = "S", default_value_t = 0.1, value_parser = bin_width, allow_negative_numbers = true)]
    pub(super) time_bin: f64,

    /// Use every Nth start speed: 1 is the paper's experiment, 13 takes seconds.
    #[arg(long, value_name = "N", default_value_t = 1, allow_negative_numbers = true, value_parser = run::whole(1..=u32::MAX))]
    pub(super) every: u32,

    /// Memory limit of a search, MiB.
    #[arg(long, value_name = "MIB", default_value_t = 64, allow_negative_numbers = true,
          value_parser = run::whole(1..=65_536_u32))]
    pub(super) memory: u32,

    /// Start no search of plan-to-stop after this time, s. The report counts the omitted searches; a check that needs
    /// them is N/A, and the exit code is 1.
    #[arg(long, value_name = "S", default_value_t = 1800.0, value_parser = seconds, allow_negative_numbers = true)]
    pub(super) time_limit: f64,

    /// The result as JSON. `-` prints it on stdout and suppresses the report.
    #[arg(long, value_name = "PATH|-", help_heading = "Outputs", value_parser = run::output("--json", "JSON", &["json"]))]
    pub(super) json: Option<PathBuf>,

    /// The measurement of each method on each instance, as CSV.
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = run::output("--csv", "CSV", &["csv"]))]
    pub(super) csv: Option<PathBuf>,

    /// The paper's three figures as an SVG picture.
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = run::output("--svg", "SVG", &["svg"]))]
    pub(super) svg: Option<PathBuf>,

    /// Print errors only: no report and no progress bar.
    #[arg(long)]
    pub(super) quiet: bool,
}

/// Arguments of `bench spirals`.
#[derive(Debug, ArgGroup)]
pub(super) struct SpiralArgs {
    /// Random seed of the problems.
    #[arg(long, value_name = "N", default_value_t = crate::bench::problems::SEED, allow_negative_numbers = true,
          value_parser = run::whole(0..=u64::MAX))]
    pub(super) seed: u64,

    /// Number of problems.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_PROBLEMS, allow_negative_numbers = true,
          value_parser = run::whole(1..=MAX_PROBLEMS))]
    pub(super) problems: u32,

    /// The result as JSON. `-` prints it on stdout and suppresses the report.
    #[arg(long, value_name = "PATH|-", help_heading = "Outputs", value_parser = run::output("--json", "JSON", &["json"]))]
    pub(super) json: Option<PathBuf>,

    /// The evaluation of each method on each problem, as CSV.
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = run::output("--csv", "CSV", &["csv"]))]
    pub(super) csv: Option<PathBuf>,

    /// The distributions of curvature and bending energy as an SVG picture.
    #[arg(long, value_name = "PATH", help_heading = "Outputs", value_parser = run::output("--svg", "SVG", &["svg"]))]
    pub(super) svg: Option<PathBuf>,

    /// Print errors only: no report and no progress bar.
    #[arg(long)]
    pub(super) quiet: bool,
}

/// The length of a benchmark's road, m.
fn road_length(text: &str) -> Result<f64, String> {
    number_in(text, 0.001..=10_000.0, "expected a length in metres from 0.001 to 10000")
}

/// The length of a benchmark's steps, m.
fn step_length(text: &str) -> Result<f64, String> {
    number_in(text, f64::MIN_POSITIVE..=10_000.0, "expected a length in metres above 0 and at most 10000")
}

/// The width of a benchmark's time bins, s. Narrower ones fill any memory before the first stop is found.
fn bin_width(text: &str) -> Result<f64, String> {
    number_in(text, 0.001..=10.0, "expected a time in seconds from 0.001 to 10")
}

fn number_in(text: &str, range: std::ops::RangeInclusive<f64>, expected: &str) -> Result<f64, String> {
    text.parse().ok().filter(|x| range.contains(x)).ok_or_else(|| expected.to_owned())
}

/// A time that is a number and not negative, s.
fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds >= 0.0 => Ok(seconds),
        _ => Err("expected a time in seconds of at least 0".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_arguments_are_consistent() {
        Args::command().debug_assert();
    }
}
