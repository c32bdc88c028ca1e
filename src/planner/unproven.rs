//! Plans without a proof: what the vehicle does where no stop is proven.
//!
//! 1. The emergency levels are tried once more with everything that vehicle and road give, without the reserve that proofs
//!    leave to the tracking controller. A plan that is found this way touches nothing if the controller needs no reserve.
//! 2. Otherwise the committed plan goes on if what is left of it still touches nothing.
//! 3. Otherwise every path of the hardest such level is driven in two ways, with full braking, and with the contact-free motion that a
//!    search finds without asking for a stop (the first line of SafeTLP: a vehicle in dense traffic, whose full braking would be
//!    answered by a contact from behind, goes on with the traffic), followed by full braking. The motion with the latest first contact
//!    wins; of those, the one with the lowest speed at contact. The arc along the present steering angle is one of the paths.
//!
//! Such a plan claims nothing. One of the first two kinds is within what the vehicle can follow ([`super::tube`]), so that the next cycle
//! goes on from it: from the measured state, each cycle would begin the swerve anew, later by the lags of the actuators. Full braking may
//! be beyond that; the next plan starts from the measured state.
//!
//! Weak: the severity of a contact is its speed alone; a contact with a pedestrian counts as one with a wall. The search without a stop
//! stands for all other motions.

use super::allowance::Kept;
use super::level::{LEAST_ACCELERATION, Level, LevelLimits, NO_MARGINS, fine_until};
use super::profile::WithProfile;
use super::record::ExpectedContact;
use super::tube::Tube;
use super::{Committed, CycleRecord, Planner, Smoothing, Start};
use crate::collision::{Allowance, BlockedGrid, Blocker, Sweep};
use crate::geometry::spiral::CubicSpiral;
use crate::trajectory::{Path, SpeedKnot, SpeedProfile, Trajectory};

/// Contacts within this time of each other count as simultaneous, s: a step of the planner's time slices.
const SIMULTANEOUS: f64 = 0.1;
/// Least deceleration of full braking, m/s². With less grip the vehicle stops nowhere in sight, and the path to its standstill
/// would have no bound.
const LEAST_BRAKING: f64 = 0.1;
/// Length of the path beyond the standstill, m.
const BEYOND: f64 = 1.0;

/// A motion along a path, and its first contact.
struct Evading {
    trajectory: Trajectory,
    contact: Option<ExpectedContact>,
}

