//! The verdict's own test: planners and controllers with one thing wrong, each in a world where nothing else is, are caught;
//! and by the promise that they break, not by a goal that they happen to miss.
//!
//! Rig and verdict keep the true world. The same scenario with nothing wrong passes: the twin.

#[path = "../common/mod.rs"]
mod common;
mod controllers;
mod planners;

use std::collections::VecDeque;
use std::sync::Arc;

use common::{VEHICLE, bundled, failures};
use controllers::Flaw;
use planners::{Belief, Late, Meddled, Once, nothing};
use stopline::drive::{Driver, MotionPlanner, Run, Settings, drive_with, planner};
use stopline::map::Scenario;
use stopline::planner::Cycle;
use stopline::vehicle::Vehicle;

/// Where the mistake is.
enum Mistake {
    /// The planner sees another world.
    Sees(fn(&mut Belief)),
    /// The planner hands out another plan than it made.
    HandsOut(fn(&mut Cycle)),
    /// MotionPlanner reach the vehicle late.
    IsLate,
    /// The first plan is the last one.
    PlansOnce,
    /// The controller does something else.
    Controller(Flaw),
    /// Nowhere.
    None,
}

/// Drives with a mistake.
fn driven<'a>(scenario: &'a Scenario, vehicle: &'a Vehicle, mistake: &Mistake) -> Run<'a> {
    let truth = Belief { scenario: scenario.clone(), vehicle: vehicle.clone(), settings: Settings::default() };
    let mut belief = truth.clone();
    if let Mistake::Sees(change) = mistake {
        change(&mut belief);
    }
    let problem = &belief.scenario.problems[0];
    let real = planner(&belief.scenario, problem, &belief.vehicle, &belief.settings).unwrap();
    let meddle = if let Mistake::HandsOut(meddle) = mistake { *meddle } else { nothing };
    let mut plans: Box<dyn MotionPlanner> = match mistake {
        Mistake::IsLate => Box::new(Late { planner: real, waiting: VecDeque::new() }),
        Mistake::PlansOnce => Box::new(Once { planner: real, first: None }),
        _ => Box::new(Meddled { planner: real, meddle }),
    };
    let mut driver = Driver::following(&mut *plans);
    if let Mistake::Controller(flaw) = mistake {
        driver.controller = Arc::new(*flaw);
    }
    drive_with(scenario, &scenario.problems[0], vehicle, &truth.settings, driver, &mut |_, _| {}).unwrap()
}

/// One mutant: the bundled scenario, the check that has to catch it, and what is wrong.
fn is_caught(name: &str, story: &str, vehicle: &Vehicle, check: &str, mistake: &Mistake) {
    let scenario = bundled(story);
    let twin = driven(&scenario, vehicle, &Mistake::None);
    assert!(twin.verdict.pass(), "{name}: the twin on {story} fails: {:#?}", failures(&twin));
    let mutant = driven(&scenario, vehicle, mistake);
    let caught: Vec<&str> = mutant.verdict.failures().map(|c| c.name).collect();
    println!("{name} on {story}: {}, caught by {caught:?}", mutant.outcome.name());
    assert!(
        caught.contains(&check),
        "{name} on {story}: {check} does not see it, {caught:?} do: {:#?}",
        failures(&mutant)
    );
}

/// One test for each mutant, and the list of all.
macro_rules! mutants {
    ($($name:ident on $story:ident, $vehicle:expr, by $check:ident: $mistake:expr;)*) => {
        /// Name, scenario and check of every mutant.
        const MUTANTS: &[(&str, &str, &str)] = &[$((stringify!($name), stringify!($story), stringify!($check))),*];
        mod mutant {
            use super::*;
            $(#[test]
            fn $name() {
                is_caught(stringify!($name), stringify!($story), &$vehicle, stringify!($check), &$mistake);
            })*
        }
    };
}

