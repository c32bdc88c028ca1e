//! The road is where cars may drive, for planner and verdict alike; no proof leaves it.

use std::f64::consts::FRAC_PI_2;

use stopline::drive::Outcome;
use stopline::fixtures::{goal, lanelet, line, network, parked, problem, scenario, straight_lanelet};
use stopline::geometry::{Point, Pose};
use stopline::map::{Interval, Lanelet, RoadNetwork, Scenario};
use stopline::vehicle::load;
use stopline::verdict::Status;

use crate::common::VEHICLE;
use crate::scenes::{START, broken_claims, check, driven, driven_until, in_front, lanes, scene, unproven};

/// A parked car leaves too little of the lane; beside it lies something that is no road, to the left or to the right.
#[test]
fn nothing_passes_over_what_is_no_road() {
    for (types, is_road) in [
        ("sidewalk", false),
        ("bicycleLane", false),
        ("crosswalk", false),
        ("border", false),
        ("parking", false),
        ("urban", true),
    ] {
        for side in [-1.0_f64, 1.0] {
            let mut network = lanes(3.5, false);
            let (from, to) = (side * 1.75, side * 5.25);
            let beside =
                Lanelet { types: vec![types.into()], ..straight_lanelet(2, (0.0, 300.0), from.min(to), from.max(to)) };
            network.lanelets.insert(2, beside);
            let scenario = scene(network, 8.0, vec![in_front(&VEHICLE, 30.0, 0.0, 3.4)]);
            let run = driven(&scenario, &VEHICLE);
            let case = format!("{types} on side {side}");
            assert_eq!(broken_claims(&run, &case), [""; 0]);
            assert_eq!(check(&run, "stays_on_road").status, Status::Pass, "{case}");
            let expected = if is_road { Outcome::GoalReached } else { Outcome::StoppedSafely };
            assert_eq!((run.outcome, unproven(&run)), (expected, 0), "{case}");
        }
    }
}

/// A lane that turns left (or right) by 90 degrees, between straights, with something of 1.4 m on both sides. Its goal asks for a stop.
fn bend(radius: f64, side: f64, types: &str) -> Scenario {
    const BEFORE: f64 = 35.0;
    const AFTER: f64 = 45.0;
    let at = |s: f64, offset: f64| {
        let turned = ((s - BEFORE) / radius).clamp(0.0, FRAC_PI_2);
        let pose =
            Pose::new(BEFORE.min(s) + radius * turned.sin(), side * radius * (1.0 - turned.cos()), side * turned);
        let beyond = (s - BEFORE - radius * FRAC_PI_2).max(0.0);
        pose.advanced(beyond).to_world(Point::new(0.0, offset))
    };
    let length = BEFORE + radius * FRAC_PI_2 + AFTER;
    let bound = |offset: f64| {
        let count = (length / 0.5) as usize;
        let points = (0..=count).map(|i| at(length * i as f64 / count as f64, offset));
        line(&points.map(|p| (p.x, p.y)).collect::<Vec<_>>())
    };
    let strip = |id, right: f64, left: f64, types: &str| Lanelet {
        types: vec![types.into()],
        ..lanelet(id, bound(right), bound(left))
    };
    let road = network([strip(1, -1.75, 1.75, "urban"), strip(2, 1.75, 3.15, types), strip(3, -3.15, -1.75, types)]);
    let (a, b) = (at(length - 16.0, 0.0), at(length - 15.0, 0.0));
    let mut end = goal(Pose::new(b.x, b.y, (b - a).y.atan2((b - a).x)), 8.0, 3.5, 60.0);
    end.speed = Some(Interval { min: 0.0, max: 0.5 });
    Scenario { problems: vec![problem(Pose::new(10.0, 0.0, 0.0), 7.0, end)], ..scenario(road, Vec::new()) }
}

/// An empty bend is no reason to cut it over the sidewalk.
#[test]
fn bends_are_not_cut_over_a_sidewalk() {
    for (radius, side) in [6.0, 8.0, 10.0].into_iter().flat_map(|r| [-1.0, 1.0].map(|s| (r, s))) {
        let scenario = bend(radius, side, if side > 0.0 { "sidewalk" } else { "border" });
        let run = driven(&scenario, &VEHICLE);
        let case = format!("{radius} m, side {side}");
        assert_eq!(broken_claims(&run, &case), [""; 0]);
        assert_eq!(check(&run, "stays_on_road").status, Status::Pass, "{case}");
        assert_eq!((run.outcome, unproven(&run)), (Outcome::GoalReached, 0), "{case}");
    }
}

