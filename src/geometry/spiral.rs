//! Cubic polynomial spirals: curvature is a cubic polynomial of arc length.
//!
//! A spiral is given by its curvature at u = 0, 1/3, 2/3, 1 of normalised arc length u = s/L and by its length L: well
//! conditioned, and the bending energy is a quadratic form in these four knots (Kelly & Nagy 2003; McNaughton 2011).
//! Heading is the exact integral of the curvature polynomial; position is its Fresnel-like integral, by Gauss–Legendre
//! quadrature with as many panels as the turning asks for.
//!
//! [`connect`] finds the spiral between two poses with given curvatures at both ends. That is a square system: three
//! unknowns (two inner knots, length), three conditions. Heading at the end is linear in the inner knots, so it is
//! eliminated and Newton works on two unknowns with an analytic Jacobian. Where a curvature bound or a soft end leaves
//! something to optimise, see [`super::spiral_opt`].
//!
//! Weak where the heading changes by more than half a turn ([`connect`] takes the heading modulo 2π) and where the end
//! lies beside or behind the start: a cubic has no freedom left there, and `connect` says so instead of returning loops.

use thiserror::Error;

use super::quadrature::{GAUSS_3, GAUSS_5, GAUSS_8};
use super::{Pose, Vector, wrap_angle};

/// A cubic spiral, in its own start frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CubicSpiral {
    /// Curvature at u = 0, 1/3, 2/3, 1, in 1/m.
    pub knots: [f64; 4],
    /// Length, m, positive.
    pub length: f64,
}

/// A point of a path: pose, curvature and its derivative by arc length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Pose of the rear axle.
    pub pose: Pose,
    /// Curvature, 1/m.
    pub curvature: f64,
    /// Derivative of curvature by arc length, 1/m².
    pub curvature_rate: f64,
}

/// Turning (rad, as bounded by [`CubicSpiral::turning_bound`]) up to which one eight-point panel is enough. It is small
/// because the bound does not see how fast curvature varies: a knot pattern of (0, −1, 2, 0) is the bad case, with an
/// error growing as turning⁴.
const TURN_OF_ONE_PANEL: f64 = 0.4;
/// Turning (rad) for each further panel, from the second on: errors below 1e-9 m on 60 m, by the tests below.
const TURN_PER_PANEL: f64 = 2.5;
/// A step of a sweep as short as this against the spiral, and turning as little as this (rad), needs three points only.
const THREE_POINTS: (usize, f64) = (32, 0.06);
/// The same for five points.
const FIVE_POINTS: (usize, f64) = (8, 0.4);

/// A polynomial of degree three in u, by rising powers.
#[derive(Debug, Clone, Copy)]
struct Cubic([f64; 4]);

impl Cubic {
    /// The cubic through four values at u = 0, 1/3, 2/3, 1.
    fn through([k0, k1, k2, k3]: [f64; 4]) -> Self {
        Self([
            k0,
            -5.5 * k0 + 9.0 * k1 - 4.5 * k2 + k3,
            9.0 * k0 - 22.5 * k1 + 18.0 * k2 - 4.5 * k3,
            -4.5 * k0 + 13.5 * k1 - 13.5 * k2 + 4.5 * k3,
        ])
    }

    fn value(&self, u: f64) -> f64 {
        let [a, b, c, d] = self.0;
        a + u * (b + u * (c + u * d))
    }

    fn derivative(&self, u: f64) -> f64 {
        let [_, b, c, d] = self.0;
        b + u * (2.0 * c + u * 3.0 * d)
    }

    /// ∫₀ᵘ.
    fn integral(&self, u: f64) -> f64 {
        let [a, b, c, d] = self.0;
        u * (a + u * (b / 2.0 + u * (c / 3.0 + u * (d / 4.0))))
    }

    /// Where the derivative vanishes inside (0, 1).
    fn extrema(&self) -> impl Iterator<Item = f64> + use<> {
        let [_, b, c, d] = self.0;
        quadratic_roots(3.0 * d, 2.0 * c, b).into_iter().flatten().filter(|u| *u > 0.0 && *u < 1.0)
    }
}

