//! The judge: named checks over what happened, derived again from the log and the scenario.
//!
//! It has to be able to contradict the planner, so it shares no code with it: the geometry here (`shapes`) is dense
//! sampling, the separating-axis theorem and the even–odd rule, slow and simple, where the planner has swept
//! footprints and bounding-volume trees. Planning records are read only where the question is about plans: whether a
//! stop was proven (`stop_proven`), where a stop was meant to be (`stops`), how often the plan changed ([`Metrics`]).
//!
//! | Check | Value | Holds when |
//! |---|---|---|
//! | `simulation` | samples that are not finite | only present when the log is empty or broken, and then fails |
//! | `no_contact` | deepest overlap with an obstacle or an occupied cell, m | ≤ [`Settings::contact_tolerance`], and the rig reports no contact |
//! | `stays_on_road` | largest excursion of the footprint, m | ≤ [`Settings::road_tolerance`] |
//! | `stops` | distance from the planned stop, m | ≤ [`Settings::stop_short`] before it, [`Settings::stop_past`] beyond it |
//! | `stop_proven` | share of cycles with a committed stop | = 1 |
//! | `fallback_stops` | the worst of what plans came to that were driven to rest without planning again | see [`fallback_stops`] |
//! | `comfort_longitudinal`, `comfort_lateral`, `comfort_jerk` | filtered extreme | ≤ the limit of [`ComfortPreset`] |
//! | `comfort_lateral_jerk` | filtered extreme | only asked where the preset has a limit |
//! | `tracking` | lateral distance from the wanted pose, m | ≤ [`Settings::tracking`] |
//! | `goal` | goal conditions not met at the best time step | = 0 |
//! | `stop_needed` | free way straight ahead of the rest, m | ≤ 10 m |
//!
//! A check holds when its value is at most its limit; only `stop_proven`, a share, has to reach its limit.
//!
//! **Which of `goal` and `stops` is asked** is one rule, [`Expectation`]: a run that ends because the way is blocked
//! can't reach its goal and is judged by its stop instead, and by whether something was in its way (`stop_needed`); every
//! other run is judged by its goal. `stops` is also
//! asked of a run that aims for the goal if it ended at rest where its plan wanted it to stop, or should have.
//!
//! Weak where: a contact between two samples (10 ms) of something thinner than the way driven meanwhile is seen only
//! by the rig; the judge does not ask who caused a contact; what was in the way is looked for straight ahead only.

mod cells;
mod check;
mod comfort;
mod contact;
mod fallback;
mod filter;
mod goal;
mod metrics;
mod presets;
mod reason;
mod road;
mod settings;
mod shapes;
mod stops;
#[cfg(test)]
mod testing;
mod tracking;

pub use check::{Check, Status};
pub(crate) use comfort::jerk_limit;
pub use fallback::{Fallback, FallbackBranch, FallbackJudge, fallback_stops};
pub use filter::zero_phase_low_pass;
pub use goal::{GoalWatch, goal_reached_at};
pub use metrics::{Metrics, metrics};
pub use presets::{ComfortLimits, ComfortPreset};
pub use settings::{FallbackSettings, Settings, SettingsError};

use crate::map::{PlanningProblem, Scenario};
use crate::planner::Cycle;
use crate::simulation::{Log, Sample};
use crate::vehicle::Vehicle;

/// The names of all checks that there are, whatever a run is asked for.
pub const CHECKS: [&str; 13] = [
    "simulation",
    "no_contact",
    "stays_on_road",
    "stops",
    "stop_proven",
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
    /// The checks, in a fixed order.
    pub checks: Vec<Check>,
}

impl Verdict {
    /// Whether every check held.
    #[must_use]
    pub fn pass(&self) -> bool {
        self.checks.iter().all(|c| !c.failed())
    }

    /// The first check that did not hold.
    pub fn first_failure(&self) -> Option<&Check> {
        self.failures().next()
    }

    /// Every check that did not hold.
    pub fn failures(&self) -> impl Iterator<Item = &Check> {
        self.checks.iter().filter(|c| c.failed())
    }

