//! Quintic polynomial paths: x and y are polynomials of degree five in a parameter u ∈ [0, 1].
//!
//! Six coefficients per axis meet position, first and second derivative at both ends in closed form (quintic Hermite
//! interpolation). Pose and curvature determine these derivatives up to the parametrisation. With the unit tangent T and
//! the left normal N
//!
//! ```text
//! r′ = e T        r″ = a T + κ e² N        e > 0 the tangent length, a the tangential second derivative, both in m
//! ```
//!
//! so that e and a at both ends ([`Tangents`]) are free. [`connect`] sets e to the chord length and a to 0, which is exact
//! on a straight line. [`connect_least_bending`] searches for the e, the same at both ends, of least bending energy.
//!
//! This curve is the alternative to the polynomial spiral ([`super::spiral`]). It costs a few dozen multiplications and no
//! iteration, and it reaches every end. Its curvature (1/m, positive to the left)
//!
//! ```text
//! κ(u) = (r′ × r″) / |r′|³
//! ```
//!
//! is a rational function that the construction does not control. **It has two weaknesses**, both shown in the tests:
//!
//! - *Peaks between the ends.* Where |r′| decreases between the ends, κ grows with its inverse cube: on lattice problems
//!   up to 1.5 times the largest curvature of the spiral between the same ends.
//! - *Dependence on e.* Each tangent length gives a different path with a different largest curvature, and a tangent that
//!   is too long makes a cusp or a loop. No length suits all problems. Minimising the bending energy, the natural choice,
//!   costs more than solving for a spiral and often results in a higher peak.
//!
//! Arc length has no closed form. It is computed by Gauss–Legendre quadrature, and the parameter at an arc length by
//! Newton's method. Outside [0, length] arc lengths are clamped to the ends.
//!
//! Source: Takahashi, Hongo, Ninomiya & Sugimoto 1989 (local path planning with quintics in the plane); the free
//! parameters as in Piazzi, Guarino Lo Bianco, Bertozzi, Fascioli & Broggi 2002 ("G²-splines", η₁…η₄).

use thiserror::Error;

use super::quadrature::GAUSS_8;
use super::spiral::PathPoint;
use super::{Pose, Vector, cross, wrap_angle};

/// The parametrisation at the ends: the freedom that pose and curvature leave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tangents {
    /// |r′| at the start, m, positive.
    pub start: f64,
    /// |r′| at the end, m, positive.
    pub end: f64,
    /// Tangential component of r″ at the start, m.
    pub start_stretch: f64,
    /// Tangential component of r″ at the end, m.
    pub end_stretch: f64,
}

impl Tangents {
    /// The same tangent length at both ends, m, and no stretch.
    #[must_use]
    pub fn equal(length: f64) -> Self {
        Self { start: length, end: length, start_stretch: 0.0, end_stretch: 0.0 }
    }
}

/// Why there is no path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum QuinticFailure {
    /// An input is not a finite number, or so large that the coefficients overflow.
    #[error("an end condition is not a finite number")]
    NotFinite,
    /// Start and end are less than a millimetre apart.
    #[error("start and end coincide")]
    Coincident,
    /// A tangent length is zero or negative.
    #[error("a tangent length is not positive")]
    TangentLength,
}

/// A quintic polynomial path, in its own start frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuinticPath {
    /// Position by ascending powers of u, m.
    coefficients: [Vector; 6],
}

/// Ends nearer than this coincide, m; as for spirals.
const SAME_POINT: f64 = 1e-3;
/// Eight-point panels over [0, 1]: arc length within 1e-8 m on lattice problems, by the tests below.
const PANELS: f64 = 8.0;
/// Newton's method for the point at an arc length stops here, m.
const STATION_TOLERANCE: f64 = 1e-10;
/// Its iteration limit. Three or four are usual; near a cusp bisection takes over, and the limit is still enough.
const MAX_ITERATIONS: usize = 60;
/// Number of intervals that are checked for a sign change of the curvature's derivative.
const BRACKETS: u32 = 128;
/// Bisections of such an interval: down to rounding.
const HALVINGS: usize = 50;
/// Range of the tangent length over the chord in [`connect_least_bending`], and the steps of its initial scan.
const SEARCH: (f64, f64, u32) = (0.3, 2.5, 22);
/// Golden-section steps after the scan: each shrinks the interval by 0.618, in total to 1e-6 of the chord.
const GOLDEN_STEPS: usize = 26;

