//! The conformal lattice: spiral edges between nodes at stations × lateral offsets of a reference line.
//!
//! Nodes lie in layers at fixed stations of the reference line, so that consecutive cycles share their nodes, edges and
//! collision checks; heading and curvature of a node are those of the reference line at its offset, κ_l = κ/(1 − κ l)
//! (McNaughton et al. 2011). Only the first edges, from where the vehicle is, are new in every cycle. The cheapest chains
//! come out of dynamic programming over the layers, which checks for collision only the edges it is about to use; where
//! the way is blocked, chains end in front of what blocks them.
//!
//! Where the curvature bound bites on the way from the vehicle, an edge may end beside its node: a convex program slides
//! its end as little as needed ([`crate::geometry::spiral_opt`]), and the chain ends there.
//!
//! Edges are the same at all speeds; what the present speed makes of them is a cost term, `slowing`: the way lost by driving
//! a bend at what its curvature allows. So ways that the vehicle can drive as it comes are the cheaper ones, and sharper
//! ones are still found where nothing else gets through.
//!
//! Weak spots: one curvature per node and, unless [`Settings::headings`] has more, one heading; edges that the vehicle
//! could only just drive may be missed. Layers lie far apart: a change of lanes between two lengths on offer aims one step of
//! the offsets beyond its lane and comes back. A change of speed that changes the distance between layers makes all edges new.

mod cost;
mod counts;
mod curve_slowdown;
mod edges;
mod layers;
pub mod refine;
mod search;
mod store;

pub use cost::{CostTerms, Weights, rank};
pub use counts::EdgeCounts;
pub(crate) use edges::OFFSET_SATURATES;
pub use store::EdgeStore;

use std::sync::Arc;

use crate::collision::{Allowance, Blocker, CollisionWorld, Sweep};
use crate::geometry::Pose;
use crate::geometry::spiral::{CubicSpiral, PathPoint};
use crate::reference::ReferenceLine;
use crate::trajectory::Path;

/// Shape of the lattice.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Stations of nodes are multiples of this, m.
    pub grid: f64,
    /// Shortest first edge, m.
    pub min_edge_length: f64,
    /// Time that an edge should last at the present speed, s.
    pub edge_time: f64,
    /// Longest edge, m.
    pub max_edge_length: f64,
    /// Layers lie closer where the reference line turns by more than this between two of them, rad.
    pub max_turn: f64,
    /// Largest number of layers.
    pub layers: usize,
    /// Number of layers that edges from the root reach directly.
    pub root_layers: usize,
    /// Spacing of lateral offsets, m.
    pub offset_spacing: f64,
    /// Largest lateral offset on either side, m.
    pub offset_limit: f64,
    /// Headings of the nodes relative to the reference line's, rad.
    pub headings: Vec<f64>,
    /// Steepest edge: lateral by longitudinal distance.
    pub max_slope: f64,
    /// Number of candidate paths handed to the speed layer.
    pub candidates: usize,
    /// Weights of the cost terms.
    pub weights: Weights,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            grid: 5.0,
            min_edge_length: 8.0,
            edge_time: 1.6,
            max_edge_length: 40.0,
            max_turn: 0.6,
            layers: 12,
            root_layers: 3,
            offset_spacing: 0.5,
            offset_limit: 4.0,
            headings: vec![0.0],
            max_slope: 0.35,
            candidates: 12,
            weights: Weights::default(),
        }
    }
}

/// Where chains start: the vehicle, or the end of the part of the committed path that is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct Root {
    /// Rear-axle pose at the start.
    pub pose: Pose,
    /// Curvature there, 1/m.
    pub curvature: f64,
    /// Part of the committed path that is driven before, starting at the vehicle. Empty if the chain starts there.
    pub kept: Vec<CubicSpiral>,
    /// Pose at which the whole chain starts.
    pub start: Pose,
    /// What the collision check overlooks near the start.
    pub allowance: Allowance,
}

