//! Checks a URDF before `urdf-rs` reads it: the messages of `urdf-rs` name neither line nor element.

use std::path::Path;

use roxmltree::{Document, Node};

use crate::vehicle::VehicleError;

/// Largest nesting depth of elements. A URDF needs about six; the parser behind `urdf-rs` is recursive, so a deeper file
/// could overflow the stack.
const MAX_DEPTH: usize = 64;

/// Numeric attributes: element, attribute, how many numbers, whether it is required.
const NUMBERS: [(&str, &str, usize, bool); 21] = [
    ("mass", "value", 1, true),
    ("inertia", "ixx", 1, true),
    ("inertia", "ixy", 1, true),
    ("inertia", "ixz", 1, true),
    ("inertia", "iyy", 1, true),
    ("inertia", "iyz", 1, true),
    ("inertia", "izz", 1, true),
    ("origin", "xyz", 3, false),
    ("origin", "rpy", 3, false),
    ("axis", "xyz", 3, true),
    ("limit", "lower", 1, false),
    ("limit", "upper", 1, false),
    ("limit", "effort", 1, false),
    ("limit", "velocity", 1, true),
    ("box", "size", 3, true),
    ("cylinder", "radius", 1, true),
    ("cylinder", "length", 1, true),
    ("capsule", "radius", 1, true),
    ("capsule", "length", 1, true),
    ("sphere", "radius", 1, true),
    ("mesh", "scale", 3, false),
];

/// Required attributes with names: element, attribute.
const NAMES: [(&str, &str); 6] = [
    ("link", "name"),
    ("joint", "name"),
    ("joint", "type"),
    ("parent", "link"),
    ("child", "link"),
    ("mesh", "filename"),
];

/// Required children: element, child.
const PARTS: [(&str, &str); 6] = [
    ("joint", "parent"),
    ("joint", "child"),
    ("inertial", "mass"),
    ("inertial", "inertia"),
    ("collision", "geometry"),
    ("visual", "geometry"),
];

/// Types of joints.
const JOINTS: [&str; 7] = ["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical"];

/// Checks the structure that `urdf-rs` assumes. Returns the names of the links with an inertial element: `urdf-rs` replaces
/// a missing one by zeros.
pub(super) fn check(file: &Path, text: &str) -> Result<Vec<String>, VehicleError> {
    let not_urdf = |message: String| VehicleError::NotUrdf { file: file.to_owned(), message };
    let document = roxmltree::Document::parse(text)
        .map_err(|e| VehicleError::NotXml { file: file.to_owned(), message: e.to_string() })?;
    let root = document.root_element();
    let is_xacro = |uri: &str| uri.contains("xacro");
    if root.namespaces().any(|n| is_xacro(n.uri()) || n.name() == Some("xacro"))
        || document.descendants().any(|n| n.tag_name().namespace().is_some_and(is_xacro))
    {
        return Err(VehicleError::Xacro { file: file.to_owned() });
    }
    if root.tag_name().name() != "robot" {
        return Err(not_urdf(format!("the root element is <{}>, expected <robot>", root.tag_name().name())));
    }
    if let Some(deep) = document.descendants().find(|n| n.ancestors().take(MAX_DEPTH + 1).count() > MAX_DEPTH) {
        let line = document.text_pos_at(deep.range().start).row;
        return Err(not_urdf(format!("line {line}: elements are nested more than {MAX_DEPTH} deep")));
    }
    for part in root.children().filter(|n| n.has_tag_name("link") || n.has_tag_name("joint")) {
        part.descendants().filter(roxmltree::Node::is_element).try_for_each(|n| check_element(file, &document, n))?;
    }
    let has_inertial = |n: &roxmltree::Node<'_, '_>| n.children().any(|c| c.has_tag_name("inertial"));
    let links = root.children().filter(|n| n.has_tag_name("link")).filter(has_inertial);
    Ok(links.filter_map(|n| n.attribute("name").map(str::to_owned)).collect())
}

/// Checks the attributes and children of an element of a link or joint.
fn check_element(file: &Path, document: &Document<'_>, node: Node<'_, '_>) -> Result<(), VehicleError> {
    let tag = node.tag_name().name();
    let error = |found: String, expected: &'static str| {
        let (line, element) = (document.text_pos_at(node.range().start).row, path_of(node));
        Err(VehicleError::Element {
            file: file.to_owned(),
            element: format!("line {line}: {element}"),
            found,
            expected,
        })
    };
    for (_, attribute, count, is_required) in NUMBERS.iter().filter(|(element, ..)| *element == tag) {
        let expected = if *count == 1 { "a number" } else { "three numbers" };
        match node.attribute(*attribute) {
            None if *is_required => return error(format!("no {attribute}"), expected),
            None => {}
            Some(text) => {
                let words: Vec<&str> = text.split_whitespace().collect();
                if words.len() != *count || words.iter().any(|word| word.parse::<f64>().is_err()) {
                    return error(format!("{attribute}=\"{text}\""), expected);
                }
            }
        }
    }
    for (_, attribute) in NAMES.iter().filter(|(element, _)| *element == tag) {
        if node.attribute(*attribute).is_none() {
            return error(format!("no {attribute}"), "this attribute");
        }
    }
    for (_, part) in PARTS.iter().filter(|(outer, _)| *outer == tag) {
        if !node.children().any(|child| child.has_tag_name(*part)) {
            return error(format!("no <{part}>"), "this child");
        }
    }
    match node.attribute("type").filter(|kind| tag == "joint" && !JOINTS.contains(kind)) {
        Some(kind) => {
            error(format!("type=\"{kind}\""), "revolute, continuous, prismatic, fixed, floating, planar or spherical")
        }
        None => Ok(()),
    }
}

/// An element with its ancestors: `link base_link, inertial, mass`.
fn path_of(node: Node<'_, '_>) -> String {
    let name = |n: Node<'_, '_>| match n.attribute("name") {
        Some(name) => format!("{} {name}", n.tag_name().name()),
        None => n.tag_name().name().to_owned(),
    };
    let mut path: Vec<String> =
        node.ancestors().filter(|n| n.is_element() && !n.has_tag_name("robot")).map(name).collect();
    path.reverse();
    path.join(", ")
}
