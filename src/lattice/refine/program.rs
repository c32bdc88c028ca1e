//! The convex program of one iteration: the cost of the lattice, linearised about a chain.
//!
//! Variables are the changes of inner knots, lengths, and poses at the joints. The joints keep the rows short: a sample
//! depends only on its own piece and the preceding joint, and equalities link consecutive joints. The end does not move.

use super::chain::{Chain, Sample, basis, basis_slope, quarter_turn};
use super::corridor::FreeWidth;
use crate::convex::{QuadraticProgram, Term};
use crate::geometry::quadrature::GAUSS_5;
use crate::geometry::steps::fitting;
use crate::geometry::{Pose, Vector};
use crate::lattice::edges::{COST_SAMPLES, OFFSET_SATURATES};
use crate::lattice::{LatticeContext, Weights};
use crate::reference::Frenet;

/// The data that all iterations share.
pub(super) struct Program<'a> {
    pub(super) context: &'a LatticeContext<'a>,
    pub(super) weights: Weights,
    /// Frame of the chains.
    pub(super) frame: Pose,
    /// Distance from the rear axle to the front bumper, m.
    pub(super) front: f64,
    /// Largest |κ| anywhere, 1/m.
    pub(super) max_curvature: f64,
    /// Largest |dκ/ds| anywhere, 1/m².
    pub(super) max_curvature_rate: f64,
    /// Largest bending energy, 1/m.
    pub(super) bending_energy: f64,
    /// Samples of the original chain with the free width around them.
    pub(super) corridor: Vec<Vec<(Sample, FreeWidth)>>,
    /// Points of the committed path.
    pub(super) anchors: Vec<Anchor>,
    /// Cost per metre of the largest lateral distance from them.
    pub(super) departure_weight: f64,
}

/// A point of the committed path.
#[derive(Debug, Clone, Copy)]
pub(super) struct Anchor {
    /// Distance from the start of the chain, m.
    pub(super) distance: f64,
    /// Pose of the committed path, in the frame of the chain.
    pub(super) pose: Pose,
}

/// Largest relative change of a length in one iteration.
const LENGTH_STEP: f64 = 0.1;
/// Regularisation of changes of a length, per m².
const LENGTH_INERTIA: f64 = 1e-5;
/// Number of intervals between the bound rows of curvature and curvature rate in a piece.
const CUTS: usize = 9;
/// Relative tightening of these rows: between them both may be slightly larger.
const BOUND_RESERVE: f64 = 0.005;

/// A program under construction about a chain.
struct Builder<'a> {
    fixed: &'a Program<'a>,
    chain: &'a Chain,
    /// Trust region of the lateral displacement, m.
    radius: f64,
    program: QuadraticProgram,
    /// Change of curvature by one unit of a knot's variable, 1/m.
    knot_unit: f64,
    /// Change of heading by one unit of a joint's variable, rad.
    heading_unit: f64,
}

impl Program<'_> {
    /// The best chain within a lateral displacement of `radius` (m) from `chain`; its end is preserved to first order.
    /// `None` if the solver fails.
    pub(super) fn step(&self, chain: &Chain, radius: f64) -> Option<Chain> {
        let mut builder = self.about(chain, radius)?;
        let next = builder.solved()?;
        let (curvature, rate) = (next.max_abs_curvature(), next.max_abs_curvature_rate());
        let bends_more = next.bending_energy() > self.bending_energy;
        if curvature <= self.max_curvature && rate <= self.max_curvature_rate && !bends_more {
            return Some(next);
        }
        // add bounds only if they are violated, which is rare
        if bends_more {
            builder.bound_bending();
        }
        for i in 0..chain.pieces() {
            if curvature > self.max_curvature {
                builder.bound_curvature(i);
            }
            if rate > self.max_curvature_rate {
                builder.bound_curvature_rate(i);
            }
        }
        builder.solved()
    }

    fn intervals(&self) -> Vec<usize> {
        self.corridor.iter().map(Vec::len).collect()
    }

    fn about<'a>(&'a self, chain: &'a Chain, radius: f64) -> Option<Builder<'a>> {
        let mean = chain.length() / chain.pieces() as f64;
        let variables = 3 * chain.pieces() - 1 + chain.pieces() + 3 * (chain.pieces() - 1);
        let mut builder = Builder {
            fixed: self,
            chain,
            radius,
            program: QuadraticProgram::new(variables),
            knot_unit: mean.powi(-2),
            heading_unit: 1.0 / mean,
        };
        let samples = chain.linearised(&self.intervals());
        let mut about = self.context.reference.project(self.frame.position).s;
        for (i, piece) in samples.iter().enumerate() {
            builder.follow(i, piece.last()?);
            builder.add_bending(i);
            builder.bound_displacement(i, piece);
            builder.add_clearance(i, piece);
            about = builder.add_offsets(i, piece, about);
        }
        builder.add_anchors(&samples);
        Some(builder)
    }
}

