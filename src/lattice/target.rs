//! A place that paths are to lead through: the set of permitted offsets and headings at one station.
//!
//! If the reference line does not meet it, the lattice has a layer there, with nodes inside the set. A path that passes the station
//! outside of it costs [`Weights::missed_target`](super::Weights::missed_target).
//!
//! Weak: one place for each lattice, and one station of it: a set that is long along the line is met where its middle is. On a narrow lane
//! (3.5 m) at 10 m/s and more, headings beyond 0.15 rad are not met: the speed is not lowered early enough for the swing.

use super::Node;

/// A set of poses of the vehicle beside one station of the reference line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Station of the rear axle, m.
    pub station: f64,
    /// Smallest and largest offset of the vehicle's reference point, m.
    pub offsets: (f64, f64),
    /// Smallest and largest heading relative to the reference line, rad.
    pub headings: (f64, f64),
    /// Distance of that point ahead of the rear axle, m.
    pub ahead: f64,
}

/// Distance of nodes from the ends of the permitted offsets, if these are wide enough, m, and of headings, rad: tracking errors, and what
/// the refinement may move.
const RESERVES: (f64, f64) = (0.3, 0.03);
/// Reserves of a path that is to pass inside.
const LEAST_RESERVES: (f64, f64) = (0.1, 0.01);
/// Stations nearer to each other are the same, m.
const SAME: f64 = 1e-6;

/// An interval without a reserve at both ends, of which at least its middle remains.
fn inner((low, high): (f64, f64), reserve: f64) -> (f64, f64) {
    let reserve = reserve.min(0.5 * (high - low));
    (low + reserve, high - reserve)
}

impl Target {
    /// The nodes of its layer beside those of any layer: nearest to the reference line and to its heading, and in the middle.
    pub(super) fn nodes(&self) -> Vec<Node> {
        let places = |interval, reserve| {
            let (low, high) = inner(interval, reserve);
            let (nearest, middle) = (0.0_f64.max(low).min(high), f64::midpoint(low, high));
            let mut places = vec![nearest, middle];
            places.dedup();
            places
        };
        let offsets = places(self.offsets, RESERVES.0);
        let headings = places(self.headings, RESERVES.1);
        let node = |offset: f64, heading: f64| Node { offset: offset - self.ahead * heading.sin(), heading };
        offsets.iter().flat_map(|offset| headings.iter().map(move |heading| node(*offset, *heading))).collect()
    }

    /// Offset (m) and heading (rad) of the rear axle, as near to the reference line as the set permits.
    #[must_use]
    pub fn pose(&self) -> (f64, f64) {
        let node = self.nodes()[0];
        (node.offset, node.heading)
    }

    /// Whether a pose of the rear axle beside the station is inside, with a small reserve.
    pub(super) fn contains(&self, offset: f64, heading: f64) -> bool {
        let is_inside = |value: f64, interval, reserve| {
            let (low, high) = inner(interval, reserve);
            (low - SAME..=high + SAME).contains(&value)
        };
        is_inside(offset + self.ahead * heading.sin(), self.offsets, LEAST_RESERVES.0)
            && is_inside(heading, self.headings, LEAST_RESERVES.1)
    }

    /// Where a path passes the station between two of its points at these stations (m), as a share of the length between them.
    pub(super) fn passed_between(&self, from: f64, to: f64) -> Option<f64> {
        let (from, to) = (from - self.station, to - self.station);
        (from < -SAME && to >= -SAME).then(|| (-from / (to - from)).min(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TARGET: Target = Target { station: 50.0, offsets: (0.4, 2.0), headings: (-0.05, 0.15), ahead: 1.4 };

    #[test]
    fn its_nodes_are_inside_and_as_near_to_the_line_as_that_permits() {
        let nodes = TARGET.nodes();
        assert_eq!(nodes.len(), 4);
        assert!(nodes.iter().all(|n| TARGET.contains(n.offset, n.heading)), "{nodes:?}");
        assert!(nodes.contains(&Node { offset: 0.7, heading: 0.0 }), "{nodes:?}");
        // a set that is one pose
        let point = Target { offsets: (0.5, 0.5), headings: (0.1, 0.1), ..TARGET };
        let nodes = point.nodes();
        assert!(nodes.len() == 1 && point.contains(nodes[0].offset, nodes[0].heading), "{nodes:?}");
    }

    #[test]
    fn each_passage_of_the_station_counts_once() {
        assert_eq!(TARGET.passed_between(48.0, 52.0), Some(0.5));
        assert_eq!(TARGET.passed_between(46.0, 50.0), Some(1.0), "it ends there");
        assert_eq!(TARGET.passed_between(50.0, 54.0), None, "it begins there");
        assert_eq!(TARGET.passed_between(40.0, 49.0), None);
    }

    #[test]
    fn the_point_of_the_vehicle_ahead_of_its_rear_axle_is_meant() {
        assert!(!TARGET.contains(0.45, 0.0) && TARGET.contains(0.55, 0.0));
        assert!(TARGET.contains(0.45, 0.1), "it is 0.14 m farther to the left");
        assert!(!TARGET.contains(1.0, 0.15) && !TARGET.contains(1.0, -0.05), "without a reserve");
    }
}
