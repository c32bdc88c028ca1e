//! The bundled scenarios end as described and pass every check; changed scenarios end otherwise.

mod common;

use std::collections::BTreeMap;

use common::{ADDED, VEHICLE, bundled, driven, failures, maps, standing};
use stopline::drive::{Outcome, Run, Settings, drive};
use stopline::geometry::{Point, Pose};
use stopline::map::{Motion, Scenario};
use stopline::planner::{Cycle, Decision};
use stopline::plot::run_svg;
use stopline::simulation::{self, Log, Sample, Touched, World};
use stopline::vehicle::State;
use stopline::verdict::{self, Expectation};

/// One test for each scenario, and the list of all.
macro_rules! scenarios {
    ($($name:ident: $outcome:ident),* $(,)?) => {
        const SCENARIOS: &[(&str, Outcome)] = &[$((stringify!($name), Outcome::$outcome)),*];
        mod ends {
            use super::*;
            $(#[test]
            fn $name() {
                ends_as_described(stringify!($name), Outcome::$outcome);
            })*
        }
    };
}

scenarios! {
    straight_100m: GoalReached,
    parked_car: GoalReached,
    slalom: GoalReached,
    s_curve: GoalReached,
    turn_90: GoalReached,
    lane_change: GoalReached,
    lane_blocked: StoppedSafely,
    slow_lead: GoalReached,
    lead_brakes_hard: StoppedSafely,
    pedestrian: GoalReached,
    cut_in: GoalReached,
    oncoming: GoalReached,
}

fn ends_as_described(name: &str, outcome: Outcome) {
    let scenario = bundled(name);
    assert!(scenario.issues.is_empty(), "{name}: {:?}", scenario.issues);
    let run = driven(&scenario);
    assert_eq!(run.outcome, outcome, "{name}: {:?}, {:#?}", run.reason, failures(&run));
    let by_outcome = if outcome == Outcome::GoalReached { "goal" } else { "stops" };
    for check in
        ["no_contact", "stays_on_road", "stop_proven", "comfort_longitudinal", "comfort_lateral", "comfort_jerk"]
            .into_iter()
            .chain(["tracking", by_outcome])
    {
        let passed = run.verdict.checks.iter().any(|c| c.name == check && c.passed());
        assert!(passed, "{name}: {check} did not pass: {:#?}", run.verdict);
    }
    assert!(run.verdict.pass(), "{name}: {:#?}", failures(&run));
    matches_its_picture(name, &run);
}

/// The pictures in `maps/README.md` show these runs, byte by byte.
fn matches_its_picture(name: &str, run: &Run) {
    let stored = std::fs::read_to_string(maps().join("pictures").join(name).with_extension("svg")).unwrap_or_default();
    assert!(
        stored == run_svg(run),
        "maps/pictures/{name}.svg differs from the picture drawn now; look at the new one and store it: \
         cargo run --release -- drive maps/{name}.xml --quiet --svg maps/pictures/{name}.svg"
    );
}

