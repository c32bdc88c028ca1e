//! `fallback_stops`: what the plans come to when nobody plans again.
//!
//! Every committed trajectory claims to be a way to rest. A run tests that claim once, at its end; here it is tested in
//! between: the world of a moment is forked, the trajectory committed at that moment is driven to its end, and the judge
//! looks at what that leads to. The fork is made by the loop ([`crate::drive`]), with the tyres, actuators, faults and
//! obstacles of the run; obstacles do in a fork what they did in the run, as recorded or predicted, whatever the vehicle does.
//!
//! A fallback holds when
//! - its trajectory ends at rest, begins within [`FARTHEST_START`] of the vehicle, and the vehicle comes to rest,
//! - neither the rig nor the judge's own geometry sees a contact, until it rests and for [`FallbackSettings::hold`] after,
//! - it rests at most [`Settings::stop_past`] beyond the planned stop and [`Settings::stop_short`] before it,
//! - it brakes no harder than its plan says it may (filtered as comfort is, with [`Settings::comfort_margin`]), or than the
//!   plan before it did, whose braking is to be released at [`RELEASE`] at least after [`HANDOVER`],
//! - it stays on the road, or goes no farther off it than the vehicle was.
//!
//! The limit of the deceleration is read from the planner's record: it is a promise, and a promise is what is judged.
//! Everything else comes from the rig, the scenario and the trajectory.
//!
//! Weak where: between samples nobody looks; a fallback that is never sampled is never judged. The excursion from the road is
//! measured every [`ROAD_SPACING`] of way.
//!
//! [`FallbackSettings::hold`]: super::FallbackSettings::hold

use std::cmp::Ordering;

use super::comfort::FilteredMotion;
use super::road::Road;
use super::{Check, Settings, Status, cells, contact};
use crate::geometry::Pose;
use crate::map::{Motion, Scenario};
use crate::simulation::{Log, Sample};
use crate::trajectory::Trajectory;
use crate::vehicle::Vehicle;

/// Farthest that a fallback may begin from where the vehicle is, m: a plan for another place is none.
const FARTHEST_START: f64 = 1.5;
/// How long the braking of the plan before may last in full, s: the lag of the brakes.
const HANDOVER: f64 = 0.1;
/// How fast it has to be released then, m/s³: a gentler release is filtered as brakes that stick.
const RELEASE: f64 = 1.5;
/// Time between two looks at a vehicle that rests, s.
const WATCH: f64 = 0.02;
/// Way between two looks at the road, m.
const ROAD_SPACING: f64 = 0.5;

/// A world that went its own way from a moment of the run: nobody planned in it.
#[derive(Debug, Clone, Copy)]
pub struct FallbackBranch<'a> {
    /// Number of the planning cycle, from 0.
    pub cycle: usize,
    /// Whether the plan had changed in that cycle; if not, it is a regular sample.
    pub is_change: bool,
    /// The trajectory committed in that cycle.
    pub trajectory: &'a Trajectory,
    /// Largest deceleration that the plan and its proof promise, m/s².
    pub promised: f64,
    /// Deceleration that the plan before wanted at the moment of the cycle, m/s²; negative if it accelerated.
    pub inherited: f64,
    /// What the rig measured, from the cycle to rest.
    pub log: &'a Log,
}

/// What a fallback came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Fallback {
    /// Number of the planning cycle, from 0.
    pub cycle: usize,
    /// Time of the cycle, s of the run.
    pub time: f64,
    /// Whether the plan had changed in that cycle.
    pub is_change: bool,
    /// Way to the planned stop, m.
    pub planned_distance: f64,
    /// Signed distance of the rest from the planned stop, m, positive beyond it; none without rest.
    pub stop_error: Option<f64>,
    /// What comes nearest to its limit, or is farthest beyond it.
    worst: Finding,
}

impl Fallback {
    /// Whether it came to rest as promised.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.worst.holds
    }
}

