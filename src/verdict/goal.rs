//! `goal`: the driven state meets every condition of one of the problem's goal states at one time step of the scenario.
//!
//! CommonRoad evaluates the states of a solution, which lie at the time steps of the file, and the **centre** of the vehicle.
//! This check does the same.

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

    /// The unmet conditions of the goal that the state meets best.
    fn least_unmet(&self, centre: &Pose, speed: f64, time: f64) -> Option<Unmet> {
        self.goals.iter().map(|g| g.unmet(centre, speed, time)).min_by_key(Vec::len)
    }

    /// Whether the centre of the vehicle passed a goal region: it was inside one and ends outside of it.
    fn is_driven_past(&self, vehicle: &Vehicle, samples: &[Sample]) -> bool {
        let Some(last) = samples.last().map(|s| vehicle.centre_of_rear_axle(&s.pose).position) else { return false };
        self.goals.iter().filter_map(|g| g.region.as_ref()).any(|region| {
            let was_inside = |s: StateAtStep| region.contains(s.centre.position);
            !region.contains(last) && states_at_steps(self.time_step, vehicle, samples).any(was_inside)
        })
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
/// no goal, or if something stood in the way of such a run before it passed the goal.
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
    let past = || watch.is_driven_past(vehicle, &log.samples);
    match (best, ahead.filter(|a| a.is_in_the_way())) {
        (Some((unmet, time)), _) if unmet.is_empty() => {
            check(0.0, Some(time), format!("reached the goal at {time:.2} s"))
        }
        (_, Some(ahead)) if !past() => Check::not_applicable(NAME, UNIT, &ahead.to_string()),
        (None, _) => check(1.0, None, "missed the goal: the run covers no time step of the scenario".into()),
        (Some((unmet, time)), _) => {
            let conditions = if unmet.len() == 1 { "condition" } else { "conditions" };
            let (count, names) = (unmet.len(), unmet.join(", "));
            let end = match ahead {
                Some(_) if past() => "; it drove past the goal".to_owned(),
                Some(ahead) => format!("; {ahead}"),
                None => String::new(),
            };
            let note = format!("missed the goal: at best {count} {conditions} unmet ({names}) at {time:.2} s{end}");
            check(count as f64, Some(time), note)
        }
    }
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
}
