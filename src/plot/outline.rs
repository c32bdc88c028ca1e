//! Outlines to draw: shapes, footprints, the bounds of the action.

use std::f64::consts::TAU;

use super::motion::Motion;
use crate::drive::Run;
use crate::geometry::{Point, Pose};
use crate::map::{GoalPosition, Motion as ObstacleMotion, Obstacle, Part, RoadNetwork, Shape};
use crate::vehicle::Vehicle;

/// Corners of the polygon that approximates a circle: the error is below a pixel for anything of the size of a person.
const CIRCLE_CORNERS: u32 = 32;

/// The outline of each part of a shape, in the frame that `pose` maps to the world. Polygons are open and keep their
/// vertices (no triangles).
pub(crate) fn shape_outlines(shape: &Shape, pose: &Pose) -> Vec<Vec<Point>> {
    shape.parts.iter().map(|part| part_outline(part).iter().map(|p| pose.to_world(*p)).collect()).collect()
}

fn part_outline(part: &Part) -> Vec<Point> {
    match part {
        Part::Rectangle { centre, length, width } => {
            let (l, w) = (0.5 * length, 0.5 * width);
            [(-l, -w), (l, -w), (l, w), (-l, w)].map(|(x, y)| centre.to_world(Point::new(x, y))).to_vec()
        }
        Part::Circle { centre, radius } => (0..CIRCLE_CORNERS)
            .map(|i| TAU * f64::from(i) / f64::from(CIRCLE_CORNERS))
            .map(|angle| Point::new(centre.x + radius * angle.cos(), centre.y + radius * angle.sin()))
            .collect(),
        Part::Polygon { vertices } => vertices.clone(),
    }
}

/// Outlines of an obstacle at `time`; empty while it does not exist.
pub(crate) fn obstacle_outlines(obstacle: &Obstacle, time: f64) -> Vec<Vec<Point>> {
    match &obstacle.motion {
        ObstacleMotion::Occupancy(sets) => sets
            .iter()
            .filter(|o| o.from <= time && time <= o.to)
            .take(1)
            .flat_map(|o| shape_outlines(&o.region, &Pose::new(0.0, 0.0, 0.0)))
            .collect(),
        _ => obstacle.pose_at(time).map_or_else(Vec::new, |pose| shape_outlines(&obstacle.shape, &pose)),
    }
}

/// Outlines of the regions of all goals. Goals without a position have none.
pub(crate) fn goal_outlines(run: &Run) -> Vec<Vec<Point>> {
    let network = &run.scenario.network;
    run.problem.goals.iter().filter_map(|g| g.position.as_ref()).flat_map(|p| goal_region(p, network)).collect()
}

fn goal_region(position: &GoalPosition, network: &RoadNetwork) -> Vec<Vec<Point>> {
    match position {
        GoalPosition::Shapes(shape) => shape_outlines(shape, &Pose::new(0.0, 0.0, 0.0)),
        GoalPosition::Lanelets(ids) => {
            ids.iter().filter_map(|id| network.lanelets.get(id)).map(|l| l.outline()).collect()
        }
    }
}

/// The parts of the footprint at a rear-axle pose.
pub(crate) fn footprint(vehicle: &Vehicle, rear_axle: &Pose) -> Vec<Vec<Point>> {
    let part = |corners: &Vec<Point>| corners.iter().map(|corner| rear_axle.to_world(*corner)).collect();
    vehicle.footprint.parts().iter().map(part).collect()
}

/// An axis-parallel box in world coordinates, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    /// Lower left corner.
    pub(crate) min: Point,
    /// Upper right corner.
    pub(crate) max: Point,
}

