//! The coarse-to-fine check agrees with a slow one, written here: every cell against every obstacle and every segment of the
//! boundary; and the hits inside a cell agree with dense sampling.

use stopline::collision::drivable::INFLATION;
use stopline::collision::{Allowance, Blocker, CollisionSettings, Margins, SafetyMargins, Sweep};
use stopline::geometry::spiral::CubicSpiral;
use stopline::geometry::{Point, Pose, Vector};
use stopline::map::ConvexPart;
use stopline::trajectory::Path;

use crate::helpers::{World, dense, distance, footprint, inflated};
use crate::random::{Random, RandomMap};

/// Random settings: spacings, margins and allowances all vary.
fn settings(random: &mut Random) -> CollisionSettings {
    let spacing = [0.1, 0.1, 0.5, 1.0, 2.0][random.within(0.0, 5.0) as usize];
    let SafetyMargins { static_obstacles, moving_obstacles, road } = margins(random);
    CollisionSettings { spacing, static_obstacles, moving_obstacles, road, ..CollisionSettings::default() }
}

fn margins(random: &mut Random) -> SafetyMargins {
    let mut margins = || Margins { lateral: random.within(0.0, 0.5), longitudinal: random.within(0.0, 0.5) };
    let (static_obstacles, moving_obstacles) = (margins(), margins());
    SafetyMargins { static_obstacles, moving_obstacles, road: random.within(0.0, 0.3) }
}

fn allowance(random: &mut Random) -> Allowance {
    let mut until = || if random.next() < 0.7 { f64::NEG_INFINITY } else { random.within(-1.0, 15.0) };
    let (reduced_until, no_road_until) = (until(), until());
    let mut share = || [0.0, 0.25, 1.0][random.within(0.0, 3.0) as usize];
    Allowance { reduced_until, to_obstacles: share(), to_road: share(), no_road_until }
}

/// The pieces of the world: static obstacles in order of their ids, then the segments of the boundary.
struct Pieces(Vec<(Blocker, ConvexPart, Disc)>);

/// A disc around a set of points, to skip what is far away.
struct Disc {
    centre: Point,
    radius: f64,
}

impl Disc {
    fn around(points: &[Point]) -> Self {
        let centre = Point::from(points.iter().map(|p| p.coords).sum::<Vector>() / points.len() as f64);
        Self { centre, radius: points.iter().map(|p| (p - centre).norm()).fold(0.0, f64::max) }
    }

    fn of(part: &ConvexPart) -> Self {
        match part {
            ConvexPart::Polygon(points) => Self::around(points),
            ConvexPart::Circle { centre, radius } => Self { centre: *centre, radius: *radius },
        }
    }

    fn gap(&self, other: &Self) -> f64 {
        (self.centre - other.centre).norm() - self.radius - other.radius
    }
}

impl Pieces {
    fn new(map: &RandomMap, world: &World) -> Self {
        let mut obstacles: Vec<_> = map.scenario.obstacles.iter().collect();
        obstacles.sort_by_key(|o| o.id);
        let parts =
            obstacles.into_iter().flat_map(|o| o.occupied_at(0.0).into_iter().map(|p| (Blocker::Obstacle(o.id), p)));
        let rings = world.statics().road().rings().flat_map(|ring| {
            let next: Vec<Point> = ring.iter().skip(1).chain(ring.first()).copied().collect();
            ring.into_iter()
                .zip(next)
                .map(|(a, b)| (Blocker::RoadBoundary, ConvexPart::Polygon(vec![a, b])))
                .collect::<Vec<_>>()
        });
        Self(parts.chain(rings).map(|(what, part)| (what, part.clone(), Disc::of(&part))).collect())
    }

    /// The first piece within `by` of a polygon that `counts`.
    fn first(&self, polygon: &[Point], by: f64, counts: impl Fn(Blocker) -> bool) -> Option<Blocker> {
        let around = Disc::around(polygon);
        let touches = |part: &ConvexPart, disc: &Disc| around.gap(disc) <= by && distance(polygon, part) <= by;
        self.0.iter().find(|(what, part, disc)| counts(*what) && touches(part, disc)).map(|(what, ..)| *what)
    }
}

/// The margins to the boundary of the road surface, which is inflated.
fn to_boundary(margins: &SafetyMargins) -> Margins {
    Margins::uniform(margins.road + INFLATION * std::f64::consts::SQRT_2)
}

fn is_obstacle(what: Blocker) -> bool {
    what != Blocker::RoadBoundary
}

