//! What a user may set about planning.

use crate::collision::{CollisionSettings, MotionBounds};
use crate::lattice;

/// Settings of the planner. Defaults are those of the README.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Speed to drive at where no sign says otherwise, m/s. A faster start speed is kept.
    pub cruise_speed: f64,
    /// Shortest look-ahead, m.
    pub min_horizon: f64,
    /// Longest look-ahead, m.
    pub max_horizon: f64,
    /// Gap kept to what blocks the way, beyond the collision margins, m.
    pub standoff: f64,
    /// Lateral acceleration that speeds on bends are planned for, as a share of the comfort limit.
    pub lateral_share: f64,
    /// Deceleration that planned stops are made with, as a share of the comfortable one.
    pub stopping_share: f64,
    /// What plans may fall back to when the comfortable limits prove nothing, gentlest first. Each is tried without
    /// margins.
    pub emergency: Vec<EmergencyLimits>,
    /// Factor on the cruising speed where an emergency asks for more than the comfortable acceleration, to get out of
    /// somebody's way.
    pub emergency_speed_factor: f64,
    /// Lateral tracking error at which planning restarts from the measured state, m.
    pub restart_lateral: f64,
    /// Longitudinal tracking error at which planning restarts from the measured state, m.
    pub restart_longitudinal: f64,
    /// Expansions allowed in each phase of a speed search.
    pub expansions: usize,
    /// Largest planned jerk, m/s³.
    pub jerk: f64,
    /// Time by which moving obstacles are given way before and after, where that is possible, s.
    pub time_gap: f64,
    /// What traffic from behind means for proofs.
    pub rear_traffic: RearTraffic,
    /// Whether proofs are to hold for more than the predicted motions.
    pub uncertainty: Uncertainty,
    /// The lattice.
    pub lattice: lattice::Settings,
    /// What is done with the path chosen from it.
    pub refinement: lattice::refine::RefinementSettings,
    /// The collision checks.
    pub collision: CollisionSettings,
}

/// What traffic that comes from behind, in our lane and heading our way, means for proofs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RearTraffic {
    /// It binds as all other does: a rest that its prediction drives through is not safe.
    #[default]
    Binding,
    /// It brakes for us, and blocks nothing until it leaves our way. The verdict does not know of it: a contact from behind
    /// is a contact.
    Yielding,
}

/// Proofs against all motions of the traffic within bounds around the predicted ones.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Uncertainty {
    /// Whether such proofs are sought.
    pub mode: UncertaintyMode,
    /// Acceleration along an obstacle's predicted heading beyond the predicted one, either way, m/s².
    pub longitudinal: f64,
    /// Acceleration across it, m/s².
    pub lateral: f64,
    /// Largest deviation across it, m; infinite (`inf`) if only the accelerations bound it.
    pub max_lateral_deviation: f64,
    /// Whether vehicles and bicycles may move backwards.
    pub vehicles_reverse: bool,
}

/// Whether proofs against sets of motions are sought.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UncertaintyMode {
    /// No: the predicted motions count.
    #[default]
    Off,
    /// First; where there is none, the predicted motions count.
    Preferred,
    /// No other counts.
    Required,
}

impl Default for Uncertainty {
    fn default() -> Self {
        Self {
            mode: UncertaintyMode::Off,
            longitudinal: 1.0,
            lateral: 0.2,
            max_lateral_deviation: f64::INFINITY,
            vehicles_reverse: false,
        }
    }
}

impl Uncertainty {
    /// The bounds of the motions.
    #[must_use]
    pub fn bounds(&self) -> MotionBounds {
        let Self { longitudinal, lateral, max_lateral_deviation, vehicles_reverse, .. } = *self;
        MotionBounds { longitudinal, lateral, max_lateral_deviation, vehicles_reverse }
    }
}

/// Accelerations of a plan in an emergency.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EmergencyLimits {
    /// Largest acceleration, m/s².
    pub acceleration: f64,
    /// Largest deceleration, m/s², positive.
    pub deceleration: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            cruise_speed: 50.0 / 3.6,
            min_horizon: 40.0,
            max_horizon: 300.0,
            standoff: 0.8,
            lateral_share: 0.75,
            stopping_share: 0.9,
            emergency: vec![
                EmergencyLimits { acceleration: 1.5, deceleration: 4.0 },
                EmergencyLimits { acceleration: 2.5, deceleration: 4.0 },
                EmergencyLimits { acceleration: 1.5, deceleration: 8.0 },
                EmergencyLimits { acceleration: 4.0, deceleration: 8.0 },
            ],
            emergency_speed_factor: 1.3,
            restart_lateral: 0.5,
            restart_longitudinal: 1.5,
            expansions: 5_000,
            jerk: 1.8,
            time_gap: 0.8,
            rear_traffic: RearTraffic::default(),
            uncertainty: Uncertainty::default(),
            lattice: lattice::Settings::default(),
            refinement: lattice::refine::RefinementSettings::default(),
            collision: CollisionSettings::default(),
        }
    }
}
