//! Speed limits of bends by cell; goals, rules and zones on a path beside its reference line.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use super::*;
use crate::collision::{CollisionSettings, CollisionWorld};
use crate::fixtures::{collision_world, follow, lanelet, line, network, scenario, straight_lanelet, vehicle};
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::reference::ReferenceSettings;
use crate::trajectory::Path;

#[test]
fn widened_intervals_merge_and_do_not_extend_into_the_past() {
    let b = widened(&[(0.5, 1.0), (2.0, 2.5), (6.0, 7.0)], 0.6, 0.4);
    assert_eq!(b, vec![(0.4, 3.1), (5.4, 7.6)]);
}

/// Everything that a situation borrows.
struct Place {
    vehicle: Vehicle,
    settings: Settings,
    world: CollisionWorld,
    reference: ReferenceLine,
}

impl Place {
    /// The reference line of these lanelets of a road, in order.
    fn on(road: crate::map::RoadNetwork, lanelets: &[i64]) -> Self {
        let vehicle = vehicle();
        let reference = ReferenceLine::new(&road, lanelets, vehicle.width, &ReferenceSettings::default()).unwrap();
        let world = collision_world(&scenario(road, Vec::new()), &vehicle, &CollisionSettings::default(), 10.0);
        Self { vehicle, settings: Settings::default(), world, reference }
    }

    /// At a station of the reference line (m), with 8 m/s.
    fn situation<'a>(&'a self, station: f64, goal: Option<GoalOnLane>, no_stopping: &'a [(f64, f64)]) -> Situation<'a> {
        Situation {
            vehicle: &self.vehicle,
            settings: &self.settings,
            traffic: self.world.predictions(),
            margins: Margins::uniform(0.3),
            fine_until: 0.0,
            reference: &self.reference,
            goal,
            goal_missed_at: None,
            station,
            time: 0.0,
            speed: 8.0,
            cruise: CRUISE,
            horizon: 10.0,
            acceleration: 2.0,
            braking: 2.0,
            proof_deceleration: 6.0,
            straight_deceleration: 6.0,
            friction: 1.0,
            search_share: 1.0,
            top_speed: f64::INFINITY,
            long_run: false,
            no_stopping,
            time_gap: 0.0,
            lateral_limit: LATERAL,
        }
    }

    fn path(&self, start: Pose, spirals: &[CubicSpiral]) -> LatticePath {
        let path = Path::new(start, spirals).unwrap();
        LatticePath {
            sweeps: vec![Arc::new(self.world.sweep_path(&path))],
            free_length: path.length(),
            path,
            kept: 0,
            blocked_by: None,
            terms: CostTerms::default(),
            end_offset: 0.0,
            first_offset: 0.0,
        }
    }
}

/// Cruise speed, m/s.
const CRUISE: f64 = 13.0;
/// Lateral acceleration, m/s².
const LATERAL: f64 = 3.0;

/// Cells of 5 m. A bend inside a cell limits both of its nodes, one at an end of a cell only the node there.
#[test]
fn a_bend_inside_a_cell_limits_both_of_its_nodes_and_one_at_its_end_only_that_node() {
    const CURVATURE: f64 = 0.1;
    let place = Place::on(network([straight_lanelet(1, (0.0, 200.0), -20.0, 20.0)]), &[1]);
    let situation = place.situation(5.0, None, &[]);
    let stations: Vec<f64> = (0..=8).map(|i| 5.0 * f64::from(i)).collect();
    let slow = (LATERAL / CURVATURE).sqrt();
    for turn in [-1.0, 1.0] {
        let arc = |length: f64| CubicSpiral { knots: [turn * CURVATURE; 4], length };
        for (from, to, limited) in [
            // inside of one cell
            (11.0, 14.0, &[10.0, 15.0][..]),
            (12.0, 13.0, &[10.0, 15.0]),
            // over a node, and far into the cells on both sides
            (12.0, 18.0, &[10.0, 15.0, 20.0]),
            // from node to node: the cells before and after it are straight
            (15.0, 20.0, &[15.0, 20.0]),
            (15.0, 25.0, &[15.0, 20.0, 25.0]),
            // the last and the first centimetres of a cell
            (14.9, 15.0, &[15.0]),
            (15.0, 15.1, &[15.0]),
            (14.9, 15.1, &[15.0]),
        ] {
            let spirals = [CubicSpiral::straight(from), arc(to - from), CubicSpiral::straight(45.0 - to)];
            let path = place.path(Pose::new(5.0, 0.0, 0.0), &spirals);
            let cells = PathCells {
                blocked: vec![Vec::new(); stations.len() - 1],
                blocked_at_start: Vec::new(),
                along: Along::new(&path.path, &place.reference, 5.0).into(),
                bends: stations.windows(2).map(|cell| bends_of(&path, cell)).collect(),
                stop: None,
                by_obstacle: Vec::new(),
                stations: stations.clone(),
            };
            let limits = situation.hard_limits(&cells, LATERAL, 1.0);
            for (station, limit) in stations.iter().zip(&limits) {
                let expected = if limited.contains(station) { slow } else { CRUISE };
                assert!((limit - expected).abs() < 1e-9, "{turn}, {from} to {to} m: {limit} m/s at {station} m");
            }
        }
    }
}

