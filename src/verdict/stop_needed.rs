//! `stop_needed`: a run that stopped instead of reaching its goal had a reason to stop.
//!
//! Without this check a planner that stops without a reason passes every other one. From the final standstill the footprint
//! is moved forwards in small steps along the lanes under the rear axle, and straight ahead if the vehicle is not aligned with a
//! lane, until it meets an obstacle, an occupied cell or the end of the road. The same result decides whether the check `goal`
//! applies: something in the way excuses a missed goal, the end of the road does not.
//!
//! An obstacle counts if it is there at any time from [`PATIENCE`] before the end of the run to [`LOOK_ON`] after, at
//! standstill. One that left earlier is no reason to stand any longer, and one that comes from behind, through the stopped
//! vehicle, is not in its way.
//!
//! Junctions and crosswalks are kept free of standing vehicles: their length does not count, so that a vehicle may wait in front of one
//! for an obstacle behind it.
//!
//! The check is lenient: the nearest obstacle on any of these paths counts, and so does an obstacle that only crosses one
//! of them later. Weak where an obstacle blocks the vehicle elsewhere, e.g. on the lane that it has to change to.

use std::fmt;

use super::cause::{self, Cause, Side};
use super::contact::{self, Place, Thing};
use super::road::Road;
use super::{Check, Expectation, Settings, Status, cells};
use crate::geometry::polyline::Polyline;
use crate::geometry::{Point, Pose, wrap_angle};
use crate::map::{Lanelet, LaneletId, Obstacle, PlanningProblem, RoadNetwork, Scenario};
use crate::number::Short;
use crate::simulation::Log;
use crate::vehicle::Vehicle;

/// Largest free distance ahead of a needed stop, m: it covers the standoff and the space to steer around an obstacle.
const FREE: f64 = 10.0;
/// How far ahead the footprint is moved, m, not counting what has to be kept free.
const LOOK_AHEAD: f64 = 20.0;
/// How far ahead it is moved at most, m: over a large junction.
const FARTHEST: f64 = 80.0;
/// Distance between two steps, m.
const STEP: f64 = 0.25;
/// Time between two looks at moving obstacles, s.
const INTERVAL: f64 = 0.25;
/// How long after the end of the run moving obstacles are looked at, s.
const LOOK_ON: f64 = 10.0;
/// How long before the end of the run an obstacle can have left and still be the reason for the standstill, s: the time to
/// notice that the lane is free, and to start.
const PATIENCE: f64 = 10.0;
/// Time between two looks at obstacles from behind, s: a car does not jump over the vehicle.
const BEHIND_INTERVAL: f64 = 0.05;
/// A vehicle at a smaller angle to a lane (rad) drives along it.
const ALIGNED: f64 = 0.1;
/// Distance to an obstacle at which a vehicle can stop without being too near, m. A goal at a larger distance from an obstacle
/// is not blocked by it.
const CLEAR: f64 = 5.0;
/// Lanes followed at branches, at most.
const LANES: usize = 16;
/// A successor that begins farther than this from the end of its lanelet is not connected to it, m.
const GAP: f64 = 3.0;

/// What ends the free road ahead.
#[derive(Debug, Clone, Copy, PartialEq)]
enum End {
    Thing(Thing),
    Road,
    /// Nothing within [`LOOK_AHEAD`].
    None,
}

/// The free road ahead of a vehicle at its final standstill.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FreeRoad {
    /// Free distance ahead, m.
    distance: f64,
    end: End,
    /// Begin of the standstill, s.
    since: f64,
    /// Free distance to a state that meets the goal but for its time, on any of the paths, m.
    goal: Option<f64>,
}

impl FreeRoad {
    /// Whether an obstacle or an occupied cell stood so near that the vehicle had to stop.
    pub(super) fn is_in_the_way(&self) -> bool {
        self.distance <= FREE && matches!(self.end, End::Thing(_))
    }

    /// Whether the vehicle is inside the goal, or could stop in it and be clear of what is in the way.
    pub(super) fn is_goal_free(&self) -> bool {
        self.goal.is_some_and(|goal| goal == 0.0 || goal <= self.distance - CLEAR)
    }
}

impl fmt::Display for FreeRoad {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.end {
            End::Thing(thing) => write!(f, "stopped {:.2} m before {thing}", Short(self.distance)),
            End::Road => write!(f, "stopped {:.2} m before the end of the road", Short(self.distance)),
            End::None => write!(f, "stopped with {:.0} m of free road ahead", self.distance),
        }
    }
}

