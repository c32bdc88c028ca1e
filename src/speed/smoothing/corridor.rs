//! The station–time corridor: blocked intervals as bounds on the station at given times.
//!
//! A vehicle passes a cell that is blocked from `t₁` to `t₂` either before, if it has left the cell at `t₁`, or after,
//! if it has not entered the cell at `t₂`. The station never decreases, so each interval is exactly one bound at one
//! time: `s(t₁) ≥` the far node of the cell, or `s(t₂) ≤` its near node. The raw profile decides which of the two
//! applies.
//!
//! The corridor drops bounds that follow from others: a station not reached at `t₂` was not reached earlier. A lead
//! vehicle still leaves one bound per cell. The *near* bounds merge neighbouring ones where the raw profile keeps
//! enough distance, and omit those that the raw profile stays far away from.

use crate::speed::SpeedProblem;
use crate::speed::prove::{first_time_at, last_time_at};
use crate::trajectory::SpeedProfile;

/// A bound on the station at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bound {
    /// Time since the start of the profile, s.
    pub(super) time: f64,
    /// Maximum or minimum station, m.
    pub(super) station: f64,
}

/// The bounds that fix the order in which the vehicle passes moving obstacles.
#[derive(Debug, Default)]
pub(super) struct Corridor {
    /// Maximum stations, in increasing order of station and time.
    upper: Vec<Bound>,
    /// Minimum stations, in increasing order of station and time.
    lower: Vec<Bound>,
    near_upper: Vec<Bound>,
    near_lower: Vec<Bound>,
    is_thinned: bool,
}

/// Distance to each bound, m: above the solver's tolerance, far below the collision margins.
const MARGIN: f64 = 1e-4;
/// A bound is near if the raw profile is less than this away from it, m.
const NEAR: f64 = 5.0;
/// Time span within which near bounds are merged, s.
const MERGE_SPAN: f64 = 0.2;
/// Minimum distance of the raw profile to a merged bound, m.
const MIN_CLEARANCE: f64 = 0.5;

impl Corridor {
    pub(super) fn new(problem: &SpeedProblem, raw: &SpeedProfile) -> Self {
        let (mut upper, mut lower) = (Vec::new(), Vec::new());
        for cell in (0..problem.cells()).filter(|c| !problem.blocked[*c].is_empty()) {
            let (near, far) = (problem.stations[cell], problem.stations[cell + 1]);
            let enters = (raw.last().station > near).then(|| last_time_at(raw, near));
            let leaves = first_time_at(raw, far);
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
            |merged, next| Bound { time: next.time, station: merged.station },
            |b| b.station - raw.at(b.time).station,
        );
        let near_lower = thinned(
            &lower,
            |merged, next| Bound { time: merged.time, station: next.station },
            |b| raw.at(b.time).station - b.station,
        );
        let is_thinned = near_upper.iter().any(|b| !upper.contains(b)) || near_lower.iter().any(|b| !lower.contains(b));
        Self { upper, lower, near_upper, near_lower, is_thinned }
    }

    /// Maximum stations, in increasing order of station and time.
    pub(super) fn upper(&self) -> &[Bound] {
        &self.upper
    }

    /// Minimum stations, in increasing order of station and time.
    pub(super) fn lower(&self) -> &[Bound] {
        &self.lower
    }

    pub(super) fn near_upper(&self) -> &[Bound] {
        &self.near_upper
    }

    pub(super) fn near_lower(&self) -> &[Bound] {
        &self.near_lower
    }

    /// Whether a near bound is stricter than the exact ones.
    pub(super) fn is_thinned(&self) -> bool {
        self.is_thinned
    }

    /// Distance to each bound, m.
    pub(super) fn margin(&self) -> f64 {
        MARGIN
    }
}

/// The upper bounds without those that follow from a bound on a nearer station at a later time.
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

/// The lower bounds without those that follow from a bound on a farther station at an earlier time.
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

