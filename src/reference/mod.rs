//! The reference line: a smoothed lane centre with its Frenet frame.
//!
//! # Construction
//!
//! The centre lines of a chain of lanelets are joined and resampled at equal steps, smoothed within the lane by a convex
//! program (`smooth`), and interpolated by a spline over arc length with continuous curvature and curvature rate
//! (`spline`). All computation is relative to the first point of the chain, so that UTM coordinates lose no accuracy.
//!
//! # Coordinates
//!
//! - The station `s` (m) is the arc length along the line from its first point.
//! - The offset `l` (m) is the signed distance from the line, positive to the left.
//! - The curvature κ (1/m) is positive where the line turns left. The parallel line at offset l has the curvature
//!   κ/(1 − κl).
//!
//! Beyond its ends the line continues straight (curvature 0). Evaluation is not limited there; projection reaches as far
//! as [`ReferenceSettings::extension`].
//!
//! [`ReferenceLine::project`] returns the coordinates of the nearest point of the line. They are unique, and the projection
//! is continuous, within the offsets of [`ReferenceLine::unique_offsets`]. [`ReferenceLine::project_state`] and
//! [`ReferenceLine::from_frenet_state`] convert whole states with speed, acceleration and curvature between
//! [`CartesianState`] and [`FrenetState`].
//!
//! # Weaknesses
//!
//! The curvature rate is that of an interpolating spline: between points it oscillates slightly more than at them. A curve
//! much tighter than the sampling step is rounded. If the smoothing program fails, the line runs through the unsmoothed
//! centre ([`ReferenceLine::is_smoothed`]).

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
use crate::geometry::steps::covering;
use crate::geometry::{Point, Pose, Vector};
use crate::map::{Lanelet, LaneletId, RoadNetwork};
pub use crate::settings::SettingsError;
use crate::settings::within;
use smooth::Freedom;
use spline::Spline;

/// Settings of the construction of reference lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceSettings {
    /// Distance between smoothed points, m. Half the distance takes twice the time.
    pub spacing: f64,
    /// Smoothing length λ, m: undulations shorter than about 2πλ are removed.
    pub smoothing_length: f64,
    /// Distance between the side of the vehicle and the lane bounds that smoothing keeps, m.
    pub margin: f64,
    /// Displacement to either side that smoothing may use even in lanes too narrow for the margin, m.
    pub min_freedom: f64,
    /// Length of the straight continuation beyond both ends, m.
    pub extension: f64,
}

impl Default for ReferenceSettings {
    fn default() -> Self {
        Self { spacing: 1.0, smoothing_length: 3.0, margin: 0.1, min_freedom: 0.2, extension: 50.0 }
    }
}

impl ReferenceSettings {
    /// Checks the range of every value.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        within("spacing", self.spacing, 0.05..=100.0, "m")?;
        within("smoothing_length", self.smoothing_length, 0.0..=1000.0, "m")?;
        within("margin", self.margin, 0.0..=100.0, "m")?;
        within("min_freedom", self.min_freedom, 0.0..=100.0, "m")?;
        within("extension", self.extension, 0.0..=1e6, "m")
    }
}

/// Why a reference line cannot be built.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ReferenceFailure {
    /// A setting is out of its range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The chain is empty.
    #[error("the chain has no lanelets")]
    Empty,
    /// The chain names a lanelet that the network does not have.
    #[error("lanelet {0} is not in the network")]
    UnknownLanelet(LaneletId),
    /// The joined centre lines are shorter than half a metre.
    #[error("the joined centre lines are shorter than 0.5 m")]
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

/// A smoothed lane centre with its Frenet frame. See the [module documentation](self).
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceLine {
    origin: Vector,
    curve: Spline,
    knots: Vec<Knot>,
    /// The lanelets of the chain with start station and speed limit, in order of stations.
    lanelets: Vec<Section>,
    extension: f64,
    smoothed: bool,
}

/// A knot of the curve, with data of the segment up to the next knot.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Knot {
    station: f64,
    point: Point,
    tangent: Vector,
    /// Upper bound of |κ| on the segment from this knot to the next one, 1/m.
    max_curvature: f64,
    /// Distance to the left lane bound, m.
    left: f64,
    /// Distance to the right lane bound, m.
    right: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Section {
    start: f64,
    id: LaneletId,
    speed_limit: Option<f64>,
}

