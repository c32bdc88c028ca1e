//! A planning cycle and its stages: a winding road of three lanes with 30 moving cars and one parked car on 100 m, and
//! more than a hundred candidate edges. Each bench asserts its results before it measures.
//!
//! `first_cycle` builds the stored edges. `steady_cycle` is a later cycle of a run in which the vehicle follows its
//! plan exactly. `RAYON_NUM_THREADS` sets the number of threads; the default is one.

use divan::{Bencher, black_box};
use stopline::collision::{Allowance, CollisionSettings, CollisionWorld, SafetyMargins};
use stopline::fixtures::{self, lanelet};
use stopline::geometry::Pose;
use stopline::geometry::polyline::Polyline;
use stopline::lattice::refine::{Commitment, RefinementSettings, refined};
use stopline::lattice::{EdgeStore, Lattice, LatticeContext, LatticePath, Root};
use stopline::map::{
    Lanelet, Motion, Neighbour, Obstacle, ObstacleKind, PlanningProblem, RoadNetwork, Scenario, Shape, TimedPose,
};
use stopline::planner::{Decision, Observation, Plan, Planner, Settings};
use stopline::reference::{ReferenceLine, ReferenceSettings};
use stopline::speed::smoothing::{self, Smoother};
use stopline::speed::{AccelerationLimits, Resolution, SpeedProblem, Strategy, search};
use stopline::vehicle::{Comfort, State, Vehicle};

fn main() {
    // one thread, so that results are comparable between machines
    let threads = std::env::var("RAYON_NUM_THREADS").ok().and_then(|n| n.parse().ok()).unwrap_or(1);
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().expect("the first pool of this process");
    divan::main();
}

/// Lanes from right to left.
const LANES: [i64; 3] = [1, 2, 3];
const LANE_WIDTH: f64 = 3.5;
/// The ego lane.
const OWN: i64 = 2;
const SPEED: f64 = 12.0;

/// Poses along the middle of the road, every 2 m.
fn middle() -> Vec<Pose> {
    let yaw = |s: f64| 0.6 + 0.25 * (s / 60.0).sin();
    let mut pose = Pose::new(1e5, 2e5, yaw(0.0));
    (0..200)
        .map(|i| {
            let here = pose;
            pose = here.advanced(2.0);
            pose.yaw = yaw(2.0 * f64::from(i + 1));
            here
        })
        .collect()
}

/// The pose `s` metres along the middle of the road, `l` to the left of it.
fn on_road(s: f64, l: f64) -> Pose {
    let poses = middle();
    let i = ((s / 2.0) as usize).min(poses.len() - 1);
    let pose = poses[i].advanced(s - 2.0 * i as f64);
    Pose { position: pose.position + pose.left() * l, yaw: pose.yaw }
}

fn network() -> RoadNetwork {
    let line = |l: f64| Polyline::new(middle().iter().map(|p| p.position + p.left() * l)).unwrap();
    let neighbour = |id: i64| LANES.contains(&id).then_some(Neighbour { id, same_direction: true });
    let lane = |id: i64| {
        let centre = (id - OWN) as f64 * LANE_WIDTH;
        Lanelet {
            centre: line(centre),
            adjacent_left: neighbour(id + 1),
            adjacent_right: neighbour(id - 1),
            speed_limit: Some(15.0),
            types: vec!["urban".into()],
            ..lanelet(id, line(centre - 0.5 * LANE_WIDTH), line(centre + 0.5 * LANE_WIDTH))
        }
    };
    fixtures::network(LANES.map(lane))
}

/// 30 cars around and ahead of the vehicle, a column of ten on each lane, at 7 to 11 m/s; and one parked car.
fn scenario() -> Scenario {
    let shape = Shape::rectangle(4.5, 1.8);
    let columns = LANES.iter().flat_map(|lane| (0..10).map(move |i| (*lane, i)));
    let driven = columns.map(|(lane, i)| {
        let speed = 9.0 + 2.0 * (lane - OWN) as f64;
        // the first car on the ego lane is 25 m ahead
        let from = if lane == OWN { 70.0 } else { 20.0 } + 10.0 * f64::from(i) + 3.0 * lane as f64;
        let states = (0..=150).map(|k| {
            let time = 0.1 * f64::from(k);
            TimedPose { time, pose: on_road(from + speed * time, (lane - OWN) as f64 * LANE_WIDTH), speed }
        });
        (100 + 10 * lane + i64::from(i), Motion::Trajectory(states.collect()))
    });
    let parked = std::iter::once((1, Motion::Static(on_road(150.0, 1.7 * LANE_WIDTH))));
    let obstacle = |(id, motion)| Obstacle { id, kind: ObstacleKind::Vehicle, shape: shape.clone(), motion };
    let obstacles = driven.chain(parked).map(obstacle).collect();
    Scenario { problems: vec![problem()], ..fixtures::scenario(network(), obstacles) }
}

