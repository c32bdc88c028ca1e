//! `stopline bench spirals`: ways to join two poses smoothly, on the same random lattice problems.
//!
//! Every [`Method`] is timed on every problem that it is for, alone on one thread, the shortest of three runs; its answers
//! are then judged (`judge`) by other means than those that made them. The first row, the cubic spiral by Newton's method,
//! is what bending energies are compared with.

mod judge;
mod shooting;

pub use judge::{Answer, Curve, Judged};

use rayon::prelude::*;

use super::problems::{COUNT, LatticeProblem, SEED, lattice_problems};
use super::{Check, Times, timed};
use crate::geometry::boundary::{EndCondition, Infeasibility, Problem, Status};
use crate::geometry::quintic;
use crate::geometry::spiral::connect;
use crate::geometry::spiral_opt::connect_bounded;

/// The curvature bound of the comparison, 1/m: a turning circle of 8.3 m radius at the rear axle, tight but not yet a
/// car's lock.
pub const BOUND: f64 = 0.12;
/// Price of the soft end's slide against bending energy, 1/m³: a metre costs as much as 10 m driven at 1/30 m curvature.
pub const SOFT: f64 = 0.01;
/// A bound counts as broken from this much above it (relative): rounding of the closed forms.
const ROUNDING: f64 = 1e-12;
/// Error promised of a spiral's end, m and rad.
const RESIDUAL: f64 = 1e-9;
/// Share of the problems under the bound that are promised to be solved, by pinned quintics or proven impossible.
const DECIDED: f64 = 0.98;

/// What to compare on.
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

/// A way to a curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Cubic spiral, everything pinned, Newton's method.
    CubicNewton,
    /// Cubic spiral whose end may slide sideways for a price ([`SOFT`]), every program by Clarabel.
    CubicSoft,
    /// Cubic spiral under [`BOUND`] where that bites: the end slides sideways, convex program.
    CubicBounded,
    /// Quintic spiral, everything pinned, of least bending energy, every program by Clarabel.
    QuinticSpiral,
    /// Quintic spiral, everything pinned, under [`BOUND`] where that bites.
    QuinticBounded,
    /// Quintic polynomial path with tangents as long as the chord.
    PolynomialChord,
    /// Quintic polynomial path with the tangent length of least bending energy.
    PolynomialLeastBending,
    /// Cubic spiral by shooting with Simpson's rule and differences, the lecture's way.
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

    /// What it is, for people.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::CubicNewton => "cubic spiral, Newton",
            Self::CubicSoft => "cubic spiral, soft end",
            Self::CubicBounded => "cubic spiral, bound bites",
            Self::QuinticSpiral => "quintic spiral",
            Self::QuinticBounded => "quintic spiral, bound bites",
            Self::PolynomialChord => "quintic polynomial, chord",
            Self::PolynomialLeastBending => "quintic polynomial, searched",
            Self::CubicShooting => "cubic spiral, shooting",
        }
    }

    /// Whether the method keeps [`BOUND`].
    fn is_bounded(self) -> bool {
        matches!(self, Self::CubicBounded | Self::QuinticBounded)
    }

    /// Whether the method is for this problem: all are for all, but those under the bound.
    #[must_use]
    pub fn is_for(self, problem: &LatticeProblem) -> bool {
        !self.is_bounded() || bites(problem)
    }

    /// Solves a problem; `None` if the method finds no curve.
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

    /// Whether the method proves that there is no curve of its kind for a problem.
    #[must_use]
    pub fn proves_impossible(self, problem: &LatticeProblem) -> bool {
        self == Self::QuinticBounded
            && bounded(problem).quintic().status == Status::Infeasible(Infeasibility::Certified)
    }

    /// Whether its curves are spirals that are held to [`RESIDUAL`].
    fn is_exact_spiral(self) -> bool {
        matches!(
            self,
            Self::CubicNewton | Self::CubicSoft | Self::CubicBounded | Self::QuinticSpiral | Self::QuinticBounded
        )
    }
}

/// The problem with everything pinned, under [`BOUND`].
fn bounded(problem: &LatticeProblem) -> Problem {
    let pinned = Problem::pinned(problem.start_curvature, problem.end, problem.end_curvature);
    Problem { max_curvature: BOUND, ..pinned }
}

fn quintic_spiral(problem: &Problem) -> Option<Answer> {
    let found = problem.quintic();
    found.status.is_solved().then_some(Answer { curve: Curve::Quintic(found.spiral), slide: 0.0 })
}

/// Whether the pinned cubic spiral breaks the bound.
fn bites(problem: &LatticeProblem) -> bool {
    connect(problem.start_curvature, &problem.end, problem.end_curvature)
        .is_ok_and(|spiral| spiral.max_abs_curvature() > BOUND)
}

