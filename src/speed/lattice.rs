//! The speed lattice that all strategies search: its states, its actions, its duplicates and what a search may spend.
//!
//! A state is (node, speed, time). The actions from it cross one cell at the comfortable acceleration, at constant speed,
//! at the comfortable deceleration and, where the phase allows it, at the aggressive deceleration; at rest, where
//! something moves on the road, there is waiting. Two things are not in the paper and matter:
//!
//! - **The clip.** When v² < 2dΔs the vehicle stops inside the cell. The deceleration is clipped so that rest falls on the
//!   next node; without it most start speeds could never reach exactly zero, and every proof would fail.
//! - **Lost states** ([`super::inevitable_collision`]) are dropped when they are popped and count as expanded.
//!
//! Duplicates are states of one node, one speed bin and one time bin ([`Resolution`]); a key packs the three into a `u64`.
//! Where nothing moves, all times are one bin. Nodes, open list and closed list keep their memory from search to search:
//! the inner loop allocates nothing once they have grown.

use std::cell::Cell;
use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};

use super::inevitable_collision::InevitableCollision;
use super::{Resolution, SpeedPlan, SpeedProblem, SpeedState, Statistics};

/// Speeds below this are rest (m/s): a rounding guard, far below the slowest speed an edge can produce.
pub(super) const REST: f64 = 1e-6;
/// A time within this of a bin's border lies in the later bin, in bins: rounding must not decide.
const ON_GRID: f64 = 1e-6;

/// How a search orders its open list and how hard it may brake.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// Nearest to the goal, then earliest, then fastest; comfortable actions.
    Explore,
    /// For a stop; the aggressive deceleration too.
    Proof,
}

/// A state met by a search.
pub(super) struct Node {
    pub(super) state: SpeedState,
    pub(super) parent: usize,
    /// Of its duplicates.
    key: u64,
}

pub(super) const NO_PARENT: usize = usize::MAX;

/// What a search writes to. Its contents do not outlive the search, its capacity does.
#[derive(Default)]
struct Memory {
    nodes: Vec<Node>,
    /// Of the search that goes on.
    front: Front,
    /// Of the one that is set aside ([`Lattice::swap_fronts`]).
    aside: Front,
}

/// What a search has open and what it has closed.
#[derive(Default)]
struct Front {
    open: BinaryHeap<Open>,
    closed: Closed,
}

impl Front {
    fn clear(&mut self) {
        self.open.clear();
        self.closed.clear();
    }

    /// Bytes for numbers of open and closed states.
    fn bytes(open: usize, closed: usize) -> usize {
        open * size_of::<Open>() + hash_table_bytes::<u64>(closed)
    }
}

/// Bytes of a hash table with so many entries: there is a byte of control beside each slot, and seven of eight are filled.
pub(super) fn hash_table_bytes<T>(entries: usize) -> usize {
    entries * (size_of::<T>() + 1) * 8 / 7
}

/// What orders the open list; the smallest rank is expanded first. Ties go to the older node.
#[derive(PartialEq)]
struct Open {
    rank: [f64; 3],
    index: usize,
}

impl Eq for Open {}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        // reversed: BinaryHeap pops its largest element
        let by_rank = (0..3).map(|i| other.rank[i].total_cmp(&self.rank[i])).find(|o| o.is_ne());
        by_rank.unwrap_or_else(|| other.index.cmp(&self.index))
    }
}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Multiplicative hashing of one `u64` key (Knuth, TAOCP 3, §6.4): the keys are small packed integers of our own.
#[derive(Default)]
pub(super) struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        for &b in bytes {
            self.write_u64(u64::from(b));
        }
    }
    fn write_u64(&mut self, key: u64) {
        self.0 = (self.0 ^ key).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(26);
    }
}

type Closed = HashSet<u64, BuildHasherDefault<KeyHasher>>;

/// The stations × speeds × times of one problem, and one search's way through them.
pub(super) struct Lattice<'a> {
    pub(super) problem: &'a SpeedProblem,
    pub(super) resolution: Resolution,
    time_matters: bool,
    inevitable_collision: InevitableCollision<'a>,
    memory: Memory,
    pub(super) statistics: Statistics,
    /// Which budget ended a search, if one did.
    pub(super) spent: Option<Budget>,
}

