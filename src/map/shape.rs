//! Obstacle and goal shapes: rectangles, circles, polygons and groups of them.

use crate::geometry::{Point, Pose, Vector, cross};

/// A union of parts, in a local frame (obstacles) or in world coordinates (goals, set-based predictions).
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// At least one part.
    pub parts: Vec<Part>,
}

/// One part of a shape.
#[derive(Debug, Clone, PartialEq)]
pub enum Part {
    /// A rectangle. Its length is in the direction of its x axis.
    Rectangle {
        /// Centre and orientation.
        centre: Pose,
        /// Full length, m.
        length: f64,
        /// Full width, m.
        width: f64,
    },
    /// A circle.
    Circle {
        /// Centre.
        centre: Point,
        /// Radius, m.
        radius: f64,
    },
    /// A simple polygon, not closed, of either orientation, possibly concave.
    Polygon {
        /// At least three vertices.
        vertices: Vec<Point>,
    },
}

impl Part {
    /// Its centre; of a polygon, the mean of its vertices.
    #[must_use]
    pub fn middle(&self) -> Point {
        match self {
            Self::Rectangle { centre, .. } => centre.position,
            Self::Circle { centre, .. } => *centre,
            Self::Polygon { vertices } => {
                let sum = vertices.iter().fold(Vector::zeros(), |sum, p| sum + p.coords);
                Point::from(sum / vertices.len().max(1) as f64)
            }
        }
    }
}

/// A convex piece for collision queries.
#[derive(Debug, Clone, PartialEq)]
pub enum ConvexPart {
    /// Counter-clockwise convex polygon.
    Polygon(Vec<Point>),
    /// A circle.
    Circle {
        /// Centre.
        centre: Point,
        /// Radius, m.
        radius: f64,
    },
}

impl Shape {
    /// A rectangle centred on the origin of its frame.
    #[must_use]
    pub fn rectangle(length: f64, width: f64) -> Self {
        Self { parts: vec![Part::Rectangle { centre: Pose::new(0.0, 0.0, 0.0), length, width }] }
    }

    /// Whether the point (in the shape's frame) is inside any part. The border is inside, up to rounding.
    #[must_use]
    pub fn contains(&self, p: Point) -> bool {
        self.parts.iter().any(|part| match part {
            Part::Rectangle { centre, length, width } => {
                let local = centre.to_local(p);
                local.x.abs() <= 0.5 * length && local.y.abs() <= 0.5 * width
            }
            Part::Circle { centre, radius } => (p - centre).norm() <= *radius,
            Part::Polygon { vertices } => polygon_contains(vertices, p),
        })
    }

    /// The shape as convex pieces. Concave polygons are cut into triangles (ear clipping).
    #[must_use]
    pub fn convex_parts(&self) -> Vec<ConvexPart> {
        let mut pieces = Vec::new();
        for part in &self.parts {
            match part {
                Part::Rectangle { centre, length, width } => {
                    let (l, w) = (0.5 * length, 0.5 * width);
                    let corners = [(-l, -w), (l, -w), (l, w), (-l, w)];
                    pieces.push(ConvexPart::Polygon(
                        corners.iter().map(|&(x, y)| centre.to_world(Point::new(x, y))).collect(),
                    ));
                }
                Part::Circle { centre, radius } => {
                    pieces.push(ConvexPart::Circle { centre: *centre, radius: *radius });
                }
                Part::Polygon { vertices } => {
                    pieces.extend(convex_pieces(vertices).into_iter().map(ConvexPart::Polygon));
                }
            }
        }
        pieces
    }

    /// The shape transformed from the local frame of a pose into the world.
    #[must_use]
    pub fn moved(&self, pose: &Pose) -> Self {
        let moved = |part: &Part| match part {
            Part::Rectangle { centre, length, width } => Part::Rectangle {
                centre: Pose { position: pose.to_world(centre.position), yaw: pose.yaw + centre.yaw },
                length: *length,
                width: *width,
            },
            Part::Circle { centre, radius } => Part::Circle { centre: pose.to_world(*centre), radius: *radius },
            Part::Polygon { vertices } => {
                Part::Polygon { vertices: vertices.iter().map(|v| pose.to_world(*v)).collect() }
            }
        };
        Self { parts: self.parts.iter().map(moved).collect() }
    }

    /// Radius of a circle around the frame's origin that contains the shape, m.
    #[must_use]
    pub fn bounding_radius(&self) -> f64 {
        self.convex_parts().iter().fold(0.0, |r, part| r.max(part.bounding_radius()))
    }
}

impl ConvexPart {
    /// The piece transformed from the local frame of a pose into the world.
    #[must_use]
    pub fn at(&self, pose: &Pose) -> Self {
        match self {
            Self::Polygon(points) => Self::Polygon(points.iter().map(|p| pose.to_world(*p)).collect()),
            Self::Circle { centre, radius } => Self::Circle { centre: pose.to_world(*centre), radius: *radius },
        }
    }

    /// Radius of a circle around the frame's origin that contains the piece, m.
    #[must_use]
    pub fn bounding_radius(&self) -> f64 {
        match self {
            Self::Polygon(points) => points.iter().fold(0.0, |r, p| r.max(p.coords.norm())),
            Self::Circle { centre, radius } => centre.coords.norm() + radius,
        }
    }
}

