//! Starts off the road, and what emergency levels may use.

use super::allowance::{Kept, allowance_at, returns_to_road};
use super::*;
use crate::collision::{CollisionSettings, Margins};
use crate::fixtures::{collision_world, parked, road, scenario, vehicle};
use crate::geometry::Pose;
use crate::geometry::spiral::CubicSpiral;
use crate::trajectory::Path;
use crate::vehicle::{CONTROL_SHARE, GRAVITY, builtin_names, load};

/// Heading changes by `turns` (rad) over pieces of 5 m, mirrored if asked for.
fn path(start: Pose, turns: &[f64], side: f64) -> Path {
    let piece = |turn: &f64| {
        // a turn without a curvature at its ends
        let peak = side * turn / 5.0 * 4.0 / 3.0;
        CubicSpiral { knots: [0.0, peak, peak, 0.0], length: 5.0 }
    };
    Path::new(start, &turns.iter().map(piece).collect::<Vec<_>>()).unwrap()
}

/// A start off the road excuses a path only while it returns, on either side.
#[test]
fn only_a_path_that_returns_to_the_road_is_excused_from_it() {
    let vehicle = vehicle();
    let world = collision_world(&scenario(road(4.0, 200.0), Vec::new()), &vehicle, &CollisionSettings::default(), 1.0);
    for (side, depth) in [-1.0, 1.0].into_iter().flat_map(|s| [0.1, 0.4].map(|d| (s, d))) {
        let start = |yaw: f64| Pose::new(20.0, side * (2.0 - 0.5 * vehicle.width + depth), side * yaw);
        let returns = |yaw: f64, turns: &[f64]| {
            let path = path(start(yaw), turns, side);
            let imposed = world.depth_off_road(&start(yaw));
            (imposed, returns_to_road(&world, &path, f64::INFINITY, 0.0))
        };
        let case = format!("{depth} m off on side {side}");
        let (imposed, straight) = returns(0.0, &[0.0, 0.0, 0.0]);
        assert!((imposed - depth).abs() < 0.02, "{case}: {imposed}");
        assert!(straight, "{case}: along the edge it does not grow");
        assert!(returns(-0.1, &[0.0, 0.0, 0.0]).1, "{case}: back to the road");
        assert!(returns(-0.2, &[0.0, 0.1, 0.1]).1, "{case}: back and along the road");
        assert!(!returns(0.02, &[0.0, 0.0, 0.0]).1, "{case}: farther off");
        assert!(!returns(0.0, &[0.1, -0.1, -0.2]).1, "{case}: first farther off, then back");
        assert!(!returns(-0.08, &[0.1, 0.1, 0.1]).1, "{case}: back, and off again");
        // with a wider tube: a stop after a few metres along the edge, and the distance at the end
        let until = |yaw: f64, until: f64, wider: f64| {
            returns_to_road(&world, &path(start(yaw), &[0.0; 3], side), until, wider)
        };
        assert!(until(0.0, 0.6, 0.3) && !until(0.0, 3.1, 0.3), "{case}: along the edge");
        // 0.06 rad are 0.899 m in 15 m; the corners of the margin stick out by another 0.05 m
        assert!(until(-0.06, f64::INFINITY, 0.8) && !until(-0.06, f64::INFINITY, 0.95), "{case}: back to the road");
        // beyond the station from which it has to be on the road, the road itself is checked
        assert!(returns(-0.2, &[0.0, 0.1, 0.1, 0.3, 0.3]).1, "{case}: off again after it");
    }
}

/// A tube of 0.24 m with something inside, ahead of the bumper or beside the door: what is free of it is kept, to 2 mm and never more. A
/// vehicle that moves without a proof keeps everything towards what is ahead.
#[test]
fn what_is_free_of_a_tube_at_the_start_is_kept() {
    let vehicle = vehicle();
    let at = Pose::new(20.0, 0.0, 0.0);
    let tube = SafetyMargins { static_obstacles: Margins::uniform(0.24), ..SafetyMargins::NONE };
    let share = |ahead: f64, left: f64, kept: Kept| {
        let centre = vehicle.centre_of_rear_axle(&at).position;
        let box_at = Pose::new(centre.x + ahead, left, 0.0);
        let scenario = scenario(road(20.0, 200.0), vec![parked(7, box_at, 2.0, 2.0)]);
        let world = collision_world(&scenario, &vehicle, &CollisionSettings::default(), 1.0);
        let point = Path::new(at, &[CubicSpiral::straight(1.0)]).unwrap().at(0.0);
        let start = TrajectoryPoint {
            time: 0.0,
            pose: at,
            curvature: point.curvature,
            curvature_rate: 0.0,
            station: 0.0,
            speed: 1.0,
            acceleration: 0.0,
            jerk: 0.0,
        };
        allowance_at(&world, &tube, &start, kept)
    };
    for gap in [0.01, 0.03, 0.1, 0.2] {
        let (ahead, left) = (0.5 * vehicle.length + gap + 1.0, 0.5 * vehicle.width + gap + 1.0);
        for (x, y) in [(ahead, 0.0), (0.0, left), (0.0, -left)] {
            let case = format!("{gap} m, at ({x}, {y})");
            let free = share(x, y, Kept::Share).to_obstacles * 0.24;
            assert!(free <= gap && free > gap - 0.005, "{case}: {free} m are kept");
            assert_eq!(share(x, y, Kept::Nothing).to_obstacles, 0.0, "{case}");
            let moving = share(x, y, Kept::Beside).to_obstacles * 0.24;
            assert!((moving - if y == 0.0 { 0.24 } else { free }).abs() < 1e-12, "{case}: {moving} m while it moves");
        }
        let beyond = share(ahead + 0.24, 0.0, Kept::Share);
        assert_eq!(beyond, crate::collision::Allowance::NONE, "{gap} m beyond the tube");
    }
}

/// Braking and turning share the grip of the tyres, and braking stays below the brakes, whatever the settings ask for.
#[test]
fn no_emergency_level_asks_for_more_than_grip_and_brakes() {
    let scenario = scenario(road(4.0, 200.0), Vec::new());
    let strong = EmergencyLimits { acceleration: 20.0, deceleration: 20.0 };
    for (name, friction) in builtin_names().iter().flat_map(|n| [1.0, 0.6, 0.15].map(|f| (n, f))) {
        let vehicle = load(name).unwrap();
        let mut settings = Settings::default();
        settings.emergency.push(strong);
        let planner = Planner::new(scenario.map(), &vehicle, &settings).unwrap();
        let limits = ProofLimits::new(&vehicle, friction);
        let grip = CONTROL_SHARE * friction * vehicle.tyres.friction * GRAVITY;
        let levels = planner.emergency_levels(&limits, SafetyMargins::NONE);
        assert_eq!(levels.len(), settings.emergency.len());
        for level in levels {
            let used = level.deceleration.hypot(level.lateral_limit);
            assert!(used <= grip + 1e-9, "{name}, friction {friction}: {used} of {grip}");
            assert!(level.braking <= level.deceleration && level.acceleration <= limits.acceleration());
            assert!(level.deceleration <= CONTROL_SHARE * vehicle.limits.deceleration, "{name}, friction {friction}");
        }
    }
}
