//! The internal form of a boundary problem: in units of its chord, mirrored so that it turns left.
//!
//! Unknowns x: the knots from the second on, then the length. In units of the chord all of them are of the order of one.
//! Mirroring makes mirrored problems identical to the bit.

use super::basis::{Basis, Rows, add, dot};
use super::{EndCondition, Problem};
use crate::geometry::spiral::{Jet, Polynomial, Spiral, Tables};
use crate::geometry::{Point, Pose, Vector, wrap_angle};

/// Programs aim this much below a bound (relative). It covers Clarabel's feasibility tolerance and the last Newton step.
const BOUND_MARGIN: f64 = 1e-6;
/// Permitted violation of a bound if an end condition lies at it (relative).
const AT_THE_BOUND: f64 = 1e-9;
/// Residual of the end conditions at which a restoration stops, m: a tenth of the guaranteed one.
const END_TOLERANCE: f64 = 1e-10;
/// Lower limit of that residual due to rounding, chords.
const END_ROUNDING: f64 = 1e-14;
/// Maximum number of Newton steps of a restoration; two or three are usual.
const RESTORING_STEPS: usize = 12;
/// Shortest and longest spiral, chords. A half circle has 1.57; longer than three has loops.
pub(super) const LENGTHS: (f64, f64) = (0.25, 3.0);
/// Lengths that the iterates of a restoration may have, chords.
const PASSING_LENGTHS: (f64, f64) = (0.2, 3.3);

/// The four one-sided bounds: curvature to the left and right, its rate up and down.
pub(super) const SIDES: [Side; 4] = [
    Side { of_rate: false, sign: 1.0 },
    Side { of_rate: false, sign: -1.0 },
    Side { of_rate: true, sign: 1.0 },
    Side { of_rate: true, sign: -1.0 },
];

/// A one-sided bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Side {
    pub(super) of_rate: bool,
    pub(super) sign: f64,
}

/// The problem in the units of the solver.
#[derive(Debug, Clone)]
pub(super) struct Scaled<const K: usize> {
    /// The chord, m.
    unit: f64,
    /// −1 if the problem was mirrored, else 1.
    mirror: f64,
    pub(super) start_curvature: f64,
    pub(super) target: Pose,
    pub(super) end_curvature: f64,
    /// Longitudinal, lateral, heading, curvature.
    pub(super) conditions: [EndCondition; 4],
    /// Fixed curvature rates at the start and at the end.
    pub(super) rates: [Option<f64>; 2],
    /// Bounds of curvature and of its rate.
    pub(super) bounds: [f64; 2],
    /// Slightly tighter bounds that the programs use.
    pub(super) aims: [f64; 2],
    /// Residual at which the end conditions count as satisfied.
    tolerance: f64,
    /// Curvatures of start and end in the units of the problem, 1/m.
    unscaled_curvatures: [f64; 2],
    pub(super) always_convex: bool,
}

/// A spiral with the deviations of its end.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place<const K: usize> {
    pub(super) jet: Jet<K>,
    /// Deviations of the end: longitudinal, lateral, heading, curvature.
    pub(super) deviation: [f64; 4],
    /// Their derivatives by the unknowns.
    pub(super) by: [[f64; K]; 4],
}

