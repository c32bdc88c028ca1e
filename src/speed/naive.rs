//! The naive strategy: best-first search to the last node at any speed.
//!
//! This is line 1 of SafeTLP. As a strategy it shows what a planner without stopping proofs would drive.

use super::SpeedPlan;
use super::lattice::{Lattice, Phase};

/// The plan to the last node, or to the state nearest to it. It has no stopping proof.
pub(super) fn search(lattice: &mut Lattice<'_>) -> SpeedPlan {
    let last = explore(lattice, lattice.resolution.expansions);
    lattice.plan_to(last, last)
}

/// Best-first search to the last node with a budget of expansions. Returns the index of a state there, or of the first state at the farthest node
/// reached.
pub(super) fn explore(lattice: &mut Lattice<'_>, mut budget: usize) -> usize {
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
