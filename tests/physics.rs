//! The vehicle simulation: closed forms, symmetry, tracking and contacts.

use stopline::fixtures::{self, knot, obstacle};
use stopline::geometry::spiral::CubicSpiral;
use stopline::geometry::{Point, Pose, Vector};
use stopline::map::{Cell, Motion, Obstacle, ObstacleKind, OccupancyGrid, Part, Shape, TimedOccupancy, TimedPose};
use stopline::simulation::{Command, GRAVITY, Log, Sample, Settings, Touched, World};
use stopline::trajectory::{Path, SpeedKnot, SpeedProfile, Trajectory};
use stopline::vehicle::{self, State, Vehicle};

fn bmw() -> Vehicle {
    vehicle::load("bmw_320i").unwrap()
}

fn start(pose: Pose, speed: f64) -> State {
    State { time: 0.0, pose, speed, lateral_speed: 0.0, acceleration: 0.0, yaw_rate: 0.0, steering: 0.0 }
}

fn straight(length: f64) -> Path {
    fixtures::straight(Pose::new(0.0, 0.0, 0.0), length)
}

/// A profile from a speed (m/s) through pieces (duration s, acceleration m/s², jerk m/s³). A final speed near zero
/// becomes zero.
fn profile(speed: f64, pieces: &[(f64, f64, f64)]) -> SpeedProfile {
    let mut knot = knot(0.0, 0.0, speed, 0.0);
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

/// Constant speed for 2 s, then a stop with deceleration `d` (m/s²), with ramps of `ramp` seconds at its start and end.
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

/// Longitudinal and lateral offset from the reference pose, m.
fn error(s: &Sample) -> (f64, f64) {
    let local = s.reference_pose.to_local(s.pose.position);
    (local.x, local.y)
}

/// First-order low-pass filter, forwards and backwards (zero phase); cut-off in Hz.
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

/// Limits of the tracking error of a vehicle.
struct Tolerances {
    /// Longitudinal and lateral error, m.
    error: f64,
    /// Overshoot of a stop, m.
    overshoot: f64,
    /// Maximum speed in curves, m/s.
    max_speed: f64,
}

/// Cars track within a decimetre. The truck has twice the brake lag and softer tyres, and the robot car is a tenth of a
/// car long: both stay within a quarter of a metre.
fn tolerances(name: &str) -> Tolerances {
    match name {
        "truck" => Tolerances { error: 0.25, overshoot: 0.01, max_speed: 22.0 },
        "f1tenth" => Tolerances { error: 0.25, overshoot: 0.01, max_speed: 8.0 },
        _ => Tolerances { error: 0.1, overshoot: 0.003, max_speed: 30.0 },
    }
}

#[test]
fn stops_within_a_decimetre_with_an_overshoot_of_at_most_a_centimetre() {
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
                let (error, overshoot) = (last.pose.position.x - end, furthest - end);
                let metrics = format!(
                    "{name} {speed:4.1} m/s, {d} m/s², ramp {ramp} s: stop error {error:+.4} m, overshoot {overshoot:+.4} m, \
                     deceleration {hardest:.2} m/s², jerk {:.2} (planned {:.2}) m/s³, standstill {:+.2} s late",
                    largest_jerk(&driven),
                    largest_jerk(&planned),
                    log.samples[moving].time - t.end_time()
                );
                println!("{metrics}");
                let limit = tolerances(name).overshoot;
                assert!(error.abs() <= 0.1 && overshoot <= limit && last.speed.abs() < 1e-3, "{metrics}");
            }
        }
    }
}

