//! The vehicle's outline: a rectangle around it, and its parts where it is not just that rectangle.
//!
//! # Technique
//! Most vehicles are one rectangle ([`Body`]); then there is nothing else here, and nothing else is computed. Otherwise the
//! rectangle around all parts decides first, and only what meets its swept hull is asked of the parts, each for
//! itself: the hull of a part at both ends of a cell, grown by margins and ε. No hull is made around several parts,
//! which would bridge the room between them. The bound ε (derived in [`super::swept`]) holds for every point of the
//! body; it is taken for the outermost corner of the rectangle, which lies no nearer than that of any part.
//!
//! Growing by margins is the Minkowski sum with the rectangle of the margins in the vehicle's axes, exact and convex. Its
//! corners are the part's, each moved by those corners of the margin rectangle that are outermost in the directions
//! between the normals of the two edges that meet there; these signs are computed once, so that growing by any margin
//! is one multiplication.
//!
//! # Weakness
//! A part costs about as much as the rectangle does, and its hulls live on the heap.

use std::sync::Arc;

use super::convert::{Local, vector};
use super::convex::Convex;
use super::swept::{Body, Frame, Margins};
use crate::vehicle::Vehicle;

/// What the vehicle covers, in the rear-axle frame.
#[derive(Debug, Clone)]
pub(super) struct Outline {
    body: Body,
    /// `None` when the body is the outline and holds the rear axle.
    parts: Option<Arc<[Part]>>,
}

/// A convex part.
#[derive(Debug)]
struct Part {
    /// Counter-clockwise.
    corners: Vec<Local>,
    grown: Vec<GrownCorner>,
}

/// A corner of a part grown by margins: `at` moved by the margins with the signs `out`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct GrownCorner {
    at: Local,
    out: Local,
}

impl Outline {
    pub(super) fn new(vehicle: &Vehicle) -> Self {
        let (body, footprint) = (Body::new(vehicle), &vehicle.footprint);
        let is_body = footprint.is_rectangle() && body.depth_of_rear_axle() >= 0.0;
        let part = |corners: &Vec<_>| Part::new(corners.iter().map(|p| vector(*p)).collect());
        let parts = (!is_body).then(|| footprint.parts().iter().map(part).collect());
        Self { body, parts }
    }

    /// The rectangle around the vehicle.
    pub(super) fn body(&self) -> &Body {
        &self.body
    }

    /// Calls `visit` with the corners of every part (counter-clockwise) where the vehicle stands.
    pub(super) fn for_each_part(&self, frame: &Frame, mut visit: impl FnMut(&[Local])) {
        match &self.parts {
            None => visit(&self.body.corners(frame)),
            Some(parts) => parts.iter().for_each(|part| visit(&part.at(frame))),
        }
    }

    /// Whether a point of every part passes a test: where no boundary meets the parts, what holds for the point holds
    /// for the part. For a rectangle that point is the rear axle.
    pub(super) fn all_parts(&self, frame: &Frame, test: impl Fn(Local) -> bool) -> bool {
        match &self.parts {
            None => test(frame.at),
            Some(parts) => parts.iter().all(|part| part.corners.first().is_none_or(|p| test(frame.to_world(*p)))),
        }
    }

    /// The parts swept from one frame to the next, grown by the margins and by `slack`; `None` when the body is all.
    pub(super) fn swept(&self, ends: [Frame; 2], margins: &Margins, slack: f64) -> Option<Box<SweptParts>> {
        let parts = Arc::clone(self.parts.as_ref()?);
        let by = Local::new(margins.longitudinal + slack, margins.lateral + slack);
        Some(Box::new(SweptParts { parts, ends, by, hulls: Vec::new() }))
    }
}

impl Part {
    fn new(corners: Vec<Local>) -> Self {
        let n = corners.len();
        let outward = |i: usize| {
            let edge = corners[(i + 1) % n] - corners[i % n];
            Local::new(edge.y, -edge.x)
        };
        let grown = (0..n).flat_map(|i| {
            let (before, after) = (outward(i + n - 1), outward(i));
            signs_between(before, after).map(move |out| (i, out)).collect::<Vec<_>>()
        });
        let grown = grown.map(|(i, out)| GrownCorner { at: corners[i], out }).collect();
        Self { grown, corners }
    }

    fn at(&self, frame: &Frame) -> Vec<Local> {
        self.corners.iter().map(|p| frame.to_world(*p)).collect()
    }
}

/// The corners of the unit square that are outermost in the directions from normal `a` counter-clockwise to normal `b`, less
/// than half a turn on.
pub(super) fn signs_between(a: Local, b: Local) -> impl Iterator<Item = Local> {
    const CORNERS: [Local; 4] =
        [Local::new(1.0, 1.0), Local::new(-1.0, 1.0), Local::new(-1.0, -1.0), Local::new(1.0, -1.0)];
    // just after a, and just before b: mirrored, where an axis begins a quadrant it ends one
    let (from, to) = (quadrant(a), 4 - quadrant(Local::new(b.y, b.x)));
    let count = (to + 4 - from) % 4;
    (0..=count).map(move |i| CORNERS[(from + i) % 4])
}

/// The quadrant that a direction lies in, 0 to 3 counter-clockwise; an axis belongs to the quadrant that begins with it.
fn quadrant(d: Local) -> usize {
    if d.y > 0.0 || (d.y == 0.0 && d.x > 0.0) {
        if d.x > 0.0 { 0 } else { 1 }
    } else if d.x < 0.0 {
        2
    } else {
        3
    }
}

