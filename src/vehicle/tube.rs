//! The tracking tube: how far the vehicle may be from its trajectory while the tracking controller follows it.
//!
//! The errors grow with the share of the tyres' grip that the trajectory uses. The friction circle of the whole vehicle is not
//! enough to describe that share: at speed, a path within it can turn in faster than the side force of the tyres builds up, and
//! braking unloads the rear axle. [`PathMotion::grip_use`] therefore looks at each axle, one lag of the steering ahead. With
//! the largest use u of a trajectory and the part t of it that turning alone uses, the bounds are a₀ + a₁ u t for the lateral
//! error and the heading, a₀ + a₁ u² for the longitudinal error. On a path with a curvature up to κ, the longitudinal error also
//! turns the heading: κ times its a₀ is added to the heading. The bounds were measured in the simulation on random trajectories
//! (`tests/tracking/tube.rs`; `docs/physics.md` says how and lists the results).
//!
//! They hold for
//! - trajectories inside the domain at every instant ([`TrackingTube::contains`]), whose curvature is at most
//!   [`TrackingTube::CURVATURE_SHARE`] of the vehicle's largest and whose steering rate is within the vehicle's limit:
//!   [`Vehicle::drivable`] checks a whole trajectory,
//! - that begin without a step of the acceleration, for at least the slower lag of drive and brakes (after a step at the first
//!   instant, the stop is further, by up to the distance driven during that lag),
//! - on a road whose friction is the one that planner and controller believe,
//! - a vehicle that is as described, without localisation error and dead time, and on its trajectory at the start, which means in its motion,
//!   too: one that skids ([`Vehicle::is_skidding`]) leaves it at once.
//!
//! A new plan that begins with the motion of the plan before continues its trajectory: the bounds hold for the trajectory that the
//! vehicle was given piece by piece, with its largest use.
//!
//! Outside of the domain there is no bound: hard braking at high speed may spin the vehicle, even on a nearly straight path,
//! because the unloaded and braked rear axle loses more side stiffness than the front axle. The model has no stability control.

use std::f64::consts::FRAC_PI_2;

use super::{Actuators, CONTROL_SHARE, GRAVITY, Limits, Tyres, Vehicle};

/// Bounds of the tracking errors: each at no use of the grip, and its growth up to full use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackingTube {
    /// Largest speeds for which the bounds hold, m/s: with up to [`Self::GENTLE_USE`] of the grip (straight driving: up to
    /// [`Self::STRAIGHT_BRAKING`]), with [`Self::MODERATE_USE`], and with more (straight driving: the second one).
    /// Between gentle and moderate use, the largest speed falls linearly ([`Self::largest_speed`]).
    pub speed: [f64; 3],
    /// Lateral error of the rear axle's centre, m.
    pub lateral: [f64; 2],
    /// Longitudinal error of the rear axle's centre, m.
    pub longitudinal: [f64; 2],
    /// Error of the heading, rad, beside the one by the longitudinal error on a curved path. It contains the slip angle of the
    /// body, by which the vehicle points inwards in a turn.
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

/// How far tracking errors displace any point of the footprint, in the axes of the trajectory's pose at the same time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackingMargins {
    /// To either side, m.
    pub lateral: f64,
    /// Ahead or behind, m.
    pub longitudinal: f64,
}

impl Vehicle {
    /// Margins around the footprint that contain the real vehicle on each trajectory in the domain of the tracking tube with at
    /// most this use of the grip. Cheap: a planner may ask once for all plans with the same largest use.
    ///
    /// They are the errors of the rear axle and the displacement by a heading error θ: a point (x, y) of the footprint moves
    /// by (x (cos θ − 1) − y sin θ, x sin θ + y (cos θ − 1)), at most with the largest |x| and |y|. They hold for each part of
    /// the footprint and for its bounding rectangle.
    #[must_use]
    pub fn tracking_margins(&self, used: &GripUse) -> TrackingMargins {
        let TrackingError { lateral, longitudinal, heading } = self.tracking.at(used);
        let (sin, cos) = heading.min(FRAC_PI_2).sin_cos();
        let (x, y) = (self.rear_axle_to_centre.abs() + 0.5 * self.length, 0.5 * self.width);
        TrackingMargins {
            lateral: lateral + x * sin + y * (1.0 - cos),
            longitudinal: longitudinal + y * sin + x * (1.0 - cos),
        }
    }
}

