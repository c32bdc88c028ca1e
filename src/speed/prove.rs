//! Verification of a speed profile against its problem.
//!
//! The proof shares no code with the searches. It computes the times at which the profile enters and leaves each cell
//! and checks acceleration, speed, blocked intervals and the final standstill. It accepts any profile of constant jerk
//! between knots, raw or smoothed.

use super::SpeedProblem;
use crate::trajectory::{SpeedKnot, SpeedProfile};

/// Condition of the proof that a profile violates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ProofViolation {
    /// The profile does not end at standstill.
    NotAtStandstill {
        /// Final speed, m/s.
        speed: f64,
    },
    /// The profile ends where stopping is not allowed, or where an obstacle passes before the horizon.
    UnsafeStandstill {
        /// Station of the standstill, m.
        station: f64,
    },
    /// The profile ends beyond the last node.
    PastTheEnd {
        /// Final station, m.
        station: f64,
    },
    /// A cell is blocked while the vehicle is in it.
    Blocked {
        /// Index of the cell.
        cell: usize,
        /// Time at which the vehicle enters the cell, s of the run.
        time: f64,
    },
    /// The vehicle exceeds the speed limit of a cell.
    TooFast {
        /// Index of the cell.
        cell: usize,
        /// Speed above the limit, m/s.
        excess: f64,
    },
    /// The deceleration exceeds the aggressive one, or the acceleration exceeds the comfortable one.
    TooHard {
        /// Time, s of the run.
        time: f64,
        /// Acceleration at that time, m/s².
        acceleration: f64,
    },
    /// The profile moves backwards.
    Backwards {
        /// Time, s of the run.
        time: f64,
    },
}

impl ProofViolation {
    /// All codes.
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

/// Tolerance of stations, m: the accuracy of a quadratic program's solution, far below the collision margins.
const STATION_SLACK: f64 = 1e-3;
/// Tolerance of speed limits, as a share: 10 % of lateral acceleration, which limits by comfort leave to the controller. A limit
/// that appears during an acceleration is exceeded for a moment by every jerk-limited profile.
const SPEED_SLACK: f64 = 0.05;
/// Tolerance of the speed while the vehicle brakes from a start above a limit, m/s: the jerk of comfortable braking is below
/// [`RAMP_JERK`].
const BRAKING_SLACK: f64 = 0.7;
/// Jerk of the transition from the start acceleration to braking, m/s³: that of a firm brake application. It bounds the
/// speed at which a start above a speed limit is excused.
const RAMP_JERK: f64 = 5.0;
/// Jerk with which a start that brakes harder than the limit releases the brakes at least, m/s³: that of comfortable driving.
const RELEASE_JERK: f64 = 1.5;
/// Tolerance of acceleration limits, m/s²: the accuracy of a quadratic program's solution.
const ACCELERATION_SLACK: f64 = 0.02;
/// A profile this close to a node counts as on the node, m: far below any margin, far above rounding errors.
const ON_NODE: f64 = 1e-7;

/// Proves that a profile ends in a safe state, enters no blocked cell and keeps the limits of speed and acceleration,
/// within small tolerances. Time 0 of the profile is the start time of the problem; both use the same stations.
///
/// # Errors
/// The first violation found.
pub fn prove(problem: &SpeedProblem, profile: &SpeedProfile) -> Result<(), ProofViolation> {
    check_accelerations(problem, profile)?;
    let end = profile.last();
    if !profile.ends_at_standstill() {
        return Err(ProofViolation::NotAtStandstill { speed: end.speed });
    }
    if end.station > problem.end() + STATION_SLACK {
        return Err(ProofViolation::PastTheEnd { station: end.station });
    }
    check_cells(problem, profile)?;
    check_standstill(problem, end.station, problem.start_time + end.time)
}

fn check_accelerations(problem: &SpeedProblem, profile: &SpeedProfile) -> Result<(), ProofViolation> {
    let limits = &problem.limits;
    let (begins, start) = (profile.knots()[0].time, profile.knots()[0].acceleration);
    // the start acceleration may exceed the limits and takes time to decay
    let highest = limits.acceleration.max(start) + ACCELERATION_SLACK;
    let lowest = |time: f64| {
        let released = start + RELEASE_JERK * (time - begins);
        released.min(-limits.aggressive_deceleration) - ACCELERATION_SLACK
    };
    let released = begins + (-limits.aggressive_deceleration - start).max(0.0) / RELEASE_JERK;
    for pair in profile.knots().windows(2) {
        // the limit is concave: between two knots it is exceeded at a knot, or where the release ends
        for time in [pair[0].time, released.clamp(pair[0].time, pair[1].time), pair[1].time] {
            let acceleration = pair[0].acceleration + pair[0].jerk * (time - pair[0].time);
            if !(lowest(time)..=highest).contains(&acceleration) {
                return Err(ProofViolation::TooHard { time: problem.start_time + time, acceleration });
            }
        }
    }
    Ok(())
}

/// Checks that every visited node and cell is free during the visit, and that speeds keep their limits.
fn check_cells(problem: &SpeedProblem, profile: &SpeedProfile) -> Result<(), ProofViolation> {
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
        check_speed(problem, profile, cell, (leaves, until))?;
        let Some(arrives) = arrives else { break };
        leaves = last_time_at(profile, far_node);
        if problem.is_standstill_blocked(cell + 1, absolute(arrives), absolute(leaves)) {
            return Err(ProofViolation::Blocked { cell, time: absolute(arrives) });
        }
    }
    Ok(())
}

