//! A drive of a suite once more, to look at it, and to see whether it comes to the same.

use std::path::Path;

use serde_json::Value;

use super::expand::Case;
use super::run::{command, key};
use super::{DriveError, Suite, report};
use crate::drive::{Run, Settings};
use crate::io::files;
use crate::io::settings_file;
use crate::result::RunResult;

/// Largest report that is read, bytes.
const MAX_BYTES: u64 = 1 << 30;

/// Why a drive cannot be replayed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplayError {
    /// The suite has no such drive.
    #[error("no drive `{id}`{}", near.as_ref().map_or_else(String::new, |near| format!(": did you mean `{near}`?")))]
    Unknown {
        /// What was asked for.
        id: String,
        /// The nearest.
        near: Option<String>,
    },
    /// The report is not one, or does not have the drive.
    #[error("{message}")]
    Report {
        /// What is wrong, with the file.
        message: String,
    },
    /// The drive cannot be made.
    #[error(transparent)]
    Drive(#[from] DriveError),
}

/// A drive to be replayed.
#[derive(Debug)]
pub struct Replay<'a> {
    case: &'a Case,
    settings: Option<(Settings, String)>,
    /// What the report says: hash of the inputs, hash of the drive.
    reported: Option<(String, String)>,
}

impl Suite {
    /// The drive with that id, as the suite has it.
    ///
    /// # Errors
    /// There is none.
    pub fn replay(&self, id: &str) -> Result<Replay<'_>, ReplayError> {
        let case = self.cases.iter().find(|c| c.id == id);
        let near = || settings_file::nearest(id, self.ids()).map(str::to_owned);
        let case = case.ok_or_else(|| ReplayError::Unknown { id: id.to_owned(), near: near() })?;
        Ok(Replay { case, settings: None, reported: None })
    }
}

impl Replay<'_> {
    /// With the settings that a JSON report has for it, and to be compared with what the report says.
    ///
    /// # Errors
    /// The file is no such report, or does not have the drive.
    pub fn as_reported(mut self, file: &Path) -> Result<Self, ReplayError> {
        let wrong =
            |message: &dyn std::fmt::Display| ReplayError::Report { message: format!("{}: {message}", file.display()) };
        let bytes = files::read(file, MAX_BYTES).map_err(|e| ReplayError::Report { message: e.to_string() })?;
        let told: Value = serde_json::from_slice(&bytes).map_err(|e| wrong(&e))?;
        if told["format"] != report::FORMAT {
            return Err(wrong(&format_args!("not a report of `stopline check --json`")));
        }
        let drives = told["suites"].as_array().into_iter().flatten().filter_map(|s| s["drives"].as_array()).flatten();
        let mut drives = drives.filter(|d| d["id"] == self.case.id.as_str());
        let drive = drives.next().ok_or_else(|| wrong(&format_args!("has no drive `{}`", self.case.id)))?;
        let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        let config = text(&told["configs"][drive["config"].as_str().unwrap_or_default()]);
        let settings: Settings = settings_file::parse(file, &config).map_err(|e| wrong(&e))?;
        settings.validate().map_err(|e| wrong(&e))?;
        self.reported = Some((text(&drive["inputs"]), text(&drive["result"]["hash"])));
        self.settings = Some((settings, config));
        Ok(self)
    }

    /// Every setting, as TOML that `--config` takes.
    #[must_use]
    pub fn config(&self) -> &str {
        self.settings.as_ref().map_or(&self.case.config, |(_, config)| config)
    }

    /// The command that makes this drive, its settings in a file of that name.
    #[must_use]
    pub fn command(&self, config: &Path) -> String {
        let case = self.case;
        command(&case.scenario, &case.vehicle_name, case.problem, config, case.seed)
    }

    /// The hash that the report has, if it has one.
    #[must_use]
    pub fn reported_hash(&self) -> Option<&str> {
        self.reported.as_ref().map(|(_, hash)| hash.as_str()).filter(|hash| !hash.is_empty())
    }

    /// Whether program version, scenario, vehicle, settings and seed are those of the report; true without a report.
    ///
    /// # Errors
    /// The scenario cannot be read.
    pub fn has_reported_inputs(&self) -> Result<bool, ReplayError> {
        let now = key(self.case, self.config())?;
        Ok(self.reported.as_ref().is_none_or(|(inputs, _)| *inputs == now))
    }

    /// Drives it and shows the run.
    ///
    /// # Errors
    /// The scenario cannot be read.
    pub fn drive<T>(&self, show: impl FnOnce(&Run, RunResult) -> T) -> Result<T, ReplayError> {
        let settings = self.settings.as_ref().map_or(&*self.case.settings, |(settings, _)| settings);
        Ok(self.case.with_run(settings, show)?)
    }
}
