//! What became of the edges that a search looked at: the reasons behind a lattice that offers little or nothing.

use std::collections::BTreeMap;

use crate::collision::Blocker;

/// Edges that a search looked at, by what became of them. Every edge counts once:
/// `tried` = `off_road` + `no_spiral` + `curvature_bound` + `winds` + `unchecked` + `obstacle` + `occupied_cell` +
/// `road_edge` + `free`.
///
/// Counts depend on the question alone, not on what the store had kept from before; only `solved` and `swept` do.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct EdgeCounts {
    /// Pairs of start and node that the lattice's shape allows.
    pub tried: usize,
    /// The node itself lies off the road.
    pub off_road: usize,
    /// No cubic spiral was found that ends in the node.
    pub no_spiral: usize,
    /// The spiral would bend more than the vehicle can.
    pub curvature_bound: usize,
    /// The spiral makes a long detour to meet its end conditions.
    pub detour: usize,
    /// Never checked for collision: not even a free one would have been part of a path worth returning.
    pub unchecked: usize,
    /// Ends in front of a static obstacle.
    pub obstacle: usize,
    /// Ends in front of an occupied cell of a grid.
    pub occupied_cell: usize,
    /// Ends where the road does.
    pub road_edge: usize,
    /// Free over its whole length.
    pub free: usize,
    /// Edges whose spiral was solved in this search; the others were kept from before.
    pub solved: usize,
    /// Edges whose footprint was swept and checked in this search; the others were kept from before.
    pub swept: usize,
    /// `obstacle` by the obstacle's id in the file.
    pub by_obstacle: BTreeMap<i64, usize>,
}

/// Why there is no edge between two places.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NoEdge {
    OffRoad,
    NoSpiral,
    CurvatureBound,
    Detour,
}

impl EdgeCounts {
    /// Every count with its stable name, in a stable order.
    #[must_use]
    pub fn named(&self) -> [(&'static str, usize); 12] {
        [
            ("tried", self.tried),
            ("off_road", self.off_road),
            ("no_spiral", self.no_spiral),
            ("curvature_bound", self.curvature_bound),
            ("detour", self.detour),
            ("unchecked", self.unchecked),
            ("obstacle", self.obstacle),
            ("occupied_cell", self.occupied_cell),
            ("road_edge", self.road_edge),
            ("free", self.free),
            ("solved", self.solved),
            ("swept", self.swept),
        ]
    }

    /// The sum of two searches.
    pub fn add(&mut self, other: &Self) {
        self.tried += other.tried;
        self.off_road += other.off_road;
        self.no_spiral += other.no_spiral;
        self.curvature_bound += other.curvature_bound;
        self.detour += other.detour;
        self.unchecked += other.unchecked;
        self.obstacle += other.obstacle;
        self.occupied_cell += other.occupied_cell;
        self.road_edge += other.road_edge;
        self.free += other.free;
        self.solved += other.solved;
        self.swept += other.swept;
        for (id, count) in &other.by_obstacle {
            *self.by_obstacle.entry(*id).or_default() += count;
        }
    }

    pub(super) fn count_refused(&mut self, reason: NoEdge) {
        self.tried += 1;
        match reason {
            NoEdge::OffRoad => self.off_road += 1,
            NoEdge::NoSpiral => self.no_spiral += 1,
            NoEdge::CurvatureBound => self.curvature_bound += 1,
            NoEdge::Detour => self.detour += 1,
        }
    }

    pub(super) fn count_unchecked(&mut self) {
        self.tried += 1;
        self.unchecked += 1;
    }

    pub(super) fn count_checked(&mut self, blocked_by: Option<Blocker>) {
        self.tried += 1;
        match blocked_by {
            None => self.free += 1,
            Some(Blocker::RoadBoundary) => self.road_edge += 1,
            Some(Blocker::OccupiedCell) => self.occupied_cell += 1,
            Some(Blocker::Obstacle(id)) => {
                self.obstacle += 1;
                *self.by_obstacle.entry(id).or_default() += 1;
            }
        }
    }
}
