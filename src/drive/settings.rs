//! Settings of a run, as read from `--config FILE.toml`.

use super::Faults;
use crate::number;
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

/// A setting that is out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("setting `{field}` is {}, it must be {expected}", number::exact(*value))]
pub struct SettingsError {
    /// Name of the setting, with its table.
    pub field: String,
    /// Its value.
    pub value: f64,
    /// Its range.
    pub expected: String,
}

fn refuse(field: impl Into<String>, value: f64, expected: impl Into<String>) -> Result<(), SettingsError> {
    Err(SettingsError { field: field.into(), value, expected: expected.into() })
}

/// Largest lateral shift of a refined path, m. It is less than the width of the narrowest vehicle, so probes on both sides
/// detect everything between them.
const WIDEST_CORRIDOR: f64 = 1.0;

/// Most edges of a lattice: a cycle evaluates a large part of them.
const MOST_EDGES: f64 = 1e5;

impl Settings {
    /// Friction of the road that the planner assumes, as a factor on that of dry asphalt: the least that is known of. Injected
    /// faults are unknown to it.
    #[must_use]
    pub fn believed_friction(&self) -> f64 {
        self.friction.iter().map(|region| region.factor).fold(1.0, f64::min) * self.simulation.friction_scale
    }

    /// Checks the range of every value, including those of the collision checks and of the simulation.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        self.signs()?;
        self.plausible()?;
        self.order()?;
        self.bounded_work()?;
        self.shares()?;
        self.headings()?;
        self.planner.collision.validate().or_else(|e| {
            refuse(format!("planner.collision.{}", e.field), e.value, format!("from {} to {}", e.min, e.max))
        })?;
        self.verdict.validate().or_else(|e| refuse(format!("verdict.{}", e.name), e.value, e.expected))?;
        if let Some((name, value, expected)) = self.faults.out_of_range() {
            return refuse(format!("faults.{name}"), value, expected);
        }
        for (index, region) in self.friction.iter().enumerate() {
            if let Err(SimulationError::Friction { key, value, expected, .. }) = region.validate(index) {
                return refuse(format!("friction[{index}].{key}"), value, expected);
            }
        }
        match self.simulation.validate() {
            Err(SimulationError::Setting { name, value, expected }) => {
                refuse(format!("simulation.{name}"), value, expected)
            }
            _ => Ok(()),
        }
    }

    /// Checks the values that must be positive or not negative.
    fn signs(&self) -> Result<(), SettingsError> {
        let p = &self.planner;
        let l = &p.lattice;
        let positive = [
            ("run.replan_interval", self.run.replan_interval),
            ("run.longest", self.run.longest),
            ("run.standstill_time", self.run.standstill_time),
            ("planner.cruise_speed", p.cruise_speed),
            ("planner.min_horizon", p.min_horizon),
            ("planner.max_horizon", p.max_horizon),
            ("planner.lateral_share", p.lateral_share),
            ("planner.stopping_share", p.stopping_share),
            ("planner.emergency_speed_factor", p.emergency_speed_factor),
            ("planner.restart_lateral", p.restart_lateral),
            ("planner.restart_longitudinal", p.restart_longitudinal),
            ("planner.jerk", p.jerk),
            ("planner.lattice.grid", l.grid),
            ("planner.lattice.min_edge_length", l.min_edge_length),
            ("planner.lattice.edge_time", l.edge_time),
            ("planner.lattice.max_edge_length", l.max_edge_length),
            ("planner.lattice.max_turn", l.max_turn),
            ("planner.lattice.offset_spacing", l.offset_spacing),
            ("planner.lattice.max_slope", l.max_slope),
        ];
        let emergency = p.emergency.iter().enumerate().flat_map(|(i, e)| {
            [("acceleration", e.acceleration), ("deceleration", e.deceleration)]
                .map(|(key, value)| (format!("planner.emergency[{i}].{key}"), value))
        });
        for (field, value) in positive.map(|(field, value)| (field.to_owned(), value)).into_iter().chain(emergency) {
            if !(value.is_finite() && value > 0.0) {
                return refuse(field, value, "positive and finite");
            }
        }
        // infinity means no bound
        if p.uncertainty.max_lateral_deviation.is_nan() || p.uncertainty.max_lateral_deviation < 0.0 {
            return refuse(
                "planner.uncertainty.max_lateral_deviation",
                p.uncertainty.max_lateral_deviation,
                "zero or more",
            );
        }
        let corridor = p.refinement.corridor;
        if !(corridor > 0.0 && corridor <= WIDEST_CORRIDOR) {
            return refuse("planner.refinement.corridor", corridor, "positive, and at most 1 m");
        }
        let not_negative = [
            ("planner.refinement.min_gain", p.refinement.min_gain),
            ("planner.standoff", p.standoff),
            ("planner.time_gap", p.time_gap),
            ("planner.uncertainty.longitudinal", p.uncertainty.longitudinal),
            ("planner.uncertainty.lateral", p.uncertainty.lateral),
            ("planner.lattice.offset_limit", l.offset_limit),
        ];
        for (field, value) in not_negative.into_iter().chain(l.weights.named()) {
            if !(value.is_finite() && value >= 0.0) {
                return refuse(field, value, "zero or more, and finite");
            }
        }
        Ok(())
    }

    /// Checks the values that are most likely a typing error beyond a bound.
    fn plausible(&self) -> Result<(), SettingsError> {
        let (p, l) = (&self.planner, &self.planner.lattice);
        let mut bounded = vec![
            ("run.standstill_time".to_owned(), self.run.standstill_time, 3_600.0, "s"),
            ("planner.standoff".to_owned(), p.standoff, 100.0, "m"),
            ("planner.time_gap".to_owned(), p.time_gap, 60.0, "s"),
            ("planner.lattice.edge_time".to_owned(), l.edge_time, 60.0, "s"),
            ("planner.lattice.max_slope".to_owned(), l.max_slope, 10.0, ""),
            ("planner.emergency_speed_factor".to_owned(), p.emergency_speed_factor, 10.0, "times the cruising speed"),
        ];
        for (i, e) in p.emergency.iter().enumerate() {
            bounded.push((format!("planner.emergency[{i}].acceleration"), e.acceleration, 20.0, "m/s²"));
            bounded.push((format!("planner.emergency[{i}].deceleration"), e.deceleration, 20.0, "m/s²"));
        }
        match bounded.into_iter().find(|(_, value, most, _)| value > most) {
            Some((field, value, most, unit)) => refuse(field, value, format!("at most {most} {unit}").trim_end()),
            None => Ok(()),
        }
    }

    /// Checks the values that must not be less than another setting.
    fn order(&self) -> Result<(), SettingsError> {
        let (p, l) = (&self.planner, &self.planner.lattice);
        if l.max_edge_length < l.min_edge_length {
            return refuse(
                "planner.lattice.max_edge_length",
                l.max_edge_length,
                "at least planner.lattice.min_edge_length",
            );
        }
        if p.max_horizon < p.min_horizon {
            return refuse("planner.max_horizon", p.max_horizon, "at least planner.min_horizon");
        }
        Ok(())
    }

    /// Checks the values that bound run time and memory.
    fn bounded_work(&self) -> Result<(), SettingsError> {
        let (p, l) = (&self.planner, &self.planner.lattice);
        let counts = [
            (
                "planner.lattice.offset_limit",
                l.offset_limit / l.offset_spacing,
                "at most 100 times offset_spacing",
                0.0,
                100.0,
            ),
            ("planner.lattice.layers", l.layers as f64, "1 to 20", 1.0, 20.0),
            ("planner.lattice.root_layers", l.root_layers as f64, "1 to 20", 1.0, 20.0),
            ("planner.lattice.grid", l.grid, "0.5 to 100 m", 0.5, 100.0),
            ("planner.lattice.candidates", l.candidates as f64, "1 to 1000", 1.0, 1000.0),
            ("number of planner.emergency levels", p.emergency.len() as f64, "0 to 16", 0.0, 16.0),
            ("planner.expansions", p.expansions as f64, "1 to 10000000", 1.0, 1e7),
            ("planner.refinement.iterations", p.refinement.iterations as f64, "1 to 100", 1.0, 100.0),
            ("planner.max_horizon", p.max_horizon, "1 to 1000 m", 1.0, 1000.0),
            ("planner.cruise_speed", p.cruise_speed, "at most 150 m/s", 0.0, 150.0),
            // a lower jerk is not noticeable and too slow to stop in time
            ("planner.jerk", p.jerk, "0.5 to 1000 m/s³", 0.5, 1000.0),
            ("run.longest", self.run.longest, "1 to 3600 s", 1.0, 3600.0),
            ("run.replan_interval", self.run.replan_interval, "0.01 to 1 s", 0.01, 1.0),
        ];
        for (field, value, expected, least, most) in counts {
            if !(least..=most).contains(&value) {
                return refuse(field, value, expected);
            }
        }
        Ok(())
    }

    fn shares(&self) -> Result<(), SettingsError> {
        let shares = [
            ("planner.lateral_share", self.planner.lateral_share),
            ("planner.stopping_share", self.planner.stopping_share),
            ("planner.refinement.min_gain", self.planner.refinement.min_gain),
        ];
        if let Some((field, value)) = shares.into_iter().find(|(_, value)| *value > 1.0) {
            return refuse(field, value, "at most 1");
        }
        let u = &self.planner.uncertainty;
        for (field, value) in
            [("planner.uncertainty.longitudinal", u.longitudinal), ("planner.uncertainty.lateral", u.lateral)]
        {
            if value > HARDEST_TRAFFIC {
                return refuse(field, value, "at most 20 m/s²");
            }
        }
        // costs are compared in millionths; larger weights would make all of them equal
        match self.planner.lattice.weights.named().into_iter().find(|(_, value)| *value > LARGEST_WEIGHT) {
            Some((field, value)) => refuse(field, value, "at most 1e6"),
            None => Ok(()),
        }
    }

    /// Checks the headings of the lattice nodes: at least one, each once, and not too many edges.
    fn headings(&self) -> Result<(), SettingsError> {
        let l = &self.planner.lattice;
        let count = l.headings.len();
        if !(1..=9).contains(&count) {
            return refuse("number of planner.lattice.headings", count as f64, "1 to 9; [0.0] is along the road alone");
        }
        for (i, &heading) in l.headings.iter().enumerate() {
            let field = || format!("planner.lattice.headings[{i}]");
            if !(-1.0..=1.0).contains(&heading) {
                return refuse(field(), heading, "from -1 to 1 rad");
            }
            if l.headings[..i].contains(&heading) {
                return refuse(field(), heading, "different from the headings before it");
            }
        }
        // edges between two layers connect every node to every node
        let nodes = (2.0 * (l.offset_limit / l.offset_spacing).floor() + 1.0) * count as f64;
        let edges = nodes * nodes * l.layers as f64;
        if edges > MOST_EDGES {
            let field = "planner.lattice: edges, (offsets × headings)² × layers,";
            return refuse(field, edges, "at most 100000: more offset_spacing, fewer headings or layers");
        }
        Ok(())
    }
}