/// Checks the speeds in a cell during the visit `[from, to]`, s of the profile.
fn check_speed(
    problem: &SpeedProblem,
    profile: &SpeedProfile,
    cell: usize,
    (from, to): (f64, f64),
) -> Result<(), ProofViolation> {
    let braked = braked_speed(problem, &profile.knots()[0], cell);
    let first = profile.knots().partition_point(|k| k.time < from);
    let inner = profile.knots()[first..].iter().take_while(|k| k.time <= to).map(|k| k.speed);
    let fastest = inner.chain([from, to].map(|t| profile.at(t).speed)).fold(0.0, f64::max);
    let excess = |speed: f64, limit: f64| speed - ((1.0 + SPEED_SLACK) * limit).max(braked + BRAKING_SLACK);
    let inside = excess(fastest, problem.speed_limits[cell].max(problem.speed_limits[cell + 1]));
    let arriving = excess(profile.at(to).speed, problem.speed_limits[cell + 1]);
    // a start above the speed limit is excused while the vehicle brakes
    let excess = inside.max(arriving);
    if excess > 0.0 { Err(ProofViolation::TooFast { cell, excess }) } else { Ok(()) }
}

/// First time at which the profile reaches a station (m), s of the profile. `None` if it never does.
pub(crate) fn first_time_at(profile: &SpeedProfile, station: f64) -> Option<f64> {
    let knots = profile.knots();
    let after = knots.partition_point(|k| k.station < station - ON_NODE);
    let reached = knots.get(after)?;
    let before = if after == 0 { reached } else { &knots[after - 1] };
    Some(before.time + time_to(before, reached.time - before.time, station - ON_NODE))
}

/// Last time at which the profile is at a station (m), s of the profile; its duration if it stops there.
pub(crate) fn last_time_at(profile: &SpeedProfile, station: f64) -> f64 {
    let knots = profile.knots();
    let after = knots.partition_point(|k| k.station <= station + ON_NODE);
    match knots.get(after) {
        None => profile.duration(),
        Some(_) if after == 0 => knots[0].time,
        Some(beyond) => {
            let before = &knots[after - 1];
            before.time + time_to(before, beyond.time - before.time, station + ON_NODE)
        }
    }
}

