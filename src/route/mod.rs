//! Routes over lanelets: from where the vehicle is to the goal, as lane corridors for the planner to choose from.
//!
//! The lane graph ([`LaneGraph`]) has drivable lanelets as nodes and following and lane changes as edges. A* finds the
//! cheapest way from the lanelet the vehicle is on; one backward search gives the cost from every lanelet, so that each
//! corridor knows how to go on at branches and how many lane changes are left. Without a goal position the corridors
//! follow their lanes by the straightest continuation with road ahead.
//!
//! Weak: a lane change is priced by a constant, wherever it happens; several of them on one short lanelet look as easy
//! as one each. Traffic and speed limits do not matter to the cost. A goal behind the vehicle on its own lanelet is not
//! driven round to: it counts as reached lanelet, with a goal station behind the vehicle.

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

/// How far the corridors reach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RouteSettings {
    /// Road wanted ahead of the vehicle, m. Corridors end at the end of a lanelet, later than this if there is road.
    pub look_ahead: f64,
    /// Road wanted behind the vehicle, m, so that rear axle and stitched plans project cleanly.
    pub look_behind: f64,
    /// A start outside of all lanelets is taken to the nearest one within this distance of its bounds, m.
    pub snap_distance: f64,
}

impl Default for RouteSettings {
    fn default() -> Self {
        Self { look_ahead: 200.0, look_behind: 25.0, snap_distance: 5.0 }
    }
}

/// What planning a route came to. None of these is an error.
#[derive(Debug, Clone, PartialEq)]
pub enum RouteOutcome {
    /// A route: to the goal, or along the lane when no goal has a position.
    Found(Route),
    /// The goal lies on no lanelet that can be reached. The route follows the present lane.
    Unreachable(Route),
    /// The start is on no drivable lanelet of its direction, nor near one.
    OffRoad,
}

impl RouteOutcome {
    /// The route, when there is one to follow.
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
    /// The lanelets of the cheapest way to the goal, lane changes included; the current corridor's without a goal.
    pub lanelets: Vec<LaneletId>,
    /// Corridors to consider: the current lane first, then the lanes beside it, left before right.
    pub lanes: Vec<LaneOption>,
    /// How far the start lies outside of its lanelet, m; 0 inside.
    pub start_outside: f64,
}

/// Which lane a corridor is, seen from the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The lane the vehicle is on.
    Current,
    /// The next lane to the left, same direction.
    Left,
    /// The next lane to the right, same direction.
    Right,
}

/// A lane corridor: a chain of lanelets, each following the one before. Stations run along the joined centre lines from
/// the chain's first point, m.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneOption {
    /// The chain, in driving order; starts behind the vehicle where there is road.
    pub lanelets: Vec<LaneletId>,
    /// Which lane it is.
    pub side: Side,
    /// Station of the start position; negative, by 30 m at most, on a lane beside that begins only ahead of the vehicle.
    pub start_station: f64,
    /// Length of the chain.
    pub length: f64,
    /// Lane changes still needed from this lane to the goal. `None` without a goal or if it cannot be reached from here.
    pub lane_changes_to_go: Option<u32>,
    /// Up to this station the goal can still be reached from this chain: where that ends before the chain does, the lane
    /// must be left by then. `None` where the goal can be reached from nowhere on it, or there is none.
    pub leave_by: Option<f64>,
    /// Where the chain's centre line runs through the goal region (of the vehicle's centre), nearest one ahead.
    pub goal: Option<GoalSpan>,
}

/// A stretch of a chain inside a goal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalSpan {
    /// Stations of its near and far end.
    pub stations: Interval,
    /// Centre-line point at the near end, to project onto a smoothed line.
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
    /// Misfit: metres of detour that would be as bad.
    misfit: f64,
    /// Distance outside of the lanelet, m.
    outside: f64,
}

