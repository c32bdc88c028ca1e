//! The only conversion between nalgebra types and rapier's glam types.
//!
//! The physics world has its origin near the start of the run: UTM coordinates would lose digits in it.

use rapier2d::math::{Pose as RapierPose, Vector as RapierVector};

use crate::geometry::{Point, Pose, Vector};

/// The frame of the physics world: world coordinates minus an origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    origin: Vector,
}

impl Frame {
    pub(super) fn at(origin: Point) -> Self {
        Self { origin: origin.coords }
    }

    pub(super) fn point_in(&self, world: Point) -> RapierVector {
        let p = world - self.origin;
        RapierVector::new(p.x, p.y)
    }

    pub(super) fn pose_in(&self, world: &Pose) -> RapierPose {
        RapierPose::new(self.point_in(world.position), world.yaw)
    }

    /// The yaw is in (−π, π].
    pub(super) fn pose_out(&self, physics: &RapierPose) -> Pose {
        Pose { position: point(physics.translation) + self.origin, yaw: physics.rotation.angle() }
    }
}

pub(super) fn point(p: RapierVector) -> Point {
    Point::new(p.x, p.y)
}

pub(super) fn vector(v: Vector) -> RapierVector {
    RapierVector::new(v.x, v.y)
}

pub(super) fn local(p: Point) -> RapierVector {
    RapierVector::new(p.x, p.y)
}
