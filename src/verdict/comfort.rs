//! `comfort_longitudinal`, `comfort_lateral`, `comfort_jerk`, `comfort_lateral_jerk`: extremes of the filtered accelerations
//! of the centre of mass. The log needs at least [`LEAST_RATE`] samples a second.
//!
//! A run is charged with what it adds to what its start imposes ([`Imposed`]).

use super::imposed::{Imposed, RELEASE, raised};
use super::presets::Quantity;
use super::{Check, ComfortPreset, Settings, Status, zero_phase_low_pass};
use crate::number::Short;
use crate::simulation::{Log, Sample};
use crate::vehicle::Vehicle;

/// The accelerations of the log on a uniform time grid, low-pass filtered.
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

/// A log with fewer samples per second is too coarse for comfort, Hz.
const LEAST_RATE: f64 = 100.0;
/// Share by which the rate may be lower: the last interval of a run can be shortened or rounded.
const RATE_TOLERANCE: f64 = 0.01;

impl FilteredMotion {
    /// Filters a log. Empty if the log is shorter than one period of the cutoff frequency (Hz): such a log is dominated by
    /// the ends of the filter.
    pub(super) fn new(log: &Log, cutoff: f64) -> Self {
        let (Some(first), Some(last)) = (log.samples.first(), log.samples.last()) else { return Self::default() };
        let steps = log.samples.len() - 1;
        let duration = last.time - first.time;
        let step = duration / steps as f64;
        if steps == 0 || !(step > 0.0 && duration >= 1.0 / cutoff) {
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

    /// The largest value of a function of the motion, with its moment.
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

/// The jerk limit at a speed, m/s³: `jerk` from 20 m/s on, twice as much up to 5 m/s, linear between. With 2.5 m/s³ this is
/// the limit of ISO 15622 for adaptive cruise control.
pub(crate) fn jerk_limit(jerk: f64, speed: f64) -> f64 {
    jerk * (2.0 - ((speed.abs() - 5.0) / 15.0).clamp(0.0, 1.0))
}

/// The four checks, for what was added to what the start imposes. They do not apply to a run shorter than one period of the cutoff frequency, and
/// `comfort_lateral_jerk` applies only where the preset has a limit. A log with too few samples per second fails every check
/// that applies; the value is then the time between two samples.
pub(super) fn comfort(vehicle: &Vehicle, log: &Log, settings: &Settings) -> Vec<Check> {
    let imposed = [Imposed::longitudinal(vehicle, log), Imposed::lateral(vehicle, log)];
    comfort_beyond(imposed, vehicle, log, settings)
}

/// The four checks, with what the start imposes longitudinally and laterally.
fn comfort_beyond([along, across]: [Imposed; 2], vehicle: &Vehicle, log: &Log, settings: &Settings) -> Vec<Check> {
    let preset = settings.comfort;
    let limits = preset.limits(&vehicle.comfort, settings.comfort_margin);
    let judge = Judge { motion: &FilteredMotion::new(log, settings.comfort_cutoff), settings };
    let longitudinal = Signal {
        name: "comfort_longitudinal",
        unit: "m/s²",
        what: "acceleration",
        value: &|m| m.acceleration,
        limit: &|m| if m.acceleration < 0.0 { limits.deceleration } else { limits.acceleration },
        allowance: &|m| along.allows(m.acceleration, m.time),
        imposed: along.acceleration(),
        quantity: |value| if value < 0.0 { Quantity::Deceleration } else { Quantity::Acceleration },
        event: |value, _| {
            format!("{} at {:.2} m/s²", if value < 0.0 { "braked" } else { "accelerated" }, Short(value.abs()))
        },
    };
    let lateral = Signal {
        name: "comfort_lateral",
        unit: "m/s²",
        what: "lateral acceleration",
        value: &|m| m.lateral_acceleration,
        limit: &|_| limits.lateral_acceleration,
        allowance: &|m| across.allows(m.lateral_acceleration, m.time),
        imposed: across.acceleration(),
        quantity: |_| Quantity::LateralAcceleration,
        event: |value, _| format!("accelerated to the {} at {:.2} m/s²", side(value), Short(value.abs())),
    };
    let jerk = Signal {
        name: "comfort_jerk",
        unit: "m/s³",
        what: "derivative of the acceleration",
        value: &|m| m.jerk,
        limit: &|m| jerk_limit(limits.jerk, m.speed),
        allowance: &|m| along.allows_jerk(m.jerk, m.time),
        imposed: along.acceleration(),
        quantity: |_| Quantity::Jerk,
        event: |value, speed| format!("jerk of {:.2} m/s³ at {:.1} m/s", Short(value), Short(speed)),
    };
    let mut checks = vec![judge.check(&longitudinal), judge.check(&lateral), judge.check(&jerk)];
    checks.push(match limits.lateral_jerk {
        Some(limit) => judge.check(&Signal {
            name: "comfort_lateral_jerk",
            unit: "m/s³",
            what: "derivative of the lateral acceleration",
            value: &|m| m.lateral_jerk,
            limit: &|_| limit,
            allowance: &|m| across.allows_jerk(m.lateral_jerk, m.time),
            imposed: across.acceleration(),
            quantity: |_| Quantity::LateralJerk,
            event: |value, _| format!("lateral jerk of {:.2} m/s³ to the {}", Short(value.abs()), side(value)),
        }),
        None => {
            let why = format!("the comfort preset {} has no lateral jerk limit", preset.name());
            Check::not_applicable("comfort_lateral_jerk", "m/s³", &why)
        }
    });
    checks
}

fn side(left_positive: f64) -> &'static str {
    if left_positive > 0.0 { "left" } else { "right" }
}

/// One filtered signal with its limit.
struct Signal<'s> {
    name: &'static str,
    unit: &'static str,
    /// The signal, for the method.
    what: &'static str,
    value: &'s dyn Fn(&Moment) -> f64,
    limit: &'s dyn Fn(&Moment) -> f64,
    /// What the start imposes at a moment: the limit is at least as large.
    allowance: &'s dyn Fn(&Moment) -> f64,
    /// The acceleration that the start imposes, m/s².
    imposed: f64,
    quantity: fn(f64) -> Quantity,
    /// The event in words, from value and speed (m/s).
    event: fn(f64, f64) -> String,
}

struct Judge<'f> {
    motion: &'f FilteredMotion,
    settings: &'f Settings,
}

