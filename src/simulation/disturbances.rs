//! What goes wrong in the rig and nobody in the vehicle knows: commands that arrive late, a vehicle that is not the one it
//! is taken for, a localisation that errs.
//!
//! The localisation's error is a first-order Gauss–Markov process in each coordinate (Gelb, *Applied Optimal Estimation*,
//! 1974, section 2.2): exponentially correlated, as filtered satellite and odometry errors are, and drawn exactly for any
//! spacing of the updates: e(t + Δ) = ρ e(t) + σ √(1 − ρ²) n with ρ = exp(−Δ/τ). White noise at 100 Hz would be averaged
//! away by the vehicle's inertia and test nothing.
//!
//! Weak where: speed, acceleration, yaw rate and steering angle are measured without error.

use std::collections::VecDeque;

use super::actuators::Command;
use crate::geometry::{Point, Pose};
use crate::vehicle::{State, Vehicle};

/// What is wrong in the rig. Nothing by default.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Disturbances {
    /// Time between a decision of the controller and its arrival at the actuators, s.
    pub dead_time: f64,
    /// What the controller and the actuators take the vehicle for, where that is not the one in the world.
    pub believed: Option<Vehicle>,
    /// The localisation's error, if it has one.
    pub localisation: Option<LocalisationNoise>,
}

/// Error of the localisation: Gaussian, correlated in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalisationNoise {
    /// Standard deviation of the position along the vehicle and across it, each, m.
    pub position: f64,
    /// Standard deviation of the heading, rad.
    pub yaw: f64,
    /// Time in which the error's correlation falls to 1/e, s.
    pub correlation_time: f64,
    /// Seed: the same one gives the same errors.
    pub seed: u64,
}

/// Commands on their way to the actuators.
#[derive(Debug, Clone, Default)]
pub(super) struct DeadTime {
    /// Length in steps.
    steps: u64,
    /// Commands with the step at which they arrive, in order.
    underway: VecDeque<(u64, Command)>,
}

impl DeadTime {
    /// A dead time in seconds, rounded to whole steps.
    pub(super) fn new(seconds: f64, step: f64) -> Self {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not negative; saturates
        let steps = (seconds / step).round().max(0.0) as u64;
        Self { steps, underway: VecDeque::new() }
    }

    /// Sends a command at a step.
    pub(super) fn ask(&mut self, now: u64, command: Command) {
        self.underway.push_back((now.saturating_add(self.steps), command));
    }

    /// The last command that has arrived by a step and was not taken before.
    pub(super) fn arrived(&mut self, now: u64) -> Option<Command> {
        let mut last = None;
        while self.underway.front().is_some_and(|(due, _)| *due <= now) {
            last = self.underway.pop_front().map(|(_, command)| command);
        }
        last
    }
}

/// The localisation and its error at a moment.
#[derive(Debug, Clone, Default)]
pub(super) struct Localisation {
    noise: Option<Noise>,
}

#[derive(Debug, Clone)]
struct Noise {
    law: LocalisationNoise,
    random: fastrand::Rng,
    /// Ahead and left in the vehicle's frame, m; heading, rad.
    error: [f64; 3],
    time: f64,
}

impl Localisation {
    /// A localisation whose error is stationary from the time of its start on.
    pub(super) fn new(law: Option<LocalisationNoise>, time: f64) -> Self {
        let noise = law.map(|law| {
            let mut random = fastrand::Rng::with_seed(law.seed);
            let error = deviations(&law).map(|deviation| deviation * normal(&mut random));
            Noise { law, random, error, time }
        });
        Self { noise }
    }

    /// Lets the error wander until a time of the run.
    pub(super) fn advance(&mut self, time: f64) {
        let Some(noise) = &mut self.noise else { return };
        let passed = time - noise.time;
        if passed <= 0.0 {
            return;
        }
        noise.time = time;
        let kept = (-passed / noise.law.correlation_time).exp();
        let fresh = (1.0 - kept * kept).sqrt();
        for (error, deviation) in noise.error.iter_mut().zip(deviations(&noise.law)) {
            *error = kept * *error + fresh * deviation * normal(&mut noise.random);
        }
    }

    /// The state as the vehicle takes it to be.
    pub(super) fn seen(&self, state: &State) -> State {
        let Some(noise) = &self.noise else { return *state };
        let [ahead, left, yaw] = noise.error;
        let position = state.pose.to_world(Point::new(ahead, left));
        State { pose: Pose { position, yaw: state.pose.yaw + yaw }, ..*state }
    }
}

fn deviations(law: &LocalisationNoise) -> [f64; 3] {
    [law.position, law.position, law.yaw]
}

/// A standard normal number (Box and Muller 1958; the second one is not used).
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
    fn a_command_arrives_after_the_dead_time_and_once() {
        let mut way = DeadTime::new(0.02, 0.001);
        way.ask(0, command(1.0));
        way.ask(10, command(2.0));
        let arrivals: Vec<(u64, f64)> =
            (0..60).filter_map(|step| Some((step, way.arrived(step)?.acceleration))).collect();
        assert_eq!(arrivals, [(20, 1.0), (30, 2.0)]);
    }

    #[test]
    fn without_dead_time_a_command_arrives_at_once() {
        let mut way = DeadTime::default();
        way.ask(7, command(1.0));
        assert_eq!(way.arrived(7), Some(command(1.0)));
        assert_eq!(way.arrived(8), None);
    }

    /// Errors of the position at moments that are `spacing` seconds apart.
    fn errors(seed: u64, spacing: f64, count: u32) -> Vec<[f64; 3]> {
        let mut localisation = Localisation::new(Some(LocalisationNoise { seed, ..LAW }), 0.0);
        let next = |i| {
            localisation.advance(f64::from(i) * spacing);
            localisation.noise.as_ref().map(|n| n.error).unwrap()
        };
        (0..count).map(next).collect()
    }

    #[test]
    fn the_error_has_its_deviation_and_its_correlation_whatever_the_spacing_of_updates() {
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
    fn a_seed_gives_its_errors_again_and_another_one_gives_others() {
        assert_eq!(errors(3, 0.1, 50), errors(3, 0.1, 50));
        assert_ne!(errors(3, 0.1, 50), errors(4, 0.1, 50));
        // kept, so that a new version of the generator does not change runs unseen
        assert!((errors(5, 0.1, 1)[0][0] - FIRST_OF_SEED_5).abs() < 1e-12, "{:?}", errors(5, 0.1, 1));
    }

    const FIRST_OF_SEED_5: f64 = 0.009_582_442_297_681_853;

    #[test]
    fn what_is_seen_lies_ahead_and_left_of_the_truth_by_the_error() {
        let mut localisation = Localisation::new(Some(LAW), 0.0);
        if let Some(noise) = &mut localisation.noise {
            noise.error = [0.3, 0.1, 0.02];
        }
        let pose = Pose::new(5e5, 4e6, std::f64::consts::FRAC_PI_2);
        let state = State { time: 0.0, pose, speed: 3.0, acceleration: 0.0, yaw_rate: 0.0, steering: 0.0 };
        let seen = localisation.seen(&state);
        let offset = seen.pose.position - pose.position;
        assert!((offset.x + 0.1).abs() < 1e-6 && (offset.y - 0.3).abs() < 1e-6, "{offset:?}");
        assert!((seen.pose.yaw - pose.yaw - 0.02).abs() < 1e-12 && seen.speed == 3.0);
    }
}
