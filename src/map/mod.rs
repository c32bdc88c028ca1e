//! Scenarios, independent of a file format: road network, obstacles with their predictions, planning problems.
//!
//! The readers in [`crate::io`] create these types, with the [`Issue`]s of the file; later stages do not change them.
//! Positions are world coordinates in metres. They may be as large as UTM coordinates, since all numbers are `f64`.

mod grid;
mod network;
mod obstacle;
mod problem;
mod shape;

use crate::geometry::wrap_angle;

pub use grid::{Cell, CellBlock, GridError, OccupancyGrid};
pub use network::{Lanelet, LaneletId, Neighbour, RoadNetwork, StopLine, TrafficLight, TrafficSign};
pub use obstacle::{Motion, Obstacle, ObstacleKind, TimedOccupancy, TimedPose};
pub use problem::{Goal, GoalPosition, InitialState, Interval, PlanningProblem};
pub use shape::{ConvexPart, Part, Shape};

/// A scenario: the input of a planner.
#[derive(Debug, Clone)]
pub struct Scenario {
    /// Its name in the file (CommonRoad benchmark id).
    pub id: String,
    /// Version of the file format, e.g. `2020a`.
    pub version: String,
    /// Duration of one time step of the file, s. Positive and finite.
    pub time_step: f64,
    /// Lanelets, traffic signs and traffic lights.
    pub network: RoadNetwork,
    /// Static and moving obstacles.
    pub obstacles: Vec<Obstacle>,
    /// Occupied cells, in addition to the obstacles.
    pub occupancy: Option<OccupancyGrid>,
    /// The planning problems of the file; a reader gives at least one.
    pub problems: Vec<PlanningProblem>,
    /// What the reader repaired or left out.
    pub issues: Vec<Issue>,
}

/// What a map knows: the fixed part of a scenario.
#[derive(Debug, Clone, Copy)]
pub struct Map<'a> {
    /// Lanelets, traffic signs and traffic lights.
    pub network: &'a RoadNetwork,
    /// Occupied cells.
    pub occupancy: Option<&'a OccupancyGrid>,
}

impl Scenario {
    /// The map of the scenario.
    #[must_use]
    pub fn map(&self) -> Map<'_> {
        Map { network: &self.network, occupancy: self.occupancy.as_ref() }
    }

    /// Adds an occupancy grid, read from `file`. A grid that overlaps no lanelet has no effect, most likely because it is in
    /// other coordinates: this is an issue.
    pub fn overlay(&mut self, grid: OccupancyGrid, file: &str) {
        if !grid.touches(&self.network) {
            let (width, height) = (grid.width(), grid.height());
            let corner = |block: CellBlock| grid.corners(&block)[2];
            let (near, far) = (grid.origin().position, corner(CellBlock { columns: 0..width, rows: 0..height }));
            let message = format!(
                "lies beside the road: it overlaps no lanelet, from ({:.1}, {:.1}) to ({:.1}, {:.1}); expected a grid in the \
                 scenario's coordinates; kept, without effect",
                near.x, near.y, far.x, far.y
            );
            self.issues.push(Issue { line: 0, element: format!("occupancy grid {file}"), message });
        }
        self.occupancy = Some(grid);
    }

    /// The obstacle that is exactly where a problem starts, as fast and in the same direction: exports of recordings contain the
    /// recorded vehicle itself.
    #[must_use]
    pub fn recorded_ego(&self, problem: &PlanningProblem) -> Option<&Obstacle> {
        /// Differences that the rounding of files explains: m, rad, m/s.
        const ROUNDING: f64 = 0.01;
        let InitialState { centre, speed, time_step, .. } = &problem.initial;
        let time = *time_step as f64 * self.time_step;
        let is_there = |state: &TimedPose| {
            let to = centre.to_local(state.pose.position);
            to.coords.norm() < ROUNDING
                && wrap_angle(state.pose.yaw - centre.yaw).abs() < ROUNDING
                && (state.speed - speed).abs() < ROUNDING
        };
        self.obstacles.iter().find(|obstacle| match &obstacle.motion {
            Motion::Trajectory(states) => {
                states.iter().find(|s| (s.time - time).abs() < 0.5 * self.time_step).is_some_and(is_there)
            }
            Motion::Static(_) | Motion::Occupancy(_) => false,
        })
    }

    /// Leaves an obstacle out, which is an issue. Returns whether there was one with this id.
    pub fn leave_out(&mut self, id: i64) -> bool {
        let before = self.obstacles.len();
        self.obstacles.retain(|obstacle| obstacle.id != id);
        let was_there = self.obstacles.len() < before;
        if was_there {
            self.issues.push(Issue {
                line: 0,
                element: format!("obstacle {id}"),
                message: "left out as asked for".into(),
            });
        }
        was_there
    }
}

/// Something in a file that the reader repaired or left out. The scenario is usable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Issue {
    /// Line in the file, 1-based; 0 when it concerns the file as a whole.
    pub line: u32,
    /// The element, with its id when it has one: `lanelet 12`.
    pub element: String,
    /// The fault and its consequence.
    pub message: String,
}

impl std::fmt::Display for Issue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.line {
            0 => write!(f, "{}: {}", self.element, self.message),
            line => write!(f, "line {line}: {}: {}", self.element, self.message),
        }
    }
}
