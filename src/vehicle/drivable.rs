//! Whether a whole trajectory stays in the domain of the tracking tube, and how much of the grip it uses.
//!
//! The check bounds the motion between two instants instead of sampling it, so that no extremum is missed: the speed from the
//! constant jerk, curvature and its derivative from the cubic polynomial, each use of the grip at the ends of the acceleration,
//! in which it is monotone. An interval of [`LONGEST`] or less is accepted if its bound is inside the domain and at most
//! [`TOLERANCE`] above the largest use at an instant; any other interval is halved, down to [`SHORTEST`]. The result is
//! therefore never below the true use.
//!
//! Weak where: within the shortest interval the bound combines the largest speed with the largest curvature. It exceeds the
//! true use by up to a few hundredths, and a trajectory this close to a limit is refused.

use super::tube::GripModel;
use super::{GripUse, PathMotion, TrackingTube, Vehicle};
use crate::geometry::spiral::Polynomial;
use crate::trajectory::{SpeedKnot, Trajectory};

/// Longest interval that is bounded as a whole, s.
const LONGEST: f64 = 0.2;
/// Most intervals of a stretch of constant jerk before any is halved.
const MOST: f64 = 1e4;
/// Interval that is not halved further, s.
const SHORTEST: f64 = 0.0125;
/// Excess of a bound over the largest use at an instant that is accepted.
const TOLERANCE: f64 = 0.01;
/// Difference of curvature between two spirals above which the wheels would have to turn at once, 1/m.
const JUMP: f64 = 1e-4;

/// A trajectory that leaves the domain of the tracking tube: when and why first.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{what} is {value:.3} at {time:.2} s; limit {limit:.3}")]
pub struct NotDrivable {
    /// Time of the run, s.
    pub time: f64,
    /// The limit that the trajectory exceeds.
    pub what: DrivingLimit,
    /// An upper bound of the value at that time, in the unit of `what`.
    pub value: f64,
    /// The limit, in the same unit.
    pub limit: f64,
}

/// A limit of the domain of the tracking tube.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DrivingLimit {
    /// Share of the grip that proofs may use, 0…1.
    Grip,
    /// Speed for this use of the grip, m/s: [`TrackingTube::speed`].
    Speed,
    /// Steering rate, rad/s. A jump of the curvature needs an infinite one.
    SteeringRate,
    /// Curvature, 1/m: [`TrackingTube::CURVATURE_SHARE`] of the vehicle's largest.
    Curvature,
}

impl std::fmt::Display for DrivingLimit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Grip => "use of the grip",
            Self::Speed => "speed (m/s)",
            Self::SteeringRate => "steering rate (rad/s)",
            Self::Curvature => "curvature (1/m)",
        })
    }
}

impl Vehicle {
    /// The largest use of the grip by a trajectory, if all of it is in the domain of the tracking tube on a road whose friction
    /// is `friction` times that of dry asphalt: an upper bound, by at most a few hundredths. With it,
    /// [`TrackingTube::at`] and [`Vehicle::tracking_margins`] bound the tracking errors.
    ///
    /// # Errors
    /// The first time at which the trajectory exceeds a limit, or comes within a few hundredths of it.
    pub fn drivable(&self, friction: f64, trajectory: &Trajectory) -> Result<GripUse, NotDrivable> {
        Check::new(self, friction, trajectory).run()
    }
}

/// A spiral of the path.
struct Piece {
    station: f64,
    /// 1/length, 1/m.
    per_length: f64,
    curvature: Polynomial<4>,
    /// Whether the curvature jumps at its start.
    jumps: bool,
}

impl Piece {
    /// The curvature at a share of the length.
    #[inline]
    fn at(&self, share: f64) -> Place {
        let [_, c1, c2, c3] = self.curvature.0;
        let (second, third) = (2.0 * c2, 6.0 * c3);
        Place {
            share,
            curvature: self.curvature.value(share),
            slope: c1 + share * (second + share * 0.5 * third),
            second: second + share * third,
        }
    }
}

/// A place on a spiral.
#[derive(Clone, Copy)]
struct Place {
    /// Share of the spiral's length.
    share: f64,
    /// 1/m.
    curvature: f64,
    /// Derivatives of the curvature by the share, 1/m.
    slope: f64,
    second: f64,
}

