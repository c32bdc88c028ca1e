//! The tracking tube in proofs: a plan is proven for every position that the vehicle may have while it follows the plan.
//!
//! The vehicle is never exactly on its trajectory. How far away it may be follows from what the trajectory uses of the tyres'
//! grip ([`crate::vehicle::TrackingTube`]). So the margins of a proof are not chosen, they are those that the plan needs:
//!
//! 1. The lattice search keeps the margins of its level. They are at least those of the calmest driving.
//! 2. [`Vehicle::drivable`] checks the whole trajectory of a plan, with its lead and its stop. Outside of the tube's domain nothing is
//!    known of the vehicle, so that such a plan has no proof.
//! 3. Where the tube of the plan is wider than the margins of its level, the plan is checked for collision again, with the tube. If
//!    something is inside, the path is tried once more with a speed profile that keeps this distance.
//!
//! Tracking errors fade within seconds. The use of the grip before a cycle therefore counts with that of the plan
//! ([`Driven`]). A vehicle outside of its tube is not as described: its deviation is added to the margins. If nothing is proven with these,
//! or if the vehicle is rather beside its plan than on it, it is planned for from its measured state.
//!
//! Nothing is proven from the measured state of a vehicle that skids ([`Vehicle::is_skidding`]): its lead would be another motion than
//! its own.
//!
//! Weak: to what is inside the tube at the start of a plan, only the share of the tube that is free there is kept for the first metres
//! ([`super::allowance`]).

use std::sync::Arc;

use super::allowance::{Kept, allowance_at, returns_to_road};
use super::level::LevelLimits;
use super::{Planner, Start, lead};
use crate::collision::{Allowance, Margins, SafetyMargins, Sweep};
use crate::geometry::Pose;
use crate::lattice::LatticePath;
use crate::trajectory::{Path, SpeedProfile, Trajectory, TrajectoryPoint};
use crate::vehicle::{GripUse, PathMotion, TrackingError, Vehicle};

/// Width of the tube beyond the road boundary that a proof permits, m: lanelets of real maps have gaps of centimetres between their
/// bounds, and the verdict judges by the same width.
const BEYOND_ROAD: f64 = 0.05;
/// How long a use of the grip counts after it ended, s: the settling time of the tracking controller.
const SETTLES_AFTER: f64 = 2.0;

/// The tracking tube of a plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tube {
    /// Largest tracking errors; infinite for a plan without a proof.
    pub(super) error: TrackingError,
    /// Margins that contain them.
    pub(super) margins: SafetyMargins,
}

impl Tube {
    /// Of full braking without a proof: nothing is known of it.
    pub(super) const UNKNOWN: Self = Self {
        error: TrackingError { lateral: f64::INFINITY, longitudinal: f64::INFINITY, heading: f64::INFINITY },
        margins: SafetyMargins::NONE,
    };

    /// Whether it contains the vehicle while this follows the plan.
    pub(super) fn is_known(&self) -> bool {
        self.error.lateral.is_finite()
    }

    /// With this largest use of the grip.
    pub(super) fn with(vehicle: &Vehicle, used: &GripUse) -> Self {
        let needed = vehicle.tracking_margins(used);
        let margins = Margins { lateral: needed.lateral, longitudinal: needed.longitudinal };
        let road = (needed.lateral - BEYOND_ROAD).max(0.0);
        Self {
            error: vehicle.tracking.at(used),
            margins: SafetyMargins { static_obstacles: margins, moving_obstacles: margins, road },
        }
    }

    /// The tube that contains a measured deviation as well: its margins grow by as much as its errors.
    pub(super) fn containing(self, deviation: &Deviation) -> Self {
        let Self { mut error, mut margins } = self;
        let lateral = (deviation.lateral - error.lateral).max(0.0);
        let longitudinal = (deviation.longitudinal - error.longitudinal).max(0.0);
        (error.lateral, error.longitudinal) = (error.lateral + lateral, error.longitudinal + longitudinal);
        for kept in [&mut margins.static_obstacles, &mut margins.moving_obstacles] {
            (kept.lateral, kept.longitudinal) = (kept.lateral + lateral, kept.longitudinal + longitudinal);
        }
        margins.road += lateral;
        Self { error, margins }
    }
}

/// Distance of the vehicle from the committed trajectory now, m, without sign.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Deviation {
    pub(super) lateral: f64,
    pub(super) longitudinal: f64,
}

impl Deviation {
    /// Of a pose from a reference pose.
    pub(super) fn between(reference: &Pose, pose: &Pose) -> Self {
        let error = reference.to_local(pose.position);
        Self { lateral: error.y.abs(), longitudinal: error.x.abs() }
    }
}

