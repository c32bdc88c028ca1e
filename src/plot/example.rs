//! A hand-made run for the tests of pictures and recordings: a two-lane road, a parked car to pass, a car in the other
//! lane, a pedestrian, a stop line at the end.

use crate::drive::{Outcome, Run};
use crate::fixtures::{self, knot};
use crate::geometry::polyline::Polyline;
use crate::geometry::spiral::CubicSpiral;
use crate::geometry::{Point, Pose};
use crate::lattice::CostTerms;
use crate::map::{
    Lanelet, Motion, Neighbour, Obstacle, ObstacleKind, Part, PlanningProblem, Scenario, Shape, StopLine,
    TimedOccupancy, TimedPose,
};
use crate::planner::{BlockedCell, Candidate, Cycle, Decision, Plan, Rejection, StageSeconds, Trace};
use crate::simulation::{Log, Sample};
use crate::trajectory::{Path, SpeedProfile, Trajectory};
use crate::vehicle::{Comfort, Footprint, Vehicle};
use crate::verdict::{Check, Status, Verdict};

/// The values that a [`Run`] borrows.
pub(crate) struct Example {
    pub(crate) scenario: Scenario,
    pub(crate) vehicle: Vehicle,
}

/// Origin of the road: UTM magnitudes, so that a missing local origin is visible.
pub(crate) const EAST: f64 = 691_000.0;
pub(crate) const NORTH: f64 = 5_335_000.0;
const CYCLES: u32 = 20;
const SPEED: f64 = 10.0;
/// Station at which the drive starts to brake and at which it stops, m.
const BRAKE_AT: f64 = 44.0;
const STOP_AT: f64 = 80.0;

fn at(x: f64, y: f64) -> Point {
    Point::new(EAST + x, NORTH + y)
}

impl Example {
    pub(crate) fn new() -> Self {
        let left = Neighbour { id: 2, same_direction: true };
        let right = Neighbour { id: 1, same_direction: true };
        let mut lane = lanelet(1, 0.0);
        lane.adjacent_left = Some(left);
        lane.speed_limit = Some(13.9);
        lane.stop_line = Some(StopLine { start: at(86.0, 1.75), end: at(86.0, -1.75) });
        let mut other = lanelet(2, 3.5);
        other.adjacent_right = Some(right);
        let mut pavement = lanelet(3, -3.0);
        pavement.types = vec!["sidewalk".into()];
        let vehicle = car();
        let scenario = Scenario {
            id: "HandMade_ParkedCar-1_1".into(),
            problems: vec![problem(&vehicle)],
            ..fixtures::scenario(fixtures::network([lane, other, pavement]), obstacles())
        };
        Self { scenario, vehicle }
    }

    pub(crate) fn run(&self) -> Run<'_> {
        let path = passing(0.0185, 15.0);
        let driven = Trajectory { start_time: 0.0, path: path.clone(), profile: driven_profile() };
        Run {
            scenario: &self.scenario,
            problem: &self.scenario.problems[0],
            vehicle: &self.vehicle,
            cycles: (0..CYCLES).map(|i| cycle(&driven, f64::from(i) * 0.6, i)).collect(),
            log: log(&driven, &self.vehicle),
            fallbacks: Vec::new(),
            faults: crate::drive::Faults::default(),
            outcome: Outcome::StoppedSafely,
            reason: None,
            stopping_distance: None,
            verdict: verdict(),
        }
    }
}

fn lanelet(id: i64, middle: f64) -> Lanelet {
    let half = if id == 3 { 1.25 } else { 1.75 };
    let line = |y: f64| Polyline::new((0..=26).map(|i| at(-20.0 + 6.0 * f64::from(i), y))).unwrap();
    let bounded = fixtures::lanelet(id, line(middle - half), line(middle + half));
    Lanelet { types: vec!["urban".into()], ..bounded }
}

