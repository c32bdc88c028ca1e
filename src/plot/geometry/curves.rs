//! Curves between two poses, and their curvature.

use super::{LEGEND, band, dot, framed, label, legend_row, metre_grid, sheet, stroke};
use crate::bench::problems::LatticeProblem;
use crate::bench::spirals::{Answer, BOUND, Curve, Method};
use crate::geometry::quintic::{self, Tangents};
use crate::geometry::spiral::{CubicSpiral, connect};
use crate::geometry::spiral_opt::connect_bounded;
use crate::geometry::{Point, Pose};
use crate::plot::axes::{self, Area, LimitLine, Panel};
use crate::plot::outline::Bounds;
use crate::plot::scene::{View, scale_bar};
use crate::plot::svg::{Element, Svg};
use crate::plot::{CONTENT, GAP, MARGIN, Mark, style};

/// Number of intervals of a drawn curve: smooth at any practical zoom.
const INTERVALS: usize = 160;

/// Colour of each method, the same in all pictures.
pub(super) fn colour(method: Method) -> &'static str {
    match method {
        Method::CubicNewton | Method::CubicShooting => style::DRIVEN,
        Method::CubicBounded => style::GOAL,
        Method::CubicSoft => style::PLAN,
        Method::QuinticSpiral | Method::QuinticBounded => style::VULNERABLE,
        Method::PolynomialChord => style::MOVING,
        Method::PolynomialLeastBending => style::REFERENCE,
    }
}

/// A curve and its line style.
struct StyledCurve {
    curve: Curve,
    colour: String,
    width: f64,
    dash: &'static str,
}

impl StyledCurve {
    fn new(curve: Curve, colour: &str, width: f64) -> Self {
        Self { curve, colour: colour.into(), width, dash: "" }
    }

    fn path(&self, svg: &mut Svg, view: &View) {
        let points: Vec<Point> = self.curve.sampled(INTERVALS).iter().map(|(_, p, _)| *p).collect();
        let line = stroke(view.line(&points), &self.colour, self.width);
        svg.add(&if self.dash.is_empty() { line } else { line.with("stroke-dasharray", self.dash) });
    }

    /// Curvature over arc length.
    fn curvature(&self) -> axes::Curve {
        axes::Curve {
            points: self.curve.sampled(INTERVALS).iter().map(|(s, _, k)| (*s, *k)).collect(),
            colour: self.colour.clone().into(),
            width: self.width,
            dash: self.dash,
            class: "curvature",
        }
    }
}

fn curvature_panel(id: &'static str, drawn: &[StyledCurve], at_least: (f64, f64)) -> Panel {
    let longest = drawn.iter().map(|d| d.curve.length()).fold(0.0, f64::max);
    Panel {
        title: "Curvature, 1/m",
        id,
        legend: vec![],
        curves: drawn.iter().map(StyledCurve::curvature).collect(),
        limits: vec![],
        x: (0.0, longest),
        axis: "arc length, m",
        at_least,
    }
}

fn bounds(low: (f64, f64), high: (f64, f64)) -> Bounds {
    Bounds { min: Point::new(low.0, low.1), max: Point::new(high.0, high.1) }
}

/// A pose as a dot with a short line in its heading.
fn pose_mark(svg: &mut Svg, view: &View, pose: &Pose, colour: &str) {
    let ahead = pose.advanced(22.0 / view.scale).position;
    svg.add(&stroke(view.line(&[pose.position, ahead]), colour, 1.4));
    dot(svg, view.page(&pose.position), 3.6, style::PAPER, colour);
}