/// A vehicle that turns its wheels hardly at all: no circle tighter than 86 m.
fn stiff() -> Vehicle {
    let mut vehicle = VEHICLE.clone();
    vehicle.limits.steering = 0.03;
    vehicle
}

use Mistake::{Controller, HandsOut, IsLate, PlansOnce, Sees};

mutants! {
    obstacle_ignored on parked_car, VEHICLE, by no_contact: Sees(planners::no_obstacles);
    footprint_shrunk on slalom, VEHICLE, by no_contact: Sees(planners::a_third_as_wide);
    centre_taken_for_rear_axle on lane_blocked, VEHICLE, by no_contact: Sees(planners::centre_for_rear_axle);
    prediction_frozen on cut_in, VEHICLE, by no_contact: Sees(planners::frozen_predictions);
    prediction_of_constant_velocity on lead_brakes_hard, VEHICLE, by no_contact: Sees(planners::constant_velocity);
    prediction_stale on pedestrian, VEHICLE, by no_contact: Sees(planners::stale_predictions);
    prediction_of_the_next_second on cut_in, VEHICLE, by no_contact: Sees(planners::early_predictions);
    road_borders_ignored on lane_blocked, VEHICLE, by stays_on_road: Sees(planners::wider_road);
    curvature_bound_ignored on parked_car, stiff(), by tracking: Sees(planners::any_curvature);
    comfort_limits_doubled on straight_100m, VEHICLE, by comfort_longitudinal: Sees(planners::twice_the_comfort);
    lateral_limit_ignored on s_curve, VEHICLE, by comfort_lateral: Sees(planners::any_lateral_acceleration);
    goal_claimed_falsely on straight_100m, VEHICLE, by stop_needed: Sees(planners::another_goal);
    stop_proof_skipped on straight_100m, VEHICLE, by fallback_stops: HandsOut(planners::stop_proof_skipped);
    stop_later_than_proven on lane_blocked, VEHICLE, by fallback_stops: HandsOut(planners::stops_too_late);
    plan_without_an_end on straight_100m, VEHICLE, by stop_proven: HandsOut(planners::never_stops);
    deceleration_understated on straight_100m, VEHICLE, by fallback_stops: HandsOut(planners::promises_too_much);
    clock_half_a_second_early on straight_100m, VEHICLE, by comfort_jerk: HandsOut(planners::half_a_second_early);
    path_a_foot_aside on slalom, VEHICLE, by tracking: HandsOut(planners::aside);
    path_mirrored on s_curve, VEHICLE, by stays_on_road: HandsOut(planners::mirrored);
    replans_never on straight_100m, VEHICLE, by stop_needed: PlansOnce;
    plans_late on straight_100m, VEHICLE, by comfort_jerk: IsLate;
    steering_feedback_of_the_wrong_sign on s_curve, VEHICLE, by tracking: Controller(Flaw::WrongSign);
    controller_without_feed_forward on s_curve, VEHICLE, by tracking: Controller(Flaw::NoFeedForward);
    brakes_off on lane_blocked, VEHICLE, by no_contact: Controller(Flaw::NoBrakes);
    jerk_unbounded on straight_100m, VEHICLE, by comfort_jerk: Controller(Flaw::AllOrNothing);
    stop_past_the_line on straight_100m, VEHICLE, by stops: Controller(Flaw::HalfAMetreBehind);
}
/// The table of the docs and this file's are the same.
#[test]
fn the_docs_tell_every_mutant_and_by_what_it_is_caught() {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/verdict.md");
    let text = std::fs::read_to_string(file).unwrap();
    let told: Vec<(&str, &str, &str)> = text
        .lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.split('|').map(|cell| cell.trim().trim_matches('`')).collect();
            (cells.len() == 6 && MUTANTS.iter().any(|m| m.0 == cells[1])).then(|| (cells[1], cells[2], cells[4]))
        })
        .collect();
    assert_eq!(told, MUTANTS);
    assert!(MUTANTS.len() >= 20);
}
