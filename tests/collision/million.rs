//! A million random sweeps compared with dense sampling: no false negatives.

use std::sync::atomic::{AtomicUsize, Ordering};

use stopline::collision::{Allowance, Blocker, Margins, SafetyMargins};
use stopline::geometry::spiral::CubicSpiral;
use stopline::geometry::{Point, Pose};
use stopline::map::ConvexPart;

use crate::helpers::{no_margins, vehicle};
use crate::random::{Random, RandomMap};

const MAPS: usize = 250;
const SWEEPS_EACH: usize = 4_000;
const OBJECTS: i64 = 24;
/// Distance between the poses of the dense sampling, m.
const DENSE: f64 = 0.05;
/// Smallest depth of an overlap, m: rounding.
const DEPTH: f64 = 1e-9;
/// Maximum number of corners of an object.
const MAX_CORNERS: usize = 8;
/// A free sweep that this margin (m) would stop is a near miss.
const NEAR: f64 = 0.05;

/// A convex polygon, a segment or a circle.
struct Touchable {
    points: Vec<Point>,
    radius: f64,
    centre: Point,
    reach: f64,
    what: Blocker,
}

impl Touchable {
    fn new(points: Vec<Point>, radius: f64, what: Blocker) -> Self {
        let middle = points.iter().fold(nalgebra::Vector2::zeros(), |sum, p| sum + p.coords) / points.len() as f64;
        let centre = Point::from(middle);
        let reach = radius + points.iter().fold(0.0, |m: f64, p| m.max((p - centre).norm()));
        Self { points, radius, centre, reach, what }
    }
}

/// The rectangle of the vehicle without margins, in the rear-axle frame.
struct Rectangle {
    rear: f64,
    front: f64,
    half_width: f64,
}

impl Rectangle {
    fn new() -> Self {
        let [rear_right, _, front_left, _] = vehicle().footprint.bounding_rectangle();
        Self { rear: rear_right.x, front: front_left.x, half_width: front_left.y }
    }

    fn reach(&self) -> f64 {
        self.front.max(-self.rear).hypot(self.half_width)
    }

    /// Whether the rectangle at a pose overlaps an object: separating axes of both, in the frame of the vehicle.
    fn touches(&self, pose: &Pose, object: &Touchable) -> bool {
        let near = self.reach() + object.reach;
        if (object.centre - pose.position).norm_squared() > near * near {
            return false;
        }
        let local = |p: &Point| pose.to_local(*p);
        if object.radius > 0.0 {
            let p = local(&object.points[0]);
            let (dx, dy) = ((self.rear - p.x).max(p.x - self.front).max(0.0), (p.y.abs() - self.half_width).max(0.0));
            return dx.hypot(dy) < object.radius - DEPTH;
        }
        let mut buffer = [Point::origin(); MAX_CORNERS];
        let points = &mut buffer[..object.points.len()];
        points.iter_mut().zip(&object.points).for_each(|(to, from)| *to = local(from));
        let beyond = |f: &dyn Fn(&Point) -> f64| points.iter().all(|p| f(p) > -DEPTH);
        if beyond(&|p| p.x - self.front) || beyond(&|p| self.rear - p.x) {
            return false;
        }
        if beyond(&|p| p.y - self.half_width) || beyond(&|p| -self.half_width - p.y) {
            return false;
        }
        let corners = [
            (self.rear, -self.half_width),
            (self.front, -self.half_width),
            (self.front, self.half_width),
            (self.rear, self.half_width),
        ];
        !(0..points.len()).any(|i| {
            let (a, b) = (points[i], points[(i + 1) % points.len()]);
            let outward = nalgebra::Vector2::new(b.y - a.y, a.x - b.x);
            let length = outward.norm();
            length > 0.0
                && corners.iter().all(|&(x, y)| (x - a.x) * outward.x + (y - a.y) * outward.y > -DEPTH * length)
        })
    }
}

#[derive(Debug, Default, Clone, Copy)]
struct Count {
    sweeps: usize,
    /// Contacts with an obstacle.
    obstacles: usize,
    /// Contacts with the road boundary.
    road: usize,
    /// Hits without a contact at the dense poses.
    false_positives: usize,
    near_misses: usize,
}

