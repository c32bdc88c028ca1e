//! Metrics of a run, without limits: distance, speed, smoothness, clearance.

use serde::Serialize;

use super::comfort::FilteredMotion;
use super::tracking::tracking_error;
use super::{Settings, contact, stops};
use crate::geometry::polyline::Polyline;
use crate::map::Scenario;
use crate::planner::{Cycle, Decision};
use crate::simulation::Log;
use crate::trajectory::Trajectory;
use crate::vehicle::Vehicle;

/// Metrics of a run. Accelerations and jerk are filtered as in the comfort checks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Metrics {
    /// Distance driven by the rear axle, m.
    pub distance_m: f64,
    /// Time driven, s.
    pub duration_s: f64,
    /// Distance over duration, m/s.
    pub mean_speed_mps: f64,
    /// Largest speed, m/s.
    pub max_speed_mps: f64,
    /// Largest longitudinal acceleration or deceleration, m/s².
    pub max_abs_acceleration_mps2: f64,
    /// Largest lateral acceleration, m/s².
    pub max_abs_lateral_acceleration_mps2: f64,
    /// Largest longitudinal jerk, m/s³.
    pub max_abs_jerk_mps3: f64,
    /// Signed distance of the final position from the planned stop, m, positive beyond it; `None` if it did not stop.
    pub stop_error_m: Option<f64>,
    /// Smallest distance to any obstacle or occupied cell, m, 0 on contact; `None` without any. Cells farther away than 10 m
    /// are ignored.
    pub min_clearance_m: Option<f64>,
    /// Plan switches per minute of the run. A switch is a planning cycle whose path lies more than 0.5 m beside the path
    /// committed one cycle before, at some point ahead of the vehicle that both paths reach. A longer path, or another speed
    /// on the same path, is no switch. A switch and its reversal are two.
    pub plan_switches_per_minute: f64,
    /// Cycles that kept the previous plan.
    pub kept_plans: usize,
    /// Largest distance from the reference pose, m.
    pub max_tracking_error_m: f64,
    /// Its lateral part, in the frame of the reference pose, m.
    pub max_lateral_tracking_error_m: f64,
    /// Its longitudinal part, in the frame of the reference pose, m.
    pub max_longitudinal_tracking_error_m: f64,
}

/// Measures a run.
#[must_use]
pub fn metrics(scenario: &Scenario, vehicle: &Vehicle, cycles: &[Cycle], log: &Log, settings: &Settings) -> Metrics {
    let (Some(first), Some(last)) = (log.samples.first(), log.samples.last()) else { return Metrics::default() };
    let distance = log.samples.windows(2).map(|w| (w[1].pose.position - w[0].pose.position).norm()).sum::<f64>();
    let duration = last.time - first.time;
    let per = |amount: f64, time: f64| if time > 0.0 { amount / time } else { 0.0 };
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, |m: f64, v| m.max(v.abs()));
    let filtered = FilteredMotion::new(log, settings.comfort_cutoff);
    let errors: Vec<(f64, f64)> = log.samples.iter().map(tracking_error).collect();
    Metrics {
        distance_m: distance,
        duration_s: duration,
        mean_speed_mps: per(distance, duration),
        max_speed_mps: largest(&mut log.samples.iter().map(|s| s.speed)),
        max_abs_acceleration_mps2: largest(&mut filtered.moments.iter().map(|m| m.acceleration)),
        max_abs_lateral_acceleration_mps2: largest(&mut filtered.moments.iter().map(|m| m.lateral_acceleration)),
        max_abs_jerk_mps3: largest(&mut filtered.moments.iter().map(|m| m.jerk)),
        stop_error_m: stops::stop_error(cycles, log, settings.standstill_speed).map(|(error, _)| error),
        min_clearance_m: contact::nearest(scenario, vehicle, &contact::places(log)).map(|n| n.gap.max(0.0)),
        plan_switches_per_minute: 60.0 * per(plan_switches(cycles) as f64, duration),
        kept_plans: cycles.iter().filter(|c| c.plan.decision == Decision::KeepPrevious).count(),
        max_tracking_error_m: largest(&mut errors.iter().map(|e| e.0.hypot(e.1))),
        max_lateral_tracking_error_m: largest(&mut errors.iter().map(|e| e.1)),
        max_longitudinal_tracking_error_m: largest(&mut errors.iter().map(|e| e.0)),
    }
}

/// Cycles whose path departs from the path committed before.
fn plan_switches(cycles: &[Cycle]) -> usize {
    cycles.windows(2).filter(|w| departs(&w[0].plan.trajectory, &w[1].plan.trajectory, w[1].plan.time)).count()
}

/// Whether a new path lies more than half a metre beside the old one at some point ahead that both reach.
fn departs(old: &Trajectory, new: &Trajectory, time: f64) -> bool {
    /// Lateral difference that makes another plan, m.
    const SWITCH: f64 = 0.5;
    /// Spacing of the points compared, m.
    const SPACING: f64 = 1.0;
    if old.path == new.path {
        return false;
    }
    let Some(line) = Polyline::new(new.path.sampled(SPACING).into_iter().map(|(_, p)| p.pose.position)) else {
        return false;
    };
    let from = old.at(time).station;
    old.path.sampled(SPACING).into_iter().filter(|(station, _)| *station >= from).any(|(_, p)| {
        let there = line.project(p.pose.position);
        let beside = there.station > 0.0 && there.station < line.length();
        beside && there.offset.abs() > SWITCH
    })
}

