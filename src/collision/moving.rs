//! Predicted motion of the moving obstacles, and the cells of a sweep that it blocks.
//!
//! # Technique
//! Time is divided into slices of equal length (0.1 s by default), slice j from j·Δt to (j+1)·Δt since the start of the
//! file. For each obstacle and slice, convex pieces cover the region of the obstacle during the slice:
//!
//! * **Trajectory.** The hull of each piece of the shape at both ends of the slice and at the states in between.
//!   Between states position and yaw are interpolated linearly ([`crate::map::Obstacle::pose_at`]), so a point at
//!   radius r of the frame leaves the chord by at most r·Δψ²/8 if the yaw changes by Δψ (the linear part of the motion has
//!   no second derivative). The hull is inflated by that.
//! * **Occupancy sets.** Their regions, for all slices that they overlap in time; a set is valid until the next one starts.
//!
//! Before its first and after its last state an obstacle is absent, as in CommonRoad. The regions are built once per run. A
//! query selects chunks of slices whose boxes meet the box of the sweep, by parry's hierarchy; then the cells near the box of
//! each slice, by the hierarchy of the sweep; then it decides by exact tests.
//!
//! # Modified predictions
//! [`Predictions::without`] removes slices of some obstacles (those that yield). [`Predictions::reachable`] covers every
//! motion within bounds around the predicted ones from a given time on ([`super::uncertainty`]). Both results are
//! predictions and support the same queries.
//!
//! Each sweep keeps its blocked cells for the predictions and margins of its last queries up to the horizon. With narrower margins
//! only those cells and slices are tested that are blocked with wider ones. A query that ends before the horizon is cheaper and is not
//! kept.
//!
//! # Weakness
//! One hull covers a piece that moves far in a slice while turning. There are no regions beyond the horizon.

mod fine;

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use parry2d::bounding_volume::Aabb;
use parry2d::partitioning::{Bvh, BvhBuildStrategy};

use super::Overlap;
use super::blocked::{BlockedGrid, CellRuns, GridBuilder, SliceBits};
use super::convert::Origin;
use super::convex::{Convex, SweptCorners, boxes_meet, inflated, merged};
use super::margins::Margins;
use super::swept::Sweep;
use super::uncertainty::{Leg, MotionBounds, Spread};
use crate::geometry::{Pose, wrap_angle};
use crate::map::{ConvexPart, Motion, Obstacle, ObstacleKind, TimedOccupancy, TimedPose};

/// Slices per leaf of the hierarchy over time and space.
const CHUNK: usize = 8;
/// Rounding tolerance of times, which are products of step numbers and step lengths, s.
const TIME_SLACK: f64 = 1e-9;

/// The predicted regions of the moving obstacles in time slices.
#[derive(Debug, Clone)]
pub struct Predictions {
    slice: f64,
    /// Number of slices up to the horizon.
    slices: usize,
    origin: Origin,
    obstacles: Arc<[Obstacle]>,
    tracks: Vec<Arc<Track>>,
    chunks: Vec<Chunk>,
    tree: Bvh,
    /// Identity for the cache; clones share it.
    identity: Arc<()>,
}

/// The blocked cells of a sweep for the predictions and margins of its last queries, the latest last: many paths and cycles share the
/// sweep of an edge.
#[derive(Debug, Default)]
pub(super) struct KeptRuns(Mutex<Vec<Arc<RunsOf>>>);

/// Results that a sweep keeps: with the margins of the settings, those of the tracking tube, and those of plans without a proof.
const KEPT: usize = 3;

/// The blocked cells for some predictions and margins.
#[derive(Debug)]
struct RunsOf {
    predictions: Arc<()>,
    margins: Margins,
    /// The slices that were looked at.
    slices: Range<usize>,
    runs: CellRuns,
    /// The fine runs of each cell.
    fine: Vec<OnceLock<fine::Subcells>>,
}

