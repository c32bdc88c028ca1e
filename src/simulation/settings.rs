//! Settings of the rig.

use serde::{Deserialize, Serialize};

use super::SimulationError;

/// How the rig integrates, controls and logs. [`Settings::default`] is what every run uses unless told otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Length of a physics step, s. Default 1 ms: the wheels' spin on their tyres is the fastest motion, about 120 rad/s.
    pub step: f64,
    /// Samples a second in the log, Hz. A whole number of steps lies between samples. Default 100.
    pub log_rate_hz: f64,
    /// Decisions a second of the tracking controller, Hz; its command holds in between. Default 100.
    pub control_rate_hz: f64,
    /// Factor on the tyres' friction, everywhere: 1 dry; see [`super::SURFACES`] for others. Default 1.
    pub friction_scale: f64,
    /// Whether anti-lock and traction control keep the wheels' torques inside the tyres' grip. Without, full brakes lock the
    /// wheels and full drive spins them. Default true.
    pub anti_lock: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self { step: 0.001, log_rate_hz: 100.0, control_rate_hz: 100.0, friction_scale: 1.0, anti_lock: true }
    }
}

impl Settings {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first setting that is out of its range.
    pub fn validate(&self) -> Result<(), SimulationError> {
        /// The wheels' spin on their tyres is integrated explicitly: longer steps would make it unstable.
        const LONGEST_STEP: f64 = 0.002;
        /// The verdict sees the log alone: what happens between two samples is judged by nobody, Hz.
        const LEAST_LOG_RATE: f64 = 50.0;
        /// Slower than the planner plans, the controller would not follow what was planned, Hz.
        const LEAST_CONTROL_RATE: f64 = 10.0;
        let check = |name, value: f64, ok: bool, expected| {
            if ok { Ok(()) } else { Err(SimulationError::Setting { name, value, expected }) }
        };
        check("step", self.step, self.step >= 1e-5 && self.step <= LONGEST_STEP, "from 0.00001 to 0.002 s")?;
        for (name, rate, least, expected) in [
            ("log_rate_hz", self.log_rate_hz, LEAST_LOG_RATE, "from 50 Hz to one a step"),
            ("control_rate_hz", self.control_rate_hz, LEAST_CONTROL_RATE, "from 10 Hz to one a step"),
        ] {
            check(name, rate, rate >= least && rate * self.step <= 1.0, expected)?;
        }
        let scale = self.friction_scale;
        check("friction_scale", scale, scale > 0.0 && scale <= 10.0, "above 0, at most 10")
    }

    /// Steps between log samples, at least one; where they do not go into the rate, there are more samples, not fewer.
    pub(super) fn steps_per_sample(&self) -> u64 {
        /// Rounding of the two divisions.
        const ROUNDING: f64 = 1e-9;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // validated: from ten a second to 1e5
        let steps = (1.0 / (self.log_rate_hz * self.step) + ROUNDING).floor().clamp(1.0, 1e9) as u64;
        steps
    }

    /// Steps between decisions of the controller, at least one.
    pub(super) fn steps_per_decision(&self) -> u64 {
        steps_between(self.control_rate_hz, self.step)
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // validated: from ten a second to 1e5
fn steps_between(rate: f64, step: f64) -> u64 {
    (1.0 / (rate * step)).round().clamp(1.0, 1e9) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_setting_out_of_range_is_named() {
        Settings::default().validate().unwrap();
        let bad = [
            ("step", Settings { step: 0.0, ..Settings::default() }),
            ("step", Settings { step: f64::NAN, ..Settings::default() }),
            ("step", Settings { step: 0.01, ..Settings::default() }),
            ("log_rate_hz", Settings { log_rate_hz: 0.0, ..Settings::default() }),
            ("log_rate_hz", Settings { log_rate_hz: 49.0, ..Settings::default() }),
            ("control_rate_hz", Settings { control_rate_hz: 9.0, ..Settings::default() }),
            ("log_rate_hz", Settings { log_rate_hz: f64::INFINITY, ..Settings::default() }),
            ("control_rate_hz", Settings { control_rate_hz: f64::NAN, ..Settings::default() }),
            ("friction_scale", Settings { friction_scale: -1.0, ..Settings::default() }),
        ];
        for (name, settings) in bad {
            let message = settings.validate().expect_err(name).to_string();
            assert!(message.contains(name), "{message}");
        }
    }

    #[test]
    fn unknown_keys_are_refused_and_missing_ones_default() {
        assert!(toml::from_str::<Settings>("friction_scal = 0.5").is_err());
        let settings: Settings = toml::from_str("friction_scale = 0.5").unwrap();
        assert_eq!(settings, Settings { friction_scale: 0.5, ..Settings::default() });
    }
}
