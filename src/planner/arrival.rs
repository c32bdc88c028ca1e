//! When a plan is at the goal: the speed that is not too early for its time window, and whether a plan misses it.
//!
//! The vehicle arrives in time if it drives at most at some speed, and slower where a bend or a rule asks for it: that speed is found by
//! bisection of the time that it takes. With a constant speed instead, it would be too slow before a bend, and late behind it.
//!
//! A pair of path and speed that is outside of the goal during all of its time window costs
//! [`Weights::missed_target`](crate::lattice::Weights::missed_target), so that of two plans of one level the one that meets it is taken.
//! The price rises as the window closes.
//!
//! Weak: beyond the end of the path only the cruise speed is known. Goals whose window closes later than a plan looks ahead are not
//! judged.

use super::candidate::{Situation, TRAVEL_TIME_HORIZON};
use super::goal::is_met;
use super::{Planner, Start};
use crate::geometry::steps::fitting;
use crate::lattice::LatticePath;
use crate::trajectory::SpeedProfile;

/// Slowest approach to a goal before its time window opens, m/s.
const SLOWEST: f64 = 0.5;
/// Halvings of the interval of speeds: 30 m/s to 2 mm/s.
const HALVINGS: usize = 14;
/// Time step of the goals, s: that of most files.
const STEP: f64 = 0.1;
/// Time until a goal closes below which missing it, or the lane change to it, costs more, s.
const URGENT_TIME: f64 = 8.0;
/// Time per rise by its base value, s.
const URGENCY_TIME_STEP: f64 = 2.0;

/// Factor on the price of what misses a goal that closes after a time, s.
pub(super) fn urgency(time_left: f64) -> f64 {
    1.0 + ((URGENT_TIME - time_left) / URGENCY_TIME_STEP).max(0.0)
}

impl Situation<'_> {
    /// The speed with which the vehicle is not too early at the goal, under the speed limits of the nodes of a path (m/s); infinite if no
    /// speed is. `far`: station of the path at which it leaves the goal, m.
    pub(super) fn speed_for_window(&self, stations: &[f64], limits: &[f64], far: f64) -> f64 {
        let goal = self.goal.filter(|goal| !self.waits_in(goal));
        let Some(duration) = goal.and_then(|goal| goal.time_in_front(self.station, self.time)) else {
            return f64::INFINITY;
        };
        let is_early = |speed: f64| self.driving_time(stations, limits, far, speed) < duration;
        if !is_early(self.cruise) {
            return f64::INFINITY;
        }
        let halved = |(slow, fast): (f64, f64), _| {
            let middle = f64::midpoint(slow, fast);
            if is_early(middle) { (slow, middle) } else { (middle, fast) }
        };
        (0..HALVINGS).fold((SLOWEST.min(self.cruise), self.cruise), halved).0
    }

    /// The time from the start to a station of the path (m) with at most a speed (m/s), s.
    fn driving_time(&self, stations: &[f64], limits: &[f64], to: f64, most: f64) -> f64 {
        let (mut time, mut speed) = (0.0, self.speed);
        let mut drive = |length: f64, limit: f64| {
            let faster = (speed * speed + 2.0 * self.acceleration * length).sqrt();
            let slower = (speed * speed - 2.0 * self.braking * length).max(0.0).sqrt();
            let next = limit.min(most).clamp(slower, faster);
            time += 2.0 * length / (speed + next);
            speed = next;
        };
        for (cell, limit) in stations.windows(2).zip(&limits[1..]).take_while(|(cell, _)| cell[0] < to) {
            drive(cell[1].min(to) - cell[0], limit.max(SLOWEST));
        }
        let rest = to - stations[stations.len() - 1];
        if rest > 0.0 {
            drive(rest, self.cruise);
        }
        time
    }
}

impl Planner<'_> {
    /// Charges a path for missing the goal with its speed profile.
    pub(super) fn charge_missed_goal(&self, start: &Start, path: &mut LatticePath, profile: &SpeedProfile) {
        if self.misses_goal(start, path, profile) {
            let price = self.settings.lattice.weights.missed_target * urgency(self.task_ends() - start.point.time);
            path.terms.missed_target = path.terms.missed_target.max(price);
        }
    }

    /// Whether a plan is in no goal during its time window, and the windows of all goals close soon.
    fn misses_goal(&self, start: &Start, path: &LatticePath, profile: &SpeedProfile) -> bool {
        let goals = self.goals.as_deref().unwrap_or_default();
        let now = start.point.time;
        let closes_soon = |end: f64| (now..=now + TRAVEL_TIME_HORIZON).contains(&end);
        if goals.is_empty() || !goals.iter().all(|g| g.position.is_some() && closes_soon(g.time.max)) {
            return false;
        }
        !goals.iter().any(|goal| {
            let opens = goal.time.min.max(now);
            let steps = fitting(goal.time.max - opens, STEP);
            (0..=steps).any(|i| {
                let at = profile.at(opens + i as f64 * STEP - now);
                let centre = self.vehicle.centre_of_rear_axle(&path.path.at(at.station).pose);
                is_met(goal, self.map.network, &centre, at.speed)
            })
        })
    }
}
