//! States. A value is exact or an interval; a position is a point or a region.

use super::shape;
use super::xml::{Node, Read, Source, child};
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
pub(super) fn read(source: &mut Source, node: Node) -> Read<State> {
    let step = source.required(node, "time", steps);
    let yaw = source.optional(node, "orientation", angles);
    let speed = source.optional(node, "velocity", values);
    let position = source.required(node, "position", position);
    let (step, yaw, speed, (position, is_region)) = (step?, yaw?, speed?, position?);
    let mut uncertain = is_region;
    let mut middle_of = |interval: Interval| {
        uncertain |= interval.min < interval.max;
        f64::midpoint(interval.min, interval.max)
    };
    let (step, yaw, speed) = (middle_of(step), yaw.map(&mut middle_of), speed.map(&mut middle_of));
    Ok(State { step, position, yaw, speed, uncertain })
}

/// A point, or the middle of a region; and whether it was a region.
fn position(source: &mut Source, node: Node) -> Read<(Point, bool)> {
    if let Some(point) = child(node, "point") {
        return Ok((source.point(point)?, false));
    }
    if !shape::is_region(node) {
        return Err(source.missing(node, "point, rectangle, circle or polygon"));
    }
    Ok((shape::middle(&shape::read(source, node)?), true))
}

/// An exact value or an interval.
pub(super) fn values(source: &mut Source, node: Node) -> Read<Interval> {
    let interval = ends(source, node, Source::number)?;
    if interval.min > interval.max {
        let found = format!("{} … {}", interval.min, interval.max);
        return Err(source.bad_value(node, &found, "an interval that does not end before it starts"));
    }
    Ok(interval)
}

/// An exact angle or an interval of angles, counter-clockwise from its start; its end may be written a turn too low.
pub(super) fn angles(source: &mut Source, node: Node) -> Read<Interval> {
    let Interval { min, max } = ends(source, node, Source::number)?;
    let width = if max < min { (max - min).rem_euclid(std::f64::consts::TAU) } else { max - min };
    Ok(Interval { min, max: min + width })
}

/// An exact time step or an interval of time steps.
pub(super) fn steps(source: &mut Source, node: Node) -> Read<Interval> {
    #[allow(clippy::cast_precision_loss)] // at most 1e9
    let whole = |source: &mut Source, node: Node| source.integer(node).map(|i| i as f64);
    ends(source, node, whole)?;
    values(source, node)
}

fn ends(source: &mut Source, node: Node, read: impl Fn(&mut Source, Node) -> Read<f64>) -> Read<Interval> {
    if let Some(exact) = child(node, "exact") {
        let value = read(source, exact)?;
        return Ok(Interval { min: value, max: value });
    }
    match (child(node, "intervalStart"), child(node, "intervalEnd")) {
        (Some(start), Some(end)) => {
            let (start, end) = (read(source, start), read(source, end));
            Ok(Interval { min: start?, max: end? })
        }
        _ => Err(source.missing(node, "exact, or intervalStart and intervalEnd")),
    }
}
