//! Reads `vehicle.urdf` with `urdf-rs`: masses, inertia, axles, steering limits and footprint.
//!
//! The URDF must have one root link with an inertial element, and four wheel links on continuous joints about horizontal
//! axes; revolute joints about the vertical steer the two front ones. The frame of the root link may be anywhere: lengths
//! are relative to the wheels. Mass, centre of mass and yaw inertia are summed over all links by the parallel axis
//! theorem.
//!
//! The footprint consists of the `<collision>` elements of the root and of all links that fixed joints connect to it,
//! each projected to the ground as one convex polygon: boxes and meshes (OBJ or STL beside the URDF) exactly, in any
//! orientation; spheres, capsules and upright cylinders as circumscribed polygons of 16 corners (2 % larger). It excludes
//! the wheels and the links that steer them, as these move inside the outline. Any other moving link with a collision
//! element is an error, also on a continuous joint: a hinged trailer would be missing in the collision checks.
//!
//! Limits: joints are in their zero position. Rotated frames (`rpy`) apply to positions and to yaw; an inertial frame
//! with roll or pitch is an error. Wheels that stick out of the body, as on some robots, are covered only if the body's
//! collision elements enclose them.

mod xml;

use std::path::Path;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};
use urdf_rs::{Geometry, Joint, JointType, Link, Robot};

use super::VehicleError;
use super::footprint::{Footprint, FootprintError, around_disc};
use super::mesh::{self, MeshError};
use crate::geometry::Point;
use crate::number::exact;

/// Content of the file, checked. Lengths relative to the rear axle.
#[derive(Debug)]
pub(super) struct Body {
    pub(super) footprint: Footprint,
    pub(super) wheelbase: f64,
    pub(super) rear_axle_to_mass: f64,
    pub(super) mass_height: f64,
    pub(super) track_width: f64,
    pub(super) mass: f64,
    pub(super) yaw_inertia: f64,
    pub(super) wheel_radius: f64,
    pub(super) wheel_inertia: f64,
    pub(super) steering: f64,
    pub(super) steering_rate: f64,
}

/// Tolerance of positions and angles, m and rad: files have rounded decimals.
const FRAME_TOLERANCE: f64 = 1e-3;

// Far beyond trucks of 60 t, racing cars and model cars: a larger number is a typing error or has another unit.
/// Heaviest link, kg.
const MAX_MASS: f64 = 200_000.0;
/// Largest yaw inertia of a link about its centre of mass, kg m²: 200 t on 70 m.
const MAX_YAW_INERTIA: f64 = 1e8;
/// Highest centre of mass, m.
const MAX_HEIGHT: f64 = 10.0;
/// Largest radius of a wheel, m.
const MAX_RADIUS: f64 = 3.0;
/// Largest inertia of a wheel about its axle, kg m².
const MAX_WHEEL_INERTIA: f64 = 1e5;
/// Fastest steering, rad/s.
const MAX_STEERING_RATE: f64 = 100.0;
/// Largest coordinate of an origin, m.
const MAX_COORDINATE: f64 = 1000.0;

/// Vertical component above which an axis is vertical and not horizontal.
const UPRIGHT: f64 = 0.5;

/// Returns the bytes of a mesh file by its name in the URDF.
pub(super) type MeshFiles<'a> = &'a dyn Fn(&str) -> Result<Vec<u8>, MeshError>;

/// Reads and checks the text of the file.
pub(super) fn read(file: &Path, text: &str, meshes: MeshFiles<'_>) -> Result<Body, VehicleError> {
    let with_inertial = xml::check(file, text)?;
    let robot = urdf_rs::read_from_string(text)
        .map_err(|e| VehicleError::NotUrdf { file: file.to_owned(), message: e.to_string() })?;
    Reader { file, robot: &robot, with_inertial, meshes }.body()
}

/// A link with its frame relative to the root, and the joint that it is the child of.
struct Placed<'a> {
    link: &'a Link,
    frame: Isometry3<f64>,
    joint: Option<&'a Joint>,
    /// The revolute joint that steers it, between it and the root.
    steered_by: Option<&'a Joint>,
    /// The first joint from the root that can move; `None` if the link is fixed to the root.
    moved_by: Option<&'a Joint>,
}

impl Placed<'_> {
    /// Whether it is a wheel: on a continuous joint about a horizontal axis. A continuous joint about the vertical is that
    /// of a hitch or a scanner.
    fn is_wheel(&self) -> bool {
        self.joint.is_some_and(|joint| {
            let axis = self.frame.rotation * nalgebra::Vector3::from(joint.axis.xyz.0);
            joint.joint_type == JointType::Continuous && axis.z.abs() <= UPRIGHT * axis.norm()
        })
    }
}

