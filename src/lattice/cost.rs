//! The cost of a path, by term. All terms have the same unit, metres of detour, and add up along the path.

use crate::settings::{SettingsError, within};

/// Weights of the cost terms; the section `[planner.lattice.weights]` of a settings file. Each is in metres of detour per
/// unit of its quantity.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Weights {
    /// Per metre of path and square metre of offset from the reference line, 1/m².
    pub offset: f64,
    /// Per unit of bending energy ∫κ² ds (1/m), m².
    pub curvature: f64,
    /// Per metre lost in curves that are too tight for the present speed. More than 1, since braking and accelerating lose
    /// about the same distance again.
    pub curve_slowdown: f64,
    /// Per metre of path at zero clearance; decreases quadratically to zero at `desired_clearance`.
    pub clearance: f64,
    /// Clearance from which on there is no cost, m. Not a weight.
    pub desired_clearance: f64,
    /// Per metre of path and metre by which the footprint leaves its lane, 1/m.
    pub lane_deviation: f64,
    /// Per metre between the free end of the path and the horizon.
    pub progress_shortfall: f64,
    /// Per metre of the largest lateral distance from the committed plan.
    pub plan_change: f64,
    /// Per lane change that the route still needs, m.
    pub lane_change: f64,
    /// For a path that passes the place of the goal without meeting its position and heading, m.
    pub missed_target: f64,
    /// Per metre of progress less than unobstructed driving, beyond `curve_slowdown`.
    pub travel_time: f64,
}

impl Weights {
    /// Every weight with its key in the settings.
    #[must_use]
    pub fn named(&self) -> [(&'static str, f64); 11] {
        [
            ("planner.lattice.weights.offset", self.offset),
            ("planner.lattice.weights.curvature", self.curvature),
            ("planner.lattice.weights.curve_slowdown", self.curve_slowdown),
            ("planner.lattice.weights.clearance", self.clearance),
            ("planner.lattice.weights.desired_clearance", self.desired_clearance),
            ("planner.lattice.weights.lane_deviation", self.lane_deviation),
            ("planner.lattice.weights.progress_shortfall", self.progress_shortfall),
            ("planner.lattice.weights.plan_change", self.plan_change),
            ("planner.lattice.weights.lane_change", self.lane_change),
            ("planner.lattice.weights.missed_target", self.missed_target),
            ("planner.lattice.weights.travel_time", self.travel_time),
        ]
    }
}

/// Largest weight. Costs are compared in millionths; larger weights would make all of them equal.
const LARGEST_WEIGHT: f64 = 1e6;

impl Weights {
    /// Checks the range of every weight; zero turns a term off.
    ///
    /// # Errors
    /// The first weight out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        self.named().into_iter().try_for_each(|(key, weight)| {
            within(key.rsplit('.').next().unwrap_or(key), weight, 0.0..=LARGEST_WEIGHT, "")
        })
    }
}

impl Default for Weights {
    fn default() -> Self {
        Self {
            offset: 0.05,
            curvature: 40.0,
            curve_slowdown: 2.0,
            clearance: 0.3,
            desired_clearance: 0.8,
            lane_deviation: 0.15,
            progress_shortfall: 0.6,
            plan_change: 1.5,
            lane_change: 12.0,
            missed_target: 12.0,
            travel_time: 1.0,
        }
    }
}

/// The cost of a path by term, metres of detour.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct CostTerms {
    /// Distance from the reference line.
    pub offset: f64,
    /// Bending energy.
    pub curvature: f64,
    /// Slowdown in curves that are tighter than the reference line and too tight for the present speed.
    pub curve_slowdown: f64,
    /// Small clearance to static obstacles and the road boundary.
    pub clearance: f64,
    /// Deviation of the footprint from its lane.
    pub lane_deviation: f64,
    /// Free length less than the horizon.
    pub progress_shortfall: f64,
    /// Departure from the committed plan.
    pub plan_change: f64,
    /// Lane changes that the route still needs.
    pub lane_change: f64,
    /// The place of the goal, passed without meeting it.
    pub missed_target: f64,
    /// Progress less than unobstructed driving, beyond `curve_slowdown`. Known only after the speed search.
    pub travel_time: f64,
}