/// Real roots of a u² + b u + c, without cancellation (Numerical Recipes, 5.6). A leading coefficient too small to
/// matter sends its root to infinity, which is where it belongs.
fn quadratic_roots(a: f64, b: f64, c: f64) -> [Option<f64>; 2] {
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return [None, None];
    }
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    let finite = |x: f64| x.is_finite().then_some(x);
    [finite(q / a), finite(c / q)]
}

impl CubicSpiral {
    /// A straight line, m.
    #[must_use]
    pub fn straight(length: f64) -> Self {
        Self { knots: [0.0; 4], length }
    }

    fn curvature_polynomial(&self) -> Cubic {
        Cubic::through(self.knots)
    }

    /// An upper bound of the angle turned through over the whole length, rad. On [0, 1] the Lagrange basis of a cubic
    /// sums to at most 1.64 in absolute value (its Lebesgue constant).
    fn turning_bound(&self) -> f64 {
        const LEBESGUE: f64 = 1.64;
        LEBESGUE * self.length * self.knots.iter().fold(0.0_f64, |m, k| m.max(k.abs()))
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

    /// Change of heading from the start to arc length `s`, rad: exact, not wrapped.
    #[must_use]
    pub fn heading_change(&self, s: f64) -> f64 {
        self.length * self.curvature_polynomial().integral(s / self.length)
    }

    /// Pose and curvature at arc length `s` from `start`. Error of the position below 1e-9 m for up to
    /// 60 m and half a turn, and far below it for lattice edges.
    #[must_use]
    pub fn point_at(&self, start: &Pose, s: f64) -> PathPoint {
        let cubic = self.curvature_polynomial();
        let u = s / self.length;
        let moved = self.displacement(&cubic, start.yaw, 0.0, u, panels(self.turning_bound() * u.abs()));
        self.path_point(&cubic, start, moved, u)
    }

    /// The pose at the end.
    #[must_use]
    pub fn end(&self, start: &Pose) -> Pose {
        self.point_at(start, self.length).pose
    }

    fn path_point(&self, cubic: &Cubic, start: &Pose, moved: Vector, u: f64) -> PathPoint {
        PathPoint {
            pose: Pose { position: start.position + moved, yaw: start.yaw + self.length * cubic.integral(u) },
            curvature: cubic.value(u),
            curvature_rate: cubic.derivative(u) / self.length,
        }
    }

    /// L ∫ (cos, sin)(yaw + θ) du from u = `from` to `to`.
    fn displacement(&self, cubic: &Cubic, yaw: f64, from: f64, to: f64, panels: usize) -> Vector {
        let width = (to - from) / panels as f64;
        let mut sum = Vector::zeros();
        for panel in 0..panels {
            sum += self.rule(cubic, yaw, from + width * panel as f64, width, &GAUSS_8);
        }
        sum
    }

    /// One application of a Gauss rule to the displacement over [from, from + width].
    fn rule(&self, cubic: &Cubic, yaw: f64, from: f64, width: f64, rule: &[(f64, f64)]) -> Vector {
        let mut sum = Vector::zeros();
        for (node, weight) in rule {
            let (sin, cos) = (yaw + self.length * cubic.integral(from + width * node)).sin_cos();
            sum += Vector::new(cos, sin) * *weight;
        }
        sum * (self.length * width)
    }

    /// `intervals` + 1 points at equal spacing, both ends included, each with its arc length. One sweep: every point
    /// is integrated from the one before, so this is the way to sample a whole edge. At least one interval.
    pub fn samples(&self, start: &Pose, intervals: usize) -> impl Iterator<Item = (f64, PathPoint)> + use<> {
        let (spiral, start, intervals) = (*self, *start, intervals.max(1));
        let cubic = spiral.curvature_polynomial();
        let width = 1.0 / intervals as f64;
        let turning = spiral.turning_bound() * width;
        let allows = move |(least, most): (usize, f64)| intervals >= least && turning <= most;
        let mut moved = Vector::zeros();
        (0..=intervals).map(move |i| {
            if i > 0 {
                let from = width * (i - 1) as f64;
                moved += if allows(THREE_POINTS) {
                    spiral.rule(&cubic, start.yaw, from, width, &GAUSS_3)
                } else if allows(FIVE_POINTS) {
                    spiral.rule(&cubic, start.yaw, from, width, &GAUSS_5)
                } else {
                    spiral.displacement(&cubic, start.yaw, from, from + width, panels(turning))
                };
            }
            let u = i as f64 / intervals as f64;
            (u * spiral.length, spiral.path_point(&cubic, &start, moved, u))
        })
    }

    /// [`Self::samples`], collected.
    #[must_use]
    pub fn sampled(&self, start: &Pose, intervals: usize) -> Vec<(f64, PathPoint)> {
        self.samples(start, intervals).collect()
    }

    /// Least and largest curvature on the whole spiral, 1/m: closed form.
    #[must_use]
    pub fn curvature_range(&self) -> (f64, f64) {
        let cubic = self.curvature_polynomial();
        let ends = [self.knots[0], self.knots[3]];
        let inner = cubic.extrema().map(|u| cubic.value(u));
        ends.into_iter()
            .chain(inner)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), k| (low.min(k), high.max(k)))
    }

    /// Largest |curvature| on the whole spiral, 1/m: closed form.
    #[must_use]
    pub fn max_abs_curvature(&self) -> f64 {
        let (low, high) = self.curvature_range();
        low.abs().max(high.abs())
    }

    /// Largest |derivative of curvature| on the whole spiral, 1/m²: closed form.
    #[must_use]
    pub fn max_abs_curvature_rate(&self) -> f64 {
        let cubic = self.curvature_polynomial();
        let vertex = -cubic.0[2] / (3.0 * cubic.0[3]);
        let inner = (vertex > 0.0 && vertex < 1.0).then_some(vertex);
        [0.0, 1.0].into_iter().chain(inner).fold(0.0_f64, |m, u| m.max(cubic.derivative(u).abs())) / self.length
    }

    /// Bending energy ∫ κ² ds = L kᵀ M k, 1/m: exact.
    #[must_use]
    pub fn bending_energy(&self) -> f64 {
        let mut sum = 0.0;
        for (row, k) in KNOT_MASS.iter().zip(&self.knots) {
            sum += k * row.iter().zip(&self.knots).map(|(m, k)| m * k).sum::<f64>();
        }
        sum * self.length
    }

    /// The spiral mirrored on its start heading: left and right exchanged.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        Self { knots: self.knots.map(|k| -k), length: self.length }
    }

    /// The part between two arc lengths, `from < to`; exact, since a part of a cubic is a cubic.
    #[must_use]
    pub fn part(&self, from: f64, to: f64) -> Self {
        let length = to - from;
        Self { knots: [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0].map(|u| self.curvature(from + u * length)), length }
    }
}

