//! Tracking accuracy of the controller in the vehicle simulation: stops over speeds, decelerations, vehicles and the
//! bundled maps, and paths at the comfort limit of lateral acceleration. Each test prints its metrics (`--nocapture`);
//! `docs/physics.md` lists them.

mod steps;
mod tube;

use std::path::Path as File;

use stopline::drive;
use stopline::geometry::Pose;
use stopline::geometry::spiral::CubicSpiral;
use stopline::io::commonroad;
use stopline::simulation::{Log, Sample, Settings, World};
use stopline::trajectory::{Path, SpeedKnot, SpeedProfile, Trajectory};
use stopline::vehicle::{self, State, Vehicle};
use stopline::verdict::zero_phase_low_pass;

/// Cut-off of the verdict's comfort filter, Hz.
const COMFORT_CUTOFF: f64 = 2.0;
/// Rate of the log, Hz.
const RATE: f64 = 100.0;
/// The end of a stop: the time from this long before the planned standstill until this long after it, s.
const END: f64 = 1.0;

/// Limit of the mean stop error, m.
const MAX_BIAS: f64 = 0.1;
/// Limit of each stop error, m.
const MAX_STOP_ERROR: f64 = 0.3;
/// Limit of the filtered jerk at the end of a comfortable stop, m/s³.
const MAX_END_JERK: f64 = 2.0;
/// Limit of the lateral tracking error, m.
const MAX_LATERAL_ERROR: f64 = 0.25;

fn start(pose: Pose, speed: f64) -> State {
    State { time: 0.0, pose, speed, lateral_speed: 0.0, acceleration: 0.0, yaw_rate: 0.0, steering: 0.0 }
}

/// A profile from a speed (m/s) through pieces (duration s, initial acceleration m/s², jerk m/s³).
fn profile(speed: f64, pieces: &[(f64, f64, f64)]) -> SpeedProfile {
    let mut knot = SpeedKnot { time: 0.0, station: 0.0, speed, acceleration: 0.0, jerk: 0.0 };
    let mut knots = Vec::new();
    for &(duration, acceleration, jerk) in pieces.iter().filter(|p| p.0 > 1e-9) {
        knots.push(SpeedKnot { acceleration, jerk, ..knot });
        knot = knots[knots.len() - 1].after(duration);
    }
    let speed = if knot.speed < 1e-9 { 0.0 } else { knot.speed };
    knots.push(SpeedKnot { speed, acceleration: 0.0, jerk: 0.0, ..knot });
    SpeedProfile::new(knots).unwrap()
}

/// Constant speed for 2 s, then a stop with deceleration `d` (m/s²) and ramps of jerk `j` (m/s³). A low speed reduces
/// the deceleration.
fn stop(speed: f64, d: f64, j: f64) -> SpeedProfile {
    let d = d.min((speed * j).sqrt());
    let ramp = d / j;
    profile(speed, &[(2.0, 0.0, 0.0), (ramp, 0.0, -j), (speed / d - ramp, -d, 0.0), (ramp, -d, j)])
}

/// Metrics of a stop.
#[derive(Debug, Clone, Copy)]
struct Stopped {
    /// Final position relative to the planned standstill, positive beyond it, m.
    error: f64,
    /// Farthest position relative to the planned standstill, positive beyond it, m.
    overshoot: f64,
    /// Largest filtered jerk at the end of the stop, m/s³.
    jerk: f64,
}

/// Drives a trajectory to standstill and for several seconds beyond it.
fn drive_to_standstill(v: &Vehicle, initial: &State, t: &Trajectory) -> Stopped {
    let mut world = World::new(v, &[], initial, &Settings::default()).unwrap();
    let mut log = Log::default();
    world.follow(t, t.end_time() + 4.0, &mut log);
    let end = t.at(t.end_time()).pose;
    let ahead = |s: &Sample| end.to_local(s.pose.position).x;
    let last = log.samples.last().unwrap();
    assert!(last.speed.abs() < 1e-3, "still moves at {} m/s", last.speed);
    let acceleration: Vec<f64> = log.samples.iter().map(|s| s.acceleration).collect();
    let filtered = zero_phase_low_pass(&acceleration, COMFORT_CUTOFF, RATE);
    let jerk = filtered.windows(2).zip(&log.samples).filter(|(_, s)| (s.time - t.end_time()).abs() <= END);
    Stopped {
        error: ahead(last),
        overshoot: log.samples.iter().map(ahead).fold(f64::NEG_INFINITY, f64::max),
        jerk: jerk.map(|(w, _)| ((w[1] - w[0]) * RATE).abs()).fold(0.0, f64::max),
    }
}

/// Prints and checks the metrics of several stops.
fn check(what: &str, stops: &[Stopped]) {
    assert!(!stops.is_empty(), "{what}: no stops");
    let max = |f: fn(&Stopped) -> f64| stops.iter().map(f).fold(f64::NEG_INFINITY, f64::max);
    let bias = stops.iter().map(|s| s.error).sum::<f64>() / stops.len() as f64;
    let (worst, overshoot, jerk) = (max(|s| s.error.abs()), max(|s| s.overshoot), max(|s| s.jerk));
    let metrics = format!(
        "{what}, {} stops: bias {bias:+.4} m, worst {worst:.4} m, overshoot {overshoot:+.4} m, jerk at the end {jerk:.2} m/s³",
        stops.len()
    );
    println!("{metrics}");
    assert!(bias.abs() <= MAX_BIAS && worst <= MAX_STOP_ERROR && overshoot <= 0.0, "{metrics}");
}