impl Judge<'_> {
    /// Each moment has its own limit. The worst moment is the one that uses the largest share of its limit.
    fn check(&self, signal: &Signal<'_>) -> Check {
        let Signal { name, unit, .. } = *signal;
        let cutoff = self.settings.comfort_cutoff;
        let margin = self.settings.comfort_margin;
        let limit_at = |m: &Moment| raised((signal.limit)(m), (signal.allowance)(m), margin);
        let Some((_, worst)) = self.motion.worst(|m| (signal.value)(m).abs() / limit_at(m)) else {
            let why = format!("the run is shorter than one period of the filter, {:.2} s", 1.0 / cutoff);
            return Check::not_applicable(name, unit, &why);
        };
        if self.motion.rate < LEAST_RATE * (1.0 - RATE_TOLERANCE) {
            return too_slow(name, self.motion);
        }
        let (value, limit) = ((signal.value)(&worst), limit_at(&worst));
        let event = (signal.event)(value, worst.speed);
        let source = if limit > (signal.limit)(&worst) {
            let imposed = Short(signal.imposed);
            format!("the start imposes {imposed:.2} m/s², released at {RELEASE} m/s³ or faster")
        } else {
            self.settings.comfort.source((signal.quantity)(value))
        };
        Check {
            name,
            status: Status::of(value.abs() <= limit),
            value: value.abs(),
            limit,
            unit,
            at_time: Some(worst.time),
            impact: None,
            note: format!("{event} at {:.2} s; limit {limit:.2} ({source})", worst.time),
            method: self.method(signal.what),
        }
    }

    fn method(&self, what: &str) -> String {
        let margin = match self.settings.comfort {
            ComfortPreset::Safetlp => {
                format!(
                    "; the limit includes {:.0} % for the tracking controller",
                    100.0 * self.settings.comfort_margin
                )
            }
            _ => String::new(),
        };
        let (cutoff, rate) = (self.settings.comfort_cutoff, self.motion.rate);
        format!("{what}, zero-phase Butterworth low-pass at {cutoff} Hz, {rate:.0} samples/s{margin}")
    }
}

