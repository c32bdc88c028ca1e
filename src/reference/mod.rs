//! The reference line: a smoothed lane centre with its Frenet frame.
//!
//! The centre lines of a chain of lanelets are joined, resampled, smoothed by a convex program within the lane
//! (`smooth`), and carried by a curvature-continuous spline over arc length (`spline`). Stations `s` run along the line
//! from its first point, offsets `l` are positive to the left, curvature of the parallel line at offset l is
//! κ/(1 − κl). All computation is relative to the chain's first point, so that UTM coordinates lose nothing.
//!
//! Beyond its ends the line goes on straight for the settings' extension.
//!
//! Projection ([`ReferenceLine::project`]) finds the nearest point. Frenet coordinates are unique, and the projection
//! continuous, as far from the line as [`ReferenceLine::unique_offsets`] says, station by station. Whole states, with
//! speed, acceleration and curvature, are converted in [`CartesianState`] ⇄ [`FrenetState`].
//!
//! Curvature and its derivative are continuous. The derivative is that of an interpolating spline: between points it
//! swings a little more than at them. A bend much tighter than the sampling step is rounded.

mod frenet;
mod projection;
#[cfg(test)]
mod real;
mod smooth;
mod spline;

pub use frenet::{CartesianState, FrenetState};

use thiserror::Error;

use crate::geometry::polyline::Polyline;
use crate::geometry::spiral::PathPoint;
use crate::geometry::{Point, Pose, Vector};
use crate::map::{Lanelet, LaneletId, RoadNetwork};
use smooth::Freedom;
use spline::Spline;

/// How reference lines are built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceSettings {
    /// Distance between smoothed points, m. Halving it doubles the time.
    pub spacing: f64,
    /// Undulations shorter than about 2π times this are smoothed away, m.
    pub smoothing_length: f64,
    /// Distance kept between the vehicle's side and the lane's bounds when smoothing, m.
    pub margin: f64,
    /// Freedom to either side that smoothing has even in lanes too narrow for it, m.
    pub least_freedom: f64,
    /// Straight continuation beyond both ends, m.
    pub extension: f64,
}

impl Default for ReferenceSettings {
    fn default() -> Self {
        Self { spacing: 1.0, smoothing_length: 3.0, margin: 0.1, least_freedom: 0.2, extension: 50.0 }
    }
}

/// Why there is no reference line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum ReferenceFailure {
    /// The chain is empty.
    #[error("a chain of lanelets without any lanelet")]
    Empty,
    /// The chain names a lanelet that the network does not have.
    #[error("lanelet {0} is not in the network")]
    UnknownLanelet(LaneletId),
    /// The joined centre lines are shorter than half a metre.
    #[error("the joined centre lines are too short")]
    TooShort,
}

/// Frenet coordinates of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frenet {
    /// Station of the foot point, m.
    pub s: f64,
    /// Offset, m, positive to the left.
    pub l: f64,
}

/// The reference line.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceLine {
    origin: Vector,
    curve: Spline,
    knots: Vec<Knot>,
    /// Where each lanelet of the chain begins, with its speed limit; in order of stations.
    lanelets: Vec<Section>,
    extension: f64,
    smoothed: bool,
}

/// What is known at a knot of the curve, and of the piece of it up to the next knot.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Knot {
    station: f64,
    point: Point,
    tangent: Vector,
    /// Upper bound of |κ| on the piece behind it, 1/m.
    sharpest: f64,
    left: f64,
    right: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Section {
    start: f64,
    id: LaneletId,
    speed_limit: Option<f64>,
}

/// The shortest chain that makes a line, m.
const SHORTEST: f64 = 0.5;
/// Fewest steps of a line: a cubic spline and its third differences need some.
const FEWEST_STEPS: f64 = 5.0;
/// Where lanelets overlap by less than this, the points that step back are left out, m.
const STEP_BACK: f64 = 1.0;

