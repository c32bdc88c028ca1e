//! The input of the speed layer and its validation.

use thiserror::Error;

use super::{AccelerationLimits, Resolution, TimeInterval};

/// A speed-planning problem along one path.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedProblem {
    /// Stations of the nodes along the path, increasing, m. Cell `i` lies between the nodes `i` and `i + 1`.
    pub stations: Vec<f64>,
    /// Speed limit at each node, m/s. Inside a cell the higher limit of its two nodes applies.
    pub speed_limits: Vec<f64>,
    /// Blocked intervals of each cell, sorted and disjoint.
    pub blocked: Vec<Vec<TimeInterval>>,
    /// Blocked intervals of the pose at the first node, sorted and disjoint.
    pub blocked_at_start: Vec<TimeInterval>,
    /// Whether stopping at each node is allowed (not inside a crossing or junction).
    pub stopping_allowed: Vec<bool>,
    /// Speed at the first node, m/s.
    pub start_speed: f64,
    /// Time at the first node, s of the run.
    pub start_time: f64,
    /// Time until which a stopped vehicle must stay clear of obstacles, s of the run.
    pub horizon: f64,
    /// Acceleration limits.
    pub limits: AccelerationLimits,
}

/// Why a [`SpeedProblem`] or a [`Resolution`] is invalid.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum ProblemError {
    /// The length of a list does not match the number of stations.
    #[error("{what} has {got} entries; the stations require {expected}")]
    Length {
        /// Name of the list.
        what: &'static str,
        /// Actual length.
        got: usize,
        /// Required length.
        expected: usize,
    },
    /// A station is not finite or not greater than its predecessor.
    #[error("station {index} ({station} m) is not finite or not greater than the station before it")]
    Stations {
        /// Index of the station.
        index: usize,
        /// Value, m.
        station: f64,
    },
    /// A value is out of range.
    #[error("{what} is {value}; it must be {expected}")]
    Value {
        /// Name of the value.
        what: &'static str,
        /// Actual value.
        value: f64,
        /// Allowed range.
        expected: &'static str,
    },
    /// A step does not divide a road into a valid number of cells.
    #[error("a step of {step} m on a road of {length} m does not give 1 to 65534 cells")]
    Step {
        /// Length of the step, m.
        step: f64,
        /// Length of the road, m.
        length: f64,
    },
}

/// Upper limit of the number of nodes: the search packs a node index into 16 bits.
const MAX_NODES: usize = 1 << 16;

