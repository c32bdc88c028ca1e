//! What the vehicle covers on the ground: convex polygons in the rear-axle frame.
//!
//! # Technique
//! Each part is the convex hull of its points (Andrew's monotone chain). The parts together are the footprint: between
//! them there is room, as between the cab and the box of a truck where the cab is narrower. A part within another one
//! is dropped (a cabin above the body it stands on covers nothing more). Parts with more than [`MOST_CORNERS`] corners
//! are made simpler outwards: an edge is taken away and its neighbours extended until they meet, the one that adds least
//! area first, so that the result always contains the part.
//!
//! # Weakness
//! The footprint is rigid and flat: heights are not looked at, and what turns or swings on the vehicle (steered wheels,
//! a trailer on its hitch) is not in it.

use crate::geometry::{Point, cross};

/// Corners of a part at most: collision checks cost in proportion to them, and 16 stay within 2 % of a circle's radius.
pub const MOST_CORNERS: usize = 16;
/// Parts at most: a footprint of more is a drawing, not an outline.
pub const MOST_PARTS: usize = 32;
/// Largest distance of a corner from the rear axle, m: no road vehicle is longer, but meshes in millimetres are.
pub const LARGEST_REACH: f64 = 50.0;
/// Smallest area of a part, m²: less is a line.
const SMALLEST_AREA: f64 = 1e-6;
/// Corners nearer than this are the same when footprints are compared, m: far below what a collision check resolves.
const SAME: f64 = 1e-9;

/// One or more convex polygons that move with the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Footprint {
    parts: Vec<Vec<Point>>,
    length: f64,
    width: f64,
    rear_axle_to_centre: f64,
}

/// Why points make no footprint.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FootprintError {
    /// There is no part.
    #[error("no parts")]
    Empty,
    /// More parts than [`MOST_PARTS`].
    #[error("{count} parts, {MOST_PARTS} at most are understood")]
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
    /// No area: all points of the part lie on a line.
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
    /// Index of the part that is wrong, if it is one.
    #[must_use]
    pub fn part(&self) -> Option<usize> {
        match self {
            Self::Empty | Self::TooMany { .. } => None,
            Self::NotFinite { part } | Self::Flat { part } | Self::TooFar { part, .. } => Some(*part),
        }
    }
}

impl Footprint {
    /// One rectangle (m), its middle `rear_axle_to_centre` metres before the rear axle. Nothing is checked.
    #[must_use]
    pub fn rectangle(length: f64, width: f64, rear_axle_to_centre: f64) -> Self {
        let corners = rectangle_corners(length, width, rear_axle_to_centre);
        Self { parts: vec![corners.to_vec()], length, width, rear_axle_to_centre }
    }

