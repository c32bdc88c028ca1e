//! Reader of CommonRoad scenario files, versions 2018b and 2020a.
//!
//! Format: *CommonRoad: Composable benchmarks for motion planning on roads* (Althoff, Koschi, Manzinger, IV 2017) and
//! the format descriptions 2018b and 2020a of the project. Both versions have lanelets, obstacles and planning problems
//! in one tree; 2020a renames the obstacle elements and moves speed limits from lanelets into traffic signs. The reader
//! accepts the elements of both under either version number.
//!
//! Technique: the text is parsed into a read-only tree (roxmltree; no document type declarations, so no entity
//! expansion), and one module reads each section of the tree. There are two kinds of trouble:
//!
//! - **[`ReadError`]**: the file is not a scenario, or an element that decides about a position or a size is missing or
//!   invalid: a coordinate that is not a number, an obstacle without a shape, a lane of one point, a state that is an
//!   interval ([`ElementError::Uncertain`]) or out of reach of the state before it ([`ElementError::Unreachable`]). A default would be a guess about a possible collision. All such elements are reported at once ([`ElementErrors`]): a faulty element is
//!   skipped, and the reader examines the others.
//! - **[`Issue`](crate::map::Issue)**: the scenario is usable: a reference to a missing lanelet, an unknown element, a
//!   state that is uncertain by less than a centimetre.
//!
//! Limits: intersections, signal states and the geographic location are skipped; states with intervals or regions wider
//! than a tolerance are refused (0.01 m, 0.001 rad, 0.01 m/s, 0.01 m/s², 0.001 rad/s; a time has to be exact); a stop line
//! applies to its whole lanelet; the slip angle of an initial state is checked, but the vehicle starts along its orientation.

mod error;
mod network;
mod obstacle;
mod problem;
mod shape;
mod state;
mod xml;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;

pub use error::{ElementError, ElementErrors, Place, ReadError};

use crate::io::kind::FileKind;
use crate::io::{files, text};
use crate::map::Scenario;
use xml::{Node, Source};

/// The versions of the format.
const VERSIONS: [&str; 2] = ["2018b", "2020a"];

/// Largest size of a file and of its decompressed content, bytes. The largest published scenarios have some 30 MB.
const MAX_BYTES: u64 = 256 << 20;

/// Most XML nodes: limits the memory of the tree to a few GB even for a file made of tags alone.
const MAX_NODES: u32 = 40_000_000;

/// Valid duration of a time step, s. Published scenarios use 0.03 … 0.2 s.
const TIME_STEPS: std::ops::RangeInclusive<f64> = 1e-3..=10.0;

/// Bytes from which the kind of another file is recognised.
const HEAD_BYTES: usize = 1 << 20;

/// Reads a scenario file. It may be gzip'd.
///
/// # Errors
/// The file cannot be read, is not a CommonRoad scenario, or has missing or invalid elements.
pub fn read_file(path: &Path) -> Result<Scenario, ReadError> {
    read_bytes(&path.display().to_string(), files::read(path, MAX_BYTES)?)
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
    let binary_kind = other_kind(name, &bytes);
    match text::decode(Path::new(name), bytes, MAX_BYTES) {
        Ok(text) => read_str(name, &text),
        Err(error) => Err(binary_kind.unwrap_or(error.into())),
    }
}

/// Reads a scenario from text; `name` stands for the file in messages.
///
/// # Errors
/// As [`read_file`].
pub fn read_str(name: &str, text: &str) -> Result<Scenario, ReadError> {
    let options = roxmltree::ParsingOptions { allow_dtd: false, nodes_limit: MAX_NODES, ..Default::default() };
    let document = roxmltree::Document::parse_with_options(text, options).map_err(|source| {
        let file = name.to_owned();
        let line = match source {
            roxmltree::Error::NodesLimitReached => return ReadError::TooManyNodes { file, most: MAX_NODES },
            roxmltree::Error::UnexpectedEndOfStream | roxmltree::Error::UnclosedRootNode => text.lines().count().max(1),
            _ => source.pos().row as usize,
        };
        other_kind(name, text.as_bytes()).unwrap_or(ReadError::NotXml { file, line, source })
    })?;
    let root = document.root_element();
    let mut source = Source::new(name, text);
    if root.tag_name().name() != "commonRoad" {
        let found = root.tag_name().name().to_owned();
        let wrong_root = ReadError::WrongRoot { place: source.place(root), found };
        return Err(other_kind(name, text.as_bytes()).unwrap_or(wrong_root));
    }
    if let Some(found) = root.attribute("commonRoadVersion").filter(|version| !VERSIONS.contains(version)) {
        return Err(ReadError::UnsupportedVersion { place: source.place(root), found: found.to_owned() });
    }
    let scenario = scenario(&mut source, root);
    Ok(Scenario { issues: source.finish()?, ..scenario })
}

