//! Spiral edges. The curve and a lower bound of its cost are computed first, the collision check on demand.

use std::sync::{Arc, OnceLock};

use super::cost::{CostTerms, Weights};
use super::counts::NoEdge;
use super::curve_slowdown::{CurvatureSamples, SAMPLES};
use super::{LatticeContext, Node, Root, Settings, Target};
use crate::collision::{Allowance, Blocker, Clearance, StaticHit, Sweep};
use crate::geometry::spiral::{CubicSpiral, PathPoint, connect};
use crate::geometry::spiral_opt::{Method, connect_bounded};
use crate::geometry::{Pose, wrap_angle};
use crate::reference::Frenet;

/// An edge of the lattice.
#[derive(Debug, Clone)]
pub(super) struct Edge {
    /// Index of its end node in the layer.
    pub(super) to: usize,
    /// Offset of its end node, m.
    pub(super) end_offset: f64,
    /// The curve.
    pub(super) spiral: CubicSpiral,
    /// Start pose.
    start: Pose,
    /// Lower bound of its cost: the terms that need no collision check.
    pub(super) lower_bound: CostTerms,
    /// Its curvatures.
    curvatures: CurvatureSamples,
    /// Whether it ends beside its node, so that no edge can follow.
    pub(super) ends_chain: bool,
    checked: OnceLock<Checked>,
    sweep: OnceLock<Arc<Sweep>>,
}

/// Result of the collision check of an edge.
#[derive(Debug, Clone)]
pub(super) struct Checked {
    /// Largest collision-free station of the rear axle on it, m; negative if the kept prefix is blocked.
    pub(super) free_length: f64,
    /// The blocker, if it is not free over its whole length.
    pub(super) blocked_by: Option<Blocker>,
    /// Its cost.
    pub(super) terms: CostTerms,
}

/// The kept prefix of the committed path before a root, swept once for all edges.
#[derive(Debug, Clone)]
pub(super) struct KeptPrefix {
    pub(super) sweeps: Vec<Arc<Sweep>>,
    pub(super) length: f64,
    hit: Option<StaticHit>,
    /// What it costs if the prefix misses the target.
    pub(super) missed_target: f64,
    /// Clearance of the prefix; the clearance of a path is the minimum over its parts.
    clearance: Clearance,
    /// Relaxation of the checks, in stations of the edge.
    allowance: Allowance,
}

impl KeptPrefix {
    /// The prefix of edges between nodes.
    pub(super) const EMPTY: Self = Self {
        sweeps: Vec::new(),
        length: 0.0,
        hit: None,
        missed_target: 0.0,
        clearance: Clearance { obstacle: f64::INFINITY, road: f64::INFINITY },
        allowance: Allowance::NONE,
    };

    pub(super) fn root(context: &LatticeContext<'_>, root: &Root, weights: &Weights) -> Self {
        let length = root.kept.iter().map(|s| s.length).sum();
        let path = crate::trajectory::Path::new(root.start, &root.kept);
        let mut probe = path.as_ref().map(|path| context.world.probe_path(path));
        let desired = weights.desired_clearance;
        Self {
            length,
            missed_target: missed_target(context, root, weights),
            hit: probe.as_mut().and_then(|probe| probe.static_hit(&context.margins, &root.allowance)),
            clearance: probe.map_or(Self::EMPTY.clearance, |mut probe| probe.clearance(desired)),
            sweeps: path.iter().map(|path| Arc::new(context.world.sweep_path(path))).collect(),
            allowance: root.allowance.beyond(length),
        }
    }
}

impl Edge {
    /// The edge between two nodes, each with its station (m).
    pub(super) fn between(
        context: &LatticeContext<'_>,
        (s0, from): (f64, &Node),
        (s1, to, index): (f64, &Node, usize),
        settings: &Settings,
    ) -> Result<Self, NoEdge> {
        let start = from.point(context, s0).ok_or(NoEdge::NoSpiral)?;
        let end = to.point(context, s1).ok_or(NoEdge::NoSpiral)?;
        let spiral = bounded(&start.pose, start.curvature, &end, context.max_curvature)?;
        Ok(Self::new(context, (start.pose, s0), spiral, (to, index, s1), false, settings))
    }

