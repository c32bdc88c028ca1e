//! The check of a path against the static world, coarse to fine.
//!
//! # Technique
//! A block of cells ([`super::course`]) is tested as a whole first: the hull of the body without margins at its two ends,
//! inflated by the bound ε for the length of the block, contains the footprints of all its cells. One query of the hierarchy
//! selects the pieces near the box of a block; pieces farther than their margin from the hull of the block are dropped. If
//! any remain, the block is halved and tested with these alone, down to single cells, whose footprints are those of
//! [`super::Sweep`]. The coarse hull contains the fine ones and the halves are visited in order, so that the result is the same
//! cell and the same blocker as that of a test of every cell.
//!
//! A cell that meets something is tested again in subcells of at most 0.1 m, whose footprints are tighter: the hit is the start of
//! the first one that still meets it. If none does, the search goes on.
//!
//! The clearance is measured in blocks whose hull is nearer to a piece than the smallest distance so far.
//!
//! Frames, corners and hulls are computed on demand: one frame and one hull per block on a free path near the boundary.
//!
//! # Weakness
//! A block that follows an obstacle or a bound at exactly its margin is halved everywhere.
//! Results are not cached; moving obstacles need a [`super::Sweep`].

use std::ops::Range;

use super::convert::Local;
use super::convex::{Convex, SweptCorners, boxes_meet};
use super::course::{Course, Node, Slack};
use super::margins::{Margins, SafetyMargins};
use super::statics::{Allowance, Clearance, StaticHit};
use super::swept::Frame;
use super::wide::OrientedBox;
use super::{Blocker, CollisionWorld, ROUNDING};
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;

/// Number of cells between two poses at which the clearance is measured.
const STRIDE: usize = 4;

/// A check of a spiral or path against the static world, without its swept footprint.
#[derive(Debug, Clone)]
pub struct EdgeProbe<'w> {
    world: &'w CollisionWorld,
    course: Course,
    blocks: Vec<Node>,
    /// Candidates of the present nodes: indices of obstacle pieces and of boundary segments, those of a node after those of
    /// its parent.
    near: Near,
}

/// Indices into the static world.
#[derive(Debug, Clone)]
struct Near {
    obstacles: Vec<u32>,
    boundary: Vec<u32>,
}

impl Near {
    /// Start of the entries of the next node.
    fn top(&self) -> (usize, usize) {
        (self.obstacles.len(), self.boundary.len())
    }

    fn truncate(&mut self, (obstacles, boundary): (usize, usize)) {
        self.obstacles.truncate(obstacles);
        self.boundary.truncate(boundary);
    }
}

impl<'w> EdgeProbe<'w> {
    pub(super) fn new(world: &'w CollisionWorld, spirals: &[(Pose, CubicSpiral)]) -> Self {
        let course = Course::new(&world.origin, world.outline.body(), world.spacing, spirals);
        let blocks = course.blocks();
        Self {
            world,
            course,
            blocks,
            near: Near { obstacles: Vec::with_capacity(32), boundary: Vec::with_capacity(32) },
        }
    }