/// The error about a file of another known kind.
fn other_kind(name: &str, bytes: &[u8]) -> Option<ReadError> {
    let head = &bytes[..bytes.len().min(HEAD_BYTES)];
    let kind = FileKind::of_bytes(Path::new(name), head).filter(|kind| *kind != FileKind::Scenario)?;
    Some(ReadError::OtherKind { file: name.to_owned(), kind })
}

fn scenario(source: &mut Source, root: Node) -> Scenario {
    let header = header(source, root);
    let mut known = vec!["location", "scenarioTags", "lanelet", "trafficSign", "trafficLight", "intersection"];
    known.extend(obstacle::ELEMENTS);
    known.push("planningProblem");
    source.note_unknown(root, &known);
    note_ids_of_several_kinds(source, root);
    let network = network::read(source, root);
    let obstacles = obstacle::read_all(source, root, header.time_step);
    let problems = problem::read_all(source, root, &network, header.time_step);
    let scenario = Scenario {
        id: header.id,
        version: header.version,
        time_step: header.time_step,
        network: network.roads,
        obstacles,
        occupancy: None,
        problems,
        issues: Vec::new(),
    };
    note_recorded_ego(source, root, &scenario);
    scenario
}

/// Adds an issue for each problem that starts where an obstacle is.
fn note_recorded_ego(source: &mut Source, root: Node, scenario: &Scenario) {
    for problem in &scenario.problems {
        let Some(ego) = scenario.recorded_ego(problem) else { continue };
        let is_ego = |node: &Node| obstacle::ELEMENTS.contains(&node.tag_name().name()) && id_of(*node) == Some(ego.id);
        let node = root.children().find(is_ego).unwrap_or(root);
        source.note(
            node,
            format!(
                "is exactly where problem {} starts: the recorded ego? --without-recorded-ego leaves it out",
                problem.id
            ),
        );
    }
}

struct Header {
    id: String,
    version: String,
    time_step: f64,
}

/// The attributes of the root. One with an error has a placeholder, so that the elements can be examined.
fn header(source: &mut Source, root: Node) -> Header {
    let version = source.attribute(root, "commonRoadVersion").unwrap_or_default().to_owned();
    let time_step = source.attribute(root, "timeStepSize").and_then(|text| {
        let time_step = text.trim().parse().ok().filter(|dt| TIME_STEPS.contains(dt));
        time_step.ok_or_else(|| source.bad_value(root, text, "timeStepSize in seconds, from 0.001 to 10"))
    });
    let id = match root.attribute("benchmarkID") {
        Some(id) if !id.trim().is_empty() => id.trim().to_owned(),
        _ => {
            source.note(root, "has no benchmarkID; the file name is used");
            let name = Path::new(source.file().trim_end_matches(".gz"));
            name.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
        }
    };
    Header { id, version, time_step: time_step.unwrap_or(1.0) }
}

/// The id of an element, if it is a number.
fn id_of(node: Node) -> Option<i64> {
    node.attribute("id")?.trim().parse().ok()
}

/// Reports the id of an element if an earlier one of its kind has the same. `lines` are the lines of the ids so far.
fn duplicate(source: &mut Source, node: Node, lines: &mut BTreeMap<i64, u32>) -> bool {
    let Some(id) = id_of(node) else { return false };
    match lines.entry(id) {
        Entry::Vacant(entry) => {
            entry.insert(source.line(node));
            false
        }
        Entry::Occupied(entry) => {
            let (place, first) = (source.place(node), *entry.get());
            source.report(ElementError::DuplicateId { place, first });
            true
        }
    }
}

/// Adds an issue for each id that elements of different kinds have, such as a lanelet and an obstacle. This program keeps
/// the kinds apart, but the format requires an id for each element. Planning problems are exempt: many published files
/// number them from 1, like their lanelets.
fn note_ids_of_several_kinds(source: &mut Source, root: Node) {
    let kind_of = |node: Node| match node.tag_name().name() {
        name if obstacle::ELEMENTS.contains(&name) => Some("obstacle"),
        "lanelet" => Some("lanelet"),
        "trafficSign" => Some("traffic sign"),
        "trafficLight" => Some("traffic light"),
        _ => None,
    };
    let mut seen: BTreeMap<i64, (&str, u32)> = BTreeMap::new();
    for node in root.children().filter(Node::is_element) {
        let (Some(id), Some(kind)) = (id_of(node), kind_of(node)) else { continue };
        let (first_kind, first_line) = *seen.entry(id).or_insert_with(|| (kind, source.line(node)));
        if first_kind != kind {
            source.note(node, format!("the {first_kind} in line {first_line} has the same id; both are kept"));
        }
    }
}
