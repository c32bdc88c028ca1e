//! SafeTLP, Algorithm 1 of the paper, over (station, speed, time).
//!
//! 1. A naive best-first search runs to a partial goal (the last station at any speed) with the comfortable actions.
//! 2. From its last state backwards, stopping proofs are searched, which may also use the aggressive deceleration.
//!    States from which even that cannot stop before the end are skipped. All proofs share one closed list, so that no
//!    state is expanded by two of them.
//! 3. If every proof fails, an exhaustive search from the root decides.
//!
//! Where the naive search cannot reach the end (something stands or waits there), its deepest state takes the place of
//! the partial goal. The paper orders proofs by distance to the goal; ours go by least stopping distance first, which is
//! the safety heuristic `d_safe` of SafeRTS and does not creep. Theorems 1 and 2 hold for any order.

use std::cell::Cell;
use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};

use super::outlook::Outlook;
use super::{Resolution, SpeedProblem};

/// A state of the speed lattice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedState {
    /// Node index.
    pub node: usize,
    /// Speed, m/s.
    pub speed: f64,
    /// Time, s of the run.
    pub time: f64,
}

/// A plan that ends at rest in a safe state.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedPlan {
    /// States from the root to the safe state. Two in a row at the same node mean waiting at rest.
    pub states: Vec<SpeedState>,
    /// Index of the state where the nominal prefix ends and the stopping proof begins.
    pub proof_starts: usize,
    /// Stopping proofs attempted.
    pub proofs_tried: usize,
    /// States expanded in all phases.
    pub expansions: usize,
}

impl SpeedPlan {
    /// Ends the plan at the first safe rest that it would wait at for `wait` seconds or more. A prefix that ends at a safe
    /// rest is a proven plan as well.
    pub fn end_at_long_wait(&mut self, problem: &SpeedProblem, wait: f64) {
        let leaves = |i: usize| {
            let node = self.states[i].node;
            self.states[i..].iter().take_while(|s| s.node == node).last().map_or(0.0, |s| s.time)
        };
        let end = (0..self.states.len()).find(|&i| {
            let s = &self.states[i];
            s.speed <= REST && leaves(i) - s.time >= wait && problem.is_safe_rest(s.node, s.time)
        });
        if let Some(end) = end {
            self.states.truncate(end + 1);
            self.proof_starts = self.proof_starts.min(end);
        }
    }
}

/// What the search found. Finding nothing is a result, not an error.
#[derive(Debug, Clone, PartialEq)]
pub enum SpeedOutcome {
    /// A plan with its stop proven.
    Proven(SpeedPlan),
    /// No state of the searched lattice is safe.
    NoSafePlan {
        /// States expanded in all phases.
        expansions: usize,
        /// Whether an expansion budget ended a search, so that a plan may exist all the same.
        budget_spent: bool,
    },
}

/// Searches for the fastest-going plan whose stop is proven.
///
/// The problem's vectors must fit together: `blocked` one shorter than `stations`, `caps` and `rest_allowed` as long.
#[must_use]
pub fn plan(problem: &SpeedProblem, resolution: &Resolution) -> SpeedOutcome {
    thread_local! {
        /// Kept from search to search: a cycle makes dozens, each with up to a megabyte of nodes.
        static MEMORY: Cell<Memory> = Cell::default();
    }
    MEMORY.with(|memory| {
        let mut search = Search::new(problem, *resolution, memory.take());
        let outcome = search.run();
        memory.set(search.memory);
        outcome
    })
}

/// A time within this of a bin's border lies in the later bin, in bins: rounding must not decide.
const ON_GRID: f64 = 1e-6;

/// Speeds below this are rest (m/s): a rounding guard, far below the slowest speed an edge can produce.
const REST: f64 = 1e-6;

struct Node {
    state: SpeedState,
    parent: usize,
    /// Of its duplicates.
    key: u64,
}

/// What a search writes to. Its contents do not outlive the search, its capacity does.
#[derive(Default)]
struct Memory {
    nodes: Vec<Node>,
    open: BinaryHeap<Open>,
    closed: Closed,
}

