//! The lateral vehicle model read backwards: which steering drives the rear axle along a path.
//!
//! The rear axle's path determines the motion of a single-track model (it is nearly a flat output), so nothing is
//! integrated. At a station s, to the left positive, with speed v, path curvature κ, wheelbase L, b from the rear axle to
//! the centre of mass, a = L − b, radius of gyration k:
//!
//! - slip angle of the rear axle α_r: the body points inwards of its path by it, so it turns with κ + dα_r/ds, and its yaw
//!   acceleration is ṙ = v² (dκ/ds + d²α_r/ds²);
//! - lateral force of an axle over the mass that rests on it: front v² κ + (b + k²/b) ṙ, rear v² κ + (b − k²/a) ṙ, where the
//!   rear one leaves d²α_r/ds² out, since its arm is short;
//! - slip angle for a force: the brush curve inverted, tan α = 3 μ/c · (1 − ∛(1 − ρ)) · ρ_y/ρ with the share ρ of the grip that
//!   side force ρ_y and the pull of drive or brakes take together; loads as the acceleration shifts them. All of it is read
//!   ahead by the relaxation length, on which slip builds up its force;
//! - the front wheels' angle δ = atan(L (κ + dα_r/ds) − tan α_r) + α_f.
//!
//! Derivatives are differences over some distance, since those of curvature jump where spirals meet.
//! Weak where: friction is the vehicle's own, v² dκ/ds leaves out the change of speed, and hard braking counts as a firm one
//! ([`FIRM`]). Near the limit the inversion is ill-conditioned: a little force asks for much slip, and how anti-lock splits the
//! brakes is not known here. Tried, it steered worse in emergency braking, and feedback does better.

use super::super::chassis::GRAVITY;
use crate::trajectory::Path;
use crate::vehicle::Vehicle;

/// Share of the grip beyond which slip is not raised any further: the flatter the curve, the less a force says about slip.
const LARGEST_SHARE: f64 = 0.7;
/// Largest acceleration and deceleration whose effect on grip and loads is counted, m/s²: a quarter of a dry road's.
const FIRM: f64 = 2.5;
/// Time to either side over which first derivatives are taken, s: half of a steering's lag, which smooths the rest.
const SPAN_TIME: f64 = 0.04;
/// The same for second ones.
const WIDE_SPAN_TIME: f64 = 0.15;
/// Shortest distance to either side over which derivatives are taken, m.
const SPAN_LENGTH: f64 = 0.05;

/// How the vehicle is driven at a moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drive {
    /// Speed, not negative, m/s.
    pub(super) speed: f64,
    /// Acceleration, m/s².
    pub(super) acceleration: f64,
    /// Force of drive (positive) or brakes over the mass, m/s².
    pub(super) effort: f64,
}

/// The model for one moment.
pub(super) struct Inverse<'a> {
    vehicle: &'a Vehicle,
    path: &'a Path,
    speed: f64,
    front: Axle,
    rear: Axle,
}

/// An axle at a moment. Forces are over the mass that rests on it.
#[derive(Debug, Clone, Copy)]
struct Axle {
    /// Part of the yaw acceleration that is in its lateral force, m.
    arm: f64,
    /// Full grip, m/s².
    grip: f64,
    /// Pull of drive or brakes over the grip.
    pull: f64,
    /// 3 μ/c: tangent of the slip angle at which the whole patch slides.
    sliding: f64,
}

impl<'a> Inverse<'a> {
    pub(super) fn new(vehicle: &'a Vehicle, path: &'a Path, drive: Drive) -> Self {
        let (base, b, k2) = (vehicle.wheelbase, vehicle.rear_axle_to_mass, vehicle.yaw_inertia / vehicle.mass);
        let (a, tyres, actuators) = (base - b, &vehicle.tyres, &vehicle.actuators);
        let (acceleration, effort) = (drive.acceleration.clamp(-FIRM, FIRM), drive.effort.clamp(-FIRM, FIRM));
        let front_share = if effort > 0.0 { actuators.drive_front_share } else { actuators.brake_front_share };
        // the share of the mass on an axle is the other axle's lever over the wheelbase
        let axle = |arm: f64, lever: f64, shift: f64, share: f64, stiffness: f64| {
            let gravity = (GRAVITY + acceleration * vehicle.mass_height * shift).max(0.5 * GRAVITY);
            let grip = tyres.friction * gravity;
            let pull = (effort * share * base / (lever * grip)).abs().min(LARGEST_SHARE);
            Axle { arm, grip, pull, sliding: 3.0 * tyres.friction / stiffness }
        };
        let front = axle(b + k2 / b, b, -1.0 / b, front_share, tyres.cornering_front);
        let rear = axle(b - k2 / a, a, 1.0 / a, 1.0 - front_share, tyres.cornering_rear);
        Self { vehicle, path, speed: drive.speed, front, rear }
    }

