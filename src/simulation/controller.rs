//! The tracking controller: what steering and acceleration to ask for, so that the vehicle drives its trajectory.
//!
//! Feed-forward carries the load and feedback the rest.
//! - **Steering**: the path's curvature ahead, where the rear axle will be once the steering has followed (its lag and the
//!   tyres' response), plus the understeer that the tyres need at that lateral acceleration. Feedback on lateral offset e
//!   and heading error ψ of the rear axle, κ = −ω² e − 2 ω ψ: both poles of the error, seen along the path, at ω (1/m). ω
//!   is a fixed bandwidth in time over the speed, bounded at low speed (Paden et al. 2016, section V, for the kinematic
//!   error model). In a turn the body points inwards of its path by the rear tyres' slip angle: that is wanted, not an error.
//! - **Acceleration**: the profile's, read ahead by the lag of drive or brakes, plus drag, rolling resistance and the
//!   inertia of the wheels' spin; feedback on station and speed error with both poles at one place, bounded. The station
//!   error does the work of an integrator, so there is none that could wind up.
//! - **Stop**: when the wanted speed is zero and stays zero, the brakes hold once the vehicle is at rest. Short of the
//!   end by more than a tolerance it creeps on; it never drives backwards.
//!
//! Weak where: friction lower than the vehicle's own is not known to the controller, and trajectories that ask for more
//! than the tyres have are followed as far as they go.

use crate::geometry::{Point, wrap_angle};
use crate::trajectory::{Path, Trajectory};
use crate::vehicle::{State, Vehicle};

use super::actuators::Command;
use super::chassis::GRAVITY;

/// Bandwidth of the lateral feedback in time, rad/s: a fifth of what steering lag and tyres allow.
const LATERAL_BANDWIDTH: f64 = 2.5;
/// Largest bandwidth of the lateral feedback along the path, 1/m: a car length at walking pace.
const LATERAL_BANDWIDTH_ALONG: f64 = 0.5;
/// Largest curvature that the lateral feedback may add, 1/m.
const LARGEST_CURVATURE_FEEDBACK: f64 = 0.1;
/// Largest lateral acceleration that the lateral feedback may add, m/s².
const LARGEST_LATERAL_FEEDBACK: f64 = 2.0;
/// Response of the tyres to steering beyond the steering's own lag, s.
const TYRE_RESPONSE: f64 = 0.03;
/// Bandwidth of the longitudinal feedback, rad/s.
const LONGITUDINAL_BANDWIDTH: f64 = 1.5;
/// Largest acceleration that the longitudinal feedback may add, m/s².
const LARGEST_ACCELERATION_FEEDBACK: f64 = 2.0;
/// The profile is at its end when it stays at rest this long, s.
const REST_PREVIEW: f64 = 0.5;
/// Wanted speeds below this are rest, up to the rounding of a profile, m/s.
const WANTED_REST: f64 = 1e-3;
/// Slower than this the vehicle counts as at rest when the profile is, m/s.
const AT_REST: f64 = 0.03;
/// Short of the end by less than this, the vehicle is held where it is, m.
const STOP_TOLERANCE: f64 = 0.03;
/// Deceleration with which the brakes hold at rest, m/s².
const HOLD: f64 = 2.0;

/// Decides, at the control rate, what is asked of steering, drive and brakes.
///
/// The seam between the rig and whoever drives in it: [`TrackingController`] unless a test puts another one there, e.g. to
/// see that the verdict notices a wrong one.
pub trait Controls: Send + Sync {
    /// The command that holds for the next `period` seconds, for a vehicle at `state` that is to follow `trajectory`.
    fn command(&self, vehicle: &Vehicle, trajectory: &Trajectory, state: &State, period: f64) -> Command;
}

/// The controller described at the head of this module's file: feed-forward and feedback, without memory.
#[derive(Debug, Clone, Copy, Default)]
pub struct TrackingController;

impl Controls for TrackingController {
    fn command(&self, vehicle: &Vehicle, trajectory: &Trajectory, state: &State, period: f64) -> Command {
        command(vehicle, trajectory, state, period)
    }
}

