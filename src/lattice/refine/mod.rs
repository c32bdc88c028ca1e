//! Refinement of the chosen path: optimises a chain of edges as a whole.
//!
//! Lattice edges end at nodes, that is, at given stations, offsets, headings and curvatures, so that a chain of edges bends
//! more than necessary. Refinement releases the inner joints: it varies all knots (shared at the joints) and all lengths
//! together. The start (pose and curvature), the end (pose and curvature) and the kept prefix of the committed path remain.
//!
//! ```text
//! minimise    the cost of the lattice: bending energy, offset, lane deviation, clearance, plan change
//! subject to  pose and curvature at the end
//!             bending energy ≤ the unrefined chain's
//!             |κ| ≤ κ_max, |dκ/ds| ≤ the largest one of the unrefined chain
//!             rear axle and front within the corridor at every sample
//! ```
//!
//! The objective is the cost of the lattice with a larger weight of bending. Bending energy alone would leave the reference
//! line as far as the corridor permits. The acceptance test uses the cost of the lattice, by the same code, so that
//! refinement never makes a path worse by the criteria of the lattice.
//!
//! Technique: sequential convex programming (Clarabel) with a trust region on the lateral displacement. Positions are
//! linearised by exact sensitivities. After every program Newton's method restores the end to 1e-10 m. A step is accepted
//! only if the new chain costs less, satisfies the curvature bounds in closed form, and has a free swept footprint where the
//! original has one. So every iterate can be driven, and the worst result is the original chain. Refinement is idempotent: a
//! chain that would gain less than [`RefinementSettings::min_gain`] is returned unchanged, to the bit.
//!
//! Weak: the method is local, inside a corridor of half a metre by default. It may leave the corridor by some centimetres,
//! since positions are linearised (the collision check is exact). It passes an obstacle on the same side as the lattice path.
//! Joints move along the path only slowly, so that the lengths are not quite optimal. Clearance is linearised by probes at
//! the original poses. The last edge of a blocked chain is not refined, so that the stop in front of the blocker remains.

mod chain;
mod corridor;
mod program;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use self::chain::Chain;
use self::corridor::{FreeWidth, Probe};
use self::program::{Anchor, Program};
use super::edges::{COST_SAMPLES, KeptPrefix, checked, unchecked_terms};
use super::{CostTerms, LatticeContext, LatticePath, Root, Weights};
use crate::collision::Allowance;
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::geometry::steps::covering;
use crate::settings::{SettingsError, count, positive, within};
use crate::trajectory::Path;

/// Settings of the refinement; the section `[planner.refinement]` of a settings file.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefinementSettings {
    /// Whether the chosen path is refined.
    pub enabled: bool,
    /// Maximum number of convex programs.
    pub iterations: usize,
    /// Largest displacement of the path to either side, m. At most a metre: less than the width of the vehicle.
    pub corridor: f64,
    /// Smallest reduction of the cost for which the path changes, as a fraction of the cost.
    pub min_gain: f64,
}

impl Default for RefinementSettings {
    fn default() -> Self {
        Self { enabled: true, iterations: 4, corridor: 0.5, min_gain: 0.02 }
    }
}

/// Largest lateral shift of a refined path, m. It is less than the width of the narrowest vehicle, so probes on both sides
/// detect everything between them.
const WIDEST_CORRIDOR: f64 = 1.0;

impl RefinementSettings {
    /// Checks the range of every value.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        count("iterations", self.iterations, 1..=100)?;
        positive("corridor", self.corridor, WIDEST_CORRIDOR, "m")?;
        within("min_gain", self.min_gain, 0.0..=1.0, "")
    }
}

/// The cost of leaving the committed path, by its poses at some distances ahead.
#[derive(Debug, Clone, Default)]
pub struct Commitment {
    /// Distances from the start of the path (m) with the poses of the committed path there.
    pub poses: Vec<(f64, Pose)>,
    /// Cost per metre of the largest lateral distance from these poses.
    pub weight: f64,
    /// Lateral distance at which the cost saturates, m.
    pub max_distance: f64,
}

impl Commitment {
    /// The cost of leaving the committed path for a path.
    #[must_use]
    pub fn cost(&self, path: &Path) -> f64 {
        let beside = |(ahead, pose): &(f64, Pose)| pose.to_local(path.at(*ahead).pose.position).y.abs();
        self.weight * self.poses.iter().map(beside).fold(0.0, f64::max).min(self.max_distance)
    }
}

