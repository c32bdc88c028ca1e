//! Plans without a proof: what the vehicle does where no stop is proven.
//!
//! 1. The emergency levels are tried once more with everything that vehicle and road give, without the reserve that proofs
//!    leave to the tracking controller. A plan that is found this way touches nothing if the controller needs no reserve.
//! 2. Otherwise the committed plan goes on if what is left of it still touches nothing.
//! 3. Otherwise every path of the hardest such level is driven with full braking, and the one with the latest first contact
//!    wins; of those, the one with the lowest speed at contact. The arc along the present steering angle is one of them.
//!
//! Such a plan claims nothing. One of the first two kinds is within what the vehicle can follow ([`super::tube`]), so that the next cycle
//! goes on from it: from the measured state, each cycle would begin the swerve anew, later by the lags of the actuators. Full braking may
//! be beyond that; the next plan starts from the measured state.
//!
//! Weak: the severity of a contact is its speed alone; a contact with a pedestrian counts as one with a wall.

use super::allowance::Kept;
use super::level::{Level, LevelLimits, NO_MARGINS, fine_until};
use super::profile::WithProfile;
use super::record::ExpectedContact;
use super::tube::Tube;
use super::{Committed, CycleRecord, Planner, Smoothing, Start};
use crate::collision::{Allowance, Blocker, Predictions, Sweep};
use crate::geometry::spiral::CubicSpiral;
use crate::trajectory::{Path, SpeedKnot, SpeedProfile, Trajectory};

/// Contacts within this time of each other count as simultaneous, s: a step of the planner's time slices.
const SIMULTANEOUS: f64 = 0.1;
/// Least deceleration of full braking, m/s². With less grip the vehicle stops nowhere in sight, and the path to its standstill
/// would have no bound.
const LEAST_BRAKING: f64 = 0.1;
/// Length of the path beyond the standstill, m.
const BEYOND: f64 = 1.0;

/// A path with full braking, and its first contact.
struct Braking {
    trajectory: Trajectory,
    contact: Option<ExpectedContact>,
}

impl Braking {
    /// Time of the contact in steps of [`SIMULTANEOUS`], larger is better; then its speed, smaller is better.
    fn is_better_than(&self, other: &Self) -> bool {
        #[allow(clippy::cast_possible_truncation)] // times of a run
        let key = |b: &Self| b.contact.map_or((i64::MAX, 0.0), |c| ((c.time / SIMULTANEOUS).floor() as i64, -c.speed));
        let ((time, speed), (other_time, other_speed)) = (key(self), key(other));
        time > other_time || (time == other_time && speed > other_speed)
    }
}

