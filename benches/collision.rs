//! Rates of the collision layer: edges of 50 m against a road with a hundred boundary segments and parked cars, and the
//! blocked grid of 100 m against 30 moving obstacles over 6 s. The answers are asserted before anything is timed.
//!
//! `edge_rate` (also by `cargo bench --bench collision -- edge_rate`) prints how many candidate edges are solved and
//! checked in a second on one core.

#[path = "collision/edge_rate.rs"]
mod edge_rate;

use divan::{Bencher, black_box};
use stopline::collision::{CollisionSettings, CollisionWorld};
use stopline::geometry::Pose;
use stopline::geometry::polyline::Polyline;
use stopline::geometry::spiral::CubicSpiral;
use stopline::map::{Lanelet, Motion, Obstacle, ObstacleKind, RoadNetwork, Scenario, Shape, TimedPose};
use stopline::vehicle::{Actuators, Comfort, Footprint, Limits, Tyres, Vehicle};

fn main() {
    let filters: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    if filters.is_empty() || filters.iter().any(|f| f == "edge_rate") {
        edge_rate::print();
    }
    if filters.is_empty() || filters.iter().any(|f| f != "edge_rate") {
        divan::main();
    }
}

/// A winding road of two lanes, 220 m, bound points every 2 m; it runs at 45°, so that boxes around it are poor.
pub(crate) fn road() -> Vec<Lanelet> {
    let centre: Vec<Pose> = (0..=110)
        .map(|i| {
            let s = 2.0 * f64::from(i) - 20.0;
            let yaw = 0.785 + 0.2 * (s / 30.0).sin();
            Pose::new(1e5 + s * 0.785f64.cos(), 2e5 + s * 0.785f64.sin(), yaw)
        })
        .collect();
    let bound = |l: f64| Polyline::new(centre.iter().map(|p| p.position + p.left() * l)).unwrap();
    [(1, 1.75, -1.75), (2, 5.25, 1.75)]
        .into_iter()
        .map(|(id, left, right)| lanelet(id, bound(left), bound(right)))
        .collect()
}

fn start() -> Pose {
    Pose::new(1e5, 2e5, 0.785)
}

/// `moving` cars around the path, at speeds of 0 to 12 m/s in both directions, and a parked one every 40 m beside it.
fn world(moving: usize) -> CollisionWorld {
    let shape = Shape::rectangle(4.5, 1.8);
    let beside = |s: f64, l: f64, turn: f64| {
        let p = start().advanced(s);
        Pose { position: p.position + p.left() * l, yaw: p.yaw + turn }
    };
    let parked = (0..5).map(|i| (i, Motion::Static(beside(40.0 * i as f64, -4.5, 0.0))));
    let driven = (0..moving as i64).map(|i| {
        let (way, speed) = ((i * 37 % 140) as f64 - 20.0, (i % 7) as f64 * 2.0);
        let from = if i % 2 == 0 { beside(way, 0.0, 0.0) } else { beside(way, 4.5, std::f64::consts::PI) };
        let states = (0..80).map(|k| {
            let t = 0.1 * f64::from(k);
            TimedPose { time: t, pose: from.advanced(speed * t), speed }
        });
        (100 + i, Motion::Trajectory(states.collect()))
    });
    let obstacles = parked.chain(driven).map(|(id, motion)| Obstacle {
        id,
        kind: ObstacleKind::Vehicle,
        shape: shape.clone(),
        motion,
    });
    let scenario = Scenario {
        id: "bench".into(),
        version: "2020a".into(),
        time_step: 0.1,
        network: RoadNetwork { lanelets: road().into_iter().map(|l| (l.id, l)).collect(), ..RoadNetwork::default() },
        obstacles: obstacles.collect(),
        occupancy: None,
        problems: vec![],
        issues: vec![],
    };
    CollisionWorld::new(&scenario, &vehicle(), &CollisionSettings::default(), 10.0).unwrap()
}

fn edge(length: f64) -> CubicSpiral {
    CubicSpiral { knots: [0.0, 0.004, 0.002, -0.002], length }
}

