//! Convex quadratic programs with linear and second-order cone constraints, solved by Clarabel. No other module uses
//! the solver directly.
//!
//! # Problem
//!
//! With decision variables `x ∈ ℝⁿ`, every program of this crate has the form
//!
//! ```text
//! minimise    Σᵢ wᵢ (aᵢᵀx − tᵢ)² + ½ xᵀHx + cᵀx
//! subject to  bⱼᵀx = dⱼ                                            equalities
//!             lₖ ≤ gₖᵀx ≤ uₖ                                       inequalities
//!             ‖(e₁ᵀx + f₁, …, eₘᵀx + fₘ)‖₂ ≤ e₀ᵀx + f₀             second-order cones
//! ```
//!
//! with weights `wᵢ ≥ 0` and `H` such that the Hessian of the objective is positive semidefinite. Callers state it row
//! by row:
//!
//! | part | method |
//! |---|---|
//! | `wᵢ (aᵢᵀx − tᵢ)²` | [`QuadraticProgram::add_square`] |
//! | `H`, `c` | [`QuadraticProgram::add_hessian`], [`QuadraticProgram::add_linear`] |
//! | equalities, inequalities | [`QuadraticProgram::equal`], [`QuadraticProgram::between`] |
//! | second-order cones | [`QuadraticProgram::norm_at_most`] |
//!
//! # Technique and guarantee
//!
//! Clarabel (Goulart and Chen, *Clarabel: An interior-point solver for conic programs with quadratic objectives*, 2024)
//! is a primal–dual interior-point method on a homogeneous embedding. An infeasible or unbounded program ends with a
//! certificate. Results are deterministic: one thread, an iteration limit, no time limit, a fixed factorisation method.
//!
//! # Weakness
//!
//! The solver is sensitive to scaling. Choose units in which solution and weights are within a few orders of magnitude
//! of one. Callers must expect [`Status::Numerical`].

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus, SupportedConeT,
    ZeroConeT,
};

/// Limit of interior-point iterations. A well-posed program takes 6 to 20; beyond 60, more iterations rarely converge.
const MAX_ITERATIONS: u32 = 60;
/// Feasibility and duality-gap tolerance of [`Status::Solved`]: far below a millimetre in SI units. The regularisation
/// of the factorisation (1e-8) prevents smaller values.
const TOLERANCE: f64 = 1e-8;
/// Tolerance of [`Status::AlmostSolved`].
const REDUCED_TOLERANCE: f64 = 1e-5;

/// Tolerance of [`Tuning::Small`], reachable without iterative refinement.
const SMALL_TOLERANCE: f64 = 1e-7;

/// A term of a linear expression: index of the variable and factor. Terms of the same variable add up.
pub type Term = (usize, f64);

/// An affine expression: Σ terms + constant.
pub type Affine<'a> = (&'a [Term], f64);

/// Termination status of a solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Solved to the tolerance of the [`Tuning`], 1e-8 or 1e-7.
    Solved,
    /// Solved to 1e-5: sufficient for callers that verify the result.
    AlmostSolved,
    /// Infeasible, with a certificate.
    Infeasible,
    /// Unbounded below, with a certificate.
    Unbounded,
    /// The solver reached the iteration limit.
    IterationLimit,
    /// Numerical failure, data that are not finite, or a program without variables.
    Numerical,
}

/// Result of a solve.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Termination status.
    pub status: Status,
    /// Values of the variables. Meaningful if [`Solution::is_usable`].
    pub x: Vec<f64>,
    /// Value of the objective, including constants.
    pub objective: f64,
    /// Lagrange multipliers of the equalities, then of the inequalities (non-negative), then of the cones (each in its
    /// cone, bound first), in the order of statement. At an optimum, the gradient of the objective plus Σ multiplier ·
    /// `row` is zero, with each constraint written as `row·x ≤ …`. Meaningful if [`Solution::is_usable`].
    pub multipliers: Vec<f64>,
    /// Number of interior-point iterations.
    pub iterations: u32,
}

/// Solver settings for a class of programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Tuning {
    /// Any program: with equilibration and iterative refinement, to 1e-8.
    #[default]
    General,
    /// A small, well-scaled program: without equilibration, presolve and iterative refinement, to 1e-7. It takes about
    /// two thirds of the time.
    Small,
}

impl Solution {
    /// Whether `x` is feasible and optimal, at least to the tolerance of [`Status::AlmostSolved`].
    #[must_use]
    pub fn is_usable(&self) -> bool {
        matches!(self.status, Status::Solved | Status::AlmostSolved)
    }
}