fn problem() -> PlanningProblem {
    let goal = fixtures::goal(on_road(300.0, 0.0), 20.0, LANE_WIDTH, 60.0);
    fixtures::problem(on_road(40.0, 0.0), SPEED, goal)
}

fn initial(vehicle: &Vehicle) -> State {
    let pose = vehicle.rear_axle_of_centre(&problem().initial.centre);
    State { time: 0.0, pose, speed: SPEED, lateral_speed: 0.0, acceleration: 0.0, yaw_rate: 0.0, steering: 0.0 }
}

/// The default margins.
fn margins() -> SafetyMargins {
    CollisionSettings::default().margins()
}

/// Input of the stages.
struct Stages {
    scenario: Scenario,
    vehicle: Vehicle,
    settings: Settings,
    lattice: Lattice,
    world: CollisionWorld,
    reference: ReferenceLine,
}

impl Stages {
    fn new() -> Self {
        let (scenario, vehicle, settings) = (scenario(), vehicle(), Settings::default());
        assert_eq!(scenario.obstacles.iter().filter(|o| !o.is_static()).count(), 30);
        let world = fixtures::collision_world(&scenario, &vehicle, &CollisionSettings::default(), 15.0);
        let reference = ReferenceLine::new(&scenario.network, &[OWN], vehicle.width, &ReferenceSettings::default());
        let lattice = Lattice::new(settings.lattice.clone()).unwrap();
        Self { world, reference: reference.unwrap(), scenario, vehicle, settings, lattice }
    }

    fn context(&self) -> LatticeContext<'_> {
        LatticeContext {
            reference: &self.reference,
            world: &self.world,
            margins: margins(),
            max_curvature: self.vehicle.max_curvature(),
            full_speed_curvature: self.vehicle.comfort.lateral_acceleration / (SPEED * SPEED),
            half_width: 0.5 * self.vehicle.width,
            target: None,
        }
    }

    fn root(&self) -> Root {
        let pose = initial(&self.vehicle).pose;
        Root { pose, curvature: 0.0, kept: vec![], start: pose, allowance: Allowance::NONE }
    }

    fn paths(&self, store: &mut EdgeStore) -> Vec<LatticePath> {
        self.lattice.search(&self.context(), &self.root(), SPEED, 100.0, store).paths
    }

    /// The speed problem on the path of least cost, with a constant speed limit.
    fn speed_problem(&self) -> SpeedProblem {
        let best = self.paths(&mut EdgeStore::default()).remove(0);
        let sweeps: Vec<_> = best.sweeps.iter().map(AsRef::as_ref).collect();
        let grid = self.world.blocked(&sweeps, &margins(), 0.0, 15.0);
        assert!(!grid.is_free(), "the path is free of obstacles");
        let intervals = |cell| grid.intervals(cell).iter().map(|b| (b.from, b.to)).collect::<Vec<_>>();
        SpeedProblem {
            speed_limits: vec![15.0; grid.cells() + 1],
            blocked: (0..grid.cells()).map(intervals).collect(),
            blocked_at_start: intervals(0),
            stopping_allowed: vec![true; grid.cells() + 1],
            start_speed: SPEED,
            start_time: 0.0,
            horizon: 15.0,
            limits: AccelerationLimits { acceleration: 1.5, deceleration: 1.5, aggressive_deceleration: 2.2 },
            stations: grid.stations().to_vec(),
        }
    }
}

#[divan::bench]
fn reference_line_400_m(bencher: Bencher) {
    let stages = Stages::new();
    let settings = ReferenceSettings::default();
    bencher.bench_local(|| {
        ReferenceLine::new(&stages.scenario.network, black_box(&[OWN]), stages.vehicle.width, &settings)
    });
}

/// With an empty edge store.
#[divan::bench]
fn lattice_first(bencher: Bencher) {
    let stages = Stages::new();
    assert_eq!(stages.paths(&mut EdgeStore::default()).len(), stages.settings.lattice.candidates);
    bencher.bench_local(|| stages.paths(&mut EdgeStore::default()));
}

/// With a filled edge store: only the edges from the root are new.
#[divan::bench]
fn lattice_steady(bencher: Bencher) {
    let stages = Stages::new();
    let mut store = EdgeStore::default();
    stages.paths(&mut store);
    let (context, mut root) = (stages.context(), stages.root());
    bencher.bench_local(|| {
        // a new root each time, because the store caches the result for a root
        root.start = root.start.advanced(1e-4);
        root.pose = root.start;
        stages.lattice.search(&context, &root, SPEED, 100.0, &mut store)
    });
}

