//! The tracking controller: steering and acceleration commands that keep the vehicle on its trajectory.
//!
//! Feed-forward does most of the work; feedback corrects the remaining error.
//! - **Steering**: feed-forward inverts the vehicle model ([`inverse`]): the path's curvature and its derivative at the
//!   position that the rear axle reaches after the steering lag determine the axle forces, and those the slip angles.
//!   The feedback on lateral offset e and heading error ψ of the rear axle is κ = −ω² e − 2 ω ψ, which places both
//!   poles of the error along the path at ω (1/m). ω is a bandwidth in time divided by the speed, bounded at low speed
//!   (Paden et al. 2016, section V, for the kinematic error model). In a turn the body points inwards of its path by
//!   the slip angle of the rear tyres; this angle is part of the reference, not an error.
//! - **Acceleration**: the profile's acceleration, inverted through the lag of drive or brakes ([`lag_compensated`]),
//!   plus drag, rolling resistance and the inertia of the wheels' spin and of the yaw motion ([`force`]); bounded feedback
//!   on station and speed error with a double pole. The station error acts as an integrator, so there is no integrator
//!   state that could wind up.
//! - **Bounds**: both demands stay within the grip of the road as believed ([`Grip`]), steering first. A step of the
//!   acceleration that the profile contains at least one lag ahead is commanded early, so that the vehicle brakes at most
//!   4 % harder than the profile. After a step at the first instant, the vehicle brakes up to a fifth harder than the
//!   profile to make good for the lag; every plan therefore begins with the motion of the plan before.
//! - **Stop**: over the last metres the controller aims 15 mm short of the end, which exceeds the remaining error of
//!   model and feedback. Once the reference speed is zero and stays zero and the vehicle stands still, the brakes hold
//!   it. Short of the end by more than a tolerance, the vehicle creeps forward; if it still rolls beyond the end, it
//!   brakes as hard as the profile at its hardest. It never drives backwards.
//!
//! **Tuning.** In time, both open loops are (ω² + 2 ω p)/p² behind a lag τ. Their crossover is near 2.06 ω, where the
//! controller leads by 76°, so the phase margin is about 76° − atan(2.06 ω τ), less the phase of yaw inertia and
//! sampling. ω is [`LAG_SHARE`]/τ, which leaves at least 43°. For speed, τ is the slower lag of drive and brakes; for
//! steering, it is [`Vehicle::lateral_lag`]. ω is capped where more bandwidth would only amplify noise. `margins` computes
//! phase and gain margins of the linearised loops, with tyres, over all vehicles and speeds.
//!
//! Limitations: the controller assumes one friction for the whole road; a trajectory that exceeds the tyres' grip is
//! followed as far as the tyres allow. The inversion needs the measured acceleration. With dead time in its commands, the
//! vehicle brakes harder than a profile with a step.

mod inverse;
#[cfg(test)]
mod margins;

use crate::geometry::{Point, wrap_angle};
use crate::trajectory::{Path, SpeedProfile, Trajectory};
use crate::vehicle::{State, Vehicle};

use self::inverse::{Drive, Inverse};
use super::actuators::Command;
use crate::vehicle::GRAVITY;