/// Cubic spirals from one pose to the nodes of a lattice layer on a curved road.
pub(super) fn fan() -> String {
    /// Curvature of the reference line, 1/m; station of the layer and largest offset, m.
    const CURVATURE: f64 = 0.015;
    const AHEAD: f64 = 32.0;
    const WIDEST: i32 = 6;
    let node = |s: f64, l: f64| {
        let (sin, cos) = (CURVATURE * s).sin_cos();
        let radius = 1.0 / CURVATURE - l;
        Pose::new(radius * sin, 1.0 / CURVATURE - radius * cos, CURVATURE * s)
    };
    let spirals: Vec<(f64, Pose, CubicSpiral)> = (-WIDEST..=WIDEST)
        .filter_map(|i| {
            let l = f64::from(i);
            let end = node(AHEAD, l);
            connect(0.0, &end, CURVATURE / (1.0 - CURVATURE * l)).ok().map(|spiral| (l, end, spiral))
        })
        .collect();
    let hue = |l: f64| style::hex(style::viridis(0.5 + l / f64::from(2 * WIDEST)));
    let drawn: Vec<StyledCurve> = spirals
        .iter()
        .map(|(l, _, spiral)| StyledCurve::new(Curve::Cubic(*spiral), &hue(*l), if *l == 0.0 { 2.8 } else { 1.5 }))
        .collect();
    let about = "from one straight pose to the nodes of a layer 32 m ahead on a curve of 67 m radius: \
                 each node has the heading and curvature of the road at its offset";
    let (plane, panel) = (band(0.0, 450.0), band(0.0, 250.0));
    sheet("A fan of cubic spirals", about, plane.height + LEGEND + panel.height + 16.0, |svg, top| {
        let plane = Area { corner: (MARGIN, top), ..plane };
        let view = View::new(bounds((-3.0, -4.0), (36.5, 14.6)), plane);
        framed(svg, "plane", &view, style::PANEL, |svg| {
            metre_grid(svg, &view, 5.0);
            let road: Vec<Point> = (-10..=50).map(|s| node(f64::from(s), 0.0).position).collect();
            svg.add(&stroke(view.line(&road), style::ZERO, 1.0).with("stroke-dasharray", "2 5"));
            drawn.iter().for_each(|d| d.path(svg, &view));
            pose_mark(svg, &view, &Pose::new(0.0, 0.0, 0.0), style::INK);
            for (l, end, _) in &spirals {
                pose_mark(svg, &view, end, &hue(*l));
                if l.rem_euclid(2.0) == 0.0 {
                    let (x, y) = view.page(&end.advanced(30.0 / view.scale).position);
                    label(svg, (x, y + 4.0), "start", style::INK, &metres(*l));
                }
            }
            scale_bar(svg, &view);
        });
        let entries = [
            (Mark::Line(style::ZERO, "2 5", 1.0), "reference line".into()),
            (Mark::Line(style::VIRIDIS_LOW, "", 1.8), "ends to the right".into()),
            (
                Mark::Line(style::VIRIDIS_HIGH, "", 1.8),
                "ends to the left; numbers are offsets from the reference line".into(),
            ),
        ];
        legend_row(svg, (MARGIN, top + plane.height), &entries);
        let panel = Area { corner: (MARGIN, top + plane.height + LEGEND + 8.0), ..panel };
        curvature_panel("curvature", &drawn, (-0.01, 0.01)).draw(svg, panel);
    })
}

fn metres(l: f64) -> String {
    if l == 0.0 { "0 m".into() } else { format!("{l:+} m").replace('-', "−") }
}

/// A curvature bound that the cubic spiral with both ends fixed violates, and the spiral that satisfies it with its end
/// moved sideways.
pub(super) fn bound() -> String {
    let end = Pose::new(13.0, 5.0, 0.0);
    let unbounded = connect(0.0, &end, 0.0).ok();
    let bounded = connect_bounded(0.0, &end, 0.0, BOUND).ok();
    let mut drawn = Vec::new();
    if let Some(spiral) = unbounded {
        drawn.push(StyledCurve::new(Curve::Cubic(spiral), colour(Method::CubicNewton), 2.2));
    }
    if let Some(found) = bounded {
        drawn.push(StyledCurve::new(Curve::Cubic(found.spiral), colour(Method::CubicBounded), 2.6));
    }
    let shift = bounded.map_or(0.0, |h| h.end_error);
    let reached = Pose { position: end.position + end.left() * shift, ..end };
    let about = "5 m to the left within 13 m: with both ends fixed the spiral violates the bound; a convex program keeps |κ| ≤ \
                 0.12 1/m at every point and moves the end as little as possible";
    let (plane, panel) = (band(0.0, 440.0), band(0.0, 270.0));
    sheet("An active curvature bound", about, plane.height + LEGEND + panel.height + 16.0, |svg, top| {
        let plane = Area { corner: (MARGIN, top), ..plane };
        let view = View::new(bounds((-1.5, -0.8), (17.0, 5.8)), plane);
        framed(svg, "plane", &view, style::PANEL, |svg| {
            metre_grid(svg, &view, 1.0);
            drawn.iter().for_each(|d| d.path(svg, &view));
            pose_mark(svg, &view, &Pose::new(0.0, 0.0, 0.0), style::INK);
            let (from, to) = (view.page(&end.position), view.page(&reached.position));
            svg.add(&stroke(Element::line(from, to), style::ALARM, 1.4).with("stroke-dasharray", "4 3"));
            pose_mark(svg, &view, &end, colour(Method::CubicNewton));
            pose_mark(svg, &view, &reached, colour(Method::CubicBounded));
            label(svg, (from.0 + 34.0, from.1 + 4.0), "start", style::INK, "requested end");
            let middle = (from.0 + 8.0, 0.5 * (from.1 + to.1) + 4.0);
            label(svg, middle, "start", style::ALARM, &format!("moved {:.2} m", shift.abs()));
            label(svg, (to.0 + 34.0, to.1 + 4.0), "start", style::INK, "end within the bound");
            scale_bar(svg, &view);
        });
        let entries = [
            (Mark::Line(colour(Method::CubicNewton), "", 2.2), "cubic spiral, both ends fixed (Newton)".into()),
            (
                Mark::Line(colour(Method::CubicBounded), "", 2.6),
                "cubic spiral within the bound (second-order cones)".into(),
            ),
            (Mark::Line(style::ALARM, "5 4", 1.0), "bound".into()),
        ];
        legend_row(svg, (MARGIN, top + plane.height), &entries);
        let limits = vec![bound_line(BOUND, "0.12"), bound_line(-BOUND, "−0.12")];
        let panel = Area { corner: (MARGIN, top + plane.height + LEGEND + 8.0), ..panel };
        Panel { limits, ..curvature_panel("curvature", &drawn, (-1.1 * BOUND, 1.1 * BOUND)) }.draw(svg, panel);
    })
}

