//! The cheapest chains of edges through the layers, with few collision checks.
//!
//! A lower bound of the cost of an edge (curvature, offset, lane deviation, curve slowdown) is known as soon as its spiral
//! is. The collision check adds the clearance cost and may shorten the edge; it takes ten times as long. So the search is
//! lazy (Dellin and Srinivasa 2016, A Unifying Formalism for Shortest Path Problems with Expensive Edge Evaluations: LazySP):
//!
//! 1. Dynamic programming over the layers with the present lower bounds.
//! 2. Check the edges of the chains that would be returned, also of those that would be returned if their last edge turns
//!    out to be blocked.
//! 3. Repeat until all of these are checked.
//!
//! A check only raises costs, so that the result is that of checking every edge first (tested).
//!
//! A search uses the checks in its own order even if the store has more of them from before, so that results do not depend
//! on earlier searches.

use std::sync::Arc;

use rayon::prelude::*;

use super::cost::{CostTerms, rank};
use super::counts::{EdgeCounts, NoEdge};
use super::edges::{Edge, KeptPrefix};
use super::layers::Layer;
use super::store::{CheckedEdges, NodeEdges};
use super::{LatticeContext, LatticePath, Root, SearchResult, Settings};
use crate::trajectory::Path;

/// Maximum number of candidates with the same first node, so that the speed search has different starts.
const MAX_PER_FIRST_NODE: usize = 3;

/// An edge into a layer.
struct Incoming {
    edge: Arc<Edge>,
    /// Index of its start node; `None` for the root.
    from: Option<usize>,
    /// The cost term that depends on the present speed.
    curve_slowdown: f64,
    /// Whether this search uses its collision check.
    is_evaluated: bool,
}

impl Incoming {
    fn new(edge: Arc<Edge>, from: Option<usize>, context: &LatticeContext<'_>, settings: &Settings) -> Self {
        let curve_slowdown = edge.curve_slowdown(context, &settings.weights);
        Self { edge, from, curve_slowdown, is_evaluated: false }
    }

    /// Its cost and free length (m) as far as this search has evaluated it, and whether another edge can follow.
    fn known(&self) -> (f64, f64, bool) {
        let can_continue = !self.edge.ends_chain;
        match self.edge.checked().filter(|_| self.is_evaluated) {
            Some(checked) => {
                let can_continue = can_continue && checked.blocked_by.is_none();
                (checked.terms.total() + self.curve_slowdown, checked.free_length, can_continue)
            }
            None => (self.edge.lower_bound.total() + self.curve_slowdown, self.edge.spiral.length, can_continue),
        }
    }
}

/// The cheapest chain to the end of an edge, by the present costs.
#[derive(Clone, Copy)]
struct Label {
    /// Layer of the end of the edge, and the index of the edge there.
    edge: (usize, usize),
    /// Label of the preceding chain.
    before: Option<usize>,
    /// End node of the first edge of the chain.
    first: usize,
    cost: f64,
    /// Length from the root to the end of the free part of the edge, m.
    free_length: f64,
}

/// A possible end of a candidate, in order of cost.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct End {
    rank: i64,
    label: usize,
    /// Whether it is an end independent of the check of its edge; if not, it is an end only if the edge is blocked.
    is_final: bool,
}

/// State of a search.
pub(super) struct Search<'a> {
    context: &'a LatticeContext<'a>,
    root: &'a Root,
    settings: &'a Settings,
    horizon: f64,
    /// The layers ahead, nearest first.
    ahead: Vec<Layer>,
    before: KeptPrefix,
    /// The edges into each layer.
    layers: Vec<Vec<Incoming>>,
    counts: EdgeCounts,
}

