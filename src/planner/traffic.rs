//! What of the traffic counts in a cycle: who gives way from behind, and whether proofs hold for the predicted motions
//! alone or for all motions around them.
//!
//! # Who comes from behind
//! With `rear_traffic = "binding"` everybody counts, also a vehicle behind whose prediction, made as if we were not there,
//! drives through us: then no rest in front of it is safe before it has passed. With `"yielding"` such a vehicle is taken
//! to brake for us. An obstacle yields if, at the time of the cycle,
//!
//! * its whole footprint lies behind our rear bumper along our way,
//! * it reaches into the strip that we swept on that way,
//! * and it heads the way we do, within 90°.
//!
//! Our way is where the vehicle has been since the run began, before that the reference line back to its beginning and
//! the lanelets that lead there, as long as there is only one (of two that merge, neither is known to be ours), ahead the
//! reference line. A vehicle yields **for as long as its prediction stays in the strip**, the margin to moving obstacles
//! included: from where it has pulled out, to overtake or to turn off, it counts again. Neighbours alongside, who comes ahead, crosses or comes against us count
//! throughout, and so do prediction sets, which have no heading, and who is farther back than our way is known.
//!
//! The planner alone is told so. Physics drives everybody as predicted, and the verdict calls a contact a contact, from
//! behind as well.
//!
//! # Motions around the predicted ones
//! With [`UncertaintyMode::Preferred`] the comfortable levels are tried against the set of motions first
//! ([`crate::collision::uncertainty`]), and against the predicted ones when no plan is proven; with
//! [`UncertaintyMode::Required`] all levels are tried against the set alone. Without a proof the last plan goes on. If the
//! traffic moves as predicted, that plan is proven against the set of the present moment as well: the state now is one
//! of those reckoned with, and what may come of it is less.

use std::sync::OnceLock;

use super::settings::{RearTraffic, UncertaintyMode};
use super::{Level, Planner, Start};
use crate::collision::{CollisionSettings, CollisionWorld, MotionBounds, Predictions};
use crate::geometry::Point;
use crate::geometry::polyline::Polyline;
use crate::map::{ConvexPart, Motion, Obstacle, RoadNetwork};
use crate::reference::ReferenceLine;

/// The traffic as it counts in the present cycle.
#[derive(Default)]
pub(super) struct Traffic {
    now: f64,
    /// Where the vehicle has been, and before that the lane that led there; the last point is the present one.
    came_by: Vec<Point>,
    /// Who gives way, until when (s), in the order of the scenario.
    yielding: Vec<(i64, f64)>,
    /// Of each collision world, without who gives way. Kept while that stays the same.
    binding: [OnceLock<Predictions>; 3],
    /// Of each collision world, grown in this cycle.
    grown: [OnceLock<Predictions>; 3],
}

/// How far back the way is looked at, m: who is farther behind has time to brake, and counts.
const SEEN_BEHIND: f64 = 200.0;
/// Distance between the points of the way driven, m.
const SPACING: f64 = 1.0;
/// The reference line is joined this far ahead, m: beside it, the vehicle comes back to it.
const JOINED_AHEAD: f64 = 5.0;

impl Planner<'_> {
    /// Takes note of the traffic at the start of a cycle.
    pub(super) fn look_at_traffic(&mut self, start: &Start) {
        let traffic = &mut self.traffic;
        traffic.now = start.point.time;
        traffic.grown = Default::default();
        if self.settings.rear_traffic == RearTraffic::Binding {
            return;
        }
        let reference = self.lanes.as_ref().ok().and_then(|lanes| lanes.iter().find(|l| l.is_current));
        let Some(reference) = reference.map(|lane| &lane.reference) else { return };
        let here = start.point.pose.position;
        if traffic.came_by.is_empty() {
            traffic.came_by = lane_behind(&self.scenario.network, reference, here);
        }
        traffic.come_to(here);
        let [rear_right, _, front_left, _] = self.vehicle.footprint.bounding_rectangle();
        let half_width = front_left.y.max(-rear_right.y);
        let CollisionSettings { time_slice: step, moving_obstacles: margins, .. } = self.settings.collision;
        let strips = (half_width, half_width + margins.lateral);
        let way = Way::new(&traffic.came_by, reference, rear_right.x, strips);
        let yields = |o: &Obstacle| Some((o.id, way.as_ref()?.yields_until(o, start.point.time, step)?));
        let yielding: Vec<(i64, f64)> = self.scenario.obstacles.iter().filter_map(yields).collect();
        if yielding != traffic.yielding {
            traffic.yielding = yielding;
            traffic.binding = Default::default();
        }
    }

    /// What counts of the traffic on a level.
    pub(super) fn counted(&self, level: &Level) -> &Predictions {
        self.traffic.counted(&self.worlds, level, &self.settings.uncertainty.bounds())
    }

    /// The levels with those against the set of motions, as the settings ask for them.
    pub(super) fn with_sets(&self, levels: Vec<Level>) -> Vec<Level> {
        let robust = |level: &Level| Level { robust: true, ..*level };
        match self.settings.uncertainty.mode {
            UncertaintyMode::Off => levels,
            UncertaintyMode::Preferred => {
                let with_margins = levels.iter().filter(|r| r.world == 0).map(robust);
                with_margins.chain(levels.iter().copied()).collect()
            }
            UncertaintyMode::Required => levels.iter().map(robust).collect(),
        }
    }
}

