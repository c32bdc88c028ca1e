//! `fallback_stops`: every committed plan stops as it claims when it is followed without replanning.
//!
//! Every committed trajectory claims to end at standstill. A run tests that claim once, at its end. Here it is tested in
//! between: a branch copies the simulation at one moment and follows the trajectory committed at that moment to its end. The
//! loop ([`crate::drive`]) makes the branches, with the tyres, actuators, faults and obstacles of the run. Obstacles move in a
//! branch as in the run, as recorded or predicted; they do not react to the vehicle.
//!
//! A fallback passes if
//! - its trajectory ends at standstill and begins within [`FARTHEST_START`] of the vehicle, and the vehicle stops,
//! - neither the simulation nor the geometry of the verdict finds a contact, until it stops and for
//!   [`FallbackSettings::hold`] after,
//! - it stops at most [`Settings::stop_past`] beyond the planned stop and [`Settings::stop_short`] before it,
//! - it brakes no harder than its plan claims (filtered as for comfort, with [`Settings::comfort_margin`]). Braking that the
//!   plan before or the vehicle imposes at the start is allowed for [`HANDOVER`](super::imposed::HANDOVER); then it has to
//!   decrease by [`RELEASE`](super::imposed::RELEASE) or faster,
//! - it leaves the road by at most the tolerance more than at the start.
//!
//! The claimed deceleration comes from the planner's record, because the claim is what is tested. Everything else comes from
//! the simulation, the scenario and the trajectory.
//!
//! Weak where: a contact between two samples is seen by the simulation only; a fallback that is never sampled is not tested;
//! the excursion from the road is measured every [`ROAD_SPACING`] of path.
//!
//! [`FallbackSettings::hold`]: super::FallbackSettings::hold

use std::cmp::Ordering;

use super::cause::Impact;
use super::comfort::FilteredMotion;
use super::contact::{self, Place};
use super::imposed::{Imposed, raised};
use super::road::Road;
use super::{Check, FallbackSettings, Settings, Status, cells};
use crate::geometry::Pose;
use crate::map::{Motion, Scenario};
use crate::number::Short;
use crate::simulation::Log;
use crate::trajectory::Trajectory;
use crate::vehicle::Vehicle;

/// Farthest that a fallback may begin from the vehicle, m.
const FARTHEST_START: f64 = 1.5;
/// Time between two looks at a stopped vehicle, s.
const WATCH: f64 = 0.02;
/// Distance between two looks at the road, m.
const ROAD_SPACING: f64 = 0.5;

/// A branch of the simulation: from one moment of the run it follows the committed plan without replanning.
#[derive(Debug, Clone, Copy)]
pub struct FallbackBranch<'a> {
    /// Number of the planning cycle, from 0.
    pub cycle: usize,
    /// Whether the plan changed in that cycle; if not, the branch is a regular sample.
    pub is_change: bool,
    /// The trajectory committed in that cycle.
    pub trajectory: &'a Trajectory,
    /// Largest deceleration that the plan and its proof claim, m/s².
    pub promised: f64,
    /// Deceleration of the plan before at the time of the cycle, m/s²; negative if it accelerated.
    pub inherited: f64,
    /// The log of the branch, from the cycle to standstill.
    pub log: &'a Log,
}

/// The result of a fallback branch.
#[derive(Debug, Clone, PartialEq)]
pub struct Fallback {
    /// Number of the planning cycle, from 0.
    pub cycle: usize,
    /// Time of the cycle, s of the run.
    pub time: f64,
    /// Whether the plan changed in that cycle.
    pub is_change: bool,
    /// Distance to the planned stop, m.
    pub planned_distance: f64,
    /// Largest deceleration that the plan and its proof claim, m/s².
    pub promised: f64,
    /// Signed distance of the final position from the planned stop, m, positive beyond it; `None` if it did not stop.
    pub stop_error: Option<f64>,
    /// The event nearest to its limit, or the gravest beyond its limit.
    worst: Finding,
}

impl Fallback {
    /// Whether it stopped as its plan claims.
    #[must_use]
    pub fn passes(&self) -> bool {
        self.worst.passes
    }

