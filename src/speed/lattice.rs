//! The speed lattice that all strategies search: states, actions, duplicate detection and budgets.
//!
//! A state is (node, speed, time). An action crosses one cell with the comfortable acceleration, at constant speed,
//! with the comfortable deceleration or, in phases that allow it, with the aggressive deceleration. At standstill, if
//! the road has moving obstacles, the vehicle can also wait. Two details are not in the paper:
//!
//! - **Clipped deceleration.** If v² < 2dΔs, the vehicle stops inside the cell. The action clips the deceleration so
//!   that the vehicle stops at the next node. Without the clip, most start speeds never reach exactly zero and every
//!   proof fails.
//! - **Lost states** ([`super::lost`]), from which contact is inevitable or no safe standstill can be reached, are pruned when
//!   they leave the open list. They count as expanded.
//!
//! States of one node, speed bin and time bin are duplicates ([`Resolution`]); a key packs the three indices into a
//! `u64`. Without moving obstacles all times share one bin. States, open list and closed list keep their capacity from
//! search to search, so that the inner loop does not allocate in the steady state.

use std::cell::Cell;
use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};

use super::lost::LostStates;
use super::{Resolution, SpeedPlan, SpeedProblem, SpeedState, Statistics, Strategy};

/// The vehicle stands below this speed, m/s: far above rounding errors, far below the slowest speed after an action.
pub(super) const STANDSTILL_SPEED: f64 = 1e-6;
/// Tolerance for rounding errors of distances (m) and squared speeds (m²/s²).
pub(super) const ROUNDING: f64 = 1e-6;
/// A time this close below a bin border belongs to the later bin, in bins: rounding must not decide.
const BIN_TOLERANCE: f64 = 1e-6;

/// Expansion order and available actions of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// Nearest to the last node first, then earliest, then fastest; comfortable actions only.
    Explore,
    /// In [`ProofOrder`]; with the aggressive deceleration.
    Proof,
}

/// A generated state.
pub(super) struct Node {
    pub(super) state: SpeedState,
    pub(super) parent: usize,
    /// Key shared by all duplicates.
    key: u64,
}

/// Parent index of the root.
pub(super) const NO_PARENT: usize = usize::MAX;

/// Working memory of a search. Later searches reuse its capacity.
#[derive(Default)]
struct Memory {
    nodes: Vec<Node>,
    /// Lists of the running search.
    active: SearchLists,
    /// Lists of the suspended search ([`Lattice::swap_searches`]).
    suspended: SearchLists,
}

/// Open and closed list of a search.
#[derive(Default)]
struct SearchLists {
    open: BinaryHeap<Open>,
    closed: Closed,
}

impl SearchLists {
    fn clear(&mut self) {
        self.open.clear();
        self.closed.clear();
    }

    /// Bytes for a number of open and of closed states.
    fn bytes(open: usize, closed: usize) -> usize {
        open * size_of::<Open>() + hash_table_bytes::<u64>(closed)
    }
}

/// Bytes of a hash table with a number of entries: one control byte per slot and a load factor of 7/8.
pub(super) fn hash_table_bytes<T>(entries: usize) -> usize {
    entries * (size_of::<T>() + 1) * 8 / 7
}

/// An entry of the open list. The smallest rank is expanded first; ties go to the older node.
#[derive(PartialEq)]
struct Open {
    rank: [f64; 3],
    index: usize,
}

impl Eq for Open {}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        // reversed, because BinaryHeap pops its largest element
        let by_rank = (0..3).map(|i| other.rank[i].total_cmp(&self.rank[i])).find(|o| o.is_ne());
        by_rank.unwrap_or_else(|| other.index.cmp(&self.index))
    }
}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Multiplicative hashing of a `u64` key (Knuth, TAOCP 3, §6.4). The keys are packed indices and need no protection
/// against hostile input.
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

/// The lattice of one problem, with the state of one search.
pub(super) struct Lattice<'a> {
    pub(super) problem: &'a SpeedProblem,
    pub(super) resolution: Resolution,
    time_matters: bool,
    /// States in which a contact is inevitable, and those without a safe standstill, if the strategy asks for one.
    to_contact: LostStates<'a>,
    to_rest: Option<LostStates<'a>>,
    memory: Memory,
    pub(super) statistics: Statistics,
    /// The budget that ended a search, if one did.
    pub(super) exhausted: Option<Budget>,
}

