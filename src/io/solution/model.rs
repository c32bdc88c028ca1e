//! The kinematic single-track model over one time step, its limits and its derivatives.

use nalgebra::{Matrix4x5, Matrix5, Matrix5x2, Vector2, Vector5};

use super::sigma;
use crate::geometry::{Point, wrap_angle};
use crate::map::InitialState;
use crate::vehicle::Vehicle;

/// Index of the steering angle in a state.
pub(super) const DELTA: usize = 2;
/// Index of the speed.
pub(super) const V: usize = 3;
/// Index of the heading.
pub(super) const PSI: usize = 4;

/// Longest step of the Runge–Kutta integration, s: the error is below a micrometre.
const SUBSTEP: f64 = 0.02;

/// Ratio of each limit that is used, so that rounding in the file does not exceed it.
const MARGIN: f64 = 0.999;

/// Largest lateral acceleration as a ratio of the friction circle.
const LATERAL_RATIO: f64 = 0.95;

pub(super) struct Model {
    wheelbase: f64,
    rear_axle_to_centre: f64,
    dt: f64,
    substeps: u32,
    steering: f64,
    steering_rate: f64,
    acceleration: f64,
    switching_speed: f64,
    speed: f64,
}

impl Model {
    pub(super) fn new(vehicle: &Vehicle, dt: f64) -> Self {
        let limits = &vehicle.limits;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // dt is at most ten seconds
        let substeps = (dt / SUBSTEP).ceil().max(1.0) as u32;
        Self {
            wheelbase: vehicle.wheelbase,
            rear_axle_to_centre: vehicle.rear_axle_to_centre,
            dt,
            substeps,
            steering: limits.steering * MARGIN,
            steering_rate: limits.steering_rate * MARGIN,
            acceleration: limits.acceleration * MARGIN,
            switching_speed: limits.switching_speed,
            speed: limits.speed * MARGIN,
        }
    }

    /// The initial state, relative to the initial centre.
    pub(super) fn start(&self, initial: &InitialState, steering: f64) -> Vector5<f64> {
        let rear = initial.centre.forward() * -self.rear_axle_to_centre;
        let steering = steering.clamp(-self.steering, self.steering);
        Vector5::new(rear.x, rear.y, steering, initial.speed, initial.centre.yaw)
    }

    /// The vehicle's centre.
    pub(super) fn centre(&self, z: &Vector5<f64>) -> Point {
        let (sin, cos) = z[PSI].sin_cos();
        Point::new(z[0] + self.rear_axle_to_centre * cos, z[1] + self.rear_axle_to_centre * sin)
    }

    fn derivative(&self, z: &Vector5<f64>, u: &Vector2<f64>) -> Vector5<f64> {
        let (sin, cos) = z[PSI].sin_cos();
        Vector5::new(z[V] * cos, z[V] * sin, u[0], u[1], self.yaw_rate(z))
    }

    fn yaw_rate(&self, z: &Vector5<f64>) -> f64 {
        z[V] * z[DELTA].tan() / self.wheelbase
    }

    /// The state one time step later (classical Runge–Kutta).
    pub(super) fn step(&self, z: &Vector5<f64>, u: &Vector2<f64>) -> Vector5<f64> {
        let h = self.dt / f64::from(self.substeps);
        let mut z = *z;
        for _ in 0..self.substeps {
            let k1 = self.derivative(&z, u);
            let k2 = self.derivative(&(z + k1 * (0.5 * h)), u);
            let k3 = self.derivative(&(z + k2 * (0.5 * h)), u);
            let k4 = self.derivative(&(z + k3 * h), u);
            z += (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0);
        }
        z
    }

    /// The inputs that turn towards a heading and reach a speed within the step, before limits.
    pub(super) fn towards(&self, z: &Vector5<f64>, yaw: f64, speed: f64) -> Vector2<f64> {
        /// Speed below which the heading does not determine the steering, m/s.
        const STANDSTILL: f64 = 0.5;
        let steering = if z[V] < STANDSTILL {
            z[DELTA]
        } else {
            (wrap_angle(yaw - z[PSI]) * self.wheelbase / (self.dt * z[V])).atan()
        };
        Vector2::new((steering - z[DELTA]) / self.dt, (speed - z[V]) / self.dt)
    }

