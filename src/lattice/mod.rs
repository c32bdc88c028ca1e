//! The conformal lattice: spiral edges between nodes at stations × lateral offsets of a reference line.
//!
//! Nodes lie at fixed stations of the reference line (multiples of [`Settings::grid`]), so that consecutive cycles share
//! their nodes, edges and collision checks; heading and curvature of a node are those of the reference line at its
//! offset, κ_l = κ/(1 − κ l) (McNaughton et al. 2011). Only the first edges, from where the vehicle is, are new in every
//! cycle. The cheapest chain of free edges to each end node comes out of dynamic programming over the layers; where
//! the way is blocked, chains end in front of what blocks them.
//!
//! Where the curvature bound bites on the way from the vehicle, an edge may end beside its node: a convex program slides
//! its end as little as needed ([`crate::geometry::spiral_opt`]), and the chain ends there.
//!
//! Weak spots: one heading and curvature per node; edges that the vehicle could only just drive may be missed.

mod cost;
mod counts;
mod edges;

pub use cost::{CostTerms, Weights, rank};
pub use counts::EdgeCounts;
pub use edges::{Edge, EdgeStore};

use std::sync::Arc;

use crate::collision::{Allowance, Blocker, CollisionWorld, Sweep};
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::reference::ReferenceLine;
use crate::trajectory::Path;

/// Shape of the lattice.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Stations of nodes are multiples of this, m.
    pub grid: f64,
    /// Shortest first edge, m.
    pub shortest_edge: f64,
    /// Time that the first edge should last at the present speed, s.
    pub edge_time: f64,
    /// Longest edge, m.
    pub longest_edge: f64,
    /// Largest number of layers.
    pub layers: usize,
    /// Number of layers that edges from the root reach directly.
    pub root_layers: usize,
    /// Spacing of lateral offsets, m.
    pub offset_spacing: f64,
    /// Largest lateral offset on either side, m.
    pub offset_limit: f64,
    /// Steepest edge: lateral by longitudinal distance.
    pub steepest: f64,
    /// Number of candidate paths handed to the speed layer.
    pub candidates: usize,
    /// Weights of the cost terms.
    pub weights: Weights,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            grid: 5.0,
            shortest_edge: 8.0,
            edge_time: 1.6,
            longest_edge: 40.0,
            layers: 8,
            root_layers: 3,
            offset_spacing: 0.5,
            offset_limit: 4.0,
            steepest: 0.35,
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
pub struct Ground<'a> {
    /// The reference line.
    pub reference: &'a ReferenceLine,
    /// What is in the way.
    pub world: &'a CollisionWorld,
    /// Largest curvature that edges may have anywhere, 1/m.
    pub max_curvature: f64,
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
    ground: &Ground<'_>,
    root: &Root,
    speed: f64,
    horizon: f64,
    settings: &Settings,
    store: &mut EdgeStore,
) -> Vec<LatticePath> {
    search(ground, root, speed, horizon, settings, store).paths
}

/// Chains of edges from `root` over layers up to `horizon` metres ahead, cheapest first, [`Settings::candidates`] at most,
/// with what became of the edges looked at.
#[must_use]
pub fn search(
    ground: &Ground<'_>,
    root: &Root,
    speed: f64,
    horizon: f64,
    settings: &Settings,
    store: &mut EdgeStore,
) -> Found {
    let question = edges::Question { root: root.clone(), speed, horizon };
    if let Some(answer) = store.answers.get(&question) {
        return answer;
    }
    let here = ground.reference.project(root.start.position).s;
    store.forget_before(here - FORGOTTEN_BEHIND, settings);
    let stations = layer_stations(ground, root, speed, horizon, settings);
    let chains = Chains::build(ground, root, &stations, settings, store);
    let answer = chains.map_or_else(Found::default, |chains| {
        let counts = chains.counts.clone();
        Found { paths: chains.candidates(ground, root, horizon, settings), counts }
    });
    let mut kept = answer.clone();
    kept.counts.made = 0;
    store.answers.keep(question, &kept);
    answer
}