/// What can be wrong with a fallback, worst first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Numbers,
    Contact,
    Rest,
    Stop,
    Road,
    Braking,
    Start,
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq)]
struct Finding {
    kind: Kind,
    holds: bool,
    value: f64,
    limit: f64,
    unit: &'static str,
    /// Time of the run, s.
    at: f64,
    what: String,
}

impl Finding {
    fn new(kind: Kind, value: f64, limit: f64, unit: &'static str, at: f64, what: String) -> Self {
        Self { kind, holds: value <= limit, value, limit, unit, at, what }
    }

    /// Which of two is worse: a broken limit before a kept one, then the graver, then the one that uses more of its limit.
    fn compared(&self, other: &Self) -> Ordering {
        let share = |f: &Self| if f.value > 0.0 { f.value / f.limit } else { 0.0 };
        let graver = if self.holds { Ordering::Equal } else { other.kind.cmp(&self.kind) };
        other.holds.cmp(&self.holds).then(graver).then(share(self).total_cmp(&share(other)))
    }
}

/// Judges branches of one run. What they have in common is made once.
pub struct FallbackJudge<'a> {
    scenario: &'a Scenario,
    vehicle: &'a Vehicle,
    settings: Settings,
    road: Road,
    /// The end of the last motion that is known of, s.
    last_motion: f64,
}

impl<'a> FallbackJudge<'a> {
    /// A judge for a scenario and the vehicle in it.
    #[must_use]
    pub fn new(scenario: &'a Scenario, vehicle: &'a Vehicle, settings: &Settings) -> Self {
        let moving = scenario.obstacles.iter().filter(|o| !matches!(o.motion, Motion::Static(_)));
        let last_motion = moving.map(|o| o.lifetime().1).fold(f64::NEG_INFINITY, f64::max);
        Self { scenario, vehicle, settings: *settings, road: Road::new(&scenario.network), last_motion }
    }

    /// Judges one fork.
    #[must_use]
    pub fn assess(&self, fork: &FallbackBranch<'_>) -> Fallback {
        let settings = &self.settings;
        let time = fork.log.samples.first().map_or(fork.trajectory.start_time, |s| s.time);
        let stop = stop_error(fork, settings);
        let findings = [ends_at_standstill(fork, settings, time), self.touches(fork), self.leaves_road(fork)]
            .into_iter()
            .chain(broken_numbers(fork, time))
            .chain(brakes(fork, settings))
            .chain(stop.map(|(error, at)| stops(error, at, settings)));
        let worst = findings.fold(begins(fork, time), |a, b| if b.compared(&a).is_gt() { b } else { a });
        Fallback {
            cycle: fork.cycle,
            time,
            is_change: fork.is_change,
            planned_distance: fork.trajectory.profile.last().station - fork.trajectory.at(time).station,
            stop_error: stop.map(|(error, _)| error),
            worst,
        }
    }

    /// Contact on the way, by the rig and by the judge's geometry, and at rest by the latter alone.
    fn touches(&self, fork: &FallbackBranch<'_>) -> Finding {
        let tolerance = self.settings.contact_tolerance;
        let watched = Log { samples: self.watched(fork.log), ..Log::default() };
        let obstacle = contact::closest(self.scenario, self.vehicle, &watched)
            .map(|c| (c.gap, c.time, format!("obstacle {}", c.obstacle)));
        // cells stay where they are: nothing comes to a vehicle at rest
        let cell = cells::closest(self.scenario, self.vehicle, fork.log)
            .map(|c| (c.gap, c.time, format!("occupied cells around {c}")));
        let nearest = obstacle.into_iter().chain(cell).reduce(|a, b| if b.0 < a.0 { b } else { a });
        let start = fork.log.samples.first().map_or(0.0, |s| s.time);
        let (gap, at, with) = nearest.unwrap_or((f64::INFINITY, start, "nothing".into()));
        let depth = (-gap).max(0.0);
        let Some(c) = fork.log.contact else {
            let rests = fork.log.samples.last().is_some_and(|s| at > s.time);
            let what = format!("{} {with}", if rests { "at rest, overlaps" } else { "overlaps" });
            return Finding::new(Kind::Contact, depth, tolerance, "m", at, what);
        };
        let what = format!(
            "the rig reports a contact with {} at {:.2} m/s, struck at ({:.2}, {:.2}) m from the rear axle",
            c.with, c.speed, c.at_rear_axle_frame.x, c.at_rear_axle_frame.y
        );
        Finding { holds: false, ..Finding::new(Kind::Contact, depth, tolerance, "m", c.time, what) }
    }

