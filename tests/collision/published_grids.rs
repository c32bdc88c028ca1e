//! Occupied cells of published grids, compared with dense sampling of points.

use std::path::PathBuf;

use stopline::geometry::{Point, Pose};
use stopline::io::ros_map;
use stopline::map::{Cell, OccupancyGrid};

use crate::helpers::{no_margins, plain, scenario, vehicle, world};
use crate::random::Random;

/// The published ROS maps, if they exist on this machine.
fn real_grids() -> Vec<(PathBuf, OccupancyGrid)> {
    let data = std::env::var_os("STOPLINE_DATA").map_or_else(
        || std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        std::path::PathBuf::from,
    );
    let folders = std::fs::read_dir(data.join("ros_map_server")).into_iter().flatten().filter_map(Result::ok);
    let files = folders.filter_map(|f| std::fs::read_dir(f.path()).ok()).flatten().filter_map(Result::ok);
    let mut files: Vec<PathBuf> =
        files.map(|f| f.path()).filter(|p| p.extension().is_some_and(|e| e == "yaml")).collect();
    files.sort();
    if files.is_empty() {
        println!("skipped: no real grids under {}", data.display());
    }
    files.into_iter().map(|path| (path.clone(), ros_map::read_file(&path).unwrap_or_else(|e| panic!("{e}")))).collect()
}

/// Whether a cell is occupied inside the footprint inflated by `by`, by points at most `every` apart.
fn touches(grid: &OccupancyGrid, pose: &Pose, by: f64, every: f64) -> bool {
    let [rear_right, _, front_left, _] = vehicle().footprint.bounding_rectangle();
    let along = |from: f64, to: f64| {
        let n = ((to - from) / every).ceil();
        (0..=n as u32).map(move |i| from + (to - from) * f64::from(i) / n)
    };
    along(rear_right.x - by, front_left.x + by).any(|x| {
        along(rear_right.y - by, front_left.y + by)
            .any(|y| grid.cell_at(pose.to_world(Point::new(x, y))) == Some(Cell::Occupied))
    })
}

/// No occupied point inside the footprint is missed, and every hit is within the excess.
#[test]
fn sweeps_over_published_grids_agree_with_sampled_points() {
    const SWEEPS: usize = 40;
    const EXCESS: f64 = 0.05;
    let mut random = Random::new(3);
    for (path, grid) in real_grids() {
        let (width, height) = (grid.width() as f64 * grid.resolution(), grid.height() as f64 * grid.resolution());
        let (mut hits, mut free, mut tries) = (0, 0, 0);
        let mut scenario = scenario(plain(), vec![]);
        scenario.occupancy = Some(grid.clone());
        let world = world(&scenario, &no_margins());
        while hits + free < SWEEPS && tries < 20 * SWEEPS {
            tries += 1;
            let at = Point::new(random.within(0.0, width), random.within(0.0, height));
            let start = Pose { position: grid.origin().to_world(at), yaw: random.within(-3.1, 3.1) };
            let spiral = random.spiral(0.2, (2.0, 15.0));
            let on_the_square = |p: &Point| p.x.abs() < 170.0 && p.y.abs() < 170.0;
            if !on_the_square(&start.position) || touches(&grid, &start, 0.0, 0.2) && random.next() < 0.9 {
                continue;
            }
            let n = (spiral.length / 0.05).ceil() as usize;
            let poses: Vec<(f64, Pose)> = spiral.samples(&start, n).map(|(s, p)| (s, p.pose)).collect();
            let truth = poses.iter().find(|(_, pose)| touches(&grid, pose, -1e-9, 0.4 * grid.resolution()));
            let hit = world.hit(&start, &spiral);
            match (truth, hit) {
                (Some((s, pose)), None) => panic!("{}: missed at {s} m, {pose:?}", path.display()),
                (Some((s, _)), Some(hit)) => assert!(hit.station <= *s, "{hit:?}, expected {s}"),
                _ => {}
            }
            if let Some(hit) = hit {
                let in_cell = poses.iter().filter(|(s, _)| (hit.station - 0.05..hit.station + 0.55).contains(s));
                let near = in_cell.map(|(_, pose)| pose).any(|p| touches(&grid, p, EXCESS, 0.4 * grid.resolution()));
                assert!(near, "{}: false hit {hit:?} of {start:?} {spiral:?}", path.display());
                hits += 1;
            } else {
                free += 1;
            }
        }
        println!(
            "{}: {} × {} cells of {} m, {} rectangles, {hits} sweeps hit, {free} free",
            path.file_name().unwrap().to_string_lossy(),
            grid.width(),
            grid.height(),
            grid.resolution(),
            grid.blocks(|c| c == Cell::Occupied).len(),
        );
    }
}
