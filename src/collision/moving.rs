//! Predicted motion of the moving obstacles, and what it blocks along a sweep.
//!
//! # Technique
//! Time is cut into slices of equal length (0.1 s by default), slice j from j·Δt to (j+1)·Δt since the start of the
//! file. For each obstacle and slice the region covered during the slice is kept as convex pieces:
//!
//! * **Trajectory.** The hull of each piece of the shape at both ends of the slice and at the states in between.
//!   Between states position and yaw are interpolated linearly ([`crate::map::Obstacle::pose_at`]), so a point at
//!   radius r of the frame leaves the chord by at most r·Δψ²/8 where the yaw changes by Δψ (the linear part of the
//!   motion has no second derivative): the hull is grown by that.
//! * **Occupancy sets.** Their regions, for all slices that they share time with; a set holds until the next begins.
//!
//! Before its first and after its last state an obstacle is absent, as CommonRoad has it. This is built once for a
//! run. A query asks parry's hierarchy over chunks of slices for those that meet the sweep's box at all, then descends
//! the sweep's own hierarchy with the box of each slice, and decides by exact tests.
//!
//! # What else may count
//! [`Predictions::without`] leaves slices of some obstacles out (of those who give way); [`Predictions::grown`] covers
//! every motion within bounds around the predicted ones, as seen from a moment ([`super::uncertainty`]). Both are
//! predictions again and are asked in the same way.
//!
//! What predictions block is kept with each sweep. It is kept for the first predictions that ask; the answers to all others,
//! and to grown ones, which hold for one moment only, are computed each time.
//!
//! # Weakness
//! A piece that moves far in a slice while turning is covered by one hull. Nothing is known beyond the horizon.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use parry2d::bounding_volume::Aabb;
use parry2d::partitioning::{Bvh, BvhBuildStrategy};

use super::blocked::{BlockedGrid, CellRuns, GridBuilder, SliceBits};
use super::convert::Origin;
use super::convex::{Convex, SweptCorners, boxes_meet, merged};
use super::swept::{Margins, Sweep, with_margins};
use super::uncertainty::{Leg, MotionBounds, Spread};
use super::{CollisionSettings, Overlap};
use crate::geometry::{Pose, wrap_angle};
use crate::map::{ConvexPart, Motion, Obstacle, ObstacleKind, TimedOccupancy, TimedPose};

/// Slices per leaf of the hierarchy over time and space.
const CHUNK: usize = 8;
/// Times are products of step numbers and step lengths: allow their rounding, s.
const TIME_SLACK: f64 = 1e-9;

/// The moving obstacles' predicted regions in slices of time.
#[derive(Debug, Clone)]
pub struct Predictions {
    slice: f64,
    /// Number of slices up to the horizon.
    slices: usize,
    origin: Origin,
    margins: Margins,
    obstacles: Arc<[Obstacle]>,
    tracks: Vec<Arc<Track>>,
    chunks: Vec<Chunk>,
    tree: Bvh,
    /// Tells these predictions from others (a clone is the same); `None` if nothing is to be kept of them.
    identity: Option<Arc<()>>,
}

/// What these predictions block along a sweep, kept with it: a sweep on a kept edge is asked about in many cycles.
#[derive(Debug, Clone)]
pub(super) struct KeptRuns {
    /// Identity of the predictions.
    of: Arc<()>,
    /// First slice that was looked at; all later ones were.
    first: usize,
    runs: CellRuns,
}

/// One obstacle's regions: those of slice `first + i` are `slices[i]`.
#[derive(Debug, Clone)]
struct Track {
    id: i64,
    first: usize,
    slices: Vec<Slice>,
    /// The predicted motion in each of the slices; `None` for prediction sets, which have no heading.
    course: Option<Course>,
}

/// A predicted motion, slice by slice.
#[derive(Debug, Clone)]
struct Course {
    /// The first state.
    begins: TimedPose,
    legs: Vec<Leg>,
    may_reverse: Reversing,
}

/// Whether an obstacle of its kind may move backwards.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Reversing {
    Always,
    IfVehiclesDo,
}

#[derive(Debug, Clone, Default)]
struct Slice {
    pieces: Vec<Convex>,
    /// Box around the pieces; `None` while there are none.
    aabb: Option<Aabb>,
}

/// Some slices of a track.
#[derive(Debug, Clone)]
struct Chunk {
    track: usize,
    /// Indices into the track's slices.
    slices: Range<usize>,
}

