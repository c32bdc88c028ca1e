//! What can be typed.

use std::path::PathBuf;

use clap::{Args as ArgGroup, Parser, Subcommand};

use crate::drive::Faults;
use crate::regression::Shard;
use crate::verdict::ComfortPreset;

/// Shown at the end of `--help`.
const EXIT_CODES: &str = "Exit codes:
  0  it ran and every check held
  1  it ran and a check failed: unsafe, uncomfortable, no plan
  2  wrong use of the command line
  3  an input is unreadable or invalid, or an output cannot be written
  4  a fault of the program itself
  130  `check` was interrupted by Ctrl-C";

/// Problems of a comparison.
const DEFAULT_PROBLEMS: u32 = 2000;
/// Most problems that can be asked for: about ten minutes.
const MAX_PROBLEMS: u32 = 1_000_000;

/// Most threads that can be asked for.
const MAX_THREADS: u16 = 1024;

/// A local planner that never commits to a trajectory it cannot stop from, and a physics rig that checks it.
#[derive(Debug, Parser)]
#[command(name = "stopline", version, after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
pub(super) struct Args {
    #[command(subcommand)]
    pub(super) command: Command,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// One planning cycle from the initial state.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Plan(RunArgs),
    /// Closed loop: replan at 10 Hz, execute in physics, judge.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Drive(RunArgs),
    /// Regression suites: many drives, what is expected of them, reports that CI systems read.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Check(CheckArgs),
    /// Comparisons on problems made from a seed.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Bench(BenchArgs),
}

/// Arguments of `check`.
#[derive(Debug, ArgGroup)]
pub(super) struct CheckArgs {
    /// Suites: TOML files, or folders with a suite.toml.
    #[arg(required = true, value_name = "SUITE")]
    pub(super) suites: Vec<PathBuf>,

    /// Number of parallel drives; the number of cores if not given. The reports do not depend on it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(MAX_THREADS)))]
    pub(super) jobs: Option<u16>,

    /// Run only part I of N: every Nth drive, beginning with the Ith.
    #[arg(long, value_name = "I/N")]
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
    #[arg(long, value_name = "PATH", requires = "replay", help_heading = "Replay")]
    pub(super) svg: Option<PathBuf>,

    /// Write the complete report as JSON; `-` prints it to stdout, and nothing else.
    #[arg(long, value_name = "PATH|-", help_heading = "Outputs")]
    pub(super) json: Option<PathBuf>,

    /// Write the report as JUnit XML.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
    pub(super) junit: Option<PathBuf>,

    /// Write a summary as Markdown.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
    pub(super) markdown: Option<PathBuf>,

    /// Write a page with pictures of failed drives.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
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

/// What to compare.
#[derive(Debug, Subcommand)]
pub(super) enum Comparison {
    /// Smooth paths between lattice ends: spirals, polynomials, the lecture's way.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Spirals(SpiralArgs),
    /// The experiment of the SafeTLP paper: four ways to search a speed, 104 instances. Takes minutes.
    #[command(after_help = EXIT_CODES, after_long_help = EXIT_CODES)]
    Safetlp(SafeTlpArgs),
}

/// Arguments of `bench safetlp`.
#[derive(Debug, ArgGroup)]
pub(super) struct SafeTlpArgs {
    /// Length of the road, m; at most 10 km.
    #[arg(long, value_name = "M", default_value_t = 100.0, value_parser = road_length, allow_negative_numbers = true)]
    pub(super) length: f64,

    /// Length of a step, m. One that does not divide the road is made a little shorter.
    #[arg(long, value_name = "M", default_value_t = 0.5, allow_negative_numbers = true)]
    pub(super) step: f64,

    /// Width of a time bin, s; 1 ms to 10 s.
    #[arg(long, value_name = "S", default_value_t = 0.1, value_parser = bin_width, allow_negative_numbers = true)]
    pub(super) time_bin: f64,

    /// Take every Nth start speed only: 1 is the paper's experiment, 13 ends within seconds.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) every: u32,

    /// Memory that a search may use, MiB.
    #[arg(long, value_name = "MIB", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub(super) memory: u32,

    /// Begin no search of plan-to-stop after this time, s; those left out are told.
    #[arg(long, value_name = "S", default_value_t = 1800.0, value_parser = seconds)]
    pub(super) time_limit: f64,

    /// The result as JSON; `-` prints it on stdout, and nothing else.
    #[arg(long, value_name = "PATH|-", help_heading = "Outputs")]
    pub(super) json: Option<PathBuf>,

    /// What each method made of each instance, as a table.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
    pub(super) csv: Option<PathBuf>,

    /// The paper's three figures as one picture.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
    pub(super) svg: Option<PathBuf>,

    /// No report and no progress bar; errors only.
    #[arg(long)]
    pub(super) quiet: bool,
}

/// Arguments of `bench spirals`.
#[derive(Debug, ArgGroup)]
pub(super) struct SpiralArgs {
    /// Seed of the problems.
    #[arg(long, value_name = "N", default_value_t = crate::bench::problems::SEED)]
    pub(super) seed: u64,

