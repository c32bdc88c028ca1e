//! SafeTLP, Algorithm 1 of *Safe Temporal Planning for Urban Driving*.
//!
//! 1. A naive best-first search runs to a partial goal (the last station at any speed) with the comfortable actions.
//! 2. From its last state backwards, stopping proofs are searched, which may also use the aggressive deceleration.
//!    States from which even that cannot stop before the end are skipped. All proofs share one closed list, so that no
//!    state is expanded by two of them.
//! 3. If every proof fails, an exhaustive search from the root decides. It passes over what the proofs have closed: there
//!    is nothing safe below. So a state is expanded at most once by the naive search and once by all the others, which is
//!    Theorem 2 with the naive search counted.
//!
//! Where the naive search cannot reach the end (something stands or waits there), its deepest state takes the place of
//! the partial goal. Proofs go in the order that [`super::ProofOrder`] names; Theorems 1 and 2 hold for any.

use super::SpeedPlan;
use super::lattice::{Lattice, NO_PARENT, Phase};

/// The plan, if any state of the lattice is safe and the budgets last.
pub(super) fn search(lattice: &mut Lattice<'_>) -> Option<SpeedPlan> {
    // line 1: a potentially unsafe trajectory to a partial goal
    let last = super::naive::explore(lattice);
    // lines 2–9: proofs from its last state backwards, one closed list for all of them
    lattice.clear_closed();
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
    // line 10: exhaustive search from the root. Below what the proofs have closed nothing is safe, if they ran to their ends
    if lattice.spent.is_some() {
        lattice.clear_closed();
    }
    let mut budget = lattice.resolution.expansions;
    prove_stop(lattice, 0, &mut budget).map(|safe| lattice.plan_to(safe, 0))
}

/// Best-first search for a safe state below `from`.
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