/// A lane of 10 m that turns left by 90 degrees with 20 m between straights, driven 4 m to the left of its middle: the path is 6 m shorter
/// than the line. After the bend, its places are those with the same y.
#[test]
fn goals_rules_and_zones_are_where_they_are_beside_a_path_on_the_inner_side_of_a_bend() {
    const RADIUS: f64 = 20.0;
    // as the reference line is smoothed, and cells have a length
    const SLACK: f64 = 0.6;
    let bound = |offset: f64| {
        let radius = RADIUS - offset;
        let turned = (1..=60).map(|i| f64::from(i) / 60.0 * FRAC_PI_2);
        let arc = turned.map(|a| (20.0 + radius * a.sin(), RADIUS - radius * a.cos()));
        line(&[(0.0, offset), (20.0, offset)].into_iter().chain(arc).collect::<Vec<_>>())
    };
    let after = |offset: f64| line(&[(40.0 - offset, 20.0), (40.0 - offset, 90.0)]);
    let slow = crate::map::Lanelet { speed_limit: Some(4.0), ..lanelet(2, after(-5.0), after(5.0)) };
    let mut road = network([lanelet(1, bound(-5.0), bound(5.0)), slow]);
    follow(&mut road, 1, 2);
    let place = Place::on(road, &[1, 2]);
    let inner = RADIUS - 4.0;
    let spirals = [
        CubicSpiral::straight(18.0),
        CubicSpiral { knots: [1.0 / inner; 4], length: inner * FRAC_PI_2 },
        CubicSpiral::straight(50.0),
    ];
    let path = place.path(Pose::new(2.0, 4.0, 0.0), &spirals);
    let y = |station: f64| path.path.at(station).pose.position.y;
    // the station of the line beside a y after the bend
    let beside = |y: f64| place.reference.project(crate::geometry::Point::new(40.0, y)).s;
    let begins = place.reference.project(crate::geometry::Point::new(2.0, 0.0)).s;
    assert!((beside(30.0) - begins - (18.0 + inner * FRAC_PI_2 + 10.0) - 4.0 * FRAC_PI_2).abs() < SLACK);

    // a stop in a goal
    let window = (0.0, f64::INFINITY);
    let goal = GoalOnLane { near: beside(45.0), far: beside(55.0), speed: (0.0, 0.3), window, target: None };
    let situation = place.situation(begins, Some(goal), &[]);
    let (end, cause) = situation.cells(&path, &situation.course(&path)).unwrap().stop.unwrap();
    let station = goal.stop_station();
    assert_eq!(cause, Cause::Goal);
    let expected = 45.0 + station - goal.near;
    assert!((y(end) - expected).abs() < SLACK, "stops at {}, the goal is at {expected}", y(end));

    // a zone without stopping
    let zone = [(beside(30.0), beside(40.0))];
    let situation = place.situation(begins, None, &zone);
    let cells = situation.cells(&path, &situation.course(&path)).unwrap();
    let ForSearch(problem, _) = situation.for_search(&cells);
    let nodes = || problem.stations.iter().map(|s| y(*s)).zip(&problem.stopping_allowed);
    assert!(
        nodes().all(|(y, may)| *may || (30.0 - SLACK..=40.0 + SLACK).contains(&y)),
        "{:?}",
        nodes().collect::<Vec<_>>()
    );
    assert!(
        nodes().all(|(y, may)| !*may || !(30.0 + SLACK..=40.0 - SLACK).contains(&y)),
        "{:?}",
        nodes().collect::<Vec<_>>()
    );
    assert!(nodes().any(|(_, may)| !*may));

    // the speed limit of the lanelet after the bend
    let limits = situation.hard_limits(&cells, LATERAL, 1.0);
    for (station, limit) in problem.stations.iter().zip(&limits) {
        if y(*station) > 20.0 + SLACK {
            assert!((limit - 4.0).abs() < 1e-9, "{limit} m/s at y = {}", y(*station));
        } else if y(*station) < 20.0 - SLACK {
            assert!(*limit > 4.5, "{limit} m/s at y = {}", y(*station));
        }
    }
}

