//! `stays_on_road`: the outline of every driven footprint lies within the union of the drivable lanelets.

use super::shapes::{Bounds, contains, distance_to_outline, footprint_at};
use super::{Check, Settings, Status};
use crate::geometry::{Point, Pose};
use crate::map::RoadNetwork;
use crate::number::Short;
use crate::simulation::Log;
use crate::vehicle::Vehicle;

/// Spacing of the tested points on the footprint's outline, m. A notch in the road border narrower than this can be missed.
const OUTLINE_SPACING: f64 = 0.5;

/// Lanelets within this distance of the footprint are tested first, m. A larger excursion is measured against all lanelets.
const NEARBY: f64 = 2.0;

struct Area {
    outline: Vec<Point>,
    bounds: Bounds,
}

/// The drivable lanelets of a network.
pub(super) struct Road {
    areas: Vec<Area>,
}

/// The point of a footprint that lies farthest off the road.
#[derive(Debug, Clone, Copy)]
pub(super) struct Excursion {
    /// Distance of the point from the road, m; 0 if the whole outline is on the road.
    pub(super) depth: f64,
    /// The point, in world coordinates; `None` if the whole outline is on the road.
    pub(super) at: Option<Point>,
}

impl Road {
    pub(super) fn new(network: &RoadNetwork) -> Self {
        let drivable = network.lanelets.values().filter(|l| l.is_drivable());
        let area = |outline: Vec<Point>| Area { bounds: Bounds::of(&outline), outline };
        Self { areas: drivable.map(|l| area(l.outline())).collect() }
    }

    /// The largest distance of any point of the footprint's outline from the road, with the rear axle at a pose.
    pub(super) fn excursion(&self, vehicle: &Vehicle, rear_axle: &Pose) -> Excursion {
        let parts = footprint_at(vehicle, rear_axle);
        let on_road = Excursion { depth: 0.0, at: None };
        parts.iter().map(|part| self.excursion_of(part)).fold(on_road, deeper)
    }

    fn excursion_of(&self, part: &[Point]) -> Excursion {
        let around = Bounds::of(part);
        let nearby: Vec<&Area> = self.areas.iter().filter(|a| a.bounds.near(&around, NEARBY)).collect();
        outline_points(part)
            .filter(|p| !nearby.iter().any(|a| contains(&a.outline, *p)))
            .map(|p| {
                let to = |area: &&Area| distance_to_outline(&area.outline, p);
                let near = nearby.iter().map(to).fold(f64::INFINITY, f64::min);
                let all = || self.areas.iter().map(|a| to(&a)).fold(f64::INFINITY, f64::min);
                // `nearby` contains every lanelet within NEARBY of the point
                Excursion { depth: if near <= NEARBY { near } else { all() }, at: Some(p) }
            })
            .fold(Excursion { depth: 0.0, at: None }, deeper)
    }
}

fn deeper(a: Excursion, b: Excursion) -> Excursion {
    if b.depth > a.depth { b } else { a }
}

/// The check: the largest distance of any point of the footprint's outline from the drivable lanelets.
pub(super) fn stays_on_road(network: &RoadNetwork, vehicle: &Vehicle, log: &Log, settings: &Settings) -> Check {
    let road = Road::new(network);
    let limit = settings.road_tolerance;
    let mut at_start = 0.0;
    let mut worst = (Excursion { depth: 0.0, at: None }, 0.0);
    for (i, sample) in log.samples.iter().enumerate() {
        let excursion = road.excursion(vehicle, &sample.pose);
        if i == 0 {
            at_start = excursion.depth;
        }
        if excursion.depth > worst.0.depth {
            worst = (excursion, sample.time);
        }
    }
    let (Excursion { depth, at }, time) = worst;
    let passes = depth <= limit;
    let verb = if passes { "stayed on the road: at most" } else { "left the road by" };
    let mut note = match at {
        None => "stayed on the road".to_owned(),
        Some(p) => format!(
            "{verb} {:.2} m at {time:.2} s at ({:.1}, {:.1}); limit {limit:.2} m",
            Short(depth),
            Short(p.x),
            Short(p.y)
        ),
    };
    if at_start > limit {
        note += &format!("; the start is {:.2} m off the road", Short(at_start));
    }
    Check {
        name: "stays_on_road",
        status: Status::of(passes),
        value: depth,
        limit,
        unit: "m",
        at_time: at.map(|_| time),
        impact: None,
        note,
        method: format!(
            "points every {OUTLINE_SPACING} m on the footprint's outline against the union of {} drivable lanelets",
            road.areas.len()
        ),
    }
}

fn outline_points(corners: &[Point]) -> impl Iterator<Item = Point> + '_ {
    (0..corners.len()).flat_map(move |i| {
        let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
        let steps = ((b - a).norm() / OUTLINE_SPACING).ceil().max(1.0);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small positive count
        (0..steps as usize).map(move |k| a + (b - a) * (k as f64 / steps))
    })
}
