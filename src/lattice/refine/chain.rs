//! A chain of cubic spirals with continuous curvature, and the sensitivities of its points to knots and lengths.
//!
//! All quantities are in the frame of the chain's start (origin, heading 0), so that they do not depend on the coordinates
//! of the map. Positions are L ∫ (cos θ, sin θ) du with θ linear in the knots. Their derivatives are integrals of the same
//! kind; one sweep of five-point Gauss rules over the intervals between samples computes both.

use nalgebra::{Matrix3, Vector3};

use crate::geometry::quadrature::GAUSS_5;
use crate::geometry::spiral::CubicSpiral;
use crate::geometry::{Point, Pose, Vector};

/// Start of a chain in its frame.
pub(super) const ORIGIN: Pose = Pose { position: Point::new(0.0, 0.0), yaw: 0.0 };

/// The Lagrange basis of the knots at u = 0, 1/3, 2/3, 1, by ascending powers of u.
const BASIS: [[f64; 4]; 4] =
    [[1.0, -5.5, 9.0, -4.5], [0.0, 9.0, -22.5, 13.5], [0.0, -4.5, 18.0, -13.5], [0.0, 1.0, -4.5, 4.5]];

/// The basis at `u`; the curvature is its product with the knots.
pub(super) fn basis(u: f64) -> [f64; 4] {
    BASIS.map(|[a, b, c, d]| a + u * (b + u * (c + u * d)))
}

/// The derivative of the basis by `u`.
pub(super) fn basis_slope(u: f64) -> [f64; 4] {
    BASIS.map(|[_, b, c, d]| b + u * (2.0 * c + u * 3.0 * d))
}

/// The integral of the basis from 0 to `u`.
fn basis_integral(u: f64) -> [f64; 4] {
    BASIS.map(|[a, b, c, d]| u * (a + u * (b / 2.0 + u * (c / 3.0 + u * (d / 4.0)))))
}

/// The vector rotated by 90° to the left: the derivative of a lever by the angle of its base.
pub(super) fn quarter_turn(v: Vector) -> Vector {
    Vector::new(-v.y, v.x)
}

/// A chain of spirals. Neighbours share the knot at their joint, so that curvature is continuous by construction.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chain {
    /// Knots of all pieces, 1/m; piece `i` has the knots 3 i to 3 i + 3.
    pub(super) knots: Vec<f64>,
    /// Lengths of the pieces, m.
    pub(super) lengths: Vec<f64>,
}

/// A point of a chain with its sensitivities. Derivatives are by the variables of the piece that it lies on; the preceding pieces move
/// the start of the piece.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Normalised arc length in the piece.
    pub(super) u: f64,
    /// Pose in the frame of the chain's start; yaw not wrapped.
    pub(super) pose: Pose,
    /// Vector from the start of the piece, m.
    pub(super) lever: Vector,
    /// Derivatives of the position by the four knots of the piece (m²) and its length.
    pub(super) position_by: [Vector; 5],
    /// Derivatives of the heading by the same (m, 1/m).
    pub(super) heading_by: [f64; 5],
}

impl Chain {
    /// `None` without a piece, or if curvatures differ at a joint.
    pub(super) fn of(spirals: &[CubicSpiral]) -> Option<Self> {
        /// Tolerance of equal curvatures, 1/m.
        const SAME: f64 = 1e-9;
        let mut knots = vec![spirals.first()?.knots[0]];
        for spiral in spirals {
            if (spiral.knots[0] - knots[knots.len() - 1]).abs() > SAME {
                return None;
            }
            knots.extend(&spiral.knots[1..]);
        }
        Some(Self { knots, lengths: spirals.iter().map(|s| s.length).collect() })
    }

    pub(super) fn pieces(&self) -> usize {
        self.lengths.len()
    }

    pub(super) fn length(&self) -> f64 {
        self.lengths.iter().sum()
    }

    pub(super) fn spiral(&self, piece: usize) -> CubicSpiral {
        let k = &self.knots[3 * piece..];
        CubicSpiral { knots: [k[0], k[1], k[2], k[3]], length: self.lengths[piece] }
    }

    pub(super) fn spirals(&self) -> Vec<CubicSpiral> {
        (0..self.pieces()).map(|i| self.spiral(i)).collect()
    }

    /// End pose in the frame of the start.
    pub(super) fn end(&self) -> Pose {
        (0..self.pieces()).fold(ORIGIN, |pose, i| self.spiral(i).end(&pose))
    }

    /// Bending energy ∫ κ² ds, 1/m: exact.
    pub(super) fn bending_energy(&self) -> f64 {
        self.spirals().iter().map(CubicSpiral::bending_energy).sum()
    }