    /// Steering angle with which the rear axle passes a station, with a curvature added to the path's, rad.
    pub(super) fn steering(&self, station: f64, added: f64) -> f64 {
        let (near, wide) = (self.span(SPAN_TIME), self.span(WIDE_SPAN_TIME));
        let slip = |station: f64| self.rear_slip(station, added);
        let here = slip(station);
        let turning = (slip(station + near) - slip(station - near)) / (2.0 * near);
        let swinging = (slip(station + wide) - 2.0 * here + slip(station - wide)) / (wide * wide);
        let ahead = station + self.vehicle.tyres.relaxation_length;
        let front = self.slip(&self.front, self.bend(ahead) + added, self.bend_rate(ahead) + swinging);
        let curvature = self.bend(station) + added + turning;
        (self.vehicle.wheelbase * curvature - here.tan()).atan() + front
    }

    /// Slip angle of the rear axle at a station with a curvature added to the path's, positive where the body points to the
    /// left of its path, rad.
    pub(super) fn rear_slip(&self, station: f64, added: f64) -> f64 {
        let ahead = station + self.vehicle.tyres.relaxation_length;
        self.slip(&self.rear, self.bend(ahead) + added, self.bend_rate(ahead))
    }

    /// Slip angle of an axle for a curvature and its derivative along the path, rad.
    fn slip(&self, axle: &Axle, curvature: f64, rate: f64) -> f64 {
        let lateral = self.speed * self.speed * (curvature + axle.arm * rate) / axle.grip;
        let whole = lateral.hypot(axle.pull);
        if whole <= 0.0 {
            return 0.0;
        }
        (axle.sliding * (1.0 - (1.0 - whole.min(LARGEST_SHARE)).cbrt()) * lateral / whole).atan()
    }

    fn bend(&self, station: f64) -> f64 {
        self.path.curvature_and_rate_at(station).0
    }

    fn bend_rate(&self, station: f64) -> f64 {
        let near = self.span(SPAN_TIME);
        (self.bend(station + near) - self.bend(station - near)) / (2.0 * near)
    }

    /// Distance to either side over which derivatives are taken, m.
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
    fn in_a_steady_turn_it_is_the_single_track_formula_and_left_and_right_are_alike() {
        for name in vehicle::builtin_names() {
            let v = vehicle::load(name).unwrap();
            for (speed, lateral) in [(5.0, 0.1), (15.0, -0.1)] {
                let curvature = lateral / (speed * speed);
                let understeer = (1.0 / v.tyres.cornering_front - 1.0 / v.tyres.cornering_rear) / GRAVITY;
                let expected = v.wheelbase * curvature + understeer * lateral;
                // 0.1 m/s² is a hundredth of the grip: the curve is straight up to that
                for (of_path, added) in [(curvature, 0.0), (0.0, curvature)] {
                    let path = circle(of_path);
                    let model = Inverse::new(&v, &path, coasting(speed));
                    let found = model.steering(50.0, added);
                    assert!((found / expected - 1.0).abs() < 0.01, "{name} {speed} m/s: {found} {expected}");
                    let slip = lateral / (GRAVITY * v.tyres.cornering_rear);
                    assert!((model.rear_slip(50.0, added) / slip - 1.0).abs() < 0.01, "{name}");
                }
            }
        }
    }

    #[test]
    fn pull_takes_grip_from_the_driven_axle_and_braking_load_from_the_rear() {
        let v = vehicle::load("bmw_320i").unwrap();
        let path = circle(3.0 / 225.0);
        let slip = |drive: Drive| Inverse::new(&v, &path, drive).rear_slip(50.0, 0.0);
        let still = slip(coasting(15.0));
        // rear-wheel drive
        assert!(slip(Drive { effort: 2.0, ..coasting(15.0) }) > 1.01 * still);
        assert!(slip(Drive { acceleration: -2.0, ..coasting(15.0) }) > 1.02 * still);
    }

    #[test]
    fn more_than_the_grip_is_answered_with_a_finite_angle() {
        let v = vehicle::load("bmw_320i").unwrap();
        let path = circle(0.3);
        for drive in [coasting(30.0), Drive { acceleration: -50.0, effort: -50.0, speed: 30.0 }] {
            let angle = Inverse::new(&v, &path, drive).steering(50.0, 0.0);
            assert!(angle.is_finite() && angle > 0.0, "{angle}");
        }
    }
}
