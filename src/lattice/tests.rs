//! The search compared with slow, simple code; and its independence of repetition, threads and cached edges.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::edges::{Edge, KeptPrefix};
use super::layers::Layer;
use super::*;
use crate::collision::CollisionSettings;
use crate::fixtures::{self, lanelet, network, two_lane_road};
use crate::geometry::polyline::Polyline;
use crate::geometry::{Point, Vector};
use crate::map::{Lanelet, Obstacle};
use crate::reference::ReferenceSettings;
use proptest::prelude::*;

/// The search with valid settings.
fn search(
    context: &LatticeContext<'_>,
    root: &Root,
    speed: f64,
    horizon: f64,
    settings: &Settings,
    store: &mut EdgeStore,
) -> SearchResult {
    Lattice::new(settings.clone()).unwrap().search(context, root, speed, horizon, store)
}

fn paths(
    context: &LatticeContext<'_>,
    root: &Root,
    speed: f64,
    horizon: f64,
    settings: &Settings,
    store: &mut EdgeStore,
) -> Vec<LatticePath> {
    search(context, root, speed, horizon, settings, store).paths
}

/// A straight reference line along x.
pub(super) fn straight_road(length: f64) -> ReferenceLine {
    lane((0..=20).map(|i| Point::new(length * f64::from(i) / 20.0, 0.0)).collect())
}

/// A straight, a left turn by 90°, a straight of 60 m.
pub(super) fn bent_road(before: f64, radius: f64) -> ReferenceLine {
    let turned = (1..=30).map(|i| std::f64::consts::FRAC_PI_2 * f64::from(i) / 30.0);
    let bend = turned.map(|a| Point::new(before + radius * a.sin(), radius * (1.0 - a.cos())));
    let first = (0..=10).map(|i| Point::new(before * f64::from(i) / 10.0, 0.0));
    let last = (1..=20).map(|i| Point::new(before + radius, radius + 3.0 * f64::from(i)));
    lane(first.chain(bend).chain(last).collect())
}

/// The reference line of a lane 3.5 m wide.
fn lane(centre: Vec<Point>) -> ReferenceLine {
    let middle = Polyline::new(centre.iter().copied()).unwrap();
    let side = |offset: f64| {
        Polyline::new((0..centre.len()).map(|i| {
            let (a, b) = (centre[i.saturating_sub(1)], centre[(i + 1).min(centre.len() - 1)]);
            let tangent: Vector = (b - a).normalize();
            centre[i] + Vector::new(-tangent.y, tangent.x) * offset
        }))
        .unwrap()
    };
    let network = network([Lanelet { centre: middle, ..lanelet(1, side(-1.75), side(1.75)) }]);
    ReferenceLine::new(&network, &[1], 1.61, &ReferenceSettings::default()).unwrap()
}

/// A parked car of 4.5 m × 1.8 m, parallel to the road.
fn car(id: i64, x: f64, y: f64) -> Obstacle {
    standing(id, Pose::new(x, y, 0.0), 4.5, 1.8)
}

fn standing(id: i64, pose: Pose, length: f64, width: f64) -> Obstacle {
    fixtures::parked(id, pose, length, width)
}

