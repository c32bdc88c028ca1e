//! `comfort_longitudinal`, `comfort_lateral`, `comfort_jerk`: the filtered accelerations of the centre of mass.

use super::{Check, Settings, zero_phase_low_pass};
use crate::simulation::{Log, Sample};
use crate::vehicle::Vehicle;

/// What a passenger feels: the log's accelerations on a uniform time grid, filtered.
#[derive(Debug, Clone, Default)]
pub(super) struct Felt {
    pub(super) moments: Vec<Moment>,
    /// Samples per second.
    pub(super) rate: f64,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Moment {
    pub(super) time: f64,
    pub(super) speed: f64,
    pub(super) acceleration: f64,
    pub(super) lateral_acceleration: f64,
    /// Derivative of the filtered acceleration, m/s³.
    pub(super) jerk: f64,
}

impl Felt {
    pub(super) fn new(log: &Log, cutoff: f64) -> Self {
        let (Some(first), Some(last)) = (log.samples.first(), log.samples.last()) else { return Self::default() };
        let steps = log.samples.len() - 1;
        let step = (last.time - first.time) / steps as f64;
        if steps == 0 || !(step > 0.0 && step.is_finite()) {
            return Self::default();
        }
        let rate = 1.0 / step;
        let times: Vec<f64> = (0..=steps).map(|i| first.time + i as f64 * step).collect();
        let resampled = |value: fn(&Sample) -> f64| -> Vec<f64> {
            times.iter().map(|&t| interpolated(&log.samples, t, value)).collect()
        };
        let speed = resampled(|s| s.speed);
        let acceleration = zero_phase_low_pass(&resampled(|s| s.acceleration), cutoff, rate);
        let lateral = zero_phase_low_pass(&resampled(|s| s.lateral_acceleration), cutoff, rate);
        let jerk = |i: usize| {
            let (before, after) = (i.saturating_sub(1), (i + 1).min(steps));
            (acceleration[after] - acceleration[before]) / ((after - before) as f64 * step)
        };
        let moments = (0..=steps)
            .map(|i| Moment {
                time: times[i],
                speed: speed[i],
                acceleration: acceleration[i],
                lateral_acceleration: lateral[i],
                jerk: jerk(i),
            })
            .collect();
        Self { moments, rate }
    }

    /// The largest value of something, with its moment.
    pub(super) fn worst(&self, value: impl Fn(&Moment) -> f64) -> Option<(f64, Moment)> {
        self.moments.iter().map(|m| (value(m), *m)).max_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// A value of the log at a time, linear between samples.
fn interpolated(samples: &[Sample], time: f64, value: fn(&Sample) -> f64) -> f64 {
    let after = samples.partition_point(|s| s.time <= time);
    match (after.checked_sub(1).and_then(|i| samples.get(i)), samples.get(after)) {
        (Some(a), Some(b)) => value(a) + (value(b) - value(a)) * (time - a.time) / (b.time - a.time),
        (Some(only), None) | (None, Some(only)) => value(only),
        (None, None) => f64::NAN,
    }
}

/// The jerk limit at a speed, m/s³: twice the limit at high speed below 5 m/s, falling linearly until 20 m/s. With the
/// usual 2.5 m/s³ this is ISO 15622's limit for adaptive cruise control, 5 → 2.5 m/s³.
pub(crate) fn jerk_limit(jerk: f64, speed: f64) -> f64 {
    jerk * (2.0 - ((speed.abs() - 5.0) / 15.0).clamp(0.0, 1.0))
}

/// The three checks. A run of fewer than two samples has felt nothing and passes.
pub(super) fn comfort(vehicle: &Vehicle, log: &Log, settings: &Settings) -> [Check; 3] {
    let felt = Felt::new(log, settings.comfort_cutoff);
    let comfort = &vehicle.comfort;
    let allowed = 1.0 + settings.comfort_margin;
    let filter = format!(
        "zero-phase Butterworth low-pass at {} Hz, {:.0} samples/s, limit with {:.0} % for the tracking controller",
        settings.comfort_cutoff,
        felt.rate,
        100.0 * settings.comfort_margin
    );
    // Each is held against the limit at its own moment: the worst is the one that uses most of its limit.
    let check = |name, unit, value: &dyn Fn(&Moment) -> f64, limit: &dyn Fn(&Moment) -> f64, what: &str| {
        let worst = felt.worst(|m| value(m).abs() / limit(m)).map(|(_, m)| m);
        let (value, limit) = worst.map_or((0.0, 0.0), |m| (value(&m), allowed * limit(&m)));
        Check {
            name,
            pass: value.abs() <= limit,
            value: value.abs(),
            limit,
            unit,
            at_time: worst.map(|m| m.time),
            note: format!("{what}{}; {filter}", if value < 0.0 { " (negative)" } else { "" }),
        }
    };
    [
        check(
            "comfort_longitudinal",
            "m/s²",
            &|m| m.acceleration,
            &|m| if m.acceleration < 0.0 { comfort.aggressive_deceleration } else { comfort.acceleration },
            "comfortable acceleration, tolerated deceleration",
        ),
        check(
            "comfort_lateral",
            "m/s²",
            &|m| m.lateral_acceleration,
            &|_| comfort.lateral_acceleration,
            "lateral acceleration",
        ),
        check(
            "comfort_jerk",
            "m/s³",
            &|m| m.jerk,
            &|m| jerk_limit(comfort.jerk, m.speed),
            "derivative of the filtered acceleration, limit by speed as in ISO 15622",
        ),
    ]
}
