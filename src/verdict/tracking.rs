//! `tracking`: the lateral error of the tracking controller.

use super::{Check, Settings, Status};
use crate::number::Short;
use crate::simulation::{Log, Sample};

/// Position of the rear axle in the frame of the reference pose: (ahead, left), m.
pub(super) fn tracking_error(sample: &Sample) -> (f64, f64) {
    let error = sample.reference_pose.to_local(sample.pose.position);
    (error.x, error.y)
}

/// The check: the largest lateral error. `stops` and the metrics cover the longitudinal error.
pub(super) fn tracking(log: &Log, settings: &Settings) -> Check {
    let errors = log.samples.iter().map(|s| (tracking_error(s).1, s.time));
    let (error, time) = errors.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs())).unwrap_or((0.0, 0.0));
    let side = if error > 0.0 { "left" } else { "right" };
    let limit = settings.tracking;
    Check {
        name: "tracking",
        status: Status::of(error.abs() <= limit),
        value: error.abs(),
        limit,
        unit: "m",
        at_time: Some(time),
        impact: None,
        note: if error == 0.0 {
            format!("no lateral offset from the reference pose; limit {limit:.2} m")
        } else {
            format!(
                "{:.2} m to the {side} of the reference pose at {time:.2} s; limit {limit:.2} m",
                Short(error.abs())
            )
        },
        method: "lateral distance of the rear axle from the reference pose, in every sample".into(),
    }
}
