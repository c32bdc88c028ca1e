//! Rapier's sets, and their integration. There are no constraints to solve: rapier integrates the chassis, moves the
//! obstacles and finds the contacts.

use rapier2d::dynamics::{
    CCDSolver, ImpulseJointSet, IntegrationParameters, IslandManager, MultibodyJointSet, RigidBodyBuilder,
    RigidBodyHandle, RigidBodySet, SoftBodySet,
};
use rapier2d::geometry::{
    BroadPhaseBvh, ColliderBuilder, ColliderHandle, ColliderSet, Group, InteractionGroups, InteractionTestMode,
    NarrowPhase, SharedShape,
};
use rapier2d::math::{Pose as RapierPose, Vector as RapierVector};
use rapier2d::pipeline::PhysicsPipeline;
use rapier2d::prelude::MassProperties;

use super::SimulationError;
use super::chassis::Wrench;
use super::convert::{Frame, local, vector};
use crate::vehicle::{Footprint, State, Vehicle};

/// Rapier's sets, and their integration.
pub(super) struct Physics {
    parameters: IntegrationParameters,
    pipeline: PhysicsPipeline,
    islands: IslandManager,
    broad_phase: BroadPhaseBvh,
    pub(super) narrow_phase: NarrowPhase,
    pub(super) bodies: RigidBodySet,
    pub(super) colliders: ColliderSet,
    impulse_joints: ImpulseJointSet,
    multibody_joints: MultibodyJointSet,
    soft_bodies: SoftBodySet,
    ccd: CCDSolver,
}

/// The collider of one part of the vehicle's footprint.
#[derive(Debug, Clone, Copy)]
pub(super) struct PartCollider {
    pub(super) collider: ColliderHandle,
    /// Distance of the collider's frame ahead of the rear axle, m.
    pub(super) at: f64,
}

/// Shapes of the footprint's parts, each with the distance of its frame ahead of the rear axle, m.
fn part_shapes(footprint: &Footprint) -> Result<Vec<(f64, SharedShape)>, SimulationError> {
    if footprint.is_rectangle() {
        let cuboid = SharedShape::cuboid(0.5 * footprint.length(), 0.5 * footprint.width());
        return Ok(vec![(footprint.rear_axle_to_centre(), cuboid)]);
    }
    let polygon = |corners: &Vec<_>| {
        let shape = SharedShape::convex_polyline(corners.iter().map(|p| local(*p)).collect());
        shape.map(|shape| (0.0, shape)).ok_or(SimulationError::Footprint)
    };
    footprint.parts().iter().map(polygon).collect()
}

impl Clone for Physics {
    fn clone(&self) -> Self {
        Self {
            parameters: self.parameters,
            // only scratch memory between steps
            pipeline: PhysicsPipeline::new(),
            islands: self.islands.clone(),
            broad_phase: self.broad_phase.clone(),
            narrow_phase: self.narrow_phase.clone(),
            bodies: self.bodies.clone(),
            colliders: self.colliders.clone(),
            impulse_joints: self.impulse_joints.clone(),
            multibody_joints: self.multibody_joints.clone(),
            soft_bodies: self.soft_bodies.clone(),
            ccd: self.ccd.clone(),
        }
    }
}

impl Physics {
    pub(super) fn new(step: f64) -> Self {
        let parameters = IntegrationParameters {
            dt: step,
            // no constraints: tyres push the only dynamic body
            num_solver_iterations: 1,
            // at 1 ms nothing tunnels, and motion must not be clamped before a contact
            max_ccd_substeps: 0,
            normalized_max_linear_velocity: f64::MAX,
            // contacts of exactly this step's poses
            contact_recycling: false,
            ..IntegrationParameters::default()
        };
        Self {
            parameters,
            pipeline: PhysicsPipeline::new(),
            islands: IslandManager::new(),
            broad_phase: BroadPhaseBvh::new(),
            narrow_phase: NarrowPhase::new(),
            bodies: RigidBodySet::new(),
            colliders: ColliderSet::new(),
            impulse_joints: ImpulseJointSet::new(),
            multibody_joints: MultibodyJointSet::new(),
            soft_bodies: SoftBodySet::new(),
            ccd: CCDSolver::new(),
        }
    }

