//! Worlds, shapes and slow simple geometry that the tests share.

use proptest::prelude::*;
use stopline::collision::{CollisionSettings, CollisionWorld, Margins};
use stopline::geometry::polyline::Polyline;
use stopline::geometry::spiral::CubicSpiral;
use stopline::geometry::{Point, Pose, Vector, cross};
use stopline::map::{ConvexPart, Lanelet, Motion, Obstacle, ObstacleKind, Part, RoadNetwork, Scenario, Shape};
use stopline::vehicle::{Actuators, Comfort, Footprint, Limits, Tyres, Vehicle};

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

pub(crate) fn line(points: &[(f64, f64)]) -> Polyline {
    Polyline::new(points.iter().map(|&(x, y)| Point::new(x, y))).unwrap()
}

pub(crate) fn lanelet(id: i64, left: Polyline, right: Polyline) -> Lanelet {
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

pub(crate) fn network(lanelets: Vec<Lanelet>) -> RoadNetwork {
    RoadNetwork { lanelets: lanelets.into_iter().map(|l| (l.id, l)).collect(), ..RoadNetwork::default() }
}

pub(crate) fn scenario(lanelets: Vec<Lanelet>, obstacles: Vec<Obstacle>) -> Scenario {
    Scenario {
        id: "test".into(),
        version: "2020a".into(),
        time_step: 0.1,
        network: network(lanelets),
        obstacles,
        occupancy: None,
        problems: vec![],
        issues: vec![],
    }
}

/// A square of asphalt, 400 m wide, around the origin.
pub(crate) fn plain() -> Vec<Lanelet> {
    vec![lanelet(1, line(&[(-200.0, 200.0), (200.0, 200.0)]), line(&[(-200.0, -200.0), (200.0, -200.0)]))]
}

pub(crate) fn straight_road(length: f64, half_width: f64) -> Vec<Lanelet> {
    let bound = |y| line(&[(-20.0, y), (length, y)]);
    vec![lanelet(1, bound(half_width), bound(-half_width))]
}

pub(crate) fn obstacle(id: i64, shape: Shape, motion: Motion) -> Obstacle {
    Obstacle { id, kind: ObstacleKind::Unknown, shape, motion }
}

pub(crate) fn circle(radius: f64) -> Shape {
    Shape { parts: vec![Part::Circle { centre: Point::new(0.0, 0.0), radius }] }
}

pub(crate) fn no_margins() -> CollisionSettings {
    CollisionSettings {
        static_obstacles: Margins::NONE,
        moving_obstacles: Margins::NONE,
        road: 0.0,
        ..CollisionSettings::default()
    }
}

pub(crate) fn world(scenario: &Scenario, settings: &CollisionSettings) -> CollisionWorld {
    CollisionWorld::new(scenario, &vehicle(), settings, 10.0).unwrap()
}

pub(crate) fn footprint(pose: &Pose) -> Vec<Point> {
    vehicle().footprint.bounding_rectangle().iter().map(|p| pose.to_world(*p)).collect()
}

/// Signed separation of convex polygons over the directions of their edges: negative when they overlap. Slow and simple.
pub(crate) fn separation(a: &[Point], b: &[Point]) -> f64 {
    let one_way = |a: &[Point], b: &[Point]| {
        (0..a.len())
            .map(|i| {
                let (from, to) = (a[i], a[(i + 1) % a.len()]);
                let outward = Vector::new(to.y - from.y, from.x - to.x).normalize();
                b.iter().map(|p| outward.dot(&(p - from))).fold(f64::INFINITY, f64::min)
            })
            .fold(f64::NEG_INFINITY, f64::max)
    };
    one_way(a, b).max(one_way(b, a))
}

/// Distance of a point to a convex polygon, 0 inside.
pub(crate) fn point_distance(polygon: &[Point], p: Point) -> f64 {
    let inside =
        (0..polygon.len()).all(|i| cross(polygon[(i + 1) % polygon.len()] - polygon[i], p - polygon[i]) >= 0.0);
    if inside {
        return 0.0;
    }
    let closed = Polyline::new(polygon.iter().chain(std::iter::once(&polygon[0])).copied()).unwrap();
    closed.project(p).offset.abs()
}

/// Whether the footprint overlaps any piece by more than `by` metres.
pub(crate) fn overlaps(pose: &Pose, pieces: &[ConvexPart], by: f64) -> bool {
    let body = footprint(pose);
    pieces.iter().any(|piece| match piece {
        ConvexPart::Polygon(points) => separation(&body, points) < -by,
        ConvexPart::Circle { centre, radius } => point_distance(&body, *centre) < radius - by,
    })
}

pub(crate) fn spirals(tightest: f64) -> impl Strategy<Value = CubicSpiral> {
    let k = -tightest..tightest;
    ([k.clone(), k.clone(), k.clone(), k], 2.0..40.0f64).prop_map(|(knots, length)| CubicSpiral { knots, length })
}

pub(crate) fn shapes() -> impl Strategy<Value = Shape> {
    prop_oneof![
        (0.2..5.0f64, 0.2..2.5f64).prop_map(|(l, w)| Shape::rectangle(l, w)),
        (0.1..2.0f64).prop_map(circle),
        prop::collection::vec((-2.0..2.0f64, -2.0..2.0f64), 3).prop_map(|v| Shape {
            parts: vec![Part::Polygon { vertices: v.into_iter().map(|(x, y)| Point::new(x, y)).collect() }]
        }),
    ]
}

/// Poses of a spiral every `spacing` m.
pub(crate) fn dense(start: &Pose, spiral: &CubicSpiral, spacing: f64) -> Vec<(f64, Pose)> {
    let n = (spiral.length / spacing).ceil() as usize;
    (0..=n).map(|i| spiral.length * i as f64 / n as f64).map(|s| (s, spiral.point_at(start, s).pose)).collect()
}

pub(crate) fn straight(length: f64) -> CubicSpiral {
    CubicSpiral { knots: [0.0; 4], length }
}