/// A program under construction. The module documentation states its form.
#[derive(Debug, Clone)]
pub struct QuadraticProgram {
    linear: Vec<f64>,
    constant: f64,
    /// Upper triangle of the Hessian. Duplicates add up.
    hessian: Triplets,
    equalities: Rows,
    inequalities: Rows,
    cones: Rows,
    cone_sizes: Vec<usize>,
}

/// Rows of `A x + s = b`.
#[derive(Debug, Clone, Default)]
struct Rows {
    entries: Triplets,
    right: Vec<f64>,
}

impl Rows {
    /// Appends the row `factor · terms·x + s = right`.
    fn push(&mut self, terms: &[Term], factor: f64, right: f64) {
        let row = self.right.len();
        self.entries.extend(terms.iter().map(|&(column, value)| (row, column, factor * value)));
        self.right.push(right);
    }
}

/// (row, column, value).
type Triplets = Vec<(usize, usize, f64)>;

impl QuadraticProgram {
    /// An unconstrained program with a number of variables and a zero objective.
    #[must_use]
    pub fn new(variables: usize) -> Self {
        Self {
            linear: vec![0.0; variables],
            constant: 0.0,
            hessian: Vec::new(),
            equalities: Rows::default(),
            inequalities: Rows::default(),
            cones: Rows::default(),
            cone_sizes: Vec::new(),
        }
    }

    /// Number of variables.
    #[must_use]
    pub fn variables(&self) -> usize {
        self.linear.len()
    }

    /// Adds a variable and returns its index.
    pub fn add_variable(&mut self) -> usize {
        self.linear.push(0.0);
        self.linear.len() - 1
    }

    /// Adds `weight · (terms·x − target)²` to the objective; `weight` ≥ 0.
    pub fn add_square(&mut self, weight: f64, terms: &[Term], target: f64) {
        for (n, &(i, a)) in terms.iter().enumerate() {
            self.linear[i] -= 2.0 * weight * target * a;
            self.add_hessian(i, i, 2.0 * weight * a * a);
            for &(j, b) in &terms[n + 1..] {
                // the cross term of a repeated variable lies on the diagonal, which belongs to both triangles
                let twice = if i == j { 2.0 } else { 1.0 };
                self.add_hessian(i, j, twice * 2.0 * weight * a * b);
            }
        }
        self.constant += weight * target * target;
    }

    /// Adds `value · x_i x_j` for i ≠ j or `½ value · x_i²` for i = j to the objective. The whole Hessian must be
    /// positive semidefinite.
    pub fn add_hessian(&mut self, i: usize, j: usize, value: f64) {
        self.hessian.push((i.min(j), i.max(j), value));
    }

    /// Adds `factor · x_i` to the objective.
    pub fn add_linear(&mut self, i: usize, factor: f64) {
        self.linear[i] += factor;
    }

    /// Requires `terms·x = value`.
    pub fn equal(&mut self, terms: &[Term], value: f64) {
        self.equalities.push(terms, 1.0, value);
    }

    /// Requires `lower ≤ terms·x ≤ upper`. An infinite bound adds no row; equal bounds add an equality.
    pub fn between(&mut self, lower: f64, terms: &[Term], upper: f64) {
        if lower == upper {
            return self.equal(terms, lower);
        }
        if upper != f64::INFINITY {
            self.inequalities.push(terms, 1.0, upper);
        }
        if lower != f64::NEG_INFINITY {
            self.inequalities.push(terms, -1.0, -lower);
        }
    }

