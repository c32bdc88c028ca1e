//! Cubic polynomial spirals: curvature is a cubic polynomial of arc length.
//!
//! A spiral is given by its curvature at u = 0, 1/3, 2/3, 1 of normalised arc length and by its length: well
//! conditioned, and the bending energy is a quadratic form in these four knots (Kelly & Nagy 2003; McNaughton 2011).

use super::Pose;

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
    /// Pose and curvature at arc length `s` from `start`.
    #[must_use]
    pub fn point_at(&self, start: &Pose, s: f64) -> PathPoint {
        let s = s.clamp(0.0, self.length);
        let u = if self.length > 0.0 { s / self.length } else { 0.0 };
        let [c0, c1, c2, c3] = self.coefficients();
        let heading = |u: f64| start.yaw + self.length * u * (c0 + u * (c1 / 2.0 + u * (c2 / 3.0 + u * c3 / 4.0)));
        let mut position = start.position;
        const PANELS: usize = 4;
        let width = u / PANELS as f64;
        for panel in 0..PANELS {
            for (node, weight) in super::quadrature::GAUSS_5 {
                let (sin, cos) = heading(width * (panel as f64 + node)).sin_cos();
                position += super::Vector::new(cos, sin) * (weight * width * self.length);
            }
        }
        PathPoint {
            pose: Pose { position, yaw: heading(u) },
            curvature: c0 + u * (c1 + u * (c2 + u * c3)),
            curvature_rate: (c1 + u * (2.0 * c2 + u * 3.0 * c3)) / self.length.max(f64::MIN_POSITIVE),
        }
    }

    /// Coefficients of curvature as a polynomial of u, from the knots (Lagrange at 0, 1/3, 2/3, 1).
    fn coefficients(&self) -> [f64; 4] {
        let [a, b, c, d] = self.knots;
        [
            a,
            0.5 * (-11.0 * a + 18.0 * b - 9.0 * c + 2.0 * d),
            0.5 * (18.0 * a - 45.0 * b + 36.0 * c - 9.0 * d),
            0.5 * (-9.0 * a + 27.0 * b - 27.0 * c + 9.0 * d),
        ]
    }
}
