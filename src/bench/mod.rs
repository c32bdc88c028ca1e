//! Comparisons that the program can repeat anywhere: `stopline bench`.
//!
//! Each comparison is a module that makes its problems from a seed, measures, and returns plain figures; printing them is
//! the command line's. What a measurement finds is the same on every machine and in every repetition. What it took is in
//! fields named `time`, read from the wall clock, and nothing else depends on them.

pub mod problems;
pub mod safetlp;
pub mod spirals;

use std::time::Instant;

/// Wall-clock times of one problem each, µs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Times {
    /// Half of the problems took no longer.
    pub median_us: f64,
    /// Ninety-nine in a hundred took no longer.
    pub p99_us: f64,
}

/// Something promised, with its figure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Check {
    /// Stable name.
    pub name: &'static str,
    /// Whether it held.
    pub pass: bool,
    /// The figure.
    pub value: f64,
    /// What it may be.
    pub limit: f64,
    /// Unit of both.
    pub unit: &'static str,
}

/// Runs of a problem, of which the shortest counts: what the machine did in between is not the method's.
const RUNS: usize = 3;

/// What `solve` returns for each problem, one after the other on this thread, and what it took. `watch` hears after each
/// problem how many are done, outside of what is timed.
fn timed<P, A>(problems: &[P], solve: impl Fn(&P) -> A, watch: &mut dyn FnMut(usize)) -> (Vec<A>, Times) {
    let mut seconds = Vec::with_capacity(problems.len());
    let mut answers = Vec::with_capacity(problems.len());
    for problem in problems {
        let mut shortest = f64::INFINITY;
        for run in 0..RUNS {
            let begun = Instant::now();
            let answer = std::hint::black_box(solve(std::hint::black_box(problem)));
            shortest = shortest.min(begun.elapsed().as_secs_f64());
            if run == 0 {
                answers.push(answer);
            }
        }
        seconds.push(shortest);
        watch(seconds.len());
    }
    seconds.sort_by(f64::total_cmp);
    (answers, Times { median_us: 1e6 * quantile(&seconds, 0.5), p99_us: 1e6 * quantile(&seconds, 0.99) })
}

/// The smallest value that a share of all does not exceed (nearest rank); 0 of nothing.
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
    fn every_problem_is_answered_once_and_in_order() {
        let (answers, times) = timed(&[3, 1, 2], |p| 10 * p, &mut |_| {});
        assert_eq!(answers, [30, 10, 20]);
        assert!(times.median_us >= 0.0 && times.p99_us >= times.median_us);
        let (none, times) = timed(&[0; 0], |p| *p, &mut |_| {});
        assert_eq!((none.len(), times), (0, Times { median_us: 0.0, p99_us: 0.0 }));
    }
}
