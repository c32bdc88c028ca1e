//! The lattice search alone, without speed search and simulation: slaloms of parked cars, lane changes, blocked roads.

mod common;

use common::VEHICLE;
use stopline::collision::{Allowance, Blocker, CollisionSettings};
use stopline::fixtures;
use stopline::geometry::polyline::Polyline;
use stopline::geometry::{Point, Pose};
use stopline::lattice::{EdgeStore, Lattice, LatticeContext, LatticePath, Root, SearchResult, Settings};
use stopline::map::{Lanelet, Motion, Neighbour, Obstacle};
use stopline::reference::{ReferenceLine, ReferenceSettings};

/// Length of the roads, m.
const LENGTH: f64 = 160.0;
/// A parked car, m.
const CAR: (f64, f64) = (4.5, 1.8);

/// A straight lanelet in x direction between two lateral positions, m.
fn lanelet(id: i64, right: f64, left: f64) -> Lanelet {
    let bound = |y: f64| Polyline::new((0..=16).map(|i| Point::new(0.1 * LENGTH * f64::from(i), y))).unwrap();
    fixtures::lanelet(id, bound(right), bound(left))
}

fn parked(id: i64, x: f64, y: f64, (length, width): (f64, f64)) -> Obstacle {
    fixtures::parked(id, Pose::new(x, y, 0.0), length, width)
}

/// The search result on lanelet 1, from a rear-axle pose at a speed.
fn searched(lanelets: Vec<Lanelet>, obstacles: &[Obstacle], start: Pose, speed: f64, horizon: f64) -> SearchResult {
    searched_with(lanelets, obstacles, start, (speed, speed), horizon)
}

/// [`searched`] with the layers of one speed and the costs of another.
fn searched_with(
    lanelets: Vec<Lanelet>,
    obstacles: &[Obstacle],
    start: Pose,
    (speed, driven): (f64, f64),
    horizon: f64,
) -> SearchResult {
    let scenario = fixtures::scenario(fixtures::network(lanelets), obstacles.to_vec());
    let reference = ReferenceLine::new(&scenario.network, &[1], VEHICLE.width, &ReferenceSettings::default()).unwrap();
    let world = fixtures::collision_world(&scenario, &VEHICLE, &CollisionSettings::default(), 5.0);
    let (max_curvature, half_width) = (VEHICLE.max_curvature(), 0.5 * VEHICLE.width);
    let full_speed_curvature = planned_lateral() / (driven * driven);
    let margins = CollisionSettings::default().margins();
    let context = LatticeContext {
        reference: &reference,
        world: &world,
        margins,
        max_curvature,
        full_speed_curvature,
        half_width,
        target: None,
    };
    let root = Root { pose: start, curvature: 0.0, kept: vec![], start, allowance: Allowance::NONE };
    Lattice::new(Settings::default()).unwrap().search(&context, &root, speed, horizon, &mut EdgeStore::default())
}

/// Smallest distance between the vehicle on a path and an axis-aligned rectangle, m, by points of the vehicle's outline
/// every few centimetres.
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

/// Lateral position of the vehicle's centre at x, m.
fn beside(path: &LatticePath, x: f64) -> f64 {
    let centre = |i: i32| VEHICLE.centre_of_rear_axle(&path.path.at(0.1 * f64::from(i)).pose).position;
    let steps = (path.path.length() / 0.1) as i32;
    (0..=steps).map(centre).min_by(|a, b| (a.x - x).abs().total_cmp(&(b.x - x).abs())).unwrap().y
}

/// Cars on alternate sides of a road 7 m wide; each blocks more than its half of the road.
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
        let found = searched(vec![lanelet(1, -3.5, 3.5)], &cars, Pose::new(8.0, 0.0, 0.0), 7.0, 110.0);
        let path = &found.paths[0];
        assert_eq!(path.blocked_by, None, "the cheapest path is blocked: {:?}", found.counts);
        assert!(path.path.length() > 90.0, "ends after {} m", path.path.length());
        for car in &cars {
            let Motion::Static(at) = &car.motion else { panic!("it moves") };
            let (x, y) = (at.position.x, at.position.y);
            let offset = beside(path, x);
            // half of both widths plus the margin from the centre of the car, and not much farther
            let away = (y - offset) * y.signum();
            let least = 0.5 * (CAR.1 + VEHICLE.width) + 0.2;
            assert!((least..least + 0.9).contains(&away), "car {} is passed at {away:.2} m from its centre", car.id);
            let gap = distance(path, car, CAR);
            assert!(gap >= 0.199, "{gap:.3} m to car {}", car.id);
        }
    }
}

