//! Whether lanes lead from a pose to the region of a goal: over successors and over neighbours in the same direction.
//!
//! A vehicle does not turn back, so a goal that lanes led to from the start and no longer lead to was driven past, even if the
//! vehicle never was inside: on the next lane, or after the exit that it should have taken. The search shares no code with the
//! route of the planner. It is lenient: a lane can be changed anywhere, at no length.
//!
//! Weak where the map does not connect lanes that are connected on the road: then nothing is known, and nothing is said.

use std::collections::BTreeMap;

use super::shapes::contains;
use crate::geometry::{Point, Pose, wrap_angle};
use crate::map::{ConvexPart, GoalPosition, Lanelet, LaneletId, RoadNetwork, Shape};

/// Distance between two points of a region that are looked up on the lanes, m.
const SPACING: f64 = 1.0;
/// Corners of the polygon that stands for a circle.
const CORNERS: u32 = 16;
/// A lane that is entered earlier by less than this is not entered again, m.
const EARLIER: f64 = 1e-6;

/// First and last station of a region on each of its lanelets, m.
type Stations = BTreeMap<LaneletId, (f64, f64)>;

/// The lanes below the region of a goal.
#[derive(Debug, Clone)]
pub(super) struct GoalLanes<'a> {
    network: &'a RoadNetwork,
    stations: Stations,
}

impl<'a> GoalLanes<'a> {
    pub(super) fn new(network: &'a RoadNetwork, position: &GoalPosition) -> Self {
        let stations = match position {
            GoalPosition::Lanelets(ids) => {
                ids.iter().filter_map(|id| network.lanelets.get(id)).map(|l| (l.id, (0.0, l.centre.length()))).collect()
            }
            GoalPosition::Shapes(shape) => of_shape(network, shape),
        };
        Self { network, stations }
    }

    /// Whether lanes lead from a pose of the vehicle's centre into the region; `None` if either is on no lane.
    pub(super) fn lead_from(&self, centre: &Pose) -> Option<bool> {
        let from = self.under(centre);
        let entered = self.entered(&from);
        let reaches = |(id, (_, last)): (&LaneletId, &(f64, f64))| entered.get(id).is_some_and(|from| from <= last);
        (!from.is_empty() && !self.stations.is_empty()).then(|| self.stations.iter().any(reaches))
    }

    /// Whether lanes lead from the region to a pose of the vehicle's centre; `None` if either is on no lane.
    pub(super) fn lead_to(&self, centre: &Pose) -> Option<bool> {
        let to = self.under(centre);
        let from: Vec<(LaneletId, f64)> = self.stations.iter().map(|(id, (first, _))| (*id, *first)).collect();
        let entered = self.entered(&from);
        let reaches = |(id, station): &(LaneletId, f64)| entered.get(id).is_some_and(|from| from <= station);
        (!to.is_empty() && !from.is_empty()).then(|| to.iter().any(reaches))
    }

    /// The lanes under a pose in its direction, with its station. On the lane of the oncoming traffic, those beside it.
    fn under(&self, pose: &Pose) -> Vec<(LaneletId, f64)> {
        let below = |l: &&Lanelet| l.is_drivable() && contains(&l.outline(), pose.position);
        let below: Vec<&Lanelet> = self.network.lanelets.values().filter(below).collect();
        let in_direction = |l: &&Lanelet| {
            let yaw = l.centre.yaw_at(l.centre.project(pose.position).station);
            wrap_angle(pose.yaw - yaw).abs() < std::f64::consts::FRAC_PI_2
        };
        let mut lanes: Vec<&Lanelet> = below.iter().copied().filter(in_direction).collect();
        if lanes.is_empty() {
            let neighbours = below.iter().flat_map(|l| [l.adjacent_left, l.adjacent_right]).flatten();
            lanes = neighbours.filter_map(|n| self.network.lanelets.get(&n.id)).filter(in_direction).collect();
        }
        lanes.iter().map(|l| (l.id, l.centre.project(pose.position).station)).collect()
    }

    /// Every lanelet that can be reached, with the first station on it, m.
    fn entered(&self, from: &[(LaneletId, f64)]) -> BTreeMap<LaneletId, f64> {
        let mut entered: BTreeMap<LaneletId, f64> = BTreeMap::new();
        let mut open = from.to_vec();
        while let Some((id, station)) = open.pop() {
            let Some(lanelet) = self.network.lanelets.get(&id).filter(|l| l.is_drivable()) else { continue };
            if entered.get(&id).is_some_and(|before| *before <= station + EARLIER) {
                continue;
            }
            entered.insert(id, station);
            open.extend(lanelet.successors.iter().map(|next| (*next, 0.0)));
            let beside = [lanelet.adjacent_left, lanelet.adjacent_right].into_iter().flatten();
            for neighbour in beside.filter(|n| n.same_direction) {
                if let Some(next) = self.network.lanelets.get(&neighbour.id) {
                    open.push((next.id, next.centre.project(lanelet.centre.at(station)).station));
                }
            }
        }
        entered
    }
}

/// The lanelets below points of a shape.
fn of_shape(network: &RoadNetwork, shape: &Shape) -> Stations {
    let points: Vec<Point> = shape.convex_parts().iter().flat_map(points_of).collect();
    let mut stations = Stations::new();
    for lanelet in network.lanelets.values().filter(|l| l.is_drivable()) {
        let outline = lanelet.outline();
        for p in points.iter().filter(|p| contains(&outline, **p)) {
            let station = lanelet.centre.project(*p).station;
            let (first, last) = stations.entry(lanelet.id).or_insert((station, station));
            (*first, *last) = (first.min(station), last.max(station));
        }
    }
    stations
}

/// Points on the outline of a convex part, and on the lines from its middle to its corners.
fn points_of(part: &ConvexPart) -> Vec<Point> {
    let corners = match part {
        ConvexPart::Polygon(corners) => corners.clone(),
        ConvexPart::Circle { centre, radius } => {
            let corner = |k| std::f64::consts::TAU * f64::from(k) / f64::from(CORNERS);
            (0..CORNERS).map(|k| Pose { position: *centre, yaw: corner(k) }.advanced(*radius).position).collect()
        }
    };
    let middle = Point::from(corners.iter().map(|p| p.coords).sum::<crate::geometry::Vector>() / corners.len() as f64);
    let ends = corners.iter().copied().zip(corners.iter().copied().cycle().skip(1));
    ends.flat_map(|(a, b)| between(a, b).chain(between(a, middle))).chain([middle]).collect()
}

fn between(a: Point, b: Point) -> impl Iterator<Item = Point> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // positive; a region is at most 1e9 m large
    let count = ((b - a).norm() / SPACING).ceil().clamp(1.0, 1e4) as usize;
    (0..count).map(move |i| a + (b - a) * (i as f64 / count as f64))
}
