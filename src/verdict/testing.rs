//! A synthetic run without faults for the tests. Each test introduces one fault.
//!
//! A straight lane of 3.5 m; the vehicle's centre starts at x = 10 m with 8 m/s, brakes from 5 s on with a raised cosine
//! (mean 1 m/s², peak 2 m/s², jerk 0.79 m/s³) and stands in the goal at x = 82 m from 13 s to 15 s. A car is parked
//! beside the lane at (60, 3.5) and another drives 40 m ahead.

use std::f64::consts::{PI, TAU};

use super::{PlannedFor, Settings, Verdict, judge};
use crate::fixtures::{self, knot};
use crate::geometry::polyline::Polyline;
use crate::geometry::{Point, Pose};
use crate::map::{
    Goal, Interval, Lanelet, Motion, Obstacle, ObstacleKind, PlanningProblem, Scenario, Shape, TimedPose,
};
use crate::planner::{self, Cycle};
use crate::simulation::{Log, Sample};
use crate::trajectory::{Path, SpeedProfile, Trajectory};
use crate::vehicle::{Comfort, Footprint, TrackingTube, Vehicle};

pub(super) use crate::fixtures::cycle;

/// Where the run takes place in the world, and whether it is mirrored.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) origin: Pose,
    pub(super) mirrored: bool,
}

impl Place {
    pub(super) const fn here() -> Self {
        Self { origin: Pose { position: Point::new(0.0, 0.0), yaw: 0.0 }, mirrored: false }
    }

    pub(super) fn side(&self) -> f64 {
        if self.mirrored { -1.0 } else { 1.0 }
    }

    pub(super) fn point(&self, x: f64, y: f64) -> Point {
        self.origin.to_world(Point::new(x, self.side() * y))
    }

    pub(super) fn pose(&self, x: f64, y: f64, yaw: f64) -> Pose {
        Pose { position: self.point(x, y), yaw: self.origin.yaw + self.side() * yaw }
    }

    /// A lanelet along x between two offsets.
    pub(super) fn lanelet(&self, id: i64, x: (f64, f64), right: f64, left: f64) -> Lanelet {
        let line = |y: f64| Polyline::new([self.point(x.0, y), self.point(x.1, y)]).unwrap();
        let (right, left) = if self.mirrored { (left, right) } else { (right, left) };
        Lanelet { types: vec!["urban".into()], ..fixtures::lanelet(id, line(right), line(left)) }
    }

    /// A parked car.
    pub(super) fn parked(&self, id: i64, x: f64, y: f64) -> Obstacle {
        fixtures::parked(id, self.pose(x, y, 0.0), 4.5, 1.8)
    }

    /// A car that drives from one point to another in a time interval.
    pub(super) fn moving(&self, id: i64, time: (f64, f64), from: (f64, f64), to: (f64, f64)) -> Obstacle {
        let at = |time, p: (f64, f64)| TimedPose { time, pose: self.pose(p.0, p.1, 0.0), speed: 0.0 };
        let motion = Motion::Trajectory(vec![at(time.0, from), at(time.1, to)]);
        Obstacle { id, kind: ObstacleKind::Vehicle, shape: Shape::rectangle(4.5, 1.8), motion }
    }

    /// A straight path along x for the rear axle.
    pub(super) fn straight(&self, x: f64, y: f64, length: f64) -> Path {
        fixtures::straight(self.pose(x, y, 0.0), length)
    }
}

/// Everything that the verdict reads.
#[derive(Debug, Clone)]
pub(super) struct Story {
    pub(super) place: Place,
    pub(super) scenario: Scenario,
    pub(super) vehicle: Vehicle,
    pub(super) cycles: Vec<Cycle>,
    pub(super) planner: planner::Settings,
    pub(super) log: Log,
    pub(super) settings: Settings,
}

pub(super) const STOPPED_FROM: f64 = 13.0;
pub(super) const DURATION: f64 = 15.0;

impl Story {
    pub(super) fn clean() -> Self {
        Self::at(Place::here())
    }

