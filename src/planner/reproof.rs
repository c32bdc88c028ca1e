//! The proof of the committed plan, again in each cycle.
//!
//! A plan was proven for what was known when it was made. Each cycle proves the rest of it again for what is known now: from
//! the present time on, no cell that the vehicle still visits is blocked, and the standstill at its end stays free until the
//! horizon ([`prove`](crate::speed::prove()), which shares no code with the searches). Static obstacles are checked again when they have
//! changed. Speed limits of curves and rules depend on nothing that changes.
//!
//! A plan with margins that holds only without them goes on as one without. A plan that holds no more is one without a proof:
//! [`Level::Unproven`].

use super::allowance::{Kept, allowance_at};
use super::level::Level;
use super::tube::Deviation;
use super::{Committed, Planner};
use crate::collision::{SafetyMargins, Sweep};
use crate::speed::{AccelerationLimits, SpeedProblem, first_time_at, last_time_at, prove};
use crate::trajectory::{Path, Trajectory};
use crate::vehicle::State;

/// Tolerance of a changed limit, m/s².
const ACCELERATION_SLACK: f64 = 1e-9;
/// Tolerance of stations, m: that of the proof.
const STATION_SLACK: f64 = 1e-3;
/// What a visit is longer on both sides, m: the proof looks at the cells on both sides of a node that is within its tolerance.
const VISIT_SLACK: f64 = 2.0 * STATION_SLACK;

impl Planner<'_> {
    /// Proves the rest of the committed plan for what is known now, and sets its level accordingly.
    pub(super) fn verify_committed(&mut self, state: &State) {
        let Some(committed) = self.committed.take_if(|c| c.level.is_proven()) else { return };
        let reference = committed.trajectory.at(state.time);
        let tube = committed.tube.containing(&Deviation::between(&reference.pose, &state.pose));
        let margins = committed.margins.at_least(&tube.margins);
        let as_before = (committed.level, margins, committed.robust);
        let bare = (committed.level.max(Level::NoMargin), tube.margins, false);
        let weaker = [as_before, (committed.level, margins, false), bare];
        let holds =
            weaker.into_iter().find(|(_, margins, robust)| self.holds(&committed, margins, *robust, state.time));
        let (level, margins, robust) = holds.unwrap_or((Level::Unproven, margins, false));
        let statics = self.known.statics;
        let compared = committed.compared.filter(|_| (level, robust) == (as_before.0, as_before.2));
        self.committed = Some(Committed { level, margins, robust, statics, compared, ..committed });
    }

    fn holds(&self, plan: &Committed, margins: &SafetyMargins, robust: bool, now: f64) -> bool {
        plan.deceleration <= self.limits.deceleration() + ACCELERATION_SLACK
            && (plan.statics == self.known.statics && plan.margins.at_least(margins) == plan.margins
                || self.is_free_of_statics(&plan.trajectory, margins, now, Kept::Nothing)
                    && self.is_free_of_statics(&plan.trajectory, &plan.tube.margins, now, Kept::Share))
            && self.is_free_of_traffic(&plan.trajectory, (&plan.sweeps(), plan.fine_until), margins, robust, now)
    }

    /// Whether the part of the path that is still ahead is free of static obstacles, up to the standstill.
    pub(super) fn is_free_of_statics(&self, plan: &Trajectory, margins: &SafetyMargins, now: f64, kept: Kept) -> bool {
        let (world, here) = (&self.known.world, plan.at(now));
        let ahead = Path::new(here.pose, &plan.path.part(here.station, f64::INFINITY));
        let Some(ahead) = ahead else { return true };
        let allowance = allowance_at(world, margins, &here, kept);
        let hit = world.probe_path(&ahead).static_hit(margins, &allowance);
        hit.is_none_or(|hit| here.station + hit.station >= plan.profile.last().station - STATION_SLACK)
    }

    /// Whether the sweeps of a trajectory, resolved finely up to a station (m), are free of traffic while it visits them.
    pub(super) fn is_free_of_traffic(
        &self,
        trajectory: &Trajectory,
        (sweeps, fine_until): (&[&Sweep], f64),
        margins: &SafetyMargins,
        robust: bool,
        now: f64,
    ) -> bool {
        let horizon = self.known.horizon.max(now + 1.0);
        if sweeps.is_empty() {
            return true;
        }
        let mut before = 0.0;
        let visits: Vec<_> = sweeps
            .iter()
            .map(|sweep| {
                let stations = (before, before + sweep.length());
                before = stations.1;
                (*sweep, visit(trajectory, stations, (now, horizon)))
            })
            .collect();
        let grid = self.predictions(robust).blocked_during(&visits, &margins.moving_obstacles, fine_until);
        let ahead = |cell: usize| grid.intervals(cell).iter().map(|b| (b.from.max(now), b.to)).collect::<Vec<_>>();
        let stations = grid.stations().to_vec();
        let problem = SpeedProblem {
            speed_limits: vec![f64::INFINITY; stations.len()],
            blocked: (0..grid.cells()).map(ahead).collect(),
            blocked_at_start: ahead(0),
            stopping_allowed: vec![true; stations.len()],
            start_speed: trajectory.profile.knots()[0].speed,
            start_time: trajectory.start_time,
            horizon,
            limits: AccelerationLimits {
                acceleration: f64::INFINITY,
                deceleration: f64::INFINITY,
                aggressive_deceleration: f64::INFINITY,
            },
            stations,
        };
        prove(&problem, &trajectory.profile).is_ok()
    }
}

