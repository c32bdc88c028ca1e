//! The chosen chain of edges, optimised once more as a whole.
//!
//! Lattice edges end at nodes: at given stations, offsets, headings and curvatures. A chain of them bends more than it
//! has to. Here the inner joints are let go: all knots (shared at the joints) and all lengths are varied together, while
//! the start (pose and curvature), the end (pose and curvature) and whatever is kept of the committed path stay.
//!
//! ```text
//! minimise    the lattice's own cost: bending energy, offset, lane, clearance, leaving the plan in force
//! subject to  the end's pose and curvature
//!             bending energy ≤ the unrefined chain's
//!             |κ| ≤ κ_max, |dκ/ds| ≤ the largest one of the unrefined chain
//!             rear axle and front within the corridor at every sample
//! ```
//!
//! The objective is the lattice's with bending made dearer, and not bending energy alone, because that alone would leave
//! the reference line as far as the corridor lets it. What is cheaper here is cheaper there, by the same code: refinement trades none of the
//! lattice's preferences away.
//!
//! Technique: sequential convex programming (Clarabel) with a radius of trust on the sideways displacement; positions
//! are linearised by exact sensitivities. After every program the end is brought back by Newton's method to 1e-10 m,
//! and the step is taken only if the new chain **checks out**: it costs less, keeps the curvature bounds in closed form,
//! and its swept footprint is free where the original's was. So every iterate could be driven, and the worst result is
//! the chain that went in. The same gate makes refinement idempotent: a chain that would gain less than
//! [`RefinementSettings::min_gain`] comes back as it was, to the bit.
//!
//! Weak: a local method, inside a corridor of half a metre by default, which it may leave by some centimetres, because
//! positions are linearised (what is in the way is checked without that). It passes an obstacle on the side on which the
//! lattice passes it. Joints slide along the path only slowly, so that the best lengths are not quite found. Clearance is
//! linearised by probes at the original poses. Where the chain is blocked, its last edge, which ends in front of the
//! blocker, is left as it is, so that the place to stop at stays.

mod chain;
mod corridor;
mod program;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use self::chain::Chain;
use self::corridor::{Probe, Room};
use self::program::{Anchor, Program};
use super::edges::{COST_SAMPLES, KeptPrefix, checked, least_terms};
use super::{CostTerms, LatticeContext, LatticePath, Root, Weights};
use crate::collision::Allowance;
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::trajectory::Path;

/// How the chosen chain of edges is refined.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefinementSettings {
    /// Whether it is.
    pub enabled: bool,
    /// Largest number of convex programs.
    pub iterations: usize,
    /// How far the path may move to either side, m. At most a metre: less than the vehicle is wide.
    pub corridor: f64,
    /// Share of a chain's cost that a refinement must save to be kept. Smaller gains are not worth another path.
    pub min_gain: f64,
}

impl Default for RefinementSettings {
    fn default() -> Self {
        Self { enabled: true, iterations: 4, corridor: 0.5, min_gain: 0.02 }
    }
}

/// A path that costs to leave: the one in force, at some distances ahead.
#[derive(Debug, Clone, Default)]
pub struct Commitment {
    /// Distances from the start of the path (m) with the poses in force there.
    pub poses: Vec<(f64, Pose)>,
    /// Price per metre of the largest distance to the side at these.
    pub weight: f64,
    /// Distance beyond which leaving costs no more, m.
    pub max_distance: f64,
}

impl Commitment {
    /// What a path pays for leaving it.
    #[must_use]
    pub fn cost(&self, path: &Path) -> f64 {
        let beside = |(ahead, pose): &(f64, Pose)| pose.to_local(path.at(*ahead).pose.position).y.abs();
        self.weight * self.poses.iter().map(beside).fold(0.0, f64::max).min(self.max_distance)
    }
}

/// How much dearer bending is in the programs than in the lattice. Their step is taken only if it costs less by the
/// lattice's own weights; within that, leaning to the less bent of two paths makes a swerve long and early, where the
/// lattice's weights alone put it off a little in every cycle.
const EMPHASIS: f64 = 2.0;
/// Costs gain at least this, in the unit of all costs (m of detour): nobody would notice less.
const LEAST_GAIN: f64 = 0.01;
/// Once a step gains less than this share of what would be worth a new path, the next is not worth its time.
const SETTLED: f64 = 0.25;
/// Radius of trust after a step that did not check out, as a share of the one before.
const SHRINK: f64 = 0.3;
/// Share of the vehicle's width that the corridor may take to either side at most.
const WIDTH_SHARE: f64 = 0.9;
/// Spacing of the samples at which the corridor is probed, m at most.
const SPACING: f64 = 2.5;
/// Curvature bounds are checked in closed form with this much for rounding.
const ROUNDING: f64 = 1e-9;
/// The curvature's derivative is bounded so that refinement steers no faster than the lattice, but not to less than
/// this, 1/m²: a straight chain must remain free to bend.
const RATE_FLOOR: f64 = 1e-3;

