//! Obstacles as colliders: fixed, moving on a trajectory, or regions that exist for an interval.
//!
//! Most moving obstacles are far away most of the time. An obstacle that cannot meet the vehicle before the next review
//! ([`REVIEW`]) has no body until then. The check bounds the motion of the obstacle by its prediction and that of the
//! vehicle by its grip, so no contact is missed.

use std::sync::Arc;

use rapier2d::dynamics::{RigidBodyBuilder, RigidBodyHandle, RigidBodySet};
use rapier2d::geometry::SharedShape;
use rapier2d::math::{Pose as RapierPose, Vector as RapierVector};

use super::SimulationError;
use super::convert::{Frame, local};
use super::physics::Physics;
use crate::geometry::{Point, Pose, Vector};
use crate::map::{ConvexPart, Motion, Obstacle, Shape, TimedPose};

/// Time between reviews of the obstacles near the vehicle, s.
pub(super) const REVIEW: f64 = 0.1;

/// All obstacles of a world. Clones share the constant part.
#[derive(Clone)]
pub(super) struct Obstacles {
    shared: Arc<Shared>,
    /// Per obstacle: its body while it exists; for a set-based one with the index of the set.
    bodies: Vec<Option<(RigidBodyHandle, usize)>>,
    /// Per obstacle: whether it may meet the vehicle before the next review.
    near: Vec<bool>,
}

/// The part that does not change in a run.
struct Shared {
    frame: Frame,
    entries: Vec<Entry>,
}

struct Entry {
    obstacle: Obstacle,
    /// Colliders of the shape in its own frame; for sets, of each region in the physics frame.
    shapes: Vec<Vec<(RapierPose, SharedShape)>>,
    /// Bounding circles of the shapes: about the frame's origin; for sets, about each region's middle in world
    /// coordinates, m.
    circles: Vec<(Point, f64)>,
}

impl Obstacles {
    /// Checks the obstacles and prepares their colliders.
    pub(super) fn new(obstacles: &[Obstacle], frame: &Frame) -> Result<Self, SimulationError> {
        let entries = obstacles.iter().map(|o| Entry::new(o, frame)).collect::<Result<Vec<_>, _>>()?;
        let (bodies, near) = (vec![None; entries.len()], vec![false; entries.len()]);
        Ok(Self { shared: Arc::new(Shared { frame: *frame, entries }), bodies, near })
    }

    /// The id of the obstacle whose colliders carry this user data.
    pub(super) fn id(&self, user_data: u128) -> Option<i64> {
        self.shared.entries.get(usize::try_from(user_data).ok()?).map(|e| e.obstacle.id)
    }

    /// Finds the obstacles that come within `reach` of a position between `time` and the next review.
    pub(super) fn review(&mut self, time: f64, position: Point, reach: f64) {
        for (entry, near) in self.shared.entries.iter().zip(&mut self.near) {
            *near = entry.comes_near(time, position, reach);
        }
    }

    /// Creates the bodies of near obstacles that exist at `time`, and removes those of all others.
    pub(super) fn place(&mut self, physics: &mut Physics, time: f64) {
        for (index, entry) in self.shared.entries.iter().enumerate() {
            let now = self.bodies[index];
            if now.is_some() && entry.obstacle.is_static() {
                continue;
            }
            if !self.near[index] && now.is_none() {
                continue;
            }
            let required = if self.near[index] { entry.present(time) } else { None };
            if required == now.map(|(_, set)| set) {
                continue;
            }
            if let Some((body, _)) = now {
                physics.remove(body);
            }
            self.bodies[index] = required.map(|set| {
                let body = match &entry.obstacle.motion {
                    Motion::Trajectory(_) => RigidBodyBuilder::kinematic_position_based(),
                    Motion::Static(_) | Motion::Occupancy(_) => RigidBodyBuilder::fixed(),
                };
                let pose = entry.obstacle.pose_at(time).map(|p| self.shared.frame.pose_in(&p)).unwrap_or_default();
                (physics.insert(body.pose(pose), &entry.shapes[set], index as u128), set)
            });
        }
    }

    /// Moves the obstacles to their poses at `time`, the end of the coming step.
    pub(super) fn drive(&self, bodies: &mut RigidBodySet, time: f64) {
        for (entry, body) in self.shared.entries.iter().zip(&self.bodies) {
            if let (Motion::Trajectory(_), Some((handle, _))) = (&entry.obstacle.motion, body)
                && let (Some(pose), Some(body)) = (entry.obstacle.pose_at(time), bodies.get_mut(*handle))
            {
                body.set_next_kinematic_position(self.shared.frame.pose_in(&pose));
            }
        }
    }
}

