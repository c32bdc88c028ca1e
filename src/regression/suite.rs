//! The suite file: its format and its reader.
//!
//! The reader refuses unknown keys and suggests a similar one; an error names the line. It reads the settings of a suite
//! twice: as [`drive::Settings`](crate::drive::Settings), so that an error names the line, and as a TOML table, because
//! only a table of the given keys can be merged with the defaults.
//!
//! The visitors here are written by hand: an untagged enum of serde would accept the same values, but its errors name
//! neither the line nor the expected form.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use serde::de::{self, Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use toml::Spanned;

use super::SuiteError;
use super::baseline::Baseline;
use super::expand::{self, Case};
use crate::drive::{self, Outcome};
use crate::io::settings_file;

/// The suite of a folder.
const SUITE_OF_FOLDER: &str = "suite.toml";

/// The largest number of repetitions of a drive.
const MAX_REPETITIONS: u32 = 1000;

/// A suite: drives and their expectations. It is read and checked completely, except the scenarios, which are read when
/// they are driven.
#[derive(Debug)]
pub struct Suite {
    /// The key `name`, or the name of the file.
    pub name: String,
    /// The suite file.
    pub file: PathBuf,
    pub(super) cases: Vec<Case>,
    /// The baseline file, if the suite has a baseline.
    pub(super) baseline_file: Option<PathBuf>,
}

impl Suite {
    /// Reads a suite; for a folder, the file `suite.toml` in it.
    ///
    /// # Errors
    /// The suite, a settings file or a vehicle cannot be read or is invalid, or an entry matches no file.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SuiteError> {
        let given = path.as_ref();
        let file = if given.is_dir() { given.join(SUITE_OF_FOLDER) } else { given.to_owned() };
        let text = settings_file::text(&file)?;
        settings_file::parse::<SuiteFile<drive::Settings>>(&file, &text)?;
        let read: SuiteFile<toml::Table> = settings_file::parse(&file, &text)?;
        let stem = || file.file_stem().map_or_else(|| "suite".into(), |s| s.to_string_lossy().into_owned());
        let name = read.name.clone().unwrap_or_else(stem);
        let baseline_file = read.baseline.as_ref().map(|relative| folder_of(&file).join(relative));
        let cases = expand::cases(&file, &text, read)?;
        if let (Some(case), None) = (cases.iter().find(|c| !c.expected.tolerances.is_empty()), &baseline_file) {
            let message = format!("`{}` has tolerances, but the suite has no `baseline`", case.id);
            return Err(SuiteError::Wrong { file, line: None, message });
        }
        Ok(Self { name, file, cases, baseline_file })
    }

    /// The baseline file, if the suite has a baseline.
    #[must_use]
    pub fn baseline_file(&self) -> Option<&Path> {
        self.baseline_file.as_deref()
    }

    /// The ids of the drives, in the order of the report.
    pub fn ids(&self) -> impl Iterator<Item = &str> {
        self.cases.iter().map(|c| c.id.as_str())
    }

    /// The stored baseline; empty if the suite has none.
    pub(super) fn baseline(&self, may_be_missing: bool) -> Result<Baseline, SuiteError> {
        self.baseline_file.as_deref().map_or_else(|| Ok(Baseline::default()), |f| Baseline::read(f, may_be_missing))
    }

    /// All files that the suite and its drives read. No report may replace one of them.
    #[must_use]
    pub fn inputs(&self) -> Vec<PathBuf> {
        let mut inputs = vec![self.file.clone()];
        inputs.extend(self.baseline_file.clone());
        for case in &self.cases {
            inputs.push(case.scenario.clone());
            inputs.extend(case.config_file.clone());
            inputs.extend(crate::vehicle::files_of(&case.vehicle_name));
        }
        inputs.sort();
        inputs.dedup();
        inputs
    }
}

/// The folder to which paths in a file are relative.
pub(super) fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The content of a suite file; `S` is the type of settings.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SuiteFile<S> {
    name: Option<String>,
    baseline: Option<PathBuf>,
    pub(super) defaults: Option<Spanned<Entry<S>>>,
    pub(super) drive: Vec<Spanned<Entry<S>>>,
}

/// A `[[drive]]`, or the `[defaults]` of all drives.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Entry<S> {
    pub(super) name: Option<String>,
    pub(super) scenarios: Option<OneOrMore<String>>,
    pub(super) exclude: Option<OneOrMore<String>>,
    pub(super) problem: Option<i64>,
    pub(super) vehicle: Option<OneOrMore<String>>,
    pub(super) config: Option<PathBuf>,
    pub(super) settings: Option<S>,
    pub(super) matrix: Option<BTreeMap<String, Vec<toml::Value>>>,
    pub(super) seeds: Option<Vec<u64>>,
    pub(super) repetitions: Option<Repetitions>,
    pub(super) expect: Option<OneOrMore<Expect>>,
    pub(super) checks: Option<Vec<String>>,
    pub(super) expected_failure: Option<String>,
    pub(super) limits: Option<BTreeMap<String, Bound>>,
    pub(super) tolerances: Option<BTreeMap<String, Tolerance>>,
}

