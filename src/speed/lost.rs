//! Detection of lost states: states from which every sequence of actions enters a blocked cell (*inevitable collision states*,
//! Fraichard and Asama, Advanced Robotics 18, 2004), or none leads to a safe standstill. Without it, the search expands the
//! whole tree below such a state before it fails.
//!
//! # Technique
//!
//! **Entry times, backwards, once for each problem.** For each cell, the times at which a vehicle that drives through it may enter it: in
//! a free interval of the cell, and so early that it leaves the cell before the interval ends. If the search asks for a safe
//! standstill, it must leave the cell at a time at which one can still be reached from the next node: at once, by crossing the
//! next cell, or after a wait. All of these sets are unions of intervals that begin where a free interval begins, so that only
//! their ends have to be computed. A vehicle in a platoon that reaches the end of the road before the platoon has passed is lost at the root.
//!
//! **Entry windows, for each state.** The vehicle enters every cell within its stopping distance. Its entry time lies in a window: the
//! maximum acceleration gives the earliest time, the hardest braking the latest. From cell to cell, the entry times raise the
//! earliest time: the raised time applies to all farther cells, so the vehicle cannot pass an obstacle that drives ahead of it. An
//! empty window proves that the state is lost.
//!
//! The test is conservative: it may miss a lost state, but it never reports a state from which a plan exists. Pruning
//! therefore keeps Theorems 1 and 2 valid. It misses states because it ignores the speed beyond the stopping distance, and that a
//! moving vehicle cannot wait.

use super::lattice::STANDSTILL_SPEED;
use super::{SpeedProblem, SpeedState, TimeInterval};

/// The test examines one in this many cells. Obstacles block many neighbouring cells, so the others add little.
const STRIDE: usize = 4;
/// Tolerance of times, s: far above rounding errors, far below a time bin.
const TIME_SLACK: f64 = 1e-6;
/// All times.
const ALWAYS: TimeInterval = (f64::NEG_INFINITY, f64::INFINITY);

/// The lost states of a problem, as a membership test.
pub(super) struct LostStates<'a> {
    problem: &'a SpeedProblem,
    /// The examined cells that cannot be entered at all times, in order, with the times at which they can.
    cells: Vec<(usize, Vec<TimeInterval>)>,
    /// For each node, the index in `cells` of the first cell that is not behind the node.
    next: Vec<usize>,
    /// For each node, the times at which a vehicle that stands there can reach a safe standstill; empty if none is asked for.
    standing: Vec<Vec<TimeInterval>>,
    /// Highest speed limit, m/s.
    top_speed: f64,
}

impl<'a> LostStates<'a> {
    /// The states in which a contact is inevitable.
    pub(super) fn to_contact(problem: &'a SpeedProblem) -> Self {
        let times = fastest_crossings(problem);
        let all = |(cell, takes): (usize, &f64)| entries(&problem.blocked[cell], &[ALWAYS], *takes);
        let entered = times.iter().enumerate().map(all).collect();
        Self::with(problem, entered, Vec::new())
    }

    /// The states from which no safe standstill can be reached.
    pub(super) fn to_rest(problem: &'a SpeedProblem) -> Self {
        let times = fastest_crossings(problem);
        let mut standing = vec![Vec::new(); problem.stations.len()];
        let mut entered = vec![Vec::new(); problem.cells()];
        for node in (0..=problem.cells()).rev() {
            let blocked = standstill_blocked(problem, node);
            let mut fine = Vec::new();
            if node < problem.cells() {
                entered[node] = entries(&problem.blocked[node], &standing[node + 1], times[node]);
                fine.clone_from(&entered[node]);
            }
            if problem.stopping_allowed[node] {
                let last = blocked.iter().rev().find(|(from, _)| *from <= problem.horizon);
                fine.push((last.map_or(f64::NEG_INFINITY, |(_, to)| *to), f64::INFINITY));
            }
            standing[node] = entries(&blocked, &fine, 0.0);
        }
        Self::with(problem, entered, standing)
    }

    fn with(problem: &'a SpeedProblem, entered: Vec<Vec<TimeInterval>>, standing: Vec<Vec<TimeInterval>>) -> Self {
        let is_examined = |(i, times): &(usize, Vec<TimeInterval>)| i.is_multiple_of(STRIDE) && times[..] != [ALWAYS];
        let cells: Vec<_> = entered.into_iter().enumerate().filter(is_examined).collect();
        let next = (0..=problem.cells()).map(|node| cells.partition_point(|(cell, _)| *cell < node)).collect();
        let top_speed = problem.speed_limits.iter().fold(0.0, |a: f64, b| a.max(*b));
        Self { problem, cells, next, standing, top_speed }
    }

