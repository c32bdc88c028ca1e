//! Named checks over what happened, derived from the log and the scenario alone.

/// One named check.
#[derive(Debug, Clone, PartialEq)]
pub struct Check {
    /// Stable name, e.g. `no_contact`.
    pub name: &'static str,
    /// Whether it held.
    pub pass: bool,
    /// The worst value met.
    pub value: f64,
    /// The limit it is held against.
    pub limit: f64,
    /// Unit of both.
    pub unit: &'static str,
    /// Time of the worst moment, s, when there is one.
    pub at_time: Option<f64>,
    /// What was measured and how, one line.
    pub note: String,
}

/// All checks of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Verdict {
    /// The checks, in a fixed order.
    pub checks: Vec<Check>,
}

impl Verdict {
    /// Whether every check held.
    #[must_use]
    pub fn pass(&self) -> bool {
        self.checks.iter().all(|c| c.pass)
    }

    /// The first check that did not hold.
    pub fn first_failure(&self) -> Option<&Check> {
        self.failures().next()
    }

    /// Every check that did not hold.
    pub fn failures(&self) -> impl Iterator<Item = &Check> {
        self.checks.iter().filter(|c| !c.pass)
    }
}
