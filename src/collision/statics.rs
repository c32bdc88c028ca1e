//! The static world: static obstacles, occupied cells of a grid and the road boundary.
//!
//! Only the cells of an occupancy grid near the road are kept, since the vehicle cannot reach the others.
//!
//! Convex pieces are in parry's bounding volume hierarchies, one for the obstacles and one for the boundary segments, since
//! they have different margins. A sweep is tested in blocks of eight cells: one query of the hierarchies per block, then the
//! exact test of the cells whose boxes meet a candidate.

use parry2d::bounding_volume::{Aabb, BoundingVolume as _};
use parry2d::partitioning::{Bvh, BvhBuildStrategy};

use super::convert::{Local, Origin};
use super::convex::{Convex, boxes_meet, inflated};
use super::drivable::DrivableArea;
use super::margins::{Margins, SafetyMargins};
use super::swept::{FAN, Sweep};
use super::wide::WideTree;
use super::{Blocker, CollisionSettings, Overlap};
use crate::map::{Cell, Motion, Obstacle, OccupancyGrid, RoadNetwork};

/// Number of cells between two poses at which the clearance is measured.
pub(super) const STRIDE: usize = 4;

/// The first cell of a sweep that meets the static world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StaticHit {
    /// Start of that cell, m from the start of the sweep: the last collision-free station of the rear axle.
    pub station: f64,
    /// Index of the cell.
    pub cell: usize,
    /// The blocker; obstacles (lowest id first) take precedence over occupied cells, these over the road boundary.
    pub what: Blocker,
}

/// Relaxation of a check near the start of a sweep: a vehicle that already stands inside a margin, or partly off the road,
/// must be able to leave. Stations are m from the start of the sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Allowance {
    /// Up to this station footprints have no margins, m.
    pub no_margins_until: f64,
    /// Up to this station the road boundary is ignored, m.
    pub no_road_until: f64,
}

impl Allowance {
    /// No relaxation.
    pub const NONE: Self = Self { no_margins_until: f64::NEG_INFINITY, no_road_until: f64::NEG_INFINITY };
}

/// Distances of a sweep to the static world, m, each limited to a cap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clearance {
    /// Distance to the nearest static obstacle or occupied cell, m.
    pub obstacle: f64,
    /// Distance to the road boundary, m.
    pub road: f64,
}

/// Static obstacles, occupied cells and the road boundary.
#[derive(Debug, Clone)]
pub struct StaticWorld {
    road: DrivableArea,
    /// Convex pieces: those of the obstacles in order of their ids, then those of the occupancy grid.
    pieces: Vec<Convex>,
    /// The blocker of each piece.
    blockers: Vec<Blocker>,
    tree: Bvh,
    /// Hierarchy over the pieces and, numbered after them, the boundary segments.
    everything: WideTree,
}

