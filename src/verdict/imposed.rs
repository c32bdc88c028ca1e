//! The acceleration that a start imposes: it takes its time to go, and a run or a plan is not charged with it.
//!
//! The allowance is what the vehicle has at the start, in full for [`HANDOVER`], and decreases at [`RELEASE`] then. It is read
//! from the first sample of a log, which is logged before any command of the run acts: a plan cannot brake hard and excuse
//! itself. The comfort checks use it for a run, `fallback_stops` for a branch.

use crate::simulation::{GRAVITY, Log, Sample};
use crate::vehicle::Vehicle;

/// How long an imposed acceleration may last in full, s: the lag of brakes, drive and steering.
pub(super) const HANDOVER: f64 = 0.1;
/// Least rate at which an imposed acceleration decreases then, and the jerk of its release that is never charged, m/s³. It is
/// less than the jerk limit of every preset and bundled vehicle (at least 2.5), so that a comfortable release stays within
/// the allowance.
pub(super) const RELEASE: f64 = 1.5;

/// An acceleration that a start imposes, along one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Imposed {
    /// Time of the start, s.
    begins: f64,
    /// At the start, m/s², with its sign.
    acceleration: f64,
}

impl Imposed {
    /// The longitudinal acceleration at the start of a log. A file can state any number; tyres give at most their friction.
    pub(super) fn longitudinal(vehicle: &Vehicle, log: &Log) -> Self {
        Self::at(log.samples.first(), vehicle, |s| s.acceleration)
    }

    /// The lateral acceleration at the start of a log: of the speed and of the curvature that the steering angle gives. The
    /// forces of the tyres build up only in the first tenths of a second.
    pub(super) fn lateral(vehicle: &Vehicle, log: &Log) -> Self {
        let curvature = |s: &Sample| s.steering.tan() / vehicle.wheelbase;
        Self::at(log.samples.first(), vehicle, |s| s.speed * s.speed * curvature(s))
    }

    fn at(start: Option<&Sample>, vehicle: &Vehicle, value: impl Fn(&Sample) -> f64) -> Self {
        let most = vehicle.tyres.friction * GRAVITY;
        let acceleration = start.map_or(0.0, value);
        let finite = if acceleration.is_finite() { acceleration.clamp(-most, most) } else { 0.0 };
        Self { begins: start.map_or(0.0, |s| s.time), acceleration: finite }
    }

    /// At least a deceleration that a plan before imposes, m/s².
    pub(super) fn with_deceleration(self, deceleration: f64) -> Self {
        Self { acceleration: self.acceleration.min(-deceleration), ..self }
    }

    /// The acceleration at the start, m/s².
    pub(super) fn acceleration(&self) -> f64 {
        self.acceleration
    }

    /// What remains at a time, m/s², at least 0; without its sign.
    fn remaining(&self, time: f64) -> f64 {
        let released = RELEASE * (time - self.begins - HANDOVER).max(0.0);
        (self.acceleration.abs() - released).max(0.0)
    }

    /// The allowance for an acceleration of a sign at a time, m/s²; 0 for the other direction.
    pub(super) fn allows(&self, acceleration: f64, time: f64) -> f64 {
        if acceleration * self.acceleration > 0.0 { self.remaining(time) } else { 0.0 }
    }

    /// The allowance for a jerk at a time, m/s³: [`RELEASE`] while the imposed acceleration decreases, in that direction.
    pub(super) fn allows_jerk(&self, jerk: f64, time: f64) -> f64 {
        if jerk * self.acceleration < 0.0 && self.remaining(time) > 0.0 { RELEASE } else { 0.0 }
    }
}

/// A limit raised to an allowance, which has the margin of the tracking controller.
pub(super) fn raised(limit: f64, allowance: f64, margin: f64) -> f64 {
    limit.max((1.0 + margin) * allowance)
}