/// The free road ahead of the final standstill; `None` if the run ended moving. `goal` says whether a stopped vehicle whose
/// centre has a pose meets every condition of a goal but its time.
pub(super) fn free_road(
    scenario: &Scenario,
    vehicle: &Vehicle,
    log: &Log,
    settings: &Settings,
    goal: impl Fn(&Pose) -> bool,
) -> Option<FreeRoad> {
    let last = log.samples.last().filter(|s| s.speed.abs() <= settings.standstill_speed)?;
    let stopped = log.samples.iter().rposition(|s| s.speed.abs() > settings.standstill_speed).map_or(0, |i| i + 1);
    let since = log.samples.get(stopped).map_or(last.time, |s| s.time);
    let span = (since.max(last.time - PATIENCE), until(scenario, last.time));
    let obstacles =
        scenario.obstacles.iter().filter(|o| !comes_from_behind(scenario, vehicle, o, &last.pose, span, settings));
    let look = Look { scenario, vehicle, obstacles: obstacles.collect(), times: times(span, INTERVAL) };

    let lanes = Lane::all(&scenario.network, &last.pose);
    let straight = straight_road_end(&Road::new(&scenario.network), vehicle, &last.pose, settings);
    // in a bend, straight ahead leads to another lane
    let is_aligned = lanes.iter().any(|lane| lane.heading.abs() < ALIGNED);
    let ahead = |distance: f64| last.pose.advanced(distance);
    let mut things = Vec::new();
    let mut goals = Vec::new();
    let is_goal = |pose: Pose| goal(&vehicle.centre_of_rear_axle(&pose));
    let mut look_along = |road_end: f64, places: &[Ahead]| {
        things.push(look.first_thing(road_end, places));
        goals.push(places.iter().find(|place| is_goal(place.pose)).map(|place| place.free));
    };
    if !is_aligned {
        look_along(straight, &places(&scenario.network, vehicle, ahead));
    }
    for lane in &lanes {
        look_along(lane.road_end(vehicle), &places(&scenario.network, vehicle, |distance| lane.pose(distance)));
    }
    let nearest = things.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0));
    let goal = goals.into_iter().flatten().min_by(f64::total_cmp);
    // the lane that goes on farthest says where the road ends; a bend leaves the road straight ahead
    let road_end = lanes.iter().map(|l| l.road_end(vehicle)).reduce(f64::max).unwrap_or(straight);
    let (distance, end) = match nearest {
        Some((distance, thing)) => (distance, End::Thing(thing)),
        None if road_end < LOOK_AHEAD => (road_end, End::Road),
        None => (LOOK_AHEAD, End::None),
    };
    Some(FreeRoad { distance, end, since, goal })
}

/// Whether a moving obstacle comes from behind to the place of the stopped vehicle.
fn comes_from_behind(
    scenario: &Scenario,
    vehicle: &Vehicle,
    obstacle: &Obstacle,
    pose: &Pose,
    span: (f64, f64),
    settings: &Settings,
) -> bool {
    if obstacle.is_static() {
        return false;
    }
    let standing = |time: f64| Place { time, pose: *pose, speed: 0.0 };
    let places: Vec<Place> = times(span, BEHIND_INTERVAL).into_iter().map(standing).collect();
    let impact = cause::impact(scenario, vehicle, &places, Thing::Obstacle(obstacle.id), settings);
    impact.cause == Cause::Other && impact.side == Some(Side::Rear)
}

const NAME: &str = "stop_needed";

/// The check, from the free road ahead of the final standstill.
pub(super) fn stop_needed(problem: &PlanningProblem, ahead: Option<&FreeRoad>, settings: &Settings) -> Check {
    let why_not = match (settings.expect, ahead) {
        (Expectation::Goal, _) => "the run did not stop safely short of its goal",
        (_, None) => "the run ended moving",
        _ if problem.goals.is_empty() => "the planning problem has no goal",
        (Expectation::Stop, Some(free)) => {
            return Check {
                name: NAME,
                status: Status::of(free.distance <= FREE),
                value: free.distance,
                limit: FREE,
                unit: "m",
                at_time: Some(free.since),
                impact: None,
                note: format!("{free} at {:.2} s; limit {FREE:.0} m", free.since),
                method: "free distance of the footprint along its lanes, straight ahead where it is not aligned".into(),
            };
        }
    };
    Check::not_applicable(NAME, "m", why_not)
}

