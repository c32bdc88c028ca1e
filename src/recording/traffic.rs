//! Obstacles and the vehicle: shapes once, in their body frames, and poses as columns.

use rerun::{LineStrips2D, TimeColumn, Transform3D};

use super::shapes::{HATCH_RADIUS, arrow_head, hatch};
use super::style::{self, Rgb, metres, order, pixels, strips};
use super::{Context, RecordingError, TICK, TIMELINE};
use crate::geometry::{Point, Pose};
use crate::map::{Motion, Obstacle, ObstacleKind, TimedOccupancy};
use crate::plot::outline::{Bounds, shape_outlines};

/// Time after an obstacle's last state at which it disappears, s.
const AFTER: f64 = 1e-3;
/// The frame of a shape in world coordinates.
const WORLD: Pose = Pose { position: Point::new(0.0, 0.0), yaw: 0.0 };

/// Logs the obstacles and the vehicle.
pub(super) fn log(context: &Context) -> Result<(), RecordingError> {
    for obstacle in &context.run.scenario.obstacles {
        let entity = format!("map/obstacles/{}", obstacle.id);
        match &obstacle.motion {
            Motion::Static(pose) => log_static(context, &entity, obstacle, pose)?,
            Motion::Trajectory(_) => log_moving(context, &entity, obstacle)?,
            Motion::Occupancy(sets) => log_sets(context, &entity, obstacle, sets)?,
        }
    }
    log_vehicle(context)?;
    log_driven_path(context)
}

/// Fill and edge of an obstacle.
fn colours(obstacle: &Obstacle) -> (Rgb, Rgb) {
    match obstacle.kind {
        ObstacleKind::Pedestrian | ObstacleKind::Bicycle => style::VULNERABLE,
        _ if obstacle.is_static() => style::STATIC,
        _ => style::MOVING,
    }
}

/// Lines that fill a body, and its edges, about its middle. Files may give a shape far from the origin of its frame,
/// even in world coordinates, where `f32` would lose precision.
struct Body {
    middle: Point,
    fill: LineStrips2D,
    edges: LineStrips2D,
}

impl Body {
    /// An obstacle's body.
    fn of(obstacle: &Obstacle) -> Self {
        let (fill, edge) = colours(obstacle);
        let given = shape_outlines(&obstacle.shape, &WORLD);
        let middle = Bounds::around(given.iter().flatten()).map_or(Point::origin(), |b| b.centre());
        let outlines = shape_outlines(&obstacle.shape, &Pose { position: Point::from(-middle.coords), yaw: 0.0 });
        let strokes = outlines.iter().flat_map(|o| hatch(o)).map(|stroke| flat(&stroke));
        Self {
            middle,
            fill: strips(strokes.collect(), fill, metres(HATCH_RADIUS), order::OBSTACLES),
            edges: strips(outlines.iter().map(|o| ring(o)).collect(), edge, pixels(1.0), order::OBSTACLE_EDGES),
        }
    }

    /// Pose of the middle for a pose of the shape's frame.
    fn placed(&self, frame: &Pose) -> Pose {
        Pose { position: frame.to_world(self.middle), yaw: frame.yaw }
    }
}

/// Points in a body frame.
#[allow(clippy::cast_possible_truncation)] // metres about the frame's origin
fn flat(points: &[Point]) -> Vec<[f32; 2]> {
    points.iter().filter(|p| p.x.is_finite() && p.y.is_finite()).map(|p| [p.x as f32, p.y as f32]).collect()
}

/// A closed line in a body frame.
fn ring(points: &[Point]) -> Vec<[f32; 2]> {
    let mut line = flat(points);
    line.extend(line.first().copied());
    line
}

fn log_static(context: &Context, entity: &str, obstacle: &Obstacle, pose: &Pose) -> Result<(), RecordingError> {
    let body = Body::of(obstacle);
    let Some((translation, turn)) = placed(context, &body.placed(pose)) else { return Ok(()) };
    context.log_static(entity, &Transform3D::from_translation_mat3x3(translation, turn))?;
    context.log_static(entity, &body.edges)?;
    context.log_static(&format!("{entity}/fill"), &body.fill)
}

/// A body that is visible during its lifetime and moves with its poses.
fn log_moving(context: &Context, entity: &str, obstacle: &Obstacle) -> Result<(), RecordingError> {
    let (appears, disappears) = obstacle.lifetime();
    let (from, to) = context.motion.time_range();
    let shown = (appears.max(from), disappears.min(to));
    if shown.1 < shown.0 {
        return Ok(());
    }
    let body = Body::of(obstacle);
    let times = context.motion.ticks(TICK).into_iter().filter(|t| (shown.0..=shown.1).contains(t));
    let poses: Vec<(f64, Pose)> = std::iter::once(shown.0)
        .chain(times.filter(|t| *t > shown.0))
        .filter_map(|t| Some((t, body.placed(&obstacle.pose_at(t)?))))
        .collect();
    send_poses(context, entity, &poses)?;
    context.set_time(shown.0);
    context.log(entity, &body.edges)?;
    context.log(&format!("{entity}/fill"), &body.fill)?;
    if disappears < to {
        clear(context, entity, disappears + AFTER)?;
    }
    Ok(())
}

/// Clears an entity from `time` on.
fn clear(context: &Context, entity: &str, time: f64) -> Result<(), RecordingError> {
    context.set_time(time);
    let empty = LineStrips2D::new(Vec::<Vec<[f32; 2]>>::new());
    context.log(entity, &empty)?;
    context.log(&format!("{entity}/fill"), &empty)
}

