//! `goal`: the driven state meets every condition of one of the problem's goal states at one time step of the scenario.
//!
//! CommonRoad evaluates the states of a solution, which lie at the time steps of the file, and the **centre** of the vehicle.
//! This check does the same.

use std::fmt;

use super::lanes::GoalLanes;
use super::shapes::contains;
use super::stop_needed::FreeRoad;
use super::{Check, Status};
use crate::geometry::{Point, Pose};
use crate::map::{Goal, GoalPosition, Interval, PlanningProblem, Scenario, Shape};
use crate::simulation::{Log, Sample};
use crate::vehicle::Vehicle;

/// Slack of a time interval, s: the time of a step is a product and is rounded.
const TIME_SLACK: f64 = 1e-6;

/// The goal states of a problem, with their regions resolved.
#[derive(Debug, Clone)]
pub struct GoalWatch {
    goals: Vec<Watched>,
    time_step: f64,
}

#[derive(Debug, Clone)]
struct Watched {
    region: Option<Region>,
    goal: Goal,
}

#[derive(Debug, Clone)]
enum Region {
    Shape(Shape),
    /// Outlines of lanelets.
    Outlines(Vec<Vec<Point>>),
}

impl Region {
    fn contains(&self, p: Point) -> bool {
        match self {
            Self::Shape(shape) => shape.contains(p),
            Self::Outlines(outlines) => outlines.iter().any(|o| contains(o, p)),
        }
    }
}

/// Names of the conditions of a goal that a state does not meet.
type Unmet = Vec<&'static str>;

impl Watched {
    fn unmet(&self, centre: &Pose, speed: f64, time: f64) -> Unmet {
        let Goal { time: when, speed: speeds, yaw, .. } = &self.goal;
        let slack = Interval { min: when.min - TIME_SLACK, max: when.max + TIME_SLACK };
        [
            ("position", self.region.as_ref().is_none_or(|r| r.contains(centre.position))),
            ("time", slack.contains(time)),
            ("speed", speeds.is_none_or(|i| i.contains(speed))),
            ("heading", yaw.is_none_or(|i| i.contains_angle(centre.yaw))),
        ]
        .into_iter()
        .filter_map(|(name, is_met)| (!is_met).then_some(name))
        .collect()
    }
}

impl GoalWatch {
    /// Resolves the goal regions. Lanelets that the network does not have are ignored.
    #[must_use]
    pub fn new(scenario: &Scenario, problem: &PlanningProblem) -> Self {
        let region = |position: &GoalPosition| match position {
            GoalPosition::Shapes(shape) => Region::Shape(shape.clone()),
            GoalPosition::Lanelets(ids) => {
                let lanelets = ids.iter().filter_map(|id| scenario.network.lanelets.get(id));
                Region::Outlines(lanelets.map(crate::map::Lanelet::outline).collect())
            }
        };
        let goals = problem
            .goals
            .iter()
            .map(|goal| Watched { region: goal.position.as_ref().map(region), goal: goal.clone() })
            .collect();
        Self { goals, time_step: scenario.time_step }
    }

    /// Whether the state meets every condition of one of the goals. `centre` is the pose of the vehicle's centre,
    /// `speed` in m/s, `time` in s since the file's time step 0.
    #[must_use]
    pub fn is_goal(&self, centre: &Pose, speed: f64, time: f64) -> bool {
        self.goals.iter().any(|g| g.unmet(centre, speed, time).is_empty())
    }

    /// Index of the first sample at or after the first time step at which one of the goals is met and `counts` is true of
    /// speed (m/s) and time (s). States between samples are interpolated, so the result does not depend on the sample rate.
    #[must_use]
    pub fn reached_in(
        &self,
        vehicle: &Vehicle,
        samples: &[Sample],
        counts: impl Fn(f64, f64) -> bool,
    ) -> Option<usize> {
        let time = states_at_steps(self.time_step, vehicle, samples)
            .find(|s| self.is_goal(&s.centre, s.speed, s.time) && counts(s.speed, s.time))?
            .time;
        let index = samples.partition_point(|s| s.time < time - TIME_SLACK);
        (index < samples.len()).then_some(index)
    }