/// The last time at which moving obstacles are looked at, s.
fn until(scenario: &Scenario, end: f64) -> f64 {
    let moving = scenario.obstacles.iter().filter(|o| !o.is_static());
    moving.map(|o| o.lifetime().1).fold(f64::NEG_INFINITY, f64::max).min(end + LOOK_ON)
}

/// The times of a span, at least its first, at intervals.
fn times((from, until): (f64, f64), interval: f64) -> Vec<f64> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a span is 20 s at most; negative is 0
    let count = ((until - from) / interval) as usize;
    (0..=count).map(|i| from + i as f64 * interval).collect()
}

/// Distances at which the footprint is tested, m.
fn steps() -> impl Iterator<Item = f64> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 320 steps
    let count = (FARTHEST / STEP) as usize;
    (0..=count).map(|i| i as f64 * STEP)
}

/// Distance to the end of the road straight ahead, m; [`LOOK_AHEAD`] if it is not nearer.
fn straight_road_end(road: &Road, vehicle: &Vehicle, pose: &Pose, settings: &Settings) -> f64 {
    let tolerated = settings.road_tolerance.max(road.excursion(vehicle, pose).depth);
    let leaves = |ahead: &f64| road.excursion(vehicle, &pose.advanced(*ahead)).depth > tolerated;
    steps().find(leaves).unwrap_or(FARTHEST)
}

/// A place on a path ahead.
struct Ahead {
    /// Distance, m.
    driven: f64,
    /// The part of it on which the vehicle may stand, m.
    free: f64,
    pose: Pose,
}

/// The places of the footprint on a path.
fn places(network: &RoadNetwork, vehicle: &Vehicle, pose_at: impl Fn(f64) -> Pose) -> Vec<Ahead> {
    let kept_free: Vec<&Lanelet> = network.lanelets.values().filter(|l| l.is_kept_free()).collect();
    let front = vehicle.front_overhang_from_rear_axle();
    let axis = [front, 0.5 * front, 0.0, front - vehicle.length];
    let may_stand = |pose: &Pose| {
        let along = axis.map(|x| pose.to_world(Point::new(x, 0.0)));
        !kept_free.iter().any(|l| along.iter().any(|p| l.contains(*p)))
    };
    let mut free = 0.0;
    let place = |driven| {
        let place = Ahead { driven, free, pose: pose_at(driven) };
        free += if may_stand(&place.pose) { STEP } else { 0.0 };
        place
    };
    steps().map(place).take_while(|place| place.free <= LOOK_AHEAD).collect()
}

struct Look<'a> {
    scenario: &'a Scenario,
    vehicle: &'a Vehicle,
    obstacles: Vec<&'a Obstacle>,
    times: Vec<f64>,
}

impl Look<'_> {
    /// The first thing that the footprint meets on a path before the road ends, with the free distance before it, m.
    fn first_thing(&self, road_end: f64, ahead: &[Ahead]) -> Option<(f64, Thing)> {
        let on_road = ahead.iter().take_while(|place| place.driven < road_end || place.driven == 0.0);
        on_road.into_iter().find_map(|Ahead { free, pose, .. }| {
            let place = |time: &f64| Place { time: *time, pose: *pose, speed: 0.0 };
            let places: Vec<Place> = self.times.iter().map(place).collect();
            let obstacle = contact::nearest_obstacle(self.obstacles.iter().copied(), self.vehicle, &places);
            // cells do not move
            let cells = cells::nearest(self.scenario, self.vehicle, &places[..1]);
            let nearest = obstacle.into_iter().chain(cells).reduce(|a, b| if b.gap < a.gap { b } else { a })?;
            (nearest.gap < 0.0).then_some((*free, nearest.thing))
        })
    }
}

/// A lane under the rear axle: the centre line of a lanelet and of a chain of its successors.
struct Lane {
    line: Polyline,
    /// Station of the rear axle, m.
    station: f64,
    /// Lateral offset of the rear axle, m, positive to the left.
    offset: f64,
    /// Heading relative to the centre line, rad.
    heading: f64,
}

impl Lane {
    /// The lanes that contain the rear axle and lead in its direction, with a lane for each branch ahead.
    fn all(network: &RoadNetwork, pose: &Pose) -> Vec<Self> {
        let here = |l: &&Lanelet| l.is_drivable() && l.contains(pose.position);
        let chains = network.lanelets.values().filter(here).flat_map(|l| chains(network, l.id));
        chains.take(LANES).filter_map(|chain| Self::new(network, &chain, pose)).collect()
    }

