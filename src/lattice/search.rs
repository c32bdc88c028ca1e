//! The cheapest chains of edges through the layers, with as few collision checks as it takes.
//!
//! What an edge costs at least (bending, offset, lane, slowing) is known as soon as its spiral is; the collision check, which adds
//! the closeness to obstacles and may cut the edge short, costs ten times as much. So the search is lazy (Dellin and
//! Srinivasa 2016, A Unifying Formalism for Shortest Path Problems with Expensive Edge Evaluations: LazySP): dynamic
//! programming over the layers with the costs known so far; the edges of the chains that would be handed out are checked,
//! and those that would be handed out if they were blocked; and again, until all these were checked before. As costs only
//! rise by a check, what is handed out then is what would be if every edge had been checked (tested).
//!
//! Each search reveals the checks to itself in the same order, whatever the store has from before, so that answers do not
//! depend on what was asked earlier.

use std::sync::Arc;

use rayon::prelude::*;

use super::cost::{CostTerms, rank};
use super::counts::{EdgeCounts, NoEdge};
use super::edges::{Edge, KeptPrefix};
use super::store::{EdgeStore, NodeEdges};
use super::{Found, LatticeContext, LatticePath, Node, Root, Settings};
use crate::trajectory::Path;

/// How many candidates may share their first node, so that the speed layer sees different ways to start.
const MOST_PER_FIRST_NODE: usize = 3;

/// An edge on its way into a layer.
struct Incoming {
    edge: Arc<Edge>,
    /// Index of the node it starts at; `None` from the root.
    from: Option<usize>,
    /// What it costs at the present speed beyond what it always costs.
    curve_slowdown: f64,
    /// Whether this search has asked for its collision check.
    is_revealed: bool,
}

impl Incoming {
    fn new(edge: Arc<Edge>, from: Option<usize>, context: &LatticeContext<'_>, settings: &Settings) -> Self {
        let curve_slowdown = edge.curve_slowdown(context, &settings.weights);
        Self { edge, from, curve_slowdown, is_revealed: false }
    }

    /// Its cost as far as this search knows it, how far it may be driven, m, and whether another edge can follow.
    fn known(&self) -> (f64, f64, bool) {
        let goes_on = !self.edge.ends_chain;
        match self.edge.checked().filter(|_| self.is_revealed) {
            Some(checked) => {
                let goes_on = goes_on && checked.blocked_by.is_none();
                (checked.terms.total() + self.curve_slowdown, checked.free_length, goes_on)
            }
            None => (self.edge.least.total() + self.curve_slowdown, self.edge.spiral.length, goes_on),
        }
    }
}

/// The cheapest chain to the end of an edge, as far as costs are known.
#[derive(Clone, Copy)]
struct Label {
    /// Layer that the edge leads to, and its index there.
    edge: (usize, usize),
    /// Label of the chain before it.
    before: Option<usize>,
    /// Node that the first edge of the chain leads to.
    first: usize,
    cost: f64,
    /// Length from the root to the end of the free part of the edge, m.
    free_length: f64,
}

/// Where a candidate may end, in order of cost.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct End {
    rank: i64,
    label: usize,
    /// Whether it is an end whatever the check of its edge says; if not, only when that finds it blocked.
    is_final: bool,
}

/// A search under way.
pub(super) struct Search<'a> {
    context: &'a LatticeContext<'a>,
    root: &'a Root,
    settings: &'a Settings,
    horizon: f64,
    nodes: Vec<Node>,
    before: KeptPrefix,
    /// The edges into each layer.
    layers: Vec<Vec<Incoming>>,
    counts: EdgeCounts,
}

impl<'a> Search<'a> {
    /// Lays all edges between the layers and from the root, unchecked. `stations`: see [`super::layers::ahead`].
    pub(super) fn new(
        context: &'a LatticeContext<'a>,
        root: &'a Root,
        stations: &[i64],
        horizon: f64,
        settings: &'a Settings,
        store: &mut EdgeStore,
    ) -> Self {
        let (nodes, before) = (super::nodes(settings), KeptPrefix::root(context, root, &settings.weights));
        let mut search =
            Self { context, root, settings, horizon, nodes, before, layers: Vec::new(), counts: EdgeCounts::default() };
        for (i, station) in stations.iter().enumerate() {
            let mut incoming = Vec::new();
            if i > 0 {
                search.extend_from_layer((stations[i - 1], *station), store, &mut incoming);
            }
            // long edges straight from the root: a gentle change of lanes takes more than one stride
            if i < settings.root_layers.max(1) {
                let found = search.root_edges(*station, store);
                search.counts.solved += found.edges.len();
                search.counts.add(&found.refused);
                incoming.extend(found.edges.into_iter().map(|edge| Incoming::new(edge, None, context, settings)));
            }
            search.layers.push(incoming);
        }
        search
    }

