//! The sequence of convex programs: starts, merit, trust region, stopping.

use super::basis::{Basis, add, dot};
use super::certificate::impossible;
use super::scaled::{Place, Scaled, moved};
use super::subproblem::{Bounds, Model, Step, cholesky};
use super::{EndCondition, Infeasibility, Method, Status};
use crate::geometry::spiral::{CubicSpiral, Spiral, Tables, connect};
use crate::geometry::{Point, Pose};

/// Convex programs at most; two to five are usual.
const MAX_ITERATIONS: u32 = 40;
/// A last step that promised less than this of the objective, and kept what it promised, is the last.
const WORTH_A_STEP: f64 = 1e-4;
/// A place within the bounds is good enough if the model, without them, finds less than this of the objective to gain.
const LITTLE_TO_GAIN: f64 = 2e-5;
/// Less than this of the objective is nothing.
const NOTHING: f64 = 1e-9;
/// What an objective near zero is compared with instead.
const SMALLEST_OBJECTIVE: f64 = 1e-9;
/// First trust region, in chords and radians.
const FIRST_RADIUS: f64 = 1.0;
/// A step that nothing holds back may be longer than the trust region by this: its end is checked all the same.
const LONG: f64 = 4.0;
/// After a step smaller than this the bounds of cubics enter as cones instead of cuts: far from the end the program's
/// exactness is lost in the linearisation of the ends.
const FINE: f64 = 0.1;
/// A trust region this small does not move the end any more.
const LEAST_RADIUS: f64 = 1e-8;
/// Share of the promised decrease at which a step is taken.
const ACCEPTED: f64 = 0.05;
/// Sides whose extremum is within this of the aim (relative) join the program.
const COMES_NEAR: f64 = 0.15;
/// Boxes of the proof that nothing fits, before the search where its start is out of bounds, and after it.
const EARLY_BOXES: usize = 20;
const LATE_BOXES: usize = 200;
/// A start that breaks a bound by more than this (relative) may well have no solution: proof is looked for first.
const OUT_OF_REACH: f64 = 0.12;
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

    /// What gains are measured by.
    fn floor(&self) -> f64 {
        self.objective.abs().max(SMALLEST_OBJECTIVE)
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
    /// Whether a proof that nothing fits was looked for in earnest, and not found.
    looked_for_proof: bool,
}

impl<const K: usize> Run<K> {
    pub(super) fn new(scaled: Scaled<K>) -> Self {
        Self { scaled, iterations: 0, programs: 0, looked_for_proof: false }
    }

    pub(super) fn solve(mut self) -> Outcome<K> {
        let (mut status, place) = self.search();
        if status == stuck() && !self.looked_for_proof && impossible(&self.scaled, LATE_BOXES) {
            status = Status::Infeasible(Infeasibility::Certified);
        }
        self.outcome(status, &place)
    }