impl KeptRuns {
    fn slots(&self) -> MutexGuard<'_, Vec<Arc<RunsOf>>> {
        // a slot holds no half-written value: it is replaced as a whole
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Clone for KeptRuns {
    fn clone(&self) -> Self {
        Self(Mutex::new(self.slots().clone()))
    }
}

/// The regions of one obstacle; those of slice `first + i` are `slices[i]`.
#[derive(Debug, Clone)]
struct Track {
    id: i64,
    first: usize,
    slices: Vec<Slice>,
    /// The predicted motion in the slices; `None` for prediction sets, which have no heading.
    course: Option<Course>,
}

/// A predicted motion, slice by slice.
#[derive(Debug, Clone)]
struct Course {
    /// The first state.
    begins: TimedPose,
    shape: MovingShape,
    legs: Vec<Leg>,
    may_reverse: Reversing,
}

/// A shape with its states: times (s) and poses relative to the origin.
#[derive(Debug, Clone)]
struct MovingShape {
    states: Vec<(f64, Pose)>,
    parts: Vec<ConvexPart>,
}

/// Whether an obstacle of a kind may move backwards.
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

/// Consecutive slices of a track.
#[derive(Debug, Clone)]
struct Chunk {
    track: usize,
    /// Indices into the track's slices.
    slices: Range<usize>,
}

impl Predictions {
    /// Divides the motion of all moving obstacles from time 0 to `horizon` (s since time step 0 of the file) into slices.
    pub(super) fn new(obstacles: &[Obstacle], origin: Origin, slice: f64, horizon: f64) -> Self {
        let slices = index((horizon / slice - TIME_SLACK).ceil());
        let mut obstacles: Vec<Obstacle> = obstacles.iter().filter(|o| !o.is_static()).cloned().collect();
        obstacles.sort_by_key(|o| o.id);
        let tracks: Vec<_> =
            obstacles.iter().filter_map(|o| Track::new(o, &origin, slice, slices).map(Arc::new)).collect();
        let (chunks, tree) = hierarchy(&tracks);
        Self { slice, slices, origin, obstacles: obstacles.into(), tracks, chunks, tree, identity: Arc::new(()) }
    }

    /// These predictions with other regions.
    fn with_tracks(&self, tracks: Vec<Arc<Track>>) -> Self {
        let (chunks, tree) = hierarchy(&tracks);
        let identity = Arc::new(());
        Self { tracks, chunks, tree, identity, obstacles: Arc::clone(&self.obstacles), ..*self }
    }

    /// These predictions without the slices of some obstacles within a time interval (s since time step 0 of the file). Other
    /// slices remain.
    #[must_use]
    pub fn without(&self, removed: &[(i64, (f64, f64))]) -> Self {
        let remaining = |track: &Arc<Track>| match removed.iter().find(|(id, _)| *id == track.id) {
            Some((_, (from, until))) => {
                Arc::new(track.without((from / self.slice - TIME_SLACK).ceil(), until / self.slice + TIME_SLACK))
            }
            None => Arc::clone(track),
        };
        self.with_tracks(self.tracks.iter().map(remaining).collect())
    }

    /// The reachable sets of the obstacles from `now` on (s since time step 0 of the file): their states at `now` are the
    /// predicted ones, their later motions any within the bounds. Prediction sets remain unchanged.
    #[must_use]
    pub fn reachable(&self, now: f64, bounds: &MotionBounds) -> Self {
        if bounds.is_zero() {
            return self.clone();
        }
        let reachable = |track: &Arc<Track>| match &track.course {
            Some(course) => Arc::new(track.reachable(course, now, self.slice, bounds)),
            None => Arc::clone(track),
        };
        self.with_tracks(self.tracks.iter().map(reachable).collect())
    }

    /// End of the predictions, s since time step 0 of the file.
    #[must_use]
    pub fn horizon(&self) -> f64 {
        self.slices as f64 * self.slice
    }