/// Station indices (multiples of the grid) of the layers ahead of the root.
fn layer_stations(ground: &Ground<'_>, root: &Root, speed: f64, horizon: f64, settings: &Settings) -> Vec<i64> {
    let here = ground.reference.project(root.pose.position).s;
    let edge = (speed * settings.edge_time).clamp(settings.shortest_edge, settings.longest_edge);
    // whole grid steps, at least one
    let stride = (edge / settings.grid).round().max(1.0) * settings.grid;
    let end = (here + horizon).min(ground.reference.length());
    let mut layers = Vec::new();
    #[allow(clippy::cast_possible_truncation)] // stations are far below 2⁵³ grid steps
    let mut index = ((here + edge) / settings.grid - ON_GRID).ceil() as i64;
    #[allow(clippy::cast_possible_truncation)]
    let stride = (stride / settings.grid) as i64;
    while layers.len() < settings.layers && index as f64 * settings.grid <= end + ON_GRID {
        layers.push(index);
        index += stride;
    }
    if layers.is_empty() {
        // less than one edge of road left: the last grid station there is
        #[allow(clippy::cast_possible_truncation)]
        let last = (end / settings.grid).floor() as i64;
        if last as f64 * settings.grid > here + 1.0 {
            layers.push(last);
        }
    }
    layers
}

/// Edges and the best way to reach each node, layer by layer.
struct Chains {
    /// All edges tried, with the label of the chain that leads to their start.
    labels: Vec<Label>,
    /// Labels that end a candidate: at the last layer or in front of something.
    ends: Vec<usize>,
    counts: EdgeCounts,
}

/// The best chain to the end of an edge.
struct Label {
    edge: Arc<Edge>,
    before: Option<usize>,
    terms: CostTerms,
    /// Length from the root to the end of the free part of the edge, m.
    free_length: f64,
    first_offset: f64,
}

impl Chains {
    fn build(
        ground: &Ground<'_>,
        root: &Root,
        stations: &[i64],
        settings: &Settings,
        store: &mut EdgeStore,
    ) -> Option<Self> {
        let first = *stations.first()?;
        let mut chains = Self { labels: Vec::new(), ends: Vec::new(), counts: EdgeCounts::default() };
        let offsets = offsets(settings);
        let root_edges = |store: &mut EdgeStore, station| {
            // who starts off the road, or inside a margin, may pass over nodes that are off it
            let all = vec![true; offsets.len()];
            let on_road = root.allowance == Allowance::NONE;
            let nodes = if on_road { store.nodes(ground, station, &offsets, settings) } else { &all };
            let mut found = edges::from_root(ground, root, station, nodes, &offsets, settings);
            found.counts.made = found.edges.len();
            found
        };
        let found = root_edges(store, first);
        chains.counts.add(&found.counts);
        let mut layer = chains.extend(found.edges.into_iter().map(|e| (None, e)), offsets.len());
        for (i, pair) in stations.windows(2).enumerate() {
            let reached: Vec<(usize, usize)> =
                layer.iter().enumerate().filter_map(|(offset, label)| Some((offset, (*label)?))).collect();
            let starts: Vec<usize> = reached.iter().map(|(offset, _)| *offset).collect();
            let (next, made) = store.between(ground, (pair[0], pair[1]), &starts, &offsets, settings);
            chains.counts.made += made;
            let mut tries = Vec::new();
            for (offset, label) in reached {
                let Some(node) = &next[offset] else { continue };
                chains.counts.add(&node.counts);
                tries.extend(node.edges.iter().map(|e| (Some(label), Arc::clone(e))));
            }
            // long edges straight from the root: a gentle change of lanes takes more than one stride
            if i + 1 < settings.root_layers {
                let found = root_edges(store, pair[1]);
                chains.counts.add(&found.counts);
                tries.extend(found.edges.into_iter().map(|e| (None, e)));
            }
            layer = chains.extend(tries.into_iter(), offsets.len());
        }
        chains.ends.extend(layer.iter().flatten());
        Some(chains)
    }

