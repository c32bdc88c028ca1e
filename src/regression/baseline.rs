//! Kept figures of earlier runs, as JSON with sorted keys, so that what a change of the program did is a readable diff.

use std::collections::BTreeMap;
use std::path::Path;

use super::SuiteError;
use crate::io::files;

const FORMAT: &str = "stopline.baseline/2";

/// Largest file, bytes: a hundred thousand drives with thirty figures each.
const MAX_BYTES: u64 = 256 << 20;

/// What is kept of a suite.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Baseline {
    format: String,
    /// By the drive's id.
    pub(super) drives: BTreeMap<String, Kept>,
}

/// What is kept of a drive.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Kept {
    pub(super) outcome: String,
    /// The figures with a tolerance; null is none, e.g. the stop error of a drive that did not stop.
    pub(super) figures: BTreeMap<String, Option<f64>>,
}

impl Baseline {
    pub(super) fn new(drives: BTreeMap<String, Kept>) -> Self {
        Self { format: FORMAT.into(), drives }
    }

    /// Reads a baseline. One that is corrupt is an error even where a missing one is not: what it has of drives that are
    /// not run would be lost.
    pub(super) fn read(file: &Path, may_be_missing: bool) -> Result<Self, SuiteError> {
        if may_be_missing && !file.exists() {
            return Ok(Self::default());
        }
        let wrong = |message: String| SuiteError::Baseline { file: file.to_owned(), message };
        if !file.exists() {
            return Err(wrong("there is none yet; `--bless` writes it".into()));
        }
        let bytes = files::read(file, MAX_BYTES)?;
        let read: Self = serde_json::from_slice(&bytes).map_err(|e| wrong(format!("not a baseline: {e}")))?;
        if read.format != FORMAT {
            return Err(wrong(format!("its format is `{}`, expected `{FORMAT}`", read.format)));
        }
        Ok(read)
    }

    /// Writes it whole, unless the same is there already.
    pub(super) fn write(&self, file: &Path) -> Result<(), SuiteError> {
        let value = serde_json::to_value(self).map_err(|e| SuiteError::Fault(e.to_string()))?;
        let text = crate::result::json::text(&value);
        if files::read(file, MAX_BYTES).is_ok_and(|there| there == text.as_bytes()) {
            return Ok(());
        }
        Ok(files::write_atomic(file, text.as_bytes())?)
    }
}
