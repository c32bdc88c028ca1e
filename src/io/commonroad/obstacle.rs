//! Obstacles: shape, kind, and what the file predicts of their motion.

use super::error::ReadError;
use super::shape::{self, child_text};
use super::state::{self, State};
use super::xml::{Node, Source, child, children};
use crate::geometry::{Pose, Vector};
use crate::map::{Motion, Obstacle, ObstacleKind, Shape, TimedOccupancy, TimedPose};

pub(super) fn read_all(source: &mut Source, root: Node, time_step: f64) -> Result<Vec<Obstacle>, ReadError> {
    let mut obstacles = Vec::new();
    let mut seen = std::collections::BTreeSet::new();
    for node in root.children().filter(Node::is_element) {
        let obstacle = match node.tag_name().name() {
            "obstacle" => by_role(source, node, time_step)?,
            "staticObstacle" => fixed(source, node)?,
            "dynamicObstacle" => moving(source, node, time_step)?,
            "environmentObstacle" => environment(source, node)?,
            "phantomObstacle" => phantom(source, node, time_step)?,
            _ => continue,
        };
        if !seen.insert(obstacle.id) {
            source.note(node, "its id is already taken by an obstacle before it; both are kept");
        }
        obstacles.push(obstacle);
    }
    Ok(obstacles)
}

/// The form of 2018b: one element, the role tells.
fn by_role(source: &mut Source, node: Node, time_step: f64) -> Result<Obstacle, ReadError> {
    let role = source.child(node, "role")?;
    match super::xml::text(role).trim() {
        "static" => fixed(source, node),
        "dynamic" => moving(source, node, time_step),
        other => Err(source.bad_value(role, other, "static or dynamic")),
    }
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
            source.note(node, format!("its type \"{other}\" is not known"));
            ObstacleKind::Unknown
        }
        None => {
            source.note(node, "has no type");
            ObstacleKind::Unknown
        }
    }
}

/// Initial state; an orientation that is missing is 0, noted unless the shape is round.
fn initial(source: &mut Source, node: Node, shape: &Shape) -> Result<State, ReadError> {
    let node = source.child(node, "initialState")?;
    let mut state = state::read(source, node)?;
    if state.uncertain {
        source.note(node, "is uncertain; the middle of its intervals and regions is used");
    }
    if state.yaw.is_none() && !shape::is_round(shape) {
        source.note(node, "has no orientation; 0 is used");
    }
    state.yaw.get_or_insert(0.0);
    Ok(state)
}

fn pose(state: &State) -> Pose {
    Pose { position: state.position, yaw: state.yaw.unwrap_or(0.0) }
}

fn fixed(source: &mut Source, node: Node) -> Result<Obstacle, ReadError> {
    note_unknown(source, node);
    let shape = shape::read(source, source.child(node, "shape")?)?;
    let motion = Motion::Static(pose(&initial(source, node, &shape)?));
    Ok(Obstacle { id: source.id(node, "id")?, kind: kind(source, node), shape, motion })
}

fn moving(source: &mut Source, node: Node, time_step: f64) -> Result<Obstacle, ReadError> {
    note_unknown(source, node);
    let shape = shape::read(source, source.child(node, "shape")?)?;
    let first = initial(source, node, &shape)?;
    let motion = if let Some(trajectory) = child(node, "trajectory") {
        Motion::Trajectory(trajectory_of(source, trajectory, first, &shape, time_step)?)
    } else if let Some(set) = child(node, "occupancySet") {
        let at_start = Exactly { step: first.step, region: shape.moved(&pose(&first)) };
        Motion::Occupancy(occupancies(source, set, Some(at_start), time_step)?)
    } else {
        source.note(node, "has no prediction; taken as standing at its initial state for ever");
        Motion::Static(pose(&first))
    };
    Ok(Obstacle { id: source.id(node, "id")?, kind: kind(source, node), shape, motion })
}

/// A structure: its shape is in world coordinates and it has no state.
fn environment(source: &mut Source, node: Node) -> Result<Obstacle, ReadError> {
    source.note_unknown(node, &["type", "shape"]);
    let world = shape::read(source, source.child(node, "shape")?)?;
    let middle = shape::middle(&world);
    let shape = world.moved(&Pose { position: (-middle.coords).into(), yaw: 0.0 });
    let motion = Motion::Static(Pose { position: middle, yaw: 0.0 });
    Ok(Obstacle { id: source.id(node, "id")?, kind: kind(source, node), shape, motion })
}

/// An obstacle that nobody sees: only sets that it may occupy.
fn phantom(source: &mut Source, node: Node, time_step: f64) -> Result<Obstacle, ReadError> {
    source.note_unknown(node, &["role", "type", "occupancySet"]);
    let sets = occupancies(source, source.child(node, "occupancySet")?, None, time_step)?;
    let shape = sets.first().map(|set| set.region.clone()).ok_or_else(|| source.missing(node, "occupancy"))?;
    Ok(Obstacle { id: source.id(node, "id")?, kind: ObstacleKind::Unknown, shape, motion: Motion::Occupancy(sets) })
}

