//! Small test fixtures: lines, roads, obstacles, a car, problems, plans and their records.
//!
//! For the tests and benches of this crate and of crates that build on it. Every function builds a complete, valid
//! value from the few arguments relevant to a test; a test that depends on another field sets it by struct update:
//!
//! ```
//! use stopline::fixtures::{network, parked, scenario, straight_lanelet};
//! use stopline::geometry::Pose;
//! use stopline::map::{Obstacle, ObstacleKind};
//!
//! let lane = straight_lanelet(1, (0.0, 100.0), -1.75, 1.75);
//! let wall = Obstacle { kind: ObstacleKind::Structure, ..parked(7, Pose::new(60.0, 0.0, 0.0), 1.0, 3.5) };
//! let blocked = scenario(network([lane]), vec![wall]);
//! assert!(blocked.network.lanelets[&1].contains(blocked.obstacles[0].pose_at(0.0).unwrap().position));
//! ```
//!
//! The values are constants and are not read from `vehicles/`, so that a test keeps its meaning when a vehicle file
//! changes. Invalid arguments (a line of one point) panic: these functions are not readers. They build values and never
//! plan, so that verdict and planner can be tested on the same worlds and still share no code.

use crate::collision::{CollisionSettings, CollisionWorld};
use crate::geometry::polyline::Polyline;
use crate::geometry::spiral::CubicSpiral;
use crate::geometry::{Point, Pose};
use crate::map::{
    Goal, GoalPosition, InitialState, Interval, Lanelet, LaneletId, Motion, Neighbour, Obstacle, ObstacleKind, Part,
    PlanningProblem, RoadNetwork, Scenario, Shape, TimedPose,
};
use crate::planner::{Cycle, Decision, Plan, Smoothing, Trace};
use crate::trajectory::{Path, SpeedKnot, Trajectory};
use crate::vehicle::{Actuators, Comfort, Footprint, Limits, TrackingTube, Tyres, Vehicle};

/// Time between two states of a moving obstacle, s.
const TIME_STEP: f64 = 0.1;

/// A line through points (m).
///
/// # Panics
/// If fewer than two points differ.
#[must_use]
pub fn line(points: &[(f64, f64)]) -> Polyline {
    Polyline::new(points.iter().map(|&(x, y)| Point::new(x, y))).expect("two points that differ")
}

/// A lanelet between two bounds, in driving direction, without neighbours, predecessors, successors and rules. Its
/// centre line is the middle between the bounds, as in the scenario reader.
///
/// # Panics
/// If the bounds are each other's reverse, so that their middle is a point.
#[must_use]
pub fn lanelet(id: LaneletId, right: Polyline, left: Polyline) -> Lanelet {
    let centre = Lanelet::centre_line(left.points(), right.points(), &left, &right).expect("a middle with a length");
    Lanelet {
        id,
        left,
        right,
        centre,
        successors: Vec::new(),
        predecessors: Vec::new(),
        adjacent_left: None,
        adjacent_right: None,
        speed_limit: None,
        stop_line: None,
        signs: Vec::new(),
        lights: Vec::new(),
        types: Vec::new(),
    }
}

/// A lanelet along x, from `x.0` to `x.1`, between two lateral positions (m).
///
/// # Panics
/// If the length is zero.
#[must_use]
pub fn straight_lanelet(id: LaneletId, x: (f64, f64), right: f64, left: f64) -> Lanelet {
    let bound = |y: f64| line(&[(x.0, y), (x.1, y)]);
    lanelet(id, bound(right), bound(left))
}

/// A network of lanelets, without signs and lights.
#[must_use]
pub fn network(lanelets: impl IntoIterator<Item = Lanelet>) -> RoadNetwork {
    RoadNetwork { lanelets: lanelets.into_iter().map(|l| (l.id, l)).collect(), ..RoadNetwork::default() }
}

/// One lane along x from the origin, its middle on y = 0, as lanelet 1. Width and length in m.
///
/// # Panics
/// If the length is zero.
#[must_use]
pub fn road(width: f64, length: f64) -> RoadNetwork {
    network([straight_lanelet(1, (0.0, length), -0.5 * width, 0.5 * width)])
}

/// Makes one lanelet of a network the successor of another.
///
/// # Panics
/// If a lanelet does not exist.
pub fn follow(network: &mut RoadNetwork, from: LaneletId, to: LaneletId) {
    let missing = "a lanelet of the network";
    network.lanelets.get_mut(&from).expect(missing).successors.push(to);
    network.lanelets.get_mut(&to).expect(missing).predecessors.push(from);
}

