//! Reading `vehicles/NAME/`: `vehicle.urdf` says what the vehicle is made of, `dynamics.toml` what a URDF cannot say.
//!
//! A few vehicles are built into the program; others are read from a folder. Every number is checked here, once: what
//! [`load`] returns needs no further checks.

use std::io::Read;
use std::path::{Path, PathBuf};

use super::mesh::{MOST_BYTES, MeshError};
use super::{Vehicle, dynamics, urdf};

/// A vehicle embedded in the program.
struct Builtin {
    name: &'static str,
    urdf: &'static str,
    dynamics: &'static str,
    /// Mesh files by their names in the URDF.
    meshes: &'static [(&'static str, &'static [u8])],
}

const BUILTIN: [Builtin; 4] = [
    Builtin {
        name: "bmw_320i",
        urdf: include_str!("../../vehicles/bmw_320i/vehicle.urdf"),
        dynamics: include_str!("../../vehicles/bmw_320i/dynamics.toml"),
        meshes: &[],
    },
    Builtin {
        name: "ford_escort",
        urdf: include_str!("../../vehicles/ford_escort/vehicle.urdf"),
        dynamics: include_str!("../../vehicles/ford_escort/dynamics.toml"),
        meshes: &[],
    },
    Builtin {
        name: "truck",
        urdf: include_str!("../../vehicles/truck/vehicle.urdf"),
        dynamics: include_str!("../../vehicles/truck/dynamics.toml"),
        meshes: &[],
    },
    Builtin {
        name: "f1tenth",
        urdf: include_str!("../../vehicles/f1tenth/vehicle.urdf"),
        dynamics: include_str!("../../vehicles/f1tenth/dynamics.toml"),
        meshes: &[("body.obj", include_bytes!("../../vehicles/f1tenth/body.obj"))],
    },
];

const BUILTIN_NAMES: [&str; BUILTIN.len()] = {
    let mut names = [""; BUILTIN.len()];
    let mut i = 0;
    while i < names.len() {
        names[i] = BUILTIN[i].name;
        i += 1;
    }
    names
};

/// Why a vehicle could not be read. Each kind names the file and the element.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// Neither a built-in name nor a folder.
    #[error(
        "no vehicle `{name}`: expected one of {}, or a folder that holds vehicle.urdf and dynamics.toml",
        BUILTIN_NAMES.join(", ")
    )]
    Unknown {
        /// What was asked for.
        name: String,
    },
    /// A file is missing or cannot be read as text.
    #[error("{}: cannot be read: {source}", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not well-formed XML.
    #[error("{}: not XML: {message}", file.display())]
    NotXml {
        /// The file.
        file: PathBuf,
        /// What is wrong and where.
        message: String,
    },
    /// A xacro macro file in place of the URDF that it generates.
    #[error("{}: this is xacro, not URDF: run xacro first (`xacro model.urdf.xacro > vehicle.urdf`)", file.display())]
    Xacro {
        /// The file.
        file: PathBuf,
    },
    /// XML, but not a URDF that can be understood.
    #[error("{}: not a URDF: {message}", file.display())]
    NotUrdf {
        /// The file.
        file: PathBuf,
        /// What was expected.
        message: String,
    },
    /// TOML that does not parse, or has missing or unknown keys.
    #[error("{}: {message}", file.display())]
    Toml {
        /// The file.
        file: PathBuf,
        /// What is wrong, with the line.
        message: String,
    },
    /// A mesh of the footprint that cannot be read.
    #[error("{}: {element}: mesh `{mesh}`: {source}", file.display())]
    Mesh {
        /// The URDF.
        file: PathBuf,
        /// The element, with its name: `link base_link, collision 1`.
        element: String,
        /// The mesh, as the URDF names it.
        mesh: String,
        /// What is wrong.
        source: MeshError,
    },
    /// An element that is missing or has a value out of its range.
    #[error("{}: {element}: {found}; expected {expected}", file.display())]
    Element {
        /// The file.
        file: PathBuf,
        /// The element, with its name: `link base_link`, `tyres.friction`.
        element: String,
        /// What was found.
        found: String,
        /// What was expected.
        expected: &'static str,
    },
}

/// Names of the vehicles built into the program.
#[must_use]
pub fn builtin_names() -> &'static [&'static str] {
    &BUILTIN_NAMES
}

