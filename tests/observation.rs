//! The planner in a loop of one's own: what is known changes from cycle to cycle, and wrong observations are refused.

mod common;

use std::sync::Arc;

use common::{VEHICLE, bundled};
use stopline::collision::Blocker;
use stopline::drive::{Observer, PredictionMode, Sensor};
use stopline::fixtures::{parked, vehicle};
use stopline::geometry::{Point, Pose};
use stopline::map::{Goal, Interval, Motion, Obstacle, ObstacleKind, Part, Scenario, Shape, TimedOccupancy, TimedPose};
use stopline::planner::{Cause, Decision, Level, Observation, ObservationError, Plan, Planner, PlannerError};
use stopline::vehicle::{State, Vehicle};
use stopline::{Settings, drive};

/// A road of 100 m along x, driven at 10 m/s.
struct Loop {
    scenario: Scenario,
    observation: Observation,
}

impl Loop {
    fn new() -> Self {
        let mut scenario = bundled("straight_100m");
        scenario.problems[0].initial.speed = 10.0;
        let initial = &scenario.problems[0].initial;
        let state = State {
            time: 0.0,
            pose: VEHICLE.rear_axle_of_centre(&initial.centre),
            speed: 10.0,
            lateral_speed: 0.0,
            acceleration: 0.0,
            yaw_rate: 0.0,
            steering: 0.0,
        };
        let observation = Observation::of_scenario(&scenario, &scenario.problems[0], state);
        Self { scenario, observation }
    }

    fn planner(&self) -> Planner<'_> {
        Planner::new(self.scenario.map(), &VEHICLE, &stopline::planner::Settings::default()).unwrap()
    }

    fn start(&self) -> Pose {
        self.observation.state.pose
    }
}

/// The state after the plan was followed exactly for a time.
fn followed(plan: &Plan, by: f64) -> State {
    let point = plan.trajectory.at(plan.time + by);
    State {
        time: plan.time + by,
        pose: point.pose,
        speed: point.speed,
        lateral_speed: 0.0,
        acceleration: point.acceleration,
        yaw_rate: point.speed * point.curvature,
        steering: VEHICLE.steering_for_curvature(point.curvature),
    }
}

fn observed(obstacles: Vec<Obstacle>, observation: &Observation) -> Observation {
    Observation { obstacles: obstacles.into(), ..observation.clone() }
}

/// A car on the lane with a prediction.
fn car(id: i64, states: Vec<TimedPose>) -> Obstacle {
    Obstacle {
        kind: ObstacleKind::Vehicle,
        motion: Motion::Trajectory(states),
        ..parked(id, Pose::new(0.0, 0.0, 0.0), 4.5, 1.8)
    }
}

fn at(time: f64, x: f64, speed: f64) -> TimedPose {
    TimedPose { time, pose: Pose::new(x, 0.0, 0.0), speed }
}

#[test]
fn an_obstacle_that_appears_in_mid_run_is_stopped_for() {
    let world = Loop::new();
    let mut planner = world.planner();
    let mut observation = world.observation.clone();
    let mut plan = planner.cycle(&observation).unwrap();
    let wall = world.start().position.x + 45.0;
    for cycle in 1..100 {
        observation.state = followed(&plan, 0.1);
        if cycle == 10 {
            assert_ne!(plan.stops_for, Some(Cause::Obstacle(7)));
            observation.obstacles = Arc::from([parked(7, Pose::new(wall, 0.0, 0.0), 1.0, 8.0)]);
        }
        plan = planner.cycle(&observation).unwrap();
        assert!(plan.level.is_proven(), "cycle {cycle}: {plan:?}");
    }
    let front = followed(&plan, 10.0).pose.position.x + VEHICLE.front_overhang_from_rear_axle();
    assert!(front < wall - 0.5 && front > wall - 3.0, "{front} before {wall}");
    assert_eq!(plan.stops_for, Some(Cause::Obstacle(7)), "{plan:?}");
}

