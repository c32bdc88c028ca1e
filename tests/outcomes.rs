//! Starts and goals that no plan can serve end as outcomes with a reason, never as errors.

use std::path::Path;

use stopline::drive::{self, Outcome, Settings};
use stopline::fixtures::parked;
use stopline::geometry::Point;
use stopline::geometry::polyline::Polyline;
use stopline::io::commonroad;
use stopline::map::{GoalPosition, Scenario};
use stopline::planner::Decision;
use stopline::vehicle;

fn straight() -> Scenario {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("maps/straight_100m.xml");
    commonroad::read_file(&file).unwrap()
}

fn ends(scenario: &Scenario) -> (Outcome, Option<&'static str>, usize) {
    let vehicle = vehicle::load("bmw_320i").unwrap();
    let run = drive::drive(scenario, &scenario.problems[0], &vehicle, &Settings::default(), &mut |_, _| {}).unwrap();
    (run.outcome, run.reason, run.log.samples.len())
}

#[test]
fn a_start_far_off_the_road_is_no_safe_plan_with_its_reason() {
    let mut scenario = straight();
    scenario.problems[0].initial.centre.position.y += 500.0;
    assert_eq!(ends(&scenario), (Outcome::NoSafePlan, Some("start_off_road"), 0));
}

#[test]
fn a_goal_on_a_road_without_connection_is_no_safe_plan_with_its_reason() {
    let mut scenario = straight();
    let mut island = scenario.network.lanelets.values().next().unwrap().clone();
    let away = |line: &Polyline| Polyline::new(line.points().iter().map(|p| Point::new(p.x, p.y + 1000.0))).unwrap();
    island.id = 999;
    (island.left, island.right, island.centre) = (away(&island.left), away(&island.right), away(&island.centre));
    (island.successors, island.predecessors) = (Vec::new(), Vec::new());
    (island.adjacent_left, island.adjacent_right) = (None, None);
    scenario.network.lanelets.insert(999, island);
    scenario.problems[0].goals[0].position = Some(GoalPosition::Lanelets(vec![999]));
    assert_eq!(ends(&scenario), (Outcome::NoSafePlan, Some("goal_unreachable"), 0));
}

#[test]
fn a_goal_whose_time_is_past_is_told_and_not_driven() {
    let mut scenario = straight();
    scenario.problems[0].goals[0].time.min = -5.0;
    scenario.problems[0].goals[0].time.max = -1.0;
    assert_eq!(ends(&scenario), (Outcome::TimedOut, Some("goal_time_is_past"), 0));
}

/// The emergency stop that stands in where nothing was ever proven is not a proven plan, however long it is kept.
#[test]
fn a_wall_too_near_to_stop_before_leaves_no_cycle_proven() {
    let mut scenario = straight();
    let initial = &scenario.problems[0].initial;
    let mut wall = initial.centre;
    wall.position += initial.centre.forward() * 4.5;
    scenario.obstacles.push(parked(9000, wall, 1.0, 20.0));
    let vehicle = vehicle::load("bmw_320i").unwrap();
    let run = drive::drive(&scenario, &scenario.problems[0], &vehicle, &Settings::default(), &mut |_, _| {}).unwrap();
    assert!(!run.cycles.is_empty() && run.cycles.iter().all(|c| c.decision == Decision::Unproven));
    let proven = run.verdict.checks.iter().find(|c| c.name == "stop_proven").unwrap();
    assert_eq!((proven.value, proven.failed()), (0.0, true));
}

#[test]
fn who_starts_too_fast_for_the_way_there_is_hears_the_distance_that_a_stop_takes() {
    let mut scenario = straight();
    scenario.problems[0].initial.speed = 20.0;
    let initial = scenario.problems[0].initial.centre;
    let mut wall = initial;
    wall.position += initial.forward() * 25.0;
    scenario.obstacles.push(parked(9000, wall, 1.0, 20.0));
    let vehicle = vehicle::load("bmw_320i").unwrap();
    let run = drive::plan(&scenario, &scenario.problems[0], &vehicle, &Settings::default()).unwrap();
    assert_eq!((run.outcome, run.reason), (Outcome::NoSafePlan, Some("cannot_stop")));
    let hardest = Settings::default().planner.emergency.last().unwrap().deceleration;
    let expected = 20.0 * 20.0 / (2.0 * hardest);
    assert!((run.stopping_distance.unwrap() - expected).abs() < 1e-9, "{:?} m", run.stopping_distance);
}

/// The file's time steps are where a goal counts; no physics step may pass between them.
#[test]
fn a_goal_is_reached_whatever_the_length_of_a_physics_step() {
    let (scenario, vehicle) = (straight(), vehicle::load("bmw_320i").unwrap());
    for step in [0.0007, 0.001, 0.0016, 0.0017, 0.0019] {
        let mut settings = Settings::default();
        settings.simulation.step = step;
        let run = drive::drive(&scenario, &scenario.problems[0], &vehicle, &settings, &mut |_, _| {}).unwrap();
        assert_eq!(run.outcome, Outcome::GoalReached, "{step} s");
        assert!(run.verdict.pass(), "{step} s: {:?}", run.verdict.first_failure());
    }
}

/// MotionPlanner are made anew ten times a second, long before a jerk-limited one has come to move.
#[test]
fn a_vehicle_at_rest_drives_off_at_every_jerk() {
    let vehicle = vehicle::load("bmw_320i").unwrap();
    for (speed, jerk) in [(0.0, 0.5), (0.0, 1.0), (0.0, 1.8), (0.001, 1.8), (0.01, 1.8), (0.0, 2.5), (0.0, 10.0)] {
        let mut scenario = straight();
        scenario.problems[0].initial.speed = speed;
        let mut settings = Settings::default();
        settings.planner.jerk = jerk;
        let run = drive::drive(&scenario, &scenario.problems[0], &vehicle, &settings, &mut |_, _| {}).unwrap();
        assert_eq!(run.outcome, Outcome::GoalReached, "from {speed} m/s with {jerk} m/s³");
    }
}
