//! Other traffic, junctions and goals: what is proven for them holds, and a missed goal is not hidden.

use std::f64::consts::PI;

use stopline::drive::{Outcome, Run, Settings, drive};
use stopline::fixtures::{driving, follow, network, obstacle, parked, straight_lanelet};
use stopline::geometry::Pose;
use stopline::map::{
    Goal, GoalPosition, Interval, Motion, Neighbour, Obstacle, ObstacleKind, Part, RoadNetwork, Scenario, Shape,
    TimedPose,
};
use stopline::planner::Plan;
use stopline::verdict::Status;

use crate::common::VEHICLE;
use crate::scenes::{START, broken_claims, check, driven, driven_until, in_front, lanes, scene, unproven};

/// Smallest clearance of a run, m.
fn clearance(run: &Run) -> f64 {
    let settings = stopline::verdict::Settings::default();
    let metrics = stopline::verdict::metrics(run.scenario, run.vehicle, &run.cycles, &run.log, &settings);
    metrics.min_clearance_m.unwrap()
}

/// A lane of 3.5 m with an oncoming one to its left.
fn with_oncoming_lane() -> RoadNetwork {
    let mut lane = straight_lanelet(1, (0.0, 300.0), -1.75, 1.75);
    let mut oncoming = straight_lanelet(2, (0.0, 300.0), 1.75, 5.25);
    (oncoming.left, oncoming.right) = (oncoming.right.reversed(), oncoming.left.reversed());
    oncoming.centre = oncoming.centre.reversed();
    lane.adjacent_left = Some(Neighbour { id: 2, same_direction: false });
    oncoming.adjacent_left = Some(Neighbour { id: 1, same_direction: false });
    network([lane, oncoming])
}

/// A truck of 2.5 m takes a part of the lane: the plan that keeps margins moves aside and is never given up for one without. It passes with
/// a clearance and does not stop in the way of the truck.
#[test]
fn an_oncoming_truck_that_takes_a_part_of_the_lane_is_passed_with_clearance() {
    for (over, speed) in [(0.5, 10.0), (0.9, 10.0), (0.9, 14.0)] {
        let from = Pose::new(START + 210.0, 1.75 + 1.25 - over, PI);
        let truck = Obstacle { shape: Shape::rectangle(12.0, 2.5), ..driving(7, from, speed, 40.0) };
        let scenario = scene(with_oncoming_lane(), 10.0, vec![truck]);
        let run = driven(&scenario, &VEHICLE);
        let case = format!("{over} m, {speed} m/s");
        assert_eq!(broken_claims(&run, &case), [""; 0]);
        assert_eq!((run.outcome, unproven(&run)), (Outcome::GoalReached, 0), "{case}");
        assert!(clearance(&run) > 0.25, "{case}: {} m", clearance(&run));
        let slowest = run.log.samples.iter().map(|s| s.speed).fold(f64::INFINITY, f64::min);
        assert!(slowest > 3.0, "{case}: {slowest} m/s");
        let levels: Vec<_> = run.cycles.iter().map(|c| c.plan.level).collect();
        assert!(levels.windows(2).all(|l| l[1].is_as_safe_as(l[0])), "{case}: {levels:?}");
    }
}

/// A leader that stands at a distance ahead for 3 s and drives off.
fn leader(gap: f64) -> Obstacle {
    let place = Pose::new(START + 0.5 * VEHICLE.length + gap + 2.25, 0.0, 0.0);
    let states = (0..=300).map(|i| {
        let time = 0.1 * f64::from(i);
        let (ramp, rest) = ((time - 3.0).clamp(0.0, 5.0), (time - 8.0).max(0.0));
        TimedPose { time, pose: place.advanced(ramp * ramp + 10.0 * rest), speed: 2.0 * ramp }
    });
    let leader = obstacle(7, Shape::rectangle(4.5, 1.8), Motion::Trajectory(states.collect()));
    Obstacle { kind: ObstacleKind::Vehicle, ..leader }
}

