//! Reachable sets compared with sampled motions, and predictions without some obstacles.

use std::f64::consts::{FRAC_PI_2, PI};

use proptest::prelude::*;
use proptest::strategy::Strategy as Generator;

use super::*;
use crate::collision::convert::{Local, vector};
use crate::collision::{CollisionSettings, CollisionWorld, SafetyMargins};
use crate::geometry::{Point, Vector};
use crate::map::{RoadNetwork, Shape};
use crate::speed::{AccelerationLimits, Resolution, SpeedProblem, Strategy, prove, search, smoothing};
use crate::trajectory::SpeedProfile;

const FREE: MotionBounds =
    MotionBounds { longitudinal: 2.0, lateral: 0.6, max_lateral_deviation: f64::INFINITY, vehicles_reverse: true };
/// Length of the predictions, s.
const DURATION: f64 = 6.0;
/// Step of the sampled motions, s.
const STEP: f64 = 0.005;

/// A prediction: start pose, speed (not below zero), acceleration, yaw rate.
#[derive(Debug, Clone)]
struct Predicted {
    kind: ObstacleKind,
    from: Pose,
    speed: f64,
    acceleration: f64,
    turning: f64,
    /// Time between states, s.
    interval: f64,
}

impl Predicted {
    fn obstacle(&self) -> Obstacle {
        let states =
            (0..=(DURATION / self.interval).round() as usize).scan((self.from, self.speed), |(pose, speed), i| {
                let state = TimedPose { time: self.interval * i as f64, pose: *pose, speed: *speed };
                let distance = *speed * self.interval;
                let middle = Pose { yaw: pose.yaw + 0.5 * self.turning * self.interval, ..*pose };
                *pose = Pose {
                    position: middle.advanced(distance).position,
                    yaw: wrap_angle(pose.yaw + self.turning * self.interval),
                };
                *speed = (*speed + self.acceleration * self.interval).max(0.0);
                Some(state)
            });
        let motion = Motion::Trajectory(states.collect());
        Obstacle { id: 7, kind: self.kind, shape: Shape::rectangle(4.0, 1.8), motion }
    }
}

fn predictions(obstacles: &[Obstacle]) -> Predictions {
    Predictions::new(obstacles, Origin::amid([]), 0.1, DURATION)
}

fn predicted() -> impl Generator<Value = Predicted> {
    let interval = prop_oneof![Just(0.1), Just(0.2), Just(0.3)];
    let kind = prop_oneof![Just(ObstacleKind::Vehicle), Just(ObstacleKind::Pedestrian)];
    (kind, -3.1..3.1f64, 0.0..15.0f64, -2.0..1.0f64, prop_oneof![Just(0.0), -0.6..0.6f64], interval).prop_map(
        |(kind, yaw, speed, acceleration, turning, interval)| {
            let from = Pose::new(10.0, -20.0, yaw);
            Predicted { kind, from, speed, acceleration, turning, interval }
        },
    )
}

/// Accelerations of a sampled motion: in one direction, later in the opposite one, mixed with noise.
#[derive(Debug, Clone)]
struct Push {
    direction: f64,
    turns_at: f64,
    noise: Vec<(f64, f64)>,
    share_of_noise: f64,
}

fn push() -> impl Generator<Value = Push> {
    let noise = prop::collection::vec((-1.0..1.0f64, -1.0..1.0f64), 40);
    let turns_at = prop_oneof![Just(f64::INFINITY), 0.5..5.0f64];
    (-3.1..3.1f64, turns_at, noise, prop_oneof![Just(0.0), 0.0..1.0f64])
        .prop_map(|(direction, turns_at, noise, share_of_noise)| Push { direction, turns_at, noise, share_of_noise })
}

