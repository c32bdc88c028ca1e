//! Faults on purpose: what goes wrong in the rig while the planner believes that all is well.
//!
//! The planner, its proofs and the tracking controller keep the vehicle as it is described; the rig drives another one, or
//! late, or lets it think that it is somewhere else; and the verdict judges the truth. Whatever the fault, a run ends with the
//! name of the promise that broke, or with none broken.

use serde::{Deserialize, Serialize};

use crate::planner::{Cycle, Decision};
use crate::simulation::{Disturbances, LocalisationNoise};
use crate::vehicle::Vehicle;

/// Faults of a run. None by default. In a settings file: the table `[faults]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Faults {
    /// Dead time between the controller's decisions and the actuators, s, on top of the vehicle's own lags.
    pub delay: f64,
    /// Factor on the friction of the road.
    pub friction: f64,
    /// Factor on the vehicle's mass and yaw inertia; the forces of drive and brakes stay what they are for the mass that is
    /// believed.
    pub mass: f64,
    /// Standard deviation of the localisation along the vehicle and across it, m; that of the heading is
    /// [`YAW_PER_METRE`] times as much.
    pub noise: f64,
    /// Planning cycles missed after each that is made; the last plan goes on meanwhile.
    pub missed_cycles: u32,
    /// Seed of the localisation's error.
    pub seed: u64,
}

/// Standard deviation of the heading for one metre of the position's, rad/m: 0.1 m goes with 0.01 rad (0.6°), as in an
/// inertial system aided by satellites.
pub const YAW_PER_METRE: f64 = 0.1;
/// Time in which the localisation's error is forgotten, s.
const CORRELATION_TIME: f64 = 1.0;

impl Default for Faults {
    fn default() -> Self {
        Self { delay: 0.0, friction: 1.0, mass: 1.0, noise: 0.0, missed_cycles: 0, seed: 0 }
    }
}