/// A budget of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Budget {
    /// [`Resolution::expansions`].
    Expansions,
    /// [`Resolution::memory`].
    Memory,
}

/// Runs a search on a lattice. The thread keeps the working memory for its next search: a planning cycle runs dozens,
/// each with up to a megabyte of nodes.
pub(super) fn with<T>(
    problem: &SpeedProblem,
    strategy: Strategy,
    resolution: &Resolution,
    search: impl FnOnce(&mut Lattice<'_>) -> T,
) -> (T, Statistics, Option<Budget>) {
    thread_local! {
        static MEMORY: Cell<Memory> = Cell::default();
    }
    MEMORY.with(|kept| {
        let mut lattice = Lattice::new(problem, strategy, *resolution, kept.take());
        let found = search(&mut lattice);
        lattice.clear_closed();
        lattice.swap_searches();
        lattice.clear_closed();
        let Lattice { memory, statistics, exhausted, .. } = lattice;
        // releases the memory of a rare large search
        if memory.bytes() <= MAX_KEPT_BYTES {
            kept.set(memory);
        }
        (found, statistics, exhausted)
    })
}

/// Maximum working memory that a thread keeps between searches, bytes.
const MAX_KEPT_BYTES: usize = 16 << 20;

impl Memory {
    /// Reserved bytes.
    fn bytes(&self) -> usize {
        let lists = [&self.active, &self.suspended].map(|f| SearchLists::bytes(f.open.capacity(), f.closed.capacity()));
        self.nodes.capacity() * size_of::<Node>() + lists.iter().sum::<usize>()
    }

    /// Bytes in use, independent of the capacity that earlier searches left.
    fn bytes_in_use(&self) -> usize {
        let lists = [&self.active, &self.suspended].map(|f| SearchLists::bytes(f.open.len(), f.closed.len()));
        self.nodes.len() * size_of::<Node>() + lists.iter().sum::<usize>()
    }
}

impl<'a> Lattice<'a> {
    fn new(problem: &'a SpeedProblem, strategy: Strategy, resolution: Resolution, mut memory: Memory) -> Self {
        memory.nodes.clear();
        memory.active.clear();
        memory.suspended.clear();
        let time_matters = problem.time_matters() || resolution.always_timed;
        let to_contact = LostStates::to_contact(problem);
        let to_rest = (strategy != Strategy::Naive).then(|| LostStates::to_rest(problem));
        let statistics = Statistics::default();
        let mut lattice =
            Self { problem, resolution, time_matters, to_contact, to_rest, memory, statistics, exhausted: None };
        let root = SpeedState { node: 0, speed: problem.start_speed, time: problem.start_time };
        let key = lattice.key(&root);
        lattice.memory.nodes.push(Node { state: root, parent: NO_PARENT, key });
        lattice
    }

    /// The state of a node index; the root has index 0.
    pub(super) fn state(&self, index: usize) -> SpeedState {
        self.memory.nodes[index].state
    }

    /// The parent of a node index; [`NO_PARENT`] for the root.
    pub(super) fn parent(&self, index: usize) -> usize {
        self.memory.nodes[index].parent
    }

    /// Whether the state is safe ([`SpeedProblem::is_safe_standstill`]).
    pub(super) fn is_safe(&self, index: usize) -> bool {
        let state = self.state(index);
        state.speed <= STANDSTILL_SPEED && self.problem.is_safe_standstill(state.node, state.time)
    }

    /// Starts a search: `from` becomes the only open state.
    pub(super) fn begin(&mut self, from: usize, phase: Phase) {
        self.memory.active.open.clear();
        let rank = self.rank(&self.memory.nodes[from].state, phase);
        self.memory.active.open.push(Open { rank, index: from });
    }

    /// Clears the closed list of the running search.
    pub(super) fn clear_closed(&mut self) {
        self.statistics.closed += self.memory.active.closed.len();
        self.memory.active.closed.clear();
    }

    /// Suspends the running search and resumes the suspended one.
    pub(super) fn swap_searches(&mut self) {
        let Memory { active, suspended, .. } = &mut self.memory;
        std::mem::swap(active, suspended);
    }

    /// Pops and closes the best open state that is neither closed nor lost. Lost states count as expanded, because the test takes about
    /// as long as an expansion.
    pub(super) fn next(&mut self, phase: Phase, budget: &mut usize) -> Option<usize> {
        while let Some(Open { index, .. }) = self.memory.active.open.pop() {
            let Node { state, key, .. } = &self.memory.nodes[index];
            if !self.memory.active.closed.insert(*key) {
                continue;
            }
            if !self.is_lost(state, phase) {
                return Some(index);
            }
            if !self.charge(budget) {
                break;
            }
        }
        None
    }

    /// Whether a state is lost: without a safe standstill, for which the vehicle may brake hard, or in front of a contact with the
    /// actions of the phase.
    fn is_lost(&self, state: &SpeedState, phase: Phase) -> bool {
        let hardest = self.problem.limits.aggressive_deceleration;
        self.to_rest.as_ref().is_some_and(|lost| lost.contains(state, hardest))
            || ((phase == Phase::Explore || self.to_rest.is_none())
                && self.to_contact.contains(state, self.hardest_braking(phase)))
    }

    /// Maximum deceleration of a phase, m/s².
    pub(super) fn hardest_braking(&self, phase: Phase) -> f64 {
        let limits = &self.problem.limits;
        if phase == Phase::Explore { limits.deceleration } else { limits.aggressive_deceleration }
    }

    /// Charges one expansion to the budgets. Returns `false` if a budget is exhausted.
    pub(super) fn charge(&mut self, budget: &mut usize) -> bool {
        let bytes = self.memory.bytes_in_use();
        self.charge_with(budget, bytes)
    }

    /// [`Self::charge`] for a search with its own working memory of `bytes` bytes.
    pub(super) fn charge_with(&mut self, budget: &mut usize, bytes: usize) -> bool {
        if *budget == 0 {
            self.exhausted = Some(Budget::Expansions);
            return false;
        }
        if bytes > self.resolution.memory {
            self.exhausted = Some(Budget::Memory);
            return false;
        }
        self.statistics.bytes = self.statistics.bytes.max(bytes);
        *budget -= 1;
        self.statistics.expansions += 1;
        true
    }

    /// Whether the aggressive deceleration stops the vehicle before the last node.
    pub(super) fn can_stop_from(&self, state: &SpeedState) -> bool {
        let available = self.problem.end() - self.problem.stations[state.node];
        state.speed * state.speed <= 2.0 * self.problem.limits.aggressive_deceleration * available + ROUNDING
    }

    /// Adds the successors of a node to the open list.
    pub(super) fn expand(&mut self, index: usize, phase: Phase) {
        let from = self.memory.nodes[index].state;
        let actions =
            Actions { problem: self.problem, wait: self.waiting_time(), braking: self.hardest_braking(phase) };
        actions.successors(&from, |to| self.push(to, index, phase));
    }

    /// Duration of the waiting action, s. `None` if time does not matter.
    pub(super) fn waiting_time(&self) -> Option<f64> {
        self.time_matters.then_some(self.resolution.wait)
    }

    fn push(&mut self, state: SpeedState, parent: usize, phase: Phase) {
        let key = self.key(&state);
        if self.memory.active.closed.contains(&key) {
            return;
        }
        let index = self.memory.nodes.len();
        self.memory.nodes.push(Node { state, parent, key });
        self.memory.active.open.push(Open { rank: self.rank(&state, phase), index });
    }

    fn rank(&self, s: &SpeedState, phase: Phase) -> [f64; 3] {
        let distance_to_goal = -(s.node as f64);
        match (phase, self.resolution.proof_order) {
            (Phase::Explore, _) => [distance_to_goal, s.time, -s.speed],
            (Phase::Proof, ProofOrder::StoppingDistance) => [s.speed, s.time, distance_to_goal],
            (Phase::Proof, ProofOrder::NearestGoal) => [distance_to_goal, s.speed, s.time],
        }
    }

    /// Packs node, speed bin and time bin into 16 + 24 + 24 bits. The last bin includes all larger values.
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
            ((s.time - self.problem.start_time) / self.resolution.time + BIN_TOLERANCE).floor() as usize
        } else {
            0
        };
        (speed, time)
    }

    /// The plan that ends at the node `end`. Its stopping proof begins at the node `proof_root`.
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

