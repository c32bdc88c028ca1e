//! The lane graph: lanelets as nodes, successors and lane changes as edges. The searches are those of petgraph.

use std::collections::BTreeMap;

use petgraph::algo::{astar, dijkstra};
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::{EdgeRef, Reversed};

use crate::geometry::Point;
use crate::map::{LaneletId, RoadNetwork};

/// Cost of a lane change, as metres of detour.
const LANE_CHANGE_COST: f64 = 30.0;

/// Kind of an edge between lanelets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// To a successor.
    Follow,
    /// To an adjacent lanelet of the same direction.
    Change,
}

/// The lane graph of a road network: drivable lanelets only.
///
/// The cost of an edge to a successor is the length of the lanelet before it, that of a lane change 30 m. Each is at least
/// the distance between the first points of the two lanelets (which is larger for gaps between lanelets), so that the
/// straight-line distance between first points is a consistent heuristic.
#[derive(Debug, Clone)]
pub struct LaneGraph {
    graph: DiGraph<LaneletId, (Link, f64)>,
    nodes: BTreeMap<LaneletId, NodeIndex>,
    firsts: BTreeMap<LaneletId, Point>,
}

/// A path through the lane graph.
#[derive(Debug, Clone, PartialEq)]
pub struct LanePath {
    /// Lanelets from the start to the goal, including both.
    pub lanelets: Vec<LaneletId>,
    /// Cost, m (lengths and lane changes).
    pub cost: f64,
}

impl LaneGraph {
    /// The graph of a network, without references to lanelets that do not exist or are not drivable.
    #[must_use]
    pub fn new(network: &RoadNetwork) -> Self {
        let mut graph = DiGraph::new();
        let (mut nodes, mut firsts) = (BTreeMap::new(), BTreeMap::new());
        for lanelet in network.lanelets.values().filter(|l| l.is_drivable()) {
            nodes.insert(lanelet.id, graph.add_node(lanelet.id));
            firsts.insert(lanelet.id, lanelet.centre.first());
        }
        for lanelet in network.lanelets.values() {
            let Some(&from) = nodes.get(&lanelet.id) else { continue };
            let follow = lanelet.successors.iter().map(|id| (*id, Link::Follow, lanelet.centre.length()));
            let adjacent = [lanelet.adjacent_left, lanelet.adjacent_right];
            let change = adjacent.iter().flatten().filter(|n| n.same_direction);
            let change = change.map(|n| (n.id, Link::Change, LANE_CHANGE_COST));
            for (id, link, cost) in follow.chain(change) {
                let Some(&to) = nodes.get(&id) else { continue };
                let apart = (firsts[&id] - firsts[&lanelet.id]).norm();
                graph.add_edge(from, to, (link, cost.max(apart)));
            }
        }
        Self { graph, nodes, firsts }
    }

    /// Whether the lanelet is in the graph.
    #[must_use]
    pub fn contains(&self, id: LaneletId) -> bool {
        self.nodes.contains_key(&id)
    }