    /// The end of the last time window, s, if it was over at the end of the run.
    fn closed_window(&self, log: &Log) -> Option<f64> {
        let end = self.deadline();
        log.samples.last().is_some_and(|s| s.time >= end - TIME_SLACK).then_some(end)
    }

    /// Whether waiting can reach a goal: the state meets every condition but the time, and the time window opens later.
    /// Arguments as for [`GoalWatch::is_goal`].
    #[must_use]
    pub fn opens_later(&self, centre: &Pose, speed: f64, time: f64) -> bool {
        let waits = |g: &Watched| g.goal.time.min > time && g.unmet(centre, speed, time) == ["time"];
        self.goals.iter().any(waits)
    }

    /// The latest time at which the goal can be reached, s; −∞ without a goal.
    #[must_use]
    pub fn deadline(&self) -> f64 {
        self.goals.iter().map(|g| g.goal.time.max).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Whether a stopped vehicle whose centre has this pose meets every condition of a goal but its time. A goal without a
    /// region has no place.
    pub(super) fn is_place_to_stop(&self, centre: &Pose) -> bool {
        let only_time_unmet = |g: &Watched| g.unmet(centre, 0.0, f64::NAN) == ["time"];
        self.goals.iter().filter(|g| g.region.is_some()).any(only_time_unmet)
    }

    /// The unmet conditions of the goal that the state meets best.
    fn least_unmet(&self, centre: &Pose, speed: f64, time: f64) -> Option<Unmet> {
        self.goals.iter().map(|g| g.unmet(centre, speed, time)).min_by_key(Vec::len)
    }

    /// Whether the centre of the vehicle passed a goal region: it was inside one and ends outside of it.
    fn is_left(&self, vehicle: &Vehicle, samples: &[Sample]) -> bool {
        let Some(last) = samples.last().map(|s| vehicle.centre_of_rear_axle(&s.pose).position) else { return false };
        self.goals.iter().filter_map(|g| g.region.as_ref()).any(|region| {
            let was_inside = |s: StateAtStep| region.contains(s.centre.position);
            !region.contains(last) && states_at_steps(self.time_step, vehicle, samples).any(was_inside)
        })
    }
}

/// Why a goal was missed, whatever stands in the way at the end of the run.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Miss {
    /// The lanes lead from the goal to the start, and none from the start to the goal.
    BehindStart,
    /// The vehicle left the region of a goal, or lanes led to the goal at the start and none at the end.
    DrivenPast,
    /// The vehicle ends in the goal or could stop in it, clear of what is in the way.
    Free,
}

impl fmt::Display for Miss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::BehindStart => "the goal lies behind the start",
            Self::DrivenPast => "it was driven past",
            Self::Free => "nothing stood between the vehicle and the goal",
        })
    }
}

impl Miss {
    fn of(
        scenario: &Scenario,
        problem: &PlanningProblem,
        vehicle: &Vehicle,
        log: &Log,
        ahead: Option<&FreeRoad>,
    ) -> Option<Self> {
        let watch = GoalWatch::new(scenario, problem);
        let (first, last) = (log.samples.first()?, log.samples.last()?);
        let [start, end] = [first, last].map(|s| vehicle.centre_of_rear_axle(&s.pose));
        let lanes = |goal: &Goal| goal.position.as_ref().map(|p| GoalLanes::new(&scenario.network, p));
        // a goal without a region can be reached anywhere
        let lanes: Option<Vec<GoalLanes>> = problem.goals.iter().map(lanes).collect();
        let every = |is: &dyn Fn(&GoalLanes) -> bool| lanes.as_ref().is_some_and(|lanes| lanes.iter().all(is));
        let leads = |lanes: &GoalLanes, pose: &Pose| lanes.lead_from(pose) == Some(true);
        let none = |lanes: &GoalLanes, pose: &Pose| lanes.lead_from(pose) == Some(false);
        let some_led = lanes.as_ref().is_some_and(|lanes| lanes.iter().any(|l| leads(l, &start)));
        if every(&|l| none(l, &start) && l.lead_to(&start) == Some(true)) {
            Some(Self::BehindStart)
        } else if watch.is_left(vehicle, &log.samples) || some_led && every(&|l| none(l, &end)) {
            Some(Self::DrivenPast)
        } else {
            ahead.is_some_and(FreeRoad::is_goal_free).then_some(Self::Free)
        }
    }
}

