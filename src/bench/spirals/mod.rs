//! `stopline bench spirals`: methods that connect two poses smoothly, on the same random lattice problems.
//!
//! Each [`Method`] solves every problem that it applies to, three times on one thread; the shortest time counts.
//! `evaluation` then computes the metrics of its answers, independently of the method. The reference for bending
//! energies is the cubic spiral by Newton's method, the first row.

mod evaluation;
mod shooting;

pub use evaluation::{Answer, Curve, Evaluation};

use rayon::prelude::*;

use super::problems::{COUNT, LatticeProblem, SEED, lattice_problems};
use super::{Check, Times, timed};
use crate::geometry::boundary::{EndCondition, Infeasibility, Problem, Status};
use crate::geometry::quintic;
use crate::geometry::spiral::connect;
use crate::geometry::spiral_opt::connect_bounded;
use crate::verdict::Status as CheckStatus;

/// The curvature bound of the comparison, 1/m: a radius of 8.3 m at the rear axle, somewhat wider than the minimum of a
/// car.
pub const BOUND: f64 = 0.12;
/// Weight of the squared lateral displacement of a soft end, relative to bending energy, 1/m³: a displacement of 1 m
/// costs as much as 9 m at a curvature of 1/30 m.
pub const SOFT: f64 = 0.01;
/// Relative tolerance of the curvature bound: rounding errors of the closed forms.
const ROUNDING: f64 = 1e-12;
/// Limit of the residual at the end of a spiral, m and rad.
const MAX_RESIDUAL: f64 = 1e-9;
/// Minimum share of the problems with an active bound that are solved or, for pinned quintics, proven infeasible.
const MIN_DECIDED: f64 = 0.98;

/// Settings of the comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Seed of the problems.
    pub seed: u64,
    /// Number of problems.
    pub problems: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { seed: SEED, problems: COUNT }
    }
}

/// A method to connect two poses. *Pinned*: both poses and both end curvatures are fixed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Pinned cubic spiral by Newton's method.
    CubicNewton,
    /// Cubic spiral with a lateral displacement of the end at a cost ([`SOFT`]), every program by Clarabel.
    CubicSoft,
    /// Cubic spiral within [`BOUND`] where the bound is active, with a lateral displacement of the end; convex program.
    CubicBounded,
    /// Pinned quintic spiral of least bending energy, every program by Clarabel.
    QuinticSpiral,
    /// Pinned quintic spiral within [`BOUND`] where the bound is active.
    QuinticBounded,
    /// Quintic polynomial path with tangents as long as the chord.
    PolynomialChord,
    /// Quintic polynomial path with the tangent length of least bending energy.
    PolynomialLeastBending,
    /// Pinned cubic spiral by the lecture's shooting method, with Simpson's rule and finite differences.
    CubicShooting,
}

impl Method {
    /// All methods, in the order of the table.
    pub const ALL: [Self; 8] = [
        Self::CubicNewton,
        Self::CubicSoft,
        Self::CubicBounded,
        Self::QuinticSpiral,
        Self::QuinticBounded,
        Self::PolynomialChord,
        Self::PolynomialLeastBending,
        Self::CubicShooting,
    ];