    /// Number of problems.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_PROBLEMS,
          value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_PROBLEMS)))]
    pub(super) problems: u32,

    /// The result as JSON; `-` prints it on stdout, and nothing else.
    #[arg(long, value_name = "PATH|-", help_heading = "Outputs")]
    pub(super) json: Option<PathBuf>,

    /// What each method made of each problem, as a table.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
    pub(super) csv: Option<PathBuf>,

    /// A picture.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
    pub(super) svg: Option<PathBuf>,

    /// No report; errors only.
    #[arg(long)]
    pub(super) quiet: bool,
}

/// Arguments of `plan` and `drive`.
#[derive(Debug, ArgGroup)]
pub(super) struct RunArgs {
    /// Scenario file: CommonRoad XML, 2018b or 2020a.
    pub(super) scenario: PathBuf,

    /// Vehicle: the name of one built in, or a folder with vehicle.urdf and dynamics.toml.
    #[arg(long, value_name = "NAME|FOLDER", default_value = "bmw_320i")]
    pub(super) vehicle: String,

    /// Settings to change, as TOML.
    #[arg(long, value_name = "FILE.toml")]
    pub(super) config: Option<PathBuf>,

    /// Occupancy grid of ROS in the scenario's coordinates: its occupied cells are obstacles, too.
    #[arg(long, value_name = "FILE.yaml")]
    pub(super) grid: Option<PathBuf>,

    /// Whose limits of comfort count: safetlp (the vehicle's own), iso15622, iso11270, r157.
    #[arg(long, value_name = "PRESET")]
    pub(super) comfort: Option<ComfortPreset>,

    /// Drive what is planned to rest in a forked world every so many seconds; `off` for never. Half a second if not given.
    #[arg(long, value_name = "S|off", value_parser = fallback_interval)]
    pub(super) fallbacks: Option<FallbackInterval>,

    /// A fault for the rig that the planner does not know of; repeatable: delay=S, friction=FACTOR, mass=FACTOR, noise=M,
    /// missed_cycles=N.
    #[arg(long, value_name = "NAME=VALUE", value_parser = fault)]
    pub(super) inject: Vec<String>,

    /// Friction of the road: a factor or dry, wet, ice for all of it; or a file of `[[friction]]` tables with a `factor` and a
    /// `polygon` each.
    #[arg(long, value_name = "FACTOR|FILE.toml", allow_negative_numbers = true)]
    pub(super) friction: Option<String>,

    /// Which planning problem of the file; needed if it has several.
    #[arg(long, value_name = "ID", allow_negative_numbers = true)]
    pub(super) problem: Option<i64>,

    /// Seed of what is random: the noise of `--inject noise`. Kept in the result.
    #[arg(long, value_name = "N")]
    pub(super) seed: Option<u64>,

    /// Threads to plan with; all cores if not given. The result does not depend on it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(MAX_THREADS)))]
    pub(super) threads: Option<u16>,

    /// The result as JSON; `-` prints it on stdout, and nothing else.
    #[arg(long, value_name = "PATH|-", help_heading = "Outputs")]
    pub(super) json: Option<PathBuf>,

    /// Every planning cycle of a drive with its candidates, their cost terms and why they were rejected, in the JSON: large.
    #[arg(long, requires = "json", help_heading = "Outputs")]
    pub(super) json_cycles: bool,

    /// The driven samples (for `plan`, the planned ones) as a table.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
    pub(super) csv: Option<PathBuf>,

    /// A CommonRoad solution of the kinematic single-track model.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
    pub(super) solution: Option<PathBuf>,

    /// A picture.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
    pub(super) svg: Option<PathBuf>,

    /// A recording for the Rerun viewer.
    #[arg(long, value_name = "PATH", help_heading = "Outputs")]
    pub(super) rrd: Option<PathBuf>,

    /// No report and no progress bar; errors only.
    #[arg(long)]
    pub(super) quiet: bool,
}

/// The length of a benchmark's road, m.
fn road_length(text: &str) -> Result<f64, String> {
    number_in(text, 0.001..=10_000.0, "a length in metres, 0.001 to 10000")
}

/// The width of a benchmark's time bins, s. Narrower ones fill any memory before the first stop is found.
fn bin_width(text: &str) -> Result<f64, String> {
    number_in(text, 0.001..=10.0, "a time in seconds, 0.001 to 10")
}

fn number_in(text: &str, range: std::ops::RangeInclusive<f64>, expected: &str) -> Result<f64, String> {
    text.parse().ok().filter(|x| range.contains(x)).ok_or_else(|| expected.to_owned())
}

/// How often fallbacks are driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum FallbackInterval {
    Off,
    Seconds(f64),
}

fn fallback_interval(text: &str) -> Result<FallbackInterval, String> {
    if text == "off" { Ok(FallbackInterval::Off) } else { seconds(text).map(FallbackInterval::Seconds) }
}

/// A fault by itself is as it should be; what is injected twice counts as it was last.
fn fault(text: &str) -> Result<String, String> {
    Faults::default().inject(text).map(|()| text.to_owned())
}

/// A time that is a number and not negative, s.
fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds >= 0.0 => Ok(seconds),
        _ => Err("a time in seconds, not negative".into()),
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
