//! Cubic spirals between random lattice ends: 10…40 m ahead, ±8 m across, ±0.5 rad, end curvatures ±0.1.
//! Figures are per whole set of 2,000 problems: divide by 2,000 for one spiral.

use divan::{Bencher, black_box};
use stopline::bench::problems::{COUNT, SEED, lattice_problems};
use stopline::geometry::Pose;
use stopline::geometry::spiral::{CubicSpiral, connect};
use stopline::geometry::spiral_opt::connect_bounded;

fn main() {
    divan::main();
}

/// Start curvature, end pose, end curvature.
fn problems() -> Vec<(f64, Pose, f64)> {
    lattice_problems(SEED, COUNT).iter().map(|p| (p.start_curvature, p.end, p.end_curvature)).collect()
}

fn spirals() -> Vec<CubicSpiral> {
    problems().iter().filter_map(|(start, end, curvature)| connect(*start, end, *curvature).ok()).collect()
}

/// Newton's method alone.
#[divan::bench]
fn newton_2000(bencher: Bencher) {
    let problems = problems();
    bencher.bench_local(|| {
        for (start, end, curvature) in &problems {
            let _ = black_box(connect(black_box(*start), end, *curvature));
        }
    });
}

/// The convex program, on the problems in which a bound of 0.12 1/m bites: divide by their number, 321.
#[divan::bench]
fn bounded_where_the_bound_bites(bencher: Bencher) {
    const BOUND: f64 = 0.12;
    let mut bitten = problems();
    bitten.retain(|(start, end, curvature)| {
        connect(*start, end, *curvature).is_ok_and(|spiral| spiral.max_abs_curvature() > BOUND)
    });
    bencher.bench_local(|| {
        for (start, end, curvature) in &bitten {
            let _ = black_box(connect_bounded(*start, end, *curvature, BOUND));
        }
    });
}

/// The sweep that collision checks use: a sample every half metre.
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
