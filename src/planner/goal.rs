//! The goal of a planning problem in the coordinates of a reference line.

use crate::geometry::steps::fitting;
use crate::geometry::{Pose, wrap_angle};
use crate::map::{Goal, GoalPosition, RoadNetwork};
use crate::reference::{Frenet, ReferenceLine, Via};
use crate::vehicle::Vehicle;

/// The goal on a reference line: stations, speed and time window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalOnLane {
    /// First station of the rear axle at which the vehicle's centre is inside the goal, m.
    pub near: f64,
    /// Last such station, m.
    pub far: f64,
    /// Highest permitted speed at the goal, m/s.
    pub speed_limit: f64,
    /// Time window of the goal, s of the run.
    pub window: (f64, f64),
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

/// A goal whose middle is farther from the line is in another lane, m; half the width of a lane.
const BESIDE: f64 = 1.75;
/// Offsets tried to either side.
const STEPS: i32 = 35;
/// Distance from the border of a goal, if it is wide enough, m: tracking errors, and nodes beside the line.
const OFFSET_RESERVE: f64 = 0.3;
/// The same for headings, rad.
const HEADING_RESERVE: f64 = 0.03;
/// Largest heading relative to the lane, rad.
const STEEPEST: f64 = 0.12;
/// Length before and behind the place with its offset, m.
const HOLDS: f64 = 2.0;
/// Length of a lateral displacement of 1 m, m: at 14 m/s its lateral acceleration is 1 m/s² (the peak of the quintic's second derivative is
/// 5.77); it grows with the square root of the displacement.
const FADES: f64 = 33.0;
/// Shortest such length, m.
const SHORTEST_FADE: f64 = 15.0;

/// The value nearest to 0 inside an interval, with a reserve to its ends if it is wide enough; `None` if it is empty.
fn nearest_inside(low: f64, high: f64, reserve: f64) -> Option<f64> {
    let reserve = reserve.min(0.5 * (high - low));
    (low <= high).then(|| 0.0_f64.max(low + reserve).min(high - reserve))
}

/// A goal with a lower speed limit than this (m/s) requires a stop.
const STOP_SPEED: f64 = 1.0;

impl GoalOnLane {
    /// The first interval of the reference line inside the goal; `None` if the line does not meet it or the goal has no
    /// position.
    #[must_use]
    pub fn find(goal: &Goal, network: &RoadNetwork, line: &ReferenceLine, vehicle: &Vehicle) -> Option<Self> {
        /// Sampling of the line, m.
        const STEP: f64 = 0.5;
        let position = goal.position.as_ref()?;
        let (mut near, mut far) = (None, 0.0);
        for i in 0..=fitting(line.length(), STEP) {
            let station = i as f64 * STEP;
            let centre = vehicle.centre_of_rear_axle(&line.at(station).pose);
            let inside = match position {
                GoalPosition::Shapes(shape) => shape.contains(centre.position),
                GoalPosition::Lanelets(ids) => {
                    ids.iter().any(|id| network.lanelets.get(id).is_some_and(|l| l.contains(centre.position)))
                }
            };
            if inside {
                near.get_or_insert(station);
                far = station;
            } else if near.is_some() {
                break;
            }
        }
        near.map(|near| Self {
            near,
            far,
            speed_limit: goal.speed.map_or(f64::INFINITY, |s| s.max),
            window: (goal.time.min, goal.time.max),
        })
    }

