//! Conversion of states between the plane and Frenet coordinates: position, heading, speed, acceleration, curvature.
//!
//! The closed forms are those of Werling, Ziegler, Kammel and Thrun, "Optimal trajectory generation for dynamic street
//! scenarios in a Frenet frame" (ICRA 2010), appendix I. With the curvature κ_r of the line and its derivative κ_r′ at the
//! foot, the heading Δθ relative to the line, and q = 1 − κ_r l:
//!
//! ```text
//! l′ = q tan Δθ
//! l″ = −(κ_r′ l + κ_r l′) tan Δθ + q/cos² Δθ · (κ q/cos Δθ − κ_r)
//! ṡ  = v cos Δθ / q
//! a  = s̈ q/cos Δθ + ṡ²/cos Δθ · (q tan Δθ (κ q/cos Δθ − κ_r) − (κ_r′ l + κ_r l′))
//! ```
//!
//! They hold for q > 0 (before the centre of curvature) and |Δθ| < π/2. A vehicle that reverses along the line has v < 0
//! and ṡ < 0.
//!
//! Weak near the limits of the range: for q → 0 or |Δθ| → π/2 the derivatives, and with them the errors, grow without
//! bound.

use super::{Frenet, ReferenceLine};
use crate::geometry::spiral::PathPoint;
use crate::geometry::{Pose, wrap_angle};

/// Motion of a point in the plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CartesianState {
    /// Position, m, and heading, rad.
    pub pose: Pose,
    /// Speed along the heading, m/s; negative when reversing.
    pub speed: f64,
    /// Derivative of the speed, m/s².
    pub acceleration: f64,
    /// Curvature of the path, 1/m, positive to the left.
    pub curvature: f64,
}

/// Motion of a point in the Frenet coordinates of a reference line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrenetState {
    /// Station, m.
    pub s: f64,
    /// ds/dt, m/s.
    pub s_dot: f64,
    /// d²s/dt², m/s².
    pub s_ddot: f64,
    /// Offset, m, positive to the left.
    pub l: f64,
    /// dl/ds, without unit.
    pub l_prime: f64,
    /// d²l/ds², 1/m.
    pub l_second: f64,
}

impl ReferenceLine {
    /// Converts a state to Frenet coordinates, with the foot point of [`Self::project`]. `None` at and beyond the centre of
    /// curvature, for headings of 90° or more to the line, beyond the straight continuations, and for input that is not
    /// finite.
    #[must_use]
    pub fn project_state(&self, state: &CartesianState) -> Option<FrenetState> {
        self.state_at_foot(state, self.project(state.pose.position))
    }

    /// [`Self::project_state`] with the foot point of [`Self::project_near`].
    #[must_use]
    pub fn project_state_near(&self, state: &CartesianState, hint: f64) -> Option<FrenetState> {
        self.state_at_foot(state, self.project_near(state.pose.position, hint))
    }

    fn state_at_foot(&self, state: &CartesianState, Frenet { s, l }: Frenet) -> Option<FrenetState> {
        if s <= -self.extension || s >= self.length() + self.extension {
            return None;
        }
        let turn = Turn::new(&self.at(s), l, wrap_angle(state.pose.yaw - self.at(s).pose.yaw))?;
        let s_dot = state.speed * turn.cos / turn.shrink;
        let relative = turn.relative_curvature(state.curvature);
        let l_second = -turn.shrink_rate * turn.tan + turn.shrink / (turn.cos * turn.cos) * relative;
        let s_ddot = (state.acceleration - s_dot * s_dot * turn.stretch_rate(relative)) * turn.cos / turn.shrink;
        Some(FrenetState { s, s_dot, s_ddot, l, l_prime: turn.shrink * turn.tan, l_second })
    }

