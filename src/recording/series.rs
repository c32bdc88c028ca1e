//! Values over time, as columns, and the station–time diagram of each planning cycle.

use rerun::{LineStrips2D, Points2D, Scalars, SeriesLines, TimeColumn};

use super::shapes::{HATCH_RADIUS, hatch};
use super::style::{Rgb, metres, pixels};
use super::{Context, RecordingError, TIMELINE};
use crate::geometry::Point;
use crate::planner::{BlockedCell, Cycle, Decision};
use crate::plot::axes::nice_step;
use crate::plot::motion::{MotionSample, speed_limit_at};
use crate::verdict::jerk_limit;

const DRIVEN: Rgb = (92, 170, 255);
const REFERENCE: Rgb = (255, 190, 70);
const LIMIT: Rgb = (214, 96, 96);
const COMFORT: Rgb = (150, 130, 90);
const AXIS: Rgb = (110, 120, 130);
const GRID: Rgb = (44, 50, 58);
const BLOCKED: Rgb = (150, 52, 52);
const BLOCKED_EDGE: Rgb = (214, 92, 84);
const PLAN: Rgb = (92, 224, 255);

/// Smallest time between points of a curve, s.
const STEP: f64 = 0.01;
/// Width of the station–time diagram, as a multiple of its height.
const ASPECT: f64 = 1.7;
/// Longest time span of the station–time diagram, s: a plan may creep to its stop for a minute.
const MAX_TIME_SPAN: f64 = 15.0;
/// Maximum number of filled cells per station–time diagram; further ones are hollow.
const FILLED_CELLS: usize = 60;

/// Logs everything under `series` and `st`.
pub(super) fn log(context: &Context) -> Result<(), RecordingError> {
    let samples = context.motion.thinned(STEP);
    let driven = if context.motion.driven { "driven" } else { "planned" };
    let curve = |entity: &str, name: &str, look: (Rgb, f32), value: &dyn Fn(&MotionSample) -> f64| {
        let points: Vec<(f64, f64)> = samples.iter().map(|s| (s.time, value(s))).collect();
        send(context, &format!("series/{entity}"), name, look, &points)
    };
    curve("speed/driven", driven, (DRIVEN, 2.0), &|s| s.speed)?;
    curve("acceleration/driven", driven, (DRIVEN, 2.0), &|s| s.acceleration)?;
    curve("jerk/driven", driven, (DRIVEN, 1.5), &|s| s.jerk)?;
    curve("lateral_acceleration/driven", driven, (DRIVEN, 2.0), &|s| s.lateral_acceleration)?;
    let jerk = context.run.vehicle.comfort.jerk;
    curve("jerk/comfort_max", "comfort", (COMFORT, 1.0), &|s| jerk_limit(jerk, s.speed))?;
    curve("jerk/comfort_min", "comfort, negative", (COMFORT, 1.0), &|s| -jerk_limit(jerk, s.speed))?;
    curve("steering/driven", driven, (DRIVEN, 2.0), &|s| s.steering.to_degrees())?;
    if context.motion.driven {
        curve("speed/reference", "reference", (REFERENCE, 1.2), &|s| s.reference_speed)?;
        curve("steering/command", "command", (REFERENCE, 1.2), &|s| s.reference_steering.to_degrees())?;
    }
    let network = &context.run.scenario.network;
    let limits: Vec<(f64, f64)> = (context.motion.thinned(0.1).iter())
        .filter_map(|s| Some((s.time, speed_limit_at(network, &s.pose)?)))
        .collect();
    send(context, "series/speed/limit", "limit", (LIMIT, 1.2), &limits)?;
    log_comfort(context)?;
    log_station_time(context)
}

/// Horizontal lines at the comfort limits and the fallback limit.
fn log_comfort(context: &Context) -> Result<(), RecordingError> {
    let comfort = &context.run.vehicle.comfort;
    let (from, to) = context.motion.time_range();
    let levels = [
        ("series/acceleration/comfort_max", "comfort", COMFORT, comfort.acceleration),
        ("series/acceleration/comfort_min", "comfort, braking", COMFORT, -comfort.deceleration),
        ("series/acceleration/fallback", "fallback limit", LIMIT, -comfort.aggressive_deceleration),
        ("series/lateral_acceleration/comfort_left", "comfort, left", COMFORT, comfort.lateral_acceleration),
        ("series/lateral_acceleration/comfort_right", "comfort, right", COMFORT, -comfort.lateral_acceleration),
    ];
    levels.iter().filter(|_| to > from).try_for_each(|(entity, name, colour, level)| {
        send(context, entity, name, (*colour, 1.0), &[(from, *level), (to, *level)])
    })
}

