//! A bounding volume hierarchy for queries with oriented boxes.
//!
//! # Technique
//! A node has four children; their boxes are stored as centres and half extents in `f32`, axis by axis, so that one test
//! covers all four (Dammertz et al. 2008, *Shallow bounding volume hierarchies for fast SIMD ray tracing*). A node is skipped
//! if it is apart from the query on a coordinate axis or on an axis of the query. The axes of the query matter: the
//! axis-aligned box of a piece of a diagonal road is four fifths empty.
//!
//! Boxes are rounded outwards and the query is inflated by the error of `f32`, so that the result misses no leaf; the caller
//! tests the results exactly. The tree is built by two median splits per node and is the same for the same boxes.

use parry2d::bounding_volume::Aabb;
use parry2d::glamx::glam::Vec4;

use super::convert::Local;
use super::convex::Convex;

/// Children of a node.
const WIDE: usize = 4;
/// Marks an index as that of a leaf.
const LEAF: u32 = 1 << 31;

/// A box with its number.
type Item = (Aabb, u32);

/// A hierarchy of boxes; leaves are numbered in the order of the input.
#[derive(Debug, Clone)]
pub(super) struct WideTree {
    /// The root comes last.
    nodes: Vec<Node>,
    /// Largest coordinate, m.
    extent: f64,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    x: Vec4,
    y: Vec4,
    half_x: Vec4,
    half_y: Vec4,
    child: [u32; WIDE],
}

impl Node {
    /// A node that meets no query.
    const EMPTY: Self = Self {
        x: Vec4::ZERO,
        y: Vec4::ZERO,
        half_x: Vec4::NEG_INFINITY,
        half_y: Vec4::NEG_INFINITY,
        child: [LEAF; WIDE],
    };
}

/// A rectangle in any orientation.
#[derive(Debug, Clone, Copy)]
pub(super) struct OrientedBox {
    centre: Local,
    /// Unit vector of its first axis.
    forward: Local,
    /// Half extents on its axes.
    half: Local,
    /// Half extents of the smallest axis-aligned box around its points, with the same centre.
    upright: Local,
}

impl OrientedBox {
    /// The box around points in a direction (of any length).
    pub(super) fn around(points: &[Local], direction: Local) -> Self {
        let forward = direction.try_normalize().unwrap_or(Local::X);
        let origin = points.first().copied().unwrap_or(Local::ZERO);
        let (mut low, mut high) = (Local::ZERO, Local::ZERO);
        for p in points {
            let d = *p - origin;
            let turned = Local::new(d.dot(forward), forward.perp_dot(d));
            (low, high) = (low.min(turned), high.max(turned));
        }
        let centre = origin + forward.rotate(0.5 * (low + high));
        let upright = points.iter().fold(Local::ZERO, |m, p| m.max((*p - centre).abs()));
        Self { centre, forward, half: 0.5 * (high - low), upright }
    }

    /// A lower bound of the distance to a piece, m: the larger gap on the axes of the box. Negative if they overlap on both.
    pub(super) fn gap_to(&self, piece: &Convex) -> f64 {
        let (mut low, mut high) = (Local::INFINITY, Local::NEG_INFINITY);
        for p in piece.points() {
            let d = *p - self.centre;
            let turned = Local::new(d.dot(self.forward), self.forward.perp_dot(d));
            (low, high) = (low.min(turned), high.max(turned));
        }
        (low - self.half).max(-self.half - high).max_element() - piece.radius()
    }
}

impl WideTree {
    /// A hierarchy over boxes with finite coordinates.
    pub(super) fn new(boxes: impl Iterator<Item = Aabb>) -> Self {
        #[allow(clippy::cast_possible_truncation)] // there are not 2³¹ pieces
        let mut items: Vec<Item> = boxes.enumerate().map(|(i, aabb)| (aabb, i as u32)).collect();
        let extent = items.iter().fold(0.0, |m: f64, (b, _)| m.max(b.mins.abs().max(b.maxs.abs()).max_element()));
        let mut tree = Self { nodes: Vec::with_capacity(items.len() / 2 + 1), extent };
        if !items.is_empty() {
            tree.build(&mut items);
        }
        tree
    }