    /// Edges from the nodes of the last layer that some edge leads to.
    fn extend_from_layer(&mut self, pair: (i64, i64), store: &mut EdgeStore, incoming: &mut Vec<Incoming>) {
        let mut is_reached = vec![false; self.nodes.len()];
        for step in self.layers.last().into_iter().flatten().filter(|step| !step.edge.ends_chain) {
            is_reached[step.edge.to] = true;
        }
        let starts: Vec<usize> = (0..is_reached.len()).filter(|i| is_reached[*i]).collect();
        let (edges, solved) = store.between(self.context, pair, &starts, &self.nodes, self.settings);
        self.counts.solved += solved;
        for from in starts {
            let Some(node) = &edges[from] else { continue };
            self.counts.add(&node.refused);
            incoming.extend(
                node.edges.iter().map(|edge| Incoming::new(Arc::clone(edge), Some(from), self.context, self.settings)),
            );
        }
    }

    fn root_edges(&self, station: i64, store: &mut EdgeStore) -> NodeEdges {
        // who starts off the road, or inside a margin, may pass over nodes that are off it
        let all = vec![true; self.nodes.len()];
        let is_on_road = self.root.allowance == crate::collision::Allowance::NONE;
        let ends = if is_on_road { store.on_road(self.context, station, &self.nodes, self.settings) } else { &all };
        let begins = self.context.reference.project(self.root.pose.position).s;
        let station = station as f64 * self.settings.grid;
        let tried: Vec<Result<Edge, NoEdge>> = (0..self.nodes.len())
            .into_par_iter()
            .map(|j| {
                if ends[j] {
                    let to = (station, &self.nodes[j], j);
                    Edge::from_root(self.context, (begins, self.root), to, self.settings)
                } else {
                    Err(NoEdge::OffRoad)
                }
            })
            .collect();
        let mut found = NodeEdges::default();
        tried.into_iter().for_each(|edge| found.take(edge));
        found
    }

    /// The cheapest chains, their edges checked.
    pub(super) fn run(mut self) -> Found {
        loop {
            let (labels, ends) = self.cheapest();
            let (chosen, provisional) = self.chosen(&labels, ends);
            let mut asked: Vec<(usize, usize)> = chosen
                .iter()
                .chain(&provisional)
                .flat_map(|end| chain(&labels, *end))
                .filter(|(layer, index)| !self.layers[*layer][*index].is_revealed)
                .collect();
            asked.sort_unstable();
            asked.dedup();
            if asked.is_empty() {
                let paths = chosen.iter().filter_map(|end| self.path(&labels, *end)).collect();
                return Found { paths, counts: self.counted() };
            }
            self.evaluate(&asked);
        }
    }

    /// [`Self::run`] with every edge checked first: the slow way, to hold it against.
    #[cfg(test)]
    pub(super) fn run_eagerly(mut self) -> Found {
        let lengths = self.layers.iter().map(Vec::len).enumerate();
        let all: Vec<_> = lengths.flat_map(|(layer, n)| (0..n).map(move |index| (layer, index))).collect();
        self.evaluate(&all);
        self.run()
    }

    /// Checks edges for collision, those that were not checked before.
    fn evaluate(&mut self, asked: &[(usize, usize)]) {
        let (context, settings) = (self.context, self.settings);
        let steps: Vec<&Incoming> = asked.iter().map(|(layer, index)| &self.layers[*layer][*index]).collect();
        let new: Vec<&&Incoming> = steps.iter().filter(|step| step.edge.checked().is_none()).collect();
        self.counts.swept += new.len();
        new.par_iter().for_each(|step| {
            let before = if step.from.is_none() { &self.before } else { &KeptPrefix::NOTHING };
            step.edge.check(context, before, settings);
        });
        for (layer, index) in asked {
            self.layers[*layer][*index].is_revealed = true;
        }
    }