    /// The edges of a lanelet in the order of the file: target, kind, cost (m).
    pub fn links(&self, id: LaneletId) -> impl Iterator<Item = (LaneletId, Link, f64)> + '_ {
        let mut links: Vec<_> = self
            .nodes
            .get(&id)
            .into_iter()
            .flat_map(|node| self.graph.edges(*node))
            .map(|edge| (self.graph[edge.target()], edge.weight().0, edge.weight().1))
            .collect();
        // petgraph iterates from the newest edge
        links.reverse();
        links.into_iter()
    }

    /// The cheapest path from a lanelet to any of the goals (A*). `None` if there is no path.
    #[must_use]
    pub fn shortest(&self, start: LaneletId, goals: &[LaneletId]) -> Option<LanePath> {
        let start = *self.nodes.get(&start)?;
        let targets: Vec<Point> = goals.iter().filter_map(|id| self.firsts.get(id)).copied().collect();
        let distance_left = |node: NodeIndex| {
            let here = self.firsts[&self.graph[node]];
            targets.iter().map(|t| (t - here).norm()).fold(f64::INFINITY, f64::min)
        };
        if targets.is_empty() {
            return None;
        }
        let is_goal = |node| goals.contains(&self.graph[node]);
        let (cost, path) = astar(&self.graph, start, is_goal, |e| e.weight().1, distance_left)?;
        Some(LanePath { lanelets: path.into_iter().map(|n| self.graph[n]).collect(), cost })
    }

    /// Cost to the nearest goal, for each lanelet from which one can be reached: one backward search (Dijkstra).
    #[must_use]
    pub fn costs_to_go(&self, goals: &[LaneletId]) -> BTreeMap<LaneletId, f64> {
        let mut graph = self.graph.clone();
        let sink = graph.add_node(LaneletId::MIN);
        for node in goals.iter().filter_map(|id| self.nodes.get(id)) {
            graph.add_edge(*node, sink, (Link::Follow, 0.0));
        }
        let costs = dijkstra(Reversed(&graph), sink, None, |e| e.weight().1);
        self.nodes.iter().filter_map(|(id, node)| costs.get(node).map(|cost| (*id, *cost))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::two_lane_road;
    use proptest::prelude::*;

    #[test]
    fn edges_keep_the_order_of_the_file_and_skip_missing_lanelets() {
        let mut network = two_lane_road(3);
        let first = network.lanelets.get_mut(&100).unwrap();
        first.successors.insert(0, 999);
        let graph = LaneGraph::new(&network);
        let links: Vec<_> = graph.links(100).map(|(id, link, _)| (id, link)).collect();
        assert_eq!(links, [(101, Link::Follow), (200, Link::Change)]);
        network.lanelets.get_mut(&101).unwrap().types.push("sidewalk".into());
        assert!(!LaneGraph::new(&network).contains(101));
    }

    #[test]
    fn a_goal_on_the_other_lane_costs_one_lane_change() {
        let graph = LaneGraph::new(&two_lane_road(4));
        let path = graph.shortest(100, &[203]).unwrap();
        assert_eq!(path.lanelets.len(), 5);
        assert!((path.cost - (3.0 * 50.0 + LANE_CHANGE_COST)).abs() < 1e-9);
        assert!(graph.shortest(103, &[100]).is_none(), "no path leads backwards");
    }

    proptest! {
        /// A* with its heuristic and the backward search without one agree on random networks with gaps.
        #[test]
        fn forward_and_backward_searches_agree(
            edges in prop::collection::vec((0..8i64, 0..8i64), 5..25), goal in 0..8i64, gap in 0.0..200.0f64
        ) {
            let mut network = two_lane_road(4);
            let ids: Vec<i64> = network.lanelets.keys().copied().collect();
            for lanelet in network.lanelets.values_mut() {
                lanelet.successors.clear();
            }
            for (from, to) in edges {
                let (from, to) = (ids[usize::try_from(from).unwrap()], ids[usize::try_from(to).unwrap()]);
                network.lanelets.get_mut(&from).unwrap().successors.push(to);
            }
            let moved = network.lanelets.get_mut(&102).unwrap();
            moved.centre = crate::geometry::polyline::Polyline::new(
                moved.centre.points().iter().map(|p| p + crate::geometry::Vector::new(0.0, gap))).unwrap();
            let graph = LaneGraph::new(&network);
            let goals = [ids[usize::try_from(goal).unwrap()]];
            let costs = graph.costs_to_go(&goals);
            for id in ids {
                match (graph.shortest(id, &goals), costs.get(&id)) {
                    (Some(path), Some(cost)) => prop_assert!((path.cost - cost).abs() < 1e-9, "{} {}", path.cost, cost),
                    (forward, backward) => prop_assert!(forward.is_none() && backward.is_none()),
                }
            }
        }
    }
}
