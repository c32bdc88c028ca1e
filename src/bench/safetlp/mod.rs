//! `stopline bench safetlp`: the experiment of *Safe Temporal Planning for Urban Driving* (Empirical Evaluation).
//!
//! The road is straight, empty and 100 m long, with steps of half a metre, a speed limit of 15 m/s and a stop at its
//! end. The four sets of acceleration limits (Table 1 of the paper) and start speeds from 0 to 5 m/s in steps of 0.2
//! m/s give 104 instances. Every [`Method`] searches each instance; [`crate::speed::prove()`], which shares no code with
//! the searches, verifies the plans.
//!
//! The paper leaves three choices open:
//!
//! - *Time discretisation.* In a spatiotemporal lattice, states of one station and speed at different times differ. The
//!   bins are 0.1 s and 0.05 m/s wide; the speeds that the three actions produce lie farther apart, up to rounding.
//!   Half the time bin doubles the states of plan-to-stop and does not affect SafeTLP. An empty road allows a search
//!   without time ([`Method::PlanToStopTimeless`]): it makes plan-to-stop 500 times cheaper, still far from SafeTLP.
//! - *Choice of the plan.* Plan-to-stop searches the whole lattice and returns the plan with the earliest arrival, so
//!   its speeds are the best that comfortable actions reach.
//! - *Actions of the proofs.* Only the proofs of SafeTLP and SafeRTS may use the aggressive deceleration.

mod metrics;

pub use metrics::{Group, Summary};

use std::time::Instant;

use rayon::prelude::*;

use crate::speed::{
    AccelerationLimits, ProblemError, ProofOrder, Resolution, SpeedOutcome, SpeedPlan, SpeedProblem, Strategy, prove,
    search, smoothing,
};

/// Table 1 of the paper: (comfortable acceleration and deceleration, aggressive deceleration), m/s².
pub const LIMIT_SETS: [(f64, f64); 4] = [(0.8, 1.6), (1.0, 1.8), (1.2, 2.0), (1.5, 2.2)];
/// Number of start speeds per 1 m/s.
const SPEEDS_PER_MPS: f64 = 5.0;
/// Number of start speeds: 0…5 m/s.
const SPEEDS: u32 = 26;
/// Speed limit of the road, m/s.
const TOP_SPEED: f64 = 15.0;
/// Code of an instance that was not searched because the time limit was over.
pub const TIME_LIMIT: &str = "time_limit";
/// Expansion budget of SafeRTS: that of a planning cycle.
const REAL_TIME_EXPANSIONS: usize = 2_000;

/// Settings of the comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Length of the road, m.
    pub length: f64,
    /// Length of a step, m.
    pub step: f64,
    /// Width of a time bin, s.
    pub time_bin: f64,
    /// Uses every n-th start speed; 1 for the paper's experiment.
    pub every: u32,
    /// Memory limit of a search, bytes.
    pub memory: usize,
    /// Expansion limit of a search.
    pub expansions: usize,
    /// No search of plan-to-stop begins later than this after the start of the comparison, s. The report counts the
    /// omitted searches. Apart from times, only this setting depends on the clock.
    pub time_limit: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            length: 100.0,
            step: 0.5,
            time_bin: 0.1,
            every: 1,
            memory: 64 << 20,
            expansions: 100_000_000,
            time_limit: 1800.0,
        }
    }
}

/// A search method with its discretisation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Best-first search to the end at any speed, without a stop.
    Naive,
    /// Exhaustive breadth-first search, with time.
    PlanToStop,
    /// Exhaustive breadth-first search, without time: it does not matter on an empty road.
    PlanToStopTimeless,
    /// SafeTLP with the paper's order of proofs, with time.
    SafeTlp,
    /// SafeTLP as in the planner: proofs by stopping distance, time only with moving obstacles.
    SafeTlpPlanner,
    /// SafeRTS with the expansion budget of a planning cycle.
    SafeRts,
}

impl Method {
    /// All methods, in the order of the table.
    pub const ALL: [Self; 6] =
        [Self::Naive, Self::PlanToStop, Self::PlanToStopTimeless, Self::SafeTlp, Self::SafeTlpPlanner, Self::SafeRts];