/// What each cell meets as a whole.
fn flat(pieces: &Pieces, world: &World, sweep: &Sweep, path: &Path, allowance: &Allowance) -> Vec<Option<Blocker>> {
    // only cells that end within the allowance are excused
    let excused = sweep.stations().iter().take_while(|s| **s <= allowance.no_road_until).count();
    let is_within = sweep.stations()[sweep.cells()] < allowance.no_road_until;
    let first_checked = Some(excused.saturating_sub(1)).filter(|_| !is_within);
    let is_on_road = |limit: usize| world.statics().road().contains(path.at(sweep.stations()[limit]).pose.position);
    let off_road = first_checked.filter(|limit| !is_on_road(*limit)).map(|limit| limit.min(sweep.cells() - 1));
    let in_cell = |cell: usize| {
        let leaves = sweep.stations()[cell + 1];
        let first = |margins: Margins, share: f64, counts: fn(Blocker) -> bool| {
            let margins = if leaves <= allowance.reduced_until { margins.scaled(share) } else { margins };
            sweep.part_footprints(cell, &margins).iter().find_map(|hull| pieces.first(hull, 0.0, counts))
        };
        let obstacle = first(world.margins.static_obstacles, allowance.to_obstacles, is_obstacle);
        let checks_road = leaves > allowance.no_road_until;
        let edge =
            || first(to_boundary(&world.margins), allowance.to_road, |what| !is_obstacle(what)).filter(|_| checks_road);
        obstacle.or_else(edge).or_else(|| off_road.filter(|limit| *limit == cell).map(|_| Blocker::RoadBoundary))
    };
    (0..sweep.cells()).map(in_cell).collect()
}

/// Obstacle and boundary hits, in first and later cells, and free paths; with one and two pieces. Cells of a tenth of a metre are
/// not divided, so that the result is that of the slow check; of longer ones, a hit lies in a cell that the slow check stops.
#[test]
fn coarse_to_fine_and_flat_agree() {
    let mut random = Random::new(5);
    let mut seen = [0; 4];
    for objects in [0, 1, 10, 40].into_iter().cycle().take(60) {
        let map = RandomMap::new(&mut random, objects);
        let settings = settings(&mut random);
        let world = map.world(&settings);
        let pieces = Pieces::new(&map, &world);
        for _ in 0..60 {
            let (start, allowance) = (map.start(&mut random), allowance(&mut random));
            let spirals: Vec<_> = (0..random.within(1.0, 3.0) as usize)
                .map(|_| {
                    let max_curvature = if random.next() < 0.5 { 0.03 } else { 0.25 };
                    random.spiral(max_curvature, (0.05, 40.0))
                })
                .collect();
            let path = Path::new(start, &spirals).unwrap();
            let sweep = world.sweep_path(&path);
            let mut probe = world.probe_path(&path);
            assert_eq!(probe.cells(), sweep.cells());
            // in both orders: the first query must not change the result of the second
            let cap = random.within(0.1, 3.0);
            let before = (random.next() < 0.5).then(|| probe.clearance(cap));
            let hit = probe.static_hit(&world.margins, &allowance);
            let clearance = probe.clearance(cap);
            assert!(before.is_none_or(|before| before == clearance), "{start:?} {spirals:?}");
            let cells = flat(&pieces, &world, &sweep, &path, &allowance);
            let first = cells.iter().position(Option::is_some);
            match hit {
                Some(hit) if settings.spacing == 0.1 => {
                    assert_eq!(
                        (Some(hit.cell), Some(hit.what)),
                        (first, cells[hit.cell]),
                        "{start:?} {spirals:?} {allowance:?}"
                    );
                    assert_eq!(hit.station, sweep.stations()[hit.cell]);
                }
                Some(hit) => {
                    assert!(cells[hit.cell].is_some(), "{hit:?} of {start:?} {spirals:?} {allowance:?}");
                    let within = sweep.stations()[hit.cell]..sweep.stations()[hit.cell + 1];
                    assert!(within.contains(&hit.station), "{hit:?} outside {within:?}");
                }
                None => assert!(first.is_none() || settings.spacing > 0.1, "{start:?} {spirals:?} {allowance:?}"),
            }
            let expected = slow_clearance(&pieces, &sweep, &path, cap);
            assert!((clearance.obstacle - expected.0).abs() < 1e-6 && (clearance.road - expected.1).abs() < 1e-6);
            seen[match hit {
                None => 0,
                Some(hit) if hit.cell == 0 => 1,
                Some(hit) if hit.what == Blocker::RoadBoundary => 2,
                Some(_) => 3,
            }] += 1;
        }
    }
    println!("free {}, hit in the first cell {}, road {}, obstacle {}", seen[0], seen[1], seen[2], seen[3]);
    assert!(seen.iter().all(|n| *n > 200), "too few samples of a kind: {seen:?}");
}

