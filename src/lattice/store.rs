//! What stays the same from cycle to cycle: edges between nodes, and the last answers.

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use super::counts::{EdgeCounts, NoEdge};
use super::edges::Edge;
use super::{Found, LatticeContext, Node, Root, Settings};
use crate::collision::{Allowance, Blocker};
use crate::geometry::spiral::CubicSpiral;

/// Station index from, station index to.
type LayerPair = (i64, i64);

/// The edges that start at a node, in order of the node they end at, and the reasons of those that there are not.
#[derive(Debug, Clone, Default)]
pub(super) struct NodeEdges {
    pub(super) edges: Vec<Arc<Edge>>,
    pub(super) refused: EdgeCounts,
}

impl NodeEdges {
    pub(super) fn take(&mut self, tried: Result<Edge, NoEdge>) {
        match tried {
            Ok(edge) => self.edges.push(Arc::new(edge)),
            Err(reason) => self.refused.count_refused(reason),
        }
    }
}

/// Keeps what stays the same: the edges between lattice nodes from cycle to cycle, which depend on the reference line and
/// the static world only, and the last answers of [`super::search`], which several attempts of one cycle ask for again. A
/// store belongs to one reference line, one collision world and one set of settings.
#[derive(Debug, Clone, Default)]
pub struct EdgeStore {
    /// By the node they start at; `None` where nobody asked yet.
    layers: HashMap<LayerPair, Vec<Option<NodeEdges>>>,
    /// For each station index, which nodes are worth going to.
    on_road: HashMap<i64, Vec<bool>>,
    pub(super) answers: Answers,
}

impl EdgeStore {
    /// Drops what lies behind a station, m.
    pub(super) fn forget_before(&mut self, station: f64, settings: &Settings) {
        let ahead = |index: i64| index as f64 * settings.grid >= station;
        self.layers.retain(|(_, to), _| ahead(*to));
        self.on_road.retain(|index, _| ahead(*index));
    }

    /// Which nodes of a layer edges may lead to: those at which the vehicle, margins included, is on the road. All, if
    /// none is.
    pub(super) fn on_road(
        &mut self,
        context: &LatticeContext<'_>,
        station: i64,
        nodes: &[Node],
        settings: &Settings,
    ) -> &[bool] {
        self.on_road.entry(station).or_insert_with(|| {
            let s = station as f64 * settings.grid;
            let is_on_road = |node: &Node| {
                node.point(context, s).is_some_and(|point| {
                    let mut here = context.world.probe(&point.pose, &CubicSpiral::straight(NODE_LENGTH));
                    here.static_hit(&Allowance::NONE).is_none_or(|hit| hit.what != Blocker::RoadBoundary)
                })
            };
            let on_road: Vec<bool> = nodes.iter().map(is_on_road).collect();
            if on_road.contains(&true) { on_road } else { vec![true; nodes.len()] }
        })
    }

    /// Edges between two layers by the node they start at, there for (at least) the `starts` given, and how many spirals
    /// had to be solved for them.
    pub(super) fn between(
        &mut self,
        context: &LatticeContext<'_>,
        (from, to): LayerPair,
        starts: &[usize],
        nodes: &[Node],
        settings: &Settings,
    ) -> (&[Option<NodeEdges>], usize) {
        let ends = self.on_road(context, to, nodes, settings).to_vec();
        let layer = self.layers.entry((from, to)).or_insert_with(|| vec![None; nodes.len()]);
        let (s0, s1) = (from as f64 * settings.grid, to as f64 * settings.grid);
        let pairs: Vec<(usize, usize)> = starts
            .iter()
            .filter(|i| layer[**i].is_none())
            .flat_map(|&i| (0..nodes.len()).map(move |j| (i, j)))
            .filter(|&(i, j)| (nodes[i].offset - nodes[j].offset).abs() <= settings.max_slope * (s1 - s0))
            .collect();
        let tried: Vec<Result<Edge, NoEdge>> = pairs
            .par_iter()
            .map(|&(i, j)| {
                if ends[j] {
                    Edge::between(context, (s0, &nodes[i]), (s1, &nodes[j], j), settings)
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
            layer[i].get_or_insert_default().take(edge);
        }
        (layer, solved)
    }
}

/// Length of the sweep that stands for a node, m.
const NODE_LENGTH: f64 = 0.05;

/// What [`super::search`] was asked.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Question {
    pub(super) root: Root,
    pub(super) speed: f64,
    pub(super) full_speed_curvature: f64,
    pub(super) horizon: f64,
}

/// The last questions with their answers, oldest first.
#[derive(Debug, Clone, Default)]
pub(super) struct Answers(Vec<(Question, Found)>);

impl Answers {
    /// Questions kept: a cycle asks from two roots.
    const KEPT: usize = 2;

    pub(super) fn get(&self, question: &Question) -> Option<Found> {
        self.0.iter().find(|(asked, _)| asked == question).map(|(_, answer)| answer.clone())
    }

    /// Keeps an answer; given again, it says that nothing was made for it.
    pub(super) fn keep(&mut self, question: Question, answer: &Found) {
        if self.0.len() == Self::KEPT {
            self.0.remove(0);
        }
        let mut answer = answer.clone();
        (answer.counts.solved, answer.counts.swept) = (0, 0);
        self.0.push((question, answer));
    }
}
