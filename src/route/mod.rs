//! Routes over lanelets, from the vehicle to the goal, as lane corridors that the planner chooses from.
//!
//! The lane graph ([`LaneGraph`]) has drivable lanelets as nodes and successors and lane changes as edges. A* finds the
//! cheapest path from the vehicle's lanelet to the goal. One backward search gives the cost to go from every lanelet, so
//! that each corridor takes the branches towards the goal and has its number of remaining lane changes. Without a goal
//! position, a corridor follows its lane by the straightest continuation that is long enough.
//!
//! Limits: a lane change has a constant cost, so several of them on one short lanelet cost as much as on a long one.
//! Traffic and speed limits do not affect the cost. A goal behind the vehicle on the same lanelet counts as reached
//! lanelet, with a goal station behind the vehicle; no route leads around to it.

mod chain;
pub mod explain;
mod goal;
mod graph;

pub use graph::{LaneGraph, LanePath, Link};

use std::collections::BTreeMap;

use crate::geometry::{Point, Pose, wrap_angle};
use crate::map::{Goal, Interval, LaneletId, RoadNetwork};
use chain::Guide;
use goal::{GoalSpans, goal_spans};

/// Extent of the corridors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RouteSettings {
    /// Least length ahead of the vehicle, m, if the road is long enough. A corridor ends at the end of a lanelet.
    pub look_ahead: f64,
    /// Least length behind the vehicle, m, so that the rear axle and kept plan prefixes project onto the corridor.
    pub look_behind: f64,
    /// Largest distance of a start from the bounds of the nearest lanelet, m, if it is outside of all lanelets.
    pub snap_distance: f64,
}

impl Default for RouteSettings {
    fn default() -> Self {
        Self { look_ahead: 200.0, look_behind: 25.0, snap_distance: 5.0 }
    }
}

/// Outcome of planning a route. None of these is an error.
#[derive(Debug, Clone, PartialEq)]
pub enum RouteOutcome {
    /// A route to the goal, or along the lane if no goal has a position.
    Found(Route),
    /// No lanelet of the goal can be reached. The route follows the current lane.
    Unreachable(Route),
    /// The start is neither on nor near a drivable lanelet of its direction.
    OffRoad,
}

impl RouteOutcome {
    /// The route; `None` if there is none.
    #[must_use]
    pub fn route(&self) -> Option<&Route> {
        match self {
            Self::Found(route) | Self::Unreachable(route) => Some(route),
            Self::OffRoad => None,
        }
    }
}

/// A route.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// The lanelets of the cheapest path to the goal, including lane changes. Without a goal, those of the current corridor.
    pub lanelets: Vec<LaneletId>,
    /// Corridors: the current lane first, then the adjacent lanes, left before right.
    pub lanes: Vec<LaneOption>,
    /// Distance of the start from its lanelet, m; 0 inside.
    pub start_outside: f64,
}

/// Position of a corridor relative to the vehicle's lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The lane the vehicle is on.
    Current,
    /// The next lane to the left, same direction.
    Left,
    /// The next lane to the right, same direction.
    Right,
}

/// A lane corridor: a chain of lanelets, each a successor of the one before. Stations are arc lengths along the joined
/// centre lines from the first point of the chain, m.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneOption {
    /// The chain in driving order. It starts behind the vehicle, if the road does.
    pub lanelets: Vec<LaneletId>,
    /// Position relative to the vehicle's lane.
    pub side: Side,
    /// Station of the start position. Negative, at least -30 m, on an adjacent lane that begins ahead of the vehicle.
    pub start_station: f64,
    /// Length of the chain, m.
    pub length: f64,
    /// Remaining lane changes from this lane to the goal. `None` without a goal, or if it cannot be reached.
    pub lane_changes_to_go: Option<u32>,
    /// Station up to which the goal can be reached from this chain. The vehicle must leave the lane before it if it is less
    /// than `length`. `None` without a goal, or if it cannot be reached from anywhere on the chain.
    pub leave_by: Option<f64>,
    /// The first section of the chain's centre line ahead that is inside a goal region (of the vehicle's centre).
    pub goal: Option<GoalSpan>,
}

/// A section of a chain inside a goal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalSpan {
    /// Stations of its near and far end, m.
    pub stations: Interval,
    /// Centre-line point at the near end, for projection onto a smoothed line.
    pub near: Point,
    /// Centre-line point at the far end.
    pub far: Point,
}

