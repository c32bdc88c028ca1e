//! Lateral displacement of the footprint from a path that is free of static obstacles.

use super::chain::Sample;
use crate::collision::{Allowance, EdgeProbe};
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::lattice::LatticeContext;
use crate::lattice::edges::closeness;

/// Free width at a sample of the original path.
#[derive(Debug, Clone, Default)]
pub(super) struct FreeWidth {
    /// Free displacement of the footprint to the right, m, not negative.
    pub(super) right: f64,
    /// Free displacement to the left, m, not negative.
    pub(super) left: f64,
    /// Linearised clearance as the minimum of lines over the displacement (m to the left): (clearance without displacement,
    /// slope).
    pub(super) clearance: Vec<(f64, f64)>,
}

/// Probes of static obstacles and the road boundary around poses of a path.
pub(super) struct Probe<'a> {
    pub(super) context: &'a LatticeContext<'a>,
    /// Frame of the samples.
    pub(super) frame: Pose,
    /// Largest displacement, m. Less than the width of the vehicle, so that the footprint is free between two free
    /// displacements.
    pub(super) limit: f64,
    /// Clearance from which on there is no cost, m.
    pub(super) desired: f64,
}

/// Length of the path at a pose, m.
const PROBE_LENGTH: f64 = 0.02;
/// Reduction of a free width below the limit, m: sweeps of whole edges are wider than these by their slack.
const RESERVE: f64 = 0.02;
/// Displacement at which the slope of the clearance is evaluated, m.
const SLOPE_STEP: f64 = 0.1;

impl Probe<'_> {
    /// The free width at a sample. `allowance` is relative to the sample.
    pub(super) fn free_width(&self, sample: &Sample, allowance: &Allowance) -> FreeWidth {
        let yaw = self.frame.yaw + sample.pose.yaw;
        let pose = Pose { position: self.frame.to_world(sample.pose.position), yaw };
        let at = |d: f64| Pose { position: pose.position + pose.left() * d, yaw };
        let margins = &self.context.margins;
        let to_obstacle = self.limit + margins.static_obstacles.lateral.hypot(margins.static_obstacles.longitudinal);
        // a centimetre for the inflation of the road surface and the length of the probe
        let to_road = self.limit + margins.road + 0.01;
        let cap = to_obstacle.max(to_road).max(self.desired + self.limit) + PROBE_LENGTH;
        let clearance = |pose: &Pose, cap: f64| self.at(pose).clearance(cap);
        let here = clearance(&pose, cap);
        let (right, left) = if here.obstacle >= to_obstacle && here.road >= to_road {
            (self.limit, self.limit)
        } else {
            let free = |d: f64| self.at(&at(d)).static_hit(margins, allowance).is_none();
            (self.reach(|d| free(-d)), self.reach(free))
        };
        let near = closeness(&here);
        let clearance = if near >= self.desired + self.limit {
            Vec::new()
        } else {
            let there = |d: f64| closeness(&clearance(&at(d), cap));
            tangents(near, there(-SLOPE_STEP), there(SLOPE_STEP))
        };
        FreeWidth { right, left, clearance }
    }

    /// The check at a pose.
    fn at(&self, pose: &Pose) -> EdgeProbe<'_> {
        self.context.world.probe(pose, &CubicSpiral::straight(PROBE_LENGTH))
    }

    /// The largest free displacement up to the limit, by bisection; zero if there is none.
    fn reach(&self, free: impl Fn(f64) -> bool) -> f64 {
        /// Bisections: a resolution of a sixteenth of the limit.
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

/// Lines through the clearance here, by the clearances one step to either side: two lines where it decreases to both sides
/// (between two obstacles), else one.
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
    fn clearance_between_two_walls_decreases_to_both_sides() {
        let lines = tangents(0.5, 0.4, 0.4);
        let at = |d: f64| lines.iter().map(|(c, slope)| c + slope * d).fold(f64::INFINITY, f64::min);
        assert!((at(0.1) - 0.4).abs() < 1e-12 && (at(-0.1) - 0.4).abs() < 1e-12);
        assert_eq!(tangents(0.5, 0.6, 0.4).len(), 1);
        assert!((tangents(0.5, 0.6, 0.4)[0].1 + 1.0).abs() < 1e-12);
    }
}
