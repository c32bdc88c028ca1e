//! The lattice alone, without speed or loop: the best path through a slalom of parked cars and over a change of lanes
//! comes out of it, and with the way closed nothing does.

mod common;

use common::VEHICLE;
use stopline::collision::{Allowance, Blocker, CollisionSettings, CollisionWorld};
use stopline::fixtures;
use stopline::geometry::polyline::Polyline;
use stopline::geometry::{Point, Pose};
use stopline::lattice::{EdgeStore, LatticeContext, LatticePath, Root, SearchResult, Settings, search};
use stopline::map::{Lanelet, Motion, Neighbour, Obstacle};
use stopline::reference::{ReferenceLine, ReferenceSettings};

/// Length of the roads, m.
const LENGTH: f64 = 160.0;
/// A parked car, m.
const CAR: (f64, f64) = (4.5, 1.8);

/// A straight lanelet along x between two lateral positions, m.
fn lanelet(id: i64, right: f64, left: f64) -> Lanelet {
    let bound = |y: f64| Polyline::new((0..=16).map(|i| Point::new(0.1 * LENGTH * f64::from(i), y))).unwrap();
    fixtures::lanelet(id, bound(right), bound(left))
}

fn parked(id: i64, x: f64, y: f64, (length, width): (f64, f64)) -> Obstacle {
    fixtures::parked(id, Pose::new(x, y, 0.0), length, width)
}

/// What the lattice finds on lanelet 1, from a rear-axle pose at a speed.
fn found(lanelets: Vec<Lanelet>, obstacles: &[Obstacle], start: Pose, speed: f64, horizon: f64) -> SearchResult {
    found_as_if(lanelets, obstacles, start, (speed, speed), horizon)
}

/// [`found`] with the layers of one speed and the costs of another.
fn found_as_if(
    lanelets: Vec<Lanelet>,
    obstacles: &[Obstacle],
    start: Pose,
    (speed, driven): (f64, f64),
    horizon: f64,
) -> SearchResult {
    let scenario = fixtures::scenario(fixtures::network(lanelets), obstacles.to_vec());
    let reference = ReferenceLine::new(&scenario.network, &[1], VEHICLE.width, &ReferenceSettings::default()).unwrap();
    let world = CollisionWorld::new(&scenario, &VEHICLE, &CollisionSettings::default(), 5.0).unwrap();
    let (max_curvature, half_width) = (VEHICLE.max_curvature(), 0.5 * VEHICLE.width);
    let full_speed_curvature = planned_lateral() / (driven * driven);
    let context =
        LatticeContext { reference: &reference, world: &world, max_curvature, full_speed_curvature, half_width };
    let root = Root { pose: start, curvature: 0.0, kept: vec![], start, allowance: Allowance::NONE };
    search(&context, &root, speed, horizon, &Settings::default(), &mut EdgeStore::default())
}

/// Least distance between the vehicle driven along a path and a rectangle along x, m: points of the vehicle's outline
/// every few centimetres, against the box.
fn distance(path: &LatticePath, obstacle: &Obstacle, (length, width): (f64, f64)) -> f64 {
    let Motion::Static(at) = &obstacle.motion else { panic!("it moves") };
    let corners = VEHICLE.footprint.bounding_rectangle();
    let outline: Vec<Point> = (0..4)
        .flat_map(|i| (0..60).map(move |k| (i, f64::from(k) / 60.0)))
        .map(|(i, u)| corners[i] + (corners[(i + 1) % 4] - corners[i]) * u)
        .collect();
    let steps = (path.path.length() / 0.1) as i32;
    let poses = (0..=steps).map(|i| path.path.at(0.1 * f64::from(i)).pose);
    let gap = |p: Point| {
        let (dx, dy) = ((p.x - at.position.x).abs() - 0.5 * length, (p.y - at.position.y).abs() - 0.5 * width);
        dx.max(0.0).hypot(dy.max(0.0))
    };
    poses.flat_map(|pose| outline.iter().map(move |p| gap(pose.to_world(*p)))).fold(f64::INFINITY, f64::min)
}

/// Lateral position of the vehicle's centre when it is beside x, m.
fn beside(path: &LatticePath, x: f64) -> f64 {
    let centre = |i: i32| VEHICLE.centre_of_rear_axle(&path.path.at(0.1 * f64::from(i)).pose).position;
    let steps = (path.path.length() / 0.1) as i32;
    (0..=steps).map(centre).min_by(|a, b| (a.x - x).abs().total_cmp(&(b.x - x).abs())).unwrap().y
}