/// A path through the lattice with its swept footprint.
#[derive(Debug, Clone)]
pub struct LatticePath {
    /// The path, from the vehicle on.
    pub path: Path,
    /// How many spirals at its start belong to the committed path.
    pub kept: usize,
    /// Swept footprints of its edges, in order.
    pub sweeps: Vec<Arc<Sweep>>,
    /// How far the rear axle may come on it, m.
    pub free_length: f64,
    /// What ends it, if it ends before its length.
    pub blocked_by: Option<Blocker>,
    /// Cost by term.
    pub terms: CostTerms,
    /// Lateral offset that it ends at, m.
    pub end_offset: f64,
    /// Offset of its first node, m.
    pub first_offset: f64,
}

/// What the lattice is built on.
#[derive(Clone, Copy)]
pub struct LatticeContext<'a> {
    /// The reference line.
    pub reference: &'a ReferenceLine,
    /// What is in the way.
    pub world: &'a CollisionWorld,
    /// Largest curvature that edges may have anywhere, 1/m.
    pub max_curvature: f64,
    /// Largest curvature that can be driven at the present speed, 1/m: the lateral acceleration that plans may use, by the
    /// square of the speed; infinite at rest. What bends more costs [`CostTerms::slowing`].
    pub full_speed_curvature: f64,
    /// Half of the vehicle's width, m.
    pub half_width: f64,
}

/// What a search found.
#[derive(Debug, Clone, Default)]
pub struct Found {
    /// Cheapest first; none is an outcome, whose reasons `counts` tells.
    pub paths: Vec<LatticePath>,
    /// What became of the edges.
    pub counts: EdgeCounts,
}

/// The paths of [`search`].
#[must_use]
pub fn paths(
    context: &LatticeContext<'_>,
    root: &Root,
    speed: f64,
    horizon: f64,
    settings: &Settings,
    store: &mut EdgeStore,
) -> Vec<LatticePath> {
    search(context, root, speed, horizon, settings, store).paths
}

/// Chains of edges from `root` over layers up to `horizon` metres ahead, cheapest first, [`Settings::candidates`] at most,
/// with what became of the edges looked at.
#[must_use]
pub fn search(
    context: &LatticeContext<'_>,
    root: &Root,
    speed: f64,
    horizon: f64,
    settings: &Settings,
    store: &mut EdgeStore,
) -> Found {
    let question =
        store::Question { root: root.clone(), speed, full_speed_curvature: context.full_speed_curvature, horizon };
    if let Some(answer) = store.answers.get(&question) {
        return answer;
    }
    store.forget_before(context.reference.project(root.start.position).s - FORGOTTEN_BEHIND, settings);
    let here = context.reference.project(root.pose.position).s;
    let stations = layers::ahead(context.reference, here, speed, horizon, settings);
    let answer = search::Search::new(context, root, &stations, horizon, settings, store).run();
    store.answers.keep(question, &answer);
    answer
}

/// Kept edges that end this far behind the vehicle are dropped, m: it does not drive backwards, but may replan there.
const FORGOTTEN_BEHIND: f64 = 20.0;

/// Where in a layer an edge may end.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Node {
    /// Lateral offset, m.
    offset: f64,
    /// Heading relative to the reference line's, rad.
    heading: f64,
}

impl Node {
    /// Pose and curvature at a station, m; `None` beyond the reference line's centre of curvature.
    fn point(&self, context: &LatticeContext<'_>, station: f64) -> Option<PathPoint> {
        let mut point = context.reference.offset_pose(station, self.offset)?;
        point.pose.yaw += self.heading;
        Some(point)
    }
}

/// The nodes of every layer, right to left.
fn nodes(settings: &Settings) -> Vec<Node> {
    #[allow(clippy::cast_possible_truncation)] // a few dozen
    let count = (settings.offset_limit / settings.offset_spacing).floor() as i64;
    let offsets = (-count..=count).map(|i| i as f64 * settings.offset_spacing);
    offsets.flat_map(|offset| settings.headings.iter().map(move |&heading| Node { offset, heading })).collect()
}

#[cfg(test)]
mod tests;
