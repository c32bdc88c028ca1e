//! Whether the tyres slide sideways.
//!
//! Everything that is known of the tracking errors holds for a vehicle that begins on its trajectory, with wheels that roll in the
//! direction of their motion but for the slip angle that the side force needs. A vehicle that spins or slides is somewhere else a moment
//! later, whatever its speed and steering angle say: its speed along the heading may even be zero.
//!
//! An axle skids if its slip angle exceeds the one at which its tyres give the share of the grip that proofs may use
//! ([`CONTROL_SHARE`]). For the brush model, with its cornering stiffness c per load and the friction μ, that is
//! tan α = 3 (1 − ∛(1 − share)) μ/c.

use super::{CONTROL_SHARE, GRAVITY, GripUse, State, Vehicle};

/// Speed below which a slip angle means nothing, m/s. A slide with the slip angle of the limit at this speed ends within a centimetre.
const SLOW: f64 = 1.0;

impl Vehicle {
    /// Whether an axle of the vehicle skids on a road whose friction is `friction` times that of dry asphalt.
    #[must_use]
    pub fn is_skidding(&self, state: &State, friction: f64) -> bool {
        let limit = 3.0 * (1.0 - (1.0 - CONTROL_SHARE).cbrt()) * friction * self.tyres.friction;
        let skids =
            |(forward, left): (f64, f64), stiffness: f64| left.abs() > limit / stiffness * forward.abs().max(SLOW);
        let left = state.lateral_speed + self.wheelbase * state.yaw_rate;
        let (sin, cos) = state.steering.sin_cos();
        let front = (state.speed * cos + left * sin, left * cos - state.speed * sin);
        skids((state.speed, state.lateral_speed), self.tyres.cornering_rear) || skids(front, self.tyres.cornering_front)
    }
}

impl Vehicle {
    /// Whether the vehicle rolls backwards, farther until its brakes stop it than the error with which it follows a calm plan: plans go
    /// forwards only. `friction` is a factor on that of dry asphalt.
    #[must_use]
    pub fn is_rolling_back(&self, state: &State, friction: f64) -> bool {
        let back = (-state.speed).max(0.0);
        let braking = self.limits.deceleration.min(CONTROL_SHARE * friction * self.tyres.friction * GRAVITY);
        let rolls = back * self.actuators.brake_lag + back * back / (2.0 * braking);
        rolls > self.tracking.at(&GripUse::default()).longitudinal
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::vehicle::{GRAVITY, builtin_names, load};

    fn moving(speed: f64, lateral_speed: f64, yaw_rate: f64, steering: f64) -> State {
        let pose = Pose::new(1.0, 2.0, 0.3);
        State { time: 0.0, pose, speed, lateral_speed, acceleration: 0.0, yaw_rate, steering }
    }

    #[test]
    fn a_turn_within_the_grip_is_no_skid_and_a_spin_or_a_slide_is() {
        for name in builtin_names() {
            let v = load(name).unwrap();
            for (friction, speed) in [(1.0, 4.0), (0.15, 4.0), (0.15, 0.5), (1.0, 0.0)] {
                assert!(!v.is_skidding(&moving(0.0, 0.005, 0.0, 0.0), friction), "{name}: it hardly moves");
                for side in [-1.0, 1.0] {
                    // a turn with half of the grip, on wheels that roll where they point
                    let turn = 0.5 * friction * v.tyres.friction * GRAVITY / f64::max(speed, 1.0).powi(2);
                    let turn = side * turn.min(0.9 * v.max_curvature());
                    let rolling = moving(speed, 0.0, speed * turn, v.steering_for_curvature(turn));
                    assert!(!v.is_skidding(&rolling, friction), "{name} {friction} {speed}");
                    let slides = State { lateral_speed: side * 2.2, ..rolling };
                    let spins = State { yaw_rate: rolling.yaw_rate + side * 2.5 / v.wheelbase, ..rolling };
                    assert!(v.is_skidding(&slides, friction), "{name} {friction} {speed}");
                    assert!(v.is_skidding(&spins, friction), "{name} {friction} {speed}");
                }
            }
        }
    }

    /// The rear tyres of a steady turn: side force over load is the lateral acceleration over g.
    #[test]
    fn the_limit_is_the_share_of_the_grip_that_proofs_use() {
        for name in builtin_names() {
            let v = load(name).unwrap();
            for friction in [1.0, 0.15] {
                let (mu, speed) = (friction * v.tyres.friction, 8.0);
                for (share, skids) in [(0.84, false), (0.86, true)] {
                    // F/F_z = μ (ρ − ρ²/3 + ρ³/27) with ρ = c tan α/μ, solved by bisection
                    let force = |rho: f64| rho - rho * rho / 3.0 + rho.powi(3) / 27.0;
                    let (mut low, mut high) = (0.0, 3.0);
                    for _ in 0..60 {
                        let middle = 0.5 * (low + high);
                        if force(middle) < share { low = middle } else { high = middle }
                    }
                    let slip = speed * low * mu / v.tyres.cornering_rear;
                    // the front wheels roll in the direction of their motion
                    let state = moving(speed, slip, -slip / v.wheelbase, 0.0);
                    assert_eq!(v.is_skidding(&state, friction), skids, "{name} {friction} {share}");
                }
            }
        }
    }
}
