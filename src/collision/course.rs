//! A path divided into cells, with vehicle frames on demand.
//!
//! # Technique
//! The curvature of a spiral is a cubic of arc length, so that each section has simple algebra. The Taylor coefficients at
//! its start give the exact heading. Its Bernstein coefficients bound |κ| and |κ′| (a polynomial is within the hull of its
//! Bernstein coefficients; Farin, *Curves and Surfaces for CAGD*, ch. 5). Gauss quadrature of a heading that turns little
//! needs no trigonometric function.
//!
//! The frame at cell limit `i` is computed from the one at `i` with its lowest set bit cleared (as in a Fenwick tree),
//! starting at its block; block starts are computed one after the other. So the computation of a frame does not depend on
//! the order of the queries, and the coarse check ([`super::coarse`]), which needs few frames, uses the same bits as the
//! [`super::Sweep`], which has all of them.
//!
//! A cell that meets something is divided into equal parts ([`Subcell`]), whose frames start from that of the cell.
//!
//! # Cell length
//! [`super::CollisionSettings::spacing`], or an integer fraction of it if the spiral turns so much that the excess of the
//! footprint would be larger than [`EXCESS`] (see [`excess`]). The station cells of the blocked grid keep the spacing, so
//! that the speed search does not depend on the curvature of the spiral.

use super::convert::{Local, Origin};
use super::swept::{Body, Frame, SKIN};
use crate::geometry::Pose;
use crate::geometry::quadrature::{GAUSS_3, GAUSS_5, GAUSS_8};
use crate::geometry::spiral::CubicSpiral;
use crate::geometry::steps::covering;

/// Largest excess of the footprint of a cell over the covered area, as a fraction of the spacing: 4.5 cm at 0.5 m.
pub(super) const EXCESS: f64 = 0.09;
/// Largest length of a subcell, m.
pub(super) const FINE_SPACING: f64 = 0.1;
/// Largest number of cells per station cell.
const MAX_CUTS: usize = 8;
/// Largest number of cells and largest length (m) of a block. Blocks are as long as ε permits.
const MAX_IN_BLOCK: usize = 32;
const MAX_BLOCK_LENGTH: f64 = 9.0;
/// Largest ε of a block, m: a larger coarse hull excludes too few pieces.
const BLOCK_SLACK: f64 = 0.25;

/// A section of a spiral: curvature by powers of t ∈ [0, 1].
#[derive(Debug, Clone, Copy)]
struct Stretch {
    /// Coefficients of the curvature, 1/m.
    powers: [f64; 4],
    /// Length, m.
    length: f64,
}

impl Stretch {
    /// Upper bounds of |κ| (1/m) and |κ′| (1/m²).
    fn bounds(&self) -> (f64, f64) {
        let [a, b, c, d] = self.powers;
        let bernstein = [a, a + b / 3.0, a + (2.0 * b + c) / 3.0, a + b + c + d];
        let k = bernstein.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let k1 = bernstein.windows(2).fold(0.0, |m: f64, w| m.max((w[1] - w[0]).abs()));
        (k, 3.0 * k1 / self.length)
    }

    /// Change of heading from its start to t, rad.
    fn turned(&self, t: f64) -> f64 {
        let [a, b, c, d] = self.powers;
        self.length * t * (a + t * (b / 2.0 + t * (c / 3.0 + t * (d / 4.0))))
    }

    /// Its second half.
    fn second_half(&self) -> Self {
        let [a, b, c, d] = self.powers;
        let at_half = [a + 0.5 * (b + 0.5 * (c + 0.5 * d)), b + c + 0.75 * d, c + 1.5 * d, d];
        Self { powers: at_half, length: self.length }.first_half()
    }

    fn first_half(&self) -> Self {
        let [a, b, c, d] = self.powers;
        Self { powers: [a, 0.5 * b, 0.25 * c, 0.125 * d], length: 0.5 * self.length }
    }