/// Bumper to bumper: it waits without closing in, proven, and follows comfortably.
#[test]
fn a_vehicle_close_behind_a_leader_does_not_close_in() {
    for gap in [0.15, 0.2, 0.3, 0.45, 0.8] {
        let scenario = scene(lanes(3.5, false), 0.0, vec![leader(gap)]);
        let run = driven_until(&scenario, &VEHICLE, 1.0, 20.0);
        let case = format!("{gap} m");
        assert_eq!(broken_claims(&run, &case), [""; 0]);
        assert_eq!(unproven(&run), 0, "{case}");
        assert!(clearance(&run) > gap - 0.02, "{case}: {} m", clearance(&run));
        for name in ["comfort_longitudinal", "comfort_jerk"] {
            assert_ne!(check(&run, name).status, Status::Fail, "{case}: {:?}", check(&run, name));
        }
        let end = run.log.samples[run.log.samples.len() - 1];
        assert!(end.pose.position.x > START + 60.0, "{case}: it follows");
    }
}

/// Goals beside the middle of the lane, on either side, and turned a little: the vehicle drives there and meets them.
#[test]
fn a_goal_beside_the_middle_of_the_lane_is_driven_to() {
    for (beside, turned) in [(0.9, 0.0), (0.6, 0.08), (0.4, 0.0), (0.3, 0.16), (-0.2, 0.2)] {
        let ends = [1.0, -1.0].map(|side| {
            let mut scenario = scene(lanes(4.5, false), 10.0, Vec::new());
            let goal = &mut scenario.problems[0].goals[0];
            let at = Pose::new(START + 100.0, side * beside, side * turned);
            goal.position = Some(GoalPosition::Shapes(Shape::rectangle(4.0, 0.8).moved(&at)));
            goal.yaw = Some(Interval { min: at.yaw - 0.08, max: at.yaw + 0.08 });
            let run = driven(&scenario, &VEHICLE);
            let case = format!("{beside} m, {turned} rad, side {side}");
            assert_eq!(broken_claims(&run, &case), [""; 0]);
            assert_eq!((run.outcome, unproven(&run)), (Outcome::GoalReached, 0), "{case}: {:?}", check(&run, "goal"));
            side * run.log.samples[run.log.samples.len() - 1].pose.position.y
        });
        assert!((ends[0] - ends[1]).abs() < 1e-3, "{beside} m, {turned} rad: {ends:?}");
    }
}

/// A parked car, and a goal in the lane just before it, open for a moment: the vehicle is there in time, and passes the car afterwards. Without a
/// price for missing the goal it is in the other lane by then.
#[test]
fn a_goal_before_a_parked_car_is_met_before_the_car_is_passed() {
    for (ahead, width, opens) in [(44.0, 3.0, 3.0), (48.0, 3.5, 3.4), (60.0, 3.5, 3.8)] {
        let mut scenario = scene(lanes(3.5, true), 12.0, vec![in_front(&VEHICLE, ahead, 0.0, 1.8)]);
        let region = Shape::rectangle(40.0, width).moved(&Pose::new(START + 50.0, 0.0, 0.0));
        let goal = &mut scenario.problems[0].goals[0];
        (goal.position, goal.time) = (Some(GoalPosition::Shapes(region)), Interval { min: opens, max: opens + 0.5 });
        let mut settings = Settings::default();
        let price = settings.planner.lattice.weights.missed_target;
        for (price, outcome) in [(price, Outcome::GoalReached), (0.0, Outcome::TimedOut)] {
            settings.planner.lattice.weights.missed_target = price;
            let run = drive(&scenario, &scenario.problems[0], &VEHICLE, &settings, &mut |_, _| {}).unwrap();
            let case = format!("{ahead} m, at a price of {price}");
            assert_eq!(broken_claims(&run, &case), [""; 0]);
            assert_eq!((run.outcome, unproven(&run)), (outcome, 0), "{case}: {:?}", check(&run, "goal"));
        }
    }
}

