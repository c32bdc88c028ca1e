//! Stops that brakes and tyres give, and no harder than needed.

use stopline::drive::Outcome;
use stopline::fixtures::parked;
use stopline::geometry::Pose;
use stopline::planner::Rejection;
use stopline::vehicle::{CONTROL_SHARE, GRAVITY, GripUse, ProofLimits, Vehicle, builtin_names, load};

use crate::common::VEHICLE;
use crate::scenes::{
    START, before_a_wall, broken_claims, driven, driven_until, hardest_braking, hardest_stop, in_front, lanes, scene,
    unproven,
};

/// Its brakes give 7 m/s² after a lag of 0.2 s; proofs use 85 % of it, and keep the tube of full use of the grip before the wall. A
/// stop that is possible is found, and a shorter one is never claimed.
#[test]
fn a_truck_stops_where_its_brakes_suffice_and_claims_nothing_where_they_do_not() {
    let truck = load("truck").unwrap();
    let all = GripUse { total: 1.0, turning: 0.0, curvature: 0.0 };
    let possible = hardest_stop(&truck, 15.0, 1.0) + truck.tracking_margins(&all).longitudinal;
    let (mut found, mut wrong) = (0, Vec::new());
    for distance in 16..=30 {
        let distance = f64::from(distance);
        let scenario = before_a_wall(&truck, 15.0, distance);
        let run = driven(&scenario, &truck);
        wrong.extend(broken_claims(&run, &format!("{distance} m")));
        let is_proven = unproven(&run) == 0;
        // half a metre: a cell of the collision checks
        assert!(
            is_proven || distance < possible + 0.5,
            "{distance} m: {possible} suffice, {}",
            run.cycles[0].summary()
        );
        assert!(!is_proven || distance > hardest_stop(&truck, 15.0, 1.0), "{distance} m: {}", run.cycles[0].summary());
        if is_proven {
            assert_eq!(run.outcome, Outcome::StoppedSafely, "{distance} m");
            found += 1;
        }
    }
    assert_eq!(wrong, [""; 0]);
    assert!(found >= 7, "{found} stops are found");
}

/// The vehicle speeds up at its start: its drive takes longer to release than its brakes to come on, and what it gains until then is part of
/// the stop.
#[test]
fn a_stop_from_an_acceleration_brakes_no_harder_than_claimed() {
    let mut wrong = Vec::new();
    for (name, speed) in
        ["bmw_320i", "ford_escort", "truck"].iter().flat_map(|n| [6.0, 10.0, 12.3, 15.0].map(|v| (n, v)))
    {
        let vehicle = load(name).unwrap();
        for acceleration in [1.0, 2.5, 4.0] {
            for share in [2.1, 1.9, 1.7] {
                let distance = speed * speed / (2.0 * share) + 0.25 * speed + 2.3;
                let mut scenario = before_a_wall(&vehicle, speed, distance);
                scenario.problems[0].initial.acceleration = acceleration;
                let run = driven_until(&scenario, &vehicle, 1.0, 1.0);
                wrong.extend(broken_claims(&run, &format!("{name}, {speed} m/s, {acceleration} m/s², {share} m/s²")));
            }
        }
    }
    assert_eq!(wrong, [""; 0]);
}

/// A wall that is a little too close: the vehicle is without a proof until it has nearly stopped. What is left of its speed then is
/// not proven to end in the last centimetres, unless it does.
#[test]
fn the_last_centimetres_before_a_wall_are_no_stop_unless_they_are() {
    let truck = load("truck").unwrap();
    let (mut late, mut wrong) = (0, Vec::new());
    for (friction, speed, from) in [(0.4, 5.0, 5.0), (0.6, 6.0, 4.2), (1.0, 5.0, 2.4)] {
        for i in 0..20 {
            let distance = from + 0.04 * f64::from(i);
            let scenario = before_a_wall(&truck, speed, distance);
            let run = driven_until(&scenario, &truck, friction, 4.0);
            wrong.extend(broken_claims(&run, &format!("friction {friction}, {speed} m/s, {distance:.2} m")));
            late += usize::from(unproven(&run) > 0);
        }
    }
    assert_eq!(wrong, [""; 0]);
    assert!(late > 20, "{late} runs without a proof: the walls are far enough away");
}