#[test]
fn comfortable_stops_end_smoothly_before_the_line() {
    for name in vehicle::builtin_names() {
        let v = vehicle::load(name).unwrap();
        let path = Path::new(Pose::new(0.0, 0.0, 0.7), &[CubicSpiral { knots: [0.0; 4], length: 500.0 }]).unwrap();
        for (d, j) in [(0.5, 1.0), (1.0, 1.0), (1.5, 1.5), (2.2, 1.5), (2.2, 2.5), (3.5, 2.5)] {
            let speeds = [2.0, 3.5, 5.0, 8.0, 11.0, 14.0, 17.0, 20.0];
            let stops = speeds.map(|speed| {
                let t = Trajectory { start_time: 0.0, path: path.clone(), profile: stop(speed, d, j) };
                drive_to_standstill(&v, &start(t.at(0.0).pose, speed), &t)
            });
            check(&format!("{name}, {d} m/s², jerk {j} m/s³"), &stops);
            let jerk = stops.iter().map(|s| s.jerk).fold(0.0, f64::max);
            // the simulation adds little to the planned jerk: a plan with 1.5 m/s³ stays below 2 m/s³
            assert!(jerk <= (j + 0.5).max(MAX_END_JERK), "{name}, {d} m/s², {j} m/s³: {jerk}");
            assert!(j > 1.5 || jerk <= MAX_END_JERK, "{name}, {d} m/s², {j} m/s³: {jerk}");
        }
    }
}

/// A stop within the brake lag: the vehicle keeps braking beyond the planned standstill. The lag alone accounts for 5
/// cm.
#[test]
fn emergency_stop_within_the_brake_lag_has_a_small_overshoot() {
    let v = vehicle::load("bmw_320i").unwrap();
    let path = Path::new(Pose::new(0.0, 0.0, 0.0), &[CubicSpiral { knots: [0.0; 4], length: 50.0 }]).unwrap();
    for (speed, d, limit) in [(0.54, 8.3, 0.06), (1.0, 8.0, 0.1), (1.0, 4.0, 0.1)] {
        let t = Trajectory { start_time: 0.0, path: path.clone(), profile: profile(speed, &[(speed / d, -d, 0.0)]) };
        let stopped = drive_to_standstill(&v, &start(t.at(0.0).pose, speed), &t);
        println!("{speed} m/s, {d} m/s²: {:+.3} m", stopped.overshoot);
        assert!(stopped.overshoot <= limit, "{speed} m/s, {d} m/s²: {stopped:?}");
    }
}

/// Drives every fifth committed plan of each bundled map to standstill, from the state in which it was committed.
#[test]
fn committed_plans_of_the_bundled_maps_stop_at_their_end() {
    let folder = File::new(env!("CARGO_MANIFEST_DIR")).join("maps");
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|f| f.unwrap().path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "xml"));
    files.sort();
    let v = vehicle::load("bmw_320i").unwrap();
    let mut stops = Vec::new();
    for file in files {
        let scenario = commonroad::read_file(&file).unwrap();
        let run =
            drive::drive(&scenario, &scenario.problems[0], &v, &drive::Settings::default(), &mut |_, _| {}).unwrap();
        let name = file.file_stem().unwrap().to_string_lossy().into_owned();
        for cycle in run.cycles.iter().step_by(5) {
            let sample = run.log.samples.iter().find(|s| s.time > cycle.plan.time - 1e-6).unwrap();
            let plan = &cycle.plan.trajectory;
            if !plan.profile.ends_at_standstill() || plan.end_time() <= cycle.plan.time || sample.speed < 0.5 {
                continue;
            }
            let Sample { time, pose, speed, lateral_speed, acceleration, yaw_rate, steering, .. } = *sample;
            let state = State { time, pose, speed, lateral_speed, acceleration, yaw_rate, steering };
            let stopped = drive_to_standstill(&v, &state, plan);
            if stopped.error.abs() > 0.05 {
                println!("{name} at {:.1} s, {speed:.1} m/s: {stopped:?}", cycle.plan.time);
            }
            stops.push(stopped);
        }
    }
    check("maps/", &stops);
}

