//! A proof is one for what is known now: where the vehicle is, what stands around it, how slippery the road is.

use std::sync::Arc;

use stopline::collision::Blocker;
use stopline::fixtures::{driving, parked};
use stopline::geometry::{Point, Pose};
use stopline::map::{Obstacle, Scenario};
use stopline::planner::{Decision, Level, Observation, Plan, Planner, Settings};
use stopline::simulation::{self, Log, World};
use stopline::vehicle::{GripUse, State, Vehicle};

use crate::common::{PlaneMotion, VEHICLE};
use crate::scenes::{START, in_front, lanes, scene};

/// The state at the start of a scenario.
fn at_start(scenario: &Scenario, vehicle: &Vehicle) -> State {
    let initial = &scenario.problems[0].initial;
    let pose = vehicle.rear_axle_of_centre(&initial.centre);
    State { time: 0.0, pose, speed: initial.speed, lateral_speed: 0.0, acceleration: 0.0, yaw_rate: 0.0, steering: 0.0 }
}

/// The state after a plan was followed exactly for a time, beside it by a distance to the left and ahead, m.
fn followed(plan: &Plan, vehicle: &Vehicle, by: f64, (ahead, left): (f64, f64)) -> State {
    let point = plan.trajectory.at(plan.time + by);
    State {
        time: plan.time + by,
        pose: Pose { position: point.pose.to_world(Point::new(ahead, left)), yaw: point.pose.yaw },
        speed: point.speed,
        lateral_speed: 0.0,
        acceleration: point.acceleration,
        yaw_rate: point.speed * point.curvature,
        steering: vehicle.steering_for_curvature(point.curvature),
    }
}

/// The first two plans, the second one of a changed observation.
fn two_plans(scenario: &Scenario, settings: &Settings, change: impl Fn(&mut Observation, &Plan)) -> [Plan; 2] {
    let mut planner = Planner::new(scenario.map(), &VEHICLE, settings).unwrap();
    let mut observation = Observation::of_scenario(scenario, &scenario.problems[0], at_start(scenario, &VEHICLE));
    let first = planner.cycle(&observation).unwrap();
    observation.state = followed(&first, &VEHICLE, 0.1, (0.0, 0.0));
    change(&mut observation, &first);
    let second = planner.cycle(&observation).unwrap();
    [first, second]
}

/// Where the front bumper is while a plan is followed, m.
fn front_at(plan: &Plan, time: f64) -> f64 {
    plan.trajectory.at(time).pose.position.x + VEHICLE.front_overhang_from_rear_axle()
}

/// No plan goes on because it was proven once: whatever refutes it, it is replaced or loses its proof.
#[test]
fn a_plan_that_what_is_seen_now_refutes_never_goes_on_as_proven() {
    let empty = scene(lanes(3.5, false), 10.0, Vec::new());
    let settings = Settings::default();
    let wall = |x: f64| parked(7, Pose::new(x + 0.5, 0.0, 0.0), 1.0, 8.0);
    for distance in [2.0, 4.0, 6.0, 8.0, 12.0, 20.0] {
        let [first, second] =
            two_plans(&empty, &settings, |o, plan| o.obstacles = Arc::from([wall(front_at(plan, 0.1) + distance)]));
        assert!(first.level.is_proven() && first.stops_for.is_none());
        assert_ne!(second.decision, Decision::KeepPrevious, "{distance} m");
        let end = front_at(&second, 60.0) - front_at(&first, 0.1);
        assert!(!second.level.is_proven() || end < distance, "{distance} m: {second:?}");
        assert_eq!(second.level.is_proven(), distance > 7.0, "{distance} m: {second:?}");
    }
    // one that drives towards the vehicle in its lane
    for gap in [15.0, 25.0] {
        let [first, second] = two_plans(&empty, &settings, |o, plan| {
            o.obstacles =
                Arc::from([driving(7, Pose::new(front_at(plan, 0.1) + gap, 0.0, std::f64::consts::PI), 8.0, 8.0)]);
        });
        assert_ne!(second.decision, Decision::KeepPrevious, "{gap} m");
        assert_ne!(first.trajectory, second.trajectory, "{gap} m");
        assert_eq!(second.level, Level::Unproven, "{gap} m: it drives into the standing vehicle");
    }
    // less grip than the plan needs
    for friction in [0.5, 0.15] {
        let near = scene(lanes(3.5, false), 10.0, vec![in_front(&VEHICLE, 9.5, 0.0, 8.0)]);
        let [first, second] = two_plans(&near, &settings, |o, _| o.friction = friction);
        assert!(first.level.is_proven(), "{first:?}");
        assert_ne!(second.decision, Decision::KeepPrevious, "friction {friction}");
        assert_eq!(second.level, Level::Unproven, "friction {friction}");
    }
}

