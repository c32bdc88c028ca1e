//! What a start imposes: a vehicle inside a margin, or partly off the road, must be able to leave.
//!
//! - **The margins of a level** are wishes there: within [`LEAVE_MARGIN`] none are kept to the kind of thing (obstacles or road boundary)
//!   whose margin the start is inside of.
//! - **The tube** is what a proof rests on: the share of it that is free at the start is kept, so that the vehicle comes no closer than it
//!   is. A vehicle right in front of a wall has no proof of a plan towards it, and one that moves towards it has no proof at all.
//!
//! Off the road, the boundary is ignored for [`RETURN_TO_ROAD`], while the distance from the road shrinks. Beyond what the start imposes,
//! a proof permits 5 cm, as on the road: enough for the tracking errors of calm driving. By as much as the tube of the plan is wider than
//! that of calm driving, the vehicle has to be nearer to the road than at its start at the end of this distance.
//!
//! Weak: one share for all obstacles, whichever is near. A start off the road is excused from the tube of calm driving.

use crate::collision::{Allowance, Blocker, CollisionWorld, EdgeProbe, Margins, SafetyMargins};
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::trajectory::{Path, TrajectoryPoint};

/// Distance within which the vehicle must leave a margin, m.
const LEAVE_MARGIN: f64 = 6.0;
/// Distance within which the vehicle must return to the road, m.
const RETURN_TO_ROAD: f64 = 15.0;
/// Accuracy of the share of a tube that is kept, halvings: of the widest one, half a metre, it is 2 mm. With centimetres, a vehicle that
/// rolls the last ones towards a wall had a proof.
const HALVINGS: usize = 8;

/// What is kept of margins that the start is inside of.
#[derive(Clone, Copy)]
pub(super) enum Kept {
    Nothing,
    /// As much as is free at the start.
    Share,
    /// As much as is free at the start, but everything towards what is ahead: a vehicle that moves without a proof may not stop before it.
    Beside,
}

/// The allowance of collision checks for a vehicle that stands inside a margin or partly off the road.
pub(super) fn allowance_at(
    world: &CollisionWorld,
    margins: &SafetyMargins,
    p: &TrajectoryPoint,
    kept: Kept,
) -> Allowance {
    let mut here = probe_at(world, &p.pose, p.curvature);
    if here.static_hit(margins, &Allowance::NONE).is_none() {
        return Allowance::NONE;
    }
    let ahead = Margins { lateral: 0.0, ..margins.static_obstacles };
    let to_obstacles = if matches!(kept, Kept::Beside) && is_near_obstacle(&mut here, &ahead) {
        1.0
    } else {
        kept.share_of(|share| is_near_obstacle(&mut here, &margins.static_obstacles.scaled(share)))
    };
    let to_road = kept.share_of(|share| is_near_boundary(&mut here, share * margins.road));
    let off_road = world.start_overlap(&p.pose, p.time).is_some_and(|o| o.what == Blocker::RoadBoundary);
    let no_road_until = if off_road { RETURN_TO_ROAD } else { f64::NEG_INFINITY };
    Allowance { reduced_until: LEAVE_MARGIN, to_obstacles, to_road, no_road_until }
}

/// Whether a path that starts off the road returns to it without a detour, up to a station (m): its distance from the road never
/// grows by more than the swing of its rear, and shrinks with the square of the distance driven, as an error of the heading that grows
/// displaces the vehicle, by `wider` (m) until the end of [`RETURN_TO_ROAD`].
pub(super) fn returns_to_road(world: &CollisionWorld, path: &Path, until: f64, wider: f64) -> bool {
    /// Distance between compared poses, m.
    const SPACING: f64 = 0.5;
    /// By how much it may grow, m: the rear of a vehicle that turns back to the road swings out.
    const SWING: f64 = 0.01;
    let poses = path.sampled(SPACING).into_iter().take_while(|(station, _)| *station <= until.min(RETURN_TO_ROAD));
    let (mut imposed, mut least) = (None, f64::INFINITY);
    poses.into_iter().all(|(station, point)| {
        let depth = world.depth_off_road(&point.pose);
        let share = station / RETURN_TO_ROAD;
        let permitted = *imposed.get_or_insert(depth) - wider * share * share;
        let shrinks = depth <= least + SWING;
        least = least.min(depth);
        let is_far_enough = if permitted >= 0.0 {
            depth <= permitted + SWING
        } else {
            !is_near_boundary(&mut probe_at(world, &point.pose, point.curvature), -permitted)
        };
        shrinks && is_far_enough
    })
}

impl Kept {
    /// The largest share at which nothing is near, from below.
    fn share_of(self, mut is_near: impl FnMut(f64) -> bool) -> f64 {
        if !is_near(1.0) {
            return 1.0;
        }
        let (mut kept, mut near) = (0.0, 1.0);
        for _ in 0..if matches!(self, Self::Nothing) { 0 } else { HALVINGS } {
            let share = f64::midpoint(kept, near);
            *if is_near(share) { &mut near } else { &mut kept } = share;
        }
        kept
    }
}

/// Length of the path of a vehicle that stands, m: that of the least overlap that counts as a contact.
pub(super) const STANDING: f64 = 1e-3;

/// A probe of the vehicle at a pose.
fn probe_at<'w>(world: &'w CollisionWorld, pose: &Pose, curvature: f64) -> EdgeProbe<'w> {
    world.probe(pose, &CubicSpiral { knots: [curvature; 4], length: STANDING })
}

fn is_near_obstacle(here: &mut EdgeProbe<'_>, margins: &Margins) -> bool {
    let off_the_road = Allowance { no_road_until: f64::INFINITY, ..Allowance::NONE };
    here.static_hit(&SafetyMargins { static_obstacles: *margins, ..SafetyMargins::NONE }, &off_the_road).is_some()
}

fn is_near_boundary(here: &mut EdgeProbe<'_>, road: f64) -> bool {
    let hit = here.static_hit(&SafetyMargins { road, ..SafetyMargins::NONE }, &Allowance::NONE);
    hit.is_some_and(|hit| hit.what == Blocker::RoadBoundary)
}
