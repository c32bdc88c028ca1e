//! `stops`: the run stopped where the plan said. `stop_proven`: every cycle committed to a trajectory that ends at standstill.

use super::{Check, Expectation, Settings, Status};
use crate::geometry::Point;
use crate::number::Short;
use crate::planner::{Cycle, Decision};
use crate::simulation::Log;
use crate::trajectory::Trajectory;

/// A trajectory with less than this left to drive (m) does not say where the stop was planned.
const STOPPED_ALREADY: f64 = 0.01;

/// A planned speed below this is standstill, m/s: the last knot of a profile is rounded.
const PLANNED_STANDSTILL: f64 = 1e-3;

/// Time after the planned stop by which the vehicle must have stopped, s.
const SETTLING: f64 = 1.0;

/// Signed stop error of a run that ended at standstill, m, positive beyond the planned stop; with the begin of the standstill,
/// s.
///
/// The planned stop is the next standstill of the last trajectory that was committed before the vehicle stopped and still had
/// a distance to drive. A plan made at standstill starts at the vehicle and would hide the error. `None` if the run ended
/// moving, the vehicle never moved, or there is no such trajectory.
pub(super) fn stop_error(cycles: &[Cycle], log: &Log, standstill_speed: f64) -> Option<(f64, f64)> {
    let (since, position) = final_standstill(log, standstill_speed)?;
    let (trajectory, station) = cycles.iter().rev().filter(|c| c.plan.time <= since).find_map(|c| {
        Some((
            &c.plan.trajectory,
            next_stop(&c.plan.trajectory, c.plan.time).filter(|s| s.ahead > STOPPED_ALREADY)?.station,
        ))
    })?;
    let planned = trajectory.path.at(station).pose;
    Some((planned.to_local(position).x, since))
}

/// Begin (s) and position of the final standstill; `None` if the run ended moving or the vehicle never moved.
fn final_standstill(log: &Log, standstill_speed: f64) -> Option<(f64, Point)> {
    let last = log.samples.last()?;
    let last_moving = log.samples.iter().rposition(|s| s.speed.abs() > standstill_speed)?;
    let first_stopped = log.samples.get(last_moving + 1)?;
    Some((first_stopped.time, last.pose.position))
}

/// The next standstill of a trajectory.
struct NextStop {
    station: f64,
    /// Distance to it, m.
    ahead: f64,
}

/// The first standstill of a trajectory ahead of its point at `time`; its end if there is no other.
fn next_stop(trajectory: &Trajectory, time: f64) -> Option<NextStop> {
    let profile = &trajectory.profile;
    let now = profile.at(time - trajectory.start_time);
    let ahead = |k: &&crate::trajectory::SpeedKnot| k.time > now.time && k.station > now.station + STOPPED_ALREADY;
    let knot =
        profile.knots().iter().filter(ahead).find(|k| k.speed <= PLANNED_STANDSTILL).or(profile.knots().last())?;
    Some(NextStop { station: knot.station, ahead: knot.station - now.station })
}

const NAME: &str = "stops";

/// The check. It does not apply to a run that had no stop to make.
pub(super) fn stops(cycles: &[Cycle], log: &Log, settings: &Settings) -> Check {
    let Some(last) = log.samples.last() else { return Check::not_applicable(NAME, "m", "the log is empty") };
    if last.speed.abs() > settings.standstill_speed {
        let planned = cycles
            .last()
            .filter(|c| c.plan.trajectory.profile.ends_at_standstill())
            .map(|c| c.plan.trajectory.end_time());
        return ended_moving(last.speed.abs(), last.time, planned, settings);
    }
    let asked = settings.expect == Expectation::Stop;
    match stop_error(cycles, log, settings.standstill_speed) {
        Some((error, time)) => {
            let (limit, side) =
                if error > 0.0 { (settings.stop_past, "beyond") } else { (settings.stop_short, "before") };
            Check {
                name: NAME,
                status: Status::of(error.abs() <= limit),
                value: error.abs(),
                limit,
                unit: "m",
                at_time: Some(time),
                impact: None,
                note: format!(
                    "stopped {:.2} m {side} the planned stop at {time:.2} s; limit {limit:.2} m",
                    Short(error.abs())
                ),
                method: "distance of the rear axle from the planned stop along the planned heading".into(),
            }
        }
        None if asked => Check {
            name: NAME,
            status: Status::Pass,
            value: last.speed.abs(),
            limit: settings.standstill_speed,
            unit: "m/s",
            at_time: Some(last.time),
            impact: None,
            note: "stood still; no committed trajectory had a stop ahead".into(),
            method: "speed at the end of the run".into(),
        },
        None => Check::not_applicable(NAME, "m", "no committed trajectory had a stop ahead"),
    }
}

/// The check for a run that ended moving: it fails if a stop was asked for or is overdue. `planned` is the time of the planned
/// stop, s.
fn ended_moving(speed: f64, time: f64, planned: Option<f64>, settings: &Settings) -> Check {
    let overdue = planned.filter(|stop| time > stop + SETTLING);
    if settings.expect != Expectation::Stop && overdue.is_none() {
        return Check::not_applicable(NAME, "m", "the run ended moving, before the planned stop was due");
    }
    let late = overdue.map_or_else(String::new, |stop| format!(", {:.1} s after the planned stop", time - stop));
    Check {
        name: NAME,
        status: Status::Fail,
        value: speed,
        limit: settings.standstill_speed,
        unit: "m/s",
        at_time: Some(time),
        impact: None,
        note: format!(
            "still moved at {:.2} m/s at the end of the run, {time:.2} s{late}; limit {:.2} m/s",
            Short(speed),
            settings.standstill_speed
        ),
        method: "speed at the end of the run".into(),
    }
}

/// The check: the share of cycles whose committed trajectory is proven and ends at standstill.
pub(super) fn stop_proven(cycles: &[Cycle]) -> Check {
    let unproven =
        |c: &&Cycle| c.plan.decision == Decision::Unproven || !c.plan.trajectory.profile.ends_at_standstill();
    let (all, bad) = (cycles.len(), cycles.iter().filter(unproven).count());
    let kept = cycles.iter().filter(|c| c.plan.decision == Decision::KeepPrevious).count();
    let first = cycles.iter().find(unproven).map(|c| c.plan.time);
    Check {
        name: "stop_proven",
        status: Status::of(bad == 0 && all > 0),
        value: if all == 0 { 0.0 } else { (all - bad) as f64 / all as f64 },
        limit: 1.0,
        unit: "share",
        at_time: first,
        impact: None,
        note: match first {
            _ if all == 0 => "no planning cycle ran".into(),
            Some(time) => {
                format!("{bad} of {all} cycles committed to no proven stop, the first at {time:.2} s")
            }
            None => format!("all {all} cycles committed to a proven stop; {kept} kept the previous plan"),
        },
        method: "share of cycles whose decision claims a proof and whose trajectory ends at standstill".into(),
    }
}