/// A lanelet that the vehicle may be on.
#[derive(Debug, Clone, Copy)]
struct Footing {
    id: LaneletId,
    /// Station of the vehicle on its centre line, m.
    station: f64,
    /// Cost of the deviation from the lane's direction and centre line, as metres of detour.
    misfit: f64,
    /// Distance outside of the lanelet, m.
    outside: f64,
}

/// Plans a route from the pose of the vehicle's centre to any of the goals. If no goal has a position, the route follows
/// the lane.
#[must_use]
pub fn plan(network: &RoadNetwork, start: &Pose, goals: &[Goal], settings: &RouteSettings) -> RouteOutcome {
    let graph = LaneGraph::new(network);
    let footings = footings(network, start, settings.snap_distance);
    let has_position = goals.iter().any(|g| g.position.is_some());
    let spans = goal_spans(network, goals);
    let targets: Vec<LaneletId> = spans.keys().copied().collect();
    let costs = graph.costs_to_go(&targets);
    let price = |f: &Footing| {
        let to_goal = costs.get(&f.id).map(|cost| (cost - f.station).max(0.0));
        f.misfit + if has_position { to_goal.unwrap_or(UNREACHABLE_COST) } else { 0.0 }
    };
    let Some(footing) = footings.iter().min_by(|a, b| price(a).total_cmp(&price(b))) else {
        return RouteOutcome::OffRoad;
    };

    let guide = Guide { network, graph: &graph, costs: &costs };
    let lanes = corridors(&guide, footing, start, &spans, settings);
    let path = graph.shortest(footing.id, &targets);
    let is_reachable = path.is_some();
    let lanelets = path.map(|p| p.lanelets).or_else(|| lanes.first().map(|l| l.lanelets.clone())).unwrap_or_default();
    let route = Route { lanelets, lanes, start_outside: footing.outside };
    if is_reachable || !has_position { RouteOutcome::Found(route) } else { RouteOutcome::Unreachable(route) }
}

/// Cost above that of any path through a map, m, so that a lanelet from which the goal can be reached is preferred.
const UNREACHABLE_COST: f64 = 1e6;
/// Cost of a heading error, metres of detour per radian. It distinguishes lanelets that overlap in a junction.
const MISFIT_PER_RADIAN: f64 = 60.0;
/// Cost of a lateral offset, metres of detour per metre.
const MISFIT_PER_METRE: f64 = 10.0;

/// The drivable lanelets of the start's direction that contain it, or else the nearest ones.
fn footings(network: &RoadNetwork, start: &Pose, snap_distance: f64) -> Vec<Footing> {
    let footing = |lanelet: &crate::map::Lanelet| {
        let foot = lanelet.centre.project(start.position);
        let off = wrap_angle(start.yaw - lanelet.centre.yaw_at(foot.station)).abs();
        if !lanelet.is_drivable() || off > std::f64::consts::FRAC_PI_2 {
            return None;
        }
        let outside = if lanelet.contains(start.position) {
            0.0
        } else {
            let to = |bound: &crate::geometry::polyline::Polyline| bound.project(start.position).offset.abs();
            to(&lanelet.left).min(to(&lanelet.right))
        };
        let misfit = MISFIT_PER_RADIAN * off + MISFIT_PER_METRE * foot.offset.abs();
        Some(Footing { id: lanelet.id, station: foot.station, misfit, outside })
    };
    let all: Vec<Footing> = network.lanelets.values().filter_map(footing).collect();
    let inside: Vec<Footing> = all.iter().filter(|f| f.outside == 0.0).copied().collect();
    if !inside.is_empty() {
        return inside;
    }
    let nearest = all.iter().map(|f| f.outside).fold(f64::INFINITY, f64::min);
    // lanelets that share the nearest bound are equally near
    all.into_iter().filter(|f| f.outside <= snap_distance && f.outside <= nearest + 1e-6).collect()
}

/// Largest distance to the beginning of an adjacent lane, m; a lane that begins farther ahead is no option yet.
const FARTHEST_BEGINNING: f64 = 30.0;

