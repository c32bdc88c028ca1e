//! The sequence of convex programs: starts, merit, trust region, stopping.

use super::basis::{Basis, add, dot};
use super::scaled::{LENGTHS, Place, Scaled, moved};
use super::subproblem::{Bounds, Model, Step, cholesky};
use super::{EndCondition, Infeasibility, Method, Status};
use crate::convex::{QuadraticProgram, Term};
use crate::geometry::spiral::{CubicSpiral, Polynomial, Spiral, Tables, connect};
use crate::geometry::{Point, Pose};

/// Convex programs at most; two to five are usual.
const MAX_ITERATIONS: u32 = 40;
/// A last step that promised less than this of the objective, and kept what it promised, is the last.
const WORTH_A_STEP: f64 = 1e-4;
/// Less than this of the objective is nothing.
const NOTHING: f64 = 1e-9;
/// What an objective near zero is compared with instead.
const SMALLEST_OBJECTIVE: f64 = 1e-9;
/// First trust region, in chords and radians.
const FIRST_RADIUS: f64 = 1.0;
/// A trust region this small does not move the end any more.
const LEAST_RADIUS: f64 = 1e-8;
/// Share of the promised decrease at which a step is taken.
const ACCEPTED: f64 = 0.05;
/// Sides whose extremum is within this of the aim (relative) join the program.
const COMES_NEAR: f64 = 0.15;
/// A start from Newton's root with more curvature than this many bounds is tried against a tamer one.
const WILD: f64 = 1.3;

/// How it ended, in the problem's units.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outcome<const K: usize> {
    pub(super) status: Status,
    pub(super) spiral: Spiral<K>,
    pub(super) method: Method,
    pub(super) iterations: u32,
    pub(super) programs: u32,
}

/// A place with what the merit is made of.
#[derive(Debug, Clone, Copy)]
struct Measured<const K: usize> {
    place: Place<K>,
    objective: f64,
    /// Of each side, relative to its aim.
    beyond: [f64; 4],
}

impl<const K: usize> Measured<K> {
    /// The worst break of a bound.
    fn broken(&self) -> f64 {
        self.beyond.iter().fold(0.0, |m: f64, b| m.max(*b))
    }

    fn merit(&self, penalty: f64) -> f64 {
        let broken = self.broken();
        if broken > 0.0 { self.objective + penalty * broken } else { self.objective }
    }
}

/// A solve under way.
#[derive(Debug, Clone)]
pub(super) struct Run<const K: usize> {
    scaled: Scaled<K>,
    iterations: u32,
    programs: u32,
}

impl<const K: usize> Run<K> {
    pub(super) fn new(scaled: Scaled<K>) -> Self {
        Self { scaled, iterations: 0, programs: 0 }
    }

    pub(super) fn solve(mut self) -> Outcome<K> {
        let (start, restored) = self.start();
        if !restored {
            let status = self.without_a_spiral();
            return self.outcome(status, &start);
        }
        let measured = self.measured(start);
        let (status, last) = self.descend(measured);
        let status = match status {
            Status::Infeasible(_) => self.without_a_spiral(),
            other => other,
        };
        self.outcome(status, &last.place)
    }

    fn outcome(&self, status: Status, place: &Place<K>) -> Outcome<K> {
        let square = self.free_count(place) == 0;
        let method = match (self.programs, square) {
            (0, true) => Method::Newton,
            (0, false) => Method::ReducedNewton,
            _ => Method::Convex,
        };
        Outcome {
            status,
            spiral: self.scaled.unscaled(&place.jet.spiral),
            method,
            iterations: self.iterations.max(1),
            programs: self.programs,
        }
    }

    fn free_count(&self, place: &Place<K>) -> usize {
        K - self.scaled.rows(place, &[None; 4]).count.min(K)
    }

    fn measured(&self, place: Place<K>) -> Measured<K> {
        Measured { objective: self.scaled.objective(&place), beyond: self.scaled.beyond(&place.jet.spiral), place }
    }

