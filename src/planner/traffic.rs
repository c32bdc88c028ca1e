//! The traffic that constrains proofs: following vehicles that yield, and robust proofs for motions around the predictions.
//!
//! # Following vehicles
//! With `rear_traffic = "binding"` all traffic constrains proofs. A prediction ignores the ego vehicle, so that a following
//! vehicle may drive through it; then a standstill in front of that vehicle is unsafe until it has passed. With
//! `"yielding"` the planner assumes that a following vehicle brakes for the ego vehicle. An obstacle yields if, at the time
//! of the cycle,
//!
//! * its whole footprint is behind the rear bumper of the ego vehicle, along the ego path,
//! * it overlaps the strip that the ego vehicle swept on that path,
//! * and its heading differs from that of the path by less than 90°.
//!
//! The ego path consists of three parts: the path driven since the start of the run; before it the reference line back to
//! its start and the predecessors of its first lanelet, while each has only one (with several, the ego path is unknown); and
//! ahead the reference line. An obstacle yields **until its prediction leaves the strip**, including the margin to moving
//! obstacles. Once it has pulled out to overtake or turned off, it constrains proofs again. All other traffic always
//! constrains proofs: neighbours, leading, crossing and oncoming vehicles, prediction sets (which have no heading), and
//! obstacles beyond the known ego path.
//!
//! With `"binding"` only the part of a following vehicle's motion that is extrapolated beyond its prediction is left out: nobody
//! predicted that it drives into a vehicle that stands in front of it.
//!
//! Only the planner makes this assumption. The simulation moves all obstacles as predicted, and the verdict counts a contact
//! from behind as a contact.
//!
//! # Robust proofs
//! With [`UncertaintyMode::Preferred`] the planner tries the levels with margins against the reachable sets first
//! ([`crate::collision::uncertainty`]), then all levels against the predictions. With [`UncertaintyMode::Required`] it tries
//! all levels against the reachable sets only. Without a proof the previous plan continues. If the traffic moves as
//! predicted, that plan is still robust: the present state is one of the states that its proof covered, and the reachable
//! sets from it are smaller.

use std::sync::OnceLock;

use super::Planner;
use super::known::Change;
use super::level::{Level, LevelLimits};
use super::settings::{RearTraffic, UncertaintyMode};
use crate::collision::{CollisionSettings, MotionBounds, Predictions};
use crate::geometry::Point;
use crate::geometry::polyline::Polyline;
use crate::map::{ConvexPart, Motion, Obstacle, RoadNetwork};
use crate::reference::ReferenceLine;
use crate::vehicle::State;

/// The traffic of the present cycle.
#[derive(Default)]
pub(super) struct Traffic {
    now: f64,
    /// The path driven so far, preceded by the lane that led to it; the last point is the present position.
    driven_path: Vec<Point>,
    /// Obstacles with the time interval in which they do not constrain proofs (s), in the order of the observation.
    yielding: Vec<(i64, (f64, f64))>,
    /// The predictions without these intervals. Valid while `yielding` does not change.
    binding: OnceLock<Predictions>,
    /// The reachable sets of this cycle.
    reachable: OnceLock<Predictions>,
}

/// Length of the ego path behind the vehicle, m. Obstacles farther behind constrain proofs.
const LOOK_BEHIND: f64 = 200.0;
/// Distance between the points of the driven path, m.
const SPACING: f64 = 1.0;
/// Distance ahead at which the ego path joins the reference line, m.
const JOINED_AHEAD: f64 = 5.0;

impl Planner<'_> {
    /// Updates the traffic at the start of a cycle.
    pub(super) fn update_traffic(&mut self, state: &State) {
        let (traffic, now) = (&mut self.traffic, state.time);
        traffic.now = now;
        traffic.reachable = OnceLock::new();
        let is_binding = self.settings.rear_traffic == RearTraffic::Binding;
        if is_binding && self.settings.extrapolation.duration <= 0.0 {
            return;
        }
        let reference = self.lanes.as_ref().ok().and_then(|lanes| lanes.iter().find(|l| l.is_current));
        let Some(reference) = reference.map(|lane| &lane.reference) else { return };
        let here = state.pose.position;
        if traffic.driven_path.is_empty() {
            traffic.driven_path = lane_behind(self.map.network, reference, here);
        }
        traffic.record_position(here);
        let [rear_right, _, front_left, _] = self.vehicle.footprint.bounding_rectangle();
        let half_width = front_left.y.max(-rear_right.y);
        let CollisionSettings { time_slice: step, moving_obstacles: margins, .. } = self.settings.collision;
        let strips = (half_width, half_width + margins.lateral);
        let own_path = OwnPath::new(&traffic.driven_path, reference, rear_right.x, strips);
        let yields = |o: &Obstacle| {
            let until = own_path.as_ref()?.yields_until(o, now, step)?;
            let interval = if is_binding { (o.lifetime().1, f64::INFINITY) } else { (f64::NEG_INFINITY, until) };
            Some((o.id, interval))
        };
        let yielding: Vec<_> = self.known.observed.iter().filter_map(yields).collect();
        if yielding != traffic.yielding {
            traffic.yielding = yielding;
            traffic.binding = OnceLock::new();
        }
    }

    /// The predictions that constrain proofs on a level.
    pub(super) fn predictions_for(&self, level: &LevelLimits) -> &Predictions {
        self.predictions(level.robust)
    }

    /// The predictions that constrain proofs, robust ones or others.
    pub(super) fn predictions(&self, robust: bool) -> &Predictions {
        self.traffic.predictions(self.known.world.predictions(), robust, &self.settings.uncertainty.bounds())
    }

    /// The levels, with those for robust proofs as the settings require.
    pub(super) fn with_robust_levels(&self, levels: Vec<LevelLimits>) -> Vec<LevelLimits> {
        let robust = |level: &LevelLimits| LevelLimits { robust: true, ..*level };
        match self.settings.uncertainty.mode {
            UncertaintyMode::Off => levels,
            UncertaintyMode::Preferred => {
                let with_margins = levels.iter().filter(|r| r.level < Level::NoMargin).map(robust);
                with_margins.chain(levels.iter().copied()).collect()
            }
            UncertaintyMode::Required => levels.iter().map(robust).collect(),
        }
    }
}

