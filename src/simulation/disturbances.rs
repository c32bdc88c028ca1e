//! Disturbances of the simulation that are unknown to the vehicle: dead time of the commands, a wrong vehicle model,
//! localisation noise.
//!
//! The localisation error is a first-order Gauss–Markov process in each coordinate (Gelb, *Applied Optimal Estimation*,
//! 1974, section 2.2): exponentially correlated, as filtered satellite and odometry errors are, and sampled exactly for
//! any time between updates: e(t + Δ) = ρ e(t) + σ √(1 − ρ²) n with ρ = exp(−Δ/τ). The vehicle's inertia would average
//! out white noise at 100 Hz, so that it would test nothing.
//!
//! Limitations: speed, acceleration, yaw rate and steering angle are measured without error.

use std::collections::VecDeque;

use super::actuators::Command;
use crate::geometry::{Point, Pose};
use crate::vehicle::{State, Vehicle};

/// Disturbances of a simulation. None by default.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Disturbances {
    /// Time between a decision of the controller and its effect on the actuators, s.
    pub dead_time: f64,
    /// The vehicle model that controller and actuators assume, where it differs from the simulated vehicle.
    pub believed: Option<Vehicle>,
    /// The localisation error, if any.
    pub localisation: Option<LocalisationNoise>,
}

/// Localisation error: Gaussian, correlated in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalisationNoise {
    /// Standard deviation of the position, longitudinal and lateral each, m.
    pub position: f64,
    /// Standard deviation of the heading, rad.
    pub yaw: f64,
    /// Time constant after which the correlation of the error has fallen to 1/e, s.
    pub correlation_time: f64,
    /// Random seed: equal seeds give equal errors.
    pub seed: u64,
}

/// Commands delayed on their path to the actuators.
#[derive(Debug, Clone, Default)]
pub(super) struct DeadTime {
    /// Delay in steps.
    steps: u64,
    /// Pending commands with the step at which each arrives, in order.
    pending: VecDeque<(u64, Command)>,
}

impl DeadTime {
    /// A dead time in seconds, rounded to whole steps of `step` seconds.
    pub(super) fn new(seconds: f64, step: f64) -> Self {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not negative; saturates
        let steps = (seconds / step).round().max(0.0) as u64;
        Self { steps, pending: VecDeque::new() }
    }

    /// Sends a command at a step.
    pub(super) fn send(&mut self, now: u64, command: Command) {
        self.pending.push_back((now.saturating_add(self.steps), command));
    }

    /// The latest command that has arrived by a step and was not returned before.
    pub(super) fn arrived(&mut self, now: u64) -> Option<Command> {
        let mut last = None;
        while self.pending.front().is_some_and(|(due, _)| *due <= now) {
            last = self.pending.pop_front().map(|(_, command)| command);
        }
        last
    }
}

/// The localisation and its error at one instant.
#[derive(Debug, Clone, Default)]
pub(super) struct Localisation {
    noise: Option<Noise>,
}

#[derive(Debug, Clone)]
struct Noise {
    model: LocalisationNoise,
    random: fastrand::Rng,
    /// Longitudinal and lateral error in the vehicle frame, m; heading error, rad.
    error: [f64; 3],
    time: f64,
}

impl Localisation {
    /// A localisation whose error is stationary from `time` on.
    pub(super) fn new(model: Option<LocalisationNoise>, time: f64) -> Self {
        let noise = model.map(|model| {
            let mut random = fastrand::Rng::with_seed(model.seed);
            let error = deviations(&model).map(|deviation| deviation * normal(&mut random));
            Noise { model, random, error, time }
        });
        Self { noise }
    }

    /// Advances the error to a time of the run, s.
    pub(super) fn advance(&mut self, time: f64) {
        let Some(noise) = &mut self.noise else { return };
        let elapsed = time - noise.time;
        if elapsed <= 0.0 {
            return;
        }
        noise.time = time;
        let kept = (-elapsed / noise.model.correlation_time).exp();
        let fresh = (1.0 - kept * kept).sqrt();
        for (error, deviation) in noise.error.iter_mut().zip(deviations(&noise.model)) {
            *error = kept * *error + fresh * deviation * normal(&mut noise.random);
        }
    }

