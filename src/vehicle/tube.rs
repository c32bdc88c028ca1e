//! The tracking tube: how far the vehicle may be from its trajectory while the tracking controller follows it.
//!
//! The errors grow with the share of the tyres' grip that the trajectory uses. The friction circle of the whole vehicle is not
//! enough to describe that share: at speed, a path within it can turn in faster than the side force of the tyres builds up, and
//! braking unloads the rear axle. [`PathMotion::grip_use`] therefore looks at each axle, one lag of the steering ahead. With
//! the largest use u of a trajectory and the part t of it that turning alone uses, the bounds are a₀ + a₁ u t for the lateral
//! error and the heading, a₀ + a₁ u² for the longitudinal error. They were measured in the simulation on random trajectories
//! (`tests/tracking/tube.rs`; `docs/physics.md` says how and lists the results).
//!
//! They hold for
//! - trajectories inside the domain at every instant ([`TrackingTube::contains`]), whose curvature is at most 95 % of the
//!   vehicle's largest and whose steering rate is within the vehicle's limit,
//! - that brake at the earliest one lag of the brakes after their start (an emergency stop that begins with a step goes
//!   further, by up to the distance driven during that lag),
//! - on a road whose friction is the one that planner and controller believe,
//! - a vehicle that is as described, without localisation error and dead time, and on its trajectory at the start.
//!
//! Outside of the domain there is no bound: hard braking in a turn at high speed may spin the vehicle, because the unloaded and
//! braked rear axle loses more side stiffness than the front axle. The model has no stability control.

use super::{Actuators, CONTROL_SHARE, GRAVITY, Limits, Tyres, Vehicle};

/// Bounds of the tracking errors: each at no use of the grip, and its growth up to full use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackingTube {
    /// Largest speeds for which the bounds hold, m/s: with up to [`Self::MODERATE_USE`] of the grip, and with all of it.
    /// Straight driving is bounded at the first one with any use.
    pub speed: [f64; 2],
    /// Lateral error of the rear axle's centre, m.
    pub lateral: [f64; 2],
    /// Longitudinal error of the rear axle's centre, m.
    pub longitudinal: [f64; 2],
    /// Error of the heading, rad. It contains the slip angle of the body, by which the vehicle points inwards in a turn.
    pub heading: [f64; 2],
}

/// Largest distances between vehicle and trajectory, in the frame of the trajectory's pose at the same time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackingError {
    /// Lateral, to either side, m.
    pub lateral: f64,
    /// Longitudinal, ahead or behind, m.
    pub longitudinal: f64,
    /// Heading, to either side, rad.
    pub heading: f64,
}

impl TrackingTube {
    /// Use of the grip up to which the bounds hold at high speed.
    pub const MODERATE_USE: f64 = 0.7;
    /// Use of the grip by turning below which the vehicle drives straight.
    pub const STRAIGHT_USE: f64 = 0.05;

    /// Whether the bounds hold for a motion at this speed (m/s) with this use of the grip.
    #[must_use]
    pub fn contains(&self, speed: f64, used: &GripUse) -> bool {
        let [moderate, full] = self.speed;
        let calm = used.total <= Self::MODERATE_USE || used.turning <= Self::STRAIGHT_USE;
        used.total <= 1.0 && speed <= if calm { moderate } else { full }
    }

    /// The bounds for a trajectory that uses the grip at most that much.
    #[must_use]
    pub fn at(&self, used: &GripUse) -> TrackingError {
        let bound = |[least, growth]: [f64; 2], used: f64| least + growth * used;
        TrackingError {
            lateral: bound(self.lateral, used.total * used.turning),
            longitudinal: bound(self.longitudinal, used.total * used.total),
            heading: bound(self.heading, used.total * used.turning),
        }
    }