/// Largest acceleration of other traffic, m/s²; no tyre gives more.
const HARDEST_TRAFFIC: f64 = 20.0;
/// Largest weight of a cost term.
const LARGEST_WEIGHT: f64 = 1e6;

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
        assert!(of("[]").contains("number of planner.lattice.headings` is 0, it must be 1 to 9"), "{}", of("[]"));
        assert!(of("[0.0, nan]").contains("planner.lattice.headings[1]` is NaN, it must be from -1 to 1 rad"));
        assert!(of("[0.0, 2.0]").contains("headings[1]` is 2"));
        assert!(of("[0.1, 0.0, 0.1]").contains("headings[2]` is 0.1, it must be different from"));
        assert!(of("[0.0, -0.0]").contains("different from"));
        let ten: Vec<f64> = (0..10).map(|i| 0.01 * f64::from(i)).collect();
        assert!(of(&format!("{ten:?}")).contains("is 10, it must be 1 to 9"));
    }

    #[test]
    fn refuses_implausible_values_with_their_range() {
        for (text, range) in [
            ("[planner]\nstandoff = 200.0", "planner.standoff` is 200, it must be at most 100 m"),
            ("[planner]\ntime_gap = 61.0", "at most 60 s"),
            ("[run]\nstandstill_time = 1e300", "is 1e300, it must be at most 3600 s"),
            ("[planner.lattice]\nmax_slope = 11.0", "at most 10"),
            ("[[planner.emergency]]\nacceleration = 1.0\ndeceleration = 21.0", "at most 20 m/s²"),
            ("[planner]\nemergency_speed_factor = 11.0", "at most 10 times the cruising speed"),
            ("[planner]\njerk = 1e-9", "0.5 to 1000 m/s³"),
            ("[planner.lattice]\ngrid = 1e-6", "0.5 to 100 m"),
            ("[planner.lattice]\nroot_layers = 0", "1 to 20"),
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
