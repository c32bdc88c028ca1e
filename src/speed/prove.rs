//! Checks a speed profile against its problem, by other code than the search: cell by cell, from the times at which the
//! profile enters and leaves each cell.

use super::SpeedProblem;
use crate::trajectory::{SpeedKnot, SpeedProfile};

/// Why a profile is not a proven plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ProofViolation {
    /// It does not end at rest.
    NotAtStandstill {
        /// Final speed, m/s.
        speed: f64,
    },
    /// It ends where resting is not allowed, or where an obstacle comes by before the horizon.
    UnsafeStandstill {
        /// Station of rest, m.
        station: f64,
    },
    /// It runs past the last node.
    PastTheEnd {
        /// Final station, m.
        station: f64,
    },
    /// A cell is blocked while the profile is in it.
    Blocked {
        /// Index of the cell.
        cell: usize,
        /// Time at which the profile enters it, s of the run.
        time: f64,
    },
    /// The speed cap of a cell is exceeded.
    TooFast {
        /// Index of the cell.
        cell: usize,
        /// Speed over the cap, m/s.
        excess: f64,
    },
    /// A deceleration above the aggressive one, or an acceleration above the comfortable one.
    TooHard {
        /// Time, s of the run.
        time: f64,
        /// Acceleration there, m/s².
        acceleration: f64,
    },
    /// It moves backwards.
    Backwards {
        /// Time, s of the run.
        time: f64,
    },
}

impl ProofViolation {
    /// Every code, in the order of the checks.
    pub const CODES: [&'static str; 7] =
        ["too_hard", "not_at_standstill", "past_the_end", "backwards", "blocked", "too_fast", "unsafe_standstill"];

    /// The stable code used in reports.
    #[must_use]
    pub fn code(self) -> &'static str {
        match self {
            Self::TooHard { .. } => "too_hard",
            Self::NotAtStandstill { .. } => "not_at_standstill",
            Self::PastTheEnd { .. } => "past_the_end",
            Self::Backwards { .. } => "backwards",
            Self::Blocked { .. } => "blocked",
            Self::TooFast { .. } => "too_fast",
            Self::UnsafeStandstill { .. } => "unsafe_standstill",
        }
    }
}

/// How far a profile may run past the last node (m): rounding of a quadratic program's solution, far below the
/// collision margins.
const STATION_SLACK: f64 = 1e-3;
/// Speed over a cap that is forgiven (m/s). Caps are comfort and rule limits, not edges of physics, and a jerk limit of
/// 1.8 m/s³ carries the speed on by 1.5²/(2·1.8) m/s when a cap appears in the middle of an acceleration.
const SPEED_SLACK: f64 = 0.7;
/// Jerk with which an acceleration that a profile starts with turns to braking, where a cap asks for it, m/s³: that of a
/// firm foot on the brake.
const RAMP_JERK: f64 = 5.0;
/// Acceleration over a limit that is forgiven (m/s²): tolerance of the quadratic program.
const ACCELERATION_SLACK: f64 = 0.02;
/// Distance within which the profile counts as standing on a node (m): far below any margin, far above rounding.
const ON_NODE: f64 = 1e-7;

/// Proves that the profile ends at rest in a safe state without entering a blocked cell, within speed_limits and accelerations.
/// The profile's time 0 is the problem's start time and its stations are those of the problem.
///
/// # Errors
/// The first violation met along the profile.
pub fn prove(problem: &SpeedProblem, profile: &SpeedProfile) -> Result<(), ProofViolation> {
    accelerations_hold(problem, profile)?;
    let end = profile.last();
    if !profile.ends_at_standstill() {
        return Err(ProofViolation::NotAtStandstill { speed: end.speed });
    }
    if end.station > problem.end() + STATION_SLACK {
        return Err(ProofViolation::PastTheEnd { station: end.station });
    }
    cells_hold(problem, profile)?;
    standstill_holds(problem, end.station, problem.start_time + end.time)
}

fn accelerations_hold(problem: &SpeedProblem, profile: &SpeedProfile) -> Result<(), ProofViolation> {
    let limits = &problem.limits;
    let start = profile.knots()[0].acceleration;
    // the vehicle may enter the cycle with more than the limits, and needs time to leave that state
    let highest = limits.acceleration.max(start) + ACCELERATION_SLACK;
    let lowest = (-limits.aggressive_deceleration).min(start) - ACCELERATION_SLACK;
    for pair in profile.knots().windows(2) {
        let before_next = pair[0].acceleration + pair[0].jerk * (pair[1].time - pair[0].time);
        for acceleration in [pair[0].acceleration, before_next] {
            if !(lowest..=highest).contains(&acceleration) {
                return Err(ProofViolation::TooHard { time: problem.start_time + pair[0].time, acceleration });
            }
        }
    }
    Ok(())
}