    /// The edge from the root, near station `s0`, to a node. If the curvature bound is active, it may end beside the node.
    pub(super) fn from_root(
        context: &LatticeContext<'_>,
        (s0, root): (f64, &Root),
        (s1, to, index): (f64, &Node, usize),
        settings: &Settings,
    ) -> Result<Self, NoEdge> {
        let end = to.point(context, s1).ok_or(NoEdge::NoSpiral)?;
        let exact = bounded(&root.pose, root.curvature, &end, context.max_curvature);
        let ends_chain = exact.is_err();
        let spiral = match exact {
            Ok(spiral) => spiral,
            Err(reason) if to.offset.abs() <= SLIDES_WITHIN => slid(root, &end, context.max_curvature).ok_or(reason)?,
            Err(reason) => return Err(reason),
        };
        Ok(Self::new(context, (root.pose, s0), spiral, (to, index, s1), ends_chain, settings))
    }

    fn new(
        context: &LatticeContext<'_>,
        (start, s0): (Pose, f64),
        spiral: CubicSpiral,
        (to, index, s1): (&Node, usize, f64),
        ends_chain: bool,
        settings: &Settings,
    ) -> Self {
        let (lower_bound, curvatures) = unchecked_terms(context, &start, &spiral, (s0, s1), &settings.weights);
        Self {
            to: index,
            end_offset: to.offset,
            spiral,
            start,
            lower_bound,
            curvatures,
            ends_chain,
            checked: OnceLock::new(),
            sweep: OnceLock::new(),
        }
    }

    /// The cost term that depends on the present speed.
    pub(super) fn curve_slowdown(&self, context: &LatticeContext<'_>, weights: &Weights) -> f64 {
        weights.curve_slowdown * self.curvatures.curve_slowdown(self.spiral.length, context.full_speed_curvature)
    }

    /// The result of the collision check, if it was made.
    pub(super) fn checked(&self) -> Option<&Checked> {
        self.checked.get()
    }

    /// The result of the collision check, which is made now if necessary. `before` must belong to the start of the edge.
    pub(super) fn check(&self, context: &LatticeContext<'_>, before: &KeptPrefix, settings: &Settings) -> &Checked {
        self.checked
            .get_or_init(|| checked(context, (&self.start, &self.spiral), &self.lower_bound, before, &settings.weights))
    }

    /// Its swept footprint; computed only for returned chains.
    pub(super) fn sweep(&self, context: &LatticeContext<'_>) -> &Arc<Sweep> {
        self.sweep.get_or_init(|| Arc::new(context.world.sweep(&self.start, &self.spiral)))
    }
}

/// The collision check of a spiral. `lower_bound` contains its other cost terms, `before` is the prefix before it.
pub(super) fn checked(
    context: &LatticeContext<'_>,
    (start, spiral): (&Pose, &CubicSpiral),
    lower_bound: &CostTerms,
    before: &KeptPrefix,
    w: &Weights,
) -> Checked {
    let mut probe = context.world.probe(start, spiral);
    let (hit, from) = match before.hit {
        Some(hit) => (Some(hit), before.length),
        None => (probe.static_hit(&context.margins, &before.allowance), 0.0),
    };
    let clearance = probe.clearance(w.desired_clearance);
    let near = closeness(&clearance).min(closeness(&before.clearance));
    let share = (1.0 - near / w.desired_clearance).max(0.0);
    Checked {
        free_length: hit.map_or(spiral.length, |h| h.station - from),
        blocked_by: hit.map(|h| h.what),
        terms: CostTerms { clearance: w.clearance * spiral.length * share.powi(2), ..*lower_bound },
    }
}

/// The clearance that the cost depends on, m.
pub(super) fn closeness(clearance: &Clearance) -> f64 {
    clearance.obstacle.min(clearance.road + ROAD_CLEARANCE_BONUS)
}