    /// Stable name, for files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::CubicNewton => "cubic_newton",
            Self::CubicSoft => "cubic_soft",
            Self::CubicBounded => "cubic_bounded",
            Self::QuinticSpiral => "quintic_spiral",
            Self::QuinticBounded => "quintic_bounded",
            Self::PolynomialChord => "polynomial_chord",
            Self::PolynomialLeastBending => "polynomial_least_bending",
            Self::CubicShooting => "cubic_shooting",
        }
    }

    /// Label in tables and pictures.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::CubicNewton => "cubic spiral, Newton",
            Self::CubicSoft => "cubic spiral, soft end",
            Self::CubicBounded => "cubic spiral, active bound",
            Self::QuinticSpiral => "quintic spiral",
            Self::QuinticBounded => "quintic spiral, active bound",
            Self::PolynomialChord => "quintic polynomial, chord",
            Self::PolynomialLeastBending => "quintic polynomial, searched",
            Self::CubicShooting => "cubic spiral, shooting",
        }
    }

    /// Whether the method keeps [`BOUND`].
    fn is_bounded(self) -> bool {
        matches!(self, Self::CubicBounded | Self::QuinticBounded)
    }

    /// Whether the method applies to a problem. Bounded methods apply only where the bound is active.
    #[must_use]
    pub fn is_for(self, problem: &LatticeProblem) -> bool {
        !self.is_bounded() || bound_is_active(problem)
    }

    /// Solves a problem. `None` if the method finds no curve.
    #[must_use]
    pub fn solve(self, problem: &LatticeProblem) -> Option<Answer> {
        let LatticeProblem { start_curvature, end, end_curvature } = problem;
        let (start, last) = (*start_curvature, *end_curvature);
        let pinned = |curve| Answer { curve, slide: 0.0 };
        match self {
            Self::CubicNewton => connect(start, end, last).ok().map(|s| pinned(Curve::Cubic(s))),
            Self::CubicBounded => {
                let found = connect_bounded(start, end, last, BOUND).ok()?;
                Some(Answer { curve: Curve::Cubic(found.spiral), slide: found.end_error })
            }
            Self::CubicSoft => {
                let lateral = EndCondition::Soft { weight: SOFT };
                let found = Problem { lateral, always_convex: true, ..Problem::pinned(start, *end, last) }.cubic();
                let answer = Answer { curve: Curve::Cubic(found.spiral), slide: found.deviation.lateral };
                found.status.is_solved().then_some(answer)
            }
            Self::QuinticSpiral => {
                quintic_spiral(&Problem { always_convex: true, ..Problem::pinned(start, *end, last) })
            }
            Self::QuinticBounded => quintic_spiral(&bounded(problem)),
            Self::PolynomialChord => quintic::connect(start, end, last).ok().map(|p| pinned(Curve::Polynomial(p))),
            Self::PolynomialLeastBending => {
                quintic::connect_least_bending(start, end, last).ok().map(|p| pinned(Curve::Polynomial(p)))
            }
            Self::CubicShooting => shooting::shoot(problem).map(|s| pinned(Curve::Cubic(s))),
        }
    }

    /// Whether the method proves that a problem has no solution of its kind.
    #[must_use]
    pub fn proves_impossible(self, problem: &LatticeProblem) -> bool {
        self == Self::QuinticBounded
            && bounded(problem).quintic().status == Status::Infeasible(Infeasibility::Certified)
    }

    /// Whether the method computes spirals subject to [`MAX_RESIDUAL`].
    fn is_exact_spiral(self) -> bool {
        matches!(
            self,
            Self::CubicNewton | Self::CubicSoft | Self::CubicBounded | Self::QuinticSpiral | Self::QuinticBounded
        )
    }
}

/// The pinned problem within [`BOUND`].
fn bounded(problem: &LatticeProblem) -> Problem {
    let pinned = Problem::pinned(problem.start_curvature, problem.end, problem.end_curvature);
    Problem { max_curvature: BOUND, ..pinned }
}

fn quintic_spiral(problem: &Problem) -> Option<Answer> {
    let found = problem.quintic();
    found.status.is_solved().then_some(Answer { curve: Curve::Quintic(found.spiral), slide: 0.0 })
}

/// Whether the pinned cubic spiral violates the bound.
fn bound_is_active(problem: &LatticeProblem) -> bool {
    connect(problem.start_curvature, &problem.end, problem.end_curvature)
        .is_ok_and(|spiral| spiral.max_abs_curvature() > BOUND)
}

/// Metrics of a method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// The method.
    pub method: Method,
    /// Number of problems that the method applies to.
    pub problems: usize,
    /// Number of solved problems.
    pub solved: usize,
    /// Number of problems proven infeasible.
    pub impossible: usize,
    /// Maximum distance of a curve's end from the reported end, m.
    pub worst_residual: f64,
    /// Maximum heading error at the end, rad.
    pub worst_heading: f64,
    /// Maximum lateral displacement of an end, m.
    pub worst_slide: f64,
    /// Maximum |curvature| of all curves, 1/m.
    pub max_curvature: f64,
    /// Mean bending energy, 1/m; 0 without a curve.
    pub mean_energy: f64,
    /// Total bending energy divided by that of the pinned cubic spirals on the same problems; NaN without a curve.
    pub energy_ratio: f64,
    /// Number of curves with a curvature above [`BOUND`].
    pub over_bound: usize,
    /// Time per problem.
    pub time: Times,
}

