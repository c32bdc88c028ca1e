//! Polynomial spirals of least bending energy under end conditions and bounds of the curvature and its rate.
//!
//! ```text
//! minimise    ∫ κ² ds + Σ wᵢ dᵢ²                 over the knots and the length
//! subject to  dᵢ = 0, or lowᵢ ≤ dᵢ ≤ highᵢ, or free   for the deviations d of the end from its target:
//!                                                longitudinal and lateral (in the target's frame), heading, curvature
//!             |κ(u)| ≤ κ_max,  |dκ/ds(u)| ≤ rate_max   for all u in [0, 1]
//! ```
//!
//! [`Problem::cubic`] and [`Problem::quintic`] solve a [`Problem`]. The [`Solution`] reports the status, the method, and
//! the residuals of the conditions.
//!
//! # Technique
//!
//! - **Square problems** (a cubic with all end conditions fixed) leave no freedom: Newton's method.
//! - Other problems are solved by **feasible sequential convex programming**. A least-norm Newton step restores the end
//!   conditions of every iterate, so that the variables of the convex program are the one to four remaining degrees of
//!   freedom. The Hessian of the Lagrangian is exact (second moments of the quadrature, no finite differences). Two to
//!   four programs are usual. An ℓ1 penalty of the bounds as merit function and a trust region globalise the iteration
//!   (Fletcher's Sℓ₁QP; Nocedal & Wright, 18.5).
//! - A program without an active inequality is a linear system and is solved as such ([`Method::ReducedNewton`]);
//!   otherwise Clarabel solves it ([`Method::Convex`]). [`Problem::always_convex`] uses Clarabel for every program.
//! - **Bounds of cubics** are exact convex constraints: a cubic is non-negative on [0, 1] if and only if it is
//!   u·σ₁ + (1−u)·σ₂ with sums of squares σ of degree two, a quadratic if and only if it is σ + γ u(1−u) with γ ≥ 0
//!   (Markov–Lukács; Szegő, Orthogonal Polynomials, 1.21.1), and σ = a + 2bu + cu² is a three-dimensional second-order
//!   cone ‖(2b, a − c)‖ ≤ a + c. The equalities are eliminated analytically: two variables and two cones for each side of
//!   the curvature, one variable and one cone for each side of its rate, and only for sides that are nearly active. The
//!   first, long steps use cuts at the extrema instead, since the linearisation of the ends is coarser than the cones.
//! - **Bounds of quintics** would need 3×3 semidefinite cones. Linear cuts at the exact extrema replace them. Each
//!   iteration updates the cuts, and the Hessian contains the second derivative of the extremum's value (its argument
//!   moves), so that the iteration converges like Newton's method with fewer variables. The exact extrema of the result
//!   are checked. If a quintic fails from its own start, it starts again from the cubic that solves the problem.
//! - **Quintics start** from the cubic solution, minus the bending that a quintic can avoid. To first order in the heading
//!   this has a closed form, and usually one program remains.
//! - **Proof of infeasibility**: branch and bound over linear relaxations of the whole problem, position included (see
//!   `certificate`). For quintics with all end conditions fixed and a start far out of bounds the proof comes before the
//!   search, so that the many infeasible problems are cheap.
//!
//! # Guarantees
//!
//! With [`Status::Solved`] or [`Status::BoundActive`]:
//! - Fixed conditions and ranges hold to 1e-9 m and rad.
//! - Curvature and rate are within their bounds everywhere. The programs aim 1e-6 (relative) below the bounds; where an
//!   end condition is closer to the bound than that, they hold to 1e-9 of it.
//! - The spiral is a local optimum, to 1e-4 of the objective.
//!
//! Equal problems have equal solutions to the bit, and mirrored problems have mirrored solutions to the bit.
//!
//! # Weaknesses
//!
//! - Quintics with a soft end under an active bound take ten to twenty steps.
//! - The method is local. Where the end requires an S-shape of large curvature, another start could reach a better
//!   optimum.
//! - [`Infeasibility::NotFound`] is no proof. [`Infeasibility::Certified`] and the reasons that follow from the data are
//!   proofs. Near the limit of feasibility a proof may take two hundred boxes, about a millisecond.
//! - Ends behind the vehicle are rejected, and lengths are limited to 0.25 to 3 chords: without a cost of length, bending
//!   energy alone prefers ever longer detours.

mod basis;
mod certificate;
#[cfg(test)]
mod reference;
mod scaled;
mod sequential;
mod subproblem;

use self::scaled::Scaled;
use self::sequential::Run;
use super::spiral::Spiral;
use super::{Pose, wrap_angle};

/// Condition on one quantity of the end, as a deviation from its target: m, rad or 1/m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EndCondition {
    /// The deviation is zero.
    Fixed,
    /// The deviation lies between these two values, both included.
    Range(f64, f64),
    /// No condition.
    Free,
    /// Penalised: weight · deviation² is added to the bending energy (1/m).
    Soft {
        /// Not negative. Unit: 1/m³ for a position, 1/(m·rad²) for the heading, m for the curvature.
        weight: f64,
    },
}