/// Loads a vehicle by built-in name, or from a folder that holds `vehicle.urdf` and `dynamics.toml` (the path of the
/// `vehicle.urdf` itself is understood too).
///
/// # Errors
/// An unknown name, an unreadable file, or a value out of its range.
pub fn load(name_or_folder: &str) -> Result<Vehicle, VehicleError> {
    if let Some(Builtin { name, urdf, dynamics, meshes }) = BUILTIN.iter().find(|b| b.name == name_or_folder) {
        let mesh = |wanted: &str| {
            let found = meshes.iter().find(|(name, _)| *name == wanted);
            found
                .map(|(_, bytes)| bytes.to_vec())
                .ok_or_else(|| std::io::Error::from(std::io::ErrorKind::NotFound).into())
        };
        return assemble(name, &Path::new("vehicles").join(name), urdf, dynamics, &mesh);
    }
    let given = Path::new(name_or_folder);
    let folder = if given.is_file() { given.parent().unwrap_or(given) } else { given };
    if name_or_folder.is_empty() || !folder.is_dir() {
        return Err(VehicleError::Unknown { name: name_or_folder.to_owned() });
    }
    let read = |file: &str| {
        let file = folder.join(file);
        std::fs::read_to_string(&file).map_err(|source| VehicleError::Unreadable { file, source })
    };
    let (urdf, toml) = (read("vehicle.urdf")?, read("dynamics.toml")?);
    let absolute = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = absolute.file_name().map_or_else(|| name_or_folder.to_owned(), |n| n.to_string_lossy().into_owned());
    assemble(&name, folder, &urdf, &toml, &|mesh| read_mesh(&folder.join(mesh)))
}

/// Reads a mesh file, unless it is too large to be one for collision.
fn read_mesh(file: &Path) -> Result<Vec<u8>, MeshError> {
    let mut bytes = Vec::new();
    std::fs::File::open(file)?.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MOST_BYTES { Err(MeshError::TooLarge) } else { Ok(bytes) }
}

