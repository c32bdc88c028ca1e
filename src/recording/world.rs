//! The top view: the map once, obstacles, plans and the vehicle over time.

use std::collections::BTreeMap;

use rerun::{LineStrips2D, Points2D, Radius, Transform3D};

use super::shapes::{HATCH_RADIUS, Surface, arrow_head, dashes, hatch, is_convex};
use super::{Context, RecordingError, Rgb, TICK};
use crate::geometry::Point;
use crate::geometry::polyline::Polyline;
use crate::map::{ConvexPart, Lanelet, Obstacle, ObstacleKind};
use crate::planner::{Candidate, Cycle};
use crate::plot::outline::{footprint, goal_outlines, obstacle_outlines};

const ROAD: [u8; 4] = [46, 52, 60, 255];
const WAY: [u8; 4] = [37, 40, 42, 255];
const BOUND: Rgb = (132, 142, 153);
const LANE_MARK: Rgb = (196, 203, 210);
const CENTRE: Rgb = (70, 78, 88);
const STOP_LINE: Rgb = (255, 82, 82);
const GOAL: Rgb = (46, 204, 143);
const STATIC_FILL: Rgb = (98, 108, 120);
const STATIC_EDGE: Rgb = (190, 198, 206);
const MOVING_FILL: Rgb = (150, 72, 16);
const MOVING_EDGE: Rgb = (255, 150, 64);
const VULNERABLE_FILL: Rgb = (128, 36, 96);
const VULNERABLE_EDGE: Rgb = (255, 120, 205);
const EGO_FILL: Rgb = (26, 92, 190);
const EGO_EDGE: Rgb = (150, 205, 255);
const DRIVEN: Rgb = (74, 120, 190);
const PLAN: Rgb = (92, 224, 255);
const PROVEN_STOP: Rgb = (255, 214, 92);
const REFERENCE: Rgb = (120, 128, 138);
const CHOSEN: Rgb = (92, 214, 120);
const ACCEPTED: Rgb = (88, 128, 116);
const REJECTED: Rgb = (138, 66, 66);

/// What lies above what.
mod order {
    pub(super) const SURFACE: f32 = -10.0;
    pub(super) const MARKS: f32 = 1.0;
    pub(super) const GOAL: f32 = 3.0;
    pub(super) const REFERENCE: f32 = 5.0;
    pub(super) const REJECTED: f32 = 6.0;
    pub(super) const CANDIDATES: f32 = 7.0;
    pub(super) const DRIVEN: f32 = 9.0;
    pub(super) const OBSTACLES: f32 = 20.0;
    pub(super) const OBSTACLE_EDGES: f32 = 21.0;
    pub(super) const PLAN: f32 = 40.0;
    pub(super) const EGO: f32 = 30.0;
    pub(super) const EGO_EDGE: f32 = 31.0;
    pub(super) const LABELS: f32 = 50.0;
}

/// The surface reaches this far beyond the action, m: whoever pans a little still sees road.
const SURFACE_MARGIN: f64 = 60.0;
/// Points along a candidate: its shape is smooth, and there are many of them.
const CANDIDATE_POINTS: f64 = 32.0;
/// Spacing of points along the committed path, m.
const PLAN_SPACING: f64 = 0.5;

/// Logs everything under `map` and the frame that follows the vehicle.
pub(super) fn log(context: &Context) -> Result<(), RecordingError> {
    let mirror = Transform3D::from_mat3x3([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]);
    context.log_static("map", &mirror)?;
    log_road(context)?;
    log_static_obstacles(context)?;
    log_driven_path(context)?;
    for cycle in &context.run.cycles {
        context.set_time(cycle.time);
        log_cycle(context, cycle)?;
    }
    for time in context.motion.ticks(TICK) {
        context.set_time(time);
        log_moving_obstacles(context, time)?;
        log_vehicle(context, time)?;
    }
    Ok(())
}

/// Line strips of one look; without any line the entity becomes empty from this time on.
fn strips(lines: Vec<Vec<[f32; 2]>>, colour: Rgb, radius: Radius, order: f32) -> LineStrips2D {
    let lines: Vec<_> = lines.into_iter().filter(|line| line.len() > 1).collect();
    LineStrips2D::new(lines).with_colors([colour]).with_radii([radius]).with_draw_order(order)
}

fn pixels(radius: f32) -> Radius {
    Radius::new_ui_points(radius)
}

#[allow(clippy::cast_possible_truncation)] // centimetres
fn metres(radius: f64) -> Radius {
    Radius::new_scene_units(radius as f32)
}