    /// Stable name, for files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Naive => "naive",
            Self::PlanToStop => "plan_to_stop",
            Self::PlanToStopTimeless => "plan_to_stop_timeless",
            Self::SafeTlp => "safetlp",
            Self::SafeTlpPlanner => "safetlp_planner",
            Self::SafeRts => "safe_rts",
        }
    }

    /// Label in tables and pictures.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Naive => "naive (no stop)",
            Self::PlanToStop => "plan-to-stop",
            Self::PlanToStopTimeless => "plan-to-stop, no time",
            Self::SafeTlp => "SafeTLP",
            Self::SafeTlpPlanner => "SafeTLP, planner order",
            Self::SafeRts => "SafeRTS, 2,000 expansions",
        }
    }

    fn strategy(self) -> Strategy {
        match self {
            Self::Naive => Strategy::Naive,
            Self::PlanToStop | Self::PlanToStopTimeless => Strategy::PlanToStop,
            Self::SafeTlp | Self::SafeTlpPlanner => Strategy::SafeTlp,
            Self::SafeRts => Strategy::SafeRts,
        }
    }

    fn resolution(self, settings: &Settings) -> Resolution {
        let expansions = if self == Self::SafeRts { REAL_TIME_EXPANSIONS } else { settings.expansions };
        Resolution {
            time: settings.time_bin,
            expansions,
            exploration: expansions,
            memory: settings.memory,
            always_timed: !matches!(self, Self::PlanToStopTimeless | Self::SafeTlpPlanner),
            proof_order: match self {
                Self::SafeTlpPlanner => ProofOrder::StoppingDistance,
                _ => ProofOrder::NearestGoal,
            },
            ..Resolution::default()
        }
    }
}

/// A start speed with a set of limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instance {
    /// Index in [`LIMIT_SETS`].
    pub set: usize,
    /// Start speed, m/s.
    pub start_speed: f64,
}

/// Result of a method on an instance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Number of expanded states.
    pub expansions: usize,
    /// Number of states in closed lists.
    pub closed: usize,
    /// Number of attempted stopping proofs.
    pub proofs_tried: usize,
    /// Number of the successful attempt, from 1.
    pub proof_succeeded: Option<usize>,
    /// Peak memory, bytes.
    pub bytes: usize,
    /// Metrics of the plan, if there is one.
    pub plan: Option<PlanMetrics>,
    /// Code of the outcome: [`SpeedOutcome::code`] or [`TIME_LIMIT`].
    pub ended: &'static str,
    /// Wall-clock time, s.
    pub time: f64,
}

/// Metrics of a plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanMetrics {
    /// Distance over time, m/s.
    pub average_speed: f64,
    /// Highest speed, m/s.
    pub top_speed: f64,
    /// Final speed, m/s.
    pub end_speed: f64,
    /// Whether the plan passes [`prove()`]: it ends in a safe state and keeps all limits.
    pub proved_again: bool,
}

/// Result of the comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// The settings, with the actual length of a step.
    pub settings: Settings,
    /// The instances, ordered by limit set.
    pub instances: Vec<Instance>,
    /// Measurements by method (in the order of [`Method::ALL`]) and instance.
    pub measurements: Vec<Vec<Measurement>>,
}

/// The paper's instances.
fn instances(every: u32) -> Vec<Instance> {
    let speeds = || (0..SPEEDS).step_by(every.max(1) as usize).map(|i| f64::from(i) / SPEEDS_PER_MPS);
    (0..LIMIT_SETS.len()).flat_map(|set| speeds().map(move |start_speed| Instance { set, start_speed })).collect()
}

impl Instance {
    /// The road, on which stopping is allowed at the end only.
    fn problem(&self, settings: &Settings) -> Result<SpeedProblem, ProblemError> {
        let (comfortable, aggressive) = LIMIT_SETS[self.set];
        let limits = AccelerationLimits {
            acceleration: comfortable,
            deceleration: comfortable,
            aggressive_deceleration: aggressive,
        };
        let mut problem =
            SpeedProblem::empty_road(settings.length, settings.step, TOP_SPEED, self.start_speed, limits)?;
        problem.stopping_allowed.fill(false);
        if let Some(end) = problem.stopping_allowed.last_mut() {
            *end = true;
        }
        Ok(problem)
    }
}