/// Two lanes along x in the same direction, of `count` lanelets of 50 m each: 100, 101, … on the right about y = 0 and
/// 200, 201, … on the left about y = 3.5 m, all 3.5 m wide.
#[must_use]
pub fn two_lane_road(count: i64) -> RoadNetwork {
    let mut lanes = RoadNetwork::default();
    for i in 0..count {
        let x = (50.0 * i as f64, 50.0 * i as f64 + 50.0);
        let mut right = straight_lanelet(100 + i, x, -1.75, 1.75);
        let mut left = straight_lanelet(200 + i, x, 1.75, 5.25);
        right.adjacent_left = Some(Neighbour { id: left.id, same_direction: true });
        left.adjacent_right = Some(Neighbour { id: right.id, same_direction: true });
        lanes.lanelets.extend([(right.id, right), (left.id, left)]);
    }
    for i in 1..count {
        follow(&mut lanes, 99 + i, 100 + i);
        follow(&mut lanes, 199 + i, 200 + i);
    }
    lanes
}

/// A scenario of a road and obstacles, with time steps of 0.1 s; no planning problem, no grid.
#[must_use]
pub fn scenario(network: RoadNetwork, obstacles: Vec<Obstacle>) -> Scenario {
    Scenario {
        id: "test".into(),
        version: "2020a".into(),
        time_step: TIME_STEP,
        network,
        obstacles,
        occupancy: None,
        problems: Vec::new(),
        issues: Vec::new(),
    }
}

/// An obstacle of unknown kind.
#[must_use]
pub fn obstacle(id: i64, shape: Shape, motion: Motion) -> Obstacle {
    Obstacle { id, kind: ObstacleKind::Unknown, shape, motion }
}

/// A parked vehicle: a rectangle (m) centred at a pose, its length along the heading.
#[must_use]
pub fn parked(id: i64, pose: Pose, length: f64, width: f64) -> Obstacle {
    let (shape, motion) = (Shape::rectangle(length, width), Motion::Static(pose));
    Obstacle { kind: ObstacleKind::ParkedVehicle, ..obstacle(id, shape, motion) }
}

/// A car of 4.5 m × 1.8 m that drives straight at a constant speed (m/s) from a pose at time 0, for a duration (s).
#[must_use]
pub fn driving(id: i64, from: Pose, speed: f64, duration: f64) -> Obstacle {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // saturating
    let steps = (duration / TIME_STEP).round() as u32;
    let state = |k| {
        let time = TIME_STEP * f64::from(k);
        TimedPose { time, pose: from.advanced(speed * time), speed }
    };
    let motion = Motion::Trajectory((0..=steps).map(state).collect());
    Obstacle { kind: ObstacleKind::Vehicle, ..obstacle(id, Shape::rectangle(4.5, 1.8), motion) }
}

/// A circle about the obstacle's origin. Radius in m.
#[must_use]
pub fn circle(radius: f64) -> Shape {
    Shape { parts: vec![Part::Circle { centre: Point::origin(), radius }] }
}

/// A goal: the vehicle's centre within a rectangle (m) between time 0 and a deadline (s), at any speed and heading.
#[must_use]
pub fn goal(centre: Pose, length: f64, width: f64, deadline: f64) -> Goal {
    let region = Shape { parts: vec![Part::Rectangle { centre, length, width }] };
    Goal {
        position: Some(GoalPosition::Shapes(region)),
        time: Interval { min: 0.0, max: deadline },
        speed: None,
        yaw: None,
    }
}

/// Planning problem 1: from the pose of the vehicle's centre and a speed (m/s) at time 0, to a goal.
#[must_use]
pub fn problem(centre: Pose, speed: f64, goal: Goal) -> PlanningProblem {
    let initial = InitialState { centre, speed, acceleration: 0.0, yaw_rate: 0.0, time_step: 0 };
    PlanningProblem { id: 1, initial, goals: vec![goal] }
}

/// A straight path from a rear-axle pose. Length in m.
///
/// # Panics
/// If the length is zero.
#[must_use]
pub fn straight(start: Pose, length: f64) -> Path {
    Path::new(start, &[CubicSpiral::straight(length)]).expect("a positive length")
}

/// A knot with constant acceleration: s, m, m/s, m/s².
#[must_use]
pub fn knot(time: f64, station: f64, speed: f64, acceleration: f64) -> SpeedKnot {
    SpeedKnot { time, station, speed, acceleration, jerk: 0.0 }
}

/// The collision world of a scenario with predictions up to a horizon (s).
///
/// # Panics
/// If a setting is out of its range.
#[must_use]
pub fn collision_world(
    scenario: &Scenario,
    vehicle: &Vehicle,
    settings: &CollisionSettings,
    horizon: f64,
) -> CollisionWorld {
    let Scenario { network, occupancy, obstacles, .. } = scenario;
    CollisionWorld::new(network, occupancy.as_ref(), obstacles, vehicle, settings, horizon).expect("valid settings")
}

/// The record of a planning cycle that committed a newly proven plan; all other fields are empty.
#[must_use]
pub fn cycle(time: f64, committed: Trajectory) -> Cycle {
    Cycle {
        plan: Plan {
            time,
            trajectory: committed,
            decision: Decision::NewPlan,
            level: crate::planner::Level::Comfort,
            deceleration: 1.5,
            is_robust: false,
            smoothing: Smoothing::Comfortable,
            limited_by: None,
            stops_for: None,
            expected_contact: None,
        },
        trace: Trace::default(),
    }
}

