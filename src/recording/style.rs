//! Style of the top view: colours, line widths and drawing order.

use rerun::{LineStrips2D, Radius};

/// A colour: red, green, blue.
pub(super) type Rgb = (u8, u8, u8);

/// Ground beside the road and background of the views.
pub(super) const GROUND: Rgb = (20, 23, 27);
/// Road surface.
pub(super) const ROAD: Rgb = (46, 52, 60);
/// Lanelets that are not for cars.
pub(super) const NON_DRIVABLE: Rgb = (37, 40, 42);
/// Bounds of the road.
pub(super) const BOUND: Rgb = (132, 142, 153);
/// Bounds between lanes of one direction.
pub(super) const LANE_MARK: Rgb = (196, 203, 210);
/// Centre lines.
pub(super) const CENTRE: Rgb = (70, 78, 88);
/// Stop lines.
pub(super) const STOP_LINE: Rgb = (255, 82, 82);
/// Goal.
pub(super) const GOAL: Rgb = (46, 204, 143);
/// The driven path.
pub(super) const DRIVEN: Rgb = (74, 120, 190);
/// The committed plan.
pub(super) const PLAN: Rgb = (92, 224, 255);
/// Footprint at the committed plan's fallback stop.
pub(super) const FALLBACK_STOP: Rgb = (255, 214, 92);
/// Reference line.
pub(super) const REFERENCE: Rgb = (120, 128, 138);
/// The chosen candidate.
pub(super) const CHOSEN: Rgb = (92, 214, 120);
/// Feasible candidates that were not chosen.
pub(super) const ACCEPTED: Rgb = (88, 128, 116);
/// Infeasible candidates.
pub(super) const REJECTED: Rgb = (138, 66, 66);
/// Fill and edge of static obstacles.
pub(super) const STATIC: (Rgb, Rgb) = ((98, 108, 120), (190, 198, 206));
/// Fill and edge of moving vehicles.
pub(super) const MOVING: (Rgb, Rgb) = ((150, 72, 16), (255, 150, 64));
/// Fill and edge of pedestrians and bicycles.
pub(super) const VULNERABLE: (Rgb, Rgb) = ((128, 36, 96), (255, 120, 205));
/// Fill and edge of the vehicle.
pub(super) const EGO: (Rgb, Rgb) = ((26, 92, 190), (150, 205, 255));

/// Drawing order: larger values are on top.
pub(super) mod order {
    pub(in super::super) const SURFACE: f32 = -10.0;
    pub(in super::super) const MARKS: f32 = 1.0;
    pub(in super::super) const GOAL: f32 = 3.0;
    pub(in super::super) const REFERENCE: f32 = 5.0;
    pub(in super::super) const REJECTED: f32 = 6.0;
    pub(in super::super) const CANDIDATES: f32 = 7.0;
    pub(in super::super) const DRIVEN: f32 = 9.0;
    pub(in super::super) const OBSTACLES: f32 = 20.0;
    pub(in super::super) const OBSTACLE_EDGES: f32 = 21.0;
    pub(in super::super) const PLAN: f32 = 40.0;
    pub(in super::super) const EGO: f32 = 30.0;
    pub(in super::super) const EGO_EDGE: f32 = 31.0;
    pub(in super::super) const LABELS: f32 = 50.0;
}

/// Line strips of one style; without any line, the entity is empty from the current time on.
pub(super) fn strips(lines: Vec<Vec<[f32; 2]>>, colour: Rgb, radius: Radius, order: f32) -> LineStrips2D {
    let lines: Vec<_> = lines.into_iter().filter(|line| line.len() > 1).collect();
    LineStrips2D::new(lines).with_colors([colour]).with_radii([radius]).with_draw_order(order)
}

/// Half-width of a line with a constant width on the screen.
pub(super) fn pixels(radius: f32) -> Radius {
    Radius::new_ui_points(radius)
}

/// Half-width of a line with a constant width in the world, m.
#[allow(clippy::cast_possible_truncation)] // centimetres
pub(super) fn metres(radius: f64) -> Radius {
    Radius::new_scene_units(radius as f32)
}
