//! What the planner knows of the obstacles: the predictions of the present observation, complete up to a horizon, and the
//! collision world built from them.
//!
//! Everything is kept as long as the observed obstacles stay the same, so that the cached checks of lattice edges stay valid.
//! New predictions renew the moving part; only a change of the static obstacles invalidates the edges.
//!
//! # After the end of a prediction
//! An obstacle does not vanish where its prediction ends. It moves on for [`Extrapolation::duration`] with its last speed and
//! heading, or as a set of positions that grows with the acceleration bounds of [`Uncertainty`]. This part of a prediction is an
//! assumption: it does not bind the vehicle in front of a follower (`traffic`), which brakes rather than drive into it.
//!
//! Weak: the last motion follows no lane. After the extrapolation, nothing is assumed of the obstacle.

use std::sync::Arc;

use super::settings::{ExtrapolatedMotion, Extrapolation, Settings, Uncertainty};
use crate::collision::{CollisionWorld, SettingsError};
use crate::geometry::{Point, Pose, Vector};
use crate::map::{Map, Motion, Obstacle, Part, Shape, TimedOccupancy, TimedPose};
use crate::vehicle::Vehicle;

/// Time between the states of an extrapolated motion, s.
const STEP: f64 = 0.5;
/// Longest horizon of predictions, s from the cycle.
const LONGEST: f64 = 60.0;
/// Where less than this is left of a horizon that ends before the predictions, it is renewed, s.
const RENEWED: f64 = 30.0;
/// The obstacles of the present observation.
pub(super) struct Known {
    /// As observed.
    pub(super) observed: Arc<[Obstacle]>,
    /// End of the predictions, s of the run.
    pub(super) horizon: f64,
    /// Counts the changes of the static obstacles.
    pub(super) statics: u64,
    /// The collision world.
    pub(super) world: CollisionWorld,
}

/// What changed with an observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Change {
    Nothing,
    Moving,
    Static,
}

impl Known {
    /// A world without obstacles.
    pub(super) fn nothing(map: Map<'_>, vehicle: &Vehicle, settings: &Settings) -> Result<Self, SettingsError> {
        let observed: Arc<[Obstacle]> = Arc::new([]);
        let world = CollisionWorld::new(map.network, map.occupancy, &observed, vehicle, &settings.collision, 0.0)?;
        Ok(Self { world, observed, horizon: 0.0, statics: 0 })
    }

    /// Whether `observed` are the obstacles known already.
    pub(super) fn is(&self, observed: &Arc<[Obstacle]>) -> bool {
        Arc::ptr_eq(&self.observed, observed)
    }

    /// Takes over the obstacles observed at `now` (s of the run).
    pub(super) fn renew(
        &mut self,
        observed: &Arc<[Obstacle]>,
        now: f64,
        map: Map<'_>,
        vehicle: &Vehicle,
        settings: &Settings,
    ) -> Result<Change, SettingsError> {
        let ends = observed.iter().map(|o| prediction_end(o, &settings.extrapolation)).fold(0.0, f64::max);
        let is_short = self.horizon < ends && self.horizon < now + RENEWED;
        if self.is(observed) && !is_short {
            return Ok(Change::Nothing);
        }
        let fixed = |obstacles: &[Obstacle]| obstacles.iter().filter(|o| o.is_static()).cloned().collect::<Vec<_>>();
        let change = if fixed(&self.observed) == fixed(observed) { Change::Moving } else { Change::Static };
        if change == Change::Moving && !is_short && self.observed[..] == observed[..] {
            self.observed = Arc::clone(observed);
            return Ok(Change::Nothing);
        }
        let horizon = ends.min(now + LONGEST);
        let complete: Vec<Obstacle> = observed.iter().flat_map(|o| completed(o, now, settings)).collect();
        match change {
            Change::Static => {
                let Map { network, occupancy } = map;
                self.world = CollisionWorld::new(network, occupancy, &complete, vehicle, &settings.collision, horizon)?;
            }
            _ => self.world = self.world.with_predictions(&complete, horizon),
        }
        (self.observed, self.horizon) = (Arc::clone(observed), horizon);
        self.statics += u64::from(change == Change::Static);
        Ok(change)
    }
}

