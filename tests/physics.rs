//! The physics rig against closed forms, its own mirror image, and trajectories to track.

use stopline::geometry::Pose;
use stopline::geometry::spiral::CubicSpiral;
use stopline::map::Obstacle;
use stopline::simulation::{Log, Sample, Settings, World};
use stopline::trajectory::{Path, SpeedKnot, SpeedProfile, Trajectory};
use stopline::vehicle::{self, State, Vehicle};

fn bmw() -> Vehicle {
    vehicle::load("bmw_320i").unwrap()
}

fn start(pose: Pose, speed: f64) -> State {
    State { time: 0.0, pose, speed, acceleration: 0.0, yaw_rate: 0.0, steering: 0.0 }
}

fn straight(length: f64) -> Path {
    Path::new(Pose::new(0.0, 0.0, 0.0), &[CubicSpiral { knots: [0.0; 4], length }]).unwrap()
}

/// A profile of pieces (duration s, acceleration m/s², jerk m/s³), from a speed; ends at rest if it comes near it.
fn profile(speed: f64, pieces: &[(f64, f64, f64)]) -> SpeedProfile {
    let mut knot = SpeedKnot { time: 0.0, station: 0.0, speed, acceleration: 0.0, jerk: 0.0 };
    let mut knots = Vec::new();
    for &(t, acceleration, jerk) in pieces.iter().filter(|p| p.0 > 1e-9) {
        knots.push(SpeedKnot { acceleration, jerk, ..knot });
        knot.time += t;
        knot.station += t * (knot.speed + t * (acceleration / 2.0 + t * jerk / 6.0));
        knot.speed += t * (acceleration + t * jerk / 2.0);
    }
    if knot.speed.abs() < 1e-9 {
        knot.speed = 0.0;
    }
    knots.push(knot);
    SpeedProfile::new(knots).unwrap()
}

/// Constant speed for 2 s, then a stop with deceleration `d`, its onset and release taking `ramp` seconds each.
fn stop(speed: f64, d: f64, ramp: f64) -> SpeedProfile {
    let jerk = if ramp > 0.0 { d / ramp } else { 0.0 };
    profile(speed, &[(2.0, 0.0, 0.0), (ramp, 0.0, -jerk), (speed / d - ramp, -d, 0.0), (ramp, -d, jerk)])
}

fn drive(v: &Vehicle, obstacles: &[Obstacle], initial: &State, t: &Trajectory, until: f64, settings: &Settings) -> Log {
    let mut world = World::new(v, obstacles, initial, settings).unwrap();
    let mut log = Log::default();
    world.follow(t, until, &mut log);
    log
}

/// Offset from the wanted pose: ahead and to the left, m.
fn error(s: &Sample) -> (f64, f64) {
    let local = s.wanted_pose.to_local(s.pose.position);
    (local.x, local.y)
}

/// First-order low-pass of a series, both ways (no delay), cut-off in Hz.
fn low_pass(series: &[f64], dt: f64, cut_off: f64) -> Vec<f64> {
    let alpha = 1.0 - (-std::f64::consts::TAU * cut_off * dt).exp();
    let pass = |series: Vec<f64>| {
        let mut state = series[0];
        let filtered = series.into_iter().map(|x| {
            state += alpha * (x - state);
            state
        });
        filtered.collect::<Vec<_>>()
    };
    let mut once = pass(series.to_vec());
    once.reverse();
    let mut twice = pass(once);
    twice.reverse();
    twice
}

fn largest_jerk(acceleration: &[f64]) -> f64 {
    low_pass(acceleration, 0.01, 2.0).windows(2).map(|w| ((w[1] - w[0]) / 0.01).abs()).fold(0.0, f64::max)
}

#[test]
fn stops_end_within_a_decimetre_and_never_beyond_by_more_than_a_centimetre() {
    for name in vehicle::builtin_names() {
        let v = vehicle::load(name).unwrap();
        for speed in [5.0, 8.0, 10.0, 12.5, 15.0] {
            for (d, ramp) in [(1.5, 0.0), (1.5, 0.6), (2.2, 0.0), (2.2, 0.88)] {
                let t = Trajectory { start_time: 0.0, path: straight(200.0), profile: stop(speed, d, ramp) };
                let end = t.profile.last().station;
                let initial = start(Pose::new(0.0, 0.0, 0.0), speed);
                let log = drive(&v, &[], &initial, &t, t.end_time() + 5.0, &Settings::default());
                let furthest = log.samples.iter().map(|s| s.pose.position.x).fold(f64::NEG_INFINITY, f64::max);
                let last = log.samples.last().unwrap();
                let hardest = log.samples.iter().map(|s| -s.acceleration).fold(0.0, f64::max);
                let moving = log.samples.iter().rposition(|s| s.speed.abs() > 0.01).unwrap();
                let driven: Vec<_> = log.samples.iter().map(|s| s.acceleration).collect();
                let planned: Vec<_> = log.samples.iter().map(|s| t.at(s.time).acceleration).collect();
                let (error, beyond) = (last.pose.position.x - end, furthest - end);
                let figures = format!(
                    "{name} {speed:4.1} m/s, {d} m/s², ramp {ramp} s: stop error {error:+.4} m, beyond {beyond:+.4} m, hardest \
                     {hardest:.2} m/s², jerk {:.2} of {:.2} m/s³, at rest {:+.2} s late",
                    largest_jerk(&driven),
                    largest_jerk(&planned),
                    log.samples[moving].time - t.end_time()
                );
                println!("{figures}");
                assert!(error.abs() <= 0.1 && beyond <= 0.012 && last.speed.abs() < 1e-3, "{figures}");
            }
        }
    }
}

#[test]
fn an_s_curve_is_tracked_to_a_decimetre() {
    let v = bmw();
    for (speed, kappa) in
        [(3.0, 0.12), (8.0, 3.0 / 64.0), (12.0, 3.0 / 144.0), (20.0, 3.0 / 400.0), (30.0, 2.0 / 900.0)]
    {
        let spiral = |k: f64| CubicSpiral { knots: [0.0, k, k, 0.0].map(|x| x * 8.0 / 9.0), length: 4.0 * speed };
        let lead = CubicSpiral { knots: [0.0; 4], length: speed };
        let path = Path::new(Pose::new(0.0, 0.0, 0.3), &[lead, spiral(kappa), spiral(-kappa), lead]).unwrap();
        let duration = path.length() / speed;
        let t = Trajectory { start_time: 0.0, path, profile: profile(speed, &[(duration, 0.0, 0.0)]) };
        let log = drive(&v, &[], &start(t.at(0.0).pose, speed), &t, duration, &Settings::default());
        let worst = log.samples.iter().map(|s| error(s).1.abs()).fold(0.0, f64::max);
        let along = log.samples.iter().map(|s| error(s).0.abs()).fold(0.0, f64::max);
        let lateral = log.samples.iter().map(|s| s.lateral_acceleration.abs()).fold(0.0, f64::max);
        let figures = format!("{speed} m/s at {lateral:.2} m/s²: worst {worst:.3} m aside, {along:.3} m along");
        println!("{figures}");
        assert!(worst <= 0.1 && along <= 0.1, "{figures}");
    }
}
