//! `stays_on_road`: the whole outline of every driven footprint, within the union of the lanelets.

use super::shapes::{Bounds, contains, distance_to_outline, footprint_at};
use super::{Check, Settings, Status};
use crate::geometry::{Point, Pose};
use crate::map::RoadNetwork;
use crate::simulation::Log;
use crate::vehicle::Vehicle;

/// Spacing of the points tested on the footprint's outline, m: half the narrowest notch of a road border that is
/// worth seeing.
const OUTLINE_SPACING: f64 = 0.5;

/// How far around the footprint lanelets are looked at first, m. Excursions beyond it are measured against all.
const NEARBY: f64 = 2.0;

struct Area {
    outline: Vec<Point>,
    bounds: Bounds,
}

/// The drivable lanelets of a network.
pub(super) struct Road {
    areas: Vec<Area>,
}

impl Road {
    pub(super) fn new(network: &RoadNetwork) -> Self {
        let drivable = network.lanelets.values().filter(|l| l.is_drivable());
        let area = |outline: Vec<Point>| Area { bounds: Bounds::of(&outline), outline };
        Self { areas: drivable.map(|l| area(l.outline())).collect() }
    }

    /// The largest distance of any point of the footprint's outline from the road, m, with the vehicle's rear axle there.
    pub(super) fn excursion(&self, vehicle: &Vehicle, rear_axle: &Pose) -> f64 {
        excursion(&self.areas, &footprint_at(vehicle, rear_axle))
    }
}

/// The check: the largest distance of any point of the footprint's outline from the drivable lanelets.
pub(super) fn stays_on_road(network: &RoadNetwork, vehicle: &Vehicle, log: &Log, settings: &Settings) -> Check {
    let road = Road::new(network);
    let mut worst = (0.0, None);
    let mut at_start = 0.0;
    for (i, sample) in log.samples.iter().enumerate() {
        let excursion = road.excursion(vehicle, &sample.pose);
        if i == 0 {
            at_start = excursion;
        }
        if excursion > worst.0 {
            worst = (excursion, Some(sample.time));
        }
    }
    let mut note =
        format!("footprint's outline every {OUTLINE_SPACING} m against the union of {} lanelets", road.areas.len());
    if at_start > settings.road_tolerance {
        note += &format!("; the start itself is {at_start:.2} m off the road");
    }
    Check {
        name: "stays_on_road",
        status: Status::of(worst.0 <= settings.road_tolerance),
        value: worst.0,
        limit: settings.road_tolerance,
        unit: "m",
        at_time: worst.1,
        note,
    }
}

/// The largest distance of a point on the footprint's outline from the union of the areas, m.
fn excursion(areas: &[Area], footprint: &[Vec<Point>]) -> f64 {
    footprint.iter().map(|part| excursion_of(areas, part)).fold(0.0, f64::max)
}

fn excursion_of(areas: &[Area], part: &[Point]) -> f64 {
    let around = Bounds::of(part);
    let nearby: Vec<&Area> = areas.iter().filter(|a| a.bounds.near(&around, NEARBY)).collect();
    outline_points(part)
        .filter(|p| !nearby.iter().any(|a| contains(&a.outline, *p)))
        .map(|p| {
            let to = |area: &&Area| distance_to_outline(&area.outline, p);
            let near = nearby.iter().map(to).fold(f64::INFINITY, f64::min);
            // what lies within NEARBY of the point was among `nearby`
            if near <= NEARBY { near } else { areas.iter().map(|a| to(&a)).fold(f64::INFINITY, f64::min) }
        })
        .fold(0.0, f64::max)
}

fn outline_points(corners: &[Point]) -> impl Iterator<Item = Point> + '_ {
    (0..corners.len()).flat_map(move |i| {
        let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
        let steps = ((b - a).norm() / OUTLINE_SPACING).ceil().max(1.0);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small positive count
        (0..steps as usize).map(move |k| a + (b - a) * (k as f64 / steps))
    })
}
