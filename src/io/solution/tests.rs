//! Tests of the fit on logs of a vehicle with slip (dynamic single-track model with linear tyres).

use super::*;
use crate::fixtures;
use crate::map::{InitialState, RoadNetwork};
use crate::simulation::Sample;

/// The BMW 320i with all published digits, since the fit is accurate to a millimetre.
fn bmw() -> Vehicle {
    crate::vehicle::load("bmw_320i").unwrap()
}

fn scenario(centre: Pose, speed: f64, dt: f64) -> Scenario {
    let initial = InitialState { centre, speed, acceleration: 0.0, yaw_rate: 0.0, time_step: 0 };
    Scenario {
        id: "ZAM_Slip-1_1_T-1".into(),
        time_step: dt,
        problems: vec![PlanningProblem { id: 7, initial, goals: vec![] }],
        ..fixtures::scenario(RoadNetwork::default(), vec![])
    }
}

/// Log of a single-track model with cornering forces linear in the slip angles, and without slip near standstill. Explicit
/// Euler with 1 ms steps.
fn driven(vehicle: &Vehicle, centre: Pose, speed: f64, seconds: f64, command: impl Fn(f64, f64) -> (f64, f64)) -> Log {
    const H: f64 = 1e-3;
    let (lr, lf) = (vehicle.rear_axle_to_mass, vehicle.wheelbase - vehicle.rear_axle_to_mass);
    let weight = vehicle.mass * 9.81;
    let (cf, cr) = (20.898 * weight * lr / vehicle.wheelbase, 20.898 * weight * lf / vehicle.wheelbase);
    let (mut mass, mut vx, mut vy, mut r, mut steering) = (centre, speed, 0.0_f64, 0.0_f64, 0.0_f64);
    let mut log = Log::default();
    for i in 0..=(seconds / H) as usize {
        let t = i as f64 * H;
        let (setpoint, ax) = command(t, vx);
        let rear = mass.advanced(-lr);
        if i % 10 == 0 {
            log.samples.push(Sample {
                time: t,
                pose: rear,
                speed: vx,
                lateral_speed: vy - lr * r,
                yaw_rate: r,
                acceleration: ax,
                lateral_acceleration: vx * r,
                steering,
                commanded_acceleration: ax,
                commanded_steering: setpoint,
                reference_pose: rear,
                reference_speed: vx,
                reference_station: 0.0,
            });
        }
        steering += (setpoint - steering).clamp(-0.39 * H, 0.39 * H);
        if vx > 2.0 {
            let (af, ar) = (steering - ((vy + lf * r) / vx).atan(), -((vy - lr * r) / vx).atan());
            let (ff, fr) = (cf * af, cr * ar);
            vy += H * ((ff + fr) / vehicle.mass - vx * r);
            r += H * (lf * ff - lr * fr) / vehicle.yaw_inertia;
        } else {
            r = vx * steering.tan() / vehicle.wheelbase;
            vy = lr * r;
        }
        vx = (vx + H * ax).max(0.0);
        mass.position += (mass.forward() * vx + mass.left() * vy) * H;
        mass.yaw += H * r;
    }
    log
}

/// Checks a step by integrating the model in 2000 Euler steps. Steering and speed are linear between the states.
fn assert_follows(vehicle: &Vehicle, a: &KinematicState, b: &KinematicState, dt: f64) {
    const N: usize = 2000;
    let (rate, acceleration) = ((b.steering - a.steering) / dt, (b.speed - a.speed) / dt);
    assert!(rate.abs() <= 0.4, "steering rate {rate}");
    assert!(acceleration.abs() <= 11.5, "acceleration {acceleration}");
    let lateral = a.speed.powi(2) * a.steering.tan() / vehicle.wheelbase;
    assert!(lateral.hypot(acceleration) <= 11.5, "friction circle: {lateral}, {acceleration}");
    assert!(b.steering.abs() <= 1.066 && b.speed >= -1e-12, "{b:?}");
    let mut rear = vehicle.rear_axle_of_centre(&a.centre);
    for i in 0..N {
        let t = (i as f64 + 0.5) * dt / N as f64;
        let (v, delta) = (a.speed + acceleration * t, a.steering + rate * t);
        let turn = v * delta.tan() / vehicle.wheelbase * dt / N as f64;
        rear.yaw += 0.5 * turn;
        rear = rear.advanced(v * dt / N as f64);
        rear.yaw += 0.5 * turn;
    }
    let centre = vehicle.centre_of_rear_axle(&rear);
    assert!((centre.position - b.centre.position).norm() < 1e-6, "{centre:?} is not {b:?}");
    assert!(wrap_angle(centre.yaw - b.centre.yaw).abs() < 1e-7);
}

