//! The verdict on a run: named checks, computed from the log and the scenario.
//!
//! The verdict must be able to contradict the planner, so it shares no code with it. Its geometry (`shapes`) is slow and
//! simple: dense sampling, the separating-axis theorem and the winding number; the planner uses swept footprints and
//! bounding-volume trees. Planning records are read only for questions about plans: whether a stop was proven
//! (`stop_proven`), what a plan claims (`claims_margin`, `claims_deceleration`, `fallback_stops`), where a stop was planned
//! (`stops`) and how often the plan changed ([`Metrics`]).
//!
//! | Check | Value | Passes if |
//! |---|---|---|
//! | `simulation` | samples with a number that is not finite | = 0, and the log is not empty |
//! | `no_contact` | deepest overlap with an obstacle or an occupied cell, m | ≤ [`Settings::contact_tolerance`], and the simulation reports no contact |
//! | `stays_on_road` | largest excursion of the footprint, m | ≤ [`Settings::road_tolerance`] |
//! | `stops` | distance from the planned stop, m | ≤ [`Settings::stop_short`] before it, [`Settings::stop_past`] beyond it |
//! | `stop_proven` | share of cycles with a proven stop | = 1 |
//! | `claims_margin` | largest depth of anything static inside the margins of a plan with a proof, m | ≤ 0.02 m, and every such plan is drivable |
//! | `claims_deceleration` | largest deceleration of such a plan beyond what it claims and its level permits, m/s² | ≤ 0.05 m/s² |
//! | `fallback_stops` | the worst event in the fallback branches | see [`fallback_stops`] |
//! | `comfort_longitudinal`, `comfort_lateral`, `comfort_jerk`, `comfort_lateral_jerk` | filtered extreme | ≤ the limit of the [`ComfortPreset`] |
//! | `tracking` | lateral distance from the reference pose, m | ≤ that of the vehicle's tracking tube, or [`Settings::tracking`] |
//! | `goal` | goal conditions not met at the best time step | = 0 |
//! | `stop_needed` | free distance ahead of the final standstill, m | ≤ 10 m |
//!
//! A check passes if its value is at most its limit; `stop_proven`, a share, has to reach its limit. Every check is listed in
//! every verdict, in the order of [`CHECKS`]. A check that does not apply says why in its note.
//!
//! **Goal or stop.** A run that neither reached its goal nor had something in its way fails. A run that stopped safely
//! ([`Expectation::Stop`]) is excused from `goal` only if an obstacle or an occupied cell stood in its way, and the goal neither
//! lies behind the start, nor was driven past, nor could be entered before the obstacle. The end of the road is no excuse. `stop_needed` asks whether there was any reason to stop. Every other run is asked for its goal. `stops`
//! also applies to a run asked for its goal if it ended at standstill where its plan stops, or should have.
//!
//! Weak where: a contact between two samples (10 ms) with a thing thinner than the distance driven between them is seen by
//! the simulation only, and has an unknown cause; obstacles in the way are looked for along the present lane only, straight
//! ahead where the vehicle is not aligned with one.

mod cause;
mod cells;
mod check;
mod claims;
mod comfort;
mod contact;
mod fallback;
mod filter;
mod goal;
mod imposed;
mod lanes;
mod metrics;
mod presets;
mod road;
mod settings;
mod shapes;
mod stop_needed;
mod stops;
#[cfg(test)]
mod testing;
mod tracking;

pub use cause::{Cause, Impact, Side};
pub use check::{Check, Status};
pub use claims::PlannedFor;
pub(crate) use comfort::jerk_limit;
pub use contact::Thing;
pub use fallback::{Fallback, FallbackBranch, FallbackJudge, fallback_stops};
pub use filter::zero_phase_low_pass;
pub use goal::{GoalWatch, goal_reached_at};
pub use metrics::{Metrics, metrics};
pub use presets::{ComfortLimits, ComfortPreset};
pub use settings::{FallbackSettings, Settings, SettingsError};

use crate::map::{PlanningProblem, Scenario};
use crate::planner::Cycle;
use crate::simulation::{Log, Sample};
use crate::vehicle::{State, Vehicle};

