//! Distance to the occupied cells of a grid: the driven footprints against all of them near the way, by other code than
//! the rig's colliders.
//!
//! The way is cut into stretches of two metres; each is held against the cells within [`FAR`] of it, merged to
//! rectangles. So the cost grows with the way and not with the grid.

use super::shapes::{Bounds, footprint_at, gap};
use crate::geometry::Point;
use crate::map::{Cell, ConvexPart, Scenario};
use crate::simulation::{Log, Sample};
use crate::vehicle::Vehicle;

/// Cells farther away than this are not looked for, m.
pub(super) const FAR: f64 = 10.0;
/// Length of a stretch of the way, m.
const STRETCH: f64 = 2.0;

/// The smallest gap to occupied cells in a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NearestCells {
    /// Gap, m; negative is the depth of an overlap with neighbouring cells as one.
    pub(super) gap: f64,
    /// Time of the run, s.
    pub(super) time: f64,
    /// Middle of the cells.
    at: Point,
}

impl std::fmt::Display for NearestCells {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "({:.2}, {:.2})", self.at.x, self.at.y)
    }
}

/// The smallest gap over all samples; `None` without an occupied cell within [`FAR`].
pub(super) fn closest(scenario: &Scenario, vehicle: &Vehicle, log: &Log) -> Option<NearestCells> {
    let grid = scenario.occupancy.as_ref()?;
    let mut best: Option<NearestCells> = None;
    for stretch in stretches(&log.samples) {
        let parts = stretch.iter().flat_map(|s| footprint_at(vehicle, &s.pose).into_iter().map(|part| (s.time, part)));
        let parts: Vec<(f64, Vec<Point>)> = parts.collect();
        let around = grid.part_around(parts.iter().flat_map(|(_, corners)| corners), FAR);
        let blocks = grid.blocks_within(&around, |cell| cell == Cell::Occupied);
        let corners = blocks.iter().map(|block| grid.corners(block));
        let blocks: Vec<(Bounds, [Point; 4])> = corners.map(|corners| (Bounds::of(&corners), corners)).collect();
        for (time, part) in &parts {
            let here = Bounds::of(part);
            for (bounds, corners) in &blocks {
                let floor = best.map_or(FAR, |b| b.gap);
                if !bounds.near(&here, floor.max(0.0)) {
                    continue;
                }
                let found = gap(part, &ConvexPart::Polygon(corners.to_vec()));
                if found < floor {
                    let at = nalgebra::center(&corners[0], &corners[2]);
                    best = Some(NearestCells { gap: found, time: *time, at });
                }
            }
        }
    }
    best
}

/// The samples in runs within [`STRETCH`] of their first.
fn stretches(samples: &[Sample]) -> Vec<&[Sample]> {
    let mut rest = samples;
    let mut found = Vec::new();
    while let Some(first) = rest.first() {
        let leaves = |s: &Sample| (s.pose.position - first.pose.position).norm() > STRETCH;
        let (stretch, after) = rest.split_at(rest.iter().position(leaves).unwrap_or(rest.len()));
        found.push(stretch);
        rest = after;
    }
    found
}