impl ReferenceLine {
    /// The line along a chain of lanelets, each following the one before, for a vehicle of the given width (m).
    ///
    /// # Errors
    /// See [`ReferenceFailure`].
    pub fn new(
        network: &RoadNetwork,
        chain: &[LaneletId],
        vehicle_width: f64,
        settings: &ReferenceSettings,
    ) -> Result<Self, ReferenceFailure> {
        let lanelets: Vec<&Lanelet> = chain
            .iter()
            .map(|id| network.lanelets.get(id).ok_or(ReferenceFailure::UnknownLanelet(*id)))
            .collect::<Result<_, _>>()?;
        let origin = lanelets.first().ok_or(ReferenceFailure::Empty)?.centre.first().coords;
        let centre = joined(&lanelets, origin, |l| &l.centre).ok_or(ReferenceFailure::TooShort)?;
        if centre.length() < SHORTEST {
            return Err(ReferenceFailure::TooShort);
        }
        let (points, step) = resampled(&centre, settings.spacing);
        let left = joined(&lanelets, origin, |l| &l.left);
        let right = joined(&lanelets, origin, |l| &l.right);
        let bounds = Bounds { left: left.as_ref(), right: right.as_ref() };
        let widths = bounds.along(&points);

        let free = |width: f64| (width - 0.5 * vehicle_width - settings.margin).max(settings.least_freedom);
        let freedom: Vec<Freedom> = widths.iter().map(|w| Freedom { left: free(w.0), right: free(w.1) }).collect();
        let normals = smooth::normals(&points);
        let smooth = smooth::smoothed(&points, &normals, &freedom, step, settings.smoothing_length);
        let smoothed = smooth.is_some();
        let points = smooth.unwrap_or(points);
        let curve = Spline::through(&points).ok_or(ReferenceFailure::TooShort)?;
        let widths = bounds.along(&points);
        let knots = curve.stations().zip(&points).zip(widths);
        let knots = knots
            .map(|((station, point), (left, right))| {
                let tangent = curve.frame(station).tangent;
                Knot { station, point: *point, tangent, sharpest: curve.sharpest_behind(station), left, right }
            })
            .collect();
        let mut line = Self { origin, curve, knots, lanelets: Vec::new(), extension: settings.extension, smoothed };
        line.lanelets = line.sections(&lanelets);
        Ok(line)
    }

    /// Where the lanelets begin along the line: feet of their first centre points, in order.
    fn sections(&self, lanelets: &[&Lanelet]) -> Vec<Section> {
        let mut start = f64::NEG_INFINITY;
        let mut travelled = 0.0;
        lanelets
            .iter()
            .map(|lanelet| {
                let foot = if travelled == 0.0 { 0.0 } else { self.project_near(lanelet.centre.first(), travelled).s };
                travelled += lanelet.centre.length();
                start = foot.max(start);
                Section { start, id: lanelet.id, speed_limit: lanelet.speed_limit }
            })
            .collect()
    }

