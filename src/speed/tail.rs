//! Creeping tails: plans that crawl towards their rest.
//!
//! A stopping proof only has to end at rest, and the order in which the paper expands it (nearest to the goal, then
//! slowest) likes to come to rest as far ahead as it can, as slowly as it can: a plan that crawls its last 40 m at
//! 0.5 m/s is proven and useless. The order by stopping distance does not, but what a proof ends with is nobody's choice
//! in either.
//!
//! A plan *creeps* for the time that it moves at less than [`CRAWL`] before its final rest, beyond what a comfortable stop
//! from that speed takes, and it is told as creeping above [`MAX_CREEPING_TIME`]. Before smoothing, at a second less, the tail is laid anew: to the same rest as fast as speed_limits and
//! comfort allow, or, if something is in the way, to rest at once. What is laid anew is proved anew; the creeping tail
//! stands if that fails, as it does behind a queue that creeps itself.

use super::lattice::REST;
use super::{SpeedPlan, SpeedProblem, SpeedState, prove, smoothing};
use crate::trajectory::SpeedProfile;

/// Slower than this before its rest a plan crawls, m/s.
pub const CRAWL: f64 = 1.0;
/// Crawling for so long is not worth a word, s: a jerk limit and a soft landing make a comfortable stop longer by as much.
pub const MAX_CREEPING_TIME: f64 = 3.0;
/// Of that, what smoothing adds, s: a searched tail may crawl for the rest.
const SOFT_LANDING: f64 = 1.0;

/// Time for which a profile crawls to its final rest beyond what a stop with `deceleration` (m/s²) takes, s.
#[must_use]
pub fn creeping_time(profile: &SpeedProfile, deceleration: f64) -> f64 {
    let knots = profile.knots();
    let last_fast = knots.iter().rposition(|k| k.speed >= CRAWL).unwrap_or(0);
    let tail = knots[last_fast..].windows(2);
    let moving = tail.filter(|pair| pair[1].station - pair[0].station > REST).map(|pair| pair[1].time - pair[0].time);
    (moving.sum::<f64>() - CRAWL / deceleration).max(0.0)
}

/// The plan with another tail that does not creep, proved for the same problem; `None` if it does not creep, or no other
/// tail can be proved.
#[must_use]
pub fn without_creeping(problem: &SpeedProblem, plan: &SpeedPlan) -> Option<SpeedPlan> {
    let creeps = |plan: &SpeedPlan| {
        let profile = smoothing::raw_profile(problem, plan)?;
        Some((creeping_time(&profile, problem.limits.deceleration) > MAX_CREEPING_TIME - SOFT_LANDING, profile))
    };
    if !creeps(plan)?.0 {
        return None;
    }
    let last_fast = plan.states.iter().rposition(|s| s.speed >= CRAWL).unwrap_or(0);
    let rest = plan.states.last()?.node;
    let others = [on_to(problem, plan, last_fast, rest), at_rest_soon(problem, plan, last_fast)];
    others
        .into_iter()
        .flatten()
        .find(|other| creeps(other).is_some_and(|(creeps, profile)| !creeps && prove(problem, &profile).is_ok()))
}

/// As fast as speed_limits and comfort allow from one of the plan's states to rest at a node.
fn on_to(problem: &SpeedProblem, plan: &SpeedPlan, from: usize, rest: usize) -> Option<SpeedPlan> {
    let stations = &problem.stations;
    let limits = &problem.limits;
    let slowing = |node: usize| (2.0 * limits.deceleration * (stations[rest] - stations[node])).max(0.0).sqrt();
    extended(problem, plan, from, |state, ds| {
        let faster = (state.speed * state.speed + 2.0 * limits.acceleration * ds).sqrt();
        faster.min(problem.speed_limits[state.node + 1]).min(slowing(state.node + 1))
    })
}

/// Braking comfortably from one of the plan's states on.
fn at_rest_soon(problem: &SpeedProblem, plan: &SpeedPlan, from: usize) -> Option<SpeedPlan> {
    let deceleration = problem.limits.deceleration;
    extended(problem, plan, from, |state, ds| (state.speed * state.speed - 2.0 * deceleration * ds).max(0.0).sqrt())
}