/// Searches every instance with every method. Calls `progress` after each search.
///
/// Searches of plan-to-stop take seconds and run in parallel. The others take microseconds, run one after the other,
/// and report the shortest of three times.
///
/// # Errors
/// [`ProblemError`] for an invalid road or invalid bins.
pub fn compare(settings: &Settings, progress: impl Fn() + Sync) -> Result<Comparison, ProblemError> {
    let instances = instances(settings.every);
    let problems: Vec<SpeedProblem> = instances.iter().map(|i| i.problem(settings)).collect::<Result<_, _>>()?;
    for method in Method::ALL {
        method.resolution(settings).validate()?;
    }
    let start = Instant::now();
    let is_late = || start.elapsed().as_secs_f64() >= settings.time_limit;
    let measure = |method: Method, problem: &SpeedProblem, runs: u32| {
        let measurement = (0..runs).map(|_| measure_once(method, problem, settings)).reduce(|a, b| {
            let shortest = a.time.min(b.time);
            Measurement { time: shortest, ..a }
        });
        progress();
        measurement
    };
    let all = |method: Method| -> Vec<Measurement> {
        match method {
            Method::PlanToStop | Method::PlanToStopTimeless => {
                let measure = |p| if is_late() { Some(Measurement::empty(TIME_LIMIT)) } else { measure(method, p, 1) };
                problems.par_iter().filter_map(measure).collect()
            }
            _ => problems.iter().filter_map(|p| measure(method, p, 3)).collect(),
        }
    };
    let step = problems.first().map_or(settings.step, |p| p.end() / p.cells() as f64);
    Ok(Comparison { settings: Settings { step, ..*settings }, measurements: Method::ALL.map(all).to_vec(), instances })
}

/// Number of searches that [`compare`] makes.
#[must_use]
pub fn searches(settings: &Settings) -> usize {
    Method::ALL.len() * instances(settings.every).len()
}

fn measure_once(method: Method, problem: &SpeedProblem, settings: &Settings) -> Measurement {
    let resolution = method.resolution(settings);
    let start = Instant::now();
    let outcome = search(problem, method.strategy(), &resolution);
    let time = start.elapsed().as_secs_f64();
    // `compare` has validated problem and resolution
    let Ok(outcome) = outcome else { return Measurement::empty("invalid") };
    let statistics = *outcome.statistics();
    let ended = outcome.code();
    let plan = match outcome {
        SpeedOutcome::Proven { plan, .. } | SpeedOutcome::Unproven { plan, .. } => plan_metrics(&plan, problem),
        SpeedOutcome::NoPlan { .. } => None,
    };
    Measurement {
        expansions: statistics.expansions,
        closed: statistics.closed,
        proofs_tried: statistics.proofs_tried,
        proof_succeeded: statistics.proof_succeeded,
        bytes: statistics.bytes,
        plan,
        ended,
        time,
    }
}

impl Measurement {
    /// A measurement without a search.
    fn empty(ended: &'static str) -> Self {
        Self {
            expansions: 0,
            closed: 0,
            proofs_tried: 0,
            proof_succeeded: None,
            bytes: 0,
            plan: None,
            ended,
            time: 0.0,
        }
    }
}

