//! `stop_needed`: a run that stopped instead of reaching its goal had something in its way.
//!
//! Without this check a planner that stops for nothing would be as safe as can be, and pass. From where the vehicle rests its
//! footprint is pushed straight ahead until it meets an obstacle, at any time from the rest on, or an occupied cell, or leaves
//! the road. That is kind to the planner: in a bend straight ahead leaves the road soon, and what only crosses the way later
//! counts as being in it.

use super::cells;
use super::contact;
use super::road::Road;
use super::{Check, Settings, Status};
use crate::map::{Motion, PlanningProblem, Scenario};
use crate::simulation::{Log, Sample};
use crate::vehicle::Vehicle;

/// Free way ahead that still counts as none, m: room to swing out round something, and to keep off it.
const FREE_WAY: f64 = 10.0;
/// How far ahead is looked, m.
const LOOK_AHEAD: f64 = 20.0;
/// Way between two looks, m.
const STEP: f64 = 0.25;
/// Time between two looks, s.
const INTERVAL: f64 = 0.25;
/// How long after the end of the run what moves is looked at, s.
const LOOK_ON: f64 = 10.0;

/// The check; `None` for a problem without a goal, or for a run that ended moving.
pub(super) fn stop_needed(
    scenario: &Scenario,
    problem: &PlanningProblem,
    vehicle: &Vehicle,
    log: &Log,
    settings: &Settings,
) -> Option<Check> {
    let last = log.samples.last().filter(|s| s.speed.abs() <= settings.standstill_speed)?;
    if problem.goals.is_empty() {
        return None;
    }
    let rest = log.samples.iter().rposition(|s| s.speed.abs() > settings.standstill_speed).map_or(0, |i| i + 1);
    let since = log.samples.get(rest).map_or(last.time, |s| s.time);
    let moments = moments(scenario, since, last.time);
    let road = Road::new(&scenario.network);
    let off_road = settings.road_tolerance.max(road.excursion(vehicle, &last.pose));
    let blocks = |ahead: f64| {
        let pose = last.pose.advanced(ahead);
        if road.excursion(vehicle, &pose) > off_road {
            return Some("the road ends".to_owned());
        }
        let there = Log {
            samples: moments.iter().map(|time| Sample { time: *time, pose, ..*last }).collect(),
            ..Log::default()
        };
        let obstacle = contact::closest(scenario, vehicle, &there).filter(|c| c.gap < 0.0);
        let cell = || {
            let now = Log { samples: vec![Sample { pose, ..*last }], ..Log::default() };
            cells::closest(scenario, vehicle, &now).filter(|c| c.gap < 0.0)
        };
        obstacle
            .map(|o| format!("obstacle {}", o.obstacle))
            .or_else(|| cell().map(|c| format!("occupied cells around {c}")))
    };
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 80 looks
    let looks = (LOOK_AHEAD / STEP) as usize;
    let found = (0..=looks).map(|i| i as f64 * STEP).find_map(|ahead| Some((ahead, blocks(ahead)?)));
    let (free, what) = found.unwrap_or((LOOK_AHEAD, "nothing".into()));
    Some(Check {
        name: "stop_needed",
        status: Status::of(free <= FREE_WAY),
        value: free,
        limit: FREE_WAY,
        unit: "m",
        at_time: Some(since),
        note: format!("free way straight ahead of the rest before what it stopped for: {what}"),
    })
}

/// When to look: from the rest on while something moves.
fn moments(scenario: &Scenario, since: f64, end: f64) -> Vec<f64> {
    let moving = scenario.obstacles.iter().filter(|o| !matches!(o.motion, Motion::Static(_)));
    let until = moving.map(|o| o.lifetime().1).fold(f64::NEG_INFINITY, f64::max).min(end + LOOK_ON);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a run is an hour at most; negative is 0
    let looks = ((until - since) / INTERVAL) as usize;
    (0..=looks).map(|i| since + i as f64 * INTERVAL).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Expectation;
    use super::super::testing::Story;
    use super::*;

    fn asked(s: &Story) -> Option<Check> {
        s.judge().checks.into_iter().find(|c| c.name == "stop_needed")
    }

    /// The clean run, asked for a stop: it rests with its bumper at 84.254 m on a road that ends at 130 m.
    fn stopped() -> Story {
        let mut s = Story::clean();
        s.settings = Settings::expecting(Expectation::Stop);
        s
    }

    #[test]
    fn a_stop_on_a_free_road_is_not_needed_and_one_before_a_parked_car_is() {
        let mut s = stopped();
        assert_eq!(s.failures(), ["stop_needed"]);
        s.scenario.obstacles.push(s.place.parked(7, 90.0, 0.5));
        assert_eq!(s.failures(), [""; 0]);
        let check = asked(&s).unwrap();
        // bumper to bumper 90 − 2.25 − 84.254, seen within a step behind it
        assert!(check.value >= 3.496 && check.value <= 3.496 + STEP, "{check:?}");
        s.scenario.obstacles.pop();
        s.scenario.obstacles.push(s.place.parked(7, 90.0, 3.0));
        assert_eq!(s.failures(), ["stop_needed"], "beside the way");
    }

    #[test]
    fn what_crosses_later_and_where_the_road_ends_are_reasons() {
        let mut s = stopped();
        s.scenario.obstacles.push(s.place.moving(7, (14.0, 19.0), (88.0, -20.0), (88.0, 20.0)));
        assert_eq!(s.failures(), [""; 0]);
        let mut s = stopped();
        s.scenario.network.lanelets.insert(2, s.place.lanelet(2, (70.0, 90.0), -1.75, 1.75));
        assert_eq!(s.failures(), [""; 0]);
        assert!(asked(&s).unwrap().note.contains("the road ends"));
    }

    #[test]
    fn who_is_asked_for_the_goal_or_has_none_is_not_asked() {
        assert!(asked(&Story::clean()).is_none());
        let mut s = stopped();
        s.problem().goals.clear();
        assert!(asked(&s).is_none());
    }
}
