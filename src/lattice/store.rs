//! The cache between cycles: edges between nodes, and the last search results.

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use super::counts::{EdgeCounts, NoEdge};
use super::edges::Edge;
use super::layers::{Layer, LayerId};
use super::{LatticeContext, Node, Root, SearchResult, Settings};
use crate::collision::{Allowance, Blocker, SafetyMargins};
use crate::geometry::spiral::CubicSpiral;

/// Two consecutive layers.
type LayerPair = (LayerId, LayerId);

/// The edges that start at a node, in order of their end nodes, and counts of the rejected ones.
#[derive(Debug, Clone, Default)]
pub(super) struct NodeEdges {
    pub(super) edges: Vec<Arc<Edge>>,
    pub(super) rejected: EdgeCounts,
}

impl NodeEdges {
    pub(super) fn add(&mut self, tried: Result<Edge, NoEdge>) {
        match tried {
            Ok(edge) => self.edges.push(Arc::new(edge)),
            Err(reason) => self.rejected.count_rejected(reason),
        }
    }
}

/// Cache of lattice edges. Edges between nodes depend only on the reference line, the static world and the margins, and are
/// valid for many cycles. The last results of [`super::Lattice::search`] are cached as well, since several attempts of a cycle
/// repeat them. A store belongs to one reference line, one static world and one set of settings; it keeps the edges of every
/// margins apart.
#[derive(Debug, Clone, Default)]
pub struct EdgeStore(Vec<(SafetyMargins, CheckedEdges)>);

impl EdgeStore {
    /// The edges checked with the margins.
    pub(super) fn of(&mut self, margins: &SafetyMargins) -> &mut CheckedEdges {
        let found = self.0.iter().position(|(of, _)| of == margins).unwrap_or_else(|| {
            self.0.push((*margins, CheckedEdges::default()));
            self.0.len() - 1
        });
        &mut self.0[found].1
    }
}

/// The edges checked with the same margins.
#[derive(Debug, Clone, Default)]
pub(super) struct CheckedEdges {
    /// Edges by start node; `None` if not computed yet.
    layers: HashMap<LayerPair, Vec<Option<NodeEdges>>>,
    /// For each layer, whether each node is on the road.
    on_road: HashMap<LayerId, Vec<bool>>,
    pub(super) recent: RecentResults,
}

impl CheckedEdges {
    /// Drops everything behind a station, m.
    pub(super) fn drop_before(&mut self, station: f64, settings: &Settings) {
        let ahead = |layer: LayerId| layer.station(settings).is_none_or(|s| s >= station);
        self.layers.retain(|(_, to), _| ahead(*to));
        self.on_road.retain(|index, _| ahead(*index));
    }

    /// For each node of a layer, whether edges may lead to it: the vehicle with its margins must be on the road there. All
    /// nodes, if this holds for none.
    pub(super) fn on_road(&mut self, context: &LatticeContext<'_>, layer: &Layer) -> &[bool] {
        let Layer { id, station, nodes } = layer;
        self.on_road.entry(*id).or_insert_with(|| {
            let is_on_road = |node: &Node| {
                node.point(context, *station).is_some_and(|point| {
                    let mut here = context.world.probe(&point.pose, &CubicSpiral::straight(NODE_LENGTH));
                    here.static_hit(&context.margins, &Allowance::NONE)
                        .is_none_or(|hit| hit.what != Blocker::RoadBoundary)
                })
            };
            let on_road: Vec<bool> = nodes.iter().map(is_on_road).collect();
            if on_road.contains(&true) { on_road } else { vec![true; nodes.len()] }
        })
    }

    /// Edges between two layers by start node, computed for at least the given `starts`, and the number of spirals that were
    /// solved for it.
    pub(super) fn between(
        &mut self,
        context: &LatticeContext<'_>,
        (from, to): (&Layer, &Layer),
        starts: &[usize],
        settings: &Settings,
    ) -> (&[Option<NodeEdges>], usize) {
        let ends = self.on_road(context, to).to_vec();
        let layer = self.layers.entry((from.id, to.id)).or_insert_with(|| vec![None; from.nodes.len()]);
        let (s0, s1) = (from.station, to.station);
        let pairs: Vec<(usize, usize)> = starts
            .iter()
            .filter(|i| layer[**i].is_none())
            .flat_map(|&i| (0..to.nodes.len()).map(move |j| (i, j)))
            .filter(|&(i, j)| (from.nodes[i].offset - to.nodes[j].offset).abs() <= settings.max_slope * (s1 - s0))
            .collect();
        let tried: Vec<Result<Edge, NoEdge>> = pairs
            .par_iter()
            .map(|&(i, j)| {
                if ends[j] {
                    Edge::between(context, (s0, &from.nodes[i]), (s1, &to.nodes[j], j), settings)
                } else {
                    Err(NoEdge::OffRoad)
                }
            })
            .collect();
        for i in starts {
            layer[*i].get_or_insert_default();
        }
        let solved = tried.iter().filter(|edge| edge.is_ok()).count();
        for ((i, _), edge) in pairs.into_iter().zip(tried) {
            layer[i].get_or_insert_default().add(edge);
        }
        (layer, solved)
    }
}

/// Length of the sweep at a node, m.
const NODE_LENGTH: f64 = 0.05;

/// Arguments of [`super::Lattice::search`].
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SearchQuery {
    pub(super) root: Root,
    pub(super) speed: f64,
    pub(super) full_speed_curvature: f64,
    pub(super) horizon: f64,
}

/// The last queries with their results, oldest first.
#[derive(Debug, Clone, Default)]
pub(super) struct RecentResults(Vec<(SearchQuery, SearchResult)>);

impl RecentResults {
    /// Capacity: a cycle searches from two roots.
    const CAPACITY: usize = 2;

    pub(super) fn get(&self, query: &SearchQuery) -> Option<SearchResult> {
        self.0.iter().find(|(cached, _)| cached == query).map(|(_, result)| result.clone())
    }

    /// Caches a result. When it is returned again, its `solved` and `swept` counts are zero.
    pub(super) fn keep(&mut self, query: SearchQuery, result: &SearchResult) {
        if self.0.len() == Self::CAPACITY {
            self.0.remove(0);
        }
        let mut result = result.clone();
        (result.counts.solved, result.counts.swept) = (0, 0);
        self.0.push((query, result));
    }
}
