//! Reproducible comparisons of methods: `stopline bench`.
//!
//! Each comparison is a module that generates its problems, runs all methods and returns metrics; `cli::bench` prints
//! them. All metrics are deterministic except the fields named `time`, which contain wall-clock times.

pub mod commonroad;
pub mod fallbacks;
pub mod problems;
pub mod safetlp;
pub mod spirals;

use std::time::Instant;

use crate::verdict::Status;

/// Distribution of the wall-clock time per problem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Times {
    /// Median, µs.
    pub median_us: f64,
    /// 99th percentile, µs.
    pub p99_us: f64,
}

/// A check of one metric against its limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Check {
    /// Stable name.
    pub name: &'static str,
    /// Whether the check passes. A check without the searches that it needs is N/A; then the comparison does not pass.
    pub status: Status,
    /// Value of the metric; NaN if the check does not apply.
    pub value: f64,
    /// Limit of the value.
    pub limit: f64,
    /// Unit of value and limit.
    pub unit: &'static str,
}

/// Runs per problem. The shortest time counts, because other processes only prolong a run.
const RUNS: usize = 3;

/// Solves all problems one after the other on this thread. Returns the answers and the times. Calls `progress` with the
/// number of finished problems after each one, outside the timed section.
fn timed<P, A>(problems: &[P], solve: impl Fn(&P) -> A, progress: &mut dyn FnMut(usize)) -> (Vec<A>, Times) {
    let mut seconds = Vec::with_capacity(problems.len());
    let mut answers = Vec::with_capacity(problems.len());
    for problem in problems {
        let mut shortest = f64::INFINITY;
        for run in 0..RUNS {
            let start = Instant::now();
            let answer = std::hint::black_box(solve(std::hint::black_box(problem)));
            shortest = shortest.min(start.elapsed().as_secs_f64());
            if run == 0 {
                answers.push(answer);
            }
        }
        seconds.push(shortest);
        progress(seconds.len());
    }
    seconds.sort_by(f64::total_cmp);
    (answers, Times { median_us: 1e6 * quantile(&seconds, 0.5), p99_us: 1e6 * quantile(&seconds, 0.99) })
}

/// Quantile of sorted values by the nearest-rank method; 0 for an empty slice.
pub(crate) fn quantile(sorted: &[f64], share: f64) -> f64 {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a share of a count
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_nearest_ranks() {
        let times: Vec<f64> = (1..=200).map(f64::from).collect();
        assert_eq!((quantile(&times, 0.5), quantile(&times, 0.99), quantile(&times, 1.0)), (100.0, 198.0, 200.0));
        assert_eq!((quantile(&[7.0], 0.5), quantile(&[7.0], 0.99), quantile(&[], 0.5)), (7.0, 7.0, 0.0));
    }

    #[test]
    fn answers_every_problem_once_in_order() {
        let (answers, times) = timed(&[3, 1, 2], |p| 10 * p, &mut |_| {});
        assert_eq!(answers, [30, 10, 20]);
        assert!(times.median_us >= 0.0 && times.p99_us >= times.median_us);
        let (none, times) = timed(&[0; 0], |p| *p, &mut |_| {});
        assert_eq!((none.len(), times), (0, Times { median_us: 0.0, p99_us: 0.0 }));
    }
}