/// The first time step at which the run meets the goal, s.
#[must_use]
pub fn goal_reached_at(scenario: &Scenario, problem: &PlanningProblem, vehicle: &Vehicle, log: &Log) -> Option<f64> {
    let watch = GoalWatch::new(scenario, problem);
    states_at_steps(scenario.time_step, vehicle, &log.samples)
        .find(|s| watch.is_goal(&s.centre, s.speed, s.time))
        .map(|s| s.time)
}

const NAME: &str = "goal";
const UNIT: &str = "conditions";

/// The check. Its value is the number of unmet conditions at the time step that meets most.
///
/// `ahead` is the road ahead of a run that stopped instead of reaching its goal. The check does not apply if the problem has
/// no goal, or if something stood in the way of such a run and nothing else explains the miss ([`Miss`]).
pub(super) fn goal(
    scenario: &Scenario,
    problem: &PlanningProblem,
    vehicle: &Vehicle,
    log: &Log,
    ahead: Option<&FreeRoad>,
) -> Check {
    if problem.goals.is_empty() {
        return Check::not_applicable(NAME, UNIT, "the planning problem has no goal");
    }
    let watch = GoalWatch::new(scenario, problem);
    let best = states_at_steps(scenario.time_step, vehicle, &log.samples)
        .filter_map(|s| Some((watch.least_unmet(&s.centre, s.speed, s.time)?, s.time)))
        .min_by_key(|(unmet, _)| unmet.len());
    let check = |value: f64, at_time, note| Check {
        name: NAME,
        status: Status::of(value == 0.0),
        value,
        limit: 0.0,
        unit: UNIT,
        at_time,
        impact: None,
        note,
        method: "conditions of a goal state that the vehicle's centre does not meet at the best time step".into(),
    };
    if let Some((_, time)) = best.as_ref().filter(|(unmet, _)| unmet.is_empty()) {
        return check(0.0, Some(*time), format!("reached the goal at {time:.2} s"));
    }
    let miss = Miss::of(scenario, problem, vehicle, log, ahead);
    if let (None, Some(ahead)) = (miss, ahead.filter(|a| a.is_in_the_way())) {
        return Check::not_applicable(NAME, UNIT, &ahead.to_string());
    }
    let Some((unmet, time)) = best else {
        return check(1.0, None, "missed the goal: the run covers no time step of the scenario".into());
    };
    let conditions = if unmet.len() == 1 { "condition" } else { "conditions" };
    let (count, names) = (unmet.len(), unmet.join(", "));
    let mut note = format!("missed the goal: at best {count} {conditions} unmet ({names}) at {time:.2} s");
    let window = watch.closed_window(log).map(|end| format!("its time window was over at {end:.2} s"));
    let reasons = [miss.map(|m| m.to_string()), window, ahead.map(ToString::to_string)];
    for reason in reasons.into_iter().flatten() {
        note += &format!("; {reason}");
    }
    check(count as f64, Some(time), note)
}

struct StateAtStep {
    time: f64,
    /// Pose of the vehicle's centre.
    centre: Pose,
    speed: f64,
}

/// The driven states at the scenario's time steps that the samples cover, interpolated between samples.
fn states_at_steps<'a>(
    step: f64,
    vehicle: &'a Vehicle,
    samples: &'a [Sample],
) -> impl Iterator<Item = StateAtStep> + 'a {
    let first = samples.first().map_or(f64::INFINITY, |s| s.time);
    let last = samples.last().map_or(f64::NEG_INFINITY, |s| s.time);
    let start = ((first - TIME_SLACK) / step).ceil();
    let count = (((last + TIME_SLACK) / step).floor() - start + 1.0).max(0.0);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count, not negative; NaN gives 0
    (0..count as usize).filter_map(move |i| {
        let time = (start + i as f64) * step;
        let (pose, speed) = interpolated(samples, time)?;
        Some(StateAtStep { time, centre: vehicle.centre_of_rear_axle(&pose), speed })
    })
}

