//! Planning problems: initial state and goal states.

use std::collections::BTreeMap;

use super::error::ElementError;
use super::network::Network;
use super::xml::{Node, Read, Source, all, child, children};
use super::{duplicate, shape, state};
use crate::geometry::Pose;
use crate::map::{Goal, GoalPosition, InitialState, Interval, PlanningProblem};
use crate::vehicle::State;

pub(super) fn read_all(source: &mut Source, root: Node, network: &Network, time_step: f64) -> Vec<PlanningProblem> {
    let mut problems = Vec::new();
    let mut lines = BTreeMap::new();
    for node in children(root, "planningProblem") {
        let problem = problem(source, node, network, time_step);
        if duplicate(source, node, &mut lines) {
            continue;
        }
        problems.extend(problem);
    }
    if child(root, "planningProblem").is_none() {
        let place = source.place(root);
        source.report(ElementError::NoPlanningProblem { place });
    }
    problems
}

fn problem(source: &mut Source, node: Node, network: &Network, time_step: f64) -> Read<PlanningProblem> {
    source.note_unknown(node, &["initialState", "goalState"]);
    let id = source.id(node, "id");
    let initial = source.required(node, "initialState", initial);
    let goals = all(children(node, "goalState").map(|g| goal(source, g, network, time_step)));
    if child(node, "goalState").is_none() {
        source.note(node, "has no goalState; the run ends at standstill or at its time limit");
    }
    Ok(PlanningProblem { id: id?, initial: initial?, goals: goals? })
}

/// Largest initial slip angle, rad: beyond it the vehicle moves backwards, which is a negative speed.
const MAX_SLIP_ANGLE: f64 = std::f64::consts::FRAC_PI_2;
/// Slip angles below this one are those of a turn, which the yaw rate describes, rad.
const SLIDING: f64 = 0.1;

fn initial(source: &mut Source, node: Node) -> Read<InitialState> {
    let state = state::read(source, node);
    let (orientation, velocity) = (source.child(node, "orientation"), source.child(node, "velocity"));
    let mut of = |name, tolerance, most, expected| {
        let value = source.optional(node, name, |source, n| state::bounded(source, n, tolerance, most, expected));
        Ok(value?.map_or(0.0, |(middle, _)| middle))
    };
    let (acceleration, yaw_rate) = (State::HIGHEST_ACCELERATION, State::HIGHEST_YAW_RATE);
    let acceleration = of("acceleration", state::ACCELERATION, acceleration, "an acceleration of at most 50 m/s²");
    let yaw_rate = of("yawRate", state::YAW_RATE, yaw_rate, "a yaw rate of at most 20 rad/s");
    let slip_angle =
        of("slipAngle", state::SLIP_ANGLE, MAX_SLIP_ANGLE, "a slip angle of at most pi/2 rad to either side");
    let (state, _, _) = (state?, orientation?, velocity?);
    let (speed, slip_angle) = (state.speed.unwrap_or(0.0), slip_angle?);
    if state.uncertain {
        source.note(node, "is uncertain within the tolerances; the middle of its intervals and regions is used");
    }
    if speed < 0.0 {
        source.note(node, format!("rolls backwards at {} m/s; plans go forwards only", -speed));
    }
    if slip_angle.abs() > SLIDING {
        source.note(node, format!("has a slip angle of {slip_angle} rad; the vehicle starts along its orientation"));
    }
    #[allow(clippy::cast_possible_truncation)] // whole and at most 1e9
    Ok(InitialState {
        centre: Pose { position: state.position, yaw: state.yaw.unwrap_or(0.0) },
        speed,
        acceleration: acceleration?,
        yaw_rate: yaw_rate?,
        time_step: state.step as i64,
    })
}

fn goal(source: &mut Source, node: Node, network: &Network, time_step: f64) -> Read<Goal> {
    source.note_unknown(node, &["position", "time", "velocity", "orientation"]);
    let steps = source.required(node, "time", state::steps);
    let position = source.optional(node, "position", |source, n| position(source, n, network));
    let speed = source.optional(node, "velocity", state::values);
    let yaw = source.optional(node, "orientation", state::angles);
    let steps = steps?;
    let time = Interval { min: steps.min * time_step, max: steps.max * time_step };
    Ok(Goal { position: position?, time, speed: speed?, yaw: yaw? })
}

/// The region of a goal: lanelets by reference, or shapes.
fn position(source: &mut Source, node: Node, network: &Network) -> Read<GoalPosition> {
    if child(node, "lanelet").is_none() {
        return shape::read(source, node).map(GoalPosition::Shapes);
    }
    let ids = source.references(node, "lanelet")?;
    let (lanelets, missing): (Vec<_>, Vec<_>) = ids.iter().copied().partition(|id| network.may_have(*id));
    if lanelets.is_empty() {
        let ids = missing.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        let place = source.place(node);
        return Err(source.report(ElementError::NoSuchLanelet { place, ids }));
    }
    for (reference, id) in children(node, "lanelet").zip(&ids).filter(|(_, id)| missing.contains(id)) {
        source.note(reference, format!("refers to lanelet {id}, which does not exist; left out"));
    }
    if shape::is_region(node) {
        source.note(node, "has lanelets and shapes; the shapes are left out");
    }
    Ok(GoalPosition::Lanelets(lanelets))
}
