//! The blocked intervals as bounds on the station at single moments.
//!
//! A cell blocked from `t₁` to `t₂` is passed either before, which is to have left it at `t₁`, or after, which is not to
//! have entered it at `t₂`. Stations never fall, so one bound at one moment is all that an interval asks for, and it is
//! exact: `s(t₁) ≥` the cell's far node, or `s(t₂) ≤` its near one. Which of the two is the searched plan's choice.
//!
//! Most bounds follow from others (what is not reached at `t₂` was not reached before): only the others are kept. An
//! obstacle that drives ahead leaves one in every cell; *near* bounds take several together, where the searched plan has
//! room for it, and leave out those that it stays far from.

use crate::speed::SpeedProblem;
use crate::speed::prove::{first_time_at, last_time_at};
use crate::trajectory::SpeedProfile;

/// A bound on the station at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bound {
    /// Since the start of the profile, s.
    pub(super) time: f64,
    /// Most or least station then, m.
    pub(super) station: f64,
}

/// The bounds that keep a plan in its order with everything that moves.
#[derive(Debug, Default)]
pub(super) struct Corridor {
    /// Not beyond the station at the time; in order of both.
    upper: Vec<Bound>,
    /// At or beyond the station at the time; in order of both.
    lower: Vec<Bound>,
    near_upper: Vec<Bound>,
    near_lower: Vec<Bound>,
    is_thinned: bool,
}

/// Distance kept from each bound, m: above the solver's tolerance, below anything that matters.
const MARGIN: f64 = 1e-4;
/// Bounds farther from the searched plan than this are not near, m.
const NEAR: f64 = 5.0;
/// Bounds within so long of each other are taken together, s,
const TOGETHER: f64 = 0.2;
/// where the searched plan keeps this far from the result, m.
const ROOM: f64 = 0.5;

impl Corridor {
    pub(super) fn new(problem: &SpeedProblem, searched: &SpeedProfile) -> Self {
        let (mut upper, mut lower) = (Vec::new(), Vec::new());
        for cell in (0..problem.cells()).filter(|c| !problem.blocked[*c].is_empty()) {
            let (near, far) = (problem.stations[cell], problem.stations[cell + 1]);
            let enters = (searched.last().station > near).then(|| last_time_at(searched, near));
            let leaves = first_time_at(searched, far);
            for &(from, to) in &problem.blocked[cell] {
                let (from, to) = (from - problem.start_time, to - problem.start_time);
                if to < 0.0 {
                    continue;
                }
                if enters.is_none_or(|enters| to <= enters) {
                    upper.push(Bound { time: to, station: near });
                } else if leaves.is_some_and(|leaves| leaves <= from) {
                    lower.push(Bound { time: from, station: far });
                }
            }
        }
        let (upper, lower) = (upper_front(upper), lower_front(lower));
        let near_upper = thinned(
            &upper,
            |group, next| Bound { time: next.time, station: group.station },
            |b| b.station - searched.at(b.time).station,
        );
        let near_lower = thinned(
            &lower,
            |group, next| Bound { time: group.time, station: next.station },
            |b| searched.at(b.time).station - b.station,
        );
        let is_thinned = near_upper.iter().any(|b| !upper.contains(b)) || near_lower.iter().any(|b| !lower.contains(b));
        Self { upper, lower, near_upper, near_lower, is_thinned }
    }

    /// Stations that are not passed before their times; in order of both.
    pub(super) fn upper(&self) -> &[Bound] {
        &self.upper
    }

    /// Stations that are reached at their times; in order of both.
    pub(super) fn lower(&self) -> &[Bound] {
        &self.lower
    }

    pub(super) fn near_upper(&self) -> &[Bound] {
        &self.near_upper
    }

    pub(super) fn near_lower(&self) -> &[Bound] {
        &self.near_lower
    }

    /// Whether near bounds are stricter than the others somewhere.
    pub(super) fn is_thinned(&self) -> bool {
        self.is_thinned
    }

    /// Distance to keep from each bound, m.
    pub(super) fn margin(&self) -> f64 {
        MARGIN
    }
}

/// The upper bounds that do not follow from others, those for nearer stations at later times.
fn upper_front(mut bounds: Vec<Bound>) -> Vec<Bound> {
    bounds.sort_by(|a, b| a.station.total_cmp(&b.station).then(b.time.total_cmp(&a.time)));
    let mut latest = f64::NEG_INFINITY;
    bounds.retain(|b| {
        let is_new = b.time > latest;
        latest = latest.max(b.time);
        is_new
    });
    bounds
}

/// The lower bounds that do not follow from others, those for farther stations at earlier times.
fn lower_front(mut bounds: Vec<Bound>) -> Vec<Bound> {
    bounds.sort_by(|a, b| b.station.total_cmp(&a.station).then(a.time.total_cmp(&b.time)));
    let mut earliest = f64::INFINITY;
    bounds.retain(|b| {
        let is_new = b.time < earliest;
        earliest = earliest.min(b.time);
        is_new
    });
    bounds.reverse();
    bounds
}