/// Factor on the weight of bending in the programs. A step is accepted only if it costs less by the weights of the lattice.
/// Within that, the preference for less bending makes swerves long and early; the weights of the lattice alone postpone them
/// slightly in every cycle.
const EMPHASIS: f64 = 2.0;
/// Smallest reduction of the cost, m of detour.
const MIN_GAIN: f64 = 0.01;
/// The iteration stops when a step gains less than this fraction of the required gain.
const SETTLED: f64 = 0.25;
/// Factor on the trust region after a rejected step.
const SHRINK: f64 = 0.3;
/// Largest corridor to either side as a fraction of the vehicle's width.
const WIDTH_SHARE: f64 = 0.9;
/// Largest spacing of the samples of the corridor, m. At 2.5 m, paths beside a parked car are refined towards it and bend more than
/// without refinement; below 1.25 m, results hardly change.
const SPACING: f64 = 1.25;
/// Relative rounding tolerance of the curvature bounds.
const ROUNDING: f64 = 1e-9;
/// Lower limit of the bound of the curvature rate, 1/m². The bound is the largest rate of the original chain, so that
/// refinement steers no faster than the lattice; a straight chain must remain free to bend.
const RATE_FLOOR: f64 = 1e-3;

/// The path with its edges after the kept prefix optimised as a whole. `None` if the gain is too small or no improvement is
/// accepted. `allowance` is that of the root; `front` is the distance from the rear axle to the front bumper, m.
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
    let problem = Refinement::of(context, path, allowance, weights, commitment)?;
    let original = Chain::of(&problem.movable)?;
    let before = problem.evaluated(&original)?;
    let worth = (settings.min_gain * before.cost).max(MIN_GAIN);
    if before.cost <= worth {
        return None;
    }
    let width = WIDTH_SHARE * 2.0 * context.half_width;
    let program = problem.program(&original, front, settings.corridor.min(width))?;
    let (mut best, mut evaluated) = (original.clone(), before.clone());
    let target = original.end();
    let mut radius = settings.corridor;
    for _ in 0..settings.iterations {
        let step = program.step(&best, radius);
        let Some((next, now)) = step.and_then(|next| problem.accepted(next, &target, &program, evaluated.cost)) else {
            if best != original {
                // the remaining gain is below the error of the linearisation
                break;
            }
            radius *= SHRINK;
            continue;
        };
        let gain = evaluated.cost - now.cost;
        (best, evaluated) = (next, now);
        if gain < SETTLED * settings.min_gain * evaluated.cost {
            break;
        }
    }
    if before.cost - evaluated.cost > worth { problem.path(&best, &evaluated, &before.terms) } else { None }
}

/// The parts of the path to refine.
struct Refinement<'a> {
    context: &'a LatticeContext<'a>,
    path: &'a LatticePath,
    weights: &'a Weights,
    commitment: &'a Commitment,
    allowance: &'a Allowance,
    path_start: Pose,
    kept: Vec<CubicSpiral>,
    /// Frame of the chains: the end of the kept prefix.
    frame: Pose,
    /// The edges to optimise.
    movable: Vec<CubicSpiral>,
    /// The kept prefix before them.
    before: KeptPrefix,
    /// The unchanged edges after them.
    tail: Vec<CubicSpiral>,
}

/// Cost of a chain.
#[derive(Clone)]
struct EvaluatedChain {
    terms: CostTerms,
    /// Total with the cost of leaving the committed path.
    cost: f64,
}

impl<'a> Refinement<'a> {
    /// `None` if there are fewer than two edges to optimise.
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

    /// The whole path with this chain.
    fn assembled(&self, chain: &Chain) -> Option<Path> {
        Path::new(self.path_start, &[self.kept.clone(), chain.spirals(), self.tail.clone()].concat())
    }

