//! Goal regions on lanes: the lanelets that lead through a goal, and the stations inside it.

use std::collections::BTreeMap;

use crate::geometry::steps::covering;
use crate::geometry::{Point, wrap_angle};
use crate::map::{ConvexPart, Goal, GoalPosition, Interval, Lanelet, LaneletId, RoadNetwork, Shape};

/// Spacing at which centre lines are sampled in a goal shape, m. Goal regions are metres long.
const SPACING: f64 = 0.25;
/// Largest difference between a lane's heading and a goal's heading interval, rad. The vehicle may be at an angle to the
/// lane; only lanes of the opposite direction must be excluded.
const HEADING_MARGIN: f64 = 0.6;

/// Stations of the centre line inside the goal, m, by lanelet.
pub(super) type GoalSpans = BTreeMap<LaneletId, Interval>;

/// The drivable lanelets that lead through any goal with a position. First choice: lanelets whose centre line passes
/// through the region in the direction of the goal; then in any direction; then lanelets that overlap the region.
pub(super) fn goal_spans(network: &RoadNetwork, goals: &[Goal]) -> GoalSpans {
    let mut spans = GoalSpans::new();
    for goal in goals {
        match &goal.position {
            Some(GoalPosition::Lanelets(ids)) => {
                for lanelet in ids.iter().filter_map(|id| network.lanelets.get(id)).filter(|l| l.is_drivable()) {
                    add(&mut spans, lanelet.id, Interval { min: 0.0, max: lanelet.centre.length() });
                }
            }
            Some(GoalPosition::Shapes(shape)) => {
                let mut inside: Vec<_> = crossing(network, shape, goal.yaw.as_ref());
                if inside.is_empty() {
                    inside = crossing(network, shape, None);
                }
                if inside.is_empty() {
                    inside = overlapping(network, shape);
                }
                for (id, span) in inside {
                    add(&mut spans, id, span);
                }
            }
            None => {}
        }
    }
    spans
}

/// Adds a span of a lanelet. Of several, the first one along the lanelet is kept, joined with those that touch it.
fn add(spans: &mut GoalSpans, id: LaneletId, span: Interval) {
    let entry = spans.entry(id).or_insert(span);
    if span.min <= entry.max && span.max >= entry.min {
        *entry = Interval { min: entry.min.min(span.min), max: entry.max.max(span.max) };
    } else if span.max < entry.min {
        *entry = span;
    }
}

/// Lanelets whose centre line passes through the shape, with the first section inside.
fn crossing(network: &RoadNetwork, shape: &Shape, yaw: Option<&Interval>) -> Vec<(LaneletId, Interval)> {
    let fits = |lanelet: &Lanelet, station: f64| {
        let Some(yaw) = yaw else { return true };
        let middle = f64::midpoint(yaw.min, yaw.max);
        let off = wrap_angle(lanelet.centre.yaw_at(station) - middle).abs();
        off <= 0.5 * (yaw.max - yaw.min) + HEADING_MARGIN
    };
    let near = bounding_box(shape);
    let lanelets = network.lanelets.values().filter(|l| l.is_drivable() && touches(&near, l));
    lanelets
        .filter_map(|lanelet| {
            let length = lanelet.centre.length();
            let steps = covering(length, SPACING);
            let stations = (0..=steps).map(|i| length * i as f64 / steps as f64);
            let inside = |s: &f64| shape.contains(lanelet.centre.at(*s)) && fits(lanelet, *s);
            let mut run = stations.skip_while(|s| !inside(s)).take_while(inside);
            let min = run.next()?;
            Some((lanelet.id, Interval { min, max: run.last().unwrap_or(min) }))
        })
        .collect()
}

/// Lanelets that contain characteristic points of the shape, with the section between their projections.
fn overlapping(network: &RoadNetwork, shape: &Shape) -> Vec<(LaneletId, Interval)> {
    let points: Vec<Point> = shape.convex_parts().iter().flat_map(characteristic_points).collect();
    let lanelets = network.lanelets.values().filter(|l| l.is_drivable());
    lanelets
        .filter_map(|lanelet| {
            let stations = points.iter().filter(|p| lanelet.contains(**p)).map(|p| lanelet.centre.project(*p).station);
            stations
                .map(|s| Interval { min: s, max: s })
                .reduce(|a, b| Interval { min: a.min.min(b.min), max: a.max.max(b.max) })
                .map(|span| (lanelet.id, span))
        })
        .collect()
}

/// The middle of a convex piece, and points at 50 % and 95 % of the distance to its corners.
fn characteristic_points(part: &ConvexPart) -> Vec<Point> {
    let (centre, rim): (Point, Vec<Point>) = match part {
        ConvexPart::Polygon(points) => {
            let sum = points.iter().fold(crate::geometry::Vector::zeros(), |a, p| a + p.coords);
            (Point::from(sum / points.len().max(1) as f64), points.clone())
        }
        ConvexPart::Circle { centre, radius } => {
            let rim = (0..8).map(|i| std::f64::consts::FRAC_PI_4 * f64::from(i));
            (*centre, rim.map(|a| centre + crate::geometry::Vector::new(a.cos(), a.sin()) * *radius).collect())
        }
    };
    let inner = rim.iter().flat_map(|p| [0.5, 0.95].map(|ratio| centre + (p - centre) * ratio));
    std::iter::once(centre).chain(inner).collect()
}

/// Lower left and upper right corner.
type Box2 = (Point, Point);

fn include((low, high): Box2, p: Point) -> Box2 {
    (Point::new(low.x.min(p.x), low.y.min(p.y)), Point::new(high.x.max(p.x), high.y.max(p.y)))
}

const EMPTY: Box2 = (Point::new(f64::INFINITY, f64::INFINITY), Point::new(f64::NEG_INFINITY, f64::NEG_INFINITY));

fn bounding_box(shape: &Shape) -> Box2 {
    shape.convex_parts().iter().fold(EMPTY, |all, part| match part {
        ConvexPart::Polygon(points) => points.iter().fold(all, |b, p| include(b, *p)),
        ConvexPart::Circle { centre, radius } => {
            let r = crate::geometry::Vector::new(*radius, *radius);
            include(include(all, centre - r), centre + r)
        }
    })
}

fn touches((low, high): &Box2, lanelet: &Lanelet) -> bool {
    let (first, last) = lanelet.centre.points().iter().fold(EMPTY, |b, p| include(b, *p));
    first.x <= high.x && last.x >= low.x && first.y <= high.y && last.y >= low.y
}
