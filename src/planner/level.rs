//! Levels: what a plan and its proof may use, from the gentlest to the hardest.
//!
//! A cycle tries the levels in order and takes the first one on which a stop is proven. On one level the cost decides. A
//! committed plan whose proof holds is never left for a plan of a harder level: that would trade safety for progress.
//!
//! [`Level::Unproven`] is outside of this order: where no level has a proof, the vehicle still has to do something, see
//! `unproven`.

use super::Planner;
use super::candidate::planned_lateral;
use super::tube::Tube;
use crate::collision::{Margins, SafetyMargins};
use crate::vehicle::{GripUse, ProofLimits};

/// What a plan demands of the vehicle, its passengers and other traffic; ordered, the gentlest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Level {
    /// Collision margins and the time gap of the settings; proofs use the aggressive deceleration of the comfort limits.
    Comfort,
    /// As before, with a short time gap to moving obstacles.
    ShortGap,
    /// As before, with stops in junctions and on crosswalks.
    StopInJunction,
    /// As before, without time gap and margins.
    NoMargin,
    /// As before, with the emergency limits of this index in the settings.
    Emergency(u8),
    /// No stop is proven.
    Unproven,
}

impl Level {
    /// The stable name used in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Comfort => "comfort",
            Self::ShortGap => "short_gap",
            Self::StopInJunction => "stop_in_junction",
            Self::NoMargin => "no_margin",
            Self::Emergency(_) => "emergency",
            Self::Unproven => "unproven",
        }
    }

    /// Whether plans of this level have a proven stop.
    #[must_use]
    pub fn is_proven(self) -> bool {
        self != Self::Unproven
    }

    /// Whether a proof of this level is at least as safe as one of another. Time gaps and free junctions are wishes: the levels
    /// with margins are equally safe.
    #[must_use]
    pub fn is_as_safe_as(self, other: Self) -> bool {
        self <= other.max(Self::StopInJunction)
    }
}

/// Limits of plans and proofs on one level.
#[derive(Clone, Copy)]
pub(super) struct LevelLimits {
    pub(super) level: Level,
    /// Margins of the collision checks.
    pub(super) margins: SafetyMargins,
    /// Whether moving obstacles near the start are resolved finely.
    pub(super) is_fine: bool,
    /// Largest acceleration, m/s².
    pub(super) acceleration: f64,
    /// Deceleration of nominal braking, m/s².
    pub(super) braking: f64,
    /// Largest deceleration of proofs, m/s².
    pub(super) deceleration: f64,
    /// Fraction of that deceleration that the search uses; smoothing needs the remainder.
    pub(super) search_share: f64,
    /// Factor on the cruise speed.
    pub(super) speed_factor: f64,
    /// Time gap to moving obstacles, s.
    pub(super) time_gap: f64,
    /// Whether stopping in junctions is forbidden.
    pub(super) junctions_kept_free: bool,
    /// Upper bound of the lateral acceleration of paths, m/s².
    pub(super) lateral_limit: f64,
    /// Whether proofs must hold for all obstacle motions within the bounds.
    pub(super) robust: bool,
}

impl LevelLimits {
    /// Whether the lattice has the same paths on this level as on another one.
    pub(super) fn has_paths_of(&self, other: &Self) -> bool {
        self.margins == other.margins
    }

    /// Whether it is one of the emergency levels.
    pub(super) fn is_emergency(&self) -> bool {
        matches!(self.level, Level::Emergency(_))
    }

    /// An emergency level with another deceleration, m/s².
    pub(super) fn with_deceleration(self, deceleration: f64) -> Self {
        Self { braking: NOMINAL_SHARE * deceleration, deceleration, ..self }
    }

    /// Station up to which moving obstacles are resolved finely from a start speed (m/s), m; 0 if they are not.
    pub(super) fn fine_until(&self, speed: f64) -> f64 {
        if self.is_fine { fine_until(speed) } else { 0.0 }
    }
}

/// Station up to which moving obstacles are resolved finely from a start speed (m/s), m: bumper to bumper, cells of half a metre
/// and slices of a tenth of a second are too coarse, until braking has opened the gap.
pub(super) fn fine_until(speed: f64) -> f64 {
    /// Length ahead of a standing vehicle, m.
    const LENGTH: f64 = 2.0;
    /// Time by which it is longer ahead of a moving one, s.
    const TIME: f64 = 1.0;
    LENGTH + TIME * speed
}

