//! The lanes of the route, each with its reference line, goal and cached lattice edges.

use super::goal::GoalOnLane;
use crate::geometry::steps::fitting;
use crate::geometry::{Point, Pose};
use crate::lattice::{EdgeStore, Target};
use crate::map::{Goal, Lanelet, LaneletId, PlanningProblem, RoadNetwork, Scenario};
use crate::reference::ReferenceLine;
use crate::route::{self, LaneOption, RouteOutcome, RouteSettings, Side};
use crate::vehicle::Vehicle;

/// A lane that the planner may follow.
pub(super) struct Lane {
    pub(super) reference: ReferenceLine,
    /// The last lanelet of the reference line.
    last_lanelet: LaneletId,
    /// Samples of the reference line, for records.
    pub(super) samples: Vec<Point>,
    /// Whether the vehicle was on this lane when the route was planned.
    pub(super) is_current: bool,
    /// Number of lane changes from this lane that the route still needs.
    pub(super) lane_changes_to_go: u32,
    pub(super) goal: Option<GoalOnLane>,
    /// Last station before a goal on another lane is missed, m.
    pub(super) goal_missed_at: Option<f64>,
    /// Latest time at which the goal can be reached, s of the run; infinite without a goal position.
    pub(super) goal_deadline: f64,
    /// Station intervals in which stopping is not allowed, m.
    pub(super) no_stopping: Vec<(f64, f64)>,
    /// Cached lattice edges.
    pub(super) edges: EdgeStore,
}

/// Why there is no lane to drive on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoLane {
    /// The start is neither on a lane nor near one.
    StartOffRoad,
    /// The lane graph has no path to the goal.
    GoalUnreachable,
    /// No lane of the route has a reference line.
    NoReference,
}

impl NoLane {
    /// Every reason.
    pub const ALL: [Self; 3] = [Self::StartOffRoad, Self::GoalUnreachable, Self::NoReference];

    /// The stable code used in reports.
    #[must_use]
    pub fn code(self) -> &'static str {
        match self {
            Self::StartOffRoad => "start_off_road",
            Self::GoalUnreachable => "goal_unreachable",
            Self::NoReference => "no_reference_line",
        }
    }

    /// The positions and lanelets behind the reason, as a sentence; `None` if there is nothing to add to the code.
    #[must_use]
    pub fn detail(self, scenario: &Scenario, problem: &PlanningProblem) -> Option<String> {
        let (network, start, settings) = (&scenario.network, &problem.initial.centre, route_settings());
        match self {
            Self::StartOffRoad => Some(route::explain::off_road(network, start, &settings)),
            Self::GoalUnreachable => Some(route::explain::unreachable(network, start, &problem.goals, &settings)),
            Self::NoReference => None,
        }
    }
}

/// Length of the route ahead, m.
const LOOK_AHEAD: f64 = 450.0;

fn route_settings() -> RouteSettings {
    RouteSettings { look_ahead: LOOK_AHEAD, ..RouteSettings::default() }
}

impl Lane {
    /// The lanes of the route from a pose of the vehicle's centre.
    pub(super) fn all(
        network: &RoadNetwork,
        goals: &[Goal],
        centre: &Pose,
        vehicle: &Vehicle,
    ) -> Result<Vec<Self>, NoLane> {
        let found = match route::plan(network, centre, goals, &route_settings()) {
            RouteOutcome::Found(route) => route,
            RouteOutcome::Unreachable(_) => return Err(NoLane::GoalUnreachable),
            RouteOutcome::OffRoad => return Err(NoLane::StartOffRoad),
        };
        let goal_known = found.lanes.iter().any(|l| l.lane_changes_to_go.is_some());
        let lanes: Vec<Self> = found
            .lanes
            .iter()
            .filter(|option| !goal_known || option.lane_changes_to_go.is_some())
            .filter_map(|option| Self::new(network, goals, vehicle, option))
            .collect();
        let mut lanes = lanes;
        Self::mark_missed_goal(&mut lanes);
        if lanes.is_empty() { Err(NoLane::NoReference) } else { Ok(lanes) }
    }

