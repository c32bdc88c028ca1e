//! The three charts of the SafeTLP paper's experiment: expanded states, planning time, average speed.

use super::axes::Area;
use super::geometry::{legend_row, sheet};
use super::violin::{Panel, Violin};
use super::{CONTENT, GAP, MARGIN, Mark, style};
use crate::bench::safetlp::{Comparison, LIMIT_SETS, Measurement, Method};

/// The methods that plan a stop: the paper's, in its order, then ours; each with its colour.
const SHOWN: [(Method, &str); 4] = [
    (Method::PlanToStop, style::MOVING),
    (Method::PlanToStopTimeless, style::REFERENCE),
    (Method::SafeTlp, style::DRIVEN),
    (Method::SafeRts, style::GOAL),
];

/// A chart of the experiment. The panel in the middle shows wall-clock times; the others are reproducible.
#[must_use]
pub fn experiment(comparison: &Comparison) -> String {
    const HEIGHT: f64 = 340.0;
    const LEGEND: f64 = 28.0;
    let s = &comparison.settings;
    let about = format!(
        "{} instances: a stop after {} m in steps of {} m, at most 15 m/s, start speeds 0…5 m/s, four sets of limits; time bins \
         of {} s",
        comparison.instances.len(),
        s.length,
        s.step,
        s.time_bin
    );
    sheet("Safe temporal lattice planning: the paper's experiment", &about, HEIGHT + LEGEND + 8.0, |svg, top| {
        let entries: Vec<(Mark, String)> =
            SHOWN.iter().map(|(m, colour)| (Mark::Box(colour, "0.35"), m.label().to_owned())).collect();
        legend_row(svg, (MARGIN, top - 8.0), &entries);
        let width = (CONTENT - 2.0 * GAP) / 3.0;
        let panels = [
            panel(comparison, "(a) expanded states", "expansions", true, |m| Some(m.expansions as f64)),
            panel(comparison, "(b) planning time, ms", "times", true, |m| Some(1e3 * m.time)),
            panel(comparison, "(c) average speed, m/s", "speeds", false, |m| m.plan.map(|p| p.average_speed)),
        ];
        for (i, panel) in panels.iter().enumerate() {
            let left = MARGIN + i as f64 * (width + GAP);
            panel.draw(svg, Area { corner: (left, top + LEGEND), width, height: HEIGHT });
        }
    })
}

fn panel(
    comparison: &Comparison,
    title: &'static str,
    id: &'static str,
    logarithmic: bool,
    value: fn(&Measurement) -> Option<f64>,
) -> Panel {
    let violin = |(method, colour): (Method, &'static str), set: usize| Violin {
        values: comparison.group(method, Some(set)).sorted(value),
        colour,
        class: method.name(),
    };
    let groups = LIMIT_SETS.iter().enumerate().map(|(set, (comfortable, aggressive))| {
        (format!("{comfortable}/{aggressive}"), SHOWN.iter().map(|shown| violin(*shown, set)).collect())
    });
    Panel { title, id, logarithmic, groups: groups.collect(), axis: "limit set: comfortable/aggressive, m/s²" }
}
