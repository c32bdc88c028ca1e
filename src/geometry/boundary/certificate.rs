//! Proof of infeasibility: branch and bound over a linear relaxation of the boundary problem.
//!
//! With turning rates qᵢ = L kᵢ instead of curvatures, all conditions except the position are linear in x = (q₁ … q, L):
//! the heading θ(u) = Σ qᵢ ∫Nᵢ, the end heading, the bound |Σ qᵢ Nᵢ(u)| ≤ κ_max L. The position is not linear:
//!
//! ```text
//! ∫ cos(θ(u) − δ) du = (required end position, projected onto direction δ) / L
//! ```
//!
//! But the bound confines the heading: between start, middle and end it turns by at most κ_max L. On such an interval the
//! cosine lies below a line (its tangent where it is concave, its secant where it is convex, each moved up as far as
//! necessary), and 1/L lies above its tangent and below its secant. So the position becomes a few more linear rows, one for
//! each of several directions δ. If the rows contradict each other, there is no spiral in the box of (L, headings at 1/4,
//! 1/2 and 3/4 of the length); otherwise the box is halved. (Relaxation by under- and overestimators in a spatial branch and
//! bound: McCormick 1976; Horst & Tuy, Global Optimization.)
//!
//! A contradiction is a set of multipliers y ≥ 0 of rows aᵢ·x ≤ bᵢ with Σ y a = 0 and Σ y b < 0 (Farkas' lemma). A dual
//! simplex method computes it, and a separate sum of the rows checks it, so that the proof does not depend on the numerical
//! behaviour of the method. The proof relies on floating-point sums (contradictions smaller than [`MARGIN`] do not count)
//! and on the error of the quadrature, at most [`QUADRATURE`], by which its rows are loosened.
//!
//! Weak where the end is only just out of reach, and where the bound permits the heading to turn by more than a radian or
//! two: the boxes must be small there, and there are many.

use super::EndCondition;
use super::basis::dot;
use super::scaled::{LENGTHS, Scaled};
use crate::geometry::quadrature::GAUSS_8;
use crate::geometry::spiral::{Polynomial, Tables};

/// Smallest contradiction that counts as a proof.
const MARGIN: f64 = 1e-6;
/// Turning (rad) up to which a quadrature of this many eight-point panels has an error below [`QUADRATURE`]. Beyond the last
/// one the rows of the position are omitted.
const PANELS: [(usize, f64); 2] = [(2, 3.0), (4, 14.0)];
/// Permitted error of the mean direction by quadrature.
const QUADRATURE: f64 = 1e-6;
/// Parameters u at which headings are bounded and boxes are split.
const MARKS: [f64; 3] = [0.25, 0.5, 0.75];
/// Number of intervals between the initial bound rows. Relaxed solutions that violate a bound elsewhere add rows there.
const PLACES: usize = 8;
/// Relaxations per box, each linearised about the solution of the previous one.
const ROUNDS: usize = 2;
/// Maximum number of unknowns: six for a quintic, and the slack.
const MAX_UNKNOWNS: usize = 7;
/// Maximum number of exchanges of the dual simplex method; ten are usual.
const EXCHANGES: usize = 120;

/// Whether there is provably no spiral within bounds, lengths and fixed or ranged conditions. `false` means undecided.
///
/// Examines at most `boxes` boxes.
pub(super) fn is_infeasible<const K: usize>(scaled: &Scaled<K>, boxes: usize) -> bool {
    Search::new(scaled).is_some_and(|search| search.run(boxes))
}

/// a·x ≤ b, scaled so that the largest |a| is one.
#[derive(Debug, Clone, Copy)]
struct Row<const K: usize> {
    a: [f64; K],
    b: f64,
}

/// A box of the search.
#[derive(Debug, Clone, Copy)]
struct Region<const K: usize> {
    /// Length, chords.
    length: (f64, f64),
    /// Headings at the marks, rad.
    headings: [(f64, f64); MARKS.len()],
    /// The last relaxed solution, about which the next relaxation is linearised.
    guess: Option<[f64; K]>,
}

/// What may remain of a region.
#[derive(Debug, Clone, Copy)]
enum Remainder<const K: usize> {
    /// Provably no spiral.
    Empty,
    /// Undecided, with the relaxed solution if there is one.
    Possible(Option<[f64; K]>),
}