#[test]
fn tracks_an_s_curve() {
    // the curvature and lateral acceleration of each vehicle limit these values: a truck has a larger turning radius
    // and a lower comfort limit than a car
    let kinds: [(f64, f64); 5] =
        [(3.0, 0.12), (8.0, 3.0 / 64.0), (12.0, 3.0 / 144.0), (20.0, 3.0 / 400.0), (30.0, 2.0 / 900.0)];
    let cases = vehicle::builtin_names().iter().flat_map(|name| kinds.map(|(speed, kappa)| (*name, speed, kappa)));
    for (name, speed, kappa) in cases {
        let v = vehicle::load(name).unwrap();
        if speed > tolerances(name).max_speed {
            continue;
        }
        let kappa = kappa.min(0.8 * v.max_curvature()).min(v.comfort.lateral_acceleration / (speed * speed));
        let spiral = |k: f64| CubicSpiral { knots: [0.0, k, k, 0.0].map(|x| x * 8.0 / 9.0), length: 4.0 * speed };
        let lead = CubicSpiral { knots: [0.0; 4], length: speed };
        let path = Path::new(Pose::new(0.0, 0.0, 0.3), &[lead, spiral(kappa), spiral(-kappa), lead]).unwrap();
        let duration = path.length() / speed;
        let t = Trajectory { start_time: 0.0, path, profile: profile(speed, &[(duration, 0.0, 0.0)]) };
        let log = drive(&v, &[], &start(t.at(0.0).pose, speed), &t, duration, &Settings::default());
        let lateral = log.samples.iter().map(|s| error(s).1.abs()).fold(0.0, f64::max);
        let longitudinal = log.samples.iter().map(|s| error(s).0.abs()).fold(0.0, f64::max);
        let acceleration = log.samples.iter().map(|s| s.lateral_acceleration.abs()).fold(0.0, f64::max);
        let metrics = format!(
            "{name} {speed} m/s at {acceleration:.2} m/s²: error {lateral:.3} m lateral, {longitudinal:.3} m longitudinal"
        );
        println!("{metrics}");
        assert!(lateral.max(longitudinal) <= tolerances(name).error, "{metrics}");
    }
}

/// A trajectory that accelerates, turns left and right, and brakes to standstill.
fn varied(origin: Pose, mirror: f64) -> Trajectory {
    let spiral = |k: f64| CubicSpiral { knots: [0.0, mirror * k, mirror * k, 0.0], length: 30.0 };
    let path = Path::new(origin, &[spiral(0.03), spiral(-0.03), spiral(0.01)]).unwrap();
    let pieces = [
        (1.0, 0.0, 1.5),
        (2.0, 1.5, 0.0),
        (1.0, 1.5, -1.5),
        (2.0, 0.0, 0.0),
        (1.0, 0.0, -2.0),
        (3.75, -2.0, 0.0),
        (1.0, -2.0, 2.0),
    ];
    Trajectory { start_time: 0.0, path, profile: profile(5.0, &pieces) }
}

fn drive_varied(origin: Pose, mirror: f64, settings: &Settings) -> Log {
    let t = varied(origin, mirror);
    drive(&bmw(), &[], &start(origin, 5.0), &t, t.end_time() + 2.0, settings)
}

/// The largest distance between two runs, m, with the poses of the first run mapped by a function.
fn max_distance(a: &Log, b: &Log, map: impl Fn(&Pose) -> Pose) -> f64 {
    assert_eq!(a.samples.len(), b.samples.len());
    a.samples.iter().zip(&b.samples).map(|(p, q)| (map(&p.pose).position - q.pose.position).norm()).fold(0.0, f64::max)
}

#[test]
fn mirrored_inputs_give_the_mirrored_run() {
    let origin = Pose::new(0.0, 0.0, 0.0);
    let (left, right) =
        (drive_varied(origin, 1.0, &Settings::default()), drive_varied(origin, -1.0, &Settings::default()));
    assert!(left.samples.iter().any(|s| s.pose.position.y.abs() > 3.0), "the run does not turn");
    let worst = max_distance(&left, &right, |p| Pose::new(p.position.x, -p.position.y, -p.yaw));
    // rounding errors only: the sum of the four wheel forces has a fixed order
    assert!(worst < 1e-9, "{worst} m");
    for (a, b) in left.samples.iter().zip(&right.samples) {
        assert!(
            (a.steering + b.steering).abs() < 1e-9 && (a.lateral_acceleration + b.lateral_acceleration).abs() < 1e-6
        );
    }
}

#[test]
fn utm_coordinates_give_the_same_run() {
    let near = drive_varied(Pose::new(0.0, 0.0, 0.7), 1.0, &Settings::default());
    let (x, y) = (691_234.567, 5_334_765.432);
    let far = drive_varied(Pose::new(x, y, 0.7), 1.0, &Settings::default());
    let worst = max_distance(&near, &far, |p| Pose::new(p.position.x + x, p.position.y + y, p.yaw));
    // f64 resolves 1e-9 m at 5e6 m
    assert!(worst < 1e-6, "{worst} m");
}

