//! What a drive came to against what is expected of it: outcome, checks, equal repetitions, limits, baseline.
//!
//! Figures are the numbers of the drive's JSON under their own names: every one of `metrics`, the value of every check
//! (`tracking`), every count of `planning` (`expansions`, `smoothing.firm`). A figure that the drive has but that is null
//! (no obstacle, no clearance) is within every limit; one that it does not have is a failure, because a limit on a
//! misspelt name would never fail.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use super::baseline::Kept;
use super::expand::{Case, Expected};
use super::run::Measured;
use crate::drive::Outcome;
use crate::io::settings_file::nearest;
use crate::verdict;

/// Something that is not as expected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// Of what kind.
    pub kind: FailureKind,
    /// What, with values and limits, in a line.
    pub message: String,
}

/// What can be other than expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum FailureKind {
    /// It ended otherwise.
    Outcome,
    /// A check of the verdict did not hold, or was not asked.
    Check,
    /// Two repetitions differ.
    Deterministic,
    /// A figure is beyond its limit.
    Limit,
    /// A figure or the outcome is not what is kept.
    Baseline,
    /// A limit, a tolerance or a check of a name that nothing has. No expectation to fail covers it: it would hide there.
    UnknownName,
    /// It is expected to fail and did not.
    UnexpectedPass,
}

impl FailureKind {
    /// Stable name, as in the reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Outcome => "outcome",
            Self::Check => "check",
            Self::Deterministic => "deterministic",
            Self::Limit => "limit",
            Self::Baseline => "baseline",
            Self::UnknownName => "unknown_name",
            Self::UnexpectedPass => "unexpected_pass",
        }
    }
}

pub(super) type Figures = BTreeMap<String, Option<f64>>;

/// The figures of a drive's JSON.
pub(super) fn figures(result: &Map<String, Value>) -> Figures {
    let mut figures = Figures::new();
    for table in ["metrics", "planning"] {
        flatten("", result.get(table).unwrap_or(&Value::Null), &mut figures);
    }
    for check in result.get("checks").and_then(Value::as_array).into_iter().flatten() {
        if let Some(name) = check["name"].as_str().filter(|_| check["status"] != "not_applicable") {
            figures.insert(name.to_owned(), check["value"].as_f64());
        }
    }
    figures
}

fn flatten(prefix: &str, value: &Value, figures: &mut Figures) {
    for (key, value) in value.as_object().into_iter().flatten() {
        let name = format!("{prefix}{key}");
        match value {
            Value::Number(number) => drop(figures.insert(name, number.as_f64())),
            Value::Null => drop(figures.insert(name, None)),
            nested => flatten(&format!("{name}."), nested, figures),
        }
    }
}

/// What of a drive is kept in a baseline.
pub(super) fn kept(case: &Case, measured: &Measured) -> Kept {
    let mut figures = figures(&measured.result);
    figures.retain(|name, _| case.expected.tolerances.contains_key(name));
    Kept { outcome: measured.outcome().to_owned(), figures }
}

/// Everything that is not as expected; `kept` is the baseline's entry if the suite has a baseline.
pub(super) fn failures(case: &Case, measured: &Measured, kept: Option<Option<&Kept>>) -> Vec<Failure> {
    let expected = &case.expected;
    let mut all = Failures(Vec::new());
    all.outcome(expected, measured);
    all.checks(expected, measured);
    all.repetitions(measured);
    let figures = figures(&measured.result);
    all.limits(expected, &figures);
    match kept {
        Some(Some(kept)) => all.baseline(expected, measured, &figures, kept),
        Some(None) if !expected.tolerances.is_empty() => {
            all.add(FailureKind::Baseline, "it is not in the baseline; `--bless` adds it".into());
        }
        _ => {}
    }
    let held = all.0.iter().all(|f| f.kind == FailureKind::UnknownName);
    if let (Some(why), true) = (&expected.fail, held) {
        all.add(FailureKind::UnexpectedPass, format!("it is expected to fail ({why}), and everything held"));
    }
    all.0
}

struct Failures(Vec<Failure>);

impl Failures {
    fn add(&mut self, kind: FailureKind, message: String) {
        self.0.push(Failure { kind, message });
    }

    fn outcome(&mut self, expected: &Expected, measured: &Measured) {
        let (outcome, reason) = (measured.outcome(), measured.result.get("reason").and_then(Value::as_str));
        let right = match expected.outcomes.as_slice() {
            [] => [Outcome::GoalReached, Outcome::StoppedSafely].iter().any(|o| o.name() == outcome),
            outcomes => outcomes.iter().any(|o| o.name() == outcome),
        };
        if !right {
            let reason = reason.map_or_else(String::new, |r| format!(" ({r})"));
            let names: Vec<_> = expected.outcomes.iter().map(|o| o.name()).collect();
            let names = if names.is_empty() { "goal_reached or stopped_safely".into() } else { names.join(" or ") };
            self.add(FailureKind::Outcome, format!("ended as {outcome}{reason}, expected {names}"));
        }
    }

