//! Obstacles as colliders: fixed, moving on a trajectory, or regions that exist for an interval.

use std::sync::Arc;

use rapier2d::dynamics::{RigidBodyBuilder, RigidBodyHandle, RigidBodySet};
use rapier2d::geometry::SharedShape;
use rapier2d::math::{Pose as RapierPose, Vector as RapierVector};

use super::SimulationError;
use super::convert::{Frame, local};
use super::physics::Physics;
use crate::geometry::{Point, Pose};
use crate::map::{ConvexPart, Motion, Obstacle, Shape};

/// All obstacles of a world. What never changes is shared between clones.
#[derive(Clone)]
pub(super) struct Obstacles {
    plan: Arc<Plan>,
    /// Per obstacle: its body, while it exists, and for set-based ones the index of the set.
    bodies: Vec<Option<(RigidBodyHandle, usize)>>,
}

struct Plan {
    frame: Frame,
    entries: Vec<Entry>,
}

struct Entry {
    obstacle: Obstacle,
    /// Colliders of the shape in its own frame; for sets, of each region in the physics frame.
    shapes: Vec<Vec<(RapierPose, SharedShape)>>,
}

impl Obstacles {
    /// Checks the obstacles and prepares their colliders.
    pub(super) fn new(obstacles: &[Obstacle], frame: &Frame) -> Result<Self, SimulationError> {
        let entries = obstacles.iter().map(|o| Entry::new(o, frame)).collect::<Result<Vec<_>, _>>()?;
        let bodies = vec![None; entries.len()];
        Ok(Self { plan: Arc::new(Plan { frame: *frame, entries }), bodies })
    }

    /// The id of the obstacle whose colliders carry this user data.
    pub(super) fn id(&self, user_data: u128) -> Option<i64> {
        self.plan.entries.get(usize::try_from(user_data).ok()?).map(|e| e.obstacle.id)
    }

    /// Creates the bodies of obstacles that exist at `time`, and removes those that do not any more.
    pub(super) fn place(&mut self, physics: &mut Physics, time: f64) {
        for (index, entry) in self.plan.entries.iter().enumerate() {
            let now = self.bodies[index];
            if now.is_some() && entry.obstacle.is_static() {
                continue;
            }
            let wanted = entry.present(time);
            if wanted == now.map(|(_, set)| set) {
                continue;
            }
            if let Some((body, _)) = now {
                physics.remove(body);
            }
            self.bodies[index] = wanted.map(|set| {
                let body = match &entry.obstacle.motion {
                    Motion::Trajectory(_) => RigidBodyBuilder::kinematic_position_based(),
                    Motion::Static(_) | Motion::Occupancy(_) => RigidBodyBuilder::fixed(),
                };
                let pose = entry.obstacle.pose_at(time).map(|p| self.plan.frame.pose_in(&p)).unwrap_or_default();
                (physics.insert(body.pose(pose), &entry.shapes[set], index as u128), set)
            });
        }
    }

    /// Sends the moving obstacles to where they are at `time`, the end of the coming step.
    pub(super) fn drive(&self, bodies: &mut RigidBodySet, time: f64) {
        for (entry, body) in self.plan.entries.iter().zip(&self.bodies) {
            if let (Motion::Trajectory(_), Some((handle, _))) = (&entry.obstacle.motion, body)
                && let (Some(pose), Some(body)) = (entry.obstacle.pose_at(time), bodies.get_mut(*handle))
            {
                body.set_next_kinematic_position(self.plan.frame.pose_in(&pose));
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
            made.ok_or(wrong("a shape that is not finite, or of no size"))
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
        Ok(Self { obstacle: obstacle.clone(), shapes })
    }

    /// Which of the shapes exists at `time`.
    fn present(&self, time: f64) -> Option<usize> {
        match &self.obstacle.motion {
            Motion::Static(_) => Some(0),
            Motion::Trajectory(_) => self.obstacle.pose_at(time).map(|_| 0),
            Motion::Occupancy(sets) => sets.iter().position(|s| s.from <= time && time <= s.to),
        }
    }
}

/// A collider for a convex piece, with its place. Polygons without area become their outline: a wall is still a wall.
fn collider_shape(part: &ConvexPart, place: &dyn Fn(Point) -> RapierVector) -> Option<(RapierPose, SharedShape)> {
    match part {
        ConvexPart::Circle { centre, radius } => {
            let centre = place(*centre);
            let ok = centre.is_finite() && radius.is_finite() && *radius > 0.0;
            ok.then(|| (RapierPose::from_translation(centre), SharedShape::ball(*radius)))
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

fn is_finite(pose: &Pose) -> bool {
    pose.yaw.is_finite() && pose.position.coords.iter().all(|v| v.is_finite())
}
