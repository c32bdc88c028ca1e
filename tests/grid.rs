//! Runs with an occupancy grid: the vehicle stops before walls, passes through gaps, and contacts are detected.

mod common;

use common::{VEHICLE, bundled, driven, failures};
use stopline::drive::{Outcome, Settings};
use stopline::geometry::{Point, Pose};
use stopline::map::{Cell, OccupancyGrid, Scenario};
use stopline::simulation::Touched;
use stopline::verdict;

/// Side of a cell, m.
const SIDE: f64 = 0.5;
/// Rows of a wall: 20 m to each side of the lane's centre line.
const ROWS: usize = 80;
/// Distance from the start to the wall, m.
const AHEAD: f64 = 45.0;

/// The straight road with a wall of cells across it, with a gap of `gap` metres to each side of the lane's centre line.
fn walled(gap: f64) -> (Scenario, Pose) {
    let mut scenario = bundled("straight_100m");
    let foot = scenario.problems[0].initial.centre.advanced(AHEAD);
    let length = ROWS as f64 * SIDE;
    let origin = Pose { position: foot.position - foot.left() * (0.5 * length), yaw: foot.yaw };
    let middle = |row: usize| (row as f64 + 0.5) * SIDE - 0.5 * length;
    let cell = |row: usize| if middle(row).abs() < gap { Cell::Free } else { Cell::Occupied };
    let cells = (0..ROWS).map(cell).collect();
    scenario.occupancy = Some(OccupancyGrid::new(origin, SIDE, 1, ROWS, cells).unwrap());
    (scenario, foot)
}

/// Smallest distance of the front from the wall, m.
fn distance_to_wall(run: &stopline::drive::Run, foot: &Pose) -> f64 {
    let front = Point::new(VEHICLE.front_overhang_from_rear_axle(), 0.0);
    let ahead = |pose: &Pose| -foot.to_local(pose.to_world(front)).x;
    run.log.samples.iter().map(|s| ahead(&s.pose)).fold(f64::INFINITY, f64::min)
}

#[test]
fn stops_before_a_wall_of_cells() {
    let (scenario, foot) = walled(0.0);
    let run = driven(&scenario);
    assert_eq!(run.outcome, Outcome::StoppedSafely, "{:?}", failures(&run));
    let distance = distance_to_wall(&run, &foot);
    assert!((0.2..8.0).contains(&distance), "stops {distance} m before it");
    let last = run.log.samples.last().unwrap();
    assert!(last.speed.abs() < 0.01);
    assert!(run.verdict.checks.iter().any(|c| c.name == "no_contact" && c.passed()));
}

#[test]
fn drives_through_a_gap_in_the_wall() {
    let (scenario, foot) = walled(1.5);
    let run = driven(&scenario);
    assert_eq!(run.outcome, Outcome::GoalReached, "{:?}", failures(&run));
    assert!(run.verdict.pass(), "{:?}", failures(&run));
    assert!(distance_to_wall(&run, &foot) < 0.0, "it has passed the wall");
}

/// A contact with a wall that is too near to stop ends the run, like a contact with any obstacle.
#[test]
fn touching_occupied_cells_is_a_collision() {
    let mut scenario = bundled("straight_100m");
    let centre = scenario.problems[0].initial.centre;
    let speed = scenario.problems[0].initial.speed;
    let foot = centre.advanced(0.5 * VEHICLE.length + 0.5);
    let corner = Pose { position: foot.position - foot.left() * 10.0, yaw: foot.yaw };
    scenario.occupancy = Some(OccupancyGrid::new(corner, SIDE, 1, 40, vec![Cell::Occupied; 40]).unwrap());
    let run = driven(&scenario);
    assert_eq!(run.outcome, Outcome::Collision);
    let contact = run.log.contact.unwrap();
    assert_eq!(contact.with, Touched::OccupiedCell);
    assert!(contact.time < 1.1 * 0.5 / speed + 0.1 && contact.time > 0.4 / speed, "{contact:?}");
    assert!(distance_to_wall(&run, &foot).abs() < 0.03, "{} m", distance_to_wall(&run, &foot));
    let no_contact = run.verdict.failures().find(|c| c.name == "no_contact").expect("the verdict has no contact");
    assert!(no_contact.note.contains("ran into occupied cells"), "{}", no_contact.note);
    let metrics = verdict::metrics(&scenario, &VEHICLE, &run.cycles, &run.log, &verdict::Settings::default());
    assert!(metrics.min_clearance_m.unwrap() < 0.01, "{metrics:?}");
}