    fn checks(&mut self, expected: &Expected, measured: &Measured) {
        let checks = measured.result.get("checks").and_then(Value::as_array);
        let checks: Vec<&Value> = checks.into_iter().flatten().collect();
        let name = |check: &Value| check["name"].as_str().unwrap_or_default().to_owned();
        for check in checks.iter().filter(|c| c["status"] == "fail") {
            if expected.checks.as_ref().is_none_or(|asked| asked.contains(&name(check))) {
                let number = |key: &str| check[key].as_f64().map_or_else(|| "none".into(), number);
                let unit = check["unit"].as_str().unwrap_or_default();
                let when = check["at_time"].as_f64().map_or_else(String::new, |t| format!(" at {t:.2} s"));
                let note = check["note"].as_str().unwrap_or_default();
                let (value, limit) = (number("value"), number("limit"));
                let message = format!("{}: {value} {unit}, limit {limit}{when}: {note}", name(check));
                self.add(FailureKind::Check, message);
            }
        }
        let names: Vec<String> = checks.iter().filter(|c| c["status"] != "not_applicable").map(|c| name(c)).collect();
        for asked in expected.checks.iter().flatten().filter(|asked| !names.contains(asked)) {
            self.missing(FailureKind::Check, "check", asked, names.iter().map(String::as_str));
        }
    }

    fn repetitions(&mut self, measured: &Measured) {
        let first = measured.hash();
        let other = measured.hashes.iter().enumerate().find(|(_, hash)| *hash != first);
        if let Some((i, hash)) = other {
            let of = measured.hashes.len();
            self.add(
                FailureKind::Deterministic,
                format!("repetition {} of {of} has hash {hash}, the first {first}", i + 1),
            );
        }
    }

    fn limits(&mut self, expected: &Expected, figures: &Figures) {
        for (name, bound) in &expected.limits {
            let Some(figure) = figures.get(name) else {
                self.missing(FailureKind::Limit, "figure", name, figures.keys().map(String::as_str));
                continue;
            };
            let Some(value) = figure else { continue };
            for (limit, side, beyond) in [
                (bound.max, "at most", bound.max.is_some_and(|max| *value > max)),
                (bound.min, "at least", bound.min.is_some_and(|min| *value < min)),
            ] {
                if let (Some(limit), true) = (limit, beyond) {
                    self.add(FailureKind::Limit, format!("{name}: {}, limit {side} {limit}", number(*value)));
                }
            }
        }
    }

    fn baseline(&mut self, expected: &Expected, measured: &Measured, figures: &Figures, kept: &Kept) {
        if kept.outcome != measured.outcome() {
            self.add(FailureKind::Baseline, format!("ended as {}, before as {}", measured.outcome(), kept.outcome));
        }
        for (name, tolerance) in &expected.tolerances {
            let Some(is) = figures.get(name) else {
                self.missing(FailureKind::Baseline, "figure", name, figures.keys().map(String::as_str));
                continue;
            };
            let Some(was) = kept.figures.get(name) else {
                self.add(FailureKind::Baseline, format!("{name}: not in the baseline; `--bless` adds it"));
                continue;
            };
            match (is, was) {
                (Some(is), Some(was)) if (is - was).abs() > tolerance.around(*was) => {
                    let (most, change) = (number(tolerance.around(*was)), number(is - was));
                    let message = format!(
                        "{name}: {}, before {}: changed by {change}, at most {most}",
                        number(*is),
                        number(*was)
                    );
                    self.add(FailureKind::Baseline, message);
                }
                (None, Some(was)) => self.add(FailureKind::Baseline, format!("{name}: none, before {}", number(*was))),
                (Some(is), None) => self.add(FailureKind::Baseline, format!("{name}: {}, before none", number(*is))),
                _ => {}
            }
        }
    }

    fn missing<'a>(&mut self, kind: FailureKind, what: &str, name: &str, known: impl Iterator<Item = &'a str>) {
        if verdict::CHECKS.contains(&name) {
            return self.add(kind, format!("{name}: this drive was not asked for it"));
        }
        let near = nearest(name, known).map_or_else(String::new, |near| format!("; did you mean `{near}`?"));
        self.add(FailureKind::UnknownName, format!("{name}: this drive has no such {what}{near}"));
    }
}

/// Six significant digits: what changed by rounding alone looks the same.
pub(super) fn number(value: f64) -> String {
    if value == 0.0 || (1e-3..1e7).contains(&value.abs()) {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // −3 … 7
        let decimals = (5.0 - value.abs().max(1e-3).log10().floor()).clamp(0.0, 8.0) as usize;
        let text = format!("{value:.decimals$}");
        let trimmed = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        return trimmed.to_owned();
    }
    format!("{value:.5e}")
}
