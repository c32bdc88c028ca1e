//! `no_contact`: the rig's contact, and the driven footprints against every obstacle and occupied cell at every sample.

use super::cells;
use super::shapes::{footprint_at, gap};
use super::{Check, Settings, Status};
use crate::geometry::Point;
use crate::map::{ConvexPart, Motion, Obstacle, Scenario};
use crate::simulation::Log;
use crate::vehicle::Vehicle;

/// The smallest gap to any obstacle in a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Closest {
    /// Gap, m; negative is the depth of an overlap.
    pub(super) gap: f64,
    /// Time of the run, s.
    pub(super) time: f64,
    /// Id of the obstacle.
    pub(super) obstacle: i64,
}

/// The smallest gap over all samples and obstacles; `None` if no obstacle ever exists while the vehicle drives.
pub(super) fn closest(scenario: &Scenario, vehicle: &Vehicle, log: &Log) -> Option<Closest> {
    let bodies: Vec<Body> = scenario.obstacles.iter().map(Body::new).collect();
    let reach = 0.5 * vehicle.length.hypot(vehicle.width);
    let mut best: Option<Closest> = None;
    for sample in &log.samples {
        let footprint = footprint_at(vehicle, &sample.pose);
        let centre = vehicle.centre_of_rear_axle(&sample.pose).position;
        for body in &bodies {
            let floor = best.map_or(f64::INFINITY, |b| b.gap);
            let found = body.gap_at(sample.time, &footprint, centre, reach, floor);
            if found < floor {
                best = Some(Closest { gap: found, time: sample.time, obstacle: body.obstacle.id });
            }
        }
    }
    best
}

/// The smallest distance to any obstacle, or to any occupied cell within [`cells::FAR`], m, 0 on contact; `None` if there
/// is none of both.
pub(super) fn clearance(scenario: &Scenario, vehicle: &Vehicle, log: &Log) -> Option<f64> {
    let obstacle = closest(scenario, vehicle, log).map(|c| c.gap);
    let cell = cells::closest(scenario, vehicle, log).map(|c| c.gap);
    obstacle.into_iter().chain(cell).reduce(f64::min).map(|gap| gap.max(0.0))
}

/// The check. A set-based prediction counts as its whole set: being inside it is a contact.
pub(super) fn no_contact(scenario: &Scenario, vehicle: &Vehicle, log: &Log, settings: &Settings) -> Check {
    let closest = closest(scenario, vehicle, log);
    let cell = cells::closest(scenario, vehicle, log);
    let in_cells = cell.filter(|c| -c.gap > settings.contact_tolerance);
    let depth = closest.map_or(0.0, |c| (-c.gap).max(0.0)).max(cell.map_or(0.0, |c| (-c.gap).max(0.0)));
    let overlap = closest.filter(|c| -c.gap > settings.contact_tolerance);
    let start = log.samples.first().map(|s| s.time);
    // the nearer of both is told
    let nearest_cell = cell.filter(|c| closest.is_none_or(|o| c.gap < o.gap));
    let (at_time, note) = match (log.contact, overlap, in_cells, closest) {
        (Some(c), ..) => (
            Some(c.time),
            format!(
                "the rig reports a contact with {} at {:.2} m/s, struck at ({:.2}, {:.2}) m from the rear axle",
                c.with, c.speed, c.at_rear_axle_frame.x, c.at_rear_axle_frame.y
            ),
        ),
        (None, Some(o), ..) => {
            let when = if Some(o.time) == start { " already at the start" } else { "" };
            (
                Some(o.time),
                format!("the driven footprint overlaps obstacle {}{when}; the rig saw no contact", o.obstacle),
            )
        }
        (None, None, Some(c), _) => (Some(c.time), format!("the driven footprint overlaps occupied cells around {c}")),
        (None, None, None, closest) => match (nearest_cell, closest) {
            (Some(c), _) => (Some(c.time), format!("nearest: {:.2} m to occupied cells around {c}", c.gap.max(0.0))),
            (None, Some(o)) => (Some(o.time), format!("nearest: {:.2} m to obstacle {}", o.gap.max(0.0), o.obstacle)),
            (None, None) => (None, "no obstacle".into()),
        },
    };
    Check {
        name: "no_contact",
        status: Status::of(log.contact.is_none() && overlap.is_none() && in_cells.is_none()),
        value: depth,
        limit: settings.contact_tolerance,
        unit: "m",
        at_time,
        note,
    }
}

/// An obstacle with its convex pieces made once.
struct Body<'a> {
    obstacle: &'a Obstacle,
    /// Pieces in the obstacle's frame, with the radius around its origin.
    local: Group,
    /// Pieces of each set of a set-based prediction, in world coordinates.
    sets: Vec<(f64, f64, Group)>,
}

/// Convex pieces within a circle.
struct Group {
    parts: Vec<ConvexPart>,
    centre: Point,
    radius: f64,
}

impl Group {
    fn new(parts: Vec<ConvexPart>, centre: Point) -> Self {
        let reach = |part: &ConvexPart| match part {
            ConvexPart::Polygon(points) => points.iter().map(|p| (p - centre).norm()).fold(0.0, f64::max),
            ConvexPart::Circle { centre: c, radius } => (c - centre).norm() + radius,
        };
        let radius = parts.iter().map(reach).fold(0.0, f64::max);
        Self { parts, centre, radius }
    }
}

impl<'a> Body<'a> {
    fn new(obstacle: &'a Obstacle) -> Self {
        let sets = match &obstacle.motion {
            Motion::Occupancy(sets) => sets
                .iter()
                .map(|set| {
                    let parts = set.region.convex_parts();
                    let centre = parts.first().map_or(Point::origin(), some_point);
                    (set.from, set.to, Group::new(parts, centre))
                })
                .collect(),
            Motion::Static(_) | Motion::Trajectory(_) => Vec::new(),
        };
        Self { obstacle, local: Group::new(obstacle.shape.convex_parts(), Point::origin()), sets }
    }

    /// The gap at `time` between the nearest parts if it is smaller than `floor`, else something not smaller.
    fn gap_at(&self, time: f64, footprint: &[Vec<Point>], centre: Point, reach: f64, floor: f64) -> f64 {
        let out_of_reach = |c: Point, radius: f64| (c - centre).norm() - radius - reach >= floor;
        let smallest = |gaps: &mut dyn Iterator<Item = f64>| gaps.fold(f64::INFINITY, f64::min);
        let to = |part: &ConvexPart| smallest(&mut footprint.iter().map(|own| gap(own, part)));
        match (&self.obstacle.motion, self.obstacle.pose_at(time)) {
            (Motion::Occupancy(_), _) => smallest(
                &mut self
                    .sets
                    .iter()
                    .filter(|(from, to, group)| {
                        *from <= time && time <= *to && !out_of_reach(group.centre, group.radius)
                    })
                    .flat_map(|(_, _, group)| group.parts.iter().map(to)),
            ),
            (_, Some(pose)) if !out_of_reach(pose.position, self.local.radius) => {
                smallest(&mut self.local.parts.iter().map(|part| to(&part.at(&pose))))
            }
            _ => f64::INFINITY,
        }
    }
}

fn some_point(part: &ConvexPart) -> Point {
    match part {
        ConvexPart::Polygon(points) => points.first().copied().unwrap_or(Point::origin()),
        ConvexPart::Circle { centre, .. } => *centre,
    }
}