fn interpolated(samples: &[Sample], time: f64) -> Option<(Pose, f64)> {
    let after = samples.partition_point(|s| s.time <= time + TIME_SLACK);
    let before = samples.get(after.saturating_sub(1))?;
    let Some(next) = samples.get(after).filter(|n| n.time > before.time) else {
        return Some((before.pose, before.speed));
    };
    let ratio = ((time - before.time) / (next.time - before.time)).clamp(0.0, 1.0);
    Some((before.pose.interpolated(&next.pose, ratio), before.speed + (next.speed - before.speed) * ratio))
}

#[cfg(test)]
mod tests {
    use super::super::testing::Story;
    use super::*;

    fn reached(s: &Story) -> Option<f64> {
        goal_reached_at(&s.scenario, &s.scenario.problems[0], &s.vehicle, &s.log)
    }

    fn region(s: &Story, x: f64, length: f64) -> Option<GoalPosition> {
        let part = crate::map::Part::Rectangle { centre: s.place.pose(x, 0.0, 0.0), length, width: 3.5 };
        Some(GoalPosition::Shapes(Shape { parts: vec![part] }))
    }

    #[test]
    fn the_goal_is_reached_at_the_first_time_step_with_the_centre_inside() {
        let mut s = Story::clean();
        (s.goal().speed, s.goal().yaw) = (None, None);
        // at 8 m/s from x = 10 the centre passes x = 30.1 after 2.5125 s
        s.goal().position = region(&s, 32.1, 4.0);
        assert!((reached(&s).unwrap() - 2.6).abs() < 1e-9, "{:?}", reached(&s));
    }

    #[test]
    fn a_region_crossed_between_two_time_steps_is_missed() {
        let mut s = Story::clean();
        s.goal().speed = None;
        s.goal().position = region(&s, 10.4, 0.5);
        assert_eq!(reached(&s), None);
        s.goal().position = region(&s, 10.8, 0.5);
        assert!((reached(&s).unwrap() - 0.1).abs() < 1e-9);
    }

    #[test]
    fn a_goal_of_time_alone_is_reached_at_the_first_step_of_its_interval() {
        let mut s = Story::clean();
        (s.goal().position, s.goal().speed, s.goal().yaw) = (None, None, None);
        s.goal().time = Interval { min: 33.0 * 0.1, max: 33.0 * 0.1 };
        assert!((reached(&s).unwrap() - 3.3).abs() < 1e-9);
        s.goal().time = Interval { min: 15.1, max: 20.0 };
        assert_eq!(reached(&s), None, "the log ends before");
    }

    #[test]
    fn one_of_the_lanelets_and_one_of_the_goals_suffices() {
        let mut s = Story::clean();
        s.goal().speed = None;
        s.goal().position = Some(GoalPosition::Lanelets(vec![4711, 2]));
        let time = reached(&s).unwrap();
        // lanelet 2 starts at x = 70
        let centre =
            |t: f64| s.log.samples[(t * 100.0).round() as usize].pose.position.x + s.vehicle.rear_axle_to_centre;
        assert!(centre(time) >= 70.0 && centre(time - 0.1) < 70.0, "{time}");

        let unreachable = Goal { time: Interval { min: 50.0, max: 60.0 }, ..s.goal().clone() };
        s.problem().goals.insert(0, unreachable);
        assert_eq!(reached(&s), Some(time));
    }

    #[test]
    fn headings_are_compared_modulo_full_turns() {
        let mut s = Story::clean();
        s.goal().yaw = Some(Interval { min: std::f64::consts::TAU - 0.05, max: std::f64::consts::TAU + 0.05 });
        assert!(reached(&s).is_some());
        s.goal().yaw = Some(Interval { min: 0.01, max: 0.05 });
        assert_eq!(reached(&s), None);
    }

