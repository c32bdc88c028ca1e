//! Comfort limit presets: the limits of the vehicle or of a publication.
//!
//! A published limit applies to the driven motion, without the margin that planned limits get. Where a publication has no
//! limit, the limit of the vehicle applies.
//!
//! - **SafeTLP**, Table 1, the default: the vehicle's `dynamics.toml`. The limit for braking is the aggressive deceleration.
//! - **ISO 15622** (adaptive cruise control): −3.5 to +2.0 m/s², jerk 5 m/s³ up to 5 m/s and 2.5 m/s³ from 20 m/s on, linear
//!   between; no lateral limits. The standard averages deceleration over 2 s and jerk over 1 s. The filter here
//!   ([`zero_phase_low_pass`](super::zero_phase_low_pass)) averages over less and is therefore stricter. Below 20 m/s the
//!   standard allows more acceleration; here the limit for high speed applies at every speed.
//! - **ISO 11270** (lane keeping assistance): 3 m/s² and 5 m/s³ lateral. The standard averages the jerk over 0.5 s.
//! - **UN R157** (automated lane keeping): a deceleration of 4.0 m/s², the limit that its minimum-risk maneuver aims for.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::vehicle::Comfort;

/// Comfort limit preset.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ComfortPreset {
    /// The limits of the vehicle; those of Table 1 of the SafeTLP paper for the bundled vehicles.
    #[default]
    Safetlp,
    /// ISO 15622, adaptive cruise control.
    Iso15622,
    /// ISO 11270, lane keeping assistance.
    Iso11270,
    /// UN Regulation 157, automated lane keeping systems.
    R157,
}

/// Comfort limits; all are positive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComfortLimits {
    /// Largest acceleration, m/s².
    pub acceleration: f64,
    /// Largest deceleration, m/s².
    pub deceleration: f64,
    /// Largest lateral acceleration, m/s².
    pub lateral_acceleration: f64,
    /// Largest longitudinal jerk at 20 m/s and above, m/s³; twice that up to 5 m/s, linear between.
    pub jerk: f64,
    /// Largest lateral jerk, m/s³; `None` if there is no limit.
    pub lateral_jerk: Option<f64>,
}

/// A quantity with a comfort limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    Acceleration,
    Deceleration,
    LateralAcceleration,
    Jerk,
    LateralJerk,
}

impl ComfortPreset {
    /// Every preset.
    pub const ALL: [Self; 4] = [Self::Safetlp, Self::Iso15622, Self::Iso11270, Self::R157];

    /// The name used in settings and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Safetlp => "safetlp",
            Self::Iso15622 => "iso15622",
            Self::Iso11270 => "iso11270",
            Self::R157 => "r157",
        }
    }

    /// Where the limit of a quantity comes from, in words.
    pub(super) fn source(self, quantity: Quantity) -> String {
        use Quantity::{Acceleration, Deceleration, Jerk, LateralAcceleration, LateralJerk};
        let has_limit = match self {
            Self::Safetlp => true,
            Self::Iso15622 => matches!(quantity, Acceleration | Deceleration | Jerk),
            Self::Iso11270 => matches!(quantity, LateralAcceleration | LateralJerk),
            Self::R157 => quantity == Deceleration,
        };
        let preset = format!("comfort preset {}", self.name());
        if has_limit { preset } else { format!("limit of the vehicle; {preset} has none") }
    }

    /// The limits for a vehicle. `margin` is the share added to the limits of the vehicle; published limits have no margin.
    #[must_use]
    pub fn limits(self, comfort: &Comfort, margin: f64) -> ComfortLimits {
        let factor = 1.0 + margin;
        let of_vehicle = ComfortLimits {
            acceleration: factor * comfort.acceleration,
            deceleration: factor * comfort.aggressive_deceleration,
            lateral_acceleration: factor * comfort.lateral_acceleration,
            jerk: factor * comfort.jerk,
            lateral_jerk: None,
        };
        match self {
            Self::Safetlp => of_vehicle,
            Self::Iso15622 => ComfortLimits { acceleration: 2.0, deceleration: 3.5, jerk: 2.5, ..of_vehicle },
            Self::Iso11270 => ComfortLimits { lateral_acceleration: 3.0, lateral_jerk: Some(5.0), ..of_vehicle },
            Self::R157 => ComfortLimits { deceleration: 4.0, ..of_vehicle },
        }
    }
}

impl FromStr for ComfortPreset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|preset| preset.name() == text).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("expected one of {names}")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_same_on_the_command_line_and_in_files() {
        #[derive(Deserialize)]
        struct File {
            comfort: ComfortPreset,
        }
        for preset in ComfortPreset::ALL {
            assert_eq!(preset.name().parse(), Ok(preset));
            let file: File = toml::from_str(&format!("comfort = \"{}\"", preset.name())).unwrap();
            assert_eq!(file.comfort, preset);
        }
        assert!("iso26262".parse::<ComfortPreset>().unwrap_err().contains("safetlp, iso15622, iso11270, r157"));
    }

    #[test]
    fn published_limits_have_no_margin_and_the_vehicle_sets_the_others() {
        let comfort = Comfort {
            acceleration: 1.0,
            deceleration: 1.5,
            aggressive_deceleration: 2.0,
            lateral_acceleration: 2.5,
            jerk: 1.0,
        };
        let iso = ComfortPreset::Iso15622.limits(&comfort, 0.1);
        assert_eq!((iso.acceleration, iso.deceleration, iso.jerk), (2.0, 3.5, 2.5));
        assert!((iso.lateral_acceleration - 2.75).abs() < 1e-12 && iso.lateral_jerk.is_none());
        let lane = ComfortPreset::Iso11270.limits(&comfort, 0.1);
        assert_eq!((lane.lateral_acceleration, lane.lateral_jerk), (3.0, Some(5.0)));
        assert!((lane.deceleration - 2.2).abs() < 1e-12);
        assert_eq!(ComfortPreset::R157.limits(&comfort, 0.1).deceleration, 4.0);
    }
}