/// A goal from 96 to 100 m, whose window opens in 12 s, on straight lanes and with a slow stretch in the middle: the vehicle leaves the goal
/// half a second after its window opens, and drives faster before a slow stretch than without it.
#[test]
fn the_speed_for_a_time_window_makes_up_for_slow_stretches() {
    let place = Place::on(network([straight_lanelet(1, (0.0, 300.0), -2.0, 2.0)]), &[1]);
    let stations: Vec<f64> = (0..=300).map(|i| 0.5 * f64::from(i)).collect();
    let slow = |limit: f64| -> Vec<f64> {
        let mut limits =
            stations.iter().map(|s| if (40.0..=60.0).contains(s) { limit } else { 50.0 }).collect::<Vec<_>>();
        make_reachable(&stations, &mut limits, 2.0);
        limits
    };
    let goal = |opens: f64| GoalOnLane {
        near: 96.0,
        far: 100.0,
        speed: (0.0, f64::INFINITY),
        window: (opens, 60.0),
        target: None,
    };
    let speed = |opens: f64, limit: f64| {
        place.situation(0.0, Some(goal(opens)), &[]).speed_for_window(&stations, &slow(limit), 100.0)
    };
    // the vehicle begins at 8 m/s: 100 m in 12.5 s
    assert!((speed(12.0, 50.0) - 8.0).abs() < 0.01, "{}", speed(12.0, 50.0));
    // 20 m at 6 m/s and 80 m at u, with ramps of 2 m/s² around it and one at the start: each takes (Δv)²/2a/v longer than none
    let u = speed(12.0, 6.0);
    let ramps = (u - 8.0).powi(2) / 4.0 / u + 2.0 * (u - 6.0).powi(2) / 4.0 / u;
    let time = 80.0 / u + 20.0 / 6.0 + ramps;
    assert!(u > 8.2 && (time - 12.5).abs() < 0.15, "{u} m/s, {time} s");
    assert_eq!(speed(9.0, 3.0), f64::INFINITY, "too late at any speed");
    assert_eq!(speed(0.0, 50.0), f64::INFINITY, "it is open");
    let behind = place.situation(101.0, Some(goal(12.0)), &[]);
    assert_eq!(behind.speed_for_window(&stations, &slow(6.0), 0.0), f64::INFINITY);
}

/// A straight path may brake harder than one that turns within the stopping distance, to either side; a bend beyond it does not count.
#[test]
fn only_a_straight_path_leaves_the_grip_to_the_brakes() {
    let place = Place::on(network([straight_lanelet(1, (0.0, 200.0), -20.0, 20.0)]), &[1]);
    let situation = Situation { straight_deceleration: 8.0, ..place.situation(5.0, None, &[]) };
    // 8 m/s: 5.3 m at 6 m/s²
    let bend =
        |from: f64, curvature: f64| [CubicSpiral::straight(from), CubicSpiral { knots: [curvature; 4], length: 25.0 }];
    for (spirals, hardest) in [
        ([CubicSpiral::straight(10.0), CubicSpiral::straight(25.0)], 8.0),
        (bend(3.0, 0.03), 6.0),
        (bend(3.0, -0.03), 6.0),
        (bend(10.0, 0.03), 8.0),
    ] {
        let Evaluation::Proven(proven) = situation.evaluate(&place.path(Pose::new(5.0, 0.0, 0.0), &spirals)) else {
            panic!("no proof: {spirals:?}")
        };
        assert_eq!(proven.hardest_deceleration(), hardest, "{spirals:?}");
    }
}