/// The decisions of some cycles on the empty road, each a tenth of a second after the one before; `change` alters the observation of the
/// last one.
fn decisions(cycles: usize, change: impl Fn(&mut Observation)) -> Vec<Decision> {
    let world = Loop::new();
    let mut planner = world.planner();
    let mut observation = world.observation.clone();
    let mut decisions = Vec::new();
    for cycle in 0..cycles {
        if cycle + 1 == cycles {
            change(&mut observation);
        }
        let plan = planner.cycle(&observation).unwrap();
        decisions.push(plan.decision);
        observation.state = followed(&plan, 0.1);
    }
    decisions
}

/// A search at least every half second; between two searches the plan goes on, except for what makes another one necessary or better.
#[test]
fn between_two_searches_the_proven_plan_continues_unless_the_road_or_the_task_changes() {
    let usual = decisions(31, |_| {});
    let between: Vec<usize> = usual.split(|d| *d != Decision::Continue).map(<[_]>::len).collect();
    assert!(between.iter().all(|n| *n <= 4) && between.contains(&4), "{usual:?}");
    // a cycle in which nothing would have been searched
    let last = usual.iter().position(|d| *d == Decision::Continue).unwrap() + 1;
    assert_eq!(decisions(last, |_| {})[last - 1], Decision::Continue);
    let x = Loop::new().start().position.x;
    let beside = |kind: fn(i64, Pose) -> Obstacle| {
        move |o: &mut Observation| o.obstacles = Arc::from([kind(7, Pose::new(x + 300.0, 50.0, 0.0))])
    };
    let searched = |change: &dyn Fn(&mut Observation)| decisions(last, change)[last - 1] != Decision::Continue;
    assert!(searched(&beside(|id, pose| parked(id, pose, 1.0, 1.0))), "the static obstacles");
    assert!(searched(&|o| o.friction = 0.9), "the friction");
    assert!(
        searched(&|o| o.goals = o
            .goals
            .iter()
            .map(|g| Goal { speed: None, yaw: None, ..g.clone() })
            .rev()
            .chain(o.goals.iter().cloned())
            .collect()),
        "the goals"
    );
    assert!(searched(&|o| o.state.pose.position.y += 2.0), "the vehicle is beside its plan");
    // a moving obstacle matters only if it refutes the plan
    let crossing = |y: f64| {
        let pose = |time: f64| TimedPose { time, pose: Pose::new(x + 25.0, y, 0.0), speed: 0.1 };
        car(7, vec![pose(0.0), pose(30.0)])
    };
    assert!(searched(&|o| o.obstacles = Arc::from([crossing(0.0)])), "it is in the way");
    assert!(!searched(&|o| o.obstacles = Arc::from([crossing(50.0)])), "it is far away");
}

/// A leader drives on; then it brakes harder than predicted. The committed plan, proven for the first prediction, is refuted.
#[test]
fn the_committed_plan_is_proven_again_for_new_predictions() {
    let world = Loop::new();
    let x = world.start().position.x;
    let moves = car(5, (0..=80).map(|i| at(0.1 * f64::from(i), x + 26.0 + f64::from(i), 10.0)).collect());
    // stops at once where it is after a second
    let mut states: Vec<TimedPose> = (0..=10).map(|i| at(0.1 * f64::from(i), x + 26.0 + f64::from(i), 10.0)).collect();
    states.push(at(8.0, x + 36.0, 0.0));
    let stops = car(5, states);
    let mut planner = world.planner();
    let mut plan = planner.cycle(&observed(vec![moves.clone()], &world.observation)).unwrap();
    for _ in 1..=10 {
        plan = planner
            .cycle(&Observation { state: followed(&plan, 0.1), ..observed(vec![moves.clone()], &world.observation) })
            .unwrap();
    }
    assert!(plan.level.is_proven());
    let ends_before =
        |plan: &Plan| followed(plan, 60.0).pose.position.x + VEHICLE.front_overhang_from_rear_axle() < x + 36.0 - 2.25;
    assert!(!ends_before(&plan), "the plan must rely on the leader");
    let state = followed(&plan, 0.1);
    let now = planner.cycle(&Observation { state, ..observed(vec![stops], &world.observation) }).unwrap();
    assert_ne!(now.decision, Decision::KeepPrevious, "it is refuted");
    assert!(ends_before(&now) && now.level.is_proven(), "{now:?}");
    // the same observation again refutes nothing
    let again = planner
        .cycle(&Observation { state: followed(&now, 0.1), ..observed(vec![moves], &world.observation) })
        .unwrap();
    assert!(again.level.is_proven());
}