/// A method's figures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// The method.
    pub method: Method,
    /// Problems it is for.
    pub problems: usize,
    /// Problems for which it found a curve.
    pub solved: usize,
    /// Problems for which it proved that there is none.
    pub impossible: usize,
    /// Largest distance of a curve's end from where it is said to be, m.
    pub worst_residual: f64,
    /// Largest error of the heading there, rad.
    pub worst_heading: f64,
    /// Largest distance that an end slid sideways, m.
    pub worst_slide: f64,
    /// Largest |curvature| of all curves, 1/m.
    pub max_curvature: f64,
    /// Mean bending energy, 1/m; 0 without a curve.
    pub mean_energy: f64,
    /// Sum of the bending energies over that of the pinned cubic spirals on the same problems; not a number without a
    /// curve.
    pub energy_ratio: f64,
    /// Curves with a curvature above [`BOUND`].
    pub over_bound: usize,
    /// What it took.
    pub time: Times,
}

/// What came out.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// What was compared on.
    pub settings: Settings,
    /// The problems.
    pub problems: Vec<LatticeProblem>,
    /// One row a method.
    pub rows: Vec<Row>,
    /// For each method what its answers are worth, problem by problem: `None` where it was not asked or found nothing.
    pub judged: Vec<Vec<Option<Judged>>>,
}

/// Solves, times and judges.
#[must_use]
pub fn compare(settings: &Settings) -> Comparison {
    compare_watched(settings, &mut |_, _, _| {})
}

/// [`compare`]; `watch` hears which method is at work, and how many of all problems of all methods are done.
#[must_use]
pub fn compare_watched(settings: &Settings, watch: &mut dyn FnMut(Method, usize, usize)) -> Comparison {
    let problems = lattice_problems(settings.seed, settings.problems);
    let mut rows = Vec::new();
    let mut judged: Vec<Vec<Option<Judged>>> = Vec::new();
    let all = problems.len() * Method::ALL.len();
    for (i, method) in Method::ALL.into_iter().enumerate() {
        let mut done = |n| watch(method, i * problems.len() + n, all);
        let (asked, answers, time) = measured(method, &problems, &mut done);
        // those that the method is not for are done, too
        done(problems.len());
        let reference = judged.first().unwrap_or(&answers);
        let unsolved = problems.par_iter().zip(&answers).filter(|(p, answer)| method.is_for(p) && answer.is_none());
        let impossible = unsolved.filter(|(p, _)| method.proves_impossible(p)).count();
        rows.push(Row { impossible, ..row(method, asked, time, &answers, reference) });
        judged.push(answers);
    }
    Comparison { settings: *settings, problems, rows, judged }
}

/// How many problems a method was asked, what its answers are worth, and what it took. Timed alone, judged in parallel.
fn measured(
    method: Method,
    problems: &[LatticeProblem],
    watch: &mut dyn FnMut(usize),
) -> (usize, Vec<Option<Judged>>, Times) {
    let places: Vec<usize> = (0..problems.len()).filter(|i| method.is_for(&problems[*i])).collect();
    let (answers, time) = timed(&places, |i| method.solve(&problems[*i]), watch);
    let worth: Vec<Option<Judged>> =
        places.par_iter().zip(&answers).map(|(i, answer)| answer.map(|a| a.judged(&problems[*i]))).collect();
    let mut judged = vec![None; problems.len()];
    for (i, worth) in places.iter().zip(worth) {
        judged[*i] = worth;
    }
    (places.len(), judged, time)
}