/// A node of the quadrature: its parameter, its weight, and the integrals of the basis up to it.
#[derive(Debug, Clone, Copy)]
struct Node<const K: usize> {
    u: f64,
    weight: f64,
    turned: [f64; K],
}

/// A direction, and the smallest permitted projection of the end position onto it, chords.
#[derive(Debug, Clone, Copy)]
struct Reach {
    direction: Angle,
    least: f64,
}

/// The data that all boxes share.
struct Search<'a, const K: usize> {
    scaled: &'a Scaled<K>,
    /// Quadratures, from coarse to fine.
    nodes: [Vec<Node<K>>; PANELS.len()],
    /// ∫Nᵢ up to each mark.
    marks: [[f64; K]; MARKS.len()],
    /// Permitted end heading, rad.
    heading: (f64, f64),
    /// Shortest length, chords.
    shortest: f64,
    reaches: Vec<Reach>,
    /// Rows that hold in every box.
    common: Vec<Row<K>>,
}

impl<'a, const K: usize> Search<'a, K> {
    fn new(scaled: &'a Scaled<K>) -> Option<Self> {
        if scaled.bounds.iter().all(|bound| *bound == f64::INFINITY) {
            return None;
        }
        let free = (f64::NEG_INFINITY, f64::INFINITY);
        let limits = scaled.conditions.map(|condition| match condition {
            EndCondition::Fixed => (0.0, 0.0),
            EndCondition::Range(low, high) => (low, high),
            EndCondition::Free | EndCondition::Soft { .. } => free,
        });
        let [longitudinal, lateral, heading, curvature] = limits;
        let constrained = |limits: (f64, f64)| limits.0.is_finite() && limits.1.is_finite();
        let nodes = PANELS.map(|(panels, _)| {
            let places = (0..panels).flat_map(|panel| GAUSS_8.map(|(node, weight)| (panel as f64 + node, weight)));
            let share = 1.0 / panels as f64;
            places
                .map(|(place, weight)| Node { u: share * place, weight: share * weight, turned: turned(share * place) })
                .collect()
        });
        let pinned = longitudinal == (0.0, 0.0) && lateral == (0.0, 0.0);
        let mut search = Self {
            scaled,
            nodes,
            marks: MARKS.map(turned),
            heading: (scaled.target.yaw + heading.0, scaled.target.yaw + heading.1),
            shortest: if pinned { 1.0 } else { LENGTHS.0 },
            reaches: Vec::new(),
            common: Vec::new(),
        };
        let chord = scaled.target.position.coords;
        let directions: Vec<f64> = match (constrained(longitudinal), constrained(lateral)) {
            (true, true) => {
                (0..8).map(|i| chord.y.atan2(chord.x) + f64::from(i) * std::f64::consts::FRAC_PI_4).collect()
            }
            (true, false) => vec![scaled.target.yaw, scaled.target.yaw + std::f64::consts::PI],
            (false, true) => [0.5, 1.5].map(|turn| scaled.target.yaw + turn * std::f64::consts::PI).to_vec(),
            (false, false) => Vec::new(),
        };
        for direction in directions {
            let (sin, cos) = direction.sin_cos();
            let seen = |axis: crate::geometry::Vector, limits: (f64, f64)| {
                let share = axis.x * cos + axis.y * sin;
                // an unconstrained component has no share in the directions that are used
                if constrained(limits) { (share * limits.0).min(share * limits.1) } else { 0.0 }
            };
            let least = chord.x * cos
                + chord.y * sin
                + seen(scaled.target.forward(), longitudinal)
                + seen(scaled.target.left(), lateral);
            search.reaches.push(Reach { direction: Angle::new(direction), least });
        }
        search.common = search.linear_rows(curvature);
        Some(search)
    }

    /// Σ qᵢ cᵢ as a row in the unknowns; the turning rate of the start is L k₀.
    fn in_unknowns(&self, c: &[f64; K]) -> [f64; K] {
        let mut a = [0.0; K];
        a[..K - 1].copy_from_slice(&c[1..]);
        a[K - 1] = c[0] * self.scaled.start_curvature;
        a
    }

