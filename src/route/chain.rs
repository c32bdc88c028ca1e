//! Chains of lanelets along a lane: forwards along the route, and backwards so that positions behind can be projected.

use std::collections::BTreeMap;

use super::graph::{LaneGraph, Link};
use crate::geometry::wrap_angle;
use crate::map::{LaneletId, RoadNetwork};

/// Cost of a branch that is too short, in metres of missing road per radian of turning, if no goal decides.
const DEAD_END_PER_RADIAN: f64 = 100.0;
/// Most lanelets of a chain: a limit for files with lanelets of centimetres.
const MAX_LANELETS: usize = 500;

/// Chooses the continuation of each lanelet.
pub(super) struct Guide<'a> {
    pub(super) network: &'a RoadNetwork,
    pub(super) graph: &'a LaneGraph,
    /// Cost to go of the lanelets from which a goal can be reached; empty without a goal.
    pub(super) costs: &'a BTreeMap<LaneletId, f64>,
}

impl Guide<'_> {
    fn length(&self, id: LaneletId) -> f64 {
        self.network.lanelets.get(&id).map_or(0.0, |l| l.centre.length())
    }

    /// Heading of the centre line at the end (`at_end`) or start of a lanelet, rad.
    fn yaw(&self, id: LaneletId, at_end: bool) -> f64 {
        self.network.lanelets.get(&id).map_or(0.0, |l| l.centre.yaw_at(if at_end { l.centre.length() } else { 0.0 }))
    }

    fn successors(&self, id: LaneletId) -> impl Iterator<Item = LaneletId> + '_ {
        self.graph.links(id).filter(|(_, link, _)| *link == Link::Follow).map(|(to, ..)| to)
    }

    /// Length of road from the start of a lanelet along its longest continuation, m. The search ends at `enough` metres or
    /// after `depth` lanelets.
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

    /// The best continuation: towards the goal if a successor leads there, else the straightest one with `remaining` metres
    /// of road. `is_reached` says whether the chain has a goal lanelet already.
    fn next(&self, id: LaneletId, remaining: f64, is_reached: bool) -> Option<LaneletId> {
        /// Lanelets looked ahead; each one multiplies the work by the number of branches at most.
        const DEPTH: usize = 8;
        if !is_reached {
            let follow = self.graph.links(id).filter(|(_, link, _)| *link == Link::Follow);
            let towards_goal = follow.filter_map(|(to, _, cost)| self.costs.get(&to).map(|to_go| (to, cost + to_go)));
            if let Some((to, _)) = towards_goal.min_by(|a, b| a.1.total_cmp(&b.1)) {
                return Some(to);
            }
        }
        let price = |to: LaneletId| {
            let turn = wrap_angle(self.yaw(to, true) - self.yaw(id, true)).abs();
            let missing = (remaining - self.road_ahead(to, remaining, DEPTH)).max(0.0);
            turn + missing / DEAD_END_PER_RADIAN
        };
        self.successors(id).map(|to| (to, price(to))).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(to, _)| to)
    }

    /// The chain that starts with `first`, at least `ahead` metres long from its start if the road is. It has no lanelet
    /// twice.
    pub(super) fn forwards(&self, first: LaneletId, ahead: f64) -> Vec<LaneletId> {
        let mut chain = vec![first];
        let (mut last, mut length) = (first, self.length(first));
        let mut is_reached = self.costs.get(&first) == Some(&0.0);
        while length < ahead && chain.len() < MAX_LANELETS {
            let Some(next) = self.next(last, ahead - length, is_reached).filter(|n| !chain.contains(n)) else { break };
            is_reached |= self.costs.get(&next) == Some(&0.0);
            chain.push(next);
            length += self.length(next);
            last = next;
        }
        chain
    }

    /// The straightest chain of predecessors before `first`, in driving order, at least `behind` metres long if the road is.
    /// It has no lanelet of `excluded`.
    pub(super) fn backwards(&self, first: LaneletId, behind: f64, excluded: &[LaneletId]) -> Vec<LaneletId> {
        let mut chain: Vec<LaneletId> = Vec::new();
        let (mut last, mut length) = (first, 0.0);
        while length < behind && chain.len() < MAX_LANELETS {
            let Some(lanelet) = self.network.lanelets.get(&last) else { break };
            let free = lanelet.predecessors.iter().copied();
            let free = free.filter(|id| self.graph.contains(*id) && !excluded.contains(id) && !chain.contains(id));
            let turn = |id: LaneletId| wrap_angle(self.yaw(last, false) - self.yaw(id, false)).abs();
            let Some(previous) = free.min_by(|a, b| turn(*a).total_cmp(&turn(*b))) else { break };
            chain.push(previous);
            length += self.length(previous);
            last = previous;
        }
        chain.reverse();
        chain
    }

    /// Number of lane changes on the cheapest path from a lanelet to the goal. `None` if there is no path.
    pub(super) fn lane_changes(&self, from: LaneletId) -> Option<u32> {
        let mut here = from;
        let mut changes = 0;
        let mut to_go = *self.costs.get(&here)?;
        while to_go > 0.0 {
            let nearer = self.graph.links(here).filter_map(|(to, link, cost)| {
                self.costs.get(&to).filter(|next| **next < to_go).map(|next| (to, link, cost + next, *next))
            });
            let (to, link, _, next) = nearer.min_by(|a, b| a.2.total_cmp(&b.2))?;
            changes += u32::from(link == Link::Change);
            (here, to_go) = (to, next);
        }
        Some(changes)
    }
}
