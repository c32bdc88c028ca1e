//! The world without a file format: road network, obstacles with their predictions, planning problems.
//!
//! Readers in [`crate::io`] produce these types together with the [`Issue`]s they met; every later stage only reads
//! them. Positions are world coordinates in metres (UTM magnitudes are fine: everything is `f64`).

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

/// A scenario: what a planner is given.
#[derive(Debug, Clone)]
pub struct Scenario {
    /// The file's own name for it (CommonRoad benchmark id).
    pub id: String,
    /// Version of the file format, e.g. `2020a`.
    pub version: String,
    /// Duration of one time step of the file, s. Positive and finite.
    pub time_step: f64,
    /// Lanes and rules.
    pub network: RoadNetwork,
    /// Everything that can be hit, static and moving.
    pub obstacles: Vec<Obstacle>,
    /// Cells that can be hit, beside the obstacles.
    pub occupancy: Option<OccupancyGrid>,
    /// The tasks set by the file, at least one after reading a scenario.
    pub problems: Vec<PlanningProblem>,
    /// What the reader had to repair or leave out.
    pub issues: Vec<Issue>,
}

impl Scenario {
    /// Lays a grid, read from `file`, over the map. One that lies beside every lanelet has no effect, most likely because
    /// it is in other coordinates: that is noted as an issue.
    pub fn overlay(&mut self, grid: OccupancyGrid, file: &str) {
        if !grid.touches(&self.network) {
            let (width, height) = (grid.width(), grid.height());
            let corner = |block: CellBlock| grid.corners(&block)[2];
            let (near, far) = (grid.origin().position, corner(CellBlock { columns: 0..width, rows: 0..height }));
            let message = format!(
                "lies beside the road: no lanelet is under it, from ({:.1}, {:.1}) to ({:.1}, {:.1}); expected a grid in the \
                 scenario's coordinates; kept, but nothing of it is in the way",
                near.x, near.y, far.x, far.y
            );
            self.issues.push(Issue { line: 0, element: format!("occupancy grid {file}"), message });
        }
        self.occupancy = Some(grid);
    }
}

/// Something in a file that the reader repaired or left out. The map is still usable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Issue {
    /// Line in the file, 1-based; 0 when it concerns the file as a whole.
    pub line: u32,
    /// The element, with its id when it has one: `lanelet 12`.
    pub element: String,
    /// What was found, what was expected, what was done.
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