/// The corridor of the current lane and those of the adjacent lanes.
fn corridors(
    guide: &Guide<'_>,
    footing: &Footing,
    start: &Pose,
    spans: &GoalSpans,
    settings: &RouteSettings,
) -> Vec<LaneOption> {
    let ahead = footing.station + settings.look_ahead;
    let current = guide.forwards(footing.id, ahead);
    let mut lanes = vec![option(guide, Side::Current, &current, footing.station, start, spans, settings)];
    for side in [Side::Left, Side::Right] {
        // an adjacent lane may begin further ahead
        let beside = current.iter().find_map(|id| {
            let lanelet = guide.network.lanelets.get(id)?;
            let neighbour = if side == Side::Left { lanelet.adjacent_left } else { lanelet.adjacent_right };
            neighbour.filter(|n| n.same_direction && guide.graph.contains(n.id) && !current.contains(&n.id))
        });
        if let Some(neighbour) = beside {
            let foot =
                guide.network.lanelets.get(&neighbour.id).map_or(0.0, |l| l.centre.project(start.position).station);
            let chain = guide.forwards(neighbour.id, foot + settings.look_ahead);
            let lane = option(guide, side, &chain, foot, start, spans, settings);
            if lane.start_station >= -FARTHEST_BEGINNING {
                lanes.push(lane);
            }
        }
    }
    lanes
}

/// Completes the chain ahead to a corridor: road behind, stations and goal.
fn option(
    guide: &Guide<'_>,
    side: Side,
    ahead: &[LaneletId],
    station_on_first: f64,
    start: &Pose,
    spans: &GoalSpans,
    settings: &RouteSettings,
) -> LaneOption {
    let first = ahead.first().copied();
    let behind = first.map_or(Vec::new(), |id| guide.backwards(id, settings.look_behind - station_on_first, ahead));
    let lanelets: Vec<LaneletId> = behind.iter().chain(ahead).copied().collect();
    let centre = |id: &LaneletId| guide.network.lanelets.get(id).map(|l| &l.centre);
    let starts: Vec<f64> = lanelets
        .iter()
        .scan(0.0, |sum, id| {
            let start = *sum;
            *sum += centre(id).map_or(0.0, crate::geometry::polyline::Polyline::length);
            Some(start)
        })
        .collect();
    let length_of = |id: &LaneletId| centre(id).map_or(0.0, crate::geometry::polyline::Polyline::length);
    let length = lanelets.iter().map(length_of).sum();
    let before = starts.get(behind.len()).copied().unwrap_or(0.0);
    // on a lane that begins further ahead, the vehicle is on the road behind it: project onto that road, too
    let start_station = lanelets
        .iter()
        .zip(&starts)
        .take(behind.len() + 1)
        .filter_map(|(id, at)| centre(id).map(|c| (at, c.project(start.position))))
        .min_by(|a, b| a.1.offset.abs().total_cmp(&b.1.offset.abs()))
        .map_or(before + station_on_first, |(at, foot)| at + foot.station);
    // for a chain that begins ahead of the vehicle: the station on its straight extension backwards
    let shortfall = lanelets.first().and_then(centre).map_or(0.0, |c| {
        let begin = Pose { position: c.first(), yaw: c.yaw_at(0.0) };
        begin.to_local(start.position).x.min(0.0)
    });
    let start_station = if start_station == 0.0 { shortfall } else { start_station };
    let leave_by = lanelets
        .iter()
        .zip(&starts)
        .rev()
        .find(|(id, _)| guide.costs.contains_key(id))
        .map(|(id, start)| start + length_of(id));
    let lane_changes_to_go = first.and_then(|id| guide.lane_changes(id));
    LaneOption {
        goal: goal_on_chain(guide, &lanelets, &starts, start_station, spans),
        lanelets,
        side,
        start_station,
        length,
        lane_changes_to_go,
        leave_by,
    }
}

