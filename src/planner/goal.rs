//! The goal of a planning problem in the coordinates of a reference line.

use std::f64::consts::FRAC_PI_2;

use crate::geometry::steps::fitting;
use crate::geometry::{Pose, wrap_angle};
use crate::lattice::Target;
use crate::map::{Goal, GoalPosition, Interval, LaneletId, RoadNetwork, Shape};
use crate::reference::ReferenceLine;
use crate::vehicle::Vehicle;

/// The goal on a reference line: stations, poses, speed and time window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalOnLane {
    /// First station of the rear axle at which the vehicle's centre is inside the goal, m.
    pub near: f64,
    /// Last such station, m.
    pub far: f64,
    /// Permitted speeds at the goal, m/s.
    pub speed: (f64, f64),
    /// Time window of the goal, s of the run.
    pub window: (f64, f64),
    /// The poses with which the vehicle meets a goal that is short.
    pub target: Option<Target>,
}

/// Driving time before the window of a goal closes at which the vehicle should be there, s: a cycle, and what traffic takes of it.
const RESERVE: f64 = 0.4;

/// The constant speed that a vehicle has to reach with an acceleration (m/s²) to drive a distance (m) in a time (s), m/s; `None` if that
/// is impossible. It may be less than the present speed (m/s).
fn speed_in_time(distance: f64, time: f64, speed: f64, acceleration: f64) -> Option<f64> {
    if time <= 0.0 {
        return None;
    }
    let ahead = distance - speed * time;
    if ahead <= 0.0 {
        return Some(distance / time);
    }
    // distance = u t − (u − v)² / 2a: the vehicle is as much behind as it takes to speed up
    let gain = acceleration * time;
    let root = gain * gain - 2.0 * acceleration * ahead;
    (root >= 0.0).then(|| speed + gain - root.sqrt())
}

/// A longer goal has no [`Target`]: the vehicle may meet it anywhere, m.
const LONGEST_TARGET: f64 = 10.0;
/// Sampling along the line, and aside, m.
const STEP: f64 = 0.5;
const ASIDE: f64 = 0.05;
/// Steps aside to either side: as far as the nodes of the lattice go by default, 4 m.
const STEPS_ASIDE: i32 = 80;
/// Largest heading relative to the lane where the goal has none, rad.
const TURNED: f64 = FRAC_PI_2;

/// A goal with a lower speed limit than this (m/s) requires a stop.
const STOP_SPEED: f64 = 1.0;

impl GoalOnLane {
    /// The goal in the lane of a reference line; `None` if it is not there or has no position.
    #[must_use]
    pub fn find(goal: &Goal, network: &RoadNetwork, line: &ReferenceLine, vehicle: &Vehicle) -> Option<Self> {
        let (near, far, target) = match goal.position.as_ref()? {
            GoalPosition::Lanelets(ids) => {
                let (near, far) = stretch(line, vehicle, (0.0, 0.0), |centre| is_on(ids, network, centre))?;
                (near, far, None)
            }
            GoalPosition::Shapes(shape) => in_shape(shape, goal.yaw, line, vehicle)?,
        };
        Some(Self {
            near,
            far,
            speed: goal.speed.map_or((0.0, f64::INFINITY), |s| (s.min, s.max)),
            window: (goal.time.min, goal.time.max),
            target,
        })
    }

    /// Whether the goal requires a stop.
    #[must_use]
    pub fn is_stop(&self) -> bool {
        self.speed.1 < STOP_SPEED
    }

    /// Station for a stop in the goal, m.
    #[must_use]
    pub fn stop_station(&self) -> f64 {
        // the middle, at most 5 m into a long region
        self.near + (0.5 * (self.far - self.near)).min(5.0)
    }

    /// The speed that the vehicle has to reach with an acceleration (m/s²) to be in the goal before its time window closes and as fast as
    /// it asks for, m/s. `None` if it is in the goal or behind it, or too late.
    #[must_use]
    pub fn speed_in_time(&self, station: f64, time: f64, speed: f64, acceleration: f64) -> Option<f64> {
        let distance = (station < self.near).then_some(self.near - station)?;
        let in_time = speed_in_time(distance, self.window.1 - RESERVE - time, speed, acceleration)?;
        Some(in_time.max(self.speed.0))
    }