    fn new(network: &RoadNetwork, chain: &[LaneletId], pose: &Pose) -> Option<Self> {
        let points = chain.iter().filter_map(|id| network.lanelets.get(id)).flat_map(|l| l.centre.points());
        let line = Polyline::new(points.copied())?;
        let first = network.lanelets.get(chain.first()?)?;
        let foot = line.project_between(pose.position, 0.0, first.centre.length());
        let heading = wrap_angle(pose.yaw - line.yaw_at(foot.station));
        let leads_ahead = heading.abs() < std::f64::consts::FRAC_PI_2;
        leads_ahead.then_some(Self { line, station: foot.station, offset: foot.offset, heading })
    }

    /// The rear axle some distance ahead, with the same offset and heading relative to the lane.
    fn pose(&self, ahead: f64) -> Pose {
        let station = self.station + ahead;
        let on_line = Pose { position: self.line.at(station), yaw: self.line.yaw_at(station) };
        Pose { position: on_line.to_world(Point::new(0.0, self.offset)), yaw: on_line.yaw + self.heading }
    }

    /// Distance that the front of the vehicle can move before the lane ends, m; at most [`FARTHEST`].
    fn road_end(&self, vehicle: &Vehicle) -> f64 {
        let front = self.station + vehicle.front_overhang_from_rear_axle();
        (self.line.length() - front).clamp(0.0, FARTHEST)
    }
}

/// Chains of connected lanelets from a lanelet on, long enough for [`FARTHEST`] and the longest vehicle.
fn chains(network: &RoadNetwork, from: LaneletId) -> Vec<Vec<LaneletId>> {
    const ENOUGH: f64 = FARTHEST + 30.0;
    let mut finished = Vec::new();
    let mut open = vec![(vec![from], 0.0)];
    while let Some((chain, length)) = open.pop() {
        let end = chain.last().and_then(|id| network.lanelets.get(id));
        let next = |id: &&LaneletId| {
            let connected = |l: &Lanelet| end.is_some_and(|e| (l.centre.first() - e.centre.last()).norm() <= GAP);
            !chain.contains(id) && network.lanelets.get(id).is_some_and(|l| l.is_drivable() && connected(l))
        };
        let successors: Vec<LaneletId> = end.iter().flat_map(|l| l.successors.iter()).filter(next).copied().collect();
        if length > ENOUGH || successors.is_empty() || finished.len() + open.len() >= LANES {
            finished.push(chain);
            continue;
        }
        for id in successors {
            let added = network.lanelets.get(&id).map_or(0.0, |l| l.centre.length());
            open.push(([chain.clone(), vec![id]].concat(), length + added));
        }
    }
    finished
}

#[cfg(test)]
mod tests {
    use super::super::testing::Story;
    use super::*;
    use crate::simulation::Sample;

    fn check(s: &Story, name: &str) -> Check {
        s.judge().checks.into_iter().find(|c| c.name == name).unwrap()
    }

    /// The clean run with its goal moved aside, as a safe stop: the front bumper stops at 84.254 m on a road that ends at
    /// 130 m.
    fn stopped() -> Story {
        let mut s = Story::clean();
        s.goal().position = Some(crate::map::GoalPosition::Lanelets(vec![4711]));
        s.settings = Settings::expecting(Expectation::Stop);
        s
    }

    /// The road ends at a station, m.
    fn end_road_at(s: &mut Story, end: f64) {
        s.scenario.network.lanelets.insert(2, s.place.lanelet(2, (70.0, end), -1.75, 1.75));
    }

    #[test]
    fn a_stop_on_a_free_road_fails_and_one_before_a_parked_car_passes() {
        let mut s = stopped();
        assert_eq!(s.failures(), ["goal", "stop_needed"]);
        assert_eq!(check(&s, "stop_needed").note, "stopped with 20 m of free road ahead at 12.21 s; limit 10 m");
        s.scenario.obstacles.push(s.place.parked(7, 90.0, 0.5));
        assert_eq!(s.failures(), [""; 0]);
        let needed = check(&s, "stop_needed");
        // bumper to bumper 90 − 2.25 − 84.254, seen at the first step beyond
        assert!(needed.value >= 3.496 && needed.value <= 3.496 + STEP, "{needed:?}");
        let goal = check(&s, "goal");
        assert_eq!(
            (goal.status, &*goal.note),
            (Status::NotApplicable, "not applicable: stopped 3.50 m before obstacle 7")
        );
        s.scenario.obstacles.pop();
        s.scenario.obstacles.push(s.place.parked(7, 90.0, 3.0));
        assert_eq!(s.failures(), ["goal", "stop_needed"], "a car beside the lane is not in the way");
    }

