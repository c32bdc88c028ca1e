//! `stopline bench safetlp`: the experiment of *Safe Temporal Planning for Urban Driving* (Empirical Evaluation).
//!
//! A straight empty road of 100 m in half-metre steps, at most 15 m/s, a stop at its end; four sets of accelerations (the
//! paper's Table 1) and start speeds from 0 to 5 m/s by 0.2: 104 instances. Every [`Method`] searches each of them; what
//! it found is proved again by [`crate::speed::prove`], which shares no code with the searches.
//!
//! What the paper leaves open, and what is taken here:
//!
//! - *Time discretisation.* States at one station with the same speed but different times are different in a spatiotemporal
//!   lattice. Times are told apart in bins of a tenth of a second, speeds in bins of 0.05 m/s (the speeds that three
//!   actions can produce lie further apart, up to rounding). Halving the bin doubles the states of plan-to-stop; SafeTLP
//!   does not notice. Without time ([`Method::PlanToStopTimeless`]), which an empty road would allow, plan-to-stop is
//!   five hundred times cheaper, and still far behind.
//! - *Which plan plan-to-stop takes.* It searches everything there is; it gets the earliest arrival of all it found, so its
//!   speeds are the best that comfortable actions reach.
//! - *Actions of the proofs.* The aggressive deceleration may be used by SafeTLP's proofs and by nothing else.

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
/// Start speeds lie this many to the m/s,
const SPEEDS_PER_MPS: f64 = 5.0;
/// up to this many of them: 0…5 m/s.
const SPEEDS: u32 = 26;
/// Highest speed, m/s.
const TOP_SPEED: f64 = 15.0;
/// Code of an instance that was left out because time was up.
pub const TIME_LIMIT: &str = "time_limit";
/// Expansions allowed to SafeRTS: what it would get in a planning cycle.
const REAL_TIME_EXPANSIONS: usize = 2_000;

/// What to compare on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Length of the road, m.
    pub length: f64,
    /// Length of a step, m.
    pub step: f64,
    /// Width of a time bin, s.
    pub time_bin: f64,
    /// Every how many start speeds one is taken; 1 for the paper's experiment.
    pub every: u32,
    /// Memory that a search may use, bytes.
    pub memory: usize,
    /// Expansions that a search may make.
    pub expansions: usize,
    /// No search of plan-to-stop begins later than this, s after the first. What is left out is told; it is the one thing
    /// here that the clock decides.
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

/// A way to search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Best first to the end at any speed: no stop.
    Naive,
    /// Exhaustive breadth-first search with time.
    PlanToStop,
    /// The same, told that on an empty road times do not matter.
    PlanToStopTimeless,
    /// SafeTLP with the paper's order of proofs, with time.
    SafeTlp,
    /// SafeTLP as the planner runs it: proofs by stopping distance, times told apart only where something moves.
    SafeTlpPlanner,
    /// Exploring and proving in turns, under the budget of a planning cycle.
    SafeRts,
}

impl Method {
    /// All, in the order of the table.
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

    /// What it is, for people.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Naive => "naive (no stop)",
            Self::PlanToStop => "plan-to-stop",
            Self::PlanToStopTimeless => "plan-to-stop, no time",
            Self::SafeTlp => "SafeTLP",
            Self::SafeTlpPlanner => "SafeTLP, our order",
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

/// A start speed under a set of limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instance {
    /// Index in [`LIMIT_SETS`].
    pub set: usize,
    /// Start speed, m/s.
    pub start_speed: f64,
}

/// What a method made of an instance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// States expanded.
    pub expansions: usize,
    /// States in closed lists.
    pub closed: usize,
    /// Stopping proofs tried.
    pub proofs_tried: usize,
    /// Which of them succeeded.
    pub proof_succeeded: Option<usize>,
    /// Most memory in use, bytes.
    pub bytes: usize,
    /// The plan, if there is one.
    pub plan: Option<PlanMetrics>,
    /// What the search came to, as a stable code.
    pub ended: &'static str,
    /// Wall-clock time, s.
    pub time: f64,
}

/// A plan's figures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanMetrics {
    /// Way over time, m/s.
    pub average_speed: f64,
    /// Highest speed, m/s.
    pub top_speed: f64,
    /// Speed at its end, m/s.
    pub end_speed: f64,
    /// Whether other code than the search proved it again: it ends at rest, within every limit.
    pub proved_again: bool,
}

/// What came out.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// What was compared on, with the length that a step really has.
    pub settings: Settings,
    /// The instances, set by set.
    pub instances: Vec<Instance>,
    /// For each method ([`Method::ALL`]) what it made of each instance.
    pub measurements: Vec<Vec<Measurement>>,
}

/// The paper's instances.
fn instances(every: u32) -> Vec<Instance> {
    let speeds = || (0..SPEEDS).step_by(every.max(1) as usize).map(|i| f64::from(i) / SPEEDS_PER_MPS);
    (0..LIMIT_SETS.len()).flat_map(|set| speeds().map(move |start_speed| Instance { set, start_speed })).collect()
}