/// What a search may spend.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Budget {
    /// [`Resolution::expansions`].
    Expansions,
    /// [`Resolution::memory`].
    Memory,
}

/// Runs a search on a lattice whose memory is kept from search to search of this thread: a cycle makes dozens, each with
/// up to a megabyte of nodes.
pub(super) fn with<T>(
    problem: &SpeedProblem,
    resolution: &Resolution,
    search: impl FnOnce(&mut Lattice<'_>) -> T,
) -> (T, Statistics, Option<Budget>) {
    thread_local! {
        static MEMORY: Cell<Memory> = Cell::default();
    }
    MEMORY.with(|kept| {
        let mut lattice = Lattice::new(problem, *resolution, kept.take());
        let found = search(&mut lattice);
        lattice.clear_closed();
        lattice.swap_fronts();
        lattice.clear_closed();
        let Lattice { memory, statistics, spent, .. } = lattice;
        // what a rare large search needed is given back
        if memory.bytes() <= KEPT_BYTES {
            kept.set(memory);
        }
        (found, statistics, spent)
    })
}

/// Memory kept from search to search, bytes.
const KEPT_BYTES: usize = 16 << 20;

impl Memory {
    /// Bytes reserved.
    fn bytes(&self) -> usize {
        let fronts = [&self.front, &self.aside].map(|f| Front::bytes(f.open.capacity(), f.closed.capacity()));
        self.nodes.capacity() * size_of::<Node>() + fronts.iter().sum::<usize>()
    }

    /// Bytes in use; they do not depend on what an earlier search left reserved.
    fn bytes_in_use(&self) -> usize {
        let fronts = [&self.front, &self.aside].map(|f| Front::bytes(f.open.len(), f.closed.len()));
        self.nodes.len() * size_of::<Node>() + fronts.iter().sum::<usize>()
    }
}

impl<'a> Lattice<'a> {
    fn new(problem: &'a SpeedProblem, resolution: Resolution, mut memory: Memory) -> Self {
        memory.nodes.clear();
        memory.front.clear();
        memory.aside.clear();
        let time_matters = problem.time_matters() || resolution.always_timed;
        let inevitable_collision = InevitableCollision::new(problem);
        let statistics = Statistics::default();
        let mut lattice =
            Self { problem, resolution, time_matters, inevitable_collision, memory, statistics, spent: None };
        let root = SpeedState { node: 0, speed: problem.start_speed, time: problem.start_time };
        let key = lattice.key(&root);
        lattice.memory.nodes.push(Node { state: root, parent: NO_PARENT, key });
        lattice
    }

    /// The state at an index; the root is at 0.
    pub(super) fn state(&self, index: usize) -> SpeedState {
        self.memory.nodes[index].state
    }

    /// The state before, [`NO_PARENT`] for the root.
    pub(super) fn parent(&self, index: usize) -> usize {
        self.memory.nodes[index].parent
    }

    /// Whether the state is a safe one: at rest, where resting is allowed, untouched to the horizon.
    pub(super) fn is_safe(&self, index: usize) -> bool {
        let state = self.state(index);
        state.speed <= REST && self.problem.is_safe_standstill(state.node, state.time)
    }

    /// Makes `from` the only open state.
    pub(super) fn begin(&mut self, from: usize, phase: Phase) {
        self.memory.front.open.clear();
        let rank = self.rank(&self.memory.nodes[from].state, phase);
        self.memory.front.open.push(Open { rank, index: from });
    }

    /// Forgets which states were expanded.
    pub(super) fn clear_closed(&mut self) {
        self.statistics.closed += self.memory.front.closed.len();
        self.memory.front.closed.clear();
    }

    /// Sets the search that goes on aside, and takes up the one that was.
    pub(super) fn swap_fronts(&mut self) {
        let Memory { front, aside, .. } = &mut self.memory;
        std::mem::swap(front, aside);
    }

    /// Takes the best open state that is neither closed nor lost, and closes it. Lost states count as expanded: to see
    /// that they are takes about as long.
    pub(super) fn next(&mut self, phase: Phase, budget: &mut usize) -> Option<usize> {
        let braking = self.strongest(phase);
        while let Some(Open { index, .. }) = self.memory.front.open.pop() {
            let Node { state, key, .. } = &self.memory.nodes[index];
            if !self.memory.front.closed.insert(*key) {
                continue;
            }
            if !self.inevitable_collision.is_inevitable_collision(state, braking) {
                return Some(index);
            }
            if !self.charge(budget) {
                break;
            }
        }
        None
    }

    /// Hardest braking of a phase, m/s².
    pub(super) fn strongest(&self, phase: Phase) -> f64 {
        let limits = &self.problem.limits;
        if phase == Phase::Explore { limits.deceleration } else { limits.aggressive_deceleration }
    }

    /// Pays for an expansion; whether there was something left to pay with.
    pub(super) fn charge(&mut self, budget: &mut usize) -> bool {
        let bytes = self.memory.bytes_in_use();
        self.charge_with(budget, bytes)
    }

    /// [`Self::charge`] for a search that keeps its states itself, in so many bytes.
    pub(super) fn charge_with(&mut self, budget: &mut usize, bytes: usize) -> bool {
        if *budget == 0 {
            self.spent = Some(Budget::Expansions);
            return false;
        }
        if bytes > self.resolution.memory {
            self.spent = Some(Budget::Memory);
            return false;
        }
        self.statistics.bytes = self.statistics.bytes.max(bytes);
        *budget -= 1;
        self.statistics.expansions += 1;
        true
    }

    /// Whether the aggressive deceleration stops the vehicle before the last node.
    pub(super) fn can_stop_from(&self, state: &SpeedState) -> bool {
        let room = self.problem.end() - self.problem.stations[state.node];
        state.speed * state.speed <= 2.0 * self.problem.limits.aggressive_deceleration * room + REST
    }

    /// Opens the states that the actions of a phase lead to.
    pub(super) fn expand(&mut self, index: usize, phase: Phase) {
        let from = self.memory.nodes[index].state;
        let rules = Rules { problem: self.problem, wait: self.waits(), braking: self.strongest(phase) };
        rules.successors(&from, |to| self.push(to, index, phase));
    }

    /// Duration of the waiting action, s, if there is one.
    pub(super) fn waits(&self) -> Option<f64> {
        self.time_matters.then_some(self.resolution.wait)
    }

    fn push(&mut self, state: SpeedState, parent: usize, phase: Phase) {
        let key = self.key(&state);
        if self.memory.front.closed.contains(&key) {
            return;
        }
        let index = self.memory.nodes.len();
        self.memory.nodes.push(Node { state, parent, key });
        self.memory.front.open.push(Open { rank: self.rank(&state, phase), index });
    }

    fn rank(&self, s: &SpeedState, phase: Phase) -> [f64; 3] {
        let to_go = -(s.node as f64);
        match (phase, self.resolution.proof_order) {
            (Phase::Explore, _) => [to_go, s.time, -s.speed],
            (Phase::Proof, ProofOrder::StoppingDistance) => [s.speed, s.time, to_go],
            (Phase::Proof, ProofOrder::NearestGoal) => [to_go, s.speed, s.time],
        }
    }

    /// Packs station, speed bin and time bin: 16 + 24 + 24 bits. The last bin of a kind holds all beyond.
    fn key(&self, s: &SpeedState) -> u64 {
        const LAST: u64 = (1 << 24) - 1;
        let (speed, time) = self.bins(s);
        ((s.node as u64) << 48) | ((speed as u64).min(LAST) << 24) | (time as u64).min(LAST)
    }

    /// Speed bin and time bin of a state.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // bins of bounded, non-negative quantities
    pub(super) fn bins(&self, s: &SpeedState) -> (usize, usize) {
        let speed = (s.speed / self.resolution.speed).round() as usize;
        let time = if self.time_matters {
            ((s.time - self.problem.start_time) / self.resolution.time + ON_GRID).floor() as usize
        } else {
            0
        };
        (speed, time)
    }

    /// The plan that leads to a state; what comes after `proof_root` on it is its proof.
    pub(super) fn plan_to(&self, end: usize, proof_root: usize) -> SpeedPlan {
        let mut states = Vec::new();
        let mut proof_starts = 0;
        let mut index = end;
        while index != NO_PARENT {
            if index == proof_root {
                proof_starts = states.len();
            }
            states.push(self.memory.nodes[index].state);
            index = self.memory.nodes[index].parent;
        }
        proof_starts = states.len() - 1 - proof_starts;
        states.reverse();
        SpeedPlan { states, proof_starts }
    }
}

/// The actions of a search.
pub(super) struct Rules<'a> {
    pub(super) problem: &'a SpeedProblem,
    /// Duration of the waiting action at rest, s; `None` where time does not matter.
    pub(super) wait: Option<f64>,
    /// Hardest braking, m/s².
    pub(super) braking: f64,
}

