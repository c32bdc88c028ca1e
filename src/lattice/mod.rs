//! The conformal lattice: spiral edges between nodes at stations × lateral offsets of a reference line.
//!
//! # Technique
//!
//! Nodes are in layers at fixed stations of the reference line, so that consecutive cycles share nodes, edges and collision
//! checks. Heading and curvature of a node are those of the reference line at its offset, κ_l = κ/(1 − κ l) (McNaughton et
//! al. 2011). Only the edges from the vehicle to the first layers are new in every cycle. Dynamic programming over the layers
//! yields the cheapest chains of edges and checks only the edges that it uses for collisions. Where an edge is blocked, its
//! chain ends in front of the blocker.
//!
//! If the curvature bound is active on an edge from the vehicle, the edge may end beside its node: a convex program slides
//! its end sideways as little as needed ([`crate::geometry::spiral_opt`]), and the chain ends there.
//!
//! Paths can be asked to lead through a set of poses beside the reference line, a [`Target`]: there is a layer at its station, with
//! nodes in the set.
//!
//! Edges do not depend on the speed. The present speed enters as the cost term [`CostTerms::curve_slowdown`]: the distance
//! lost by driving a curve at the speed that its curvature permits. So paths that the vehicle can drive at its present speed
//! are cheaper, and tighter ones are still available where no other path is free.
//!
//! # Weaknesses
//!
//! A node has one curvature and, by default, one heading ([`Settings::headings`]), so that edges near the limits of the
//! vehicle may be missed. Layers are far apart: a lane change whose length falls between two layers overshoots its lane by
//! one step of the offsets. A change of speed that changes the distance between layers invalidates all edges.

mod cost;
mod counts;
mod curve_slowdown;
mod edges;
mod layers;
pub mod refine;
mod search;
mod store;
mod target;

pub use cost::{CostTerms, Weights, rank};
pub use counts::EdgeCounts;
pub(crate) use edges::OFFSET_SATURATES;
pub use store::EdgeStore;
pub use target::Target;

use std::sync::Arc;

use crate::collision::{Allowance, Blocker, CollisionWorld, SafetyMargins, Sweep};
use crate::geometry::Pose;
use crate::geometry::spiral::{CubicSpiral, PathPoint};
use crate::reference::ReferenceLine;
pub use crate::settings::SettingsError;
use crate::settings::{count, length, positive, within};
use crate::trajectory::Path;

/// Settings of the lattice; the section `[planner.lattice]` of a settings file.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Unit of the stations of layers, m.
    pub grid: f64,
    /// Smallest distance from the vehicle to the first layer, m.
    pub min_edge_length: f64,
    /// Driving time per edge at the present speed, s; it determines the distance between layers.
    pub edge_time: f64,
    /// Largest distance between layers, m.
    pub max_edge_length: f64,
    /// Largest turning of the reference line between two layers, rad; more turning reduces their distance.
    pub max_turn: f64,
    /// Maximum number of layers.
    pub layers: usize,
    /// Number of layers with edges directly from the vehicle.
    pub root_layers: usize,
    /// Spacing of the lateral offsets, m.
    pub offset_spacing: f64,
    /// Largest lateral offset to either side, m.
    pub offset_limit: f64,
    /// Headings of the nodes relative to the reference line, rad.
    pub headings: Vec<f64>,
    /// Largest slope of an edge: lateral over longitudinal distance.
    pub max_slope: f64,
    /// Maximum number of candidate paths for the speed search.
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

/// Largest acceptable offset, m: several times the width of a motorway.
const WIDEST_OFFSET: f64 = 50.0;
/// Most offsets to either side.
const MOST_OFFSETS: f64 = 100.0;
/// Most edges of a lattice: a cycle evaluates a large part of them.
const MOST_EDGES: f64 = 1e5;

impl Settings {
    /// Checks the range of every value, and the number of edges that they give.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        within("grid", self.grid, 0.5..=100.0, "m")?;
        positive("min_edge_length", self.min_edge_length, f64::INFINITY, "m")?;
        positive("max_edge_length", self.max_edge_length, f64::INFINITY, "m")?;
        if self.max_edge_length < self.min_edge_length {
            return Err(SettingsError::new("max_edge_length", self.max_edge_length, "at least min_edge_length"));
        }
        positive("edge_time", self.edge_time, 60.0, "s")?;
        positive("max_turn", self.max_turn, f64::INFINITY, "rad")?;
        count("layers", self.layers, 1..=20)?;
        count("root_layers", self.root_layers, 1..=20)?;
        positive("max_slope", self.max_slope, 10.0, "")?;
        count("candidates", self.candidates, 1..=1000)?;
        self.weights.validate().map_err(|e| e.in_table("weights"))?;
        positive("offset_spacing", self.offset_spacing, f64::INFINITY, "m")?;
        within("offset_limit", self.offset_limit, 0.0..=WIDEST_OFFSET, "m")?;
        if self.offset_limit / self.offset_spacing > MOST_OFFSETS {
            let expected = "at least a hundredth of offset_limit";
            return Err(SettingsError::new("offset_spacing", self.offset_spacing, expected));
        }
        self.validate_headings()
    }

    /// Checks the headings of the nodes: at least one, each once, and not too many edges.
    fn validate_headings(&self) -> Result<(), SettingsError> {
        length("headings", &self.headings, 1..=9)?;
        for (i, &heading) in self.headings.iter().enumerate() {
            let field = format!("headings[{i}]");
            within(&field, heading, -1.0..=1.0, "rad")?;
            if self.headings[..i].contains(&heading) {
                return Err(SettingsError::new(field, heading, "different from the headings before it"));
            }
        }
        // edges between two layers connect every node to every node
        let nodes = (2.0 * (self.offset_limit / self.offset_spacing).floor() + 1.0) * self.headings.len() as f64;
        let edges = nodes * nodes * self.layers as f64;
        if edges > MOST_EDGES {
            let field = " (number of edges, (offsets × headings)² × layers)";
            let expected = "at most 100000: more offset_spacing, fewer headings or layers";
            return Err(SettingsError::new(field, edges, expected));
        }
        Ok(())
    }
}

