//! The running gear: four wheels under a rigid body, and the force and torque they exert on it.
//!
//! Each wheel has a spin, driven and braked, and a [`Tyre`]. Brakes and rolling resistance are dry friction on the
//! spin: they can stop a wheel and keep it locked but never turn it, so brakes never push the vehicle backwards. A
//! locked wheel and the spring of its tyre hold a parked car.
//!
//! Vertical loads are quasi-static: the static load, plus the load that the filtered accelerations transfer between the
//! axles (m a_x h / L) and between the sides (m a_y h / track, split between the axles in proportion to the weight).
//! Loads are clipped at zero (lift-off). An ideal anti-lock and traction control limits each wheel's torque to what its
//! tyre can transmit in addition to its current side force; brake force that one axle cannot transmit goes to the other
//! one.
//!
//! Limitations: no suspension, so no roll or pitch motion; both axles have the mean track width; the wheels' spin has
//! no gyroscopic effect; the road is flat.

use crate::vehicle::{GRAVITY, Vehicle};

use super::actuators::ActuatorState;
use super::tyre::{Patch, Tyre};

/// Time constant of the load transfer, s: that of a car's body on its springs.
const LOAD_LAG: f64 = 0.05;
/// Share of a tyre's grip that anti-lock and traction control allow a torque to use.
const GRIP_CONTROL: f64 = 0.98;

/// Motion of the body, in the body frame at the centre of mass.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    /// Speed forward, m/s.
    pub(super) forward: f64,
    /// Speed to the left, m/s.
    pub(super) left: f64,
    /// Yaw rate, rad/s.
    pub(super) yaw_rate: f64,
}

/// Force and torque on the body, in the body frame at the centre of mass.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Wrench {
    /// Force forward, N.
    pub(super) forward: f64,
    /// Force to the left, N.
    pub(super) left: f64,
    /// Torque about the vertical, N m.
    pub(super) yaw: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Wheel {
    /// Spin, rad/s, positive when rolling forward.
    spin: f64,
    tyre: Tyre,
    /// Side force of the last step, N.
    side_force: f64,
}

/// The four wheels: front left, front right, rear left, rear right.
#[derive(Debug, Clone)]
pub(super) struct RunningGear {
    wheels: [Wheel; 4],
    /// Filtered acceleration, forward and left, that shifts the loads, m/s².
    load_acceleration: [f64; 2],
    /// Friction coefficient under each wheel.
    friction: [f64; 4],
    /// Whether torques are limited to the tyres' grip.
    anti_lock: bool,
}

impl RunningGear {
    /// Wheels that roll without slip at a speed (m/s), with loads for an acceleration (m/s²), on a road with scaled
    /// friction.
    pub(super) fn rolling(vehicle: &Vehicle, speed: f64, acceleration: f64, friction_scale: f64) -> Self {
        let wheel = Wheel { spin: speed / vehicle.wheel_radius, ..Wheel::default() };
        Self {
            wheels: [wheel; 4],
            load_acceleration: [acceleration, 0.0],
            friction: [friction_scale * vehicle.tyres.friction; 4],
            anti_lock: true,
        }
    }

    /// Switches off anti-lock and traction control.
    pub(super) fn without_anti_lock(self) -> Self {
        Self { anti_lock: false, ..self }
    }

    /// Sets the friction coefficient under each wheel.
    pub(super) fn set_friction(&mut self, friction: [f64; 4]) {
        self.friction = friction;
    }