    /// Whether a state is provably lost for a vehicle that brakes with at most `deceleration` (m/s²).
    pub(super) fn contains(&self, state: &SpeedState, deceleration: f64) -> bool {
        if state.speed <= STANDSTILL_SPEED {
            return self.standing.get(state.node).is_some_and(|times| entry(times, state.time) > state.time);
        }
        let p = self.problem;
        let v2 = state.speed * state.speed;
        let stopping_distance = v2 / (2.0 * deceleration);
        let top_speed = self.top_speed.max(state.speed);
        let here = p.stations[state.node];
        // lower bound of the entry time of every cell ahead
        let mut earliest = state.time;
        for (cell, times) in &self.cells[self.next[state.node]..] {
            let distance = p.stations[*cell] - here;
            if distance >= stopping_distance {
                return false;
            }
            let latest = state.time + (state.speed - (v2 - 2.0 * deceleration * distance).sqrt()) / deceleration;
            let max_speed = (v2 + 2.0 * p.limits.acceleration * distance).sqrt();
            let takes = (2.0 * distance / (state.speed + max_speed)).max(distance / top_speed);
            earliest = entry(times, earliest.max(state.time + takes));
            if earliest > latest + TIME_SLACK {
                return true;
            }
        }
        false
    }
}

/// The first of these times that is not before a time; infinite if there is none.
fn entry(times: &[TimeInterval], earliest: f64) -> f64 {
    let first = times.partition_point(|(_, to)| *to + TIME_SLACK < earliest);
    times.get(first).map_or(f64::INFINITY, |(from, _)| from.max(earliest))
}

/// Between blocked intervals: the times from which a vehicle can go on to one of the times `then`, which takes at least a time (s) and ends
/// before the next blocked interval begins.
fn entries(blocked: &[TimeInterval], then: &[TimeInterval], takes: f64) -> Vec<TimeInterval> {
    let begins = std::iter::once(ALWAYS.0).chain(blocked.iter().map(|(_, to)| *to));
    let ends = blocked.iter().map(|(from, _)| *from).chain([ALWAYS.1]);
    let latest = |(begins, ends): (f64, f64)| {
        let reaching = then.iter().filter(|(from, to)| *from <= ends && *to >= begins).map(|(_, to)| to.min(ends));
        let latest = reaching.reduce(f64::max)? - takes;
        (latest >= begins).then_some((begins, latest))
    };
    begins.zip(ends).filter_map(latest).collect()
}

/// The times at which a standstill at a node is blocked: both cells beside it are.
fn standstill_blocked(problem: &SpeedProblem, node: usize) -> Vec<TimeInterval> {
    let behind = if node == 0 { &problem.blocked_at_start } else { &problem.blocked[node - 1] };
    let Some(ahead) = problem.blocked.get(node) else { return behind.clone() };
    let (mut both, mut a, mut b) = (Vec::new(), behind.iter().peekable(), ahead.iter().peekable());
    while let (Some(one), Some(other)) = (a.peek(), b.peek()) {
        let (from, to) = (one.0.max(other.0), one.1.min(other.1));
        if from <= to {
            both.push((from, to));
        }
        if one.1 < other.1 {
            a.next()
        } else {
            b.next()
        };
    }
    both
}