fn obstacles() -> Vec<Obstacle> {
    let moving = |x: f64, y: f64, vx: f64, vy: f64, until: u32| {
        let states = (0..=until).map(|i| {
            let t = 0.1 * f64::from(i);
            TimedPose {
                time: t,
                pose: Pose { position: at(x + vx * t, y + vy * t), yaw: vy.atan2(vx) },
                speed: vx.hypot(vy),
            }
        });
        Motion::Trajectory(states.collect())
    };
    let corners = [(100.0, -4.2), (106.0, -4.2), (106.0, -1.75), (103.0, -2.8)].map(|(x, y)| at(x, y));
    let sets = (0..80).map(|i| {
        let from = 0.1 * f64::from(i);
        let centre = Pose { position: at(110.0 - 2.0 * from, 3.5), yaw: 0.0 };
        let region = Shape { parts: vec![Part::Rectangle { centre, length: 4.0 + 0.5 * from, width: 2.5 }] };
        TimedOccupancy { from, to: from + 0.1, region }
    });
    let of_kind = |kind, id, shape, motion| Obstacle { kind, ..fixtures::obstacle(id, shape, motion) };
    let (in_lane, still) = (Pose { position: at(47.0, -0.8), yaw: 0.03 }, Motion::Static(Pose::new(0.0, 0.0, 0.0)));
    let island = Shape { parts: vec![Part::Polygon { vertices: corners.to_vec() }] };
    vec![
        fixtures::parked(31, in_lane, 4.6, 1.9),
        of_kind(ObstacleKind::Vehicle, 32, Shape::rectangle(4.4, 1.8), moving(25.0, 3.5, 11.0, 0.0, 70)),
        of_kind(ObstacleKind::Pedestrian, 33, fixtures::circle(0.35), moving(90.0, -3.5, 0.0, 0.9, 110)),
        of_kind(ObstacleKind::Structure, 34, island, still),
        of_kind(ObstacleKind::Bicycle, 35, Shape::rectangle(1.8, 0.7), Motion::Occupancy(sets.collect())),
    ]
}

fn problem(vehicle: &Vehicle) -> PlanningProblem {
    let start = Pose { position: at(2.0, 0.0), yaw: 0.0 };
    let goal = fixtures::goal(Pose { position: at(80.0, 0.0), yaw: 0.0 }, 10.0, 3.0, 20.0);
    fixtures::problem(vehicle.centre_of_rear_axle(&start), SPEED, goal)
}

fn car() -> Vehicle {
    let comfort = Comfort {
        acceleration: 2.0,
        deceleration: 2.0,
        aggressive_deceleration: 4.0,
        lateral_acceleration: 2.0,
        jerk: 5.0,
    };
    Vehicle { comfort, wheelbase: 2.578, ..fixtures::vehicle_with(Footprint::rectangle(4.508, 1.61, 1.4)) }
}

/// A path that passes an obstacle on its left and returns; `curvature` is that of the lane changes, 1/m.
fn passing(curvature: f64, straight: f64) -> Path {
    let spiral = |knots: [f64; 4], length: f64| CubicSpiral { knots, length };
    let shift = |k: f64| spiral([0.0, k, -k, 0.0], 25.0);
    let start = Pose { position: at(2.0, 0.0), yaw: 0.0 };
    let pieces = [
        spiral([0.0; 4], straight),
        shift(curvature),
        spiral([0.0; 4], 10.0),
        shift(-curvature),
        spiral([0.0; 4], 20.0),
    ];
    Path::new(start, &pieces).unwrap()
}

/// Keeps the speed, then brakes uniformly to standstill.
fn braking(from: f64, delay: f64, speed: f64, deceleration: f64) -> SpeedProfile {
    let (stop, brake_at) = (delay + speed / deceleration, from + speed * delay);
    let stop_at = brake_at + speed * speed / (2.0 * deceleration);
    SpeedProfile::new(vec![
        knot(0.0, from, speed, 0.0),
        knot(delay, brake_at, speed, -deceleration),
        knot(stop, stop_at, 0.0, 0.0),
    ])
    .unwrap()
}

