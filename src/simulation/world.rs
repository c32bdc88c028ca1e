//! The rapier world: bodies, colliders, the clock, contacts and the log.

use std::sync::Arc;

use rapier2d::dynamics::RigidBodyHandle;
use rapier2d::geometry::ContactPair;
use rapier2d::math::Vector as RapierVector;

use super::actuators::{ActuatorState, Command};
use super::cells::{CELL, Cells};
use super::chassis::{GRAVITY, Motion, RunningGear, Wrench, wheel_position};
use super::controller::{Controller, TrackingController};
use super::convert::{Frame, point};
use super::disturbances::{DeadTime, Disturbances, Localisation};
use super::friction::{FrictionMap, FrictionRegion};
use super::obstacles::{Obstacles, REVIEW};
use super::physics::{PartCollider, Physics};
use super::{Contact, Log, Sample, Settings, SimulationError, Touched, controller};
use crate::geometry::{Point, Pose, Vector, wrap_angle};
use crate::map::{Obstacle, OccupancyGrid};
use crate::trajectory::{Trajectory, TrajectoryPoint};
use crate::vehicle::{State, Vehicle};

/// A vehicle among obstacles, at a moment of a run. A clone goes its own way from there on: it is how a fallback is tried
/// out in the middle of a run.
#[derive(Clone)]
pub struct World {
    vehicle: Arc<Vehicle>,
    /// What the controller and the actuators take the vehicle for.
    believed: Arc<Vehicle>,
    controls: Arc<dyn Controller>,
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
    /// What the tyres and the air did to the body in the last step.
    wrench: Wrench,
    start_time: f64,
    steps: u64,
    /// Continuous yaw of the last measurement, rad.
    yaw: f64,
    ended: Option<Ended>,
}

/// Why a run cannot go on.
#[derive(Debug, Clone, Copy)]
enum Ended {
    Contact(Contact),
    Broke(f64),
}

/// What the log calls wanted.
struct Wanted {
    pose: Pose,
    speed: f64,
    station: f64,
}

impl World {
    /// Puts the vehicle at its initial state among the obstacles. Wheels roll without slip and the actuators have settled
    /// on the initial acceleration and steering.
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
        let State { time, pose, speed, acceleration, yaw_rate, steering } = *initial;
        if ![time, pose.position.x, pose.position.y, pose.yaw, speed, acceleration, yaw_rate, steering]
            .iter()
            .all(|v| v.is_finite())
        {
            return Err(SimulationError::InitialState(format!("{initial:?}")));
        }
        let frame = Frame::at(pose.position);
        let mut physics = Physics::new(settings.step);
        let (chassis, footprint) = physics.insert_vehicle(vehicle, &frame, initial)?;
        let resistance = controller::resistance(vehicle, speed);
        let effort = if speed == 0.0 && acceleration == 0.0 { 0.0 } else { acceleration + resistance };
        let obstacles = Obstacles::new(obstacles, &frame)?;
        let gear = RunningGear::rolling(vehicle, speed, acceleration, settings.friction_scale);
        let gear = if settings.anti_lock { gear } else { gear.without_anti_lock() };
        let vehicle = Arc::new(vehicle.clone());
        let mut world = Self {
            believed: Arc::clone(&vehicle),
            controls: Arc::new(TrackingController),
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

    /// The same world with the occupied cells of a grid in it. To be called before the run begins.
    #[must_use]
    pub fn with_occupancy(mut self, grid: &OccupancyGrid) -> Self {
        self.cells = Some(Cells::new(grid));
        self.review();
        self
    }

    /// The same world with something wrong in it that nobody in the vehicle knows of. To be called before the run begins.
    #[must_use]
    pub fn disturbed(mut self, disturbances: &Disturbances) -> Self {
        if let Some(believed) = &disturbances.believed {
            self.believed = Arc::new(believed.clone());
        }
        self.dead_time = DeadTime::new(disturbances.dead_time, self.settings.step);
        self.localisation = Localisation::new(disturbances.localisation, self.start_time);
        self
    }

    /// The same world with another controller than [`TrackingController`].
    #[must_use]
    pub fn controlled_by(mut self, controls: Arc<dyn Controller>) -> Self {
        self.controls = controls;
        self
    }

    /// The same world on a road with these patches of other friction, in the scenario's coordinates. To be called before
    /// the run begins.
    ///
    /// # Errors
    /// A region that is none, by its index.
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

    /// Whether the run is over: contact, or broken numbers. Nothing moves any more then.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ended.is_some()
    }

    /// The vehicle as measured now.
    #[must_use]
    pub fn state(&self) -> State {
        let (pose, motion) = self.measured();
        State {
            time: self.time(),
            pose,
            speed: motion.forward,
            acceleration: self.wrench.forward / self.vehicle.mass,
            yaw_rate: motion.yaw_rate,
            steering: self.actuators.steering,
        }
    }

    /// The vehicle as it takes itself to be now: [`World::state`] with the localisation's error.
    #[must_use]
    pub fn localised(&self) -> State {
        self.localisation.seen(&self.state())
    }