/// A log too coarse for comfort. The value is the time between two samples.
fn too_slow(name: &'static str, motion: &FilteredMotion) -> Check {
    Check {
        name,
        status: Status::Fail,
        value: 1.0 / motion.rate,
        limit: 1.0 / LEAST_RATE,
        unit: "s",
        at_time: motion.moments.first().map(|m| m.time),
        impact: None,
        note: format!("the log has {:.0} samples/s; comfort needs at least {LEAST_RATE:.0}", motion.rate),
        method: "mean time between two samples of the log".into(),
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
    fn a_log_below_100_samples_per_second_fails_every_comfort_check() {
        let mut s = Story::clean();
        s.log.samples = s.log.samples.iter().step_by(2).copied().collect();
        let failed = [("comfort_longitudinal", "s"), ("comfort_lateral", "s"), ("comfort_jerk", "s")];
        assert_eq!(failures(&s), failed);
        let check = s.judge().first_failure().cloned().unwrap();
        assert!((check.value - 0.02).abs() < 1e-9 && (check.limit - 0.01).abs() < 1e-12, "{check:?}");
    }

    #[test]
    fn the_preset_sets_the_limits() {
        let mut s = Story::clean();
        // the vehicle's limits are 1.5 and 2.2 m/s², with a margin of 10 %
        for m in &mut s.log.samples {
            m.acceleration += bump(m.time, 1.0, 3.0, 1.8) - bump(m.time, 7.0, 4.0, 1.2);
        }
        assert_eq!(failures(&s), [("comfort_longitudinal", "m/s²")]);
        s.settings.comfort = ComfortPreset::Iso15622;
        assert_eq!(failures(&s), []);
        s.settings.comfort = ComfortPreset::R157;
        assert_eq!(
            failures(&s),
            [("comfort_longitudinal", "m/s²")],
            "R157 has no limit for acceleration, so the vehicle's limit applies"
        );
    }

    #[test]
    fn lateral_jerk_applies_only_where_the_preset_has_a_limit() {
        let mut s = Story::clean();
        // ±1.6 m/s² at 0.8 Hz: jerk 8 m/s³, hardly reduced by the filter
        for m in &mut s.log.samples {
            m.lateral_acceleration += bump(m.time, 1.0, 4.0, 1.6) * (5.0 * m.time).sin();
        }
        assert_eq!(failures(&s), []);
        s.settings.comfort = ComfortPreset::Iso11270;
        assert_eq!(failures(&s), [("comfort_lateral_jerk", "m/s³")]);
        let worst = s.judge().first_failure().cloned().unwrap();
        assert!(worst.value > 6.0 && worst.value < 8.5, "{worst:?}");
    }

    #[test]
    fn the_note_names_the_event_the_limit_and_its_source() {
        let mut s = Story::clean();
        for m in &mut s.log.samples {
            m.acceleration -= bump(m.time, 0.5, 4.0, 3.0);
        }
        let check = |s: &Story, name: &str| s.judge().checks.into_iter().find(|c| c.name == name).unwrap();
        let braking = check(&s, "comfort_longitudinal");
        let expected = format!(
            "braked at {:.2} m/s² at {:.2} s; limit 2.42 (comfort preset safetlp)",
            braking.value,
            braking.at_time.unwrap()
        );
        assert_eq!(braking.note, expected);
        assert!(braking.method.contains("2 Hz, 100 samples/s") && braking.method.contains("10 %"), "{braking:?}");
        s.settings.comfort = ComfortPreset::Iso15622;
        let lateral = check(&s, "comfort_lateral");
        assert!(lateral.note.ends_with("(limit of the vehicle; comfort preset iso15622 has none)"), "{lateral:?}");
        let jerk = check(&s, "comfort_lateral_jerk");
        assert_eq!(jerk.note, "not applicable: the comfort preset iso15622 has no lateral jerk limit");
    }

    #[test]
    fn comfort_does_not_apply_to_a_run_shorter_than_a_period_of_the_filter() {
        let mut s = Story::clean();
        s.log.samples.truncate(50);
        let comfort = s.judge().checks.into_iter().filter(|c| c.name.starts_with("comfort"));
        let short = comfort.filter(|c| c.name != "comfort_lateral_jerk");
        assert!(short.clone().all(|c| c.status == Status::NotApplicable) && short.count() == 3);
        s.log.samples = Story::clean().log.samples[..51].to_vec();
        assert!(s.judge().checks.iter().any(|c| c.name == "comfort_jerk" && c.passed()));
    }

    /// The clean run with an imposed acceleration of −6 m/s² in its first sample, released at a rate (m/s³) from a time on.
    fn braking_at_start(rate: f64, from: f64) -> Story {
        let mut s = Story::clean();
        for m in &mut s.log.samples {
            m.acceleration -= (6.0 - rate * (m.time - from).max(0.0)).max(0.0);
        }
        s
    }

    #[test]
    fn a_start_that_imposes_nothing_is_judged_exactly_as_without_the_allowance() {
        let nothing = [Imposed::longitudinal(&Story::clean().vehicle, &Log::default()); 2];
        let mut uncomfortable = Story::clean();
        for m in &mut uncomfortable.log.samples {
            m.acceleration -= bump(m.time, 0.01, 4.0, 3.0);
            m.lateral_acceleration += bump(m.time, 0.01, 4.0, 3.6);
        }
        for s in [Story::clean(), uncomfortable] {
            for comfort_preset in ComfortPreset::ALL {
                let settings = Settings { comfort: comfort_preset, ..s.settings };
                let expected = comfort_beyond(nothing, &s.vehicle, &s.log, &settings);
                assert_eq!(comfort(&s.vehicle, &s.log, &settings), expected);
            }
        }
        // from the first moments on, the limits are those of the preset, to the bit
        let mut early = Story::clean();
        for m in &mut early.log.samples {
            m.acceleration -= bump(m.time, 0.01, 0.5, 3.0);
            m.lateral_acceleration += bump(m.time, 0.01, 0.5, 3.6);
        }
        let limits = early.settings.comfort.limits(&early.vehicle.comfort, early.settings.comfort_margin);
        let expected = [limits.deceleration, limits.lateral_acceleration].map(f64::to_bits);
        for s in [Story::clean(), early] {
            let checks = comfort(&s.vehicle, &s.log, &s.settings);
            assert_eq!([checks[0].limit.to_bits(), checks[1].limit.to_bits()], expected);
        }
    }

    #[test]
    fn braking_that_the_start_imposes_is_not_charged_while_it_is_released() {
        let s = braking_at_start(1.8, 0.0);
        assert_eq!(failures(&s), []);
        // a limit of the start and its release in the note
        let worst = s.judge().checks.into_iter().find(|c| c.name == "comfort_longitudinal").unwrap();
        let source = "(the start imposes -6.00 m/s², released at 1.5 m/s³ or faster)";
        assert!(worst.note.ends_with(source) && worst.limit > 2.42, "{worst:?}");
        assert_eq!(failures(&braking_at_start(1.8, 1.0)), [("comfort_longitudinal", "m/s²")], "held for a second");
        assert_eq!(failures(&braking_at_start(1.0, 0.0)), [("comfort_longitudinal", "m/s²")], "released too slowly");
    }

    #[test]
    fn harder_braking_than_the_start_imposes_or_after_its_release_is_charged() {
        let mut harder = braking_at_start(1.8, 0.0);
        for m in harder.log.samples.iter_mut().filter(|m| m.time > 0.0) {
            m.acceleration -= bump(m.time, 0.1, 3.0, 3.0);
        }
        assert_eq!(failures(&harder), [("comfort_longitudinal", "m/s²")]);
        let mut again = braking_at_start(1.8, 0.0);
        for m in &mut again.log.samples {
            m.acceleration -= bump(m.time, 5.0, 4.0, 3.0);
        }
        assert_eq!(failures(&again), [("comfort_longitudinal", "m/s²")]);
    }

    #[test]
    fn a_start_that_brakes_does_not_excuse_an_acceleration() {
        let mut s = braking_at_start(6.0, 0.0);
        for m in &mut s.log.samples {
            m.acceleration += bump(m.time, 0.5, 3.0, 2.4);
        }
        assert!(failures(&s).contains(&("comfort_longitudinal", "m/s²")), "{:?}", failures(&s));
    }

    #[test]
    fn a_command_of_the_run_does_not_excuse_itself() {
        let mut s = Story::clean();
        for m in s.log.samples.iter_mut().filter(|m| m.time > 0.0) {
            m.acceleration -= (6.0 - 1.8 * m.time).max(0.0);
        }
        assert!(failures(&s).contains(&("comfort_longitudinal", "m/s²")), "{:?}", failures(&s));
    }

    #[test]
    fn no_file_imposes_more_than_the_tyres_give() {
        let mut s = Story::clean();
        for m in &mut s.log.samples {
            m.acceleration -= if m.time == 0.0 { 1e9 } else { bump(m.time, 8.0, 3.0, 3.0) };
        }
        let most = s.vehicle.tyres.friction * crate::simulation::GRAVITY;
        assert_eq!(Imposed::longitudinal(&s.vehicle, &s.log).acceleration(), -most);
        assert_eq!(failures(&s)[0], ("comfort_longitudinal", "m/s²"));
    }

    #[test]
    fn lateral_acceleration_of_speed_and_steering_angle_at_the_start_is_released_too() {
        for side in [1.0, -1.0] {
            // 5 m/s² at 8 m/s
            let released = |from: f64| {
                let mut s = Story::clean();
                let wheelbase = s.vehicle.wheelbase;
                for m in &mut s.log.samples {
                    let value = (5.0 - 1.8 * (m.time - from).max(0.0)).max(0.0);
                    m.lateral_acceleration += side * value;
                    m.steering = side * (value / 64.0 * wheelbase).atan();
                }
                s
            };
            assert_eq!(failures(&released(0.0)), []);
            assert_eq!(failures(&released(1.0)), [("comfort_lateral", "m/s²")], "held for a second");
            let mut straight = released(0.0);
            straight.log.samples[0].steering = 0.0;
            assert_eq!(failures(&straight), [("comfort_lateral", "m/s²")], "not imposed");
            let mut other_side = released(0.0);
            other_side.log.samples[0].steering *= -1.0;
            assert_eq!(failures(&other_side), [("comfort_lateral", "m/s²")], "imposed to the other side");
        }
    }

    #[test]
    fn the_jerk_of_the_release_is_charged_only_beyond_its_rate() {
        // a vehicle with a jerk limit of 0.5 m/s³ at high speed, twice as much at 5 m/s
        let with_rate = |rate: f64| {
            let mut s = braking_at_start(rate, 0.0);
            s.vehicle.comfort.jerk = 0.5;
            // without the bump of the clean run's own stop
            s.log.samples.truncate(500);
            s.judge().checks.into_iter().find(|c| c.name == "comfort_jerk").unwrap()
        };
        // at most 1.65 m/s³ with the margin, far above the vehicle's own limit
        assert!(with_rate(1.5).passed(), "{:?}", with_rate(1.5));
        assert!(with_rate(1.8).failed(), "{:?}", with_rate(1.8));
        let imposed = Imposed::longitudinal(&Story::clean().vehicle, &braking_at_start(1.5, 0.0).log);
        assert_eq!((imposed.allows_jerk(1.0, 1.0), imposed.allows_jerk(-1.0, 1.0)), (RELEASE, 0.0));
        assert_eq!(imposed.allows_jerk(1.0, 4.2), 0.0, "6 m/s² are gone after 4.1 s");
    }
}
