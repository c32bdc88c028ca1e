//! Recognises what kind of file something is, for error messages: a wrong file should name the flag or command that reads
//! it.
//!
//! Technique: folders by the files in them; binary formats by their first bytes; XML by its root element; TOML by its
//! top-level keys; text formats without a mark by the name's extension. Readers ask it only about a file that they have
//! refused. It sees bytes: compressed files and encodings other than UTF-8 have to be decoded first.

use std::fmt;
use std::io::Read as _;
use std::path::Path;

/// Bytes read of a file: all of any TOML file written by hand, and the head of the others.
const HEAD_BYTES: u64 = 1 << 20;

/// Kind of a file or folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FileKind {
    /// CommonRoad scenario, XML.
    Scenario,
    /// CommonRoad solution, XML.
    Solution,
    /// Lanelet2 map or another map in OpenStreetMap's XML.
    Lanelet2,
    /// OpenDRIVE map, XML.
    OpenDrive,
    /// OpenSCENARIO scenario, XML.
    OpenScenario,
    /// URDF of a vehicle or robot, XML.
    Urdf,
    /// Picture in SVG.
    Svg,
    /// Web page.
    Html,
    /// Picture in pixels, with the name of its format.
    Image(&'static str),
    /// Occupancy grid of ROS `map_server`, YAML.
    OccupancyGrid,
    /// Settings of a run, TOML.
    Settings,
    /// Friction patches alone, TOML.
    FrictionPatches,
    /// Regression suite, TOML.
    Suite,
    /// `dynamics.toml` of a vehicle.
    Dynamics,
    /// JSON.
    Json,
    /// Rerun recording.
    Recording,
    /// Table, CSV.
    Csv,
    /// Grid map of the MovingAI benchmarks.
    MovingAi,
    /// Road graph of the DIMACS challenge.
    Dimacs,
    /// OpenStreetMap extract in protocol buffers.
    Pbf,
    /// Folder of a vehicle: `vehicle.urdf` and `dynamics.toml`.
    VehicleFolder,
    /// Folder with a `suite.toml`.
    SuiteFolder,
}

impl FileKind {
    /// The kind of a file or folder. `None` if it cannot be read or is none of the known kinds.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        if path.is_dir() {
            return match () {
                () if path.join("vehicle.urdf").is_file() => Some(Self::VehicleFolder),
                () if path.join("suite.toml").is_file() => Some(Self::SuiteFolder),
                () => None,
            };
        }
        let about = std::fs::metadata(path).ok()?;
        let mut head = Vec::new();
        if about.is_file() {
            // a device may never end, and a pipe can be read once
            std::fs::File::open(path).ok()?.take(HEAD_BYTES).read_to_end(&mut head).ok()?;
        }
        Self::of_bytes(path, &head)
    }

    /// The kind of a file from its name and its first bytes.
    #[must_use]
    pub fn of_bytes(path: &Path, head: &[u8]) -> Option<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        if let Some(kind) = binary(head, &extension) {
            return Some(kind);
        }
        // the head may end within a character
        let text = match std::str::from_utf8(head) {
            Ok(text) => text,
            Err(e) => std::str::from_utf8(&head[..e.valid_up_to()]).unwrap_or_default(),
        };
        let text = text.trim_start_matches('\u{feff}').trim_start();
        if text.starts_with('<') {
            return xml(text);
        }
        match extension.as_str() {
            "toml" => toml_kind(text),
            "yaml" | "yml" if has_key(text, "image") && has_key(text, "resolution") => Some(Self::OccupancyGrid),
            "json" if text.starts_with(['{', '[']) => Some(Self::Json),
            "csv" => Some(Self::Csv),
            "map" if text.starts_with("type ") => Some(Self::MovingAi),
            "gr" | "co" if text.starts_with(['c', 'p']) => Some(Self::Dimacs),
            _ => None,
        }
    }

    /// The command or flag that reads such a file, as a sentence without its full stop.
    #[must_use]
    pub fn reader(self) -> &'static str {
        match self {
            Self::Scenario => "`stopline plan` and `stopline drive` read it as SCENARIO",
            Self::Solution => "no command reads it",
            Self::Lanelet2 | Self::OpenDrive | Self::OpenScenario | Self::MovingAi | Self::Dimacs | Self::Pbf => {
                "no command of this version reads it; scenarios are CommonRoad XML"
            }
            Self::Urdf | Self::Dynamics | Self::VehicleFolder => "--vehicle reads its folder",
            Self::Image(_) => "--grid reads the YAML file that names an image",
            Self::OccupancyGrid => "--grid reads it",
            Self::Settings => "--config reads it",
            Self::FrictionPatches => "`stopline drive` reads it with --friction",
            Self::Suite | Self::SuiteFolder => "`stopline check` reads it",
            Self::Json => "`stopline check --replay ID --report` reads the report of a check",
            Self::Recording => "the Rerun viewer opens it",
            Self::Svg | Self::Html => "a browser opens it",
            Self::Csv => "no command reads it",
        }
    }
}