/// The path from the origin with heading 0 and `start_curvature` (1/m) to the pose `end` (in that frame) with
/// `end_curvature` (1/m). Both tangents are as long as the chord. The end conditions hold to rounding.
///
/// # Errors
/// [`QuinticFailure::NotFinite`] and [`QuinticFailure::Coincident`].
pub fn connect(start_curvature: f64, end: &Pose, end_curvature: f64) -> Result<QuinticPath, QuinticFailure> {
    let chord = chord(start_curvature, end, end_curvature)?;
    connect_with(start_curvature, end, end_curvature, &Tangents::equal(chord))
}

/// [`connect`] with the given free parameters.
///
/// # Errors
/// See [`QuinticFailure`].
pub fn connect_with(
    start_curvature: f64,
    end: &Pose,
    end_curvature: f64,
    tangents: &Tangents,
) -> Result<QuinticPath, QuinticFailure> {
    chord(start_curvature, end, end_curvature)?;
    let Tangents { start, end: last, start_stretch, end_stretch } = *tangents;
    if ![start, last, start_stretch, end_stretch].iter().all(|v| v.is_finite()) {
        return Err(QuinticFailure::NotFinite);
    }
    if !(start > 0.0 && last > 0.0) {
        return Err(QuinticFailure::TangentLength);
    }
    let d = end.position.coords;
    let v0 = Vector::new(start, 0.0);
    let a0 = Vector::new(start_stretch, start_curvature * start * start);
    let v1 = end.forward() * last;
    let a1 = end.forward() * end_stretch + end.left() * (end_curvature * last * last);
    let coefficients = [
        Vector::zeros(),
        v0,
        a0 * 0.5,
        d * 10.0 - v0 * 6.0 - v1 * 4.0 - a0 * 1.5 + a1 * 0.5,
        d * -15.0 + v0 * 8.0 + v1 * 7.0 + a0 * 1.5 - a1,
        d * 6.0 - v0 * 3.0 - v1 * 3.0 - a0 * 0.5 + a1 * 0.5,
    ];
    let finite = coefficients.iter().all(|c| c.x.is_finite() && c.y.is_finite());
    if finite { Ok(QuinticPath { coefficients }) } else { Err(QuinticFailure::NotFinite) }
}

/// [`connect`] with the tangent length of least bending energy, the same at both ends and between 0.3 and 2.5 chords: a
/// scan of 23 lengths, then a golden-section search around the best. About 50 times the work of [`connect`].
///
/// # Errors
/// [`QuinticFailure::NotFinite`] and [`QuinticFailure::Coincident`].
pub fn connect_least_bending(
    start_curvature: f64,
    end: &Pose,
    end_curvature: f64,
) -> Result<QuinticPath, QuinticFailure> {
    let chord = chord(start_curvature, end, end_curvature)?;
    let path = |ratio: f64| connect_with(start_curvature, end, end_curvature, &Tangents::equal(ratio * chord));
    // failures and cusps are not candidates
    let energy = |ratio: f64| path(ratio).map_or(f64::INFINITY, |p| finite_or_infinity(p.bending_energy()));
    let (min, max, steps) = SEARCH;
    let width = (max - min) / f64::from(steps);
    let ratios = (0..=steps).map(|i| min + width * f64::from(i));
    let best = ratios.min_by(|a, b| energy(*a).total_cmp(&energy(*b))).unwrap_or(1.0);
    path(golden_section((best - width).max(min), (best + width).min(max), energy))
}

fn finite_or_infinity(value: f64) -> f64 {
    if value.is_finite() { value } else { f64::INFINITY }
}

/// The minimiser between two bounds of a function with one minimum there (Kiefer 1953).
fn golden_section(mut low: f64, mut high: f64, f: impl Fn(f64) -> f64) -> f64 {
    const RATIO: f64 = 0.618_033_988_749_894_8;
    let (mut left, mut right) = (high - RATIO * (high - low), low + RATIO * (high - low));
    let (mut at_left, mut at_right) = (f(left), f(right));
    for _ in 0..GOLDEN_STEPS {
        if at_left <= at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - RATIO * (high - low);
            at_left = f(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + RATIO * (high - low);
            at_right = f(right);
        }
    }
    0.5 * (low + high)
}

