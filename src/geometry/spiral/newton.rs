//! The cubic spiral between two poses with given curvatures, by Newton's method.
//!
//! A square system: three unknowns (two inner knots, length) and three conditions (end position and heading). The end
//! heading is linear in the inner knots and is eliminated, so that Newton's method has two unknowns. Its Jacobian is
//! analytic.
//!
//! Weak where the heading changes by more than half a turn ([`connect`] takes the heading modulo 2π) and where the end
//! lies beside or behind the start. A cubic has no freedom left there, and `connect` returns a failure instead of a path
//! with loops.

use thiserror::Error;

use super::{CubicSpiral, panels};
use crate::geometry::quadrature::{GAUSS_3, GAUSS_8};
use crate::geometry::{Point, Pose, Vector, wrap_angle};

/// Why no spiral connects the two ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum SpiralFailure {
    /// An input is not a finite number.
    #[error("an end condition is not a finite number")]
    NotFinite,
    /// Start and end are less than a millimetre apart.
    #[error("start and end coincide")]
    Coincident,
    /// The end lies behind the start: no forward path without a loop.
    #[error("the end lies behind the start")]
    Behind,
    /// Newton's method or the convex program did not converge, or converged to a path with loops.
    #[error("the iteration did not converge")]
    NotConverged,
    /// No spiral within the curvature bound reaches the end, even with a sideways slide.
    #[error("no spiral within the curvature bound reaches the end")]
    CurvatureBound,
}

/// Position error at which Newton's method stops, m: a tenth of the promised error.
const POSITION_TOLERANCE: f64 = 1e-10;
/// Iteration limit. Newton's method converges in three to six iterations where there is a useful solution.
const MAX_ITERATIONS: usize = 20;
/// Halvings of a Newton step that does not reduce the residual.
const MAX_HALVINGS: usize = 5;
/// A spiral longer than this many chords has loops (a half circle has 1.57).
const MAX_DETOUR: f64 = 3.0;

/// Solves for the cubic spiral from the origin with heading 0 and `start_curvature` (1/m) to the pose `end` (in that
/// frame; its heading is wrapped to (−π, π]) with `end_curvature` (1/m). End position to 1e-9 m, end heading to rounding.
///
/// # Errors
/// See [`SpiralFailure`]; never [`SpiralFailure::CurvatureBound`], since there is no bound here.
pub fn connect(start_curvature: f64, end: &Pose, end_curvature: f64) -> Result<CubicSpiral, SpiralFailure> {
    let target = end.position.coords;
    if ![target.x, target.y, end.yaw, start_curvature, end_curvature].iter().all(|v| v.is_finite()) {
        return Err(SpiralFailure::NotFinite);
    }
    let chord = target.norm();
    if chord < 1e-3 {
        return Err(SpiralFailure::Coincident);
    }
    if target.x < 0.0 && end.to_local(Point::origin()).x > 0.0 {
        return Err(SpiralFailure::Behind);
    }
    let problem = Boundary { start_curvature, end_curvature, heading: wrap_angle(end.yaw), target };
    let (mut length, mut asymmetry) = problem.start();
    let mut shot = problem.shoot(length, asymmetry);
    for _ in 0..MAX_ITERATIONS {
        let size = shot.error.norm();
        if size <= POSITION_TOLERANCE {
            let short = length <= MAX_DETOUR * chord;
            return if short { Ok(problem.spiral(length, asymmetry)) } else { Err(SpiralFailure::NotConverged) };
        }
        let Some(inverse) = shot.jacobian.try_inverse() else { return Err(SpiralFailure::NotConverged) };
        let step = -(inverse * shot.error);
        // the length must stay positive: limit steps that would more than halve it
        let mut ratio = if step.x < -0.5 * length { -0.5 * length / step.x } else { 1.0 };
        let mut next = problem.shoot(length + ratio * step.x, asymmetry + ratio * step.y);
        for _ in 0..MAX_HALVINGS {
            if next.error.norm() < size {
                break;
            }
            ratio *= 0.5;
            next = problem.shoot(length + ratio * step.x, asymmetry + ratio * step.y);
        }
        length += ratio * step.x;
        asymmetry += ratio * step.y;
        shot = next;
        if !(shot.error.norm().is_finite() && length <= 10.0 * MAX_DETOUR * chord) {
            return Err(SpiralFailure::NotConverged);
        }
    }
    Err(SpiralFailure::NotConverged)
}

