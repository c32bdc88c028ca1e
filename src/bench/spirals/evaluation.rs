//! What a curve is worth, found by other means than those that made it.
//!
//! Ends of spirals come from Simpson's rule on a fine grid (the solvers use Gauss–Legendre), the largest curvature from
//! 10,000 samples beside the closed form.

use super::shooting::simpson_end;
use crate::bench::problems::LatticeProblem;
use crate::geometry::quintic::QuinticPath;
use crate::geometry::spiral::{CubicSpiral, QuinticSpiral};
use crate::geometry::{Pose, Vector, wrap_angle};

/// Samples of the curvature along a curve, beside its closed form.
const SAMPLES: u32 = 10_000;
/// Simpson intervals for the end of a spiral: below 1e-11 m on 40 m.
const INTERVALS: u32 = 4000;

/// A curve of any kind, in its start frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Curve {
    /// Cubic spiral.
    Cubic(CubicSpiral),
    /// Quintic spiral.
    Quintic(QuinticSpiral),
    /// Quintic polynomial path.
    Polynomial(QuinticPath),
}

/// What a method came up with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// The curve.
    pub curve: Curve,
    /// How far to the left of the wanted end, across its heading, the method says that it ends, m.
    pub slide: f64,
}

/// What an answer is worth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evaluation {
    /// Distance of the curve's end from where the method says it is, m.
    pub end_residual: f64,
    /// Difference of the heading there, rad.
    pub heading_residual: f64,
    /// Distance across the wanted end's heading that the method gave up, m.
    pub slide: f64,
    /// Largest |curvature|, 1/m.
    pub max_curvature: f64,
    /// Bending energy ∫ κ² ds, 1/m.
    pub bending_energy: f64,
    /// Length, m.
    pub length: f64,
}

impl Answer {
    /// Judges the answer to a problem.
    #[must_use]
    pub fn evaluate(&self, problem: &LatticeProblem) -> Evaluation {
        let curve = &self.curve;
        let end = curve.end();
        let said = problem.end.position + problem.end.left() * self.slide;
        Evaluation {
            end_residual: (end.position - said).norm(),
            heading_residual: wrap_angle(end.yaw - problem.end.yaw).abs(),
            slide: self.slide.abs(),
            max_curvature: curve.max_abs_curvature(),
            bending_energy: curve.bending_energy(),
            length: curve.length(),
        }
    }
}

impl Curve {
    /// The end from the origin with heading 0.
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

    /// Curvature at a share of the way, 1/m. The share is of arc length, or of the parameter for a polynomial path.
    #[must_use]
    pub fn curvature(&self, share: f64) -> f64 {
        match self {
            Self::Cubic(spiral) => spiral.curvature(share * spiral.length),
            Self::Quintic(spiral) => spiral.curvature(share * spiral.length),
            Self::Polynomial(path) => path.curvature(share),
        }
    }

    /// Largest |curvature|, 1/m: of 10,001 samples and of the closed form (for polynomial paths, of the zeros of the
    /// derivative).
    #[must_use]
    pub fn max_abs_curvature(&self) -> f64 {
        let known = match self {
            Self::Cubic(spiral) => spiral.max_abs_curvature(),
            Self::Quintic(spiral) => spiral.max_abs_curvature(),
            Self::Polynomial(path) => path.max_abs_curvature(),
        };
        let samples = (0..=SAMPLES).map(|i| self.curvature(f64::from(i) / f64::from(SAMPLES)).abs());
        samples.fold(known, f64::max)
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

    /// `intervals` + 1 points equally spaced in arc length: arc length, position, curvature.
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
    fn what_is_wrong_with_a_spiral_is_seen() {
        let p = problem();
        let spiral = connect(p.start_curvature, &p.end, p.end_curvature).unwrap();
        let right = Answer { curve: Curve::Cubic(spiral), slide: 0.0 }.evaluate(&p);
        assert!(right.end_residual < 1e-9 && right.heading_residual < 1e-12, "{right:?}");
        let longer = CubicSpiral { length: spiral.length + 0.01, ..spiral };
        let wrong = Answer { curve: Curve::Cubic(longer), slide: 0.0 }.evaluate(&p);
        assert!((wrong.end_residual - 0.01).abs() < 2e-3 && wrong.heading_residual > 1e-5, "{wrong:?}");
        // an end that is said to lie half a metre to the left, and does not
        let claimed = Answer { curve: Curve::Cubic(spiral), slide: 0.5 }.evaluate(&p);
        assert!((claimed.end_residual - 0.5).abs() < 1e-9 && claimed.slide == 0.5, "{claimed:?}");
    }
}
