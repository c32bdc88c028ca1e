//! Polynomial spirals, cubic and quintic: curves whose curvature is a polynomial of arc length.
//!
//! With arc length s ∈ [0, L] and u = s/L the curve is
//!
//! ```text
//! κ(s) = Σ kᵢ Nᵢ(u)                     curvature, 1/m, positive to the left
//! θ(s) = θ₀ + ∫₀ˢ κ ds                   heading, rad, not wrapped
//! p(s) = p₀ + ∫₀ˢ (cos θ, sin θ) ds      position, m
//! ```
//!
//! A spiral stores its curvature kᵢ at equal steps of u (four knots make a cubic, six a quintic; Nᵢ is the Lagrange
//! basis of these knots) and its length L. This parametrisation is well conditioned, and the bending energy is a
//! quadratic form in the knots (Kelly & Nagy 2003; McNaughton 2011). The start pose (p₀, θ₀) is an argument of the
//! functions that need it.
//!
//! Heading and curvature are exact to rounding. Position is a Fresnel-like integral: Gauss–Legendre quadrature with as
//! many panels as the turning requires, error below 1e-9 m for 60 m and half a turn. Extrema of the curvature and of its
//! rate are roots of polynomials of degree four at most and are exact.
//!
//! Outside [0, L] the polynomials are extrapolated: values are defined, but neither the accuracy nor the extrema cover
//! them. A length that is not positive gives values that are not finite, or an empty curve.
//!
//! - [`connect`] solves for the cubic between two poses with given curvatures at both ends (Newton's method).
//! - [`super::boundary`] solves for the cubic or quintic of least bending energy under end conditions that leave
//!   freedom, and under bounds of curvature and of its rate.
//! - [`Spiral::nearest`] projects a point.
//!
//! Weak: a spiral that turns by many turns over its length is integrated with a bounded number of panels and loses
//! accuracy. No road turns that much.

mod gradient;
mod nearest;
mod newton;
mod polynomial;

pub use self::gradient::EndGradient;
pub(crate) use self::gradient::Jet;
#[cfg(test)]
pub(crate) use self::newton::tests::lattice_problems;
pub use self::newton::{SpiralFailure, connect};
pub(crate) use self::polynomial::{Polynomial, Tables};

use super::quadrature::{GAUSS_3, GAUSS_5, GAUSS_8};
use super::{Pose, Vector};

/// A polynomial spiral with `KNOTS` knots, in its start frame. Use [`CubicSpiral`] or [`QuinticSpiral`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spiral<const KNOTS: usize> {
    /// Curvature at equal steps of arc length from the start to the end, 1/m, positive to the left.
    pub knots: [f64; KNOTS],
    /// Length, m, positive.
    pub length: f64,
}

/// A cubic spiral: curvature at u = 0, 1/3, 2/3, 1.
pub type CubicSpiral = Spiral<4>;

/// A quintic spiral: curvature at u = 0, 1/5, … 1. Its two additional knots fix the curvature rate at the ends or
/// reduce the bending energy.
pub type QuinticSpiral = Spiral<6>;

/// A point of a path: pose, curvature and the derivative of curvature by arc length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Position, m, and heading, rad. For a vehicle path: the pose of the rear axle.
    pub pose: Pose,
    /// Curvature, 1/m, positive to the left.
    pub curvature: f64,
    /// Curvature rate: the derivative of curvature by arc length, 1/m².
    pub curvature_rate: f64,
}

/// Turning (rad, as bounded by [`Spiral::turning_bound`]) up to which one eight-point panel is enough. It is small
/// because the bound ignores how fast curvature varies: the knots (0, −1, 2, 0) are the worst case, with an error that
/// grows as turning⁴.
const TURN_OF_ONE_PANEL: f64 = 0.3;
/// Turning (rad) per additional panel, from the second on: errors below 1e-9 m on 60 m, by the tests below.
const TURN_PER_PANEL: f64 = 2.0;
/// The same for a quintic, whose curvature varies faster than its bound shows.
const TURN_PER_PANEL_OF_A_QUINTIC: f64 = 1.25;
/// Three-point quadrature is enough for a sweep of at least this many intervals with at most this turning (rad) each.
const THREE_POINTS: (usize, f64) = (32, 0.06);
/// The same for five-point quadrature.
const FIVE_POINTS: (usize, f64) = (8, 0.4);

impl<const K: usize> Spiral<K> {
    /// Upper bound of the sum of |basis polynomials| on [0, 1] (the Lebesgue constant: 1.6311 for four knots at equal
    /// steps, 3.1063 for six).
    const LEBESGUE: f64 = if K <= 4 { 1.64 } else { 3.11 };