/// Neighbours joined by `join` (into a stricter bound) where that leaves room, and what has a lot of room left out.
fn thinned(bounds: &[Bound], join: impl Fn(&Bound, &Bound) -> Bound, room: impl Fn(&Bound) -> f64) -> Vec<Bound> {
    let mut joined: Vec<Bound> = Vec::new();
    let mut first = 0.0;
    for bound in bounds.iter().filter(|b| room(b) < NEAR) {
        let together = joined.last().filter(|_| bound.time - first <= TOGETHER);
        let together = together.map(|group| join(group, bound)).filter(|b| room(b) >= ROOM);
        match (together, joined.last_mut()) {
            (Some(together), Some(last)) => *last = together,
            _ => {
                joined.push(*bound);
                first = bound.time;
            }
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::speed::prove;
    use crate::speed::smoothing::{Settings, smooth_and_prove};
    use crate::speed::test_support::empty_road;
    use crate::speed::{Resolution, Strategy, search, smoothing::raw_profile};
    use proptest::prelude::*;

    /// 10 m/s for four seconds, then −2 m/s² to rest at 65 m.
    fn searched() -> SpeedProfile {
        let knot = |time, station, speed, acceleration| crate::trajectory::SpeedKnot {
            time,
            station,
            speed,
            acceleration,
            jerk: 0.0,
        };
        let knots = vec![knot(0.0, 0.0, 10.0, 0.0), knot(4.0, 40.0, 10.0, -2.0), knot(9.0, 65.0, 0.0, 0.0)];
        SpeedProfile::new(knots).unwrap()
    }

    #[test]
    fn each_interval_is_one_bound_on_the_side_that_the_plan_chose() {
        let mut problem = empty_road(100.0, 10.0);
        problem.start_time = 2.0;
        problem.blocked[20] = vec![(2.0, 2.9), (3.5, 4.0)]; // 10.0 to 10.5 m, passed at 3 s
        problem.blocked[140] = vec![(30.0, 31.0)]; // 70 m, never reached
        let corridor = Corridor::new(&problem, &searched());
        let near =
            |b: &Bound, time: f64, station: f64| (b.time - time).abs() < 1e-9 && (b.station - station).abs() < 1e-9;
        let [first, last] = corridor.upper() else { panic!("{corridor:?}") };
        assert!(near(first, 0.9, 10.0) && near(last, 29.0, 70.0), "{corridor:?}");
        let [left] = corridor.lower() else { panic!("{corridor:?}") };
        assert!(near(left, 1.5, 10.5), "{corridor:?}");
        assert_eq!(corridor.near_lower(), corridor.lower(), "4.5 m is near");
        assert_eq!(corridor.near_upper().len(), 1, "one metre is near");
    }

    #[test]
    fn of_bounds_that_follow_from_others_nothing_is_kept() {
        let b = |time, station| Bound { time, station };
        let upper = upper_front(vec![b(3.0, 8.0), b(1.0, 5.0), b(2.0, 5.0), b(1.5, 7.0), b(4.0, 9.0)]);
        assert_eq!(upper, [b(2.0, 5.0), b(3.0, 8.0), b(4.0, 9.0)]);
        let lower = lower_front(vec![b(3.0, 8.0), b(1.0, 5.0), b(2.0, 5.0), b(3.5, 7.0), b(4.0, 9.0)]);
        assert_eq!(lower, [b(1.0, 5.0), b(3.0, 8.0), b(4.0, 9.0)]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        /// Near bounds say more than all bounds about the stretch that they keep: whoever keeps a joined one keeps those
        /// that it stands for.
        #[test]
        fn joined_bounds_are_stricter(
            bounds in prop::collection::vec((0.0..5.0f64, 0.0..60.0f64), 0..60),
            slow in 1.0..12.0f64,
        ) {
            let all = upper_front(bounds.iter().map(|&(time, station)| Bound { time, station }).collect());
            let join = |a: &Bound, b: &Bound| Bound { time: b.time, station: a.station };
            let room = |b: &Bound| b.station - slow * b.time;
            let near = thinned(&all, join, room);
            for bound in all.iter().filter(|b| room(b) < NEAR) {
                prop_assert!(near.iter().any(|n| n.time >= bound.time && n.station <= bound.station));
            }
        }

        /// Crossing traffic at random: what is smoothed is proved, and what the corridor says holds.
        #[test]
        fn a_smoothed_plan_keeps_every_bound(
            speed in 2.0..12.0f64,
            blocks in prop::collection::vec((20..150usize, 1..12usize, 1.0..9.0f64, 0.3..3.0f64), 1..6),
        ) {
            let mut problem = empty_road(100.0, speed);
            for (cell, cells, from, lasts) in blocks {
                for c in cell..cell + cells {
                    if problem.blocked[c].is_empty() {
                        problem.blocked[c] = vec![(from, from + lasts)];
                    }
                }
            }
            let found = search(&problem, Strategy::SafeTlp, &Resolution::default()).unwrap();
            let Some(searched) = found.proven().and_then(|plan| raw_profile(&problem, &plan)) else { return Ok(()) };
            let corridor = Corridor::new(&problem, &searched);
            let Ok(smooth) = smooth_and_prove(&problem, &problem.speed_limits, &searched, 0.0, &Settings::default()) else {
                return Ok(());
            };
            prop_assert_eq!(prove(&problem, &smooth.profile), Ok(()));
            let at = |b: &Bound| smooth.profile.at(b.time).station;
            prop_assert!(corridor.upper().iter().all(|b| at(b) <= b.station + 1e-6));
            prop_assert!(corridor.lower().iter().all(|b| at(b) >= b.station - 1e-6));
        }
    }
}
