//! Contact with the occupied cells of a grid: the driven footprints against all of them near the way. The rig has no
//! bodies for cells, so this is what sees them.

use super::shapes::{Bounds, footprint_at, gap};
use crate::geometry::Point;
use crate::map::{Cell, ConvexPart, Scenario};
use crate::simulation::Log;
use crate::vehicle::Vehicle;

/// The deepest overlap with occupied cells in a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct InCells {
    /// Depth of the overlap with neighbouring cells as one, m.
    pub(super) depth: f64,
    /// Time of the run, s.
    pub(super) time: f64,
    /// Middle of the cells.
    at: Point,
}

impl InCells {
    pub(super) fn note(&self) -> String {
        format!("the driven footprint overlaps occupied cells around ({:.2}, {:.2})", self.at.x, self.at.y)
    }
}

/// The deepest overlap over all samples; `None` if there is none.
pub(super) fn deepest(scenario: &Scenario, vehicle: &Vehicle, log: &Log) -> Option<InCells> {
    let grid = scenario.occupancy.as_ref()?;
    let parts = log.samples.iter().flat_map(|s| footprint_at(vehicle, &s.pose).into_iter().map(|part| (s.time, part)));
    let parts: Vec<(f64, Vec<Point>)> = parts.collect();
    let way: Vec<Point> = parts.iter().flat_map(|(_, corners)| corners).copied().collect();
    let way = Bounds::of(&way);
    let blocks = grid.blocks(|cell| cell == Cell::Occupied);
    let near: Vec<(Bounds, [Point; 4])> = blocks
        .iter()
        .map(|block| grid.corners(block))
        .map(|corners| (Bounds::of(&corners), corners))
        .filter(|(bounds, _)| bounds.near(&way, 0.0))
        .collect();
    let mut worst: Option<InCells> = None;
    for (time, part) in &parts {
        let here = Bounds::of(part);
        for (_, corners) in near.iter().filter(|(bounds, _)| bounds.near(&here, 0.0)) {
            let depth = -gap(part, &ConvexPart::Polygon(corners.to_vec()));
            if depth > worst.map_or(0.0, |w| w.depth) {
                let at = nalgebra::center(&corners[0], &corners[2]);
                worst = Some(InCells { depth, time: *time, at });
            }
        }
    }
    worst
}