const NO_PARENT: usize = usize::MAX;

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
struct KeyHasher(u64);

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

struct Search<'a> {
    problem: &'a SpeedProblem,
    resolution: Resolution,
    time_matters: bool,
    outlook: Outlook<'a>,
    memory: Memory,
    expansions: usize,
    budget_spent: bool,
}

/// How a phase orders its open list.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Nearest to the goal, then earliest, then fastest; comfortable actions.
    Naive,
    /// Least stopping distance; the aggressive deceleration too.
    Proof,
}

impl<'a> Search<'a> {
    fn new(problem: &'a SpeedProblem, resolution: Resolution, mut memory: Memory) -> Self {
        memory.nodes.clear();
        let time_matters = problem.time_matters();
        let outlook = Outlook::new(problem);
        Self { problem, resolution, time_matters, outlook, memory, expansions: 0, budget_spent: false }
    }

    fn run(&mut self) -> SpeedOutcome {
        let p = self.problem;
        let root = SpeedState { node: 0, speed: p.start_speed, time: p.start_time };
        let key = self.key(&root);
        self.memory.nodes.push(Node { state: root, parent: NO_PARENT, key });

        // line 1: a potentially unsafe trajectory to a partial goal
        let last = self.naive_search();
        // lines 2–9: proofs from its last state backwards, one closed list for all of them
        self.memory.closed.clear();
        let mut proofs_tried = 0;
        let mut budget = self.resolution.expansions;
        let mut current = last;
        while current != NO_PARENT {
            if self.can_stop_from(&self.memory.nodes[current].state) {
                proofs_tried += 1;
                if let Some(safe) = self.prove_stop(current, &mut budget) {
                    return self.proven(safe, current, proofs_tried);
                }
            }
            current = self.memory.nodes[current].parent;
        }
        // line 10: exhaustive search from the root
        let mut budget = self.resolution.expansions;
        self.memory.closed.clear();
        match self.prove_stop(0, &mut budget) {
            Some(safe) => self.proven(safe, 0, proofs_tried),
            None => SpeedOutcome::NoSafePlan { expansions: self.expansions, budget_spent: self.budget_spent },
        }
    }

    /// Best-first search to the last station; the state that got nearest if none gets there.
    fn naive_search(&mut self) -> usize {
        let mut budget = self.resolution.expansions;
        let mut deepest = 0;
        self.begin(0, Phase::Naive);
        self.memory.closed.clear();
        while let Some(index) = self.next(Phase::Naive, &mut budget) {
            let node = self.memory.nodes[index].state.node;
            if node > self.memory.nodes[deepest].state.node {
                deepest = index;
            }
            if node == self.problem.cells() {
                return index;
            }
            if !self.charge(&mut budget) {
                break;
            }
            self.expand(index, Phase::Naive);
        }
        deepest
    }

    /// Best-first search for a safe state below `from`.
    fn prove_stop(&mut self, from: usize, budget: &mut usize) -> Option<usize> {
        self.begin(from, Phase::Proof);
        while let Some(index) = self.next(Phase::Proof, budget) {
            let state = self.memory.nodes[index].state;
            if state.speed <= REST && self.problem.is_safe_rest(state.node, state.time) {
                return Some(index);
            }
            if !self.charge(budget) {
                return None;
            }
            self.expand(index, Phase::Proof);
        }
        None
    }

    /// Makes `from` the only open state.
    fn begin(&mut self, from: usize, phase: Phase) {
        self.memory.open.clear();
        let rank = rank(&self.memory.nodes[from].state, phase);
        self.memory.open.push(Open { rank, index: from });
    }

    /// Takes the best open state that is neither closed nor lost, and closes it. Lost states count as expanded: to see
    /// that they are takes about as long.
    fn next(&mut self, phase: Phase, budget: &mut usize) -> Option<usize> {
        let braking = self.strongest(phase);
        while let Some(Open { index, .. }) = self.memory.open.pop() {
            let Node { state, key, .. } = &self.memory.nodes[index];
            if !self.memory.closed.insert(*key) {
                continue;
            }
            if !self.outlook.is_lost(state, braking) {
                return Some(index);
            }
            if !self.charge(budget) {
                break;
            }
        }
        None
    }