/// M_ij = ∫₀¹ N_i N_j du of the cubic Lagrange basis: bending energy is L kᵀ M k.
pub(super) const KNOT_MASS: [[f64; 4]; 4] = {
    const S: f64 = 1680.0;
    [
        [128.0 / S, 99.0 / S, -36.0 / S, 19.0 / S],
        [99.0 / S, 648.0 / S, -81.0 / S, -36.0 / S],
        [-36.0 / S, -81.0 / S, 648.0 / S, 99.0 / S],
        [19.0 / S, -36.0 / S, 99.0 / S, 128.0 / S],
    ]
};

/// Number of eight-point panels for a turning, rad.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small positive count
fn panels(turning: f64) -> usize {
    /// More turning than any road holds: a bound on the work for absurd input, where accuracy does not matter.
    const MOST: f64 = 64.0;
    if turning <= TURN_OF_ONE_PANEL { 1 } else { 2 + (turning / TURN_PER_PANEL).min(MOST) as usize }
}

/// Why no spiral joins the two ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum SpiralFailure {
    /// An input is not a finite number.
    #[error("an end condition is not a finite number")]
    NotFinite,
    /// Start and end are less than a millimetre apart.
    #[error("start and end coincide")]
    Coincident,
    /// The end lies behind the start: no forward path without a loop.
    #[error("the end lies behind the start")]
    Behind,
    /// Newton's method or the convex program did not settle, or settled on a path with loops.
    #[error("the iteration did not converge")]
    NotConverged,
    /// No spiral within the curvature bound reaches the end, even softly.
    #[error("the curvature bound leaves no spiral")]
    CurvatureBound,
}

