//! Spirals between random lattice ends: 10…40 m longitudinally, ±8 m laterally, ±0.5 rad, end curvatures ±0.1 1/m.
//!
//! First prints a table of times per spiral. Each problem is solved five times and the shortest time counts, because
//! other processes only prolong a run; medians and 99th percentiles are over the problems. Then runs divan's benches,
//! whose times are per set of problems.

use std::time::{Duration, Instant};

use divan::{Bencher, black_box};
use stopline::bench::problems::{COUNT, SEED, lattice_problems};
use stopline::geometry::Pose;
use stopline::geometry::boundary::{EndCondition, Problem, Solution};
use stopline::geometry::spiral::{CubicSpiral, connect};
use stopline::geometry::spiral_opt::connect_bounded;

/// A curvature bound that is active in about a sixth of the problems, 1/m.
const BOUND: f64 = 0.12;
/// A bound of the curvature rate that is often active, 1/m².
const RATE: f64 = 0.03;

fn main() {
    if std::env::args().any(|argument| argument == "--bench") {
        table();
    }
    divan::main();
}

/// A lattice problem: start curvature, end pose, end curvature.
type Ends = (f64, Pose, f64);

fn problems() -> Vec<Ends> {
    let problems = lattice_problems(SEED, COUNT);
    problems.into_iter().map(|p| (p.start_curvature, p.end, p.end_curvature)).collect()
}

/// The problems with an active curvature bound.
fn with_active_bound() -> Vec<Ends> {
    let mut problems = problems();
    problems.retain(|(start, end, curvature)| {
        connect(*start, end, *curvature).is_ok_and(|spiral| spiral.max_abs_curvature() > BOUND)
    });
    problems
}

/// The problems with an active bound of the curvature rate.
fn with_active_rate() -> Vec<Ends> {
    let mut problems = problems();
    problems.retain(|(start, end, curvature)| {
        connect(*start, end, *curvature).is_ok_and(|spiral| spiral.max_abs_curvature_rate() > RATE)
    });
    problems
}

/// Metrics of a solve.
struct Outcome {
    solved: bool,
    residual: f64,
    iterations: u32,
    programs: u32,
}

impl<const K: usize> From<Solution<K>> for Outcome {
    fn from(s: Solution<K>) -> Self {
        let solved = s.status.is_solved();
        Self { solved, residual: s.residual, iterations: s.iterations, programs: s.programs }
    }
}

fn table() {
    const ORIGIN: Pose = Pose { position: stopline::geometry::Point::new(0.0, 0.0), yaw: 0.0 };
    println!("times per spiral in µs");
    println!(
        "{:<46}{:>6}{:>8}{:>9}{:>9}{:>9}{:>11}{:>7}{:>10}",
        "problem", "count", "solved", "median", "p99", "max", "residual m", "steps", "programs"
    );
    let all = problems();
    row("cubic pinned: Newton", &all, |(start, end, curvature)| {
        let found = connect(*start, end, *curvature);
        let residual = found.map_or(f64::NAN, |s| (s.end(&ORIGIN).position - end.position).norm());
        Outcome { solved: found.is_ok(), residual, iterations: 0, programs: 0 }
    });
    let pinned = |(start, end, curvature): &Ends| Problem::pinned(*start, *end, *curvature);
    let soft = |ends: &Ends, weight| Problem { lateral: EndCondition::Soft { weight }, ..pinned(ends) };
    for (how, always_convex) in [("reduced Newton", false), ("Clarabel", true)] {
        let with = |problem: Problem| Problem { always_convex, ..problem };
        row(&format!("cubic, soft lateral, no bound: {how}"), &all, |e| with(soft(e, 0.01)).cubic().into());
        row(&format!("quintic pinned, no bound: {how}"), &all, |e| with(pinned(e)).quintic().into());
    }
    let active = with_active_bound();
    let bounded = |problem: Problem| Problem { max_curvature: BOUND, ..problem };
    row("cubic, active bound, soft lateral: cones", &active, |e| bounded(soft(e, 100.0)).cubic().into());
    row("quintic, active bound, soft lateral: cuts", &active, |e| bounded(soft(e, 100.0)).quintic().into());
    row("quintic, active bound, pinned: cuts", &active, |e| bounded(pinned(e)).quintic().into());
    let steep = with_active_rate();
    let rate_bounded = |problem: Problem| Problem { max_curvature_rate: RATE, ..problem };
    row("cubic, active rate bound, soft lateral: cones", &steep, |e| rate_bounded(soft(e, 100.0)).cubic().into());
    row("quintic, active rate bound, soft lateral: cuts", &steep, |e| rate_bounded(soft(e, 100.0)).quintic().into());
    row("cubic, target behind", &all, |(start, end, curvature)| {
        let behind = Pose::new(-end.position.x, end.position.y, end.yaw);
        bounded(Problem::pinned(*start, behind, *curvature)).cubic().into()
    });
    println!();
}