/// The motion at an instant.
#[derive(Clone, Copy)]
struct Instant {
    /// Index of the last knot of the profile, and the time since, s.
    knot: usize,
    time: f64,
    speed: f64,
    acceleration: f64,
    /// Index of the spiral.
    piece: usize,
    place: Place,
}

/// Bounds on a part of the path.
struct Bend {
    /// Largest and smallest |curvature|, 1/m.
    most: f64,
    least: f64,
    /// Largest |derivative of the curvature|, 1/m².
    rate: f64,
}

impl Bend {
    /// Includes the part of a spiral between two places.
    #[inline]
    fn include(&mut self, piece: &Piece, from: &Place, to: &Place) {
        let part = to.share - from.share;
        let arc = part * part / 8.0;
        let bulge = arc * from.second.abs().max(to.second.abs());
        let (k, l) = (from.curvature, to.curvature);
        self.most = self.most.max(k.abs().max(l.abs()) + bulge);
        let least = if k * l <= 0.0 { 0.0 } else { (k.abs().min(l.abs()) - bulge).max(0.0) };
        self.least = self.least.min(least);
        let rate = from.slope.abs().max(to.slope.abs()) + arc * (6.0 * piece.curvature.0[3]).abs();
        self.rate = self.rate.max(rate * piece.per_length);
    }
}

/// Bounds within an interval of time.
struct Bound {
    speed: f64,
    curvature: f64,
    steering_rate: f64,
    used: GripUse,
}

struct Check<'a> {
    vehicle: &'a Vehicle,
    grip: GripModel,
    largest_curvature: f64,
    trajectory: &'a Trajectory,
    pieces: Vec<Piece>,
}

impl<'a> Check<'a> {
    fn new(vehicle: &'a Vehicle, friction: f64, trajectory: &'a Trajectory) -> Self {
        let mut before = None;
        let pieces = trajectory.path.pieces().map(|(station, _, spiral)| {
            let [first, .., last] = spiral.knots;
            let jumps = (before.unwrap_or(first) - first).abs() > JUMP;
            before = Some(last);
            Piece { station, per_length: 1.0 / spiral.length, curvature: spiral.curvature_polynomial(), jumps }
        });
        Self {
            vehicle,
            grip: GripModel::new(vehicle, friction),
            largest_curvature: TrackingTube::CURVATURE_SHARE * vehicle.max_curvature(),
            trajectory,
            pieces: pieces.collect(),
        }
    }

    fn run(&self) -> Result<GripUse, NotDrivable> {
        self.is_finite()?;
        let instants = self.instants();
        let mut seen = instants.iter().fold(GripUse::default(), |seen, i| seen.max(self.used_at(i)));
        let mut found = seen;
        let mut open = Vec::new();
        // between two stretches of constant jerk, no time passes; but the next spiral may begin there
        let is_interval = |pair: &&[Instant]| pair[0].knot == pair[1].knot || pair[0].piece != pair[1].piece;
        for pair in instants.windows(2).filter(is_interval) {
            open.push((pair[0], pair[1]));
            while let Some((from, to)) = open.pop() {
                let bound = self.within(&from, &to);
                let is_inside = self.is_inside(&bound);
                let close =
                    bound.used.total <= seen.total + TOLERANCE && bound.used.turning <= seen.turning + TOLERANCE;
                if is_inside && close {
                    found = found.max(bound.used);
                } else if to.time - from.time > SHORTEST {
                    let middle = self.instant(from.knot, f64::midpoint(from.time, to.time), from.piece);
                    seen = seen.max(self.used_at(&middle));
                    open.extend([(middle, to), (from, middle)]);
                } else if is_inside {
                    found = found.max(bound.used);
                } else {
                    return Err(self.left(&from, &bound));
                }
            }
        }
        Ok(found)
    }