    /// Puts the check of the forked fallbacks to its place, behind `stop_proven`. A run that was not judged stays so.
    pub fn add_fallbacks(&mut self, check: Option<Check>) {
        let place = self.checks.iter().position(|c| c.name == "stop_proven");
        if let (Some(place), Some(check)) = (place, check) {
            self.checks.insert(place + 1, check);
        }
    }
}

/// What the run is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Expectation {
    /// To meet the problem's goal: the check `goal` is asked. For every outcome but a safe stop.
    #[default]
    Goal,
    /// To be at rest where the plan said: the checks `stops` and `stop_needed` are asked, `goal` is not. For the outcome
    /// `stopped_safely`, where the way ends or is blocked.
    Stop,
}

/// Judges a run. The checks come in the order of the module's table.
#[must_use]
pub fn judge(
    scenario: &Scenario,
    problem: &PlanningProblem,
    vehicle: &Vehicle,
    cycles: &[Cycle],
    log: &Log,
    settings: &Settings,
) -> Verdict {
    let mut checks: Vec<Check> = broken(log).into_iter().collect();
    if !log.samples.is_empty() {
        checks.push(contact::no_contact(scenario, vehicle, log, settings));
        checks.push(road::stays_on_road(&scenario.network, vehicle, log, settings));
        checks.extend(stops::stops(cycles, log, settings));
        checks.push(stops::stop_proven(cycles));
        checks.extend(comfort::comfort(vehicle, log, settings));
        checks.push(tracking::tracking(log, settings));
        match settings.expect {
            Expectation::Goal => checks.push(goal::goal(scenario, problem, vehicle, log)),
            Expectation::Stop => checks.extend(reason::stop_needed(scenario, problem, vehicle, log, settings)),
        }
    }
    Verdict { checks }
}

