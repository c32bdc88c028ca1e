//! The vehicle simulation: a rapier world in which a vehicle with mass, tyres and actuator lags follows trajectories.
//!
//! The world is planar and has no gravity. The chassis is one rigid body with the vehicle's mass and yaw inertia and
//! the parts of the footprint as colliders. Four tyres exert forces on it (`tyre`, `chassis`). Actuators with lag and
//! limits steer, drive and brake it (`actuators`), commanded by a tracking controller (`controller`). Each tyre has the
//! friction of the road patch below it (`friction`). Obstacles are colliders: static ones, moving ones on their
//! predicted trajectories, set-based ones as regions for their time intervals; so are the occupied cells of a grid
//! (`cells`). Contacts cause no forces: the first one is logged and ends the run.
//!
//! Runs are deterministic: fixed steps, no threads, rapier's `enhanced-determinism`. The physics has its origin at the
//! start of the run; logs are in world coordinates.

mod actuators;
mod cells;
mod chassis;
mod controller;
mod convert;
mod disturbances;
mod friction;
mod obstacles;
mod physics;
mod settings;
mod tyre;
mod world;

pub use crate::vehicle::GRAVITY;
pub use actuators::Command;
pub use controller::{Controller, TrackingController};
pub use disturbances::{Disturbances, LocalisationNoise};
pub use friction::{FrictionRegion, SURFACES, surface};
pub use settings::Settings;
pub use world::World;

use crate::geometry::Pose;

/// The reason why a simulation cannot start.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// A setting out of its range.
    #[error("simulation setting `{name}`: {value}; expected {expected}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// The value.
        value: f64,
        /// The expected range.
        expected: &'static str,
    },
    /// An invalid friction region.
    #[error("`friction[{region}].{key}`: {value}; expected {expected}")]
    Friction {
        /// Index of the region.
        region: usize,
        /// The invalid key of the region.
        key: &'static str,
        /// The value: a factor, a coordinate, a number of corners, an index of an edge or an area.
        value: f64,
        /// The expected range.
        expected: &'static str,
    },
    /// The initial state contains a number that is not finite.
    #[error("the vehicle's initial state is not finite: {0}")]
    InitialState(String),
    /// A part of the vehicle's footprint is not a convex polygon with an area.
    #[error("the vehicle's footprint has a part without area")]
    Footprint,
    /// An obstacle contains a number that is not finite, or has no shape.
    #[error("obstacle {id}: {message}")]
    Obstacle {
        /// The obstacle's id.
        id: i64,
        /// What is invalid.
        message: &'static str,
    },
}

/// State of the simulation at one instant. Logged at a fixed rate of at least 50 Hz.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time of the run, s.
    pub time: f64,
    /// Rear-axle pose.
    pub pose: Pose,
    /// Speed of the rear axle along the heading, m/s.
    pub speed: f64,
    /// Speed of the rear axle to the left, m/s.
    pub lateral_speed: f64,
    /// Yaw rate, rad/s.
    pub yaw_rate: f64,
    /// Acceleration of the centre of mass along the heading, m/s².
    pub acceleration: f64,
    /// Acceleration of the centre of mass to the left, m/s².
    pub lateral_acceleration: f64,
    /// Steering angle, rad.
    pub steering: f64,
    /// Commanded acceleration of drive and brakes, m/s².
    pub commanded_acceleration: f64,
    /// Commanded steering angle, rad.
    pub commanded_steering: f64,
    /// Reference pose of the rear axle: that of the trajectory at this time.
    pub reference_pose: Pose,
    /// Reference speed, m/s.
    pub reference_speed: f64,
    /// Reference station on the trajectory's path, m.
    pub reference_station: f64,
}

/// The other object of a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Touched {
    /// The obstacle with this id.
    Obstacle(i64),
    /// An occupied cell of the grid.
    OccupiedCell,
}

impl std::fmt::Display for Touched {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Obstacle(id) => write!(f, "obstacle {id}"),
            Self::OccupiedCell => write!(f, "an occupied cell"),
        }
    }
}

/// A contact between the vehicle and something else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Time of the run, s.
    pub time: f64,
    /// The other object; an obstacle if the vehicle touches an obstacle and a cell at once.
    pub with: Touched,
    /// Position of the contact in the rear-axle frame, m.
    pub at_rear_axle_frame: crate::geometry::Point,
    /// The vehicle's speed at that moment, m/s.
    pub speed: f64,
}

/// The log of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Log {
    /// Samples in order of time; the first is the initial state.
    pub samples: Vec<Sample>,
    /// The first contact, if any. The run ends with it.
    pub contact: Option<Contact>,
    /// Time at which the physics produced a number that is not finite, s. The run ends with it.
    pub broke_at: Option<f64>,
}
