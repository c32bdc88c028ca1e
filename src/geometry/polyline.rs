//! A chain of straight segments parametrised by arc length: lane bounds, centre lines, stop lines.
//!
//! Stations are arc lengths from the first point, in metres. Offsets are signed distances, positive to the left of the
//! direction of travel. Beyond its ends the line continues straight for evaluation ([`Polyline::at`]), but not for
//! projection ([`Polyline::project`]), which is limited to the segments.
//!
//! Weak: heading jumps at the corners, and near an inner corner the projection of a moving point jumps. Where a
//! continuous frame is needed, use [`crate::reference::ReferenceLine`].

use super::steps::covering;
use super::{Point, Vector, cross};

/// A polyline of at least two points, without zero-length segments.
#[derive(Debug, Clone, PartialEq)]
pub struct Polyline {
    points: Vec<Point>,
    /// Arc length from the first point to each point, m.
    stations: Vec<f64>,
}

/// Points nearer to each other than this count as one point, m: file coordinates resolve millimetres at best.
const SAME_POINT: f64 = 1e-6;

/// The projection of a point onto a polyline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Arc length of the foot point, m.
    pub station: f64,
    /// Signed distance, m, positive to the left.
    pub offset: f64,
    /// The foot point.
    pub foot: Point,
}

impl Polyline {
    /// Builds the polyline and drops repeated points. `None` if a coordinate is not finite or fewer than two distinct
    /// points remain.
    #[must_use]
    pub fn new(points: impl IntoIterator<Item = Point>) -> Option<Self> {
        let mut kept: Vec<Point> = Vec::new();
        let mut stations = Vec::new();
        let mut length = 0.0;
        for p in points {
            if !(p.x.is_finite() && p.y.is_finite()) {
                return None;
            }
            if let Some(last) = kept.last() {
                let step = (p - last).norm();
                if step < SAME_POINT {
                    continue;
                }
                length += step;
            }
            kept.push(p);
            stations.push(length);
        }
        (kept.len() >= 2).then_some(Self { points: kept, stations })
    }

    /// The points, at least two.
    #[must_use]
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Arc length of each point, m.
    #[must_use]
    pub fn stations(&self) -> &[f64] {
        &self.stations
    }

