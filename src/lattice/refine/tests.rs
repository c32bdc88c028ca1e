use super::*;
use crate::collision::CollisionSettings;
use crate::fixtures;
use crate::geometry::polyline::Polyline;
use crate::geometry::spiral::connect;
use crate::map::{Lanelet, RoadNetwork, Scenario};
use crate::reference::{ReferenceLine, ReferenceSettings};

/// One wide lane along an arc with parked cars.
struct Scene {
    /// Start of the lane.
    frame: Pose,
    /// Curvature of the lane, 1/m.
    bend: f64,
    /// Stations and offsets of parked cars, m.
    cars: Vec<(f64, f64)>,
    /// Sign of offsets and curvature: −1 for the mirror image.
    side: f64,
}

/// Two parked cars, passed on the left and on the right.
const CARS: [(f64, f64); 2] = [(30.0, -1.0), (62.0, 1.0)];
/// Stations and offsets of the nodes of a path between them.
const SLALOM: [(f64, f64); 6] = [(0.0, 0.3), (20.0, 1.2), (36.0, 1.2), (54.0, -1.2), (70.0, -1.2), (95.0, 0.0)];
/// From the rear axle to the front bumper of the car used here, m.
const FRONT: f64 = 3.7;

impl Scene {
    fn slalom() -> Self {
        Self { frame: Pose::new(3.0, -7.0, 0.4), bend: 0.004, cars: CARS.to_vec(), side: 1.0 }
    }

    fn mirrored(self) -> Self {
        let frame = Pose::new(self.frame.position.x, -self.frame.position.y, -self.frame.yaw);
        Self { frame, side: -self.side, ..self }
    }

    fn moved(self, x: f64, y: f64) -> Self {
        let at = self.frame.position;
        Self { frame: Pose::new(at.x + x, at.y + y, self.frame.yaw), ..self }
    }

    fn empty(self) -> Self {
        Self { cars: vec![], ..self }
    }

    /// The pose at a station with offset `l` to the left (in the mirror image, to the right).
    fn at(&self, s: f64, l: f64) -> Pose {
        let arc = CubicSpiral { knots: [self.side * self.bend; 4], length: 200.0 };
        let on_line = arc.point_at(&self.frame, s).pose;
        Pose { position: on_line.position + on_line.left() * (self.side * l), yaw: on_line.yaw }
    }

    fn network(&self) -> RoadNetwork {
        const HALF_WIDTH: f64 = 4.5;
        let line =
            |l: f64| Polyline::new((0..=160).map(|i| self.at(f64::from(i) - 20.0, self.side * l).position)).unwrap();
        let bounded = fixtures::lanelet(1, line(-HALF_WIDTH), line(HALF_WIDTH));
        fixtures::network([Lanelet { centre: line(0.0), ..bounded }])
    }

    fn scenario(&self) -> Scenario {
        let car = |(id, &(s, l)): (i64, &(f64, f64))| fixtures::parked(id, self.at(s, l), 4.5, 1.8);
        fixtures::scenario(self.network(), (10..).zip(&self.cars).map(car).collect())
    }