    /// The cells that the moving obstacles block on consecutive sweeps with margins, from time `from` to `to` (s since time
    /// step 0 of the file; extended to whole slices and limited to the horizon).
    #[must_use]
    pub fn blocked(&self, sweeps: &[&Sweep], margins: &Margins, from: f64, to: f64) -> BlockedGrid {
        self.blocked_finely(sweeps, margins, (from, to), f64::NEG_INFINITY)
    }

    /// [`Predictions::blocked`] at a fine resolution up to a station, m from the start of the first sweep: subcells of 0.1 m and
    /// sub-slices of 0.025 s where a cell is blocked.
    #[must_use]
    pub fn blocked_finely(
        &self,
        sweeps: &[&Sweep],
        margins: &Margins,
        times: (f64, f64),
        fine_until: f64,
    ) -> BlockedGrid {
        let visits: Vec<_> = sweeps.iter().map(|sweep| (*sweep, times)).collect();
        self.blocked_during(&visits, margins, fine_until)
    }

    /// [`Predictions::blocked_finely`] of sweeps that are visited at certain times (s since time step 0 of the file): what blocks one at
    /// another time is left out.
    #[must_use]
    pub fn blocked_during(&self, visits: &[(&Sweep, (f64, f64))], margins: &Margins, fine_until: f64) -> BlockedGrid {
        let mut grid = GridBuilder::new(|track: usize| self.tracks[track].id);
        for (sweep, (from, to)) in visits {
            let first = index((from / self.slice + TIME_SLACK).floor()).min(self.slices);
            let end = index((to / self.slice - TIME_SLACK).ceil()).clamp(first, self.slices);
            let time = |slice: usize| slice as f64 * self.slice;
            let within = (time(first), time(end));
            let kept = self.kept_runs(sweep, margins, first..end);
            let before = grid.end();
            for (cell, limits) in sweep.grid_stations().windows(2).enumerate() {
                if before + limits[0] < fine_until && !kept.runs.of(cell).is_empty() {
                    let division = || fine::Division { predictions: self, sweep, margins, coarse: &kept.runs };
                    let subcells = kept.fine[cell].get_or_init(|| division().of(cell, &kept.slices));
                    for (end, runs) in subcells.runs() {
                        grid.push(before + end, runs, |i| self.sub_slice_time(i), within);
                    }
                } else {
                    grid.push(before + limits[1], kept.runs.of(cell), time, within);
                }
            }
        }
        grid.finish()
    }

    /// These slices (or more) in which each cell of the sweep is blocked, from the cache of the sweep if they are there.
    fn kept_runs(&self, sweep: &Sweep, margins: &Margins, slices: Range<usize>) -> Arc<RunsOf> {
        let contains = |kept: &RunsOf| {
            Arc::ptr_eq(&kept.predictions, &self.identity)
                && kept.slices.start <= slices.start
                && slices.end <= kept.slices.end
        };
        let mut wider = None;
        for kept in sweep.kept_runs().slots().iter().filter(|kept| contains(kept)) {
            if kept.margins == *margins {
                return Arc::clone(kept);
            }
            if kept.margins.contain(margins) {
                wider = Some(Arc::clone(kept));
            }
        }
        let mut bits = SliceBits::new(sweep.grid_cells(), slices.len());
        if wider.as_ref().is_none_or(|wider| !wider.runs.is_empty()) {
            self.mark(sweep, margins, slices.clone(), wider.as_deref().map(|wider| &wider.runs), &mut bits);
        }
        let (predictions, runs) = (Arc::clone(&self.identity), bits.runs(slices.start));
        let fine = vec![OnceLock::new(); sweep.grid_cells()];
        let is_up_to_horizon = slices.end == self.slices;
        let new = Arc::new(RunsOf { predictions, margins: *margins, slices, runs, fine });
        if is_up_to_horizon {
            let mut slots = sweep.kept_runs().slots();
            slots.retain(|kept| Arc::ptr_eq(&kept.predictions, &self.identity) && kept.margins != *margins);
            let excess = (slots.len() + 1).saturating_sub(KEPT);
            slots.drain(..excess);
            slots.push(Arc::clone(&new));
        }
        new
    }

