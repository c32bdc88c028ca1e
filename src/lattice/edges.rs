//! Spiral edges: the curve and what it costs at least come first, the collision check when a search asks for it.

use std::sync::{Arc, OnceLock};

use super::cost::{CostTerms, Weights};
use super::counts::NoEdge;
use super::curve_slowdown::{Bends, SAMPLES};
use super::{LatticeContext, Node, Root, Settings};
use crate::collision::{Allowance, Blocker, Clearance, StaticHit, Sweep};
use crate::geometry::spiral::{CubicSpiral, PathPoint, connect};
use crate::geometry::spiral_opt::{Method, connect_bounded};
use crate::geometry::{Pose, wrap_angle};
use crate::reference::Frenet;

/// An edge of the lattice.
#[derive(Debug, Clone)]
pub(super) struct Edge {
    /// Index of the node it ends at, in its layer.
    pub(super) to: usize,
    /// Offset of that node, m.
    pub(super) end_offset: f64,
    /// The curve.
    pub(super) spiral: CubicSpiral,
    /// Where it starts.
    start: Pose,
    /// What it costs at least: the terms that need no collision check.
    pub(super) least: CostTerms,
    /// How much it bends.
    bends: Bends,
    /// Whether it ends beside its node, so that no other edge goes on from it.
    pub(super) ends_chain: bool,
    checked: OnceLock<Checked>,
    sweep: OnceLock<Arc<Sweep>>,
}

/// What the collision check of an edge found.
#[derive(Debug, Clone)]
pub(super) struct Checked {
    /// How far the rear axle may come on it, m; below zero if something is in the way before it begins.
    pub(super) free_length: f64,
    /// What ends it before its length.
    pub(super) blocked_by: Option<Blocker>,
    /// Its cost.
    pub(super) terms: CostTerms,
}

/// What a root brings with it: the part of the committed path that is driven before, swept once for all edges.
#[derive(Debug, Clone)]
pub(super) struct KeptPrefix {
    pub(super) sweeps: Vec<Arc<Sweep>>,
    pub(super) length: f64,
    hit: Option<StaticHit>,
    /// Distances that it keeps: a path is as close as its closest part.
    clearance: Clearance,
    /// What checks overlook, by stations of the edge.
    allowance: Allowance,
}

impl KeptPrefix {
    /// For edges between nodes.
    pub(super) const NOTHING: Self = Self {
        sweeps: Vec::new(),
        length: 0.0,
        hit: None,
        clearance: Clearance { obstacle: f64::INFINITY, road: f64::INFINITY },
        allowance: Allowance::NONE,
    };

    pub(super) fn root(context: &LatticeContext<'_>, root: &Root, weights: &Weights) -> Self {
        let length = root.kept.iter().map(|s| s.length).sum();
        let path = crate::trajectory::Path::new(root.start, &root.kept);
        let sweep = path.map(|path| context.world.sweep_path(&path));
        Self {
            length,
            clearance: sweep
                .as_ref()
                .map_or(Self::NOTHING.clearance, |s| context.world.clearance(s, weights.desired_clearance)),
            hit: sweep.as_ref().and_then(|s| context.world.static_hit_from_start(s, &root.allowance)),
            sweeps: sweep.into_iter().map(Arc::new).collect(),
            allowance: Allowance {
                no_margins_until: root.allowance.no_margins_until - length,
                no_road_until: root.allowance.no_road_until - length,
            },
        }
    }
}

impl Edge {
    /// The edge between two nodes, each with its station.
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

    /// The edge from the root, at about station `s0`, to a node. Where the curvature bound bites, it may end beside it.
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
        let (least, bends) = least_terms(context, &start, &spiral, (s0, s1), &settings.weights);
        Self {
            to: index,
            end_offset: to.offset,
            spiral,
            start,
            least,
            bends,
            ends_chain,
            checked: OnceLock::new(),
            sweep: OnceLock::new(),
        }
    }

    /// What it costs at the present speed beyond what it always costs.
    pub(super) fn curve_slowdown(&self, context: &LatticeContext<'_>, weights: &Weights) -> f64 {
        weights.curve_slowdown * self.bends.curve_slowdown(self.spiral.length, context.full_speed_curvature)
    }

    /// The collision check if it was made.
    pub(super) fn checked(&self) -> Option<&Checked> {
        self.checked.get()
    }

    /// The collision check, made now if it was not before. `before` must be that of the edge's start.
    pub(super) fn check(&self, context: &LatticeContext<'_>, before: &KeptPrefix, settings: &Settings) -> &Checked {
        self.checked
            .get_or_init(|| checked(context, (&self.start, &self.spiral), &self.least, before, &settings.weights))
    }

    /// Its swept footprint: made for the chains that are handed out only.
    pub(super) fn sweep(&self, context: &LatticeContext<'_>) -> &Arc<Sweep> {
        self.sweep.get_or_init(|| Arc::new(context.world.sweep(&self.start, &self.spiral)))
    }
}

