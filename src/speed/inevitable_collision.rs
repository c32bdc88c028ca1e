//! Tells the search which states are lost: moving so fast, behind something that is in the way, that braking as hard as
//! allowed is not enough. The search would find out by expanding everything below them.
//!
//! From a state, the time at which the vehicle enters a cell ahead lies in a window: not before what the strongest
//! acceleration reaches, not after what the hardest braking gives; cells within the stopping distance are entered in any
//! case. Cell by cell, the blocked intervals cut the window from below (who enters after time `t` and finds the cell
//! blocked from before `t` until `b` enters after `b`, or never), and the cut carries over to the cells behind: an
//! obstacle that drives ahead along the path is not jumped over. Where the window becomes empty, the state is lost.
//!
//! Every bound errs to the side of keeping a state: leaving lost states out loses no plan, so the theorems hold as they
//! stand. Not all lost states are found: a window with a hole in it is treated as if it had none.

use super::{SpeedProblem, SpeedState};

/// Cells looked at: every one of this many. Obstacles are much longer than the cells they block.
const STRIDE: usize = 4;
/// Added to the latest times, s: far above the rounding of sums along a path, far below a time bin.
const TIME_SLACK: f64 = 1e-6;

/// The cells that are blocked at some time, prepared for questions.
pub(super) struct InevitableCollision<'a> {
    problem: &'a SpeedProblem,
    /// Some of the cells that are ever blocked, in order.
    cells: Vec<usize>,
    /// For each node, the index in `cells` of the first one not behind it.
    next: Vec<usize>,
    /// The highest cap, m/s.
    top: f64,
}

impl<'a> InevitableCollision<'a> {
    pub(super) fn new(problem: &'a SpeedProblem) -> Self {
        let wanted = |i: &usize| i.is_multiple_of(STRIDE) && !problem.blocked[*i].is_empty();
        let cells: Vec<usize> = (0..problem.cells()).filter(wanted).collect();
        let next = (0..=problem.cells()).map(|node| cells.partition_point(|c| *c < node)).collect();
        let top = problem.speed_limits.iter().fold(0.0, |a: f64, b| a.max(*b));
        Self { problem, cells, next, top }
    }

    /// Whether no way leads on from the state, braking with `deceleration` (m/s²) at the hardest.
    pub(super) fn is_inevitable_collision(&self, state: &SpeedState, deceleration: f64) -> bool {
        let p = self.problem;
        let v2 = state.speed * state.speed;
        let stops_after = v2 / (2.0 * deceleration);
        let top = self.top.max(state.speed);
        let here = p.stations[state.node];
        // no cell ahead is entered before this
        let mut earliest = state.time;
        for &cell in &self.cells[self.next[state.node]..] {
            let way = p.stations[cell] - here;
            if way >= stops_after {
                return false;
            }
            let latest = state.time + (state.speed - (v2 - 2.0 * deceleration * way).sqrt()) / deceleration;
            let through = p.stations[cell + 1] - here;
            let fastest = (v2 + 2.0 * p.limits.acceleration * through).sqrt();
            let leaves = state.time + (2.0 * through / (state.speed + fastest)).max(through / top);
            let blocked = &p.blocked[cell];
            let first = blocked.partition_point(|&(_, end)| end < earliest);
            for &(from, to) in &blocked[first..] {
                if from > earliest.max(leaves) {
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

    /// An obstacle of 9 m (both vehicles' lengths) that drives ahead, its rear at `gap` metres now.
    fn behind(speed: f64, gap: f64, lead_speed: f64) -> SpeedProblem {
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
    fn braking_to_the_speed_of_the_one_ahead_decides() {
        // 6 m/s too fast, 1.5 m/s²: 12 m are needed
        let too_close = behind(12.0, 11.0, 6.0);
        assert!(InevitableCollision::new(&too_close).is_inevitable_collision(&start(&too_close), 1.5));
        let enough = behind(12.0, 13.0, 6.0);
        assert!(!InevitableCollision::new(&enough).is_inevitable_collision(&start(&enough), 1.5));
        assert!(
            !InevitableCollision::new(&too_close).is_inevitable_collision(&start(&too_close), 2.2),
            "harder braking is enough"
        );
    }

    #[test]
    fn a_state_at_rest_or_on_a_free_road_is_not_lost() {
        let p = behind(0.0, 1.0, 0.5);
        assert!(!InevitableCollision::new(&p).is_inevitable_collision(&start(&p), 1.5));
        let free = empty_road(10.0, 15.0);
        assert!(!InevitableCollision::new(&free).is_inevitable_collision(&start(&free), 1.5));
    }

    /// Whether any sequence of actions comes to rest or to the end without touching anything on the way.
    fn comes_through(p: &SpeedProblem, s: SpeedState, deceleration: f64) -> bool {
        if s.node == p.cells() || s.speed <= 0.0 {
            return true;
        }
        let ds = p.stations[s.node + 1] - p.stations[s.node];
        [p.limits.acceleration, 0.0, -deceleration].iter().any(|a| {
            let speed = (s.speed * s.speed + 2.0 * a * ds).max(0.0).sqrt().min(p.speed_limits[s.node + 1]);
            let time = s.time + 2.0 * ds / (s.speed + speed);
            !p.is_blocked(s.node, s.time, time)
                && comes_through(p, SpeedState { node: s.node + 1, speed, time }, deceleration)
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]

        #[test]
        fn no_way_leads_on_from_a_lost_state(
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
            if InevitableCollision::new(&p).is_inevitable_collision(&start(&p), deceleration) {
                prop_assert!(!comes_through(&p, start(&p), deceleration));
            }
        }
    }
}