    /// Cost of a chain by the terms of the lattice; `None` if its swept footprint is not free.
    fn evaluated(&self, chain: &Chain) -> Option<EvaluatedChain> {
        let reference = self.context.reference;
        let mut start = self.frame;
        let mut station = reference.project(start.position).s;
        let mut terms = CostTerms::default();
        for (i, spiral) in chain.spirals().into_iter().enumerate() {
            let end = spiral.end(&start);
            let ends = reference.project_near(end.position, station + spiral.length).s;
            let before = if i == 0 { &self.before } else { &KeptPrefix::EMPTY };
            let (least, curvatures) = unchecked_terms(self.context, &start, &spiral, (station, ends), self.weights);
            let checked = checked(self.context, (&start, &spiral), &least, before, self.weights);
            if checked.blocked_by.is_some() {
                return None;
            }
            let curve_slowdown = self.weights.curve_slowdown
                * curvatures.curve_slowdown(spiral.length, self.context.full_speed_curvature);
            terms = terms.plus(&CostTerms { curve_slowdown, ..checked.terms });
            (start, station) = (end, ends);
        }
        let departure = self.commitment.cost(&self.assembled(chain)?);
        Some(EvaluatedChain { terms, cost: terms.total() + departure })
    }

    /// The chain of a program with its end restored, if it satisfies the bounds, is free, and costs less than `limit`.
    fn accepted(
        &self,
        mut next: Chain,
        target: &Pose,
        program: &Program<'_>,
        limit: f64,
    ) -> Option<(Chain, EvaluatedChain)> {
        if !next.restore(target)
            || next.bending_energy() > program.bending_energy * (1.0 + ROUNDING)
            || next.max_abs_curvature() > program.max_curvature * (1.0 + ROUNDING)
            || next.max_abs_curvature_rate() > program.max_curvature_rate * (1.0 + ROUNDING)
        {
            return None;
        }
        let evaluated = self.evaluated(&next)?;
        (evaluated.cost < limit).then_some((next, evaluated))
    }

    /// The data that all iterations share. `None` if the corridor has no width.
    fn program(&self, original: &Chain, front: f64, limit: f64) -> Option<Program<'_>> {
        let corridor = self.corridor(original, limit);
        let is_open = |(_, free_width): &(_, FreeWidth)| free_width.left + free_width.right > 0.0;
        if !corridor.iter().flatten().any(is_open) {
            return None;
        }
        let anchor = |(ahead, pose): &(f64, Pose)| {
            let distance = ahead - self.kept_length();
            let pose = Pose { position: self.frame.to_local(pose.position), yaw: pose.yaw - self.frame.yaw };
            (distance > 0.0 && distance < original.length()).then_some(Anchor { distance, pose })
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
            departure_weight: self.commitment.weight,
        })
    }

    /// Samples of the original chain with the free width around them.
    fn corridor(&self, original: &Chain, limit: f64) -> Vec<Vec<(chain::Sample, FreeWidth)>> {
        let desired = self.weights.desired_clearance;
        let probe = Probe { context: self.context, frame: self.frame, limit, desired };
        let mut before = self.kept_length();
        let pieces = original.linearised(&original.lengths.iter().map(|l| intervals(*l)).collect::<Vec<_>>());
        pieces
            .into_iter()
            .enumerate()
            .map(|(i, samples)| {
                let length = original.lengths[i];
                let free_width = |s: &chain::Sample| {
                    let here = before + s.u * length;
                    // the allowance near the start applies to the first edge only
                    let allowance = if i > 0 { Allowance::NONE } else { self.allowance.beyond(here) };
                    probe.free_width(s, &allowance)
                };
                let all = samples.into_iter().map(|s| (s, free_width(&s))).collect();
                before += length;
                all
            })
            .collect()
    }

    /// The refined path, with the terms of the chain replaced.
    fn path(&self, chain: &Chain, evaluated: &EvaluatedChain, before: &CostTerms) -> Option<LatticePath> {
        let (old, now) = (&self.path.terms, &evaluated.terms);
        let terms = CostTerms {
            offset: old.offset + now.offset - before.offset,
            curvature: old.curvature + now.curvature - before.curvature,
            curve_slowdown: old.curve_slowdown + now.curve_slowdown - before.curve_slowdown,
            clearance: old.clearance + now.clearance - before.clearance,
            lane_deviation: old.lane_deviation + now.lane_deviation - before.lane_deviation,
            missed_target: old.missed_target + now.missed_target - before.missed_target,
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

/// Number of intervals of an edge: a multiple of that of the cost samples, at most [`SPACING`] long.
fn intervals(length: f64) -> usize {
    covering(length, SPACING * COST_SAMPLES as f64) * COST_SAMPLES
}