    /// The convex hulls of the given sets of points (m, rear-axle frame), in their order, those within others left out.
    ///
    /// # Errors
    /// No parts or too many, a number that is not finite, a part without area or too far away.
    pub fn new(parts: Vec<Vec<Point>>) -> Result<Self, FootprintError> {
        match parts.len() {
            0 => return Err(FootprintError::Empty),
            count if count > MOST_PARTS => return Err(FootprintError::TooMany { count }),
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

    /// Width of the bounding rectangle, m: twice the distance of the outermost corner from the vehicle's middle line.
    #[must_use]
    pub fn width(&self) -> f64 {
        self.width
    }

    /// Distance from the rear axle forward to the middle of the bounding rectangle, m.
    #[must_use]
    pub fn rear_axle_to_centre(&self) -> f64 {
        self.rear_axle_to_centre
    }

    /// The rectangle around all parts, as wide to the left as to the right: corners counter-clockwise from rear right, in
    /// the rear-axle frame, m.
    #[must_use]
    pub fn bounding_rectangle(&self) -> [Point; 4] {
        rectangle_corners(self.length, self.width, self.rear_axle_to_centre)
    }

    /// Whether the bounding rectangle is the footprint, not just around it.
    #[must_use]
    pub fn is_rectangle(&self) -> bool {
        let rectangle = self.bounding_rectangle();
        let is_it = |part: &[Point]| {
            part.len() == 4
                && part.iter().zip(&rectangle).all(|(a, b)| (a.x - b.x).abs() < SAME && (a.y - b.y).abs() < SAME)
        };
        matches!(self.parts.as_slice(), [part] if is_it(part))
    }

    /// Distance of the outermost corner from the rear axle, m.
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

/// Rounded to a picometre: the sizes of a single box come back as they were written, not as a difference of corners.
fn as_written(length: f64) -> f64 {
    (length * 1e12).round() / 1e12
}

/// The hull of a part's points, checked and not too detailed.
fn part_of(part: usize, points: Vec<Point>) -> Result<Vec<Point>, FootprintError> {
    if !points.iter().all(|p| p.x.is_finite() && p.y.is_finite()) {
        return Err(FootprintError::NotFinite { part });
    }
    let reach = points.iter().fold(0.0, |r: f64, p| r.max(p.coords.norm()));
    if reach > LARGEST_REACH {
        return Err(FootprintError::TooFar { part, reach });
    }
    let hull = convex_hull(points);
    if hull.len() < 3 || area(&hull) < SMALLEST_AREA {
        return Err(FootprintError::Flat { part });
    }
    Ok(simpler(hull))
}

/// Convex hull, counter-clockwise from the lowest x, by Andrew's monotone chain. Collinear points leave two.
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

/// A convex polygon around a convex polygon (counter-clockwise), with [`MOST_CORNERS`] corners at most.
fn simpler(mut polygon: Vec<Point>) -> Vec<Point> {
    /// More corners than this are first circumscribed by as many equal angles: 0.008 % of the radius.
    const MANY: usize = 256;
    if polygon.len() > MANY {
        polygon = circumscribed(&polygon, MANY);
    }
    while polygon.len() > MOST_CORNERS {
        let n = polygon.len();
        let at = |i: usize| polygon[i % n];
        // taking away the edge from corner i to the next one
        let best = (0..n)
            .filter_map(|i| {
                let (a, b, c, d) = (at(i + n - 1), at(i), at(i + 1), at(i + 2));
                let meet = meeting(a, b - a, c, d - c)?;
                Some((i, meet, cross(meet - b, c - b).abs()))
            })
            .min_by(|(_, _, a), (_, _, b)| a.total_cmp(b));
        // with more than four corners some neighbours turn by less than half a circle together
        let Some((i, meet, _)) = best else { break };
        polygon[i] = meet;
        polygon.remove((i + 1) % n);
    }
    polygon
}

/// Where the ray from `b = a + along` on meets the line through `c`; `None` when it never does ahead.
fn meeting(a: Point, along: crate::geometry::Vector, c: Point, other: crate::geometry::Vector) -> Option<Point> {
    let turn = cross(along, other);
    let far = cross(c - a, other) / turn;
    (turn > 0.0 && far.is_finite() && far >= 1.0).then(|| a + along * far)
}

/// The polygon of `n` tangents at equal angles around points.
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
    // a tangent that only touches a corner has no length, but for rounding: the hull tidies up
    convex_hull(corners.collect())
}

/// The parts that lie in no other one; of equal ones the first.
fn without_contained(parts: &[Vec<Point>]) -> Vec<Vec<Point>> {
    let within = |inner: &[Point], outer: &[Point]| inner.iter().all(|p| depth(outer, *p) >= -SAME);
    let stays = |i: usize| {
        !(0..parts.len()).any(|j| {
            let is_in = j != i && within(&parts[i], &parts[j]);
            is_in && (j < i || !within(&parts[j], &parts[i]))
        })
    };
    (0..parts.len()).filter(|i| stays(*i)).map(|i| parts[i].clone()).collect()
}

/// Depth of a point in a convex counter-clockwise polygon, m; negative outside.
fn depth(polygon: &[Point], p: Point) -> f64 {
    let edges = polygon.iter().zip(polygon.iter().cycle().skip(1));
    edges.map(|(a, b)| cross(b - a, p - a) / (b - a).norm()).fold(f64::INFINITY, f64::min)
}

/// The corners of a regular polygon around a disc, its first and every fourth side parallel to the axes: as wide and as
/// long as the disc, at its corners 2 % larger than the radius (1/cos(π/16)).
pub(super) fn around_disc(centre: Point, radius: f64) -> [Point; MOST_CORNERS] {
    let half_step = std::f64::consts::PI / MOST_CORNERS as f64;
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
    fn the_sizes_of_one_box_come_back_as_written() {
        let (length, width, centre) = (4.508, 1.61, 1.422_717_093_6);
        let given = Footprint::rectangle(length, width, centre);
        let read = Footprint::new(vec![rectangle_corners(length, width, centre).to_vec()]).unwrap();
        assert_eq!(given, read);
        assert_eq!((read.length(), read.width(), read.rear_axle_to_centre()), (length, width, centre));
        assert!(read.is_rectangle());
        assert_eq!(read.parts()[0], read.bounding_rectangle());
    }

    #[test]
    fn parts_of_other_kinds_are_no_rectangle_but_have_one_around_them() {
        let narrow_and_wide = vec![boxed((2.0, 4.0), (-1.0, 1.0)), boxed((-1.0, 2.0), (-1.2, 1.2))];
        let f = Footprint::new(narrow_and_wide).unwrap();
        assert!(!f.is_rectangle() && f.parts().len() == 2);
        assert_eq!((f.length(), f.width(), f.rear_axle_to_centre()), (5.0, 2.4, 1.5));
        assert!((f.reach() - 17f64.sqrt()).abs() < 1e-12);
        let off_the_middle = Footprint::new(vec![boxed((-1.0, 2.0), (-0.5, 1.0))]).unwrap();
        assert!(!off_the_middle.is_rectangle());
        assert_eq!(off_the_middle.width(), 2.0);
    }

    #[test]
    fn parts_within_others_are_dropped_and_of_equal_ones_the_first_stays() {
        let (body, cabin) = (boxed((-1.0, 4.0), (-1.0, 1.0)), boxed((0.0, 2.0), (-1.0, 0.9)));
        for parts in [vec![body.clone(), cabin.clone()], vec![cabin, body.clone()], vec![body.clone(), body.clone()]] {
            assert_eq!(Footprint::new(parts).unwrap().parts(), std::slice::from_ref(&body));
        }
    }

    #[test]
    fn what_is_no_footprint_is_told_apart() {
        let good = boxed((-1.0, 1.0), (-1.0, 1.0));
        let line = vec![Point::new(0.0, 0.0), Point::new(1.0, 1.0), Point::new(3.0, 3.0)];
        assert_eq!(Footprint::new(vec![]), Err(FootprintError::Empty));
        assert_eq!(Footprint::new(vec![good.clone(), line]), Err(FootprintError::Flat { part: 1 }));
        assert_eq!(Footprint::new(vec![vec![]]), Err(FootprintError::Flat { part: 0 }));
        let many = Footprint::new(vec![good.clone(); MOST_PARTS + 1]);
        assert_eq!(many, Err(FootprintError::TooMany { count: MOST_PARTS + 1 }));
        let broken = vec![Point::new(f64::NAN, 0.0); 3];
        assert_eq!(Footprint::new(vec![broken]), Err(FootprintError::NotFinite { part: 0 }));
        let far = boxed((-1.0, 1.0), (49.0, 51.0));
        assert!(matches!(Footprint::new(vec![good, far]), Err(FootprintError::TooFar { part: 1, .. })));
    }

    #[test]
    fn the_polygon_around_a_disc_holds_it_and_is_two_percent_larger() {
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
    fn a_finely_drawn_outline_is_simplified_outwards_within_two_percent() {
        for n in [17, 40, 300, 20_000] {
            let drawn: Vec<Point> = (0..n)
                .map(|i| std::f64::consts::TAU * f64::from(i) / f64::from(n))
                .map(|a| Point::new(2.0 * a.cos(), 0.9 * a.sin()))
                .collect();
            let f = Footprint::new(vec![drawn.clone()]).unwrap();
            let part = &f.parts()[0];
            assert!(part.len() <= MOST_CORNERS);
            assert!(drawn.iter().all(|p| depth(part, *p) > -1e-9), "{n} corners: something is cut off");
            let exact = std::f64::consts::PI * 2.0 * 0.9;
            assert!(area(part) < 1.03 * exact, "{n} corners: {} m² in place of {exact} m²", area(part));
        }
    }

    proptest! {
        #[test]
        fn hulls_hold_their_points_turn_left_and_have_few_corners(p in points(3..60)) {
            prop_assume!(area(&convex_hull(p.clone())) > 1e-3);
            let f = Footprint::new(vec![p.clone()]).unwrap();
            let part = &f.parts()[0];
            prop_assert!(part.len() >= 3 && part.len() <= MOST_CORNERS);
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
