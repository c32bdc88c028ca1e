//! Occupancy grids: square cells that are free, occupied or unknown.

use std::ops::Range;

use crate::geometry::{Point, Pose};

/// What is known of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cell {
    /// Nothing is there.
    Free,
    /// Something is there.
    Occupied,
    /// Nobody knows.
    Unknown,
}

/// A grid of square cells, turned anyhow in the world.
///
/// Cell (column, row) is the square from (column, row) · resolution to (column + 1, row + 1) · resolution in the frame
/// of the origin: columns along its x axis, rows along its y axis, borders included.
#[derive(Debug, Clone, PartialEq)]
pub struct OccupancyGrid {
    origin: Pose,
    resolution: f64,
    width: usize,
    height: usize,
    /// Row by row from the origin's, each from the origin's column.
    cells: Vec<Cell>,
}

/// Why cells make no grid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GridError {
    /// Not a length.
    #[error("the resolution is {0} m, expected a positive number")]
    Resolution(f64),
    /// The pose of the origin is not finite.
    #[error("the origin is not finite")]
    Origin,
    /// More or fewer cells than width times height, or none.
    #[error("{cells} cells for a width of {width} and a height of {height}, expected their product, at least 1")]
    Size {
        /// Cells given.
        cells: usize,
        /// Cells in a row.
        width: usize,
        /// Rows.
        height: usize,
    },
}

/// A rectangle of cells.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CellBlock {
    /// Its columns.
    pub columns: Range<usize>,
    /// Its rows.
    pub rows: Range<usize>,
}

impl OccupancyGrid {
    /// A grid from its cells, row by row from the row of the origin. `origin` is the pose of the outer corner of cell
    /// (0, 0), `resolution` the side of a cell, m.
    ///
    /// # Errors
    /// A resolution that is no length, an origin that is not finite, another number of cells than width · height.
    pub fn new(
        origin: Pose,
        resolution: f64,
        width: usize,
        height: usize,
        cells: Vec<Cell>,
    ) -> Result<Self, GridError> {
        if !(resolution.is_finite() && resolution > 0.0) {
            return Err(GridError::Resolution(resolution));
        }
        if ![origin.position.x, origin.position.y, origin.yaw].iter().all(|v| v.is_finite()) {
            return Err(GridError::Origin);
        }
        if cells.is_empty() || width.checked_mul(height) != Some(cells.len()) {
            return Err(GridError::Size { cells: cells.len(), width, height });
        }
        Ok(Self { origin, resolution, width, height, cells })
    }

    /// Pose of the outer corner of cell (0, 0).
    #[must_use]
    pub fn origin(&self) -> &Pose {
        &self.origin
    }

    /// Side of a cell, m.
    #[must_use]
    pub fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Cells in a row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// A cell; `None` beyond the grid.
    #[must_use]
    pub fn cell(&self, column: usize, row: usize) -> Option<Cell> {
        if column < self.width { self.cells.get(row.checked_mul(self.width)? + column).copied() } else { None }
    }

