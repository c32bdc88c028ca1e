//! The simulated world: bodies, colliders, the clock, contacts and the log.

use std::sync::Arc;

use rapier2d::dynamics::RigidBodyHandle;
use rapier2d::geometry::ContactPair;
use rapier2d::math::Vector as RapierVector;

use super::actuators::{ActuatorState, Command};
use super::cells::{CELL, Cells};
use super::chassis::{Motion, RunningGear, Wrench, wheel_position};
use super::controller::{Controller, TrackingController};
use super::convert::{Frame, point};
use super::disturbances::{DeadTime, Disturbances, Localisation};
use super::friction::{FrictionMap, FrictionRegion};
use super::obstacles::{Obstacles, REVIEW};
use super::physics::{PartCollider, Physics};
use super::{Contact, Log, Sample, Settings, SimulationError, Touched};
use crate::geometry::{Point, Pose, Vector, wrap_angle};
use crate::map::{Obstacle, OccupancyGrid};
use crate::trajectory::{Trajectory, TrajectoryPoint};
use crate::vehicle::{GRAVITY, State, Vehicle};

/// A vehicle among obstacles at one instant of a run. A clone is an independent branch from there on: this is how a
/// fallback is tested in the middle of a run.
#[derive(Clone)]
pub struct World {
    vehicle: Arc<Vehicle>,
    /// The vehicle model that controller and actuators assume.
    believed: Arc<Vehicle>,
    controller: Arc<dyn Controller>,
    settings: Settings,
    physics: Physics,
    frame: Frame,
    obstacles: Obstacles,
    cells: Option<Cells>,
    friction: Option<Arc<FrictionMap>>,
    chassis: RigidBodyHandle,
    footprint: Vec<PartCollider>,
    gear: RunningGear,
    actuators: ActuatorState,
    command: Command,
    dead_time: DeadTime,
    localisation: Localisation,
    /// Mean force and torque of tyres and drag on the body in the last step.
    wrench: Wrench,
    start_time: f64,
    steps: u64,
    /// Continuous yaw of the last measurement, rad.
    yaw: f64,
    ended: Option<Ended>,
}

/// The reason why a run has ended.
#[derive(Debug, Clone, Copy)]
enum Ended {
    Contact(Contact),
    Broke(f64),
}

/// The reference written to the log.
struct Reference {
    pose: Pose,
    speed: f64,
    station: f64,
}

impl World {
    /// Places the vehicle in its initial state among the obstacles. Wheels roll without slip, and the actuators are in
    /// steady state at the initial acceleration and steering.
    ///
    /// # Errors
    /// A setting out of its range, or a number that is not finite in the initial state or in an obstacle.
    pub fn new(
        vehicle: &Vehicle,
        obstacles: &[Obstacle],
        initial: &State,
        settings: &Settings,
    ) -> Result<Self, SimulationError> {
        settings.validate()?;
        let State { time, pose, speed, lateral_speed, acceleration, yaw_rate, steering } = *initial;
        if ![time, pose.position.x, pose.position.y, pose.yaw, speed, lateral_speed, acceleration, yaw_rate, steering]
            .iter()
            .all(|v| v.is_finite())
        {
            return Err(SimulationError::InitialState(format!("{initial:?}")));
        }
        let frame = Frame::at(pose.position);
        let mut physics = Physics::new(settings.step);
        let (chassis, footprint) = physics.insert_vehicle(vehicle, &frame, initial)?;
        let resistance = vehicle.resistance(speed);
        let effort = if speed == 0.0 && acceleration == 0.0 { 0.0 } else { acceleration + resistance };
        let obstacles = Obstacles::new(obstacles, &frame)?;
        let gear = RunningGear::rolling(vehicle, speed, acceleration, settings.friction_scale);
        let gear = if settings.anti_lock { gear } else { gear.without_anti_lock() };
        let vehicle = Arc::new(vehicle.clone());
        let mut world = Self {
            believed: Arc::clone(&vehicle),
            controller: Arc::new(TrackingController::default()),
            settings: *settings,
            physics,
            frame,
            obstacles,
            cells: None,
            friction: None,
            chassis,
            footprint,
            gear,
            actuators: ActuatorState::settled(&vehicle, effort, steering, speed),
            command: Command { acceleration: effort, steering },
            dead_time: DeadTime::default(),
            localisation: Localisation::default(),
            wrench: Wrench { forward: vehicle.mass * acceleration, ..Wrench::default() },
            vehicle,
            start_time: time,
            steps: 0,
            yaw: pose.yaw,
            ended: None,
        };
        world.place_obstacles();
        Ok(world)
    }

    /// Adds the occupied cells of a grid. To be called before the run begins.
    #[must_use]
    pub fn with_occupancy(mut self, grid: &OccupancyGrid) -> Self {
        self.cells = Some(Cells::new(grid));
        self.review();
        self
    }