impl Traffic {
    fn come_to(&mut self, here: Point) {
        // the last point is where the vehicle was in the cycle before: kept if it is far enough from the one before it
        if let [.., a, b] = self.came_by[..]
            && (b - a).norm() < SPACING
        {
            self.came_by.pop();
        }
        self.came_by.push(here);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count of points
        let most = (SEEN_BEHIND / SPACING) as usize;
        let too_many = self.came_by.len().saturating_sub(most);
        self.came_by.drain(..too_many);
    }

    fn counted<'t>(&'t self, worlds: &'t [CollisionWorld; 3], level: &Level, bounds: &MotionBounds) -> &'t Predictions {
        let all = worlds[level.world].predictions();
        let binding = match self.yielding[..] {
            [] => all,
            _ => self.binding[level.world].get_or_init(|| all.without(&self.yielding)),
        };
        if level.robust { self.grown[level.world].get_or_init(|| binding.grown(self.now, bounds)) } else { binding }
    }
}

/// The lane up to a point on the reference line, and the only lanelets that lead to it.
fn lane_behind(network: &RoadNetwork, reference: &ReferenceLine, here: Point) -> Vec<Point> {
    /// Lanelets followed back at most: they may be short, and go in circles.
    const MOST_LANELETS: usize = 50;
    let station = reference.project(here).s;
    let mut behind: Vec<Point> = Vec::new();
    for (_, p) in reference.points().take_while(|(s, _)| *s < station - SPACING) {
        if behind.last().is_none_or(|last| (p - last).norm() >= SPACING) {
            behind.push(p);
        }
    }
    let mut length = station;
    let mut first = reference.lanelet_at(0.0).and_then(|id| network.lanelets.get(&id));
    for _ in 0..MOST_LANELETS {
        let before = first.and_then(|l| match l.predecessors[..] {
            [only] => network.lanelets.get(&only),
            _ => None,
        });
        let Some(before) = before.filter(|_| length < SEEN_BEHIND) else { break };
        length += before.centre.length();
        behind.splice(0..0, before.centre.resampled(2.0 * SPACING));
        first = Some(before);
    }
    behind
}

/// The vehicle's way, with the strip that it sweeps.
struct Way {
    line: Polyline,
    /// Station of the rear bumper, m.
    rear_bumper: f64,
    /// Half widths of what is swept, and with the margin to moving obstacles, m.
    strips: (f64, f64),
}

/// Where a footprint lies along the way, m.
struct Extent {
    stations: (f64, f64),
    offsets: (f64, f64),
}

impl Extent {
    /// Whether it reaches into a strip of that half width.
    fn is_within(&self, half_width: f64) -> bool {
        self.offsets.0 <= half_width && self.offsets.1 >= -half_width
    }
}

impl Way {
    /// From the way driven up to the rear axle, the reference line ahead, the rear bumper's coordinate from the rear axle
    /// (negative) and the half widths of the strips, m.
    fn new(came_by: &[Point], reference: &ReferenceLine, rear: f64, strips: (f64, f64)) -> Option<Self> {
        let here = *came_by.last()?;
        let joined = reference.project(here).s + JOINED_AHEAD;
        let ahead = reference.points().skip_while(|(s, _)| *s < joined).map(|(_, p)| p);
        let line = Polyline::new(came_by.iter().copied().chain(ahead))?;
        let driven = Polyline::new(came_by.iter().copied())?.length();
        Some(Self { line, rear_bumper: driven + rear, strips })
    }

    /// Until when an obstacle gives way from behind: as long as its prediction stays in the strip. `None` if it does not.
    fn yields_until(&self, obstacle: &Obstacle, now: f64, step: f64) -> Option<f64> {
        let Motion::Trajectory(_) = obstacle.motion else { return None };
        let pose = obstacle.pose_at(now)?;
        let extent = self.extent(&obstacle.occupied_at(now))?;
        let is_behind = extent.stations.0 > 0.0 && extent.stations.1 < self.rear_bumper;
        let direction = self.line.yaw_at(self.line.project(pose.position).station);
        let follows = (pose.yaw - direction).cos() > 0.0;
        if !(is_behind && follows && extent.is_within(self.strips.0)) {
            return None;
        }
        let in_strip = |time: f64| {
            // where it is not, it does no harm
            self.extent(&obstacle.occupied_at(time)).is_none_or(|extent| extent.is_within(self.strips.1))
        };
        // on the limits of the slices of time, so that the answer stays the same from cycle to cycle
        let first = (now / step).floor();
        let ends = ((obstacle.lifetime().1 - now) / step).ceil().max(0.0);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count of slices
        let leaves = (1..=ends as usize + 1).map(|i| (first + i as f64) * step).find(|t| !in_strip(*t));
        Some(leaves.map_or(f64::INFINITY, |t| t - step))
    }

    /// `None` of nothing.
    fn extent(&self, parts: &[ConvexPart]) -> Option<Extent> {
        let mut found: Option<Extent> = None;
        let mut take = |p: Point, radius: f64| {
            let at = self.line.project(p);
            let (s, l) = (at.station, at.offset);
            let extent = found.get_or_insert(Extent { stations: (s, s), offsets: (l, l) });
            extent.stations = (extent.stations.0.min(s - radius), extent.stations.1.max(s + radius));
            extent.offsets = (extent.offsets.0.min(l - radius), extent.offsets.1.max(l + radius));
        };
        for part in parts {
            match part {
                ConvexPart::Polygon(points) => points.iter().for_each(|p| take(*p, 0.0)),
                ConvexPart::Circle { centre, radius } => take(*centre, *radius),
            }
        }
        found
    }
}