    /// Number of cells, at least one.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.course.cells()
    }

    /// The first station at which the path meets a static obstacle or leaves the road, with margins, to 0.1 m. `allowance` is for a path from the
    /// position of the vehicle, which may already be inside a margin or partly off the road.
    #[must_use]
    pub fn static_hit(&mut self, margins: &SafetyMargins, allowance: &Allowance) -> Option<StaticHit> {
        let cells = self.cells();
        // the footprint of a part is connected: if no boundary meets it, one point inside proves that all of it is inside
        let first_checked = self.last_excused(cells, allowance);
        let road = self.world.statics.road();
        let on_road = |frame: &Frame| self.world.outline.all_parts(frame, |p| road.contains_local(p));
        let off_road = first_checked.filter(|limit| !on_road(&self.course.frame(*limit)));
        let off_road = off_road.map(|limit| limit.min(cells - 1));
        let search = Search::new(margins, allowance, off_road.unwrap_or(cells - 1));
        for i in 0..self.blocks.len() {
            let block = self.blocks[i];
            if block.first > search.last {
                break;
            }
            if let Some(hit) = self.hit_in_block(&search, &block) {
                let is_off_road = off_road == Some(hit.cell);
                return Some(StaticHit {
                    station: if is_off_road { self.course.station(hit.cell) } else { hit.station },
                    ..hit
                });
            }
        }
        off_road.map(|cell| StaticHit { station: self.course.station(cell), cell, what: Blocker::RoadBoundary })
    }

    /// The last limit of a cell before which the road is ignored; the first one if it is ignored nowhere, `None` if it is everywhere.
    fn last_excused(&self, cells: usize, allowance: &Allowance) -> Option<usize> {
        let is_excused = |limit: &usize| self.course.station(*limit) <= allowance.no_road_until;
        let last = (0..=cells).rfind(is_excused).unwrap_or(0);
        (self.course.station(cells) >= allowance.no_road_until).then_some(last)
    }

    /// Distances of the vehicle without margins to static obstacles and to the road boundary, at most `cap`, m: the minimum
    /// over the poses at every fourth cell limit and at the last one. For costs of paths without a hit: between these poses the
    /// distance may be slightly smaller in curves.
    #[must_use]
    pub fn clearance(&mut self, cap: f64) -> Clearance {
        let mut least = Clearance { obstacle: cap, road: cap };
        for i in 0..self.blocks.len() {
            let block = self.blocks[i];
            let poses = block.first.next_multiple_of(STRIDE)..block.end;
            let is_last = i + 1 == self.blocks.len();
            if poses.is_empty() && !is_last {
                continue;
            }
            let mut hull = self.hull(&block, 0.0);
            let reach = (least.obstacle, least.road);
            self.query(&hull, reach);
            let found = self.near.top();
            self.narrow(&mut hull, ((0, 0), found), reach);
            if self.near.top() == found {
                continue;
            }
            let (pieces, segments) = (self.world.statics.obstacles(), self.world.statics.road().boundary());
            let last = is_last.then_some(block.end);
            for limit in poses.step_by(STRIDE).chain(last) {
                let frame = self.course.frame(limit);
                self.world.outline.for_each_part(&frame, |part| {
                    let turned = OrientedBox::around(part, frame.forward);
                    least.obstacle = nearest(&self.near.obstacles[found.0..], pieces, (part, &turned), least.obstacle);
                    least.road = nearest(&self.near.boundary[found.1..], segments, (part, &turned), least.road);
                });
            }
        }
        least
    }

    /// The hull of a node without margins, for queries with margins of the given reach.
    fn hull(&mut self, node: &Node, reach: f64) -> NodeHull {
        let (from, to) = (self.course.frame(node.first), self.course.frame(node.end));
        let body = self.world.outline.body().inflated(&Margins::NONE, self.course.node_slack(node, reach));
        let [a, b, c, d] = body.corners(&from);
        let [e, f, g, h] = body.corners(&to);
        NodeHull::new([a, b, c, d, e, f, g, h], from.forward + to.forward)
    }

    fn hit_in_block(&mut self, search: &Search, block: &Node) -> Option<StaticHit> {
        let mut hull = self.hull(block, search.widest());
        self.query(&hull, search.reach);
        if !search.checks_road(self.course.station(block.end)) {
            self.near.boundary.clear();
        }
        let found = self.near.top();
        if found == (0, 0) {
            return None;
        }
        self.near.obstacles.sort_unstable();
        self.narrow(&mut hull, ((0, 0), found), search.reach);
        if self.near.top() == found { None } else { self.descend(search, block, found) }
    }

    /// Collects the obstacle pieces and the boundary segments within a reach of the oriented box of a hull.
    fn query(&mut self, hull: &NodeHull, (obstacles, road): (f64, f64)) {
        self.near.truncate((0, 0));
        let statics = &self.world.statics;
        let (pieces, segments) = (statics.obstacles(), statics.road().boundary());
        let near = &mut self.near;
        statics.everything().visit(&hull.oriented_box, obstacles.max(road), |leaf| {
            #[allow(clippy::cast_possible_truncation)] // there are not 2³¹ pieces
            if let Some(piece) = pieces.get(leaf) {
                if hull.oriented_box.gap_to(piece) <= obstacles {
                    near.obstacles.push(leaf as u32);
                }
            } else if hull.oriented_box.gap_to(&segments[leaf - pieces.len()]) <= road {
                near.boundary.push((leaf - pieces.len()) as u32);
            }
        });
    }

    /// Pushes those of the entries `from..to` that may be within reach of the hull.
    fn narrow(
        &mut self,
        hull: &mut NodeHull,
        (from, to): ((usize, usize), (usize, usize)),
        (obstacles, road): (f64, f64),
    ) {
        let statics = &self.world.statics;
        hull.keep(&mut self.near.obstacles, from.0..to.0, statics.obstacles(), obstacles);
        hull.keep(&mut self.near.boundary, from.1..to.1, statics.road().boundary(), road);
    }

    /// The first cell of a node that meets one of the entries from `from` on.
    fn descend(&mut self, search: &Search, node: &Node, from: (usize, usize)) -> Option<StaticHit> {
        let to = self.near.top();
        if node.cells() == 1 {
            return self.hit_in_cell(search, node.first, from);
        }
        for half in node.halves() {
            if half.cells() == 0 || half.first > search.last {
                continue;
            }
            if half.cells() > 1 {
                let mut hull = self.hull(&half, search.widest());
                self.narrow(&mut hull, (from, to), search.reach);
            } else if let Some(hit) = self.hit_in_cell(search, half.first, from) {
                return Some(hit);
            }
            if self.near.top() != to {
                let hit = self.descend(search, &half, to);
                if hit.is_some() {
                    return hit;
                }
            }
            self.near.truncate(to);
        }
        None
    }

    /// The first subcell that meets one of the entries from `from` on, if the cell as a whole does.
    fn hit_in_cell(&mut self, search: &Search, cell: usize, from: (usize, usize)) -> Option<StaticHit> {
        let leaves = self.course.station(cell + 1);
        let ends = [self.course.frame(cell), self.course.frame(cell + 1)];
        let slack = self.course.cell_slack(cell);
        self.blocker_of(search, leaves, (ends, slack), from)?;
        self.course.subcells(cell, ends).into_iter().find_map(|subcell| {
            let what = self.blocker_of(search, leaves, (subcell.ends, subcell.slack), from)?;
            Some(StaticHit { station: subcell.station, cell, what })
        })
    }

    /// What a footprint meets, between two frames in the cell that ends at a station (m). Only cells within the allowance are excused.
    fn blocker_of(
        &self,
        search: &Search,
        leaves: f64,
        (ends, slack): ([Frame; 2], Slack),
        from: (usize, usize),
    ) -> Option<Blocker> {
        let statics = &self.world.statics;
        let allowance = search.allowance;
        let is_reduced = leaves <= allowance.reduced_until;
        let first = |entries: &[u32], pieces: &[Convex], margins: &Margins, share: f64| {
            if entries.is_empty() {
                return None;
            }
            let margins = margins.scaled(if is_reduced { share } else { 1.0 });
            let mut shape = self.world.outline.footprint(ends, &margins, slack.at(margins.reach()));
            let aabb = shape.aabb();
            entries.iter().copied().find(|i| {
                let piece = &pieces[*i as usize];
                boxes_meet(piece.aabb(), &aabb) && piece.overlaps(&mut shape)
            })
        };
        if let Some(piece) =
            first(&self.near.obstacles[from.0..], statics.obstacles(), &search.obstacles, allowance.to_obstacles)
        {
            return Some(statics.blocker(piece));
        }
        let on_edge = search.checks_road(leaves)
            && first(&self.near.boundary[from.1..], statics.road().boundary(), &search.boundary, allowance.to_road)
                .is_some();
        on_edge.then_some(Blocker::RoadBoundary)
    }
}

