//! One convex program of the sequence: a quadratic model in the free directions, with the bounds as cones or cuts.
//!
//! Variables are the coordinates of the step in the free directions ("shares" in the code) and, with bounds that may be
//! violated at a penalty, one elastic variable t that loosens all of them.

use super::EndCondition;
use super::basis::{Basis, add, dot};
use super::scaled::{LENGTHS, Place, SIDES, Scaled, Side};
use crate::convex::{Affine, QuadraticProgram, Status, Term, Tuning};
use crate::geometry::spiral::{Polynomial, Spiral, Tables};

/// The quadratic model about a place, in the coordinates of the free directions.
#[derive(Debug, Clone)]
pub(super) struct Model<'a, const K: usize> {
    pub(super) scaled: &'a Scaled<K>,
    pub(super) place: &'a Place<K>,
    pub(super) basis: Basis<K>,
    pub(super) variables: usize,
    pub(super) gradient: [f64; K],
    /// Positive definite.
    pub(super) hessian: [[f64; K]; K],
}

/// Solution of a program.
#[derive(Debug, Clone)]
pub(super) struct Step<const K: usize> {
    /// Coordinates in the free directions.
    pub(super) shares: [f64; K],
    /// Remaining violation of the linearised bounds, relative to the aims: the maximum over all sides.
    pub(super) violation: f64,
    /// Gradient of the constraint part of the Lagrangian: multipliers of bounds and lengths times their derivatives.
    pub(super) pull: [f64; K],
    /// Multipliers of the ranges, positive at the upper limit.
    pub(super) ranges: [f64; 4],
    /// Multiplier of all bounds together: decrease of the objective per relative loosening.
    pub(super) price: f64,
    /// Second-order part of the cuts: multiplier times the Hessian of the extremum's value, whose argument moves.
    pub(super) cut_hessian: [[f64; K]; K],
}

impl<const K: usize> Step<K> {
    pub(super) fn free(shares: [f64; K]) -> Self {
        Self { shares, violation: 0.0, pull: [0.0; K], ranges: [0.0; 4], price: 0.0, cut_hessian: [[0.0; K]; K] }
    }
}

/// Treatment of the bounds in a program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bounds {
    /// The sides that enter, in the order of [`SIDES`].
    pub(super) sides: [bool; 4],
    /// Exact cones (cubics only) instead of cuts.
    pub(super) cones: bool,
    /// Penalty of a violation; infinite for hard bounds.
    pub(super) penalty: f64,
    /// Trust region of each coordinate.
    pub(super) radius: f64,
}

/// An affine function of the step: constant + by · Δx + Σ extra. `loosened` is its derivative by the elastic variable.
#[derive(Debug, Clone, Copy)]
struct Row<const K: usize> {
    constant: f64,
    by: [f64; K],
    extra: [Term; 2],
    loosened: f64,
}

impl<const K: usize> Row<K> {
    /// Σ factor · row.
    fn sum(parts: &[(f64, &Self)]) -> Self {
        let mut sum = Self { constant: 0.0, by: [0.0; K], extra: [(0, 0.0); 2], loosened: 0.0 };
        for (factor, part) in parts {
            sum.constant += factor * part.constant;
            add(&mut sum.by, *factor, &part.by);
            sum.loosened += factor * part.loosened;
        }
        sum
    }

    fn with(mut self, extra: [Term; 2]) -> Self {
        self.extra = extra;
        self
    }
}

/// A program under construction, with the rows in the order of their multipliers.
struct Assembly<const K: usize> {
    program: QuadraticProgram,
    variables: usize,
    directions: [[f64; K]; K],
    elastic: Option<usize>,
    /// Rows `≥ 0`, in the program's order.
    inequalities: Vec<(Row<K>, Origin)>,
    /// Rows of the cones, in the program's order.
    cones: Vec<Row<K>>,
}

/// The constraint that a multiplier belongs to.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Origin {
    /// A cut of the bound of a side at a parameter u.
    Cut(Side, f64),
    /// The sign condition of an auxiliary variable.
    Sign,
    Length,
    Range(usize, f64),
}

