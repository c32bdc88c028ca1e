//! Scenes of these tests, and what every run has to keep.

use stopline::drive::{Run, Settings, drive};
use stopline::fixtures::{goal, network, parked, problem, scenario, straight_lanelet};
use stopline::geometry::Pose;
use stopline::map::{Neighbour, Obstacle, RoadNetwork, Scenario};
use stopline::planner::Plan;
use stopline::vehicle::{ProofLimits, Vehicle};
use stopline::verdict::{Check, Status};

/// Where the vehicle's centre starts, m.
pub(crate) const START: f64 = 30.0;
/// Id of the obstacle ahead.
pub(crate) const WALL: i64 = 77;

/// A lane of a width (m) along x, its middle on y = 0, and a second one to its left if asked for. 300 m long.
pub(crate) fn lanes(width: f64, has_left: bool) -> RoadNetwork {
    let half = 0.5 * width;
    let mut right = straight_lanelet(1, (0.0, 300.0), -half, half);
    let mut left = straight_lanelet(2, (0.0, 300.0), half, half + width);
    right.adjacent_left = has_left.then_some(Neighbour { id: 2, same_direction: true });
    left.adjacent_right = Some(Neighbour { id: 1, same_direction: true });
    network(std::iter::once(right).chain(has_left.then_some(left)))
}

/// From [`START`] at a speed (m/s) to a goal 170 m ahead.
pub(crate) fn scene(network: RoadNetwork, speed: f64, obstacles: Vec<Obstacle>) -> Scenario {
    let goal = goal(Pose::new(START + 170.0, 0.0, 0.0), 6.0, 3.5, 60.0);
    Scenario { problems: vec![problem(Pose::new(START, 0.0, 0.0), speed, goal)], ..scenario(network, obstacles) }
}

/// A static obstacle of 4.5 m whose rear is at a distance ahead of the front bumper, its middle at a lateral position, m.
pub(crate) fn in_front(vehicle: &Vehicle, distance: f64, y: f64, width: f64) -> Obstacle {
    parked(WALL, Pose::new(START + 0.5 * vehicle.length + distance + 2.25, y, 0.0), 4.5, width)
}

/// A lane of 3.5 m with a wall over all of it.
pub(crate) fn before_a_wall(vehicle: &Vehicle, speed: f64, distance: f64) -> Scenario {
    scene(lanes(3.5, false), speed, vec![in_front(vehicle, distance, 0.0, 20.0)])
}

/// Drives with a friction that the planner knows, at the longest until a time, s.
pub(crate) fn driven_until<'a>(scenario: &'a Scenario, vehicle: &'a Vehicle, friction: f64, longest: f64) -> Run<'a> {
    let mut settings = Settings::default();
    settings.simulation.friction_scale = friction;
    settings.run.longest = longest;
    drive(scenario, &scenario.problems[0], vehicle, &settings, &mut |_, _| {}).unwrap()
}

/// Drives on a dry road to the end.
pub(crate) fn driven<'a>(scenario: &'a Scenario, vehicle: &'a Vehicle) -> Run<'a> {
    driven_until(scenario, vehicle, 1.0, 60.0)
}

pub(crate) fn check(run: &Run, name: &str) -> Check {
    run.verdict.checks.iter().find(|c| c.name == name).unwrap().clone()
}

/// Number of cycles without a proof.
pub(crate) fn unproven(run: &Run) -> usize {
    run.cycles.iter().filter(|c| !c.plan.level.is_proven()).count()
}

/// What a run among static obstacles breaks of the claims of its plans: a contact after a proof, a fallback that does not stop as
/// claimed, something inside claimed margins, braking beyond the claimed deceleration, a road left farther than the start was.
pub(crate) fn broken_claims(run: &Run, case: &str) -> Vec<String> {
    let checks = ["fallback_stops", "claims_margin", "claims_deceleration", "stays_on_road"];
    let failed = checks.map(|name| check(run, name)).into_iter().filter(|c| c.status == Status::Fail);
    let mut broken: Vec<String> = failed.map(|c| format!("{case}: {}: {}", c.name, c.note)).collect();
    let proven = run.cycles.len() - unproven(run);
    if let Some(contact) = run.log.contact.filter(|_| proven > 0) {
        broken.push(format!("{case}: {:?} after {proven} of {} proven cycles", contact.with, run.cycles.len()));
    }
    broken
}

/// Largest deceleration of a plan, m/s².
pub(crate) fn hardest_braking(plan: &Plan) -> f64 {
    let knots = plan.trajectory.profile.knots();
    let at_ends = knots.windows(2).flat_map(|k| [k[0], k[0].after((k[1].time - k[0].time) * (1.0 - 1e-9))]);
    at_ends.map(|k| -k.acceleration).fold(0.0, f64::max)
}

/// The distance (m) that a vehicle needs for a stop with the hardest braking of a proof: that of the hardest level, within brakes and
/// grip, after the lag of the brakes.
pub(crate) fn hardest_stop(vehicle: &Vehicle, speed: f64, friction: f64) -> f64 {
    let hardest = stopline::planner::Settings::default().emergency.iter().map(|e| e.deceleration).fold(0.0, f64::max);
    let braking = ProofLimits::new(vehicle, friction).deceleration().min(hardest);
    speed * vehicle.actuators.brake_lag + speed * speed / (2.0 * braking)
}