    fn with_context<T>(&self, test: impl FnOnce(&LatticeContext<'_>) -> T) -> T {
        let scenario = self.scenario();
        let vehicle = crate::vehicle::load("bmw_320i").unwrap();
        let reference = ReferenceLine::new(&scenario.network, &[1], vehicle.width, &ReferenceSettings::default());
        let world = fixtures::collision_world(&scenario, &vehicle, &CollisionSettings::default(), 5.0);
        let (max_curvature, half_width) = (vehicle.max_curvature(), 0.5 * vehicle.width);
        // 11 m/s at the comfortable lateral acceleration
        let full_speed_curvature = 3.0 / 121.0;
        test(&LatticeContext {
            reference: &reference.unwrap(),
            world: &world,
            margins: CollisionSettings::default().margins(),
            max_curvature,
            full_speed_curvature,
            half_width,
            target: None,
        })
    }

    /// The lattice path through nodes.
    fn path(&self, context: &LatticeContext<'_>, nodes: &[(f64, f64)]) -> LatticePath {
        let node = |(s, l): (f64, f64)| {
            let shrink = 1.0 - self.bend * l;
            (self.at(s, l), self.side * self.bend / shrink)
        };
        let start = node(nodes[0]).0;
        let spirals: Vec<CubicSpiral> = nodes
            .windows(2)
            .map(|ends| {
                let ((from, k0), (to, k1)) = (node(ends[0]), node(ends[1]));
                let local = Pose { position: from.to_local(to.position), yaw: to.yaw - from.yaw };
                connect(k0, &local, k1).unwrap()
            })
            .collect();
        let path = Path::new(start, &spirals).unwrap();
        let blank = LatticePath {
            free_length: path.length(),
            path,
            kept: 0,
            sweeps: vec![],
            blocked_by: None,
            terms: CostTerms { progress_shortfall: 5.0, ..CostTerms::default() },
            end_offset: nodes[nodes.len() - 1].1,
            first_offset: nodes[1].1,
        };
        let weights = Weights::default();
        let (commitment, allowance) = (Commitment::default(), Allowance::NONE);
        let problem = Refinement::of(context, &blank, &allowance, &weights, &commitment).unwrap();
        let evaluated = problem.evaluated(&Chain::of(&spirals).unwrap()).expect("the path must be free");
        let sweeps =
            blank.path.pieces().map(|(_, start, spiral)| Arc::new(context.world.sweep(start, spiral))).collect();
        LatticePath { terms: blank.terms.plus(&evaluated.terms), sweeps, ..blank }
    }
}

fn refine(context: &LatticeContext<'_>, path: &LatticePath, settings: &RefinementSettings) -> Option<LatticePath> {
    let (weights, none) = (Weights::default(), Commitment::default());
    refined(context, path, &Allowance::NONE, FRONT, &weights, &none, settings)
}

fn energy(path: &Path) -> f64 {
    path.pieces().map(|(_, _, spiral)| spiral.bending_energy()).sum()
}

fn spirals(path: &Path) -> Vec<CubicSpiral> {
    path.pieces().map(|(_, _, spiral)| *spiral).collect()
}

/// The original and the refined path of the slalom.
fn slalom(scene: &Scene) -> (LatticePath, LatticePath) {
    scene.with_context(|context| {
        let path = scene.path(context, &SLALOM);
        let better = refine(context, &path, &RefinementSettings::default()).expect("the slalom can be improved");
        (path, better)
    })
}

#[test]
fn refinement_reduces_cost_and_bending_energy_and_preserves_the_ends() {
    let (path, better) = slalom(&Scene::slalom());
    println!(
        "cost {:.3} to {:.3}, energy {:.5} to {:.5}",
        path.terms.total(),
        better.terms.total(),
        energy(&path.path),
        energy(&better.path)
    );
    assert!(better.terms.total() < 0.9 * path.terms.total());
    assert!(energy(&better.path) < 0.8 * energy(&path.path));
    assert_eq!(better.terms.progress_shortfall, path.terms.progress_shortfall);
    assert_eq!(better.free_length, better.path.length());
    assert_eq!(better.sweeps.len(), 5);
    let ends = |p: &Path| (p.at(0.0), p.at(p.length()));
    let ((start, end), (new_start, new_end)) = (ends(&path.path), ends(&better.path));
    assert_eq!((start.pose, start.curvature), (new_start.pose, new_start.curvature));
    assert!((end.pose.position - new_end.pose.position).norm() < 1e-9);
    assert!((end.pose.yaw - new_end.pose.yaw).abs() < 1e-9);
    assert!((end.curvature - new_end.curvature).abs() < 1e-12);
    for pair in spirals(&better.path).windows(2) {
        assert_eq!(pair[0].knots[3], pair[1].knots[0], "curvature must not jump at a joint");
    }
}

#[test]
fn the_terms_of_the_refined_path_agree_with_the_lattice() {
    Scene::slalom().with_context(|context| {
        // 20 m/s at the comfortable lateral acceleration: too fast for the slalom
        let context = &LatticeContext { full_speed_curvature: 3.0 / 400.0, ..*context };
        let path = Scene::slalom().path(context, &SLALOM);
        let better = refine(context, &path, &RefinementSettings::default()).unwrap();
        let weights = Weights::default();
        let mut sum = CostTerms { progress_shortfall: 5.0, ..CostTerms::default() };
        for (_, start, spiral) in better.path.pieces() {
            let ends = [*start, spiral.end(start)].map(|p| context.reference.project(p.position).s);
            let (least, curvatures) = unchecked_terms(context, start, spiral, ends.into(), &weights);
            sum = sum.plus(&checked(context, (start, spiral), &least, &KeptPrefix::EMPTY, &weights).terms);
            sum.curve_slowdown +=
                weights.curve_slowdown * curvatures.curve_slowdown(spiral.length, context.full_speed_curvature);
        }
        assert!(sum.curve_slowdown > 0.0, "the slalom must be too tight for the speed somewhere");
        assert!((sum.total() - better.terms.total()).abs() < 1e-9, "{sum:?} {:?}", better.terms);
    });
}

#[test]
fn every_pose_respects_the_margins_and_the_corridor() {
    for limit in [0.15, 0.5] {
        let scene = Scene::slalom();
        scene.with_context(|context| {
            let path = scene.path(context, &SLALOM);
            let settings = RefinementSettings { corridor: limit, ..RefinementSettings::default() };
            let better = refine(context, &path, &settings).unwrap();
            let line = Polyline::new(path.path.sampled(0.05).into_iter().map(|(_, p)| p.pose.position)).unwrap();
            for (_, point) in better.path.sampled(0.05) {
                let mut here = context.world.probe(&point.pose, &CubicSpiral::straight(0.001));
                assert_eq!(here.static_hit(&context.margins, &Allowance::NONE), None, "at {:?}", point.pose);
                // the linearisation has an error of some centimetres
                let offset = line.project(point.pose.position).offset;
                assert!(offset.abs() < limit + 0.05, "{offset} of {limit} at {:?}", point.pose);
            }
        });
    }
}

/// A passage so narrow that both margins are touched: refinement must not violate them.
#[test]
fn a_narrow_passage_keeps_its_margins() {
    let nodes = [(0.0, 1.5), (24.0, 0.0), (36.0, 0.0), (62.0, 1.5), (90.0, 0.0)];
    // half the width of the car, half that of the vehicle, the margin, and two centimetres
    let beside = 0.9 + 0.805 + 0.2 + 0.02;
    let scene = Scene { cars: vec![(32.0, beside), (32.0, -beside)], bend: 0.0, ..Scene::slalom() };
    scene.with_context(|context| {
        let path = scene.path(context, &nodes);
        let better = refine(context, &path, &RefinementSettings::default()).unwrap_or_else(|| path.clone());
        assert!(better.terms.total() <= path.terms.total());
        for (_, point) in better.path.sampled(0.05) {
            let mut here = context.world.probe(&point.pose, &CubicSpiral::straight(0.001));
            assert_eq!(here.static_hit(&context.margins, &Allowance::NONE), None);
        }
    });
}

#[test]
fn a_corridor_without_width_and_a_single_edge_are_not_refined() {
    let scene = Scene::slalom();
    scene.with_context(|context| {
        let path = scene.path(context, &SLALOM);
        let narrow = RefinementSettings { corridor: 1e-9, ..RefinementSettings::default() };
        assert!(refine(context, &path, &narrow).is_none());
        let weights = Weights::default();
        let (commitment, allowance) = (Commitment::default(), Allowance::NONE);
        let problem = Refinement::of(context, &path, &allowance, &weights, &commitment).unwrap();
        let original = Chain::of(&problem.movable).unwrap();
        assert!(problem.program(&original, FRONT, 0.0).is_none(), "a corridor without width has no program");
        // the last edge of a blocked path is not refined
        let two = scene.path(context, &[(0.0, 0.3), (12.0, 1.6), (30.0, 1.2)]);
        assert!(refine(context, &two, &RefinementSettings::default()).is_some());
        let blocked = LatticePath { blocked_by: Some(crate::collision::Blocker::Obstacle(10)), ..two };
        assert!(refine(context, &blocked, &RefinementSettings::default()).is_none());
    });
}

#[test]
fn a_mirrored_problem_has_the_mirrored_result() {
    let (_, left) = slalom(&Scene::slalom());
    let (_, right) = slalom(&Scene::slalom().mirrored());
    for (a, b) in spirals(&left.path).iter().zip(spirals(&right.path)) {
        assert!((a.length - b.length).abs() < 1e-4, "{a:?} {b:?}");
        assert!(a.knots.iter().zip(&b.knots).all(|(a, b)| (a + b).abs() < 1e-6), "{a:?} {b:?}");
    }
}

#[test]
fn a_translated_map_has_the_same_result() {
    let (_, here) = slalom(&Scene::slalom());
    let (_, there) = slalom(&Scene::slalom().moved(1e6, -2e6));
    for (a, b) in spirals(&here.path).iter().zip(spirals(&there.path)) {
        assert!((a.length - b.length).abs() < 1e-4, "{a:?} {b:?}");
        assert!(a.knots.iter().zip(&b.knots).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} {b:?}");
    }
    assert!((here.terms.total() - there.terms.total()).abs() < 1e-6);
}

/// Edges along a straight lane are as long as their stations are apart, up to the rounding of the map's coordinates.
#[test]
fn the_samples_of_an_edge_between_grid_stations_do_not_depend_on_rounding() {
    for (length, expected) in [(15.0, 12), (30.0, 24), (45.0, 36), (60.0, 48)] {
        for rounding in [-1e-9, 0.0, 1e-9] {
            assert_eq!(intervals(length + rounding), expected, "{length} m");
        }
    }
    assert_eq!((intervals(0.5), intervals(15.01), intervals(29.9)), (6, 18, 24));
}

#[test]
fn an_optimal_path_is_unchanged() {
    let scene = Scene::slalom().empty();
    scene.with_context(|context| {
        let settings = RefinementSettings::default();
        let on_line = scene.path(context, &[(0.0, 0.0), (20.0, 0.0), (50.0, 0.0), (80.0, 0.0)]);
        assert!(refine(context, &on_line, &settings).is_none(), "an arc along the line");
    });
}

/// Refining a refined path gains little and converges to the same path, to the bit.
#[test]
fn repeated_refinement_converges() {
    let scene = Scene::slalom();
    scene.with_context(|context| {
        let settings = RefinementSettings::default();
        let first = refine(context, &scene.path(context, &SLALOM), &settings).unwrap();
        let (mut path, mut rounds) = (first.clone(), 0);
        while let Some(next) = refine(context, &path, &settings) {
            assert!(next.terms.total() < path.terms.total());
            path = next;
            rounds += 1;
            assert!(rounds < 10, "it does not converge");
        }
        let gain = (first.terms.total() - path.terms.total()) / first.terms.total();
        println!("{rounds} more rounds gained {:.2} %", 100.0 * gain);
        assert!(gain < 0.1, "{gain}");
    });
}

#[test]
fn the_cost_of_leaving_the_committed_path_is_included() {
    let scene = Scene::slalom();
    scene.with_context(|context| {
        let path = scene.path(context, &SLALOM);
        let free = refine(context, &path, &RefinementSettings::default()).unwrap();
        let poses = [5.0, 10.0, 20.0, 30.0].map(|d| (d, path.path.at(d).pose)).to_vec();
        let commitment = Commitment { poses, weight: 10.0, max_distance: f64::INFINITY };
        assert!(commitment.cost(&path.path) < 1e-9);
        let (weights, settings) = (Weights::default(), RefinementSettings::default());
        let committed = refined(context, &path, &Allowance::NONE, FRONT, &weights, &commitment, &settings).unwrap();
        let (far, near) = (commitment.cost(&free.path), commitment.cost(&committed.path));
        assert!(near < 0.3 * far, "{near} {far}");
        let total = |p: &LatticePath| p.terms.total() + commitment.cost(&p.path);
        assert!(total(&committed) <= total(&free).min(total(&path)));
    });
}

#[test]
fn respects_an_active_curvature_bound() {
    let scene = Scene { bend: 0.0, ..Scene::slalom() }.empty();
    scene.with_context(|context| {
        let path = scene.path(context, &[(0.0, 2.0), (12.0, 0.5), (24.0, 0.6), (36.0, -1.2), (50.0, 0.0)]);
        let bound = spirals(&path.path).iter().fold(0.0_f64, |m, s| m.max(s.max_abs_curvature()));
        let tight = LatticeContext { max_curvature: 0.5 * bound, ..*context };
        let rate = |p: &Path| spirals(p).iter().fold(0.0_f64, |m, s| m.max(s.max_abs_curvature_rate()));
        let better = refine(&tight, &path, &RefinementSettings::default()).unwrap();
        for spiral in spirals(&better.path) {
            assert!(spiral.max_abs_curvature() <= bound * (1.0 + 1e-9));
        }
        assert!(rate(&better.path) <= rate(&path.path) * (1.0 + 1e-9));
    });
}

/// Smallest bending energy by a slow coordinate search without derivatives: one step of each variable in turn, the end
/// restored, a smaller step without improvement. Unless joints slide, the pieces keep their fractions of the length.
fn coordinate_search(original: &Chain, rate: f64, joints_slide: bool) -> f64 {
    let target = original.end();
    // ∫κ² by the midpoint rule, not in closed form
    let energy = |chain: &Chain| {
        const CELLS: i32 = 200;
        let of = |s: &CubicSpiral| {
            let h = s.length / f64::from(CELLS);
            (0..CELLS).map(|i| h * s.curvature((f64::from(i) + 0.5) * h).powi(2)).sum::<f64>()
        };
        chain.spirals().iter().map(of).sum::<f64>()
    };
    let (mut best, mut least) = (original.clone(), energy(original));
    let inner = original.knots.len() - 2;
    let mut steps = vec![1e-3; inner];
    steps.extend(vec![0.2; original.pieces()]);
    for _ in 0..600 {
        for (i, step) in steps.iter_mut().enumerate() {
            let better = [1.0, -1.0].into_iter().find_map(|side| {
                let mut next = best.clone();
                if i < inner {
                    next.knots[i + 1] += side * *step
                } else {
                    next.lengths[i - inner] += side * *step
                }
                let mut legal = next.restore(&target);
                if !joints_slide {
                    let factor = next.length() / original.length();
                    next.lengths = original.lengths.iter().map(|l| l * factor).collect();
                    // alternate between knots and lengths until both agree
                    legal = (0..8).all(|_| {
                        let back = next.restore(&target);
                        let factor = next.length() / original.length();
                        next.lengths = original.lengths.iter().map(|l| l * factor).collect();
                        back
                    }) && (next.end().position - target.position).norm() < 1e-6;
                }
                legal = legal && next.max_abs_curvature_rate() <= rate;
                let now = if legal { energy(&next) } else { f64::INFINITY };
                (now < least).then_some((next, now))
            });
            match better {
                Some(found) => {
                    (best, least) = found;
                    *step *= 1.6;
                }
                None => *step *= 0.6,
            }
            *step = step.max(1e-9);
        }
    }
    least
}

#[test]
fn a_coordinate_search_improves_by_less_than_a_hundredth() {
    let weights = Weights { offset: 0.0, lane_deviation: 0.0, clearance: 0.0, ..Weights::default() };
    let scene = Scene { bend: 0.0, ..Scene::slalom() }.empty();
    let cases: [&[(f64, f64)]; 3] = [
        &[(0.0, 0.0), (18.0, 0.8), (40.0, 0.5)],
        &[(0.0, 0.5), (15.0, 0.0), (35.0, 0.3)],
        &[(0.0, 0.0), (20.0, 0.4), (36.0, 1.1), (60.0, 1.0)],
    ];
    for nodes in cases {
        scene.with_context(|context| {
            let path = scene.path(context, nodes);
            let settings = RefinementSettings { enabled: true, iterations: 60, corridor: 1.0, min_gain: 1e-4 };
            let start = std::time::Instant::now();
            let none = Commitment::default();
            let better = refined(context, &path, &Allowance::NONE, FRONT, &weights, &none, &settings).unwrap();
            let quick = refined(
                context,
                &path,
                &Allowance::NONE,
                FRONT,
                &weights,
                &none,
                &RefinementSettings { corridor: 1.0, ..RefinementSettings::default() },
            );
            let original = Chain::of(&spirals(&path.path)).unwrap();
            let rate = original.max_abs_curvature_rate().max(RATE_FLOOR);
            let (least, sliding) =
                (coordinate_search(&original, rate, false), coordinate_search(&original, rate, true));
            let found = energy(&better.path);
            println!(
                "{:?}: {:.6} to {found:.6} (by default {:.6}), coordinate search {least:.6}, sliding {sliding:.6}",
                start.elapsed(),
                energy(&path.path),
                quick.map_or(f64::NAN, |q| energy(&q.path))
            );
            assert!(found <= 1.01 * least, "{found}, but {least} is possible");
            // joints move along the path only slowly, with little effect
            let saved = (energy(&path.path) - found) / (energy(&path.path) - sliding);
            assert!(saved > 0.99, "only {saved} of the possible reduction");
        });
    }
}