/// 100 m of two lanes, the reference line in the middle of the right one (y = 0).
fn with_context(obstacles: Vec<Obstacle>, test: impl FnOnce(&LatticeContext<'_>)) {
    let scenario = fixtures::scenario(two_lane_road(2), obstacles);
    let vehicle = crate::vehicle::load("bmw_320i").unwrap();
    let reference =
        ReferenceLine::new(&scenario.network, &[100, 101], vehicle.width, &ReferenceSettings::default()).unwrap();
    let world = fixtures::collision_world(&scenario, &vehicle, &CollisionSettings::default(), 5.0);
    let (max_curvature, half_width) = (vehicle.max_curvature(), 0.5 * vehicle.width);
    // 9.5 m/s at the comfortable lateral acceleration
    let full_speed_curvature = 3.0 / 90.0;
    let margins = CollisionSettings::default().margins();
    test(&LatticeContext {
        reference: &reference,
        world: &world,
        margins,
        max_curvature,
        full_speed_curvature,
        half_width,
        target: None,
    });
}

fn root(context: &LatticeContext<'_>, station: f64, offset: f64) -> Root {
    let pose = context.reference.offset_pose(station, offset).unwrap().pose;
    Root { pose, curvature: 0.0, kept: vec![], start: pose, allowance: Allowance::NONE }
}

/// The content of paths, without their sweeps.
fn summary(paths: &[LatticePath]) -> Vec<(Path, f64, CostTerms, Option<Blocker>)> {
    paths.iter().map(|p| (p.path.clone(), p.free_length, p.terms, p.blocked_by)).collect()
}

/// Counts without those that depend on the cache.
fn reasons(counts: &EdgeCounts) -> EdgeCounts {
    EdgeCounts { solved: 0, swept: 0, ..counts.clone() }
}

fn assert_complete(counts: &EdgeCounts) {
    let c = counts;
    let rejected = c.off_road + c.no_spiral + c.curvature_bound + c.detour;
    assert_eq!(c.tried, rejected + c.unchecked + c.obstacle + c.occupied_cell + c.road_edge + c.free, "{c:?}");
    assert_eq!(c.obstacle, c.by_obstacle.values().sum::<usize>(), "{c:?}");
}

#[test]
fn results_do_not_depend_on_the_cache() {
    with_context(vec![car(7, 30.0, 0.0)], |context| {
        let settings = Settings::default();
        let mut used = EdgeStore::default();
        // from the side, other nodes are reached first
        for (station, offset) in [(5.0, 1.0), (5.5, -0.5), (5.0, 1.0), (6.0, 0.3), (5.0, 0.0)] {
            let root = root(context, station, offset);
            let cached = search(context, &root, 5.0, 40.0, &settings, &mut used);
            let fresh = search(context, &root, 5.0, 40.0, &settings, &mut EdgeStore::default());
            assert!(!fresh.paths.is_empty());
            assert_eq!(summary(&cached.paths), summary(&fresh.paths));
            assert_eq!(reasons(&cached.counts), reasons(&fresh.counts));
            let again = search(context, &root, 5.0, 40.0, &settings, &mut used);
            assert_eq!(summary(&again.paths), summary(&fresh.paths));
            assert_eq!((again.counts.solved, again.counts.swept), (0, 0), "a repeated query was computed again");
        }
    });
}

#[test]
fn free_paths_pass_the_parked_car_and_end_on_the_road() {
    with_context(vec![car(7, 30.0, 0.0)], |context| {
        let root = root(context, 5.0, 0.0);
        let found = paths(context, &root, 5.0, 40.0, &Settings::default(), &mut EdgeStore::default());
        assert!(found.iter().any(|p| p.blocked_by.is_none()), "no path passes the car");
        assert!(found.windows(2).all(|w| w[0].terms.rank() <= w[1].terms.rank()));
        for path in found.iter().filter(|p| p.blocked_by.is_none()) {
            let end = path.path.at(path.path.length()).pose;
            assert_eq!(context.world.start_overlap(&end, 0.0), None);
        }
    });
}

/// Brute force: the cheapest free chain to each end node over all chains, with every edge checked.
struct AllChains<'a> {
    context: &'a LatticeContext<'a>,
    root: &'a Root,
    layers: Vec<Layer>,
    settings: &'a Settings,
    best: BTreeMap<usize, f64>,
    tried: usize,
}