    /// The nearest input inside the limits.
    pub(super) fn clamp(&self, z: &Vector5<f64>, u: Vector2<f64>) -> Vector2<f64> {
        let (low, high) = self.bounds(z, &u);
        Vector2::new(u[0].clamp(low[0], high[0]), u[1].clamp(low[1], high[1]))
    }

    /// Limits of the inputs in a state: steering angle and rate; drive, top speed and standstill; friction circle. If the
    /// steering angle is too large for the speed, they enforce a smaller one.
    pub(super) fn bounds(&self, z: &Vector5<f64>, u: &Vector2<f64>) -> (Vector2<f64>, Vector2<f64>) {
        // Limits that decrease with speed apply at the end of the step, too.
        let fastest = z[V].abs().max(z[V] + u[1].clamp(0.0, self.acceleration) * self.dt);
        // Beyond this angle, the lateral acceleration alone exceeds the friction circle.
        let sharpest = (LATERAL_RATIO * self.acceleration * self.wheelbase / fastest.powi(2)).atan().min(self.steering);
        let lowest = ((-sharpest - z[DELTA]) / self.dt).clamp(-self.steering_rate, self.steering_rate);
        let highest = ((sharpest - z[DELTA]) / self.dt).clamp(-self.steering_rate, self.steering_rate);
        let lateral = z[V] * self.yaw_rate(z);
        let circle = (self.acceleration.powi(2) - lateral.powi(2)).max(0.0).sqrt();
        // Above the switching speed, the power of the drive is the limit.
        let drive = self.acceleration * (self.switching_speed / fastest.max(self.switching_speed));
        let grip_speed = (self.acceleration * self.wheelbase / z[DELTA].tan().abs()).sqrt();
        let most = circle.min(drive).min(((self.speed.min(grip_speed) - z[V]) / self.dt).max(0.0));
        let least = (-circle).max((-z[V] / self.dt).min(0.0));
        (Vector2::new(lowest, least), Vector2::new(highest, most))
    }

    /// ∂f/∂z and ∂f/∂u by central differences.
    pub(super) fn linearised(&self, z: &Vector5<f64>, u: &Vector2<f64>) -> (Matrix5<f64>, Matrix5x2<f64>) {
        /// Step of the difference: the order of the cube root of the rounding error.
        const H: f64 = 1e-5;
        let mut a = Matrix5::zeros();
        for i in 0..5 {
            let mut d = Vector5::zeros();
            d[i] = H;
            a.set_column(i, &((self.step(&(z + d), u) - self.step(&(z - d), u)) / (2.0 * H)));
        }
        let mut b = Matrix5x2::zeros();
        for i in 0..2 {
            let mut d = Vector2::zeros();
            d[i] = H;
            b.set_column(i, &((self.step(z, &(u + d)) - self.step(z, &(u - d))) / (2.0 * H)));
        }
        (a, b)
    }

    /// Derivative of the weighted deviations (centre, heading, speed) by the state.
    pub(super) fn residual_jacobian(&self, z: &Vector5<f64>) -> Matrix4x5<f64> {
        let (sin, cos) = z[PSI].sin_cos();
        let mut j = Matrix4x5::zeros();
        j[(0, 0)] = 1.0 / sigma::POSITION;
        j[(1, 1)] = 1.0 / sigma::POSITION;
        j[(0, PSI)] = -self.rear_axle_to_centre * sin / sigma::POSITION;
        j[(1, PSI)] = self.rear_axle_to_centre * cos / sigma::POSITION;
        j[(2, PSI)] = 1.0 / sigma::HEADING;
        j[(3, V)] = 1.0 / sigma::SPEED;
        j
    }
}
