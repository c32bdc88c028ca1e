//! What the vehicle observes: the obstacles in sight at the time of a cycle, each with a prediction.
//!
//! An obstacle that is not born yet, is gone, or is out of sight is not in the observation. A record that ends on the road does not say
//! that the obstacle has gone: it is remembered where the record ends for as long as the planner extrapolates its motion
//! (`planner.extrapolation.duration`). The verdict keeps CommonRoad's meaning, in which it is gone. The sensor sees all around and
//! without a limit by default; `[observation.sensor]` gives it a range, a field of view, occlusion, a delay and misses. With a
//! delay it shows the obstacles as they were, with predictions from then on. An obstacle is occluded if the straight lines from
//! the sensor, at the centre of the vehicle, to its centre and its corners all cross another obstacle.
//!
//! Weak: there is no tracking, so that an obstacle that is occluded for a moment is forgotten for that moment; occupied cells
//! occlude nothing, and positions have no error. Static obstacles are seen by the same rules.

use std::sync::Arc;

use super::Settings;
use super::prediction::{self, PredictionMode};
use crate::geometry::{Point, Pose, Vector, cross, wrap_angle};
use crate::map::{ConvexPart, Goal, Obstacle, PlanningProblem, Scenario};
use crate::planner::Observation;
use crate::settings::{SettingsError, each_once, within};
use crate::vehicle::{State, Vehicle};

/// Settings of the observations; the section `[observation]` of a settings file.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObservationSettings {
    /// How the motion of the obstacles in sight is predicted.
    pub prediction: PredictionMode,
    /// Length of predictions that are not recorded, s.
    pub prediction_horizon: f64,
    /// What is in sight.
    pub sensor: Sensor,
}

impl Default for ObservationSettings {
    fn default() -> Self {
        Self { prediction: PredictionMode::default(), prediction_horizon: 6.0, sensor: Sensor::default() }
    }
}

/// What of the obstacles is in sight.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sensor {
    /// Largest distance from the centre of the vehicle to the nearest corner or the centre of an obstacle in sight, m.
    pub range: f64,
    /// Angle of the field of view around the heading, degrees.
    pub fov: f64,
    /// Whether obstacles hide each other.
    pub occlusion: bool,
    /// Age of what is seen, s.
    pub delay: f64,
    /// Probability that an obstacle is missed in a cycle.
    pub missed: f64,
    /// Random seed of the misses.
    pub seed: u64,
}

impl Default for Sensor {
    fn default() -> Self {
        Self { range: f64::INFINITY, fov: 360.0, occlusion: false, delay: 0.0, missed: 0.0, seed: 0 }
    }
}

impl ObservationSettings {
    /// Checks the range of every value.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        within("prediction_horizon", self.prediction_horizon, 0.1..=60.0, "s")?;
        self.sensor.validate().map_err(|e| e.in_table("sensor"))
    }
}

impl Sensor {
    /// The names of all properties.
    pub const NAMES: [&'static str; 6] = ["range", "fov", "occlusion", "delay", "missed", "seed"];

    /// Sets properties, written `name=value,name=value`; `occlusion` alone switches it on.
    ///
    /// # Errors
    /// An unknown name or one that is given twice, or a value that is not of its kind or out of its range.
    pub fn set(&mut self, text: &str) -> Result<(), String> {
        let pairs = text.split(',').map(|property| {
            let (name, value) = property.split_once('=').unwrap_or((property, ""));
            (name.trim(), value.trim())
        });
        each_once(pairs.clone().map(|(name, _)| name))?;
        for (name, value) in pairs {
            let number = || value.parse::<f64>().map_err(|_| format!("{name}: `{value}` is not a number"));
            match name {
                "range" => self.range = number()?,
                "fov" => self.fov = number()?,
                "delay" => self.delay = number()?,
                "missed" => self.missed = number()?,
                "occlusion" => {
                    self.occlusion = match value {
                        "" | "true" | "on" => true,
                        "false" | "off" => false,
                        other => return Err(format!("occlusion: `{other}` is neither on nor off")),
                    }
                }
                "seed" => {
                    let wrong = |_| format!("seed: `{value}` is not a whole number from 0 to {}", u64::MAX);
                    self.seed = value.parse().map_err(wrong)?;
                }
                other => return Err(format!("unknown property `{other}`; expected {}", Self::NAMES.join(", "))),
            }
        }
        self.validate().map_err(|e| format!("{} must be {}", e.field, e.expected))
    }

    fn validate(&self) -> Result<(), SettingsError> {
        within("range", self.range, 0.0..=f64::INFINITY, "m")?;
        within("fov", self.fov, 0.0..=360.0, "degrees")?;
        within("delay", self.delay, 0.0..=5.0, "s")?;
        within("missed", self.missed, 0.0..=1.0, "")
    }
}

/// Makes the observations of a run from a scenario.
pub struct Observer<'a> {
    scenario: &'a Scenario,
    vehicle: &'a Vehicle,
    settings: &'a Settings,
    goals: Arc<[Goal]>,
    /// The last obstacles, and which of the scenario they are: recorded predictions do not change.
    last: Option<(Vec<usize>, Arc<[Obstacle]>)>,
}

impl<'a> Observer<'a> {
    /// An observer in a scenario with one of its problems.
    #[must_use]
    pub fn new(
        scenario: &'a Scenario,
        problem: &PlanningProblem,
        vehicle: &'a Vehicle,
        settings: &'a Settings,
    ) -> Self {
        Self { scenario, vehicle, settings, goals: problem.goals.as_slice().into(), last: None }
    }

