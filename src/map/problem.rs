//! Planning problems: initial state and goal of a run.

use super::{LaneletId, Shape};
use crate::geometry::{Pose, wrap_angle};

/// A planning problem of a scenario.
#[derive(Debug, Clone)]
pub struct PlanningProblem {
    /// Id in the file.
    pub id: i64,
    /// State of the vehicle at the start.
    pub initial: InitialState,
    /// Alternative goals: the run reaches its goal if it reaches any of them. Empty if the file has no goal state.
    pub goals: Vec<Goal>,
}

/// The vehicle at the start. As in CommonRoad, the pose is that of the vehicle's **centre**;
/// [`crate::vehicle::Vehicle::rear_axle_of_centre`] converts it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InitialState {
    /// Pose of the vehicle's centre.
    pub centre: Pose,
    /// Speed along the heading, m/s.
    pub speed: f64,
    /// Acceleration along the heading, m/s².
    pub acceleration: f64,
    /// Yaw rate, rad/s.
    pub yaw_rate: f64,
    /// Time step of the file.
    pub time_step: i64,
}

/// A closed interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Lower end.
    pub min: f64,
    /// Upper end.
    pub max: f64,
}

impl Interval {
    /// Whether the value is inside; both ends are.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        self.min <= value && value <= self.max
    }

    /// Whether the angle is inside, modulo full turns.
    #[must_use]
    pub fn contains_angle(&self, angle: f64) -> bool {
        let middle = f64::midpoint(self.min, self.max);
        wrap_angle(angle - middle).abs() <= 0.5 * (self.max - self.min)
    }
}

/// A goal state: the conjunction of its conditions, for the vehicle's **centre**.
#[derive(Debug, Clone, PartialEq)]
pub struct Goal {
    /// Region, if there is one.
    pub position: Option<GoalPosition>,
    /// Time since time step 0 of the file, s.
    pub time: Interval,
    /// Speed, m/s, if there is a condition.
    pub speed: Option<Interval>,
    /// Heading, rad, if there is a condition.
    pub yaw: Option<Interval>,
}

/// The region of a goal.
#[derive(Debug, Clone, PartialEq)]
pub enum GoalPosition {
    /// Any of the shapes, in world coordinates.
    Shapes(Shape),
    /// Any of the lanelets.
    Lanelets(Vec<LaneletId>),
}
