//! The sequence of convex programs: starts, merit function, trust region, stopping criteria.

use super::basis::{Basis, add, dot};
use super::certificate::is_infeasible;
use super::scaled::{Place, Scaled, moved};
use super::subproblem::{Bounds, Model, Step, cholesky};
use super::{EndCondition, Infeasibility, Method, Status};
use crate::geometry::spiral::{CubicSpiral, Spiral, Tables, connect};
use crate::geometry::{Point, Pose};

/// Maximum number of convex programs; two to five are usual.
const MAX_ITERATIONS: u32 = 40;
/// The iteration stops after a step with a predicted decrease below this fraction of the objective, if the actual
/// decrease agrees with the prediction.
const WORTH_A_STEP: f64 = 1e-4;
/// A place within the bounds is optimal if the unconstrained model decreases by less than this fraction of the objective.
const LITTLE_TO_GAIN: f64 = 2e-5;
/// A predicted decrease below this fraction of the objective is zero.
const NEGLIGIBLE: f64 = 1e-9;
/// Lower limit of the objective in such fractions.
const SMALLEST_OBJECTIVE: f64 = 1e-9;
/// Initial trust region, chords and radians.
const FIRST_RADIUS: f64 = 1.0;
/// An unconstrained step may exceed the trust region by this factor; its merit is checked like that of any other step.
const LONG: f64 = 4.0;
/// After a step smaller than this the bounds of cubics enter as cones instead of cuts. Far from the solution the
/// linearisation of the ends is coarser than the cones.
const FINE: f64 = 0.1;
/// The iteration stops at a trust region smaller than this.
const MIN_RADIUS: f64 = 1e-8;
/// Fraction of the predicted decrease at which a step is accepted.
const ACCEPTED: f64 = 0.05;
/// Sides whose extremum is within this (relative) of the aim enter the program.
const COMES_NEAR: f64 = 0.15;
/// Maximum number of boxes of the infeasibility proof: before the search if its start is out of bounds, and after it.
const EARLY_BOXES: usize = 20;
const LATE_BOXES: usize = 200;
/// If a start violates a bound by more than this (relative), the proof comes before the search.
const OUT_OF_REACH: f64 = 0.12;
/// If the curvature of Newton's spiral exceeds the bound by more than this factor, a start of moderate curvature competes.
const EXCESSIVE: f64 = 1.3;

/// Outcome in the units of the problem.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outcome<const K: usize> {
    pub(super) status: Status,
    pub(super) spiral: Spiral<K>,
    pub(super) method: Method,
    pub(super) iterations: u32,
    pub(super) programs: u32,
}

/// A place with the terms of its merit.
#[derive(Debug, Clone, Copy)]
struct Evaluated<const K: usize> {
    place: Place<K>,
    objective: f64,
    /// Excess of each side, relative to its aim.
    excess: [f64; 4],
}

impl<const K: usize> Evaluated<K> {
    /// The largest violation of a bound; 0 if all hold.
    fn violation(&self) -> f64 {
        self.excess.iter().fold(0.0, |m: f64, b| m.max(*b))
    }

    /// The scale of decreases: |objective|, at least [`SMALLEST_OBJECTIVE`].
    fn scale(&self) -> f64 {
        self.objective.abs().max(SMALLEST_OBJECTIVE)
    }

    fn merit(&self, penalty: f64) -> f64 {
        let violation = self.violation();
        if violation > 0.0 { self.objective + penalty * violation } else { self.objective }
    }
}

/// State of a solve.
#[derive(Debug, Clone)]
pub(super) struct Run<const K: usize> {
    scaled: Scaled<K>,
    iterations: u32,
    programs: u32,
    /// Whether an infeasibility proof with [`LATE_BOXES`] has failed.
    proof_attempted: bool,
}

impl<const K: usize> Run<K> {
    pub(super) fn new(scaled: Scaled<K>) -> Self {
        Self { scaled, iterations: 0, programs: 0, proof_attempted: false }
    }

    pub(super) fn solve(mut self) -> Outcome<K> {
        let (mut status, place) = self.search();
        if status == not_found() && !self.proof_attempted && is_infeasible(&self.scaled, LATE_BOXES) {
            status = Status::Infeasible(Infeasibility::Certified);
        }
        self.outcome(status, &place)
    }

