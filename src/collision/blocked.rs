//! Blocked intervals: the station–time graph for the speed search.

use std::ops::Range;

/// A time interval in which an obstacle blocks a station cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockedInterval {
    /// Start, s since time step 0 of the file.
    pub from: f64,
    /// End, s.
    pub to: f64,
    /// Id of the obstacle; the lowest one if several block at once.
    pub obstacle: i64,
}

/// The blocked times of each station cell on consecutive sweeps. The vehicle is in cell `i` while its rear axle is between
/// `stations()[i]` and `stations()[i + 1]`.
///
/// Intervals consist of whole time slices, or of parts of them where the grid is fine. The region of a slice covers both of its
/// ends, so that intervals that only touch do not conflict.
#[derive(Debug, Clone, PartialEq)]
pub struct BlockedGrid {
    /// Cell limits, m from the start of the first sweep.
    stations: Vec<f64>,
    /// The intervals of cell `i` are `intervals[starts[i]..starts[i + 1]]`.
    starts: Vec<u32>,
    /// Sorted by time and disjoint within a cell; neighbours with different obstacles touch.
    intervals: Vec<BlockedInterval>,
}

impl BlockedGrid {
    /// Number of cells.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.stations.len() - 1
    }

    /// Cell limits, m from the start of the first sweep; one more than there are cells.
    #[must_use]
    pub fn stations(&self) -> &[f64] {
        &self.stations
    }

    /// The cells that share a point with the station interval; a limit between two cells belongs to both.
    #[must_use]
    pub fn cells_over(&self, from: f64, to: f64) -> std::ops::Range<usize> {
        let first = self.stations.partition_point(|s| *s < from).saturating_sub(1).min(self.cells());
        let end = self.stations.partition_point(|s| *s <= to).min(self.cells());
        first..end.max(first)
    }

    /// The blocked intervals of a cell, sorted and disjoint; none beyond the last cell.
    #[must_use]
    pub fn intervals(&self, cell: usize) -> &[BlockedInterval] {
        match (self.starts.get(cell), self.starts.get(cell + 1)) {
            (Some(&a), Some(&b)) => &self.intervals[a as usize..b as usize],
            _ => &[],
        }
    }

    /// Whether the cell is blocked at any time between `from` and `to` (intervals that only touch do not count, unless
    /// `from` = `to`).
    #[must_use]
    pub fn is_blocked(&self, cell: usize, from: f64, to: f64) -> bool {
        self.first_blocked(cell, from, to).is_some()
    }

    /// The first interval that blocks the cell between `from` and `to`.
    #[must_use]
    pub fn first_blocked(&self, cell: usize, from: f64, to: f64) -> Option<&BlockedInterval> {
        let intervals = self.intervals(cell);
        let instant = from == to;
        let i = intervals.partition_point(|b| if instant { b.to < from } else { b.to <= from });
        intervals.get(i).filter(|b| if instant { b.from <= to } else { b.from < to })
    }

    /// Whether any cell that shares a point with the station interval is blocked between the times.
    #[must_use]
    pub fn is_range_blocked(&self, stations: (f64, f64), times: (f64, f64)) -> bool {
        self.cells_over(stations.0, stations.1).any(|cell| self.is_blocked(cell, times.0, times.1))
    }

    /// All blocked cells as (station interval in m, time interval in s).
    pub fn blocked_cells(&self) -> impl Iterator<Item = ((f64, f64), (f64, f64))> + '_ {
        (0..self.cells()).flat_map(move |cell| {
            let stations = (self.stations[cell], self.stations[cell + 1]);
            self.intervals(cell).iter().map(move |b| (stations, (b.from, b.to)))
        })
    }

    /// Whether no cell is blocked.
    #[must_use]
    pub fn is_free(&self) -> bool {
        self.intervals.is_empty()
    }
}

/// Table of cells × slices with the obstacle that blocks each, under construction.
#[derive(Debug)]
pub(super) struct SliceBits {
    slices: usize,
    /// Index of the track + 1 by cell and slice; 0 if free.
    by: Vec<u32>,
}