/// The cost terms of a spiral that depend neither on a collision check nor on the present speed, and its curvatures.
/// `begins` and `ends` are approximate stations of its ends on the reference line, m.
pub(super) fn unchecked_terms(
    context: &LatticeContext<'_>,
    start: &Pose,
    spiral: &CubicSpiral,
    (begins, ends): (f64, f64),
    w: &Weights,
) -> (CostTerms, CurvatureSamples) {
    let mut terms = CostTerms { curvature: w.curvature * spiral.bending_energy(), ..CostTerms::default() };
    let mut curvatures = [(0.0, 0.0); COST_SAMPLES];
    let spacing = spiral.length / COST_SAMPLES as f64;
    let mut before = begins;
    for ((station, point), curvature) in spiral.samples(start, COST_SAMPLES).skip(1).zip(&mut curvatures) {
        let hint = begins + (ends - begins) * station / spiral.length;
        let Frenet { s, l } = context.reference.project_near(point.pose.position, hint);
        terms.offset += w.offset * spacing * l.abs().min(OFFSET_SATURATES).powi(2);
        let (left, right) = context.reference.lane_bounds(s);
        let over = (l + context.half_width - left).max(context.half_width - l - right).max(0.0);
        terms.lane_deviation += w.lane_deviation * spacing * over;
        *curvature = (point.curvature, context.reference.at(s).curvature);
        let passed = context.target.and_then(|target| Some((target, target.passed_between(before, s)?)));
        if let Some((target, share)) = passed {
            let there = spiral.point_at(start, station - (1.0 - share) * spacing).pose;
            terms.missed_target += if is_met(context, &target, &there) { 0.0 } else { w.missed_target };
        }
        before = s;
    }
    (terms, CurvatureSamples::new(curvatures))
}

/// Whether a pose of the rear axle beside the target is in it.
fn is_met(context: &LatticeContext<'_>, target: &Target, pose: &Pose) -> bool {
    let Frenet { s, l } = context.reference.project_near(pose.position, target.station);
    target.contains(l, wrap_angle(pose.yaw - context.reference.at(s).pose.yaw))
}

/// What it costs if the kept prefix before a root misses the target.
fn missed_target(context: &LatticeContext<'_>, root: &Root, w: &Weights) -> f64 {
    if context.target.is_none() {
        return 0.0;
    }
    let begins = context.reference.project(root.start.position).s;
    let mut at = (root.start, begins);
    root.kept.iter().fold(0.0, |sum, spiral| {
        let end = spiral.end(&at.0);
        let ends = context.reference.project_near(end.position, at.1 + spiral.length).s;
        let (terms, _) = unchecked_terms(context, &at.0, spiral, (at.1, ends), w);
        at = (end, ends);
        sum + terms.missed_target
    })
}

/// Edges to nodes within this offset may slide sideways if the curvature bound is active, m: a tight corner needs some path,
/// not one to every node.
const SLIDES_WITHIN: f64 = 1.0;
/// Largest ratio of the length of an edge to its chord.
const MAX_DETOUR: f64 = 1.5;
/// The offset cost saturates at this offset, m: during a lane change a larger offset does not make the path worse.
pub(crate) const OFFSET_SATURATES: f64 = 2.0;
/// The road boundary costs like an obstacle that is farther away by this, m: lanes are narrow by design.
const ROAD_CLEARANCE_BONUS: f64 = 0.5;

/// The spiral from a pose to a node, if its curvature is within the bound everywhere.
fn bounded(start: &Pose, start_curvature: f64, end: &PathPoint, max_curvature: f64) -> Result<CubicSpiral, NoEdge> {
    let local = Pose { position: start.to_local(end.pose.position), yaw: wrap_angle(end.pose.yaw - start.yaw) };
    let spiral = connect(start_curvature, &local, end.curvature).map_err(|_| NoEdge::NoSpiral)?;
    if spiral.length > MAX_DETOUR * local.position.coords.norm() {
        return Err(NoEdge::Detour);
    }
    let bound = max_curvature.max(start_curvature.abs());
    if spiral.max_abs_curvature() > bound * (1.0 + 1e-9) { Err(NoEdge::CurvatureBound) } else { Ok(spiral) }
}

/// The spiral to a node under the curvature bound; a convex program slides its end sideways as little as needed.
fn slid(root: &Root, end: &PathPoint, max_curvature: f64) -> Option<CubicSpiral> {
    let local = Pose { position: root.pose.to_local(end.pose.position), yaw: wrap_angle(end.pose.yaw - root.pose.yaw) };
    let found = connect_bounded(root.curvature, &local, end.curvature, max_curvature).ok()?;
    let detour = found.spiral.length > MAX_DETOUR * local.position.coords.norm();
    (found.method == Method::Convex && !detour).then_some(found.spiral)
}
/// Number of samples of an edge for the offset and lane costs.
pub(super) const COST_SAMPLES: usize = SAMPLES;
