//! How far the footprint may move sideways from a path without meeting anything static.

use super::chain::Sample;
use crate::collision::{Allowance, CollisionWorld};
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::lattice::edges::closeness;

/// Room at a sample of the original path.
#[derive(Debug, Clone, Default)]
pub(super) struct Room {
    /// How far the footprint may move to the right, m, zero or more.
    pub(super) right: f64,
    /// The same to the left.
    pub(super) left: f64,
    /// Lines whose least value at a sideways displacement (m to the left) is about the clearance there: (clearance
    /// without displacement, slope).
    pub(super) clearance: Vec<(f64, f64)>,
}

/// Probes of static obstacles and the road's edge around poses of a path.
pub(super) struct Probe<'a> {
    pub(super) world: &'a CollisionWorld,
    /// Pose of the frame that samples are in.
    pub(super) frame: Pose,
    /// Largest displacement asked about, m; less than the vehicle is wide, so that a footprint that is free here and
    /// there is free between.
    pub(super) limit: f64,
    /// Clearance that costs nothing, m.
    pub(super) wanted: f64,
}

/// Length of the sweep that stands for a pose, m.
const PROBE_LENGTH: f64 = 0.02;
/// Taken off a room that is less than the limit, m: the sweeps of whole edges are wider than these by their slack.
const RESERVE: f64 = 0.02;
/// Displacement at which the slope of the clearance is measured, m.
const SLOPE_STEP: f64 = 0.1;

impl Probe<'_> {
    /// The room at a sample. `allowance` is told from the sample on.
    pub(super) fn room(&self, sample: &Sample, allowance: &Allowance) -> Room {
        let yaw = self.frame.yaw + sample.pose.yaw;
        let pose = Pose { position: self.frame.to_world(sample.pose.position), yaw };
        let at = |d: f64| Pose { position: pose.position + pose.left() * d, yaw };
        let settings = self.world.settings();
        let to_obstacle = self.limit + settings.static_obstacles.lateral.hypot(settings.static_obstacles.longitudinal);
        // a centimetre for the growth of the road's surface and the length of the probe
        let to_road = self.limit + settings.road + 0.01;
        let cap = to_obstacle.max(to_road).max(self.wanted + self.limit) + PROBE_LENGTH;
        let clearance = |pose: &Pose, cap: f64| self.world.clearance(&self.sweep(pose), cap);
        let here = clearance(&pose, cap);
        let (right, left) = if here.obstacle >= to_obstacle && here.road >= to_road {
            (self.limit, self.limit)
        } else {
            let free = |d: f64| self.world.static_hit_from_start(&self.sweep(&at(d)), allowance).is_none();
            (self.reach(|d| free(-d)), self.reach(free))
        };
        let near = closeness(&here);
        let clearance = if near >= self.wanted + self.limit {
            Vec::new()
        } else {
            let there = |d: f64| closeness(&clearance(&at(d), cap));
            tangents(near, there(-SLOPE_STEP), there(SLOPE_STEP))
        };
        Room { right, left, clearance }
    }

    fn sweep(&self, pose: &Pose) -> crate::collision::Sweep {
        self.world.sweep(pose, &CubicSpiral::straight(PROBE_LENGTH))
    }

    /// The farthest of some displacements that is free, up to the limit; nothing if not even a little is.
    fn reach(&self, free: impl Fn(f64) -> bool) -> f64 {
        /// Halvings: the room is told to a sixteenth of the limit.
        const HALVINGS: usize = 4;
        if free(self.limit) {
            return self.limit;
        }
        let (mut inside, mut outside) = (0.0, self.limit);
        for _ in 0..HALVINGS {
            let middle = f64::midpoint(inside, outside);
            if free(middle) { inside = middle } else { outside = middle }
        }
        (inside - RESERVE).max(0.0)
    }
}

/// Lines through the clearance here, from those a step to either side: one for each side where it falls to both (between
/// two obstacles), one in all where it is about straight or rises to both.
fn tangents(here: f64, right: f64, left: f64) -> Vec<(f64, f64)> {
    let (from_right, to_left) = ((here - right) / SLOPE_STEP, (left - here) / SLOPE_STEP);
    if from_right > to_left {
        vec![(here, from_right), (here, to_left)]
    } else {
        vec![(here, f64::midpoint(from_right, to_left))]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clearance_between_two_walls_falls_to_both_sides() {
        let lines = tangents(0.5, 0.4, 0.4);
        let at = |d: f64| lines.iter().map(|(c, slope)| c + slope * d).fold(f64::INFINITY, f64::min);
        assert!((at(0.1) - 0.4).abs() < 1e-12 && (at(-0.1) - 0.4).abs() < 1e-12);
        assert_eq!(tangents(0.5, 0.6, 0.4).len(), 1);
        assert!((tangents(0.5, 0.6, 0.4)[0].1 + 1.0).abs() < 1e-12);
    }
}
