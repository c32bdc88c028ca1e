//! The outline of the vehicle: a bounding rectangle, and convex parts if the vehicle is not a rectangle.
//!
//! # Technique
//! Most vehicles are one rectangle ([`Body`]) and have no parts. Otherwise the bounding rectangle is tested first, and the
//! parts only against obstacles that meet its swept hull: each part separately, by its hull at both ends of a cell, inflated
//! by margins and ε. A hull around several parts would cover the gap between them. The bound ε (derived in
//! [`super::swept`]) holds for every point of the body; it is computed for the outermost corner of the rectangle, which is
//! at least as far out as that of any part.
//!
//! Inflation by margins is the Minkowski sum with the rectangle of the margins in the axes of the vehicle, exact and convex.
//! Its corners are those of the part, each displaced by the corners of the margin rectangle that are extreme between the
//! normals of its two edges. These signs are computed once, so that inflation by any margin is one multiplication.
//!
//! # Weakness
//! A part costs about as much as the rectangle, and its hulls are on the heap.

use std::sync::Arc;

use super::convert::{Local, vector};
use super::convex::{Convex, SweptCorners};
use super::margins::Margins;
use super::swept::{Body, Frame};
use crate::vehicle::Vehicle;

/// The area of the vehicle in the rear-axle frame.
#[derive(Debug, Clone)]
pub(super) struct Outline {
    body: Body,
    /// `None` if the vehicle is the rectangle and contains the rear axle.
    parts: Option<Arc<[Part]>>,
}

/// A convex part.
#[derive(Debug)]
struct Part {
    /// Counter-clockwise.
    corners: Vec<Local>,
    inflated: Vec<InflatedCorner>,
}

/// A corner of an inflated part: `at` displaced by the margins with the signs `out`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct InflatedCorner {
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

    /// The bounding rectangle of the vehicle.
    pub(super) fn body(&self) -> &Body {
        &self.body
    }

    /// Calls `visit` with the corners of every part (counter-clockwise) at the frame.
    pub(super) fn for_each_part(&self, frame: &Frame, mut visit: impl FnMut(&[Local])) {
        match &self.parts {
            None => visit(&self.body.corners(frame)),
            Some(parts) => parts.iter().for_each(|part| visit(&part.at(frame))),
        }
    }

    /// Whether one point of every part passes a test. If no boundary meets the parts, the result for the point is valid for
    /// the whole part. For a rectangle the point is the rear axle.
    pub(super) fn all_parts(&self, frame: &Frame, test: impl Fn(Local) -> bool) -> bool {
        match &self.parts {
            None => test(frame.at),
            Some(parts) => parts.iter().all(|part| part.corners.first().is_none_or(|p| test(frame.to_world(*p)))),
        }
    }

    /// The footprint swept from one frame to the next, inflated by the margins and by `slack`.
    pub(super) fn footprint(&self, ends: [Frame; 2], margins: &Margins, slack: f64) -> SweptCorners {
        let body = self.body.inflated(margins, slack);
        let ([a, b, c, d], [e, f, g, h]) = (body.corners(&ends[0]), body.corners(&ends[1]));
        SweptCorners::new([a, b, c, d, e, f, g, h]).with_parts(self.swept(ends, margins, slack))
    }

    /// The parts swept from one frame to the next, inflated by the margins and by `slack`; `None` for a rectangle.
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
        let inflated = (0..n).flat_map(|i| {
            let (before, after) = (outward(i + n - 1), outward(i));
            signs_between(before, after).map(move |out| (i, out)).collect::<Vec<_>>()
        });
        let inflated = inflated.map(|(i, out)| InflatedCorner { at: corners[i], out }).collect();
        Self { inflated, corners }
    }

    fn at(&self, frame: &Frame) -> Vec<Local> {
        self.corners.iter().map(|p| frame.to_world(*p)).collect()
    }
}

/// The corners of the unit square that are extreme in the directions from normal `a` counter-clockwise to normal `b`, which
/// are less than 180° apart.
pub(super) fn signs_between(a: Local, b: Local) -> impl Iterator<Item = Local> {
    const CORNERS: [Local; 4] =
        [Local::new(1.0, 1.0), Local::new(-1.0, 1.0), Local::new(-1.0, -1.0), Local::new(1.0, -1.0)];
    // the quadrants just after a and just before b; the latter by mirroring, which exchanges start and end of a quadrant
    let (from, to) = (quadrant(a), 4 - quadrant(Local::new(b.y, b.x)));
    let count = (to + 4 - from) % 4;
    (0..=count).map(move |i| CORNERS[(from + i) % 4])
}

