//! Fault injection: faults of the simulated vehicle that the planner does not know of.
//!
//! The planner, its proofs and the tracking controller use the vehicle as described. The simulation uses another vehicle, acts
//! late, or returns a wrong position. The verdict uses the true state. The checks name the claim that a fault broke.

use serde::{Deserialize, Serialize};

use crate::planner::{Cycle, Decision, Plan, Trace};
use crate::settings::{SettingsError, count, each_once, within};
use crate::simulation::{Disturbances, LocalisationNoise};
use crate::vehicle::Vehicle;

/// Injected faults of a run; none by default. In a settings file: the table `[faults]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Faults {
    /// Dead time between the commands of the controller and the actuators, s, in addition to the lags of the vehicle.
    pub delay: f64,
    /// Factor on the friction of the tyres.
    pub friction: f64,
    /// Factor on mass and yaw inertia of the vehicle. Drive and brakes give the forces for the described mass.
    pub mass: f64,
    /// Standard deviation of the localisation error, m, longitudinal and lateral each. The standard deviation of the heading
    /// is [`YAW_PER_METRE`] times as much.
    pub noise: f64,
    /// Planning cycles missed after each cycle that runs. The previous plan is kept meanwhile.
    pub missed_cycles: u32,
    /// Random seed of the localisation error.
    pub seed: u64,
}

/// Standard deviation of the heading for one metre of position, rad/m: 0.1 m goes with 0.01 rad (0.6°), as in an inertial
/// system aided by satellites.
pub const YAW_PER_METRE: f64 = 0.1;
/// Correlation time of the localisation error, s.
const CORRELATION_TIME: f64 = 1.0;

impl Default for Faults {
    fn default() -> Self {
        Self { delay: 0.0, friction: 1.0, mass: 1.0, noise: 0.0, missed_cycles: 0, seed: 0 }
    }
}

/// Most planning cycles missed in a row.
const MOST_MISSED: usize = 10_000;

impl Faults {
    /// The names of all faults.
    pub const NAMES: [&'static str; 5] = ["delay", "friction", "mass", "noise", "missed_cycles"];

    /// Whether any fault is injected.
    #[must_use]
    pub fn is_any(&self) -> bool {
        *self != Self { seed: self.seed, ..Self::default() }
    }

    /// Injects one fault, written `name=value`.
    ///
    /// # Errors
    /// An unknown name, or a value that is not a number or out of its range.
    pub fn inject(&mut self, text: &str) -> Result<(), String> {
        let expected = || format!("expected NAME=VALUE with a name of {}", Self::NAMES.join(", "));
        let (name, value) = text.split_once('=').ok_or_else(expected)?;
        let (name, value) = (name.trim(), value.trim());
        let number: f64 = value.parse().map_err(|_| format!("{name}: `{value}` is not a number"))?;
        match name {
            "delay" => self.delay = number,
            "friction" => self.friction = number,
            "mass" => self.mass = number,
            "noise" => self.noise = number,
            "missed_cycles" => {
                let wrong = |_| format!("{name}: `{value}` is not a whole number from 0 to {MOST_MISSED}");
                self.missed_cycles = value.parse().map_err(wrong)?;
            }
            other => return Err(format!("unknown fault `{other}`; {}", expected())),
        }
        self.validate().map_err(|e| format!("{} must be {}", e.field, e.expected))
    }

    /// Injects several faults, each written `name=value`.
    ///
    /// # Errors
    /// As [`Faults::inject`], or a name that is given twice.
    pub fn inject_all(&mut self, texts: &[String]) -> Result<(), String> {
        each_once(texts.iter().map(|text| text.split('=').next().unwrap_or_default().trim()))?;
        texts.iter().try_for_each(|text| self.inject(text))
    }

    /// Checks the range of every value.
    ///
    /// # Errors
    /// The first value out of its range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        within("delay", self.delay, 0.0..=2.0, "s")?;
        within("friction", self.friction, 0.01..=2.0, "")?;
        within("mass", self.mass, 0.1..=10.0, "")?;
        within("noise", self.noise, 0.0..=10.0, "m")?;
        count("missed_cycles", self.missed_cycles as usize, 0..=MOST_MISSED)
    }

    /// The simulated vehicle.
    pub(super) fn real(&self, vehicle: &Vehicle) -> Vehicle {
        let (mass, yaw_inertia) = (self.mass * vehicle.mass, self.mass * vehicle.yaw_inertia);
        Vehicle { mass, yaw_inertia, ..vehicle.clone() }
    }

    /// Disturbances of the simulation, for the vehicle as described.
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

    /// Whether the planner misses a cycle, counted from 0. It never misses the first: without it there is no plan.
    pub(super) fn misses(&self, cycle: usize) -> bool {
        !cycle.is_multiple_of(self.missed_cycles as usize + 1)
    }
}

/// The record of a cycle that the planner missed: it keeps the previous plan.
pub(super) fn missed(last: &Cycle, time: f64) -> Cycle {
    let decision = if last.plan.decision == Decision::Unproven { Decision::Unproven } else { Decision::KeepPrevious };
    let trace =
        Trace { reference: last.trace.reference.clone(), is_refined: last.trace.is_refined, ..Trace::default() };
    Cycle { plan: Plan { time, decision, ..last.plan.clone() }, trace }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn injects_faults_by_name_and_refuses_unknown_ones() {
        let mut faults = Faults::default();
        assert!(!faults.is_any());
        for text in ["delay=0.2", "friction=0.6", "mass = 1.2", "noise=0.1", "missed_cycles=3"] {
            faults.inject(text).unwrap();
        }
        assert_eq!(faults, Faults { delay: 0.2, friction: 0.6, mass: 1.2, noise: 0.1, missed_cycles: 3, seed: 0 });
        assert!(faults.is_any() && !Faults { seed: 9, ..Faults::default() }.is_any());
        for (text, part) in [
            ("delay", "NAME=VALUE"),
            ("lag=0.1", "unknown fault `lag`"),
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
    fn each_fault_is_injected_once() {
        let inject =
            |texts: &[&str]| Faults::default().inject_all(&texts.iter().map(|t| t.to_string()).collect::<Vec<_>>());
        assert_eq!(inject(&["mass=1.1", "delay=0.1"]), Ok(()));
        let message = inject(&["mass=1.1", "delay=0.1", "mass =1.2"]).unwrap_err();
        assert_eq!(message, "`mass` is given twice; expected each name once");
    }

    #[test]
    fn injects_a_fault_of_every_name() {
        for name in Faults::NAMES {
            Faults::default().inject(&format!("{name}=1")).unwrap();
        }
    }

    #[test]
    fn misses_three_of_four_cycles_and_never_the_first() {
        let misses = |missed_cycles, n| {
            (0..n).map(|i| Faults { missed_cycles, ..Faults::default() }.misses(i)).collect::<Vec<_>>()
        };
        assert_eq!(misses(0, 3), [false; 3]);
        assert_eq!(misses(3, 6), [false, true, true, true, false, true]);
    }

    #[test]
    fn without_faults_the_simulation_is_undisturbed() {
        let vehicle = crate::fixtures::vehicle_with(crate::vehicle::Footprint::rectangle(4.5, 1.8, 1.4));
        let faults = Faults::default();
        assert_eq!(faults.disturbances(&vehicle), Disturbances::default());
        assert_eq!(faults.real(&vehicle), vehicle);
    }
}
