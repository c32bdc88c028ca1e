//! Faults on purpose: with each of them every story of `maps/` ends without a contact, or as the table of `docs/verdict.md`
//! says; the planner never knows, and the same fault gives the same run.

mod common;

use common::{VEHICLE, bundled, failures};
use stopline::drive::{Faults, Outcome, Run, Settings, drive};
use stopline::map::Scenario;

fn with<'a>(scenario: &'a Scenario, faults: &[&str], seed: u64) -> Run<'a> {
    let mut settings = Settings::default();
    for fault in faults {
        settings.faults.inject(fault).unwrap();
    }
    settings.faults.seed = seed;
    drive(scenario, &scenario.problems[0], &VEHICLE, &settings, &mut |_, _| {}).unwrap()
}

fn broken(run: &Run) -> Vec<&'static str> {
    run.verdict.failures().map(|c| c.name).collect()
}

/// The stories with obstacles, in which something can be touched.
const TRAFFIC: [&str; 5] = ["parked_car", "slalom", "lead_brakes_hard", "pedestrian", "lane_blocked"];

#[test]
fn more_mass_and_missed_cycles_break_no_promise() {
    for name in TRAFFIC {
        let scenario = bundled(name);
        for fault in ["mass=1.2", "missed_cycles=3"] {
            let run = with(&scenario, &[fault], 0);
            assert!(run.verdict.pass(), "{name}, {fault}: {:#?}", failures(&run));
        }
    }
}

#[test]
fn all_faults_at_once_touch_nothing() {
    let all = ["delay=0.2", "friction=0.6", "mass=1.2", "noise=0.1", "missed_cycles=3"];
    for name in TRAFFIC {
        let scenario = bundled(name);
        let run = with(&scenario, &all, 0);
        assert!(run.faults.is_any());
        assert_ne!(run.outcome, Outcome::Collision, "{name}: {:#?}", failures(&run));
        assert!(!broken(&run).contains(&"no_contact"), "{name}: {:#?}", failures(&run));
    }
}

/// On ice the run itself may end well, and its fallbacks would not have: nobody but the branches sees it.
#[test]
fn ice_is_seen_by_the_fallbacks_where_the_run_itself_ends_well() {
    let scenario = bundled("pedestrian");
    let run = with(&scenario, &["friction=0.2"], 0);
    assert_eq!(broken(&run), ["fallback_stops"], "{:#?}", failures(&run));
}

#[test]
fn dead_time_is_felt_in_tracking_and_comfort() {
    let scenario = bundled("s_curve");
    let run = with(&scenario, &["delay=0.2"], 0);
    let broken = broken(&run);
    assert!(broken.contains(&"tracking") && !broken.contains(&"stays_on_road"), "{:#?}", failures(&run));
}

#[test]
fn noise_comes_from_its_seed_alone() {
    let scenario = bundled("straight_100m");
    let [first, again, other] = [1, 1, 2].map(|seed| with(&scenario, &["noise=0.1"], seed).log);
    assert_eq!(first, again);
    assert_ne!(first, other);
    let [one, two] = [1, 2].map(|seed| with(&scenario, &[], seed).log);
    assert_eq!(one, two, "without noise the seed changes nothing");
}

/// FallbackBranches go their own way: with them or without them the run is the same to the last bit, and so are they for any number
/// of threads.
#[test]
fn forks_change_nothing_in_the_run_and_do_not_depend_on_threads() {
    let scenario = bundled("pedestrian");
    let problem = &scenario.problems[0];
    let go = |enabled, threads| {
        let mut settings = Settings::default();
        settings.verdict.fallbacks.enabled = enabled;
        settings.faults = Faults { noise: 0.05, delay: 0.05, ..Faults::default() };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| drive(&scenario, problem, &VEHICLE, &settings, &mut |_, _| {})).unwrap()
    };
    let (with, without, parallel) = (go(true, 1), go(false, 1), go(true, 3));
    assert_eq!(with.log, without.log);
    assert!(with.fallbacks.len() > 20 && without.fallbacks.is_empty());
    assert!(without.verdict.checks.iter().all(|c| c.name != "fallback_stops"));
    assert_eq!(with.fallbacks, parallel.fallbacks);
    assert_eq!(with.verdict, parallel.verdict);
}