struct Wheel<'a> {
    name: &'a str,
    at: nalgebra::Vector3<f64>,
    steered_by: Option<&'a Joint>,
    radius: f64,
    inertia: f64,
}

struct Reader<'a> {
    file: &'a Path,
    robot: &'a Robot,
    with_inertial: Vec<String>,
    meshes: MeshFiles<'a>,
}

impl<'a> Reader<'a> {
    fn element<T>(&self, element: String, found: impl Into<String>, expected: &'static str) -> Result<T, VehicleError> {
        Err(VehicleError::Element { file: self.file.to_owned(), element, found: found.into(), expected })
    }

    fn body(&self) -> Result<Body, VehicleError> {
        let links = self.placed_links()?;
        self.refuse_moving_parts(&links)?;
        let wheels = self.wheels(&links)?;
        let (front, rear): (Vec<_>, Vec<_>) = wheels.iter().partition(|w| w.steered_by.is_some());
        let pair = |axle: &[&Wheel<'_>], name: &str| {
            match axle {
            [a, b] if a.at.y * b.at.y < 0.0 && (a.at.x - b.at.x).abs() < FRAME_TOLERANCE => {
                Ok((f64::midpoint(a.at.x, b.at.x), (a.at.y - b.at.y).abs()))
            }
            _ => self.element(
                format!("wheels of the {name} axle"),
                format!("{} wheel(s): {}", axle.len(), axle.iter().map(|w| w.name).collect::<Vec<_>>().join(", ")),
                "two wheels on continuous joints, left and right at the same x: the front ones steered, the rear ones not",
            ),
        }
        };
        let ((front_x, front_track), (rear_x, rear_track)) = (pair(&front, "front")?, pair(&rear, "rear")?);
        let wheelbase = front_x - rear_x;
        if wheelbase <= 0.0 {
            return self.element("wheelbase".into(), format!("{wheelbase} m"), "front wheels before the rear wheels");
        }
        let (steering, steering_rate) = self.steering(&front)?;
        let mean = |f: fn(&Wheel<'_>) -> f64| wheels.iter().map(f).sum::<f64>() / wheels.len() as f64;
        let (wheel_radius, ground) = (mean(|w| w.radius), mean(|w| w.at.z - w.radius));
        let (mass, centre, yaw_inertia) = self.mass(&links)?;
        if centre.y.abs() > FRAME_TOLERANCE {
            return self.element("centre of mass".into(), format!("{} m to the left", centre.y), "the middle (y = 0)");
        }
        let footprint = self.footprint(&links, rear_x)?;
        let (rear_axle_to_mass, mass_height) = (centre.x - rear_x, centre.z - ground);
        if !(0.0..=wheelbase).contains(&rear_axle_to_mass) || !(0.0..=MAX_HEIGHT).contains(&mass_height) {
            let found = format!("{rear_axle_to_mass} m before the rear axle, {mass_height} m above the ground");
            return self.element("centre of mass".into(), found, "between the axles and at most 10 m above the ground");
        }
        Ok(Body {
            footprint,
            wheelbase,
            rear_axle_to_mass,
            mass_height,
            track_width: f64::midpoint(front_track, rear_track),
            mass,
            yaw_inertia,
            wheel_radius,
            wheel_inertia: mean(|w| w.inertia),
            steering,
            steering_rate,
        })
    }

    /// Places every link in the root frame, the root first.
    fn placed_links(&self) -> Result<Vec<Placed<'a>>, VehicleError> {
        let robot: &'a Robot = self.robot;
        for joint in &robot.joints {
            for end in [&joint.parent.link, &joint.child.link] {
                if !robot.links.iter().any(|l| l.name == *end) {
                    return self.element(
                        format!("joint {}", joint.name),
                        format!("no link `{end}`"),
                        "links of this file",
                    );
                }
            }
        }
        let mut roots = robot.links.iter().filter(|l| !robot.joints.iter().any(|j| j.child.link == l.name));
        let (Some(root), None) = (roots.next(), roots.next()) else {
            let count = robot.links.iter().filter(|l| !robot.joints.iter().any(|j| j.child.link == l.name)).count();
            return self.element(
                "robot".into(),
                format!("{count} root links"),
                "one link that is not the child of a joint",
            );
        };
        let frame = Isometry3::identity();
        let mut placed = vec![Placed { link: root, frame, joint: None, steered_by: None, moved_by: None }];
        let mut next = 0;
        while next < placed.len() {
            let (parent, frame, steered) = (&placed[next].link.name, placed[next].frame, placed[next].steered_by);
            let moved = placed[next].moved_by;
            for joint in robot.joints.iter().filter(|j| j.parent.link == *parent) {
                let Some(link) = robot.links.iter().find(|l| l.name == joint.child.link) else { continue };
                if placed.iter().any(|p| p.link.name == link.name) || placed.len() > robot.links.len() {
                    return self.element(
                        format!("link {}", link.name),
                        "the child of two joints",
                        "one joint for each link",
                    );
                }
                let is_steering = joint.joint_type == JointType::Revolute && joint.axis.xyz[2].abs() > UPRIGHT;
                let steered_by = if is_steering { Some(joint) } else { steered };
                let frame = frame * self.isometry(&format!("joint {}", joint.name), &joint.origin)?;
                let moved_by = moved.or((joint.joint_type != JointType::Fixed).then_some(joint));
                placed.push(Placed { link, frame, joint: Some(joint), steered_by, moved_by });
            }
            next += 1;
        }
        if placed.len() < robot.links.len() {
            return self.element(
                "robot".into(),
                "links without a connection to the root",
                "a tree of joints without loops",
            );
        }
        Ok(placed)
    }

