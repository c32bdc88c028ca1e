//! The result as JSON, and its hash.
//!
//! Numbers that are not finite are null. The hash is SHA-256 over the result's canonical JSON (keys sorted, no spaces,
//! without times of the clock and without the hash) followed by the bits of every sampled state, so that equal hashes
//! mean equal runs to the last bit. What only tells more of the same run (`--json-cycles`, the solution's fit) is not in
//! the hash.
//!
//! `planning.rejections` counts candidates by the codes of [`Rejection`](crate::planner::Rejection), every code always
//! there; `planning.edges` counts lattice edges by what became of them ([`EdgeCounts`](crate::lattice::EdgeCounts)).
//! `planning.proven_against_set` counts the cycles whose plan holds against all motions within the bounds of
//! `planner.uncertainty`; it is there only if the settings ask for such proofs.
//! `plan` lists the candidates of its one cycle; a drive has hundreds of cycles and lists them only if asked.

use serde_json::{Map, Value, json};
use sha2::{Digest as _, Sha256};

use super::engine::{self, Summary, Times};
use super::job::{Job, Kind};
use crate::drive::Run;
use crate::planner::{Candidate, Cycle, Decision};
use crate::simulation::Sample;

/// Fills in the result's JSON and hash.
pub(super) fn fill(job: &Job, run: &Run, summary: &mut Summary) {
    let samples = engine::driven(job.kind, run).samples;
    let mut result = result(job, run, summary, &samples);
    summary.hash = hash(&Value::Object(result.clone()), &samples);
    if let Some(planning) = result.get_mut("planning").and_then(Value::as_object_mut) {
        let told = |Times { median, p99, max }: Times| json!({ "median": median, "p99": p99, "max": max });
        planning.insert("time_ms".into(), told(summary.planning.time_ms));
        planning.insert("smoothing_ms".into(), told(summary.planning.smoothing_ms));
    }
    if job.outputs.json_cycles {
        result.insert("cycles".into(), run.cycles.iter().map(cycle).collect());
    }
    if let Some(solution) = &summary.solution {
        result.insert("solution".into(), json!({ "max_deviation_m": solution.max_deviation_m }));
    }
    result.insert("hash".into(), json!(summary.hash));
    summary.json = Value::Object(result);
}

/// What does not depend on the clock, nor on which files are written.
fn result(job: &Job, run: &Run, summary: &Summary, samples: &[Sample]) -> Map<String, Value> {
    let mut result = Map::new();
    let mut put = |key: &str, value: Value| result.insert(key.to_owned(), value);
    put(
        "format",
        json!(match job.kind {
            Kind::Plan => "stopline.plan/1",
            Kind::Drive => "stopline.drive/1",
        }),
    );
    put("scenario", json!(run.scenario.id));
    put("problem", json!(run.problem.id));
    put("vehicle", json!(run.vehicle.name));
    put("seed", json!(job.seed));
    put("outcome", json!(run.outcome.name()));
    put("reason", json!(run.reason));
    if let Some(distance) = run.stopping_distance {
        put("stopping_distance_m", json!(distance));
    }
    put("verdict", json!(if summary.held { "pass" } else { "fail" }));
    put("checks", checks(run));
    put("metrics", serde_json::to_value(summary.metrics).unwrap_or_default());
    put(
        "planning",
        json!({
            "cycles": summary.planning.cycles,
            "proven_cycles": summary.planning.proven_cycles,
            "refined_cycles": summary.planning.refined_cycles,
            "smoothing": summary.planning.smoothing,
            "creeping_cycles": summary.planning.creeping_cycles,
            "unsmoothed": summary.planning.unsmoothed,
            "expansions": summary.planning.expansions,
            "candidates": summary.planning.candidates,
            "rejections": rejections(summary),
            "edges": serde_json::to_value(&summary.planning.edges).unwrap_or_default(),
        }),
    );
    if let (Some(count), Some(planning)) =
        (summary.planning.proven_against_set, result.get_mut("planning").and_then(Value::as_object_mut))
    {
        planning.insert("proven_against_set".into(), json!(count));
    }
    let mut put = |key: &str, value: Value| result.insert(key.to_owned(), value);
    if run.faults.is_any() {
        put("faults", serde_json::to_value(run.faults).unwrap_or_default());
    }
    put("issues", issues(run));
    if job.kind == Kind::Plan {
        put("plan", plan(run, samples));
        put("candidates", run.cycles.last().map_or_else(|| json!([]), candidates));
    }
    result
}

/// Candidates rejected by each reason.
fn rejections(summary: &Summary) -> Value {
    let counted = summary.planning.rejections.iter();
    Value::Object(counted.map(|(why, count)| (why.code().to_owned(), json!(count))).collect())
}

fn cycle(cycle: &Cycle) -> Value {
    let deceleration = match cycle.decision {
        Decision::NewPlan { deceleration } => Some(deceleration),
        Decision::KeepLast | Decision::Unproven => None,
    };
    json!({
        "time_s": cycle.time,
        "decision": cycle.decision.name(),
        "deceleration_mps2": deceleration,
        "proven_against_set": cycle.is_proven_against_set,
        "expansions": cycle.expansions,
        "candidates": candidates(cycle),
    })
}