/// The deviations of a motion within the bounds, every [`STEP`] from `now` on, as long as it satisfies the bounds.
fn deviations(obstacle: &Obstacle, now: f64, bounds: &MotionBounds, push: &Push) -> Vec<Vector> {
    let reverses = bounds.vehicles_reverse || obstacle.kind == ObstacleKind::Pedestrian;
    let (mut at, mut velocity) = (Vector::zeros(), Vector::zeros());
    let mut found = vec![at];
    while now + STEP * found.len() as f64 <= DURATION {
        let s = STEP * (found.len() - 1) as f64;
        let (before, after) = (obstacle.pose_at(now + s).unwrap(), obstacle.pose_at(now + s + STEP).unwrap());
        let pose = before.interpolated(&after, 0.5);
        let turned = pose.yaw - push.direction;
        let sign = if s < push.turns_at { 1.0 } else { -1.0 };
        let noise = push.noise[((s / 0.25) as usize).min(39)];
        let mix = |pushed: f64, noise: f64| pushed * (1.0 - push.share_of_noise) + noise * push.share_of_noise;
        let longitudinal = bounds.longitudinal * mix(sign * turned.cos().signum(), noise.0);
        let lateral = bounds.lateral * mix(-sign * turned.sin().signum(), noise.1);
        let predicted = (after.position - before.position) / STEP;
        let moved = |longitudinal: f64| {
            let acceleration = pose.forward() * longitudinal + pose.left() * lateral;
            (at + velocity * STEP + acceleration * (0.5 * STEP * STEP), velocity + acceleration * STEP)
        };
        let satisfies_bounds = |(at, velocity): &(Vector, Vector)| {
            let forward = (predicted + velocity).dot(&after.forward());
            let allowed = predicted.dot(&after.forward()).min(0.0);
            (reverses || forward >= allowed) && at.dot(&after.left()).abs() <= bounds.max_lateral_deviation
        };
        // a motion that would reverse accelerates instead; if that violates the bounds, it ends here
        let Some(next) = [longitudinal, bounds.longitudinal].into_iter().map(moved).find(satisfies_bounds) else {
            break;
        };
        (at, velocity) = next;
        found.push(at);
    }
    found
}