/// Plans a route from the vehicle's centre to the goals (alternatives). Goals without a position ask only to go on.
#[must_use]
pub fn plan(network: &RoadNetwork, start: &Pose, goals: &[Goal], settings: &RouteSettings) -> RouteOutcome {
    let graph = LaneGraph::new(network);
    let footings = footings(network, start, settings.snap_distance);
    let wanted = goals.iter().any(|g| g.position.is_some());
    let spans = goal_spans(network, goals);
    let targets: Vec<LaneletId> = spans.keys().copied().collect();
    let costs = graph.costs_to_go(&targets);
    let price = |f: &Footing| {
        let way = costs.get(&f.id).map(|cost| (cost - f.station).max(0.0));
        f.misfit + if wanted { way.unwrap_or(UNREACHABLE_COST) } else { 0.0 }
    };
    let Some(footing) = footings.iter().min_by(|a, b| price(a).total_cmp(&price(b))) else {
        return RouteOutcome::OffRoad;
    };

    let guide = Guide { network, graph: &graph, costs: &costs };
    let lanes = corridors(&guide, footing, start, &spans, settings);
    let way = graph.shortest(footing.id, &targets);
    let reachable = way.is_some();
    let lanelets = way.map(|w| w.lanelets).or_else(|| lanes.first().map(|l| l.lanelets.clone())).unwrap_or_default();
    let route = Route { lanelets, lanes, start_outside: footing.outside };
    if reachable || !wanted { RouteOutcome::Found(route) } else { RouteOutcome::Unreachable(route) }
}

/// More than any way through a map costs, m: a lanelet from which the goal is reached wins over one from which it is not.
const UNREACHABLE_COST: f64 = 1e6;
/// Metres of detour as bad as a radian of heading against the lane. Where lanelets overlap in a junction, their
/// directions tell them apart.
const MISFIT_PER_RADIAN: f64 = 60.0;
/// Metres of detour as bad as a metre beside the centre line.
const MISFIT_PER_METRE: f64 = 10.0;

/// The drivable lanelets that hold the start and run its way, or else the nearest ones.
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
    // lanelets that share the nearest bound are as near as each other
    all.into_iter().filter(|f| f.outside <= snap_distance && f.outside <= nearest + 1e-6).collect()
}

/// A lane beside that begins farther ahead than this is not offered yet, m.
const FARTHEST_BEGINNING: f64 = 30.0;

/// The current lane's corridor and those beside it.
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
        // the lane beside may begin only further on
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

/// A corridor from its chain ahead: road behind added, stations and goal measured.
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
    // projected on the whole of what is near: a lane that begins further on has the vehicle on the road behind it
    let start_station = lanelets
        .iter()
        .zip(&starts)
        .take(behind.len() + 1)
        .filter_map(|(id, at)| centre(id).map(|c| (at, c.project(start.position))))
        .min_by(|a, b| a.1.offset.abs().total_cmp(&b.1.offset.abs()))
        .map_or(before + station_on_first, |(at, foot)| at + foot.station);
    // a chain that begins ahead of the vehicle: on its straight continuation backwards
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

