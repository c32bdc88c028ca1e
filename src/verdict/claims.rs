//! `claims_margin` and `claims_deceleration`: every committed plan with a proof keeps, as planned, what its level claims.
//!
//! The fallback branches sample plans and simulate them. Here each plan is measured without a simulation, from its record:
//! - **Margin.** The planned footprint, widened by the tracking margins of what the plan uses of the grip
//!   ([`Vehicle::tracking_margins`]), is free of static obstacles and occupied cells, and leaves the road by at most
//!   [`Settings::road_tolerance`], from the end of the lead to the planned standstill. Levels with margins keep those of the planner's
//!   settings, too. A plan outside of the domain of the tracking tube has no bound of its tracking errors and fails.
//! - **Deceleration.** After the lead, the profile brakes no harder than the plan claims and its level permits.
//!
//! The lead is the first brake lag of a plan: it continues the motion before. **What a start imposes** is excused. A footprint
//! that is inside its margins at the start keeps none for the first [`LEAVE_MARGIN`]; one that is off the road returns within
//! [`RETURN_TO_ROAD`] and moves no farther off. A deceleration at the end of the lead decreases by
//! [`RELEASE`](super::imposed::RELEASE) or faster.
//!
//! Poses are sampled, so that a violation between two of them is seen less deep or not at all, but none is reported that is not
//! there. Only definitions are shared with the planner: levels, margins of the settings, the domain and the bounds of the
//! tracking tube.
//!
//! Weak where: moving obstacles are left to `fallback_stops`; static obstacles that the vehicle had not observed yet count; what was
//! driven before a plan can widen its tube, which is not considered.

use std::fmt;

use rayon::prelude::*;

use super::contact::{self, Body, Nearest, Place};
use super::imposed::RELEASE;
use super::road::Road;
use super::{Check, Settings, Status, Thing, cells};
use crate::geometry::steps::covering;
use crate::geometry::{Point, Vector};
use crate::map::{Motion, Scenario};
use crate::number::Short;
use crate::planner::{self, Cycle, Decision, Level, Plan};
use crate::trajectory::Trajectory;
use crate::vehicle::{Footprint, GripUse, NotDrivable, ProofLimits, Vehicle};

/// Largest distance between two poses, m.
const SPACING: f64 = 0.5;
/// Largest shortfall of a margin that passes, m: rounding, and corners of the road that are rounded in one geometry and not in another.
const MARGIN_TOLERANCE: f64 = 0.02;
/// Largest excess of a deceleration that passes, m/s²: knots of a profile are rounded.
const DECELERATION_TOLERANCE: f64 = 0.05;
/// A start with less than this to spare counts as inside its margins, m: swept footprints contain more than the vehicle.
const NEAR: f64 = 0.05;
/// Distance within which a plan has to leave a margin that its start is inside of, m.
const LEAVE_MARGIN: f64 = 6.0;
/// A start farther beyond the boundary than this is off the road, m: lanelets are rounded to millimetres.
const ROUNDED_ROAD: f64 = 1e-3;
/// Distance within which a plan has to return to the road, m.
const RETURN_TO_ROAD: f64 = 15.0;

/// What the plans of a run were made for: their claims refer to it.
#[derive(Debug, Clone, Copy)]
pub struct PlannedFor<'a> {
    /// The settings of the planner.
    pub settings: &'a planner::Settings,
    /// Friction of the road that it believed, as a factor on that of dry asphalt.
    pub friction: f64,
}

/// A plan that claims a proof.
struct Claim<'a> {
    /// Number of the planning cycle, from 0.
    cycle: usize,
    plan: &'a Plan,
}

impl Claim<'_> {
    /// Where its plan begins: time since the start of the trajectory, s.
    fn lead(&self, vehicle: &Vehicle) -> f64 {
        vehicle.actuators.brake_lag.min(self.plan.trajectory.profile.last().time)
    }
}

impl fmt::Display for Claim<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the plan of cycle {} at {:.2} s (level {})", self.cycle, self.plan.time, self.plan.level)
    }
}