    /// Refuses numbers that are not finite: comparisons below would not see them.
    fn is_finite(&self) -> Result<(), NotDrivable> {
        let refused = |what| NotDrivable { time: self.trajectory.start_time, what, value: f64::NAN, limit: f64::MAX };
        for k in self.trajectory.profile.knots() {
            if !(k.time + k.station + k.speed + k.acceleration + k.jerk).is_finite() {
                return Err(refused(DrivingLimit::Speed));
            }
        }
        let is_finite = |p: &Piece| (p.per_length + p.curvature.0.iter().sum::<f64>()).is_finite();
        if self.pieces.iter().all(is_finite) { Ok(()) } else { Err(refused(DrivingLimit::Curvature)) }
    }

    /// Both ends of each stretch of constant jerk, and instants between them at equal steps.
    fn instants(&self) -> Vec<Instant> {
        let knots = self.trajectory.profile.knots();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a positive count
        let steps = |i: usize| ((knots[i + 1].time - knots[i].time) / LONGEST).ceil().clamp(1.0, MOST) as usize;
        let count = (0..knots.len() - 1).map(|i| steps(i) + 1).sum();
        let (mut instants, mut piece) = (Vec::with_capacity(count), 0);
        for i in 0..knots.len() - 1 {
            let count = steps(i);
            let step = (knots[i + 1].time - knots[i].time) / count as f64;
            for n in 0..=count {
                let instant = self.instant(i, n as f64 * step, piece);
                piece = instant.piece;
                instants.push(instant);
            }
        }
        instants
    }

    /// The motion at a time (s) after a knot; near this spiral.
    #[inline]
    fn instant(&self, knot: usize, time: f64, mut piece: usize) -> Instant {
        let SpeedKnot { station, speed, acceleration, .. } = self.trajectory.profile.knots()[knot].after(time);
        while piece + 1 < self.pieces.len() && self.pieces[piece + 1].station <= station {
            piece += 1;
        }
        while piece > 0 && self.pieces[piece].station > station {
            piece -= 1;
        }
        let spiral = &self.pieces[piece];
        let place = spiral.at(((station - spiral.station) * spiral.per_length).clamp(0.0, 1.0));
        Instant { knot, time, speed, acceleration, piece, place }
    }

    /// The use of the grip at an instant.
    #[inline]
    fn used_at(&self, instant: &Instant) -> GripUse {
        let Instant { speed, acceleration, piece, place, .. } = *instant;
        let curvature_rate = place.slope * self.pieces[piece].per_length;
        let motion = PathMotion { speed, acceleration, curvature: place.curvature, curvature_rate };
        self.grip.axles(&motion).used(place.curvature)
    }

    /// Bounds between two instants after the same knot.
    #[inline]
    fn within(&self, from: &Instant, to: &Instant) -> Bound {
        let mut speed = from.speed.max(to.speed);
        if from.knot == to.knot && from.acceleration > 0.0 && to.acceleration < 0.0 {
            // the speed at which the acceleration changes its sign
            let jerk = self.trajectory.profile.knots()[from.knot].jerk;
            speed = from.speed - 0.5 * from.acceleration * from.acceleration / jerk;
        }
        let bend = self.bend(from, to);
        let axles = |acceleration| {
            self.grip.axles(&PathMotion { speed, acceleration, curvature: bend.most, curvature_rate: bend.rate })
        };
        let mut axle_uses = axles(from.acceleration);
        if to.acceleration != from.acceleration {
            axle_uses = axle_uses.max(axles(to.acceleration));
        }
        let least = self.vehicle.wheelbase * bend.least;
        let steering_rate = self.vehicle.wheelbase * bend.rate * speed / (1.0 + least * least);
        Bound { speed, curvature: bend.most, steering_rate, used: axle_uses.used(bend.most) }
    }

    /// Bounds on the path between two instants.
    #[inline]
    fn bend(&self, from: &Instant, to: &Instant) -> Bend {
        // at a joint, rounding may put the end of a stretch behind the start of the next one
        let (from, to) = if from.piece > to.piece { (to, from) } else { (from, to) };
        let mut bend = Bend { most: 0.0, least: f64::INFINITY, rate: 0.0 };
        let mut start = from.place;
        for i in from.piece..to.piece {
            let (piece, next) = (&self.pieces[i], &self.pieces[i + 1]);
            bend.include(piece, &start, &piece.at(1.0));
            start = next.at(0.0);
            if next.jumps {
                bend.rate = f64::INFINITY;
            }
        }
        bend.include(&self.pieces[to.piece], &start, &to.place);
        bend
    }