impl Planner<'_> {
    /// The levels with a proof, in the order of the attempts. A committed proven plan is not left for a harder level.
    pub(super) fn levels(&self) -> Vec<LevelLimits> {
        let comfort = &self.vehicle.comfort;
        let least = self.least_tube().margins;
        let first = LevelLimits {
            level: Level::Comfort,
            margins: self.settings.collision.margins().at_least(&self.comfortable_tube().margins),
            is_fine: false,
            acceleration: comfort.acceleration,
            braking: comfort.deceleration,
            deceleration: comfort.aggressive_deceleration,
            search_share: SEARCH_SHARE,
            speed_factor: 1.0,
            time_gap: self.settings.time_gap,
            junctions_kept_free: true,
            lateral_limit: LATERAL_HEADROOM * comfort.lateral_acceleration,
            robust: false,
        };
        let short_gap = LevelLimits { level: Level::ShortGap, time_gap: SHORT_GAP, ..first };
        let in_junction = LevelLimits { level: Level::StopInJunction, junctions_kept_free: false, ..short_gap };
        let no_margin = LevelLimits {
            level: Level::NoMargin,
            time_gap: 0.0,
            margins: least,
            is_fine: true,
            search_share: 1.0,
            ..in_junction
        };
        let mut levels = vec![first, short_gap, in_junction, no_margin];
        levels.extend(self.emergency_levels(&self.limits, least));
        if let Some(committed) = self.committed.as_ref().filter(|c| c.level.is_proven()) {
            levels.retain(|l| l.level.is_as_safe_as(committed.level));
        }
        self.with_robust_levels(levels)
    }

    /// The tube of comfortable driving and of a stop with the aggressive deceleration.
    fn comfortable_tube(&self) -> Tube {
        let comfort = &self.vehicle.comfort;
        let grip = self.limits.lateral_beside(0.0);
        let lateral = planned_lateral(&self.settings, &self.vehicle, comfort.lateral_acceleration);
        let total = lateral.hypot(comfort.aggressive_deceleration) / grip;
        Tube::with(&self.described, &GripUse { total, turning: lateral / grip, curvature: 0.0 })
    }

    /// The emergency levels of the settings, as far as the limits permit.
    pub(super) fn emergency_levels(&self, limits: &ProofLimits, margins: SafetyMargins) -> Vec<LevelLimits> {
        let one = |(index, e): (u8, &super::EmergencyLimits)| {
            let deceleration = e.deceleration.min(limits.deceleration());
            let is_fast = e.acceleration > self.vehicle.comfort.acceleration;
            LevelLimits {
                level: Level::Emergency(index),
                margins,
                is_fine: true,
                acceleration: e.acceleration.min(limits.acceleration()),
                braking: NOMINAL_SHARE * deceleration,
                deceleration,
                search_share: 1.0,
                speed_factor: if is_fast { self.settings.emergency_speed_factor } else { 1.0 },
                time_gap: 0.0,
                junctions_kept_free: false,
                lateral_limit: EMERGENCY_LATERAL.min(limits.lateral_beside(deceleration)),
                robust: false,
            }
        };
        (0..).zip(&self.settings.emergency).map(one).collect()
    }
}

/// The margins of plans without a proof, m.
pub(super) const NO_MARGINS: SafetyMargins =
    SafetyMargins { static_obstacles: Margins::uniform(0.01), moving_obstacles: Margins::uniform(0.01), road: 0.0 };
/// Fraction of the comfortable lateral acceleration that paths may use; the tracking controller has the remainder.
const LATERAL_HEADROOM: f64 = 0.9;
/// Fraction of the aggressive deceleration that the search uses; a jerk-limited stop needs the remainder to build up.
const SEARCH_SHARE: f64 = 0.85;
/// Fraction of an emergency deceleration for nominal braking; proofs may use all of it.
const NOMINAL_SHARE: f64 = 0.75;
/// Time gap if no plan is proven with the one of the settings, s: a reserve for smoothing.
const SHORT_GAP: f64 = 0.15;
/// Lateral acceleration of emergency paths, m/s²: within dry friction, combined with braking.
const EMERGENCY_LATERAL: f64 = 5.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_with_margins_are_equally_safe_and_the_others_ordered() {
        use Level::{Comfort, Emergency, NoMargin, ShortGap, StopInJunction, Unproven};
        let with_margins = [Comfort, ShortGap, StopInJunction];
        for (a, b) in with_margins.into_iter().flat_map(|a| with_margins.map(|b| (a, b))) {
            assert!(a.is_as_safe_as(b), "{a} {b}");
        }
        let order = [StopInJunction, NoMargin, Emergency(0), Emergency(1), Unproven];
        for (i, safer) in order.into_iter().enumerate() {
            for other in &order[i + 1..] {
                assert!(safer.is_as_safe_as(*other) && !other.is_as_safe_as(safer), "{safer:?} {other:?}");
            }
        }
        assert!(order.iter().all(|l| l.is_proven() == (*l != Unproven)));
    }
}
