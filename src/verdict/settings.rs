//! What a run is asked for, the tolerances of the checks, and which fallbacks are simulated.

use serde::{Deserialize, Serialize};

use super::{ComfortPreset, Expectation};

/// What the run is asked for, and the tolerances of the checks. In a settings file: the table `[verdict]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Goal or safe stop. Not in a file: the outcome of the run decides.
    #[serde(skip)]
    pub expect: Expectation,
    /// Largest overlap with an obstacle that is no contact, m. A millimetre: the physics engine reports deeper overlaps, and
    /// rounding is far smaller.
    pub contact_tolerance: f64,
    /// Largest excursion beyond the lanelets that is still on the road, m. Neighbouring lanelets of real maps have gaps of
    /// centimetres between their bounds, and polylines deviate from their curves by as much.
    pub road_tolerance: f64,
    /// Largest distance of the final position before the planned stop, m.
    pub stop_short: f64,
    /// Largest distance of the final position beyond the planned stop, m.
    pub stop_past: f64,
    /// Largest speed at standstill, m/s.
    pub standstill_speed: f64,
    /// Largest lateral distance from the reference pose, m. By default that of the vehicle's tracking tube with full use of the
    /// grip that proofs may use.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracking: Option<f64>,
    /// Comfort limit preset.
    pub comfort: ComfortPreset,
    /// Share by which the driven motion may exceed the limits of the vehicle, which the planner uses: the part of the tracking
    /// controller.
    pub comfort_margin: f64,
    /// Frequency at which the comfort filter passes 1/√2 of the amplitude, Hz. See
    /// [`zero_phase_low_pass`](super::zero_phase_low_pass).
    pub comfort_cutoff: f64,
    /// Which fallbacks are simulated.
    pub fallbacks: FallbackSettings,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            expect: Expectation::Goal,
            contact_tolerance: 0.001,
            road_tolerance: 0.05,
            stop_short: 0.3,
            stop_past: 0.1,
            standstill_speed: 0.05,
            tracking: None,
            comfort: ComfortPreset::default(),
            comfort_margin: 0.1,
            comfort_cutoff: 2.0,
            fallbacks: FallbackSettings::default(),
        }
    }
}

/// Which fallbacks are simulated to standstill, in branches of the simulation. In a settings file: the table
/// `[verdict.fallbacks]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FallbackSettings {
    /// Whether any is simulated. If not, the check `fallback_stops` does not apply.
    pub enabled: bool,
    /// Time between two regular samples, s.
    pub interval: f64,
    /// Changes of the plan sampled beyond those, at most, in a run.
    pub changes: usize,
    /// How long a stopped vehicle is checked against moving obstacles, s.
    pub hold: f64,
}

impl Default for FallbackSettings {
    fn default() -> Self {
        Self { enabled: true, interval: 0.5, changes: 40, hold: 10.0 }
    }
}

/// A setting that is out of its range.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("setting `{name}` of the verdict is {value}, it must be {expected}")]
pub struct SettingsError {
    /// Name of the setting inside its table.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Its range.
    pub expected: &'static str,
}

impl Settings {
    /// The default tolerances, with what the run is asked for.
    #[must_use]
    pub fn expecting(expect: Expectation) -> Self {
        Self { expect, ..Self::default() }
    }

    /// Checks the range of every value. Beyond the upper end a check would be meaningless.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        #[allow(clippy::cast_precision_loss)] // a count, compared with 10,000
        let ranges = [
            ("contact_tolerance", self.contact_tolerance, 0.0, 0.1, "from 0 to 0.1 m"),
            ("road_tolerance", self.road_tolerance, 0.0, 5.0, "from 0 to 5 m"),
            ("stop_short", self.stop_short, 0.0, 10.0, "from 0 to 10 m"),
            ("stop_past", self.stop_past, 0.0, 10.0, "from 0 to 10 m"),
            ("standstill_speed", self.standstill_speed, 0.001, 0.5, "from 0.001 to 0.5 m/s"),
            ("tracking", self.tracking.unwrap_or(0.0), 0.0, 5.0, "from 0 to 5 m"),
            ("comfort_margin", self.comfort_margin, 0.0, 1.0, "from 0 to 1"),
            ("comfort_cutoff", self.comfort_cutoff, 0.1, 10.0, "from 0.1 to 10 Hz"),
            ("fallbacks.interval", self.fallbacks.interval, 0.05, 3600.0, "from 0.05 to 3600 s"),
            ("fallbacks.changes", self.fallbacks.changes as f64, 0.0, 10_000.0, "at most 10000"),
            ("fallbacks.hold", self.fallbacks.hold, 0.0, 600.0, "from 0 to 600 s"),
        ];
        match ranges.into_iter().find(|(_, value, least, most, _)| !(*least..=*most).contains(value)) {
            Some((name, value, .., expected)) => Err(SettingsError { name, value, expected }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_errors_name_the_setting() {
        assert_eq!(Settings::default().validate(), Ok(()));
        for (text, name) in [
            ("contact_tolerance = -0.001", "contact_tolerance"),
            ("road_tolerance = nan", "road_tolerance"),
            ("stop_short = 11.0", "stop_short"),
            ("stop_past = inf", "stop_past"),
            ("standstill_speed = 0.0", "standstill_speed"),
            ("tracking = -1.0", "tracking"),
            ("comfort_margin = 1.1", "comfort_margin"),
            ("comfort_cutoff = 0.0", "comfort_cutoff"),
            ("[fallbacks]\ninterval = 0.0", "fallbacks.interval"),
            ("[fallbacks]\nchanges = 10001", "fallbacks.changes"),
            ("[fallbacks]\nhold = -1.0", "fallbacks.hold"),
        ] {
            let settings: Settings = toml::from_str(text).unwrap();
            assert_eq!(settings.validate().map_err(|e| e.name), Err(name), "{text}");
        }
    }

    #[test]
    fn refuses_unknown_keys_and_the_expectation() {
        for text in ["expect = \"Stop\"", "comfrt = \"safetlp\"", "comfort = \"iso\"", "[fallbacks]\nevery = 1.0"] {
            assert!(toml::from_str::<Settings>(text).is_err(), "{text}");
        }
    }
}
