//! Detection of inevitable collision states: states from which every sequence of actions enters a blocked cell
//! (Fraichard and Asama, *Inevitable collision states*, Advanced Robotics 18, 2004). Without it, the search expands the
//! whole tree below such a state before it fails.
//!
//! The vehicle enters every cell within its stopping distance. Its entry time lies in a window: the maximum
//! acceleration gives the earliest time, the hardest braking the latest. From cell to cell, the blocked intervals raise
//! the earliest time: if a cell is blocked from before the earliest entry until `b`, the vehicle enters it after `b` or
//! never. The raised time applies to all farther cells, so the vehicle cannot pass an obstacle that drives ahead of it.
//! An empty window proves that the state is an inevitable collision state.
//!
//! The test is conservative: it may miss such a state, but it never reports a state from which a plan exists. Pruning
//! therefore keeps Theorems 1 and 2 valid. It misses states because it ignores the gaps between blocked intervals
//! inside a window.

use super::{SpeedProblem, SpeedState};

/// The test examines one in this many cells. Obstacles block many neighbouring cells, so the others add little.
const STRIDE: usize = 4;
/// Tolerance of the latest entry times, s: far above rounding errors, far below a time bin.
const TIME_SLACK: f64 = 1e-6;

/// The inevitable collision states of a problem, as a membership test.
pub(super) struct InevitableCollisionStates<'a> {
    problem: &'a SpeedProblem,
    /// The examined cells that have blocked intervals, in order.
    cells: Vec<usize>,
    /// For each node, the index in `cells` of the first cell that is not behind the node.
    next: Vec<usize>,
    /// Highest speed limit, m/s.
    top_speed: f64,
}

impl<'a> InevitableCollisionStates<'a> {
    pub(super) fn new(problem: &'a SpeedProblem) -> Self {
        let is_examined = |i: &usize| i.is_multiple_of(STRIDE) && !problem.blocked[*i].is_empty();
        let cells: Vec<usize> = (0..problem.cells()).filter(is_examined).collect();
        let next = (0..=problem.cells()).map(|node| cells.partition_point(|c| *c < node)).collect();
        let top_speed = problem.speed_limits.iter().fold(0.0, |a: f64, b| a.max(*b));
        Self { problem, cells, next, top_speed }
    }

    /// Whether a state is provably an inevitable collision state for a vehicle that brakes with at most `deceleration`
    /// (m/s²).
    pub(super) fn contains(&self, state: &SpeedState, deceleration: f64) -> bool {
        let p = self.problem;
        let v2 = state.speed * state.speed;
        let stopping_distance = v2 / (2.0 * deceleration);
        let top_speed = self.top_speed.max(state.speed);
        let here = p.stations[state.node];
        // lower bound of the entry time of every cell ahead
        let mut earliest = state.time;
        for &cell in &self.cells[self.next[state.node]..] {
            let distance = p.stations[cell] - here;
            if distance >= stopping_distance {
                return false;
            }
            let latest = state.time + (state.speed - (v2 - 2.0 * deceleration * distance).sqrt()) / deceleration;
            let far_distance = p.stations[cell + 1] - here;
            let max_speed = (v2 + 2.0 * p.limits.acceleration * far_distance).sqrt();
            let earliest_exit =
                state.time + (2.0 * far_distance / (state.speed + max_speed)).max(far_distance / top_speed);
            let blocked = &p.blocked[cell];
            let first = blocked.partition_point(|&(_, end)| end < earliest);
            for &(from, to) in &blocked[first..] {
                if from > earliest.max(earliest_exit) {
                    break;
                }
                earliest = to;
            }
            if earliest > latest + TIME_SLACK {
                return true;
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::*;
    use proptest::prelude::*;

    /// A lead vehicle at `lead_speed` (m/s), its rear `gap` (m) ahead. It blocks 9 m, the lengths of both vehicles.
    fn following(speed: f64, gap: f64, lead_speed: f64) -> SpeedProblem {
        let mut p = empty_road(100.0, speed);
        for cell in 0..p.cells() {
            let at = p.stations[cell];
            let (front, rear) = ((at - gap - 9.0) / lead_speed, (at - gap) / lead_speed);
            if rear > 0.0 {
                p.blocked[cell] = vec![(front.max(0.0), rear)];
            }
        }
        p
    }

    fn start(problem: &SpeedProblem) -> SpeedState {
        SpeedState { node: 0, speed: problem.start_speed, time: 0.0 }
    }

    #[test]
    fn braking_to_the_speed_of_the_lead_vehicle_decides() {
        // closing at 6 m/s, the vehicle needs 12 m at 1.5 m/s²
        let too_close = following(12.0, 11.0, 6.0);
        assert!(InevitableCollisionStates::new(&too_close).contains(&start(&too_close), 1.5));
        let far_enough = following(12.0, 13.0, 6.0);
        assert!(!InevitableCollisionStates::new(&far_enough).contains(&start(&far_enough), 1.5));
        assert!(
            !InevitableCollisionStates::new(&too_close).contains(&start(&too_close), 2.2),
            "braking with 2.2 m/s² avoids the collision"
        );
    }

    #[test]
    fn neither_a_standstill_nor_a_free_road_is_inevitable() {
        let p = following(0.0, 1.0, 0.5);
        assert!(!InevitableCollisionStates::new(&p).contains(&start(&p), 1.5));
        let free = empty_road(10.0, 15.0);
        assert!(!InevitableCollisionStates::new(&free).contains(&start(&free), 1.5));
    }

    /// Whether some sequence of actions reaches a standstill or the last node without entering a blocked cell.
    fn can_avoid(p: &SpeedProblem, s: SpeedState, deceleration: f64) -> bool {
        if s.node == p.cells() || s.speed <= 0.0 {
            return true;
        }
        let ds = p.stations[s.node + 1] - p.stations[s.node];
        [p.limits.acceleration, 0.0, -deceleration].iter().any(|a| {
            let speed = (s.speed * s.speed + 2.0 * a * ds).max(0.0).sqrt().min(p.speed_limits[s.node + 1]);
            let time = s.time + 2.0 * ds / (s.speed + speed);
            !p.is_blocked(s.node, s.time, time)
                && can_avoid(p, SpeedState { node: s.node + 1, speed, time }, deceleration)
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]

        #[test]
        fn no_action_sequence_avoids_a_reported_collision(
            speed in 0.5..8.0f64,
            blocks in prop::collection::vec((0..10usize, 0.0..4.0f64, 0.05..3.0f64), 0..10),
            deceleration in 0.5..4.0f64,
        ) {
            let mut p = empty_road(5.0, speed);
            for (cell, from, length) in blocks {
                if p.blocked[cell].last().is_none_or(|b| b.1 < from) {
                    p.blocked[cell].push((from, from + length));
                }
            }
            if InevitableCollisionStates::new(&p).contains(&start(&p), deceleration) {
                prop_assert!(!can_avoid(&p, start(&p), deceleration));
            }
        }
    }
}
