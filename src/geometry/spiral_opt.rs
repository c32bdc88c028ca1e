//! Spirals under a curvature bound, by sequential convex programming.
//!
//! With position, heading and curvature pinned at both ends a cubic spiral is determined ([`connect`]), and there is
//! nothing to optimise. Where that spiral breaks the curvature bound, the end is allowed to slide sideways:
//!
//! ```text
//! minimise    ∫ κ² ds + w e²                   over the inner knots k₁, k₂, the length L and the slide e
//! subject to  end(k₁, k₂, L) = target + e · (left of the target's heading),   heading exact
//!             |κ(u)| ≤ κ_max  for all u in [0, 1]
//! ```
//!
//! The end is linearised about the iterate; the energy is kept quadratic in the knots. The bound is exact and convex: a
//! cubic is non-negative on [0, 1] if and only if it is u·σ₁(u) + (1−u)·σ₂(u) with σ₁, σ₂ sums of squares of degree 2
//! (Markov–Lukács; Szegő, Orthogonal Polynomials, 1.21.1), and such a σ = a + 2bu + cu² is a three-dimensional
//! second-order cone ‖(2b, a − c)‖ ≤ a + c. No samples, no cuts. Newton's root is the start.
//!
//! Weak: a local method. It tells [`SpiralFailure::CurvatureBound`] when a linearised program has no solution, which
//! happens for ends that would have to slide by more than about five metres although a spiral exists.

use super::quadrature::GAUSS_8;
use super::spiral::{CubicSpiral, KNOT_MASS, SpiralFailure, connect};
use super::{Pose, Vector, wrap_angle};
use crate::convex::{QuadraticProgram, Status, Term};

/// How a spiral was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Newton's method: all end conditions met.
    Newton,
    /// The convex program: the end slid sideways to hold the bound.
    Convex,
}

/// A spiral within a curvature bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundedSpiral {
    /// The spiral; its largest |curvature| is within the bound everywhere.
    pub spiral: CubicSpiral,
    /// How it was found.
    pub method: Method,
    /// How far the end slid to the left of the wanted end, across its heading, m; 0 for [`Method::Newton`].
    pub end_error: f64,
}

/// Price of the slide against bending energy, 1/m³: a centimetre costs as much as 10 m driven at 1/30 m curvature, so
/// that the end stays where it was asked for as far as the bound allows.
const SLIDE_WEIGHT: f64 = 100.0;
/// The cones hold to about 5e-8 of the bound; aim this much below it (relative).
const BOUND_MARGIN: f64 = 1e-6;
/// Linearised ends agree with the true one to this, m and rad, when the iteration stops.
const END_TOLERANCE: f64 = 1e-8;
/// Slides less than this between iterations count as settled, m.
const SLIDE_TOLERANCE: f64 = 1e-4;
/// Iterations of the sequential program; four to six is usual.
const MAX_ITERATIONS: usize = 15;
/// Largest relative change of the length in an iteration: what the linearisation is good for.
const LENGTH_STEP: f64 = 0.3;

/// The spiral from the origin with heading 0 and `start_curvature` to `end` (in that frame) with `end_curvature`, with
/// |curvature| ≤ `max_curvature` everywhere. Newton's method, checked in closed form; where the bound bites, the end
/// slides sideways as little as needed.
///
/// # Errors
/// [`SpiralFailure`]; [`SpiralFailure::CurvatureBound`] if an end curvature exceeds the bound or nothing is within it.
pub fn connect_bounded(
    start_curvature: f64,
    end: &Pose,
    end_curvature: f64,
    max_curvature: f64,
) -> Result<BoundedSpiral, SpiralFailure> {
    let free = connect(start_curvature, end, end_curvature);
    if !(start_curvature.abs() <= max_curvature && end_curvature.abs() <= max_curvature) {
        return Err(SpiralFailure::CurvatureBound);
    }
    let start = match free {
        Ok(spiral) if spiral.max_abs_curvature() <= max_curvature => {
            return Ok(BoundedSpiral { spiral, method: Method::Newton, end_error: 0.0 });
        }
        Ok(spiral) => spiral,
        // a straight chord is a start as good as any where Newton found nothing
        Err(SpiralFailure::NotConverged) => CubicSpiral {
            knots: [start_curvature, 0.0, 0.0, end_curvature],
            length: end.position.coords.norm() * (1.0 + wrap_angle(end.yaw).powi(2) / 24.0),
        },
        Err(failure) => return Err(failure),
    };
    slide(start, end, max_curvature)
}