/// Minimum bin width and waiting time of a search, m/s and s.
const MIN_WIDTH: f64 = 1e-6;

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

    /// Whether a cell is blocked at any time in `[from, to]`.
    #[must_use]
    pub fn is_blocked(&self, cell: usize, from: f64, to: f64) -> bool {
        overlaps(&self.blocked[cell], from, to)
    }

    /// Whether an obstacle may touch a vehicle that stands at a node at any time in `[from, to]`. A node belongs to the
    /// cells on both sides, so at each time one free cell is enough to exclude contact.
    #[must_use]
    pub fn is_standstill_blocked(&self, node: usize, from: f64, to: f64) -> bool {
        let behind = if node == 0 { &self.blocked_at_start } else { &self.blocked[node - 1] };
        match self.blocked.get(node) {
            None => overlaps(behind, from, to),
            Some(ahead) => behind.iter().any(|&(start, end)| {
                let (start, end) = (start.max(from), end.min(to));
                start <= end && overlaps(ahead, start, end)
            }),
        }
    }

    /// Whether a standstill at a node from `time` on is a safe state: stopping is allowed there, and the pose stays
    /// free until the horizon.
    #[must_use]
    pub fn is_safe_standstill(&self, node: usize, time: f64) -> bool {
        self.stopping_allowed[node] && !self.is_standstill_blocked(node, time, self.horizon.max(time))
    }

    /// Whether any pose on the path is ever blocked. If not, the time of a state does not matter.
    #[must_use]
    pub fn time_matters(&self) -> bool {
        !self.blocked_at_start.is_empty() || self.blocked.iter().any(|b| !b.is_empty())
    }

    /// A road of `length` (m) without obstacles, in steps of about `step` (m), with one speed limit (m/s).
    ///
    /// # Errors
    /// [`ProblemError::Step`] for a step that is not positive or longer than the road; otherwise see
    /// [`Self::validate`].
    pub fn empty_road(
        length: f64,
        step: f64,
        speed_limit: f64,
        start_speed: f64,
        limits: AccelerationLimits,
    ) -> Result<Self, ProblemError> {
        let cells = (length / step).round();
        if !(step > 0.0 && step <= length && cells < MAX_NODES as f64) {
            return Err(ProblemError::Step { step, length });
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked above
        let cells = cells as usize;
        let problem = Self {
            stations: (0..=cells).map(|i| length * i as f64 / cells as f64).collect(),
            speed_limits: vec![speed_limit; cells + 1],
            blocked: vec![Vec::new(); cells],
            blocked_at_start: Vec::new(),
            stopping_allowed: vec![true; cells + 1],
            start_speed,
            start_time: 0.0,
            horizon: 0.0,
            limits,
        };
        problem.validate()?;
        Ok(problem)
    }

    /// Checks the lengths of the lists and the ranges of all values.
    ///
    /// # Errors
    /// The first violation.
    pub fn validate(&self) -> Result<(), ProblemError> {
        let nodes = self.stations.len();
        let value = |what, value, is_valid: bool, expected| {
            if is_valid { Ok(()) } else { Err(ProblemError::Value { what, value, expected }) }
        };
        value("number of stations", nodes as f64, (1..MAX_NODES).contains(&nodes), "between 1 and 65535")?;
        for (what, got, expected) in [
            ("speed_limits", self.speed_limits.len(), nodes),
            ("stopping_allowed", self.stopping_allowed.len(), nodes),
            ("blocked", self.blocked.len(), nodes - 1),
        ] {
            if got != expected {
                return Err(ProblemError::Length { what, got, expected });
            }
        }
        if let Some(index) = self.stations.iter().position(|s| !s.is_finite()) {
            return Err(ProblemError::Stations { index, station: self.stations[index] });
        }
        for (index, pair) in self.stations.windows(2).enumerate() {
            if pair[1] <= pair[0] {
                return Err(ProblemError::Stations { index: index + 1, station: pair[1] });
            }
        }
        let invalid = self.speed_limits.iter().copied().find(|limit| limit.is_nan() || *limit < 0.0);
        value("speed limit", invalid.unwrap_or(0.0), invalid.is_none(), "non-negative")?;
        self.limits.validate()?;
        let speed = self.start_speed;
        value("start speed", speed, speed >= 0.0 && speed.is_finite(), "finite and non-negative")?;
        value("start time", self.start_time, self.start_time.is_finite(), "finite")?;
        value("horizon", self.horizon, !self.horizon.is_nan(), "a number")
    }
}

impl AccelerationLimits {
    /// Checks that all limits are positive and that the aggressive deceleration is not below the comfortable one.
    ///
    /// # Errors
    /// The first violation.
    pub fn validate(&self) -> Result<(), ProblemError> {
        let value = |what, value, is_valid: bool, expected| {
            if is_valid { Ok(()) } else { Err(ProblemError::Value { what, value, expected }) }
        };
        let positive = |a: f64| a > 0.0 && a.is_finite();
        value("acceleration", self.acceleration, positive(self.acceleration), "positive and finite")?;
        value("deceleration", self.deceleration, positive(self.deceleration), "positive and finite")?;
        let aggressive = self.aggressive_deceleration;
        let is_valid = aggressive >= self.deceleration && aggressive.is_finite();
        value("aggressive deceleration", aggressive, is_valid, "finite and at least the comfortable deceleration")
    }
}

impl Resolution {
    /// Checks that bins and waits are at least 1e-6 wide. Below that, rounding errors separate duplicates, and the
    /// number of bins exceeds the range of a state key.
    ///
    /// # Errors
    /// The first violation.
    pub fn validate(&self) -> Result<(), ProblemError> {
        let widths = [("speed bin", self.speed), ("time bin", self.time), ("waiting time", self.wait)];
        let invalid = widths.into_iter().find(|(_, w)| !(*w >= MIN_WIDTH && w.is_finite()));
        invalid.map_or(Ok(()), |(what, value)| {
            Err(ProblemError::Value { what, value, expected: "finite and at least 1e-6" })
        })
    }
}

