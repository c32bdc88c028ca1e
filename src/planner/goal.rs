//! The goal of a planning problem, seen along a reference line.

use crate::map::{Goal, GoalPosition, RoadNetwork};
use crate::reference::ReferenceLine;
use crate::vehicle::Vehicle;

/// Where the goal lies on a reference line, and what is to be done there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalOnLane {
    /// Stations of the rear axle at which the vehicle's centre is inside the goal, m.
    pub near: f64,
    /// End of that interval, m.
    pub far: f64,
    /// Highest speed that counts as reaching it, m/s.
    pub speed_limit: f64,
    /// Time window in which it counts, s of the run.
    pub window: (f64, f64),
}

/// Slower than this at the goal (m/s) means to stop there.
const STOP_SPEED: f64 = 1.0;

impl GoalOnLane {
    /// The goal's stretch of the reference line, from its start on; `None` if the line does not touch it.
    #[must_use]
    pub fn find(goal: &Goal, network: &RoadNetwork, line: &ReferenceLine, vehicle: &Vehicle) -> Option<Self> {
        /// Sampling of the line, m.
        const STEP: f64 = 0.5;
        let position = goal.position.as_ref()?;
        let (mut near, mut far) = (None, 0.0);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count of samples
        let samples = (line.length() / STEP) as usize;
        for i in 0..=samples {
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

    /// Whether the vehicle is to come to rest in the goal.
    #[must_use]
    pub fn is_stop(&self) -> bool {
        self.speed_limit < STOP_SPEED
    }

    /// The station to stop at, if the goal asks for a stop or is reached before its time window opens.
    #[must_use]
    pub fn stop_station(&self) -> f64 {
        // the middle, but not deep into a long region
        self.near + (0.5 * (self.far - self.near)).min(5.0)
    }

    /// The speed that brings the vehicle from `station` at `time` to the goal just inside its time window, if driving
    /// faster would be too early.
    #[must_use]
    pub fn speed_for_window(&self, station: f64, time: f64) -> f64 {
        let (opens, _) = self.window;
        if time >= opens || station >= self.far {
            return f64::INFINITY;
        }
        // be at the far end when the window has been open for half a second
        (self.far - station) / (opens + 0.5 - time)
    }
}
