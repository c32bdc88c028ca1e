//! stopline as a library: read a scenario, drive it, print the verdict.
//!
//! `cargo run --release --example drive -- maps/parked_car.xml`

use std::error::Error;
use std::path::Path;

use stopline::drive::{Settings, drive};
use stopline::io::commonroad::read_file;
use stopline::vehicle::load;

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args().nth(1).unwrap_or_else(|| "maps/parked_car.xml".into());
    let scenario = read_file(Path::new(&file))?;
    let vehicle = load("bmw_320i")?;
    let mut settings = Settings::default();
    settings.planner.cruise_speed = 10.0;

    let problem = &scenario.problems[0]; // the reader guarantees one problem
    let run = drive(&scenario, problem, &vehicle, &settings, &mut |_time, _latest_end| {})?;

    println!("{}: {}", scenario.id, run.outcome.name());
    for check in &run.verdict.checks {
        println!("  {:<4} {:<20} {}", check.status, check.name, check.note);
    }
    let stop = run.cycles.iter().map(|c| c.plan.trajectory.end_time()).next_back().unwrap_or_default();
    println!("  the last committed trajectory stops at {stop:.1} s");
    Ok(())
}
