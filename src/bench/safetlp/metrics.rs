//! What the measurements of `stopline bench safetlp` come to: by method, by method and limit set, and as promises.

use super::super::{Check, quantile};
use super::{Comparison, LIMIT_SETS, Measurement, Method, TIME_LIMIT};

/// How many times fewer expansions SafeTLP must need than plan-to-stop, on the median.
const FEWER: f64 = 1000.0;
/// Memory that no search may exceed, bytes.
const MEMORY: f64 = (64 << 20) as f64;

/// One method on one limit set, or on all.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// The method.
    pub method: Method,
    /// Index in [`LIMIT_SETS`]; `None` for all.
    pub set: Option<usize>,
    /// What it made of the instances.
    pub measurements: Vec<Measurement>,
}

/// A group in a few numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Instances.
    pub instances: usize,
    /// MotionPlanner whose stop was proved again.
    pub proven: usize,
    /// Median of the expansions; not a number where nothing was searched.
    pub expansions: f64,
    /// Median time, s; likewise.
    pub time: f64,
    /// Mean of the average speeds of the plans, m/s; not a number without a plan.
    pub average_speed: f64,
    /// Most memory of a search, bytes.
    pub bytes: usize,
}

impl Group {
    /// A value of every instance that was searched, sorted.
    #[must_use]
    pub fn sorted(&self, value: impl Fn(&Measurement) -> Option<f64>) -> Vec<f64> {
        let searched = self.measurements.iter().filter(|m| m.ended != TIME_LIMIT);
        let mut values: Vec<f64> = searched.filter_map(value).filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        values
    }

    /// The group in a few numbers.
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

/// Not a number of nothing.
fn median(sorted: &[f64]) -> f64 {
    if sorted.is_empty() { f64::NAN } else { quantile(sorted, 0.5) }
}

impl Comparison {
    /// The fastest start, m/s.
    #[must_use]
    pub fn fastest_start(&self) -> f64 {
        self.instances.iter().map(|i| i.start_speed).fold(0.0, f64::max)
    }

    /// One method on one limit set, or on all.
    #[must_use]
    pub fn group(&self, method: Method, set: Option<usize>) -> Group {
        let place = Method::ALL.iter().position(|m| *m == method);
        let measured = place.and_then(|p| self.measurements.get(p)).into_iter().flatten();
        let chosen = measured.zip(&self.instances).filter(|(_, i)| set.is_none_or(|s| s == i.set));
        Group { method, set, measurements: chosen.map(|(m, _)| *m).collect() }
    }

    /// What the paper claims and what we promise.
    #[must_use]
    pub fn checks(&self) -> Vec<Check> {
        let summary = |method, set| self.group(method, set).summary();
        let (ours, theirs) = (summary(Method::SafeTlp, None), summary(Method::PlanToStop, None));
        let share = ours.proven as f64 / ours.instances.max(1) as f64;
        let ratio = theirs.expansions / ours.expansions;
        let gains = (0..LIMIT_SETS.len()).map(|set| {
            summary(Method::SafeTlp, Some(set)).average_speed - summary(Method::PlanToStop, Some(set)).average_speed
        });
        let least_gain =
            gains.fold(f64::INFINITY, |least, gain| if gain < least || gain.is_nan() { gain } else { least });
        let memory = Method::ALL.iter().map(|m| summary(*m, None).bytes).max().unwrap_or(0) as f64;
        let check = |name, pass, value, limit, unit| Check { name, pass, value, limit, unit };
        vec![
            check("all_proven", share >= 1.0, share, 1.0, "share"),
            check("expansion_ratio", ratio >= FEWER, ratio, FEWER, "plan-to-stop/SafeTLP"),
            check("average_speed", least_gain >= 0.0, least_gain, 0.0, "m/s gained, worst set"),
            check("memory", memory <= MEMORY, memory, MEMORY, "B"),
        ]
    }
}