/// The table of `maps/README.md`, the list above and the folder agree.
#[test]
fn the_readme_lists_every_scenario_with_its_outcome() {
    let listed: BTreeMap<String, String> = SCENARIOS.iter().map(|(n, o)| ((*n).into(), o.name().into())).collect();
    let files = std::fs::read_dir(maps()).unwrap().map(|e| e.unwrap().path());
    let mut in_folder: Vec<String> = files
        .filter(|p| p.extension().is_some_and(|e| e == "xml"))
        .map(|p| p.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    in_folder.sort();
    assert_eq!(in_folder, listed.keys().cloned().collect::<Vec<_>>());
    let readme = std::fs::read_to_string(maps().join("README.md")).unwrap();
    let rows = readme.lines().filter_map(|line| {
        let cells: Vec<_> = line.split('|').map(str::trim).collect();
        let name = cells.get(1)?.strip_prefix("[`")?.split(".xml").next()?;
        Some((name.to_owned(), cells.get(3)?.trim_matches('`').to_owned()))
    });
    assert_eq!(rows.collect::<BTreeMap<_, _>>(), listed);
}

// ---- Twins: a change of the scenario changes the outcome.

/// Drives with an added wall and asserts a stop before it.
fn stops_before_a_wall(name: &str, wall: Pose) {
    /// Longer than any of the roads is wide, m.
    const WIDTH: f64 = 16.0;
    let mut scenario = bundled(name);
    scenario.obstacles.push(standing(wall, 1.0, WIDTH));
    let run = driven(&scenario);
    assert_eq!(run.outcome, Outcome::StoppedSafely, "{name}: {:?}, {:#?}", run.reason, failures(&run));
    assert!(run.verdict.pass(), "{name}: {:#?}", failures(&run));
    let (start, end) = (run.log.samples[0], run.log.samples[run.log.samples.len() - 1]);
    let to_wall = wall.to_local(VEHICLE.centre_of_rear_axle(&end.pose).position).x;
    let front = -to_wall - 0.5 * VEHICLE.length - 0.5;
    let driven = (end.pose.position - start.pose.position).norm();
    assert!(driven > 10.0, "{name}: stopped without a reason, after {driven:.1} m");
    assert!(front > 0.0 && front < 5.0, "{name}: {front:.2} m left to the wall");
}

#[test]
fn stops_before_a_wall_behind_the_parked_car() {
    stops_before_a_wall("parked_car", Pose::new(90.0, 0.0, 0.0));
}

#[test]
fn stops_before_a_wall_beside_the_parked_car() {
    stops_before_a_wall("parked_car", Pose::new(60.0, 0.0, 0.0));
}

#[test]
fn stops_before_a_wall_on_the_empty_road() {
    stops_before_a_wall("straight_100m", Pose::new(80.0, 0.0, 0.0));
}

#[test]
fn stops_before_a_wall_in_place_of_the_slow_lead() {
    let mut scenario = bundled("slow_lead");
    scenario.obstacles.clear();
    scenario.obstacles.push(standing(Pose::new(70.0, 0.0, 0.0), 1.0, 16.0));
    let run = driven(&scenario);
    assert_eq!(run.outcome, Outcome::StoppedSafely, "{:#?}", failures(&run));
    assert!(run.verdict.pass(), "{:#?}", failures(&run));
}

/// Without obstacles the goal is reached.
fn reaches_its_goal_when_empty(name: &str) {
    let mut scenario = bundled(name);
    scenario.obstacles.clear();
    let run = driven(&scenario);
    assert_eq!(run.outcome, Outcome::GoalReached, "{name}: {:#?}", failures(&run));
    assert!(run.verdict.pass(), "{name}: {:#?}", failures(&run));
}

#[test]
fn reaches_the_goal_without_the_building_site() {
    reaches_its_goal_when_empty("lane_blocked");
}

#[test]
fn reaches_the_goal_without_the_braking_lead() {
    reaches_its_goal_when_empty("lead_brakes_hard");
}

#[test]
fn traffic_costs_time() {
    for name in ["slow_lead", "pedestrian"] {
        let with = bundled(name);
        let mut without = with.clone();
        without.obstacles.clear();
        let last = |run: &Run| run.log.samples[run.log.samples.len() - 1].time;
        let (with, without) = (last(&driven(&with)), last(&driven(&without)));
        assert!(with > without + 1.0, "{name}: {with:.1} s with traffic, {without:.1} s without");
    }
}

#[test]
fn a_goal_missed_in_time_fails() {
    let mut scenario = bundled("straight_100m");
    scenario.problems[0].goals[0].time.max = 3.0;
    let run = driven(&scenario);
    assert_eq!(run.outcome, Outcome::TimedOut);
    let failed: Vec<_> = run.verdict.failures().map(|c| c.name).collect();
    assert_eq!(failed, ["goal"]);
}

#[test]
fn a_start_inside_a_wall_is_a_collision_with_its_reason() {
    let mut scenario = bundled("straight_100m");
    scenario.obstacles.push(standing(scenario.problems[0].initial.centre, 1.0, 1.0));
    let run = driven(&scenario);
    assert_eq!((run.outcome, run.reason), (Outcome::Collision, Some("start_in_collision")));
    assert!(run.verdict.failures().any(|c| c.name == "no_contact"));
}

// ---- Verdict and simulation do not use the planner's knowledge: the same drive in another scenario.

fn judged(run: &Run, scenario: &Scenario) -> Vec<&'static str> {
    let settings = verdict::Settings::expecting(Expectation::Goal);
    let defaults = Settings::default();
    let planned_for = defaults.planned_for();
    let verdict = verdict::judge(scenario, run.problem, run.vehicle, (&run.cycles, planned_for), &run.log, &settings);
    verdict.failures().map(|c| c.name).collect()
}

