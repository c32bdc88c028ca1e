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
pub(super) struct Outlook<'a> {
    problem: &'a SpeedProblem,
    /// Some of the cells that are ever blocked, in order.
    cells: Vec<usize>,
    /// For each node, the index in `cells` of the first one not behind it.
    next: Vec<usize>,
    /// The highest cap, m/s.
    top: f64,
}

impl<'a> Outlook<'a> {
    pub(super) fn new(problem: &'a SpeedProblem) -> Self {
        let wanted = |i: &usize| i % STRIDE == 0 && !problem.blocked[*i].is_empty();
        let cells: Vec<usize> = (0..problem.cells()).filter(wanted).collect();
        let next = (0..=problem.cells()).map(|node| cells.partition_point(|c| *c < node)).collect();
        let top = problem.caps.iter().fold(0.0, |a: f64, b| a.max(*b));
        Self { problem, cells, next, top }
    }

    /// Whether no way leads on from the state, braking with `deceleration` (m/s²) at the hardest.
    pub(super) fn is_lost(&self, state: &SpeedState, deceleration: f64) -> bool {
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
