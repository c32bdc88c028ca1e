//! `stopline bench`: arguments and outputs of the comparisons in [`crate::bench`].

mod commonroad;
mod fallbacks;
mod safetlp;
mod spirals;

use serde_json::{Value, json};

use super::args::Comparison;
use super::{Exit, Failure, report};
use crate::bench::Check;
use crate::verdict::Status;

/// Runs a comparison.
pub(super) fn run(comparison: Comparison) -> Result<Exit, Failure> {
    match comparison {
        Comparison::Commonroad(args) => commonroad::run(args),
        Comparison::Fallbacks(args) => fallbacks::run(args),
        Comparison::Safetlp(args) => safetlp::run(args),
        Comparison::Spirals(args) => spirals::run(args),
    }
}

fn all_pass(checks: &[Check]) -> bool {
    checks.iter().all(|c| c.status == Status::Pass)
}

fn check_json(check: &Check) -> Value {
    let Check { name, status, value, limit, unit } = check;
    json!({ "name": name, "status": status.name(), "value": value, "limit": limit, "unit": unit })
}

/// The checks as a text table.
fn check_table(checks: &[Check]) -> String {
    let head = ["check", "", "value", "limit", "unit"].map(str::to_owned).to_vec();
    let row = |c: &Check| {
        let value = if c.value.is_nan() { "-".to_owned() } else { format!("{:.3e}", c.value) };
        [c.name, &c.status.to_string(), &value, &format!("{:.3e}", c.limit), c.unit].map(str::to_owned).to_vec()
    };
    report::table(&std::iter::once(head).chain(checks.iter().map(row)).collect::<Vec<_>>())
}