    /// Converts a state from Frenet coordinates to the plane. `None` at and beyond the centre of curvature.
    #[must_use]
    pub fn from_frenet_state(&self, state: &FrenetState) -> Option<CartesianState> {
        let on_line = self.at(state.s);
        let shrink = 1.0 - on_line.curvature * state.l;
        let turn = Turn::new(&on_line, state.l, (state.l_prime / shrink).atan())?;
        let relative = (state.l_second + turn.shrink_rate * turn.tan) * turn.cos * turn.cos / turn.shrink;
        let pose = Pose { position: self.from_frenet(state.s, state.l), yaw: on_line.pose.yaw + turn.angle };
        Some(CartesianState {
            pose,
            speed: state.s_dot * turn.shrink / turn.cos,
            acceleration: state.s_ddot * turn.shrink / turn.cos
                + state.s_dot * state.s_dot * turn.stretch_rate(relative),
            curvature: (relative + on_line.curvature) * turn.cos / turn.shrink,
        })
    }
}

/// Quantities at a foot point that both directions of the conversion use.
struct Turn {
    /// Heading relative to the line, rad, within ±π/2.
    angle: f64,
    cos: f64,
    tan: f64,
    /// κ_r, 1/m.
    curvature: f64,
    /// q = 1 − κ_r l, positive.
    shrink: f64,
    /// κ_r′ l + κ_r l′ = −dq/ds, 1/m.
    shrink_rate: f64,
}

impl Turn {
    fn new(on_line: &PathPoint, l: f64, angle: f64) -> Option<Self> {
        let (curvature, cos, tan) = (on_line.curvature, angle.cos(), angle.tan());
        let shrink = 1.0 - curvature * l;
        let valid = shrink > 0.0 && angle.abs() < std::f64::consts::FRAC_PI_2;
        let shrink_rate = on_line.curvature_rate * l + curvature * shrink * tan;
        valid.then_some(Self { angle, cos, tan, curvature, shrink, shrink_rate })
    }

    /// dΔθ/ds = κ q/cos Δθ − κ_r, 1/m.
    fn relative_curvature(&self, curvature: f64) -> f64 {
        curvature * self.shrink / self.cos - self.curvature
    }

    /// d(q/cos Δθ)/ds, 1/m: the change of travelled distance per station.
    fn stretch_rate(&self, relative: f64) -> f64 {
        (self.shrink * self.tan * relative - self.shrink_rate) / self.cos
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{UTM, lane_along, line, turn};
    use super::*;
    use crate::geometry::Vector;
    use crate::geometry::spiral::CubicSpiral;
    use proptest::prelude::*;

    fn bend(radius: f64) -> ReferenceLine {
        line(&lane_along(&turn(radius), UTM), &[1])
    }

    #[test]
    fn straight_lines_have_the_coordinates_of_the_plane() {
        let line = line(&crate::fixtures::two_lane_road(3), &[100, 101, 102]);
        let state = CartesianState { pose: Pose::new(40.0, 1.2, 0.3), speed: 9.0, acceleration: -1.5, curvature: 0.02 };
        let f = line.project_state(&state).unwrap();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} instead of {b}");
        close(f.s, 40.0);
        close(f.l, 1.2);
        close(f.s_dot, 9.0 * 0.3_f64.cos());
        close(f.l_prime, 0.3_f64.tan());
        close(f.l_second, 0.02 / 0.3_f64.cos().powi(3));
        // d/dt (v cos θ)
        close(f.s_ddot, -1.5 * 0.3_f64.cos() - 9.0 * 0.3_f64.sin() * 0.02 * 9.0);
    }