/// The path with its edges after the kept part optimised as a whole; `None` if that gains too little, or nothing better
/// checks out. `allowance` is the root's, `front` the distance from the rear axle to the front bumper, m.
#[must_use]
pub fn refined(
    context: &LatticeContext<'_>,
    path: &LatticePath,
    allowance: &Allowance,
    front: f64,
    weights: &Weights,
    commitment: &Commitment,
    settings: &RefinementSettings,
) -> Option<LatticePath> {
    let stage = Stage::of(context, path, allowance, weights, commitment)?;
    let original = Chain::of(&stage.movable)?;
    let before = stage.measured(&original)?;
    let worth = (settings.min_gain * before.cost).max(LEAST_GAIN);
    if before.cost <= worth {
        return None;
    }
    let width = WIDTH_SHARE * 2.0 * context.half_width;
    let program = stage.program(&original, front, settings.corridor.min(width))?;
    let (mut best, mut measured) = (original.clone(), before.clone());
    let target = original.end();
    let mut radius = settings.corridor;
    for _ in 0..settings.iterations {
        let step = program.step(&best, radius);
        let Some((next, now)) = step.and_then(|next| stage.accepted(next, &target, &program, measured.cost)) else {
            if best != original {
                // what is left to gain is less than the linearisation sees
                break;
            }
            radius *= SHRINK;
            continue;
        };
        let gain = measured.cost - now.cost;
        (best, measured) = (next, now);
        if gain < SETTLED * settings.min_gain * measured.cost {
            break;
        }
    }
    if before.cost - measured.cost > worth { stage.path(&best, &measured, &before.terms) } else { None }
}

/// The path that is refined, taken apart.
struct Stage<'a> {
    context: &'a LatticeContext<'a>,
    path: &'a LatticePath,
    weights: &'a Weights,
    commitment: &'a Commitment,
    allowance: &'a Allowance,
    path_start: Pose,
    kept: Vec<CubicSpiral>,
    /// Pose of the frame that chains are in: the end of what is kept.
    frame: Pose,
    movable: Vec<CubicSpiral>,
    /// What is driven before them.
    before: KeptPrefix,
    /// What follows behind them and stays.
    tail: Vec<CubicSpiral>,
}

/// A chain in its place.
#[derive(Clone)]
struct Measured {
    terms: CostTerms,
    /// The terms' sum with the cost of leaving what is committed.
    cost: f64,
}

impl<'a> Stage<'a> {
    /// `None` if there are not two edges to optimise together.
    fn of(
        context: &'a LatticeContext<'a>,
        path: &'a LatticePath,
        allowance: &'a Allowance,
        weights: &'a Weights,
        commitment: &'a Commitment,
    ) -> Option<Self> {
        let pieces: Vec<(Pose, CubicSpiral)> = path.path.pieces().map(|(_, start, spiral)| (*start, *spiral)).collect();
        let edges = pieces.len().checked_sub(path.kept)?;
        let movable = edges.checked_sub(usize::from(path.blocked_by.is_some())).filter(|n| *n > 1)?;
        let spirals = |range: std::ops::Range<usize>| -> Vec<CubicSpiral> {
            pieces[range].iter().map(|(_, spiral)| *spiral).collect()
        };
        let (start, first) = (pieces[0].0, &pieces[path.kept]);
        let kept = spirals(0..path.kept);
        let root = Root { pose: first.0, curvature: first.1.knots[0], kept, start, allowance: *allowance };
        Some(Self {
            before: KeptPrefix::root(context, &root, weights),
            context,
            path,
            weights,
            commitment,
            allowance,
            path_start: pieces[0].0,
            kept: spirals(0..path.kept),
            frame: pieces[path.kept].0,
            movable: spirals(path.kept..path.kept + movable),
            tail: spirals(path.kept + movable..pieces.len()),
        })
    }

    fn kept_length(&self) -> f64 {
        self.kept.iter().map(|s| s.length).sum()
    }

    /// The whole path with this chain in it.
    fn assembled(&self, chain: &Chain) -> Option<Path> {
        Path::new(self.path_start, &[self.kept.clone(), chain.spirals(), self.tail.clone()].concat())
    }

    /// Cost of a chain, as the lattice has it; `None` if its swept footprint is not free.
    fn measured(&self, chain: &Chain) -> Option<Measured> {
        let reference = self.context.reference;
        let mut start = self.frame;
        let mut station = reference.project(start.position).s;
        let mut terms = CostTerms::default();
        for (i, spiral) in chain.spirals().into_iter().enumerate() {
            let end = spiral.end(&start);
            let ends = reference.project_near(end.position, station + spiral.length).s;
            let before = if i == 0 { &self.before } else { &KeptPrefix::NOTHING };
            let (least, bends) = least_terms(self.context, &start, &spiral, (station, ends), self.weights);
            let checked = checked(self.context, (&start, &spiral), &least, before, self.weights);
            if checked.blocked_by.is_some() {
                return None;
            }
            let curve_slowdown =
                self.weights.curve_slowdown * bends.curve_slowdown(spiral.length, self.context.full_speed_curvature);
            terms = terms.plus(&CostTerms { curve_slowdown, ..checked.terms });
            (start, station) = (end, ends);
        }
        let leaving = self.commitment.cost(&self.assembled(chain)?);
        Some(Measured { terms, cost: terms.total() + leaving })
    }

