//! A run depends neither on the position, rotation and mirroring of the map nor on the number of threads.

mod common;

use common::{PlaneMotion, VEHICLE, bundled, driven};
use stopline::drive::{Outcome, Run, Settings, drive};
use stopline::geometry::{Vector, wrap_angle};
use stopline::map::Scenario;
use stopline::simulation::Log;
use stopline::verdict::{self, Metrics};

/// Scenarios with static obstacles only: an empty road, an obstacle to pass on one side, curves.
const STATIC: [&str; 3] = ["straight_100m", "parked_car", "s_curve"];
/// Scenarios with traffic: ahead, stopping ahead, from the side.
const TRAFFIC: [&str; 3] = ["slow_lead", "lead_brakes_hard", "cut_in"];

/// Largest accepted difference between a moved run and the moved original, m and rad.
///
/// Rounding is 2·10⁻¹⁰ m (an `f64` at 2·10⁶ m). The interior-point solver amplifies it: the iteration at which it stops
/// changes its result by its tolerance, and the next cycles plan from there. The runs differ by up to 2·10⁻⁵ m. A choice that
/// depends on rounding makes them differ by far more.
const PATH_TOLERANCE: f64 = 1e-3;
/// Tolerance of speeds, m/s.
const SPEED_TOLERANCE: f64 = 1e-3;
/// Tolerance of the end of the run, s: none but rounding.
const TIME_TOLERANCE: f64 = 1e-9;
/// Tolerance of filtered accelerations, m/s², and jerk, m/s³.
const ACCELERATION_TOLERANCE: f64 = 1e-2;

fn metrics(run: &Run) -> Metrics {
    verdict::metrics(run.scenario, run.vehicle, &run.cycles, &run.log, &verdict::Settings::default())
}

/// Drives scenarios unchanged and moved, and requires equal runs. Drives all of them before it reports failures.
fn same_when_moved(names: &[&str], motion: PlaneMotion) {
    let differences: Vec<String> = names.iter().flat_map(|name| differences(name, &motion)).collect();
    assert!(differences.is_empty(), "{differences:#?}");
}

fn differences(name: &str, motion: &PlaneMotion) -> Vec<String> {
    let scenario = bundled(name);
    let moved_scenario = motion.scenario(&scenario);
    let (first, moved) = (driven(&scenario), driven(&moved_scenario));
    let described = |run: &Run| {
        let checks = run.verdict.checks.iter().map(|c| (c.name, c.status));
        format!("{} {:?} {:?}", run.outcome.name(), run.reason, checks.collect::<Vec<_>>())
    };
    let mut found = Vec::new();
    if described(&first) != described(&moved) {
        found.push(format!("{name}: {} instead of {}", described(&moved), described(&first)));
    }
    found.extend(motion_differences(name, &first, &moved, motion));
    found.extend(metric_differences(name, &metrics(&first), &metrics(&moved)));
    found
}

/// The first and the largest difference beyond the tolerances, sample by sample.
fn motion_differences(name: &str, first: &Run, moved: &Run, motion: &PlaneMotion) -> Option<String> {
    let mut begins = None;
    let mut worst = [0.0_f64; 3];
    for (a, b) in first.log.samples.iter().zip(&moved.log.samples) {
        let expected = motion.pose(&a.pose);
        let difference = [
            (b.pose.position - expected.position).norm(),
            wrap_angle(b.pose.yaw - expected.yaw).abs(),
            (a.speed - b.speed).abs(),
        ];
        if difference.iter().zip([PATH_TOLERANCE, PATH_TOLERANCE, SPEED_TOLERANCE]).any(|(d, most)| *d > most) {
            begins.get_or_insert(a.time);
        }
        worst = std::array::from_fn(|i| worst[i].max(difference[i]));
    }
    let [distance, turn, speed] = worst;
    println!("{name}: at most {distance:.2e} m, {turn:.2e} rad, {speed:.2e} m/s apart");
    begins.map(|t| format!("{name}: differs from {t:.2} s on, at most {distance:.4} m, {turn:.4} rad, {speed:.4} m/s"))
}