/// Shortest chain, m.
const MIN_LENGTH: f64 = 0.5;
/// Minimum number of steps: third differences need several points.
const MIN_STEPS: usize = 5;
/// Where lanelets overlap by less than this, points that step back are dropped, m.
const STEP_BACK: f64 = 1.0;

impl ReferenceLine {
    /// Builds the line along a chain of lanelets, each a successor of the previous one, for a vehicle of the given width
    /// (m).
    ///
    /// # Errors
    /// See [`ReferenceFailure`].
    pub fn new(
        network: &RoadNetwork,
        chain: &[LaneletId],
        vehicle_width: f64,
        settings: &ReferenceSettings,
    ) -> Result<Self, ReferenceFailure> {
        settings.validate()?;
        let lanelets: Vec<&Lanelet> = chain
            .iter()
            .map(|id| network.lanelets.get(id).ok_or(ReferenceFailure::UnknownLanelet(*id)))
            .collect::<Result<_, _>>()?;
        let origin = lanelets.first().ok_or(ReferenceFailure::Empty)?.centre.first().coords;
        let centre = joined(&lanelets, origin, |l| &l.centre).ok_or(ReferenceFailure::TooShort)?;
        if centre.length() < MIN_LENGTH {
            return Err(ReferenceFailure::TooShort);
        }
        let (points, step) = resampled(&centre, settings.spacing);
        let left = joined(&lanelets, origin, |l| &l.left);
        let right = joined(&lanelets, origin, |l| &l.right);
        let bounds = Bounds { left: left.as_ref(), right: right.as_ref() };
        let widths = bounds.distances(&points);

        let free = |width: f64| (width - 0.5 * vehicle_width - settings.margin).max(settings.min_freedom);
        let freedom: Vec<Freedom> = widths.iter().map(|w| Freedom { left: free(w.0), right: free(w.1) }).collect();
        let normals = smooth::normals(&points);
        let smooth = smooth::smoothed(&points, &normals, &freedom, step, settings.smoothing_length);
        let smoothed = smooth.is_some();
        let points = smooth.unwrap_or(points);
        let curve = Spline::through(&points).ok_or(ReferenceFailure::TooShort)?;
        let widths = bounds.distances(&points);
        let knots = curve.stations().zip(&points).zip(widths);
        let knots = knots
            .map(|((station, point), (left, right))| {
                let tangent = curve.frame(station).tangent;
                let max_curvature = curve.max_curvature_after(station);
                Knot { station, point: *point, tangent, max_curvature, left, right }
            })
            .collect();
        let mut line = Self { origin, curve, knots, lanelets: Vec::new(), extension: settings.extension, smoothed };
        line.lanelets = line.sections(&lanelets);
        Ok(line)
    }

    /// Start stations of the lanelets: the feet of their first centre points, ascending.
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

    /// Length without the straight continuations, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.curve.length()
    }

    /// Whether smoothing succeeded; if not, the line runs through the unsmoothed lane centre.
    #[must_use]
    pub fn is_smoothed(&self) -> bool {
        self.smoothed
    }

    /// Pose, curvature and curvature rate at station `s` (m). Beyond the ends the line is straight, without limit.
    #[must_use]
    pub fn at(&self, s: f64) -> PathPoint {
        let mut point = self.curve.at(s);
        point.pose.position += self.origin;
        point
    }

    /// The point of the parallel line at station `s` and offset `l` (m): its heading is that of the reference line, its
    /// curvature κ/(1 − κl), its curvature rate (by the arc length of the parallel line) κ'/(1 − κl)³. `None` at and beyond
    /// the centre of curvature.
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

    /// Distances from the line to the left and the right lane bound at station `s`, m; negative if the line is outside.
    /// Beyond the ends, the values at the ends.
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

    /// The lanelet at station `s`; beyond the ends, the first or the last one.
    #[must_use]
    pub fn lanelet_at(&self, s: f64) -> Option<LaneletId> {
        self.section_at(s).map(|section| section.id)
    }

    /// Speed limit of the lanelet at station `s`, m/s; `None` without a limit.
    #[must_use]
    pub fn speed_limit(&self, s: f64) -> Option<f64> {
        self.section_at(s).and_then(|section| section.speed_limit)
    }

    /// The lanelets of the chain with their start stations (m), in order.
    pub fn lanelets(&self) -> impl Iterator<Item = (LaneletId, f64)> + '_ {
        self.lanelets.iter().map(|section| (section.id, section.start))
    }

    /// The knots of the line with their stations (m), about [`ReferenceSettings::spacing`] apart.
    pub fn points(&self) -> impl Iterator<Item = (f64, Point)> + '_ {
        self.knots.iter().map(|k| (k.station, k.point + self.origin))
    }
}

