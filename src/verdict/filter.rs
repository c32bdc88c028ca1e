//! The low-pass filter applied before every comfort check.
//!
//! A second-order Butterworth filter runs forwards and backwards. It has no phase lag, so an extreme keeps its time. Vehicle
//! testing prescribes such phaseless filters for measured accelerations (Euro NCAP test protocols: 10 Hz, for peaks of
//! emergency braking). Comfort concerns slower motion, and jerk needs more smoothing than acceleration: ISO 15622 averages
//! jerk over 1 s, UN R79 lateral jerk over 0.5 s. A moving average over `T` passes 1/√2 at 0.443/`T`, which is 0.44 and
//! 0.89 Hz. The default of 2 Hz passes more and is therefore stricter.

use std::f64::consts::{PI, SQRT_2};

/// Filters a signal sampled at `rate` Hz. A sinusoid of `cutoff` Hz keeps 1/√2 of its amplitude; constants are unchanged;
/// nothing is shifted in phase. The signal is extended by its mirror image at both ends.
///
/// Weak at the ends: the mirror image flattens a slope within about half a period of the cutoff. The usual point reflection
/// keeps slopes, but it reflects about the end sample, whose noise would then shift the signal near it.
///
/// Two passes multiply their gains, so each pass is designed for a higher frequency: `cutoff` divided by (√2 − 1)^¼ (Winter,
/// *Biomechanics and Motor Control of Human Movement*, 2.2.4.4), in the warped frequency of the bilinear transform, where the
/// factor is exact. A signal with fewer than ten samples per period of `cutoff` is returned unchanged.
#[must_use]
pub fn zero_phase_low_pass(signal: &[f64], cutoff: f64, rate: f64) -> Vec<f64> {
    const SAMPLES_PER_PERIOD: f64 = 10.0;
    if signal.len() < 3 || !(rate > SAMPLES_PER_PERIOD * cutoff && cutoff > 0.0) {
        return signal.to_vec();
    }
    let filter = Butterworth::new(cutoff, rate);
    let pad = padding(signal.len(), cutoff, rate);
    let mut padded = continued(signal, pad);
    for _ in 0..2 {
        padded = filter.run(&padded);
        padded.reverse();
    }
    padded[pad..pad + signal.len()].to_vec()
}

/// Samples added at each end: 1.5 periods of the cutoff. The transient of the filter decays to a few 1e-4 within them.
fn padding(samples: usize, cutoff: f64, rate: f64) -> usize {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // positive; saturates at huge rates
    let samples_of_transient = (1.5 * rate / cutoff).ceil() as usize;
    samples_of_transient.min(samples - 1)
}

/// The signal with its mirror image at both ends. `pad` is less than its length.
fn continued(signal: &[f64], pad: usize) -> Vec<f64> {
    let before = signal[1..=pad].iter().rev();
    let after = signal[signal.len() - 1 - pad..signal.len() - 1].iter().rev();
    before.chain(signal).chain(after).copied().collect()
}

/// Coefficients of the second-order section. Its gain at zero frequency is 1.
struct Butterworth {
    b: [f64; 3],
    a: [f64; 2],
}

impl Butterworth {
    fn new(cutoff: f64, rate: f64) -> Self {
        let w = (PI * cutoff / rate).tan() / (SQRT_2 - 1.0).powf(0.25);
        let scale = 1.0 / (1.0 + SQRT_2 * w + w * w);
        let b = w * w * scale;
        Self { b: [b, 2.0 * b, b], a: [2.0 * (w * w - 1.0) * scale, (1.0 - SQRT_2 * w + w * w) * scale] }
    }

    /// One pass (transposed direct form II), started in the steady state of the first value.
    fn run(&self, signal: &[f64]) -> Vec<f64> {
        let ([b0, b1, b2], [a1, a2]) = (self.b, self.a);
        let start = signal.first().copied().unwrap_or(0.0);
        let mut z2 = (b2 - a2) * start;
        let mut z1 = (b1 - a1) * start + z2;
        signal
            .iter()
            .map(|&x| {
                let y = b0 * x + z1;
                z1 = b1 * x - a1 * y + z2;
                z2 = b2 * x - a2 * y;
                y
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Closed form: amplitude gain of the two passes is 1 / (1 + (tan(πf/r) / w)⁴).
    #[test]
    fn sinusoids_keep_the_amplitude_and_phase_of_the_closed_form() {
        let (cutoff, rate) = (2.0, 100.0);
        let w = (PI * cutoff / rate).tan() / (SQRT_2 - 1.0).powf(0.25);
        for frequency in [0.1, 0.5, 1.0, 2.0, 5.0, 10.0] {
            let sine = |i: usize| (2.0 * PI * frequency * i as f64 / rate + 0.3).sin();
            let signal: Vec<f64> = (0..4000).map(sine).collect();
            let filtered = zero_phase_low_pass(&signal, cutoff, rate);
            let gain = 1.0 / (1.0 + ((PI * frequency / rate).tan() / w).powi(4));
            for i in 1000..3000 {
                assert!((filtered[i] - gain * signal[i]).abs() < 1e-6, "{frequency} Hz, sample {i}: gain {gain}");
            }
        }
    }

    #[test]
    fn the_cutoff_keeps_one_over_root_two() {
        let signal: Vec<f64> = (0..4000).map(|i| (2.0 * PI * 2.0 * f64::from(i) / 1000.0).sin()).collect();
        let filtered = zero_phase_low_pass(&signal, 2.0, 1000.0);
        let peak = filtered[1000..3000].iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        assert!((peak - 1.0 / SQRT_2).abs() < 1e-4, "{peak}");
    }

    #[test]
    fn constants_are_unchanged_everywhere_and_ramps_away_from_the_ends() {
        let constant = zero_phase_low_pass(&[1.5; 300], 2.0, 100.0);
        assert!(constant.iter().all(|v| (v - 1.5).abs() < 1e-12), "{constant:?}");
        let ramp: Vec<f64> = (0..500).map(|i| 3.0 + 0.01 * f64::from(i)).collect();
        let filtered = zero_phase_low_pass(&ramp, 2.0, 100.0);
        for i in 50..450 {
            assert!((filtered[i] - ramp[i]).abs() < 1e-3, "sample {i}: {} for {}", filtered[i], ramp[i]);
        }
    }

    #[test]
    fn noise_at_the_ends_does_not_shift_the_signal() {
        let noise: Vec<f64> = (0..300).map(|i| if i % 2 == 0 { 5.0 } else { -5.0 }).collect();
        let filtered = zero_phase_low_pass(&noise, 2.0, 100.0);
        assert!(filtered.iter().all(|v| v.abs() < 0.1), "{filtered:?}");
    }

    #[test]
    fn short_or_coarse_signals_are_returned_unchanged() {
        assert_eq!(zero_phase_low_pass(&[], 2.0, 100.0), Vec::<f64>::new());
        assert_eq!(zero_phase_low_pass(&[1.0, 2.0], 2.0, 100.0), [1.0, 2.0]);
        assert_eq!(zero_phase_low_pass(&[1.0, 2.0, 0.0], 2.0, 10.0), [1.0, 2.0, 0.0]);
        assert_eq!(zero_phase_low_pass(&[1.0, 2.0, 0.0], 2.0, f64::NAN), [1.0, 2.0, 0.0]);
        assert_eq!(zero_phase_low_pass(&[1.0, 2.0, 0.0], 2.0, 100.0).len(), 3);
    }
}