/// The plans with a proof; one that is kept counts once, unless it claims more than before.
fn claims(cycles: &[Cycle]) -> Vec<Claim<'_>> {
    let mut claims: Vec<Claim<'_>> = Vec::new();
    for (cycle, plan) in cycles.iter().map(|c| &c.plan).enumerate() {
        if plan.decision == Decision::Unproven || !plan.level.is_proven() {
            continue;
        }
        let is_known = claims.last().is_some_and(|Claim { plan: last, .. }| {
            last.level <= plan.level && last.deceleration <= plan.deceleration && last.trajectory == plan.trajectory
        });
        if !is_known {
            claims.push(Claim { cycle, plan });
        }
    }
    claims
}

/// What is nearest to a plan, or farthest inside its margins.
#[derive(Debug, Clone, Copy, PartialEq)]
enum What {
    Nothing,
    Thing(Thing),
    Road(Point),
    NotDrivable(NotDrivable),
}

/// How far something is inside the margins of a plan, m; negative if there is room to spare.
#[derive(Debug, Clone, Copy)]
struct Shortfall {
    depth: f64,
    what: What,
}

impl Shortfall {
    const NONE: Self = Self { depth: f64::NEG_INFINITY, what: What::Nothing };

    fn of(nearest: Option<Nearest>) -> Self {
        nearest.map_or(Self::NONE, |n| Self { depth: -n.gap, what: What::Thing(n.thing) })
    }

    fn passes(&self) -> bool {
        self.depth <= MARGIN_TOLERANCE && !matches!(self.what, What::NotDrivable(_))
    }

    /// The worse one: a failure before a pass, then the deeper one.
    fn worse(self, other: Self) -> Self {
        let key = |s: &Self| (!s.passes(), s.depth);
        if key(&other) > key(&self) { other } else { self }
    }
}

/// Measures the plans of one run.
struct Judge<'a> {
    scenario: &'a Scenario,
    vehicle: &'a Vehicle,
    planned_for: PlannedFor<'a>,
    limits: ProofLimits,
    statics: Vec<Body<'a>>,
    road: Road,
    settings: &'a Settings,
}

impl<'a> Judge<'a> {
    fn new(scenario: &'a Scenario, vehicle: &'a Vehicle, planned_for: PlannedFor<'a>, settings: &'a Settings) -> Self {
        let statics = scenario.obstacles.iter().filter(|o| matches!(o.motion, Motion::Static(_)));
        Self {
            scenario,
            vehicle,
            planned_for,
            limits: ProofLimits::new(vehicle, planned_for.friction),
            statics: statics.map(Body::new).collect(),
            road: Road::new(&scenario.network),
            settings,
        }
    }

    /// The shortfall of the margins of a plan.
    fn margin(&self, claim: &Claim<'_>) -> Shortfall {
        /// Without a bound of the tracking errors, that of the largest use stands for it.
        const FULL: GripUse = GripUse { total: 1.0, turning: 1.0, curvature: 0.0 };
        let Plan { trajectory, level, .. } = claim.plan;
        let drivable = self.vehicle.drivable(self.planned_for.friction, trajectory);
        let tube = self.vehicle.tracking_margins(drivable.as_ref().unwrap_or(&FULL));
        let tube = Vector::new(tube.longitudinal, tube.lateral);
        let collision = &self.planned_for.settings.collision;
        let (mut to_obstacles, mut to_road) = (tube, tube);
        if *level <= Level::StopInJunction {
            let of_level = collision.static_obstacles;
            to_obstacles = tube.sup(&Vector::new(of_level.longitudinal, of_level.lateral));
            to_road = tube.sup(&Vector::repeat(collision.road + self.settings.road_tolerance));
        }
        let places = places(trajectory, claim.lead(self.vehicle), claim.plan.time);
        let found = self
            .near_obstacles(&places, &widened(self.vehicle, to_obstacles))
            .worse(self.near_boundary(&places, &widened(self.vehicle, to_road)));
        match drivable {
            Ok(_) => found,
            Err(why) => Shortfall { depth: found.depth, what: What::NotDrivable(why) },
        }
    }

