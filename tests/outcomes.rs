//! Starts and goals that no plan can serve end as outcomes with a reason, never as errors; and a run that misses its goal fails
//! unless something stood in its way.

use std::path::Path;

use stopline::collision::Blocker;
use stopline::drive::{self, Outcome, Run, Settings};
use stopline::fixtures::{obstacle, parked};
use stopline::geometry::polyline::Polyline;
use stopline::geometry::{Point, Pose};
use stopline::io::commonroad;
use stopline::map::{GoalPosition, Interval, Motion, Obstacle, ObstacleKind, Part, Scenario, Shape, TimedPose};
use stopline::planner::Decision;
use stopline::result::{Kind, RunResult};
use stopline::vehicle::{self, ProofLimits, Vehicle};
use stopline::verdict::{Check, Status};

fn straight() -> Scenario {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("maps/straight_100m.xml");
    commonroad::read_file(&file).unwrap()
}

fn car() -> Vehicle {
    vehicle::load("bmw_320i").unwrap()
}

fn driven<'a>(scenario: &'a Scenario, vehicle: &'a Vehicle) -> Run<'a> {
    drive::drive(scenario, &scenario.problems[0], vehicle, &Settings::default(), &mut |_, _| {}).unwrap()
}

fn planned<'a>(scenario: &'a Scenario, vehicle: &'a Vehicle) -> Run<'a> {
    drive::plan(scenario, &scenario.problems[0], vehicle, &Settings::default()).unwrap()
}

fn check(run: &Run, name: &str) -> Check {
    run.verdict.checks.iter().find(|c| c.name == name).unwrap().clone()
}

fn failures(run: &Run) -> Vec<&'static str> {
    run.verdict.failures().map(|c| c.name).collect()
}

fn passes(kind: Kind, run: &Run) -> bool {
    RunResult::new(kind, run, &Settings::default(), 0).pass
}

/// The scenario with its goal at a pose relative to the start: a rectangle for the vehicle's centre.
fn with_goal_at(mut scenario: Scenario, ahead: f64, left: f64, width: f64) -> Scenario {
    let start = scenario.problems[0].initial.centre;
    let centre = Pose { position: start.to_world(Point::new(ahead, left)), yaw: start.yaw };
    let shape = Shape { parts: vec![Part::Rectangle { centre, length: 6.0, width }] };
    scenario.problems[0].goals[0].position = Some(GoalPosition::Shapes(shape));
    scenario
}

// ---- Proofs stay within what the vehicle reaches on the road.

/// A straight road with a wall at a distance ahead of the front bumper, m.
fn before_a_wall(vehicle: &Vehicle, speed: f64, distance: f64) -> Scenario {
    let mut scenario = straight();
    let initial = &mut scenario.problems[0].initial;
    initial.speed = speed;
    let wall = initial.centre.advanced(0.5 * vehicle.length + distance + 0.5);
    scenario.obstacles.push(parked(77, wall, 1.0, 20.0));
    scenario
}

/// Its brakes give 7 m/s² after a lag of 0.2 s, too little for these distances: 15 m/s take 16 m and 3 m of lag.
#[test]
fn a_truck_too_close_to_a_wall_claims_no_proof() {
    let truck = vehicle::load("truck").unwrap();
    for distance in [16.0, 17.0, 18.0] {
        let scenario = before_a_wall(&truck, 15.0, distance);
        let run = driven(&scenario, &truck);
        assert_eq!(run.outcome, Outcome::Collision, "{distance} m");
        let proven = run.cycles.iter().filter(|c| c.plan.decision != Decision::Unproven).count();
        assert_eq!(proven, 0, "of {} cycles, {distance} m", run.cycles.len());
        let foreseen: Vec<_> = run.cycles.iter().filter_map(|c| c.plan.expected_contact).collect();
        assert!(!foreseen.is_empty(), "{distance} m");
        assert!(foreseen.iter().all(|c| c.what == Blocker::Obstacle(77)), "{distance} m: {foreseen:?}");
        let (expected, contact) = (foreseen[foreseen.len() - 1], run.log.contact.unwrap());
        assert!((contact.time - expected.time).abs() < 0.3, "{distance} m: {expected:?} {contact:?}");
    }
}