/// Result of the comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// The settings.
    pub settings: Settings,
    /// The problems.
    pub problems: Vec<LatticeProblem>,
    /// One row per method.
    pub rows: Vec<Row>,
    /// Evaluations by method and problem. `None` where the method does not apply or found no curve.
    pub evaluations: Vec<Vec<Option<Evaluation>>>,
}

/// Solves all problems with all methods and evaluates the answers.
#[must_use]
pub fn compare(settings: &Settings) -> Comparison {
    compare_with_progress(settings, &mut |_, _, _| {})
}

/// [`compare`] with a progress callback: the running method, the number of finished solves, and the number of all
/// solves.
#[must_use]
pub fn compare_with_progress(settings: &Settings, progress: &mut dyn FnMut(Method, usize, usize)) -> Comparison {
    let problems = lattice_problems(settings.seed, settings.problems);
    let mut rows = Vec::new();
    let mut evaluations: Vec<Vec<Option<Evaluation>>> = Vec::new();
    let all = problems.len() * Method::ALL.len();
    for (i, method) in Method::ALL.into_iter().enumerate() {
        let mut done = |n| progress(method, i * problems.len() + n, all);
        let (applicable, answers, time) = measure(method, &problems, &mut done);
        // includes the problems that the method does not apply to
        done(problems.len());
        let reference = evaluations.first().unwrap_or(&answers);
        let unsolved = problems.par_iter().zip(&answers).filter(|(p, answer)| method.is_for(p) && answer.is_none());
        let impossible = unsolved.filter(|(p, _)| method.proves_impossible(p)).count();
        rows.push(Row { impossible, ..row(method, applicable, time, &answers, reference) });
        evaluations.push(answers);
    }
    Comparison { settings: *settings, problems, rows, evaluations }
}

/// Number of problems that a method applies to, the evaluations of its answers, and its times. Solves on one thread and
/// evaluates in parallel.
fn measure(
    method: Method,
    problems: &[LatticeProblem],
    progress: &mut dyn FnMut(usize),
) -> (usize, Vec<Option<Evaluation>>, Times) {
    let places: Vec<usize> = (0..problems.len()).filter(|i| method.is_for(&problems[*i])).collect();
    let (answers, time) = timed(&places, |i| method.solve(&problems[*i]), progress);
    let worth: Vec<Option<Evaluation>> =
        places.par_iter().zip(&answers).map(|(i, answer)| answer.map(|a| a.evaluate(&problems[*i]))).collect();
    let mut evaluations = vec![None; problems.len()];
    for (i, worth) in places.iter().zip(worth) {
        evaluations[*i] = worth;
    }
    (places.len(), evaluations, time)
}

fn row(
    method: Method,
    problems: usize,
    time: Times,
    judged: &[Option<Evaluation>],
    reference: &[Option<Evaluation>],
) -> Row {
    let found: Vec<Evaluation> = judged.iter().flatten().copied().collect();
    let largest = |value: fn(&Evaluation) -> f64| found.iter().map(value).fold(0.0, f64::max);
    let energy: f64 = found.iter().map(|j| j.bending_energy).sum();
    let both = judged.iter().zip(reference).filter_map(|(j, r)| Some(((*j)?.bending_energy, (*r)?.bending_energy)));
    let (ours, theirs) = both.fold((0.0, 0.0), |(a, b), (ours, theirs)| (a + ours, b + theirs));
    Row {
        method,
        problems,
        solved: found.len(),
        impossible: 0,
        worst_residual: largest(|j| j.end_residual),
        worst_heading: largest(|j| j.heading_residual),
        worst_slide: largest(|j| j.slide),
        max_curvature: largest(|j| j.max_curvature),
        mean_energy: energy / found.len().max(1) as f64,
        energy_ratio: ours / theirs,
        over_bound: found.iter().filter(|j| j.max_curvature > BOUND * (1.0 + ROUNDING)).count(),
        time,
    }
}

