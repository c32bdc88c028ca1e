//! The speed profiles of the planning lecture in closed form: the linear ramp and the trapezoid.
//!
//! Both are functions of the station. A *ramp* goes from one speed to another at constant acceleration over a given way,
//! a = (v_f² − v_0²)/2s; where the limits clamp that acceleration, it comes to another end speed and says so. A
//! *trapezoid* goes to a transit speed, holds it, and comes to its end speed at the last station: the way to stop at a
//! line. Where the way is too short for the transit speed it becomes a triangle with the peak that still fits,
//!
//! ```text
//! v_p² = (2 a d s + d v_0² + a v_f²) / (a + d)
//! ```
//!
//! and where it is too short to come to the end speed at all, it brakes as hard as allowed and says what is left.
//! (The lecture prints the third segment with the first one's acceleration; it is the deceleration that leads to v_f at
//! s_f.)
//!
//! Weak: neither knows of moving obstacles nor of jerk. The planner searches and smooths instead; these are the reference
//! to compare with, and enough where nothing moves.

use super::{AccelerationLimits, ProblemError};
use crate::trajectory::{SpeedKnot, SpeedProfile};

/// Constant acceleration from one speed towards another over a given way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramp {
    /// Speed at station 0, m/s.
    pub start_speed: f64,
    /// Acceleration, within the limits, m/s².
    pub acceleration: f64,
    /// Station at which the ramp ends: that of the wanted speed, or the end of the way, m.
    pub end: f64,
    /// Speed there, and after it, m/s.
    pub end_speed: f64,
}

/// Up to a transit speed, along at it, down to the end speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trapezoid {
    /// Speed at station 0, m/s.
    pub start_speed: f64,
    /// Speed of the middle, m/s; the peak, where the middle has no length.
    pub transit_speed: f64,
    /// Speed at the last station, m/s. Above the one asked for where braking as hard as allowed is not enough.
    pub end_speed: f64,
    /// Stations at which the middle begins and ends, and the last station, m.
    pub stations: [f64; 3],
}

/// Speed after a way `s` at constant acceleration: v² = v_0² + 2as, not below rest.
fn speed_after(speed: f64, acceleration: f64, s: f64) -> f64 {
    (speed * speed + 2.0 * acceleration * s).max(0.0).sqrt()
}