/// Parts swept through a cell; hulls are built when first asked for.
#[derive(Debug, Clone)]
pub(super) struct SweptParts {
    parts: Arc<[Part]>,
    ends: [Frame; 2],
    /// By how much the parts are grown, along and across, m.
    by: Local,
    /// Of the first parts, in their order.
    hulls: Vec<Convex>,
}

impl SweptParts {
    /// Whether a piece shares a point with any of the parts.
    pub(super) fn meet(&mut self, piece: &Convex) -> bool {
        (0..self.parts.len()).any(|i| {
            if self.hulls.len() <= i {
                self.hulls.extend(self.hull(i));
            }
            // a hull that is missing had no finite corner, and nothing is known about it
            self.hulls.get(i).is_none_or(|hull| piece.overlaps_polygon(hull.points()))
        })
    }

    /// The hulls of all parts, counter-clockwise.
    pub(super) fn hulls(&self) -> impl Iterator<Item = Convex> + '_ {
        (0..self.parts.len()).filter_map(|i| self.hull(i))
    }

    fn hull(&self, part: usize) -> Option<Convex> {
        let grown = &self.parts[part].grown;
        let corners = self.ends.iter().flat_map(|end| grown.iter().map(|c| end.to_world(c.at + c.out * self.by)));
        Convex::hull_of(corners.collect(), 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use proptest::prelude::*;

    fn polygons() -> impl Strategy<Value = Vec<Local>> {
        let coordinate = prop_oneof![(-4.0..4.0f64), (-3..3i32).prop_map(f64::from)];
        prop::collection::vec((coordinate.clone(), coordinate), 3..9).prop_filter_map("no area", |points| {
            let hull = Convex::hull_of(points.into_iter().map(|(x, y)| Local::new(x, y)).collect(), 0.0)?;
            (hull.points().len() > 2).then(|| hull.points().to_vec())
        })
    }

    fn signs(normals: ((f64, f64), (f64, f64))) -> Vec<(f64, f64)> {
        let ((ax, ay), (bx, by)) = normals;
        signs_between(Local::new(ax, ay), Local::new(bx, by)).map(|s| (s.x, s.y)).collect()
    }

    #[test]
    fn the_corners_of_a_box_move_out_once_each_and_a_tip_twice() {
        assert_eq!(signs(((0.0, -1.0), (1.0, 0.0))), [(1.0, -1.0)]);
        assert_eq!(signs(((1.0, 0.0), (0.0, 1.0))), [(1.0, 1.0)]);
        assert_eq!(signs(((0.0, 1.0), (-1.0, 0.0))), [(-1.0, 1.0)]);
        assert_eq!(signs(((-1.0, 0.0), (0.0, -1.0))), [(-1.0, -1.0)]);
        // a nose that points forward lies between the front corners of the margins
        assert_eq!(signs(((1.0, -1.0), (1.0, 1.0))), [(1.0, -1.0), (1.0, 1.0)]);
        assert_eq!(signs(((1.0, 0.1), (1.0, 0.2))), [(1.0, 1.0)]);
        assert_eq!(signs(((-0.1, -1.0), (0.1, 1.0))), [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)]);
    }

    #[test]
    fn a_rectangle_as_a_part_is_swept_as_the_body_is() {
        let corners = [(-1.0, -0.5), (3.0, -0.5), (3.0, 0.5), (-1.0, 0.5)].map(|(x, y)| Local::new(x, y));
        let part = Part::new(corners.to_vec());
        assert_eq!(part.grown.len(), 4);
        let frame = Frame::new(&Pose::new(2.0, -1.0, 0.3));
        let grown: Vec<Local> =
            part.grown.iter().map(|c| frame.to_world(c.at + c.out * Local::new(0.3, 0.2))).collect();
        let by_hand =
            [(-1.3, -0.7), (3.3, -0.7), (3.3, 0.7), (-1.3, 0.7)].map(|(x, y)| frame.to_world(Local::new(x, y)));
        assert!(grown.iter().zip(&by_hand).all(|(a, b)| (*a - *b).length() < 1e-12));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]
        /// The slow way: the hull of every corner moved by every corner of the margins.
        #[test]
        fn growing_is_the_minkowski_sum_with_the_margins(corners in polygons(), along in 0.0..1.0f64, across in 0.0..1.0f64) {
            let by = Local::new(along, across);
            let part = Part::new(corners.clone());
            let ours = Convex::hull_of(part.grown.iter().map(|c| c.at + c.out * by).collect(), 0.0).unwrap();
            let square = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].map(|(x, y)| Local::new(x, y));
            let all = corners.iter().flat_map(|c| square.map(|s| *c + s * by)).collect();
            let slow = Convex::hull_of(all, 0.0).unwrap();
            prop_assert!(part.grown.len() <= corners.len() + 4, "{} corners of {}", part.grown.len(), corners.len());
            for p in slow.points() {
                prop_assert!(ours.distance_to(&[*p, *p, *p]) < 1e-12, "{p} is cut off");
            }
            for p in ours.points() {
                prop_assert!(slow.distance_to(&[*p, *p, *p]) < 1e-12, "{p} is too far out");
            }
        }
    }
}