    #[test]
    fn the_watch_gives_the_same_result_part_by_part_at_every_sample_rate() {
        let whole = Story::clean();
        let watch = GoalWatch::new(&whole.scenario, &whole.scenario.problems[0]);
        let reached_part_by_part = |samples: &[Sample]| {
            let mut evaluated: usize = 0;
            samples.chunks(7).find_map(|part| {
                let from = evaluated.saturating_sub(1);
                evaluated += part.len();
                let index = watch.reached_in(&whole.vehicle, &samples[from..evaluated], |_, _| true)?;
                Some(samples[from + index].time)
            })
        };
        for every in [1, 3, 7] {
            // at 0.03 s and 0.07 s few samples lie on a time step
            let samples: Vec<Sample> = whole.log.samples.iter().copied().step_by(every).collect();
            let log = Log { samples, ..whole.log.clone() };
            let expected = goal_reached_at(&whole.scenario, &whole.scenario.problems[0], &whole.vehicle, &log).unwrap();
            let found = reached_part_by_part(&log.samples).unwrap();
            let spacing = 0.01 * every as f64;
            assert!((expected - 1e-9..expected + spacing).contains(&found), "{found} for {expected}");
        }
        assert_eq!(watch.reached_in(&whole.vehicle, &whole.log.samples, |_, _| false), None);
        assert_eq!(watch.deadline(), 30.0);
    }

    #[test]
    fn waiting_helps_only_while_time_is_the_one_unmet_condition_and_the_window_opens_later() {
        let mut s = Story::clean();
        s.goal().time = Interval { min: 20.0, max: 30.0 };
        let watch = GoalWatch::new(&s.scenario, &s.scenario.problems[0]);
        let inside = s.place.pose(82.0, 0.0, 0.0);
        assert!(watch.opens_later(&inside, 0.0, 15.0));
        assert!(!watch.opens_later(&inside, 0.0, 20.0), "the window is open");
        assert!(!watch.opens_later(&inside, 0.0, 31.0), "the window is closed");
        assert!(!watch.opens_later(&inside, 1.0, 15.0), "too fast");
        assert!(!watch.opens_later(&s.place.pose(60.0, 0.0, 0.0), 0.0, 15.0), "outside");
    }

    fn goal_check(s: &Story) -> Check {
        s.judge().checks.into_iter().find(|c| c.name == NAME).unwrap()
    }

    /// The clean run as a safe stop before a parked car, on two lanes: 1 and 2 on the right, 3 and 4 on the left.
    fn stopped_before_a_car(place: super::super::testing::Place) -> Story {
        use crate::map::Neighbour;
        let mut s = Story::at(place);
        let lanes = &mut s.scenario.network.lanelets;
        lanes.insert(3, place.lanelet(3, (0.0, 70.0), 1.75, 5.25));
        lanes.insert(4, place.lanelet(4, (70.0, 130.0), 1.75, 5.25));
        for (right, left) in [(1, 3), (2, 4)] {
            let beside = |id| Some(Neighbour { id, same_direction: true });
            lanes.get_mut(&right).unwrap().adjacent_left = beside(left);
            lanes.get_mut(&left).unwrap().adjacent_right = beside(right);
        }
        crate::fixtures::follow(&mut s.scenario.network, 1, 2);
        crate::fixtures::follow(&mut s.scenario.network, 3, 4);
        s.scenario.obstacles.push(place.parked(7, 90.0, 0.0));
        s.settings = super::super::Settings::expecting(super::super::Expectation::Stop);
        s
    }

    fn rectangle(s: &Story, x: f64, y: f64, length: f64) -> Option<GoalPosition> {
        let part = crate::map::Part::Rectangle { centre: s.place.pose(x, y, 0.0), length, width: 3.0 };
        Some(GoalPosition::Shapes(Shape { parts: vec![part] }))
    }

    fn places() -> [super::super::testing::Place; 2] {
        let here = super::super::testing::Place::here();
        let far = Pose { position: Point::new(6.9e5, 5.3e6), yaw: 2.2 };
        [here, super::super::testing::Place { origin: far, mirrored: true }]
    }

