//! `goal`: every condition of one of the problem's goal states, at once, at a time step of the scenario.
//!
//! CommonRoad judges a solution's states, which lie at the file's time steps, and it judges the vehicle's **centre**.
//! So does this.

use super::shapes::contains;
use super::{Check, Status};
use crate::geometry::{Point, Pose};
use crate::map::{Goal, GoalPosition, Interval, PlanningProblem, Scenario, Shape};
use crate::simulation::{Log, Sample};
use crate::vehicle::Vehicle;

/// Slack of a time interval, s: times of steps are products of the step and come with rounding.
const TIME_SLACK: f64 = 1e-6;

/// The goal of a problem with its regions looked up, to be asked sample by sample.
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

/// The conditions of a goal that do not hold in a state, by name.
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
        .filter_map(|(name, holds)| (!holds).then_some(name))
        .collect()
    }
}

impl GoalWatch {
    /// Looks up the goal's regions. Lanelets that the network does not have are no part of the goal.
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

    /// The first time step of the file within the samples at which one of the goals is met and `counts` holds of speed
    /// (m/s) and time (s): the index of the first sample that is no earlier. States between samples are interpolated, so
    /// that no rate of samples misses a time step.
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

    /// The latest time at which the goal can still be reached, s; −∞ without a goal.
    #[must_use]
    pub fn deadline(&self) -> f64 {
        self.goals.iter().map(|g| g.goal.time.max).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The fewest conditions left unmet by any of the goals, and which.
    fn least_unmet(&self, centre: &Pose, speed: f64, time: f64) -> Option<Unmet> {
        self.goals.iter().map(|g| g.unmet(centre, speed, time)).min_by_key(Vec::len)
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

/// The check. Its value counts the conditions that were not met at the time step that met most.
pub(super) fn goal(scenario: &Scenario, problem: &PlanningProblem, vehicle: &Vehicle, log: &Log) -> Check {
    let watch = GoalWatch::new(scenario, problem);
    let best = states_at_steps(scenario.time_step, vehicle, &log.samples)
        .filter_map(|s| Some((watch.least_unmet(&s.centre, s.speed, s.time)?, s.time)))
        .min_by_key(|(unmet, _)| unmet.len());
    let check = |value: f64, at_time, note| Check {
        name: "goal",
        status: Status::of(value == 0.0),
        value,
        limit: 0.0,
        unit: "conditions",
        at_time,
        note,
    };
    match best {
        None => check(1.0, None, "the problem has no goal state, or the run no time step".into()),
        Some((unmet, time)) if unmet.is_empty() => {
            check(0.0, Some(time), "every condition met by the vehicle's centre at a time step".into())
        }
        Some((unmet, time)) => check(
            unmet.len() as f64,
            Some(time),
            format!("never met together; nearest to it, unmet: {}", unmet.join(", ")),
        ),
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
    fn the_first_time_step_inside_counts_and_it_is_the_centre_that_enters() {
        let mut s = Story::clean();
        (s.goal().speed, s.goal().yaw) = (None, None);
        // at 8 m/s from x = 10 the centre passes x = 30.1 after 2.5125 s
        s.goal().position = region(&s, 32.1, 4.0);
        assert!((reached(&s).unwrap() - 2.6).abs() < 1e-9, "{:?}", reached(&s));
    }

    #[test]
    fn a_region_crossed_between_two_time_steps_is_missed_as_the_referee_would() {
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
    fn any_of_the_lanelets_and_any_of_the_goals_will_do() {
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
    fn asked_part_by_part_the_watch_agrees_with_the_whole_log_whatever_the_rate_of_samples() {
        let whole = Story::clean();
        let watch = GoalWatch::new(&whole.scenario, &whole.scenario.problems[0]);
        let asked = |samples: &[Sample]| {
            let mut judged: usize = 0;
            samples.chunks(7).find_map(|part| {
                let from = judged.saturating_sub(1);
                judged += part.len();
                let index = watch.reached_in(&whole.vehicle, &samples[from..judged], |_, _| true)?;
                Some(samples[from + index].time)
            })
        };
        for every in [1, 3, 7] {
            // 3 and 7 hundredths of a second: hardly a sample lies on a time step
            let samples: Vec<Sample> = whole.log.samples.iter().copied().step_by(every).collect();
            let log = Log { samples, ..whole.log.clone() };
            let expected = goal_reached_at(&whole.scenario, &whole.scenario.problems[0], &whole.vehicle, &log).unwrap();
            let found = asked(&log.samples).unwrap();
            let spacing = 0.01 * every as f64;
            assert!((expected - 1e-9..expected + spacing).contains(&found), "{found} for {expected}");
        }
        assert_eq!(watch.reached_in(&whole.vehicle, &whole.log.samples, |_, _| false), None);
        assert_eq!(watch.deadline(), 30.0);
    }
}