#[test]
fn half_the_step_changes_the_run_by_millimetres() {
    let origin = Pose::new(0.0, 0.0, 0.0);
    let coarse = drive_varied(origin, 1.0, &Settings::default());
    let fine = drive_varied(origin, 1.0, &Settings { step: 0.0005, ..Settings::default() });
    let worst = max_distance(&coarse, &fine, |p| *p);
    println!("half the step: {worst:.5} m");
    assert!(worst < 0.005, "{worst} m");
}

#[test]
fn run_in_pieces_equals_the_whole_run_and_clones_are_independent() {
    let t = varied(Pose::new(0.0, 0.0, 0.0), 1.0);
    let traffic = [crossing(7, Point::new(200.0, 30.0), Vector::new(0.0, -3.0), 12.0)];
    let world = World::new(&bmw(), &traffic, &start(t.at(0.0).pose, 5.0), &Settings::default()).unwrap();
    let (mut whole, mut pieces, mut branched) = (Log::default(), Log::default(), Log::default());
    world.clone().follow(&t, 8.0, &mut whole);
    let mut stepwise = world.clone();
    for k in 1..=80 {
        if k == 41 {
            let mut branch = stepwise.clone();
            branch.hold(Command { acceleration: -5.0, steering: 0.0 }, 8.0, &mut branched);
            assert!(branch.state().speed.abs() < 1e-3, "the branch does not stop");
        }
        stepwise.follow(&t, 0.1 * f64::from(k), &mut pieces);
    }
    assert_eq!(whole, pieces);
    assert_eq!(branched.samples[0].time, 4.0);
    assert!(
        whole.samples.windows(2).all(|w| (w[1].time - w[0].time - 0.01).abs() < 1e-9),
        "not 100 samples per second"
    );
    assert_eq!(whole.samples[0].time, 0.0);
}

#[test]
fn deceleration_lag_matches_the_brake_time_constant() {
    let v = bmw();
    let mut world = World::new(
        &v,
        &[],
        &start(Pose::new(0.0, 0.0, 0.0), 15.0),
        &Settings { log_rate_hz: 1000.0, ..Settings::default() },
    )
    .unwrap();
    let mut log = Log::default();
    world.hold(Command { acceleration: 0.0, steering: 0.0 }, 1.0, &mut log);
    let coasting = log.samples.last().unwrap().acceleration;
    world.hold(Command { acceleration: -3.0, steering: 0.0 }, 2.0, &mut log);
    let end = log.samples.last().unwrap().acceleration;
    let level = coasting + (end - coasting) * (1.0 - (-1.0f64).exp());
    let lag = log.samples.iter().find(|s| s.acceleration < level).unwrap().time - 1.0;
    // tyre relaxation and wheel inertia add to the lag of the actuator
    assert!(lag >= v.actuators.brake_lag && lag < v.actuators.brake_lag + 0.03, "{lag} s");
}

#[test]
fn full_braking_distance_matches_the_closed_form() {
    let v = bmw();
    for (scale, speed) in [(1.0, 30.0), (0.6, 20.0), (0.2, 10.0)] {
        let settings = Settings { friction_scale: scale, ..Settings::default() };
        let mut world = World::new(&v, &[], &start(Pose::new(0.0, 0.0, 0.4), speed), &settings).unwrap();
        let mut log = Log::default();
        world.hold(Command { acceleration: -50.0, steering: 0.0 }, 20.0, &mut log);
        let (first, last) = (log.samples[0], *log.samples.last().unwrap());
        let distance = (last.pose.position - first.pose.position).norm();
        let (grip, c) = (scale * v.tyres.friction * GRAVITY, v.tyres.drag / v.mass);
        // closed form with drag, plus the brake lag
        let shortest = (1.0 + c * speed * speed / grip).ln() / (2.0 * c);
        let expected = shortest + speed * v.actuators.brake_lag;
        println!("μ·{scale}, {speed} m/s: {distance:.2} m, closed form {expected:.2} m");
        assert!(distance > shortest && distance < 1.04 * expected, "{distance} {expected}");
        assert!(last.speed.abs() < 1e-6);
        for s in &log.samples {
            // the logged acceleration is that of the previous step, with slightly higher drag
            let limit = grip + c * s.speed * s.speed + 1e-3;
            assert!(-s.acceleration <= limit, "{} m/s² at {} s, limit {limit}", s.acceleration, s.time);
        }
        // the brakes never move the vehicle backwards, but the tyres release their deflection: at most 3 μ σ / c, at
        // which a brush tyre slides
        let deflection = 3.0 * scale * v.tyres.friction * v.tyres.relaxation_length / v.tyres.longitudinal;
        let furthest = log.samples.iter().map(|s| (s.pose.position - first.pose.position).norm()).fold(0.0, f64::max);
        assert!(furthest - distance < deflection, "rolls back {} m", furthest - distance);
    }
}