/// The window of the goal closes soon: the vehicle drives faster than its cruise speed, if that is enough, and not for a goal that it
/// cannot reach in time.
#[test]
fn a_goal_whose_window_closes_soon_is_hurried_for() {
    let cruise = stopline::planner::Settings::default().cruise_speed;
    // 167 m to the goal, 12.0 s at the cruise speed
    for (closes, in_time, fastest) in [(13.5, true, cruise), (11.4, true, 1.15 * cruise), (6.0, false, cruise)] {
        let mut scenario = scene(lanes(3.5, false), cruise, Vec::new());
        scenario.problems[0].goals[0].time = Interval { min: 0.0, max: closes };
        scenario.network.lanelets.values_mut().for_each(|lanelet| lanelet.speed_limit = None);
        let run = driven(&scenario, &VEHICLE);
        let case = format!("{closes} s");
        assert_eq!(broken_claims(&run, &case), [""; 0]);
        assert_eq!(run.outcome == Outcome::GoalReached, in_time, "{case}: {:?}", check(&run, "goal"));
        let top = run.log.samples.iter().map(|s| s.speed).fold(0.0, f64::max);
        assert!(top < fastest + 0.2, "{case}: {top} m/s");
        assert_eq!(unproven(&run), 0, "{case}");
    }
}

/// A follower that does not brake leaves no stop that could be proven; one that brakes does. Full braking would be answered by a contact from behind: the
/// vehicle goes on with the traffic, and brakes with the leader.
#[test]
fn a_vehicle_without_a_proof_goes_on_with_dense_traffic() {
    for (ahead, behind, speed, braking) in [(8.0, 4.0, 15.0, 0.0), (12.0, 3.0, 12.0, 0.0), (10.0, 5.0, 15.0, 1.0)] {
        let (car, half) = (4.5, 0.5 * VEHICLE.length);
        let moving = |id: i64, x: f64, braking: f64| {
            let states = (0..=100).map(|i| {
                let time = 0.1 * f64::from(i);
                let driven = time * (speed - 0.5 * braking * time);
                TimedPose { time, pose: Pose::new(x + driven, 0.0, 0.0), speed: speed - braking * time }
            });
            let moving = obstacle(id, Shape::rectangle(car, 1.8), Motion::Trajectory(states.collect()));
            Obstacle { kind: ObstacleKind::Vehicle, ..moving }
        };
        let leader = moving(7, START + half + ahead + 0.5 * car, braking);
        let follower = moving(8, START - half - behind - 0.5 * car, braking);
        let scenario = scene(lanes(3.5, false), speed, vec![leader, follower]);
        let run = driven_until(&scenario, &VEHICLE, 1.0, 5.0);
        let case = format!("{ahead} m, {behind} m, {speed} m/s, {braking} m/s²");
        assert!(braking > 0.0 || unproven(&run) > 10, "{case}: no case of a follower that does not brake");
        assert_ne!(run.outcome, Outcome::Collision, "{case}: {:?}", check(&run, "no_contact"));
    }
}

/// The prediction of a standing car ends before the vehicle is there; nothing says that it has gone. Its place is not driven through while
/// it is assumed to stand there.
#[test]
fn the_place_of_a_car_whose_prediction_ended_is_not_driven_through() {
    for (ends, assumed) in [(1.0, 3.0), (3.0, 3.0), (3.0, 8.0), (0.0, 12.0)] {
        let place = Pose::new(START + 40.0, 0.0, 0.0);
        let states = [0.0, ends].map(|time| TimedPose { time, pose: place, speed: 0.0 });
        let states = if ends > 0.0 { states.to_vec() } else { states[..1].to_vec() };
        let car = obstacle(7, Shape::rectangle(4.5, 1.8), Motion::Trajectory(states));
        let car = Obstacle { kind: ObstacleKind::Vehicle, ..car };
        let scenario = scene(lanes(3.5, false), 10.0, vec![car]);
        let mut settings = Settings::default();
        settings.planner.extrapolation.duration = assumed;
        settings.run.longest = ends + assumed + 4.0;
        let run = drive(&scenario, &scenario.problems[0], &VEHICLE, &settings, &mut |_, _| {}).unwrap();
        let rear = place.position.x - 2.25;
        let front = |x: f64| x + VEHICLE.front_overhang_from_rear_axle();
        let reached = run.log.samples.iter().find(|s| front(s.pose.position.x) >= rear).map(|s| s.time);
        assert!(reached.is_none_or(|t| t > ends + assumed), "{ends} s, {assumed} s: there at {reached:?} s");
        // the run does not end while it waits
        let drives_on = reached.is_some_and(|t| t < ends + assumed + 4.0);
        assert!(drives_on, "{ends} s, {assumed} s: there at {reached:?} s");
    }
}