    /// A straight line of the given length, m.
    #[must_use]
    pub fn straight(length: f64) -> Self {
        Self { knots: [0.0; K], length }
    }

    pub(crate) fn curvature_polynomial(&self) -> Polynomial<K> {
        Polynomial::through(&self.knots)
    }

    /// An upper bound of ∫ |κ| ds over the whole length, rad.
    fn turning_bound(&self) -> f64 {
        Self::LEBESGUE * self.length * self.knots.iter().fold(0.0_f64, |m, k| m.max(k.abs()))
    }

    /// Curvature at arc length `s`, 1/m.
    #[must_use]
    pub fn curvature(&self, s: f64) -> f64 {
        self.curvature_polynomial().value(s / self.length)
    }

    /// Derivative of the curvature by arc length at `s`, 1/m².
    #[must_use]
    pub fn curvature_rate(&self, s: f64) -> f64 {
        self.curvature_polynomial().derivative(s / self.length) / self.length
    }

    /// [`Self::curvature`] and [`Self::curvature_rate`].
    #[must_use]
    pub fn curvature_and_rate(&self, s: f64) -> (f64, f64) {
        let (curvature, u) = (self.curvature_polynomial(), s / self.length);
        (curvature.value(u), curvature.derivative(u) / self.length)
    }

    /// Change of heading from the start to arc length `s`, rad: exact, not wrapped.
    #[must_use]
    pub fn heading_change(&self, s: f64) -> f64 {
        self.length * self.curvature_polynomial().integral(s / self.length)
    }

    /// Pose and curvature at arc length `s` (m) of the spiral that begins at `start`. The position error is below
    /// 1e-9 m for up to 60 m and half a turn, and far below that for lattice edges.
    #[must_use]
    pub fn point_at(&self, start: &Pose, s: f64) -> PathPoint {
        let curvature = self.curvature_polynomial();
        let u = s / self.length;
        let moved = self.displacement(&curvature, start.yaw, 0.0, u, panels::<K>(self.turning_bound() * u.abs()));
        self.path_point(&curvature, start, moved, u)
    }

    /// The pose at the end of the spiral that begins at `start`.
    #[must_use]
    pub fn end(&self, start: &Pose) -> Pose {
        self.point_at(start, self.length).pose
    }

    fn path_point(&self, curvature: &Polynomial<K>, start: &Pose, moved: Vector, u: f64) -> PathPoint {
        PathPoint {
            pose: Pose { position: start.position + moved, yaw: start.yaw + self.length * curvature.integral(u) },
            curvature: curvature.value(u),
            curvature_rate: curvature.derivative(u) / self.length,
        }
    }

    /// L ∫ (cos, sin)(yaw + θ) du from u = `from` to `to`.
    fn displacement(&self, curvature: &Polynomial<K>, yaw: f64, from: f64, to: f64, panels: usize) -> Vector {
        let width = (to - from) / panels as f64;
        let mut sum = Vector::zeros();
        for panel in 0..panels {
            sum += self.rule(curvature, yaw, from + width * panel as f64, width, &GAUSS_8);
        }
        sum
    }

    /// One application of a Gauss rule to the displacement over [from, from + width].
    fn rule(&self, curvature: &Polynomial<K>, yaw: f64, from: f64, width: f64, rule: &[(f64, f64)]) -> Vector {
        let mut sum = Vector::zeros();
        for (node, weight) in rule {
            let (sin, cos) = (yaw + self.length * curvature.integral(from + width * node)).sin_cos();
            sum += Vector::new(cos, sin) * *weight;
        }
        sum * (self.length * width)
    }

    /// `intervals` + 1 points at equal spacing, both ends included, each with its arc length (m). At least one interval.
    /// Every point is integrated from the previous one, so that this is the cheapest sampling of a whole spiral.
    pub fn samples(&self, start: &Pose, intervals: usize) -> impl Iterator<Item = (f64, PathPoint)> + use<K> {
        let (spiral, start, intervals) = (*self, *start, intervals.max(1));
        let curvature = spiral.curvature_polynomial();
        let width = 1.0 / intervals as f64;
        let turning = spiral.turning_bound() * width;
        let allows = move |(min, max): (usize, f64)| intervals >= min && turning <= max;
        let mut moved = Vector::zeros();
        (0..=intervals).map(move |i| {
            if i > 0 {
                let from = width * (i - 1) as f64;
                moved += if allows(THREE_POINTS) {
                    spiral.rule(&curvature, start.yaw, from, width, &GAUSS_3)
                } else if allows(FIVE_POINTS) {
                    spiral.rule(&curvature, start.yaw, from, width, &GAUSS_5)
                } else {
                    spiral.displacement(&curvature, start.yaw, from, from + width, panels::<K>(turning))
                };
            }
            let u = i as f64 / intervals as f64;
            (u * spiral.length, spiral.path_point(&curvature, &start, moved, u))
        })
    }