    /// Advances the wheels by `dt` seconds; returns the mean force and torque on the body in that time.
    pub(super) fn step(&mut self, vehicle: &Vehicle, actuators: &ActuatorState, motion: &Motion, dt: f64) -> Wrench {
        let loads = self.loads(vehicle);
        let drive = split_drive(vehicle, actuators.drive, &self.grip(vehicle, &loads, 1.0));
        let brake = split_brake(vehicle, actuators.brake, &self.grip(vehicle, &loads, -1.0));
        let angles = steering_angles(vehicle, actuators.steering);
        let tyres = &vehicle.tyres;
        let mut wrench = Wrench::default();
        for i in 0..4 {
            let (x, y) = wheel_position(vehicle, i);
            let (sin, cos) = angles[i].sin_cos();
            let (hub_x, hub_y) = (motion.forward - motion.yaw_rate * y, motion.left + motion.yaw_rate * x);
            let (longitudinal, lateral) = (hub_x * cos + hub_y * sin, hub_y * cos - hub_x * sin);
            let wheel = &mut self.wheels[i];
            let patch = Patch {
                rolling: longitudinal,
                sliding: [longitudinal - wheel.spin * vehicle.wheel_radius, lateral],
                load: loads[i],
                friction: self.friction[i],
                stiffness: [tyres.longitudinal, if i < 2 { tyres.cornering_front } else { tyres.cornering_rear }],
            };
            let [fx, fy] = wheel.tyre.step(tyres, &patch, dt);
            wheel.side_force = fy;
            let resistance = brake[i] + tyres.rolling_resistance * loads[i];
            wheel.spin = spin_after(vehicle, wheel.spin, drive[i] - fx, resistance, dt);
            let (forward, left) = (fx * cos - fy * sin, fx * sin + fy * cos);
            wrench.forward += forward;
            wrench.left += left;
            wrench.yaw += x * left - y * forward;
        }
        let drag = tyres.drag * motion.forward.hypot(motion.left);
        wrench.forward -= drag * motion.forward;
        wrench.left -= drag * motion.left;
        let follow = dt / (LOAD_LAG + dt);
        for (filtered, force) in self.load_acceleration.iter_mut().zip([wrench.forward, wrench.left]) {
            *filtered += follow * (force / vehicle.mass - *filtered);
        }
        wrench
    }

    /// Vertical load of each wheel, N.
    fn loads(&self, vehicle: &Vehicle) -> [f64; 4] {
        let (m, h, base) = (vehicle.mass, vehicle.mass_height, vehicle.wheelbase);
        let [ax, ay] = self.load_acceleration;
        let front_share = vehicle.rear_axle_to_mass / base;
        let axle_transfer = m * ax * h / base;
        [0, 1, 2, 3].map(|i| {
            let (share, transfer) =
                if i < 2 { (front_share, -axle_transfer) } else { (1.0 - front_share, axle_transfer) };
            let side_transfer = share * m * ay * h / vehicle.track_width;
            let left = i % 2 == 0;
            (0.5 * (share * m * GRAVITY + transfer) + if left { -side_transfer } else { side_transfer }).max(0.0)
        })
    }

    /// Force at the tread (forward for `direction` 1, backward for −1) available to each wheel, N: what the tyre can
    /// transmit in addition to its side force, and what the spin itself absorbs. Unbounded without anti-lock and
    /// traction control.
    fn grip(&self, vehicle: &Vehicle, loads: &[f64; 4], direction: f64) -> [f64; 4] {
        if !self.anti_lock {
            return [f64::INFINITY; 4];
        }
        let spin =
            vehicle.wheel_inertia / vehicle.wheel_radius.powi(2) * (direction * self.load_acceleration[0]).max(0.0);
        [0, 1, 2, 3].map(|i| {
            let grip = GRIP_CONTROL * self.friction[i] * loads[i];
            (grip * grip - self.wheels[i].side_force.powi(2)).max(0.0).sqrt() + spin
        })
    }

    /// Kinetic energy of the wheels' spin, J.
    #[cfg(test)]
    fn spin_energy(&self, vehicle: &Vehicle) -> f64 {
        self.wheels.iter().map(|w| 0.5 * vehicle.wheel_inertia * w.spin * w.spin).sum()
    }
}

/// Position of a wheel relative to the centre of mass: forward, left, m.
pub(super) fn wheel_position(vehicle: &Vehicle, wheel: usize) -> (f64, f64) {
    let x = if wheel < 2 { vehicle.wheelbase - vehicle.rear_axle_to_mass } else { -vehicle.rear_axle_to_mass };
    let y = 0.5 * vehicle.track_width;
    (x, if wheel.is_multiple_of(2) { y } else { -y })
}

/// Ackermann steering: the front wheels' axes meet on the rear axle's line. Angles in the order of the wheels, rad.
fn steering_angles(vehicle: &Vehicle, middle: f64) -> [f64; 4] {
    let (tan, base, half) = (middle.tan(), vehicle.wheelbase, 0.5 * vehicle.track_width);
    [(base * tan).atan2(base - half * tan), (base * tan).atan2(base + half * tan), 0.0, 0.0]
}