impl Faults {
    /// The names by which faults are injected.
    pub const NAMES: [&'static str; 5] = ["delay", "friction", "mass", "noise", "missed_cycles"];

    /// Whether anything goes wrong.
    #[must_use]
    pub fn is_any(&self) -> bool {
        *self != Self { seed: self.seed, ..Self::default() }
    }

    /// Injects one fault, written `name=value`.
    ///
    /// # Errors
    /// A name that is none, or a value that is no number or out of its range.
    pub fn inject(&mut self, text: &str) -> Result<(), String> {
        let expected = || format!("expected NAME=VALUE with a name of {}", Self::NAMES.join(", "));
        let (name, value) = text.split_once('=').ok_or_else(expected)?;
        let number: f64 = value.trim().parse().map_err(|_| format!("`{value}` is not a number"))?;
        match name.trim() {
            "delay" => self.delay = number,
            "friction" => self.friction = number,
            "mass" => self.mass = number,
            "noise" => self.noise = number,
            "missed_cycles" => {
                self.missed_cycles = value.trim().parse().map_err(|_| format!("`{value}` is not a whole number"))?;
            }
            other => return Err(format!("`{other}` is no fault; {}", expected())),
        }
        match self.wrong() {
            Some((name, _, expected)) => Err(format!("{name} must be {expected}")),
            None => Ok(()),
        }
    }

    /// The first value out of its range, with what it should be.
    pub(super) fn wrong(&self) -> Option<(&'static str, f64, &'static str)> {
        let ranges = [
            ("delay", self.delay, 0.0, 2.0, "from 0 to 2 s"),
            ("friction", self.friction, 0.01, 2.0, "from 0.01 to 2"),
            ("mass", self.mass, 0.1, 10.0, "from 0.1 to 10"),
            ("noise", self.noise, 0.0, 10.0, "from 0 to 10 m"),
            ("missed_cycles", f64::from(self.missed_cycles), 0.0, 10_000.0, "from 0 to 10000"),
        ];
        let wrong = ranges.into_iter().find(|(_, value, least, most, _)| !(*least..=*most).contains(value));
        wrong.map(|(name, value, .., expected)| (name, value, expected))
    }

    /// The vehicle that is really there.
    pub(super) fn real(&self, vehicle: &Vehicle) -> Vehicle {
        let (mass, yaw_inertia) = (self.mass * vehicle.mass, self.mass * vehicle.yaw_inertia);
        Vehicle { mass, yaw_inertia, ..vehicle.clone() }
    }

    /// What is wrong in the rig, for the vehicle that is believed to be there.
    pub(super) fn disturbances(&self, vehicle: &Vehicle) -> Disturbances {
        let noise = LocalisationNoise {
            position: self.noise,
            yaw: YAW_PER_METRE * self.noise,
            correlation_time: CORRELATION_TIME,
            seed: self.seed,
        };
        Disturbances {
            dead_time: self.delay,
            believed: (self.mass != 1.0).then(|| vehicle.clone()),
            localisation: (self.noise > 0.0).then_some(noise),
        }
    }

    /// Whether a cycle, counted from 0, is one that the planner misses. The first never is: without it there is no plan.
    pub(super) fn misses(&self, cycle: usize) -> bool {
        !cycle.is_multiple_of(self.missed_cycles as usize + 1)
    }
}

/// The record of a cycle that the planner missed: the last plan goes on.
pub(super) fn missed(last: &Cycle, time: f64) -> Cycle {
    let decision = if last.decision == Decision::Unproven { Decision::Unproven } else { Decision::KeepPrevious };
    Cycle {
        time,
        decision,
        candidates: Vec::new(),
        blocked: Vec::new(),
        chosen: None,
        edges: crate::lattice::EdgeCounts::default(),
        expansions: 0,
        stage_seconds: crate::planner::StageSeconds::default(),
        ..last.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_injected_by_name_and_what_is_none_is_named() {
        let mut faults = Faults::default();
        assert!(!faults.is_any());
        for text in ["delay=0.2", "friction=0.6", "mass = 1.2", "noise=0.1", "missed_cycles=3"] {
            faults.inject(text).unwrap();
        }
        assert_eq!(faults, Faults { delay: 0.2, friction: 0.6, mass: 1.2, noise: 0.1, missed_cycles: 3, seed: 0 });
        assert!(faults.is_any() && !Faults { seed: 9, ..Faults::default() }.is_any());
        for (text, part) in [
            ("delay", "NAME=VALUE"),
            ("lag=0.1", "`lag` is no fault"),
            ("delay=fast", "`fast` is not a number"),
            ("delay=-0.1", "from 0 to 2 s"),
            ("delay=nan", "from 0 to 2 s"),
            ("friction=0", "from 0.01 to 2"),
            ("mass=inf", "from 0.1 to 10"),
            ("noise=11", "from 0 to 10 m"),
            ("missed_cycles=1.5", "not a whole number"),
            ("missed_cycles=-1", "not a whole number"),
        ] {
            let message = Faults::default().inject(text).expect_err(text);
            assert!(message.contains(part), "{text}: {message}");
        }
    }

    #[test]
    fn every_name_is_a_fault() {
        for name in Faults::NAMES {
            Faults::default().inject(&format!("{name}=1")).unwrap();
        }
    }

    #[test]
    fn of_four_cycles_three_are_missed_and_never_the_first() {
        let misses = |missed_cycles, n| {
            (0..n).map(|i| Faults { missed_cycles, ..Faults::default() }.misses(i)).collect::<Vec<_>>()
        };
        assert_eq!(misses(0, 3), [false; 3]);
        assert_eq!(misses(3, 6), [false, true, true, true, false, true]);
    }

    #[test]
    fn without_faults_the_rig_is_told_nothing() {
        let vehicle = crate::fixtures::vehicle_with(crate::vehicle::Footprint::rectangle(4.5, 1.8, 1.4));
        let faults = Faults::default();
        assert_eq!(faults.disturbances(&vehicle), Disturbances::default());
        assert_eq!(faults.real(&vehicle), vehicle);
    }
}