impl TrackingTube {
    /// Use of the grip up to which the bounds hold at the speeds of motorways.
    pub const GENTLE_USE: f64 = 0.3;
    /// Use of the grip up to which the bounds hold at the speeds of rural roads.
    pub const MODERATE_USE: f64 = 0.7;
    /// Use of the grip by turning below which the vehicle drives straight.
    pub const STRAIGHT_USE: f64 = 0.05;
    /// Use of the grip up to which straight driving is as fast as gentle driving.
    pub const STRAIGHT_BRAKING: f64 = 0.5;
    /// Share of the vehicle's largest curvature up to which the bounds hold.
    pub const CURVATURE_SHARE: f64 = 0.95;

    /// Whether the bounds hold for a motion at this speed (m/s) with this use of the grip.
    #[must_use]
    pub fn contains(&self, speed: f64, used: &GripUse) -> bool {
        used.total <= 1.0 && speed <= self.largest_speed(used)
    }

    /// The largest speed for which the bounds hold with this use of the grip, m/s: from gentle to [`Self::MODERATE_USE`] a line
    /// from the first to the second [`Self::speed`], with more the third one. Straight driving: the first one up to
    /// [`Self::STRAIGHT_BRAKING`], then the same line, then the second one.
    #[must_use]
    pub fn largest_speed(&self, used: &GripUse) -> f64 {
        let [gentle, moderate, full] = self.speed;
        let is_straight = used.turning <= Self::STRAIGHT_USE;
        if used.total > Self::MODERATE_USE {
            return if is_straight { moderate } else { full };
        }
        if is_straight && used.total <= Self::STRAIGHT_BRAKING {
            return gentle;
        }
        let above = (used.total - Self::GENTLE_USE).max(0.0) / (Self::MODERATE_USE - Self::GENTLE_USE);
        gentle + above * (moderate - gentle)
    }

    /// The largest use of the grip with which straight driving at a speed (m/s) is in the domain, if any is.
    #[must_use]
    pub fn straight_use(&self, speed: f64) -> f64 {
        let [gentle, moderate, _] = self.speed;
        if speed <= moderate {
            return 1.0;
        }
        let above = ((speed - moderate) / (gentle - moderate)).min(1.0);
        (Self::MODERATE_USE - above * (Self::MODERATE_USE - Self::GENTLE_USE)).max(Self::STRAIGHT_BRAKING)
    }

    /// The bounds for a trajectory that uses the grip at most that much.
    #[must_use]
    pub fn at(&self, used: &GripUse) -> TrackingError {
        let bound = |[least, growth]: [f64; 2], used: f64| least + growth * used;
        TrackingError {
            lateral: bound(self.lateral, used.total * used.turning),
            longitudinal: bound(self.longitudinal, used.total * used.total),
            heading: bound(self.heading, used.total * used.turning) + used.curvature * self.longitudinal[0],
        }
    }

    /// Bounds for a vehicle that was not measured, wider than those of each built-in vehicle: the distance μ g τ² with the
    /// slowest lag τ, and three times the slip angle μ/c at which the softer axle's linear force would be the full grip. The
    /// speeds are up to 80 % of the top speed, twelve wheelbases per second with gentle and four and a half with moderate
    /// use of the grip; half of the latter with full use.
    pub(super) fn estimated(tyres: &Tyres, actuators: &Actuators, limits: &Limits, wheelbase: f64) -> Self {
        let [gentle, moderate] = [12.0, 4.5].map(|per_second: f64| (0.8 * limits.speed).min(per_second * wheelbase));
        let lag = lateral_lag(tyres, actuators, gentle).max(actuators.brake_lag).max(actuators.drive_lag);
        let distance = tyres.friction * GRAVITY * lag * lag;
        let slip = tyres.friction / tyres.cornering_front.min(tyres.cornering_rear);
        Self {
            speed: [gentle, moderate, 0.5 * moderate],
            lateral: [0.1, distance.max(0.3)],
            longitudinal: [0.1, distance.max(0.4)],
            heading: [0.12, 3.0 * slip],
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

/// Shares of the grip that proofs may use ([`CONTROL_SHARE`]), 0…1: those of the more heavily used axle; with the curvature.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct GripUse {
    /// By turning, braking and accelerating together.
    pub total: f64,
    /// By turning alone.
    pub turning: f64,
    /// Largest |curvature|, 1/m.
    pub curvature: f64,
}

impl GripUse {
    /// The larger of each.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self {
            total: self.total.max(other.total),
            turning: self.turning.max(other.turning),
            curvature: self.curvature.max(other.curvature),
        }
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
        GripModel::new(vehicle, friction).axles(self).used(self.curvature)
    }
}

