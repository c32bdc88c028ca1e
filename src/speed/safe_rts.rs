//! A search in the manner of SafeRTS (Cserna, Doyle, Ramsdell, Ruml: *Avoiding Dead Ends in Real-Time Heuristic Search*,
//! AAAI-18): it explores and proves in turns under one budget of expansions, and returns the best proven prefix that it
//! has when the budget is spent.
//!
//! Each turn spends a slice on the naive search, which goes on where it was, and a slice on stopping proofs from its best
//! state backwards, until one succeeds or meets a state of the proven prefix. A turn without a proof doubles the slice, a
//! proof resets it. States below which an exhausted proof found nothing are dead for all later proofs. When the naive
//! search has come to its end, what is left of the budget goes to proofs; the last one starts at the root, so that with an
//! unlimited budget the search is complete.
//!
//! Two differences to the original: proofs run backwards along the best path as in SafeTLP, instead of from its last state
//! only; and there is no action to commit to, since the planner replans from scratch in every cycle.

use super::SpeedPlan;
use super::lattice::{Lattice, NO_PARENT, Phase};
use super::safe_tlp::prove_stop;

/// Expansions of the first slice, as in the paper.
const FIRST_SLICE: usize = 10;

/// The plan that gets farthest of those proven within the budget.
pub(super) fn search(lattice: &mut Lattice<'_>) -> Option<SpeedPlan> {
    let mut budget = lattice.resolution.expansions;
    let mut slice = FIRST_SLICE;
    let mut best: Option<Prefix> = None;
    let mut deepest = 0;
    lattice.begin(0, Phase::Explore);
    loop {
        let goes_on = explore(lattice, &mut deepest, slice, &mut budget);
        // without anything left to explore, proofs may use all there is
        let mut allowance = if goes_on { slice.min(budget) } else { budget };
        let before = allowance;
        lattice.swap_fronts();
        let proven = prove_back(lattice, deepest, best.as_ref(), &mut allowance);
        lattice.swap_fronts();
        budget -= before - allowance;
        slice = if proven.is_some() { FIRST_SLICE } else { 2 * slice };
        best = proven.or(best);
        if !goes_on || budget == 0 {
            break;
        }
    }
    best.map(|prefix| lattice.plan_to(prefix.safe, prefix.root))
}

/// A proven prefix: the path to `root`, and from there to the safe state.
struct Prefix {
    root: usize,
    safe: usize,
}

/// Goes on with the naive search for a slice of the budget; whether there is more to explore.
fn explore(lattice: &mut Lattice<'_>, deepest: &mut usize, mut slice: usize, budget: &mut usize) -> bool {
    while let Some(index) = lattice.next(Phase::Explore, budget) {
        let node = lattice.state(index).node;
        if node > lattice.state(*deepest).node {
            *deepest = index;
        }
        if node == lattice.problem.cells() || !lattice.charge(budget) {
            return false;
        }
        lattice.expand(index, Phase::Explore);
        slice -= 1;
        if slice == 0 {
            return true;
        }
    }
    false
}

/// Proofs from a state backwards to the root, or to what is proven already.
fn prove_back(lattice: &mut Lattice<'_>, from: usize, best: Option<&Prefix>, budget: &mut usize) -> Option<Prefix> {
    let mut current = from;
    while current != NO_PARENT && best.is_none_or(|b| b.root != current) && *budget > 0 {
        if lattice.can_stop_from(&lattice.state(current)) {
            lattice.statistics.proofs_tried += 1;
            if let Some(safe) = prove_stop(lattice, current, budget) {
                lattice.statistics.proof_succeeded = Some(lattice.statistics.proofs_tried);
                // what a proof that succeeded has closed is not dead
                lattice.clear_closed();
                return Some(Prefix { root: current, safe });
            }
        }
        current = lattice.parent(current);
    }
    if *budget == 0 {
        // nor is what a proof that ran out of budget has closed
        lattice.clear_closed();
    }
    None
}