impl<const K: usize> Scaled<K> {
    pub(super) fn new(problem: &Problem) -> Self {
        let unit = problem.target.position.coords.norm();
        let yaw = wrap_angle(problem.target.yaw);
        let signs = [
            problem.target.position.y,
            yaw,
            problem.start_curvature,
            problem.end_curvature,
            problem.start_rate.unwrap_or(0.0),
            problem.end_rate.unwrap_or(0.0),
        ];
        let mirror = if signs.into_iter().find(|v| *v != 0.0).is_some_and(|v| v < 0.0) { -1.0 } else { 1.0 };
        // deviations in m, m, rad, 1/m; penalties in 1/m
        let scales = [1.0 / unit, 1.0 / unit, 1.0, unit];
        let mirrors = [1.0, mirror, mirror, mirror];
        let mut conditions = problem.conditions();
        for ((condition, scale), mirror) in conditions.iter_mut().zip(scales).zip(mirrors) {
            *condition = match *condition {
                EndCondition::Range(low, high) if low == high && low == 0.0 => EndCondition::Fixed,
                EndCondition::Range(low, high) => {
                    let (a, b) = (low * scale * mirror, high * scale * mirror);
                    EndCondition::Range(a.min(b), a.max(b))
                }
                EndCondition::Soft { weight } => EndCondition::Soft { weight: weight * unit / (scale * scale) },
                other => other,
            };
        }
        let (kappa, rate) = (unit * mirror, unit * unit * mirror);
        let ends_kappa = [problem.start_curvature, problem.end_curvature];
        let bounds = [problem.max_curvature * unit, problem.max_curvature_rate * unit * unit];
        let aim = |bound: f64, pinned: f64| {
            if pinned > bound * (1.0 - 2.0 * BOUND_MARGIN) { bound } else { bound * (1.0 - BOUND_MARGIN) }
        };
        let pinned_kappa =
            ends_kappa[0].abs().max(if problem.curvature == EndCondition::Fixed { ends_kappa[1].abs() } else { 0.0 });
        let rates = [problem.start_rate, problem.end_rate];
        let pinned_rate = rates.iter().flatten().fold(0.0_f64, |m, r| m.max(r.abs()));
        let at = problem.target.position;
        Self {
            unit,
            mirror,
            start_curvature: problem.start_curvature * kappa,
            target: Pose { position: Point::new(at.x / unit, mirror * at.y / unit), yaw: mirror * yaw },
            end_curvature: problem.end_curvature * kappa,
            conditions,
            rates: rates.map(|r| r.map(|r| r * rate)),
            bounds,
            aims: [aim(bounds[0], pinned_kappa * unit), aim(bounds[1], pinned_rate * unit * unit)],
            tolerance: (END_TOLERANCE / unit).max(END_ROUNDING),
            unscaled_curvatures: ends_kappa,
            always_convex: problem.always_convex,
        }
    }

    /// The same problem with another number of knots.
    pub(super) fn with_knots<const OTHER: usize>(&self) -> Scaled<OTHER> {
        Scaled {
            unit: self.unit,
            mirror: self.mirror,
            start_curvature: self.start_curvature,
            target: self.target,
            end_curvature: self.end_curvature,
            conditions: self.conditions,
            rates: self.rates,
            bounds: self.bounds,
            aims: self.aims,
            tolerance: self.tolerance,
            unscaled_curvatures: self.unscaled_curvatures,
            always_convex: self.always_convex,
        }
    }

    /// The spiral in the units of the problem.
    pub(super) fn unscaled(&self, spiral: &Spiral<K>) -> Spiral<K> {
        let mut knots = spiral.knots.map(|k| k * self.mirror / self.unit);
        knots[0] = self.unscaled_curvatures[0]; // without rounding
        if self.conditions[3] == EndCondition::Fixed {
            knots[K - 1] = self.unscaled_curvatures[1];
        }
        Spiral { knots, length: spiral.length * self.unit }
    }

    /// Excess over the aim (relative) up to which a bound counts as satisfied.
    pub(super) fn slack(&self, side: Side) -> f64 {
        let which = usize::from(side.of_rate);
        (self.bounds[which] / self.aims[which] - 1.0).max(AT_THE_BOUND)
    }

    pub(super) fn aim(&self, side: Side) -> f64 {
        self.aims[usize::from(side.of_rate)]
    }

    pub(super) fn place(&self, spiral: &Spiral<K>) -> Place<K> {
        let jet = Jet::of(spiral);
        let (forward, left) = (self.target.forward(), self.target.left());
        let off = jet.end() - self.target.position.coords;
        let deviation = [
            off.dot(&forward),
            off.dot(&left),
            jet.heading() - self.target.yaw,
            spiral.knots[K - 1] - self.end_curvature,
        ];
        let mut by = [[0.0; K]; 4];
        for i in 1..K {
            let moved = jet.by_knot(i);
            by[0][i - 1] = moved.dot(&forward);
            by[1][i - 1] = moved.dot(&left);
            by[2][i - 1] = spiral.length * Tables::<K>::WEIGHTS[i];
        }
        let moved = jet.by_length();
        by[0][K - 1] = moved.dot(&forward);
        by[1][K - 1] = moved.dot(&left);
        by[2][K - 1] = jet.heading() / spiral.length;
        by[3][K - 2] = 1.0;
        Place { jet, deviation, by }
    }