/// Bandwidth of a loop times the lag of its actuator: see "Tuning" in the module documentation.
const LAG_SHARE: f64 = 0.25;
/// Largest bandwidth of the lateral feedback in time, rad/s: above it, localisation noise would reach the steering.
const LATERAL_BANDWIDTH: f64 = 2.5;
/// Largest bandwidth of the lateral feedback along the path, 1/m. Active at walking pace.
const LATERAL_BANDWIDTH_PER_METRE: f64 = 0.5;
/// Largest curvature that the lateral feedback may add, 1/m.
const LARGEST_CURVATURE_FEEDBACK: f64 = 0.1;
/// Largest lateral acceleration that the lateral feedback may add, m/s².
const LARGEST_LATERAL_FEEDBACK: f64 = 2.0;
/// Largest bandwidth of the longitudinal feedback, rad/s: 1 m of station error demands about 2 m/s².
const LONGITUDINAL_BANDWIDTH: f64 = 1.5;
/// Largest acceleration that the longitudinal feedback may add, m/s².
const LARGEST_ACCELERATION_FEEDBACK: f64 = 2.0;
/// The profile has ended once its speed stays zero for this long, s.
const STANDSTILL_PREVIEW: f64 = 0.5;
/// Reference speeds below this are zero up to the rounding of a profile, m/s.
const STANDSTILL_REFERENCE: f64 = 1e-3;
/// Below this speed the vehicle counts as standing still when the profile does, m/s.
const STANDSTILL_SPEED: f64 = 0.03;
/// Above this speed beyond the end, the stop has failed and the vehicle brakes as hard as its profile at its hardest, m/s.
/// This happens in an emergency that began later than the brakes' lag allows. Stops with a ramp are slower there.
const OVERRUN: f64 = 2.0 * STANDSTILL_SPEED;
/// Within this distance before the end, the brakes hold the vehicle where it stands, m.
const STOP_TOLERANCE: f64 = 0.03;
/// Distance before the end at which a stop aims, m.
const AIM_SHORT: f64 = 0.015;
/// Distance before the end over which the aim moves to [`AIM_SHORT`], m.
const AIM_BLEND: f64 = 5.0;
/// Time by which the brakes release a stop without a ramp early, over their lag. At 1 the vehicle would roll Δa τ²/2
/// beyond the end; at ½ it stops within 0.03 Δa τ² of it, and still more softly than planned.
const STOP_RELEASE: f64 = 0.5;
/// Deceleration with which the brakes hold the vehicle at standstill, m/s².
const HOLD: f64 = 2.0;
/// Share of the grip as believed that the controller may demand: more than proofs use
/// ([`CONTROL_SHARE`](crate::vehicle::CONTROL_SHARE)), less than anti-lock leaves (0.98).
const GRIP_SHARE: f64 = 0.95;
/// Share of the grip that remains for braking in any turn: braking also reduces the lateral acceleration.
const LEAST_SHARE: f64 = 0.5;
/// Deceleration below which a profile hardly brakes, m/s².
const COASTING: f64 = 0.5;

/// Decides, at the control rate, on the commands to steering, drive and brakes.
///
/// The interface between the simulation and its controller: [`TrackingController`] by default; a test may insert
/// another one, e.g. to check that the verdict detects a faulty one.
pub trait Controller: Send + Sync {
    /// The command for the next `period` seconds, for a vehicle in `state` that follows `trajectory`.
    fn command(&self, vehicle: &Vehicle, trajectory: &Trajectory, state: &State, period: f64) -> Command;
}

/// The controller described at the head of this module's file: feed-forward and feedback, without memory. By default it
/// believes that the road is dry.
#[derive(Debug, Clone, Copy)]
pub struct TrackingController {
    friction: f64,
}

impl TrackingController {
    /// A controller for a road whose friction is believed to be `friction` times that of dry asphalt.
    #[must_use]
    pub fn on_road(friction: f64) -> Self {
        Self { friction }
    }
}

impl Default for TrackingController {
    fn default() -> Self {
        Self::on_road(1.0)
    }
}

impl Controller for TrackingController {
    fn command(&self, vehicle: &Vehicle, trajectory: &Trajectory, state: &State, period: f64) -> Command {
        command(vehicle, self.friction * vehicle.tyres.friction, trajectory, state, period)
    }
}

/// The grip that the controller may demand, m/s²: the radius of the friction circle.
#[derive(Debug, Clone, Copy)]
struct Grip(f64);

impl Grip {
    fn new(friction: f64) -> Self {
        Self(GRIP_SHARE * friction * GRAVITY)
    }

    /// The largest acceleration in one direction beside one in the other, m/s².
    fn beside(self, other: f64) -> f64 {
        (self.0 * self.0 - other * other).max((LEAST_SHARE * self.0).powi(2)).sqrt()
    }
}

/// Bandwidth of the lateral feedback along the path at a speed, 1/m.
fn lateral_bandwidth(vehicle: &Vehicle, speed: f64) -> f64 {
    let in_time = LATERAL_BANDWIDTH.min(LAG_SHARE / vehicle.lateral_lag(speed));
    LATERAL_BANDWIDTH_PER_METRE.min(in_time / speed)
}

