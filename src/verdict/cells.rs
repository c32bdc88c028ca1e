//! Distance of the driven footprints to the occupied cells of a grid, computed without the colliders of the simulation.
//!
//! The driven path is divided into sections of two metres. Each section is tested against the occupied cells within [`FAR`],
//! merged into rectangles. The cost therefore grows with the length of the path and not with the size of the grid.

use super::contact::{Nearest, Place, Thing};
use super::shapes::{Bounds, footprint_at, gap};
use crate::geometry::Point;
use crate::map::{Cell, ConvexPart, Scenario};
use crate::vehicle::Vehicle;

/// Cells farther away than this are ignored, m.
pub(super) const FAR: f64 = 10.0;
/// Length of a section of the path, m.
const SECTION: f64 = 2.0;

/// The smallest gap to an occupied cell at any place; `None` without an occupied cell within [`FAR`]. Neighbouring cells
/// count as one block.
pub(super) fn nearest(scenario: &Scenario, vehicle: &Vehicle, places: &[Place]) -> Option<Nearest> {
    let grid = scenario.occupancy.as_ref()?;
    let mut best: Option<Nearest> = None;
    for section in sections(places) {
        let parts = section.iter().flat_map(|p| footprint_at(vehicle, &p.pose).into_iter().map(move |part| (p, part)));
        let parts: Vec<(&Place, Vec<Point>)> = parts.collect();
        let around = grid.part_around(parts.iter().flat_map(|(_, corners)| corners), FAR);
        let blocks = grid.blocks_within(&around, |cell| cell == Cell::Occupied);
        let corners = blocks.iter().map(|block| grid.corners(block));
        let blocks: Vec<(Bounds, [Point; 4])> = corners.map(|corners| (Bounds::of(&corners), corners)).collect();
        for (place, part) in &parts {
            let here = Bounds::of(part);
            for (bounds, corners) in &blocks {
                let floor = best.map_or(FAR, |b| b.gap);
                if !bounds.near(&here, floor.max(0.0)) {
                    continue;
                }
                let gap = gap(part, &ConvexPart::Polygon(corners.to_vec()));
                if gap < floor {
                    let thing = Thing::Cells(nalgebra::center(&corners[0], &corners[2]));
                    best = Some(Nearest { gap, time: place.time, speed: place.speed, thing });
                }
            }
        }
    }
    best
}

/// The blocks of occupied cells around places that are near each other.
pub(super) fn blocks_around(scenario: &Scenario, vehicle: &Vehicle, places: &[Place]) -> Vec<ConvexPart> {
    /// Larger than what a vehicle drives between two samples, m.
    const MARGIN: f64 = 2.0;
    let Some(grid) = scenario.occupancy.as_ref() else { return Vec::new() };
    let corners: Vec<Point> = places.iter().flat_map(|p| footprint_at(vehicle, &p.pose)).flatten().collect();
    let blocks = grid.blocks_within(&grid.part_around(&corners, MARGIN), |cell| cell == Cell::Occupied);
    blocks.iter().map(|block| ConvexPart::Polygon(grid.corners(block).to_vec())).collect()
}

/// The places in runs, each run within [`SECTION`] of its first place.
fn sections(places: &[Place]) -> Vec<&[Place]> {
    let mut remaining = places;
    let mut sections = Vec::new();
    while let Some(first) = remaining.first() {
        let leaves = |p: &Place| (p.pose.position - first.pose.position).norm() > SECTION;
        let (section, after) = remaining.split_at(remaining.iter().position(leaves).unwrap_or(remaining.len()));
        sections.push(section);
        remaining = after;
    }
    sections
}
