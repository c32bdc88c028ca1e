//! Fault injection: the bundled scenarios end without contact, or as the table of `docs/verdict.md` says. The planner does not
//! know the fault, and the same fault gives the same run.

mod common;

use common::{VEHICLE, bundled, failures};
use stopline::drive::{Faults, Outcome, Run, Settings, drive};
use stopline::map::Scenario;
use stopline::verdict::Status;

fn with_faults<'a>(scenario: &'a Scenario, faults: &[&str], seed: u64) -> Run<'a> {
    let mut settings = Settings::default();
    for fault in faults {
        settings.faults.inject(fault).unwrap();
    }
    settings.faults.seed = seed;
    drive(scenario, &scenario.problems[0], &VEHICLE, &settings, &mut |_, _| {}).unwrap()
}

fn failed(run: &Run) -> Vec<&'static str> {
    run.verdict.failures().map(|c| c.name).collect()
}

/// Scenarios with obstacles.
const TRAFFIC: [&str; 5] = ["parked_car", "slalom", "lead_brakes_hard", "pedestrian", "lane_blocked"];

#[test]
fn more_mass_and_missed_cycles_fail_no_check() {
    for name in TRAFFIC {
        let scenario = bundled(name);
        for fault in ["mass=1.2", "missed_cycles=3"] {
            let run = with_faults(&scenario, &[fault], 0);
            assert!(run.verdict.pass(), "{name}, {fault}: {:#?}", failures(&run));
        }
    }
}

#[test]
fn all_faults_together_cause_no_contact() {
    let all = ["delay=0.2", "friction=0.6", "mass=1.2", "noise=0.1", "missed_cycles=3"];
    for name in TRAFFIC {
        let scenario = bundled(name);
        let run = with_faults(&scenario, &all, 0);
        assert!(run.faults.is_any());
        assert_ne!(run.outcome, Outcome::Collision, "{name}: {:#?}", failures(&run));
        assert!(!failed(&run).contains(&"no_contact"), "{name}: {:#?}", failures(&run));
    }
}

/// On ice a run can pass every other check while its fallbacks would fail.
#[test]
fn ice_fails_the_fallbacks_of_a_run_that_ends_well() {
    let scenario = bundled("pedestrian");
    let run = with_faults(&scenario, &["friction=0.2"], 0);
    assert_eq!(failed(&run), ["fallback_stops"], "{:#?}", failures(&run));
}

#[test]
fn dead_time_fails_tracking_and_not_the_road() {
    let scenario = bundled("s_curve");
    let run = with_faults(&scenario, &["delay=0.25"], 0);
    let failed = failed(&run);
    assert!(failed.contains(&"tracking") && !failed.contains(&"stays_on_road"), "{:#?}", failures(&run));
}

#[test]
fn noise_depends_on_its_seed_alone() {
    let scenario = bundled("straight_100m");
    let [first, again, other] = [1, 1, 2].map(|seed| with_faults(&scenario, &["noise=0.1"], seed).log);
    assert_eq!(first, again);
    assert_ne!(first, other);
    let [one, two] = [1, 2].map(|seed| with_faults(&scenario, &[], seed).log);
    assert_eq!(one, two, "without noise the seed has no effect");
}

/// A run is the same to the bit with and without fallback branches, and the branches are the same for any number of threads.
#[test]
fn fallback_branches_change_neither_the_run_nor_with_the_number_of_threads() {
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
    let off = without.verdict.checks.iter().find(|c| c.name == "fallback_stops").unwrap();
    assert_eq!(off.status, Status::NotApplicable);
    assert_eq!(with.fallbacks, parallel.fallbacks);
    assert_eq!(with.verdict, parallel.verdict);
}
