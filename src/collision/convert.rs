//! Conversion between the points of this crate and the vectors of parry (glam).
//!
//! Everything in [`crate::collision`] is computed relative to an [`Origin`] near the road, so that UTM coordinates
//! (about 1e6 m, where an `f64` still resolves 1e-10 m) cost no accuracy in products of coordinates.

use crate::geometry::{Point, Pose};

/// A position relative to the [`Origin`], m; parry's vector type.
pub(super) type Local = parry2d::math::Vector;

/// The world point that all collision geometry is relative to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Origin(Point);

impl Origin {
    /// The centre of the bounding box of the points, in integer metres; the world origin if no point is finite.
    pub(super) fn amid<'a>(points: impl IntoIterator<Item = &'a Point>) -> Self {
        let mut bounds: Option<(Point, Point)> = None;
        for p in points.into_iter().filter(|p| p.x.is_finite() && p.y.is_finite()) {
            let (low, high) = bounds.get_or_insert((*p, *p));
            *low = Point::new(low.x.min(p.x), low.y.min(p.y));
            *high = Point::new(high.x.max(p.x), high.y.max(p.y));
        }
        Self(bounds.map_or(Point::origin(), |(low, high)| nalgebra::center(&low, &high).map(f64::round)))
    }

    pub(super) fn local(&self, p: Point) -> Local {
        Local::new(p.x - self.0.x, p.y - self.0.y)
    }

    pub(super) fn world(&self, p: Local) -> Point {
        Point::new(p.x + self.0.x, p.y + self.0.y)
    }

    pub(super) fn local_pose(&self, pose: &Pose) -> Pose {
        Pose { position: pose.position - self.0.coords, yaw: pose.yaw }
    }
}

/// A point that is already relative to the origin, as a parry vector.
pub(super) fn vector(p: Point) -> Local {
    Local::new(p.x, p.y)
}