impl AllChains<'_> {
    fn extend(&mut self, layer: usize, from: Option<usize>, cost: f64) {
        let (context, settings) = (self.context, self.settings);
        let targets = match from {
            Some(_) => layer..(layer + 1).min(self.layers.len()),
            None => 0..settings.root_layers.min(self.layers.len()),
        };
        let counts: Vec<usize> = self.layers.iter().map(|layer| layer.nodes.len()).collect();
        for (to_layer, j) in targets.flat_map(|l| (0..counts[l]).map(move |j| (l, j))) {
            let Layer { station, nodes, .. } = self.layers[to_layer].clone();
            let to = (station, &nodes[j], j);
            let (edge, before) = match from {
                None => {
                    let begins = context.reference.project(self.root.pose.position).s;
                    (
                        Edge::from_root(context, (begins, self.root), to, settings),
                        KeptPrefix::root(context, self.root, &settings.weights),
                    )
                }
                Some(i) => {
                    let before = &self.layers[to_layer - 1];
                    let steep = (before.nodes[i].offset - nodes[j].offset).abs() / (station - before.station);
                    if steep > settings.max_slope {
                        continue;
                    }
                    let from = (before.station, &before.nodes[i]);
                    (Edge::between(context, from, to, settings), KeptPrefix::EMPTY)
                }
            };
            let Ok(edge) = edge else { continue };
            let checked = edge.check(context, &before, settings);
            self.tried += 1;
            if checked.blocked_by.is_some() || edge.ends_chain {
                continue;
            }
            let cost = cost + checked.terms.total() + edge.curve_slowdown(context, &settings.weights);
            if to_layer + 1 == self.layers.len() {
                let best = self.best.entry(j).or_insert(f64::INFINITY);
                *best = best.min(cost);
            } else {
                self.extend(to_layer + 1, Some(j), cost);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]
    /// On small lattices with random cars: every free path is the cheapest to its node, the first one is the cheapest of
    /// all, and there are free paths if and only if brute force has some.
    #[test]
    fn lazy_search_agrees_with_brute_force(
        cars in prop::collection::vec((18.0..70.0_f64, -1.5..5.0_f64), 0..4),
        offset in -0.6..1.2_f64,
        headings in prop::sample::select(vec![vec![0.0], vec![-0.08, 0.08]]),
        target in prop::option::of((20.0..60.0_f64, -1.5..1.5_f64, -0.1..0.1_f64)),
    ) {
        let obstacles = cars.iter().enumerate().map(|(i, (x, y))| car(i as i64, *x, *y)).collect();
        let settings = Settings {
            offset_spacing: 1.0, offset_limit: if headings.len() > 1 { 1.0 } else { 2.0 }, headings, ..Settings::default()
        };
        // blocked chains that meet the target do not take the places of all free ones
        let weights = Weights { missed_target: 2.0, ..Weights::default() };
        let settings = Settings { weights, ..settings };
        let mut failure = None;
        with_context(obstacles, |context| {
            let root = root(context, 4.0, offset);
            let target = target.map(|(station, l, h)| {
                Target { station, offsets: (l, l + 0.8), headings: (h, h + 0.1), ahead: 1.4 }
            });
            let context = &LatticeContext { target, ..*context };
            let layers = layers::ahead(context, 4.0, 9.5, 60.0, &settings);
            let found = search(context, &root, 9.5, 60.0, &settings, &mut EdgeStore::default());
            assert_complete(&found.counts);
            let mut store = EdgeStore::default();
            let store = store.of(&context.margins);
            let eager = search::Search::new(context, &root, layers.clone(), 60.0, &settings, store);
            let eager = eager.run_eagerly();
            assert_eq!(eager.counts.unchecked, 0);
            assert_eq!(summary(&found.paths), summary(&eager.paths), "blocked chains included");
            assert!((1..=4).contains(&layers.len()), "{layers:?}");
            let last = layers[layers.len() - 1].clone();
            let best = BTreeMap::new();
            let mut all = AllChains { context, root: &root, layers, settings: &settings, best, tried: 0 };
            all.extend(0, None, 0.0);
            let missing = |p: &LatticePath| settings.weights.progress_shortfall * (60.0 - p.free_length).max(0.0);
            let free: Vec<&LatticePath> = found.paths.iter().filter(|p| p.blocked_by.is_none()).collect();
            let ends: Vec<f64> = free.iter().map(|p| p.terms.total() - missing(p)).collect();
            let cheapest = all.best.values().copied().fold(f64::INFINITY, f64::min);
            if free.is_empty() != all.best.is_empty() {
                failure = Some(format!("{} free paths, brute force {:?}", free.len(), all.best));
            }
            for (path, cost) in free.iter().zip(&ends) {
                let of_node = all.best.iter().filter(|(j, _)| last.nodes[**j].offset == path.end_offset);
                if !of_node.into_iter().any(|(_, best)| (best - cost).abs() < 1e-6) {
                    failure = Some(format!("{cost} to offset {}, brute force {:?}", path.end_offset, all.best));
                }
            }
            // lengths, and with them the progress shortfall, differ slightly between end nodes
            if let Some(first) = ends.first() && *first > cheapest + settings.weights.progress_shortfall * 1.0 {
                failure = Some(format!("first is {first}, the cheapest {cheapest}"));
            }
        });
        prop_assert!(failure.is_none(), "{failure:?}");
    }
}

#[test]
fn results_are_equal_to_the_bit_for_every_number_of_threads() {
    with_context(vec![car(7, 30.0, 0.0), car(8, 60.0, 3.0)], |context| {
        let found = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let root = root(context, 5.0, 0.2);
            let found =
                pool.install(|| search(context, &root, 8.0, 70.0, &Settings::default(), &mut EdgeStore::default()));
            let numbers: Vec<u64> = found
                .paths
                .iter()
                .flat_map(|p| {
                    let spirals = p.path.pieces().flat_map(|(s, _, spiral)| {
                        spiral.knots.into_iter().chain([s, spiral.length]).collect::<Vec<_>>()
                    });
                    spirals.chain([p.terms.total(), p.free_length]).map(f64::to_bits).collect::<Vec<_>>()
                })
                .collect();
            (numbers, found.counts)
        };
        let one = found(1);
        assert!(one.0.len() > 100);
        for threads in [1, 2, 5] {
            assert!(found(threads) == one, "{threads} threads differ from one");
        }
    });
}

