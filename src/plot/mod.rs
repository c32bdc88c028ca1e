//! Pictures: a run as one self-contained SVG file, for people and for reports.
//!
//! The top view is cropped to the action, with y up; values over time are below it, or beside it where the action is as
//! high as wide. The file loads nothing: no fonts, no scripts, no links. Equal runs give equal bytes.
//!
//! [`geometry`] draws the pictures of `docs/geometry.md`: curves, lattice and sweeps, without a run.
//!
//! Limitations: labels are placed by simple rules and may overlap in dense traffic; a diagonal road is not rotated to
//! fit the page.

pub(crate) mod axes;
#[cfg(test)]
pub(crate) mod example;
pub mod geometry;
pub(crate) mod motion;
pub(crate) mod outline;
pub mod safetlp;
mod scene;
pub(crate) mod style;
mod svg;
mod violin;

use axes::{Area, Curve, LimitLine, Panel};
use motion::{Motion, MotionSample, speed_limit_at};
use outline::action_bounds;
use scene::{Scene, View};
use svg::{Element, Page, Svg};

use crate::drive::Run;
use crate::planner::{Candidate, Rejection};
use crate::trajectory::Trajectory;
use crate::verdict::{Check, jerk_limit};

/// Width of the page and margin around everything, px.
const PAGE_WIDTH: f64 = 1240.0;
const MARGIN: f64 = 24.0;
const CONTENT: f64 = PAGE_WIDTH - 2.0 * MARGIN;
/// Space between the parts, px.
const GAP: f64 = 22.0;
/// Vertical space between panels, px.
const PANEL_GAP: f64 = 10.0;
/// Height of the legend's row, px.
const LEGEND: f64 = 26.0;
/// Ratio of width to height from which on the top view has the full page width and the panels are below it.
const WIDE: f64 = 1.7;
/// Failed checks listed in the header; further ones are counted.
const LISTED_FAILURES: usize = 4;
/// Maximum characters per line of the header: fits with a wide font.
const LINE_LENGTH: usize = 160;
/// Time by which the panels extend beyond the drive to show the last fallback stops, s.
const TAIL: f64 = 4.0;
/// Smallest time between points of a curve, s.
const CURVE_STEP: f64 = 0.04;

/// A picture of a run: the top view with perceived, planned and driven motion, and speed and accelerations over time.
/// For a single planning cycle, whose log is empty, the committed plan replaces the drive.
#[must_use]
pub fn run_svg(run: &Run) -> String {
    let motion = Motion::of(run);
    let fastest = motion.samples.iter().map(|s| s.speed).fold(1.0, f64::max);
    let scene = Scene { run, motion: &motion, top_speed: nice_ceiling(fastest) };
    let bounds = action_bounds(run, &motion);
    let header = Header::of(run, motion.driven);
    let top = MARGIN + header.height();
    let layout = Layout::new(bounds.width() / bounds.height(), top);

    let mut svg = Svg::new(PAGE_WIDTH, layout.page_height);
    svg.add_text(&Element::new("title"), &format!("{}: {}", run.scenario.id, run.outcome.name()));
    svg.add(&Element::rect((0.0, 0.0), PAGE_WIDTH, layout.page_height).with("fill", style::PAPER));
    header.draw(&mut svg);
    scene.draw(&mut svg, &View::new(bounds, layout.scene));
    legend(&mut svg, layout.legend, &scene);
    for (panel, area) in panels(run, &motion).iter().zip(layout.panels) {
        panel.draw(&mut svg, area);
    }
    svg.finish()
}

/// Positions of the parts.
struct Layout {
    scene: Area,
    legend: Page,
    panels: [Area; 4],
    page_height: f64,
}

impl Layout {
    /// `aspect` is the ratio of width to height of the action, `top` the y coordinate below the header, px.
    fn new(aspect: f64, top: f64) -> Self {
        if aspect >= WIDE { Self::stacked(aspect, top) } else { Self::side_by_side(top) }
    }

