//! Step steer, ramp steer, slalom and brake-in-turn, driven by the physics rig without planner and controller: one CSV
//! file each, with the inputs, for comparison with other vehicle models (`benches/vehicle_models/compare.py`).
//!
//! `cargo run --release --example manoeuvres -- DIR`

mod rig;

use std::error::Error;
use std::path::PathBuf;

use rig::{Input, MANOEUVRES};
use stopline::geometry::Pose;
use stopline::simulation::Settings;
use stopline::vehicle::load;

fn main() -> Result<(), Box<dyn Error>> {
    let directory = PathBuf::from(std::env::args().nth(1).ok_or("usage: manoeuvres DIR")?);
    std::fs::create_dir_all(&directory)?;
    let vehicle = load("bmw_320i")?;
    // the centre of mass begins at the origin
    let from = Pose::new(-vehicle.rear_axle_to_mass, 0.0, 0.0);
    for manoeuvre in &MANOEUVRES {
        let instants = manoeuvre.drive(&vehicle, from, &Settings::default())?;
        let path = directory.join(format!("{}.rig.csv", manoeuvre.name));
        let mut file = csv::Writer::from_path(&path)?;
        file.write_record([
            "time",
            "steering_rate",
            "acceleration",
            "x",
            "y",
            "yaw",
            "steering",
            "speed",
            "yaw_rate",
            "lateral_acceleration",
        ])?;
        // nothing drives beyond the last instant
        let rest = std::iter::once(Input { steering_rate: 0.0, acceleration: 0.0 });
        for (at, input) in instants.iter().zip(manoeuvre.inputs().into_iter().chain(rest)) {
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
            file.write_record(row.map(|value| format!("{value:.9}")))?;
        }
        file.flush()?;
        println!("{}", path.display());
    }
    Ok(())
}