    fn near_obstacles(&self, places: &[Place], wide: &Vehicle) -> Shortfall {
        let nearest = |places: &[Place], vehicle: &Vehicle| {
            let obstacle = contact::nearest_body(&self.statics, vehicle, places);
            let cells = cells::nearest(self.scenario, vehicle, places);
            obstacle.into_iter().chain(cells).reduce(|a, b| if b.gap < a.gap { b } else { a })
        };
        let is_imposed = nearest(&places[..1], wide).is_some_and(|n| n.gap < NEAR);
        let (first, others) = places.split_at(if is_imposed { within(places, LEAVE_MARGIN) } else { 0 });
        Shortfall::of(nearest(first, self.vehicle)).worse(Shortfall::of(nearest(others, wide)))
    }

    fn near_boundary(&self, places: &[Place], wide: &Vehicle) -> Shortfall {
        let tolerance = self.settings.road_tolerance;
        let worst = |places: &[Place], vehicle: &Vehicle, permitted: f64| {
            let excursions = places.iter().map(|p| self.road.excursion(vehicle, &p.pose));
            let one = |e: super::road::Excursion| {
                e.at.map_or(Shortfall::NONE, |at| Shortfall { depth: e.depth - permitted, what: What::Road(at) })
            };
            excursions.map(one).fold(Shortfall::NONE, Shortfall::worse)
        };
        let at_start = self.road.excursion(self.vehicle, &places[0].pose).depth;
        let nearly = widened(wide, Vector::repeat(NEAR));
        let length = match self.road.excursion(&nearly, &places[0].pose).depth {
            _ if at_start > ROUNDED_ROAD => within(places, RETURN_TO_ROAD),
            depth if depth > 0.0 => within(places, LEAVE_MARGIN),
            _ => 0,
        };
        let (first, others) = places.split_at(length);
        worst(first, self.vehicle, tolerance.max(at_start)).worse(worst(others, wide, tolerance))
    }

    /// Largest deceleration that a plan may use, m/s².
    fn permitted(&self, plan: &Plan) -> f64 {
        let of_level = match plan.level {
            Level::Emergency(index) => self
                .planned_for
                .settings
                .emergency
                .get(usize::from(index))
                .map_or(0.0, |e| e.deceleration.min(self.limits.deceleration())),
            _ => self.limits.applied_to(self.vehicle).comfort.aggressive_deceleration,
        };
        of_level.min(plan.deceleration)
    }

    /// The moment at which a plan exceeds the permitted deceleration most, or has the least to spare.
    fn deceleration(&self, claim: &Claim<'_>) -> Braking {
        let permitted = self.permitted(claim.plan);
        let profile = &claim.plan.trajectory.profile;
        let lead = claim.lead(self.vehicle);
        let parts = || braking_parts(&claim.plan.trajectory);
        let during = parts().filter(|p| p.from < lead - ROUNDING).map(|p| p.at(p.from).max(p.at(lead.min(p.to))));
        let imposed = during.fold(0.0, f64::max);
        // the excess is concave within a part: its largest value is at an end, or where the release ends
        let released = lead + (imposed - permitted).max(0.0) / RELEASE;
        let moments =
            |p: BrakingPart| [p.from.max(lead), released.clamp(p.from.max(lead), p.to), p.to].map(|t| (t, p.at(t)));
        let after = parts().filter(|p| p.to > lead + ROUNDING).flat_map(moments);
        let limit = |time: f64| permitted.max(imposed - RELEASE * (time - lead));
        let all = after.map(|(time, value)| Braking {
            value,
            limit: limit(time),
            time: time + claim.plan.trajectory.start_time,
        });
        let standing =
            Braking { value: 0.0, limit: permitted, time: claim.plan.trajectory.start_time + profile.last().time };
        all.fold(standing, |a, b| if b.excess() > a.excess() { b } else { a })
    }
}

/// Times of a profile closer than this are equal, s.
const ROUNDING: f64 = 1e-6;

/// A deceleration of a plan at a time of the run (s) and what it may be, m/s².
#[derive(Debug, Clone, Copy)]
struct Braking {
    value: f64,
    limit: f64,
    time: f64,
}

impl Braking {
    fn excess(&self) -> f64 {
        self.value - self.limit
    }
}

/// A part of a profile with constant jerk.
struct BrakingPart {
    from: f64,
    to: f64,
    deceleration: f64,
    jerk: f64,
}

