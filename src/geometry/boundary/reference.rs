//! A slow and simple reference optimiser for the tests: random search over the free unknowns, Newton's method with
//! finite-difference Jacobians for the others, bounds sampled at a thousand points. It shares only the evaluation of a
//! spiral with the solver.

use super::{EndCondition, Problem};
use crate::geometry::spiral::Spiral;
use crate::geometry::{Pose, wrap_angle};

const ORIGIN: Pose = Pose { position: crate::geometry::Point::new(0.0, 0.0), yaw: 0.0 };

/// splitmix64, uniform in [−1, 1].
pub(super) struct Rng(pub(super) u64);

impl Rng {
    pub(super) fn sample(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

struct Reference<'a> {
    problem: &'a Problem,
    /// Unknowns that Newton's method solves for; K stands for the length.
    dependent: Vec<usize>,
    independent: Vec<usize>,
}

/// The best spiral: its cost and its violation of bounds and ranges.
pub(super) struct Best {
    pub(super) cost: f64,
    pub(super) violation: f64,
}

/// Deviations of the end: longitudinal, lateral, heading, curvature.
pub(super) fn deviations<const K: usize>(problem: &Problem, spiral: &Spiral<K>) -> [f64; 4] {
    let end = spiral.end(&ORIGIN);
    let off = end.position - problem.target.position;
    [
        off.dot(&problem.target.forward()),
        off.dot(&problem.target.left()),
        end.yaw - wrap_angle(problem.target.yaw),
        spiral.knots[K - 1] - problem.end_curvature,
    ]
}

/// ∫ κ² ds by the midpoint rule plus the penalties of soft conditions; the largest violation of bounds (relative) and
/// ranges.
pub(super) fn evaluated<const K: usize>(problem: &Problem, spiral: &Spiral<K>, samples: usize) -> (f64, f64) {
    let (mut cost, mut violation) = (0.0, 0.0_f64);
    for i in 0..samples {
        let curvature = spiral.curvature(spiral.length * (i as f64 + 0.5) / samples as f64);
        cost += curvature * curvature * spiral.length / samples as f64;
    }
    for i in 0..=samples {
        let s = spiral.length * i as f64 / samples as f64;
        violation = violation.max(spiral.curvature(s).abs() / problem.max_curvature - 1.0);
        if problem.max_curvature_rate < f64::INFINITY {
            violation = violation.max(spiral.curvature_rate(s).abs() / problem.max_curvature_rate - 1.0);
        }
    }
    for (condition, d) in problem.conditions().into_iter().zip(deviations(problem, spiral)) {
        match condition {
            EndCondition::Soft { weight } => cost += weight * d * d,
            EndCondition::Range(low, high) => violation = violation.max(low - d).max(d - high),
            EndCondition::Fixed | EndCondition::Free => {}
        }
    }
    (cost, violation)
}

impl Reference<'_> {
    fn new<const K: usize>(problem: &Problem) -> Reference<'_> {
        // the length solves the longitudinal condition, inner knots the lateral one and the heading, the last the curvature
        let solved_by = [K, K / 2, K / 2 - 1, K - 1];
        let conditions = problem.conditions().into_iter().zip(solved_by);
        let mut dependent: Vec<usize> =
            conditions.filter(|(c, _)| *c == EndCondition::Fixed).map(|(_, unknown)| unknown).collect();
        if problem.start_rate.is_some() {
            dependent.push(1);
        }
        if problem.end_rate.is_some() {
            dependent.push(K - 2);
        }
        let independent = (1..=K).filter(|unknown| !dependent.contains(unknown)).collect();
        Reference { problem, dependent, independent }
    }

    fn residuals<const K: usize>(&self, spiral: &Spiral<K>) -> Vec<f64> {
        let mut residuals: Vec<f64> = (self.problem.conditions().into_iter())
            .zip(deviations(self.problem, spiral))
            .filter(|(c, _)| *c == EndCondition::Fixed)
            .map(|(_, d)| d)
            .collect();
        residuals.extend(self.problem.start_rate.map(|rate| spiral.curvature_rate(0.0) - rate));
        residuals.extend(self.problem.end_rate.map(|rate| spiral.curvature_rate(spiral.length) - rate));
        residuals
    }

    /// Solves for the dependent unknowns by Newton's method.
    fn solved<const K: usize>(&self, mut spiral: Spiral<K>) -> Option<Spiral<K>> {
        let chord = self.problem.target.position.coords.norm();
        let n = self.dependent.len();
        for _ in 0..20 {
            let here = self.residuals(&spiral);
            if here.iter().all(|r| r.abs() < 1e-9) {
                return (spiral.length < 3.0 * chord && spiral.length > 0.25 * chord).then_some(spiral);
            }
            let mut jacobian = nalgebra::DMatrix::<f64>::zeros(n, n);
            for (column, unknown) in self.dependent.iter().enumerate() {
                let h = 1e-6;
                let there = self.residuals(&changed(&spiral, *unknown, h));
                for row in 0..n {
                    jacobian[(row, column)] = (there[row] - here[row]) / h;
                }
            }
            let step = jacobian.lu().solve(&nalgebra::DVector::from_vec(here))?;
            for (row, unknown) in self.dependent.iter().enumerate() {
                spiral = changed(&spiral, *unknown, -step[row]);
            }
            if !(spiral.length > 0.1 * chord && spiral.length < 4.0 * chord) {
                return None;
            }
        }
        None
    }

    /// A (1+1) evolution strategy with the one-fifth rule.
    fn evolved<const K: usize>(&self, start: Spiral<K>, rounds: usize, rng: &mut Rng) -> Option<Best> {
        const PENALTY: f64 = 1e3;
        let merit = |spiral: &Spiral<K>| {
            let (cost, violation) = evaluated(self.problem, spiral, 1000);
            (cost + PENALTY * violation.max(0.0), cost, violation)
        };
        let mut at = self.solved(start)?;
        let mut value = merit(&at);
        let chord = self.problem.target.position.coords.norm();
        let mut size = 0.3;
        for _ in 0..rounds {
            let mut trial = at;
            for unknown in &self.independent {
                let unit = if *unknown == K { chord } else { 1.0 / chord };
                trial = changed(&trial, *unknown, size * unit * rng.sample());
            }
            let better = self.solved(trial).map(|t| (t, merit(&t))).filter(|(_, v)| v.0 < value.0);
            if let Some((spiral, v)) = better {
                at = spiral;
                value = v;
                size *= 1.5;
            } else {
                size *= 0.92;
            }
            if size < 1e-9 {
                break;
            }
        }
        Some(Best { cost: value.1, violation: value.2 })
    }
}