    /// Drives along the trajectory until the time `until` (s of the run), logging at the settings' rate. Ends early, with
    /// the reason in the log, on contact or on numbers that are not finite; a world that has ended stays as it is.
    pub fn follow(&mut self, trajectory: &Trajectory, until: f64, log: &mut Log) {
        let (vehicle, controls) = (Arc::clone(&self.believed), Arc::clone(&self.controls));
        let period = 1.0 / self.settings.control_rate_hz;
        self.run(
            until,
            log,
            |state| controls.command(&vehicle, trajectory, state, period),
            |state| {
                let TrajectoryPoint { pose, speed, station, .. } = trajectory.at(state.time);
                Wanted { pose, speed, station }
            },
        );
    }

    /// Holds one command until the time `until`, as an emergency stop does: no trajectory, no controller. What the log
    /// calls wanted is what was measured.
    pub fn hold(&mut self, command: Command, until: f64, log: &mut Log) {
        self.run(until, log, |_| command, |state| Wanted { pose: state.pose, speed: state.speed, station: 0.0 });
    }

    /// Steps up to `until`: decide, step, look for contacts, log.
    fn run(
        &mut self,
        until: f64,
        log: &mut Log,
        decide: impl Fn(&State) -> Command,
        wanted: impl Fn(&State) -> Wanted,
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
                self.dead_time.ask(self.steps, command);
            }
            self.command = self.dead_time.arrived(self.steps).unwrap_or(self.command);
            if log.samples.is_empty() {
                log.samples.push(self.sample(&wanted(&self.state())));
            }
            first = false;
            self.step();
            if self.ended.is_some() || self.steps.is_multiple_of(sample) {
                log.samples.push(self.sample(&wanted(&self.state())));
            }
        }
        if self.ended.is_none() {
            // contacts of the last poses: a step finds those of the poses before it
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

    /// One step of physics. Contacts are those of the poses before the step.
    fn step(&mut self) {
        let (time, dt) = (self.time(), self.settings.step);
        let (_, motion) = self.measured();
        self.actuators.step(&self.believed, &self.command, motion.forward, dt);
        self.look_up_friction();
        let wrench = self.gear.step(&self.vehicle, &self.actuators, &motion, dt);
        if ![wrench.forward, wrench.left, wrench.yaw].iter().all(|v| v.is_finite()) {
            self.ended = Some(Ended::Broke(time));
            return;
        }
        self.wrench = wrench;
        self.physics.push(self.chassis, &wrench);
        self.obstacles.drive(&mut self.physics.bodies, time + dt);
        let sane = self.physics.step();
        let contact = self.contact(time, motion.forward);
        self.steps += 1;
        self.yaw += wrap_angle(self.rear_axle().yaw - self.yaw);
        self.place_obstacles();
        if let Some(contact) = contact {
            self.ended = Some(Ended::Contact(contact));
        } else if !sane {
            self.ended = Some(Ended::Broke(time + dt));
        }
    }

    /// Tells each wheel what it stands on.
    fn look_up_friction(&mut self) {
        let Some(map) = &self.friction else { return };
        let place = self.physics.bodies[self.chassis].position();
        let dry = self.settings.friction_scale * self.vehicle.tyres.friction;
        self.gear.stand_on([0, 1, 2, 3].map(|wheel| {
            let (x, y) = wheel_position(&self.vehicle, wheel);
            dry * map.at(place.transform_point(RapierVector::new(x, y)))
        }));
    }

    /// Gives the obstacles that exist now their bodies; from time to time, decides what is near.
    fn place_obstacles(&mut self) {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 50 to 10,000 steps: see Settings::validate
        let interval = (REVIEW / self.settings.step) as u64;
        if self.steps.is_multiple_of(interval) {
            self.review();
        }
        let time = self.time();
        self.obstacles.place(&mut self.physics, time);
    }

    /// Decides which obstacles and cells the vehicle may meet before the next review.
    fn review(&mut self) {
        let (pose, motion) = self.measured();
        let stickiest = self.friction.as_ref().map_or(1.0, |map| map.largest());
        let strongest = self.settings.friction_scale * stickiest * self.vehicle.tyres.friction * GRAVITY;
        let speed = motion.forward.hypot(motion.left) + self.vehicle.length * motion.yaw_rate.abs();
        // twice what the tyres can do: drag, turning and rapier's contact margin are in it too
        let travel = speed * REVIEW + strongest * REVIEW * REVIEW + 0.5;
        let reach = self.vehicle.footprint.reach() + travel;
        self.obstacles.review(self.time(), pose.position, reach);
        if let Some(cells) = &mut self.cells {
            cells.review(&mut self.physics, &self.frame, pose.position, reach);
        }
    }

    /// The deepest contact with an obstacle of the lowest index, else with a cell, if any is touched.
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

    /// What a part touches: the obstacle's index, the distance (negative) and the place in the rear-axle frame.
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

    /// Rear-axle pose, and the motion of the centre of mass in the body's frame. The forward speed is that of the rear
    /// axle too.
    fn measured(&self) -> (Pose, Motion) {
        let body = &self.physics.bodies[self.chassis];
        let velocity = body.rotation().inverse_transform_vector(body.linvel());
        let motion = Motion { forward: velocity.x, left: velocity.y, yaw_rate: body.angvel() };
        (Pose { yaw: self.yaw, ..self.rear_axle() }, motion)
    }

    fn sample(&self, wanted: &Wanted) -> Sample {
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
            reference_pose: wanted.pose,
            reference_speed: wanted.speed,
            reference_station: wanted.station,
        }
    }
}
