//! Panels of violin plots: the distribution of a metric in several groups, on a linear or logarithmic scale.
//!
//! A violin is a Gaussian kernel density (bandwidth by Silverman's rule, on the drawn scale) mirrored on its axis,
//! scaled to the width of its slot and cut off at the smallest and largest value. A line marks the median, a bar the
//! quartiles. Few or equal values give a thin violin.

use super::axes::{Area, nice_step};
use super::style;
use super::svg::{Element, Page, Svg, number};

/// A panel.
pub(super) struct Panel {
    /// Title with the unit.
    pub(super) title: &'static str,
    /// Id of its group.
    pub(super) id: &'static str,
    /// Whether the scale is logarithmic.
    pub(super) logarithmic: bool,
    /// Groups from left to right with their labels, each with violins side by side.
    pub(super) groups: Vec<(String, Vec<Violin>)>,
    /// Label of the groups, below them.
    pub(super) axis: &'static str,
}

/// One distribution.
pub(super) struct Violin {
    /// Sorted.
    pub(super) values: Vec<f64>,
    /// Colour.
    pub(super) colour: &'static str,
    /// CSS class.
    pub(super) class: &'static str,
}

const LEFT: f64 = 52.0;
const BELOW: f64 = 40.0;
const ABOVE: f64 = 24.0;

impl Panel {
    /// Draws the panel into the area.
    pub(super) fn draw(&self, svg: &mut Svg, area: Area) {
        let plot = Area {
            corner: (area.corner.0 + LEFT, area.corner.1 + ABOVE),
            width: area.width - LEFT,
            height: area.height - ABOVE - BELOW,
        };
        svg.group(&Element::new("g").with("id", self.id), |svg| {
            let title = Element::new("text").num("x", plot.corner.0).num("y", area.corner.1 + 12.0);
            svg.add_text(&title.num("font-size", 13.0).with("font-weight", "600").with("fill", style::INK), self.title);
            svg.add(&Element::rect(plot.corner, plot.width, plot.height).with("fill", style::PANEL));
            let range = self.range();
            self.grid(svg, plot, range);
            let width = plot.width / self.groups.len().max(1) as f64;
            for (i, (name, violins)) in self.groups.iter().enumerate() {
                let left = plot.corner.0 + width * i as f64;
                label(svg, (left + 0.5 * width, plot.corner.1 + plot.height + 15.0), "middle", name);
                let slot = 0.9 * width / violins.len().max(1) as f64;
                for (j, violin) in violins.iter().enumerate() {
                    let middle = left + 0.05 * width + slot * (j as f64 + 0.5);
                    let values: Vec<f64> = violin.values.iter().map(|v| self.scaled(*v)).collect();
                    violin.draw(svg, &values, middle, 0.45 * slot, |v| level(plot, range, v));
                }
            }
            label(svg, (plot.corner.0 + plot.width, plot.corner.1 + plot.height + 32.0), "end", self.axis);
        });
    }

    /// A value on the drawn scale.
    fn scaled(&self, value: f64) -> f64 {
        if self.logarithmic { value.max(f64::MIN_POSITIVE).log10() } else { value }
    }

    /// Vertical range on the drawn scale: all values with a margin; whole decades on a logarithmic scale.
    fn range(&self) -> (f64, f64) {
        let values = self.groups.iter().flat_map(|g| &g.1).flat_map(|v| &v.values).map(|v| self.scaled(*v));
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            return (0.0, 1.0);
        }
        if self.logarithmic {
            return (low.floor(), high.ceil().max(low.floor() + 1.0));
        }
        let margin = 0.06 * (high - low).max(0.1);
        (low - margin, high + margin)
    }

    fn grid(&self, svg: &mut Svg, plot: Area, range: (f64, f64)) {
        let step = if self.logarithmic { 1.0 } else { nice_step((range.1 - range.0) * 34.0 / plot.height) };
        #[allow(clippy::cast_possible_truncation)] // few
        let (first, last) = ((range.0 / step).ceil() as i64, (range.1 / step).floor() as i64);
        for i in first..=last {
            let y = level(plot, range, i as f64 * step);
            let line = Element::line((plot.corner.0, y), (plot.corner.0 + plot.width, y)).with("stroke", style::GRID);
            svg.add(&line.num("stroke-width", 1.0));
            let text = if self.logarithmic { power_of_ten(i) } else { number(i as f64 * step) };
            label(svg, (plot.corner.0 - 6.0, y + 3.6), "end", &text);
        }
    }
}

/// Page coordinate of a scaled value.
fn level(plot: Area, range: (f64, f64), value: f64) -> f64 {
    plot.corner.1 + plot.height * (range.1 - value) / (range.1 - range.0)
}

fn label(svg: &mut Svg, (x, y): Page, anchor: &str, text: &str) {
    let element = Element::new("text").num("x", x).num("y", y).num("font-size", 10.5);
    svg.add_text(&element.with("text-anchor", anchor).with("fill", style::FAINT_INK), text);
}