    /// Requires the Euclidean norm of `inner` to be at most `bound`.
    pub fn norm_at_most(&mut self, inner: &[Affine<'_>], bound: Affine<'_>) {
        for (terms, constant) in std::iter::once(&bound).chain(inner) {
            self.cones.push(terms, -1.0, *constant);
        }
        self.cone_sizes.push(inner.len() + 1);
    }

    /// Solves the program.
    #[must_use]
    pub fn solve(&self) -> Solution {
        self.solve_tuned(Tuning::General)
    }

    /// Solves the program with a tuning.
    #[must_use]
    pub fn solve_tuned(&self, tuning: Tuning) -> Solution {
        let variables = self.variables();
        let failed = |status| Solution {
            status,
            x: vec![0.0; variables],
            objective: f64::NAN,
            multipliers: Vec::new(),
            iterations: 0,
        };
        let parts = [&self.equalities, &self.inequalities, &self.cones];
        let mut entries = Triplets::with_capacity(parts.iter().map(|p| p.entries.len()).sum());
        let mut right = Vec::with_capacity(parts.iter().map(|p| p.right.len()).sum());
        for part in parts {
            let first = right.len();
            entries.extend(part.entries.iter().map(|&(row, column, value)| (first + row, column, value)));
            right.extend_from_slice(&part.right);
        }
        // the solver panics on an empty matrix
        if variables == 0 {
            return failed(Status::Numerical);
        }
        let finite = |values: &[f64]| values.iter().all(|v| v.is_finite());
        if !finite(&right)
            || !finite(&self.linear)
            || !self.hessian.iter().chain(&entries).all(|(_, _, value)| value.is_finite())
        {
            return failed(Status::Numerical);
        }
        let mut cones: Vec<SupportedConeT<f64>> =
            vec![ZeroConeT(self.equalities.right.len()), NonnegativeConeT(self.inequalities.right.len())];
        cones.extend(self.cone_sizes.iter().map(|size| SecondOrderConeT(*size)));
        let hessian = compressed(variables, variables, &self.hessian);
        let constraints = compressed(right.len(), variables, &entries);
        let Ok(mut solver) = DefaultSolver::new(&hessian, &self.linear, &constraints, &right, &cones, settings(tuning))
        else {
            return failed(Status::Numerical);
        };
        solver.solve();
        let solution = &solver.solution;
        Solution {
            status: status(solution.status),
            x: solution.x.clone(),
            objective: solution.obj_val + self.constant,
            multipliers: solution.z.clone(),
            iterations: solution.iterations,
        }
    }
}

/// The solver's settings.
fn settings(tuning: Tuning) -> DefaultSettings<f64> {
    let general = DefaultSettings {
        verbose: false,
        max_iter: MAX_ITERATIONS,
        time_limit: f64::INFINITY,
        tol_gap_abs: TOLERANCE,
        tol_gap_rel: TOLERANCE,
        tol_feas: TOLERANCE,
        reduced_tol_gap_abs: REDUCED_TOLERANCE,
        reduced_tol_gap_rel: REDUCED_TOLERANCE,
        reduced_tol_feas: REDUCED_TOLERANCE,
        max_threads: 1,
        direct_solve_method: "qdldl".to_owned(),
        ..DefaultSettings::default()
    };
    match tuning {
        Tuning::General => general,
        Tuning::Small => DefaultSettings {
            equilibrate_enable: false,
            iterative_refinement_enable: false,
            presolve_enable: false,
            tol_gap_abs: SMALL_TOLERANCE,
            tol_gap_rel: SMALL_TOLERANCE,
            tol_feas: SMALL_TOLERANCE,
            ..general
        },
    }
}

fn status(status: SolverStatus) -> Status {
    match status {
        SolverStatus::Solved => Status::Solved,
        SolverStatus::AlmostSolved => Status::AlmostSolved,
        SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => Status::Infeasible,
        SolverStatus::DualInfeasible | SolverStatus::AlmostDualInfeasible => Status::Unbounded,
        SolverStatus::MaxIterations | SolverStatus::MaxTime => Status::IterationLimit,
        _ => Status::Numerical,
    }
}

/// Compressed sparse columns from triplets; duplicates add up. Two stable counting sorts: by row, then by column.
fn compressed(rows: usize, columns: usize, triplets: &[(usize, usize, f64)]) -> CscMatrix<f64> {
    let by_row = counting_sort(triplets, rows, |t| t.0);
    let by_column = counting_sort(&by_row, columns, |t| t.1);
    let mut column_starts = Vec::with_capacity(columns + 1);
    let mut row_indices: Vec<usize> = Vec::with_capacity(by_column.len());
    let mut values: Vec<f64> = Vec::with_capacity(by_column.len());
    column_starts.push(0);
    let mut remaining = by_column.iter().peekable();
    for column in 0..columns {
        let start = row_indices.len();
        while let Some(&&(row, _, value)) = remaining.peek().filter(|t| t.1 == column) {
            remaining.next();
            if row_indices.len() > start && row_indices.last() == Some(&row) {
                if let Some(last) = values.last_mut() {
                    *last += value;
                }
            } else {
                row_indices.push(row);
                values.push(value);
            }
        }
        column_starts.push(row_indices.len());
    }
    CscMatrix::new(rows, columns, column_starts, row_indices, values)
}

fn counting_sort<T: Copy>(items: &[T], keys: usize, key: impl Fn(&T) -> usize) -> Vec<T> {
    let mut next = vec![0_usize; keys + 1];
    for item in items {
        next[key(item) + 1] += 1;
    }
    for k in 0..keys {
        next[k + 1] += next[k];
    }
    let mut sorted = items.to_vec();
    for item in items {
        let slot = &mut next[key(item)];
        sorted[*slot] = *item;
        *slot += 1;
    }
    sorted
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-6
    }

