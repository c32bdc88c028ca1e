//! The library without the command line: wrong settings are errors, whichever function receives them.

mod common;

use common::{VEHICLE, bundled};
use stopline::collision::{Allowance, CollisionSettings};
use stopline::fixtures::straight_lanelet;
use stopline::lattice::{self, EdgeStore, Lattice, LatticeContext, Root};
use stopline::planner::{self, Planner};
use stopline::reference::{ReferenceFailure, ReferenceLine, ReferenceSettings};
use stopline::speed::smoothing::{self, Smoother, raw_profile};
use stopline::speed::{AccelerationLimits, Resolution, SpeedProblem, Strategy, search};
use stopline::{DriveError, Settings, drive, simulation};

/// The message of the planner about settings that `change` made wrong.
fn refusal(change: impl FnOnce(&mut planner::Settings)) -> String {
    let scenario = bundled("straight_100m");
    let mut settings = planner::Settings::default();
    change(&mut settings);
    let planner = Planner::new(scenario.map(), &VEHICLE, &settings);
    planner.err().expect("the settings are wrong").to_string()
}

#[test]
fn the_planner_refuses_settings_out_of_their_range() {
    for wrong in [0.0, -0.5, f64::NAN] {
        let message = refusal(|s| s.lattice.offset_spacing = wrong);
        assert_eq!(message, format!("setting `lattice.offset_spacing` is {wrong}, it must be positive and finite"));
    }
    assert!(refusal(|s| s.lattice.offset_spacing = 1e-9).starts_with("setting `lattice.offset_spacing` is 1e-9,"));
    assert!(refusal(|s| s.lattice.grid = 0.0).starts_with("setting `lattice.grid` is 0,"));
    assert!(refusal(|s| s.lattice.layers = usize::MAX).starts_with("setting `lattice.layers` is"));
    assert!(refusal(|s| s.lattice.headings.clear()).starts_with("setting `lattice.headings` has 0 entries,"));
    assert!(refusal(|s| s.collision.spacing = 0.0).starts_with("setting `collision.spacing` is 0,"));
    assert!(refusal(|s| s.refinement.iterations = 0).starts_with("setting `refinement.iterations` is 0,"));
    assert!(refusal(|s| s.uncertainty.lateral = -1.0).starts_with("setting `uncertainty.lateral` is -1,"));
    assert!(refusal(|s| s.emergency[1].deceleration = 0.0).starts_with("setting `emergency[1].deceleration` is 0,"));
    assert!(refusal(|s| s.jerk = 0.0).starts_with("setting `jerk` is 0,"));
}

#[test]
fn a_drive_refuses_wrong_settings_of_every_stage() {
    let scenario = bundled("straight_100m");
    let refused = |change: &dyn Fn(&mut Settings)| {
        let mut settings = Settings::default();
        change(&mut settings);
        let driven = drive::drive(&scenario, &scenario.problems[0], &VEHICLE, &settings, &mut |_, _| {});
        let Err(DriveError::Settings(error)) = driven else { panic!("not refused as a setting") };
        error.field
    };
    assert_eq!(refused(&|s| s.planner.lattice.offset_spacing = 0.0), "planner.lattice.offset_spacing");
    assert_eq!(refused(&|s| s.simulation.step = 0.0), "simulation.step");
    assert_eq!(refused(&|s| s.verdict.fallbacks.interval = 0.0), "verdict.fallbacks.interval");
    assert_eq!(refused(&|s| s.faults.mass = f64::NAN), "faults.mass");
    assert_eq!(refused(&|s| s.run.replan_interval = 0.0), "run.replan_interval");
    let no_road = simulation::FrictionRegion { factor: 0.5, polygon: vec![] };
    assert_eq!(refused(&|s| s.friction = vec![no_road.clone()]), "friction[0].polygon");
    // the least of several numbers would skip one that is none
    let polygon = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
    let no_number = simulation::FrictionRegion { factor: f64::NAN, polygon };
    assert_eq!(refused(&|s| s.friction = vec![no_number.clone()]), "friction[0].factor");
    assert_eq!(refused(&|s| s.observation.sensor.range = -1.0), "observation.sensor.range");
    assert_eq!(refused(&|s| s.observation.prediction_horizon = f64::NAN), "observation.prediction_horizon");
}

fn network() -> stopline::map::RoadNetwork {
    stopline::fixtures::network([straight_lanelet(1, (0.0, 100.0), -1.75, 1.75)])
}

#[test]
fn a_lattice_refuses_wrong_settings() {
    let scenario = stopline::fixtures::scenario(network(), vec![]);
    let reference = ReferenceLine::new(&scenario.network, &[1], VEHICLE.width, &ReferenceSettings::default()).unwrap();
    let world = stopline::fixtures::collision_world(&scenario, &VEHICLE, &CollisionSettings::default(), 0.0);
    let context = LatticeContext {
        reference: &reference,
        world: &world,
        margins: CollisionSettings::default().margins(),
        max_curvature: VEHICLE.max_curvature(),
        full_speed_curvature: f64::INFINITY,
        half_width: 0.5 * VEHICLE.width,
        target: None,
    };
    let start = reference.offset_pose(10.0, 0.0).unwrap().pose;
    let root = Root { pose: start, curvature: 0.0, kept: vec![], start, allowance: Allowance::NONE };
    let lattice = Lattice::new(lattice::Settings::default()).unwrap();
    assert!(!lattice.search(&context, &root, 8.0, 40.0, &mut EdgeStore::default()).paths.is_empty());
    let refused = |settings: lattice::Settings| Lattice::new(settings).unwrap_err().field;
    assert_eq!(refused(lattice::Settings { offset_spacing: 0.0, ..lattice::Settings::default() }), "offset_spacing");
    let mut wrong = lattice::Settings::default();
    wrong.weights.curvature = -1.0;
    assert_eq!(refused(wrong), "weights.curvature");
}

#[test]
fn a_reference_line_refuses_wrong_settings() {
    for spacing in [0.0, -1.0, 1e-12, f64::NAN] {
        let settings = ReferenceSettings { spacing, ..ReferenceSettings::default() };
        let Err(ReferenceFailure::Settings(error)) = ReferenceLine::new(&network(), &[1], 1.8, &settings) else {
            panic!("not refused")
        };
        assert_eq!(error.field, "spacing");
    }
}

#[test]
fn smoothing_refuses_wrong_settings() {
    let limits = AccelerationLimits { acceleration: 1.5, deceleration: 2.0, aggressive_deceleration: 4.0 };
    let problem = SpeedProblem::empty_road(60.0, 0.5, 10.0, 5.0, limits).unwrap();
    let found = search(&problem, Strategy::SafeTlp, &Resolution::default()).unwrap();
    let raw = raw_profile(&problem, &found.proven().expect("a plan")).unwrap();
    let smoother = |step: f64| Smoother::new(smoothing::Settings { step, ..smoothing::Settings::default() });
    let smooth = smoother(0.2).unwrap().smooth_and_prove(&problem, &problem.speed_limits, &raw, 0.0);
    assert_eq!(smooth.map(|s| s.is_firm), Ok(false));
    for wrong in [0.0, -0.2, f64::NAN] {
        assert_eq!(smoother(wrong).unwrap_err().field, "step");
    }
}
