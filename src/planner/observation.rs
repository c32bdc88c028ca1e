//! What is known at the time of a planning cycle, and its checks.
//!
//! An observation is complete: what is not in it does not exist for the cycle. The planner keeps nothing of an earlier
//! observation but the committed plan, which it verifies against the present one.
//!
//! A prediction is the motion of an obstacle from now on. It may begin earlier, and the past is ignored. One that begins later
//! than now is preceded by its first state, moved back with its speed and heading. One that ends while the obstacle is in sight
//! is continued ([`Extrapolation`](super::Extrapolation)), so that an obstacle without a prediction is a trajectory of one state.

use std::collections::HashSet;
use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use crate::geometry::Point;
use crate::map::{Goal, Motion, Obstacle, Part, PlanningProblem, Scenario, Shape};
use crate::vehicle::State;

/// What is known at the time of a cycle.
#[derive(Debug, Clone)]
pub struct Observation {
    /// Estimated state of the vehicle, with the time of the cycle.
    pub state: State,
    /// The obstacles in sight, each with its prediction. Share the slice between cycles while it does not change: its
    /// preparation is kept.
    pub obstacles: Arc<[Obstacle]>,
    /// The goals; any of them ends the task. None to follow the lane.
    pub goals: Arc<[Goal]>,
    /// Friction of the road ahead as believed, as a factor on that of dry asphalt.
    pub friction: f64,
}

/// Largest believed friction, as a factor on that of dry asphalt: no road is that good, and proofs would not hold.
pub const HIGHEST_FRICTION: f64 = 10.0;

/// Why an observation is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ObservationError {
    /// A value of the vehicle's state is not a finite number.
    #[error("{what} of the vehicle is {value}, expected a finite number")]
    State {
        /// Name of the value.
        what: &'static str,
        /// The value.
        value: f64,
    },
    /// A value of the vehicle's state is beyond what a vehicle can do.
    #[error("{what} of the vehicle is {value} {unit}, expected at most {most} {unit} to either side")]
    Beyond {
        /// Name of the value.
        what: &'static str,
        /// The value.
        value: f64,
        /// The largest value to either side.
        most: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// The time is before that of the previous cycle.
    #[error("the observation is of {now} s, expected a time not before the previous cycle at {before} s")]
    TimeGoesBack {
        /// Time of the observation, s.
        now: f64,
        /// Time of the previous cycle, s.
        before: f64,
    },
    /// The friction is not a positive number up to [`HIGHEST_FRICTION`].
    #[error("the friction is {0}, expected a number above 0 and up to {HIGHEST_FRICTION}, times that of dry asphalt")]
    Friction(f64),
    /// Two obstacles have the same id.
    #[error("two obstacles have the id {0}, expected one for each id")]
    DuplicateId(i64),
    /// A value of an obstacle is not a finite number.
    #[error("obstacle {id}: {what} is not finite, expected finite numbers")]
    Obstacle {
        /// Id of the obstacle.
        id: i64,
        /// What is not finite.
        what: &'static str,
    },
    /// The states or sets of a prediction are missing or not in order of time.
    #[error("obstacle {id}: its prediction {what}")]
    Prediction {
        /// Id of the obstacle.
        id: i64,
        /// What is wrong, and what was expected.
        what: &'static str,
    },
    /// A limit of a goal is not a number.
    #[error("goal {index}: a limit of {what} is not a number")]
    Goal {
        /// Index of the goal.
        index: usize,
        /// Name of the condition.
        what: &'static str,
    },
}

impl Observation {
    /// The observation of a scenario in which everything is known in advance, with dry asphalt.
    #[must_use]
    pub fn of_scenario(scenario: &Scenario, problem: &PlanningProblem, state: State) -> Self {
        Self {
            state,
            obstacles: scenario.obstacles.as_slice().into(),
            goals: problem.goals.as_slice().into(),
            friction: 1.0,
        }
    }

