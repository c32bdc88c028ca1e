//! Tests of the reader on published scenarios. The files are not part of the project: without them, the tests are skipped
//! with a message.

use std::path::PathBuf;

use stopline::io::commonroad::read_file;
use stopline::map::{Motion, Scenario};

/// The folder of published scenarios, if it exists.
fn scenarios() -> Option<PathBuf> {
    let root = std::env::var_os("STOPLINE_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    let folder = root.join("commonroad");
    if !folder.join("INDEX.csv").is_file() {
        eprintln!("skipped: no real scenarios (set STOPLINE_DATA to their folder)");
        return None;
    }
    Some(folder)
}

/// A row of the index: values of the file counted by another program.
#[derive(Debug)]
struct Row {
    file: String,
    id: String,
    version: String,
    dt: f64,
    lanelets: usize,
    fixed: usize,
    moving: usize,
    goal_has: [bool; 4],
    initial_speed: f64,
    horizon: f64,
}

fn rows(folder: &std::path::Path) -> Vec<Row> {
    let mut reader = csv::Reader::from_path(folder.join("INDEX.csv")).unwrap();
    let headers = reader.headers().unwrap().clone();
    let column = |name: &str| headers.iter().position(|h| h == name).unwrap();
    reader
        .records()
        .map(|record| {
            let record = record.unwrap();
            let text = |name: &str| record[column(name)].to_owned();
            let number = |name: &str| record[column(name)].parse::<f64>().unwrap();
            let count = |name: &str| record[column(name)].parse::<usize>().unwrap();
            Row {
                file: text("file"),
                id: text("benchmark_id"),
                version: text("version"),
                dt: number("dt"),
                lanelets: count("lanelets"),
                fixed: count("static_obstacles"),
                moving: count("dynamic_obstacles"),
                goal_has: ["goal_position", "goal_time", "goal_velocity", "goal_orientation"].map(|n| count(n) > 0),
                initial_speed: number("initial_speed"),
                horizon: number("horizon_s"),
            }
        })
        .collect()
}

fn compare(row: &Row, s: &Scenario) {
    let file = &row.file;
    assert_eq!((&s.id, &s.version, s.time_step), (&row.id, &row.version, row.dt), "{file}");
    assert_eq!(s.network.lanelets.len(), row.lanelets, "{file}");
    let fixed = s.obstacles.iter().filter(|o| o.is_static()).count();
    assert_eq!((fixed, s.obstacles.len() - fixed), (row.fixed, row.moving), "{file}");
    let goals = &s.problems[0].goals;
    let has = [
        goals.iter().any(|g| g.position.is_some()),
        !goals.is_empty(),
        goals.iter().any(|g| g.speed.is_some()),
        goals.iter().any(|g| g.yaw.is_some()),
    ];
    assert_eq!(has, row.goal_has, "{file}");
    assert!((s.problems[0].initial.speed - row.initial_speed).abs() < 1e-3, "{file}");
    let horizon = goals.iter().map(|g| g.time.max).fold(0.0, f64::max);
    assert!((horizon - row.horizon).abs() < 1e-6, "{file}: goal until {horizon}, index {}", row.horizon);
}

#[test]
fn reads_every_published_scenario_as_its_index_says() {
    let Some(folder) = scenarios() else { return };
    let rows = rows(&folder);
    assert!(rows.len() >= 70);
    for row in &rows {
        let scenario = read_file(&folder.join(&row.file)).unwrap_or_else(|e| panic!("{e}"));
        compare(row, &scenario);
        for issue in &scenario.issues {
            println!("{}: {issue}", row.file);
        }
    }
}

#[test]
fn centre_lines_are_between_bounds_and_obstacles_do_not_jump() {
    let Some(folder) = scenarios() else { return };
    let (mut lanelets, mut between, mut steps, mut jumps) = (0, 0, 0, 0);
    for row in rows(&folder) {
        let s = read_file(&folder.join(&row.file)).unwrap();
        for lanelet in s.network.lanelets.values() {
            let middle = lanelet.centre.at(0.5 * lanelet.centre.length());
            between +=
                usize::from(lanelet.left.project(middle).offset < 0.0 && lanelet.right.project(middle).offset > 0.0);
            lanelets += 1;
        }
        for o in &s.obstacles {
            let Motion::Trajectory(states) = &o.motion else { continue };
            for w in states.windows(2) {
                let moved = (w[1].pose.position - w[0].pose.position).norm();
                let fastest = w[0].speed.abs().max(w[1].speed.abs()) + 3.0;
                steps += 1;
                jumps += usize::from(moved > fastest * (w[1].time - w[0].time) + 0.5);
            }
        }
    }
    // The others have bounds that fold back, or a bound of a few centimetres.
    println!("{between} of {lanelets} middles are between their bounds");
    println!("{jumps} of {steps} steps are faster than the speeds around them");
    assert!(200 * jumps < steps);
    assert!(between as f64 > 0.995 * lanelets as f64);
}