    /// The time that a vehicle at a station (m) at a time has until it should leave the goal: just after the window opens, s. `None` if the
    /// window is open, or the vehicle behind the goal.
    #[must_use]
    pub fn time_in_front(&self, station: f64, time: f64) -> Option<f64> {
        /// The vehicle leaves the goal this long after its window opens, s, or in the middle of a short window.
        const INSIDE: f64 = 0.5;
        let (opens, closes) = self.window;
        (time < opens && station < self.far).then(|| opens + INSIDE.min(0.5 * (closes - opens)) - time)
    }
}

/// Whether a state meets the position, heading and speed of a goal; `centre` is the pose of the vehicle's centre.
pub(super) fn is_met(goal: &Goal, network: &RoadNetwork, centre: &Pose, speed: f64) -> bool {
    let is_there = match &goal.position {
        None => true,
        Some(GoalPosition::Shapes(shape)) => shape.contains(centre.position),
        Some(GoalPosition::Lanelets(ids)) => is_on(ids, network, centre),
    };
    let has_heading = goal.yaw.is_none_or(|yaw| {
        let (low, high) = relative(yaw, centre.yaw);
        low <= 0.0 && 0.0 <= high
    });
    is_there && has_heading && goal.speed.is_none_or(|speeds| speeds.contains(speed))
}

/// The ends of an interval of headings relative to a heading, rad.
fn relative(yaw: Interval, to: f64) -> (f64, f64) {
    let half = 0.5 * (yaw.max - yaw.min);
    let middle = wrap_angle(f64::midpoint(yaw.min, yaw.max) - to);
    (middle - half, middle + half)
}

/// Whether a pose is on one of these lanelets.
fn is_on(ids: &[LaneletId], network: &RoadNetwork, centre: &Pose) -> bool {
    ids.iter().any(|id| network.lanelets.get(id).is_some_and(|l| l.contains(centre.position)))
}

/// The first stretch on which the vehicle's centre is inside, with the rear axle at an offset (m) and a heading (rad) relative to the line.
fn stretch(
    line: &ReferenceLine,
    vehicle: &Vehicle,
    (offset, heading): (f64, f64),
    contains: impl Fn(&Pose) -> bool,
) -> Option<(f64, f64)> {
    let (mut near, mut far) = (None, 0.0);
    for station in (0..=fitting(line.length(), STEP)).map(|i| i as f64 * STEP) {
        let on_line = line.offset_pose(station, offset).map(|p| Pose { yaw: p.pose.yaw + heading, ..p.pose });
        if on_line.is_some_and(|pose| contains(&vehicle.centre_of_rear_axle(&pose))) {
            near.get_or_insert(station);
            far = station;
        } else if near.is_some() {
            break;
        }
    }
    near.map(|near| (near, far))
}

/// First and last station in a shape, and the poses that meet it; `None` if it is not in the lane of the line.
fn in_shape(
    shape: &Shape,
    yaw: Option<Interval>,
    line: &ReferenceLine,
    vehicle: &Vehicle,
) -> Option<(f64, f64, Option<Target>)> {
    let contains = |centre: &Pose| shape.contains(centre.position);
    let on_line = stretch(line, vehicle, (0.0, 0.0), contains);
    let ahead = vehicle.centre_of_rear_axle(&Pose::new(0.0, 0.0, 0.0)).position.x;
    let stations = on_line.map_or_else(
        || shape.parts.iter().map(|part| line.project(part.middle()).s - ahead).collect(),
        |(near, far)| vec![f64::midpoint(near, far)],
    );
    let target = stations.into_iter().find_map(|station| target_at(station, ahead, shape, yaw, line, vehicle));
    if let Some((near, far)) = on_line {
        return Some((near, far, target.filter(|_| far - near <= LONGEST_TARGET)));
    }
    let target = target?;
    let (offset, heading) = target.pose();
    let (left, right) = line.lane_bounds(target.station);
    // a goal for which the vehicle would have to leave its lane is none of this lane
    let is_in_lane = offset + 0.5 * vehicle.width <= left && 0.5 * vehicle.width - offset <= right;
    let (near, far) = stretch(line, vehicle, (offset, heading), contains).filter(|_| is_in_lane)?;
    Some((near, far, (far - near <= LONGEST_TARGET).then_some(target)))
}

