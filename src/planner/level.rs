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
use crate::vehicle::{Comfort, GripUse, PathMotion, ProofLimits};

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
    /// Largest deceleration of proofs, m/s², on a path that turns and on a straight one.
    pub(super) deceleration: f64,
    pub(super) straight_deceleration: f64,
    /// Fraction of that deceleration that the search uses; smoothing needs the remainder.
    pub(super) search_share: f64,
    /// Factor on the cruise speed.
    pub(super) speed_factor: f64,
    /// Largest planned speed, m/s.
    pub(super) top_speed: f64,
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

    /// Whether the moving obstacles block the same cells of a path on this level as on another one with the same margins.
    pub(super) fn sees_traffic_as(&self, other: &Self) -> bool {
        (self.robust, self.is_fine) == (other.robust, other.is_fine)
    }

    /// Whether it is one of the emergency levels.
    pub(super) fn is_emergency(&self) -> bool {
        matches!(self.level, Level::Emergency(_))
    }

    /// An emergency level whose limits are nearer to those of comfort: 0 is comfort, 1 the level itself.
    pub(super) fn with_severity(self, severity: f64, comfort: &Comfort) -> Self {
        let between = |gentle: f64, hard: f64| gentle.min(hard) + severity * (hard - gentle).max(0.0);
        let deceleration = between(comfort.aggressive_deceleration, self.deceleration);
        Self {
            braking: self.braking * deceleration / self.deceleration,
            deceleration,
            straight_deceleration: between(comfort.aggressive_deceleration, self.straight_deceleration),
            lateral_limit: between(LATERAL_HEADROOM * comfort.lateral_acceleration, self.lateral_limit),
            ..self
        }
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
    pub(super) fn levels(&self, speed: f64) -> Vec<LevelLimits> {
        let comfort = &self.vehicle.comfort;
        let least = self.least_tube().margins;
        let first = LevelLimits {
            level: Level::Comfort,
            margins: self.settings.collision.margins().at_least(&self.comfortable_tube().margins),
            is_fine: false,
            acceleration: comfort.acceleration,
            braking: comfort.deceleration,
            deceleration: comfort.aggressive_deceleration,
            straight_deceleration: comfort.aggressive_deceleration,
            search_share: SEARCH_SHARE,
            speed_factor: 1.0,
            top_speed: self.vehicle.limits.speed,
            // a gap is a wish, less than the goal
            time_gap: if self.haste.is_some() { SHORT_GAP } else { self.settings.time_gap },
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
        let is_double = |level: &LevelLimits| match level.level {
            // with the gap of the first level
            Level::ShortGap => self.haste.is_some(),
            Level::StopInJunction => !self.has_junctions(),
            _ => false,
        };
        levels.retain(|level| !is_double(level));
        levels.extend(self.emergency_levels(&self.limits, least));
        if let Some(committed) = self.committed.as_ref().filter(|c| c.level.is_proven()) {
            levels.retain(|l| l.level.is_as_safe_as(committed.level));
        }
        let levels = levels.into_iter().map(|level| self.in_domain(speed, level)).collect();
        self.with_robust_levels(levels)
    }

    /// Whether there are places without stopping on the lanes.
    fn has_junctions(&self) -> bool {
        self.lanes.as_ref().is_ok_and(|lanes| lanes.iter().any(|lane| !lane.no_stopping.is_empty()))
    }

    /// The level with limits inside the domain of the tracking tube from a start speed (m/s) on. The tube knows hard braking up to
    /// a lower speed than gentle braking: a plan that begins below it stays below it, one that begins above it brakes the more
    /// gently the faster it begins.
    pub(super) fn in_domain(&self, speed: f64, level: LevelLimits) -> LevelLimits {
        let share = DOMAIN_SHARE * self.described.tracking.straight_use(speed);
        let deceleration = level.deceleration.min(share * self.limits.lateral_beside(0.0));
        let straight_share = STRAIGHT_SHARE * self.described.tracking.straight_use(speed / DOMAIN_SHARE);
        LevelLimits {
            deceleration,
            straight_deceleration: level.straight_deceleration.min(straight_share * self.limits.lateral_beside(0.0)),
            braking: level.braking * deceleration / level.deceleration,
            acceleration: self.acceleration_with(share, speed, level.acceleration),
            top_speed: level.top_speed.min(self.top_speed(deceleration)),
            ..level
        }
    }

    /// The acceleration (m/s²) at a speed (m/s), reduced as far as it would use more than a share of the grip of an axle.
    fn acceleration_with(&self, share: f64, speed: f64, acceleration: f64) -> f64 {
        /// The use is nearly in proportion to the force of the drive: each step leaves less than a tenth of the error.
        const STEPS: usize = 3;
        let resistance = self.described.resistance(speed);
        let step = |a: f64, _| (a + resistance) * (share / self.straight_use(speed, a)).min(1.0) - resistance;
        (0..STEPS).fold(acceleration, step).max(LEAST_ACCELERATION).min(acceleration)
    }

    /// The use of the grip by a straight drive at a speed (m/s) with an acceleration (m/s²).
    fn straight_use(&self, speed: f64, acceleration: f64) -> f64 {
        let motion = PathMotion { speed, acceleration, curvature: 0.0, curvature_rate: 0.0 };
        motion.grip_use(&self.described, self.friction).total
    }

    /// Largest speed at which straight driving and braking (m/s²) are in the domain of the tracking tube, with a reserve, m/s.
    fn top_speed(&self, deceleration: f64) -> f64 {
        let tube = &self.described.tracking;
        let braking = (deceleration / self.limits.lateral_beside(0.0)).min(1.0);
        let largest = |total: f64| tube.largest_speed(&GripUse { total, turning: 0.0, curvature: 0.0 });
        // overcoming the resistance takes less at lower speeds
        let driving = self.straight_use(largest(braking), 0.0);
        DOMAIN_SHARE * largest(braking.max(driving))
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
            let beside_a_turn = limits.lateral_beside(LEAST_TURNING * limits.lateral_beside(0.0));
            let straight_deceleration = e.deceleration.min(limits.deceleration());
            let deceleration = straight_deceleration.min(beside_a_turn);
            let is_fast = e.acceleration > self.vehicle.comfort.acceleration;
            LevelLimits {
                level: Level::Emergency(index),
                margins,
                is_fine: true,
                acceleration: e.acceleration.min(limits.acceleration()),
                braking: NOMINAL_SHARE * deceleration,
                deceleration,
                straight_deceleration,
                search_share: 1.0,
                speed_factor: if is_fast { self.settings.emergency_speed_factor } else { 1.0 },
                top_speed: self.vehicle.limits.speed,
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
/// Share of a limit of the tracking tube's domain that plans aim at: proofs forgive 5 % of a speed limit, and the tube looks at the
/// grip of each axle.
const DOMAIN_SHARE: f64 = 0.95;
/// Share of the grip for braking on a straight path: √(1 − t²) with the use t by turning up to which a path is straight
/// ([`crate::vehicle::TrackingTube::STRAIGHT_USE`]).
const STRAIGHT_SHARE: f64 = 0.9987;
/// Least acceleration of a level, m/s²: the search needs a positive one.
pub(super) const LEAST_ACCELERATION: f64 = 0.05;
/// Fraction of the comfortable lateral acceleration that paths may use; the tracking controller has the remainder.
const LATERAL_HEADROOM: f64 = 0.9;
/// Fraction of the aggressive deceleration that the search uses; a jerk-limited stop needs the remainder to build up.
const SEARCH_SHARE: f64 = 0.85;
/// Fraction of an emergency deceleration for nominal braking; proofs may use all of it.
const NOMINAL_SHARE: f64 = 0.75;
/// Time gap if no plan is proven with the one of the settings, s: a reserve for smoothing.
const SHORT_GAP: f64 = 0.15;
/// Share of the grip that emergency braking leaves for turning. Without it, a road on which the brakes can use all of the grip
/// would permit no path but a straight one, which keeps all of it for the brakes. Braking is weaker by 8 %, as √(1 − 0.4²) = 0.92.
const LEAST_TURNING: f64 = 0.4;
/// Lateral acceleration of emergency paths, m/s²: within dry friction, combined with braking.
const EMERGENCY_LATERAL: f64 = 5.0;

#[cfg(test)]
mod tests {
    use super::super::{Observation, Rejection, Settings};
    use super::*;
    use crate::bench::fallbacks::{SURFACES, Scene};
    use crate::geometry::Pose;
    use crate::geometry::spiral::CubicSpiral;
    use crate::map::Scenario;
    use crate::trajectory::{Path, SpeedKnot, SpeedProfile, Trajectory};
    use crate::vehicle::{State, Vehicle, builtin_names, load};

    fn observation(scenario: &Scenario, vehicle: &Vehicle, speed: f64, friction: f64) -> Observation {
        let problem = &scenario.problems[0];
        let pose = vehicle.rear_axle_of_centre(&problem.initial.centre);
        let state =
            State { time: 0.0, pose, speed, lateral_speed: 0.0, acceleration: 0.0, yaw_rate: 0.0, steering: 0.0 };
        Observation { friction, ..Observation::of_scenario(scenario, problem, state) }
    }

    /// Calls `check` with a planner that has observed each surface, for every built-in vehicle, with the friction.
    fn on_every_surface(mut check: impl FnMut(&Planner<'_>, &Vehicle, f64)) {
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("maps/straight_100m.xml");
        let scenario = crate::io::commonroad::read_file(&file).unwrap();
        for name in builtin_names() {
            let vehicle = load(name).unwrap();
            for friction in SURFACES.map(|surface| surface.friction) {
                let mut planner = Planner::new(scenario.map(), &vehicle, &Settings::default()).unwrap();
                planner.observe(&observation(&scenario, &vehicle, 3.0, friction)).unwrap();
                check(&planner, &vehicle, friction);
            }
        }
    }

    /// Where the road gives less than a level asks for, braking must not take all of the grip: no bend would be left.
    #[test]
    fn every_level_turns_and_brakes_within_the_grip_and_plans_within_what_it_proves() {
        on_every_surface(|planner, vehicle, friction| {
            let proven = planner.levels(3.0).into_iter().map(|level| (level, &planner.limits));
            let unproven = planner.emergency_levels(&planner.unreserved, NO_MARGINS).into_iter();
            for (level, limits) in proven.chain(unproven.map(|level| (level, &planner.unreserved))) {
                let what = format!("{} {friction} {}: {}", vehicle.name, level.level, level.lateral_limit);
                let grip = limits.lateral_beside(0.0);
                assert!(level.deceleration.hypot(level.lateral_limit) <= grip + 1e-9, "{what}");
                let comfortable = LATERAL_HEADROOM * planner.vehicle.comfort.lateral_acceleration;
                assert!(level.lateral_limit >= comfortable.min(0.4 * grip) - 1e-9, "{what}");
                let planned = planned_lateral(&planner.settings, &planner.vehicle, level.lateral_limit);
                assert!(planned <= level.lateral_limit, "{what}");
            }
        });
    }

    /// A straight drive at a constant speed (m/s) for a time (s), then braking (m/s²) to standstill.
    fn straight_stop(speed: f64, cruise: f64, deceleration: f64) -> Trajectory {
        let knot = |time, station, speed, acceleration| SpeedKnot { time, station, speed, acceleration, jerk: 0.0 };
        let (begins, time) = (speed * cruise, speed / deceleration);
        let ends = begins + 0.5 * speed * time;
        let brakes = [knot(cruise, begins, speed, -deceleration), knot(cruise + time, ends, 0.0, 0.0)];
        let cruises = (cruise > 0.0).then_some(knot(0.0, 0.0, speed, 0.0));
        let profile = SpeedProfile::new(cruises.into_iter().chain(brakes).collect());
        let path = Path::new(Pose::new(0.0, 0.0, 0.0), &[CubicSpiral::straight(ends + 1.0)]).unwrap();
        Trajectory { start_time: 0.0, path, profile: profile.unwrap() }
    }

    /// Proofs may brake as hard as the level from its top speed, 5 % above it, and from any start below the tube's largest speed.
    #[test]
    fn the_hardest_straight_motion_of_every_level_is_in_the_domain_of_the_tube() {
        on_every_surface(|planner, vehicle, friction| {
            let [gentle, moderate, _] = vehicle.tracking.speed;
            for start in [0.5 * moderate, 0.99 * moderate, 1.01 * moderate, 0.99 * gentle] {
                for level in planner.levels(start) {
                    let what = format!("{} {friction} {start} {}", vehicle.name, level.level);
                    for (speed, cruise, deceleration) in [
                        (start, 0.0, level.straight_deceleration),
                        (start, 0.0, level.deceleration),
                        (1.05 * level.top_speed, 1.0, level.deceleration),
                    ] {
                        assert!(deceleration <= planner.limits.deceleration(), "{what}");
                        let drivable = vehicle.drivable(friction, &straight_stop(speed, cruise, deceleration));
                        assert!(drivable.is_ok(), "{what}: {drivable:?}");
                    }
                    let drive = PathMotion {
                        speed: start,
                        acceleration: level.acceleration,
                        curvature: 0.0,
                        curvature_rate: 0.0,
                    };
                    let is_inside = vehicle.tracking.contains(start, &drive.grip_use(vehicle, friction));
                    assert!(is_inside || level.acceleration == LEAST_ACCELERATION, "{what}");
                    assert!(level.acceleration > 0.0 && level.braking <= level.deceleration, "{what}");
                }
            }
        });
    }

    /// Full braking and the turning of a straight path use the grip up.
    #[test]
    fn braking_on_a_straight_path_leaves_the_grip_to_keep_straight() {
        let used = STRAIGHT_SHARE.hypot(crate::vehicle::TrackingTube::STRAIGHT_USE);
        assert!((0.9995..=1.0).contains(&used), "{used}");
    }

    #[test]
    fn the_search_finds_no_profile_that_its_proof_refuses() {
        let (mut proven, mut emergencies) = (0, 0);
        for name in builtin_names() {
            let vehicle = load(name).unwrap();
            for (friction, number) in SURFACES.iter().flat_map(|s| (0..9).map(|number| (s.friction, number))) {
                let Scene { scenario, kind } = Scene::new(7, number, &vehicle, friction);
                let mut planner = Planner::new(scenario.map(), &vehicle, &Settings::default()).unwrap();
                let speed = scenario.problems[0].initial.speed;
                let cycle = planner.traced_cycle(&observation(&scenario, &vehicle, speed, friction)).unwrap();
                let refused = cycle.trace.rejections(Rejection::ReverificationFailed);
                assert_eq!(refused, 0, "{name} {friction} {}", kind.name());
                proven += usize::from(cycle.plan.level.is_proven());
                emergencies += usize::from(matches!(cycle.plan.level, Level::Emergency(_)));
            }
        }
        println!("{proven} of 108 first cycles are proven, {emergencies} of them as emergencies");
        assert!(proven > 60 && emergencies > 0, "{proven} {emergencies}");
    }

    /// Zero is comfort, one the level itself, and everything grows between them. No level becomes harder than it is.
    #[test]
    fn an_emergency_is_as_severe_as_asked_for() {
        on_every_surface(|planner, vehicle, friction| {
            let comfort = &planner.vehicle.comfort;
            for level in planner.levels(3.0).into_iter().filter(LevelLimits::is_emergency) {
                let case = format!("{} {friction} {}", vehicle.name, level.level);
                let at = |severity: f64| {
                    let LevelLimits { deceleration, lateral_limit, braking, .. } =
                        level.with_severity(severity, comfort);
                    assert!((braking / deceleration - level.braking / level.deceleration).abs() < 1e-12, "{case}");
                    [deceleration, lateral_limit]
                };
                let hard = [level.deceleration, level.lateral_limit];
                let gentle = [comfort.aggressive_deceleration, LATERAL_HEADROOM * comfort.lateral_acceleration];
                for i in 0..2 {
                    assert!((at(0.0)[i] - gentle[i].min(hard[i])).abs() < 1e-12, "{case}");
                    assert!((at(1.0)[i] - hard[i]).abs() < 1e-12, "{case}");
                    assert!((at(0.5)[i] - 0.5 * (at(0.0)[i] + hard[i])).abs() < 1e-12, "{case}");
                }
            }
        });
    }

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