/// The check `simulation`, present only when it fails: a log without samples or with numbers that are not finite
/// proves nothing, and the other checks could miss a NaN.
fn broken(log: &Log) -> Option<Check> {
    let first_bad = log.samples.iter().find(|s| !is_finite(s));
    let count = log.samples.iter().filter(|s| !is_finite(s)).count();
    let note = match (log.broke_at, first_bad) {
        (Some(t), _) => format!("the physics produced a number that is not finite at {t:.3} s"),
        (None, Some(_)) => format!("{count} of {} samples hold a number that is not finite", log.samples.len()),
        (None, None) if log.samples.is_empty() => "nothing was driven: the log is empty".into(),
        (None, None) => return None,
    };
    let at_time = log.broke_at.or(first_bad.map(|s| s.time));
    Some(Check {
        name: "simulation",
        status: Status::Fail,
        value: count.max(1) as f64,
        limit: 0.0,
        unit: "samples",
        at_time,
        note,
    })
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
    use super::testing::{Place, REST_FROM, Story, bump};
    use super::*;
    use crate::geometry::{Point, Pose};
    use crate::map::{GoalPosition, Interval, Motion, ObstacleKind, Shape, TimedOccupancy};
    use crate::planner::Decision;
    use crate::simulation::{Contact, Touched};

    #[test]
    fn the_clean_run_passes_and_says_all_it_should() {
        let verdict = Story::clean().judge();
        let names: Vec<_> = verdict.checks.iter().map(|c| c.name).collect();
        let all = [
            "no_contact",
            "stays_on_road",
            "stops",
            "stop_proven",
            "comfort_longitudinal",
            "comfort_lateral",
            "comfort_jerk",
            "tracking",
            "goal",
        ];
        assert_eq!(names, all);
        assert!(verdict.pass(), "{:?}", verdict.first_failure());
        for c in verdict.checks.iter().filter(|c| c.name != "stop_proven") {
            assert!(c.value <= c.limit, "passes, but its value is beyond its limit: {c:?}");
        }
    }

    /// The check that has to see it, what is broken, and how.
    type Breakage = (&'static str, &'static str, fn(&mut Story));

    /// Each breaks one thing in a clean run.
    fn broken_one_at_a_time() -> Vec<Breakage> {
        vec![
            ("no_contact", "a contact that only the rig saw", |s| {
                let at_rear_axle_frame = Point::new(3.6, 0.0);
                s.log.contact =
                    Some(Contact { time: 3.0, with: Touched::Obstacle(101), at_rear_axle_frame, speed: 8.0 });
            }),
            ("no_contact", "a parked car's edge in the way that the rig did not see", |s| {
                s.scenario.obstacles[0] = s.place.parked(100, 60.0, 1.69);
            }),
            ("no_contact", "a car crossing at the wrong moment", |s| {
                // beside the lane before and after; on it at x = 34 when the vehicle is there after 3 s
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
            ("no_contact", "a round post with its side in the way", |s| {
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
            ("stops", "a rest 0.15 m beyond the planned one", |s| {
                s.displace(|m| (0.15 * m.time.min(13.0) / 13.0, 0.0))
            }),
            ("stops", "a rest 0.4 m before the planned one", |s| s.displace(|m| (-0.4 * m.time.min(13.0) / 13.0, 0.0))),
            ("stop_proven", "one cycle without a plan", |s| s.cycles[70].decision = Decision::Unproven),
            ("stop_proven", "one committed trajectory that ends moving", |s| {
                let committed = &mut s.cycles[70].committed;
                let knots = committed.profile.knots()[..2].to_vec();
                committed.profile = crate::trajectory::SpeedProfile::new(knots).unwrap();
            }),
            ("stop_proven", "no cycle at all", |s| s.cycles.clear()),
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
            ("comfort_jerk", "a shudder of 1.2 Hz that accelerates no more than allowed", |s| {
                for m in &mut s.log.samples {
                    m.acceleration += bump(m.time, 0.5, 4.0, 1.2) * (7.5 * m.time).sin();
                }
            }),
            ("tracking", "0.3 m beside the wanted pose for a moment", |s| {
                for m in &mut s.log.samples {
                    m.reference_pose.position += m.pose.left() * bump(m.time, 6.0, 1.0, 0.3) * s.place.side();
                }
            }),
            ("goal", "a goal 5 m further on", |s| {
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
            ("goal", "no goal state", |s| s.problem().goals.clear()),
            ("simulation", "a number that is not finite where no other check looks", |s| {
                s.log.samples[3].reference_pose.yaw = f64::NAN;
            }),
        ]
    }

    #[test]
    fn each_broken_run_fails_its_own_check_and_no_other() {
        for (name, what, break_it) in broken_one_at_a_time() {
            let mut story = Story::clean();
            break_it(&mut story);
            let failures = story.failures();
            // a NaN may reach further checks; they come after the one that names it
            let judged = if name == "simulation" { &failures[..1] } else { &failures[..] };
            assert_eq!(judged, [name], "{what}: fails {failures:?}");
        }
    }

    #[test]
    fn far_away_turned_or_mirrored_the_verdict_is_the_same() {
        let here = Place::here();
        let far = Place { origin: Pose::new(6.9e5, 5.3e6, 2.2), mirrored: false };
        let mirrored = Place { origin: Pose::new(0.0, 0.0, 0.0), mirrored: true };
        let clean: Breakage = ("", "nothing", |_| ());
        for (_, what, break_it) in broken_one_at_a_time().into_iter().chain([clean]) {
            if what.contains("not finite") || what.contains("another heading") {
                continue; // NaN equals nothing; that heading is absolute
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
                    let same = a.name == b.name && a.status == b.status && (a.value - b.value).abs() < 1e-6;
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
        // at rest is below 0.05 m/s: the raised cosine's last 0.79 s
        let rest = value("stops", &s).at_time.unwrap();
        assert!((rest - (REST_FROM - 0.79)).abs() < 0.02, "{rest}");
    }

    #[test]
    fn a_shudder_too_fast_to_feel_is_not_held_against_the_run() {
        let mut s = Story::clean();
        for (i, m) in s.log.samples.iter_mut().enumerate() {
            m.acceleration += if i % 2 == 0 { 5.0 } else { -5.0 };
        }
        assert_eq!(s.failures(), [""; 0]);
    }

    #[test]
    fn a_run_before_a_blocked_way_is_judged_by_its_stop_and_not_by_its_goal() {
        let mut s = Story::clean();
        s.problem().goals.clear();
        assert_eq!(s.failures(), ["goal"]);
        s.settings = Settings::expecting(Expectation::Stop);
        assert_eq!(s.failures(), [""; 0]);
        assert!(s.judge().checks.iter().any(|c| c.name == "stops"));
        s.log.samples.truncate(1000);
        assert_eq!(s.failures(), ["stops"], "still moving");
    }

    #[test]
    fn a_run_that_ends_moving_has_no_stop_to_make_unless_it_is_overdue() {
        let mut s = Story::clean();
        s.goal().speed = None;
        s.goal().position = None;
        s.log.samples.truncate(1000);
        assert_eq!(s.failures(), [""; 0]);
        assert!(s.judge().checks.iter().all(|c| c.name != "stops"));

        let mut s = Story::clean();
        for m in s.log.samples.iter_mut().filter(|m| m.time > 8.0) {
            m.speed = m.speed.max(0.3);
        }
        assert_eq!(s.failures(), ["stops"], "the planned stop was 2 s ago");
    }

    #[test]
    fn a_plan_made_at_rest_does_not_hide_the_stop_error() {
        let mut s = Story::clean();
        s.displace(|m| (0.2 * m.time.min(13.0) / 13.0, 0.0));
        for c in s.cycles.iter_mut().filter(|c| c.time > 13.05) {
            // planned again from the measured pose, a hair ahead
            let x = 82.2 - s.vehicle.rear_axle_to_centre;
            c.committed.path = s.place.straight(x, 0.0, 0.005);
        }
        assert_eq!(s.failures(), ["stops"]);
    }

    #[test]
    fn what_stands_between_the_parts_of_a_vehicle_is_no_contact_and_what_a_part_meets_is_one() {
        use crate::geometry::Point;
        use crate::vehicle::Footprint;
        let prong = |right: f64, left: f64| {
            [(-0.8, right), (3.6, right), (3.6, left), (-0.8, left)].map(|(x, y)| Point::new(x, y)).to_vec()
        };
        let mut s = Story::clean();
        s.vehicle.footprint = Footprint::new(vec![prong(-0.8, -0.3), prong(0.3, 0.8)]).unwrap();
        let mut post = s.place.parked(7, 40.0, 0.0);
        for (y, failures) in
            [(0.0, &[][..]), (0.15, &[]), (0.25, &["no_contact"]), (-0.25, &["no_contact"]), (-1.0, &[])]
        {
            post.shape = crate::map::Shape::rectangle(0.2, 0.2);
            post.motion = crate::map::Motion::Static(s.place.pose(40.0, y, 0.0));
            let mut with_post = s.clone();
            with_post.scenario.obstacles.push(post.clone());
            assert_eq!(with_post.failures(), failures, "a post at {y}");
        }
        // a strip without road under neither prong is seen by nobody, one under the left prong is
        let strips = |gap: (f64, f64)| {
            let mut s = s.clone();
            s.scenario.network.lanelets.clear();
            s.scenario.network.lanelets.insert(1, s.place.lanelet(1, (0.0, 130.0), -1.75, gap.0));
            s.scenario.network.lanelets.insert(2, s.place.lanelet(2, (0.0, 130.0), gap.1, 1.75));
            s.failures()
        };
        assert_eq!(strips((-0.25, 0.25)), [""; 0]);
        assert_eq!(strips((0.2, 0.5)), ["stays_on_road"]);
    }

    #[test]
    fn what_the_start_is_to_blame_for_is_said() {
        let mut s = Story::clean();
        s.displace(|_| (0.0, 1.0));
        let verdict = s.judge();
        assert!(verdict.first_failure().unwrap().note.contains("the start itself"), "{verdict:?}");

        let mut s = Story::clean();
        s.scenario.obstacles[0] = s.place.parked(100, 10.0, 0.0);
        let verdict = s.judge();
        assert!(verdict.first_failure().unwrap().note.contains("already at the start"), "{verdict:?}");
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
    fn a_long_run_among_many_obstacles_is_judged_at_once() {
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
}
