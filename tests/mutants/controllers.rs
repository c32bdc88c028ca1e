//! The tracking controller with one fault each.

use stopline::simulation::{Command, Controller, TrackingController};
use stopline::trajectory::Trajectory;
use stopline::vehicle::{State, Vehicle};

/// The fault.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Flaw {
    /// Steering feedback pushes away from the path.
    WrongSign,
    /// No feed-forward of curvature and acceleration.
    NoFeedForward,
    /// The brakes do not work.
    NoBrakes,
    /// The acceleration command is the largest or the smallest value.
    AllOrNothing,
    /// The estimated position is half a metre behind the true one.
    HalfAMetreBehind,
}

impl Controller for Flaw {
    fn command(&self, vehicle: &Vehicle, trajectory: &Trajectory, state: &State, period: f64) -> Command {
        let real = |state: &State| TrackingController::default().command(vehicle, trajectory, state, period);
        let right = real(state);
        // on the plan there is no error to correct, so the command is the feed-forward
        let reference = trajectory.at(state.time);
        let planned = || real(&State { pose: reference.pose, speed: reference.speed, ..*state });
        match self {
            Self::WrongSign => Command { steering: 2.0 * planned().steering - right.steering, ..right },
            Self::NoFeedForward => {
                let planned = planned();
                Command {
                    steering: right.steering - planned.steering,
                    acceleration: right.acceleration - planned.acceleration,
                }
            }
            Self::NoBrakes => Command { acceleration: right.acceleration.max(0.0), ..right },
            Self::AllOrNothing => {
                const ALL: f64 = 1.6;
                Command { acceleration: if right.acceleration > 0.0 { ALL } else { -ALL }, ..right }
            }
            Self::HalfAMetreBehind => real(&State { pose: state.pose.advanced(-0.5), ..*state }),
        }
    }
}
