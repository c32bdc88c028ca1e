//! Plan-to-stop: the conventional method that the SafeTLP paper compares with. A breadth-first search expands every
//! state that comfortable actions reach. It returns the plan to the farthest safe state, and to the earliest of
//! several.
//!
//! The search proceeds node by node. The states of one node form a layer. Memory contains two layers at a time; of all
//! other layers it keeps one byte per state, the step that reached it. The plan is reconstructed by replaying these
//! steps. Twenty million states fit into [`super::Resolution::memory`] this way.

use std::collections::HashMap;
use std::hash::BuildHasherDefault;

use super::lattice::{Actions, KeyHasher, Lattice, Phase, STANDSTILL_SPEED, hash_table_bytes};
use super::{SpeedPlan, SpeedState};

/// The best plan. `None` if no safe state is reachable, or if a budget ended the search before it found one.
pub(super) fn search(lattice: &mut Lattice<'_>) -> Option<SpeedPlan> {
    let actions = Actions {
        problem: lattice.problem,
        wait: lattice.waiting_time(),
        braking: lattice.hardest_braking(Phase::Explore),
    };
    let root = lattice.state(0);
    let nodes = lattice.problem.stations.len();
    let mut layers = Layers { here: vec![root], next: Vec::new(), steps: Vec::new(), done: 0 };
    layers.steps.resize_with(nodes, Steps::default);
    layers.steps[0].push(Step { parent: 0, successor: 0, waited: false });
    let mut best: Option<Best> = None;
    let mut seen: [Seen; 2] = Default::default();
    let mut budget = lattice.resolution.expansions;
    'nodes: for node in 0..nodes {
        let mut index = 0;
        // waiting actions extend the layer during the iteration
        while let Some(&state) = layers.here.get(index) {
            if state.speed <= STANDSTILL_SPEED && lattice.problem.is_safe_standstill(node, state.time) {
                best = better(best, Best { node, index, time: state.time });
            }
            if !lattice.charge_with(&mut budget, layers.bytes(node) + seen[0].bytes() + seen[1].bytes()) {
                break 'nodes;
            }
            let mut number = 0;
            actions.successors(&state, |to| {
                let (speed, time) = lattice.bins(&to);
                if seen[to.node - node].insert(speed, time) {
                    layers.add(index, number, node, to);
                }
                number += 1;
            });
            index += 1;
        }
        lattice.statistics.closed += layers.here.len();
        layers.advance(node);
        seen.swap(0, 1);
        seen[1].clear();
    }
    best.map(|best| layers.plan(root, &actions, &best))
}

/// The set of visited (speed bin, time bin) pairs of one node: a sparse bit set with one bit per pair. Each word covers
/// 64 neighbouring time bins.
#[derive(Default)]
struct Seen {
    words: HashMap<u64, u64, BuildHasherDefault<KeyHasher>>,
}

