//! The vehicle simulation against closed forms and published vehicle models, without planner and controller.
//!
//! Each test prints its measured values (`--nocapture`); `docs/physics.md` has the table.

#[path = "../examples/maneuvers/open_loop.rs"]
#[allow(dead_code)] // the example uses the other items
mod open_loop;

use open_loop::{Instant, MANEUVERS, TICK, bare, spin_factor};
use stopline::geometry::{Point, Pose};
use stopline::simulation::{Command, FrictionRegion, GRAVITY, Log, Sample, Settings, World};
use stopline::vehicle::{self, State, Vehicle};

/// Every step is logged.
const EACH_STEP: Settings =
    Settings { step: 0.001, log_rate_hz: 1000.0, control_rate_hz: 1000.0, friction_scale: 1.0, anti_lock: true };

/// Largest accepted differences from the reference models: yaw rate and lateral acceleration against ST, then against
/// MB, RMS over RMS. `docs/physics.md` explains them.
const LARGEST_SHARES: [(&str, [f64; 4]); 4] = [
    ("step_steer", [0.02, 0.03, 0.09, 0.09]),
    ("ramp_steer", [0.03, 0.05, 0.09, 0.08]),
    ("slalom", [0.04, 0.07, 0.06, 0.11]),
    ("brake_in_turn", [0.08, 0.09, 0.15, 0.15]),
];

fn bmw() -> Vehicle {
    vehicle::load("bmw_320i").unwrap()
}

fn at_speed(speed: f64) -> State {
    State {
        time: 0.0,
        pose: Pose::new(0.0, 0.0, 0.0),
        speed,
        lateral_speed: 0.0,
        acceleration: 0.0,
        yaw_rate: 0.0,
        steering: 0.0,
    }
}

/// Understeer gradient of the linear single-track model with stiffness proportional to load, rad s²/m.
fn understeer_gradient(v: &Vehicle) -> f64 {
    (1.0 / v.tyres.cornering_front - 1.0 / v.tyres.cornering_rear) / GRAVITY
}

/// Steering angle of the linear single-track model for a lateral acceleration at a speed, rad.
fn linear_steering(v: &Vehicle, lateral: f64, speed: f64) -> f64 {
    lateral * (v.wheelbase / (speed * speed) + understeer_gradient(v))
}

/// The last sample of a turn in which an ideal cruise control alone keeps the speed.
fn steady_turn(v: &Vehicle, speed: f64, steering: f64, duration: f64) -> Sample {
    let v = bare(v, EACH_STEP.step);
    let mut world = World::new(&v, &[], &State { steering, ..at_speed(speed) }, &Settings::default()).unwrap();
    let mut log = Log::default();
    let mut effort = 0.0;
    for tick in 1..=(duration / TICK).round() as usize {
        let error = speed - world.state().speed;
        effort += 2.0 * error * TICK;
        world.hold(Command { acceleration: 5.0 * error + effort, steering }, TICK * tick as f64, &mut log);
    }
    *log.samples.last().unwrap()
}

#[test]
fn steady_yaw_rate_matches_the_linear_single_track_model() {
    let lateral = 0.2 * GRAVITY;
    for (name, speeds) in [
        ("bmw_320i", [10.0, 20.0, 35.0]),
        ("ford_escort", [10.0, 20.0, 35.0]),
        ("truck", [10.0, 15.0, 22.0]),
        ("f1tenth", [2.0, 3.0, 4.0]),
    ] {
        let v = vehicle::load(name).unwrap();
        for speed in speeds {
            for side in [1.0, -1.0] {
                let steering = side * linear_steering(&v, lateral, speed);
                let s = steady_turn(&v, speed, steering, 20.0);
                let expected = s.speed * steering / (v.wheelbase + understeer_gradient(&v) * s.speed * s.speed);
                let off = s.yaw_rate / expected - 1.0;
                let report = format!(
                    "{name} {speed} m/s, {:+.3} m/s²: yaw rate {:+.5} rad/s, linear {expected:+.5} rad/s, {:+.2} %",
                    s.lateral_acceleration,
                    s.yaw_rate,
                    100.0 * off
                );
                println!("{report}");
                // above 5 m/s, 0.2 g is beyond the linear range of the robot's soft tyres
                assert!(off.abs() <= 0.02 && (s.lateral_acceleration.abs() / lateral - 1.0).abs() < 0.05, "{report}");
            }
        }
    }
}

