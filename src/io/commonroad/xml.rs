//! Typed access to the XML tree. Every accessor reports what is missing or invalid: file, line, element, expected value.

use std::borrow::Cow;

use super::error::{ElementError, ElementErrors, Place};
use crate::geometry::Point;
use crate::map::Issue;

pub(super) type Node<'a> = roxmltree::Node<'a, 'a>;

/// Largest magnitude of any number in a scenario: coordinates are at most Earth-sized, and beyond this `f64` no longer
/// resolves a micrometre.
const MAX_MAGNITUDE: f64 = 1e9;

/// Proof that an error has been reported: only [`Source::report`] makes one. A caller that gets it skips its element and
/// reports nothing more about it.
#[derive(Debug)]
pub(super) struct Reported(());

/// A value, or the proof that the error has been reported.
pub(super) type Read<T> = Result<T, Reported>;

/// The values, if all could be read. Every item is examined, so that all errors are reported.
pub(super) fn all<T>(items: impl Iterator<Item = Read<T>>) -> Read<Vec<T>> {
    let mut failure = None;
    let mut values = Vec::new();
    for item in items {
        match item {
            Ok(value) => values.push(value),
            Err(reported) => failure = Some(reported),
        }
    }
    failure.map_or(Ok(values), Err)
}

/// The text being read, with the errors and issues found in it so far.
pub(super) struct Source {
    file: String,
    /// Byte at which each line starts. The tree's own look-up counts from the top each time.
    line_starts: Vec<usize>,
    errors: ElementErrors,
    issues: Vec<Issue>,
}

impl Source {
    pub(super) fn new(file: &str, text: &str) -> Self {
        let line_starts = std::iter::once(0).chain(text.match_indices('\n').map(|(i, _)| i + 1)).collect();
        Self { file: file.to_owned(), line_starts, errors: ElementErrors::none(), issues: Vec::new() }
    }

    pub(super) fn file(&self) -> &str {
        &self.file
    }

    /// The issues in order of their lines, or the errors if there are any.
    pub(super) fn finish(mut self) -> Result<Vec<Issue>, ElementErrors> {
        self.errors.sort();
        self.issues.sort_by_key(|issue| issue.line);
        if self.errors.total() > 0 { Err(self.errors) } else { Ok(self.issues) }
    }

    pub(super) fn line(&self, node: Node) -> u32 {
        let line = self.line_starts.partition_point(|&start| start <= node.range().start);
        u32::try_from(line).unwrap_or(u32::MAX)
    }

    pub(super) fn place(&self, node: Node) -> Place {
        Place { file: self.file.clone(), line: self.line(node), element: describe(node) }
    }

    /// Reports an error.
    pub(super) fn report(&mut self, error: ElementError) -> Reported {
        self.errors.push(error);
        Reported(())
    }

    pub(super) fn missing(&mut self, node: Node, expected: &'static str) -> Reported {
        let place = self.place(node);
        self.report(ElementError::Missing { place, expected })
    }

    pub(super) fn bad_value(&mut self, node: Node, found: &str, expected: &'static str) -> Reported {
        /// Longest excerpt of a wrong value in a message, characters.
        const EXCERPT: usize = 40;
        let place = self.place(node);
        self.report(ElementError::BadValue { place, found: found.chars().take(EXCERPT).collect(), expected })
    }

    pub(super) fn bad_points(&mut self, node: Node, found: usize, expected: &'static str) -> Reported {
        let place = self.place(node);
        self.report(ElementError::BadPoints { place, found, expected })
    }

    /// Adds an issue: something that the reader repaired or left out.
    pub(super) fn note(&mut self, node: Node, message: impl Into<String>) {
        let issue = Issue { line: self.line(node), element: describe(node), message: message.into() };
        self.issues.push(issue);
    }

    /// Adds an issue for each child whose name is not in `known`.
    pub(super) fn note_unknown(&mut self, node: Node, known: &[&str]) {
        for child in node.children().filter(Node::is_element) {
            if !known.contains(&child.tag_name().name()) {
                self.note(child, "unknown element; skipped");
            }
        }
    }