/// A set-based prediction: the hollow outline of each set during its interval.
fn log_sets(
    context: &Context,
    entity: &str,
    obstacle: &Obstacle,
    sets: &[TimedOccupancy],
) -> Result<(), RecordingError> {
    let (from, to) = context.motion.time_range();
    let visible = || sets.iter().filter(|set| set.from <= to && set.to >= from);
    for set in visible() {
        context.set_time(set.from.max(from));
        let outlines = shape_outlines(&set.region, &WORLD).iter().map(|o| context.ring(o)).collect();
        context.log(entity, &strips(outlines, colours(obstacle).1, pixels(1.0), order::OBSTACLE_EDGES))?;
    }
    match visible().next_back() {
        Some(set) if set.to < to => clear(context, entity, set.to + AFTER),
        _ => Ok(()),
    }
}

fn log_vehicle(context: &Context) -> Result<(), RecordingError> {
    let vehicle = context.run.vehicle;
    let samples: Vec<(f64, Pose)> =
        (context.motion.ticks(TICK).into_iter()).filter_map(|t| Some((t, context.motion.at(t)?.pose))).collect();
    if samples.is_empty() {
        return Ok(());
    }
    send_poses(context, "map/ego", &samples)?;
    let parts = || vehicle.footprint.parts().iter();
    let edges = parts().map(|part| ring(part)).chain([ring(&arrow_head(vehicle))]).collect();
    context.log_static("map/ego", &strips(edges, style::EGO.1, pixels(1.2), order::EGO_EDGE))?;
    let fill = strips(
        parts().flat_map(|part| hatch(part)).map(|stroke| flat(&stroke)).collect(),
        style::EGO.0,
        metres(HATCH_RADIUS),
        order::EGO,
    );
    context.log_static("map/ego/fill", &fill)?;
    // the frame of the view that follows the vehicle: it translates without rotation and is not mirrored
    let (times, places): (Vec<f64>, Vec<[f32; 3]>) =
        samples.iter().filter_map(|(t, pose)| context.local(&pose.position).map(|[x, y]| (*t, [x, -y, 0.0]))).unzip();
    let moves = Transform3D::update_fields().with_many_translation(places);
    send(context, "follow", times, moves)
}

fn log_driven_path(context: &Context) -> Result<(), RecordingError> {
    let path: Vec<Point> = context.motion.thinned(0.05).iter().map(|s| s.pose.position).collect();
    context.log_static("map/driven", &strips(vec![context.line(&path)], style::DRIVEN, pixels(1.0), order::DRIVEN))
}

/// A pose as translation and rotation matrix (columns).
fn placed(context: &Context, pose: &Pose) -> Option<([f32; 3], [[f32; 3]; 3])> {
    let [x, y] = context.local(&pose.position)?;
    #[allow(clippy::cast_possible_truncation)] // within ±1
    let (sin, cos) = (pose.yaw.sin() as f32, pose.yaw.cos() as f32);
    (sin.is_finite() && cos.is_finite()).then_some(([x, y, 0.0], [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]))
}

fn send_poses(context: &Context, entity: &str, poses: &[(f64, Pose)]) -> Result<(), RecordingError> {
    let placed: Vec<_> = poses.iter().filter_map(|(t, pose)| Some((*t, placed(context, pose)?))).collect();
    let times = placed.iter().map(|(t, _)| *t).collect();
    let transforms = Transform3D::update_fields()
        .with_many_translation(placed.iter().map(|(_, p)| p.0))
        .with_many_mat3x3(placed.iter().map(|(_, p)| p.1));
    send(context, entity, times, transforms)
}

fn send(context: &Context, entity: &str, times: Vec<f64>, data: Transform3D) -> Result<(), RecordingError> {
    if times.is_empty() {
        return Ok(());
    }
    let columns = data.columns_of_unit_batches().map_err(RecordingError::encoding)?;
    let times = TimeColumn::new_duration_secs(TIMELINE, times);
    context.stream.send_columns(entity, [times], columns).map_err(RecordingError::encoding)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::{Part, Shape};
    use rerun::AsComponents as _;

    fn polygon(corners: [(f64, f64); 3], frame: Pose) -> Obstacle {
        let vertices = corners.map(|(x, y)| Point::new(x, y)).to_vec();
        let shape = Shape { parts: vec![Part::Polygon { vertices }] };
        Obstacle { id: 1, kind: ObstacleKind::Structure, shape, motion: Motion::Static(frame) }
    }

    #[test]
    fn a_shape_in_world_coordinates_keeps_its_precision() {
        let near = Body::of(&polygon([(0.0, 0.0), (3.0, 0.25), (1.0, 2.125)], Pose::new(0.0, 0.0, 0.0)));
        let (x, y) = (691_000.0, 5_335_000.0);
        let corners = [(x, y), (x + 3.0, y + 0.25), (x + 1.0, y + 2.125)];
        let far = Body::of(&polygon(corners, Pose::new(0.0, 0.0, 0.0)));
        assert_eq!(near.edges.as_serialized_batches(), far.edges.as_serialized_batches());
        let frame = Pose::new(x, y, 0.0);
        assert_eq!(near.placed(&frame).position, far.placed(&Pose::new(0.0, 0.0, 0.0)).position);
    }
}