    /// The vector from its start to its end, in the frame of its start, m. `halvings` limits the work for absurd curvature.
    fn chord(&self, halvings: u32) -> Local {
        /// Turning, and its part from varying curvature (rad; a tenth of the linear variation), up to which the three-point
        /// rule has an error below 2e-10 of the length: the square of the latter and the cube of the linear variation are
        /// the first terms that the rule does not integrate exactly.
        const THREE: (f64, f64) = (0.08, 0.0015);
        /// The same for the five-point rule.
        const FIVE: (f64, f64) = (0.25, 0.08);
        /// Turning up to which the eight-point rule is sufficient for any cubic.
        const EIGHT: f64 = 0.6;
        let turning = self.length * self.bounds().0;
        let uneven = self.length * (0.1 * self.powers[1].abs() + self.powers[2].abs() + self.powers[3].abs());
        let within = |(max, max_uneven): (f64, f64)| turning <= max && uneven <= max_uneven;
        if within(THREE) {
            self.rule(&GAUSS_3)
        } else if within(FIVE) {
            self.rule(&GAUSS_5)
        } else if turning <= EIGHT || halvings == 0 {
            self.rule(&GAUSS_8)
        } else {
            let (sin, cos) = self.turned(0.5).sin_cos();
            let second = self.second_half().chord(halvings - 1);
            self.first_half().chord(halvings - 1) + Local::new(cos, sin).rotate(second)
        }
    }

    fn rule(&self, rule: &[(f64, f64)]) -> Local {
        let mut sum = Local::ZERO;
        for (t, weight) in rule {
            let (sin, cos) = small_sin_cos(self.turned(*t));
            sum += Local::new(cos, sin) * *weight;
        }
        sum * self.length
    }
}

/// Sine and cosine by Taylor series, accurate to 1e-11, for small angles that need no range reduction.
fn small_sin_cos(x: f64) -> (f64, f64) {
    const SMALL: f64 = 0.65;
    if x.abs() > SMALL {
        return x.sin_cos();
    }
    let y = x * x;
    let horner = |c: [f64; 5]| 1.0 + y * (c[0] + y * (c[1] + y * (c[2] + y * (c[3] + y * c[4]))));
    let cos = horner([-1.0 / 2.0, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0, -1.0 / 3_628_800.0]);
    let sin = x * horner([-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5_040.0, 1.0 / 362_880.0, -1.0 / 39_916_800.0]);
    (sin, cos)
}

/// Largest excess (m) of the footprint of a cell of length `h` over the covered area. At the inner side of a curve the side
/// of the vehicle is tangent to a circle beside the rear axle. The hull bridges the gap between the first and the last of
/// these tangents, which cross at the angle κh. Between the rear corner of one and the front corner of the other the gap is
/// κh · ab/(a + b) wide, with a and b their distances from the crossing. The excess is this plus ε.
fn excess(body: &Body, (k, k1): (f64, f64), h: f64) -> f64 {
    let (rear, front) = body.overhangs();
    let (a, b) = (rear + 0.5 * h, front + 0.5 * h);
    k * h * a * b / (a + b) + 0.125 * h * h * body.max_second_derivative(k, k1)
}

/// One spiral, divided into cells.
#[derive(Debug, Clone)]
struct Piece {
    start: Frame,
    yaw: f64,
    /// Curvature by powers of arc length.
    powers: [f64; 4],
    length: f64,
    cells: usize,
    /// Number of cells in a station cell.
    cuts: usize,
    /// Number of cells in a block: a power of two.
    block: usize,
    /// Index of its first cell in the course.
    first_cell: usize,
    /// Station of its start, m.
    first_station: f64,
    /// Index (in this piece) of the last computed block start, with its frame.
    reached: (usize, Frame),
}