impl Entry {
    fn new(obstacle: &Obstacle, frame: &Frame) -> Result<Self, SimulationError> {
        let wrong = |message| SimulationError::Obstacle { id: obstacle.id, message };
        let colliders = |shape: &Shape, place: &dyn Fn(Point) -> RapierVector| {
            let parts = shape.convex_parts();
            if parts.is_empty() {
                return Err(wrong("no shape; expected at least one part"));
            }
            let made: Option<Vec<_>> = parts.iter().map(|part| collider_shape(part, place)).collect();
            made.ok_or(wrong("a shape that is not finite or has no size"))
        };
        let shapes = match &obstacle.motion {
            Motion::Static(pose) => {
                if !is_finite(pose) {
                    return Err(wrong("a pose that is not finite"));
                }
                vec![colliders(&obstacle.shape, &local)?]
            }
            Motion::Trajectory(states) => {
                if !states.iter().all(|s| s.time.is_finite() && is_finite(&s.pose)) {
                    return Err(wrong("a state that is not finite"));
                }
                vec![colliders(&obstacle.shape, &local)?]
            }
            Motion::Occupancy(sets) => {
                let place = |p| frame.point_in(p);
                sets.iter().map(|set| colliders(&set.region, &place)).collect::<Result<_, _>>()?
            }
        };
        let circles = match &obstacle.motion {
            Motion::Occupancy(sets) => sets.iter().map(|set| bounding_circle(&set.region)).collect(),
            _ => vec![(Point::origin(), obstacle.shape.bounding_radius())],
        };
        Ok(Self { obstacle: obstacle.clone(), shapes, circles })
    }

    /// Whether the obstacle may come within `reach` of a position between `time` and the next review. Conservative: no
    /// false negatives.
    fn comes_near(&self, time: f64, position: Point, reach: f64) -> bool {
        // longer than the interval: obstacles move to their poses at the end of a step
        let until = time + 1.5 * REVIEW;
        match &self.obstacle.motion {
            Motion::Static(_) => true,
            Motion::Trajectory(states) => {
                let Some(&(_, radius)) = self.circles.first() else { return false };
                let first = states.partition_point(|s| s.time <= time).saturating_sub(1);
                let last = states.partition_point(|s| s.time <= until).min(states.len().saturating_sub(1));
                let Some(window) = states.get(first..=last) else { return false };
                let distance = |s: &TimedPose| (s.pose.position - position).norm();
                let travel: f64 = window.windows(2).map(|w| (w[1].pose.position - w[0].pose.position).norm()).sum();
                window.first().is_some_and(|s| distance(s) - travel <= reach + radius)
            }
            Motion::Occupancy(sets) => sets.iter().zip(&self.circles).any(|(set, (centre, radius))| {
                set.from <= until && time <= set.to && (centre - position).norm() <= reach + radius
            }),
        }
    }

    /// Index of the shape that exists at `time`.
    fn present(&self, time: f64) -> Option<usize> {
        match &self.obstacle.motion {
            Motion::Static(_) => Some(0),
            Motion::Trajectory(_) => self.obstacle.pose_at(time).map(|_| 0),
            Motion::Occupancy(sets) => sets.iter().position(|s| s.from <= time && time <= s.to),
        }
    }
}

/// A collider for a convex part, with its position. A polygon without area becomes its outline: it still is a wall.
fn collider_shape(part: &ConvexPart, place: &dyn Fn(Point) -> RapierVector) -> Option<(RapierPose, SharedShape)> {
    match part {
        ConvexPart::Circle { centre, radius } => {
            let centre = place(*centre);
            let is_valid = centre.is_finite() && radius.is_finite() && *radius > 0.0;
            is_valid.then(|| (RapierPose::from_translation(centre), SharedShape::ball(*radius)))
        }
        ConvexPart::Polygon(points) => {
            let points: Vec<_> = points.iter().map(|p| place(*p)).collect();
            if points.len() < 2 || !points.iter().all(|p| p.is_finite()) {
                return None;
            }
            let shape = SharedShape::convex_hull(&points).unwrap_or_else(|| SharedShape::polyline(points, None));
            Some((RapierPose::IDENTITY, shape))
        }
    }
}

/// A circle that contains the whole shape, in the shape's frame.
fn bounding_circle(shape: &Shape) -> (Point, f64) {
    let parts = shape.convex_parts();
    let points: Vec<Point> = parts
        .iter()
        .flat_map(|part| match part {
            ConvexPart::Polygon(points) => points.clone(),
            ConvexPart::Circle { centre, .. } => vec![*centre],
        })
        .collect();
    let middle = Point::from(points.iter().map(|p| p.coords).sum::<Vector>() / points.len().max(1) as f64);
    let radius = parts.iter().fold(0.0, |r: f64, part| {
        r.max(match part {
            ConvexPart::Polygon(points) => points.iter().fold(0.0, |r: f64, p| r.max((p - middle).norm())),
            ConvexPart::Circle { centre, radius } => (centre - middle).norm() + radius,
        })
    });
    (middle, radius)
}

fn is_finite(pose: &Pose) -> bool {
    pose.yaw.is_finite() && pose.position.coords.iter().all(|v| v.is_finite())
}
