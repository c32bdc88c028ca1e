//! SafeTLP: Algorithm 1 of Cserna, Doyle, Gu and Ruml, *Safe Temporal Planning for Urban Driving*.
//!
//! 1. A naive best-first search with comfortable actions finds a trajectory to a partial goal: the last node at any
//!    speed.
//! 2. From the last state of that trajectory backwards, best-first searches look for a stopping proof. They may also
//!    use the aggressive deceleration. The algorithm skips states from which even that deceleration cannot stop before
//!    the last node. All proofs share one closed list, so each state is expanded by at most one of them.
//! 3. If all proofs fail, a search from the root decides. It skips the states that the proofs have closed, because no
//!    safe state is reachable from them. So the naive search expands a state at most once, and all other searches
//!    together at most once: the bound of Theorem 2 includes the naive search.
//!
//! If the naive search cannot reach the last node, for example behind a stopped obstacle, or not with its budget, its farthest
//! state replaces the partial goal. [`super::ProofOrder`] sets the expansion order of the proofs; Theorems 1 and 2 hold for any order.

use super::SpeedPlan;
use super::lattice::{Lattice, NO_PARENT, Phase};

/// A proven plan. `None` if no safe state is reachable or a budget is exhausted.
pub(super) fn search(lattice: &mut Lattice<'_>) -> Option<SpeedPlan> {
    // line 1: potentially unsafe trajectory to a partial goal
    let last = super::naive::explore(lattice, lattice.resolution.exploration);
    // lines 2–9: proofs from its last state backwards, one closed list for all of them
    lattice.clear_closed();
    // an exploration may end anywhere
    lattice.exhausted = None;
    let mut budget = lattice.resolution.expansions;
    let mut current = last;
    while current != NO_PARENT {
        if lattice.can_stop_from(&lattice.state(current)) {
            lattice.statistics.proofs_tried += 1;
            if let Some(safe) = prove_stop(lattice, current, &mut budget) {
                lattice.statistics.proof_succeeded = Some(lattice.statistics.proofs_tried);
                return Some(lattice.plan_to(safe, current));
            }
        }
        current = lattice.parent(current);
    }
    // line 10: search from the root. States that an unfinished proof has closed may still lead to a safe state; where proofs are that
    // far, it seldom finds one
    let mut budget = lattice.resolution.expansions;
    if lattice.exhausted.take().is_some() {
        lattice.clear_closed();
        budget = budget.min(lattice.resolution.exploration);
    }
    prove_stop(lattice, 0, &mut budget).map(|safe| lattice.plan_to(safe, 0))
}

/// Best-first search for a safe state that is reachable from `from`. Returns the index of that state.
pub(super) fn prove_stop(lattice: &mut Lattice<'_>, from: usize, budget: &mut usize) -> Option<usize> {
    lattice.begin(from, Phase::Proof);
    while let Some(index) = lattice.next(Phase::Proof, budget) {
        if lattice.is_safe(index) {
            return Some(index);
        }
        if !lattice.charge(budget) {
            return None;
        }
        lattice.expand(index, Phase::Proof);
    }
    None
}
