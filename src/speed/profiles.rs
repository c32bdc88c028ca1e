//! The speed profiles of the planning lecture in closed form: linear ramp and trapezoid.
//!
//! Both are functions of the station. A *ramp* changes the speed at constant acceleration over a given distance `s`, a
//! = (v_f² − v_0²)/2s. If the limits clamp the acceleration, the ramp ends at another speed, which it reports. A
//! *trapezoid* changes to a transit speed, keeps it, and reaches its end speed at the last station, for example to stop
//! at a line. If the distance is too short for the transit speed, the trapezoid becomes a triangle with the peak speed
//!
//! ```text
//! v_p² = (2 a d s + d v_0² + a v_f²) / (a + d)
//! ```
//!
//! If the distance is too short for the end speed too, the profile brakes with the aggressive deceleration at most and
//! reports the speed that remains. (The lecture prints the third segment with the acceleration of the first. The
//! correct value is the deceleration that reaches v_f at s_f.)
//!
//! Weakness: these profiles ignore moving obstacles and jerk. They serve as a reference for the search and the
//! smoothing, and suffice on roads without moving obstacles.

use super::{AccelerationLimits, ProblemError};
use crate::trajectory::{SpeedKnot, SpeedProfile};

/// Constant acceleration from one speed towards another over a given distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramp {
    /// Speed at station 0, m/s.
    pub start_speed: f64,
    /// Acceleration, within the limits, m/s².
    pub acceleration: f64,
    /// Last station of the ramp, m.
    pub end: f64,
    /// Speed at the last station and beyond it, m/s.
    pub end_speed: f64,
}

/// Change to a transit speed, constant speed, change to the end speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trapezoid {
    /// Speed at station 0, m/s.
    pub start_speed: f64,
    /// Speed of the middle segment, m/s; the peak speed if that segment is empty.
    pub transit_speed: f64,
    /// Speed at the last station, m/s. It exceeds the requested speed if the aggressive deceleration does not suffice.
    pub end_speed: f64,
    /// Start and end of the middle segment, and the last station, m.
    pub stations: [f64; 3],
}

/// Speed (m/s) after a distance `s` (m) at constant acceleration (m/s²): v² = v_0² + 2as; zero after a standstill.
fn speed_after(speed: f64, acceleration: f64, s: f64) -> f64 {
    (speed * speed + 2.0 * acceleration * s).max(0.0).sqrt()
}

