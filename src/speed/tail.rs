//! Replacement of creeping tails: the last part of a plan that moves at a crawl.
//!
//! A stopping proof only has to end at standstill. The paper's expansion order (nearest to the goal, then slowest)
//! prefers a standstill that is far ahead and approached slowly: a plan that crawls its last 40 m at 0.5 m/s is proven
//! and useless. The order by stopping distance ([`super::ProofOrder`]) avoids most such plans, but neither order
//! controls the tail.
//!
//! A plan *creeps* while it moves below [`CREEPING_SPEED`] before its final standstill. Its creeping time is the
//! duration of that part minus the duration of a comfortable stop from that speed. [`without_creeping`] replaces a tail
//! that creeps for too long by the fastest comfortable approach to the same standstill or, if that is blocked, by an
//! immediate comfortable stop. It proves the replacement; if the proof fails, the original tail stays, for example
//! behind a queue that creeps.

use super::lattice::{ROUNDING, STANDSTILL_SPEED};
use super::{SpeedPlan, SpeedProblem, SpeedState, prove, smoothing};
use crate::trajectory::SpeedProfile;

/// A plan creeps below this speed, m/s.
pub const CREEPING_SPEED: f64 = 1.0;
/// Creeping time up to which a smoothed profile does not count as creeping, s: the jerk limit and a gentle end prolong
/// a comfortable stop by as much.
pub const MAX_CREEPING_TIME: f64 = 3.0;
/// The part of [`MAX_CREEPING_TIME`] reserved for smoothing, s. A raw profile may creep for the difference.
const SMOOTHING_TIME: f64 = 1.0;

/// Time for which a profile creeps before its final standstill, beyond a stop with `deceleration` (m/s²), s.
#[must_use]
pub fn creeping_time(profile: &SpeedProfile, deceleration: f64) -> f64 {
    let knots = profile.knots();
    let last_fast = knots.iter().rposition(|k| k.speed >= CREEPING_SPEED).unwrap_or(0);
    let tail = knots[last_fast..].windows(2);
    let moving = tail.filter(|pair| pair[1].station - pair[0].station > ROUNDING);
    let duration: f64 = moving.map(|pair| pair[1].time - pair[0].time).sum();
    (duration - CREEPING_SPEED / deceleration).max(0.0)
}

/// The plan with a proved tail that does not creep. `None` if the plan does not creep, or if neither replacement can be
/// proved.
#[must_use]
pub fn without_creeping(problem: &SpeedProblem, plan: &SpeedPlan) -> Option<SpeedPlan> {
    let creeps = |plan: &SpeedPlan| {
        let profile = smoothing::raw_profile(problem, plan)?;
        Some((creeping_time(&profile, problem.limits.deceleration) > MAX_CREEPING_TIME - SMOOTHING_TIME, profile))
    };
    if !creeps(plan)?.0 {
        return None;
    }
    let last_fast = plan.states.iter().rposition(|s| s.speed >= CREEPING_SPEED).unwrap_or(0);
    let stop_node = plan.states.last()?.node;
    let replacements =
        [fastest_approach(problem, plan, last_fast, stop_node), immediate_stop(problem, plan, last_fast)];
    replacements
        .into_iter()
        .flatten()
        .find(|other| creeps(other).is_some_and(|(creeps, profile)| !creeps && prove(problem, &profile).is_ok()))
}

/// The fastest comfortable approach from the state `from` of the plan to a standstill at `stop_node`.
fn fastest_approach(problem: &SpeedProblem, plan: &SpeedPlan, from: usize, stop_node: usize) -> Option<SpeedPlan> {
    let stations = &problem.stations;
    let limits = &problem.limits;
    let braking = |node: usize| (2.0 * limits.deceleration * (stations[stop_node] - stations[node])).max(0.0).sqrt();
    with_tail(problem, plan, from, |state, ds| {
        let accelerated = (state.speed * state.speed + 2.0 * limits.acceleration * ds).sqrt();
        accelerated.min(problem.speed_limits[state.node + 1]).min(braking(state.node + 1))
    })
}

