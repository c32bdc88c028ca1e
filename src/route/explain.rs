//! Why there is no route: positions and lanelets, as sentences for reports.
//!
//! Everything here is computed again from the network, only for runs that end before they begin. The sentences name
//! lanelets by the ids of the file and give positions in its coordinates, m.

use std::collections::BTreeSet;

use super::{Footing, LaneGraph, RouteSettings, footings, goal_spans};
use crate::geometry::{Point, Pose, Vector, wrap_angle};
use crate::map::{ConvexPart, Goal, GoalPosition, Lanelet, LaneletId, RoadNetwork};

/// Says where a start lies for which [`plan`](super::plan) finds no lane, and why none fits.
#[must_use]
pub fn off_road(network: &RoadNetwork, start: &Pose, settings: &RouteSettings) -> String {
    let at = format!("the start {}", place(start.position));
    let Some((nearest, distance)) = nearest(network.lanelets.values(), start.position) else {
        return format!("{at} has no lanelet near it: the map has none");
    };
    let id = nearest.id;
    let heading = nearest.centre.yaw_at(nearest.centre.project(start.position).station);
    let off = wrap_angle(start.yaw - heading).abs().to_degrees();
    let relation = if distance > 0.0 {
        format!("is {distance:.1} m from the nearest lanelet, {id}")
    } else {
        format!("is inside lanelet {id}")
    };
    let reason = match () {
        () if distance > settings.snap_distance => {
            format!("; a start may be at most {} m outside of its lanelet", settings.snap_distance)
        }
        () if !nearest.is_drivable() => format!(", which is not for cars ({})", nearest.types.join(", ")),
        () => format!(", but the vehicle heads {off:.0}° away from the direction of that lanelet"),
    };
    format!("{at} {relation}{reason}")
}

/// Says where a goal lies that [`plan`](super::plan) finds no route to, and where the routes from the start lead instead.
#[must_use]
pub fn unreachable(network: &RoadNetwork, start: &Pose, goals: &[Goal], settings: &RouteSettings) -> String {
    let Some((at, position)) = goals.iter().find_map(|goal| located(network, goal)) else {
        return missing_lanelets(goals);
    };
    let targets: Vec<LaneletId> = goal_spans(network, goals).keys().copied().collect();
    let Some(&target) = targets.first() else {
        let drivable = network.lanelets.values().filter(|l| l.is_drivable());
        return match nearest(drivable, position) {
            Some((lanelet, distance)) => {
                format!(
                    "the goal {at} is on no drivable lanelet; the nearest is lanelet {}, {distance:.1} m away",
                    lanelet.id
                )
            }
            None => format!("the goal {at} is on no drivable lanelet: the map has none"),
        };
    };
    let footings = footings(network, start, settings.snap_distance);
    let Some(footing) = footings.iter().min_by(|a, b| a.misfit.total_cmp(&b.misfit)) else {
        return format!("the goal {at} is on lanelet {target}, the start on no lanelet");
    };
    let graph = LaneGraph::new(network);
    let from = footing.id;
    let reached = reachable(&graph, from);
    let between = format!("no route leads from the start's lanelet {from} to the goal {at} on lanelet {target}");
    if let Some((lanelet, beside)) = oncoming(network, &targets, &reached) {
        return format!("{between}: lanelet {lanelet} is the oncoming lane beside lanelet {beside}");
    }
    if is_behind(&graph, &targets, &footings) {
        return format!("{between}: the goal is behind the start, and no road leads back to it");
    }
    let candidates = reached.iter().filter_map(|id| network.lanelets.get(id));
    match nearest(candidates, position) {
        Some((lanelet, distance)) => {
            let count = reached.len();
            let id = lanelet.id;
            format!(
                "{between}: of the {count} lanelet(s) within reach, {id} is nearest to the goal, {distance:.1} m away"
            )
        }
        None => between,
    }
}

/// Goals whose lanelets are all missing from the map.
fn missing_lanelets(goals: &[Goal]) -> String {
    let ids = goals.iter().filter_map(|goal| match &goal.position {
        Some(GoalPosition::Lanelets(ids)) => Some(ids),
        _ => None,
    });
    let ids: Vec<String> = ids.flatten().map(ToString::to_string).collect();
    format!("the goal is on lanelet(s) {}, which the map does not have", ids.join(", "))
}

fn place(p: Point) -> String {
    format!("at ({:.1}, {:.1})", p.x, p.y)
}

/// A point of a goal's region and its description. `None` without a position, or if its lanelets are missing.
fn located(network: &RoadNetwork, goal: &Goal) -> Option<(String, Point)> {
    let point = match goal.position.as_ref()? {
        GoalPosition::Shapes(shape) => match shape.convex_parts().first()? {
            ConvexPart::Circle { centre, .. } => *centre,
            ConvexPart::Polygon(corners) => {
                let sum = corners.iter().fold(Vector::zeros(), |sum, corner| sum + corner.coords);
                #[allow(clippy::cast_precision_loss)] // a count of corners
                let count = corners.len().max(1) as f64;
                Point::from(sum / count)
            }
        },
        GoalPosition::Lanelets(ids) => {
            let lanelet = ids.iter().find_map(|id| network.lanelets.get(id))?;
            lanelet.centre.at(0.5 * lanelet.centre.length())
        }
    };
    Some((place(point), point))
}