impl Seen {
    /// Adds a pair of bins. Returns whether it is new.
    fn insert(&mut self, speed: usize, time: usize) -> bool {
        // 24 bits for the speed, 40 for the time word; the last bin includes all larger values
        let (speed, word) = ((speed as u64).min((1 << 24) - 1), (time as u64 / 64).min((1 << 40) - 1));
        let word = self.words.entry(speed << 40 | word).or_default();
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

/// The states of two neighbouring nodes, and the steps to all states.
struct Layers {
    here: Vec<SpeedState>,
    next: Vec<SpeedState>,
    /// Steps of each node, one for each state.
    steps: Vec<Steps>,
    /// Memory of the steps of finished nodes, bytes.
    done: usize,
}

/// The steps to the states of one node, packed into one byte each: the difference of the parent's index to the previous
/// parent's, and the number of the successor. Parents are in order: first those at the previous node, then those that
/// wait at this node. Each of the two sequences starts at zero.
#[derive(Default)]
struct Steps {
    bytes: Vec<u8>,
    /// Number of states.
    states: usize,
    /// Last parent at the previous node, and last parent that waits at this node.
    last: [usize; 2],
}

/// The step to one state.
#[derive(Clone, Copy)]
struct Step {
    /// Index of the parent in its layer.
    parent: usize,
    /// Number of the state among the parent's successors.
    successor: u8,
    /// Whether the step is a waiting action: the parent is at the same node.
    waited: bool,
}

impl Steps {
    /// Bits of the successor's number. There are five actions.
    const BITS: u32 = 3;
    const LOW: u8 = (1 << Self::BITS) - 1;
    /// Code in place of a successor's number: a waiting action, which is always the first successor.
    const WAITED: u8 = 7;
    /// Codes in place of a successor's number: no state, only an increment of the parent's index, at the previous node
    /// or at this node.
    const SKIP: [u8; 2] = [5, 6];
    /// Largest increment of the parent's index in one byte.
    const MAX_INCREMENT: usize = (u8::MAX >> Self::BITS) as usize;

    #[allow(clippy::cast_possible_truncation)] // five bits
    fn push(&mut self, Step { parent, successor, waited }: Step) {
        let kind = usize::from(waited);
        let mut increment = parent - self.last[kind];
        self.last[kind] = parent;
        while increment > Self::MAX_INCREMENT {
            self.bytes.push((Self::MAX_INCREMENT as u8) << Self::BITS | Self::SKIP[kind]);
            increment -= Self::MAX_INCREMENT;
        }
        self.bytes.push((increment as u8) << Self::BITS | if waited { Self::WAITED } else { successor });
        self.states += 1;
    }

    /// All steps, in order.
    fn unpacked(&self) -> Vec<Step> {
        let mut steps = Vec::with_capacity(self.states);
        let mut last = [0; 2];
        for byte in &self.bytes {
            let (increment, low) = (usize::from(byte >> Self::BITS), byte & Self::LOW);
            let waited = low == Self::WAITED || low == Self::SKIP[1];
            last[usize::from(waited)] += increment;
            if !Self::SKIP.contains(&low) {
                let successor = if waited { 0 } else { low };
                steps.push(Step { parent: last[usize::from(waited)], successor, waited });
            }
        }
        steps
    }
}

/// The best safe state so far.
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
    /// Adds a successor of the state `parent` in the layer of `node`.
    fn add(&mut self, parent: usize, successor: u8, node: usize, to: SpeedState) {
        let waited = to.node == node;
        if waited { &mut self.here } else { &mut self.next }.push(to);
        self.steps[to.node].push(Step { parent, successor, waited });
    }

    fn advance(&mut self, node: usize) {
        self.steps[node].bytes.shrink_to_fit();
        self.done += self.steps[node].bytes.len();
        std::mem::swap(&mut self.here, &mut self.next);
        self.next.clear();
    }

    /// Memory in use during the expansion of a node's layer, bytes.
    fn bytes(&self, node: usize) -> usize {
        let states = (self.here.capacity() + self.next.capacity()) * size_of::<SpeedState>();
        let steps = self.steps.iter().skip(node).take(2).map(|s| s.bytes.capacity()).sum::<usize>();
        states + self.done + steps
    }

    /// The plan to a state: follows the steps backwards, then replays them forwards.
    fn plan(&self, root: SpeedState, actions: &Actions<'_>, best: &Best) -> SpeedPlan {
        let (mut node, mut index) = (best.node, best.index);
        let mut successors = Vec::new();
        let mut steps = self.steps[node].unpacked();
        loop {
            if node == 0 && index == 0 {
                break;
            }
            let Some(&step) = steps.get(index) else { break };
            successors.push(step.successor);
            index = step.parent;
            if !step.waited {
                node -= 1;
                steps = self.steps[node].unpacked();
            }
        }
        let mut states = vec![root];
        let mut here = root;
        for successor in successors.into_iter().rev() {
            let mut number = 0;
            actions.successors(&here.clone(), |to| {
                if number == successor {
                    here = to;
                }
                number += 1;
            });
            states.push(here);
        }
        SpeedPlan { proof_starts: 0, states }
    }
}