/// A road with a junction of 14 m at 100 m.
fn junction() -> RoadNetwork {
    let mut inside = straight_lanelet(2, (100.0, 114.0), -1.75, 1.75);
    inside.types = vec!["urban".into(), "intersection".into()];
    let mut road = network([
        straight_lanelet(1, (0.0, 100.0), -1.75, 1.75),
        inside,
        straight_lanelet(3, (114.0, 300.0), -1.75, 1.75),
    ]);
    follow(&mut road, 1, 2);
    follow(&mut road, 2, 3);
    road
}

/// Whether the vehicle reaches into the junction with its rear axle at a place, m.
fn blocks_junction(x: f64) -> bool {
    x + VEHICLE.front_overhang_from_rear_axle() > 100.0 && x < 114.0
}

/// The lane is blocked shortly behind a junction, seen from far: the vehicle stops before the junction.
#[test]
fn a_vehicle_stops_before_a_junction_that_it_cannot_leave() {
    let mut wrong = Vec::new();
    for (behind, speed) in [(3.0, 10.0), (1.5, 10.0), (3.0, 6.0), (4.0, 13.0)] {
        let site = parked(7, Pose::new(114.0 + behind + 1.5, 0.0, 0.0), 3.0, 3.2);
        let scenario = scene(junction(), speed, vec![site]);
        let run = driven(&scenario, &VEHICLE);
        let case = format!("blocked {behind} m behind it, {speed} m/s");
        wrong.extend(broken_claims(&run, &case));
        let end = run.log.samples[run.log.samples.len() - 1].pose.position.x;
        if run.outcome != Outcome::StoppedSafely || blocks_junction(end) {
            wrong.push(format!("{case}: {}, with the rear axle at {end:.1} m", run.outcome.name()));
        }
        for name in ["comfort_longitudinal", "comfort_jerk"] {
            let check = check(&run, name);
            wrong.extend((check.status == Status::Fail).then(|| format!("{case}: {name}: {}", check.note)));
        }
    }
    assert_eq!(wrong, [""; 0]);
}

/// How long the rear axle is in the junction on a plan, s.
fn in_junction(plan: &Plan) -> f64 {
    /// Between two looks, s.
    const STEP: f64 = 0.1;
    let looks = ((plan.trajectory.end_time() - plan.time) / STEP) as usize;
    let places = (0..=looks).map(|i| plan.trajectory.at(plan.time + STEP * i as f64).pose.position.x);
    STEP * places.filter(|x| (100.5..113.0).contains(x)).count() as f64
}