/// What it is, with its article: `an OpenDRIVE map`.
impl fmt::Display for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Scenario => "a CommonRoad scenario",
            Self::Solution => "a CommonRoad solution",
            Self::Lanelet2 => "a Lanelet2 or OpenStreetMap file (<osm>)",
            Self::OpenDrive => "an OpenDRIVE map (<OpenDRIVE>)",
            Self::OpenScenario => "an OpenSCENARIO file (<OpenSCENARIO>)",
            Self::Urdf => "a URDF (<robot>)",
            Self::Svg => "an SVG picture",
            Self::Html => "an HTML page",
            Self::Image(format) => return write!(f, "a {format} image"),
            Self::OccupancyGrid => "an occupancy grid of ROS",
            Self::Settings => "a settings file",
            Self::FrictionPatches => "a file of friction patches",
            Self::Suite => "a regression suite",
            Self::Dynamics => "the dynamics of a vehicle",
            Self::Json => "a JSON file",
            Self::Recording => "a Rerun recording",
            Self::Csv => "a CSV table",
            Self::MovingAi => "a MovingAI grid map",
            Self::Dimacs => "a DIMACS road graph",
            Self::Pbf => "an OpenStreetMap extract (.pbf)",
            Self::VehicleFolder => "the folder of a vehicle",
            Self::SuiteFolder => "the folder of a regression suite",
        })
    }
}

/// Formats with a mark in their first bytes.
fn binary(head: &[u8], extension: &str) -> Option<FileKind> {
    const MARKS: [(&[u8], FileKind); 5] = [
        (b"\x89PNG", FileKind::Image("PNG")),
        (b"\xff\xd8\xff", FileKind::Image("JPEG")),
        (b"GIF8", FileKind::Image("GIF")),
        (b"BM", FileKind::Image("BMP")),
        (b"RRF", FileKind::Recording),
    ];
    // "P2" and "BM" are short marks: text may begin with them
    let is_netpbm = matches!(head, [b'P', b'1'..=b'6', b' ' | b'\n' | b'\r' | b'\t', ..]);
    let marked = MARKS.iter().find(|(mark, _)| head.starts_with(mark) && (mark.len() > 2 || extension == "bmp"));
    match marked {
        Some((_, kind)) => Some(*kind),
        None if is_netpbm => Some(FileKind::Image(if matches!(head[1], b'2' | b'5') { "PGM" } else { "PNM" })),
        None if extension == "pbf" => Some(FileKind::Pbf),
        None => None,
    }
}

/// XML by the name of its root element.
fn xml(text: &str) -> Option<FileKind> {
    let mut rest = text;
    let root = loop {
        rest = &rest[rest.find('<')? + 1..];
        let end = match () {
            () if rest.starts_with("!--") => "-->",
            () if rest.starts_with(['?', '!']) => ">",
            () => break rest.split(|c: char| c.is_whitespace() || c == '>' || c == '/').next()?,
        };
        rest = &rest[rest.find(end)? + end.len()..];
    };
    // with a namespace's prefix or without
    match root.rsplit(':').next()? {
        "commonRoad" => Some(FileKind::Scenario),
        "CommonRoadSolution" => Some(FileKind::Solution),
        "osm" => Some(FileKind::Lanelet2),
        "OpenDRIVE" => Some(FileKind::OpenDrive),
        "OpenSCENARIO" | "OpenScenario" => Some(FileKind::OpenScenario),
        "robot" => Some(FileKind::Urdf),
        "svg" => Some(FileKind::Svg),
        "html" => Some(FileKind::Html),
        _ => None,
    }
}