impl<'a> Search<'a> {
    /// Creates all edges between the layers and from the root, unchecked. `ahead`: see [`super::layers::ahead`].
    pub(super) fn new(
        context: &'a LatticeContext<'a>,
        root: &'a Root,
        ahead: Vec<Layer>,
        horizon: f64,
        settings: &'a Settings,
        store: &mut CheckedEdges,
    ) -> Self {
        let before = KeptPrefix::root(context, root, &settings.weights);
        let (layers, counts) = (Vec::with_capacity(ahead.len()), EdgeCounts::default());
        let mut search = Self { context, root, settings, horizon, ahead, before, layers, counts };
        for i in 0..search.ahead.len() {
            let mut incoming = Vec::new();
            if i > 0 {
                search.extend_from_layer(i, store, &mut incoming);
            }
            // long edges directly from the root: a gentle lane change takes more than one layer distance
            if i < settings.root_layers.max(1) {
                let from_root = search.root_edges(i, store);
                search.counts.solved += from_root.edges.len();
                search.counts.add(&from_root.rejected);
                incoming.extend(from_root.edges.into_iter().map(|edge| Incoming::new(edge, None, context, settings)));
            }
            search.layers.push(incoming);
        }
        search
    }

    /// Adds the edges into a layer from all reached nodes of the layer before it.
    fn extend_from_layer(&mut self, to: usize, store: &mut CheckedEdges, incoming: &mut Vec<Incoming>) {
        let (from, to) = (&self.ahead[to - 1], &self.ahead[to]);
        let mut is_reached = vec![false; from.nodes.len()];
        for step in self.layers.last().into_iter().flatten().filter(|step| !step.edge.ends_chain) {
            is_reached[step.edge.to] = true;
        }
        let starts: Vec<usize> = (0..is_reached.len()).filter(|i| is_reached[*i]).collect();
        let (edges, solved) = store.between(self.context, (from, to), &starts, self.settings);
        self.counts.solved += solved;
        for from in starts {
            let Some(node) = &edges[from] else { continue };
            self.counts.add(&node.rejected);
            incoming.extend(
                node.edges.iter().map(|edge| Incoming::new(Arc::clone(edge), Some(from), self.context, self.settings)),
            );
        }
    }

    fn root_edges(&self, to: usize, store: &mut CheckedEdges) -> NodeEdges {
        let layer = &self.ahead[to];
        // a vehicle that starts off the road or inside a margin may use nodes off the road
        let all = vec![true; layer.nodes.len()];
        let is_on_road = self.root.allowance == crate::collision::Allowance::NONE;
        let ends = if is_on_road { store.on_road(self.context, layer) } else { &all };
        let begins = self.context.reference.project(self.root.pose.position).s;
        let tried: Vec<Result<Edge, NoEdge>> = (0..layer.nodes.len())
            .into_par_iter()
            .map(|j| {
                if ends[j] {
                    let to = (layer.station, &layer.nodes[j], j);
                    Edge::from_root(self.context, (begins, self.root), to, self.settings)
                } else {
                    Err(NoEdge::OffRoad)
                }
            })
            .collect();
        let mut edges = NodeEdges::default();
        tried.into_iter().for_each(|edge| edges.add(edge));
        edges
    }

    /// Runs the search: the cheapest chains, with all of their edges checked.
    pub(super) fn run(mut self) -> SearchResult {
        loop {
            let (labels, ends) = self.cheapest();
            let (chosen, provisional) = self.chosen(&labels, ends);
            let mut pending: Vec<(usize, usize)> = chosen
                .iter()
                .chain(&provisional)
                .flat_map(|end| chain(&labels, *end))
                .filter(|(layer, index)| !self.layers[*layer][*index].is_evaluated)
                .collect();
            pending.sort_unstable();
            pending.dedup();
            if pending.is_empty() {
                let paths = chosen.iter().filter_map(|end| self.path(&labels, *end)).collect();
                return SearchResult { paths, counts: self.counted() };
            }
            self.evaluate(&pending);
        }
    }

    /// [`Self::run`] with every edge checked first: the slow reference for the tests.
    #[cfg(test)]
    pub(super) fn run_eagerly(mut self) -> SearchResult {
        let lengths = self.layers.iter().map(Vec::len).enumerate();
        let all: Vec<_> = lengths.flat_map(|(layer, n)| (0..n).map(move |index| (layer, index))).collect();
        self.evaluate(&all);
        self.run()
    }

