//! The conservative swept footprint of a vehicle along a spiral or a path.
//!
//! # Technique
//! Each spiral is divided into cells of equal length, at most [`super::CollisionSettings::spacing`] (`course`). The footprint of a
//! cell is the convex hull of the vehicle's rectangle at its two ends, each inflated by ε on every side. The hull of two
//! rectangles inflated by a disc is the hull of the inflated rectangles, so that the footprint contains everything within ε
//! of the hull.
//!
//! # The bound ε
//! A corner with coordinates (x, y) in the rear-axle frame follows, over arc length s, the curve X(s) = r(s) + R(θ(s))·(x, y)
//! with r' = R·(1, 0) and θ' = κ, so that in the frame of the vehicle
//!
//! ```text
//! X″ = ( −κ′·y − κ²·x ,  κ + κ′·x − κ²·y )
//! ```
//!
//! A twice differentiable curve leaves the chord between its ends at s and s + h by at most h²/8 · max |X″| (the error of
//! linear interpolation: the sagitta of the arc if X″ is constant). The chord is in the hull of the two rectangles, hence
//! ε = h²/8 · max |X″| with |x|, |y| of the outermost corner and the largest |κ|, |κ′| of the cell, which its Bernstein
//! coefficients bound. Margins displace the corner by a vector δ and X″ by (−κ′·δy − κ²·δx, κ′·δx − κ²·δy), whose length is
//! |δ| · √(κ⁴ + κ′²): ε grows linearly with the margins, and one footprint serves queries with any margins. All other points of the rectangle are convex combinations of its corners, so that the bound
//! for the corners holds for all of them; also for parts inside the rectangle, each swept separately (`outline`).
//!
//! # Weakness
//! The hull bridges the inner side of a curve, and ε grows with κ and κ′. If both together exceed about a tenth of the
//! spacing, the spiral is divided into shorter cells. So at the default spacing the footprint exceeds the covered area by at
//! most 5 cm for curvatures up to 0.2 1/m with rates up to 0.1 1/m² (measured: 3.8 cm). The excess is proportional to the
//! spacing.

use parry2d::bounding_volume::Aabb;

use super::convert::{Local, Origin, vector};
use super::convex::{Convex, SweptCorners, boxes_meet, inflated, merged};
use super::course::{Course, Slack, Subcell};
use super::margins::Margins;
use super::moving::KeptRuns;
use super::outline::Outline;
use crate::geometry::spiral::CubicSpiral;
use crate::geometry::{Point, Pose};
use crate::trajectory::Path;
use crate::vehicle::Vehicle;

/// Inflation of every footprint, m. It covers the rounding of the overlap tests and the quadrature error of positions, both
/// below 1e-7 m; touching counts as overlap.
pub(super) const SKIN: f64 = 1e-6;

/// The rectangle of the vehicle, or the bounding rectangle of its parts, in the rear-axle frame, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Body {
    rear: f64,
    front: f64,
    half_width: f64,
}

impl Body {
    pub(super) fn new(vehicle: &Vehicle) -> Self {
        let [rear_right, _, front_left, _] = vehicle.footprint.bounding_rectangle();
        Self { rear: rear_right.x, front: front_left.x, half_width: front_left.y }
    }

    /// A rectangle from its extent behind (negative) and ahead of the rear axle and its half width, m.
    #[cfg(test)]
    pub(super) fn of_rectangle(rear: f64, front: f64, half_width: f64) -> Self {
        Self { rear, front, half_width }
    }

    /// The rectangle inflated by the margins and by `slack` on every side.
    pub(super) fn inflated(&self, margins: &Margins, slack: f64) -> Self {
        let longitudinal = margins.longitudinal + slack;
        Self {
            rear: self.rear - longitudinal,
            front: self.front + longitudinal,
            half_width: self.half_width + margins.lateral + slack,
        }
    }

    /// Counter-clockwise from rear right.
    pub(super) fn corners(&self, frame: &Frame) -> [Local; 4] {
        let (forward, left) = (frame.forward, frame.forward.perp());
        let (rear, front) = (frame.at + forward * self.rear, frame.at + forward * self.front);
        let side = left * self.half_width;
        [rear - side, front - side, front + side, rear + side]
    }

