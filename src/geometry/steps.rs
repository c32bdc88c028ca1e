//! Numbers of equal steps in a length.
//!
//! Maps are drawn, and lattice nodes lie, at whole metres: many lengths are exact multiples of a step. There, rounding would
//! decide between n and n + 1, and with it the coordinates of the map. So a length that is a multiple of the step up to
//! rounding counts as that multiple.

/// Tolerance, in steps: above the rounding of UTM coordinates (10⁻⁹ m) for steps of a centimetre, below any effect.
const WHOLE: f64 = 1e-6;

/// Smallest number of equal steps of at most `step` (up to rounding) that cover `length`; at least one.
#[must_use]
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // saturates; at least one
pub fn covering(length: f64, step: f64) -> usize {
    (length / step - WHOLE).ceil().max(1.0) as usize
}

/// Largest number of whole steps in `length` (up to rounding); zero if it is negative.
#[must_use]
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // saturates; negative values become zero
pub fn fitting(length: f64, step: f64) -> usize {
    (length / step + WHOLE).floor() as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_does_not_decide_at_a_multiple() {
        for (multiple, step) in [(30.0, 15.0), (75.0, 0.5), (0.3, 0.1), (12.0, 0.01)] {
            let steps = f64::round(multiple / step);
            // the resolution of an `f64` at 5·10⁶ m
            for rounding in [-1e-9, 0.0, 1e-9] {
                assert_eq!(covering(multiple + rounding, step) as f64, steps, "{multiple} in {step}");
                assert_eq!(fitting(multiple + rounding, step) as f64, steps, "{multiple} in {step}");
            }
        }
    }

    #[test]
    fn other_lengths_are_rounded_up_and_down() {
        assert_eq!((covering(30.1, 15.0), fitting(29.9, 15.0)), (3, 1));
        assert_eq!((covering(0.0, 1.0), fitting(0.0, 1.0)), (1, 0));
        assert_eq!((covering(-3.0, 1.0), fitting(-3.0, 1.0)), (1, 0));
        assert_eq!((covering(f64::NAN, 1.0), fitting(f64::NAN, 1.0)), (1, 0));
    }
}