#[test]
fn understeer_gradient_follows_the_cornering_stiffnesses() {
    // understeering, oversteering (below its critical speed), neutral
    for (front, rear) in [(18.0, 26.0), (26.0, 18.0), (21.92, 21.92)] {
        let mut v = bmw();
        (v.tyres.cornering_front, v.tyres.cornering_rear) = (front, rear);
        // ISO 4138: steering in addition to that of the path's curvature, over the lateral acceleration
        let beyond = |lateral: f64| {
            let steering = linear_steering(&v, lateral, 20.0);
            let s = steady_turn(&v, 20.0, steering, 30.0);
            (steering - (v.wheelbase * s.yaw_rate / s.speed).atan(), s.lateral_acceleration)
        };
        let (low, high) = (beyond(0.1), beyond(0.3));
        let (gradient, expected) = ((high.0 - low.0) / (high.1 - low.1), understeer_gradient(&v));
        println!("stiffness {front}/{rear}: {:.5} °s²/m of {:.5}", gradient.to_degrees(), expected.to_degrees());
        // 2 % of the contribution of one axle's slip: the gradient is a difference and may be zero
        let scale = 1.0 / (front.min(rear) * GRAVITY);
        assert!((gradient - expected).abs() < 0.02 * scale, "{gradient} {expected}");
    }
}

#[test]
fn rear_slip_angle_follows_the_brush_curve() {
    let v = bmw();
    let grip = v.tyres.friction * GRAVITY;
    for share in [0.1, 0.3, 0.5, 0.7, 0.8] {
        let s = steady_turn(&v, 20.0, linear_steering(&v, share * grip, 20.0), 20.0);
        // g(ρ) = 1 − (1 − ρ/3)³ solved for ρ = c tan α/μ (Pacejka 2012, section 3.2)
        let share = s.lateral_acceleration / grip;
        let expected = (3.0 * v.tyres.friction / v.tyres.cornering_rear * (1.0 - (1.0 - share).cbrt())).atan();
        let slip = (-s.lateral_speed / s.speed).atan();
        println!("{:.1} % of the grip: slip {slip:.5} rad, brush {expected:.5} rad", 100.0 * share);
        assert!((slip / expected - 1.0).abs() < 0.03, "{slip} {expected}");
    }
}

#[test]
fn a_slide_uses_nearly_all_of_the_grip_and_no_more() {
    for scale in [1.0, 0.5, 0.2] {
        let v = bare(&bmw(), EACH_STEP.step);
        let grip = scale * v.tyres.friction * GRAVITY;
        let settings = Settings { friction_scale: scale, ..EACH_STEP };
        let mut world = World::new(&v, &[], &at_speed(20.0), &settings).unwrap();
        let mut log = Log::default();
        world.hold(Command { acceleration: 0.0, steering: 0.4 }, 2.0, &mut log);
        let peak = log.samples.iter().map(|s| s.lateral_acceleration.hypot(s.acceleration)).fold(0.0, f64::max);
        println!("μ·{scale}: {peak:.3} m/s² of {grip:.3}");
        assert!(peak <= grip * (1.0 + 1e-9) && peak > 0.97 * grip, "{peak} of {grip}");
    }
}

#[test]
fn stopping_distance_matches_v_squared_over_two_mu_g() {
    for (scale, speed, anti_lock) in [
        (1.0, 30.0, false),
        (1.0, 20.0, false),
        (0.6, 20.0, false),
        (0.2, 10.0, false),
        (1.0, 30.0, true),
        (1.0, 20.0, true),
        (0.6, 20.0, true),
        (0.2, 10.0, true),
    ] {
        let mut v = bare(&bmw(), EACH_STEP.step);
        // enough to lock the front wheels at full grip
        v.limits.deceleration = 30.0;
        let settings = Settings { friction_scale: scale, anti_lock, ..EACH_STEP };
        let mut world = World::new(&v, &[], &at_speed(speed), &settings).unwrap();
        let mut log = Log::default();
        world.hold(Command { acceleration: -50.0, steering: 0.0 }, 20.0, &mut log);
        let distance = log.samples.last().unwrap().pose.position.x;
        let expected = speed * speed / (2.0 * scale * v.tyres.friction * GRAVITY);
        let off = distance / expected - 1.0;
        let kind = if anti_lock { "anti-lock" } else { "locked" };
        println!("{kind} μ·{scale}, {speed} m/s: {distance:.3} m, v²/2μg {expected:.3} m, {:+.2} %", 100.0 * off);
        // anti-lock uses 98 % of the grip, and load transfer to the front takes time
        let limit = if anti_lock { 0.04 } else { 0.01 };
        assert!(off.abs() <= limit, "{kind}: {distance} {expected}");
    }
}

