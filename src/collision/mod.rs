//! Collision checks: swept footprints against the road boundary, static and moving obstacles.
//!
//! # Queries
//!
//! Every query names its margins ([`SafetyMargins`]); a world has none.
//!
//! - A lattice edge or a path ([`CollisionWorld::probe`]): the first station at which the swept footprint meets a static
//!   obstacle or leaves the road ([`EdgeProbe::static_hit`]), and its clearance ([`EdgeProbe::clearance`]).
//! - A chain of edges, swept ([`CollisionWorld::sweep`]): the times at which moving obstacles block each station cell ([`CollisionWorld::blocked`]).
//! - The start: the obstacle or boundary that the vehicle already overlaps ([`CollisionWorld::start_overlap`]).
//!
//! # Technique
//!
//! Footprints are conservative: hulls of the vehicle's rectangle, or of each of its parts (`outline`), at neighbouring
//! sampled poses, inflated by a bound from curvature and spacing (derived in [`swept`]). Predictions are hulls over time
//! slices ([`moving`]); the road is the union of its lanelets ([`drivable`]). The broad phase uses parry's bounding volume
//! hierarchies for the world and boxes merged along the path for sweeps. The narrow phase is a separating-axis test. There
//! are no false negatives for the vehicle and the obstacle motion that the map describes; false positives are within some
//! centimetres at the default settings.
//!
//! # Weaknesses
//!
//! Predictions are assumed to be exact, unless reachable sets replace them ([`uncertainty`]). Stations are resolved to a
//! cell (0.5 m), times to a slice (0.1 s). Only the margins cover tracking errors.
//!
//! All poses are those of the rear axle in world coordinates; times are seconds since time step 0 of the file.

mod blocked;
mod coarse;
mod convert;
mod convex;
mod course;
pub mod drivable;
mod margins;
pub mod moving;
mod outline;
pub mod statics;
pub mod swept;
pub mod uncertainty;
mod wide;

pub use blocked::{BlockedGrid, BlockedInterval};
pub use coarse::EdgeProbe;
pub use drivable::DrivableArea;
pub use margins::{Margins, SafetyMargins};
pub use moving::Predictions;
pub use statics::{Allowance, Clearance, StaticHit, StaticWorld};
pub use swept::Sweep;
pub use uncertainty::MotionBounds;

use std::sync::Arc;

use self::convert::Origin;
use self::outline::Outline;
use self::swept::Frame;
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::map::{Motion, Obstacle, OccupancyGrid, RoadNetwork};
use crate::trajectory::Path;
use crate::vehicle::Vehicle;

/// Resolution and margins of the collision checks; the section `[planner.collision]` of a settings file.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CollisionSettings {
    /// Largest length of a station cell, m. Smaller cells have tighter footprints and cost more; the excess grows with the
    /// square of the length.
    pub spacing: f64,
    /// Length of a time slice of the predictions, s.
    pub time_slice: f64,
    /// Margins to static obstacles, m.
    pub static_obstacles: Margins,
    /// Margins to moving obstacles, m.
    pub moving_obstacles: Margins,
    /// Margin to the road boundary, m.
    pub road: f64,
    /// Whether unknown cells of an occupancy grid count as occupied.
    pub unknown_is_occupied: bool,
}

impl Default for CollisionSettings {
    fn default() -> Self {
        Self {
            spacing: 0.5,
            time_slice: 0.1,
            static_obstacles: Margins::uniform(0.2),
            moving_obstacles: Margins::uniform(0.3),
            road: 0.05,
            unknown_is_occupied: false,
        }
    }
}

/// A setting that is out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("collision setting `{field}` is {value}, it must be between {min} and {max}")]
pub struct SettingsError {
    /// Name of the setting.
    pub field: &'static str,
    /// Its value.
    pub value: f64,
    /// Smallest permitted value.
    pub min: f64,
    /// Largest permitted value.
    pub max: f64,
}

