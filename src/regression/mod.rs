//! Regression suites: many drives, what is expected of each, and reports that CI systems read.
//!
//! A [`Suite`] is a TOML file (`suite` has the reader, `docs/suites.md` the format). [`Suite::run`] drives it on all
//! cores and compares every drive with its expected outcome, its checks, limits on its figures, and a baseline kept
//! from earlier runs with a tolerance per figure. The [`Summary`] is the same for every number of jobs, and so are the
//! bytes of every [`report`]: wall-clock times are in none.
//!
//! From a test of another project, which fails with a list of what is wrong, drive by drive:
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
//! Weak where: the whole suite is expanded before it starts, and its results stay in memory until the reports are
//! written (some 10 kB a drive); a baseline is compared figure by figure, each for itself.

mod baseline;
mod compare;
mod expand;
mod glob;
mod replay;
pub mod report;
mod run;
mod state;
mod suite;
mod summary;

use std::path::PathBuf;

pub use compare::{Failure, FailureKind};
pub use replay::{Replay, ReplayError};
pub use run::{Options, Progress, Shard};
pub use suite::Suite;
pub use summary::{DriveError, DriveReport, ErrorKind, Status, SuiteFailed, Summary};

use crate::io::files::{InputError, WriteError};
use crate::io::settings_file::TomlError;

/// Why a suite could not be run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SuiteError {
    /// The suite is not TOML, or has keys or values that are not expected.
    #[error(transparent)]
    Toml(#[from] TomlError),
    /// A file cannot be read.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// What the suite says cannot be done.
    #[error("{}{}: {message}", file.display(), line.map_or_else(String::new, |line| format!(":{line}")))]
    Wrong {
        /// The suite.
        file: PathBuf,
        /// Where its entry begins.
        line: Option<usize>,
        /// What is wrong.
        message: String,
    },
    /// The baseline cannot be used.
    #[error("{}: {message}", file.display())]
    Baseline {
        /// The baseline.
        file: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// The state of an interrupted run cannot be used.
    #[error("{}: {message}", file.display())]
    State {
        /// The state file.
        file: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// The program's own fault.
    #[error("{0}")]
    Fault(String),
}

/// The code of the docs compiles.
#[cfg(doctest)]
#[doc = include_str!("../../docs/suites.md")]
struct Docs;

#[cfg(test)]
mod tests;