    /// The point nearest to (3, 2) with x + y = 1 and lower ≤ y ≤ upper: (1, 0) if the bounds are inactive.
    fn nearest(lower: f64, upper: f64) -> Solution {
        let mut program = QuadraticProgram::new(2);
        program.add_square(1.0, &[(0, 1.0)], 3.0);
        program.add_square(1.0, &[(1, 1.0)], 2.0);
        program.equal(&[(0, 1.0), (1, 1.0)], 1.0);
        program.between(lower, &[(1, 1.0)], upper);
        program.solve()
    }

    #[test]
    fn finds_the_known_optimum_with_inactive_active_and_equal_bounds() {
        let free = nearest(f64::NEG_INFINITY, f64::INFINITY);
        assert_eq!(free.status, Status::Solved);
        assert!(near(free.x[0], 1.0) && near(free.x[1], 0.0) && near(free.objective, 8.0), "{free:?}");
        let bound = nearest(0.5, 2.0);
        assert!(near(bound.x[0], 0.5) && near(bound.x[1], 0.5), "{bound:?}");
        let pinned = nearest(0.25, 0.25);
        assert!(near(pinned.x[1], 0.25), "equal bounds are an equality: {pinned:?}");
    }

    #[test]
    fn reports_an_infeasible_program() {
        assert_eq!(nearest(2.0, 1.0).status, Status::Infeasible);
        let mut program = QuadraticProgram::new(1);
        program.equal(&[(0, 1.0)], 1.0);
        program.equal(&[(0, 1.0)], 2.0);
        assert_eq!(program.solve().status, Status::Infeasible);
    }

    #[test]
    fn reports_an_unbounded_program() {
        let mut program = QuadraticProgram::new(1);
        program.add_linear(0, 1.0);
        program.between(f64::NEG_INFINITY, &[(0, 1.0)], 0.0);
        assert_eq!(program.solve().status, Status::Unbounded);
    }

    #[test]
    fn reports_data_that_are_not_finite() {
        for bad in [f64::NAN, f64::INFINITY] {
            let mut program = QuadraticProgram::new(1);
            program.add_square(1.0, &[(0, bad)], 0.0);
            assert_eq!(program.solve().status, Status::Numerical);
        }
        assert_eq!(nearest(f64::NAN, 1.0).status, Status::Numerical);
    }

    #[test]
    fn cone_bounds_the_norm() {
        // farthest point in direction (3, 4) in the circle of radius 2 about (1, 0)
        let mut program = QuadraticProgram::new(2);
        program.add_linear(0, -3.0);
        program.add_linear(1, -4.0);
        program.norm_at_most(&[(&[(0, 1.0)], -1.0), (&[(1, 1.0)], 0.0)], (&[], 2.0));
        let solution = program.solve();
        assert!(near(solution.x[0], 1.0 + 1.2) && near(solution.x[1], 1.6), "{solution:?}");
    }

    #[test]
    fn multipliers_balance_the_gradient_in_the_order_stated() {
        // point nearest to (3, 2) with x ≤ 1 and ‖(x, y)‖ ≤ √2
        for tuning in [Tuning::General, Tuning::Small] {
            let mut program = QuadraticProgram::new(2);
            program.add_square(1.0, &[(0, 1.0)], 3.0);
            program.add_square(1.0, &[(1, 1.0)], 2.0);
            program.norm_at_most(&[(&[(0, 1.0)], 0.0), (&[(1, 1.0)], 0.0)], (&[], 2.0_f64.sqrt()));
            program.between(f64::NEG_INFINITY, &[(0, 1.0)], 1.0);
            let solution = program.solve_tuned(tuning);
            assert!(solution.is_usable() && near(solution.x[0], 1.0) && near(solution.x[1], 1.0), "{solution:?}");
            let [row, bound, x, y] = solution.multipliers[..] else { panic!("{solution:?}") };
            // stationarity: gradient (−4, −2) + row·(1, 0) − (x, y) = 0 with the multipliers (bound, x, y) of the cone
            assert!((row - 4.0 - x).abs() < 1e-4 && (-2.0 - y).abs() < 1e-4, "{solution:?}");
            assert!(row >= 0.0 && bound > 0.0);
        }
    }