/// A vehicle on a road: what [`PathMotion::grip_use`] needs, for many motions.
#[derive(Debug, Clone, Copy)]
pub(super) struct GripModel {
    /// 1/(ρ μ) with the share ρ that proofs may use.
    per_load: f64,
    /// [`Vehicle::lateral_lag`] at standstill, s, and its growth with the speed, s²/m.
    lag: [f64; 2],
    /// [`Vehicle::resistance`] at standstill, m/s², and its growth with the squared speed, 1/m.
    resistance: [f64; 2],
    front: Axle,
    rear: Axle,
}

#[derive(Debug, Clone, Copy)]
struct Axle {
    /// Lever arm of the yaw acceleration, m.
    arm: f64,
    /// Load per acceleration.
    transfer: f64,
    /// Share of the drive over the share of the mass.
    drive: f64,
}

impl GripModel {
    pub(super) fn new(vehicle: &Vehicle, friction: f64) -> Self {
        let (base, b, k2) = (vehicle.wheelbase, vehicle.rear_axle_to_mass, vehicle.yaw_inertia / vehicle.mass);
        let (a, front_drive) = (base - b, vehicle.actuators.drive_front_share);
        // `lever`: of the other axle, whose share of the wheelbase is this axle's share of the mass
        let axle = |arm, lever: f64, sign: f64, drive_share: f64| Axle {
            arm,
            transfer: sign * vehicle.mass_height / lever,
            drive: drive_share * base / lever,
        };
        let linear = |of: &dyn Fn(f64) -> f64| [of(0.0), of(1.0) - of(0.0)];
        Self {
            per_load: 1.0 / (CONTROL_SHARE * friction * vehicle.tyres.friction),
            lag: linear(&|speed| vehicle.lateral_lag(speed)),
            resistance: linear(&|speed| vehicle.resistance(speed)),
            front: axle(b + k2 / b, b, -1.0, front_drive),
            rear: axle((b - k2 / a).abs(), a, 1.0, 1.0 - front_drive),
        }
    }

    /// The use of each axle.
    #[inline]
    pub(super) fn axles(&self, motion: &PathMotion) -> AxleUses {
        let PathMotion { speed, acceleration, curvature, curvature_rate } = *motion;
        let v2 = speed * speed;
        let (lateral, yaw) = (v2 * curvature.abs(), v2 * curvature_rate.abs());
        let ahead = speed * (self.lag[0] + self.lag[1] * speed);
        let drive = (acceleration + self.resistance[0] + self.resistance[1] * v2).max(0.0);
        let least = acceleration.abs() * self.per_load / GRAVITY;
        let used = |axle: &Axle| {
            let load = GRAVITY + axle.transfer * acceleration;
            if load <= 0.0 {
                return AxleUse { turning: f64::INFINITY, along: f64::INFINITY };
            }
            let per_grip = self.per_load / load;
            let turning = (lateral + (ahead + axle.arm) * yaw) * per_grip;
            AxleUse { turning, along: least.max(drive * axle.drive * per_grip) }
        };
        AxleUses { front: used(&self.front), rear: used(&self.rear) }
    }
}

/// Shares of the grip of one axle.
#[derive(Debug, Clone, Copy)]
struct AxleUse {
    turning: f64,
    along: f64,
}

impl AxleUse {
    fn max(self, other: Self) -> Self {
        Self { turning: self.turning.max(other.turning), along: self.along.max(other.along) }
    }

    fn squared(self) -> f64 {
        self.turning * self.turning + self.along * self.along
    }
}

/// Shares of the grip of both axles.
#[derive(Debug, Clone, Copy)]
pub(super) struct AxleUses {
    front: AxleUse,
    rear: AxleUse,
}

impl AxleUses {
    /// The larger of each.
    #[inline]
    pub(super) fn max(self, other: Self) -> Self {
        Self { front: self.front.max(other.front), rear: self.rear.max(other.rear) }
    }

