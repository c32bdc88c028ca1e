//! The physics rig: a rapier world in which the vehicle follows trajectories with mass, tyres and slow actuators.
//!
//! The world is seen from above, without gravity. The chassis is one rigid body with the vehicle's mass and yaw inertia
//! and the parts of the footprint as its colliders; four tyres push it (`tyre`, `chassis`), turned, driven and braked by actuators with
//! lag and limits (`actuators`), which a tracking controller commands (`controller`); each tyre has the friction of the
//! patch of road that it stands on (`friction`). Obstacles are colliders: fixed ones,
//! moving ones on their predicted trajectories, set-based ones as regions for their interval; so are the occupied cells of a
//! grid (`cells`). Nothing pushes back: the first touch is logged and ends the run.
//!
//! Every number comes out the same for the same input: fixed steps, no threads, rapier's `enhanced-determinism`.
//! The physics has its origin at the start of the run; logs are in world coordinates.

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

pub use actuators::Command;
pub use chassis::GRAVITY;
pub use controller::{Controller, TrackingController};
pub use disturbances::{Disturbances, LocalisationNoise};
pub use friction::{FrictionRegion, SURFACES, surface};
pub use settings::Settings;
pub use world::World;

use crate::geometry::Pose;

/// Why a run cannot start.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// A setting out of its range.
    #[error("simulation setting `{name}`: {value}; expected {expected}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// A region of friction that is none.
    #[error("`friction[{region}].{key}`: {value}; expected {expected}")]
    Friction {
        /// Index of the region.
        region: usize,
        /// Its key.
        key: &'static str,
        /// Its value; of a polygon with too few corners, their number.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// The initial state has a number that is not finite.
    #[error("the vehicle's initial state is not finite: {0}")]
    InitialState(String),
    /// A part of the vehicle's footprint is no convex polygon with an area.
    #[error("the vehicle's footprint has a part without area")]
    Footprint,
    /// An obstacle has a number that is not finite, or no shape.
    #[error("obstacle {id}: {message}")]
    Obstacle {
        /// The obstacle's id.
        id: i64,
        /// What is wrong.
        message: &'static str,
    },
}

/// What the rig measured at one instant. Logged at a fixed rate of at least 100 Hz.
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
    /// Acceleration asked of drive and brakes, m/s².
    pub commanded_acceleration: f64,
    /// Steering angle asked for, rad.
    pub commanded_steering: f64,
    /// Rear-axle pose that the trajectory wants now.
    pub reference_pose: Pose,
    /// Speed that the trajectory wants now, m/s.
    pub reference_speed: f64,
    /// Station on the trajectory's path that is wanted now, m.
    pub reference_station: f64,
}

/// What the vehicle touched.
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
    /// What was touched; an obstacle, if an obstacle and a cell at once.
    pub with: Touched,
    /// Where on the vehicle it struck: the contact's position in the rear-axle frame, m.
    pub at_rear_axle_frame: crate::geometry::Point,
    /// The vehicle's speed at that moment, m/s.
    pub speed: f64,
}

/// Everything that the rig measured in a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Log {
    /// Samples in order of time; the first is the initial state.
    pub samples: Vec<Sample>,
    /// The first contact, if any. The run ends with it.
    pub contact: Option<Contact>,
    /// Time at which a non-finite number was found in the physics, s. The run ends with it.
    pub broke_at: Option<f64>,
}
