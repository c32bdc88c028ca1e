//! What a proof of stopping may assume of a vehicle on a road.
//!
//! A stop is proven for accelerations, so those have to be ones that this vehicle reaches on the road as believed. Longitudinal
//! and lateral acceleration share the grip of the tyres (friction ellipse; a circle, as the tyre model has one friction
//! coefficient for both directions):
//!
//! ```text
//! a_x² + a_y² ≤ (ρ · μ · g)²,   a_x ≥ −ρ · b
//! ```
//!
//! with the friction coefficient μ = believed factor × the tyres' peak friction, the deceleration b that the brakes reach, and
//! the share ρ = [`CONTROL_SHARE`]; the rest is the tracking controller's. The vehicle accelerates with the grip of its driven axles only:
//! on ice, a car with rear drive reaches less than half of the deceleration of its brakes.
//!
//! Weak where: one friction for the whole road ahead, the least that is known of; no slopes; drag and rolling resistance, which
//! help to brake, are left out; the drive's power limit is not considered.

use super::Vehicle;

/// Gravity, m/s² (CGPM 1901 standard value).
pub const GRAVITY: f64 = 9.806_65;

/// Share of grip and brakes that proofs use. The tracking controller needs the rest to correct errors, and anti-lock control
/// leaves 2 % of the grip unused.
pub const CONTROL_SHARE: f64 = 0.85;

/// Accelerations that proofs may use, m/s².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProofLimits {
    /// Grip in any direction.
    grip: f64,
    /// Deceleration on a straight road.
    deceleration: f64,
    /// Acceleration on a straight road.
    acceleration: f64,
}

impl ProofLimits {
    /// The limits of a vehicle on a road whose friction is `friction` times that of dry asphalt.
    #[must_use]
    pub fn new(vehicle: &Vehicle, friction: f64) -> Self {
        Self::with_share(vehicle, friction, CONTROL_SHARE)
    }

    /// Everything that the vehicle and the road give, without a reserve for the tracking controller. Not for proofs.
    #[must_use]
    pub fn unreserved(vehicle: &Vehicle, friction: f64) -> Self {
        Self::with_share(vehicle, friction, 1.0)
    }

    fn with_share(vehicle: &Vehicle, friction: f64, share: f64) -> Self {
        let grip = share * friction * vehicle.tyres.friction * GRAVITY;
        Self {
            grip,
            deceleration: grip.min(share * vehicle.limits.deceleration),
            acceleration: vehicle.limits.acceleration.min(grip * traction(vehicle)),
        }
    }

    /// Largest deceleration on a straight path, m/s², positive.
    #[must_use]
    pub fn deceleration(&self) -> f64 {
        self.deceleration
    }

    /// Largest acceleration on a straight path, m/s².
    #[must_use]
    pub fn acceleration(&self) -> f64 {
        self.acceleration
    }

    /// Largest lateral acceleration beside a longitudinal one, m/s².
    #[must_use]
    pub fn lateral_beside(&self, longitudinal: f64) -> f64 {
        (self.grip * self.grip - longitudinal * longitudinal).max(0.0).sqrt()
    }

    /// The vehicle with limits of comfort that are within these: a limit of comfort is a wish, the road's is not. Where the
    /// comfortable accelerations use up the grip together, each keeps the same share of it. Its top speed is within that of its
    /// tracking tube: nothing can be claimed beyond.
    #[must_use]
    pub fn applied_to(&self, vehicle: &Vehicle) -> Vehicle {
        let mut vehicle = vehicle.clone();
        vehicle.limits.speed = vehicle.limits.speed.min(SPEED_SHARE * vehicle.tracking.speed[0]);
        let comfort = &mut vehicle.comfort;
        comfort.aggressive_deceleration = comfort.aggressive_deceleration.min(self.deceleration * HALF);
        comfort.deceleration = comfort.deceleration.min(comfort.aggressive_deceleration * COMFORT_SHARE);
        comfort.acceleration = comfort.acceleration.min(self.acceleration * HALF);
        comfort.lateral_acceleration = comfort.lateral_acceleration.min(self.lateral_beside(self.deceleration * HALF));
        vehicle
    }
}