    /// Tries one start after the other until one succeeds.
    fn search(&mut self) -> (Status, Place<K>) {
        let mut best: Option<(Status, Evaluated<K>)> = None;
        let mut unrestored = None;
        let (first, second) = self.starts();
        for attempt in 0..3 {
            let start = match attempt {
                0 => Some(first),
                1 => self.cubic(),
                _ => second,
            };
            let Some(start) = start else { continue };
            let (place, restored) = self.scaled.restore(&start);
            if !restored {
                unrestored.get_or_insert(place);
                continue;
            }
            let start = self.evaluated(place);
            if attempt == 0
                && start.violation() > OUT_OF_REACH
                && self.is_position_constrained()
                && is_infeasible(&self.scaled, EARLY_BOXES)
            {
                return (Status::Infeasible(Infeasibility::Certified), start.place);
            }
            let found = self.descend(start);
            if found.0 == not_found() && self.is_position_constrained() && !self.proof_attempted {
                if is_infeasible(&self.scaled, LATE_BOXES) {
                    return (Status::Infeasible(Infeasibility::Certified), found.1.place);
                }
                self.proof_attempted = true;
            }
            if best.as_ref().is_none_or(|best| self.is_better(&found, best)) {
                best = Some(found);
            }
            // further starts only after a failure or a result far from a soft target
            if best.as_ref().is_some_and(|(status, at)| status.is_solved() && !self.is_far_off(&at.place)) {
                break;
            }
        }
        match best {
            Some((status, last)) => (status, last.place),
            None => (not_found(), unrestored.unwrap_or_else(|| self.scaled.place(&Spiral::straight(1.0)))),
        }
    }

    fn is_better(&self, found: &(Status, Evaluated<K>), best: &(Status, Evaluated<K>)) -> bool {
        match (found.0.is_solved(), best.0.is_solved()) {
            (true, true) => found.1.objective < best.1.objective,
            (false, false) => found.1.violation() < best.1.violation(),
            (found, _) => found,
        }
    }

    /// Whether both components of the end position are constrained: then the problem may well be infeasible.
    fn is_position_constrained(&self) -> bool {
        let [longitudinal, lateral, ..] = self.scaled.conditions;
        [longitudinal, lateral].iter().all(|c| matches!(c, EndCondition::Fixed | EndCondition::Range(..)))
    }