/// One wild point of a bound, inside or far outside of the lane, on either side: planner and verdict see the same road. Beside it a car
/// leaves 3 m: enough to pass without the wild point, not with one 1.4 m inside.
#[test]
fn a_wild_point_of_a_bound_is_the_same_road_for_planner_and_verdict() {
    for (side, out) in [-1.0, 1.0].into_iter().flat_map(|s| [0.0, -1.4, 1.0, 4.0].map(|o| (s, o))) {
        let bound = |of: f64| {
            let wild = |i: i32| if i == 35 && of == side { of * (2.5 + out) } else { of * 2.5 };
            line(&(0..=150).map(|i| (2.0 * f64::from(i), wild(i))).collect::<Vec<_>>())
        };
        let road = network([lanelet(1, bound(-1.0), bound(1.0))]);
        let car = parked(7, Pose::new(70.0, side * -1.4, 0.0), 4.5, 1.8);
        let scenario = scene(road, 8.0, vec![car]);
        let run = driven_until(&scenario, &VEHICLE, 1.0, 9.0);
        let case = format!("{out} m out on side {side}");
        assert_eq!(broken_claims(&run, &case), [""; 0]);
        assert_eq!(check(&run, "stays_on_road").status, Status::Pass, "{case}");
        assert_eq!(unproven(&run), 0, "{case}");
        let is_past = run.log.samples[run.log.samples.len() - 1].pose.position.x > 75.0;
        assert_eq!(is_past, out >= 0.0, "{case}");
    }
}

/// How far the vehicle is beyond the edge of a straight lane, on its worst side, m.
fn beyond(pose: &Pose, half_lane: f64) -> f64 {
    let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
    let centre = VEHICLE.centre_of_rear_axle(pose);
    let of =
        |(x, y): (f64, f64)| centre.to_world(Point::new(0.5 * x * VEHICLE.length, 0.5 * y * VEHICLE.width)).y.abs();
    corners.map(of).into_iter().fold(0.0, f64::max) - half_lane
}

/// Starts partly off the road by a depth (m), turned outwards by a yaw (rad), on one side.
fn off_road(depth: f64, yaw: f64, side: f64) -> Scenario {
    let mut scenario = scene(lanes(3.5, false), 8.0, Vec::new());
    let initial = &mut scenario.problems[0].initial.centre;
    let reach = 0.5 * VEHICLE.width * yaw.cos() + 0.5 * VEHICLE.length * yaw.abs().sin();
    (initial.position.y, initial.yaw) = (side * (1.75 + depth - reach), side * yaw);
    scenario
}

/// What the start imposes shrinks: no proof leads farther off the road, on neither side, and a vehicle that does not point outwards
/// returns.
#[test]
fn a_start_off_the_road_leads_no_farther_off_it() {
    let mut wrong = Vec::new();
    for (depth, yaw) in [0.05, 0.4, 0.8].into_iter().flat_map(|d| [-0.08_f64, 0.0, 0.02].map(|y| (d, y))) {
        let mut ends = Vec::new();
        for side in [-1.0, 1.0] {
            let scenario = off_road(depth, yaw, side);
            let run = driven_until(&scenario, &VEHICLE, 1.0, 5.0);
            let case = format!("{depth} m off, {yaw} rad, side {side}");
            // from the first proof on: before it, braking without one may go on outwards
            let first = run.cycles.iter().find(|c| c.plan.level.is_proven()).map_or(f64::INFINITY, |c| c.plan.time);
            let since = run.log.samples.iter().filter(|s| s.time >= first).map(|s| beyond(&s.pose, 1.75));
            let offs: Vec<f64> = since.collect();
            let farthest = offs.iter().copied().fold(0.0, f64::max);
            if offs.first().is_some_and(|begins| farthest > begins + 0.05) {
                wrong.push(format!("{case}: {:.3} m off at the first proof, {farthest:.3} m after it", offs[0]));
            }
            if yaw <= 0.0 && unproven(&run) > 0 {
                wrong.push(format!("{case}: {}", run.cycles[0].summary()));
            }
            let last = run.log.samples[run.log.samples.len() - 1];
            if yaw <= 0.0 && beyond(&last.pose, 1.75) > 0.0 {
                wrong.push(format!("{case}: not back on the road"));
            }
            ends.push((side * last.pose.position.y, last.pose.position.x));
        }
        let apart = (ends[0].0 - ends[1].0).abs().max((ends[0].1 - ends[1].1).abs());
        if apart > 1e-3 {
            wrong.push(format!("{depth} m off, {yaw} rad: the sides end {apart} m apart"));
        }
    }
    assert_eq!(wrong, [""; 0]);
}

