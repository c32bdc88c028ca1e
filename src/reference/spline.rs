//! A curvature-continuous curve through points, by arc length.
//!
//! A cubic spline (C²) over the chord length gives position, tangent and curvature. Its own parameter t is not arc
//! length; in each segment t is a quintic polynomial of arc length that matches t, dt/ds and d²t/ds² at both ends, with
//! the segments' lengths by Gauss–Legendre quadrature. So evaluation is explicit, curvature is exact for the curve (it
//! does not depend on the parameter), and the speed |dP/ds| is 1 to about 1e-6 between knots and exactly at them.

use crate::geometry::quadrature::GAUSS_5;
use crate::geometry::spiral::PathPoint;
use crate::geometry::{Point, Pose, Vector, cross};

/// The curve. At least one segment.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spline {
    segments: Vec<Segment>,
    length: f64,
}

/// Position, unit tangent and curvature of the curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TangentFrame {
    pub(super) position: Point,
    pub(super) tangent: Vector,
    pub(super) curvature: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Segment {
    /// Arc length at the start, m.
    station: f64,
    /// Arc length of the segment, m.
    length: f64,
    /// Position by powers of the spline parameter from the segment's start.
    position: [Vector; 4],
    /// Spline parameter by powers of s/length.
    parameter: [f64; 6],
}

impl Spline {
    /// The curve through at least two points, no two neighbours equal.
    pub(super) fn through(points: &[Point]) -> Option<Self> {
        let steps: Vec<f64> = points.windows(2).map(|w| (w[1] - w[0]).norm()).collect();
        if steps.is_empty() || steps.iter().any(|h| !(h.is_finite() && *h > 1e-9)) {
            return None;
        }
        let bends = second_derivatives(points, &steps);
        let mut segments = Vec::with_capacity(steps.len());
        let mut station = 0.0;
        for (i, h) in steps.iter().enumerate() {
            let chord = points[i + 1] - points[i];
            let (bend, next) = (bends[i], bends[i + 1]);
            let position = [
                points[i].coords,
                chord / *h - (bend * 2.0 + next) * (*h / 6.0),
                bend / 2.0,
                (next - bend) / (6.0 * *h),
            ];
            let segment = Segment::new(station, *h, position);
            station += segment.length;
            segments.push(segment);
        }
        Some(Self { segments, length: station })
    }

    /// Arc length, m.
    pub(super) fn length(&self) -> f64 {
        self.length
    }

    /// Arc length at each of the points it runs through.
    pub(super) fn stations(&self) -> impl Iterator<Item = f64> + '_ {
        self.segments.iter().map(|s| s.station).chain(std::iter::once(self.length))
    }

    /// The same as [`Self::at`] without angles, for searches.
    pub(super) fn frame(&self, s: f64) -> TangentFrame {
        let inside = s.clamp(0.0, self.length);
        let i = self.segments.partition_point(|g| g.station <= inside).max(1) - 1;
        let mut frame = self.segments[i].frame(inside - self.segments[i].station);
        if s != inside {
            frame.position += frame.tangent * (s - inside);
            frame.curvature = 0.0;
        }
        frame
    }

    /// Position and curvature at arc length `s`; straight beyond the ends.
    pub(super) fn at(&self, s: f64) -> PathPoint {
        let inside = s.clamp(0.0, self.length);
        let i = self.segments.partition_point(|g| g.station <= inside).max(1) - 1;
        let point = self.segments[i].at(inside - self.segments[i].station);
        if s == inside {
            return point;
        }
        PathPoint { pose: point.pose.advanced(s - inside), curvature: 0.0, curvature_rate: 0.0 }
    }
}

/// Second derivatives of the cubic spline at its points, by Thomas' algorithm. At both ends the second derivative of
/// the last point equals that of its neighbour (parabolic run-out): curvature is not forced to zero in a bend.
fn second_derivatives(points: &[Point], steps: &[f64]) -> Vec<Vector> {
    let n = points.len();
    if n < 3 {
        return vec![Vector::zeros(); n];
    }
    // rows 1..n-1: h₋ M₋ + 2(h₋ + h₊) M + h₊ M₊ = 6 (slope₊ − slope₋), with M₀ = M₁ and Mₙ₋₁ = Mₙ₋₂
    let mut upper = vec![0.0; n];
    let mut bends = vec![Vector::zeros(); n];
    for i in 1..n - 1 {
        let (before, after) = (steps[i - 1], steps[i]);
        let slope = (points[i + 1] - points[i]) / after - (points[i] - points[i - 1]) / before;
        let mut diagonal = 2.0 * (before + after);
        let mut right = slope * 6.0;
        if i == 1 {
            diagonal += before;
        } else {
            diagonal -= before * upper[i - 1];
            right -= bends[i - 1] * before;
        }
        if i == n - 2 {
            diagonal += after;
        } else {
            upper[i] = after / diagonal;
        }
        bends[i] = right / diagonal;
    }
    for i in (1..n - 2).rev() {
        bends[i] = bends[i] - bends[i + 1] * upper[i];
    }
    bends[0] = bends[1];
    bends[n - 1] = bends[n - 2];
    bends
}

