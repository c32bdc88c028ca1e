//! The road network: lanelets with their neighbours and rules, traffic signs, traffic lights.

use std::collections::BTreeMap;

use crate::geometry::Point;
use crate::geometry::polyline::Polyline;

/// Id of a lanelet, as in the file.
pub type LaneletId = i64;

/// The road network. Lanelets are ordered by id, so that every iteration is reproducible.
#[derive(Debug, Clone, Default)]
pub struct RoadNetwork {
    /// All lanelets by id.
    pub lanelets: BTreeMap<LaneletId, Lanelet>,
    /// Traffic signs by id.
    pub signs: BTreeMap<i64, TrafficSign>,
    /// Traffic lights by id.
    pub lights: BTreeMap<i64, TrafficLight>,
}

/// An adjacent lanelet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Neighbour {
    /// The neighbour's id.
    pub id: LaneletId,
    /// Whether it has the same driving direction.
    pub same_direction: bool,
}

/// A section of a lane between two bounds.
#[derive(Debug, Clone)]
pub struct Lanelet {
    /// Id in the file.
    pub id: LaneletId,
    /// Left bound, in driving direction.
    pub left: Polyline,
    /// Right bound, in driving direction.
    pub right: Polyline,
    /// Middle between the bounds, in driving direction.
    pub centre: Polyline,
    /// Ids of the next lanelets.
    pub successors: Vec<LaneletId>,
    /// Ids of the previous lanelets.
    pub predecessors: Vec<LaneletId>,
    /// Neighbour on the left.
    pub adjacent_left: Option<Neighbour>,
    /// Neighbour on the right.
    pub adjacent_right: Option<Neighbour>,
    /// Speed limit from traffic signs on this lanelet, m/s.
    pub speed_limit: Option<f64>,
    /// Stop line on this lanelet.
    pub stop_line: Option<StopLine>,
    /// Ids of the traffic signs that apply.
    pub signs: Vec<i64>,
    /// Ids of the traffic lights that apply.
    pub lights: Vec<i64>,
    /// Types as in the file: `urban`, `crosswalk`, `intersection`, …
    pub types: Vec<String>,
}

impl Lanelet {
    /// The centre line of two bounds: between corresponding points if both have the same number of points, else between
    /// points at equal ratios of the lengths. `None` if it has no length.
    pub(crate) fn centre_line(
        left_points: &[Point],
        right_points: &[Point],
        left: &Polyline,
        right: &Polyline,
    ) -> Option<Polyline> {
        if left_points.len() == right_points.len() {
            return Polyline::new(left_points.iter().zip(right_points).map(|(l, r)| nalgebra::center(l, r)));
        }
        let last = left_points.len().max(right_points.len()) - 1;
        #[allow(clippy::cast_precision_loss)] // a count of points
        Polyline::new((0..=last).map(|i| {
            let ratio = i as f64 / last as f64;
            nalgebra::center(&left.at(ratio * left.length()), &right.at(ratio * right.length()))
        }))
    }

    /// The outline: right bound forwards, left bound backwards. Counter-clockwise if the left bound is on the left. Not
    /// closed.
    #[must_use]
    pub fn outline(&self) -> Vec<Point> {
        self.right.points().iter().chain(self.left.points().iter().rev()).copied().collect()
    }

    /// Whether cars may drive on it: not on sidewalks, bicycle lanes, crosswalks, borders and parking areas.
    #[must_use]
    pub fn is_drivable(&self) -> bool {
        const CLOSED: [&str; 5] = ["sidewalk", "bicycleLane", "crosswalk", "border", "parking"];
        !self.types.iter().any(|t| CLOSED.contains(&t.as_str()))
    }

    /// Whether it has to be kept free of standing vehicles: junctions and crosswalks.
    #[must_use]
    pub fn is_kept_free(&self) -> bool {
        const KEPT_FREE: [&str; 2] = ["intersection", "crosswalk"];
        self.types.iter().any(|t| KEPT_FREE.contains(&t.as_str()))
    }

    /// Whether the point is inside the outline (even–odd rule). Either answer on the border.
    #[must_use]
    pub fn contains(&self, p: Point) -> bool {
        super::shape::polygon_contains(&self.outline(), p)
    }
}

/// A stop line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopLine {
    /// Left end.
    pub start: Point,
    /// Right end.
    pub end: Point,
}

/// A traffic sign as in the file.
#[derive(Debug, Clone, PartialEq)]
pub struct TrafficSign {
    /// Id in the file.
    pub id: i64,
    /// Sign numbers with their additional values: `("274", ["13.89"])`.
    pub elements: Vec<(String, Vec<String>)>,
    /// Position, when given.
    pub position: Option<Point>,
}

/// A traffic light with its cycle, as in the file.
#[derive(Debug, Clone, PartialEq)]
pub struct TrafficLight {
    /// Id in the file.
    pub id: i64,
    /// Colour and duration in time steps, in order.
    pub cycle: Vec<(String, u32)>,
    /// Offset of the cycle, time steps.
    pub offset: i64,
    /// Position, when given.
    pub position: Option<Point>,
}