fn log_road(context: &Context) -> Result<(), RecordingError> {
    let network = &context.run.scenario.network;
    let lanelets: Vec<&Lanelet> = network.lanelets.values().collect();
    let region = context.action.grown(SURFACE_MARGIN);
    let surface = Surface::paint(network, &region, ROAD, WAY);
    let corner = context.local(&surface.corner).unwrap_or_default();
    #[allow(clippy::cast_possible_truncation)] // decimetres
    let scale = surface.pixel as f32;
    let place = Transform3D::from_translation_scale([corner[0], corner[1], 0.0], [scale, scale, 1.0]);
    context.log_static("map/surface", &place)?;
    let image = rerun::Image::from_rgba32(surface.rgba, surface.size).with_draw_order(order::SURFACE);
    context.log_static("map/surface", &image)?;

    let centres = lanelets.iter().filter(|l| l.is_drivable()).map(|l| context.line(l.centre.points())).collect();
    context.log_static("map/centre_lines", &strips(centres, CENTRE, pixels(0.5), order::MARKS))?;
    let sides = lanelets.iter().flat_map(|l| [(&l.left, l.adjacent_left), (&l.right, l.adjacent_right)]);
    let (inner, outer): (Vec<_>, Vec<_>) = sides.partition(|(_, n)| n.is_some_and(|n| n.same_direction));
    let bounds = outer.iter().map(|(line, _)| context.line(line.points())).collect();
    context.log_static("map/bounds", &strips(bounds, BOUND, pixels(1.0), order::MARKS))?;
    let marks = inner.iter().flat_map(|(line, _)| dashes(line, 3.0, 4.5)).map(|dash| context.line(&dash)).collect();
    context.log_static("map/lane_marks", &strips(marks, LANE_MARK, pixels(0.9), order::MARKS))?;
    let stops = lanelets.iter().filter_map(|l| l.stop_line).map(|l| context.line(&[l.start, l.end])).collect();
    context.log_static("map/stop_lines", &strips(stops, STOP_LINE, pixels(2.0), order::MARKS))?;
    let goals = goal_outlines(context.run);
    let edges = goals.iter().filter_map(|o| Polyline::new(o.iter().chain(o.first()).copied()));
    let dashed = edges.flat_map(|e| dashes(&e, 1.0, 0.6)).map(|dash| context.line(&dash)).collect();
    context.log_static("map/goal", &strips(dashed, GOAL, pixels(1.3), order::GOAL))
}

/// Lines that fill convex outlines, ready to be drawn with [`HATCH_RADIUS`].
fn fills(context: &Context, parts: &[ConvexPart]) -> Vec<Vec<[f32; 2]>> {
    let hatches = parts.iter().filter_map(|part| match part {
        ConvexPart::Polygon(points) if is_convex(points) => Some(hatch(points)),
        _ => None,
    });
    hatches.map(|line| context.line(&line)).collect()
}

fn log_static_obstacles(context: &Context) -> Result<(), RecordingError> {
    let obstacles: Vec<&Obstacle> = context.run.scenario.obstacles.iter().filter(|o| o.is_static()).collect();
    let parts: Vec<ConvexPart> = obstacles.iter().flat_map(|o| o.occupied_at(0.0)).collect();
    let fill = strips(fills(context, &parts), STATIC_FILL, metres(HATCH_RADIUS), order::OBSTACLES);
    context.log_static("map/obstacles/static/fill", &fill)?;
    let outlines = obstacles.iter().flat_map(|o| obstacle_outlines(o, 0.0)).map(|o| context.ring(&o)).collect();
    let edges = strips(outlines, STATIC_EDGE, pixels(1.0), order::OBSTACLE_EDGES);
    context.log_static("map/obstacles/static", &edges)
}

fn log_moving_obstacles(context: &Context, time: f64) -> Result<(), RecordingError> {
    let moving = || context.run.scenario.obstacles.iter().filter(|o| !o.is_static());
    if moving().next().is_none() {
        return Ok(());
    }
    let looks = [
        ("map/obstacles/moving", false, MOVING_FILL, MOVING_EDGE),
        ("map/obstacles/vulnerable", true, VULNERABLE_FILL, VULNERABLE_EDGE),
    ];
    for (entity, vulnerable, fill, edge) in looks {
        let of_kind = || moving().filter(|o| is_vulnerable(o) == vulnerable);
        if of_kind().next().is_none() {
            continue;
        }
        let parts: Vec<ConvexPart> = of_kind().filter(|o| has_body(o)).flat_map(|o| o.occupied_at(time)).collect();
        let filled = strips(fills(context, &parts), fill, metres(HATCH_RADIUS), order::OBSTACLES);
        context.log(&format!("{entity}/fill"), &filled)?;
        let outlines = of_kind().flat_map(|o| obstacle_outlines(o, time)).map(|o| context.ring(&o)).collect();
        context.log(entity, &strips(outlines, edge, pixels(1.0), order::OBSTACLE_EDGES))?;
    }
    Ok(())
}

fn is_vulnerable(obstacle: &Obstacle) -> bool {
    matches!(obstacle.kind, ObstacleKind::Pedestrian | ObstacleKind::Bicycle)
}