/// The collision check of a spiral in its place. `least` are its terms so far; `before` is what is driven before it.
pub(super) fn checked(
    context: &LatticeContext<'_>,
    (start, spiral): (&Pose, &CubicSpiral),
    least: &CostTerms,
    before: &KeptPrefix,
    w: &Weights,
) -> Checked {
    let mut probe = context.world.probe(start, spiral);
    let (hit, from) = match before.hit {
        Some(hit) => (Some(hit), before.length),
        None => (probe.static_hit(&before.allowance), 0.0),
    };
    let clearance = probe.clearance(w.desired_clearance);
    let near = closeness(&clearance).min(closeness(&before.clearance));
    let share = (1.0 - near / w.desired_clearance).max(0.0);
    Checked {
        free_length: hit.map_or(spiral.length, |h| h.station - from),
        blocked_by: hit.map(|h| h.what),
        terms: CostTerms { clearance: w.clearance * spiral.length * share.powi(2), ..*least },
    }
}

/// The clearance that costs by, m.
pub(super) fn closeness(clearance: &Clearance) -> f64 {
    clearance.obstacle.min(clearance.road + ROAD_IS_KINDER)
}

/// The terms of a spiral that need neither a collision check nor the present speed, and how much it bends. `stations` are
/// about where it begins and ends on the reference line, m.
pub(super) fn least_terms(
    context: &LatticeContext<'_>,
    start: &Pose,
    spiral: &CubicSpiral,
    (begins, ends): (f64, f64),
    w: &Weights,
) -> (CostTerms, Bends) {
    let mut terms = CostTerms { curvature: w.curvature * spiral.bending_energy(), ..CostTerms::default() };
    let mut curvatures = [(0.0, 0.0); COST_SAMPLES];
    let way = spiral.length / COST_SAMPLES as f64;
    for ((along, point), curvature) in spiral.samples(start, COST_SAMPLES).skip(1).zip(&mut curvatures) {
        let about = begins + (ends - begins) * along / spiral.length;
        let Frenet { s, l } = context.reference.project_near(point.pose.position, about);
        terms.offset += w.offset * way * l.abs().min(OFFSET_SATURATES).powi(2);
        let (left, right) = context.reference.lane_bounds(s);
        let over = (l + context.half_width - left).max(context.half_width - l - right).max(0.0);
        terms.lane_deviation += w.lane_deviation * way * over;
        *curvature = (point.curvature, context.reference.at(s).curvature);
    }
    (terms, Bends::new(curvatures))
}

/// Nodes within this offset may be missed sideways where the curvature bound bites, m: a tight corner needs some way
/// round it, not one to every node.
const SLIDES_WITHIN: f64 = 1.0;
/// A spiral this many times longer than its chord winds: not an edge.
const LONGEST_DETOUR: f64 = 1.5;
/// Offsets beyond this cost no more (m): on the way from another lane they say nothing about the path.
pub(crate) const OFFSET_SATURATES: f64 = 2.0;
/// The road's edge costs like an obstacle that is this much farther away (m): lanes are narrow by design.
const ROAD_IS_KINDER: f64 = 0.5;

/// The spiral from a pose to a node, if there is one whose curvature stays within the bound everywhere.
fn bounded(start: &Pose, start_curvature: f64, end: &PathPoint, max_curvature: f64) -> Result<CubicSpiral, NoEdge> {
    let local = Pose { position: start.to_local(end.pose.position), yaw: wrap_angle(end.pose.yaw - start.yaw) };
    let spiral = connect(start_curvature, &local, end.curvature).map_err(|_| NoEdge::NoSpiral)?;
    if spiral.length > LONGEST_DETOUR * local.position.coords.norm() {
        return Err(NoEdge::Detour);
    }
    let bound = max_curvature.max(start_curvature.abs());
    if spiral.max_abs_curvature() > bound * (1.0 + 1e-9) { Err(NoEdge::CurvatureBound) } else { Ok(spiral) }
}

/// The spiral to a node under the curvature bound, by the convex program that slides its end sideways as little as needed.
fn slid(root: &Root, end: &PathPoint, max_curvature: f64) -> Option<CubicSpiral> {
    let local = Pose { position: root.pose.to_local(end.pose.position), yaw: wrap_angle(end.pose.yaw - root.pose.yaw) };
    let found = connect_bounded(root.curvature, &local, end.curvature, max_curvature).ok()?;
    let detour = found.spiral.length > LONGEST_DETOUR * local.position.coords.norm();
    (found.method == Method::Convex && !detour).then_some(found.spiral)
}
/// Samples along an edge for the costs by offset.
pub(super) const COST_SAMPLES: usize = SAMPLES;