    /// Adds edges behind their labels; returns the best free label at each offset of the layer reached.
    fn extend(
        &mut self,
        edges: impl Iterator<Item = (Option<usize>, Arc<Edge>)>,
        offsets: usize,
    ) -> Vec<Option<usize>> {
        let mut best: Vec<Option<usize>> = vec![None; offsets];
        for (before, edge) in edges {
            let label = self.label(before, edge);
            let index = self.labels.len();
            let (to, free) = (label.edge.to, label.edge.blocked_by.is_none() && !label.edge.ends_chain);
            if free {
                let total = label.terms.rank();
                if best[to].is_none_or(|b| total < self.labels[b].terms.rank()) {
                    best[to] = Some(index);
                }
            } else {
                self.ends.push(index);
            }
            self.labels.push(label);
        }
        best
    }

    fn label(&self, before: Option<usize>, edge: Arc<Edge>) -> Label {
        match before {
            None => {
                Label { terms: edge.terms, free_length: edge.free_length, first_offset: edge.end_offset, before, edge }
            }
            Some(b) => {
                let chain = &self.labels[b];
                Label {
                    terms: chain.terms.plus(&edge.terms),
                    free_length: chain.free_length + edge.free_length,
                    first_offset: chain.first_offset,
                    before,
                    edge,
                }
            }
        }
    }

    /// The cheapest chain to each end offset and through each first offset, cheapest first; chains that end in front of
    /// something pay for what they miss of the horizon.
    fn candidates(mut self, ground: &Ground<'_>, root: &Root, horizon: f64, settings: &Settings) -> Vec<LatticePath> {
        let kept: f64 = root.kept.iter().map(|s| s.length).sum();
        for &end in &self.ends {
            let label = &mut self.labels[end];
            label.terms.missing = settings.weights.missing * (horizon - kept - label.free_length).max(0.0);
        }
        let labels = &self.labels;
        self.ends.sort_by_key(|&end| (labels[end].terms.rank(), end));
        let mut chosen: Vec<usize> = Vec::new();
        for &end in &self.ends {
            let key = |i: usize| (quantum(labels[i].first_offset), quantum(labels[i].edge.end_offset));
            let seen = chosen.iter().any(|&c| key(c) == key(end));
            let similar = chosen.iter().filter(|&&c| key(c).0 == key(end).0).count();
            if !seen && similar < MOST_PER_FIRST_NODE {
                chosen.push(end);
            }
            if chosen.len() == settings.candidates {
                break;
            }
        }
        chosen.into_iter().filter_map(|end| self.path(ground, root, end)).collect()
    }

    fn path(&self, ground: &Ground<'_>, root: &Root, end: usize) -> Option<LatticePath> {
        let mut chain = Vec::new();
        let mut label = Some(end);
        while let Some(l) = label {
            chain.push(Arc::clone(&self.labels[l].edge));
            label = self.labels[l].before;
        }
        chain.reverse();
        let spirals: Vec<_> = root.kept.iter().copied().chain(chain.iter().map(|e| e.spiral)).collect();
        let kept: f64 = root.kept.iter().map(|s| s.length).sum();
        let last = &self.labels[end];
        Some(LatticePath {
            path: Path::new(root.start, &spirals)?,
            sweeps: chain.iter().map(|e| Arc::clone(e.sweep(ground, root))).collect(),
            free_length: kept + last.free_length,
            blocked_by: last.edge.blocked_by,
            terms: last.terms,
            end_offset: last.edge.end_offset,
            first_offset: last.first_offset,
        })
    }
}

/// Kept edges that end this far behind the vehicle are dropped, m: it does not drive backwards, but may replan there.
const FORGOTTEN_BEHIND: f64 = 20.0;
/// A station within this of a grid line lies on it (in grid steps and m): rounding must not decide on which side.
const ON_GRID: f64 = 1e-6;

/// How many candidates may share their first node, so that the speed layer sees different ways to start.
const MOST_PER_FIRST_NODE: usize = 3;

/// Offsets as whole centimetres, to compare them.
#[allow(clippy::cast_possible_truncation)] // metres of lateral offset
fn quantum(offset: f64) -> i64 {
    (offset * 100.0).round() as i64
}

