//! Planning problems: initial state and goal states.

use super::error::ReadError;
use super::xml::{Node, Source, child, children};
use super::{shape, state};
use crate::geometry::Pose;
use crate::map::{Goal, GoalPosition, InitialState, Interval, PlanningProblem, RoadNetwork};

pub(super) fn read_all(
    source: &mut Source,
    root: Node,
    network: &RoadNetwork,
    time_step: f64,
) -> Result<Vec<PlanningProblem>, ReadError> {
    let mut problems: Vec<PlanningProblem> = Vec::new();
    for node in children(root, "planningProblem") {
        let id = source.id(node, "id")?;
        if problems.iter().any(|p| p.id == id) {
            return Err(ReadError::DuplicateId { place: source.place(node) });
        }
        source.note_unknown(node, &["initialState", "goalState"]);
        let initial = initial(source, source.child(node, "initialState")?)?;
        let goals =
            children(node, "goalState").map(|g| goal(source, g, network, time_step)).collect::<Result<Vec<_>, _>>()?;
        if goals.is_empty() {
            source.note(node, "has no goalState; the run ends when it stands or its time is over");
        }
        problems.push(PlanningProblem { id, initial, goals });
    }
    Ok(problems)
}

/// No road vehicle is faster, m/s. What is planned and drawn grows with the way to a stop.
const MAX_SPEED: f64 = 150.0;

fn initial(source: &mut Source, node: Node) -> Result<InitialState, ReadError> {
    let state = state::read(source, node)?;
    let yaw = state.yaw.ok_or_else(|| source.missing(node, "orientation"))?;
    let speed = state.speed.ok_or_else(|| source.missing(node, "velocity"))?;
    if speed.abs() > MAX_SPEED {
        let velocity = source.child(node, "velocity")?;
        return Err(source.bad_value(velocity, &speed.to_string(), "a speed of at most 150 m/s"));
    }
    if state.uncertain {
        source.note(node, "is uncertain; the middle of its intervals and regions is used");
    }
    if speed < 0.0 {
        source.note(node, format!("rolls backwards at {} m/s; plans go forwards only", -speed));
    }
    let optional = |name| child(node, name).map_or(Ok(0.0), |n| state::values(source, n).map(middle));
    #[allow(clippy::cast_possible_truncation)] // at most 1e9
    Ok(InitialState {
        centre: Pose { position: state.position, yaw },
        speed,
        acceleration: optional("acceleration")?,
        yaw_rate: optional("yawRate")?,
        time_step: state.step.floor() as i64,
    })
}

fn middle(interval: Interval) -> f64 {
    f64::midpoint(interval.min, interval.max)
}

fn goal(source: &mut Source, node: Node, network: &RoadNetwork, time_step: f64) -> Result<Goal, ReadError> {
    source.note_unknown(node, &["position", "time", "velocity", "orientation"]);
    let steps = state::steps(source, source.child(node, "time")?)?;
    Ok(Goal {
        position: child(node, "position").map(|n| position(source, n, network)).transpose()?,
        time: Interval { min: steps.min * time_step, max: steps.max * time_step },
        speed: child(node, "velocity").map(|n| state::values(source, n)).transpose()?,
        yaw: child(node, "orientation").map(|n| state::angles(source, n)).transpose()?,
    })
}

/// The region of a goal: lanelets by reference, or shapes.
fn position(source: &mut Source, node: Node, network: &RoadNetwork) -> Result<GoalPosition, ReadError> {
    if child(node, "lanelet").is_none() {
        return shape::read(source, node).map(GoalPosition::Shapes);
    }
    let mut lanelets = Vec::new();
    for reference in children(node, "lanelet") {
        let id = source.id(reference, "ref")?;
        if network.lanelets.contains_key(&id) {
            lanelets.push(id);
        } else {
            source.note(reference, format!("names lanelet {id}, which does not exist; left out"));
        }
    }
    if shape::is_region(node) {
        source.note(node, "has lanelets and shapes; the shapes are left out");
    }
    if lanelets.is_empty() {
        return Err(ReadError::NoSuchLanelet { place: source.place(node) });
    }
    Ok(GoalPosition::Lanelets(lanelets))
}