#[test]
fn shared_edges_are_computed_once() {
    with_context(vec![car(7, 40.0, 0.0)], |context| {
        let (settings, mut store) = (Settings::default(), EdgeStore::default());
        let found = search(context, &root(context, 5.0, 0.0), 8.0, 70.0, &settings, &mut store);
        let mut distinct: Vec<*const Sweep> = found.paths.iter().flat_map(|p| &p.sweeps).map(Arc::as_ptr).collect();
        let used = distinct.len();
        distinct.sort_unstable();
        distinct.dedup();
        assert!(distinct.len() < used, "paths share no edge: {used} edges");
        // the same piece of road is the same sweep
        let pieces = |p: &LatticePath| -> Vec<(Pose, CubicSpiral)> {
            p.path.pieces().map(|(_, start, spiral)| (*start, *spiral)).collect()
        };
        for (a, b) in found.paths.iter().flat_map(|a| found.paths.iter().map(move |b| (a, b))) {
            for (i, (start, spiral)) in pieces(a).iter().enumerate() {
                let same = pieces(b).iter().position(|(s, sp)| sp == spiral && s.position == start.position);
                if let Some(j) = same {
                    assert!(Arc::ptr_eq(&a.sweeps[i], &b.sweeps[j]), "the same edge was swept twice");
                }
            }
        }
        assert_complete(&found.counts);
        let counts = &found.counts;
        assert_eq!(counts.swept, counts.free + counts.obstacle + counts.road_edge, "an edge was checked twice");
        assert!(counts.unchecked > 80, "not lazy: {counts:?}");
        // slightly farther ahead, only the edges from the root are new
        let next = search(context, &root(context, 5.3, 0.0), 8.0, 70.0, &settings, &mut store);
        assert!(next.counts.solved <= settings.root_layers * nodes(&settings).len(), "{:?}", next.counts);
        assert!(next.counts.swept < counts.swept, "{:?} after {counts:?}", next.counts);
    });
}

/// A root at the end of a kept arc of 6 m.
fn kept_root(context: &LatticeContext<'_>) -> Root {
    let start = context.reference.offset_pose(5.0, 0.0).unwrap().pose;
    let kept = CubicSpiral { knots: [0.01; 4], length: 6.0 };
    let end = kept.point_at(&start, kept.length);
    Root { pose: end.pose, curvature: end.curvature, kept: vec![kept], start, allowance: Allowance::NONE }
}

