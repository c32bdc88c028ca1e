//! Obstacles and their predicted motion.

use super::{ConvexPart, Shape};
use crate::geometry::Pose;

/// An obstacle with its shape and motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Obstacle {
    /// Id in the file.
    pub id: i64,
    /// Kind of road user or structure.
    pub kind: ObstacleKind,
    /// Shape in the obstacle's frame. For [`Motion::Occupancy`] it is used only until the first predicted set.
    pub shape: Shape,
    /// Motion over time.
    pub motion: Motion,
}

/// Kind of an obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObstacleKind {
    /// Car, truck, bus, motorcycle, train, …
    Vehicle,
    /// Bicycle.
    Bicycle,
    /// Pedestrian.
    Pedestrian,
    /// Parked vehicle.
    ParkedVehicle,
    /// Building, construction zone, pillar, boundary.
    Structure,
    /// Anything else.
    Unknown,
}

/// Predicted motion of an obstacle. Times are in seconds since time step 0 of the file.
#[derive(Debug, Clone, PartialEq)]
pub enum Motion {
    /// It stands still at all times.
    Static(Pose),
    /// A predicted trajectory of the shape's frame: at least one state, in order of time. As in CommonRoad, the obstacle does
    /// not exist before its first and after its last state.
    Trajectory(Vec<TimedPose>),
    /// A set-based prediction: a region for each time interval, in order of time.
    Occupancy(Vec<TimedOccupancy>),
}

/// A pose at a time, with the speed along its heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedPose {
    /// Time, s.
    pub time: f64,
    /// Pose of the shape's frame.
    pub pose: Pose,
    /// Speed, m/s.
    pub speed: f64,
}

/// A region that may be occupied during a time interval.
#[derive(Debug, Clone, PartialEq)]
pub struct TimedOccupancy {
    /// Start of the interval, s.
    pub from: f64,
    /// End of the interval, s.
    pub to: f64,
    /// The region, in world coordinates.
    pub region: Shape,
}

impl Obstacle {
    /// Whether it is static.
    #[must_use]
    pub fn is_static(&self) -> bool {
        matches!(self.motion, Motion::Static(_))
    }

    /// Pose of the shape's frame at `time`, interpolated between states; `None` if it does not exist then, and for
    /// set-based predictions, which have no pose.
    #[must_use]
    pub fn pose_at(&self, time: f64) -> Option<Pose> {
        self.state_at(time).map(|state| state.pose)
    }

    /// Pose and speed at `time`, interpolated between states.
    #[must_use]
    pub fn state_at(&self, time: f64) -> Option<TimedPose> {
        match &self.motion {
            Motion::Static(pose) => Some(TimedPose { time, pose: *pose, speed: 0.0 }),
            Motion::Trajectory(states) => {
                /// Tolerance for the rounding of times `k · dt`, s.
                const SLACK: f64 = 1e-9;
                let (first, last) = (states.first()?, states.last()?);
                if time < first.time - SLACK || time > last.time + SLACK {
                    return None;
                }
                let after = states.partition_point(|s| s.time <= time);
                if after == 0 {
                    return Some(*first);
                }
                let before = &states[after - 1];
                let Some(next) = states.get(after) else { return Some(*last) };
                let ratio = (time - before.time) / (next.time - before.time);
                Some(TimedPose {
                    time,
                    pose: before.pose.interpolated(&next.pose, ratio),
                    speed: before.speed + (next.speed - before.speed) * ratio,
                })
            }
            Motion::Occupancy(_) => None,
        }
    }

    /// The convex pieces occupied at `time`, in world coordinates; empty if it does not exist then.
    #[must_use]
    pub fn occupied_at(&self, time: f64) -> Vec<ConvexPart> {
        match &self.motion {
            Motion::Occupancy(sets) => {
                sets.iter().filter(|o| o.from <= time && time <= o.to).flat_map(|o| o.region.convex_parts()).collect()
            }
            _ => match self.pose_at(time) {
                Some(pose) => self.shape.convex_parts().iter().map(|part| part.at(&pose)).collect(),
                None => Vec::new(),
            },
        }
    }

    /// The time interval in which the obstacle exists, s.
    #[must_use]
    pub fn lifetime(&self) -> (f64, f64) {
        match &self.motion {
            Motion::Static(_) => (f64::NEG_INFINITY, f64::INFINITY),
            Motion::Trajectory(states) => {
                (states.first().map_or(f64::INFINITY, |s| s.time), states.last().map_or(f64::NEG_INFINITY, |s| s.time))
            }
            Motion::Occupancy(sets) => {
                (sets.first().map_or(f64::INFINITY, |s| s.from), sets.last().map_or(f64::NEG_INFINITY, |s| s.to))
            }
        }
    }
}