/// The times at which a trajectory is between two stations (m), from now to the horizon, s of the run; up to the horizon where it ends there, and
/// an interval of no length where it never is.
fn visit(trajectory: &Trajectory, (from, to): (f64, f64), (now, horizon): (f64, f64)) -> (f64, f64) {
    let (profile, begins) = (&trajectory.profile, trajectory.start_time);
    let Some(enters) = first_time_at(profile, from - VISIT_SLACK) else { return (now, now) };
    let ends_inside = profile.last().station <= to + VISIT_SLACK;
    let leaves = if ends_inside { horizon } else { begins + last_time_at(profile, to + VISIT_SLACK) };
    let enters = (begins + enters).max(now);
    (enters, leaves.max(enters))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::straight;
    use crate::geometry::Pose;
    use crate::trajectory::{SpeedKnot, SpeedProfile};

    /// Accelerates, drives on, waits at 20 m and goes on to a stop at 30 m.
    fn with_a_wait() -> Trajectory {
        let knot = |time, station, speed, acceleration| SpeedKnot { time, station, speed, acceleration, jerk: 0.0 };
        let knots = vec![
            knot(0.0, 0.0, 4.0, 0.0),
            knot(4.0, 16.0, 4.0, -2.0),
            knot(6.0, 20.0, 0.0, 0.0),
            knot(9.0, 20.0, 0.0, 2.0),
            knot(11.0, 24.0, 4.0, -4.0 / 3.0),
            knot(14.0, 30.0, 0.0, 0.0),
        ];
        let path = straight(Pose::new(0.0, 0.0, 0.0), 50.0);
        Trajectory { start_time: 3.0, path, profile: SpeedProfile::new(knots).unwrap() }
    }

    /// Each time is in the visit of the part of the path where the vehicle is then; the visit of its stop lasts to the horizon.
    #[test]
    fn a_visit_contains_every_time_at_which_the_vehicle_is_there() {
        const HORIZON: f64 = 40.0;
        let trajectory = with_a_wait();
        for now in [3.0, 5.0, 9.0, 13.0, 20.0] {
            for (from, to) in
                [(0.0, 4.0), (4.0, 16.0), (16.0, 20.0), (20.0, 24.0), (24.0, 30.0), (30.0, 34.0), (34.0, 50.0)]
            {
                let (enters, leaves) = visit(&trajectory, (from, to), (now, HORIZON));
                let mut is_there = false;
                for i in 0..=4000 {
                    let time = now + (HORIZON - now) * f64::from(i) / 4000.0;
                    let station = trajectory.at(time).station;
                    if (from..=to).contains(&station) {
                        is_there = true;
                        assert!((enters..=leaves).contains(&time), "{from} {to} {time}: {enters} {leaves}");
                    }
                }
                let is_stop = (from..=to).contains(&30.0);
                assert!(!is_stop || leaves == HORIZON, "{from} {to}: {leaves}");
                assert!(is_there || leaves - enters < 1e-2, "{from} {to} from {now}: {enters} {leaves}");
            }
        }
    }
}
