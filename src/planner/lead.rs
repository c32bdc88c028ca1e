//! The lead of a plan: the motion from the time of a cycle until a new plan can take effect.
//!
//! Brakes respond with a lag, so that a stop which is decided now begins later. A plan therefore starts where the vehicle will be
//! one lag of the brakes after the cycle, and its trajectory begins with the motion until then: that of the committed plan, or
//! the present acceleration and curvature without one. So proofs pay the distance driven during the lag, and the controller
//! knows each step of the acceleration as early as the brakes need (trajectory stitching, as in Apollo's planning module).
//!
//! The lead on a committed plan is part of a proof. One that is extrapolated is checked here, without margins: no plan can
//! prevent a contact during the lead.
//!
//! An extrapolated lead is the motion of wheels that roll where they point. A vehicle that skids moves in another way, and no plan of it is
//! proven.
//!
//! The lead of a measured state with an acceleration lasts as long as the drive needs to release it, if that is longer than the lag of the
//! brakes.
//!
//! Weak: on a committed plan, the lag of the drive is left to the tracking controller.

use super::Planner;
use super::allowance::{Kept, STANDING, allowance_at};
use super::level::NO_MARGINS;
use super::record::ExpectedContact;
use super::unproven::first_contact;
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::trajectory::{Path, SpeedKnot, SpeedProfile, Trajectory, TrajectoryPoint};
use crate::vehicle::{State, Vehicle};

/// The motion before a plan takes effect.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Lead {
    /// Time of the cycle, s of the run.
    begins: f64,
    start: Pose,
    spirals: Vec<CubicSpiral>,
    /// Knots with times since the cycle and stations from the start; the last one is the end of the lead.
    knots: Vec<SpeedKnot>,
}

/// How long the brakes of a vehicle take to respond, s: proofs on a committed plan begin that much after the cycle.
pub(super) fn duration(vehicle: &Vehicle) -> f64 {
    vehicle.actuators.brake_lag
}

impl Lead {
    /// The next `duration` seconds of a trajectory.
    pub(super) fn on(trajectory: &Trajectory, time: f64, duration: f64) -> Self {
        let profile = &trajectory.profile;
        let (from, to) = (time - trajectory.start_time, time - trajectory.start_time + duration);
        let (first, last) = (profile.at(from), profile.at(to));
        let inner = profile.knots().iter().filter(|k| from < k.time && k.time < to).copied();
        let rebased = |k: SpeedKnot| SpeedKnot { time: k.time - from, station: k.station - first.station, ..k };
        Self {
            begins: time,
            start: trajectory.path.at(first.station).pose,
            spirals: trajectory.path.part(first.station, last.station),
            knots: std::iter::once(first).chain(inner).chain([last]).map(rebased).collect(),
        }
    }

    /// The measured motion continued with its acceleration and curvature, at the longest to standstill.
    pub(super) fn extrapolated(state: &State, vehicle: &Vehicle, duration: f64) -> Self {
        let (speed, acceleration) = (state.speed.max(0.0), state.acceleration);
        let first = SpeedKnot { time: 0.0, station: 0.0, speed, acceleration, jerk: 0.0 };
        let moves_for = if acceleration < 0.0 { duration.min(-speed / acceleration) } else { duration };
        let mut knots = vec![first];
        if moves_for < duration {
            if moves_for > 0.0 {
                knots.push(first.after(moves_for));
            }
            let last = knots.len() - 1;
            (knots[last].speed, knots[last].acceleration) = (0.0, 0.0);
            knots.push(SpeedKnot { time: duration, ..knots[last] });
        } else {
            knots.push(first.after(duration));
        }
        let length = knots[knots.len() - 1].station;
        let arc = CubicSpiral { knots: [state.steering.tan() / vehicle.wheelbase; 4], length };
        let path = Path::new(state.pose, &[arc]);
        let spirals = path.map_or_else(Vec::new, |path| path.part(0.0, length));
        Self { begins: state.time, start: state.pose, spirals, knots }
    }

    /// Its path; `None` at standstill.
    pub(super) fn path(&self) -> Option<Path> {
        Path::new(self.start, &self.spirals)
    }

    /// Its path, or the place where the vehicle stands: a path of [`STANDING`].
    pub(super) fn path_or_place(&self) -> Option<Path> {
        self.path().or_else(|| Path::new(self.start, &[CubicSpiral::straight(STANDING)]))
    }