    /// Index of the node over the items.
    fn build(&mut self, items: &mut [Item]) -> u32 {
        let mut node = Node::EMPTY;
        let (low, high) = halved(items);
        let ((a, b), (c, d)) = (halved(low), halved(high));
        let quarters = [a, b, c, d].into_iter().filter(|quarter| !quarter.is_empty());
        for (i, quarter) in quarters.enumerate() {
            let aabb = quarter.iter().skip(1).fold(quarter[0].0, |a, (b, _)| super::convex::merged(&a, b));
            (node.x[i], node.half_x[i]) = rounded_out(aabb.mins.x, aabb.maxs.x);
            (node.y[i], node.half_y[i]) = rounded_out(aabb.mins.y, aabb.maxs.y);
            node.child[i] = if quarter.len() == 1 { LEAF | quarter[0].1 } else { self.build(quarter) };
        }
        self.nodes.push(node);
        #[allow(clippy::cast_possible_truncation)] // fewer nodes than leaves
        let index = (self.nodes.len() - 1) as u32;
        index
    }

    /// Calls `found` with at least every leaf whose box is within `reach` of the oriented box.
    pub(super) fn visit(&self, query: &OrientedBox, reach: f64, mut found: impl FnMut(usize)) {
        /// Leaves have 31-bit numbers and nodes two splits: 16 levels with three siblings each.
        const MAX_DEPTH: usize = 64;
        let Some(root) = self.nodes.len().checked_sub(1) else { return };
        let query = Query::new(query, reach, self.extent);
        let mut stack = [0_u32; MAX_DEPTH];
        #[allow(clippy::cast_possible_truncation)] // fewer nodes than leaves
        let root = root as u32;
        stack[0] = root;
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let node = &self.nodes[stack[height] as usize];
            let mut meets = query.meets(node);
            while meets != 0 {
                let child = node.child[meets.trailing_zeros() as usize];
                meets &= meets - 1;
                if child & LEAF != 0 {
                    found((child & !LEAF) as usize);
                } else {
                    stack[height] = child;
                    height += 1;
                }
            }
        }
    }
}

/// An oriented box in `f32`, inflated.
struct Query {
    x: f32,
    y: f32,
    half_x: f32,
    half_y: f32,
    forward_x: f32,
    forward_y: f32,
    upright_x: f32,
    upright_y: f32,
}

impl Query {
    #[allow(clippy::cast_possible_truncation)] // inflated by the rounding error
    fn new(query: &OrientedBox, reach: f64, extent: f64) -> Self {
        /// Relative error of the sums and products of [`Query::meets`], with a reserve (an `f32` has 6e-8).
        const ROUNDING: f64 = 1e-6;
        let size = extent + query.centre.x.abs() + query.centre.y.abs() + query.upright.max_element();
        let reach = reach + ROUNDING * (1.0 + size + reach);
        Self {
            x: query.centre.x as f32,
            y: query.centre.y as f32,
            half_x: (query.half.x + reach) as f32,
            half_y: (query.half.y + reach) as f32,
            forward_x: query.forward.x as f32,
            forward_y: query.forward.y as f32,
            upright_x: (query.upright.x + reach) as f32,
            upright_y: (query.upright.y + reach) as f32,
        }
    }

    /// The children that are not apart on any of the four axes, as bits.
    fn meets(&self, node: &Node) -> u32 {
        let (fx, fy) = (self.forward_x, self.forward_y);
        let (gx, gy) = (fx.abs(), fy.abs());
        let (dx, dy, hx, hy) = (node.x - self.x, node.y - self.y, node.half_x, node.half_y);
        let upright = dx.abs().cmple(hx + self.upright_x) & dy.abs().cmple(hy + self.upright_y);
        let longitudinal = (dx * fx + dy * fy).abs().cmple(hx * gx + hy * gy + self.half_x);
        let lateral = (dy * fx - dx * fy).abs().cmple(hx * gy + hy * gx + self.half_y);
        (upright & longitudinal & lateral).bitmask()
    }
}

