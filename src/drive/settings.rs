//! What a user may set about a run, as read from `--config FILE.toml`.

use crate::{planner, simulation};

/// Settings of a run. Every field has a default; unknown keys are refused.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// The planner.
    pub planner: planner::Settings,
    /// The physics rig.
    pub simulation: simulation::Settings,
    /// The closed loop.
    pub run: RunSettings,
}

/// Settings of the closed loop.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunSettings {
    /// Time between planning cycles, s.
    pub replan_interval: f64,
    /// Longest run, s, whatever the goal's time window says.
    pub longest: f64,
    /// Time at rest, with nothing moving any more, after which a run has ended, s.
    pub rest: f64,
}

impl Default for RunSettings {
    fn default() -> Self {
        Self { replan_interval: 0.1, longest: 120.0, rest: 2.0 }
    }
}

/// A setting that is out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("setting `{field}` is {value}, it must be {expected}")]
pub struct SettingsError {
    /// Name of the setting, with its table.
    pub field: &'static str,
    /// Its value.
    pub value: f64,
    /// What it should be.
    pub expected: &'static str,
}

/// A path may be moved sideways by less than the narrowest vehicle is wide, m: probes on both sides then see what is
/// between them.
const WIDEST_CORRIDOR: f64 = 1.0;

/// Edges of a lattice at most: a cycle looks at a good part of them.
const MOST_EDGES: f64 = 1e5;

impl Settings {
    /// Checks every value's range.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let p = &self.planner;
        let l = &p.lattice;
        let positive: [(&'static str, f64); 18] = [
            ("run.replan_interval", self.run.replan_interval),
            ("run.longest", self.run.longest),
            ("run.rest", self.run.rest),
            ("planner.cruise_speed", p.cruise_speed),
            ("planner.shortest_horizon", p.shortest_horizon),
            ("planner.longest_horizon", p.longest_horizon),
            ("planner.lateral_share", p.lateral_share),
            ("planner.stopping_share", p.stopping_share),
            ("planner.restart_lateral", p.restart_lateral),
            ("planner.restart_longitudinal", p.restart_longitudinal),
            ("planner.jerk", p.jerk),
            ("planner.lattice.grid", l.grid),
            ("planner.lattice.shortest_edge", l.shortest_edge),
            ("planner.lattice.edge_time", l.edge_time),
            ("planner.lattice.longest_edge", l.longest_edge),
            ("planner.lattice.most_turn", l.most_turn),
            ("planner.lattice.offset_spacing", l.offset_spacing),
            ("planner.lattice.steepest", l.steepest),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(SettingsError { field, value, expected: "positive and finite" });
            }
        }
        // infinite is a bound here: none
        if p.uncertainty.most_across.is_nan() || p.uncertainty.most_across < 0.0 {
            let (field, value) = ("planner.uncertainty.most_across", p.uncertainty.most_across);
            return Err(SettingsError { field, value, expected: "zero or more" });
        }
        let corridor = p.refinement.corridor;
        if !(corridor > 0.0 && corridor <= WIDEST_CORRIDOR) {
            let (field, expected) = ("planner.refinement.corridor", "positive, and at most 1 m");
            return Err(SettingsError { field, value: corridor, expected });
        }
        let not_negative = [
            ("planner.refinement.least_gain", p.refinement.least_gain),
            ("planner.standoff", p.standoff),
            ("planner.time_gap", p.time_gap),
            ("planner.uncertainty.along", p.uncertainty.along),
            ("planner.uncertainty.across", p.uncertainty.across),
            ("planner.lattice.offset_limit", l.offset_limit),
        ];
        for (field, value) in not_negative.into_iter().chain(l.weights.named()) {
            if !(value.is_finite() && value >= 0.0) {
                return Err(SettingsError { field, value, expected: "zero or more, and finite" });
            }
        }
        // costs are compared in millionths: larger weights would make all of them equal
        if let Some((field, value)) = l.weights.named().into_iter().find(|(_, value)| *value > LARGEST_WEIGHT) {
            return Err(SettingsError { field, value, expected: "at most 1e6" });
        }
        if l.longest_edge < l.shortest_edge {
            let expected = "at least planner.lattice.shortest_edge";
            return Err(SettingsError { field: "planner.lattice.longest_edge", value: l.longest_edge, expected });
        }
        if p.longest_horizon < p.shortest_horizon {
            let expected = "at least planner.shortest_horizon";
            return Err(SettingsError { field: "planner.longest_horizon", value: p.longest_horizon, expected });
        }
        self.bounded_work()
    }

    /// Settings that would make a run endless or fill the memory.
    fn bounded_work(&self) -> Result<(), SettingsError> {
        let l = &self.planner.lattice;
        let counts = [
            (
                "planner.lattice.offset_limit",
                l.offset_limit / l.offset_spacing,
                "at most 100 times offset_spacing",
                100.0,
            ),
            ("planner.lattice.layers", l.layers as f64, "1 to 20", 20.0),
            ("planner.lattice.candidates", l.candidates as f64, "1 to 1000", 1000.0),
            ("planner.expansions", self.planner.expansions as f64, "1 to 10000000", 1e7),
            ("planner.refinement.iterations", self.planner.refinement.iterations as f64, "1 to 100", 100.0),
            ("planner.longest_horizon", self.planner.longest_horizon, "1 to 1000 m", 1000.0),
            ("run.longest", self.run.longest, "1 to 3600 s", 3600.0),
        ];
        for (field, value, expected, most) in counts {
            if value > most || (value < 1.0 && field != "planner.lattice.offset_limit") {
                return Err(SettingsError { field, value, expected });
            }
        }
        // edges between two layers go from every node to every node
        let nodes = (2.0 * (l.offset_limit / l.offset_spacing).floor() + 1.0) * l.headings.len() as f64;
        let edges = nodes * nodes * l.layers as f64;
        if edges > MOST_EDGES {
            let expected = "at most 100000: more offset_spacing, fewer headings or layers";
            return Err(SettingsError {
                field: "planner.lattice: edges, (offsets × headings)² × layers,",
                value: edges,
                expected,
            });
        }
        if !(1..=9).contains(&l.headings.len()) {
            let value = l.headings.len() as f64;
            return Err(SettingsError { field: "planner.lattice.headings", value, expected: "1 to 9 headings" });
        }
        if let Some(&value) = l.headings.iter().find(|h| h.is_nan() || h.abs() > 1.0) {
            return Err(SettingsError { field: "planner.lattice.headings", value, expected: "-1 to 1 rad" });
        }
        let shares = [
            ("planner.lateral_share", self.planner.lateral_share),
            ("planner.stopping_share", self.planner.stopping_share),
            ("planner.refinement.least_gain", self.planner.refinement.least_gain),
        ];
        if let Some((field, value)) = shares.into_iter().find(|(_, value)| *value > 1.0) {
            return Err(SettingsError { field, value, expected: "at most 1" });
        }
        let u = &self.planner.uncertainty;
        for (field, value) in [("planner.uncertainty.along", u.along), ("planner.uncertainty.across", u.across)] {
            if value > HARDEST_TRAFFIC {
                return Err(SettingsError { field, value, expected: "at most 20 m/s²" });
            }
        }
        if self.planner.cruise_speed > 150.0 {
            let value = self.planner.cruise_speed;
            return Err(SettingsError { field: "planner.cruise_speed", value, expected: "at most 150 m/s" });
        }
        if self.run.replan_interval < 0.01 || self.run.replan_interval > 1.0 {
            let value = self.run.replan_interval;
            return Err(SettingsError { field: "run.replan_interval", value, expected: "0.01 to 1 s" });
        }
        let emergency = self.planner.emergency.iter().flat_map(|e| [e.acceleration, e.deceleration]);
        if let Some(value) = emergency.chain([self.planner.emergency_speed]).find(|d| !(d.is_finite() && *d > 0.0)) {
            return Err(SettingsError { field: "planner.emergency", value, expected: "positive and finite" });
        }
        Ok(())
    }
}