fn plan_metrics(plan: &SpeedPlan, problem: &SpeedProblem) -> Option<PlanMetrics> {
    let (first, last) = (plan.states.first()?, plan.states.last()?);
    let distance = problem.stations[last.node] - problem.stations[first.node];
    let proved_again = smoothing::raw_profile(problem, plan).is_some_and(|p| prove(problem, &p).is_ok());
    Some(PlanMetrics {
        average_speed: distance / (last.time - first.time),
        top_speed: plan.states.iter().map(|s| s.speed).fold(0.0, f64::max),
        end_speed: last.speed,
        proved_again,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict::Status;

    /// A road on which plan-to-stop takes milliseconds.
    const SMALL: Settings = Settings {
        length: 20.0,
        step: 0.5,
        time_bin: 0.1,
        every: 13,
        memory: 64 << 20,
        expansions: 1_000_000,
        time_limit: 600.0,
    };

    #[test]
    fn the_papers_experiment_has_104_instances() {
        let all = instances(1);
        assert_eq!(all.len(), 104);
        assert!((all[25].start_speed - 5.0).abs() < 1e-12 && all[26] == Instance { set: 1, start_speed: 0.0 });
        assert_eq!(searches(&Settings::default()), 624);
    }

    #[test]
    fn repeated_comparisons_differ_only_in_time() {
        let timeless = || {
            let mut comparison = compare(&SMALL, || ()).unwrap();
            comparison.measurements.iter_mut().flatten().for_each(|m| m.time = 0.0);
            comparison
        };
        assert_eq!(timeless(), timeless());
    }

    #[test]
    fn every_plan_passes_the_proof_except_the_naive_one() {
        let comparison = compare(&SMALL, || ()).unwrap();
        for (method, measured) in Method::ALL.iter().zip(&comparison.measurements) {
            assert_eq!(measured.len(), 8);
            for m in measured {
                let plan = m.plan.unwrap_or_else(|| panic!("{method:?} {m:?}"));
                assert_eq!(plan.proved_again, *method != Method::Naive, "{method:?} {plan:?}");
                assert_eq!(plan.end_speed == 0.0, *method != Method::Naive);
            }
        }
    }

    #[test]
    fn checks_pass_and_report_each_violation() {
        let comparison = compare(&SMALL, || ()).unwrap();
        let failed =
            |c: &Comparison| c.checks().iter().filter(|c| c.status != Status::Pass).map(|c| c.name).collect::<Vec<_>>();
        assert_eq!(failed(&comparison), [""; 0]);
        let tlp = Method::ALL.iter().position(|m| *m == Method::SafeTlp).unwrap();
        let break_with = |change: &dyn Fn(&mut Measurement)| {
            let mut broken = comparison.clone();
            change(&mut broken.measurements[tlp][0]);
            failed(&broken)
        };
        let mut quick = comparison.clone();
        quick.measurements[1].iter_mut().for_each(|m| m.expansions = 50_000);
        assert_eq!(failed(&quick), ["expansion_ratio"]);
        assert!(break_with(&|m| m.plan = None).contains(&"all_proven"));
        assert!(break_with(&|m| m.bytes = 65 << 20).contains(&"memory"));
        assert!(break_with(&|m| m.plan.as_mut().unwrap().average_speed = 0.1).contains(&"average_speed"));
        assert!(break_with(&|m| m.plan.as_mut().unwrap().proved_again = false).contains(&"all_proven"));
    }

    #[test]
    fn reports_an_exhausted_budget() {
        for tight in [Settings { memory: 10_000, ..SMALL }, Settings { expansions: 50, ..SMALL }] {
            let comparison = compare(&tight, || ()).unwrap();
            let exhaustive = &comparison.measurements[1];
            assert!(exhaustive.iter().any(|m| m.plan.is_none() && m.ended.ends_with("budget")), "{exhaustive:?}");
        }
    }

    #[test]
    fn checks_without_the_searches_that_the_time_limit_omits_do_not_apply() {
        let comparison = compare(&Settings { time_limit: 0.0, ..SMALL }, || ()).unwrap();
        for (method, measured) in Method::ALL.iter().zip(&comparison.measurements) {
            let is_exhaustive = method.strategy() == Strategy::PlanToStop;
            assert!(measured.iter().all(|m| (m.ended == TIME_LIMIT) == is_exhaustive), "{method:?} {measured:?}");
        }
        let statuses = comparison.checks().into_iter().map(|c| (c.name, c.status)).collect::<Vec<_>>();
        assert_eq!(
            statuses,
            [
                ("all_proven", Status::Pass),
                ("expansion_ratio", Status::NotApplicable),
                ("average_speed", Status::NotApplicable),
                ("memory", Status::Pass),
            ]
        );
        let summary = comparison.group(Method::PlanToStop, None).summary();
        assert!(summary.expansions.is_nan() && summary.time.is_nan(), "metrics without a search: {summary:?}");
    }

    #[test]
    fn reports_the_actual_length_of_a_step() {
        let step = compare(&Settings { step: 0.3, every: 25, ..SMALL }, || ()).unwrap().settings.step;
        assert!((step - 20.0 / 67.0).abs() < 1e-12, "{step}");
    }

    #[test]
    fn rejects_invalid_roads_and_bins() {
        for wrong in [
            Settings { step: 0.0, ..SMALL },
            Settings { step: 21.0, ..SMALL },
            Settings { length: -1.0, ..SMALL },
            Settings { length: f64::NAN, ..SMALL },
            Settings { time_bin: 0.0, ..SMALL },
            Settings { time_bin: f64::NAN, ..SMALL },
        ] {
            assert!(compare(&wrong, || ()).is_err(), "{wrong:?}");
        }
    }
}
