//! The speed layer: how fast to go along a path that is already chosen, so that a stop is always proven.
//!
//! The state is (station, speed, time). Stations are nodes `s_0 < s_1 < … < s_n` along the path; an edge crosses the
//! cell between two nodes at constant acceleration `a`, so that
//!
//! ```text
//! v′² = v² + 2 a Δs        Δt = 2 Δs / (v + v′)
//! ```
//!
//! A cell is *blocked* during the time intervals in which the vehicle, anywhere in that cell, would touch a moving
//! obstacle. `safe_tlp` searches this lattice by the SafeTLP algorithm (Cserna, Doyle, Gu, Ruml: *Safe Temporal
//! Planning for Urban Driving*, Algorithm 1); [`smoothing`] makes the result jerk-limited through a quadratic program;
//! [`prove`] checks any profile again, by other code than the search.
//!
//! Weak spots: duplicates are detected on a grid of speed and time (see [`Resolution`]), so completeness holds for that
//! grid and not for the continuum; edges have unbounded jerk until they are smoothed.

pub mod bounds;
mod outlook;
mod prove;
mod safe_tlp;
pub mod smoothing;

pub use prove::{Refutation, prove};
pub use safe_tlp::{SpeedOutcome, SpeedPlan, SpeedState, plan};

/// A closed time interval `(from, to)`, s of the run.
pub type TimeInterval = (f64, f64);

/// A speed-planning problem along one path.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedProblem {
    /// Nodes, m along the path, increasing. Cell `i` lies between nodes `i` and `i + 1`.
    pub stations: Vec<f64>,
    /// Highest speed allowed at each node, m/s; inside a cell the higher one of its two nodes.
    pub caps: Vec<f64>,
    /// For each cell the time intervals in which it is blocked, sorted and disjoint.
    pub blocked: Vec<Vec<TimeInterval>>,
    /// Time intervals in which the pose at the first node itself is blocked, sorted and disjoint.
    pub blocked_at_start: Vec<TimeInterval>,
    /// Whether coming to rest at each node is allowed (not inside a crossing or junction).
    pub rest_allowed: Vec<bool>,
    /// Speed at the first node, m/s.
    pub start_speed: f64,
    /// Time at the first node, s of the run.
    pub start_time: f64,
    /// Time up to which a vehicle at rest must stay free of obstacles, s of the run.
    pub horizon: f64,
    /// Accelerations that may be used.
    pub limits: AccelerationLimits,
}

/// Accelerations of the search; decelerations are positive numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AccelerationLimits {
    /// Comfortable acceleration, m/s².
    pub acceleration: f64,
    /// Comfortable deceleration, m/s².
    pub deceleration: f64,
    /// Deceleration that only stopping proofs may use, m/s², at least the comfortable one.
    pub aggressive_deceleration: f64,
}

/// Discretisation and budgets of the search. Budgets are counts, never times, so that results repeat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resolution {
    /// States at one station within this speed of each other (and of the same time bin) are duplicates, m/s.
    pub speed: f64,
    /// Width of a time bin, s. Ignored where nothing moves, since then time does not matter.
    pub time: f64,
    /// Duration of one waiting action at rest, s.
    pub wait: f64,
    /// Expansions allowed in each of the three phases (naive search, all proofs together, exhaustive search).
    pub expansions: usize,
}

impl Default for Resolution {
    fn default() -> Self {
        Self { speed: 0.05, time: 0.1, wait: 0.5, expansions: 20_000 }
    }
}

impl SpeedProblem {
    /// Number of cells.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.stations.len().saturating_sub(1)
    }

    /// Station of the last node, m.
    #[must_use]
    pub fn end(&self) -> f64 {
        self.stations.last().copied().unwrap_or(0.0)
    }

    /// Whether cell `i` is blocked at any moment of `[from, to]`.
    #[must_use]
    pub fn is_blocked(&self, cell: usize, from: f64, to: f64) -> bool {
        overlaps(&self.blocked[cell], from, to)
    }

    /// Whether a vehicle at rest at node `i` is touched at any moment of `[from, to]`. A node belongs to the cells on
    /// both sides: at each moment, being free in either proves it.
    #[must_use]
    pub fn is_rest_blocked(&self, node: usize, from: f64, to: f64) -> bool {
        let behind = if node == 0 { &self.blocked_at_start } else { &self.blocked[node - 1] };
        match self.blocked.get(node) {
            None => overlaps(behind, from, to),
            Some(ahead) => behind.iter().any(|&(start, end)| {
                let (start, end) = (start.max(from), end.min(to));
                start <= end && overlaps(ahead, start, end)
            }),
        }
    }

    /// A safe state: at rest where resting is allowed, untouched from `time` to the horizon.
    #[must_use]
    pub fn is_safe_rest(&self, node: usize, time: f64) -> bool {
        self.rest_allowed[node] && !self.is_rest_blocked(node, time, self.horizon.max(time))
    }

    /// Whether anything moves near this path at all. If not, time does not tell states apart.
    #[must_use]
    pub fn time_matters(&self) -> bool {
        !self.blocked_at_start.is_empty() || self.blocked.iter().any(|b| !b.is_empty())
    }
}

/// Whether `[from, to]` meets any of the sorted disjoint intervals.
fn overlaps(intervals: &[TimeInterval], from: f64, to: f64) -> bool {
    let first_ending_after = intervals.partition_point(|&(_, end)| end < from);
    intervals.get(first_ending_after).is_some_and(|&(start, _)| start <= to)
}

#[cfg(test)]
pub(crate) mod test_support {
    use super::{AccelerationLimits, SpeedProblem};

    /// The paper's road: `length` metres in half-metre steps, 15 m/s, limit set 4 of Table 1, nothing in the way.
    pub(crate) fn empty_road(length: f64, start_speed: f64) -> SpeedProblem {
        let cells = (length / 0.5).round() as usize;
        SpeedProblem {
            stations: (0..=cells).map(|i| 0.5 * i as f64).collect(),
            caps: vec![15.0; cells + 1],
            blocked: vec![Vec::new(); cells],
            blocked_at_start: Vec::new(),
            rest_allowed: vec![true; cells + 1],
            start_speed,
            start_time: 0.0,
            horizon: 30.0,
            limits: AccelerationLimits { acceleration: 1.5, deceleration: 1.5, aggressive_deceleration: 2.2 },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::overlaps;

    #[test]
    fn touching_an_interval_counts_as_blocked() {
        let b = [(1.0, 2.0), (4.0, 5.0)];
        assert!(overlaps(&b, 2.0, 3.0));
        assert!(overlaps(&b, 0.0, 1.0));
        assert!(overlaps(&b, 0.0, 9.0));
        assert!(!overlaps(&b, 2.1, 3.9));
        assert!(!overlaps(&b, 5.1, 9.0));
        assert!(!overlaps(&[], 0.0, 1.0));
    }
}