    /// Rows of the curvature bound, the end heading and the end curvature.
    fn linear_rows(&self, curvature: (f64, f64)) -> Vec<Row<K>> {
        let mut rows = Vec::with_capacity(2 * PLACES + 16);
        let bound = self.scaled.bounds[0];
        if bound < f64::INFINITY {
            for place in 1..=PLACES {
                let a = self.in_unknowns(&basis(|p| p.value(place as f64 / PLACES as f64)));
                for sign in [1.0, -1.0] {
                    let mut a = a.map(|v| sign * v);
                    a[K - 1] -= bound;
                    push(&mut rows, a, 0.0);
                }
            }
        }
        let end = self.in_unknowns(&Tables::<K>::WEIGHTS);
        between(&mut rows, end, self.heading);
        for (sign, limit) in [(1.0, curvature.1), (-1.0, -curvature.0)] {
            if limit.is_finite() {
                let mut a = [0.0; K];
                a[K - 2] = sign;
                a[K - 1] = -(sign * self.scaled.end_curvature + limit);
                push(&mut rows, a, 0.0);
            }
        }
        rows
    }

    /// Branch and bound, depth first.
    fn run(&self, boxes: usize) -> bool {
        let all = (f64::NEG_INFINITY, f64::INFINITY);
        let mut open = Vec::with_capacity(32);
        // long spirals are unlikely and their rows are weak, so the initial boxes grow with the length
        let mut low = self.shortest;
        let mut growth = 1.1;
        while low < LENGTHS.1 {
            let high = (low * growth).min(LENGTHS.1);
            open.push(Region { length: (low, high), headings: [all; MARKS.len()], guess: None });
            low = high;
            growth += 0.1;
        }
        let mut budget = boxes;
        while let Some(region) = open.pop() {
            if budget == 0 {
                return false;
            }
            budget -= 1;
            let Some(narrowed) = self.narrowed(region) else { continue };
            if let Remainder::Possible(guess) = self.remainder(&narrowed) {
                open.extend(Region { guess, ..narrowed }.halves());
            }
        }
        true
    }

    /// Largest |q| in a region, rad.
    fn turning(&self, region: &Region<K>) -> f64 {
        let [bound, rate] = self.scaled.bounds;
        let longest = region.length.1;
        (bound * longest).min(longest * (self.scaled.start_curvature.abs() + rate * longest))
    }

    /// Narrows the headings at the marks to those reachable from start, end and other marks; `None` if there are none.
    fn narrowed(&self, region: Region<K>) -> Option<Region<K>> {
        let turning = self.turning(&region);
        let mut narrowed = region;
        for (heading, u) in narrowed.headings.iter_mut().zip(MARKS) {
            *heading = self.reachable(&region, turning, u);
            if heading.0 > heading.1 {
                return None;
            }
        }
        Some(narrowed)
    }

    /// Headings at u that are reachable from start, end and marks.
    fn reachable(&self, region: &Region<K>, turning: f64, u: f64) -> (f64, f64) {
        let known = region.headings.iter().copied().zip(MARKS).chain([((0.0, 0.0), 0.0), (self.heading, 1.0)]);
        known.fold((f64::NEG_INFINITY, f64::INFINITY), |(low, high), (heading, at)| {
            let turned = turning * (u - at).abs();
            (low.max(heading.0 - turned), high.min(heading.1 + turned))
        })
    }

    /// Bounds a region by its relaxations.
    fn remainder(&self, region: &Region<K>) -> Remainder<K> {
        let turning = self.turning(region);
        let fine_enough = PANELS.iter().zip(&self.nodes).find(|((_, most), _)| turning <= *most);
        let nodes: &[Node<K>] = fine_enough.map_or(&[], |(_, nodes)| nodes);
        let mut tube = Vec::with_capacity(nodes.len());
        for node in nodes {
            let (low, high) = self.reachable(region, turning, node.u);
            if low > high {
                return Remainder::Empty;
            }
            tube.push([Angle::new(low), Angle::new(high)]);
        }
        let (mut low, mut high) = ([-turning; K], [turning; K]);
        (low[K - 1], high[K - 1]) = region.length;
        let mut rows = self.rows(region, &low, &high);
        let mut simplex = Simplex::new(&rows);
        let mut guess = region.guess;
        for round in 0..ROUNDS {
            let known = rows.len();
            if !nodes.is_empty() {
                self.position_rows(&mut rows, region, nodes, &tube, guess.as_ref());
            }
            if let Some(x) = guess.filter(|_| round > 0) {
                self.bound_rows(&mut rows, &x);
            }
            if round > 0 && rows.len() == known {
                break;
            }
            match simplex.run(&rows, &low, &high) {
                SimplexOutcome::Contradiction => return Remainder::Empty,
                SimplexOutcome::Stuck => break,
                SimplexOutcome::Point(x) => guess = Some(x),
            }
        }
        Remainder::Possible(guess)
    }

