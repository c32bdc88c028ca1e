//! Moving obstacles at a fine resolution: never more than the coarse grid blocks, never less than dense sampling in space and time
//! finds.

use proptest::prelude::*;
use stopline::collision::{BlockedGrid, CollisionSettings, CollisionWorld, Margins, SafetyMargins};
use stopline::geometry::{Pose, Vector};
use stopline::map::{ConvexPart, Motion, Obstacle, Shape, TimedPose};

use crate::helpers::{World, distance, inflated, obstacle, plain, scenario, shapes, spirals, straight, vehicle, world};

/// Whether the coarse grid blocks a rectangle of the fine one, at its middle and close to its corners.
fn covers(coarse: &BlockedGrid, stations: (f64, f64), times: (f64, f64)) -> bool {
    let within = |(from, to): (f64, f64), share: f64| from + (to - from) * share;
    [(0.5, 0.5), (0.01, 0.01), (0.01, 0.99), (0.99, 0.01), (0.99, 0.99)].iter().all(|&(a, b)| {
        let (s, t) = (within(stations, a), within(times, b));
        coarse.is_range_blocked((s, s), (t, t))
    })
}

fn touches(pose: &Pose, margins: &Margins, parts: &[ConvexPart]) -> bool {
    let body = inflated(pose, margins);
    parts.iter().any(|part| distance(&body, part) == 0.0)
}

/// Circles about a place near the path, at a speed that may be zero, with states at different steps.
fn moving(id: i64, shape: Shape, place: Pose, speed: f64, yaw_rate: f64, (step, begins): (f64, f64)) -> Obstacle {
    let state = |i: u32| {
        let time = begins + f64::from(i) * step;
        let turned = place.yaw + 0.5 * yaw_rate * time;
        let position = place.position + Vector::new(turned.cos(), turned.sin()) * (speed * time);
        TimedPose { time, pose: Pose { position, yaw: place.yaw + yaw_rate * time }, speed }
    };
    obstacle(id, shape, Motion::Trajectory((0..=(5.0 / step) as u32).map(state).collect()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn a_fine_grid_is_a_subset_of_the_coarse_one_and_misses_no_contact(
        spiral in spirals(0.2), obstacles in prop::collection::vec((shapes(), 0.0..1.0f64, -3.0..3.0f64, -3.2..3.2f64), 1..4),
        speed in prop_oneof![Just(0.0), 0.0..1.0f64, 0.0..12.0f64], yaw_rate in prop_oneof![Just(0.0), -1.0..1.0f64],
        step in prop_oneof![Just(0.1), Just(0.04), Just(0.25)], begins in prop_oneof![Just(0.0), 0.0..1.0f64],
        lateral in 0.0..0.4f64, longitudinal in 0.0..0.4f64, until in prop_oneof![Just(f64::INFINITY), 0.0..20.0f64],
    ) {
        let start = Pose::new(-11.0, 4.0, 0.7);
        let obstacles: Vec<Obstacle> = (5..).zip(obstacles).map(|(id, (shape, at, aside, heading))| {
            let near = spiral.point_at(&start, at * spiral.length).pose;
            moving(id, shape, Pose { position: near.position + near.left() * aside, yaw: heading }, speed, yaw_rate, (step, begins))
        }).collect();
        let world = world(&scenario(plain(), obstacles.clone()), &CollisionSettings::default());
        let margins = SafetyMargins { moving_obstacles: Margins { lateral, longitudinal }, ..SafetyMargins::NONE };
        let sweep = world.sweep(&start, &spiral);
        let coarse = CollisionWorld::blocked(&world, &[&sweep], &margins, 0.0, 5.0);
        let fine = world.blocked_finely(&[&sweep], &margins, (0.0, 5.0), until);
        prop_assert_eq!(fine.stations().last(), coarse.stations().last());
        prop_assert!(fine.stations().windows(2).all(|pair| pair[0] < pair[1]));
        for (stations, times) in fine.blocked_cells() {
            prop_assert!(covers(&coarse, stations, times), "{stations:?} {times:?} is free in the coarse grid");
        }
        // what the fine grid frees: poses every 4 cm or so, times every 12.5 ms
        for ((from, to), (begins, ends)) in coarse.blocked_cells() {
            for i in 0..=12 {
                let s = from + (to - from) * f64::from(i) / 12.0;
                let pose = spiral.point_at(&start, s).pose;
                for k in 0..=((ends - begins) / 0.0125).round() as u32 {
                    let t = (begins + 0.0125 * f64::from(k)).min(ends);
                    if !fine.is_range_blocked((s, s), (t, t)) {
                        let meets = |o: &Obstacle| touches(&pose, &margins.moving_obstacles, &o.occupied_at(t));
                        prop_assert!(!obstacles.iter().any(meets), "the contact at {s} m and {t} s is missed");
                    }
                }
            }
        }
    }
}

/// A car whose rear is at a distance ahead of the front bumper, with a speed.
fn leader(gap: f64, speed: f64) -> World {
    let rear = vehicle().front_overhang_from_rear_axle() + gap;
    let car = stopline::fixtures::driving(5, Pose::new(rear + 2.25, 0.0, 0.0), speed, 9.0);
    world(&scenario(plain(), vec![car]), &CollisionSettings::default())
}

/// The last station at which a vehicle may stand for ever, m.
fn free_until(grid: &BlockedGrid) -> f64 {
    let first = (0..grid.cells()).find(|cell| !grid.intervals(*cell).is_empty()).unwrap();
    grid.stations()[first]
}

#[test]
fn close_behind_a_standing_or_slow_leader_there_is_a_free_standstill() {
    let margins = SafetyMargins { moving_obstacles: Margins::uniform(0.01), ..SafetyMargins::NONE };
    for (gap, speed) in [(0.15, 0.0), (0.3, 0.0), (0.15, 0.3), (0.45, 0.0), (0.45, 1.0)] {
        let world = leader(gap, speed);
        let sweep = world.sweep(&Pose::new(0.0, 0.0, 0.0), &straight(30.0));
        let coarse = CollisionWorld::blocked(&world, &[&sweep], &margins, 0.0, 9.0);
        let fine = world.blocked_finely(&[&sweep], &margins, (0.0, 9.0), 2.0);
        assert!(!coarse.intervals(0).is_empty(), "the whole first cell counts as blocked");
        let free = free_until(&fine);
        assert!((gap - 0.01 - 0.1..=gap - 0.01).contains(&free), "free until {free} m of {gap} m");
        // few more cells: those in which the rear of the leader is
        let more = fine.cells() - coarse.cells();
        assert!((1..=16).contains(&more), "{more} more cells at {speed} m/s");
        let far = world.blocked_finely(&[&sweep], &margins, (0.0, 9.0), 0.0);
        assert_eq!(far, coarse);
    }
}