/// Every built-in vehicle that brakes for a wall: no plan uses more of grip and brakes together than a proof may.
#[test]
fn no_proven_plan_uses_more_than_grip_and_brakes() {
    let mut wrong = Vec::new();
    for (name, friction) in builtin_names().iter().flat_map(|n| [1.0, 0.15].map(|f| (n, f))) {
        let vehicle = load(name).unwrap();
        let speed = if vehicle.mass < 100.0 { 2.5 } else { 9.0 };
        let limits = ProofLimits::new(&vehicle, friction);
        let grip = CONTROL_SHARE * friction * vehicle.tyres.friction * GRAVITY;
        for (extra, y) in [(0.5, 0.0), (2.0, -0.9)] {
            let distance = hardest_stop(&vehicle, speed, friction) + extra;
            // half of the lane is free
            let wall = in_front(&vehicle, distance, y * vehicle.width, vehicle.width);
            let scenario = scene(lanes(2.6 * vehicle.width, true), speed, vec![wall]);
            let run = driven_until(&scenario, &vehicle, friction, 2.5);
            let case = format!("{name}, friction {friction}, {distance:.1} m");
            wrong.extend(broken_claims(&run, &case));
            for plan in run.cycles.iter().map(|c| &c.plan).filter(|p| p.level.is_proven()) {
                let times = (0..200).map(|i| plan.time + 0.05 * f64::from(i));
                let moving = times.map(|t| plan.trajectory.at(t)).filter(|p| p.speed > 0.1);
                let used = moving.map(|p| p.acceleration.hypot(p.speed * p.speed * p.curvature)).fold(0.0, f64::max);
                if used > 1.02 * grip || plan.deceleration > limits.deceleration() + 0.03 {
                    wrong.push(format!("{case}: {used} of {grip}, claims {}", plan.deceleration));
                }
            }
        }
    }
    assert_eq!(wrong, [""; 0]);
}

/// Friction of ice.
const ICE: f64 = 0.15;

/// Where the road is known to be icy, every plan claims what ice gives, and stops before the wall in every branch.
#[test]
fn proofs_on_ice_hold_at_every_distance() {
    let mut wrong = Vec::new();
    for name in ["bmw_320i", "ford_escort"] {
        let vehicle = load(name).unwrap();
        let grip = ICE * vehicle.tyres.friction * GRAVITY;
        for (speed, share) in [(3.0, 0.6), (3.0, 1.3), (3.0, 2.5), (8.0, 0.6), (8.0, 0.9), (8.0, 1.1), (8.0, 1.8)] {
            let distance = share * hardest_stop(&vehicle, speed, ICE) + 1.0;
            let scenario = before_a_wall(&vehicle, speed, distance);
            let run = driven_until(&scenario, &vehicle, ICE, 20.0);
            let case = format!("{name}, {speed} m/s, {distance:.1} m");
            wrong.extend(broken_claims(&run, &case));
            let proven = run.cycles.iter().map(|c| &c.plan).filter(|p| p.level.is_proven());
            let hardest = proven.map(|p| p.deceleration.max(hardest_braking(p))).fold(0.0, f64::max);
            if hardest >= grip {
                wrong.push(format!("{case}: {hardest} m/s² of {grip} are proven"));
            }
        }
    }
    assert_eq!(wrong, [""; 0]);
}

/// A stop that brakes and tyres give with the reserve of proofs is found on every road: straight ahead it needs no grip to turn.
#[test]
fn a_possible_stop_is_found_on_every_road() {
    let mut wrong = Vec::new();
    for (name, friction) in ["bmw_320i", "ford_escort", "truck"].iter().flat_map(|n| [0.6, ICE].map(|f| (n, f))) {
        let vehicle = load(name).unwrap();
        let margin = vehicle.tracking_margins(&GripUse { total: 1.0, turning: 0.0, curvature: 0.0 }).longitudinal;
        for (speed, share) in [(3.0, 1.1), (8.0, 1.05), (8.0, 1.3)] {
            // half a metre: a cell of the collision checks
            let distance = share * hardest_stop(&vehicle, speed, friction) + margin + 0.5;
            let scenario = before_a_wall(&vehicle, speed, distance);
            let run = driven_until(&scenario, &vehicle, friction, 1.0);
            if unproven(&run) > 0 {
                let why = run.cycles[0].summary();
                wrong.push(format!("{name}, friction {friction}, {speed} m/s, {distance:.1} m: {why}"));
            }
        }
    }
    assert_eq!(wrong, [""; 0]);
}

/// A proof that is found when a vehicle that braked without one has almost stopped holds, too.
#[test]
fn a_proof_at_the_end_of_a_stop_without_one_holds() {
    let mut wrong = Vec::new();
    for (name, friction, speed, distances) in [
        ("truck", ICE, 3.0, [5.6, 6.6]),
        ("truck", ICE, 8.0, [31.2, 33.0]),
        ("truck", 1.0, 4.0, [2.3, 2.4]),
        ("f1tenth", ICE, 2.5, [3.5, 3.6]),
        ("bmw_320i", 1.0, 5.0, [1.8, 2.0]),
        ("bmw_320i", 1.0, 12.0, [9.0, 9.6]),
    ] {
        let vehicle = load(name).unwrap();
        for distance in distances {
            let scenario = before_a_wall(&vehicle, speed, distance);
            let run = driven_until(&scenario, &vehicle, friction, 10.0);
            wrong.extend(broken_claims(&run, &format!("{name}, friction {friction}, {speed} m/s, {distance:.1} m")));
        }
    }
    assert_eq!(wrong, [""; 0]);
}

