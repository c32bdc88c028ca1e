//! A synthetic run for the tests: clean, so that each test can break one thing in it.
//!
//! A straight lane of 3.5 m; the vehicle's centre starts at x = 10 m with 8 m/s, brakes from 5 s on with a raised cosine
//! (mean 1 m/s², peak 2 m/s², jerk 0.79 m/s³), rests at x = 82 m from 13 s on, in the goal, until 15 s. A car is parked
//! beside the lane at (60, 3.5) and another drives 40 m ahead.

use std::f64::consts::{PI, TAU};

use super::{Settings, Verdict, judge};
use crate::geometry::polyline::Polyline;
use crate::geometry::spiral::CubicSpiral;
use crate::geometry::{Point, Pose};
use crate::map::{
    Goal, GoalPosition, InitialState, Interval, Lanelet, Motion, Obstacle, ObstacleKind, Part, PlanningProblem,
    RoadNetwork, Scenario, Shape, TimedPose,
};
use crate::planner::{Cycle, Decision, StageSeconds};
use crate::simulation::{Log, Sample};
use crate::trajectory::{Path, SpeedKnot, SpeedProfile, Trajectory};
use crate::vehicle::{Actuators, Comfort, Footprint, Limits, Tyres, Vehicle};

/// Where in the world the run takes place, and whether it is seen in a mirror.
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
        Lanelet {
            id,
            left: line(left),
            right: line(right),
            centre: line(0.5 * (left + right)),
            successors: Vec::new(),
            predecessors: Vec::new(),
            adjacent_left: None,
            adjacent_right: None,
            speed_limit: None,
            stop_line: None,
            signs: Vec::new(),
            lights: Vec::new(),
            types: vec!["urban".into()],
        }
    }

    /// A parked car.
    pub(super) fn parked(&self, id: i64, x: f64, y: f64) -> Obstacle {
        let motion = Motion::Static(self.pose(x, y, 0.0));
        Obstacle { id, kind: ObstacleKind::ParkedVehicle, shape: Shape::rectangle(4.5, 1.8), motion }
    }

    /// A car that drives from one point to another in a time interval.
    pub(super) fn moving(&self, id: i64, time: (f64, f64), from: (f64, f64), to: (f64, f64)) -> Obstacle {
        let at = |time, p: (f64, f64)| TimedPose { time, pose: self.pose(p.0, p.1, 0.0), speed: 0.0 };
        let motion = Motion::Trajectory(vec![at(time.0, from), at(time.1, to)]);
        Obstacle { id, kind: ObstacleKind::Vehicle, shape: Shape::rectangle(4.5, 1.8), motion }
    }

    /// A straight path along x for the rear axle.
    pub(super) fn straight(&self, x: f64, y: f64, length: f64) -> Path {
        Path::new(self.pose(x, y, 0.0), &[CubicSpiral { knots: [0.0; 4], length }]).unwrap()
    }
}

/// Everything the judge reads.
#[derive(Debug, Clone)]
pub(super) struct Story {
    pub(super) place: Place,
    pub(super) scenario: Scenario,
    pub(super) vehicle: Vehicle,
    pub(super) cycles: Vec<Cycle>,
    pub(super) log: Log,
    pub(super) settings: Settings,
}

pub(super) const REST_FROM: f64 = 13.0;
pub(super) const DURATION: f64 = 15.0;

impl Story {
    pub(super) fn clean() -> Self {
        Self::at(Place::here())
    }

    pub(super) fn at(place: Place) -> Self {
        let vehicle = bmw();
        let goal = Goal {
            position: Some(GoalPosition::Shapes(Shape {
                parts: vec![Part::Rectangle { centre: place.pose(82.0, 0.0, 0.0), length: 6.0, width: 3.5 }],
            })),
            time: Interval { min: 0.0, max: 30.0 },
            speed: Some(Interval { min: 0.0, max: 0.5 }),
            yaw: Some(Interval { min: place.origin.yaw - 0.1, max: place.origin.yaw + 0.1 }),
        };
        let initial = InitialState {
            centre: place.pose(10.0, 0.0, 0.0),
            speed: 8.0,
            acceleration: 0.0,
            yaw_rate: 0.0,
            time_step: 0,
        };
        let mut network = RoadNetwork::default();
        network.lanelets.insert(1, place.lanelet(1, (0.0, 70.0), -1.75, 1.75));
        network.lanelets.insert(2, place.lanelet(2, (70.0, 130.0), -1.75, 1.75));
        let scenario = Scenario {
            id: "ZAM_Test-1_1_T-1".into(),
            version: "2020a".into(),
            time_step: 0.1,
            network,
            obstacles: vec![place.parked(100, 60.0, 3.5), place.moving(101, (0.0, 20.0), (50.0, 0.0), (210.0, 0.0))],
            occupancy: None,
            problems: vec![PlanningProblem { id: 1, initial, goals: vec![goal] }],
            issues: Vec::new(),
        };
        let rear = 10.0 - vehicle.rear_axle_to_centre;
        let committed =
            Trajectory { start_time: 0.0, path: place.straight(rear, 0.0, 72.0), profile: braking_profile() };
        let cycles = (0..150).map(|i| cycle(0.1 * f64::from(i), committed.clone())).collect();
        let samples = (0..=1500)
            .map(|i| {
                let time = 0.01 * f64::from(i);
                let (way, speed, acceleration) = raised_cosine_stop(time);
                sample(time, place.pose(rear + way, 0.0, 0.0), speed, acceleration)
            })
            .collect();
        let log = Log { samples, contact: None, broke_at: None };
        Self { place, scenario, vehicle, cycles, log, settings: Settings::default() }
    }