/// Share of the grip that the driven axles can use: each carries its share of the weight and has to transmit its share of the drive.
/// The load that moves to the rear axle is left out.
fn traction(vehicle: &Vehicle) -> f64 {
    let front_load = vehicle.rear_axle_to_mass / vehicle.wheelbase;
    let front_drive = vehicle.actuators.drive_front_share;
    // without a share of the drive, an axle sets no limit
    let of = |load: f64, drive: f64| if drive > 0.0 { load / drive } else { f64::INFINITY };
    of(front_load, front_drive).min(of(1.0 - front_load, 1.0 - front_drive)).min(1.0)
}

/// Share of the straight-line limit at which as much is left for the other direction: 1/√2.
const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Share of the tube's largest speed that plans aim at: proofs forgive 5 % of a speed limit.
const SPEED_SHARE: f64 = 0.95;
/// Comfortable deceleration as a share of the aggressive one, where the road limits both: that of the SafeTLP paper's limits.
const COMFORT_SHARE: f64 = 0.7;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::{builtin_names, load};

    #[test]
    fn limits_are_within_brakes_and_grip() {
        for name in builtin_names() {
            let vehicle = load(name).unwrap();
            for friction in [1.0, 0.6, 0.15] {
                let limits = ProofLimits::new(&vehicle, friction);
                let grip = friction * vehicle.tyres.friction * GRAVITY;
                assert!(limits.deceleration() < grip && limits.deceleration() < vehicle.limits.deceleration);
                for share in [0.0, 0.3, 0.7, 1.0] {
                    let longitudinal = share * limits.deceleration();
                    assert!(longitudinal.hypot(limits.lateral_beside(longitudinal)) <= CONTROL_SHARE * grip + 1e-12);
                }
                assert_eq!(limits.lateral_beside(grip), 0.0);
            }
        }
    }

    /// Per driven axle: drive force over load.
    #[test]
    fn acceleration_is_within_the_grip_of_each_driven_axle() {
        for name in builtin_names() {
            let mut vehicle = load(name).unwrap();
            for front in [vehicle.actuators.drive_front_share, 0.0, 0.4, 1.0] {
                vehicle.actuators.drive_front_share = front;
                let acceleration = ProofLimits::new(&vehicle, 0.15).acceleration();
                let front_load = vehicle.rear_axle_to_mass / vehicle.wheelbase;
                for (load, drive) in [(front_load, front), (1.0 - front_load, 1.0 - front)] {
                    let used = drive * acceleration / (load * 0.15 * vehicle.tyres.friction * GRAVITY);
                    assert!(used <= CONTROL_SHARE + 1e-12, "{name}: {used} of the grip with {front} at the front");
                }
                assert!(acceleration > 0.25 * 0.15 * vehicle.tyres.friction * GRAVITY, "{name} {front}");
            }
        }
    }

    #[test]
    fn comfort_is_left_alone_on_dry_asphalt_and_within_the_grip_on_ice() {
        let car = load("bmw_320i").unwrap();
        let dry = ProofLimits::new(&car, 1.0).applied_to(&car);
        assert!((dry.limits.speed / car.tracking.speed[0] - 0.95).abs() < 1e-12);
        assert_eq!(dry.comfort, car.comfort);
        let limits = ProofLimits::new(&car, 0.15);
        let comfort = limits.applied_to(&car).comfort;
        assert!(comfort.deceleration < comfort.aggressive_deceleration);
        assert!(comfort.aggressive_deceleration.hypot(comfort.lateral_acceleration) <= limits.grip + 1e-12);
        assert!(comfort.acceleration.hypot(comfort.lateral_acceleration) <= limits.grip + 1e-12);
    }
}