impl Planner<'_> {
    /// The plan without a proof from the start.
    pub(super) fn unproven(&mut self, start: &Start, record: &mut CycleRecord) -> (Committed, Option<ExpectedContact>) {
        let levels = self.emergency_levels(&self.unreserved, NO_MARGINS);
        let speed = start.point.speed;
        let unproven = |level: LevelLimits| LevelLimits {
            level: Level::Unproven,
            top_speed: self.in_domain(speed, level).top_speed,
            ..level
        };
        let levels: Vec<LevelLimits> = levels.into_iter().map(unproven).collect();
        if let Some((level, choice)) = self.choose(start, &levels, record) {
            record.trace.chosen = Some(choice.candidate);
            let profile = choice.proven.raw_profile.clone();
            let committed =
                self.committed_of(start, level, WithProfile { choice, profile, smoothing: Smoothing::EmergencyStop });
            return (committed, start.lead_contact);
        }
        if let Some(evading) = self.still_evading(start) {
            return (evading, None);
        }
        let deceleration = self.unreserved.deceleration().max(LEAST_BRAKING);
        let mut best = self.braking_on_arc(start, deceleration);
        if let Some(hardest) = levels.last() {
            self.brake_on_lanes(start, *hardest, deceleration, &mut best, record);
        }
        let committed = Committed {
            trajectory: best.trajectory,
            deceleration,
            level: Level::Unproven,
            smoothing: Smoothing::EmergencyStop,
            is_refined: false,
            lead: start.lead.length(),
            tube: Tube::UNKNOWN,
            margins: NO_MARGINS,
            fine_until: 0.0,
            sweeps: Vec::new(),
            statics: self.known.statics,
            path_cost: 0.0,
            robust: false,
            limited_by: None,
            stops_for: None,
        };
        (committed, best.contact)
    }

    /// The committed plan, if what is left of it still touches nothing and the vehicle is near it.
    fn still_evading(&self, start: &Start) -> Option<Committed> {
        let committed = self.committed.as_ref().filter(|c| !c.sweeps.is_empty())?;
        let (trajectory, now) = (&committed.trajectory, start.lead.begins());
        let reference = trajectory.at(now);
        let is_near = self.is_near(&reference, start.lead.start());
        let is_free = || {
            self.is_free_of_statics(trajectory, &NO_MARGINS, now, Kept::Nothing)
                && self.is_free_of_traffic(
                    trajectory,
                    (&committed.sweeps(), committed.fine_until),
                    &NO_MARGINS,
                    false,
                    now,
                )
        };
        (is_near && is_free()).then(|| Committed {
            level: Level::Unproven,
            margins: NO_MARGINS,
            robust: false,
            smoothing: Smoothing::EmergencyStop,
            ..committed.clone()
        })
    }

    /// Replaces `best` by full braking along a lattice path with a later or slower first contact.
    fn brake_on_lanes(
        &mut self,
        start: &Start,
        level: LevelLimits,
        deceleration: f64,
        best: &mut Braking,
        record: &mut CycleRecord,
    ) {
        for lane in 0..self.lanes.as_ref().map_or(0, Vec::len) {
            let paths = self.lattice_paths(start, lane, level, &mut record.trace.edges);
            let Some(on) = self.lanes.as_ref().ok().and_then(|l| l.get(lane)) else { return };
            let situation = self.situation(start, on, level);
            for path in paths.iter().filter(|path| !situation.is_curve_speed_infeasible(path)) {
                let sweeps: Vec<&Sweep> = path.sweeps.iter().map(AsRef::as_ref).collect();
                let blocked_at = path.blocked_by.map(|what| (path.free_length, what));
                let braking = self.braking_along(start, &path.path, &sweeps, blocked_at, deceleration);
                if let Some(braking) = braking.filter(|b| b.is_better_than(best)) {
                    *best = braking;
                }
            }
        }
    }

    /// Full braking along the present curvature.
    fn braking_on_arc(&self, start: &Start, deceleration: f64) -> Braking {
        let p = &start.point;
        let bound = self.vehicle.max_curvature();
        let length = p.speed * p.speed / (2.0 * deceleration) + BEYOND;
        let arc = CubicSpiral { knots: [p.curvature.clamp(-bound, bound); 4], length };
        let path = Path::new(p.pose, &[arc]).or_else(|| Path::new(p.pose, &[CubicSpiral::straight(length)]));
        let path = path.unwrap_or_else(|| unreachable!("a straight spiral of positive length is a path"));
        let world = &self.known.world;
        let sweep = world.sweep_path(&path);
        let hit = world.probe_path(&path).static_hit(&NO_MARGINS, &Allowance::NONE);
        let blocked_at = hit.map(|hit| (hit.station, hit.what));
        self.braking_along(start, &path, &[&sweep], blocked_at, deceleration)
            .unwrap_or_else(|| unreachable!("the path is long enough to stop on"))
    }

    /// Full braking along a path, which is extended by its tangent where it is too short; `None` if it is no path then.
    fn braking_along(
        &self,
        start: &Start,
        path: &Path,
        sweeps: &[&Sweep],
        blocked_at: Option<(f64, Blocker)>,
        deceleration: f64,
    ) -> Option<Braking> {
        let p = &start.point;
        let profile = full_braking(p.speed, deceleration);
        let missing = profile.last().station + BEYOND - path.length();
        let path = if missing > 0.0 {
            let spirals = path.pieces().map(|(_, _, spiral)| *spiral);
            Path::new(p.pose, &spirals.chain([CubicSpiral::straight(missing)]).collect::<Vec<_>>())?
        } else {
            path.clone()
        };
        let predictions = self.known.world.predictions();
        let contact = first_contact(predictions, sweeps, blocked_at, &profile, (p.time, f64::INFINITY));
        Some(Braking { trajectory: start.lead.followed_by(&path, &profile), contact: start.lead_contact.or(contact) })
    }
}

/// Braking to standstill at a constant deceleration.
fn full_braking(speed: f64, deceleration: f64) -> SpeedProfile {
    let knot = |time, station, speed, acceleration| SpeedKnot { time, station, speed, acceleration, jerk: 0.0 };
    let mut knots = vec![knot(0.0, 0.0, speed, 0.0)];
    if speed > 0.0 {
        knots[0].acceleration = -deceleration;
        knots.push(knot(speed / deceleration, speed * speed / (2.0 * deceleration), 0.0, 0.0));
    }
    SpeedProfile::new(knots).unwrap_or_else(|| unreachable!("one or two knots in order are a profile"))
}

