//! Speed of the vehicle simulation. Prints the ratio to real time, then the distribution of the time for one second of
//! driving: 10 ms is 100 × real time; and that of the check whether a whole plan can be driven. Each bench asserts that the
//! run is complete before it measures.

use divan::Bencher;
use stopline::fixtures::driving;
use stopline::geometry::Pose;
use stopline::geometry::spiral::CubicSpiral;
use stopline::map::Obstacle;
use stopline::simulation::{Log, Settings, World};
use stopline::trajectory::{Path, SpeedKnot, SpeedProfile, Trajectory};
use stopline::vehicle::{self, State};

fn main() {
    for obstacles in OBSTACLES {
        println!("{obstacles} obstacles: {:.0} × real time", ratio(obstacles));
    }
    divan::main();
}

/// Numbers of moving obstacles.
const OBSTACLES: [usize; 3] = [0, 30, 100];

/// Simulated time divided by computing time, for the fastest of several runs: other processes only prolong a run.
fn ratio(obstacles: usize) -> f64 {
    /// Length of a run, s.
    const DURATION: f64 = 1.0;
    let (world, trajectory) = scene(obstacles);
    let run = || {
        let (mut world, mut log) = (world.clone(), Log::default());
        let start = std::time::Instant::now();
        world.follow(&trajectory, DURATION, &mut log);
        assert!(log.contact.is_none(), "the run is incomplete");
        start.elapsed().as_secs_f64()
    };
    DURATION / (0..30).map(|_| run()).fold(f64::INFINITY, f64::min)
}

/// Moving obstacles in the two lanes beside the vehicle, every 10 m ahead and behind, at its speed or half of it.
fn traffic(count: usize) -> Vec<Obstacle> {
    (0..count)
        .map(|i| {
            let (x, y, speed) =
                (10.0 * (i as f64 / 2.0 - 4.0), if i % 2 == 0 { 4.0 } else { -4.0 }, 12.0 / (1 + i % 2) as f64);
            driving(i as i64, Pose::new(x, y, 0.0), speed, 10.0)
        })
        .collect()
}

/// A vehicle among obstacles, and its reference trajectory.
fn scene(obstacles: usize) -> (World, Trajectory) {
    let vehicle = vehicle::load("bmw_320i").expect("a built-in vehicle");
    let spiral = CubicSpiral { knots: [0.0, 0.002, -0.002, 0.0], length: 100.0 };
    let path = Path::new(Pose::new(0.0, 0.0, 0.0), &[spiral]).expect("one spiral");
    let knot = SpeedKnot { time: 0.0, station: 0.0, speed: 12.0, acceleration: 0.0, jerk: 0.0 };
    let end = SpeedKnot { time: 8.0, station: 96.0, ..knot };
    let profile = SpeedProfile::new(vec![knot, end]).expect("ordered knots");
    let trajectory = Trajectory { start_time: 0.0, path, profile };
    let initial = State {
        time: 0.0,
        pose: Pose::new(0.0, 0.0, 0.0),
        speed: 12.0,
        lateral_speed: 0.0,
        acceleration: 0.0,
        yaw_rate: 0.0,
        steering: 0.0,
    };
    let world = World::new(&vehicle, &traffic(obstacles), &initial, &Settings::default()).expect("a valid world");
    (world, trajectory)
}

#[divan::bench(args = OBSTACLES)]
fn a_second_of_driving(bencher: Bencher<'_, '_>, obstacles: usize) {
    let (world, trajectory) = scene(obstacles);
    let mut log = Log::default();
    world.clone().follow(&trajectory, 1.0, &mut log);
    assert!(log.contact.is_none() && log.samples.len() == 101, "the run is incomplete");
    bencher.with_inputs(|| (world.clone(), Log::default())).bench_local_values(|(mut world, mut log)| {
        world.follow(&trajectory, 1.0, &mut log);
        log
    });
}

/// A plan of 100 m with ten bends: cruise, then a stop with a deceleration, m/s².
fn plan(speed: f64, deceleration: f64) -> Trajectory {
    let bend = 1.4 / (speed * speed);
    let spirals: Vec<CubicSpiral> = (0..10)
        .map(|i| if i % 2 == 0 { bend } else { -bend })
        .map(|k| CubicSpiral { knots: [0.0, k, k, 0.0], length: 10.0 })
        .collect();
    let path = Path::new(Pose::new(0.0, 0.0, 0.0), &spirals).expect("ten spirals");
    let (braking, jerk) = (0.5 * speed * speed / deceleration, 2.5);
    let start = SpeedKnot { time: 0.0, station: 0.0, speed, acceleration: 0.0, jerk: 0.0 };
    let ramp = SpeedKnot { jerk: -jerk, ..start.after((95.0 - braking - speed * deceleration / jerk) / speed) };
    let brakes = SpeedKnot { jerk: 0.0, acceleration: -deceleration, ..ramp.after(deceleration / jerk) };
    let stop = SpeedKnot { acceleration: 0.0, ..brakes.after(brakes.speed / deceleration) };
    let profile = SpeedProfile::new(vec![start, ramp, brakes, stop]).expect("ordered knots");
    Trajectory { start_time: 0.0, path, profile }
}

/// Speed, m/s, and deceleration, m/s²: a comfortable plan and one near the limit of the grip.
const PLANS: [(f64, f64); 2] = [(8.0, 1.5), (12.0, 6.0)];

#[divan::bench(args = PLANS)]
fn a_whole_plan_is_drivable(bencher: Bencher<'_, '_>, (speed, deceleration): (f64, f64)) {
    let vehicle = vehicle::load("bmw_320i").expect("a built-in vehicle");
    let plan = plan(speed, deceleration);
    let used = vehicle.drivable(1.0, &plan).expect("a drivable plan");
    assert!(used.total > 0.2 && used.turning > 0.2, "{used:?}");
    bencher.bench_local(|| vehicle.drivable(1.0, divan::black_box(&plan)));
}