/// Why a plan has no tube.
pub(super) enum OutOfTube {
    /// It leaves the domain in which the tracking errors are known.
    NotDrivable,
    /// Something is inside these margins, which the plan needs.
    Blocked(SafetyMargins),
}

impl OutOfTube {
    /// The margins with which it can be tried again.
    pub(super) fn margins(self) -> Option<SafetyMargins> {
        match self {
            Self::NotDrivable => None,
            Self::Blocked(margins) => Some(margins),
        }
    }
}

/// The use of the grip within the last [`SETTLES_AFTER`] seconds, on plans that continue each other.
#[derive(Debug, Default)]
pub(super) struct Driven(Vec<(f64, GripUse)>);

impl Driven {
    /// Forgets everything: the vehicle begins exactly on its trajectory.
    pub(super) fn restart(&mut self) {
        self.0.clear();
    }

    /// Adds the use at a time, s of the run, which does not go backwards.
    pub(super) fn add(&mut self, time: f64, used: GripUse) {
        self.0.retain(|(at, _)| *at >= time - SETTLES_AFTER);
        self.0.push((time, used));
    }

    /// The largest use.
    pub(super) fn used(&self) -> GripUse {
        self.0.iter().map(|(_, used)| *used).fold(GripUse::default(), GripUse::max)
    }
}

