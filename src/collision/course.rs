//! A path cut into cells, with vehicle frames that are made when they are asked for.
//!
//! # Technique
//! A spiral's curvature is a cubic of arc length, so on any stretch of it everything is local algebra: the Taylor
//! coefficients at the stretch's start give the heading exactly, its Bernstein coefficients bound |κ| and |κ′| over the
//! stretch (a polynomial stays within the hull of its Bernstein coefficients; Farin, *Curves and Surfaces for CAGD*, ch.
//! 5), and Gauss quadrature of a heading that turns little needs no trigonometric function.
//!
//! The frame at cell limit `i` is reached from the one at `i` with its lowest set bit cleared (as in a Fenwick tree),
//! from the start of its block on; block starts follow one another. So every frame has one way to be computed, whoever
//! asks in whatever order, and the coarse check ([`super::coarse`]) that asks for few of them sees the same bits as the
//! [`super::Sweep`] that has them all.
//!
//! # Cell length
//! The setting [`super::CollisionSettings::spacing`], or a whole fraction of it where a spiral bends so much that the
//! footprint would exceed what is covered by more than [`EXCESS`] (see [`excess`]). The station cells of the blocked grid
//! keep the spacing: what is searched for speeds over them does not depend on how the spiral bends.

use super::convert::{Local, Origin};
use super::swept::{Body, Frame, SKIN};
use crate::geometry::Pose;
use crate::geometry::quadrature::{GAUSS_3, GAUSS_5, GAUSS_8};
use crate::geometry::spiral::CubicSpiral;

/// How far a cell's footprint may reach beyond what is covered in it, as a share of the spacing: 4.5 cm at 0.5 m.
pub(super) const EXCESS: f64 = 0.09;
/// Cells are cut into this many at most, whatever the curvature.
const MOST_CUTS: usize = 8;
/// Blocks have this many cells at most, and are at most this long (m); they are as long as ε allows.
const MOST_IN_BLOCK: usize = 32;
const LONGEST_BLOCK: f64 = 9.0;
/// Largest ε of a block, m: beyond it a coarse hull decides too little.
const BLOCK_SLACK: f64 = 0.25;