impl<const K: usize> Model<'_, K> {
    /// Change of the objective in the model.
    pub(super) fn change(&self, shares: &[f64; K]) -> f64 {
        let mut sum = 0.0;
        for i in 0..self.variables {
            let curved: f64 = (0..self.variables).map(|j| self.hessian[i][j] * shares[j]).sum();
            sum += shares[i] * (self.gradient[i] + 0.5 * curved);
        }
        sum
    }

    /// Change of the objective over a unit step: the scale of the penalty.
    pub(super) fn stiffness(&self) -> f64 {
        (0..self.variables).fold(1.0, |m: f64, i| m.max(self.gradient[i].abs() + self.hessian[i][i]))
    }

    /// The step in the unknowns, from its coordinates.
    pub(super) fn step(&self, shares: &[f64; K]) -> [f64; K] {
        let mut step = [0.0; K];
        for (direction, share) in self.basis.free().iter().zip(shares) {
            add(&mut step, *share, direction);
        }
        step
    }

    /// Decrease of the unconstrained model: half the squared Newton decrement (Boyd & Vandenberghe, 9.5.1). It bounds the
    /// decrease under inequalities.
    pub(super) fn gain(&self) -> Option<f64> {
        self.minimiser().map(|shares| -self.change(&shares))
    }

    /// The minimiser of the unconstrained model.
    fn minimiser(&self) -> Option<[f64; K]> {
        let factor = cholesky(&self.hessian, self.variables)?;
        Some(solved(&factor, &self.gradient, self.variables))
    }

    /// The unconstrained minimiser, if it lies in the trust region and satisfies ranges and lengths: then it solves the
    /// program without bounds.
    pub(super) fn unconstrained(&self, radius: f64) -> Option<Step<K>> {
        let shares = self.minimiser()?;
        if shares.iter().any(|s| s.abs() > radius) {
            return None;
        }
        let step = self.step(&shares);
        let within = |value: f64, (low, high): (f64, f64)| value >= low && value <= high;
        let satisfied = self.scaled.conditions.iter().enumerate().all(|(q, condition)| match *condition {
            EndCondition::Range(low, high) => {
                within(self.place.deviation[q] + dot(&self.place.by[q], &step), (low, high))
            }
            _ => true,
        });
        (satisfied && within(self.place.jet.spiral.length + step[K - 1], LENGTHS)).then(|| Step::free(shares))
    }

    /// Solves the program with Clarabel. `None` if it is infeasible or the solver failed.
    ///
    /// The rows of the trust region are omitted if no bound is near and the unconstrained minimiser lies inside: they are
    /// half of the program.
    pub(super) fn solve(&self, bounds: &Bounds) -> Option<Step<K>> {
        let inside = |shares: &[f64; K]| shares.iter().all(|share| share.abs() <= bounds.radius);
        if !bounds.sides.contains(&true) && self.minimiser().is_some_and(|shares| inside(&shares)) {
            let step = self.solve_within(bounds, f64::INFINITY)?;
            if inside(&step.shares) {
                return Some(step);
            }
        }
        self.solve_within(bounds, bounds.radius)
    }

    /// Solves the program with coordinates of at most this size.
    fn solve_within(&self, bounds: &Bounds, radius: f64) -> Option<Step<K>> {
        let mut assembly = self.assembly(bounds);
        for (side, active) in SIDES.iter().zip(bounds.sides) {
            if active {
                self.bound(&mut assembly, *side, bounds.cones);
            }
        }
        // last, so that the rows whose multipliers are used come first
        for i in 0..self.variables {
            assembly.program.between(-radius, &[(i, 1.0)], radius);
        }
        if let Some(t) = assembly.elastic {
            assembly.program.between(0.0, &[(t, 1.0)], f64::INFINITY);
        }
        let mut solution = assembly.program.solve_tuned(Tuning::Small);
        if !solution.is_usable() && solution.status != Status::Infeasible {
            // weights of very different size: the solver's equilibration may help
            solution = assembly.program.solve();
        }
        if !solution.is_usable() {
            debug_assert!(solution.status != Status::Unbounded, "the Hessian is positive definite");
            return None;
        }
        let mut step = Step::free([0.0; K]);
        for (i, share) in step.shares[..self.variables].iter_mut().enumerate() {
            *share = solution.x[i];
        }
        step.violation = assembly.elastic.map_or(0.0, |t| solution.x[t].max(0.0));
        let trust_region = if radius.is_finite() { 2 * self.variables } else { 0 };
        let unused = trust_region + usize::from(assembly.elastic.is_some());
        let conic = solution.multipliers.iter().skip(assembly.inequalities.len() + unused);
        for ((row, origin), multiplier) in assembly.inequalities.iter().zip(&solution.multipliers) {
            match origin {
                Origin::Range(q, sign) => step.ranges[*q] += sign * multiplier,
                Origin::Sign => {}
                Origin::Length => add(&mut step.pull, -multiplier, &row.by),
                Origin::Cut(side, u) => {
                    add(&mut step.pull, -multiplier, &row.by);
                    self.add_cut_hessian(*side, *u, *multiplier, &mut step.cut_hessian);
                }
            }
            step.price += multiplier * row.loosened;
        }
        for (row, multiplier) in assembly.cones.iter().zip(conic) {
            add(&mut step.pull, -multiplier, &row.by);
            step.price += multiplier * row.loosened;
        }
        Some(step)
    }

    /// The model, the trust region, ranges and lengths.
    fn assembly(&self, bounds: &Bounds) -> Assembly<K> {
        let mut directions = [[0.0; K]; K];
        directions[..self.variables].copy_from_slice(self.basis.free());
        let mut program = QuadraticProgram::new(self.variables);
        for i in 0..self.variables {
            program.add_linear(i, self.gradient[i]);
            for j in i..self.variables {
                program.add_hessian(i, j, self.hessian[i][j]);
            }
        }
        let mut assembly = Assembly {
            program,
            variables: self.variables,
            directions,
            elastic: None,
            inequalities: Vec::with_capacity(16),
            cones: Vec::with_capacity(24),
        };
        if bounds.penalty < f64::INFINITY {
            let t = assembly.program.add_variable();
            assembly.program.add_linear(t, bounds.penalty);
            assembly.elastic = Some(t);
        }
        for (q, condition) in self.scaled.conditions.iter().enumerate() {
            if let EndCondition::Range(low, high) = *condition {
                let (at, by) = (self.place.deviation[q], self.place.by[q]);
                let row = |constant: f64, sign: f64| Row {
                    constant,
                    by: by.map(|b| sign * b),
                    extra: [(0, 0.0); 2],
                    loosened: 0.0,
                };
                assembly.not_negative(row(at - low, 1.0), Origin::Range(q, -1.0));
                assembly.not_negative(row(high - at, -1.0), Origin::Range(q, 1.0));
            }
        }
        let mut by_length = [0.0; K];
        by_length[K - 1] = 1.0;
        let length = self.place.jet.spiral.length;
        let reach = bounds.radius * (self.variables as f64).sqrt();
        let lengths = [(length - LENGTHS.0, 1.0), (LENGTHS.1 - length, -1.0)];
        for (constant, sign) in lengths.into_iter().filter(|(margin, _)| *margin < reach) {
            let by = by_length.map(|b| sign * b);
            assembly.not_negative(Row { constant, by, extra: [(0, 0.0); 2], loosened: 0.0 }, Origin::Length);
        }
        assembly
    }
}