/// Two posts leave a gap that is narrower than the tube of the plan and wider than the vehicle: nothing proves the plan any more, but it
/// touches nothing, and nothing better is known. It goes on, and claims nothing.
#[test]
fn a_plan_without_its_proof_goes_on_if_it_touches_nothing() {
    let empty = scene(lanes(3.5, false), 10.0, Vec::new());
    // without emergency levels nothing else than the plan itself can be continued
    let settings = Settings { emergency: Vec::new(), ..Settings::default() };
    let gate = |plan: &Plan, beside: f64| -> Vec<Obstacle> {
        let (x, y) = (front_at(plan, 0.1) + 3.0, 0.5 * VEHICLE.width + beside + 0.25);
        vec![parked(7, Pose::new(x, -y, 0.0), 0.5, 0.5), parked(8, Pose::new(x, y, 0.0), 0.5, 0.5)]
    };
    let through = |beside| two_plans(&empty, &settings, |o, plan| o.obstacles = gate(plan, beside).into());
    let least = VEHICLE.tracking_margins(&GripUse::default()).lateral;
    for share in [0.4, 0.6, 0.8] {
        let [first, second] = through(share * least);
        assert_eq!((second.decision, second.level), (Decision::Unproven, Level::Unproven), "{share}");
        assert_eq!(second.trajectory, first.trajectory, "{share}: it goes on");
        assert_eq!(second.expected_contact, None, "{share}");
    }
    // where it would touch, it does not go on
    let [first, second] = through(-0.05);
    assert_ne!(second.trajectory, first.trajectory);
    assert!(matches!(second.expected_contact.map(|c| c.what), Some(Blocker::Obstacle(7 | 8))), "{second:?}");
    // and where the gap is wide enough, the plan keeps its proof
    assert!(through(0.8)[1].level.is_proven());
}

/// A vehicle that is not where its plan says: what is claimed then holds from where it is.
#[test]
fn proofs_hold_for_a_vehicle_beside_its_plan() {
    // a wall ahead, and cars that leave 0.35 m beside the vehicle
    let beside = |id: i64, y: f64| parked(id, Pose::new(START + 12.0, y, 0.0), 14.0, 1.0);
    let y = 0.5 * VEHICLE.width + 0.35 + 0.5;
    let obstacles = vec![in_front(&VEHICLE, 16.0, 0.0, 8.0), beside(1, y), beside(2, -y)];
    let scenario = scene(lanes(5.0, false), 8.0, obstacles);
    let [mut proven, mut wrong] = [0, 0].map(|_: i32| Vec::new());
    for (away, angle) in [0.1, 0.25, 0.5, 0.75, 1.0, 1.5].into_iter().flat_map(|d| (0..8).map(move |i| (d, i))) {
        let (sin, cos) = (f64::from(angle) * std::f64::consts::FRAC_PI_4).sin_cos();
        let place = (away * cos, away * sin);
        let mut planner = Planner::new(scenario.map(), &VEHICLE, &Settings::default()).unwrap();
        let mut observation = Observation::of_scenario(&scenario, &scenario.problems[0], at_start(&scenario, &VEHICLE));
        let first = planner.cycle(&observation).unwrap();
        assert!(first.level.is_proven());
        observation.state = followed(&first, &VEHICLE, 0.1, place);
        let plan = planner.cycle(&observation).unwrap();
        let case = format!("{place:.2?} m from its plan");
        if !plan.level.is_proven() {
            continue;
        }
        proven.push(case.clone());
        let mut world =
            World::new(&VEHICLE, &scenario.obstacles, &observation.state, &simulation::Settings::default()).unwrap();
        let mut log = Log::default();
        world.follow(&plan.trajectory, plan.time + 15.0, &mut log);
        let end = log.samples[log.samples.len() - 1];
        if let Some(contact) = log.contact {
            wrong.push(format!("{case}: proven as {}, touches {:?}", plan.level, contact.with));
        } else if end.speed.abs() > 0.05 {
            wrong.push(format!("{case}: proven as {}, still drives {} m/s", plan.level, end.speed));
        }
    }
    assert_eq!(wrong, [""; 0]);
    assert!(proven.len() > 20, "{}: {proven:?}", proven.len());
}