    /// How it broke its proof, as a stable code; `None` if it did not.
    #[must_use]
    pub fn failure(&self) -> Option<&'static str> {
        (!self.worst.passes).then_some(match self.worst.kind {
            Kind::Numbers => "numbers",
            Kind::Contact => "contact",
            Kind::Standstill => "standstill",
            Kind::Beyond => "beyond",
            Kind::Road => "road",
            Kind::Short => "short",
            Kind::Braking => "braking",
            Kind::Start => "start",
        })
    }

    /// The event nearest to its limit, or farthest beyond it, in words.
    #[must_use]
    pub fn event(&self) -> &str {
        &self.worst.what
    }

    /// Who ran into whom, if its event is a contact.
    #[must_use]
    pub fn impact(&self) -> Option<&Impact> {
        self.worst.impact.as_ref()
    }

    /// Whether its event is graver than that of another fallback.
    #[must_use]
    pub fn is_graver_than(&self, other: &Self) -> bool {
        self.worst.compared(&other.worst).is_gt()
    }
}

/// Kinds of events in a fallback, gravest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Numbers,
    Contact,
    Standstill,
    /// A stop beyond the planned one.
    Beyond,
    Road,
    /// A stop before the planned one: no danger, but not the plan.
    Short,
    Braking,
    Start,
}

/// One measured event.
#[derive(Debug, Clone, PartialEq)]
struct Finding {
    kind: Kind,
    passes: bool,
    value: f64,
    limit: f64,
    unit: &'static str,
    /// Time of the run, s.
    at: f64,
    /// The event in words, without its time.
    what: String,
    /// Who ran into whom, if it is a contact.
    impact: Option<Impact>,
}

impl Finding {
    fn new(kind: Kind, value: f64, limit: f64, unit: &'static str, at: f64, what: String) -> Self {
        Self { kind, passes: value <= limit, value, limit, unit, at, what, impact: None }
    }

    /// Which of two is worse: a failure before a pass, then the graver failure, then the one that uses more of its limit.
    fn compared(&self, other: &Self) -> Ordering {
        let share = |f: &Self| if f.value > 0.0 { f.value / f.limit } else { 0.0 };
        let graver = if self.passes { Ordering::Equal } else { other.kind.cmp(&self.kind) };
        other.passes.cmp(&self.passes).then(graver).then(share(self).total_cmp(&share(other)))
    }
}

/// Judges the branches of one run.
pub struct FallbackJudge<'a> {
    scenario: &'a Scenario,
    vehicle: &'a Vehicle,
    settings: Settings,
    road: Road,
    /// The end of the last known motion, s.
    last_motion: f64,
}

impl<'a> FallbackJudge<'a> {
    /// A judge for a scenario and a vehicle.
    #[must_use]
    pub fn new(scenario: &'a Scenario, vehicle: &'a Vehicle, settings: &Settings) -> Self {
        let moving = scenario.obstacles.iter().filter(|o| !matches!(o.motion, Motion::Static(_)));
        let last_motion = moving.map(|o| o.lifetime().1).fold(f64::NEG_INFINITY, f64::max);
        Self { scenario, vehicle, settings: *settings, road: Road::new(&scenario.network), last_motion }
    }

    /// Judges one branch.
    #[must_use]
    pub fn assess(&self, branch: &FallbackBranch<'_>) -> Fallback {
        let settings = &self.settings;
        let time = branch.log.samples.first().map_or(branch.trajectory.start_time, |s| s.time);
        let stop = stop_error(branch, settings);
        let findings = [ends_at_standstill(branch, settings, time), self.touches(branch), self.leaves_road(branch)]
            .into_iter()
            .chain(broken_numbers(branch, time))
            .chain(brakes(branch, self.vehicle, settings))
            .chain(stop.map(|(error, at)| stops(error, at, settings)));
        let worst = findings.fold(begins(branch, time), |a, b| if b.compared(&a).is_gt() { b } else { a });
        Fallback {
            cycle: branch.cycle,
            time,
            is_change: branch.is_change,
            planned_distance: branch.trajectory.profile.last().station - branch.trajectory.at(time).station,
            promised: branch.promised,
            stop_error: stop.map(|(error, _)| error),
            worst,
        }
    }

