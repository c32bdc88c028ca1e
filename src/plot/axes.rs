//! Panels with two axes: rounded ticks, curves, limit lines.

use std::borrow::Cow;

use super::style;
use super::svg::{Element, Page, Svg, number};

/// A curve of a panel.
pub(super) struct Curve {
    /// (horizontal, vertical) values, usually in horizontal order.
    pub(super) points: Vec<(f64, f64)>,
    /// Colour.
    pub(super) colour: Cow<'static, str>,
    /// Width, px.
    pub(super) width: f64,
    /// Dash pattern, empty for a solid line.
    pub(super) dash: &'static str,
    /// CSS class.
    pub(super) class: &'static str,
}

/// A horizontal line at a limit.
pub(super) struct LimitLine {
    /// Value of the limit.
    pub(super) value: f64,
    /// Label beside the line.
    pub(super) label: &'static str,
    /// Colour.
    pub(super) colour: &'static str,
}

/// A panel: values over time or another quantity.
pub(super) struct Panel {
    /// Title with the unit.
    pub(super) title: &'static str,
    /// Id of its group.
    pub(super) id: &'static str,
    /// Legend: names of curves with their colours, right of the title.
    pub(super) legend: Vec<(&'static str, &'static str)>,
    /// Curves, drawn in order.
    pub(super) curves: Vec<Curve>,
    /// Limit lines.
    pub(super) limits: Vec<LimitLine>,
    /// Range of the horizontal axis.
    pub(super) x: (f64, f64),
    /// Label of the horizontal axis, with the unit.
    pub(super) axis: &'static str,
    /// Range that the vertical axis covers at least.
    pub(super) at_least: (f64, f64),
}

/// A rectangle on the page, px.
#[derive(Debug, Clone, Copy)]
pub(super) struct Area {
    /// Upper left corner.
    pub(super) corner: Page,
    /// Width.
    pub(super) width: f64,
    /// Height.
    pub(super) height: f64,
}

/// Space for the tick labels to the left of and below the plot, and for the title above it, px.
const LEFT: f64 = 40.0;
const BELOW: f64 = 32.0;
const ABOVE: f64 = 24.0;

impl Panel {
    /// Draws the panel into the area.
    pub(super) fn draw(&self, svg: &mut Svg, area: Area) {
        let plot = Area {
            corner: (area.corner.0 + LEFT, area.corner.1 + ABOVE),
            width: area.width - LEFT,
            height: area.height - ABOVE - BELOW,
        };
        let x = Scale::new(self.x, (plot.corner.0, plot.corner.0 + plot.width));
        let y = Scale::new(self.value_range(), (plot.corner.1 + plot.height, plot.corner.1));
        svg.group(&Element::new("g").with("id", self.id), |svg| {
            let title = Element::new("text").num("x", plot.corner.0).num("y", area.corner.1 + 12.0);
            svg.add_text(&title.num("font-size", 13.0).with("font-weight", "600").with("fill", style::INK), self.title);
            self.draw_legend(svg, (plot.corner.0 + plot.width, area.corner.1 + 12.0));
            grid(svg, plot, (&x, self.axis), &y);
            let clip = format!("clip-{}", self.id);
            svg.group(&Element::new("clipPath").with("id", &clip), |svg| {
                svg.add(&Element::rect(plot.corner, plot.width, plot.height));
            });
            svg.group(&Element::new("g").with("clip-path", &format!("url(#{clip})")), |svg| {
                for curve in &self.curves {
                    curve.draw(svg, &x, &y);
                }
                for limit in &self.limits {
                    limit.draw(svg, plot, &y);
                }
            });
        });
    }

    fn draw_legend(&self, svg: &mut Svg, (right, y): Page) {
        let mut x = right;
        for (name, colour) in self.legend.iter().rev() {
            let text = Element::new("text").num("x", x).num("y", y).num("font-size", 11.0);
            svg.add_text(&text.with("text-anchor", "end").with("fill", colour), name);
            x -= 6.4 * name.chars().count() as f64 + 12.0;
        }
    }

    /// Vertical range: all finite values and `at_least`, with a margin.
    fn value_range(&self) -> (f64, f64) {
        let values = self.curves.iter().flat_map(|c| &c.points).map(|p| p.1).filter(|v| v.is_finite());
        let (low, high) = values.fold(self.at_least, |(low, high), v| (low.min(v), high.max(v)));
        let margin = 0.06 * (high - low);
        (if low < 0.0 { low - margin } else { low }, high + margin)
    }
}

impl Curve {
    fn draw(&self, svg: &mut Svg, x: &Scale, y: &Scale) {
        let points = self.points.iter().map(|(time, value)| (x.at(*time), y.at(*value)));
        let mut line = Element::polyline(points)
            .with("class", self.class)
            .with("fill", "none")
            .with("stroke", &self.colour)
            .num("stroke-width", self.width)
            .with("stroke-linejoin", "round");
        if !self.dash.is_empty() {
            line = line.with("stroke-dasharray", self.dash);
        }
        svg.add(&line);
    }
}