    /// The front bumper stops at 84.25 m, 1.75 m before a junction of 14 m; behind it stands a car.
    #[test]
    fn a_junction_is_kept_free_and_its_length_does_not_count() {
        let mut s = stopped();
        let parts = [(2, 70.0, 86.0), (3, 86.0, 100.0), (4, 100.0, 130.0)];
        for (id, from, to) in parts {
            let mut part = s.place.lanelet(id, (from, to), -1.75, 1.75);
            part.successors = if id < 4 { vec![id + 1] } else { Vec::new() };
            s.scenario.network.lanelets.insert(id, part);
        }
        s.scenario.obstacles.push(s.place.parked(7, 105.0, 0.0));
        assert_eq!(s.failures(), ["goal", "stop_needed"], "18.5 m on a plain road");
        s.scenario.network.lanelets.entry(3).and_modify(|junction| junction.types = vec!["intersection".into()]);
        assert_eq!(s.failures(), [""; 0]);
        let needed = check(&s, "stop_needed");
        assert!(needed.value >= 1.75 && needed.value <= 1.75 + STEP, "{needed:?}");
        // a car 26 m behind the junction is no reason to wait in front of it
        s.scenario.obstacles.pop();
        s.scenario.obstacles.push(s.place.parked(7, 128.0, 0.0));
        assert_eq!(s.failures(), ["goal", "stop_needed"]);
    }

    #[test]
    fn an_obstacle_that_crosses_later_is_in_the_way() {
        let mut s = stopped();
        s.scenario.obstacles.push(s.place.moving(7, (14.0, 19.0), (88.0, -20.0), (88.0, 20.0)));
        assert_eq!(s.failures(), [""; 0]);
    }

    #[test]
    fn the_end_of_the_road_is_a_reason_to_stop_but_no_excuse_for_a_missed_goal() {
        let mut s = stopped();
        end_road_at(&mut s, 90.0);
        assert_eq!(s.failures(), ["goal"]);
        let needed = check(&s, "stop_needed");
        // the front bumper stops at 82 + 4.508 / 2 m
        assert!((needed.value - (90.0 - 84.254)).abs() < 0.01, "{needed:?}");
        assert!(
            check(&s, "goal").note.ends_with("stopped 5.75 m before the end of the road"),
            "{:?}",
            check(&s, "goal")
        );
        // an obstacle beyond the end of the road changes nothing
        s.scenario.obstacles.push(s.place.parked(7, 93.0, 0.0));
        assert_eq!(s.failures(), ["goal"]);
        s.scenario.obstacles.pop();
        s.scenario.obstacles.push(s.place.parked(7, 88.0, 0.0));
        assert_eq!(s.failures(), [""; 0]);
    }

    #[test]
    fn a_goal_that_was_driven_past_is_not_excused_by_an_obstacle() {
        let mut s = stopped();
        s.scenario.obstacles.push(s.place.parked(7, 90.0, 0.0));
        let region = |s: &Story, x: f64| {
            let centre = s.place.pose(x, 0.0, 0.0);
            let part = crate::map::Part::Rectangle { centre, length: 6.0, width: 3.5 };
            Some(crate::map::GoalPosition::Shapes(crate::map::Shape { parts: vec![part] }))
        };
        s.goal().position = region(&s, 40.0);
        assert_eq!(s.failures(), ["goal"]);
        assert!(check(&s, "goal").note.contains("; it was driven past; stopped "), "{:?}", check(&s, "goal"));
        s.goal().position = region(&s, 110.0);
        assert_eq!(s.failures(), [""; 0], "a goal beyond the obstacle");
    }

