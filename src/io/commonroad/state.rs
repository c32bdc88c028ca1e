//! States. A value is exact or an interval; a position is a point or a region.
//!
//! A proof starts from states: that of the vehicle, and those of the obstacles. The middle of an interval would be a guess about
//! all of its other values, so the reader refuses a state with an interval or a region that is wider than a tolerance. The
//! tolerances are below the accuracy of localisation and far below every margin of a plan. A time is exact.

use super::error::ElementError;
use super::shape;
use super::xml::{Node, Read, Source, child};
use crate::geometry::Point;
use crate::map::Interval;
use crate::vehicle;

/// Widest interval of a quantity whose middle is used.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tolerance {
    width: f64,
    /// With its unit, for messages.
    expected: &'static str,
}

/// Diagonal of the box around a region of positions.
const POSITION: Tolerance = Tolerance { width: 0.01, expected: "a point, or a region of at most 0.01 m" };
const ORIENTATION: Tolerance = Tolerance { width: 1e-3, expected: "exact, or an interval of at most 0.001 rad" };
const VELOCITY: Tolerance = Tolerance { width: 0.01, expected: "exact, or an interval of at most 0.01 m/s" };
const TIME: Tolerance = Tolerance { width: 0.0, expected: "exact" };
pub(super) const ACCELERATION: Tolerance =
    Tolerance { width: 0.01, expected: "exact, or an interval of at most 0.01 m/s²" };
pub(super) const YAW_RATE: Tolerance =
    Tolerance { width: 1e-3, expected: "exact, or an interval of at most 0.001 rad/s" };
pub(super) const SLIP_ANGLE: Tolerance =
    Tolerance { width: 1e-3, expected: "exact, or an interval of at most 0.001 rad" };

/// The speeds that are valid, for messages.
const SPEEDS: &str = "a speed of at most 150 m/s";

/// A state with its uncertain values, at most as wide as their tolerances, reduced to their middles.
pub(super) struct State<'a> {
    pub(super) node: Node<'a>,
    /// Time in steps of the file.
    pub(super) step: f64,
    pub(super) position: Point,
    pub(super) yaw: Option<f64>,
    pub(super) speed: Option<f64>,
    /// Whether any of the above was an interval or a region.
    pub(super) uncertain: bool,
}

/// Reads a state's time, position, orientation and velocity.
pub(super) fn read<'a>(source: &mut Source, node: Node<'a>) -> Read<State<'a>> {
    let step = source.required(node, "time", |source, n| middle(source, n, steps, TIME));
    let yaw = source.optional(node, "orientation", |source, n| middle(source, n, angles, ORIENTATION));
    let speed = source
        .optional(node, "velocity", |source, n| bounded(source, n, VELOCITY, vehicle::State::HIGHEST_SPEED, SPEEDS));
    let position = source.required(node, "position", position);
    let ((step, _), yaw, speed, (position, is_region)) = (step?, yaw?, speed?, position?);
    let is_interval = |value: &Option<(f64, bool)>| value.is_some_and(|(_, is_interval)| is_interval);
    let uncertain = is_region || is_interval(&yaw) || is_interval(&speed);
    let exact = |value: Option<(f64, bool)>| value.map(|(middle, _)| middle);
    Ok(State { node, step, position, yaw: exact(yaw), speed: exact(speed), uncertain })
}

/// An exact value, or the middle of an interval within the tolerance; and whether it was an interval.
pub(super) fn middle(
    source: &mut Source,
    node: Node,
    read: impl Fn(&mut Source, Node) -> Read<Interval>,
    tolerance: Tolerance,
) -> Read<(f64, bool)> {
    let Interval { min, max } = read(source, node)?;
    within(source, node, max - min, tolerance)?;
    Ok((f64::midpoint(min, max), min < max))
}

/// As [`middle`], of a quantity whose magnitude has a bound.
pub(super) fn bounded(
    source: &mut Source,
    node: Node,
    tolerance: Tolerance,
    most: f64,
    expected: &'static str,
) -> Read<(f64, bool)> {
    let (middle, is_interval) = middle(source, node, values, tolerance)?;
    if middle.abs() <= most {
        Ok((middle, is_interval))
    } else {
        Err(source.bad_value(node, &middle.to_string(), expected))
    }
}

/// Reports the first state that is too far from the one before it. The states are in order of their times, one for each.
pub(super) fn reachable(source: &mut Source, states: &[State], time_step: f64) -> Read<()> {
    for pair in states.windows(2) {
        let distance = (pair[1].position - pair[0].position).norm();
        let speed = distance / ((pair[1].step - pair[0].step) * time_step);
        if speed > vehicle::State::HIGHEST_SPEED {
            let place = source.place(pair[1].node);
            return Err(source.report(ElementError::Unreachable { place, distance, speed, expected: SPEEDS }));
        }
    }
    Ok(())
}

/// Reports a value that is wider than its tolerance.
fn within(source: &mut Source, node: Node, width: f64, tolerance: Tolerance) -> Read<()> {
    /// The ends of an interval are decimal numbers, and their difference is rounded.
    const ROUNDING: f64 = 1e-9;
    if width <= tolerance.width + ROUNDING {
        return Ok(());
    }
    let (place, expected) = (source.place(node), tolerance.expected);
    Err(source.report(ElementError::Uncertain { place, width, expected }))
}

/// A point, or the middle of a region; and whether it was a region.
fn position(source: &mut Source, node: Node) -> Read<(Point, bool)> {
    if let Some(point) = child(node, "point") {
        return Ok((source.point(point)?, false));
    }
    if !shape::is_region(node) {
        return Err(source.missing(node, "point, rectangle, circle or polygon"));
    }
    let region = shape::read(source, node)?;
    within(source, node, shape::extent(&region), POSITION)?;
    Ok((shape::middle(&region), true))
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
    ends(source, node, Source::step)?;
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
