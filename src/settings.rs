//! The error of a setting out of its range, and the checks behind it.
//!
//! Each settings type has a method `validate`. A constructor or function that would hang or panic with a wrong value calls
//! it. A type validates the settings that it contains and adds the name of their table to the error.

use std::ops::RangeInclusive;

use crate::number;

/// A setting that is out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("setting `{field}` {}, it must {} {expected}", self.found(), if *is_length { "have" } else { "be" })]
pub struct SettingsError {
    /// Name of the setting, with its table as seen from the settings that were validated.
    pub field: String,
    /// Its value, or the length of a list.
    pub value: f64,
    /// Whether the length of a list is out of its range.
    pub is_length: bool,
    /// Its range.
    pub expected: String,
}

impl SettingsError {
    pub(crate) fn new(field: impl Into<String>, value: f64, expected: impl Into<String>) -> Self {
        Self { field: field.into(), value, is_length: false, expected: expected.into() }
    }

    /// The value as in a sentence.
    fn found(&self) -> String {
        let value = number::exact(self.value);
        if self.is_length { format!("has {value} entries") } else { format!("is {value}") }
    }

    /// The same error as seen from the settings that contain `table`.
    #[must_use]
    pub fn in_table(self, table: &str) -> Self {
        // a remark about the table as a whole begins with a space
        let separator = if self.field.starts_with(' ') { "" } else { "." };
        Self { field: format!("{table}{separator}{}", self.field), ..self }
    }
}

/// Refuses values outside of a range, and NaN. An infinite end is no bound.
pub(crate) fn within(field: &str, value: f64, range: RangeInclusive<f64>, unit: &str) -> Result<(), SettingsError> {
    if range.contains(&value) {
        return Ok(());
    }
    let (least, most) = (number::exact(*range.start()), number::exact(*range.end()));
    let expected =
        if range.end().is_infinite() { format!("at least {least}") } else { format!("from {least} to {most}") };
    Err(SettingsError::new(field, value, format!("{expected} {unit}").trim_end()))
}

/// Refuses zero, negative numbers, and numbers above `most`; infinity always.
pub(crate) fn positive(field: &str, value: f64, most: f64, unit: &str) -> Result<(), SettingsError> {
    if value.is_finite() && value > 0.0 && value <= most {
        return Ok(());
    }
    let bound = if most.is_finite() {
        format!("positive, and at most {} {unit}", number::exact(most))
    } else {
        "positive and finite".into()
    };
    Err(SettingsError::new(field, value, bound.trim_end()))
}

/// Refuses counts outside of a range.
pub(crate) fn count(field: &str, value: usize, range: RangeInclusive<usize>) -> Result<(), SettingsError> {
    if range.contains(&value) {
        return Ok(());
    }
    #[allow(clippy::cast_precision_loss)] // for a message
    let value = value as f64;
    Err(SettingsError::new(field, value, format!("from {} to {}", range.start(), range.end())))
}

/// Refuses lists with too few or too many entries.
pub(crate) fn length<T>(field: &str, list: &[T], range: RangeInclusive<usize>) -> Result<(), SettingsError> {
    count(field, list.len(), range).map_err(|error| SettingsError { is_length: true, ..error })
}

/// Refuses a name that is given twice: one of the values would be ignored.
pub(crate) fn each_once<'a>(names: impl IntoIterator<Item = &'a str>) -> Result<(), String> {
    let mut seen = std::collections::BTreeSet::new();
    let repeated = names.into_iter().find(|name| !seen.insert(*name));
    repeated.map_or(Ok(()), |name| Err(format!("`{name}` is given twice; expected each name once")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_refuse_nan_and_say_what_is_expected() {
        let of = |result: Result<(), SettingsError>| result.unwrap_err().to_string();
        assert_eq!(within("a", 2.0, 0.0..=2.0, "m"), Ok(()));
        assert_eq!(of(within("a", f64::NAN, 0.0..=2.0, "m")), "setting `a` is NaN, it must be from 0 to 2 m");
        assert_eq!(within("a", f64::INFINITY, 0.0..=f64::INFINITY, "m"), Ok(()));
        assert_eq!(of(within("a", -1.0, 0.0..=f64::INFINITY, "m")), "setting `a` is -1, it must be at least 0 m");
        assert_eq!(of(positive("a", 0.0, 1.0, "")), "setting `a` is 0, it must be positive, and at most 1");
        for wrong in [f64::INFINITY, f64::NAN, 0.0] {
            assert!(of(positive("a", wrong, f64::INFINITY, "m")).ends_with("must be positive and finite"));
        }
        assert_eq!(of(count("a", 0, 1..=9)), "setting `a` is 0, it must be from 1 to 9");
    }

    #[test]
    fn tables_precede_the_name() {
        let name = |field: &str| SettingsError::new(field, 0.0, "").in_table("b").in_table("a").field;
        assert_eq!(name("c"), "a.b.c");
        assert_eq!(name(" (edges)"), "a.b (edges)");
    }
}