/// Puts together what the two files and the meshes say.
fn assemble(
    name: &str,
    folder: &Path,
    urdf_text: &str,
    toml_text: &str,
    meshes: urdf::MeshFiles<'_>,
) -> Result<Vehicle, VehicleError> {
    let body = urdf::read(&folder.join("vehicle.urdf"), urdf_text, meshes)?;
    let dynamics = dynamics::read(&folder.join("dynamics.toml"), toml_text)?;
    Ok(Vehicle {
        name: name.to_owned(),
        commonroad_type: dynamics.commonroad_type,
        length: body.footprint.length(),
        width: body.footprint.width(),
        wheelbase: body.wheelbase,
        rear_axle_to_centre: body.footprint.rear_axle_to_centre(),
        footprint: body.footprint,
        rear_axle_to_mass: body.rear_axle_to_mass,
        mass_height: body.mass_height,
        track_width: body.track_width,
        mass: body.mass,
        yaw_inertia: body.yaw_inertia,
        wheel_radius: body.wheel_radius,
        wheel_inertia: body.wheel_inertia,
        limits: dynamics.limits(body.steering, body.steering_rate),
        tyres: dynamics.tyres,
        actuators: dynamics.actuators,
        comfort: dynamics.comfort,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bmw() -> (&'static str, &'static str) {
        (BUILTIN[0].urdf, BUILTIN[0].dynamics)
    }

    /// Puts files of no folder together: no mesh is found.
    fn assemble(name: &str, folder: &Path, urdf: &str, toml: &str) -> Result<Vehicle, VehicleError> {
        super::assemble(name, folder, urdf, toml, &|mesh| read_mesh(&Path::new("no/such/folder").join(mesh)))
    }

    /// Reads the BMW with one text of one file replaced.
    fn broken(urdf: (&str, &str), toml: (&str, &str)) -> String {
        let (u, t) = bmw();
        assert!(u.contains(urdf.0) && t.contains(toml.0), "the text to break is not there: {urdf:?} {toml:?}");
        let (u, t) = (u.replacen(urdf.0, urdf.1, 1), t.replacen(toml.0, toml.1, 1));
        assemble("x", Path::new("x"), &u, &t).expect_err(&format!("accepted {urdf:?} {toml:?}")).to_string()
    }

    #[test]
    fn published_mass_inertia_and_axles_come_out_of_the_links() {
        // M. Althoff and G. Würsching, "CommonRoad: Vehicle Models", 2020, table 6
        for (name, mass, inertia, a, b, height) in [
            (
                "bmw_320i",
                1_093.295_233_467_404_6,
                1_791.599_530_012_285_6,
                1.156_195_706_4,
                1.422_717_093_6,
                0.574_868_954_4,
            ),
            ("ford_escort", 1_225.887_846_725_334_4, 1_538.853_371_356_139_4, 0.883_92, 1.508_76, 0.557_784),
        ] {
            let v = load(name).unwrap();
            for (what, is, published) in [
                ("mass", v.mass, mass),
                ("yaw inertia", v.yaw_inertia, inertia),
                ("wheelbase", v.wheelbase, a + b),
                ("centre of mass", v.rear_axle_to_mass, b),
                ("centre", v.rear_axle_to_centre, b),
                ("height", v.mass_height, height),
            ] {
                assert!((is / published - 1.0).abs() < 1e-8, "{name}: {what} is {is}, published is {published}");
            }
        }
        let v = load("bmw_320i").unwrap();
        assert_eq!((v.length, v.width, v.wheel_radius, v.wheel_inertia), (4.508, 1.61, 0.344, 1.7));
        assert_eq!((v.limits.steering, v.limits.steering_rate), (1.066, 0.4));
        assert!((v.track_width - 0.5 * (1.38684 + 1.36398)).abs() < 1e-12);
        assert_eq!(v.commonroad_type, Some(2));
        assert_eq!(load("ford_escort").unwrap().commonroad_type, Some(1));
    }

    #[test]
    fn every_built_in_vehicle_loads() {
        for name in builtin_names() {
            assert_eq!(&load(name).unwrap().name, name);
        }
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        for name in ["bmw", "", "no/such/folder"] {
            let message = load(name).unwrap_err().to_string();
            assert!(message.contains("bmw_320i, ford_escort"), "{message}");
        }
    }

    #[test]
    fn a_folder_is_read_and_a_missing_file_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().to_str().unwrap();
        let message = load(path).unwrap_err().to_string();
        assert!(message.contains("vehicle.urdf: cannot be read"), "{message}");
        std::fs::write(folder.path().join("vehicle.urdf"), bmw().0).unwrap();
        let message = load(path).unwrap_err().to_string();
        assert!(message.contains("dynamics.toml: cannot be read"), "{message}");
        std::fs::write(folder.path().join("dynamics.toml"), bmw().1).unwrap();
        let builtin = load("bmw_320i").unwrap();
        let read = load(path).unwrap();
        assert_eq!(Vehicle { name: builtin.name.clone(), ..read }, builtin);
        let by_file = load(folder.path().join("vehicle.urdf").to_str().unwrap()).unwrap();
        assert_eq!(Vehicle { name: builtin.name.clone(), ..by_file }, builtin);
        std::fs::write(folder.path().join("dynamics.toml"), [0xff, 0xfe, 0x00]).unwrap();
        assert!(matches!(load(path), Err(VehicleError::Unreadable { .. })));
    }

    #[test]
    fn files_of_another_kind_are_told_apart() {
        let same = ("", "");
        assert!(broken(("<robot name", "<robot <name"), same).contains("not XML"));
        assert!(broken(("<?xml version=\"1.0\"?>", "just text"), same).contains("not XML"));
        let message = broken(("<robot ", "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\" "), same);
        assert!(message.contains("run xacro first"), "{message}");
        let message = assemble("x", Path::new("x"), "<commonRoad/>", bmw().1).unwrap_err().to_string();
        assert!(message.contains("<commonRoad>") && message.contains("<robot>"), "{message}");
        let message = assemble("x", Path::new("x"), "<robot name=\"x\"/>", bmw().1).unwrap_err().to_string();
        assert!(message.contains("vehicle.urdf"), "{message}");
    }

    #[test]
    fn one_wrong_thing_in_the_urdf_is_named() {
        let same = ("", "");
        for (old, new, part) in [
            ("<mass value=\"965.710868256\"/>", "<mass value=\"0\"/>", "link base_link: mass 0"),
            ("<mass value=\"965.710868256\"/>", "<mass value=\"-1\"/>", "link base_link: mass -1"),
            ("<mass value=\"965.710868256\"/>", "<mass value=\"nan\"/>", "link base_link"),
            ("<mass value=\"965.710868256\"/>", "<mass value=\"1e400\"/>", "link base_link"),
            ("<mass value=\"965.710868256\"/>", "<mass value=\"heavy\"/>", "vehicle.urdf"),
            ("<mass value=\"31.8960913028\"/>", "<mass value=\"-2\"/>", "link front_left_wheel: mass -2"),
            ("izz=\"1512.7097647948\"", "izz=\"-1\"", "link base_link: yaw inertia -1"),
            ("izz=\"1512.7097647948\"", "izz=\"inf\"", "link base_link"),
            ("type=\"revolute\"", "type=\"fixed\"", "front axle"),
            ("upper=\"1.066\"", "upper=\"0\"", "joint front_left_steering"),
            ("lower=\"-1.066\" upper=\"1.066\"", "lower=\"-2\" upper=\"2\"", "joint front_left_steering"),
            ("velocity=\"0.4\"", "velocity=\"0\"", "joint front_left_steering"),
            (
                "<cylinder radius=\"0.344\" length=\"0.205\"/>",
                "<cylinder radius=\"0\" length=\"0.2\"/>",
                "front_left_wheel",
            ),
            ("iyy=\"1.7\"", "iyy=\"0\"", "front_left_wheel"),
            ("<child link=\"left_steering_knuckle\"/>", "<child link=\"nobody\"/>", "nobody"),
            ("<origin xyz=\"2.5789128 0.69342 0.344\"/>", "<origin xyz=\"-2.5789128 0.69342 0.344\"/>", "front axle"),
        ] {
            let message = broken((old, new), same);
            assert!(message.contains(part) && message.contains("vehicle.urdf"), "{new}: {message}");
        }
    }

    #[test]
    fn a_chassis_without_inertial_no_wheels_or_no_steering_is_refused() {
        let read = |u: &str| assemble("x", Path::new("x"), u, bmw().1).unwrap_err().to_string();
        let start = bmw().0.find("    <inertial>").unwrap();
        let end = bmw().0.find("</inertial>\n").unwrap() + "</inertial>\n".len();
        let message = read(&format!("{}{}", &bmw().0[..start], &bmw().0[end..]));
        assert!(message.contains("link base_link: no <inertial>"), "{message}");
        let message = read(&bmw().0.replace("\"continuous\"", "\"fixed\""));
        assert!(message.contains("wheel"), "{message}");
        let message = read(&bmw().0.replace("\"revolute\"", "\"fixed\""));
        assert!(message.contains("steer"), "{message}");
        let message = read(&bmw().0.replace("2.5789128", "-2.5789128"));
        assert!(message.contains("wheelbase"), "{message}");
    }

    #[test]
    fn a_loop_of_joints_is_refused() {
        let u = "<robot name='x'><link name='a'/><link name='b'/><link name='c'/>\
                 <joint name='p' type='fixed'><parent link='a'/><child link='b'/></joint>\
                 <joint name='q' type='fixed'><parent link='b'/><child link='a'/></joint></robot>";
        assert!(assemble("x", Path::new("x"), u, bmw().1).is_err());
        let deep = format!("<robot>{}{}</robot>", "<a>".repeat(20_000), "</a>".repeat(20_000));
        assert!(assemble("x", Path::new("x"), &deep, bmw().1).is_err(), "deep nesting must not overflow the stack");
    }

    #[test]
    fn one_wrong_thing_in_the_toml_is_named() {
        let same = ("", "");
        for (old, new, part) in [
            ("friction = 1.0489", "friction = -1.0", "tyres.friction: -1"),
            ("friction = 1.0489", "friction = 0.0", "tyres.friction: 0"),
            ("friction = 1.0489", "friction = nan", "tyres.friction"),
            ("friction = 1.0489", "friction = 1", ""),
            ("friction = 1.0489", "fricton = 1.0", "fricton"),
            ("friction = 1.0489", "", "friction"),
            ("friction = 1.0489", "friction = \"high\"", "friction"),
            ("drag = 0.39", "drag = -0.1", "tyres.drag"),
            ("speed = 50.8", "speed = inf", "limits.speed"),
            ("drive_front_share = 0.0", "drive_front_share = 1.5", "actuators.drive_front_share"),
            ("brake_lag = 0.10", "brake_lag = 0.0", "actuators.brake_lag"),
            ("jerk = 2.5", "jerk = 0.0", "comfort.jerk"),
            ("aggressive_deceleration = 2.2", "aggressive_deceleration = 1.0", "comfort.aggressive_deceleration"),
            ("[comfort]", "[comfort", "dynamics.toml"),
        ] {
            if part.is_empty() {
                continue;
            }
            let message = broken(same, (old, new));
            assert!(message.contains(part) && message.contains("dynamics.toml"), "{new}: {message}");
        }
    }
}
