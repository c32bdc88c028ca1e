//! Shared by the tests that drive: scenarios, runs, added obstacles, and motions of the plane.

#![allow(dead_code)] // every test file is a crate and uses a part of this

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use stopline::drive::{Run, Settings, drive};
use stopline::fixtures::parked;
use stopline::geometry::polyline::Polyline;
use stopline::geometry::{Point, Pose, Vector};
use stopline::io::commonroad::read_file;
use stopline::map::{
    Goal, GoalPosition, Interval, Lanelet, Motion, Obstacle, ObstacleKind, Part, PlanningProblem, Scenario, Shape,
    StopLine,
};
use stopline::vehicle::{Vehicle, load};

/// The vehicle that the scenarios of `maps/` are made for.
pub(crate) static VEHICLE: LazyLock<Vehicle> = LazyLock::new(|| load("bmw_320i").unwrap());

/// The folder of the bundled scenarios.
pub(crate) fn maps() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("maps")
}

/// A bundled scenario, by the name of its file.
pub(crate) fn bundled(name: &str) -> Scenario {
    let file = maps().join(name).with_extension("xml");
    read_file(&file).unwrap_or_else(|e| panic!("{e}"))
}

/// The folder of published scenarios, if it exists.
pub(crate) fn real_scenarios() -> Option<PathBuf> {
    let root = std::env::var_os("STOPLINE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    let folder = root.join("commonroad");
    if !folder.join("INDEX.csv").is_file() {
        eprintln!("skipped: no published scenarios (set STOPLINE_DATA to their folder)");
        return None;
    }
    Some(folder)
}

/// Drives the first problem of a scenario with the default settings.
pub(crate) fn driven(scenario: &Scenario) -> Run<'_> {
    let problem = &scenario.problems[0];
    drive(scenario, problem, &VEHICLE, &Settings::default(), &mut |_, _| {}).unwrap()
}

/// The failed checks, for messages; empty if none failed.
pub(crate) fn failures(run: &Run) -> Vec<String> {
    let line = |c: &stopline::verdict::Check| {
        format!("{} {:.3} {} (limit {:.3}) at {:?} s: {}", c.name, c.value, c.unit, c.limit, c.at_time, c.note)
    };
    run.verdict.failures().map(line).collect()
}

/// Id of obstacles that tests add.
pub(crate) const ADDED: i64 = 9_999;

/// A static rectangle, its length along its heading.
pub(crate) fn standing(pose: Pose, length: f64, width: f64) -> Obstacle {
    Obstacle { kind: ObstacleKind::Structure, ..parked(ADDED, pose, length, width) }
}

/// A motion of the plane: mirrored at the x axis if set, then rotated about the origin, then translated.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlaneMotion {
    pub(crate) is_mirrored: bool,
    pub(crate) turn: f64,
    pub(crate) shift: Vector,
}

impl PlaneMotion {
    pub(crate) const NONE: Self = Self { is_mirrored: false, turn: 0.0, shift: Vector::new(0.0, 0.0) };

    fn local(&self, p: Point) -> Point {
        if self.is_mirrored { Point::new(p.x, -p.y) } else { p }
    }

    fn signed(&self, left_positive: f64) -> f64 {
        if self.is_mirrored { -left_positive } else { left_positive }
    }

    pub(crate) fn point(&self, p: Point) -> Point {
        nalgebra::Rotation2::new(self.turn) * self.local(p) + self.shift
    }

    pub(crate) fn pose(&self, pose: &Pose) -> Pose {
        Pose { position: self.point(pose.position), yaw: self.signed(pose.yaw) + self.turn }
    }

    fn line(&self, line: &Polyline) -> Polyline {
        Polyline::new(line.points().iter().map(|p| self.point(*p))).unwrap()
    }

