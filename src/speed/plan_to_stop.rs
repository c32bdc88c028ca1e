//! The conventional method that the SafeTLP paper compares with: plan to stop. A breadth-first search expands every state
//! that the comfortable actions reach, and of the safe states it takes the one farthest along the road, then the earliest.
//!
//! The lattice is searched station by station. States of one station live in a layer; only two layers are in memory at a
//! time, and of all others the steps alone (a byte a state), from which the plan is played again. That is what makes twenty
//! million states fit into [`super::Resolution::memory`].

use std::collections::HashMap;
use std::hash::BuildHasherDefault;

use super::lattice::{KeyHasher, Lattice, Phase, REST, Rules, hash_table_bytes};
use super::{SpeedPlan, SpeedState};

/// The best plan; `None` if no safe state is reachable, or if a budget ended the search before one was met.
pub(super) fn search(lattice: &mut Lattice<'_>) -> Option<SpeedPlan> {
    let rules = Rules { problem: lattice.problem, wait: lattice.waits(), braking: lattice.strongest(Phase::Explore) };
    let root = lattice.state(0);
    let nodes = lattice.problem.stations.len();
    let mut layers = Layers { here: vec![root], next: Vec::new(), steps: Vec::new(), done: 0 };
    layers.steps.resize_with(nodes, Steps::default);
    layers.steps[0].push(Step { parent: 0, successor: 0, waited: false });
    let mut best: Option<Best> = None;
    let mut seen: [Seen; 2] = Default::default();
    let mut budget = lattice.resolution.expansions;
    'stations: for node in 0..nodes {
        let mut index = 0;
        // waiting adds to the layer while it is gone through
        while let Some(&state) = layers.here.get(index) {
            if state.speed <= REST && lattice.problem.is_safe_standstill(node, state.time) {
                best = better(best, Best { node, index, time: state.time });
            }
            if !lattice.charge_with(&mut budget, layers.bytes(node) + seen[0].bytes() + seen[1].bytes()) {
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
        layers.advance(node);
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
        // 24 bits of speed and 40 of time words; the last bin of a kind holds all beyond
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

/// The states of two stations, and how every state was reached.
struct Layers {
    here: Vec<SpeedState>,
    next: Vec<SpeedState>,
    /// For each station, of each state.
    steps: Vec<Steps>,
    /// Capacity of the steps of the stations that are done, bytes.
    done: usize,
}

/// How the states of a station were reached, a byte each: how many states their parent lies after the parent of the one
/// before, and which of the parent's successors they are. Parents come in order, first those at the station before, then
/// those that wait at the same one; each kind is counted from zero.
#[derive(Default)]
struct Steps {
    bytes: Vec<u8>,
    /// Number of states.
    states: usize,
    /// Parents of the last state that came from the station before, and of the last one that waited.
    last: [usize; 2],
}

/// How one state was reached.
#[derive(Clone, Copy)]
struct Step {
    /// Index of the parent at its station.
    parent: usize,
    /// Number among its successors.
    successor: u8,
    /// Whether the parent is at the same station.
    waited: bool,
}

impl Steps {
    /// Bits of the successor's number; there are five actions.
    const BITS: u32 = 3;
    const LOW: u8 = (1 << Self::BITS) - 1;
    /// In place of a successor's number: waited, which is the first of the actions.
    const WAITED: u8 = 7;
    /// In place of a successor's number: no state, but parents to pass over, on the way from the station before or waiting.
    const PASS: [u8; 2] = [5, 6];
    /// Parents that a byte passes over at most.
    const FAR: usize = (u8::MAX >> Self::BITS) as usize;

    #[allow(clippy::cast_possible_truncation)] // five bits
    fn push(&mut self, Step { parent, successor, waited }: Step) {
        let kind = usize::from(waited);
        let mut ahead = parent - self.last[kind];
        self.last[kind] = parent;
        while ahead > Self::FAR {
            self.bytes.push((Self::FAR as u8) << Self::BITS | Self::PASS[kind]);
            ahead -= Self::FAR;
        }
        self.bytes.push((ahead as u8) << Self::BITS | if waited { Self::WAITED } else { successor });
        self.states += 1;
    }

    /// All of them, in order.
    fn unpacked(&self) -> Vec<Step> {
        let mut steps = Vec::with_capacity(self.states);
        let mut last = [0; 2];
        for byte in &self.bytes {
            let (ahead, low) = (usize::from(byte >> Self::BITS), byte & Self::LOW);
            let waited = low == Self::WAITED || low == Self::PASS[1];
            last[usize::from(waited)] += ahead;
            if !Self::PASS.contains(&low) {
                let successor = if waited { 0 } else { low };
                steps.push(Step { parent: last[usize::from(waited)], successor, waited });
            }
        }
        steps
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
    /// Adds the `successor`th successor of a state of the present layer.
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

    /// Memory in use while a station is gone through, bytes.
    fn bytes(&self, node: usize) -> usize {
        let states = (self.here.capacity() + self.next.capacity()) * size_of::<SpeedState>();
        let steps = self.steps.iter().skip(node).take(2).map(|s| s.bytes.capacity()).sum::<usize>();
        states + self.done + steps
    }

    /// The way to a state: backwards by the steps, then played forwards.
    fn plan(&self, root: SpeedState, rules: &Rules<'_>, best: &Best) -> SpeedPlan {
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
        for wanted in successors.into_iter().rev() {
            let mut number = 0;
            rules.successors(&here.clone(), |to| {
                if number == wanted {
                    here = to;
                }
                number += 1;
            });
            states.push(here);
        }
        SpeedPlan { proof_starts: 0, states }
    }
}
