//! Smoothing of a centre line inside its lane, as a convex program.
//!
//! The line is resampled at even steps h into points cᵢ with normals nᵢ. Variables are the displacements lᵢ along the
//! normals; pᵢ = cᵢ + lᵢ nᵢ. With the smoothing length λ:
//!
//! ```text
//! minimise    Σ lᵢ² + λ⁶ Σ ‖Δ³pᵢ / h³‖²
//! subject to  −rightᵢ ≤ lᵢ ≤ leftᵢ
//! ```
//!
//! The third difference is the derivative of curvature: the smoothest line is one of clothoids, which is what a driver
//! steers. Undulations shorter than about 2πλ are smoothed away, longer ones stay. l = 0 is always feasible.

use crate::convex::QuadraticProgram;
use crate::geometry::{Point, Vector};

/// How far a point may move to either side, m, both positive.
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
            let along = points[(i + 1).min(last)] - points[i.saturating_sub(1)];
            let along = along.try_normalize(1e-12).unwrap_or_else(Vector::x);
            Vector::new(-along.y, along.x)
        })
        .collect()
}

/// The smoothed points. `None` if the solver fails: the caller goes on with the points as they are.
pub(super) fn smoothed(
    points: &[Point],
    normals: &[Vector],
    freedom: &[Freedom],
    step: f64,
    smoothing_length: f64,
) -> Option<Vec<Point>> {
    const THIRD_DIFFERENCE: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
    let mut program = QuadraticProgram::new(points.len());
    let weight = (smoothing_length / step).powi(6);
    for first in 0..points.len().saturating_sub(3) {
        for axis in [0, 1] {
            let terms: [_; 4] = std::array::from_fn(|k| (first + k, THIRD_DIFFERENCE[k] * normals[first + k][axis]));
            let unmoved: f64 = (0..4).map(|k| THIRD_DIFFERENCE[k] * points[first + k][axis]).sum();
            program.add_square(weight, &terms, -unmoved);
        }
    }
    for (i, free) in freedom.iter().enumerate() {
        program.add_square(1.0, &[(i, 1.0)], 0.0);
        program.between(-free.right, &[(i, 1.0)], free.left);
    }
    let solution = program.solve();
    solution.is_usable().then(|| {
        let moved = points.iter().zip(normals).zip(&solution.x);
        moved.map(|((p, n), l)| p + n * *l).collect()
    })
}
