//! A run does not depend on where the map lies, how it is turned, which side is left, nor on the threads it has.

mod common;

use common::{PlaneMotion, VEHICLE, bundled, driven, failures};
use stopline::drive::{Outcome, Run, Settings, drive};
use stopline::geometry::{Vector, wrap_angle};
use stopline::map::Scenario;
use stopline::simulation::Log;
use stopline::verdict::{self, Metrics};

/// Stories of each kind: nothing, something to pass on one side, bends, traffic ahead, traffic from the side.
const STORIES: [&str; 6] = ["straight_100m", "parked_car", "s_curve", "slow_lead", "lead_brakes_hard", "cut_in"];

/// How far a moved run may be from the moved first run, m and rad. At 2·10⁶ m an `f64` resolves 2·10⁻¹⁰ m; that is what
/// enters, and what the loop of planning and physics makes of it over 20 s stays below this.
const SAME_WAY: f64 = 1e-4;
/// The same for speeds, m/s.
const SAME_SPEED: f64 = 1e-4;
/// The same for filtered accelerations and jerk, m/s² and m/s³.
const SAME_FEEL: f64 = 1e-3;

fn metrics(run: &Run) -> Metrics {
    verdict::metrics(run.scenario, run.vehicle, &run.cycles, &run.log, &verdict::Settings::default())
}

/// Drives a story as it is and moved, and demands the same run.
fn same_when_moved(name: &str, motion: PlaneMotion) {
    let scenario = bundled(name);
    let moved_scenario = motion.scenario(&scenario);
    let (first, moved) = (driven(&scenario), driven(&moved_scenario));
    assert_eq!((moved.outcome, moved.reason), (first.outcome, first.reason), "{name}: {:#?}", failures(&moved));
    same_verdict(name, &first, &moved);
    same_way(name, &first, &moved, &motion);
    same_metrics(name, &metrics(&first), &metrics(&moved));
}

fn same_verdict(name: &str, first: &Run, moved: &Run) {
    let told = |run: &Run| run.verdict.checks.iter().map(|c| (c.name, c.pass)).collect::<Vec<_>>();
    assert_eq!(told(moved), told(first), "{name}");
}

fn same_way(name: &str, first: &Run, moved: &Run, motion: &PlaneMotion) {
    assert_eq!(moved.log.samples.len(), first.log.samples.len(), "{name}: samples");
    for (a, b) in first.log.samples.iter().zip(&moved.log.samples) {
        let wanted = motion.pose(&a.pose);
        let apart = (b.pose.position - wanted.position).norm();
        let turned = wrap_angle(b.pose.yaw - wanted.yaw).abs();
        assert!(
            apart < SAME_WAY && turned < SAME_WAY && (a.speed - b.speed).abs() < SAME_SPEED,
            "{name}: at {:.2} s {apart:e} m and {turned:e} rad away, {} m/s instead of {}",
            a.time,
            b.speed,
            a.speed
        );
    }
}

fn same_metrics(name: &str, first: &Metrics, moved: &Metrics) {
    let named = |m: &Metrics| serde_json::to_value(m).unwrap();
    let (first, moved) = (named(first), named(moved));
    for (key, value) in first.as_object().unwrap() {
        let tolerance = if key.contains("acceleration") || key.contains("jerk") { SAME_FEEL } else { SAME_WAY };
        match (value.as_f64(), moved[key].as_f64()) {
            (Some(a), Some(b)) => assert!((a - b).abs() <= tolerance, "{name}: {key} is {b} instead of {a}"),
            (a, b) => assert_eq!(a, b, "{name}: {key}"),
        }
    }
}

#[test]
fn utm_coordinates_change_nothing() {
    for name in STORIES {
        same_when_moved(name, PlaneMotion { shift: Vector::new(1.0e6, 1.0e6), ..PlaneMotion::NONE });
    }
}

#[test]
fn a_turned_map_changes_nothing() {
    for name in STORIES {
        same_when_moved(name, PlaneMotion { turn: 2.5, ..PlaneMotion::NONE });
    }
}

#[test]
fn a_mirrored_map_gives_the_mirrored_run() {
    for name in STORIES {
        same_when_moved(name, PlaneMotion { is_mirrored: true, ..PlaneMotion::NONE });
    }
}

#[test]
fn mirrored_turned_and_moved_at_once() {
    let motion = PlaneMotion { is_mirrored: true, turn: -1.1, shift: Vector::new(-6.9e5, 5.3e6) };
    same_when_moved("parked_car", motion);
}

/// The helper itself: a motion that forgets something would make the tests above compare a run with another story.
#[test]
fn mirroring_twice_gives_back_the_scenario_and_once_does_not() {
    let motion = PlaneMotion { is_mirrored: true, ..PlaneMotion::NONE };
    for name in STORIES {
        let scenario = bundled(name);
        let once = motion.scenario(&scenario);
        let told = |s: &Scenario| format!("{:?} {:?} {:?}", s.network, s.obstacles, s.problems).replace("-0.0", "0.0");
        assert_eq!(told(&motion.scenario(&once)), told(&scenario), "{name}");
        assert_ne!(told(&once), told(&scenario), "{name}: is its own mirror image");
        for lanelet in once.network.lanelets.values() {
            let (left, right) =
                (lanelet.centre.project(lanelet.left.first()), lanelet.centre.project(lanelet.right.first()));
            assert!(left.offset > 0.0 && right.offset < 0.0, "{name}: lanelet {} has its bounds exchanged", lanelet.id);
        }
    }
}

/// Every driven number and every decision, to the bit.
fn bits(run: &Run) -> (Outcome, Vec<u64>, String) {
    let Log { samples, .. } = &run.log;
    let numbers = samples.iter().flat_map(|s| {
        [
            s.time,
            s.pose.position.x,
            s.pose.position.y,
            s.pose.yaw,
            s.speed,
            s.lateral_speed,
            s.yaw_rate,
            s.acceleration,
            s.lateral_acceleration,
            s.steering,
            s.commanded_acceleration,
            s.commanded_steering,
            s.wanted_pose.position.x,
            s.wanted_pose.position.y,
            s.wanted_station,
        ]
    });
    let decisions = run.cycles.iter().map(|c| (c.decision, c.chosen, c.candidates.len(), c.expansions));
    (run.outcome, numbers.map(f64::to_bits).collect(), format!("{:?}", decisions.collect::<Vec<_>>()))
}

#[test]
fn repetitions_and_thread_counts_give_equal_bits() {
    for name in ["parked_car", "cut_in"] {
        let scenario = bundled(name);
        let with_threads = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| bits(&driven(&scenario)))
        };
        let one = with_threads(1);
        assert!(one.1.len() > 1000, "{name}: hardly anything was driven");
        assert!(one == with_threads(1), "{name}: a second run differs");
        assert!(one == with_threads(2), "{name}: two threads differ from one");
    }
}

/// What the test above compares does tell runs apart.
#[test]
fn another_friction_gives_other_bits() {
    let scenario = bundled("straight_100m");
    let mut settings = Settings::default();
    settings.simulation.friction_scale = 0.9;
    let slippery = drive(&scenario, &scenario.problems[0], &VEHICLE, &settings, &mut |_, _| {}).unwrap();
    assert!(bits(&driven(&scenario)) != bits(&slippery));
}