    /// Adds rows of the curvature bound where a relaxed solution violates it.
    fn bound_rows(&self, rows: &mut Vec<Row<K>>, x: &[f64; K]) {
        let bound = self.scaled.bounds[0];
        let length = x[K - 1];
        let mut knots = [0.0; K];
        knots[0] = length * self.scaled.start_curvature;
        knots[1..].copy_from_slice(&x[..K - 1]);
        let rate = Polynomial::through(&knots);
        for u in rate.roots_of_derivative(1).iter() {
            let value = rate.value(u);
            if value.abs() > bound * length {
                let mut a = self.in_unknowns(&basis(|p| value.signum() * p.value(u)));
                a[K - 1] -= bound;
                push(rows, a, 0.0);
            }
        }
    }

    /// The rows of a region except those of the position. The limits of each unknown come first: the simplex method starts
    /// from them.
    fn rows(&self, region: &Region<K>, low: &[f64; K], high: &[f64; K]) -> Vec<Row<K>> {
        let mut rows = Vec::with_capacity(2 * K + self.common.len() + 4 * PLACES + 2 * self.reaches.len() + 10);
        for (sign, limit) in [(1.0, high), (-1.0, low)] {
            for (i, limit) in limit.iter().enumerate() {
                let mut a = [0.0; K];
                a[i] = sign;
                rows.push(Row { a, b: sign * limit });
            }
        }
        rows.extend_from_slice(&self.common);
        self.rate_rows(&mut rows, region);
        for (mark, heading) in self.marks.iter().zip(region.headings) {
            between(&mut rows, self.in_unknowns(mark), heading);
        }
        rows
    }

    /// Adds rows of |κ'| ≤ rate: |Σ qᵢ Nᵢ'(u)| ≤ rate L², with L² below its secant; and of fixed rates at the ends, with L²
    /// between tangent and secant.
    fn rate_rows(&self, rows: &mut Vec<Row<K>>, region: &Region<K>) {
        let (short, long) = region.length;
        // L² ≤ slope L + constant, and above the tangent in the middle
        let secant = (short + long, -short * long);
        let middle = f64::midpoint(short, long);
        let tangent = (2.0 * middle, -middle * middle);
        let mut at_most = |u: f64, sign: f64, factor: f64| {
            let mut a = self.in_unknowns(&basis(|p| sign * p.derivative(u)));
            let line = if factor >= 0.0 { secant } else { tangent };
            a[K - 1] -= factor * line.0;
            push(rows, a, factor * line.1);
        };
        let rate = self.scaled.bounds[1];
        if rate < f64::INFINITY {
            for place in 0..=PLACES {
                at_most(place as f64 / PLACES as f64, 1.0, rate);
                at_most(place as f64 / PLACES as f64, -1.0, rate);
            }
        }
        for (end, rate) in self.scaled.rates.iter().enumerate() {
            if let Some(rate) = rate {
                at_most(end as f64, 1.0, *rate);
                at_most(end as f64, -1.0, -rate);
            }
        }
    }

    /// Adds rows Σ w · (line above cos(θ − δ)) ≥ least/L, with lines that are tightest near a guess.
    fn position_rows(
        &self,
        rows: &mut Vec<Row<K>>,
        region: &Region<K>,
        nodes: &[Node<K>],
        tube: &[[Angle; 2]],
        guess: Option<&[f64; K]>,
    ) {
        let (short, long) = region.length;
        let middle = f64::midpoint(short, long);
        let near = |node: &Node<K>, [low, high]: &[Angle; 2]| {
            let at = |x: &[f64; K]| dot(&self.in_unknowns(&node.turned), x).clamp(low.value, high.value);
            Angle::new(guess.map_or_else(|| f64::midpoint(low.value, high.value), at))
        };
        let near: Vec<Angle> = nodes.iter().zip(tube).map(|(node, sides)| near(node, sides)).collect();
        for Reach { direction, least } in &self.reaches {
            // least/L ≥ constant + slope L
            let (constant, slope) = if *least > 0.0 {
                (2.0 * least / middle, -least / (middle * middle))
            } else {
                (least / short + least / long, -least / (short * long))
            };
            let (mut c, mut b) = ([0.0; K], QUADRATURE - constant);
            for ((node, [low, high]), near) in nodes.iter().zip(tube).zip(&near) {
                let line = line_above_cosine(&low.from(direction), &high.from(direction), &near.from(direction));
                b += node.weight * (line.1 - line.0 * direction.value);
                for (c, turned) in c.iter_mut().zip(&node.turned) {
                    *c -= node.weight * line.0 * turned;
                }
            }
            let mut a = self.in_unknowns(&c);
            a[K - 1] += slope;
            push(rows, a, b);
        }
    }
}