    /// [`Self::samples`], collected.
    #[must_use]
    pub fn sampled(&self, start: &Pose, intervals: usize) -> Vec<(f64, PathPoint)> {
        self.samples(start, intervals).collect()
    }

    /// Smallest and largest curvature on the whole spiral, 1/m: exact to rounding.
    #[must_use]
    pub fn curvature_range(&self) -> (f64, f64) {
        let curvature = self.curvature_polynomial();
        let inner = curvature.roots_of_derivative(1).iter().map(|u| curvature.value(u));
        range(inner.chain([self.knots[0], self.knots[K - 1]]))
    }

    /// Largest |curvature| on the whole spiral, 1/m: exact to rounding.
    #[must_use]
    pub fn max_abs_curvature(&self) -> f64 {
        let (low, high) = self.curvature_range();
        low.abs().max(high.abs())
    }

    /// Smallest and largest curvature rate on the whole spiral, 1/m²: exact to rounding.
    #[must_use]
    pub fn curvature_rate_range(&self) -> (f64, f64) {
        let curvature = self.curvature_polynomial();
        let inner = curvature.roots_of_derivative(2).iter();
        range(inner.chain([0.0, 1.0]).map(|u| curvature.derivative(u) / self.length))
    }

    /// Largest |curvature rate| on the whole spiral, 1/m²: exact to rounding.
    #[must_use]
    pub fn max_abs_curvature_rate(&self) -> f64 {
        let (low, high) = self.curvature_rate_range();
        low.abs().max(high.abs())
    }

    /// Bending energy ∫ κ² ds = L kᵀ M k, 1/m: exact to rounding.
    #[must_use]
    pub fn bending_energy(&self) -> f64 {
        let mut sum = 0.0;
        for (row, k) in Tables::<K>::MASS.iter().zip(&self.knots) {
            sum += k * row.iter().zip(&self.knots).map(|(m, k)| m * k).sum::<f64>();
        }
        sum * self.length
    }

    /// The spiral mirrored at its start heading: left and right exchanged.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        Self { knots: self.knots.map(|k| -k), length: self.length }
    }

    /// The part between two arc lengths (m), `from < to`. Exact, since a part of a polynomial is a polynomial.
    #[must_use]
    pub fn part(&self, from: f64, to: f64) -> Self {
        let length = to - from;
        let curvature = self.curvature_polynomial();
        Self { knots: std::array::from_fn(|i| curvature.value((from + knot::<K>(i) * length) / self.length)), length }
    }
}

impl CubicSpiral {
    /// The same curve as a quintic.
    #[must_use]
    pub fn elevated(&self) -> QuinticSpiral {
        let curvature = self.curvature_polynomial();
        let mut knots: [f64; 6] = std::array::from_fn(|i| curvature.value(knot::<6>(i)));
        knots[5] = self.knots[3]; // without rounding
        QuinticSpiral { knots, length: self.length }
    }
}

/// Normalised arc length of a knot.
fn knot<const K: usize>(i: usize) -> f64 {
    i as f64 / (K - 1) as f64
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), k| (low.min(k), high.max(k)))
}