fn check(centre: Pose, speed: f64, dt: f64, steps: i64, bound: f64, command: impl Fn(f64, f64) -> (f64, f64)) {
    let (vehicle, s) = (bmw(), scenario(centre, speed, dt));
    let log = driven(&vehicle, centre, speed, steps as f64 * dt, command);
    let fit = fit(&s, &s.problems[0], &vehicle, &log, steps);
    assert_eq!(fit.states.len() as i64, steps + 1);
    assert_eq!((fit.states[0].centre, fit.states[0].speed), (centre, speed), "exactly the initial state");
    for w in fit.states.windows(2) {
        assert_eq!(w[1].time_step, w[0].time_step + 1);
        assert_follows(&vehicle, &w[0], &w[1], dt);
    }
    println!("largest deviation {:.4} m", fit.max_deviation_m);
    assert!(fit.max_deviation_m < bound, "{} m", fit.max_deviation_m);
    let worst = fit.states.iter().map(|f| {
        let sample = &log.samples[((f.time_step as f64 * dt) / 0.01).round() as usize];
        (vehicle.centre_of_rear_axle(&sample.pose).position - f.centre.position).norm()
    });
    assert!(
        (worst.fold(0.0, f64::max) - fit.max_deviation_m).abs() < 1e-6,
        "the reported deviation is the largest one"
    );
}

#[test]
fn follows_a_slalom_at_15_mps_within_3_cm() {
    check(Pose::new(5e5, 4e6, 2.0), 15.0, 0.1, 80, 0.03, |t, _| (0.04 * (1.5 * t).sin(), 0.0));
}

#[test]
fn follows_braking_in_a_curve_to_standstill() {
    check(Pose::new(0.0, 0.0, -3.1), 12.0, 0.1, 60, 0.03, |t, v| (0.08 * t.min(1.0), if v > 0.0 { -4.0 } else { 0.0 }));
}

#[test]
fn follows_a_start_from_standstill_with_full_steering() {
    check(Pose::new(3.0, -2.0, 0.4), 0.0, 0.2, 40, 0.05, |t, v| {
        (
            1.0,
            if t < 1.0 {
                0.0
            } else if v < 3.0 {
                1.5
            } else {
                0.0
            },
        )
    });
}

#[test]
fn starts_at_the_initial_state_of_the_problem() {
    let (vehicle, s) = (bmw(), scenario(Pose::new(0.0, 0.5, 0.0), 10.0, 0.1));
    let log = driven(&vehicle, Pose::new(0.0, 0.0, 0.0), 10.0, 6.0, |_, _| (0.0, 0.0));
    let fit = fit(&s, &s.problems[0], &vehicle, &log, 60);
    assert_eq!(fit.states[0].centre.position, Point::new(0.0, 0.5));
    assert!((fit.max_deviation_m - 0.5).abs() < 1e-6);
    let last = fit.states[60].centre.position;
    assert!((last - Point::new(60.0, 0.0)).norm() < 0.02, "it returns to the log: {last}");
    for w in fit.states.windows(2) {
        assert_follows(&vehicle, &w[0], &w[1], 0.1);
    }
}

