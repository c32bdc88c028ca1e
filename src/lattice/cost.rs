//! What a path costs, term by term. All terms are additive along the path, in the same unit: metres of detour.

/// Weights of the cost terms.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Weights {
    /// Per metre of way and square metre of offset from the reference line.
    pub offset: f64,
    /// Per 1/m of bending energy ∫κ² ds.
    pub curvature: f64,
    /// Per metre lost where the path bends more than the present speed allows: more than 1, as slowing down and gaining
    /// speed again lose about as much again.
    pub curve_slowdown: f64,
    /// Per metre of way at zero clearance; falls with the square to nothing at `desired_clearance`.
    pub clearance: f64,
    /// Clearance that costs nothing, m.
    pub desired_clearance: f64,
    /// Per metre of way and metre by which the footprint leaves its lane.
    pub lane_deviation: f64,
    /// Per metre missing to the horizon where the way is blocked.
    pub progress_shortfall: f64,
    /// Per metre of the largest lateral distance to the plan in force: the price of leaving it.
    pub plan_change: f64,
    /// Per lane change still needed to stay on the route.
    pub lane_change: f64,
    /// Per metre that the speed layer falls behind free driving, beyond what `curve_slowdown` has counted.
    pub travel_time: f64,
}

impl Weights {
    /// Every weight with its name in the settings.
    #[must_use]
    pub fn named(&self) -> [(&'static str, f64); 10] {
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
            ("planner.lattice.weights.travel_time", self.travel_time),
        ]
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
            travel_time: 1.0,
        }
    }
}

/// The cost of a path by term.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct CostTerms {
    /// Distance from the reference line.
    pub offset: f64,
    /// Bending energy.
    pub curvature: f64,
    /// Bends, sharper than the reference line's, that the present speed can't be kept through.
    pub curve_slowdown: f64,
    /// Closeness to static obstacles and the road's edge.
    pub clearance: f64,
    /// Leaving the lane.
    pub lane_deviation: f64,
    /// Way missing to the horizon.
    pub progress_shortfall: f64,
    /// Leaving the plan in force.
    pub plan_change: f64,
    /// Lane changes to go.
    pub lane_change: f64,
    /// Falling behind free driving, beyond `curve_slowdown`.
    pub travel_time: f64,
}

impl CostTerms {
    /// Every term with its name in reports.
    #[must_use]
    pub fn named(&self) -> [(&'static str, f64); 9] {
        [
            ("offset", self.offset),
            ("curvature", self.curvature),
            ("curve_slowdown", self.curve_slowdown),
            ("clearance", self.clearance),
            ("lane_deviation", self.lane_deviation),
            ("progress_shortfall", self.progress_shortfall),
            ("plan_change", self.plan_change),
            ("lane_change", self.lane_change),
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
            + self.travel_time
    }

    /// The sum in whole millionths, to compare: costs that differ by rounding only are equal, so that a turned or moved
    /// map does not decide between them.
    #[must_use]
    pub fn rank(&self) -> i64 {
        rank(self.total())
    }

    /// Term by term sum.
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
            travel_time: self.travel_time + other.travel_time,
        }
    }
}

/// A cost in whole millionths; see [`CostTerms::rank`].
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
    fn every_weight_and_every_term_is_named_and_every_term_has_its_weight() {
        let weights = Weights::default();
        let names = weights.named().map(|(name, _)| name.strip_prefix("planner.lattice.weights.").unwrap());
        assert_eq!(sorted(names), sorted(keys(&weights).iter().map(String::as_str)));
        let terms = CostTerms::default();
        assert_eq!(sorted(terms.named().map(|t| t.0)), sorted(keys(&terms).iter().map(String::as_str)));
        assert!(terms.named().iter().all(|(term, _)| names.contains(term)));
    }

    #[test]
    fn the_total_is_the_sum_of_the_named_terms_and_sums_go_term_by_term() {
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
            &mut terms.travel_time,
        ]
        .into_iter()
        .enumerate()
        {
            *term = f64::from(1 << i);
        }
        assert_eq!(terms.total(), 511.0);
        assert_eq!(terms.named().map(|t| t.1).iter().sum::<f64>(), 511.0);
        assert_eq!(terms.plus(&terms).named().map(|t| t.1), terms.named().map(|t| 2.0 * t.1));
        assert_eq!((rank(1.0), rank(1.0 + 4e-7), terms.rank()), (1_000_000, 1_000_000, 511_000_000));
    }
}