/// Number of eight-point panels for a turning, rad.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small positive count
fn panels<const K: usize>(turning: f64) -> usize {
    /// Limits the work for input that turns more than any road; accuracy does not matter there.
    const MAX_PANELS: f64 = 64.0;
    let per_panel = if K <= 4 { TURN_PER_PANEL } else { TURN_PER_PANEL_OF_A_QUINTIC };
    if turning <= TURN_OF_ONE_PANEL { 1 } else { 2 + (turning / per_panel).min(MAX_PANELS) as usize }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Displacement by Simpson's rule on a fine grid: slow, and independent of the Gauss rules.
    fn simpson<const K: usize>(spiral: &Spiral<K>, start: &Pose, s: f64) -> Vector {
        let n = 20_000;
        let direction = |i: usize| {
            let t = s * i as f64 / n as f64;
            let (sin, cos) = (start.yaw + spiral.heading_change(t)).sin_cos();
            Vector::new(cos, sin)
        };
        let inner: Vector =
            (1..n).map(|i| direction(i) * if i % 2 == 1 { 4.0 } else { 2.0 }).fold(Vector::zeros(), |a, b| a + b);
        (direction(0) + inner + direction(n)) * (s / n as f64 / 3.0)
    }

    fn spirals() -> impl Strategy<Value = CubicSpiral> {
        (prop::array::uniform4(-0.25..0.25f64), 1.0..60.0f64).prop_filter_map("turns too much", |(knots, length)| {
            let spiral = CubicSpiral { knots, length };
            let turning = (0..=100).map(|i| spiral.heading_change(length * f64::from(i) / 100.0).abs());
            (turning.fold(0.0, f64::max) <= std::f64::consts::PI).then_some(spiral)
        })
    }

    proptest! {
        #[test]
        fn position_agrees_with_dense_simpson(spiral in spirals(), yaw in -3.0..3.0f64, part in 0.0..1.0f64) {
            let start = Pose::new(0.0, 0.0, yaw);
            let s = part * spiral.length;
            let error = (spiral.point_at(&start, s).pose.position.coords - simpson(&spiral, &start, s)).norm();
            prop_assert!(error < 1e-9, "off by {error:e} m at {s}");
        }

        #[test]
        fn sweep_and_single_points_agree(spiral in spirals(), intervals in 1..200usize) {
            let start = Pose::new(3.0, -2.0, 0.7);
            let swept = spiral.sampled(&start, intervals);
            prop_assert_eq!(swept.len(), intervals + 1);
            for (s, point) in swept {
                let single = spiral.point_at(&start, s);
                prop_assert!((point.pose.position - single.pose.position).norm() < 1e-9);
                prop_assert!((point.pose.yaw - single.pose.yaw).abs() < 1e-12);
                prop_assert!((point.curvature - single.curvature).abs() < 1e-13);
            }
        }

        #[test]
        fn derivatives_agree_with_differences(spiral in spirals(), part in 0.05..0.95f64) {
            let (s, h) = (part * spiral.length, 1e-4 * spiral.length);
            let start = Pose::new(0.0, 0.0, 0.0);
            let (before, after) = (spiral.point_at(&start, s - h), spiral.point_at(&start, s + h));
            let middle = spiral.point_at(&start, s);
            let scale = 1.0 / spiral.length;
            prop_assert!(((after.pose.yaw - before.pose.yaw) / (2.0 * h) - middle.curvature).abs() < 1e-6);
            prop_assert!(((after.curvature - before.curvature) / (2.0 * h) - middle.curvature_rate).abs() < 1e-5 * scale);
            let tangent = (after.pose.position - before.pose.position) / (2.0 * h);
            prop_assert!((tangent - middle.pose.forward()).norm() < 1e-5);
        }

        #[test]
        fn closed_form_extrema_bound_every_sample_and_are_reached(spiral in spirals()) {
            let samples: Vec<f64> = (0..=2000).map(|i| spiral.length * f64::from(i) / 2000.0).collect();
            let curvature = samples.iter().fold(0.0_f64, |m, s| m.max(spiral.curvature(*s).abs()));
            let rate = samples.iter().fold(0.0_f64, |m, s| m.max(spiral.curvature_rate(*s).abs()));
            prop_assert!(spiral.max_abs_curvature() >= curvature - 1e-13);
            prop_assert!(spiral.max_abs_curvature() <= curvature + 1e-5);
            prop_assert!(spiral.max_abs_curvature_rate() >= rate - 1e-13);
            prop_assert!(spiral.max_abs_curvature_rate() <= rate + 1e-5 / spiral.length.min(1.0));
        }

        #[test]
        fn bending_energy_is_the_integral_of_squared_curvature(spiral in spirals()) {
            let n = 3000;
            let dense: f64 = (0..n).map(|i| spiral.curvature(spiral.length * (f64::from(i) + 0.5) / f64::from(n)).powi(2))
                .sum::<f64>() * spiral.length / f64::from(n);
            prop_assert!((dense - spiral.bending_energy()).abs() < 1e-5 * (1.0 + dense));
        }

        #[test]
        fn a_part_lies_on_the_whole_spiral(spiral in spirals(), a in 0.0..0.9f64, b in 0.05..1.0f64) {
            let from = a * spiral.length;
            let to = from + b * (spiral.length - from);
            let start = Pose::new(1.0, 2.0, 0.3);
            let part = spiral.part(from, to);
            let end = part.end(&spiral.point_at(&start, from).pose);
            let whole = spiral.point_at(&start, to).pose;
            prop_assert!((end.position - whole.position).norm() < 1e-9);
            prop_assert!((end.yaw - whole.yaw).abs() < 1e-11);
        }
    }

    #[test]
    fn a_circle_closes_its_quarter() {
        let quarter = CubicSpiral { knots: [0.1; 4], length: 5.0 * std::f64::consts::PI };
        let end = quarter.end(&Pose::new(0.0, 0.0, 0.0));
        assert!((end.position - crate::geometry::Point::new(10.0, 10.0)).norm() < 1e-12);
        assert!((quarter.bending_energy() - 0.01 * quarter.length).abs() < 1e-15);
    }
}