    /// Checks everything but the obstacles.
    pub(super) fn validate(&self, before: f64) -> Result<(), ObservationError> {
        let State { time, pose, speed, lateral_speed, acceleration, yaw_rate, steering } = self.state;
        let (at, yaw) = (pose.position, pose.yaw);
        for (what, value) in [("the time", time), ("the x position", at.x), ("the y position", at.y), ("the yaw", yaw)]
        {
            if !value.is_finite() {
                return Err(ObservationError::State { what, value });
            }
        }
        for (what, value, most, unit) in [
            ("the speed", speed, State::HIGHEST_SPEED, "m/s"),
            ("the lateral speed", lateral_speed, State::HIGHEST_SPEED, "m/s"),
            ("the acceleration", acceleration, State::HIGHEST_ACCELERATION, "m/s²"),
            ("the yaw rate", yaw_rate, State::HIGHEST_YAW_RATE, "rad/s"),
            ("the steering angle", steering, FRAC_PI_2, "rad"),
        ] {
            if !value.is_finite() {
                return Err(ObservationError::State { what, value });
            }
            if value.abs() > most {
                return Err(ObservationError::Beyond { what, value, most, unit });
            }
        }
        if time < before {
            return Err(ObservationError::TimeGoesBack { now: time, before });
        }
        if !(self.friction > 0.0 && self.friction <= HIGHEST_FRICTION) {
            return Err(ObservationError::Friction(self.friction));
        }
        for (index, goal) in self.goals.iter().enumerate() {
            let conditions = [("time", Some(goal.time)), ("speed", goal.speed), ("yaw", goal.yaw)];
            let wrong = conditions.into_iter().find(|(_, i)| i.is_some_and(|i| i.min.is_nan() || i.max.is_nan()));
            if let Some((what, _)) = wrong {
                return Err(ObservationError::Goal { index, what });
            }
        }
        Ok(())
    }

    /// Checks the obstacles.
    pub(super) fn validate_obstacles(&self) -> Result<(), ObservationError> {
        let mut ids = HashSet::with_capacity(self.obstacles.len());
        for obstacle in self.obstacles.iter() {
            if !ids.insert(obstacle.id) {
                return Err(ObservationError::DuplicateId(obstacle.id));
            }
            validate_obstacle(obstacle)?;
        }
        Ok(())
    }
}

fn validate_obstacle(obstacle: &Obstacle) -> Result<(), ObservationError> {
    let id = obstacle.id;
    let finite = |what, values: &[f64]| {
        if values.iter().all(|v| v.is_finite()) { Ok(()) } else { Err(ObservationError::Obstacle { id, what }) }
    };
    let finite_shape = |what, shape: &Shape| {
        if shape.parts.iter().all(is_finite) { Ok(()) } else { Err(ObservationError::Obstacle { id, what }) }
    };
    match &obstacle.motion {
        Motion::Static(pose) => {
            finite("its position", &[pose.position.x, pose.position.y, pose.yaw])?;
            finite_shape("its shape", &obstacle.shape)
        }
        Motion::Trajectory(states) => {
            finite_shape("its shape", &obstacle.shape)?;
            if states.is_empty() {
                let what = "has no state, expected at least the present one";
                return Err(ObservationError::Prediction { id, what });
            }
            for s in states {
                finite(
                    "a state of its prediction",
                    &[s.time, s.pose.position.x, s.pose.position.y, s.pose.yaw, s.speed],
                )?;
            }
            if states.windows(2).any(|pair| pair[1].time <= pair[0].time) {
                let what = "has states out of order, expected increasing times";
                return Err(ObservationError::Prediction { id, what });
            }
            Ok(())
        }
        Motion::Occupancy(sets) => {
            for set in sets {
                finite("a time of its predicted sets", &[set.from, set.to])?;
                finite_shape("a predicted set", &set.region)?;
            }
            if sets.is_empty() || sets.iter().any(|s| s.to < s.from) || sets.windows(2).any(|p| p[1].from < p[0].from) {
                let what = "has sets out of order or none, expected at least one, in order of time";
                return Err(ObservationError::Prediction { id, what });
            }
            Ok(())
        }
    }
}

fn is_finite(part: &Part) -> bool {
    let point = |p: &Point| p.x.is_finite() && p.y.is_finite();
    match part {
        Part::Rectangle { centre, length, width } => {
            point(&centre.position) && [centre.yaw, *length, *width].iter().all(|v| v.is_finite())
        }
        Part::Circle { centre, radius } => point(centre) && radius.is_finite(),
        Part::Polygon { vertices } => vertices.iter().all(point),
    }
}
