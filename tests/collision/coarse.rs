//! The coarse-to-fine check agrees with the flat check, to the bit.

use stopline::collision::{Allowance, Blocker, CollisionSettings, Margins};
use stopline::trajectory::Path;

use crate::random::{Random, RandomMap};

/// Random settings: spacings, margins and allowances all vary.
fn settings(random: &mut Random) -> CollisionSettings {
    let mut margins = || Margins { lateral: random.within(0.0, 0.5), longitudinal: random.within(0.0, 0.5) };
    let (static_obstacles, moving_obstacles) = (margins(), margins());
    let spacing = [0.1, 0.5, 0.5, 1.0, 2.0][random.within(0.0, 5.0) as usize];
    let road = random.within(0.0, 0.3);
    CollisionSettings { spacing, static_obstacles, moving_obstacles, road, ..CollisionSettings::default() }
}

fn allowance(random: &mut Random) -> Allowance {
    let mut until = || if random.next() < 0.7 { f64::NEG_INFINITY } else { random.within(-1.0, 15.0) };
    Allowance { no_margins_until: until(), no_road_until: until() }
}

/// Obstacle and boundary hits, in first and later cells, and free paths; with one and two pieces.
#[test]
fn coarse_to_fine_and_flat_agree() {
    let mut random = Random::new(5);
    let mut seen = [0; 4];
    for objects in [0, 1, 10, 40].into_iter().cycle().take(80) {
        let map = RandomMap::new(&mut random, objects);
        let world = map.world(&settings(&mut random));
        for _ in 0..100 {
            let (start, allowance) = (map.start(&mut random), allowance(&mut random));
            let spirals: Vec<_> = (0..random.within(1.0, 3.0) as usize)
                .map(|_| {
                    let max_curvature = if random.next() < 0.5 { 0.03 } else { 0.25 };
                    random.spiral(max_curvature, (0.05, 40.0))
                })
                .collect();
            let path = Path::new(start, &spirals).unwrap();
            let sweep = world.sweep_path(&path);
            let mut probe = world.probe_path(&path);
            let flat = world.static_hit_from_start(&sweep, &world.margins, &allowance);
            assert_eq!(probe.cells(), sweep.cells());
            // in both orders: the first query must not change the result of the second
            let cap = random.within(0.1, 3.0);
            if random.next() < 0.5 {
                assert_eq!(probe.static_hit(&world.margins, &allowance), flat, "{start:?} {spirals:?} {allowance:?}");
                assert_eq!(probe.clearance(cap), world.clearance(&sweep, cap), "{start:?} {spirals:?}");
            } else {
                assert_eq!(probe.clearance(cap), world.clearance(&sweep, cap), "{start:?} {spirals:?}");
                assert_eq!(probe.static_hit(&world.margins, &allowance), flat, "{start:?} {spirals:?} {allowance:?}");
            }
            seen[match flat {
                None => 0,
                Some(hit) if hit.cell == 0 => 1,
                Some(hit) if hit.what == Blocker::RoadBoundary => 2,
                Some(_) => 3,
            }] += 1;
        }
    }
    println!("free {}, hit in the first cell {}, road {}, obstacle {}", seen[0], seen[1], seen[2], seen[3]);
    assert!(seen.iter().all(|n| *n > 500), "too few samples of a kind: {seen:?}");
}