    /// The cell that holds a point of the world; `None` beyond the grid.
    #[must_use]
    pub fn cell_at(&self, p: Point) -> Option<Cell> {
        let local = self.origin.to_local(p) / self.resolution;
        if !(local.x >= 0.0 && local.y >= 0.0) {
            return None;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not negative; beyond the grid it saturates
        self.cell(local.x as usize, local.y as usize)
    }

    /// The wanted cells as few rectangles that do not overlap: runs of each row, joined with the row below where it has
    /// the very same run. In order of their first row and column.
    #[must_use]
    pub fn blocks(&self, wanted: impl Fn(Cell) -> bool) -> Vec<CellBlock> {
        let mut blocks: Vec<CellBlock> = Vec::new();
        // blocks that end with the last row, in order of their columns
        let mut open: Vec<usize> = Vec::new();
        for (row, cells) in self.cells.chunks_exact(self.width).enumerate() {
            let mut below = open.into_iter().peekable();
            let mut now = Vec::new();
            let mut column = 0;
            for run in cells.chunk_by(|a, b| wanted(*a) == wanted(*b)) {
                let columns = column..column + run.len();
                column = columns.end;
                if !wanted(run[0]) {
                    continue;
                }
                while below.next_if(|i| blocks[*i].columns.start < columns.start).is_some() {}
                if let Some(same) = below.next_if(|i| blocks[*i].columns == columns) {
                    blocks[same].rows.end = row + 1;
                    now.push(same);
                } else {
                    now.push(blocks.len());
                    blocks.push(CellBlock { columns, rows: row..row + 1 });
                }
            }
            open = now;
        }
        blocks
    }

    /// The corners of a rectangle of cells in the world, counter-clockwise.
    #[must_use]
    pub fn corners(&self, block: &CellBlock) -> [Point; 4] {
        let at = |column: usize, row: usize| {
            self.origin.to_world(Point::new(column as f64 * self.resolution, row as f64 * self.resolution))
        };
        let (c, r) = (&block.columns, &block.rows);
        [at(c.start, r.start), at(c.end, r.start), at(c.end, r.end), at(c.start, r.end)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grid(width: usize, rows: &[&str]) -> OccupancyGrid {
        let cells = rows.iter().flat_map(|row| row.chars()).map(|c| match c {
            '#' => Cell::Occupied,
            '?' => Cell::Unknown,
            _ => Cell::Free,
        });
        OccupancyGrid::new(Pose::new(10.0, 20.0, 0.0), 0.5, width, rows.len(), cells.collect()).unwrap()
    }

    #[test]
    fn runs_are_joined_over_rows_where_they_are_the_same() {
        let grid = grid(5, &["##..#", "##..#", "##.##", "....."]);
        let blocks = grid.blocks(|c| c == Cell::Occupied);
        let expected = [(0..2, 0..3), (4..5, 0..2), (3..5, 2..3)];
        assert_eq!(blocks, expected.map(|(columns, rows)| CellBlock { columns, rows }));
        assert_eq!(
            grid.corners(&blocks[1]).map(|p| (p.x, p.y)),
            [(12.0, 20.0), (12.5, 20.0), (12.5, 21.0), (12.0, 21.0)]
        );
    }

    #[test]
    fn a_point_lies_in_its_cell_of_a_turned_grid() {
        let cells = vec![Cell::Free, Cell::Occupied, Cell::Unknown, Cell::Free];
        let quarter = std::f64::consts::FRAC_PI_2;
        let grid = OccupancyGrid::new(Pose::new(1.0, 2.0, quarter), 2.0, 2, 2, cells).unwrap();
        // columns go up, rows go left
        assert_eq!(grid.cell_at(Point::new(0.0, 5.0)), Some(Cell::Occupied));
        assert_eq!(grid.cell_at(Point::new(-2.0, 3.0)), Some(Cell::Unknown));
        for outside in [(2.0, 3.0), (0.0, 1.0), (0.0, 6.5), (-3.5, 3.0), (f64::NAN, 0.0), (1e300, 1e300)] {
            assert_eq!(grid.cell_at(Point::new(outside.0, outside.1)), None, "{outside:?}");
        }
        assert_eq!((grid.cell(2, 0), grid.cell(0, 2), grid.cell(usize::MAX, usize::MAX)), (None, None, None));
    }

    #[test]
    fn what_is_no_grid_is_told() {
        let at = |x: f64| Pose::new(x, 0.0, 0.0);
        let new = |origin, resolution, width, n: usize| {
            OccupancyGrid::new(origin, resolution, width, 2, vec![Cell::Free; n]).unwrap_err()
        };
        assert!(matches!(new(at(0.0), 0.0, 2, 4), GridError::Resolution(_)));
        assert!(matches!(new(at(0.0), f64::NAN, 2, 4), GridError::Resolution(_)));
        assert_eq!(new(at(f64::INFINITY), 1.0, 2, 4), GridError::Origin);
        for (width, n) in [(2, 3), (0, 0), (usize::MAX, 4)] {
            assert!(matches!(new(at(0.0), 1.0, width, n), GridError::Size { .. }), "{width} {n}");
        }
    }

    proptest! {
        /// The blocks cover the wanted cells, each once, and nothing else.
        #[test]
        fn blocks_are_the_wanted_cells(width in 1..9usize, height in 1..9usize, seed in prop::collection::vec(0..3u8, 64)) {
            let cells: Vec<Cell> =
                seed[..width * height].iter().map(|c| [Cell::Free, Cell::Occupied, Cell::Unknown][usize::from(*c)]).collect();
            let grid = OccupancyGrid::new(Pose::new(0.0, 0.0, 0.0), 1.0, width, height, cells).unwrap();
            let wanted = |c| c != Cell::Free;
            let mut covered = vec![0; width * height];
            for block in grid.blocks(wanted) {
                for row in block.rows.clone() {
                    block.columns.clone().for_each(|column| covered[row * width + column] += 1);
                }
            }
            for row in 0..height {
                for column in 0..width {
                    prop_assert_eq!(covered[row * width + column], i32::from(wanted(grid.cell(column, row).unwrap())));
                }
            }
        }
    }
}