/// The first section of the chain inside a goal whose far end is not behind the start. Sections of successive lanelets are
/// joined.
fn goal_on_chain(
    guide: &Guide<'_>,
    lanelets: &[LaneletId],
    starts: &[f64],
    start_station: f64,
    spans: &BTreeMap<LaneletId, Interval>,
) -> Option<GoalSpan> {
    /// Largest gap between sections that are joined, m: goal regions are sampled every 0.25 m.
    const SAME_SECTION: f64 = 0.6;
    let mut section: Option<GoalSpan> = None;
    for (id, start) in lanelets.iter().zip(starts) {
        let (Some(span), Some(lanelet)) = (spans.get(id), guide.network.lanelets.get(id)) else { continue };
        let stations = Interval { min: start + span.min, max: start + span.max };
        let far = lanelet.centre.at(span.max);
        match &mut section {
            Some(goal) if stations.min <= goal.stations.max + SAME_SECTION => {
                goal.stations.max = stations.max;
                goal.far = far;
            }
            Some(_) => break,
            None if stations.max < start_station => {}
            None => section = Some(GoalSpan { stations, near: lanelet.centre.at(span.min), far }),
        }
    }
    section
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{self, follow, lanelet, two_lane_road};
    use crate::geometry::polyline::Polyline;
    use crate::map::{GoalPosition, Lanelet};

    fn goal_at(x: f64, y: f64) -> Goal {
        fixtures::goal(Pose::new(x, y, 0.0), 10.0, 3.0, 10.0)
    }

    fn goal(position: Option<GoalPosition>) -> Goal {
        Goal { position, ..goal_at(0.0, 0.0) }
    }

    fn found(outcome: RouteOutcome) -> Route {
        match outcome {
            RouteOutcome::Found(route) => route,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_goal_on_the_other_lane_needs_one_lane_change() {
        let network = two_lane_road(5);
        let settings = RouteSettings { look_ahead: 150.0, ..RouteSettings::default() };
        let route = found(plan(&network, &Pose::new(60.0, 0.3, 0.0), &[goal_at(170.0, 3.5)], &settings));
        assert_eq!(route.lanes.len(), 2);
        let (current, left) = (&route.lanes[0], &route.lanes[1]);
        assert_eq!((current.side, left.side), (Side::Current, Side::Left));
        assert_eq!(current.lanelets, [100, 101, 102, 103, 104], "from behind the vehicle to 150 m ahead");
        assert_eq!((current.lane_changes_to_go, left.lane_changes_to_go), (Some(1), Some(0)));
        assert!((current.start_station - 60.0).abs() < 1e-9);
        assert!(current.goal.is_none());
        let goal = left.goal.unwrap();
        assert!((goal.stations.min - 165.0).abs() < 0.3 && (goal.stations.max - 175.0).abs() < 0.3, "{goal:?}");
        assert!((goal.near - Point::new(165.0, 3.5)).norm() < 0.3);
        assert_eq!(current.leave_by, Some(200.0), "on lanelet 104 the goal is behind");
    }

    #[test]
    fn joins_a_goal_over_two_lanelets() {
        let route = found(plan(
            &two_lane_road(5),
            &Pose::new(10.0, 0.0, 0.0),
            &[goal_at(100.0, 0.0)],
            &RouteSettings::default(),
        ));
        let span = route.lanes[0].goal.unwrap().stations;
        assert!((span.min - 95.0).abs() < 0.3 && (span.max - 105.0).abs() < 0.3, "{span:?}");
    }

    #[test]
    fn a_goal_of_lanelets_spans_them() {
        let goal = goal(Some(GoalPosition::Lanelets(vec![102, 103, 777])));
        let route = found(plan(&two_lane_road(5), &Pose::new(10.0, 0.0, 0.0), &[goal], &RouteSettings::default()));
        assert_eq!(route.lanelets, [100, 101, 102]);
        let span = route.lanes[0].goal.unwrap().stations;
        assert_eq!((span.min, span.max), (100.0, 200.0));
    }

    #[test]
    fn follows_the_lane_without_a_goal_position() {
        let settings = RouteSettings { look_ahead: 60.0, ..RouteSettings::default() };
        let route = found(plan(&two_lane_road(5), &Pose::new(60.0, 3.4, 0.1), &[goal(None)], &settings));
        assert_eq!(route.lanes[0].lanelets, [200, 201, 202]);
        assert_eq!(route.lanes[0].lane_changes_to_go, None);
        assert_eq!(route.lanes[1].side, Side::Right);
    }

    #[test]
    fn goes_straight_at_a_branch_without_a_goal() {
        let mut network = two_lane_road(3);
        // 300 turns right after 100
        let bend = |offset: f64| {
            Polyline::new((0..=10).map(|i| {
                let a = std::f64::consts::FRAC_PI_2 * f64::from(i) / 10.0;
                Point::new(50.0 + (20.0 + offset) * a.sin(), -20.0 + (20.0 + offset) * a.cos())
            }))
            .unwrap()
        };
        let side_road = Lanelet { centre: bend(0.0), ..lanelet(300, bend(-1.75), bend(1.75)) };
        network.lanelets.insert(300, side_road);
        network.lanelets.get_mut(&100).unwrap().successors.insert(0, 300);
        let settings = RouteSettings { look_ahead: 100.0, ..RouteSettings::default() };
        let start = Pose::new(10.0, 0.0, 0.0);
        let route = found(plan(&network, &start, &[], &settings));
        assert_eq!(route.lanes[0].lanelets, [100, 101, 102]);
        // with a goal on the branch, the route takes it
        let goals = [goal(Some(GoalPosition::Lanelets(vec![300])))];
        let route = found(plan(&network, &start, &goals, &settings));
        assert_eq!(route.lanes[0].lanelets, [100, 300]);
    }

    #[test]
    fn chooses_between_overlapping_lanelets_by_heading_and_goal() {
        let mut network = two_lane_road(2);
        // a diverging lanelet over the same area, rotated by 0.3 rad to the left
        let (sin, cos) = 0.3_f64.sin_cos();
        let line = |offset: f64| {
            Polyline::new([0.0, 40.0].map(|s| Point::new(s * cos - offset * sin, s * sin + offset * cos))).unwrap()
        };
        let diverging = Lanelet { centre: line(0.0), ..lanelet(400, line(-1.75), line(1.75)) };
        network.lanelets.insert(400, diverging);
        let plan_at = |yaw: f64, goals: &[Goal]| {
            let route = found(plan(&network, &Pose::new(2.0, 0.3, yaw), goals, &RouteSettings::default()));
            route.lanelets[0]
        };
        assert_eq!(plan_at(0.0, &[]), 100);
        assert_eq!(plan_at(0.3, &[]), 400);
        assert_eq!(plan_at(0.0, &[goal(Some(GoalPosition::Lanelets(vec![400])))]), 400);
    }

    #[test]
    fn a_start_against_the_lane_direction_is_off_road() {
        let network = two_lane_road(2);
        let settings = RouteSettings::default();
        assert_eq!(plan(&network, &Pose::new(10.0, 0.0, std::f64::consts::PI), &[], &settings), RouteOutcome::OffRoad);
    }

    #[test]
    fn snaps_a_start_beside_the_road_but_not_a_far_one() {
        let network = two_lane_road(2);
        let settings = RouteSettings::default();
        let route = found(plan(&network, &Pose::new(10.0, -3.75, 0.0), &[], &settings));
        assert_eq!(route.lanes[0].lanelets[0], 100);
        assert!((route.start_outside - 2.0).abs() < 1e-9);
        assert_eq!(plan(&network, &Pose::new(10.0, -30.0, 0.0), &[], &settings), RouteOutcome::OffRoad);
        assert_eq!(plan(&network, &Pose::new(f64::NAN, 0.0, 0.0), &[], &settings), RouteOutcome::OffRoad);
        assert_eq!(plan(&RoadNetwork::default(), &Pose::new(0.0, 0.0, 0.0), &[], &settings), RouteOutcome::OffRoad);
    }

    #[test]
    fn an_unreachable_goal_gives_the_current_lane() {
        let network = two_lane_road(3);
        let start = Pose::new(110.0, 0.0, 0.0);
        let outcome = plan(&network, &start, &[goal_at(20.0, 0.0)], &RouteSettings::default());
        let RouteOutcome::Unreachable(route) = outcome else { panic!("{outcome:?}") };
        assert_eq!(route.lanes[0].lane_changes_to_go, None);
        let off_road = plan(&network, &start, &[goal_at(0.0, 900.0)], &RouteSettings::default());
        assert!(matches!(off_road, RouteOutcome::Unreachable(_)));
    }

    #[test]
    fn a_chain_ends_when_a_ring_closes() {
        let mut network = two_lane_road(2);
        follow(&mut network, 101, 100);
        let route = found(plan(&network, &Pose::new(10.0, 0.0, 0.0), &[], &RouteSettings::default()));
        assert_eq!(route.lanes[0].lanelets, [100, 101]);
    }

    /// Every real scenario gets an outcome; where there is a route, its chains are connected.
    #[test]
    fn real_scenarios_have_connected_corridors() {
        let Some(folder) = crate::reference::tests::real_data("commonroad") else { return };
        let (mut found, mut unreachable, mut off_road) = (0, Vec::new(), Vec::new());
        for (name, scenario) in crate::reference::tests::real_scenarios(&folder) {
            for problem in &scenario.problems {
                let outcome =
                    plan(&scenario.network, &problem.initial.centre, &problem.goals, &RouteSettings::default());
                match &outcome {
                    RouteOutcome::Found(_) => found += 1,
                    RouteOutcome::Unreachable(_) => unreachable.push(name.clone()),
                    RouteOutcome::OffRoad => off_road.push(name.clone()),
                }
                for lane in outcome.route().iter().flat_map(|r| &r.lanes) {
                    for pair in lane.lanelets.windows(2) {
                        assert!(scenario.network.lanelets[&pair[0]].successors.contains(&pair[1]), "{name}: {lane:?}");
                    }
                    assert!(lane.start_station >= -FARTHEST_BEGINNING && lane.start_station <= lane.length);
                }
            }
        }
        println!("{found} found, unreachable: {unreachable:?}, off road: {off_road:?}");
        assert!(found > 60);
    }
}