    /// A shape with the two functions applied to its points and poses.
    fn shape(shape: &Shape, point: impl Fn(Point) -> Point, pose: impl Fn(&Pose) -> Pose) -> Shape {
        let part = |part: &Part| match part {
            Part::Rectangle { centre, length, width } => {
                Part::Rectangle { centre: pose(centre), length: *length, width: *width }
            }
            Part::Circle { centre, radius } => Part::Circle { centre: point(*centre), radius: *radius },
            Part::Polygon { vertices } => Part::Polygon { vertices: vertices.iter().map(|v| point(*v)).collect() },
        };
        Shape { parts: shape.parts.iter().map(part).collect() }
    }

    fn world_shape(&self, shape: &Shape) -> Shape {
        Self::shape(shape, |p| self.point(p), |p| self.pose(p))
    }

    /// A shape in the frame of its obstacle. The frame itself moves; the shape is only mirrored.
    fn body_shape(&self, shape: &Shape) -> Shape {
        Self::shape(shape, |p| self.local(p), |p| Pose { position: self.local(p.position), yaw: self.signed(p.yaw) })
    }

    fn lanelet(&self, lanelet: &Lanelet) -> Lanelet {
        let mut moved = lanelet.clone();
        (moved.left, moved.right) = (self.line(&lanelet.left), self.line(&lanelet.right));
        moved.centre = self.line(&lanelet.centre);
        moved.stop_line =
            lanelet.stop_line.map(|line| StopLine { start: self.point(line.start), end: self.point(line.end) });
        if self.is_mirrored {
            std::mem::swap(&mut moved.left, &mut moved.right);
            std::mem::swap(&mut moved.adjacent_left, &mut moved.adjacent_right);
            moved.stop_line = moved.stop_line.map(|line| StopLine { start: line.end, end: line.start });
        }
        moved
    }

    fn obstacle(&self, obstacle: &Obstacle) -> Obstacle {
        let mut moved = obstacle.clone();
        moved.shape = self.body_shape(&obstacle.shape);
        match &mut moved.motion {
            Motion::Static(pose) => *pose = self.pose(pose),
            Motion::Trajectory(states) => states.iter_mut().for_each(|s| s.pose = self.pose(&s.pose)),
            Motion::Occupancy(sets) => sets.iter_mut().for_each(|s| s.region = self.world_shape(&s.region)),
        }
        moved
    }

    fn goal(&self, goal: &Goal) -> Goal {
        let yaw = |i: Interval| match self.is_mirrored {
            true => Interval { min: self.turn - i.max, max: self.turn - i.min },
            false => Interval { min: self.turn + i.min, max: self.turn + i.max },
        };
        let mut moved = goal.clone();
        moved.yaw = goal.yaw.map(yaw);
        if let Some(GoalPosition::Shapes(shape)) = &goal.position {
            moved.position = Some(GoalPosition::Shapes(self.world_shape(shape)));
        }
        moved
    }

    fn problem(&self, problem: &PlanningProblem) -> PlanningProblem {
        let mut moved = problem.clone();
        moved.initial.centre = self.pose(&problem.initial.centre);
        moved.initial.yaw_rate = self.signed(problem.initial.yaw_rate);
        moved.goals = problem.goals.iter().map(|g| self.goal(g)).collect();
        moved
    }

    /// The moved scenario.
    pub(crate) fn scenario(&self, scenario: &Scenario) -> Scenario {
        let mut moved = scenario.clone();
        for lanelet in moved.network.lanelets.values_mut() {
            *lanelet = self.lanelet(lanelet);
        }
        for sign in moved.network.signs.values_mut() {
            sign.position = sign.position.map(|p| self.point(p));
        }
        for light in moved.network.lights.values_mut() {
            light.position = light.position.map(|p| self.point(p));
        }
        moved.obstacles = scenario.obstacles.iter().map(|o| self.obstacle(o)).collect();
        moved.problems = scenario.problems.iter().map(|p| self.problem(p)).collect();
        moved
    }
}
