//! What a user may set about planning.

use crate::collision::CollisionSettings;
use crate::lattice;

/// Settings of the planner. Defaults are those of the README.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Speed to drive at where no sign says otherwise, m/s. A faster start speed is kept.
    pub cruise_speed: f64,
    /// Shortest look-ahead, m.
    pub shortest_horizon: f64,
    /// Longest look-ahead, m.
    pub longest_horizon: f64,
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
    pub emergency_speed: f64,
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
    /// The lattice.
    pub lattice: lattice::Settings,
    /// What is done with the path chosen from it.
    pub refinement: lattice::refine::RefinementSettings,
    /// The collision checks.
    pub collision: CollisionSettings,
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
            shortest_horizon: 40.0,
            longest_horizon: 300.0,
            standoff: 0.8,
            lateral_share: 0.75,
            stopping_share: 0.9,
            emergency: vec![
                EmergencyLimits { acceleration: 1.5, deceleration: 4.0 },
                EmergencyLimits { acceleration: 2.5, deceleration: 4.0 },
                EmergencyLimits { acceleration: 1.5, deceleration: 8.0 },
                EmergencyLimits { acceleration: 4.0, deceleration: 8.0 },
            ],
            emergency_speed: 1.3,
            restart_lateral: 0.5,
            restart_longitudinal: 1.5,
            expansions: 5_000,
            jerk: 1.8,
            time_gap: 0.8,
            lattice: lattice::Settings::default(),
            refinement: lattice::refine::RefinementSettings::default(),
            collision: CollisionSettings::default(),
        }
    }
}
