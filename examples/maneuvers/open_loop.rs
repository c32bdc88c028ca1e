//! Open-loop maneuvers in the vehicle simulation: the inputs act directly on steering, drive and brakes.
//!
//! Shared by the example, which writes them to files, and by the tests, which compare the simulation with the reference
//! models. The inputs are those of the CommonRoad vehicle models: steering rate and longitudinal acceleration, constant
//! over each [`TICK`]. [`bare`] removes from the vehicle what those models do not have: lags, drag, rolling resistance.

use stopline::geometry::{Point, Pose};
use stopline::simulation::{Command, GRAVITY, Log, Settings, SimulationError, World};
use stopline::vehicle::{State, Vehicle};

/// Time over which the inputs are constant, s.
pub(crate) const TICK: f64 = 0.01;
/// Time at which each maneuver begins, s; until then the vehicle drives straight.
const BEGIN: f64 = 0.5;

/// A maneuver: inputs over time, starting in straight driving at a constant speed.
pub(crate) struct Maneuver {
    /// Name, as in file names.
    pub(crate) name: &'static str,
    /// Initial speed, m/s.
    pub(crate) speed: f64,
    /// Duration, s.
    pub(crate) duration: f64,
    /// Curvature over the time since the beginning of the maneuver: steering angle of the virtual middle front wheel
    /// divided by the wheelbase, 1/m. At small angles it is the path curvature of a neutral vehicle.
    curvature: fn(f64) -> f64,
    /// Longitudinal acceleration over the same time, m/s².
    acceleration: fn(f64) -> f64,
    /// 1, or −1 for the mirrored maneuver.
    side: f64,
}

/// Inputs during one tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Input {
    /// Steering rate, rad/s.
    pub(crate) steering_rate: f64,
    /// Longitudinal acceleration, m/s².
    pub(crate) acceleration: f64,
}

/// Motion of the vehicle at one instant, at the centre of mass.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Instant {
    /// Time, s.
    pub(crate) time: f64,
    /// Position of the centre of mass, m.
    pub(crate) position: Point,
    /// Yaw, rad.
    pub(crate) yaw: f64,
    /// Steering angle, rad.
    pub(crate) steering: f64,
    /// Speed along the heading, m/s.
    pub(crate) speed: f64,
    /// Yaw rate, rad/s.
    pub(crate) yaw_rate: f64,
    /// Acceleration to the left, m/s².
    pub(crate) lateral_acceleration: f64,
}

/// The maneuvers of the comparison.
///
/// Steering rates stay below the 0.4 rad/s of the published parameters. For a neutral vehicle the lateral acceleration
/// is 0.3 g in the steady part of the step, 0.6 g at the end of the ramp and about 0.35 g at the peaks of the slalom.
pub(crate) const MANEUVERS: [Maneuver; 4] = [
    // as in ISO 7401: straight driving, then a step
    Maneuver { name: "step_steer", speed: 20.0, duration: 5.0, curvature: step, acceleration: |_| 0.0, side: 1.0 },
    // as in ISO 4138, constant speed and slowly increasing steering: up to 0.6 g
    Maneuver {
        name: "ramp_steer",
        speed: 20.0,
        duration: 8.5,
        curvature: |t| 0.0019 * t,
        acceleration: |_| 0.0,
        side: 1.0,
    },
    // four periods of 2 s
    Maneuver {
        name: "slalom",
        speed: 15.0,
        duration: 8.5,
        curvature: |t| 0.0155 * (std::f64::consts::PI * t).sin(),
        acceleration: |_| 0.0,
        side: 1.0,
    },
    // as in ISO 7975: a steady turn, then braking
    Maneuver {
        name: "brake_in_turn",
        speed: 20.0,
        duration: 5.5,
        curvature: step,
        acceleration: |t| if t < 2.5 { 0.0 } else { -4.0 },
        side: 1.0,
    },
];

/// A step to 0.3 g at 20 m/s, within a tenth of a second.
fn step(time: f64) -> f64 {
    (0.075 * time).min(0.3 * GRAVITY / 400.0)
}

impl Maneuver {
    /// The mirrored maneuver.
    pub(crate) fn mirrored(&self) -> Self {
        Self { side: -self.side, ..*self }
    }

    /// The inputs, tick by tick.
    pub(crate) fn inputs(&self, vehicle: &Vehicle) -> Vec<Input> {
        let since = |tick: usize| (TICK * tick as f64 - BEGIN).max(0.0);
        (0..(self.duration / TICK).round() as usize)
            .map(|tick| Input {
                steering_rate: self.side
                    * vehicle.wheelbase
                    * ((self.curvature)(since(tick + 1)) - (self.curvature)(since(tick)))
                    / TICK,
                acceleration: (self.acceleration)(since(tick)),
            })
            .collect()
    }

    /// Drives the maneuver from a rear-axle pose. Returns the motion at the start of each tick and at the end.
    ///
    /// # Errors
    /// A setting out of its range.
    pub(crate) fn drive(
        &self,
        vehicle: &Vehicle,
        from: Pose,
        settings: &Settings,
    ) -> Result<Vec<Instant>, SimulationError> {
        let vehicle = bare(vehicle, settings.step);
        let initial = State {
            time: 0.0,
            pose: from,
            speed: self.speed,
            lateral_speed: 0.0,
            acceleration: 0.0,
            yaw_rate: 0.0,
            steering: 0.0,
        };
        let mut world = World::new(&vehicle, &[], &initial, settings)?;
        let (mut instants, mut steering) = (vec![instant(&vehicle, &world.state(), 0.0)], 0.0);
        let steps = (TICK / settings.step).round() as usize;
        let mut log = Log::default();
        for (tick, input) in self.inputs(&vehicle).iter().enumerate() {
            for step in 1..=steps {
                let angle = steering + input.steering_rate * settings.step * step as f64;
                let command = Command { acceleration: input.acceleration * spin_factor(&vehicle), steering: angle };
                world.hold(command, TICK * tick as f64 + settings.step * step as f64, &mut log);
            }
            steering += input.steering_rate * TICK;
            let lateral = log.samples.last().map_or(0.0, |s| s.lateral_acceleration);
            instants.push(instant(&vehicle, &world.state(), lateral));
        }
        Ok(instants)
    }
}

/// Ratio of the drive force that an acceleration requires to the vehicle's mass times that acceleration: part of the
/// force accelerates the wheels' spin. The tracking controller applies the same ratio.
pub(crate) fn spin_factor(vehicle: &Vehicle) -> f64 {
    1.0 + 4.0 * vehicle.wheel_inertia / (vehicle.mass * vehicle.wheel_radius.powi(2))
}

/// The vehicle without lags, drag and rolling resistance: the steering follows its setpoint within a physics step.
pub(crate) fn bare(vehicle: &Vehicle, step: f64) -> Vehicle {
    let mut bare = vehicle.clone();
    bare.limits.steering_acceleration = 1e9;
    bare.actuators.steering_lag = step;
    bare.actuators.drive_lag = 1e-9;
    bare.actuators.brake_lag = 1e-9;
    bare.tyres.drag = 0.0;
    bare.tyres.rolling_resistance = 0.0;
    bare
}

fn instant(vehicle: &Vehicle, state: &State, lateral_acceleration: f64) -> Instant {
    Instant {
        time: state.time,
        position: state.pose.advanced(vehicle.rear_axle_to_mass).position,
        yaw: state.pose.yaw,
        steering: state.steering,
        speed: state.speed,
        yaw_rate: state.yaw_rate,
        lateral_acceleration,
    }
}