impl StaticWorld {
    /// `reach` is the largest distance of the footprint from the rear axle, m.
    pub(super) fn new(
        network: &RoadNetwork,
        occupancy: Option<&OccupancyGrid>,
        obstacles: &[Obstacle],
        origin: Origin,
        settings: &CollisionSettings,
        reach: f64,
    ) -> Self {
        let mut found: Vec<(i64, Convex)> = Vec::new();
        for obstacle in obstacles {
            if let Motion::Static(pose) = &obstacle.motion {
                let parts = obstacle.shape.convex_parts();
                found.extend(parts.iter().filter_map(|p| Some((obstacle.id, Convex::of_part(&p.at(pose), &origin)?))));
            }
        }
        found.sort_by_key(|(id, _)| *id);
        let found = found.into_iter().map(|(id, piece)| (Blocker::Obstacle(id), piece));
        let road = DrivableArea::with_origin(network, origin);
        let of_grid = |grid| occupied(grid, network, settings, &origin, &road, 2.0 * reach + BESIDE);
        let cells = occupancy.map(of_grid).unwrap_or_default().into_iter().map(|piece| (Blocker::OccupiedCell, piece));
        let (blockers, pieces): (Vec<Blocker>, Vec<Convex>) = found.chain(cells).unzip();
        let boxes: Vec<Aabb> = pieces.iter().map(|p| *p.aabb()).collect();
        Self {
            everything: WideTree::new(pieces.iter().chain(road.boundary()).map(|p| *p.aabb())),
            road,
            tree: Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes),
            pieces,
            blockers,
        }
    }

    /// The drivable area.
    #[must_use]
    pub fn road(&self) -> &DrivableArea {
        &self.road
    }

    /// The first cell in which the swept footprint with its margins meets a static obstacle or leaves the road.
    #[must_use]
    pub fn first_hit(&self, sweep: &Sweep, margins: &SafetyMargins, allowance: &Allowance) -> Option<StaticHit> {
        // the footprint of a part is connected: if no boundary meets it, one point inside proves that all of it is inside
        let first_checked = sweep.stations().iter().position(|s| *s >= allowance.no_road_until);
        let on_road = |i: usize| sweep.outline().all_parts(&sweep.frames()[i], |p| self.road.contains_local(p));
        let off_road = first_checked.filter(|i| !on_road(*i));
        let off_road = off_road.map(|i| i.min(sweep.cells() - 1));
        let hit = sweep
            .boxes()
            .blocks()
            .iter()
            .enumerate()
            .find_map(|(i, block)| self.hit_in_block(sweep, margins, allowance, (i, block)));
        match (hit, off_road) {
            (Some(hit), Some(cell)) if hit.cell <= cell => Some(hit),
            (_, Some(cell)) => Some(StaticHit { station: sweep.stations()[cell], cell, what: Blocker::RoadBoundary }),
            (hit, None) => hit,
        }
    }

    fn hit_in_block(
        &self,
        sweep: &Sweep,
        margins: &SafetyMargins,
        allowance: &Allowance,
        (block, aabb): (usize, &Aabb),
    ) -> Option<StaticHit> {
        let (obstacle_margins, road_margins) = (margins.static_obstacles, margins.to_boundary());
        let reach = inflated(aabb, sweep.reach(&obstacle_margins));
        let near = |i: &u32| sweep.block_may_meet(block, &self.pieces[*i as usize], &obstacle_margins);
        let mut obstacles: Vec<u32> = self.tree.intersect_aabb(&reach).filter(near).collect();
        obstacles.sort_unstable();
        let reach = inflated(aabb, sweep.reach(&road_margins));
        let near = |piece: &&Convex| sweep.block_may_meet(block, piece, &road_margins);
        let edge: Vec<&Convex> = self.road.near(&reach).filter(near).collect();
        if obstacles.is_empty() && edge.is_empty() {
            return None;
        }
        (FAN * block..(FAN * (block + 1)).min(sweep.cells())).find_map(|cell| {
            let station = sweep.stations()[cell];
            let relaxed = station < allowance.no_margins_until;
            let margins = if relaxed { Margins::NONE } else { obstacle_margins };
            let reach = sweep.cell_box(cell, &margins);
            let mut corners = sweep.corners(cell, &margins);
            let mut meets = |piece: &Convex| boxes_meet(piece.aabb(), &reach) && piece.overlaps(&mut corners);
            if let Some(hit) = obstacles.iter().find(|i| meets(&self.pieces[**i as usize])) {
                return Some(StaticHit { station, cell, what: self.blocker(*hit) });
            }
            if station < allowance.no_road_until {
                return None;
            }
            let margins = if relaxed { Margins::NONE } else { road_margins };
            let reach = sweep.cell_box(cell, &margins);
            let mut corners = sweep.corners(cell, &margins);
            let mut meets = |piece: &Convex| boxes_meet(piece.aabb(), &reach) && piece.overlaps(&mut corners);
            edge.iter().any(|piece| meets(piece)).then_some(StaticHit { station, cell, what: Blocker::RoadBoundary })
        })
    }

    /// The pieces of the obstacles, in order of their ids, followed by those of the occupancy grid.
    pub(super) fn obstacles(&self) -> &[Convex] {
        &self.pieces
    }

    /// The hierarchy over the pieces of the obstacles and, numbered after them, the boundary segments.
    pub(super) fn everything(&self) -> &WideTree {
        &self.everything
    }

    /// The blocker of a piece of [`StaticWorld::obstacles`].
    pub(super) fn blocker(&self, piece: u32) -> Blocker {
        self.blockers[piece as usize]
    }

    /// Distance of the vehicle without margins to static obstacles and to the road boundary, at most `cap`, m: the minimum
    /// over the poses at every fourth cell limit and at the last one. For costs of paths without a hit: between these poses
    /// the distance may be slightly smaller in curves.
    #[must_use]
    pub fn clearance(&self, sweep: &Sweep, cap: f64) -> Clearance {
        let frames = sweep.frames();
        let mut least = Clearance { obstacle: cap, road: cap };
        for frame in frames.iter().step_by(STRIDE).chain(frames.last()) {
            sweep.outline().for_each_part(frame, |part| {
                let aabb = Aabb::from_points_ref(part);
                least.obstacle = super::nearest(&self.tree, &self.pieces, part, &aabb, least.obstacle);
                least.road = self.road.boundary_distance(part, &aabb, least.road);
            });
        }
        least
    }

    /// The static obstacle, else the road boundary, that a part of the footprint without margins overlaps.
    pub(super) fn overlap(&self, part: &[Local]) -> Option<Overlap> {
        let aabb = Aabb::from_points_ref(part);
        let mut hits: Vec<u32> = self.tree.intersect_aabb(&aabb).collect();
        hits.sort_unstable();
        let hit = hits.into_iter().find(|i| self.pieces[*i as usize].distance_to(part) == 0.0);
        if let Some(i) = hit {
            let depth = self.pieces[i as usize].depth_in(part);
            return Some(Overlap { what: self.blocker(i), depth });
        }
        let depth = self.road.depth_outside(part)?;
        Some(Overlap { what: Blocker::RoadBoundary, depth })
    }
}

