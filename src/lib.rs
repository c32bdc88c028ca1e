//! **stopline**: a local planner for road vehicles that never commits to a trajectory it cannot stop from, and a physics
//! rig that checks that it was right.

pub mod bench;
pub mod cli;
pub mod collision;
pub mod convex;
pub mod drive;
pub mod fixtures;
pub mod geometry;
pub mod io;
pub mod lattice;
pub mod map;
pub mod planner;
pub mod plot;
#[cfg(feature = "rerun")]
pub mod recording;
pub mod reference;
pub mod regression;
pub mod result;
pub mod route;
pub mod simulation;
pub mod speed;
pub mod trajectory;
pub mod vehicle;
pub mod verdict;