#[test]
fn the_kept_prefix_is_swept_once_and_starts_every_path() {
    with_context(vec![car(7, 40.0, 0.0)], |context| {
        let found =
            search(context, &kept_root(context), 8.0, 60.0, &Settings::default(), &mut EdgeStore::default()).paths;
        assert!(found.len() > 3);
        for path in &found {
            assert!(Arc::ptr_eq(&path.sweeps[0], &found[0].sweeps[0]));
            assert_eq!(path.sweeps.len(), path.path.pieces().count());
            let swept: f64 = path.sweeps.iter().map(|s| s.stations().last().unwrap()).sum();
            assert!((swept - path.path.length()).abs() < 1e-9, "{swept} m swept of {} m", path.path.length());
            if path.blocked_by.is_none() {
                assert!((path.free_length - path.path.length()).abs() < 1e-9);
            }
        }
    });
}

#[test]
fn a_blocked_kept_prefix_blocks_every_path() {
    // front bumper at 5 + 3.7 m: 2 m of the kept prefix are free
    with_context(vec![standing(3, Pose::new(11.3, 0.0, 0.0), 0.5, 3.0)], |context| {
        let found =
            search(context, &kept_root(context), 8.0, 60.0, &Settings::default(), &mut EdgeStore::default()).paths;
        assert!(!found.is_empty());
        for path in found {
            assert_eq!(path.blocked_by, Some(Blocker::Obstacle(3)));
            assert!((0.5..4.0).contains(&path.free_length), "{} m free", path.free_length);
        }
    });
}

#[test]
fn counts_explain_a_lattice_without_edges() {
    with_context(vec![], |context| {
        // beside the line, with a different heading and almost no steering: no edge reaches a node
        let context = LatticeContext { max_curvature: 1e-4, ..*context };
        let mut root = root(&context, 5.0, 0.3);
        root.pose.yaw += 0.1;
        root.start = root.pose;
        let found = search(&context, &root, 8.0, 60.0, &Settings::default(), &mut EdgeStore::default());
        let counts = &found.counts;
        assert_complete(counts);
        assert!(found.paths.is_empty());
        assert!(counts.off_road > 0, "nodes to the right of the road: {counts:?}");
        assert!(counts.curvature_bound > 10 && counts.curvature_bound == counts.tried - counts.off_road, "{counts:?}");
        // a root that points backwards needs detours
        root.pose.yaw += 2.0;
        root.start = root.pose;
        let context = LatticeContext { max_curvature: 1.0, ..context };
        let found = search(&context, &root, 8.0, 60.0, &Settings::default(), &mut EdgeStore::default());
        assert!(found.counts.detour + found.counts.no_spiral > 10, "{:?}", found.counts);
        assert_complete(&found.counts);
    });
}

#[test]
fn counts_name_the_wall_that_blocks_all_paths() {
    with_context(vec![standing(5, Pose::new(50.0, 1.75, 0.0), 1.0, 12.0)], |context| {
        let root = root(context, 5.0, 0.0);
        let found = search(context, &root, 8.0, 70.0, &Settings::default(), &mut EdgeStore::default());
        assert_complete(&found.counts);
        // some paths leave the road before the wall
        assert!(found.paths.iter().all(|p| p.blocked_by.is_some()));
        assert_eq!(found.paths[0].blocked_by, Some(Blocker::Obstacle(5)));
        assert_eq!(found.counts.by_obstacle.keys().copied().collect::<Vec<_>>(), [5]);
        assert!(found.counts.obstacle > 10 && found.counts.free > 0, "{:?}", found.counts);
    });
}

#[test]
fn the_end_of_the_road_has_no_paths_and_no_counts() {
    with_context(vec![], |context| {
        let end = context.reference.length();
        let found =
            search(context, &root(context, end - 0.5, 0.0), 8.0, 70.0, &Settings::default(), &mut EdgeStore::default());
        assert!(found.paths.is_empty());
        assert_eq!(found.counts, EdgeCounts::default());
    });
}

#[test]
fn more_headings_never_increase_the_lowest_cost() {
    with_context(vec![car(7, 32.0, 0.3), car(8, 52.0, 3.4)], |context| {
        let best = |headings: Vec<f64>| {
            let settings = Settings { headings, ..Settings::default() };
            paths(context, &root(context, 5.0, 0.0), 8.0, 70.0, &settings, &mut EdgeStore::default())[0].terms.total()
        };
        let (one, three) = (best(vec![0.0]), best(vec![-0.1, 0.0, 0.1]));
        assert!(three <= one + 1e-9, "{three} instead of {one}");
    });
}
