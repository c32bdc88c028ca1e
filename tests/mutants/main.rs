//! Mutation test of the verdict: planners and controllers with one fault each fail the check that covers the fault, and not only
//! the goal.
//!
//! Simulation and verdict use the true scenario. The same scenario without a fault, the twin, passes.

#[path = "../common/mod.rs"]
mod common;
mod controllers;
mod planners;

use std::collections::VecDeque;
use std::sync::Arc;

use common::{VEHICLE, bundled, failures};
use controllers::Flaw;
use planners::{Belief, Believer, Changed, Late, Once, unchanged};
use stopline::drive::{Driver, MotionPlanner, Run, Settings, drive_with};
use stopline::map::Scenario;
use stopline::planner::Cycle;
use stopline::simulation::TrackingController;
use stopline::vehicle::{Vehicle, load};
use stopline::verdict::ComfortPreset;

/// The kind of fault.
enum Mistake {
    /// The planner gets wrong inputs.
    Sees(fn(&mut Belief)),
    /// The plans are changed.
    HandsOut(fn(&mut Cycle)),
    /// Plans are late.
    IsLate,
    /// The planner never replans.
    PlansOnce,
    /// The planner predicts with constant velocity and keeps a proven plan without proving it again.
    Trusts,
    /// The planner gets wrong inputs on a slippery road.
    OnIce(fn(&mut Belief)),
    /// The plans are changed, in a run that begins too fast for the gentle levels.
    InAHurry(fn(&mut Cycle)),
    /// The controller has a fault.
    Controller(Flaw),
    /// No fault.
    None,
}

/// Drives with a fault.
fn driven<'a>(scenario: &'a Scenario, vehicle: &'a Vehicle, mistake: &Mistake) -> Run<'a> {
    let mut truth = Belief { scenario: scenario.clone(), vehicle: vehicle.clone(), settings: Settings::default() };
    if let Mistake::OnIce(_) = mistake {
        truth.settings.simulation.friction_scale = ICE;
    }
    if let Mistake::InAHurry(_) = mistake {
        // the limits of an emergency: 4 m/s², and no limit of jerk beyond the vehicle's
        truth.settings.verdict.comfort = ComfortPreset::R157;
    }
    let mut belief = truth.clone();
    match mistake {
        Mistake::Sees(change) | Mistake::OnIce(change) => change(&mut belief),
        Mistake::Trusts => planners::constant_velocity_prediction(&mut belief),
        _ => {}
    }
    let real = Believer::new(&belief);
    let change = match mistake {
        Mistake::HandsOut(change) | Mistake::InAHurry(change) => *change,
        _ => unchanged,
    };
    let mut mutant: Box<dyn MotionPlanner> = match mistake {
        Mistake::IsLate => Box::new(Late { planner: real, waiting: VecDeque::new() }),
        Mistake::PlansOnce | Mistake::Trusts => Box::new(Once { planner: real, first: None }),
        _ => Box::new(Changed { planner: real, change }),
    };
    let believed = TrackingController::on_road(belief.settings.believed_friction());
    let mut driver = Driver { planner: &mut *mutant, controller: Arc::new(believed) };
    if let Mistake::Controller(flaw) = mistake {
        driver.controller = Arc::new(*flaw);
    }
    drive_with(scenario, &scenario.problems[0], vehicle, &truth.settings, driver, &mut |_, _| {}).unwrap()
}

/// One mutant: the bundled scenario, the check that has to fail, and the fault.
fn is_caught(name: &str, on: &str, vehicle: &Vehicle, check: &str, mistake: &Mistake) {
    let mut scenario = bundled(on);
    let no_mistake = match mistake {
        Mistake::OnIce(_) => Mistake::OnIce(|_| ()),
        Mistake::InAHurry(_) => Mistake::InAHurry(unchanged),
        _ => Mistake::None,
    };
    if let Mistake::InAHurry(_) = mistake {
        scenario.problems[0].initial.speed = HURRY;
    }
    let twin = driven(&scenario, vehicle, &no_mistake);
    assert!(twin.verdict.pass(), "{name}: the twin on {on} fails: {:#?}", failures(&twin));
    let mutant = driven(&scenario, vehicle, mistake);
    let caught: Vec<&str> = mutant.verdict.failures().map(|c| c.name).collect();
    println!("{name} on {on}: {}, caught by {caught:?}", mutant.outcome.name());
    assert!(caught.contains(&check), "{name} on {on}: {check} passes, {caught:?} fail: {:#?}", failures(&mutant));
}

/// One test for each mutant, and the list of all.
macro_rules! mutants {
    ($($name:ident on $on:ident, $vehicle:expr, by $check:ident: $mistake:expr;)*) => {
        /// Name, scenario and check of every mutant.
        const MUTANTS: &[(&str, &str, &str)] = &[$((stringify!($name), stringify!($on), stringify!($check))),*];
        mod mutant {
            use super::*;
            $(#[test]
            fn $name() {
                is_caught(stringify!($name), stringify!($on), &$vehicle, stringify!($check), &$mistake);
            })*
        }
    };
}

