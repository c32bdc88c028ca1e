//! `no_contact`: contacts reported by the simulation, and overlaps of the driven footprints with obstacles and occupied cells;
//! with the cause of the contact ([`cause`]).

use std::fmt;

use super::cause::{self, Impact};
use super::cells;
use super::shapes::{footprint_at, gap};
use super::{Check, Settings, Status};
use crate::geometry::{Point, Pose};
use crate::map::{ConvexPart, Motion, Obstacle, Scenario};
use crate::number::Short;
use crate::simulation::{Contact, Log, Sample, Touched};
use crate::vehicle::Vehicle;

/// Something that a vehicle can touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Thing {
    /// An obstacle, by its id.
    Obstacle(i64),
    /// Occupied cells, by the middle of the block that they form.
    Cells(Point),
}

impl fmt::Display for Thing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Obstacle(id) => write!(f, "obstacle {id}"),
            Self::Cells(at) => write!(f, "occupied cells at ({:.2}, {:.2})", at.x, at.y),
        }
    }
}

/// A footprint that was at some place at some time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    /// s of the run.
    pub(super) time: f64,
    /// Rear axle.
    pub(super) pose: Pose,
    /// m/s.
    pub(super) speed: f64,
}

impl From<&Sample> for Place {
    fn from(s: &Sample) -> Self {
        Self { time: s.time, pose: s.pose, speed: s.speed }
    }
}

/// The places of a log, one for each sample.
pub(super) fn places(log: &Log) -> Vec<Place> {
    log.samples.iter().map(Place::from).collect()
}

/// The smallest gap between the vehicle and anything.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Nearest {
    /// Gap, m; a negative gap is the depth of an overlap.
    pub(super) gap: f64,
    /// s of the run.
    pub(super) time: f64,
    /// Speed of the vehicle, m/s.
    pub(super) speed: f64,
    pub(super) thing: Thing,
}

impl Nearest {
    /// Depth of the overlap, m; 0 if there is none.
    pub(super) fn depth(&self) -> f64 {
        (-self.gap).max(0.0)
    }
}

/// The smallest gap to any obstacle at any place; `None` if no obstacle exists at any of the times.
pub(super) fn nearest_obstacle<'a>(
    obstacles: impl IntoIterator<Item = &'a Obstacle>,
    vehicle: &Vehicle,
    places: &[Place],
) -> Option<Nearest> {
    nearest_body(&obstacles.into_iter().map(Body::new).collect::<Vec<_>>(), vehicle, places)
}

