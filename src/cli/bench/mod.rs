//! `stopline bench`: arguments and outputs of the comparisons; the measuring is in [`crate::bench`].

mod spirals;

use super::args::Comparison;
use super::{Exit, Failure};

/// Runs a comparison.
pub(super) fn run(comparison: Comparison) -> Result<Exit, Failure> {
    match comparison {
        Comparison::Spirals(args) => spirals::run(args),
    }
}
