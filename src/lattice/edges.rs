//! Spiral edges with their collision check and cost, and the store that keeps those between lattice nodes.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use rayon::prelude::*;

use super::cost::CostTerms;
use super::counts::{EdgeCounts, NoEdge};
use super::{Found, Ground, Root, Settings};
use crate::collision::{Allowance, Blocker, Sweep};
use crate::geometry::spiral::{CubicSpiral, PathPoint, connect};
use crate::geometry::spiral_opt::{Method, connect_bounded};
use crate::geometry::{Pose, wrap_angle};
use crate::reference::Frenet;

/// An edge of the lattice.
#[derive(Debug, Clone)]
pub struct Edge {
    /// Index of the offset it starts at; `None` from the root.
    pub from: Option<usize>,
    /// Index of the offset it ends at.
    pub to: usize,
    /// Offset it ends at, m.
    pub end_offset: f64,
    /// The curve.
    pub spiral: CubicSpiral,
    /// Where it starts.
    start: Pose,
    /// Its swept footprint, once a path goes along it. Most edges lose before, and sweeps are large: they are not kept
    /// from the check.
    sweep: OnceLock<Arc<Sweep>>,
    /// How far the rear axle may come on it, m.
    pub free_length: f64,
    /// What ends it before its length.
    pub blocked_by: Option<Blocker>,
    /// Its cost.
    pub terms: CostTerms,
    /// Whether it ends beside its node, so that no other edge goes on from it.
    pub ends_chain: bool,
}

impl Edge {
    /// Its swept footprint; for an edge from the root that of the kept part, too.
    pub(super) fn sweep(&self, ground: &Ground<'_>, root: &Root) -> &Arc<Sweep> {
        self.sweep.get_or_init(|| {
            let (kept, path_start) =
                if self.from.is_none() { (root.kept.as_slice(), root.start) } else { (&[][..], self.start) };
            Arc::new(swept(ground, &self.start, &self.spiral, kept, path_start))
        })
    }
}

/// The swept footprint of a spiral, after a kept part that begins at `path_start`.
fn swept(ground: &Ground<'_>, start: &Pose, spiral: &CubicSpiral, kept: &[CubicSpiral], path_start: Pose) -> Sweep {
    if kept.is_empty() {
        return ground.world.sweep(start, spiral);
    }
    let spirals: Vec<_> = kept.iter().copied().chain([*spiral]).collect();
    match crate::trajectory::Path::new(path_start, &spirals) {
        Some(path) => ground.world.sweep_path(&path),
        None => ground.world.sweep(start, spiral),
    }
}

/// Station index from, station index to.
type LayerPair = (i64, i64);
/// Edges by the offset they start at; `None` where nobody asked yet.
type LayerEdges = Vec<Option<NodeEdges>>;

/// The edges that start at a node, in order of the offset they end at, and how many were refused.
#[derive(Debug, Clone, Default)]
pub(super) struct NodeEdges {
    pub(super) edges: Vec<Arc<Edge>>,
    pub(super) counts: EdgeCounts,
}

impl NodeEdges {
    pub(super) fn take(&mut self, tried: Result<Edge, NoEdge>) {
        match tried {
            Ok(edge) => {
                self.counts.count_checked(edge.blocked_by);
                self.edges.push(Arc::new(edge));
            }
            Err(reason) => self.counts.count_refused(reason),
        }
    }
}

/// Keeps what stays the same: the edges between lattice nodes from cycle to cycle, which depend on the reference line and
/// the static world only, and the last answers of [`super::paths`], which several attempts of one cycle ask for again. A
/// store belongs to one reference line, one collision world and one set of settings.
///
/// Edges are made when their first node is first reached by a free chain: most nodes lie off the road and never are.
#[derive(Debug, Clone, Default)]
pub struct EdgeStore {
    layers: HashMap<LayerPair, LayerEdges>,
    /// For each station index, which offsets are worth going to.
    nodes: HashMap<i64, Vec<bool>>,
    pub(super) answers: Answers,
}

impl EdgeStore {
    /// Drops what lies behind a station, m.
    pub(super) fn forget_before(&mut self, station: f64, settings: &Settings) {
        let ahead = |index: i64| index as f64 * settings.grid >= station;
        self.layers.retain(|(_, to), _| ahead(*to));
        self.nodes.retain(|index, _| ahead(*index));
    }