impl Rules<'_> {
    /// The free states that the actions lead to, in a fixed order: wait, accelerate, hold, decelerate, brake hard.
    pub(super) fn successors(&self, from: &SpeedState, mut visit: impl FnMut(SpeedState)) {
        let p = self.problem;
        if from.speed <= REST {
            self.waited(from).into_iter().for_each(&mut visit);
        }
        if from.node >= p.cells() {
            return;
        }
        let ds = p.stations[from.node + 1] - p.stations[from.node];
        let (v2, cap) = (from.speed * from.speed, p.speed_limits[from.node + 1]);
        let limits = &p.limits;
        // A start above the cap may stay above it while it brakes as hard as this phase allows.
        let lowest = (v2 - 2.0 * self.braking * ds).max(0.0).sqrt();
        let admissible = |v: f64| v <= cap.max(lowest);
        let mut cross = |speed: f64| self.crossed(from, ds, speed).into_iter().for_each(&mut visit);

        let faster = (v2 + 2.0 * limits.acceleration * ds).sqrt().min(cap);
        if faster > from.speed {
            cross(faster);
        }
        let held = from.speed.min(cap).max(lowest);
        if held > REST && admissible(held) {
            cross(held);
        }
        for deceleration in [limits.deceleration, limits.aggressive_deceleration] {
            if deceleration > self.braking || from.speed <= REST {
                continue;
            }
            // v² < 2dΔs stops inside the cell: the deceleration is clipped so that rest falls on the next node
            let slower = (v2 - 2.0 * deceleration * ds).max(0.0).sqrt();
            if (slower < held || held <= REST) && admissible(slower) {
                cross(slower);
            }
        }
    }

    /// Waiting at rest: allowed where the pose stays free for the waiting time.
    fn waited(&self, from: &SpeedState) -> Option<SpeedState> {
        let time = from.time + self.wait?;
        let free = time <= self.problem.horizon && !self.problem.is_standstill_blocked(from.node, from.time, time);
        free.then_some(SpeedState { time, ..*from })
    }

    /// The next node at a speed, unless the cell is blocked meanwhile.
    fn crossed(&self, from: &SpeedState, ds: f64, speed: f64) -> Option<SpeedState> {
        let speed = if speed <= REST { 0.0 } else { speed };
        if from.speed + speed <= REST {
            return None; // at rest and staying there: waiting is the action for that
        }
        let time = from.time + 2.0 * ds / (from.speed + speed);
        let free = !self.problem.is_blocked(from.node, from.time, time);
        free.then_some(SpeedState { node: from.node + 1, speed, time })
    }
}

/// In which order a stopping proof expands its states. The theorems hold for any.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ProofOrder {
    /// Least stopping distance first, the safety heuristic `d_safe` of SafeRTS (Cserna et al. 2017): rest comes soon, and
    /// no plan creeps.
    #[default]
    StoppingDistance,
    /// Nearest to the goal, then slowest: the order of the SafeTLP paper. Where rest is allowed at the goal only, it is the
    /// one that gets there; it may crawl on its last metres.
    NearestGoal,
}