/// Every node passed, and every cell between two of them, must be free while the profile is there; speed_limits must hold.
fn cells_hold(problem: &SpeedProblem, profile: &SpeedProfile) -> Result<(), ProofViolation> {
    for pair in profile.knots().windows(2) {
        if pair[1].station < pair[0].station - STATION_SLACK {
            return Err(ProofViolation::Backwards { time: problem.start_time + pair[0].time });
        }
    }
    let absolute = |t: f64| problem.start_time + t;
    let mut leaves = last_time_at(profile, problem.stations[0]);
    for cell in 0..problem.cells() {
        let far_node = problem.stations[cell + 1];
        let arrives = first_time_at(profile, far_node);
        let until = arrives.unwrap_or(profile.duration());
        if profile.last().station > problem.stations[cell] + STATION_SLACK
            && problem.is_blocked(cell, absolute(leaves), absolute(until))
        {
            return Err(ProofViolation::Blocked { cell, time: absolute(leaves) });
        }
        cap_holds(problem, profile, cell, (leaves, until))?;
        let Some(arrives) = arrives else { break };
        leaves = last_time_at(profile, far_node);
        if problem.is_standstill_blocked(cell + 1, absolute(arrives), absolute(leaves)) {
            return Err(ProofViolation::Blocked { cell, time: absolute(arrives) });
        }
    }
    Ok(())
}

fn cap_holds(
    problem: &SpeedProblem,
    profile: &SpeedProfile,
    cell: usize,
    (from, to): (f64, f64),
) -> Result<(), ProofViolation> {
    let braked = braked_from(problem, &profile.knots()[0], cell);
    let first = profile.knots().partition_point(|k| k.time < from);
    let inner = profile.knots()[first..].iter().take_while(|k| k.time <= to).map(|k| k.speed);
    let fastest = inner.chain([from, to].map(|t| profile.at(t).speed)).fold(0.0, f64::max);
    let inside = fastest - problem.speed_limits[cell].max(problem.speed_limits[cell + 1]).max(braked);
    let arriving = profile.at(to).speed - problem.speed_limits[cell + 1].max(braked);
    // braking from above the cap is a start state's right, as long as it gets no faster
    let excess = inside.max(arriving);
    if excess > SPEED_SLACK { Err(ProofViolation::TooFast { cell, excess }) } else { Ok(()) }
}

/// First time at which the profile reaches a station, if it does.
pub(super) fn first_time_at(profile: &SpeedProfile, station: f64) -> Option<f64> {
    let knots = profile.knots();
    let after = knots.partition_point(|k| k.station < station - ON_NODE);
    let reached = knots.get(after)?;
    let before = if after == 0 { reached } else { &knots[after - 1] };
    Some(before.time + time_to(before, reached.time - before.time, station - ON_NODE))
}

/// Time at which the profile leaves a station for good; its end if it rests there.
pub(super) fn last_time_at(profile: &SpeedProfile, station: f64) -> f64 {
    let knots = profile.knots();
    let after = knots.partition_point(|k| k.station <= station + ON_NODE);
    match knots.get(after) {
        None => profile.duration(),
        Some(_) if after == 0 => knots[0].time,
        Some(left) => {
            let before = &knots[after - 1];
            before.time + time_to(before, left.time - before.time, station + ON_NODE)
        }
    }
}

/// Seconds after `knot` until `station` is reached, which is not before it and not beyond where the profile is `length`
/// seconds later: Newton's method, kept inside a bracket that is halved where it fails.
fn time_to(knot: &SpeedKnot, length: f64, station: f64) -> f64 {
    /// Far above rounding, and at any speed far below [`ON_NODE`].
    const ACCURACY: f64 = 1e-10;
    /// Halvings alone get from an hour to the accuracy in so many.
    const MOST_STEPS: usize = 60;
    let (mut lower, mut upper) = (0.0, length);
    let mut time = upper;
    for _ in 0..MOST_STEPS {
        let here = knot.after(time);
        let beyond = here.station - station;
        if beyond >= 0.0 {
            upper = time
        } else {
            lower = time
        }
        let newton = time - beyond / here.speed;
        let next = if (lower..=upper).contains(&newton) { newton } else { f64::midpoint(lower, upper) };
        let is_there = (next - time).abs() < ACCURACY;
        time = next;
        if is_there {
            break;
        }
    }
    time
}

/// Speed left in `cell` when braking comfortably from the start of the problem, to which the start's acceleration turns
/// within [`RAMP_JERK`].
fn braked_from(problem: &SpeedProblem, start: &SpeedKnot, cell: usize) -> f64 {
    let run = problem.stations[cell] - problem.stations[0];
    let braking = problem.limits.deceleration;
    let turning = ((start.acceleration + braking) / RAMP_JERK).max(0.0);
    let turned = SpeedKnot { jerk: -RAMP_JERK, ..*start }.after(turning);
    let beyond = run - (turned.station - start.station);
    if beyond <= 0.0 {
        // not yet turned: no more than the fastest on the way
        return start.speed + start.acceleration.max(0.0).powi(2) / (2.0 * RAMP_JERK);
    }
    (turned.speed * turned.speed - 2.0 * braking * beyond).max(0.0).sqrt()
}