/// The poses beside a station that meet a shape; `None` if there are none.
fn target_at(
    station: f64,
    ahead: f64,
    shape: &Shape,
    yaw: Option<Interval>,
    line: &ReferenceLine,
    vehicle: &Vehicle,
) -> Option<Target> {
    (0.0..=line.length()).contains(&station).then_some(())?;
    let is_inside = |offset: &f64| {
        let centre = line.offset_pose(station, *offset).map(|p| vehicle.centre_of_rear_axle(&p.pose));
        centre.is_some_and(|centre| shape.contains(centre.position))
    };
    let inside = (-STEPS_ASIDE..=STEPS_ASIDE).map(|i| f64::from(i) * ASIDE).filter(is_inside);
    let offsets = inside.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), l| (a.min(l), b.max(l)));
    let headings = yaw.map_or((-TURNED, TURNED), |yaw| relative(yaw, line.at(station).pose.yaw));
    (offsets.0 <= offsets.1 && headings.0 <= headings.1).then_some(Target { station, offsets, headings, ahead })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 m from 8 m/s with 1.5 m/s²: the distance of the ramp and of the constant speed after it is the one asked for.
    #[test]
    fn the_speed_in_time_drives_the_distance_in_the_time() {
        for (time, speed) in [(3.9, 8.0), (4.2, 8.0), (4.9, 8.0), (12.0, 0.0), (8.0, 0.0)] {
            let (distance, acceleration) = (40.0, 1.5);
            let needed = speed_in_time(distance, time, speed, acceleration).unwrap();
            let ramp = (needed - speed).max(0.0) / acceleration;
            let driven = 0.5 * (speed + needed) * ramp + needed * (time - ramp);
            assert!((driven - distance).abs() < 1e-9 && ramp <= time + 1e-9, "{time} s: {needed} m/s, {driven} m");
        }
        assert_eq!(speed_in_time(40.0, 8.0, 8.0, 1.5), Some(5.0), "it has time");
        assert_eq!(speed_in_time(40.0, 3.0, 8.0, 1.5), None, "8 · 3 + 1.5 · 9 / 2 = 30.75 m");
        assert_eq!(speed_in_time(40.0, 0.0, 8.0, 1.5), None, "the window is closed");
    }

    #[test]
    fn the_least_speed_of_a_goal_is_needed_even_if_less_is_in_time() {
        let goal = |least: f64| GoalOnLane {
            near: 40.0,
            far: 42.0,
            speed: (least, f64::INFINITY),
            window: (0.0, 8.0 + RESERVE),
            target: None,
        };
        let needed = |least: f64| goal(least).speed_in_time(0.0, 0.0, 8.0, 1.5);
        assert_eq!((needed(0.0), needed(4.0), needed(12.0)), (Some(5.0), Some(5.0), Some(12.0)));
        assert_eq!(goal(12.0).speed_in_time(40.0, 0.0, 8.0, 1.5), None, "in the goal");
    }

    /// Headings that wrap: from 170° to 190°, seen from −175° and from 160°.
    #[test]
    fn headings_are_compared_on_the_circle() {
        let yaw = Interval { min: 170.0_f64.to_radians(), max: 190.0_f64.to_radians() };
        let seen = |from: f64| {
            let (low, high) = relative(yaw, from.to_radians());
            (low.to_degrees().round(), high.to_degrees().round())
        };
        assert_eq!((seen(-175.0), seen(185.0), seen(160.0)), ((-15.0, 5.0), (-15.0, 5.0), (10.0, 30.0)));
    }
}