    /// Bounds for a vehicle that was not measured, wider than those of each built-in vehicle: the distance μ g τ² with the
    /// slowest lag τ, three times the slip angle μ/c at which the softer axle's linear force would be the full grip, and up to
    /// nine wheelbases per second or 80 % of the top speed, half of that with full use of the grip.
    pub(super) fn estimated(tyres: &Tyres, actuators: &Actuators, limits: &Limits, wheelbase: f64) -> Self {
        let speed = (0.8 * limits.speed).min(9.0 * wheelbase);
        let lag = lateral_lag(tyres, actuators, speed).max(actuators.brake_lag).max(actuators.drive_lag);
        let distance = tyres.friction * GRAVITY * lag * lag;
        let slip = tyres.friction / tyres.cornering_front.min(tyres.cornering_rear);
        Self {
            speed: [speed, 0.5 * speed],
            lateral: [0.1, distance.max(0.3)],
            longitudinal: [0.1, distance.max(0.4)],
            heading: [0.1, 3.0 * slip],
        }
    }
}

/// See [`Vehicle::lateral_lag`].
pub(super) fn lateral_lag(tyres: &Tyres, actuators: &Actuators, speed: f64) -> f64 {
    const SHARE: f64 = 0.7;
    actuators.steering_lag + SHARE * speed / (GRAVITY * tyres.cornering_front.min(tyres.cornering_rear))
}

/// Motion along a path at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathMotion {
    /// Speed, m/s.
    pub speed: f64,
    /// Acceleration along the path, m/s².
    pub acceleration: f64,
    /// Curvature of the rear axle's path, 1/m.
    pub curvature: f64,
    /// Derivative of the curvature by arc length, 1/m².
    pub curvature_rate: f64,
}

/// Shares of the grip that proofs may use ([`CONTROL_SHARE`]), 0…1: those of the more heavily used axle.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct GripUse {
    /// By turning, braking and accelerating together.
    pub total: f64,
    /// By turning alone.
    pub turning: f64,
}

impl GripUse {
    /// The larger of each.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self { total: self.total.max(other.total), turning: self.turning.max(other.turning) }
    }
}