    /// Total length, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.stations[self.stations.len() - 1]
    }

    /// The first point.
    #[must_use]
    pub fn first(&self) -> Point {
        self.points[0]
    }

    /// The last point.
    #[must_use]
    pub fn last(&self) -> Point {
        self.points[self.points.len() - 1]
    }

    /// Index of the segment that contains `station`, clamped to the first and the last segment.
    fn segment_at(&self, station: f64) -> usize {
        let upper = self.stations.partition_point(|&s| s <= station);
        upper.clamp(1, self.points.len() - 1) - 1
    }

    /// The point at `station` (m); beyond the ends, on the straight continuation of the end segments.
    #[must_use]
    pub fn at(&self, station: f64) -> Point {
        let i = self.segment_at(station);
        self.points[i] + self.direction(i) * (station - self.stations[i])
    }

    /// Unit direction of segment `i`.
    fn direction(&self, i: usize) -> Vector {
        (self.points[i + 1] - self.points[i]) / (self.stations[i + 1] - self.stations[i])
    }

    /// Heading of the segment at `station` (m), rad.
    #[must_use]
    pub fn yaw_at(&self, station: f64) -> f64 {
        let d = self.direction(self.segment_at(station));
        d.y.atan2(d.x)
    }

    /// The nearest point of the polyline (ends included, not extended), with its signed offset. The first of several
    /// equally near points.
    #[must_use]
    pub fn project(&self, p: Point) -> Projection {
        self.project_between(p, f64::NEG_INFINITY, f64::INFINITY)
    }

    /// Like [`Self::project`], restricted to the segments that contain stations between `from` and `to`; at least one
    /// segment.
    #[must_use]
    pub fn project_between(&self, p: Point, from: f64, to: f64) -> Projection {
        /// Rounding of distances, m.
        const ROUNDING: f64 = 1e-6;
        let mut best = Projection { station: 0.0, offset: f64::INFINITY, foot: self.points[0] };
        let (mut i, last) = (self.segment_at(from), self.segment_at(to));
        while i <= last {
            let length = self.stations[i + 1] - self.stations[i];
            let direction = self.direction(i);
            let travelled = (p - self.points[i]).dot(&direction).clamp(0.0, length);
            let foot = self.points[i] + direction * travelled;
            let distance = (p - foot).norm();
            if distance < best.offset.abs() {
                let side = if cross(direction, p - self.points[i]) < 0.0 { -1.0 } else { 1.0 };
                best = Projection { station: self.stations[i] + travelled, offset: side * distance, foot };
            }
            // the distance to the line changes at most as fast as arc length: skip segments that cannot be nearer
            let nearer_from = self.stations[i + 1] + (p - self.points[i + 1]).norm() - best.offset.abs() - ROUNDING;
            i += 1;
            while i < last && self.stations[i + 1] < nearer_from {
                i += 1;
            }
        }
        best
    }

    /// The part between two stations (clamped to the ends). `None` if it has no length.
    #[must_use]
    pub fn slice(&self, from: f64, to: f64) -> Option<Self> {
        let (from, to) = (from.max(0.0), to.min(self.length()));
        if to <= from {
            return None;
        }
        let inner = self.points.iter().zip(&self.stations).filter(|(_, s)| **s > from && **s < to).map(|(p, _)| *p);
        Self::new(std::iter::once(self.at(from)).chain(inner).chain(std::iter::once(self.at(to))))
    }

    /// The same line in the opposite direction.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let total = self.length();
        Self {
            points: self.points.iter().rev().copied().collect(),
            stations: self.stations.iter().rev().map(|s| total - s).collect(),
        }
    }

    /// Points at equal steps of at most `spacing` metres, both ends included.
    #[must_use]
    pub fn resampled(&self, spacing: f64) -> Vec<Point> {
        let steps = covering(self.length(), spacing);
        (0..=steps).map(|i| self.at(self.length() * i as f64 / steps as f64)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner() -> Polyline {
        Polyline::new([Point::new(0.0, 0.0), Point::new(10.0, 0.0), Point::new(10.0, 0.0), Point::new(10.0, 5.0)])
            .unwrap()
    }

    #[test]
    fn drops_repeated_points_and_rejects_a_single_point() {
        assert_eq!(corner().points().len(), 3);
        assert_eq!(corner().length(), 15.0);
        assert!(Polyline::new([Point::new(1.0, 1.0), Point::new(1.0, 1.0)]).is_none());
        assert!(Polyline::new([Point::new(1.0, f64::NAN), Point::new(1.0, 1.0)]).is_none());
    }

    #[test]
    fn offsets_are_positive_to_the_left_and_stations_are_arc_lengths() {
        let p = corner().project(Point::new(4.0, 1.5));
        assert_eq!((p.station, p.offset), (4.0, 1.5));
        let p = corner().project(Point::new(4.0, -1.5));
        assert_eq!((p.station, p.offset), (4.0, -1.5));
        let p = corner().project(Point::new(9.0, 4.0));
        assert_eq!((p.station, p.offset), (14.0, 1.0));
    }

    #[test]
    fn skipped_segments_never_contain_the_foot_point() {
        // a winding line that comes near itself
        let at = |i: i32| {
            let a = 0.05 * f64::from(i);
            Point::new(10.0 * a.sin() + 3.0 * (2.3 * a).cos(), 8.0 * (1.3 * a).sin())
        };
        let line = Polyline::new((0..300).map(at)).unwrap();
        for k in 0..400 {
            let p = Point::new(0.07 * f64::from(k) - 14.0, 9.0 * (0.37 * f64::from(k)).sin());
            let projected = line.project(p);
            let nearest_segment = (line.points().windows(2))
                .map(|w| Polyline::new(w.iter().copied()).unwrap().project(p).offset.abs())
                .fold(f64::INFINITY, f64::min);
            assert!(
                (projected.offset.abs() - nearest_segment).abs() < 1e-12,
                "{} instead of {nearest_segment}",
                projected.offset
            );
        }
    }

    #[test]
    fn slice_keeps_inner_corners() {
        let s = corner().slice(8.0, 12.0).unwrap();
        assert_eq!(s.length(), 4.0);
        assert_eq!(s.points().len(), 3);
        assert_eq!(s.at(2.0), Point::new(10.0, 0.0));
        assert!(corner().slice(16.0, 20.0).is_none());
    }

    #[test]
    fn continues_straight_beyond_both_ends() {
        assert_eq!(corner().at(16.0), Point::new(10.0, 6.0));
        assert_eq!(corner().at(-1.0), Point::new(-1.0, 0.0));
    }
}