/// Whether `[from, to]` intersects one of the sorted, disjoint, closed intervals.
fn overlaps(intervals: &[TimeInterval], from: f64, to: f64) -> bool {
    let first_ending_after = intervals.partition_point(|&(_, end)| end < from);
    intervals.get(first_ending_after).is_some_and(|&(start, _)| start <= to)
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::*;

    #[test]
    fn intervals_are_closed() {
        let b = [(1.0, 2.0), (4.0, 5.0)];
        assert!(overlaps(&b, 2.0, 3.0));
        assert!(overlaps(&b, 0.0, 1.0));
        assert!(overlaps(&b, 0.0, 9.0));
        assert!(!overlaps(&b, 2.1, 3.9));
        assert!(!overlaps(&b, 5.1, 9.0));
        assert!(!overlaps(&[], 0.0, 1.0));
    }

    const LIMITS: AccelerationLimits =
        AccelerationLimits { acceleration: 1.5, deceleration: 1.5, aggressive_deceleration: 2.2 };

    #[test]
    fn rejects_a_step_that_does_not_divide_the_road() {
        let road = |step| SpeedProblem::empty_road(100.0, step, 15.0, 0.0, LIMITS);
        assert_eq!(road(0.5).map(|p| p.cells()), Ok(200));
        assert_eq!(road(100.0).map(|p| p.cells()), Ok(1));
        for step in [0.0, -0.5, 100.5, f64::NAN, f64::INFINITY, 1e-9] {
            assert!(matches!(road(step), Err(ProblemError::Step { .. })), "{step}");
        }
    }

    #[test]
    fn names_each_invalid_value() {
        let error = |change: &dyn Fn(&mut SpeedProblem)| {
            let mut problem = empty_road(10.0, 3.0);
            assert_eq!(problem.validate(), Ok(()));
            change(&mut problem);
            problem.validate().unwrap_err().to_string()
        };
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(error(&|p| p.limits.acceleration = bad).starts_with("acceleration"));
            assert!(error(&|p| p.limits.deceleration = bad).starts_with("deceleration"));
        }
        for bad in [1.4, f64::NAN, f64::INFINITY] {
            assert!(error(&|p| p.limits.aggressive_deceleration = bad).starts_with("aggressive"));
        }
        for bad in [-0.1, f64::NAN, f64::INFINITY] {
            assert!(error(&|p| p.start_speed = bad).starts_with("start speed"));
        }
        assert!(error(&|p| p.speed_limits[3] = f64::NAN).starts_with("speed limit"));
        assert!(error(&|p| p.speed_limits[3] = -1.0).starts_with("speed limit"));
        assert!(error(&|p| p.start_time = f64::INFINITY).starts_with("start time"));
        assert!(error(&|p| p.horizon = f64::NAN).starts_with("horizon"));
        assert!(error(&|p| p.stations[3] = p.stations[2]).starts_with("station 3"));
        assert!(error(&|p| p.stations[20] = f64::INFINITY).starts_with("station 20"));
        assert!(error(&|p| p.speed_limits.truncate(20)).starts_with("speed_limits has 20"));
        assert!(error(&|p| p.blocked.truncate(19)).starts_with("blocked has 19"));
        assert!(error(&|p| p.stopping_allowed.truncate(20)).starts_with("stopping_allowed"));
        assert!(error(&|p| p.stations.clear()).starts_with("number of stations"));
    }

    #[test]
    fn rejects_bins_and_waits_without_width() {
        let valid = Resolution::default();
        assert_eq!(valid.validate(), Ok(()));
        for bad in [0.0, -1.0, f64::NAN] {
            assert!(Resolution { speed: bad, ..valid }.validate().is_err());
            assert!(Resolution { time: bad, ..valid }.validate().is_err());
            assert!(Resolution { wait: bad, ..valid }.validate().is_err());
        }
    }
}