impl BrakingPart {
    /// Deceleration at a time, m/s².
    fn at(&self, time: f64) -> f64 {
        self.deceleration - self.jerk * (time - self.from)
    }
}

fn braking_parts(trajectory: &Trajectory) -> impl Iterator<Item = BrakingPart> + '_ {
    trajectory.profile.knots().windows(2).map(|k| BrakingPart {
        from: k[0].time,
        to: k[1].time,
        deceleration: -k[0].acceleration,
        jerk: k[0].jerk,
    })
}

/// The planned places from the end of the lead (s since the start) to the end of the profile, at most [`SPACING`] apart.
fn places(trajectory: &Trajectory, lead: f64, time: f64) -> Vec<Place> {
    let (from, to) = (trajectory.profile.at(lead).station, trajectory.profile.last().station);
    let count = covering(to - from, SPACING);
    let station = |i: usize| from + (to - from) * i as f64 / count as f64;
    (0..=count).map(|i| Place { time, pose: trajectory.path.at(station(i)).pose, speed: 0.0 }).collect()
}

/// Number of places within a distance of the first one along the path, m.
fn within(places: &[Place], distance: f64) -> usize {
    let mut driven = 0.0;
    let steps = places.windows(2).map(|p| (p[1].pose.position - p[0].pose.position).norm());
    1 + steps
        .take_while(|step| {
            driven += step;
            driven <= distance
        })
        .count()
}

/// The vehicle with a footprint that is larger by margins ahead, behind and to both sides, m.
fn widened(vehicle: &Vehicle, margins: Vector) -> Vehicle {
    let corners = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)];
    let offsets = corners.map(|(x, y)| margins.component_mul(&Vector::new(x, y)));
    let around = |p: &Point| offsets.map(|offset| p + offset);
    let parts = vehicle.footprint.parts().iter().map(|part| part.iter().flat_map(around).collect()).collect();
    let footprint = Footprint::new(parts).unwrap_or_else(|_| vehicle.footprint.clone());
    let (length, width) = (vehicle.length + 2.0 * margins.x, vehicle.width + 2.0 * margins.y);
    Vehicle { footprint, length, width, ..vehicle.clone() }
}

const MARGIN: &str = "claims_margin";
const DECELERATION: &str = "claims_deceleration";

/// Both checks.
pub(super) fn check(
    scenario: &Scenario,
    vehicle: &Vehicle,
    cycles: &[Cycle],
    planned_for: PlannedFor<'_>,
    settings: &Settings,
) -> [Check; 2] {
    let claims = claims(cycles);
    if claims.is_empty() {
        let none = "no planning cycle claims a proof";
        return [Check::not_applicable(MARGIN, "m", none), Check::not_applicable(DECELERATION, "m/s²", none)];
    }
    let judge = Judge::new(scenario, vehicle, planned_for, settings);
    // in the order of the cycles, for any number of threads
    let margins: Vec<Shortfall> = claims.par_iter().map(|claim| judge.margin(claim)).collect();
    let braking: Vec<Braking> = claims.iter().map(|claim| judge.deceleration(claim)).collect();
    [margin_check(&claims, &margins), deceleration_check(&claims, &braking)]
}

/// The index of the worst one; the first of equals.
fn worst<T: Copy>(all: &[T], is_worse: impl Fn(&T, &T) -> bool) -> usize {
    (1..all.len()).fold(0, |worst, i| if is_worse(&all[i], &all[worst]) { i } else { worst })
}

