//! Where the vehicle can't be, and when: swept footprints against the road's edge, static and moving obstacles.
//!
//! **What it answers.** For an edge of the lattice: the first station at which the swept footprint meets something
//! static or leaves the road ([`CollisionWorld::static_hit`]), and how far it stays away ([`CollisionWorld::clearance`]);
//! both without a sweep, coarse to fine, by [`CollisionWorld::probe`], which is what thousands of candidates need.
//! For a chain of edges: the times at which moving obstacles block each station cell ([`CollisionWorld::blocked`]).
//! For the start: what it already overlaps ([`CollisionWorld::start_overlap`]).
//!
//! **Technique.** Footprints are conservative: hulls of the vehicle's rectangle, or of each of its parts (`outline`), at
//! neighbouring sampled poses, grown by a bound from curvature and spacing (derived in [`swept`]). Predictions are hulls over slices of time ([`moving`]), the road
//! is the union of its lanelets ([`drivable`]). Broad phases are parry's bounding volume hierarchies, for what stays
//! the same over a run, and boxes merged along the path, for the sweeps. The narrow phase is a separating-axis test.
//! So there are no false negatives against the vehicle and obstacle motion that the map describes; false positives
//! stay within some centimetres at the default settings.
//!
//! **Weakness.** It believes the predictions, unless it is asked about motions around them ([`uncertainty`]). Stations are resolved to the cell (0.5 m), times to the slice (0.1 s).
//! Where the vehicle drifts off its path, only the margins protect it.
//!
//! All poses are those of the rear axle, in world coordinates; times are seconds since time step 0 of the file.

mod blocked;
mod coarse;
mod convert;
mod convex;
mod course;
pub mod drivable;
pub mod moving;
mod outline;
pub mod statics;
pub mod swept;
pub mod uncertainty;
mod wide;

pub use blocked::{BlockedGrid, BlockedInterval};
pub use coarse::EdgeProbe;
pub use drivable::DrivableArea;
pub use moving::Predictions;
pub use statics::{Allowance, Clearance, StaticHit, StaticWorld};
pub use swept::{Margins, Sweep};
pub use uncertainty::MotionBounds;

use parry2d::bounding_volume::Aabb;
use parry2d::partitioning::Bvh;

use self::convert::{Local, Origin};
use self::convex::{Convex, box_distance};
use self::outline::Outline;
use self::swept::Frame;
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::map::{Motion, Scenario};
use crate::trajectory::Path;
use crate::vehicle::Vehicle;

/// Resolution and margins of the collision checks.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CollisionSettings {
    /// Length of a station cell at most, m. Smaller cells are tighter and cost more; the excess grows with its square.
    pub spacing: f64,
    /// Length of a time slice of the predictions, s.
    pub time_slice: f64,
    /// Distance kept from static obstacles.
    pub static_obstacles: Margins,
    /// Distance kept from moving obstacles.
    pub moving_obstacles: Margins,
    /// Distance kept from the road's edge, m.
    pub road: f64,
    /// Whether cells of an occupancy grid that nobody knows count as occupied.
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
    /// Least value allowed.
    pub min: f64,
    /// Largest value allowed.
    pub max: f64,
}

impl CollisionSettings {
    /// Checks every value against its range.
    ///
    /// # Errors
    /// The first setting that is out of range or not a number.
    pub fn validate(&self) -> Result<(), SettingsError> {
        // spacing: below a centimetre only time is lost, above two metres the excess at full lock passes half a metre
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

    /// The largest of all margins, for bounds that must hold with each.
    fn widest(&self) -> Margins {
        let (s, m, road) = (self.static_obstacles, self.moving_obstacles, self.road + drivable::OUTSIDE);
        Margins {
            lateral: s.lateral.max(m.lateral).max(road),
            longitudinal: s.longitudinal.max(m.longitudinal).max(road),
        }
    }
}

/// What is in the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Blocker {
    /// An obstacle, by its id in the file.
    Obstacle(i64),
    /// A cell of the occupancy grid.
    OccupiedCell,
    /// The edge of the road.
    RoadBoundary,
}

/// An overlap of the bare footprint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overlap {
    /// With what.
    pub what: Blocker,
    /// How far the vehicle would have to move to be free of it, m: exact for two polygons, an estimate off the road.
    pub depth: f64,
}

/// Everything that can be in the way of a vehicle in a scenario. Built once for a run; every query is read-only.
#[derive(Debug, Clone)]
pub struct CollisionWorld {
    origin: Origin,
    outline: Outline,
    settings: CollisionSettings,
    statics: StaticWorld,
    predictions: Predictions,
}

impl CollisionWorld {
    /// Builds the road's surface, the static obstacles and the predictions up to `horizon` (s since time step 0 of the
    /// file: the end of the run plus what the last plan looks ahead).
    ///
    /// # Errors
    /// A setting out of its range.
    pub fn new(
        scenario: &Scenario,
        vehicle: &Vehicle,
        settings: &CollisionSettings,
        horizon: f64,
    ) -> Result<Self, SettingsError> {
        settings.validate()?;
        let origin = origin_of(scenario);
        Ok(Self {
            origin,
            outline: Outline::new(vehicle),
            settings: *settings,
            statics: StaticWorld::new(scenario, origin, settings, vehicle.footprint.reach()),
            predictions: Predictions::new(&scenario.obstacles, origin, settings, horizon),
        })
    }

