//! The inverse lateral vehicle model: the steering angle that moves the rear axle along a path.
//!
//! The rear axle's path determines the motion of a single-track model (its position is nearly a flat output), so
//! nothing is integrated. At a station s, left positive, with speed v, path curvature κ, wheelbase L, distance b from
//! the rear axle to the centre of mass, a = L − b and radius of gyration k:
//!
//! - slip angle of the rear axle α_r: the body points inwards of its path by this angle, so it turns with κ + dα_r/ds,
//!   and its yaw acceleration is ṙ = v² (dκ/ds + d²α_r/ds²);
//! - lateral force of an axle over the mass it carries: front v² κ + (b + k²/b) ṙ, rear v² κ + (b − k²/a) ṙ; the rear
//!   one neglects d²α_r/ds², since its lever is short;
//! - slip angle for a force: the inverted brush curve, tan α = 3 μ/c · (1 − ∛(1 − ρ)) · ρ_y/ρ, with the share ρ of the
//!   grip that side force ρ_y and longitudinal force use together; loads include the longitudinal transfer. All of this
//!   is evaluated one relaxation length ahead, over which slip builds up its force;
//! - angle of the front wheels: δ = atan(L (κ + dα_r/ds) − tan α_r) + α_f.
//!
//! Derivatives are differences over a finite distance, since those of curvature jump where spirals meet.
//!
//! Limitations: one friction coefficient; v² dκ/ds neglects the change of speed; the brakes are assumed to keep their
//! balance, which anti-lock changes near the limit.

use crate::trajectory::Path;
use crate::vehicle::GRAVITY;
use crate::vehicle::Vehicle;

/// Largest share of the grip that is inverted: the flatter the curve, the less a force determines slip.
const LARGEST_SHARE: f64 = 0.9;
/// Half-width in time of first differences, s: half of a typical steering lag, which smooths what remains.
const SPAN_TIME: f64 = 0.04;
/// Half-width in time of second differences, s.
const WIDE_SPAN_TIME: f64 = 0.15;
/// Smallest half-width of differences, m.
const SPAN_LENGTH: f64 = 0.05;

/// Longitudinal motion of the vehicle at one instant.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drive {
    /// Speed, not negative, m/s.
    pub(super) speed: f64,
    /// Acceleration, m/s².
    pub(super) acceleration: f64,
    /// Force of drive (positive) or brakes over the mass, m/s².
    pub(super) effort: f64,
}

/// The model at one instant.
pub(super) struct Inverse<'a> {
    vehicle: &'a Vehicle,
    path: &'a Path,
    speed: f64,
    front: Axle,
    rear: Axle,
}

/// An axle at one instant. Forces are over the mass that it carries.
#[derive(Debug, Clone, Copy)]
struct Axle {
    /// Lateral force per yaw acceleration, over the mass that the axle carries, m.
    arm: f64,
    /// Full grip, m/s².
    grip: f64,
    /// Force of drive or brakes over the grip.
    longitudinal: f64,
    /// 3 μ/c: tangent of the slip angle at which the whole patch slides.
    sliding: f64,
}

impl<'a> Inverse<'a> {
    /// The model on a road with a friction coefficient.
    pub(super) fn new(vehicle: &'a Vehicle, friction: f64, path: &'a Path, drive: Drive) -> Self {
        let (base, b, k2) = (vehicle.wheelbase, vehicle.rear_axle_to_mass, vehicle.yaw_inertia / vehicle.mass);
        let (a, tyres, actuators) = (base - b, &vehicle.tyres, &vehicle.actuators);
        // the tyres can do no more
        let most = friction * GRAVITY;
        let (acceleration, effort) = (drive.acceleration.clamp(-most, most), drive.effort.clamp(-most, most));
        let front_share = if effort > 0.0 { actuators.drive_front_share } else { actuators.brake_front_share };
        // an axle carries the share of the mass given by the other axle's lever over the wheelbase
        let axle = |arm: f64, lever: f64, shift: f64, share: f64, stiffness: f64| {
            let gravity = (GRAVITY + acceleration * vehicle.mass_height * shift).max(0.5 * GRAVITY);
            let grip = friction * gravity;
            let longitudinal = (effort * share * base / (lever * grip)).abs().min(LARGEST_SHARE);
            Axle { arm, grip, longitudinal, sliding: 3.0 * friction / stiffness }
        };
        let front = axle(b + k2 / b, b, -1.0 / b, front_share, tyres.cornering_front);
        let rear = axle(b - k2 / a, a, 1.0 / a, 1.0 - front_share, tyres.cornering_rear);
        Self { vehicle, path, speed: drive.speed, front, rear }
    }