#[test]
fn coasting_matches_drag_and_rolling_resistance() {
    for name in vehicle::builtin_names() {
        let v = vehicle::load(name).unwrap();
        let (speed, duration) = (0.8 * v.limits.speed, 10.0);
        let mut world = World::new(&v, &[], &at_speed(speed), &Settings::default()).unwrap();
        let mut log = Log::default();
        // the drive force, which kept the speed, decays first
        world.hold(Command { acceleration: 0.0, steering: 0.0 }, 3.0, &mut log);
        let before = world.state().speed;
        world.hold(Command { acceleration: 0.0, steering: 0.0 }, 3.0 + duration, &mut log);
        // v̇ = −(A + B v²): v = √(A/B) tan(atan(v₀ √(B/A)) − √(AB) t)
        let factor = spin_factor(&v);
        let (a, b) = (v.tyres.rolling_resistance * GRAVITY / factor, v.tyres.drag / (v.mass * factor));
        let expected = (a / b).sqrt() * ((before * (b / a).sqrt()).atan() - (a * b).sqrt() * duration).tan();
        let loss = before - world.state().speed;
        println!("{name}: {loss:.4} m/s lost in {duration} s, closed form {:.4} m/s", before - expected);
        assert!((loss / (before - expected) - 1.0).abs() < 0.005, "{name}");
    }
}

#[test]
fn full_drive_converts_the_power_into_speed() {
    let v = bare(&bmw(), EACH_STEP.step);
    let (speed, duration) = (20.0, 5.0);
    let mut world = World::new(&v, &[], &at_speed(speed), &Settings::default()).unwrap();
    let mut log = Log::default();
    world.hold(Command { acceleration: 50.0, steering: 0.0 }, duration, &mut log);
    // P = m a v_s: v² = v₀² + 2 P t/m; tyre slip dissipates a part
    let power = v.limits.acceleration * v.limits.switching_speed;
    let expected = (speed * speed + 2.0 * power * duration / spin_factor(&v)).sqrt();
    let reached = world.state().speed;
    println!("{reached:.3} m/s after {duration} s at full power, closed form {expected:.3} m/s");
    assert!((reached - speed) / (expected - speed) > 0.97 && reached <= expected, "{reached} {expected}");
}

#[test]
fn actuator_time_constants_match_the_vehicle() {
    for name in vehicle::builtin_names() {
        let mut v = vehicle::load(name).unwrap();
        // drag would decrease while the brakes are measured
        v.tyres.drag = 0.0;
        let speed = 0.25 * v.limits.speed;
        let response = |command: Command, measured: fn(&Sample) -> f64| {
            let mut world = World::new(&v, &[], &at_speed(speed), &EACH_STEP).unwrap();
            let mut log = Log::default();
            let idle = Command { acceleration: 0.0, steering: 0.0 };
            world.hold(idle, 2.0, &mut log);
            let before = measured(log.samples.last().unwrap());
            world.hold(command, 4.0, &mut log);
            let end = measured(log.samples.last().unwrap());
            let level = 1.0 - (-1.0f64).exp();
            let reached = |s: &&Sample| s.time > 2.0 && (measured(s) - before) / (end - before) >= level;
            log.samples.iter().find(reached).unwrap().time - 2.0
        };
        let drive = response(Command { acceleration: 0.3, steering: 0.0 }, |s| s.acceleration);
        let brake = response(Command { acceleration: -0.3, steering: 0.0 }, |s| s.acceleration);
        let steering = response(Command { acceleration: 0.0, steering: 1e-4 }, |s| s.steering);
        let a = &v.actuators;
        println!(
            "{name}: drive {drive:.3} s of {}, brakes {brake:.3} s of {}, steering {steering:.3} s of {}",
            a.drive_lag, a.brake_lag, a.steering_lag
        );
        // tyre relaxation and wheel spin add to the lags of drive and brakes
        for (measured, lag, beyond) in
            [(drive, a.drive_lag, 0.03), (brake, a.brake_lag, 0.03), (steering, a.steering_lag, 0.003)]
        {
            assert!(measured > lag - 0.002 && measured < lag + beyond, "{name}: {measured} s, lag {lag} s");
        }
    }
}

#[test]
fn brakes_hold_a_car_for_a_minute() {
    for name in vehicle::builtin_names() {
        let v = vehicle::load(name).unwrap();
        for steering in [0.0, v.limits.steering] {
            let mut world = World::new(&v, &[], &State { steering, ..at_speed(0.0) }, &Settings::default()).unwrap();
            let mut log = Log::default();
            world.hold(Command { acceleration: -2.0, steering }, 60.0, &mut log);
            let moved = log.samples.iter().map(|s| s.pose.position.coords.norm()).fold(0.0, f64::max);
            assert!(moved < 1e-9, "{name} creeps {moved} m");
        }
    }
}

