//! Planning problems: where the run starts and what counts as the goal.

use super::{LaneletId, Shape};
use crate::geometry::{Pose, wrap_angle};

/// A planning problem of a scenario.
#[derive(Debug, Clone)]
pub struct PlanningProblem {
    /// Id in the file.
    pub id: i64,
    /// Where the vehicle is at the start.
    pub initial: InitialState,
    /// Alternatives: reaching any of them is reaching the goal. Empty only in a file without a goal state.
    pub goals: Vec<Goal>,
}

/// The vehicle at the start. The pose is that of the vehicle's **centre**, as CommonRoad has it;
/// [`crate::vehicle::Vehicle::rear_axle_of_centre`] converts.
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
    /// Whether the value lies inside, ends included.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        self.min <= value && value <= self.max
    }

    /// Whether the angle lies inside, modulo full turns.
    #[must_use]
    pub fn contains_angle(&self, angle: f64) -> bool {
        let middle = f64::midpoint(self.min, self.max);
        wrap_angle(angle - middle).abs() <= 0.5 * (self.max - self.min)
    }
}

/// One goal state: all the given conditions together, judged for the vehicle's **centre**.
#[derive(Debug, Clone)]
pub struct Goal {
    /// Where, when given.
    pub position: Option<GoalPosition>,
    /// When, as time since the start of the file, s.
    pub time: Interval,
    /// Speed, m/s, when given.
    pub speed: Option<Interval>,
    /// Heading, rad, when given.
    pub yaw: Option<Interval>,
}

/// The region of a goal.
#[derive(Debug, Clone)]
pub enum GoalPosition {
    /// Any of these shapes, in world coordinates.
    Shapes(Shape),
    /// Any of these lanelets.
    Lanelets(Vec<LaneletId>),
}
