//! The least bent polynomial spiral under end conditions, a curvature bound and a bound of the curvature's rate.
//!
//! ```text
//! minimise    ∫ κ² ds + Σ wᵢ dᵢ²                 over the knots and the length
//! subject to  dᵢ = 0, or lowᵢ ≤ dᵢ ≤ highᵢ, or free   for the deviations d of the end from its target:
//!                                                along and across (in the target's frame), heading, curvature
//!             |κ(u)| ≤ κ_max,  |dκ/ds(u)| ≤ rate_max   for all u in [0, 1]
//! ```
//!
//! A [`Problem`] is solved by [`Problem::cubic`] or [`Problem::quintic`]. The [`Solution`] says how it ended, by which
//! method, and how well the conditions are met.
//!
//! # Technique
//!
//! - **Square problems** (a cubic with everything pinned) have nothing to optimise: Newton's method.
//! - Otherwise a **feasible sequential convex program**: every iterate is put back onto the end conditions by a least-norm
//!   Newton step, so the convex program only has the one to four quantities left free as variables, with the exact
//!   Hessian of the Lagrangian (second moments of the quadrature, no differences). Two to four programs are usual.
//!   Globalised by the ℓ1 penalty of the bounds as merit and a trust region (Fletcher's Sℓ₁QP; Nocedal & Wright, 18.5).
//! - A program in which no inequality bites is a linear system, and solved as such ([`Method::ReducedNewton`]); otherwise
//!   Clarabel solves it ([`Method::Convex`]). [`Problem::always_convex`] asks for Clarabel every time.
//! - **Bounds of cubics** are exact convex constraints: a cubic is non-negative on [0, 1] if and only if it is
//!   u·σ₁ + (1−u)·σ₂ with sums of squares σ of degree two, a quadratic if and only if it is σ + γ u(1−u) with γ ≥ 0
//!   (Markov–Lukács; Szegő, Orthogonal Polynomials, 1.21.1), and σ = a + 2bu + cu² is a three-dimensional second-order
//!   cone ‖(2b, a − c)‖ ≤ a + c. The equalities are eliminated by hand: two variables and two cones for each side of the
//!   curvature, one variable and one cone for each side of its rate, and only for sides that come near. The first steps,
//!   which are long, use cuts at the extrema instead: what the cones know exactly is lost in the linearised ends there.
//! - **Bounds of quintics** would need 3×3 semidefinite cones. Instead: linear cuts at the extrema, found exactly and
//!   re-placed in each iteration, with the second derivative of the extremum's value (its place moves) in the Hessian:
//!   that converges like Newton's method, and with fewer variables; the result is checked at the exact extrema all the
//!   same. Where a quintic finds nothing from its own start, it starts again from the cubic that solves the problem.
//! - **Quintics start** from the cubic root, less what a quintic need not bend: to first order in the heading that is a
//!   closed form, and mostly one program is left to solve.
//! - **Proof that nothing fits**: branch and bound over linear relaxations of the whole problem, position included (see
//!   `certificate`). Of pinned quintics whose start is far out of bounds it comes first, so that the many problems which
//!   have no solution do not cost a search.
//!
//! # What is promised
//!
//! With [`Status::Solved`] or [`Status::BoundActive`]: fixed conditions and ranges hold to 1e-9 m and rad, curvature and
//! rate are within their bounds everywhere (programs aim 1e-6 below them; where an end is pinned closer than that to the
//! bound, they hold to 1e-9 of it), and the spiral is a local optimum, to 1e-4 of the objective. Same problem, same bits;
//! a mirrored problem has the mirrored solution to the bit.
//!
//! Weak: quintics with a soft end under a bound that bites take ten to twenty steps. It is a local method; another start
//! could find a better optimum where the end needs an S-shape of large curvature. [`Infeasibility::NotFound`] is no proof.
//! Only [`Infeasibility::Certified`] and the reasons seen from the data are; a proof may take two hundred boxes, a
//! millisecond, where the end is only just out of reach.
//! Ends behind the vehicle are refused, and lengths are kept between a quarter and three times the chord: without a price
//! on length, bending energy alone prefers ever longer detours.

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

/// What is asked of one quantity of the end, as a deviation from its target: metres, radians or 1/m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EndCondition {
    /// On the target.
    Fixed,
    /// The deviation lies between these two.
    Range(f64, f64),
    /// Anywhere.
    Free,
    /// Anywhere, for a price: weight · deviation² is added to the bending energy (1/m).
    Soft {
        /// In 1/m³ for a position, 1/(m·rad²) for the heading, m for the curvature.
        weight: f64,
    },
}

/// A boundary-value problem: from the origin with heading 0 to a target in that frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Problem {
    /// Curvature at the start, 1/m: always held.
    pub start_curvature: f64,
    /// Derivative of the curvature by arc length at the start, 1/m²; free if `None`.
    pub start_rate: Option<f64>,
    /// The pose wanted at the end. Heading is taken in (−π, π].
    pub target: Pose,
    /// The curvature wanted at the end, 1/m.
    pub end_curvature: f64,
    /// Derivative of the curvature by arc length at the end, 1/m²; free if `None`.
    pub end_rate: Option<f64>,
    /// Position along the target's heading.
    pub along: EndCondition,
    /// Position across it, to the left.
    pub across: EndCondition,
    /// Heading.
    pub heading: EndCondition,
    /// Curvature.
    pub curvature: EndCondition,
    /// Bound of |curvature|, 1/m; may be infinite.
    pub max_curvature: f64,
    /// Bound of |derivative of curvature by arc length|, 1/m²; may be infinite.
    pub max_curvature_rate: f64,
    /// Solves every convex program with Clarabel, even if none of its inequalities bites: slower, the same answer.
    pub always_convex: bool,
}