    /// Adds disturbances that are unknown to the vehicle. To be called before the run begins.
    #[must_use]
    pub fn disturbed(mut self, disturbances: &Disturbances) -> Self {
        if let Some(believed) = &disturbances.believed {
            self.believed = Arc::new(believed.clone());
        }
        self.dead_time = DeadTime::new(disturbances.dead_time, self.settings.step);
        self.localisation = Localisation::new(disturbances.localisation, self.start_time);
        self
    }

    /// Replaces the default [`TrackingController`], which believes that the road is dry.
    #[must_use]
    pub fn controlled_by(mut self, controller: Arc<dyn Controller>) -> Self {
        self.controller = controller;
        self
    }

    /// Adds patches of different friction, in the scenario's coordinates. To be called before the run begins.
    ///
    /// # Errors
    /// [`SimulationError::Friction`] names the index of an invalid region.
    pub fn with_friction(mut self, regions: &[FrictionRegion]) -> Result<Self, SimulationError> {
        self.friction = Some(Arc::new(FrictionMap::new(regions, &self.frame)?)).filter(|_| !regions.is_empty());
        self.review();
        Ok(self)
    }

    /// Time of the run, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.start_time + self.steps as f64 * self.settings.step
    }

    /// Whether the run has ended: by a contact, or by a number that is not finite. A world that has ended does not move
    /// any more.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ended.is_some()
    }

    /// The true state of the vehicle.
    #[must_use]
    pub fn state(&self) -> State {
        let (pose, motion) = self.measured();
        State {
            time: self.time(),
            pose,
            speed: motion.forward,
            lateral_speed: motion.left - motion.yaw_rate * self.vehicle.rear_axle_to_mass,
            acceleration: self.wrench.forward / self.vehicle.mass,
            yaw_rate: motion.yaw_rate,
            steering: self.actuators.steering,
        }
    }

    /// The state that the vehicle measures: [`World::state`] with the localisation error.
    #[must_use]
    pub fn localised(&self) -> State {
        self.localisation.localised(&self.state())
    }

    /// Follows the trajectory until the time `until` (s of the run), logging at the configured rate. Ends early, with
    /// the reason in the log, at a contact or at a number that is not finite; a world that has ended does not change.
    pub fn follow(&mut self, trajectory: &Trajectory, until: f64, log: &mut Log) {
        let (vehicle, controller) = (Arc::clone(&self.believed), Arc::clone(&self.controller));
        let period = 1.0 / self.settings.control_rate_hz;
        self.run(
            until,
            log,
            |state| controller.command(&vehicle, trajectory, state, period),
            |state| {
                let TrajectoryPoint { pose, speed, station, .. } = trajectory.at(state.time);
                Reference { pose, speed, station }
            },
        );
    }

    /// Holds one command until the time `until` (s of the run), as an emergency stop does: no trajectory, no
    /// controller. The logged reference equals the measured state.
    pub fn hold(&mut self, command: Command, until: f64, log: &mut Log) {
        self.run(until, log, |_| command, |state| Reference { pose: state.pose, speed: state.speed, station: 0.0 });
    }

    /// Steps until `until`: decide, step, find contacts, log.
    fn run(
        &mut self,
        until: f64,
        log: &mut Log,
        decide: impl Fn(&State) -> Command,
        reference: impl Fn(&State) -> Reference,
    ) {
        let (decision, sample) = (self.settings.steps_per_decision(), self.settings.steps_per_sample());
        let half = 0.5 * self.settings.step;
        let mut first = true;
        while self.ended.is_none() && self.time() + half < until {
            if first || self.steps.is_multiple_of(decision) {
                self.localisation.advance(self.time());
                let command = decide(&self.localised());
                if !(command.acceleration.is_finite() && command.steering.is_finite()) {
                    self.ended = Some(Ended::Broke(self.time()));
                    break;
                }
                self.dead_time.send(self.steps, command);
            }
            self.command = self.dead_time.arrived(self.steps).unwrap_or(self.command);
            if log.samples.is_empty() {
                log.samples.push(self.sample(&reference(&self.state())));
            }
            first = false;
            self.step();
            if self.ended.is_some() || self.steps.is_multiple_of(sample) {
                log.samples.push(self.sample(&reference(&self.state())));
            }
        }
        if self.ended.is_none() {
            // contacts of the final poses: a step finds those of the poses before it
            self.physics.find_contacts();
            let state = self.state();
            self.ended = self.contact(state.time, state.speed).map(Ended::Contact);
        }
        match self.ended {
            Some(Ended::Contact(contact)) => log.contact = Some(contact),
            Some(Ended::Broke(time)) => log.broke_at = Some(time),
            None => {}
        }
    }

    /// Advances the physics by one step. Contacts are those of the poses before the step.
    fn step(&mut self) {
        let (time, dt) = (self.time(), self.settings.step);
        let (_, motion) = self.measured();
        self.actuators.step(&self.believed, &self.command, motion.forward, dt);
        self.update_friction();
        let wrench = self.gear.step(&self.vehicle, &self.actuators, &motion, dt);
        if ![wrench.forward, wrench.left, wrench.yaw].iter().all(|v| v.is_finite()) {
            self.ended = Some(Ended::Broke(time));
            return;
        }
        self.wrench = wrench;
        self.physics.push(self.chassis, &wrench);
        self.obstacles.drive(&mut self.physics.bodies, time + dt);
        let is_finite = self.physics.step();
        let contact = self.contact(time, motion.forward);
        self.steps += 1;
        self.yaw += wrap_angle(self.rear_axle().yaw - self.yaw);
        self.place_obstacles();
        if let Some(contact) = contact {
            self.ended = Some(Ended::Contact(contact));
        } else if !is_finite {
            self.ended = Some(Ended::Broke(time + dt));
        }
    }

    /// Sets the friction below each wheel.
    fn update_friction(&mut self) {
        let Some(map) = &self.friction else { return };
        let place = self.physics.bodies[self.chassis].position();
        let dry = self.settings.friction_scale * self.vehicle.tyres.friction;
        self.gear.set_friction([0, 1, 2, 3].map(|wheel| {
            let (x, y) = wheel_position(&self.vehicle, wheel);
            dry * map.at(place.transform_point(RapierVector::new(x, y)))
        }));
    }

    /// Updates the bodies of the obstacles that exist now; at intervals, reviews which are near.
    fn place_obstacles(&mut self) {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 50 to 10,000 steps: see Settings::validate
        let interval = (REVIEW / self.settings.step) as u64;
        if self.steps.is_multiple_of(interval) {
            self.review();
        }
        let time = self.time();
        self.obstacles.place(&mut self.physics, time);
    }

    /// Finds the obstacles and cells that the vehicle may meet before the next review.
    fn review(&mut self) {
        let (pose, motion) = self.measured();
        let max_factor = self.friction.as_ref().map_or(1.0, |map| map.largest());
        let max_acceleration = self.settings.friction_scale * max_factor * self.vehicle.tyres.friction * GRAVITY;
        let speed = motion.forward.hypot(motion.left) + self.vehicle.length * motion.yaw_rate.abs();
        // twice the travel from the tyres' acceleration: covers drag, turning and rapier's contact margin too
        let travel = speed * REVIEW + max_acceleration * REVIEW * REVIEW + 0.5;
        let reach = self.vehicle.footprint.reach() + travel;
        self.obstacles.review(self.time(), pose.position, reach);
        if let Some(cells) = &mut self.cells {
            cells.review(&mut self.physics, &self.frame, pose.position, reach);
        }
    }

    /// The deepest contact with the obstacle of the lowest index, else with a cell, if any.
    fn contact(&self, time: f64, speed: f64) -> Option<Contact> {
        let pairs = self
            .footprint
            .iter()
            .flat_map(|part| self.physics.narrow_phase.contact_pairs_with(part.collider).map(move |pair| (part, pair)));
        let touching = pairs.filter_map(|(part, pair)| self.touch(part, pair));
        let (index, _, at) = touching.min_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)))?;
        let with = if index == CELL { Touched::OccupiedCell } else { Touched::Obstacle(self.obstacles.id(index)?) };
        Some(Contact { time, with, at_rear_axle_frame: at, speed })
    }

    /// Contact of a footprint part: index of the obstacle, distance (negative) and position in the rear-axle frame.
    fn touch(&self, part: &PartCollider, pair: &ContactPair) -> Option<(u128, f64, Point)> {
        let (_, deepest) = pair.find_deepest_contact()?;
        if deepest.dist > 0.0 {
            return None;
        }
        let (other, here) = if pair.collider1 == part.collider {
            (pair.collider2, deepest.local_p1)
        } else {
            (pair.collider1, deepest.local_p2)
        };
        let index = self.physics.colliders.get(other)?.user_data;
        Some((index, deepest.dist, point(here) + Vector::new(part.at, 0.0)))
    }

    fn rear_axle(&self) -> Pose {
        let body = &self.physics.bodies[self.chassis];
        self.frame.pose_out(body.position()).advanced(-self.vehicle.rear_axle_to_mass)
    }

    /// Rear-axle pose, and the motion of the centre of mass in the body frame. Its forward speed is also that of the
    /// rear axle.
    fn measured(&self) -> (Pose, Motion) {
        let body = &self.physics.bodies[self.chassis];
        let velocity = body.rotation().inverse_transform_vector(body.linvel());
        let motion = Motion { forward: velocity.x, left: velocity.y, yaw_rate: body.angvel() };
        (Pose { yaw: self.yaw, ..self.rear_axle() }, motion)
    }

    fn sample(&self, reference: &Reference) -> Sample {
        let (pose, motion) = self.measured();
        Sample {
            time: self.time(),
            pose,
            speed: motion.forward,
            lateral_speed: motion.left - motion.yaw_rate * self.vehicle.rear_axle_to_mass,
            yaw_rate: motion.yaw_rate,
            acceleration: self.wrench.forward / self.vehicle.mass,
            lateral_acceleration: self.wrench.left / self.vehicle.mass,
            steering: self.actuators.steering,
            commanded_acceleration: self.command.acceleration,
            commanded_steering: self.command.steering,
            reference_pose: reference.pose,
            reference_speed: reference.speed,
            reference_station: reference.station,
        }
    }
}