#[test]
fn parked_car_stays_in_place_for_a_minute() {
    let v = bmw();
    for steering in [0.0, 0.5] {
        let initial = State { steering, ..start(Pose::new(100.0, -20.0, 1.0), 0.0) };
        let path =
            Path::new(initial.pose, &[CubicSpiral { knots: [steering.tan() / v.wheelbase; 4], length: 10.0 }]).unwrap();
        let t = Trajectory { start_time: 0.0, path, profile: profile(0.0, &[(1.0, 0.0, 0.0)]) };
        let log = drive(&v, &[], &initial, &t, 60.0, &Settings::default());
        let moved = log.samples.iter().map(|s| (s.pose.position - initial.pose.position).norm()).fold(0.0, f64::max);
        let fastest = log.samples.iter().map(|s| s.speed.abs()).fold(0.0, f64::max);
        assert!(moved < 1e-6 && fastest < 1e-6, "{moved} m, {fastest} m/s");
    }
}

#[test]
fn stopped_car_stands_still() {
    let t = varied(Pose::new(0.0, 0.0, 0.0), 1.0);
    let log = drive(&bmw(), &[], &start(t.at(0.0).pose, 5.0), &t, t.end_time() + 60.0, &Settings::default());
    let settled = log.samples.iter().find(|s| s.time > t.end_time() + 3.0).unwrap();
    for s in log.samples.iter().filter(|s| s.time > settled.time) {
        assert!((s.pose.position - settled.pose.position).norm() < 1e-6, "creeps at {} s", s.time);
        assert!(s.acceleration.abs() < 1e-3, "jitters at {} s", s.time);
    }
}

#[test]
fn tracks_a_curve_from_standstill_to_standstill() {
    let v = bmw();
    let pieces =
        [(1.0, 0.0, 1.0), (3.0, 1.0, 0.0), (1.0, 1.0, -1.0), (1.0, 0.0, -1.0), (3.0, -1.0, 0.0), (1.0, -1.0, 1.0)];
    let path =
        Path::new(Pose::new(0.0, 0.0, 0.0), &[CubicSpiral { knots: [0.15, 0.1, 0.0, -0.1], length: 30.0 }]).unwrap();
    let t = Trajectory { start_time: 1.0, path, profile: profile(0.0, &pieces) };
    let initial = State { steering: v.steering_for_curvature(0.15), ..start(Pose::new(0.0, 0.0, 0.0), 0.0) };
    let log = drive(&v, &[], &initial, &t, t.end_time() + 3.0, &Settings::default());
    let lateral = log.samples.iter().map(|s| error(s).1.abs()).fold(0.0, f64::max);
    let longitudinal = log.samples.iter().map(|s| error(s).0.abs()).fold(0.0, f64::max);
    let (stop_error, _) = error(log.samples.last().unwrap());
    println!(
        "standstill to standstill: {lateral:.3} m lateral, {longitudinal:.3} m longitudinal, stop {stop_error:+.4} m"
    );
    assert!(lateral < 0.1 && longitudinal < 0.1 && stop_error.abs() < 0.02);
    assert!(log.samples.iter().all(|s| s.speed > -0.01), "the vehicle reverses");
}