/// The first stretch of the chain inside a goal whose far end is not behind the start, joined over lanelet borders.
fn goal_on_chain(
    guide: &Guide<'_>,
    lanelets: &[LaneletId],
    starts: &[f64],
    start_station: f64,
    spans: &BTreeMap<LaneletId, Interval>,
) -> Option<GoalSpan> {
    /// Stretches closer than this are one, m: regions are tried every quarter of a metre.
    const SAME_STRETCH: f64 = 0.6;
    let mut found: Option<GoalSpan> = None;
    for (id, start) in lanelets.iter().zip(starts) {
        let (Some(span), Some(lanelet)) = (spans.get(id), guide.network.lanelets.get(id)) else { continue };
        let stations = Interval { min: start + span.min, max: start + span.max };
        let far = lanelet.centre.at(span.max);
        match &mut found {
            Some(goal) if stations.min <= goal.stations.max + SAME_STRETCH => {
                goal.stations.max = stations.max;
                goal.far = far;
            }
            Some(_) => break,
            None if stations.max < start_station => {}
            None => found = Some(GoalSpan { stations, near: lanelet.centre.at(span.min), far }),
        }
    }
    found
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
    fn goal_on_the_other_lane_asks_for_one_change_and_says_where_it_is() {
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
        assert_eq!(current.leave_by, Some(200.0), "from 104 on the goal is behind");
    }

    #[test]
    fn goal_over_a_lanelet_border_is_one_stretch() {
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
    fn goal_given_by_lanelets_spans_them() {
        let goal = goal(Some(GoalPosition::Lanelets(vec![102, 103, 777])));
        let route = found(plan(&two_lane_road(5), &Pose::new(10.0, 0.0, 0.0), &[goal], &RouteSettings::default()));
        assert_eq!(route.lanelets, [100, 101, 102]);
        let span = route.lanes[0].goal.unwrap().stations;
        assert_eq!((span.min, span.max), (100.0, 200.0));
    }

    #[test]
    fn without_a_position_the_lane_is_followed() {
        let settings = RouteSettings { look_ahead: 60.0, ..RouteSettings::default() };
        let route = found(plan(&two_lane_road(5), &Pose::new(60.0, 3.4, 0.1), &[goal(None)], &settings));
        assert_eq!(route.lanes[0].lanelets, [200, 201, 202]);
        assert_eq!(route.lanes[0].lane_changes_to_go, None);
        assert_eq!(route.lanes[1].side, Side::Right);
    }

    #[test]
    fn straight_on_wins_over_turning_off_unless_it_is_a_dead_end() {
        let mut network = two_lane_road(3);
        // 300 turns off to the right after 100
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
        // with a goal on the branch, the branch
        let goals = [goal(Some(GoalPosition::Lanelets(vec![300])))];
        let route = found(plan(&network, &start, &goals, &settings));
        assert_eq!(route.lanes[0].lanelets, [100, 300]);
    }

    #[test]
    fn overlapping_lanelets_are_told_apart_by_heading_and_goal() {
        let mut network = two_lane_road(2);
        // a diverging lanelet over the same ground, turned by 0.3 rad to the left
        let (sin, cos) = 0.3_f64.sin_cos();
        let line = |offset: f64| {
            Polyline::new([0.0, 40.0].map(|s| Point::new(s * cos - offset * sin, s * sin + offset * cos))).unwrap()
        };
        let across = Lanelet { centre: line(0.0), ..lanelet(400, line(-1.75), line(1.75)) };
        network.lanelets.insert(400, across);
        let plan_at = |yaw: f64, goals: &[Goal]| {
            let route = found(plan(&network, &Pose::new(2.0, 0.3, yaw), goals, &RouteSettings::default()));
            route.lanelets[0]
        };
        assert_eq!(plan_at(0.0, &[]), 100);
        assert_eq!(plan_at(0.3, &[]), 400);
        assert_eq!(plan_at(0.0, &[goal(Some(GoalPosition::Lanelets(vec![400])))]), 400);
    }

    #[test]
    fn opposite_lanes_are_not_for_starting() {
        let network = two_lane_road(2);
        let settings = RouteSettings::default();
        assert_eq!(plan(&network, &Pose::new(10.0, 0.0, std::f64::consts::PI), &[], &settings), RouteOutcome::OffRoad);
    }

    #[test]
    fn a_start_beside_the_road_is_taken_to_it_and_a_far_one_is_not() {
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
    fn an_unreachable_goal_is_an_outcome_with_a_lane_to_follow() {
        let network = two_lane_road(3);
        let start = Pose::new(110.0, 0.0, 0.0);
        let outcome = plan(&network, &start, &[goal_at(20.0, 0.0)], &RouteSettings::default());
        let RouteOutcome::Unreachable(route) = outcome else { panic!("{outcome:?}") };
        assert_eq!(route.lanes[0].lane_changes_to_go, None);
        let off_road = plan(&network, &start, &[goal_at(0.0, 900.0)], &RouteSettings::default());
        assert!(matches!(off_road, RouteOutcome::Unreachable(_)));
    }

    #[test]
    fn a_ring_ends_the_chain_instead_of_the_program() {
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