/// For each cell, the least time in which it can be crossed, s: with the largest speeds that the limits and the acceleration from the start
/// allow. A start above the limits may brake as gently as comfort asks for.
fn fastest_crossings(problem: &SpeedProblem) -> Vec<f64> {
    let mut speed = problem.start_speed;
    let cell = |i: usize| {
        let length = problem.stations[i + 1] - problem.stations[i];
        let v2 = speed * speed;
        let faster = (v2 + 2.0 * problem.limits.acceleration * length).sqrt();
        let slower = (v2 - 2.0 * problem.limits.deceleration * length).max(0.0).sqrt();
        let next = problem.speed_limits[i + 1].max(slower).min(faster);
        let takes = 2.0 * length / (speed + next);
        speed = next;
        takes
    };
    (0..problem.cells()).map(cell).collect()
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::super::{Resolution, Strategy, search};
    use super::*;
    use proptest::prelude::*;

    /// A lead vehicle at `lead_speed` (m/s), its rear `gap` (m) ahead. It blocks 9 m, the lengths of both vehicles.
    fn following(speed: f64, gap: f64, lead_speed: f64) -> SpeedProblem {
        let mut p = empty_road(100.0, speed);
        for cell in 0..p.cells() {
            let at = p.stations[cell];
            let (front, rear) = ((at - gap - 9.0) / lead_speed, (at - gap) / lead_speed);
            if rear > 0.0 {
                p.blocked[cell] = vec![(front.max(0.0), rear)];
            }
        }
        p
    }

    fn start(problem: &SpeedProblem) -> SpeedState {
        SpeedState { node: 0, speed: problem.start_speed, time: 0.0 }
    }

    #[test]
    fn braking_to_the_speed_of_the_lead_vehicle_decides() {
        // closing at 6 m/s, the vehicle needs 12 m at 1.5 m/s²
        let too_close = following(12.0, 11.0, 6.0);
        assert!(LostStates::to_contact(&too_close).contains(&start(&too_close), 1.5));
        let far_enough = following(12.0, 13.0, 6.0);
        assert!(!LostStates::to_contact(&far_enough).contains(&start(&far_enough), 1.5));
        assert!(
            !LostStates::to_contact(&too_close).contains(&start(&too_close), 2.2),
            "braking with 2.2 m/s² avoids the collision"
        );
    }

    #[test]
    fn neither_a_standstill_nor_a_free_road_is_inevitable() {
        let p = following(0.0, 1.0, 0.5);
        assert!(!LostStates::to_contact(&p).contains(&start(&p), 1.5));
        let free = empty_road(10.0, 15.0);
        assert!(!LostStates::to_contact(&free).contains(&start(&free), 1.5));
    }

    /// Between a leader 1 s ahead and a follower 1 s behind, both at 6 m/s, which pass the end of the road after 7.7 s. Where the predictions
    /// end before that, a stop is safe; if not, no standstill is, and the search ends where it begins.
    #[test]
    fn a_vehicle_in_a_platoon_that_leaves_the_road_is_lost_at_once() {
        let platoon = |horizon: f64| {
            let mut p = empty_road(40.0, 6.0);
            p.horizon = horizon;
            p.limits.acceleration = 0.5;
            for cell in 0..p.cells() {
                let passes = p.stations[cell] / 6.0;
                p.blocked[cell] = vec![(passes - 2.5, passes - 1.0), (passes + 1.0, passes + 2.5)];
            }
            p
        };
        let search = |horizon: f64| search(&platoon(horizon), Strategy::SafeTlp, &Resolution::default()).unwrap();
        let lost = search(20.0);
        assert_eq!(lost.code(), "no_safe_state");
        assert!(lost.statistics().expansions <= 3, "{:?}", lost.statistics());
        assert_eq!(search(5.0).code(), "proven");
        let problem = platoon(20.0);
        assert!(!LostStates::to_contact(&problem).contains(&start(&problem), 2.2), "it only has to drive on");
    }

    /// Standing where a follower arrives, with a free road ahead up to a place without stopping: lost from the time on at which that place
    /// cannot be left behind any more.
    #[test]
    fn a_standing_vehicle_is_lost_once_it_cannot_leave_in_time() {
        let mut p = empty_road(10.0, 0.0);
        p.horizon = 60.0;
        // everything but the last node is passed at 20 s
        for cell in 0..p.cells() - 1 {
            p.blocked[cell] = vec![(20.0, 21.0)];
        }
        p.blocked_at_start = vec![(20.0, 21.0)];
        // 10 m with 1.5 m/s² take 3.65 s
        let lost = LostStates::to_rest(&p);
        let standing = |time: f64| SpeedState { node: 0, speed: 0.0, time };
        assert!(!lost.contains(&standing(16.3), 2.2), "it can leave");
        assert!(lost.contains(&standing(16.6), 2.2), "it cannot");
        assert!(!lost.contains(&standing(21.5), 2.2), "it has been passed");
    }

    /// Whether some sequence of actions reaches a standstill or the last node without entering a blocked cell.
    fn can_avoid(p: &SpeedProblem, s: SpeedState, deceleration: f64) -> bool {
        if s.node == p.cells() || s.speed <= 0.0 {
            return true;
        }
        let ds = p.stations[s.node + 1] - p.stations[s.node];
        [p.limits.acceleration, 0.0, -deceleration].iter().any(|a| {
            let speed = (s.speed * s.speed + 2.0 * a * ds).max(0.0).sqrt().min(p.speed_limits[s.node + 1]);
            let time = s.time + 2.0 * ds / (s.speed + speed);
            !p.is_blocked(s.node, s.time, time)
                && can_avoid(p, SpeedState { node: s.node + 1, speed, time }, deceleration)
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]

        #[test]
        fn no_action_sequence_avoids_a_reported_collision(
            speed in 0.5..8.0f64,
            blocks in prop::collection::vec((0..10usize, 0.0..4.0f64, 0.05..3.0f64), 0..10),
            deceleration in 0.5..4.0f64,
        ) {
            let mut p = empty_road(5.0, speed);
            for (cell, from, length) in blocks {
                if p.blocked[cell].last().is_none_or(|b| b.1 < from) {
                    p.blocked[cell].push((from, from + length));
                }
            }
            if LostStates::to_contact(&p).contains(&start(&p), deceleration) {
                prop_assert!(!can_avoid(&p, start(&p), deceleration));
            }
        }
    }
}