/// Largest distance from the road of a start position that the occupancy grid covers, with margins, m.
const BESIDE: f64 = 20.0;

/// The occupied cells of the scenario's grid within a distance of the road, merged into few rectangles; all of them if there
/// is no road. If any part of the vehicle is on the road, all other parts are within twice its reach.
fn occupied(
    grid: &OccupancyGrid,
    network: &RoadNetwork,
    settings: &CollisionSettings,
    origin: &Origin,
    road: &DrivableArea,
    distance: f64,
) -> Vec<Convex> {
    let is_occupied = |cell| cell == Cell::Occupied || settings.unknown_is_occupied && cell == Cell::Unknown;
    let piece = |block| Convex::hull_of(grid.corners(&block).iter().map(|p| origin.local(*p)).collect(), 0.0);
    if road.is_empty() {
        return grid.blocks(is_occupied).into_iter().filter_map(piece).collect();
    }
    let bounds = network.lanelets.values().flat_map(|l| l.left.points().iter().chain(l.right.points()));
    let part = grid.part_around(bounds, distance);
    let is_near = |piece: &Convex| {
        let around = piece.aabb().loosened(distance);
        road.near(&around).next().is_some() || road.contains_local(piece.aabb().center())
    };
    grid.blocks_within(&part, is_occupied).into_iter().filter_map(piece).filter(is_near).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{network, road, straight_lanelet};
    use crate::geometry::{Point, Pose};

    /// Centres of the kept cells of one row of cells perpendicular to the road, one every 10 m.
    fn kept(road: &RoadNetwork) -> Vec<f64> {
        let mut cells = vec![Cell::Free; 1000];
        cells.iter_mut().step_by(10).for_each(|cell| *cell = Cell::Occupied);
        let grid = OccupancyGrid::new(Pose::new(50.0, -500.0, 0.0), 1.0, 1, 1000, cells).unwrap();
        let at = Origin::amid(&[Point::origin()]);
        let world = StaticWorld::new(road, Some(&grid), &[], at, &CollisionSettings::default(), 3.0);
        world.pieces.iter().map(|piece| piece.aabb().center().y).collect()
    }

    #[test]
    fn keeps_only_cells_that_the_vehicle_can_reach() {
        // within 26 m of a road from −2 to 2 m
        assert_eq!(kept(&road(4.0, 100.0)), [-19.5, -9.5, 0.5, 10.5, 20.5]);
        // in the middle of a wide one, far from its edge
        let wide = kept(&network([straight_lanelet(1, (-200.0, 200.0), -200.0, 200.0)]));
        assert_eq!((wide.len(), wide[0], wide[wide.len() - 1]), (45, -219.5, 220.5));
        assert_eq!(kept(&RoadNetwork::default()).len(), 100, "without a road all cells are kept");
    }
}