    /// Length, without the straight continuations, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.curve.length()
    }

    /// Whether the convex program succeeded; if not, the line runs through the lane's centre as it is.
    #[must_use]
    pub fn is_smoothed(&self) -> bool {
        self.smoothed
    }

    /// Pose, curvature and its derivative at station `s`. Beyond the ends straight on, however far.
    #[must_use]
    pub fn at(&self, s: f64) -> PathPoint {
        let mut point = self.curve.at(s);
        point.pose.position += self.origin;
        point
    }

    /// The point of the parallel line at offset `l`: its heading is that of the reference line, its curvature
    /// κ/(1 − κl), its curvature's derivative (by its own arc length) κ'/(1 − κl)³. `None` at and beyond the centre of
    /// curvature.
    #[must_use]
    pub fn offset_pose(&self, s: f64, l: f64) -> Option<PathPoint> {
        let on_line = self.at(s);
        let shrink = 1.0 - on_line.curvature * l;
        (shrink > 0.0).then(|| PathPoint {
            pose: Pose { position: on_line.pose.position + on_line.pose.left() * l, yaw: on_line.pose.yaw },
            curvature: on_line.curvature / shrink,
            curvature_rate: on_line.curvature_rate / shrink.powi(3),
        })
    }

    /// Distances from the line to the lane's own bounds at station `s`, left and right, m; negative if the line is
    /// outside. Beyond the ends, as at the ends.
    #[must_use]
    pub fn lane_bounds(&self, s: f64) -> (f64, f64) {
        let i = self.knots.partition_point(|k| k.station <= s).clamp(1, self.knots.len() - 1);
        let (before, after) = (&self.knots[i - 1], &self.knots[i]);
        let ratio = ((s - before.station) / (after.station - before.station)).clamp(0.0, 1.0);
        let mix = |a: f64, b: f64| a + (b - a) * ratio;
        (mix(before.left, after.left), mix(before.right, after.right))
    }

    fn section_at(&self, s: f64) -> Option<&Section> {
        let after = self.lanelets.partition_point(|section| section.start <= s);
        self.lanelets.get(after.max(1) - 1)
    }

    /// The lanelet at station `s`; beyond the ends, the first or last one.
    #[must_use]
    pub fn lanelet_at(&self, s: f64) -> Option<LaneletId> {
        self.section_at(s).map(|section| section.id)
    }

    /// Speed limit of the lanelet at station `s`, m/s.
    #[must_use]
    pub fn speed_limit(&self, s: f64) -> Option<f64> {
        self.section_at(s).and_then(|section| section.speed_limit)
    }

    /// The lanelets of the chain with the stations at which they begin, in order.
    pub fn lanelets(&self) -> impl Iterator<Item = (LaneletId, f64)> + '_ {
        self.lanelets.iter().map(|section| (section.id, section.start))
    }

    /// The points that carry the line, about every settings' spacing, with their stations: for pictures.
    pub fn points(&self) -> impl Iterator<Item = (f64, Point)> + '_ {
        self.knots.iter().map(|k| (k.station, k.point + self.origin))
    }
}

/// One kind of line of all lanelets, joined, relative to the origin. Points that step back against the direction of
/// travel by a little (lanelets that overlap) are left out.
fn joined(lanelets: &[&Lanelet], origin: Vector, line: impl Fn(&Lanelet) -> &Polyline) -> Option<Polyline> {
    let mut points: Vec<Point> = Vec::new();
    for lanelet in lanelets {
        for p in line(lanelet).points() {
            let p = p - origin;
            if let [.., before, last] = points.as_slice() {
                let step = p - last;
                if step.norm() < STEP_BACK && step.dot(&(last - before)) < 0.0 {
                    continue;
                }
            }
            points.push(p);
        }
    }
    Polyline::new(points)
}

/// Points at even steps of `spacing` at most, and the step between them, m.
fn resampled(line: &Polyline, spacing: f64) -> (Vec<Point>, f64) {
    /// Lengths that are whole numbers of steps but for rounding must not get one more, in steps.
    const WHOLE: f64 = 1e-6;
    let steps = (line.length() / spacing - WHOLE).ceil().max(FEWEST_STEPS);
    let step = (line.length() / steps).max(SHORTEST / FEWEST_STEPS);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a positive count of points
    ((0..=steps as usize).map(|i| line.at(step * i as f64)).collect(), step)
}

/// The lane's bounds, joined over the chain.
struct Bounds<'a> {
    left: Option<&'a Polyline>,
    right: Option<&'a Polyline>,
}

impl Bounds<'_> {
    /// Distances of points along the lane to its left and right bound, m, negative outside.
    fn along(&self, points: &[Point]) -> Vec<(f64, f64)> {
        let left = self.left.map(|bound| offsets(bound, points));
        let right = self.right.map(|bound| offsets(bound, points));
        let at = |offsets: &Option<Vec<f64>>, i: usize| offsets.as_ref().map_or(0.0, |o| o[i]);
        (0..points.len()).map(|i| (-at(&left, i), at(&right, i))).collect()
    }
}