    /// The linearised fixed conditions, and the ranges that are `pinned` at a limit.
    pub(super) fn rows(&self, place: &Place<K>, pinned: &[Option<f64>; 4]) -> Rows<K> {
        let mut rows = Rows::none();
        for (q, condition) in self.conditions.iter().enumerate() {
            if *condition == EndCondition::Fixed {
                rows.push(place.by[q], place.deviation[q]);
            }
        }
        for (end, rate) in self.rates.iter().enumerate() {
            if let Some(rate) = rate {
                let (row, residual) = rate_row(&place.jet.spiral, end as f64, *rate);
                rows.push(row, residual);
            }
        }
        for (q, limit) in pinned.iter().enumerate() {
            if let Some(limit) = limit {
                rows.push(place.by[q], place.deviation[q] - limit);
            }
        }
        rows
    }

    /// Restores the end conditions by least-norm Newton steps; violated ranges are pinned at their limit. `None` if the
    /// iteration does not converge within the permitted lengths.
    pub(super) fn restored(&self, spiral: &Spiral<K>) -> Option<Place<K>> {
        let (place, on_conditions) = self.restore(spiral);
        on_conditions.then_some(place)
    }

    /// [`Self::restored`], with the last place in any case and whether it satisfies the conditions.
    pub(super) fn restore(&self, spiral: &Spiral<K>) -> (Place<K>, bool) {
        /// Halvings of a step that does not reduce the residual.
        const HALVINGS: usize = 5;
        let mut pinned = [None; 4];
        let mut place = self.place(spiral);
        for _ in 0..RESTORING_STEPS {
            for (q, condition) in self.conditions.iter().enumerate() {
                if let EndCondition::Range(low, high) = *condition {
                    let d = place.deviation[q];
                    if d < low - self.tolerance || d > high + self.tolerance {
                        pinned[q] = Some(d.clamp(low, high));
                    }
                }
            }
            let rows = self.rows(&place, &pinned);
            if rows.worst() <= self.tolerance {
                let length = place.jet.spiral.length;
                let fits = (PASSING_LENGTHS.0..=PASSING_LENGTHS.1).contains(&length);
                return (place, fits);
            }
            let Some(basis) = Basis::of(&rows) else { return (place, false) };
            let step = basis.correction(&rows.residual);
            let size = sum_of_squares(&rows);
            // limit steps that would more than halve or double the length
            let mut ratio = (0.5 * place.jet.spiral.length / step[K - 1].abs()).min(1.0);
            let mut next = self.place(&moved(&place.jet.spiral, &step, ratio));
            let mut halvings = 0;
            while sum_of_squares(&self.rows(&next, &pinned)) >= size {
                halvings += 1;
                if halvings > HALVINGS {
                    return (place, false);
                }
                ratio *= 0.5;
                next = self.place(&moved(&place.jet.spiral, &step, ratio));
            }
            if !next.deviation.iter().all(|d| d.is_finite()) {
                return (place, false);
            }
            place = next;
        }
        (place, false)
    }

    /// Bending energy plus the penalties of soft conditions.
    pub(super) fn objective(&self, place: &Place<K>) -> f64 {
        let mut sum = place.jet.spiral.bending_energy();
        for (condition, d) in self.conditions.iter().zip(place.deviation) {
            if let EndCondition::Soft { weight } = condition {
                sum += weight * d * d;
            }
        }
        sum
    }

    /// Gradient of the objective by the unknowns.
    pub(super) fn gradient(&self, place: &Place<K>) -> [f64; K] {
        let (by_knot, by_length) = place.jet.spiral.bending_energy_gradient();
        let mut gradient = [0.0; K];
        gradient[..K - 1].copy_from_slice(&by_knot[1..]);
        gradient[K - 1] = by_length;
        for (q, condition) in self.conditions.iter().enumerate() {
            if let EndCondition::Soft { weight } = condition {
                add(&mut gradient, 2.0 * weight * place.deviation[q], &place.by[q]);
            }
        }
        gradient
    }