    /// On a path with a curvature, 1/m.
    #[inline]
    pub(super) fn used(self, curvature: f64) -> GripUse {
        // faster than `hypot`, and shares neither overflow nor vanish
        GripUse {
            total: self.front.squared().max(self.rear.squared()).sqrt(),
            turning: self.front.turning.max(self.rear.turning),
            curvature: curvature.abs(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Pose};
    use crate::vehicle::{Footprint, ProofLimits, builtin_names, load};

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
        for (total, turning, curvature, expected) in
            [(0.5, 0.25, 0.0, [0.2, 0.3, 0.01]), (0.5, 0.25, 0.1, [0.2, 0.3, 0.03]), (1.0, 0.0, 0.0, [0.1, 0.6, 0.0])]
        {
            let TrackingError { lateral, longitudinal, heading } = MEASURED.at(&GripUse { total, turning, curvature });
            for (found, expected) in [lateral, longitudinal, heading].into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-12, "{total} {turning}: {found} {expected}");
            }
        }
    }

    const MEASURED: TrackingTube =
        TrackingTube { speed: [40.0, 30.0, 20.0], lateral: [0.1, 0.8], longitudinal: [0.2, 0.4], heading: [0.0, 0.08] };

    #[test]
    fn the_largest_speeds_are_the_measured_ones_and_fall_linearly_up_to_moderate_use() {
        for (total, turning, expected) in [
            (0.0, 0.0, 40.0),
            (0.3, 0.3, 40.0),
            (0.4, 0.3, 37.5),
            (0.5, 0.3, 35.0),
            (0.6, 0.06, 32.5),
            (0.7, 0.7, 30.0),
            (0.701, 0.06, 20.0),
            (1.0, 1.0, 20.0),
            (0.5, 0.05, 40.0),
            (0.501, 0.05, 34.975),
            (0.6, 0.0, 32.5),
            (0.65, 0.05, 31.25),
            (0.7, 0.05, 30.0),
            (0.701, 0.05, 30.0),
            (1.0, 0.0, 30.0),
        ] {
            let found = MEASURED.largest_speed(&GripUse { total, turning, curvature: 0.0 });
            assert!((found - expected).abs() < 1e-9, "{total} {turning}: {found}, not {expected}");
        }
    }

    #[test]
    fn the_largest_speed_never_rises_with_the_use_and_jumps_only_at_its_corners() {
        let flat = |speed| TrackingTube { speed, ..MEASURED };
        let builtin = builtin_names().iter().map(|name| load(name).unwrap().tracking);
        for tube in builtin.chain([MEASURED, flat([5.0; 3]), flat([30.0, 30.0, 20.0]), flat([30.0, 20.0, 20.0])]) {
            let largest = |total: f64, turning: f64| tube.largest_speed(&GripUse { total, turning, curvature: 0.0 });
            let [gentle, moderate, _] = tube.speed;
            for i in 0..1000 {
                let (total, step) = (f64::from(i) * 1e-3, 1e-3);
                let (straight, turning) = (largest(total, 0.0), largest(total, 0.06));
                assert!(turning <= straight && straight <= gentle, "{tube:?} {total}");
                let fall = straight - largest(total + step, 0.0);
                let steepest = 1.001 * step * (gentle - moderate) / 0.4 + 1e-9;
                let near = |corner: f64| (total - corner).abs() < 1.5 * step;
                assert!(fall >= -1e-12 && (fall <= steepest || near(0.5)), "{tube:?} {total}: {fall}");
                let fall = turning - largest(total + step, 0.06);
                assert!(fall >= -1e-12 && (fall <= steepest || near(0.7)), "{tube:?} {total}: {fall}");
            }
        }
    }

    #[test]
    fn straight_driving_with_the_largest_use_is_just_inside_the_domain() {
        for (speed, expected) in [(0.0, 1.0), (30.0, 1.0), (30.01, 0.6996), (32.5, 0.6), (35.0, 0.5), (40.0, 0.5)] {
            let found = MEASURED.straight_use(speed);
            assert!((found - expected).abs() < 1e-9, "{speed}: {found}, not {expected}");
        }
        let flat = TrackingTube { speed: [5.0; 3], ..MEASURED };
        assert!((flat.straight_use(5.0) - 1.0).abs() < 1e-12 && (flat.straight_use(5.1) - 0.5).abs() < 1e-12);
        for name in builtin_names() {
            let tube = load(name).unwrap().tracking;
            let [gentle, moderate, full] = tube.speed;
            let between = |share: f64| moderate + share * (gentle - moderate);
            for speed in [0.5 * full, moderate, between(0.01), between(0.3), between(0.5), between(0.9), gentle] {
                let straight = |total| GripUse { total, turning: 0.0, curvature: 0.0 };
                let most = tube.straight_use(speed);
                assert!(tube.contains(speed, &straight(most - 1e-9)), "{name} {speed}");
                assert!(!tube.contains(speed, &straight(most + 1e-9)), "{name} {speed}");
                if speed > moderate && most > TrackingTube::STRAIGHT_BRAKING {
                    assert!((tube.largest_speed(&straight(most)) - speed).abs() < 1e-9, "{name} {speed}");
                }
            }
        }
    }

    #[test]
    fn the_domain_ends_earlier_for_hard_braking_in_turns() {
        for (speed, total, turning, inside) in [
            (39.0, 0.3, 0.3, true),
            (41.0, 0.3, 0.3, false),
            (39.0, 0.31, 0.3, true),
            (39.0, 0.35, 0.3, false),
            (39.0, 0.5, 0.04, true),
            (41.0, 0.5, 0.04, false),
            (39.0, 0.51, 0.04, false),
            (34.0, 0.51, 0.04, true),
            (29.0, 0.9, 0.04, true),
            (31.0, 0.9, 0.04, false),
            (31.0, 0.6, 0.5, true),
            (33.0, 0.6, 0.5, false),
            (29.0, 0.9, 0.5, false),
            (19.0, 0.9, 0.5, true),
            (19.0, 1.1, 0.5, false),
        ] {
            let used = GripUse { total, turning, curvature: 0.0 };
            assert_eq!(MEASURED.contains(speed, &used), inside, "{speed} {total} {turning}");
        }
    }

    #[test]
    fn the_estimate_is_wider_than_every_measured_tube() {
        for name in builtin_names() {
            let v = load(name).unwrap();
            let estimate = TrackingTube::estimated(&v.tyres, &v.actuators, &v.limits, v.wheelbase);
            for used in [0.0, 0.5, 1.0] {
                let used = GripUse { total: used, turning: used, curvature: 0.0 };
                let (wide, measured) = (estimate.at(&used), v.tracking.at(&used));
                assert!(wide.lateral >= measured.lateral, "{name} {used:?}: {wide:?} {measured:?}");
                assert!(wide.longitudinal >= measured.longitudinal, "{name} {used:?}: {wide:?} {measured:?}");
                assert!(wide.heading >= measured.heading, "{name} {used:?}: {wide:?} {measured:?}");
            }
            assert!(estimate.speed.iter().zip(v.tracking.speed).all(|(wide, measured)| *wide <= measured), "{name}");
        }
    }

    /// Every corner of a vehicle whose errors are inside the tube lies inside the footprint with its margins, and no margin is
    /// much too wide.
    #[test]
    fn margins_contain_the_footprint_with_every_error_inside_the_tube() {
        let rng = &mut fastrand::Rng::with_seed(1);
        let shaped = crate::fixtures::vehicle_with(
            Footprint::new(vec![
                vec![Point::new(-1.0, -1.2), Point::new(3.0, -1.2), Point::new(3.0, 1.2), Point::new(-1.0, 1.2)],
                vec![Point::new(3.0, -0.8), Point::new(5.0, -0.5), Point::new(5.0, 0.6), Point::new(3.0, 0.8)],
            ])
            .unwrap(),
        );
        let ahead = crate::fixtures::vehicle_with(Footprint::rectangle(2.0, 1.0, 3.0));
        let vehicles = builtin_names().iter().map(|name| load(name).unwrap()).chain([shaped, ahead]);
        for v in vehicles {
            let mut farthest = (0.0_f64, 0.0_f64);
            for i in 0..2000 {
                let total = rng.f64();
                let used = GripUse { total, turning: total * rng.f64(), curvature: rng.f64() * v.max_curvature() };
                let (bound, margins) = (v.tracking.at(&used), v.tracking_margins(&used));
                // half of the errors are at their bounds
                let mut share = || if i % 2 == 0 { 2.0 * rng.f64() - 1.0 } else { [-1.0, 1.0][rng.usize(0..2)] };
                let (x, y, heading) = (share() * bound.longitudinal, share() * bound.lateral, share() * bound.heading);
                let real = Pose::new(x, y, heading);
                let corners = v.footprint.parts().iter().flatten().copied().chain(v.footprint.bounding_rectangle());
                for corner in corners {
                    let moved = real.to_world(corner) - corner;
                    let slack = 1e-12;
                    assert!(moved.y.abs() <= margins.lateral + slack, "{} {used:?} {corner} {moved}", v.name);
                    assert!(moved.x.abs() <= margins.longitudinal + slack, "{} {used:?} {corner} {moved}", v.name);
                    farthest.0 = farthest.0.max(moved.y.abs() / margins.lateral);
                    farthest.1 = farthest.1.max(moved.x.abs() / margins.longitudinal);
                }
            }
            assert!(farthest.0 > 0.9 && farthest.1 > 0.8, "{}: {farthest:?}", v.name);
        }
    }
}
