//! Something close ahead, the lane beside it free: brake, evade, or say that there is no proof.

use std::f64::consts::FRAC_PI_2;

use stopline::collision::Blocker;
use stopline::drive::{Outcome, Run};
use stopline::planner::Plan;
use stopline::trajectory::TrajectoryPoint;
use stopline::vehicle::{ProofLimits, Vehicle, load};

use crate::common::VEHICLE;
use crate::scenes::{WALL, broken_claims, driven_until, hardest_stop, in_front, lanes, scene, unproven};

/// Of the steering along a plan, rad/s: the largest rate that its speed and the rate of its curvature demand.
fn steering_rate(vehicle: &Vehicle, plan: &Plan) -> f64 {
    let base = vehicle.wheelbase;
    let rate = |p: TrajectoryPoint| p.speed * base * p.curvature_rate.abs() / (1.0 + (base * p.curvature).powi(2));
    (0..400).map(|i| rate(plan.trajectory.at(plan.time + 0.02 * f64::from(i)))).fold(0.0, f64::max)
}

/// What a run breaks, with the steering rate of its proven plans.
fn broken(run: &Run, case: &str) -> Vec<String> {
    let mut broken = broken_claims(run, case);
    let proven = run.cycles.iter().map(|c| &c.plan).filter(|p| p.level.is_proven());
    let rate = proven.map(|plan| steering_rate(run.vehicle, plan)).fold(0.0, f64::max);
    if rate > 1.02 * run.vehicle.limits.steering_rate {
        broken.push(format!("{case}: a plan steers with {rate:.3} rad/s"));
    }
    broken
}

/// Every speed in town and on the road, a car or half a car over the lane, from too close to stop up to comfortable.
#[test]
fn nothing_proven_touches_a_car_that_stands_close_ahead() {
    let mut wrong = Vec::new();
    let (mut stopped, mut evaded, mut unproven_runs) = (0, 0, 0);
    for speed in [6.0, 9.0, 14.0] {
        let needed = hardest_stop(&VEHICLE, speed, 1.0);
        for (share, y) in [0.6, 0.9, 1.05, 1.3].into_iter().flat_map(|s| [-1.2, 0.3].map(|y| (s, y))) {
            let distance = share * needed;
            let scenario = scene(lanes(3.5, true), speed, vec![in_front(&VEHICLE, distance, y, 1.8)]);
            let run = driven_until(&scenario, &VEHICLE, 1.0, 5.0);
            wrong.extend(broken(&run, &format!("{speed} m/s, {distance:.1} m, {y} m aside")));
            let is_proven = unproven(&run) == 0;
            stopped += usize::from(is_proven && run.outcome == Outcome::StoppedSafely);
            evaded += usize::from(is_proven && run.outcome != Outcome::StoppedSafely);
            unproven_runs += usize::from(!is_proven);
        }
    }
    assert_eq!(wrong, [""; 0]);
    println!("{stopped} stops, {evaded} evaded, {unproven_runs} without a proof");
    assert!(stopped > 3 && evaded > 3 && unproven_runs > 3, "{stopped} {evaded} {unproven_runs}");
}

/// The steering of the truck is slower than that of the car.
#[test]
fn no_proven_plan_steers_faster_than_the_steering_can() {
    let mut wrong = Vec::new();
    let truck = load("truck").unwrap();
    for (vehicle, width) in [(&*VEHICLE, 3.5), (&truck, 4.0)] {
        for (speed, share) in [4.0, 6.0, 9.0].into_iter().flat_map(|v| [1.4, 1.8].map(|s| (v, s))) {
            for y in [-0.6, -1.0] {
                let distance = share * hardest_stop(vehicle, speed, 1.0);
                let scenario = scene(lanes(width, true), speed, vec![in_front(vehicle, distance, y, 1.8)]);
                let run = driven_until(&scenario, vehicle, 1.0, 6.0);
                wrong.extend(broken(&run, &format!("{}, {speed} m/s, {distance:.1} m, {y} m aside", vehicle.name)));
            }
        }
    }
    assert_eq!(wrong, [""; 0]);
}

