//! Smoothing of a centre line inside its lane, as a convex program.
//!
//! The line is resampled at equal steps h into points cᵢ with normals nᵢ. The variables are the displacements lᵢ along the
//! normals, pᵢ = cᵢ + lᵢ nᵢ. With the smoothing length λ:
//!
//! ```text
//! minimise    Σ lᵢ² + λ⁶ Σ ‖Δ³pᵢ / h³‖²
//! subject to  −rightᵢ ≤ lᵢ ≤ leftᵢ
//! ```
//!
//! The third difference approximates the derivative of curvature: the smoothest line consists of clothoids, as a driver
//! steers them. Undulations shorter than about 2πλ are removed, longer ones remain. l = 0 is always feasible.
//!
//! The matrix of the normal equations has three off-diagonals, so that a solve with given active bounds takes linear time.
//! The primal-dual active set method (Hintermüller, Ito & Kunisch 2002) starts without active bounds, which is correct for
//! most lanes; it adds violated bounds and drops bounds with a multiplier of the wrong sign. When the set no longer changes,
//! the optimality conditions hold exactly. The method may cycle in theory; then Clarabel solves the program, to its
//! tolerance.
//!
//! Weak: the program is linear in the displacements along fixed normals, so that a curve tighter than the lane is wide is
//! smoothed only approximately.

use crate::convex::QuadraticProgram;
use crate::geometry::{Point, Vector};

/// Permitted displacement of a point to either side, m, both positive.
#[derive(Debug, Clone, Copy)]
pub(super) struct Freedom {
    pub(super) left: f64,
    pub(super) right: f64,
}

/// Unit normals to the left of a chain of points, by central differences.
pub(super) fn normals(points: &[Point]) -> Vec<Vector> {
    let last = points.len().saturating_sub(1);
    (0..points.len())
        .map(|i| {
            let chord = points[(i + 1).min(last)] - points[i.saturating_sub(1)];
            let tangent = chord.try_normalize(1e-12).unwrap_or_else(Vector::x);
            Vector::new(-tangent.y, tangent.x)
        })
        .collect()
}

/// The smoothed points; `None` if both solvers fail.
pub(super) fn smoothed(
    points: &[Point],
    normals: &[Vector],
    freedom: &[Freedom],
    step: f64,
    smoothing_length: f64,
) -> Option<Vec<Point>> {
    let problem = Problem { points, normals, freedom, weight: (smoothing_length / step).powi(6) };
    let moves = problem.by_active_set().or_else(|| problem.by_interior_point())?;
    Some(points.iter().zip(normals).zip(&moves).map(|((p, n), l)| p + n * *l).collect())
}

/// Third difference of four neighbours.
const THIRD_DIFFERENCE: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
/// Off-diagonals of the normal equations: a third difference ties a point to three neighbours.
const BAND: usize = 3;

/// The program: Σ lᵢ² + weight Σ ‖Δ³pᵢ‖² within the freedom of each point.
struct Problem<'a> {
    points: &'a [Point],
    normals: &'a [Vector],
    freedom: &'a [Freedom],
    weight: f64,
}

impl Problem<'_> {
    /// Every third difference: the first of its four points, its factors of their displacements, and its value without
    /// displacements.
    fn differences(&self) -> impl Iterator<Item = (usize, [f64; 4], f64)> + '_ {
        let firsts = 0..self.points.len().saturating_sub(BAND);
        firsts.flat_map(|first| [0, 1].map(|axis| (first, axis))).map(|(first, axis)| {
            let factors = std::array::from_fn(|k| THIRD_DIFFERENCE[k] * self.normals[first + k][axis]);
            let unmoved = (0..4).map(|k| THIRD_DIFFERENCE[k] * self.points[first + k][axis]).sum();
            (first, factors, unmoved)
        })
    }

    /// Matrix and right-hand side of the normal equations. Row i contains the entries (i, i), (i, i + 1), … of the symmetric
    /// matrix.
    fn normal_equations(&self) -> (Vec<[f64; BAND + 1]>, Vec<f64>) {
        let n = self.points.len();
        let mut matrix = vec![[1.0, 0.0, 0.0, 0.0]; n];
        let mut right = vec![0.0; n];
        for (first, factors, unmoved) in self.differences() {
            for k in 0..=BAND {
                right[first + k] -= self.weight * factors[k] * unmoved;
                for j in k..=BAND {
                    matrix[first + k][j - k] += self.weight * factors[k] * factors[j];
                }
            }
        }
        (matrix, right)
    }

    /// The displacements by the primal-dual active set method; `None` if it does not converge.
    fn by_active_set(&self) -> Option<Vec<f64>> {
        /// Maximum number of changes of the active set; beyond it the method cycles.
        const MAX_CHANGES: usize = 40;
        let (matrix, right) = self.normal_equations();
        let mut active: Vec<Option<f64>> = vec![None; right.len()];
        for _ in 0..MAX_CHANGES {
            let moves = solved_with(matrix.clone(), right.clone(), &active);
            if moves.iter().any(|l| !l.is_finite()) {
                return None;
            }
            let residuals = residuals(&matrix, &right, &moves);
            let next: Vec<Option<f64>> = (moves.iter().zip(&residuals).zip(self.freedom).zip(&active))
                .map(|(((l, residual), free), active)| match active {
                    // a bound stays active while the objective pushes against it
                    Some(bound) => (*residual * bound > 0.0).then_some(*bound),
                    None if *l > free.left => Some(free.left),
                    None if *l < -free.right => Some(-free.right),
                    None => None,
                })
                .collect();
            if next == active {
                return Some(moves);
            }
            active = next;
        }
        None
    }

    /// The displacements by Clarabel.
    fn by_interior_point(&self) -> Option<Vec<f64>> {
        let mut program = QuadraticProgram::new(self.points.len());
        for (first, factors, unmoved) in self.differences() {
            let terms: [_; 4] = std::array::from_fn(|k| (first + k, factors[k]));
            program.add_square(self.weight, &terms, -unmoved);
        }
        for (i, free) in self.freedom.iter().enumerate() {
            program.add_square(1.0, &[(i, 1.0)], 0.0);
            program.between(-free.right, &[(i, 1.0)], free.left);
        }
        let solution = program.solve();
        solution.is_usable().then_some(solution.x)
    }
}

