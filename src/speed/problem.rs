//! What the speed layer is asked.

use thiserror::Error;

use super::{AccelerationLimits, Resolution, TimeInterval};

/// A speed-planning problem along one path.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedProblem {
    /// Nodes, m along the path, increasing. Cell `i` lies between nodes `i` and `i + 1`.
    pub stations: Vec<f64>,
    /// Highest speed allowed at each node, m/s; inside a cell the higher one of its two nodes.
    pub speed_limits: Vec<f64>,
    /// For each cell the time intervals in which it is blocked, sorted and disjoint.
    pub blocked: Vec<Vec<TimeInterval>>,
    /// Time intervals in which the pose at the first node itself is blocked, sorted and disjoint.
    pub blocked_at_start: Vec<TimeInterval>,
    /// Whether coming to rest at each node is allowed (not inside a crossing or junction).
    pub stopping_allowed: Vec<bool>,
    /// Speed at the first node, m/s.
    pub start_speed: f64,
    /// Time at the first node, s of the run.
    pub start_time: f64,
    /// Time up to which a vehicle at rest must stay free of obstacles, s of the run.
    pub horizon: f64,
    /// Accelerations that may be used.
    pub limits: AccelerationLimits,
}

/// Why a problem makes no sense.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum ProblemError {
    /// A list does not fit the number of stations.
    #[error("{what} has {got} entries, the stations ask for {expected}")]
    Length {
        /// Which list.
        what: &'static str,
        /// Its length.
        got: usize,
        /// What it should be.
        expected: usize,
    },
    /// A station is not a number, or not beyond the one before.
    #[error("station {index} ({station} m) is not a number beyond the one before it")]
    Stations {
        /// Which station.
        index: usize,
        /// Its value, m.
        station: f64,
    },
    /// A value out of its range.
    #[error("{what} is {value}, it must be {expected}")]
    Value {
        /// Which value.
        what: &'static str,
        /// What it is.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
    /// A step that does not cut the road.
    #[error("a step of {step} m on a road of {length} m")]
    Step {
        /// The step, m.
        step: f64,
        /// The road, m.
        length: f64,
    },
}

/// Most nodes of a problem: the search packs their number into sixteen bits.
const MOST_NODES: usize = 1 << 16;