impl CollisionSettings {
    /// Checks every value against its range.
    ///
    /// # Errors
    /// The first setting that is out of range or not a number.
    pub fn validate(&self) -> Result<(), SettingsError> {
        // spacing: below a centimetre there is no benefit; above two metres the excess at full lock exceeds half a metre
        let fields = [
            ("spacing", self.spacing, 0.01, 2.0),
            ("time_slice", self.time_slice, 0.01, 1.0),
            ("static_obstacles.lateral", self.static_obstacles.lateral, 0.0, 10.0),
            ("static_obstacles.longitudinal", self.static_obstacles.longitudinal, 0.0, 10.0),
            ("moving_obstacles.lateral", self.moving_obstacles.lateral, 0.0, 10.0),
            ("moving_obstacles.longitudinal", self.moving_obstacles.longitudinal, 0.0, 10.0),
            ("road", self.road, 0.0, 10.0),
        ];
        let wrong = fields.into_iter().find(|(_, value, min, max)| !(min..=max).contains(&value));
        wrong.map_or(Ok(()), |(field, value, min, max)| Err(SettingsError { field, value, min, max }))
    }

    /// The margins, for queries.
    #[must_use]
    pub fn margins(&self) -> SafetyMargins {
        let Self { static_obstacles, moving_obstacles, road, .. } = *self;
        SafetyMargins { static_obstacles, moving_obstacles, road }
    }
}

/// The cause of a blocked path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Blocker {
    /// An obstacle, by its id in the file.
    Obstacle(i64),
    /// A cell of the occupancy grid.
    OccupiedCell,
    /// The road boundary.
    RoadBoundary,
}

/// An overlap of the footprint without margins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overlap {
    /// What the footprint overlaps.
    pub what: Blocker,
    /// Distance that the vehicle would have to move to be free, m: exact for two polygons, an estimate off the road.
    pub depth: f64,
}

/// A road with its static and moving obstacles, for one vehicle. It has a resolution and no margins: every query names its own.
/// Queries are read-only. Copies share the static part.
#[derive(Debug, Clone)]
pub struct CollisionWorld {
    origin: Origin,
    outline: Outline,
    spacing: f64,
    time_slice: f64,
    statics: Arc<StaticWorld>,
    predictions: Predictions,
}

impl CollisionWorld {
    /// Builds the road surface, the static obstacles and the predictions up to `horizon` (s since time step 0 of the file:
    /// the end of the run plus the horizon of the last plan). Of the settings it uses the resolution and `unknown_is_occupied`;
    /// the margins belong to the queries.
    ///
    /// # Errors
    /// A setting out of its range.
    pub fn new(
        network: &RoadNetwork,
        occupancy: Option<&OccupancyGrid>,
        obstacles: &[Obstacle],
        vehicle: &Vehicle,
        settings: &CollisionSettings,
        horizon: f64,
    ) -> Result<Self, SettingsError> {
        settings.validate()?;
        let origin = origin_of(network, occupancy, obstacles);
        let reach = vehicle.footprint.reach();
        Ok(Self {
            origin,
            outline: Outline::new(vehicle),
            spacing: settings.spacing,
            time_slice: settings.time_slice,
            statics: Arc::new(StaticWorld::new(network, occupancy, obstacles, origin, settings, reach)),
            predictions: Predictions::new(obstacles, origin, settings.time_slice, horizon),
        })
    }

    /// The same road and static obstacles with other moving obstacles and another horizon (see [`CollisionWorld::new`]). Static
    /// obstacles among `obstacles` are ignored.
    #[must_use]
    pub fn with_predictions(&self, obstacles: &[Obstacle], horizon: f64) -> Self {
        let predictions = Predictions::new(obstacles, self.origin, self.time_slice, horizon);
        Self { outline: self.outline.clone(), statics: Arc::clone(&self.statics), predictions, ..*self }
    }

    /// The static part.
    #[must_use]
    pub fn statics(&self) -> &StaticWorld {
        &self.statics
    }

    /// The moving part.
    #[must_use]
    pub fn predictions(&self) -> &Predictions {
        &self.predictions
    }