impl<const K: usize> Model<'_, K> {
    /// Adds a one-sided bound.
    fn bound(&self, assembly: &mut Assembly<K>, side: Side, cones: bool) {
        let margin = self.margin(side);
        match (cones && K == 4, side.of_rate) {
            (true, false) => cubic_not_negative(assembly, &margin),
            (true, true) => quadratic_not_negative(assembly, &margin),
            (false, _) => self.cuts(assembly, side, &margin),
        }
    }

    /// Coefficients by ascending powers of u of the margin to the bound, relative to its aim: 1 − ±κ(u)/aim, or
    /// L − ±k′(u)/aim for the rate.
    fn margin(&self, side: Side) -> [Row<K>; K] {
        let spiral = &self.place.jet.spiral;
        let factor = -side.sign / self.scaled.aim(side);
        let curvature = Polynomial::through(&spiral.knots);
        std::array::from_fn(|power| {
            // a coefficient of the derivative derives from the next higher power
            let (from, share) = if side.of_rate { (power + 1, (power + 1) as f64 * factor) } else { (power, factor) };
            let mut row = Row { constant: 0.0, by: [0.0; K], extra: [(0, 0.0); 2], loosened: 0.0 };
            if from < K {
                row.constant = share * curvature.0[from];
                for (by, basis) in row.by.iter_mut().zip(&Tables::<K>::BASIS[1..]) {
                    *by = share * basis[from];
                }
            }
            if power == 0 {
                let whole = if side.of_rate { spiral.length } else { 1.0 };
                row.constant += whole;
                row.loosened = whole;
                row.by[K - 1] = if side.of_rate { 1.0 } else { 0.0 };
            }
            row
        })
    }

    /// Adds cuts at the extrema that are near the aim, and at the ends.
    fn cuts(&self, assembly: &mut Assembly<K>, side: Side, margin: &[Row<K>; K]) {
        /// Extrema with a larger relative margin do not enter this iteration.
        const NEAR: f64 = 0.5;
        let spiral: &Spiral<K> = &self.place.jet.spiral;
        let curvature = Polynomial::through(&spiral.knots);
        let order = if side.of_rate { 2 } else { 1 };
        for u in curvature.roots_of_derivative(order).iter().chain([0.0, 1.0]) {
            let mut power = 1.0;
            let powers: [f64; K] = std::array::from_fn(|_| {
                let now = power;
                power *= u;
                now
            });
            let parts: [(f64, &Row<K>); K] = std::array::from_fn(|p| (powers[p], &margin[p]));
            let row = Row::sum(&parts);
            // the curvature at the start is fixed
            if row.constant < NEAR && (side.of_rate || u > 0.0) {
                assembly.not_negative(row, Origin::Cut(side, u));
            }
        }
    }

    /// Adds the Hessian of the maximum over u of a bounded quantity φ(u; x), times its multiplier. φ is linear in x, but the
    /// argument of an inner extremum moves with x, which gives (∂φᵤ/∂x)(∂φᵤ/∂x)ᵀ / −φᵤᵤ.
    fn add_cut_hessian(&self, side: Side, u: f64, multiplier: f64, hessian: &mut [[f64; K]; K]) {
        if !(u > 0.0 && u < 1.0 && multiplier > 0.0) {
            return;
        }
        let orders = if side.of_rate { (2, 3) } else { (1, 2) };
        let factor = side.sign / self.scaled.aim(side);
        let curvature = Polynomial::through(&self.place.jet.spiral.knots);
        let steepness = -factor * curvature.derivative_of_order(orders.1, u);
        let mut moved = [0.0; K];
        for (moved, basis) in moved.iter_mut().zip(&Tables::<K>::BASIS[1..]) {
            *moved = factor * Polynomial(*basis).derivative_of_order(orders.0, u);
        }
        if steepness > 0.0 {
            for (row, by) in hessian.iter_mut().zip(moved) {
                add(row, multiplier * by / steepness, &moved);
            }
        }
    }
}

