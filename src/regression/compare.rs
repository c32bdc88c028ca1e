//! Compares a drive with its expectations: outcome, checks, equal repetitions, limits, baseline.
//!
//! A metric is a number of the drive's JSON under its own name: all of `metrics`, the value of every check that applies
//! (`tracking`), all counts of `planning` (`expansions`, `smoothing.firm`). A metric that is null (the clearance of a drive
//! without obstacles) is within every limit. A limit on a metric that the drive does not have (`robust_cycles` without
//! `planner.uncertainty`) is a failure, since it would never fail. So is a limit on a check that does not apply. Misspelt
//! names are errors of the suite ([`super::names`]).

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use super::baseline::BaselineDrive;
use super::expand::{Case, Expected};
use super::run::Measured;
use crate::drive::Outcome;
use crate::io::settings_file::nearest;
use crate::verdict::{self, Status};

/// A difference from the expectations.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// The expectation that is not met.
    pub kind: FailureKind,
    /// The difference, with values and limits.
    pub message: String,
}

/// The expectation that a failure is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum FailureKind {
    /// The outcome is not an expected one.
    Outcome,
    /// A check of the verdict failed, or a required check does not apply.
    Check,
    /// Two repetitions differ.
    Deterministic,
    /// A metric is out of its limits.
    Limit,
    /// A metric or the outcome differs from the baseline.
    Baseline,
    /// The drive has no metric of the name of a limit or a tolerance. An expected failure does not cover it: it would hide
    /// there.
    UnknownName,
    /// The drive is expected to fail and passed.
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

/// Metrics by name. `None`: the drive has no value, e.g. no clearance because there is no obstacle.
pub(super) type Metrics = BTreeMap<String, Option<f64>>;

/// The metrics of a drive's JSON.
pub(super) fn metrics(result: &Map<String, Value>) -> Metrics {
    let mut metrics = Metrics::new();
    for table in ["metrics", "planning"] {
        flatten("", result.get(table).unwrap_or(&Value::Null), &mut metrics);
    }
    for check in checks(result).filter(|check| !is_not_applicable(check)) {
        metrics.insert(name(check).to_owned(), check["value"].as_f64());
    }
    metrics
}

fn flatten(prefix: &str, value: &Value, metrics: &mut Metrics) {
    for (key, value) in value.as_object().into_iter().flatten() {
        let name = format!("{prefix}{key}");
        match value {
            Value::Number(number) => drop(metrics.insert(name, number.as_f64())),
            Value::Null => drop(metrics.insert(name, None)),
            nested => flatten(&format!("{name}."), nested, metrics),
        }
    }
}

fn checks(result: &Map<String, Value>) -> impl Iterator<Item = &Value> {
    result.get("checks").and_then(Value::as_array).into_iter().flatten()
}

fn name(check: &Value) -> &str {
    check["name"].as_str().unwrap_or_default()
}

fn is_not_applicable(check: &Value) -> bool {
    check["status"] == Status::NotApplicable.name()
}

/// The part of a result that the baseline stores.
pub(super) fn baseline_of(case: &Case, measured: &Measured) -> BaselineDrive {
    let mut metrics = metrics(&measured.result);
    metrics.retain(|name, _| case.expected.tolerances.contains_key(name));
    BaselineDrive { outcome: measured.outcome().to_owned(), metrics }
}

/// All differences from the expectations; `baseline` is the entry of the baseline, if the suite has a baseline.
pub(super) fn failures(case: &Case, measured: &Measured, baseline: Option<Option<&BaselineDrive>>) -> Vec<Failure> {
    let expected = &case.expected;
    let metrics = metrics(&measured.result);
    let mut all = Failures { measured, metrics: &metrics, list: Vec::new() };
    all.outcome(expected);
    all.checks(expected);
    all.repetitions();
    all.limits(expected);
    match baseline {
        Some(Some(baseline)) => all.baseline(expected, baseline),
        Some(None) if !expected.tolerances.is_empty() => {
            all.add(FailureKind::Baseline, "the drive is not in the baseline; `--update-baseline` adds it".into());
        }
        _ => {}
    }
    let passes = all.list.iter().all(|f| f.kind == FailureKind::UnknownName);
    if let (Some(why), true) = (&expected.failure, passes) {
        all.add(FailureKind::UnexpectedPass, format!("the drive is expected to fail ({why}), but it passes"));
    }
    all.list
}

struct Failures<'a> {
    measured: &'a Measured,
    metrics: &'a Metrics,
    list: Vec<Failure>,
}

