//! Settings of the planner.

use crate::collision::{CollisionSettings, MotionBounds};
use crate::lattice;
use crate::settings::{SettingsError, count, length, positive, within};

/// Settings of the planner; the section `[planner]` of a settings file. SI units.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Cruise speed without a speed limit, m/s. A higher start speed replaces it.
    pub cruise_speed: f64,
    /// Shortest planning horizon, m. The horizon grows with the stopping distance.
    pub min_horizon: f64,
    /// Longest planning horizon, m.
    pub max_horizon: f64,
    /// Gap between the vehicle and a blocking obstacle at a planned stop, in addition to the collision margins, m.
    pub standoff: f64,
    /// Lateral acceleration of planned speeds in curves, as a fraction of the limit.
    pub lateral_share: f64,
    /// Deceleration of planned stops, as a fraction of comfortable braking.
    pub stopping_share: f64,
    /// Acceleration limits of the emergency levels, gentlest first. The planner tries them in order if no plan is proven
    /// within the comfort limits. All of them use the collision world without margins.
    pub emergency: Vec<EmergencyLimits>,
    /// Factor on the cruise speed at emergency levels with more than the comfortable acceleration, so that the vehicle can
    /// clear a conflict zone.
    pub emergency_speed_factor: f64,
    /// Maximum number of expansions of a speed search in each phase that looks for proofs; a fifth of it in the others.
    pub expansions: usize,
    /// Largest jerk of comfortable speed profiles, m/s³.
    pub jerk: f64,
    /// Time gap to moving obstacles, before and after them, s. Less if no plan is proven with it.
    pub time_gap: f64,
    /// Treatment of traffic from behind in proofs.
    pub rear_traffic: RearTraffic,
    /// Bounds of motions around the predictions that proofs cover.
    pub uncertainty: Uncertainty,
    /// What is assumed of an obstacle after the end of its prediction.
    pub extrapolation: Extrapolation,
    /// Settings of the lattice.
    pub lattice: lattice::Settings,
    /// Settings of the refinement of the chosen path.
    pub refinement: lattice::refine::RefinementSettings,
    /// Settings of the collision checks.
    pub collision: CollisionSettings,
}

/// Treatment in proofs of traffic that follows the vehicle in its lane and direction.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RearTraffic {
    /// It constrains proofs like all other traffic: a standstill on the predicted path of a following vehicle is unsafe.
    #[default]
    Binding,
    /// It brakes for the vehicle: it constrains proofs only after it has left the vehicle's path. Only the planner assumes
    /// this; the verdict counts a contact from behind as a contact.
    Yielding,
}

/// Bounds of obstacle motions around the predictions; robust proofs hold for every motion within them.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Uncertainty {
    /// Whether the planner seeks robust proofs.
    pub mode: UncertaintyMode,
    /// Largest difference from the predicted acceleration in the direction of the predicted heading, m/s².
    pub longitudinal: f64,
    /// Largest difference from the predicted acceleration perpendicular to the predicted heading, m/s².
    pub lateral: f64,
    /// Largest lateral deviation from the prediction, m; `inf` for no bound other than the accelerations.
    pub max_lateral_deviation: f64,
    /// Whether vehicles and bicycles may reverse.
    pub vehicles_reverse: bool,
}

/// Whether proofs must be robust, that is, hold for all motions within the bounds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UncertaintyMode {
    /// Proofs hold for the predicted motions.
    #[default]
    Off,
    /// The planner tries robust proofs first, then proofs for the predicted motions.
    Preferred,
    /// The planner accepts robust proofs only.
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
    /// The bounds, as the collision checks use them.
    #[must_use]
    pub fn bounds(&self) -> MotionBounds {
        let Self { longitudinal, lateral, max_lateral_deviation, vehicles_reverse, .. } = *self;
        MotionBounds { longitudinal, lateral, max_lateral_deviation, vehicles_reverse }
    }
}

/// What is assumed of an obstacle after the end of its prediction.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Extrapolation {
    /// For how long its motion is continued, s; 0 if it vanishes at the end of its prediction, as in CommonRoad.
    pub duration: f64,
    /// How.
    pub motion: ExtrapolatedMotion,
}

