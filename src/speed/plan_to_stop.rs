//! The conventional method that the SafeTLP paper compares with: plan to stop. A breadth-first search expands every state
//! that the comfortable actions reach, and of the safe states it takes the one farthest along the road, then the earliest.
//!
//! The lattice is searched station by station. States of one station live in a layer; only two layers are in memory at a
//! time, and of all others the steps alone (three bytes a state), from which the plan is played again. That is what makes ten
//! million states fit into [`super::Resolution::memory`].

use std::collections::HashMap;
use std::hash::BuildHasherDefault;

use super::lattice::{Budget, KeyHasher, Lattice, Phase, REST, Rules, hash_table_bytes};
use super::{SpeedPlan, SpeedState};

/// The best plan; `None` if no safe state is reachable, or if a budget ended the search before one was met.
pub(super) fn search(lattice: &mut Lattice<'_>) -> Option<SpeedPlan> {
    let rules = Rules { problem: lattice.problem, wait: lattice.waits(), braking: lattice.strongest(Phase::Explore) };
    let root = lattice.state(0);
    let nodes = lattice.problem.stations.len();
    let mut layers = Layers { here: vec![root], next: Vec::new(), steps: vec![Vec::new(); nodes], states: 1 };
    layers.steps[0].push(Step::ROOT);
    let mut best: Option<Best> = None;
    let mut seen: [Seen; 2] = Default::default();
    let mut budget = lattice.resolution.expansions;
    'stations: for node in 0..nodes {
        let mut index = 0;
        // waiting adds to the layer while it is gone through
        while let Some(&state) = layers.here.get(index) {
            if state.speed <= REST && lattice.problem.is_safe_rest(node, state.time) {
                best = better(best, Best { node, index, time: state.time });
            }
            if !lattice.charge_with(&mut budget, layers.bytes() + seen[0].bytes() + seen[1].bytes()) {
                break 'stations;
            }
            let mut number = 0;
            rules.successors(&state, |to| {
                let (speed, time) = lattice.bins(&to);
                if seen[to.node - node].insert(speed, time) {
                    layers.add(index, number, node, to);
                }
                number += 1;
            });
            index += 1;
        }
        lattice.statistics.closed += layers.here.len();
        if layers.next.len() >= Step::MOST {
            lattice.spent = Some(Budget::Memory);
            break;
        }
        layers.advance();
        seen.swap(0, 1);
        seen[1].clear();
    }
    best.map(|best| layers.plan(root, &rules, &best))
}

/// The speed and time bins of one station that were met: a bit each, in words of 64 neighbouring times. Words are few
/// where bins are coarse, and exist only where something was met where they are fine.
#[derive(Default)]
struct Seen {
    words: HashMap<u64, u64, BuildHasherDefault<KeyHasher>>,
}

impl Seen {
    /// Whether the bin was not in it before.
    fn insert(&mut self, speed: usize, time: usize) -> bool {
        let word = self.words.entry(((speed as u64) << 32) | (time as u64 / 64)).or_default();
        let bit = 1 << (time % 64);
        let new = *word & bit == 0;
        *word |= bit;
        new
    }

    fn clear(&mut self) {
        self.words.clear();
    }

    fn bytes(&self) -> usize {
        hash_table_bytes::<(u64, u64)>(self.words.len())
    }
}

/// The states of two stations, and how every state was reached.
struct Layers {
    here: Vec<SpeedState>,
    next: Vec<SpeedState>,
    /// For each station, of each state.
    steps: Vec<Vec<Step>>,
    /// Number of all of them.
    states: usize,
}

/// How a state was reached, in three bytes: the index of its parent in its layer, and which of the parent's successors it
/// is. The parent lies in the same layer if they waited, else in the layer before.
#[derive(Clone, Copy, PartialEq)]
struct Step([u8; 3]);

impl Step {
    /// Bits of the successor's number; there are five actions.
    const BITS: u32 = 3;
    /// Stands for waiting.
    const WAITED: u32 = (1 << Self::BITS) - 1;
    const ROOT: Self = Self([u8::MAX; 3]);
    /// States of a layer that can be told apart: two million.
    const MOST: usize = (1 << (24 - Self::BITS)) - 1;

    fn new(parent: usize, successor: u32, waited: bool) -> Self {
        #[allow(clippy::cast_possible_truncation)] // layers are kept below `MOST`
        let packed = (parent as u32) << Self::BITS | if waited { Self::WAITED } else { successor };
        let [a, b, c, _] = packed.to_le_bytes();
        Self([a, b, c])
    }

    fn packed(self) -> u32 {
        let [a, b, c] = self.0;
        u32::from_le_bytes([a, b, c, 0])
    }

    fn parent(self) -> usize {
        (self.packed() >> Self::BITS) as usize
    }

    fn waited(self) -> bool {
        self.packed() & Self::WAITED == Self::WAITED
    }

    fn successor(self) -> usize {
        // waiting is the first of the actions
        if self.waited() { 0 } else { (self.packed() & Self::WAITED) as usize }
    }
}

/// A safe state.
#[derive(Clone, Copy)]
struct Best {
    node: usize,
    index: usize,
    time: f64,
}

fn better(best: Option<Best>, found: Best) -> Option<Best> {
    let keep = best.filter(|b| (b.node, -b.time) >= (found.node, -found.time));
    keep.or(Some(found))
}

impl Layers {
    /// Adds the `number`th successor of a state of the present layer.
    fn add(&mut self, parent: usize, number: u32, node: usize, to: SpeedState) {
        let waited = to.node == node;
        if waited { &mut self.here } else { &mut self.next }.push(to);
        self.steps[to.node].push(Step::new(parent, number, waited));
        self.states += 1;
    }

    fn advance(&mut self) {
        std::mem::swap(&mut self.here, &mut self.next);
        self.next.clear();
    }

    fn bytes(&self) -> usize {
        let states = (self.here.len() + self.next.len()) * size_of::<SpeedState>();
        states + self.states * size_of::<Step>()
    }

    /// The way to a state: backwards by the steps, then played forwards.
    fn plan(&self, root: SpeedState, rules: &Rules<'_>, best: &Best) -> SpeedPlan {
        let (mut node, mut index) = (best.node, best.index);
        let mut steps = Vec::new();
        while let Some(&step) = self.steps.get(node).and_then(|s| s.get(index)).filter(|s| **s != Step::ROOT) {
            steps.push(step);
            (node, index) = (if step.waited() { node } else { node - 1 }, step.parent());
        }
        let mut states = vec![root];
        let mut here = root;
        for step in steps.iter().rev() {
            let mut number = 0;
            rules.successors(&here.clone(), |to| {
                if number == step.successor() {
                    here = to;
                }
                number += 1;
            });
            states.push(here);
        }
        SpeedPlan { proof_starts: 0, states }
    }
}