/// The items below and above the median on the axis with the larger extent of their centres.
fn halved(items: &mut [Item]) -> (&mut [Item], &mut [Item]) {
    if items.len() < 2 {
        return items.split_at_mut(items.len());
    }
    let middle = |(aabb, _): &Item| aabb.mins + aabb.maxs;
    let first = (Local::INFINITY, Local::NEG_INFINITY);
    let (low, high) = items.iter().map(middle).fold(first, |(low, high), m| (low.min(m), high.max(m)));
    let extent = high - low;
    let key = |item: &Item| if extent.x >= extent.y { middle(item).x } else { middle(item).y };
    let half = items.len() / 2;
    items.select_nth_unstable_by(half, |a, b| key(a).total_cmp(&key(b)).then(a.1.cmp(&b.1)));
    items.split_at_mut(half)
}

/// Centre and half extent in `f32` of an interval, rounded outwards.
#[allow(clippy::cast_possible_truncation)] // rounded outwards
fn rounded_out(low: f64, high: f64) -> (f32, f32) {
    let middle = (0.5 * (low + high)) as f32;
    let half = (high - f64::from(middle)).max(f64::from(middle) - low);
    (middle, (half as f32).next_up())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn turned(x: f64, y: f64, angle: f64, half: (f64, f64)) -> ([Local; 4], OrientedBox) {
        let forward = Local::new(angle.cos(), angle.sin());
        let corner = |i: f64, j: f64| Local::new(x, y) + forward.rotate(Local::new(i * half.0, j * half.1));
        let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        (corners, OrientedBox::around(&corners, 3.0 * forward))
    }

    proptest! {
        /// Agrees with a list of all boxes, at any distance from the origin.
        #[test]
        fn visits_every_box_within_reach(
            boxes in prop::collection::vec((-50.0..50.0f64, -50.0..50.0f64, 0.0..5.0f64, 0.0..5.0f64), 0..80),
            x in -60.0..60.0f64, y in -60.0..60.0f64, angle in -4.0..4.0f64, half in (0.0..10.0f64, 0.0..3.0f64), reach in 0.0..2.0f64,
            shift in prop_oneof![Just(0.0), Just(1e3), Just(-3e5)],
        ) {
            let at = |x: f64, y: f64| Local::new(x + shift, y - 0.5 * shift);
            let boxes: Vec<Aabb> = boxes.iter().map(|&(x, y, w, h)| Aabb { mins: at(x, y), maxs: at(x + w, y + h) }).collect();
            let tree = WideTree::new(boxes.iter().copied());
            let (corners, query) = turned(x + shift, y - 0.5 * shift, angle, half);
            let mut found = vec![0; boxes.len()];
            tree.visit(&query, reach, |leaf| found[leaf] += 1);
            for (aabb, found) in boxes.iter().zip(found) {
                let (a, b) = (aabb.mins, aabb.maxs);
                let corners_of_box = vec![a, Local::new(b.x, a.y), b, Local::new(a.x, b.y)];
                let piece = Convex::hull_of(corners_of_box, 0.0).unwrap();
                let distance = piece.distance_to(&corners);
                prop_assert!(found <= 1);
                prop_assert!(found == 1 || distance > reach, "missed a box at {distance}, reach {reach}");
                prop_assert!(query.gap_to(&piece) <= distance + 1e-9);
                // and hardly more: two boxes have only these four axes
                if shift == 0.0 && query.gap_to(&piece) > reach + 0.01 {
                    prop_assert_eq!(found, 0);
                }
            }
        }
    }
}