/// Sends a curve as two columns, with its name and style; sends nothing without points.
fn send(
    context: &Context,
    entity: &str,
    name: &str,
    look: (Rgb, f32),
    points: &[(f64, f64)],
) -> Result<(), RecordingError> {
    let finite: Vec<(f64, f64)> = points.iter().filter(|p| p.0.is_finite() && p.1.is_finite()).copied().collect();
    if finite.is_empty() {
        return Ok(());
    }
    let line = SeriesLines::new().with_names([name]).with_colors([look.0]).with_widths([look.1]);
    context.log_static(entity, &line)?;
    let times = TimeColumn::new_duration_secs(TIMELINE, finite.iter().map(|p| p.0));
    let values =
        Scalars::new(finite.iter().map(|p| p.1)).columns_of_unit_batches().map_err(RecordingError::encoding)?;
    context.stream.send_columns(entity, [times], values).map_err(RecordingError::encoding)
}

/// Vertical range of each plot, by entity: wide enough that noise about a constant does not fill the plot.
pub(super) fn ranges(context: &Context) -> [(&'static str, [f64; 2]); 5] {
    let comfort = &context.run.vehicle.comfort;
    let samples = &context.motion.samples;
    let around = |value: fn(&MotionSample) -> f64, low: f64, high: f64| {
        let (low, high) = samples.iter().map(value).fold((low, high), |(low, high), v| (low.min(v), high.max(v)));
        let margin = 0.08 * (high - low);
        [if low < 0.0 { low - margin } else { low }, high + margin]
    };
    let limits = samples.iter().step_by(10).filter_map(|s| speed_limit_at(&context.run.scenario.network, &s.pose));
    let (side, jerk) = (comfort.lateral_acceleration, 2.0 * comfort.jerk);
    [
        ("speed", around(|s| s.speed.max(s.reference_speed), 0.0, limits.fold(1.0, f64::max))),
        ("acceleration", around(|s| s.acceleration, -comfort.aggressive_deceleration, comfort.acceleration)),
        ("jerk", around(|s| s.jerk, -jerk, jerk)),
        ("lateral_acceleration", around(|s| s.lateral_acceleration, -side, side)),
        ("steering", around(|s| s.steering.to_degrees(), -2.0, 2.0)),
    ]
}

/// Extent of the station–time diagrams: seconds and metres ahead, over all cycles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StationTime {
    /// Seconds after the cycle.
    pub(super) seconds: f64,
    /// Metres ahead of the vehicle.
    pub(super) metres: f64,
}

impl StationTime {
    /// The extent that contains every committed plan with a margin, at least 4 s and 20 m.
    pub(super) fn of(cycles: &[Cycle]) -> Self {
        let least = Self { seconds: 4.0, metres: 20.0 };
        cycles.iter().fold(least, |extent, cycle| {
            let plan = &cycle.plan.trajectory;
            let ahead = plan.profile.last().station - plan.at(cycle.plan.time).station;
            Self {
                // `max` drops what is not a number
                seconds: extent.seconds.max(plan.end_time() - cycle.plan.time + 0.5).min(MAX_TIME_SPAN),
                metres: extent.metres.max(1.15 * ahead + 5.0).min(2000.0),
            }
        })
    }

    /// Position of a time and station in the diagram: time to the right, stations up (y is down in the viewer).
    fn place(&self, time: f64, station: f64) -> Point {
        Point::new(ASPECT * self.metres * time / self.seconds, -station)
    }

    /// The visible box, x and y.
    pub(super) fn view(&self) -> ([f64; 2], [f64; 2]) {
        ([-0.25 * self.metres, (ASPECT + 0.1) * self.metres], [-1.06 * self.metres, 0.14 * self.metres])
    }

    fn clamped(&self, time: f64, station: f64) -> Point {
        self.place(time.clamp(0.0, self.seconds), station.clamp(0.0, self.metres))
    }
}

#[allow(clippy::cast_possible_truncation)] // diagrams of some hundred metres
fn flat(points: &[Point]) -> Vec<[f32; 2]> {
    points.iter().filter(|p| p.x.is_finite() && p.y.is_finite()).map(|p| [p.x as f32, p.y as f32]).collect()
}

fn log_station_time(context: &Context) -> Result<(), RecordingError> {
    let extent = StationTime::of(&context.run.cycles);
    log_axes(context, &extent)?;
    // where the plan continues without a search, its blocked cells are those of the last one
    let mut blocked: &[BlockedCell] = &[];
    for cycle in &context.run.cycles {
        context.set_time(cycle.plan.time);
        if cycle.plan.decision != Decision::Continue {
            blocked = &cycle.trace.blocked;
        }
        let plan = &cycle.plan.trajectory;
        let now = plan.at(cycle.plan.time).station;
        let steps = (extent.seconds / 0.1).ceil();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most 1200
        let curve: Vec<Point> = (0..=steps as usize)
            .map(|i| extent.seconds * i as f64 / steps)
            .map(|t| extent.place(t, plan.at(cycle.plan.time + t).station - now))
            .collect();
        let line = LineStrips2D::new([flat(&curve)]).with_colors([PLAN]).with_radii([pixels(1.5)]);
        context.log("st/plan", &line.with_draw_order(10.0))?;
        let cells: Vec<[Point; 4]> = blocked.iter().filter_map(|cell| corners(&extent, cycle, now, cell)).collect();
        let ring = |c: &[Point; 4]| flat(&[c[0], c[1], c[2], c[3], c[0]]);
        let edges = LineStrips2D::new(cells.iter().map(ring)).with_colors([BLOCKED_EDGE]);
        context.log("st/blocked", &edges.with_radii([pixels(0.5)]).with_draw_order(6.0))?;
        let filled = cells.iter().take(FILLED_CELLS).flat_map(|c| hatch(c)).map(|stroke| flat(&stroke));
        let fill = LineStrips2D::new(filled).with_colors([BLOCKED]).with_radii([metres(HATCH_RADIUS)]);
        context.log("st/blocked/fill", &fill.with_draw_order(5.0))?;
    }
    Ok(())
}