/// The sequential convex program, from a first spiral with the wanted curvatures at its ends.
fn slide(start: CubicSpiral, end: &Pose, max_curvature: f64) -> Result<BoundedSpiral, SpiralFailure> {
    let bound = max_curvature * (1.0 - BOUND_MARGIN);
    let [k0, k1, k2, k3] = start.knots;
    // the iteration starts inside the bound at the knots, so that its first linearisation is about something sensible
    let chord = end.position.coords.norm();
    let mut spiral = CubicSpiral {
        knots: [k0, k1.clamp(-bound, bound), k2.clamp(-bound, bound), k3],
        length: start.length.min(1.5 * chord),
    };
    let mut last_slide = f64::INFINITY;
    for _ in 0..MAX_ITERATIONS {
        let (next, slide) = step(&spiral, end, bound)?;
        spiral = next;
        let reached = spiral.end(&Pose::new(0.0, 0.0, 0.0));
        let miss = reached.position - end.position - end.left() * slide;
        let turned_wrong = reached.yaw - wrap_angle(end.yaw);
        if miss.norm() < END_TOLERANCE
            && turned_wrong.abs() < END_TOLERANCE
            && (slide - last_slide).abs() < SLIDE_TOLERANCE
        {
            return if spiral.max_abs_curvature() <= max_curvature {
                Ok(BoundedSpiral { spiral, method: Method::Convex, end_error: slide })
            } else {
                Err(SpiralFailure::CurvatureBound)
            };
        }
        last_slide = slide;
    }
    Err(SpiralFailure::NotConverged)
}

// Variables of the convex program, scaled to the order of one: inner knots by the bound, length by its last value.
const KNOT_1: usize = 0;
const KNOT_2: usize = 1;
const LENGTH: usize = 2;
const SLIDE: usize = 3;
const VARIABLES: usize = 4;

/// One convex program about `spiral`: the next iterate and its slide.
fn step(spiral: &CubicSpiral, end: &Pose, bound: f64) -> Result<(CubicSpiral, f64), SpiralFailure> {
    let [k0, k1, k2, k3] = spiral.knots;
    let length = spiral.length;
    let mut program = QuadraticProgram::new(VARIABLES);
    add_energy(&mut program, spiral, bound);
    program.add_square(SLIDE_WEIGHT / (length * bound * bound), &[(SLIDE, 1.0)], 0.0);
    program.between(1.0 - LENGTH_STEP, &[(LENGTH, 1.0)], 1.0 + LENGTH_STEP);

    let linear = Linearised::about(spiral);
    let target = end.position.coords;
    for axis in [0, 1] {
        let by = [linear.by_knot_1[axis] * bound, linear.by_knot_2[axis] * bound, linear.by_length[axis] * length];
        let here = by[0] * k1 / bound + by[1] * k2 / bound + by[2];
        program.equal(
            &[(KNOT_1, by[0]), (KNOT_2, by[1]), (LENGTH, by[2]), (SLIDE, -end.left()[axis])],
            target[axis] - linear.end[axis] + here,
        );
    }
    // heading L (k₀ + 3k₁ + 3k₂ + k₃)/8, linearised about the iterate
    let sum = k0 + 3.0 * k1 + 3.0 * k2 + k3;
    let by_knot = 3.0 * length * bound / 8.0;
    program.equal(
        &[(KNOT_1, by_knot), (KNOT_2, by_knot), (LENGTH, length * sum / 8.0)],
        wrap_angle(end.yaw) + 3.0 * length * (k1 + k2) / 8.0,
    );
    for sign in [1.0, -1.0] {
        bound_cubic(&mut program, sign * k0 / bound, sign, sign * k3 / bound);
    }

    let solution = program.solve();
    match solution.status {
        Status::Solved | Status::AlmostSolved => {
            let knots = [k0, solution.x[KNOT_1] * bound, solution.x[KNOT_2] * bound, k3];
            Ok((CubicSpiral { knots, length: solution.x[LENGTH] * length }, solution.x[SLIDE]))
        }
        Status::Infeasible => Err(SpiralFailure::CurvatureBound),
        _ => Err(SpiralFailure::NotConverged),
    }
}

/// Bending energy L kᵀMk over L̄κ_max²: quadratic in the knots at the last length, linear in the length.
fn add_energy(program: &mut QuadraticProgram, spiral: &CubicSpiral, bound: f64) {
    let m = &KNOT_MASS;
    let [k0, k3] = [spiral.knots[0] / bound, spiral.knots[3] / bound];
    for (variable, row) in [(KNOT_1, 1), (KNOT_2, 2)] {
        program.add_hessian(variable, variable, 2.0 * m[row][row]);
        program.add_linear(variable, 2.0 * (m[row][0] * k0 + m[row][3] * k3));
    }
    program.add_hessian(KNOT_1, KNOT_2, 2.0 * m[1][2]);
    program.add_linear(LENGTH, spiral.bending_energy() / (spiral.length * bound * bound));
}