impl Piece {
    fn new(start: &Pose, spiral: &CubicSpiral, body: &Body, spacing: f64, first: (usize, f64)) -> Self {
        let length = spiral.length;
        let [k0, k1, k2, k3] = spiral.knots;
        // powers of u = s / L through the knots at thirds
        let by_u = [
            k0,
            -5.5 * k0 + 9.0 * k1 - 4.5 * k2 + k3,
            9.0 * k0 - 22.5 * k1 + 18.0 * k2 - 4.5 * k3,
            -4.5 * k0 + 13.5 * k1 - 13.5 * k2 + 4.5 * k3,
        ];
        let inverse = 1.0 / length;
        let powers = [by_u[0], by_u[1] * inverse, by_u[2] * inverse * inverse, by_u[3] * inverse * inverse * inverse];
        let mut bending = Stretch { powers: by_u, length }.bounds();
        let limit = EXCESS * spacing;
        let mut cuts = 1;
        if excess(body, bending, spacing) > limit {
            bending = (spiral.max_abs_curvature(), spiral.max_abs_curvature_rate());
            while cuts < MAX_CUTS && excess(body, bending, spacing / cuts as f64) > limit {
                cuts += 1;
            }
        }
        let cells = cuts * covering(length, spacing);
        let h = length / cells as f64;
        let mut block = 1;
        while 2 * block <= MAX_IN_BLOCK && block < cells {
            let longer = 2.0 * block as f64 * h;
            let slack = 0.125 * longer * longer * body.max_second_derivative(bending.0, bending.1);
            if longer > MAX_BLOCK_LENGTH || slack > BLOCK_SLACK {
                break;
            }
            block *= 2;
        }
        let frame = Frame::new(start);
        let (first_cell, first_station) = first;
        Self {
            start: frame,
            yaw: start.yaw,
            powers,
            length,
            cells,
            cuts,
            block,
            first_cell,
            first_station,
            reached: (0, frame),
        }
    }

    /// Arc length at a cell limit, m from the start of the piece.
    fn arc_length(&self, limit: usize) -> f64 {
        limit as f64 / self.cells as f64 * self.length
    }

    /// The section between two cell limits of the course.
    fn stretch_of(&self, first: usize, end: usize) -> Stretch {
        self.stretch(self.arc_length(first - self.first_cell), self.arc_length(end - self.first_cell))
    }

    /// The section between two arc lengths, m.
    fn stretch(&self, s: f64, to: f64) -> Stretch {
        let length = to - s;
        let [a, b, c, d] = self.powers;
        let h = length;
        let powers = [
            a + s * (b + s * (c + s * d)),
            h * (b + s * (2.0 * c + s * 3.0 * d)),
            h * h * (c + 3.0 * s * d),
            h * h * h * d,
        ];
        Stretch { powers, length }
    }

    /// The frame at the arc length `s` from the one at `from`, m.
    fn frame_after(&self, from: f64, at: &Frame, s: f64) -> Frame {
        /// Maximum number of halvings, for absurd curvature.
        const MAX_HALVINGS: u32 = 6;
        let [a, b, c, d] = self.powers;
        let yaw = self.yaw + s * (a + s * (b / 2.0 + s * (c / 3.0 + s * (d / 4.0))));
        let (sin, cos) = yaw.sin_cos();
        let chord = self.stretch(from, s).chord(MAX_HALVINGS);
        Frame { at: at.at + at.forward.rotate(chord), forward: Local::new(cos, sin) }
    }
}

/// A part of a cell of at most [`FINE_SPACING`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Subcell {
    /// Station of its start, m from the start of the course.
    pub(super) station: f64,
    /// Frames at its limits.
    pub(super) ends: [Frame; 2],
    /// Its ε.
    pub(super) slack: Slack,
}

/// A block of consecutive cells of one piece, or a part of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Node {
    piece: usize,
    /// First cell, index in the course.
    pub(super) first: usize,
    /// One beyond the last cell, index in the course.
    pub(super) end: usize,
    /// Number of cells of the full block, a power of two; fewer at the end of a piece.
    size: usize,
}

