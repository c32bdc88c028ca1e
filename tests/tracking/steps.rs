//! Steps of braking: deceleration claimed by the profile and deceleration driven, as the verdict filters it; position of the
//! stop. The check `fallback_stops` allows a tenth more than the claim.

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
    /// Largest filtered deceleration, m/s².
    deceleration: f64,
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
    Driven { deceleration: filtered.iter().fold(0.0, |m, a| m.max(-a)), error: end.to_local(last.pose.position).x }
}

/// Share by which the filtered deceleration may exceed the profile's: that of the verdict.
const MARGIN: f64 = 0.1;
/// Limit of the stop error behind a step that is known a lag of the brakes ahead, m.
const STOP: f64 = 0.05;

/// Whether drag and rolling resistance leave the brakes something to do.
fn is_braked(v: &Vehicle, claimed: f64, speed: f64) -> bool {
    v.tyres.drag * speed * speed / v.mass + 1.0 < claimed
}

#[test]
fn stops_that_begin_with_a_step_brake_no_harder_than_promised() {
    for name in vehicle::builtin_names() {
        let v = vehicle::load(name).unwrap();
        for friction in [1.0, 0.6, 0.15] {
            let limit = ProofLimits::new(&v, friction).deceleration();
            for claimed in [2.0, 4.0, 6.0, 8.0].into_iter().filter(|c| *c < limit).chain([limit]) {
                for speed in [5.0, 10.0, 20.0].into_iter().filter(|speed| is_braked(&v, claimed, *speed)) {
                    for at in [0.0, 0.3] {
                        let step = Step { claimed, speed, at, friction, mismatch: Mismatch::None };
                        let driven = drive(&v, &step);
                        assert!(driven.deceleration <= (1.0 + MARGIN) * claimed, "{name} {step:?}: {driven:?}");
                        // a step at the first instant costs at most the distance driven during the lag
                        let late = if at == 0.0 { speed * v.actuators.brake_lag } else { 0.0 };
                        assert!(driven.error > -STOP && driven.error < late + STOP, "{name} {step:?}: {driven:?}");
                    }
                }
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
            for at in [0.0, 0.3] {
                for friction in [1.0, 0.6, 0.15] {
                    let mut cells = Vec::new();
                    for share in [2.0, 4.0, 6.0, 8.0, 0.0] {
                        let limit = ProofLimits::new(&v, friction).deceleration();
                        let claimed = if share == 0.0 { limit } else { share };
                        if claimed > limit {
                            continue;
                        }
                        let speeds = [5.0, 10.0, 20.0].into_iter().filter(|speed| is_braked(&v, claimed, *speed));
                        let stop = |speed| drive(&v, &Step { claimed, speed, at, friction, mismatch });
                        let all: Vec<Driven> = speeds.map(stop).collect();
                        let most = all.iter().map(|d| d.deceleration).fold(0.0, f64::max);
                        let errors: Vec<String> = all.iter().map(|d| format!("{:+.2}", d.error)).collect();
                        let errors = errors.join(" ");
                        cells.push(format!("{claimed:.2}→{most:.2} ({:.2}) {errors}", most / claimed));
                    }
                    println!("{name:12} {mismatch:?} step at {at} friction {friction}: {}", cells.join(" | "));
                }
            }
        }
    }
}