    /// Marks the slices in which the sweep's cells are blocked; only those that are blocked with wider margins, if these are known.
    fn mark(
        &self,
        sweep: &Sweep,
        margins: &Margins,
        range: Range<usize>,
        wider: Option<&CellRuns>,
        bits: &mut SliceBits,
    ) {
        let reach = inflated(sweep.boxes().bounds(), sweep.reach(margins));
        let mut found: Vec<u32> = self.tree.intersect_aabb(&reach).collect();
        // chunks are in order of obstacle and time, so that the lowest id blocks a cell
        found.sort_unstable();
        let mut corners: Vec<Option<SweptCorners>> = vec![None; sweep.cells()];
        for chunk in found.into_iter().map(|i| &self.chunks[i as usize]) {
            let track = &self.tracks[chunk.track];
            for i in chunk.slices.clone() {
                let j = track.first + i;
                let slice = &track.slices[i];
                let Some(aabb) = slice.aabb.filter(|_| range.contains(&j)) else { continue };
                sweep.cells_near(&aabb, &slice.pieces, margins, |cell| {
                    let station_cell = sweep.grid_cell(cell);
                    let is_free = |wider: &CellRuns| wider.track_at(station_cell, j).is_none();
                    if bits.is_set(station_cell, j - range.start) || wider.is_some_and(is_free) {
                        return;
                    }
                    let shape = corners[cell].get_or_insert_with(|| sweep.corners(cell, margins));
                    let reach = sweep.cell_box(cell, margins);
                    if slice.meets(shape, &reach) {
                        bits.set(station_cell, j - range.start, chunk.track);
                    }
                });
            }
        }
    }

    /// The first obstacle, in order of id, that shares a point with the convex polygon at `time`, without margins.
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
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // float casts saturate, as intended
fn index(x: f64) -> usize {
    x as usize
}

/// Chunks of all tracks, and a hierarchy over their boxes.
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
                let states = states.iter().map(|s| (s.time, origin.local_pose(&s.pose))).collect();
                let shape = MovingShape { states, parts };
                let (first, slices, legs) = shape.divided(slice, slices)?;
                let may_reverse = match obstacle.kind {
                    ObstacleKind::Vehicle | ObstacleKind::Bicycle | ObstacleKind::ParkedVehicle => {
                        Reversing::IfVehiclesDo
                    }
                    ObstacleKind::Pedestrian | ObstacleKind::Structure | ObstacleKind::Unknown => Reversing::Always,
                };
                Some(Self { id: obstacle.id, first, slices, course: Some(Course { begins, shape, legs, may_reverse }) })
            }
            Motion::Occupancy(sets) => {
                let (first, slices) = of_sets(sets, origin, slice, slices)?;
                Some(Self { id: obstacle.id, first, slices, course: None })
            }
        }
    }

    /// The track without the slices between two times, in slices.
    fn without(&self, from: f64, until: f64) -> Self {
        let position = |time: f64| index(time).saturating_sub(self.first).min(self.slices.len());
        let (from, until) = (position(from), position(until));
        let mut remaining = self.clone();
        remaining.slices[from..until.max(from)].fill_with(Slice::default);
        remaining
    }

    /// The reachable set in the slices from `now` on.
    fn reachable(&self, course: &Course, now: f64, slice: f64, bounds: &MotionBounds) -> Self {
        let may_reverse = bounds.vehicles_reverse || course.may_reverse == Reversing::Always;
        let mut spread = Spread::new(bounds, may_reverse);
        let absent = course.begins.time - now;
        if let Some(leg) = course.legs.first().filter(|_| absent > 0.0) {
            // before it appears, extrapolate its first state backwards
            let (low, _) = leg.headings;
            let distance = course.begins.speed.abs() * absent;
            spread.advance(absent, &Leg { end: course.begins.time, headings: leg.headings, heading: low, distance });
        }
        let past = index((now / slice + TIME_SLACK).floor()).saturating_sub(self.first).min(self.slices.len());
        let reachable = |(region, leg): (&Slice, &Leg)| {
            spread.advance(leg.end - now, leg);
            let reach = spread.reach(leg);
            let mut reachable = Slice::default();
            region.pieces.iter().filter_map(|p| p.minkowski_sum(&reach)).for_each(|p| reachable.push(p));
            reachable
        };
        let slices = self.slices.iter().zip(&course.legs).skip(past).map(reachable).collect();
        Self { id: self.id, first: self.first + past, slices, course: None }
    }
}