    /// From one start after the other, until one leads to a good end.
    fn search(&mut self) -> (Status, Place<K>) {
        let mut best: Option<(Status, Measured<K>)> = None;
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
            let start = self.measured(place);
            if attempt == 0
                && start.broken() > OUT_OF_REACH
                && self.is_position_held()
                && impossible(&self.scaled, EARLY_BOXES)
            {
                return (Status::Infeasible(Infeasibility::Certified), start.place);
            }
            let found = self.descend(start);
            if found.0 == stuck() && self.is_position_held() && !self.looked_for_proof {
                if impossible(&self.scaled, LATE_BOXES) {
                    return (Status::Infeasible(Infeasibility::Certified), found.1.place);
                }
                self.looked_for_proof = true;
            }
            if best.as_ref().is_none_or(|best| self.is_better(&found, best)) {
                best = Some(found);
            }
            // another start only where the first led nowhere, or astray
            if best.as_ref().is_some_and(|(status, at)| status.is_solved() && !self.astray(&at.place)) {
                break;
            }
        }
        match best {
            Some((status, last)) => (status, last.place),
            None => (stuck(), unrestored.unwrap_or_else(|| self.scaled.place(&Spiral::straight(1.0)))),
        }
    }

    fn is_better(&self, found: &(Status, Measured<K>), best: &(Status, Measured<K>)) -> bool {
        match (found.0.is_solved(), best.0.is_solved()) {
            (true, true) => found.1.objective < best.1.objective,
            (false, false) => found.1.broken() < best.1.broken(),
            (found, _) => found,
        }
    }

    /// Whether the end's position is held both ways: then the bound may well leave nothing.
    fn is_position_held(&self) -> bool {
        let [along, across, ..] = self.scaled.conditions;
        [along, across].iter().all(|c| matches!(c, EndCondition::Fixed | EndCondition::Range(..)))
    }

    /// Whether a soft position ended so far off that another start may do better.
    fn astray(&self, place: &Place<K>) -> bool {
        /// In chords.
        const FAR: f64 = 0.25;
        let [along, across, ..] = self.scaled.conditions;
        [along, across]
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

    fn measured(&self, place: Place<K>) -> Measured<K> {
        Measured { objective: self.scaled.objective(&place), beyond: self.scaled.beyond(&place.jet.spiral), place }
    }

    /// Where to start: from Newton's root and from a tamer spiral, the one that breaks the bounds less first.
    fn starts(&self) -> (Spiral<K>, Option<Spiral<K>>) {
        let scaled = &self.scaled;
        let target = self.shifted_target();
        let newton = connect(scaled.start_curvature, &target, scaled.end_curvature).ok();
        let tame = drawn(&self.tame(newton, &target));
        let Some(root) = newton.map(|cubic| unbent(drawn(&cubic))).filter(|root| *root != tame) else {
            return (tame, None);
        };
        let worst = |spiral: &Spiral<K>| scaled.beyond(spiral).iter().fold(0.0, |m: f64, b| m.max(*b));
        let restored = |spiral: &Spiral<K>| scaled.restored(spiral).map_or(f64::INFINITY, |p| worst(&p.jet.spiral));
        if worst(&root) < WILD - 1.0 || restored(&tame) >= worst(&root) {
            (root, Some(tame))
        } else {
            (tame, Some(root))
        }
    }

    /// The cubic that solves the problem of a quintic: within the bounds, if more bent than it must be.
    fn cubic(&mut self) -> Option<Spiral<K>> {
        if K <= 4 {
            return None;
        }
        let mut run = Run::new(self.scaled.with_knots::<4>());
        let (status, place) = run.search();
        self.iterations += run.iterations;
        self.programs += run.programs;
        status.is_solved().then(|| drawn(&place.jet.spiral))
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
        let mut best = at;
        let mut pace = Pace {
            radius: FIRST_RADIUS,
            penalty: 0.0,
            size: f64::INFINITY,
            may_break: false,
            shortcut: !scaled.always_convex,
        };
        let mut last = Step::free([0.0; K]);
        let mut sides = [false; 4];
        for _ in 0..MAX_ITERATIONS {
            let Some(model) = model(&scaled, &at.place, &last) else { return (stuck(), best) };
            if model.variables == 0 {
                return (if scaled.holds(&at.beyond) { Status::Solved } else { stuck() }, at);
            }
            let begun = self.programs > 0 || !scaled.always_convex;
            if begun && at.broken() <= 0.0 && model.gain().is_some_and(|g| g <= LITTLE_TO_GAIN * at.floor()) {
                return (self.status(&last, at.floor()), at);
            }
            self.iterations += 1;
            for (side, beyond) in sides.iter_mut().zip(at.beyond) {
                *side |= beyond > -COMES_NEAR;
            }
            let held_back = last.price > 0.0 || at.broken() > 0.0;
            let shortcut = if pace.shortcut && !held_back { model.unconstrained(LONG * pace.radius) } else { None };
            let Some(step) = shortcut.or_else(|| self.program(&model, sides, &mut pace)) else {
                return (stuck(), best);
            };
            let floor = at.floor();
            let price = if held_back || step.price > 0.0 { 2.0 * step.price } else { model.stiffness() };
            pace.penalty = price.max(0.2 * pace.penalty);
            let promised = -model.change(&step.shares) + pace.penalty * (at.broken() - step.broken);
            let size = step.shares.iter().fold(0.0_f64, |m, s| m.max(s.abs()));
            let settled = promised <= NOTHING * floor || pace.radius < LEAST_RADIUS;
            if !scaled.holds(&at.beyond) && (settled || hopeless(at.broken(), step.broken, pace.radius)) {
                return (stuck(), best);
            }
            let trial = moved(&at.place.jet.spiral, &model.step(&step.shares), 1.0);
            let Some(next) = scaled.restored(&trial).map(|place| self.measured(place)) else {
                if settled {
                    return (self.status(&step, floor), at);
                }
                pace.learn(f64::NAN, size);
                continue;
            };
            let kept = at.merit(pace.penalty) - next.merit(pace.penalty);
            if settled {
                let better = kept > 0.0 && scaled.holds(&next.beyond);
                return (self.status(&step, floor), if better { next } else { at });
            }
            let ratio = kept / promised;
            pace.learn(ratio, size);
            if ratio < ACCEPTED || ratio.is_nan() {
                continue;
            }
            at = next;
            if at.broken() < best.broken() || at.broken() == 0.0 && at.objective < best.objective {
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
    fn program(&mut self, model: &Model<'_, K>, sides: [bool; 4], pace: &mut Pace) -> Option<Step<K>> {
        let bounds = Bounds { sides, cones: pace.size < FINE, penalty: f64::INFINITY, radius: pace.radius };
        if !pace.may_break {
            self.programs += 1;
            if let Some(step) = model.solve(&bounds) {
                return Some(step);
            }
        }
        self.programs += 1;
        let penalty = pace.penalty.max(10.0 * model.stiffness());
        let step = model.solve(&Bounds { penalty, ..bounds })?;
        pace.may_break = step.broken > 1e-6;
        pace.penalty = penalty;
        Some(step)
    }
}

/// How boldly the iteration goes on.
#[derive(Debug, Clone, Copy)]
struct Pace {
    /// Trust region of each share of the free directions.
    radius: f64,
    /// Price of a broken bound in the merit.
    penalty: f64,
    /// Of the last step taken.
    size: f64,
    /// Whether the last program had to break a bound.
    may_break: bool,
    /// Whether steps without the bounds are tried first: until one fails.
    shortcut: bool,
}

impl Pace {
    /// After a step of a size that kept this share of its promise.
    fn learn(&mut self, ratio: f64, size: f64) {
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

/// Whether the linearised bounds say that not even a step of a unit mends a hundredth of what is broken.
fn hopeless(broken: f64, left: f64, radius: f64) -> bool {
    broken - left < 0.01 * broken * radius.min(1.0)
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

/// The least bent quintic with a quintic's ends, to first order in the heading: same length, curvatures at the ends,
/// heading at the end and mean heading, which is the direction of the chord. Changes of the curvature that leave these alone
/// are u (1−u) times polynomials that are orthogonal to 1 and u under that weight, with t = 2u − 1 the Gegenbauer polynomials
/// 5t² − 1 and 7t³ − 3t; one being even and the other odd, each has its own share.
fn unbent<const K: usize>(mut spiral: Spiral<K>) -> Spiral<K> {
    if K < 6 {
        return spiral;
    }
    let mass = &Tables::<K>::MASS;
    for polynomial in [|t: f64| 5.0 * t * t - 1.0, |t: f64| 7.0 * t * t * t - 3.0 * t] {
        let change: [f64; K] = std::array::from_fn(|i| {
            let t = 2.0 * i as f64 / (K - 1) as f64 - 1.0;
            (1.0 - t * t) * polynomial(t)
        });
        let bent: [f64; K] = std::array::from_fn(|i| dot(&mass[i], &change));
        let share = dot(&bent, &spiral.knots) / dot(&bent, &change);
        add(&mut spiral.knots, -share, &change);
    }
    spiral
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
    let mut full = scaled.hessian(place, &multipliers);
    for (row, bend) in full.iter_mut().zip(&last.bend) {
        add(row, 1.0, bend);
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::boundary::Problem;
    use crate::geometry::spiral::lattice_problems;

    /// The model's gradient and Hessian against differences of the objective over restored places: nothing of the second
    /// derivatives, multipliers or free directions may be wrong.
    fn check<const K: usize>(problem: &Problem) -> bool {
        let scaled = Scaled::<K>::new(problem);
        let run = Run::new(scaled.clone());
        let target = run.shifted_target();
        let root = connect(scaled.start_curvature, &target, scaled.end_curvature).unwrap();
        let Some(place) = scaled.restored(&drawn(&root)) else { return false };
        let model = model(&scaled, &place, &Step::free([0.0; K])).unwrap();
        let at = |shares: [f64; K]| {
            let there = moved(&place.jet.spiral, &model.step(&shares), 1.0);
            scaled.objective(&scaled.restored(&there).unwrap())
        };
        let h = 1e-3;
        let along = |i: usize, a: f64, j: usize, b: f64| {
            let mut shares = [0.0; K];
            shares[i] += a * h;
            shares[j] += b * h;
            at(shares)
        };
        let mut differences = [[0.0; K]; K];
        for (i, row) in differences.iter_mut().enumerate().take(model.variables) {
            let slope = (along(i, 1.0, i, 0.0) - along(i, -1.0, i, 0.0)) / (2.0 * h);
            let scale = 1.0 + model.hessian[i][i];
            assert!((slope - model.gradient[i]).abs() < 1e-3 * scale, "{slope} {}", model.gradient[i]);
            for (j, difference) in row.iter_mut().enumerate().take(model.variables) {
                let equal = along(i, 1.0, j, 1.0) + along(i, -1.0, j, -1.0);
                let opposite = along(i, 1.0, j, -1.0) + along(i, -1.0, j, 1.0);
                *difference = (equal - opposite) / (4.0 * h * h);
            }
        }
        // what is not convex is made so: then there is nothing to compare
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
    fn the_unbent_quintic_keeps_what_it_should_and_bends_least() {
        for (start, end, curvature) in lattice_problems(50) {
            let root: Spiral<6> = drawn(&connect(start, &end, curvature).unwrap());
            let least = unbent(root);
            // ∫κ and ∫∫κ, by exact sums over the basis
            let mean = |s: &Spiral<6>| -> f64 {
                let heading = s.curvature_polynomial().0;
                heading.iter().enumerate().map(|(p, c)| c / ((p + 1) as f64 * (p + 2) as f64)).sum()
            };
            assert_eq!((least.knots[0], least.knots[5], least.length), (root.knots[0], root.knots[5], root.length));
            assert!((least.heading_change(least.length) - root.heading_change(root.length)).abs() < 1e-12);
            assert!((mean(&least) - mean(&root)).abs() < 1e-12);
            assert!(least.bending_energy() <= root.bending_energy());
            // nothing is left to gain, and every curvature that was changed by such polynomials has the same least
            let again = unbent(least);
            assert!(least.knots.iter().zip(again.knots).all(|(a, b)| (a - b).abs() < 1e-14));
        }
        let cubic = Spiral { knots: [0.1, -0.2, 0.3, 0.0], length: 20.0 };
        assert_eq!(unbent(cubic), cubic, "a cubic has no such freedom");
    }

    #[test]
    fn the_model_has_the_objectives_derivatives_on_the_end_conditions() {
        let mut compared = 0;
        for (start, end, curvature) in lattice_problems(40) {
            let soft = |weight| EndCondition::Soft { weight };
            let pinned = Problem::pinned(start, end, curvature);
            let elastic = Problem { across: soft(0.01), heading: soft(1.0), ..pinned };
            compared += usize::from(check::<4>(&elastic));
            compared += usize::from(check::<6>(&pinned));
            compared += usize::from(check::<6>(&Problem { curvature: soft(1.0), start_rate: Some(0.0), ..elastic }));
        }
        assert!(compared > 100, "the test is about nothing: {compared}");
    }
}
