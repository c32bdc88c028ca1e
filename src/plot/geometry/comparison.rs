//! Distributions of the solutions of `stopline bench spirals`, by method.

use super::curves::colour;
use super::{LEGEND, legend_row, sheet};
use crate::bench::spirals::{BOUND, Comparison, Evaluation, Method};
use crate::plot::axes::{Area, Curve, Panel};
use crate::plot::{CONTENT, GAP, MARGIN, Mark, style};

/// A chart of a comparison: the share of problems for which the curve's largest curvature, and its bending energy
/// relative to the cubic spiral, stay below a value. It has no times: equal problems give equal bytes.
#[must_use]
pub fn comparison(comparison: &Comparison) -> String {
    const HEIGHT: f64 = 330.0;
    let about = format!(
        "{} lattice problems, seed {}: 10…40 m ahead, ±8 m lateral, ±0.5 rad, curvature ±0.1 1/m at both ends; each line is \
         the share of problems for which a method stays below the value",
        comparison.problems.len(),
        comparison.settings.seed
    );
    sheet("Smooth paths between lattice ends", &about, HEIGHT + LEGEND + 8.0, |svg, top| {
        let entries: Vec<(Mark, String)> =
            shown().map(|m| (Mark::Line(colour(m), "", 2.2), m.label().to_owned())).collect();
        legend_row(svg, (MARGIN, top - 8.0), &entries);
        let width = 0.5 * (CONTENT - GAP);
        let left = Area { corner: (MARGIN, top + LEGEND), width, height: HEIGHT };
        curvatures(comparison).draw(svg, left);
        energies(comparison).draw(svg, Area { corner: (MARGIN + width + GAP, left.corner.1), ..left });
    })
}

/// The methods shown: those that solve every problem at the exact end. Shooting is omitted, since it gives the same
/// spirals as Newton's method.
fn shown() -> impl Iterator<Item = Method> {
    let hidden = [Method::CubicShooting, Method::CubicSoft, Method::CubicBounded, Method::QuinticBounded];
    Method::ALL.into_iter().filter(move |m| !hidden.contains(m))
}

fn curvatures(comparison: &Comparison) -> Panel {
    const HIGHEST: f64 = 0.3;
    let bound = Curve {
        points: vec![(BOUND, 0.0), (BOUND, 100.0)],
        colour: style::ALARM.into(),
        width: 1.0,
        dash: "5 4",
        class: "limit",
    };
    let lines = shown().map(|m| share(m, &values(comparison, m, |j, _| j.max_curvature), HIGHEST));
    Panel {
        title: "Share of problems, %, by largest |curvature|",
        id: "curvatures",
        legend: vec![("bound", style::ALARM)],
        curves: lines.chain([bound]).collect(),
        limits: vec![],
        x: (0.0, HIGHEST),
        axis: "largest |κ|, 1/m",
        at_least: (0.0, 100.0),
    }
}

fn energies(comparison: &Comparison) -> Panel {
    const HIGHEST: f64 = 1.2;
    let others = shown().filter(|m| *m != Method::CubicNewton);
    Panel {
        title: "Share of problems, %, by bending energy over the cubic spiral's",
        id: "energies",
        legend: vec![],
        curves: others.map(|m| share(m, &values(comparison, m, |j, r| j.bending_energy / r), HIGHEST)).collect(),
        limits: vec![],
        x: (0.0, HIGHEST),
        axis: "∫κ² ds over that of the cubic spiral",
        at_least: (0.0, 100.0),
    }
}

/// A metric of every solution of a method, computed from the solution and the bending energy of the cubic spiral;
/// sorted.
fn values(comparison: &Comparison, method: Method, metric: fn(&Evaluation, f64) -> f64) -> Vec<f64> {
    let place = |m| Method::ALL.iter().position(|other| *other == m);
    let (Some(own), Some(reference)) = (place(method), place(Method::CubicNewton)) else { return Vec::new() };
    let pairs = comparison.evaluations[own].iter().zip(&comparison.evaluations[reference]);
    let both = pairs.filter_map(|(own, reference)| Some(metric(own.as_ref()?, reference.as_ref()?.bending_energy)));
    let mut values: Vec<f64> = both.filter(|v| v.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    values
}

/// The cumulative share of sorted values, %, at enough points to look smooth.
fn share(method: Method, sorted: &[f64], highest: f64) -> Curve {
    const POINTS: u32 = 240;
    let below = |x: f64| 100.0 * sorted.partition_point(|v| *v <= x) as f64 / sorted.len().max(1) as f64;
    let points = (0..=POINTS).map(|i| highest * f64::from(i) / f64::from(POINTS)).map(|x| (x, below(x)));
    Curve { points: points.collect(), colour: colour(method).into(), width: 2.2, dash: "", class: method.name() }
}
