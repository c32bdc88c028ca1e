//! Obstacles: shape, kind, and predicted motion.

use super::id_of;
use super::shape;
use super::state::{self, State};
use super::xml::{Node, Read, Source, all, child, child_text, children, text};
use crate::geometry::{Pose, Vector};
use crate::map::{Motion, Obstacle, ObstacleKind, Shape, TimedOccupancy, TimedPose};

/// Names of the elements that are obstacles.
pub(super) const ELEMENTS: [&str; 5] =
    ["obstacle", "staticObstacle", "dynamicObstacle", "environmentObstacle", "phantomObstacle"];

pub(super) fn read_all(source: &mut Source, root: Node, time_step: f64) -> Vec<Obstacle> {
    let mut obstacles = Vec::new();
    let mut seen = std::collections::BTreeSet::new();
    for node in root.children().filter(Node::is_element) {
        let obstacle = match node.tag_name().name() {
            "obstacle" => by_role(source, node, time_step),
            "staticObstacle" => fixed(source, node),
            "dynamicObstacle" => moving(source, node, time_step),
            "environmentObstacle" => environment(source, node),
            "phantomObstacle" => phantom(source, node, time_step),
            _ => continue,
        };
        if id_of(node).is_some_and(|id| !seen.insert(id)) {
            source.note(node, "an obstacle before it has the same id; both are kept");
        }
        obstacles.extend(obstacle);
    }
    obstacles
}

/// The form of 2018b: one element name, with the role in a child.
fn by_role(source: &mut Source, node: Node, time_step: f64) -> Read<Obstacle> {
    let role = source.required(node, "role", |source, role| match text(role).trim() {
        "static" => Ok(false),
        "dynamic" => Ok(true),
        other => Err(source.bad_value(role, other, "static or dynamic")),
    });
    // with an invalid role, the element is still examined for other errors
    let obstacle = if matches!(role, Ok(false)) { fixed(source, node) } else { moving(source, node, time_step) };
    role?;
    obstacle
}

fn note_unknown(source: &mut Source, node: Node) {
    source.note_unknown(
        node,
        &[
            "role",
            "type",
            "shape",
            "initialState",
            "initialSignalState",
            "signalSeries",
            "trajectory",
            "occupancySet",
            "wheelbase",
        ],
    );
}

fn kind(source: &mut Source, node: Node) -> ObstacleKind {
    match child_text(node, "type").as_deref() {
        Some("car" | "truck" | "bus" | "motorcycle" | "priorityVehicle" | "train" | "taxi") => ObstacleKind::Vehicle,
        Some("bicycle") => ObstacleKind::Bicycle,
        Some("pedestrian") => ObstacleKind::Pedestrian,
        Some("parkedVehicle") => ObstacleKind::ParkedVehicle,
        Some("building" | "pillar" | "constructionZone" | "roadBoundary" | "medianStrip" | "median_strip") => {
            ObstacleKind::Structure
        }
        Some("unknown") => ObstacleKind::Unknown,
        Some(other) => {
            source.note(node, format!("its type \"{other}\" is unknown"));
            ObstacleKind::Unknown
        }
        None => {
            source.note(node, "has no type");
            ObstacleKind::Unknown
        }
    }
}

/// Initial state. A missing orientation is replaced by 0, with an issue unless the shape is round. `shape` is `None` if
/// it has an error.
fn initial<'a>(source: &mut Source, node: Node<'a>, shape: Option<&Shape>) -> Read<State<'a>> {
    let node = source.child(node, "initialState")?;
    let mut state = state::read(source, node)?;
    if state.uncertain {
        source.note(node, "is uncertain within the tolerances; the middle of its intervals and regions is used");
    }
    if state.yaw.is_none() && !shape.is_some_and(shape::is_round) {
        source.note(node, "has no orientation; 0 is used");
    }
    state.yaw.get_or_insert(0.0);
    Ok(state)
}

fn pose(state: &State) -> Pose {
    Pose { position: state.position, yaw: state.yaw.unwrap_or(0.0) }
}

fn fixed(source: &mut Source, node: Node) -> Read<Obstacle> {
    note_unknown(source, node);
    let id = source.id(node, "id");
    let kind = kind(source, node);
    let shape = source.required(node, "shape", shape::read);
    let state = initial(source, node, shape.as_ref().ok());
    Ok(Obstacle { id: id?, kind, shape: shape?, motion: Motion::Static(pose(&state?)) })
}