    /// Largest |curvature| anywhere, 1/m: closed form.
    pub(super) fn max_abs_curvature(&self) -> f64 {
        self.spirals().iter().fold(0.0, |m: f64, s| m.max(s.max_abs_curvature()))
    }

    /// Largest |curvature rate| anywhere, 1/m²: closed form.
    pub(super) fn max_abs_curvature_rate(&self) -> f64 {
        self.spirals().iter().fold(0.0, |m: f64, s| m.max(s.max_abs_curvature_rate()))
    }

    /// Samples of every piece at equal spacing, one per interval, without the start of the piece.
    pub(super) fn linearised(&self, intervals: &[usize]) -> Vec<Vec<Sample>> {
        let mut start = ORIGIN;
        let mut all = Vec::with_capacity(self.pieces());
        for (i, &intervals) in intervals.iter().enumerate().take(self.pieces()) {
            let samples = linearised(&self.spiral(i), &start, intervals);
            if let Some(last) = samples.last() {
                start = last.pose;
            }
            all.push(samples);
        }
        all
    }

    /// Restores the end to `target` by the least-norm change of inner knots and lengths (Gauss–Newton on three conditions; a
    /// knot is weighted by the displacement of the path, its change times the square of the mean length). `false` if the
    /// error of the end remains above [`END_TOLERANCE`].
    pub(super) fn restore(&mut self, target: &Pose) -> bool {
        /// Iteration limit; two or three are usual.
        const ITERATIONS: usize = 8;
        for _ in 0..ITERATIONS {
            let end = self.end();
            let off = target.position - end.position;
            let residual = Vector3::new(off.x, off.y, target.yaw - end.yaw);
            if residual.norm() <= END_TOLERANCE {
                return true;
            }
            let unit = (self.pieces() as f64 / self.length()).powi(2);
            let (by_knot, by_length) = self.end_by(unit);
            let inner = &by_knot[1..by_knot.len() - 1];
            let gram: Matrix3<f64> = inner.iter().chain(&by_length).map(|c| c * c.transpose()).sum();
            let Some(multipliers) = gram.try_inverse().map(|inverse| inverse * residual) else { return false };
            for (knot, column) in self.knots[1..].iter_mut().zip(inner) {
                *knot += unit * column.dot(&multipliers);
            }
            for (length, column) in self.lengths.iter_mut().zip(&by_length) {
                *length += column.dot(&multipliers);
            }
            if !self.lengths.iter().all(|l| l.is_finite() && *l > 0.0) {
                return false;
            }
        }
        false
    }

    /// Derivatives of the end (x, y, yaw) by every knot, in `unit`s, and by every length.
    fn end_by(&self, unit: f64) -> (Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
        /// Intervals per piece. Newton's method does not need more accurate derivatives.
        const INTERVALS: usize = 6;
        let samples = self.linearised(&vec![INTERVALS; self.pieces()]);
        let ends: Vec<Sample> = samples.iter().filter_map(|piece| piece.last().copied()).collect();
        let end = ends.last().map_or(ORIGIN, |last| last.pose);
        let mut by_knot = vec![Vector3::zeros(); self.knots.len()];
        let mut by_length = vec![Vector3::zeros(); self.pieces()];
        for (i, sample) in ends.iter().enumerate() {
            let lever = quarter_turn(end.position - sample.pose.position);
            let column = |j: usize| {
                let moved = sample.position_by[j] + lever * sample.heading_by[j];
                Vector3::new(moved.x, moved.y, sample.heading_by[j])
            };
            for j in 0..4 {
                by_knot[3 * i + j] += column(j) * unit;
            }
            by_length[i] = column(4);
        }
        (by_knot, by_length)
    }
}

/// Tolerance of the end pose, m and rad: a tenth of the guaranteed error.
pub(super) const END_TOLERANCE: f64 = 1e-10;