impl SliceBits {
    pub(super) fn new(cells: usize, slices: usize) -> Self {
        Self { slices, by: vec![0; cells * slices] }
    }

    pub(super) fn is_set(&self, cell: usize, slice: usize) -> bool {
        self.by[cell * self.slices + slice] != 0
    }

    #[allow(clippy::cast_possible_truncation)] // there are not 2³² obstacles
    pub(super) fn set(&mut self, cell: usize, slice: usize, track: usize) {
        self.by[cell * self.slices + slice] = track as u32 + 1;
    }

    /// The runs of slices that one track blocks, by cell; `first` is the first slice of the table.
    #[allow(clippy::cast_possible_truncation)] // cells × slices stays far below 2³²
    pub(super) fn runs(&self, first: usize) -> CellRuns {
        let mut all = CellRuns { starts: vec![0], runs: Vec::new() };
        let free = vec![0; self.slices];
        for row in self.by.chunks_exact(self.slices.max(1)) {
            let mut start = first;
            // most cells are never blocked, which one memory comparison decides
            let blocked = if row == free.as_slice() { &row[..0] } else { row };
            for run in blocked.chunk_by(|a, b| a == b) {
                if run[0] != 0 {
                    all.runs.push(Run { slices: start..start + run.len(), track: run[0] as usize - 1 });
                }
                start += run.len();
            }
            all.starts.push(all.runs.len() as u32);
        }
        all
    }
}

/// Slices in which one track blocks a cell.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Run {
    slices: Range<usize>,
    track: usize,
}

/// The runs of every cell, in order of time.
#[derive(Debug, Clone)]
pub(super) struct CellRuns {
    /// The runs of cell `i` are `runs[starts[i]..starts[i + 1]]`; without slices there are no cells.
    starts: Vec<u32>,
    runs: Vec<Run>,
}

impl CellRuns {
    /// The runs of a cell, in order of time.
    pub(super) fn of(&self, cell: usize) -> &[Run] {
        match (self.starts.get(cell), self.starts.get(cell + 1)) {
            (Some(&a), Some(&b)) => &self.runs[a as usize..b as usize],
            _ => &[],
        }
    }

    /// Whether no cell is ever blocked.
    pub(super) fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// The track that blocks a cell in a slice.
    pub(super) fn track_at(&self, cell: usize, slice: usize) -> Option<usize> {
        let runs = self.of(cell);
        let next = runs.partition_point(|run| run.slices.end <= slice);
        runs.get(next).filter(|run| run.slices.start <= slice).map(|run| run.track)
    }
}

/// Builds a grid, cell by cell.
pub(super) struct GridBuilder<F> {
    /// The obstacle of a track.
    id: F,
    grid: BlockedGrid,
}

impl<F: Fn(usize) -> i64> GridBuilder<F> {
    pub(super) fn new(id: F) -> Self {
        Self { id, grid: BlockedGrid { stations: vec![0.0], starts: vec![0], intervals: Vec::new() } }
    }

    /// Station of the end of the last cell, m.
    pub(super) fn end(&self) -> f64 {
        self.grid.stations[self.grid.stations.len() - 1]
    }

    /// Adds a cell up to a station; `time` is the start of a slice of the runs, `within` are the times that count, s.
    pub(super) fn push(&mut self, station: f64, runs: &[Run], time: impl Fn(usize) -> f64, within: (f64, f64)) {
        let grid = &mut self.grid;
        grid.stations.push(station);
        for run in runs {
            let (from, to) = (time(run.slices.start).max(within.0), time(run.slices.end).min(within.1));
            if from < to {
                grid.intervals.push(BlockedInterval { from, to, obstacle: (self.id)(run.track) });
            }
        }
        #[allow(clippy::cast_possible_truncation)] // cells × slices stays far below 2³²
        grid.starts.push(grid.intervals.len() as u32);
    }

    pub(super) fn finish(self) -> BlockedGrid {
        self.grid
    }
}
