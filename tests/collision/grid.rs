//! Occupied cells of synthetic grids.

use stopline::collision::{Blocker, CollisionSettings};
use stopline::geometry::Pose;
use stopline::map::{Cell, OccupancyGrid};

use crate::helpers::{no_margins, plain, scenario, straight, vehicle, world};

fn grid_of(origin: Pose, resolution: f64, width: usize, cells: Vec<Cell>) -> OccupancyGrid {
    OccupancyGrid::new(origin, resolution, width, cells.len() / width, cells).unwrap()
}

#[test]
fn occupied_cells_block_and_unknown_ones_if_configured() {
    for (cell, unknown_is_occupied, seen) in [
        (Cell::Occupied, false, true),
        (Cell::Unknown, false, false),
        (Cell::Unknown, true, true),
        (Cell::Free, true, false),
    ] {
        let mut scenario = scenario(plain(), vec![]);
        // one cell of 0.4 m, turned by 45°, its nearest corner at x = 30
        let turned = Pose::new(30.0, 0.0, -0.25 * std::f64::consts::PI);
        scenario.occupancy = Some(grid_of(turned, 0.4, 1, vec![cell]));
        let world = world(&scenario, &CollisionSettings { unknown_is_occupied, ..no_margins() });
        let start = Pose::new(0.0, 0.0, 0.0);
        let hit = world.hit(&start, &straight(40.0));
        assert_eq!(hit.map(|h| h.what), seen.then_some(Blocker::OccupiedCell), "{cell:?}");
        if let Some(hit) = hit {
            let truth = 30.0 - vehicle().front_overhang_from_rear_axle();
            assert!(hit.station <= truth && truth < hit.station + 0.55, "{hit:?}, expected {truth}");
            let inside = world.start_overlap(&Pose::new(29.0, 0.0, 0.0), 0.0);
            assert_eq!(inside.map(|o| o.what), Some(Blocker::OccupiedCell));
        }
    }
}
