//! Who ran into whom: the cause of a contact, from the motion of both at the point of contact.
//!
//! **Moment.** The first moment at which the footprint and the other overlap by the tolerance of contacts, found by bisection
//! between two samples. The overlap is then so shallow that the axis of least overlap is the normal of the contact; at the
//! deepest overlap it can be another one.
//!
//! **Velocities.** Those of the two points of the bodies at the point of contact, by differences of the poses between the two
//! samples. The speeds written in a scenario are not read: they can contradict its positions. Each velocity counts along the
//! normal, towards the other. A part of at most [`Settings::standstill_speed`] is no motion, and a stopped vehicle has none.
//!
//! Weak where: a set of a set-based prediction has no velocity. A vehicle that drives into one ran into it, and a set that
//! begins at the place of the vehicle appeared there.

use std::fmt;

use super::contact::{Body, Place, Thing};
use super::shapes::{Touch, footprint_at, gap, touch};
use super::{Settings, cells};
use crate::geometry::{Point, Pose, Vector};
use crate::map::{ConvexPart, Obstacle, Scenario};
use crate::number::Short;
use crate::vehicle::Vehicle;

/// The cause of a contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cause {
    /// The vehicle moved towards the other, which did not move towards the vehicle.
    Vehicle,
    /// The other moved towards the vehicle, which did not move towards it.
    Other,
    /// Both moved towards each other.
    Both {
        /// Share of the vehicle in the closing speed, above 0 and below 1.
        vehicle_share: f64,
    },
    /// They were in contact at the first sample: no motion of the run is the cause.
    Start,
    /// The obstacle, or a set of its prediction, began to exist at the place of the vehicle.
    Appeared,
    /// The motion does not give the cause: neither moved towards the other, or only the simulation found the contact.
    Unknown,
}

impl Cause {
    /// The stable name in JSON: `vehicle`, `other`, `both`, `start`, `appeared`, `unknown`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Vehicle => "vehicle",
            Self::Other => "other",
            Self::Both { .. } => "both",
            Self::Start => "start",
            Self::Appeared => "appeared",
            Self::Unknown => "unknown",
        }
    }

    /// The cause from the speeds of vehicle and other towards each other, m/s. A speed of at most `standstill` is no motion,
    /// unless neither is faster.
    fn of(vehicle: f64, other: f64, standstill: f64) -> Self {
        match (vehicle > standstill, other > standstill) {
            (true, true) => Self::Both { vehicle_share: vehicle / (vehicle + other) },
            (true, false) => Self::Vehicle,
            (false, true) => Self::Other,
            (false, false) if vehicle > other.max(0.0) => Self::Vehicle,
            (false, false) if other > vehicle.max(0.0) => Self::Other,
            (false, false) => Self::Unknown,
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Side of the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The front.
    Front,
    /// The rear.
    Rear,
    /// The left side.
    Left,
    /// The right side.
    Right,
}

impl Side {
    /// The stable name in JSON: `front`, `rear`, `left`, `right`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Rear => "rear",
            Self::Left => "left",
            Self::Right => "right",
        }
    }

    /// The side that a direction in the frame of the vehicle points to.
    fn towards(direction: Vector) -> Self {
        match (direction.x.abs() >= direction.y.abs(), direction.x > 0.0, direction.y > 0.0) {
            (true, true, _) => Self::Front,
            (true, false, _) => Self::Rear,
            (false, _, true) => Self::Left,
            (false, _, false) => Self::Right,
        }
    }

    /// Where something comes from that hits this side.
    fn origin(self) -> &'static str {
        match self {
            Self::Front => "from the front",
            Self::Rear => "from behind",
            Self::Left => "from the left",
            Self::Right => "from the right",
        }
    }
}

/// The begin of a contact, with its cause.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Impact {
    /// The other.
    pub with: Thing,
    /// Who ran into whom.
    pub cause: Cause,
    /// s of the run.
    pub time: f64,
    /// The side of the vehicle that was hit; `None` where the cause is [`Cause::Start`] or [`Cause::Unknown`] without
    /// geometry.
    pub side: Option<Side>,
    /// Speed of the vehicle towards the other at the point of contact along the normal, m/s; negative away from it.
    pub vehicle_speed: f64,
    /// Speed of the other towards the vehicle at the point of contact along the normal, m/s; negative away from it.
    pub other_speed: f64,
    /// Whether the vehicle was at standstill.
    pub is_stopped: bool,
}

