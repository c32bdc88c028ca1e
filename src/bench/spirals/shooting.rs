//! The shooting method of the planning lecture, as a slow reference: Simpson's rule and finite differences.
//!
//! Newton's method solves for the two inner knots and the length such that position and heading match the end.
//! Positions come from Simpson's rule on a fixed grid, derivatives from finite differences. Except for the curvature
//! polynomial, the method shares no code with [`connect`](crate::geometry::spiral::connect).
//!
//! Weakness, by design: the grid limits the accuracy, and the finite differences slow the convergence.

use nalgebra::{Matrix3, Vector3};

use crate::bench::problems::LatticeProblem;
use crate::geometry::spiral::{CubicSpiral, Spiral};
use crate::geometry::{Vector, wrap_angle};

/// Intervals of Simpson's rule: an error of 1e-6 m on 40 m. Each further digit takes 1.8 times as many.
const INTERVALS: u32 = 200;
/// Step of the finite differences: the square root of the rounding error.
const STEP: f64 = 1e-8;
/// Tolerance of the residual at the end, m and rad: the limit of finite differences.
const TOLERANCE: f64 = 1e-8;
/// Iteration limit; ten are typical.
const MAX_ITERATIONS: usize = 50;

/// The spiral that meets all end conditions within the accuracy of Simpson's rule. `None` if the iteration does not
/// converge.
pub(super) fn shoot(problem: &LatticeProblem) -> Option<CubicSpiral> {
    let chord = problem.end.position.coords.norm();
    // scaled unknowns: inner knots times chord, length over chord
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
        // excludes degenerate spirals and loops
        x[2] = x[2].clamp(0.5, 3.0);
    }
    None
}

fn spiral(problem: &LatticeProblem, chord: f64, x: &Vector3<f64>) -> CubicSpiral {
    let knots = [problem.start_curvature, x[0] / chord, x[1] / chord, problem.end_curvature];
    CubicSpiral { knots, length: x[2] * chord }
}

/// Residual of the end conditions: x (m), y (m), heading (rad).
fn residual(problem: &LatticeProblem, chord: f64, x: &Vector3<f64>) -> Vector3<f64> {
    let trial = spiral(problem, chord, x);
    let error = simpson_end(&trial, INTERVALS) - problem.end.position.coords;
    Vector3::new(error.x, error.y, trial.heading_change(trial.length) - wrap_angle(problem.end.yaw))
}

/// The end of a spiral from the origin with heading 0, m, by Simpson's rule with an even number of intervals.
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
    fn shooting_and_newton_find_the_same_spirals() {
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
    fn simpson_is_of_fourth_order() {
        let spiral = CubicSpiral { knots: [0.05, -0.1, 0.15, 0.0], length: 30.0 };
        let exact = spiral.end(&crate::geometry::Pose::new(0.0, 0.0, 0.0)).position.coords;
        let (coarse, fine) = ((simpson_end(&spiral, 40) - exact).norm(), (simpson_end(&spiral, 400) - exact).norm());
        assert!(coarse > 1e-6 && fine < 2e-4 * coarse, "{coarse:e} {fine:e}");
    }
}