    /// Contact while driving, by the simulation and by geometry, and at standstill by geometry alone.
    fn touches(&self, branch: &FallbackBranch<'_>) -> Finding {
        let tolerance = self.settings.contact_tolerance;
        let places = self.watched(branch.log);
        let obstacle = contact::nearest_obstacle(&self.scenario.obstacles, self.vehicle, &places);
        // cells do not move: a stopped vehicle needs no further look
        let cell = cells::nearest(self.scenario, self.vehicle, &contact::places(branch.log));
        let nearest = obstacle.into_iter().chain(cell).reduce(|a, b| if b.gap < a.gap { b } else { a });
        let start = branch.log.samples.first().map_or(0.0, |s| s.time);
        let depth = nearest.map_or(0.0, |n| n.depth());
        let overlap = nearest.filter(|n| n.depth() > tolerance);
        let (scenario, vehicle, reported) = (self.scenario, self.vehicle, branch.log.contact);
        let impact = contact::impact(scenario, vehicle, &places, (reported, overlap), &self.settings);
        let (at, what) = match (reported, impact, nearest) {
            (Some(contact), Some(impact), _) => (contact.time, impact.to_string()),
            (None, Some(impact), _) => (impact.time, format!("{impact} and overlapped it by {:.3} m", Short(depth))),
            (.., Some(n)) => (n.time, format!("overlapped {} by {:.3} m", n.thing, Short(depth))),
            (.., None) => (start, "no contact".into()),
        };
        let finding = Finding::new(Kind::Contact, depth, tolerance, "m", at, what);
        Finding { passes: finding.passes && reported.is_none(), impact, ..finding }
    }

    /// The places of a branch, and its final standstill for as long as anything still moves.
    fn watched(&self, log: &Log) -> Vec<Place> {
        let mut places = contact::places(log);
        let stopped = |s: &&Place| log.contact.is_none() && s.speed.abs() <= self.settings.standstill_speed;
        if let Some(last) = places.last().filter(stopped).copied() {
            let until = self.last_motion.min(last.time + self.settings.fallbacks.hold);
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most 600 s / 0.02 s; negative is 0
            let looks = ((until - last.time) / WATCH) as usize;
            places.extend((1..=looks).map(|i| Place { time: last.time + i as f64 * WATCH, ..last }));
        }
        places
    }

    fn leaves_road(&self, branch: &FallbackBranch<'_>) -> Finding {
        let excursion = |pose: &Pose| self.road.excursion(self.vehicle, pose).depth;
        let (mut at_start, mut worst, mut last) = (0.0, (0.0, 0.0), None::<Pose>);
        for sample in &branch.log.samples {
            if last.is_some_and(|l| (sample.pose.position - l.position).norm() < ROAD_SPACING) {
                continue;
            }
            let here = excursion(&sample.pose);
            if last.replace(sample.pose).is_none() {
                (at_start, worst) = (here, (here, sample.time));
            }
            if here > worst.0 {
                worst = (here, sample.time);
            }
        }
        // a start off the road is imposed, as on the road the tolerance is for what is added to it
        let limit = at_start + self.settings.road_tolerance;
        Finding::new(Kind::Road, worst.0, limit, "m", worst.1, format!("left the road by {:.2} m", Short(worst.0)))
    }
}

fn begins(branch: &FallbackBranch<'_>, time: f64) -> Finding {
    let first = branch.log.samples.first();
    let planned = branch.trajectory.at(time).pose;
    let apart = first.map_or(f64::INFINITY, |s| (s.pose.position - planned.position).norm());
    let what = format!("began {:.2} m from the vehicle", Short(apart));
    Finding::new(Kind::Start, apart, FARTHEST_START, "m", time, what)
}

/// The plan has to end at standstill, and so has the vehicle.
fn ends_at_standstill(branch: &FallbackBranch<'_>, settings: &Settings, time: f64) -> Finding {
    let planned = branch.trajectory.profile.last().speed;
    let (speed, at) = branch.log.samples.last().map_or((0.0, time), |s| (s.speed.abs(), s.time));
    let (speed, what) = if planned > settings.standstill_speed {
        (planned, format!("the committed trajectory ends at {planned:.2} m/s"))
    } else {
        (speed, format!("moved at {:.3} m/s after the planned stop", Short(speed)))
    };
    // a contact ends the branch and is graver
    let limit = if branch.log.contact.is_some() { f64::INFINITY } else { settings.standstill_speed };
    Finding::new(Kind::Standstill, speed, limit, "m/s", at, what)
}