/// Corners of a blocked cell; `None` if it is outside the diagram.
fn corners(
    extent: &StationTime,
    cycle: &Cycle,
    now: f64,
    &BlockedCell { stations: (near, far), times: (from, to), .. }: &BlockedCell,
) -> Option<[Point; 4]> {
    let low = extent.clamped(from - cycle.plan.time, near - now);
    let high = extent.clamped(to - cycle.plan.time, far - now);
    let is_visible = high.x > low.x && low.y > high.y;
    is_visible.then_some([low, Point::new(high.x, low.y), high, Point::new(low.x, high.y)])
}

fn log_axes(context: &Context, extent: &StationTime) -> Result<(), RecordingError> {
    let (second, metre) = (nice_step(extent.seconds / 6.0), nice_step(extent.metres / 5.0));
    let steps = |end: f64, step: f64| {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most 200
        let count = (end / step + 1e-9).floor() as u32;
        (0..=count).map(move |i| step * f64::from(i))
    };
    let vertical = steps(extent.seconds, second).map(|t| [extent.place(t, 0.0), extent.place(t, extent.metres)]);
    let horizontal = steps(extent.metres, metre).map(|s| [extent.place(0.0, s), extent.place(extent.seconds, s)]);
    let grid = LineStrips2D::new(vertical.chain(horizontal).map(|line| flat(&line))).with_colors([GRID]);
    context.log_static("st/grid", &grid.with_radii([pixels(0.5)]).with_draw_order(0.0))?;
    let times = steps(extent.seconds, second).skip(1).map(|t| (extent.place(t, 0.0), format!("{t:.0} s")));
    let stations = steps(extent.metres, metre).skip(1).map(|s| (extent.place(0.0, s), format!("{s:.0} m")));
    let (places, labels): (Vec<Point>, Vec<String>) = times.chain(stations).unzip();
    let ticks = Points2D::new(flat(&places)).with_labels(labels).with_show_labels(true).with_colors([AXIS]);
    context.log_static("st/ticks", &ticks.with_radii([pixels(1.0)]).with_draw_order(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::example::Example;

    #[test]
    fn the_station_time_diagram_contains_every_plan() {
        let example = Example::new();
        let run = example.run();
        let extent = StationTime::of(&run.cycles);
        for cycle in &run.cycles {
            let plan = &cycle.plan.trajectory;
            assert!(plan.end_time() - cycle.plan.time < extent.seconds);
            assert!(plan.profile.last().station - plan.at(cycle.plan.time).station < extent.metres);
        }
        let (x, y) = extent.view();
        let corner = extent.place(extent.seconds, extent.metres);
        assert!(x[0] < 0.0 && corner.x < x[1] && y[0] < corner.y && 0.0 < y[1]);
        assert_eq!(StationTime::of(&[]), StationTime { seconds: 4.0, metres: 20.0 });
    }

    #[test]
    fn blocked_cells_are_clipped_to_the_diagram() {
        let example = Example::new();
        let run = example.run();
        let (extent, cycle) = (StationTime::of(&run.cycles), &run.cycles[0]);
        let now = cycle.plan.trajectory.at(cycle.plan.time).station;
        let cell_of = |stations, times| BlockedCell { stations, times, obstacle: 1 };
        let unlimited = cell_of((now + 5.0, f64::INFINITY), (cycle.plan.time + 1.0, f64::INFINITY));
        let cell = corners(&extent, cycle, now, &unlimited).unwrap();
        assert_eq!(cell[0], extent.place(1.0, 5.0));
        assert_eq!(cell[2], extent.place(extent.seconds, extent.metres));
        let past = cell_of((now + 5.0, now + 9.0), (cycle.plan.time - 2.0, cycle.plan.time - 1.0));
        assert_eq!(corners(&extent, cycle, now, &past), None);
        let behind = cell_of((now - 9.0, now - 5.0), (cycle.plan.time, cycle.plan.time + 1.0));
        assert_eq!(corners(&extent, cycle, now, &behind), None);
    }
}