/// Cars cross a junction one after the other: a plan that enters the junction leaves it within seconds, and none creeps through it.
#[test]
fn no_fallback_creeps_through_a_junction() {
    /// From a standstill, 13 m take 4 s with the comfortable acceleration; to let a car pass inside takes some more, s.
    const MOST: f64 = 15.0;
    let mut wrong = Vec::new();
    for (gap, speed) in [(22.0, 9.0), (30.0, 8.0), (45.0, 8.0)] {
        // from both sides, until the vehicle has passed
        let crossing = |i: i64| {
            let side = if i % 2 == 0 { 1.0 } else { -1.0 };
            let from = Pose::new(107.0 + 2.0 * side, -side * (20.0 + gap * i as f64), side * 0.5 * PI);
            driving(10 + i, from, speed, 60.0)
        };
        let mut road = junction();
        // the crossing road
        let cross = straight_lanelet(4, (-300.0, 300.0), -1.75, 1.75);
        let turned = |line: &stopline::geometry::polyline::Polyline, y: f64| {
            let points: Vec<_> = line.points().iter().map(|p| (107.0 - p.y + y, p.x)).collect();
            stopline::fixtures::line(&points)
        };
        for (id, x) in [(4, 2.0), (5, -2.0)] {
            road.lanelets.insert(id, stopline::fixtures::lanelet(id, turned(&cross.right, x), turned(&cross.left, x)));
        }
        let mut scenario = scene(road, 8.0, (0..8).map(crossing).collect());
        scenario.problems[0].initial.centre.position.x = 40.0;
        let run = driven_until(&scenario, &VEHICLE, 1.0, 40.0);
        let case = format!("a car each {gap} m at {speed} m/s");
        wrong.extend(broken_claims(&run, &case));
        for plan in run.cycles.iter().map(|c| &c.plan) {
            let takes = in_junction(plan);
            if takes > MOST {
                let end = plan.trajectory.path.at(plan.trajectory.profile.last().station).pose.position.x;
                wrong.push(format!(
                    "{case}: the plan of {:.1} s takes {takes:.1} s to leave it and ends at {end:.1} m",
                    plan.time
                ));
            }
        }
        let longest = run.cycles.iter().map(|c| in_junction(&c.plan)).fold(0.0, f64::max);
        println!("{case}: {}, at most {longest:.1} s in the junction, {} unproven", run.outcome.name(), unproven(&run));
    }
    assert_eq!(wrong, [""; 0]);
}

/// The goal is on the lane beside, and a car drives there at the same speed: the vehicle changes lanes before or behind it. If it misses the
/// goal, the run fails.
#[test]
fn a_lane_change_beside_a_car_of_equal_speed_reaches_the_goal_or_fails_it() {
    let mut reached = 0;
    for (speed, ahead) in [(8.0, -3.0), (8.0, 2.0), (12.0, 0.0)] {
        let car = driving(7, Pose::new(START + ahead, 3.5, 0.0), speed, 60.0);
        let mut scenario = scene(lanes(3.5, true), speed, vec![car]);
        scenario.problems[0].goals = vec![goal_on_the_left(130.0)];
        let run = driven_until(&scenario, &VEHICLE, 1.0, 20.0);
        let case = format!("{speed} m/s, {ahead} m ahead");
        assert_eq!(broken_claims(&run, &case), [""; 0]);
        assert_eq!(check(&run, "no_contact").status, Status::Pass, "{case}");
        let is_reached = run.outcome == Outcome::GoalReached;
        assert_eq!(check(&run, "goal").status == Status::Pass, is_reached, "{case}");
        assert!(is_reached || check(&run, "goal").status == Status::Fail, "{case}: {:?}", check(&run, "goal"));
        reached += usize::from(is_reached);
    }
    assert!(reached >= 2, "{reached} goals");
}

fn goal_on_the_left(ahead: f64) -> Goal {
    let centre = Pose::new(START + ahead, 3.5, 0.0);
    let region = Shape { parts: vec![Part::Rectangle { centre, length: 10.0, width: 3.0 }] };
    let time = Interval { min: 0.0, max: 60.0 };
    Goal { position: Some(GoalPosition::Shapes(region)), time, speed: None, yaw: None }
}

/// A goal that lies behind the start, or beside the only lane, cannot be reached: the run ends at the end of the road and fails `goal`.
#[test]
fn a_goal_that_cannot_be_reached_forwards_is_failed() {
    for (ahead, y) in [(-6.0, 0.0), (-12.0, 0.0), (60.0, 1.6)] {
        let mut scenario: Scenario = scene(lanes(3.5, false), 5.0, Vec::new());
        let centre = Pose::new(START + ahead, y, 0.0);
        let region =
            Shape { parts: vec![Part::Rectangle { centre, length: 6.0, width: if y == 0.0 { 3.5 } else { 0.2 } }] };
        scenario.problems[0].goals[0].position = Some(GoalPosition::Shapes(region));
        let run = driven(&scenario, &VEHICLE);
        assert_eq!(run.outcome, Outcome::StoppedSafely, "{ahead} m");
        assert_eq!(run.verdict.failures().map(|c| c.name).collect::<Vec<_>>(), ["goal"], "{ahead} m");
    }
}