impl Predictions {
    /// Cuts the motion of all moving obstacles from time 0 to `horizon` (s since time step 0 of the file) into slices.
    pub(super) fn new(obstacles: &[Obstacle], origin: Origin, settings: &CollisionSettings, horizon: f64) -> Self {
        let slice = settings.time_slice;
        let slices = index((horizon / slice - TIME_SLACK).ceil());
        let mut obstacles: Vec<Obstacle> = obstacles.iter().filter(|o| !o.is_static()).cloned().collect();
        obstacles.sort_by_key(|o| o.id);
        let tracks: Vec<_> =
            obstacles.iter().filter_map(|o| Track::new(o, &origin, slice, slices).map(Arc::new)).collect();
        let (chunks, tree) = hierarchy(&tracks);
        Self {
            slice,
            slices,
            origin,
            margins: settings.moving_obstacles,
            obstacles: obstacles.into(),
            tracks,
            chunks,
            tree,
            identity: Some(Arc::new(())),
        }
    }

    /// These predictions with other regions.
    fn with_tracks(&self, tracks: Vec<Arc<Track>>, identity: Option<Arc<()>>) -> Self {
        let (chunks, tree) = hierarchy(&tracks);
        Self { tracks, chunks, tree, identity, obstacles: Arc::clone(&self.obstacles), ..*self }
    }

    /// These predictions without the slices of some obstacles that end by a time each (id, s since time step 0 of the
    /// file); later ones stay.
    #[must_use]
    pub fn without(&self, left_out: &[(i64, f64)]) -> Self {
        let left = |track: &Arc<Track>| match left_out.iter().find(|(id, _)| *id == track.id) {
            Some((_, until)) => Arc::new(track.after(until / self.slice + TIME_SLACK)),
            None => Arc::clone(track),
        };
        self.with_tracks(self.tracks.iter().map(left).collect(), Some(Arc::new(())))
    }

    /// The regions that the obstacles may cover from `now` on (s since time step 0 of the file), their states then being
    /// the predicted ones and their later motions anything within the bounds. Prediction sets stay as they are.
    #[must_use]
    pub fn grown(&self, now: f64, bounds: &MotionBounds) -> Self {
        if bounds.hold_nothing_more() {
            return self.clone();
        }
        let grown = |track: &Arc<Track>| match &track.course {
            Some(course) => Arc::new(track.grown(course, now, self.slice, bounds)),
            None => Arc::clone(track),
        };
        self.with_tracks(self.tracks.iter().map(grown).collect(), None)
    }

    /// End of what is predicted, s since time step 0 of the file.
    #[must_use]
    pub fn horizon(&self) -> f64 {
        self.slices as f64 * self.slice
    }

    /// What the moving obstacles block along sweeps that follow one another, from time `from` to `to` (s since time
    /// step 0 of the file; widened to whole slices, cut at the horizon).
    #[must_use]
    pub fn blocked(&self, sweeps: &[&Sweep], from: f64, to: f64) -> BlockedGrid {
        let first = index((from / self.slice + TIME_SLACK).floor()).min(self.slices);
        let end = index((to / self.slice - TIME_SLACK).ceil()).clamp(first, self.slices);
        let mut grid = GridBuilder::new(self.slice, first..end);
        for sweep in sweeps {
            let id = |track: usize| self.tracks[track].id;
            match self.kept_runs(sweep, first) {
                Some(kept) => grid.append(sweep, kept, id),
                None => grid.append(sweep, &self.runs(sweep, first), id),
            }
        }
        grid.finish()
    }

    /// The runs kept with the sweep, unless they are of other predictions, or begin too late.
    fn kept_runs<'s>(&self, sweep: &'s Sweep, first: usize) -> Option<&'s CellRuns> {
        let identity = self.identity.as_ref()?;
        let new = || KeptRuns { of: Arc::clone(identity), first, runs: self.runs(sweep, first) };
        let kept = sweep.kept_runs().get_or_init(new);
        (Arc::ptr_eq(&kept.of, identity) && kept.first <= first).then_some(&kept.runs)
    }

    /// The slices from `first` to the horizon in which each cell of the sweep is blocked.
    fn runs(&self, sweep: &Sweep, first: usize) -> CellRuns {
        let mut bits = SliceBits::new(sweep.grid_cells(), self.slices - first);
        self.mark(sweep, first..self.slices, &mut bits);
        bits.runs(first)
    }

    /// Marks the slices in which the sweep's cells are blocked.
    fn mark(&self, sweep: &Sweep, wanted: Range<usize>, bits: &mut SliceBits) {
        let reach = with_margins(sweep.boxes().bounds(), &self.margins);
        let mut found: Vec<u32> = self.tree.intersect_aabb(&reach).collect();
        // chunks are in order of obstacle and time: the first obstacle to block a cell keeps it
        found.sort_unstable();
        let mut corners: Vec<Option<SweptCorners>> = vec![None; sweep.cells()];
        for chunk in found.into_iter().map(|i| &self.chunks[i as usize]) {
            let track = &self.tracks[chunk.track];
            for i in chunk.slices.clone() {
                let j = track.first + i;
                let slice = &track.slices[i];
                let Some(aabb) = slice.aabb.filter(|_| wanted.contains(&j)) else { continue };
                sweep.cells_near(&aabb, &slice.pieces, &self.margins, |cell| {
                    let station_cell = sweep.grid_cell(cell);
                    if bits.is_set(station_cell, j - wanted.start) {
                        return;
                    }
                    let shape = corners[cell].get_or_insert_with(|| sweep.corners(cell, &self.margins));
                    let reach = with_margins(sweep.boxes().cell(cell), &self.margins);
                    if slice.pieces.iter().any(|p| boxes_meet(p.aabb(), &reach) && p.overlaps(shape)) {
                        bits.set(station_cell, j - wanted.start, chunk.track);
                    }
                });
            }
        }
    }

    /// The first obstacle, in order of id, that shares a point with the convex polygon at `time`, no margins.
    pub(super) fn overlap(&self, hull: &[super::convert::Local], time: f64) -> Option<Overlap> {
        self.obstacles.iter().find_map(|obstacle| {
            let parts = obstacle.occupied_at(time);
            let hit =
                parts.iter().filter_map(|p| Convex::of_part(p, &self.origin)).find(|p| p.distance_to(hull) == 0.0)?;
            Some(Overlap { what: super::Blocker::Obstacle(obstacle.id), depth: hit.depth_in(hull) })
        })
    }
}

