//! Lanelets, traffic signs, traffic lights.

use std::collections::{BTreeMap, BTreeSet};

use super::xml::{Node, Read, Source, all, child, child_text, children, text};
use super::{duplicate, id_of};
use crate::geometry::polyline::Polyline;
use crate::geometry::{Point, cross};
use crate::map::{Lanelet, LaneletId, Neighbour, RoadNetwork, StopLine, TrafficLight, TrafficSign};

/// The road network, with the ids of all lanelets of the file, including those with errors.
pub(super) struct Network {
    pub(super) roads: RoadNetwork,
    ids: BTreeSet<LaneletId>,
    /// Whether a lanelet has no id, or one that is not a number.
    has_unknown_ids: bool,
}

impl Network {
    /// Whether a reference to this lanelet is valid. True if it might be to a lanelet whose id is reported as an error.
    pub(super) fn may_have(&self, id: LaneletId) -> bool {
        self.ids.contains(&id) || self.has_unknown_ids
    }
}

pub(super) fn read(source: &mut Source, root: Node) -> Network {
    let mut roads = RoadNetwork { signs: signs(source, root), lights: lights(source, root), ..Default::default() };
    let mut lines = BTreeMap::new();
    for node in children(root, "lanelet") {
        let lanelet = lanelet(source, node);
        if duplicate(source, node, &mut lines) {
            continue;
        }
        let Ok(mut lanelet) = lanelet else { continue };
        let signs = lanelet.signs.iter().filter_map(|id| roads.signs.get(id));
        for limit in signs.flat_map(speed_limits) {
            lanelet.speed_limit = Some(lanelet.speed_limit.map_or(limit, |l| l.min(limit)));
        }
        roads.lanelets.insert(lanelet.id, lanelet);
    }
    drop_dangling_references(source, root, &mut roads);
    let has_unknown_ids = children(root, "lanelet").any(|node| id_of(node).is_none());
    Network { roads, ids: lines.into_keys().collect(), has_unknown_ids }
}

fn lanelet(source: &mut Source, node: Node) -> Read<Lanelet> {
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
    let id = source.id(node, "id");
    let (left, right) = (source.required(node, "leftBound", bound), source.required(node, "rightBound", bound));
    let (successors, predecessors) = (source.references(node, "successor"), source.references(node, "predecessor"));
    let adjacent_left = source.optional(node, "adjacentLeft", neighbour);
    let adjacent_right = source.optional(node, "adjacentRight", neighbour);
    let speed_limit = source.optional(node, "speedLimit", Source::positive);
    let (signs, lights) = (source.references(node, "trafficSignRef"), source.references(node, "trafficLightRef"));
    let line = source.optional(node, "stopLine", marking);
    let ((left_points, left), (right_points, right)) = (left?, right?);
    let Some(centre) = Lanelet::centre_line(&left_points, &right_points, &left, &right) else {
        return Err(source.bad_points(node, 1, "a centre line of 2"));
    };
    let (mut signs, mut lights, mut stop_line) = (signs?, lights?, None);
    if let Some(line) = line? {
        let node = child(node, "stopLine").unwrap_or(node);
        stop_line = Some(across_lane(source, node, &line.points, &left, &right, &centre));
        signs.extend(line.signs);
        lights.extend(line.lights);
    }
    let lanelet = Lanelet {
        id: id?,
        successors: unique(successors?),
        predecessors: unique(predecessors?),
        adjacent_left: adjacent_left?,
        adjacent_right: adjacent_right?,
        speed_limit: speed_limit?,
        stop_line,
        signs: unique(signs),
        lights: unique(lights),
        types: children(node, "laneletType").map(|n| text(n).trim().to_owned()).collect(),
        left,
        right,
        centre,
    };
    if signed_area(&lanelet.outline()) < 0.0 {
        source.note(node, "its left bound is to the right of its right bound; used as it is");
    }
    Ok(lanelet)
}

/// Largest length of a lanelet's bound, m. References are sampled along it, so memory grows with it.
const MAX_LENGTH: f64 = 1e5;

/// A bound's points as written, and their line without repeated points.
fn bound(source: &mut Source, node: Node) -> Read<(Vec<Point>, Polyline)> {
    let points = source.points(node)?;
    let Some(line) = Polyline::new(points.iter().copied()) else {
        return Err(source.bad_points(node, points.len(), "at least 2 that differ"));
    };
    if line.length() > MAX_LENGTH {
        let found = format!("{:.0} m", line.length());
        return Err(source.bad_value(node, &found, "a length of at most 100 km"));
    }
    Ok((points, line))
}

/// Positive for counter-clockwise outlines.
fn signed_area(outline: &[Point]) -> f64 {
    let Some(&origin) = outline.first() else { return 0.0 };
    outline.windows(2).map(|w| 0.5 * cross(w[0] - origin, w[1] - origin)).sum()
}

fn unique(mut ids: Vec<i64>) -> Vec<i64> {
    let mut seen = BTreeSet::new();
    ids.retain(|id| seen.insert(*id));
    ids
}

fn neighbour(source: &mut Source, node: Node) -> Read<Neighbour> {
    let id = source.id(node, "ref")?;
    let same_direction = match node.attribute("drivingDir") {
        Some("same") => true,
        Some("opposite") => false,
        _ => {
            source.note(node, "drivingDir is neither same nor opposite; assumed opposite, so no plan changes to it");
            false
        }
    };
    Ok(Neighbour { id, same_direction })
}