/// The candidates of a cycle in the order in which they were looked at. Exactly one that is not rejected: the chosen one.
fn candidates(cycle: &Cycle) -> Value {
    let one = |c: &Candidate| {
        let end = c.path.at(c.path.length()).pose.position;
        json!({
            "lane": c.lane,
            "attempt": c.attempt,
            "length_m": c.path.length(),
            "end_x_m": end.x,
            "end_y_m": end.y,
            "cost": c.cost,
            "terms": c.terms,
            "rejected": c.rejected.map(|why| why.code()),
        })
    };
    cycle.candidates.iter().map(one).collect()
}

fn checks(run: &Run) -> Value {
    let check = |c: &crate::verdict::Check| {
        json!({
            "name": c.name,
            "pass": c.pass,
            "value": c.value,
            "limit": c.limit,
            "unit": c.unit,
            "at_time": c.at_time,
            "note": c.note,
        })
    };
    run.verdict.checks.iter().map(check).collect()
}

fn issues(run: &Run) -> Value {
    let issue = |i: &crate::map::Issue| json!({ "line": i.line, "element": i.element, "message": i.message });
    run.scenario.issues.iter().map(issue).collect()
}

/// The committed plan with its proof: null if there is none.
fn plan(run: &Run, samples: &[Sample]) -> Value {
    /// Samples told per planned one: a tenth of a second.
    const EVERY: usize = 10;
    let Some(Decision::NewPlan { deceleration }) = run.cycles.last().map(|c| c.decision) else { return Value::Null };
    let state = |s: &Sample| {
        json!({
            "time_s": s.time,
            "x_m": s.pose.position.x,
            "y_m": s.pose.position.y,
            "yaw_rad": s.pose.yaw,
            "speed_mps": s.speed,
            "acceleration_mps2": s.acceleration,
            "steering_rad": s.steering,
            "station_m": s.wanted_station,
        })
    };
    let last = samples.len().saturating_sub(1);
    let told = samples.iter().enumerate().filter(|(i, _)| i % EVERY == 0 || *i == last);
    json!({
        "proof": { "deceleration_mps2": deceleration, "ends_at_rest": samples.last().is_some_and(|s| s.speed == 0.0) },
        "reference_point": "rear axle",
        "states": told.map(|(_, s)| state(s)).collect::<Vec<_>>(),
    })
}

/// SHA-256 over the canonical JSON and the bits of the states, in hexadecimal.
pub(super) fn hash(result: &Value, samples: &[Sample]) -> String {
    let mut hasher = Sha256::new();
    hasher.update(canonical(result).to_string());
    for s in samples {
        let numbers = [
            s.time,
            s.pose.position.x,
            s.pose.position.y,
            s.pose.yaw,
            s.speed,
            s.lateral_speed,
            s.yaw_rate,
            s.acceleration,
            s.lateral_acceleration,
            s.steering,
        ];
        numbers.iter().for_each(|x| hasher.update(x.to_bits().to_le_bytes()));
    }
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The value with the keys of every object sorted, whichever map serde_json was built with.
fn canonical(value: &Value) -> Value {
    match value {
        Value::Object(map) => {
            let mut keys: Vec<&String> = map.keys().collect();
            keys.sort();
            Value::Object(keys.into_iter().map(|k| (k.clone(), canonical(&map[k]))).collect())
        }
        Value::Array(items) => items.iter().map(canonical).collect(),
        other => other.clone(),
    }
}

/// The text of a JSON output: indented, one newline at its end.
pub(super) fn text(value: &Value) -> String {
    format!("{value:#}\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    fn sample(x: f64) -> Sample {
        let pose = Pose::new(x, 0.0, 0.0);
        Sample {
            time: 0.0,
            pose,
            speed: 0.0,
            lateral_speed: 0.0,
            yaw_rate: 0.0,
            acceleration: 0.0,
            lateral_acceleration: 0.0,
            steering: 0.0,
            commanded_acceleration: 0.0,
            commanded_steering: 0.0,
            wanted_pose: pose,
            wanted_speed: 0.0,
            wanted_station: 0.0,
        }
    }

    #[test]
    fn the_hash_sees_the_last_bit_of_a_state_and_not_the_order_of_keys() {
        let value = json!({ "a": 1, "b": { "d": [1.5, null], "c": 2 } });
        let turned: Value = serde_json::from_str(r#"{"b":{"c":2,"d":[1.5,null]},"a":1}"#).unwrap();
        assert_eq!(hash(&value, &[sample(1.0)]), hash(&turned, &[sample(1.0)]));
        assert_ne!(hash(&value, &[sample(1.0)]), hash(&value, &[sample(1.0_f64.next_up())]));
        assert_ne!(hash(&value, &[]), hash(&json!({}), &[]));
        assert_eq!(hash(&value, &[]).len(), 64);
    }

    #[test]
    fn what_is_not_finite_is_null() {
        assert_eq!(json!({ "a": f64::NAN, "b": f64::INFINITY }), json!({ "a": null, "b": null }));
    }
}