    /// Its length, m.
    pub(super) fn length(&self) -> f64 {
        self.knots[self.knots.len() - 1].station
    }

    /// Time of the cycle, s of the run.
    pub(super) fn begins(&self) -> f64 {
        self.begins
    }

    /// The pose at that time.
    pub(super) fn start(&self) -> &Pose {
        &self.start
    }

    /// Its largest deceleration, m/s².
    pub(super) fn deceleration(&self) -> f64 {
        self.knots.iter().map(|k| -k.acceleration).fold(0.0, f64::max)
    }

    /// The state at its end, where plans start. Stations are those of the lead; `curvature` is that of a lead without a length.
    pub(super) fn end(&self, curvature: f64) -> TrajectoryPoint {
        let knot = self.knots[self.knots.len() - 1];
        let path = self.path().map(|path| path.at(path.length()));
        TrajectoryPoint {
            time: self.begins + knot.time,
            pose: path.map_or(self.start, |p| p.pose),
            curvature: path.map_or(curvature, |p| p.curvature),
            curvature_rate: path.map_or(0.0, |p| p.curvature_rate),
            station: knot.station,
            speed: knot.speed,
            acceleration: knot.acceleration,
            jerk: knot.jerk,
        }
    }

    /// The trajectory of the lead and a plan that starts at its end.
    pub(super) fn followed_by(&self, path: &Path, profile: &SpeedProfile) -> Trajectory {
        let (before, end) = (&self.knots[..self.knots.len() - 1], self.knots[self.knots.len() - 1]);
        let moved = |k: &SpeedKnot| SpeedKnot { time: k.time + end.time, station: k.station + end.station, ..*k };
        let mut knots: Vec<SpeedKnot> = Vec::new();
        for knot in before.iter().copied().chain(profile.knots().iter().map(moved)) {
            // times that differ by less than their rounding (brakes without a lag, a last millionth of speed): the later knot counts
            while knots.last().is_some_and(|last| last.time >= knot.time) {
                knots.pop();
            }
            knots.push(knot);
        }
        let spirals: Vec<CubicSpiral> =
            self.spirals.iter().copied().chain(path.pieces().map(|(_, _, spiral)| *spiral)).collect();
        Trajectory {
            start_time: self.begins,
            path: Path::new(self.start, &spirals).unwrap_or_else(|| path.clone()),
            profile: SpeedProfile::new(knots).unwrap_or_else(|| unreachable!("knots in order are a profile")),
        }
    }
}