/// Position error at which Newton's method stops, m; a tenth of what is promised.
const POSITION_TOLERANCE: f64 = 1e-10;
/// Newton's method converges in three to six iterations where there is a useful solution.
const MAX_ITERATIONS: usize = 20;
/// Halvings of a Newton step that does not reduce the residual.
const MAX_HALVINGS: usize = 5;
/// A spiral longer than this many chords has loops (a half circle has 1.57).
const MAX_DETOUR: f64 = 3.0;

/// The spiral from the origin with heading 0 and `start_curvature` to the pose `end` (in that frame, heading taken
/// modulo 2π in (−π, π]) with `end_curvature`. Position to 1e-9 m, heading to rounding.
///
/// # Errors
/// See [`SpiralFailure`]: never [`SpiralFailure::CurvatureBound`], since nothing is bounded here.
pub fn connect(start_curvature: f64, end: &Pose, end_curvature: f64) -> Result<CubicSpiral, SpiralFailure> {
    let target = end.position.coords;
    if ![target.x, target.y, end.yaw, start_curvature, end_curvature].iter().all(|v| v.is_finite()) {
        return Err(SpiralFailure::NotFinite);
    }
    let chord = target.norm();
    if chord < 1e-3 {
        return Err(SpiralFailure::Coincident);
    }
    if target.x < 0.0 && end.to_local(super::Point::origin()).x > 0.0 {
        return Err(SpiralFailure::Behind);
    }
    let problem = Boundary { start_curvature, end_curvature, heading: wrap_angle(end.yaw), target };
    let (mut length, mut asymmetry) = problem.start();
    let mut shot = problem.shoot(length, asymmetry);
    for _ in 0..MAX_ITERATIONS {
        let size = shot.error.norm();
        if size <= POSITION_TOLERANCE {
            let short = length <= MAX_DETOUR * chord;
            return if short { Ok(problem.spiral(length, asymmetry)) } else { Err(SpiralFailure::NotConverged) };
        }
        let Some(inverse) = shot.jacobian.try_inverse() else { return Err(SpiralFailure::NotConverged) };
        let step = -(inverse * shot.error);
        // the length must stay positive, and a step that more than halves it is not to be believed
        let mut ratio = if step.x < -0.5 * length { -0.5 * length / step.x } else { 1.0 };
        let mut next = problem.shoot(length + ratio * step.x, asymmetry + ratio * step.y);
        for _ in 0..MAX_HALVINGS {
            if next.error.norm() < size {
                break;
            }
            ratio *= 0.5;
            next = problem.shoot(length + ratio * step.x, asymmetry + ratio * step.y);
        }
        length += ratio * step.x;
        asymmetry += ratio * step.y;
        shot = next;
        if !(shot.error.norm().is_finite() && length <= 10.0 * MAX_DETOUR * chord) {
            return Err(SpiralFailure::NotConverged);
        }
    }
    Err(SpiralFailure::NotConverged)
}

/// The two-point problem of [`connect`] with the end heading eliminated. Unknowns: length L and asymmetry d = k₁ − k₂;
/// the sum of the inner knots follows from heading = L (k₀ + 3k₁ + 3k₂ + k₃)/8.
struct Boundary {
    start_curvature: f64,
    end_curvature: f64,
    heading: f64,
    target: Vector,
}

/// Where a trial spiral ends.
struct Shot {
    /// End of the trial minus target, m.
    error: Vector,
    /// Derivatives of the end by (length, asymmetry).
    jacobian: nalgebra::Matrix2<f64>,
}

/// ∫ (N₁ + N₂)/2 and ∫ (N₁ − N₂)/2 from 0 to u, of the Lagrange basis.
fn inner_knot_integrals(u: f64) -> (f64, f64) {
    let even = u * u * (1.125 - 0.75 * u);
    let odd = u * u * (3.375 + u * (-6.75 + u * 3.375));
    (even, odd)
}

impl Boundary {
    fn spiral(&self, length: f64, asymmetry: f64) -> CubicSpiral {
        let sum = (8.0 * self.heading / length - self.start_curvature - self.end_curvature) / 3.0;
        let knots = [self.start_curvature, 0.5 * (sum + asymmetry), 0.5 * (sum - asymmetry), self.end_curvature];
        CubicSpiral { knots, length }
    }

