//! Tests of the search strategies: the theorems of the paper, and a comparison of each strategy with plain enumeration.

use super::lattice::STANDSTILL_SPEED;
use super::test_support::empty_road;
use super::{Strategy, *};
use proptest::prelude::*;
use proptest::strategy::Strategy as Generator;

/// A resolution at which only equal states are duplicates.
fn exact() -> Resolution {
    Resolution { speed: 1e-6, time: 1e-6, wait: 0.5, expansions: 200_000, ..Resolution::default() }
}

fn plan(problem: &SpeedProblem, strategy: Strategy, resolution: &Resolution) -> Option<SpeedPlan> {
    search(problem, strategy, resolution).unwrap().proven()
}

fn safe_tlp(problem: &SpeedProblem) -> SpeedOutcome {
    search(problem, Strategy::SafeTlp, &Resolution::default()).unwrap()
}

fn proven(problem: &SpeedProblem) -> SpeedPlan {
    safe_tlp(problem).proven().unwrap_or_else(|| panic!("no plan for {problem:?}"))
}

/// The strategies with stopping proofs.
const PROVING: [Strategy; 3] = [Strategy::PlanToStop, Strategy::SafeTlp, Strategy::SafeRts];

#[test]
fn plans_to_the_end_of_the_papers_road_with_few_expansions() {
    for tenth in (0..=50).step_by(2) {
        let problem = empty_road(100.0, f64::from(tenth) / 10.0);
        let outcome = safe_tlp(&problem);
        let expansions = outcome.statistics().expansions;
        assert!(expansions < 1000, "{expansions} expansions");
        let plan = outcome.proven().unwrap();
        let last = plan.states.last().unwrap();
        assert_eq!(last.speed, 0.0);
        assert!(problem.stations[last.node] > 99.0, "stops short at {}", problem.stations[last.node]);
        let profile = smoothing::raw_profile(&problem, &plan).unwrap();
        assert_eq!(prove(&problem, &profile), Ok(()));
    }
}

#[test]
fn clipped_deceleration_stops_a_slow_start_in_one_cell() {
    // v² = 0.09 is far below 2dΔs = 1.5: without the clip no node has zero speed
    let problem = empty_road(1.0, 0.3);
    assert_eq!(proven(&problem).states.last().unwrap().speed, 0.0);
}

#[test]
fn start_too_fast_to_stop_is_an_outcome() {
    // 10 m/s needs 22.7 m at 2.2 m/s²
    let short = empty_road(22.5, 10.0);
    for strategy in PROVING {
        let outcome = search(&short, strategy, &Resolution::default()).unwrap();
        let SpeedOutcome::NoPlan { why: NoPlan::CannotStop { needed }, .. } = outcome else {
            panic!("{strategy:?}: {outcome:?}")
        };
        assert!((needed - 100.0 / 4.4).abs() < 1e-9, "{needed}");
    }
    assert!(safe_tlp(&empty_road(23.0, 10.0)).proven().is_some());
}

#[test]
fn start_above_the_speed_limit_brakes_to_it() {
    let mut problem = empty_road(100.0, 18.0);
    problem.speed_limits = vec![10.0; problem.speed_limits.len()];
    let plan = proven(&problem);
    let reached = plan.states.iter().position(|s| s.speed <= 10.0).unwrap();
    assert!(plan.states[reached..].iter().all(|s| s.speed <= 10.0));
    assert!(plan.states[..=reached].windows(2).all(|w| w[1].speed < w[0].speed));
}