/// Requires 1 − κ(u) ≥ 0 on [0, 1], for the cubic with the scaled knots (k0, sign·x, sign·y, k3): 1 − κ(u) is
/// u(a₁ + 2b₁u + c₁u²) + (1−u)(a₂ + 2b₂u + c₂u²), coefficient by coefficient, with both factors in their cones.
fn bound_cubic(program: &mut QuadraticProgram, k0: f64, sign: f64, k3: f64) {
    let [a1, b1, c1, a2, b2, c2] = std::array::from_fn(|_| program.add_variable());
    let squares: [&[Term]; 4] = [
        &[(a2, 1.0)],
        &[(a1, 1.0), (b2, 2.0), (a2, -1.0)],
        &[(b1, 2.0), (c2, 1.0), (b2, -2.0)],
        &[(c1, 1.0), (c2, -1.0)],
    ];
    // coefficients of κ by rising powers, for each knot
    const OF_KNOT_0: [f64; 4] = [1.0, -5.5, 9.0, -4.5];
    const OF_KNOT_1: [f64; 4] = [0.0, 9.0, -22.5, 13.5];
    const OF_KNOT_2: [f64; 4] = [0.0, -4.5, 18.0, -13.5];
    const OF_KNOT_3: [f64; 4] = [0.0, 1.0, -4.5, 4.5];
    for (power, terms) in squares.iter().enumerate() {
        let mut row = terms.to_vec();
        row.push((KNOT_1, sign * OF_KNOT_1[power]));
        row.push((KNOT_2, sign * OF_KNOT_2[power]));
        let one = if power == 0 { 1.0 } else { 0.0 };
        program.equal(&row, one - k0 * OF_KNOT_0[power] - k3 * OF_KNOT_3[power]);
    }
    for (a, b, c) in [(a1, b1, c1), (a2, b2, c2)] {
        let inner: [(&[Term], f64); 2] = [(&[(b, 2.0)], 0.0), (&[(a, 1.0), (c, -1.0)], 0.0)];
        program.norm_at_most(&inner, (&[(a, 1.0), (c, 1.0)], 0.0));
    }
}

/// The end of a spiral and its derivatives, in the start frame.
struct Linearised {
    end: Vector,
    by_knot_1: Vector,
    by_knot_2: Vector,
    by_length: Vector,
}