fn driven_profile() -> SpeedProfile {
    braking(0.0, BRAKE_AT / SPEED, SPEED, SPEED * SPEED / (2.0 * (STOP_AT - BRAKE_AT)))
}

fn cycle(driven: &Trajectory, time: f64, index: u32) -> Cycle {
    let now = driven.at(time);
    let profile = braking(now.station, 0.8, now.speed.max(0.01), 3.5);
    let rejections = [
        None,
        None,
        None,
        Some(Rejection::BlockedAtStart),
        Some(Rejection::NoProof),
        Some(Rejection::CurveSpeedInfeasible),
    ];
    let curvatures = [0.0185, 0.0150, 0.0215, 0.0030, 0.0400, -0.0200];
    let candidates = curvatures.iter().zip(rejections).map(|(curvature, rejected)| Candidate {
        path: passing(*curvature, 15.0),
        lane: 0,
        attempt: 0,
        cost: if rejected.is_some() { f64::INFINITY } else { (curvature - 0.0185).abs() },
        terms: CostTerms::default(),
        blocked_by: None,
        rejected,
    });
    let kept = index == 8;
    let committed = Trajectory { start_time: time, path: driven.path.clone(), profile };
    let decision = if kept { Decision::KeepPrevious } else { Decision::NewPlan };
    let trace = Trace {
        reference: (0..=30).map(|i| at(2.0 + 3.0 * f64::from(i), 0.0)).collect(),
        candidates: candidates.collect(),
        blocked: (0..10)
            .map(|k| f64::from(k) * 0.5)
            .map(|t| BlockedCell {
                stations: (now.station + 24.0 + 5.0 * t, now.station + 30.0 + 5.0 * t),
                times: (time + t, time + t + 0.5),
                obstacle: 1,
            })
            .collect(),
        chosen: (!kept).then_some(0),
        expansions: 120,
        stage_seconds: StageSeconds { total: 0.002, ..StageSeconds::default() },
        ..Trace::default()
    };
    let plan = fixtures::cycle(time, committed).plan;
    Cycle { plan: Plan { decision, deceleration: 3.5, ..plan }, trace }
}

fn log(driven: &Trajectory, vehicle: &Vehicle) -> Log {
    let samples = (0..=1200).map(|i| {
        let time = 0.01 * f64::from(i);
        let p = driven.at(time);
        // the vehicle lags a little behind its reference
        let lagged = driven.at((time - 0.15).max(0.0));
        Sample {
            time,
            pose: p.pose,
            speed: p.speed,
            lateral_speed: 0.0,
            yaw_rate: p.curvature * p.speed,
            acceleration: lagged.acceleration + 0.03 * (9.0 * time).sin() * p.speed.min(1.0),
            lateral_acceleration: lagged.curvature * lagged.speed * lagged.speed,
            steering: vehicle.steering_for_curvature(lagged.curvature),
            commanded_acceleration: p.acceleration,
            commanded_steering: vehicle.steering_for_curvature(p.curvature),
            reference_pose: p.pose,
            reference_speed: p.speed,
            reference_station: p.station,
        }
    });
    Log { samples: samples.collect(), contact: None, broke_at: None }
}

fn verdict() -> Verdict {
    let check = |name: &'static str, pass, value, limit, unit, at_time, note: &str| Check {
        name,
        status: Status::of(pass),
        value,
        limit,
        unit,
        at_time,
        impact: None,
        note: note.into(),
        method: String::new(),
    };
    Verdict {
        checks: vec![
            check("no_contact", true, 0.0, 0.0, "", None, "no contact"),
            check("stays_on_road", true, 0.31, 0.0, "m", Some(4.2), "smallest distance to the border"),
            check("stop_proven", false, 0.95, 1.0, "", Some(4.8), "share of cycles with a proof <all | any>"),
            check("comfort_longitudinal", true, 1.42, 2.0, "m/s²", Some(6.0), "largest |a|"),
            check("comfort_lateral", true, 1.86, 2.0, "m/s²", Some(2.3), "largest |a|"),
        ],
    }
}