/// Start of the chains: the vehicle, or the end of the kept prefix of the committed path.
#[derive(Debug, Clone, PartialEq)]
pub struct Root {
    /// Pose of the rear axle at the root.
    pub pose: Pose,
    /// Curvature at the root, 1/m.
    pub curvature: f64,
    /// Kept prefix of the committed path, from the vehicle to the root. Empty if the root is at the vehicle.
    pub kept: Vec<CubicSpiral>,
    /// Pose of the vehicle, where the kept prefix starts.
    pub start: Pose,
    /// Relaxation of the collision checks near the start.
    pub allowance: Allowance,
}

/// A path through the lattice with its swept footprint.
#[derive(Debug, Clone)]
pub struct LatticePath {
    /// The path, starting at the vehicle.
    pub path: Path,
    /// Number of spirals at its start that belong to the kept prefix.
    pub kept: usize,
    /// Swept footprints of its edges, in order.
    pub sweeps: Vec<Arc<Sweep>>,
    /// Largest collision-free station of the rear axle, m.
    pub free_length: f64,
    /// The blocker, if the path is blocked.
    pub blocked_by: Option<Blocker>,
    /// Cost by term.
    pub terms: CostTerms,
    /// Lateral offset of its end, m.
    pub end_offset: f64,
    /// Offset of its first node, m.
    pub first_offset: f64,
}

/// The data that a lattice is built on.
#[derive(Clone, Copy)]
pub struct LatticeContext<'a> {
    /// The reference line.
    pub reference: &'a ReferenceLine,
    /// The static collision world.
    pub world: &'a CollisionWorld,
    /// Margins of the collision checks.
    pub margins: SafetyMargins,
    /// Bound of |curvature| of edges, 1/m.
    pub max_curvature: f64,
    /// Largest curvature that the vehicle can drive at its present speed, 1/m: the planned lateral acceleration over the
    /// square of the speed; infinite at standstill. Tighter curves cost [`CostTerms::curve_slowdown`].
    pub full_speed_curvature: f64,
    /// Half of the vehicle's width, m.
    pub half_width: f64,
    /// The place that paths are to lead through, if there is one; always the same for one [`EdgeStore`].
    pub target: Option<Target>,
}

/// Result of a search.
#[derive(Debug, Clone, Default)]
pub struct SearchResult {
    /// The paths, cheapest first. Empty if there is none; then `counts` contains the reasons.
    pub paths: Vec<LatticePath>,
    /// Counts of the edges by outcome.
    pub counts: EdgeCounts,
}

/// The lattice with valid settings, so that no search can fail or hang because of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Lattice {
    settings: Settings,
}

impl Lattice {
    /// Checks the settings.
    ///
    /// # Errors
    /// A setting out of its range.
    pub fn new(settings: Settings) -> Result<Self, SettingsError> {
        settings.validate()?;
        Ok(Self { settings })
    }

    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Searches for the cheapest chains of edges from `root` through the layers up to `horizon` metres ahead, at most
    /// [`Settings::candidates`]. `speed` (m/s) determines the distance between layers.
    #[must_use]
    pub fn search(
        &self,
        context: &LatticeContext<'_>,
        root: &Root,
        speed: f64,
        horizon: f64,
        store: &mut EdgeStore,
    ) -> SearchResult {
        let settings = &self.settings;
        let store = store.of(&context.margins);
        let full_speed_curvature = context.full_speed_curvature;
        let query = store::SearchQuery { root: root.clone(), speed, full_speed_curvature, horizon };
        if let Some(result) = store.recent.get(&query) {
            return result;
        }
        store.drop_before(context.reference.project(root.start.position).s - KEPT_BEHIND, settings);
        let here = context.reference.project(root.pose.position).s;
        let layers = layers::ahead(context, here, speed, horizon, settings);
        let result = search::Search::new(context, root, layers, horizon, settings, store).run();
        store.recent.keep(query, &result);
        result
    }
}

/// Cached edges that end farther behind the vehicle than this are dropped, m.
const KEPT_BEHIND: f64 = 20.0;

/// A node of a layer: an end of edges.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Node {
    /// Lateral offset, m.
    offset: f64,
    /// Heading relative to the reference line, rad.
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

/// The nodes of any layer, from right to left.
fn nodes(settings: &Settings) -> Vec<Node> {
    #[allow(clippy::cast_possible_truncation)] // validated: at most 100
    let count = (settings.offset_limit / settings.offset_spacing).floor() as i64;
    let offsets = (-count..=count).map(|i| i as f64 * settings.offset_spacing);
    offsets.flat_map(|offset| settings.headings.iter().map(move |&heading| Node { offset, heading })).collect()
}

#[cfg(test)]
mod tests;
