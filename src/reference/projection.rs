//! Projection of points to Frenet coordinates and back, and the offsets within which these coordinates are unique.
//!
//! **Projection.** The foot of a point q is a root of g(s) = (q − P(s))·T(s), whose derivative is −(1 − κ l). A segment
//! between two knots contains a local minimum of the distance only if g decreases through zero there. While |κ| times the
//! distance is below one, g decreases on the whole segment: its signs at the knots decide, and a bracketed Newton iteration
//! solves for the root. Segments whose curvature is too large for that are subdivided. So the foot is the nearest point of
//! the whole line, not just a local minimum near the nearest knot.
//!
//! **Uniqueness.** The circle that touches the line in P(s) and passes through another of its points Q has the curvature
//! 2 d·N/‖d‖², d = Q − P(s). For Q → P(s) this is κ(s). A point at offset l has P(s) as its only nearest point if and only
//! if the circle around it through P(s) contains no other point of the line, that is, if 1/l exceeds all these curvatures.
//! So the largest of them over the line gives the range to the left and the smallest the range to the right. One formula
//! covers the radius of curvature, sharper curves nearby, and a line that returns to itself.

use super::{Frenet, Knot, ReferenceLine};
use crate::geometry::steps::covering;
use crate::geometry::{Point, Vector, cross};

/// Search range of [`ReferenceLine::project_near`] to either side of its hint, m.
const WINDOW: f64 = 10.0;
/// Number of parts of a segment whose curvature is too large for the signs at its ends to decide.
const FINE_PIECES: u32 = 8;

/// A foot point and the square of its distance, m².
type Foot = (f64, Frenet);

impl ReferenceLine {
    /// The point at station `s` and offset `l` (m). [`Self::project`] is its inverse within [`Self::unique_offsets`].
    #[must_use]
    pub fn from_frenet(&self, s: f64, l: f64) -> Point {
        let frame = self.curve.frame(s);
        frame.position + frame.normal() * l + self.origin
    }

    /// Frenet coordinates of a point, by the nearest point of the whole line, continuations included. Continuous in the
    /// point within [`Self::unique_offsets`].
    #[must_use]
    pub fn project(&self, point: Point) -> Frenet {
        let local = point - self.origin;
        let last = self.knots.len() - 1;
        // a foot always exists: g changes sign between first and last knot, or a continuation contains the foot
        self.nearest_foot(local, 0, last).map_or_else(|| self.foot_at(local, self.knots[0].station).1, |(_, foot)| foot)
    }

    /// Frenet coordinates of a point with a station near `hint` (m), by the nearest point within 10 m of it: the station
    /// does not jump where the line comes near itself. Falls back to [`Self::project`] if the distance still decreases at
    /// the end of the search range. Continuous in the point within [`Self::unique_offsets_within`] 10 m plus the error of
    /// the hint.
    #[must_use]
    pub fn project_near(&self, point: Point, hint: f64) -> Frenet {
        let local = point - self.origin;
        let last = self.knots.len() - 1;
        let from = self.knots.partition_point(|k| k.station < hint - WINDOW);
        let to = self.knots.partition_point(|k| k.station <= hint + WINDOW).saturating_sub(1);
        if from >= to {
            return self.project(point);
        }
        let beyond = |knot: usize| (local - self.knots[knot].point).norm_squared();
        match self.nearest_foot(local, from, to) {
            Some((square, foot)) if (from == 0 || square <= beyond(from)) && (to == last || square <= beyond(to)) => {
                foot
            }
            _ => self.project(point),
        }
    }

    /// Offsets to the left and to the right of station `s` within which Frenet coordinates are unique (m, both positive,
    /// infinite without a limit): a point on this normal with a smaller offset has its only nearest point at `s`. The values
    /// are a thousandth on the safe side. Evaluates every knot: not for inner loops.
    #[must_use]
    pub fn unique_offsets(&self, s: f64) -> (f64, f64) {
        self.unique_offsets_within(s, f64::INFINITY)
    }