/// The initial state and the predicted ones in order of time, one for each time.
fn trajectory_of(
    source: &mut Source,
    node: Node,
    first: State,
    shape: &Shape,
    time_step: f64,
) -> Result<Vec<TimedPose>, ReadError> {
    let mut states = vec![first];
    for state in children(node, "state") {
        states.push(state::read(source, state)?);
    }
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
        source.note(node, format!("{contradicting} states are elsewhere than another one of the same time; left out"));
    }
    note_gaps(source, node, &states);
    fill_headings(source, node, &mut states, shape);
    Ok(timed_poses(source, node, &states, time_step))
}

/// Tells of times without a state between two that are there: the motion goes on evenly from the one to the other.
fn note_gaps(source: &mut Source, node: Node, states: &[State]) {
    let steps = states.windows(2).map(|w| w[1].step - w[0].step);
    let usual = steps.clone().fold(f64::INFINITY, f64::min);
    // time steps may be intervals, whose middles lie at halves
    let gaps = steps.clone().filter(|s| *s > 1.5 * usual).count();
    let longest = steps.fold(0.0, f64::max);
    if gaps > 0 {
        source.note(
            node,
            format!("has {gaps} gap(s) between its states, the longest of {longest} time steps; filled evenly"),
        );
    }
}

/// Gives states without an orientation that of their motion, or that of the state before while standing.
fn fill_headings(source: &mut Source, node: Node, states: &mut [State], shape: &Shape) {
    /// Shorter moves tell nothing of the heading, m.
    const STANDING: f64 = 0.01;
    let missing = states.iter().filter(|s| s.yaw.is_none()).count();
    if missing > 0 && !shape::is_round(shape) {
        source.note(node, format!("{missing} states have no orientation; that of their motion is used"));
    }
    let mut last = 0.0;
    for i in 0..states.len() {
        let step = states.get(i + 1).map_or(Vector::zeros(), |next| next.position - states[i].position);
        let along_motion = if step.norm() > STANDING { step.y.atan2(step.x) } else { last };
        last = *states[i].yaw.get_or_insert(along_motion);
    }
}

/// States with times in seconds. A speed that is missing is that of the motion to the next state (or from the last);
/// so are all, when most of the file's speeds contradict the positions, which are what can be hit.
fn timed_poses(source: &mut Source, node: Node, states: &[State], time_step: f64) -> Vec<TimedPose> {
    /// Speeds that differ less are noise of recordings, m/s.
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
    let lies = 2 * contradicting > states.len();
    if lies {
        source.note(node, format!("{contradicting} speeds contradict the positions; the speed of the motion is used"));
    }
    let timed = |(s, moved): (&State, &f64)| TimedPose {
        time: s.step * time_step,
        pose: pose(s),
        speed: s.speed.filter(|_| !lies).unwrap_or(*moved),
    };
    states.iter().zip(&moved).map(timed).collect()
}

/// A region occupied at one time step.
struct Exactly {
    step: f64,
    region: Shape,
}

/// The occupied regions in order of time. Where time passes that no set covers, as between sets for single steps, the
/// sets on both sides are kept for that time: the obstacle is in either. `at_start` is the region of the initial state.
fn occupancies(
    source: &mut Source,
    node: Node,
    at_start: Option<Exactly>,
    time_step: f64,
) -> Result<Vec<TimedOccupancy>, ReadError> {
    let mut sets: Vec<(f64, f64, Shape)> = at_start.into_iter().map(|s| (s.step, s.step, s.region)).collect();
    for occupancy in children(node, "occupancy") {
        let steps = state::steps(source, source.child(occupancy, "time")?)?;
        sets.push((steps.min, steps.max, shape::read(source, source.child(occupancy, "shape")?)?));
    }
    if !sets.is_sorted_by(|a, b| a.0 <= b.0) {
        source.note(node, "its sets are not in order of time; sorted");
        sets.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    let times = without_gaps(&sets.iter().map(|s| (s.0, s.1)).collect::<Vec<_>>());
    let timed = |((from, to), (_, _, region)): ((f64, f64), (f64, f64, Shape))| TimedOccupancy {
        from: from * time_step,
        to: to * time_step,
        region,
    };
    Ok(times.into_iter().zip(sets).map(timed).collect())
}

/// Widens intervals, sorted by their starts, over the gaps between them, from both sides.
pub(super) fn without_gaps(intervals: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut furthest = f64::NEG_INFINITY;
    let furthest_end: Vec<f64> = intervals
        .iter()
        .map(|(_, to)| {
            furthest = furthest.max(*to);
            furthest
        })
        .collect();
    let widen = |&(from, to): &(f64, f64)| {
        let begun_before = intervals.partition_point(|i| i.0 < from);
        let end_before = begun_before.checked_sub(1).map_or(from, |last| furthest_end[last]);
        let begun = intervals.partition_point(|i| i.0 <= to);
        let goes_on = furthest_end[begun - 1] > to;
        let next = intervals.get(begun).filter(|_| !goes_on).map_or(to, |i| i.0);
        (from.min(end_before), next)
    };
    intervals.iter().map(widen).collect()
}