    fn isometry(&self, element: &str, pose: &urdf_rs::Pose) -> Result<Isometry3<f64>, VehicleError> {
        let ([x, y, z], [roll, pitch, yaw]) = (pose.xyz.0, pose.rpy.0);
        if [x, y, z, roll, pitch, yaw].iter().any(|v| !v.is_finite()) {
            return self.element(element.to_owned(), "an origin that is not finite", "finite numbers");
        }
        if let Some(far) = [x, y, z].into_iter().find(|v| v.abs() > MAX_COORDINATE) {
            let found = format!("an origin with the coordinate {}", exact(far));
            return self.element(element.to_owned(), found, "coordinates of at most 1000 m");
        }
        Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw)))
    }

    fn wheels(&self, links: &[Placed<'a>]) -> Result<Vec<Wheel<'a>>, VehicleError> {
        let mut wheels = Vec::new();
        for p in links.iter().filter(|p| p.is_wheel()) {
            let name = format!("link {}", p.link.name);
            let radius = p.link.collision.iter().find_map(|c| match c.geometry {
                Geometry::Cylinder { radius, .. } | Geometry::Sphere { radius } => Some(radius),
                _ => None,
            });
            let Some(radius) = radius else {
                let found = "a continuous joint about a horizontal axis, but no collision cylinder or sphere";
                return self.element(
                    name,
                    found,
                    "a cylinder with the radius of the wheel, or a joint of another type",
                );
            };
            if !(radius > 0.0 && radius <= MAX_RADIUS) {
                return self.element(name, format!("radius {}", exact(radius)), "a radius above 0, at most 3 m");
            }
            let inertia = p.link.inertial.inertia.iyy;
            if !(inertia > 0.0 && inertia <= MAX_WHEEL_INERTIA) {
                let expected = "an inertia about the axle above 0, at most 100000 kg m²";
                return self.element(name, format!("iyy {}", exact(inertia)), expected);
            }
            wheels.push(Wheel {
                name: &p.link.name,
                at: p.frame.translation.vector,
                steered_by: p.steered_by,
                radius,
                inertia,
            });
        }
        if wheels.is_empty() {
            return self.element(
                "robot".into(),
                "no wheels",
                "four wheel links on continuous joints about horizontal axes",
            );
        }
        Ok(wheels)
    }

    /// The smallest limits of the steering joints: angle and rate.
    fn steering(&self, front: &[&Wheel<'_>]) -> Result<(f64, f64), VehicleError> {
        let (mut angle, mut rate) = (f64::INFINITY, f64::INFINITY);
        for joint in front.iter().filter_map(|w| w.steered_by) {
            let limit = &joint.limit;
            let side = limit.upper.min(-limit.lower);
            if !(side > 0.0
                && side < std::f64::consts::FRAC_PI_2
                && limit.velocity > 0.0
                && limit.velocity <= MAX_STEERING_RATE)
            {
                return self.element(
                    format!("joint {}", joint.name),
                    format!(
                        "lower {}, upper {}, velocity {}",
                        exact(limit.lower),
                        exact(limit.upper),
                        exact(limit.velocity)
                    ),
                    "limits lower < 0 < upper below a right angle (rad), and a velocity above 0, at most 100 rad/s",
                );
            }
            (angle, rate) = (angle.min(side), rate.min(limit.velocity));
        }
        Ok((angle, rate))
    }

    /// Total mass (kg), centre of mass in the root frame (m), and yaw inertia about it (kg m²).
    fn mass(&self, links: &[Placed<'a>]) -> Result<(f64, nalgebra::Vector3<f64>, f64), VehicleError> {
        let mut parts = Vec::new();
        for p in links {
            let name = format!("link {}", p.link.name);
            let is_chassis_or_wheel = p.joint.is_none() || p.is_wheel();
            if !self.with_inertial.contains(&p.link.name) {
                if is_chassis_or_wheel {
                    return self.element(name, "no <inertial>", "mass and inertia of the chassis and of each wheel");
                }
                continue;
            }
            let (mass, inertia) = (p.link.inertial.mass.value, &p.link.inertial.inertia);
            let positive = |v: f64, most: f64| v <= most && (v > 0.0 || (v == 0.0 && !is_chassis_or_wheel));
            if !positive(mass, MAX_MASS) {
                return self.element(name, format!("mass {}", exact(mass)), "a mass above 0, at most 200000 kg");
            }
            if !positive(inertia.izz, MAX_YAW_INERTIA) {
                let found = format!("yaw inertia {}", exact(inertia.izz));
                return self.element(name, found, "an izz above 0, at most 1e8 kg m²");
            }
            let frame = p.frame * self.isometry(&name, &p.link.inertial.origin)?;
            if (frame.rotation * nalgebra::Vector3::z()).z < 1.0 - FRAME_TOLERANCE {
                return self.element(name, "an inertial frame that is rolled or pitched", "z axis up");
            }
            parts.push((mass, frame.translation.vector, inertia.izz));
        }
        let total: f64 = parts.iter().map(|p| p.0).sum();
        let centre = parts.iter().map(|(m, at, _)| at * *m).sum::<nalgebra::Vector3<f64>>() / total;
        let yaw = parts.iter().map(|(m, at, izz)| izz + m * (at - centre).xy().norm_squared()).sum();
        Ok((total, centre, yaw))
    }

    /// Projection of the collision elements of the root and of all links fixed to it, in the rear-axle frame.
    fn footprint(&self, links: &[Placed<'a>], rear_x: f64) -> Result<Footprint, VehicleError> {
        let (mut names, mut parts) = (Vec::new(), Vec::new());
        for p in links.iter().filter(|p| p.moved_by.is_none()) {
            for (i, collision) in p.link.collision.iter().enumerate() {
                let which = collision.name.clone().unwrap_or_else(|| (i + 1).to_string());
                let name = format!("link {}, collision {which}", p.link.name);
                let frame = p.frame * self.isometry(&name, &collision.origin)?;
                let frame = Translation3::new(-rear_x, 0.0, 0.0) * frame;
                parts.push(self.projected(&name, &frame, &collision.geometry)?);
                names.push(name);
            }
        }
        Footprint::new(parts).or_else(|e| {
            let root = || links.first().map_or_else(String::new, |p| format!("link {}", p.link.name));
            let element = e.part().and_then(|i| names.get(i).cloned()).unwrap_or_else(root);
            let expected = match e {
                FootprintError::Empty => "a <collision> element on it or on a link fixed to it",
                FootprintError::TooMany { .. } => "fewer collision elements: one mesh or box may enclose several",
                FootprintError::NotFinite { .. } => "finite origins, sizes and vertices",
                FootprintError::Flat { .. } => "a collision element that covers an area of the ground",
                FootprintError::TooFar { .. } => {
                    "corners within 50 m of it (a mesh in millimetres needs scale=\"0.001 0.001 0.001\")"
                }
            };
            self.element(element, format!("a footprint with {e}"), expected)
        })
    }

    /// Refuses collision elements on moving links, except on wheels and on links that steer one. A link behind a continuous
    /// joint about the vertical is neither, even with wheels: it is a trailer.
    fn refuse_moving_parts(&self, links: &[Placed<'a>]) -> Result<(), VehicleError> {
        let parent = |p: &Placed<'a>| links.iter().find(|q| p.joint.is_some_and(|j| j.parent.link == q.link.name));
        let is_hitched =
            |p: &&Placed<'a>| p.joint.is_some_and(|j| j.joint_type == JointType::Continuous) && !p.is_wheel();
        let with_wheels: Vec<&str> = (links.iter().filter(|p| p.is_wheel()))
            .flat_map(|wheel| std::iter::successors(Some(wheel), |p| parent(p)))
            .map(|p| p.link.name.as_str())
            .collect();
        for p in links.iter().filter(|p| !p.link.collision.is_empty()) {
            let hitch = std::iter::successors(Some(p), |p| parent(p)).find(is_hitched).and_then(|p| p.joint);
            let loose = p.moved_by.filter(|_| !with_wheels.contains(&p.link.name.as_str()));
            let Some(joint) = hitch.or(loose) else { continue };
            let expected = if hitch.is_some() {
                "a fixed joint, or no collision element: only wheels may be on continuous joints (no trailers)"
            } else {
                "fixed joints between the chassis and the parts of its outline"
            };
            let found = format!("a collision element that joint {} moves", joint.name);
            return self.element(format!("link {}", p.link.name), found, expected);
        }
        Ok(())
    }

    /// Points whose convex hull contains the projection of a geometry to the ground.
    fn projected(&self, name: &str, frame: &Isometry3<f64>, geometry: &Geometry) -> Result<Vec<Point>, VehicleError> {
        let ground = |x: f64, y: f64, z: f64| (frame * Point3::new(x, y, z)).xy();
        // discs around both ends of the axis: their hull is that of an upright cylinder or of any capsule
        let round = |radius: f64, half: f64| {
            [ground(0.0, 0.0, -half), ground(0.0, 0.0, half)].iter().flat_map(|end| around_disc(*end, radius)).collect()
        };
        match geometry {
            Geometry::Box { size } => {
                let [x, y, z] = self.sizes(name, "box", size.0)?.map(|s| 0.5 * s);
                let corners = [(-x, -y), (x, -y), (x, y), (-x, y)];
                let is_upright = frame.rotation.i == 0.0 && frame.rotation.j == 0.0;
                let heights = if is_upright { vec![0.0] } else { vec![-z, z] };
                Ok(heights.into_iter().flat_map(|z| corners.map(|(x, y)| ground(x, y, z))).collect())
            }
            Geometry::Sphere { radius } => {
                let [radius] = self.sizes(name, "sphere", [*radius])?;
                Ok(round(radius, 0.0))
            }
            Geometry::Capsule { radius, length } => {
                let [radius, length] = self.sizes(name, "capsule", [*radius, *length])?;
                Ok(round(radius, 0.5 * length))
            }
            Geometry::Cylinder { radius, length } => {
                let [radius, length] = self.sizes(name, "cylinder", [*radius, *length])?;
                if (frame.rotation * nalgebra::Vector3::z()).xy().norm() > FRAME_TOLERANCE {
                    return self.element(
                        name.to_owned(),
                        "a cylinder that is not upright",
                        "an upright cylinder, or a box",
                    );
                }
                Ok(round(radius, 0.5 * length))
            }
            Geometry::Mesh { filename, scale } => {
                let scale = scale.map_or([1.0; 3], |s| s.0);
                if !scale.iter().all(|s| s.is_finite() && *s != 0.0) {
                    let found = format!("scale {} {} {}", scale[0], scale[1], scale[2]);
                    return self.element(name.to_owned(), found, "finite numbers other than 0");
                }
                let vertices = self.vertices(filename).map_err(|source| VehicleError::Mesh {
                    file: self.file.to_owned(),
                    element: name.to_owned(),
                    mesh: filename.clone(),
                    source,
                })?;
                Ok(vertices.iter().map(|[x, y, z]| ground(x * scale[0], y * scale[1], z * scale[2])).collect())
            }
        }
    }

    fn vertices(&self, filename: &str) -> Result<Vec<[f64; 3]>, MeshError> {
        let is_stl = mesh::is_stl(filename)?;
        mesh::vertices(is_stl, &(self.meshes)(filename)?)
    }

    /// The sizes of a geometry, if they are positive and finite.
    fn sizes<const N: usize>(&self, name: &str, kind: &str, sizes: [f64; N]) -> Result<[f64; N], VehicleError> {
        if sizes.iter().all(|v| v.is_finite() && *v > 0.0) {
            return Ok(sizes);
        }
        let found = sizes.map(|v| v.to_string()).join(" ");
        self.element(name.to_owned(), format!("a {kind} of {found}"), "positive finite sizes (m)")
    }
}