/// The arrival at a station (m) with the acceleration of the first knot; `None` if the profile ends before.
fn contact_at(profile: &SpeedProfile, begins: f64, station: f64, what: Blocker) -> Option<ExpectedContact> {
    let first = profile.knots()[0];
    if station >= profile.last().station {
        return None;
    }
    let speed = (first.speed * first.speed + 2.0 * first.acceleration * station).max(0.0).sqrt();
    let time = if first.acceleration == 0.0 { station / speed } else { (speed - first.speed) / first.acceleration };
    Some(ExpectedContact { what, time: begins + time, speed })
}

/// The first contact on sweeps, with a constant acceleration: with what blocks them from a station (m) on, or with moving
/// obstacles. `until` (s of the run) is when the vehicle leaves the end of the profile; infinite where it stands there.
pub(super) fn first_contact(
    predictions: &Predictions,
    sweeps: &[&Sweep],
    blocked_at: Option<(f64, Blocker)>,
    profile: &SpeedProfile,
    (begins, until): (f64, f64),
) -> Option<ExpectedContact> {
    let fixed = blocked_at.and_then(|(station, what)| contact_at(profile, begins, station, what));
    let margins = &NO_MARGINS.moving_obstacles;
    let times = (begins, until.min(predictions.horizon()).max(begins + 1.0));
    let grid = predictions.blocked_finely(sweeps, margins, times, fine_until(profile.knots()[0].speed));
    let end = profile.last();
    let visited = |cell: usize| grid.stations()[cell] <= end.station;
    let visit = |cell: usize| {
        let arrival = |station: f64| contact_at(profile, begins, station, Blocker::RoadBoundary).map(|c| c.time);
        let from = if cell == 0 { begins } else { arrival(grid.stations()[cell])? };
        let to = arrival(grid.stations()[cell + 1]).unwrap_or(until);
        let blocked = grid.first_blocked(cell, from, to)?;
        let time = blocked.from.max(from);
        let speed = profile.at(time - begins).speed;
        Some(ExpectedContact { what: Blocker::Obstacle(blocked.obstacle), time, speed })
    };
    let moving = (0..grid.cells()).take_while(|c| visited(*c)).filter_map(visit);
    fixed.into_iter().chain(moving).reduce(|a, b| if b.time < a.time { b } else { a })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::straight;
    use crate::geometry::Pose;

    fn braking(contact: Option<(f64, f64)>) -> Braking {
        let path = straight(Pose::new(0.0, 0.0, 0.0), 10.0);
        let trajectory = Trajectory { start_time: 0.0, path, profile: full_braking(4.0, 2.0) };
        let contact = contact.map(|(time, speed)| ExpectedContact { what: Blocker::Obstacle(1), time, speed });
        Braking { trajectory, contact }
    }

    #[test]
    fn no_contact_is_best_then_a_late_one_then_a_slow_one() {
        let order = [None, Some((2.0, 9.0)), Some((1.04, 3.0)), Some((1.01, 4.0)), Some((0.5, 1.0))];
        for (i, better) in order.iter().enumerate() {
            for worse in &order[i + 1..] {
                assert!(braking(*better).is_better_than(&braking(*worse)), "{better:?} {worse:?}");
                assert!(!braking(*worse).is_better_than(&braking(*better)), "{better:?} {worse:?}");
            }
        }
        assert!(!braking(None).is_better_than(&braking(None)), "the first of equal ones stays");
    }

    /// v² = v₀² − 2as and t = (v₀ − v)/a, with v₀ = 10 m/s, a = 5 m/s²: standstill at 10 m after 2 s.
    #[test]
    fn arrivals_of_full_braking_are_those_of_the_closed_form() {
        let profile = full_braking(10.0, 5.0);
        assert!((profile.last().station - 10.0).abs() < 1e-12 && (profile.duration() - 2.0).abs() < 1e-12);
        for station in [0.0, 1.0, 6.4, 9.9] {
            let speed = (100.0_f64 - 10.0 * station).sqrt();
            let contact = contact_at(&profile, 3.0, station, Blocker::RoadBoundary).unwrap();
            assert!((contact.speed - speed).abs() < 1e-12, "{contact:?}");
            assert!((contact.time - 3.0 - (10.0 - speed) / 5.0).abs() < 1e-12, "{contact:?}");
        }
        assert_eq!(contact_at(&profile, 3.0, 10.0, Blocker::RoadBoundary), None, "it stops there");
        assert_eq!(full_braking(0.0, 5.0).duration(), 0.0);
    }
}
