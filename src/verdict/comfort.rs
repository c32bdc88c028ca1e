//! `comfort_longitudinal`, `comfort_lateral`, `comfort_jerk`, `comfort_lateral_jerk`: the filtered accelerations of the
//! centre of mass, from signals of at least [`LEAST_RATE`].

use super::{Check, ComfortPreset, Settings, Status, zero_phase_low_pass};
use crate::simulation::{Log, Sample};
use crate::vehicle::Vehicle;

/// What a passenger feels: the log's accelerations on a uniform time grid, filtered.
#[derive(Debug, Clone, Default)]
pub(super) struct FilteredMotion {
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
    /// Derivative of the filtered lateral acceleration, m/s³.
    pub(super) lateral_jerk: f64,
}

/// Slower signals say too little about comfort, Hz. A run's last interval may be cut short or rounded: a percent is let go.
const LEAST_RATE: f64 = 100.0;
const RATE_TOLERANCE: f64 = 0.01;

impl FilteredMotion {
    pub(super) fn new(log: &Log, cutoff: f64) -> Self {
        let (Some(first), Some(last)) = (log.samples.first(), log.samples.last()) else { return Self::default() };
        let steps = log.samples.len() - 1;
        let step = (last.time - first.time) / steps as f64;
        let felt_for = last.time - first.time;
        if steps == 0 || !(step > 0.0 && felt_for >= 1.0 / cutoff) {
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
        let slope = |signal: &[f64], i: usize| {
            let (before, after) = (i.saturating_sub(1), (i + 1).min(steps));
            (signal[after] - signal[before]) / ((after - before) as f64 * step)
        };
        let moments = (0..=steps)
            .map(|i| Moment {
                time: times[i],
                speed: speed[i],
                acceleration: acceleration[i],
                lateral_acceleration: lateral[i],
                jerk: slope(&acceleration, i),
                lateral_jerk: slope(&lateral, i),
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

/// The checks, `comfort_lateral_jerk` only where the preset has a limit for it. A run shorter than a period of the filter's
/// frequency (half a second) has filtered nothing that it could tell from the ends of the log, and passes; signals that are too slow to judge fail, each check with the time between two samples.
pub(super) fn comfort(vehicle: &Vehicle, log: &Log, settings: &Settings) -> Vec<Check> {
    let filtered = FilteredMotion::new(log, settings.comfort_cutoff);
    let limits = settings.comfort.limits(&vehicle.comfort, settings.comfort_margin);
    let judge = Judge { filtered: &filtered, filter: filter(&filtered, settings) };
    let mut checks = vec![
        judge.check(
            "comfort_longitudinal",
            "m/s²",
            &|m| m.acceleration,
            &|m| if m.acceleration < 0.0 { limits.deceleration } else { limits.acceleration },
            "comfortable acceleration, tolerated deceleration",
        ),
        judge.check(
            "comfort_lateral",
            "m/s²",
            &|m| m.lateral_acceleration,
            &|_| limits.lateral_acceleration,
            "lateral acceleration",
        ),
        judge.check(
            "comfort_jerk",
            "m/s³",
            &|m| m.jerk,
            &|m| jerk_limit(limits.jerk, m.speed),
            "derivative of the filtered acceleration, limit by speed as in ISO 15622",
        ),
    ];
    checks.extend(limits.lateral_jerk.map(|limit| {
        let what = "derivative of the filtered lateral acceleration";
        judge.check("comfort_lateral_jerk", "m/s³", &|m| m.lateral_jerk, &|_| limit, what)
    }));
    checks
}

/// How the signals were made and what they are held against, for the notes.
fn filter(filtered: &FilteredMotion, settings: &Settings) -> String {
    let limits = match settings.comfort {
        ComfortPreset::Safetlp => {
            format!("limit with {:.0} % for the tracking controller", 100.0 * settings.comfort_margin)
        }
        published => format!("limits of {}", published.name()),
    };
    let cutoff = settings.comfort_cutoff;
    format!("zero-phase Butterworth low-pass at {cutoff} Hz, {:.0} samples/s, {limits}", filtered.rate)
}

struct Judge<'f> {
    filtered: &'f FilteredMotion,
    filter: String,
}

impl Judge<'_> {
    /// Each is held against the limit at its own moment: the worst is the one that uses most of its limit.
    fn check(
        &self,
        name: &'static str,
        unit: &'static str,
        value: &dyn Fn(&Moment) -> f64,
        limit: &dyn Fn(&Moment) -> f64,
        what: &str,
    ) -> Check {
        if self.filtered.rate > 0.0 && self.filtered.rate < LEAST_RATE * (1.0 - RATE_TOLERANCE) {
            return too_slow(name, self.filtered);
        }
        let worst = self.filtered.worst(|m| value(m).abs() / limit(m)).map(|(_, m)| m);
        let (value, limit) = worst.map_or((0.0, 0.0), |m| (value(&m), limit(&m)));
        Check {
            name,
            status: Status::of(value.abs() <= limit),
            value: value.abs(),
            limit,
            unit,
            at_time: worst.map(|m| m.time),
            note: format!("{what}{}; {}", if value < 0.0 { " (negative)" } else { "" }, self.filter),
        }
    }
}

/// Signals that nobody can judge comfort by: the value is the time between two samples.
fn too_slow(name: &'static str, filtered: &FilteredMotion) -> Check {
    Check {
        name,
        status: Status::Fail,
        value: 1.0 / filtered.rate,
        limit: 1.0 / LEAST_RATE,
        unit: "s",
        at_time: filtered.moments.first().map(|m| m.time),
        note: format!("{:.0} samples/s in the log; comfort is judged by at least {LEAST_RATE:.0}", filtered.rate),
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Story, bump};
    use super::*;

    fn failures(s: &Story) -> Vec<(&'static str, &'static str)> {
        s.judge().failures().map(|c| (c.name, c.unit)).collect()
    }

    #[test]
    fn a_log_slower_than_a_hundred_samples_a_second_is_refused_by_every_comfort_check() {
        let mut s = Story::clean();
        s.log.samples = s.log.samples.iter().step_by(2).copied().collect();
        let refused = [("comfort_longitudinal", "s"), ("comfort_lateral", "s"), ("comfort_jerk", "s")];
        assert_eq!(failures(&s), refused);
        let check = s.judge().first_failure().cloned().unwrap();
        assert!((check.value - 0.02).abs() < 1e-9 && (check.limit - 0.01).abs() < 1e-12, "{check:?}");
    }

    #[test]
    fn a_preset_is_what_the_run_is_held_against() {
        let mut s = Story::clean();
        // the vehicle's own limits are 1.5 and 2.2 m/s² with a tenth
        for m in &mut s.log.samples {
            m.acceleration += bump(m.time, 1.0, 3.0, 1.8) - bump(m.time, 7.0, 4.0, 1.2);
        }
        assert_eq!(failures(&s), [("comfort_longitudinal", "m/s²")]);
        s.settings.comfort = ComfortPreset::Iso15622;
        assert_eq!(failures(&s), []);
        s.settings.comfort = ComfortPreset::R157;
        assert_eq!(failures(&s), [("comfort_longitudinal", "m/s²")], "silent about acceleration: 1.8 m/s² is too much");
    }

    #[test]
    fn lateral_jerk_is_asked_for_only_where_there_is_a_limit() {
        let mut s = Story::clean();
        // ±1.6 m/s² at 0.8 Hz: jerk 8 m/s³, hardly less behind the filter
        for m in &mut s.log.samples {
            m.lateral_acceleration += bump(m.time, 1.0, 4.0, 1.6) * (5.0 * m.time).sin();
        }
        assert_eq!(failures(&s), []);
        s.settings.comfort = ComfortPreset::Iso11270;
        assert_eq!(failures(&s), [("comfort_lateral_jerk", "m/s³")]);
        let worst = s.judge().first_failure().cloned().unwrap();
        assert!(worst.value > 6.0 && worst.value < 8.5, "{worst:?}");
    }
}