/// The distance between the ends, m, or the reason why there is no path between them.
fn chord(start_curvature: f64, end: &Pose, end_curvature: f64) -> Result<f64, QuinticFailure> {
    let d = end.position.coords;
    if ![d.x, d.y, end.yaw, start_curvature, end_curvature, d.norm()].iter().all(|v| v.is_finite()) {
        return Err(QuinticFailure::NotFinite);
    }
    if d.norm() < SAME_POINT { Err(QuinticFailure::Coincident) } else { Ok(d.norm()) }
}

/// First three derivatives of the position by the parameter, m.
struct Derivatives {
    first: Vector,
    second: Vector,
    third: Vector,
}

impl Derivatives {
    fn curvature(&self) -> f64 {
        cross(self.first, self.second) / self.first.norm().powi(3)
    }

    /// dκ/du · |r′|⁵, with the sign of dκ/du: |r′|² (r′ × r‴) − 3 (r′ × r″)(r′ · r″).
    fn curvature_slope(&self) -> f64 {
        self.first.norm_squared() * cross(self.first, self.third)
            - 3.0 * cross(self.first, self.second) * self.first.dot(&self.second)
    }
}

impl QuinticPath {
    /// Position by ascending powers of u, m, in the start frame.
    #[must_use]
    pub fn coefficients(&self) -> &[Vector; 6] {
        &self.coefficients
    }

    fn position(&self, u: f64) -> Vector {
        self.coefficients.iter().rev().fold(Vector::zeros(), |sum, c| sum * u + c)
    }

    fn first_derivative(&self, u: f64) -> Vector {
        let [_, b, c, d, e, f] = &self.coefficients;
        b + (c * 2.0 + (d * 3.0 + (e * 4.0 + f * (5.0 * u)) * u) * u) * u
    }

    fn derivatives(&self, u: f64) -> Derivatives {
        let [_, _, c, d, e, f] = &self.coefficients;
        Derivatives {
            first: self.first_derivative(u),
            second: c * 2.0 + (d * 6.0 + (e * 12.0 + f * (20.0 * u)) * u) * u,
            third: d * 6.0 + (e * 24.0 + f * (60.0 * u)) * u,
        }
    }

    /// Pose and curvature at the parameter `u` ∈ [0, 1] of the path that begins at `start`. The heading is the start
    /// heading plus an angle in (−π, π]: it jumps where the path has turned by more than half a turn. Curvature and its
    /// derivative are NaN at a cusp.
    #[must_use]
    pub fn at(&self, start: &Pose, u: f64) -> PathPoint {
        let d = self.derivatives(u);
        let turn = wrap_angle(d.first.y.atan2(d.first.x));
        let position = start.to_world(self.position(u).into());
        PathPoint {
            pose: Pose { position, yaw: start.yaw + turn },
            curvature: d.curvature(),
            curvature_rate: d.curvature_slope() / d.first.norm().powi(6),
        }
    }

    /// Pose and curvature at arc length `s` (clamped to the path) from `start`.
    #[must_use]
    pub fn point_at(&self, start: &Pose, s: f64) -> PathPoint {
        self.at(start, self.parameter_at(s))
    }

    /// The pose at the end.
    #[must_use]
    pub fn end(&self, start: &Pose) -> Pose {
        self.at(start, 1.0).pose
    }

    /// Curvature at the parameter `u` ∈ [0, 1], 1/m.
    #[must_use]
    pub fn curvature(&self, u: f64) -> f64 {
        self.derivatives(u).curvature()
    }

