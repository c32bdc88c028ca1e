//! SafeRTS: an anytime search after Cserna, Doyle, Ramsdell and Ruml, *Avoiding Dead Ends in Real-Time Heuristic
//! Search*, AAAI-18. It alternates exploration and stopping proofs under one expansion budget and returns the longest
//! proven prefix.
//!
//! Each round continues the naive search for a slice of expansions. It then spends another slice on stopping proofs,
//! from the farthest state of the naive search backwards, until a proof succeeds or reaches a proven prefix. A round
//! without a proof doubles the slice; a proof resets it. States that an exhausted proof has closed are dead ends for
//! all later proofs. When the naive search ends, the remaining budget goes to proofs. The last proof starts at the
//! root, so the search is complete if the budget is unlimited.
//!
//! Two differences from the original: proofs run backwards along the best path as in SafeTLP, not from its last state
//! only; and the search commits to no action, because the planner replans from scratch in every cycle.

use super::SpeedPlan;
use super::lattice::{Lattice, NO_PARENT, Phase};
use super::safe_tlp::prove_stop;

/// Expansions of the first slice, as in the paper.
const FIRST_SLICE: usize = 10;

/// The plan with the longest prefix proven within the budget.
pub(super) fn search(lattice: &mut Lattice<'_>) -> Option<SpeedPlan> {
    let mut budget = lattice.resolution.expansions;
    let mut slice = FIRST_SLICE;
    let mut best: Option<Prefix> = None;
    let mut deepest = 0;
    lattice.begin(0, Phase::Explore);
    loop {
        let has_more = explore(lattice, &mut deepest, slice, &mut budget);
        // after the exploration, proofs may use the whole remaining budget
        let mut allowance = if has_more { slice.min(budget) } else { budget };
        let before = allowance;
        lattice.swap_searches();
        let proven = prove_back(lattice, deepest, best.as_ref(), &mut allowance);
        lattice.swap_searches();
        budget -= before - allowance;
        slice = if proven.is_some() { FIRST_SLICE } else { 2 * slice };
        best = proven.or(best);
        if !has_more || budget == 0 {
            break;
        }
    }
    best.map(|prefix| lattice.plan_to(prefix.safe, prefix.root))
}

/// A proven prefix: the path to the state `root`, from which a stopping proof leads to the state `safe`.
struct Prefix {
    root: usize,
    safe: usize,
}

/// Continues the naive search for a slice of the budget. Returns whether states remain to explore.
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

/// Attempts proofs from a state backwards to the root or to the proven prefix.
fn prove_back(lattice: &mut Lattice<'_>, from: usize, best: Option<&Prefix>, budget: &mut usize) -> Option<Prefix> {
    let mut current = from;
    while current != NO_PARENT && best.is_none_or(|b| b.root != current) && *budget > 0 {
        if lattice.can_stop_from(&lattice.state(current)) {
            lattice.statistics.proofs_tried += 1;
            if let Some(safe) = prove_stop(lattice, current, budget) {
                lattice.statistics.proof_succeeded = Some(lattice.statistics.proofs_tried);
                // states that a successful proof has closed are no dead ends
                lattice.clear_closed();
                return Some(Prefix { root: current, safe });
            }
        }
        current = lattice.parent(current);
    }
    if *budget == 0 {
        // states that an unfinished proof has closed may be no dead ends
        lattice.clear_closed();
    }
    None
}