/// What a contact with half a wall in the lane breaks: it is not announced, comes after a proof, or is faster than straight braking with
/// all that brakes and tyres give would make it.
fn badly_hit(speed: f64, distance: f64) -> Vec<String> {
    let all = ProofLimits::unreserved(&VEHICLE, 1.0).deceleration();
    let mut wrong = Vec::new();
    for side in [-1.0, 1.0] {
        // the free lane is on the other side
        let network = if side > 0.0 { mirrored_lanes() } else { lanes(3.5, true) };
        let scenario = scene(network, speed, vec![in_front(&VEHICLE, distance, side * 1.2, 1.8)]);
        let run = driven_until(&scenario, &VEHICLE, 1.0, 6.0);
        let case = format!("{speed} m/s, {distance} m, side {side}");
        wrong.extend(broken_claims(&run, &case));
        let Some(contact) = run.log.contact else { continue };
        // the first cycles may hope to evade with the reserve of the controller
        let announced = run.cycles.iter().filter_map(|c| c.plan.expected_contact).next_back();
        if announced.map(|c| c.what) != Some(Blocker::Obstacle(WALL)) {
            wrong.push(format!("{case}: not announced: {}", run.cycles[run.cycles.len() - 1].summary()));
        }
        // the brake force builds up within a few decimetres more
        let left = distance - speed * VEHICLE.actuators.brake_lag - 0.3;
        let straight = (speed * speed - 2.0 * all * left).max(0.0).sqrt();
        if contact.speed > straight {
            wrong.push(format!("{case}: contact at {:.1} m/s, straight braking gives {straight:.1}", contact.speed));
        }
    }
    wrong
}

/// So near that neither braking nor steering avoids it: nothing is claimed, the contact is announced, and it is slow.
#[test]
fn a_contact_that_cannot_be_avoided_is_announced_and_slow() {
    let cases = [(8.0, 2.6), (8.0, 3.2), (8.0, 3.8), (11.0, 6.0)];
    assert_eq!(cases.into_iter().flat_map(|(v, d)| badly_hit(v, d)).collect::<Vec<_>>(), [""; 0]);
}

/// A swerve with all of the grip that comes too late is given up for braking.
#[test]
fn a_swerve_that_comes_too_late_is_given_up_for_braking() {
    let cases = [(12.0, 7.0), (14.0, 9.0), (16.0, 11.0)];
    assert_eq!(cases.into_iter().flat_map(|(v, d)| badly_hit(v, d)).collect::<Vec<_>>(), [""; 0]);
}

/// A lane with another one to its right.
fn mirrored_lanes() -> stopline::map::RoadNetwork {
    use stopline::fixtures::{network, straight_lanelet};
    use stopline::map::Neighbour;
    let mut lane = straight_lanelet(1, (0.0, 300.0), -1.75, 1.75);
    let mut right = straight_lanelet(2, (0.0, 300.0), -5.25, -1.75);
    lane.adjacent_right = Some(Neighbour { id: 2, same_direction: true });
    right.adjacent_left = Some(Neighbour { id: 1, same_direction: true });
    network([lane, right])
}

/// A lane that is a little too narrow to pass with margins: a proven stop is kept, and ends before the car.
#[test]
fn a_proven_stop_is_kept_where_a_swerve_would_be_milder() {
    let mut wrong = Vec::new();
    let mut stops = 0;
    for (speed, distance) in [(6.0, 4.6), (8.0, 6.8), (8.0, 7.5), (10.0, 10.0), (12.0, 14.0)] {
        for (width, y) in [(4.5, -0.6), (4.5, 0.6), (4.3, -0.5), (4.2, 0.4)] {
            let scenario = scene(lanes(width, false), speed, vec![in_front(&VEHICLE, distance, y, 1.8)]);
            let run = driven_until(&scenario, &VEHICLE, 1.0, 8.0);
            let case = format!("{speed} m/s, {distance} m, {y} m aside in {width} m");
            wrong.extend(broken(&run, &case));
            let levels: Vec<_> = run.cycles.iter().map(|c| c.plan.level).collect();
            let left = levels.windows(2).find(|l| !l[1].is_as_safe_as(l[0]));
            wrong.extend(left.map(|l| format!("{case}: {} left for {}", l[0], l[1])));
            stops += usize::from(run.outcome == Outcome::StoppedSafely);
        }
    }
    assert_eq!(wrong, [""; 0]);
    assert!(stops > 10, "{stops}");
}

/// The steering angle stays within the vehicle's: a check of [`steering_rate`] on a plan that is known.
#[test]
fn the_steering_rate_of_a_plan_is_that_of_its_curvature() {
    use stopline::fixtures::{cycle, knot};
    use stopline::geometry::Pose;
    use stopline::geometry::spiral::CubicSpiral;
    use stopline::trajectory::{Path, SpeedProfile, Trajectory};
    // from straight to a radius of 10 m within 10 m, at 5 m/s
    let clothoid = CubicSpiral { knots: [0.0, 0.1 / 3.0, 0.2 / 3.0, 0.1], length: 10.0 };
    let path = Path::new(Pose::new(0.0, 0.0, FRAC_PI_2), &[clothoid]).unwrap();
    let profile = SpeedProfile::new(vec![knot(0.0, 0.0, 5.0, 0.0), knot(2.0, 10.0, 5.0, 0.0)]).unwrap();
    let plan = cycle(0.0, Trajectory { start_time: 0.0, path, profile }).plan;
    // tan δ = L κ, κ' = 0.01 1/m²
    assert!((steering_rate(&VEHICLE, &plan) - 5.0 * 0.01 * VEHICLE.wheelbase).abs() < 1e-3);
}
