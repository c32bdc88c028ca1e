//! The naive strategy: best-first search to the last station, at whatever speed. It is line 1 of SafeTLP, and alone it is
//! what a planner without a proof would drive: nothing says that it can stop.

use super::SpeedPlan;
use super::lattice::{Lattice, Phase};

/// The plan to the state that came nearest to the end; its proof is empty, since there is none.
pub(super) fn search(lattice: &mut Lattice<'_>) -> SpeedPlan {
    let last = explore(lattice);
    lattice.plan_to(last, last)
}

/// Best-first search to the last station; the state that got nearest if none gets there.
pub(super) fn explore(lattice: &mut Lattice<'_>) -> usize {
    let mut budget = lattice.resolution.expansions;
    let mut deepest = 0;
    lattice.begin(0, Phase::Explore);
    while let Some(index) = lattice.next(Phase::Explore, &mut budget) {
        let node = lattice.state(index).node;
        if node > lattice.state(deepest).node {
            deepest = index;
        }
        if node == lattice.problem.cells() {
            return index;
        }
        if !lattice.charge(&mut budget) {
            break;
        }
        lattice.expand(index, Phase::Explore);
    }
    deepest
}
