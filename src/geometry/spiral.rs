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
    /// Coefficients of the curvature in u = s / length, lowest first.
    fn coefficients(&self) -> [f64; 4] {
        let [a, b, c, d] = self.knots;
        [
            a,
            0.5 * (-11.0 * a + 18.0 * b - 9.0 * c + 2.0 * d),
            4.5 * (2.0 * a - 5.0 * b + 4.0 * c - d),
            4.5 * (d - 3.0 * c + 3.0 * b - a),
        ]
    }

    /// Pose and curvature at arc length `s` from `start`.
    #[must_use]
    pub fn point_at(&self, start: &Pose, s: f64) -> PathPoint {
        let panels = (s.abs() / 2.0).ceil().max(1.0);
        let mut position = start.position;
        for i in 0..panels as usize {
            position += self.panel(start.yaw, s * i as f64 / panels, s / panels);
        }
        self.finish(start, s, position)
    }

    fn heading(&self, s: f64) -> f64 {
        let [a, b, c, d] = self.coefficients();
        let u = s / self.length;
        s * (a + u * (b / 2.0 + u * (c / 3.0 + u * d / 4.0)))
    }

    fn panel(&self, yaw: f64, from: f64, width: f64) -> super::Vector {
        super::quadrature::GAUSS_5.iter().fold(super::Vector::zeros(), |sum, (node, weight)| {
            let (sin, cos) = (yaw + self.heading(from + width * node)).sin_cos();
            sum + super::Vector::new(cos, sin) * (*weight * width)
        })
    }

    fn finish(&self, start: &Pose, s: f64, position: super::Point) -> PathPoint {
        let [a, b, c, d] = self.coefficients();
        let u = s / self.length;
        PathPoint {
            pose: Pose { position, yaw: start.yaw + self.heading(s) },
            curvature: a + u * (b + u * (c + u * d)),
            curvature_rate: (b + u * (2.0 * c + u * 3.0 * d)) / self.length,
        }
    }

    /// `intervals` + 1 points at equal spacing, both ends included, each with its arc length.
    pub fn samples(&self, start: &Pose, intervals: usize) -> impl Iterator<Item = (f64, PathPoint)> + use<> {
        let (spiral, start) = (*self, *start);
        let mut position = start.position;
        let width = spiral.length / intervals as f64;
        (0..=intervals).map(move |i| {
            let s = spiral.length * i as f64 / intervals as f64;
            if i > 0 {
                position += spiral.panel(start.yaw, s - width, width);
            }
            (s, spiral.finish(&start, s, position))
        })
    }
}