    pub(super) fn at(place: Place) -> Self {
        let vehicle = car();
        let goal = Goal {
            speed: Some(Interval { min: 0.0, max: 0.5 }),
            yaw: Some(Interval { min: place.origin.yaw - 0.1, max: place.origin.yaw + 0.1 }),
            ..fixtures::goal(place.pose(82.0, 0.0, 0.0), 6.0, 3.5, 30.0)
        };
        let road = [place.lanelet(1, (0.0, 70.0), -1.75, 1.75), place.lanelet(2, (70.0, 130.0), -1.75, 1.75)];
        let cars = vec![place.parked(100, 60.0, 3.5), place.moving(101, (0.0, 20.0), (50.0, 0.0), (210.0, 0.0))];
        let scenario = Scenario {
            problems: vec![fixtures::problem(place.pose(10.0, 0.0, 0.0), 8.0, goal)],
            ..fixtures::scenario(fixtures::network(road), cars)
        };
        let rear = 10.0 - vehicle.rear_axle_to_centre;
        let committed =
            Trajectory { start_time: 0.0, path: place.straight(rear, 0.0, 72.0), profile: braking_profile() };
        let cycles = (0..150).map(|i| cycle(0.1 * f64::from(i), committed.clone())).collect();
        let samples = (0..=1500)
            .map(|i| {
                let time = 0.01 * f64::from(i);
                let (station, speed, acceleration) = raised_cosine_stop(time);
                sample(time, place.pose(rear + station, 0.0, 0.0), speed, acceleration)
            })
            .collect();
        let log = Log { samples, contact: None, broke_at: None };
        Self {
            place,
            scenario,
            vehicle,
            cycles,
            planner: planner::Settings::default(),
            log,
            settings: Settings::default(),
        }
    }

    pub(super) fn problem(&mut self) -> &mut PlanningProblem {
        &mut self.scenario.problems[0]
    }

    pub(super) fn goal(&mut self) -> &mut Goal {
        &mut self.problem().goals[0]
    }

    /// Moves every driven pose and its reference pose by a function (ahead, left) of the sample, m.
    pub(super) fn displace(&mut self, by: impl Fn(&Sample) -> (f64, f64)) {
        for s in &mut self.log.samples {
            let (ahead, left) = by(s);
            let offset = s.pose.forward() * ahead + s.pose.left() * (left * self.place.side());
            s.pose.position += offset;
            s.reference_pose.position += offset;
        }
    }

    pub(super) fn judge(&self) -> Verdict {
        let Self { scenario, vehicle, cycles, planner, log, settings, .. } = self;
        let planned_for = PlannedFor { settings: planner, friction: 1.0 };
        judge(scenario, &scenario.problems[0], vehicle, (cycles, planned_for), log, settings)
    }

    /// Names of the checks that fail.
    pub(super) fn failures(&self) -> Vec<&'static str> {
        self.judge().failures().map(|c| c.name).collect()
    }
}

/// (station, speed, acceleration) of the run at a time.
fn raised_cosine_stop(time: f64) -> (f64, f64, f64) {
    let t = (time - 5.0).clamp(0.0, 8.0);
    // a = −(1 − cos(2πt/8)), integrated twice
    let w = TAU / 8.0;
    let station = 8.0 * time.min(5.0) + 8.0 * t - 0.5 * t * t - ((w * t).cos() - 1.0) / (w * w);
    (station, 8.0 - t + (w * t).sin() / w, (w * t).cos() - 1.0)
}

/// 8 m/s for 5 s, then 1 m/s² to standstill: the times and stations of the raised cosine at its ends.
fn braking_profile() -> SpeedProfile {
    SpeedProfile::new(vec![knot(0.0, 0.0, 8.0, 0.0), knot(5.0, 40.0, 8.0, -1.0), knot(13.0, 72.0, 0.0, 0.0)]).unwrap()
}

fn sample(time: f64, pose: Pose, speed: f64, acceleration: f64) -> Sample {
    Sample {
        time,
        pose,
        speed: speed.max(0.0),
        lateral_speed: 0.0,
        yaw_rate: 0.0,
        acceleration,
        lateral_acceleration: 0.0,
        steering: 0.0,
        commanded_acceleration: acceleration,
        commanded_steering: 0.0,
        reference_pose: pose,
        reference_speed: speed,
        reference_station: 0.0,
    }
}

/// A bump of the given height and length that starts and ends smoothly (raised cosine).
pub(super) fn bump(time: f64, from: f64, length: f64, height: f64) -> f64 {
    let u = (time - from) / length;
    if (0.0..=1.0).contains(&u) { 0.5 * height * (1.0 - (2.0 * PI * u).cos()) } else { 0.0 }
}

/// A car with the comfort limits of the SafeTLP paper and a narrow tracking tube.
fn car() -> Vehicle {
    let comfort = Comfort {
        acceleration: 1.5,
        deceleration: 1.5,
        aggressive_deceleration: 2.2,
        lateral_acceleration: 3.0,
        jerk: 2.5,
    };
    let tracking = TrackingTube {
        speed: [30.0, 25.0, 20.0],
        lateral: [0.05, 0.16],
        longitudinal: [0.03, 0.1],
        heading: [0.03, 0.06],
    };
    Vehicle { comfort, tracking, ..fixtures::vehicle_with(Footprint::rectangle(4.508, 1.61, 1.422)) }
}