/// The two-point problem of [`connect`] with the end heading eliminated. Unknowns: length L and asymmetry d = k₁ − k₂;
/// the sum of the inner knots follows from heading = L (k₀ + 3k₁ + 3k₂ + k₃)/8.
struct Boundary {
    start_curvature: f64,
    end_curvature: f64,
    heading: f64,
    target: Vector,
}

/// End of a trial spiral.
struct Shot {
    /// End of the trial minus target, m.
    error: Vector,
    /// Derivatives of the end by (length, asymmetry).
    jacobian: nalgebra::Matrix2<f64>,
}

/// ∫ (N₁ + N₂)/2 and ∫ (N₁ − N₂)/2 from 0 to u, of the Lagrange basis.
fn inner_knot_integrals(u: f64) -> (f64, f64) {
    let even = u * u * (1.125 - 0.75 * u);
    let odd = u * u * (3.375 + u * (-6.75 + u * 3.375));
    (even, odd)
}

impl Boundary {
    fn spiral(&self, length: f64, asymmetry: f64) -> CubicSpiral {
        let sum = (8.0 * self.heading / length - self.start_curvature - self.end_curvature) / 3.0;
        let knots = [self.start_curvature, 0.5 * (sum + asymmetry), 0.5 * (sum - asymmetry), self.end_curvature];
        CubicSpiral { knots, length }
    }

    /// Initial guess of (length, asymmetry), for small deviations from the chord: the mean heading is the direction of
    /// the chord, and a heading that deviates from it by δ lengthens the path by δ²/2.
    fn start(&self) -> (f64, f64) {
        let chord = self.target.norm();
        let direction = self.target.y.atan2(self.target.x);
        // a circular arc
        let mut length = chord * (1.0 + self.heading * self.heading / 24.0);
        let mut asymmetry = 0.0;
        for _ in 0..2 {
            // the mean over u of the heading is L ∫ (1−u) κ du: linear in the asymmetry, by 9/80 each
            let mean = length * mean_heading(&self.spiral(length, 0.0).knots);
            asymmetry = (direction - mean) / (length * (9.0 / 80.0));
            let cubic = self.spiral(length, asymmetry).curvature_polynomial();
            let cosine: f64 =
                GAUSS_3.iter().map(|(u, w)| w * (length * cubic.integral(*u) - direction).cos()).sum::<f64>();
            length = chord / cosine.max(0.5);
        }
        (length, asymmetry)
    }

    fn shoot(&self, length: f64, asymmetry: f64) -> Shot {
        let spiral = self.spiral(length, asymmetry);
        let cubic = spiral.curvature_polynomial();
        let panels = panels::<4>(spiral.turning_bound());
        let width = 1.0 / panels as f64;
        // ∫ of: tangent, ∂/∂L and ∂/∂d of the heading times the normal
        let (mut tangent, mut by_length, mut by_asymmetry) = (Vector::zeros(), Vector::zeros(), Vector::zeros());
        for panel in 0..panels {
            for (node, weight) in &GAUSS_8 {
                let u = width * (panel as f64 + node);
                let theta = length * cubic.integral(u);
                let (even, odd) = inner_knot_integrals(u);
                // L·∂θ/∂L with fixed curvature, plus the change of the sum of the inner knots
                let length_share = theta - (8.0 / 3.0) * self.heading * even;
                let (sin, cos) = theta.sin_cos();
                let normal = Vector::new(-sin, cos) * *weight;
                tangent += Vector::new(cos, sin) * *weight;
                by_length += normal * length_share;
                by_asymmetry += normal * odd;
            }
        }
        let jacobian =
            nalgebra::Matrix2::from_columns(&[(tangent + by_length) * width, by_asymmetry * (width * length * length)]);
        Shot { error: tangent * (length * width) - self.target, jacobian }
    }
}

