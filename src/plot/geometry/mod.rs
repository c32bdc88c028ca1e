//! The pictures of `docs/geometry.md`: curves, lattice and sweeps, drawn with the planner's code.
//!
//! [`pictures`] draws them all; `cargo run --release --example geometry_page` writes them to the page's folder. The
//! output is reproducible; a test compares it with the committed files.

mod comparison;
mod curves;
mod lattice;

pub use comparison::comparison;

use super::axes::Area;
use super::scene::View;
use super::style;
use super::svg::{Element, Page, Svg};
use super::{CONTENT, MARGIN, Mark, PAGE_WIDTH};
use crate::map::Scenario;
use crate::vehicle::Vehicle;

/// All pictures of the page with their file names. Lattice and sweep use the slalom of `maps/` and the given vehicle;
/// they are omitted if the scenario's first planning problem has no route.
#[must_use]
pub fn pictures(slalom: &Scenario, vehicle: &Vehicle) -> Vec<(&'static str, String)> {
    let measured = crate::bench::spirals::compare(&crate::bench::spirals::Settings::default());
    let mut all = vec![
        ("fan.svg", curves::fan()),
        ("bound.svg", curves::bound()),
        ("curves.svg", curves::side_by_side()),
        ("comparison.svg", comparison(&measured)),
    ];
    if let Some(scene) = lattice::LatticeScene::new(slalom, vehicle) {
        all.extend([("lattice.svg", scene.lattice()), ("sweep.svg", scene.sweep())]);
    }
    all
}

/// Height of a sheet's title and of the line below it, px.
const HEAD: f64 = 52.0;
/// Height of a legend's row, px.
const LEGEND: f64 = 28.0;

/// A page with a title, a subtitle and `height` px of content, drawn by `draw` from the given `top` on.
pub(super) fn sheet(title: &str, about: &str, height: f64, draw: impl FnOnce(&mut Svg, f64)) -> String {
    let (top, page_height) = (MARGIN + HEAD, MARGIN + HEAD + height + MARGIN);
    let mut svg = Svg::new(PAGE_WIDTH, page_height);
    svg.add_text(&Element::new("title"), title);
    svg.add(&Element::rect((0.0, 0.0), PAGE_WIDTH, page_height).with("fill", style::PAPER));
    let line = |y: f64, size: f64| Element::new("text").num("x", MARGIN).num("y", y).num("font-size", size);
    svg.group(&Element::new("g").with("id", "header"), |svg| {
        svg.add_text(&line(MARGIN + 14.0, 20.0).with("font-weight", "700").with("fill", style::INK), title);
        svg.add_text(&line(MARGIN + 35.0, 13.0).with("fill", style::FAINT_INK), about);
    });
    draw(&mut svg, top);
    svg.finish()
}

/// The full content width of the page from `top` on.
fn band(top: f64, height: f64) -> Area {
    Area { corner: (MARGIN, top), width: CONTENT, height }
}

/// A view of the plane, clipped to its area, on a background colour.
fn framed(svg: &mut Svg, id: &str, view: &View, background: &str, draw: impl FnOnce(&mut Svg)) {
    let (area, clip) = (view.area, format!("clip-{id}"));
    let rect = || Element::rect(area.corner, area.width, area.height).num("rx", 4.0);
    svg.group(&Element::new("clipPath").with("id", &clip), |svg| svg.add(&rect()));
    svg.group(&Element::new("g").with("id", id).with("clip-path", &format!("url(#{clip})")), |svg| {
        svg.add(&rect().with("fill", background));
        draw(svg);
    });
}

/// Lines every `step` metres of the plane.
fn metre_grid(svg: &mut Svg, view: &View, step: f64) {
    let (low, high) = (view.bounds.min, view.bounds.max);
    let (left, top) = view.area.corner;
    let (right, bottom) = (left + view.area.width, top + view.area.height);
    #[allow(clippy::cast_possible_truncation)] // a few dozen lines
    let multiples =
        |from: f64, to: f64| ((from / step).ceil() as i64..=(to / step).floor() as i64).map(|i| i as f64 * step);
    svg.group(&Element::new("g").with("stroke", style::GRID).num("stroke-width", 1.0), |svg| {
        for x in multiples(low.x, high.x) {
            let column = left + view.scale * (x - low.x);
            svg.add(&Element::line((column, top), (column, bottom)));
        }
        for y in multiples(low.y, high.y) {
            let level = top + view.scale * (high.y - y);
            svg.add(&Element::line((left, level), (right, level)));
        }
    });
}

/// A legend row: symbols with their names.
pub(super) fn legend_row(svg: &mut Svg, (left, top): Page, entries: &[(Mark, String)]) {
    svg.group(
        &Element::new("g").with("class", "legend").num("font-size", 11.5).with("fill", style::FAINT_INK),
        |svg| {
            let (mut x, middle) = (left, top + 14.0);
            for (mark, text) in entries {
                mark.draw(svg, (x, middle));
                svg.add_text(&Element::new("text").num("x", x + 26.0).num("y", middle + 4.0), text);
                x += 26.0 + 6.6 * text.chars().count() as f64 + 18.0;
            }
        },
    );
}

/// Sets colour and width of a line.
fn stroke(element: Element, colour: &str, width: f64) -> Element {
    element.with("stroke", colour).num("stroke-width", width).with("stroke-linejoin", "round")
}

/// Text on the drawing, with a halo that keeps it readable over lines.
fn label(svg: &mut Svg, place: Page, anchor: &str, colour: &str, text: &str) {
    let element = Element::new("text").num("x", place.0).num("y", place.1).num("font-size", 12.0);
    let element = element.with("text-anchor", anchor).with("fill", colour).with("stroke", style::PANEL);
    let halo = element.num("stroke-width", 3.0).with("paint-order", "stroke").with("stroke-linejoin", "round");
    svg.add_text(&halo, text);
}

/// A dot on the page, with an outline.
fn dot(svg: &mut Svg, (x, y): Page, radius: f64, fill: &str, edge: &str) {
    let circle = Element::new("circle").num("cx", x).num("cy", y).num("r", radius).with("fill", fill);
    svg.add(&circle.with("stroke", edge).num("stroke-width", 1.2));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_picture_of_curves_is_valid() {
        for (name, svg) in [("fan", curves::fan()), ("bound", curves::bound()), ("curves", curves::side_by_side())] {
            let read = roxmltree::Document::parse(&svg).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{name}");
            let mut ids: Vec<&str> = read.descendants().filter_map(|n| n.attribute("id")).collect();
            ids.sort_unstable();
            assert!(ids.windows(2).all(|w| w[0] != w[1]), "{name}: a duplicate id: {ids:?}");
        }
    }

    #[test]
    fn draws_a_comparison_of_one_problem() {
        let settings = crate::bench::spirals::Settings { seed: 7, problems: 1 };
        let svg = comparison(&crate::bench::spirals::compare(&settings));
        assert!(roxmltree::Document::parse(&svg).is_ok() && !svg.contains("NaN"), "{svg}");
    }
}
