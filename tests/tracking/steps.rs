//! Steps of braking: deceleration claimed by the profile and deceleration driven; position of the stop. The check
//! `fallback_stops` filters the deceleration and allows a tenth more than the claim.

use std::sync::Arc;
use stopline::geometry::Pose;
use stopline::geometry::spiral::CubicSpiral;

use stopline::simulation::{Disturbances, Log, Sample, Settings, TrackingController, World};
use stopline::trajectory::{Path, Trajectory};
use stopline::vehicle::{self, ProofLimits, Vehicle};
use stopline::verdict::zero_phase_low_pass;

use super::{COMFORT_CUTOFF, RATE, profile, start};

/// Difference between the simulated vehicle and the controller's belief.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Mismatch {
    None,
    /// 20 % heavier.
    Heavy,
    /// 20 % lighter.
    Light,
    /// Commands arrive 0.1 s late.
    Late,
}

/// One stop that begins with a step of the acceleration.
#[derive(Debug, Clone, Copy)]
struct Step {
    /// Deceleration of the profile, m/s².
    claimed: f64,
    speed: f64,
    /// Time of the step, s.
    at: f64,
    friction: f64,
    mismatch: Mismatch,
}

#[derive(Debug, Clone, Copy)]
struct Driven {
    /// Largest deceleration, m/s².
    deceleration: f64,
    /// Largest deceleration as the verdict filters it, m/s².
    filtered: f64,
    /// Final position relative to the planned standstill, positive beyond it, m.
    error: f64,
}

fn drive(v: &Vehicle, step: &Step) -> Driven {
    let path = Path::new(Pose::new(0.0, 0.0, 0.7), &[CubicSpiral { knots: [0.0; 4], length: 500.0 }]).unwrap();
    let pieces = [(step.at, 0.0, 0.0), (step.speed / step.claimed, -step.claimed, 0.0)];
    let t = Trajectory { start_time: 0.0, path, profile: profile(step.speed, &pieces) };
    let factor = match step.mismatch {
        Mismatch::Heavy => 1.2,
        Mismatch::Light => 0.8,
        Mismatch::None | Mismatch::Late => 1.0,
    };
    let real = Vehicle { mass: factor * v.mass, yaw_inertia: factor * v.yaw_inertia, ..v.clone() };
    let disturbances = Disturbances {
        dead_time: if step.mismatch == Mismatch::Late { 0.1 } else { 0.0 },
        believed: (factor != 1.0).then(|| v.clone()),
        localisation: None,
    };
    let settings = Settings { friction_scale: step.friction, ..Settings::default() };
    let world = World::new(&real, &[], &start(t.at(0.0).pose, step.speed), &settings).unwrap();
    let mut world = world.disturbed(&disturbances).controlled_by(Arc::new(TrackingController::on_road(step.friction)));
    let mut log = Log::default();
    world.follow(&t, t.end_time() + 4.0, &mut log);
    let end = t.at(t.end_time()).pose;
    let acceleration: Vec<f64> = log.samples.iter().map(|s: &Sample| s.acceleration).collect();
    let filtered = zero_phase_low_pass(&acceleration, COMFORT_CUTOFF, RATE);
    let last = log.samples.last().unwrap();
    assert!(
        last.speed.abs() < 0.03 || step.mismatch == Mismatch::Light,
        "{} {step:?}: still moves at {} m/s",
        v.name,
        last.speed
    );
    let hardest = |accelerations: &[f64]| accelerations.iter().fold(0.0, |m, a| f64::max(m, -a));
    Driven {
        deceleration: hardest(&acceleration),
        filtered: hardest(&filtered),
        error: end.to_local(last.pose.position).x,
    }
}

/// Share by which the deceleration may exceed the profile's.
const MARGIN: f64 = 0.04;
/// The same for the filtered deceleration: that of the verdict, whose filter overshoots a step by 4 %.
const FILTERED_MARGIN: f64 = 0.1;
/// Limit of the stop error, m.
const STOP: f64 = 0.05;

/// Decelerations up to the limit of proofs, m/s².
fn claims(v: &Vehicle, friction: f64) -> Vec<f64> {
    let limit = ProofLimits::new(v, friction).deceleration();
    [2.0, 4.0, 6.0, 8.0].into_iter().filter(|claimed| *claimed < limit).chain([limit]).collect()
}

/// Speeds at which drag and rolling resistance leave the brakes something to do, m/s.
fn speeds(v: &Vehicle, claimed: f64) -> impl Iterator<Item = f64> {
    [5.0, 10.0, 20.0].into_iter().filter(move |speed| 1.5 * v.resistance(*speed) < claimed)
}

/// How long ahead the controller knows each step: plans begin with the motion before for this long, s.
fn lead(v: &Vehicle) -> f64 {
    v.actuators.brake_lag.max(v.actuators.drive_lag)
}

#[test]
fn steps_known_one_lag_ahead_keep_their_claim_and_their_stop() {
    for name in vehicle::builtin_names() {
        let v = vehicle::load(name).unwrap();
        for friction in [1.0, 0.6, 0.15] {
            for claimed in claims(&v, friction) {
                let mut stops = 0;
                for speed in speeds(&v, claimed) {
                    let step = Step { claimed, speed, at: lead(&v), friction, mismatch: Mismatch::None };
                    let driven = drive(&v, &step);
                    assert!(driven.deceleration <= (1.0 + MARGIN) * claimed, "{name} {step:?}: {driven:?}");
                    assert!(driven.filtered <= (1.0 + FILTERED_MARGIN) * claimed, "{name} {step:?}: {driven:?}");
                    assert!(driven.error.abs() <= STOP, "{name} {step:?}: {driven:?}");
                    stops += 1;
                }
                assert!(stops > 0, "{name} {claimed} m/s²: no stop");
            }
        }
    }
}

/// Prints the table of `docs/physics.md`.
#[test]
#[ignore = "prints a table"]
fn table_of_steps() {
    for name in vehicle::builtin_names() {
        let v = vehicle::load(name).unwrap();
        for mismatch in [Mismatch::None, Mismatch::Heavy, Mismatch::Light, Mismatch::Late] {
            for at in [0.0, lead(&v)] {
                for friction in [1.0, 0.6, 0.15] {
                    let mut cells = Vec::new();
                    for claimed in claims(&v, friction) {
                        let stop = |speed| drive(&v, &Step { claimed, speed, at, friction, mismatch });
                        let all: Vec<Driven> = speeds(&v, claimed).map(stop).collect();
                        let largest = |of: fn(&Driven) -> f64| all.iter().map(of).fold(0.0, f64::max) / claimed;
                        let (driven, filtered) = (largest(|d| d.deceleration), largest(|d| d.filtered));
                        let errors: Vec<String> = all.iter().map(|d| format!("{:+.2}", d.error)).collect();
                        let errors = errors.join(" ");
                        cells.push(format!("{claimed:.2}: {driven:.3} filtered {filtered:.3} stop {errors}"));
                    }
                    println!("{name:12} {mismatch:?} step at {at} friction {friction}: {}", cells.join(" | "));
                }
            }
        }
    }
}
