//! Reads a vehicle from `vehicles/NAME/`: geometry, masses and steering limits from `vehicle.urdf`, the rest from
//! `dynamics.toml`.
//!
//! Some vehicles are built into the program; others are read from a folder. Every number is checked here, so that a
//! [`Vehicle`] needs no further checks.

use std::path::{Path, PathBuf};

use super::mesh::{MAX_BYTES, MeshError};
use super::{TrackingTube, Vehicle, dynamics, urdf};
use crate::io::files::{self, InputError};
use crate::io::settings_file::nearest;
use crate::io::text;

/// Largest `vehicle.urdf` or `dynamics.toml`, bytes.
const MAX_TEXT: u64 = 16 << 20;

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

/// Why a vehicle could not be read. The messages name the file and the element.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// Neither a built-in name nor a folder.
    #[error(
        "no vehicle `{name}`: expected one of {}, or a folder with vehicle.urdf and dynamics.toml{}",
        BUILTIN_NAMES.join(", "),
        suggestion(name)
    )]
    Unknown {
        /// The requested name or folder.
        name: String,
    },
    /// A file is missing, cannot be read, or is not text.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Not well-formed XML.
    #[error("{}: not XML: {message}", file.display())]
    NotXml {
        /// The file.
        file: PathBuf,
        /// The reason, with the position.
        message: String,
    },
    /// A xacro macro file in place of the URDF that it generates.
    #[error("{}: this is xacro, not URDF: run xacro first (`xacro model.urdf.xacro > vehicle.urdf`)", file.display())]
    Xacro {
        /// The file.
        file: PathBuf,
    },
    /// XML, but not a valid URDF.
    #[error("{}: not a URDF: {message}", file.display())]
    NotUrdf {
        /// The file.
        file: PathBuf,
        /// The reason.
        message: String,
    },
    /// Invalid TOML, or a missing or unknown key.
    #[error("{}: {message}", file.display())]
    Toml {
        /// The file.
        file: PathBuf,
        /// The reason, with the line.
        message: String,
    },
    /// A mesh of the footprint that cannot be read.
    #[error("{}: {element}: mesh `{mesh}`: {source}", file.display())]
    Mesh {
        /// The URDF.
        file: PathBuf,
        /// The element, with its name: `link base_link, collision 1`.
        element: String,
        /// File name of the mesh in the URDF.
        mesh: String,
        /// The reason.
        source: MeshError,
    },
    /// An element that is missing or has a value out of its range.
    #[error("{}: {element}: {found}; expected {expected}", file.display())]
    Element {
        /// The file.
        file: PathBuf,
        /// The element, with its name: `link base_link`, `tyres.friction`.
        element: String,
        /// The value in the file.
        found: String,
        /// The values that are valid.
        expected: &'static str,
    },
}

/// The built-in name nearest to an unknown one, as the end of a message.
fn suggestion(unknown: &str) -> String {
    let last = Path::new(unknown).file_name().map(|name| name.to_string_lossy()).unwrap_or_default();
    nearest(&last, BUILTIN_NAMES).map_or_else(String::new, |name| format!("; did you mean `{name}`?"))
}

/// Names of the vehicles built into the program.
#[must_use]
pub fn builtin_names() -> &'static [&'static str] {
    &BUILTIN_NAMES
}

/// Loads a vehicle by its built-in name, or from a folder with `vehicle.urdf` and `dynamics.toml`. The path of a file in
/// the folder stands for the folder.
///
/// # Errors
/// An unknown name, an unreadable file, or a value out of its range.
pub fn load(name_or_folder: &str) -> Result<Vehicle, VehicleError> {
    if let Some(Builtin { name, urdf, dynamics, meshes }) = BUILTIN.iter().find(|b| b.name == name_or_folder) {
        let mesh = |file: &str| {
            let mesh = meshes.iter().find(|(name, _)| *name == file);
            mesh.map(|(_, bytes)| bytes.to_vec())
                .ok_or_else(|| std::io::Error::from(std::io::ErrorKind::NotFound).into())
        };
        return assemble(name, &Path::new("vehicles").join(name), urdf, dynamics, &mesh);
    }
    let given = Path::new(name_or_folder);
    let folder = if given.is_file() { given.parent().unwrap_or(given) } else { given };
    if name_or_folder.is_empty() || !folder.is_dir() {
        return Err(VehicleError::Unknown { name: name_or_folder.to_owned() });
    }
    let read = |file: &str| text::read(&folder.join(file), MAX_TEXT);
    let (urdf, toml) = (read("vehicle.urdf")?, read("dynamics.toml")?);
    let absolute = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = absolute.file_name().map_or_else(|| name_or_folder.to_owned(), |n| n.to_string_lossy().into_owned());
    assemble(&name, folder, &urdf, &toml, &|mesh| read_mesh(&folder.join(mesh)))
}

