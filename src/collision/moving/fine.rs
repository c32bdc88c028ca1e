//! Blocked cells at a fine resolution: subcells of 0.1 m and sub-slices of 0.025 s.
//!
//! # Technique
//! A station cell that is blocked in a slice is tested again: each of its subcells with the region of each sub-slice. Both are
//! tighter, and what they do not block is free. So a vehicle close behind another one has a free standstill where it stands. A
//! cell between two cells that are blocked in the same slice is inside the obstacle and remains blocked. Subcells that are
//! blocked at the same times are joined, so that the grid has few more cells than before.
//!
//! Free cells and free slices are never tested, so that the result is a subset of the coarse one.
//!
//! # Weakness
//! The slices of reachable sets and of prediction sets are not divided.

use std::ops::Range;

use super::super::blocked::{CellRuns, Run, SliceBits};
use super::super::convex::merged;
use super::super::course::Subcell;
use super::super::margins::Margins;
use super::super::swept::Sweep;
use super::{Predictions, Slice, TIME_SLACK, Track, index, poses_between};

/// Largest length of a sub-slice, s.
const FINE_SLICE: f64 = 0.025;
/// Slices in which an obstacle moves less are not divided, m.
const STILL: f64 = 0.01;

/// The division of station cells of a sweep.
pub(super) struct Division<'a> {
    pub(super) predictions: &'a Predictions,
    pub(super) sweep: &'a Sweep,
    pub(super) margins: &'a Margins,
    /// The blocked cells of the sweep.
    pub(super) coarse: &'a CellRuns,
}

/// The subcells of a station cell.
#[derive(Debug, Clone)]
pub(super) struct Subcells {
    /// Station of the end of each, m from the start of the sweep; equal neighbours are one.
    ends: Vec<(f64, usize)>,
    runs: CellRuns,
}

impl Subcells {
    /// The station of the end of each subcell (m from the start of the sweep) with its runs of sub-slices.
    pub(super) fn runs(&self) -> impl Iterator<Item = (f64, &[Run])> {
        self.ends.iter().map(|(end, subcell)| (*end, self.runs.of(*subcell)))
    }
}

impl Predictions {
    /// Number of sub-slices in a slice.
    fn sub_slices(&self) -> usize {
        index((self.slice / FINE_SLICE - TIME_SLACK).ceil()).max(1)
    }

    /// The start of a sub-slice, s.
    pub(super) fn sub_slice_time(&self, i: usize) -> f64 {
        let count = self.sub_slices();
        (i / count) as f64 * self.slice + (i % count) as f64 * (self.slice / count as f64)
    }
}

impl Division<'_> {
    /// The subcells of a station cell in some slices.
    pub(super) fn of(&self, cell: usize, slices: &Range<usize>) -> Subcells {
        let subcells = self.sweep.subcells(cell);
        let runs = self.runs(cell, &subcells, slices);
        let ends = subcells.iter().skip(1).map(|next| next.station).chain([self.sweep.grid_stations()[cell + 1]]);
        let is_last_of_equal = |i: usize| i + 1 == subcells.len() || runs.of(i) != runs.of(i + 1);
        let ends = ends.enumerate().filter(|(i, _)| is_last_of_equal(*i)).map(|(i, end)| (end, i)).collect();
        Subcells { ends, runs }
    }

    /// The runs of the subcells, in sub-slices.
    fn runs(&self, cell: usize, subcells: &[Subcell], slices: &Range<usize>) -> CellRuns {
        let (first, count) = (slices.start, self.predictions.sub_slices());
        let time = |i: usize| self.predictions.sub_slice_time(i);
        let mut shapes: Vec<_> = subcells.iter().map(|s| self.sweep.subcell_corners(s, self.margins)).collect();
        let boxes: Vec<_> = shapes.iter().map(|shape| shape.aabb()).collect();
        let mut bits = SliceBits::new(shapes.len(), count * slices.len());
        let Some(around) = boxes.iter().copied().reduce(|a, b| merged(&a, &b)) else { return bits.runs(0) };
        let within = |slice: usize| count * (slice - first)..count * (slice + 1 - first);
        let is_inside = |slice: usize| {
            let before = cell.checked_sub(1).and_then(|before| self.coarse.track_at(before, slice));
            before.is_some() && self.coarse.track_at(cell + 1, slice).is_some()
        };
        let mut is_tested = vec![false; slices.len()];
        for slice in slices.clone() {
            let Some(track) = self.coarse.track_at(cell, slice) else { continue };
            is_tested[slice - first] = !is_inside(slice);
            if is_inside(slice) {
                (0..shapes.len()).for_each(|subcell| within(slice).for_each(|i| bits.set(subcell, i, track)));
            }
        }
        let mut found: Vec<u32> = self.predictions.tree.intersect_aabb(&around).collect();
        // chunks are in order of obstacle and time, so that the lowest id blocks a subcell
        found.sort_unstable();
        for chunk in found.into_iter().map(|i| &self.predictions.chunks[i as usize]) {
            let track = &self.predictions.tracks[chunk.track];
            for i in chunk.slices.clone() {
                let slice = track.first + i;
                if !slices.contains(&slice) || !is_tested[slice - first] {
                    continue;
                }
                let mut regions = None;
                for (subcell, (shape, aabb)) in shapes.iter_mut().zip(&boxes).enumerate() {
                    if !track.slices[i].meets(shape, aabb) {
                        continue;
                    }
                    let regions = regions.get_or_insert_with(|| {
                        let of = |k| track.region_in(i, (time(count * slice + k), time(count * slice + k + 1)));
                        (0..count).map(of).collect::<Vec<_>>()
                    });
                    for (k, region) in within(slice).zip(regions) {
                        if !bits.is_set(subcell, k) && region.as_ref().is_none_or(|region| region.meets(shape, aabb)) {
                            bits.set(subcell, k, chunk.track);
                        }
                    }
                }
            }
        }
        bits.runs(count * first)
    }
}

impl Track {
    /// The region in a sub-slice of slice `i` of the track, between two times (s); `None` if it is that of the whole slice.
    fn region_in(&self, i: usize, (from, to): (f64, f64)) -> Option<Slice> {
        let course = self.course.as_ref()?;
        let states = &course.shape.states;
        let (first, last) = (states.first()?.0, states.last()?.0);
        if course.legs.get(i)?.distance < STILL {
            return None;
        }
        let (from, to) = (from.max(first), to.min(last));
        if from > to + TIME_SLACK {
            return Some(Slice::default());
        }
        Some(course.shape.region(&poses_between(states, from.min(to), to)))
    }
}