#[test]
fn exhausted_budget_is_named() {
    let problem = empty_road(100.0, 3.0);
    let few = Resolution { expansions: 100, ..Resolution::default() };
    let small = Resolution { memory: 4096, ..Resolution::default() };
    for (resolution, budget) in [(few, Budget::Expansions), (small, Budget::Memory)] {
        let timed = Resolution { always_timed: true, ..resolution };
        let outcome = search(&problem, Strategy::PlanToStop, &timed).unwrap();
        // the search may have found a safe state before
        match outcome {
            SpeedOutcome::NoPlan { why, .. } => assert_eq!(why, NoPlan::BudgetExhausted(budget)),
            SpeedOutcome::Proven { ref plan, .. } => assert!(plan.states.last().unwrap().node < 100),
            SpeedOutcome::Unproven { .. } => panic!("{outcome:?}"),
        }
        assert!(outcome.statistics().expansions <= 100 || outcome.statistics().bytes <= 4096);
    }
}

#[test]
fn a_road_too_short_to_stop_on_needs_no_search() {
    for strategy in [Strategy::PlanToStop, Strategy::SafeTlp, Strategy::SafeRts] {
        let outcome = search(&empty_road(22.0, 10.0), strategy, &Resolution::default()).unwrap();
        assert_eq!((outcome.code(), outcome.statistics().expansions), ("cannot_stop", 0));
    }
    let naive = search(&empty_road(22.0, 10.0), Strategy::Naive, &Resolution::default()).unwrap();
    assert_eq!(naive.code(), "unproven", "it asks for no stop");
}

/// With few expansions, the exploration ends early on the road. A proof from there is a proof, and a complete search that finds none has
/// found that there is none.
#[test]
fn an_exploration_that_ends_early_is_no_exhausted_search() {
    let short = Resolution { exploration: 5, ..Resolution::default() };
    let free = empty_road(100.0, 3.0);
    let (near, far) = [short, Resolution::default()]
        .map(|resolution| search(&free, Strategy::SafeTlp, &resolution).unwrap().proven().unwrap())
        .into();
    assert!(near.proof_starts <= 6 && far.proof_starts > 60, "{} {}", near.proof_starts, far.proof_starts);
    // it may stand at the end only; the gaps in the last cell but one are too short for a vehicle that stops behind it
    let mut hopeless = empty_road(6.0, 3.0);
    hopeless.horizon = 8.0;
    let last = hopeless.cells();
    hopeless.stopping_allowed[..last].fill(false);
    hopeless.blocked[last - 2] = (0..200).map(|i| (f64::from(i), f64::from(i) + 0.8)).collect();
    let [early, whole] =
        [short, Resolution::default()].map(|resolution| search(&hopeless, Strategy::SafeTlp, &resolution).unwrap());
    assert_eq!((early.code(), whole.code()), ("no_safe_state", "no_safe_state"));
    let expansions = [early, whole].map(|outcome| outcome.statistics().expansions);
    assert!(expansions[0] > 100 && expansions[0] <= expansions[1], "{expansions:?}");
}

#[test]
fn safe_rts_keeps_its_budget_and_gets_farther_with_a_larger_one() {
    let problem = empty_road(100.0, 3.0);
    let mut before = 0;
    for expansions in [20, 40, 80, 160, 320, 640, 1280] {
        let resolution = Resolution { expansions, ..Resolution::default() };
        let outcome = search(&problem, Strategy::SafeRts, &resolution).unwrap();
        assert!(outcome.statistics().expansions <= expansions);
        let reached = outcome.proven().map_or(0, |p| p.states[p.proof_starts].node);
        assert!(reached >= before, "node {reached} with {expansions} expansions, {before} with fewer");
        before = reached;
    }
    let whole = proven(&problem);
    assert_eq!(before, whole.states[whole.proof_starts].node, "not as far as the unlimited search");
}

#[test]
fn repeated_searches_have_equal_results() {
    let problems = [empty_road(100.0, 3.0), empty_road(40.0, 7.0)];
    for strategy in Strategy::ALL {
        let first = search(&problems[0], strategy, &Resolution::default());
        let _ = search(&problems[1], strategy, &Resolution::default());
        assert_eq!(first, search(&problems[0], strategy, &Resolution::default()));
    }
}