#[divan::bench]
fn sweep_50_m(bencher: Bencher) {
    let world = world(0);
    assert_eq!(world.sweep(&start(), &edge(50.0)).cells(), 100);
    bencher.bench_local(|| world.sweep(black_box(&start()), black_box(&edge(50.0))));
}

#[divan::bench]
fn static_hit_50_m(bencher: Bencher) {
    let world = world(0);
    let sweep = world.sweep(&start(), &edge(50.0));
    assert_eq!(world.static_hit(&sweep), None);
    bencher.bench_local(|| world.static_hit(black_box(&sweep)));
}

#[divan::bench]
fn clearance_50_m(bencher: Bencher) {
    let world = world(0);
    let sweep = world.sweep(&start(), &edge(50.0));
    assert!(world.clearance(&sweep, 2.0).road > 0.0);
    bencher.bench_local(|| world.clearance(black_box(&sweep), 2.0));
}

/// All cars on the vehicle's own and the neighbouring lane: far more contact than in traffic.
#[divan::bench(args = [5, 30])]
fn blocked_100_m_6_s(bencher: Bencher, moving: usize) {
    let world = world(moving);
    let (a, b) = (world.sweep(&start(), &edge(50.0)), world.sweep(&start().advanced(50.0), &edge(50.0)));
    let grid = world.blocked(&[&a, &b], 0.0, 6.0);
    assert!(grid.cells() == 200 && !grid.is_free());
    bencher.bench_local(|| world.blocked(black_box(&[&a, &b]), 0.0, 6.0));
}

#[divan::bench]
fn is_blocked(bencher: Bencher) {
    let world = world(30);
    let sweep = world.sweep(&start(), &edge(50.0));
    let grid = world.blocked(&[&sweep], 0.0, 6.0);
    let mut i = 0;
    bencher.bench_local(|| {
        i = (i + 7) % 100;
        grid.is_blocked(black_box(i), 2.0, 2.3)
    });
}

#[divan::bench]
fn world_of_30_obstacles(bencher: Bencher) {
    bencher.bench_local(|| world(black_box(30)));
}

fn lanelet(id: i64, left: Polyline, right: Polyline) -> Lanelet {
    Lanelet {
        id,
        centre: left.clone(),
        left,
        right,
        successors: vec![],
        predecessors: vec![],
        adjacent_left: None,
        adjacent_right: None,
        speed_limit: None,
        stop_line: None,
        signs: vec![],
        lights: vec![],
        types: vec![],
    }
}

/// The published dimensions of the BMW 320i; the rest does not matter here.
pub(crate) fn vehicle() -> Vehicle {
    Vehicle {
        name: "bmw_320i".into(),
        commonroad_type: Some(2),
        footprint: Footprint::rectangle(4.508, 1.61, 1.4227),
        length: 4.508,
        width: 1.61,
        wheelbase: 2.5789,
        rear_axle_to_centre: 1.4227,
        rear_axle_to_mass: 1.4227,
        mass_height: 0.5,
        track_width: 1.5,
        mass: 1093.0,
        yaw_inertia: 1791.0,
        wheel_radius: 0.3,
        wheel_inertia: 1.0,
        limits: Limits {
            steering: 1.066,
            steering_rate: 0.4,
            steering_acceleration: 20.0,
            speed: 50.8,
            acceleration: 11.5,
            switching_speed: 7.3,
            deceleration: 11.5,
        },
        tyres: Tyres {
            friction: 1.0,
            cornering_front: 20.0,
            cornering_rear: 20.0,
            longitudinal: 20.0,
            relaxation_length: 0.3,
            rolling_resistance: 0.01,
            drag: 0.4,
        },
        actuators: Actuators {
            drive_lag: 0.2,
            brake_lag: 0.1,
            steering_lag: 0.1,
            drive_front_share: 0.0,
            brake_front_share: 0.6,
        },
        comfort: Comfort {
            acceleration: 2.0,
            deceleration: 2.0,
            aggressive_deceleration: 6.0,
            lateral_acceleration: 3.0,
            jerk: 3.0,
        },
    }
}
