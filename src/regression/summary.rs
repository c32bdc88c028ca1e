//! The summary of a suite.

use std::fmt;
use std::path::PathBuf;

use super::compare::{Failure, Metrics, metrics, number};
use super::run::{Measured, Shard};

/// The result of a suite.
#[derive(Debug, Clone)]
pub struct Summary {
    /// The name of the suite.
    pub name: String,
    /// The suite file.
    pub file: PathBuf,
    /// The part of the suite that ran; all of it if none.
    pub shard: Option<Shard>,
    /// The number of drives of the whole suite.
    pub suite_drives: usize,
    /// The finished drives, in the order of the suite.
    pub drives: Vec<DriveReport>,
    /// The number of drives that did not run because the run was cancelled.
    pub not_driven: usize,
    /// Ids in the baseline that the suite does not have; `--update-baseline` removes them.
    pub stale_in_baseline: Vec<String>,
    /// Wall-clock time, s. No report contains it, so that reports do not depend on the number of jobs.
    pub seconds: f64,
}

/// The result of a drive and its comparison with the expectations.
#[derive(Debug, Clone)]
pub struct DriveReport {
    /// The id, unique in the suite.
    pub id: String,
    /// The scenario's path relative to the suite.
    pub scenario: String,
    /// The name of the vehicle.
    pub vehicle: String,
    /// The random seed.
    pub seed: u64,
    /// SHA-256 of all inputs of the drive; empty if the scenario cannot be read.
    pub inputs: String,
    /// All settings of the drive, as TOML for `--config`.
    pub config: String,
    /// The status.
    pub status: Status,
    /// Why the drive is expected to fail, if it is.
    pub expected_failure: Option<String>,
    /// All differences from the expectations.
    pub failures: Vec<Failure>,
    /// Why the drive could not run.
    pub error: Option<DriveError>,
    /// An SVG picture, if requested and the drive failed.
    pub picture: Option<String>,
    pub(super) measured: Option<Measured>,
}

/// Status of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Status {
    /// All expectations are met.
    Pass,
    /// An expectation is not met.
    Fail,
    /// An expected failure (xfail): the drive failed as expected.
    ExpectedFailure,
    /// The drive is expected to fail and passed: the suite is out of date.
    UnexpectedPass,
    /// The drive could not run.
    Error,
}

impl Status {
    /// All statuses.
    pub const ALL: [Self; 5] = [Self::Pass, Self::Fail, Self::ExpectedFailure, Self::UnexpectedPass, Self::Error];

    /// The stable name in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "fail",
            Self::ExpectedFailure => "expected_failure",
            Self::UnexpectedPass => "unexpected_pass",
            Self::Error => "error",
        }
    }

    /// The label in texts.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Pass => "PASS",
            Self::Fail => "FAIL",
            Self::ExpectedFailure => "expected failure",
            Self::UnexpectedPass => "unexpected PASS",
            Self::Error => "ERROR",
        }
    }

    /// Whether the drive ran and does not meet its expectations.
    #[must_use]
    pub fn is_failure(self) -> bool {
        matches!(self, Self::Fail | Self::UnexpectedPass)
    }
}

/// Why a drive could not run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct DriveError {
    /// The cause.
    pub kind: ErrorKind,
    /// The reason.
    pub message: String,
}

/// The cause of an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// A file cannot be read or is invalid.
    Input,
    /// A fault of the program.
    Fault,
}

impl ErrorKind {
    /// Stable name, as in the reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Input => "input",
            Self::Fault => "fault",
        }
    }
}

impl DriveError {
    pub(super) fn input(error: impl fmt::Display) -> Self {
        Self { kind: ErrorKind::Input, message: error.to_string() }
    }
}

impl DriveReport {
    /// The outcome; none if the drive could not run.
    #[must_use]
    pub fn outcome(&self) -> Option<&str> {
        self.measured.as_ref().map(Measured::outcome)
    }

    /// The hash, equal for equal drives; none if the drive could not run.
    #[must_use]
    pub fn hash(&self) -> Option<&str> {
        self.measured.as_ref().map(Measured::hash)
    }

    /// The metrics by name: metrics of the run, values of checks, counts of planning. `None`: the drive has no value, e.g.
    /// no clearance because there is no obstacle.
    #[must_use]
    pub fn metrics(&self) -> std::collections::BTreeMap<String, Option<f64>> {
        self.measured.as_ref().map_or_else(Metrics::new, |m| metrics(&m.result))
    }