/// Narrowest bins and shortest wait of a search, m/s and s.
const NARROWEST: f64 = 1e-6;

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

    /// A safe state: at rest where resting is allowed, untouched from `time` to the horizon.
    #[must_use]
    pub fn is_safe_standstill(&self, node: usize, time: f64) -> bool {
        self.stopping_allowed[node] && !self.is_standstill_blocked(node, time, self.horizon.max(time))
    }

    /// Whether anything moves near this path at all. If not, time does not tell states apart.
    #[must_use]
    pub fn time_matters(&self) -> bool {
        !self.blocked_at_start.is_empty() || self.blocked.iter().any(|b| !b.is_empty())
    }

    /// A road without anything on it: `length` metres in steps of `step`, one cap.
    ///
    /// # Errors
    /// [`ProblemError`]: a step of nothing or longer than the road, or what [`Self::validate`] finds.
    pub fn empty_road(
        length: f64,
        step: f64,
        cap: f64,
        start_speed: f64,
        limits: AccelerationLimits,
    ) -> Result<Self, ProblemError> {
        let cells = (length / step).round();
        if !(step > 0.0 && step <= length && cells < MOST_NODES as f64) {
            return Err(ProblemError::Step { step, length });
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked above
        let cells = cells as usize;
        let problem = Self {
            stations: (0..=cells).map(|i| length * i as f64 / cells as f64).collect(),
            speed_limits: vec![cap; cells + 1],
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

    /// Checks that the lists fit together and that every number can be one.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn validate(&self) -> Result<(), ProblemError> {
        let nodes = self.stations.len();
        let value = |what, value, holds: bool, expected| {
            if holds { Ok(()) } else { Err(ProblemError::Value { what, value, expected }) }
        };
        value("number of stations", nodes as f64, (1..MOST_NODES).contains(&nodes), "between 1 and 65535")?;
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
        let cap = self.speed_limits.iter().copied().find(|c| c.is_nan() || *c < 0.0);
        value("cap", cap.unwrap_or(0.0), cap.is_none(), "a speed, not negative")?;
        self.limits.validate()?;
        let speed = self.start_speed;
        value("start speed", speed, speed >= 0.0 && speed.is_finite(), "a speed, not negative")?;
        value("start time", self.start_time, self.start_time.is_finite(), "a time")?;
        value("horizon", self.horizon, !self.horizon.is_nan(), "a time")
    }
}

impl AccelerationLimits {
    /// Checks that every one is positive, and the aggressive deceleration at least the comfortable one.
    ///
    /// # Errors
    /// The first that is wrong.
    pub fn validate(&self) -> Result<(), ProblemError> {
        let value = |what, value, holds: bool, expected| {
            if holds { Ok(()) } else { Err(ProblemError::Value { what, value, expected }) }
        };
        let positive = |a: f64| a > 0.0 && a.is_finite();
        value("acceleration", self.acceleration, positive(self.acceleration), "positive")?;
        value("deceleration", self.deceleration, positive(self.deceleration), "positive")?;
        let hardest = self.aggressive_deceleration;
        let harder = hardest >= self.deceleration && hardest.is_finite();
        value("aggressive deceleration", hardest, harder, "at least the comfortable one")
    }
}

impl Resolution {
    /// Checks that bins and waits have a width of a millionth at the least: below, rounding tells states apart, and the bins
    /// of a drive are more than a key can hold.
    ///
    /// # Errors
    /// The first that has none.
    pub fn validate(&self) -> Result<(), ProblemError> {
        let widths = [("speed bin", self.speed), ("time bin", self.time), ("waiting time", self.wait)];
        let wrong = widths.into_iter().find(|(_, w)| !(*w >= NARROWEST && w.is_finite()));
        wrong.map_or(Ok(()), |(what, value)| Err(ProblemError::Value { what, value, expected: "at least 1e-6" }))
    }
}

/// Whether `[from, to]` meets any of the sorted disjoint intervals.
fn overlaps(intervals: &[TimeInterval], from: f64, to: f64) -> bool {
    let first_ending_after = intervals.partition_point(|&(_, end)| end < from);
    intervals.get(first_ending_after).is_some_and(|&(start, _)| start <= to)
}

#[cfg(test)]
mod tests {
    use super::super::test_support::empty_road;
    use super::*;

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

    const LIMITS: AccelerationLimits =
        AccelerationLimits { acceleration: 1.5, deceleration: 1.5, aggressive_deceleration: 2.2 };

    #[test]
    fn a_step_that_does_not_cut_the_road_is_an_error() {
        let road = |step| SpeedProblem::empty_road(100.0, step, 15.0, 0.0, LIMITS);
        assert_eq!(road(0.5).map(|p| p.cells()), Ok(200));
        assert_eq!(road(100.0).map(|p| p.cells()), Ok(1));
        for step in [0.0, -0.5, 100.5, f64::NAN, f64::INFINITY, 1e-9] {
            assert!(matches!(road(step), Err(ProblemError::Step { .. })), "{step}");
        }
    }

    #[test]
    fn each_wrong_number_is_named() {
        let named = |change: &dyn Fn(&mut SpeedProblem)| {
            let mut problem = empty_road(10.0, 3.0);
            assert_eq!(problem.validate(), Ok(()));
            change(&mut problem);
            problem.validate().unwrap_err().to_string()
        };
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(named(&|p| p.limits.acceleration = bad).starts_with("acceleration"));
            assert!(named(&|p| p.limits.deceleration = bad).starts_with("deceleration"));
        }
        for bad in [1.4, f64::NAN, f64::INFINITY] {
            assert!(named(&|p| p.limits.aggressive_deceleration = bad).starts_with("aggressive"));
        }
        for bad in [-0.1, f64::NAN, f64::INFINITY] {
            assert!(named(&|p| p.start_speed = bad).starts_with("start speed"));
        }
        assert!(named(&|p| p.speed_limits[3] = f64::NAN).starts_with("cap"));
        assert!(named(&|p| p.speed_limits[3] = -1.0).starts_with("cap"));
        assert!(named(&|p| p.start_time = f64::INFINITY).starts_with("start time"));
        assert!(named(&|p| p.horizon = f64::NAN).starts_with("horizon"));
        assert!(named(&|p| p.stations[3] = p.stations[2]).starts_with("station 3"));
        assert!(named(&|p| p.stations[20] = f64::INFINITY).starts_with("station 20"));
        assert!(named(&|p| p.speed_limits.truncate(20)).starts_with("speed_limits has 20"));
        assert!(named(&|p| p.blocked.truncate(19)).starts_with("blocked has 19"));
        assert!(named(&|p| p.stopping_allowed.truncate(20)).starts_with("stopping_allowed"));
        assert!(named(&|p| p.stations.clear()).starts_with("number of stations"));
    }

    #[test]
    fn bins_without_width_are_an_error() {
        let fine = Resolution::default();
        assert_eq!(fine.validate(), Ok(()));
        for bad in [0.0, -1.0, f64::NAN] {
            assert!(Resolution { speed: bad, ..fine }.validate().is_err());
            assert!(Resolution { time: bad, ..fine }.validate().is_err());
            assert!(Resolution { wait: bad, ..fine }.validate().is_err());
        }
    }
}