/// [`nearest_obstacle`] of obstacles that are divided already.
pub(super) fn nearest_body(bodies: &[Body<'_>], vehicle: &Vehicle, places: &[Place]) -> Option<Nearest> {
    let reach = 0.5 * vehicle.length.hypot(vehicle.width);
    let mut best: Option<Nearest> = None;
    for place in places {
        let footprint = footprint_at(vehicle, &place.pose);
        let centre = vehicle.centre_of_rear_axle(&place.pose).position;
        for body in bodies {
            let floor = best.map_or(f64::INFINITY, |b| b.gap);
            let gap = body.gap_at(place.time, &footprint, centre, reach, floor);
            if gap < floor {
                let thing = Thing::Obstacle(body.obstacle.id);
                best = Some(Nearest { gap, time: place.time, speed: place.speed, thing });
            }
        }
    }
    best
}

/// The smallest gap to any obstacle, or to any occupied cell within [`cells::FAR`]; `None` if there is neither.
pub(super) fn nearest(scenario: &Scenario, vehicle: &Vehicle, places: &[Place]) -> Option<Nearest> {
    let obstacle = nearest_obstacle(&scenario.obstacles, vehicle, places);
    let cells = cells::nearest(scenario, vehicle, places);
    obstacle.into_iter().chain(cells).reduce(|a, b| if b.gap < a.gap { b } else { a })
}

/// The begin of the contact that a log or its geometry has; `None` if there is none. `overlap` is the deepest one.
pub(super) fn impact(
    scenario: &Scenario,
    vehicle: &Vehicle,
    places: &[Place],
    (reported, overlap): (Option<Contact>, Option<Nearest>),
    settings: &Settings,
) -> Option<Impact> {
    let touched = |contact: Contact| match contact.with {
        Touched::Obstacle(id) => Thing::Obstacle(id),
        Touched::OccupiedCell => {
            let at = contact.at_rear_axle_frame;
            Thing::Cells(places.last().map_or(at, |p| p.pose.to_world(at)))
        }
    };
    let thing = reported.map(touched).or(overlap.map(|n| n.thing))?;
    Some(cause::impact(scenario, vehicle, places, thing, settings))
}

/// The check. Inside a predicted occupancy set counts as a contact.
pub(super) fn no_contact(scenario: &Scenario, vehicle: &Vehicle, log: &Log, settings: &Settings) -> Check {
    let places = places(log);
    let nearest = nearest(scenario, vehicle, &places);
    let limit = settings.contact_tolerance;
    let overlap = nearest.filter(|n| n.depth() > limit);
    let impact = impact(scenario, vehicle, &places, (log.contact, overlap), settings);
    let event = impact.map_or_else(String::new, |i| i.to_string());
    let (at_time, note) = match (log.contact, overlap, nearest) {
        (Some(Contact { time, at_rear_axle_frame: at, speed, .. }), ..) => {
            let point = format!("point of contact ({:.2}, {:.2}) m from the rear axle", Short(at.x), Short(at.y));
            let drove = if speed.abs() <= settings.standstill_speed {
                "the vehicle stood".to_owned()
            } else {
                format!("the vehicle drove at {:.1} m/s", Short(speed))
            };
            (Some(time), format!("{event} at {time:.2} s; {drove}; {point}"))
        }
        (None, Some(n), _) => {
            let began = impact.map_or(n.time, |i| i.time);
            let overlap = format!("overlap {:.3} m at {:.2} s; limit {limit} m", Short(n.depth()), n.time);
            let note = format!("{event} at {began:.2} s; {overlap}; the simulation reported no contact");
            (Some(n.time), note)
        }
        (None, None, Some(n)) => {
            let gap = n.gap.max(0.0);
            (Some(n.time), format!("no contact; the nearest was {} at {:.2} m at {:.2} s", n.thing, Short(gap), n.time))
        }
        (None, None, None) => (None, "no contact; the scenario has no obstacle near the vehicle".into()),
    };
    Check {
        name: "no_contact",
        status: Status::of(log.contact.is_none() && overlap.is_none()),
        value: nearest.map_or(0.0, |n| n.depth()),
        limit,
        unit: "m",
        at_time,
        impact,
        note,
        method:
            "contacts of the simulation, and the footprint of every sample against every obstacle and occupied cell"
                .into(),
    }
}

/// An obstacle, divided into convex parts once.
pub(super) struct Body<'a> {
    obstacle: &'a Obstacle,
    /// Parts in the frame of the obstacle.
    local: Group,
    /// Start (s), end (s) and parts, in world coordinates, of each set of a set-based prediction.
    sets: Vec<(f64, f64, Group)>,
}

/// Convex parts inside a circle.
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
    pub(super) fn new(obstacle: &'a Obstacle) -> Self {
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

    /// [`Body::gap_at`] a place of a vehicle.
    pub(super) fn gap_from(&self, vehicle: &Vehicle, place: &Place, floor: f64) -> f64 {
        let reach = 0.5 * vehicle.length.hypot(vehicle.width);
        let centre = vehicle.centre_of_rear_axle(&place.pose).position;
        self.gap_at(place.time, &footprint_at(vehicle, &place.pose), centre, reach, floor)
    }

    /// The gap to the footprint at a time, m, if it is smaller than `floor`; otherwise any number that is not smaller.
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