impl Node {
    /// Its two halves; the second may be empty at the end of a piece.
    pub(super) fn halves(&self) -> [Self; 2] {
        let size = self.size / 2;
        let middle = (self.first + size).min(self.end);
        [Self { size, end: middle, ..*self }, Self { size, first: middle, ..*self }]
    }

    /// Number of cells.
    pub(super) fn cells(&self) -> usize {
        self.end - self.first
    }
}

/// Consecutive spirals, divided into cells.
#[derive(Debug, Clone)]
pub(super) struct Course {
    pieces: Vec<Piece>,
    /// Cached frames at the cell limits.
    frames: Vec<Option<Frame>>,
    /// The vehicle without margins.
    body: Body,
}

impl Course {
    /// `body` is the vehicle without margins.
    pub(super) fn new(origin: &Origin, body: &Body, spacing: f64, spirals: &[(Pose, CubicSpiral)]) -> Self {
        let mut pieces: Vec<Piece> = Vec::with_capacity(spirals.len());
        let mut next = (0, 0.0);
        for (start, spiral) in spirals {
            let piece = Piece::new(&origin.local_pose(start), spiral, body, spacing, next);
            next = (next.0 + piece.cells, next.1 + piece.length);
            pieces.push(piece);
        }
        Self { pieces, frames: vec![None; next.0 + 1], body: *body }
    }

    /// Number of cells.
    pub(super) fn cells(&self) -> usize {
        self.frames.len() - 1
    }

    /// The piece that a cell belongs to.
    fn piece_of(&self, cell: usize) -> usize {
        self.pieces.partition_point(|p| p.first_cell <= cell).saturating_sub(1)
    }

    /// Station of a cell limit, m from the start.
    pub(super) fn station(&self, limit: usize) -> f64 {
        let piece = &self.pieces[self.piece_of(limit.saturating_sub(1))];
        piece.first_station + piece.arc_length(limit - piece.first_cell)
    }

    /// The station cells: their limits, m from the start, and the station cell of each cell.
    pub(super) fn station_cells(&self) -> (Vec<f64>, Vec<u32>) {
        let (mut limits, mut of_cell) = (vec![0.0], Vec::with_capacity(self.cells()));
        for piece in &self.pieces {
            for first in (0..piece.cells).step_by(piece.cuts) {
                #[allow(clippy::cast_possible_truncation)] // there are not 2³² cells
                of_cell.extend(std::iter::repeat_n(limits.len() as u32 - 1, piece.cuts));
                limits.push(self.station(piece.first_cell + first + piece.cuts));
            }
        }
        (limits, of_cell)
    }

    /// The frame at a cell limit. At a joint it is the end of the earlier piece.
    pub(super) fn frame(&mut self, limit: usize) -> Frame {
        if let Some(frame) = self.frames[limit] {
            return frame;
        }
        let p = self.piece_of(limit.saturating_sub(1));
        let piece = &mut self.pieces[p];
        let target = limit - piece.first_cell;
        let block_start = target / piece.block * piece.block;
        let (mut at, mut frame) = if piece.reached.0 <= block_start { piece.reached } else { (0, piece.start) };
        while at < block_start {
            frame = piece.frame_after(piece.arc_length(at), &frame, piece.arc_length(at + piece.block));
            at += piece.block;
        }
        piece.reached = (at, frame);
        let mut step = piece.block;
        while at < target {
            step /= 2;
            if target - at >= step {
                let cached = self.frames[piece.first_cell + at + step];
                let (from, to) = (piece.arc_length(at), piece.arc_length(at + step));
                frame = cached.unwrap_or_else(|| piece.frame_after(from, &frame, to));
                at += step;
                self.frames[piece.first_cell + at] = Some(frame);
            }
        }
        self.frames[limit] = Some(frame);
        frame
    }

    /// ε of a cell.
    pub(super) fn cell_slack(&self, cell: usize) -> Slack {
        let piece = &self.pieces[self.piece_of(cell)];
        self.slack_of(&piece.stretch_of(cell, cell + 1))
    }