    /// Which nodes of a layer edges may lead to: those at which the vehicle, margins included, is on the road. All, if
    /// none is.
    pub(super) fn nodes(&mut self, ground: &Ground<'_>, station: i64, offsets: &[f64], settings: &Settings) -> &[bool] {
        self.nodes.entry(station).or_insert_with(|| {
            let s = station as f64 * settings.grid;
            let on_road = |offset: &f64| {
                ground.reference.offset_pose(s, *offset).is_some_and(|node| {
                    let here = ground.world.sweep(&node.pose, &CubicSpiral::straight(NODE_LENGTH));
                    ground.world.static_hit(&here).is_none_or(|hit| hit.what != Blocker::RoadBoundary)
                })
            };
            let nodes: Vec<bool> = offsets.iter().map(on_road).collect();
            if nodes.contains(&true) { nodes } else { vec![true; offsets.len()] }
        })
    }

    /// Edges between two layers by the offset they start at, made for (at least) the `starts` given, each in order of
    /// the offset they end at.
    pub(super) fn between(
        &mut self,
        ground: &Ground<'_>,
        (from, to): LayerPair,
        starts: &[usize],
        offsets: &[f64],
        settings: &Settings,
    ) -> (&[Option<NodeEdges>], usize) {
        let ends = self.nodes(ground, to, offsets, settings).to_vec();
        let layer = self.layers.entry((from, to)).or_insert_with(|| vec![None; offsets.len()]);
        let (s0, s1) = (from as f64 * settings.grid, to as f64 * settings.grid);
        let pairs: Vec<(usize, usize)> = starts
            .iter()
            .filter(|i| layer[**i].is_none())
            .flat_map(|&i| (0..offsets.len()).map(move |j| (i, j)))
            .filter(|&(i, j)| (offsets[i] - offsets[j]).abs() <= settings.steepest * (s1 - s0))
            .collect();
        let tried: Vec<Result<Edge, NoEdge>> = pairs
            .par_iter()
            .map(|&(i, j)| {
                if !ends[j] {
                    return Err(NoEdge::OffRoad);
                }
                let start = ground.reference.offset_pose(s0, offsets[i]).ok_or(NoEdge::NoSpiral)?;
                let end = ground.reference.offset_pose(s1, offsets[j]).ok_or(NoEdge::NoSpiral)?;
                let spiral = bounded(&start.pose, start.curvature, &end, ground.max_curvature)?;
                let start = start.pose;
                let stations = (s0, s1);
                let placed =
                    Placed { start, stations, spiral, kept: &[], path_start: start, allowance: Allowance::NONE };
                Ok(placed.checked(ground, Some(i), j, offsets[j], settings))
            })
            .collect();
        for i in starts {
            layer[*i].get_or_insert_default();
        }
        let made = tried.iter().filter(|edge| edge.is_ok()).count();
        for ((i, _), edge) in pairs.into_iter().zip(tried) {
            layer[i].get_or_insert_default().take(edge);
        }
        (layer, made)
    }
}

/// Length of the sweep that stands for a node, m.
const NODE_LENGTH: f64 = 0.05;

/// Edges from the root to the nodes of a layer.
pub(super) fn from_root(
    ground: &Ground<'_>,
    root: &Root,
    station: i64,
    nodes: &[bool],
    offsets: &[f64],
    settings: &Settings,
) -> NodeEdges {
    let begins = ground.reference.project(root.pose.position).s;
    let station = station as f64 * settings.grid;
    let tried: Vec<Result<Edge, NoEdge>> = (0..offsets.len())
        .into_par_iter()
        .map(|j| {
            if !nodes[j] {
                return Err(NoEdge::OffRoad);
            }
            let end = ground.reference.offset_pose(station, offsets[j]).ok_or(NoEdge::NoSpiral)?;
            let exact = bounded(&root.pose, root.curvature, &end, ground.max_curvature);
            let ends_chain = exact.is_err();
            let spiral = match exact {
                Ok(spiral) => spiral,
                Err(reason) if offsets[j].abs() <= SLIDES_WITHIN => {
                    slid(root, &end, ground.max_curvature).ok_or(reason)?
                }
                Err(reason) => return Err(reason),
            };
            let placed = Placed {
                start: root.pose,
                stations: (begins, station),
                spiral,
                kept: &root.kept,
                path_start: root.start,
                allowance: root.allowance,
            };
            Ok(Edge { ends_chain, ..placed.checked(ground, None, j, offsets[j], settings) })
        })
        .collect();
    let mut found = NodeEdges::default();
    tried.into_iter().for_each(|edge| found.take(edge));
    found
}

/// Nodes within this offset may be missed sideways where the curvature bound bites, m: a tight corner needs some way
/// round it, not one to every node.
const SLIDES_WITHIN: f64 = 1.0;

