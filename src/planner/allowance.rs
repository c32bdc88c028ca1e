//! What a start imposes: a vehicle inside a margin, or partly off the road, must be able to leave.
//!
//! - **The margins of a level** are wishes there: within [`LEAVE_MARGIN`] none are kept to the kind of thing (obstacles or road boundary)
//!   whose margin the start is inside of.
//! - **The tube** is what a proof rests on: the share of it that is free at the start is kept, so that the vehicle comes no closer than it
//!   is. A vehicle right in front of a wall has no proof of a plan towards it.
//!
//! Off the road, the boundary is ignored for [`RETURN_TO_ROAD`].
//!
//! Weak: one share for all obstacles, whichever is near.

use crate::collision::{Allowance, Blocker, CollisionWorld, EdgeProbe, Margins, SafetyMargins};
use crate::geometry::spiral::CubicSpiral;
use crate::trajectory::TrajectoryPoint;

/// Distance within which the vehicle must leave a margin, m.
const LEAVE_MARGIN: f64 = 6.0;
/// Distance within which the vehicle must return to the road, m.
const RETURN_TO_ROAD: f64 = 15.0;
/// Number of shares of a tube: of the widest one, an eighth is a few centimetres.
const SHARES: u32 = 8;

/// What is kept of margins that the start is inside of.
#[derive(Clone, Copy)]
pub(super) enum Kept {
    Nothing,
    /// As much as is free at the start.
    Share,
}

/// The allowance of collision checks for a vehicle that stands inside a margin or partly off the road.
pub(super) fn allowance_at(
    world: &CollisionWorld,
    margins: &SafetyMargins,
    p: &TrajectoryPoint,
    kept: Kept,
) -> Allowance {
    let mut here = world.probe(&p.pose, &CubicSpiral { knots: [p.curvature; 4], length: 0.05 });
    if here.static_hit(margins, &Allowance::NONE).is_none() {
        return Allowance::NONE;
    }
    let to_obstacles = kept.share_of(|share| is_near_obstacle(&mut here, &margins.static_obstacles.scaled(share)));
    let to_road = kept.share_of(|share| is_near_boundary(&mut here, share * margins.road));
    let off_road = world.start_overlap(&p.pose, p.time).is_some_and(|o| o.what == Blocker::RoadBoundary);
    let no_road_until = if off_road { RETURN_TO_ROAD } else { f64::NEG_INFINITY };
    Allowance { reduced_until: LEAVE_MARGIN, to_obstacles, to_road, no_road_until }
}

impl Kept {
    /// The largest share at which nothing is near.
    fn share_of(self, mut is_near: impl FnMut(f64) -> bool) -> f64 {
        if !is_near(1.0) {
            return 1.0;
        }
        let smaller = match self {
            Self::Nothing => 0..0,
            Self::Share => 1..SHARES,
        };
        smaller.rev().map(|part| f64::from(part) / f64::from(SHARES)).find(|share| !is_near(*share)).unwrap_or(0.0)
    }
}

fn is_near_obstacle(here: &mut EdgeProbe<'_>, margins: &Margins) -> bool {
    let off_the_road = Allowance { no_road_until: f64::INFINITY, ..Allowance::NONE };
    here.static_hit(&SafetyMargins { static_obstacles: *margins, ..SafetyMargins::NONE }, &off_the_road).is_some()
}

fn is_near_boundary(here: &mut EdgeProbe<'_>, road: f64) -> bool {
    let hit = here.static_hit(&SafetyMargins { road, ..SafetyMargins::NONE }, &Allowance::NONE);
    hit.is_some_and(|hit| hit.what == Blocker::RoadBoundary)
}
