//! `tracking`: the lateral error of the tracking controller.

use super::{Check, Settings, Status};
use crate::number::Short;
use crate::simulation::{Log, Sample};
use crate::vehicle::{GripUse, Vehicle};

/// Position of the rear axle in the frame of the reference pose: (ahead, left), m.
pub(super) fn tracking_error(sample: &Sample) -> (f64, f64) {
    let error = sample.reference_pose.to_local(sample.pose.position);
    (error.x, error.y)
}

/// The largest lateral error that the vehicle's tracking tube permits, m: with full use of the grip that proofs may use, all of it by
/// turning.
fn widest(vehicle: &Vehicle) -> f64 {
    vehicle.tracking.at(&GripUse { total: 1.0, turning: 1.0, curvature: 0.0 }).lateral
}

/// The check: the largest lateral error. `stops` and the metrics cover the longitudinal error.
pub(super) fn tracking(vehicle: &Vehicle, log: &Log, settings: &Settings) -> Check {
    let errors = log.samples.iter().map(|s| (tracking_error(s).1, s.time));
    let (error, time) = errors.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs())).unwrap_or((0.0, 0.0));
    let side = if error > 0.0 { "left" } else { "right" };
    let limit = settings.tracking.unwrap_or_else(|| widest(vehicle));
    Check {
        name: "tracking",
        status: Status::of(error.abs() <= limit),
        value: error.abs(),
        limit,
        unit: "m",
        at_time: Some(time),
        impact: None,
        note: if error == 0.0 {
            format!("no lateral offset from the reference pose; limit {limit:.3} m")
        } else {
            format!(
                "{:.3} m to the {side} of the reference pose at {time:.2} s; limit {limit:.3} m",
                Short(error.abs())
            )
        },
        method: "lateral distance of the rear axle from the reference pose, in every sample".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Story, bump};
    use super::*;

    #[test]
    fn the_limit_is_that_of_the_vehicle_unless_the_settings_have_one() {
        let mut s = Story::clean();
        s.vehicle.tracking.lateral = [0.04, 0.1];
        for m in &mut s.log.samples {
            m.reference_pose.position += m.pose.left() * bump(m.time, 6.0, 1.0, 0.15);
        }
        for (setting, limit, status) in
            [(None, 0.14, Status::Fail), (Some(0.2), 0.2, Status::Pass), (Some(0.0), 0.0, Status::Fail)]
        {
            s.settings.tracking = setting;
            let check = tracking(&s.vehicle, &s.log, &s.settings);
            assert!((check.limit - limit).abs() < 1e-12 && check.status == status, "{setting:?}: {check:?}");
            assert!((check.value - 0.15).abs() < 1e-9, "{check:?}");
        }
    }
}