#[test]
fn enters_a_crossing_after_it_is_free() {
    let mut problem = empty_road(40.0, 5.0);
    for cell in 30..36 {
        problem.blocked[cell] = vec![(0.0, 8.0)];
    }
    let plan = proven(&problem);
    let last = plan.states.last().unwrap();
    assert!(problem.stations[last.node] > 39.0, "never crossed: {last:?}");
    let enters = plan.states.iter().find(|s| s.node == 31).unwrap();
    assert!(enters.time > 8.0, "entered at {}", enters.time);
}

#[test]
fn plan_truncated_at_a_long_wait_is_proven() {
    let mut problem = empty_road(40.0, 5.0);
    for cell in 30..36 {
        problem.blocked[cell] = vec![(0.0, 20.0)];
    }
    let mut cut = proven(&problem);
    let whole = cut.states.len();
    cut.end_at_long_wait(&problem, 2.0);
    assert!(cut.states.len() < whole, "no long wait in {:?}", cut.states);
    assert_eq!(cut.states.last().unwrap().speed, 0.0);
    assert_eq!(prove(&problem, &smoothing::raw_profile(&problem, &cut).unwrap()), Ok(()));
}

#[test]
fn does_not_stop_inside_a_junction() {
    let mut problem = empty_road(30.0, 5.0);
    for node in 20..=60 {
        problem.stopping_allowed[node] = false;
    }
    let plan = proven(&problem);
    assert!(plan.states.last().unwrap().node < 20);
}

#[test]
fn does_not_stop_ahead_of_a_following_vehicle() {
    // a vehicle at 6 m/s follows 1 s behind and does not brake: only driving ahead of it is safe
    let mut problem = empty_road(60.0, 6.0);
    problem.horizon = 8.0;
    for cell in 0..problem.cells() {
        let t = problem.stations[cell] / 6.0 + 1.0;
        problem.blocked[cell] = vec![(t, t + 0.6)];
    }
    let plan = proven(&problem);
    let last = plan.states.last().unwrap();
    assert!(last.time + 1e-9 >= 8.0 || problem.stations[last.node] > 42.0, "stops in its path at {last:?}");
}

/// Whether a safe state is reachable with the given decelerations, by depth-first enumeration without a closed list.
fn safe_state_exists(problem: &SpeedProblem, s: SpeedState, decelerations: &[f64]) -> bool {
    if s.speed <= STANDSTILL_SPEED {
        if problem.is_safe_standstill(s.node, s.time) {
            return true;
        }
        let later = SpeedState { time: s.time + exact().wait, ..s };
        if problem.time_matters()
            && later.time <= problem.horizon
            && !problem.is_standstill_blocked(s.node, s.time, later.time)
            && safe_state_exists(problem, later, decelerations)
        {
            return true;
        }
    }
    if s.node >= problem.cells() {
        return false;
    }
    let ds = problem.stations[s.node + 1] - problem.stations[s.node];
    [problem.limits.acceleration, 0.0].into_iter().chain(decelerations.iter().map(|d| -d)).any(|a| {
        let v = (s.speed * s.speed + 2.0 * a * ds).max(0.0).sqrt().min(problem.speed_limits[s.node + 1]);
        if s.speed + v <= STANDSTILL_SPEED {
            return false;
        }
        let time = s.time + 2.0 * ds / (s.speed + v);
        !problem.is_blocked(s.node, s.time, time)
            && safe_state_exists(problem, SpeedState { node: s.node + 1, speed: v, time }, decelerations)
    })
}