/// Too little grip to stop on is an outcome, however little it is.
#[test]
fn a_road_almost_without_friction_is_an_outcome() {
    let car = car();
    let scenario = before_a_wall(&car, 8.0, 70.0);
    for friction in [1e-3, 1e-9, 1e-300] {
        let mut settings = Settings::default();
        settings.simulation.friction_scale = friction;
        settings.run.longest = 1.0;
        let run = drive::drive(&scenario, &scenario.problems[0], &car, &settings, &mut |_, _| {}).unwrap();
        assert!(run.cycles.iter().all(|c| c.plan.decision == Decision::Unproven), "{friction}");
    }
}

/// The lane is narrower than the vehicle all along, and blocked ahead: what the start imposes is no licence to drive round the
/// obstacle off the road.
#[test]
fn a_vehicle_wider_than_its_lane_leaves_the_road_no_farther_than_it_must() {
    let car = car();
    let mut scenario = before_a_wall(&car, 5.0, 40.0);
    scenario.obstacles[0].shape = Shape::rectangle(1.0, 1.5);
    let half = 0.5 * car.width - 0.03;
    for lanelet in scenario.network.lanelets.values_mut() {
        let moved = |side: f64| {
            let points = lanelet.centre.points();
            let yaw = lanelet.centre.yaw_at(0.0);
            Polyline::new(points.iter().map(|p| Pose { position: *p, yaw }.to_world(Point::new(0.0, side)))).unwrap()
        };
        (lanelet.left, lanelet.right) = (moved(half), moved(-half));
    }
    let run = driven(&scenario, &car);
    let road = check(&run, "stays_on_road");
    assert!(!road.failed(), "{road:?}");
    let fallbacks = check(&run, "fallback_stops");
    assert!(!fallbacks.failed(), "{fallbacks:?}");
    assert_eq!(run.outcome, Outcome::StoppedSafely);
}

/// Where 2 m/s² and a standoff of a few centimetres suffice, nobody brakes with 8 for a standoff of 0.8 m.
#[test]
fn the_standoff_is_given_up_before_hard_braking() {
    let car = car();
    for (speed, distance) in [(2.0, 1.25), (5.0, 4.6)] {
        let scenario = before_a_wall(&car, speed, distance);
        let run = driven(&scenario, &car);
        assert_eq!(run.outcome, Outcome::StoppedSafely, "{speed} m/s, {distance} m");
        assert!(run.cycles.iter().all(|c| c.plan.level.is_proven()), "{speed} m/s, {distance} m");
        // after the lag of the brakes, up to the wall
        let needed = speed * speed / (2.0 * (distance - speed * car.actuators.brake_lag));
        let hardest = run.log.samples.iter().map(|s| -s.acceleration).fold(0.0, f64::max);
        assert!(hardest < 1.6 * needed, "{speed} m/s, {distance} m: {hardest} where {needed} suffice");
    }
}

/// Brakes for a car ahead, and keeps to that: no milder plan round it with a centimetre to spare.
#[test]
fn a_proven_stop_is_not_left_for_a_swerve_without_margins() {
    let car = car();
    let mut scenario = before_a_wall(&car, 8.0, 6.8);
    scenario.obstacles[0].shape = Shape::rectangle(1.0, 1.9);
    let run = driven(&scenario, &car);
    assert_eq!(run.outcome, Outcome::StoppedSafely);
    assert!(run.cycles.iter().all(|c| c.plan.level.is_proven()));
    assert!(!check(&run, "fallback_stops").failed() && !check(&run, "no_contact").failed());
}