    /// Arc length, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.arc_length(0.0, 1.0)
    }

    /// Arc length between two parameters, m; negative if `to < from`. Accurate to 1e-8 m on lattice problems.
    #[must_use]
    pub fn arc_length(&self, from: f64, to: f64) -> f64 {
        integral(from, to, |u| self.first_derivative(u).norm())
    }

    /// The parameter at arc length `s`, m, clamped to the path.
    #[must_use]
    pub fn parameter_at(&self, s: f64) -> f64 {
        self.advanced((0.0, 0.0), s, self.length())
    }

    /// The parameter at arc length `s`, given an earlier parameter and its arc length: Newton's method on the arc length
    /// with its derivative |r′|, and bisection where a step leaves the bracket.
    fn advanced(&self, (from, from_s): (f64, f64), s: f64, length: f64) -> f64 {
        if s >= length {
            return 1.0;
        }
        let (mut low, mut high) = (from, 1.0);
        let mut u = from;
        let mut error = from_s - s;
        for _ in 0..MAX_ITERATIONS {
            if error.abs() <= STATION_TOLERANCE {
                break;
            }
            if error > 0.0 {
                high = u
            } else {
                low = u
            }
            let newton = u - error / self.first_derivative(u).norm();
            let next = if low < newton && newton < high { newton } else { f64::midpoint(low, high) };
            error += self.arc_length(u, next);
            u = next;
        }
        u
    }

    /// `intervals` + 1 points at equal spacing of arc length, both ends included, each with its arc length (m). At least
    /// one interval.
    #[must_use]
    pub fn sampled(&self, start: &Pose, intervals: usize) -> Vec<(f64, PathPoint)> {
        let length = self.length();
        let intervals = intervals.max(1);
        let mut last = (0.0, 0.0);
        let sample = |i: usize| {
            let s = length * i as f64 / intervals as f64;
            last = (self.advanced(last, s, length), s);
            (s, self.at(start, last.0))
        };
        (0..=intervals).map(sample).collect()
    }

    /// Bending energy ∫ κ² ds, 1/m, by quadrature. Not finite if a node of the quadrature lies at a cusp.
    #[must_use]
    pub fn bending_energy(&self) -> f64 {
        integral(0.0, 1.0, |u| {
            let d = self.derivatives(u);
            // κ² |r′|
            cross(d.first, d.second).powi(2) / d.first.norm().powi(5)
        })
    }

    /// Smallest and largest curvature on the whole path, 1/m.
    ///
    /// The zeros of dκ/du, a polynomial of degree 13 over |r′|⁵, are bracketed by its signs at 129 equidistant
    /// parameters and located by bisection. Two extrema within one interval are missed; the error is at most the change
    /// of curvature within 1/128 of the path, which matters only near a cusp.
    #[must_use]
    pub fn curvature_range(&self) -> (f64, f64) {
        let slope = |u: f64| self.derivatives(u).curvature_slope();
        let mut range = (f64::INFINITY, f64::NEG_INFINITY);
        let mut include = |u: f64| {
            let k = self.curvature(u);
            range = (range.0.min(k), range.1.max(k));
        };
        let mut before = (0.0, slope(0.0));
        include(0.0);
        for i in 1..=BRACKETS {
            let u = f64::from(i) / f64::from(BRACKETS);
            let now = (u, slope(u));
            if before.1 * now.1 < 0.0 {
                include(bisected(before, now.0, slope));
            }
            include(u);
            before = now;
        }
        range
    }

    /// Largest |curvature| on the whole path, 1/m; see [`Self::curvature_range`].
    #[must_use]
    pub fn max_abs_curvature(&self) -> f64 {
        let (low, high) = self.curvature_range();
        low.abs().max(high.abs())
    }

    /// The path mirrored at its start heading: left and right exchanged.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        Self { coefficients: self.coefficients.map(|c| Vector::new(c.x, -c.y)) }
    }
}

/// The argument at which `f` changes sign; `f(low)` is `at_low`, and `f(high)` has the opposite sign.
fn bisected((mut low, at_low): (f64, f64), mut high: f64, f: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..HALVINGS {
        let middle = f64::midpoint(low, high);
        if f(middle) * at_low > 0.0 { low = middle } else { high = middle }
    }
    f64::midpoint(low, high)
}

