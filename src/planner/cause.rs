//! Why a plan is as it is: what limits its speed now, and what it will stop for.
//!
//! The cause of a stop is what its station was planned for: a blocker of the path, the goal, the end of the road; else the moving
//! obstacle that blocks the cells behind the standstill. What limits the speed is the first limit that the profile reaches within
//! the next seconds; a stop before any other limit.
//!
//! Weak: an obstacle that the plan lets pass, or passes in front of, is named only where the plan stops for it.

use super::candidate::{Situation, TargetLimits};
use super::record::{BlockedCell, Cause};
use crate::lattice::LatticePath;
use crate::trajectory::SpeedProfile;

/// How far ahead a limit counts as one of now, s.
const NOW: f64 = 3.0;
/// Time between compared states, s.
const STEP: f64 = 0.2;
/// A profile within this share of a limit reaches it.
const REACHED: f64 = 0.97;
/// A profile that ends within this distance of a planned stop stops for it, m: smoothing ends a little before it.
const AT_STOP: f64 = 0.5;
/// Cells within this distance behind the standstill are the reason for it, m.
const BEHIND_STOP: f64 = 3.0;

/// What a profile stops for; `None` if its end is only the fallback of a plan that goes on.
pub(super) fn stops_for(profile: &SpeedProfile, stop: Option<(f64, Cause)>, blocked: &[BlockedCell]) -> Option<Cause> {
    let end = profile.last().station;
    if let Some((_, cause)) = stop.filter(|(station, _)| end > station - AT_STOP) {
        return Some(cause);
    }
    let behind = blocked.iter().filter(|c| c.stations.1 > end && c.stations.0 < end + BEHIND_STOP);
    let first = behind.reduce(|a, b| if (b.stations.0, b.times.0) < (a.stations.0, a.times.0) { b } else { a });
    first.map(|cell| Cause::Obstacle(cell.obstacle))
}

impl Situation<'_> {
    /// The first limit that a profile reaches within the next seconds; `None` if it accelerates freely.
    pub(super) fn limited_by(
        &self,
        path: &LatticePath,
        profile: &SpeedProfile,
        limits: &TargetLimits,
        stops_for: Option<Cause>,
    ) -> Option<Cause> {
        let steps = std::iter::successors(Some(0.0), |t| Some(t + STEP)).take_while(|t| *t <= NOW);
        let reached = steps.map(|t| profile.at(t)).find_map(|state| {
            let node = limits.stations.partition_point(|s| *s < state.station).min(limits.stations.len() - 1);
            (state.speed >= REACHED * limits.speeds[node]).then_some(node)
        });
        let braking = profile.at(NOW).speed < profile.knots()[0].speed;
        let Some(node) = reached else { return stops_for.filter(|_| braking) };
        // a limit lowers those before it, so that braking can follow them
        let cause = (node..limits.stations.len()).find_map(|i| self.cause_at(path, limits, i));
        cause.or(stops_for)
    }

    /// What the limit at a node is for; `None` if a later one or the planned stop lowers it.
    fn cause_at(&self, path: &LatticePath, limits: &TargetLimits, node: usize) -> Option<Cause> {
        /// Rounding, m/s.
        const SAME: f64 = 1e-6;
        let (station, speed) = (limits.stations[node], limits.speeds[node]);
        let causes = self.speed_limits_by_cause(path, limits, station);
        causes.into_iter().find(|(limit, _)| *limit <= speed + SAME).map(|(_, cause)| cause)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::knot;

    #[test]
    fn a_stop_is_for_what_it_was_planned_for_else_for_the_first_obstacle_behind_it() {
        let profile = SpeedProfile::new(vec![knot(0.0, 0.0, 8.0, -2.0), knot(4.0, 16.0, 0.0, 0.0)]).unwrap();
        let cell = |from: f64, time: f64, obstacle| BlockedCell {
            stations: (from, from + 0.5),
            times: (time, time + 1.0),
            obstacle,
        };
        let blocked = [cell(18.0, 5.0, 3), cell(16.5, 7.0, 2), cell(16.5, 6.0, 1), cell(15.0, 0.0, 4)];
        assert_eq!(stops_for(&profile, Some((16.2, Cause::Goal)), &blocked), Some(Cause::Goal));
        assert_eq!(stops_for(&profile, Some((20.0, Cause::Goal)), &blocked), Some(Cause::Obstacle(1)));
        assert_eq!(stops_for(&profile, None, &blocked[..1]), Some(Cause::Obstacle(3)));
        assert_eq!(stops_for(&profile, None, &blocked[3..]), None);
    }
}