fn moving(source: &mut Source, node: Node, time_step: f64) -> Read<Obstacle> {
    note_unknown(source, node);
    let id = source.id(node, "id");
    let kind = kind(source, node);
    let shape = source.required(node, "shape", shape::read);
    let first = initial(source, node, shape.as_ref().ok());
    let prediction = match (child(node, "trajectory"), child(node, "occupancySet")) {
        (Some(trajectory), _) => states(source, trajectory).map(|states| Prediction::Trajectory(trajectory, states)),
        (None, Some(set)) => sets(source, set).map(|sets| Prediction::Occupancy(set, sets)),
        (None, None) => Ok(Prediction::None),
    };
    let (shape, first) = (shape?, first?);
    let motion = match prediction? {
        Prediction::Trajectory(node, states) => {
            Motion::Trajectory(trajectory(source, node, first, states, &shape, time_step)?)
        }
        Prediction::Occupancy(node, mut sets) => {
            sets.insert(0, Set { from: first.step, to: first.step, region: shape.moved(&pose(&first)) });
            Motion::Occupancy(occupancies(source, node, sets, time_step))
        }
        Prediction::None => {
            source.note(node, "has no prediction; assumed to stand at its initial state for the whole run");
            Motion::Static(pose(&first))
        }
    };
    Ok(Obstacle { id: id?, kind, shape, motion })
}

/// The prediction of a moving obstacle as written, with its element.
enum Prediction<'a> {
    Trajectory(Node<'a>, Vec<State<'a>>),
    Occupancy(Node<'a>, Vec<Set>),
    None,
}

/// A structure. Its shape is in world coordinates, and it has no state.
fn environment(source: &mut Source, node: Node) -> Read<Obstacle> {
    source.note_unknown(node, &["type", "shape"]);
    let id = source.id(node, "id");
    let kind = kind(source, node);
    let world = source.required(node, "shape", shape::read)?;
    let middle = shape::middle(&world);
    let shape = world.moved(&Pose { position: (-middle.coords).into(), yaw: 0.0 });
    Ok(Obstacle { id: id?, kind, shape, motion: Motion::Static(Pose { position: middle, yaw: 0.0 }) })
}

/// A hypothetical obstacle in an occluded region: only the sets that it may occupy.
fn phantom(source: &mut Source, node: Node, time_step: f64) -> Read<Obstacle> {
    source.note_unknown(node, &["role", "type", "occupancySet"]);
    let id = source.id(node, "id");
    let set = source.child(node, "occupancySet")?;
    let sets = sets(source, set)?;
    let sets = occupancies(source, set, sets, time_step);
    let shape = sets.first().map(|set| set.region.clone()).ok_or_else(|| source.missing(node, "occupancy"))?;
    Ok(Obstacle { id: id?, kind: ObstacleKind::Unknown, shape, motion: Motion::Occupancy(sets) })
}

fn states<'a>(source: &mut Source, trajectory: Node<'a>) -> Read<Vec<State<'a>>> {
    all(children(trajectory, "state").map(|state| state::read(source, state)))
}

/// The initial state and the predicted ones in order of time, one for each time.
fn trajectory<'a>(
    source: &mut Source,
    node: Node,
    first: State<'a>,
    predicted: Vec<State<'a>>,
    shape: &Shape,
    time_step: f64,
) -> Read<Vec<TimedPose>> {
    let mut states = vec![first];
    states.extend(predicted);
    let predicted = states.len() - 1;
    if predicted == 0 {
        source.note(node, "has no state; the obstacle exists at its initial state only");
    }
    let uncertain = states.iter().skip(1).filter(|s| s.uncertain).count();
    if uncertain > 0 {
        source.note(node, format!("{uncertain} of {predicted} states are uncertain; the middle of each is used"));
    }
    if !states.is_sorted_by(|a, b| a.step <= b.step) {
        source.note(node, "its states are not in order of time; sorted");
        states.sort_by(|a, b| a.step.total_cmp(&b.step));
    }
    let mut contradicting = 0;
    states.dedup_by(|later, kept| {
        contradicting += usize::from(later.step == kept.step && later.position != kept.position);
        later.step == kept.step
    });
    if contradicting > 0 {
        source.note(
            node,
            format!("{contradicting} states contradict the position of another state at the same time; left out"),
        );
    }
    note_gaps(source, node, &states);
    fill_headings(source, node, &mut states, shape);
    state::reachable(source, &states, time_step)?;
    Ok(timed_poses(source, node, &states, time_step))
}

/// Adds an issue for time steps without a state between two states: the motion is interpolated over such a gap.
fn note_gaps(source: &mut Source, node: Node, states: &[State]) {
    let steps = states.windows(2).map(|w| w[1].step - w[0].step);
    let usual = steps.clone().fold(f64::INFINITY, f64::min);
    // a gap is longer than a step: the factor allows for rounding only
    let gaps = steps.clone().filter(|s| *s > 1.5 * usual).count();
    let longest = steps.fold(0.0, f64::max);
    if gaps > 0 {
        source.note(
            node,
            format!("has {gaps} gap(s) between its states, the longest of {longest} time steps; interpolated"),
        );
    }
}