/// The contact is there while the brakes cannot respond yet, and over before a plan begins; the twin passes beside.
#[test]
fn a_standing_vehicle_that_is_driven_through_has_no_proof() {
    let mut world = Loop::new();
    world.observation.state.speed = 0.0;
    let start = world.start().position;
    let passes = |time: f64, beside: f64| {
        let at = |i: i32| {
            let since = 0.05 * f64::from(i);
            TimedPose {
                time: time + since,
                pose: Pose::new(start.x + 4.0 + 40.0 * since, start.y + beside, 0.0),
                speed: 40.0,
            }
        };
        vec![car(3, (0..40).map(at).collect())]
    };
    for (beside, is_proven) in [(0.0, false), (2.5, true)] {
        let mut planner = world.planner();
        let plan = planner.cycle(&observed(passes(0.0, beside), &world.observation)).unwrap();
        assert_eq!(plan.level.is_proven(), is_proven, "{plan:?}");
        let contact = plan.expected_contact.map(|contact| (contact.what, contact.time));
        assert_eq!(contact, (!is_proven).then_some((Blocker::Obstacle(3), 0.0)), "{plan:?}");
        // the same with a proven plan before
        let mut planner = world.planner();
        assert!(planner.cycle(&world.observation).unwrap().level.is_proven());
        let state = State { time: 0.1, ..world.observation.state };
        let plan = planner.cycle(&Observation { state, ..observed(passes(0.1, beside), &world.observation) }).unwrap();
        assert_eq!(plan.level.is_proven(), is_proven, "{plan:?}");
    }
}

/// Plans go forwards only: of a vehicle that rolls backwards, nothing is proven until its brakes have stopped it. What is left of the
/// swing after a stop is less than the tracking error.
#[test]
fn a_vehicle_that_rolls_backwards_has_no_proof() {
    let world = Loop::new();
    for (speed, is_proven) in [(-5.0, false), (-1.0, false), (-0.5, false), (-0.1, true), (0.0, true), (0.5, true)] {
        let state = State { speed, ..world.observation.state };
        let mut planner = world.planner();
        let plan = planner.cycle(&Observation { state, ..world.observation.clone() }).unwrap();
        assert_eq!(plan.level.is_proven(), is_proven, "{speed} m/s: {plan:?}");
        // the same after a proven plan
        let mut planner = world.planner();
        let before = State { speed: 0.0, ..world.observation.state };
        let before = planner.cycle(&Observation { state: before, ..world.observation.clone() }).unwrap();
        assert!(before.level.is_proven());
        let state = State { time: 0.1, ..state };
        let plan = planner.cycle(&Observation { state, ..world.observation.clone() }).unwrap();
        assert_eq!(plan.level.is_proven(), is_proven, "{speed} m/s after a plan: {plan:?}");
    }
}

/// Without a plan of its own the planner keeps the old one only while its proof holds: here the road is blocked behind it.
#[test]
fn a_refuted_plan_without_a_successor_is_unproven() {
    let world = Loop::new();
    let mut planner = world.planner();
    let plan = planner.cycle(&world.observation).unwrap();
    let state = followed(&plan, 0.1);
    let wall =
        parked(3, Pose::new(state.pose.position.x + VEHICLE.front_overhang_from_rear_axle() + 1.5, 0.0, 0.0), 1.0, 8.0);
    let now = planner.cycle(&Observation { state, ..observed(vec![wall], &world.observation) }).unwrap();
    assert_eq!((now.decision, now.level), (Decision::Unproven, Level::Unproven));
    let contact = now.expected_contact.expect("1.5 m at 10 m/s is too near");
    assert_eq!(contact.what, stopline::collision::Blocker::Obstacle(3));
    assert_eq!(now.stops_for, Some(Cause::Obstacle(3)));
}

