//! The stations of the layers on the reference line.
//!
//! Consecutive cycles should use the same layers, so that edges can be cached. But with only a few fixed stations the lattice
//! could not place swerves near the obstacles. Therefore the distance between layers is one of a few values that depend only
//! on the speed. Layers are at integer multiples of a quarter of that distance (at least of the grid), so that four sets of
//! layers alternate as the vehicle moves. Where the reference line turns by more than [`Settings::max_turn`] between two
//! layers, the gap is halved until it turns less or is one grid step.

use std::sync::Arc;

use super::{LatticeContext, Node, Settings, nodes};
use crate::geometry::wrap_angle;
use crate::reference::ReferenceLine;

/// What a layer is fixed to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum LayerId {
    /// A multiple of [`Settings::grid`].
    Grid(i64),
    /// The target.
    Target,
}

impl LayerId {
    /// The station of a layer of the grid, m.
    pub(super) fn station(self, settings: &Settings) -> Option<f64> {
        match self {
            Self::Grid(index) => Some(index as f64 * settings.grid),
            Self::Target => None,
        }
    }
}

/// A layer.
#[derive(Debug, Clone)]
pub(super) struct Layer {
    pub(super) id: LayerId,
    /// m.
    pub(super) station: f64,
    /// From right to left; at a target, its nodes behind all others.
    pub(super) nodes: Arc<[Node]>,
}

/// The layers ahead of station `here`, nearest first: those of the grid, and that of a target beside the reference line instead of the
/// ones next to it.
pub(super) fn ahead(
    context: &LatticeContext<'_>,
    here: f64,
    speed: f64,
    horizon: f64,
    settings: &Settings,
) -> Vec<Layer> {
    let everywhere: Arc<[Node]> = nodes(settings).into();
    let on_grid = |index: i64| {
        let (id, nodes) = (LayerId::Grid(index), Arc::clone(&everywhere));
        Layer { id, station: index as f64 * settings.grid, nodes }
    };
    let mut layers: Vec<Layer> =
        on_grid_ahead(context.reference, here, speed, horizon, settings).into_iter().map(on_grid).collect();
    let (nearest, farthest) = (here + NEAREST_TARGET * settings.min_edge_length, here + horizon);
    if let Some(target) = context.target.filter(|t| (nearest..=farthest).contains(&t.station) && !t.contains(0.0, 0.0))
    {
        layers.retain(|layer| (layer.station - target.station).abs() >= settings.min_edge_length);
        let nodes = everywhere.iter().copied().chain(target.nodes()).collect();
        layers.push(Layer { id: LayerId::Target, station: target.station, nodes });
        layers.sort_by(|a, b| a.station.total_cmp(&b.station));
    }
    layers
}

/// Smallest distance from the vehicle to the layer of the target, as a share of the least length of an edge: nothing nearer leads there.
const NEAREST_TARGET: f64 = 0.5;

/// Indices of stations, in multiples of [`Settings::grid`], of the layers of the grid ahead of station `here`, nearest first.
fn on_grid_ahead(reference: &ReferenceLine, here: f64, speed: f64, horizon: f64, settings: &Settings) -> Vec<i64> {
    let target = (speed * settings.edge_time).clamp(settings.min_edge_length, settings.max_edge_length);
    let (stride, phase) = spacing(target, settings);
    let farthest = (here + horizon).min(reference.length());
    let station = |index: i64| index as f64 * settings.grid;
    let first = ceil((here + target) / (phase as f64 * settings.grid)) * phase;
    let mut layers = Vec::new();
    // the gap before the first layer may be halved, too
    let mut to = first;
    while layers.len() < settings.layers && station(to) <= farthest + ON_GRID {
        split(reference, to - stride, to, settings, &mut layers);
        layers.retain(|index| *index >= first || station(*index) >= here + settings.min_edge_length);
        to += stride;
    }
    layers.truncate(settings.layers);
    if layers.is_empty() {
        // the road ends within one edge: use its last grid station
        let last = ceil(farthest / settings.grid + ON_GRID) - 1;
        layers.extend((station(last) > here + MIN_LAST_EDGE).then_some(last));
    }
    layers
}

/// Tolerance of stations on the grid, in steps and m, so that rounding does not decide.
const ON_GRID: f64 = 1e-6;
/// Shortest edge at the end of the road, m.
const MIN_LAST_EDGE: f64 = 1.0;

/// Distances between layers and the unit of their stations, in grid steps. Neighbouring distances differ by a third or a
/// half: one is always near the target, and few of them serve all speeds.
const SPACINGS: [(i64, i64); 8] = [(1, 1), (2, 1), (3, 1), (4, 1), (6, 2), (8, 2), (12, 3), (16, 4)];

/// The spacing with the smallest ratio to a target length, m.
fn spacing(target: f64, settings: &Settings) -> (i64, i64) {
    let off = |steps: i64| (steps as f64 * settings.grid / target).ln().abs();
    SPACINGS.into_iter().min_by(|(a, _), (b, _)| off(*a).total_cmp(&off(*b))).unwrap_or((1, 1))
}

#[allow(clippy::cast_possible_truncation)] // stations are far below 2⁵³ grid steps
fn ceil(steps: f64) -> i64 {
    (steps - ON_GRID).ceil() as i64
}

