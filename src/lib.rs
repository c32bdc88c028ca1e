//! **stopline**: a local planner for road vehicles that commits only to trajectories with a proven stop, and a vehicle
//! simulation that validates them.
//!
//! # A tour
//!
//! ```
//! use std::path::Path;
//!
//! use stopline::{Outcome, Settings, drive, io, vehicle};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let vehicle = vehicle::load("bmw_320i")?; // or a folder of your own
//! let scenario = io::commonroad::read_file(Path::new("maps/straight_100m.xml"))?;
//! let problem = &scenario.problems[0];
//! let mut settings = Settings::default();
//! settings.planner.cruise_speed = 8.0; // m/s
//!
//! // one planning cycle: a trajectory that ends at a standstill
//! let plan = drive::plan(&scenario, problem, &vehicle, &settings)?;
//! assert_eq!(plan.outcome, Outcome::Planned);
//! let trajectory = &plan.cycles[0].plan.trajectory;
//! assert_eq!(trajectory.at(trajectory.end_time()).speed, 0.0);
//!
//! // the closed loop: ten cycles a second, executed by the simulated vehicle
//! let run = drive::drive(&scenario, problem, &vehicle, &settings, &mut |_time, _latest_end| {})?;
//! println!("{} after {} cycles", run.outcome, run.cycles.len());
//!
//! // what the recorded motion says about it
//! for check in &run.verdict.checks {
//!     println!("{:<4} {:<20} {}", check.status, check.name, check.note);
//! }
//! assert!(run.verdict.pass());
//!
//! // a setting out of its range is an error
//! settings.planner.lattice.offset_spacing = 0.0;
//! let error = drive::plan(&scenario, problem, &vehicle, &settings).err().expect("refused");
//! assert_eq!(error.to_string(), "setting `planner.lattice.offset_spacing` is 0, it must be positive and finite");
//! # Ok(())
//! # }
//! ```
//!
//! [`Planner`] plans cycle by cycle, from any state. [`drive::drive_with`] takes another planner or controller. [`fixtures`]
//! builds small scenarios in code.
//!
//! # Overview
//!
//! Each planning cycle builds a lattice of paths along a smoothed reference line ([`reference`](mod@reference),
//! [`lattice`]), checks swept footprints against road and obstacles ([`collision`]), and searches a speed profile with
//! a stopping proof for the candidate paths ([`speed`]). The result is a [`trajectory::Trajectory`]: a nominal prefix
//! and a fallback that ends at standstill. If no new plan can be proven, the planner keeps the previous plan and its
//! proven stop ([`planner`]).
//!
//! [`drive`] closes the loop: it replans at 10 Hz and executes each plan in a rigid-body simulation with tyres,
//! actuators and a tracking controller ([`simulation`]). [`verdict`] judges the logged run by named checks. It shares
//! no code with the planner's collision checks, so it can contradict the planner.
//!
//! | modules | purpose |
//! |---|---|
//! | [`geometry`], [`convex`] | curves and convex programs |
//! | [`vehicle`], [`map`], [`io`] | vehicles, scenarios and their file formats |
//! | [`route`], [`reference`](mod@reference), [`lattice`], [`collision`], [`speed`], [`trajectory`], [`planner`] | planning |
//! | [`simulation`], [`verdict`], [`drive`], `regression` | validation |
//! | [`result`](mod@result), [`plot`], `recording`, [`bench`](mod@bench), `cli` | output, comparisons and the command line |
//! | [`settings`] | ranges of settings; each settings type has a method `validate` |
//!
//! # Features
//!
//! Without features (`default-features = false`) the library plans, drives and judges. The features add modules: `images`
//! (`io::ros_map`, occupancy grids of ROS), `regression` (suites and their reports), `rerun` (`recording`) and `cli` (the
//! command line, with `images` and `regression`). The defaults are `cli` and `rerun`.
//!
//! # Conventions
//!
//! - SI units, radians, seconds. `x` points forward or east, `y` left or north; yaw is counter-clockwise from `x`.
//! - Lateral offset, curvature and steering angle are positive to the left.
//! - A vehicle pose is that of the rear-axle centre. Readers and writers of files convert it.
//! - Results are deterministic: the same input gives the same bytes for any number of threads. Budgets are counts, not
//!   times.
//! - The absence of a plan is an outcome with a reason, not an error.

pub mod bench;
#[cfg(feature = "cli")]
pub mod cli;
pub mod collision;
pub mod convex;
pub mod drive;
pub mod fixtures;
pub mod geometry;
pub mod io;
pub mod lattice;
pub mod map;
mod names;
mod number;
pub mod planner;
pub mod plot;
#[cfg(feature = "rerun")]
pub mod recording;
pub mod reference;
#[cfg(feature = "regression")]
pub mod regression;
pub mod result;
pub mod route;
pub mod settings;
pub mod simulation;
pub mod speed;
pub mod trajectory;
pub mod vehicle;
pub mod verdict;
mod workers;

pub use drive::{DriveError, Outcome, Run, Settings};
pub use map::{PlanningProblem, Scenario};
pub use planner::{Cycle, Planner};
pub use settings::SettingsError;
pub use simulation::Log;
pub use trajectory::Trajectory;
pub use vehicle::{State, Vehicle};
pub use verdict::{Check, Status, Verdict};