impl Evading {
    /// Time of the contact in steps of [`SIMULTANEOUS`], larger is better; then its speed, smaller is better.
    fn is_better_than(&self, other: &Self) -> bool {
        #[allow(clippy::cast_possible_truncation)] // times of a run
        let key = |e: &Self| e.contact.map_or((i64::MAX, 0.0), |c| ((c.time / SIMULTANEOUS).floor() as i64, -c.speed));
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
        if let Some(hardest) = levels.last().filter(|_| start.lead_contact.is_none()) {
            self.evade_on_lanes(start, *hardest, deceleration, &mut best, record);
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
            proof_begins: start.point.time,
            lane: None,
            compared: None,
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

    /// Replaces `best` by a motion along a lattice path with a later or slower first contact. A vehicle without a proof does not speed up.
    fn evade_on_lanes(
        &mut self,
        start: &Start,
        level: LevelLimits,
        deceleration: f64,
        best: &mut Evading,
        record: &mut CycleRecord,
    ) {
        for lane in 0..self.lanes.as_ref().map_or(0, Vec::len) {
            let paths = self.lattice_paths(start, lane, level, &mut record.trace.edges);
            let Some(on) = self.lanes.as_ref().ok().and_then(|l| l.get(lane)) else { return };
            let situation = self.situation(start, on, LevelLimits { acceleration: LEAST_ACCELERATION, ..level });
            for path in paths.iter().filter(|path| !situation.is_curve_speed_infeasible(path)) {
                let sweeps: Vec<&Sweep> = path.sweeps.iter().map(AsRef::as_ref).collect();
                let blocked_at = path.blocked_by.map(|what| (path.free_length, what));
                let grid = self.all_blocked(&sweeps, start.point.time, start.point.speed);
                let explored = || situation.explored(path).map(|profile| then_braking(profile, deceleration));
                let motions: [&dyn Fn() -> Option<SpeedProfile>; 2] =
                    [&|| Some(full_braking(start.point.speed, deceleration)), &explored];
                for motion in motions {
                    if best.contact.is_none() {
                        return;
                    }
                    let evading = motion().and_then(|p| self.evading_along(start, &path.path, &grid, blocked_at, &p));
                    if let Some(evading) = evading.filter(|e| e.is_better_than(best)) {
                        *best = evading;
                    }
                }
            }
        }
    }

    /// Full braking along the present curvature.
    fn braking_on_arc(&self, start: &Start, deceleration: f64) -> Evading {
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
        let grid = self.all_blocked(&[&sweep], p.time, p.speed);
        self.evading_along(start, &path, &grid, blocked_at, &full_braking(p.speed, deceleration))
            .unwrap_or_else(|| unreachable!("the path is long enough to stop on"))
    }

    /// A motion along a path, which is extended by its tangent where it is too short; `None` if it is no path then.
    fn evading_along(
        &self,
        start: &Start,
        path: &Path,
        grid: &BlockedGrid,
        blocked_at: Option<(f64, Blocker)>,
        profile: &SpeedProfile,
    ) -> Option<Evading> {
        let p = &start.point;
        let missing = profile.last().station + BEYOND - path.length();
        let path = if missing > 0.0 {
            let spirals = path.pieces().map(|(_, _, spiral)| *spiral);
            Path::new(p.pose, &spirals.chain([CubicSpiral::straight(missing)]).collect::<Vec<_>>())?
        } else {
            path.clone()
        };
        let contact = first_contact(grid, blocked_at, profile, (p.time, f64::INFINITY));
        Some(Evading { trajectory: start.lead.followed_by(&path, profile), contact: start.lead_contact.or(contact) })
    }
}

impl Planner<'_> {
    /// The cells that all moving obstacles, also yielding ones, block on sweeps from a time (s of the run) on; finely where a vehicle with a
    /// speed (m/s) is soon.
    pub(super) fn all_blocked(&self, sweeps: &[&Sweep], from: f64, speed: f64) -> BlockedGrid {
        let predictions = self.known.world.predictions();
        let times = (from, predictions.horizon().max(from + 1.0));
        predictions.blocked_finely(sweeps, &NO_MARGINS.moving_obstacles, times, fine_until(speed))
    }
}

/// Braking to standstill at a constant deceleration.
fn full_braking(speed: f64, deceleration: f64) -> SpeedProfile {
    let knot = SpeedKnot { time: 0.0, station: 0.0, speed, acceleration: 0.0, jerk: 0.0 };
    let start = SpeedProfile::new(vec![knot]).unwrap_or_else(|| unreachable!("one knot is a profile"));
    then_braking(start, deceleration)
}

/// The profile, and after its end braking to standstill at a constant deceleration.
fn then_braking(profile: SpeedProfile, deceleration: f64) -> SpeedProfile {
    let mut knots = profile.knots().to_vec();
    let last = knots.len() - 1;
    if knots[last].speed == 0.0 {
        return profile;
    }
    knots[last].acceleration = -deceleration;
    let stands = knots[last].after(knots[last].speed / deceleration);
    knots.push(SpeedKnot { speed: 0.0, acceleration: 0.0, ..stands });
    SpeedProfile::new(knots).unwrap_or_else(|| unreachable!("knots in order are a profile"))
}

/// When a profile with constant accelerations between its knots first reaches a station (m), s since its start, and its speed there,
/// m/s; `None` if it ends before.
fn arrival(profile: &SpeedProfile, station: f64) -> Option<(f64, f64)> {
    if station > profile.last().station {
        return None;
    }
    let knots = profile.knots();
    let from = &knots[knots.partition_point(|k| k.station < station).saturating_sub(1)];
    let ahead = station - from.station;
    let speed = (from.speed * from.speed + 2.0 * from.acceleration * ahead).max(0.0).sqrt();
    let takes = if ahead > 0.0 { 2.0 * ahead / (from.speed + speed) } else { 0.0 };
    Some((from.time + takes, speed))
}

/// The first contact of a profile with constant accelerations between its knots: with what blocks the path from a station (m) on, or with
/// moving obstacles on a grid. `until` (s of the run) is when the vehicle leaves the end of the profile; infinite where it stands there.
pub(super) fn first_contact(
    grid: &BlockedGrid,
    blocked_at: Option<(f64, Blocker)>,
    profile: &SpeedProfile,
    (begins, until): (f64, f64),
) -> Option<ExpectedContact> {
    let fixed = blocked_at.and_then(|(station, what)| {
        // a vehicle that stops there touches nothing
        let (time, speed) = arrival(profile, station).filter(|_| station < profile.last().station)?;
        Some(ExpectedContact { what, time: begins + time, speed })
    });
    let visit = |cell: usize| {
        let from = begins + arrival(profile, grid.stations()[cell])?.0;
        let to = arrival(profile, grid.stations()[cell + 1]).map_or(until, |(time, _)| begins + time);
        let blocked = grid.first_blocked(cell, from, to)?;
        let time = blocked.from.max(from);
        let speed = profile.at(time - begins).speed;
        Some(ExpectedContact { what: Blocker::Obstacle(blocked.obstacle), time, speed })
    };
    let moving = (0..grid.cells()).filter_map(visit);
    fixed.into_iter().chain(moving).reduce(|a, b| if b.time < a.time { b } else { a })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::straight;
    use crate::geometry::Pose;

    fn braking(contact: Option<(f64, f64)>) -> Evading {
        let path = straight(Pose::new(0.0, 0.0, 0.0), 10.0);
        let trajectory = Trajectory { start_time: 0.0, path, profile: full_braking(4.0, 2.0) };
        let contact = contact.map(|(time, speed)| ExpectedContact { what: Blocker::Obstacle(1), time, speed });
        Evading { trajectory, contact }
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
            let (time, found) = arrival(&profile, station).unwrap();
            assert!((found - speed).abs() < 1e-12 && (time - (10.0 - speed) / 5.0).abs() < 1e-12, "{time} {found}");
        }
        assert_eq!(arrival(&profile, 10.1), None, "it stops before");
        assert_eq!(full_braking(0.0, 5.0).duration(), 0.0);
    }

