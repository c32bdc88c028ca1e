//! One named check and its status.

use std::fmt;

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
#[derive(Debug, Clone, PartialEq)]
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
    /// The event in one sentence.
    pub note: String,
}

impl Check {
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
