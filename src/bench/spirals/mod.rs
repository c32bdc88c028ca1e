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
use super::{Times, timed};
use crate::geometry::boundary::{EndCondition, Problem};
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
/// Position error promised of Newton's method, m.
const RESIDUAL: f64 = 1e-9;

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
                let across = EndCondition::Soft { weight: SOFT };
                let found = Problem { across, always_convex: true, ..Problem::pinned(start, *end, last) }.cubic();
                let answer = Answer { curve: Curve::Cubic(found.spiral), slide: found.deviation.across };
                found.status.is_solved().then_some(answer)
            }
            Self::QuinticSpiral => {
                quintic_spiral(&Problem { always_convex: true, ..Problem::pinned(start, *end, last) })
            }
            Self::QuinticBounded => {
                quintic_spiral(&Problem { max_curvature: BOUND, ..Problem::pinned(start, *end, last) })
            }
            Self::PolynomialChord => quintic::connect(start, end, last).ok().map(|p| pinned(Curve::Polynomial(p))),
            Self::PolynomialLeastBending => {
                quintic::connect_least_bending(start, end, last).ok().map(|p| pinned(Curve::Polynomial(p)))
            }
            Self::CubicShooting => shooting::shoot(problem).map(|s| pinned(Curve::Cubic(s))),
        }
    }
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

/// Something promised, with its figure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Check {
    /// Stable name.
    pub name: &'static str,
    /// Whether it held.
    pub pass: bool,
    /// The figure.
    pub value: f64,
    /// What it may be.
    pub limit: f64,
    /// Unit of both.
    pub unit: &'static str,
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
        rows.push(row(method, asked, time, &answers, reference));
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
    fn row(&self, method: Method) -> Option<&Row> {
        self.rows.iter().find(|r| r.method == method)
    }

    /// What is promised of these problems: Newton's method solves all of them to a nanometre, and no curve that was asked
    /// to stay within the bound leaves it.
    #[must_use]
    pub fn checks(&self) -> Vec<Check> {
        let figure = |method, value: &dyn Fn(&Row) -> f64| self.row(method).map_or(f64::NAN, value);
        let solved = figure(Method::CubicNewton, &|r| r.solved as f64 / r.problems.max(1) as f64);
        let residual = figure(Method::CubicNewton, &|r| r.worst_residual);
        let bounded = self.rows.iter().filter(|r| r.method.is_bounded()).map(|r| r.max_curvature).fold(0.0, f64::max);
        [
            ("newton_solves_all", solved >= 1.0, solved, 1.0, "share"),
            ("newton_residual", residual <= RESIDUAL, residual, RESIDUAL, "m"),
            ("bound_holds", bounded <= BOUND * (1.0 + ROUNDING), bounded, BOUND, "1/m"),
        ]
        .map(|(name, pass, value, limit, unit)| Check { name, pass, value, limit, unit })
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
            assert!(row.solved <= row.problems && row.problems <= SMALL.problems);
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
        let mut comparison = compare(&SMALL);
        assert!(comparison.checks().iter().all(|c| c.pass), "{:?}", comparison.checks());
        comparison.rows[0].solved -= 1;
        comparison.rows[0].worst_residual = 2e-9;
        comparison.rows[4].max_curvature = 0.121;
        assert!(comparison.checks().iter().all(|c| !c.pass), "{:?}", comparison.checks());
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