    /// 2 s from 4 m/s to a standstill of 1 s, 2 s with 1 m/s², then braking: v = 2 m/s at the last knot, 1 m to standstill with 2 m/s².
    #[test]
    fn arrivals_are_the_first_ones_and_braking_begins_where_the_profile_ends() {
        let knot = |time, station, speed, acceleration| SpeedKnot { time, station, speed, acceleration, jerk: 0.0 };
        let knots = [(0.0, 0.0, 4.0, -2.0), (2.0, 4.0, 0.0, 0.0), (3.0, 4.0, 0.0, 1.0), (5.0, 6.0, 2.0, 0.0)];
        let profile = SpeedProfile::new(knots.map(|(t, s, v, a)| knot(t, s, v, a)).to_vec()).unwrap();
        let braked = then_braking(profile, 2.0);
        assert_eq!(braked.last(), &knot(6.0, 7.0, 0.0, 0.0));
        assert_eq!(arrival(&braked, 4.0), Some((2.0, 0.0)), "before the wait");
        assert_eq!(arrival(&braked, 4.5), Some((4.0, 1.0)), "after it");
        assert_eq!(arrival(&braked, 6.75), Some((5.5, 1.0)));
        assert_eq!((arrival(&braked, 0.0), arrival(&braked, 7.0)), (Some((0.0, 4.0)), Some((6.0, 0.0))));
    }
}
