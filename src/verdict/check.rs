//! One named check and its status.

use std::fmt;

use super::Impact;

/// Status of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The value is within its limit.
    Pass,
    /// The value is beyond its limit.
    Fail,
    /// The check does not apply to this run; its note says why.
    NotApplicable,
}

impl Status {
    /// [`Status::Pass`] if the condition is met, [`Status::Fail`] if not.
    #[must_use]
    pub fn of(condition: bool) -> Self {
        if condition { Self::Pass } else { Self::Fail }
    }

    /// The stable name in JSON: `pass`, `fail`, `not_applicable`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "fail",
            Self::NotApplicable => "not_applicable",
        }
    }
}

/// PASS, FAIL or N/A; padding and alignment of the format apply.
impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Pass => "PASS",
            Self::Fail => "FAIL",
            Self::NotApplicable => "N/A",
        })
    }
}

/// One named check.
///
/// Two checks are equal if all their fields are equal; NaN equals NaN.
#[derive(Debug, Clone)]
pub struct Check {
    /// Stable name, e.g. `no_contact`.
    pub name: &'static str,
    /// Whether it passed.
    pub status: Status,
    /// The worst value; NaN if the check does not apply.
    pub value: f64,
    /// Its limit; NaN if the check does not apply.
    pub limit: f64,
    /// Unit of both.
    pub unit: &'static str,
    /// Time of the worst moment, s, when there is one.
    pub at_time: Option<f64>,
    /// Who ran into whom, for a contact in `no_contact` and `fallback_stops`.
    pub impact: Option<Impact>,
    /// The event in one sentence: what happened, when, and the limit.
    pub note: String,
    /// How the value is measured; empty if the check does not apply.
    pub method: String,
}

impl PartialEq for Check {
    fn eq(&self, other: &Self) -> bool {
        let bits = |c: &Self| (c.value.to_bits(), c.limit.to_bits(), c.at_time.map(f64::to_bits));
        let text = |c: &Self| (c.name, c.status, c.unit, c.impact);
        bits(self) == bits(other) && text(self) == text(other) && self.note == other.note && self.method == other.method
    }
}

impl Check {
    /// A check that does not apply. `why` completes the sentence "not applicable: …".
    pub(super) fn not_applicable(name: &'static str, unit: &'static str, why: &str) -> Self {
        Self {
            name,
            status: Status::NotApplicable,
            value: f64::NAN,
            limit: f64::NAN,
            unit,
            at_time: None,
            impact: None,
            note: format!("not applicable: {why}"),
            method: String::new(),
        }
    }

    /// Whether the status is [`Status::Pass`].
    #[must_use]
    pub fn passed(&self) -> bool {
        self.status == Status::Pass
    }

    /// Whether the status is [`Status::Fail`].
    #[must_use]
    pub fn failed(&self) -> bool {
        self.status == Status::Fail
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_check_that_does_not_apply_equals_itself_and_neither_passes_nor_fails() {
        let check = Check::not_applicable("goal", "conditions", "the planning problem has no goal");
        assert_eq!(check, check.clone());
        assert!(!check.passed() && !check.failed() && check.value.is_nan() && check.limit.is_nan());
        assert_eq!(check.note, "not applicable: the planning problem has no goal");
        assert_ne!(check, Check { value: 0.0, ..check.clone() });
    }
}