/// Appends the layers between `from` (excluded) and `to` (included), closer where the line turns.
fn split(reference: &ReferenceLine, from: i64, to: i64, settings: &Settings, layers: &mut Vec<i64>) {
    if to - from > 1 && turning(reference, from, to, settings.grid) > settings.max_turn {
        let middle = i64::midpoint(from, to);
        split(reference, from, middle, settings, layers);
        split(reference, middle, to, settings, layers);
    } else {
        layers.push(to);
    }
}

/// Total variation of the heading of the line between two stations, rad.
fn turning(reference: &ReferenceLine, from: i64, to: i64, grid: f64) -> f64 {
    /// Samples per grid step.
    const FINENESS: i64 = 2;
    let yaw = |i: i64| reference.at(i as f64 / FINENESS as f64 * grid).pose.yaw;
    (from * FINENESS..to * FINENESS).map(|i| wrap_angle(yaw(i + 1) - yaw(i)).abs()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::tests::{bent_road, straight_road};
    use std::collections::BTreeSet;

    fn metres(layers: &[i64], settings: &Settings) -> Vec<f64> {
        layers.iter().map(|i| *i as f64 * settings.grid).collect()
    }

    #[test]
    fn one_speed_has_at_most_four_sets_of_layers() {
        let (line, settings) = (straight_road(300.0), Settings::default());
        for speed in [0.0, 3.0, 8.0, 13.9, 20.0, 25.0, 40.0] {
            let cycles = (0..200).map(|i| on_grid_ahead(&line, 10.0 + 0.7 * f64::from(i), speed, 100.0, &settings));
            let pairs: BTreeSet<(i64, i64)> =
                cycles.flat_map(|c| c.windows(2).map(|w| (w[0], w[1])).collect::<Vec<_>>()).collect();
            let mut starts_in_stride = BTreeSet::new();
            for (from, to) in &pairs {
                starts_in_stride.insert(from % (to - from));
            }
            assert!(starts_in_stride.len() <= 4, "{speed} m/s: {starts_in_stride:?}");
            // the pairs exist at every speed
            assert!(!pairs.is_empty());
        }
    }

    #[test]
    fn few_distances_between_layers_serve_all_speeds() {
        let settings = Settings::default();
        let distances = (0..400).map(|i| spacing((0.16 * f64::from(i)).clamp(8.0, 40.0), &settings).0);
        let distinct: BTreeSet<i64> = distances.clone().collect();
        assert_eq!(distinct.len(), 5, "from standstill to 40 m/s: {distinct:?}");
        assert!(distances.clone().zip(distances.skip(1)).all(|(a, b)| b >= a));
    }

    #[test]
    fn first_edges_exceed_the_target_length_by_less_than_ten_metres() {
        let (line, settings) = (straight_road(400.0), Settings::default());
        for i in 0..400 {
            let (here, speed) = (0.31 * f64::from(i), 0.1 * f64::from(i % 300));
            let layers = metres(&on_grid_ahead(&line, here, speed, 100.0, &settings), &settings);
            let target = (speed * settings.edge_time).clamp(settings.min_edge_length, settings.max_edge_length);
            assert!(
                (target - 1e-4..target + 10.0).contains(&(layers[0] - here)),
                "{} at {speed} m/s",
                layers[0] - here
            );
            assert!(layers.windows(2).all(|w| w[1] > w[0]));
            assert!(*layers.last().unwrap() <= here + 100.0 + 1e-5);
        }
    }

    #[test]
    fn rounding_does_not_move_a_station_off_the_grid() {
        let (line, settings) = (straight_road(300.0), Settings::default());
        // 8 m beyond 12 m is the grid station of 20 m
        for off in [-1e-7, 0.0, 1e-7] {
            assert_eq!(on_grid_ahead(&line, 12.0 + off, 0.0, 60.0, &settings)[0], 4, "{off}");
        }
    }

    #[test]
    fn layers_are_closer_only_where_the_line_turns() {
        let settings = Settings::default();
        // straight 40 m, a quarter circle of 10 m radius, straight
        let line = bent_road(40.0, 10.0);
        let layers = metres(&on_grid_ahead(&line, 0.0, 6.0, 100.0, &settings), &settings);
        let gaps: Vec<(f64, f64)> = layers.windows(2).map(|w| (w[0], w[1] - w[0])).collect();
        let in_bend = |s: &f64| (40.0..50.0).contains(s);
        assert!(gaps.iter().any(|(s, gap)| in_bend(s) && *gap == 5.0), "{gaps:?}");
        assert!(gaps.iter().filter(|(s, _)| *s < 25.0 || *s > 65.0).all(|(_, gap)| *gap == 10.0), "{gaps:?}");
        // before the curve the first layer is nearer than on a straight road, but not nearer than the shortest edge
        let nearest = |here: f64| on_grid_ahead(&line, here, 12.0, 100.0, &settings)[0] as f64 * settings.grid - here;
        assert!(nearest(38.0) < 12.0 * settings.edge_time && nearest(38.0) >= settings.min_edge_length);
        assert!(nearest(2.0) >= 12.0 * settings.edge_time);
    }

    #[test]
    fn the_last_grid_station_of_the_road_is_a_layer() {
        let settings = Settings::default();
        let line = straight_road(103.0);
        for here in [93.0, 96.0, 98.5] {
            assert_eq!(on_grid_ahead(&line, here, 2.0, 100.0, &settings), [20], "from {here} m");
        }
        assert_eq!(on_grid_ahead(&line, 99.5, 2.0, 100.0, &settings), Vec::<i64>::new());
    }
}