impl<const K: usize> Region<K> {
    /// Halves the region in its widest dimension.
    fn halves(self) -> [Self; 2] {
        let (mut first, mut second) = (self, self);
        let width = |(low, high): (f64, f64)| high - low;
        let mut widest = None;
        for mark in 0..MARKS.len() {
            if width(self.headings[mark]) > widest.map_or(width(self.length), |mark: usize| width(self.headings[mark]))
            {
                widest = Some(mark);
            }
        }
        if let Some(mark) = widest {
            let middle = f64::midpoint(self.headings[mark].0, self.headings[mark].1);
            (first.headings[mark].1, second.headings[mark].0) = (middle, middle);
        } else {
            let middle = f64::midpoint(self.length.0, self.length.1);
            (first.length.1, second.length.0) = (middle, middle);
        }
        [first, second]
    }
}

/// ∫₀ᵘ of each basis polynomial.
fn turned<const K: usize>(u: f64) -> [f64; K] {
    basis(|p| p.integral(u))
}

/// A functional applied to each basis polynomial.
fn basis<const K: usize>(of: impl Fn(&Polynomial<K>) -> f64) -> [f64; K] {
    Tables::<K>::BASIS.map(|b| of(&Polynomial(b)))
}

/// Appends a·x ≤ b, scaled to a largest coefficient of one.
fn push<const K: usize>(rows: &mut Vec<Row<K>>, a: [f64; K], b: f64) {
    let largest = a.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    if largest > 0.0 && largest.is_finite() {
        rows.push(Row { a: a.map(|v| v / largest), b: b / largest });
    }
}

/// Appends low ≤ a·x ≤ high; limits that are not finite are omitted.
fn between<const K: usize>(rows: &mut Vec<Row<K>>, a: [f64; K], (low, high): (f64, f64)) {
    if high.is_finite() {
        push(rows, a, high);
    }
    if low.is_finite() {
        push(rows, a.map(|v| -v), -low);
    }
}

/// An angle with its sine and cosine.
#[derive(Debug, Clone, Copy)]
struct Angle {
    value: f64,
    cos: f64,
    sin: f64,
}

impl Angle {
    fn new(value: f64) -> Self {
        let (sin, cos) = value.sin_cos();
        Self { value, cos, sin }
    }

    /// The angle relative to a direction.
    fn from(&self, direction: &Self) -> Self {
        Self {
            value: self.value - direction.value,
            cos: self.cos * direction.cos + self.sin * direction.sin,
            sin: self.sin * direction.cos - self.cos * direction.sin,
        }
    }
}

/// A line (slope, constant) above the cosine on [low, high] that touches it: the tangent at `near` where the cosine is
/// concave, the secant where it is convex, moved up until it is above everywhere.
fn line_above_cosine(low: &Angle, high: &Angle, near: &Angle) -> (f64, f64) {
    use std::f64::consts::{PI, TAU};
    /// The slope of a secant over a narrower interval is dominated by rounding.
    const NARROW: f64 = 1e-6;
    let width = high.value - low.value;
    let concave = near.cos > 0.0;
    let slope = if concave || width < NARROW { -near.sin } else { (high.cos - low.cos) / width };
    let mut constant = (low.cos - slope * low.value).max(high.cos - slope * high.value);
    // convex on the whole interval: the secant is above
    if !concave && width < PI && low.cos <= 0.0 && high.cos <= 0.0 {
        return (slope, constant);
    }
    // the maximum of cos x − slope x is at sin x = −slope with cos x > 0: at −asin(slope) + 2πn inside the interval
    let (peak, height) = if concave {
        (near.value, near.cos)
    } else {
        let sine = slope.clamp(-1.0, 1.0);
        (-sine.asin(), (1.0 - sine * sine).sqrt())
    };
    let mut x = if concave && width < TAU { peak } else { peak + TAU * ((low.value - peak) / TAU).ceil() };
    while x <= high.value {
        constant = constant.max(height - slope * x);
        x += TAU;
    }
    (slope, constant)
}