impl Instance {
    /// The road, on which rest is allowed at the end only.
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

/// Searches every instance with every method; `done` is told after each search.
///
/// Searches of plan-to-stop take seconds and go side by side on the threads there are; the others take microseconds, go one
/// after the other, and count the shortest of three runs.
///
/// # Errors
/// Settings that make no road or no bins.
pub fn compare(settings: &Settings, done: impl Fn() + Sync) -> Result<Comparison, ProblemError> {
    let instances = instances(settings.every);
    let problems: Vec<SpeedProblem> = instances.iter().map(|i| i.problem(settings)).collect::<Result<_, _>>()?;
    for method in Method::ALL {
        method.resolution(settings).validate()?;
    }
    let begun = Instant::now();
    let is_late = || begun.elapsed().as_secs_f64() >= settings.time_limit;
    let measure = |method: Method, problem: &SpeedProblem, runs: u32| {
        let measured = (0..runs).map(|_| measured(method, problem, settings)).reduce(|a, b| {
            let faster = a.time.min(b.time);
            Measurement { time: faster, ..a }
        });
        done();
        measured
    };
    let all = |method: Method| -> Vec<Measurement> {
        match method {
            Method::PlanToStop | Method::PlanToStopTimeless => {
                let measure =
                    |p| if is_late() { Some(Measurement::nothing(TIME_LIMIT)) } else { measure(method, p, 1) };
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

fn measured(method: Method, problem: &SpeedProblem, settings: &Settings) -> Measurement {
    let resolution = method.resolution(settings);
    let begun = Instant::now();
    let outcome = search(problem, method.strategy(), &resolution);
    let time = begun.elapsed().as_secs_f64();
    // problem and resolution are validated before anything is measured
    let Ok(outcome) = outcome else { return Measurement::nothing("invalid") };
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
    fn nothing(ended: &'static str) -> Self {
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
    let way = problem.stations[last.node] - problem.stations[first.node];
    let proved_again = smoothing::raw_profile(problem, plan).is_some_and(|p| prove(problem, &p).is_ok());
    Some(PlanMetrics {
        average_speed: way / (last.time - first.time),
        top_speed: plan.states.iter().map(|s| s.speed).fold(0.0, f64::max),
        end_speed: last.speed,
        proved_again,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A road on which even plan-to-stop is quick.
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
    fn two_measurements_differ_in_time_alone() {
        let timeless = || {
            let mut comparison = compare(&SMALL, || ()).unwrap();
            comparison.measurements.iter_mut().flatten().for_each(|m| m.time = 0.0);
            comparison
        };
        assert_eq!(timeless(), timeless());
    }

    #[test]
    fn every_safe_plan_is_proved_again_and_the_naive_one_is_not() {
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
    fn all_promises_hold_and_broken_ones_are_told() {
        let comparison = compare(&SMALL, || ()).unwrap();
        let told = |c: &Comparison| c.checks().iter().filter(|c| !c.pass).map(|c| c.name).collect::<Vec<_>>();
        assert_eq!(told(&comparison), [""; 0]);
        let tlp = Method::ALL.iter().position(|m| *m == Method::SafeTlp).unwrap();
        let break_with = |change: &dyn Fn(&mut Measurement)| {
            let mut broken = comparison.clone();
            change(&mut broken.measurements[tlp][0]);
            told(&broken)
        };
        let mut quick = comparison.clone();
        quick.measurements[1].iter_mut().for_each(|m| m.expansions = 50_000);
        assert_eq!(told(&quick), ["expansion_ratio"]);
        assert!(break_with(&|m| m.plan = None).contains(&"all_proven"));
        assert!(break_with(&|m| m.bytes = 65 << 20).contains(&"memory"));
        assert!(break_with(&|m| m.plan.as_mut().unwrap().average_speed = 0.1).contains(&"average_speed"));
        assert!(break_with(&|m| m.plan.as_mut().unwrap().proved_again = false).contains(&"all_proven"));
    }

    #[test]
    fn a_budget_too_small_is_told_and_nothing_fails() {
        for tight in [Settings { memory: 10_000, ..SMALL }, Settings { expansions: 50, ..SMALL }] {
            let comparison = compare(&tight, || ()).unwrap();
            let exhaustive = &comparison.measurements[1];
            assert!(exhaustive.iter().any(|m| m.plan.is_none() && m.ended.ends_with("budget")), "{exhaustive:?}");
        }
    }

    #[test]
    fn when_time_is_up_the_rest_of_plan_to_stop_is_left_out_and_the_promises_are_not_held() {
        let comparison = compare(&Settings { time_limit: 0.0, ..SMALL }, || ()).unwrap();
        for (method, measured) in Method::ALL.iter().zip(&comparison.measurements) {
            let is_exhaustive = method.strategy() == Strategy::PlanToStop;
            assert!(measured.iter().all(|m| (m.ended == TIME_LIMIT) == is_exhaustive), "{method:?} {measured:?}");
        }
        assert!(comparison.checks().iter().any(|c| !c.pass));
        let summary = comparison.group(Method::PlanToStop, None).summary();
        assert!(summary.expansions.is_nan() && summary.time.is_nan(), "nothing was measured: {summary:?}");
    }

    #[test]
    fn a_step_that_does_not_divide_the_road_is_told_as_it_was_made() {
        let step = compare(&Settings { step: 0.3, every: 25, ..SMALL }, || ()).unwrap().settings.step;
        assert!((step - 20.0 / 67.0).abs() < 1e-12, "{step}");
    }

    #[test]
    fn roads_and_bins_that_make_no_sense_are_errors() {
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
