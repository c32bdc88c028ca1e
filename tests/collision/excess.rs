//! Excess of the conservative footprint over the area that the vehicle covers.

use stopline::collision::Margins;
use stopline::geometry::spiral::CubicSpiral;
use stopline::geometry::{Point, Pose};

use crate::helpers::{no_margins, plain, scenario, vehicle, world};
use crate::random::Random;

/// Curvature ranges, 1/m, and the largest |κ′| in them, 1/m². A car at walking speed with its largest steering rate reaches
/// 0.1 1/m².
const RANGES: [(f64, f64); 5] = [(0.0, 0.05), (0.05, 0.1), (0.1, 0.15), (0.15, 0.2), (0.2, 0.3)];
const MAX_RATE: f64 = 0.1;
const SPIRALS: usize = 150;
const CELLS_OF_EACH: usize = 6;
/// Guaranteed limit of the excess up to 0.2 1/m, m.
const LIMIT: f64 = 0.05;

/// Distance from the vehicle's rectangle at a pose, m, 0 inside.
fn outside(pose: &Pose, p: Point) -> f64 {
    let v = vehicle_rectangle();
    let d = pose.to_local(p);
    (v.0 - d.x).max(d.x - v.1).max(0.0).hypot((d.y.abs() - v.2).max(0.0))
}

fn vehicle_rectangle() -> (f64, f64, f64) {
    static RECTANGLE: std::sync::OnceLock<(f64, f64, f64)> = std::sync::OnceLock::new();
    *RECTANGLE.get_or_init(|| {
        let [rear_right, _, front_left, _] = vehicle().footprint.bounding_rectangle();
        (rear_right.x, front_left.x, front_left.y)
    })
}

/// Points on the border of a polygon.
fn border(polygon: &[Point]) -> Vec<Point> {
    const EVERY: f64 = 0.04;
    let sides = polygon.iter().zip(polygon.iter().cycle().skip(1));
    sides
        .flat_map(|(a, b)| {
            let n = ((b - a).norm() / EVERY).ceil().max(1.0);
            (0..n as u32).map(move |i| a + (b - a) * (f64::from(i) / n))
        })
        .collect()
}

/// A random spiral whose largest |κ| is in the range.
fn spiral(random: &mut Random, (from, to): (f64, f64)) -> CubicSpiral {
    loop {
        let spiral = random.spiral(1.2 * to, (3.0, 30.0));
        let k = spiral.max_abs_curvature();
        if k > from && k <= to && spiral.max_abs_curvature_rate() <= MAX_RATE {
            return spiral;
        }
    }
}

/// The excess of some cells of the spiral, m: the largest distance of their footprints from the area covered on the whole
/// path, by dense sampling.
fn excesses(random: &mut Random, spiral: &CubicSpiral) -> Vec<f64> {
    const DENSE: f64 = 0.02;
    let start = Pose::new(0.0, 0.0, random.within(-3.0, 3.0));
    let world = world(&scenario(plain(), vec![]), &no_margins());
    let sweep = world.sweep(&start, spiral);
    let n = (spiral.length / DENSE).ceil() as usize;
    let poses: Vec<(f64, Pose)> = spiral.sampled(&start, n).into_iter().map(|(s, p)| (s, p.pose)).collect();
    let cell_excess = |cell: usize| {
        let (from, to) = (sweep.stations()[cell], sweep.stations()[cell + 1]);
        let within = |by: f64| {
            let low = poses.partition_point(|(s, _)| *s < from - by).saturating_sub(1);
            &poses[low..poses.partition_point(|(s, _)| *s < to + by).min(poses.len() - 1) + 1]
        };
        // poses within a body length can cover the point; poses in the cell itself usually do
        let nearest = |p: Point, poses: &[(f64, Pose)]| {
            poses.iter().map(|(_, pose)| outside(pose, p)).fold(f64::INFINITY, f64::min)
        };
        border(&sweep.footprint(cell, &Margins::NONE)).into_iter().fold(0.0, |worst: f64, p| {
            if nearest(p, within(0.0)) <= worst { worst } else { worst.max(nearest(p, within(5.0))) }
        })
    };
    (0..CELLS_OF_EACH).map(|_| cell_excess(random.within(0.0, sweep.cells() as f64) as usize)).collect()
}

#[test]
fn footprints_exceed_the_covered_area_by_at_most_five_centimetres() {
    let mut random = Random::new(11);
    for range in RANGES {
        let mut all: Vec<f64> = (0..SPIRALS)
            .flat_map(|_| {
                let spiral = spiral(&mut random, range);
                excesses(&mut random, &spiral)
            })
            .collect();
        all.sort_by(f64::total_cmp);
        let at = |share: f64| 100.0 * all[((all.len() - 1) as f64 * share) as usize];
        println!(
            "|κ| up to {:.2} 1/m, |κ′| up to {MAX_RATE} 1/m²: excess median {:.2} cm, 90 % {:.2} cm, 99 % {:.2} cm, largest {:.2} cm",
            range.1,
            at(0.5),
            at(0.9),
            at(0.99),
            at(1.0)
        );
        assert!(range.1 > 0.2 || at(1.0) <= 100.0 * LIMIT, "{} cm at up to {} 1/m", at(1.0), range.1);
    }
}