    /// The state with the localisation error: ahead and left in the vehicle frame.
    pub(super) fn localised(&self, state: &State) -> State {
        let Some(noise) = &self.noise else { return *state };
        let [longitudinal, lateral, yaw] = noise.error;
        let position = state.pose.to_world(Point::new(longitudinal, lateral));
        State { pose: Pose { position, yaw: state.pose.yaw + yaw }, ..*state }
    }
}

fn deviations(model: &LocalisationNoise) -> [f64; 3] {
    [model.position, model.position, model.yaw]
}

/// A standard normal sample (Box and Muller 1958; the second one is discarded).
fn normal(random: &mut fastrand::Rng) -> f64 {
    // 1 − [0, 1) is never zero
    let radius = (-2.0 * (1.0 - random.f64()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.f64()).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAW: LocalisationNoise = LocalisationNoise { position: 0.1, yaw: 0.01, correlation_time: 1.0, seed: 5 };

    fn command(acceleration: f64) -> Command {
        Command { acceleration, steering: 0.0 }
    }

    #[test]
    fn a_command_arrives_once_after_the_dead_time() {
        let mut delay = DeadTime::new(0.02, 0.001);
        delay.send(0, command(1.0));
        delay.send(10, command(2.0));
        let arrivals: Vec<(u64, f64)> =
            (0..60).filter_map(|step| Some((step, delay.arrived(step)?.acceleration))).collect();
        assert_eq!(arrivals, [(20, 1.0), (30, 2.0)]);
    }

    #[test]
    fn without_dead_time_a_command_arrives_at_once() {
        let mut delay = DeadTime::default();
        delay.send(7, command(1.0));
        assert_eq!(delay.arrived(7), Some(command(1.0)));
        assert_eq!(delay.arrived(8), None);
    }

    /// Errors at instants that are `spacing` seconds apart.
    fn errors(seed: u64, spacing: f64, count: u32) -> Vec<[f64; 3]> {
        let mut localisation = Localisation::new(Some(LocalisationNoise { seed, ..LAW }), 0.0);
        let next = |i| {
            localisation.advance(f64::from(i) * spacing);
            localisation.noise.as_ref().map(|n| n.error).unwrap()
        };
        (0..count).map(next).collect()
    }

    #[test]
    fn deviation_and_correlation_are_independent_of_the_update_interval() {
        for spacing in [0.05, 0.5] {
            let errors = errors(1, spacing, 40_000);
            for (axis, deviation) in [0.1, 0.1, 0.01].into_iter().enumerate() {
                let mean_square = errors.iter().map(|e| e[axis] * e[axis]).sum::<f64>() / errors.len() as f64;
                assert!((mean_square.sqrt() / deviation - 1.0).abs() < 0.05, "{spacing} s, axis {axis}: {mean_square}");
                let shifted = errors.iter().zip(&errors[1..]).map(|(a, b)| a[axis] * b[axis]).sum::<f64>();
                let correlation = shifted / errors.len() as f64 / mean_square;
                assert!((correlation - (-spacing).exp()).abs() < 0.03, "{spacing} s, axis {axis}: {correlation}");
            }
        }
    }

    #[test]
    fn equal_seeds_give_equal_errors() {
        assert_eq!(errors(3, 0.1, 50), errors(3, 0.1, 50));
        assert_ne!(errors(3, 0.1, 50), errors(4, 0.1, 50));
        // pinned, so that a new version of the generator does not change runs unnoticed
        assert!((errors(5, 0.1, 1)[0][0] - FIRST_OF_SEED_5).abs() < 1e-12, "{:?}", errors(5, 0.1, 1));
    }

    const FIRST_OF_SEED_5: f64 = 0.009_582_442_297_681_853;

    #[test]
    fn the_localised_pose_is_offset_by_the_error() {
        let mut localisation = Localisation::new(Some(LAW), 0.0);
        if let Some(noise) = &mut localisation.noise {
            noise.error = [0.3, 0.1, 0.02];
        }
        let pose = Pose::new(5e5, 4e6, std::f64::consts::FRAC_PI_2);
        let state =
            State { time: 0.0, pose, speed: 3.0, lateral_speed: 0.0, acceleration: 0.0, yaw_rate: 0.0, steering: 0.0 };
        let localised = localisation.localised(&state);
        let offset = localised.pose.position - pose.position;
        assert!((offset.x + 0.1).abs() < 1e-6 && (offset.y - 0.3).abs() < 1e-6, "{offset:?}");
        assert!((localised.pose.yaw - pose.yaw - 0.02).abs() < 1e-12 && localised.speed == 3.0);
    }
}