    /// Steering angle that moves the rear axle along the path at a station, with a curvature added to the path's (1/m),
    /// rad.
    pub(super) fn steering(&self, station: f64, added: f64) -> f64 {
        let (near, wide) = (self.span(SPAN_TIME), self.span(WIDE_SPAN_TIME));
        let slip = |station: f64| self.rear_slip(station, added);
        let here = slip(station);
        let slip_rate = (slip(station + near) - slip(station - near)) / (2.0 * near);
        let slip_second_rate = (slip(station + wide) - 2.0 * here + slip(station - wide)) / (wide * wide);
        let ahead = station + self.vehicle.tyres.relaxation_length;
        let front =
            self.slip(&self.front, self.curvature_at(ahead) + added, self.curvature_rate_at(ahead) + slip_second_rate);
        let curvature = self.curvature_at(station) + added + slip_rate;
        (self.vehicle.wheelbase * curvature - here.tan()).atan() + front
    }

    /// Slip angle of the rear axle at a station with a curvature added to the path's (1/m), positive where the body
    /// points to the left of its path, rad.
    pub(super) fn rear_slip(&self, station: f64, added: f64) -> f64 {
        let ahead = station + self.vehicle.tyres.relaxation_length;
        self.slip(&self.rear, self.curvature_at(ahead) + added, self.curvature_rate_at(ahead))
    }

    /// Slip angle of an axle for a curvature and its derivative along the path, rad.
    fn slip(&self, axle: &Axle, curvature: f64, rate: f64) -> f64 {
        let lateral = self.speed * self.speed * (curvature + axle.arm * rate) / axle.grip;
        let combined = lateral.hypot(axle.longitudinal);
        if combined <= 0.0 {
            return 0.0;
        }
        (axle.sliding * (1.0 - (1.0 - combined.min(LARGEST_SHARE)).cbrt()) * lateral / combined).atan()
    }

    fn curvature_at(&self, station: f64) -> f64 {
        self.path.curvature_and_rate_at(station).0
    }

    fn curvature_rate_at(&self, station: f64) -> f64 {
        let near = self.span(SPAN_TIME);
        (self.curvature_at(station + near) - self.curvature_at(station - near)) / (2.0 * near)
    }

    /// Half-width of differences, m.
    fn span(&self, time: f64) -> f64 {
        SPAN_LENGTH.max(self.speed * time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::geometry::spiral::CubicSpiral;
    use crate::vehicle;

    fn coasting(speed: f64) -> Drive {
        Drive { speed, acceleration: 0.0, effort: 0.0 }
    }

    fn circle(curvature: f64) -> Path {
        Path::new(Pose::new(0.0, 0.0, 0.0), &[CubicSpiral { knots: [curvature; 4], length: 100.0 }]).unwrap()
    }

    #[test]
    fn a_steady_turn_matches_the_single_track_formula_on_both_sides() {
        for name in vehicle::builtin_names() {
            let v = vehicle::load(name).unwrap();
            for (speed, lateral) in [(5.0, 0.1), (15.0, -0.1)] {
                let curvature = lateral / (speed * speed);
                let understeer = (1.0 / v.tyres.cornering_front - 1.0 / v.tyres.cornering_rear) / GRAVITY;
                let expected = v.wheelbase * curvature + understeer * lateral;
                // 0.1 m/s² is a hundredth of the grip: the brush curve is linear up to there
                for (of_path, added) in [(curvature, 0.0), (0.0, curvature)] {
                    let path = circle(of_path);
                    let model = Inverse::new(&v, v.tyres.friction, &path, coasting(speed));
                    let found = model.steering(50.0, added);
                    assert!((found / expected - 1.0).abs() < 0.01, "{name} {speed} m/s: {found} {expected}");
                    let slip = lateral / (GRAVITY * v.tyres.cornering_rear);
                    assert!((model.rear_slip(50.0, added) / slip - 1.0).abs() < 0.01, "{name}");
                }
            }
        }
    }

    #[test]
    fn drive_force_and_braking_increase_the_rear_slip() {
        let v = vehicle::load("bmw_320i").unwrap();
        let path = circle(3.0 / 225.0);
        let slip = |drive: Drive| Inverse::new(&v, v.tyres.friction, &path, drive).rear_slip(50.0, 0.0);
        let coasting_slip = slip(coasting(15.0));
        // rear-wheel drive
        assert!(slip(Drive { effort: 2.0, ..coasting(15.0) }) > 1.01 * coasting_slip);
        assert!(slip(Drive { acceleration: -2.0, ..coasting(15.0) }) > 1.02 * coasting_slip);
    }

    #[test]
    fn the_angle_stays_finite_beyond_the_grip() {
        let v = vehicle::load("bmw_320i").unwrap();
        let path = circle(0.3);
        for drive in [coasting(30.0), Drive { acceleration: -50.0, effort: -50.0, speed: 30.0 }] {
            let angle = Inverse::new(&v, v.tyres.friction, &path, drive).steering(50.0, 0.0);
            assert!(angle.is_finite() && angle > 0.0, "{angle}");
        }
    }
}