    /// A first place on the end conditions, or the best that failed to get there.
    fn start(&self) -> (Place<K>, bool) {
        let scaled = &self.scaled;
        let target = self.shifted_target();
        let newton = connect(scaled.start_curvature, &target, scaled.end_curvature).ok();
        let mut failed = None;
        if let Some(cubic) = newton {
            let (place, restored) = scaled.restore(&drawn(&cubic));
            if restored && scaled.beyond(&place.jet.spiral).iter().all(|b| *b < WILD - 1.0) {
                return (place, true);
            }
            failed = Some((place, restored));
        }
        let tame = self.tame(newton, &target);
        let (place, restored) = scaled.restore(&drawn(&tame));
        match failed {
            Some((wild, true)) => {
                let worst = |p: &Place<K>| scaled.beyond(&p.jet.spiral).iter().fold(0.0, |m: f64, b| m.max(*b));
                if restored && worst(&place) < worst(&wild) { (place, true) } else { (wild, true) }
            }
            _ => (place, restored),
        }
    }

    /// The target moved into the ranges, for Newton's method.
    fn shifted_target(&self) -> Pose {
        let into = |condition: EndCondition| match condition {
            EndCondition::Range(low, high) => 0.0_f64.clamp(low, high),
            _ => 0.0,
        };
        let scaled = &self.scaled;
        let [along, across, heading, _] = scaled.conditions.map(into);
        let position: Point = scaled.target.to_world(Point::new(along, across));
        Pose { position, yaw: scaled.target.yaw + heading }
    }

    /// A cubic within the curvature bound at its knots: Newton's, clipped, or one that turns evenly.
    fn tame(&self, newton: Option<CubicSpiral>, target: &Pose) -> CubicSpiral {
        /// Room left to the bound.
        const INSIDE: f64 = 0.95;
        let scaled = &self.scaled;
        let bound = scaled.aims[0] * INSIDE;
        let chord = target.position.coords.norm();
        let length = newton.map_or(chord * (1.0 + target.yaw * target.yaw / 24.0), |s| s.length.min(1.5 * chord));
        let even = target.yaw / length;
        let knots = newton.map_or([scaled.start_curvature, even, even, scaled.end_curvature], |s| s.knots);
        CubicSpiral {
            knots: [knots[0], knots[1].clamp(-bound, bound), knots[2].clamp(-bound, bound), knots[3]],
            length,
        }
    }

    /// From a place on the end conditions to a local optimum.
    fn descend(&mut self, start: Measured<K>) -> (Status, Measured<K>) {
        let scaled = self.scaled.clone();
        let mut at = start;
        let mut radius = FIRST_RADIUS;
        let mut penalty = 0.0_f64;
        let mut last = Step::free([0.0; K]);
        let mut sides = [false; 4];
        let mut may_break = false;
        let mut best = at;
        while self.iterations < MAX_ITERATIONS {
            let Some(model) = model(&scaled, &at.place, &last) else { return (stuck(), best) };
            if model.variables == 0 {
                return (if scaled.holds(&at.beyond) { Status::Solved } else { stuck() }, at);
            }
            self.iterations += 1;
            for (side, beyond) in sides.iter_mut().zip(at.beyond) {
                *side |= beyond > -COMES_NEAR;
            }
            let floor = at.objective.abs().max(SMALLEST_OBJECTIVE);
            let least_penalty = 10.0 * (floor + 1.0);
            let near = sides.contains(&true);
            let shortcut = if scaled.always_convex || last.price > 0.0 || at.broken() > 0.0 {
                None
            } else {
                model.unconstrained(radius)
            };
            let step = match shortcut {
                Some(step) => Some(step),
                None => self.program(&model, sides, radius, penalty.max(least_penalty), &mut may_break),
            };
            let Some(step) = step else { return (stuck(), best) };
            penalty = penalty.max(1.5 * step.price).max(if near { least_penalty } else { 0.0 });
            let promised = -model.change(&step.shares) + penalty * (at.broken() - step.broken);
            let size = step.shares.iter().fold(0.0_f64, |m, s| m.max(s.abs()));
            let settled = promised <= NOTHING * floor || radius < LEAST_RADIUS;
            if settled && at.broken() > 0.0 && !scaled.holds(&at.beyond) {
                return (stuck(), best);
            }
            let trial = moved(&at.place.jet.spiral, &model.step(&step.shares), 1.0);
            let Some(next) = scaled.restored(&trial).map(|place| self.measured(place)) else {
                if settled {
                    return (self.status(&step, floor), at);
                }
                radius = 0.25 * size;
                continue;
            };
            let kept = at.merit(penalty) - next.merit(penalty);
            if settled {
                let better = kept > 0.0 && scaled.holds(&next.beyond);
                return (self.status(&step, floor), if better { next } else { at });
            }
            let ratio = kept / promised;
            if ratio > 0.75 && size > 0.8 * radius {
                radius *= 2.0;
            } else if ratio < 0.25 {
                radius = 0.3 * size;
            }
            if ratio < ACCEPTED || ratio.is_nan() {
                continue;
            }
            at = next;
            if at.merit(penalty) < best.merit(penalty) || at.broken() < best.broken() {
                best = at;
            }
            let as_promised = promised <= WORTH_A_STEP * floor && (ratio - 1.0).abs() < 0.3;
            if as_promised && scaled.holds(&at.beyond) {
                return (self.status(&step, floor), at);
            }
            last = step;
        }
        (Status::IterationLimit, best)
    }