/// Time after `knot` at which the profile reaches `station` (m), s. The station must lie between those at the knot and
/// `duration` (s) later. Newton's method, safeguarded by bisection.
fn time_to(knot: &SpeedKnot, duration: f64, station: f64) -> f64 {
    /// Far above rounding errors; at any speed, the distance is far below [`ON_NODE`].
    const ACCURACY: f64 = 1e-10;
    /// Enough for bisection alone to reach the accuracy from a bracket of one hour.
    const MAX_STEPS: usize = 60;
    let (mut lower, mut upper) = (0.0, duration);
    let mut time = upper;
    for _ in 0..MAX_STEPS {
        let here = knot.after(time);
        let beyond = here.station - station;
        if beyond >= 0.0 {
            upper = time
        } else {
            lower = time
        }
        let newton = time - beyond / here.speed;
        let next = if (lower..=upper).contains(&newton) { newton } else { f64::midpoint(lower, upper) };
        let converged = (next - time).abs() < ACCURACY;
        time = next;
        if converged {
            break;
        }
    }
    time
}

/// Speed at the near node of `cell`, m/s, of a vehicle that brakes comfortably from the start. Its acceleration changes
/// from the start acceleration to the deceleration with [`RAMP_JERK`].
fn braked_speed(problem: &SpeedProblem, start: &SpeedKnot, cell: usize) -> f64 {
    let distance = problem.stations[cell] - problem.stations[0];
    let braking = problem.limits.deceleration;
    let ramp_time = ((start.acceleration + braking) / RAMP_JERK).max(0.0);
    let ramp_end = SpeedKnot { jerk: -RAMP_JERK, ..*start }.after(ramp_time);
    let beyond = distance - (ramp_end.station - start.station);
    if beyond <= 0.0 {
        // still on the ramp: the peak speed is an upper bound
        return start.speed + start.acceleration.max(0.0).powi(2) / (2.0 * RAMP_JERK);
    }
    (ramp_end.speed * ramp_end.speed - 2.0 * braking * beyond).max(0.0).sqrt()
}

