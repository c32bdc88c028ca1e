//! Shapes: rectangle, circle, polygon, several in one element.

use super::error::ReadError;
use super::xml::{Node, Source, child, text};
use crate::geometry::{Point, Pose, cross};
use crate::map::{Part, Shape};

/// Most vertices of one polygon: cutting a concave polygon into convex pieces takes time of a higher power of it.
const MAX_VERTICES: usize = 1000;

/// Smallest area of a polygon, m²: below it is a line.
const MIN_AREA: f64 = 1e-6;

/// The shapes among the children of an element; at least one.
pub(super) fn read(source: &Source, node: Node) -> Result<Shape, ReadError> {
    let mut parts = Vec::new();
    for child in node.children().filter(Node::is_element) {
        match child.tag_name().name() {
            "rectangle" => parts.push(rectangle(source, child)?),
            "circle" => parts.push(circle(source, child)?),
            "polygon" => parts.push(polygon(source, child)?),
            other => return Err(source.bad_value(child, other, "a rectangle, circle or polygon")),
        }
    }
    if parts.is_empty() {
        return Err(source.missing(node, "rectangle, circle or polygon"));
    }
    Ok(Shape { parts })
}

/// Whether the element holds shapes.
pub(super) fn is_region(node: Node) -> bool {
    ["rectangle", "circle", "polygon"].iter().any(|name| child(node, name).is_some())
}

fn rectangle(source: &Source, node: Node) -> Result<Part, ReadError> {
    let yaw = child(node, "orientation").map_or(Ok(0.0), |n| source.number(n))?;
    Ok(Part::Rectangle {
        centre: Pose { position: centre(source, node)?, yaw },
        length: source.positive(source.child(node, "length")?)?,
        width: source.positive(source.child(node, "width")?)?,
    })
}

fn circle(source: &Source, node: Node) -> Result<Part, ReadError> {
    Ok(Part::Circle { centre: centre(source, node)?, radius: source.positive(source.child(node, "radius")?)? })
}

/// The centre of a rectangle or circle, the origin when it is not given.
fn centre(source: &Source, node: Node) -> Result<Point, ReadError> {
    child(node, "center").map_or(Ok(Point::origin()), |n| source.point(n))
}

fn polygon(source: &Source, node: Node) -> Result<Part, ReadError> {
    let mut vertices = source.points(node)?;
    vertices.dedup();
    if vertices.len() > 1 && vertices.first() == vertices.last() {
        vertices.pop();
    }
    let found = vertices.len();
    if found > MAX_VERTICES {
        return Err(ReadError::BadPoints { place: source.place(node), found, expected: "at most 1000" });
    }
    if found < 3 || area(&vertices) < MIN_AREA {
        return Err(ReadError::BadPoints { place: source.place(node), found, expected: "at least 3 around an area" });
    }
    Ok(Part::Polygon { vertices })
}

/// Largest area of a triangle between the first vertex and two neighbours, m²: zero only if all lie on one line.
fn area(vertices: &[Point]) -> f64 {
    let Some(&origin) = vertices.first() else { return 0.0 };
    vertices.windows(2).map(|w| 0.5 * cross(w[0] - origin, w[1] - origin).abs()).fold(0.0, f64::max)
}

/// Middle of the box around the shape.
pub(super) fn middle(shape: &Shape) -> Point {
    let (mut low, mut high) = (Point::new(f64::MAX, f64::MAX), Point::new(f64::MIN, f64::MIN));
    let mut hold = |p: Point| {
        low = low.inf(&p);
        high = high.sup(&p);
    };
    for part in &shape.parts {
        match part {
            Part::Rectangle { centre, .. } if shape.parts.len() == 1 => return centre.position,
            Part::Rectangle { centre, length, width } => {
                for (x, y) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
                    hold(centre.to_world(Point::new(x * length, y * width)));
                }
            }
            Part::Circle { centre, radius } => {
                hold(Point::new(centre.x - radius, centre.y - radius));
                hold(Point::new(centre.x + radius, centre.y + radius));
            }
            Part::Polygon { vertices } => vertices.iter().for_each(|v| hold(*v)),
        }
    }
    nalgebra::center(&low, &high)
}

/// Whether turning the shape about its frame's origin changes nothing.
pub(super) fn is_round(shape: &Shape) -> bool {
    shape.parts.iter().all(|p| matches!(p, Part::Circle { centre, .. } if *centre == Point::origin()))
}

/// The trimmed text of a child, if it is there.
pub(super) fn child_text(node: Node, name: &str) -> Option<String> {
    child(node, name).map(|n| text(n).trim().to_owned())
}
