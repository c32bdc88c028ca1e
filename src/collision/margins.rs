//! Margins of the collision checks: distances that a footprint keeps in addition to the conservative sweep.

use super::drivable::OUTSIDE;

/// Margins to one kind of obstacle, in the axes of the vehicle, m; finite and not negative.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Margins {
    /// Margin to the left and to the right, m.
    pub lateral: f64,
    /// Margin to the front and to the rear, m.
    pub longitudinal: f64,
}

impl Margins {
    /// No margin.
    pub const NONE: Self = Self { lateral: 0.0, longitudinal: 0.0 };

    /// The same on all sides.
    #[must_use]
    pub const fn uniform(margin: f64) -> Self {
        Self { lateral: margin, longitudinal: margin }
    }

    /// A share of them.
    #[must_use]
    pub fn scaled(&self, share: f64) -> Self {
        Self { lateral: share * self.lateral, longitudinal: share * self.longitudinal }
    }

    /// Whether they are at least as wide on each side.
    pub(super) fn contain(&self, other: &Self) -> bool {
        self.lateral >= other.lateral && self.longitudinal >= other.longitudinal
    }

    /// Displacement of a corner, m.
    pub(super) fn reach(&self) -> f64 {
        self.lateral.hypot(self.longitudinal)
    }
}

/// The margins of a query: to static obstacles, to moving obstacles and to the road boundary.
///
/// A [`super::CollisionWorld`] has no margins; every query names its own. The bound ε of a footprint depends on the margins of
/// the query ([`super::swept`]), so that none are too wide for a world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SafetyMargins {
    /// Margins to static obstacles and occupied cells, m.
    pub static_obstacles: Margins,
    /// Margins to moving obstacles, m.
    pub moving_obstacles: Margins,
    /// Margin to the road boundary, m.
    pub road: f64,
}

impl SafetyMargins {
    /// No margins.
    pub const NONE: Self = Self { static_obstacles: Margins::NONE, moving_obstacles: Margins::NONE, road: 0.0 };

    /// The wider one of each.
    #[must_use]
    pub fn at_least(&self, other: &Self) -> Self {
        let wider = |a: &Margins, b: &Margins| Margins {
            lateral: a.lateral.max(b.lateral),
            longitudinal: a.longitudinal.max(b.longitudinal),
        };
        Self {
            static_obstacles: wider(&self.static_obstacles, &other.static_obstacles),
            moving_obstacles: wider(&self.moving_obstacles, &other.moving_obstacles),
            road: self.road.max(other.road),
        }
    }

    /// The margins to the boundary of the drivable area, which is inflated.
    pub(super) fn to_boundary(self) -> Margins {
        Margins::uniform(self.road + OUTSIDE)
    }
}