    /// The reasons why the drive does not count as a success; empty if it does.
    #[must_use]
    pub fn problems(&self) -> Vec<String> {
        match (&self.error, self.status) {
            (Some(error), _) => vec![format!("{} error: {}", error.kind.name(), error.message)],
            (None, Status::Pass | Status::ExpectedFailure) => Vec::new(),
            (None, _) => self.failures.iter().map(|f| format!("{}: {}", f.kind.name(), f.message)).collect(),
        }
    }

    /// A metric as text.
    pub(super) fn metric(&self, name: &str) -> String {
        self.metrics().get(name).copied().flatten().map_or_else(|| "–".into(), number)
    }
}

impl Summary {
    /// The number of drives with that status.
    #[must_use]
    pub fn count(&self, status: Status) -> usize {
        self.drives.iter().filter(|d| d.status == status).count()
    }

    /// Whether all drives ran and met their expectations.
    #[must_use]
    pub fn is_success(&self) -> bool {
        self.not_driven == 0 && self.drives.iter().all(|d| matches!(d.status, Status::Pass | Status::ExpectedFailure))
    }

    /// For tests: an error that lists all failed drives with their reasons.
    ///
    /// # Errors
    /// A drive failed, passed although it is expected to fail, or did not run.
    pub fn into_result(self) -> Result<(), SuiteFailed> {
        if self.is_success() { Ok(()) } else { Err(SuiteFailed(Box::new(self))) }
    }

    /// A sentence if the shard has no drives. That is a success: the suite has at least one drive, so another shard has it.
    #[must_use]
    pub fn empty_shard(&self) -> Option<String> {
        let shard = self.shard.filter(|_| self.drives.is_empty() && self.not_driven == 0)?;
        let (drives, count) = (self.suite_drives, shard.count);
        let which =
            if drives == 1 { format!("shard 1/{count}") } else { format!("shards 1/{count} to {drives}/{count}") };
        Some(format!("shard {shard} has no drives: the suite has {drives}, in the {which}"))
    }

    /// The counts in a line: "12 drives: 11 PASS, 1 FAIL".
    #[must_use]
    pub fn counts(&self) -> String {
        let count = |status: &Status| Some((self.count(*status), status.label())).filter(|(count, _)| *count > 0);
        let not_driven = Some((self.not_driven, "not driven")).filter(|(count, _)| *count > 0);
        let counts = Status::ALL.iter().filter_map(count).chain(not_driven);
        let counts: Vec<String> = counts.map(|(count, label)| format!("{count} {label}")).collect();
        let total = self.drives.len() + self.not_driven;
        let plural = if total == 1 { "" } else { "s" };
        let shard = self.shard.map_or_else(String::new, |s| format!(" (shard {s})"));
        let colon = if counts.is_empty() { "" } else { ": " };
        format!("{total} drive{plural}{shard}{colon}{}", counts.join(", "))
    }
}

impl fmt::Display for Summary {
    /// The counts, and the drives that did not pass, with their reasons.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(f, "{}: {}", self.name, self.counts())?;
        if let Some(empty) = self.empty_shard() {
            writeln!(f, "\n{empty}")?;
        }
        for drive in self.drives.iter().filter(|d| d.status != Status::Pass) {
            let why = drive.expected_failure.as_ref().map_or_else(String::new, |why| format!(" ({why})"));
            writeln!(f, "\n{}: {}{why}", drive.id, drive.status.label())?;
            for problem in drive.problems() {
                writeln!(f, "  {}", problem.replace('\n', "\n  "))?;
            }
        }
        if !self.stale_in_baseline.is_empty() {
            let stale = self.stale_in_baseline.join(", ");
            writeln!(f, "\nin the baseline, but not in the suite: {stale}; `--update-baseline` removes them")?;
        }
        Ok(())
    }
}

/// A suite with failures. `Display` and `Debug` list the failed drives with their reasons: a test that returns the error
/// prints it with `Debug`.
#[derive(Clone)]
pub struct SuiteFailed(
    /// The result of the suite.
    pub Box<Summary>,
);

impl fmt::Display for SuiteFailed {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

impl fmt::Debug for SuiteFailed {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

impl std::error::Error for SuiteFailed {}
