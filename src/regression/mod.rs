//! Regression suites: many drives with expectations, and reports for CI systems.
//!
//! A [`Suite`] is a TOML file (format: `docs/suites.md`). [`Suite::run`] runs its drives on all cores and compares each drive
//! with its expected outcome, its checks, limits on its metrics, and a baseline of an earlier run with a tolerance per
//! metric. The [`Summary`] and the bytes of every [`report`] do not depend on the number of jobs; no report contains
//! wall-clock times.
//!
//! A test of another project fails with a list of all failed drives and their reasons:
//!
//! ```no_run
//! use stopline::regression::{Options, Suite};
//!
//! // #[test]
//! fn drives_as_before() -> Result<(), Box<dyn std::error::Error>> {
//!     let suite = Suite::load("tests/suite.toml")?;
//!     suite.run(&Options::default())?.into_result()?;
//!     Ok(())
//! }
//! ```
//!
//! Limitations: the suite is expanded before it starts, and all results stay in memory until the reports are written
//! (about 10 kB per drive). The baseline is compared metric by metric.

mod baseline;
mod compare;
mod expand;
mod names;
mod pattern;
mod replay;
pub mod report;
mod run;
mod state;
mod suite;
mod summary;

use std::path::PathBuf;

pub use compare::{Failure, FailureKind};
pub use replay::{Replay, ReplayError};
pub use run::{Options, Progress, Shard, shell_command};
pub use suite::Suite;
pub use summary::{DriveError, DriveReport, ErrorKind, Status, SuiteFailed, Summary};

use crate::io::files::{InputError, WriteError};
use crate::io::settings_file::TomlError;

/// Why a suite could not run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SuiteError {
    /// The suite is not TOML, or has unknown keys or invalid values.
    #[error(transparent)]
    Toml(#[from] TomlError),
    /// A file cannot be read.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// An entry of the suite is invalid.
    #[error("{}{}: {message}", file.display(), line.map_or_else(String::new, |line| format!(":{line}")))]
    Wrong {
        /// The suite.
        file: PathBuf,
        /// The line where the entry begins.
        line: Option<usize>,
        /// The reason.
        message: String,
    },
    /// The baseline cannot be used.
    #[error("{}: {message}", file.display())]
    Baseline {
        /// The baseline.
        file: PathBuf,
        /// The reason.
        message: String,
    },
    /// The state of an interrupted run cannot be used.
    #[error("{}: {message}", file.display())]
    State {
        /// The state file.
        file: PathBuf,
        /// The reason.
        message: String,
    },
    /// A fault of the program.
    #[error("{0}")]
    Fault(String),
}

/// Compiles the code in the docs.
#[cfg(doctest)]
#[doc = include_str!("../../docs/suites.md")]
struct Docs;

#[cfg(test)]
mod tests;
