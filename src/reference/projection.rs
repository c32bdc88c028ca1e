//! Points to Frenet coordinates and back, and how far from the line these are unique.
//!
//! The foot of a point q is a root of g(s) = (q − P(s))·T(s), whose slope is −(1 − κ l). A piece of the line between two
//! knots holds a nearest point inside only if g falls through zero there; while |κ| times the distance is below one g
//! falls all along, so that its signs at the knots tell, and Newton's method within them finds the root. Where the bend
//! is too sharp for that, the piece is searched more finely. So the foot found is the nearest point of the whole line,
//! not a nearest one near the nearest knot.
//!
//! **Uniqueness.** The circle that touches the line in P(s) and passes through another of its points Q has the curvature
//! 2 d·N/‖d‖², d = Q − P(s). For Q → P(s) this is κ(s). A point at offset l has P(s) as its one nearest point exactly if
//! the circle around it through P(s) holds no other point of the line, that is, if 1/l is above all these curvatures. So
//! the largest of them over the line gives the range to the left, the smallest the one to the right: one formula for the
//! radius of curvature, for sharper bends near by, and for a line that comes back to itself.

use super::{Frenet, Knot, ReferenceLine};
use crate::geometry::{Point, Vector, cross};

/// Search of [`ReferenceLine::project_near`] to either side of its hint, m.
const WINDOW: f64 = 10.0;
/// Pieces that a stretch between two knots is cut into where its bend is too sharp for the signs at its ends to tell.
const FINE_PIECES: u32 = 8;

/// A foot point and the square of its distance, m².
type Foot = (f64, Frenet);

impl ReferenceLine {
    /// The point at station `s` and offset `l`; see [`Self::unique_offsets`] for where [`Self::project`] leads back.
    #[must_use]
    pub fn from_frenet(&self, s: f64, l: f64) -> Point {
        let frame = self.curve.frame(s);
        frame.position + frame.normal() * l + self.origin
    }

    /// Frenet coordinates of a point: the nearest point of the whole line, continuations included. Continuous in the
    /// point within [`Self::unique_offsets`].
    #[must_use]
    pub fn project(&self, point: Point) -> Frenet {
        let local = point - self.origin;
        let last = self.knots.len() - 1;
        // from its first to its last knot g falls or a continuation holds a foot: there is always one
        self.nearest_foot(local, 0, last).map_or_else(|| self.foot_at(local, self.knots[0].station).1, |(_, foot)| foot)
    }

    /// Frenet coordinates of a point whose station is about `hint`: the nearest point within 10 m of it, so that a line
    /// that comes near itself does not make the station jump. Falls back to the whole line when the way to the line gets
    /// shorter beyond the rim of the search. Continuous in the point within [`Self::unique_offsets_within`] 10 m and the
    /// hint's error.
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

    /// How far to the left and to the right of station `s` Frenet coordinates are unique (m, both positive, infinite
    /// where nothing limits them): a point of this normal at a smaller offset has the foot `s` on the whole line, and no
    /// other as near. Rounded towards the safe side by a thousandth. Looks at every
    /// knot: not for inner loops.
    #[must_use]
    pub fn unique_offsets(&self, s: f64) -> (f64, f64) {
        self.unique_offsets_within(s, f64::INFINITY)
    }

    /// The same against the part of the line within `reach` metres of `s` alone: what a projection that knows about
    /// where it is ([`Self::project_near`]) can tell apart. Where a line crosses or meets itself,
    /// [`Self::unique_offsets`] falls to nothing and this does not.
    #[must_use]
    pub fn unique_offsets_within(&self, s: f64, reach: f64) -> (f64, f64) {
        /// Share by which the curvatures found are raised: a peak between two knots is found to less than this.
        const SAFE_SIDE: f64 = 1e-3;
        let touching = Touching::new(self, s);
        let samples: Vec<(f64, f64)> = self.stations_within(s, reach).map(|at| (at, touching.curvature(at))).collect();
        let limit = |side: f64| {
            let found = touching.largest(&samples, side);
            if found > 0.0 { 1.0 / (found * (1.0 + SAFE_SIDE)) } else { f64::INFINITY }
        };
        (limit(1.0), limit(-1.0))
    }