/// The spiral to a node under the curvature bound, by the convex program that slides its end sideways as little as needed.
fn slid(root: &Root, end: &PathPoint, max_curvature: f64) -> Option<CubicSpiral> {
    let local = Pose { position: root.pose.to_local(end.pose.position), yaw: wrap_angle(end.pose.yaw - root.pose.yaw) };
    let found = connect_bounded(root.curvature, &local, end.curvature, max_curvature).ok()?;
    let winds = found.spiral.length > LONGEST_DETOUR * local.position.coords.norm();
    (found.method == Method::Convex && !winds).then_some(found.spiral)
}

/// What [`super::paths`] was asked.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Question {
    pub(super) root: Root,
    pub(super) speed: f64,
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

    pub(super) fn keep(&mut self, question: Question, answer: &Found) {
        if self.0.len() == Self::KEPT {
            self.0.remove(0);
        }
        self.0.push((question, answer.clone()));
    }
}

/// The spiral from a pose to a node, if there is one whose curvature stays within the bound everywhere.
fn bounded(start: &Pose, start_curvature: f64, end: &PathPoint, max_curvature: f64) -> Result<CubicSpiral, NoEdge> {
    let local = Pose { position: start.to_local(end.pose.position), yaw: wrap_angle(end.pose.yaw - start.yaw) };
    let spiral = connect(start_curvature, &local, end.curvature).map_err(|_| NoEdge::NoSpiral)?;
    if spiral.length > LONGEST_DETOUR * local.position.coords.norm() {
        return Err(NoEdge::Winds);
    }
    let bound = max_curvature.max(start_curvature.abs());
    if spiral.max_abs_curvature() > bound * (1.0 + 1e-9) { Err(NoEdge::CurvatureBound) } else { Ok(spiral) }
}

/// A spiral this many times longer than its chord winds: not an edge.
const LONGEST_DETOUR: f64 = 1.5;

/// A spiral in its place.
struct Placed<'a> {
    start: Pose,
    /// About where it begins and ends on the reference line, m.
    stations: (f64, f64),
    spiral: CubicSpiral,
    kept: &'a [CubicSpiral],
    path_start: Pose,
    allowance: Allowance,
}

impl Placed<'_> {
    fn checked(
        self,
        ground: &Ground<'_>,
        from: Option<usize>,
        to: usize,
        end_offset: f64,
        settings: &Settings,
    ) -> Edge {
        let kept_length: f64 = self.kept.iter().map(|s| s.length).sum();
        let sweep = swept(ground, &self.start, &self.spiral, self.kept, self.path_start);
        let hit = ground.world.static_hit_from_start(&sweep, &self.allowance);
        let free_length = hit.map_or(self.spiral.length, |h| h.station - kept_length);
        let terms = self.terms(ground, &sweep, settings);
        Edge {
            from,
            to,
            end_offset,
            spiral: self.spiral,
            start: self.start,
            sweep: OnceLock::new(),
            free_length,
            blocked_by: hit.map(|h| h.what),
            terms,
            ends_chain: false,
        }
    }

    fn terms(&self, ground: &Ground<'_>, sweep: &Sweep, settings: &Settings) -> CostTerms {
        /// Samples along an edge for the costs by offset.
        const SAMPLES: usize = 6;
        let w = &settings.weights;
        let mut terms = CostTerms { bending: w.bending * self.spiral.bending_energy(), ..CostTerms::default() };
        let way = self.spiral.length / SAMPLES as f64;
        let (begins, ends) = self.stations;
        for (along, point) in self.spiral.samples(&self.start, SAMPLES).skip(1) {
            let about = begins + (ends - begins) * along / self.spiral.length;
            let Frenet { s, l } = ground.reference.project_near(point.pose.position, about);
            terms.offset += w.offset * way * l.abs().min(OFFSET_SATURATES).powi(2);
            let (left, right) = ground.reference.lane_bounds(s);
            let over = (l + ground.half_width - left).max(ground.half_width - l - right).max(0.0);
            terms.lane += w.lane * way * over;
        }
        let clearance = ground.world.clearance(sweep, w.clearance_wanted);
        let near = 1.0 - clearance.obstacle.min(clearance.road + ROAD_IS_KINDER) / w.clearance_wanted;
        terms.clearance = w.clearance * self.spiral.length * near.max(0.0).powi(2);
        terms
    }
}

/// Offsets beyond this cost no more (m): on the way from another lane they say nothing about the path.
const OFFSET_SATURATES: f64 = 2.0;
/// The road's edge costs like an obstacle that is this much farther away (m): lanes are narrow by design.
const ROAD_IS_KINDER: f64 = 0.5;
