//! Shapes: rectangles, circles and polygons, one or several in an element.

use super::xml::{Node, Read, Source, all, child};
use crate::geometry::{Point, Pose, cross};
use crate::map::{Part, Shape};

/// Most vertices of a polygon: the time to cut a concave polygon into convex pieces grows with a power of their number.
const MAX_VERTICES: usize = 1000;

/// Smallest area of a polygon, m²; a smaller one is a line.
const MIN_AREA: f64 = 1e-6;

/// The shapes among the children of an element; at least one.
pub(super) fn read(source: &mut Source, node: Node) -> Read<Shape> {
    let parts = all(node.children().filter(Node::is_element).map(|child| match child.tag_name().name() {
        "rectangle" => rectangle(source, child),
        "circle" => circle(source, child),
        "polygon" => polygon(source, child),
        other => Err(source.bad_value(child, other, "a rectangle, circle or polygon")),
    }))?;
    if parts.is_empty() {
        return Err(source.missing(node, "rectangle, circle or polygon"));
    }
    Ok(Shape { parts })
}

/// Whether the element contains shapes.
pub(super) fn is_region(node: Node) -> bool {
    ["rectangle", "circle", "polygon"].iter().any(|name| child(node, name).is_some())
}

fn rectangle(source: &mut Source, node: Node) -> Read<Part> {
    let yaw = source.optional(node, "orientation", Source::number);
    let centre = centre(source, node);
    let length = source.required(node, "length", Source::positive);
    let width = source.required(node, "width", Source::positive);
    let centre = Pose { position: centre?, yaw: yaw?.unwrap_or(0.0) };
    Ok(Part::Rectangle { centre, length: length?, width: width? })
}

fn circle(source: &mut Source, node: Node) -> Read<Part> {
    let (centre, radius) = (centre(source, node), source.required(node, "radius", Source::positive));
    Ok(Part::Circle { centre: centre?, radius: radius? })
}

/// The centre of a rectangle or circle; the origin if there is none.
fn centre(source: &mut Source, node: Node) -> Read<Point> {
    Ok(source.optional(node, "center", Source::point)?.unwrap_or_else(Point::origin))
}

fn polygon(source: &mut Source, node: Node) -> Read<Part> {
    let mut vertices = source.points(node)?;
    vertices.dedup();
    if vertices.len() > 1 && vertices.first() == vertices.last() {
        vertices.pop();
    }
    let found = vertices.len();
    if found > MAX_VERTICES {
        return Err(source.bad_points(node, found, "at most 1000"));
    }
    if found < 3 || area(&vertices) < MIN_AREA {
        return Err(source.bad_points(node, found, "at least 3 around an area"));
    }
    Ok(Part::Polygon { vertices })
}

/// Largest area of a triangle between the first vertex and two neighbours, m²: zero only if all lie on one line.
fn area(vertices: &[Point]) -> f64 {
    let Some(&origin) = vertices.first() else { return 0.0 };
    vertices.windows(2).map(|w| 0.5 * cross(w[0] - origin, w[1] - origin).abs()).fold(0.0, f64::max)
}

/// Middle of the shape's bounding box.
pub(super) fn middle(shape: &Shape) -> Point {
    if let [Part::Rectangle { centre, .. }] = shape.parts.as_slice() {
        return centre.position;
    }
    let (low, high) = bounds(shape);
    nalgebra::center(&low, &high)
}

/// Diagonal of the shape's bounding box, m.
pub(super) fn extent(shape: &Shape) -> f64 {
    let (low, high) = bounds(shape);
    (high - low).norm()
}

/// Lower left and upper right corner of the shape's bounding box.
fn bounds(shape: &Shape) -> (Point, Point) {
    let (mut low, mut high) = (Point::new(f64::MAX, f64::MAX), Point::new(f64::MIN, f64::MIN));
    let mut include = |p: Point| {
        low = low.inf(&p);
        high = high.sup(&p);
    };
    for part in &shape.parts {
        match part {
            Part::Rectangle { centre, length, width } => {
                for (x, y) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
                    include(centre.to_world(Point::new(x * length, y * width)));
                }
            }
            Part::Circle { centre, radius } => {
                include(Point::new(centre.x - radius, centre.y - radius));
                include(Point::new(centre.x + radius, centre.y + radius));
            }
            Part::Polygon { vertices } => vertices.iter().for_each(|v| include(*v)),
        }
    }
    (low, high)
}

/// Whether the shape is the same in every orientation.
pub(super) fn is_round(shape: &Shape) -> bool {
    shape.parts.iter().all(|p| matches!(p, Part::Circle { centre, .. } if *centre == Point::origin()))
}