/// A part of a spiral: curvature by powers of t ∈ [0, 1] along it.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    /// 1/m.
    powers: [f64; 4],
    /// m.
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

    /// From its start to its end, in the frame of its start, m. `halvings` bounds the work for absurd curvature.
    fn chord(&self, halvings: u32) -> Local {
        /// Turning, and what of it comes from uneven curvature (rad; a tenth of what grows evenly counts), up to which
        /// three points err by less than 2e-10 of the length: the square of the latter and the cube of what grows evenly
        /// meet the first power that the rule does not integrate.
        const THREE: (f64, f64) = (0.08, 0.0015);
        /// The same for five points.
        const FIVE: (f64, f64) = (0.25, 0.08);
        /// Turning up to which eight points do, for any cubic.
        const EIGHT: f64 = 0.6;
        let turning = self.length * self.bounds().0;
        let uneven = self.length * (0.1 * self.powers[1].abs() + self.powers[2].abs() + self.powers[3].abs());
        let within = |(most, most_uneven): (f64, f64)| turning <= most && uneven <= most_uneven;
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

/// Sine and cosine by Taylor's series where it is good to 1e-11, which is where no range need be reduced.
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

/// By how much (m) the footprint of a cell of length `h` may reach beyond what is covered in it. On the inner side of a
/// bend the vehicle's side runs tangent to a circle abeam the rear axle; the hull bridges the bow tie between the first
/// and the last of these tangents, which cross there at the angle κh: from the rear corner of one to the front corner
/// of the other this is κh · ab/(a + b) wide, with a and b their distances from the crossing. ε comes on top.
fn excess(body: &Body, (k, k1): (f64, f64), h: f64) -> f64 {
    let (rear, front) = body.overhangs();
    let (a, b) = (rear + 0.5 * h, front + 0.5 * h);
    k * h * a * b / (a + b) + 0.125 * h * h * body.bend(k, k1)
}

/// Cells of equal length, `spacing` at most.
fn cells_for(length: f64, spacing: f64) -> usize {
    /// A length that is a multiple of the spacing but for rounding gets no extra cell.
    const ROUNDING: f64 = 1e-9;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a positive count of cells
    let cells = (length / spacing - ROUNDING).ceil().max(1.0) as usize;
    cells
}

/// One spiral, cut.
#[derive(Debug, Clone)]
struct Piece {
    start: Frame,
    yaw: f64,
    /// Curvature by powers of arc length.
    powers: [f64; 4],
    length: f64,
    cells: usize,
    /// Cells in a station cell.
    cuts: usize,
    /// Cells in a block: a power of two.
    block: usize,
    /// Index of its first cell in the course, and its station, m.
    first_cell: usize,
    first_station: f64,
    /// Index (in this piece) of the last block start whose frame is made, with that frame.
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
            while cuts < MOST_CUTS && excess(body, bending, spacing / cuts as f64) > limit {
                cuts += 1;
            }
        }
        let cells = cuts * cells_for(length, spacing);
        let h = length / cells as f64;
        let mut block = 1;
        while 2 * block <= MOST_IN_BLOCK && block < cells {
            let longer = 2.0 * block as f64 * h;
            let slack = 0.125 * longer * longer * body.bend(bending.0, bending.1);
            if longer > LONGEST_BLOCK || slack > BLOCK_SLACK {
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
    fn along(&self, limit: usize) -> f64 {
        limit as f64 / self.cells as f64 * self.length
    }

    fn stretch(&self, from: usize, to: usize) -> Stretch {
        let s = self.along(from);
        let length = self.along(to) - s;
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

    fn frame_after(&self, from: usize, at: &Frame, to: usize) -> Frame {
        /// Halvings for absurd curvature.
        const MOST: u32 = 6;
        let s = self.along(to);
        let [a, b, c, d] = self.powers;
        let yaw = self.yaw + s * (a + s * (b / 2.0 + s * (c / 3.0 + s * (d / 4.0))));
        let (sin, cos) = yaw.sin_cos();
        let chord = self.stretch(from, to).chord(MOST);
        Frame { at: at.at + at.forward.rotate(chord), forward: Local::new(cos, sin) }
    }
}

/// A block of cells (or a part of one) that hang together in one piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Node {
    piece: usize,
    /// First cell, index in the course.
    pub(super) first: usize,
    /// One beyond the last cell, index in the course.
    pub(super) end: usize,
    /// Cells it would have if the piece did not end: a power of two.
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

/// Spirals that follow one another, cut into cells.
#[derive(Debug, Clone)]
pub(super) struct Course {
    pieces: Vec<Piece>,
    /// Frames at the cell limits, where somebody asked.
    frames: Vec<Option<Frame>>,
    /// The body with the widest margins: what ε must hold for.
    widest: Body,
}

impl Course {
    /// `body` is the bare vehicle, `widest` the one with the largest margins.
    pub(super) fn new(
        origin: &Origin,
        (body, widest): (&Body, Body),
        spacing: f64,
        spirals: &[(Pose, CubicSpiral)],
    ) -> Self {
        let mut pieces: Vec<Piece> = Vec::with_capacity(spirals.len());
        let mut next = (0, 0.0);
        for (start, spiral) in spirals {
            let piece = Piece::new(&origin.local_pose(start), spiral, body, spacing, next);
            next = (next.0 + piece.cells, next.1 + piece.length);
            pieces.push(piece);
        }
        Self { pieces, frames: vec![None; next.0 + 1], widest }
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
        piece.first_station + piece.along(limit - piece.first_cell)
    }

    /// The station cells, as long as the spacing allows: limits, m from the start, and which of them each cell is in.
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

    /// The frame at a cell limit. Where pieces join it is the one that the earlier one ends with.
    pub(super) fn frame(&mut self, limit: usize) -> Frame {
        if let Some(frame) = self.frames[limit] {
            return frame;
        }
        let p = self.piece_of(limit.saturating_sub(1));
        let piece = &mut self.pieces[p];
        let wanted = limit - piece.first_cell;
        let block_start = wanted / piece.block * piece.block;
        let (mut at, mut frame) = if piece.reached.0 <= block_start { piece.reached } else { (0, piece.start) };
        while at < block_start {
            frame = piece.frame_after(at, &frame, at + piece.block);
            at += piece.block;
        }
        piece.reached = (at, frame);
        let mut step = piece.block;
        while at < wanted {
            step /= 2;
            if wanted - at >= step {
                let cached = self.frames[piece.first_cell + at + step];
                frame = cached.unwrap_or_else(|| piece.frame_after(at, &frame, at + step));
                at += step;
                self.frames[piece.first_cell + at] = Some(frame);
            }
        }
        self.frames[limit] = Some(frame);
        frame
    }

    /// ε of a cell, [`SKIN`] included, m.
    pub(super) fn cell_slack(&self, cell: usize) -> f64 {
        let piece = &self.pieces[self.piece_of(cell)];
        let stretch = piece.stretch(cell - piece.first_cell, cell + 1 - piece.first_cell);
        slack(&self.widest, stretch.bounds(), stretch.length)
    }

    /// By how much a rectangle at both ends of a node must be grown for its hull to hold the footprints of all its
    /// cells, m. The cells' own slack is bounded with the node's curvature and grows the body that the node's ε is for;
    /// a second [`SKIN`] keeps the coarse test's rounding from deciding anything.
    pub(super) fn node_slack(&self, node: &Node) -> f64 {
        let piece = &self.pieces[node.piece];
        let stretch = piece.stretch(node.first - piece.first_cell, node.end - piece.first_cell);
        let bounds = stretch.bounds();
        let own = slack(&self.widest, bounds, stretch.length / node.cells() as f64);
        let grown = self.widest.grown(&super::Margins::NONE, own);
        own + slack(&grown, bounds, stretch.length)
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

/// ε = h²/8 · max |X″| (see [`super::swept`]) and [`SKIN`], m.
fn slack(body: &Body, (k, k1): (f64, f64), h: f64) -> f64 {
    SKIN + 0.125 * h * h * body.bend(k, k1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collision::Margins;
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
        Course::new(
            &Origin::amid([&Point::new(0.0, 0.0)]),
            (&body(), body().grown(&Margins::uniform(0.3), 0.0)),
            spacing,
            &placed,
        )
    }

    /// What the quadratures of frames and of single points may differ by on spirals far wilder than any edge, m: a tenth of
    /// the skin that covers it.
    const OFF: f64 = 0.1 * SKIN;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]

        /// Frames are those of the spiral's own quadrature, also over several pieces.
        #[test]
        fn frames_are_on_the_spiral(first in spirals(), second in spirals(), yaw in -3.0..3.0f64, spacing in 0.05..2.0f64) {
            let start = Pose::new(12.0, -7.0, yaw);
            let mut course = course(&start, &[first, second], spacing);
            for limit in 0..=course.cells() {
                let s = course.station(limit);
                let pose = if s <= first.length { first.point_at(&start, s).pose } else { second.point_at(&first.end(&start), s - first.length).pose };
                let frame = course.frame(limit);
                let off = Vector::new(frame.at.x - pose.position.x, frame.at.y - pose.position.y).norm();
                prop_assert!(off < OFF, "{off} m off at {s} of {first:?} {second:?}");
                prop_assert!((frame.forward - Local::new(pose.yaw.cos(), pose.yaw.sin())).length() < 1e-9);
            }
        }

        /// Whatever is asked first, the bits are the same.
        #[test]
        fn frames_do_not_depend_on_the_order_of_asking(first in spirals(), second in spirals(), seed in 0..1000usize) {
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
            let (k, k1) = piece.stretch(a, b.min(n).max(a + 1)).bounds();
            for i in a..=b.min(n) {
                let s = course.station(i).min(spiral.length);
                prop_assert!(spiral.curvature(s).abs() <= k + 1e-12);
                prop_assert!(spiral.curvature_rate(s).abs() <= k1 + 1e-9);
            }
        }
    }

    #[test]
    fn absurd_curvature_is_cut_in_bounded_time() {
        for knots in [[1e6, -1e6, 1e6, 0.0], [f64::NAN; 4], [f64::INFINITY; 4]] {
            let mut course = course(&Pose::new(0.0, 0.0, 0.0), &[CubicSpiral { knots, length: 50.0 }], 0.5);
            assert!(course.cells() <= 100 * MOST_CUTS);
            let _ = course.frame(course.cells());
        }
    }
}