impl Failures<'_> {
    fn add(&mut self, kind: FailureKind, message: String) {
        self.list.push(Failure { kind, message });
    }

    fn outcome(&mut self, expected: &Expected) {
        let (outcome, reason) = (self.measured.outcome(), self.measured.result.get("reason").and_then(Value::as_str));
        let names: Vec<&str> = match expected.outcomes.as_slice() {
            [] => [Outcome::GoalReached, Outcome::StoppedSafely].map(Outcome::name).to_vec(),
            outcomes => outcomes.iter().map(|o| o.name()).collect(),
        };
        if !names.contains(&outcome) {
            let reason = reason.map_or_else(String::new, |r| format!(" ({r})"));
            self.add(FailureKind::Outcome, format!("{outcome}{reason}, expected {}", names.join(" or ")));
        }
    }

    fn checks(&mut self, expected: &Expected) {
        let required = expected.checks.as_deref();
        let is_required = |name: &str| required.is_none_or(|required| required.iter().any(|r| r == name));
        for check in checks(&self.measured.result).filter(|c| c["status"] == Status::Fail.name()) {
            if is_required(name(check)) {
                self.add(FailureKind::Check, failed(check));
            }
        }
        for required in required.into_iter().flatten() {
            let check = checks(&self.measured.result).find(|check| name(check) == required);
            if check.is_none_or(is_not_applicable) {
                let names = checks(&self.measured.result).map(name);
                self.missing(FailureKind::Check, "check", required, names);
            }
        }
    }

    fn repetitions(&mut self) {
        let (first, hashes) = (self.measured.hash(), &self.measured.hashes);
        if let Some((i, hash)) = hashes.iter().enumerate().find(|(_, hash)| *hash != first) {
            let message = format!("repetition {} of {} has hash {hash}, the first has {first}", i + 1, hashes.len());
            self.add(FailureKind::Deterministic, message);
        }
    }

    fn limits(&mut self, expected: &Expected) {
        for (name, bound) in &expected.limits {
            let Some(metric) = self.metrics.get(name) else {
                self.missing_metric(FailureKind::Limit, name);
                continue;
            };
            let Some(value) = metric else { continue };
            for (limit, side, is_beyond) in [
                (bound.max, "at most", bound.max.is_some_and(|max| *value > max)),
                (bound.min, "at least", bound.min.is_some_and(|min| *value < min)),
            ] {
                if let (Some(limit), true) = (limit, is_beyond) {
                    self.add(FailureKind::Limit, format!("{name}: {}, limit {side} {}", number(*value), number(limit)));
                }
            }
        }
    }

    fn baseline(&mut self, expected: &Expected, baseline: &BaselineDrive) {
        let outcome = self.measured.outcome();
        if baseline.outcome != outcome {
            self.add(FailureKind::Baseline, format!("outcome {outcome}, baseline {}", baseline.outcome));
        }
        for (name, tolerance) in &expected.tolerances {
            let Some(value) = self.metrics.get(name) else {
                self.missing_metric(FailureKind::Baseline, name);
                continue;
            };
            let Some(before) = baseline.metrics.get(name) else {
                let message = format!("{name}: not in the baseline; `--update-baseline` adds it");
                self.add(FailureKind::Baseline, message);
                continue;
            };
            let text = |value: Option<f64>| value.map_or_else(|| "none".into(), number);
            let values = format!("{name}: {}, baseline {}", text(*value), text(*before));
            match (value, before) {
                (Some(value), Some(before)) if (value - before).abs() > tolerance.around(*before) => {
                    let (change, most) = (number(value - before), number(tolerance.around(*before)));
                    self.add(FailureKind::Baseline, format!("{values}: changed by {change}, tolerance {most}"));
                }
                (None, Some(_)) | (Some(_), None) => self.add(FailureKind::Baseline, values),
                _ => {}
            }
        }
    }

    fn missing_metric(&mut self, kind: FailureKind, name: &str) {
        let metrics = self.metrics;
        self.missing(kind, "metric", name, metrics.keys().map(String::as_str));
    }

    /// A check that does not apply, or an unknown name.
    fn missing<'n>(&mut self, kind: FailureKind, what: &str, required: &str, known: impl Iterator<Item = &'n str>) {
        let check = checks(&self.measured.result).find(|check| name(check) == required);
        if check.is_some() || verdict::CHECKS.contains(&required) {
            let reason = check.and_then(|check| check["note"].as_str()).filter(|note| !note.is_empty());
            let reason = reason.map_or_else(String::new, |reason| format!(": {reason}"));
            return self.add(kind, format!("{required}: required, but N/A in this drive{reason}"));
        }
        let near = nearest(required, known).map_or_else(String::new, |near| format!("; did you mean `{near}`?"));
        self.add(FailureKind::UnknownName, format!("{required}: this drive has no such {what}{near}"));
    }
}

/// A failed check: the event, then the value and its limit.
fn failed(check: &Value) -> String {
    let number = |key: &str| check[key].as_f64().map_or_else(|| "none".into(), number);
    let unit = check["unit"].as_str().unwrap_or_default();
    let when = check["at_time"].as_f64().map_or_else(String::new, |t| format!(" at {t:.2} s"));
    let note = check["note"].as_str().unwrap_or_default();
    format!("{}: {note} ({} {unit}{when}, limit {})", name(check), number("value"), number("limit"))
}

/// The number with six significant digits, so that values that differ by rounding look the same.
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