fn metric_differences(name: &str, first: &Metrics, moved: &Metrics) -> Vec<String> {
    let named = |m: &Metrics| serde_json::to_value(m).unwrap();
    let (first, moved) = (named(first), named(moved));
    let tolerance = |key: &str| match key {
        "duration_s" => TIME_TOLERANCE,
        "kept_plans" | "plan_switches_per_minute" => 0.0,
        key if key.contains("acceleration") || key.contains("jerk") => ACCELERATION_TOLERANCE,
        key if key.contains("speed") => SPEED_TOLERANCE,
        _ => PATH_TOLERANCE,
    };
    let differs = |(key, value): (&String, &serde_json::Value)| {
        let same = match (value.as_f64(), moved[key].as_f64()) {
            (Some(a), Some(b)) => (a - b).abs() <= tolerance(key),
            (a, b) => a == b,
        };
        (!same).then(|| format!("{name}: {key} is {} instead of {value}", moved[key]))
    };
    first.as_object().unwrap().iter().filter_map(differs).collect()
}

const UTM: PlaneMotion = PlaneMotion { shift: Vector::new(1.0e6, 1.0e6), ..PlaneMotion::NONE };
const ROTATED: PlaneMotion = PlaneMotion { turn: 2.5, ..PlaneMotion::NONE };
const MIRRORED: PlaneMotion = PlaneMotion { is_mirrored: true, ..PlaneMotion::NONE };

#[test]
fn utm_coordinates_change_nothing() {
    same_when_moved(&STATIC, UTM);
}

#[test]
fn utm_coordinates_change_nothing_with_traffic() {
    same_when_moved(&TRAFFIC, UTM);
}

#[test]
fn a_mirrored_map_gives_the_mirrored_run() {
    same_when_moved(&STATIC, MIRRORED);
}

#[test]
fn a_mirrored_map_gives_the_mirrored_run_with_traffic() {
    same_when_moved(&TRAFFIC, MIRRORED);
}

#[test]
fn a_rotated_map_changes_nothing() {
    same_when_moved(&STATIC, ROTATED);
}

#[test]
fn a_rotated_map_changes_nothing_with_traffic() {
    same_when_moved(&TRAFFIC, ROTATED);
}

#[test]
fn mirroring_rotation_and_translation_together_change_nothing() {
    let motion = PlaneMotion { is_mirrored: true, turn: -1.1, shift: Vector::new(-6.9e5, 5.3e6) };
    same_when_moved(&["parked_car", "slalom", "turn_90"], motion);
}

/// Checks the helper: a motion that omits something would make the tests above compare different scenarios.
#[test]
fn mirroring_is_its_own_inverse_and_not_the_identity() {
    let motion = MIRRORED;
    for name in STATIC.iter().chain(&TRAFFIC) {
        let scenario = bundled(name);
        let once = motion.scenario(&scenario);
        let described =
            |s: &Scenario| format!("{:?} {:?} {:?}", s.network, s.obstacles, s.problems).replace("-0.0", "0.0");
        assert_eq!(described(&motion.scenario(&once)), described(&scenario), "{name}");
        // a straight lane with all objects on its centre line is symmetric
        let is_symmetric = ["straight_100m", "slow_lead", "lead_brakes_hard"].contains(name);
        assert!(is_symmetric || described(&once) != described(&scenario), "{name}: not mirrored");
        for lanelet in once.network.lanelets.values() {
            let (left, right) =
                (lanelet.centre.project(lanelet.left.first()), lanelet.centre.project(lanelet.right.first()));
            assert!(left.offset > 0.0 && right.offset < 0.0, "{name}: lanelet {} has swapped bounds", lanelet.id);
        }
    }
}

/// All logged numbers and decisions, bit by bit.
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
            s.reference_pose.position.x,
            s.reference_pose.position.y,
            s.reference_station,
        ]
    });
    let decisions =
        run.cycles.iter().map(|c| (c.plan.decision, c.trace.chosen, c.trace.candidates.len(), c.trace.expansions));
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
        assert!(one.1.len() > 1000, "{name}: the run is too short");
        assert!(one == with_threads(1), "{name}: a second run differs");
        assert!(one == with_threads(2), "{name}: two threads differ from one");
    }
}

/// Checks that the comparison above distinguishes runs.
#[test]
fn another_friction_gives_other_bits() {
    let scenario = bundled("straight_100m");
    let mut settings = Settings::default();
    settings.simulation.friction_scale = 0.9;
    let slippery = drive(&scenario, &scenario.problems[0], &VEHICLE, &settings, &mut |_, _| {}).unwrap();
    assert!(bits(&driven(&scenario)) != bits(&slippery));
}
