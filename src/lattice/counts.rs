//! Counts of lattice edges by outcome: they explain why a lattice has few paths or none.

use std::collections::BTreeMap;

use crate::collision::Blocker;

/// Counts of the edges of a search by outcome. Every edge counts once:
/// `tried` = `off_road` + `no_spiral` + `curvature_bound` + `detour` + `unchecked` + `obstacle` + `occupied_cell` +
/// `road_edge` + `free`.
///
/// Except `solved` and `swept`, the counts do not depend on the edges that are cached from earlier searches.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct EdgeCounts {
    /// Pairs of start and node within the shape of the lattice.
    pub tried: usize,
    /// The node is off the road.
    pub off_road: usize,
    /// No cubic spiral connects start and node.
    pub no_spiral: usize,
    /// The spiral exceeds the curvature bound of the vehicle.
    pub curvature_bound: usize,
    /// The spiral is much longer than its chord.
    pub detour: usize,
    /// Not checked for collision, because the edge cannot be part of a returned path.
    pub unchecked: usize,
    /// Blocked by a static obstacle.
    pub obstacle: usize,
    /// Blocked by an occupied cell of an occupancy grid.
    pub occupied_cell: usize,
    /// Blocked by the road boundary.
    pub road_edge: usize,
    /// Free over its whole length.
    pub free: usize,
    /// Edges whose spiral was solved in this search; the others were cached.
    pub solved: usize,
    /// Edges that were swept and checked in this search; the others were cached.
    pub swept: usize,
    /// `obstacle` by the id of the obstacle.
    pub by_obstacle: BTreeMap<i64, usize>,
}

/// Why there is no edge between a start and a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NoEdge {
    OffRoad,
    NoSpiral,
    CurvatureBound,
    Detour,
}

impl EdgeCounts {
    /// Every count with its name in reports, in a stable order.
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

    /// Adds the counts of another search.
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

    pub(super) fn count_rejected(&mut self, reason: NoEdge) {
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