impl Planner<'_> {
    /// The first contact during an extrapolated lead, without margins. A standing vehicle is where it stands.
    pub(super) fn contact_during(&self, lead: &Lead) -> Option<ExpectedContact> {
        let path = lead.path_or_place()?;
        let profile = SpeedProfile::new(lead.knots.clone())?;
        let world = &self.known.world;
        let sweep = world.sweep_path(&path);
        let end = lead.end(0.0);
        let ends = end.time;
        let at = TrajectoryPoint { pose: lead.start, time: lead.begins, ..end };
        let allowance = allowance_at(world, &NO_MARGINS, &at, Kept::Nothing);
        let hit = world.probe_path(&path).static_hit(&NO_MARGINS, &allowance);
        let fixed = hit.map(|hit| (hit.station, hit.what));
        let grid = self.all_blocked(&[&sweep], lead.begins, profile.knots()[0].speed);
        first_contact(&grid, fixed, &profile, (lead.begins, ends))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{knot, vehicle};

    const DURATION: f64 = 0.25;

    /// Two arcs, driven with braking and a stop.
    fn committed() -> Trajectory {
        let arcs = [(0.02, 7.0), (-0.03, 40.0)].map(|(k, length)| CubicSpiral { knots: [k; 4], length });
        let path = Path::new(Pose::new(3.0, -1.0, 0.4), &arcs).unwrap();
        let knots = vec![knot(0.0, 0.0, 8.0, 0.0), knot(1.0, 8.0, 8.0, -4.0), knot(3.0, 16.0, 0.0, 0.0)];
        Trajectory { start_time: 5.0, path, profile: SpeedProfile::new(knots).unwrap() }
    }

    /// A plan from the end of a lead.
    fn rest(end: &TrajectoryPoint) -> (Path, SpeedProfile) {
        let path = Path::new(end.pose, &[CubicSpiral { knots: [end.curvature; 4], length: 50.0 }]).unwrap();
        let mut knots = vec![knot(0.0, 0.0, end.speed, -2.0)];
        if end.speed > 0.0 {
            knots.push(knot(end.speed / 2.0, end.speed * end.speed / 4.0, 0.0, 0.0));
        }
        (path, SpeedProfile::new(knots).unwrap())
    }

    #[test]
    fn a_lead_on_a_trajectory_is_that_trajectory_and_the_plan_continues_from_its_end() {
        let committed = committed();
        for now in [5.0, 5.3, 5.9, 6.4, 7.8, 7.99, 8.0, 12.0] {
            let lead = Lead::on(&committed, now, DURATION);
            let end = lead.end(0.0);
            let there = committed.at(now + DURATION);
            assert!((end.pose.position - there.pose.position).norm() < 1e-9 && (end.speed - there.speed).abs() < 1e-9);
            assert!((end.time - there.time).abs() < 1e-12, "{now}");
            let (path, profile) = rest(&end);
            let joined = lead.followed_by(&path, &profile);
            for i in 0..=10 {
                let after = f64::from(i) / 10.0 * DURATION * (1.0 - 1e-9);
                let (a, b) = (joined.at(now + after), committed.at(now + after));
                assert!((a.pose.position - b.pose.position).norm() < 1e-6, "{now} {after}");
                assert!((a.speed - b.speed).abs() < 1e-9 && (a.acceleration - b.acceleration).abs() < 1e-9);
            }
            for after in [0.3, 1.0] {
                let planned = path.at(profile.at(after).station).pose.position;
                assert!((joined.at(now + DURATION + after).pose.position - planned).norm() < 1e-6, "{now} {after}");
            }
        }
    }

    /// A lag below the rounding of the time, and a plan that stops within it.
    #[test]
    fn knots_that_rounding_puts_at_the_same_time_are_one() {
        let committed = committed();
        for lag in [0.0, 1e-20, f64::MIN_POSITIVE] {
            for now in [5.0, 5.3, 6.0, 7.99, 12.0] {
                let lead = Lead::on(&committed, now, lag);
                let (path, profile) = rest(&lead.end(0.0));
                let joined = lead.followed_by(&path, &profile);
                assert!((joined.at(now).speed - committed.at(now).speed).abs() < 1e-9);
                assert_eq!(joined.profile.last().speed, 0.0, "{now}");
            }
        }
        let lead = Lead::on(&committed, 5.3, DURATION);
        let (path, _) = rest(&lead.end(0.0));
        let stops = SpeedProfile::new(vec![knot(0.0, 0.0, 1e-18, -8.0), knot(1e-18 / 8.0, 0.0, 0.0, 0.0)]).unwrap();
        let joined = lead.followed_by(&path, &stops);
        assert_eq!((joined.profile.last().speed, joined.profile.last().acceleration), (0.0, 0.0));
    }

    #[test]
    fn without_a_plan_the_measured_motion_continues_at_the_longest_to_standstill() {
        let vehicle = vehicle();
        let state = |speed, acceleration| State {
            time: 2.0,
            pose: Pose::new(1.0, 2.0, 0.7),
            speed,
            lateral_speed: 0.0,
            acceleration,
            yaw_rate: 0.0,
            steering: 0.1,
        };
        // s = v t + a t²/2, v = v₀ + a t, until v = 0
        for (speed, acceleration) in [(8.0, 0.0), (8.0, 2.0), (8.0, -6.0), (0.5, -4.0), (0.0, -4.0), (0.0, 0.0)] {
            let lead = Lead::extrapolated(&state(speed, acceleration), &vehicle, DURATION);
            let time = if acceleration < 0.0 { DURATION.min(-speed / acceleration) } else { DURATION };
            let (length, end) = (speed * time + 0.5 * acceleration * time * time, lead.end(0.04));
            assert!((lead.length() - length).abs() < 1e-12, "{speed} {acceleration}: {lead:?}");
            assert!((end.speed - (speed + acceleration * time)).abs() < 1e-12 && end.time == 2.0 + DURATION);
            let curvature = if length > 0.0 { 0.1_f64.tan() / vehicle.wheelbase } else { 0.04 };
            assert!((end.curvature - curvature).abs() < 1e-12);
            let (path, profile) = rest(&end);
            let joined = lead.followed_by(&path, &profile);
            assert_eq!(joined.at(2.0).speed, speed);
            assert!((joined.at(2.0 + DURATION).station - length).abs() < 1e-9);
        }
    }
}
