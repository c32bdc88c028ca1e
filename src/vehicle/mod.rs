//! The vehicle: dimensions, limits, tyres and actuators, single-track kinematics.
//!
//! Inside the program a vehicle's pose is at the **centre of the rear axle**; [`Vehicle::centre_of_rear_axle`] and
//! [`Vehicle::rear_axle_of_centre`] convert to and from the centre that CommonRoad files use.

mod drivable;
mod dynamics;
mod footprint;
mod mesh;
mod proof;
mod read;
mod skid;
mod tube;
mod urdf;

pub use drivable::{DrivingLimit, NotDrivable};
pub use footprint::{Footprint, FootprintError, MAX_CORNERS, MAX_PARTS, MAX_REACH};
pub use mesh::MeshError;
pub use proof::{CONTROL_SHARE, GRAVITY, ProofLimits};
pub use read::{VehicleError, builtin_names, files_of, load};
pub use tube::{GripUse, PathMotion, TrackingError, TrackingMargins, TrackingTube};

use crate::geometry::Pose;

/// A vehicle, checked when read: every number finite, masses and lengths positive.
#[derive(Debug, Clone, PartialEq)]
pub struct Vehicle {
    /// Name, e.g. `bmw_320i`.
    pub name: String,
    /// CommonRoad vehicle type id (1 Ford Escort, 2 BMW 320i, 3 VW Vanagon), when it is one of the published ones.
    pub commonroad_type: Option<u8>,
    /// Area that it covers on the ground.
    pub footprint: Footprint,
    /// Outer length of the footprint, m: [`Footprint::length`].
    pub length: f64,
    /// Outer width of the footprint, m: [`Footprint::width`].
    pub width: f64,
    /// Distance between the axles, m.
    pub wheelbase: f64,
    /// Distance from the rear axle forward to the middle of the footprint, m: [`Footprint::rear_axle_to_centre`].
    pub rear_axle_to_centre: f64,
    /// Distance from the rear axle forward to the centre of mass, m.
    pub rear_axle_to_mass: f64,
    /// Height of the centre of mass, m.
    pub mass_height: f64,
    /// Distance between the wheels of an axle, m.
    pub track_width: f64,
    /// Total mass, kg.
    pub mass: f64,
    /// Yaw inertia of the whole vehicle about its centre of mass, kg m².
    pub yaw_inertia: f64,
    /// Wheel radius, m.
    pub wheel_radius: f64,
    /// Spin inertia of one wheel about its axle, kg m².
    pub wheel_inertia: f64,
    /// Limits of motion.
    pub limits: Limits,
    /// Tyres.
    pub tyres: Tyres,
    /// Actuators.
    pub actuators: Actuators,
    /// Comfort limits for planning and for the verdict.
    pub comfort: Comfort,
    /// Bound of the tracking errors.
    pub tracking: TrackingTube,
}

/// Physical limits of the vehicle's motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Largest steering angle of the (virtual middle) front wheel, rad.
    pub steering: f64,
    /// Largest steering rate, rad/s.
    pub steering_rate: f64,
    /// Largest steering acceleration, rad/s².
    pub steering_acceleration: f64,
    /// Top speed, m/s.
    pub speed: f64,
    /// Largest drive acceleration, m/s².
    pub acceleration: f64,
    /// Speed above which the drive is limited by power (a·v constant), m/s.
    pub switching_speed: f64,
    /// Largest deceleration of the brakes, m/s², positive. The tyres may limit it further.
    pub deceleration: f64,
}

/// Tyre and resistance parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tyres {
    /// Peak friction coefficient on dry road.
    pub friction: f64,
    /// Cornering stiffness coefficient per unit of load, front (C_y = coefficient · F_z), 1/rad.
    pub cornering_front: f64,
    /// Cornering stiffness coefficient per unit of load, rear, 1/rad.
    pub cornering_rear: f64,
    /// Longitudinal slip stiffness per unit of load.
    pub longitudinal: f64,
    /// Relaxation length, m.
    pub relaxation_length: f64,
    /// Rolling resistance coefficient.
    pub rolling_resistance: f64,
    /// Aerodynamic drag, ½ρ c_w A, N s²/m².
    pub drag: f64,
}

