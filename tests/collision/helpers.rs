//! Worlds, shapes and simple brute-force geometry that the tests share.

use proptest::prelude::*;
use stopline::collision::{
    Allowance, BlockedGrid, CollisionSettings, CollisionWorld, Margins, SafetyMargins, StaticHit, Sweep,
};
use stopline::fixtures::{self, straight_lanelet};
use stopline::geometry::spiral::CubicSpiral;
use stopline::geometry::{Point, Pose, Vector, cross};
use stopline::map::{ConvexPart, Lanelet, Obstacle, Part, Scenario, Shape};

pub(crate) use stopline::fixtures::{circle, lanelet, line, network, obstacle, vehicle};

pub(crate) fn scenario(lanelets: Vec<Lanelet>, obstacles: Vec<Obstacle>) -> Scenario {
    fixtures::scenario(network(lanelets), obstacles)
}

/// A square of asphalt, 400 m wide, around the origin.
pub(crate) fn plain() -> Vec<Lanelet> {
    vec![straight_lanelet(1, (-200.0, 200.0), -200.0, 200.0)]
}

pub(crate) fn straight_road(length: f64, half_width: f64) -> Vec<Lanelet> {
    vec![straight_lanelet(1, (-20.0, length), -half_width, half_width)]
}

pub(crate) fn no_margins() -> CollisionSettings {
    CollisionSettings {
        static_obstacles: Margins::NONE,
        moving_obstacles: Margins::NONE,
        road: 0.0,
        ..CollisionSettings::default()
    }
}

pub(crate) fn world(scenario: &Scenario, settings: &CollisionSettings) -> World {
    World { world: fixtures::collision_world(scenario, &vehicle(), settings, 10.0), margins: settings.margins() }
}

/// A collision world with the margins of all queries.
pub(crate) struct World {
    world: CollisionWorld,
    pub(crate) margins: SafetyMargins,
}

impl std::ops::Deref for World {
    type Target = CollisionWorld;

    fn deref(&self) -> &CollisionWorld {
        &self.world
    }
}

impl World {
    pub(crate) fn hit(&self, start: &Pose, spiral: &CubicSpiral) -> Option<StaticHit> {
        self.hit_from_start(start, spiral, &Allowance::NONE)
    }

    pub(crate) fn hit_from_start(
        &self,
        start: &Pose,
        spiral: &CubicSpiral,
        allowance: &Allowance,
    ) -> Option<StaticHit> {
        self.probe(start, spiral).static_hit(&self.margins, allowance)
    }

    pub(crate) fn blocked(&self, sweeps: &[&Sweep], from: f64, to: f64) -> BlockedGrid {
        self.world.blocked(sweeps, &self.margins, from, to)
    }
}

pub(crate) fn footprint(pose: &Pose) -> Vec<Point> {
    inflated(pose, &Margins::NONE)
}

/// The vehicle with margins at a pose.
pub(crate) fn inflated(pose: &Pose, margins: &Margins) -> Vec<Point> {
    let corners = vehicle().footprint.bounding_rectangle();
    let middle = 0.5 * (corners[0].x + corners[2].x);
    let out = |p: &Point| Vector::new((p.x - middle).signum() * margins.longitudinal, p.y.signum() * margins.lateral);
    corners.iter().map(|p| pose.to_world(p + out(p))).collect()
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
    ring_distance(polygon, p)
}

/// Distance from a convex polygon to a convex polygon, a segment or a circle, 0 if they overlap. Slow and simple.
pub(crate) fn distance(polygon: &[Point], part: &ConvexPart) -> f64 {
    match part {
        ConvexPart::Circle { centre, radius } => (point_distance(polygon, *centre) - radius).max(0.0),
        ConvexPart::Polygon(points) if separation(polygon, points) <= 0.0 => 0.0,
        ConvexPart::Polygon(points) => {
            let from = points.iter().map(|p| point_distance(polygon, *p));
            let to = polygon.iter().map(|p| ring_distance(points, *p));
            from.chain(to).fold(f64::INFINITY, f64::min)
        }
    }
}

/// Distance of a point to the sides of a polygon.
fn ring_distance(ring: &[Point], p: Point) -> f64 {
    let sides = ring.iter().zip(ring.iter().cycle().skip(1)).filter(|(a, b)| a != b);
    sides
        .map(|(a, b)| {
            let share = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
            (p - (a + (b - a) * share)).norm()
        })
        .fold(f64::INFINITY, f64::min)
}

/// Whether the footprint overlaps any piece by more than `by` metres.
pub(crate) fn overlaps(pose: &Pose, pieces: &[ConvexPart], by: f64) -> bool {
    let body = footprint(pose);
    pieces.iter().any(|piece| match piece {
        ConvexPart::Polygon(points) => separation(&body, points) < -by,
        ConvexPart::Circle { centre, radius } => point_distance(&body, *centre) < radius - by,
    })
}

pub(crate) fn spirals(max_curvature: f64) -> impl Strategy<Value = CubicSpiral> {
    let k = -max_curvature..max_curvature;
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
