//! Candidate edges per second: cubic spirals by Newton's method, and their swept footprints against the road boundary
//! and 100 static obstacles beside a two-lane road.
//!
//! The edges are those of a lattice: between nodes on the ego lane and the adjacent lane of a winding road, 10 to 40 m
//! apart, with headings and curvatures of the road. The obstacles are parked cars on both sides; some of them protrude
//! into a lane.

use std::hint::black_box;
use std::time::Instant;

use stopline::collision::{Allowance, CollisionSettings, CollisionWorld, SafetyMargins};
use stopline::fixtures::{collision_world, lanelet, network, parked, scenario, vehicle};
use stopline::geometry::polyline::Polyline;
use stopline::geometry::spiral::{CubicSpiral, connect};
use stopline::geometry::{Pose, wrap_angle};

/// Number of requested edges. Some have no spiral.
const EDGES: usize = 4000;
const OBSTACLES: i64 = 100;
/// Clearance up to which cost terms consider obstacles, m: the default of the lattice.
const DESIRED_CLEARANCE: f64 = 0.8;

/// Random numbers in [0, 1) from a seed: xorshift64* (Vigna, 2016).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.next()
    }
}

/// Pose and curvature at an offset `l` from the centre of the right lane. The heading is that of `road`: 45° plus a
/// sine of 0.2 rad.
fn node(s: f64, l: f64) -> (Pose, f64) {
    const STEP: f64 = 0.1;
    let yaw = |s: f64| 0.785 + 0.2 * (s / 30.0).sin();
    let (mut x, mut y) = (1e5, 2e5);
    for i in 0..(s / STEP).round() as u32 {
        let (sin, cos) = yaw((f64::from(i) + 0.5) * STEP).sin_cos();
        (x, y) = (x + STEP * cos, y + STEP * sin);
    }
    let pose = Pose::new(x, y, yaw(s));
    let curvature = 0.2 / 30.0 * (s / 30.0).cos();
    (Pose { position: pose.position + pose.left() * l, yaw: pose.yaw }, curvature / (1.0 - curvature * l))
}

fn world() -> CollisionWorld {
    let mut random = Random(7);
    let obstacles = (0..OBSTACLES).map(|id| {
        let left = id % 2 == 0;
        // a tenth protrudes into a lane; the others keep a distance of up to three metres
        let inside = random.next() < 0.1;
        let gap = if inside { random.within(-1.0, 0.0) } else { random.within(0.3, 3.0) };
        let l = if left { 5.25 + 0.9 + gap } else { -1.75 - 0.9 - gap };
        let (place, _) = node(2.0 + 2.0 * id as f64, l);
        let place = Pose { yaw: place.yaw + random.within(-0.1, 0.1), ..place };
        parked(id, place, 4.5, 1.8)
    });
    let bound = |l: f64| Polyline::new((0..=125).map(|i| node(2.0 * f64::from(i), l).0.position)).unwrap();
    let lanes = [lanelet(1, bound(-1.75), bound(1.75)), lanelet(2, bound(1.75), bound(5.25))];
    let scenario = scenario(network(lanes), obstacles.collect());
    collision_world(&scenario, &vehicle(), &CollisionSettings::default(), 1.0)
}

fn margins() -> SafetyMargins {
    CollisionSettings::default().margins()
}

/// A boundary-value problem: start pose, start curvature, end pose in the start frame, end curvature.
type Problem = (Pose, f64, Pose, f64);

fn problems() -> Vec<Problem> {
    let mut random = Random(1);
    let problem = |_| {
        let (s, ahead) = (random.within(5.0, 190.0), random.within(10.0, 40.0));
        let from = random.within(-0.7, 4.2);
        // limits the slope to that of lattice edges
        let to = random.within(-0.8, 4.3).clamp(from - 0.25 * ahead, from + 0.25 * ahead);
        let ((start, k0), (end, k1)) = (node(s, from), node(s + ahead, to));
        let local = Pose { position: start.to_local(end.position), yaw: wrap_angle(end.yaw - start.yaw) };
        (start, k0, local, k1)
    };
    (0..EDGES).map(problem).collect()
}

fn solve(p: &Problem) -> Option<CubicSpiral> {
    connect(p.1, &p.2, p.3).ok()
}

/// Items per second. The shortest of several runs counts for each chunk, because other processes only prolong a run.
fn rate<T>(items: &[T], work: impl Fn(&T)) -> f64 {
    const RUNS: usize = 30;
    const CHUNK: usize = 100;
    let best = |chunk: &[T]| {
        let time = |_| {
            let clock = Instant::now();
            chunk.iter().for_each(&work);
            clock.elapsed().as_secs_f64()
        };
        (0..RUNS).map(time).fold(f64::INFINITY, f64::min)
    };
    items.len() as f64 / items.chunks(CHUNK).map(best).sum::<f64>()
}

/// Prints the rates.
pub(crate) fn print() {
    let (world, problems) = (world(), problems());
    let spirals: Vec<(Pose, CubicSpiral)> = problems.iter().filter_map(|p| Some((p.0, solve(p)?))).collect();
    let length: f64 = spirals.iter().map(|(_, s)| s.length).sum();
    let mut free = 0;
    for (start, spiral) in &spirals {
        free += usize::from(world.probe(start, spiral).static_hit(&margins(), &Allowance::NONE).is_none());
    }
    let n = spirals.len();
    println!(
        "edge_rate: {n} lattice edges of {:.1} m on average, {:.0} % free, against {OBSTACLES} obstacles and 250 m of road",
        length / n as f64,
        100.0 * free as f64 / n as f64,
    );
    let solving = rate(&problems, |p| {
        black_box(solve(p));
    });
    println!("  solve only                {solving:>10.0} edges/s");
    let each = |work: &dyn Fn(&Pose, &CubicSpiral)| rate(&spirals, |(start, s)| work(start, s));
    let both = |work: &dyn Fn(&Pose, &CubicSpiral)| rate(&problems, |p| solve(p).iter().for_each(|s| work(&p.0, s)));
    let check = |start: &Pose, spiral: &CubicSpiral| {
        black_box(world.probe(start, spiral).static_hit(&margins(), &Allowance::NONE));
    };
    let cost = |start: &Pose, spiral: &CubicSpiral| {
        let mut probe = world.probe(start, spiral);
        black_box((probe.static_hit(&margins(), &Allowance::NONE), probe.clearance(DESIRED_CLEARANCE)));
    };
    let line = |name: &str, rate: f64| println!("  {name:<25} {rate:>10.0} edges/s");
    line("check only", each(&check));
    line("solve and check", both(&check));
    line("check and clearance", each(&cost));
    line("solve, check, clearance", both(&cost));
}