/// The actions available to a search.
pub(super) struct Actions<'a> {
    pub(super) problem: &'a SpeedProblem,
    /// Duration of the waiting action at standstill, s. `None` if time does not matter.
    pub(super) wait: Option<f64>,
    /// Maximum deceleration, m/s².
    pub(super) braking: f64,
}

impl Actions<'_> {
    /// Visits the collision-free successors in a fixed order: wait, accelerate, keep speed, decelerate, brake hard.
    pub(super) fn successors(&self, from: &SpeedState, mut visit: impl FnMut(SpeedState)) {
        let p = self.problem;
        if from.speed <= STANDSTILL_SPEED {
            self.wait(from).into_iter().for_each(&mut visit);
        }
        if from.node >= p.cells() {
            return;
        }
        let ds = p.stations[from.node + 1] - p.stations[from.node];
        let (v2, speed_limit) = (from.speed * from.speed, p.speed_limits[from.node + 1]);
        let limits = &p.limits;
        // a start above the speed limit is valid while the vehicle brakes as hard as the phase allows
        let lowest = (v2 - 2.0 * self.braking * ds).max(0.0).sqrt();
        let is_admissible = |v: f64| v <= speed_limit.max(lowest);
        let mut cross = |speed: f64| self.cross(from, ds, speed).into_iter().for_each(&mut visit);

        let faster = (v2 + 2.0 * limits.acceleration * ds).sqrt().min(speed_limit);
        if faster > from.speed {
            cross(faster);
        }
        let constant = from.speed.min(speed_limit).max(lowest);
        if constant > STANDSTILL_SPEED && is_admissible(constant) {
            cross(constant);
        }
        for deceleration in [limits.deceleration, limits.aggressive_deceleration] {
            if deceleration > self.braking || from.speed <= STANDSTILL_SPEED {
                continue;
            }
            // clipped: for v² < 2dΔs the vehicle stops at the next node
            let slower = (v2 - 2.0 * deceleration * ds).max(0.0).sqrt();
            if (slower < constant || constant <= STANDSTILL_SPEED) && is_admissible(slower) {
                cross(slower);
            }
        }
    }

    /// Waits at standstill, if the pose stays free for the waiting time.
    fn wait(&self, from: &SpeedState) -> Option<SpeedState> {
        let time = from.time + self.wait?;
        let free = time <= self.problem.horizon && !self.problem.is_standstill_blocked(from.node, from.time, time);
        free.then_some(SpeedState { time, ..*from })
    }

    /// Crosses the next cell, of length `ds` (m), to reach `speed` (m/s) at its far node, if the cell is free
    /// meanwhile.
    fn cross(&self, from: &SpeedState, ds: f64, speed: f64) -> Option<SpeedState> {
        let speed = if speed <= STANDSTILL_SPEED { 0.0 } else { speed };
        if from.speed + speed <= STANDSTILL_SPEED {
            return None; // a stopped vehicle stays in place by waiting
        }
        let time = from.time + 2.0 * ds / (from.speed + speed);
        let free = !self.problem.is_blocked(from.node, from.time, time);
        free.then_some(SpeedState { node: from.node + 1, speed, time })
    }
}

/// Expansion order of a stopping proof. Theorems 1 and 2 hold for any order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ProofOrder {
    /// Least stopping distance first: the safety heuristic `d_safe` of SafeRTS (Cserna et al. 2017). Proofs stop early
    /// and rarely creep.
    #[default]
    StoppingDistance,
    /// Nearest to the goal first, then slowest: the order of the SafeTLP paper. It suits problems that allow stopping
    /// at the goal only. Proofs may creep over their last metres.
    NearestGoal,
}