    fn slack_of(&self, stretch: &Stretch) -> Slack {
        Slack::new(&self.body, stretch.bounds(), stretch.length)
    }

    /// A cell in equal parts of at most [`FINE_SPACING`], from the frames at its limits.
    pub(super) fn subcells(&self, cell: usize, [start, end]: [Frame; 2]) -> Vec<Subcell> {
        let piece = &self.pieces[self.piece_of(cell)];
        let begins = piece.arc_length(cell - piece.first_cell);
        let length = piece.arc_length(cell + 1 - piece.first_cell) - begins;
        let count = covering(length, FINE_SPACING);
        let limit = |i: usize| begins + length * i as f64 / count as f64;
        let mut frame = start;
        let subcell = |i: usize| {
            let (from, to) = (limit(i), limit(i + 1));
            let next = if i + 1 == count { end } else { piece.frame_after(from, &frame, to) };
            let ends = [std::mem::replace(&mut frame, next), next];
            Subcell { station: piece.first_station + from, ends, slack: self.slack_of(&piece.stretch(from, to)) }
        };
        (0..count).map(subcell).collect()
    }

    /// Inflation of the rectangles at both ends of a node for which their hull, with margins of the given reach, contains the
    /// footprints of all its cells with these margins, m. The curvature of the node bounds the slack of its cells, which
    /// inflates the body for the ε of the node. A second [`SKIN`] covers the rounding of the coarse test.
    pub(super) fn node_slack(&self, node: &Node, reach: f64) -> f64 {
        let piece = &self.pieces[node.piece];
        let stretch = piece.stretch_of(node.first, node.end);
        let bounds = stretch.bounds();
        let own = Slack::new(&self.body, bounds, stretch.length / node.cells() as f64).at(reach);
        own + Slack::new(&self.body, bounds, stretch.length).at(reach + std::f64::consts::SQRT_2 * own)
    }

    /// All cells in blocks, in order.
    pub(super) fn blocks(&self) -> Vec<Node> {
        let of_piece = |(index, p): (usize, &Piece)| {
            let (first, cells, block) = (p.first_cell, p.cells, p.block);
            (0..cells).step_by(block).map(move |i| Node {
                piece: index,
                first: first + i,
                end: first + (i + block).min(cells),
                size: block,
            })
        };
        self.pieces.iter().enumerate().flat_map(of_piece).collect()
    }
}

/// ε of a cell as a function of the margins (see [`super::swept`]), [`SKIN`] included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slack {
    /// Without margins, m.
    pub(super) bare: f64,
    /// Increase per metre of the reach of the margins.
    pub(super) growth: f64,
}

impl Slack {
    /// Of a section of length `h` with the bounds of |κ| and |κ′|.
    fn new(body: &Body, (k, k1): (f64, f64), h: f64) -> Self {
        let sagitta = 0.125 * h * h;
        Self {
            bare: SKIN + sagitta * body.max_second_derivative(k, k1),
            growth: sagitta * (k * k * k * k + k1 * k1).sqrt(),
        }
    }

    /// ε with margins of the given reach, m.
    pub(super) fn at(&self, reach: f64) -> f64 {
        self.bare + self.growth * reach
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Vector};
    use proptest::prelude::*;

    fn body() -> Body {
        Body::of_rectangle(-0.83, 3.68, 0.805)
    }

    fn spirals() -> impl Strategy<Value = CubicSpiral> {
        let k = -0.25..0.25f64;
        ([k.clone(), k.clone(), k.clone(), k], 0.3..60.0f64).prop_map(|(knots, length)| CubicSpiral { knots, length })
    }

    fn course(start: &Pose, spirals: &[CubicSpiral], spacing: f64) -> Course {
        let mut at = *start;
        let placed = spirals.iter().map(|s| {
            let here = at;
            at = s.end(&at);
            (here, *s)
        });
        let placed: Vec<_> = placed.collect();
        Course::new(&Origin::amid([&Point::new(0.0, 0.0)]), &body(), spacing, &placed)
    }