    /// Hardest braking of a phase, m/s².
    fn strongest(&self, phase: Phase) -> f64 {
        let limits = &self.problem.limits;
        if phase == Phase::Naive { limits.deceleration } else { limits.aggressive_deceleration }
    }

    fn charge(&mut self, budget: &mut usize) -> bool {
        if *budget == 0 {
            self.budget_spent = true;
            return false;
        }
        *budget -= 1;
        self.expansions += 1;
        true
    }

    /// Whether the aggressive deceleration stops the vehicle before the last node.
    fn can_stop_from(&self, state: &SpeedState) -> bool {
        let room = self.problem.end() - self.problem.stations[state.node];
        state.speed * state.speed <= 2.0 * self.problem.limits.aggressive_deceleration * room + REST
    }

    fn expand(&mut self, index: usize, phase: Phase) {
        let from = self.memory.nodes[index].state;
        let p = self.problem;
        if from.speed <= REST && self.time_matters {
            self.wait(index, phase);
        }
        if from.node >= p.cells() {
            return;
        }
        let ds = p.stations[from.node + 1] - p.stations[from.node];
        let (v2, cap) = (from.speed * from.speed, p.caps[from.node + 1]);
        let limits = &p.limits;
        let strongest = self.strongest(phase);
        // A start above the cap may stay above it while it brakes as hard as this phase allows.
        let lowest = (v2 - 2.0 * strongest * ds).max(0.0).sqrt();
        let admissible = |v: f64| v <= cap.max(lowest);
        let push = |this: &mut Self, speed: f64| this.push_edge(index, ds, speed, phase);

        let faster = (v2 + 2.0 * limits.acceleration * ds).sqrt().min(cap);
        if faster > from.speed {
            push(self, faster);
        }
        let held = from.speed.min(cap).max(lowest);
        if held > REST && admissible(held) {
            push(self, held);
        }
        for deceleration in [limits.deceleration, limits.aggressive_deceleration] {
            if deceleration > strongest || from.speed <= REST {
                continue;
            }
            // v² < 2dΔs stops inside the cell: the deceleration is clipped so that rest falls on the next node
            let slower = (v2 - 2.0 * deceleration * ds).max(0.0).sqrt();
            if (slower < held || held <= REST) && admissible(slower) {
                push(self, slower);
            }
        }
    }

    /// Waiting at rest: allowed where the pose stays free for the waiting time.
    fn wait(&mut self, index: usize, phase: Phase) {
        let from = self.memory.nodes[index].state;
        let time = from.time + self.resolution.wait;
        if time <= self.problem.horizon && !self.problem.is_rest_blocked(from.node, from.time, time) {
            self.push(SpeedState { time, ..from }, index, phase);
        }
    }

    fn push_edge(&mut self, parent: usize, ds: f64, speed: f64, phase: Phase) {
        let from = self.memory.nodes[parent].state;
        let speed = if speed <= REST { 0.0 } else { speed };
        if from.speed + speed <= REST {
            return; // at rest and staying there: waiting is the action for that
        }
        let time = from.time + 2.0 * ds / (from.speed + speed);
        if !self.problem.is_blocked(from.node, from.time, time) {
            self.push(SpeedState { node: from.node + 1, speed, time }, parent, phase);
        }
    }

    fn push(&mut self, state: SpeedState, parent: usize, phase: Phase) {
        let key = self.key(&state);
        if self.memory.closed.contains(&key) {
            return;
        }
        let index = self.memory.nodes.len();
        self.memory.nodes.push(Node { state, parent, key });
        self.memory.open.push(Open { rank: rank(&state, phase), index });
    }

    /// Packs station, speed bin and time bin: 16 + 24 + 24 bits.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // bins of bounded, non-negative quantities
    fn key(&self, s: &SpeedState) -> u64 {
        let speed = (s.speed / self.resolution.speed).round() as u64;
        let time = if self.time_matters {
            ((s.time - self.problem.start_time) / self.resolution.time + ON_GRID).floor() as u64
        } else {
            0
        };
        ((s.node as u64) << 48) | ((speed & 0xFF_FFFF) << 24) | (time & 0xFF_FFFF)
    }