/// Bandwidth of the longitudinal feedback, rad/s.
fn longitudinal_bandwidth(vehicle: &Vehicle) -> f64 {
    let actuators = &vehicle.actuators;
    LONGITUDINAL_BANDWIDTH.min(LAG_SHARE / actuators.drive_lag.max(actuators.brake_lag))
}

/// The command of [`TrackingController`] on a road with a friction coefficient.
fn command(vehicle: &Vehicle, friction: f64, trajectory: &Trajectory, state: &State, period: f64) -> Command {
    let reference = trajectory.at(state.time);
    let projection = project(&trajectory.path, state.pose.position, reference.station);
    let (speed, grip) = (state.speed.max(0.0), Grip::new(friction));
    // loads and grip follow the real acceleration, which lags behind the reference
    let effort = state.acceleration + vehicle.resistance(speed);
    let drive = Drive { speed, acceleration: state.acceleration, effort };
    let model = Inverse::new(vehicle, friction, &trajectory.path, drive);
    let lateral = grip.beside(reference.acceleration);
    let added = curvature_feedback(vehicle, &model, state, &projection, lateral);
    let lag = vehicle.actuators.steering_lag + 0.5 * period;
    let steering = model.steering(projection.station + speed * lag, added);
    let longitudinal = grip.beside(speed * speed * (projection.curvature + added));
    Command {
        steering: steering.clamp(-vehicle.limits.steering, vehicle.limits.steering),
        acceleration: acceleration(vehicle, trajectory, state, projection.station, 0.5 * period)
            .clamp(-longitudinal, longitudinal),
    }
}

/// Curvature that the feedback adds to the path's, 1/m. Together they demand at most a lateral acceleration of `largest`
/// (m/s²).
fn curvature_feedback(
    vehicle: &Vehicle,
    model: &Inverse<'_>,
    state: &State,
    projection: &Projection,
    largest: f64,
) -> f64 {
    let speed = state.speed.max(0.0);
    let heading_error = wrap_angle(state.pose.yaw - projection.yaw - model.rear_slip(projection.station, 0.0));
    let omega = lateral_bandwidth(vehicle, speed);
    let feedback = -omega * omega * projection.offset - 2.0 * omega * heading_error;
    let bound = LARGEST_CURVATURE_FEEDBACK.min(LARGEST_LATERAL_FEEDBACK / (speed * speed));
    let (of_path, in_grip) = (projection.curvature, largest / (speed * speed));
    // a path that exceeds the grip is left to the tyres
    let (least, most) = ((-in_grip - of_path).min(0.0), (in_grip - of_path).max(0.0));
    feedback.clamp(-bound, bound).clamp(least, most)
}

fn acceleration(vehicle: &Vehicle, trajectory: &Trajectory, state: &State, station: f64, half_period: f64) -> f64 {
    let (profile, since) = (&trajectory.profile, state.time - trajectory.start_time);
    let reference = profile.at(since);
    let aim = aim_station(profile, reference.station);
    let (station_error, speed_error) = (aim - station, reference.speed - state.speed);
    let at_end =
        reference.speed < STANDSTILL_REFERENCE && profile.at(since + STANDSTILL_PREVIEW).speed < STANDSTILL_REFERENCE;
    if at_end && state.speed < STANDSTILL_SPEED && station_error < STOP_TOLERANCE {
        return -HOLD;
    }
    if at_end && state.speed > OVERRUN && station_error < 0.0 {
        let hardest = hardest_braking(profile);
        return -if hardest > COASTING { hardest } else { HOLD };
    }
    let omega = longitudinal_bandwidth(vehicle);
    let feedback = omega * omega * station_error + 2.0 * omega * speed_error;
    let feedback = feedback.clamp(-LARGEST_ACCELERATION_FEEDBACK, LARGEST_ACCELERATION_FEEDBACK);
    let resistance = vehicle.resistance(state.speed);
    let effort = |lag, front_share| {
        let planned = lag_compensated(profile, since + half_period, lag) + feedback;
        let ahead = station + state.speed * (half_period + lag);
        force(vehicle, &trajectory.path, ahead, state.speed, planned, front_share) + resistance
    };
    let actuators = &vehicle.actuators;
    let braking = effort(actuators.brake_lag, actuators.brake_front_share);
    if braking < 0.0 { braking } else { effort(actuators.drive_lag, actuators.drive_front_share).max(0.0) }
}