/// The names of all checks, in the order in which every verdict lists them.
pub const CHECKS: [&str; 15] = [
    "simulation",
    "no_contact",
    "stays_on_road",
    "stops",
    "stop_proven",
    "claims_margin",
    "claims_deceleration",
    "fallback_stops",
    "comfort_longitudinal",
    "comfort_lateral",
    "comfort_jerk",
    "comfort_lateral_jerk",
    "tracking",
    "goal",
    "stop_needed",
];

/// All checks of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Verdict {
    /// The checks, in the order of [`CHECKS`]; empty if nothing was driven.
    pub checks: Vec<Check>,
}

impl Verdict {
    /// Whether no check failed.
    #[must_use]
    pub fn pass(&self) -> bool {
        self.checks.iter().all(|c| !c.failed())
    }

    /// The first check that failed.
    pub fn first_failure(&self) -> Option<&Check> {
        self.failures().next()
    }

    /// Every check that failed.
    pub fn failures(&self) -> impl Iterator<Item = &Check> {
        self.checks.iter().filter(|c| c.failed())
    }

    /// Replaces the check of the same name. An empty verdict stays empty.
    pub fn replace(&mut self, check: Check) {
        if let Some(listed) = self.checks.iter_mut().find(|c| c.name == check.name) {
            *listed = check;
        }
    }
}

/// What a run is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Expectation {
    /// To reach the goal of its problem. For every outcome but a safe stop.
    #[default]
    Goal,
    /// To have stopped where its plan said, for a reason, and to have reached its goal unless something stood in its way. For
    /// the outcome `stopped_safely`.
    Stop,
}