    /// A program's chain with its end brought back, if it checks out and costs less than `limit`.
    fn accepted(&self, mut next: Chain, target: &Pose, program: &Program<'_>, limit: f64) -> Option<(Chain, Measured)> {
        if !next.restore(target)
            || next.bending_energy() > program.bending_energy * (1.0 + ROUNDING)
            || next.max_abs_curvature() > program.max_curvature * (1.0 + ROUNDING)
            || next.max_abs_curvature_rate() > program.max_curvature_rate * (1.0 + ROUNDING)
        {
            return None;
        }
        let measured = self.measured(&next)?;
        (measured.cost < limit).then_some((next, measured))
    }

    /// What stays the same over the iterations. `None` for a corridor without any width.
    fn program(&self, original: &Chain, front: f64, limit: f64) -> Option<Program<'_>> {
        let corridor = self.corridor(original, limit);
        let is_open = |(_, room): &(_, Room)| room.left + room.right > 0.0;
        if !corridor.iter().flatten().any(is_open) {
            return None;
        }
        let anchor = |(ahead, pose): &(f64, Pose)| {
            let along = ahead - self.kept_length();
            let pose = Pose { position: self.frame.to_local(pose.position), yaw: pose.yaw - self.frame.yaw };
            (along > 0.0 && along < original.length()).then_some(Anchor { along, pose })
        };
        Some(Program {
            context: self.context,
            weights: Weights { curvature: EMPHASIS * self.weights.curvature, ..*self.weights },
            frame: self.frame,
            front,
            max_curvature: self.context.max_curvature.max(original.max_abs_curvature()),
            max_curvature_rate: original.max_abs_curvature_rate().max(RATE_FLOOR),
            bending_energy: original.bending_energy(),
            corridor,
            anchors: self.commitment.poses.iter().filter_map(anchor).collect(),
            leaving: self.commitment.weight,
        })
    }

    /// Samples of the original chain with the room around them.
    fn corridor(&self, original: &Chain, limit: f64) -> Vec<Vec<(chain::Sample, Room)>> {
        let wanted = self.weights.desired_clearance;
        let probe = Probe { world: self.context.world, frame: self.frame, limit, wanted };
        let mut before = self.kept_length();
        let pieces = original.linearised(&original.lengths.iter().map(|l| intervals(*l)).collect::<Vec<_>>());
        pieces
            .into_iter()
            .enumerate()
            .map(|(i, samples)| {
                let length = original.lengths[i];
                let room = |s: &chain::Sample| {
                    let here = before + s.u * length;
                    // what is overlooked near the start is for the first edge
                    let allowance = if i > 0 {
                        Allowance::NONE
                    } else {
                        Allowance {
                            no_margins_until: self.allowance.no_margins_until - here,
                            no_road_until: self.allowance.no_road_until - here,
                        }
                    };
                    probe.room(s, &allowance)
                };
                let all = samples.into_iter().map(|s| (s, room(&s))).collect();
                before += length;
                all
            })
            .collect()
    }

    /// The refined path: what the original costs, with the terms of the chain exchanged.
    fn path(&self, chain: &Chain, measured: &Measured, before: &CostTerms) -> Option<LatticePath> {
        let (old, now) = (&self.path.terms, &measured.terms);
        let terms = CostTerms {
            offset: old.offset + now.offset - before.offset,
            curvature: old.curvature + now.curvature - before.curvature,
            curve_slowdown: old.curve_slowdown + now.curve_slowdown - before.curve_slowdown,
            clearance: old.clearance + now.clearance - before.clearance,
            lane_deviation: old.lane_deviation + now.lane_deviation - before.lane_deviation,
            ..*old
        };
        let path = self.assembled(chain)?;
        let mut start = self.frame;
        let swept = chain.spirals().into_iter().map(|spiral| {
            let sweep = self.context.world.sweep(&start, &spiral);
            start = spiral.end(&start);
            Arc::new(sweep)
        });
        let sweeps = &self.path.sweeps;
        let kept = self.before.sweeps.len().min(sweeps.len());
        let behind = sweeps.iter().skip(kept + self.movable.len()).cloned();
        Some(LatticePath {
            free_length: match self.path.blocked_by {
                None => path.length(),
                Some(_) => self.path.free_length + path.length() - self.path.path.length(),
            },
            path,
            sweeps: sweeps[..kept].iter().cloned().chain(swept).chain(behind).collect(),
            terms,
            ..self.path.clone()
        })
    }
}

/// Samples of an edge: a multiple of the cost's, [`SPACING`] apart at most.
fn intervals(length: f64) -> usize {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small positive count
    let fold = (length / (SPACING * COST_SAMPLES as f64)).ceil().max(1.0) as usize;
    fold * COST_SAMPLES
}