    /// [`Self::unique_offsets`] restricted to the part of the line within `reach` metres of `s`: the range of a projection
    /// with a hint ([`Self::project_near`]). Where a line crosses or meets itself, [`Self::unique_offsets`] is zero and this
    /// is not.
    #[must_use]
    pub fn unique_offsets_within(&self, s: f64, reach: f64) -> (f64, f64) {
        /// Relative increase of the curvatures; it exceeds the error of a maximum between two knots.
        const SAFE_SIDE: f64 = 1e-3;
        let touching = Touching::new(self, s);
        let samples: Vec<(f64, f64)> = self.stations_within(s, reach).map(|at| (at, touching.curvature(at))).collect();
        let limit = |side: f64| {
            let largest = touching.largest(&samples, side);
            if largest > 0.0 { 1.0 / (largest * (1.0 + SAFE_SIDE)) } else { f64::INFINITY }
        };
        (limit(1.0), limit(-1.0))
    }

    /// Stations of the knots, of equally dense points of the continuations, and `s`, within `reach` of `s`, ascending.
    fn stations_within(&self, s: f64, reach: f64) -> impl Iterator<Item = f64> + '_ {
        let (from, to) = ((s - reach).max(-self.extension), (s + reach).min(self.length() + self.extension));
        let step = self.length() / (self.knots.len() - 1) as f64;
        let beyond = covering(self.extension, step);
        let before = (1..=beyond).rev().map(move |i| -self.extension * i as f64 / beyond as f64);
        let after = (1..=beyond).map(move |i| self.length() + self.extension * i as f64 / beyond as f64);
        let all = before.chain(self.knots.iter().map(|k| k.station)).chain(after);
        let inner = all.filter(move |at| *at > from && *at < to);
        let (first, second) = (inner.clone().filter(move |at| *at < s), inner.filter(move |at| *at > s));
        std::iter::once(from.min(s)).chain(first).chain([s]).chain(second).chain([to.max(s)])
    }

    /// The offset and squared distance of a local point at a given station.
    fn foot_at(&self, local: Point, s: f64) -> Foot {
        let frame = self.curve.frame(s);
        let away = local - frame.position;
        (away.norm_squared(), Frenet { s, l: cross(frame.tangent, away) })
    }

    /// The nearest point of the line between two knots, including a continuation if a knot is the first or the last.
    /// `None` if the distance has no minimum inside.
    fn nearest_foot(&self, local: Point, from: usize, to: usize) -> Option<Foot> {
        let mut best: Option<Foot> = None;
        let mut consider = |foot: Foot| {
            if best.is_none_or(|b| foot.0 < b.0) {
                best = Some(foot);
            }
            best
        };
        let relative = |knot: &Knot| {
            let away = local - knot.point;
            (away.dot(&knot.tangent), away.norm_squared())
        };
        let last = self.knots.len() - 1;
        let mut sharp = false;
        let mut before = relative(&self.knots[from]);
        if from == 0 && before.0 < 0.0 {
            consider(self.foot_at(local, before.0.max(-self.extension)));
        }
        for pair in self.knots[from..=to].windows(2) {
            let after = relative(&pair[1]);
            if before.0 >= 0.0 && after.0 < 0.0 {
                consider(self.foot_between(local, (pair[0].station, before.0), (pair[1].station, after.0)));
            }
            sharp |= is_sharp(&pair[0], before.1.max(after.1));
            before = after;
        }
        if to == last && before.0 >= 0.0 {
            consider(self.foot_at(local, self.knots[last].station + before.0.min(self.extension)));
        }
        if sharp { self.nearest_of_sharp(local, from, to, best) } else { best }
    }

    /// Subdivides the segments where the point is farther from the line than the radius of curvature, if they can contain
    /// a nearer foot than the best one.
    #[cold]
    fn nearest_of_sharp(&self, local: Point, from: usize, to: usize, mut best: Option<Foot>) -> Option<Foot> {
        for pair in self.knots[from..=to].windows(2) {
            let squares = [&pair[0], &pair[1]].map(|k| (local - k.point).norm_squared());
            let length = pair[1].station - pair[0].station;
            let nearest = (squares[0].min(squares[1]).sqrt() - 0.5 * length).max(0.0);
            if !is_sharp(&pair[0], squares[0].max(squares[1])) || best.is_some_and(|b| b.0 <= nearest * nearest) {
                continue;
            }
            let bracket = |s: f64| {
                let frame = self.curve.frame(s);
                (s, (local - frame.position).dot(&frame.tangent))
            };
            let mut low = bracket(pair[0].station);
            for i in 1..=FINE_PIECES {
                let high = bracket(pair[0].station + length * f64::from(i) / f64::from(FINE_PIECES));
                if low.1 >= 0.0 && high.1 < 0.0 {
                    let foot = self.foot_between(local, low, high);
                    if best.is_none_or(|b| foot.0 < b.0) {
                        best = Some(foot);
                    }
                }
                low = high;
            }
        }
        best
    }

    /// The foot between two stations with their values of g, not negative at the first and negative at the second: a
    /// bracketed Newton iteration from the root of the secant.
    fn foot_between(&self, local: Point, (mut low, g_low): (f64, f64), (mut high, g_high): (f64, f64)) -> Foot {
        /// After a step this short, m, the error (its square times a curvature) is negligible.
        const TOLERANCE: f64 = 1e-8;
        const MAX_ITERATIONS: usize = 60;
        let mut s = low + (high - low) * (g_low / (g_low - g_high));
        let mut foot = (f64::INFINITY, Frenet { s, l: 0.0 });
        for _ in 0..MAX_ITERATIONS {
            let frame = self.curve.frame(s);
            let away = local - frame.position;
            let (g, l) = (away.dot(&frame.tangent), cross(frame.tangent, away));
            foot = (away.norm_squared(), Frenet { s, l });
            let slope = 1.0 - frame.curvature * l;
            let step = g / slope;
            if slope > 0.0 && step.abs() <= TOLERANCE {
                foot.1.s = (s + step).clamp(low, high);
                break;
            }
            if g > 0.0 {
                low = s;
            } else {
                high = s;
            }
            let newton = s + step;
            s = if slope > 0.0 && newton > low && newton < high { newton } else { f64::midpoint(low, high) };
            if high - low <= TOLERANCE {
                break;
            }
        }
        foot
    }
}