fn row(method: Method, problems: usize, time: Times, judged: &[Option<Judged>], reference: &[Option<Judged>]) -> Row {
    let found: Vec<Judged> = judged.iter().flatten().copied().collect();
    let largest = |value: fn(&Judged) -> f64| found.iter().map(value).fold(0.0, f64::max);
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

    /// What is promised of these problems, whatever the machine: all are solved where nothing is bounded; where a bound
    /// bites, nearly all are if the end may slide, and nearly all are solved or proven impossible if it may not; ends are met
    /// to a nanometre; no curve that was asked to stay within the bound leaves it; and quintics bend less than cubics.
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
            (at_most("newton_residual", most(&newton, &|r| r.worst_residual), RESIDUAL), "m"),
            (at_least("spirals_solve_all", least(&free, &|r| share(r.solved, r.problems)), 1.0), "share"),
            (at_least("bounded_cubics_solved", slid, DECIDED), "share"),
            (at_least("bounded_quintics_decided", decided, DECIDED), "share"),
            (at_most("spirals_residual", most(&exact, &|r| r.worst_residual), RESIDUAL), "m"),
            (at_most("spirals_heading", most(&exact, &|r| r.worst_heading), RESIDUAL), "rad"),
            (at_most("bound_holds", most(&Method::is_bounded, &|r| r.max_curvature), BOUND * (1.0 + ROUNDING)), "1/m"),
            (at_most("quintics_bend_less", most(&quintic, &|r| r.energy_ratio), 1.0), "ratio"),
        ]
        .map(|((name, pass, value, limit), unit)| Check { name, pass, value, limit, unit })
        .to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: Settings = Settings { seed: 7, problems: 120 };

    #[test]
    fn two_measurements_differ_in_time_alone() {
        let timeless = |settings| {
            let mut comparison = compare(settings);
            comparison.rows.iter_mut().for_each(|r| r.time = Times { median_us: 0.0, p99_us: 0.0 });
            comparison
        };
        assert_eq!(timeless(&SMALL), timeless(&SMALL));
        let other = Settings { seed: 8, ..SMALL };
        assert_ne!(timeless(&SMALL).judged, timeless(&other).judged);
    }

    #[test]
    fn who_watches_hears_of_every_method_and_only_forwards_up_to_the_end() {
        let mut heard: Vec<(Method, usize, usize)> = Vec::new();
        let _ = compare_watched(&Settings { seed: 7, problems: 5 }, &mut |m, done, all| heard.push((m, done, all)));
        assert!(heard.windows(2).all(|w| w[0].1 <= w[1].1), "{heard:?}");
        assert!(heard.iter().all(|h| h.2 == 5 * Method::ALL.len()));
        assert_eq!(heard.last().map(|h| h.1), Some(5 * Method::ALL.len()));
        for (i, method) in Method::ALL.into_iter().enumerate() {
            let of_method: Vec<usize> = heard.iter().filter(|h| h.0 == method).map(|h| h.1).collect();
            assert_eq!(of_method.last(), Some(&(5 * (i + 1))), "{method:?}");
        }
    }

    #[test]
    fn every_row_says_what_its_answers_say() {
        let comparison = compare(&SMALL);
        assert_eq!(comparison.rows.len(), Method::ALL.len());
        for (row, judged) in comparison.rows.iter().zip(&comparison.judged) {
            assert_eq!(row.solved, judged.iter().flatten().count(), "{row:?}");
            assert!(row.solved + row.impossible <= row.problems && row.problems <= SMALL.problems);
            assert!(row.impossible == 0 || row.method == Method::QuinticBounded);
            assert!(row.over_bound <= row.solved);
            assert!(row.time.median_us > 0.0 && row.time.p99_us >= row.time.median_us);
        }
        let reference = comparison.row(Method::CubicNewton).unwrap();
        assert_eq!((reference.energy_ratio, reference.worst_slide), (1.0, 0.0));
        // the bound is asked for exactly where the free spiral breaks it, and holds there
        let bounded = comparison.row(Method::CubicBounded).unwrap();
        assert!(bounded.problems == reference.over_bound && bounded.problems > 5);
        assert_eq!(bounded.over_bound, 0);
        assert!(bounded.worst_slide > 0.01);
    }

    #[test]
    fn promises_are_kept_and_a_broken_one_is_told() {
        let good = compare(&SMALL);
        assert!(good.checks().iter().all(|c| c.pass), "{:?}", good.checks());
        /// What to break, and the checks that must tell.
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
        for (method, break_it, told) in cases {
            let mut comparison = good.clone();
            comparison.rows.iter_mut().filter(|r| r.method == method).for_each(break_it);
            let failed: Vec<&str> = comparison.checks().iter().filter(|c| !c.pass).map(|c| c.name).collect();
            assert_eq!(failed, told, "{method:?}");
        }
        // a method whose curves are coarse by design may be
        let mut comparison = good;
        comparison.rows.iter_mut().filter(|r| r.method == Method::CubicShooting).for_each(|r| r.worst_residual = 1e-6);
        assert!(comparison.checks().iter().all(|c| c.pass));
    }

    #[test]
    fn one_problem_in_which_no_bound_bites_is_measured_too() {
        let seed = (0..100).find(|seed| !bites(&lattice_problems(*seed, 1)[0])).unwrap();
        let comparison = compare(&Settings { seed, problems: 1 });
        let bounded = comparison.row(Method::CubicBounded).unwrap();
        assert_eq!((bounded.problems, bounded.solved, bounded.mean_energy), (0, 0, 0.0));
        assert!(comparison.checks().iter().all(|c| c.pass));
    }
}