fn check_standstill(problem: &SpeedProblem, station: f64, time: f64) -> Result<(), ProofViolation> {
    // between two nodes, stopping must be allowed at both and the cell between them must be free
    let after = problem.stations.partition_point(|&s| s < station - STATION_SLACK).min(problem.cells());
    let on_node = (problem.stations[after] - station).abs() <= STATION_SLACK;
    let is_safe = if on_node {
        problem.is_safe_standstill(after, time)
    } else {
        let before = after.saturating_sub(1);
        problem.stopping_allowed[before]
            && problem.stopping_allowed[after]
            && !problem.is_blocked(before, time, problem.horizon.max(time))
    };
    if is_safe { Ok(()) } else { Err(ProofViolation::UnsafeStandstill { station }) }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::*;

    /// 10 m/s for `cruise` seconds, then −2 m/s² to standstill.
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
    fn proves_a_valid_profile_and_names_each_violation() {
        let valid = empty_road(60.0, 10.0);
        assert_eq!(prove(&valid, &cruise_and_brake(2.0)), Ok(()));
        assert!(matches!(
            prove(&empty_road(40.0, 10.0), &cruise_and_brake(2.0)),
            Err(ProofViolation::PastTheEnd { .. })
        ));

        let mut blocked = valid.clone();
        blocked.blocked[20] = vec![(1.04, 1.2)]; // the vehicle is in the cell from 10.0 to 10.5 m from 1.00 to 1.05 s
        assert!(matches!(prove(&blocked, &cruise_and_brake(2.0)), Err(ProofViolation::Blocked { cell: 20, .. })));
        blocked.blocked[20] = vec![(0.0, 0.99), (1.06, 9.0)];
        assert_eq!(prove(&blocked, &cruise_and_brake(2.0)), Ok(()));

        let mut limited = valid.clone();
        limited.speed_limits[61] = 4.0;
        assert!(matches!(prove(&limited, &cruise_and_brake(2.0)), Err(ProofViolation::TooFast { cell: 60, .. })));

        let mut junction = valid.clone();
        junction.stopping_allowed[90] = false; // the profile stops at 45 m
        assert!(matches!(prove(&junction, &cruise_and_brake(2.0)), Err(ProofViolation::UnsafeStandstill { .. })));

        let mut passed = valid.clone();
        passed.blocked[89] = vec![(20.0, 21.0)];
        passed.blocked[90] = vec![(20.0, 21.0)];
        assert!(matches!(prove(&passed, &cruise_and_brake(2.0)), Err(ProofViolation::UnsafeStandstill { .. })));

        let mut gentle = valid;
        gentle.limits.aggressive_deceleration = 1.9;
        assert!(matches!(prove(&gentle, &cruise_and_brake(2.0)), Err(ProofViolation::TooHard { .. })));
    }

    /// A start that brakes at 3 m/s² where 2 m/s² are permitted releases the brakes at 1.5 m/s³: after 2/3 s.
    #[test]
    fn a_hard_start_is_excused_while_it_is_released() {
        for (jerk, is_proven) in [(1.6, true), (1.4, false)] {
            let start = SpeedKnot { time: 0.0, station: 0.0, speed: 10.0, acceleration: -3.0, jerk };
            let then = SpeedKnot { acceleration: -2.0, jerk: 0.0, ..start.after(1.0 / jerk) };
            let rest = SpeedKnot { acceleration: 0.0, ..then.after(then.speed / 2.0) };
            let profile = SpeedProfile::new(vec![start, then, SpeedKnot { speed: 0.0, ..rest }]).unwrap();
            let mut problem = empty_road(60.0, 10.0);
            problem.limits.aggressive_deceleration = 2.0;
            assert_eq!(prove(&problem, &profile).is_ok(), is_proven, "{jerk} m/s³");
        }
    }

    /// 5 % of a limit, whatever the limit is: at 4 m/s, 0.7 m/s would be 38 % of lateral acceleration.
    #[test]
    fn forgives_a_share_of_a_speed_limit() {
        for limit in [4.0, 12.0] {
            for (share, is_proven) in [(1.04, true), (1.06, false)] {
                let speed = share * limit;
                let knot =
                    |time, station, speed, acceleration| SpeedKnot { time, station, speed, acceleration, jerk: 0.0 };
                let stop = (speed / 2.0, speed * speed / 4.0);
                let profile = SpeedProfile::new(vec![
                    knot(0.0, 0.0, speed, 0.0),
                    knot(20.0 / speed, 20.0, speed, -2.0),
                    knot(20.0 / speed + stop.0, 20.0 + stop.1, 0.0, 0.0),
                ]);
                let mut problem = empty_road(80.0, 0.0);
                problem.speed_limits.fill(limit);
                assert_eq!(prove(&problem, &profile.unwrap()).is_ok(), is_proven, "{speed} m/s, limit {limit} m/s");
            }
        }
    }

    #[test]
    fn time_at_a_station_matches_plain_bisection() {
        let profile = cruise_and_brake(1.0);
        let pieces = [
            (profile.knots()[0], 1.0),
            (profile.knots()[1], 5.0),
            (SpeedKnot { time: 0.0, station: 0.0, speed: 0.0, acceleration: 0.0, jerk: 0.7 }, 3.0),
            (SpeedKnot { time: 0.0, station: 5.0, speed: 2.0, acceleration: -1.0, jerk: 0.25 }, 4.0),
        ];
        for (knot, duration) in pieces {
            let end = knot.after(duration).station;
            for i in 0..=50 {
                let station = knot.station + (end - knot.station) * f64::from(i) / 50.0;
                let (mut lower, mut upper) = (0.0, duration);
                for _ in 0..80 {
                    let middle = f64::midpoint(lower, upper);
                    if knot.after(middle).station >= station { upper = middle } else { lower = middle }
                }
                let found = time_to(&knot, duration, station);
                assert!((knot.after(found).station - station).abs() < 1e-9, "{station} at {found}");
                // near standstill the times may differ, the stations may not
                assert!((found - upper).abs() < 1e-4, "{found} against {upper}");
            }
        }
    }

    #[test]
    fn rejects_a_profile_that_does_not_stop() {
        let knot = |time, station| SpeedKnot { time, station, speed: 10.0, acceleration: 0.0, jerk: 0.0 };
        let profile = SpeedProfile::new(vec![knot(0.0, 0.0), knot(3.0, 30.0)]).unwrap();
        assert_eq!(prove(&empty_road(60.0, 10.0), &profile), Err(ProofViolation::NotAtStandstill { speed: 10.0 }));
    }
}