impl Slice {
    /// Whether it shares a point with a footprint in a box.
    fn meets(&self, shape: &mut SweptCorners, aabb: &Aabb) -> bool {
        self.pieces.iter().any(|p| boxes_meet(p.aabb(), aabb) && p.overlaps(shape))
    }

    fn push(&mut self, piece: Convex) {
        self.aabb = Some(self.aabb.map_or(*piece.aabb(), |aabb| merged(&aabb, piece.aabb())));
        self.pieces.push(piece);
    }
}

impl MovingShape {
    /// The first slice, and the regions and the motion of all slices up to the last state.
    fn divided(&self, slice: f64, slices: usize) -> Option<(usize, Vec<Slice>, Vec<Leg>)> {
        let (first, last) = (self.states.first()?, self.states.last()?);
        let range = overlapped(first.0, last.0, slice, slices);
        let (mut regions, mut legs) = (Vec::with_capacity(range.len()), Vec::with_capacity(range.len()));
        let mut heading = first.1.yaw;
        for j in range.clone() {
            let (from, to) = ((j as f64 * slice).max(first.0), ((j + 1) as f64 * slice).min(last.0));
            let poses = poses_between(&self.states, from, to);
            let leg = leg_along(&poses, heading, to);
            heading = leg.heading;
            legs.push(leg);
            regions.push(self.region(&poses));
        }
        (!regions.is_empty()).then_some((range.start, regions, legs))
    }

    /// The region through consecutive poses.
    fn region(&self, poses: &[Pose]) -> Slice {
        let turn = poses.windows(2).map(|w| wrap_angle(w[1].yaw - w[0].yaw).abs()).fold(0.0, f64::max);
        let mut region = Slice::default();
        for part in &self.parts {
            let slack = 0.125 * turn * turn * part.bounding_radius();
            Convex::moved_through(part, poses, slack).into_iter().for_each(|piece| region.push(piece));
        }
        region
    }
}

/// The motion through some poses, from an unwrapped heading, up to a time.
fn leg_along(poses: &[Pose], mut heading: f64, end: f64) -> Leg {
    let (mut headings, mut distance) = ((heading, heading), 0.0);
    for pair in poses.windows(2) {
        heading += wrap_angle(pair[1].yaw - pair[0].yaw);
        headings = (headings.0.min(heading), headings.1.max(heading));
        distance += (pair[1].position - pair[0].position).norm();
    }
    Leg { end, headings, heading, distance }
}

/// The poses at both times and the states in between, interpolated like [`Obstacle::pose_at`].
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

/// The first slice with a region, and all regions up to the last one.
fn of_sets(sets: &[TimedOccupancy], origin: &Origin, slice: f64, slices: usize) -> Option<(usize, Vec<Slice>)> {
    let mut found: BTreeMap<usize, Slice> = BTreeMap::new();
    for (i, set) in sets.iter().enumerate() {
        let until = sets.get(i + 1).map_or(set.to, |next| next.from.max(set.to));
        let pieces: Vec<Convex> = set.region.convex_parts().iter().filter_map(|p| Convex::of_part(p, origin)).collect();
        for j in overlapped(set.from, until, slice, slices) {
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

/// The slices that share more than an instant with the interval; for an instant, those that contain it.
fn overlapped(from: f64, to: f64, slice: f64, slices: usize) -> Range<usize> {
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