/// Joins one line of every lanelet, relative to the origin. Points that step back slightly against the direction of travel
/// (lanelets that overlap) are dropped.
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

/// Points at equal steps of at most `spacing`, and the step, m.
fn resampled(line: &Polyline, spacing: f64) -> (Vec<Point>, f64) {
    let steps = covering(line.length(), spacing).max(MIN_STEPS);
    let step = (line.length() / steps as f64).max(MIN_LENGTH / MIN_STEPS as f64);
    ((0..=steps).map(|i| line.at(step * i as f64)).collect(), step)
}

/// The lane bounds, joined over the chain.
struct Bounds<'a> {
    left: Option<&'a Polyline>,
    right: Option<&'a Polyline>,
}

impl Bounds<'_> {
    /// Distances of points to the left and the right bound, m, negative outside. The points must be in order of travel.
    fn distances(&self, points: &[Point]) -> Vec<(f64, f64)> {
        let left = self.left.map(|bound| offsets(bound, points));
        let right = self.right.map(|bound| offsets(bound, points));
        let at = |offsets: &Option<Vec<f64>>, i: usize| offsets.as_ref().map_or(0.0, |o| o[i]);
        (0..points.len()).map(|i| (-at(&left, i), at(&right, i))).collect()
    }
}

/// Signed offsets of a sequence of points from a line beside them. The search for each point starts near the foot of the
/// previous one.
fn offsets(line: &Polyline, points: &[Point]) -> Vec<f64> {
    /// Search range behind and ahead of the last foot, m: it covers the change between neighbouring points.
    const BEHIND: f64 = 5.0;
    const AHEAD: f64 = 15.0;
    // search the start only: the bound of a closed ring returns to this place
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

    /// The folder of published maps; prints a note and returns `None` if it does not exist.
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

    /// All readable scenarios, in order of their names.
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

    /// A straight, a left turn by 90° with the given radius in steps of half a metre, a straight.
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
    fn a_straight_road_has_a_straight_centred_line() {
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
        assert!((line.at(160.0).pose.position - Point::new(160.0, 0.0)).norm() < 1e-6, "not straight beyond the end");
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
    fn smooths_a_jagged_centre_and_preserves_a_long_curve() {
        let jagged: Vec<Point> =
            (0..80).map(|i| Point::new(f64::from(i), if i % 2 == 0 { 0.1 } else { -0.1 })).collect();
        let smooth = line(&lane_along(&jagged, UTM), &[1]);
        let worst = (0..700).map(|i| smooth.at(5.0 + f64::from(i) * 0.1).curvature.abs()).fold(0.0, f64::max);
        assert!(worst < 0.01, "curvature {worst} after smoothing");
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
    fn overlapping_lanelets_and_repeated_points_cause_no_curvature() {
        let mut network = two_lane_road(3);
        let step_back = |x: f64| Polyline::new([49.8, 49.8001, 70.0, 100.0].map(|p| Point::new(p, x))).unwrap();
        let middle = network.lanelets.get_mut(&101).unwrap();
        (middle.left, middle.right, middle.centre) = (step_back(1.75), step_back(-1.75), step_back(0.0));
        let line = line(&network, &[100, 101, 102]);
        assert!((line.length() - 150.0).abs() < 1e-6);
        assert!((0..1500).all(|i| line.at(f64::from(i) * 0.1).curvature.abs() < 1e-6));
    }

    #[test]
    fn accepts_short_chains_and_rejects_invalid_ones() {
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
    fn offset_poses_have_the_curvature_of_the_parallel_line() {
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
