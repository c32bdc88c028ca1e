//! Footprint: the area that the vehicle covers on the ground, as convex polygons in the rear-axle frame.
//!
//! # Technique
//! Each part is the convex hull of its points (Andrew's monotone chain). The union of the parts is the footprint, so it
//! need not be convex: beside a truck's narrow cab there is free space. A part inside another one is dropped, such as a
//! cabin above a body. A part with more than [`MAX_CORNERS`] corners is simplified outwards: an edge is removed and its
//! neighbours are extended to their intersection, the edge that adds the least area first. The result contains the part.
//!
//! # Limits
//! The footprint is rigid and flat. It has no heights, and no steered wheels or trailers.

use crate::geometry::{Point, cross};

/// Most corners of a part. The cost of a collision check is proportional to it; 16 corners are within 2 % of a circle's
/// radius.
pub const MAX_CORNERS: usize = 16;
/// Most parts of a footprint.
pub const MAX_PARTS: usize = 32;
/// Largest distance of a corner from the rear axle, m. No road vehicle is longer; a mesh in millimetres is.
pub const MAX_REACH: f64 = 50.0;
/// Smallest area of a part, m²; a smaller part is a line.
const SMALLEST_AREA: f64 = 1e-6;
/// Distance below which corners are equal, m: far below the resolution of a collision check.
const SAME: f64 = 1e-9;

/// One or more convex polygons that move with the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Footprint {
    parts: Vec<Vec<Point>>,
    length: f64,
    width: f64,
    rear_axle_to_centre: f64,
}

/// Why points do not form a footprint.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FootprintError {
    /// There is no part.
    #[error("no parts")]
    Empty,
    /// More parts than [`MAX_PARTS`].
    #[error("{count} parts, more than {MAX_PARTS}")]
    TooMany {
        /// Number of parts.
        count: usize,
    },
    /// A coordinate that is not finite.
    #[error("a corner that is not finite")]
    NotFinite {
        /// Index of the part.
        part: usize,
    },
    /// A part without area: all its points are on a line.
    #[error("no area")]
    Flat {
        /// Index of the part.
        part: usize,
    },
    /// A corner too far from the rear axle.
    #[error("a corner {reach:.1} m from the rear axle")]
    TooFar {
        /// Index of the part.
        part: usize,
        /// Distance of its farthest corner from the rear axle, m.
        reach: f64,
    },
}

impl FootprintError {
    /// Index of the invalid part; `None` if the error concerns the number of parts.
    #[must_use]
    pub fn part(&self) -> Option<usize> {
        match self {
            Self::Empty | Self::TooMany { .. } => None,
            Self::NotFinite { part } | Self::Flat { part } | Self::TooFar { part, .. } => Some(*part),
        }
    }
}

impl Footprint {
    /// A rectangle (m) whose middle is `rear_axle_to_centre` in front of the rear axle. The sizes are not checked.
    #[must_use]
    pub fn rectangle(length: f64, width: f64, rear_axle_to_centre: f64) -> Self {
        let corners = rectangle_corners(length, width, rear_axle_to_centre);
        Self { parts: vec![corners.to_vec()], length, width, rear_axle_to_centre }
    }

    /// The convex hulls of sets of points (m, rear-axle frame), in their order, without those inside another one.
    ///
    /// # Errors
    /// No parts or too many; a part with a number that is not finite, without area, or too far from the rear axle.
    pub fn new(parts: Vec<Vec<Point>>) -> Result<Self, FootprintError> {
        match parts.len() {
            0 => return Err(FootprintError::Empty),
            count if count > MAX_PARTS => return Err(FootprintError::TooMany { count }),
            _ => {}
        }
        let hulls: Result<Vec<_>, _> = parts.into_iter().enumerate().map(|(i, points)| part_of(i, points)).collect();
        let parts = without_contained(&hulls?);
        let corners = || parts.iter().flatten();
        let low = corners().fold(f64::INFINITY, |a, p| a.min(p.x));
        let high = corners().fold(f64::NEG_INFINITY, |a, p| a.max(p.x));
        let side = corners().fold(0.0, |a: f64, p| a.max(p.y.abs()));
        Ok(Self {
            length: as_written(high - low),
            width: as_written(2.0 * side),
            rear_axle_to_centre: as_written(f64::midpoint(low, high)),
            parts,
        })
    }

    /// The parts: corners counter-clockwise, in the rear-axle frame, m.
    #[must_use]
    pub fn parts(&self) -> &[Vec<Point>] {
        &self.parts
    }

    /// Length of the bounding rectangle, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Width of the bounding rectangle, m: twice the largest distance of a corner from the vehicle's longitudinal axis.
    #[must_use]
    pub fn width(&self) -> f64 {
        self.width
    }

