//! Settings of a run, as read from `--config FILE.toml`.

use super::{Faults, ObservationSettings};
pub use crate::settings::SettingsError;
use crate::settings::{positive, within};
use crate::simulation::SimulationError;
use crate::{planner, simulation, verdict};

/// Settings of a run. Every field has a default; unknown keys are refused.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// The planner.
    pub planner: planner::Settings,
    /// The vehicle simulation.
    pub simulation: simulation::Settings,
    /// Regions of the road with other friction, as `[[friction]]` tables.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub friction: Vec<simulation::FrictionRegion>,
    /// What the vehicle observes, and how it predicts.
    pub observation: ObservationSettings,
    /// The closed loop.
    pub run: RunSettings,
    /// The verdict: tolerances, comfort limits, fallbacks.
    pub verdict: verdict::Settings,
    /// Injected faults.
    pub faults: Faults,
}

/// Settings of the closed loop.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunSettings {
    /// Time between planning cycles, s.
    pub replan_interval: f64,
    /// Longest run, s, regardless of the time window of the goal.
    pub longest: f64,
    /// Time at standstill after which a run ends if waiting cannot help, s.
    pub standstill_time: f64,
}

impl Default for RunSettings {
    fn default() -> Self {
        Self { replan_interval: 0.1, longest: 120.0, standstill_time: 2.0 }
    }
}

impl RunSettings {
    /// Checks the range of every value.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        within("replan_interval", self.replan_interval, 0.01..=1.0, "s")?;
        within("longest", self.longest, 1.0..=3600.0, "s")?;
        positive("standstill_time", self.standstill_time, 3600.0, "s")
    }
}

impl Settings {
    /// Friction of the road that the planner assumes, as a factor on that of dry asphalt: the least that is known of. Injected
    /// faults are unknown to it.
    #[must_use]
    pub fn believed_friction(&self) -> f64 {
        self.friction.iter().map(|region| region.factor).fold(1.0, f64::min) * self.simulation.friction_scale
    }

    /// What the claims of plans refer to.
    #[must_use]
    pub fn planned_for(&self) -> verdict::PlannedFor<'_> {
        verdict::PlannedFor { settings: &self.planner, friction: self.believed_friction() }
    }

    /// Checks the range of every value, table by table.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        self.run.validate().map_err(|e| e.in_table("run"))?;
        self.observation.validate().map_err(|e| e.in_table("observation"))?;
        self.planner.validate().map_err(|e| e.in_table("planner"))?;
        self.verdict.validate().map_err(|e| SettingsError::new(e.name, e.value, e.expected).in_table("verdict"))?;
        self.faults.validate().map_err(|e| e.in_table("faults"))?;
        for (index, region) in self.friction.iter().enumerate() {
            region.validate(index).map_err(of_simulation)?;
        }
        self.simulation.validate().map_err(of_simulation)
    }
}