impl Linearised {
    /// By two eight-point panels per radian: the tolerance here is 1e-8 m, and steps are corrected by the next ones.
    fn about(spiral: &CubicSpiral) -> Self {
        let length = spiral.length;
        let turning = length * spiral.knots.iter().fold(0.0_f64, |m, k| m.max(k.abs()));
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small positive count
        let panels = 2 + (2.0 * turning).min(100.0) as usize;
        let mut sum = Self {
            end: Vector::zeros(),
            by_knot_1: Vector::zeros(),
            by_knot_2: Vector::zeros(),
            by_length: Vector::zeros(),
        };
        for panel in 0..panels {
            for (node, weight) in &GAUSS_8 {
                let u = (panel as f64 + node) / panels as f64;
                let theta = spiral.heading_change(u * length);
                let (sin, cos) = theta.sin_cos();
                let weight = weight * length / panels as f64;
                let (tangent, normal) = (Vector::new(cos, sin) * weight, Vector::new(-sin, cos) * weight);
                // ∫ N₁ and ∫ N₂ of the Lagrange basis
                let knot_1 = u * u * (4.5 + u * (-7.5 + u * 3.375));
                let knot_2 = u * u * (-2.25 + u * (6.0 - u * 3.375));
                sum.end += tangent;
                sum.by_knot_1 += normal * (length * knot_1);
                sum.by_knot_2 += normal * (length * knot_2);
                sum.by_length += (tangent + normal * theta) / length;
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::spiral::tests::lattice_problems;

    const ORIGIN: Pose = Pose { position: super::super::Point::new(0.0, 0.0), yaw: 0.0 };

    #[test]
    fn newton_is_kept_where_the_bound_does_not_bite() {
        let end = Pose::new(20.0, 1.0, 0.0);
        let bounded = connect_bounded(0.0, &end, 0.0, 0.2).unwrap();
        assert_eq!(bounded.method, Method::Newton);
        assert_eq!(bounded.spiral, connect(0.0, &end, 0.0).unwrap());
        assert_eq!(bounded.end_error, 0.0);
    }

    #[test]
    fn linearisation_agrees_with_differences() {
        for (start, end, curvature) in lattice_problems(30) {
            let spiral = connect(start, &end, curvature).unwrap();
            let linear = Linearised::about(&spiral);
            assert!((linear.end - spiral.end(&ORIGIN).position.coords).norm() < 1e-9);
            let shifted = |change: &dyn Fn(&mut CubicSpiral, f64), h: f64| {
                let (mut plus, mut minus) = (spiral, spiral);
                change(&mut plus, h);
                change(&mut minus, -h);
                (plus.end(&ORIGIN).position - minus.end(&ORIGIN).position) / (2.0 * h)
            };
            let by_knot_1 = shifted(&|s, h| s.knots[1] += h, 1e-6);
            let by_knot_2 = shifted(&|s, h| s.knots[2] += h, 1e-6);
            let by_length = shifted(&|s, h| s.length += h, 1e-4);
            assert!((by_knot_1 - linear.by_knot_1).norm() < 1e-3, "{by_knot_1} {}", linear.by_knot_1);
            assert!((by_knot_2 - linear.by_knot_2).norm() < 1e-3);
            assert!((by_length - linear.by_length).norm() < 1e-5);
        }
    }

    /// The least slide within the bound by bisection over Newton's spirals: slow and independent of the cones.
    fn least_slide(start: f64, end: &Pose, curvature: f64, bound: f64, towards: f64) -> Option<f64> {
        let fits = |slide: f64| {
            let moved = Pose { position: end.position + end.left() * slide, yaw: end.yaw };
            connect(start, &moved, curvature).is_ok_and(|s| s.max_abs_curvature() <= bound)
        };
        let first = (1..=4000).map(|i| towards * f64::from(i) * 0.005).find(|s| fits(*s))?;
        let (mut outside, mut inside) = (first - towards * 0.005, first);
        for _ in 0..30 {
            let middle = f64::midpoint(outside, inside);
            if fits(middle) { inside = middle } else { outside = middle }
        }
        Some(inside)
    }

    #[test]
    fn bound_holds_everywhere_and_the_slide_is_the_least_possible() {
        let bound = 0.12;
        let mut bitten = 0;
        for (start, end, curvature) in lattice_problems(400) {
            let free = connect(start, &end, curvature).unwrap();
            if free.max_abs_curvature() <= bound {
                continue;
            }
            let least = [1.0, -1.0].map(|side| least_slide(start, &end, curvature, bound, side));
            let Some(least) = least.into_iter().flatten().min_by(|a, b| a.abs().total_cmp(&b.abs())) else { continue };
            let bounded = match connect_bounded(start, &end, curvature, bound) {
                Ok(bounded) => bounded,
                Err(failure) => {
                    assert!(least.abs() > 5.0, "{failure} where a slide of {least} is enough: {start} {end:?}");
                    continue;
                }
            };
            bitten += 1;
            assert_eq!(bounded.method, Method::Convex);
            let spiral = bounded.spiral;
            for i in 0..=1000 {
                assert!(spiral.curvature(spiral.length * f64::from(i) / 1000.0).abs() <= bound);
            }
            let reached = spiral.end(&ORIGIN);
            assert!((reached.yaw - end.yaw).abs() < 1e-7);
            assert!((reached.position - end.position - end.left() * bounded.end_error).norm() < 1e-7);
            let excess = (bounded.end_error - least).abs();
            assert!(excess < 0.02, "slid {} where {least} is enough, for {start} {end:?}", bounded.end_error);
        }
        assert!(bitten > 40, "the test is about nothing: {bitten}");
    }

    #[test]
    fn mirrored_problems_have_mirrored_slides() {
        let end = Pose::new(12.0, 4.0, 0.0);
        let left = connect_bounded(0.0, &end, 0.0, 0.1).unwrap();
        let right = connect_bounded(0.0, &Pose::new(12.0, -4.0, 0.0), 0.0, 0.1).unwrap();
        assert!(left.end_error < -0.1, "the end must slide back towards the start's line: {left:?}");
        assert!((left.end_error + right.end_error).abs() < 1e-6);
        assert!((left.spiral.length - right.spiral.length).abs() < 1e-6);
    }

    #[test]
    fn what_the_bound_forbids_is_told() {
        let end = Pose::new(10.0, 0.0, 1.5);
        assert_eq!(connect_bounded(0.3, &end, 0.0, 0.2), Err(SpiralFailure::CurvatureBound));
        // a quarter turn in ten metres needs more than 0.05 of curvature
        assert!(connect_bounded(0.0, &end, 0.0, 0.05).is_err());
        assert_eq!(connect_bounded(f64::NAN, &end, 0.0, 0.2), Err(SpiralFailure::CurvatureBound));
        assert_eq!(connect_bounded(0.0, &Pose::new(f64::NAN, 0.0, 0.0), 0.0, 0.2), Err(SpiralFailure::NotFinite));
    }
}