    /// Distance from the rear axle forward to the middle of the bounding rectangle, m.
    #[must_use]
    pub fn rear_axle_to_centre(&self) -> f64 {
        self.rear_axle_to_centre
    }

    /// The bounding rectangle, symmetric about the longitudinal axis: corners counter-clockwise from rear right, in the
    /// rear-axle frame, m.
    #[must_use]
    pub fn bounding_rectangle(&self) -> [Point; 4] {
        rectangle_corners(self.length, self.width, self.rear_axle_to_centre)
    }

    /// Whether the footprint is its bounding rectangle.
    #[must_use]
    pub fn is_rectangle(&self) -> bool {
        let rectangle = self.bounding_rectangle();
        let is_equal = |part: &[Point]| {
            part.len() == 4
                && part.iter().zip(&rectangle).all(|(a, b)| (a.x - b.x).abs() < SAME && (a.y - b.y).abs() < SAME)
        };
        matches!(self.parts.as_slice(), [part] if is_equal(part))
    }

    /// Largest distance of a corner from the rear axle, m.
    #[must_use]
    pub fn reach(&self) -> f64 {
        self.parts.iter().flatten().fold(0.0, |r: f64, p| r.max(p.coords.norm()))
    }
}

fn rectangle_corners(length: f64, width: f64, rear_axle_to_centre: f64) -> [Point; 4] {
    let (front, rear) = (rear_axle_to_centre + 0.5 * length, rear_axle_to_centre - 0.5 * length);
    let half = 0.5 * width;
    [Point::new(rear, -half), Point::new(front, -half), Point::new(front, half), Point::new(rear, half)]
}

/// Rounds to a picometre, so that a single box has exactly its written sizes and not a difference of corners.
fn as_written(length: f64) -> f64 {
    (length * 1e12).round() / 1e12
}

/// The hull of a part's points, checked and simplified.
fn part_of(part: usize, points: Vec<Point>) -> Result<Vec<Point>, FootprintError> {
    if !points.iter().all(|p| p.x.is_finite() && p.y.is_finite()) {
        return Err(FootprintError::NotFinite { part });
    }
    let reach = points.iter().fold(0.0, |r: f64, p| r.max(p.coords.norm()));
    if reach > MAX_REACH {
        return Err(FootprintError::TooFar { part, reach });
    }
    let hull = convex_hull(points);
    if hull.len() < 3 || area(&hull) < SMALLEST_AREA {
        return Err(FootprintError::Flat { part });
    }
    Ok(simplified(hull))
}

/// Convex hull, counter-clockwise from the lowest x, by Andrew's monotone chain. Two corners if all points are collinear.
fn convex_hull(mut points: Vec<Point>) -> Vec<Point> {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let chain = |points: &mut dyn Iterator<Item = &Point>| {
        let mut chain: Vec<Point> = Vec::new();
        for p in points {
            while let [.., a, b] = chain.as_slice()
                && cross(b - a, p - b) <= 0.0
            {
                chain.pop();
            }
            chain.push(*p);
        }
        // the other chain begins with this one's last point
        chain.pop();
        chain
    };
    let mut hull = chain(&mut points.iter());
    hull.extend(chain(&mut points.iter().rev()));
    hull
}

fn area(polygon: &[Point]) -> f64 {
    let Some(first) = polygon.first() else { return 0.0 };
    polygon.windows(2).map(|w| 0.5 * cross(w[0] - first, w[1] - first)).sum()
}

/// A convex polygon that contains a convex polygon (counter-clockwise) and has at most [`MAX_CORNERS`] corners.
fn simplified(mut polygon: Vec<Point>) -> Vec<Point> {
    /// A polygon with more corners is first replaced by tangents at this many equal angles: 0.008 % of the radius larger.
    const MANY: usize = 256;
    if polygon.len() > MANY {
        polygon = circumscribed(&polygon, MANY);
    }
    while polygon.len() > MAX_CORNERS {
        let n = polygon.len();
        let at = |i: usize| polygon[i % n];
        // without the edge from corner i to the next one
        let best = (0..n)
            .filter_map(|i| {
                let (a, b, c, d) = (at(i + n - 1), at(i), at(i + 1), at(i + 2));
                let corner = intersection(a, b - a, c, d - c)?;
                Some((i, corner, cross(corner - b, c - b).abs()))
            })
            .min_by(|(_, _, a), (_, _, b)| a.total_cmp(b));
        // with more than four corners, the neighbours of some edge turn by less than half a circle in total
        let Some((i, corner, _)) = best else { break };
        polygon[i] = corner;
        polygon.remove((i + 1) % n);
    }
    polygon
}