    fn proven(&self, safe: usize, proof_root: usize, proofs_tried: usize) -> SpeedOutcome {
        let mut states = Vec::new();
        let mut proof_starts = 0;
        let mut index = safe;
        while index != NO_PARENT {
            if index == proof_root {
                proof_starts = states.len();
            }
            states.push(self.memory.nodes[index].state);
            index = self.memory.nodes[index].parent;
        }
        proof_starts = states.len() - 1 - proof_starts;
        states.reverse();
        SpeedOutcome::Proven(SpeedPlan { states, proof_starts, proofs_tried, expansions: self.expansions })
    }
}

fn rank(s: &SpeedState, phase: Phase) -> [f64; 3] {
    match phase {
        Phase::Naive => [-(s.node as f64), s.time, -s.speed],
        Phase::Proof => [s.speed, s.time, -(s.node as f64)],
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::super::{prove, smoothing};
    use super::*;
    use proptest::prelude::*;

    /// So fine that only equal states are duplicates.
    const EXACT: Resolution = Resolution { speed: 1e-6, time: 1e-6, wait: 0.5, expansions: 200_000 };

    fn proven(problem: &SpeedProblem) -> SpeedPlan {
        match plan(problem, &Resolution::default()) {
            SpeedOutcome::Proven(plan) => plan,
            SpeedOutcome::NoSafePlan { .. } => panic!("no plan for {problem:?}"),
        }
    }

    #[test]
    fn the_papers_road_is_driven_fast_and_ends_at_rest() {
        for tenth in (0..=50).step_by(2) {
            let problem = empty_road(100.0, f64::from(tenth) / 10.0);
            let plan = proven(&problem);
            let last = plan.states.last().unwrap();
            assert_eq!(last.speed, 0.0);
            assert!(problem.stations[last.node] > 99.0, "stops short at {}", problem.stations[last.node]);
            assert!(plan.expansions < 1000, "{} expansions", plan.expansions);
            let profile = smoothing::unsmoothed(&problem, &plan).unwrap();
            assert_eq!(prove(&problem, &profile), Ok(()));
        }
    }

    #[test]
    fn a_slow_start_stops_inside_one_step_by_the_clipped_deceleration() {
        // v² = 0.09 is far below 2dΔs = 1.5: without the clip rest would be missed
        let problem = empty_road(1.0, 0.3);
        assert_eq!(proven(&problem).states.last().unwrap().speed, 0.0);
    }

    #[test]
    fn too_fast_to_stop_on_the_road_is_an_outcome() {
        // 10 m/s needs 22.7 m at 2.2 m/s²
        assert!(matches!(plan(&empty_road(22.5, 10.0), &Resolution::default()), SpeedOutcome::NoSafePlan { .. }));
        assert!(matches!(plan(&empty_road(23.0, 10.0), &Resolution::default()), SpeedOutcome::Proven(_)));
    }

    #[test]
    fn a_crossing_that_opens_later_is_waited_for_or_reached_late() {
        let mut problem = empty_road(40.0, 5.0);
        for cell in 30..36 {
            problem.blocked[cell] = vec![(0.0, 8.0)];
        }
        let plan = proven(&problem);
        let last = plan.states.last().unwrap();
        assert!(problem.stations[last.node] > 39.0, "never crossed: {last:?}");
        let enters = plan.states.iter().find(|s| s.node == 31).unwrap();
        assert!(enters.time > 8.0, "entered at {}", enters.time);
    }

    #[test]
    fn a_plan_cut_at_a_long_wait_is_still_proven() {
        let mut problem = empty_road(40.0, 5.0);
        for cell in 30..36 {
            problem.blocked[cell] = vec![(0.0, 20.0)];
        }
        let mut cut = proven(&problem);
        let whole = cut.states.len();
        cut.end_at_long_wait(&problem, 2.0);
        assert!(cut.states.len() < whole, "no long wait in {:?}", cut.states);
        assert_eq!(cut.states.last().unwrap().speed, 0.0);
        assert_eq!(prove(&problem, &smoothing::unsmoothed(&problem, &cut).unwrap()), Ok(()));
    }

    #[test]
    fn rest_inside_a_junction_is_no_proof() {
        let mut problem = empty_road(30.0, 5.0);
        for node in 20..=60 {
            problem.rest_allowed[node] = false;
        }
        let plan = proven(&problem);
        assert!(plan.states.last().unwrap().node < 20);
    }

    #[test]
    fn a_rear_vehicle_that_sweeps_the_road_leaves_no_safe_rest_before_it_has_passed() {
        // everything is swept at 6 m/s from behind, 1 s behind the start: only driving on ahead of it is safe
        let mut problem = empty_road(60.0, 6.0);
        problem.horizon = 8.0;
        for cell in 0..problem.cells() {
            let t = problem.stations[cell] / 6.0 + 1.0;
            problem.blocked[cell] = vec![(t, t + 0.6)];
        }
        let plan = proven(&problem);
        let last = plan.states.last().unwrap();
        assert!(last.time + 1e-9 >= 8.0 || problem.stations[last.node] > 42.0, "rests in the way at {last:?}");
    }

    /// Depth-first enumeration of everything reachable, without any closed list: slow and plain.
    fn safe_state_exists(problem: &SpeedProblem, s: SpeedState) -> bool {
        if s.speed <= REST {
            if problem.is_safe_rest(s.node, s.time) {
                return true;
            }
            let later = SpeedState { time: s.time + EXACT.wait, ..s };
            if problem.time_matters()
                && later.time <= problem.horizon
                && !problem.is_rest_blocked(s.node, s.time, later.time)
                && safe_state_exists(problem, later)
            {
                return true;
            }
        }
        if s.node >= problem.cells() {
            return false;
        }
        let ds = problem.stations[s.node + 1] - problem.stations[s.node];
        let l = &problem.limits;
        [l.acceleration, 0.0, -l.deceleration, -l.aggressive_deceleration].iter().any(|a| {
            let v = (s.speed * s.speed + 2.0 * a * ds).max(0.0).sqrt().min(problem.caps[s.node + 1]);
            if s.speed + v <= REST {
                return false;
            }
            let time = s.time + 2.0 * ds / (s.speed + v);
            !problem.is_blocked(s.node, s.time, time)
                && safe_state_exists(problem, SpeedState { node: s.node + 1, speed: v, time })
        })
    }

    fn small_problem() -> impl Strategy<Value = SpeedProblem> {
        let block = (0..6usize, 0.0..6.0f64, 0.1..3.0f64);
        (0.0..4.0f64, prop::collection::vec(block, 0..4), prop::collection::vec(any::<bool>(), 7)).prop_map(
            |(speed, blocks, rest)| {
                let mut p = empty_road(3.0, speed);
                p.horizon = 8.0;
                p.rest_allowed = rest;
                for (cell, from, length) in blocks {
                    if p.blocked[cell].is_empty() {
                        p.blocked[cell] = vec![(from, from + length)];
                    }
                }
                p
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// Theorem 1 and its converse, against plain enumeration.
        #[test]
        fn a_safe_plan_is_found_exactly_when_one_exists(problem in small_problem()) {
            let root = SpeedState { node: 0, speed: problem.start_speed, time: 0.0 };
            let found = matches!(plan(&problem, &EXACT), SpeedOutcome::Proven(_));
            prop_assert_eq!(found, safe_state_exists(&problem, root));
        }

        /// Every plan returned is checked again by other code.
        #[test]
        fn no_plan_touches_a_blocked_interval(problem in small_problem()) {
            if let SpeedOutcome::Proven(found) = plan(&problem, &EXACT) {
                let profile = smoothing::unsmoothed(&problem, &found).unwrap();
                prop_assert_eq!(prove(&problem, &profile), Ok(()));
            }
        }
    }
}