/// The deceleration that stops before the wall after the lag of the brakes, with the tube of calm driving, m/s².
fn needed(vehicle: &Vehicle, speed: f64, distance: f64) -> f64 {
    let margin = vehicle.tracking_margins(&GripUse::default()).longitudinal;
    speed * speed / (2.0 * (distance - speed * vehicle.actuators.brake_lag - margin))
}

/// An emergency is no reason to brake with all there is.
#[test]
fn a_stop_brakes_about_as_hard_as_needed() {
    let mut wrong = Vec::new();
    for (speed, distance) in [
        (2.0, 1.0),
        (3.0, 1.6),
        (5.0, 3.0),
        (5.0, 4.0),
        (8.0, 6.8),
        (8.0, 9.0),
        (10.0, 12.0),
        (10.0, 15.0),
        (14.0, 25.0),
    ] {
        let scenario = before_a_wall(&VEHICLE, speed, distance);
        let run = driven(&scenario, &VEHICLE);
        let case = format!("{speed} m/s, {distance} m");
        wrong.extend(broken_claims(&run, &case));
        if unproven(&run) > 0 {
            wrong.push(format!("{case}: {}", run.cycles[0].summary()));
        }
        let most = (1.35 * speed * speed / (2.0 * distance)).max(1.15 * needed(&VEHICLE, speed, distance));
        let planned = run.cycles.iter().map(|c| hardest_braking(&c.plan)).fold(0.0, f64::max);
        if planned > most.max(VEHICLE.comfort.aggressive_deceleration) {
            wrong.push(format!("{case}: plans brake with up to {planned:.2} m/s² where {most:.2} suffice"));
        }
    }
    assert_eq!(wrong, [""; 0]);
}

/// An emergency stop needs a wider tube than the margins of its level, which are those of calm driving: it is planned once more with
/// the margins that it needs, and is not given up.
#[test]
fn a_plan_that_needs_a_wider_tube_is_tried_with_it() {
    let least = VEHICLE.tracking_margins(&GripUse::default());
    let (mut wider, mut wrong) = (0, Vec::new());
    for (speed, extra) in [8.0, 12.0, 16.0].into_iter().flat_map(|v| [0.7, 0.9, 1.1, 1.3].map(|e| (v, e))) {
        let distance = hardest_stop(&VEHICLE, speed, 1.0) + extra;
        let scenario = before_a_wall(&VEHICLE, speed, distance);
        let run = driven(&scenario, &VEHICLE);
        let case = format!("{speed} m/s, {distance:.2} m");
        wrong.extend(broken_claims(&run, &case));
        let first = &run.cycles[0];
        let blocked = first.trace.rejections(Rejection::TubeBlocked);
        if !first.plan.level.is_proven() || blocked > 0 {
            wrong.push(format!("{case}: {blocked} blocked tubes, {}", first.summary()));
            continue;
        }
        let own = VEHICLE.tracking_margins(&VEHICLE.drivable(1.0, &first.plan.trajectory).unwrap());
        let end = first.plan.trajectory.profile.last().station;
        let standstill = first.plan.trajectory.path.at(end).pose.position.x + VEHICLE.front_overhang_from_rear_axle();
        let gap = START + 0.5 * VEHICLE.length + distance - standstill;
        if gap < own.longitudinal - 2e-3 {
            wrong.push(format!("{case}: stops {gap} m before it, with a tube of {own:?}"));
        }
        wider += usize::from(own.longitudinal > 1.5 * least.longitudinal);
    }
    assert_eq!(wrong, [""; 0]);
    assert!(wider > 6, "{wider} plans need a wider tube");
}

/// Beside the path as well: a swerve with much of the grip passes where its tube fits, and keeps it from what stands beside.
#[test]
fn a_swerve_keeps_its_tube_from_what_stands_beside_it() {
    let (mut swerves, mut wrong) = (0, Vec::new());
    for (speed, distance) in [(8.0, 7.2), (8.0, 8.8), (12.0, 11.0), (12.0, 13.0)] {
        // behind the car that blocks the lane, a second one narrows the lane beside
        let beside = parked(78, Pose::new(START + distance + 14.0, 5.1, 0.0), 4.5, 1.6);
        let wall = in_front(&VEHICLE, distance, -0.9, 1.6);
        let scenario = scene(lanes(3.5, true), speed, vec![wall, beside]);
        let run = driven_until(&scenario, &VEHICLE, 1.0, 5.0);
        wrong.extend(broken_claims(&run, &format!("{speed} m/s, {distance} m")));
        let end = run.log.samples[run.log.samples.len() - 1].pose.position.x;
        swerves += usize::from(unproven(&run) == 0 && end > START + distance + 14.0);
    }
    assert_eq!(wrong, [""; 0]);
    assert!(swerves > 2, "{swerves}");
}