    /// Resolution and margins.
    #[must_use]
    pub fn settings(&self) -> &CollisionSettings {
        &self.settings
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
        Sweep::along(&self.origin, &self.outline, &self.settings, &[(*start, *spiral)])
    }

    /// The swept footprint along a whole path.
    #[must_use]
    pub fn sweep_path(&self, path: &Path) -> Sweep {
        Sweep::along(&self.origin, &self.outline, &self.settings, &swept::pieces_of(path))
    }

    /// The check of a spiral against what does not move, coarse to fine and lazily: the answers of
    /// [`CollisionWorld::static_hit_from_start`] and [`CollisionWorld::clearance`] without a [`Sweep`].
    #[must_use]
    pub fn probe(&self, start: &Pose, spiral: &CubicSpiral) -> EdgeProbe<'_> {
        EdgeProbe::new(self, &[(*start, *spiral)])
    }

    /// [`CollisionWorld::probe`] of a whole path.
    #[must_use]
    pub fn probe_path(&self, path: &Path) -> EdgeProbe<'_> {
        EdgeProbe::new(self, &swept::pieces_of(path))
    }

    /// The first cell that meets a static obstacle or leaves the road, margins included.
    #[must_use]
    pub fn static_hit(&self, sweep: &Sweep) -> Option<StaticHit> {
        self.statics.first_hit(sweep, &Allowance::NONE)
    }

    /// [`CollisionWorld::static_hit`] for a sweep from where the vehicle stands, which may be inside a margin or partly
    /// off the road already.
    #[must_use]
    pub fn static_hit_from_start(&self, sweep: &Sweep, allowance: &Allowance) -> Option<StaticHit> {
        self.statics.first_hit(sweep, allowance)
    }

    /// Distances to static obstacles and to the road's edge along the sweep, without margins, `cap` at most, m.
    #[must_use]
    pub fn clearance(&self, sweep: &Sweep, cap: f64) -> Clearance {
        self.statics.clearance(sweep, cap)
    }

    /// What moving obstacles block along sweeps that follow one another, between two times.
    #[must_use]
    pub fn blocked(&self, sweeps: &[&Sweep], from: f64, to: f64) -> BlockedGrid {
        self.predictions.blocked(sweeps, from, to)
    }

    /// What the vehicle, without margins, overlaps at a pose and a time: an obstacle before the road's edge; of several
    /// parts of the vehicle, the one that is deeper in.
    #[must_use]
    pub fn start_overlap(&self, pose: &Pose, time: f64) -> Option<Overlap> {
        let frame = Frame::new(&self.origin.local_pose(pose));
        let is_obstacle = |o: &Overlap| o.what != Blocker::RoadBoundary;
        let mut worst: Option<Overlap> = None;
        self.outline.for_each_part(&frame, |part| {
            let fixed = self.statics.overlap(part);
            let found = fixed.filter(is_obstacle).or_else(|| self.predictions.overlap(part, time)).or(fixed);
            let rank = |o: Overlap| (is_obstacle(&o), o.depth);
            if found.map(rank) > worst.map(rank) {
                worst = found;
            }
        });
        worst
    }
}

/// An origin amid the road, or amid obstacles and start where there is no road.
fn origin_of(scenario: &Scenario) -> Origin {
    let lanelets = scenario.network.lanelets.values();
    let bounds = lanelets.flat_map(|l| l.left.points().iter().chain(l.right.points()));
    let poses = scenario.obstacles.iter().filter_map(|o| match &o.motion {
        Motion::Static(pose) => Some(&pose.position),
        Motion::Trajectory(states) => states.first().map(|s| &s.pose.position),
        Motion::Occupancy(_) => None,
    });
    let starts = scenario.problems.iter().map(|p| &p.initial.centre.position);
    if scenario.network.lanelets.is_empty() { Origin::amid(poses.chain(starts)) } else { Origin::amid(bounds) }
}

/// Boxes are believed to be this much nearer than they are, m: so rounding decides nothing, and the least distance is the
/// same in whatever order the pieces are asked.
const ROUNDING: f64 = 1e-9;

/// Distance from a convex polygon with the given box to the nearest piece, `cap` at most, m.
fn nearest(tree: &Bvh, pieces: &[Convex], hull: &[Local], aabb: &Aabb, cap: f64) -> f64 {
    let to_box = |node: &parry2d::partitioning::BvhNode, _| box_distance(&node.aabb(), aabb) - ROUNDING;
    let to_piece = |leaf: u32, _| Some(pieces[leaf as usize].distance_to(hull));
    tree.find_best(cap, to_box, to_piece).map_or(cap, |(_, distance)| distance)
}