/// A start on occupied cells is a collision; one beside them is not.
#[test]
fn a_start_on_occupied_cells_is_a_collision() {
    let mut scenario = bundled("straight_100m");
    let centre = scenario.problems[0].initial.centre;
    let beside = |offset: f64| {
        let corner = Pose { position: centre.position + centre.left() * offset, yaw: centre.yaw };
        Some(OccupancyGrid::new(corner, SIDE, 1, 1, vec![Cell::Occupied]).unwrap())
    };
    scenario.occupancy = beside(0.5 * VEHICLE.width - 0.1);
    let run = driven(&scenario);
    assert_eq!((run.outcome, run.reason), (Outcome::Collision, Some("start_in_collision")));
    scenario.occupancy = beside(0.5 * VEHICLE.width + 0.3);
    let run = driven(&scenario);
    assert_eq!(run.outcome, Outcome::GoalReached, "{:?}", failures(&run));
    let metrics = verdict::metrics(&scenario, &VEHICLE, &run.cycles, &run.log, &verdict::Settings::default());
    assert!(metrics.min_clearance_m.is_some_and(|c| c > 0.1 && c < 0.31), "{metrics:?}");
}

/// The verdict about a run on the empty road fails if the scenario has a wall that the simulation did not have.
#[test]
fn driving_through_occupied_cells_fails_the_verdict() {
    let empty = bundled("straight_100m");
    let run = driven(&empty);
    let (scenario, _) = walled(0.0);
    let verdict = |scenario: &Scenario| {
        let (settings, defaults) = (verdict::Settings::default(), Settings::default());
        let plans = (&run.cycles[..], defaults.planned_for());
        let checks = verdict::judge(scenario, &scenario.problems[0], &VEHICLE, plans, &run.log, &settings).checks;
        checks.into_iter().find(|c| c.name == "no_contact").unwrap()
    };
    assert!(verdict(&empty).passed());
    let check = verdict(&scenario);
    assert!(check.failed() && check.note.contains("occupied cells"), "{check:?}");
    // the car is across the wall, so the penetration depth is in its longitudinal direction
    assert!(check.value > 0.5, "{check:?}");
    assert!(verdict(&walled(1.5).0).passed(), "the gap is wide enough");
}

/// The command line reads a ROS grid in addition to the scenario.
#[cfg(feature = "cli")]
#[test]
fn the_command_line_reads_a_grid() {
    let folder = tempfile::tempdir().unwrap();
    let (_, foot) = walled(0.0);
    let length = ROWS as f64 * SIDE;
    let origin = foot.position - foot.left() * (0.5 * length);
    let yaml = format!(
        "image: wall.pgm\nresolution: {SIDE}\norigin: [{}, {}, {}]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
        origin.x, origin.y, foot.yaw
    );
    std::fs::write(folder.path().join("wall.yaml"), yaml).unwrap();
    let run = || {
        let mut command = assert_cmd::Command::cargo_bin("stopline").unwrap();
        command.current_dir(folder.path()).args([
            "drive",
            "--quiet",
            "--grid",
            "wall.yaml",
            "--json",
            "-",
            "--svg",
            "out.svg",
        ]);
        command.arg(common::maps().join("straight_100m.xml")).output().unwrap()
    };
    let missing = run();
    assert_eq!(missing.status.code(), Some(3));
    let stderr = String::from_utf8_lossy(&missing.stderr).into_owned();
    assert!(stderr.contains("wall.yaml:1: image \"wall.pgm\""), "{stderr}");
    std::fs::write(folder.path().join("wall.pgm"), format!("P2 1 {ROWS} 255\n{}", "0 ".repeat(ROWS))).unwrap();
    let drive = run();
    let json: serde_json::Value = serde_json::from_slice(&drive.stdout).unwrap();
    assert_eq!(json["outcome"], "stopped_safely");
    assert!(std::fs::read_to_string(folder.path().join("out.svg")).unwrap().contains("id=\"occupancy\""));
}