    /// The place beside the reference line that it has to lead through so that the vehicle meets the goal: as near to the line, and as
    /// parallel to it, as the position and the heading of the goal permit. `None` if the line does, if the vehicle would not be in the lane
    /// there, or the goal has no shape.
    #[must_use]
    pub fn beside(goal: &Goal, line: &ReferenceLine, vehicle: &Vehicle) -> Option<Via> {
        let Some(GoalPosition::Shapes(shape)) = &goal.position else { return None };
        shape.parts.iter().find_map(|part| {
            let Frenet { s, l } = line.project(part.middle());
            let to_centre = vehicle.centre_of_rear_axle(&Pose::new(0.0, 0.0, 0.0)).position.x;
            let station = s - to_centre;
            if l.abs() > BESIDE || !(0.0..=line.length()).contains(&station) {
                return None;
            }
            let is_inside = |offset: &f64| {
                let pose = line.offset_pose(station, *offset).map(|p| vehicle.centre_of_rear_axle(&p.pose));
                pose.is_some_and(|centre| shape.contains(centre.position))
            };
            let inside = (-STEPS..=STEPS).map(|i| f64::from(i) * BESIDE / f64::from(STEPS)).filter(is_inside);
            let (low, high) = inside.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), l| (a.min(l), b.max(l)));
            let (left, right) = line.lane_bounds(station);
            let is_in_lane =
                |offset: &f64| offset + 0.5 * vehicle.width <= left && 0.5 * vehicle.width - offset <= right;
            let offset = nearest_inside(low, high, OFFSET_RESERVE).filter(is_in_lane)?;
            let heading = goal.yaw.map_or(Some(0.0), |yaw| {
                let half = 0.5 * (yaw.max - yaw.min);
                let middle = wrap_angle(f64::midpoint(yaw.min, yaw.max) - line.at(station).pose.yaw);
                nearest_inside(middle - half, middle + half, HEADING_RESERVE)
            })?;
            let heading = heading.clamp(-STEEPEST, STEEPEST);
            let aside = offset.abs() + 3.0 * heading.abs();
            let fades = (FADES * aside.sqrt()).max(SHORTEST_FADE);
            (aside > 0.0).then_some(Via { station, offset, heading, holds: HOLDS, fades })
        })
    }

    /// Whether the goal requires a stop.
    #[must_use]
    pub fn is_stop(&self) -> bool {
        self.speed_limit < STOP_SPEED
    }

    /// Station for a stop in the goal, m.
    #[must_use]
    pub fn stop_station(&self) -> f64 {
        // the middle, at most 5 m into a long region
        self.near + (0.5 * (self.far - self.near)).min(5.0)
    }

    /// The speed that the vehicle has to reach with an acceleration (m/s²) to be in the goal before its time window closes, m/s. `None` if
    /// it is in the goal or behind it, or too late.
    #[must_use]
    pub fn speed_in_time(&self, station: f64, time: f64, speed: f64, acceleration: f64) -> Option<f64> {
        let distance = (station < self.near).then_some(self.near - station)?;
        speed_in_time(distance, self.window.1 - RESERVE - time, speed, acceleration)
    }

    /// The speed with which the vehicle reaches the goal from `station` at `time` just after its time window opens, m/s;
    /// infinite if no speed is too early.
    #[must_use]
    pub fn speed_for_window(&self, station: f64, time: f64) -> f64 {
        /// The vehicle leaves the goal this long after its window opens, s, or in the middle of a short window.
        const INSIDE: f64 = 0.5;
        let (opens, closes) = self.window;
        if time >= opens || station >= self.far {
            return f64::INFINITY;
        }
        (self.far - station) / (opens + INSIDE.min(0.5 * (closes - opens)) - time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 m from 8 m/s with 1.5 m/s²: the distance of the ramp and of the constant speed after it is the one asked for.
    /// A goal from 88 to 90 m, 10 s ahead: the vehicle is in it while its window is open, however short that is.
    #[test]
    fn the_vehicle_is_in_the_goal_while_its_window_is_open() {
        for open in [0.1, 0.4, 1.0, 5.0] {
            let goal = GoalOnLane { near: 88.0, far: 90.0, speed_limit: f64::INFINITY, window: (10.0, 10.0 + open) };
            let speed = goal.speed_for_window(0.0, 0.0);
            let (enters, leaves) = (goal.near / speed, goal.far / speed);
            assert!(leaves > 10.0 && enters < 10.0 + open, "{open} s: from {enters} s to {leaves} s");
            assert_eq!(goal.speed_for_window(0.0, 10.0), f64::INFINITY, "it is open");
            assert_eq!(goal.speed_for_window(90.0, 0.0), f64::INFINITY, "behind it");
        }
    }

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
}