/// The lateral offsets of every layer, m, right to left.
fn offsets(settings: &Settings) -> Vec<f64> {
    #[allow(clippy::cast_possible_truncation)] // a few dozen
    let count = (settings.offset_limit / settings.offset_spacing).floor() as i64;
    (-count..=count).map(|i| i as f64 * settings.offset_spacing).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collision::CollisionSettings;
    use crate::map::{Motion, Obstacle, ObstacleKind, Scenario, Shape};
    use crate::reference::ReferenceSettings;

    /// A car parked ahead on a straight road.
    fn scenario() -> Scenario {
        let network = crate::route::tests::two_lane_road(2);
        let lanelet = network.lanelets.values().next().unwrap();
        let parked = Pose { position: lanelet.centre.at(30.0), yaw: 0.0 };
        let obstacle = Obstacle {
            id: 7,
            kind: ObstacleKind::ParkedVehicle,
            shape: Shape::rectangle(4.5, 1.8),
            motion: Motion::Static(parked),
        };
        Scenario {
            id: "test".into(),
            version: "2020a".into(),
            time_step: 0.1,
            network,
            obstacles: vec![obstacle],
            problems: vec![],
            issues: vec![],
        }
    }

    fn with_ground(test: impl FnOnce(&Ground<'_>)) {
        let scenario = scenario();
        let vehicle = crate::vehicle::load("bmw_320i").unwrap();
        let lane: Vec<i64> = scenario.network.lanelets.keys().copied().filter(|id| *id < 200).collect();
        let settings = ReferenceSettings::default();
        let reference = ReferenceLine::new(&scenario.network, &lane, vehicle.width, &settings).unwrap();
        let world = CollisionWorld::new(&scenario, &vehicle, &CollisionSettings::default(), 5.0).unwrap();
        let (max_curvature, half_width) = (vehicle.max_curvature(), 0.5 * vehicle.width);
        test(&Ground { reference: &reference, world: &world, max_curvature, half_width });
    }

    fn root(ground: &Ground<'_>, station: f64, offset: f64) -> Root {
        let pose = ground.reference.offset_pose(station, offset).unwrap().pose;
        Root { pose, curvature: 0.0, kept: vec![], start: pose, allowance: Allowance::NONE }
    }

    fn summary(paths: &[LatticePath]) -> Vec<(Path, f64, CostTerms, Option<Blocker>)> {
        paths.iter().map(|p| (p.path.clone(), p.free_length, p.terms, p.blocked_by)).collect()
    }

    #[test]
    fn what_a_store_was_asked_before_does_not_change_its_answers() {
        with_ground(|ground| {
            let settings = Settings::default();
            let mut used = EdgeStore::default();
            // from the side, other nodes are reached first
            for (station, offset) in [(5.0, 1.0), (5.5, -0.5), (5.0, 1.0), (6.0, 0.3), (5.0, 0.0)] {
                let root = root(ground, station, offset);
                let asked = paths(ground, &root, 5.0, 40.0, &settings, &mut used);
                let fresh = paths(ground, &root, 5.0, 40.0, &settings, &mut EdgeStore::default());
                assert!(!fresh.is_empty());
                assert_eq!(summary(&asked), summary(&fresh));
                let again = paths(ground, &root, 5.0, 40.0, &settings, &mut used);
                assert_eq!(summary(&again), summary(&fresh));
            }
        });
    }

    #[test]
    fn the_parked_car_is_passed_or_stopped_at_and_no_path_ends_off_the_road() {
        with_ground(|ground| {
            let found =
                paths(ground, &root(ground, 5.0, 0.0), 5.0, 40.0, &Settings::default(), &mut EdgeStore::default());
            assert!(found.iter().any(|p| p.blocked_by.is_none()), "nothing passes");
            assert!(found.windows(2).all(|w| w[0].terms.rank() <= w[1].terms.rank()));
            for path in found.iter().filter(|p| p.blocked_by.is_none()) {
                let end = path.path.at(path.path.length()).pose;
                assert_eq!(ground.world.start_overlap(&end, 0.0), None);
            }
        });
    }
}