    /// Permitted difference between the quadratures of frames and of single points, for spirals far beyond any edge, m: a
    /// tenth of the skin that covers it.
    const TOLERANCE: f64 = 0.1 * SKIN;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]

        /// Frames agree with the quadrature of the spiral, also over several pieces.
        #[test]
        fn frames_are_on_the_spiral(first in spirals(), second in spirals(), yaw in -3.0..3.0f64, spacing in 0.05..2.0f64) {
            let start = Pose::new(12.0, -7.0, yaw);
            let mut course = course(&start, &[first, second], spacing);
            for limit in 0..=course.cells() {
                let s = course.station(limit);
                let pose = if s <= first.length { first.point_at(&start, s).pose } else { second.point_at(&first.end(&start), s - first.length).pose };
                let frame = course.frame(limit);
                let off = Vector::new(frame.at.x - pose.position.x, frame.at.y - pose.position.y).norm();
                prop_assert!(off < TOLERANCE, "{off} m off at {s} of {first:?} {second:?}");
                prop_assert!((frame.forward - Local::new(pose.yaw.cos(), pose.yaw.sin())).length() < 1e-9);
            }
        }

        /// Frames are equal to the bit for every order of queries.
        #[test]
        fn frames_do_not_depend_on_the_order_of_queries(first in spirals(), second in spirals(), seed in 0..1000usize) {
            let start = Pose::new(12.0, -7.0, 0.3);
            let mut in_order = course(&start, &[first, second], 0.5);
            let mut at_random = in_order.clone();
            let n = in_order.cells();
            let all: Vec<Frame> = (0..=n).map(|i| in_order.frame(i)).collect();
            for i in 0..=n {
                let limit = (i * 7919 + seed) % (n + 1);
                prop_assert_eq!(at_random.frame(limit), all[limit]);
            }
        }

        /// Blocks and their halves cover every cell once, in order.
        #[test]
        fn nodes_cover_all_cells_in_order(first in spirals(), second in spirals(), spacing in 0.05..2.0f64) {
            let course = course(&Pose::new(0.0, 0.0, 0.0), &[first, second], spacing);
            let mut next = 0;
            let mut open: Vec<Node> = course.blocks().into_iter().rev().collect();
            while let Some(node) = open.pop() {
                match node.cells() {
                    0 => {}
                    1 => {
                        prop_assert_eq!(node.first, next);
                        next += 1;
                    }
                    _ => open.extend(node.halves().into_iter().rev()),
                }
            }
            prop_assert_eq!(next, course.cells());
        }

        /// The bounds hold at all points and for all parts.
        #[test]
        fn curvature_bounds_hold(spiral in spirals(), from in 0.0..1.0f64, to in 0.0..1.0f64) {
            let course = course(&Pose::new(0.0, 0.0, 0.0), &[spiral], 0.05);
            let n = course.cells();
            let limit = |share: f64| (share * n as f64) as usize;
            let (a, b) = (limit(from.min(to)), limit(from.max(to)) + 1);
            let piece = &course.pieces[0];
            let (k, k1) = piece.stretch_of(a, b.min(n).max(a + 1)).bounds();
            for i in a..=b.min(n) {
                let s = course.station(i).min(spiral.length);
                prop_assert!(spiral.curvature(s).abs() <= k + 1e-12);
                prop_assert!(spiral.curvature_rate(s).abs() <= k1 + 1e-9);
            }
        }
    }

    #[test]
    fn absurd_curvature_is_divided_in_bounded_time() {
        for knots in [[1e6, -1e6, 1e6, 0.0], [f64::NAN; 4], [f64::INFINITY; 4]] {
            let mut course = course(&Pose::new(0.0, 0.0, 0.0), &[CubicSpiral { knots, length: 50.0 }], 0.5);
            assert!(course.cells() <= 100 * MAX_CUTS);
            let _ = course.frame(course.cells());
        }
    }
}