fn small_problem() -> impl Generator<Value = SpeedProblem> {
    let block = (0..6usize, 0.0..6.0f64, 0.1..3.0f64);
    (0.0..4.0f64, prop::collection::vec(block, 0..4), prop::collection::vec(any::<bool>(), 7)).prop_map(
        |(speed, blocks, stopping_allowed)| {
            let mut p = empty_road(3.0, speed);
            p.horizon = 8.0;
            p.stopping_allowed = stopping_allowed;
            for (cell, from, length) in blocks {
                if p.blocked[cell].is_empty() {
                    p.blocked[cell] = vec![(from, from + length)];
                }
            }
            p
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Theorem 1 and its converse, for all actions and for the comfortable ones only.
    #[test]
    fn finds_a_safe_plan_exactly_if_one_exists(problem in small_problem()) {
        let root = SpeedState { node: 0, speed: problem.start_speed, time: 0.0 };
        let AccelerationLimits { deceleration, aggressive_deceleration, .. } = problem.limits;
        let any = safe_state_exists(&problem, root, &[deceleration, aggressive_deceleration]);
        prop_assert_eq!(plan(&problem, Strategy::SafeTlp, &exact()).is_some(), any);
        prop_assert_eq!(plan(&problem, Strategy::SafeRts, &exact()).is_some(), any);
        let gentle = safe_state_exists(&problem, root, &[deceleration]);
        prop_assert_eq!(plan(&problem, Strategy::PlanToStop, &exact()).is_some(), gentle);
    }

    /// Theorem 2.
    #[test]
    fn expands_at_most_twice_the_reachable_states(problem in small_problem()) {
        let states = reachable(&problem);
        let outcome = search(&problem, Strategy::SafeTlp, &exact()).unwrap();
        let expansions = outcome.statistics().expansions;
        prop_assert!(expansions <= 2 * states, "{} of {}", expansions, states);
    }

    /// The proof, which shares no code with the searches, accepts every plan.
    #[test]
    fn every_plan_passes_the_proof(problem in small_problem()) {
        for strategy in PROVING {
            if let Some(found) = plan(&problem, strategy, &exact()) {
                let profile = smoothing::raw_profile(&problem, &found).unwrap();
                prop_assert_eq!(prove(&problem, &profile), Ok(()), "{:?}", strategy);
            }
        }
    }

    /// Plan-to-stop reaches the farthest safe state of those that comfortable actions reach, then the earliest.
    #[test]
    fn plan_to_stop_is_optimal(problem in small_problem()) {
        let mut best: Option<(usize, f64)> = None;
        let mut todo = vec![SpeedState { node: 0, speed: problem.start_speed, time: 0.0 }];
        let actions = lattice::Actions {
            problem: &problem,
            wait: problem.time_matters().then_some(exact().wait),
            braking: problem.limits.deceleration,
        };
        while let Some(s) = todo.pop() {
            if s.speed <= STANDSTILL_SPEED && problem.is_safe_standstill(s.node, s.time) {
                let better = best.is_none_or(|(node, time)| s.node > node || s.node == node && s.time < time);
                best = if better { Some((s.node, s.time)) } else { best };
            }
            actions.successors(&s, |to| todo.push(to));
        }
        let found = plan(&problem, Strategy::PlanToStop, &exact());
        let found = found.map(|p| p.states.last().map(|s| (s.node, s.time)).unwrap());
        match (found, best) {
            (Some(f), Some(b)) => prop_assert!(f.0 == b.0 && (f.1 - b.1).abs() < 1e-5, "{:?} {:?}", f, b),
            (f, b) => prop_assert_eq!(f, b),
        }
    }
}

/// Number of distinct states reachable with all actions.
fn reachable(problem: &SpeedProblem) -> usize {
    let actions = lattice::Actions {
        problem,
        wait: problem.time_matters().then_some(exact().wait),
        braking: problem.limits.aggressive_deceleration,
    };
    let mut seen = std::collections::BTreeSet::new();
    let mut todo = vec![SpeedState { node: 0, speed: problem.start_speed, time: 0.0 }];
    while let Some(s) = todo.pop() {
        let micro = |x: f64| (x * 1e6).round() as i64;
        let time = if problem.time_matters() { micro(s.time) } else { 0 };
        if seen.insert((s.node, micro(s.speed), time)) {
            actions.successors(&s, |to| todo.push(to));
        }
    }
    seen.len()
}