/// Largest distance of the motion from the regions, m, beyond the error of the sampling.
fn escape(predictions: &Predictions, obstacle: &Obstacle, now: f64, deviations: &[Vector], turning: f64) -> f64 {
    let track = &predictions.tracks[0];
    let parts = obstacle.shape.convex_parts();
    let mut worst = f64::NEG_INFINITY;
    for (i, deviation) in deviations.iter().enumerate().step_by(7) {
        let elapsed = STEP * i as f64;
        let slice = ((now + elapsed) / predictions.slice + 1e-9) as usize;
        let Some(region) = slice.checked_sub(track.first).and_then(|i| track.slices.get(i)) else { continue };
        let pose = obstacle.pose_at(now + elapsed).unwrap();
        let ConvexPart::Polygon(corners) = &parts[0] else { panic!() };
        for corner in corners {
            let p = vector(pose.to_world(*corner) + deviation);
            let out = region.pieces[0].distance_to(&[p, p, p]);
            let sampling = 2.0 * turning.abs() * STEP * elapsed * elapsed + 1e-6;
            worst = worst.max(out - sampling);
        }
    }
    worst
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    /// No false negative: 3000 motions, many at the border of the set, stay inside the reachable sets.
    #[test]
    fn no_motion_within_the_bounds_leaves_the_reachable_sets(
        predicted in predicted(), pushes in prop::collection::vec(push(), 5), now in prop_oneof![Just(0.0), Just(1.3), 0.0..3.0f64],
        longitudinal in 0.0..4.0f64, lateral in 0.0..2.0f64,
        max_lateral_deviation in prop_oneof![Just(f64::INFINITY), 0.1..2.0f64], vehicles_reverse in any::<bool>(),
    ) {
        let bounds = MotionBounds { longitudinal, lateral, max_lateral_deviation, vehicles_reverse };
        let obstacle = predicted.obstacle();
        let reachable = predictions(std::slice::from_ref(&obstacle)).reachable(now, &bounds);
        for push in &pushes {
            let motion = deviations(&obstacle, now, &bounds, push);
            let out = escape(&reachable, &obstacle, now, &motion, predicted.turning);
            prop_assert!(out <= 0.0, "{out} m out with {push:?}");
        }
    }

    #[test]
    fn wider_bounds_enlarge_the_set_and_a_later_time_reduces_it(
        predicted in predicted(), longitudinal in 0.0..3.0f64, lateral in 0.0..1.0f64, more in 1.0..2.0f64, most in 0.2..2.0f64,
    ) {
        let all = predictions(&[Predicted { turning: 0.0, ..predicted.clone() }.obstacle()]);
        let bounds = MotionBounds { longitudinal, lateral, max_lateral_deviation: most, vehicles_reverse: false };
        let reachable = all.reachable(1.0, &bounds);
        for wider in [
            all.reachable(1.0, &MotionBounds { longitudinal: more * longitudinal, ..bounds }),
            all.reachable(1.0, &MotionBounds { lateral: more * lateral, ..bounds }),
            all.reachable(1.0, &MotionBounds { max_lateral_deviation: more * most, ..bounds }),
            all.reachable(1.0, &MotionBounds { vehicles_reverse: true, ..bounds }),
            all.reachable(0.0, &bounds),
            all.reachable(0.55, &bounds),
        ] {
            prop_assert!(lies_in(&reachable, &wider), "{bounds:?}");
        }
        let none = all.reachable(1.0, &MotionBounds { longitudinal: 0.0, lateral: 0.0, ..bounds });
        prop_assert!(lies_in(&none, &reachable));
        // turning or not
        let bent = predictions(&[predicted.obstacle()]);
        prop_assert!(lies_in(&after(&bent, 1.0), &bent.reachable(1.0, &bounds)));
    }

    /// The guarantee of a robust proof: the plan reaches standstill without contact for every motion in the set.
    #[test]
    fn a_robust_plan_is_safe_for_every_motion_in_the_set(
        crossing in -40.0..40.0f64, speed in 1.0..10.0f64, turning in prop_oneof![Just(0.0), -0.2..0.2f64],
        distance in 10.0..50.0f64, pushes in prop::collection::vec(push(), 8), own in 2.0..10.0f64,
    ) {
        let yaw = if crossing > 0.0 { -1.3 } else { 1.3 };
        let from = Pose::new(distance, crossing, yaw);
        let predicted = Predicted { kind: ObstacleKind::Vehicle, from, speed, acceleration: 0.0, turning, interval: 0.1 };
        let obstacle = predicted.obstacle();
        let bounds = MotionBounds { vehicles_reverse: false, ..FREE };
        let world = world(vec![obstacle.clone()]);
        let set = world.predictions().reachable(0.0, &bounds);
        // most problems have a plan; too many rejections would fail the test
        let plan = plan(&problem(&world, &set, own));
        prop_assume!(plan.is_some());
        for push in &pushes {
            let motion = deviations(&obstacle, 0.0, &bounds, push);
            let states = motion.iter().enumerate().step_by(10).map(|(i, deviation)| {
                let time = STEP * i as f64;
                let state = obstacle.state_at(time).unwrap();
                // the steps of the sampling may leave the set by less than this
                let pose = Pose { position: state.pose.position + deviation * 0.999, ..state.pose };
                TimedPose { time, pose, ..state }
            });
            let moved = Obstacle { motion: Motion::Trajectory(states.collect()), ..obstacle.clone() };
            let world = self::world(vec![moved]);
            let actual = problem(&world, world.predictions(), own);
            prop_assert_eq!(plan.as_ref().map(|plan| prove(&actual, plan)), Some(Ok(())), "{:?}", push);
        }
    }
}