/// A boundary-value problem: a spiral from the origin with heading 0 to a target in that frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Problem {
    /// Curvature at the start, 1/m; always fixed.
    pub start_curvature: f64,
    /// Derivative of the curvature by arc length at the start, 1/m²; free if `None`.
    pub start_rate: Option<f64>,
    /// Target pose of the end. Its heading is wrapped to (−π, π].
    pub target: Pose,
    /// Target curvature of the end, 1/m.
    pub end_curvature: f64,
    /// Derivative of the curvature by arc length at the end, 1/m²; free if `None`.
    pub end_rate: Option<f64>,
    /// Condition on the position along the target's heading.
    pub longitudinal: EndCondition,
    /// Condition on the position to the left of the target's heading.
    pub lateral: EndCondition,
    /// Condition on the heading.
    pub heading: EndCondition,
    /// Condition on the curvature.
    pub curvature: EndCondition,
    /// Bound of |curvature|, 1/m; may be infinite.
    pub max_curvature: f64,
    /// Bound of |derivative of curvature by arc length|, 1/m²; may be infinite.
    pub max_curvature_rate: f64,
    /// Solves every convex program with Clarabel, even without active inequalities: slower, with the same result to the
    /// tolerance of the solver.
    pub always_convex: bool,
}

impl Problem {
    /// A problem with all end conditions fixed and no bounds.
    #[must_use]
    pub fn pinned(start_curvature: f64, target: Pose, end_curvature: f64) -> Self {
        Self {
            start_curvature,
            start_rate: None,
            target,
            end_curvature,
            end_rate: None,
            longitudinal: EndCondition::Fixed,
            lateral: EndCondition::Fixed,
            heading: EndCondition::Fixed,
            curvature: EndCondition::Fixed,
            max_curvature: f64::INFINITY,
            max_curvature_rate: f64::INFINITY,
            always_convex: false,
        }
    }

    /// The conditions: longitudinal, lateral, heading, curvature.
    fn conditions(&self) -> [EndCondition; 4] {
        [self.longitudinal, self.lateral, self.heading, self.curvature]
    }

    /// Solves for the cubic of least bending energy. With all conditions fixed there is at most one candidate, by
    /// Newton's method.
    #[must_use]
    pub fn cubic(&self) -> Solution<4> {
        self.solve()
    }

    /// Solves for the quintic of least bending energy.
    #[must_use]
    pub fn quintic(&self) -> Solution<6> {
        self.solve()
    }

    fn solve<const K: usize>(&self) -> Solution<K> {
        if let Err(reason) = self.check::<K>() {
            return Solution::none(Status::Infeasible(reason));
        }
        // wrap once, so that solver and report use the same heading even if an angle of many turns has lost its digits
        let target = Pose { yaw: wrap_angle(self.target.yaw), ..self.target };
        let problem = Self { target, ..*self };
        let outcome = Run::new(Scaled::<K>::new(&problem)).solve();
        problem.solution(&outcome)
    }

    /// Infeasibility that follows from the data alone.
    fn check<const K: usize>(&self) -> Result<(), Infeasibility> {
        let t = &self.target;
        let data = [t.position.x, t.position.y, t.yaw, self.start_curvature, self.end_curvature];
        let rates = [self.start_rate, self.end_rate];
        let bad_condition = |condition: EndCondition| match condition {
            EndCondition::Fixed | EndCondition::Free => false,
            EndCondition::Range(low, high) => !(low <= high && low < f64::INFINITY && high > f64::NEG_INFINITY),
            EndCondition::Soft { weight } => !(weight >= 0.0 && weight.is_finite()),
        };
        if !data.iter().chain(rates.iter().flatten()).all(|v| v.is_finite())
            || self.conditions().into_iter().any(bad_condition)
            || !(self.max_curvature >= 0.0 && self.max_curvature_rate >= 0.0)
        {
            return Err(Infeasibility::Invalid);
        }
        let chord = t.position.coords.norm();
        if chord < 1e-3 {
            return Err(Infeasibility::Coincident);
        }
        if self.longitudinal == EndCondition::Fixed && t.position.x < 0.0 && t.to_local(super::Point::origin()).x > 0.0
        {
            return Err(Infeasibility::Behind);
        }
        let fixed = self.conditions().into_iter().filter(|c| *c == EndCondition::Fixed).count();
        if fixed + rates.iter().flatten().count() > K {
            return Err(Infeasibility::Overdetermined);
        }
        let end_curvature_beyond =
            self.curvature == EndCondition::Fixed && self.end_curvature.abs() > self.max_curvature;
        if self.start_curvature.abs() > self.max_curvature
            || end_curvature_beyond
            || rates.iter().flatten().any(|r| r.abs() > self.max_curvature_rate)
        {
            return Err(Infeasibility::EndBeyondBound);
        }
        Ok(())
    }