impl LimitLine {
    fn draw(&self, svg: &mut Svg, plot: Area, y: &Scale) {
        let (left, right, level) = (plot.corner.0, plot.corner.0 + plot.width, y.at(self.value));
        let line = Element::line((left, level), (right, level)).with("class", "limit").with("stroke", self.colour);
        svg.add(&line.num("stroke-width", 1.0).with("stroke-dasharray", "5 4"));
        // below the line near the top of the panel, where there is no space above it
        let offset = if level - plot.corner.1 < 13.0 { 11.0 } else { -3.5 };
        let label = Element::new("text").num("x", right - 3.0).num("y", level + offset).num("font-size", 10.0);
        svg.add_text(&label.with("text-anchor", "end").with("fill", self.colour), self.label);
    }
}

fn grid(svg: &mut Svg, plot: Area, (x, axis): (&Scale, &str), y: &Scale) {
    let (left, top) = plot.corner;
    let (right, bottom) = (left + plot.width, top + plot.height);
    svg.add(&Element::rect(plot.corner, plot.width, plot.height).with("fill", style::PANEL));
    let label = Element::new("text").num("font-size", 10.5).with("fill", style::FAINT_INK);
    for tick in ticks(y.from, (plot.height / 34.0).clamp(2.0, 7.0)) {
        let level = y.at(tick);
        let colour = if tick == 0.0 { style::ZERO } else { style::GRID };
        svg.add(&Element::line((left, level), (right, level)).with("stroke", colour).num("stroke-width", 1.0));
        let text = label.clone().num("x", left - 6.0).num("y", level + 3.6).with("text-anchor", "end");
        svg.add_text(&text, &signed(tick));
    }
    for tick in ticks(x.from, (plot.width / 60.0).clamp(2.0, 10.0)) {
        let column = x.at(tick);
        svg.add(&Element::line((column, top), (column, bottom)).with("stroke", style::GRID).num("stroke-width", 1.0));
        let text = label.clone().num("x", column).num("y", bottom + 15.0).with("text-anchor", "middle");
        svg.add_text(&text, &signed(tick));
    }
    let text = label.num("x", right).num("y", bottom + 28.0).with("text-anchor", "end");
    svg.add_text(&text, axis);
}

/// A number with a typographic minus sign.
fn signed(value: f64) -> String {
    number(value).replace('-', "−")
}

/// A linear scale from values to pixels.
#[derive(Debug, Clone, Copy)]
struct Scale {
    from: (f64, f64),
    to: (f64, f64),
}

impl Scale {
    /// A scale; an empty or unordered interval of values is replaced by one of length 1.
    fn new(from: (f64, f64), to: (f64, f64)) -> Self {
        let interval = if from.1 > from.0 { from } else { (from.0, from.0 + 1.0) };
        Self { from: interval, to }
    }

    fn at(&self, value: f64) -> f64 {
        self.to.0 + (value - self.from.0) / (self.from.1 - self.from.0) * (self.to.1 - self.to.0)
    }
}

/// Multiples of a rounded step (1, 2 or 5 times a power of ten) in the interval, about `count` of them.
fn ticks(range: (f64, f64), count: f64) -> Vec<f64> {
    let step = nice_step((range.1 - range.0) / count);
    #[allow(clippy::cast_possible_truncation)] // few: the step follows from the range
    let (first, last) = ((range.0 / step - 1e-9).ceil() as i64, (range.1 / step + 1e-9).floor() as i64);
    (first..=last).map(|i| i as f64 * step).collect()
}

/// The smallest 1, 2 or 5 times a power of ten that is at least `step`; 1 if `step` is not a positive number.
pub(crate) fn nice_step(step: f64) -> f64 {
    if !(step.is_finite() && step > 0.0) {
        return 1.0;
    }
    let power = 10f64.powf(step.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|m| m * power).find(|nice| *nice >= step * (1.0 - 1e-9)).unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn steps_are_one_two_five() {
        let steps = [0.9, 1.0, 1.1, 2.4, 5.1, 70.0, 0.03].map(nice_step);
        for (step, expected) in steps.into_iter().zip([1.0, 1.0, 2.0, 5.0, 10.0, 100.0, 0.05]) {
            assert!((step - expected).abs() < 1e-12, "{steps:?}");
        }
        assert_eq!([f64::NAN, 0.0, -1.0].map(nice_step), [1.0; 3]);
    }

    proptest! {
        #[test]
        fn ticks_are_few_and_inside_the_interval(low in -1e4..1e4f64, length in 1e-3..1e4f64, count in 2.0..10.0f64) {
            let ticks = super::ticks((low, low + length), count);
            let slack = 1e-6 * length;
            prop_assert!(ticks.iter().all(|t| *t >= low - slack && *t <= low + length + slack));
            prop_assert!(ticks.len() as f64 <= count + 2.0, "{ticks:?}");
        }
    }

    #[test]
    fn an_empty_panel_contains_no_invalid_numbers() {
        let panel = Panel {
            title: "t",
            id: "p",
            legend: vec![],
            curves: vec![],
            limits: vec![],
            x: (0.0, 0.0),
            axis: "time, s",
            at_least: (0.0, 0.0),
        };
        let mut svg = Svg::new(100.0, 100.0);
        panel.draw(&mut svg, Area { corner: (0.0, 0.0), width: 100.0, height: 100.0 });
        let text = svg.finish();
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    }
}