    /// Hessian of objective − Σ λ d over the deviations d of the end; soft conditions have λ from their penalty.
    pub(super) fn hessian(&self, place: &Place<K>, multipliers: &[f64; 4]) -> [[f64; K]; K] {
        let spiral = &place.jet.spiral;
        let mut lambda = *multipliers;
        let mut hessian = [[0.0; K]; K];
        let (energy_by_knot, _) = spiral.bending_energy_gradient();
        for i in 1..K {
            for j in 1..K {
                hessian[i - 1][j - 1] = 2.0 * spiral.length * Tables::<K>::MASS[i][j];
            }
            hessian[i - 1][K - 1] = energy_by_knot[i] / spiral.length;
        }
        for (q, condition) in self.conditions.iter().enumerate() {
            if let EndCondition::Soft { weight } = condition {
                lambda[q] = -2.0 * weight * place.deviation[q];
                for (i, row) in hessian.iter_mut().enumerate() {
                    add(row, 2.0 * weight * place.by[q][i], &place.by[q]);
                }
            }
        }
        let position: Vector = self.target.forward() * lambda[0] + self.target.left() * lambda[1];
        let (by_knots, by_both, by_length) = place.jet.second(position);
        for i in 1..K {
            for j in i..K {
                hessian[i - 1][j - 1] -= by_knots[i][j];
            }
            hessian[i - 1][K - 1] -= by_both[i] + lambda[2] * Tables::<K>::WEIGHTS[i];
        }
        hessian[K - 1][K - 1] -= by_length;
        // copy the upper triangle into the lower one
        for i in 1..K {
            let (above, below) = hessian.split_at_mut(i);
            for (entry, row) in below[0].iter_mut().zip(above) {
                *entry = row[i];
            }
        }
        hessian
    }

    /// Relative excess of a spiral over each aim; negative inside the bound.
    pub(super) fn excess(&self, spiral: &Spiral<K>) -> [f64; 4] {
        let mut excess = [-1.0; 4];
        let [kappa, rate] = self.aims;
        if kappa < f64::INFINITY {
            let (low, high) = spiral.curvature_range();
            excess[0] = relative(high, kappa);
            excess[1] = relative(-low, kappa);
        }
        if rate < f64::INFINITY {
            let (low, high) = spiral.curvature_rate_range();
            excess[2] = relative(high, rate);
            excess[3] = relative(-low, rate);
        }
        excess
    }

    /// Whether the bounds hold to the guaranteed tolerance.
    pub(super) fn holds(&self, excess: &[f64; 4]) -> bool {
        SIDES.iter().zip(excess).all(|(side, excess)| *excess <= self.slack(*side))
    }
}

/// Value over aim, minus one; any positive value exceeds an aim of zero infinitely.
fn relative(value: f64, aim: f64) -> f64 {
    if aim > 0.0 {
        value / aim - 1.0
    } else if value > 0.0 {
        f64::INFINITY
    } else {
        0.0
    }
}

/// The spiral after `ratio` of a step.
pub(super) fn moved<const K: usize>(spiral: &Spiral<K>, step: &[f64; K], ratio: f64) -> Spiral<K> {
    let mut spiral = *spiral;
    for (knot, step) in spiral.knots[1..].iter_mut().zip(step) {
        *knot += ratio * step;
    }
    spiral.length += ratio * step[K - 1];
    spiral
}

/// The condition κ'(u) = rate as a row: Σ kᵢ N'ᵢ(u) − rate · L, linear in the unknowns.
fn rate_row<const K: usize>(spiral: &Spiral<K>, u: f64, rate: f64) -> ([f64; K], f64) {
    let by_knot = Tables::<K>::BASIS.map(|basis| Polynomial(basis).derivative(u));
    let mut row = [0.0; K];
    row[..K - 1].copy_from_slice(&by_knot[1..]);
    row[K - 1] = -rate;
    (row, dot(&by_knot, &spiral.knots) - rate * spiral.length)
}

fn sum_of_squares<const K: usize>(rows: &Rows<K>) -> f64 {
    rows.residual[..rows.count].iter().map(|r| r * r).sum()
}