/// 10ⁿ as text.
fn power_of_ten(n: i64) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let digit = |c: char| c.to_digit(10).map_or('⁻', |d| DIGITS[d as usize]);
    format!("10{}", n.to_string().chars().map(digit).collect::<String>())
}

impl Violin {
    fn draw(&self, svg: &mut Svg, values: &[f64], middle: f64, half: f64, y: impl Fn(f64) -> f64) {
        /// Number of slices from the smallest to the largest value.
        const SLICES: u32 = 48;
        let (Some(&low), Some(&high)) = (values.first(), values.last()) else { return };
        let bandwidth = silverman(values);
        let at = |i: u32| low + (high - low) * f64::from(i) / f64::from(SLICES);
        let density: Vec<(f64, f64)> =
            (0..=SLICES).map(|i| (at(i), kernel_density(values, bandwidth, at(i)))).collect();
        let peak = density.iter().map(|d| d.1).fold(f64::MIN_POSITIVE, f64::max);
        let side = |sign: f64| density.iter().map(move |(v, d)| (*v, middle + sign * half * d / peak));
        let outline = side(1.0).chain(side(-1.0).collect::<Vec<_>>().into_iter().rev()).map(|(v, x)| (x, y(v)));
        let shape = Element::polygon(outline.collect::<Vec<_>>()).with("class", self.class).with("fill", self.colour);
        svg.add(&shape.num("fill-opacity", 0.35).with("stroke", self.colour).num("stroke-width", 1.2));
        let quartile = |share: f64| y(quantile(values, share));
        let bar = Element::line((middle, quartile(0.25)), (middle, quartile(0.75))).with("stroke", self.colour);
        svg.add(&bar.num("stroke-width", 3.0));
        let half_length = half.min(7.0);
        let median = Element::line((middle - half_length, quartile(0.5)), (middle + half_length, quartile(0.5)));
        svg.add(&median.with("stroke", style::INK).num("stroke-width", 1.6));
    }
}

/// Silverman's rule of thumb: 0.9 min(σ, IQR/1.34) n^(−1/5) (Density Estimation, 1986, 3.31); a small positive value
/// for equal values.
fn silverman(sorted: &[f64]) -> f64 {
    const LEAST: f64 = 1e-3;
    let n = sorted.len() as f64;
    let mean = sorted.iter().sum::<f64>() / n;
    let deviation = (sorted.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    let middle_half = (quantile(sorted, 0.75) - quantile(sorted, 0.25)) / 1.34;
    let spread = if middle_half > 0.0 { deviation.min(middle_half) } else { deviation };
    (0.9 * spread * n.powf(-0.2)).max(LEAST)
}

/// Kernel density up to a constant factor, which the drawing normalises.
fn kernel_density(values: &[f64], bandwidth: f64, at: f64) -> f64 {
    values.iter().map(|v| (-0.5 * ((at - v) / bandwidth).powi(2)).exp()).sum()
}

/// The quantile of sorted values for a share in 0…1, linearly interpolated; 0 without values.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * sorted.len().saturating_sub(1) as f64;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // an index
    let below = place.floor() as usize;
    let (Some(a), Some(b)) = (sorted.get(below), sorted.get(below + 1).or(sorted.last())) else { return 0.0 };
    a + (b - a) * (place - below as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(values: Vec<f64>, logarithmic: bool) -> String {
        let violin = Violin { values, colour: style::PLAN, class: "a" };
        let groups = vec![("one".to_owned(), vec![violin])];
        let panel = Panel { title: "t", id: "p", logarithmic, groups, axis: "groups" };
        let mut svg = Svg::new(300.0, 200.0);
        panel.draw(&mut svg, Area { corner: (0.0, 0.0), width: 300.0, height: 200.0 });
        svg.finish()
    }

    #[test]
    fn draws_many_few_equal_and_no_values() {
        assert!(panel((0..50).map(f64::from).collect(), false).contains("class=\"a\""));
        assert!(panel(vec![2.0], false).contains("class=\"a\""));
        assert!(panel(vec![2.0; 9], true).contains("class=\"a\""));
        assert!(!panel(vec![], true).contains("class=\"a\""));
        assert!(panel(vec![0.0, 3.0], true).contains("class=\"a\""), "zero on a logarithmic scale");
    }

    #[test]
    fn a_logarithmic_scale_shows_whole_decades() {
        let drawn = panel(vec![300.0, 4e6], true);
        for decade in ["10²", "10³", "10⁷"] {
            assert!(drawn.contains(decade), "{decade} in {drawn}");
        }
        assert_eq!(power_of_ten(-3), "10⁻³");
    }

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.5), 2.0);
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.75), 3.0);
        assert_eq!((quantile(&[7.0], 0.3), quantile(&[], 0.5)), (7.0, 0.0));
    }
}