/// Signed offsets of a row of points from a line that runs beside them: the search for each point starts near the foot
/// of the one before.
fn offsets(line: &Polyline, points: &[Point]) -> Vec<f64> {
    /// Search behind and ahead of the last foot, m: lanes widen and bend between neighbouring points by less.
    const BEHIND: f64 = 5.0;
    const AHEAD: f64 = 15.0;
    // both begin together; where a chain closes a ring its bound comes back to this place
    let mut station = line.project_between(points[0], 0.0, AHEAD).station;
    points
        .iter()
        .map(|p| {
            let foot = line.project_between(*p, station - BEHIND, station + AHEAD);
            station = foot.station;
            foot.offset
        })
        .collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::fixtures::{lanelet, network, two_lane_road};
    use crate::map::{Lanelet, Scenario};
    use std::path::{Path, PathBuf};

    /// The folder of real files, if it is there; says so if not.
    pub(crate) fn real_data(kind: &str) -> Option<PathBuf> {
        let root = std::env::var_os("STOPLINE_DATA")
            .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
        let folder = root.join(kind);
        if !folder.is_dir() {
            println!("skipped: no {kind} files (set STOPLINE_DATA)");
            return None;
        }
        Some(folder)
    }

    /// All scenarios that can be read, in order of their names.
    pub(crate) fn real_scenarios(folder: &Path) -> Vec<(String, Scenario)> {
        let mut paths: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
        paths.retain(|p| p.extension().is_some_and(|e| e == "xml"));
        paths.sort();
        let name = |p: &Path| p.file_stem().unwrap().to_string_lossy().into_owned();
        paths.iter().filter_map(|p| crate::io::commonroad::read_file(p).ok().map(|s| (name(p), s))).collect()
    }
    pub(super) const WIDTH: f64 = 1.8;

    pub(super) fn line(network: &RoadNetwork, chain: &[LaneletId]) -> ReferenceLine {
        ReferenceLine::new(network, chain, WIDTH, &ReferenceSettings::default()).unwrap()
    }

    /// A lane 3.5 m wide along a chain of centre points, far from the origin.
    pub(super) fn lane_along(points: &[Point], origin: Vector) -> RoadNetwork {
        let normals = smooth::normals(points);
        let side =
            |offset: f64| Polyline::new(points.iter().zip(&normals).map(|(p, n)| p + n * offset + origin)).unwrap();
        network([Lanelet { centre: side(0.0), ..lanelet(1, side(-1.75), side(1.75)) }])
    }

    /// Straight, a left turn by 90° with the given radius in steps of half a metre, straight.
    pub(super) fn turn(radius: f64) -> Vec<Point> {
        let arc = radius * std::f64::consts::FRAC_PI_2;
        let on_arc = |s: f64| {
            let a = s / radius;
            Point::new(30.0 + radius * a.sin(), radius * (1.0 - a.cos()))
        };
        let steps = (2.0 * arc).ceil();
        let before = (0..15).map(|i| Point::new(2.0 * f64::from(i), 0.0));
        let within = (0..=steps as i32).map(|i| on_arc(arc * f64::from(i) / steps));
        let after = (1..15).map(|i| Point::new(30.0 + radius, radius + 2.0 * f64::from(i)));
        before.chain(within).chain(after).collect()
    }

    pub(super) const UTM: Vector = Vector::new(6.9e5, 5.3e6);

    #[test]
    fn straight_road_stays_straight_and_in_the_middle() {
        let line = line(&two_lane_road(3), &[100, 101, 102]);
        assert!((line.length() - 150.0).abs() < 1e-6);
        let p = line.at(77.7);
        assert!((p.pose.position - Point::new(77.7, 0.0)).norm() < 1e-6);
        assert!(p.pose.yaw.abs() < 1e-9 && p.curvature.abs() < 1e-9);
        let (left, right) = line.lane_bounds(60.0);
        assert!((left - 1.75).abs() < 1e-6 && (right - 1.75).abs() < 1e-6);
        assert_eq!(
            (line.lanelet_at(-5.0), line.lanelet_at(49.0), line.lanelet_at(51.0)),
            (Some(100), Some(100), Some(101))
        );
        assert!((line.at(160.0).pose.position - Point::new(160.0, 0.0)).norm() < 1e-6, "straight beyond the end");
        assert!((line.project(Point::new(-3.0, 1.0)).s + 3.0).abs() < 1e-6);
    }

    #[test]
    fn a_junction_turn_is_drivable_and_inside_the_lane() {
        for radius in [6.0, 10.0, 25.0] {
            let line = line(&lane_along(&turn(radius), UTM), &[1]);
            assert!(line.is_smoothed());
            let samples: Vec<f64> = (0..=(line.length() / 0.1) as i32).map(|i| f64::from(i) * 0.1).collect();
            let worst = samples.iter().map(|s| line.at(*s).curvature.abs()).fold(0.0, f64::max);
            assert!(worst < 1.1 / radius, "curvature {worst} for radius {radius}");
            for s in &samples {
                let (left, right) = line.lane_bounds(*s);
                assert!(left.min(right) > WIDTH / 2.0 + 0.05, "{left} {right} at {s} of radius {radius}");
            }
        }
    }

    #[test]
    fn jagged_centre_is_smoothed_and_a_long_bend_is_kept() {
        let jagged: Vec<Point> =
            (0..80).map(|i| Point::new(f64::from(i), if i % 2 == 0 { 0.1 } else { -0.1 })).collect();
        let smooth = line(&lane_along(&jagged, UTM), &[1]);
        let worst = (0..700).map(|i| smooth.at(5.0 + f64::from(i) * 0.1).curvature.abs()).fold(0.0, f64::max);
        assert!(worst < 0.01, "curvature {worst} left of the jags");
        let bend: Vec<Point> = (0..80)
            .map(|i| {
                let a = f64::from(i) / 50.0;
                Point::new(50.0 * a.sin(), 50.0 * (1.0 - a.cos()))
            })
            .collect();
        let bend = line(&lane_along(&bend, UTM), &[1]);
        for i in 0..79 {
            let p = bend.at(f64::from(i));
            assert!((p.curvature - 0.02).abs() < 1e-3, "{} at {i}", p.curvature);
        }
    }

    #[test]
    fn lanelets_that_overlap_or_repeat_points_make_no_kink() {
        let mut network = two_lane_road(3);
        let step_back = |x: f64| Polyline::new([49.8, 49.8001, 70.0, 100.0].map(|p| Point::new(p, x))).unwrap();
        let middle = network.lanelets.get_mut(&101).unwrap();
        (middle.left, middle.right, middle.centre) = (step_back(1.75), step_back(-1.75), step_back(0.0));
        let line = line(&network, &[100, 101, 102]);
        assert!((line.length() - 150.0).abs() < 1e-6);
        assert!((0..1500).all(|i| line.at(f64::from(i) * 0.1).curvature.abs() < 1e-6));
    }

    #[test]
    fn short_chains_and_bad_chains_have_an_answer() {
        let network = lane_along(&[Point::new(0.0, 0.0), Point::new(1.0, 0.2), Point::new(2.0, 0.3)], UTM);
        assert!((line(&network, &[1]).length() - 2.03).abs() < 0.02);
        let settings = ReferenceSettings::default();
        let new = |network: &RoadNetwork, chain: &[LaneletId]| ReferenceLine::new(network, chain, WIDTH, &settings);
        assert_eq!(new(&network, &[]), Err(ReferenceFailure::Empty));
        assert_eq!(new(&network, &[1, 7]), Err(ReferenceFailure::UnknownLanelet(7)));
        let tiny = lane_along(&[Point::new(0.0, 0.0), Point::new(0.1, 0.0)], UTM);
        assert_eq!(new(&tiny, &[1]), Err(ReferenceFailure::TooShort));
    }

    #[test]
    fn offset_lines_have_their_own_curvature() {
        let line = line(&lane_along(&turn(10.0), Vector::zeros()), &[1]);
        let (s, h, l) = (37.0, 1e-3, 2.0);
        let at = |s: f64| line.offset_pose(s, l).unwrap();
        let (before, here, after) = (at(s - h), at(s), at(s + h));
        let travelled = (after.pose.position - before.pose.position).norm();
        assert!(((after.pose.yaw - before.pose.yaw) / travelled - here.curvature).abs() < 1e-4);
        assert!((here.curvature_rate - (after.curvature - before.curvature) / travelled).abs() < 1e-3);
        assert!(line.offset_pose(s, 20.0).is_none(), "beyond the centre of curvature");
    }
}