    fn status(&self, step: &Step<K>, floor: f64) -> Status {
        if step.price > 1e-6 * floor { Status::BoundActive } else { Status::Solved }
    }

    /// The program with bounds that hold, or, where that has no solution, that may be broken for a price.
    fn program(
        &mut self,
        model: &Model<'_, K>,
        sides: [bool; 4],
        radius: f64,
        penalty: f64,
        may_break: &mut bool,
    ) -> Option<Step<K>> {
        let bounds = Bounds { sides, penalty: f64::INFINITY, radius };
        if !*may_break {
            self.programs += 1;
            if let Some(step) = model.solve(&bounds) {
                return Some(step);
            }
        }
        self.programs += 1;
        let step = model.solve(&Bounds { penalty, ..bounds })?;
        *may_break = step.broken > 1e-6;
        Some(step)
    }

    /// What to say when no place on the conditions and within the bounds was found.
    fn without_a_spiral(&mut self) -> Status {
        self.programs += 1;
        let certified = contradictory(&self.scaled);
        Status::Infeasible(if certified { Infeasibility::Certified } else { Infeasibility::NotFound })
    }
}

fn stuck() -> Status {
    Status::Infeasible(Infeasibility::NotFound)
}

/// The cubic with so many knots, ends to the bit.
fn drawn<const K: usize>(cubic: &CubicSpiral) -> Spiral<K> {
    let curvature = cubic.curvature_polynomial();
    let mut knots = std::array::from_fn(|i| curvature.value(i as f64 / (K - 1) as f64));
    knots[K - 1] = cubic.knots[3];
    Spiral { knots, length: cubic.length }
}

/// The quadratic model about a place, with the multipliers that the last step gave.
fn model<'a, const K: usize>(scaled: &'a Scaled<K>, place: &'a Place<K>, last: &Step<K>) -> Option<Model<'a, K>> {
    let rows = scaled.rows(place, &[None; 4]);
    let basis = Basis::of(&rows)?;
    let variables = K - rows.count;
    let objective = scaled.gradient(place);
    let mut pulled = objective;
    add(&mut pulled, 1.0, &last.pull);
    for (q, multiplier) in last.ranges.iter().enumerate() {
        add(&mut pulled, *multiplier, &place.by[q]);
    }
    let found = basis.multipliers(&pulled);
    let mut multipliers = last.ranges.map(|m| -m);
    let fixed = scaled.conditions.iter().zip(&mut multipliers).filter(|(c, _)| **c == EndCondition::Fixed);
    for ((_, multiplier), found) in fixed.zip(found) {
        *multiplier = found;
    }
    let full = scaled.hessian(place, &multipliers);
    let mut gradient = [0.0; K];
    let mut hessian = [[0.0; K]; K];
    for (i, direction) in basis.free().iter().enumerate() {
        gradient[i] = dot(&objective, direction);
        let bent: [f64; K] = std::array::from_fn(|row| dot(&full[row], direction));
        for (j, other) in basis.free().iter().enumerate() {
            hessian[i][j] = dot(&bent, other);
        }
    }
    convexify(&mut hessian, variables)?;
    Some(Model { scaled, place, basis, variables, gradient, hessian })
}