/// One row of the reference: the motion of CommonRoad's single-track (ST) and multi-body (MB) models under the same
/// inputs.
#[derive(serde::Deserialize)]
struct Reference {
    vehicle: u8,
    maneuver: String,
    /// Ticks since the start.
    tick: usize,
    st_yaw_rate: f64,
    st_lateral_acceleration: f64,
    st_x: f64,
    st_y: f64,
    mb_yaw_rate: f64,
    mb_lateral_acceleration: f64,
}

/// Written by `benches/vehicle_models/compare.py`.
const REFERENCE: &str = include_str!("../benches/vehicle_models/reference.csv");

fn rms(values: impl Iterator<Item = f64> + Clone) -> f64 {
    (values.clone().map(|x| x * x).sum::<f64>() / values.count() as f64).sqrt()
}

/// RMS of the difference of two series over the RMS of the second one.
fn share(pairs: &[(f64, f64)]) -> f64 {
    rms(pairs.iter().map(|(a, b)| a - b)) / rms(pairs.iter().map(|(_, b)| *b))
}

#[test]
fn maneuvers_match_the_single_track_and_multi_body_models() {
    let reference: Vec<Reference> =
        csv::Reader::from_reader(REFERENCE.as_bytes()).deserialize().collect::<Result<_, _>>().unwrap();
    for (name, number) in [("ford_escort", 1), ("bmw_320i", 2)] {
        let v = vehicle::load(name).unwrap();
        for m in &MANEUVERS {
            let rows: Vec<&Reference> =
                reference.iter().filter(|r| r.vehicle == number && r.maneuver == m.name).collect();
            assert!(rows.len() > 90, "{name} {}: {} rows", m.name, rows.len());
            let driven = m.drive(&v, Pose::new(-v.rear_axle_to_mass, 0.0, 0.0), &Settings::default()).unwrap();
            let pairs = |measured: fn(&Instant) -> f64, expected: fn(&Reference) -> f64| -> Vec<(f64, f64)> {
                rows.iter().map(|r| (measured(&driven[r.tick]), expected(r))).collect()
            };
            let yaw = share(&pairs(|s| s.yaw_rate, |r| r.st_yaw_rate));
            let lateral = share(&pairs(|s| s.lateral_acceleration, |r| r.st_lateral_acceleration));
            let yaw_mb = share(&pairs(|s| s.yaw_rate, |r| r.mb_yaw_rate));
            let lateral_mb = share(&pairs(|s| s.lateral_acceleration, |r| r.mb_lateral_acceleration));
            let off = rows.iter().map(|r| (driven[r.tick].position - Point::new(r.st_x, r.st_y)).norm());
            let report = format!(
                "{name} {}: yaw rate {:.2} % of ST, {:.2} % of MB; lateral acceleration {:.2} %, {:.2} %; {:.2} m from ST",
                m.name,
                100.0 * yaw,
                100.0 * yaw_mb,
                100.0 * lateral,
                100.0 * lateral_mb,
                off.fold(0.0, f64::max)
            );
            println!("{report}");
            let limit = LARGEST_SHARES.iter().find(|(name, _)| *name == m.name).unwrap().1;
            let found = [yaw, lateral, yaw_mb, lateral_mb];
            assert!(found.iter().zip(limit).all(|(found, limit)| *found <= limit), "{report}, limits {limit:?}");
        }
    }
}

/// Largest distance between two runs, the first one mapped by a function, m.
fn apart(a: &[Instant], b: &[Instant], map: impl Fn(Pose) -> Pose) -> f64 {
    assert_eq!(a.len(), b.len());
    let mapped = |s: &Instant| map(Pose { position: s.position, yaw: s.yaw }).position;
    a.iter().zip(b).map(|(p, q)| (mapped(p) - q.position).norm()).fold(0.0, f64::max)
}

#[test]
fn rotation_and_translation_do_not_change_a_maneuver() {
    let v = bmw();
    let origin = Pose::new(0.0, 0.0, 0.0);
    for m in &MANEUVERS {
        let near = m.drive(&v, origin, &Settings::default()).unwrap();
        for from in [Pose::new(0.0, 0.0, 2.0), Pose::new(1e6, -1e6, 0.0), Pose::new(-1e6, 1e6, -0.7)] {
            let far = m.drive(&v, from, &Settings::default()).unwrap();
            let worst = apart(&near, &far, |p| Pose { position: from.to_world(p.position), yaw: p.yaw + from.yaw });
            println!("{} from {from:?}: {worst:.1e} m", m.name);
            // f64 resolves 2·10⁻¹⁰ m at 10⁶ m
            assert!(worst < 1e-8, "{}: {worst} m", m.name);
        }
    }
}

