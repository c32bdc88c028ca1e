//! Scenarios, independent of a file format: road network, obstacles with their predictions, planning problems.
//!
//! The readers in [`crate::io`] create these types, with the [`Issue`]s of the file; later stages do not change them.
//! Positions are world coordinates in metres. They may be as large as UTM coordinates, since all numbers are `f64`.

mod grid;
mod network;
mod obstacle;
mod problem;
mod shape;

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