impl Comparison {
    /// The row of a method.
    #[cfg(test)]
    fn row(&self, method: Method) -> Option<&Row> {
        self.rows.iter().find(|r| r.method == method)
    }

    /// Checks of the metrics, independent of the machine. Unbounded methods solve all problems. Where the bound is
    /// active, the cubic with a free lateral end solves nearly all, and the pinned quintic solves or refutes nearly
    /// all. Residuals are below a nanometre, bounded curves keep the bound, and quintic spirals bend less than cubic
    /// ones.
    #[must_use]
    pub fn checks(&self) -> Vec<Check> {
        let share = |count: usize, of: usize| if of == 0 { 1.0 } else { count as f64 / of as f64 };
        let least = |of: &dyn Fn(Method) -> bool, value: &dyn Fn(&Row) -> f64| {
            self.rows.iter().filter(|r| of(r.method)).map(value).fold(1.0, f64::min)
        };
        let most = |of: &dyn Fn(Method) -> bool, value: &dyn Fn(&Row) -> f64| {
            self.rows.iter().filter(|r| of(r.method)).map(value).fold(0.0, f64::max)
        };
        let newton = |m| m == Method::CubicNewton;
        let free = |m: Method| m.is_exact_spiral() && !m.is_bounded();
        let exact = Method::is_exact_spiral;
        let quintic = |m| m == Method::QuinticSpiral;
        let decided = least(&|m| m == Method::QuinticBounded, &|r| share(r.solved + r.impossible, r.problems));
        let slid = least(&|m| m == Method::CubicBounded, &|r| share(r.solved, r.problems));
        let at_least = |name, value: f64, limit: f64| (name, value >= limit, value, limit);
        let at_most = |name, value: f64, limit: f64| (name, value <= limit, value, limit);
        [
            (at_least("newton_solves_all", least(&newton, &|r| share(r.solved, r.problems)), 1.0), "share"),
            (at_most("newton_residual", most(&newton, &|r| r.worst_residual), MAX_RESIDUAL), "m"),
            (at_least("spirals_solve_all", least(&free, &|r| share(r.solved, r.problems)), 1.0), "share"),
            (at_least("bounded_cubics_solved", slid, MIN_DECIDED), "share"),
            (at_least("bounded_quintics_decided", decided, MIN_DECIDED), "share"),
            (at_most("spirals_residual", most(&exact, &|r| r.worst_residual), MAX_RESIDUAL), "m"),
            (at_most("spirals_heading", most(&exact, &|r| r.worst_heading), MAX_RESIDUAL), "rad"),
            (at_most("bound_holds", most(&Method::is_bounded, &|r| r.max_curvature), BOUND * (1.0 + ROUNDING)), "1/m"),
            (at_most("quintics_bend_less", most(&quintic, &|r| r.energy_ratio), 1.0), "ratio"),
        ]
        .map(|((name, pass, value, limit), unit)| Check { name, status: CheckStatus::of(pass), value, limit, unit })
        .to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: Settings = Settings { seed: 7, problems: 120 };

    #[test]
    fn repeated_comparisons_differ_only_in_time() {
        let timeless = |settings| {
            let mut comparison = compare(settings);
            comparison.rows.iter_mut().for_each(|r| r.time = Times { median_us: 0.0, p99_us: 0.0 });
            comparison
        };
        assert_eq!(timeless(&SMALL), timeless(&SMALL));
        let other = Settings { seed: 8, ..SMALL };
        assert_ne!(timeless(&SMALL).evaluations, timeless(&other).evaluations);
    }

    #[test]
    fn progress_is_monotonic_and_covers_every_method() {
        let mut reports: Vec<(Method, usize, usize)> = Vec::new();
        let settings = Settings { seed: 7, problems: 5 };
        let _ = compare_with_progress(&settings, &mut |m, done, all| reports.push((m, done, all)));
        assert!(reports.windows(2).all(|w| w[0].1 <= w[1].1), "{reports:?}");
        assert!(reports.iter().all(|r| r.2 == 5 * Method::ALL.len()));
        assert_eq!(reports.last().map(|r| r.1), Some(5 * Method::ALL.len()));
        for (i, method) in Method::ALL.into_iter().enumerate() {
            let of_method: Vec<usize> = reports.iter().filter(|r| r.0 == method).map(|r| r.1).collect();
            assert_eq!(of_method.last(), Some(&(5 * (i + 1))), "{method:?}");
        }
    }

    #[test]
    fn rows_agree_with_the_evaluations() {
        let comparison = compare(&SMALL);
        assert_eq!(comparison.rows.len(), Method::ALL.len());
        for (row, evaluations) in comparison.rows.iter().zip(&comparison.evaluations) {
            assert_eq!(row.solved, evaluations.iter().flatten().count(), "{row:?}");
            assert!(row.solved + row.impossible <= row.problems && row.problems <= SMALL.problems);
            assert!(row.impossible == 0 || row.method == Method::QuinticBounded);
            assert!(row.over_bound <= row.solved);
            assert!(row.time.median_us > 0.0 && row.time.p99_us >= row.time.median_us);
        }
        let reference = comparison.row(Method::CubicNewton).unwrap();
        assert_eq!((reference.energy_ratio, reference.worst_slide), (1.0, 0.0));
        // bounded methods apply exactly where the free spiral violates the bound, and keep it
        let bounded = comparison.row(Method::CubicBounded).unwrap();
        assert!(bounded.problems == reference.over_bound && bounded.problems > 5);
        assert_eq!(bounded.over_bound, 0);
        assert!(bounded.worst_slide > 0.01);
    }

    #[test]
    fn checks_pass_and_report_each_violation() {
        let good = compare(&SMALL);
        assert!(good.checks().iter().all(|c| c.status == CheckStatus::Pass), "{:?}", good.checks());
        /// A method, a fault in its row, and the checks that must fail.
        type Case = (Method, fn(&mut Row), &'static [&'static str]);
        let cases: [Case; 9] = [
            (Method::CubicNewton, |r| r.solved -= 1, &["newton_solves_all", "spirals_solve_all"]),
            (Method::CubicNewton, |r| r.worst_residual = 2e-9, &["newton_residual", "spirals_residual"]),
            (Method::CubicBounded, |r| r.solved -= 1, &["bounded_cubics_solved"]),
            (Method::QuinticSpiral, |r| r.solved -= 1, &["spirals_solve_all"]),
            (Method::QuinticBounded, |r| r.impossible = 0, &["bounded_quintics_decided"]),
            (Method::CubicSoft, |r| r.worst_residual = 2e-9, &["spirals_residual"]),
            (Method::QuinticBounded, |r| r.worst_heading = 2e-9, &["spirals_heading"]),
            (Method::QuinticBounded, |r| r.max_curvature = 0.121, &["bound_holds"]),
            (Method::QuinticSpiral, |r| r.energy_ratio = 1.01, &["quintics_bend_less"]),
        ];
        for (method, fault, expected) in cases {
            let mut comparison = good.clone();
            comparison.rows.iter_mut().filter(|r| r.method == method).for_each(fault);
            let failed: Vec<&str> =
                comparison.checks().iter().filter(|c| c.status != CheckStatus::Pass).map(|c| c.name).collect();
            assert_eq!(failed, expected, "{method:?}");
        }
        // no limit applies to the residual of the shooting method
        let mut comparison = good;
        comparison.rows.iter_mut().filter(|r| r.method == Method::CubicShooting).for_each(|r| r.worst_residual = 1e-6);
        assert!(comparison.checks().iter().all(|c| c.status == CheckStatus::Pass));
    }

    #[test]
    fn measures_a_single_problem_with_an_inactive_bound() {
        let seed = (0..100).find(|seed| !bound_is_active(&lattice_problems(*seed, 1)[0])).unwrap();
        let comparison = compare(&Settings { seed, problems: 1 });
        let bounded = comparison.row(Method::CubicBounded).unwrap();
        assert_eq!((bounded.problems, bounded.solved, bounded.mean_energy), (0, 0, 0.0));
        assert!(comparison.checks().iter().all(|c| c.status == CheckStatus::Pass));
    }
}
