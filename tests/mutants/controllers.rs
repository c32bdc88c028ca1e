//! Controllers with one thing wrong, made of the real one.

use stopline::simulation::{Command, Controller, TrackingController};
use stopline::trajectory::Trajectory;
use stopline::vehicle::{State, Vehicle};

/// What is wrong.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Flaw {
    /// Steering feedback pushes away from the path.
    WrongSign,
    /// Neither curvature nor acceleration are read from the plan.
    NoFeedForward,
    /// Whatever would brake does not.
    NoBrakes,
    /// Pedals are pressed all the way or not at all.
    AllOrNothing,
    /// The vehicle is thought to be half a metre behind where it is.
    HalfAMetreBehind,
}

impl Controller for Flaw {
    fn command(&self, vehicle: &Vehicle, trajectory: &Trajectory, state: &State, period: f64) -> Command {
        let real = |state: &State| TrackingController.command(vehicle, trajectory, state, period);
        let right = real(state);
        // on the plan there is nothing to correct: what is left is the feed-forward
        let wanted = trajectory.at(state.time);
        let planned = || real(&State { pose: wanted.pose, speed: wanted.speed, ..*state });
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
