//! Replays one drive of a suite, to look at it and to verify that its result is reproducible.

use std::path::Path;

use serde_json::Value;

use super::expand::Case;
use super::run::{command, key};
use super::{DriveError, Suite, report};
use crate::drive::{Run, Settings};
use crate::io::files;
use crate::io::settings_file::{self, nearest};
use crate::result::RunResult;

/// Largest report, bytes.
const MAX_BYTES: u64 = 1 << 30;

/// The largest number of suggestions for an unknown id.
const MAX_SUGGESTIONS: usize = 3;

/// Why a drive cannot be replayed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplayError {
    /// The suite has no such drive.
    #[error("no drive `{id}`{}", suggested(suggestions))]
    Unknown {
        /// The unknown id.
        id: String,
        /// Ids that may be meant.
        suggestions: Vec<String>,
    },
    /// The report is invalid or does not contain the drive.
    #[error("{message}")]
    Report {
        /// The reason, with the file.
        message: String,
    },
    /// The drive could not run.
    #[error(transparent)]
    Drive(#[from] DriveError),
}

fn suggested(ids: &[String]) -> String {
    let quoted: Vec<String> = ids.iter().map(|id| format!("`{id}`")).collect();
    if quoted.is_empty() { String::new() } else { format!("; did you mean {}?", quoted.join(" or ")) }
}

/// A drive to replay.
#[derive(Debug)]
pub struct Replay<'a> {
    case: &'a Case,
    settings: Option<(Settings, String)>,
    reported: Option<Reported>,
}

/// The hashes in a report.
#[derive(Debug)]
struct Reported {
    inputs: String,
    result: String,
}

impl Suite {
    /// The drive with that id, with the settings of the suite.
    ///
    /// # Errors
    /// The suite has no such drive.
    pub fn replay(&self, id: &str) -> Result<Replay<'_>, ReplayError> {
        Replay::find(std::slice::from_ref(self), id)
    }
}

/// Ids that may be meant: the nearest one, those that contain the text, or those of the scenario with the nearest name.
fn suggestions(text: &str, ids: &[&str]) -> Vec<String> {
    /// The name of the scenario, without its extension.
    fn scenario(id: &str) -> &str {
        id.split(['.', '@', '#']).next().unwrap_or(id)
    }
    if let Some(near) = nearest(text, ids.iter().copied()) {
        return vec![near.to_owned()];
    }
    let first = |is_meant: &dyn Fn(&str) -> bool| -> Vec<String> {
        ids.iter().filter(|id| is_meant(id)).take(MAX_SUGGESTIONS).map(|id| (*id).to_owned()).collect()
    };
    let containing = first(&|id| !text.is_empty() && id.contains(text));
    match nearest(scenario(text), ids.iter().map(|id| scenario(id))) {
        Some(near) if containing.is_empty() => first(&|id| scenario(id) == near),
        _ => containing,
    }
}

impl<'a> Replay<'a> {
    /// The first drive with that id in any of the suites, with the settings of its suite.
    ///
    /// # Errors
    /// No suite has such a drive.
    pub fn find(suites: &'a [Suite], id: &str) -> Result<Self, ReplayError> {
        let case = suites.iter().flat_map(|suite| &suite.cases).find(|case| case.id == id);
        let suggestions = || suggestions(id, &suites.iter().flat_map(Suite::ids).collect::<Vec<_>>());
        let case = case.ok_or_else(|| ReplayError::Unknown { id: id.to_owned(), suggestions: suggestions() })?;
        Ok(Self { case, settings: None, reported: None })
    }

    /// Takes the settings of the drive from a JSON report, to compare the result with that of the report.
    ///
    /// # Errors
    /// The file is not a report or does not contain the drive.
    pub fn as_reported(mut self, file: &Path) -> Result<Self, ReplayError> {
        let wrong =
            |message: &dyn std::fmt::Display| ReplayError::Report { message: format!("{}: {message}", file.display()) };
        let bytes = files::read(file, MAX_BYTES).map_err(|e| ReplayError::Report { message: e.to_string() })?;
        let report: Value = serde_json::from_slice(&bytes).map_err(|e| wrong(&e))?;
        if report["format"] != report::FORMAT {
            return Err(wrong(&format_args!("not a report of `stopline check --json` ({})", report::FORMAT)));
        }
        let drives = report["suites"].as_array().into_iter().flatten().filter_map(|s| s["drives"].as_array()).flatten();
        let mut drives = drives.filter(|d| d["id"] == self.case.id.as_str());
        let drive = drives.next().ok_or_else(|| wrong(&format_args!("has no drive `{}`", self.case.id)))?;
        let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        let config = text(&report["configs"][drive["config"].as_str().unwrap_or_default()]);
        let settings: Settings = settings_file::parse(file, &config).map_err(|e| wrong(&e))?;
        settings.validate().map_err(|e| wrong(&e))?;
        self.reported = Some(Reported { inputs: text(&drive["inputs"]), result: text(&drive["result"]["hash"]) });
        self.settings = Some((settings, config));
        Ok(self)
    }

    /// All settings, as TOML for `--config`.
    #[must_use]
    pub fn config(&self) -> &str {
        self.settings.as_ref().map_or(&self.case.config, |(_, config)| config)
    }

    /// The `stopline drive` command of this drive, with its settings in the file `config`.
    #[must_use]
    pub fn command(&self, config: &Path) -> String {
        let case = self.case;
        command(&case.scenario, &case.vehicle_name, case.problem, config, case.seed)
    }

    /// The hash in the report, if it has one.
    #[must_use]
    pub fn reported_hash(&self) -> Option<&str> {
        self.reported.as_ref().map(|reported| reported.result.as_str()).filter(|hash| !hash.is_empty())
    }

    /// Whether program version, scenario, vehicle, settings and seed equal those of the report; true without a report.
    ///
    /// # Errors
    /// The scenario cannot be read.
    pub fn has_reported_inputs(&self) -> Result<bool, ReplayError> {
        let inputs = key(self.case, self.config())?;
        Ok(self.reported.as_ref().is_none_or(|reported| reported.inputs == inputs))
    }

    /// Drives and passes the run to `show`.
    ///
    /// # Errors
    /// The scenario cannot be read.
    pub fn drive<T>(&self, show: impl FnOnce(&Run, RunResult) -> T) -> Result<T, ReplayError> {
        let settings = self.settings.as_ref().map_or(&*self.case.settings, |(settings, _)| settings);
        Ok(self.case.with_run(settings, show)?)
    }
}