    /// Stations of the knots, of as dense points of the continuations, and `s`, in order, within `reach` of `s`.
    fn stations_within(&self, s: f64, reach: f64) -> impl Iterator<Item = f64> + '_ {
        let (from, to) = ((s - reach).max(-self.extension), (s + reach).min(self.length() + self.extension));
        let step = self.length() / (self.knots.len() - 1) as f64;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some dozens of points
        let beyond = (self.extension / step).ceil() as usize;
        let before = (1..=beyond).rev().map(move |i| -self.extension * i as f64 / beyond as f64);
        let after = (1..=beyond).map(move |i| self.length() + self.extension * i as f64 / beyond as f64);
        let all = before.chain(self.knots.iter().map(|k| k.station)).chain(after);
        let inner = all.filter(move |at| *at > from && *at < to);
        let (first, second) = (inner.clone().filter(move |at| *at < s), inner.filter(move |at| *at > s));
        std::iter::once(from.min(s)).chain(first).chain([s]).chain(second).chain([to.max(s)])
    }

    /// The foot of a local point on the line, with its distance's square, at a station that is taken as it is.
    fn foot_at(&self, local: Point, s: f64) -> Foot {
        let frame = self.curve.frame(s);
        let away = local - frame.position;
        (away.norm_squared(), Frenet { s, l: cross(frame.tangent, away) })
    }

    /// The nearest point of the line between two knots, continuations included where these are its first or last. None
    /// if the way to the line only gets shorter towards the ends of that stretch.
    fn nearest_foot(&self, local: Point, from: usize, to: usize) -> Option<Foot> {
        let mut best: Option<Foot> = None;
        let mut consider = |foot: Foot| {
            if best.is_none_or(|b| foot.0 < b.0) {
                best = Some(foot);
            }
            best
        };
        let seen = |knot: &Knot| {
            let away = local - knot.point;
            (away.dot(&knot.tangent), away.norm_squared())
        };
        let last = self.knots.len() - 1;
        let mut sharp = false;
        let mut before = seen(&self.knots[from]);
        if from == 0 && before.0 < 0.0 {
            consider(self.foot_at(local, before.0.max(-self.extension)));
        }
        for pair in self.knots[from..=to].windows(2) {
            let after = seen(&pair[1]);
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

    /// The pieces in which a point lies farther from the line than its bend allows: searched by smaller steps, where
    /// they can hold a nearer foot than the one found so far.
    #[cold]
    fn nearest_of_sharp(&self, local: Point, from: usize, to: usize, mut best: Option<Foot>) -> Option<Foot> {
        for pair in self.knots[from..=to].windows(2) {
            let squares = [&pair[0], &pair[1]].map(|k| (local - k.point).norm_squared());
            let length = pair[1].station - pair[0].station;
            let nearest = (squares[0].min(squares[1]).sqrt() - 0.5 * length).max(0.0);
            if !is_sharp(&pair[0], squares[0].max(squares[1])) || best.is_some_and(|b| b.0 <= nearest * nearest) {
                continue;
            }
            let along = |s: f64| {
                let frame = self.curve.frame(s);
                (s, (local - frame.position).dot(&frame.tangent))
            };
            let mut low = along(pair[0].station);
            for i in 1..=FINE_PIECES {
                let high = along(pair[0].station + length * f64::from(i) / f64::from(FINE_PIECES));
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

    /// The foot between two stations given with g, which is not negative at the first and negative at the second: from
    /// the secant's root by Newton's method, kept inside the bracket.
    fn foot_between(&self, local: Point, (mut low, g_low): (f64, f64), (mut high, g_high): (f64, f64)) -> Foot {
        /// After a step as short as this, m, the error is its square times a curvature: nothing.
        const TOLERANCE: f64 = 1e-8;
        const MAX_ITERATIONS: usize = 60;
        let mut s = low + (high - low) * (g_low / (g_low - g_high));
        let mut foot = (f64::INFINITY, Frenet { s, l: 0.0 });
        for _ in 0..MAX_ITERATIONS {
            let frame = self.curve.frame(s);
            let away = local - frame.position;
            let (along, l) = (away.dot(&frame.tangent), cross(frame.tangent, away));
            foot = (away.norm_squared(), Frenet { s, l });
            let slope = 1.0 - frame.curvature * l;
            let step = along / slope;
            if slope > 0.0 && step.abs() <= TOLERANCE {
                foot.1.s = (s + step).clamp(low, high);
                break;
            }
            if along > 0.0 {
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

/// Whether a point this far away (m²) may be beyond a centre of curvature of the piece behind a knot.
fn is_sharp(knot: &Knot, square: f64) -> bool {
    knot.sharpest * knot.sharpest * square >= 1.0
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

    /// Curvature of the circle that touches here and passes through the line's point at a station, 1/m; the line's own
    /// curvature where that is here.
    fn curvature(&self, at: f64) -> f64 {
        /// Nearer points give no more than the curvature here, and rounding, m.
        const HERE: f64 = 1e-3;
        if (at - self.s).abs() < HERE {
            return self.curvature;
        }
        let away = self.line.curve.frame(at).position - self.point;
        2.0 * away.dot(&self.normal) / away.norm_squared().max(f64::MIN_POSITIVE)
    }

    /// The largest curvature to one side (1: left, −1: right), between the samples by golden sections.
    fn largest(&self, samples: &[(f64, f64)], side: f64) -> f64 {
        /// Peaks whose samples come this near to the highest one are looked at more closely.
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

/// The largest value of a function with one peak between two places, by golden sections, to 10⁻⁴ of the interval.
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

    /// A line through points, its lane far from the origin.
    fn through(points: &[Point], origin: Vector) -> ReferenceLine {
        line(&lane_along(points, origin), &[1])
    }

    /// Points of a way whose curvature is given by arc length, every half metre.
    fn way(length: f64, curvature: impl Fn(f64) -> f64) -> Vec<Point> {
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

    /// Lines with what makes projection hard: sharp bends, a hairpin, bends to both sides, a way that comes back beside
    /// itself, one that crosses itself.
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
            ("hairpin", through(&way(75.0, hairpin), UTM)),
            ("bends to both sides", through(&way(60.0, s_bend), UTM)),
            ("crossing", through(&way(110.0, crossing), UTM)),
            ("straight", through(&way(50.0, |_| 0.0), UTM)),
        ]
    }

    /// The nearest of points every 2 cm, by looking at all of them: distance and station.
    fn nearest_by_looking(line: &ReferenceLine, point: Point) -> (f64, f64) {
        let (from, to) = (-line.extension, line.length() + line.extension);
        let steps = ((to - from) / 0.02) as i32;
        let local = point - line.origin;
        let at = |i: i32| from + (to - from) * f64::from(i) / f64::from(steps);
        let seen = (0..=steps).map(|i| ((line.curve.frame(at(i)).position - local).norm(), at(i)));
        seen.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
    }

    #[test]
    fn the_range_of_unique_offsets_is_what_looking_at_all_points_says() {
        for (name, line) in hard_lines() {
            let mut limited = 0;
            for i in 0..(line.length() / 1.7) as i32 {
                let s = f64::from(i) * 1.7 + 0.3;
                let (left, right) = line.unique_offsets(s);
                for (side, limit) in [(1.0, left), (-1.0, right)] {
                    assert!(limit > 0.0, "{name}: {limit} at {s}");
                    let inside = side * (0.995 * limit).min(40.0);
                    let (distance, at) = nearest_by_looking(line, line.from_frenet(s, inside));
                    assert!(distance > inside.abs() - 1e-4, "{name}: {inside} at {s} is nearer to {at}");
                    // the sampling can't tell points whose distance differs by less than its own
                    assert!((at - s).abs() < 1.5, "{name}: {inside} at {s} has its foot at {at}");
                    if limit < 30.0 {
                        limited += 1;
                        let outside = side * (1.01 * limit + 0.05);
                        let (distance, _) = nearest_by_looking(line, line.from_frenet(s, outside));
                        assert!(distance < outside.abs() - 1e-7, "{name}: {outside} at {s} is still the nearest");
                    }
                }
            }
            assert_eq!(limited == 0, *name == "straight", "{name}: limited at {limited} places");
        }
    }

    #[test]
    fn a_crossing_line_leaves_no_offsets_against_the_whole_of_it_and_some_against_its_neighbourhood() {
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
    fn beside_a_circle_the_range_ends_at_its_centre_and_on_the_other_side_where_it_closes() {
        let circle = |s: f64| if s < 60.0 { 0.1 } else { 0.0 };
        let line = through(&way(60.0, circle), Vector::zeros());
        let (left, right) = line.unique_offsets(30.0);
        assert!((left - 10.0).abs() < 0.1, "{left}");
        // opposite to the gap, nothing else comes near; the continuations leave to the right
        assert!(right > 30.0, "{right}");
    }

    #[test]
    fn a_point_that_walks_across_a_bend_has_a_station_that_does_not_jump() {
        const STEP: f64 = 0.01;
        const SHARE: f64 = 0.95;
        let mut walked = 0;
        for (name, line) in hard_lines() {
            for crossing in 0..12 {
                let target = line.at(line.length() * (0.2 + 0.05 * f64::from(crossing))).pose;
                let yaw = f64::from(crossing) * 2.4;
                let direction = Vector::new(yaw.cos(), yaw.sin());
                let mut last: Option<Frenet> = None;
                for i in -1500..1500 {
                    let foot = line.project(target.position + direction * (f64::from(i) * STEP));
                    let (left, right) = line.unique_offsets(foot.s);
                    // a step must not lead over the rim, either
                    let most = |limit: f64| SHARE * limit - 10.0 * STEP;
                    let within = foot.l < most(left) && -foot.l < most(right) && foot.s.abs() < line.length();
                    if let Some(last) = last.filter(|_| within) {
                        walked += 1;
                        let moved = (foot.s - last.s).abs();
                        // ds = dx / (1 − κ l)
                        assert!(moved < 2.0 * STEP / (1.0 - SHARE), "{name}: from {last:?} to {foot:?}");
                        assert!((foot.l - last.l).abs() < 1.001 * STEP, "{name}: from {last:?} to {foot:?}");
                    }
                    last = within.then_some(foot);
                }
            }
        }
        assert!(walked > 50_000, "{walked} steps only");
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
        assert!((line.project_near(far, 3.0).s - line.project(far).s).abs() < 1e-9, "a wrong hint does no harm");
        let nowhere = Point::new(f64::NAN, 0.0);
        assert!(line.project(nowhere).l.is_nan() && line.project_near(nowhere, 3.0).l.is_nan());
    }

    /// A line moved, turned and (left for right) mirrored.
    fn changed(points: &[Point], yaw: f64, to: Vector, mirrored: bool) -> (Vec<Point>, impl Fn(Point) -> Point) {
        let side = if mirrored { -1.0 } else { 1.0 };
        let change = move |p: Point| {
            let (sin, cos) = yaw.sin_cos();
            Point::new(cos * p.x - sin * side * p.y, sin * p.x + cos * side * p.y) + to
        };
        (points.iter().map(|p| change(*p)).collect(), change)
    }

    #[test]
    fn moved_turned_and_mirrored_lines_give_the_same_coordinates() {
        let points = way(70.0, |s| 0.2 * (s / 6.0).sin());
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
            let (brute, at) = nearest_by_looking(line, p);
            prop_assert!(distance <= brute + 1e-9, "{distance} against {brute} at {at}");
            // and back to the same point, wherever it is
            prop_assert!(beyond || (line.from_frenet(found.s, found.l) - p).norm() < 1e-6);
        }
    }
}