#[test]
fn returns_from_an_offset_start_with_little_overshoot() {
    for speed in [3.0, 10.0, 25.0] {
        let t = Trajectory {
            start_time: 0.0,
            path: straight(300.0),
            profile: profile(speed, &[(300.0 / speed, 0.0, 0.0)]),
        };
        let log = drive(&bmw(), &[], &start(Pose::new(0.0, 0.5, 0.05), speed), &t, 10.0, &Settings::default());
        let lowest = log.samples.iter().map(|s| s.pose.position.y).fold(f64::INFINITY, f64::min);
        let last = log.samples.last().unwrap().pose.position.y;
        let steepest = log.samples.iter().map(|s| s.lateral_acceleration.abs()).fold(0.0, f64::max);
        println!("{speed} m/s: overshoot {lowest:.3} m, remaining {last:.4} m, {steepest:.2} m/s²");
        assert!(last.abs() < 0.02 && lowest > -0.1, "{speed} m/s: {lowest} {last}");
    }
}

/// A box of the size of a pedestrian that passes the point `at` at the time `when` (s).
fn crossing(id: i64, at: Point, velocity: Vector, when: f64) -> Obstacle {
    let state = |k: i32| {
        let time = 0.1 * f64::from(k);
        let p = at + velocity * (time - when);
        TimedPose { time, pose: Pose::new(p.x, p.y, velocity.y.atan2(velocity.x)), speed: velocity.norm() }
    };
    Obstacle {
        id,
        kind: ObstacleKind::Pedestrian,
        shape: Shape::rectangle(0.5, 0.5),
        motion: Motion::Trajectory((0..=200).map(state).collect()),
    }
}

fn parked(id: i64, x: f64, y: f64) -> Obstacle {
    fixtures::parked(id, Pose::new(x, y, 0.0), 4.0, 2.0)
}

fn along_x(speed: f64) -> Trajectory {
    Trajectory { start_time: 0.0, path: straight(300.0), profile: profile(speed, &[(300.0 / speed, 0.0, 0.0)]) }
}

#[test]
fn contact_with_a_parked_car_has_the_right_time_and_place() {
    let v = bmw();
    let obstacles = [parked(3, 60.0, 5.0), parked(42, 50.0, 1.0), parked(4, 80.0, 0.0)];
    let log = drive(&v, &obstacles, &start(Pose::new(0.0, 0.0, 0.0), 10.0), &along_x(10.0), 20.0, &Settings::default());
    let contact = log.contact.unwrap();
    let expected = (48.0 - v.front_overhang_from_rear_axle()) / 10.0;
    assert_eq!(contact.with, Touched::Obstacle(42));
    assert!((contact.time - expected).abs() < 0.005, "{} s, expected {expected} s", contact.time);
    assert!((contact.at_rear_axle_frame.x - v.front_overhang_from_rear_axle()).abs() < 0.02, "{contact:?}");
    assert!(
        (-0.01..=0.5 * v.width + 0.01).contains(&contact.at_rear_axle_frame.y),
        "not on the left half of the front: {contact:?}"
    );
    assert!((contact.speed - 10.0).abs() < 0.1);
    let last = log.samples.last().unwrap();
    assert!(last.time - contact.time < 0.0021, "the run continues after the contact: {} s", last.time);
}

#[test]
fn distinguishes_a_near_miss_from_a_contact() {
    let v = bmw();
    for (gap, hit) in [(0.02, false), (-0.02, true)] {
        let obstacle = parked(1, 50.0, 1.0 + 0.5 * v.width + gap);
        let log =
            drive(&v, &[obstacle], &start(Pose::new(0.0, 0.0, 0.0), 10.0), &along_x(10.0), 12.0, &Settings::default());
        assert_eq!(log.contact.is_some(), hit, "gap {gap} m");
    }
}

#[test]
fn hits_a_crossing_obstacle_only_at_its_time() {
    let v = bmw();
    for (when, hit) in [(5.0, true), (3.0, false), (7.0, false)] {
        let obstacle = crossing(9, Point::new(52.0, 0.0), Vector::new(0.0, 2.0), when);
        let log =
            drive(&v, &[obstacle], &start(Pose::new(0.0, 0.0, 0.0), 10.0), &along_x(10.0), 10.0, &Settings::default());
        assert_eq!(log.contact.map(|c| c.with), hit.then_some(Touched::Obstacle(9)), "crossing at {when} s");
    }
}

