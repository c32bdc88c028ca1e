//! **stopline**: a local planner for road vehicles that commits only to trajectories with a proven stop, and a vehicle
//! simulation that validates them.
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
//! | [`simulation`], [`verdict`], [`drive`], [`regression`] | validation |
//! | [`result`](mod@result), [`plot`], `recording` (feature `rerun`), [`bench`](mod@bench), [`cli`] | output, comparisons and the command line |
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