/// Force of drive or brakes over mass for an acceleration of the rear axle, m/s², for wheels that roll without side slip.
///
/// The kinetic energy is then ½ m v² (1 + (b² + k²) κ² + spin), with the distance b of the centre of mass from the rear axle and the
/// radius of gyration k. Without the yaw motion's part, the vehicle loses speed where the curvature grows and gains speed where it
/// falls. The front wheels run faster than the rear ones, by √(1 + L² κ²), so a force there does more work.
fn force(vehicle: &Vehicle, path: &Path, station: f64, speed: f64, acceleration: f64, front_share: f64) -> f64 {
    let spin = 4.0 * vehicle.wheel_inertia / (vehicle.mass * vehicle.wheel_radius * vehicle.wheel_radius);
    let yaw = vehicle.rear_axle_to_mass * vehicle.rear_axle_to_mass + vehicle.yaw_inertia / vehicle.mass;
    let (curvature, rate) = path.curvature_and_rate_at(station);
    let needed = acceleration * (1.0 + spin + yaw * curvature * curvature) + yaw * curvature * rate * speed * speed;
    let front = (vehicle.wheelbase * curvature).hypot(1.0);
    needed / (1.0 + front_share * (front - 1.0))
}

/// Largest deceleration of a profile, m/s².
fn hardest_braking(profile: &SpeedProfile) -> f64 {
    let within = profile.knots().windows(2).map(|pair| pair[0].after(pair[1].time - pair[0].time).acceleration);
    profile.knots().iter().map(|k| k.acceleration).chain(within).fold(0.0, |hardest, a| hardest.max(-a))
}

/// The station to aim at: the profile's, moved before the end where the profile ends at standstill.
fn aim_station(profile: &SpeedProfile, station: f64) -> f64 {
    if !profile.ends_at_standstill() {
        return station;
    }
    let left = profile.last().station - station;
    station - AIM_SHORT * (1.0 - left / AIM_BLEND).clamp(0.0, 1.0)
}

/// Input of a first-order lag at `time` whose output is the profile's acceleration. It is a + τ ȧ where the
/// acceleration is continuous, which is exact. Jumps, which no lag can follow, are commanded τ earlier, which results
/// in the right speed. Only the jump to standstill is commanded later, since position matters there.
fn lag_compensated(profile: &SpeedProfile, time: f64, lag: f64) -> f64 {
    let (knots, from) = (profile.knots(), profile.at(time));
    let next = knots.partition_point(|k| k.time <= time).max(1);
    let mut jumps = 0.0;
    for pair in knots[next - 1..].windows(2).take_while(|pair| pair[1].time <= time + lag) {
        let before = pair[0].after(pair[1].time - pair[0].time).acceleration;
        let is_last = pair[1].time >= profile.last().time;
        if !is_last {
            jumps += pair[1].acceleration - before;
        } else if !profile.ends_at_standstill() || pair[1].time <= time + STOP_RELEASE * lag {
            jumps -= before;
        }
    }
    from.acceleration + lag * from.jerk + jumps
}

/// Projection of the vehicle onto its path.
struct Projection {
    /// Station of the nearest point; beyond the ends of the path, on its tangents there, m.
    station: f64,
    /// Signed distance from the path, left positive, m.
    offset: f64,
    yaw: f64,
    /// Curvature of the path, 1/m.
    curvature: f64,
}