    /// Whether a soft position is so far from its target that another start may be better.
    fn is_far_off(&self, place: &Place<K>) -> bool {
        /// Chords.
        const FAR: f64 = 0.25;
        let [longitudinal, lateral, ..] = self.scaled.conditions;
        [longitudinal, lateral]
            .iter()
            .zip(place.deviation)
            .any(|(condition, d)| matches!(condition, EndCondition::Soft { .. }) && d.abs() > FAR)
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

    fn evaluated(&self, place: Place<K>) -> Evaluated<K> {
        Evaluated { objective: self.scaled.objective(&place), excess: self.scaled.excess(&place.jet.spiral), place }
    }

    /// The starts: Newton's spiral and one of moderate curvature; first the one with the smaller violation of the bounds.
    fn starts(&self) -> (Spiral<K>, Option<Spiral<K>>) {
        let scaled = &self.scaled;
        let target = self.shifted_target();
        let newton = connect(scaled.start_curvature, &target, scaled.end_curvature).ok();
        let moderate = with_knots(&self.moderate(newton, &target));
        let Some(root) = newton.map(|cubic| least_bent(with_knots(&cubic))).filter(|root| *root != moderate) else {
            return (moderate, None);
        };
        let worst = |spiral: &Spiral<K>| scaled.excess(spiral).iter().fold(0.0, |m: f64, b| m.max(*b));
        let restored = |spiral: &Spiral<K>| scaled.restored(spiral).map_or(f64::INFINITY, |p| worst(&p.jet.spiral));
        if worst(&root) < EXCESSIVE - 1.0 || restored(&moderate) >= worst(&root) {
            (root, Some(moderate))
        } else {
            (moderate, Some(root))
        }
    }

    /// The cubic solution of the problem as a start for the quintic: within the bounds, with more bending than necessary.
    fn cubic(&mut self) -> Option<Spiral<K>> {
        if K <= 4 {
            return None;
        }
        let mut run = Run::new(self.scaled.with_knots::<4>());
        let (status, place) = run.search();
        self.iterations += run.iterations;
        self.programs += run.programs;
        status.is_solved().then(|| with_knots(&place.jet.spiral))
    }

    /// The target moved into the ranges, for Newton's method.
    fn shifted_target(&self) -> Pose {
        let into = |condition: EndCondition| match condition {
            EndCondition::Range(low, high) => 0.0_f64.clamp(low, high),
            _ => 0.0,
        };
        let scaled = &self.scaled;
        let [longitudinal, lateral, heading, _] = scaled.conditions.map(into);
        let position: Point = scaled.target.to_world(Point::new(longitudinal, lateral));
        Pose { position, yaw: scaled.target.yaw + heading }
    }

    /// A cubic whose knots are within the curvature bound: Newton's with clamped knots, or one of even curvature.
    fn moderate(&self, newton: Option<CubicSpiral>, target: &Pose) -> CubicSpiral {
        /// Fraction of the bound to which knots are clamped.
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

    /// Iterates from a place that satisfies the end conditions to a local optimum.
    fn descend(&mut self, start: Evaluated<K>) -> (Status, Evaluated<K>) {
        let scaled = self.scaled.clone();
        let mut at = start;
        let mut best = at;
        let mut control = StepControl {
            radius: FIRST_RADIUS,
            penalty: 0.0,
            size: f64::INFINITY,
            is_elastic: false,
            shortcut: !scaled.always_convex,
        };
        let mut last = Step::free([0.0; K]);
        let mut sides = [false; 4];
        for _ in 0..MAX_ITERATIONS {
            let Some(model) = model(&scaled, &at.place, &last) else { return (not_found(), best) };
            if model.variables == 0 {
                return (if scaled.holds(&at.excess) { Status::Solved } else { not_found() }, at);
            }
            let begun = self.programs > 0 || !scaled.always_convex;
            if begun && at.violation() <= 0.0 && model.gain().is_some_and(|g| g <= LITTLE_TO_GAIN * at.scale()) {
                return (self.status(&last, at.scale()), at);
            }
            self.iterations += 1;
            for (side, excess) in sides.iter_mut().zip(at.excess) {
                *side |= excess > -COMES_NEAR;
            }
            let constrained = last.price > 0.0 || at.violation() > 0.0;
            let shortcut =
                if control.shortcut && !constrained { model.unconstrained(LONG * control.radius) } else { None };
            let Some(step) = shortcut.or_else(|| self.program(&model, sides, &mut control)) else {
                return (not_found(), best);
            };
            let scale = at.scale();
            let price = if constrained || step.price > 0.0 { 2.0 * step.price } else { model.stiffness() };
            control.penalty = price.max(0.2 * control.penalty);
            let promised = -model.change(&step.shares) + control.penalty * (at.violation() - step.violation);
            let size = step.shares.iter().fold(0.0_f64, |m, s| m.max(s.abs()));
            let settled = promised <= NEGLIGIBLE * scale || control.radius < MIN_RADIUS;
            if !scaled.holds(&at.excess) && (settled || cannot_improve(at.violation(), step.violation, control.radius))
            {
                return (not_found(), best);
            }
            let trial = moved(&at.place.jet.spiral, &model.step(&step.shares), 1.0);
            let Some(next) = scaled.restored(&trial).map(|place| self.evaluated(place)) else {
                if settled {
                    return (self.status(&step, scale), at);
                }
                control.update(f64::NAN, size);
                continue;
            };
            let kept = at.merit(control.penalty) - next.merit(control.penalty);
            if settled {
                let better = kept > 0.0 && scaled.holds(&next.excess);
                return (self.status(&step, scale), if better { next } else { at });
            }
            let ratio = kept / promised;
            control.update(ratio, size);
            if ratio < ACCEPTED || ratio.is_nan() {
                continue;
            }
            at = next;
            if at.violation() < best.violation() || at.violation() == 0.0 && at.objective < best.objective {
                best = at;
            }
            let as_promised = promised <= WORTH_A_STEP * scale && (ratio - 1.0).abs() < 0.3;
            if as_promised && scaled.holds(&at.excess) {
                return (self.status(&step, scale), at);
            }
            last = step;
        }
        (Status::IterationLimit, best)
    }

    fn status(&self, step: &Step<K>, scale: f64) -> Status {
        if step.price > 1e-6 * scale { Status::BoundActive } else { Status::Solved }
    }

    /// Solves the program with hard bounds or, if that is infeasible, with elastic bounds.
    fn program(&mut self, model: &Model<'_, K>, sides: [bool; 4], control: &mut StepControl) -> Option<Step<K>> {
        let bounds = Bounds { sides, cones: control.size < FINE, penalty: f64::INFINITY, radius: control.radius };
        if !control.is_elastic {
            self.programs += 1;
            if let Some(step) = model.solve(&bounds) {
                return Some(step);
            }
        }
        self.programs += 1;
        let penalty = control.penalty.max(10.0 * model.stiffness());
        let step = model.solve(&Bounds { penalty, ..bounds })?;
        control.is_elastic = step.violation > 1e-6;
        control.penalty = penalty;
        Some(step)
    }
}

/// Trust region, penalty and mode of the iteration.
#[derive(Debug, Clone, Copy)]
struct StepControl {
    /// Trust region of each coordinate.
    radius: f64,
    /// Penalty of a violation in the merit.
    penalty: f64,
    /// Size of the last accepted step.
    size: f64,
    /// Whether the last program needed elastic bounds.
    is_elastic: bool,
    /// Whether unconstrained steps come first: until one fails.
    shortcut: bool,
}

impl StepControl {
    /// Updates after a step of this size with this ratio of actual to predicted decrease.
    fn update(&mut self, ratio: f64, size: f64) {
        if ratio > 0.75 && size > 0.8 * self.radius {
            self.radius *= 2.0;
        } else if ratio < 0.25 || ratio.is_nan() {
            self.radius = 0.3 * size;
        }
        if ratio >= ACCEPTED {
            self.size = size;
        } else {
            self.shortcut = false;
        }
    }
}

/// Whether, by the linearised bounds, a unit step reduces the violation by less than a hundredth.
fn cannot_improve(violation: f64, remaining: f64, radius: f64) -> bool {
    violation - remaining < 0.01 * violation * radius.min(1.0)
}

fn not_found() -> Status {
    Status::Infeasible(Infeasibility::NotFound)
}

/// The cubic with K knots; its end curvatures are not rounded.
fn with_knots<const K: usize>(cubic: &CubicSpiral) -> Spiral<K> {
    let curvature = cubic.curvature_polynomial();
    let mut knots = std::array::from_fn(|i| curvature.value(i as f64 / (K - 1) as f64));
    knots[K - 1] = cubic.knots[3];
    Spiral { knots, length: cubic.length }
}

/// The quintic of least bending energy with the ends of the given one, to first order in the heading: same length, end
/// curvatures, end heading and mean heading (the direction of the chord). Changes of the curvature that preserve these are
/// u (1−u) times polynomials orthogonal to 1 and u under that weight: with t = 2u − 1 the Gegenbauer polynomials 5t² − 1
/// and 7t³ − 3t. One is even and the other odd, so that their factors are independent. A cubic is returned unchanged.
fn least_bent<const K: usize>(mut spiral: Spiral<K>) -> Spiral<K> {
    if K < 6 {
        return spiral;
    }
    let mass = &Tables::<K>::MASS;
    for polynomial in [|t: f64| 5.0 * t * t - 1.0, |t: f64| 7.0 * t * t * t - 3.0 * t] {
        let change: [f64; K] = std::array::from_fn(|i| {
            let t = 2.0 * i as f64 / (K - 1) as f64 - 1.0;
            (1.0 - t * t) * polynomial(t)
        });
        let weighted: [f64; K] = std::array::from_fn(|i| dot(&mass[i], &change));
        let share = dot(&weighted, &spiral.knots) / dot(&weighted, &change);
        add(&mut spiral.knots, -share, &change);
    }
    spiral
}

/// The quadratic model about a place, with the multipliers of the last step.
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
    let mut full = scaled.hessian(place, &multipliers);
    for (row, cut) in full.iter_mut().zip(&last.cut_hessian) {
        add(row, 1.0, cut);
    }
    let mut gradient = [0.0; K];
    let mut hessian = [[0.0; K]; K];
    for (i, direction) in basis.free().iter().enumerate() {
        gradient[i] = dot(&objective, direction);
        let product: [f64; K] = std::array::from_fn(|row| dot(&full[row], direction));
        for (j, other) in basis.free().iter().enumerate() {
            hessian[i][j] = dot(&product, other);
        }
    }
    convexify(&mut hessian, variables)?;
    Some(Model { scaled, place, basis, variables, gradient, hessian })
}

/// Adds to the diagonal until the matrix is positive definite.
fn convexify<const K: usize>(hessian: &mut [[f64; K]; K], count: usize) -> Option<()> {
    /// First shift relative to the largest entry, growth factor, number of shifts: 1e-4 … 1e6.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::boundary::Problem;
    use crate::geometry::spiral::lattice_problems;

    /// Compares gradient and Hessian of the model with finite differences of the objective over restored places: covers
    /// second derivatives, multipliers and free directions. Returns whether the Hessian was comparable.
    fn check<const K: usize>(problem: &Problem) -> bool {
        let scaled = Scaled::<K>::new(problem);
        let run = Run::new(scaled.clone());
        let target = run.shifted_target();
        let root = connect(scaled.start_curvature, &target, scaled.end_curvature).unwrap();
        let Some(place) = scaled.restored(&with_knots(&root)) else { return false };
        let model = model(&scaled, &place, &Step::free([0.0; K])).unwrap();
        let at = |shares: [f64; K]| {
            let there = moved(&place.jet.spiral, &model.step(&shares), 1.0);
            scaled.objective(&scaled.restored(&there).unwrap())
        };
        let h = 1e-3;
        let offset_objective = |i: usize, a: f64, j: usize, b: f64| {
            let mut shares = [0.0; K];
            shares[i] += a * h;
            shares[j] += b * h;
            at(shares)
        };
        let mut differences = [[0.0; K]; K];
        for (i, row) in differences.iter_mut().enumerate().take(model.variables) {
            let slope = (offset_objective(i, 1.0, i, 0.0) - offset_objective(i, -1.0, i, 0.0)) / (2.0 * h);
            let scale = 1.0 + model.hessian[i][i];
            assert!((slope - model.gradient[i]).abs() < 1e-3 * scale, "{slope} {}", model.gradient[i]);
            for (j, difference) in row.iter_mut().enumerate().take(model.variables) {
                let equal = offset_objective(i, 1.0, j, 1.0) + offset_objective(i, -1.0, j, -1.0);
                let opposite = offset_objective(i, 1.0, j, -1.0) + offset_objective(i, -1.0, j, 1.0);
                *difference = (equal - opposite) / (4.0 * h * h);
            }
        }
        // a model that was convexified is not comparable
        let convex = cholesky(&differences, model.variables).is_some();
        for (i, row) in differences.iter().enumerate().take(if convex { model.variables } else { 0 }) {
            for (j, difference) in row.iter().enumerate().take(model.variables) {
                let scale = 1.0 + model.hessian[i][i].max(model.hessian[j][j]);
                let off = (difference - model.hessian[i][j]).abs();
                assert!(off < 2e-2 * scale, "{i} {j}: {difference} {}", model.hessian[i][j]);
            }
        }
        convex
    }

    #[test]
    fn the_least_bent_quintic_preserves_its_ends_and_its_mean_heading() {
        for (start, end, curvature) in lattice_problems(50) {
            let root: Spiral<6> = with_knots(&connect(start, &end, curvature).unwrap());
            let least = least_bent(root);
            // ∫κ and ∫∫κ, by exact sums over the basis
            let mean = |s: &Spiral<6>| -> f64 {
                let heading = s.curvature_polynomial().0;
                heading.iter().enumerate().map(|(p, c)| c / ((p + 1) as f64 * (p + 2) as f64)).sum()
            };
            assert_eq!((least.knots[0], least.knots[5], least.length), (root.knots[0], root.knots[5], root.length));
            assert!((least.heading_change(least.length) - root.heading_change(root.length)).abs() < 1e-12);
            assert!((mean(&least) - mean(&root)).abs() < 1e-12);
            assert!(least.bending_energy() <= root.bending_energy());
            // a second application changes nothing
            let again = least_bent(least);
            assert!(least.knots.iter().zip(again.knots).all(|(a, b)| (a - b).abs() < 1e-14));
        }
        let cubic = Spiral { knots: [0.1, -0.2, 0.3, 0.0], length: 20.0 };
        assert_eq!(least_bent(cubic), cubic, "a cubic has no such freedom");
    }

    #[test]
    fn model_derivatives_agree_with_finite_differences() {
        let mut compared = 0;
        for (start, end, curvature) in lattice_problems(40) {
            let soft = |weight| EndCondition::Soft { weight };
            let pinned = Problem::pinned(start, end, curvature);
            let elastic = Problem { lateral: soft(0.01), heading: soft(1.0), ..pinned };
            compared += usize::from(check::<4>(&elastic));
            compared += usize::from(check::<6>(&pinned));
            compared += usize::from(check::<6>(&Problem { curvature: soft(1.0), start_rate: Some(0.0), ..elastic }));
        }
        assert!(compared > 100, "too few comparisons: {compared}");
    }
}