/// A prediction that ends in front of the vehicle: the car is still there afterwards (`cases/32_*`).
#[test]
fn an_obstacle_does_not_vanish_at_the_end_of_its_prediction() {
    let world = Loop::new();
    let x = world.start().position.x;
    let stands = car(5, vec![at(0.0, x + 35.0, 0.0), at(1.0, x + 35.0, 0.0)]);
    let mut settings = stopline::planner::Settings::default();
    let mut ends = |duration: f64| {
        settings.extrapolation.duration = duration;
        let mut planner = Planner::new(world.scenario.map(), &VEHICLE, &settings).unwrap();
        let plan = planner.cycle(&observed(vec![stands.clone()], &world.observation)).unwrap();
        let at = |t: f64| followed(&plan, t).pose.position.x + VEHICLE.front_overhang_from_rear_axle();
        (at(3.9), at(60.0))
    };
    let rear = x + 35.0 - 2.25;
    assert!(ends(3.0).0 < rear, "it is assumed to stay for 3 s: {:?}", ends(3.0));
    assert!(ends(0.0).1 > rear, "as in CommonRoad it vanishes: {:?}", ends(0.0));
    assert!(ends(20.0).1 < rear);
}

#[test]
fn an_obstacle_without_a_prediction_or_a_past_moves_on_as_it_does() {
    let world = Loop::new();
    let x = world.start().position.x;
    let mut settings = stopline::planner::Settings::default();
    settings.extrapolation.duration = 20.0;
    let plan = |speed: f64, first: f64| {
        let alone = car(5, vec![TimedPose { time: first, ..at(0.0, x + 40.0, speed) }]);
        let mut planner = Planner::new(world.scenario.map(), &VEHICLE, &settings).unwrap();
        planner.cycle(&observed(vec![alone], &world.observation)).unwrap()
    };
    let progress = |plan: &Plan| followed(plan, 6.0).pose.position.x - x;
    let (away, standing) = (progress(&plan(10.0, 0.0)), progress(&plan(0.0, 0.0)));
    assert!(away > standing + 10.0, "{away} {standing}");
    // one that is seen later than now is moved back to now: it is there already
    let late = progress(&plan(0.0, 0.5));
    assert!((late - standing).abs() < 1.0, "{late} {standing}");
}

#[test]
fn the_friction_may_change_in_mid_run() {
    let world = Loop::new();
    let mut planner = world.planner();
    let dry = planner.cycle(&world.observation).unwrap();
    let state = followed(&dry, 0.1);
    let ice = planner.cycle(&Observation { state, friction: 0.15, ..world.observation.clone() }).unwrap();
    let hardest = |plan: &Plan| plan.trajectory.profile.knots().iter().map(|k| -k.acceleration).fold(0.0, f64::max);
    let grip = 0.15 * VEHICLE.tyres.friction * 9.81;
    assert!(hardest(&dry) > grip, "{}", hardest(&dry));
    assert!(ice.deceleration < grip && hardest(&ice) < grip + 0.05, "{ice:?}");
}