    fn aabb(&self, frame: &Frame) -> Aabb {
        let f = frame.forward;
        let (middle, half) = (0.5 * (self.front + self.rear), 0.5 * (self.front - self.rear));
        let extent = f.abs() * half + Local::new(f.y, f.x).abs() * self.half_width;
        let centre = frame.at + f * middle;
        Aabb { mins: centre - extent, maxs: centre + extent }
    }

    /// Extent behind and ahead of the rear axle, m.
    pub(super) fn overhangs(&self) -> (f64, f64) {
        (self.rear.abs(), self.front.abs())
    }

    /// Upper bound of |X″| over the rectangle (module docs), 1/m.
    pub(super) fn max_second_derivative(&self, curvature: f64, curvature_rate: f64) -> f64 {
        let (x, y) = (self.front.abs().max(self.rear.abs()), self.half_width);
        let (k, k1) = (curvature, curvature_rate);
        let (longitudinal, lateral) = (k1 * y + k * k * x, k + k1 * x + k * k * y);
        // not `hypot`, which takes five times as long and is not needed without overflow
        (longitudinal * longitudinal + lateral * lateral).sqrt()
    }

    /// Depth of the rear axle inside the rectangle, m; negative outside.
    pub(super) fn depth_of_rear_axle(&self) -> f64 {
        self.front.min(-self.rear)
    }
}

/// A rear-axle pose relative to the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub(super) at: Local,
    /// Unit vector along the heading.
    pub(super) forward: Local,
}

impl Frame {
    pub(super) fn new(local: &Pose) -> Self {
        let (sin, cos) = local.yaw.sin_cos();
        Self { at: vector(local.position), forward: Local::new(cos, sin) }
    }

    /// A point of the rear-axle frame, relative to the origin.
    pub(super) fn to_world(self, p: Local) -> Local {
        self.at + self.forward * p.x + self.forward.perp() * p.y
    }
}

/// A swept footprint, divided into cells by station. Cell `i` contains the area that the vehicle covers while its rear axle
/// is between `stations()[i]` and `stations()[i + 1]`.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// Cell limits, m from the start; one more than there are cells.
    stations: Vec<f64>,
    /// Limits of the station cells, m from the start, and the station cell of each cell.
    station_cells: (Vec<f64>, Vec<u32>),
    frames: Vec<Frame>,
    course: Course,
    /// ε of each cell.
    slack: Vec<Slack>,
    /// The largest [`Slack::growth`].
    growth: f64,
    /// Bounding boxes of the cells, without margins.
    boxes: BoxTree,
    /// Oriented bounding boxes of [`FAN`] cells each, without margins.
    block_boxes: Vec<BlockBox>,
    outline: Outline,
    origin: Origin,
    /// Cached cells that moving obstacles block.
    kept_runs: KeptRuns,
}

impl Sweep {
    pub(super) fn new(origin: &Origin, outline: &Outline, spacing: f64, pieces: &[(Pose, CubicSpiral)]) -> Self {
        let body = outline.body();
        let mut course = Course::new(origin, body, spacing, pieces);
        let cells = course.cells();
        let stations: Vec<f64> = (0..=cells).map(|limit| course.station(limit)).collect();
        let frames: Vec<Frame> = (0..=cells).map(|limit| course.frame(limit)).collect();
        let slack: Vec<Slack> = (0..cells).map(|cell| course.cell_slack(cell)).collect();
        let boxes = frames.windows(2).zip(&slack).map(|(ends, slack)| {
            let body = body.inflated(&Margins::NONE, slack.bare);
            merged(&body.aabb(&ends[0]), &body.aabb(&ends[1]))
        });
        let boxes = BoxTree::new(boxes.collect());
        let block_boxes = block_boxes_of(body, &frames, &slack);
        let growth = slack.iter().fold(0.0, |most: f64, slack| most.max(slack.growth));
        let outline = outline.clone();
        let station_cells = course.station_cells();
        let (origin, kept_runs) = (*origin, KeptRuns::default());
        Self { stations, station_cells, frames, course, slack, growth, boxes, block_boxes, outline, origin, kept_runs }
    }