/// The converse of the property above: the test detects regions that are too small.
#[test]
fn motions_at_the_border_leave_slightly_smaller_regions() {
    let push =
        |direction: f64| Push { direction, turns_at: f64::INFINITY, noise: vec![(0.0, 0.0); 40], share_of_noise: 0.0 };
    for turning in [0.0, 0.3] {
        let from = Pose::new(0.0, 0.0, 0.4);
        let kind = ObstacleKind::Vehicle;
        let predicted = Predicted { kind, from, speed: 8.0, acceleration: 0.0, turning, interval: 0.1 };
        let obstacle = predicted.obstacle();
        let all = predictions(std::slice::from_ref(&obstacle));
        let escapes = |small: &MotionBounds, directions: &[f64]| {
            let reachable = all.reachable(0.0, small);
            let out =
                |n: &f64| escape(&reachable, &obstacle, 0.0, &deviations(&obstacle, 0.0, &FREE, &push(*n)), turning);
            directions.iter().map(out).fold(f64::NEG_INFINITY, f64::max)
        };
        let last = 0.4 + turning * DURATION;
        let (longitudinal, lateral) = ([last, last + PI], [last + FRAC_PI_2, last - FRAC_PI_2]);
        assert!(escapes(&FREE, &longitudinal) <= 0.0 && escapes(&FREE, &lateral) <= 0.0);
        assert!(escapes(&MotionBounds { longitudinal: 0.8 * FREE.longitudinal, ..FREE }, &longitudinal) > 0.5);
        assert!(escapes(&MotionBounds { lateral: 0.5 * FREE.lateral, ..FREE }, &lateral) > 0.5);
        let lane = MotionBounds { max_lateral_deviation: 0.5, ..FREE };
        assert!(escapes(&lane, &lateral) > 0.5);
    }
    // reversing with 2 m/s² for 6 s gives 36 m, minus the predicted 12 m
    let kind = ObstacleKind::Vehicle;
    let slow =
        Predicted { kind, from: Pose::new(0.0, 0.0, 0.0), speed: 2.0, acceleration: 0.0, turning: 0.0, interval: 0.1 };
    let obstacle = slow.obstacle();
    let reachable =
        predictions(std::slice::from_ref(&obstacle)).reachable(0.0, &MotionBounds { vehicles_reverse: false, ..FREE });
    let out = escape(&reachable, &obstacle, 0.0, &deviations(&obstacle, 0.0, &FREE, &push(PI)), 0.0);
    assert!((out - 24.0).abs() < 1.5, "{out}");
}

#[test]
fn zero_bounds_and_zero_elapsed_time_give_the_prediction() {
    let kind = ObstacleKind::Vehicle;
    let from = Pose::new(30.0, 10.0, -1.2);
    let predicted = Predicted { kind, from, speed: 5.0, acceleration: 0.3, turning: 0.1, interval: 0.1 };
    let world = world(vec![predicted.obstacle()]);
    let sweep = world.sweep(&Pose::new(0.0, 0.0, 0.0), &crate::geometry::spiral::CubicSpiral::straight(60.0));
    let plain = world.blocked(&[&sweep], &margins(), 0.0, DURATION);
    assert!(!plain.is_free());
    let none = MotionBounds { longitudinal: 0.0, lateral: 0.0, ..FREE };
    assert_eq!(
        world.predictions().reachable(0.0, &none).blocked(&[&sweep], &margins().moving_obstacles, 0.0, DURATION),
        plain
    );
    let reachable =
        world.predictions().reachable(0.0, &FREE).blocked(&[&sweep], &margins().moving_obstacles, 0.0, DURATION);
    assert!(reachable.blocked_cells().count() > plain.blocked_cells().count());
    // the result of the plain predictions is unchanged, cached or not
    assert_eq!(world.blocked(&[&sweep], &margins(), 0.0, DURATION), plain);
    // in the first slice the deviation is at most 0.5 · 2 · 0.1² = 1 cm
    let (all, reachable) = (world.predictions(), world.predictions().reachable(2.0, &FREE));
    let now = &reachable.tracks[0].slices[20 - reachable.tracks[0].first].pieces[0];
    let bare = &all.tracks[0].slices[20].pieces[0];
    let farthest = now.points().iter().map(|p| bare.distance_to(&[*p, *p, *p])).fold(0.0, f64::max);
    assert!(farthest > 1e-3 && farthest < 0.0105, "{farthest}");
}