impl PathMotion {
    /// The share of the grip that this motion uses on a road whose friction is `friction` times that of dry asphalt. It is at
    /// least the share of the friction circle.
    ///
    /// Per axle, with the lever arms a and b of the centre of mass, the wheelbase L and the radius of gyration k: side force
    /// over carried mass v² |κ| + (v τ + r) v² |κ′| with r = b + k²/b in front and |b − k²/a| behind (yaw acceleration) and
    /// the lag τ = [`Vehicle::lateral_lag`]; load with the longitudinal transfer. Brake force is in proportion to the load,
    /// as anti-lock tends to distribute it near the limit; drive force, which overcomes the resistance too, is at the driven axle.
    #[must_use]
    pub fn grip_use(&self, vehicle: &Vehicle, friction: f64) -> GripUse {
        let (base, b, k2) = (vehicle.wheelbase, vehicle.rear_axle_to_mass, vehicle.yaw_inertia / vehicle.mass);
        let (a, v2) = (base - b, self.speed * self.speed);
        let (lateral, yaw) = (v2 * self.curvature.abs(), v2 * self.curvature_rate.abs());
        let ahead = self.speed * vehicle.lateral_lag(self.speed);
        let usable = CONTROL_SHARE * friction * vehicle.tyres.friction;
        let front_drive = vehicle.actuators.drive_front_share;
        let effort = self.acceleration + vehicle.resistance(self.speed);
        // `lever`: of the other axle, whose share of the wheelbase is this axle's share of the mass
        let axle = |arm: f64, lever: f64, transfer: f64, drive_share: f64| {
            let load = GRAVITY + transfer * self.acceleration * vehicle.mass_height / lever;
            if load <= 0.0 {
                return GripUse { total: f64::INFINITY, turning: f64::INFINITY };
            }
            let turning = (lateral + (ahead + arm) * yaw) / (usable * load);
            let drive = effort.max(0.0) * drive_share * base / lever / (usable * load);
            let along = drive.max(self.acceleration.abs() / (usable * GRAVITY));
            GripUse { total: turning.hypot(along), turning }
        };
        let front = axle(b + k2 / b, b, -1.0, front_drive);
        front.max(axle((b - k2 / a).abs(), a, 1.0, 1.0 - front_drive))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::{ProofLimits, builtin_names, load};

    #[test]
    fn the_use_is_that_of_the_friction_circle_where_nothing_turns_or_shifts() {
        for name in builtin_names() {
            let v = load(name).unwrap();
            let flat = Vehicle { mass_height: 0.0, ..v.clone() };
            let motion = PathMotion { speed: 10.0, acceleration: -1.0, curvature: -0.02, curvature_rate: 0.0 };
            for friction in [1.0, 0.6] {
                let limits = ProofLimits::new(&v, friction);
                let circle = 2.0f64.hypot(1.0) / limits.lateral_beside(0.0);
                assert!(motion.grip_use(&v, friction).total > circle, "{name}: braking unloads the rear axle");
                assert!((motion.grip_use(&flat, friction).total / circle - 1.0).abs() < 1e-12, "{name}");
                let turning = PathMotion { curvature_rate: 0.001, ..motion };
                let late = turning.grip_use(&flat, friction).total;
                assert!(late > 1.05 * circle, "{name}: side force builds up with a lag");
            }
        }
    }

    #[test]
    fn straight_braking_at_the_limit_of_proofs_uses_it_fully() {
        for name in builtin_names() {
            let v = load(name).unwrap();
            let limit = ProofLimits::new(&v, 0.6);
            let motion =
                PathMotion { speed: 10.0, acceleration: -limit.deceleration(), curvature: 0.0, curvature_rate: 0.0 };
            assert!((motion.grip_use(&v, 0.6).total - 1.0).abs() < 1e-9, "{name}");
        }
    }

    #[test]
    fn bounds_grow_with_the_use() {
        let tube =
            TrackingTube { speed: [30.0, 20.0], lateral: [0.1, 0.8], longitudinal: [0.2, 0.4], heading: [0.0, 0.08] };
        for (total, turning, expected) in [(0.5, 0.25, [0.2, 0.3, 0.01]), (1.0, 0.0, [0.1, 0.6, 0.0])] {
            let TrackingError { lateral, longitudinal, heading } = tube.at(&GripUse { total, turning });
            for (found, expected) in [lateral, longitudinal, heading].into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-12, "{total} {turning}: {found} {expected}");
            }
        }
    }

    #[test]
    fn the_domain_ends_earlier_for_hard_braking_in_turns() {
        let tube =
            TrackingTube { speed: [30.0, 20.0], lateral: [0.1, 0.8], longitudinal: [0.2, 0.4], heading: [0.0, 0.08] };
        for (speed, total, turning, inside) in [
            (29.0, 0.6, 0.5, true),
            (31.0, 0.6, 0.5, false),
            (29.0, 0.9, 0.5, false),
            (29.0, 0.9, 0.04, true),
            (19.0, 0.9, 0.5, true),
            (19.0, 1.1, 0.5, false),
        ] {
            assert_eq!(tube.contains(speed, &GripUse { total, turning }), inside, "{speed} {total} {turning}");
        }
    }

    #[test]
    fn the_estimate_is_wider_than_every_measured_tube() {
        for name in builtin_names() {
            let v = load(name).unwrap();
            let estimate = TrackingTube::estimated(&v.tyres, &v.actuators, &v.limits, v.wheelbase);
            for used in [0.0, 0.5, 1.0] {
                let used = GripUse { total: used, turning: used };
                let (wide, measured) = (estimate.at(&used), v.tracking.at(&used));
                assert!(wide.lateral >= measured.lateral, "{name} {used:?}: {wide:?} {measured:?}");
                assert!(wide.longitudinal >= measured.longitudinal, "{name} {used:?}: {wide:?} {measured:?}");
                assert!(wide.heading >= measured.heading, "{name} {used:?}: {wide:?} {measured:?}");
            }
            assert!(estimate.speed[0] <= v.tracking.speed[0] && estimate.speed[1] <= v.tracking.speed[1], "{name}");
        }
    }
}
