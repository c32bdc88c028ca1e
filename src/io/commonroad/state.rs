//! States: values that are exact or intervals, positions that are points or regions.

use super::error::ReadError;
use super::shape;
use super::xml::{Node, Source, child};
use crate::geometry::Point;
use crate::map::Interval;

/// A state with its uncertain values reduced to their middles.
pub(super) struct State {
    /// Time in steps of the file; a half where it is the middle of an interval.
    pub(super) step: f64,
    pub(super) position: Point,
    pub(super) yaw: Option<f64>,
    pub(super) speed: Option<f64>,
    /// Whether any of the above was an interval or a region.
    pub(super) uncertain: bool,
}

/// Reads a state's time, position, orientation and velocity.
pub(super) fn read(source: &Source, node: Node) -> Result<State, ReadError> {
    let mut uncertain = false;
    let mut middle_of = |interval: Interval| {
        uncertain |= interval.min < interval.max;
        f64::midpoint(interval.min, interval.max)
    };
    let step = middle_of(steps(source, source.child(node, "time")?)?);
    let yaw = child(node, "orientation").map(|n| angles(source, n)).transpose()?.map(&mut middle_of);
    let speed = child(node, "velocity").map(|n| values(source, n)).transpose()?.map(&mut middle_of);
    let (position, is_region) = position(source, source.child(node, "position")?)?;
    Ok(State { step, position, yaw, speed, uncertain: uncertain || is_region })
}

/// A point, or the middle of a region; and whether it was a region.
fn position(source: &Source, node: Node) -> Result<(Point, bool), ReadError> {
    if let Some(point) = child(node, "point") {
        return Ok((source.point(point)?, false));
    }
    if !shape::is_region(node) {
        return Err(source.missing(node, "point, rectangle, circle or polygon"));
    }
    Ok((shape::middle(&shape::read(source, node)?), true))
}

/// An exact value or an interval.
pub(super) fn values(source: &Source, node: Node) -> Result<Interval, ReadError> {
    let interval = ends(source, node, Source::number)?;
    if interval.min > interval.max {
        return Err(source.bad_value(
            node,
            &format!("{} … {}", interval.min, interval.max),
            "an interval that does not end before it starts",
        ));
    }
    Ok(interval)
}

/// An exact angle or an interval of angles, counter-clockwise from its start; its end may be written a turn too low.
pub(super) fn angles(source: &Source, node: Node) -> Result<Interval, ReadError> {
    let Interval { min, max } = ends(source, node, Source::number)?;
    let width = if max < min { (max - min).rem_euclid(std::f64::consts::TAU) } else { max - min };
    Ok(Interval { min, max: min + width })
}

/// An exact time step or an interval of time steps.
pub(super) fn steps(source: &Source, node: Node) -> Result<Interval, ReadError> {
    #[allow(clippy::cast_precision_loss)] // at most 1e9
    let whole = |source: &Source, node: Node| source.integer(node).map(|i| i as f64);
    ends(source, node, whole)?;
    values(source, node)
}

fn ends(
    source: &Source,
    node: Node,
    read: impl Fn(&Source, Node) -> Result<f64, ReadError>,
) -> Result<Interval, ReadError> {
    if let Some(exact) = child(node, "exact") {
        let value = read(source, exact)?;
        return Ok(Interval { min: value, max: value });
    }
    match (child(node, "intervalStart"), child(node, "intervalEnd")) {
        (Some(start), Some(end)) => Ok(Interval { min: read(source, start)?, max: read(source, end)? }),
        _ => Err(source.missing(node, "exact, or intervalStart and intervalEnd")),
    }
}