/// Projects onto the path: Newton's method from the reference station. If the vehicle is far from it, a search over the
/// whole path comes first.
fn project(path: &Path, position: Point, guess: f64) -> Projection {
    /// Closer than this to the reference point, Newton's method converges to the nearest point of the path, m.
    const NEAR: f64 = 2.0;
    let distance = |station: f64| (path.at(station).pose.position - position).norm();
    let mut station = guess.clamp(0.0, path.length());
    if distance(station) > NEAR {
        let coarse = path.sampled(1.0).into_iter().map(|(s, p)| (s, (p.pose.position - position).norm()));
        station = coarse.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(station, |(s, _)| s);
    }
    let mut at = path.at(station);
    let mut local = at.pose.to_local(position);
    for _ in 0..8 {
        // derivative of the along-track error by station; bounded away from the centre of curvature
        let slope = (1.0 - at.curvature * local.y).max(0.2);
        let next = (station + local.x / slope).clamp(0.0, path.length());
        let moved = (next - station).abs();
        station = next;
        at = path.at(station);
        local = at.pose.to_local(position);
        if moved < 1e-9 {
            break;
        }
    }
    Projection { station: station + local.x, offset: local.y, yaw: at.pose.yaw, curvature: at.curvature }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::geometry::spiral::CubicSpiral;
    use crate::trajectory::SpeedKnot;

    fn winding() -> Path {
        let s = |knots| CubicSpiral { knots, length: 30.0 };
        Path::new(Pose::new(3.0, -2.0, 0.4), &[s([0.0, 0.05, 0.05, 0.0]), s([0.0, -0.05, -0.05, 0.0])]).unwrap()
    }

    #[test]
    fn projection_is_the_nearest_of_many_points_and_left_is_positive() {
        let path = winding();
        let fine = path.sampled(0.01);
        for i in 0..60 {
            let (s, offset) = (i as f64, ((i * 7) % 5) as f64 - 2.0);
            let p = path.at(s).pose.to_world(Point::new(0.0, offset));
            let found = project(&path, p, s + 1.0);
            let nearest = fine.iter().map(|(_, q)| (q.pose.position - p).norm()).fold(f64::INFINITY, f64::min);
            assert!((found.offset.abs() - nearest).abs() < 1e-3, "{s}: {} {nearest}", found.offset);
            assert!((found.offset - offset).abs() < 1e-6 && (found.station - s).abs() < 1e-6, "{s} {offset}");
        }
    }

    #[test]
    fn the_station_continues_on_the_tangent_beyond_the_ends() {
        let path = winding();
        let end = path.at(path.length()).pose;
        let found = project(&path, end.advanced(1.5).position, path.length());
        assert!((found.station - path.length() - 1.5).abs() < 1e-9 && found.offset.abs() < 1e-9);
        let found = project(&path, path.at(0.0).pose.advanced(-0.7).position, 0.0);
        assert!((found.station + 0.7).abs() < 1e-9);
    }

    fn knot(time: f64, acceleration: f64, jerk: f64) -> SpeedKnot {
        SpeedKnot { time, station: 0.0, speed: 10.0, acceleration, jerk }
    }

    /// Speed error behind a lag whose input is compensated: at the end of the profile, and the largest one, m/s.
    fn speed_error(profile: &SpeedProfile, lag: f64) -> (f64, f64) {
        let dt = 1e-4;
        let (mut output, mut error, mut worst): (f64, f64, f64) = (0.0, 0.0, 0.0);
        for i in 0..60_000 {
            let time = -1.0 + dt * f64::from(i);
            output += (lag_compensated(profile, time, lag) - output) * dt / lag;
            error += (output - profile.at(time).acceleration) * dt;
            worst = worst.max(error.abs());
        }
        (error, worst)
    }

    #[test]
    fn a_lag_compensated_input_reproduces_the_profile() {
        let smooth = [
            knot(-1.0, 0.0, 0.0),
            knot(0.0, 0.0, -2.5),
            knot(0.6, -1.5, 0.0),
            knot(1.5, -1.5, 2.5),
            knot(2.1, 0.0, 0.0),
        ];
        let jumps = [
            knot(-1.0, 0.0, 0.0),
            knot(0.0, -1.5, 0.0),
            knot(0.8, -1.5, 1.0),
            knot(1.8, -0.5, 0.0),
            knot(2.1, 0.0, 0.0),
        ];
        for lag in [0.05, 0.1, 0.3] {
            let (end, worst) = speed_error(&SpeedProfile::new(smooth.to_vec()).unwrap(), lag);
            assert!(
                end.abs() < 1e-3 && worst < 1e-3,
                "smooth, lag {lag} s: {end} m/s at the end, {worst} m/s at worst"
            );
            let (end, worst) = speed_error(&SpeedProfile::new(jumps.to_vec()).unwrap(), lag);
            // in between, a jump causes the error of the lag's exponential
            assert!(end.abs() < 1e-3 && worst < 1.5 * lag * 0.4, "jumps, lag {lag} s: {end} m/s, {worst} m/s at worst");
        }
    }

    /// The work of the force is the change of the kinetic energy of rigid body and wheels.
    #[test]
    fn the_force_does_the_work_that_a_bend_needs() {
        let path = winding();
        for name in crate::vehicle::builtin_names() {
            let v = crate::vehicle::load(name).unwrap();
            let yaw = v.rear_axle_to_mass * v.rear_axle_to_mass + v.yaw_inertia / v.mass;
            let spin = 4.0 * v.wheel_inertia / (v.mass * v.wheel_radius * v.wheel_radius);
            let energy = |station: f64, speed: f64| {
                let curvature = path.at(station).curvature;
                0.5 * speed * speed * (1.0 + spin + yaw * curvature * curvature)
            };
            let step = 1e-5;
            for (station, speed, acceleration, front) in
                [(3.0, 4.0, 0.0, 0.0), (12.0, 2.0, -2.0, 0.6), (27.0, 6.0, -1.0, 1.0), (50.0, 3.0, 1.0, 0.3)]
            {
                // along the path, v² changes by 2 a per metre
                let at = |ds: f64| energy(station + ds, (speed * speed + 2.0 * acceleration * ds).sqrt());
                let work = (at(step) - at(-step)) / (2.0 * step);
                let faster = (v.wheelbase * path.at(station).curvature).hypot(1.0);
                let distance = front * faster + 1.0 - front;
                let found = force(&v, &path, station, speed, acceleration, front) * distance;
                assert!((found - work).abs() < 1e-6, "{name} {station} m: {found} {work}");
            }
        }
    }

    #[test]
    fn demands_stay_within_the_grip_of_the_road_as_believed() {
        let v = crate::vehicle::load("bmw_320i").unwrap();
        let profile = SpeedProfile::new(vec![knot(0.0, -8.0, 0.0), knot(1.0, 0.0, 0.0)]).unwrap();
        let t = Trajectory { start_time: 0.0, path: winding(), profile };
        for friction in [1.0, 0.6, 0.15] {
            let grip = GRIP_SHARE * friction * v.tyres.friction * GRAVITY;
            for (offset, speed) in [(1.0, 14.0), (-1.0, 9.0), (0.0, 3.0)] {
                let position = t.path.at(2.0).pose.to_world(Point::new(0.0, offset));
                let pose = Pose { position, ..t.path.at(2.0).pose };
                let state = State {
                    time: 0.2,
                    pose,
                    speed,
                    lateral_speed: 0.0,
                    acceleration: 0.0,
                    yaw_rate: 0.0,
                    steering: 0.0,
                };
                let command = TrackingController::on_road(friction).command(&v, &t, &state, 0.01);
                assert!(command.acceleration.abs() <= grip + 1e-12, "{friction} {speed}: {command:?}");
                // the path's lateral acceleration and the feedback's together
                let room = Grip::new(friction * v.tyres.friction).beside(0.0);
                let projection = project(&t.path, pose.position, 2.0);
                let model = Inverse::new(&v, friction, &t.path, Drive { speed, acceleration: 0.0, effort: 0.0 });
                let total = projection.curvature + curvature_feedback(&v, &model, &state, &projection, room);
                assert!(total.abs() * speed * speed <= room.max(projection.curvature.abs() * speed * speed) + 1e-9);
            }
        }
        let grip = Grip::new(1.0);
        assert!((grip.beside(0.6 * grip.0) - 0.8 * grip.0).abs() < 1e-12);
        assert_eq!(grip.beside(2.0 * grip.0), LEAST_SHARE * grip.0);
    }

    #[test]
    fn the_aim_moves_before_a_stop_without_a_jump() {
        let ends = |speed: f64| {
            SpeedProfile::new(vec![knot(0.0, 0.0, 0.0), SpeedKnot { station: 30.0, speed, ..knot(3.0, 0.0, 0.0) }])
                .unwrap()
        };
        assert_eq!((aim_station(&ends(5.0), 30.0), aim_station(&ends(0.0), 20.0)), (30.0, 20.0));
        let samples: Vec<f64> = (0..=300).map(|i| aim_station(&ends(0.0), 0.1 * f64::from(i))).collect();
        assert!(samples.windows(2).all(|w| w[1] > w[0] && w[1] - w[0] < 0.101), "always forwards");
        assert!((samples[300] - (30.0 - AIM_SHORT)).abs() < 1e-12);
    }
}