/// Every observation is the good one with one fault.
#[test]
fn wrong_observations_are_refused_and_the_planner_goes_on() {
    let world = Loop::new();
    let mut planner = world.planner();
    planner
        .cycle(&Observation { state: State { time: 1.0, ..world.observation.state }, ..world.observation.clone() })
        .unwrap();
    let later = State { time: 1.1, ..world.observation.state };
    let good = Observation { state: later, ..world.observation.clone() };
    let mut refused = |change: &dyn Fn(&mut Observation)| {
        let mut wrong = good.clone();
        change(&mut wrong);
        let error = planner.cycle(&wrong).expect_err("a wrong observation");
        let PlannerError::Observation(error) = error else { panic!("{error}") };
        assert!(planner.cycle(&good).is_ok(), "after {error}");
        error
    };
    let with = |o: Obstacle| move |w: &mut Observation| w.obstacles = Arc::from([o.clone()]);
    let nan = f64::NAN;
    assert!(matches!(refused(&|o| o.state.speed = nan), ObservationError::State { what: "the speed", .. }));
    assert!(matches!(refused(&|o| o.state.pose.position.x = f64::INFINITY), ObservationError::State { .. }));
    assert!(matches!(refused(&|o| o.state.time = nan), ObservationError::State { what: "the time", .. }));
    for change in [
        |o: &mut Observation| o.state.speed = -151.0,
        |o: &mut Observation| o.state.lateral_speed = 1e9,
        |o: &mut Observation| o.state.acceleration = 1e308,
        |o: &mut Observation| o.state.yaw_rate = -21.0,
        |o: &mut Observation| o.state.steering = 1.6,
    ] {
        assert!(matches!(refused(&change), ObservationError::Beyond { .. }));
    }
    assert_eq!(
        refused(&|o| o.state.speed = 1e5).to_string(),
        "the speed of the vehicle is 100000 m/s, expected at most 150 m/s to either side"
    );
    assert_eq!(refused(&|o| o.state.time = 0.9), ObservationError::TimeGoesBack { now: 0.9, before: 1.1 });
    for friction in [0.0, -1.0, 11.0] {
        assert_eq!(refused(&|o| o.friction = friction), ObservationError::Friction(friction));
    }
    assert!(matches!(refused(&|o| o.friction = nan), ObservationError::Friction(_)));
    let wall = parked(7, Pose::new(80.0, 0.0, 0.0), 1.0, 8.0);
    assert_eq!(refused(&|o| o.obstacles = vec![wall.clone(), wall.clone()].into()), ObservationError::DuplicateId(7));
    let mut no_place = wall.clone();
    no_place.motion = Motion::Static(Pose::new(nan, 0.0, 0.0));
    assert!(matches!(refused(&with(no_place)), ObservationError::Obstacle { id: 7, .. }));
    for part in [
        Part::Circle { centre: Point::origin(), radius: nan },
        Part::Polygon { vertices: vec![Point::origin(), Point::new(nan, 1.0), Point::new(1.0, 0.0)] },
        Part::Rectangle { centre: Pose::new(0.0, 0.0, 0.0), length: nan, width: 1.0 },
    ] {
        let no_shape = Obstacle { shape: Shape { parts: vec![part] }, ..wall.clone() };
        assert!(matches!(refused(&with(no_shape)), ObservationError::Obstacle { id: 7, what: "its shape" }));
    }
    assert!(matches!(refused(&with(car(7, vec![]))), ObservationError::Prediction { id: 7, .. }));
    assert!(matches!(
        refused(&with(car(7, vec![at(2.0, 1.0, 1.0), at(1.0, 0.0, 1.0)]))),
        ObservationError::Prediction { .. }
    ));
    assert!(matches!(refused(&with(car(7, vec![at(1.0, 1.0, nan)]))), ObservationError::Obstacle { .. }));
    let sets = |times: &[(f64, f64)]| {
        let set = |&(from, to): &(f64, f64)| TimedOccupancy { from, to, region: Shape::rectangle(1.0, 1.0) };
        Obstacle { motion: Motion::Occupancy(times.iter().map(set).collect()), ..wall.clone() }
    };
    for times in [&[][..], &[(2.0, 1.0)], &[(2.0, 3.0), (1.0, 2.0)]] {
        assert!(matches!(refused(&with(sets(times))), ObservationError::Prediction { .. }), "{times:?}");
    }
    let goal = world.observation.goals.first().cloned().expect("the map has a goal");
    let no_time = stopline::map::Goal { time: Interval { min: nan, max: 1.0 }, ..goal };
    assert_eq!(refused(&|o| o.goals = Arc::from([no_time.clone()])), ObservationError::Goal { index: 0, what: "time" });
    let texts = [refused(&|o| o.friction = 0.0).to_string(), refused(&|o| o.state.time = 0.5).to_string()];
    assert!(texts.iter().all(|t| t.contains("expected")), "{texts:?}");
}