/// p(u) ≥ 0 on [0, 1] for a cubic p: p = u (a₁ + 2b₁u + c₁u²) + (1−u)(a₂ + 2b₂u + c₂u²) with both factors in their
/// cones. Four coefficients follow from those of p; b₂ and c₂ are variables.
fn cubic_not_negative<const K: usize>(assembly: &mut Assembly<K>, p: &[Row<K>]) {
    let (b2, c2) = (assembly.program.add_variable(), assembly.program.add_variable());
    let [p0, p1, p2, p3] = p else { return };
    let extra = |b: f64, c: f64| [(b2, b), (c2, c)];
    assembly.cone([
        Row::sum(&[(1.0, p0), (1.0, p1), (1.0, p3)]).with(extra(-2.0, 1.0)),
        Row::sum(&[(1.0, p2)]).with(extra(2.0, -1.0)),
        Row::sum(&[(1.0, p0), (1.0, p1), (-1.0, p3)]).with(extra(-2.0, -1.0)),
    ]);
    assembly.cone([
        Row::sum(&[(1.0, p0)]).with(extra(0.0, 1.0)),
        Row::sum(&[]).with(extra(2.0, 0.0)),
        Row::sum(&[(1.0, p0)]).with(extra(0.0, -1.0)),
    ]);
}