/// Whether it is somewhere, not just possibly there: set-based predictions stay hollow.
fn has_body(obstacle: &Obstacle) -> bool {
    !matches!(obstacle.motion, crate::map::Motion::Occupancy(_))
}

fn log_cycle(context: &Context, cycle: &Cycle) -> Result<(), RecordingError> {
    let reference = vec![context.line(&cycle.reference)];
    context.log("map/plan/reference", &strips(reference, REFERENCE, pixels(0.6), order::REFERENCE))?;
    log_candidates(context, cycle)?;
    let plan = &cycle.committed;
    let (from, to) = (plan.profile.at(cycle.time - plan.start_time).station, plan.profile.last().station);
    let ahead: Vec<Point> = (plan.path.sampled(PLAN_SPACING).iter())
        .filter(|(station, _)| (from..=to).contains(station))
        .map(|(_, p)| p.pose.position)
        .collect();
    let stop = plan.path.at(to).pose;
    let line: Vec<Point> =
        std::iter::once(plan.path.at(from).pose.position).chain(ahead).chain([stop.position]).collect();
    context.log("map/plan/committed", &strips(vec![context.line(&line)], PLAN, pixels(1.6), order::PLAN))?;
    let print = context.ring(&footprint(context.run.vehicle, &stop));
    context.log("map/plan/proven_stop", &strips(vec![print], PROVEN_STOP, pixels(1.2), order::PLAN))
}

fn log_candidates(context: &Context, cycle: &Cycle) -> Result<(), RecordingError> {
    let line = |c: &Candidate| {
        let points = c.path.sampled((c.path.length() / CANDIDATE_POINTS).max(0.5));
        context.line(&points.iter().map(|(_, p)| p.pose.position).collect::<Vec<_>>())
    };
    let chosen = cycle.chosen.and_then(|i| cycle.candidates.get(i));
    let all = || cycle.candidates.iter();
    let accepted = all().filter(|c| c.rejected.is_none()).map(line).collect();
    let rejected = all().filter(|c| c.rejected.is_some()).map(line).collect();
    let chosen = chosen.map(line).into_iter().collect();
    context.log("map/plan/candidates/rejected", &strips(rejected, REJECTED, pixels(0.5), order::REJECTED))?;
    context.log("map/plan/candidates/accepted", &strips(accepted, ACCEPTED, pixels(0.7), order::CANDIDATES))?;
    context.log("map/plan/candidates/chosen", &strips(chosen, CHOSEN, pixels(1.2), order::CANDIDATES))?;
    let (places, labels) = rejection_labels(context, &cycle.candidates);
    let points = Points2D::new(places).with_radii([pixels(1.5)]).with_colors([STOP_LINE]);
    context.log("map/plan/candidates/reasons", &points.with_labels(labels).with_draw_order(order::LABELS))
}

/// One label for each reason, at the end of the middle candidate that has it: a label on each would hide the road.
fn rejection_labels(context: &Context, candidates: &[Candidate]) -> (Vec<[f32; 2]>, Vec<String>) {
    let mut by_reason: BTreeMap<&str, Vec<&Candidate>> = BTreeMap::new();
    for candidate in candidates {
        if let Some(reason) = candidate.rejected {
            by_reason.entry(reason).or_default().push(candidate);
        }
    }
    by_reason
        .iter()
        .filter_map(|(reason, group)| {
            let path = &group[group.len() / 2].path;
            let place = context.local(&path.at(path.length()).pose.position)?;
            Some((place, if group.len() > 1 { format!("{reason} ×{}", group.len()) } else { (*reason).to_owned() }))
        })
        .unzip()
}

fn log_driven_path(context: &Context) -> Result<(), RecordingError> {
    let path: Vec<Point> = context.motion.thinned(0.05).iter().map(|s| s.pose.position).collect();
    context.log_static("map/driven", &strips(vec![context.line(&path)], DRIVEN, pixels(1.0), order::DRIVEN))
}

fn log_vehicle(context: &Context, time: f64) -> Result<(), RecordingError> {
    let Some(sample) = context.motion.at(time) else { return Ok(()) };
    let vehicle = context.run.vehicle;
    let print = footprint(vehicle, &sample.pose);
    let fill = context.line(&hatch(&print));
    context.log("map/ego/fill", &strips(vec![fill], EGO_FILL, metres(HATCH_RADIUS), order::EGO))?;
    let edges = vec![context.ring(&print), context.ring(&arrow_head(vehicle, &sample.pose))];
    context.log("map/ego", &strips(edges, EGO_EDGE, pixels(1.2), order::EGO_EDGE))?;
    // the frame of the view that follows the vehicle: moves with it, does not turn, and is not under the mirror
    if let Some([x, y]) = context.local(&sample.pose.position) {
        context.log("follow", &Transform3D::from_translation([x, -y, 0.0]))?;
    }
    Ok(())
}