    fn stacked(aspect: f64, top: f64) -> Self {
        let scene = Area { corner: (MARGIN, top), width: CONTENT, height: (CONTENT / aspect).clamp(150.0, 620.0) };
        let legend = top + scene.height + 8.0;
        let rows = legend + LEGEND + GAP;
        let (width, height) = ((CONTENT - GAP) / 2.0, 190.0);
        let panel = |(column, row): (f64, f64)| Area {
            corner: (MARGIN + column * (width + GAP), rows + row * (height + PANEL_GAP)),
            width,
            height,
        };
        Self {
            scene,
            legend: (MARGIN, legend),
            panels: [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(panel),
            page_height: rows + 2.0 * height + PANEL_GAP + MARGIN,
        }
    }

    fn side_by_side(top: f64) -> Self {
        const HEIGHT: f64 = 760.0;
        let scene = Area { corner: (MARGIN, top), width: 0.62 * CONTENT, height: HEIGHT };
        let (left, height) = (MARGIN + scene.width + GAP, (HEIGHT - 3.0 * PANEL_GAP) / 4.0);
        let width = CONTENT - scene.width - GAP;
        let panel = |i: f64| Area { corner: (left, top + i * (height + PANEL_GAP)), width, height };
        Self {
            scene,
            legend: (MARGIN, top + HEIGHT + 8.0),
            panels: [0.0, 1.0, 2.0, 3.0].map(panel),
            page_height: top + HEIGHT + LEGEND + 8.0 + MARGIN,
        }
    }
}

/// Title, outcome, verdict and failed checks.
struct Header {
    title: String,
    about: String,
    badge: (String, &'static str),
    failures: Vec<String>,
}

impl Header {
    fn of(run: &Run, driven: bool) -> Self {
        let outcome = run.outcome.name().replace('_', " ");
        let what = if driven { "driven in simulation" } else { "planned" };
        let (verdict, colour) = match (run.verdict.checks.is_empty(), run.verdict.pass()) {
            (true, _) => (outcome, style::FAINT_INK),
            (false, true) => (format!("{outcome} · PASS"), style::PASS),
            (false, false) => (format!("{outcome} · FAIL"), style::ALARM),
        };
        let failed: Vec<&Check> = run.verdict.failures().collect();
        let mut failures: Vec<String> = failed.iter().take(LISTED_FAILURES).map(|c| describe(c)).collect();
        if failed.len() > LISTED_FAILURES {
            failures.push(format!("and {} more", failed.len() - LISTED_FAILURES));
        }
        let reason = run.reason.map_or_else(String::new, |r| format!(" · {}", r.replace('_', " ")));
        let about = format!("{} · problem {} · {what}{reason}", run.vehicle.name, run.problem.id);
        Self { title: run.scenario.id.clone(), about, badge: (verdict, colour), failures }
    }

    fn height(&self) -> f64 {
        52.0 + 17.0 * self.failures.len() as f64
    }