    #[test]
    fn an_obstacle_in_a_bend_is_found_along_the_lane() {
        // a left bend of radius 30 m about (0, 30): straight ahead leaves the road before the obstacle
        let arc = |radius: f64| {
            let point = |k: i32| {
                let angle = f64::from(k) * 0.02;
                (radius * angle.sin(), 30.0 - radius * angle.cos())
            };
            crate::fixtures::line(&(-20..60).map(point).collect::<Vec<_>>())
        };
        let mut s = stopped();
        s.scenario.network = crate::fixtures::network([crate::fixtures::lanelet(1, arc(31.75), arc(28.25))]);
        let on_arc = |angle: f64| Pose::new(30.0 * angle.sin(), 30.0 - 30.0 * angle.cos(), angle);
        let standing = crate::simulation::Sample { pose: on_arc(0.0), speed: 0.0, ..s.log.samples[0] };
        s.log.samples = vec![standing];
        let ahead = |s: &Story| free_road(&s.scenario, &s.vehicle, &s.log, &s.settings, |_| false).unwrap();
        s.scenario.obstacles = vec![crate::fixtures::parked(7, on_arc(0.45), 2.0, 1.8)];
        let free = ahead(&s);
        // arc length 13.5 m to the obstacle's middle, less half its length and the front overhang of 3.676 m
        assert!(free.is_in_the_way() && (free.distance - (13.5 - 1.0 - 3.676)).abs() < 0.6, "{free:?}");
        s.scenario.obstacles.clear();
        assert_eq!(ahead(&s).end, End::None);
        s.scenario.obstacles = vec![crate::fixtures::parked(7, Pose::new(12.0, -3.2, 0.0), 2.0, 1.8)];
        assert_eq!(ahead(&s).end, End::None, "an obstacle beside the road is not in the way");
        // on the outer lane of the bend, straight ahead
        s.scenario.network.lanelets.insert(2, crate::fixtures::lanelet(2, arc(35.25), arc(31.75)));
        s.scenario.obstacles = vec![crate::fixtures::parked(7, Pose::new(12.0, -0.6, 0.4), 2.0, 1.0)];
        assert_eq!(ahead(&s).end, End::None, "{:?}", ahead(&s));
        // a vehicle that points there has it in its way
        s.log.samples[0].pose.yaw -= 0.2;
        s.scenario.obstacles = vec![crate::fixtures::parked(7, Pose::new(10.0, -1.6, 0.4), 2.0, 1.0)];
        assert!(ahead(&s).is_in_the_way(), "{:?}", ahead(&s));
    }

    #[test]
    fn the_check_does_not_apply_to_a_run_asked_for_its_goal_or_without_one() {
        assert_eq!(check(&Story::clean(), "stop_needed").status, Status::NotApplicable);
        let mut s = stopped();
        s.problem().goals.clear();
        assert_eq!(check(&s, "stop_needed").status, Status::NotApplicable);
        assert_eq!(check(&s, "goal").note, "not applicable: the planning problem has no goal");
        assert_eq!(s.failures(), [""; 0]);
    }

    #[test]
    fn an_obstacle_that_comes_from_behind_through_the_stopped_vehicle_is_not_in_its_way() {
        let mut s = stopped();
        s.scenario.obstacles.push(s.place.moving(7, (16.0, 20.0), (60.0, 0.0), (120.0, 0.0)));
        assert_eq!(s.failures(), ["goal", "stop_needed"], "{:?}", check(&s, "stop_needed"));
        // one that comes towards the vehicle is
        s.scenario.obstacles.pop();
        s.scenario.obstacles.push(s.place.moving(7, (16.0, 20.0), (120.0, 0.0), (60.0, 0.0)));
        assert_eq!(s.failures(), [""; 0]);
    }

    #[test]
    fn an_obstacle_that_left_long_before_the_end_is_no_reason_to_stand() {
        let standing_until = |leaves: f64| {
            let mut s = stopped();
            let last = *s.log.samples.last().unwrap();
            let standing = (1..=2500).map(|i| Sample { time: last.time + 0.01 * f64::from(i), ..last });
            s.log.samples.extend(standing);
            let at = |time, x| crate::map::TimedPose { time, pose: s.place.pose(x, 0.0, 0.0), speed: 0.0 };
            let states = vec![at(0.0, 90.0), at(leaves, 90.0), at(leaves + 2.0, 115.0)];
            let lead = Obstacle { motion: crate::map::Motion::Trajectory(states), ..s.place.parked(7, 90.0, 0.0) };
            s.scenario.obstacles.push(lead);
            s.failures()
        };
        // the run ends at 40 s
        assert_eq!(standing_until(25.0), ["goal", "stop_needed"]);
        assert_eq!(standing_until(31.0), [""; 0]);
    }
}