/// Checks that all values are finite and non-negative and that the limits are valid.
fn validate(values: &[(&'static str, f64)], limits: &AccelerationLimits) -> Result<(), ProblemError> {
    let invalid = values.iter().find(|(_, v)| !(*v >= 0.0 && v.is_finite()));
    if let Some(&(what, value)) = invalid {
        return Err(ProblemError::Value { what, value, expected: "finite and non-negative" });
    }
    limits.validate()
}

impl Ramp {
    /// The ramp from `start_speed` to `reference_speed` (m/s) over `distance` (m). It reaches the reference speed at
    /// the last station if the comfortable limits allow it. Otherwise they clamp the acceleration and the end speed
    /// differs.
    ///
    /// # Errors
    /// [`ProblemError::Value`] for an invalid speed, distance or limit.
    pub fn new(
        start_speed: f64,
        reference_speed: f64,
        distance: f64,
        limits: &AccelerationLimits,
    ) -> Result<Self, ProblemError> {
        validate(
            &[("start speed", start_speed), ("reference speed", reference_speed), ("distance", distance)],
            limits,
        )?;
        let squares = reference_speed * reference_speed - start_speed * start_speed;
        // a zero distance requires an infinite acceleration, which the limits clamp
        let needed = if squares == 0.0 { 0.0 } else { squares / (2.0 * distance) };
        let acceleration = needed.clamp(-limits.deceleration, limits.acceleration);
        let is_clamped = acceleration != needed;
        let end_speed = if is_clamped { speed_after(start_speed, acceleration, distance) } else { reference_speed };
        Ok(Self { start_speed, acceleration, end: distance, end_speed })
    }

    /// Speed at a station, m/s.
    #[must_use]
    pub fn speed_at(&self, s: f64) -> f64 {
        if s >= self.end { self.end_speed } else { speed_after(self.start_speed, self.acceleration, s.max(0.0)) }
    }
}

impl Trapezoid {
    /// The profile from `start_speed` over `transit_speed` to `end_speed` (m/s) after `distance` (m). It uses the
    /// comfortable limits, and the aggressive deceleration where the comfortable one does not suffice.
    ///
    /// # Errors
    /// [`ProblemError::Value`] for an invalid speed, distance or limit.
    pub fn new(
        start_speed: f64,
        transit_speed: f64,
        end_speed: f64,
        distance: f64,
        limits: &AccelerationLimits,
    ) -> Result<Self, ProblemError> {
        let speeds = [("start speed", start_speed), ("transit speed", transit_speed), ("end speed", end_speed)];
        validate(&[&speeds[..], &[("distance", distance)]].concat(), limits)?;
        let (a, d) = (limits.acceleration, limits.deceleration);
        let square = |v: f64| v * v;
        // lengths of the first and the third segment if the profile reaches the transit speed
        let first = if transit_speed >= start_speed { a } else { -d };
        let last = if transit_speed >= end_speed { -d } else { a };
        let up = (square(transit_speed) - square(start_speed)) / (2.0 * first);
        let down = (square(end_speed) - square(transit_speed)) / (2.0 * last);
        if up + down <= distance {
            return Ok(Self { start_speed, transit_speed, end_speed, stations: [up, distance - down, distance] });
        }
        let needed = (square(start_speed) - square(end_speed)) / (2.0 * distance);
        if needed >= d {
            // braking only, harder than comfortable
            let deceleration = needed.min(limits.aggressive_deceleration);
            let end_speed =
                if deceleration < needed { speed_after(start_speed, -deceleration, distance) } else { end_speed };
            return Ok(Self { start_speed, transit_speed: start_speed, end_speed, stations: [0.0, 0.0, distance] });
        }
        if -needed >= a {
            // acceleration only, without reaching the end speed
            let end_speed = speed_after(start_speed, a, distance);
            return Ok(Self { start_speed, transit_speed: end_speed, end_speed, stations: [distance; 3] });
        }
        if transit_speed < start_speed.min(end_speed) {
            // an inverted triangle: brakes to the lowest speed that the distance allows, then accelerates
            let low = (d * square(end_speed) + a * square(start_speed) - 2.0 * a * d * distance) / (a + d);
            let valley = low.max(0.0).sqrt();
            let turn = (square(start_speed) - square(valley)) / (2.0 * d);
            return Ok(Self { start_speed, transit_speed: valley, end_speed, stations: [turn, turn, distance] });
        }
        let peak = ((2.0 * a * d * distance + d * square(start_speed) + a * square(end_speed)) / (a + d)).sqrt();
        let turn = (square(peak) - square(start_speed)) / (2.0 * a);
        Ok(Self { start_speed, transit_speed: peak, end_speed, stations: [turn, turn, distance] })
    }

    /// Accelerations of the three segments, m/s²; 0 for an empty segment.
    #[must_use]
    pub fn accelerations(&self) -> [f64; 3] {
        let [up, down, end] = self.stations;
        let rate = |from: f64, to: f64, length: f64| {
            if length > 0.0 { (to * to - from * from) / (2.0 * length) } else { 0.0 }
        };
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

    /// The profile over time. `None` if its duration is infinite: it starts or continues from standstill without
    /// acceleration.
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
        // an empty segment has two knots at one time: the last one replaces the others
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
    fn ramp_has_the_lectures_acceleration() {
        let ramp = Ramp::new(5.0, 10.0, 30.0, &LIMITS).unwrap();
        assert!((ramp.acceleration - 75.0 / 60.0).abs() < 1e-12);
        assert_eq!(ramp.end_speed, 10.0);
        assert!((ramp.speed_at(10.0) - (25.0 + 25.0_f64).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn clamped_ramp_reports_its_end_speed() {
        let up = Ramp::new(0.0, 10.0, 10.0, &LIMITS).unwrap();
        assert_eq!(up.acceleration, 1.5);
        assert!((up.end_speed - 30.0_f64.sqrt()).abs() < 1e-12);
        let down = Ramp::new(10.0, 0.0, 10.0, &LIMITS).unwrap();
        assert_eq!(down.acceleration, -2.0);
        assert!((down.end_speed - 60.0_f64.sqrt()).abs() < 1e-12);
        let empty = Ramp::new(3.0, 4.0, 0.0, &LIMITS).unwrap();
        assert_eq!((empty.end_speed, empty.speed_at(0.0)), (3.0, 3.0));
    }

    #[test]
    fn trapezoid_has_the_lectures_stations() {
        let t = Trapezoid::new(5.0, 10.0, 0.0, 100.0, &LIMITS).unwrap();
        assert_eq!(t.stations, [25.0, 75.0, 100.0]);
        assert_eq!(t.speed_at(50.0), 10.0);
        assert_eq!(t.speed_at(100.0), 0.0);
        // the corrected third segment: the deceleration, not the first acceleration
        assert!((t.speed_at(90.0) - (100.0 - 2.0 * 2.0 * 15.0_f64).sqrt()).abs() < 1e-12);
        assert!((t.profile().unwrap().duration() - (10.0 / 3.0 + 5.0 + 5.0)).abs() < 1e-12);
    }

    #[test]
    fn short_distance_gives_a_triangle_an_aggressive_stop_or_a_remaining_speed() {
        let triangle = Trapezoid::new(0.0, 15.0, 0.0, 30.0, &LIMITS).unwrap();
        assert!(triangle.transit_speed < 15.0);
        let [first, _, last] = triangle.accelerations();
        assert!((first - 1.5).abs() < 1e-9 && (last + 2.0).abs() < 1e-9);

        let hard = Trapezoid::new(10.0, 10.0, 0.0, 20.0, &LIMITS).unwrap();
        assert_eq!(hard.end_speed, 0.0);
        assert!((hard.accelerations()[2] + 2.5).abs() < 1e-12);

        let moving = Trapezoid::new(10.0, 10.0, 0.0, 10.0, &LIMITS).unwrap();
        assert!((moving.end_speed - 20.0_f64.sqrt()).abs() < 1e-12, "{moving:?}");
    }

    #[test]
    fn rejects_each_invalid_value() {
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
    fn profile_of_infinite_duration_is_none() {
        assert_eq!(Trapezoid::new(0.0, 0.0, 0.0, 10.0, &LIMITS).unwrap().profile(), None);
    }

    proptest! {
        #[test]
        fn accelerations_stay_within_limits_and_speeds_are_continuous(
            v0 in 0.0..20.0f64, transit in 0.0..20.0f64, vf in 0.0..20.0f64, distance in 0.01..300.0f64,
        ) {
            let t = Trapezoid::new(v0, transit, vf, distance, &LIMITS).unwrap();
            let [first, _, last] = t.accelerations();
            for a in [first, last] {
                prop_assert!((-4.0 - 1e-9..=1.5 + 1e-9).contains(&a), "{:?} {}", t, a);
            }
            let [up, down, end] = t.stations;
            prop_assert!(0.0 <= up && up <= down + 1e-9 && down <= end && end == distance, "{:?}", t);
            prop_assert!((t.speed_at(0.0) - v0).abs() < 1e-9 || up == 0.0);
            for s in [up, down, end] {
                let jump = t.speed_at(s - 1e-9).powi(2) - t.speed_at(s + 1e-9).powi(2);
                prop_assert!(jump.abs() < 1e-6, "{:?} jumps by {} at {}", t, jump, s);
            }
        }

        /// Compares with an integration in small time steps.
        #[test]
        fn profile_over_time_matches_speeds_over_stations(
            v0 in 0.0..15.0f64, transit in 0.5..15.0f64, vf in 0.0..15.0f64, distance in 1.0..200.0f64,
        ) {
            let t = Trapezoid::new(v0, transit, vf, distance, &LIMITS).unwrap();
            let profile = t.profile().unwrap();
            prop_assert!((profile.last().station - distance).abs() < 1e-9);
            let (steps, mut station) = (2000, 0.0);
            let h = profile.duration() / f64::from(steps);
            for i in 0..steps {
                let here = profile.at(h * f64::from(i));
                prop_assert!((here.speed - t.speed_at(here.station)).abs() < 1e-4, "{:?} at {:?}", t, here);
                station += h * profile.at(h * (f64::from(i) + 0.5)).speed;
            }
            prop_assert!((station - distance).abs() < 1e-2 * (1.0 + distance * 0.01), "{} of {}", station, distance);
        }
    }
}