/// A `<stopLine>` as written.
struct StopMarking {
    points: Vec<Point>,
    signs: Vec<i64>,
    lights: Vec<i64>,
}

fn marking(source: &mut Source, node: Node) -> Read<StopMarking> {
    let points = source.points(node);
    let (signs, lights) = (source.references(node, "trafficSignRef"), source.references(node, "trafficLightRef"));
    Ok(StopMarking { points: points?, signs: signs?, lights: lights? })
}

/// The stop line with its left end first. Without two points, it is at the end of the lanelet.
fn across_lane(
    source: &mut Source,
    node: Node,
    points: &[Point],
    left: &Polyline,
    right: &Polyline,
    centre: &Polyline,
) -> StopLine {
    let at_end = StopLine { start: left.last(), end: right.last() };
    let (start, end) = match points {
        [] => return at_end,
        [start, .., end] if start != end => (*start, *end),
        _ => {
            source.note(node, "has one point; the end of the lanelet is used");
            return at_end;
        }
    };
    let yaw = centre.yaw_at(centre.project(nalgebra::center(&start, &end)).station);
    let to_left = crate::geometry::Vector::new(-yaw.sin(), yaw.cos());
    let swapped = (start - end).dot(&to_left) < 0.0;
    if swapped { StopLine { start: end, end: start } } else { StopLine { start, end } }
}

/// Removes references to elements that the file does not have, with an issue for each.
fn drop_dangling_references(source: &mut Source, root: Node, network: &mut RoadNetwork) {
    let known: BTreeSet<LaneletId> = network.lanelets.keys().copied().collect();
    for node in children(root, "lanelet") {
        let Some(lanelet) = id_of(node).and_then(|id| network.lanelets.get_mut(&id)) else { continue };
        let keep = |source: &mut Source, what: &str, exists: bool, id: i64| {
            if !exists {
                source.note(node, format!("refers to {what} {id}, which does not exist; left out"));
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

/// The optional `<position>` of a sign or light.
fn position(source: &mut Source, node: Node) -> Read<Option<Point>> {
    child(node, "position").and_then(|p| child(p, "point")).map(|p| source.point(p)).transpose()
}

fn signs(source: &mut Source, root: Node) -> BTreeMap<i64, TrafficSign> {
    let (mut signs, mut lines) = (BTreeMap::new(), BTreeMap::new());
    for node in children(root, "trafficSign") {
        let sign = sign(source, node);
        if duplicate(source, node, &mut lines) {
            continue;
        }
        signs.extend(sign.map(|sign| (sign.id, sign)));
    }
    signs
}

fn sign(source: &mut Source, node: Node) -> Read<TrafficSign> {
    let id = source.id(node, "id");
    let elements = all(children(node, "trafficSignElement").map(|element| sign_element(source, element)));
    let position = position(source, node);
    Ok(TrafficSign { id: id?, elements: elements?.into_iter().flatten().collect(), position: position? })
}

/// A sign's number and its additional values. `None` without a number.
fn sign_element(source: &mut Source, node: Node) -> Read<Option<(String, Vec<String>)>> {
    let Some(code) = child_text(node, "trafficSignID") else {
        source.note(node, "has no trafficSignID; left out");
        return Ok(None);
    };
    if is_speed_limit(&code) {
        all(children(node, "additionalValue").map(|v| source.positive(v)))?;
        if child(node, "additionalValue").is_none() {
            source.note(node, "is a speed limit without its additionalValue; it sets no limit");
        }
    }
    Ok(Some((code, children(node, "additionalValue").map(|v| text(v).trim().to_owned()).collect())))
}

/// The speed limits of a sign, m/s.
fn speed_limits(sign: &TrafficSign) -> impl Iterator<Item = f64> {
    let elements = sign.elements.iter().filter(|(code, _)| is_speed_limit(code));
    elements.flat_map(|(_, values)| values).filter_map(|v| v.parse().ok())
}

/// Whether a sign sets a speed limit. The numbers are those of CommonRoad's national tables; files of any country also
/// use the German 274. The end of a zone (274.2) sets none.
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

fn lights(source: &mut Source, root: Node) -> BTreeMap<i64, TrafficLight> {
    let (mut lights, mut lines) = (BTreeMap::new(), BTreeMap::new());
    for node in children(root, "trafficLight") {
        let light = light(source, node);
        if duplicate(source, node, &mut lines) {
            continue;
        }
        lights.extend(light.map(|light| (light.id, light)));
    }
    lights
}

fn light(source: &mut Source, node: Node) -> Read<TrafficLight> {
    let id = source.id(node, "id");
    let cycle = source.optional(node, "cycle", |source, cycle| {
        let phases = all(children(cycle, "cycleElement").map(|element| phase(source, element)));
        let offset = source.optional(cycle, "timeOffset", Source::integer);
        Ok((phases?, offset?.unwrap_or(0)))
    });
    if child(node, "cycle").is_none() {
        source.note(node, "has no cycle");
    }
    let position = position(source, node);
    let (cycle, offset) = cycle?.unwrap_or_default();
    Ok(TrafficLight { id: id?, cycle, offset, position: position? })
}

/// Colour and duration in time steps.
fn phase(source: &mut Source, node: Node) -> Read<(String, u32)> {
    let steps = source.required(node, "duration", |source, duration| {
        let steps = source.integer(duration)?;
        u32::try_from(steps).map_err(|_| source.bad_value(duration, &text(duration), "a number of time steps"))
    });
    let colour = source.required(node, "color", |_, colour| Ok(text(colour).trim().to_owned()));
    Ok((colour?, steps?))
}