/// Comfort is a wish: brakes that are weaker than it limit the proofs.
#[test]
fn a_vehicle_whose_brakes_are_weaker_than_its_comfort_proves_with_its_brakes() {
    let world = Loop::new();
    let mut weak = vehicle();
    weak.limits.deceleration = 1.0;
    assert!(weak.comfort.deceleration > 1.0);
    let mut planner = Planner::new(world.scenario.map(), &weak, &stopline::planner::Settings::default()).unwrap();
    let plan = planner.cycle(&world.observation).unwrap();
    assert!(plan.deceleration < 1.0 && plan.level.is_proven(), "{plan:?}");
    let hardest = plan.trajectory.profile.knots().iter().map(|k| -k.acceleration).fold(0.0, f64::max);
    assert!(hardest < 1.0 + 0.03, "{hardest}");
}

/// The observations of a scenario with a sensor.
fn in_sight(scenario: &Scenario, sensor: Sensor, mode: PredictionMode, state: &State) -> Vec<Obstacle> {
    let mut settings = Settings::default();
    (settings.observation.sensor, settings.observation.prediction) = (sensor, mode);
    Observer::new(scenario, &scenario.problems[0], &VEHICLE, &settings).observe(state).obstacles.to_vec()
}

#[test]
fn the_sensor_shows_what_is_in_range_in_view_and_not_hidden() {
    let world = Loop::new();
    let (state, eye) = (world.observation.state, VEHICLE.centre_of_rear_axle(&world.start()).position);
    let place = |id: i64, x: f64, y: f64| parked(id, Pose::new(eye.x + x, eye.y + y, 0.0), 2.0, 2.0);
    let mut scenario = world.scenario.clone();
    // 2 is hidden behind 1, 3 is behind the vehicle, 4 is far, 5 beside
    scenario.obstacles =
        vec![place(1, 10.0, 0.0), place(2, 20.0, 0.0), place(3, -15.0, 0.0), place(4, 90.0, 9.0), place(5, 0.0, 12.0)];
    let seen = |sensor| -> Vec<i64> {
        in_sight(&scenario, sensor, PredictionMode::Recorded, &state).iter().map(|o| o.id).collect()
    };
    let all = Sensor::default();
    assert_eq!(seen(all), [1, 2, 3, 4, 5]);
    assert_eq!(seen(Sensor { range: 50.0, ..all }), [1, 2, 3, 5]);
    assert_eq!(seen(Sensor { range: 8.9, ..all }), [0_i64; 0]);
    assert_eq!(seen(Sensor { fov: 60.0, ..all }), [1, 2, 4]);
    assert_eq!(seen(Sensor { occlusion: true, ..all }), [1, 3, 4, 5]);
    assert_eq!(seen(Sensor { missed: 1.0, ..all }), [0_i64; 0]);
    // a share of the cycles, the same for the same seed
    let missed = |seed: u64| -> Vec<bool> {
        let sensor = Sensor { missed: 0.3, seed, ..all };
        let state = |i: i32| State { time: 0.1 * f64::from(i), ..state };
        (0..400).map(|i| in_sight(&scenario, sensor, PredictionMode::Recorded, &state(i)).len() < 5).collect()
    };
    assert_eq!(missed(1), missed(1));
    assert_ne!(missed(1), missed(2));
    let share = missed(3).iter().filter(|m| **m).count() as f64 / 400.0;
    assert!((share - (1.0 - 0.7_f64.powi(5))).abs() < 0.08, "{share}");
}