/// A sidewalk beside the lane is not road, for the planner as for the verdict: no plan and no fallback goes there.
#[test]
fn nothing_drives_over_a_sidewalk() {
    let car = car();
    let mut scenario = before_a_wall(&car, 8.0, 40.0);
    let mut sidewalk = scenario.network.lanelets.values().next().unwrap().clone();
    let width = sidewalk.left.at(0.0) - sidewalk.right.at(0.0);
    let shifted = |line: &Polyline| Polyline::new(line.points().iter().map(|p| p - width)).unwrap();
    (sidewalk.left, sidewalk.right) = (shifted(&sidewalk.left), shifted(&sidewalk.right));
    sidewalk.centre = shifted(&sidewalk.centre);
    (sidewalk.id, sidewalk.types) = (9001, vec!["sidewalk".into()]);
    // beside the lane, leaving more than the width of the vehicle only over there
    scenario.obstacles.pop();
    let initial = scenario.problems[0].initial.centre;
    scenario.obstacles.push(parked(77, initial.advanced(45.0), 4.0, width.norm()));
    for (types, outcome) in [("sidewalk", Outcome::StoppedSafely), ("urban", Outcome::GoalReached)] {
        let mut scenario = scenario.clone();
        sidewalk.types = vec![types.into()];
        scenario.network.lanelets.insert(sidewalk.id, sidewalk.clone());
        let run = driven(&scenario, &car);
        for name in ["no_contact", "stays_on_road", "fallback_stops"] {
            assert_eq!(check(&run, name).status, Status::Pass, "{types}: {:?}", check(&run, name));
        }
        assert_eq!(run.outcome, outcome, "{types}");
    }
}

/// On ice of which the planner knows, every proof holds: the run and each fallback branch stop before the wall.
#[test]
fn proofs_on_ice_hold() {
    let car = car();
    let scenario = before_a_wall(&car, 8.0, 70.0);
    let mut settings = Settings::default();
    settings.simulation.friction_scale = 0.15;
    let run = drive::drive(&scenario, &scenario.problems[0], &car, &settings, &mut |_, _| {}).unwrap();
    assert_eq!(run.outcome, Outcome::StoppedSafely);
    for name in ["no_contact", "stop_proven", "fallback_stops"] {
        assert_eq!(check(&run, name).status, Status::Pass, "{:?}", check(&run, name));
    }
    // with the friction unknown to the planner, the same road breaks the proofs
    settings.simulation.friction_scale = 1.0;
    settings.faults.friction = 0.15;
    let run = drive::drive(&scenario, &scenario.problems[0], &car, &settings, &mut |_, _| {}).unwrap();
    assert_eq!(check(&run, "fallback_stops").status, Status::Fail);
}

// ---- Close behind another vehicle.

/// A leader whose rear is at a distance ahead of the front bumper, m. It stands for 3 s and drives off.
fn behind_a_leader(vehicle: &Vehicle, gap: f64) -> Scenario {
    let mut scenario = straight();
    let initial = &mut scenario.problems[0].initial;
    initial.speed = 0.0;
    let place = initial.centre.advanced(0.5 * vehicle.length + gap + 2.25);
    let states = (0..=300).map(|i| {
        let time = 0.1 * f64::from(i);
        let (ramp, acceleration) = ((time - 3.0).clamp(0.0, 5.0), 2.0);
        let distance = 0.5 * acceleration * ramp * ramp + acceleration * ramp * (time - 3.0 - ramp).max(0.0);
        TimedPose { time, pose: place.advanced(distance), speed: acceleration * ramp }
    });
    let leader = obstacle(100, Shape::rectangle(4.5, 1.8), Motion::Trajectory(states.collect()));
    scenario.obstacles.push(Obstacle { kind: ObstacleKind::Vehicle, ..leader });
    scenario
}