/// Whether a point at this squared distance (m²) may be beyond a centre of curvature of the segment after a knot.
fn is_sharp(knot: &Knot, square: f64) -> bool {
    knot.max_curvature * knot.max_curvature * square >= 1.0
}

/// The circles that touch the line at one station.
struct Touching<'a> {
    line: &'a ReferenceLine,
    s: f64,
    point: Point,
    normal: Vector,
    curvature: f64,
}

impl<'a> Touching<'a> {
    fn new(line: &'a ReferenceLine, s: f64) -> Self {
        let frame = line.curve.frame(s);
        Self { line, s, point: frame.position, normal: frame.normal(), curvature: frame.curvature }
    }

    /// Curvature of the circle that touches here and passes through the point of the line at station `at`, 1/m; the
    /// curvature of the line for `at` = `s`.
    fn curvature(&self, at: f64) -> f64 {
        /// For nearer points the formula gives the curvature here plus rounding errors, m.
        const HERE: f64 = 1e-3;
        if (at - self.s).abs() < HERE {
            return self.curvature;
        }
        let away = self.line.curve.frame(at).position - self.point;
        2.0 * away.dot(&self.normal) / away.norm_squared().max(f64::MIN_POSITIVE)
    }

    /// The largest curvature to one side (1: left, −1: right); golden-section search between the samples.
    fn largest(&self, samples: &[(f64, f64)], side: f64) -> f64 {
        /// Peaks of at least this fraction of the highest sample are refined.
        const NEAR_PEAK: f64 = 0.8;
        let value = |i: usize| side * samples[i].1;
        let last = samples.len() - 1;
        let highest = (0..=last).map(value).fold(0.0, f64::max);
        let peaks = (0..=last).filter(|i| {
            let v = value(*i);
            v > NEAR_PEAK * highest && (*i == 0 || v >= value(i - 1)) && (*i == last || v >= value(i + 1))
        });
        peaks.fold(highest, |most, i| {
            let (from, to) = (samples[i.saturating_sub(1)].0, samples[(i + 1).min(last)].0);
            most.max(golden_maximum(from, to, |at| side * self.curvature(at)))
        })
    }
}