/// Intersection of the ray that extends the edge from `a` to `a + edge` with the line through `c` in direction `other`.
/// `None` if there is none in front.
fn intersection(a: Point, edge: crate::geometry::Vector, c: Point, other: crate::geometry::Vector) -> Option<Point> {
    let turn = cross(edge, other);
    let ratio = cross(c - a, other) / turn;
    (turn > 0.0 && ratio.is_finite() && ratio >= 1.0).then(|| a + edge * ratio)
}

/// The polygon of `n` tangents to the points at equal angles.
fn circumscribed(points: &[Point], n: usize) -> Vec<Point> {
    let tangent = |i: usize| {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / n as f64).sin_cos();
        let normal = crate::geometry::Vector::new(cos, sin);
        let support = points.iter().map(|p| p.coords.dot(&normal)).fold(f64::NEG_INFINITY, f64::max);
        (normal, support)
    };
    let tangents: Vec<_> = (0..n).map(tangent).collect();
    let corners = (0..n).map(|i| {
        let ((a, p), (b, q)) = (tangents[i], tangents[(i + 1) % n]);
        let turn = cross(a, b);
        Point::new((p * b.y - q * a.y) / turn, (q * a.x - p * b.x) / turn)
    });
    // a tangent that touches one corner has no length except for rounding: the hull removes it
    convex_hull(corners.collect())
}

/// The parts that are not inside another one; of equal parts the first.
fn without_contained(parts: &[Vec<Point>]) -> Vec<Vec<Point>> {
    let within = |inner: &[Point], outer: &[Point]| inner.iter().all(|p| depth(outer, *p) >= -SAME);
    let is_kept = |i: usize| {
        !(0..parts.len()).any(|j| {
            let is_inside = j != i && within(&parts[i], &parts[j]);
            is_inside && (j < i || !within(&parts[j], &parts[i]))
        })
    };
    (0..parts.len()).filter(|i| is_kept(*i)).map(|i| parts[i].clone()).collect()
}

/// Depth of a point in a convex counter-clockwise polygon, m; negative outside.
fn depth(polygon: &[Point], p: Point) -> f64 {
    let edges = polygon.iter().zip(polygon.iter().cycle().skip(1));
    edges.map(|(a, b)| cross(b - a, p - a) / (b - a).norm()).fold(f64::INFINITY, f64::min)
}