    /// Motion along a spiral through the curve: states by the closed form, coordinates by projection.
    #[test]
    fn derivatives_agree_with_finite_differences_of_projected_points() {
        for (radius, begins, l) in [(6.0, 26.0, 0.8), (6.0, 28.0, -1.0), (12.0, 25.0, 2.0), (25.0, 30.0, -2.0)] {
            let line = bend(radius);
            let start = line.offset_pose(begins, l).unwrap().pose;
            let start = Pose { yaw: start.yaw + 0.1, ..start };
            let spiral = CubicSpiral { knots: [0.0, 0.6 / radius, 0.9 / radius, 0.2 / radius], length: 14.0 };
            let (v, a) = (7.0, -1.3);
            let state = |t: f64| {
                let travelled = v * t + 0.5 * a * t * t;
                let p = spiral.point_at(&start, travelled);
                CartesianState { pose: p.pose, speed: v + a * t, acceleration: a, curvature: p.curvature }
            };
            let h = 2e-3;
            for i in 1..18 {
                let t = 0.1 * f64::from(i);
                let here = line.project_state(&state(t)).unwrap();
                let [before, after] = [t - h, t + h].map(|t| line.project(state(t).pose.position));
                let (ds, dl) = (after.s - before.s, after.l - before.l);
                let s_dot = ds / (2.0 * h);
                let s_ddot = (after.s - 2.0 * here.s + before.s) / (h * h);
                let l_prime = dl / ds;
                // second difference of l by s with unequal steps
                let (behind, ahead) = (here.s - before.s, after.s - here.s);
                let l_second = 2.0 * ((after.l - here.l) / ahead - (here.l - before.l) / behind) / (behind + ahead);
                for (name, found, expected, tolerance) in [
                    ("ṡ", here.s_dot, s_dot, 1e-3),
                    ("s̈", here.s_ddot, s_ddot, 2e-2),
                    ("l′", here.l_prime, l_prime, 1e-4),
                    ("l″", here.l_second, l_second, 2e-3),
                ] {
                    assert!((found - expected).abs() < tolerance, "{name} {found}, not {expected}, {radius} at {t}");
                }
            }
        }
    }

    #[test]
    fn rejects_states_beyond_the_centre_of_curvature_perpendicular_to_the_line_and_beyond_its_end() {
        let line = bend(10.0);
        let s = 38.0;
        let state = |l: f64, turned: f64| {
            let on_line = line.at(s).pose;
            let pose = Pose { position: on_line.position + on_line.left() * l, yaw: on_line.yaw + turned };
            CartesianState { pose, speed: 5.0, acceleration: 0.0, curvature: 0.0 }
        };
        assert!(line.project_state(&state(2.0, 1.5)).is_some());
        assert_eq!(line.project_state(&state(2.0, 1.6)), None);
        assert_eq!(line.project_state(&state(2.0, 3.1)), None);
        let frenet = |l: f64| FrenetState { s, s_dot: 5.0, s_ddot: 0.0, l, l_prime: 0.0, l_second: 0.0 };
        assert!(line.from_frenet_state(&frenet(9.0)).is_some());
        assert_eq!(line.from_frenet_state(&frenet(11.0)), None);
        let mut far = state(0.0, 0.0);
        far.pose.position = line.at(-60.0).pose.position;
        assert_eq!(line.project_state(&far), None);
        far.pose.position += Vector::new(f64::NAN, 0.0);
        assert_eq!(line.project_state(&far), None);
    }

    proptest! {
        #[test]
        fn states_survive_a_round_trip(
            part in -0.1..1.1f64, share in -0.9..0.9f64, radius in 4.0..40.0f64, turned in -1.2..1.2f64,
            speed in -5.0..30.0f64, acceleration in -8.0..4.0f64, curvature in -0.25..0.25f64,
        ) {
            let line = bend(radius);
            let s = part * line.length();
            let (left, right) = line.unique_offsets(s);
            let l = share * if share > 0.0 { left.min(8.0) } else { right.min(8.0) };
            let on_line = line.at(s).pose;
            let pose = Pose { position: line.from_frenet(s, l), yaw: on_line.yaw + turned };
            let state = CartesianState { pose, speed, acceleration, curvature };
            let frenet = line.project_state(&state).unwrap();
            prop_assert_eq!(line.project_state_near(&state, s), Some(frenet));
            let back = line.from_frenet_state(&frenet).unwrap();
            prop_assert!((back.pose.position - pose.position).norm() < 1e-6);
            prop_assert!(wrap_angle(back.pose.yaw - pose.yaw).abs() < 1e-6);
            prop_assert!((back.speed - speed).abs() < 1e-6 && (back.acceleration - acceleration).abs() < 1e-6);
            prop_assert!((back.curvature - curvature).abs() < 1e-6);
        }
    }
}
