//! The complete report, for programs and for replays.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use crate::regression::{DriveReport, Status, Summary};

/// The `format` of the report.
pub const FORMAT: &str = "stopline.check/2";

/// All suites with all drives. `configs` contains each settings file once, by a short hash of it. The settings are TOML,
/// because JSON has no infinity.
#[must_use]
pub fn json(suites: &[Summary]) -> String {
    let mut configs = BTreeMap::new();
    let suites: Vec<Value> = suites.iter().map(|s| suite(s, &mut configs)).collect();
    let value = json!({ "format": FORMAT, "version": env!("CARGO_PKG_VERSION"), "suites": suites, "configs": configs });
    crate::result::json::text(&value)
}

fn suite<'a>(summary: &'a Summary, configs: &mut BTreeMap<String, &'a str>) -> Value {
    let counts: BTreeMap<&str, usize> = Status::ALL.iter().map(|s| (s.name(), summary.count(*s))).collect();
    json!({
        "name": summary.name,
        "file": summary.file.to_string_lossy(),
        "shard": summary.shard.map(|s| s.to_string()),
        "success": summary.is_success(),
        "counts": counts,
        "drives": summary.drives.iter().map(|d| drive(d, configs)).collect::<Vec<_>>(),
        "stale_in_baseline": summary.stale_in_baseline,
    })
}

fn drive<'a>(drive: &'a DriveReport, configs: &mut BTreeMap<String, &'a str>) -> Value {
    let digest = Sha256::digest(drive.config.as_bytes());
    let config: String = digest.iter().take(6).map(|byte| format!("{byte:02x}")).collect();
    configs.insert(config.clone(), &drive.config);
    let failures: Vec<Value> =
        drive.failures.iter().map(|f| json!({ "kind": f.kind.name(), "message": f.message })).collect();
    json!({
        "id": drive.id,
        "scenario": drive.scenario,
        "vehicle": drive.vehicle,
        "seed": drive.seed,
        "config": config,
        "inputs": drive.inputs,
        "status": drive.status.name(),
        "expected_failure": drive.expected_failure,
        "failures": failures,
        "error": drive.error.as_ref().map(|e| json!({ "kind": e.kind.name(), "message": e.message })),
        "repetitions": drive.measured.as_ref().map(|m| m.hashes.len()),
        "result": drive.measured.as_ref().map(|m| &m.result),
    })
}