/// A vehicle with a turning radius of 86 m.
fn stiff() -> Vehicle {
    let mut vehicle = VEHICLE.clone();
    vehicle.limits.steering = 0.03;
    vehicle
}

/// A vehicle whose passengers accept any jerk.
fn firm() -> Vehicle {
    let mut vehicle = VEHICLE.clone();
    vehicle.comfort.jerk = 10.0;
    vehicle
}

fn truck() -> Vehicle {
    load("truck").unwrap()
}

/// Speed at the start from which only an emergency level stops in front of `lane_blocked`, m/s.
const HURRY: f64 = 18.0;
/// Friction of ice.
const ICE: f64 = 0.15;

use Mistake::{Controller, HandsOut, InAHurry, IsLate, OnIce, PlansOnce, Sees, Trusts};

mutants! {
    obstacle_ignored on parked_car, VEHICLE, by no_contact: Sees(planners::no_obstacles);
    footprint_shrunk on slalom, VEHICLE, by no_contact: Sees(planners::a_fifth_as_wide);
    footprint_centred_on_rear_axle on lane_blocked, VEHICLE, by no_contact: Sees(planners::centre_for_rear_axle);
    prediction_frozen on cut_in, VEHICLE, by no_contact: Sees(planners::frozen_predictions);
    prediction_of_constant_velocity on lead_brakes_hard, VEHICLE, by no_contact: Sees(planners::constant_velocity);
    prediction_stale on pedestrian, VEHICLE, by no_contact: Sees(planners::stale_predictions);
    prediction_of_the_next_second on cut_in, VEHICLE, by no_contact: Sees(planners::early_predictions);
    observation_old on lead_brakes_hard, VEHICLE, by no_contact: Sees(planners::old_observation);
    obstacle_dropped_after_its_prediction on lead_brakes_hard, VEHICLE, by no_contact: Sees(planners::dropped_after_a_second);
    friction_believed_too_high on parked_car, VEHICLE, by fallback_stops: OnIce(planners::dry_road);
    committed_plan_not_verified on lead_brakes_hard, VEHICLE, by no_contact: Trusts;
    road_borders_ignored on lane_blocked, VEHICLE, by stays_on_road: Sees(planners::wider_road);
    curvature_bound_ignored on parked_car, stiff(), by claims_margin: Sees(planners::any_curvature);
    tube_halved on parked_car, truck(), by claims_margin: Sees(planners::half_the_tube);
    comfort_limits_doubled on straight_100m, VEHICLE, by comfort_longitudinal: Sees(planners::twice_the_comfort);
    lateral_limit_ignored on s_curve, VEHICLE, by comfort_lateral: Sees(planners::any_lateral_acceleration);
    goal_claimed_falsely on straight_100m, VEHICLE, by stop_needed: Sees(planners::another_goal);
    stop_proof_skipped on straight_100m, VEHICLE, by fallback_stops: HandsOut(planners::stop_proof_skipped);
    stop_later_than_proven on lane_blocked, VEHICLE, by fallback_stops: HandsOut(planners::stops_too_late);
    plan_without_an_end on straight_100m, VEHICLE, by stop_proven: HandsOut(planners::never_stops);
    deceleration_understated on straight_100m, VEHICLE, by fallback_stops: HandsOut(planners::deceleration_understated);
    level_reported_too_low on lane_blocked, firm(), by claims_deceleration: InAHurry(planners::gentlest_level);
    clock_half_a_second_early on straight_100m, VEHICLE, by comfort_jerk: HandsOut(planners::half_a_second_early);
    path_offset_to_the_left on slalom, VEHICLE, by tracking: HandsOut(planners::aside);
    path_mirrored on s_curve, VEHICLE, by stays_on_road: HandsOut(planners::mirrored);
    never_replans on straight_100m, VEHICLE, by stop_needed: PlansOnce;
    plans_late on straight_100m, VEHICLE, by comfort_jerk: IsLate;
    steering_feedback_of_the_wrong_sign on s_curve, VEHICLE, by stays_on_road: Controller(Flaw::WrongSign);
    controller_without_feed_forward on s_curve, VEHICLE, by tracking: Controller(Flaw::NoFeedForward);
    brakes_off on lane_blocked, VEHICLE, by no_contact: Controller(Flaw::NoBrakes);
    jerk_unbounded on straight_100m, VEHICLE, by comfort_jerk: Controller(Flaw::AllOrNothing);
    stop_past_the_line on straight_100m, VEHICLE, by fallback_stops: Controller(Flaw::HalfAMetreBehind);
}

/// The table in the docs and the list above agree.
#[test]
fn the_docs_list_every_mutant_with_its_check() {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/verdict.md");
    let text = std::fs::read_to_string(file).unwrap();
    let listed: Vec<(&str, &str, &str)> = text
        .lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.split('|').map(|cell| cell.trim().trim_matches('`')).collect();
            (cells.len() == 6 && MUTANTS.iter().any(|m| m.0 == cells[1])).then(|| (cells[1], cells[2], cells[4]))
        })
        .collect();
    assert_eq!(listed, MUTANTS);
    assert!(MUTANTS.len() >= 20);
}