    /// Number of cells, at least one.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.slack.len()
    }

    /// Cell limits, m from the start of the sweep; one more than there are cells.
    #[must_use]
    pub fn stations(&self) -> &[f64] {
        &self.stations
    }

    /// Limits of the station cells of the blocked grid, m from the start: one spacing apart, or less so that they divide the
    /// length of the spiral. A station cell is one cell or, in tight curves, several.
    pub(super) fn grid_stations(&self) -> &[f64] {
        &self.station_cells.0
    }

    /// Number of station cells.
    pub(super) fn grid_cells(&self) -> usize {
        self.station_cells.0.len() - 1
    }

    /// The station cell of a cell.
    pub(super) fn grid_cell(&self, cell: usize) -> usize {
        self.station_cells.1[cell] as usize
    }

    /// Length of the swept path, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.stations[self.stations.len() - 1]
    }

    /// The footprint of a cell with margins, counter-clockwise, in world coordinates; empty beyond the last cell. For a
    /// vehicle with several parts, that of their bounding rectangle: see [`Sweep::part_footprints`].
    #[must_use]
    pub fn footprint(&self, cell: usize, margins: &Margins) -> Vec<Point> {
        if cell >= self.cells() {
            return Vec::new();
        }
        self.corners(cell, margins).hull().iter().map(|p| self.origin.world(*p)).collect()
    }

    /// The footprints of all parts of the vehicle in a cell, like [`Sweep::footprint`]; the checks use these.
    #[must_use]
    pub fn part_footprints(&self, cell: usize, margins: &Margins) -> Vec<Vec<Point>> {
        if cell >= self.cells() {
            return Vec::new();
        }
        let world = |hull: Convex| hull.points().iter().map(|p| self.origin.world(*p)).collect();
        let ends = [self.frames[cell], self.frames[cell + 1]];
        match self.outline.swept(ends, margins, self.slack[cell].at(margins.reach())) {
            Some(parts) => parts.hulls().map(world).collect(),
            None => vec![self.footprint(cell, margins)],
        }
    }

    pub(super) fn corners(&self, cell: usize, margins: &Margins) -> SweptCorners {
        let ends = [self.frames[cell], self.frames[cell + 1]];
        self.outline.footprint(ends, margins, self.slack[cell].at(margins.reach()))
    }

    /// The subcells of a station cell, in order.
    pub(super) fn subcells(&self, grid_cell: usize) -> Vec<Subcell> {
        #[allow(clippy::cast_possible_truncation)] // there are not 2³² cells
        let first = self.station_cells.1.partition_point(|of| *of < grid_cell as u32);
        let cells = (first..self.cells()).take_while(|cell| self.grid_cell(*cell) == grid_cell);
        cells.flat_map(|cell| self.course.subcells(cell, [self.frames[cell], self.frames[cell + 1]])).collect()
    }

    /// The footprint of a subcell with margins.
    pub(super) fn subcell_corners(&self, subcell: &Subcell, margins: &Margins) -> SweptCorners {
        self.outline.footprint(subcell.ends, margins, subcell.slack.at(margins.reach()))
    }

    pub(super) fn kept_runs(&self) -> &KeptRuns {
        &self.kept_runs
    }

    pub(super) fn boxes(&self) -> &BoxTree {
        &self.boxes
    }

    /// Inflation for which a box without margins contains the footprints with margins in it, m.
    pub(super) fn reach(&self, margins: &Margins) -> f64 {
        (1.0 + self.growth) * margins.reach()
    }

    /// The box around a cell with margins.
    pub(super) fn cell_box(&self, cell: usize, margins: &Margins) -> Aabb {
        inflated(self.boxes.cell(cell), self.reach(margins))
    }

    /// `false` only if the oriented box of a block of cells, with margins, is apart from the piece.
    fn block_may_meet(&self, block: usize, piece: &Convex, margins: &Margins) -> bool {
        self.block_boxes[block].may_meet(piece, self.reach(margins))
    }

    /// Calls `found` in order with every cell that may meet one of the pieces in the box `aabb`, by its box and its block.
    pub(super) fn cells_near(&self, aabb: &Aabb, pieces: &[Convex], margins: &Margins, mut found: impl FnMut(usize)) {
        let reach = inflated(aabb, self.reach(margins));
        self.boxes.visit_blocks(&reach, &mut |block| {
            if pieces.iter().any(|piece| self.block_may_meet(block, piece, margins)) {
                let cells = FAN * block..(FAN * (block + 1)).min(self.cells());
                cells.filter(|cell| boxes_meet(self.boxes.cell(*cell), &reach)).for_each(&mut found);
            }
        });
    }
}