fn standstill_holds(problem: &SpeedProblem, station: f64, time: f64) -> Result<(), ProofViolation> {
    // the nodes around the station: rest must be allowed at both, and free in the cell between them
    let after = problem.stations.partition_point(|&s| s < station - STATION_SLACK).min(problem.cells());
    let on_node = (problem.stations[after] - station).abs() <= STATION_SLACK;
    let safe = if on_node {
        problem.is_safe_standstill(after, time)
    } else {
        let before = after.saturating_sub(1);
        problem.stopping_allowed[before]
            && problem.stopping_allowed[after]
            && !problem.is_blocked(before, time, problem.horizon.max(time))
    };
    if safe { Ok(()) } else { Err(ProofViolation::UnsafeStandstill { station }) }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::*;

    /// 10 m/s for `cruise` seconds, then −2 m/s² to rest.
    fn cruise_and_brake(cruise: f64) -> SpeedProfile {
        let knot = |time, station, speed, acceleration| SpeedKnot { time, station, speed, acceleration, jerk: 0.0 };
        SpeedProfile::new(vec![
            knot(0.0, 0.0, 10.0, 0.0),
            knot(cruise, 10.0 * cruise, 10.0, -2.0),
            knot(cruise + 5.0, 10.0 * cruise + 25.0, 0.0, 0.0),
        ])
        .unwrap()
    }

    #[test]
    fn each_violation_is_named_and_the_clean_profile_passes() {
        let clean = empty_road(60.0, 10.0);
        assert_eq!(prove(&clean, &cruise_and_brake(2.0)), Ok(()));
        assert!(matches!(
            prove(&empty_road(40.0, 10.0), &cruise_and_brake(2.0)),
            Err(ProofViolation::PastTheEnd { .. })
        ));

        let mut blocked = clean.clone();
        blocked.blocked[20] = vec![(1.04, 1.2)]; // the cell from 10.0 to 10.5 m is crossed from 1.00 to 1.05 s
        assert!(matches!(prove(&blocked, &cruise_and_brake(2.0)), Err(ProofViolation::Blocked { cell: 20, .. })));
        blocked.blocked[20] = vec![(0.0, 0.99), (1.06, 9.0)];
        assert_eq!(prove(&blocked, &cruise_and_brake(2.0)), Ok(()));

        let mut capped = clean.clone();
        capped.speed_limits[61] = 4.0;
        assert!(matches!(prove(&capped, &cruise_and_brake(2.0)), Err(ProofViolation::TooFast { cell: 60, .. })));

        let mut junction = clean.clone();
        junction.stopping_allowed[90] = false; // rest is at 45 m
        assert!(matches!(prove(&junction, &cruise_and_brake(2.0)), Err(ProofViolation::UnsafeStandstill { .. })));

        let mut visited = clean.clone();
        visited.blocked[89] = vec![(20.0, 21.0)];
        visited.blocked[90] = vec![(20.0, 21.0)];
        assert!(matches!(prove(&visited, &cruise_and_brake(2.0)), Err(ProofViolation::UnsafeStandstill { .. })));

        let mut gentle = clean;
        gentle.limits.aggressive_deceleration = 1.9;
        assert!(matches!(prove(&gentle, &cruise_and_brake(2.0)), Err(ProofViolation::TooHard { .. })));
    }

    #[test]
    fn times_at_stations_are_those_of_plain_halving_standing_start_and_stop_included() {
        let profile = cruise_and_brake(1.0);
        let pieces = [
            (profile.knots()[0], 1.0),
            (profile.knots()[1], 5.0),
            (SpeedKnot { time: 0.0, station: 0.0, speed: 0.0, acceleration: 0.0, jerk: 0.7 }, 3.0),
            (SpeedKnot { time: 0.0, station: 5.0, speed: 2.0, acceleration: -1.0, jerk: 0.25 }, 4.0),
        ];
        for (knot, length) in pieces {
            let end = knot.after(length).station;
            for i in 0..=50 {
                let station = knot.station + (end - knot.station) * f64::from(i) / 50.0;
                let (mut lower, mut upper) = (0.0, length);
                for _ in 0..80 {
                    let middle = f64::midpoint(lower, upper);
                    if knot.after(middle).station >= station { upper = middle } else { lower = middle }
                }
                let found = time_to(&knot, length, station);
                assert!((knot.after(found).station - station).abs() < 1e-9, "{station} at {found}");
                // where it hardly moves the times may differ, the stations not
                assert!((found - upper).abs() < 1e-4, "{found} against {upper}");
            }
        }
    }

    #[test]
    fn a_profile_that_never_stops_is_refuted() {
        let knot = |time, station| SpeedKnot { time, station, speed: 10.0, acceleration: 0.0, jerk: 0.0 };
        let profile = SpeedProfile::new(vec![knot(0.0, 0.0), knot(3.0, 30.0)]).unwrap();
        assert_eq!(prove(&empty_road(60.0, 10.0), &profile), Err(ProofViolation::NotAtStandstill { speed: 10.0 }));
    }
}
