//! Convex programs: the one place that knows the Clarabel interior-point solver.
//!
//! Every program of this crate has the form
//!
//! ```text
//! minimise    Σ wᵢ (aᵢᵀx − tᵢ)² + cᵀx
//! subject to  bⱼᵀx = dⱼ
//!             lₖ ≤ gₖᵀx ≤ uₖ
//!             ‖(e₁ᵀx + f₁, …, eₙᵀx + fₙ)‖ ≤ e₀ᵀx + f₀      (second-order cones)
//! ```
//!
//! and is stated row by row to a [`QuadraticProgram`]. Clarabel (Goulart & Chen 2024) solves the homogeneous embedding,
//! so that an infeasible program ends with a certificate and not with a time limit.
//!
//! Deterministic: one thread, a limit of iterations and none of time, a fixed factorisation method. Weak on badly scaled
//! data: choose units so that the solution and the weights are within a few orders of magnitude of one. A status of
//! [`Status::Numerical`] is an outcome that callers must expect.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus, SupportedConeT,
    ZeroConeT,
};

/// Interior-point iterations. A well-posed program takes 6 to 20; more means trouble that further ones do not cure.
const MAX_ITERATIONS: u32 = 60;
/// Feasibility and duality-gap tolerance of [`Status::Solved`]: far below a millimetre in our units, and well above
/// where the factorisation's regularisation (1e-8) starts to stall.
const TOLERANCE: f64 = 1e-8;
/// The looser tolerance that still counts as [`Status::AlmostSolved`].
const REDUCED_TOLERANCE: f64 = 1e-5;

/// The tolerance of [`Tuning::Small`]: what is reached without refinement.
const SMALL_TOLERANCE: f64 = 1e-7;

/// A coefficient of a linear expression: variable and factor. A variable may occur more than once.
pub type Term = (usize, f64);

/// An affine expression: Σ terms + constant.
pub type Affine<'a> = (&'a [Term], f64);

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Solved to 1e-8.
    Solved,
    /// Solved to 1e-5: feasible and optimal enough for uses that check the result.
    AlmostSolved,
    /// No point satisfies the constraints (certified).
    Infeasible,
    /// The objective falls without end (certified).
    Unbounded,
    /// Iteration limit reached.
    IterationLimit,
    /// Numerical trouble, data that are not finite, or no variables at all.
    Numerical,
}

/// What a solve returned.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// How it ended.
    pub status: Status,
    /// Values of the variables; meaningful if [`Solution::is_usable`].
    pub x: Vec<f64>,
    /// Value of the objective, constants included.
    pub objective: f64,
    /// Multipliers: of the equalities, then of the inequalities (not negative), then of the cones (each in its own cone,
    /// bound first), in the order they were stated. At an optimum, gradient of the objective + Σ multiplier · (row of
    /// the constraint as `row·x ≤ …`) = 0. Meaningful if [`Solution::is_usable`].
    pub multipliers: Vec<f64>,
    /// Interior-point iterations used.
    pub iterations: u32,
}

/// What a solve is tuned to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Tuning {
    /// Any program: scaled and refined by the solver, to 1e-8.
    #[default]
    General,
    /// A program of a few well-scaled variables: without the solver's own scaling and iterative refinement, to 1e-7.
    /// About two thirds of the time.
    Small,
}

impl Solution {
    /// Whether `x` satisfies the constraints and is optimal, at least to the looser tolerance.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        matches!(self.status, Status::Solved | Status::AlmostSolved)
    }
}

/// A program under construction. See the module's head for its form.
#[derive(Debug, Clone)]
pub struct QuadraticProgram {
    linear: Vec<f64>,
    constant: f64,
    /// Upper triangle of the Hessian, duplicates add up.
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
    /// Appends `factor · terms · x + s = right`.
    fn push(&mut self, terms: &[Term], factor: f64, right: f64) {
        let row = self.right.len();
        self.entries.extend(terms.iter().map(|&(column, value)| (row, column, factor * value)));
        self.right.push(right);
    }
}

/// (row, column, value).
type Triplets = Vec<(usize, usize, f64)>;

impl QuadraticProgram {
    /// A program of so many variables, unconstrained, with a zero objective.
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
                // a variable that occurs twice has its cross term on the diagonal, where both triangles meet
                let twice = if i == j { 2.0 } else { 1.0 };
                self.add_hessian(i, j, twice * 2.0 * weight * a * b);
            }
        }
        self.constant += weight * target * target;
    }

    /// Adds `½ (x_i H x_j + x_j H x_i)` for i ≠ j, `½ H x_i²` for i = j. The Hessian must be positive semidefinite in all.
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

    /// Requires `lower ≤ terms·x ≤ upper`. An infinite bound is no bound; equal bounds are an equality.
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
        // the solver's factorisation indexes its first column
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

