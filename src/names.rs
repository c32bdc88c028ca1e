//! `Display` of the enumerations that are shown to people, in one place: the name that reports use, or plain words.
//!
//! Alignment of the format string applies.

use std::fmt;

/// Displays each type by the method that returns its name.
macro_rules! display_by_name {
    ($($type:ty => $name:ident),* $(,)?) => {$(
        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.$name())
            }
        }
    )*};
}

display_by_name! {
    crate::bench::fallbacks::Kind => name,
    crate::bench::safetlp::Method => label,
    crate::bench::spirals::Method => label,
    crate::drive::Outcome => name,
    crate::drive::PredictionMode => name,
    crate::planner::Decision => name,
    crate::planner::Level => name,
    crate::planner::NoLane => code,
    crate::planner::Smoothing => code,
    crate::speed::ProofViolation => code,
    crate::speed::SpeedOutcome => code,
    crate::speed::Strategy => name,
    crate::speed::smoothing::Failure => code,
    crate::verdict::Cause => name,
    crate::verdict::ComfortPreset => name,
    crate::verdict::Side => name,
}

#[cfg(feature = "regression")]
display_by_name! {
    crate::regression::ErrorKind => name,
    crate::regression::FailureKind => name,
}

/// Displays each value by a text.
macro_rules! display_by_text {
    ($($type:ty { $($variant:ident => $text:literal),* $(,)? })*) => {$(
        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(match self { $(Self::$variant => $text,)* })
            }
        }
    )*};
}

display_by_text! {
    crate::geometry::boundary::Infeasibility {
        Invalid => "an input is invalid",
        Coincident => "start and target coincide",
        Behind => "the target lies behind the start",
        Overdetermined => "more conditions are fixed than the spiral has unknowns",
        EndBeyondBound => "a fixed curvature or rate exceeds its bound",
        Certified => "proven infeasible",
        NotFound => "no solution found",
    }
    crate::map::Cell { Free => "free", Occupied => "occupied", Unknown => "unknown" }
    crate::map::ObstacleKind {
        Vehicle => "vehicle",
        Bicycle => "bicycle",
        Pedestrian => "pedestrian",
        ParkedVehicle => "parked vehicle",
        Structure => "structure",
        Unknown => "unknown obstacle",
    }
    crate::planner::RearTraffic { Binding => "binding", Yielding => "yielding" }
    crate::planner::UncertaintyMode { Off => "off", Preferred => "preferred", Required => "required" }
    crate::result::Kind { Plan => "plan", Drive => "drive" }
    crate::route::Side { Current => "current lane", Left => "left lane", Right => "right lane" }
    crate::speed::Budget { Expansions => "expansions", Memory => "memory" }
}

impl fmt::Display for crate::collision::Blocker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Obstacle(id) => f.pad(&format!("obstacle {id}")),
            Self::OccupiedCell => f.pad("an occupied cell"),
            Self::RoadBoundary => f.pad("the road boundary"),
        }
    }
}

impl fmt::Display for crate::speed::NoPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CannotStop { needed } => {
                write!(
                    f,
                    "the stopping distance of {:.1} m exceeds the length of the road",
                    crate::number::Short(*needed)
                )
            }
            Self::NoSafeState => f.pad("no safe state can be reached"),
            Self::BudgetExhausted(budget) => write!(f, "the search exhausted its budget of {budget}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::collision::Blocker;
    use crate::drive::Outcome;
    use crate::speed::{Budget, NoPlan};

    #[test]
    fn enumerations_display_the_names_of_the_reports() {
        assert_eq!(Outcome::GoalReached.to_string(), Outcome::GoalReached.name());
        assert_eq!(format!("{:>14}|{:<6}|", Outcome::Planned, crate::result::Kind::Plan), "       planned|plan  |");
        assert_eq!(format!("{:<12}|", Blocker::Obstacle(7)), "obstacle 7  |");
        let stop = NoPlan::CannotStop { needed: 61.52 };
        assert_eq!(stop.to_string(), "the stopping distance of 61.5 m exceeds the length of the road");
        let budget = NoPlan::BudgetExhausted(Budget::Memory);
        assert_eq!(budget.to_string(), "the search exhausted its budget of memory");
    }

    /// The words of settings are those of their files.
    #[test]
    fn settings_display_their_keys() {
        use crate::planner::{RearTraffic, UncertaintyMode};
        fn same(value: impl std::fmt::Display + serde::Serialize) {
            assert_eq!(serde_json::to_value(&value).unwrap(), value.to_string());
        }
        [UncertaintyMode::Off, UncertaintyMode::Preferred, UncertaintyMode::Required].into_iter().for_each(same);
        [RearTraffic::Binding, RearTraffic::Yielding].into_iter().for_each(same);
    }
}