/// Refinement of a chain that starts two metres beside the reference line.
#[divan::bench]
fn refinement(bencher: Bencher) {
    let stages = Stages::new();
    let (context, settings) = (stages.context(), RefinementSettings::default());
    let beside = stages.root();
    let pose = Pose { position: beside.pose.position + beside.pose.left() * 2.0, ..beside.pose };
    let root = Root { pose, start: pose, ..beside };
    let found = stages.lattice.search(&context, &root, SPEED, 100.0, &mut EdgeStore::default()).paths;
    let (front, weights) = (stages.vehicle.front_overhang_from_rear_axle(), stages.settings.lattice.weights);
    let refine = |path: &LatticePath| {
        refined(&context, path, &Allowance::NONE, front, &weights, &Commitment::default(), &settings)
    };
    let long = found.into_iter().filter(|p| p.path.pieces().count() >= 3);
    let best =
        long.into_iter().find(|p| refine(p).is_some()).expect("a chain of three edges that the refinement improves");
    println!("{} edges", best.path.pieces().count());
    bencher.bench_local(|| refine(black_box(&best)));
}

/// The blocked grid of one candidate, computed for the first time.
#[divan::bench]
fn blocked_grid(bencher: Bencher) {
    let stages = Stages::new();
    let best = stages.paths(&mut EdgeStore::default()).remove(0);
    bencher
        .with_inputs(|| stages.world.sweep_path(&best.path))
        .bench_local_refs(|sweep| stages.world.blocked(black_box(&[sweep]), &margins(), 0.0, 15.0));
}

/// The blocked grid of one candidate from the cache of its sweeps.
#[divan::bench]
fn blocked_grid_kept(bencher: Bencher) {
    let stages = Stages::new();
    let best = stages.paths(&mut EdgeStore::default()).remove(0);
    let sweeps: Vec<_> = best.sweeps.iter().map(AsRef::as_ref).collect();
    bencher.bench_local(|| stages.world.blocked(black_box(&sweeps), &margins(), 0.0, 15.0));
}

/// The speed search of one candidate.
#[divan::bench]
fn speed_search(bencher: Bencher) {
    let problem = Stages::new().speed_problem();
    let resolution = Resolution { expansions: Settings::default().expansions, ..Resolution::default() };
    let found = || search(black_box(&problem), Strategy::SafeTlp, &resolution);
    assert!(found().unwrap().proven().is_some());
    bencher.bench_local(found);
}

/// Smoothing and proof of the selected candidate.
#[divan::bench]
fn smoothing_and_proof(bencher: Bencher) {
    let problem = Stages::new().speed_problem();
    let found = search(&problem, Strategy::SafeTlp, &Resolution::default()).unwrap().proven().expect("a plan");
    let raw = smoothing::raw_profile(&problem, &found).unwrap();
    let smoother = Smoother::new(smoothing::Settings::default()).unwrap();
    bencher.bench_local(|| smoother.smooth_and_prove(black_box(&problem), &problem.speed_limits, &raw, 0.0));
}

/// The first cycle of a run. The setup (scenario, routes, collision worlds, reference lines) is not timed.
#[divan::bench(sample_size = 1)]
fn first_cycle(bencher: Bencher) {
    let stages = Stages::new();
    let observation = stages.observation(initial(&stages.vehicle));
    bencher.with_inputs(|| stages.planner(&observation)).bench_local_refs(|planner| planner.cycle(&observation));
}

/// Later cycles of a run. Each starts from the state that the previous plan prescribes.
#[divan::bench(sample_size = 1, sample_count = 30)]
fn steady_cycle(bencher: Bencher) {
    let stages = Stages::new();
    let mut observation = stages.observation(initial(&stages.vehicle));
    let mut planner = stages.planner(&observation);
    let first = planner.traced_cycle(&observation).unwrap();
    assert_eq!(first.plan.decision, Decision::NewPlan, "no plan");
    assert!(first.trace.candidates.len() > 10);
    let mut last = first.plan;
    bencher.bench_local(|| {
        observation.state = after(&last, 0.1, &stages.vehicle);
        last = planner.cycle(&observation).unwrap();
    });
}

impl Stages {
    fn observation(&self, state: State) -> Observation {
        Observation::of_scenario(&self.scenario, &self.scenario.problems[0], state)
    }

    /// A planner that has built its worlds and lanes.
    fn planner(&self, observation: &Observation) -> Planner<'_> {
        let mut planner = Planner::new(self.scenario.map(), &self.vehicle, &self.settings).unwrap();
        assert_eq!(planner.no_lane(observation).unwrap(), None);
        planner
    }
}

/// The state after the vehicle has followed the plan exactly for `interval` seconds.
fn after(plan: &Plan, interval: f64, vehicle: &Vehicle) -> State {
    let time = plan.time + interval;
    let point = plan.trajectory.at(time);
    State {
        time,
        pose: point.pose,
        speed: point.speed,
        lateral_speed: 0.0,
        acceleration: point.acceleration,
        yaw_rate: point.speed * point.curvature,
        steering: vehicle.steering_for_curvature(point.curvature),
    }
}

/// A car with the paper's comfort limits.
fn vehicle() -> Vehicle {
    let comfort = Comfort {
        acceleration: 1.5,
        deceleration: 1.5,
        aggressive_deceleration: 2.2,
        lateral_acceleration: 1.8,
        jerk: 2.0,
    };
    Vehicle { comfort, ..fixtures::vehicle() }
}
