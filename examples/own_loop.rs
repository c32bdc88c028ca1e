//! stopline in a loop of your own: observations in, plans out.
//!
//! A pedestrian that nobody predicted steps onto the road half-way. The vehicle here follows its plans exactly; yours won't, and
//! the planner takes its estimated state.
//!
//! `cargo run --release --example own_loop`

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use stopline::geometry::Pose;
use stopline::io::commonroad::read_file;
use stopline::map::{Motion, Obstacle, ObstacleKind, Shape, TimedPose};
use stopline::planner::{Observation, Planner, Settings};
use stopline::vehicle::{State, load};

/// Time between two cycles, s.
const INTERVAL: f64 = 0.1;

/// The pedestrian as a sensor sees it at a time (s): where it is and how fast, without a prediction.
fn pedestrian(time: f64) -> Option<Obstacle> {
    const STEPS_OUT: f64 = 3.0; // s
    const SPEED: f64 = 1.5; // m/s
    let walked = SPEED * (time - STEPS_OUT);
    (walked >= 0.0).then(|| Obstacle {
        id: 1,
        kind: ObstacleKind::Pedestrian,
        shape: Shape::rectangle(0.5, 0.5),
        motion: Motion::Trajectory(vec![TimedPose {
            time,
            pose: Pose::new(48.0, -3.0 + walked, std::f64::consts::FRAC_PI_2),
            speed: SPEED,
        }]),
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let scenario = read_file(Path::new("maps/straight_100m.xml"))?;
    let problem = &scenario.problems[0];
    let vehicle = load("bmw_320i")?;
    let settings = Settings { cruise_speed: 8.0, ..Settings::default() };
    let mut planner = Planner::new(scenario.map(), &vehicle, &settings)?;

    let mut state = State {
        time: 0.0,
        pose: vehicle.rear_axle_of_centre(&problem.initial.centre),
        speed: problem.initial.speed,
        lateral_speed: 0.0,
        acceleration: 0.0,
        yaw_rate: 0.0,
        steering: 0.0,
    };
    for cycle in 0..150 {
        let plan = planner.cycle(&Observation {
            state,
            obstacles: pedestrian(state.time).into_iter().collect(),
            goals: Arc::from(problem.goals.as_slice()),
            friction: 1.0, // dry asphalt
        })?;
        if cycle % 10 == 0 {
            let stop = plan.trajectory.profile.last().station - plan.trajectory.at(state.time).station;
            println!(
                "{:4.1} s, {:4.1} m/s: {}, level {}, stop in {stop:.1} m{}",
                state.time,
                state.speed,
                plan.decision,
                plan.level,
                plan.stops_for.map_or_else(String::new, |why| format!(" for {why}")),
            );
        }
        // your vehicle: measure its state after the interval
        let point = plan.trajectory.at(state.time + INTERVAL);
        state = State {
            time: state.time + INTERVAL,
            pose: point.pose,
            speed: point.speed,
            lateral_speed: 0.0,
            acceleration: point.acceleration,
            yaw_rate: point.speed * point.curvature,
            steering: vehicle.steering_for_curvature(point.curvature),
        };
    }
    Ok(())
}