/// The lanelet nearest to a point and its distance, m; 0 inside.
fn nearest<'a>(lanelets: impl Iterator<Item = &'a Lanelet>, point: Point) -> Option<(&'a Lanelet, f64)> {
    let distance = |lanelet: &Lanelet| {
        if lanelet.contains(point) {
            return 0.0;
        }
        [&lanelet.left, &lanelet.right]
            .map(|bound| bound.project(point).offset.abs())
            .into_iter()
            .fold(f64::MAX, f64::min)
    };
    lanelets.map(|lanelet| (lanelet, distance(lanelet))).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Lanelets that routes from a lanelet lead to, itself included.
fn reachable(graph: &LaneGraph, from: LaneletId) -> BTreeSet<LaneletId> {
    let mut reached = BTreeSet::from([from]);
    let mut open = vec![from];
    while let Some(id) = open.pop() {
        open.extend(graph.links(id).map(|(to, ..)| to).filter(|to| reached.insert(*to)));
    }
    reached
}

/// A goal lanelet that is the oncoming lane of a reachable one, with that one.
fn oncoming(
    network: &RoadNetwork,
    targets: &[LaneletId],
    reached: &BTreeSet<LaneletId>,
) -> Option<(LaneletId, LaneletId)> {
    reached.iter().filter_map(|id| network.lanelets.get(id)).find_map(|lanelet| {
        let beside = [lanelet.adjacent_left, lanelet.adjacent_right];
        let opposite = beside.iter().flatten().find(|n| !n.same_direction && targets.contains(&n.id))?;
        Some((opposite.id, lanelet.id))
    })
}

/// Whether a route leads from the goal to the start.
fn is_behind(graph: &LaneGraph, targets: &[LaneletId], footings: &[Footing]) -> bool {
    let starts: Vec<LaneletId> = footings.iter().map(|f| f.id).collect();
    targets.iter().any(|target| graph.shortest(*target, &starts).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{goal, two_lane_road};
    use crate::map::Neighbour;

    fn says(start: Pose) -> String {
        off_road(&two_lane_road(3), &start, &RouteSettings::default())
    }

    fn says_of_goal(network: &RoadNetwork, goal: Goal) -> String {
        unreachable(network, &Pose::new(60.0, 0.0, 0.0), &[goal], &RouteSettings::default())
    }

    #[test]
    fn names_the_start_and_the_nearest_lanelet() {
        let far = says(Pose::new(60.0, -20.0, 0.0));
        assert_eq!(
            far,
            "the start at (60.0, -20.0) is 18.2 m from the nearest lanelet, 101; a start may be at most 5 m outside of its \
             lanelet"
        );
        let against = says(Pose::new(60.0, 0.0, std::f64::consts::PI));
        assert!(against.contains("is inside lanelet 101, but the vehicle heads 180° away"), "{against}");
        let mut network = two_lane_road(1);
        network.lanelets.values_mut().for_each(|l| l.types.push("sidewalk".into()));
        let closed = off_road(&network, &Pose::new(10.0, 0.0, 0.0), &RouteSettings::default());
        assert!(closed.contains("lanelet 100, which is not for cars (") && closed.contains("sidewalk"), "{closed}");
        network.lanelets.clear();
        let empty = off_road(&network, &Pose::new(10.0, 0.0, 0.0), &RouteSettings::default());
        assert!(empty.ends_with("the map has none"), "{empty}");
    }

    #[test]
    fn names_the_goal_and_why_no_route_leads_there() {
        let mut network = two_lane_road(3);
        let at = |x: f64, y: f64| goal(Pose::new(x, y, 0.0), 4.0, 2.0, 10.0);
        let beside = says_of_goal(&network, at(60.0, 90.0));
        assert!(beside.contains("the goal at (60.0, 90.0) is on no drivable lanelet"), "{beside}");
        let behind = says_of_goal(&network, at(20.0, 0.0));
        assert!(behind.contains("from the start's lanelet 101 to the goal at (20.0, 0.0) on lanelet 100"), "{behind}");
        assert!(behind.contains("the goal is behind the start"), "{behind}");
        let missing = says_of_goal(&network, Goal { position: Some(GoalPosition::Lanelets(vec![7])), ..at(0.0, 0.0) });
        assert_eq!(missing, "the goal is on lanelet(s) 7, which the map does not have");
        // without the link between the lanes
        network.lanelets.values_mut().for_each(|l| {
            (l.adjacent_left, l.adjacent_right) = (None, None);
        });
        let apart = says_of_goal(&network, at(120.0, 3.5));
        assert!(apart.contains("of the 2 lanelet(s) within reach, 102 is nearest to the goal, 1.8 m away"), "{apart}");
        network.lanelets.get_mut(&102).unwrap().adjacent_left = Some(Neighbour { id: 202, same_direction: false });
        let oncoming = says_of_goal(&network, at(120.0, 3.5));
        assert!(oncoming.ends_with("lanelet 202 is the oncoming lane beside lanelet 102"), "{oncoming}");
    }
}