/// A non-negative whole number as an index; negative and not-a-number become 0.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // float casts saturate, which is what is wanted
fn index(x: f64) -> usize {
    x as usize
}

/// Chunks of all tracks, and parry's tree over their boxes.
fn hierarchy(tracks: &[Arc<Track>]) -> (Vec<Chunk>, Bvh) {
    let (chunks, boxes): (Vec<Chunk>, Vec<Aabb>) = tracks.iter().enumerate().flat_map(chunks_of).unzip();
    (chunks, Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes))
}

fn chunks_of((track, t): (usize, &Arc<Track>)) -> Vec<(Chunk, Aabb)> {
    let chunk = |(c, slices): (usize, &[Slice])| {
        let aabb = slices.iter().filter_map(|s| s.aabb).reduce(|a, b| merged(&a, &b))?;
        Some((Chunk { track, slices: c * CHUNK..c * CHUNK + slices.len() }, aabb))
    };
    t.slices.chunks(CHUNK).enumerate().filter_map(chunk).collect()
}

impl Track {
    /// `None` if the obstacle does not exist before the horizon.
    fn new(obstacle: &Obstacle, origin: &Origin, slice: f64, slices: usize) -> Option<Self> {
        match &obstacle.motion {
            Motion::Static(_) => None,
            Motion::Trajectory(states) => {
                let begins = *states.first()?;
                let parts = obstacle.shape.convex_parts();
                let (first, slices, legs) = of_trajectory(states, &parts, origin, slice, slices)?;
                let may_reverse = match obstacle.kind {
                    ObstacleKind::Vehicle | ObstacleKind::Bicycle | ObstacleKind::ParkedVehicle => {
                        Reversing::IfVehiclesDo
                    }
                    ObstacleKind::Pedestrian | ObstacleKind::Structure | ObstacleKind::Unknown => Reversing::Always,
                };
                Some(Self { id: obstacle.id, first, slices, course: Some(Course { begins, legs, may_reverse }) })
            }
            Motion::Occupancy(sets) => {
                let (first, slices) = of_sets(sets, origin, slice, slices)?;
                Some(Self { id: obstacle.id, first, slices, course: None })
            }
        }
    }

    /// Without the slices that end by `until`, in slices.
    fn after(&self, until: f64) -> Self {
        let gone = index(until).saturating_sub(self.first).min(self.slices.len());
        let mut left = self.clone();
        left.slices[..gone].fill_with(Slice::default);
        left
    }

    /// What may be covered in the slices from `now` on.
    fn grown(&self, course: &Course, now: f64, slice: f64, bounds: &MotionBounds) -> Self {
        let may_reverse = bounds.vehicles_reverse || course.may_reverse == Reversing::Always;
        let mut spread = Spread::new(bounds, may_reverse);
        let unseen = course.begins.time - now;
        if let Some(leg) = course.legs.first().filter(|_| unseen > 0.0) {
            // until it appears it comes as it then goes
            let (low, _) = leg.headings;
            let way = course.begins.speed.abs() * unseen;
            spread.advance(unseen, &Leg { end: course.begins.time, headings: leg.headings, heading: low, way });
        }
        let past = index((now / slice + TIME_SLACK).floor()).saturating_sub(self.first).min(self.slices.len());
        let grown = |(region, leg): (&Slice, &Leg)| {
            spread.advance(leg.end - now, leg);
            let reach = spread.reach(leg);
            let mut grown = Slice::default();
            region.pieces.iter().filter_map(|p| p.spread(&reach)).for_each(|p| grown.push(p));
            grown
        };
        let slices = self.slices.iter().zip(&course.legs).skip(past).map(grown).collect();
        Self { id: self.id, first: self.first + past, slices, course: None }
    }
}

