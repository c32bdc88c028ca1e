//! Cubic spirals between random lattice ends: 10…40 m ahead, ±8 m across, ±0.5 rad, end curvatures ±0.1.
//! Figures are per whole set of 2,000 problems: divide by 2,000 for one spiral.

use divan::{Bencher, black_box};
use stopline::geometry::Pose;
use stopline::geometry::spiral::{CubicSpiral, connect};
use stopline::geometry::spiral_opt::connect_bounded;

const PROBLEMS: usize = 2000;

fn main() {
    divan::main();
}

/// Reproducible problems (splitmix64): start curvature, end pose, end curvature.
fn problems() -> Vec<(f64, Pose, f64)> {
    let mut state = 7_u64;
    let mut uniform = move |low: f64, high: f64| {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..PROBLEMS)
        .map(|_| {
            let end = Pose::new(uniform(10.0, 40.0), uniform(-8.0, 8.0), uniform(-0.5, 0.5));
            (uniform(-0.1, 0.1), end, uniform(-0.1, 0.1))
        })
        .collect()
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