/// The margins and the allowance of a search, and its last cell.
struct Search<'a> {
    obstacles: Margins,
    boundary: Margins,
    /// Reach of both margins, m.
    reach: (f64, f64),
    allowance: &'a Allowance,
    last: usize,
}

impl<'a> Search<'a> {
    fn new(margins: &SafetyMargins, allowance: &'a Allowance, last: usize) -> Self {
        let (obstacles, boundary) = (margins.static_obstacles, margins.to_boundary());
        Self { obstacles, boundary, reach: (obstacles.reach(), boundary.reach()), allowance, last }
    }

    fn widest(&self) -> f64 {
        self.reach.0.max(self.reach.1)
    }

    /// Whether the road matters in a cell that ends at a station (m).
    fn checks_road(&self, leaves: f64) -> bool {
        leaves > self.allowance.no_road_until
    }
}

/// The smallest distance of the body, given by its corners and the box around them, to the entries, at most `cap`, m.
fn nearest(entries: &[u32], pieces: &[Convex], (corners, turned): (&[Local], &OrientedBox), cap: f64) -> f64 {
    entries.iter().map(|i| &pieces[*i as usize]).fold(cap, |least, piece| {
        if turned.gap_to(piece) - ROUNDING < least { least.min(piece.distance_to(corners)) } else { least }
    })
}

/// The coarse hull of a node, without margins.
#[derive(Debug, Clone)]
struct NodeHull {
    corners: SweptCorners,
    /// The oriented bounding box, aligned with the path.
    oriented_box: OrientedBox,
    /// Outward unit normals of the edges of the hull with the extent of the hull in their direction; on demand.
    edges: Option<([(Local, f64); 8], usize)>,
}

impl NodeHull {
    /// `direction` is its approximate direction, of any length.
    fn new(corners: [Local; 8], direction: Local) -> Self {
        Self {
            corners: SweptCorners::new(corners),
            oriented_box: OrientedBox::around(&corners, direction),
            edges: None,
        }
    }

    /// Appends those of the entries in the range that may be within `reach`.
    fn keep(&mut self, entries: &mut Vec<u32>, range: Range<usize>, pieces: &[Convex], reach: f64) {
        for i in range {
            let entry = entries[i];
            if self.may_meet(&pieces[entry as usize], reach) {
                entries.push(entry);
            }
        }
    }

    /// `false` only if the piece is farther than `reach` from the hull.
    fn may_meet(&mut self, piece: &Convex, reach: f64) -> bool {
        let reach = reach + piece.radius();
        let (edges, n) = self.edges();
        edges[..*n].iter().all(|(outward, extent)| {
            let limit = extent + reach;
            piece.points().iter().any(|p| outward.dot(*p) <= limit)
        })
    }

    fn edges(&mut self) -> &([(Local, f64); 8], usize) {
        self.edges.get_or_insert_with(|| {
            let hull = self.corners.hull();
            let mut edges = [(Local::ZERO, 0.0); 8];
            let n = hull.len().min(edges.len());
            let mut from = hull[hull.len() - 1];
            for (edge, &to) in edges.iter_mut().zip(hull) {
                let outward = Local::new(to.y - from.y, from.x - to.x).normalize_or_zero();
                *edge = (outward, outward.dot(from));
                from = to;
            }
            (edges, n)
        })
    }
}
