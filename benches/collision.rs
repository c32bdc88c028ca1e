//! Speed of the collision layer: edges of 50 m on a road with a hundred boundary segments and parked cars, and the
//! blocked grid of 100 m with 30 moving obstacles over 6 s. Each bench asserts its results before it measures.
//!
//! `edge_rate` (alone: `cargo bench --bench collision -- edge_rate`) prints how many candidate edges one core solves
//! and checks per second.

#[path = "collision/edge_rate.rs"]
mod edge_rate;

use divan::{Bencher, black_box};
use stopline::collision::{Allowance, CollisionSettings, CollisionWorld, SafetyMargins};
use stopline::fixtures::{collision_world, driving, lanelet, network, parked, scenario, vehicle};
use stopline::geometry::Pose;
use stopline::geometry::polyline::Polyline;
use stopline::geometry::spiral::CubicSpiral;
use stopline::map::Lanelet;

fn main() {
    let filters: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    if filters.is_empty() || filters.iter().any(|f| f == "edge_rate") {
        edge_rate::print();
    }
    if filters.is_empty() || filters.iter().any(|f| f != "edge_rate") {
        divan::main();
    }
}

/// A winding road of two lanes, 220 m long, with bound points every 2 m. It runs at 45°, the worst case for
/// axis-aligned bounding boxes.
fn road() -> Vec<Lanelet> {
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
        .map(|(id, left, right)| lanelet(id, bound(right), bound(left)))
        .collect()
}

fn start() -> Pose {
    Pose::new(1e5, 2e5, 0.785)
}

/// `moving` cars near the path, at speeds of 0 to 12 m/s in both directions, and a parked car beside it every 40 m.
fn world(moving: usize) -> CollisionWorld {
    let beside = |s: f64, l: f64, turn: f64| {
        let p = start().advanced(s);
        Pose { position: p.position + p.left() * l, yaw: p.yaw + turn }
    };
    let parked = (0..5).map(|i| parked(i, beside(40.0 * i as f64, -4.5, 0.0), 4.5, 1.8));
    let driven = (0..moving as i64).map(|i| {
        let (station, speed) = ((i * 37 % 140) as f64 - 20.0, (i % 7) as f64 * 2.0);
        let from = if i % 2 == 0 { beside(station, 0.0, 0.0) } else { beside(station, 4.5, std::f64::consts::PI) };
        driving(100 + i, from, speed, 7.9)
    });
    let scenario = scenario(network(road()), parked.chain(driven).collect());
    collision_world(&scenario, &vehicle(), &CollisionSettings::default(), 10.0)
}

fn margins() -> SafetyMargins {
    CollisionSettings::default().margins()
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
    let hit = || world.probe(black_box(&start()), &edge(50.0)).static_hit(&margins(), &Allowance::NONE);
    assert_eq!(hit(), None);
    bencher.bench_local(hit);
}

#[divan::bench]
fn clearance_50_m(bencher: Bencher) {
    let world = world(0);
    let clearance = || world.probe(black_box(&start()), &edge(50.0)).clearance(2.0);
    assert!(clearance().road > 0.0);
    bencher.bench_local(clearance);
}

/// All cars are on the ego lane and the adjacent lane: far more contacts than in traffic.
#[divan::bench(args = [5, 30])]
fn blocked_100_m_6_s(bencher: Bencher, moving: usize) {
    let world = world(moving);
    let (a, b) = (world.sweep(&start(), &edge(50.0)), world.sweep(&start().advanced(50.0), &edge(50.0)));
    let grid = world.blocked(&[&a, &b], &margins(), 0.0, 6.0);
    assert!(grid.cells() == 200 && !grid.is_free());
    bencher.bench_local(|| world.blocked(black_box(&[&a, &b]), &margins(), 0.0, 6.0));
}

#[divan::bench]
fn is_blocked(bencher: Bencher) {
    let world = world(30);
    let sweep = world.sweep(&start(), &edge(50.0));
    let grid = world.blocked(&[&sweep], &margins(), 0.0, 6.0);
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