/// How the plan of a mirrored scene differs from the mirrored plan, as text; `None` if it does not. The scene: a wall of 1.2 m ahead, its
/// middle at y, another one 12 m behind it, a lane beside, a start aside of the lane's middle, m.
fn differs_mirrored([speed, ahead, y, beside, aside]: [f64; 5]) -> Option<String> {
    let other = parked(78, Pose::new(START + ahead + 12.0, beside, 0.0), 3.0, 1.2);
    let mut scenario = scene(lanes(3.5, true), speed, vec![in_front(&VEHICLE, ahead, y, 1.2), other]);
    scenario.problems[0].initial.centre.position.y = aside;
    let mirror = PlaneMotion { is_mirrored: true, ..PlaneMotion::NONE };
    let mirrored = mirror.scenario(&scenario);
    let [plan, reflected] = [&scenario, &mirrored].map(|scenario| {
        let mut planner = Planner::new(scenario.map(), &VEHICLE, &Settings::default()).unwrap();
        let start = at_start(scenario, &VEHICLE);
        planner.cycle(&Observation::of_scenario(scenario, &scenario.problems[0], start)).unwrap()
    });
    let claim = |plan: &Plan| (plan.level, plan.decision, plan.stops_for);
    let apart = (0..80).map(|i| 0.1 * f64::from(i)).map(|time| {
        let (point, other) = (plan.trajectory.at(time), reflected.trajectory.at(time));
        (other.pose.position - mirror.pose(&point.pose).position).norm().max((other.speed - point.speed).abs())
    });
    let apart = apart.fold(0.0, f64::max);
    let same = claim(&plan) == claim(&reflected) && apart < 1e-3;
    (!same).then(|| format!("{:?} and {:?}, {apart} m or m/s apart", claim(&plan), claim(&reflected)))
}

/// Left and right are the same: the mirrored observation has the mirrored plan, with the same claim.
#[test]
fn a_mirrored_observation_has_the_mirrored_plan() {
    let rng = &mut fastrand::Rng::with_seed(1);
    for _ in 0..60 {
        let scene =
            [(2.0, 14.0), (5.0, 40.0), (0.15, 1.6), (-2.0, 4.0), (-0.6, 0.6)].map(|(a, b)| a + (b - a) * rng.f64());
        assert_eq!(differs_mirrored(scene), None, "{scene:?}");
    }
}

/// Also where two plans cost the same, and where refinement hardly gains.
#[test]
#[ignore = "ties are broken by the order of offsets, and refinement is accepted on one side only"]
fn ties_and_small_gains_are_mirrored_too() {
    for scene in [
        // at its very end the plan swerves to either side with the same cost
        [13.97292588063975, 5.0, 1.5643002587246646, 2.6890354158948258, 0.0],
        // refined on one side only
        [5.949157897340537, 20.60828206997498, 1.3272057816317295, 2.618459779378249, -0.564707856264022],
    ] {
        assert_eq!(differs_mirrored(scene), None, "{scene:?}");
    }
}
