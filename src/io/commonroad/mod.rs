//! Reader of CommonRoad scenario files, versions 2018b and 2020a.
//!
//! Format: *CommonRoad: Composable benchmarks for motion planning on roads* (Althoff, Koschi, Manzinger, IV 2017) and
//! the format descriptions 2018b and 2020a of the project. Both versions hold lanelets, obstacles and planning problems
//! in one tree; 2020a renames the obstacle elements and moves speed limits from lanelets into traffic signs. The reader
//! takes the elements of both under either version number.
//!
//! Technique: the text is parsed into a read-only tree (roxmltree; no document type declarations, so no entity
//! expansion), and each section is taken from the tree by its own module. Two kinds of trouble are kept apart:
//!
//! - **[`ReadError`]**: what is wrong decides where something is or how large it is (a number that is none, an obstacle
//!   without a shape, a lane of one point), or the file is not a scenario at all. Going on would be guessing about
//!   something that can be hit.
//! - **[`Issue`](crate::map::Issue)**: the file is still usable: a reference to a missing lanelet, an element that this
//!   reader does not know, an uncertain state of which the middle is used.
//!
//! Weak spots: intersections, signal states and the geographic location are skipped; an uncertain position of a state
//! (a region instead of a point) is reduced to its middle; a stop line belongs to its whole lanelet.

mod error;
mod network;
mod obstacle;
mod problem;
mod shape;
mod state;
mod xml;

#[cfg(test)]
mod tests;

use std::path::Path;

pub use error::{Place, ReadError};

use crate::io::{files, text};
use crate::map::Scenario;
use xml::{Node, Source};

/// The versions that this reader knows.
const VERSIONS: [&str; 2] = ["2018b", "2020a"];

/// Largest file read, bytes. The largest published scenarios have some 30 MB; devices that never end stop here.
const MAX_BYTES: u64 = 256 << 20;

/// Most XML nodes accepted: bounds the memory of the tree to a few GB even for files made of tags alone.
const MAX_NODES: u32 = 40_000_000;

/// Duration of a time step accepted, s. Published scenarios use 0.03 … 0.2 s.
const TIME_STEPS: std::ops::RangeInclusive<f64> = 1e-3..=10.0;

/// Reads a scenario file. It may be gzip'd.
///
/// # Errors
/// The file cannot be read, is not a CommonRoad scenario, or has missing or invalid elements.
pub fn read_file(path: &Path) -> Result<Scenario, ReadError> {
    read_str(&path.display().to_string(), &text::read(path, MAX_BYTES)?)
}

/// Reads a scenario from a stream, such as standard input; `name` stands for the file in messages.
///
/// # Errors
/// As [`read_file`].
pub fn read_from(name: &str, stream: impl std::io::Read) -> Result<Scenario, ReadError> {
    read_bytes(name, files::read_from(Path::new(name), stream, MAX_BYTES)?)
}

/// Reads a scenario from the bytes of a file, in any encoding that [`text::decode`] accepts; `name` stands for the file
/// in messages.
///
/// # Errors
/// As [`read_file`].
pub fn read_bytes(name: &str, bytes: Vec<u8>) -> Result<Scenario, ReadError> {
    read_str(name, &text::decode(Path::new(name), bytes, MAX_BYTES)?)
}

/// Reads a scenario from text; `name` stands for the file in messages.
///
/// # Errors
/// As [`read_file`].
pub fn read_str(name: &str, text: &str) -> Result<Scenario, ReadError> {
    let options = roxmltree::ParsingOptions { allow_dtd: false, nodes_limit: MAX_NODES, ..Default::default() };
    let document = roxmltree::Document::parse_with_options(text, options).map_err(|source| ReadError::NotXml {
        file: name.to_owned(),
        line: source.pos().row,
        source,
    })?;
    let mut source = Source::new(name, text);
    scenario(&mut source, document.root_element())
}

fn scenario(source: &mut Source, root: Node) -> Result<Scenario, ReadError> {
    let header = header(source, root)?;
    source.note_unknown(
        root,
        &[
            "location",
            "scenarioTags",
            "lanelet",
            "trafficSign",
            "trafficLight",
            "intersection",
            "obstacle",
            "staticObstacle",
            "dynamicObstacle",
            "environmentObstacle",
            "phantomObstacle",
            "planningProblem",
        ],
    );
    let network = network::read(source, root)?;
    let obstacles = obstacle::read_all(source, root, header.time_step)?;
    let problems = problem::read_all(source, root, &network, header.time_step)?;
    if problems.is_empty() {
        return Err(ReadError::NoPlanningProblem { file: source.file().to_owned() });
    }
    Ok(Scenario {
        id: header.id,
        version: header.version,
        time_step: header.time_step,
        network,
        obstacles,
        occupancy: None,
        problems,
        issues: source.take_issues(),
    })
}

struct Header {
    id: String,
    version: String,
    time_step: f64,
}

fn header(source: &mut Source, root: Node) -> Result<Header, ReadError> {
    if root.tag_name().name() != "commonRoad" {
        return Err(ReadError::WrongRoot { place: source.place(root), found: root.tag_name().name().to_owned() });
    }
    let version = source.attribute(root, "commonRoadVersion")?;
    if !VERSIONS.contains(&version) {
        return Err(ReadError::UnsupportedVersion { place: source.place(root), found: version.to_owned() });
    }
    let text = source.attribute(root, "timeStepSize")?;
    let time_step = text.trim().parse().ok().filter(|dt| TIME_STEPS.contains(dt)).ok_or_else(|| {
        let expected = "timeStepSize in seconds, from 0.001 to 10";
        ReadError::BadValue { place: source.place(root), found: text.to_owned(), expected }
    })?;
    let id = match root.attribute("benchmarkID") {
        Some(id) if !id.trim().is_empty() => id.trim().to_owned(),
        _ => {
            source.note(root, "has no benchmarkID; the file's name stands for it");
            let stem = Path::new(source.file()).file_stem().map(|s| s.to_string_lossy().into_owned());
            stem.unwrap_or_default()
        }
    };
    Ok(Header { id, version: version.to_owned(), time_step })
}