/// A comfortable stop from the state `from` of the plan.
fn immediate_stop(problem: &SpeedProblem, plan: &SpeedPlan, from: usize) -> Option<SpeedPlan> {
    let deceleration = problem.limits.deceleration;
    with_tail(problem, plan, from, |state, ds| (state.speed * state.speed - 2.0 * deceleration * ds).max(0.0).sqrt())
}

/// The plan up to the state `from`, followed by a tail: `next_speed` gives the speed (m/s) at the next node from a
/// state and the length of the cell (m). `None` if the tail does not end at standstill.
fn with_tail(
    problem: &SpeedProblem,
    plan: &SpeedPlan,
    from: usize,
    next_speed: impl Fn(&SpeedState, f64) -> f64,
) -> Option<SpeedPlan> {
    let mut states = plan.states.get(..=from)?.to_vec();
    let mut state = *states.last()?;
    while state.node < problem.cells() {
        let ds = problem.stations[state.node + 1] - problem.stations[state.node];
        let speed = next_speed(&state, ds);
        let speed = if speed <= STANDSTILL_SPEED { 0.0 } else { speed };
        if state.speed + speed <= STANDSTILL_SPEED {
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
        creeping_time(&profile(problem, plan), problem.limits.deceleration) > MAX_CREEPING_TIME - SMOOTHING_TIME
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
    fn replaces_creeping_tails_of_the_papers_instances_for_both_proof_orders() {
        let mut creeping = Vec::new();
        for proof_order in [ProofOrder::StoppingDistance, ProofOrder::NearestGoal] {
            let resolution = Resolution { proof_order, ..Resolution::default() };
            let mut count = 0;
            for problem in instances() {
                let plan = search(&problem, Strategy::SafeTlp, &resolution).unwrap().proven().expect("a plan");
                let Some(other) = without_creeping(&problem, &plan) else {
                    assert!(!creeps(&problem, &plan), "still creeps: {plan:?}");
                    continue;
                };
                count += 1;
                assert!(creeps(&problem, &plan) && !creeps(&problem, &other));
                assert_eq!(prove(&problem, &profile(&problem, &other)), Ok(()));
                assert_eq!(
                    other.states.last().unwrap().node,
                    plan.states.last().unwrap().node,
                    "stops at another node"
                );
                assert_eq!(other.states[..=other.proof_starts], plan.states[..=other.proof_starts]);
            }
            creeping.push(count);
        }
        println!("{} creeping tails by stopping distance, {} by the paper's order", creeping[0], creeping[1]);
    }

    /// The whole path at 0.5 m/s.
    fn crawling(problem: &SpeedProblem) -> SpeedPlan {
        let cells = problem.cells();
        let state = |node: usize| SpeedState { node, speed: 0.5, time: node as f64 };
        let mut states: Vec<SpeedState> = (0..cells).map(state).collect();
        states.push(SpeedState { node: cells, speed: 0.0, time: cells as f64 + 1.0 });
        SpeedPlan { states, proof_starts: 0 }
    }

    #[test]
    fn creeping_time_excludes_a_comfortable_stop() {
        let problem = empty_road(20.0, 0.5);
        assert!((creeping_time(&profile(&problem, &crawling(&problem)), 1.5) - (41.0 - 1.0 / 1.5)).abs() < 1e-9);
        let found = search(&problem, Strategy::SafeTlp, &Resolution::default()).unwrap().proven().unwrap();
        assert!(creeping_time(&profile(&problem, &found), 1.5) < MAX_CREEPING_TIME);
    }

    #[test]
    fn stops_early_behind_a_creeping_obstacle_or_keeps_creeping_if_stopping_is_not_allowed() {
        // the obstacle clears half a metre per second
        let mut problem = empty_road(20.0, 0.5);
        for cell in 2..problem.cells() {
            problem.blocked[cell] = vec![(0.0, cell as f64 - 0.9)];
        }
        problem.horizon = 60.0;
        let plan = crawling(&problem);
        assert_eq!(prove(&problem, &profile(&problem, &plan)), Ok(()));
        let other = without_creeping(&problem, &plan).expect("an immediate stop is free");
        assert!(other.states.last().unwrap().node <= 2);
        problem.stopping_allowed[..30].fill(false);
        assert_eq!(prove(&problem, &profile(&problem, &plan)), Ok(()));
        assert_eq!(without_creeping(&problem, &plan), None, "a replacement was proved");
    }
}