/// A mid-size car: the published dimensions of the BMW 320i, rounded, and round values for the other parameters.
#[must_use]
pub fn vehicle() -> Vehicle {
    const TO_CENTRE: f64 = 1.4227;
    Vehicle {
        name: "bmw_320i".into(),
        commonroad_type: Some(2),
        footprint: Footprint::rectangle(4.508, 1.61, TO_CENTRE),
        length: 4.508,
        width: 1.61,
        wheelbase: 2.5789,
        rear_axle_to_centre: TO_CENTRE,
        rear_axle_to_mass: TO_CENTRE,
        mass_height: 0.5,
        track_width: 1.5,
        mass: 1093.0,
        yaw_inertia: 1791.0,
        wheel_radius: 0.3,
        wheel_inertia: 1.0,
        limits: Limits {
            steering: 1.066,
            steering_rate: 0.4,
            steering_acceleration: 20.0,
            speed: 50.8,
            acceleration: 11.5,
            switching_speed: 7.3,
            deceleration: 11.5,
        },
        tyres: Tyres {
            friction: 1.0,
            cornering_front: 20.0,
            cornering_rear: 20.0,
            longitudinal: 20.0,
            relaxation_length: 0.3,
            rolling_resistance: 0.01,
            drag: 0.4,
        },
        actuators: Actuators {
            drive_lag: 0.2,
            brake_lag: 0.1,
            steering_lag: 0.1,
            drive_front_share: 0.0,
            brake_front_share: 0.6,
        },
        comfort: Comfort {
            acceleration: 2.0,
            deceleration: 2.0,
            aggressive_deceleration: 6.0,
            lateral_acceleration: 3.0,
            jerk: 3.0,
        },
        tracking: TrackingTube {
            speed: [40.0, 30.0, 20.0],
            lateral: [0.05, 0.5],
            longitudinal: [0.05, 0.1],
            heading: [0.02, 0.1],
        },
    }
}

/// The same car with another footprint, which determines its dimensions.
#[must_use]
pub fn vehicle_with(footprint: Footprint) -> Vehicle {
    Vehicle {
        length: footprint.length(),
        width: footprint.width(),
        rear_axle_to_centre: footprint.rear_axle_to_centre(),
        footprint,
        ..vehicle()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_centre_line_is_that_of_the_reader() {
        let lane = straight_lanelet(3, (-20.0, 80.0), -1.0, 2.5);
        assert_eq!(lane.centre, line(&[(-20.0, 0.75), (80.0, 0.75)]));
        assert!(lane.contains(Point::new(0.0, 2.4)) && !lane.contains(Point::new(0.0, -1.1)));
        let uneven = lanelet(3, line(&[(0.0, 0.0), (10.0, 0.0)]), line(&[(0.0, 2.0), (4.0, 2.0), (10.0, 2.0)]));
        assert_eq!(uneven.centre.points().len(), 3);
        assert_eq!((uneven.centre.first(), uneven.centre.last()), (Point::new(0.0, 1.0), Point::new(10.0, 1.0)));
    }

    #[test]
    fn a_two_lane_road_is_connected() {
        let lanes = two_lane_road(3).lanelets;
        assert_eq!(lanes.keys().copied().collect::<Vec<_>>(), [100, 101, 102, 200, 201, 202]);
        assert_eq!((&lanes[&101].predecessors[..], &lanes[&101].successors[..]), (&[100][..], &[102][..]));
        assert_eq!(lanes[&101].adjacent_left.map(|n| n.id), Some(201));
        assert_eq!(lanes[&201].adjacent_right.map(|n| n.id), Some(101));
        assert_eq!(lanes[&201].right, lanes[&101].left);
    }

    #[test]
    fn a_driving_car_moves_with_its_speed_for_its_duration() {
        let car = driving(5, Pose::new(10.0, 2.0, std::f64::consts::FRAC_PI_2), 4.0, 2.0);
        let there = car.state_at(1.5).unwrap();
        assert!((there.pose.position - Point::new(10.0, 8.0)).norm() < 1e-12 && there.speed == 4.0);
        assert!(car.pose_at(2.0).is_some() && car.pose_at(2.1).is_none());
    }

    #[test]
    fn the_car_matches_its_vehicle_file() {
        let (fixture, file) = (vehicle(), crate::vehicle::load("bmw_320i").unwrap());
        for (what, a, b) in [
            ("length", fixture.length, file.length),
            ("width", fixture.width, file.width),
            ("wheelbase", fixture.wheelbase, file.wheelbase),
            ("mass", fixture.mass, file.mass),
            ("yaw inertia", fixture.yaw_inertia, file.yaw_inertia),
            ("centre", fixture.rear_axle_to_centre, file.rear_axle_to_centre),
            ("steering", fixture.limits.steering, file.limits.steering),
        ] {
            assert!((a / b - 1.0).abs() < 1e-3, "{what}: {a} {b}");
        }
        let small = vehicle_with(Footprint::rectangle(0.6, 0.3, 0.2));
        assert_eq!((small.length, small.width, small.rear_axle_to_centre), (0.6, 0.3, 0.2));
    }
}