impl Traffic {
    fn record_position(&mut self, here: Point) {
        // keep the position of the previous cycle only if it is far enough from the point before it
        if let [.., a, b] = self.driven_path[..]
            && (b - a).norm() < SPACING
        {
            self.driven_path.pop();
        }
        self.driven_path.push(here);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count of points
        let limit = (LOOK_BEHIND / SPACING) as usize;
        let excess = self.driven_path.len().saturating_sub(limit);
        self.driven_path.drain(..excess);
    }

    /// Drops what was computed for other obstacles.
    pub(super) fn renew(&mut self, change: Change) {
        if change != Change::Nothing {
            (self.binding, self.reachable) = Default::default();
        }
    }

    fn predictions<'t>(&'t self, all: &'t Predictions, robust: bool, bounds: &MotionBounds) -> &'t Predictions {
        let binding = match self.yielding[..] {
            [] => all,
            _ => self.binding.get_or_init(|| all.without(&self.yielding)),
        };
        if robust { self.reachable.get_or_init(|| binding.reachable(self.now, bounds)) } else { binding }
    }
}

/// The lane up to a point on the reference line, with its unique predecessors.
fn lane_behind(network: &RoadNetwork, reference: &ReferenceLine, here: Point) -> Vec<Point> {
    /// Maximum number of predecessors: they may be short, and may form a cycle.
    const MAX_LANELETS: usize = 50;
    let station = reference.project(here).s;
    let mut behind: Vec<Point> = Vec::new();
    for (_, p) in reference.points().take_while(|(s, _)| *s < station - SPACING) {
        if behind.last().is_none_or(|last| (p - last).norm() >= SPACING) {
            behind.push(p);
        }
    }
    let mut length = station;
    let mut first = reference.lanelet_at(0.0).and_then(|id| network.lanelets.get(&id));
    for _ in 0..MAX_LANELETS {
        let before = first.and_then(|l| match l.predecessors[..] {
            [only] => network.lanelets.get(&only),
            _ => None,
        });
        let Some(before) = before.filter(|_| length < LOOK_BEHIND) else { break };
        length += before.centre.length();
        behind.splice(0..0, before.centre.resampled(2.0 * SPACING));
        first = Some(before);
    }
    behind
}

/// The ego path with the strip that the vehicle sweeps.
struct OwnPath {
    line: Polyline,
    /// Station of the rear bumper, m.
    rear_bumper: f64,
    /// Half widths of the swept strip, without and with the margin to moving obstacles, m.
    strips: (f64, f64),
}

/// Extent of a footprint in the coordinates of the ego path, m.
struct Extent {
    stations: (f64, f64),
    offsets: (f64, f64),
}

impl Extent {
    /// Whether it overlaps a strip of this half width.
    fn is_within(&self, half_width: f64) -> bool {
        self.offsets.0 <= half_width && self.offsets.1 >= -half_width
    }
}

impl OwnPath {
    /// Builds the ego path from the driven path up to the rear axle, the reference line ahead, the coordinate of the rear
    /// bumper relative to the rear axle (negative) and the half widths of the strips, m.
    fn new(driven_path: &[Point], reference: &ReferenceLine, rear: f64, strips: (f64, f64)) -> Option<Self> {
        let here = *driven_path.last()?;
        let joined = reference.project(here).s + JOINED_AHEAD;
        let ahead = reference.points().skip_while(|(s, _)| *s < joined).map(|(_, p)| p);
        let line = Polyline::new(driven_path.iter().copied().chain(ahead))?;
        let driven = Polyline::new(driven_path.iter().copied())?.length();
        Some(Self { line, rear_bumper: driven + rear, strips })
    }

    /// The time until which an obstacle yields, s: its prediction stays in the strip until then. `None` if it does not yield.
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
            // an absent obstacle constrains no proof
            self.extent(&obstacle.occupied_at(time)).is_none_or(|extent| extent.is_within(self.strips.1))
        };
        // at the limits of the time slices, so that the result does not change from cycle to cycle
        let first = (now / step).floor();
        let ends = ((obstacle.lifetime().1 - now) / step).ceil().max(0.0);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count of slices
        let leaves = (1..=ends as usize + 1).map(|i| (first + i as f64) * step).find(|t| !in_strip(*t));
        Some(leaves.map_or(f64::INFINITY, |t| t - step))
    }

    /// The extent of a footprint; `None` if it is empty.
    fn extent(&self, parts: &[ConvexPart]) -> Option<Extent> {
        let mut total: Option<Extent> = None;
        let mut include = |p: Point, radius: f64| {
            let at = self.line.project(p);
            let (s, l) = (at.station, at.offset);
            let extent = total.get_or_insert(Extent { stations: (s, s), offsets: (l, l) });
            extent.stations = (extent.stations.0.min(s - radius), extent.stations.1.max(s + radius));
            extent.offsets = (extent.offsets.0.min(l - radius), extent.offsets.1.max(l + radius));
        };
        for part in parts {
            match part {
                ConvexPart::Polygon(points) => points.iter().for_each(|p| include(*p, 0.0)),
                ConvexPart::Circle { centre, radius } => include(*centre, *radius),
            }
        }
        total
    }
}
