//! Steering, drive and brakes: the response of the actuators to commands, with lags and limits.
//!
//! Steering is a position servo with a first-order lag, a rate limit and an acceleration limit. Near its setpoint the
//! rate is limited to √(2 a |error|), the largest rate from which it can still stop in time, so it does not overshoot.
//! Drive and brakes are first-order lags on the force, clipped to the vehicle's limits: the drive to its largest
//! acceleration and, above the switching speed, to its power (a·v constant; Althoff and Würsching 2020, equation 4);
//! the brakes to their largest deceleration.

use crate::vehicle::Vehicle;

/// A command to steering, drive and brakes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// Force of drive (positive) or brakes (negative) over the vehicle's mass, m/s². Resistance acts in addition to it.
    pub acceleration: f64,
    /// Steering angle of the virtual middle front wheel, rad.
    pub steering: f64,
}

/// The state of the actuators.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ActuatorState {
    /// Steering angle of the virtual middle front wheel, rad.
    pub(super) steering: f64,
    steering_rate: f64,
    /// Force of the drive at the wheels, N, not negative.
    pub(super) drive: f64,
    /// Force of the brakes at the wheels, N, not negative.
    pub(super) brake: f64,
}

impl ActuatorState {
    /// Actuators in steady state at an acceleration (force over mass) and a steering angle.
    pub(super) fn settled(vehicle: &Vehicle, acceleration: f64, steering: f64, speed: f64) -> Self {
        let [drive, brake] = force_setpoints(vehicle, acceleration, speed);
        let steering = steering.clamp(-vehicle.limits.steering, vehicle.limits.steering);
        Self { steering, steering_rate: 0.0, drive, brake }
    }

    /// Advances by `dt` seconds towards the command.
    pub(super) fn step(&mut self, vehicle: &Vehicle, command: &Command, speed: f64, dt: f64) {
        self.step_steering(vehicle, command.steering, dt);
        let [drive, brake] = force_setpoints(vehicle, command.acceleration, speed);
        let approach = |now: f64, setpoint: f64, lag: f64| setpoint + (now - setpoint) * (-dt / lag).exp();
        self.drive = approach(self.drive, drive, vehicle.actuators.drive_lag).min(drive_limit(vehicle, speed));
        self.brake = approach(self.brake, brake, vehicle.actuators.brake_lag);
    }

    fn step_steering(&mut self, vehicle: &Vehicle, command: f64, dt: f64) {
        let limits = &vehicle.limits;
        let error = command.clamp(-limits.steering, limits.steering) - self.steering;
        let stopping_rate = (2.0 * limits.steering_acceleration * error.abs()).sqrt();
        let max_rate = limits.steering_rate.min(stopping_rate);
        let rate = (error / vehicle.actuators.steering_lag).clamp(-max_rate, max_rate);
        let change = limits.steering_acceleration * dt;
        self.steering_rate += (rate - self.steering_rate).clamp(-change, change);
        self.steering = (self.steering + self.steering_rate * dt).clamp(-limits.steering, limits.steering);
    }
}

/// Force setpoints of drive and brakes for an acceleration, within their limits, N.
fn force_setpoints(vehicle: &Vehicle, acceleration: f64, speed: f64) -> [f64; 2] {
    let drive = (vehicle.mass * acceleration.max(0.0)).min(drive_limit(vehicle, speed));
    let brake = vehicle.mass * (-acceleration).max(0.0).min(vehicle.limits.deceleration);
    [drive, brake]
}

/// Largest force of the drive at a speed, N. Zero at top speed.
fn drive_limit(vehicle: &Vehicle, speed: f64) -> f64 {
    let limits = &vehicle.limits;
    if speed >= limits.speed {
        return 0.0;
    }
    vehicle.mass * limits.acceleration * (limits.switching_speed / speed.max(limits.switching_speed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle;

    const DT: f64 = 1e-3;

    fn bmw() -> Vehicle {
        vehicle::load("bmw_320i").unwrap()
    }

    /// Time at which `value` first passes 1 − 1/e of `end`.
    fn time_constant(end: f64, mut value: impl FnMut() -> f64) -> f64 {
        (1..100_000).find(|_| value() / end >= 1.0 - (-1.0f64).exp()).unwrap() as f64 * DT
    }

    #[test]
    fn each_actuator_has_its_own_time_constant() {
        let v = bmw();
        let idle = ActuatorState::settled(&v, 0.0, 0.0, 5.0);
        let mut a = idle;
        let drive = time_constant(v.mass, || {
            a.step(&v, &Command { acceleration: 1.0, steering: 0.0 }, 5.0, DT);
            a.drive
        });
        assert!((drive - v.actuators.drive_lag).abs() <= 2.0 * DT, "{drive}");
        let mut a = idle;
        let brake = time_constant(v.mass, || {
            a.step(&v, &Command { acceleration: -1.0, steering: 0.0 }, 5.0, DT);
            a.brake
        });
        assert!((brake - v.actuators.brake_lag).abs() <= 2.0 * DT, "{brake}");
        // small enough that neither the rate nor the acceleration limit is active
        let small = 1e-6;
        let mut a = idle;
        let steering = time_constant(small, || {
            a.step(&v, &Command { acceleration: 0.0, steering: small }, 5.0, DT);
            a.steering
        });
        assert!((steering - v.actuators.steering_lag).abs() <= 3.0 * DT, "{steering}");
    }

    #[test]
    fn steering_respects_its_limits_and_does_not_overshoot() {
        let v = bmw();
        for target in [0.02, 0.3, 1.0, 5.0] {
            let mut a = ActuatorState::settled(&v, 0.0, 0.0, 5.0);
            let (mut last, mut last_rate, mut largest) = (0.0, 0.0, 0.0f64);
            for _ in 0..10_000 {
                a.step(&v, &Command { acceleration: 0.0, steering: target }, 5.0, DT);
                let rate = (a.steering - last) / DT;
                assert!(rate.abs() <= v.limits.steering_rate + 1e-9, "rate {rate}");
                if a.steering < v.limits.steering {
                    let acceleration: f64 = (rate - last_rate) / DT;
                    assert!(acceleration.abs() <= v.limits.steering_acceleration + 1e-6, "acceleration {acceleration}");
                }
                (last, last_rate, largest) = (a.steering, rate, largest.max(a.steering));
            }
            let end = target.min(v.limits.steering);
            assert!((a.steering - end).abs() < 1e-6 && largest <= end + 1e-4, "{target}: {} {largest}", a.steering);
        }
    }

    #[test]
    fn drive_and_brakes_respect_their_limits() {
        let v = bmw();
        let force = |speed: f64, acceleration: f64| {
            let a = ActuatorState::settled(&v, acceleration, 0.0, speed);
            (a.drive - a.brake) / v.mass
        };
        assert_eq!(force(1.0, 50.0), v.limits.acceleration);
        let power = v.limits.acceleration * v.limits.switching_speed;
        assert!((force(30.0, 50.0) * 30.0 - power).abs() < 1e-9);
        assert_eq!(force(v.limits.speed, 1.0), 0.0);
        assert_eq!(force(30.0, -50.0), -v.limits.deceleration);
    }
}