/// Bumper to bumper, a standstill is safe and proven: the vehicle waits where it stands and follows.
#[test]
fn a_vehicle_close_behind_a_standing_leader_waits_and_follows() {
    let car = car();
    for gap in [0.15, 0.3, 0.6] {
        let scenario = behind_a_leader(&car, gap);
        let run = driven(&scenario, &car);
        let unproven = run.cycles.iter().filter(|c| c.plan.decision == Decision::Unproven).count();
        assert_eq!((run.outcome, unproven), (Outcome::GoalReached, 0), "{gap} m");
        for name in ["no_contact", "stop_proven", "fallback_stops"] {
            assert_eq!(check(&run, name).status, Status::Pass, "{gap} m: {:?}", check(&run, name));
        }
    }
}

// ---- Facts of the start: a plan and a drive report the same outcome and reason.

fn off_road() -> Scenario {
    let mut scenario = straight();
    scenario.problems[0].initial.centre.position.y += 500.0;
    scenario
}

fn unreachable_goal() -> Scenario {
    let mut scenario = straight();
    let mut island = scenario.network.lanelets.values().next().unwrap().clone();
    let away = |line: &Polyline| Polyline::new(line.points().iter().map(|p| Point::new(p.x, p.y + 1000.0))).unwrap();
    island.id = 999;
    (island.left, island.right, island.centre) = (away(&island.left), away(&island.right), away(&island.centre));
    (island.successors, island.predecessors) = (Vec::new(), Vec::new());
    (island.adjacent_left, island.adjacent_right) = (None, None);
    scenario.network.lanelets.insert(999, island);
    scenario.problems[0].goals[0].position = Some(GoalPosition::Lanelets(vec![999]));
    scenario
}

fn goal_in_the_past() -> Scenario {
    let mut scenario = straight();
    scenario.problems[0].goals[0].time = Interval { min: -5.0, max: -1.0 };
    scenario
}

fn start_in_a_wall() -> Scenario {
    let mut scenario = straight();
    scenario.obstacles.push(parked(9000, scenario.problems[0].initial.centre, 1.0, 1.0));
    scenario
}

/// The start is at 5 m/s, so the goal must not ask for a stop.
fn start_in_the_goal() -> Scenario {
    let mut scenario = with_goal_at(straight(), 1.0, 0.0, 3.5);
    scenario.problems[0].goals[0].speed = None;
    scenario
}

#[test]
fn plan_and_drive_report_the_same_facts_of_the_start() {
    let vehicle = car();
    for (scenario, outcome, reason, is_simulated) in [
        (off_road(), Outcome::NoSafePlan, Some("start_off_road"), false),
        (unreachable_goal(), Outcome::NoSafePlan, Some("goal_unreachable"), false),
        (goal_in_the_past(), Outcome::TimedOut, Some("goal_time_is_past"), false),
        (start_in_a_wall(), Outcome::Collision, Some("start_in_collision"), true),
        (start_in_the_goal(), Outcome::AlreadyAtGoal, None, true),
    ] {
        let (plan, drive) = (planned(&scenario, &vehicle), driven(&scenario, &vehicle));
        assert_eq!((plan.outcome, plan.reason), (outcome, reason), "plan");
        assert_eq!((drive.outcome, drive.reason), (outcome, reason), "drive");
        assert_eq!(!drive.log.samples.is_empty(), is_simulated, "{outcome:?}");
        let is_success = outcome == Outcome::AlreadyAtGoal;
        assert_eq!((passes(Kind::Plan, &plan), passes(Kind::Drive, &drive)), (is_success, is_success), "{outcome:?}");
    }
}

