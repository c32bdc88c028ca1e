//! Settings of the simulation.

use serde::{Deserialize, Serialize};

use super::SimulationError;

/// Integration, control and log rates, and friction of a simulation. Runs use [`Settings::default`] unless configured
/// otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Length of a physics step, s. The fastest motion is the wheels' spin on their tyres, about 120 rad/s. Default
    /// 0.001.
    pub step: f64,
    /// Rate of log samples, Hz. Samples are a whole number of steps apart. Default 100.
    pub log_rate_hz: f64,
    /// Rate of the tracking controller, Hz; its command is held in between. Default 100.
    pub control_rate_hz: f64,
    /// Factor on the tyres' friction everywhere: 1 is dry; see [`super::SURFACES`] for others. Default 1.
    pub friction_scale: f64,
    /// Whether anti-lock and traction control limit the wheels' torques to the tyres' grip. Without them, full braking
    /// locks the wheels and full drive spins them. Default true.
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
    /// [`SimulationError::Setting`] names the first setting out of its range.
    pub fn validate(&self) -> Result<(), SimulationError> {
        /// The wheels' spin on their tyres is integrated explicitly: longer steps are unstable, s.
        const MAX_STEP: f64 = 0.002;
        /// The verdict uses the log alone and cannot check what happens between two samples, Hz.
        const MIN_LOG_RATE: f64 = 50.0;
        /// A controller slower than the planner cannot follow its plans, Hz.
        const MIN_CONTROL_RATE: f64 = 10.0;
        let check = |name, value: f64, in_range: bool, expected| {
            if in_range { Ok(()) } else { Err(SimulationError::Setting { name, value, expected }) }
        };
        check("step", self.step, self.step >= 1e-5 && self.step <= MAX_STEP, "from 0.00001 to 0.002 s")?;
        for (name, rate, min, expected) in [
            ("log_rate_hz", self.log_rate_hz, MIN_LOG_RATE, "from 50 Hz to one per step"),
            ("control_rate_hz", self.control_rate_hz, MIN_CONTROL_RATE, "from 10 Hz to one per step"),
        ] {
            check(name, rate, rate >= min && rate * self.step <= 1.0, expected)?;
        }
        let scale = self.friction_scale;
        check("friction_scale", scale, scale > 0.0 && scale <= 10.0, "above 0, at most 10")
    }

    /// Steps between log samples, at least one; rounded down, so that the rate is not below the setting.
    pub(super) fn steps_per_sample(&self) -> u64 {
        /// Tolerance for the rounding of the two divisions.
        const ROUNDING: f64 = 1e-9;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // validated: from 10 to 1e5 Hz
        let steps = (1.0 / (self.log_rate_hz * self.step) + ROUNDING).floor().clamp(1.0, 1e9) as u64;
        steps
    }

    /// Steps between decisions of the controller, at least one.
    pub(super) fn steps_per_decision(&self) -> u64 {
        steps_between(self.control_rate_hz, self.step)
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // validated: from 10 to 1e5 Hz
fn steps_between(rate: f64, step: f64) -> u64 {
    (1.0 / (rate * step)).round().clamp(1.0, 1e9) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn validation_names_each_setting_out_of_range() {
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
    fn rejects_unknown_keys_and_defaults_missing_ones() {
        assert!(toml::from_str::<Settings>("friction_scal = 0.5").is_err());
        let settings: Settings = toml::from_str("friction_scale = 0.5").unwrap();
        assert_eq!(settings, Settings { friction_scale: 0.5, ..Settings::default() });
    }
}