/// Replaces a missing orientation by the direction of motion, or at standstill by the orientation of the state before.
fn fill_headings(source: &mut Source, node: Node, states: &mut [State], shape: &Shape) {
    /// A shorter displacement gives no heading, m.
    const STANDING: f64 = 0.01;
    let missing = states.iter().filter(|s| s.yaw.is_none()).count();
    if missing > 0 && !shape::is_round(shape) {
        source.note(node, format!("{missing} states have no orientation; the direction of their motion is used"));
    }
    let mut last = 0.0;
    for i in 0..states.len() {
        let step = states.get(i + 1).map_or(Vector::zeros(), |next| next.position - states[i].position);
        let of_motion = if step.norm() > STANDING { step.y.atan2(step.x) } else { last };
        last = *states[i].yaw.get_or_insert(of_motion);
    }
}

/// States with times in seconds. A missing speed is replaced by that of the motion to the next state (from the previous
/// one at the end). All speeds are, if most of them contradict the positions: collisions depend on positions.
fn timed_poses(source: &mut Source, node: Node, states: &[State], time_step: f64) -> Vec<TimedPose> {
    /// Smaller differences of the speed are noise of recordings, m/s.
    const CONTRADICTION: f64 = 2.0;
    let speed_between =
        |a: &State, b: &State| (b.position - a.position).dot(&pose(a).forward()) / ((b.step - a.step) * time_step);
    let moved_at = |i: usize| match (states.get(i + 1), i.checked_sub(1)) {
        (Some(next), _) => speed_between(&states[i], next),
        (None, Some(before)) => speed_between(&states[before], &states[i]),
        (None, None) => states[i].speed.unwrap_or(0.0),
    };
    let moved: Vec<f64> = (0..states.len()).map(moved_at).collect();
    let contradicts = |(s, moved): &(&State, &f64)| s.speed.is_some_and(|v| (v - **moved).abs() > CONTRADICTION);
    let contradicting = states.iter().zip(&moved).filter(contradicts).count();
    let is_contradictory = 2 * contradicting > states.len();
    if is_contradictory {
        source.note(node, format!("{contradicting} speeds contradict the positions; the speed of the motion is used"));
    }
    let timed = |(s, moved): (&State, &f64)| TimedPose {
        time: s.step * time_step,
        pose: pose(s),
        speed: s.speed.filter(|_| !is_contradictory).unwrap_or(*moved),
    };
    states.iter().zip(&moved).map(timed).collect()
}

/// A region that the obstacle may occupy, with the first and last time step.
struct Set {
    from: f64,
    to: f64,
    region: Shape,
}

fn sets(source: &mut Source, node: Node) -> Read<Vec<Set>> {
    all(children(node, "occupancy").map(|occupancy| {
        let steps = source.required(occupancy, "time", state::steps);
        let region = source.required(occupancy, "shape", shape::read);
        let steps = steps?;
        Ok(Set { from: steps.min, to: steps.max, region: region? })
    }))
}

/// The occupied regions in order of time. In a gap between sets, as between sets for single steps, the sets on both
/// sides are kept: the obstacle is in either.
fn occupancies(source: &mut Source, node: Node, mut sets: Vec<Set>, time_step: f64) -> Vec<TimedOccupancy> {
    if !sets.is_sorted_by(|a, b| a.from <= b.from) {
        source.note(node, "its sets are not in order of time; sorted");
        sets.sort_by(|a, b| a.from.total_cmp(&b.from));
    }
    let times = without_gaps(&sets.iter().map(|s| (s.from, s.to)).collect::<Vec<_>>());
    let timed = |((from, to), set): ((f64, f64), Set)| TimedOccupancy {
        from: from * time_step,
        to: to * time_step,
        region: set.region,
    };
    times.into_iter().zip(sets).map(timed).collect()
}

/// Extends intervals, sorted by their starts, over the gaps between them, from both sides.
pub(super) fn without_gaps(intervals: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut furthest = f64::NEG_INFINITY;
    let furthest_end: Vec<f64> = intervals
        .iter()
        .map(|(_, to)| {
            furthest = furthest.max(*to);
            furthest
        })
        .collect();
    let extend = |&(from, to): &(f64, f64)| {
        let started_before = intervals.partition_point(|i| i.0 < from);
        let end_before = started_before.checked_sub(1).map_or(from, |last| furthest_end[last]);
        let started = intervals.partition_point(|i| i.0 <= to);
        let continues = furthest_end[started - 1] > to;
        let next = intervals.get(started).filter(|_| !continues).map_or(to, |i| i.0);
        (from.min(end_before), next)
    };
    intervals.iter().map(extend).collect()
}