    #[test]
    fn a_goal_behind_the_start_is_not_excused_and_said_so() {
        for place in places() {
            let mut s = stopped_before_a_car(place);
            for y in [0.0, 3.5] {
                s.goal().position = rectangle(&s, 4.0, y, 2.0);
                assert_eq!(s.failures(), [NAME], "{:?}", goal_check(&s));
                assert!(
                    goal_check(&s).note.contains("; the goal lies behind the start; stopped "),
                    "{:?}",
                    goal_check(&s)
                );
            }
            // on a ring, lanes lead there
            crate::fixtures::follow(&mut s.scenario.network, 2, 1);
            assert_eq!(s.failures(), [""; 0]);
        }
        let mut s = Story::clean();
        s.goal().position = rectangle(&s, 4.0, 0.0, 2.0);
        assert!(goal_check(&s).note.ends_with("; the goal lies behind the start"), "{:?}", goal_check(&s));
    }

    #[test]
    fn a_goal_that_was_passed_on_the_next_lane_is_not_excused() {
        for place in places() {
            let mut s = stopped_before_a_car(place);
            s.goal().position = rectangle(&s, 40.0, 3.5, 6.0);
            assert_eq!(s.failures(), [NAME]);
            assert!(goal_check(&s).note.contains("; it was driven past; stopped "), "{:?}", goal_check(&s));
            // another goal still lies ahead
            let ahead = Goal { position: rectangle(&s, 110.0, 3.5, 6.0), ..s.goal().clone() };
            s.problem().goals.push(ahead);
            assert_eq!(s.failures(), [""; 0], "{:?}", goal_check(&s));
            s.problem().goals.remove(0);
            assert_eq!(goal_check(&s).note, "not applicable: stopped 3.50 m before obstacle 7");
        }
    }

    #[test]
    fn a_goal_crossed_between_two_time_steps_was_driven_past() {
        let mut s = stopped_before_a_car(super::super::testing::Place::here());
        s.goal().position = rectangle(&s, 30.4, 0.0, 0.1);
        assert_eq!(s.failures(), [NAME]);
        assert!(goal_check(&s).note.contains("; it was driven past"), "{:?}", goal_check(&s));
    }

    #[test]
    fn a_missed_exit_is_not_excused_unless_the_map_does_not_connect_it() {
        let mut s = stopped_before_a_car(super::super::testing::Place::here());
        s.scenario.network.lanelets.insert(5, s.place.lanelet(5, (70.0, 130.0), -8.0, -4.5));
        s.goal().position = Some(GoalPosition::Lanelets(vec![5]));
        assert_eq!(s.failures(), [""; 0], "no lane leads there from the start");
        crate::fixtures::follow(&mut s.scenario.network, 1, 5);
        assert_eq!(s.failures(), [NAME]);
        assert!(goal_check(&s).note.contains("; it was driven past"), "{:?}", goal_check(&s));
    }

    #[test]
    fn an_obstacle_beyond_the_goal_is_no_excuse() {
        for place in places() {
            let mut s = stopped_before_a_car(place);
            s.scenario.obstacles.pop();
            // the front bumper stops at 84.254 m, 7.5 m before the car
            s.scenario.obstacles.push(place.parked(7, 94.0, 0.0));
            s.goal().position = rectangle(&s, 84.5, 0.0, 2.0);
            assert_eq!(s.failures(), [NAME]);
            let note = goal_check(&s).note;
            assert!(note.contains("; nothing stood between the vehicle and the goal; stopped "), "{note}");
            s.goal().position = rectangle(&s, 87.0, 0.0, 2.0);
            assert_eq!(s.failures(), [""; 0], "too near to the car");
            s.goal().position = rectangle(&s, 84.5, 0.0, 2.0);
            s.goal().speed = Some(Interval { min: 3.0, max: 9.0 });
            assert_eq!(s.failures(), [""; 0], "the car may prevent the speed");
        }
    }

    #[test]
    fn a_time_window_that_is_over_is_said_so_and_no_obstacle_excuses_it() {
        let mut s = stopped_before_a_car(super::super::testing::Place::here());
        s.goal().time = Interval { min: 0.0, max: 9.0 };
        assert_eq!(s.failures(), [NAME]);
        let note = goal_check(&s).note;
        assert!(note.contains("unmet (time) at ") && note.contains("; its time window was over at 9.00 s"), "{note}");
        // not yet open
        s.goal().time = Interval { min: 20.0, max: 30.0 };
        assert_eq!(s.failures(), [NAME]);
        assert!(!goal_check(&s).note.contains("time window"), "{:?}", goal_check(&s));
    }
}