    #[test]
    fn terms_of_a_repeated_variable_add_up() {
        let mut program = QuadraticProgram::new(1);
        program.add_square(1.0, &[(0, 1.0), (0, 2.0)], 6.0);
        let solution = program.solve();
        assert!(near(solution.x[0], 2.0), "{solution:?}");
        assert!(near(solution.objective, 0.0));
    }

    #[test]
    fn solves_a_program_without_constraints_and_reports_one_without_variables() {
        assert_eq!(QuadraticProgram::new(0).solve().status, Status::Numerical);
        let mut program = QuadraticProgram::new(1);
        program.add_square(1.0, &[(0, 1.0)], 4.0);
        assert!(near(program.solve().x[0], 4.0));
    }

    proptest! {
        #[test]
        fn compressed_matrix_is_the_sum_of_the_triplets(
            triplets in prop::collection::vec((0..5usize, 0..4usize, -1.0..1.0f64), 0..40)
        ) {
            let matrix = compressed(5, 4, &triplets);
            prop_assert!(matrix.check_format().is_ok());
            let mut dense = [[0.0; 4]; 5];
            for (row, column, value) in &triplets {
                dense[*row][*column] += value;
            }
            for (row, values) in dense.iter().enumerate() {
                for (column, value) in values.iter().enumerate() {
                    prop_assert!((matrix.get_entry((row, column)).unwrap_or(0.0) - value).abs() < 1e-12);
                }
            }
        }

        /// With inactive constraints, the optimum of a least-squares program has a zero gradient.
        #[test]
        fn gradient_vanishes_at_the_optimum(rows in prop::collection::vec((prop::array::uniform3(-1.0..1.0f64), -2.0..2.0f64), 4..9)) {
            let mut program = QuadraticProgram::new(3);
            for (a, target) in &rows {
                program.add_square(1.0, &[(0, a[0]), (1, a[1]), (2, a[2])], *target);
            }
            for i in 0..3 {
                program.add_square(0.1, &[(i, 1.0)], 0.0);
                program.between(-100.0, &[(i, 1.0)], 100.0);
            }
            let solution = program.solve();
            prop_assert_eq!(solution.status, Status::Solved);
            let x = &solution.x;
            for i in 0..3 {
                let gradient: f64 = rows.iter()
                    .map(|(a, t)| 2.0 * a[i] * (a[0] * x[0] + a[1] * x[1] + a[2] * x[2] - t)).sum::<f64>() + 0.2 * x[i];
                prop_assert!(gradient.abs() < 1e-5, "gradient {gradient:e}");
            }
        }
    }

    /// A program of the size of the speed smoothing: 60 steps of (station, speed, acceleration).
    #[test]
    fn repeated_solves_have_equal_results() {
        let steps = 60;
        let (h, at) = (0.1, |step: usize, part: usize| 3 * step + part);
        let mut program = QuadraticProgram::new(3 * steps);
        program.equal(&[(at(0, 0), 1.0)], 0.0);
        program.equal(&[(at(0, 1), 1.0)], 10.0);
        for k in 0..steps {
            program.add_square(1.0, &[(at(k, 1), 1.0)], 12.0);
            program.between(-3.0, &[(at(k, 2), 1.0)], 2.0);
            program.between(0.0, &[(at(k, 1), 1.0)], 11.5);
            program.between(f64::NEG_INFINITY, &[(at(k, 0), 1.0)], 40.0);
            if k + 1 < steps {
                program.add_square(10.0, &[(at(k + 1, 2), 1.0), (at(k, 2), -1.0)], 0.0);
                program.equal(&[(at(k + 1, 1), 1.0), (at(k, 1), -1.0), (at(k, 2), -h)], 0.0);
                program.equal(&[(at(k + 1, 0), 1.0), (at(k, 0), -1.0), (at(k, 1), -h), (at(k, 2), -0.5 * h * h)], 0.0);
            }
        }
        let first = program.solve();
        assert_eq!(first.status, Status::Solved);
        assert!(first.x[at(steps - 1, 0)] <= 40.0 + 1e-6);
        assert_eq!(first, program.solve());
        let start = std::time::Instant::now();
        for _ in 0..20 {
            let _ = program.solve();
        }
        println!("{} iterations, {:?} each", first.iterations, start.elapsed() / 20);
    }
}