impl Planner<'_> {
    /// Whether the vehicle at a pose can go on along a plan: it is less than half its width beside it, and not farther ahead or behind
    /// than the widest tube and what it drives during a lag of the brakes.
    pub(super) fn is_near(&self, reference: &TrajectoryPoint, pose: &Pose) -> bool {
        let deviation = Deviation::between(&reference.pose, pose);
        let widest = self.described.tracking.at(&GripUse { total: 1.0, turning: 1.0, curvature: 0.0 });
        let during_lag = reference.speed * lead::duration(&self.described);
        deviation.lateral <= 0.5 * self.described.width && deviation.longitudinal <= widest.longitudinal + during_lag
    }

    /// Records what the committed trajectory uses now.
    pub(super) fn record_use(&mut self, start: &Start, time: f64) {
        let Some(committed) = self.committed.as_ref().filter(|_| start.on_plan) else {
            self.driven.restart();
            return;
        };
        let now = committed.trajectory.at(time);
        let motion = PathMotion {
            speed: now.speed,
            acceleration: now.acceleration,
            curvature: now.curvature,
            curvature_rate: now.curvature_rate,
        };
        self.driven.add(time, motion.grip_use(&self.described, self.friction));
    }

    /// The tube of calm driving: the least that a proof needs.
    pub(super) fn least_tube(&self) -> Tube {
        Tube::with(&self.described, &GripUse::default())
    }

    /// The tube of a plan on a level, if the vehicle can be relied on to stay inside, and if nothing else is there.
    pub(super) fn tube_of(
        &self,
        start: &Start,
        level: &LevelLimits,
        path: &LatticePath,
        profile: &SpeedProfile,
    ) -> Result<Tube, OutOfTube> {
        let trajectory = start.lead.followed_by(&path.path, profile);
        let used = self.described.drivable(self.friction, &trajectory).map_err(|_| OutOfTube::NotDrivable)?;
        let tube = Tube::with(&self.described, &used.max(self.driven.used())).containing(&start.deviation);
        if !level.level.is_proven() {
            // it claims nothing of what is inside
            return Ok(tube);
        }
        let margins = level.margins.at_least(&tube.margins);
        // a start inside the margins of the level is excused from them, not from the tube
        let allowance = allowance_at(&self.known.world, &level.margins, &start.point, Kept::Nothing);
        let is_excused = allowance != Allowance::NONE;
        let kept = if is_excused { tube.margins } else { margins };
        let is_free =
            (kept == level.margins && !is_excused) || self.is_tube_free(start, level, &trajectory, &path.sweeps, &kept);
        if is_free { Ok(tube) } else { Err(OutOfTube::Blocked(margins)) }
    }

    /// A path that ends in front of whatever is inside these margins.
    pub(super) fn shortened(&self, start: &Start, margins: &SafetyMargins, path: LatticePath) -> LatticePath {
        let world = &self.known.world;
        let allowance = allowance_at(world, margins, &start.point, Kept::Nothing);
        match world.probe_path(&path.path).static_hit(margins, &allowance) {
            Some(hit) if hit.station < path.free_length => {
                LatticePath { free_length: hit.station, blocked_by: Some(hit.what), ..path }
            }
            _ => path,
        }
    }

    fn is_tube_free(
        &self,
        start: &Start,
        level: &LevelLimits,
        trajectory: &Trajectory,
        sweeps: &[Arc<Sweep>],
        margins: &SafetyMargins,
    ) -> bool {
        let world = &self.known.world;
        let now = trajectory.start_time;
        let at_start = allowance_at(world, margins, &trajectory.at(now), start.kept);
        // what is imposed on the lead does not excuse what comes after it
        let is_lead_free = start
            .lead
            .path_or_place()
            .is_none_or(|path| world.probe_path(&path).static_hit(margins, &at_start).is_none());
        let lead = start.lead.path().map(|path| world.sweep_path(&path));
        let sweeps: Vec<&Sweep> = lead.iter().chain(sweeps.iter().map(AsRef::as_ref)).collect();
        let fine_until = start.lead.length() + level.fine_until(start.point.speed);
        let is_return = || {
            let (from, end) = (trajectory.at(now).station, trajectory.profile.last().station);
            let wider = (margins.road - self.least_tube().margins.road).max(0.0);
            let ahead = Path::new(trajectory.at(now).pose, &trajectory.path.part(from, f64::INFINITY));
            ahead.is_none_or(|path| returns_to_road(world, &path, end - from, wider))
        };
        is_lead_free
            && (!at_start.is_off_road() || is_return())
            && self.is_free_of_statics(trajectory, margins, start.point.time, start.kept)
            && self.is_free_of_traffic(trajectory, (&sweeps, fine_until), margins, level.robust, now)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Cycle, Observation, Settings};
    use super::*;
    use crate::map::Scenario;
    use crate::vehicle::{State, builtin_names, load};

    fn used(total: f64, turning: f64) -> GripUse {
        GripUse { total, turning, curvature: 0.0 }
    }

    #[test]
    fn a_use_of_the_grip_counts_for_two_more_seconds_and_a_restart_forgets_it() {
        let mut driven = Driven::default();
        driven.add(0.0, used(0.9, 0.1));
        driven.add(0.5, used(0.2, 0.4));
        assert_eq!(driven.used(), used(0.9, 0.4));
        driven.add(2.0, used(0.1, 0.1));
        assert_eq!(driven.used(), used(0.9, 0.4));
        driven.add(2.01, used(0.1, 0.1));
        assert_eq!(driven.used(), used(0.2, 0.4));
        driven.restart();
        assert_eq!(driven.used(), GripUse::default());
    }

    /// The road may be left by 5 cm, the tolerance of the verdict; everything else keeps the whole tube.
    #[test]
    fn margins_contain_the_tracking_errors_of_every_vehicle() {
        for name in builtin_names() {
            let vehicle = load(name).unwrap();
            for grip in [used(0.0, 0.0), used(0.5, 0.3), used(1.0, 1.0)] {
                let Tube { error, margins } = Tube::with(&vehicle, &grip);
                for kept in [margins.static_obstacles, margins.moving_obstacles] {
                    assert!(kept.lateral > error.lateral && kept.longitudinal >= error.longitudinal, "{name} {grip:?}");
                }
                assert!((margins.road - (margins.static_obstacles.lateral - 0.05)).abs() < 1e-12, "{name} {grip:?}");
            }
        }
    }

    fn straight() -> Scenario {
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("maps/straight_100m.xml");
        crate::io::commonroad::read_file(&file).unwrap()
    }

    /// A cycle at the start, and one 0.1 s later with the vehicle at a place in the frame of its plan, m.
    fn two_cycles(scenario: &Scenario, ahead: f64, left: f64) -> (Cycle, State) {
        let vehicle = load("bmw_320i").unwrap();
        let problem = &scenario.problems[0];
        let pose = vehicle.rear_axle_of_centre(&problem.initial.centre);
        let speed = problem.initial.speed;
        let state =
            State { time: 0.0, pose, speed, lateral_speed: 0.0, acceleration: 0.0, yaw_rate: 0.0, steering: 0.0 };
        let mut planner = Planner::new(scenario.map(), &vehicle, &Settings::default()).unwrap();
        let first = planner.cycle(&Observation::of_scenario(scenario, problem, state)).unwrap();
        let planned = first.trajectory.at(0.1);
        let at = planned.pose.advanced(ahead);
        let pose = Pose { position: at.position + left * at.left(), ..at };
        let state = State { time: 0.1, pose, speed: planned.speed, acceleration: planned.acceleration, ..state };
        (planner.traced_cycle(&Observation::of_scenario(scenario, problem, state)).unwrap(), state)
    }

    #[test]
    fn the_tube_grows_by_what_a_deviation_exceeds_it() {
        let tube = Tube::with(&load("truck").unwrap(), &used(0.3, 0.2));
        let inside = Deviation { lateral: 0.5 * tube.error.lateral, longitudinal: tube.error.longitudinal };
        assert_eq!(tube.containing(&inside), tube);
        let aside = Deviation { lateral: tube.error.lateral + 0.25, longitudinal: tube.error.longitudinal + 0.5 };
        let wide = tube.containing(&aside);
        assert!((wide.margins.static_obstacles.lateral - tube.margins.static_obstacles.lateral - 0.25).abs() < 1e-12);
        assert!(
            (wide.margins.moving_obstacles.longitudinal - tube.margins.moving_obstacles.longitudinal - 0.5).abs()
                < 1e-12
        );
        assert!((wide.margins.road - tube.margins.road - 0.25).abs() < 1e-12);
        assert!((wide.error.lateral - aside.lateral).abs() < 1e-12);
    }

    #[test]
    fn a_vehicle_near_its_plan_goes_on_along_it_and_one_beside_it_begins_where_it_is() {
        let scenario = straight();
        let tube = load("bmw_320i").unwrap().tracking.at(&GripUse::default());
        let begins_at_vehicle = |ahead, left| {
            let (cycle, state) = two_cycles(&scenario, ahead, left);
            (cycle.plan.trajectory.at(0.1).pose.position - state.pose.position).norm() < 1e-9
        };
        for side in [-1.0, 1.0] {
            assert!(!begins_at_vehicle(0.0, side * 0.9 * tube.lateral));
            assert!(!begins_at_vehicle(side * 0.9 * tube.longitudinal, 0.0));
            // outside of the tube, with margins that contain the vehicle
            assert!(!begins_at_vehicle(0.0, side * 0.3));
            assert!(!begins_at_vehicle(side * 0.3, 0.0));
            // half the width is 0.81 m; in a lag of 0.1 s the vehicle drives less than 1 m
            assert!(begins_at_vehicle(0.0, side * 0.85));
            assert!(begins_at_vehicle(side * 1.2, 0.0));
        }
    }

    /// A vehicle that slides sideways stands still along its heading, and stops nowhere soon.
    #[test]
    fn nothing_is_proven_for_a_vehicle_that_skids() {
        let scenario = straight();
        let problem = &scenario.problems[0];
        for name in builtin_names() {
            let vehicle = load(name).unwrap();
            let pose = vehicle.rear_axle_of_centre(&problem.initial.centre);
            let spin = 2.5 / vehicle.wheelbase;
            for (speed, lateral_speed, yaw_rate) in
                [(0.9, 0.0, 0.0), (0.9, 1.5, 0.0), (0.0, -1.5, 0.0), (0.9, 0.0, spin)]
            {
                let state = State { time: 0.0, pose, speed, lateral_speed, acceleration: 0.0, yaw_rate, steering: 0.0 };
                let mut planner = Planner::new(scenario.map(), &vehicle, &Settings::default()).unwrap();
                let observation = Observation { friction: 0.15, ..Observation::of_scenario(&scenario, problem, state) };
                let cycle = planner.traced_cycle(&observation).unwrap();
                let skids = lateral_speed != 0.0 || yaw_rate != 0.0;
                assert_eq!(
                    cycle.plan.level.is_proven(),
                    !skids,
                    "{name} {lateral_speed} {yaw_rate}: {}",
                    cycle.summary()
                );
            }
        }
    }

    /// 8 m/s is beyond what is known of the robot car: no proof, whatever is free.
    #[test]
    fn nothing_is_proven_outside_of_the_domain_of_the_tube() {
        let scenario = straight();
        let vehicle = load("f1tenth").unwrap();
        let problem = &scenario.problems[0];
        let pose = vehicle.rear_axle_of_centre(&problem.initial.centre);
        for (speed, is_known) in [(3.0, true), (8.0, false)] {
            let state =
                State { time: 0.0, pose, speed, lateral_speed: 0.0, acceleration: 0.0, yaw_rate: 0.0, steering: 0.0 };
            let mut planner = Planner::new(scenario.map(), &vehicle, &Settings::default()).unwrap();
            let cycle = planner.traced_cycle(&Observation::of_scenario(&scenario, problem, state)).unwrap();
            assert_eq!(cycle.plan.level.is_proven(), is_known, "{speed} m/s: {}", cycle.summary());
            assert_eq!(cycle.trace.rejections(super::super::Rejection::NotDrivable) > 0, !is_known);
        }
    }
}
