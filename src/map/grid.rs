//! Occupancy grids: square cells that are free, occupied or unknown.

use std::ops::Range;
use std::sync::Arc;

use super::RoadNetwork;
use crate::geometry::{Point, Pose};

/// State of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cell {
    /// Free of obstacles.
    Free,
    /// Occupied by an obstacle.
    Occupied,
    /// Not observed.
    Unknown,
}

/// A grid of square cells, in any orientation.
///
/// Cell (column, row) is the closed square from (column, row) · resolution to (column + 1, row + 1) · resolution in the
/// frame of the origin: columns in x direction, rows in y direction.
#[derive(Debug, Clone, PartialEq)]
pub struct OccupancyGrid {
    origin: Pose,
    resolution: f64,
    width: usize,
    height: usize,
    /// Row by row from the origin. Shared, since grids are large and clones are common.
    cells: Arc<[Cell]>,
}

/// Why cells do not form a grid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GridError {
    /// The resolution is not a positive length.
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
    /// The resolution is not positive, the origin is not finite, or the number of cells is not width · height.
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
        Ok(Self { origin, resolution, width, height, cells: cells.into() })
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

    /// A cell; `None` outside of the grid.
    #[must_use]
    pub fn cell(&self, column: usize, row: usize) -> Option<Cell> {
        if column < self.width { self.cells.get(row.checked_mul(self.width)? + column).copied() } else { None }
    }

    /// The cell that contains a point of the world; `None` outside of the grid.
    #[must_use]
    pub fn cell_at(&self, p: Point) -> Option<Cell> {
        let local = self.origin.to_local(p) / self.resolution;
        if !(local.x >= 0.0 && local.y >= 0.0) {
            return None;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        // not negative; saturates outside of the grid
        self.cell(local.x as usize, local.y as usize)
    }

    /// The selected cells as few disjoint rectangles: runs of each row, joined with an equal run of the row below. In order
    /// of their first row and column.
    #[must_use]
    pub fn blocks(&self, is_selected: impl Fn(Cell) -> bool) -> Vec<CellBlock> {
        self.blocks_within(&CellBlock { columns: 0..self.width, rows: 0..self.height }, is_selected)
    }

    /// [`OccupancyGrid::blocks`] of a part of the grid. The rectangles are inside the part.
    #[must_use]
    pub fn blocks_within(&self, part: &CellBlock, is_selected: impl Fn(Cell) -> bool) -> Vec<CellBlock> {
        let columns = part.columns.start..part.columns.end.min(self.width);
        let rows = part.rows.start..part.rows.end.min(self.height);
        let mut blocks: Vec<CellBlock> = Vec::new();
        if columns.is_empty() {
            return blocks;
        }
        // blocks that extend to the previous row, in order of their columns
        let mut open: Vec<usize> = Vec::new();
        for row in rows {
            let cells = &self.cells[row * self.width..][columns.clone()];
            let mut below = open.into_iter().peekable();
            let mut now = Vec::new();
            let mut column = columns.start;
            for run in cells.chunk_by(|a, b| is_selected(*a) == is_selected(*b)) {
                let columns = column..column + run.len();
                column = columns.end;
                if !is_selected(run[0]) {
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

    /// The part of the grid within `margin` metres of the points' bounding box (in the grid's directions). Empty without
    /// points, or if the grid is farther away.
    #[must_use]
    pub fn part_around<'a>(&self, points: impl IntoIterator<Item = &'a Point>, margin: f64) -> CellBlock {
        let empty = (Point::new(f64::INFINITY, f64::INFINITY), Point::new(f64::NEG_INFINITY, f64::NEG_INFINITY));
        let around = |(low, high): (Point, Point), p: Point| (low.inf(&p), high.sup(&p));
        let (low, high) = points.into_iter().map(|p| self.origin.to_local(*p)).fold(empty, around);
        // casts saturate at zero and at the largest number; NaN becomes zero
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let cells = |low: f64, high: f64, count: usize| {
            let (from, to) = ((low - margin) / self.resolution, (high + margin) / self.resolution);
            (from.floor() as usize).min(count)..(to.ceil() as usize).min(count)
        };
        CellBlock { columns: cells(low.x, high.x, self.width), rows: cells(low.y, high.y, self.height) }
    }

    /// Whether the grid overlaps any lanelet.
    #[must_use]
    pub fn touches(&self, network: &RoadNetwork) -> bool {
        let far = Point::new(self.width as f64, self.height as f64) * self.resolution;
        let inside = |p: &Point| (0.0..=far.x).contains(&p.x) && (0.0..=far.y).contains(&p.y);
        network.lanelets.values().any(|lanelet| {
            let outline: Vec<Point> = lanelet.outline().iter().map(|p| self.origin.to_local(*p)).collect();
            let edges = outline.iter().zip(outline.iter().cycle().skip(1));
            // the outline enters the grid, or the grid is inside the outline
            outline.iter().any(inside)
                || edges.into_iter().any(|(a, b)| crosses(*a, *b, far))
                || lanelet.contains(self.origin.position)
        })
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

/// Whether a segment intersects the rectangle from the origin to `far`, by line clipping (Liang & Barsky 1984).
fn crosses(a: Point, b: Point, far: Point) -> bool {
    let (mut from, mut to) = (0.0_f64, 1.0_f64);
    for (start, direction, length) in [(a.x, b.x - a.x, far.x), (a.y, b.y - a.y, far.y)] {
        if direction == 0.0 {
            if !(0.0..=length).contains(&start) {
                return false;
            }
            continue;
        }
        let (one, other) = (-start / direction, (length - start) / direction);
        (from, to) = (from.max(one.min(other)), to.min(one.max(other)));
    }
    from <= to
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
    fn joins_equal_runs_of_successive_rows() {
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
    fn finds_the_cell_of_a_point_in_a_rotated_grid() {
        let cells = vec![Cell::Free, Cell::Occupied, Cell::Unknown, Cell::Free];
        let quarter = std::f64::consts::FRAC_PI_2;
        let grid = OccupancyGrid::new(Pose::new(1.0, 2.0, quarter), 2.0, 2, 2, cells).unwrap();
        // columns are in y direction, rows in -x direction
        assert_eq!(grid.cell_at(Point::new(0.0, 5.0)), Some(Cell::Occupied));
        assert_eq!(grid.cell_at(Point::new(-2.0, 3.0)), Some(Cell::Unknown));
        for outside in [(2.0, 3.0), (0.0, 1.0), (0.0, 6.5), (-3.5, 3.0), (f64::NAN, 0.0), (1e300, 1e300)] {
            assert_eq!(grid.cell_at(Point::new(outside.0, outside.1)), None, "{outside:?}");
        }
        assert_eq!((grid.cell(2, 0), grid.cell(0, 2), grid.cell(usize::MAX, usize::MAX)), (None, None, None));
    }

    #[test]
    fn the_part_around_points_is_their_bounding_box_inside_the_grid() {
        let grid = grid(4, &["....", "....", "....", "...."]);
        let part = |x: f64, y: f64, margin: f64| grid.part_around(&[Point::new(x, y)], margin);
        // cells of 0.5 m from (10, 20)
        assert_eq!(part(11.1, 20.6, 0.0), CellBlock { columns: 2..3, rows: 1..2 });
        assert_eq!(part(11.1, 20.6, 0.45), CellBlock { columns: 1..4, rows: 0..3 });
        assert_eq!(part(11.1, 20.6, 100.0), CellBlock { columns: 0..4, rows: 0..4 });
        for (x, y) in [(0.0, 21.0), (30.0, 21.0), (11.0, 0.0), (11.0, 1e300), (f64::NAN, f64::NAN)] {
            assert!(grid.blocks_within(&part(x, y, 1.0), |_| true).is_empty(), "({x}, {y})");
        }
        assert!(grid.blocks_within(&grid.part_around(&[], 5.0), |_| true).is_empty());
    }

    #[test]
    fn a_grid_touches_a_road_that_enters_crosses_or_surrounds_it() {
        use crate::fixtures::{lanelet, line, network, road};
        let rotated = |x: f64, y: f64, yaw: f64| {
            OccupancyGrid::new(Pose::new(x, y, yaw), 1.0, 10, 10, vec![Cell::Free; 100]).unwrap()
        };
        let lane = road(4.0, 100.0);
        for (grid, what) in [
            (rotated(95.0, -5.0, 0.0), "the road ends in it"),
            (rotated(50.0, -5.0, 0.0), "the road crosses it"),
            (rotated(50.0, 1.9, 0.0), "the side of the road is inside it"),
            (rotated(50.0, -7.0, std::f64::consts::FRAC_PI_4), "a corner extends over the side of the road"),
        ] {
            assert!(grid.touches(&lane), "{what}");
        }
        let wide = network([lanelet(1, line(&[(0.0, -50.0), (100.0, -50.0)]), line(&[(0.0, 50.0), (100.0, 50.0)]))]);
        assert!(rotated(40.0, 0.0, 0.3).touches(&wide), "it lies within the road");
        for (grid, what) in [
            (rotated(50.0, 2.1, 0.0), "beside"),
            (rotated(101.0, -5.0, 0.0), "behind the end"),
            (rotated(-20.0, -20.0, 0.0), "before and below"),
            (rotated(-9.0, 1.0, std::f64::consts::FRAC_PI_4), "its box would touch"),
        ] {
            assert!(!grid.touches(&lane), "{what}");
        }
        assert!(!rotated(0.0, 0.0, 0.0).touches(&RoadNetwork::default()));
    }

    #[test]
    fn refuses_invalid_grids() {
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
        /// The blocks of a part cover the selected cells in it.
        #[test]
        fn blocks_of_a_part_cover_its_selected_cells(
            seed in prop::collection::vec(any::<bool>(), 48), c in (0..10usize, 0..10usize), r in (0..8usize, 0..8usize),
        ) {
            let cells: Vec<Cell> = seed.iter().map(|o| if *o { Cell::Occupied } else { Cell::Free }).collect();
            let grid = OccupancyGrid::new(Pose::new(0.0, 0.0, 0.0), 1.0, 8, 6, cells).unwrap();
            let part = CellBlock { columns: c.0..c.1, rows: r.0..r.1 };
            let blocks = grid.blocks_within(&part, |c| c == Cell::Occupied);
            let covers = |column, row| blocks.iter().filter(|b| b.columns.contains(&column) && b.rows.contains(&row)).count();
            for row in 0..6 {
                for column in 0..8 {
                    let inside = part.columns.contains(&column) && part.rows.contains(&row);
                    let is_selected = inside && grid.cell(column, row) == Some(Cell::Occupied);
                    prop_assert_eq!(covers(column, row), usize::from(is_selected));
                }
            }
        }

        /// The blocks cover each selected cell once, and no other cell.
        #[test]
        fn blocks_cover_the_selected_cells_once(width in 1..9usize, height in 1..9usize, seed in prop::collection::vec(0..3u8, 64)) {
            let cells: Vec<Cell> =
                seed[..width * height].iter().map(|c| [Cell::Free, Cell::Occupied, Cell::Unknown][usize::from(*c)]).collect();
            let grid = OccupancyGrid::new(Pose::new(0.0, 0.0, 0.0), 1.0, width, height, cells).unwrap();
            let is_selected = |c| c != Cell::Free;
            let mut covered = vec![0; width * height];
            for block in grid.blocks(is_selected) {
                for row in block.rows.clone() {
                    block.columns.clone().for_each(|column| covered[row * width + column] += 1);
                }
            }
            for row in 0..height {
                for column in 0..width {
                    prop_assert_eq!(covered[row * width + column], i32::from(is_selected(grid.cell(column, row).unwrap())));
                }
            }
        }
    }
}