/// Spin after `dt` seconds under a force at the tread and a dry friction (N at the tread). The friction can stop the
/// spin but not reverse it.
fn spin_after(vehicle: &Vehicle, spin: f64, force: f64, resistance: f64, dt: f64) -> f64 {
    let change = dt * vehicle.wheel_radius / vehicle.wheel_inertia;
    let free = spin + force * change;
    let friction = resistance * change;
    if free.abs() <= friction { 0.0 } else { free - friction.copysign(free) }
}

/// The drive's force at each wheel, N.
fn split_drive(vehicle: &Vehicle, force: f64, grip: &[f64; 4]) -> [f64; 4] {
    let front = vehicle.actuators.drive_front_share;
    [0, 1, 2, 3].map(|i| (0.5 * force * if i < 2 { front } else { 1.0 - front }).min(grip[i]))
}

/// The brakes' force at each wheel, N: by the brake balance, the excess of one axle over its grip going to the other one.
fn split_brake(vehicle: &Vehicle, force: f64, grip: &[f64; 4]) -> [f64; 4] {
    let share = vehicle.actuators.brake_front_share;
    let (front_grip, rear_grip) = (grip[0] + grip[1], grip[2] + grip[3]);
    if front_grip.is_infinite() {
        return [share, share, 1.0 - share, 1.0 - share].map(|share| 0.5 * share * force);
    }
    let front = (share * force).max(force - rear_grip).min(front_grip);
    let rear = (force - front).min(rear_grip);
    [0, 1, 2, 3].map(|i| {
        let (axle, axle_grip) = if i < 2 { (front, front_grip) } else { (rear, rear_grip) };
        // evenly, but no wheel above its grip: the other side gets the excess
        let other = axle_grip - grip[i];
        (0.5 * axle).max(axle - other).min(grip[i])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle;
    use proptest::prelude::*;

    fn bmw() -> Vehicle {
        vehicle::load("bmw_320i").unwrap()
    }

    /// Integrates the body in the body frame (semi-implicit Euler), without a physics engine.
    fn advance(v: &Vehicle, gear: &mut RunningGear, actuators: &ActuatorState, m: &mut Motion, dt: f64) -> Wrench {
        let w = gear.step(v, actuators, m, dt);
        let (ax, ay) = (w.forward / v.mass + m.yaw_rate * m.left, w.left / v.mass - m.yaw_rate * m.forward);
        m.forward += ax * dt;
        m.left += ay * dt;
        m.yaw_rate += w.yaw / v.yaw_inertia * dt;
        w
    }

    #[test]
    fn static_loads_add_up_to_the_weight_and_balance_about_the_centre_of_mass() {
        let v = bmw();
        let loads = RunningGear::rolling(&v, 0.0, 0.0, 1.0).loads(&v);
        assert!((loads.iter().sum::<f64>() - v.mass * GRAVITY).abs() < 1e-9);
        let moment: f64 = (0..4).map(|i| loads[i] * wheel_position(&v, i).0).sum();
        assert!(moment.abs() < 1e-9, "{moment}");
    }

    #[test]
    fn load_moves_to_the_front_in_braking_and_to_the_right_in_a_left_turn() {
        let v = bmw();
        let mut gear = RunningGear::rolling(&v, 10.0, -5.0, 1.0);
        gear.load_acceleration[1] = 3.0;
        let loads = gear.loads(&v);
        assert!((loads.iter().sum::<f64>() - v.mass * GRAVITY).abs() < 1e-9, "the total weight is unchanged");
        let front = loads[0] + loads[1];
        let expected = v.mass * (GRAVITY * v.rear_axle_to_mass + 5.0 * v.mass_height) / v.wheelbase;
        assert!((front - expected).abs() < 1e-9, "{front} {expected}");
        let right = loads[1] + loads[3];
        let expected = 0.5 * v.mass * GRAVITY + v.mass * 3.0 * v.mass_height / v.track_width;
        assert!((right - expected).abs() < 1e-9, "{right} {expected}");
    }

    #[test]
    fn ackermann_axes_meet_on_the_rear_axle() {
        let v = bmw();
        for middle in [-1.0, -0.3, 0.2, 1.0f64] {
            let radius = v.wheelbase / middle.tan();
            for (i, angle) in steering_angles(&v, middle).into_iter().take(2).enumerate() {
                let y = wheel_position(&v, i).1;
                assert!((angle.tan() * (radius - y) - v.wheelbase).abs() < 1e-9, "{middle} wheel {i}");
            }
        }
    }

    #[test]
    fn steady_turn_has_the_yaw_rate_of_the_single_track_model() {
        let v = bmw();
        let understeer = 1.0 / v.tyres.cornering_front - 1.0 / v.tyres.cornering_rear;
        for (speed, steering) in [(5.0, 0.05), (12.0, 0.02), (20.0, 0.01), (20.0, -0.01)] {
            let mut gear = RunningGear::rolling(&v, speed, 0.0, 1.0);
            let mut m = Motion { forward: speed, left: 0.0, yaw_rate: 0.0 };
            let actuators = ActuatorState::settled(&v, 0.0, steering, speed);
            for _ in 0..5_000 {
                advance(&v, &mut gear, &actuators, &mut m, 1e-3);
                m.forward = speed; // an ideal cruise control
            }
            // r = v δ / (L + (1/c_f − 1/c_r) v²/g): cornering stiffness proportional to the load
            let expected = speed * steering / (v.wheelbase + understeer * speed * speed / GRAVITY);
            assert!(
                (m.yaw_rate / expected - 1.0).abs() < 0.02,
                "{speed} m/s: {} rad/s, expected {expected}",
                m.yaw_rate
            );
        }
    }

    #[test]
    fn brakes_use_the_full_grip_and_no_more() {
        let v = bmw();
        for scale in [1.0, 0.6, 0.2] {
            let mut gear = RunningGear::rolling(&v, 25.0, 0.0, scale);
            let mut m = Motion { forward: 25.0, left: 0.0, yaw_rate: 0.0 };
            let actuators = ActuatorState::settled(&v, -20.0, 0.0, 25.0);
            let limit = scale * v.tyres.friction * GRAVITY;
            let (mut distance, mut time) = (0.0, 0.0);
            while m.forward > 0.05 {
                let speed = m.forward;
                let w = advance(&v, &mut gear, &actuators, &mut m, 1e-3);
                let drag = v.tyres.drag * speed * speed;
                assert!(-w.forward <= v.mass * limit + drag + 1e-6, "{} m/s²", w.forward / v.mass);
                (distance, time) = (distance + m.forward * 1e-3, time + 1e-3);
                assert!(time < 60.0);
            }
            // v dv/ds = −(μ g + c v²/m), integrated from v to 0
            let c = v.tyres.drag / v.mass;
            let shortest = (1.0 + c * 25.0 * 25.0 / limit).ln() / (2.0 * c);
            assert!(distance > 0.995 * shortest && distance < 1.04 * shortest, "{scale}: {distance} m of {shortest} m");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn coasting_creates_no_energy(
            forward in -5.0..40.0, left in -8.0..8.0, yaw_rate in -2.0..2.0, steering in -0.6..0.6,
        ) {
            let v = bmw();
            let mut gear = RunningGear::rolling(&v, forward, 0.0, 1.0);
            let mut m = Motion { forward, left, yaw_rate };
            let actuators = ActuatorState::settled(&v, 0.0, steering, forward);
            let energy = |m: &Motion, gear: &RunningGear| {
                0.5 * v.mass * (m.forward.powi(2) + m.left.powi(2))
                    + 0.5 * v.yaw_inertia * m.yaw_rate.powi(2)
                    + gear.spin_energy(&v)
            };
            let start = energy(&m, &gear);
            let mut least = start;
            // energy that the tyres' springs can store and return: at most full grip over the deflection at which they
            // slide
            let stored = v.mass * GRAVITY * v.tyres.friction.powi(2) * v.tyres.relaxation_length * 3.0
                / v.tyres.cornering_front;
            for _ in 0..5_000 {
                advance(&v, &mut gear, &actuators, &mut m, 1e-3);
                let now = energy(&m, &gear);
                prop_assert!(now <= least + stored, "{} J gained, springs store {stored} J", now - least);
                least = least.min(now);
            }
        }
    }
}