/// The end of the prediction with its extrapolation, s of the run; −∞ for what stands still.
fn prediction_end(obstacle: &Obstacle, extrapolation: &Extrapolation) -> f64 {
    if obstacle.is_static() { f64::NEG_INFINITY } else { obstacle.lifetime().1 + extrapolation.duration }
}

/// The obstacle with a prediction that begins at `now` (s of the run) at the latest and goes on after its end; a set after a
/// trajectory is a second obstacle with the same id.
fn completed(obstacle: &Obstacle, now: f64, settings: &Settings) -> Vec<Obstacle> {
    let Extrapolation { duration, motion } = settings.extrapolation;
    let with = |motion| Obstacle { motion, ..obstacle.clone() };
    match &obstacle.motion {
        Motion::Static(_) => vec![obstacle.clone()],
        Motion::Trajectory(states) => {
            let (Some(first), Some(last)) = (states.first(), states.last()) else { return Vec::new() };
            let mut states = states.clone();
            if first.time > now {
                states.insert(0, moved_on(first, now - first.time));
            }
            if duration <= 0.0 {
                return vec![with(Motion::Trajectory(states))];
            }
            match motion {
                ExtrapolatedMotion::LastMotion => {
                    states.extend(steps(duration).map(|(_, to)| moved_on(last, to)));
                    vec![with(Motion::Trajectory(states))]
                }
                ExtrapolatedMotion::Set => {
                    let set = |(from, to)| grown(&obstacle.shape, last, (from, to), &settings.uncertainty);
                    let sets = steps(duration).map(set).collect();
                    vec![with(Motion::Trajectory(states)), with(Motion::Occupancy(sets))]
                }
            }
        }
        Motion::Occupancy(sets) => {
            let mut sets = sets.clone();
            if let Some(last) = sets.last_mut().filter(|_| duration > 0.0) {
                last.to += duration;
            }
            if let Some(first) = sets.first_mut().filter(|first| first.from > now) {
                first.from = now;
            }
            vec![with(Motion::Occupancy(sets))]
        }
    }
}

/// Times since the end of a prediction: consecutive intervals up to `duration`, s.
fn steps(duration: f64) -> impl Iterator<Item = (f64, f64)> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count of states
    let count = (duration / STEP).ceil().max(1.0) as usize;
    (0..count).map(move |i| (duration * i as f64 / count as f64, duration * (i + 1) as f64 / count as f64))
}

/// A state moved on with its speed along its heading for a time (s), or back.
fn moved_on(state: &TimedPose, by: f64) -> TimedPose {
    let (sin, cos) = state.pose.yaw.sin_cos();
    let position = state.pose.position + Vector::new(cos, sin) * (state.speed * by);
    TimedPose { time: state.time + by, pose: Pose { position, ..state.pose }, ..*state }
}

/// The positions that a shape can reach from a state, between two times after it (s): those at both times, as far apart as the
/// acceleration bounds allow at the later one.
fn grown(shape: &Shape, state: &TimedPose, (from, to): (f64, f64), bounds: &Uncertainty) -> TimedOccupancy {
    let by = 0.5 * bounds.longitudinal.max(bounds.lateral) * to * to;
    let along = 0.5 * (state.speed * (to - from)).abs();
    let middle = moved_on(state, f64::midpoint(from, to));
    let larger = |part: &Part| match part {
        Part::Rectangle { length, width, centre } => {
            Part::Rectangle { length: length + 2.0 * (by + along), width: width + 2.0 * by, centre: *centre }
        }
        other => {
            let parts = Shape { parts: vec![other.clone()] };
            Part::Circle { centre: Point::origin(), radius: parts.bounding_radius() + by + along }
        }
    };
    let region = Shape { parts: shape.parts.iter().map(larger).collect() }.moved(&middle.pose);
    TimedOccupancy { from: state.time + from, to: state.time + to, region }
}
