//! Predictions of the obstacles in sight.
//!
//! * `recorded`: the motion that the scenario records. The planner knows the future.
//! * `constant-velocity`: with the present speed and heading.
//! * `lane-following`: with the present speed and distance from the centre line, along the lanelet that the obstacle is on and
//!   the straightest of its successors; with constant velocity where it is on no lanelet of its direction.
//!
//! Static obstacles and prediction sets keep what is recorded: a set has no speed that could be continued.
//!
//! Weak: one motion per obstacle, constant speed, no interaction.

use crate::geometry::polyline::Polyline;
use crate::geometry::{Pose, Vector, wrap_angle};
use crate::map::{LaneletId, Motion, Obstacle, RoadNetwork, TimedPose};

/// How the motion of obstacles is predicted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PredictionMode {
    /// As the scenario records it.
    #[default]
    Recorded,
    /// With the present speed and heading.
    ConstantVelocity,
    /// With the present speed along the lane.
    LaneFollowing,
}

impl PredictionMode {
    /// Every mode.
    pub const ALL: [Self; 3] = [Self::Recorded, Self::ConstantVelocity, Self::LaneFollowing];

    /// The stable name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Recorded => "recorded",
            Self::ConstantVelocity => "constant-velocity",
            Self::LaneFollowing => "lane-following",
        }
    }
}

/// Time between predicted states, s.
const STEP: f64 = 0.2;
/// An obstacle follows a lanelet whose direction differs from its heading by less than this, rad.
const ALONG: f64 = std::f64::consts::FRAC_PI_4;
/// Largest number of lanelets that a prediction follows.
const MAX_LANELETS: usize = 50;

/// An obstacle with its prediction for `horizon` seconds from `seen_at` (s of the run) on.
pub(super) fn predicted(
    obstacle: &Obstacle,
    seen_at: f64,
    horizon: f64,
    mode: PredictionMode,
    network: &RoadNetwork,
) -> Obstacle {
    let state = obstacle.state_at(seen_at.max(0.0)).filter(|_| matches!(obstacle.motion, Motion::Trajectory(_)));
    let states = match (state, mode) {
        (None, _) | (_, PredictionMode::Recorded) => return obstacle.clone(),
        (Some(state), PredictionMode::ConstantVelocity) => times(horizon).map(|t| straight_on(&state, t)).collect(),
        (Some(state), PredictionMode::LaneFollowing) => match Followed::from(&state, horizon, network) {
            Some(lane) => times(horizon).map(|t| lane.after(&state, t)).collect(),
            None => times(horizon).map(|t| straight_on(&state, t)).collect(),
        },
    };
    Obstacle { motion: Motion::Trajectory(states), ..obstacle.clone() }
}

fn times(horizon: f64) -> impl Iterator<Item = f64> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count of states
    let count = (horizon / STEP).ceil() as usize;
    (0..=count).map(|i| i as f64 * STEP)
}

/// A state moved on with its speed and heading.
fn straight_on(state: &TimedPose, after: f64) -> TimedPose {
    let (sin, cos) = state.pose.yaw.sin_cos();
    let position = state.pose.position + Vector::new(cos, sin) * (state.speed * after);
    TimedPose { time: state.time + after, pose: Pose { position, ..state.pose }, ..*state }
}

/// The centre line that an obstacle follows.
struct Followed {
    line: Polyline,
    /// Station of the obstacle on it, m.
    station: f64,
    /// Its distance from the line, to the left, m.
    offset: f64,
    /// Its heading relative to the line, rad.
    heading: f64,
}

impl Followed {
    /// The lane of a state, as far as it gets; `None` if it is on no lanelet in its direction.
    fn from(state: &TimedPose, horizon: f64, network: &RoadNetwork) -> Option<Self> {
        let position = state.pose.position;
        let heading_to = |line: &Polyline| wrap_angle(state.pose.yaw - line.yaw_at(line.project(position).station));
        let on = network.lanelets.values().filter(|l| l.is_drivable() && l.contains(position));
        let on = on.map(|l| (heading_to(&l.centre).abs(), l.id)).filter(|(apart, _)| *apart < ALONG);
        let (_, first) = on.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let reach = state.speed.max(0.0) * horizon;
        let line = chain(network, first, reach + network.lanelets.get(&first)?.centre.length())?;
        let at = line.project(position);
        Some(Self { station: at.station, offset: at.offset, heading: heading_to(&line), line })
    }

    fn after(&self, state: &TimedPose, after: f64) -> TimedPose {
        let station = self.station + state.speed * after;
        let on_line = station.clamp(0.0, self.line.length());
        let yaw = self.line.yaw_at(on_line);
        let (sin, cos) = yaw.sin_cos();
        let beyond = Vector::new(cos, sin) * (station - on_line);
        let position = self.line.at(on_line) + Vector::new(-sin, cos) * self.offset + beyond;
        TimedPose { time: state.time + after, pose: Pose { position, yaw: yaw + self.heading }, ..*state }
    }
}

/// The centre line of a lanelet and the straightest successors, at least `length` metres long if the road is.
fn chain(network: &RoadNetwork, first: LaneletId, length: f64) -> Option<Polyline> {
    let mut lanelet = network.lanelets.get(&first)?;
    let mut points = lanelet.centre.points().to_vec();
    let mut so_far = lanelet.centre.length();
    for _ in 0..MAX_LANELETS {
        if so_far >= length {
            break;
        }
        let leaves = lanelet.centre.yaw_at(lanelet.centre.length());
        let bend = |id: &LaneletId| {
            network.lanelets.get(id).map(|l| wrap_angle(l.centre.yaw_at(l.centre.length()) - leaves).abs())
        };
        let next = lanelet.successors.iter().filter_map(|id| Some((bend(id)?, *id))).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some(next) = next.and_then(|(_, id)| network.lanelets.get(&id)) else { break };
        lanelet = next;
        points.extend_from_slice(lanelet.centre.points());
        so_far += lanelet.centre.length();
    }
    Polyline::new(points)
}