/// The near bounds. `merge` replaces two neighbours by one stricter bound; `clearance` is the distance of the raw
/// profile to a bound, m.
fn thinned(bounds: &[Bound], merge: impl Fn(&Bound, &Bound) -> Bound, clearance: impl Fn(&Bound) -> f64) -> Vec<Bound> {
    let mut near: Vec<Bound> = Vec::new();
    let mut first = 0.0;
    for bound in bounds.iter().filter(|b| clearance(b) < NEAR) {
        let previous = near.last().filter(|_| bound.time - first <= MERGE_SPAN);
        let merged = previous.map(|previous| merge(previous, bound)).filter(|b| clearance(b) >= MIN_CLEARANCE);
        match (merged, near.last_mut()) {
            (Some(merged), Some(last)) => *last = merged,
            _ => {
                near.push(*bound);
                first = bound.time;
            }
        }
    }
    near
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::speed::prove;
    use crate::speed::smoothing::{Settings, Smoother};
    use crate::speed::test_support::empty_road;
    use crate::speed::{Resolution, Strategy, search, smoothing::raw_profile};
    use proptest::prelude::*;

    /// 10 m/s for four seconds, then −2 m/s² to standstill at 65 m.
    fn raw() -> SpeedProfile {
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
    fn each_interval_gives_one_bound_on_the_side_of_the_raw_profile() {
        let mut problem = empty_road(100.0, 10.0);
        problem.start_time = 2.0;
        problem.blocked[20] = vec![(2.0, 2.9), (3.5, 4.0)]; // 10.0 to 10.5 m, passed at 3 s
        problem.blocked[140] = vec![(30.0, 31.0)]; // 70 m, never reached
        let corridor = Corridor::new(&problem, &raw());
        let near =
            |b: &Bound, time: f64, station: f64| (b.time - time).abs() < 1e-9 && (b.station - station).abs() < 1e-9;
        let [first, last] = corridor.upper() else { panic!("{corridor:?}") };
        assert!(near(first, 0.9, 10.0) && near(last, 29.0, 70.0), "{corridor:?}");
        let [left] = corridor.lower() else { panic!("{corridor:?}") };
        assert!(near(left, 1.5, 10.5), "{corridor:?}");
        assert_eq!(corridor.near_lower(), corridor.lower(), "a bound at 4.5 m is near");
        assert_eq!(corridor.near_upper().len(), 1, "only the bound at 1 m is near");
    }

    #[test]
    fn drops_bounds_that_follow_from_others() {
        let b = |time, station| Bound { time, station };
        let upper = upper_front(vec![b(3.0, 8.0), b(1.0, 5.0), b(2.0, 5.0), b(1.5, 7.0), b(4.0, 9.0)]);
        assert_eq!(upper, [b(2.0, 5.0), b(3.0, 8.0), b(4.0, 9.0)]);
        let lower = lower_front(vec![b(3.0, 8.0), b(1.0, 5.0), b(2.0, 5.0), b(3.5, 7.0), b(4.0, 9.0)]);
        assert_eq!(lower, [b(1.0, 5.0), b(3.0, 8.0), b(4.0, 9.0)]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        /// A merged bound implies the bounds that it replaces.
        #[test]
        fn merged_bounds_are_stricter(
            bounds in prop::collection::vec((0.0..5.0f64, 0.0..60.0f64), 0..60),
            slow in 1.0..12.0f64,
        ) {
            let all = upper_front(bounds.iter().map(|&(time, station)| Bound { time, station }).collect());
            let merge = |a: &Bound, b: &Bound| Bound { time: b.time, station: a.station };
            let clearance = |b: &Bound| b.station - slow * b.time;
            let near = thinned(&all, merge, clearance);
            for bound in all.iter().filter(|b| clearance(b) < NEAR) {
                prop_assert!(near.iter().any(|n| n.time >= bound.time && n.station <= bound.station));
            }
        }

        /// Random crossing traffic: every smoothed profile is proved and stays in the corridor.
        #[test]
        fn smoothed_profile_keeps_every_bound(
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
            let Some(raw) = found.proven().and_then(|plan| raw_profile(&problem, &plan)) else { return Ok(()) };
            let corridor = Corridor::new(&problem, &raw);
            let smoother = Smoother::new(Settings::default()).unwrap();
            let Ok(smooth) = smoother.smooth_and_prove(&problem, &problem.speed_limits, &raw, 0.0) else {
                return Ok(());
            };
            prop_assert_eq!(prove(&problem, &smooth.profile), Ok(()));
            let at = |b: &Bound| smooth.profile.at(b.time).station;
            prop_assert!(corridor.upper().iter().all(|b| at(b) <= b.station + 1e-6));
            prop_assert!(corridor.lower().iter().all(|b| at(b) >= b.station - 1e-6));
        }
    }
}