    /// Sets the station at which a goal on another lane is missed.
    fn mark_missed_goal(lanes: &mut [Self]) {
        let Some(point) = lanes.iter().find_map(|l| {
            let goal = l.goal.as_ref()?;
            let station = if goal.is_stop() { goal.stop_station() } else { goal.far };
            Some(l.reference.at(station).pose.position)
        }) else {
            return;
        };
        for lane in lanes.iter_mut().filter(|l| l.goal.is_none()) {
            lane.goal_missed_at = Some(lane.reference.project(point).s);
        }
    }

    /// The poses that meet the goal.
    pub(super) fn target(&self) -> Option<Target> {
        self.goal.and_then(|goal| goal.target)
    }

    /// Whether the road continues beyond the end of the reference line.
    pub(super) fn goes_on(&self, network: &RoadNetwork) -> bool {
        network.lanelets.get(&self.last_lanelet).is_some_and(|l| !l.successors.is_empty())
    }

    fn new(network: &RoadNetwork, goals: &[Goal], vehicle: &Vehicle, option: &LaneOption) -> Option<Self> {
        let settings = crate::reference::ReferenceSettings::default();
        let lanelets = joined(network, &option.lanelets);
        let reference = ReferenceLine::new(network, lanelets, vehicle.width, &settings).ok()?;
        let goal = goals.iter().find_map(|g| GoalOnLane::find(g, network, &reference, vehicle));
        let is_current = option.side == Side::Current;
        let count = fitting(reference.length(), 2.0);
        Some(Self {
            samples: (0..=count).map(|i| reference.at(2.0 * i as f64).pose.position).collect(),
            no_stopping: kept_free(network, &reference, vehicle),
            lane_changes_to_go: option.lane_changes_to_go.unwrap_or(u32::from(!is_current)),
            edges: EdgeStore::default(),
            last_lanelet: *lanelets.last()?,
            goal_missed_at: None,
            goal_deadline: deadline(goals),
            is_current,
            goal,
            reference,
        })
    }
}

/// The latest time at which a goal with a position can be reached, s; infinite if no goal has one.
fn deadline(goals: &[Goal]) -> f64 {
    let times = goals.iter().filter(|g| g.position.is_some()).map(|g| g.time.max);
    times.reduce(f64::max).unwrap_or(f64::INFINITY)
}

/// The lanelets of a chain up to the first gap: some files name successors that begin elsewhere, and a reference line must be
/// continuous.
fn joined<'a>(network: &RoadNetwork, chain: &'a [LaneletId]) -> &'a [LaneletId] {
    /// Larger distances between the end of a lanelet and its successor are gaps, m.
    const GAP: f64 = 3.0;
    let ends = |id: &LaneletId| network.lanelets.get(id).map(|l| (l.centre.first(), l.centre.last()));
    let gap = chain.windows(2).position(|pair| match (ends(&pair[0]), ends(&pair[1])) {
        (Some((_, end)), Some((start, _))) => (start - end).norm() > GAP,
        _ => true,
    });
    &chain[..gap.map_or(chain.len(), |i| i + 1)]
}

/// Station intervals of the line in which stopping is not allowed, for the rear axle: where a part of the vehicle is in a lanelet
/// that has to be kept free.
fn kept_free(network: &RoadNetwork, line: &ReferenceLine, vehicle: &Vehicle) -> Vec<(f64, f64)> {
    /// Sampling of the line, m.
    const STEP: f64 = 1.0;
    let front = vehicle.front_overhang_from_rear_axle();
    let rear = vehicle.length - front;
    let mut stretches: Vec<(f64, f64)> = Vec::new();
    for i in 0..=fitting(line.length(), STEP) {
        let station = i as f64 * STEP;
        let lanelet = line.lanelet_at(station).and_then(|id| network.lanelets.get(&id));
        if lanelet.is_some_and(Lanelet::is_kept_free) {
            let (from, to) = (station - STEP - front, station + STEP + rear);
            match stretches.last_mut() {
                Some(last) if from <= last.1 => last.1 = to,
                _ => stretches.push((from, to)),
            }
        }
    }
    stretches
}