/// Less off the road is not worse: at any speed, a start parallel to the road leads back to it with a proof in each cycle, though the rear
/// swings out.
#[test]
fn a_start_a_little_off_the_road_leads_back_to_it() {
    let mut wrong = Vec::new();
    for (depth, speed) in [0.005, 0.01, 0.03, 0.05, 0.07, 0.1].into_iter().flat_map(|d| [0.0, 3.0, 8.0].map(|v| (d, v)))
    {
        for side in [-1.0, 1.0] {
            let mut scenario = off_road(depth, 0.0, side);
            scenario.problems[0].initial.speed = speed;
            let run = driven_until(&scenario, &VEHICLE, 1.0, 6.0);
            let case = format!("{depth} m off, {speed} m/s, side {side}");
            if unproven(&run) > 0 {
                wrong.push(format!("{case}: {}", run.cycles[0].summary()));
            }
            let offs: Vec<f64> = run.log.samples.iter().map(|s| beyond(&s.pose, 1.75)).collect();
            let farthest = offs.iter().copied().fold(0.0, f64::max);
            if farthest > depth + 0.05 || offs.last().is_none_or(|last| *last > 0.0) {
                wrong.push(format!("{case}: {farthest} m off, or not back"));
            }
        }
    }
    assert_eq!(wrong, [""; 0]);
}

/// What is claimed from there holds, too.
#[test]
fn claims_from_a_start_off_the_road_hold() {
    let mut wrong = Vec::new();
    for (depth, yaw) in [0.05, 0.4, 0.8].into_iter().flat_map(|d| [-0.08, 0.0].map(|y| (d, y))) {
        let scenario = off_road(depth, yaw, 1.0);
        let run = driven_until(&scenario, &VEHICLE, 1.0, 3.0);
        let broken = broken_claims(&run, &format!("{depth} m off, {yaw} rad"));
        // the start itself is off the road
        wrong.extend(broken.into_iter().filter(|b| !b.contains("stays_on_road")));
    }
    assert_eq!(wrong, [""; 0]);
}

/// A lane of a width (m).
fn narrow(width: f64) -> RoadNetwork {
    network([straight_lanelet(1, (0.0, 300.0), -0.5 * width, 0.5 * width)])
}

/// A vehicle that is wider than its lane leaves it no farther than it must, before a site that blocks it as well.
#[test]
fn a_vehicle_wider_than_its_lane_stays_in_its_middle() {
    let truck = load("truck").unwrap();
    for (vehicle, speed) in [(&*VEHICLE, 8.0), (&truck, 6.0)] {
        for less in [0.02, 0.05, 0.08] {
            let site = in_front(vehicle, 35.0, 0.0, vehicle.width);
            let scenario = scene(narrow(vehicle.width - less), speed, vec![site]);
            let run = driven(&scenario, vehicle);
            let case = format!("{}, {less} m wider", vehicle.name);
            assert_ne!(check(&run, "stays_on_road").status, Status::Fail, "{case}");
            assert_eq!(run.outcome, Outcome::StoppedSafely, "{case}");
            let aside = run.log.samples.iter().map(|s| s.pose.position.y.abs()).fold(0.0, f64::max);
            assert!(aside < 0.06, "{case}: {aside} m aside");
            assert_ne!(check(&run, "fallback_stops").status, Status::Fail, "{case}");
        }
    }
}

/// It claims no margin to the edges that it does not have.
#[test]
fn a_vehicle_wider_than_its_lane_claims_no_margin_to_its_edges() {
    let mut wrong = Vec::new();
    for less in [0.02, 0.05, 0.08] {
        let site = in_front(&VEHICLE, 35.0, 0.0, VEHICLE.width);
        let scenario = scene(narrow(VEHICLE.width - less), 8.0, vec![site]);
        let run = driven(&scenario, &VEHICLE);
        wrong.extend(broken_claims(&run, &format!("{less} m wider")));
    }
    assert_eq!(wrong, [""; 0]);
}

/// The start of these scenes is on the lane.
#[test]
fn the_scenes_start_where_they_say() {
    let scenario = bend(8.0, 1.0, "sidewalk");
    assert!(scenario.network.lanelets[&1].contains(scenario.problems[0].initial.centre.position));
    assert!(
        (beyond(&VEHICLE.rear_axle_of_centre(&Pose::new(START, 1.0, 0.0)), 1.75) - (1.0 + 0.5 * VEHICLE.width - 1.75))
            .abs()
            < 1e-9
    );
}
