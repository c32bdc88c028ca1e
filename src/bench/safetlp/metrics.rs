//! Metrics and checks of `stopline bench safetlp`, by method and by limit set.

use super::super::{Check, quantile};
use super::{Comparison, LIMIT_SETS, Measurement, Method, TIME_LIMIT};
use crate::verdict::Status;

/// Minimum ratio of the median expansions of plan-to-stop to those of SafeTLP.
const MIN_EXPANSION_RATIO: f64 = 1000.0;
/// Memory limit of every search, bytes.
const MAX_MEMORY: f64 = (64 << 20) as f64;

/// The measurements of one method on one limit set or on all.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// The method.
    pub method: Method,
    /// Index in [`LIMIT_SETS`]; `None` for all.
    pub set: Option<usize>,
    /// One measurement per instance.
    pub measurements: Vec<Measurement>,
}

/// Aggregated metrics of a group.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Number of instances.
    pub instances: usize,
    /// Number of plans that passed the independent proof.
    pub proven: usize,
    /// Median number of expansions; NaN without a search.
    pub expansions: f64,
    /// Median time, s; NaN without a search.
    pub time: f64,
    /// Mean of the average speeds of the plans, m/s; NaN without a plan.
    pub average_speed: f64,
    /// Peak memory of all searches, bytes.
    pub bytes: usize,
}

impl Group {
    /// Sorted values of the instances that were searched.
    #[must_use]
    pub fn sorted(&self, value: impl Fn(&Measurement) -> Option<f64>) -> Vec<f64> {
        let searched = self.measurements.iter().filter(|m| m.ended != TIME_LIMIT);
        let mut values: Vec<f64> = searched.filter_map(value).filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        values
    }

    /// Aggregated metrics.
    #[must_use]
    pub fn summary(&self) -> Summary {
        let speeds = self.sorted(|m| m.plan.map(|p| p.average_speed));
        Summary {
            instances: self.measurements.len(),
            proven: self.measurements.iter().filter(|m| m.plan.is_some_and(|p| p.proved_again)).count(),
            expansions: median(&self.sorted(|m| Some(m.expansions as f64))),
            time: median(&self.sorted(|m| Some(m.time))),
            average_speed: speeds.iter().sum::<f64>() / speeds.len() as f64,
            bytes: self.measurements.iter().map(|m| m.bytes).max().unwrap_or(0),
        }
    }
}

/// Median of sorted values; NaN for an empty slice.
fn median(sorted: &[f64]) -> f64 {
    if sorted.is_empty() { f64::NAN } else { quantile(sorted, 0.5) }
}

impl Comparison {
    /// Highest start speed, m/s.
    #[must_use]
    pub fn fastest_start(&self) -> f64 {
        self.instances.iter().map(|i| i.start_speed).fold(0.0, f64::max)
    }

    /// The measurements of a method on one limit set, or on all.
    #[must_use]
    pub fn group(&self, method: Method, set: Option<usize>) -> Group {
        let place = Method::ALL.iter().position(|m| *m == method);
        let measured = place.and_then(|p| self.measurements.get(p)).into_iter().flatten();
        let chosen = measured.zip(&self.instances).filter(|(_, i)| set.is_none_or(|s| s == i.set));
        Group { method, set, measurements: chosen.map(|(m, _)| *m).collect() }
    }

    /// The claims of the paper and the memory limit, as checks.
    #[must_use]
    pub fn checks(&self) -> Vec<Check> {
        let summary = |method, set| self.group(method, set).summary();
        let (safe_tlp, plan_to_stop) = (summary(Method::SafeTlp, None), summary(Method::PlanToStop, None));
        let share = safe_tlp.proven as f64 / safe_tlp.instances.max(1) as f64;
        let ratio = plan_to_stop.expansions / safe_tlp.expansions;
        let gains = (0..LIMIT_SETS.len()).map(|set| {
            summary(Method::SafeTlp, Some(set)).average_speed - summary(Method::PlanToStop, Some(set)).average_speed
        });
        let least_gain =
            gains.fold(f64::INFINITY, |least, gain| if gain < least || gain.is_nan() { gain } else { least });
        let memory = Method::ALL.iter().map(|m| summary(*m, None).bytes).max().unwrap_or(0) as f64;
        let check = |name, pass, value: f64, limit, unit| {
            // no value: plan-to-stop was omitted after the time limit, or found no plan
            let status = if value.is_nan() { Status::NotApplicable } else { Status::of(pass) };
            Check { name, status, value, limit, unit }
        };
        vec![
            check("all_proven", share >= 1.0, share, 1.0, "share"),
            check("expansion_ratio", ratio >= MIN_EXPANSION_RATIO, ratio, MIN_EXPANSION_RATIO, "plan-to-stop/SafeTLP"),
            check("average_speed", least_gain >= 0.0, least_gain, 0.0, "m/s gained, worst set"),
            check("memory", memory <= MAX_MEMORY, memory, MAX_MEMORY, "B"),
        ]
    }
}