/// The quadrant of a direction, 0 to 3 counter-clockwise; an axis belongs to the quadrant that starts at it.
fn quadrant(d: Local) -> usize {
    if d.y > 0.0 || (d.y == 0.0 && d.x > 0.0) {
        if d.x > 0.0 { 0 } else { 1 }
    } else if d.x < 0.0 {
        2
    } else {
        3
    }
}

/// Parts swept through a cell; hulls are built on demand.
#[derive(Debug, Clone)]
pub(super) struct SweptParts {
    parts: Arc<[Part]>,
    ends: [Frame; 2],
    /// Inflation of the parts, longitudinal and lateral, m.
    by: Local,
    /// Hulls of the first parts, in order.
    hulls: Vec<Convex>,
}

impl SweptParts {
    /// Whether a piece shares a point with any of the parts.
    pub(super) fn meet(&mut self, piece: &Convex) -> bool {
        (0..self.parts.len()).any(|i| {
            if self.hulls.len() <= i {
                self.hulls.extend(self.hull(i));
            }
            // a missing hull has no finite corner: assume an overlap
            self.hulls.get(i).is_none_or(|hull| piece.overlaps_polygon(hull.points()))
        })
    }

    /// The hulls of all parts, counter-clockwise.
    pub(super) fn hulls(&self) -> impl Iterator<Item = Convex> + '_ {
        (0..self.parts.len()).filter_map(|i| self.hull(i))
    }

    fn hull(&self, part: usize) -> Option<Convex> {
        let inflated = &self.parts[part].inflated;
        let corners = self.ends.iter().flat_map(|end| inflated.iter().map(|c| end.to_world(c.at + c.out * self.by)));
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
    fn corners_of_a_box_have_one_sign_and_a_tip_has_two() {
        assert_eq!(signs(((0.0, -1.0), (1.0, 0.0))), [(1.0, -1.0)]);
        assert_eq!(signs(((1.0, 0.0), (0.0, 1.0))), [(1.0, 1.0)]);
        assert_eq!(signs(((0.0, 1.0), (-1.0, 0.0))), [(-1.0, 1.0)]);
        assert_eq!(signs(((-1.0, 0.0), (0.0, -1.0))), [(-1.0, -1.0)]);
        // a nose that points forward uses both front corners of the margins
        assert_eq!(signs(((1.0, -1.0), (1.0, 1.0))), [(1.0, -1.0), (1.0, 1.0)]);
        assert_eq!(signs(((1.0, 0.1), (1.0, 0.2))), [(1.0, 1.0)]);
        assert_eq!(signs(((-0.1, -1.0), (0.1, 1.0))), [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)]);
    }

    #[test]
    fn a_rectangular_part_is_inflated_like_the_body() {
        let corners = [(-1.0, -0.5), (3.0, -0.5), (3.0, 0.5), (-1.0, 0.5)].map(|(x, y)| Local::new(x, y));
        let part = Part::new(corners.to_vec());
        assert_eq!(part.inflated.len(), 4);
        let frame = Frame::new(&Pose::new(2.0, -1.0, 0.3));
        let inflated: Vec<Local> =
            part.inflated.iter().map(|c| frame.to_world(c.at + c.out * Local::new(0.3, 0.2))).collect();
        let expected =
            [(-1.3, -0.7), (3.3, -0.7), (3.3, 0.7), (-1.3, 0.7)].map(|(x, y)| frame.to_world(Local::new(x, y)));
        assert!(inflated.iter().zip(&expected).all(|(a, b)| (*a - *b).length() < 1e-12));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]
        /// Brute force: the hull of every corner displaced by every corner of the margins.
        #[test]
        fn inflation_is_the_minkowski_sum_with_the_margins(
            corners in polygons(), longitudinal in 0.0..1.0f64, lateral in 0.0..1.0f64,
        ) {
            let by = Local::new(longitudinal, lateral);
            let part = Part::new(corners.clone());
            let ours = Convex::hull_of(part.inflated.iter().map(|c| c.at + c.out * by).collect(), 0.0).unwrap();
            let square = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].map(|(x, y)| Local::new(x, y));
            let all = corners.iter().flat_map(|c| square.map(|s| *c + s * by)).collect();
            let slow = Convex::hull_of(all, 0.0).unwrap();
            prop_assert!(part.inflated.len() <= corners.len() + 4, "{} corners of {}", part.inflated.len(), corners.len());
            for p in slow.points() {
                prop_assert!(ours.distance_to(&[*p, *p, *p]) < 1e-12, "{p} is cut off");
            }
            for p in ours.points() {
                prop_assert!(slow.distance_to(&[*p, *p, *p]) < 1e-12, "{p} is too far out");
            }
        }
    }
}
