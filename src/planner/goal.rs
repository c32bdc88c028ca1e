//! The goal of a planning problem in the coordinates of a reference line.

use crate::geometry::steps::fitting;
use crate::map::{Goal, GoalPosition, RoadNetwork};
use crate::reference::ReferenceLine;
use crate::vehicle::Vehicle;

/// The goal on a reference line: stations, speed and time window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalOnLane {
    /// First station of the rear axle at which the vehicle's centre is inside the goal, m.
    pub near: f64,
    /// Last such station, m.
    pub far: f64,
    /// Highest permitted speed at the goal, m/s.
    pub speed_limit: f64,
    /// Time window of the goal, s of the run.
    pub window: (f64, f64),
}

/// A goal with a lower speed limit than this (m/s) requires a stop.
const STOP_SPEED: f64 = 1.0;

impl GoalOnLane {
    /// The first interval of the reference line inside the goal; `None` if the line does not meet it or the goal has no
    /// position.
    #[must_use]
    pub fn find(goal: &Goal, network: &RoadNetwork, line: &ReferenceLine, vehicle: &Vehicle) -> Option<Self> {
        /// Sampling of the line, m.
        const STEP: f64 = 0.5;
        let position = goal.position.as_ref()?;
        let (mut near, mut far) = (None, 0.0);
        for i in 0..=fitting(line.length(), STEP) {
            let station = i as f64 * STEP;
            let centre = vehicle.centre_of_rear_axle(&line.at(station).pose);
            let inside = match position {
                GoalPosition::Shapes(shape) => shape.contains(centre.position),
                GoalPosition::Lanelets(ids) => {
                    ids.iter().any(|id| network.lanelets.get(id).is_some_and(|l| l.contains(centre.position)))
                }
            };
            if inside {
                near.get_or_insert(station);
                far = station;
            } else if near.is_some() {
                break;
            }
        }
        near.map(|near| Self {
            near,
            far,
            speed_limit: goal.speed.map_or(f64::INFINITY, |s| s.max),
            window: (goal.time.min, goal.time.max),
        })
    }

    /// Whether the goal requires a stop.
    #[must_use]
    pub fn is_stop(&self) -> bool {
        self.speed_limit < STOP_SPEED
    }

    /// Station for a stop in the goal, m.
    #[must_use]
    pub fn stop_station(&self) -> f64 {
        // the middle, at most 5 m into a long region
        self.near + (0.5 * (self.far - self.near)).min(5.0)
    }

    /// The speed with which the vehicle reaches the goal from `station` at `time` just after its time window opens, m/s;
    /// infinite if no speed is too early.
    #[must_use]
    pub fn speed_for_window(&self, station: f64, time: f64) -> f64 {
        let (opens, _) = self.window;
        if time >= opens || station >= self.far {
            return f64::INFINITY;
        }
        // arrive at the far end half a second after the window opens
        (self.far - station) / (opens + 0.5 - time)
    }
}