    pub(super) fn attribute<'a>(&mut self, node: Node<'a>, name: &'static str) -> Read<&'a str> {
        node.attribute(name).ok_or_else(|| self.missing(node, name))
    }

    /// The integer in an attribute: `id` or `ref`.
    pub(super) fn id(&mut self, node: Node, name: &'static str) -> Read<i64> {
        let text = self.attribute(node, name)?;
        text.trim().parse().map_err(|_| self.bad_value(node, text, "an integer id"))
    }

    /// A required child.
    pub(super) fn child<'a>(&mut self, node: Node<'a>, name: &'static str) -> Read<Node<'a>> {
        child(node, name).ok_or_else(|| self.missing(node, name))
    }

    /// The value of an optional child.
    pub(super) fn optional<T>(
        &mut self,
        node: Node,
        name: &str,
        read: impl FnOnce(&mut Self, Node) -> Read<T>,
    ) -> Read<Option<T>> {
        child(node, name).map(|n| read(self, n)).transpose()
    }

    /// The value of a required child.
    pub(super) fn required<T>(
        &mut self,
        node: Node,
        name: &'static str,
        read: impl FnOnce(&mut Self, Node) -> Read<T>,
    ) -> Read<T> {
        let child = self.child(node, name)?;
        read(self, child)
    }

    /// The finite number that is the element's text.
    pub(super) fn number(&mut self, node: Node) -> Read<f64> {
        let text = text(node);
        let number = text.trim().parse::<f64>().ok().filter(|x| x.abs() <= MAX_MAGNITUDE);
        number.ok_or_else(|| self.bad_value(node, &text, "a finite number of at most 1e9"))
    }

    /// A number above zero.
    pub(super) fn positive(&mut self, node: Node) -> Read<f64> {
        let number = self.number(node)?;
        if number > 0.0 { Ok(number) } else { Err(self.bad_value(node, &text(node), "a number above 0")) }
    }

    /// A whole number, also when written `3.0`.
    pub(super) fn integer(&mut self, node: Node) -> Read<i64> {
        let number = self.number(node)?;
        #[allow(clippy::cast_possible_truncation)] // whole and at most MAX_MAGNITUDE
        if number.fract() == 0.0 { Ok(number as i64) } else { Err(self.bad_value(node, &text(node), "a whole number")) }
    }

    /// A time step: a whole number that is not negative.
    #[allow(clippy::cast_precision_loss)] // at most MAX_MAGNITUDE
    pub(super) fn step(&mut self, node: Node) -> Read<f64> {
        let step = self.integer(node)?;
        if step >= 0 { Ok(step as f64) } else { Err(self.bad_value(node, &text(node), "a time step of at least 0")) }
    }

    /// The point in an element with `<x>` and `<y>`. A `<z>` is ignored.
    pub(super) fn point(&mut self, node: Node) -> Read<Point> {
        let (x, y) = (self.required(node, "x", Self::number), self.required(node, "y", Self::number));
        Ok(Point::new(x?, y?))
    }

    /// All `<point>` children.
    pub(super) fn points(&mut self, node: Node) -> Read<Vec<Point>> {
        all(children(node, "point").map(|p| self.point(p)))
    }

    /// The ids in the `ref` attributes of the children of that name.
    pub(super) fn references(&mut self, node: Node, name: &'static str) -> Read<Vec<i64>> {
        all(children(node, name).map(|r| self.id(r, "ref")))
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

/// The text of an element without its comments.
pub(super) fn text<'a>(node: Node<'a>) -> Cow<'a, str> {
    let mut texts = node.children().filter(Node::is_text).filter_map(|t| t.text());
    let first = texts.next().unwrap_or("");
    let others: String = texts.collect();
    if others.is_empty() { Cow::Borrowed(first) } else { Cow::Owned(format!("{first}{others}")) }
}

/// The trimmed text of a child, if it is there.
pub(super) fn child_text(node: Node, name: &str) -> Option<String> {
    child(node, name).map(|n| text(n).trim().to_owned())
}

/// The element and its ancestors below the root, outermost first: `lanelet 12, leftBound`.
fn describe(node: Node) -> String {
    /// Most elements named; no known element lies deeper.
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