#[test]
fn the_verdict_detects_an_obstacle_added_on_the_driven_path() {
    let scenario = bundled("s_curve");
    let run = driven(&scenario);
    assert_eq!(judged(&run, &scenario), [""; 0], "the unchanged scenario fails");
    let middle = VEHICLE.centre_of_rear_axle(&run.log.samples[run.log.samples.len() / 2].pose);
    let mut on_the_path = scenario.clone();
    on_the_path.obstacles.push(standing(middle, 0.3, 0.3));
    assert_eq!(judged(&run, &on_the_path), ["no_contact", "claims_margin"]);
    let beside = |gap: f64| {
        let mut beside = scenario.clone();
        let to_the_left = Point::new(0.0, 0.5 * VEHICLE.width + 0.15 + gap);
        let left = Pose { position: middle.to_world(to_the_left), yaw: middle.yaw };
        beside.obstacles.push(standing(left, 0.3, 0.3));
        judged(&run, &beside)
    };
    assert_eq!(beside(0.12), ["claims_margin"], "0.12 m beside the footprint is no contact");
    assert_eq!(beside(0.3), [""; 0], "plans keep 0.2 m");
}

#[test]
fn the_verdict_detects_a_removed_lanelet() {
    let scenario = bundled("parked_car");
    let run = driven(&scenario);
    let mut narrower = scenario.clone();
    narrower.network.lanelets.remove(&2); // the left lane, which the path around the car uses
    let failed = judged(&run, &narrower);
    assert!(failed.contains(&"stays_on_road"), "{failed:?}");
}

/// Follows the same plans in a simulation with other obstacles.
fn replayed(run: &Run, obstacles: &[stopline::map::Obstacle]) -> Log {
    let s = &run.log.samples[0];
    let initial = State {
        time: s.time,
        pose: s.pose,
        speed: s.speed,
        lateral_speed: 0.0,
        acceleration: run.problem.initial.acceleration,
        yaw_rate: s.yaw_rate,
        steering: s.steering,
    };
    let mut world = World::new(&VEHICLE, obstacles, &initial, &simulation::Settings::default()).unwrap();
    let mut log = Log::default();
    for (cycle, next) in run.cycles.iter().zip(run.cycles.iter().skip(1)) {
        world.follow(&cycle.plan.trajectory, next.plan.time, &mut log);
    }
    log
}

#[test]
fn the_simulation_reports_the_contact_of_a_plan_without_obstacles() {
    let mut scenario = bundled("parked_car");
    let parked = std::mem::take(&mut scenario.obstacles);
    let run = driven(&scenario); // in the middle of the lane, through the place of the car
    let free = replayed(&run, &[]);
    assert_eq!(free.contact, None);
    assert_eq!(free.samples[..], run.log.samples[..free.samples.len()], "the replay differs from the drive");
    let contact = replayed(&run, &parked).contact.expect("no contact with the parked car");
    let Motion::Static(at) = &parked[0].motion else { panic!("a parked car that moves") };
    assert_eq!(contact.with, Touched::Obstacle(parked[0].id));
    let front = VEHICLE.front_overhang_from_rear_axle();
    assert!((contact.at_rear_axle_frame.x - front).abs() < 0.1, "{contact:?} is not at the front, {front}");
    let there = free.samples.iter().find(|s| s.time >= contact.time).unwrap();
    let bumper = there.pose.to_world(Point::new(front, 0.0)).x;
    assert!((bumper - (at.position.x - 2.25)).abs() < 0.2, "touched with the bumper at {bumper}");
    let aside = standing(Pose::new(60.0, 1.75 + 0.5, 0.0), 4.5, 1.8);
    assert_eq!(aside.id, ADDED);
    assert_eq!(replayed(&run, &[aside]).contact, None, "touched a car in the other lane");
}