/// The plan up to the state `from`, then node by node with the speeds that `next` gives, up to where that is rest.
fn extended(
    problem: &SpeedProblem,
    plan: &SpeedPlan,
    from: usize,
    next: impl Fn(&SpeedState, f64) -> f64,
) -> Option<SpeedPlan> {
    let mut states = plan.states.get(..=from)?.to_vec();
    let mut state = *states.last()?;
    while state.node < problem.cells() {
        let ds = problem.stations[state.node + 1] - problem.stations[state.node];
        let speed = next(&state, ds);
        let speed = if speed <= REST { 0.0 } else { speed };
        if state.speed + speed <= REST {
            return None;
        }
        state = SpeedState { node: state.node + 1, speed, time: state.time + 2.0 * ds / (state.speed + speed) };
        states.push(state);
        if speed <= 0.0 {
            return Some(SpeedPlan { states, proof_starts: plan.proof_starts.min(from) });
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::super::{AccelerationLimits, ProofOrder, Resolution, Strategy, search};
    use super::*;
    use crate::bench::safetlp::LIMIT_SETS;

    fn profile(problem: &SpeedProblem, plan: &SpeedPlan) -> SpeedProfile {
        smoothing::raw_profile(problem, plan).unwrap()
    }

    fn creeps(problem: &SpeedProblem, plan: &SpeedPlan) -> bool {
        creeping_time(&profile(problem, plan), problem.limits.deceleration) > MAX_CREEPING_TIME - SOFT_LANDING
    }

    /// The 104 instances of the paper.
    fn instances() -> impl Iterator<Item = SpeedProblem> {
        LIMIT_SETS.into_iter().flat_map(|(comfortable, aggressive_deceleration)| {
            let (acceleration, deceleration) = (comfortable, comfortable);
            let limits = AccelerationLimits { acceleration, deceleration, aggressive_deceleration };
            (0..26).map(move |i| SpeedProblem { limits, ..empty_road(100.0, 0.2 * f64::from(i)) })
        })
    }

    #[test]
    fn no_tail_of_the_papers_instances_creeps_whatever_the_order_of_the_proofs() {
        let mut crept = Vec::new();
        for proof_order in [ProofOrder::StoppingDistance, ProofOrder::NearestGoal] {
            let resolution = Resolution { proof_order, ..Resolution::default() };
            let mut count = 0;
            for problem in instances() {
                let plan = search(&problem, Strategy::SafeTlp, &resolution).unwrap().proven().expect("a plan");
                let Some(other) = without_creeping(&problem, &plan) else {
                    assert!(!creeps(&problem, &plan), "creeps on: {plan:?}");
                    continue;
                };
                count += 1;
                assert!(creeps(&problem, &plan) && !creeps(&problem, &other));
                assert_eq!(prove(&problem, &profile(&problem, &other)), Ok(()));
                assert_eq!(other.states.last().unwrap().node, plan.states.last().unwrap().node, "gets as far");
                assert_eq!(other.states[..=other.proof_starts], plan.states[..=other.proof_starts]);
            }
            crept.push(count);
        }
        println!("{} tails crept by stopping distance, {} by the paper's order", crept[0], crept[1]);
    }

    /// The whole way at 0.5 m/s.
    fn crawling(problem: &SpeedProblem) -> SpeedPlan {
        let cells = problem.cells();
        let state = |node: usize| SpeedState { node, speed: 0.5, time: node as f64 };
        let mut states: Vec<SpeedState> = (0..cells).map(state).collect();
        states.push(SpeedState { node: cells, speed: 0.0, time: cells as f64 + 1.0 });
        SpeedPlan { states, proof_starts: 0 }
    }

    #[test]
    fn a_crawl_is_told_by_its_time_and_a_comfortable_stop_is_none() {
        let problem = empty_road(20.0, 0.5);
        assert!((creeping_time(&profile(&problem, &crawling(&problem)), 1.5) - (41.0 - 1.0 / 1.5)).abs() < 1e-9);
        let found = search(&problem, Strategy::SafeTlp, &Resolution::default()).unwrap().proven().unwrap();
        assert!(creeping_time(&profile(&problem, &found), 1.5) < MAX_CREEPING_TIME);
    }

    #[test]
    fn behind_something_that_creeps_the_plan_rests_sooner_and_keeps_creeping_where_it_may_not() {
        // cleared half a metre a second
        let mut problem = empty_road(20.0, 0.5);
        for cell in 2..problem.cells() {
            problem.blocked[cell] = vec![(0.0, cell as f64 - 0.9)];
        }
        problem.horizon = 60.0;
        let plan = crawling(&problem);
        assert_eq!(prove(&problem, &profile(&problem, &plan)), Ok(()));
        let other = without_creeping(&problem, &plan).expect("resting at once is free");
        assert!(other.states.last().unwrap().node <= 2);
        problem.stopping_allowed[..30].fill(false);
        assert_eq!(prove(&problem, &profile(&problem, &plan)), Ok(()));
        assert_eq!(without_creeping(&problem, &plan), None, "no other tail can be proved");
    }
}