/// Actuator dynamics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Actuators {
    /// Time constant of the drive, s.
    pub drive_lag: f64,
    /// Time constant of the brakes, s.
    pub brake_lag: f64,
    /// Time constant of the steering's position loop, s.
    pub steering_lag: f64,
    /// Share of drive force on the front axle, 0…1.
    pub drive_front_share: f64,
    /// Share of brake force on the front axle, 0…1.
    pub brake_front_share: f64,
}

/// Comfort limits. Decelerations are positive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comfort {
    /// Comfortable acceleration, m/s².
    pub acceleration: f64,
    /// Comfortable deceleration, m/s².
    pub deceleration: f64,
    /// Aggressive deceleration, valid in stopping proofs, m/s².
    pub aggressive_deceleration: f64,
    /// Lateral acceleration, m/s².
    pub lateral_acceleration: f64,
    /// Longitudinal jerk, m/s³.
    pub jerk: f64,
}

impl Vehicle {
    /// Pose of the footprint's centre for a pose of the rear axle.
    #[must_use]
    pub fn centre_of_rear_axle(&self, rear_axle: &Pose) -> Pose {
        rear_axle.advanced(self.rear_axle_to_centre)
    }

    /// Pose of the rear axle for a pose of the footprint's centre.
    #[must_use]
    pub fn rear_axle_of_centre(&self, centre: &Pose) -> Pose {
        centre.advanced(-self.rear_axle_to_centre)
    }

    /// Distance from the rear axle to the front bumper, m.
    #[must_use]
    pub fn front_overhang_from_rear_axle(&self) -> f64 {
        self.rear_axle_to_centre + 0.5 * self.length
    }

    /// Time after which the lateral acceleration follows the steering command at a speed (m/s), s: the steering lag and a
    /// share of m v/C = v/(c g), the time constant with which side force reduces lateral speed, for the softer axle. The
    /// share is below 1 because the yaw motion leads the lateral motion.
    #[must_use]
    pub fn lateral_lag(&self, speed: f64) -> f64 {
        tube::lateral_lag(&self.tyres, &self.actuators, speed)
    }

    /// Deceleration by rolling resistance and drag at a speed (m/s), m/s².
    #[must_use]
    pub fn resistance(&self, speed: f64) -> f64 {
        self.tyres.rolling_resistance * GRAVITY + self.tyres.drag * speed * speed.abs() / self.mass
    }

    /// Largest curvature of the rear axle's path, 1/m: tan(δ_max)/wheelbase.
    #[must_use]
    pub fn max_curvature(&self) -> f64 {
        self.limits.steering.tan() / self.wheelbase
    }

    /// Steering angle that drives the rear axle along `curvature` without slip, rad.
    #[must_use]
    pub fn steering_for_curvature(&self, curvature: f64) -> f64 {
        (self.wheelbase * curvature).atan()
    }
}

/// Measured state of the vehicle at a time: rear-axle pose and motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// Time of the run, s; 0 at time step 0 of the file.
    pub time: f64,
    /// Pose of the rear axle's centre.
    pub pose: Pose,
    /// Speed of the rear axle along the heading, m/s.
    pub speed: f64,
    /// Speed of the rear axle to the left of the heading, m/s: 0 for wheels that roll without slip.
    pub lateral_speed: f64,
    /// Longitudinal acceleration, m/s².
    pub acceleration: f64,
    /// Yaw rate, rad/s.
    pub yaw_rate: f64,
    /// Steering angle of the (virtual middle) front wheel, rad.
    pub steering: f64,
}

impl State {
    /// Highest speed of anything on a road, m/s: nothing is faster, and the size of a plan grows with the stopping distance.
    pub const HIGHEST_SPEED: f64 = 150.0;
    /// Largest acceleration, m/s²: several times what tyres give.
    pub const HIGHEST_ACCELERATION: f64 = 50.0;
    /// Largest yaw rate, rad/s: three turns in a second. The simulation of a faster spin needs ever smaller steps.
    pub const HIGHEST_YAW_RATE: f64 = 20.0;
}
