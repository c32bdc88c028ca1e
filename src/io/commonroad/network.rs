//! Lanelets, traffic signs, traffic lights.

use std::collections::BTreeMap;

use super::error::ReadError;
use super::shape::child_text;
use super::xml::{Node, Source, child, children, text};
use crate::geometry::polyline::Polyline;
use crate::geometry::{Point, cross};
use crate::map::{Lanelet, LaneletId, Neighbour, RoadNetwork, StopLine, TrafficLight, TrafficSign};

pub(super) fn read(source: &mut Source, root: Node) -> Result<RoadNetwork, ReadError> {
    let mut network = RoadNetwork { signs: signs(source, root)?, lights: lights(source, root)?, ..Default::default() };
    for node in children(root, "lanelet") {
        let mut lanelet = lanelet(source, node)?;
        let signs = lanelet.signs.iter().filter_map(|id| network.signs.get(id));
        for limit in signs.flat_map(speed_limits) {
            lanelet.speed_limit = Some(lanelet.speed_limit.map_or(limit, |l| l.min(limit)));
        }
        if network.lanelets.insert(lanelet.id, lanelet).is_some() {
            return Err(ReadError::DuplicateId { place: source.place(node) });
        }
    }
    drop_dangling_references(source, root, &mut network);
    Ok(network)
}

fn lanelet(source: &mut Source, node: Node) -> Result<Lanelet, ReadError> {
    source.note_unknown(
        node,
        &[
            "leftBound",
            "rightBound",
            "predecessor",
            "successor",
            "adjacentLeft",
            "adjacentRight",
            "stopLine",
            "laneletType",
            "userOneWay",
            "userBidirectional",
            "trafficSignRef",
            "trafficLightRef",
            "speedLimit",
        ],
    );
    let id = source.id(node, "id")?;
    let (left_node, right_node) = (source.child(node, "leftBound")?, source.child(node, "rightBound")?);
    let (left_points, right_points) = (source.points(left_node)?, source.points(right_node)?);
    let left = bound(source, left_node, &left_points)?;
    let right = bound(source, right_node, &right_points)?;
    let centre = Lanelet::centre_line(&left_points, &right_points, &left, &right)
        .ok_or_else(|| ReadError::BadPoints { place: source.place(node), found: 1, expected: "a centre line of 2" })?;
    let mut lanelet = Lanelet {
        id,
        successors: unique(source.references(node, "successor")?),
        predecessors: unique(source.references(node, "predecessor")?),
        adjacent_left: neighbour(source, node, "adjacentLeft")?,
        adjacent_right: neighbour(source, node, "adjacentRight")?,
        speed_limit: child(node, "speedLimit").map(|n| source.positive(n)).transpose()?,
        stop_line: None,
        signs: source.references(node, "trafficSignRef")?,
        lights: source.references(node, "trafficLightRef")?,
        types: children(node, "laneletType").map(|n| text(n).trim().to_owned()).collect(),
        left,
        right,
        centre,
    };
    if let Some(line) = child(node, "stopLine") {
        lanelet.stop_line = Some(stop_line(source, line, &lanelet)?);
        lanelet.signs.extend(source.references(line, "trafficSignRef")?);
        lanelet.lights.extend(source.references(line, "trafficLightRef")?);
    }
    lanelet.signs = unique(lanelet.signs);
    lanelet.lights = unique(lanelet.lights);
    if signed_area(&lanelet.outline()) < 0.0 {
        source.note(node, "its left bound lies on the right of its right bound; taken as it is");
    }
    Ok(lanelet)
}

/// Longest bound of a lanelet, m. References are sampled along it, so memory grows with it.
const MAX_LENGTH: f64 = 1e5;

fn bound(source: &Source, node: Node, points: &[Point]) -> Result<Polyline, ReadError> {
    let bound = Polyline::new(points.iter().copied()).ok_or_else(|| ReadError::BadPoints {
        place: source.place(node),
        found: points.len(),
        expected: "at least 2 that differ",
    })?;
    if bound.length() > MAX_LENGTH {
        let found = format!("{:.0} m", bound.length());
        return Err(source.bad_value(node, &found, "a length of at most 100 km"));
    }
    Ok(bound)
}

/// Positive for counter-clockwise outlines.
fn signed_area(outline: &[Point]) -> f64 {
    let Some(&origin) = outline.first() else { return 0.0 };
    outline.windows(2).map(|w| 0.5 * cross(w[0] - origin, w[1] - origin)).sum()
}

fn unique(mut ids: Vec<i64>) -> Vec<i64> {
    let mut seen = std::collections::BTreeSet::new();
    ids.retain(|id| seen.insert(*id));
    ids
}

fn neighbour(source: &mut Source, node: Node, name: &'static str) -> Result<Option<Neighbour>, ReadError> {
    let Some(node) = child(node, name) else { return Ok(None) };
    let id = source.id(node, "ref")?;
    let same_direction = match node.attribute("drivingDir") {
        Some("same") => true,
        Some("opposite") => false,
        _ => {
            source
                .note(node, "drivingDir is neither same nor opposite; taken as opposite, so that nobody changes there");
            false
        }
    };
    Ok(Some(Neighbour { id, same_direction }))
}

