//! Evaluation of a curve, independent of the method that computed it.
//!
//! The ends of spirals come from Simpson's rule on a fine grid (the solvers use Gauss–Legendre quadrature), the maximum
//! curvature from 10,000 samples in addition to the closed form.

use super::shooting::simpson_end;
use crate::bench::problems::LatticeProblem;
use crate::geometry::quintic::QuinticPath;
use crate::geometry::spiral::{CubicSpiral, QuinticSpiral};
use crate::geometry::{Pose, Vector, wrap_angle};

/// Number of curvature samples along a curve.
const SAMPLES: u32 = 10_000;
/// Intervals of Simpson's rule for the end of a spiral: an error below 1e-11 m on 40 m.
const INTERVALS: u32 = 4000;

/// A curve in its start frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Curve {
    /// Cubic spiral.
    Cubic(CubicSpiral),
    /// Quintic spiral.
    Quintic(QuinticSpiral),
    /// Quintic polynomial path.
    Polynomial(QuinticPath),
}

/// The solution of a method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// The curve.
    pub curve: Curve,
    /// Lateral displacement of the end from the requested pose as reported by the method, positive to the left, m.
    pub slide: f64,
}

/// Metrics of an answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evaluation {
    /// Distance of the curve's end from the end that the method reports, m.
    pub end_residual: f64,
    /// Heading error at the end, rad.
    pub heading_residual: f64,
    /// Absolute lateral displacement of the end from the requested pose, m.
    pub slide: f64,
    /// Maximum |curvature|, 1/m.
    pub max_curvature: f64,
    /// Bending energy ∫ κ² ds, 1/m.
    pub bending_energy: f64,
    /// Length, m.
    pub length: f64,
}

impl Answer {
    /// Evaluates the answer to a problem.
    #[must_use]
    pub fn evaluate(&self, problem: &LatticeProblem) -> Evaluation {
        let curve = &self.curve;
        let end = curve.end();
        let reported = problem.end.position + problem.end.left() * self.slide;
        Evaluation {
            end_residual: (end.position - reported).norm(),
            heading_residual: wrap_angle(end.yaw - problem.end.yaw).abs(),
            slide: self.slide.abs(),
            max_curvature: curve.max_abs_curvature(),
            bending_energy: curve.bending_energy(),
            length: curve.length(),
        }
    }
}

impl Curve {
    /// The end of the curve from the origin with heading 0.
    #[must_use]
    pub fn end(&self) -> Pose {
        match self {
            Self::Cubic(spiral) => {
                let end: Vector = simpson_end(spiral, INTERVALS);
                Pose { position: end.into(), yaw: spiral.heading_change(spiral.length) }
            }
            Self::Quintic(spiral) => {
                let end: Vector = simpson_end(spiral, INTERVALS);
                Pose { position: end.into(), yaw: spiral.heading_change(spiral.length) }
            }
            Self::Polynomial(path) => path.end(&Pose::new(0.0, 0.0, 0.0)),
        }
    }

    /// Curvature at a parameter in [0, 1], 1/m. The parameter is the normalised arc length, or the parameter of a
    /// polynomial path.
    #[must_use]
    pub fn curvature(&self, parameter: f64) -> f64 {
        match self {
            Self::Cubic(spiral) => spiral.curvature(parameter * spiral.length),
            Self::Quintic(spiral) => spiral.curvature(parameter * spiral.length),
            Self::Polynomial(path) => path.curvature(parameter),
        }
    }

    /// Maximum |curvature|, 1/m: over 10,001 samples and the closed form (for polynomial paths, the zeros of the
    /// derivative).
    #[must_use]
    pub fn max_abs_curvature(&self) -> f64 {
        let closed_form = match self {
            Self::Cubic(spiral) => spiral.max_abs_curvature(),
            Self::Quintic(spiral) => spiral.max_abs_curvature(),
            Self::Polynomial(path) => path.max_abs_curvature(),
        };
        let samples = (0..=SAMPLES).map(|i| self.curvature(f64::from(i) / f64::from(SAMPLES)).abs());
        samples.fold(closed_form, f64::max)
    }

    /// Bending energy ∫ κ² ds, 1/m.
    #[must_use]
    pub fn bending_energy(&self) -> f64 {
        match self {
            Self::Cubic(spiral) => spiral.bending_energy(),
            Self::Quintic(spiral) => spiral.bending_energy(),
            Self::Polynomial(path) => path.bending_energy(),
        }
    }

    /// Length, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        match self {
            Self::Cubic(spiral) => spiral.length,
            Self::Quintic(spiral) => spiral.length,
            Self::Polynomial(path) => path.length(),
        }
    }

    /// `intervals` + 1 points at equal distances of arc length: arc length (m), position, curvature (1/m).
    #[must_use]
    pub fn sampled(&self, intervals: usize) -> Vec<(f64, crate::geometry::Point, f64)> {
        let start = Pose::new(0.0, 0.0, 0.0);
        let samples = match self {
            Self::Cubic(spiral) => spiral.sampled(&start, intervals),
            Self::Quintic(spiral) => spiral.sampled(&start, intervals),
            Self::Polynomial(path) => path.sampled(&start, intervals),
        };
        samples.into_iter().map(|(s, p)| (s, p.pose.position, p.curvature)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::spiral::connect;

    fn problem() -> LatticeProblem {
        LatticeProblem { start_curvature: 0.02, end: Pose::new(20.0, 3.0, 0.2), end_curvature: -0.05 }
    }

    #[test]
    fn detects_a_wrong_length_and_a_wrong_slide() {
        let p = problem();
        let spiral = connect(p.start_curvature, &p.end, p.end_curvature).unwrap();
        let exact = Answer { curve: Curve::Cubic(spiral), slide: 0.0 }.evaluate(&p);
        assert!(exact.end_residual < 1e-9 && exact.heading_residual < 1e-12, "{exact:?}");
        let longer = CubicSpiral { length: spiral.length + 0.01, ..spiral };
        let wrong = Answer { curve: Curve::Cubic(longer), slide: 0.0 }.evaluate(&p);
        assert!((wrong.end_residual - 0.01).abs() < 2e-3 && wrong.heading_residual > 1e-5, "{wrong:?}");
        // the method reports a displacement of half a metre that the curve does not have
        let displaced = Answer { curve: Curve::Cubic(spiral), slide: 0.5 }.evaluate(&p);
        assert!((displaced.end_residual - 0.5).abs() < 1e-9 && displaced.slide == 0.5, "{displaced:?}");
    }
}