    /// Inserts the chassis, its frame at the centre of mass, with the parts of the footprint as colliders. Mass and
    /// inertia are the vehicle's; the colliders have none.
    pub(super) fn insert_vehicle(
        &mut self,
        vehicle: &Vehicle,
        frame: &Frame,
        initial: &State,
    ) -> Result<(RigidBodyHandle, Vec<PartCollider>), SimulationError> {
        let to_mass = vehicle.rear_axle_to_mass;
        let left = initial.lateral_speed + initial.yaw_rate * to_mass;
        let velocity = initial.pose.forward() * initial.speed + initial.pose.left() * left;
        let mass = MassProperties::new(RapierVector::ZERO, vehicle.mass, vehicle.yaw_inertia);
        let body = RigidBodyBuilder::dynamic()
            .pose(frame.pose_in(&initial.pose.advanced(to_mass)))
            .linvel(vector(velocity))
            .angvel(initial.yaw_rate)
            .additional_mass_properties(mass)
            .can_sleep(false);
        let handle = self.bodies.insert(body);
        let footprint = part_shapes(&vehicle.footprint)?.into_iter().map(|(at, shape)| {
            let collider = ColliderBuilder::new(shape)
                .translation(RapierVector::new(at - to_mass, 0.0))
                .density(0.0)
                // contacts are detected but exert no force
                .solver_groups(InteractionGroups::new(Group::NONE, Group::NONE, InteractionTestMode::And));
            PartCollider { collider: self.colliders.insert_with_parent(collider, handle, &mut self.bodies), at }
        });
        let footprint = footprint.collect();
        Ok((handle, footprint))
    }

    /// Inserts a body with its colliders, all marked with `user_data`.
    pub(super) fn insert(
        &mut self,
        body: RigidBodyBuilder,
        shapes: &[(RapierPose, SharedShape)],
        user_data: u128,
    ) -> RigidBodyHandle {
        let handle = self.bodies.insert(body.can_sleep(false));
        for (pose, shape) in shapes {
            let collider = ColliderBuilder::new(shape.clone()).position(*pose).density(0.0).user_data(user_data);
            self.colliders.insert_with_parent(collider, handle, &mut self.bodies);
        }
        handle
    }

    /// Removes a body with its colliders.
    pub(super) fn remove(&mut self, body: RigidBodyHandle) {
        self.bodies.remove(
            body,
            &mut self.islands,
            &mut self.colliders,
            &mut self.impulse_joints,
            &mut self.multibody_joints,
            &mut self.soft_bodies,
            true,
        );
    }

    /// Sets the force and torque of the next step, given in the body's frame.
    pub(super) fn push(&mut self, body: RigidBodyHandle, wrench: &Wrench) {
        let body = &mut self.bodies[body];
        let force = *body.rotation() * RapierVector::new(wrench.forward, wrench.left);
        body.reset_forces(false);
        body.reset_torques(false);
        body.add_force(force, true);
        body.add_torque(wrench.yaw, true);
    }

    /// Updates the contacts for the current poses; nothing moves.
    pub(super) fn find_contacts(&mut self) {
        let dt = std::mem::replace(&mut self.parameters.dt, 0.0);
        self.step();
        self.parameters.dt = dt;
    }

    /// Advances by one step; returns whether every number stayed finite.
    pub(super) fn step(&mut self) -> bool {
        self.pipeline.step(
            RapierVector::ZERO,
            &self.parameters,
            &mut self.islands,
            &mut self.broad_phase,
            &mut self.narrow_phase,
            &mut self.bodies,
            &mut self.colliders,
            &mut self.impulse_joints,
            &mut self.multibody_joints,
            &mut self.soft_bodies,
            &mut self.ccd,
            &(),
            &(),
        );
        self.pipeline.quarantine().is_empty()
    }
}