#[test]
fn pedestrians_may_reverse_and_prediction_sets_are_unchanged() {
    let walks = |kind| Predicted {
        kind,
        from: Pose::new(0.0, 0.0, 0.0),
        speed: 1.0,
        acceleration: 0.0,
        turning: 0.0,
        interval: 0.1,
    };
    let bounds = MotionBounds { vehicles_reverse: false, ..FREE };
    let behind = |kind| {
        let reachable = predictions(&[walks(kind).obstacle()]).reachable(0.0, &bounds);
        reachable.tracks[0].slices.last().unwrap().aabb.unwrap().mins.x
    };
    assert!((behind(ObstacleKind::Vehicle) + 2.1).abs() < 1e-6, "{}", behind(ObstacleKind::Vehicle));
    assert!(behind(ObstacleKind::Pedestrian) < -30.0);
    let region = Shape::rectangle(3.0, 2.0);
    let sets = Motion::Occupancy(vec![TimedOccupancy { from: 0.0, to: DURATION, region: region.clone() }]);
    let all = predictions(&[Obstacle { id: 1, kind: ObstacleKind::Vehicle, shape: region, motion: sets }]);
    assert!(lies_in(&all.reachable(0.0, &bounds), &all));
}

#[test]
fn reachable_sets_are_invariant_under_rigid_motions_and_mirroring() {
    for (turning, mirror) in [(0.3, 1.0), (0.3, -1.0), (0.0, -1.0)] {
        let kind = ObstacleKind::Vehicle;
        let predicted = |from: Pose, side: f64| Predicted {
            kind,
            from,
            speed: 6.0,
            acceleration: -0.5,
            turning: side * turning,
            interval: 0.1,
        };
        let bounds = MotionBounds { vehicles_reverse: false, max_lateral_deviation: 1.5, ..FREE };
        let first = predictions(&[predicted(Pose::new(0.0, 0.0, 0.2), 1.0).obstacle()]).reachable(0.5, &bounds);
        let (turn, shift) = (2.5, Point::new(1.0e6, 1.0e6));
        let frame = Pose { position: shift, yaw: turn };
        let from = Pose { position: shift, yaw: wrap_angle(turn + mirror * 0.2) };
        let obstacle = predicted(from, mirror).obstacle();
        let moved = Predictions::new(&[obstacle], Origin::amid([&shift]), 0.1, DURATION);
        let moved = moved.reachable(0.5, &bounds);
        for (a, b) in first.tracks[0].slices.iter().zip(&moved.tracks[0].slices) {
            let (a, b) = (&a.pieces[0], &b.pieces[0]);
            for p in a.points() {
                let there = moved.origin.local(frame.to_world(Point::new(p.x, mirror * p.y)));
                assert!(b.distance_to(&[there, there, there]) < 1e-6);
            }
            for p in b.points() {
                let back = frame.to_local(moved.origin.world(*p));
                let back = Local::new(back.x, mirror * back.y);
                assert!(a.distance_to(&[back, back, back]) < 1e-6);
            }
        }
    }
}