/// The corners of a regular polygon around a disc, with sides parallel to the axes: as wide and as long as the disc, its
/// corners 2 % beyond the radius (1/cos(π/16)).
pub(super) fn around_disc(centre: Point, radius: f64) -> [Point; MAX_CORNERS] {
    let half_step = std::f64::consts::PI / MAX_CORNERS as f64;
    std::array::from_fn(|i| {
        let (sin, cos) = (half_step * (2 * i + 1) as f64).sin_cos();
        centre + crate::geometry::Vector::new(cos, sin) * (radius / half_step.cos())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points(n: std::ops::Range<usize>) -> impl Strategy<Value = Vec<Point>> {
        prop::collection::vec((-5.0..5.0f64, -5.0..5.0f64), n)
            .prop_map(|v| v.into_iter().map(|(x, y)| Point::new(x, y)).collect())
    }

    fn boxed(x: (f64, f64), y: (f64, f64)) -> Vec<Point> {
        [(x.0, y.0), (x.1, y.0), (x.1, y.1), (x.0, y.1)].map(|(x, y)| Point::new(x, y)).to_vec()
    }

    #[test]
    fn one_box_keeps_its_exact_sizes() {
        let (length, width, centre) = (4.508, 1.61, 1.422_717_093_6);
        let given = Footprint::rectangle(length, width, centre);
        let read = Footprint::new(vec![rectangle_corners(length, width, centre).to_vec()]).unwrap();
        assert_eq!(given, read);
        assert_eq!((read.length(), read.width(), read.rear_axle_to_centre()), (length, width, centre));
        assert!(read.is_rectangle());
        assert_eq!(read.parts()[0], read.bounding_rectangle());
    }

    #[test]
    fn a_footprint_of_another_shape_has_a_bounding_rectangle() {
        let narrow_and_wide = vec![boxed((2.0, 4.0), (-1.0, 1.0)), boxed((-1.0, 2.0), (-1.2, 1.2))];
        let f = Footprint::new(narrow_and_wide).unwrap();
        assert!(!f.is_rectangle() && f.parts().len() == 2);
        assert_eq!((f.length(), f.width(), f.rear_axle_to_centre()), (5.0, 2.4, 1.5));
        assert!((f.reach() - 17f64.sqrt()).abs() < 1e-12);
        let off_centre = Footprint::new(vec![boxed((-1.0, 2.0), (-0.5, 1.0))]).unwrap();
        assert!(!off_centre.is_rectangle());
        assert_eq!(off_centre.width(), 2.0);
    }

    #[test]
    fn drops_parts_inside_others_and_keeps_the_first_of_equal_parts() {
        let (body, cabin) = (boxed((-1.0, 4.0), (-1.0, 1.0)), boxed((0.0, 2.0), (-1.0, 0.9)));
        for parts in [vec![body.clone(), cabin.clone()], vec![cabin, body.clone()], vec![body.clone(), body.clone()]] {
            assert_eq!(Footprint::new(parts).unwrap().parts(), std::slice::from_ref(&body));
        }
    }

    #[test]
    fn refuses_invalid_footprints() {
        let good = boxed((-1.0, 1.0), (-1.0, 1.0));
        let line = vec![Point::new(0.0, 0.0), Point::new(1.0, 1.0), Point::new(3.0, 3.0)];
        assert_eq!(Footprint::new(vec![]), Err(FootprintError::Empty));
        assert_eq!(Footprint::new(vec![good.clone(), line]), Err(FootprintError::Flat { part: 1 }));
        assert_eq!(Footprint::new(vec![vec![]]), Err(FootprintError::Flat { part: 0 }));
        let many = Footprint::new(vec![good.clone(); MAX_PARTS + 1]);
        assert_eq!(many, Err(FootprintError::TooMany { count: MAX_PARTS + 1 }));
        let broken = vec![Point::new(f64::NAN, 0.0); 3];
        assert_eq!(Footprint::new(vec![broken]), Err(FootprintError::NotFinite { part: 0 }));
        let far = boxed((-1.0, 1.0), (49.0, 51.0));
        assert!(matches!(Footprint::new(vec![good, far]), Err(FootprintError::TooFar { part: 1, .. })));
    }

    #[test]
    fn the_polygon_around_a_disc_is_two_percent_larger() {
        let corners = around_disc(Point::new(1.0, -2.0), 0.5).to_vec();
        for i in 0..1000 {
            let angle = f64::from(i) * 0.00628319;
            let rim = Point::new(1.0 + 0.5 * angle.cos(), -2.0 + 0.5 * angle.sin());
            assert!(depth(&corners, rim) > -1e-12);
        }
        let far = corners.iter().map(|p| (p - Point::new(1.0, -2.0)).norm()).fold(0.0, f64::max);
        assert!((far / 0.5 - 1.0196).abs() < 1e-4, "{far}");
        let f = Footprint::new(vec![corners]).unwrap();
        assert!((f.length() - 1.0).abs() < 1e-11 && (f.rear_axle_to_centre() - 1.0).abs() < 1e-11);
    }

    #[test]
    fn simplifies_a_detailed_outline_outwards_within_two_percent() {
        for n in [17, 40, 300, 20_000] {
            let outline: Vec<Point> = (0..n)
                .map(|i| std::f64::consts::TAU * f64::from(i) / f64::from(n))
                .map(|a| Point::new(2.0 * a.cos(), 0.9 * a.sin()))
                .collect();
            let f = Footprint::new(vec![outline.clone()]).unwrap();
            let part = &f.parts()[0];
            assert!(part.len() <= MAX_CORNERS);
            assert!(outline.iter().all(|p| depth(part, *p) > -1e-9), "{n} corners: a point is outside");
            let exact = std::f64::consts::PI * 2.0 * 0.9;
            assert!(area(part) < 1.03 * exact, "{n} corners: {} m², exactly {exact} m²", area(part));
        }
    }

    proptest! {
        #[test]
        fn hulls_contain_their_points_turn_left_and_have_few_corners(p in points(3..60)) {
            prop_assume!(area(&convex_hull(p.clone())) > 1e-3);
            let f = Footprint::new(vec![p.clone()]).unwrap();
            let part = &f.parts()[0];
            prop_assert!(part.len() >= 3 && part.len() <= MAX_CORNERS);
            prop_assert!(p.iter().all(|p| depth(part, *p) > -1e-9));
            let n = part.len();
            for i in 0..n {
                let (a, b, c) = (part[i], part[(i + 1) % n], part[(i + 2) % n]);
                prop_assert!(cross(b - a, c - b) > -1e-12, "a turn to the right at {b}");
            }
            let rectangle = f.bounding_rectangle();
            prop_assert!(part.iter().all(|p| depth(&rectangle, *p) > -1e-9));
        }
    }
}