    /// First values of (length, asymmetry): small deviations from the chord. The mean heading is the direction of the
    /// chord, and each radian of heading off the chord costs (off²)/2 of length.
    fn start(&self) -> (f64, f64) {
        let chord = self.target.norm();
        let direction = self.target.y.atan2(self.target.x);
        // of a circular arc, half of whose turning is the chord's angle
        let mut length = chord * (1.0 + self.heading * self.heading / 24.0);
        let mut asymmetry = 0.0;
        for _ in 0..2 {
            // the mean over u of the heading is L ∫ (1−u) κ du: linear in the asymmetry, by 9/80 each
            let mean = length * mean_heading(&self.spiral(length, 0.0).knots);
            asymmetry = (direction - mean) / (length * (9.0 / 80.0));
            let cubic = self.spiral(length, asymmetry).curvature_polynomial();
            let cosine: f64 =
                GAUSS_3.iter().map(|(u, w)| w * (length * cubic.integral(*u) - direction).cos()).sum::<f64>();
            length = chord / cosine.max(0.5);
        }
        (length, asymmetry)
    }

    fn shoot(&self, length: f64, asymmetry: f64) -> Shot {
        let spiral = self.spiral(length, asymmetry);
        let cubic = spiral.curvature_polynomial();
        let panels = panels(spiral.turning_bound());
        let width = 1.0 / panels as f64;
        // ∫ of: tangent, ∂/∂L and ∂/∂d of the heading times the normal
        let (mut tangent, mut by_length, mut by_asymmetry) = (Vector::zeros(), Vector::zeros(), Vector::zeros());
        for panel in 0..panels {
            for (node, weight) in &GAUSS_8 {
                let u = width * (panel as f64 + node);
                let theta = length * cubic.integral(u);
                let (even, odd) = inner_knot_integrals(u);
                // L·∂θ/∂L: as the curvature stays, plus what the sum of the inner knots gives back
                let length_share = theta - (8.0 / 3.0) * self.heading * even;
                let (sin, cos) = theta.sin_cos();
                let normal = Vector::new(-sin, cos) * *weight;
                tangent += Vector::new(cos, sin) * *weight;
                by_length += normal * length_share;
                by_asymmetry += normal * odd;
            }
        }
        let jacobian =
            nalgebra::Matrix2::from_columns(&[(tangent + by_length) * width, by_asymmetry * (width * length * length)]);
        Shot { error: tangent * (length * width) - self.target, jacobian }
    }
}

