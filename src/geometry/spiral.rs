//! Cubic polynomial spirals: curvature is a cubic polynomial of arc length.
//!
//! A spiral is given by its curvature at u = 0, 1/3, 2/3, 1 of normalised arc length and by its length: well
//! conditioned, and the bending energy is a quadratic form in these four knots (Kelly & Nagy 2003; McNaughton 2011).

use super::Pose;
use super::quadrature::GAUSS_5;

/// A cubic spiral, in its own start frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CubicSpiral {
    /// Curvature at u = 0, 1/3, 2/3, 1, in 1/m.
    pub knots: [f64; 4],
    /// Length, m, positive.
    pub length: f64,
}

/// A point of a path: pose, curvature and its derivative by arc length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Pose of the rear axle.
    pub pose: Pose,
    /// Curvature, 1/m.
    pub curvature: f64,
    /// Derivative of curvature by arc length, 1/m².
    pub curvature_rate: f64,
}

impl CubicSpiral {
    /// Coefficients of κ(u) in powers of u.
    fn coefficients(&self) -> [f64; 4] {
        let [a, b, c, d] = self.knots;
        [
            a,
            (-11.0 * a + 18.0 * b - 9.0 * c + 2.0 * d) / 2.0,
            (18.0 * a - 45.0 * b + 36.0 * c - 9.0 * d) / 2.0,
            (-9.0 * a + 27.0 * b - 27.0 * c + 9.0 * d) / 2.0,
        ]
    }

    /// Pose and curvature at arc length `s` from `start`.
    #[must_use]
    pub fn point_at(&self, start: &Pose, s: f64) -> PathPoint {
        const PANELS: usize = 4;
        let [a, b, c, d] = self.coefficients();
        let heading = |u: f64| start.yaw + self.length * u * (a + u * (b / 2.0 + u * (c / 3.0 + u * d / 4.0)));
        let u = s / self.length;
        let (mut x, mut y) = (0.0, 0.0);
        for i in 0..PANELS {
            for (node, weight) in GAUSS_5 {
                let (sin, cos) = heading(u * (i as f64 + node) / PANELS as f64).sin_cos();
                x += weight * cos;
                y += weight * sin;
            }
        }
        let scale = s / PANELS as f64;
        PathPoint {
            pose: Pose::new(start.position.x + x * scale, start.position.y + y * scale, heading(u)),
            curvature: a + u * (b + u * (c + u * d)),
            curvature_rate: (b + u * (2.0 * c + u * 3.0 * d)) / self.length,
        }
    }
}
