//! The static world: static obstacles, occupied cells of a grid and the road boundary.
//!
//! Only the cells of an occupancy grid near the road are kept, since the vehicle cannot reach the others.
//!
//! The convex pieces of the obstacles and the boundary segments are in one hierarchy of boxes. [`super::EdgeProbe`] checks paths
//! against them.

use parry2d::bounding_volume::BoundingVolume as _;

use super::convert::{Local, Origin};
use super::convex::Convex;
use super::drivable::DrivableArea;
use super::wide::{OrientedBox, WideTree};
use super::{Blocker, CollisionSettings, Overlap};
use crate::map::{Cell, Motion, Obstacle, OccupancyGrid, RoadNetwork};

/// The first contact of a path with the static world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StaticHit {
    /// The last collision-free station of the rear axle, to 0.1 m; m from the start of the path.
    pub station: f64,
    /// Index of the cell with the contact.
    pub cell: usize,
    /// The blocker; obstacles (lowest id first) take precedence over occupied cells, these over the road boundary.
    pub what: Blocker,
}

/// Relaxation of a check near the start of a path: a vehicle that already stands inside a margin, or partly off the road,
/// must be able to leave. Stations are m from the start of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Allowance {
    /// Up to this station footprints keep only the shares of their margins, m.
    pub reduced_until: f64,
    /// Share of the margins to obstacles, from 0 to 1.
    pub to_obstacles: f64,
    /// Share of the margin to the road boundary, from 0 to 1.
    pub to_road: f64,
    /// Up to this station the road boundary is ignored, m.
    pub no_road_until: f64,
}

impl Allowance {
    /// No relaxation.
    pub const NONE: Self =
        Self { reduced_until: f64::NEG_INFINITY, to_obstacles: 1.0, to_road: 1.0, no_road_until: f64::NEG_INFINITY };

    /// Whether it is for a vehicle that is partly off the road.
    #[must_use]
    pub fn is_off_road(&self) -> bool {
        self.no_road_until > 0.0
    }

    /// For the part of the path from a station (m) on.
    #[must_use]
    pub fn beyond(self, station: f64) -> Self {
        let (reduced_until, no_road_until) = (self.reduced_until - station, self.no_road_until - station);
        Self { reduced_until, no_road_until, ..self }
    }
}

/// Distances of a path to the static world, m, each limited to a cap.
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
        Self {
            everything: WideTree::new(pieces.iter().chain(road.boundary()).map(|p| *p.aabb())),
            road,
            pieces,
            blockers,
        }
    }

    /// The drivable area.
    #[must_use]
    pub fn road(&self) -> &DrivableArea {
        &self.road
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

    /// The static obstacle, else the road boundary, that a part of the footprint without margins overlaps.
    pub(super) fn overlap(&self, part: &[Local]) -> Option<Overlap> {
        let mut first: Option<usize> = None;
        self.everything.visit(&OrientedBox::around(part, Local::X), 0.0, |leaf| {
            if self.pieces.get(leaf).is_some_and(|piece| piece.distance_to(part) == 0.0) {
                first = Some(first.map_or(leaf, |i| i.min(leaf)));
            }
        });
        if let Some(i) = first {
            return Some(Overlap { what: self.blockers[i], depth: self.pieces[i].depth_in(part) });
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