/// Accelerations of traffic that are more than any tyre gives, m/s².
const HARDEST_TRAFFIC: f64 = 20.0;
/// Largest weight of a cost term.
const LARGEST_WEIGHT: f64 = 1e6;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_one_wrong_value_is_named() {
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
        wrong.planner.refinement.least_gain = f64::NAN;
        assert_eq!(wrong.validate().unwrap_err().field, "planner.refinement.least_gain");
        let mut wrong = Settings::default();
        wrong.run.replan_interval = 1e-9;
        assert_eq!(wrong.validate().unwrap_err().field, "run.replan_interval");
    }

    #[test]
    fn the_bounds_of_motions_are_checked_and_may_leave_the_lane_unbounded() {
        let read = |text: &str| {
            let settings: Settings = toml::from_str(&format!("[planner.uncertainty]\n{text}")).unwrap();
            settings.validate().map_err(|e| e.field)
        };
        for ok in ["mode = \"required\"", "most_across = inf", "most_across = 0.0", "along = 20.0", "across = 0.0"] {
            assert_eq!(read(ok), Ok(()), "{ok}");
        }
        for key in ["along", "across", "most_across"] {
            for wrong in ["-0.1", "nan"] {
                assert!(read(&format!("{key} = {wrong}")).unwrap_err().ends_with(key));
            }
        }
        assert!(read("along = 20.1").is_err() && read("across = inf").is_err());
        assert!(toml::from_str::<Settings>("[planner]\nrear_traffic = \"yielding\"").is_ok());
        assert!(toml::from_str::<Settings>("[planner]\nrear_traffic = \"polite\"").is_err());
        assert!(toml::from_str::<Settings>("[planner.uncertainty]\nmode = \"always\"").is_err());
    }

    #[test]
    fn every_weight_is_checked() {
        for (name, _) in crate::lattice::Weights::default().named() {
            for wrong in ["-0.001", "nan", "inf", "1.1e6"] {
                let (table, key) = name.rsplit_once('.').unwrap();
                let settings: Settings = toml::from_str(&format!("[{table}]\n{key} = {wrong}")).unwrap();
                assert_eq!(settings.validate().map_err(|e| e.field), Err(name), "{name} = {wrong}");
            }
            let (table, key) = name.rsplit_once('.').unwrap();
            let off: Settings = toml::from_str(&format!("[{table}]\n{key} = 0.0")).unwrap();
            assert_eq!(off.validate(), Ok(()), "{name} = 0 switches a term off");
        }
    }

    #[test]
    fn a_lattice_of_too_many_edges_is_refused_though_each_of_its_counts_is_allowed() {
        let headings = "headings = [-0.2, -0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15, 0.2]";
        let settings: Settings = toml::from_str(&format!("[planner.lattice]\n{headings}")).unwrap();
        assert!(settings.validate().unwrap_err().to_string().contains("edges"));
        let fewer: Settings = toml::from_str("[planner.lattice]\nheadings = [-0.1, 0.0, 0.1]").unwrap();
        assert_eq!(fewer.validate(), Ok(()));
    }

    #[test]
    fn unknown_keys_are_refused() {
        let error = toml::from_str::<Settings>("[planner]\ncruise_sped = 3.0").unwrap_err();
        assert!(error.to_string().contains("cruise_sped"), "{error}");
    }
}