    /// The outcome in the units of the problem, with residuals computed from the spiral itself.
    fn solution<const K: usize>(&self, outcome: &sequential::Outcome<K>) -> Solution<K> {
        let spiral = outcome.spiral;
        let end = spiral.end(&Pose::new(0.0, 0.0, 0.0));
        let off = end.position - self.target.position;
        let deviation = Deviation {
            longitudinal: off.dot(&self.target.forward()),
            lateral: off.dot(&self.target.left()),
            heading: end.yaw - wrap_angle(self.target.yaw),
            curvature: spiral.knots[K - 1] - self.end_curvature,
        };
        let missed = |condition: EndCondition, d: f64| match condition {
            EndCondition::Fixed => d,
            EndCondition::Range(low, high) => d - d.clamp(low, high),
            EndCondition::Free | EndCondition::Soft { .. } => 0.0,
        };
        Solution {
            status: outcome.status,
            spiral,
            method: outcome.method,
            iterations: outcome.iterations,
            programs: outcome.programs,
            deviation,
            residual: missed(self.longitudinal, deviation.longitudinal).hypot(missed(self.lateral, deviation.lateral)),
            heading_residual: missed(self.heading, deviation.heading).abs(),
            excess: (spiral.max_abs_curvature() - self.max_curvature).max(0.0),
            energy: spiral.bending_energy(),
        }
    }
}

/// The method that produced a solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Newton's method on a square system: the conditions left no freedom.
    Newton,
    /// Newton's method in the remaining degrees of freedom: no inequality was nearly active.
    ReducedNewton,
    /// Sequential convex programming with at least one program solved by Clarabel.
    Convex,
}

/// Outcome of a solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// A local optimum without an active bound of curvature or rate.
    Solved,
    /// A local optimum with an active bound of curvature or rate.
    BoundActive,
    /// No spiral, for this reason.
    Infeasible(Infeasibility),
    /// The iteration limit was reached; the spiral is the best iterate and may exceed the curvature bound by
    /// [`Solution::excess`].
    IterationLimit,
}

impl Status {
    /// Whether the spiral satisfies all conditions and bounds.
    #[must_use]
    pub fn is_solved(self) -> bool {
        matches!(self, Self::Solved | Self::BoundActive)
    }
}

/// Why there is no spiral.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Infeasibility {
    /// An input is not a finite number, a range is empty, or a weight or bound is negative.
    Invalid,
    /// Start and target are less than a millimetre apart.
    Coincident,
    /// The target lies behind the start: no forward path without a loop.
    Behind,
    /// More conditions are fixed than the spiral has unknowns.
    Overdetermined,
    /// A fixed curvature or rate exceeds its bound.
    EndBeyondBound,
    /// Proved, up to rounding and an included error of the quadrature: relaxations of the conditions contradict each
    /// other for every spiral of a permitted length. The spiral of the solution is the iterate at which the proof
    /// succeeded, or the start.
    Certified,
    /// No start led to a solution. The spiral is the best iterate; the residuals and the excess report its violations.
    NotFound,
}

/// Deviation of the end from its target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// Along the target's heading, m.
    pub longitudinal: f64,
    /// To the left of the target's heading, m.
    pub lateral: f64,
    /// Heading, rad.
    pub heading: f64,
    /// Curvature, 1/m.
    pub curvature: f64,
}

/// Result of a solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution<const KNOTS: usize> {
    /// Outcome.
    pub status: Status,
    /// The spiral; the best iterate if the problem is not solved ([`Status::is_solved`]). NaN for rejected problems.
    pub spiral: Spiral<KNOTS>,
    /// The method that produced the spiral.
    pub method: Method,
    /// Number of steps: convex programs and Newton steps.
    pub iterations: u32,
    /// Number of programs solved by Clarabel.
    pub programs: u32,
    /// Deviation of the end from its target.
    pub deviation: Deviation,
    /// Violation of the fixed and ranged positions, m.
    pub residual: f64,
    /// Violation of a fixed or ranged heading, rad.
    pub heading_residual: f64,
    /// Excess of |curvature| over its bound, 1/m; 0 if the bound holds.
    pub excess: f64,
    /// Bending energy, 1/m.
    pub energy: f64,
}

impl<const K: usize> Solution<K> {
    fn none(status: Status) -> Self {
        let nan = f64::NAN;
        Self {
            status,
            spiral: Spiral { knots: [nan; K], length: nan },
            method: Method::Newton,
            iterations: 0,
            programs: 0,
            deviation: Deviation { longitudinal: nan, lateral: nan, heading: nan, curvature: nan },
            residual: nan,
            heading_residual: nan,
            excess: nan,
            energy: nan,
        }
    }
}

#[cfg(test)]
mod tests;