/// Cars on alternate sides of a road 7 m wide: each leaves less than its own half of the road.
fn slalom(mirrored: bool) -> Vec<Obstacle> {
    let side = if mirrored { -1.0 } else { 1.0 };
    [(1, 40.0, 1.5), (2, 65.0, -1.5), (3, 90.0, 1.5)].map(|(id, x, y)| parked(id, x, side * y, CAR)).to_vec()
}

fn best_free(found: &SearchResult) -> Option<&LatticePath> {
    found.paths.iter().find(|p| p.blocked_by.is_none())
}

#[test]
fn the_best_path_through_a_slalom_passes_each_car_on_its_free_side() {
    for mirrored in [false, true] {
        let cars = slalom(mirrored);
        let found = found(vec![lanelet(1, -3.5, 3.5)], &cars, Pose::new(8.0, 0.0, 0.0), 7.0, 110.0);
        let path = &found.paths[0];
        assert_eq!(path.blocked_by, None, "the cheapest path is not one that gets through: {:?}", found.counts);
        assert!(path.path.length() > 90.0, "ends after {} m", path.path.length());
        for car in &cars {
            let Motion::Static(at) = &car.motion else { panic!("it moves") };
            let (x, y) = (at.position.x, at.position.y);
            let offset = beside(path, x);
            // half a car, half of the vehicle and the margin from the car's middle, and no farther out than need be
            let away = (y - offset) * y.signum();
            let least = 0.5 * (CAR.1 + VEHICLE.width) + 0.2;
            assert!((least..least + 0.9).contains(&away), "car {} is passed {away:.2} m off its middle", car.id);
            let gap = distance(path, car, CAR);
            assert!(gap >= 0.199, "{gap:.3} m to car {}", car.id);
        }
    }
}

#[test]
fn a_slalom_with_one_gap_closed_has_no_way_through_and_says_what_closes_it() {
    let mut cars = slalom(false);
    cars.push(parked(9, 65.0, 1.5, CAR));
    let found = found(vec![lanelet(1, -3.5, 3.5)], &cars, Pose::new(8.0, 0.0, 0.0), 7.0, 110.0);
    assert!(best_free(&found).is_none());
    let by = &found.counts.by_obstacle;
    assert!(by.contains_key(&2) && by.contains_key(&9), "{by:?}");
    // the way as far as the gap is still offered
    let farthest = found.paths.iter().map(|p| p.free_length).fold(0.0, f64::max);
    let gap = 65.0 - 0.5 * CAR.0 - VEHICLE.front_overhang_from_rear_axle() - 8.0;
    assert!((gap - 1.5..gap).contains(&farthest), "{farthest:.2} m of {gap:.2} m");
}

/// Two lanes of 3.5 m; the reference line is that of the left one, y = 3.5.
fn two_lanes() -> Vec<Lanelet> {
    let (mut left, mut right) = (lanelet(1, 1.75, 5.25), lanelet(2, -1.75, 1.75));
    left.adjacent_right = Some(Neighbour { id: 2, same_direction: true });
    right.adjacent_left = Some(Neighbour { id: 1, same_direction: true });
    vec![left, right]
}

/// Largest lateral acceleration on a path at one speed, m/s².
fn lateral(path: &LatticePath, speed: f64) -> f64 {
    let curvatures = path.path.pieces().map(|(_, _, spiral)| spiral.max_abs_curvature());
    curvatures.fold(0.0, f64::max) * speed * speed
}

/// The speeds at which the lane is changed, each with where a lorry stands on the own lane, m.
const CHANGES: [(f64, f64); 2] = [(8.0, 60.0), (14.0, 90.0)];
const LORRY: (f64, f64) = (10.0, 2.5);

fn lane_change(speed: f64, lorry: &Obstacle) -> SearchResult {
    lane_change_as_if(speed, speed, lorry)
}

fn lane_change_as_if(driven: f64, layers_of: f64, lorry: &Obstacle) -> SearchResult {
    found_as_if(two_lanes(), std::slice::from_ref(lorry), Pose::new(8.0, 0.0, 0.0), (layers_of, driven), 120.0)
}

#[test]
fn a_lane_change_ends_in_the_middle_of_the_other_lane_before_what_blocks_this_one() {
    for (speed, blocked_from) in CHANGES {
        let lorry = parked(4, blocked_from, 0.0, LORRY);
        let found = lane_change(speed, &lorry);
        let path = &found.paths[0];
        assert_eq!((path.blocked_by, path.end_offset), (None, 0.0), "at {speed} m/s: {:?}", found.counts);
        let end = path.path.at(path.path.length());
        assert!((end.pose.position.y - 3.5).abs() < 1e-6 && end.pose.yaw.abs() < 1e-6 && end.curvature.abs() < 1e-6);
        assert!(distance(path, &lorry, LORRY) >= 0.199);
        // it goes over once and stays; between two layers that are too near and too far, it may aim half a metre beyond
        // the middle, one step of the offsets, and come back
        let ys: Vec<f64> = (8..=150).map(|x| beside(path, f64::from(x))).collect();
        let farthest = ys.iter().position(|y| *y >= 3.45).expect("it does not go over");
        assert!(ys[..farthest].windows(2).all(|w| w[1] >= w[0]), "swings back: {ys:?}");
        assert!(ys[farthest..].iter().all(|y| (3.4..4.05).contains(y)), "does not stay: {ys:?}");
    }
}