/// Samples of a spiral from `start`, without the start.
fn linearised(spiral: &CubicSpiral, start: &Pose, intervals: usize) -> Vec<Sample> {
    let (k, length) = (spiral.knots, spiral.length);
    let of_knots = |weights: [f64; 4]| weights.iter().zip(&k).map(|(w, k)| w * k).sum::<f64>();
    let width = 1.0 / intervals as f64;
    let mut tangents = Vector::zeros();
    let mut normals = [Vector::zeros(); 4];
    let mut samples = Vec::with_capacity(intervals);
    for i in 0..intervals {
        for (node, weight) in &GAUSS_5 {
            let integrals = basis_integral(width * (i as f64 + node));
            let (sin, cos) = (start.yaw + length * of_knots(integrals)).sin_cos();
            tangents += Vector::new(cos, sin) * (weight * width);
            let normal = Vector::new(-sin, cos) * (weight * width);
            for (sum, integral) in normals.iter_mut().zip(integrals) {
                *sum += normal * integral;
            }
        }
        let u = width * (i + 1) as f64;
        let integrals = basis_integral(u);
        let by_length = tangents + normals.iter().zip(&k).map(|(n, k)| n * *k).sum::<Vector>() * length;
        let lever = tangents * length;
        let [a, b, c, d] = normals.map(|n| n * (length * length));
        let turned = of_knots(integrals);
        let [p, q, r, s] = integrals.map(|w| w * length);
        samples.push(Sample {
            u,
            pose: Pose { position: start.position + lever, yaw: start.yaw + length * turned },
            lever,
            position_by: [a, b, c, d, by_length],
            heading_by: [p, q, r, s, turned],
        });
    }
    samples
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn bent() -> Chain {
        let knots = vec![0.01, 0.03, -0.02, 0.015, 0.05, 0.02, -0.03, -0.01, 0.02, 0.0];
        Chain { knots, lengths: vec![14.0, 22.0, 9.0] }
    }

    #[test]
    fn samples_are_on_the_spirals() {
        let chain = bent();
        let samples = chain.linearised(&[6, 12, 6]);
        let mut start = ORIGIN;
        for (i, piece) in samples.iter().enumerate() {
            let spiral = chain.spiral(i);
            for s in piece {
                let exact = spiral.point_at(&start, s.u * spiral.length).pose;
                assert!((s.pose.position - exact.position).norm() < 1e-9);
                assert!((s.pose.yaw - exact.yaw).abs() < 1e-12);
                assert!((s.lever - (exact.position - start.position)).norm() < 1e-9);
            }
            start = spiral.end(&start);
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let chain = bent();
        let at = |change: &dyn Fn(&mut Chain, f64), h: f64| {
            let mut moved = chain.clone();
            change(&mut moved, h);
            moved.linearised(&[6; 3])
        };
        let samples = chain.linearised(&[6; 3]);
        for (piece, of_piece) in samples.iter().enumerate() {
            for j in 0..5 {
                let change = move |c: &mut Chain, h: f64| match j {
                    4 => c.lengths[piece] += h,
                    _ => c.knots[3 * piece + j] += h,
                };
                let h = if j == 4 { 1e-4 } else { 1e-6 };
                let (plus, minus) = (at(&change, h), at(&change, -h));
                for (n, s) in of_piece.iter().enumerate() {
                    let (a, b) = (plus[piece][n], minus[piece][n]);
                    // the first knot also belongs to the piece before, whose end must not move
                    let lever = (a.lever - b.lever) / (2.0 * h);
                    if piece == 0 || j > 0 {
                        assert!((lever - s.position_by[j]).norm() < 1e-4, "{piece} {n} {j}");
                        let turned = (a.pose.yaw - b.pose.yaw) / (2.0 * h);
                        assert!((turned - s.heading_by[j]).abs() < 1e-6, "{piece} {n} {j}");
                    }
                }
            }
        }
    }

    #[test]
    fn restoring_the_end_preserves_the_end_curvatures() {
        let original = bent();
        let target = original.end();
        let mut moved = original.clone();
        moved.knots[2] += 2e-3;
        moved.knots[5] -= 3e-3;
        moved.lengths[1] += 0.3;
        assert!((moved.end().position - target.position).norm() > 0.1);
        assert!(moved.restore(&target));
        let end = moved.end();
        assert!((end.position - target.position).norm() < 1e-9 && (end.yaw - target.yaw).abs() < 1e-9);
        assert_eq!((moved.knots[0], moved.knots[9]), (original.knots[0], original.knots[9]));
        assert!(!moved.restore(&Pose::new(500.0, 0.0, 0.0)), "an end out of reach must fail");
    }

    #[test]
    fn restores_straight_chains_longitudinally_and_laterally() {
        let mut chain = Chain { knots: vec![0.0; 7], lengths: vec![10.0, 12.0] };
        assert!(chain.restore(&Pose::new(21.9, 0.2, 0.01)));
    }

    #[test]
    fn rejects_a_jump_of_curvature() {
        let spirals = bent().spirals();
        assert_eq!(Chain::of(&spirals), Some(bent()));
        assert_eq!(Chain::of(&[spirals[0], spirals[2]]), None);
        assert_eq!(Chain::of(&[]), None);
    }
}