/// A text or a non-empty list of texts.
#[derive(Debug, Clone)]
pub(super) struct OneOrMore<T>(pub(super) Vec<T>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for OneOrMore<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Values<T>(std::marker::PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Values<T> {
            type Value = OneOrMore<T>;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a text or a list of texts")
            }
            fn visit_str<E: de::Error>(self, text: &str) -> Result<OneOrMore<T>, E> {
                T::deserialize(de::value::StrDeserializer::new(text)).map(|one| OneOrMore(vec![one]))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<OneOrMore<T>, A::Error> {
                let mut all = Vec::new();
                while let Some(item) = items.next_element()? {
                    all.push(item);
                }
                if all.is_empty() {
                    return Err(de::Error::invalid_length(0, &"at least one"));
                }
                Ok(OneOrMore(all))
            }
        }
        deserializer.deserialize_any(Values(std::marker::PhantomData))
    }
}

/// How often a drive is repeated to compare hashes.
#[derive(Debug, Clone, Copy, serde::Deserialize)]
#[serde(try_from = "i64")]
pub(super) struct Repetitions(pub(super) u32);

impl TryFrom<i64> for Repetitions {
    type Error = String;
    fn try_from(count: i64) -> Result<Self, String> {
        let fits = u32::try_from(count).ok().filter(|n| (1..=MAX_REPETITIONS).contains(n));
        fits.map(Self).ok_or_else(|| format!("{count} repetitions, expected 1 to {MAX_REPETITIONS}"))
    }
}

/// An expected outcome of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Expect {
    GoalReached,
    AlreadyAtGoal,
    StoppedSafely,
    NoSafePlan,
    Collision,
    TimedOut,
}

impl Expect {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::GoalReached => Outcome::GoalReached.name(),
            Self::AlreadyAtGoal => "already_at_goal",
            Self::StoppedSafely => Outcome::StoppedSafely.name(),
            Self::NoSafePlan => Outcome::NoSafePlan.name(),
            Self::Collision => Outcome::Collision.name(),
            Self::TimedOut => Outcome::TimedOut.name(),
        }
    }
}

/// The range of a metric: a number is the maximum, `{ min = …, max = … }` has both ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bound {
    pub(super) min: Option<f64>,
    pub(super) max: Option<f64>,
}

/// The accepted difference from the baseline: `absolute + relative · |baseline|`. A number is absolute.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tolerance {
    pub(super) absolute: f64,
    pub(super) relative: f64,
}

impl Tolerance {
    pub(super) fn around(&self, baseline: f64) -> f64 {
        self.absolute + self.relative * baseline.abs()
    }
}

/// A number, or a table of two optional numbers with these keys.
struct NumberOr {
    keys: &'static [&'static str; 2],
    expected: &'static str,
}

/// A number, or the values of the two keys.
enum Read {
    Number(f64),
    Table([Option<f64>; 2]),
}

impl<'de> Visitor<'de> for NumberOr {
    type Value = Read;
    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.expected)
    }
    fn visit_f64<E: de::Error>(self, number: f64) -> Result<Read, E> {
        if number.is_nan() {
            Err(E::custom(format!("nan, expected {}", self.expected)))
        } else {
            Ok(Read::Number(number))
        }
    }
    fn visit_i64<E: de::Error>(self, number: i64) -> Result<Read, E> {
        #[allow(clippy::cast_precision_loss)] // counts
        self.visit_f64(number as f64)
    }
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Read, A::Error> {
        let mut values = [None, None];
        while let Some(key) = map.next_key::<String>()? {
            let index = self.keys.iter().position(|k| *k == key);
            let index = index.ok_or_else(|| de::Error::unknown_field(&key, self.keys))?;
            let value: f64 = map.next_value()?;
            if value.is_nan() {
                return Err(de::Error::custom(format!("`{key}` is nan, expected a number")));
            }
            values[index] = Some(value);
        }
        Ok(Read::Table(values))
    }
}

impl<'de> Deserialize<'de> for Bound {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let expected = "a number (the maximum), or a table with `min`, `max` or both";
        match deserializer.deserialize_any(NumberOr { keys: &["min", "max"], expected })? {
            Read::Number(max) => Ok(Self { min: None, max: Some(max) }),
            Read::Table([None, None]) => Err(de::Error::custom(format!("an empty table, expected {expected}"))),
            Read::Table([Some(min), Some(max)]) if min > max => {
                Err(de::Error::custom(format!("`min` {min} is above `max` {max}")))
            }
            Read::Table([min, max]) => Ok(Self { min, max }),
        }
    }
}

impl<'de> Deserialize<'de> for Tolerance {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let expected = "a number (absolute), or a table with `absolute`, `relative` or both";
        let read = deserializer.deserialize_any(NumberOr { keys: &["absolute", "relative"], expected })?;
        let (absolute, relative) = match read {
            Read::Number(absolute) => (absolute, 0.0),
            Read::Table(values) => (values[0].unwrap_or(0.0), values[1].unwrap_or(0.0)),
        };
        if absolute < 0.0 || relative < 0.0 {
            return Err(de::Error::custom("a tolerance below zero, expected zero or more"));
        }
        Ok(Self { absolute, relative })
    }
}