/// Refinement reduces the driven curvature, and gains clearance to an obstacle where lattice paths, whose offsets are discrete, pass
/// much closer than desired.
#[test]
fn refined_plans_are_proven_reduce_curvature_and_gain_clearance() {
    let (refined, plain) = refined_and_plain(&bundled("turn_90"));
    assert!(refined.bending < plain.bending, "{refined:?} {plain:?}");
    let moved = [-0.1, 0.1, 0.5].map(|aside| {
        let mut scenario = bundled("parked_car");
        let Motion::Static(car) = &mut scenario.obstacles[0].motion else { unreachable!("it is parked") };
        car.position.y += aside;
        refined_and_plain(&scenario)
    });
    for (refined, plain) in &moved {
        println!("{refined:?}, without refinement {plain:?}");
        assert!(refined.bending < 0.8 * plain.bending, "{refined:?} {plain:?}");
    }
    // a clearance of 0.8 m is desired
    let mut close = moved.iter().filter(|(_, plain)| plain.clearance < 0.5).peekable();
    assert!(close.peek().is_some(), "{moved:?}");
    assert!(close.all(|(refined, plain)| refined.clearance > plain.clearance + 0.05), "{moved:?}");
}

/// What a run drove.
#[derive(Debug)]
struct Driven {
    /// ∫κ² ds of the driven path, from the steering angle, 1/m.
    bending: f64,
    /// Smallest distance to obstacles, m; infinite without one.
    clearance: f64,
}

/// A run with refinement, whose refined plans all have a proof, and one without.
fn refined_and_plain(scenario: &Scenario) -> (Driven, Driven) {
    let with = |enabled| {
        let mut settings = Settings::default();
        settings.planner.refinement.enabled = enabled;
        drive(scenario, &scenario.problems[0], &VEHICLE, &settings, &mut |_, _| {}).unwrap()
    };
    let (refined, plain) = (with(true), with(false));
    assert!(plain.cycles.iter().all(|c| !c.trace.is_refined));
    let drives_on = |c: &&Cycle| matches!(c.plan.decision, Decision::NewPlan | Decision::Continue);
    let count = refined.cycles.iter().filter(|c| c.trace.is_refined).filter(drives_on).count();
    assert!(count > 10, "{}: only {count} cycles are refined", scenario.id);
    for cycle in refined.cycles.iter().filter(|c| c.trace.is_refined) {
        assert_ne!(cycle.plan.decision, Decision::Unproven);
        assert!(cycle.plan.trajectory.profile.ends_at_standstill());
        assert!(cycle.plan.trajectory.profile.last().station <= cycle.plan.trajectory.path.length());
    }
    assert!(refined.verdict.pass(), "{:#?}", failures(&refined));
    let curvature = |s: &Sample| s.steering.tan() / VEHICLE.wheelbase;
    let driven = |run: &Run| {
        let samples = run.log.samples.windows(2);
        let metrics = verdict::metrics(scenario, &VEHICLE, &run.cycles, &run.log, &verdict::Settings::default());
        Driven {
            bending: samples.map(|w| curvature(&w[0]).powi(2) * (w[1].pose.position - w[0].pose.position).norm()).sum(),
            clearance: metrics.min_clearance_m.unwrap_or(f64::INFINITY),
        }
    };
    (driven(&refined), driven(&plain))
}
