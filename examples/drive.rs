//! stopline as a library: reads a scenario, drives it, prints the verdict.
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

    let problem = &scenario.problems[0]; // the reader makes sure that there is one
    let run = drive(&scenario, problem, &vehicle, &settings, &mut |_time, _latest_end| {})?;

    println!("{}: {}", scenario.id, run.outcome.name());
    for check in &run.verdict.checks {
        let held = check.status;
        println!("  {held} {:<20} {:.3} of {:.3} {}", check.name, check.value, check.limit, check.unit);
    }
    let stop = run.cycles.iter().map(|c| c.committed.end_time()).next_back().unwrap_or_default();
    println!("  the last committed trajectory is at rest at {stop:.1} s");
    Ok(())
}