/// An error of the simulation's settings, or of a friction region, as one of the run.
fn of_simulation(error: SimulationError) -> SettingsError {
    match error {
        SimulationError::Friction { region, key, value, expected } => {
            SettingsError::new(format!("friction[{region}].{key}"), value, expected)
        }
        SimulationError::Setting { name, value, expected } => {
            SettingsError::new(name, value, expected).in_table("simulation")
        }
        // settings have no other errors
        other => SettingsError::new("simulation", f64::NAN, other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_errors_name_the_setting() {
        assert_eq!(Settings::default().validate(), Ok(()));
        let mut wrong = Settings::default();
        wrong.planner.lattice.grid = 0.0;
        assert_eq!(wrong.validate().unwrap_err().field, "planner.lattice.grid");
        let mut wrong = Settings::default();
        wrong.planner.jerk = f64::NAN;
        assert_eq!(wrong.validate().unwrap_err().field, "planner.jerk");
        let mut wrong = Settings::default();
        wrong.planner.lattice.weights.offset = -1.0;
        assert_eq!(wrong.validate().unwrap_err().field, "planner.lattice.weights.offset");
        let mut wrong = Settings::default();
        wrong.planner.refinement.corridor = 1.5;
        assert_eq!(wrong.validate().unwrap_err().field, "planner.refinement.corridor");
        let mut wrong = Settings::default();
        wrong.planner.refinement.iterations = 0;
        assert_eq!(wrong.validate().unwrap_err().field, "planner.refinement.iterations");
        let mut wrong = Settings::default();
        wrong.planner.refinement.min_gain = f64::NAN;
        assert_eq!(wrong.validate().unwrap_err().field, "planner.refinement.min_gain");
        let mut wrong = Settings::default();
        wrong.run.replan_interval = 1e-9;
        assert_eq!(wrong.validate().unwrap_err().field, "run.replan_interval");
    }

    /// The error message for a TOML text.
    fn message(text: &str) -> String {
        let settings: Settings = toml::from_str(text).unwrap();
        settings.validate().expect_err(text).to_string()
    }

    #[test]
    fn settings_of_simulation_and_collision_checks_are_validated() {
        let simulation = message("[simulation]\nstep = 0.5");
        assert_eq!(simulation, "setting `simulation.step` is 0.5, it must be from 0.00001 to 0.002 s");
        let collision = message("[planner.collision]\nspacing = nan");
        assert_eq!(collision, "setting `planner.collision.spacing` is NaN, it must be from 0.01 to 2");
        let margin = message("[planner.collision.static_obstacles]\nlateral = -1.0\nlongitudinal = 0.0");
        assert!(margin.contains("`planner.collision.static_obstacles.lateral` is -1"), "{margin}");
    }

    #[test]
    fn headings_must_be_finite_and_distinct() {
        let of = |headings: &str| message(&format!("[planner.lattice]\nheadings = {headings}"));
        assert!(of("[]").contains("planner.lattice.headings` has 0 entries, it must have from 1 to 9"), "{}", of("[]"));
        assert!(of("[0.0, nan]").contains("planner.lattice.headings[1]` is NaN, it must be from -1 to 1 rad"));
        assert!(of("[0.0, 2.0]").contains("headings[1]` is 2"));
        assert!(of("[0.1, 0.0, 0.1]").contains("headings[2]` is 0.1, it must be different from"));
        assert!(of("[0.0, -0.0]").contains("different from"));
        let ten: Vec<f64> = (0..10).map(|i| 0.01 * f64::from(i)).collect();
        assert!(of(&format!("{ten:?}")).contains("has 10 entries, it must have from 1 to 9"));
    }

    #[test]
    fn refuses_implausible_values_with_their_range() {
        for (text, range) in [
            ("[planner]\nstandoff = 200.0", "planner.standoff` is 200, it must be from 0 to 100 m"),
            ("[planner]\ntime_gap = 61.0", "from 0 to 60 s"),
            ("[run]\nstandstill_time = 1e300", "is 1e300, it must be positive, and at most 3600 s"),
            ("[planner.lattice]\nmax_slope = 11.0", "at most 10"),
            ("[[planner.emergency]]\nacceleration = 1.0\ndeceleration = 21.0", "at most 20 m/s²"),
            ("[planner]\nemergency_speed_factor = 11.0", "at most 10 times the cruising speed"),
            ("[planner]\njerk = 1e-9", "from 0.5 to 1000 m/s³"),
            ("[planner.lattice]\ngrid = 1e-6", "from 0.5 to 100 m"),
            // the misspelt key is named, not the one that it is compared with
            (
                "[planner.lattice]\noffset_spacing = 1e-9",
                "`planner.lattice.offset_spacing` is 1e-9, it must be at least a hundredth of offset_limit",
            ),
            (
                "[planner.lattice]\noffset_limit = 1e9",
                "`planner.lattice.offset_limit` is 1e9, it must be from 0 to 50 m",
            ),
            ("[planner.lattice]\nroot_layers = 0", "from 1 to 20"),
            ("[[planner.emergency]]\nacceleration = 1.0\ndeceleration = 0.0", "planner.emergency[0].deceleration"),
        ] {
            assert!(message(text).contains(range), "{}", message(text));
        }
    }

    #[test]
    fn bounds_of_traffic_motion_are_validated_and_may_be_infinite_laterally() {
        let read = |text: &str| {
            let settings: Settings = toml::from_str(&format!("[planner.uncertainty]\n{text}")).unwrap();
            settings.validate().map_err(|e| e.field)
        };
        for ok in [
            "mode = \"required\"",
            "max_lateral_deviation = inf",
            "max_lateral_deviation = 0.0",
            "longitudinal = 20.0",
            "lateral = 0.0",
        ] {
            assert_eq!(read(ok), Ok(()), "{ok}");
        }
        for key in ["longitudinal", "lateral", "max_lateral_deviation"] {
            for wrong in ["-0.1", "nan"] {
                assert!(read(&format!("{key} = {wrong}")).unwrap_err().ends_with(key));
            }
        }
        assert!(read("longitudinal = 20.1").is_err() && read("lateral = inf").is_err());
        assert!(toml::from_str::<Settings>("[planner]\nrear_traffic = \"yielding\"").is_ok());
        assert!(toml::from_str::<Settings>("[planner]\nrear_traffic = \"polite\"").is_err());
        assert!(toml::from_str::<Settings>("[planner.uncertainty]\nmode = \"always\"").is_err());
    }

    #[test]
    fn every_weight_is_validated() {
        for (name, _) in crate::lattice::Weights::default().named() {
            for wrong in ["-0.001", "nan", "inf", "1.1e6"] {
                let (table, key) = name.rsplit_once('.').unwrap();
                let settings: Settings = toml::from_str(&format!("[{table}]\n{key} = {wrong}")).unwrap();
                assert_eq!(settings.validate().map_err(|e| e.field), Err(name.to_owned()), "{name} = {wrong}");
            }
            let (table, key) = name.rsplit_once('.').unwrap();
            let off: Settings = toml::from_str(&format!("[{table}]\n{key} = 0.0")).unwrap();
            assert_eq!(off.validate(), Ok(()), "{name} = 0 turns a term off");
        }
    }

    #[test]
    fn refuses_too_many_lattice_edges_with_allowed_counts() {
        let headings = "headings = [-0.2, -0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15, 0.2]";
        let settings: Settings = toml::from_str(&format!("[planner.lattice]\n{headings}")).unwrap();
        assert!(settings.validate().unwrap_err().to_string().contains("edges"));
        let fewer: Settings = toml::from_str("[planner.lattice]\nheadings = [-0.1, 0.0, 0.1]").unwrap();
        assert_eq!(fewer.validate(), Ok(()));
    }

    #[test]
    fn refuses_unknown_keys() {
        let error = toml::from_str::<Settings>("[planner]\ncruise_sped = 3.0").unwrap_err();
        assert!(error.to_string().contains("cruise_sped"), "{error}");
    }
}