/// How the motion of an obstacle continues after its prediction.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExtrapolatedMotion {
    /// With its last speed and heading.
    #[default]
    LastMotion,
    /// As a set that contains the positions that it reaches with the acceleration bounds of [`Uncertainty`].
    Set,
}

impl Default for Extrapolation {
    fn default() -> Self {
        Self { duration: 3.0, motion: ExtrapolatedMotion::default() }
    }
}

/// Acceleration limits of an emergency level.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EmergencyLimits {
    /// Largest acceleration, m/s².
    pub acceleration: f64,
    /// Largest deceleration, m/s², positive.
    pub deceleration: f64,
}

/// Largest acceleration of other traffic, m/s²; no tyre gives more.
const HARDEST_TRAFFIC: f64 = 20.0;
/// Largest limit of an emergency level, m/s².
const HARDEST_EMERGENCY: f64 = 20.0;

impl Settings {
    /// Checks the range of every value, including those of the lattice, the refinement and the collision checks.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        positive("cruise_speed", self.cruise_speed, 150.0, "m/s")?;
        positive("min_horizon", self.min_horizon, f64::INFINITY, "m")?;
        within("max_horizon", self.max_horizon, 1.0..=1000.0, "m")?;
        if self.max_horizon < self.min_horizon {
            return Err(SettingsError::new("max_horizon", self.max_horizon, "at least min_horizon"));
        }
        within("standoff", self.standoff, 0.0..=100.0, "m")?;
        positive("lateral_share", self.lateral_share, 1.0, "")?;
        positive("stopping_share", self.stopping_share, 1.0, "")?;
        length("emergency", &self.emergency, 0..=16)?;
        for (i, level) in self.emergency.iter().enumerate() {
            level.validate().map_err(|e| e.in_table(&format!("emergency[{i}]")))?;
        }
        positive("emergency_speed_factor", self.emergency_speed_factor, 10.0, "times the cruising speed")?;
        count("expansions", self.expansions, 1..=10_000_000)?;
        // a lower jerk is not noticeable and too slow to stop in time
        within("jerk", self.jerk, 0.5..=1000.0, "m/s³")?;
        within("time_gap", self.time_gap, 0.0..=60.0, "s")?;
        self.uncertainty.validate().map_err(|e| e.in_table("uncertainty"))?;
        within("extrapolation.duration", self.extrapolation.duration, 0.0..=60.0, "s")?;
        self.lattice.validate().map_err(|e| e.in_table("lattice"))?;
        self.refinement.validate().map_err(|e| e.in_table("refinement"))?;
        self.collision.validate().map_err(|e| of_collision(&e))
    }
}

/// An error of the collision checks as one of the planner.
pub(super) fn of_collision(error: &crate::collision::SettingsError) -> SettingsError {
    let expected = format!("from {} to {}", error.min, error.max);
    SettingsError::new(error.field, error.value, expected).in_table("collision")
}

impl Uncertainty {
    /// Checks the range of every value; the lateral deviation may be infinite.
    ///
    /// # Errors
    /// The first value out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        within("longitudinal", self.longitudinal, 0.0..=HARDEST_TRAFFIC, "m/s²")?;
        within("lateral", self.lateral, 0.0..=HARDEST_TRAFFIC, "m/s²")?;
        within("max_lateral_deviation", self.max_lateral_deviation, 0.0..=f64::INFINITY, "m")
    }
}

impl EmergencyLimits {
    /// Checks both limits.
    ///
    /// # Errors
    /// The first limit out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        positive("acceleration", self.acceleration, HARDEST_EMERGENCY, "m/s²")?;
        positive("deceleration", self.deceleration, HARDEST_EMERGENCY, "m/s²")
    }
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
            expansions: 3_000,
            jerk: 1.8,
            time_gap: 0.8,
            rear_traffic: RearTraffic::default(),
            uncertainty: Uncertainty::default(),
            extrapolation: Extrapolation::default(),
            lattice: lattice::Settings::default(),
            refinement: lattice::refine::RefinementSettings::default(),
            collision: CollisionSettings::default(),
        }
    }
}
