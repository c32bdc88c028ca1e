//! Phase and gain margins of both tracking loops, from the loops' transfer functions: test only.
//!
//! Lateral: controller, hold of half a control period, steering servo, and the linear single-track model with tyre
//! relaxation (Pacejka 2012, sections 1.3 and 5.5; damping of the carcass as in `tyre`), from steering to offset and
//! heading of the rear axle. Longitudinal: controller, hold, lag of drive or brakes, two integrators. Saturations are
//! neglected: rate and acceleration of the steering, the bounds of the feedback.

use std::f64::consts::PI;

use nalgebra::Complex;

use super::{lateral_bandwidth, longitudinal_bandwidth};
use crate::vehicle::GRAVITY;
use crate::vehicle::{self, Vehicle};

type C = Complex<f64>;

/// Half of the default control period: the mean delay of a held command, s.
const HOLD: f64 = 0.005;
/// Margins that textbooks recommend (Åström and Murray, *Feedback Systems*, section 10.3: 30° to 60°, 2 to 5).
const PHASE_MARGIN: f64 = 40.0;
const GAIN_MARGIN: f64 = 2.0;

fn lag(s: C, time_constant: f64) -> C {
    C::from(1.0) / (s * time_constant + 1.0)
}

fn hold(s: C) -> C {
    (-s * HOLD).exp()
}

/// The lateral loop, cut at the steering command.
fn lateral(v: &Vehicle, speed: f64, s: C) -> C {
    let (base, b) = (v.wheelbase, v.rear_axle_to_mass);
    let a = base - b;
    let sigma = v.tyres.relaxation_length / speed;
    let tyre = (s * (0.03f64).min(0.5 * sigma) + 1.0) / (s * sigma + 1.0);
    let front = tyre * (v.tyres.cornering_front * v.mass * GRAVITY * b / base);
    let rear = tyre * (v.tyres.cornering_rear * v.mass * GRAVITY * a / base);
    // m (s v_y + v r) = F_f + F_r and I s r = a F_f − b F_r for a steering of 1
    let m = [
        [s * v.mass + (front + rear) / speed, (front * a - rear * b) / speed + v.mass * speed],
        [(front * a - rear * b) / speed, s * v.yaw_inertia + (front * a * a + rear * b * b) / speed],
    ];
    let determinant = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    let left = (front * m[1][1] - m[0][1] * front * a) / determinant;
    let yaw_rate = (m[0][0] * front * a - front * m[1][0]) / determinant;
    let heading = yaw_rate / s;
    let offset = (left - yaw_rate * b + heading * speed) / s;
    let omega = lateral_bandwidth(v, speed);
    // the inverse model for a small curvature: Ackermann angle plus the difference of the slip angles
    let understeer = (1.0 / v.tyres.cornering_front - 1.0 / v.tyres.cornering_rear) / GRAVITY;
    let gain = base + understeer * speed * speed;
    (offset * omega * omega + heading * 2.0 * omega) * gain * lag(s, v.actuators.steering_lag) * hold(s)
}

fn longitudinal(v: &Vehicle, actuator: f64, s: C) -> C {
    let omega = longitudinal_bandwidth(v);
    (s * 2.0 * omega + omega * omega) / (s * s) * lag(s, actuator) * hold(s)
}

/// Phase margin (degrees), gain margin and crossover (rad/s) of a loop that begins with two integrators.
fn margins(open_loop: impl Fn(C) -> C) -> (f64, f64, f64) {
    let (mut phase, mut last) = (-PI, open_loop(C::new(0.0, 1e-3)));
    let (mut phase_margin, mut gain_margin, mut crossover) = (f64::INFINITY, f64::INFINITY, 0.0);
    phase += (last * C::from(-1.0)).arg();
    let mut frequency: f64 = 1e-3;
    while frequency < 300.0 {
        frequency *= 1.002;
        let now = open_loop(C::new(0.0, frequency));
        let before = phase;
        phase += (now / last).arg();
        if last.norm() >= 1.0 && now.norm() < 1.0 {
            phase_margin = phase_margin.min((PI + phase).to_degrees());
            crossover = frequency;
        }
        if before > -PI && phase <= -PI {
            gain_margin = gain_margin.min(1.0 / now.norm());
        }
        last = now;
    }
    (phase_margin, gain_margin, crossover)
}

#[test]
fn margins_of_a_known_loop_match_the_closed_form() {
    // (ω² + 2ωs)/s² without lag: crossover at ω √(2 + √5), phase margin atan(2 √(2 + √5)), infinite gain margin
    let (phase, gain, crossover) = margins(|s| (s * 3.0 + 2.25) / (s * s));
    let expected = (2.0 + 5f64.sqrt()).sqrt();
    assert!((crossover / (1.5 * expected) - 1.0).abs() < 3e-3, "{crossover}");
    assert!((phase - (2.0 * expected).atan().to_degrees()).abs() < 0.1 && gain == f64::INFINITY, "{phase} {gain}");
    // 1/s² behind a lag is unstable
    assert!(margins(|s| lag(s, 0.1) / (s * s)).0 < 0.0);
}

#[test]
fn the_lateral_loop_keeps_its_margins_over_all_speeds() {
    for name in vehicle::builtin_names() {
        let v = vehicle::load(name).unwrap();
        for speed in [0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0, 35.0] {
            if speed > v.limits.speed {
                continue;
            }
            let (phase, gain, crossover) = margins(|s| lateral(&v, speed, s));
            let report =
                format!("{name} {speed:4.1} m/s: crossover {crossover:.2} rad/s, phase {phase:.0}°, gain {gain:.1}");
            println!("{report}");
            assert!(phase >= PHASE_MARGIN && gain >= GAIN_MARGIN, "{report}");
        }
    }
}

#[test]
fn the_longitudinal_loop_keeps_its_margins_on_drive_and_brakes() {
    for name in vehicle::builtin_names() {
        let v = vehicle::load(name).unwrap();
        for (kind, actuator) in [("drive", v.actuators.drive_lag), ("brakes", v.actuators.brake_lag)] {
            let (phase, gain, crossover) = margins(|s| longitudinal(&v, actuator, s));
            let report = format!("{name} {kind}: crossover {crossover:.2} rad/s, phase {phase:.0}°, gain {gain:.1}");
            println!("{report}");
            assert!(phase >= PHASE_MARGIN && gain >= GAIN_MARGIN, "{report}");
        }
    }
}