fn broken_numbers(branch: &FallbackBranch<'_>, time: f64) -> Option<Finding> {
    let (at, what) = match (branch.log.broke_at, branch.log.samples.is_empty()) {
        (Some(at), _) => (at, "the simulation produced a number that is not finite"),
        (None, true) => (time, "the log of the branch is empty"),
        (None, false) => return None,
    };
    Some(Finding::new(Kind::Numbers, 1.0, 0.0, "samples", at, what.into()))
}

/// The deceleration that uses most of its limit; `None` if the branch is too short to filter.
fn brakes(branch: &FallbackBranch<'_>, vehicle: &Vehicle, settings: &Settings) -> Option<Finding> {
    let filtered = FilteredMotion::new(branch.log, settings.comfort_cutoff);
    let inherited = Imposed::longitudinal(vehicle, branch.log).with_deceleration(branch.inherited);
    let margin = settings.comfort_margin;
    let limit = |time: f64| raised((1.0 + margin) * branch.promised, inherited.allows(-1.0, time), margin);
    let (_, worst) = filtered.worst(|m| -m.acceleration / limit(m.time))?;
    let value = (-worst.acceleration).max(0.0);
    let what = format!("braked at {:.2} m/s²", Short(value));
    Some(Finding::new(Kind::Braking, value, limit(worst.time), "m/s²", worst.time, what))
}

/// Signed distance of the final position from the planned stop along its heading, m, with the time of stopping, s.
fn stop_error(branch: &FallbackBranch<'_>, settings: &Settings) -> Option<(f64, f64)> {
    if branch.log.contact.is_some() || !branch.trajectory.profile.ends_at_standstill() {
        return None;
    }
    let samples = &branch.log.samples;
    let last = samples.last().filter(|s| s.speed.abs() <= settings.standstill_speed)?;
    let planned = branch.trajectory.path.at(branch.trajectory.profile.last().station).pose;
    let at = samples.iter().rfind(|s| s.speed.abs() > settings.standstill_speed).map_or(last.time, |s| s.time);
    Some((planned.to_local(last.pose.position).x, at))
}

fn stops(error: f64, at: f64, settings: &Settings) -> Finding {
    let (kind, limit, side) = if error > 0.0 {
        (Kind::Beyond, settings.stop_past, "beyond")
    } else {
        (Kind::Short, settings.stop_short, "before")
    };
    let what = format!("stopped {:.2} m {side} the planned stop", Short(error.abs()));
    Finding::new(kind, error.abs(), limit, "m", at, what)
}

const NAME: &str = "fallback_stops";