/// The files that [`load`] may read for a folder; none for a built-in vehicle.
#[must_use]
pub fn files_of(name_or_folder: &str) -> Vec<PathBuf> {
    let given = Path::new(name_or_folder);
    let folder = if given.is_file() { given.parent().unwrap_or(given) } else { given };
    let is_read = |file: &PathBuf| {
        let kind = file.extension().map(|e| e.to_string_lossy().to_lowercase());
        matches!(kind.as_deref(), Some("urdf" | "toml" | "obj" | "stl"))
    };
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    entries.flatten().map(|entry| entry.path()).filter(is_read).collect()
}

/// Reads a mesh file, if it is small enough to be a mesh for collision checks.
fn read_mesh(file: &Path) -> Result<Vec<u8>, MeshError> {
    files::read(file, MAX_BYTES).map_err(|e| match e {
        InputError::Unreadable { source, .. } => MeshError::Unreadable(source),
        InputError::TooLarge { .. } | InputError::NotText { .. } => MeshError::TooLarge,
    })
}

/// Combines the two files and the meshes.
fn assemble(
    name: &str,
    folder: &Path,
    urdf_text: &str,
    toml_text: &str,
    meshes: urdf::MeshFiles<'_>,
) -> Result<Vehicle, VehicleError> {
    let body = urdf::read(&folder.join("vehicle.urdf"), urdf_text, meshes)?;
    let dynamics = dynamics::read(&folder.join("dynamics.toml"), toml_text)?;
    let limits = dynamics.limits(body.steering, body.steering_rate);
    let estimated = || TrackingTube::estimated(&dynamics.tyres, &dynamics.actuators, &limits, body.wheelbase);
    Ok(Vehicle {
        tracking: dynamics.tracking.unwrap_or_else(estimated),
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
        limits,
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

    /// Combines texts without a folder, so that every mesh is missing.
    fn assemble(name: &str, folder: &Path, urdf: &str, toml: &str) -> Result<Vehicle, VehicleError> {
        super::assemble(name, folder, urdf, toml, &|mesh| read_mesh(&Path::new("no/such/folder").join(mesh)))
    }

    /// The message of reading the BMW with one text of each file replaced.
    fn refusal(urdf: (&str, &str), toml: (&str, &str)) -> String {
        let (u, t) = bmw();
        assert!(u.contains(urdf.0) && t.contains(toml.0), "the text to replace is missing: {urdf:?} {toml:?}");
        let (u, t) = (u.replacen(urdf.0, urdf.1, 1), t.replacen(toml.0, toml.1, 1));
        assemble("x", Path::new("x"), &u, &t).expect_err(&format!("accepted {urdf:?} {toml:?}")).to_string()
    }

    #[test]
    fn the_links_sum_up_to_the_published_mass_inertia_and_axles() {
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
    fn loads_every_built_in_vehicle() {
        for name in builtin_names() {
            assert_eq!(&load(name).unwrap().name, name);
        }
    }

    #[test]
    fn suggests_the_nearest_built_in_vehicle() {
        for (name, meant) in
            [("truk", "truck"), ("bmw_320", "bmw_320i"), ("BMW-320i", "bmw_320i"), ("my/f1tnth", "f1tenth")]
        {
            let message = load(name).unwrap_err().to_string();
            assert!(message.ends_with(&format!("dynamics.toml; did you mean `{meant}`?")), "{message}");
        }
        let message = load("bicycle").unwrap_err().to_string();
        assert!(!message.contains("did you mean"), "{message}");
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        for name in ["bmw", "", "no/such/folder"] {
            let message = load(name).unwrap_err().to_string();
            assert!(message.contains("bmw_320i, ford_escort"), "{message}");
        }
    }

    #[test]
    fn reads_a_folder_and_names_a_missing_file() {
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
        for (file, text) in [("vehicle.urdf", bmw().0), ("dynamics.toml", bmw().1)] {
            let utf16: Vec<u8> = format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect();
            std::fs::write(folder.path().join(file), utf16).unwrap();
        }
        let encoded = load(path).unwrap();
        assert_eq!(Vehicle { name: builtin.name.clone(), ..encoded }, builtin);
        std::fs::write(folder.path().join("dynamics.toml"), [0xff, 0xfe, 0x00]).unwrap();
        assert!(matches!(load(path), Err(VehicleError::Input(InputError::NotText { .. }))));
    }

    #[test]
    fn refuses_files_of_another_kind() {
        let same = ("", "");
        assert!(refusal(("<robot name", "<robot <name"), same).contains("not XML"));
        assert!(refusal(("<?xml version=\"1.0\"?>", "just text"), same).contains("not XML"));
        let message = refusal(("<robot ", "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\" "), same);
        assert!(message.contains("run xacro first"), "{message}");
        let message = assemble("x", Path::new("x"), "<commonRoad/>", bmw().1).unwrap_err().to_string();
        assert!(message.contains("<commonRoad>") && message.contains("<robot>"), "{message}");
        let message = assemble("x", Path::new("x"), "<robot name=\"x\"/>", bmw().1).unwrap_err().to_string();
        assert!(message.contains("vehicle.urdf"), "{message}");
    }

    #[test]
    fn names_the_element_of_an_invalid_urdf() {
        let same = ("", "");
        for (old, new, part) in [
            ("<mass value=\"965.710868256\"/>", "<mass value=\"0\"/>", "link base_link: mass 0"),
            ("<mass value=\"965.710868256\"/>", "<mass value=\"-1\"/>", "link base_link: mass -1"),
            ("<mass value=\"965.710868256\"/>", "<mass value=\"nan\"/>", "link base_link"),
            ("<mass value=\"965.710868256\"/>", "<mass value=\"1e400\"/>", "link base_link"),
            (
                "<mass value=\"965.710868256\"/>",
                "<mass value=\"heavy\"/>",
                "link base_link, inertial, mass: value=\"heavy\"; expected a number",
            ),
            (
                "<mass value=\"965.710868256\"/>",
                "<mass/>",
                "link base_link, inertial, mass: no value; expected a number",
            ),
            ("<mass value=\"965.710868256\"/>", "", "link base_link, inertial: no <mass>"),
            ("izz=\"1512.7097647948\"", "", "link base_link, inertial, inertia: no izz; expected a number"),
            (
                "<axis xyz=\"0 0 1\"/>",
                "<axis xyz=\"0 1\"/>",
                "joint front_left_steering, axis: xyz=\"0 1\"; expected three",
            ),
            (
                "<origin xyz=\"2.5789128 0.69342 0.344\"/>",
                "<origin xyz=\"a b c\"/>",
                "joint front_left_steering, origin",
            ),
            ("type=\"revolute\"", "type=\"hinge\"", "joint front_left_steering: type=\"hinge\"; expected revolute"),
            ("<child link=\"left_steering_knuckle\"/>", "", "joint front_left_steering: no <child>"),
            ("<child link=\"left_steering_knuckle\"/>", "<child/>", "joint front_left_steering, child: no link"),
            ("velocity=\"0.4\"", "", "joint front_left_steering, limit: no velocity; expected a number"),
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
            ("<child link=\"left_steering_knuckle\"/>", "<child link=\"missing\"/>", "missing"),
            ("<origin xyz=\"2.5789128 0.69342 0.344\"/>", "<origin xyz=\"-2.5789128 0.69342 0.344\"/>", "front axle"),
        ] {
            let message = refusal((old, new), same);
            assert!(message.contains(part) && message.contains("vehicle.urdf"), "{new}: {message}");
        }
        let message = refusal(("<mass value=\"965.710868256\"/>", "<mass value=\"heavy\"/>"), same);
        let line = 1 + bmw().0[..bmw().0.find("<mass value").unwrap()].matches('\n').count();
        assert!(message.contains(&format!("vehicle.urdf: line {line}: link base_link")), "{message}");
    }

    #[test]
    fn implausible_numbers_are_refused_with_their_range() {
        let same = ("", "");
        for (old, new, part) in [
            (
                "<mass value=\"965.710868256\"/>",
                "<mass value=\"1e300\"/>",
                "mass 1e300; expected a mass above 0, at most 200000 kg",
            ),
            (
                "izz=\"1512.7097647948\"",
                "izz=\"1e300\"",
                "yaw inertia 1e300; expected an izz above 0, at most 1e8 kg m²",
            ),
            (
                "iyy=\"1.7\"",
                "iyy=\"1e300\"",
                "iyy 1e300; expected an inertia about the axle above 0, at most 100000 kg m²",
            ),
            ("velocity=\"0.4\"", "velocity=\"1e300\"", "velocity 1e300; expected limits"),
            (
                "<cylinder radius=\"0.344\"",
                "<cylinder radius=\"344\"",
                "radius 344; expected a radius above 0, at most 3 m",
            ),
            (
                "xyz=\"2.5789128 0.69342 0.344\"",
                "xyz=\"2.5789128 0.69342 1e300\"",
                "1e300; expected coordinates of at most 1000 m",
            ),
        ] {
            let message = refusal((old, new), same);
            assert!(message.contains(part), "{new}: {message}");
        }
        for (old, new, part) in [
            ("drag = 0.39", "drag = 1e300", "tyres.drag: 1e300; expected from 0 to 100 N s²/m²"),
            ("jerk = 2.5", "jerk = 1e300", "comfort.jerk: 1e300; expected above 0, at most 1000 m/s³"),
            ("friction = 1.0489", "friction = 1e300", "tyres.friction: 1e300; expected above 0, at most 5"),
            ("speed = 50.8", "speed = 508.0", "limits.speed: 508; expected above 0, at most 150 m/s"),
            ("brake_lag = 0.10", "brake_lag = 1e9", "actuators.brake_lag: 1e9; expected above 0, at most 10 s"),
            (
                "rolling_resistance = 0.012",
                "rolling_resistance = 1.2",
                "tyres.rolling_resistance: 1.2; expected from 0 to 1",
            ),
            (
                "aggressive_deceleration = 2.2",
                "aggressive_deceleration = 1e300",
                "expected at least comfort.deceleration",
            ),
        ] {
            let message = refusal(same, (old, new));
            assert!(message.contains(part), "{new}: {message}");
        }
    }

    /// A truck of 60 t and a racing car are within the bounds; `f1tenth` is a model car.
    #[test]
    fn unusual_vehicles_are_accepted() {
        let truck = &BUILTIN[2];
        let heavy = truck
            .urdf
            .replace("mass value=\"7900\"", "mass value=\"59300\"")
            .replace("izz=\"54800\"", "izz=\"1000000\"");
        assert!(assemble("x", Path::new("x"), &heavy, truck.dynamics).unwrap().mass > 59_000.0);
        let mut racing: toml::Table = bmw().1.parse().unwrap();
        for (table, key, value) in [
            ("limits", "speed", 110.0),
            ("limits", "acceleration", 20.0),
            ("limits", "deceleration", 60.0),
            ("limits", "steering_acceleration", 200.0),
            ("tyres", "friction", 2.5),
            ("tyres", "cornering_front", 60.0),
            ("tyres", "drag", 1.5),
            ("comfort", "lateral_acceleration", 50.0),
            ("comfort", "jerk", 300.0),
        ] {
            racing[table][key] = value.into();
        }
        assemble("x", Path::new("x"), bmw().0, &racing.to_string()).unwrap();
    }

    /// Elements for other programs may be inside of links or beside them.
    #[test]
    fn ignores_extensions_of_other_programs() {
        let extensions = "<gazebo reference=\"base_link\"><mass/><origin xyz=\"x\"/></gazebo>\
                          <transmission name=\"t\"><type>x</type><joint name=\"front_left_axle\"/></transmission></robot>";
        let urdf = bmw().0.replacen("</robot>", extensions, 1);
        assemble("x", Path::new("x"), &urdf, bmw().1).unwrap();
    }

    const BOX: &str = "<box size=\"4.508 1.61 1.415\"/>";
    const BOX_ORIGIN: &str = "<origin xyz=\"1.4227170936 0 0.7075\"/>";

    /// Reads the BMW with its box replaced, from a folder with the given mesh files.
    fn with_geometry(geometry: &str, meshes: &[(&str, &[u8])]) -> Result<Vehicle, VehicleError> {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in meshes {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        std::fs::write(folder.path().join("vehicle.urdf"), bmw().0.replacen(BOX, geometry, 1)).unwrap();
        std::fs::write(folder.path().join("dynamics.toml"), bmw().1).unwrap();
        load(folder.path().to_str().unwrap())
    }

    #[test]
    fn the_footprint_of_one_box_is_exactly_its_rectangle() {
        for (name, length, width, centre) in
            [("bmw_320i", 4.508, 1.61, 1.422_717_093_6), ("ford_escort", 4.298, 1.674, 1.508_76)]
        {
            let v = load(name).unwrap();
            assert_eq!((v.length, v.width, v.rear_axle_to_centre), (length, width, centre));
            assert_eq!(v.footprint, super::super::Footprint::rectangle(length, width, centre));
            assert!(v.footprint.is_rectangle());
        }
    }

    #[test]
    fn the_truck_has_a_cab_narrower_than_its_box_and_the_robot_a_hexagon() {
        let truck = load("truck").unwrap();
        let widths: Vec<f64> =
            (truck.footprint.parts().iter()).map(|part| 2.0 * part.iter().fold(0.0, |w: f64, p| w.max(p.y))).collect();
        assert_eq!(widths, [2.55, 2.3]);
        assert!((truck.length - 9.15).abs() < 1e-9 && (truck.front_overhang_from_rear_axle() - 7.32).abs() < 1e-9);
        // AASHTO: turning radius of the front axle's middle at the largest steering angle
        let radius = truck.wheelbase / truck.limits.steering.sin();
        assert!((radius - 11.58).abs() < 0.05, "{radius}");
        let robot = load("f1tenth").unwrap();
        assert_eq!((robot.footprint.parts().len(), robot.footprint.parts()[0].len()), (1, 6));
        assert!((robot.length - 0.58).abs() < 1e-9 && (robot.width - 0.31).abs() < 1e-9);
        for (what, is, published) in [
            ("mass", robot.mass, 3.74),
            ("yaw inertia", robot.yaw_inertia, 0.04712),
            ("centre of mass", robot.rear_axle_to_mass, 0.17145),
            ("height", robot.mass_height, 0.074),
            ("wheelbase", robot.wheelbase, 0.15875 + 0.17145),
        ] {
            assert!((is / published - 1.0).abs() < 1e-6, "{what} is {is}, published is {published}");
        }
    }

    #[test]
    fn a_rotated_box_gives_its_projection() {
        let read = |origin: &str| {
            let urdf = bmw().0.replacen(BOX_ORIGIN, origin, 1);
            assemble("x", Path::new("x"), &urdf, bmw().1).unwrap()
        };
        let quarter = read("<origin xyz=\"1.4 0 0.7\" rpy=\"0 0 1.5707963267948966\"/>");
        assert!(quarter.footprint.is_rectangle());
        assert!((quarter.length - 1.61).abs() < 1e-9 && (quarter.width - 4.508).abs() < 1e-9);
        let eighth = read("<origin xyz=\"1.4 0 0.7\" rpy=\"0 0 0.7853981633974483\"/>");
        let side = (4.508 + 1.61) / 2f64.sqrt();
        assert!((eighth.length - side).abs() < 1e-9 && (eighth.width - side).abs() < 1e-9);
        assert_eq!(eighth.footprint.parts()[0].len(), 4);
        // pitched by a right angle, the height of the box becomes its length
        let on_end = read("<origin xyz=\"1.4 0 0.7\" rpy=\"0 1.5707963267948966 0\"/>");
        assert!((on_end.length - 1.415).abs() < 1e-9 && (on_end.width - 1.61).abs() < 1e-9);
        let aside = read("<origin xyz=\"1.4 0.2 0.7\"/>");
        assert!((aside.width - 2.01).abs() < 1e-9 && !aside.footprint.is_rectangle());
    }

    #[test]
    fn the_footprint_includes_fixed_links_and_refuses_moving_ones() {
        let rack = |kind: &str| {
            let link = "<link name=\"rack\"><collision><origin xyz=\"-0.1 0 0\"/><geometry><box size=\"0.6 1.7 1\"/>\
                        </geometry></collision></link>";
            let joint = format!(
                "<joint name=\"mount\" type=\"{kind}\"><parent link=\"base_link\"/><child link=\"rack\"/>\
                 <origin xyz=\"-1.0 0 0.5\" rpy=\"0 0 3.141592653589793\"/><axis xyz=\"0 0 1\"/>\
                 <limit lower=\"-1\" upper=\"1\" velocity=\"1\" effort=\"1\"/></joint></robot>"
            );
            let urdf = bmw().0.replacen("</robot>", &format!("{link}{joint}"), 1);
            assemble("x", Path::new("x"), &urdf, bmw().1)
        };
        let v = rack("fixed").unwrap();
        // the link points backwards, so that -0.1 is forward: from -1.2 to -0.6
        let rear = v.footprint.parts()[1].iter().fold(f64::INFINITY, |a, p| a.min(p.x));
        assert!((rear + 1.2).abs() < 1e-9 && v.footprint.parts().len() == 2);
        assert!((v.width - 1.7).abs() < 1e-9 && (v.length - (1.2 + v.front_overhang_from_rear_axle())).abs() < 1e-9);
        let message = rack("prismatic").unwrap_err().to_string();
        assert!(message.contains("link rack") && message.contains("joint mount"), "{message}");
    }

    /// A link on a continuous joint about the vertical is not a wheel, even if it is round or has wheels.
    #[test]
    fn a_trailer_or_scanner_on_a_continuous_joint_is_not_a_wheel() {
        let with = |links: &str| {
            let urdf = bmw().0.replacen("</robot>", &format!("{links}</robot>"), 1);
            assemble("x", Path::new("x"), &urdf, bmw().1)
        };
        let joint = |name: &str, parent: &str, child: &str, axis: &str, xyz: &str| {
            format!(
                "<joint name=\"{name}\" type=\"continuous\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
                 <origin xyz=\"{xyz}\"/><axis xyz=\"{axis}\"/></joint>"
            )
        };
        let inertial = "<inertial><mass value=\"20\"/><inertia ixx=\"1\" ixy=\"0\" ixz=\"0\" iyy=\"1\" iyz=\"0\" izz=\"1\"/></inertial>";
        let link = |name: &str, geometry: &str| {
            format!("<link name=\"{name}\">{inertial}<collision><geometry>{geometry}</geometry></collision></link>")
        };
        let (hitch, deck) =
            (joint("hitch", "base_link", "trailer", "0 0 1", "-1 0 0.4"), link("trailer", "<box size=\"3 2 1\"/>"));
        let message = with(&format!("{deck}{hitch}")).unwrap_err().to_string();
        assert!(
            message.contains("link trailer: a collision element that joint hitch moves")
                && message.contains("no trailers"),
            "{message}"
        );
        let wheels = ["0.8", "-0.8"].map(|y| {
            let name = format!("wheel{y}");
            let at = format!("-2 {y} 0");
            link(&name, "<cylinder radius=\"0.3\" length=\"0.2\"/>")
                + &joint(&format!("axle{y}"), "trailer", &name, "0 1 0", &at)
        });
        let message = with(&format!("{deck}{hitch}{}", wheels.concat())).unwrap_err().to_string();
        assert!(message.contains("joint hitch moves") && message.contains("no trailers"), "{message}");
        let scanner = joint("spin", "base_link", "scanner", "0 0 1", "1 0 1.5");
        let round = link("scanner", "<cylinder radius=\"0.05\" length=\"0.1\"/>");
        let message = with(&format!("{round}{scanner}")).unwrap_err().to_string();
        assert!(message.contains("link scanner") && message.contains("joint spin"), "{message}");
        // without a collision element, it is only a mass
        let bare = format!("<link name=\"scanner\">{inertial}</link>{scanner}");
        assert!((with(&bare).unwrap().mass - load("bmw_320i").unwrap().mass - 20.0).abs() < 1e-9);
        // an error about a third rear wheel names it
        let extra = link("spare", "<cylinder radius=\"0.3\" length=\"0.2\"/>")
            + &joint("axle", "base_link", "spare", "0 1 0", "0.5 0.7 0.3");
        let message = with(&extra).unwrap_err().to_string();
        assert!(message.contains("3 wheel(s)") && message.contains("spare"), "{message}");
    }

    #[test]
    fn round_bodies_become_polygons_two_percent_larger() {
        let v = with_geometry("<cylinder radius=\"0.9\" length=\"1.2\"/>", &[]).unwrap();
        assert!((v.length - 1.8).abs() < 1e-9 && (v.width - 1.8).abs() < 1e-9 && v.footprint.parts()[0].len() == 16);
        let v = with_geometry("<sphere radius=\"0.9\"/>", &[]).unwrap();
        assert!((v.length - 1.8).abs() < 1e-9);
        let rotated = bmw().0.replacen(BOX, "<capsule radius=\"0.5\" length=\"3\"/>", 1);
        let rotated = rotated.replacen(BOX_ORIGIN, "<origin xyz=\"1.4 0 0.7\" rpy=\"0 1.5707963267948966 0\"/>", 1);
        let v = assemble("x", Path::new("x"), &rotated, bmw().1).unwrap();
        assert!((v.length - 4.0).abs() < 1e-9 && (v.width - 1.0).abs() < 1e-9, "{} {}", v.length, v.width);
        let horizontal = bmw().0.replacen(BOX, "<cylinder radius=\"0.5\" length=\"3\"/>", 1);
        let horizontal = horizontal.replacen(BOX_ORIGIN, "<origin xyz=\"1.4 0 0.7\" rpy=\"0 1.57 0\"/>", 1);
        let message = assemble("x", Path::new("x"), &horizontal, bmw().1).unwrap_err().to_string();
        assert!(message.contains("not upright") && message.contains("base_link, collision 1"), "{message}");
    }

    #[test]
    fn a_mesh_gives_its_convex_hull() {
        let obj = b"v -2 -0.8 0\nv 2 -0.8 0\nv 2.5 0 1\nv 2 0.8 0\nv -2 0.8 0\nv 0 0 3\n";
        let v = with_geometry("<mesh filename=\"body.obj\"/>", &[("body.obj", obj)]).unwrap();
        assert_eq!(v.footprint.parts()[0].len(), 5);
        assert!((v.length - 4.5).abs() < 1e-9 && (v.width - 1.6).abs() < 1e-9);
        let scaled = "<mesh filename=\"body.obj\" scale=\"0.5 -1 1\"/>";
        let v = with_geometry(scaled, &[("body.obj", obj)]).unwrap();
        assert!((v.length - 2.25).abs() < 1e-9);
        let stl = b"solid x\nvertex 0 -0.8 0\nvertex 2.5 0 1\nvertex 0 0.8 0\nendsolid";
        let v = with_geometry("<mesh filename=\"body.STL\"/>", &[("body.STL", stl)]).unwrap();
        assert_eq!(v.footprint.parts()[0].len(), 3);
    }

    #[test]
    fn names_the_element_of_an_invalid_footprint() {
        let line = b"v 0 0 0\nv 1 1 0\nv 2 2 5";
        let mm = b"v -2000 -800 0\nv 2000 -800 0\nv 0 800 0";
        let files: [(&str, &[u8]); 6] = [
            ("line.obj", line),
            ("empty.obj", b"# no vertices\n"),
            ("short.obj", b"v 1 2"),
            ("nan.obj", b"v 1 nan 2"),
            ("cut.stl", b"not an stl"),
            ("mm.obj", mm),
        ];
        let many = format!(
            "{BOX}</geometry></collision>{}",
            "<collision><geometry><box size=\"1 1 1\"/></geometry></collision>".repeat(40)
        );
        let many = many.strip_suffix("</geometry></collision>").unwrap();
        for (geometry, part) in [
            ("<box size=\"4.508 0 1.4\"/>", "collision 1: a box of 4.508 0 1.4"),
            ("<box size=\"-4.508 1 1.4\"/>", "collision 1: a box of -4.508"),
            ("<box size=\"nan 1 1.4\"/>", "collision 1: a box of NaN"),
            ("<box size=\"4 1\"/>", "vehicle.urdf"),
            ("<sphere radius=\"0\"/>", "collision 1: a sphere of 0"),
            ("<cylinder radius=\"1\" length=\"-1\"/>", "collision 1: a cylinder of 1 -1"),
            ("<capsule radius=\"inf\" length=\"1\"/>", "collision 1: a capsule of inf 1"),
            ("<box size=\"400 1 1\"/>", "collision 1: a footprint with a corner 201.4 m from the rear axle"),
            ("<mesh filename=\"none.obj\"/>", "collision 1: mesh `none.obj`: cannot be read"),
            ("<mesh filename=\"package://car/body.stl\"/>", "mesh `package://car/body.stl`: a URL"),
            ("<mesh filename=\"body.dae\"/>", "mesh `body.dae`: unknown kind"),
            ("<mesh filename=\"line.obj\"/>", "collision 1: a footprint with no area"),
            ("<mesh filename=\"empty.obj\"/>", "mesh `empty.obj`: no vertices"),
            ("<mesh filename=\"short.obj\"/>", "mesh `short.obj`: line 1"),
            ("<mesh filename=\"nan.obj\"/>", "mesh `nan.obj`: vertex 1"),
            ("<mesh filename=\"cut.stl\"/>", "mesh `cut.stl`: neither a text STL"),
            ("<mesh filename=\"mm.obj\"/>", "in millimetres"),
            ("<mesh filename=\"mm.obj\" scale=\"0 1 1\"/>", "collision 1: scale 0 1 1"),
            ("<mesh filename=\"mm.obj\" scale=\"1e300 1e300 1\"/>", "link base_link, collision 1"),
            (many, "link base_link: a footprint with 41 parts, more than 32; expected fewer"),
        ] {
            let Err(error) = with_geometry(geometry, &files) else { panic!("accepted {geometry}") };
            let message = error.to_string();
            assert!(message.contains(part) && message.contains("vehicle.urdf"), "{geometry}: {message}");
            let is_far = geometry.contains("mm.obj\"/>") || geometry.contains("400") || geometry.contains("1e300");
            assert_eq!(message.contains("in millimetres"), is_far, "the hint about the scale: {message}");
        }
        let bare = bmw().0;
        let (start, end) = (bare.find("    <collision>").unwrap(), bare.find("</collision>\n").unwrap());
        let bare = format!("{}{}", &bare[..start], &bare[end + "</collision>\n".len()..]);
        let message = assemble("x", Path::new("x"), &bare, bmw().1).unwrap_err().to_string();
        assert!(
            message.contains("link base_link: a footprint with no parts; expected a <collision> element"),
            "{message}"
        );
    }

    #[test]
    fn refuses_a_vehicle_without_inertia_wheels_or_steering() {
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
    fn refuses_a_loop_of_joints() {
        let u = "<robot name='x'><link name='a'/><link name='b'/><link name='c'/>\
                 <joint name='p' type='fixed'><parent link='a'/><child link='b'/></joint>\
                 <joint name='q' type='fixed'><parent link='b'/><child link='a'/></joint></robot>";
        assert!(assemble("x", Path::new("x"), u, bmw().1).is_err());
        let deep = format!("<robot>{}{}</robot>", "<a>".repeat(20_000), "</a>".repeat(20_000));
        assert!(assemble("x", Path::new("x"), &deep, bmw().1).is_err(), "deep nesting must not overflow the stack");
    }

    #[test]
    fn names_the_key_of_invalid_dynamics() {
        let same = ("", "");
        for (old, new, part) in [
            ("friction = 1.0489", "friction = -1.0", "tyres.friction: -1"),
            ("friction = 1.0489", "friction = 0.0", "tyres.friction: 0"),
            ("friction = 1.0489", "friction = nan", "tyres.friction"),
            ("friction = 1.0489", "friction = 1", ""),
            ("friction = 1.0489", "fricton = 1.0", "did you mean `friction`?"),
            ("[comfort]", "[comfrt]", "did you mean `comfort`?"),
            ("friction = 1.0489", "", "friction"),
            ("friction = 1.0489", "friction = \"high\"", "friction"),
            ("drag = 0.39", "drag = -0.1", "tyres.drag"),
            ("speed = 50.8", "speed = inf", "limits.speed: inf; expected above 0"),
            ("drive_front_share = 0.0", "drive_front_share = 1.5", "actuators.drive_front_share"),
            ("brake_lag = 0.10", "brake_lag = 0.0", "actuators.brake_lag"),
            ("jerk = 2.5", "jerk = 0.0", "comfort.jerk"),
            ("aggressive_deceleration = 2.2", "aggressive_deceleration = 1.0", "comfort.aggressive_deceleration"),
            ("[comfort]", "[comfort", "dynamics.toml"),
            ("speed = [35.0, 20.0, 15.0]", "speed = [25.0, 15.0]", "tracking.speed: [25, 15]; expected three positive"),
            ("speed = [35.0, 20.0, 15.0]", "speed = [35.0, 22.5, 15.0, 1.0]", "tracking.speed: [35, 22.5, 15, 1]"),
            ("speed = [35.0, 20.0, 15.0]", "speed = [35.0, 15.0, 22.5]", "none larger than the one before"),
            ("speed = [35.0, 20.0, 15.0]", "speed = [35.0, 22.5, 0.0]", "tracking.speed: [35, 22.5, 0]"),
            ("speed = [35.0, 20.0, 15.0]", "speed = [inf, 22.5, 15.0]", "tracking.speed: [inf, 22.5, 15]"),
            ("lateral = [0.025, ", "lateral = [-0.025, ", "tracking.lateral: [-0.025, "),
            ("heading = [0.016, ", "heading = [0.016, 0.1, ", "tracking.heading: [0.016, 0.1, "),
        ] {
            if part.is_empty() {
                continue;
            }
            let message = refusal(same, (old, new));
            assert!(message.contains(part) && message.contains("dynamics.toml"), "{new}: {message}");
        }
    }
}
