//! Chains of lanelets along one lane: forwards along the route, backwards for a clean projection.

use std::collections::BTreeMap;

use super::graph::{LaneGraph, Link};
use crate::geometry::wrap_angle;
use crate::map::{LaneletId, RoadNetwork};

/// Metres of missing road that are as bad as a radian of turning, where no goal decides between branches.
const DEAD_END_PER_RADIAN: f64 = 100.0;
/// No chain is longer than this many lanelets: a bound for files with lanelets of centimetres.
const MOST_LANELETS: usize = 500;

/// Knows which way to go on from each lanelet.
pub(super) struct Guide<'a> {
    pub(super) network: &'a RoadNetwork,
    pub(super) graph: &'a LaneGraph,
    /// Cost to the goal, of the lanelets that reach it; empty without a goal.
    pub(super) costs: &'a BTreeMap<LaneletId, f64>,
}

impl Guide<'_> {
    fn length(&self, id: LaneletId) -> f64 {
        self.network.lanelets.get(&id).map_or(0.0, |l| l.centre.length())
    }

    /// Heading at the end (`true`) or start of a lanelet.
    fn yaw(&self, id: LaneletId, at_end: bool) -> f64 {
        self.network.lanelets.get(&id).map_or(0.0, |l| l.centre.yaw_at(if at_end { l.centre.length() } else { 0.0 }))
    }

    fn successors(&self, id: LaneletId) -> impl Iterator<Item = LaneletId> + '_ {
        self.graph.links(id).filter(|(_, link, _)| *link == Link::Follow).map(|(to, ..)| to)
    }

    /// Metres of road from the start of a lanelet along its longest continuation, up to `enough`. `depth` bounds the walk.
    fn road_ahead(&self, id: LaneletId, enough: f64, depth: usize) -> f64 {
        let length = self.length(id);
        if length >= enough || depth == 0 {
            return length;
        }
        let mut best = 0.0_f64;
        for next in self.successors(id) {
            best = best.max(self.road_ahead(next, enough - length, depth - 1));
            if length + best >= enough {
                break;
            }
        }
        length + best
    }

    /// The best continuation: towards the goal where the goal can be reached without leaving the lane's branches; else
    /// the straightest one with road ahead.
    fn next(&self, id: LaneletId, still_wanted: f64, reached: bool) -> Option<LaneletId> {
        /// Branches looked ahead; each level at most multiplies the work by the branches of a junction.
        const DEPTH: usize = 8;
        if !reached {
            let towards = self.graph.links(id).filter(|(_, link, _)| *link == Link::Follow);
            let towards = towards.filter_map(|(to, _, cost)| self.costs.get(&to).map(|rest| (to, cost + rest)));
            if let Some((to, _)) = towards.min_by(|a, b| a.1.total_cmp(&b.1)) {
                return Some(to);
            }
        }
        let price = |to: LaneletId| {
            let turn = wrap_angle(self.yaw(to, true) - self.yaw(id, true)).abs();
            let missing = (still_wanted - self.road_ahead(to, still_wanted, DEPTH)).max(0.0);
            turn + missing / DEAD_END_PER_RADIAN
        };
        self.successors(id).map(|to| (to, price(to))).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(to, _)| to)
    }

    /// The chain from `first` on, at least `ahead` metres long if there is road (measured from the start of `first`).
    /// It never enters a lanelet twice.
    pub(super) fn forwards(&self, first: LaneletId, ahead: f64) -> Vec<LaneletId> {
        let mut chain = vec![first];
        let (mut last, mut length) = (first, self.length(first));
        let mut reached = self.costs.get(&first) == Some(&0.0);
        while length < ahead && chain.len() < MOST_LANELETS {
            let Some(next) = self.next(last, ahead - length, reached).filter(|n| !chain.contains(n)) else { break };
            reached |= self.costs.get(&next) == Some(&0.0);
            chain.push(next);
            length += self.length(next);
            last = next;
        }
        chain
    }

    /// The lanelets before `first`, in driving order, at least `behind` metres long if there is road; by the straightest
    /// predecessors, never one of `taken`.
    pub(super) fn backwards(&self, first: LaneletId, behind: f64, taken: &[LaneletId]) -> Vec<LaneletId> {
        let mut chain: Vec<LaneletId> = Vec::new();
        let (mut last, mut length) = (first, 0.0);
        while length < behind && chain.len() < MOST_LANELETS {
            let Some(lanelet) = self.network.lanelets.get(&last) else { break };
            let free = lanelet.predecessors.iter().copied();
            let free = free.filter(|id| self.graph.contains(*id) && !taken.contains(id) && !chain.contains(id));
            let turn = |id: LaneletId| wrap_angle(self.yaw(last, false) - self.yaw(id, false)).abs();
            let Some(previous) = free.min_by(|a, b| turn(*a).total_cmp(&turn(*b))) else { break };
            chain.push(previous);
            length += self.length(previous);
            last = previous;
        }
        chain.reverse();
        chain
    }

    /// Lane changes along the cheapest way from a lanelet to the goal. `None` if there is none.
    pub(super) fn lane_changes(&self, from: LaneletId) -> Option<u32> {
        let mut here = from;
        let mut changes = 0;
        let mut left = *self.costs.get(&here)?;
        while left > 0.0 {
            let ways = self.graph.links(here).filter_map(|(to, link, cost)| {
                self.costs.get(&to).filter(|rest| **rest < left).map(|rest| (to, link, cost + rest, *rest))
            });
            let (to, link, _, rest) = ways.min_by(|a, b| a.2.total_cmp(&b.2))?;
            changes += u32::from(link == Link::Change);
            (here, left) = (to, rest);
        }
        Some(changes)
    }
}
