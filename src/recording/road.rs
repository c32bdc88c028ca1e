//! The map, logged once: surface, bounds, lane markings, stop lines, goal.

use rerun::Transform3D;

use super::shapes::{Surface, dashes};
use super::style::{self, order, pixels, strips};
use super::{Context, RecordingError};
use crate::geometry::polyline::Polyline;
use crate::map::{Cell, Lanelet};
use crate::plot::outline::goal_outlines;

/// Distance by which the surface extends beyond the action, m: a panned view still shows road.
const SURFACE_MARGIN: f64 = 60.0;

/// Logs the map and the goal.
pub(super) fn log(context: &Context) -> Result<(), RecordingError> {
    let surface = log_surface(context)?;
    let network = &context.run.scenario.network;
    let lanelets: Vec<&Lanelet> = network.lanelets.values().collect();
    let centres = lanelets.iter().filter(|l| l.is_drivable()).map(|l| context.line(l.centre.points())).collect();
    context.log_static("map/centre_lines", &strips(centres, style::CENTRE, pixels(0.5), order::MARKS))?;
    let sides = lanelets.iter().flat_map(|l| [(&l.left, l.adjacent_left), (&l.right, l.adjacent_right)]);
    let (inner, outer): (Vec<_>, Vec<_>) = sides.partition(|(_, n)| n.is_some_and(|n| n.same_direction));
    let bounds = outer.iter().flat_map(|(line, neighbour)| match neighbour {
        Some(_) => vec![line.points().to_vec()],
        None => surface.rim(line),
    });
    let bounds = bounds.map(|line| context.line(&line)).collect();
    context.log_static("map/bounds", &strips(bounds, style::BOUND, pixels(1.0), order::MARKS))?;
    let marks = inner.iter().flat_map(|(line, _)| dashes(line, 3.0, 4.5)).map(|dash| context.line(&dash)).collect();
    context.log_static("map/lane_marks", &strips(marks, style::LANE_MARK, pixels(0.9), order::MARKS))?;
    let stops = lanelets.iter().filter_map(|l| l.stop_line).map(|l| context.line(&[l.start, l.end])).collect();
    context.log_static("map/stop_lines", &strips(stops, style::STOP_LINE, pixels(2.0), order::MARKS))?;
    log_occupied_cells(context)?;
    let goals = goal_outlines(context.run);
    let edges = goals.iter().filter_map(|o| Polyline::new(o.iter().chain(o.first()).copied()));
    let dashed = edges.flat_map(|e| dashes(&e, 1.0, 0.6)).map(|dash| context.line(&dash)).collect();
    context.log_static("map/goal", &strips(dashed, style::GOAL, pixels(1.3), order::GOAL))
}

/// The outlines of the occupied cells near the action, neighbours merged.
fn log_occupied_cells(context: &Context) -> Result<(), RecordingError> {
    let Some(grid) = &context.run.scenario.occupancy else { return Ok(()) };
    let region = context.action.expanded(SURFACE_MARGIN);
    let blocks = grid.blocks(|cell| cell == Cell::Occupied);
    let near = blocks.iter().map(|b| grid.corners(b)).filter(|corners| region.shows(corners));
    let outlines = near.map(|corners| context.ring(&corners)).collect();
    context.log_static("map/occupancy", &strips(outlines, style::STATIC.1, pixels(0.8), order::OBSTACLE_EDGES))
}

/// The surface as an image: 2D views have no filled polygons.
fn log_surface(context: &Context) -> Result<Surface, RecordingError> {
    let network = &context.run.scenario.network;
    let region = context.action.expanded(SURFACE_MARGIN);
    let surface = Surface::paint(network, &region);
    let corner = context.local(&surface.corner).unwrap_or_default();
    #[allow(clippy::cast_possible_truncation)] // decimetres
    let scale = surface.pixel as f32;
    let place = Transform3D::from_translation_scale([corner[0], corner[1], 0.0], [scale, scale, 1.0]);
    context.log_static("map/surface", &place)?;
    let image = rerun::Image::from_rgb24(surface.rgb.clone(), surface.size).with_draw_order(order::SURFACE);
    context.log_static("map/surface", &image)?;
    Ok(surface)
}