impl Bounds {
    /// The smallest box around all finite points; `None` without any.
    pub(crate) fn around<'p>(points: impl IntoIterator<Item = &'p Point>) -> Option<Self> {
        points.into_iter().filter(|p| p.x.is_finite() && p.y.is_finite()).fold(None, |bounds, p| {
            Some(bounds.map_or(Self { min: *p, max: *p }, |b: Self| Self { min: b.min.inf(p), max: b.max.sup(p) }))
        })
    }

    /// Extent along x, m.
    pub(crate) fn width(&self) -> f64 {
        self.max.x - self.min.x
    }

    /// Extent along y, m.
    pub(crate) fn height(&self) -> f64 {
        self.max.y - self.min.y
    }

    /// The middle.
    pub(crate) fn centre(&self) -> Point {
        nalgebra::center(&self.min, &self.max)
    }

    /// Whether the boxes share a point.
    pub(crate) fn meets(&self, other: &Self) -> bool {
        self.min.x <= other.max.x && other.min.x <= self.max.x && self.min.y <= other.max.y && other.min.y <= self.max.y
    }

    /// Whether an outline's box reaches into this one.
    pub(crate) fn shows<'p>(&self, points: impl IntoIterator<Item = &'p Point>) -> bool {
        Self::around(points).is_some_and(|b| self.meets(&b))
    }

    /// Expanded by `margin` on every side.
    pub(crate) fn expanded(&self, margin: f64) -> Self {
        let by = nalgebra::Vector2::repeat(margin);
        Self { min: self.min - by, max: self.max + by }
    }

    /// Expanded to at least this size, about the same middle.
    pub(crate) fn at_least(&self, width: f64, height: f64) -> Self {
        let half = 0.5 * nalgebra::Vector2::new(self.width().max(width), self.height().max(height));
        Self { min: self.centre() - half, max: self.centre() + half }
    }

    fn with(&self, other: &Self) -> Self {
        Self { min: self.min.inf(&other.min), max: self.max.sup(&other.max) }
    }
}

/// Margin around the driven path, m: the neighbouring lanes and a car ahead.
const MARGIN: f64 = 7.0;
/// Distance to the driven path within which a goal region is shown, m.
const GOAL_REACH: f64 = 40.0;
/// The smallest region shown, m: a stopped car must not fill the page.
const SMALLEST: (f64, f64) = (48.0, 18.0);

/// The bounds of the action: all driven and committed motion, a nearby goal, and a margin.
pub(crate) fn action_bounds(run: &Run, motion: &Motion) -> Bounds {
    let start = run.vehicle.rear_axle_of_centre(&run.problem.initial.centre);
    let driven = motion.thinned(0.1).into_iter().map(|s| s.pose);
    let planned = run.cycles.iter().flat_map(|c| c.plan.trajectory.path.sampled(2.0)).map(|(_, p)| p.pose);
    let corners: Vec<Point> =
        std::iter::once(start).chain(driven).chain(planned).flat_map(|p| footprint(run.vehicle, &p).concat()).collect();
    let origin = Bounds { min: Point::origin(), max: Point::origin() };
    let action = Bounds::around(&corners).unwrap_or(origin);
    let goals = goal_outlines(run);
    let near = goals.iter().filter_map(Bounds::around).filter(|g| action.expanded(GOAL_REACH).meets(g));
    // a goal of the length of a whole lanelet would dominate the action
    let near = near.filter(|g| g.width().max(g.height()) <= 2.0 * GOAL_REACH);
    near.fold(action, |bounds, goal| bounds.with(&goal)).expanded(MARGIN).at_least(SMALLEST.0, SMALLEST.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::example::Example;

    #[test]
    fn the_action_contains_the_driven_path_and_the_near_goal() {
        let example = Example::new();
        let run = example.run();
        let bounds = action_bounds(&run, &Motion::of(&run));
        for sample in &run.log.samples {
            assert!(bounds.shows([&sample.pose.position]));
        }
        for goal in goal_outlines(&run) {
            assert!(bounds.shows(&goal));
        }
        assert!(bounds.width() < 140.0, "cropped to the action, not the whole map: {bounds:?}");
    }

    #[test]
    fn a_quarter_turn_swaps_length_and_width() {
        let outline = shape_outlines(&Shape::rectangle(4.0, 2.0), &Pose::new(5.0, 1.0, std::f64::consts::FRAC_PI_2));
        let bounds = Bounds::around(&outline[0]).unwrap();
        assert!((bounds.width() - 2.0).abs() < 1e-12 && (bounds.height() - 4.0).abs() < 1e-12);
        assert!((bounds.centre() - Point::new(5.0, 1.0)).norm() < 1e-12);
    }

    #[test]
    fn bounds_ignore_invalid_points() {
        assert_eq!(Bounds::around(&[Point::new(f64::NAN, 0.0)]), None);
        let one = Point::new(1.0, 2.0);
        assert_eq!(Bounds::around(&[one, Point::new(f64::INFINITY, 0.0)]), Some(Bounds { min: one, max: one }));
    }
}