/// The first contact of the dense poses: station and blocker.
fn truth(body: &Rectangle, objects: &[Touchable], start: &Pose, spiral: &CubicSpiral) -> Option<(f64, Blocker)> {
    let far = spiral.length + body.reach();
    let close = |t: &&Touchable| (t.centre - start.position).norm() <= far + t.reach;
    let objects: Vec<&Touchable> = objects.iter().filter(close).collect();
    let n = (spiral.length / DENSE).ceil() as usize;
    spiral
        .samples(start, n)
        .find_map(|(s, point)| Some((s, objects.iter().find(|t| body.touches(&point.pose, t))?.what)))
}

fn check_map(seed: u64) -> Count {
    let mut random = Random::new(seed);
    let map = RandomMap::new(&mut random, OBJECTS);
    let bare = map.world(&no_margins());
    let near = Margins::uniform(NEAR);
    let near = SafetyMargins { static_obstacles: near, road: NEAR, ..SafetyMargins::NONE };
    let obstacles = map.scenario.obstacles.iter().flat_map(|o| o.occupied_at(0.0).into_iter().map(|p| (o.id, p)));
    let of_part = |(id, part): (i64, ConvexPart)| match part {
        ConvexPart::Polygon(points) => Touchable::new(points, 0.0, Blocker::Obstacle(id)),
        ConvexPart::Circle { centre, radius } => Touchable::new(vec![centre], radius, Blocker::Obstacle(id)),
    };
    let ring = map.outline.iter().zip(map.outline.iter().cycle().skip(1));
    let edges = ring.map(|(a, b)| Touchable::new(vec![*a, *b], 0.0, Blocker::RoadBoundary));
    let objects: Vec<Touchable> = obstacles.map(of_part).chain(edges).collect();
    let body = Rectangle::new();
    let mut count = Count::default();
    while count.sweeps < SWEEPS_EACH {
        let start = map.start(&mut random);
        if objects.iter().any(|t| body.touches(&start, t)) {
            continue;
        }
        let spiral = random.spiral(0.25, (2.0, 12.0));
        let hit = bare.hit(&start, &spiral);
        count.sweeps += 1;
        match (truth(&body, &objects, &start, &spiral), hit) {
            (Some((s, what)), None) => panic!("{what:?} at {s} m of {start:?} {spiral:?} is missed"),
            (Some((s, what)), Some(hit)) => {
                assert!(hit.station <= s, "{what:?} at {s} m of {start:?} {spiral:?} is hit only at {} m", hit.station);
                *(if what == Blocker::RoadBoundary { &mut count.road } else { &mut count.obstacles }) += 1;
            }
            (None, Some(_)) => count.false_positives += 1,
            (None, None) => {
                count.near_misses +=
                    usize::from(bare.probe(&start, &spiral).static_hit(&near, &Allowance::NONE).is_some());
            }
        }
    }
    count
}

/// The sweeps are the same on every machine. Their counts show that the test covers all outcomes.
#[test]
fn a_million_sweeps_have_no_false_negatives() {
    let (next, threads) = (AtomicUsize::new(0), std::thread::available_parallelism().map_or(1, usize::from));
    let work = || {
        let maps = std::iter::from_fn(|| Some(next.fetch_add(1, Ordering::Relaxed)).filter(|i| *i < MAPS));
        maps.map(|i| check_map(i as u64 + 1)).collect::<Vec<Count>>()
    };
    let counts: Vec<Count> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        workers.into_iter().flat_map(|w| w.join().unwrap_or_else(|e| std::panic::resume_unwind(e))).collect()
    });
    let sum = |of: fn(&Count) -> usize| counts.iter().map(of).sum::<usize>();
    let (sweeps, obstacles, road) = (sum(|c| c.sweeps), sum(|c| c.obstacles), sum(|c| c.road));
    let (false_positives, near) = (sum(|c| c.false_positives), sum(|c| c.near_misses));
    println!(
        "{sweeps} sweeps: {obstacles} touch an obstacle and {road} the road boundary, no false negatives; {false_positives} false positives within the excess, {near} pass within {NEAR} m"
    );
    assert_eq!(sweeps, MAPS * SWEEPS_EACH);
    assert!(obstacles > sweeps / 10 && road > sweeps / 20 && near > sweeps / 200, "too few samples of a kind");
    assert!(false_positives < sweeps / 100, "{false_positives} false positives");
}