    /// The samples of a fork, and those of its rest while something still moves.
    fn watched(&self, log: &Log) -> Vec<Sample> {
        let mut samples = log.samples.clone();
        let at_rest = |s: &&Sample| log.contact.is_none() && s.speed.abs() <= self.settings.standstill_speed;
        if let Some(last) = log.samples.last().filter(at_rest) {
            let until = self.last_motion.min(last.time + self.settings.fallbacks.hold);
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most 600 s / 0.02 s; negative is 0
            let looks = ((until - last.time) / WATCH) as usize;
            samples.extend((1..=looks).map(|i| Sample { time: last.time + i as f64 * WATCH, ..*last }));
        }
        samples
    }

    fn leaves_road(&self, fork: &FallbackBranch<'_>) -> Finding {
        let excursion = |pose: &Pose| self.road.excursion(self.vehicle, pose);
        let (mut at_start, mut worst, mut last) = (0.0, (0.0, 0.0), None::<Pose>);
        for sample in &fork.log.samples {
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
        let limit = self.settings.road_tolerance.max(at_start);
        Finding::new(Kind::Road, worst.0, limit, "m", worst.1, format!("{:.2} m off the road", worst.0))
    }
}

fn begins(fork: &FallbackBranch<'_>, time: f64) -> Finding {
    let first = fork.log.samples.first();
    let wanted = fork.trajectory.at(time).pose;
    let apart = first.map_or(f64::INFINITY, |s| (s.pose.position - wanted.position).norm());
    let what = format!("the fallback begins {apart:.2} m from the vehicle");
    Finding::new(Kind::Start, apart, FARTHEST_START, "m", time, what)
}

/// The plan has to end at rest, and the vehicle has to be there.
fn ends_at_standstill(fork: &FallbackBranch<'_>, settings: &Settings, time: f64) -> Finding {
    let planned = fork.trajectory.profile.last().speed;
    let (speed, at) = fork.log.samples.last().map_or((0.0, time), |s| (s.speed.abs(), s.time));
    let (speed, what) = if planned > settings.standstill_speed {
        (planned, format!("the committed trajectory ends at {planned:.2} m/s"))
    } else {
        (speed, format!("at {speed:.3} m/s when its planned stop was over"))
    };
    // a contact ends the fork, and is worse
    let limit = if fork.log.contact.is_some() { f64::INFINITY } else { settings.standstill_speed };
    Finding::new(Kind::Rest, speed, limit, "m/s", at, what)
}

fn broken_numbers(fork: &FallbackBranch<'_>, time: f64) -> Option<Finding> {
    let (at, what) = match (fork.log.broke_at, fork.log.samples.is_empty()) {
        (Some(at), _) => (at, "the physics produced a number that is not finite"),
        (None, true) => (time, "nothing was driven"),
        (None, false) => return None,
    };
    Some(Finding::new(Kind::Numbers, 1.0, 0.0, "samples", at, what.into()))
}

/// The deceleration that uses most of its limit. Too little was driven to filter: none.
fn brakes(fork: &FallbackBranch<'_>, settings: &Settings) -> Option<Finding> {
    let filtered = FilteredMotion::new(fork.log, settings.comfort_cutoff);
    let begun = *filtered.moments.first()?;
    let inherited = fork.inherited.max(-begun.acceleration);
    let limit = |time: f64| {
        let released = RELEASE * (time - begun.time - HANDOVER).max(0.0);
        (1.0 + settings.comfort_margin) * fork.promised.max(inherited - released)
    };
    let (_, worst) = filtered.worst(|m| -m.acceleration / limit(m.time))?;
    let what = format!("brakes at {:.2} m/s², promised are {:.2}", -worst.acceleration, fork.promised);
    let value = (-worst.acceleration).max(0.0);
    Some(Finding::new(Kind::Braking, value, limit(worst.time), "m/s²", worst.time, what))
}

/// Signed distance of the rest from the planned one along its heading, m, with the time of coming to rest.
fn stop_error(fork: &FallbackBranch<'_>, settings: &Settings) -> Option<(f64, f64)> {
    if fork.log.contact.is_some() || !fork.trajectory.profile.ends_at_standstill() {
        return None;
    }
    let last = fork.log.samples.last().filter(|s| s.speed.abs() <= settings.standstill_speed)?;
    let planned = fork.trajectory.path.at(fork.trajectory.profile.last().station).pose;
    let at = fork.log.samples.iter().rfind(|s| s.speed.abs() > settings.standstill_speed).map_or(last.time, |s| s.time);
    Some((planned.to_local(last.pose.position).x, at))
}

fn stops(error: f64, at: f64, settings: &Settings) -> Finding {
    let (limit, side) = if error > 0.0 { (settings.stop_past, "beyond") } else { (settings.stop_short, "before") };
    let what = format!("at rest {:.3} m {side} its planned stop", error.abs());
    Finding::new(Kind::Stop, error.abs(), limit, "m", at, what)
}

/// The check over all fallbacks; `None` when none was driven. `left_out` counts changes of the plan that were not sampled.
#[must_use]
pub fn fallback_stops(fallbacks: &[Fallback], left_out: usize) -> Option<Check> {
    let worst = fallbacks.iter().reduce(|a, b| if b.worst.compared(&a.worst).is_gt() { b } else { a })?;
    let failed = fallbacks.iter().filter(|f| !f.holds()).count();
    let changes = fallbacks.iter().filter(|f| f.is_change).count();
    let Finding { value, limit, unit, at, what, .. } = &worst.worst;
    let from = format!(
        "from cycle {} at {:.2} s, {:.1} m before its planned stop",
        worst.cycle, worst.time, worst.planned_distance
    );
    Some(Check {
        name: "fallback_stops",
        status: Status::of(failed == 0),
        value: *value,
        limit: *limit,
        unit,
        at_time: Some(*at),
        note: format!(
            "{} fallbacks driven to rest, {changes} of them where the plan changed, {left_out} changes not sampled; {failed} failed; \
             worst {from}: {what}",
            fallbacks.len()
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::super::testing::Story;
    use super::*;
    use crate::geometry::Point;
    use crate::simulation::{Contact, Touched};
    use crate::trajectory::SpeedProfile;

    /// The clean run as if it were a fork: it brakes at 2 m/s² at most and rests at x = 82 m from 13 s on.
    fn assessed(s: &Story, promised: f64, inherited: f64) -> Fallback {
        let trajectory = &s.cycles[0].committed;
        let fork = FallbackBranch { cycle: 3, is_change: false, trajectory, promised, inherited, log: &s.log };
        FallbackJudge::new(&s.scenario, &s.vehicle, &s.settings).assess(&fork)
    }

    fn kind(s: &Story) -> Option<Kind> {
        let found = assessed(s, 2.2, 0.0);
        (!found.holds()).then_some(found.worst.kind)
    }

    #[test]
    fn the_clean_run_is_a_fallback_that_holds() {
        let found = assessed(&Story::clean(), 2.2, 0.0);
        assert!(found.holds(), "{found:?}");
        assert!((found.planned_distance - 72.0).abs() < 1e-9 && found.stop_error.unwrap().abs() < 1e-6, "{found:?}");
        let check = fallback_stops(&[found], 0).unwrap();
        assert!(check.passed() && check.unit == "m/s²" && (check.value - 2.0).abs() < 0.01, "{check:?}");
        assert!(check.note.contains("from cycle 3 at 0.00 s"), "{check:?}");
        assert_eq!(fallback_stops(&[], 4), None);
    }

    /// What has to be found, what is broken, and how.
    type Breakage = (Kind, &'static str, fn(&mut Story));

    #[test]
    fn each_broken_fallback_is_found_for_what_is_broken() {
        let broken: [Breakage; 11] = [
            (Kind::Contact, "a parked car's edge in the way", |s| {
                s.scenario.obstacles[0] = s.place.parked(100, 60.0, 1.69);
            }),
            (Kind::Contact, "a contact that only the rig saw", |s| {
                let (with, at_rear_axle_frame) = (Touched::Obstacle(101), Point::new(3.6, 0.0));
                s.log.contact = Some(Contact { time: 3.0, with, at_rear_axle_frame, speed: 8.0 });
            }),
            (Kind::Contact, "a car that drives into the vehicle three seconds after the log's end", |s| {
                s.scenario.obstacles[1] = s.place.moving(101, (14.0, 18.0), (140.0, 0.0), (84.0, 0.0));
            }),
            (Kind::Rest, "a plan that ends moving", |s| {
                let knots = s.cycles[0].committed.profile.knots()[..2].to_vec();
                s.cycles[0].committed.profile = SpeedProfile::new(knots).unwrap();
            }),
            (Kind::Rest, "a vehicle that is still moving", |s| s.log.samples.truncate(1100)),
            (Kind::Stop, "a rest 0.15 m beyond the planned one", |s| {
                s.displace(|m| (0.15 * m.time.min(13.0) / 13.0, 0.0));
            }),
            (Kind::Stop, "a rest 0.4 m before the planned one", |s| {
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
                // beside, so that the stop is where it was along the way
                s.cycles[0].committed.path = s.place.straight(x, 1.6, 72.0);
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
    fn rest_is_watched_only_as_long_as_the_settings_say() {
        let mut s = Story::clean();
        s.scenario.obstacles[1] = s.place.moving(101, (14.0, 18.0), (140.0, 0.0), (84.0, 0.0));
        s.settings.fallbacks.hold = 1.0;
        assert_eq!(kind(&s), None);
    }

    #[test]
    fn inherited_braking_is_let_go_while_it_is_released_and_no_longer() {
        let mut s = Story::clean();
        // 4 m/s² at the start, released at 1.8 m/s³
        for m in &mut s.log.samples {
            m.acceleration -= (4.0 - 1.8 * m.time).max(0.0);
        }
        assert!(assessed(&s, 2.2, 4.0).holds());
        // held for 1.5 s
        let mut s = Story::clean();
        for m in s.log.samples.iter_mut().filter(|m| m.time < 1.5) {
            m.acceleration -= 4.0;
        }
        let found = assessed(&s, 2.2, 4.0);
        assert!(!found.holds() && found.worst.kind == Kind::Braking, "{found:?}");
    }

    #[test]
    fn a_vehicle_that_was_off_the_road_may_return_but_not_go_farther_off() {
        let mut s = Story::clean();
        s.displace(|m| (0.0, 1.5 * (1.0 - m.time / 5.0).max(0.0)));
        s.cycles[0].committed.path = s.place.straight(10.0 - s.vehicle.rear_axle_to_centre, 0.5, 72.0);
        assert_eq!(kind(&s), None);
        s.displace(|m| (0.0, super::super::testing::bump(m.time, 0.5, 2.0, 1.0)));
        assert_eq!(kind(&s), Some(Kind::Road));
    }

    #[test]
    fn a_promise_that_is_broken_outweighs_kept_ones_and_a_graver_one_a_lesser_one() {
        let mut past = Story::clean();
        past.displace(|m| (0.15 * m.time.min(13.0) / 13.0, 0.0));
        let mut hit = Story::clean();
        hit.scenario.obstacles[0] = hit.place.parked(100, 60.0, 1.69);
        let all = [&Story::clean(), &past, &hit, &past].map(|s| assessed(s, 2.2, 0.0));
        let check = fallback_stops(&all, 2).unwrap();
        assert!(check.failed() && check.note.contains("overlaps obstacle 100"), "{check:?}");
        assert!(check.note.contains("2 changes not sampled; 3 failed"), "{check:?}");
        assert!((check.value - (0.805 - (1.69 - 0.9))).abs() < 1e-9);
    }
}