/// The stop line with its left end first; without two points it lies at the end of the lanelet.
fn stop_line(source: &mut Source, node: Node, lanelet: &Lanelet) -> Result<StopLine, ReadError> {
    let at_end = StopLine { start: lanelet.left.last(), end: lanelet.right.last() };
    let (start, end) = match source.points(node)?.as_slice() {
        [] => return Ok(at_end),
        [start, .., end] if start != end => (*start, *end),
        _ => {
            source.note(node, "has one point; the end of the lanelet is taken");
            return Ok(at_end);
        }
    };
    let along = lanelet.centre.yaw_at(lanelet.centre.project(nalgebra::center(&start, &end)).station);
    let to_left = crate::geometry::Vector::new(-along.sin(), along.cos());
    let swapped = (start - end).dot(&to_left) < 0.0;
    Ok(if swapped { StopLine { start: end, end: start } } else { StopLine { start, end } })
}

/// Removes references to what is not in the file, noting each.
fn drop_dangling_references(source: &mut Source, root: Node, network: &mut RoadNetwork) {
    let known: std::collections::BTreeSet<LaneletId> = network.lanelets.keys().copied().collect();
    for node in children(root, "lanelet") {
        let Some(lanelet) = source.id(node, "id").ok().and_then(|id| network.lanelets.get_mut(&id)) else { continue };
        let keep = |source: &mut Source, what: &str, exists: bool, id: i64| {
            if !exists {
                source.note(node, format!("names {what} {id}, which does not exist; left out"));
            }
            exists
        };
        lanelet.successors.retain(|id| keep(source, "successor", known.contains(id), *id));
        lanelet.predecessors.retain(|id| keep(source, "predecessor", known.contains(id), *id));
        lanelet.adjacent_left.take_if(|n| !keep(source, "left neighbour", known.contains(&n.id), n.id));
        lanelet.adjacent_right.take_if(|n| !keep(source, "right neighbour", known.contains(&n.id), n.id));
        lanelet.signs.retain(|id| keep(source, "traffic sign", network.signs.contains_key(id), *id));
        lanelet.lights.retain(|id| keep(source, "traffic light", network.lights.contains_key(id), *id));
    }
}

fn position(source: &Source, node: Node) -> Result<Option<Point>, ReadError> {
    child(node, "position").and_then(|p| child(p, "point")).map(|p| source.point(p)).transpose()
}

fn signs(source: &mut Source, root: Node) -> Result<BTreeMap<i64, TrafficSign>, ReadError> {
    let mut signs = BTreeMap::new();
    for node in children(root, "trafficSign") {
        let id = source.id(node, "id")?;
        let mut elements = Vec::new();
        for element in children(node, "trafficSignElement") {
            let Some(code) = child_text(element, "trafficSignID") else {
                source.note(element, "has no trafficSignID; left out");
                continue;
            };
            if is_speed_limit(&code) {
                children(element, "additionalValue").try_for_each(|v| source.positive(v).map(drop))?;
                if child(element, "additionalValue").is_none() {
                    source.note(element, "is a speed limit without its additionalValue; it sets no limit");
                }
            }
            elements.push((code, children(element, "additionalValue").map(|v| text(v).trim().to_owned()).collect()));
        }
        let sign = TrafficSign { id, elements, position: position(source, node)? };
        if signs.insert(id, sign).is_some() {
            return Err(ReadError::DuplicateId { place: source.place(node) });
        }
    }
    Ok(signs)
}

/// The limits that a sign sets, m/s.
fn speed_limits(sign: &TrafficSign) -> impl Iterator<Item = f64> {
    let elements = sign.elements.iter().filter(|(code, _)| is_speed_limit(code));
    elements.flat_map(|(_, values)| values).filter_map(|v| v.parse().ok())
}

/// Whether a sign sets a speed limit. The numbers are those of CommonRoad's national tables; whichever country, files
/// also use the German 274. A zone's end (274.2) is none.
fn is_speed_limit(code: &str) -> bool {
    /// Germany (also used for China, Italy, Zamunda), USA and Puerto Rico, Spain, Russia, Argentina, Belgium, France,
    /// Greece (with a Greek capital rho), Croatia, and 273 of the older German signs.
    const CODES: [&str; 12] = [
        "MAX_SPEED",
        "MAX_SPEED_ZONE_START",
        "273",
        "R2-1",
        "r301",
        "3.24",
        "R15",
        "C43",
        "B14",
        "Ρ-32",
        "P-32",
        "B31",
    ];
    (code.starts_with("274") && code != "274.2") || CODES.contains(&code)
}

fn lights(source: &mut Source, root: Node) -> Result<BTreeMap<i64, TrafficLight>, ReadError> {
    let mut lights = BTreeMap::new();
    for node in children(root, "trafficLight") {
        let id = source.id(node, "id")?;
        let (mut cycle, mut offset) = (Vec::new(), 0);
        if let Some(cycle_node) = child(node, "cycle") {
            for element in children(cycle_node, "cycleElement") {
                let duration = source.child(element, "duration")?;
                let steps = u32::try_from(source.integer(duration)?)
                    .map_err(|_| source.bad_value(duration, &text(duration), "a count of time steps"))?;
                cycle.push((text(source.child(element, "color")?).trim().to_owned(), steps));
            }
            offset = child(cycle_node, "timeOffset").map_or(Ok(0), |n| source.integer(n))?;
        } else {
            source.note(node, "has no cycle");
        }
        let light = TrafficLight { id, cycle, offset, position: position(source, node)? };
        if lights.insert(id, light).is_some() {
            return Err(ReadError::DuplicateId { place: source.place(node) });
        }
    }
    Ok(lights)
}