/// The distances at every fourth cell limit and at the last one.
fn slow_clearance(pieces: &Pieces, sweep: &Sweep, path: &Path, cap: f64) -> (f64, f64) {
    let mut least = (cap, cap);
    let stations = sweep.stations();
    for station in stations.iter().step_by(4).chain(stations.last()) {
        let body = footprint(&path.at(*station).pose);
        let around = Disc::around(&body);
        for (what, part, disc) in &pieces.0 {
            let least = if is_obstacle(*what) { &mut least.0 } else { &mut least.1 };
            if around.gap(disc) < *least {
                *least = least.min(distance(&body, part));
            }
        }
    }
    least
}

/// The station of a hit is not behind the first contact of poses every 2 cm, and within a subcell of it there is a contact of the
/// vehicle with its margins and the excess of a subcell.
#[test]
fn hits_agree_with_dense_sampling_to_a_tenth_of_a_metre() {
    /// Largest excess of the footprint of a subcell, m.
    const EXCESS: f64 = 0.03;
    let mut random = Random::new(17);
    let (mut hits, mut later) = (0, 0);
    for _ in 0..150 {
        let map = RandomMap::new(&mut random, 12);
        let world = map.world(&CollisionSettings::default());
        let pieces = Pieces::new(&map, &world);
        for _ in 0..12 {
            let (start, margins) = (map.start(&mut random), margins(&mut random));
            let spiral = random.spiral(0.2, (1.0, 25.0));
            let touches = |pose: &Pose, by: f64| {
                let obstacle = pieces.first(&inflated(pose, &margins.static_obstacles), by, is_obstacle);
                obstacle
                    .or_else(|| pieces.first(&inflated(pose, &to_boundary(&margins)), by, |what| !is_obstacle(what)))
            };
            if touches(&start, EXCESS).is_some() || !world.statics().road().contains(start.position) {
                continue;
            }
            let hit = world.probe(&start, &spiral).static_hit(&margins, &Allowance::NONE);
            let poses = dense(&start, &spiral, 0.02);
            let truth = poses.iter().find_map(|(s, pose)| Some((*s, touches(pose, 0.0)?)));
            if let Some((s, what)) = truth {
                assert!(
                    hit.is_some_and(|hit| hit.station <= s),
                    "{what:?} at {s}, {hit:?} of {start:?} {spiral:?} {margins:?}"
                );
            }
            let Some(hit) = hit else { continue };
            hits += 1;
            let near = poses.iter().filter(|(s, _)| (hit.station - 0.01..hit.station + 0.12).contains(s));
            assert!(
                near.map(|(_, pose)| pose).any(|pose| touches(pose, EXCESS).is_some()),
                "no contact within 0.1 m of {hit:?}, truth {truth:?}, {start:?} {spiral:?} {margins:?}"
            );
            later += usize::from(world.sweep(&start, &spiral).stations()[hit.cell] < hit.station);
        }
    }
    println!("{hits} hits, {later} of them inside a cell");
    assert!(hits > 500 && later > hits / 2, "too few samples: {hits} hits, {later} inside a cell");
}

/// Straight ahead the last free station is known in closed form.
#[test]
fn a_wall_ahead_is_approached_to_a_tenth_of_a_metre() {
    use crate::helpers::{obstacle, plain, scenario, straight, vehicle, world};
    use stopline::map::{Motion, Shape};
    let front = vehicle().front_overhang_from_rear_axle();
    for i in 0..40 {
        let face = 20.0 + 0.05 * f64::from(i);
        let wall = obstacle(7, Shape::rectangle(1.0, 6.0), Motion::Static(Pose::new(face + 0.5, 0.0, 0.0)));
        let world = world(&scenario(plain(), vec![wall]), &CollisionSettings::default());
        let spiral: CubicSpiral = straight(30.0);
        let hit = world.hit(&Pose::new(0.0, 0.0, 0.0), &spiral).unwrap();
        let last_free = face - front - 0.2;
        assert!((last_free - 0.1 - 1e-5..=last_free).contains(&hit.station), "{hit:?}, expected {last_free}");
    }
}