/// A record that ends at 3 s is extrapolated for 3 s.
#[test]
fn an_obstacle_is_seen_not_before_it_is_born_remembered_after_its_record_and_late_with_a_delay() {
    let world = Loop::new();
    let mut scenario = world.scenario.clone();
    scenario.obstacles = vec![car(5, (10..=30).map(|i| at(0.1 * f64::from(i), 50.0 + f64::from(i), 10.0)).collect())];
    let seen = |time: f64, delay: f64| {
        let state = State { time, ..world.observation.state };
        in_sight(&scenario, Sensor { delay, ..Sensor::default() }, PredictionMode::Recorded, &state).len()
    };
    assert_eq!([0.0, 0.9, 1.0, 3.0, 5.9, 6.1].map(|t| seen(t, 0.0)), [0, 0, 1, 1, 1, 0]);
    assert_eq!([1.0, 1.4, 1.5, 3.5, 6.4, 6.6].map(|t| seen(t, 0.5)), [0, 0, 1, 1, 1, 0]);
}

/// On a lane that bends, the lane is followed; constant velocity leaves it.
#[test]
fn predictions_go_straight_or_along_the_lane() {
    let scenario = bundled("turn_90");
    let bends = |l: &&stopline::map::Lanelet| (l.centre.yaw_at(l.centre.length()) - l.centre.yaw_at(0.0)).abs() > 0.5;
    let lanelet = scenario.network.lanelets.values().find(bends).expect("a bend");
    let station = 0.0;
    let pose = Pose { position: lanelet.centre.at(station), yaw: lanelet.centre.yaw_at(station) };
    let moving = |time: f64| TimedPose { time, pose, speed: 8.0 };
    let mut with_car = scenario.clone();
    with_car.obstacles = vec![car(5, vec![moving(0.0), moving(9.0)])];
    let state = Loop::new().observation.state;
    let predicted = |mode| {
        let obstacles = in_sight(&with_car, Sensor::default(), mode, &state);
        let Motion::Trajectory(states) = &obstacles[0].motion else { panic!("a trajectory") };
        states.clone()
    };
    let straight = predicted(PredictionMode::ConstantVelocity);
    for s in &straight {
        let expected = pose.to_world(Point::new(8.0 * s.time, 0.0));
        assert!((s.pose.position - expected).norm() < 1e-9);
    }
    let along = predicted(PredictionMode::LaneFollowing);
    assert_eq!(along.len(), straight.len());
    let turned = |states: &[TimedPose]| (states[states.len() - 1].pose.yaw - pose.yaw).abs();
    let bend = (lanelet.centre.yaw_at(lanelet.centre.length()) - pose.yaw).abs();
    assert!(turned(&along) > 0.9 * bend && turned(&straight) == 0.0, "{} of {bend}", turned(&along));
    let aside = |s: &TimedPose| {
        let at = lanelet.centre.project(s.pose.position);
        if at.station < lanelet.centre.length() - 0.1 { at.offset.abs() } else { 0.0 }
    };
    assert!(along.iter().all(|s| aside(s) < 0.05));
    assert!(straight.iter().any(|s| aside(s) > 0.5));
    for pair in along.windows(2) {
        let moved = (pair[1].pose.position - pair[0].pose.position).norm();
        assert!((moved - 8.0 * 0.2).abs() < 0.05, "{moved}");
    }
    assert_eq!(predicted(PredictionMode::Recorded).len(), 2);
}

/// Worse knowledge of the traffic keeps the promise of a stop for what is known: a run says so itself.
#[test]
fn a_run_with_other_predictions_and_a_short_sight_is_repeatable() {
    let scenario = bundled("cut_in");
    let mut settings = Settings::default();
    settings.observation.prediction = PredictionMode::LaneFollowing;
    settings.observation.sensor = Sensor { range: 60.0, occlusion: true, ..Sensor::default() };
    let vehicle: &Vehicle = &VEHICLE;
    let run = || drive::drive(&scenario, &scenario.problems[0], vehicle, &settings, &mut |_, _| {}).unwrap();
    let (a, b) = (run(), run());
    assert_eq!(a.log.samples.len(), b.log.samples.len());
    assert!(a.log.samples.iter().zip(&b.log.samples).all(|(a, b)| a == b));
    let without: fn(&stopline::Cycle) -> stopline::planner::Plan = |c| c.plan.clone();
    assert!(a.cycles.iter().map(without).eq(b.cycles.iter().map(without)));
}
