//! What a suite came to.

use std::fmt;
use std::path::PathBuf;

use super::compare::{Failure, Figures, figures, number};
use super::run::{Measured, Shard};

/// A suite that was run.
#[derive(Debug, Clone)]
pub struct Summary {
    /// What it is called.
    pub name: String,
    /// Its file.
    pub file: PathBuf,
    /// The part of it that was run; all of it if none.
    pub shard: Option<Shard>,
    /// Its drives, in the suite's order.
    pub drives: Vec<DriveReport>,
    /// What the baseline has of drives that the suite does not have any more; `--bless` takes it out.
    pub stale_in_baseline: Vec<String>,
    /// Time of the wall clock that it took, s. In no report: they have the same bytes for every number of jobs.
    pub seconds: f64,
}

/// A drive of a suite and what is said of it.
#[derive(Debug, Clone)]
pub struct DriveReport {
    /// Its id, unique in the suite.
    pub id: String,
    /// The scenario, as the suite has it.
    pub scenario: String,
    /// The vehicle's name.
    pub vehicle: String,
    /// The seed.
    pub seed: u64,
    /// SHA-256 of everything that decides what it comes to; empty if the scenario cannot be read.
    pub inputs: String,
    /// Every setting it was driven with, as TOML that `--config` takes.
    pub config: String,
    /// How it is counted.
    pub status: Status,
    /// Why it is known to fail.
    pub expected_fail: Option<String>,
    /// What is not as expected.
    pub failures: Vec<Failure>,
    /// Why it could not be driven.
    pub error: Option<DriveError>,
    /// The SVG picture, if one was asked for and it failed.
    pub picture: Option<String>,
    pub(super) measured: Option<Measured>,
}

/// How a drive is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Status {
    /// Everything is as expected.
    Pass,
    /// Something is not.
    Fail,
    /// It is known to fail, and failed.
    ExpectedFail,
    /// It is known to fail, and everything held: the suite is out of date.
    UnexpectedPass,
    /// It could not be driven.
    Error,
}

impl Status {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Pass, Self::Fail, Self::ExpectedFail, Self::UnexpectedPass, Self::Error];

    /// Stable name, as in the reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "fail",
            Self::ExpectedFail => "expected_fail",
            Self::UnexpectedPass => "unexpected_pass",
            Self::Error => "error",
        }
    }

    /// Whether the drive was made and its result is wrong.
    #[must_use]
    pub fn is_failure(self) -> bool {
        matches!(self, Self::Fail | Self::UnexpectedPass)
    }
}

/// Why a drive could not be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct DriveError {
    /// Whose fault it is.
    pub kind: ErrorKind,
    /// What is wrong.
    pub message: String,
}

/// Whose fault an error is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// A file that cannot be read or is wrong.
    Input,
    /// The program's own.
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
    /// How it ended; none if it could not be driven.
    #[must_use]
    pub fn outcome(&self) -> Option<&str> {
        self.measured.as_ref().map(Measured::outcome)
    }

    /// Hash of the drive, equal for equal drives; none if it could not be driven.
    #[must_use]
    pub fn hash(&self) -> Option<&str> {
        self.measured.as_ref().map(Measured::hash)
    }

    /// Its figures by name: metrics, values of checks, counts of planning. None is a figure that the drive has no value
    /// of, e.g. the clearance where there is no obstacle.
    #[must_use]
    pub fn figures(&self) -> std::collections::BTreeMap<String, Option<f64>> {
        self.measured.as_ref().map_or_else(Figures::new, |m| figures(&m.result))
    }

    /// What is wrong with it, a line each; empty if it is counted as a success.
    pub(super) fn complaints(&self) -> Vec<String> {
        match (&self.error, self.status) {
            (Some(error), _) => vec![format!("{} error: {}", error.kind.name(), error.message)],
            (None, Status::Pass | Status::ExpectedFail) => Vec::new(),
            (None, _) => self.failures.iter().map(|f| format!("{}: {}", f.kind.name(), f.message)).collect(),
        }
    }

    /// A figure as text.
    pub(super) fn told(&self, figure: &str) -> String {
        self.figures().get(figure).copied().flatten().map_or_else(|| "–".into(), number)
    }
}

impl Summary {
    /// Drives that are counted so.
    #[must_use]
    pub fn count(&self, status: Status) -> usize {
        self.drives.iter().filter(|d| d.status == status).count()
    }

    /// Whether every drive was made and is as expected.
    #[must_use]
    pub fn is_success(&self) -> bool {
        self.drives.iter().all(|d| matches!(d.status, Status::Pass | Status::ExpectedFail))
    }

    /// For tests: nothing, or an error that lists what is wrong, drive by drive.
    ///
    /// # Errors
    /// A drive failed, passed though it is expected to fail, or could not be made.
    pub fn into_result(self) -> Result<(), SuiteFailed> {
        if self.is_success() { Ok(()) } else { Err(SuiteFailed(Box::new(self))) }
    }

    /// The counts in a line: "12 drives: 11 pass, 1 fail".
    #[must_use]
    pub fn counts(&self) -> String {
        let told = |status: &Status| {
            let count = self.count(*status);
            (count > 0).then(|| format!("{count} {}", status.name().replace('_', " ")))
        };
        let counts: Vec<String> = Status::ALL.iter().filter_map(told).collect();
        let shard = self.shard.map_or_else(String::new, |s| format!(" (shard {s})"));
        let plural = if self.drives.len() == 1 { "" } else { "s" };
        let colon = if counts.is_empty() { "" } else { ": " };
        format!("{} drive{plural}{shard}{colon}{}", self.drives.len(), counts.join(", "))
    }
}

impl fmt::Display for Summary {
    /// Counts, and what is wrong.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(f, "{}: {}", self.name, self.counts())?;
        for drive in self.drives.iter().filter(|d| d.status != Status::Pass) {
            let why = drive.expected_fail.as_ref().map_or_else(String::new, |why| format!(" ({why})"));
            writeln!(f, "\n{}: {}{why}", drive.id, drive.status.name().replace('_', " "))?;
            for complaint in drive.complaints() {
                writeln!(f, "  {}", complaint.replace('\n', "\n  "))?;
            }
        }
        if !self.stale_in_baseline.is_empty() {
            let stale = self.stale_in_baseline.join(", ");
            writeln!(f, "\nin the baseline, but not in the suite: {stale}; `--bless` takes them out")?;
        }
        Ok(())
    }
}

/// A suite that is not as expected. Its text lists the drives with what is wrong, also as `{:?}`, which is what a test
/// prints that returns it.
#[derive(Clone)]
pub struct SuiteFailed(
    /// What it came to.
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
