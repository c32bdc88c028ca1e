//! The promises of `docs/proof.md`, a test each. Each of these once broke: a proof was claimed that this vehicle could not keep on this
//! road, with what was known then.
//!
//! | What broke | Tests |
//! |---|---|
//! | stops that brakes and tyres cannot give, braking far beyond what is needed | [`braking`] |
//! | swerves that the vehicle cannot follow, a proven stop left for a riskier swerve | [`evading`] |
//! | roads left over sidewalks, in bends, round obstacles, and after a start beside them | [`road`] |
//! | proofs of an earlier cycle, of another place of the vehicle, of the mirrored world | [`observed`] |
//! | oncoming and leading vehicles, predictions that end, junctions, missed goals | [`traffic`] |
//!
//! Tests beside the code cover the parts: `vehicle::proof`, `planner::level`, `planner::tube`, `speed::prove`.

mod braking;
#[path = "../common/mod.rs"]
mod common;
mod evading;
mod observed;
mod road;
mod scenes;
mod traffic;