impl Impact {
    /// Speed at which the distance decreased, m/s.
    #[must_use]
    pub fn closing_speed(&self) -> f64 {
        self.vehicle_speed + self.other_speed
    }

    fn without_motion(with: Thing, cause: Cause, time: f64) -> Self {
        Self { with, cause, time, side: None, vehicle_speed: 0.0, other_speed: 0.0, is_stopped: false }
    }
}

/// The event in one clause, without its time.
impl fmt::Display for Impact {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { with, .. } = self;
        let closing = Short(self.closing_speed());
        match self.cause {
            Cause::Vehicle => {
                let part = self.side.map_or("", |side| match side {
                    Side::Front => " with its front",
                    Side::Rear => " with its rear",
                    Side::Left => " with its left side",
                    Side::Right => " with its right side",
                });
                write!(f, "the vehicle ran into {with}{part} at {closing:.1} m/s")
            }
            Cause::Other => {
                let stopped = if self.is_stopped { "stopped " } else { "" };
                let from = self.side.map_or("", Side::origin);
                write!(f, "{with} ran into the {stopped}vehicle {from} at {closing:.1} m/s")
            }
            Cause::Both { vehicle_share } => {
                let percent = 100.0 * vehicle_share;
                write!(f, "the vehicle and {with} ran into each other at {closing:.1} m/s ")?;
                write!(f, "(share of the vehicle {percent:.0} %, of {with} {:.0} %)", 100.0 - percent)
            }
            Cause::Start => write!(f, "the vehicle touched {with} at the start"),
            Cause::Appeared => write!(f, "{with} appeared at the place of the vehicle"),
            Cause::Unknown => write!(f, "the vehicle touched {with} (cause unknown)"),
        }
    }
}

/// A gap that is smaller than this counts as the contact that the simulation reports, m: its colliders touch at the poses of
/// the step before, and shapes can have a margin of contact.
const NEAR: f64 = 0.05;
/// A gap that changes by more than this within the last bisection is a jump, m: the other did not exist before.
const JUMP: f64 = 0.01;
/// Interval of a velocity where the samples give none, s.
const INTERVAL: f64 = 0.01;
/// Bisections between two samples: they divide 10 ms down to rounding.
const BISECTIONS: usize = 40;

/// The begin of the contact with a thing, at any of the places in order of time.
pub(super) fn impact(
    scenario: &Scenario,
    vehicle: &Vehicle,
    places: &[Place],
    thing: Thing,
    settings: &Settings,
) -> Impact {
    let tolerance = settings.contact_tolerance;
    let found = match thing {
        // several obstacles can have the same id
        Thing::Obstacle(id) => scenario
            .obstacles
            .iter()
            .filter(|o| o.id == id)
            .filter_map(|o| {
                let body = Body::new(o);
                let gap_at = |place: &Place, floor: f64| body.gap_from(vehicle, place, floor);
                Some((first_touch(places, gap_at, tolerance)?, Other::Obstacle(o)))
            })
            .min_by_key(|(index, _)| *index),
        Thing::Cells(_) => {
            let gap_at = |place: &Place, _: f64| {
                cells::nearest(scenario, vehicle, std::slice::from_ref(place)).map_or(f64::INFINITY, |n| n.gap)
            };
            first_touch(places, gap_at, tolerance).map(|index| {
                let around = places.get(index.saturating_sub(1)..=index).unwrap_or_default();
                (index, Other::Cells(cells::blocks_around(scenario, vehicle, around)))
            })
        }
    };
    let last = places.last().map_or(0.0, |p| p.time);
    let Some((index, other)) = found else { return Impact::without_motion(thing, Cause::Unknown, last) };
    let Some(after) = places.get(index) else { return Impact::without_motion(thing, Cause::Unknown, last) };
    let Some(before) = index.checked_sub(1).and_then(|i| places.get(i)) else {
        return Impact::without_motion(thing, Cause::Start, after.time);
    };
    Meeting { vehicle, before, after, other }.impact(thing, settings)
}