    fn draw(&self, svg: &mut Svg) {
        let line = |y: f64, size: f64| Element::new("text").num("x", MARGIN).num("y", y).num("font-size", size);
        svg.group(&Element::new("g").with("id", "header"), |svg| {
            let title = line(MARGIN + 14.0, 20.0).with("font-weight", "700").with("fill", style::INK);
            svg.add_text(&title, &self.title);
            svg.add_text(&line(MARGIN + 35.0, 13.0).with("fill", style::FAINT_INK), &self.about);
            // the font is unknown: the badge fits a wide one
            let width = 9.0 * self.badge.0.chars().count() as f64 + 24.0;
            let corner = (PAGE_WIDTH - MARGIN - width, MARGIN - 2.0);
            svg.add(&Element::rect(corner, width, 28.0).num("rx", 14.0).with("fill", self.badge.1));
            let text = Element::new("text").num("x", corner.0 + 0.5 * width).num("y", corner.1 + 19.0);
            let text = text.num("font-size", 14.0).with("font-weight", "600").with("text-anchor", "middle");
            svg.add_text(&text.with("fill", style::PAPER), &self.badge.0);
            for (i, failure) in self.failures.iter().enumerate() {
                let text = line(MARGIN + 54.0 + 17.0 * i as f64, 12.5).with("fill", style::ALARM);
                svg.add_text(&text.with("class", "failure"), failure);
            }
        });
    }
}

/// A failed check in one line: its name and the event.
fn describe(check: &Check) -> String {
    let text = format!("{}: {}", check.name, check.note);
    shortened(&text, LINE_LENGTH)
}

/// Text of at most `length` characters, with an ellipsis if it was cut.
fn shortened(text: &str, length: usize) -> String {
    if text.chars().count() <= length {
        return text.into();
    }
    text.chars().take(length.saturating_sub(1)).chain(['…']).collect()
}

/// The code of the reason why a candidate was infeasible; `None` for a feasible one with a higher cost.
pub(crate) fn refusal(candidate: &Candidate) -> Option<&'static str> {
    candidate.rejected.filter(|why| why.is_refusal()).map(Rejection::code)
}

/// The smallest of 5, 10, 15, … that is at least the speed.
fn nice_ceiling(speed: f64) -> f64 {
    (speed / 5.0).ceil().max(1.0) * 5.0
}

fn legend(svg: &mut Svg, corner: Page, scene: &Scene) {
    let run = scene.run;
    let obstacles = &run.scenario.obstacles;
    let drive = if scene.motion.driven { "driven" } else { "planned" };
    let moving = |colour: &str| obstacles.iter().any(|o| !o.is_static() && scene::moving_colour(o) == colour);
    let entries = [
        (true, Mark::Line(style::DRIVEN, "", 1.8), format!("{drive} rear axle")),
        (!run.cycles.is_empty(), Mark::Line(style::PLAN, "", 1.2), "committed plans".into()),
        (
            run.cycles.iter().any(|c| !c.trace.candidates.is_empty()),
            Mark::Line(style::CANDIDATE, "", 1.0),
            "candidates".into(),
        ),
        (
            run.scenario.occupancy.is_some() || obstacles.iter().any(|o| o.is_static()),
            Mark::Box(style::STATIC, "1"),
            "static".into(),
        ),
        (moving(style::MOVING), Mark::Box(style::MOVING, "0.25"), "moving, every second".into()),
        (moving(style::VULNERABLE), Mark::Box(style::VULNERABLE, "0.25"), "pedestrian or bicycle".into()),
        (run.problem.goals.iter().any(|g| g.position.is_some()), Mark::Box(style::GOAL, "0.16"), "goal".into()),
    ];
    svg.group(&Element::new("g").with("id", "legend").num("font-size", 11.5).with("fill", style::FAINT_INK), |svg| {
        let mut x = corner.0 + speed_legend(svg, corner, scene.top_speed);
        let middle = corner.1 + 10.0;
        for (_, mark, text) in entries.iter().filter(|(present, _, _)| *present) {
            mark.draw(svg, (x, middle));
            svg.add_text(&Element::new("text").num("x", x + 26.0).num("y", middle + 4.0), text);
            x += 26.0 + 6.6 * text.chars().count() as f64 + 18.0;
        }
    });
}

/// A legend symbol.
enum Mark {
    Line(&'static str, &'static str, f64),
    Box(&'static str, &'static str),
}

impl Mark {
    fn draw(&self, svg: &mut Svg, (x, y): Page) {
        svg.add(&match self {
            Self::Line(colour, dash, width) => {
                let line = Element::line((x, y), (x + 20.0, y)).with("stroke", colour).num("stroke-width", *width);
                if dash.is_empty() { line } else { line.with("stroke-dasharray", dash) }
            }
            Self::Box(colour, opacity) => Element::rect((x, y - 5.0), 20.0, 10.0)
                .with("fill", colour)
                .with("fill-opacity", opacity)
                .with("stroke", colour),
        });
    }
}

/// The colour scale of the speed; returns its width.
fn speed_legend(svg: &mut Svg, (x, y): Page, top_speed: f64) -> f64 {
    const STEPS: u32 = 16;
    const STEP: f64 = 7.0;
    let middle = y + 10.0;
    svg.add_text(&Element::new("text").num("x", x).num("y", middle + 4.0), "speed 0");
    for i in 0..STEPS {
        let colour = style::hex(style::viridis(f64::from(i) / f64::from(STEPS - 1)));
        // slightly wider than the step: no hairlines
        let cell = Element::rect((x + 50.0 + STEP * f64::from(i), middle - 5.0), STEP + 0.5, 10.0);
        svg.add(&cell.with("fill", &colour));
    }
    let end = 50.5 + STEP * f64::from(STEPS) + 6.0;
    let text = format!("{top_speed:.0} m/s");
    svg.add_text(&Element::new("text").num("x", x + end).num("y", middle + 4.0), &text);
    end + 6.6 * text.chars().count() as f64 + 22.0
}

/// Label of the time axis.
const TIME: &str = "time, s";

/// Speed, accelerations and jerk over time.
fn panels(run: &Run, motion: &Motion) -> [Panel; 4] {
    let (from, to) = motion.time_range();
    let stopped = run.cycles.iter().map(|c| c.plan.trajectory.end_time()).fold(to, f64::max);
    let time = (from, stopped.clamp(to, to + TAIL));
    let comfort = &run.vehicle.comfort;
    let samples = motion.thinned(CURVE_STEP);
    let driven = |value: fn(&MotionSample) -> f64, width: f64| Curve {
        points: samples.iter().map(|s| (s.time, value(s))).collect(),
        colour: style::DRIVEN.into(),
        width,
        dash: "",
        class: "driven",
    };
    let reference = Curve {
        colour: style::REFERENCE.into(),
        class: "reference",
        dash: "6 3",
        ..driven(|s| s.reference_speed, 1.6)
    };
    let mut speeds = proof_tails(run);
    let mut speed_legend = vec![(if motion.driven { "driven" } else { "planned" }, style::DRIVEN)];
    let limits = limit_curve(run, &samples);
    let limited = !limits.is_empty();
    speeds.extend(limits);
    speeds.push(driven(|s| s.speed, 2.0));
    if motion.driven {
        speeds.push(reference);
        speed_legend.extend([("reference", style::REFERENCE), ("fallback stops", style::PLAN)]);
    }
    if limited {
        speed_legend.push(("limit", style::ALARM));
    }
    let limit = |value: f64, label: &'static str| LimitLine { value, label, colour: style::LIMIT };
    let fallback_limit =
        LimitLine { value: -comfort.aggressive_deceleration, label: "fallback limit", colour: style::ALARM };
    let jerk_limits = |side: f64| Curve {
        points: samples.iter().map(|s| (s.time, side * jerk_limit(comfort.jerk, s.speed))).collect(),
        colour: style::LIMIT.into(),
        width: 1.0,
        dash: "5 4",
        class: "limit",
    };
    let (accel, decel, side) = (comfort.acceleration, comfort.deceleration, comfort.lateral_acceleration);
    [
        Panel {
            title: "Speed, m/s",
            id: "speed",
            legend: speed_legend,
            curves: speeds,
            limits: vec![],
            x: time,
            axis: TIME,
            at_least: (0.0, 1.0),
        },
        Panel {
            title: "Acceleration, m/s²",
            id: "acceleration",
            legend: vec![],
            curves: vec![driven(|s| s.acceleration, 1.8)],
            limits: vec![limit(accel, "comfort"), limit(-decel, "comfort"), fallback_limit],
            x: time,
            axis: TIME,
            at_least: (-comfort.aggressive_deceleration, accel),
        },
        Panel {
            title: "Lateral acceleration, m/s²",
            id: "lateral-acceleration",
            legend: vec![],
            curves: vec![driven(|s| s.lateral_acceleration, 1.8)],
            limits: vec![limit(side, "comfort"), limit(-side, "comfort")],
            x: time,
            axis: TIME,
            at_least: (-side, side),
        },
        Panel {
            title: "Jerk, m/s³",
            id: "jerk",
            legend: vec![("comfort", style::LIMIT)],
            curves: vec![jerk_limits(1.0), jerk_limits(-1.0), driven(|s| s.jerk, 1.8)],
            limits: vec![],
            x: time,
            axis: TIME,
            at_least: (-comfort.jerk, comfort.jerk),
        },
    ]
}

/// The speed of each committed plan down to its stop, at most one per half second.
fn proof_tails(run: &Run) -> Vec<Curve> {
    let mut tails: Vec<Curve> = Vec::new();
    let mut next = f64::NEG_INFINITY;
    for cycle in run.cycles.iter().filter(|c| c.plan.time.is_finite()) {
        if cycle.plan.time < next {
            continue;
        }
        next = cycle.plan.time + 0.5 - 1e-9;
        let plan = &cycle.plan.trajectory;
        let points = steps(cycle.plan.time, plan).map(|t| (t, plan.at(t).speed)).collect();
        tails.push(Curve { points, colour: style::PLAN.into(), width: 0.8, dash: "", class: "proof" });
    }
    tails
}

/// Times of the run from `from` to the end of a plan: its knots and some in between, where speed may be quadratic.
fn steps(from: f64, plan: &Trajectory) -> impl Iterator<Item = f64> {
    const BETWEEN: u32 = 4;
    let later = plan.profile.knots().iter().map(|k| plan.start_time + k.time).filter(move |t| *t > from);
    let mut knots: Vec<f64> = std::iter::once(from).chain(later).collect();
    let last = knots.pop();
    let ends = knots.clone().into_iter().skip(1).chain(last);
    let between = knots
        .into_iter()
        .zip(ends)
        .flat_map(|(start, end)| (0..BETWEEN).map(move |i| start + (end - start) * f64::from(i) / f64::from(BETWEEN)));
    between.chain(last)
}

/// The posted speed limit along the driven path, in one piece per stretch with a limit.
fn limit_curve(run: &Run, samples: &[MotionSample]) -> Vec<Curve> {
    let mut pieces: Vec<Vec<(f64, f64)>> = vec![Vec::new()];
    for sample in samples {
        match (speed_limit_at(&run.scenario.network, &sample.pose), pieces.last_mut()) {
            (Some(limit), Some(piece)) => piece.push((sample.time, limit)),
            (None, Some(piece)) if !piece.is_empty() => pieces.push(Vec::new()),
            _ => {}
        }
    }
    pieces
        .into_iter()
        .filter(|points| points.len() > 1)
        .map(|points| Curve { points, colour: style::ALARM.into(), width: 1.0, dash: "5 4", class: "speed-limit" })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::example::{EAST, Example, NORTH};
    use super::*;
    use crate::geometry::Point;
    use crate::map::{Motion as ObstacleMotion, RoadNetwork};

    fn assert_sound(svg: &str) {
        let read = roxmltree::Document::parse(svg).expect("well-formed");
        // the class of a rejected candidate contains "inf" too
        let numbers = svg.replace(Rejection::CurveSpeedInfeasible.code(), "");
        assert!(!numbers.contains("NaN") && !numbers.contains("inf"), "{svg}");
        assert!(read.descendants().all(|n| n.tag_name().name() != "image" && n.attribute("href").is_none()));
        let mut ids: Vec<&str> = read.descendants().filter_map(|n| n.attribute("id")).collect();
        ids.sort_unstable();
        assert!(ids.windows(2).all(|w| w[0] != w[1]), "a duplicate id: {ids:?}");
    }

    #[test]
    fn the_picture_contains_every_part() {
        let example = Example::new();
        let svg = run_svg(&example.run());
        assert_sound(&svg);
        let read = roxmltree::Document::parse(&svg).unwrap();
        let ids: Vec<&str> = read.descendants().filter_map(|n| n.attribute("id")).collect();
        let parts = ["scene", "goal", "driven-path", "driven-footprints", "committed-plans", "candidates", "scale-bar"];
        let panels = ["speed", "acceleration", "lateral-acceleration", "jerk", "legend", "header", "stop-line-1"];
        let obstacles: Vec<String> = example.scenario.obstacles.iter().map(|o| format!("obstacle-{}", o.id)).collect();
        let lanelets = ["lanelet-1", "lanelet-2", "lanelet-3"];
        let expected = parts.into_iter().chain(panels).chain(lanelets).chain(obstacles.iter().map(String::as_str));
        for id in expected {
            assert!(ids.contains(&id), "{id} is missing in {ids:?}");
        }
        for class in ["driven", "reference", "proof", "speed-limit", "limit", "centre-line", "failure"] {
            assert!(read.descendants().any(|n| n.attribute("class") == Some(class)), "no {class}");
        }
    }

    #[test]
    fn the_same_run_gives_the_same_bytes() {
        let (a, b) = (Example::new(), Example::new());
        assert_eq!(run_svg(&a.run()), run_svg(&b.run()));
    }

    #[test]
    fn text_from_the_file_is_escaped() {
        let mut example = Example::new();
        example.scenario.id = "a<b>&\"c\" \u{1}".into();
        assert_sound(&run_svg(&example.run()));
    }

    #[test]
    fn a_single_cycle_shows_its_plan() {
        let example = Example::new();
        let mut run = example.run();
        run.cycles.truncate(1);
        run.log.samples.clear();
        run.verdict.checks.clear();
        let svg = run_svg(&run);
        assert_sound(&svg);
        assert!(svg.contains("planned"));
    }

    #[test]
    fn an_empty_run_gives_a_picture() {
        let mut example = Example::new();
        example.scenario.network = RoadNetwork::default();
        example.scenario.obstacles.clear();
        example.scenario.problems[0].goals.clear();
        let mut run = example.run();
        run.cycles.clear();
        run.log.samples.clear();
        assert_sound(&run_svg(&run));
    }

    #[test]
    fn invalid_numbers_never_reach_the_file() {
        let mut example = Example::new();
        example.scenario.problems[0].initial.centre.position = Point::new(f64::NAN, f64::NAN);
        for obstacle in &mut example.scenario.obstacles {
            if let ObstacleMotion::Static(pose) = &mut obstacle.motion {
                pose.position.x = f64::NAN;
            }
        }
        let mut run = example.run();
        run.log.samples[100].acceleration = f64::NAN;
        run.log.samples[200].pose.position.y = f64::INFINITY;
        run.verdict.checks[2].value = f64::NAN;
        run.verdict.checks[2].limit = f64::INFINITY;
        assert_sound(&run_svg(&run));
    }

    #[test]
    fn long_notes_are_cut_to_the_page() {
        let example = Example::new();
        let mut run = example.run();
        run.verdict.checks[2].note = "ä".repeat(500);
        let svg = run_svg(&run);
        let read = roxmltree::Document::parse(&svg).unwrap();
        let failure = read.descendants().find(|n| n.attribute("class") == Some("failure")).unwrap();
        let text = failure.text().unwrap();
        assert_eq!(text.chars().count(), LINE_LENGTH);
        assert!(text.ends_with('…'));
    }

    #[test]
    fn a_plan_is_shown_from_the_current_time_on() {
        let example = Example::new();
        let mut run = example.run();
        let old = run.cycles[0].plan.trajectory.clone();
        run.cycles.truncate(2);
        run.cycles[1].plan.trajectory = old;
        let tails = proof_tails(&run);
        assert_eq!(tails[1].points[0].0, run.cycles[1].plan.time);
        assert!(tails.iter().all(|t| t.points.windows(2).all(|w| w[0].0 < w[1].0)), "in order of time");
        assert!(tails.iter().all(|t| t.points[t.points.len() - 1].1 == 0.0), "down to the stop");
    }

    #[test]
    fn a_diagonal_road_is_shown_beside_the_panels() {
        let aspect = 1.0;
        let layout = Layout::new(aspect, 80.0);
        assert!(layout.panels[0].corner.0 > layout.scene.corner.0 + layout.scene.width);
        let layout = Layout::new(6.0, 80.0);
        assert!(layout.panels[0].corner.1 > layout.scene.corner.1 + layout.scene.height);
        assert!(layout.scene.height < 0.25 * layout.scene.width, "a narrow road gets a narrow view");
    }

    #[test]
    fn the_left_lane_is_drawn_above_the_right_one() {
        let example = Example::new();
        let svg = run_svg(&example.run());
        let read = roxmltree::Document::parse(&svg).unwrap();
        let first_y = |id: &str| -> f64 {
            let node = read.descendants().find(|n| n.attribute("id") == Some(id)).unwrap();
            let data = node.attribute("d").unwrap();
            data.trim_start_matches('M').split(['L', ' ']).nth(1).unwrap().parse().unwrap()
        };
        assert!(first_y("lanelet-2") < first_y("lanelet-1"), "the left lane is above the right one");
        assert!(first_y("lanelet-1") < first_y("lanelet-3"));
        assert!(!svg.contains(&format!("{EAST}")) && !svg.contains(&format!("{NORTH}")), "page coordinates only");
    }
}