impl Slice {
    fn push(&mut self, piece: Convex) {
        self.aabb = Some(self.aabb.map_or(*piece.aabb(), |aabb| merged(&aabb, piece.aabb())));
        self.pieces.push(piece);
    }
}

fn of_trajectory(
    states: &[TimedPose],
    parts: &[ConvexPart],
    origin: &Origin,
    slice: f64,
    slices: usize,
) -> Option<(usize, Vec<Slice>, Vec<Leg>)> {
    let (first, last) = (states.first()?, states.last()?);
    let states: Vec<(f64, Pose)> = states.iter().map(|s| (s.time, origin.local_pose(&s.pose))).collect();
    let held = touched(first.time, last.time, slice, slices);
    let (mut found, mut legs) = (Vec::with_capacity(held.len()), Vec::with_capacity(held.len()));
    let mut heading = first.pose.yaw;
    for j in held.clone() {
        let (from, to) = ((j as f64 * slice).max(first.time), ((j + 1) as f64 * slice).min(last.time));
        let poses = poses_between(&states, from, to);
        let leg = leg_along(&poses, heading, to);
        heading = leg.heading;
        legs.push(leg);
        let turn = poses.windows(2).map(|w| wrap_angle(w[1].yaw - w[0].yaw).abs()).fold(0.0, f64::max);
        let mut region = Slice::default();
        for part in parts {
            let slack = 0.125 * turn * turn * part.bounding_radius();
            if let Some(piece) = Convex::moved_through(part, &poses, slack) {
                region.push(piece);
            }
        }
        found.push(region);
    }
    (!found.is_empty()).then_some((held.start, found, legs))
}

/// The motion through some poses, from a heading that is not wrapped to a time.
fn leg_along(poses: &[Pose], mut heading: f64, end: f64) -> Leg {
    let (mut headings, mut way) = ((heading, heading), 0.0);
    for pair in poses.windows(2) {
        heading += wrap_angle(pair[1].yaw - pair[0].yaw);
        headings = (headings.0.min(heading), headings.1.max(heading));
        way += (pair[1].position - pair[0].position).norm();
    }
    Leg { end, headings, heading, way }
}

/// The poses at both times and the states in between. Poses between states are interpolated as
/// [`Obstacle::pose_at`] does.
fn poses_between(states: &[(f64, Pose)], from: f64, to: f64) -> Vec<Pose> {
    let at = |time: f64| {
        let after = states.partition_point(|(t, _)| *t <= time);
        match (after.checked_sub(1).and_then(|i| states.get(i)), states.get(after)) {
            (Some((t0, a)), Some((t1, b))) => Some(a.interpolated(b, (time - t0) / (t1 - t0))),
            (Some((_, pose)), None) | (None, Some((_, pose))) => Some(*pose),
            (None, None) => None,
        }
    };
    let between = states.iter().filter(|(t, _)| from < *t && *t < to).map(|(_, pose)| *pose);
    at(from).into_iter().chain(between).chain(at(to)).collect()
}

/// The first slice with a region, and all up to the last.
fn of_sets(sets: &[TimedOccupancy], origin: &Origin, slice: f64, slices: usize) -> Option<(usize, Vec<Slice>)> {
    let mut found: BTreeMap<usize, Slice> = BTreeMap::new();
    for (i, set) in sets.iter().enumerate() {
        let until = sets.get(i + 1).map_or(set.to, |next| next.from.max(set.to));
        let pieces: Vec<Convex> = set.region.convex_parts().iter().filter_map(|p| Convex::of_part(p, origin)).collect();
        for j in touched(set.from, until, slice, slices) {
            let region = found.entry(j).or_default();
            pieces.iter().for_each(|p| region.push(p.clone()));
        }
    }
    let first = *found.keys().next()?;
    let mut dense = vec![Slice::default(); found.keys().next_back()? + 1 - first];
    for (j, slice) in found {
        dense[j - first] = slice;
    }
    Some((first, dense))
}

/// The slices that share more than an instant with the interval; for an instant, those that hold it.
fn touched(from: f64, to: f64, slice: f64, slices: usize) -> Range<usize> {
    let slack = if to - from > 2.0 * TIME_SLACK { TIME_SLACK } else { -TIME_SLACK };
    if to < 0.0 {
        return 0..0;
    }
    let first = index(((from + slack) / slice).floor()).min(slices);
    let end = index(((to - slack) / slice).ceil()).min(slices);
    first..end.max(first)
}

#[cfg(test)]
mod tests;