impl Segment {
    fn new(station: f64, h: f64, position: [Vector; 4]) -> Self {
        let mut segment = Self { station, length: h, position, parameter: [0.0; 6] };
        let length: f64 = GAUSS_5.iter().map(|(node, weight)| weight * h * segment.first(node * h).norm()).sum();
        // dt/ds = 1/|P'| and d²t/ds² = −P'·P''/|P'|⁴, over s/length
        let rates = |t: f64| {
            let (first, second) = (segment.first(t), segment.second(t));
            let square = first.norm_squared();
            (length / square.sqrt(), -first.dot(&second) / (square * square) * length * length)
        };
        let ((v0, a0), (v1, a1)) = (rates(0.0), rates(h));
        // quintic with these values and derivatives at both ends
        let (c1, c2) = (v0, 0.5 * a0);
        let (p, v, a) = (h - c1 - c2, v1 - c1 - 2.0 * c2, a1 - 2.0 * c2);
        let c3 = 10.0 * p - 4.0 * v + 0.5 * a;
        let c4 = -15.0 * p + 7.0 * v - a;
        let c5 = 6.0 * p - 3.0 * v + 0.5 * a;
        segment.length = length;
        segment.parameter = [0.0, c1, c2, c3, c4, c5];
        segment
    }

    fn first(&self, t: f64) -> Vector {
        let [_, b, c, d] = self.position;
        b + (c * 2.0 + d * (3.0 * t)) * t
    }

    fn second(&self, t: f64) -> Vector {
        let [_, _, c, d] = self.position;
        c * 2.0 + d * (6.0 * t)
    }

    fn frame(&self, s: f64) -> TangentFrame {
        let u = s / self.length;
        let t = self.parameter.iter().rev().fold(0.0, |sum, c| sum * u + c);
        let [a, b, c, d] = self.position;
        let (first, second) = (self.first(t), self.second(t));
        let square = first.norm_squared();
        let speed = square.sqrt();
        TangentFrame {
            position: Point::from(a + (b + (c + d * t) * t) * t),
            tangent: first / speed,
            curvature: cross(first, second) / (square * speed),
        }
    }

    fn at(&self, s: f64) -> PathPoint {
        let u = s / self.length;
        let t = self.parameter.iter().rev().fold(0.0, |sum, c| sum * u + c);
        let [a, b, c, d] = self.position;
        let position = Point::from(a + (b + (c + d * t) * t) * t);
        let (first, second, third) = (self.first(t), self.second(t), self.position[3] * 6.0);
        let square = first.norm_squared();
        let speed = square.sqrt();
        let curvature = cross(first, second) / (square * speed);
        // d/dt of P'×P''/|P'|³, over |P'|
        let curvature_rate =
            (cross(first, third) / (square * speed) - 3.0 * curvature * first.dot(&second) / square) / speed;
        PathPoint { pose: Pose { position, yaw: first.y.atan2(first.x) }, curvature, curvature_rate }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(radius: f64, step: f64, count: u32) -> Spline {
        let point = |i: u32| {
            let a = f64::from(i) * step / radius;
            Point::new(radius * a.sin(), radius * (1.0 - a.cos()))
        };
        Spline::through(&(0..count).map(point).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn circle_has_its_length_and_curvature() {
        let spline = circle(6.0, 1.0, 10);
        assert!((spline.length() - 9.0).abs() < 2e-3, "{}", spline.length());
        for i in 0..90 {
            let curvature = spline.at(f64::from(i) * 0.1).curvature;
            assert!((curvature - 1.0 / 6.0).abs() < 4e-3, "{curvature} at {i}");
        }
        let fine = circle(6.0, 0.25, 37);
        assert!((fine.length() - 9.0).abs() < 1e-5);
    }

    #[test]
    fn parameter_is_arc_length_and_derivatives_agree_with_differences() {
        let wave: Vec<Point> = (0..30).map(|i| Point::new(f64::from(i), 2.0 * (0.4 * f64::from(i)).sin())).collect();
        let spline = Spline::through(&wave).unwrap();
        let h = 1e-4;
        for i in 1..(spline.length() / 0.037) as i32 {
            let s = f64::from(i) * 0.037;
            let (before, here, after) = (spline.at(s - h), spline.at(s), spline.at(s + h));
            let tangent = (after.pose.position - before.pose.position) / (2.0 * h);
            assert!((tangent.norm() - 1.0).abs() < 1e-4, "speed {} at {s}", tangent.norm());
            assert!((tangent.normalize() - here.pose.forward()).norm() < 1e-6);
            assert!(((after.pose.yaw - before.pose.yaw) / (2.0 * h) - here.curvature).abs() < 1e-4);
            // the curvature's derivative jumps at knots
            if spline.stations().all(|k| (k - s).abs() > 2.0 * h) {
                assert!(((after.curvature - before.curvature) / (2.0 * h) - here.curvature_rate).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn position_heading_and_curvature_are_continuous_at_knots() {
        let spline = circle(6.0, 1.0, 10);
        for s in spline.stations().skip(1).take(8) {
            let (before, after) = (spline.at(s - 1e-9), spline.at(s + 1e-9));
            assert!((before.pose.position - after.pose.position).norm() < 1e-8);
            assert!((before.pose.yaw - after.pose.yaw).abs() < 1e-8);
            assert!((before.curvature - after.curvature).abs() < 1e-7);
        }
    }

    #[test]
    fn two_points_make_a_line_and_one_or_equal_ones_none() {
        let line = Spline::through(&[Point::new(0.0, 0.0), Point::new(3.0, 4.0)]).unwrap();
        assert!((line.length() - 5.0).abs() < 1e-12);
        assert!((line.at(7.5).pose.position - Point::new(4.5, 6.0)).norm() < 1e-12);
        assert!((line.at(-5.0).pose.position - Point::new(-3.0, -4.0)).norm() < 1e-12);
        assert!(Spline::through(&[Point::new(0.0, 0.0)]).is_none());
        assert!(Spline::through(&[Point::new(0.0, 0.0), Point::new(0.0, 0.0)]).is_none());
    }
}