/// What is offered: end, lateral acceleration at a speed, what blocks it.
fn offered(found: &SearchResult, speed: f64) -> Vec<(f64, f64, Option<Blocker>)> {
    found.paths.iter().map(|p| (p.end_offset, lateral(p, speed), p.blocked_by)).collect()
}

/// The largest lateral acceleration that the planner asks for, m/s².
fn planned_lateral() -> f64 {
    stopline::planner::Settings::default().lateral_share * VEHICLE.comfort.lateral_acceleration
}

#[test]
fn the_ways_over_can_be_driven_at_the_present_speed() {
    for (speed, blocked_from) in CHANGES {
        let offered = offered(&lane_change(speed, &parked(4, blocked_from, 0.0, LORRY)), speed);
        let (end, lateral, blocked_by) = offered[0];
        assert_eq!((end, blocked_by), (0.0, None));
        assert!(lateral < planned_lateral(), "the best one at {speed} m/s asks for {lateral:.2} m/s²: {offered:?}");
    }
}

/// The twin: with the lorry too near for a gentle way over, the sharp ones are offered, and the best is not sharper than
/// it must be.
#[test]
fn a_lorry_too_near_for_a_gentle_way_leaves_the_sharp_ones() {
    for (speed, blocked_from) in [(8.0, 27.0), (14.0, 37.0)] {
        let found = lane_change(speed, &parked(4, blocked_from, 0.0, LORRY));
        let offered = offered(&found, speed);
        let over = |(end, _, blocked): &&(f64, f64, Option<Blocker>)| end.abs() < 1.0 && blocked.is_none();
        let free: Vec<f64> = offered.iter().filter(over).map(|(_, lateral, _)| *lateral).collect();
        assert!(!free.is_empty(), "no way over at {speed} m/s: {offered:?}");
        assert!(free.iter().all(|lateral| *lateral > planned_lateral()), "{free:?}: the lorry is not near enough");
        assert!(found.paths[0].blocked_by.is_none() && found.paths[0].terms.curve_slowdown > 0.0, "{offered:?}");
    }
}

/// The same road at the same place: the faster the vehicle, the less its way over may bend.
#[test]
fn the_faster_the_vehicle_the_less_its_way_over_bends() {
    let bend = |speed: f64| {
        let found = lane_change_as_if(speed, 8.0, &parked(4, 90.0, 0.0, LORRY));
        lateral(&found.paths[0], 1.0)
    };
    let bends: Vec<f64> = [0.0, 4.0, 8.0, 12.0].map(bend).to_vec();
    assert!(bends.windows(2).all(|w| w[1] <= w[0]) && bends[3] < 0.7 * bends[0], "{bends:?}");
}

#[test]
fn a_wall_across_both_lanes_leaves_no_way() {
    let wall = parked(5, 60.0, 1.75, (1.0, 9.0));
    let found = found(two_lanes(), &[wall], Pose::new(8.0, 0.0, 0.0), 8.0, 120.0);
    assert!(best_free(&found).is_none());
    assert_eq!(found.paths[0].blocked_by, Some(Blocker::Obstacle(5)));
    assert!(found.counts.free > 0, "even the way as far as the wall is missing");
}

#[test]
fn a_full_lane_is_not_changed_to() {
    let row: Vec<Obstacle> = (0..22).map(|i| parked(10 + i, 15.0 + 7.0 * i as f64, 3.5, CAR)).collect();
    let found = found(two_lanes(), &row, Pose::new(8.0, 0.0, 0.0), 8.0, 120.0);
    let path = best_free(&found).expect("the own lane is free");
    // as near to the reference line as the row lets it, and no nearer
    let nearest = 3.5 - 0.5 * CAR.1 - 0.5 * VEHICLE.width - 0.2;
    for x in [30.0, 60.0, 90.0] {
        assert!(beside(path, x) < nearest, "{} m over at {x} m", beside(path, x));
    }
    for car in &row {
        assert!(distance(path, car, CAR) >= 0.199, "car {}", car.id);
    }
}