impl Problem {
    /// Everything fixed at the end, nothing bounded.
    #[must_use]
    pub fn pinned(start_curvature: f64, target: Pose, end_curvature: f64) -> Self {
        Self {
            start_curvature,
            start_rate: None,
            target,
            end_curvature,
            end_rate: None,
            along: EndCondition::Fixed,
            across: EndCondition::Fixed,
            heading: EndCondition::Fixed,
            curvature: EndCondition::Fixed,
            max_curvature: f64::INFINITY,
            max_curvature_rate: f64::INFINITY,
            always_convex: false,
        }
    }

    /// The conditions: along, across, heading, curvature.
    fn conditions(&self) -> [EndCondition; 4] {
        [self.along, self.across, self.heading, self.curvature]
    }

    /// The least bent cubic. With everything fixed there is one candidate at most, by Newton's method.
    #[must_use]
    pub fn cubic(&self) -> Solution<4> {
        self.solve()
    }

    /// The least bent quintic.
    #[must_use]
    pub fn quintic(&self) -> Solution<6> {
        self.solve()
    }

    fn solve<const K: usize>(&self) -> Solution<K> {
        if let Err(reason) = self.refused::<K>() {
            return Solution::none(Status::Infeasible(reason));
        }
        // directions of the one heading that is meant, also where an angle of many turns has lost its digits
        let target = Pose { yaw: wrap_angle(self.target.yaw), ..self.target };
        let problem = Self { target, ..*self };
        let outcome = Run::new(Scaled::<K>::new(&problem)).solve();
        problem.solution(&outcome)
    }

    /// Reasons that can be seen without solving anything.
    fn refused<const K: usize>(&self) -> Result<(), Infeasibility> {
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
        if self.along == EndCondition::Fixed && t.position.x < 0.0 && t.to_local(super::Point::origin()).x > 0.0 {
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

    /// The outcome in the problem's own units, measured anew.
    fn solution<const K: usize>(&self, outcome: &sequential::Outcome<K>) -> Solution<K> {
        let spiral = outcome.spiral;
        let end = spiral.end(&Pose::new(0.0, 0.0, 0.0));
        let off = end.position - self.target.position;
        let deviation = Deviation {
            along: off.dot(&self.target.forward()),
            across: off.dot(&self.target.left()),
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
            residual: missed(self.along, deviation.along).hypot(missed(self.across, deviation.across)),
            heading_residual: missed(self.heading, deviation.heading).abs(),
            excess: (spiral.max_abs_curvature() - self.max_curvature).max(0.0),
            energy: spiral.bending_energy(),
        }
    }
}

/// How a spiral was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Newton's method on a square system: nothing was left to optimise.
    Newton,
    /// Newton's method on what the end conditions leave free: no inequality came near.
    ReducedNewton,
    /// Sequential convex programs, at least one of them solved by Clarabel.
    Convex,
}

/// How the solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// A local optimum that no bound of curvature or rate holds back.
    Solved,
    /// A local optimum at a bound of curvature or rate.
    BoundActive,
    /// No spiral, for this reason.
    Infeasible(Infeasibility),
    /// The iteration limit came first; the spiral is the best so far and may break a bound by its
    /// [`Solution::excess`].
    IterationLimit,
}

impl Status {
    /// Whether the spiral meets all conditions and bounds.
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
    /// More is fixed than the spiral has unknowns.
    Overdetermined,
    /// A pinned curvature or rate is beyond its bound.
    EndBeyondBound,
    /// Proven, to rounding and to the error of a quadrature that is allowed for: relaxations of the conditions contradict
    /// each other wherever a spiral of a permitted length could be. The spiral is where the search stood when the proof was
    /// found: its start, if that came first.
    Certified,
    /// None was found from any start. The spiral is the best one; what it misses is in the residuals and the excess.
    NotFound,
}

/// The end's deviation from its target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// Along the target's heading, m.
    pub along: f64,
    /// To the left of it, m.
    pub across: f64,
    /// rad.
    pub heading: f64,
    /// 1/m.
    pub curvature: f64,
}

/// What a solve returned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution<const KNOTS: usize> {
    /// How it ended.
    pub status: Status,
    /// The spiral; if the status is not [`Status::is_solved`], the best that was seen. NaN for refused problems.
    pub spiral: Spiral<KNOTS>,
    /// How it was found.
    pub method: Method,
    /// Steps: convex programs, reduced or square Newton steps.
    pub iterations: u32,
    /// Programs solved by Clarabel.
    pub programs: u32,
    /// Where the end lies.
    pub deviation: Deviation,
    /// By how much the fixed and ranged positions are missed, m.
    pub residual: f64,
    /// By how much a fixed or ranged heading is missed, rad.
    pub heading_residual: f64,
    /// By how much |curvature| exceeds its bound, 1/m; 0 if it holds.
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
            deviation: Deviation { along: nan, across: nan, heading: nan, curvature: nan },
            residual: nan,
            heading_residual: nan,
            excess: nan,
            energy: nan,
        }
    }
}

#[cfg(test)]
mod tests;