/// Dual simplex method for: minimise t with aᵢ·x − t ≤ bᵢ. Rows may be appended between runs.
struct Simplex<const K: usize> {
    /// Rows that hold with equality, K + 1 of them.
    basis: [usize; MAX_UNKNOWNS],
    /// Inverse of their matrix: row by unknown (x, then t), column by row of the basis.
    inverse: [[f64; MAX_UNKNOWNS]; MAX_UNKNOWNS],
}

/// Outcome of a run of the simplex method.
enum SimplexOutcome<const K: usize> {
    /// The rows contradict each other; verified.
    Contradiction,
    /// A point that violates rows by at most [`MARGIN`].
    Point([f64; K]),
    /// Undecided.
    Stuck,
}

impl<const K: usize> Simplex<K> {
    /// Initial basis: all upper limits and the first lower limit. The rows must begin with xᵢ ≤ … for all i, then −xᵢ ≤ ….
    fn new(rows: &[Row<K>]) -> Self {
        debug_assert!(rows.len() >= 2 * K);
        let mut basis = [0; MAX_UNKNOWNS];
        for (i, row) in basis.iter_mut().enumerate().take(K + 1) {
            *row = i;
        }
        // rows: xᵢ − t = r₀…, −x₀ − t = r_K  ⇒  t = −(r₀ + r_K)/2, xᵢ = rᵢ + t
        let mut inverse = [[0.0; MAX_UNKNOWNS]; MAX_UNKNOWNS];
        for (i, row) in inverse.iter_mut().enumerate().take(K + 1) {
            if i < K {
                row[i] = 1.0;
            }
            row[0] -= 0.5;
            row[K] -= 0.5;
        }
        Self { basis, inverse }
    }

    /// Runs to the optimum or to a contradiction.
    fn run(&mut self, rows: &[Row<K>], low: &[f64; K], high: &[f64; K]) -> SimplexOutcome<K> {
        for _ in 0..EXCHANGES {
            let mut z = [0.0; MAX_UNKNOWNS];
            for (z, inverse) in z.iter_mut().zip(&self.inverse).take(K + 1) {
                *z = (0..=K).map(|i| inverse[i] * rows[self.basis[i]].b).sum();
            }
            if z[K] > MARGIN {
                return if self.adds_up(rows, low, high) {
                    SimplexOutcome::Contradiction
                } else {
                    SimplexOutcome::Stuck
                };
            }
            let mut x = [0.0; K];
            x.copy_from_slice(&z[..K]);
            let (mut worst, mut entering) = (1e-9, None);
            for (i, row) in rows.iter().enumerate() {
                let off = dot(&row.a, &x) - z[K] - row.b;
                if off > worst {
                    (worst, entering) = (off, Some(i));
                }
            }
            let Some(entering) = entering else { return SimplexOutcome::Point(x) };
            if !self.exchange(&rows[entering], entering) {
                return SimplexOutcome::Stuck;
            }
        }
        SimplexOutcome::Stuck
    }

    /// Brings a row into the basis and removes the one that keeps all multipliers non-negative; `false` if there is none.
    fn exchange(&mut self, row: &Row<K>, entering: usize) -> bool {
        /// Smaller values are rounding.
        const NEGLIGIBLE: f64 = 1e-10;
        let mut shares = [0.0; MAX_UNKNOWNS];
        for (i, share) in shares.iter_mut().enumerate().take(K + 1) {
            *share =
                row.a.iter().zip(&self.inverse).map(|(a, inverse)| a * inverse[i]).sum::<f64>() - self.inverse[K][i];
        }
        let mut leaving: Option<(f64, usize)> = None;
        for (i, share) in shares.iter().enumerate().take(K + 1).filter(|(_, share)| **share > NEGLIGIBLE) {
            let ratio = -self.inverse[K][i] / share;
            let better =
                leaving.is_none_or(|(least, at)| ratio < least - 1e-12 || ratio < least + 1e-12 && *share > shares[at]);
            if better {
                leaving = Some((ratio, i));
            }
        }
        let Some((_, leaving)) = leaving else { return false };
        for line in self.inverse.iter_mut().take(K + 1) {
            let scaled = line[leaving] / shares[leaving];
            for (i, entry) in line.iter_mut().enumerate().take(K + 1) {
                if i == leaving {
                    *entry = scaled;
                } else {
                    *entry -= shares[i] * scaled;
                }
            }
        }
        self.basis[leaving] = entering;
        true
    }