    /// The observation in a state of the vehicle.
    pub fn observe(&mut self, state: &State) -> Observation {
        let ObservationSettings { prediction, prediction_horizon, sensor } = self.settings.observation;
        let seen_at = state.time - sensor.delay;
        let in_sight = self.in_sight(&state.pose, state.time, seen_at);
        let obstacles = match self.last.take().filter(|_| prediction == PredictionMode::Recorded) {
            Some((indices, obstacles)) if indices == in_sight => obstacles,
            _ => {
                let predicted = |i: &usize| {
                    let obstacle = &self.scenario.obstacles[*i];
                    let last_seen = seen_at.min(obstacle.lifetime().1);
                    prediction::predicted(obstacle, last_seen, prediction_horizon, prediction, &self.scenario.network)
                };
                in_sight.iter().map(predicted).collect()
            }
        };
        self.last = Some((in_sight, Arc::clone(&obstacles)));
        Observation {
            state: *state,
            obstacles,
            goals: Arc::clone(&self.goals),
            friction: self.settings.believed_friction(),
        }
    }

    /// The indices of the obstacles that the sensor shows.
    fn in_sight(&self, pose: &Pose, now: f64, seen_at: f64) -> Vec<usize> {
        let sensor = &self.settings.observation.sensor;
        let exists: Vec<(usize, Vec<ConvexPart>)> = self
            .scenario
            .obstacles
            .iter()
            .enumerate()
            .map(|(i, o)| (i, self.last_place(o, seen_at)))
            .filter(|(_, parts)| !parts.is_empty())
            .collect();
        let eye = self.vehicle.centre_of_rear_axle(pose);
        let half_view = 0.5 * sensor.fov.to_radians();
        let is_seen = |(i, parts): &(usize, Vec<ConvexPart>)| {
            let others = || exists.iter().filter(|(j, _)| j != i).flat_map(|(_, parts)| parts);
            let visible = |p: &Point| {
                let to = p - eye.position;
                to.norm() <= sensor.range
                    && (sensor.fov >= 360.0 || wrap_angle(to.y.atan2(to.x) - eye.yaw).abs() <= half_view)
                    && !(sensor.occlusion && others().any(|part| crosses(part, eye.position, *p)))
            };
            parts.iter().flat_map(points_of).any(|p| visible(&p)) && !sensor.misses(self.scenario.obstacles[*i].id, now)
        };
        exists.iter().filter(|e| is_seen(e)).map(|(i, _)| *i).collect()
    }

    /// What an obstacle occupies at a time (s), or occupied when its record ended, for as long as the planner extrapolates it.
    fn last_place(&self, obstacle: &Obstacle, time: f64) -> Vec<ConvexPart> {
        let (_, ends) = obstacle.lifetime();
        let is_remembered = time <= ends + self.settings.planner.extrapolation.duration;
        occupied(obstacle, if is_remembered { time.min(ends) } else { time })
    }
}

/// What an obstacle occupies at a time (s); nothing while it does not exist. Before the run nothing has moved yet.
fn occupied(obstacle: &Obstacle, time: f64) -> Vec<ConvexPart> {
    obstacle.occupied_at(time.max(0.0))
}

/// Centre and corners of a part; of a circle, its outermost points.
fn points_of(part: &ConvexPart) -> Vec<Point> {
    match part {
        ConvexPart::Polygon(points) => {
            let sum = points.iter().fold(Point::origin().coords, |sum, p| sum + p.coords);
            let centre = Point::from(sum / points.len().max(1) as f64);
            points.iter().copied().chain([centre]).collect()
        }
        ConvexPart::Circle { centre, radius } => {
            let around = [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
            around.map(|(x, y)| Point::new(centre.x + radius * x, centre.y + radius * y)).to_vec()
        }
    }
}

/// Whether the segment between two points passes through a part.
fn crosses(part: &ConvexPart, from: Point, to: Point) -> bool {
    let along = to - from;
    match part {
        ConvexPart::Circle { centre, radius } => {
            let t = ((centre - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
            (from + along * t - centre).norm() < *radius
        }
        ConvexPart::Polygon(points) => {
            let edges = points.iter().zip(points.iter().cycle().skip(1));
            edges.into_iter().any(|(a, b)| {
                let apart = |o: Point, d: Vector, p: [Point; 2]| cross(d, p[0] - o) * cross(d, p[1] - o) < 0.0;
                apart(from, along, [*a, *b]) && apart(*a, b - a, [from, to])
            })
        }
    }
}

impl Sensor {
    /// Whether an obstacle is missed at a time (s): the same for the same seed, obstacle and time.
    fn misses(&self, id: i64, now: f64) -> bool {
        /// Resolution of times, s.
        const TICK: f64 = 1e-3;
        if self.missed <= 0.0 {
            return false;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // only the bits matter
        let tick = (now / TICK).round() as i64 as u64;
        // SplitMix64 (Steele, Lea and Flood 2014)
        let mut z = self.seed ^ (id.cast_unsigned()).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ tick.rotate_left(32);
        for multiplier in [0xBF58_476D_1CE4_E5B9, 0x94D0_49BB_1331_11EB] {
            z = (z ^ (z >> 30)).wrapping_add(0x9E37_79B9_7F4A_7C15).wrapping_mul(multiplier);
        }
        let uniform = ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64;
        uniform < self.missed
    }
}