    /// The swept footprint along a spiral.
    #[must_use]
    pub fn sweep(&self, start: &Pose, spiral: &CubicSpiral) -> Sweep {
        Sweep::new(&self.origin, &self.outline, self.spacing, &[(*start, *spiral)])
    }

    /// The swept footprint along a whole path.
    #[must_use]
    pub fn sweep_path(&self, path: &Path) -> Sweep {
        Sweep::new(&self.origin, &self.outline, self.spacing, &swept::pieces_of(path))
    }

    /// A check of a spiral against the static world, without a [`Sweep`].
    #[must_use]
    pub fn probe(&self, start: &Pose, spiral: &CubicSpiral) -> EdgeProbe<'_> {
        EdgeProbe::new(self, &[(*start, *spiral)])
    }

    /// [`CollisionWorld::probe`] of a whole path.
    #[must_use]
    pub fn probe_path(&self, path: &Path) -> EdgeProbe<'_> {
        EdgeProbe::new(self, &swept::pieces_of(path))
    }

    /// The cells that moving obstacles block on consecutive sweeps between two times (s).
    #[must_use]
    pub fn blocked(&self, sweeps: &[&Sweep], margins: &SafetyMargins, from: f64, to: f64) -> BlockedGrid {
        self.predictions.blocked(sweeps, &margins.moving_obstacles, from, to)
    }

    /// [`CollisionWorld::blocked`] at a fine resolution up to a station: subcells of 0.1 m and sub-slices of 0.025 s where a cell is
    /// blocked.
    #[must_use]
    pub fn blocked_finely(
        &self,
        sweeps: &[&Sweep],
        margins: &SafetyMargins,
        times: (f64, f64),
        fine_until: f64,
    ) -> BlockedGrid {
        self.predictions.blocked_finely(sweeps, &margins.moving_obstacles, times, fine_until)
    }

    /// How far the vehicle without margins is off the road at a pose, m; 0 on it. An estimate from the corners of its parts.
    #[must_use]
    pub fn depth_off_road(&self, pose: &Pose) -> f64 {
        let frame = Frame::new(&self.origin.local_pose(pose));
        let mut deepest = 0.0_f64;
        self.outline.for_each_part(&frame, |part| {
            deepest = deepest.max(self.statics.road().depth_outside(part).unwrap_or(0.0));
        });
        deepest
    }

    /// The overlap of the vehicle without margins at a pose and a time (s). An obstacle takes precedence over the road
    /// boundary; of several parts of the vehicle, the one with the largest depth.
    #[must_use]
    pub fn start_overlap(&self, pose: &Pose, time: f64) -> Option<Overlap> {
        let frame = Frame::new(&self.origin.local_pose(pose));
        let is_obstacle = |o: &Overlap| o.what != Blocker::RoadBoundary;
        let mut worst: Option<Overlap> = None;
        self.outline.for_each_part(&frame, |part| {
            let fixed = self.statics.overlap(part);
            let overlap = fixed.filter(is_obstacle).or_else(|| self.predictions.overlap(part, time)).or(fixed);
            let rank = |o: Overlap| (is_obstacle(&o), o.depth);
            if overlap.map(rank) > worst.map(rank) {
                worst = overlap;
            }
        });
        worst
    }
}

/// An origin in the middle of the road, or of the static obstacles and the grid if there is no road.
fn origin_of(network: &RoadNetwork, occupancy: Option<&OccupancyGrid>, obstacles: &[Obstacle]) -> Origin {
    let bounds = network.lanelets.values().flat_map(|l| l.left.points().iter().chain(l.right.points()));
    let poses = obstacles.iter().filter_map(|o| match &o.motion {
        Motion::Static(pose) => Some(&pose.position),
        Motion::Trajectory(_) | Motion::Occupancy(_) => None,
    });
    let grid = occupancy.map(|grid| &grid.origin().position);
    if network.lanelets.is_empty() { Origin::amid(poses.chain(grid)) } else { Origin::amid(bounds) }
}

/// Tolerance of box distances, m. With it rounding cannot exclude a piece, and the smallest distance does not depend on the
/// order of the pieces.
const ROUNDING: f64 = 1e-9;