#[test]
fn removed_obstacles_are_absent_until_their_time() {
    let kind = ObstacleKind::Vehicle;
    let vehicle = |id: i64, y: f64| {
        let from = Pose::new(0.0, y, 0.0);
        let predicted = Predicted { kind, from, speed: 10.0, acceleration: 0.0, turning: 0.0, interval: 0.1 };
        Obstacle { id, ..predicted.obstacle() }
    };
    let world = world(vec![vehicle(1, 0.0), vehicle(2, 0.5)]);
    let sweep = world.sweep(&Pose::new(20.0, 0.0, 0.0), &crate::geometry::spiral::CubicSpiral::straight(30.0));
    let blocked =
        |predictions: &Predictions| predictions.blocked(&[&sweep], &margins().moving_obstacles, 0.0, DURATION);
    let all = blocked(world.predictions());
    let ids = |grid: &BlockedGrid, before: f64| {
        let intervals = (0..grid.cells()).flat_map(|c| grid.intervals(c)).filter(|b| b.to <= before + 1e-9);
        let mut ids: Vec<i64> = intervals.map(|b| b.obstacle).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    };
    assert_eq!(ids(&all, DURATION), [1, 2][..1].to_vec(), "the lowest id must block a cell");
    assert_eq!(ids(&blocked(&world.predictions().without(&[(1, ALWAYS)])), DURATION), [2]);
    assert!(blocked(&world.predictions().without(&[(1, ALWAYS), (2, ALWAYS)])).is_free());
    let later = blocked(&world.predictions().without(&[(1, (0.0, 3.0)), (2, ALWAYS)]));
    assert!(ids(&later, 3.0).is_empty() && ids(&later, DURATION) == [1]);
    let times = |grid: &BlockedGrid, from: f64| -> Vec<_> {
        grid.blocked_cells().filter(|(_, t)| t.1 > from + 1e-9).map(|(s, t)| (s, (t.0.max(from), t.1))).collect()
    };
    assert_eq!(times(&later, 3.0), times(&all, 3.0));
    let earlier = blocked(&world.predictions().without(&[(1, (3.0, f64::INFINITY)), (2, ALWAYS)]));
    let until = |grid: &BlockedGrid| -> Vec<_> { grid.blocked_cells().filter(|(_, t)| t.0 < 3.0 - 1e-9).collect() };
    assert!(times(&earlier, 3.0).is_empty() && !until(&earlier).is_empty());
    assert_eq!(until(&earlier).len(), until(&all).len());
    assert_eq!(blocked(&world.predictions().without(&[])), all);
    assert_eq!(blocked(world.predictions()), all, "the cache of the sweep must still be valid");
}

/// All times.
const ALWAYS: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

fn margins() -> SafetyMargins {
    CollisionSettings::default().margins()
}

/// The predictions without the slices before a time.
fn after(predictions: &Predictions, time: f64) -> Predictions {
    predictions.without(&predictions.tracks.iter().map(|t| (t.id, (f64::NEG_INFINITY, time))).collect::<Vec<_>>())
}

/// Whether all regions of `a` are inside those of `b`, piece by piece.
fn lies_in(a: &Predictions, b: &Predictions) -> bool {
    let (a, b) = (&a.tracks[0], &b.tracks[0]);
    a.slices.iter().enumerate().all(|(i, slice)| {
        let other = (a.first + i).checked_sub(b.first).and_then(|i| b.slices.get(i));
        let Some(other) = other.filter(|o| !o.pieces.is_empty()) else { return true };
        slice.pieces.iter().zip(&other.pieces).all(|(inner, outer)| {
            inner.radius() <= outer.radius() && inner.points().iter().all(|p| outer.distance_to(&[*p, *p, *p]) < 1e-6)
        })
    })
}

fn world(obstacles: Vec<Obstacle>) -> CollisionWorld {
    let vehicle = crate::vehicle::load("bmw_320i").unwrap();
    let settings = CollisionSettings::default();
    CollisionWorld::new(&RoadNetwork::default(), None, &obstacles, &vehicle, &settings, DURATION).unwrap()
}