    /// Dynamic programming: a label for every edge that a chain leads to, and where a candidate may end: at the last layer,
    /// in front of something, and on any edge that was not checked yet.
    fn cheapest(&self) -> (Vec<Label>, Vec<End>) {
        let mut labels: Vec<Label> = Vec::with_capacity(self.layers.iter().map(Vec::len).sum());
        let mut ends: Vec<(usize, bool)> = Vec::new();
        let mut reached: Vec<Option<usize>> = vec![None; self.nodes.len()];
        for (layer, incoming) in self.layers.iter().enumerate() {
            let mut best: Vec<Option<usize>> = vec![None; self.nodes.len()];
            for (index, step) in incoming.iter().enumerate() {
                let before = match step.from {
                    None => None,
                    Some(from) => match reached[from] {
                        Some(label) => Some(label),
                        None => continue,
                    },
                };
                let (cost, way, goes_on) = step.known();
                let (cost_before, way_before, first) = match before {
                    None => (0.0, 0.0, step.edge.to),
                    Some(label) => (labels[label].cost, labels[label].free_length, labels[label].first),
                };
                let (cost, free_length) = (cost_before + cost, way_before + way);
                let label = Label { edge: (layer, index), before, first, cost, free_length };
                let best = &mut best[step.edge.to];
                if !goes_on {
                    ends.push((labels.len(), true));
                } else {
                    if !step.is_revealed {
                        ends.push((labels.len(), false));
                    }
                    if best.is_none_or(|b: usize| rank(label.cost) < rank(labels[b].cost)) {
                        *best = Some(labels.len());
                    }
                }
                labels.push(label);
            }
            reached = best;
        }
        ends.extend(reached.into_iter().flatten().map(|label| (label, true)));
        let rank = |label: usize| rank(labels[label].cost + self.missing(&labels[label]));
        let ends = ends.into_iter().map(|(label, is_final)| End { rank: rank(label), label, is_final }).collect();
        (labels, ends)
    }

    /// What a chain pays for what it misses of the horizon.
    fn missing(&self, label: &Label) -> f64 {
        self.settings.weights.progress_shortfall * (self.horizon - self.before.length - label.free_length).max(0.0)
    }

    /// The cheapest chain to each end node and through each first node, cheapest first; and those that would come among
    /// them if their last edge, which is not checked yet, should turn out to be blocked.
    fn chosen(&self, labels: &[Label], mut ends: Vec<End>) -> (Vec<usize>, Vec<usize>) {
        ends.sort_unstable();
        let key = |end: usize| {
            let Label { edge: (layer, index), first, .. } = labels[end];
            (first, self.layers[layer][index].edge.to)
        };
        let (mut chosen, mut provisional): (Vec<usize>, Vec<usize>) = (Vec::new(), Vec::new());
        for End { label: end, is_final, .. } in ends {
            let is_seen = chosen.iter().any(|c| key(*c) == key(end));
            let similar = chosen.iter().filter(|c| key(**c).0 == key(end).0).count();
            if is_seen || similar >= MOST_PER_FIRST_NODE {
                continue;
            }
            if is_final {
                chosen.push(end);
            } else {
                provisional.push(end);
            }
            if chosen.len() == self.settings.candidates {
                break;
            }
        }
        (chosen, provisional)
    }

    fn path(&self, labels: &[Label], end: usize) -> Option<LatticePath> {
        let steps: Vec<&Incoming> = chain(labels, end).map(|(layer, index)| &self.layers[layer][index]).collect();
        let edges: Vec<&Edge> = steps.iter().map(|step| &*step.edge).collect();
        let checked = edges.iter().map(|edge| edge.checked()).collect::<Option<Vec<_>>>()?;
        let spirals: Vec<_> = self.root.kept.iter().copied().chain(edges.iter().map(|edge| edge.spiral)).collect();
        let terms = checked.iter().fold(CostTerms::default(), |sum, edge| sum.plus(&edge.terms));
        let last = checked.last()?;
        Some(LatticePath {
            path: Path::new(self.root.start, &spirals)?,
            sweeps: self
                .before
                .sweeps
                .iter()
                .chain(edges.iter().map(|e| e.sweep(self.context)))
                .map(Arc::clone)
                .collect(),
            kept: self.root.kept.len(),
            free_length: self.before.length + labels[end].free_length,
            blocked_by: last.blocked_by,
            terms: CostTerms {
                progress_shortfall: self.missing(&labels[end]),
                curve_slowdown: steps.iter().map(|step| step.curve_slowdown).sum(),
                ..terms
            },
            end_offset: edges.last()?.end_offset,
            first_offset: edges.first()?.end_offset,
        })
    }

    fn counted(self) -> EdgeCounts {
        let mut counts = self.counts;
        for step in self.layers.iter().flatten() {
            match step.edge.checked().filter(|_| step.is_revealed) {
                Some(checked) => counts.count_checked(checked.blocked_by),
                None => counts.count_unchecked(),
            }
        }
        counts
    }
}

/// The edges of the chain that ends with a label, first to last.
fn chain(labels: &[Label], end: usize) -> impl Iterator<Item = (usize, usize)> {
    let mut edges: Vec<(usize, usize)> =
        std::iter::successors(Some(end), |label| labels[*label].before).map(|label| labels[label].edge).collect();
    edges.reverse();
    edges.into_iter()
}