/// TOML by its top-level keys.
fn toml_kind(text: &str) -> Option<FileKind> {
    let table: toml::Table = toml::from_str(text).ok()?;
    let has = |keys: &[&str]| keys.iter().any(|key| table.contains_key(*key));
    match () {
        () if has(&["drive", "defaults", "baseline"]) => Some(FileKind::Suite),
        () if has(&["tyres", "actuators", "commonroad_type"]) => Some(FileKind::Dynamics),
        () if has(&["planner", "simulation", "run", "verdict", "faults"]) => Some(FileKind::Settings),
        () if has(&["friction"]) => Some(FileKind::FrictionPatches),
        () => None,
    }
}

/// Whether a line of a YAML file sets that top-level key.
fn has_key(text: &str, key: &str) -> bool {
    text.lines().any(|line| line.strip_prefix(key).is_some_and(|rest| rest.trim_start().starts_with(':')))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(name: &str, head: &str) -> Option<FileKind> {
        FileKind::of_bytes(Path::new(name), head.as_bytes())
    }

    #[test]
    fn recognises_xml_by_its_root_element() {
        let scenario = "\u{feff}<?xml version='1.0'?>\n<!-- <osm> -->\n<commonRoad timeStepSize='0.1'>";
        assert_eq!(kind("a.txt", scenario), Some(FileKind::Scenario));
        assert_eq!(kind("a.xml", "<osm version=\"0.6\">"), Some(FileKind::Lanelet2));
        assert_eq!(kind("a.xml", "<OpenDRIVE/>"), Some(FileKind::OpenDrive));
        assert_eq!(kind("a", "<!DOCTYPE html>\n<html>"), Some(FileKind::Html));
        assert_eq!(kind("a", "<svg:svg xmlns:svg=\"\">"), Some(FileKind::Svg));
        for unknown in ["<", "<!--", "<?xml", "<note>", "< ", ""] {
            assert_eq!(kind("a.xml", unknown), None, "{unknown}");
        }
    }

    #[test]
    fn recognises_toml_by_its_top_level_keys() {
        assert_eq!(kind("a.toml", "name = \"x\"\n[[drive]]\n"), Some(FileKind::Suite));
        assert_eq!(kind("a.toml", "[planner]\n"), Some(FileKind::Settings));
        assert_eq!(kind("a.toml", "[[friction]]\nfactor = 1"), Some(FileKind::FrictionPatches));
        assert_eq!(kind("a.toml", "[tyres]\n"), Some(FileKind::Dynamics));
        assert_eq!(kind("a.toml", "[plannner]\n"), None);
        assert_eq!(kind("a.toml", "[planner\n"), None);
    }

    #[test]
    fn recognises_images_and_text_formats() {
        assert_eq!(kind("a.pgm", "P2 1 1 255 0"), Some(FileKind::Image("PGM")));
        assert_eq!(FileKind::of_bytes(Path::new("a"), b"\x89PNG\r\n"), Some(FileKind::Image("PNG")));
        assert_eq!(kind("a.txt", "BMW and others"), None);
        assert_eq!(kind("a.txt", "P2P"), None);
        assert_eq!(kind("a.yaml", "image: a.pgm\nresolution: 1\n"), Some(FileKind::OccupancyGrid));
        assert_eq!(kind("a.yaml", "images: 3\n"), None);
        assert_eq!(kind("a.map", "type octile\nheight 1\n"), Some(FileKind::MovingAi));
        assert_eq!(FileKind::of_bytes(Path::new("a.xml"), b"\xff\xfe<\0o\0"), None, "UTF-16");
    }

    #[test]
    fn recognises_the_projects_own_folders_and_files() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        for (path, kind) in [
            ("maps/straight_100m.xml", Some(FileKind::Scenario)),
            ("maps/suite.toml", Some(FileKind::Suite)),
            ("maps/suite.baseline.json", Some(FileKind::Json)),
            ("maps", Some(FileKind::SuiteFolder)),
            ("vehicles/truck", Some(FileKind::VehicleFolder)),
            ("vehicles/truck/vehicle.urdf", Some(FileKind::Urdf)),
            ("vehicles/truck/dynamics.toml", Some(FileKind::Dynamics)),
            ("src", None),
            ("none.xml", None),
        ] {
            assert_eq!(FileKind::of(&root.join(path)), kind, "{path}");
        }
    }
}