#[cfg(test)]
mod tests {
    use super::super::testing::{DURATION, Story, cycle};
    use super::*;

    fn measured(s: &Story) -> Metrics {
        metrics(&s.scenario, &s.vehicle, &s.cycles, &s.log, &s.settings)
    }

    #[test]
    fn metrics_of_the_clean_run_match_the_closed_form() {
        let m = measured(&Story::clean());
        let close = |a: f64, b: f64| (a - b).abs() < 1e-6;
        assert!(close(m.distance_m, 72.0) && close(m.duration_s, DURATION), "{m:?}");
        assert!(close(m.mean_speed_mps, 72.0 / DURATION) && close(m.max_speed_mps, 8.0), "{m:?}");
        assert!(
            (m.max_abs_acceleration_mps2 - 2.0).abs() < 0.01 && m.max_abs_lateral_acceleration_mps2 == 0.0,
            "{m:?}"
        );
        assert!(m.stop_error_m.is_some_and(|e| e.abs() < 1e-6), "{m:?}");
        // beside the parked car: from y = 0.805 to y = 3.5 − 0.9
        assert!(m.min_clearance_m.is_some_and(|c| close(c, 1.795)), "{m:?}");
        assert_eq!((m.plan_switches_per_minute, m.kept_plans, m.max_tracking_error_m), (0.0, 0, 0.0));
    }

    #[test]
    fn stop_error_is_signed_and_tracking_error_split_by_direction() {
        let mut s = Story::clean();
        s.displace(|m| (0.07 * m.time.min(13.0) / 13.0, 0.0));
        let (ahead, left) = (s.log.samples[0].pose.forward(), s.log.samples[0].pose.left());
        s.log.samples[400].reference_pose.position += ahead * 0.3;
        s.log.samples[500].reference_pose.position += left * 0.2;
        let m = measured(&s);
        assert!((m.stop_error_m.unwrap() - 0.07).abs() < 1e-6);
        assert!((m.max_longitudinal_tracking_error_m - 0.3).abs() < 1e-9);
        assert!((m.max_lateral_tracking_error_m - 0.2).abs() < 1e-9);
        assert!((m.max_tracking_error_m - 0.3).abs() < 1e-9);
    }

    #[test]
    fn clearance_needs_obstacles_and_metrics_need_samples() {
        let mut s = Story::clean();
        s.scenario.obstacles.clear();
        assert_eq!(measured(&s).min_clearance_m, None);
        s.log = Log::default();
        assert_eq!(measured(&s), Metrics::default());
    }

    #[test]
    fn occupied_cells_within_ten_metres_count_as_clearance() {
        use crate::map::{Cell, OccupancyGrid};
        let place = super::super::testing::Place { origin: crate::geometry::Pose::new(5e5, 4e6, 0.6), mirrored: false };
        let mut s = Story::at(place);
        // one cell of half a metre, 1.2 m to 12.3 m beside the footprint
        for (gap, beside_car, alone) in [(1.2, 1.2, Some(1.2)), (2.5, 1.795, Some(2.5)), (12.3, 1.795, None)] {
            let corner = place.pose(40.0, 0.5 * s.vehicle.width + gap, 0.0);
            s.scenario.occupancy = Some(OccupancyGrid::new(corner, 0.5, 1, 1, vec![Cell::Occupied]).unwrap());
            assert!((measured(&s).min_clearance_m.unwrap() - beside_car).abs() < 1e-6, "{gap}: {:?}", measured(&s));
            let mut without_cars = s.clone();
            without_cars.scenario.obstacles.clear();
            let found = measured(&without_cars).min_clearance_m;
            assert_eq!(found.map(|c| (c * 1e6).round() / 1e6), alone, "{gap}");
        }
    }

    #[test]
    fn only_a_path_beside_the_old_one_is_a_switch() {
        let mut s = Story::clean();
        let replan = |s: &Story, time: f64, y: f64| {
            let station = s.cycles[0].plan.trajectory.at(time).station;
            let mut c = cycle(time, s.cycles[0].plan.trajectory.clone());
            c.plan.trajectory.path = s.place.straight(station + 8.578, y, 72.0 - station);
            c
        };
        // the remainder of the path, or a small offset: the same plan
        s.cycles = vec![s.cycles[0].clone(), replan(&s, 1.0, 0.0), replan(&s, 2.0, 0.3)];
        assert_eq!(plan_switches(&s.cycles), 0);
        // a metre to the side and back
        s.cycles = vec![replan(&s, 1.0, 0.0), replan(&s, 1.1, 1.0), replan(&s, 1.2, 1.0), replan(&s, 1.3, 0.0)];
        assert_eq!(plan_switches(&s.cycles), 2);
        assert_eq!(measured(&s).plan_switches_per_minute, 8.0);
    }
}