fn margin_check(claims: &[Claim<'_>], found: &[Shortfall]) -> Check {
    let index = worst(found, |a, b| (!a.passes(), a.depth) > (!b.passes(), b.depth));
    let (claim, Shortfall { depth, what }) = (&claims[index], found[index]);
    let (all, failed) = (claims.len(), found.iter().filter(|s| !s.passes()).count());
    let thing = match what {
        What::Thing(thing) => thing.to_string(),
        What::Road(at) => format!("the road boundary at ({:.1}, {:.1})", Short(at.x), Short(at.y)),
        What::Nothing | What::NotDrivable(_) => String::new(),
    };
    let note = match what {
        What::Nothing => format!("all {all} plans keep their margins; nothing is near"),
        What::NotDrivable(why) => format!("{failed} of {all} plans fail, worst: {claim} is not drivable: {why}"),
        _ if failed > 0 => format!(
            "{failed} of {all} plans fail, worst: {thing} is {:.3} m inside the margins of {claim}; limit {MARGIN_TOLERANCE} m",
            Short(depth)
        ),
        _ => format!(
            "all {all} plans keep their margins; {thing} is nearest to those of {claim}: {:.3} m to spare",
            Short(-depth)
        ),
    };
    Check {
        name: MARGIN,
        status: Status::of(failed == 0),
        value: depth.max(0.0),
        limit: MARGIN_TOLERANCE,
        unit: "m",
        at_time: Some(claim.plan.time).filter(|_| what != What::Nothing),
        impact: None,
        note,
        method: format!(
            "the planned footprint with its margins, every {SPACING} m from the end of the lead to the planned standstill, against \
             static obstacles, occupied cells and the road"
        ),
    }
}

fn deceleration_check(claims: &[Claim<'_>], found: &[Braking]) -> Check {
    let index = worst(found, |a, b| a.excess() > b.excess());
    let (claim, braking) = (&claims[index], found[index]);
    let (all, failed) = (claims.len(), found.iter().filter(|b| b.excess() > DECELERATION_TOLERANCE).count());
    let count = if failed == 0 {
        format!("all {all} plans brake as they claim, nearest to its limit")
    } else {
        format!("{failed} of {all} plans fail, worst")
    };
    let Braking { value, limit, time } = braking;
    Check {
        name: DECELERATION,
        status: Status::of(failed == 0),
        value: braking.excess().max(0.0),
        limit: DECELERATION_TOLERANCE,
        unit: "m/s²",
        at_time: Some(time),
        impact: None,
        note: format!(
            "{count}: {claim} brakes at {:.2} m/s² at {time:.2} s, of {:.2} m/s²",
            Short(value.max(0.0)),
            Short(limit)
        ),
        method: "deceleration of the planned profile after its lead, beyond what the plan claims and its level permits"
            .into(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Place as Site, Story, cycle};
    use super::*;
    use crate::fixtures::knot;
    use crate::geometry::{Pose, Vector};
    use crate::trajectory::{SpeedKnot, SpeedProfile};

    fn checks(s: &Story) -> [Check; 2] {
        let planned_for = PlannedFor { settings: &s.planner, friction: 1.0 };
        check(&s.scenario, &s.vehicle, &s.cycles, planned_for, &s.settings)
    }

    fn margin(s: &Story) -> Check {
        checks(s)[0].clone()
    }

    fn deceleration(s: &Story) -> Check {
        checks(s)[1].clone()
    }

    /// Half of the vehicle's width and of a parked car's, m.
    const HALVES: f64 = 0.805 + 0.9;

    /// A story with a parked car at a distance from the side of the planned footprint, m.
    fn passing(site: Site, gap: f64) -> Story {
        let mut s = Story::at(site);
        s.scenario.obstacles[0] = s.place.parked(100, 60.0, HALVES + gap);
        s
    }

    fn at_level(mut s: Story, level: Level) -> Story {
        s.cycles.iter_mut().for_each(|c| c.plan.level = level);
        s
    }

    /// Lateral margin of the tube of straight driving, m.
    fn tube(s: &Story) -> f64 {
        s.vehicle.tracking_margins(&GripUse::default()).lateral
    }

    /// Each with its mirror image, and far away.
    fn everywhere() -> [Site; 3] {
        let here = Site::here();
        let far = Site { origin: Pose::new(6.9e5, 5.3e6, 2.2), mirrored: false };
        [here, far, Site { mirrored: true, ..here }]
    }

    #[test]
    fn a_plan_keeps_the_wider_one_of_its_tube_and_the_margins_of_its_level() {
        for site in everywhere() {
            let tube = tube(&Story::at(site));
            assert!((tube - 0.162).abs() < 0.002, "{tube}");
            for (level, needed) in [
                (Level::Comfort, 0.2),
                (Level::ShortGap, 0.2),
                (Level::StopInJunction, 0.2),
                (Level::NoMargin, tube),
                (Level::Emergency(0), tube),
            ] {
                let free = margin(&at_level(passing(site, needed + 0.01), level));
                assert!(free.passed() && free.value == 0.0, "{level}: {free:?}");
                assert!(
                    free.note.contains("obstacle 100 is nearest") && free.note.contains(": 0.010 m to spare"),
                    "{free:?}"
                );
                let blocked = margin(&at_level(passing(site, needed - 0.03), level));
                assert!(blocked.failed() && (blocked.value - 0.03).abs() < 1e-6, "{level}: {blocked:?}");
            }
        }
    }

    #[test]
    fn margins_of_the_settings_count_only_on_levels_with_margins() {
        let mut s = passing(Site::here(), 0.4);
        s.planner.collision.static_obstacles.lateral = 0.5;
        let check = margin(&s);
        assert!((check.value - 0.1).abs() < 1e-9, "{check:?}");
        let note = "1 of 1 plans fail, worst: obstacle 100 is 0.100 m inside the margins of the plan of cycle 0 at 0.00 s (level \
                    comfort); limit 0.02 m";
        assert_eq!(check.note, note);
        assert!(margin(&at_level(s, Level::NoMargin)).passed());
    }

    #[test]
    fn a_hard_braking_plan_has_a_wider_tube() {
        for site in everywhere() {
            let mut s = Story::at(site);
            // in front of the final standstill
            let front = 82.0 + 0.5 * s.vehicle.length;
            s.scenario.obstacles[0] = s.place.parked(100, front + 2.25 + 0.06, 0.0);
            s.planner.collision.static_obstacles.longitudinal = 0.0;
            assert!(margin(&s).passed(), "{:?}", margin(&s));
            let hard = vec![
                knot(0.0, 0.0, 8.0, 0.0),
                knot(7.0, 56.0, 8.0, 0.0),
                knot(8.0, 64.0, 8.0, -4.0),
                knot(10.0, 72.0, 0.0, 0.0),
            ];
            let mut braking = s.cycles[0].plan.trajectory.clone();
            braking.profile = SpeedProfile::new(hard).unwrap();
            let mut last = cycle(0.0, braking);
            (last.plan.level, last.plan.deceleration) = (Level::Emergency(0), 4.0);
            s.cycles = vec![last];
            let used = s.vehicle.drivable(1.0, &s.cycles[0].plan.trajectory).unwrap();
            let needed = s.vehicle.tracking_margins(&used).longitudinal;
            let found = margin(&s);
            assert!(needed > 0.075 && (found.value - (needed - 0.06)).abs() < 1e-6, "{needed} {found:?}");
        }
    }

    #[test]
    fn the_road_needs_the_tube_up_to_the_tolerance_of_the_verdict() {
        for site in everywhere() {
            let story = |beside: f64| {
                let mut s = Story::at(site);
                let narrow = s.place.lanelet(2, (70.0, 130.0), -1.75, 0.805 + beside);
                s.scenario.network.lanelets.insert(2, narrow);
                s
            };
            let needed = tube(&story(0.0)) - 0.05;
            assert!(margin(&story(needed + 0.001)).passed());
            let found = margin(&story(needed - 0.05));
            assert!(found.failed() && (found.value - 0.05).abs() < 1e-6, "{found:?}");
            assert!(found.note.contains("worst: the road boundary at ("), "{found:?}");
            let mut wide = story(needed + 0.001);
            wide.planner.collision.road = 0.3;
            let found = margin(&wide);
            assert!((found.value - (0.3 - needed - 0.001)).abs() < 1e-6, "{found:?}");
            assert!(margin(&at_level(wide, Level::NoMargin)).passed());
        }
    }

    #[test]
    fn what_the_start_imposes_is_excused_for_the_first_metres() {
        for site in everywhere() {
            // its rear end is `behind` the end of the lead
            let beside = |ahead: f64, gap: f64| {
                let mut s = passing(site, gap);
                let lead = 8.0 * s.vehicle.actuators.brake_lag;
                s.scenario.obstacles[0] = s.place.parked(100, 10.0 + lead + ahead, HALVES + gap);
                s
            };
            assert!(margin(&beside(0.0, 0.05)).passed(), "{:?}", margin(&beside(0.0, 0.05)));
            // it is beside the vehicle for 6 m and its length of the way
            let stays = margin(&beside(3.0, 0.05));
            assert!(stays.failed() && (stays.value - 0.15).abs() < 1e-6, "{stays:?}");
            assert!(margin(&beside(0.0, -0.05)).failed(), "the footprint itself");
            assert!(margin(&beside(6.0, 0.05)).failed(), "not at the start");
        }
    }

    #[test]
    fn a_start_off_the_road_may_return_and_not_move_farther_off() {
        for site in everywhere() {
            let story = |from: f64, narrow: f64, farther: f64| {
                let mut s = Story::at(site);
                for (id, x, left) in
                    [(1, (0.0, from), 0.805 - narrow), (3, (from, 20.0), 0.805 - farther), (2, (20.0, 130.0), 1.75)]
                {
                    s.scenario.network.lanelets.insert(id, s.place.lanelet(id, x, -1.75, left));
                }
                s
            };
            assert!(margin(&story(14.0, 0.2, 0.2)).passed());
            let farther = margin(&story(14.0, 0.2, 0.3));
            assert!(farther.failed() && (farther.value - 0.1).abs() < 1e-6, "{farther:?}");
            let mut never = story(14.0, 0.2, 0.2);
            never.scenario.network.lanelets.insert(2, never.place.lanelet(2, (20.0, 130.0), -1.75, 0.605));
            assert!(margin(&never).failed());
        }
    }

    #[test]
    fn a_plan_that_leaves_the_domain_of_the_tube_fails() {
        let mut s = Story::clean();
        let stops = vec![knot(0.0, 0.0, 8.0, 0.0), knot(5.0, 40.0, 8.0, -20.0), knot(5.4, 41.6, 0.0, 0.0)];
        s.cycles[0].plan.trajectory.profile = SpeedProfile::new(stops).unwrap();
        let found = margin(&s);
        assert!(
            found.failed() && found.note.starts_with("1 of 2 plans fail, worst: the plan of cycle 0 at 0.00 s"),
            "{found:?}"
        );
        assert!(found.note.contains(" is not drivable: use of the grip is "), "{found:?}");
    }

    #[test]
    fn occupied_cells_count() {
        let mut s = passing(Site::here(), 1.0);
        let far = s.clone();
        assert!(margin(&far).passed());
        let mut cells = vec![crate::map::Cell::Free; 130 * 4];
        cells[60] = crate::map::Cell::Occupied; // (60…61, 0.9…1.9)
        let origin = Pose { position: s.place.point(0.0, 0.9), yaw: 0.0 };
        s.scenario.occupancy = Some(crate::map::OccupancyGrid::new(origin, 1.0, 130, 4, cells).unwrap());
        let found = margin(&s);
        assert!(found.failed() && (found.value - (0.2 - 0.095)).abs() < 1e-6, "{found:?}");
        assert!(found.note.contains("occupied cells at "), "{found:?}");
    }

    /// A plan that brakes with some deceleration from 5 s on, claimed and on a level.
    fn braking(value: f64, claimed: f64, level: Level) -> Story {
        let mut s = Story::clean();
        let (lasts, length) = (8.0 / value, 32.0 / value);
        let knots =
            vec![knot(0.0, 0.0, 8.0, 0.0), knot(5.0, 40.0, 8.0, -value), knot(5.0 + lasts, 40.0 + length, 0.0, 0.0)];
        let plan = &mut s.cycles[10].plan;
        plan.trajectory.profile = SpeedProfile::new(knots).unwrap();
        (plan.level, plan.deceleration) = (level, claimed);
        s
    }

    #[test]
    fn a_plan_brakes_no_harder_than_it_claims_and_its_level_permits() {
        use Level::{Comfort, Emergency, NoMargin};
        for (value, claimed, level, excess) in [
            (2.0, 2.0, Comfort, 0.0),
            (2.0, 2.2, Comfort, 0.0),
            (2.0, 1.5, Comfort, 0.5),
            (3.0, 3.0, Comfort, 0.8),
            (3.0, 3.0, NoMargin, 0.8),
            (3.0, 3.0, Emergency(0), 0.0),
            (4.5, 4.5, Emergency(0), 0.5),
            (4.5, 4.5, Emergency(2), 0.0),
            (4.5, 3.0, Emergency(2), 1.5),
            (2.0, 2.0, Emergency(9), 2.0),
        ] {
            let found = deceleration(&braking(value, claimed, level));
            assert!((found.value - excess).abs() < 1e-9, "{value} {claimed} {level:?}: {found:?}");
            assert_eq!(found.failed(), excess > 0.0, "{found:?}");
        }
        let note = "1 of 3 plans fail, worst: the plan of cycle 10 at 1.00 s (level comfort) brakes at 3.00 m/s² at 5.00 s, of 2.20 m/s²";
        assert_eq!(deceleration(&braking(3.0, 3.0, Comfort)).note, note);
    }

    #[test]
    fn emergency_levels_are_bounded_by_the_road() {
        let s = braking(3.0, 3.0, Level::Emergency(2));
        let on = |friction: f64| {
            let planned_for = PlannedFor { settings: &s.planner, friction };
            check(&s.scenario, &s.vehicle, &s.cycles, planned_for, &s.settings)[1].clone()
        };
        assert!(on(1.0).passed());
        let icy = ProofLimits::new(&s.vehicle, 0.2).deceleration();
        assert!((on(0.2).value - (3.0 - icy)).abs() < 1e-9, "{icy} {:?}", on(0.2));
    }

    #[test]
    fn braking_that_the_lead_continues_has_to_decrease() {
        let lag = Story::clean().vehicle.actuators.brake_lag;
        // a deceleration during the lead, then 3 m/s², released at a rate, m/s³
        let released = |rate: f64, lead: f64| {
            let mut s = Story::clean();
            let first = SpeedKnot { acceleration: -lead, ..knot(0.0, 0.0, 8.0, 0.0) };
            let second = SpeedKnot { acceleration: -3.0, jerk: rate, ..first.after(lag) };
            let third = SpeedKnot { acceleration: -1.0, jerk: 0.0, ..second.after((3.0 - 1.0) / rate) };
            let fourth = SpeedKnot { speed: 0.0, acceleration: 0.0, ..third.after(third.speed) };
            s.cycles.truncate(1);
            s.cycles[0].plan.trajectory.profile = SpeedProfile::new(vec![first, second, third, fourth]).unwrap();
            deceleration(&s)
        };
        assert!(released(1.6, 3.0).passed(), "{:?}", released(1.6, 3.0));
        let slow = released(1.0, 3.0);
        assert!(slow.failed(), "{slow:?}");
        let step = released(1.6, 0.0);
        assert!(step.failed() && (step.value - 1.5).abs() < 1e-6, "a step after the lead is not imposed: {step:?}");
    }

    #[test]
    fn plans_without_a_proof_claim_nothing_and_a_kept_plan_counts_once() {
        let mut s = passing(Site::here(), 0.1);
        assert_eq!(claims(&s.cycles).len(), 1);
        s.cycles[..20].iter_mut().for_each(|c| c.plan.level = Level::NoMargin);
        assert_eq!(claims(&s.cycles).len(), 2, "it claims more than before");
        for c in &mut s.cycles {
            c.plan.level = Level::Unproven;
        }
        assert!(claims(&s.cycles).is_empty());
        for check in checks(&s) {
            assert_eq!(check.note, "not applicable: no planning cycle claims a proof");
        }
        let mut s = passing(Site::here(), 0.1);
        s.cycles.iter_mut().for_each(|c| c.plan.decision = Decision::Unproven);
        assert!(claims(&s.cycles).is_empty());
    }

    #[test]
    fn the_widened_footprint_is_that_of_the_margins() {
        let v = Story::clean().vehicle;
        let wide = widened(&v, Vector::new(0.3, 0.2));
        assert!(
            (wide.footprint.length() - v.length - 0.6).abs() < 1e-9
                && (wide.footprint.width() - v.width - 0.4).abs() < 1e-9
        );
        assert_eq!(wide.footprint.parts()[0].len(), 4);
    }
}