/// ∫₀¹ (1 − u) κ(u) du of the cubic through four knots.
fn mean_heading([k0, k1, k2, k3]: &[f64; 4]) -> f64 {
    (13.0 * k0 + 36.0 * k1 + 9.0 * k2 + 2.0 * k3) / 120.0
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::bench::problems;

    /// A lattice problem: start curvature, end pose, end curvature.
    pub(crate) type Problem = (f64, Pose, f64);

    /// The problems of the published benchmark, as tuples.
    pub(crate) fn lattice_problems(count: usize) -> Vec<Problem> {
        let problems = problems::lattice_problems(problems::SEED, count);
        problems.into_iter().map(|p| (p.start_curvature, p.end, p.end_curvature)).collect()
    }

    #[test]
    fn all_lattice_problems_are_solved_to_a_nanometre() {
        for (start, end, curvature) in lattice_problems(2000) {
            let spiral = connect(start, &end, curvature).unwrap_or_else(|e| panic!("{start} {end:?} {curvature}: {e}"));
            let reached = spiral.point_at(&Pose::new(0.0, 0.0, 0.0), spiral.length);
            assert!((reached.pose.position - end.position).norm() < 1e-9);
            assert!((reached.pose.yaw - end.yaw).abs() < 1e-12);
            assert_eq!((spiral.knots[0], spiral.knots[3]), (start, curvature));
            assert!(spiral.length >= end.position.coords.norm() * (1.0 - 1e-12));
            // a path longer than twice the chord would have a loop or a hairpin
            assert!(spiral.length < 2.0 * end.position.coords.norm(), "{spiral:?} for {end:?}");
        }
    }

    #[test]
    fn mirrored_problems_have_mirrored_spirals_to_the_bit() {
        for (start, end, curvature) in lattice_problems(200) {
            let mirrored_end = Pose::new(end.position.x, -end.position.y, -end.yaw);
            let direct = connect(start, &end, curvature).unwrap();
            assert_eq!(connect(-start, &mirrored_end, -curvature).unwrap(), direct.mirrored());
        }
    }

    #[test]
    fn a_problem_twice_as_large_has_a_spiral_twice_as_long() {
        for (start, end, curvature) in lattice_problems(200) {
            let large_end = Pose::new(2.0 * end.position.x, 2.0 * end.position.y, end.yaw);
            let small = connect(start, &end, curvature).unwrap();
            let large = connect(start / 2.0, &large_end, curvature / 2.0).unwrap();
            assert!((large.length - 2.0 * small.length).abs() < 1e-8);
            for (l, s) in large.knots.iter().zip(small.knots) {
                assert!((2.0 * l - s).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn jacobian_agrees_with_differences() {
        for (start_curvature, end, end_curvature) in lattice_problems(50) {
            let problem = Boundary { start_curvature, end_curvature, heading: end.yaw, target: end.position.coords };
            let (length, asymmetry) = problem.start();
            let (h, k) = (1e-4, 1e-6);
            let by_length =
                (problem.shoot(length + h, asymmetry).error - problem.shoot(length - h, asymmetry).error) / (2.0 * h);
            let by_asymmetry =
                (problem.shoot(length, asymmetry + k).error - problem.shoot(length, asymmetry - k).error) / (2.0 * k);
            let analytic = problem.shoot(length, asymmetry).jacobian;
            assert!((analytic.column(0) - by_length).norm() < 1e-6, "{analytic} {by_length}");
            assert!((analytic.column(1) - by_asymmetry).norm() < 1e-4 * (1.0 + by_asymmetry.norm()));
        }
    }

    #[test]
    fn each_invalid_input_has_its_failure() {
        let ahead = Pose::new(20.0, 1.0, 0.1);
        assert!(connect(0.0, &ahead, 0.0).is_ok());
        assert_eq!(connect(f64::NAN, &ahead, 0.0), Err(SpiralFailure::NotFinite));
        assert_eq!(connect(0.0, &ahead, f64::INFINITY), Err(SpiralFailure::NotFinite));
        assert_eq!(connect(0.0, &Pose::new(f64::NAN, 0.0, 0.0), 0.0), Err(SpiralFailure::NotFinite));
        assert_eq!(connect(0.0, &Pose::new(0.0, 0.0, 0.0), 0.0), Err(SpiralFailure::Coincident));
        assert_eq!(connect(0.0, &Pose::new(-10.0, 1.0, 0.0), 0.0), Err(SpiralFailure::Behind));
        // large but finite input terminates with a spiral or a failure
        let _ = connect(1e300, &ahead, -1e300);
        let _ = connect(0.0, &Pose::new(1e200, 1e200, 3.0), 0.0);
    }

    #[test]
    fn solves_a_half_circle() {
        let spiral = connect(0.1, &Pose::new(0.0, 20.0, std::f64::consts::PI), 0.1).unwrap();
        assert!((spiral.length - 10.0 * std::f64::consts::PI).abs() < 1e-8);
        assert!((spiral.max_abs_curvature() - 0.1).abs() < 1e-9);
    }
}