#[test]
fn a_slalom_with_a_closed_gap_is_blocked_by_the_two_cars() {
    let mut cars = slalom(false);
    cars.push(parked(9, 65.0, 1.5, CAR));
    let found = searched(vec![lanelet(1, -3.5, 3.5)], &cars, Pose::new(8.0, 0.0, 0.0), 7.0, 110.0);
    assert!(best_free(&found).is_none());
    let by = &found.counts.by_obstacle;
    assert!(by.contains_key(&2) && by.contains_key(&9), "{by:?}");
    // the paths still reach the gap
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

/// Speeds of the lane changes, m/s, each with the position of a truck on the present lane, m.
const CHANGES: [(f64, f64); 2] = [(8.0, 60.0), (14.0, 90.0)];
const TRUCK: (f64, f64) = (10.0, 2.5);

fn lane_change(speed: f64, truck: &Obstacle) -> SearchResult {
    lane_change_as_if(speed, speed, truck)
}

fn lane_change_as_if(driven: f64, layers_of: f64, truck: &Obstacle) -> SearchResult {
    searched_with(two_lanes(), std::slice::from_ref(truck), Pose::new(8.0, 0.0, 0.0), (layers_of, driven), 120.0)
}

#[test]
fn a_lane_change_ends_in_the_centre_of_the_other_lane_before_the_truck() {
    for (speed, blocked_from) in CHANGES {
        let truck = parked(4, blocked_from, 0.0, TRUCK);
        let found = lane_change(speed, &truck);
        let path = &found.paths[0];
        assert_eq!((path.blocked_by, path.end_offset), (None, 0.0), "at {speed} m/s: {:?}", found.counts);
        let end = path.path.at(path.path.length());
        assert!((end.pose.position.y - 3.5).abs() < 1e-6 && end.pose.yaw.abs() < 1e-6 && end.curvature.abs() < 1e-6);
        assert!(distance(path, &truck, TRUCK) >= 0.199);
        // it changes once and stays; if the layers do not fit its length, it may overshoot the centre by half a metre, one
        // step of the offsets
        let ys: Vec<f64> = (8..=150).map(|x| beside(path, f64::from(x))).collect();
        let farthest = ys.iter().position(|y| *y >= 3.45).expect("no lane change");
        assert!(ys[..farthest].windows(2).all(|w| w[1] >= w[0]), "swings back: {ys:?}");
        assert!(ys[farthest..].iter().all(|y| (3.4..4.05).contains(y)), "does not stay: {ys:?}");
    }
}

/// The paths: end offset, lateral acceleration at a speed, blocker.
fn summary(found: &SearchResult, speed: f64) -> Vec<(f64, f64, Option<Blocker>)> {
    found.paths.iter().map(|p| (p.end_offset, lateral(p, speed), p.blocked_by)).collect()
}

/// The planned lateral acceleration of the planner, m/s².
fn planned_lateral() -> f64 {
    stopline::planner::Settings::default().lateral_share * VEHICLE.comfort.lateral_acceleration
}

#[test]
fn lane_changes_can_be_driven_at_the_present_speed() {
    for (speed, blocked_from) in CHANGES {
        let offered = summary(&lane_change(speed, &parked(4, blocked_from, 0.0, TRUCK)), speed);
        let (end, lateral, blocked_by) = offered[0];
        assert_eq!((end, blocked_by), (0.0, None));
        assert!(lateral < planned_lateral(), "the best path at {speed} m/s needs {lateral:.2} m/s²: {offered:?}");
    }
}

/// The counterpart: if the truck is too near for a gentle lane change, the result has tight ones, with a slowdown cost.
#[test]
fn a_near_truck_leaves_only_tight_lane_changes() {
    for (speed, blocked_from) in [(8.0, 27.0), (14.0, 37.0)] {
        let found = lane_change(speed, &parked(4, blocked_from, 0.0, TRUCK));
        let offered = summary(&found, speed);
        let over = |(end, _, blocked): &&(f64, f64, Option<Blocker>)| end.abs() < 1.0 && blocked.is_none();
        let free: Vec<f64> = offered.iter().filter(over).map(|(_, lateral, _)| *lateral).collect();
        assert!(!free.is_empty(), "no lane change at {speed} m/s: {offered:?}");
        assert!(free.iter().all(|lateral| *lateral > planned_lateral()), "{free:?}: the truck is not near enough");
        assert!(found.paths[0].blocked_by.is_none() && found.paths[0].terms.curve_slowdown > 0.0, "{offered:?}");
    }
}

/// On the same road, a faster vehicle has a lane change with less curvature.
#[test]
fn faster_vehicles_have_gentler_lane_changes() {
    let curvature = |speed: f64| {
        let found = lane_change_as_if(speed, 8.0, &parked(4, 90.0, 0.0, TRUCK));
        lateral(&found.paths[0], 1.0)
    };
    let curvatures: Vec<f64> = [0.0, 4.0, 8.0, 12.0].map(curvature).to_vec();
    assert!(curvatures.windows(2).all(|w| w[1] <= w[0]) && curvatures[3] < 0.7 * curvatures[0], "{curvatures:?}");
}

#[test]
fn a_wall_over_both_lanes_blocks_all_paths() {
    let wall = parked(5, 60.0, 1.75, (1.0, 9.0));
    let found = searched(two_lanes(), &[wall], Pose::new(8.0, 0.0, 0.0), 8.0, 120.0);
    assert!(best_free(&found).is_none());
    assert_eq!(found.paths[0].blocked_by, Some(Blocker::Obstacle(5)));
    assert!(found.counts.free > 0, "no path reaches the wall");
}

#[test]
fn there_is_no_lane_change_into_an_occupied_lane() {
    let row: Vec<Obstacle> = (0..22).map(|i| parked(10 + i, 15.0 + 7.0 * i as f64, 3.5, CAR)).collect();
    let found = searched(two_lanes(), &row, Pose::new(8.0, 0.0, 0.0), 8.0, 120.0);
    let path = best_free(&found).expect("the present lane is free");
    // as near to the reference line as the row permits
    let nearest = 3.5 - 0.5 * CAR.1 - 0.5 * VEHICLE.width - 0.2;
    for x in [30.0, 60.0, 90.0] {
        assert!(beside(path, x) < nearest, "offset {} m at {x} m", beside(path, x));
    }
    for car in &row {
        assert!(distance(path, car, CAR) >= 0.199, "car {}", car.id);
    }
}
