//! Random maps from a seed: a winding road with small convex objects, and spirals among them.

use stopline::collision::CollisionSettings;
use stopline::geometry::polyline::Polyline;
use stopline::geometry::spiral::CubicSpiral;
use stopline::geometry::{Point, Pose, Vector};
use stopline::map::{Motion, Obstacle, Part, Scenario, Shape};

use crate::helpers::{World, circle, lanelet, obstacle, scenario, world};

/// Numbers in [0, 1) from a seed: xorshift64* (Vigna 2016).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        let mut random = Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        for _ in 0..8 {
            random.next();
        }
        random
    }

    pub(crate) fn next(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(crate) fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.next()
    }

    /// Knots up to `max_curvature` (1/m) times a random scale.
    pub(crate) fn spiral(&mut self, max_curvature: f64, lengths: (f64, f64)) -> CubicSpiral {
        let scale = max_curvature * self.next();
        CubicSpiral {
            knots: std::array::from_fn(|_| self.within(-scale, scale)),
            length: self.within(lengths.0, lengths.1),
        }
    }
}

/// A winding road with objects on it.
pub(crate) struct RandomMap {
    /// Poses of the centre line of the road, 2 m apart.
    pub(crate) middle: Vec<Pose>,
    pub(crate) half_width: f64,
    /// The outline of the surface, a ring.
    pub(crate) outline: Vec<Point>,
    pub(crate) scenario: Scenario,
}

impl RandomMap {
    /// 90 m of road, 6 to 16 m wide, that bends with a radius of 15 m at least; `objects` of 0.2 to 2 m on it, one in a
    /// hundred of 5 m.
    pub(crate) fn new(random: &mut Random, objects: i64) -> Self {
        let spiral = random.spiral(0.035, (89.0, 90.0));
        let start = Pose::new(random.within(-900.0, 900.0), random.within(-900.0, 900.0), random.within(-3.1, 3.1));
        let middle: Vec<Pose> = spiral.sampled(&start, 45).into_iter().map(|(_, p)| p.pose).collect();
        let half_width = random.within(3.0, 8.0);
        let side = |l: f64| middle.iter().map(move |p| p.position + p.left() * l).collect::<Vec<Point>>();
        let (left, right) = (side(half_width), side(-half_width));
        let outline = right.iter().chain(left.iter().rev()).copied().collect();
        let lanes = vec![lanelet(1, Polyline::new(right).unwrap(), Polyline::new(left).unwrap())];
        let obstacles: Vec<Obstacle> = (0..objects).map(|id| object(random, id, &middle, half_width)).collect();
        Self { middle, half_width, outline, scenario: scenario(lanes, obstacles) }
    }

    pub(crate) fn world(&self, settings: &CollisionSettings) -> World {
        world(&self.scenario, settings)
    }

    /// A pose on the road, roughly in its direction, with road ahead.
    pub(crate) fn start(&self, random: &mut Random) -> Pose {
        let i = random.within(2.0, 0.6 * self.middle.len() as f64) as usize;
        let l = random.within(-1.0, 1.0) * (self.half_width - 1.0);
        let at = self.middle[i];
        Pose { position: at.position + at.left() * l, yaw: at.yaw + random.within(-0.4, 0.4) }
    }
}

/// A rectangle, circle or convex polygon somewhere on the road.
fn object(random: &mut Random, id: i64, middle: &[Pose], half_width: f64) -> Obstacle {
    let at = middle[random.within(0.0, middle.len() as f64) as usize];
    let size = if random.next() < 0.01 { 5.0 } else { random.within(0.2, 2.0) };
    let shape = match id % 3 {
        0 => Shape::rectangle(size, random.within(0.1, 1.0) * size),
        1 => circle(0.5 * size),
        _ => {
            let n = random.within(3.0, 8.0) as u32;
            let stretched = random.within(0.2, 1.0);
            let corner = |i: u32| {
                let angle = std::f64::consts::TAU * (f64::from(i) + 0.3 * f64::from(i * i % 3)) / f64::from(n);
                Point::origin() + Vector::new(0.5 * size * angle.cos(), 0.5 * size * stretched * angle.sin())
            };
            Shape { parts: vec![Part::Polygon { vertices: (0..n).map(corner).collect() }] }
        }
    };
    let l = random.within(-half_width, half_width);
    let pose = Pose { position: at.position + at.left() * l, yaw: random.within(-3.1, 3.1) };
    obstacle(id, shape, Motion::Static(pose))
}