#[test]
fn detects_contacts_of_a_stopped_car_from_all_sides_and_at_high_speed() {
    let v = bmw();
    let standstill = Trajectory { start_time: 0.0, path: straight(10.0), profile: profile(0.0, &[(1.0, 0.0, 0.0)]) };
    for velocity in [Vector::new(8.0, 0.0), Vector::new(0.0, -8.0), Vector::new(-60.0, 0.0), Vector::new(80.0, 80.0)] {
        let obstacle = crossing(5, Point::new(1.4, 0.0), velocity, 6.0);
        let log = drive(&v, &[obstacle], &start(Pose::new(0.0, 0.0, 0.0), 0.0), &standstill, 8.0, &Settings::default());
        let contact = log.contact.unwrap_or_else(|| panic!("{velocity} passes through"));
        let reach = 3.7 / velocity.norm();
        assert!(contact.time > 6.0 - reach && contact.time < 6.0, "{velocity}: {} s", contact.time);
    }
}

/// One occupied cell of 0.4 m about 50 m ahead, in a large rotated grid.
#[test]
fn contact_with_an_occupied_cell_has_the_right_time() {
    let v = bmw();
    let (east, north, side, count) = (4.2e5, 5.1e6, 0.4, 1000_usize);
    for (yaw, y, hit) in [(0.0, 0.0, true), (0.7, 0.3, true), (-2.0, 1.1, false), (0.0, -1.3, false)] {
        // the centre of the grid's middle cell is at (50, y)
        let half = 0.5 * side * count as f64;
        let corner = Pose::new(0.0, 0.0, yaw).to_world(Point::new(half + 0.5 * side, half + 0.5 * side));
        let origin = Pose::new(east + 50.0 - corner.x, north + y - corner.y, yaw);
        let mut cells = vec![Cell::Free; count * count];
        cells[count / 2 * count + count / 2] = Cell::Occupied;
        // neither unknown cells nor occupied cells elsewhere are contacts
        cells[count / 2 * count + count / 2 - 1] = Cell::Unknown;
        cells[0] = Cell::Occupied;
        let grid = OccupancyGrid::new(origin, side, count, count, cells).unwrap();
        let start = start(Pose::new(east, north, 0.0), 10.0);
        let t = Trajectory { path: fixtures::straight(start.pose, 300.0), ..along_x(10.0) };
        let mut world = World::new(&v, &[], &start, &Settings::default()).unwrap().with_occupancy(&grid);
        let mut log = Log::default();
        world.follow(&t, 9.0, &mut log);
        let Some(contact) = log.contact else {
            assert!(!hit, "drives through the cell at yaw {yaw}");
            continue;
        };
        assert!(hit, "unexpected contact at yaw {yaw}, y {y}: {contact:?}");
        assert_eq!(contact.with, Touched::OccupiedCell);
        // a rotated square extends farther back
        let reach = 0.5 * side * (yaw.cos().abs() + yaw.sin().abs());
        let expected = (50.0 - reach - v.front_overhang_from_rear_axle()) / 10.0;
        assert!((contact.time - expected).abs() < 0.005, "{} s, expected {expected} s", contact.time);
    }
}

#[test]
fn regions_exist_only_in_their_interval_and_obstacles_until_their_prediction_ends() {
    let v = bmw();
    let region = |from: f64, to: f64| {
        let sets = vec![
            TimedOccupancy { from, to, region: wall(50.0) },
            TimedOccupancy { from: to, to: to + 0.1, region: wall(500.0) },
        ];
        obstacle(8, Shape::rectangle(1.0, 1.0), Motion::Occupancy(sets))
    };
    for (from, to, hit) in [(0.0, 3.0, None), (4.0, 9.0, Some(4.532)), (5.0, 5.05, Some(5.0)), (6.0, 7.0, None)] {
        let log = drive(
            &v,
            &[region(from, to)],
            &start(Pose::new(0.0, 0.0, 0.0), 10.0),
            &along_x(10.0),
            9.0,
            &Settings::default(),
        );
        match (log.contact, hit) {
            (None, None) => {}
            (Some(c), Some(time)) => {
                assert!((c.time - time).abs() < 0.002 && c.with == Touched::Obstacle(8), "{from}…{to}: {c:?}")
            }
            other => panic!("{from}…{to}: {other:?}"),
        }
    }
    // the prediction ends after 3 s
    let mut short = crossing(6, Point::new(52.0, 0.0), Vector::new(0.0, 1e-9), 0.0);
    if let Motion::Trajectory(states) = &mut short.motion {
        states.truncate(31);
    }
    let log = drive(&v, &[short], &start(Pose::new(0.0, 0.0, 0.0), 10.0), &along_x(10.0), 9.0, &Settings::default());
    assert_eq!(log.contact, None);
}