/// The check over all fallbacks of a run. `left_out` counts the changes of the plan that were not sampled. The check does not
/// apply if the settings turn it off or if no branch was simulated.
#[must_use]
pub fn fallback_stops(fallbacks: &[Fallback], left_out: usize, settings: &FallbackSettings) -> Check {
    if !settings.enabled {
        return Check::not_applicable(NAME, "", "the settings turn fallback branches off");
    }
    let Some(worst) = fallbacks.iter().reduce(|a, b| if b.worst.compared(&a.worst).is_gt() { b } else { a }) else {
        return Check::not_applicable(NAME, "", "no planning cycle had a proven plan");
    };
    let all = fallbacks.len();
    let failed = fallbacks.iter().filter(|f| !f.passes()).count();
    let changes = fallbacks.iter().filter(|f| f.is_change).count();
    let Finding { value, limit, unit, at, what, impact, .. } = &worst.worst;
    let count = if failed == 0 {
        format!("all {all} passed, nearest to its limit")
    } else {
        format!("{failed} of {all} failed, worst")
    };
    let plan = format!(
        "fallback stop at {:.1} m with at most {:.1} m/s², from cycle {} at {:.2} s",
        worst.planned_distance, worst.promised, worst.cycle, worst.time
    );
    Check {
        name: NAME,
        status: Status::of(failed == 0),
        value: *value,
        limit: *limit,
        unit,
        at_time: Some(*at),
        impact: *impact,
        note: format!("{count}: {what} at {at:.2} s; limit {limit:.2} {unit} ({plan})"),
        method: format!(
            "{all} branches of the simulation follow the committed plan to standstill: {} at regular times, {changes} \
             where the plan changed; {left_out} changes not sampled",
            all - changes
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Cause;
    use super::super::testing::Story;
    use super::*;
    use crate::geometry::Point;
    use crate::simulation::{Contact, Touched};
    use crate::trajectory::SpeedProfile;

    /// The clean run as a branch: it brakes at 2 m/s² at most and stops at x = 82 m at 13 s.
    fn assessed(s: &Story, promised: f64, inherited: f64) -> Fallback {
        let trajectory = &s.cycles[0].plan.trajectory;
        let branch = FallbackBranch { cycle: 3, is_change: false, trajectory, promised, inherited, log: &s.log };
        FallbackJudge::new(&s.scenario, &s.vehicle, &s.settings).assess(&branch)
    }

    fn kind(s: &Story) -> Option<Kind> {
        let fallback = assessed(s, 2.2, 0.0);
        (!fallback.passes()).then_some(fallback.worst.kind)
    }

    #[test]
    fn the_clean_run_passes_as_a_fallback() {
        let found = assessed(&Story::clean(), 2.2, 0.0);
        assert!(found.passes(), "{found:?}");
        assert!((found.planned_distance - 72.0).abs() < 1e-9 && found.stop_error.unwrap().abs() < 1e-6, "{found:?}");
        let check = fallback_stops(&[found], 0, &FallbackSettings::default());
        assert!(check.passed() && check.unit == "m/s²" && (check.value - 2.0).abs() < 0.01, "{check:?}");
        let plan = "(fallback stop at 72.0 m with at most 2.2 m/s², from cycle 3 at 0.00 s)";
        assert!(check.note.starts_with("all 1 passed") && check.note.ends_with(plan), "{check:?}");
    }

    #[test]
    fn the_check_does_not_apply_without_branches() {
        let settings = FallbackSettings::default();
        let none = fallback_stops(&[], 4, &settings);
        assert_eq!(none.note, "not applicable: no planning cycle had a proven plan");
        let off = fallback_stops(&[], 0, &FallbackSettings { enabled: false, ..settings });
        assert_eq!(off.note, "not applicable: the settings turn fallback branches off");
        assert!([none, off].iter().all(|c| c.status == Status::NotApplicable));
    }

    /// The expected kind, the fault, and the function that introduces it.
    type Breakage = (Kind, &'static str, fn(&mut Story));

    #[test]
    fn each_fault_fails_with_its_kind() {
        let broken: [Breakage; 11] = [
            (Kind::Contact, "a parked car over the edge of the path", |s| {
                s.scenario.obstacles[0] = s.place.parked(100, 60.0, 1.69);
            }),
            (Kind::Contact, "a contact that only the simulation reports", |s| {
                let (with, at_rear_axle_frame) = (Touched::Obstacle(101), Point::new(3.6, 0.0));
                s.log.contact = Some(Contact { time: 3.0, with, at_rear_axle_frame, speed: 8.0 });
            }),
            (Kind::Contact, "a car that hits the vehicle three seconds after the end of the log", |s| {
                s.scenario.obstacles[1] = s.place.moving(101, (14.0, 18.0), (140.0, 0.0), (84.0, 0.0));
            }),
            (Kind::Standstill, "a plan that ends moving", |s| {
                let knots = s.cycles[0].plan.trajectory.profile.knots()[..2].to_vec();
                s.cycles[0].plan.trajectory.profile = SpeedProfile::new(knots).unwrap();
            }),
            (Kind::Standstill, "a vehicle that still moves", |s| s.log.samples.truncate(1100)),
            (Kind::Beyond, "a stop 0.15 m beyond the planned one", |s| {
                s.displace(|m| (0.15 * m.time.min(13.0) / 13.0, 0.0));
            }),
            (Kind::Short, "a stop 0.4 m before the planned one", |s| {
                s.displace(|m| (-0.4 * m.time.min(13.0) / 13.0, 0.0));
            }),
            (Kind::Road, "a hole in the road", |s| {
                let hole = s.place.lanelet(2, (71.0, 130.0), -1.75, 1.75);
                s.scenario.network.lanelets.insert(2, hole);
            }),
            (Kind::Braking, "2.8 m/s²", |s| {
                for m in &mut s.log.samples {
                    m.acceleration -= super::super::testing::bump(m.time, 1.0, 3.0, 2.8);
                }
            }),
            (Kind::Start, "a plan for another place", |s| {
                let x = 10.0 - s.vehicle.rear_axle_to_centre;
                // beside the path, so that the station of the stop is unchanged
                s.cycles[0].plan.trajectory.path = s.place.straight(x, 1.6, 72.0);
            }),
            (Kind::Numbers, "a number that is not finite", |s| s.log.broke_at = Some(3.0)),
        ];
        for (expected, what, break_it) in broken {
            let mut s = Story::clean();
            break_it(&mut s);
            assert_eq!(kind(&s), Some(expected), "{what}: {:?}", assessed(&s, 2.2, 0.0));
        }
    }

    #[test]
    fn standstill_is_watched_only_as_long_as_the_settings_say() {
        let mut s = Story::clean();
        s.scenario.obstacles[1] = s.place.moving(101, (14.0, 18.0), (140.0, 0.0), (84.0, 0.0));
        s.settings.fallbacks.hold = 1.0;
        assert_eq!(kind(&s), None);
    }

    #[test]
    fn inherited_braking_is_allowed_only_while_it_decreases() {
        let mut s = Story::clean();
        // 4 m/s² at the start, released at 1.8 m/s³
        for m in &mut s.log.samples {
            m.acceleration -= (4.0 - 1.8 * m.time).max(0.0);
        }
        assert!(assessed(&s, 2.2, 4.0).passes());
        // constant for 1.5 s
        let mut s = Story::clean();
        for m in s.log.samples.iter_mut().filter(|m| m.time < 1.5) {
            m.acceleration -= 4.0;
        }
        let found = assessed(&s, 2.2, 4.0);
        assert!(!found.passes() && found.worst.kind == Kind::Braking, "{found:?}");
    }

    #[test]
    fn braking_that_the_vehicle_has_at_the_start_is_allowed_and_a_step_of_the_plan_is_not() {
        let braking_from = |start: f64| {
            let mut s = Story::clean();
            for m in s.log.samples.iter_mut().filter(|m| m.time >= start) {
                m.acceleration -= (4.0 - 1.8 * m.time).max(0.0);
            }
            assessed(&s, 2.2, 0.0)
        };
        assert!(braking_from(0.0).passes(), "{:?}", braking_from(0.0));
        let step = braking_from(0.01);
        assert!(!step.passes() && step.worst.kind == Kind::Braking, "{step:?}");
    }

    #[test]
    fn a_vehicle_off_the_road_may_return_but_not_move_farther_off() {
        let mut s = Story::clean();
        s.displace(|m| (0.0, 1.5 * (1.0 - m.time / 5.0).max(0.0)));
        s.cycles[0].plan.trajectory.path = s.place.straight(10.0 - s.vehicle.rear_axle_to_centre, 0.5, 72.0);
        assert_eq!(kind(&s), None);
        s.displace(|m| (0.0, super::super::testing::bump(m.time, 0.5, 2.0, 1.0)));
        assert_eq!(kind(&s), Some(Kind::Road));
    }

    #[test]
    fn the_tolerance_of_the_road_is_for_what_is_added_to_a_start_off_it() {
        let farther = |added: f64| {
            let mut s = Story::clean();
            s.displace(|m| (0.0, 1.5 + super::super::testing::bump(m.time, 2.0, 2.0, added)));
            kind(&s)
        };
        assert_eq!((farther(0.0), farther(0.045), farther(0.055)), (None, None, Some(Kind::Road)));
    }

    #[test]
    fn a_failure_outweighs_a_pass_and_a_graver_failure_a_lesser_one() {
        let mut past = Story::clean();
        past.displace(|m| (0.15 * m.time.min(13.0) / 13.0, 0.0));
        let mut hit = Story::clean();
        hit.scenario.obstacles[0] = hit.place.parked(100, 60.0, 1.69);
        let all = [&Story::clean(), &past, &hit, &past].map(|s| assessed(s, 2.2, 0.0));
        let check = fallback_stops(&all, 2, &FallbackSettings::default());
        assert!(check.failed() && check.note.contains("worst: the vehicle ran into obstacle 100 "), "{check:?}");
        assert!(check.note.contains(" and overlapped it by 0.015 m at "), "{check:?}");
        assert_eq!(check.impact.map(|i| i.cause), Some(Cause::Vehicle));
        assert!(
            check.note.starts_with("3 of 4 failed") && check.method.ends_with("2 changes not sampled"),
            "{check:?}"
        );
        assert!((check.value - (0.805 - (1.69 - 0.9))).abs() < 1e-9);
    }
}