impl Builder<'_> {
    fn solved(&self) -> Option<Chain> {
        let solution = self.program.solve();
        if !solution.is_usable() {
            return None;
        }
        let mut next = self.chain.clone();
        let last = next.knots.len() - 1;
        for (knot, x) in next.knots[1..last].iter_mut().zip(&solution.x) {
            *knot += self.knot_unit * x;
        }
        for (length, x) in next.lengths.iter_mut().zip(&solution.x[last - 1..]) {
            *length += x;
        }
        Some(next)
    }

    /// Variable of knot `j` of piece `i`; `None` for the ends of the chain.
    fn knot(&self, i: usize, j: usize) -> Option<usize> {
        let knot = 3 * i + j;
        (knot > 0 && knot < 3 * self.chain.pieces()).then(|| knot - 1)
    }

    fn length(&self, i: usize) -> usize {
        3 * self.chain.pieces() - 1 + i
    }

    /// First of the three variables of the joint after piece `i`; `None` for the end of the chain.
    fn joint(&self, i: usize) -> Option<usize> {
        let pieces = self.chain.pieces();
        (i + 1 < pieces).then(|| 4 * pieces - 1 + 3 * i)
    }

    /// A linear combination of the knots of a piece; the weights are for changes of curvature.
    fn knots(&self, i: usize, weights: &[f64]) -> Vec<Term> {
        let term = |(j, w): (usize, &f64)| Some((self.knot(i, j)?, w * self.knot_unit));
        weights.iter().enumerate().filter_map(term).collect()
    }

    /// Displacement of a sample of piece `i` in a direction, m, for the point of the vehicle `ahead` of the rear axle.
    fn moved(&self, i: usize, s: &Sample, direction: Vector, ahead: f64) -> Vec<Term> {
        // a point ahead of the rear axle moves laterally with the heading
        let swing = ahead * direction.dot(&quarter_turn(s.pose.forward()));
        let by: [f64; 5] = std::array::from_fn(|j| direction.dot(&s.position_by[j]) + swing * s.heading_by[j]);
        let mut terms = self.knots(i, &by[..4]);
        terms.push((self.length(i), by[4]));
        if let Some(joint) = i.checked_sub(1).and_then(|before| self.joint(before)) {
            let lever = direction.dot(&quarter_turn(s.lever)) + swing;
            terms.extend([(joint, direction.x), (joint + 1, direction.y), (joint + 2, lever * self.heading_unit)]);
        }
        terms
    }

    /// Change of the heading at a sample of piece `i`, rad.
    fn turned(&self, i: usize, s: &Sample) -> Vec<Term> {
        let mut terms = self.knots(i, &s.heading_by[..4]);
        terms.push((self.length(i), s.heading_by[4]));
        if let Some(joint) = i.checked_sub(1).and_then(|before| self.joint(before)) {
            terms.push((joint + 2, self.heading_unit));
        }
        terms
    }

    /// Links the joint after piece `i` to the end of the piece.
    fn follow(&mut self, i: usize, end: &Sample) {
        let rows = [self.moved(i, end, Vector::x(), 0.0), self.moved(i, end, Vector::y(), 0.0), self.turned(i, end)];
        for (n, mut row) in rows.into_iter().enumerate() {
            if let Some(joint) = self.joint(i) {
                row.push((joint + n, if n == 2 { -self.heading_unit } else { -1.0 }));
            }
            self.program.equal(&row, 0.0);
        }
    }

    /// Adds the bending energy of piece `i`: exact in the knots (κ² has degree six), linear in the length.
    fn add_bending(&mut self, i: usize) {
        let (spiral, variable) = (self.chain.spiral(i), self.length(i));
        let length = spiral.length;
        for (node, weight) in &GAUSS_5 {
            let terms = self.knots(i, &basis(*node));
            let weight = self.fixed.weights.curvature * length * weight;
            self.program.add_square(weight, &terms, -spiral.curvature(node * length));
        }
        self.program.add_linear(variable, self.fixed.weights.curvature * spiral.bending_energy() / length);
        self.program.add_square(LENGTH_INERTIA, &[(variable, 1.0)], 0.0);
        let step = LENGTH_STEP * length;
        self.program.between(-step, &[(variable, 1.0)], step);
    }

    /// Bounds the bending energy of the whole chain with its present lengths, by a second-order cone.
    fn bound_bending(&mut self) {
        /// Relative reserve for changes of the lengths.
        const RESERVE: f64 = 1e-3;
        let mut parts: Vec<(Vec<Term>, f64)> = Vec::new();
        let bound = (self.fixed.bending_energy * (1.0 - RESERVE)).sqrt();
        for i in 0..self.chain.pieces() {
            let spiral = self.chain.spiral(i);
            for (node, weight) in &GAUSS_5 {
                // relative to the bound, so that the cone has the size of one
                let root = (weight * spiral.length).sqrt() / bound;
                let terms = self.knots(i, &basis(*node).map(|w| root * w));
                parts.push((terms, root * spiral.curvature(node * spiral.length)));
            }
        }
        let inner: Vec<(&[Term], f64)> = parts.iter().map(|(terms, now)| (terms.as_slice(), *now)).collect();
        self.program.norm_at_most(&inner, (&[], 1.0));
    }

    /// Bounds |κ| of piece `i` at some points; the values between them are checked in closed form afterwards.
    fn bound_curvature(&mut self, i: usize) {
        let spiral = self.chain.spiral(i);
        for cut in 0..=CUTS {
            let u = cut as f64 / CUTS as f64;
            let here = spiral.curvature(u * spiral.length);
            let bound = ((1.0 - BOUND_RESERVE) * self.fixed.max_curvature).max(here.abs());
            let terms = self.knots(i, &basis(u));
            if !terms.is_empty() {
                self.program.between(-bound - here, &terms, bound - here);
            }
        }
    }

    /// Bounds |dκ/ds| of piece `i` at some points; this is linear in the length as well.
    fn bound_curvature_rate(&mut self, i: usize) {
        let (spiral, length) = (self.chain.spiral(i), self.length(i));
        for cut in 0..=CUTS {
            let u = cut as f64 / CUTS as f64;
            let here = spiral.curvature_rate(u * spiral.length);
            let bound = ((1.0 - BOUND_RESERVE) * self.fixed.max_curvature_rate).max(here.abs());
            // −bound (L + δL) ≤ derivative by u ≤ bound (L + δL)
            for side in [1.0, -1.0] {
                let mut terms = self.knots(i, &basis_slope(u).map(|w| side * w));
                terms.push((length, -bound));
                self.program.between(f64::NEG_INFINITY, &terms, (bound - side * here) * spiral.length);
            }
        }
    }

    /// Bounds rear axle and front by the free width where that is narrow, and the rear axle by the trust region.
    fn bound_displacement(&mut self, i: usize, samples: &[Sample]) {
        let (corridor, radius) = (&self.fixed.corridor[i], self.radius);
        let stride = samples.len() / COST_SAMPLES;
        // the end of the chain does not move
        let movable = samples.len() - usize::from(i + 1 == self.chain.pieces());
        for (n, (s, (original, free_width))) in samples.iter().zip(corridor).enumerate().take(movable) {
            let narrow = free_width.left.min(free_width.right) < radius;
            if !narrow && (n + 1) % stride != 0 {
                continue;
            }
            for ahead in [Some(0.0), narrow.then_some(self.fixed.front)].into_iter().flatten() {
                let now = displaced(s, original, ahead);
                // correct violations of the last linearisation as far as the trust region permits
                let (least, most) =
                    ((-free_width.right - now).clamp(-radius, radius), (free_width.left - now).clamp(-radius, radius));
                let terms = self.moved(i, s, original.pose.left(), ahead);
                self.program.between(least, &terms, most);
            }
        }
    }

    /// Adds the clearance cost of piece `i`: the square of the largest shortfall of clearance, as in the lattice.
    fn add_clearance(&mut self, i: usize, samples: &[Sample]) {
        let (weights, corridor) = (&self.fixed.weights, &self.fixed.corridor[i]);
        let desired = weights.desired_clearance;
        if desired <= 0.0 {
            return;
        }
        let middle = 0.5 * self.fixed.front;
        let mut rows = Vec::new();
        for (s, (original, free_width)) in samples.iter().zip(corridor) {
            let now = displaced(s, original, middle);
            for (clearance, slope) in &free_width.clearance {
                let here = clearance + slope * now;
                if here - slope.abs() * self.radius < desired {
                    let terms = self.moved(i, s, original.pose.left() * (slope / desired), middle);
                    rows.push((terms, 1.0 - here / desired));
                }
            }
        }
        if rows.is_empty() {
            return;
        }
        let shortfall = self.program.add_variable();
        self.program.add_square(weights.clearance * self.chain.lengths[i], &[(shortfall, 1.0)], 0.0);
        self.program.between(0.0, &[(shortfall, 1.0)], f64::INFINITY);
        for (mut terms, missing) in rows {
            terms.push((shortfall, 1.0));
            self.program.between(missing, &terms, f64::INFINITY);
        }
    }

    /// Adds the offset and lane-deviation costs of piece `i`, at the samples of the lattice. Takes a station near the start
    /// and returns one near the end of the piece.
    fn add_offsets(&mut self, i: usize, samples: &[Sample], mut about: f64) -> f64 {
        let (weights, context) = (&self.fixed.weights, self.fixed.context);
        let stride = samples.len() / COST_SAMPLES;
        let spacing = self.chain.lengths[i] / COST_SAMPLES as f64;
        let mut by_length = 0.0;
        for s in samples.iter().skip(stride - 1).step_by(stride) {
            let place = self.fixed.frame.to_world(s.pose.position);
            let Frenet { s: station, l } = context.reference.project_near(place, about + spacing);
            about = station;
            let normal = Pose { yaw: context.reference.at(station).pose.yaw - self.fixed.frame.yaw, ..s.pose }.left();
            let terms = self.moved(i, s, normal, 0.0);
            by_length += weights.offset * l.abs().min(OFFSET_SATURATES).powi(2);
            if l.abs() < OFFSET_SATURATES {
                self.program.add_square(weights.offset * spacing, &terms, -l);
            }
            let (left, right) = context.reference.lane_bounds(station);
            let sides = [(1.0, l + context.half_width - left), (-1.0, context.half_width - l - right)];
            by_length += weights.lane_deviation * sides[0].1.max(sides[1].1).max(0.0);
            if sides.iter().all(|(_, over)| *over <= -self.radius) {
                continue;
            }
            let over = self.program.add_variable();
            self.program.add_linear(over, weights.lane_deviation * spacing);
            self.program.between(0.0, &[(over, 1.0)], f64::INFINITY);
            for (side, now) in sides {
                let mut row: Vec<Term> = terms.iter().map(|(variable, by)| (*variable, -side * by)).collect();
                row.push((over, 1.0));
                self.program.between(now, &row, f64::INFINITY);
            }
        }
        let length = self.length(i);
        self.program.add_linear(length, by_length / COST_SAMPLES as f64);
        about
    }

    /// Adds the cost of the largest lateral distance from the committed path, at the samples next to its points.
    fn add_anchors(&mut self, samples: &[Vec<Sample>]) {
        /// A point at a joint up to rounding belongs to the piece before it, m.
        const AT_JOINT: f64 = 1e-6;
        if self.fixed.anchors.is_empty() {
            return;
        }
        let largest = self.program.add_variable();
        self.program.add_linear(largest, self.fixed.departure_weight);
        for anchor in &self.fixed.anchors {
            let mut begins = 0.0;
            let piece = self.chain.lengths.iter().position(|length| {
                begins += length;
                anchor.distance <= begins + AT_JOINT
            });
            let Some(i) = piece else { continue };
            let (length, count) = (self.chain.lengths[i], samples[i].len());
            let u = 1.0 - (begins - anchor.distance) / length;
            let nearest = fitting(u * count as f64 + 0.5, 1.0).clamp(1, count) - 1;
            let s = samples[i][nearest];
            // straight from the sample to the compared point, which is near
            let ahead = (u - s.u) * length;
            let now = anchor.pose.to_local(s.pose.advanced(ahead).position).y;
            let moved = self.moved(i, &s, anchor.pose.left(), ahead);
            // largest ≥ ±(now + moved)
            for side in [1.0, -1.0] {
                let mut row: Vec<Term> = moved.iter().map(|(variable, by)| (*variable, -side * by)).collect();
                row.push((largest, 1.0));
                self.program.between(side * now, &row, f64::INFINITY);
            }
        }
    }
}

/// Displacement of a sample to the left of the original one, m, at a point of the vehicle ahead of the rear axle.
pub(super) fn displaced(s: &Sample, original: &Sample, ahead: f64) -> f64 {
    let (now, then) = (s.pose.advanced(ahead), original.pose.advanced(ahead));
    original.pose.left().dot(&(now.position - then.position))
}
