//! A small SVG writer: elements with attributes, escaped text, numbers with fixed decimals.
//!
//! Equal calls give equal bytes. Numbers have two decimals (pixels) and are never `NaN` or infinite: a shape with such
//! a number is omitted, so that the file is always valid.

use std::fmt::Write as _;

/// A position on the page, in pixels, y down.
pub(super) type Page = (f64, f64);

/// An element under construction.
#[derive(Debug, Clone)]
pub(super) struct Element {
    name: &'static str,
    attributes: String,
    finite: bool,
}

impl Element {
    /// An element without attributes.
    pub(super) fn new(name: &'static str) -> Self {
        Self { name, attributes: String::new(), finite: true }
    }

    /// Adds a text attribute, escaped.
    pub(super) fn with(mut self, name: &str, value: &str) -> Self {
        let _ = write!(self.attributes, " {name}=\"{}\"", escape(value));
        self
    }

    /// Adds a numeric attribute.
    pub(super) fn num(mut self, name: &str, value: f64) -> Self {
        self.finite &= value.is_finite();
        let _ = write!(self.attributes, " {name}=\"{}\"", number(value));
        self
    }

    /// A rectangle.
    pub(super) fn rect(corner: Page, width: f64, height: f64) -> Self {
        Self::new("rect").num("x", corner.0).num("y", corner.1).num("width", width).num("height", height)
    }

    /// A straight line.
    pub(super) fn line(from: Page, to: Page) -> Self {
        Self::new("line").num("x1", from.0).num("y1", from.1).num("x2", to.0).num("y2", to.1)
    }

    /// An open polyline.
    pub(super) fn polyline(points: impl IntoIterator<Item = Page>) -> Self {
        Self::path(points, "")
    }

    /// A closed polygon.
    pub(super) fn polygon(points: impl IntoIterator<Item = Page>) -> Self {
        Self::path(points, "Z")
    }

    fn path(points: impl IntoIterator<Item = Page>, end: &str) -> Self {
        let mut data = String::new();
        let mut finite = true;
        let mut last = String::new();
        for (x, y) in points {
            finite &= x.is_finite() && y.is_finite();
            let point = format!("{} {}", number(x), number(y));
            if point != last {
                let _ = write!(data, "{}{point}", if last.is_empty() { "M" } else { "L" });
                last = point;
            }
        }
        finite &= !data.is_empty();
        data.push_str(end);
        let mut element = Self::new("path").with("d", &data);
        element.finite = finite;
        element
    }
}

/// A document under construction.
#[derive(Debug)]
pub(super) struct Svg {
    text: String,
    open: Vec<&'static str>,
}

impl Svg {
    /// A document of the given size in pixels.
    pub(super) fn new(width: f64, height: f64) -> Self {
        let (w, h) = (number(width), number(height));
        let text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', Arial, sans-serif\">\n"
        );
        Self { text, open: Vec::new() }
    }

    /// Adds an element without content.
    pub(super) fn add(&mut self, element: &Element) {
        if element.finite {
            self.indent();
            let _ = writeln!(self.text, "<{}{}/>", element.name, element.attributes);
        }
    }

    /// Adds an element with text content.
    pub(super) fn add_text(&mut self, element: &Element, text: &str) {
        if element.finite {
            self.indent();
            let _ = writeln!(self.text, "<{0}{1}>{2}</{0}>", element.name, element.attributes, escape(text));
        }
    }

    /// Adds an element that encloses the elements added by `content`.
    pub(super) fn group(&mut self, element: &Element, content: impl FnOnce(&mut Self)) {
        self.indent();
        let _ = writeln!(self.text, "<{}{}>", element.name, element.attributes);
        self.open.push(element.name);
        content(self);
        self.open.pop();
        self.indent();
        let _ = writeln!(self.text, "</{}>", element.name);
    }

    /// The finished document.
    pub(super) fn finish(mut self) -> String {
        self.text.push_str("</svg>\n");
        self.text
    }

    fn indent(&mut self) {
        for _ in &self.open {
            self.text.push(' ');
        }
    }
}

/// A number with at most two decimals; 0 if not finite (its element is omitted anyway).
pub(super) fn number(value: f64) -> String {
    if !value.is_finite() {
        return "0".into();
    }
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

/// Escapes text for XML content and attributes; characters that XML 1.0 forbids become the replacement character.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\t' | '\n' | '\r' => escaped.push(' '),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn numbers_have_no_negative_zero_and_no_trailing_zeros() {
        assert_eq!(number(-0.001), "0");
        assert_eq!(number(1.5), "1.5");
        assert_eq!(number(100.0), "100");
        assert_eq!(number(f64::NAN), "0");
    }

    #[test]
    fn a_shape_with_an_invalid_number_is_omitted() {
        let mut svg = Svg::new(10.0, 10.0);
        svg.add(&Element::polyline([(0.0, 1.0), (f64::NAN, 2.0)]));
        svg.add(&Element::line((0.0, f64::INFINITY), (1.0, 1.0)));
        svg.add(&Element::polygon([]));
        let text = svg.finish();
        assert!(!text.contains("path") && !text.contains("line"), "{text}");
    }

    proptest! {
        #[test]
        fn any_text_stays_well_formed(text in any::<String>()) {
            let mut svg = Svg::new(10.0, 10.0);
            svg.group(&Element::new("g").with("id", &text), |svg| svg.add_text(&Element::new("text"), &text));
            let written = svg.finish();
            let read = roxmltree::Document::parse(&written);
            prop_assert!(read.is_ok(), "{written}: {read:?}");
        }
    }
}