/// Adds to the diagonal until the matrix is positive definite.
fn convexify<const K: usize>(hessian: &mut [[f64; K]; K], count: usize) -> Option<()> {
    /// First shift, of the largest entry, and its growth: 1e-4 … 1e6.
    const SHIFTS: (f64, f64, usize) = (1e-4, 4.0, 17);
    let largest = (0..count).fold(SMALLEST_OBJECTIVE, |m: f64, i| m.max(hessian[i][i].abs()));
    let mut shift = 0.0;
    for _ in 0..SHIFTS.2 {
        let mut shifted = *hessian;
        for (i, row) in shifted.iter_mut().enumerate().take(count) {
            row[i] += shift;
        }
        if cholesky(&shifted, count).is_some() {
            *hessian = shifted;
            return Some(());
        }
        shift = (shift * SHIFTS.1).max(SHIFTS.0 * largest);
    }
    None
}

/// Whether the conditions that are linear in the knots and the length contradict each other: bounds at many points, end
/// curvature and rates, and that turning takes curvature and length. Only ever true if there is no spiral.
fn contradictory<const K: usize>(scaled: &Scaled<K>) -> bool {
    /// Places at which the bounds are asked for.
    const PLACES: usize = 20;
    let length = K - 1;
    let mut program = QuadraticProgram::new(K);
    for i in 0..K {
        program.add_square(1.0, &[(i, 1.0)], 0.0);
    }
    let [kappa, rate] = scaled.bounds;
    let knots = |basis: &dyn Fn(&Polynomial<K>) -> f64| -> (Vec<Term>, f64) {
        let values = Tables::<K>::BASIS.map(|b| basis(&Polynomial(b)));
        (values[1..].iter().copied().enumerate().collect(), values[0] * scaled.start_curvature)
    };
    for place in 0..=PLACES {
        let u = place as f64 / PLACES as f64;
        let (row, known) = knots(&|p| p.value(u));
        program.between(-kappa - known, &row, kappa - known);
        if rate < f64::INFINITY {
            for sign in [1.0, -1.0] {
                let (mut row, known) = knots(&|p| sign * p.derivative(u));
                row.push((length, -rate));
                program.between(f64::NEG_INFINITY, &row, -known);
            }
        }
    }
    for (end, wanted) in scaled.rates.iter().enumerate() {
        if let Some(wanted) = wanted {
            let (mut row, known) = knots(&|p| p.derivative(end as f64));
            row.push((length, -wanted));
            program.equal(&row, -known);
        }
    }
    let limits = |condition: EndCondition| match condition {
        EndCondition::Fixed => Some((0.0, 0.0)),
        EndCondition::Range(low, high) => Some((low, high)),
        EndCondition::Free | EndCondition::Soft { .. } => None,
    };
    let [along, across, heading, curvature] = scaled.conditions.map(limits);
    if let Some((low, high)) = curvature {
        program.between(scaled.end_curvature + low, &[(K - 2, 1.0)], scaled.end_curvature + high);
    }
    let position_pinned = along == Some((0.0, 0.0)) && across == Some((0.0, 0.0));
    let mut shortest = if position_pinned { 1.0 } else { LENGTHS.0 };
    if let Some((low, high)) = heading {
        // the turning that is needed on either side: mean curvature times length
        let (left, right) = (scaled.target.yaw + low, scaled.target.yaw + high);
        shortest = f64::max(shortest, left.max(-right) / kappa);
        let (row, known) = knots(&|p| p.integral(1.0));
        if left > 0.0 {
            program.between(left / LENGTHS.1 - known, &row, f64::INFINITY);
        }
        if right < 0.0 {
            program.between(f64::NEG_INFINITY, &row, right / LENGTHS.1 - known);
        }
    }
    if shortest > LENGTHS.1 {
        return true;
    }
    program.between(shortest, &[(length, 1.0)], LENGTHS.1);
    program.solve().status == crate::convex::Status::Infeasible
}
