//! A boundary problem in units of its chord, mirrored so that it bends left: what the solver works on.
//!
//! Unknowns x: the knots from the second on, then the length; in units of the chord all of them are of the order of one.
//! Mirroring makes mirrored problems the same problem, to the bit.

use super::basis::{Basis, Rows, add, dot};
use super::{EndCondition, Problem};
use crate::geometry::spiral::{Jet, Polynomial, Spiral, Tables};
use crate::geometry::{Point, Pose, Vector, wrap_angle};

/// Programs aim this much below a bound (relative): Clarabel's feasibility and the last Newton step stay within it.
const BOUND_MARGIN: f64 = 1e-6;
/// By how much a bound may be broken at an end that is pinned to it (relative).
const AT_THE_BOUND: f64 = 1e-9;
/// End conditions hold to this when a restoration stops, m; a tenth of what is promised.
const END_TOLERANCE: f64 = 1e-10;
/// What rounding leaves of it, in chords.
const END_ROUNDING: f64 = 1e-14;
/// Newton steps of a restoration; two or three are usual.
const RESTORING_STEPS: usize = 12;
/// Shortest and longest spiral, in chords. Three: a half circle has 1.57, and more has loops.
pub(super) const LENGTHS: (f64, f64) = (0.25, 3.0);
/// Lengths that a restoration may pass through, in chords.
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

/// The problem in solver's units.
#[derive(Debug, Clone)]
pub(super) struct Scaled<const K: usize> {
    /// The chord, m.
    unit: f64,
    /// 1 or −1: the side that the problem was mirrored to.
    mirror: f64,
    pub(super) start_curvature: f64,
    pub(super) target: Pose,
    pub(super) end_curvature: f64,
    /// Along, across, heading, curvature.
    pub(super) conditions: [EndCondition; 4],
    /// At the start and at the end.
    pub(super) rates: [Option<f64>; 2],
    /// Bounds of curvature and of its rate.
    pub(super) bounds: [f64; 2],
    /// What programs aim at instead.
    pub(super) aims: [f64; 2],
    /// Residual at which the end conditions hold.
    tolerance: f64,
    /// Curvatures of start and end as they were asked for, 1/m.
    asked: [f64; 2],
    pub(super) always_convex: bool,
}

/// A spiral with its end.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place<const K: usize> {
    pub(super) jet: Jet<K>,
    /// Deviations of the end: along, across, heading, curvature.
    pub(super) deviation: [f64; 4],
    /// Their derivatives by the unknowns.
    pub(super) by: [[f64; K]; 4],
}