/// Speeds and ways must be numbers that are not negative, accelerations positive ones.
fn checked(values: &[(&'static str, f64)], limits: &AccelerationLimits) -> Result<(), ProblemError> {
    let wrong = values.iter().find(|(_, v)| !(*v >= 0.0 && v.is_finite()));
    if let Some(&(what, value)) = wrong {
        return Err(ProblemError::Value { what, value, expected: "a number, not negative" });
    }
    limits.validate()
}

impl Ramp {
    /// The ramp from `start_speed` to `reference_speed` (m/s) over `way` metres: exactly there if the limits allow it (the
    /// comfortable deceleration, when braking). With the acceleration clamped it reaches the speed later, never within the
    /// way, or not at all.
    ///
    /// # Errors
    /// [`ProblemError::Value`] for a number that can't be one.
    pub fn new(
        start_speed: f64,
        reference_speed: f64,
        way: f64,
        limits: &AccelerationLimits,
    ) -> Result<Self, ProblemError> {
        checked(&[("start speed", start_speed), ("wanted speed", reference_speed), ("way", way)], limits)?;
        let squares = reference_speed * reference_speed - start_speed * start_speed;
        // no way at all asks for an unbounded acceleration, which the limits clamp
        let needed = if squares == 0.0 { 0.0 } else { squares / (2.0 * way) };
        let acceleration = needed.clamp(-limits.deceleration, limits.acceleration);
        let clamped = acceleration != needed;
        let end_speed = if clamped { speed_after(start_speed, acceleration, way) } else { reference_speed };
        Ok(Self { start_speed, acceleration, end: way, end_speed })
    }

    /// Speed at a station, m/s.
    #[must_use]
    pub fn speed_at(&self, s: f64) -> f64 {
        if s >= self.end { self.end_speed } else { speed_after(self.start_speed, self.acceleration, s.max(0.0)) }
    }
}

impl Trapezoid {
    /// From `start_speed` towards `transit_speed`, and down to `end_speed` (m/s) after `way` metres, with the comfortable
    /// accelerations; the aggressive deceleration is used where the comfortable one is not enough.
    ///
    /// # Errors
    /// [`ProblemError::Value`] for a number that can't be one.
    pub fn new(
        start_speed: f64,
        transit_speed: f64,
        end_speed: f64,
        way: f64,
        limits: &AccelerationLimits,
    ) -> Result<Self, ProblemError> {
        let speeds = [("start speed", start_speed), ("transit speed", transit_speed), ("end speed", end_speed)];
        checked(&[&speeds[..], &[("way", way)]].concat(), limits)?;
        let (a, d) = (limits.acceleration, limits.deceleration);
        let square = |v: f64| v * v;
        // as if there were room for it, by which rate the transit speed is reached from either side
        let first = if transit_speed >= start_speed { a } else { -d };
        let last = if transit_speed >= end_speed { -d } else { a };
        let up = (square(transit_speed) - square(start_speed)) / (2.0 * first);
        let down = (square(end_speed) - square(transit_speed)) / (2.0 * last);
        if up + down <= way {
            return Ok(Self { start_speed, transit_speed, end_speed, stations: [up, way - down, way] });
        }
        let needed = (square(start_speed) - square(end_speed)) / (2.0 * way);
        if needed >= d {
            // all of the way is braking, and harder than is comfortable
            let hardest = needed.min(limits.aggressive_deceleration);
            let end_speed = if hardest < needed { speed_after(start_speed, -hardest, way) } else { end_speed };
            return Ok(Self { start_speed, transit_speed: start_speed, end_speed, stations: [0.0, 0.0, way] });
        }
        if -needed >= a {
            // all of the way is accelerating, and the end speed is not reached
            let end_speed = speed_after(start_speed, a, way);
            return Ok(Self { start_speed, transit_speed: end_speed, end_speed, stations: [way; 3] });
        }
        if transit_speed < start_speed.min(end_speed) {
            // down towards a slow middle and up again: the valley that fits
            let low = (d * square(end_speed) + a * square(start_speed) - 2.0 * a * d * way) / (a + d);
            let valley = low.max(0.0).sqrt();
            let turn = (square(start_speed) - square(valley)) / (2.0 * d);
            return Ok(Self { start_speed, transit_speed: valley, end_speed, stations: [turn, turn, way] });
        }
        let peak = ((2.0 * a * d * way + d * square(start_speed) + a * square(end_speed)) / (a + d)).sqrt();
        let turn = (square(peak) - square(start_speed)) / (2.0 * a);
        Ok(Self { start_speed, transit_speed: peak, end_speed, stations: [turn, turn, way] })
    }

    /// The three accelerations, m/s²; 0 for a segment without length.
    #[must_use]
    pub fn accelerations(&self) -> [f64; 3] {
        let [up, down, end] = self.stations;
        let rate = |from: f64, to: f64, way: f64| if way > 0.0 { (to * to - from * from) / (2.0 * way) } else { 0.0 };
        [rate(self.start_speed, self.transit_speed, up), 0.0, rate(self.transit_speed, self.end_speed, end - down)]
    }

    /// Speed at a station, m/s.
    #[must_use]
    pub fn speed_at(&self, s: f64) -> f64 {
        let [up, down, end] = self.stations;
        let [first, _, last] = self.accelerations();
        if s >= end {
            self.end_speed
        } else if s >= down {
            speed_after(self.transit_speed, last, s - down)
        } else if s >= up {
            self.transit_speed
        } else {
            speed_after(self.start_speed, first, s.max(0.0))
        }
    }

    /// The same over time. `None` if it takes for ever: it would have to begin or to go on from rest without accelerating.
    #[must_use]
    pub fn profile(&self) -> Option<SpeedProfile> {
        let [up, down, end] = self.stations;
        let [first, _, last] = self.accelerations();
        let speeds = [self.start_speed, self.transit_speed, self.transit_speed, self.end_speed];
        let stations = [0.0, up, down, end];
        let mut time = 0.0;
        let mut knots = Vec::with_capacity(4);
        for (i, acceleration) in [first, 0.0, last, 0.0].into_iter().enumerate() {
            knots.push(SpeedKnot { time, station: stations[i], speed: speeds[i], acceleration, jerk: 0.0 });
            if i < 3 && stations[i + 1] > stations[i] {
                time += 2.0 * (stations[i + 1] - stations[i]) / (speeds[i] + speeds[i + 1]);
            }
        }
        // of segments without length only the last knot counts
        let mut kept: Vec<SpeedKnot> = Vec::with_capacity(4);
        for knot in knots {
            if kept.last().is_some_and(|k| k.time == knot.time) {
                kept.pop();
            }
            kept.push(knot);
        }
        if time.is_finite() { SpeedProfile::new(kept) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LIMITS: AccelerationLimits =
        AccelerationLimits { acceleration: 1.5, deceleration: 2.0, aggressive_deceleration: 4.0 };

    #[test]
    fn a_ramp_has_the_lectures_acceleration() {
        let ramp = Ramp::new(5.0, 10.0, 30.0, &LIMITS).unwrap();
        assert!((ramp.acceleration - 75.0 / 60.0).abs() < 1e-12);
        assert_eq!(ramp.end_speed, 10.0);
        assert!((ramp.speed_at(10.0) - (25.0 + 25.0_f64).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_clamped_ramp_says_what_it_comes_to() {
        let up = Ramp::new(0.0, 10.0, 10.0, &LIMITS).unwrap();
        assert_eq!(up.acceleration, 1.5);
        assert!((up.end_speed - 30.0_f64.sqrt()).abs() < 1e-12);
        let down = Ramp::new(10.0, 0.0, 10.0, &LIMITS).unwrap();
        assert_eq!(down.acceleration, -2.0);
        assert!((down.end_speed - 60.0_f64.sqrt()).abs() < 1e-12);
        let no_way = Ramp::new(3.0, 4.0, 0.0, &LIMITS).unwrap();
        assert_eq!((no_way.end_speed, no_way.speed_at(0.0)), (3.0, 3.0));
    }

    #[test]
    fn a_trapezoid_has_the_lectures_stations() {
        let t = Trapezoid::new(5.0, 10.0, 0.0, 100.0, &LIMITS).unwrap();
        assert_eq!(t.stations, [25.0, 75.0, 100.0]);
        assert_eq!(t.speed_at(50.0), 10.0);
        assert_eq!(t.speed_at(100.0), 0.0);
        // the corrected third segment: the deceleration, not the first acceleration
        assert!((t.speed_at(90.0) - (100.0 - 2.0 * 2.0 * 15.0_f64).sqrt()).abs() < 1e-12);
        assert!((t.profile().unwrap().duration() - (10.0 / 3.0 + 5.0 + 5.0)).abs() < 1e-12);
    }

    #[test]
    fn too_short_a_way_makes_a_triangle_or_an_aggressive_stop_or_tells_what_is_left() {
        let triangle = Trapezoid::new(0.0, 15.0, 0.0, 30.0, &LIMITS).unwrap();
        assert!(triangle.transit_speed < 15.0);
        let [first, _, last] = triangle.accelerations();
        assert!((first - 1.5).abs() < 1e-9 && (last + 2.0).abs() < 1e-9);

        let hard = Trapezoid::new(10.0, 10.0, 0.0, 20.0, &LIMITS).unwrap();
        assert_eq!(hard.end_speed, 0.0);
        assert!((hard.accelerations()[2] + 2.5).abs() < 1e-12);

        let left = Trapezoid::new(10.0, 10.0, 0.0, 10.0, &LIMITS).unwrap();
        assert!((left.end_speed - 20.0_f64.sqrt()).abs() < 1e-12, "{left:?}");
    }

    #[test]
    fn each_wrong_number_is_an_error() {
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(Ramp::new(bad, 1.0, 1.0, &LIMITS).is_err());
            assert!(Ramp::new(1.0, bad, 1.0, &LIMITS).is_err());
            assert!(Ramp::new(1.0, 1.0, bad, &LIMITS).is_err());
            assert!(Trapezoid::new(bad, 1.0, 1.0, 1.0, &LIMITS).is_err());
            assert!(Trapezoid::new(1.0, bad, 1.0, 1.0, &LIMITS).is_err());
            assert!(Trapezoid::new(1.0, 1.0, bad, 1.0, &LIMITS).is_err());
            assert!(Trapezoid::new(1.0, 1.0, 1.0, bad, &LIMITS).is_err());
        }
        let aggressive_below = AccelerationLimits { aggressive_deceleration: 1.0, ..LIMITS };
        assert!(Trapezoid::new(1.0, 1.0, 1.0, 1.0, &aggressive_below).is_err());
    }

    #[test]
    fn standing_for_ever_is_no_profile() {
        assert_eq!(Trapezoid::new(0.0, 0.0, 0.0, 10.0, &LIMITS).unwrap().profile(), None);
    }

    proptest! {
        #[test]
        fn no_acceleration_leaves_its_limits_and_speeds_are_continuous(
            v0 in 0.0..20.0f64, transit in 0.0..20.0f64, vf in 0.0..20.0f64, way in 0.01..300.0f64,
        ) {
            let t = Trapezoid::new(v0, transit, vf, way, &LIMITS).unwrap();
            let [first, _, last] = t.accelerations();
            for a in [first, last] {
                prop_assert!((-4.0 - 1e-9..=1.5 + 1e-9).contains(&a), "{:?} {}", t, a);
            }
            let [up, down, end] = t.stations;
            prop_assert!(0.0 <= up && up <= down + 1e-9 && down <= end && end == way, "{:?}", t);
            prop_assert!((t.speed_at(0.0) - v0).abs() < 1e-9 || up == 0.0);
            for s in [up, down, end] {
                let jump = t.speed_at(s - 1e-9).powi(2) - t.speed_at(s + 1e-9).powi(2);
                prop_assert!(jump.abs() < 1e-6, "{:?} jumps by {} at {}", t, jump, s);
            }
        }

        /// Against integration in small steps of time.
        #[test]
        fn profile_over_time_and_speeds_over_stations_agree(
            v0 in 0.0..15.0f64, transit in 0.5..15.0f64, vf in 0.0..15.0f64, way in 1.0..200.0f64,
        ) {
            let t = Trapezoid::new(v0, transit, vf, way, &LIMITS).unwrap();
            let profile = t.profile().unwrap();
            prop_assert!((profile.last().station - way).abs() < 1e-9);
            let (steps, mut station) = (2000, 0.0);
            let h = profile.duration() / f64::from(steps);
            for i in 0..steps {
                let here = profile.at(h * f64::from(i));
                prop_assert!((here.speed - t.speed_at(here.station)).abs() < 1e-4, "{:?} at {:?}", t, here);
                station += h * profile.at(h * (f64::from(i) + 0.5)).speed;
            }
            prop_assert!((station - way).abs() < 1e-2 * (1.0 + way * 0.01), "{} of {}", station, way);
        }
    }
}