/// ∫ f du by eight-point Gauss–Legendre panels, in proportion to the length of the interval.
fn integral(from: f64, to: f64, f: impl Fn(f64) -> f64) -> f64 {
    let panels = ((to - from).abs() * PANELS).ceil().clamp(1.0, PANELS);
    let width = (to - from) / panels;
    let mut sum = 0.0;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 1…8
    for panel in 0..panels as u32 {
        let left = from + width * f64::from(panel);
        sum += GAUSS_8.iter().map(|(node, weight)| weight * f(left + width * node)).sum::<f64>();
    }
    sum * width
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use crate::geometry::spiral;
    use crate::geometry::spiral::lattice_problems;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    const ORIGIN: Pose = Pose { position: Point::new(0.0, 0.0), yaw: 0.0 };

    fn problems() -> impl Strategy<Value = (f64, Pose, f64, Tangents)> {
        let end = (10.0..40.0f64, -8.0..8.0f64, -0.5..0.5f64).prop_map(|(x, y, yaw)| Pose::new(x, y, yaw));
        let tangents = (0.7..1.4f64, 0.7..1.4f64, -0.3..0.3f64, -0.3..0.3f64);
        (-0.1..0.1f64, end, -0.1..0.1f64, tangents).prop_map(|(start, end, curvature, (e0, e1, a0, a1))| {
            let chord = end.position.coords.norm();
            let tangents =
                Tangents { start: e0 * chord, end: e1 * chord, start_stretch: a0 * chord, end_stretch: a1 * chord };
            (start, end, curvature, tangents)
        })
    }

    proptest! {
        #[test]
        fn end_conditions_hold_to_rounding((start, end, curvature, tangents) in problems(), yaw in -3.0..3.0f64) {
            let path = connect_with(start, &end, curvature, &tangents).unwrap();
            let from = Pose::new(500_000.0, 5_000_000.0, yaw);
            let (first, last) = (path.at(&from, 0.0), path.at(&from, 1.0));
            prop_assert_eq!(first.pose, from);
            prop_assert!((first.curvature - start).abs() < 1e-15);
            // coordinates of 5e6 m have a resolution of a nanometre
            prop_assert!((from.to_local(last.pose.position) - end.position).norm() < 3e-9);
            prop_assert!((path.end(&ORIGIN).position - end.position).norm() < 1e-12);
            prop_assert!((path.end(&ORIGIN).yaw - end.yaw).abs() < 1e-13);
            prop_assert!((last.curvature - curvature).abs() < 1e-12);
            let d = path.derivatives(1.0);
            prop_assert!((d.first.norm() - tangents.end).abs() < 1e-11);
            prop_assert!((d.second.dot(&end.forward()) - tangents.end_stretch).abs() < 1e-10);
        }

        #[test]
        fn derivatives_agree_with_differences((start, end, curvature, tangents) in problems(), part in 0.05..0.95f64) {
            let path = connect_with(start, &end, curvature, &tangents).unwrap();
            let (s, h) = (part * path.length(), 1e-4 * path.length());
            let (before, here, after) =
                (path.point_at(&ORIGIN, s - h), path.point_at(&ORIGIN, s), path.point_at(&ORIGIN, s + h));
            prop_assume!(path.max_abs_curvature() < 0.5); // finite differences are inaccurate at sharp peaks
            let tangent = (after.pose.position - before.pose.position) / (2.0 * h);
            prop_assert!((tangent - here.pose.forward()).norm() < 1e-4);
            prop_assert!((wrap_angle(after.pose.yaw - before.pose.yaw) / (2.0 * h) - here.curvature).abs() < 1e-4);
            let rate = (after.curvature - before.curvature) / (2.0 * h);
            prop_assert!((rate - here.curvature_rate).abs() < 1e-3 * (1.0 + here.curvature_rate.abs()));
        }

        #[test]
        fn arc_length_and_energy_agree_with_dense_simpson((start, end, curvature, _) in problems()) {
            let path = connect(start, &end, curvature).unwrap();
            let simpson = |f: &dyn Fn(f64) -> f64| {
                let n = 2000;
                let at = |i: i32| f(f64::from(i) / f64::from(n));
                let inner: f64 = (1..n).map(|i| at(i) * if i % 2 == 1 { 4.0 } else { 2.0 }).sum();
                (at(0) + inner + at(n)) / f64::from(n) / 3.0
            };
            let length = simpson(&|u| path.derivatives(u).first.norm());
            prop_assert!((path.length() - length).abs() < 1e-8, "{} and {length}", path.length());
            let energy = simpson(&|u| path.curvature(u).powi(2) * path.derivatives(u).first.norm());
            prop_assert!((path.bending_energy() - energy).abs() < 1e-6 * energy, "{} {energy}", path.bending_energy());
        }

        #[test]
        fn the_point_at_an_arc_length_has_that_arc_length((start, end, curvature, tangents) in problems(), part in 0.0..1.0f64) {
            let path = connect_with(start, &end, curvature, &tangents).unwrap();
            let s = part * path.length();
            prop_assert!((path.arc_length(0.0, path.parameter_at(s)) - s).abs() < 1e-7);
            let samples = path.sampled(&ORIGIN, 37);
            prop_assert_eq!(samples.len(), 38);
            for (s, point) in samples {
                prop_assert!((point.pose.position - path.point_at(&ORIGIN, s).pose.position).norm() < 1e-7);
            }
        }

        #[test]
        fn extrema_bound_every_sample_and_are_reached((start, end, curvature, tangents) in problems()) {
            let path = connect_with(start, &end, curvature, &tangents).unwrap();
            let samples = (0..=20_000).map(|i| path.curvature(f64::from(i) / 20_000.0));
            let (low, high) = samples.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), k| (l.min(k), h.max(k)));
            let (min, max) = path.curvature_range();
            let rounding = 1e-12 + 1e-9 * path.max_abs_curvature();
            prop_assert!(min <= low + rounding && high - rounding <= max, "{min} {low} {high} {max}");
            prop_assert!(max - high < 1e-5 * (1.0 + high.abs()) && low - min < 1e-5 * (1.0 + low.abs()));
        }
    }

    #[test]
    fn a_straight_line_is_parametrised_by_arc_length() {
        let path = connect(0.0, &Pose::new(20.0, 0.0, 0.0), 0.0).unwrap();
        assert_eq!((path.max_abs_curvature(), path.bending_energy()), (0.0, 0.0));
        assert!((path.length() - 20.0).abs() < 1e-12);
        let point = path.point_at(&Pose::new(1.0, 2.0, PI / 2.0), 5.0).pose;
        assert!((point.position - Point::new(1.0, 7.0)).norm() < 1e-9);
    }

    #[test]
    fn reproduces_a_parabola() {
        // r(u) = (c u, a u²) is a quintic, so its end conditions determine it
        let (c, a) = (20.0_f64, 6.0_f64);
        let e = c.hypot(2.0 * a);
        let end = Pose::new(c, a, (2.0 * a).atan2(c));
        let curvature = |u: f64| 2.0 * a * c / (c * c + (2.0 * a * u).powi(2)).powf(1.5);
        let tangents = Tangents { start: c, end: e, start_stretch: 0.0, end_stretch: 4.0 * a * a / e };
        let path = connect_with(curvature(0.0), &end, curvature(1.0), &tangents).unwrap();
        for (power, expected) in [Vector::zeros(), Vector::new(c, 0.0), Vector::new(0.0, a)].iter().enumerate() {
            assert!((path.coefficients()[power] - expected).norm() < 1e-12);
        }
        assert!(path.coefficients()[3..].iter().all(|c| c.norm() < 1e-11), "{path:?}");
        for u in [0.0, 0.3, 0.7, 1.0] {
            assert!((path.curvature(u) - curvature(u)).abs() < 1e-13);
        }
        let length = 0.5 * e + c * c / (4.0 * a) * (2.0 * a / c).asinh();
        assert!((path.length() - length).abs() < 1e-11, "{} {length}", path.length());
        assert!((path.max_abs_curvature() - curvature(0.0)).abs() < 1e-15, "largest at the vertex");
    }

    #[test]
    fn approximates_a_quarter_circle_to_a_thousandth_with_tangents_as_long_as_the_arc() {
        let (radius, arc) = (10.0, 5.0 * PI);
        let end = Pose::new(radius, radius, PI / 2.0);
        let path = connect_with(1.0 / radius, &end, 1.0 / radius, &Tangents::equal(arc)).unwrap();
        assert!((path.length() - arc).abs() < 1e-3 * arc, "{}", path.length());
        for (_, point) in path.sampled(&ORIGIN, 100) {
            let from_centre = (point.pose.position - Point::new(0.0, radius)).norm();
            assert!((from_centre - radius).abs() < 1e-3 * radius, "{from_centre}");
        }
        let (low, high) = path.curvature_range();
        assert!(low > 0.97 / radius && high < 1.03 / radius, "{low} {high}");
        let least = connect_least_bending(1.0 / radius, &end, 1.0 / radius).unwrap();
        assert!(least.bending_energy() <= path.bending_energy() + 1e-9);
    }

    #[test]
    fn mirrored_problems_have_mirrored_paths_to_the_bit() {
        for (start, end, curvature) in lattice_problems(200) {
            let mirrored_end = Pose::new(end.position.x, -end.position.y, -end.yaw);
            let direct = connect(start, &end, curvature).unwrap();
            assert_eq!(connect(-start, &mirrored_end, -curvature).unwrap(), direct.mirrored());
            let least = connect_least_bending(start, &end, curvature).unwrap();
            assert_eq!(connect_least_bending(-start, &mirrored_end, -curvature).unwrap(), least.mirrored());
        }
    }

    #[test]
    fn no_scanned_tangent_length_bends_less_than_the_optimum() {
        for (start, end, curvature) in lattice_problems(50) {
            let least = connect_least_bending(start, &end, curvature).unwrap().bending_energy();
            let chord = end.position.coords.norm();
            for i in 0..=220 {
                let tangents = Tangents::equal(chord * (0.3 + 0.01 * f64::from(i)));
                let other = connect_with(start, &end, curvature, &tangents).unwrap().bending_energy();
                assert!(other.is_nan() || least <= other * (1.0 + 1e-6), "{least} {other} at {i}: {start} {end:?}");
            }
        }
    }

    /// The weaknesses that the module documentation names, compared with the spiral between the same ends.
    #[test]
    fn curvature_depends_on_the_tangent_length_and_ends_in_a_cusp() {
        // from a straight into a curve with a radius of 12.5 m
        let (end, curvature) = (Pose::new(14.0, 3.0, 0.5), 0.08);
        let spiral = spiral::connect(0.0, &end, curvature).unwrap().max_abs_curvature();
        assert!((spiral - curvature).abs() < 1e-12, "the spiral exceeds the end curvature: {spiral}");
        let peak = |ratio: f64| {
            let tangents = Tangents::equal(ratio * end.position.coords.norm());
            connect_with(0.0, &end, curvature, &tangents).unwrap().max_abs_curvature()
        };
        let [short, chord, long, too_long] = [0.75, 1.0, 1.5, 2.5].map(peak);
        assert!((chord - curvature).abs() < 1e-12, "{chord}");
        assert!(short > 1.07 * curvature && long > 1.4 * curvature, "{short} {long}");
        assert!(too_long > 1000.0 * curvature, "{too_long}");
    }

    #[test]
    fn curvature_peaks_between_the_ends_where_the_spirals_does_not() {
        let mut by_chord = Vec::new();
        let mut by_energy = Vec::new();
        for (start, end, curvature) in lattice_problems(2000) {
            let spiral = spiral::connect(start, &end, curvature).unwrap().max_abs_curvature();
            by_chord.push(connect(start, &end, curvature).unwrap().max_abs_curvature() / spiral);
            by_energy.push(connect_least_bending(start, &end, curvature).unwrap().max_abs_curvature() / spiral);
        }
        for ratios in [by_chord, by_energy] {
            let above = ratios.iter().filter(|r| **r > 1.2).count();
            assert!(above >= 100, "only {above} of 2000 exceed the spiral by a fifth");
            assert!(ratios.iter().any(|r| *r > 1.5), "none exceeds the spiral by half");
            assert!(ratios.iter().all(|r| *r > 0.8), "one is far below the spiral");
        }
    }

    #[test]
    fn each_invalid_input_has_its_failure() {
        let ahead = Pose::new(20.0, 1.0, 0.1);
        assert_eq!(connect(f64::NAN, &ahead, 0.0), Err(QuinticFailure::NotFinite));
        assert_eq!(connect(0.0, &ahead, f64::INFINITY), Err(QuinticFailure::NotFinite));
        assert_eq!(connect(0.0, &Pose::new(f64::NAN, 0.0, 0.0), 0.0), Err(QuinticFailure::NotFinite));
        assert_eq!(connect(0.0, &Pose::new(0.0, 0.0, 1.0), 0.0), Err(QuinticFailure::Coincident));
        assert_eq!(connect_least_bending(0.0, &Pose::new(0.0, 0.0, 1.0), 0.0), Err(QuinticFailure::Coincident));
        for length in [0.0, -1.0] {
            let tangents = Tangents { end: length, ..Tangents::equal(20.0) };
            assert_eq!(connect_with(0.0, &ahead, 0.0, &tangents), Err(QuinticFailure::TangentLength));
        }
        let tangents = Tangents { start_stretch: f64::NAN, ..Tangents::equal(20.0) };
        assert_eq!(connect_with(0.0, &ahead, 0.0, &tangents), Err(QuinticFailure::NotFinite));
        assert_eq!(connect(1e300, &Pose::new(1e200, 0.0, 0.0), 0.0), Err(QuinticFailure::NotFinite));
        // large but finite input terminates with a path or a failure
        if let Ok(path) = connect(1e100, &ahead, -1e100) {
            let _ = (path.length(), path.curvature_range(), path.parameter_at(3.0));
        }
        let behind = connect(0.0, &Pose::new(-10.0, 1.0, 0.0), 0.0).unwrap();
        assert!(behind.length() > 10.0, "an end behind the start must be reached with a loop");
    }
}