/// Solves the system with some of the unknowns fixed at given values.
fn solved_with(mut matrix: Vec<[f64; BAND + 1]>, mut right: Vec<f64>, fixed: &[Option<f64>]) -> Vec<f64> {
    for (i, value) in fixed.iter().enumerate() {
        let Some(value) = value else { continue };
        for k in 1..=BAND {
            if i + k < right.len() {
                right[i + k] -= matrix[i][k] * value;
            }
            if k <= i {
                right[i - k] -= matrix[i - k][k] * value;
                matrix[i - k][k] = 0.0;
            }
        }
        matrix[i] = [1.0, 0.0, 0.0, 0.0];
        right[i] = *value;
    }
    solved(matrix, right)
}

/// The residual right − matrix · x: zero for free unknowns, the multiplier of active ones.
fn residuals(matrix: &[[f64; BAND + 1]], right: &[f64], x: &[f64]) -> Vec<f64> {
    let mut residuals = right.to_vec();
    for (i, row) in matrix.iter().enumerate() {
        residuals[i] -= row[0] * x[i];
        for k in 1..=BAND.min(x.len() - 1 - i) {
            residuals[i] -= row[k] * x[i + k];
            residuals[i + k] -= row[k] * x[i];
        }
    }
    residuals
}

/// Solves a symmetric positive definite banded system by LDLᵀ in place (Golub & Van Loan, 4.3). Row i of the matrix
/// contains its entries from the diagonal to the right.
fn solved(mut matrix: Vec<[f64; BAND + 1]>, mut x: Vec<f64>) -> Vec<f64> {
    let n = x.len();
    for i in 0..n {
        let row = matrix[i];
        for k in 1..=BAND.min(n - 1 - i) {
            let factor = row[k] / row[0];
            for j in k..=BAND {
                matrix[i + k][j - k] -= factor * row[j];
            }
            x[i + k] -= factor * x[i];
        }
    }
    for i in (0..n).rev() {
        let known: f64 = (1..=BAND.min(n - 1 - i)).map(|k| matrix[i][k] * x[i + k]).sum();
        x[i] = (x[i] - known) / matrix[i][0];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs a test on the program of a jagged wave.
    fn with_problem(count: i32, jag: f64, test: impl FnOnce(&Problem<'_>)) {
        let points: Vec<Point> = (0..count)
            .map(|i| Point::new(f64::from(i), (0.2 * f64::from(i)).sin() + jag * f64::from(i * i % 7 - 3)))
            .collect();
        let normals = normals(&points);
        let freedom: Vec<Freedom> =
            (0..count).map(|i| Freedom { left: 0.3 + 0.01 * f64::from(i % 5), right: 0.3 }).collect();
        test(&Problem { points: &points, normals: &normals, freedom: &freedom, weight: 729.0 });
    }

    /// The objective, from its definition.
    fn objective(problem: &Problem<'_>, moves: &[f64]) -> f64 {
        let moved: Vec<Vector> =
            problem.points.iter().zip(problem.normals).zip(moves).map(|((p, n), l)| p.coords + n * *l).collect();
        let third = moved.windows(4).map(|w| (w[3] - w[2] * 3.0 + w[1] * 3.0 - w[0]).norm_squared());
        moves.iter().map(|l| l * l).sum::<f64>() + problem.weight * third.sum::<f64>()
    }

    #[test]
    fn active_set_and_interior_point_agree() {
        let mut at_bounds = 0;
        for count in [1, 2, 3, 4, 5, 40, 200] {
            for jag in [0.01, 0.05, 0.15, 0.4] {
                with_problem(count, jag, |problem| {
                    let found = problem.by_active_set().expect("converges");
                    let slow = problem.by_interior_point().expect("solved");
                    for (a, b) in found.iter().zip(&slow) {
                        assert!((a - b).abs() < 2e-3, "{a} against {b} of {count}, {jag}");
                    }
                    let (best, other) = (objective(problem, &found), objective(problem, &slow));
                    assert!(best <= other * (1.0 + 1e-6) + 1e-9, "{best} against {other} of {count}, {jag}");
                    for (l, free) in found.iter().zip(problem.freedom) {
                        assert!(-free.right <= *l && *l <= free.left, "{l} is outside");
                        at_bounds += usize::from(*l == free.left || *l == -free.right);
                    }
                    assert!(count < 5 || found.iter().any(|l| l.abs() > 1e-3), "no point was smoothed");
                });
            }
        }
        assert!(at_bounds > 100, "{at_bounds}");
    }

    #[test]
    fn solves_a_banded_system() {
        let matrix = vec![[4.0, 1.0, -0.5, 0.25]; 9];
        let full = |i: usize, j: usize| matrix[0].get(i.abs_diff(j)).copied().unwrap_or(0.0);
        let expected: Vec<f64> = (0..9).map(|i| f64::from(i) - 3.5).collect();
        let right = (0..9).map(|i| (0..9).map(|j| full(i, j) * expected[j]).sum()).collect();
        for (a, b) in solved(matrix.clone(), right).iter().zip(&expected) {
            assert!((a - b).abs() < 1e-12, "{a} against {b}");
        }
    }
}
