//! The names that expectations may use: the checks of the verdict, and the metrics of a drive's result. They are known
//! before any drive, so that a misspelt one is an error of the suite.

use std::collections::BTreeSet;
use std::sync::LazyLock;

use super::compare;
use super::suite::Entry;
use crate::drive::{Faults, Outcome, Run, Settings};
use crate::fixtures;
use crate::geometry::Pose;
use crate::io::settings_file::nearest;
use crate::planner::UncertaintyMode;
use crate::result::{Kind, RunResult};
use crate::simulation::Log;
use crate::verdict::{CHECKS, Verdict};

/// The names of all metrics, and of all checks: the value of a check is a metric, too.
pub(super) static METRICS: LazyLock<BTreeSet<String>> = LazyLock::new(|| {
    // the result of an empty run has every key; `robust_cycles` exists only with proofs for uncertain predictions
    let at = Pose::new(0.0, 0.0, 0.0);
    let scenario = fixtures::scenario(fixtures::road(3.5, 100.0), Vec::new());
    let problem = fixtures::problem(at, 0.0, fixtures::goal(at, 1.0, 1.0, 1.0));
    let vehicle = fixtures::vehicle();
    let mut settings = Settings::default();
    settings.planner.uncertainty.mode = UncertaintyMode::Preferred;
    let run = Run {
        scenario: &scenario,
        problem: &problem,
        vehicle: &vehicle,
        cycles: Vec::new(),
        log: Log::default(),
        fallbacks: Vec::new(),
        faults: Faults::default(),
        outcome: Outcome::NoSafePlan,
        reason: None,
        stopping_distance: None,
        verdict: Verdict::default(),
    };
    let result = RunResult::new(Kind::Drive, &run, &settings, 0);
    compare::metrics(&result.json).into_keys().chain(CHECKS.map(str::to_owned)).collect()
});

/// Checks the names in the expectations of an entry.
pub(super) fn validate<S>(entry: &Entry<S>) -> Result<(), String> {
    for name in entry.checks.iter().flatten() {
        if !CHECKS.contains(&name.as_str()) {
            let expected = format!("one of {}", CHECKS.join(", "));
            return Err(unknown(("checks", "check"), name, &expected, CHECKS));
        }
    }
    let limits = entry.limits.iter().flat_map(|l| l.keys()).map(|name| ("limits", name));
    let tolerances = entry.tolerances.iter().flat_map(|t| t.keys()).map(|name| ("tolerances", name));
    match limits.chain(tolerances).find(|(_, name)| !METRICS.contains(*name)) {
        Some((key, name)) => {
            let expected = "a check, or a number in `metrics` or `planning` of a drive's JSON";
            Err(unknown((key, "metric"), name, expected, METRICS.iter().map(String::as_str)))
        }
        None => Ok(()),
    }
}

/// The message about a name of a check or a metric (`what`) under a key.
fn unknown<'a>(
    (key, what): (&str, &str),
    name: &str,
    expected: &str,
    known: impl IntoIterator<Item = &'a str>,
) -> String {
    let near = nearest(name, known).map_or_else(String::new, |near| format!("; did you mean `{near}`?"));
    format!("`{key}`: there is no {what} `{name}`, expected {expected}{near}")
}
