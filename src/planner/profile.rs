//! The final speed profile of the chosen path: as gentle as its level permits, and with limited jerk where that can be proven.

use super::candidate::Proven;
use super::choice::Choice;
use super::level::LevelLimits;
use super::record::Smoothing;
use super::{CycleRecord, Planner, Start};
use crate::collision::SafetyMargins;
use crate::speed::smoothing::{Failure, Smoothed};
use crate::trajectory::SpeedProfile;

/// Accuracy of the severity of emergency plans, 0…1: of braking at 8 m/s², 0.1 m/s², below what a passenger notices.
const SEVERITY_STEP: f64 = 0.02;

/// A choice with its final speed profile.
pub(super) struct WithProfile {
    pub(super) choice: Choice,
    pub(super) profile: SpeedProfile,
    pub(super) smoothing: Smoothing,
}

/// A choice without a jerk-limited profile.
struct Unsmoothed {
    choice: Choice,
    why: Failure,
    /// The margins that the tube needs, if that is why.
    margins: Option<SafetyMargins>,
}

impl From<Unsmoothed> for WithProfile {
    /// With the raw profile.
    fn from(Unsmoothed { choice, why, .. }: Unsmoothed) -> Self {
        Self { profile: choice.proven.raw_profile.clone(), choice, smoothing: Smoothing::Unsmoothed(why) }
    }
}

impl Planner<'_> {
    /// The choice with its final speed profile. A choice of an emergency level brakes and turns no harder than it must: the severity of
    /// its limits is found by bisection, on the same path.
    pub(super) fn with_profile(
        &self,
        start: &Start,
        level: LevelLimits,
        choice: Choice,
        record: &mut CycleRecord,
    ) -> WithProfile {
        let mut best = self.smoothed(start, level, choice, record);
        let (mut too_low, mut severity) = (0.0, 1.0);
        while level.is_emergency() && severity - too_low > SEVERITY_STEP {
            let less = f64::midpoint(too_low, severity);
            let gentle = level.with_severity(less, &self.vehicle.comfort);
            let found = self.evaluated_again(start, &gentle, &best.choice, record);
            match found.and_then(|choice| self.accepted(start, &gentle, None, choice).ok()) {
                Some(choice) => {
                    severity = less;
                    best = self.smoothed(start, gentle, choice, record);
                }
                None => too_low = less,
            }
        }
        best
    }

    /// The choice with its final speed profile: the jerk-limited one if it passes reverification and its tube is free, else the raw
    /// one. Where the tube of the jerk-limited profile is not free, both are tried once more with the margins that it needs.
    fn smoothed(&self, start: &Start, level: LevelLimits, choice: Choice, record: &mut CycleRecord) -> WithProfile {
        self.jerk_limited(start, &level, choice).unwrap_or_else(|failed| {
            let again = failed.margins.and_then(|margins| {
                let wide = LevelLimits { margins, ..level };
                let choice = self.evaluated_again(start, &wide, &failed.choice, record)?;
                let choice = self.accepted(start, &wide, None, choice).ok()?;
                self.jerk_limited(start, &wide, choice).ok()
            });
            again.unwrap_or_else(|| (*failed).into())
        })
    }

    /// The choice with its jerk-limited profile and the tube of that.
    fn jerk_limited(&self, start: &Start, level: &LevelLimits, choice: Choice) -> Result<WithProfile, Box<Unsmoothed>> {
        let Proven { problem, target, raw_profile, .. } = &*choice.proven;
        let smoothed =
            self.smoother.smooth_and_prove(&problem.0, &target.speeds, raw_profile, start.point.acceleration);
        let Smoothed { profile, is_firm } = match smoothed {
            Ok(smoothed) => smoothed,
            Err(why) => return Err(Box::new(Unsmoothed { choice, why, margins: None })),
        };
        let smoothing = if is_firm { Smoothing::Firm } else { Smoothing::Comfortable };
        match self.tube_of(start, level, &choice.path, &profile) {
            Ok(tube) => Ok(WithProfile { choice: Choice { tube, ..choice }, profile, smoothing }),
            Err(out) => Err(Box::new(Unsmoothed { choice, why: Failure::OutOfTube, margins: out.margins() })),
        }
    }
}