fn changed<const K: usize>(spiral: &Spiral<K>, unknown: usize, by: f64) -> Spiral<K> {
    let mut spiral = *spiral;
    if unknown == K {
        spiral.length += by
    } else {
        spiral.knots[unknown] += by
    }
    spiral
}

/// The best of several starts; `None` if no spiral meets the fixed conditions from any of them.
pub(super) fn optimum<const K: usize>(problem: &Problem, starts: usize, rounds: usize) -> Option<Best> {
    let reference = Reference::new::<K>(problem);
    let chord = problem.target.position.coords.norm();
    let mut rng = Rng(11);
    let mut best: Option<Best> = None;
    for start in 0..starts {
        let mut spiral = Spiral { knots: [0.0; K], length: chord * 1.05 };
        let spread = if start == 0 { 0.0 } else { 2.0 / chord };
        for knot in &mut spiral.knots {
            *knot = spread * rng.sample();
        }
        spiral.knots[0] = problem.start_curvature;
        spiral.knots[K - 1] = problem.end_curvature;
        let Some(found) = reference.evolved(spiral, rounds, &mut rng) else { continue };
        let rank = |b: &Best| (b.violation > 1e-6, if b.violation > 1e-6 { b.violation } else { b.cost });
        if best.as_ref().is_none_or(|b| rank(&found) < rank(b)) {
            best = Some(found);
        }
    }
    best
}