/// A straight path along x for 60 m.
fn problem(world: &CollisionWorld, predictions: &Predictions, speed: f64) -> SpeedProblem {
    let sweep = world.sweep(&Pose::new(0.0, 0.0, 0.0), &crate::geometry::spiral::CubicSpiral::straight(60.0));
    let grid = predictions.blocked(&[&sweep], &margins().moving_obstacles, 0.0, DURATION);
    let intervals = |cell: usize| grid.intervals(cell).iter().map(|b| (b.from, b.to)).collect::<Vec<_>>();
    let limits = AccelerationLimits { acceleration: 1.5, deceleration: 1.5, aggressive_deceleration: 4.0 };
    SpeedProblem {
        speed_limits: vec![10.0; grid.stations().len()],
        stopping_allowed: vec![true; grid.stations().len()],
        blocked: (0..grid.cells()).map(intervals).collect(),
        blocked_at_start: intervals(0),
        stations: grid.stations().to_vec(),
        start_speed: speed,
        start_time: 0.0,
        horizon: DURATION,
        limits,
    }
}

fn plan(problem: &SpeedProblem) -> Option<SpeedProfile> {
    let found = search(problem, Strategy::SafeTlp, &Resolution::default()).unwrap().proven()?;
    let profile = smoothing::raw_profile(problem, &found).unwrap();
    assert_eq!(prove(problem, &profile), Ok(()));
    Some(profile)
}

/// A vehicle that crosses a straight path of 60 m or drives along it.
fn traffic() -> impl Generator<Value = Predicted> {
    (predicted(), 0.0..60.0f64, -8.0..8.0f64).prop_map(|(predicted, x, y)| {
        let from = Pose::new(x, y, predicted.from.yaw);
        Predicted { from, ..predicted }
    })
}

/// Margins that are often equal, m.
fn margin() -> impl Generator<Value = f64> {
    prop_oneof![Just(0.0), Just(0.2), Just(0.5), 0.0..0.6f64]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// A sweep that has answered with wider and with other margins before answers as a new one, coarsely and finely, from any time on.
    #[test]
    fn what_a_sweep_keeps_changes_no_answer(
        one in traffic(), other in traffic(), from in 0.0..3.0f64,
        queries in prop::collection::vec((margin(), margin(), prop_oneof![Just(0.0), Just(40.0)]), 1..8),
    ) {
        let world = world(vec![one.obstacle(), Obstacle { id: 8, ..other.obstacle() }]);
        let sweep = || world.sweep(&Pose::new(0.0, 0.0, 0.0), &crate::geometry::spiral::CubicSpiral::straight(60.0));
        let used = sweep();
        for (lateral, longitudinal, fine_until) in queries {
            let margins = Margins { lateral, longitudinal };
            let times = (from, DURATION);
            let found = world.predictions().blocked_finely(&[&used], &margins, times, fine_until);
            let fresh = world.predictions().blocked_finely(&[&sweep()], &margins, times, fine_until);
            prop_assert_eq!(found, fresh);
        }
    }

    /// What blocks a sweep while it is visited is the same as of all that blocks it.
    #[test]
    fn a_visit_sees_what_blocks_the_sweep_then(
        one in traffic(), from in 0.0..5.0f64, lasts in 0.0..3.0f64, has_answered in any::<bool>(),
    ) {
        let world = world(vec![one.obstacle()]);
        let sweep = world.sweep(&Pose::new(0.0, 0.0, 0.0), &crate::geometry::spiral::CubicSpiral::straight(60.0));
        let margins = margins().moving_obstacles;
        let other = world.sweep(&Pose::new(0.0, 0.0, 0.0), &crate::geometry::spiral::CubicSpiral::straight(60.0));
        if has_answered {
            let _ = world.predictions().blocked(&[&sweep], &margins, 0.0, DURATION);
        }
        let visit = world.predictions().blocked_during(&[(&sweep, (from, from + lasts))], &margins, 0.0);
        let all = world.predictions().blocked(&[&other], &margins, 0.0, DURATION);
        prop_assert_eq!(visit.stations(), all.stations());
        for (cell, i) in (0..all.cells()).flat_map(|cell| (0..=10).map(move |i| (cell, i))) {
            let time = (from + 0.1 * f64::from(i) * lasts).min(DURATION);
            prop_assert_eq!(visit.is_blocked(cell, time, time), all.is_blocked(cell, time, time));
        }
    }
}
