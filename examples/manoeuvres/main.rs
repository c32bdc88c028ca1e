//! Step steer, ramp steer, slalom and brake-in-turn, driven by the physics rig without planner and controller: one CSV
//! file for each vehicle and manoeuvre, with the inputs, for comparison with other vehicle models
//! (`benches/vehicle_models/compare.py`).
//!
//! `cargo run --release --example manoeuvres -- DIR`

#[allow(dead_code)] // the tests use the rest
mod rig;

use std::error::Error;
use std::path::{Path, PathBuf};

use rig::{Input, MANOEUVRES, Manoeuvre};
use stopline::geometry::Pose;
use stopline::simulation::Settings;
use stopline::vehicle::{Vehicle, load};

/// Vehicles with published parameters, by the type that CommonRoad gives them.
const VEHICLES: [(&str, u8); 2] = [("ford_escort", 1), ("bmw_320i", 2)];

fn main() -> Result<(), Box<dyn Error>> {
    let directory = PathBuf::from(std::env::args().nth(1).ok_or("usage: manoeuvres DIR")?);
    std::fs::create_dir_all(&directory)?;
    for (name, number) in VEHICLES {
        let vehicle = load(name)?;
        assert_eq!(vehicle.commonroad_type, Some(number), "{name}");
        for manoeuvre in &MANOEUVRES {
            let file = directory.join(format!("{number}.{}.csv", manoeuvre.name));
            write(&file, &vehicle, manoeuvre)?;
            println!("{}", file.display());
        }
    }
    Ok(())
}

/// Drives a manoeuvre and writes one row for each tick.
fn write(file: &Path, vehicle: &Vehicle, manoeuvre: &Manoeuvre) -> Result<(), Box<dyn Error>> {
    // the centre of mass begins at the origin
    let from = Pose::new(-vehicle.rear_axle_to_mass, 0.0, 0.0);
    let instants = manoeuvre.drive(vehicle, from, &Settings::default())?;
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
    // nothing drives beyond the last instant
    let rest = std::iter::once(Input { steering_rate: 0.0, acceleration: 0.0 });
    for (at, input) in instants.iter().zip(manoeuvre.inputs(vehicle).into_iter().chain(rest)) {
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