    pub(super) fn problem(&mut self) -> &mut PlanningProblem {
        &mut self.scenario.problems[0]
    }

    pub(super) fn goal(&mut self) -> &mut Goal {
        &mut self.problem().goals[0]
    }

    /// Moves every driven and wanted pose by a function of its sample.
    pub(super) fn displace(&mut self, by: impl Fn(&Sample) -> (f64, f64)) {
        for s in &mut self.log.samples {
            let (ahead, left) = by(s);
            let offset = s.pose.forward() * ahead + s.pose.left() * (left * self.place.side());
            s.pose.position += offset;
            s.wanted_pose.position += offset;
        }
    }

    pub(super) fn judge(&self) -> Verdict {
        let Self { scenario, vehicle, cycles, log, settings, .. } = self;
        judge(scenario, &scenario.problems[0], vehicle, cycles, log, settings)
    }

    /// Names of the checks that fail.
    pub(super) fn failures(&self) -> Vec<&'static str> {
        self.judge().failures().map(|c| c.name).collect()
    }
}

/// (way, speed, acceleration) of the run at a time.
fn raised_cosine_stop(time: f64) -> (f64, f64, f64) {
    let t = (time - 5.0).clamp(0.0, 8.0);
    // a = −(1 − cos(2πt/8)), integrated twice
    let w = TAU / 8.0;
    let way = 8.0 * time.min(5.0) + 8.0 * t - 0.5 * t * t - ((w * t).cos() - 1.0) / (w * w);
    (way, 8.0 - t + (w * t).sin() / w, (w * t).cos() - 1.0)
}

/// 8 m/s for 5 s, then 1 m/s² to rest: the same times and stations as the raised cosine has at its ends.
fn braking_profile() -> SpeedProfile {
    let knot = |time, station, speed, acceleration| SpeedKnot { time, station, speed, acceleration, jerk: 0.0 };
    SpeedProfile::new(vec![knot(0.0, 0.0, 8.0, 0.0), knot(5.0, 40.0, 8.0, -1.0), knot(13.0, 72.0, 0.0, 0.0)]).unwrap()
}

pub(super) fn cycle(time: f64, committed: Trajectory) -> Cycle {
    Cycle {
        time,
        committed,
        decision: Decision::NewPlan { deceleration: 1.5 },
        reference: Vec::new(),
        candidates: Vec::new(),
        blocked: Vec::new(),
        chosen: None,
        edges: Default::default(),
        expansions: 0,
        is_smooth: true,
        is_refined: false,
        is_proven_against_set: false,
        stage_seconds: StageSeconds::default(),
    }
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
        wanted_pose: pose,
        wanted_speed: speed,
        wanted_station: 0.0,
    }
}

/// A bump of the given height and length that starts and ends smoothly (raised cosine).
pub(super) fn bump(time: f64, from: f64, length: f64, height: f64) -> f64 {
    let u = (time - from) / length;
    if (0.0..=1.0).contains(&u) { 0.5 * height * (1.0 - (2.0 * PI * u).cos()) } else { 0.0 }
}

/// The figures of CommonRoad's vehicle model 2; tyres and actuators play no part here.
fn bmw() -> Vehicle {
    Vehicle {
        name: "bmw_320i".into(),
        commonroad_type: Some(2),
        footprint: Footprint::rectangle(4.508, 1.61, 1.422),
        length: 4.508,
        width: 1.61,
        wheelbase: 2.578,
        rear_axle_to_centre: 1.422,
        rear_axle_to_mass: 1.422,
        mass_height: 0.575,
        track_width: 1.386,
        mass: 1093.3,
        yaw_inertia: 1791.6,
        wheel_radius: 0.344,
        wheel_inertia: 1.7,
        limits: Limits {
            steering: 1.066,
            steering_rate: 0.4,
            steering_acceleration: 10.0,
            speed: 50.8,
            acceleration: 11.5,
            switching_speed: 7.319,
            deceleration: 11.5,
        },
        tyres: Tyres {
            friction: 1.0489,
            cornering_front: 20.89,
            cornering_rear: 20.89,
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
            acceleration: 1.5,
            deceleration: 1.5,
            aggressive_deceleration: 2.2,
            lateral_acceleration: 3.0,
            jerk: 2.5,
        },
    }
}
