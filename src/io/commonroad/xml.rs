//! Small steps through the XML tree that know how to complain: file, line, element, what was expected.

use std::borrow::Cow;

use super::error::{Place, ReadError};
use crate::geometry::Point;
use crate::map::Issue;

pub(super) type Node<'a> = roxmltree::Node<'a, 'a>;

/// Largest magnitude of any number in a scenario: coordinates are at most Earth-sized, and beyond this `f64` no longer
/// resolves a micrometre.
const MAX_MAGNITUDE: f64 = 1e9;

/// The text being read: knows lines, collects issues.
pub(super) struct Source {
    file: String,
    /// Byte at which each line starts. The tree's own look-up counts from the top each time.
    line_starts: Vec<usize>,
    issues: Vec<Issue>,
}

impl Source {
    pub(super) fn new(file: &str, text: &str) -> Self {
        let line_starts = std::iter::once(0).chain(text.match_indices('\n').map(|(i, _)| i + 1)).collect();
        Self { file: file.to_owned(), line_starts, issues: Vec::new() }
    }

    pub(super) fn file(&self) -> &str {
        &self.file
    }

    pub(super) fn take_issues(&mut self) -> Vec<Issue> {
        let mut issues = std::mem::take(&mut self.issues);
        issues.sort_by_key(|i| i.line);
        issues
    }

    fn line(&self, node: Node) -> u32 {
        let line = self.line_starts.partition_point(|&start| start <= node.range().start);
        u32::try_from(line).unwrap_or(u32::MAX)
    }

    pub(super) fn place(&self, node: Node) -> Place {
        Place { file: self.file.clone(), line: self.line(node), element: describe(node) }
    }

    /// Notes something that was repaired or left out.
    pub(super) fn note(&mut self, node: Node, message: impl Into<String>) {
        let issue = Issue { line: self.line(node), element: describe(node), message: message.into() };
        self.issues.push(issue);
    }

    /// Notes the children whose names are not in `known`.
    pub(super) fn note_unknown(&mut self, node: Node, known: &[&str]) {
        for child in node.children().filter(Node::is_element) {
            if !known.contains(&child.tag_name().name()) {
                self.note(child, "unknown element; skipped");
            }
        }
    }

    pub(super) fn missing(&self, node: Node, expected: &'static str) -> ReadError {
        ReadError::Missing { place: self.place(node), expected }
    }

    pub(super) fn bad_value(&self, node: Node, found: &str, expected: &'static str) -> ReadError {
        /// Longest excerpt of a wrong value in a message, characters.
        const EXCERPT: usize = 40;
        ReadError::BadValue { place: self.place(node), found: found.chars().take(EXCERPT).collect(), expected }
    }

    pub(super) fn attribute<'a>(&self, node: Node<'a>, name: &'static str) -> Result<&'a str, ReadError> {
        node.attribute(name).ok_or_else(|| self.missing(node, name))
    }

    /// The integer in an attribute: `id` or `ref`.
    pub(super) fn id(&self, node: Node, name: &'static str) -> Result<i64, ReadError> {
        let text = self.attribute(node, name)?;
        text.trim().parse().map_err(|_| self.bad_value(node, text, "an integer id"))
    }

    pub(super) fn child<'a>(&self, node: Node<'a>, name: &'static str) -> Result<Node<'a>, ReadError> {
        child(node, name).ok_or_else(|| self.missing(node, name))
    }

    /// The finite number that is the element's text.
    pub(super) fn number(&self, node: Node) -> Result<f64, ReadError> {
        let text = text(node);
        let number = text.trim().parse::<f64>().ok().filter(|x| x.abs() <= MAX_MAGNITUDE);
        number.ok_or_else(|| self.bad_value(node, &text, "a finite number of at most 1e9"))
    }

    /// A number above zero.
    pub(super) fn positive(&self, node: Node) -> Result<f64, ReadError> {
        let number = self.number(node)?;
        if number > 0.0 { Ok(number) } else { Err(self.bad_value(node, &text(node), "a number above 0")) }
    }

    /// A whole number, also when written `3.0`.
    pub(super) fn integer(&self, node: Node) -> Result<i64, ReadError> {
        let number = self.number(node)?;
        #[allow(clippy::cast_possible_truncation)] // whole and at most MAX_MAGNITUDE
        if number.fract() == 0.0 { Ok(number as i64) } else { Err(self.bad_value(node, &text(node), "a whole number")) }
    }

    /// The point in an element with `<x>` and `<y>`; a `<z>` is not looked at.
    pub(super) fn point(&self, node: Node) -> Result<Point, ReadError> {
        Ok(Point::new(self.number(self.child(node, "x")?)?, self.number(self.child(node, "y")?)?))
    }

    /// All `<point>` children.
    pub(super) fn points(&self, node: Node) -> Result<Vec<Point>, ReadError> {
        children(node, "point").map(|p| self.point(p)).collect()
    }

    /// The ids in the `ref` attributes of the children of that name.
    pub(super) fn references(&self, node: Node, name: &'static str) -> Result<Vec<i64>, ReadError> {
        children(node, name).map(|r| self.id(r, "ref")).collect()
    }
}

/// The first child element of that name.
pub(super) fn child<'a>(node: Node<'a>, name: &str) -> Option<Node<'a>> {
    children(node, name).next()
}

/// The child elements of that name.
pub(super) fn children<'a>(node: Node<'a>, name: &str) -> impl Iterator<Item = Node<'a>> {
    node.children().filter(move |n| n.is_element() && n.tag_name().name() == name)
}

/// The text of an element, comments left out.
pub(super) fn text<'a>(node: Node<'a>) -> Cow<'a, str> {
    let mut texts = node.children().filter(Node::is_text).filter_map(|t| t.text());
    let first = texts.next().unwrap_or("");
    let rest: String = texts.collect();
    if rest.is_empty() { Cow::Borrowed(first) } else { Cow::Owned(format!("{first}{rest}")) }
}

/// The element and those around it below the root, outermost first: `lanelet 12, leftBound`.
fn describe(node: Node) -> String {
    /// Elements named at most; no known element lies deeper.
    const DEPTH: usize = 8;
    let name = |n: Node| match n.attribute("id") {
        Some(id) => format!("{} {id}", n.tag_name().name()),
        None => n.tag_name().name().to_owned(),
    };
    let below_root = |n: &Node| n.parent_element().is_some();
    let mut names: Vec<String> =
        node.ancestors().take(DEPTH).filter(Node::is_element).filter(below_root).map(name).collect();
    if names.is_empty() {
        return name(node);
    }
    names.reverse();
    names.join(", ")
}