fn bound_line(value: f64, label: &'static str) -> LimitLine {
    LimitLine { value, label, colour: style::ALARM }
}

/// All kinds of curves between the same two poses, and the effect of the tangent length on the polynomial.
pub(super) fn side_by_side() -> String {
    let problem = LatticeProblem { start_curvature: 0.04, end: Pose::new(30.0, 7.0, -0.5), end_curvature: 0.06 };
    let methods = [Method::PolynomialLeastBending, Method::PolynomialChord, Method::QuinticSpiral, Method::CubicNewton];
    let drawn: Vec<StyledCurve> = methods
        .iter()
        .filter_map(|m| m.solve(&problem).map(|Answer { curve, .. }| StyledCurve::new(curve, colour(*m), 2.2)))
        .collect();
    let about = "the same poses and end curvatures; only the spirals stay below 0.12 1/m, and no tangent length \
                 lowers the polynomial's curvature to theirs";
    let (plane, panel) = (band(0.0, 430.0), 290.0);
    sheet("Spirals and polynomial paths", about, plane.height + LEGEND + panel + 16.0, |svg, top| {
        let plane = Area { corner: (MARGIN, top), ..plane };
        let view = View::new(bounds((-2.0, -1.5), (33.0, 11.5)), plane);
        framed(svg, "plane", &view, style::PANEL, |svg| {
            metre_grid(svg, &view, 5.0);
            drawn.iter().for_each(|d| d.path(svg, &view));
            pose_mark(svg, &view, &Pose::new(0.0, 0.0, 0.0), style::INK);
            pose_mark(svg, &view, &problem.end, style::INK);
            scale_bar(svg, &view);
        });
        let entries: Vec<(Mark, String)> =
            methods.iter().rev().map(|m| (Mark::Line(colour(*m), "", 2.2), described(*m).into())).collect();
        legend_row(svg, (MARGIN, top + plane.height), &entries);
        let (below, width) = (top + plane.height + LEGEND + 8.0, 0.5 * (CONTENT - GAP));
        let left = Area { corner: (MARGIN, below), width, height: panel };
        let limits = vec![bound_line(-BOUND, "−0.12 1/m")];
        Panel { limits, ..curvature_panel("curvature", &drawn, (-0.1, 0.1)) }.draw(svg, left);
        let right = Area { corner: (MARGIN + width + GAP, below), ..left };
        sensitivity(&problem).draw(svg, right);
    })
}

fn described(method: Method) -> &'static str {
    match method {
        Method::CubicNewton => "cubic spiral, both ends fixed",
        Method::QuinticSpiral => "quintic spiral, least bending energy",
        Method::PolynomialChord => "quintic polynomial, tangents of chord length",
        Method::PolynomialLeastBending => "quintic polynomial, tangents optimised",
        _ => method.label(),
    }
}

/// Largest curvature of the polynomial path over its tangent length, compared with that of the spiral.
fn sensitivity(problem: &LatticeProblem) -> Panel {
    /// Range of tangent lengths over the chord, and the largest curvature shown, 1/m.
    const RATIOS: (f64, f64) = (0.5, 2.0);
    const HIGHEST: f64 = 0.4;
    const STEPS: u32 = 150;
    let chord = problem.end.position.coords.norm();
    let peak = |ratio: f64| {
        let tangents = Tangents::equal(ratio * chord);
        let path = quintic::connect_with(problem.start_curvature, &problem.end, problem.end_curvature, &tangents);
        path.map_or(f64::NAN, |p| p.max_abs_curvature())
    };
    let ratios = (0..=STEPS).map(|i| RATIOS.0 + (RATIOS.1 - RATIOS.0) * f64::from(i) / f64::from(STEPS));
    let points = ratios.map(|r| (r, peak(r))).take_while(|(_, k)| *k <= HIGHEST).collect();
    let spiral = connect(problem.start_curvature, &problem.end, problem.end_curvature);
    let level = spiral.map_or(0.0, |s| s.max_abs_curvature());
    let line = axes::Curve {
        points,
        colour: colour(Method::PolynomialChord).into(),
        width: 2.2,
        dash: "",
        class: "sensitivity",
    };
    Panel {
        title: "Largest |curvature| by tangent length, 1/m",
        id: "sensitivity",
        legend: vec![("quintic polynomial", colour(Method::PolynomialChord))],
        curves: vec![line],
        limits: vec![LimitLine { value: level, label: "cubic spiral", colour: colour(Method::CubicNewton) }],
        x: RATIOS,
        axis: "tangent length over chord",
        at_least: (0.0, 0.2),
    }
}
