//! Occupied cells of a grid as colliders, near the vehicle only.
//!
//! Grids have millions of cells, and the vehicle meets a few hundred of them. Neighbouring cells are merged into
//! rectangles on one fixed body, within a window around the vehicle. The window exceeds by [`SLACK`] what the vehicle
//! can reach until the next review, and is rebuilt once the vehicle has moved that far. Therefore no contact is missed,
//! and the cost depends on the window, not on the grid.

use rapier2d::dynamics::{RigidBodyBuilder, RigidBodyHandle};
use rapier2d::geometry::SharedShape;
use rapier2d::math::{Pose as RapierPose, Vector as RapierVector};

use super::convert::Frame;
use super::physics::Physics;
use crate::geometry::Point;
use crate::map::{Cell, OccupancyGrid};

/// User data of the cells' colliders; those of obstacles count from 0.
pub(super) const CELL: u128 = u128::MAX;

/// Distance that the vehicle may move before the window is rebuilt, m.
const SLACK: f64 = 5.0;

/// The occupied cells of a world.
#[derive(Clone)]
pub(super) struct Cells {
    grid: OccupancyGrid,
    window: Option<Window>,
}

/// The region in which the cells have colliders.
#[derive(Clone, Copy)]
struct Window {
    centre: Point,
    radius: f64,
    body: RigidBodyHandle,
}

impl Cells {
    /// The grid's cells, without colliders yet.
    pub(super) fn new(grid: &OccupancyGrid) -> Self {
        Self { grid: grid.clone(), window: None }
    }

    /// Ensures that all occupied cells within `reach` of a position have colliders.
    pub(super) fn review(&mut self, physics: &mut Physics, frame: &Frame, position: Point, reach: f64) {
        if self.window.is_some_and(|w| (position - w.centre).norm() + reach <= w.radius) {
            return;
        }
        if let Some(window) = self.window.take() {
            physics.remove(window.body);
        }
        let radius = reach + SLACK;
        let part = self.grid.part_around(&[position], radius);
        let side = self.grid.resolution();
        let blocks = self.grid.blocks_within(&part, |cell| cell == Cell::Occupied);
        let shapes: Vec<(RapierPose, SharedShape)> = blocks
            .iter()
            .map(|block| {
                let half = |range: &std::ops::Range<usize>| 0.5 * side * range.len() as f64;
                let middle = |range: &std::ops::Range<usize>| 0.5 * side * (range.start + range.end) as f64;
                let place = RapierVector::new(middle(&block.columns), middle(&block.rows));
                let shape = SharedShape::cuboid(half(&block.columns), half(&block.rows));
                (RapierPose::from_translation(place), shape)
            })
            .collect();
        let body = RigidBodyBuilder::fixed().pose(frame.pose_in(self.grid.origin()));
        let body = physics.insert(body, &shapes, CELL);
        self.window = Some(Window { centre: position, radius, body });
    }
}