/// Compressed columns from triplets, duplicates added: two stable counting sorts, by row, then by column.
fn compressed(rows: usize, columns: usize, triplets: &[(usize, usize, f64)]) -> CscMatrix<f64> {
    let by_row = counting_sort(triplets, rows, |t| t.0);
    let by_column = counting_sort(&by_row, columns, |t| t.1);
    let mut column_starts = Vec::with_capacity(columns + 1);
    let mut row_indices: Vec<usize> = Vec::with_capacity(by_column.len());
    let mut values: Vec<f64> = Vec::with_capacity(by_column.len());
    column_starts.push(0);
    let mut rest = by_column.iter().peekable();
    for column in 0..columns {
        let start = row_indices.len();
        while let Some(&&(row, _, value)) = rest.peek().filter(|t| t.1 == column) {
            rest.next();
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

    /// Nearest point to (3, 2) with x + y = 1 and y ≥ `floor`: (1, 0) where the floor does not bite.
    fn nearest(floor: f64, ceiling: f64) -> Solution {
        let mut program = QuadraticProgram::new(2);
        program.add_square(1.0, &[(0, 1.0)], 3.0);
        program.add_square(1.0, &[(1, 1.0)], 2.0);
        program.equal(&[(0, 1.0), (1, 1.0)], 1.0);
        program.between(floor, &[(1, 1.0)], ceiling);
        program.solve()
    }

    #[test]
    fn known_optimum_with_and_without_the_bound_biting() {
        let free = nearest(f64::NEG_INFINITY, f64::INFINITY);
        assert_eq!(free.status, Status::Solved);
        assert!(near(free.x[0], 1.0) && near(free.x[1], 0.0) && near(free.objective, 8.0), "{free:?}");
        let bound = nearest(0.5, 2.0);
        assert!(near(bound.x[0], 0.5) && near(bound.x[1], 0.5), "{bound:?}");
        let pinned = nearest(0.25, 0.25);
        assert!(near(pinned.x[1], 0.25), "equal bounds are an equality: {pinned:?}");
    }

    #[test]
    fn the_infeasible_twin_is_told_as_infeasible() {
        assert_eq!(nearest(2.0, 1.0).status, Status::Infeasible);
        let mut program = QuadraticProgram::new(1);
        program.equal(&[(0, 1.0)], 1.0);
        program.equal(&[(0, 1.0)], 2.0);
        assert_eq!(program.solve().status, Status::Infeasible);
    }

    #[test]
    fn an_objective_without_floor_is_told_as_unbounded() {
        let mut program = QuadraticProgram::new(1);
        program.add_linear(0, 1.0);
        program.between(f64::NEG_INFINITY, &[(0, 1.0)], 0.0);
        assert_eq!(program.solve().status, Status::Unbounded);
    }

    #[test]
    fn data_that_are_not_finite_are_a_status_and_not_a_panic() {
        for bad in [f64::NAN, f64::INFINITY] {
            let mut program = QuadraticProgram::new(1);
            program.add_square(1.0, &[(0, bad)], 0.0);
            assert_eq!(program.solve().status, Status::Numerical);
        }
        assert_eq!(nearest(f64::NAN, 1.0).status, Status::Numerical);
    }

    #[test]
    fn a_cone_bounds_the_norm() {
        // farthest along (3, 4) within a circle of radius 2 about (1, 0)
        let mut program = QuadraticProgram::new(2);
        program.add_linear(0, -3.0);
        program.add_linear(1, -4.0);
        program.norm_at_most(&[(&[(0, 1.0)], -1.0), (&[(1, 1.0)], 0.0)], (&[], 2.0));
        let solution = program.solve();
        assert!(near(solution.x[0], 1.0 + 1.2) && near(solution.x[1], 1.6), "{solution:?}");
    }

    #[test]
    fn multipliers_balance_the_gradient_in_the_order_stated() {
        // nearest point to (3, 2) with x ≤ 1 and ‖(x, y)‖ ≤ √2
        for tuning in [Tuning::General, Tuning::Small] {
            let mut program = QuadraticProgram::new(2);
            program.add_square(1.0, &[(0, 1.0)], 3.0);
            program.add_square(1.0, &[(1, 1.0)], 2.0);
            program.norm_at_most(&[(&[(0, 1.0)], 0.0), (&[(1, 1.0)], 0.0)], (&[], 2.0_f64.sqrt()));
            program.between(f64::NEG_INFINITY, &[(0, 1.0)], 1.0);
            let solution = program.solve_tuned(tuning);
            assert!(solution.is_usable() && near(solution.x[0], 1.0) && near(solution.x[1], 1.0), "{solution:?}");
            let [row, bound, x, y] = solution.multipliers[..] else { panic!("{solution:?}") };
            // of the cone, −(bound, x, y)·(√2, x, y): gradient (−4, −2) + row·(1, 0) − (x, y) = 0
            assert!((row - 4.0 - x).abs() < 1e-4 && (-2.0 - y).abs() < 1e-4, "{solution:?}");
            assert!(row >= 0.0 && bound > 0.0);
        }
    }

    #[test]
    fn a_repeated_variable_adds_up() {
        let mut program = QuadraticProgram::new(1);
        program.add_square(1.0, &[(0, 1.0), (0, 2.0)], 6.0);
        let solution = program.solve();
        assert!(near(solution.x[0], 2.0), "{solution:?}");
        assert!(near(solution.objective, 0.0));
    }

    #[test]
    fn a_program_without_constraints_or_variables_does_not_panic() {
        assert_eq!(QuadraticProgram::new(0).solve().status, Status::Numerical);
        let mut program = QuadraticProgram::new(1);
        program.add_square(1.0, &[(0, 1.0)], 4.0);
        assert!(near(program.solve().x[0], 4.0));
    }

    proptest! {
        #[test]
        fn compressed_matrix_holds_the_sum_of_the_triplets(
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

        /// Without constraints that bite, the optimum of a least-squares program has a zero gradient.
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

    /// The size of the speed layer's smoothing: 60 steps of (station, speed, acceleration).
    #[test]
    fn a_smoothing_sized_program_is_solved_the_same_way_twice() {
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