/// The maximum of a function with one peak between two arguments, by golden-section search to 10⁻⁴ of the interval.
fn golden_maximum(mut from: f64, mut to: f64, f: impl Fn(f64) -> f64) -> f64 {
    const SHARE: f64 = 0.618_033_988_749_894_9;
    const SECTIONS: usize = 20;
    let (mut a, mut b) = (to - SHARE * (to - from), from + SHARE * (to - from));
    let (mut fa, mut fb) = (f(a), f(b));
    for _ in 0..SECTIONS {
        if fa > fb {
            (to, b, fb) = (b, a, fa);
            a = to - SHARE * (to - from);
            fa = f(a);
        } else {
            (from, a, fa) = (a, b, fb);
            b = from + SHARE * (to - from);
            fb = f(b);
        }
    }
    fa.max(fb)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{UTM, lane_along, line, turn};
    use super::*;
    use crate::geometry::wrap_angle;
    use proptest::prelude::*;
    use std::sync::OnceLock;

    /// The reference line of a lane through points.
    fn through(points: &[Point], origin: Vector) -> ReferenceLine {
        line(&lane_along(points, origin), &[1])
    }

    /// Points every half metre of a curve with the given curvature by arc length.
    fn curve(length: f64, curvature: impl Fn(f64) -> f64) -> Vec<Point> {
        const STEP: f64 = 0.5;
        let (mut p, mut yaw) = (Point::origin(), 0.0_f64);
        let mut points = vec![p];
        for i in 0..(length / STEP) as i32 {
            let k = curvature((f64::from(i) + 0.5) * STEP);
            let middle = yaw + 0.5 * k * STEP;
            p += Vector::new(middle.cos(), middle.sin()) * STEP;
            yaw += k * STEP;
            points.push(p);
        }
        points
    }

    /// Lines that are difficult for projection: sharp curves, a hairpin, an S-curve, a line that returns beside itself,
    /// one that crosses itself.
    fn hard_lines() -> &'static [(&'static str, ReferenceLine)] {
        static LINES: OnceLock<Vec<(&'static str, ReferenceLine)>> = OnceLock::new();
        LINES.get_or_init(make_hard_lines)
    }

    fn make_hard_lines() -> Vec<(&'static str, ReferenceLine)> {
        let bend = |from: f64, to: f64, k: f64| move |s: f64| if (from..to).contains(&s) { k } else { 0.0 };
        let hairpin = bend(30.0, 30.0 + 4.0 * std::f64::consts::PI, 0.25);
        let s_bend = |s: f64| bend(20.0, 26.0, 0.25)(s) + bend(26.0, 32.0, -0.25)(s);
        let crossing = bend(30.0, 30.0 + 1.5 * std::f64::consts::PI * 12.0, 1.0 / 12.0);
        vec![
            ("sharp turn", through(&turn(4.0), UTM)),
            ("turn", through(&turn(12.0), UTM)),
            ("hairpin", through(&curve(75.0, hairpin), UTM)),
            ("S-curve", through(&curve(60.0, s_bend), UTM)),
            ("crossing", through(&curve(110.0, crossing), UTM)),
            ("straight", through(&curve(50.0, |_| 0.0), UTM)),
        ]
    }

    /// Brute force: distance and station of the nearest of points every 2 cm.
    fn nearest_by_brute_force(line: &ReferenceLine, point: Point) -> (f64, f64) {
        let (from, to) = (-line.extension, line.length() + line.extension);
        let steps = ((to - from) / 0.02) as i32;
        let local = point - line.origin;
        let at = |i: i32| from + (to - from) * f64::from(i) / f64::from(steps);
        let distances = (0..=steps).map(|i| ((line.curve.frame(at(i)).position - local).norm(), at(i)));
        distances.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
    }

    #[test]
    fn unique_offsets_agree_with_brute_force() {
        for (name, line) in hard_lines() {
            let mut limited = 0;
            for i in 0..(line.length() / 1.7) as i32 {
                let s = f64::from(i) * 1.7 + 0.3;
                let (left, right) = line.unique_offsets(s);
                for (side, limit) in [(1.0, left), (-1.0, right)] {
                    assert!(limit > 0.0, "{name}: {limit} at {s}");
                    let inside = side * (0.995 * limit).min(40.0);
                    let (distance, at) = nearest_by_brute_force(line, line.from_frenet(s, inside));
                    assert!(distance > inside.abs() - 1e-4, "{name}: {inside} at {s} is nearer to {at}");
                    // sampling cannot distinguish points whose distances differ by less than its resolution
                    assert!((at - s).abs() < 1.5, "{name}: {inside} at {s} has its foot at {at}");
                    if limit < 30.0 {
                        limited += 1;
                        let outside = side * (1.01 * limit + 0.05);
                        let (distance, _) = nearest_by_brute_force(line, line.from_frenet(s, outside));
                        assert!(distance < outside.abs() - 1e-7, "{name}: {outside} at {s} is still the nearest");
                    }
                }
            }
            assert_eq!(limited == 0, *name == "straight", "{name}: limited at {limited} places");
        }
    }

    #[test]
    fn a_crossing_line_has_unique_offsets_only_within_a_neighbourhood() {
        let lines = hard_lines();
        let (_, line) = lines.iter().find(|(name, _)| *name == "crossing").unwrap();
        let least = |f: &dyn Fn(f64) -> (f64, f64)| {
            let at = |i: i32| f(f64::from(i) * 0.2);
            (0..(line.length() / 0.2) as i32).map(at).map(|(l, r)| l.min(r)).fold(f64::INFINITY, f64::min)
        };
        assert!(least(&|s| line.unique_offsets(s)) < 0.2);
        assert!(least(&|s| line.unique_offsets_within(s, 15.0)) > 9.0);
    }

    #[test]
    fn unique_offsets_of_a_circle_end_at_its_centre() {
        let circle = |s: f64| if s < 60.0 { 0.1 } else { 0.0 };
        let line = through(&curve(60.0, circle), Vector::zeros());
        let (left, right) = line.unique_offsets(30.0);
        assert!((left - 10.0).abs() < 0.1, "{left}");
        // opposite to the gap no other part of the line is near; the continuations leave to the right
        assert!(right > 30.0, "{right}");
    }

    #[test]
    fn the_station_of_a_moving_point_does_not_jump_within_the_unique_offsets() {
        const STEP: f64 = 0.01;
        const SHARE: f64 = 0.95;
        let mut steps = 0;
        for (name, line) in hard_lines() {
            for crossing in 0..12 {
                let target = line.at(line.length() * (0.2 + 0.05 * f64::from(crossing))).pose;
                let yaw = f64::from(crossing) * 2.4;
                let direction = Vector::new(yaw.cos(), yaw.sin());
                let mut last: Option<Frenet> = None;
                for i in -1500..1500 {
                    let foot = line.project(target.position + direction * (f64::from(i) * STEP));
                    let (left, right) = line.unique_offsets(foot.s);
                    // the next step must stay within the limits as well
                    let max = |limit: f64| SHARE * limit - 10.0 * STEP;
                    let within = foot.l < max(left) && -foot.l < max(right) && foot.s.abs() < line.length();
                    if let Some(last) = last.filter(|_| within) {
                        steps += 1;
                        let moved = (foot.s - last.s).abs();
                        // ds = dx / (1 − κ l)
                        assert!(moved < 2.0 * STEP / (1.0 - SHARE), "{name}: from {last:?} to {foot:?}");
                        assert!((foot.l - last.l).abs() < 1.001 * STEP, "{name}: from {last:?} to {foot:?}");
                    }
                    last = within.then_some(foot);
                }
            }
        }
        assert!(steps > 50_000, "{steps} steps only");
    }

    #[test]
    fn the_hint_keeps_the_station_where_the_line_meets_itself() {
        // a full circle of radius 20: its end is beside its start
        let circle: Vec<Point> = (0..=125)
            .map(|i| {
                let a = f64::from(i) / 20.0;
                Point::new(20.0 * a.sin(), 20.0 * (1.0 - a.cos()))
            })
            .collect();
        let line = through(&circle, Vector::zeros());
        let p = Point::new(0.1, 0.0);
        assert!(line.project_near(p, 1.0).s < 2.0);
        assert!(line.project_near(p, 124.0).s > 123.0);
        let far = Point::new(0.0, 40.0);
        assert!(
            (line.project_near(far, 3.0).s - line.project(far).s).abs() < 1e-9,
            "a wrong hint must not change the result"
        );
        let nowhere = Point::new(f64::NAN, 0.0);
        assert!(line.project(nowhere).l.is_nan() && line.project_near(nowhere, 3.0).l.is_nan());
    }

    /// Points that are translated, rotated and mirrored.
    fn changed(points: &[Point], yaw: f64, to: Vector, mirrored: bool) -> (Vec<Point>, impl Fn(Point) -> Point) {
        let side = if mirrored { -1.0 } else { 1.0 };
        let change = move |p: Point| {
            let (sin, cos) = yaw.sin_cos();
            Point::new(cos * p.x - sin * side * p.y, sin * p.x + cos * side * p.y) + to
        };
        (points.iter().map(|p| change(*p)).collect(), change)
    }

    #[test]
    fn coordinates_are_invariant_under_rigid_motions_and_mirroring() {
        let points = curve(70.0, |s| 0.2 * (s / 6.0).sin());
        let line = through(&points, Vector::zeros());
        for (yaw, to, mirrored) in [(0.0, UTM, false), (1.1, UTM, false), (-2.7, -UTM, true), (0.0, UTM * 0.0, true)] {
            let (there, change) = changed(&points, yaw, to, mirrored);
            let side = if mirrored { -1.0 } else { 1.0 };
            let other = through(&there, Vector::zeros());
            for i in 0..230 {
                let (s, l) = (f64::from(i) * 0.3, 4.0 * (f64::from(i) * 0.7).sin());
                let (left, right) = line.unique_offsets(s);
                let l = l.clamp(-0.9 * right, 0.9 * left);
                let p = line.from_frenet(s, l);
                let (a, b) = (line.project(p), other.project(change(p)));
                assert!((a.s - b.s).abs() < 1e-6 && (a.l - side * b.l).abs() < 1e-6, "{a:?} became {b:?}");
                let (here, turned) = (line.at(s), other.at(s));
                assert!((turned.curvature - side * here.curvature).abs() < 1e-6);
                assert!(wrap_angle(turned.pose.yaw - yaw - side * here.pose.yaw).abs() < 1e-6);
            }
        }
    }

    proptest! {
        #[test]
        fn round_trip_within_the_unique_range(
            part in -0.2..1.2f64, share in -0.98..0.98f64, radius in 4.0..40.0f64, which in 0..7usize,
        ) {
            let lines = hard_lines();
            let sharp = through(&turn(radius), UTM);
            let line = lines.get(which).map_or(&sharp, |(_, line)| line);
            let s = part * line.length();
            let within = |(left, right): (f64, f64)| (share * if share > 0.0 { left } else { right }).clamp(-50.0, 50.0);
            let l = within(line.unique_offsets(s));
            let p = line.from_frenet(s, l);
            let back = line.project(p);
            prop_assert!((back.s - s).abs() < 1e-6 && (back.l - l).abs() < 1e-6, "{back:?} for {s} {l}");
            prop_assert!((line.from_frenet(back.s, back.l) - p).norm() < 1e-6);

            let l = within(line.unique_offsets_within(s, 11.0));
            let p = line.from_frenet(s, l);
            let back = line.project_near(p, s.clamp(0.0, line.length()) + 0.9);
            prop_assert!((back.s - s).abs() < 1e-6 && (back.l - l).abs() < 1e-6, "near: {back:?} for {s} {l}");
        }

        #[test]
        fn projection_is_the_nearest_point(x in -30.0..60.0f64, y in -30.0..60.0f64, which in 0..6usize) {
            let line = &hard_lines()[which].1;
            let p = Point::new(x, y) + UTM;
            let found = line.project(p);
            let distance = (line.at(found.s).pose.position - p).norm();
            let beyond = found.s <= -line.extension || found.s >= line.length() + line.extension;
            prop_assert!((distance - found.l.abs()).abs() < 1e-9 || beyond);
            let (brute, at) = nearest_by_brute_force(line, p);
            prop_assert!(distance <= brute + 1e-9, "{distance}, but {brute} at {at}");
            // the round trip holds everywhere
            prop_assert!(beyond || (line.from_frenet(found.s, found.l) - p).norm() < 1e-6);
        }
    }
}