#[test]
fn halving_the_step_converges_at_first_order() {
    let v = bmw();
    let origin = Pose::new(0.0, 0.0, 0.0);
    for m in &MANEUVERS {
        let with = |step: f64| m.drive(&v, origin, &Settings { step, ..Settings::default() }).unwrap();
        let runs = [0.002, 0.001, 0.0005, 0.00025].map(with);
        let changes = [0, 1, 2].map(|i| apart(&runs[i], &runs[i + 1], |p| p));
        println!("{}: steps of 2, 1, ½, ¼ ms: {changes:.5?} m", m.name);
        let distance: f64 = runs[1].windows(2).map(|w| (w[1].position - w[0].position).norm()).sum();
        assert!(changes[1] < 2e-4 * distance, "{}: {changes:?} m on {distance} m", m.name);
        assert!(changes[1] < 0.7 * changes[0] && changes[2] < 0.7 * changes[1], "{}: {changes:?} m", m.name);
    }
}

#[test]
fn a_mirrored_maneuver_gives_the_mirrored_motion() {
    let v = bmw();
    let origin = Pose::new(0.0, 0.0, 0.0);
    for m in &MANEUVERS {
        let (left, right) = (m, m.mirrored());
        let a = left.drive(&v, origin, &Settings::default()).unwrap();
        let b = right.drive(&v, origin, &Settings::default()).unwrap();
        let worst = apart(&a, &b, |p| Pose { position: Point::new(p.position.x, -p.position.y), yaw: -p.yaw });
        println!("{} mirrored: {worst:.1e} m", m.name);
        assert!(worst < 1e-9, "{}: {worst} m", m.name);
    }
}

#[test]
fn repetitions_are_bit_identical() {
    let v = bmw();
    for m in &MANEUVERS {
        let bits = || -> Vec<[u64; 4]> {
            let driven = m.drive(&v, Pose::new(1e5, -2e5, 0.3), &Settings::default()).unwrap();
            driven.iter().map(|s| [s.position.x, s.position.y, s.yaw, s.yaw_rate].map(f64::to_bits)).collect()
        };
        let first = bits();
        assert!((1..10).all(|_| bits() == first), "{}", m.name);
    }
}

#[test]
fn ice_on_one_side_yaws_the_braking_car_and_ice_ahead_reduces_its_deceleration() {
    let v = bmw();
    let braked = |polygon: &[[f64; 2]], anti_lock: bool| {
        let ice = FrictionRegion { factor: 0.15, polygon: polygon.to_vec() };
        let settings = Settings { anti_lock, ..Settings::default() };
        let world = World::new(&v, &[], &at_speed(15.0), &settings).unwrap();
        let mut world = world.with_friction(&[ice]).unwrap();
        let mut log = Log::default();
        world.hold(Command { acceleration: -8.0, steering: 0.0 }, 1.0, &mut log);
        (world.state(), log)
    };
    let left = [[-50.0, 0.0], [200.0, 0.0], [200.0, 10.0], [-50.0, 10.0]];
    let right = left.map(|[x, y]| [x, -y]);
    for anti_lock in [true, false] {
        let (on_left, on_right) = (braked(&left, anti_lock).0, braked(&right, anti_lock).0);
        println!("left side on ice, anti-lock {anti_lock}: {:+.3} rad/s after 1 s", on_left.yaw_rate);
        assert!(on_left.yaw_rate < -0.1 && (on_left.yaw_rate + on_right.yaw_rate).abs() < 1e-9, "{on_left:?}");
    }
    // dry up to x = 5 m, ice beyond: each axle loses grip when it reaches the ice
    let beyond = [[5.0, -10.0], [200.0, -10.0], [200.0, 10.0], [5.0, 10.0]];
    let (_, log) = braked(&beyond, true);
    let hardest = |from: f64, to: f64| {
        let there = log.samples.iter().filter(|s| s.pose.position.x > from && s.pose.position.x < to);
        there.map(|s| -s.acceleration).fold(0.0, f64::max)
    };
    let ice = 0.15 * v.tyres.friction * GRAVITY + 0.02 * 15.0;
    assert!(hardest(0.0, 2.0) > 2.0 && hardest(5.5, 100.0) <= ice, "{} {}", hardest(0.0, 2.0), hardest(5.5, 100.0));
}
