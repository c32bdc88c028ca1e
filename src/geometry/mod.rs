//! Plane geometry that every stage shares: poses, angles, polylines, polynomial spirals.
//!
//! | module | contents |
//! |---|---|
//! | [`polyline`] | chains of straight segments by arc length; projection of points |
//! | [`spiral`] | curves whose curvature is a polynomial of arc length; evaluation, projection, Newton's method |
//! | [`boundary`] | spirals of least bending energy under end conditions and bounds of curvature and its rate |
//! | [`spiral_opt`] | spirals under a curvature bound whose end may slide sideways, for lattice edges |
//! | [`quintic`] | x and y as quintic polynomials: the alternative that the spirals are compared with |
//! | [`quadrature`] | Gauss–Legendre rules |
//! | [`steps`] | numbers of equal steps in a length, independent of rounding |
//!
//! # Frame and units
//!
//! x points east or forward, y north or left; yaw is counter-clockwise from +x. SI units, radians. Curvature, lateral
//! offset and steering are positive to the left: a path with positive curvature turns left.
//!
//! Coordinates are `f64`. In UTM coordinates of 5·10⁶ m the resolution is 1·10⁻⁹ m; functions that promise a nanometre
//! promise it relative to the start of the curve.

pub mod boundary;
pub mod polyline;
pub mod quadrature;
pub mod quintic;
pub mod spiral;
pub mod spiral_opt;
pub mod steps;

/// A position in the plane, metres.
pub type Point = nalgebra::Point2<f64>;
/// A displacement in the plane, metres.
pub type Vector = nalgebra::Vector2<f64>;

/// A position with a heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Position, m.
    pub position: Point,
    /// Heading, rad, counter-clockwise from +x. Not wrapped: consumers that compare use [`wrap_angle`].
    pub yaw: f64,
}

impl Pose {
    /// A pose from its coordinates (m, m, rad).
    #[must_use]
    pub fn new(x: f64, y: f64, yaw: f64) -> Self {
        Self { position: Point::new(x, y), yaw }
    }

    /// Unit vector along the heading.
    #[must_use]
    pub fn forward(&self) -> Vector {
        let (sin, cos) = self.yaw.sin_cos();
        Vector::new(cos, sin)
    }

    /// Unit vector to the left of the heading.
    #[must_use]
    pub fn left(&self) -> Vector {
        let (sin, cos) = self.yaw.sin_cos();
        Vector::new(-sin, cos)
    }

    /// The pose moved by `distance` (m) along its heading; negative moves it backwards. Converts between the rear axle
    /// and the centre of a vehicle.
    #[must_use]
    pub fn advanced(&self, distance: f64) -> Self {
        Self { position: self.position + self.forward() * distance, yaw: self.yaw }
    }

    /// Transforms a point from the frame of this pose into the world frame.
    #[must_use]
    pub fn to_world(&self, local: Point) -> Point {
        self.position + self.forward() * local.x + self.left() * local.y
    }

    /// Transforms a point from the world frame into the frame of this pose (x forward, y left).
    #[must_use]
    pub fn to_local(&self, world: Point) -> Point {
        let d = world - self.position;
        Point::new(d.dot(&self.forward()), d.dot(&self.left()))
    }

    /// Interpolates between `self` (`ratio` 0) and `other` (`ratio` 1): position linearly, yaw along the shorter arc.
    #[must_use]
    pub fn interpolated(&self, other: &Self, ratio: f64) -> Self {
        Self {
            position: self.position + (other.position - self.position) * ratio,
            yaw: self.yaw + wrap_angle(other.yaw - self.yaw) * ratio,
        }
    }
}

/// Wraps an angle (rad) to (−π, π]. Angles inside this range come back unchanged, to the bit.
#[must_use]
pub fn wrap_angle(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if -PI < angle && angle <= PI {
        return angle; // no rounding, so that mirrored inputs give mirrored results
    }
    let wrapped = angle.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// z component of the cross product: positive when `b` points to the left of `a`.
#[must_use]
pub fn cross(a: Vector, b: Vector) -> f64 {
    a.x * b.y - a.y * b.x
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    #[test]
    fn wrap_angle_keeps_pi_and_folds_minus_pi() {
        assert_eq!(wrap_angle(PI), PI);
        assert!((wrap_angle(-PI) - PI).abs() < 1e-15);
        assert!((wrap_angle(3.0 * PI) - PI).abs() < 1e-14);
    }

    proptest! {
        #[test]
        fn local_and_world_frames_are_inverse(x in -1e6..1e6, y in -1e6..1e6, yaw in -10.0..10.0, u in -50.0..50.0, v in -50.0..50.0) {
            let pose = Pose::new(x, y, yaw);
            let local = Point::new(u, v);
            let back = pose.to_local(pose.to_world(local));
            // 1e6 m leaves about 1e-10 m of resolution in f64
            prop_assert!((back - local).norm() < 1e-8, "{pose:?}: {local} became {back}");
        }
    }
}