/// Judges a run. `fallback_stops` is not applicable here; [`Verdict::replace`] adds it when the branches are simulated.
#[must_use]
pub fn judge(
    scenario: &Scenario,
    problem: &PlanningProblem,
    vehicle: &Vehicle,
    (cycles, planned_for): (&[Cycle], PlannedFor<'_>),
    log: &Log,
    settings: &Settings,
) -> Verdict {
    let simulation = simulation(log);
    if log.samples.is_empty() {
        let others = CHECKS[1..].iter().map(|name| Check::not_applicable(name, "", "the log is empty"));
        return Verdict { checks: std::iter::once(simulation).chain(others).collect() };
    }
    let ahead = match settings.expect {
        Expectation::Goal => None,
        Expectation::Stop => {
            let watch = GoalWatch::new(scenario, problem);
            stop_needed::free_road(scenario, vehicle, log, settings, |centre| watch.is_place_to_stop(centre))
        }
    };
    let mut checks = vec![
        simulation,
        contact::no_contact(scenario, vehicle, log, settings),
        road::stays_on_road(&scenario.network, vehicle, log, settings),
        stops::stops(cycles, log, settings),
        stops::stop_proven(cycles),
    ];
    checks.extend(claims::check(scenario, vehicle, cycles, planned_for, settings));
    checks.push(Check::not_applicable("fallback_stops", "", "no fallback branch was simulated"));
    checks.extend(comfort::comfort(vehicle, log, settings));
    checks.push(tracking::tracking(vehicle, log, settings));
    checks.push(goal::goal(scenario, problem, vehicle, log, ahead.as_ref()));
    checks.push(stop_needed::stop_needed(problem, ahead.as_ref(), settings));
    Verdict { checks }
}

/// Whether the vehicle overlaps an obstacle or an occupied cell in a state, by more than the tolerance (m).
pub(crate) fn overlaps(scenario: &Scenario, vehicle: &Vehicle, state: &State, tolerance: f64) -> bool {
    let place = contact::Place { time: state.time, pose: state.pose, speed: state.speed };
    contact::nearest(scenario, vehicle, &[place]).is_some_and(|n| n.depth() > tolerance)
}

/// The check `simulation`: a log without samples or with numbers that are not finite proves nothing, and the other checks
/// could miss a NaN.
fn simulation(log: &Log) -> Check {
    let first_bad = log.samples.iter().find(|s| !is_finite(s));
    let bad = log.samples.iter().filter(|s| !is_finite(s)).count();
    let all = log.samples.len();
    let fault = match (log.broke_at, first_bad) {
        (Some(t), _) => Some(format!("the simulation produced a number that is not finite at {t:.3} s")),
        (None, Some(s)) => {
            Some(format!("{bad} of {all} samples have a number that is not finite, the first at {:.3} s", s.time))
        }
        (None, None) if log.samples.is_empty() => Some("the log is empty".into()),
        (None, None) => None,
    };
    Check {
        name: "simulation",
        status: Status::of(fault.is_none()),
        value: if fault.is_some() { bad.max(1) as f64 } else { 0.0 },
        limit: 0.0,
        unit: "samples",
        at_time: log.broke_at.or(first_bad.map(|s| s.time)),
        impact: None,
        note: fault.unwrap_or_else(|| format!("all numbers of {all} samples are finite")),
        method: "samples of the log with a number that is not finite".into(),
    }
}

fn is_finite(s: &Sample) -> bool {
    [
        s.time,
        s.pose.position.x,
        s.pose.position.y,
        s.pose.yaw,
        s.speed,
        s.acceleration,
        s.lateral_acceleration,
        s.reference_pose.position.x,
        s.reference_pose.position.y,
        s.reference_pose.yaw,
    ]
    .iter()
    .all(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::testing::{Place, STOPPED_FROM, Story, bump};
    use super::*;
    use crate::geometry::{Point, Pose};
    use crate::map::{GoalPosition, Interval, Motion, ObstacleKind, Shape, TimedOccupancy};
    use crate::planner::Decision;
    use crate::simulation::{Contact, Touched};

    #[test]
    fn the_clean_run_passes_and_lists_every_check() {
        let verdict = Story::clean().judge();
        let names: Vec<_> = verdict.checks.iter().map(|c| c.name).collect();
        assert_eq!(names, CHECKS);
        assert!(verdict.pass(), "{:?}", verdict.first_failure());
        let not_applicable: Vec<_> =
            verdict.checks.iter().filter(|c| c.status == Status::NotApplicable).map(|c| c.name).collect();
        assert_eq!(not_applicable, ["fallback_stops", "comfort_lateral_jerk", "stop_needed"]);
        for c in &verdict.checks {
            if c.passed() {
                assert!(c.value <= c.limit || c.name == "stop_proven", "passes with a value beyond its limit: {c:?}");
                assert!(!c.note.is_empty() && !c.method.is_empty(), "{c:?}");
            } else {
                assert!(c.value.is_nan() && c.limit.is_nan() && c.at_time.is_none(), "{c:?}");
                assert!(c.note.starts_with("not applicable: "), "{c:?}");
            }
        }
    }

    /// The check that has to fail, the fault, and the function that introduces it.
    type Breakage = (&'static str, &'static str, fn(&mut Story));

    /// Faults, each in a clean run.
    fn broken_one_at_a_time() -> Vec<Breakage> {
        vec![
            ("no_contact", "a contact that only the simulation reports", |s| {
                let at_rear_axle_frame = Point::new(3.6, 0.0);
                s.log.contact =
                    Some(Contact { time: 3.0, with: Touched::Obstacle(101), at_rear_axle_frame, speed: 8.0 });
            }),
            ("no_contact", "a parked car over the edge of the path", |s| {
                s.scenario.obstacles[0] = s.place.parked(100, 60.0, 1.69);
            }),
            ("no_contact", "a car crossing at the wrong moment", |s| {
                // it crosses the lane at x = 34 m when the vehicle is there, after 3 s
                s.scenario.obstacles[1] = s.place.moving(101, (2.0, 4.0), (34.0, -10.0), (34.0, 10.0));
            }),
            ("no_contact", "the inside of a predicted set", |s| {
                let p = s.place;
                let corners = [(30.0, -9.0), (32.0, -9.0), (32.0, 0.0), (30.0, 0.0)];
                let region = Shape {
                    parts: vec![crate::map::Part::Polygon { vertices: corners.map(|(x, y)| p.point(x, y)).to_vec() }],
                };
                s.scenario.obstacles[1].motion = Motion::Occupancy(vec![TimedOccupancy { from: 2.0, to: 3.0, region }]);
            }),
            ("no_contact", "a round post that reaches into the path", |s| {
                let centre = s.place.point(40.0, -1.1);
                let part = crate::map::Part::Circle { centre: Point::origin(), radius: 0.3 };
                s.scenario.obstacles.push(crate::map::Obstacle {
                    id: 102,
                    kind: ObstacleKind::Structure,
                    shape: Shape { parts: vec![part] },
                    motion: Motion::Static(Pose { position: centre, yaw: 1.0 }),
                });
            }),
            ("stays_on_road", "a side over the left border", |s| s.displace(|_| (0.0, 1.0))),
            ("stays_on_road", "a side over the right border for a moment", |s| {
                s.displace(|m| (0.0, -bump(m.time, 2.0, 1.0, 1.05)));
            }),
            ("stays_on_road", "a hole in the road", |s| {
                let hole = s.place.lanelet(2, (71.0, 130.0), -1.75, 1.75);
                s.scenario.network.lanelets.insert(2, hole);
            }),
            ("stays_on_road", "a pavement beside a lane half as wide", |s| {
                s.scenario.network.lanelets.insert(2, s.place.lanelet(2, (70.0, 130.0), -1.75, 0.0));
                let mut pavement = s.place.lanelet(3, (70.0, 130.0), 0.0, 1.75);
                pavement.types = vec!["sidewalk".into()];
                s.scenario.network.lanelets.insert(3, pavement);
            }),
            ("stops", "a stop 0.15 m beyond the planned one", |s| {
                s.displace(|m| (0.15 * m.time.min(13.0) / 13.0, 0.0))
            }),
            ("stops", "a stop 0.4 m before the planned one", |s| s.displace(|m| (-0.4 * m.time.min(13.0) / 13.0, 0.0))),
            ("stop_proven", "one cycle without a plan", |s| s.cycles[70].plan.decision = Decision::Unproven),
            ("stop_proven", "one committed trajectory that ends moving", |s| {
                let committed = &mut s.cycles[70].plan.trajectory;
                let knots = committed.profile.knots()[..2].to_vec();
                committed.profile = crate::trajectory::SpeedProfile::new(knots).unwrap();
            }),
            ("stop_proven", "no cycle at all", |s| s.cycles.clear()),
            ("claims_margin", "a parked car within the margins of the plan", |s| {
                s.scenario.obstacles[0] = s.place.parked(100, 60.0, 1.82);
            }),
            ("claims_margin", "a lane that is too narrow for the tracking errors", |s| {
                s.scenario.network.lanelets.insert(2, s.place.lanelet(2, (70.0, 130.0), -0.82, 1.75));
            }),
            ("claims_deceleration", "plans that claim to brake at 0.5 m/s²", |s| {
                s.cycles.iter_mut().for_each(|c| c.plan.deceleration = 0.5);
            }),
            ("comfort_longitudinal", "an acceleration of 2 m/s²", |s| {
                for m in &mut s.log.samples {
                    m.acceleration += bump(m.time, 1.0, 3.0, 2.0);
                }
            }),
            ("comfort_longitudinal", "a deceleration of 2.8 m/s²", |s| {
                for m in &mut s.log.samples {
                    m.acceleration -= bump(m.time, 1.0, 3.0, 2.8);
                }
            }),
            ("comfort_lateral", "3.8 m/s² to the right", |s| {
                for m in &mut s.log.samples {
                    m.lateral_acceleration -= bump(m.time, 1.0, 3.0, 3.8) * s.place.side();
                }
            }),
            ("comfort_jerk", "an oscillation of 1.2 Hz within the acceleration limit", |s| {
                for m in &mut s.log.samples {
                    m.acceleration += bump(m.time, 0.5, 4.0, 1.2) * (7.5 * m.time).sin();
                }
            }),
            ("tracking", "0.3 m beside the reference pose for a moment", |s| {
                for m in &mut s.log.samples {
                    m.reference_pose.position += m.pose.left() * bump(m.time, 6.0, 1.0, 0.3) * s.place.side();
                }
            }),
            ("goal", "a goal 5 m farther ahead", |s| {
                let part =
                    crate::map::Part::Rectangle { centre: s.place.pose(88.1, 0.0, 0.0), length: 6.0, width: 3.5 };
                s.goal().position = Some(GoalPosition::Shapes(Shape { parts: vec![part] }));
            }),
            ("goal", "a goal that had to be reached earlier", |s| s.goal().time = Interval { min: 0.0, max: 10.0 }),
            ("goal", "a goal to be passed at speed", |s| s.goal().speed = Some(Interval { min: 5.0, max: 9.0 })),
            ("goal", "a goal of another heading", |s| s.goal().yaw = Some(Interval { min: 3.0, max: 3.1 })),
            ("goal", "a goal in a lanelet that is never entered", |s| {
                let aside = s.place.lanelet(7, (0.0, 130.0), 1.75, 5.25);
                s.scenario.network.lanelets.insert(7, aside);
                s.goal().position = Some(GoalPosition::Lanelets(vec![7, 4711]));
            }),
            ("simulation", "a number that no other check reads and that is not finite", |s| {
                s.log.samples[3].reference_pose.yaw = f64::NAN;
            }),
        ]
    }

    #[test]
    fn each_fault_fails_its_check_and_no_other() {
        for (name, what, break_it) in broken_one_at_a_time() {
            let mut story = Story::clean();
            break_it(&mut story);
            let failures = story.failures();
            // a NaN may fail further checks, which come later; what the plan ignores breaks its claims, too
            let is_claim = |f: &str| f.starts_with("claims_");
            let judged: Vec<&str> = match name {
                "simulation" => failures[..1].to_vec(),
                _ => failures.iter().copied().filter(|f| is_claim(name) || !is_claim(f)).collect(),
            };
            assert_eq!(judged, [name], "{what}: fails {failures:?}");
        }
    }

    #[test]
    fn the_verdict_is_the_same_far_away_turned_and_mirrored() {
        let here = Place::here();
        let far = Place { origin: Pose::new(6.9e5, 5.3e6, 2.2), mirrored: false };
        let mirrored = Place { origin: Pose::new(0.0, 0.0, 0.0), mirrored: true };
        let clean: Breakage = ("", "no fault", |_| ());
        for (_, what, break_it) in broken_one_at_a_time().into_iter().chain([clean]) {
            if what.contains("not finite") || what.contains("another heading") {
                continue; // NaN is unequal to NaN; that heading is absolute
            }
            let verdict_at = |place| {
                let mut story = Story::at(place);
                break_it(&mut story);
                story.judge()
            };
            let expected = verdict_at(here);
            for place in [far, mirrored] {
                let verdict = verdict_at(place);
                assert_eq!(verdict.checks.len(), expected.checks.len(), "{what}");
                for (a, b) in expected.checks.iter().zip(&verdict.checks) {
                    let is_close = (a.value - b.value).abs() < 1e-6 || a.value.is_nan() && b.value.is_nan();
                    let same = a.name == b.name && a.status == b.status && is_close;
                    assert!(same, "{what} at {place:?}:\n{a:?}\n{b:?}");
                }
            }
        }
    }

    #[test]
    fn values_are_those_of_the_closed_form() {
        let value = |name: &str, s: &Story| s.judge().checks.iter().find(|c| c.name == name).unwrap().clone();
        let mut s = Story::clean();
        s.displace(|_| (0.0, 1.0));
        assert!((value("stays_on_road", &s).value - (1.0 + 0.805 - 1.75)).abs() < 1e-9);

        let mut s = Story::clean();
        s.scenario.obstacles[0] = s.place.parked(100, 60.0, 1.69);
        assert!((value("no_contact", &s).value - (0.805 - (1.69 - 0.9))).abs() < 1e-9);

        let s = Story::clean();
        let braking = value("comfort_longitudinal", &s);
        assert!((braking.value - 2.0).abs() < 0.01, "the raised cosine's peak is 2 m/s²: {braking:?}");
        assert!((braking.at_time.unwrap() - 9.0).abs() < 0.02, "in its middle: {braking:?}");
        let jerk = value("comfort_jerk", &s);
        assert!((jerk.value - std::f64::consts::TAU / 8.0).abs() < 0.02, "{jerk:?}");
        // standstill is below 0.05 m/s: the last 0.79 s of the raised cosine
        let stopped = value("stops", &s).at_time.unwrap();
        assert!((stopped - (STOPPED_FROM - 0.79)).abs() < 0.02, "{stopped}");
    }

    #[test]
    fn an_oscillation_above_the_cutoff_passes() {
        let mut s = Story::clean();
        for (i, m) in s.log.samples.iter_mut().enumerate() {
            m.acceleration += if i % 2 == 0 { 5.0 } else { -5.0 };
        }
        assert_eq!(s.failures(), [""; 0]);
    }

    #[test]
    fn a_run_without_a_goal_is_judged_by_its_stop() {
        let mut s = Story::clean();
        s.problem().goals.clear();
        assert_eq!(s.failures(), [""; 0]);
        s.settings = Settings::expecting(Expectation::Stop);
        assert_eq!(s.failures(), [""; 0]);
        let status = |s: &Story, name: &str| s.judge().checks.iter().find(|c| c.name == name).unwrap().status;
        assert_eq!((status(&s, "stops"), status(&s, "goal")), (Status::Pass, Status::NotApplicable));
        s.log.samples.truncate(1000);
        assert_eq!(s.failures(), ["stops"], "still moving");
    }

    #[test]
    fn stops_applies_to_a_run_that_ends_moving_only_if_the_stop_is_overdue() {
        let mut s = Story::clean();
        s.goal().speed = None;
        s.goal().position = None;
        s.log.samples.truncate(1000);
        assert_eq!(s.failures(), [""; 0]);
        assert!(s.judge().checks.iter().any(|c| c.name == "stops" && c.status == Status::NotApplicable));

        let mut s = Story::clean();
        for m in s.log.samples.iter_mut().filter(|m| m.time > 8.0) {
            m.speed = m.speed.max(0.3);
        }
        assert_eq!(s.failures(), ["stops"], "the planned stop was 2 s ago");
    }

    #[test]
    fn a_plan_made_at_standstill_does_not_hide_the_stop_error() {
        let mut s = Story::clean();
        s.displace(|m| (0.2 * m.time.min(13.0) / 13.0, 0.0));
        for c in s.cycles.iter_mut().filter(|c| c.plan.time > 13.05) {
            // replanned from the measured pose
            let x = 82.2 - s.vehicle.rear_axle_to_centre;
            c.plan.trajectory.path = s.place.straight(x, 0.0, 0.005);
        }
        assert_eq!(s.failures(), ["stops"]);
    }

    #[test]
    fn a_post_between_the_parts_of_a_footprint_is_no_contact() {
        use crate::geometry::Point;
        use crate::vehicle::Footprint;
        const MARGIN: [&str; 1] = ["claims_margin"];
        const BOTH: [&str; 2] = ["no_contact", "claims_margin"];
        let prong = |right: f64, left: f64| {
            [(-0.8, right), (3.6, right), (3.6, left), (-0.8, left)].map(|(x, y)| Point::new(x, y)).to_vec()
        };
        let mut s = Story::clean();
        s.vehicle.footprint = Footprint::new(vec![prong(-0.8, -0.3), prong(0.3, 0.8)]).unwrap();
        let mut post = s.place.parked(7, 40.0, 0.0);
        for (y, failures) in
            [(0.0, &[][..]), (0.15, &MARGIN), (0.25, &BOTH), (-0.25, &BOTH), (-1.0, &MARGIN), (-1.2, &[])]
        {
            post.shape = crate::map::Shape::rectangle(0.2, 0.2);
            post.motion = crate::map::Motion::Static(s.place.pose(40.0, y, 0.0));
            let mut with_post = s.clone();
            with_post.scenario.obstacles.push(post.clone());
            assert_eq!(with_post.failures(), failures, "a post at {y}");
        }
        // a gap in the road between the prongs is no excursion, one under the left prong is
        let strips = |gap: (f64, f64)| {
            let mut s = s.clone();
            s.scenario.network.lanelets.clear();
            s.scenario.network.lanelets.insert(1, s.place.lanelet(1, (0.0, 130.0), -1.75, gap.0));
            s.scenario.network.lanelets.insert(2, s.place.lanelet(2, (0.0, 130.0), gap.1, 1.75));
            s.failures()
        };
        assert_eq!(strips((-0.15, 0.15)), [""; 0]);
        assert_eq!(strips((0.2, 0.5)), ["stays_on_road"]);
    }

    #[test]
    fn the_note_says_that_the_start_is_at_fault() {
        let mut s = Story::clean();
        s.displace(|_| (0.0, 1.0));
        let verdict = s.judge();
        assert!(verdict.first_failure().unwrap().note.contains("the start is 0.06 m off the road"), "{verdict:?}");

        let mut s = Story::clean();
        s.scenario.obstacles[0] = s.place.parked(100, 10.0, 0.0);
        let verdict = s.judge();
        assert!(
            verdict.first_failure().unwrap().note.contains("touched obstacle 100 at the start at 0.00 s"),
            "{verdict:?}"
        );
    }

    #[test]
    fn an_empty_or_broken_log_never_passes() {
        let mut s = Story::clean();
        s.log.broke_at = Some(2.0);
        assert_eq!(s.failures(), ["simulation"]);
        s.log = Log::default();
        assert_eq!(s.failures(), ["simulation"]);
        let mut s = Story::clean();
        s.log.samples.truncate(1);
        assert_eq!(s.failures(), ["goal"]);
    }

    #[test]
    fn a_long_run_among_many_obstacles_is_judged_within_half_a_second() {
        let mut s = Story::clean();
        let line = |y: f64| {
            let points = (0..200).map(|i| s.place.point(0.65 * f64::from(i), y));
            crate::geometry::polyline::Polyline::new(points).unwrap()
        };
        for k in 0..60 {
            let mut lanelet = s.place.lanelet(10 + k, (0.0, 130.0), -1.75, 1.75);
            (lanelet.right, lanelet.left) = (line(-1.75 + 0.1 * k as f64), line(1.75 + 0.1 * k as f64));
            s.scenario.network.lanelets.insert(10 + k, lanelet);
            if k < 30 {
                let y = 3.0 + 0.01 * k as f64;
                s.scenario.obstacles.push(s.place.moving(200 + k, (0.0, 15.0), (20.0, y), (90.0, y)));
            }
        }
        let start = std::time::Instant::now();
        assert_eq!(s.failures(), [""; 0]);
        let taken = start.elapsed().as_secs_f64();
        println!("1,501 samples, 32 obstacles, 62 lanelets of 400 points: {taken:.3} s");
        assert!(taken < 0.5, "{taken} s");
    }

    #[test]
    fn a_failure_names_the_event_with_its_time_and_limit() {
        let note = |break_it: fn(&mut Story)| {
            let mut s = Story::clean();
            break_it(&mut s);
            s.judge().first_failure().unwrap().note.clone()
        };
        let off_road = note(|s| s.displace(|m| (0.0, bump(m.time, 2.0, 1.0, 1.05))));
        // the left side is at 0.805 + 1.05 m where the road ends at 1.75 m; the front left corner is at x = 33.7 m
        assert!(off_road.starts_with("left the road by 0.10 m at 2.50 s at ("), "{off_road}");
        assert!(off_road.ends_with("1.9); limit 0.05 m"), "{off_road}");
        let touched = note(|s| {
            let at_rear_axle_frame = Point::new(3.6, 0.0);
            s.log.contact = Some(Contact { time: 3.0, with: Touched::Obstacle(101), at_rear_axle_frame, speed: 8.0 });
        });
        assert!(touched.starts_with("the vehicle touched obstacle 101 (cause unknown) at 3.00 s; "), "{touched}");
        assert!(touched.contains("; the vehicle drove at 8.0 m/s; point of contact (3.60, 0.00) m"), "{touched}");
        let stopped = note(|s| s.displace(|m| (-0.4 * m.time.min(13.0) / 13.0, 0.0)));
        assert!(stopped.starts_with("stopped 0.40 m before the planned stop at 12."), "{stopped}");
        assert!(stopped.ends_with("s; limit 0.30 m"), "{stopped}");
        let goal = note(|s| s.goal().yaw = Some(Interval { min: 3.0, max: 3.1 }));
        assert!(goal.starts_with("missed the goal: at best 1 condition unmet (heading) at "), "{goal}");
        let unproven = note(|s| s.cycles[70].plan.decision = Decision::Unproven);
        assert_eq!(unproven, "1 of 150 cycles committed to no proven stop, the first at 7.00 s");
        let aside = note(|s| {
            for m in &mut s.log.samples {
                m.reference_pose.position += m.pose.left() * bump(m.time, 6.0, 1.0, 0.3);
            }
        });
        assert_eq!(aside, "0.300 m to the right of the reference pose at 6.50 s; limit 0.210 m");
    }
}