fn row(name: &str, problems: &[Ends], solve: impl Fn(&Ends) -> Outcome) {
    const REPEATS: usize = 5;
    let mut times = Vec::with_capacity(problems.len());
    let (mut solved, mut residual, mut iterations, mut programs) = (0_usize, 0.0_f64, 0, 0);
    for problem in problems {
        let mut fastest = Duration::MAX;
        for repeat in 0..REPEATS {
            let begin = Instant::now();
            let outcome = black_box(solve(black_box(problem)));
            fastest = fastest.min(begin.elapsed());
            if repeat == 0 {
                iterations += outcome.iterations;
                programs += outcome.programs;
                if outcome.solved {
                    solved += 1;
                    residual = residual.max(outcome.residual);
                }
            }
        }
        times.push(fastest.as_secs_f64() * 1e6);
    }
    times.sort_by(f64::total_cmp);
    let count = problems.len();
    let at = |per_mille: usize| times.get(count * per_mille / 1000).copied().unwrap_or(f64::NAN);
    let mean = |sum: u32| f64::from(sum) / count as f64;
    println!(
        "{name:<46}{count:>6}{:>7.1}%{:>9.2}{:>9.2}{:>9.1}{residual:>11.1e}{:>7.1}{:>10.1}",
        100.0 * solved as f64 / count as f64,
        at(500),
        at(990),
        times.last().copied().unwrap_or(f64::NAN),
        mean(iterations),
        mean(programs)
    );
}

fn spirals() -> Vec<CubicSpiral> {
    problems().iter().filter_map(|(start, end, curvature)| connect(*start, end, *curvature).ok()).collect()
}

/// Pinned cubic spirals by Newton's method.
#[divan::bench]
fn newton_2000(bencher: Bencher) {
    let problems = problems();
    bencher.bench_local(|| {
        for (start, end, curvature) in &problems {
            let _ = black_box(connect(black_box(*start), end, *curvature));
        }
    });
}

/// The lattice's call on the 321 problems with an active bound.
#[divan::bench]
fn active_bound_321(bencher: Bencher) {
    let active = with_active_bound();
    bencher.bench_local(|| {
        for (start, end, curvature) in &active {
            let _ = black_box(connect_bounded(*start, end, *curvature, BOUND));
        }
    });
}

/// Sampling every half metre, as in collision checks.
#[divan::bench]
fn sweep_2000(bencher: Bencher) {
    let spirals = spirals();
    let origin = Pose::new(0.0, 0.0, 0.0);
    bencher.bench_local(|| {
        for spiral in &spirals {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small positive count
            let intervals = (2.0 * spiral.length).ceil() as usize;
            for point in spiral.samples(&origin, intervals) {
                black_box(point);
            }
        }
    });
}

/// Projection of a point two metres beside the middle of the spiral.
#[divan::bench]
fn nearest_2000(bencher: Bencher) {
    let spirals = spirals();
    let origin = Pose::new(0.0, 0.0, 0.0);
    let points: Vec<_> = spirals
        .iter()
        .map(|spiral| {
            let middle = spiral.point_at(&origin, 0.5 * spiral.length).pose;
            middle.position + middle.left() * 2.0
        })
        .collect();
    bencher.bench_local(|| {
        for (spiral, point) in spirals.iter().zip(&points) {
            black_box(spiral.nearest(&origin, *point));
        }
    });
}
