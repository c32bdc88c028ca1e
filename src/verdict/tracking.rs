//! `tracking`: how far the vehicle is from where its trajectory wants it.

use super::{Check, Settings, Status};
use crate::simulation::{Log, Sample};

/// Offset of the driven pose from the wanted one, in the wanted pose's frame: (ahead, left), m.
pub(super) fn tracking_error(sample: &Sample) -> (f64, f64) {
    let error = sample.reference_pose.to_local(sample.pose.position);
    (error.x, error.y)
}

/// The check: the largest lateral offset. Being early or late is for `stops` and the metrics.
pub(super) fn tracking(log: &Log, settings: &Settings) -> Check {
    let worst = log
        .samples
        .iter()
        .map(|s| (tracking_error(s).1, s.time))
        .max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
        .unwrap_or((0.0, 0.0));
    let side = if worst.0 > 0.0 { "left" } else { "right" };
    Check {
        name: "tracking",
        status: Status::of(worst.0.abs() <= settings.tracking),
        value: worst.0.abs(),
        limit: settings.tracking,
        unit: "m",
        at_time: Some(worst.1),
        note: format!("lateral offset of the rear axle from the wanted pose, to the {side}"),
    }
}
