//! Metrics of an earlier run, as JSON with sorted keys: a diff of the file shows what a change of the program changed.

use std::collections::BTreeMap;
use std::path::Path;

use super::SuiteError;
use crate::io::files;

const FORMAT: &str = "stopline.baseline/2";

/// Largest file, bytes: a hundred thousand drives with thirty metrics each.
const MAX_BYTES: u64 = 256 << 20;

/// The baseline of a suite.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Baseline {
    format: String,
    /// Results by the id of the drive.
    pub(super) drives: BTreeMap<String, BaselineDrive>,
}

/// The baseline of a drive.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BaselineDrive {
    pub(super) outcome: String,
    /// The metrics with a tolerance. Null: the drive has no value, e.g. no stop error because it did not stop.
    pub(super) metrics: BTreeMap<String, Option<f64>>,
}

impl Baseline {
    pub(super) fn new(drives: BTreeMap<String, BaselineDrive>) -> Self {
        Self { format: FORMAT.into(), drives }
    }

    /// Reads a baseline. A corrupt file is an error, also if a missing one is not: updating it would lose the results of
    /// drives that do not run.
    pub(super) fn read(file: &Path, may_be_missing: bool) -> Result<Self, SuiteError> {
        #[derive(serde::Deserialize)]
        struct Header {
            format: String,
        }
        if may_be_missing && !file.exists() {
            return Ok(Self::default());
        }
        let wrong = |message: String| SuiteError::Baseline { file: file.to_owned(), message };
        let not_a_baseline = |e: serde_json::Error| wrong(format!("not a baseline: {e}"));
        if !file.exists() {
            return Err(wrong("does not exist; `--update-baseline` creates it".into()));
        }
        let bytes = files::read(file, MAX_BYTES)?;
        let Header { format } = serde_json::from_slice(&bytes).map_err(not_a_baseline)?;
        if format != FORMAT {
            let advice = "remove the file and create a new one with `--update-baseline`";
            return Err(wrong(format!("its format is `{format}`, expected `{FORMAT}`: {advice}")));
        }
        serde_json::from_slice(&bytes).map_err(not_a_baseline)
    }

    /// Writes the baseline atomically. A file with the same content stays untouched.
    pub(super) fn write(&self, file: &Path) -> Result<(), SuiteError> {
        let value = serde_json::to_value(self).map_err(|e| SuiteError::Fault(e.to_string()))?;
        let text = crate::result::json::text(&value);
        if files::read(file, MAX_BYTES).is_ok_and(|content| content == text.as_bytes()) {
            return Ok(());
        }
        Ok(files::write_atomic(file, text.as_bytes())?)
    }
}