#[test]
fn a_start_in_the_goal_is_named_and_judged() {
    let (scenario, vehicle) = (start_in_the_goal(), car());
    let run = driven(&scenario, &vehicle);
    assert_eq!(run.log.samples.len(), 1, "nothing is driven");
    assert!(check(&run, "goal").passed() && check(&run, "no_contact").passed(), "{:?}", run.verdict);
    // a goal that asks for a stop is not reached at 5 m/s
    let mut stop = start_in_the_goal();
    stop.problems[0].goals[0].speed = Some(Interval { min: 0.0, max: 0.5 });
    assert_ne!(planned(&stop, &vehicle).outcome, Outcome::AlreadyAtGoal);
}

// ---- Missed goals.

#[test]
fn a_goal_behind_the_start_fails_at_the_end_of_the_road() {
    let (scenario, vehicle) = (with_goal_at(straight(), -6.0, 0.0, 3.5), car());
    let run = driven(&scenario, &vehicle);
    assert_eq!((run.outcome, failures(&run)), (Outcome::StoppedSafely, vec!["goal"]));
    assert!(!passes(Kind::Drive, &run));
    let goal = check(&run, "goal");
    assert!(
        goal.note.starts_with("missed the goal: ") && goal.note.ends_with("before the end of the road"),
        "{goal:?}"
    );
    assert!(check(&run, "stop_needed").passed(), "the end of the road is a reason to stop");
}

#[test]
fn a_goal_beside_the_lane_fails_at_the_end_of_the_road() {
    let (scenario, vehicle) = (with_goal_at(straight(), 60.0, 1.6, 0.2), car());
    let run = driven(&scenario, &vehicle);
    assert_eq!((run.outcome, failures(&run)), (Outcome::StoppedSafely, vec!["goal"]));
}

#[test]
fn a_goal_beyond_a_wall_does_not_apply_and_one_before_it_does() {
    let vehicle = car();
    let with_wall = |mut scenario: Scenario| {
        let start = scenario.problems[0].initial.centre;
        scenario.obstacles.push(parked(9000, start.advanced(70.0), 1.0, 20.0));
        scenario
    };
    let beyond = with_wall(straight());
    let run = driven(&beyond, &vehicle);
    assert_eq!((run.outcome, check(&run, "goal").status), (Outcome::StoppedSafely, Status::NotApplicable));
    assert!(passes(Kind::Drive, &run), "{:?}", run.verdict.first_failure());
    // the twin: the vehicle drives past a goal that it has to pass at another heading
    let mut before = with_wall(with_goal_at(straight(), 30.0, 0.0, 3.5));
    let goal = &mut before.problems[0].goals[0];
    (goal.speed, goal.yaw) = (None, Some(Interval { min: 3.0, max: 3.1 }));
    let run = driven(&before, &vehicle);
    assert_eq!((run.outcome, failures(&run)), (Outcome::StoppedSafely, vec!["goal"]));
}

#[test]
fn a_stopped_vehicle_waits_for_the_time_window_of_its_goal() {
    let (mut scenario, vehicle) = (straight(), car());
    let goal = &mut scenario.problems[0].goals[0];
    (goal.position, goal.speed, goal.yaw) = (None, None, None);
    goal.time = Interval { min: 40.0, max: 41.0 };
    let run = driven(&scenario, &vehicle);
    assert_eq!(run.outcome, Outcome::GoalReached);
    let last = run.log.samples.last().unwrap();
    assert!((last.time - 40.0).abs() < 0.02 && last.speed.abs() < 0.05, "{last:?}");
}

/// The window opens long after the vehicle can be there: it stops in the goal, on a road that goes on, and not in front of it.
#[test]
fn a_goal_that_opens_much_later_is_waited_for_inside() {
    let (mut scenario, vehicle) = (with_goal_at(straight(), 40.0, 0.0, 3.0), car());
    let goal = &mut scenario.problems[0].goals[0];
    (goal.speed, goal.yaw) = (None, None);
    goal.time = Interval { min: 50.0, max: 51.0 };
    let run = driven(&scenario, &vehicle);
    assert_eq!((run.outcome, failures(&run)), (Outcome::GoalReached, vec![]));
    let stands = run.log.samples.iter().find(|s| s.time > 1.0 && s.speed < 0.01).unwrap();
    assert!(stands.time < 20.0, "it stands from {} s on", stands.time);
    // the twin asks for a speed: nobody waits there
    scenario.problems[0].goals[0].speed = Some(Interval { min: 2.0, max: 9.0 });
    let run = driven(&scenario, &vehicle);
    assert_eq!(failures(&run), ["goal"]);
}