/// Paths with maximum curvature `kappa` (1/m), each scaled so that the curvature builds up in about a second.
fn paths(speed: f64, kappa: f64) -> [(&'static str, Path); 3] {
    let spiral = |k: [f64; 4], seconds: f64| CubicSpiral { knots: k.map(|x| x * kappa), length: speed * seconds };
    // a cubic through 0, k, k, 0 peaks at 9/8 k
    let bow = |sign: f64, seconds: f64| spiral([0.0, 1.0, 1.0, 0.0].map(|x| sign * x * 8.0 / 9.0), seconds);
    let straight = spiral([0.0; 4], 1.0);
    let from = Pose::new(0.0, 0.0, 0.3);
    let of = |spirals: &[CubicSpiral]| Path::new(from, spirals).unwrap();
    let turn = [
        straight,
        spiral([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0], 1.5),
        spiral([1.0; 4], 2.0),
        spiral([1.0, 2.0 / 3.0, 1.0 / 3.0, 0.0], 1.5),
        straight,
    ];
    [
        ("lane change", of(&[straight, bow(1.0, 2.0), bow(-1.0, 2.0), straight])),
        (
            "slalom",
            of(&[straight, bow(1.0, 1.5), bow(-1.0, 3.0), bow(1.0, 3.0), bow(-1.0, 3.0), bow(1.0, 1.5), straight]),
        ),
        ("turn", of(&turn)),
    ]
}

/// Limit of the longitudinal error in tight bends, m.
const MAX_TIGHT_ERROR: f64 = 0.03;

/// Where a tight bend begins and ends, the yaw motion takes up and returns a good part of the kinetic energy.
#[test]
fn tight_bends_at_low_speed_cost_no_distance() {
    for name in vehicle::builtin_names() {
        let v = vehicle::load(name).unwrap();
        let kappa = 0.75 * v.max_curvature();
        let speed = (1.5 / kappa).sqrt().min(2.0);
        // the steering rate stays within 60 % of its limit
        let build_up = kappa * v.wheelbase * speed / (0.6 * v.limits.steering_rate);
        let ramp = |from: f64, to: f64| CubicSpiral {
            knots: [0.0, 1.0, 2.0, 3.0].map(|i| kappa * (from + (to - from) * i / 3.0)),
            length: build_up,
        };
        let straight = CubicSpiral::straight(speed);
        let spirals = [straight, ramp(0.0, 1.0), ramp(1.0, 0.0), ramp(0.0, -1.0), ramp(-1.0, 0.0), straight];
        let path = Path::new(Pose::new(0.0, 0.0, 0.3), &spirals).unwrap();
        let duration = path.length() / speed;
        let t = Trajectory { start_time: 0.0, path, profile: profile(speed, &[(duration, 0.0, 0.0)]) };
        let mut world = World::new(&v, &[], &start(t.at(0.0).pose, speed), &Settings::default()).unwrap();
        let mut log = Log::default();
        world.follow(&t, duration, &mut log);
        let ahead = |s: &Sample| s.reference_pose.to_local(s.pose.position).x.abs();
        let error = log.samples.iter().map(ahead).fold(0.0, f64::max);
        println!("{name}: {error:.3} m longitudinal with up to {kappa:.2} 1/m");
        assert!(error <= MAX_TIGHT_ERROR, "{name}: {error} m with up to {kappa} 1/m");
    }
}

#[test]
fn tracks_paths_at_the_comfort_limit_of_lateral_acceleration() {
    for name in vehicle::builtin_names().iter().copied() {
        let v = vehicle::load(name).unwrap();
        let mut worst = 0.0;
        for speed in [3.0, 5.0, 8.0, 12.0, 16.0, 20.0, 25.0] {
            // near top speed, no drive force remains to compensate the resistance in curves; the robot is a tenth of a
            // car long
            if speed > 0.9 * v.limits.speed || (name == "f1tenth" && speed > 8.0) {
                continue;
            }
            let kappa = (v.comfort.lateral_acceleration / (speed * speed)).min(0.8 * v.max_curvature());
            // keeps the steering rate within 80 % of its limit: κ′ v L, with κ′ v of at most 3 κ per second on these
            // paths
            let kappa = kappa.min(0.8 * v.limits.steering_rate / (3.0 * v.wheelbase));
            for (kind, path) in paths(speed, kappa) {
                let duration = path.length() / speed;
                let t = Trajectory { start_time: 0.0, path, profile: profile(speed, &[(duration, 0.0, 0.0)]) };
                let mut world = World::new(&v, &[], &start(t.at(0.0).pose, speed), &Settings::default()).unwrap();
                let mut log = Log::default();
                world.follow(&t, duration, &mut log);
                let local = |s: &Sample| s.reference_pose.to_local(s.pose.position);
                let lateral = log.samples.iter().map(|s| local(s).y.abs()).fold(0.0, f64::max);
                let longitudinal = log.samples.iter().map(|s| local(s).x.abs()).fold(0.0, f64::max);
                let acceleration = log.samples.iter().map(|s| s.lateral_acceleration.abs()).fold(0.0, f64::max);
                println!(
                    "{name} {kind} {speed:.1} m/s, {acceleration:.2} m/s²: error {lateral:.3} m lateral, {longitudinal:.3} m \
                     longitudinal"
                );
                worst = lateral.max(worst);
                assert!(longitudinal < 0.25, "{name} {kind} {speed} m/s: {longitudinal} m longitudinal");
            }
        }
        println!("{name}: largest lateral error {worst:.3} m");
        assert!(worst <= MAX_LATERAL_ERROR, "{name}: lateral error {worst} m");
    }
}
