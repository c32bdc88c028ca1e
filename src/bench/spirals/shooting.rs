//! The lecture's way to a spiral, kept as the slow reference: shooting with Simpson's rule and differences.
//!
//! Newton's method on the two inner knots and the length against the three conditions at the end (along, across, heading).
//! Positions come from Simpson's rule on a fixed grid, derivatives from shooting again with each unknown moved a little. It
//! shares no code with [`connect`](crate::geometry::spiral::connect) but the curvature polynomial.
//!
//! Weak by design: the grid decides the accuracy and the differences the number of iterations.

use nalgebra::{Matrix3, Vector3};

use crate::bench::problems::LatticeProblem;
use crate::geometry::spiral::{CubicSpiral, Spiral};
use crate::geometry::{Vector, wrap_angle};

/// Intervals of Simpson's rule: a micrometre on 40 m, for one more digit 1.8 times as many.
const INTERVALS: u32 = 200;
/// Relative step of the differences: the square root of the rounding error.
const STEP: f64 = 1e-8;
/// Largest residual at the end, m and rad: what differences still reach.
const TOLERANCE: f64 = 1e-8;
/// Iterations; ten are usual.
const MAX_ITERATIONS: usize = 50;

/// The spiral that meets all end conditions, as far as Simpson's rule sees it. `None` if the iteration does not settle.
pub(super) fn shoot(problem: &LatticeProblem) -> Option<CubicSpiral> {
    let chord = problem.end.position.coords.norm();
    // unknowns of the order of one: inner knots times chord, length over chord
    let mut x = Vector3::new(0.0, 0.0, 1.0);
    for _ in 0..MAX_ITERATIONS {
        let error = residual(problem, chord, &x);
        if error.amax() < TOLERANCE {
            return Some(spiral(problem, chord, &x));
        }
        let mut jacobian = Matrix3::zeros();
        for unknown in 0..3 {
            let mut moved = x;
            moved[unknown] += STEP;
            jacobian.set_column(unknown, &((residual(problem, chord, &moved) - error) / STEP));
        }
        x -= jacobian.try_inverse()? * error;
        // a length near zero or of loops is not to be believed
        x[2] = x[2].clamp(0.5, 3.0);
    }
    None
}

fn spiral(problem: &LatticeProblem, chord: f64, x: &Vector3<f64>) -> CubicSpiral {
    let knots = [problem.start_curvature, x[0] / chord, x[1] / chord, problem.end_curvature];
    CubicSpiral { knots, length: x[2] * chord }
}

/// End of the trial minus the wanted one: m, m, rad.
fn residual(problem: &LatticeProblem, chord: f64, x: &Vector3<f64>) -> Vector3<f64> {
    let trial = spiral(problem, chord, x);
    let miss = simpson_end(&trial, INTERVALS) - problem.end.position.coords;
    Vector3::new(miss.x, miss.y, trial.heading_change(trial.length) - wrap_angle(problem.end.yaw))
}

/// The end of a spiral from the origin with heading 0 by Simpson's rule with an even number of intervals, m.
pub(super) fn simpson_end<const K: usize>(spiral: &Spiral<K>, intervals: u32) -> Vector {
    let h = spiral.length / f64::from(intervals);
    let direction = |i: u32| {
        let (sin, cos) = spiral.heading_change(h * f64::from(i)).sin_cos();
        Vector::new(cos, sin)
    };
    let mut sum = direction(0) + direction(intervals);
    for i in 1..intervals {
        sum += direction(i) * if i % 2 == 1 { 4.0 } else { 2.0 };
    }
    sum * (h / 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::problems::{SEED, lattice_problems};
    use crate::geometry::spiral::connect;

    #[test]
    fn the_slow_way_finds_the_same_spirals() {
        let mut found = 0;
        for p in lattice_problems(SEED, 100) {
            let fast = connect(p.start_curvature, &p.end, p.end_curvature).unwrap();
            let Some(slow) = shoot(&p) else { continue };
            found += 1;
            assert!((slow.length - fast.length).abs() < 1e-4, "{slow:?} {fast:?}");
            assert!(slow.knots.iter().zip(fast.knots).all(|(a, b)| (a - b).abs() < 1e-5), "{slow:?} {fast:?}");
        }
        assert!(found > 90, "{found} of 100");
    }

    #[test]
    fn simpson_gains_four_digits_for_ten_times_the_points() {
        let spiral = CubicSpiral { knots: [0.05, -0.1, 0.15, 0.0], length: 30.0 };
        let exact = spiral.end(&crate::geometry::Pose::new(0.0, 0.0, 0.0)).position.coords;
        let (coarse, fine) = ((simpson_end(&spiral, 40) - exact).norm(), (simpson_end(&spiral, 400) - exact).norm());
        assert!(coarse > 1e-6 && fine < 2e-4 * coarse, "{coarse:e} {fine:e}");
    }
}