impl CostTerms {
    /// Every term with its name in reports.
    #[must_use]
    pub fn named(&self) -> [(&'static str, f64); 10] {
        [
            ("offset", self.offset),
            ("curvature", self.curvature),
            ("curve_slowdown", self.curve_slowdown),
            ("clearance", self.clearance),
            ("lane_deviation", self.lane_deviation),
            ("progress_shortfall", self.progress_shortfall),
            ("plan_change", self.plan_change),
            ("lane_change", self.lane_change),
            ("missed_target", self.missed_target),
            ("travel_time", self.travel_time),
        ]
    }

    /// The sum of all terms.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.offset
            + self.curvature
            + self.curve_slowdown
            + self.clearance
            + self.lane_deviation
            + self.progress_shortfall
            + self.plan_change
            + self.lane_change
            + self.missed_target
            + self.travel_time
    }

    /// The total in integer millionths, for comparisons: costs that differ only by rounding are equal, so that rotating or
    /// moving a map does not change decisions.
    #[must_use]
    pub fn rank(&self) -> i64 {
        rank(self.total())
    }

    /// The sum, term by term.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        Self {
            offset: self.offset + other.offset,
            curvature: self.curvature + other.curvature,
            curve_slowdown: self.curve_slowdown + other.curve_slowdown,
            clearance: self.clearance + other.clearance,
            lane_deviation: self.lane_deviation + other.lane_deviation,
            progress_shortfall: self.progress_shortfall + other.progress_shortfall,
            plan_change: self.plan_change + other.plan_change,
            lane_change: self.lane_change + other.lane_change,
            missed_target: self.missed_target + other.missed_target,
            travel_time: self.travel_time + other.travel_time,
        }
    }
}

/// A cost in integer millionths; see [`CostTerms::rank`].
#[must_use]
#[allow(clippy::cast_possible_truncation)] // saturates far above any cost of a path
pub fn rank(cost: f64) -> i64 {
    (cost * 1e6).round() as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(value: &impl serde::Serialize) -> Vec<String> {
        serde_json::to_value(value).unwrap().as_object().unwrap().keys().cloned().collect()
    }

    fn sorted<'a>(names: impl IntoIterator<Item = &'a str>) -> Vec<String> {
        let mut names: Vec<String> = names.into_iter().map(str::to_owned).collect();
        names.sort();
        names
    }

    #[test]
    fn every_weight_and_term_has_a_name_and_every_term_has_a_weight() {
        let weights = Weights::default();
        let names = weights.named().map(|(name, _)| name.strip_prefix("planner.lattice.weights.").unwrap());
        assert_eq!(sorted(names), sorted(keys(&weights).iter().map(String::as_str)));
        let terms = CostTerms::default();
        assert_eq!(sorted(terms.named().map(|t| t.0)), sorted(keys(&terms).iter().map(String::as_str)));
        assert!(terms.named().iter().all(|(term, _)| names.contains(term)));
    }

    #[test]
    fn the_total_is_the_sum_of_all_terms() {
        let mut terms = CostTerms::default();
        for (i, term) in [
            &mut terms.offset,
            &mut terms.curvature,
            &mut terms.curve_slowdown,
            &mut terms.clearance,
            &mut terms.lane_deviation,
            &mut terms.progress_shortfall,
            &mut terms.plan_change,
            &mut terms.lane_change,
            &mut terms.missed_target,
            &mut terms.travel_time,
        ]
        .into_iter()
        .enumerate()
        {
            *term = f64::from(1 << i);
        }
        assert_eq!(terms.total(), 1023.0);
        assert_eq!(terms.named().map(|t| t.1).iter().sum::<f64>(), 1023.0);
        assert_eq!(terms.plus(&terms).named().map(|t| t.1), terms.named().map(|t| 2.0 * t.1));
        assert_eq!((rank(1.0), rank(1.0 + 4e-7), terms.rank()), (1_000_000, 1_000_000, 1_023_000_000));
    }
}