/// ∫₀¹ (1 − u) κ(u) du of the cubic through four knots.
fn mean_heading([k0, k1, k2, k3]: &[f64; 4]) -> f64 {
    (13.0 * k0 + 36.0 * k1 + 9.0 * k2 + 2.0 * k3) / 120.0
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A lattice problem: start curvature, end pose, end curvature.
    pub(crate) type Problem = (f64, Pose, f64);

    /// Reproducible lattice problems: 10…40 m ahead, ±8 m across, ±0.5 rad, curvatures ±0.1 (splitmix64).
    pub(crate) fn lattice_problems(count: usize) -> Vec<Problem> {
        let mut state = 7_u64;
        let mut uniform = move |low: f64, high: f64| {
            state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..count)
            .map(|_| {
                let end = Pose::new(uniform(10.0, 40.0), uniform(-8.0, 8.0), uniform(-0.5, 0.5));
                (uniform(-0.1, 0.1), end, uniform(-0.1, 0.1))
            })
            .collect()
    }

    /// The end by Simpson's rule on a fine grid: the lecture's method, slow and independent of the Gauss rules.
    fn simpson(spiral: &CubicSpiral, start: &Pose, s: f64) -> Vector {
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
            let worst = (0..=100).map(|i| spiral.heading_change(length * f64::from(i) / 100.0).abs());
            (worst.fold(0.0, f64::max) <= std::f64::consts::PI).then_some(spiral)
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
        fn a_part_runs_along_the_whole(spiral in spirals(), a in 0.0..0.9f64, b in 0.05..1.0f64) {
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
        assert!((end.position - super::super::Point::new(10.0, 10.0)).norm() < 1e-12);
        assert!((quarter.bending_energy() - 0.01 * quarter.length).abs() < 1e-15);
    }

    #[test]
    fn all_lattice_problems_are_solved_to_a_nanometre() {
        for (start, end, curvature) in lattice_problems(2000) {
            let spiral = connect(start, &end, curvature).unwrap_or_else(|e| panic!("{start} {end:?} {curvature}: {e}"));
            let reached = spiral.point_at(&Pose::new(0.0, 0.0, 0.0), spiral.length);
            assert!((reached.pose.position - end.position).norm() < 1e-9);
            assert!((reached.pose.yaw - end.yaw).abs() < 1e-12);
            assert_eq!((spiral.knots[0], spiral.knots[3]), (start, curvature));
            assert!(spiral.length >= end.position.coords.norm() * (1.0 - 1e-12));
            // twice the chord would be a path with a loop or a hairpin
            assert!(spiral.length < 2.0 * end.position.coords.norm(), "{spiral:?} for {end:?}");
        }
    }

    #[test]
    fn mirrored_problems_have_mirrored_spirals_to_the_bit() {
        for (start, end, curvature) in lattice_problems(200) {
            let mirrored_end = Pose::new(end.position.x, -end.position.y, -end.yaw);
            let direct = connect(start, &end, curvature).unwrap();
            assert_eq!(connect(-start, &mirrored_end, -curvature).unwrap(), direct.mirrored());
        }
    }

    #[test]
    fn a_problem_twice_as_large_has_a_spiral_twice_as_long() {
        for (start, end, curvature) in lattice_problems(200) {
            let large_end = Pose::new(2.0 * end.position.x, 2.0 * end.position.y, end.yaw);
            let small = connect(start, &end, curvature).unwrap();
            let large = connect(start / 2.0, &large_end, curvature / 2.0).unwrap();
            assert!((large.length - 2.0 * small.length).abs() < 1e-8);
            for (l, s) in large.knots.iter().zip(small.knots) {
                assert!((2.0 * l - s).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn jacobian_agrees_with_differences() {
        for (start_curvature, end, end_curvature) in lattice_problems(50) {
            let problem = Boundary { start_curvature, end_curvature, heading: end.yaw, target: end.position.coords };
            let (length, asymmetry) = problem.start();
            let (h, k) = (1e-4, 1e-6);
            let by_length =
                (problem.shoot(length + h, asymmetry).error - problem.shoot(length - h, asymmetry).error) / (2.0 * h);
            let by_asymmetry =
                (problem.shoot(length, asymmetry + k).error - problem.shoot(length, asymmetry - k).error) / (2.0 * k);
            let analytic = problem.shoot(length, asymmetry).jacobian;
            assert!((analytic.column(0) - by_length).norm() < 1e-6, "{analytic} {by_length}");
            assert!((analytic.column(1) - by_asymmetry).norm() < 1e-4 * (1.0 + by_asymmetry.norm()));
        }
    }

    #[test]
    fn each_bad_input_has_its_reason() {
        let ahead = Pose::new(20.0, 1.0, 0.1);
        assert!(connect(0.0, &ahead, 0.0).is_ok());
        assert_eq!(connect(f64::NAN, &ahead, 0.0), Err(SpiralFailure::NotFinite));
        assert_eq!(connect(0.0, &ahead, f64::INFINITY), Err(SpiralFailure::NotFinite));
        assert_eq!(connect(0.0, &Pose::new(f64::NAN, 0.0, 0.0), 0.0), Err(SpiralFailure::NotFinite));
        assert_eq!(connect(0.0, &Pose::new(0.0, 0.0, 0.0), 0.0), Err(SpiralFailure::Coincident));
        assert_eq!(connect(0.0, &Pose::new(-10.0, 1.0, 0.0), 0.0), Err(SpiralFailure::Behind));
        // large but finite: an answer or a reason, never a hang
        let _ = connect(1e300, &ahead, -1e300);
        let _ = connect(0.0, &Pose::new(1e200, 1e200, 3.0), 0.0);
    }

    #[test]
    fn a_half_circle_is_found() {
        let spiral = connect(0.1, &Pose::new(0.0, 20.0, std::f64::consts::PI), 0.1).unwrap();
        assert!((spiral.length - 10.0 * std::f64::consts::PI).abs() < 1e-8);
        assert!((spiral.max_abs_curvature() - 0.1).abs() < 1e-9);
    }
}