    /// Whether the rows of the basis, times their multipliers, add up to a contradiction for all x within the limits.
    fn adds_up(&self, rows: &[Row<K>], low: &[f64; K], high: &[f64; K]) -> bool {
        let (mut a, mut b, mut all) = ([0.0; K], 0.0, 0.0);
        for (i, row) in self.basis.iter().enumerate().take(K + 1) {
            let multiplier = (-self.inverse[K][i]).max(0.0);
            for (sum, entry) in a.iter_mut().zip(&rows[*row].a) {
                *sum += multiplier * entry;
            }
            b += multiplier * rows[*row].b;
            all += multiplier;
        }
        let least: f64 = (0..K).map(|i| (a[i] * low[i]).min(a[i] * high[i])).sum();
        least - b > 0.5 * MARGIN * all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convex::{QuadraticProgram, Status, Term};
    use crate::geometry::Pose;
    use crate::geometry::boundary::Problem;
    use crate::geometry::boundary::reference::Rng;
    use crate::geometry::spiral::Spiral;
    use proptest::prelude::*;

    const ORIGIN: Pose = Pose { position: crate::geometry::Point::new(0.0, 0.0), yaw: 0.0 };

    /// A problem that the spiral solves by construction, with bounds equal to its extrema.
    fn solved_by<const K: usize>(spiral: &Spiral<K>, loosened: [f64; 4], rates: bool) -> Problem {
        let end = spiral.end(&ORIGIN);
        let [longitudinal, lateral, heading, curvature] = loosened.map(|by| match by {
            by if by < 0.0 => EndCondition::Fixed,
            by if by > 1.0 => EndCondition::Free,
            by => EndCondition::Range(-by, 0.3 * by),
        });
        Problem {
            longitudinal,
            lateral,
            heading,
            curvature,
            max_curvature: spiral.max_abs_curvature(),
            max_curvature_rate: if rates { spiral.max_abs_curvature_rate() } else { f64::INFINITY },
            ..Problem::pinned(spiral.knots[0], end, spiral.knots[K - 1])
        }
    }

    fn check_not_infeasible<const K: usize>(
        knots: [f64; K],
        loosened: [f64; 4],
        rates: bool,
    ) -> Result<(), TestCaseError> {
        let spiral = Spiral { knots: knots.map(|k| 0.15 * k), length: 18.0 };
        let end = spiral.end(&ORIGIN);
        let chord = end.position.coords.norm();
        // within the permitted lengths, and without whole turns of heading
        prop_assume!(chord > 6.5 && end.yaw.abs() < 3.0 && end.position.x > 0.0);
        let problem = solved_by(&spiral, loosened, rates);
        prop_assert!(!is_infeasible(&Scaled::<K>::new(&problem), 40), "{spiral:?} {problem:?}");
        Ok(())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1500))]

        #[test]
        fn never_certifies_a_feasible_problem(
            knots in prop::array::uniform6(-1.0..1.0f64), loosened in prop::array::uniform4(-2.0..1.5f64), rates: bool,
        ) {
            check_not_infeasible(knots, loosened, rates)?;
            let [a, b, c, d, ..] = knots;
            check_not_infeasible([a, b, c, d], loosened, rates)?;
        }

        #[test]
        fn the_line_is_above_the_cosine_and_touches_it(low in -7.0..7.0f64, width in 0.0..9.0f64, at in 0.0..=1.0f64) {
            let high = low + width;
            let near = low + at * width;
            let [low, high, near] = [low, high, near].map(Angle::new);
            let (slope, constant) = line_above_cosine(&low, &high, &near);
            let mut least = f64::INFINITY;
            for i in 0..=2000 {
                let x = low.value + width * f64::from(i) / 2000.0;
                least = least.min(slope * x + constant - x.cos());
            }
            prop_assert!(least > -1e-12 && least < 1e-4, "{least:e}");
        }

        /// Agrees with Clarabel: a contradiction if and only if no point satisfies all rows.
        #[test]
        fn contradictions_agree_with_clarabel(
            entries in prop::collection::vec((prop::array::uniform4(-1.0..1.0f64), -0.6..1.0f64), 3..14)
        ) {
            let (low, high) = ([-2.0; 4], [2.0; 4]);
            let mut rows: Vec<Row<4>> = Vec::new();
            for sign in [1.0, -1.0] {
                for i in 0..4 {
                    let mut a = [0.0; 4];
                    a[i] = sign;
                    rows.push(Row { a, b: 2.0 });
                }
            }
            for (a, b) in &entries {
                push(&mut rows, *a, *b);
            }
            // least t with a·x − t ≤ b
            let mut program = QuadraticProgram::new(5);
            program.add_linear(4, 1.0);
            for row in &rows {
                let mut terms: Vec<Term> = row.a.iter().copied().enumerate().collect();
                terms.push((4, -1.0));
                program.between(f64::NEG_INFINITY, &terms, row.b);
            }
            let solution = program.solve();
            prop_assert_eq!(solution.status, Status::Solved);
            let t = solution.x[4];
            prop_assume!(t.abs() > 1e-5);
            match Simplex::new(&rows).run(&rows, &low, &high) {
                SimplexOutcome::Contradiction => prop_assert!(t > 0.0, "{t}"),
                SimplexOutcome::Point(x) => {
                    let worst = rows.iter().map(|r| r.a.iter().zip(&x).map(|(a, x)| a * x).sum::<f64>() - r.b);
                    prop_assert!(t < 0.0 && worst.fold(f64::NEG_INFINITY, f64::max) < MARGIN, "{t}");
                }
                SimplexOutcome::Stuck => prop_assert!(false, "stuck"),
            }
        }
    }

    #[test]
    fn only_contradicting_rows_add_up() {
        let rows: Vec<Row<1>> = vec![Row { a: [1.0], b: 1.0 }, Row { a: [-1.0], b: 1.0 }];
        let simplex = Simplex::<1>::new(&rows);
        assert!(!simplex.adds_up(&rows, &[-1.0], &[1.0]));
        let rows: Vec<Row<1>> = vec![Row { a: [1.0], b: -1.0 }, Row { a: [-1.0], b: -1.0 }];
        assert!(Simplex::<1>::new(&rows).adds_up(&rows, &[-1.0], &[1.0]));
        // rows that do not cancel are no contradiction if x may be large
        let rows: Vec<Row<1>> = vec![Row { a: [1.0], b: -1.0 }, Row { a: [-0.5], b: -0.1 }];
        assert!(!Simplex::<1>::new(&rows).adds_up(&rows, &[-10.0], &[10.0]));
    }

    /// Headings that turn at the permitted rate with as many reversals as a quintic has.
    #[test]
    fn quadrature_error_is_below_its_bound() {
        let mut rng = Rng(5);
        let nodes = |panels: usize| {
            (0..panels).flat_map(move |panel| {
                GAUSS_8.map(|(node, weight)| ((panel as f64 + node) / panels as f64, weight / panels as f64))
            })
        };
        for (panels, most) in PANELS {
            let mut worst = 0.0_f64;
            for case in 0..2000 {
                // the Chebyshev polynomial of degree five oscillates most
                let chebyshev = |u: f64| (5.0 * (2.0 * u - 1.0).clamp(-1.0, 1.0).acos()).cos();
                let knots: [f64; 6] =
                    std::array::from_fn(|i| if case == 0 { chebyshev(i as f64 / 5.0) } else { rng.sample() });
                let spiral = Spiral { knots, length: 1.0 };
                let share = most / spiral.max_abs_curvature();
                let heading = spiral.curvature_polynomial();
                let sum = |panels| {
                    let (mut x, mut y) = (0.0, 0.0);
                    for (u, weight) in nodes(panels) {
                        let (sin, cos) = (share * heading.integral(u)).sin_cos();
                        (x, y) = (x + weight * cos, y + weight * sin);
                    }
                    (x, y)
                };
                let ((x, y), (finer_x, finer_y)) = (sum(panels), sum(16));
                worst = worst.max((x - finer_x).hypot(y - finer_y));
            }
            println!("{panels} panels, {most} rad: {worst:e}");
            assert!(worst < QUADRATURE, "{panels} panels: {worst:e}");
        }
    }
}