    /// The limits with their bounds.
    #[inline]
    fn limits(&self, bound: &Bound) -> [(DrivingLimit, f64, f64); 4] {
        [
            (DrivingLimit::Curvature, bound.curvature, self.largest_curvature),
            (DrivingLimit::SteeringRate, bound.steering_rate, self.vehicle.limits.steering_rate),
            (DrivingLimit::Grip, bound.used.total, 1.0),
            (DrivingLimit::Speed, bound.speed, self.vehicle.tracking.largest_speed(&bound.used)),
        ]
    }

    /// Whether all bounds are within their limits; numbers that are not finite are not.
    #[inline]
    fn is_inside(&self, bound: &Bound) -> bool {
        self.limits(bound).iter().all(|(_, value, limit)| value <= limit)
    }

    /// The first limit that the bounds after an instant exceed.
    fn left(&self, from: &Instant, bound: &Bound) -> NotDrivable {
        let time = self.trajectory.start_time + self.trajectory.profile.knots()[from.knot].time + from.time;
        let exceeded = self.limits(bound).into_iter().find(|(_, value, limit)| value > limit || value.is_nan());
        let (what, value, limit) = exceeded.unwrap_or((DrivingLimit::Grip, bound.used.total, 1.0));
        NotDrivable { time, what, value, limit }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::geometry::spiral::CubicSpiral;
    use crate::trajectory::{Path, SpeedProfile};
    use crate::vehicle::load;

    /// Pieces of a profile: duration s, initial acceleration m/s², jerk m/s³.
    fn trajectory(speed: f64, pieces: &[(f64, f64, f64)], spirals: &[CubicSpiral]) -> Trajectory {
        let mut knot = SpeedKnot { time: 0.0, station: 0.0, speed, acceleration: 0.0, jerk: 0.0 };
        let mut knots = Vec::new();
        for &(duration, acceleration, jerk) in pieces {
            knots.push(SpeedKnot { acceleration, jerk, ..knot });
            knot = knots[knots.len() - 1].after(duration);
        }
        knots.push(SpeedKnot { acceleration: 0.0, jerk: 0.0, ..knot });
        let path = Path::new(Pose::new(0.0, 0.0, 0.3), spirals).unwrap();
        Trajectory { start_time: 7.0, path, profile: SpeedProfile::new(knots).unwrap() }
    }

    /// The use of the grip just after a time since the start.
    fn used_at(v: &Vehicle, t: &Trajectory, friction: f64, time: f64) -> GripUse {
        let k = t.profile.at(time);
        let (curvature, curvature_rate) = t.path.curvature_and_rate_at(k.station);
        PathMotion { speed: k.speed, acceleration: k.acceleration, curvature, curvature_rate }.grip_use(v, friction)
    }

    fn random(rng: &mut fastrand::Rng, v: &Vehicle) -> (Trajectory, f64) {
        let mut uniform = |from: f64, to: f64| from + (to - from) * rng.f64();
        let friction = if uniform(0.0, 1.0) < 0.5 { 1.0 } else { 0.5 };
        let speed = uniform(2.0, 0.7 * v.tracking.speed[2]);
        let (a, b) = (uniform(0.0, 1.0), uniform(0.5, 2.5));
        let jerk = b / uniform(0.2, 1.0);
        let pieces = [(1.0, 0.0, 0.0), (0.6, a, -2.0 * a / 0.6), (b / jerk, 0.0, -jerk), (0.8 * speed / b, -b, 0.0)];
        let largest = (uniform(0.2, 2.5) * friction / (speed * speed)).min(0.8 * v.max_curvature());
        let mut knots = [0.0; 4];
        let spirals: Vec<CubicSpiral> = (0..12)
            .map(|_| {
                knots = [knots[3], 0.0, 0.0, 0.0];
                knots[1..].fill_with(|| uniform(-largest, largest));
                CubicSpiral { knots, length: speed * uniform(0.8, 2.5) }
            })
            .collect();
        (trajectory(speed, &pieces, &spirals), friction)
    }

    /// By rounding, the stretch before a knot ends on the next spiral, and the one after it begins on the spiral before.
    #[test]
    fn a_knot_at_a_joint_is_no_demand_of_its_own() {
        let v = load("bmw_320i").unwrap();
        let bend = CubicSpiral { knots: [0.0, -0.02, 0.02, 0.0], length: 15.0 };
        let at = |time, station| SpeedKnot { time, station, speed: 7.0, acceleration: 0.0, jerk: 0.0 };
        let path = Path::new(Pose::new(0.0, 0.0, 0.0), &[bend, CubicSpiral::straight(15.0)]).unwrap();
        let used = [0.0, 1e-12].map(|rounding| {
            let knots = vec![at(0.0, 0.0), at(15.0 / 7.0, 15.0 - rounding), at(20.0 / 7.0, 20.0)];
            let profile = SpeedProfile::new(knots).unwrap();
            v.drivable(1.0, &Trajectory { start_time: 0.0, path: path.clone(), profile }).unwrap()
        });
        assert!((used[0].total - used[1].total).abs() < 1e-6, "{used:?}");
    }

    #[test]
    fn the_use_is_never_below_that_of_dense_samples_and_hardly_above() {
        let rng = &mut fastrand::Rng::with_seed(3);
        let mut driven = 0;
        for i in 0..300 {
            let v = load(["bmw_320i", "ford_escort", "truck"][i % 3]).unwrap();
            let (t, friction) = random(rng, &v);
            let times = |from: f64, to: f64| {
                let count = ((to - from) / 1e-3).ceil();
                (0..=count as usize).map(move |n| from + (to - from) * n as f64 / count)
            };
            let sampled = |from, to| {
                times(from, to).map(|time| used_at(&v, &t, friction, time)).fold(GripUse::default(), GripUse::max)
            };
            let inside = times(0.0, t.profile.duration()).all(|time| {
                let used = used_at(&v, &t, friction, time);
                v.tracking.contains(t.profile.at(time).speed, &used)
            });
            match v.drivable(friction, &t) {
                Ok(used) => {
                    assert!(inside, "{i}");
                    let dense = sampled(0.0, t.profile.duration());
                    assert!(used.total >= dense.total && used.total <= dense.total + 0.04, "{i}: {used:?} {dense:?}");
                    assert!(
                        used.turning >= dense.turning && used.turning <= dense.turning + 0.04,
                        "{i}: {used:?} {dense:?}"
                    );
                    driven += 1;
                }
                Err(left @ NotDrivable { what: DrivingLimit::Grip, time, value, .. }) => {
                    let since = time - t.start_time;
                    let dense = sampled(since, (since + SHORTEST).min(t.profile.duration()));
                    assert!(
                        value >= used_at(&v, &t, friction, since).total && value <= 1.06 * dense.total,
                        "{i}: {left:?} {dense:?}"
                    );
                    let before = (since > 1e-3).then(|| sampled(0.0, since - 1e-3));
                    assert!(before.is_none_or(|used| used.total <= 1.0), "{i}: {left:?} {before:?}");
                }
                Err(left) => assert!(left.value > left.limit, "{i}: {left:?}"),
            }
        }
        assert!((60..240).contains(&driven), "{driven} of 300 are drivable");
    }

    #[test]
    fn the_error_says_which_limit_is_exceeded_and_when_first() {
        let v = load("bmw_320i").unwrap();
        let line = |length| CubicSpiral::straight(length);
        let arc = |k: f64, length| CubicSpiral { knots: [k; 4], length };
        let into = |k: f64, length| CubicSpiral { knots: [0.0, k / 3.0, k / 1.5, k], length };
        let cruise = |speed: f64| [(200.0 / speed, 0.0, 0.0)];
        let tightest = v.max_curvature();
        for (what, from, to, t) in [
            // braking harder than proofs may, from 2 s on
            (DrivingLimit::Grip, 2.0, 2.0, trajectory(10.0, &[(2.0, 0.0, 0.0), (0.5, -9.5, 0.0)], &[line(200.0)])),
            // 9 m/s² on the arc, which begins at 30 m
            (
                DrivingLimit::Grip,
                1.5,
                3.0,
                trajectory(15.0, &cruise(15.0), &[line(20.0), into(0.04, 25.0), arc(0.04, 200.0)]),
            ),
            // faster than the bounds were measured
            (DrivingLimit::Speed, 0.0, 0.0, trajectory(v.tracking.speed[0] + 0.1, &cruise(30.0), &[line(400.0)])),
            // with three quarters of the grip, turning at more than the lower speed
            (
                DrivingLimit::Speed,
                3.5,
                5.0,
                trajectory(20.0, &cruise(20.0), &[line(20.0), into(0.017, 80.0), arc(0.017, 300.0)]),
            ),
            (
                DrivingLimit::SteeringRate,
                5.0,
                6.0,
                trajectory(2.0, &cruise(2.0), &[line(10.0), into(0.15, 0.5), arc(0.15, 200.0)]),
            ),
            // a jump of the curvature
            (DrivingLimit::SteeringRate, 4.8, 5.0, trajectory(2.0, &cruise(2.0), &[line(10.0), arc(0.01, 200.0)])),
            (
                DrivingLimit::Curvature,
                12.0,
                15.0,
                trajectory(1.0, &cruise(1.0), &[line(10.0), into(tightest, 5.0), arc(tightest, 200.0)]),
            ),
        ] {
            let left = v.drivable(1.0, &t).unwrap_err();
            assert_eq!(left.what, what, "{left}");
            let since = left.time - t.start_time;
            assert!(since >= from - SHORTEST && since <= to + SHORTEST, "{what:?}: {left}");
            assert!(left.value > left.limit && left.to_string().contains("limit"), "{left}");
        }
    }

    #[test]
    fn on_a_motorway_gentle_turns_and_firm_straight_braking_are_inside() {
        for name in ["bmw_320i", "ford_escort"] {
            let v = load(name).unwrap();
            let speed = v.tracking.speed[0] - 0.5;
            let bow = |k: f64| CubicSpiral { knots: [0.0, k, k, 0.0], length: 100.0 };
            let cruise = [(5.5, 0.0, 0.0)];
            let stop = |d: f64| [(1.0, 0.0, 0.0), (d / 2.5, 0.0, -2.5), (4.0, -d, 0.0)];
            let line = [CubicSpiral::straight(400.0)];
            let lanes = [bow(1.2 / (speed * speed)), bow(-1.2 / (speed * speed))];
            let gentle = v.drivable(1.0, &trajectory(speed, &cruise, &lanes)).unwrap();
            assert!(gentle.total <= TrackingTube::GENTLE_USE && gentle.turning > 0.15, "{name}: {gentle:?}");
            let firm = v.drivable(1.0, &trajectory(speed, &stop(4.2), &line)).unwrap();
            assert!(firm.total <= TrackingTube::STRAIGHT_BRAKING && firm.total > 0.45, "{name}: {firm:?}");
            // harder braking at this speed, or as hard in a turn, may spin the vehicle
            for (braking, path) in [(6.0, &line[..]), (4.2, &lanes)] {
                let left = v.drivable(1.0, &trajectory(speed, &stop(braking), path)).unwrap_err();
                assert!(left.what == DrivingLimit::Speed && left.limit < speed, "{name}: {left}");
            }
        }
    }

    #[test]
    fn standing_still_uses_hardly_any_grip_and_numbers_that_are_not_finite_are_refused() {
        let v = load("truck").unwrap();
        let line = [CubicSpiral::straight(5.0)];
        let used = v.drivable(1.0, &trajectory(0.0, &[(3.0, 0.0, 0.0)], &line)).unwrap();
        assert!(used.total < 0.02 && used.turning == 0.0, "{used:?}");
        assert!(v.drivable(1.0, &trajectory(f64::NAN, &[(3.0, 0.0, 0.0)], &line)).is_err());
        let bent = [CubicSpiral { knots: [0.0, f64::NAN, 0.0, 0.0], length: 5.0 }];
        assert!(v.drivable(1.0, &trajectory(1.0, &[(3.0, 0.0, 0.0)], &bent)).is_err());
    }
}
