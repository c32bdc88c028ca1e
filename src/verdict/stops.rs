//! `stops`: at rest where the plan said. `stop_proven`: every cycle committed to a trajectory that ends at rest.

use super::{Check, Expectation, Settings, Status};
use crate::geometry::Point;
use crate::planner::{Cycle, Decision};
use crate::simulation::Log;
use crate::trajectory::Trajectory;

/// A trajectory with less than this left to drive (m) says nothing about where the stop was meant to be.
const STOPPED_ALREADY: f64 = 0.01;

/// Speed below which a planned vehicle is at rest, m/s: rounding of a profile's last knot.
const PLANNED_REST: f64 = 1e-3;

/// How long after its planned stop a vehicle may still roll before it counts as not stopping, s.
const SETTLING: f64 = 1.0;

/// Signed stop error of a run that ended at rest, m, positive beyond the planned stop; with the time of coming to rest.
///
/// The planned stop is the next standstill of the last trajectory that still had a way to go when it was committed,
/// before the vehicle came to rest: a plan made at rest starts where the vehicle stands and would hide the error.
/// `None` if it did not end at rest, never moved, or no such trajectory exists.
pub(super) fn stop_error(cycles: &[Cycle], log: &Log, standstill_speed: f64) -> Option<(f64, f64)> {
    let (rest_from, position) = final_rest(log, standstill_speed)?;
    let (trajectory, station) = cycles.iter().rev().filter(|c| c.time <= rest_from).find_map(|c| {
        Some((&c.committed, next_stop(&c.committed, c.time).filter(|s| s.ahead > STOPPED_ALREADY)?.station))
    })?;
    let planned = trajectory.path.at(station).pose;
    Some((planned.to_local(position).x, rest_from))
}

/// Start of the final standstill and the position of rest; `None` if the run ended moving or never moved.
fn final_rest(log: &Log, standstill_speed: f64) -> Option<(f64, Point)> {
    let last = log.samples.last()?;
    let last_moving = log.samples.iter().rposition(|s| s.speed.abs() > standstill_speed)?;
    let rest = log.samples.get(last_moving + 1)?;
    Some((rest.time, last.pose.position))
}

/// Where a trajectory comes to rest next.
struct NextStop {
    station: f64,
    /// Distance to it, m.
    ahead: f64,
}

/// The first standstill of a trajectory that lies ahead of where it is at `time`; its end, if it has no other.
fn next_stop(trajectory: &Trajectory, time: f64) -> Option<NextStop> {
    let profile = &trajectory.profile;
    let now = profile.at(time - trajectory.start_time);
    let ahead = |k: &&crate::trajectory::SpeedKnot| k.time > now.time && k.station > now.station + STOPPED_ALREADY;
    let knot = profile.knots().iter().filter(ahead).find(|k| k.speed <= PLANNED_REST).or(profile.knots().last())?;
    Some(NextStop { station: knot.station, ahead: knot.station - now.station })
}

/// The check; `None` when the run had no stop to make.
pub(super) fn stops(cycles: &[Cycle], log: &Log, settings: &Settings) -> Option<Check> {
    let last = log.samples.last()?;
    let check = |pass, value, limit, unit, at_time, note| {
        Some(Check { name: "stops", status: Status::of(pass), value, limit, unit, at_time: Some(at_time), note })
    };
    if last.speed.abs() > settings.standstill_speed {
        let planned =
            cycles.last().filter(|c| c.committed.profile.ends_at_standstill()).map(|c| c.committed.end_time());
        let overdue = planned.is_some_and(|t| last.time > t + SETTLING);
        let note = format!("still moving at the end of the run, {:.1} s", last.time);
        let due = settings.expect == Expectation::Stop || overdue;
        return if due {
            check(false, last.speed.abs(), settings.standstill_speed, "m/s", last.time, note)
        } else {
            None
        };
    }
    match stop_error(cycles, log, settings.standstill_speed) {
        Some((error, time)) => {
            let limit = if error > 0.0 { settings.stop_past } else { settings.stop_short };
            let side = if error > 0.0 { "beyond" } else { "before" };
            let note =
                format!("at rest {:.3} m {side} the planned stop (signed stop error {error:+.3} m)", error.abs());
            check(error.abs() <= limit, error.abs(), limit, "m", time, note)
        }
        None if settings.expect == Expectation::Stop => {
            let note = "at rest; it never moved, or no trajectory with a stop ahead was committed before".into();
            check(true, last.speed.abs(), settings.standstill_speed, "m/s", last.time, note)
        }
        None => None,
    }
}

/// The check: the share of cycles whose committed trajectory is proven and does end at rest.
pub(super) fn stop_proven(cycles: &[Cycle]) -> Check {
    let unproven = |c: &&Cycle| c.decision == Decision::Unproven || !c.committed.profile.ends_at_standstill();
    let bad = cycles.iter().filter(unproven).count();
    let kept = cycles.iter().filter(|c| c.decision == Decision::KeepPrevious).count();
    let share = if cycles.is_empty() { 0.0 } else { (cycles.len() - bad) as f64 / cycles.len() as f64 };
    Check {
        name: "stop_proven",
        status: Status::of(bad == 0 && !cycles.is_empty()),
        value: share,
        limit: 1.0,
        unit: "share",
        at_time: cycles.iter().find(unproven).map(|c| c.time),
        note: format!(
            "{} cycles, {bad} without a proven stop, {kept} went on along the last proven plan",
            cycles.len()
        ),
    }
}