/// p(u) ≥ 0 on [0, 1] for a quadratic p: p = (a + 2bu + cu²) + γ u(1−u), with γ ≥ 0 the only variable.
fn quadratic_not_negative<const K: usize>(assembly: &mut Assembly<K>, p: &[Row<K>]) {
    let gamma = assembly.program.add_variable();
    let [p0, p1, p2, ..] = p else { return };
    let extra = |factor: f64| [(gamma, factor), (gamma, 0.0)];
    assembly.not_negative(Row::sum(&[]).with(extra(1.0)), Origin::Sign);
    assembly.cone([
        Row::sum(&[(1.0, p0), (1.0, p2)]).with(extra(1.0)),
        Row::sum(&[(1.0, p1)]).with(extra(-1.0)),
        Row::sum(&[(1.0, p0), (-1.0, p2)]).with(extra(-1.0)),
    ]);
}

impl<const K: usize> Assembly<K> {
    fn terms(&self, row: &Row<K>) -> Vec<Term> {
        let mut terms = Vec::with_capacity(K + 3);
        terms.extend((0..self.variables).map(|j| (j, dot(&row.by, &self.directions[j]))));
        terms.extend(row.extra.iter().filter(|(_, factor)| *factor != 0.0));
        terms.extend(self.elastic.filter(|_| row.loosened != 0.0).map(|t| (t, row.loosened)));
        terms
    }

    fn not_negative(&mut self, row: Row<K>, origin: Origin) {
        let terms = self.terms(&row);
        self.program.between(-row.constant, &terms, f64::INFINITY);
        self.inequalities.push((row, origin));
    }

    /// ‖(rows 1, 2)‖ ≤ row 0.
    fn cone(&mut self, rows: [Row<K>; 3]) {
        let terms = rows.each_ref().map(|row| self.terms(row));
        let affine = |i: usize| -> Affine<'_> { (&terms[i], rows[i].constant) };
        self.program.norm_at_most(&[affine(1), affine(2)], affine(0));
        self.cones.extend(rows);
    }
}

/// The Cholesky factor of the leading block of a matrix; `None` if the block is not positive definite.
pub(super) fn cholesky<const K: usize>(matrix: &[[f64; K]; K], count: usize) -> Option<[[f64; K]; K]> {
    let mut factor = [[0.0; K]; K];
    for i in 0..count {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
            let remainder = matrix[i][j] - known;
            if i == j {
                // a pivot that cancels to rounding is not positive; NaN fails as well
                if !(remainder > 1e-10 * matrix[i][i].abs() && remainder.is_finite()) {
                    return None;
                }
                factor[i][i] = remainder.sqrt();
            } else {
                factor[i][j] = remainder / factor[j][j];
            }
        }
    }
    Some(factor)
}

/// −matrix⁻¹ · gradient.
fn solved<const K: usize>(factor: &[[f64; K]; K], gradient: &[f64; K], count: usize) -> [f64; K] {
    let mut x = [0.0; K];
    for i in 0..count {
        let known: f64 = (0..i).map(|k| factor[i][k] * x[k]).sum();
        x[i] = (-gradient[i] - known) / factor[i][i];
    }
    for i in (0..count).rev() {
        let known: f64 = (i + 1..count).map(|k| factor[k][i] * x[k]).sum();
        x[i] = (x[i] - known) / factor[i][i];
    }
    x
}