/// What the controller asks for.
pub(super) fn command(vehicle: &Vehicle, trajectory: &Trajectory, state: &State, period: f64) -> Command {
    let wanted = trajectory.at(state.time);
    let here = project(&trajectory.path, state.pose.position, wanted.station);
    Command {
        steering: steering(vehicle, &trajectory.path, state, &here),
        acceleration: acceleration(vehicle, trajectory, state, here.station, 0.5 * period),
    }
}

fn steering(vehicle: &Vehicle, path: &Path, state: &State, here: &Projection) -> f64 {
    let tyres = &vehicle.tyres;
    let speed = state.speed.max(0.0);
    let lag = vehicle.actuators.steering_lag + TYRE_RESPONSE;
    let ahead = path.at(here.station + speed * lag);
    let rear_slip = speed * speed * here.curvature / (GRAVITY * tyres.cornering_rear);
    let heading_error = wrap_angle(state.pose.yaw - here.yaw - rear_slip);
    let omega = LATERAL_BANDWIDTH_ALONG.min(LATERAL_BANDWIDTH / speed);
    let feedback = -omega * omega * here.offset - 2.0 * omega * heading_error;
    let largest = LARGEST_CURVATURE_FEEDBACK.min(LARGEST_LATERAL_FEEDBACK / (speed * speed));
    let feedback = feedback.clamp(-largest, largest);
    let understeer =
        speed * speed * ahead.curvature / GRAVITY * (1.0 / tyres.cornering_front - 1.0 / tyres.cornering_rear);
    let steering = vehicle.steering_for_curvature(ahead.curvature + feedback) + understeer;
    steering.clamp(-vehicle.limits.steering, vehicle.limits.steering)
}

fn acceleration(vehicle: &Vehicle, trajectory: &Trajectory, state: &State, station: f64, half_period: f64) -> f64 {
    let wanted = trajectory.at(state.time);
    let (station_error, speed_error) = (wanted.station - station, wanted.speed - state.speed);
    let later = trajectory.profile.at(state.time + REST_PREVIEW - trajectory.start_time);
    let at_end = wanted.speed < WANTED_REST && later.speed < WANTED_REST;
    if at_end && state.speed < AT_REST && station_error < STOP_TOLERANCE {
        return -HOLD;
    }
    let ahead = |lag: f64| trajectory.profile.at(state.time + lag + half_period - trajectory.start_time).acceleration;
    let brake = ahead(vehicle.actuators.brake_lag);
    let feed_forward = if brake < 0.0 { brake } else { ahead(vehicle.actuators.drive_lag) };
    let omega = LONGITUDINAL_BANDWIDTH;
    let feedback = omega * omega * station_error + 2.0 * omega * speed_error;
    let feedback = feedback.clamp(-LARGEST_ACCELERATION_FEEDBACK, LARGEST_ACCELERATION_FEEDBACK);
    let spin = 1.0 + 4.0 * vehicle.wheel_inertia / (vehicle.mass * vehicle.wheel_radius * vehicle.wheel_radius);
    (feed_forward + feedback) * spin + resistance(vehicle, state.speed)
}

/// Deceleration by rolling resistance and drag, m/s².
pub(super) fn resistance(vehicle: &Vehicle, speed: f64) -> f64 {
    vehicle.tyres.rolling_resistance * GRAVITY + vehicle.tyres.drag * speed * speed.abs() / vehicle.mass
}

/// Where the vehicle is on its path.
struct Projection {
    /// Station of the nearest point; beyond the ends of the path, on its tangents there, m.
    station: f64,
    /// Signed distance from the path, left positive, m.
    offset: f64,
    yaw: f64,
    curvature: f64,
}

/// Projects onto the path: Newton's method from the wanted station, which is near unless the vehicle was thrown off;
/// then a search over the whole path first.
fn project(path: &Path, position: Point, guess: f64) -> Projection {
    /// Nearer than this to the wanted point, the nearest point of the path is surely the one that Newton finds, m.
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
        // derivative of the along-track error by station; kept away from the centre of curvature
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
    fn beyond_the_ends_the_station_goes_on_along_the_tangent() {
        let path = winding();
        let end = path.at(path.length()).pose;
        let found = project(&path, end.advanced(1.5).position, path.length());
        assert!((found.station - path.length() - 1.5).abs() < 1e-9 && found.offset.abs() < 1e-9);
        let found = project(&path, path.at(0.0).pose.advanced(-0.7).position, 0.0);
        assert!((found.station + 0.7).abs() < 1e-9);
    }
}