#[test]
fn an_infeasible_log_gives_a_feasible_trajectory() {
    let (vehicle, s) = (bmw(), scenario(Pose::new(0.0, 0.0, 0.0), 10.0, 0.1));
    let mut log = driven(&vehicle, Pose::new(0.0, 0.0, 0.0), 10.0, 3.0, |_, _| (0.0, 0.0));
    for sample in &mut log.samples {
        if sample.time > 1.0 {
            sample.pose = Pose::new(30.0, 40.0, 3.0);
            sample.speed = 90.0;
        }
    }
    let fit = fit(&s, &s.problems[0], &vehicle, &log, 30);
    assert!(fit.max_deviation_m > 10.0);
    for w in fit.states.windows(2) {
        assert_follows(&vehicle, &w[0], &w[1], 0.1);
    }
}

#[test]
fn limits_steering_beyond_the_friction_circle() {
    let (vehicle, s) = (bmw(), scenario(Pose::new(0.0, 0.0, 0.0), 35.0, 0.1));
    let log = driven(&vehicle, Pose::new(0.0, 0.0, 0.0), 35.0, 4.0, |t, _| (0.06 * (1.2 * t).sin(), 0.0));
    let fit = fit(&s, &s.problems[0], &vehicle, &log, 40);
    for w in fit.states.windows(2) {
        assert_follows(&vehicle, &w[0], &w[1], 0.1);
    }
}

#[test]
fn an_empty_log_or_range_gives_only_the_initial_state() {
    let (vehicle, s) = (bmw(), scenario(Pose::new(1.0, 2.0, 0.3), 10.0, 0.1));
    let empty = fit(&s, &s.problems[0], &vehicle, &Log::default(), 60);
    assert_eq!((empty.states.len(), empty.max_deviation_m), (1, 0.0));
    let log = driven(&vehicle, Pose::new(1.0, 2.0, 0.3), 10.0, 1.0, |_, _| (0.0, 0.0));
    assert_eq!(fit(&s, &s.problems[0], &vehicle, &log, -5).states.len(), 1);
    assert_eq!(
        fit(&s, &s.problems[0], &vehicle, &log, 30).states.len(),
        31,
        "the last sample is the reference after the end of the log"
    );
    let mut invalid = log;
    invalid.samples[50].pose.yaw = f64::NAN;
    assert!(fit(&s, &s.problems[0], &vehicle, &invalid, 10).states.iter().all(|s| s.centre.position.x.is_finite()));
}

#[test]
fn the_file_has_the_ids_of_model_vehicle_scenario_and_problem() {
    let (mut vehicle, mut s) = (bmw(), scenario(Pose::new(1e6, 2.0, 7.0), 10.0, 0.1));
    s.id = "A&B\"<".into();
    let fit = KinematicFit {
        states: vec![KinematicState {
            time_step: 3,
            centre: Pose::new(1e6 + 0.125, 2.0, 7.0),
            speed: 10.0,
            steering: -0.5,
        }],
        max_deviation_m: 0.0,
    };
    let xml = to_xml(&s, &s.problems[0], &vehicle, &fit).unwrap();
    let document = roxmltree::Document::parse(&xml).unwrap();
    assert_eq!(document.root_element().attribute("benchmark_id"), Some("KS2:SM1:A&B\"<:2020a"));
    let trajectory = document.descendants().find(|n| n.has_tag_name("ksTrajectory")).unwrap();
    assert_eq!(trajectory.attribute("planningProblem"), Some("7"));
    let value = |name: &str| {
        document.descendants().find(|n| n.has_tag_name(name)).unwrap().text().unwrap().parse::<f64>().unwrap()
    };
    assert_eq!((value("x"), value("steeringAngle"), value("time")), (1e6 + 0.125, -0.5, 3.0));
    assert!((value("orientation") - (7.0 - std::f64::consts::TAU)).abs() < 1e-12);
    vehicle.commonroad_type = None;
    assert_eq!(to_xml(&s, &s.problems[0], &vehicle, &fit), None);
}