impl<const K: usize> Scaled<K> {
    pub(super) fn new(problem: &Problem) -> Self {
        let unit = problem.target.position.coords.norm();
        let yaw = wrap_angle(problem.target.yaw);
        let leaning = [
            problem.target.position.y,
            yaw,
            problem.start_curvature,
            problem.end_curvature,
            problem.start_rate.unwrap_or(0.0),
            problem.end_rate.unwrap_or(0.0),
        ];
        let mirror = if leaning.into_iter().find(|v| *v != 0.0).is_some_and(|v| v < 0.0) { -1.0 } else { 1.0 };
        // a deviation in m, m, rad, 1/m; a weight's price is in 1/m
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
            asked: ends_kappa,
            always_convex: problem.always_convex,
        }
    }

    /// The same problem for another number of knots.
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
            asked: self.asked,
            always_convex: self.always_convex,
        }
    }

    /// The spiral in the problem's own units.
    pub(super) fn unscaled(&self, spiral: &Spiral<K>) -> Spiral<K> {
        let mut knots = spiral.knots.map(|k| k * self.mirror / self.unit);
        knots[0] = self.asked[0]; // to the bit
        if self.conditions[3] == EndCondition::Fixed {
            knots[K - 1] = self.asked[1];
        }
        Spiral { knots, length: spiral.length * self.unit }
    }

    /// How much the merit lets a bound be broken, relative to the aim.
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

    /// The fixed conditions about a place, and the ranges `held` at a limit.
    pub(super) fn rows(&self, place: &Place<K>, held: &[Option<f64>; 4]) -> Rows<K> {
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
        for (q, limit) in held.iter().enumerate() {
            if let Some(limit) = limit {
                rows.push(place.by[q], place.deviation[q] - limit);
            }
        }
        rows
    }

    /// Onto the end conditions by the shortest steps; ranges that are overstepped are held at their limit. `None` if the
    /// steps do not settle within the lengths allowed.
    pub(super) fn restored(&self, spiral: &Spiral<K>) -> Option<Place<K>> {
        let (place, on_conditions) = self.restore(spiral);
        on_conditions.then_some(place)
    }

    /// The same: the last place, and whether it is on the conditions.
    pub(super) fn restore(&self, spiral: &Spiral<K>) -> (Place<K>, bool) {
        /// Halvings of a step that does not reduce the residual.
        const HALVINGS: usize = 5;
        let mut held = [None; 4];
        let mut place = self.place(spiral);
        for _ in 0..RESTORING_STEPS {
            for (q, condition) in self.conditions.iter().enumerate() {
                if let EndCondition::Range(low, high) = *condition {
                    let d = place.deviation[q];
                    if d < low - self.tolerance || d > high + self.tolerance {
                        held[q] = Some(d.clamp(low, high));
                    }
                }
            }
            let rows = self.rows(&place, &held);
            if rows.worst() <= self.tolerance {
                let length = place.jet.spiral.length;
                let fits = (PASSING_LENGTHS.0..=PASSING_LENGTHS.1).contains(&length);
                return (place, fits);
            }
            let Some(basis) = Basis::of(&rows) else { return (place, false) };
            let step = basis.correction(&rows.residual);
            let size = sum_of_squares(&rows);
            // a step that halves or doubles the length is not to be believed
            let mut ratio = (0.5 * place.jet.spiral.length / step[K - 1].abs()).min(1.0);
            let mut next = self.place(&moved(&place.jet.spiral, &step, ratio));
            let mut halvings = 0;
            while sum_of_squares(&self.rows(&next, &held)) >= size {
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

    /// Bending energy and the prices of soft conditions.
    pub(super) fn objective(&self, place: &Place<K>) -> f64 {
        let mut sum = place.jet.spiral.bending_energy();
        for (condition, d) in self.conditions.iter().zip(place.deviation) {
            if let EndCondition::Soft { weight } = condition {
                sum += weight * d * d;
            }
        }
        sum
    }

    /// The objective's derivatives by the unknowns.
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

    /// The Hessian of objective − Σ λ d over the end's deviations d, where the soft ones bring their own λ.
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
        // the upper triangle is complete
        for i in 1..K {
            let (above, below) = hessian.split_at_mut(i);
            for (entry, row) in below[0].iter_mut().zip(above) {
                *entry = row[i];
            }
        }
        hessian
    }

    /// How far a spiral is beyond each aim, relative to it: negative inside.
    pub(super) fn beyond(&self, spiral: &Spiral<K>) -> [f64; 4] {
        let mut beyond = [-1.0; 4];
        let [kappa, rate] = self.aims;
        if kappa < f64::INFINITY {
            let (low, high) = spiral.curvature_range();
            beyond[0] = relative(high, kappa);
            beyond[1] = relative(-low, kappa);
        }
        if rate < f64::INFINITY {
            let (low, high) = spiral.curvature_rate_range();
            beyond[2] = relative(high, rate);
            beyond[3] = relative(-low, rate);
        }
        beyond
    }

    /// Whether bounds are kept, as promised.
    pub(super) fn holds(&self, beyond: &[f64; 4]) -> bool {
        SIDES.iter().zip(beyond).all(|(side, beyond)| *beyond <= self.slack(*side))
    }
}

/// Value over an aim, minus one; an aim of zero has no scale.
fn relative(value: f64, aim: f64) -> f64 {
    if aim > 0.0 {
        value / aim - 1.0
    } else if value > 0.0 {
        f64::INFINITY
    } else {
        0.0
    }
}

/// The spiral `ratio` of a step on.
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