/// The pieces of a path, for [`Sweep::new`].
pub(super) fn pieces_of(path: &Path) -> Vec<(Pose, CubicSpiral)> {
    path.pieces().map(|(_, start, spiral)| (*start, *spiral)).collect()
}

/// Boxes of consecutive cells, merged in groups of eight into levels: a bounding volume hierarchy without a build step, since
/// neighbours on a path are neighbours in the plane.
#[derive(Debug, Clone)]
pub(super) struct BoxTree {
    /// `levels[0]` contains the cells, the last level one box.
    levels: Vec<Vec<Aabb>>,
}

/// Number of boxes per box of the next level.
const FAN: usize = 8;

impl BoxTree {
    fn new(cells: Vec<Aabb>) -> Self {
        let mut levels = vec![cells];
        while levels.len() < 2 || levels[levels.len() - 1].len() > 1 {
            let below = &levels[levels.len() - 1];
            let above = below.chunks(FAN).map(|chunk| chunk.iter().skip(1).fold(chunk[0], |a, b| merged(&a, b)));
            levels.push(above.collect());
        }
        Self { levels }
    }

    pub(super) fn cell(&self, cell: usize) -> &Aabb {
        &self.levels[0][cell]
    }

    /// The box around all cells.
    pub(super) fn bounds(&self) -> &Aabb {
        &self.levels[self.levels.len() - 1][0]
    }

    /// Calls `found` with every block whose box meets `query`, in order.
    fn visit_blocks(&self, query: &Aabb, found: &mut impl FnMut(usize)) {
        self.descend(self.levels.len() - 1, 0..1, query, found);
    }

    fn descend(&self, level: usize, range: std::ops::Range<usize>, query: &Aabb, found: &mut impl FnMut(usize)) {
        for i in range {
            if !boxes_meet(&self.levels[level][i], query) {
                continue;
            }
            if level == 1 {
                found(i);
            } else {
                let end = (FAN * (i + 1)).min(self.levels[level - 1].len());
                self.descend(level - 1, FAN * i..end, query, found);
            }
        }
    }
}

/// An oriented box, aligned with the path: axis-aligned boxes extend far beyond a diagonal road.
#[derive(Debug, Clone, Copy)]
struct BlockBox {
    centre: Local,
    forward: Local,
    half: Local,
}

impl BlockBox {
    /// The box in the heading of the middle frame around a body at all frames.
    fn around(body: &Body, frames: &[Frame]) -> Self {
        let forward = frames[frames.len() / 2].forward;
        let (mut low, mut high) = (Local::INFINITY, Local::NEG_INFINITY);
        for frame in frames {
            let turned = |v: Local| Local::new(v.dot(forward), forward.perp_dot(v));
            let aabb = body.aabb(&Frame { at: turned(frame.at), forward: turned(frame.forward) });
            (low, high) = (low.min(aabb.mins), high.max(aabb.maxs));
        }
        Self { centre: forward.rotate(0.5 * (low + high)), forward, half: 0.5 * (high - low) }
    }

    /// `false` only if the piece is farther than `margin` from the box.
    fn may_meet(&self, piece: &Convex, margin: f64) -> bool {
        let (mut low, mut high) = (Local::INFINITY, Local::NEG_INFINITY);
        for p in piece.points() {
            let d = *p - self.centre;
            let turned = Local::new(d.dot(self.forward), self.forward.perp_dot(d));
            (low, high) = (low.min(turned), high.max(turned));
        }
        let reach = self.half + Local::splat(margin + piece.radius());
        low.cmple(reach).all() && high.cmpge(-reach).all()
    }
}

/// The oriented boxes of all blocks.
fn block_boxes_of(body: &Body, frames: &[Frame], slack: &[Slack]) -> Vec<BlockBox> {
    let block = |(i, slack): (usize, &[Slack])| {
        let widest = slack.iter().fold(0.0, |a: f64, b| a.max(b.bare));
        BlockBox::around(&body.inflated(&Margins::NONE, widest), &frames[FAN * i..=FAN * i + slack.len()])
    };
    slack.chunks(FAN).enumerate().map(block).collect()
}