/// The first place with an overlap deeper than the tolerance, otherwise that of the smallest gap below [`NEAR`]. `gap_at`
/// gives a gap if it is smaller than a floor, otherwise any number that is not smaller.
fn first_touch(places: &[Place], gap_at: impl Fn(&Place, f64) -> f64, tolerance: f64) -> Option<usize> {
    places.iter().position(|p| gap_at(p, -tolerance) < -tolerance).or_else(|| {
        let gaps = places.iter().map(|p| gap_at(p, NEAR)).enumerate().filter(|(_, gap)| *gap < NEAR);
        gaps.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| index)
    })
}

/// The other in a contact.
enum Other<'a> {
    Obstacle(&'a Obstacle),
    /// Blocks of occupied cells.
    Cells(Vec<ConvexPart>),
}

impl Other<'_> {
    fn parts_at(&self, time: f64) -> Vec<ConvexPart> {
        match self {
            Self::Obstacle(obstacle) => obstacle.occupied_at(time),
            Self::Cells(blocks) => blocks.clone(),
        }
    }

    /// Velocity of the point of the body that is at a place at a time, m/s. `around` is the interval between two samples.
    fn velocity(&self, point: Point, time: f64, around: (f64, f64)) -> Vector {
        let Self::Obstacle(obstacle) = self else { return Vector::zeros() };
        let Some(now) = obstacle.pose_at(time) else { return Vector::zeros() };
        let local = now.to_local(point);
        // an obstacle can begin or end to exist between the samples
        let intervals = [around, (time - INTERVAL, time), (time, time + INTERVAL)];
        let velocity = |(from, to): (f64, f64)| {
            let (first, last) = (obstacle.pose_at(from)?, obstacle.pose_at(to)?);
            Some((last.to_world(local) - first.to_world(local)) / (to - from))
        };
        intervals.into_iter().find_map(velocity).unwrap_or_else(Vector::zeros)
    }
}

/// Two samples between which the contact begins.
struct Meeting<'a> {
    vehicle: &'a Vehicle,
    before: &'a Place,
    after: &'a Place,
    other: Other<'a>,
}