    /// Checks edges for collision, unless a cached check exists, and marks them as evaluated.
    fn evaluate(&mut self, pending: &[(usize, usize)]) {
        let (context, settings) = (self.context, self.settings);
        let steps: Vec<&Incoming> = pending.iter().map(|(layer, index)| &self.layers[*layer][*index]).collect();
        let new: Vec<&&Incoming> = steps.iter().filter(|step| step.edge.checked().is_none()).collect();
        self.counts.swept += new.len();
        new.par_iter().for_each(|step| {
            let before = if step.from.is_none() { &self.before } else { &KeptPrefix::EMPTY };
            step.edge.check(context, before, settings);
        });
        for (layer, index) in pending {
            self.layers[*layer][*index].is_evaluated = true;
        }
    }

    /// Dynamic programming: a label for every reached edge, and the possible ends of candidates: at the last layer, in front
    /// of a blocker, and on every edge that is not evaluated yet.
    fn cheapest(&self) -> (Vec<Label>, Vec<End>) {
        let mut labels: Vec<Label> = Vec::with_capacity(self.layers.iter().map(Vec::len).sum());
        let mut ends: Vec<(usize, bool)> = Vec::new();
        let mut reached: Vec<Option<usize>> = Vec::new();
        for (layer, incoming) in self.layers.iter().enumerate() {
            let mut best: Vec<Option<usize>> = vec![None; self.ahead[layer].nodes.len()];
            for (index, step) in incoming.iter().enumerate() {
                let before = match step.from {
                    None => None,
                    Some(from) => match reached[from] {
                        Some(label) => Some(label),
                        None => continue,
                    },
                };
                let (cost, length, can_continue) = step.known();
                let (cost_before, length_before, first) = match before {
                    None => (0.0, 0.0, step.edge.to),
                    Some(label) => (labels[label].cost, labels[label].free_length, labels[label].first),
                };
                let (cost, free_length) = (cost_before + cost, length_before + length);
                let label = Label { edge: (layer, index), before, first, cost, free_length };
                let best = &mut best[step.edge.to];
                if !can_continue {
                    ends.push((labels.len(), true));
                } else {
                    if !step.is_evaluated {
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
        let rank = |label: usize| rank(labels[label].cost + self.shortfall(&labels[label]));
        let ends = ends.into_iter().map(|(label, is_final)| End { rank: rank(label), label, is_final }).collect();
        (labels, ends)
    }

    /// Progress shortfall cost of a chain.
    fn shortfall(&self, label: &Label) -> f64 {
        self.settings.weights.progress_shortfall * (self.horizon - self.before.length - label.free_length).max(0.0)
    }

    /// The cheapest chains to each end node through each first node, cheapest first; and the chains that would be among them
    /// if their last edge, which is not evaluated yet, turned out to be blocked.
    fn chosen(&self, labels: &[Label], mut ends: Vec<End>) -> (Vec<usize>, Vec<usize>) {
        ends.sort_unstable();
        let key = |end: usize| {
            let Label { edge: (layer, index), first, .. } = labels[end];
            (first, self.layers[layer][index].edge.to)
        };
        let (mut chosen, mut provisional): (Vec<usize>, Vec<usize>) = (Vec::new(), Vec::new());
        for End { label: end, is_final, .. } in ends {
            let is_duplicate = chosen.iter().any(|c| key(*c) == key(end));
            let similar = chosen.iter().filter(|c| key(**c).0 == key(end).0).count();
            if is_duplicate || similar >= MAX_PER_FIRST_NODE {
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
                progress_shortfall: self.shortfall(&labels[end]),
                curve_slowdown: steps.iter().map(|step| step.curve_slowdown).sum(),
                missed_target: self.before.missed_target + terms.missed_target,
                ..terms
            },
            end_offset: edges.last()?.end_offset,
            first_offset: edges.first()?.end_offset,
        })
    }

    fn counted(self) -> EdgeCounts {
        let mut counts = self.counts;
        for step in self.layers.iter().flatten() {
            match step.edge.checked().filter(|_| step.is_evaluated) {
                Some(checked) => counts.count_checked(checked.blocked_by),
                None => counts.count_unchecked(),
            }
        }
        counts
    }
}

/// The edges of the chain that ends with a label, from first to last.
fn chain(labels: &[Label], end: usize) -> impl Iterator<Item = (usize, usize)> {
    let mut edges: Vec<(usize, usize)> =
        std::iter::successors(Some(end), |label| labels[*label].before).map(|label| labels[label].edge).collect();
    edges.reverse();
    edges.into_iter()
}
