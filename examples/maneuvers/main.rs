//! Step steer, ramp steer, slalom and brake-in-turn, driven by the vehicle simulation in open loop, without planner and
//! controller. Writes one CSV file per vehicle and maneuver, with the inputs, for the comparison with other vehicle
//! models (`benches/vehicle_models/compare.py`).
//!
//! `cargo run --release --example maneuvers -- DIR`

#[allow(dead_code)] // the tests use the other items
mod open_loop;

use std::error::Error;
use std::path::{Path, PathBuf};

use open_loop::{Input, MANEUVERS, Maneuver};
use stopline::geometry::Pose;
use stopline::simulation::Settings;
use stopline::vehicle::{Vehicle, load};

/// Vehicles with published parameters, and their CommonRoad vehicle types.
const VEHICLES: [(&str, u8); 2] = [("ford_escort", 1), ("bmw_320i", 2)];

fn main() -> Result<(), Box<dyn Error>> {
    let directory = PathBuf::from(std::env::args().nth(1).ok_or("usage: maneuvers DIR")?);
    std::fs::create_dir_all(&directory)?;
    for (name, number) in VEHICLES {
        let vehicle = load(name)?;
        assert_eq!(vehicle.commonroad_type, Some(number), "{name}");
        for maneuver in &MANEUVERS {
            let file = directory.join(format!("{number}.{}.csv", maneuver.name));
            write(&file, &vehicle, maneuver)?;
            println!("{}", file.display());
        }
    }
    Ok(())
}

/// Drives a maneuver and writes one row per tick.
fn write(file: &Path, vehicle: &Vehicle, maneuver: &Maneuver) -> Result<(), Box<dyn Error>> {
    // the centre of mass starts at the origin
    let from = Pose::new(-vehicle.rear_axle_to_mass, 0.0, 0.0);
    let instants = maneuver.drive(vehicle, from, &Settings::default())?;
    let mut table = csv::Writer::from_path(file)?;
    table.write_record([
        "time_s",
        "steering_rate_radps",
        "acceleration_mps2",
        "x_m",
        "y_m",
        "yaw_rad",
        "steering_rad",
        "speed_mps",
        "yaw_rate_radps",
        "lateral_acceleration_mps2",
    ])?;
    // no input acts after the last instant
    let padding = std::iter::once(Input { steering_rate: 0.0, acceleration: 0.0 });
    for (at, input) in instants.iter().zip(maneuver.inputs(vehicle).into_iter().chain(padding)) {
        let row = [
            at.time,
            input.steering_rate,
            input.acceleration,
            at.position.x,
            at.position.y,
            at.yaw,
            at.steering,
            at.speed,
            at.yaw_rate,
            at.lateral_acceleration,
        ];
        table.write_record(row.map(|value| format!("{value:.9}")))?;
    }
    table.flush()?;
    Ok(())
}