impl Meeting<'_> {
    fn time(&self, ratio: f64) -> f64 {
        self.before.time + (self.after.time - self.before.time) * ratio
    }

    fn pose(&self, ratio: f64) -> Pose {
        self.before.pose.interpolated(&self.after.pose, ratio)
    }

    /// The deepest pair of parts.
    fn touch(&self, ratio: f64) -> Option<Touch> {
        let parts = self.other.parts_at(self.time(ratio));
        let own = footprint_at(self.vehicle, &self.pose(ratio));
        let touches = own.iter().flat_map(|part| parts.iter().map(move |other| touch(part, other)));
        touches.flatten().min_by(|a, b| a.gap.total_cmp(&b.gap))
    }

    fn gap(&self, ratio: f64) -> f64 {
        let parts = self.other.parts_at(self.time(ratio));
        let own = footprint_at(self.vehicle, &self.pose(ratio));
        own.iter().flat_map(|part| parts.iter().map(move |other| gap(part, other))).fold(f64::INFINITY, f64::min)
    }

    fn impact(&self, with: Thing, settings: &Settings) -> Impact {
        let (before, after) = (self.before, self.after);
        let limit = -settings.contact_tolerance;
        let (mut apart, mut together) = (0.0, 1.0);
        let overlaps = self.gap(1.0) < limit;
        for _ in 0..if overlaps { BISECTIONS } else { 0 } {
            let middle = f64::midpoint(apart, together);
            *(if self.gap(middle) < limit { &mut together } else { &mut apart }) = middle;
        }
        let time = self.time(together);
        let Some(touch) = self.touch(together) else { return Impact::without_motion(with, Cause::Unknown, time) };
        let pose = self.pose(together);
        let duration = after.time - before.time;
        let stands = |p: &Place| p.speed.abs() <= settings.standstill_speed;
        let is_stopped = stands(before) && stands(after);
        let own = if is_stopped || duration <= 0.0 {
            Vector::zeros()
        } else {
            let local = pose.to_local(touch.at);
            (after.pose.to_world(local) - before.pose.to_world(local)) / duration
        };
        let other = self.other.velocity(touch.at, time, (before.time, after.time));
        let (vehicle_speed, other_speed) = (own.dot(&touch.normal), -other.dot(&touch.normal));
        let cause = if overlaps && self.gap(apart) - touch.gap > JUMP {
            Cause::Appeared
        } else {
            Cause::of(vehicle_speed, other_speed, settings.standstill_speed)
        };
        let direction = Vector::new(touch.normal.dot(&pose.forward()), touch.normal.dot(&pose.left()));
        let side = Some(Side::towards(direction));
        Impact { with, cause, time, side, vehicle_speed, other_speed, is_stopped }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Place as World, Story};
    use super::*;
    use crate::map::{Cell, Motion, OccupancyGrid, Part, Shape, TimedOccupancy};
    use crate::simulation::{Contact, Touched};

    /// The same world here, far away and turned, and mirrored.
    const WORLDS: [World; 3] = [
        World::here(),
        World { origin: Pose { position: Point::new(6.9e5, 5.3e6), yaw: 2.2 }, mirrored: false },
        World { origin: Pose { position: Point::new(0.0, 0.0), yaw: 0.0 }, mirrored: true },
    ];

    /// Two seconds of a vehicle whose centre moves from the origin with constant velocity, 100 samples/s.
    fn driven(s: &Story, velocity: (f64, f64)) -> Vec<Place> {
        let at = |i: i32| {
            let time = 0.01 * f64::from(i);
            let centre = s.place.pose(velocity.0 * time, velocity.1 * time, 0.0);
            Place { time, pose: s.vehicle.rear_axle_of_centre(&centre), speed: velocity.0 }
        };
        (0..=200).map(at).collect()
    }

    /// The impact with obstacle 7, a car of 4.5 m × 1.8 m that moves from a place with constant velocity.
    fn with_car(world: World, own: (f64, f64), from: (f64, f64), velocity: (f64, f64)) -> Impact {
        let mut s = Story::at(world);
        let to = (from.0 + 2.0 * velocity.0, from.1 + 2.0 * velocity.1);
        s.scenario.obstacles = vec![match velocity {
            (0.0, 0.0) => world.parked(7, from.0, from.1),
            _ => world.moving(7, (0.0, 2.0), from, to),
        }];
        impact(&s.scenario, &s.vehicle, &driven(&s, own), Thing::Obstacle(7), &s.settings)
    }

    #[test]
    fn the_motion_along_the_normal_gives_the_cause_in_closed_cases() {
        let both = |vehicle_share| Cause::Both { vehicle_share };
        // half lengths 2.254 and 2.25 m, half widths 0.805 and 0.9 m
        let cases = [
            ("rear end by the vehicle", (8.0, 0.0), (10.0, 0.0), (5.0, 0.0), Cause::Vehicle, Side::Front, (8.0, -5.0)),
            (
                "rear end of a stopped vehicle",
                (0.0, 0.0),
                (-9.0, 0.3),
                (3.1, 0.0),
                Cause::Other,
                Side::Rear,
                (0.0, 3.1),
            ),
            ("rear end by the other", (2.0, 0.0), (-9.0, 0.3), (5.0, 0.0), Cause::Other, Side::Rear, (-2.0, 5.0)),
            ("side swipe by the other", (8.0, 0.0), (1.0, 2.0), (8.0, -0.5), Cause::Other, Side::Left, (0.0, 0.5)),
            ("side swipe by the vehicle", (8.0, 0.4), (1.0, 2.0), (8.0, 0.0), Cause::Vehicle, Side::Left, (0.4, 0.0)),
            ("both merge", (8.0, 0.3), (1.0, 2.0), (8.0, -0.1), both(0.75), Side::Left, (0.3, 0.1)),
            ("head-on", (8.0, 0.0), (20.0, 0.5), (-4.0, 0.0), both(2.0 / 3.0), Side::Front, (8.0, 4.0)),
            ("a parked car", (8.0, 0.0), (12.0, -0.5), (0.0, 0.0), Cause::Vehicle, Side::Front, (8.0, 0.0)),
            ("a car crosses into the side", (8.0, 0.0), (8.0, 7.0), (0.0, -6.0), Cause::Other, Side::Left, (0.0, 6.0)),
            ("jitter of a parked car", (8.0, 0.0), (12.0, 0.0), (-0.02, 0.0), Cause::Vehicle, Side::Front, (8.0, 0.02)),
            // 5 mm of lateral overlap, and 0.2 m driven between two samples
            ("a corner", (20.0, 0.0), (12.3, 1.7), (0.0, 0.0), Cause::Vehicle, Side::Front, (20.0, 0.0)),
        ];
        for (what, own, from, velocity, cause, side, speeds) in cases {
            for world in WORLDS {
                let found = with_car(world, own, from, velocity);
                let side = match side {
                    Side::Left if world.mirrored => Side::Right,
                    side => side,
                };
                let close = |a: f64, b: f64| (a - b).abs() < 1e-5;
                let same_cause = match (found.cause, cause) {
                    (Cause::Both { vehicle_share: a }, Cause::Both { vehicle_share: b }) => close(a, b),
                    (a, b) => a == b,
                };
                assert!(same_cause && found.side == Some(side), "{what} in {world:?}: {found:?}");
                let same = close(found.vehicle_speed, speeds.0) && close(found.other_speed, speeds.1);
                assert!(same, "{what} in {world:?}: {found:?}");
            }
        }
    }

    #[test]
    fn the_contact_begins_when_the_overlap_reaches_the_tolerance() {
        let found = with_car(World::here(), (8.0, 0.0), (10.0, 0.0), (5.0, 0.0));
        let gap = 10.0 - 2.25 - 2.254;
        assert!((found.time - (gap + 0.001) / 3.0).abs() < 1e-6, "{found:?}");
        assert!((found.closing_speed() - 3.0).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn the_sentence_names_the_moving_party() {
        let said = |own, from, velocity| with_car(World::here(), own, from, velocity).to_string();
        let behind = said((0.0, 0.0), (-9.0, 0.0), (3.1, 0.0));
        assert_eq!(behind, "obstacle 7 ran into the stopped vehicle from behind at 3.1 m/s");
        let ahead = said((8.0, 0.0), (10.0, 0.0), (5.0, 0.0));
        assert_eq!(ahead, "the vehicle ran into obstacle 7 with its front at 3.0 m/s");
        let swiped = said((8.0, 0.0), (1.0, -2.0), (8.0, 0.5));
        assert_eq!(swiped, "obstacle 7 ran into the vehicle from the right at 0.5 m/s");
        let head_on = said((8.0, 0.0), (20.0, 0.0), (-4.0, 0.0));
        let shares = "the vehicle and obstacle 7 ran into each other at 12.0 m/s (share of the vehicle 67 %, of obstacle 7 33 %)";
        assert_eq!(head_on, shares);
    }

    #[test]
    fn a_turning_vehicle_runs_into_what_stands_beside_it() {
        for world in WORLDS {
            let mut s = Story::at(world);
            s.scenario.obstacles = vec![world.parked(7, 0.0, 2.0)];
            // the rear axle stands still, and the front turns left at 0.5 rad/s
            let at = |i: i32| {
                let time = 0.01 * f64::from(i);
                Place { time, pose: s.place.pose(-1.422, 0.0, 0.5 * time), speed: 1.0 }
            };
            let places: Vec<Place> = (0..=100).map(at).collect();
            let found = impact(&s.scenario, &s.vehicle, &places, Thing::Obstacle(7), &s.settings);
            assert_eq!(found.cause, Cause::Vehicle, "{found:?}");
            // the front left corner, 3.676 m ahead and 0.805 m to the left, reaches 1.101 m after 0.0813 rad, 3.598 m ahead
            assert!((found.vehicle_speed - 0.5 * 3.598).abs() < 1e-3, "{found:?}");
        }
    }

    #[test]
    fn a_vehicle_runs_into_occupied_cells() {
        for world in WORLDS {
            let mut s = Story::at(world);
            s.scenario.obstacles.clear();
            let side = world.side();
            let corner = Pose { position: world.point(12.0, -0.25 * side), yaw: world.origin.yaw };
            s.scenario.occupancy = Some(OccupancyGrid::new(corner, 0.5, 1, 1, vec![Cell::Occupied]).unwrap());
            let found =
                impact(&s.scenario, &s.vehicle, &driven(&s, (8.0, 0.0)), Thing::Cells(corner.position), &s.settings);
            assert_eq!((found.cause, found.side), (Cause::Vehicle, Some(Side::Front)), "{found:?}");
            let time = (12.0 - 2.254 + 0.001) / 8.0;
            assert!((found.vehicle_speed - 8.0).abs() < 1e-5 && (found.time - time).abs() < 1e-6, "{found:?}");
        }
    }

    #[test]
    fn a_round_post_is_hit_along_the_line_to_its_middle() {
        for world in WORLDS {
            let mut s = Story::at(world);
            let mut post = world.parked(7, 12.0, 1.0);
            post.shape = Shape { parts: vec![Part::Circle { centre: Point::origin(), radius: 0.4 }] };
            s.scenario.obstacles = vec![post];
            let found = impact(&s.scenario, &s.vehicle, &driven(&s, (8.0, 0.0)), Thing::Obstacle(7), &s.settings);
            // the corner of the vehicle is 0.195 m beside the middle of the post
            let expected = 8.0 * (1.0 - (0.195_f64 / 0.399).powi(2)).sqrt();
            assert!((found.vehicle_speed - expected).abs() < 1e-3, "{found:?}, expected {expected}");
            assert_eq!((found.cause, found.side), (Cause::Vehicle, Some(Side::Front)));
        }
    }

    #[test]
    fn what_overlaps_at_the_first_sample_or_appears_later_is_said_so() {
        for world in WORLDS {
            assert_eq!(with_car(world, (8.0, 0.0), (3.0, 0.0), (0.0, 0.0)).cause, Cause::Start);
            let mut s = Story::at(world);
            s.scenario.obstacles = vec![world.moving(7, (1.0, 2.0), (9.0, 0.0), (17.0, 0.0))];
            let places = driven(&s, (8.0, 0.0));
            let found = |s: &Story| impact(&s.scenario, &s.vehicle, &places, Thing::Obstacle(7), &s.settings);
            assert_eq!(found(&s).cause, Cause::Appeared);
            // a set that begins at the place of the vehicle, and one that it drives into
            let set = |x: f64| Part::Rectangle { centre: world.pose(x, 0.0, 0.0), length: 4.0, width: 2.0 };
            for (x, cause) in [(8.0, Cause::Appeared), (14.0, Cause::Vehicle)] {
                let region = Shape { parts: vec![set(x)] };
                s.scenario.obstacles[0].motion = Motion::Occupancy(vec![TimedOccupancy { from: 1.0, to: 2.0, region }]);
                assert_eq!(found(&s).cause, cause, "{:?}", found(&s));
            }
        }
    }

    #[test]
    fn a_contact_that_the_geometry_does_not_see_has_no_known_cause() {
        let found = with_car(World::here(), (8.0, 0.0), (40.0, 0.0), (8.0, 0.0));
        assert_eq!((found.cause, found.side), (Cause::Unknown, None));
        assert_eq!(found.to_string(), "the vehicle touched obstacle 7 (cause unknown)");
    }

    #[test]
    fn the_check_fails_whoever_is_the_cause_and_carries_it() {
        let mut s = Story::clean();
        // it hits the vehicle 1 s after the vehicle has stopped at x = 82 m
        s.scenario.obstacles[1] = s.place.moving(101, (11.0, 15.0), (62.5, 0.0), (82.5, 0.0));
        let contact =
            Contact { time: 15.0, with: Touched::Obstacle(101), at_rear_axle_frame: Point::new(-0.8, 0.0), speed: 0.0 };
        for reported in [None, Some(contact)] {
            s.log.contact = reported;
            let check = s.judge().first_failure().cloned().unwrap();
            assert_eq!((check.name, check.impact.map(|i| i.cause)), ("no_contact", Some(Cause::Other)));
            let event = "obstacle 101 ran into the stopped vehicle from behind at 5.0 m/s at ";
            assert!(check.note.starts_with(event), "{check:?}");
        }
        s.scenario.obstacles[1] = s.place.moving(101, (0.0, 20.0), (50.0, 0.0), (210.0, 0.0));
        s.log.contact = None;
        assert!(s.judge().checks.iter().all(|c| c.impact.is_none()));
    }
}