/// A wall across the road, as a set-based region in world coordinates.
fn wall(x: f64) -> Shape {
    let rectangle = Part::Rectangle { centre: Pose::new(x, 0.0, 0.0), length: 2.0, width: 8.0 };
    Shape { parts: vec![rectangle] }
}

#[test]
fn contact_at_the_start_ends_the_run_at_once() {
    let mut world =
        World::new(&bmw(), &[parked(2, 1.0, 0.0)], &start(Pose::new(0.0, 0.0, 0.0), 10.0), &Settings::default())
            .unwrap();
    let mut log = Log::default();
    world.follow(&along_x(10.0), 1.0, &mut log);
    assert_eq!(log.contact.map(|c| (c.with, c.time)), Some((Touched::Obstacle(2), 0.0)));
    let state = world.state();
    let mut again = Log::default();
    world.follow(&along_x(10.0), 2.0, &mut again);
    assert_eq!((world.state(), again.contact, world.has_ended()), (state, log.contact, true));
}

#[test]
fn invalid_input_is_a_named_error() {
    let v = bmw();
    let valid = start(Pose::new(0.0, 0.0, 0.0), 1.0);
    let fails = |obstacles: &[Obstacle], state: &State, settings: &Settings| {
        World::new(&v, obstacles, state, settings).err().expect("accepted").to_string()
    };
    assert!(fails(&[], &State { speed: f64::NAN, ..valid }, &Settings::default()).contains("initial state"));
    assert!(fails(&[], &valid, &Settings { step: -1.0, ..Settings::default() }).contains("step"));
    assert!(fails(&[parked(17, f64::INFINITY, 0.0)], &valid, &Settings::default()).contains("obstacle 17"));
    let no_shape = Obstacle { shape: Shape { parts: vec![] }, ..parked(18, 0.0, 50.0) };
    assert!(fails(&[no_shape], &valid, &Settings::default()).contains("obstacle 18"));
    let flat = Part::Circle { centre: Point::new(0.0, 0.0), radius: f64::NAN };
    let bad_circle = Obstacle { shape: Shape { parts: vec![flat] }, ..parked(19, 0.0, 50.0) };
    assert!(fails(&[bad_circle], &valid, &Settings::default()).contains("obstacle 19"));
}

#[test]
fn commands_that_are_not_finite_end_the_run() {
    let v = bmw();
    let mut world = World::new(&v, &[], &start(Pose::new(0.0, 0.0, 0.0), 10.0), &Settings::default()).unwrap();
    let mut log = Log::default();
    world.follow(&along_x(10.0), 1.0, &mut log);
    assert_eq!(log.broke_at, None);
    for command in
        [Command { acceleration: f64::NAN, steering: 0.0 }, Command { acceleration: 0.0, steering: f64::INFINITY }]
    {
        let (mut world, mut log) = (world.clone(), log.clone());
        world.hold(command, 2.0, &mut log);
        assert_eq!((log.broke_at, world.has_ended()), (Some(1.0), true));
    }
}

#[test]
fn tracks_an_s_curve_on_a_wet_road() {
    let v = bmw();
    let settings = Settings { friction_scale: 0.5, ..Settings::default() };
    let spiral = |k: f64| CubicSpiral { knots: [0.0, k, k, 0.0], length: 45.0 };
    let path = Path::new(Pose::new(0.0, 0.0, 0.0), &[spiral(3.0 / 144.0), spiral(-3.0 / 144.0)]).unwrap();
    let t = Trajectory { start_time: 0.0, path, profile: profile(12.0, &[(7.5, 0.0, 0.0)]) };
    let log = drive(&v, &[], &start(Pose::new(0.0, 0.0, 0.0), 12.0), &t, 7.5, &settings);
    let worst = log.samples.iter().map(|s| error(s).1.abs()).fold(0.0, f64::max);
    println!("wet: lateral error {worst:.3} m");
    assert!(worst < 0.25, "{worst} m");
}