/// Twice the signed area, positive for counter-clockwise polygons.
fn doubled_area(polygon: &[Point]) -> f64 {
    let Some(&origin) = polygon.first() else { return 0.0 };
    polygon.windows(2).map(|w| cross(w[0] - origin, w[1] - origin)).sum()
}

/// Even–odd point-in-polygon test (crossing number), exact for points off the border.
#[must_use]
pub(crate) fn polygon_contains(polygon: &[Point], p: Point) -> bool {
    let mut inside = false;
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        if (a.y > p.y) != (b.y > p.y) && p.x - a.x < (b.x - a.x) * (p.y - a.y) / (b.y - a.y) {
            inside = !inside;
        }
    }
    inside
}

/// Cuts a simple polygon into counter-clockwise convex pieces: itself if convex, else triangles by ear clipping. A polygon
/// that intersects itself has no ears left at some point: the convex hull of the remainder is the last piece, so that the
/// pieces contain the polygon.
fn convex_pieces(polygon: &[Point]) -> Vec<Vec<Point>> {
    let mut ring: Vec<Point> = polygon.to_vec();
    ring.dedup_by(|a, b| (*a - *b).norm() < 1e-9);
    if ring.len() > 1 && (ring[0] - ring[ring.len() - 1]).norm() < 1e-9 {
        ring.pop();
    }
    if doubled_area(&ring) < 0.0 {
        ring.reverse();
    }
    let turn = |a: Point, b: Point, c: Point| cross(b - a, c - b);
    let is_convex = |r: &[Point]| (0..r.len()).all(|i| turn(r[i], r[(i + 1) % r.len()], r[(i + 2) % r.len()]) >= 0.0);
    let mut pieces = Vec::new();
    while ring.len() > 3 && !is_convex(&ring) {
        let n = ring.len();
        let ear = (0..n).find(|&i| {
            let (a, b, c) = (ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]);
            let others = (0..n).filter(|&j| j != i && j != (i + n - 1) % n && j != (i + 1) % n);
            turn(a, b, c) > 0.0 && !others.clone().any(|j| triangle_contains([a, b, c], ring[j]))
        });
        let Some(i) = ear else { break };
        pieces.push(vec![ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]]);
        ring.remove(i);
    }
    if ring.len() >= 3 {
        let hull = if is_convex(&ring) { ring } else { convex_hull(&ring) };
        if hull.len() >= 3 {
            pieces.push(hull);
        }
    }
    pieces
}

fn triangle_contains(t: [Point; 3], p: Point) -> bool {
    (0..3).all(|i| cross(t[(i + 1) % 3] - t[i], p - t[i]) >= 0.0)
}

/// Convex hull, counter-clockwise, by Andrew's monotone chain. Collinear points are dropped.
#[must_use]
pub(crate) fn convex_hull(points: &[Point]) -> Vec<Point> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    sorted.dedup();
    if sorted.len() < 3 {
        return sorted;
    }
    let mut hull: Vec<Point> = Vec::with_capacity(2 * sorted.len());
    let half = |hull: &mut Vec<Point>, p: Point, base: usize| {
        while hull.len() >= base + 2 {
            let (a, b): (Point, Point) = (hull[hull.len() - 2], hull[hull.len() - 1]);
            let outward: Vector = p - b;
            if cross(b - a, outward) > 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(p);
    };
    for &p in &sorted {
        half(&mut hull, p, 0);
    }
    let lower = hull.len() - 1;
    for &p in sorted.iter().rev().skip(1) {
        half(&mut hull, p, lower);
    }
    hull.pop();
    hull
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn area(pieces: &[Vec<Point>]) -> f64 {
        pieces
            .iter()
            .map(|p| {
                let o = p[0];
                0.5 * p.windows(2).map(|w| cross(w[0] - o, w[1] - o)).sum::<f64>()
            })
            .sum()
    }

    #[test]
    fn cuts_a_concave_polygon_into_pieces_of_the_same_area() {
        let l: Vec<Point> = [(0., 0.), (4., 0.), (4., 1.), (1., 1.), (1., 3.), (0., 3.)]
            .iter()
            .map(|&(x, y)| Point::new(x, y))
            .collect();
        let pieces = convex_pieces(&l);
        assert!(pieces.len() > 1);
        assert!((area(&pieces) - 6.0).abs() < 1e-12);
        let clockwise: Vec<Point> = l.iter().rev().copied().collect();
        assert!((area(&convex_pieces(&clockwise)) - 6.0).abs() < 1e-12);
    }

    #[test]
    fn a_rotated_rectangle_contains_its_corner() {
        let s = Shape {
            parts: vec![Part::Rectangle {
                centre: Pose::new(10.0, 0.0, std::f64::consts::FRAC_PI_2),
                length: 4.0,
                width: 2.0,
            }],
        };
        assert!(s.contains(Point::new(10.9, 1.9)));
        assert!(!s.contains(Point::new(11.9, 0.9)));
    }

    proptest! {
        #[test]
        fn the_hull_contains_every_point(points in prop::collection::vec((-10.0..10.0f64, -10.0..10.0f64), 3..40)) {
            let points: Vec<Point> = points.into_iter().map(|(x, y)| Point::new(x, y)).collect();
            let hull = convex_hull(&points);
            for p in &points {
                for i in 0..hull.len() {
                    let (a, b) = (hull[i], hull[(i + 1) % hull.len()]);
                    prop_assert!(cross(b - a, p - a) > -1e-9, "{p} outside hull edge {a} {b}");
                }
            }
        }
    }
}