/// A stop with all that brakes and tyres give is no proven stop, in any cycle before standstill, even if it succeeds.
#[test]
fn a_wall_within_the_stopping_distance_leaves_every_moving_cycle_unproven() {
    let mut scenario = straight();
    let initial = &scenario.problems[0].initial;
    let mut wall = initial.centre;
    wall.position += initial.centre.forward() * 4.5;
    scenario.obstacles.push(parked(9000, wall, 1.0, 20.0));
    let vehicle = car();
    let run = driven(&scenario, &vehicle);
    let moves = |time: f64| run.log.samples.iter().any(|s| s.time >= time && s.speed > 0.1);
    let moving: Vec<_> = run.cycles.iter().filter(|c| moves(c.plan.time)).collect();
    assert!(
        moving.len() > 3 && moving.iter().all(|c| c.plan.decision == Decision::Unproven),
        "{} moving",
        moving.len()
    );
    assert!(check(&run, "stop_proven").failed());
}

#[test]
fn a_start_too_fast_to_stop_reports_the_stopping_distance() {
    let mut scenario = straight();
    scenario.problems[0].initial.speed = 20.0;
    let initial = scenario.problems[0].initial.centre;
    let mut wall = initial;
    wall.position += initial.forward() * 25.0;
    scenario.obstacles.push(parked(9000, wall, 1.0, 20.0));
    let vehicle = car();
    let run = planned(&scenario, &vehicle);
    assert_eq!((run.outcome, run.reason), (Outcome::NoSafePlan, Some("cannot_stop")));
    // a plan without a proof uses all that tyres and brakes give
    let hardest = ProofLimits::unreserved(&vehicle, 1.0).deceleration();
    // after the lag of the brakes
    let expected = 20.0 * vehicle.actuators.brake_lag + 20.0 * 20.0 / (2.0 * hardest);
    assert!((run.stopping_distance.unwrap() - expected).abs() < 1e-9, "{:?} m", run.stopping_distance);
}

/// A goal counts at the time steps of the file, whatever the physics step.
#[test]
fn a_goal_is_reached_whatever_the_length_of_a_physics_step() {
    let (scenario, vehicle) = (straight(), car());
    for step in [0.0007, 0.001, 0.0016, 0.0017, 0.0019] {
        let mut settings = Settings::default();
        settings.simulation.step = step;
        let run = drive::drive(&scenario, &scenario.problems[0], &vehicle, &settings, &mut |_, _| {}).unwrap();
        assert_eq!(run.outcome, Outcome::GoalReached, "{step} s");
        assert!(run.verdict.pass(), "{step} s: {:?}", run.verdict.first_failure());
    }
}

/// The loop replans ten times a second, before a jerk-limited plan has moved the vehicle.
#[test]
fn a_stopped_vehicle_drives_off_at_every_jerk_limit() {
    let vehicle = car();
    for (speed, jerk) in [(0.0, 0.5), (0.0, 1.0), (0.0, 1.8), (0.001, 1.8), (0.01, 1.8), (0.0, 2.5), (0.0, 10.0)] {
        let mut scenario = straight();
        scenario.problems[0].initial.speed = speed;
        let mut settings = Settings::default();
        settings.planner.jerk = jerk;
        let run = drive::drive(&scenario, &scenario.problems[0], &vehicle, &settings, &mut |_, _| {}).unwrap();
        assert_eq!(run.outcome, Outcome::GoalReached, "from {speed} m/s with {jerk} m/s³");
    }
}
