//! The result of a run as JSON, with its hash.
//!
//! Numbers that are not finite are null. The hash is SHA-256 over the canonical JSON of the result (keys sorted, no spaces,
//! without wall-clock times and without the hash), followed by the bits of every sampled state: equal hashes mean equal runs to
//! the last bit. Additional output about the same run (`--json-cycles`, the fit of the solution) is not in the hash.
//!
//! `checks` has every check of the verdict, or is empty if nothing was driven; a check that does not apply has null for value
//! and limit. A check that found a contact has an `impact`: who ran into whom. `planning.rejections` counts candidates by the codes of [`Rejection`](crate::planner::Rejection), all of them;
//! `planning.edges` counts lattice edges by their result ([`EdgeCounts`](crate::lattice::EdgeCounts)).
//! `planning.robust_cycles` counts the cycles with a robust plan, proved for the reachable sets of other traffic within the
//! bounds of `planner.uncertainty`; it is present only if the settings ask for such proofs. A plan lists the candidates of its
//! one cycle; a drive has hundreds of cycles and lists them only on request.

use serde_json::{Map, Value, json};
use sha2::{Digest as _, Sha256};

use super::{Kind, Planning, Times};
use crate::drive::Run;
use crate::planner::{Candidate, Cycle, Decision};
use crate::simulation::Sample;
use crate::verdict::Metrics;

/// The part that depends neither on the clock nor on the written files; without the hash.
pub(super) fn result(
    kind: Kind,
    run: &Run,
    seed: u64,
    (pass, metrics, planning): (bool, &Metrics, &Planning),
    samples: &[Sample],
) -> Map<String, Value> {
    let mut result = Map::new();
    let mut put = |key: &str, value: Value| result.insert(key.to_owned(), value);
    put(
        "format",
        json!(match kind {
            Kind::Plan => "stopline.plan/2",
            Kind::Drive => "stopline.drive/2",
        }),
    );
    put("scenario", json!(run.scenario.id));
    put("problem", json!(run.problem.id));
    put("vehicle", json!(run.vehicle.name));
    put("seed", json!(seed));
    put("outcome", json!(run.outcome.name()));
    put("reason", json!(run.reason));
    if let Some(distance) = run.stopping_distance {
        put("stopping_distance_m", json!(distance));
    }
    put("verdict", json!(if pass { "pass" } else { "fail" }));
    put("checks", checks(run));
    put("metrics", serde_json::to_value(metrics).unwrap_or_default());
    put(
        "planning",
        json!({
            "cycles": planning.cycles,
            "proven_cycles": planning.proven_cycles,
            "refined_cycles": planning.refined_cycles,
            "smoothing": planning.smoothing,
            "creeping_cycles": planning.creeping_cycles,
            "unsmoothed": planning.unsmoothed,
            "expansions": planning.expansions,
            "candidates": planning.candidates,
            "rejections": rejections(planning),
            "edges": serde_json::to_value(&planning.edges).unwrap_or_default(),
        }),
    );
    if let (Some(count), Some(planning)) =
        (planning.robust_cycles, result.get_mut("planning").and_then(Value::as_object_mut))
    {
        planning.insert("robust_cycles".into(), json!(count));
    }
    let mut put = |key: &str, value: Value| result.insert(key.to_owned(), value);
    if run.faults.is_any() {
        put("faults", serde_json::to_value(run.faults).unwrap_or_default());
    }
    put("issues", issues(run));
    if kind == Kind::Plan {
        put("plan", plan(run, samples));
        put("candidates", run.cycles.last().map_or_else(|| json!([]), candidates));
    }
    result
}

/// Adds wall-clock times to `planning` of the result. They are not in the hash.
pub fn add_times(result: &mut Map<String, Value>, planning: &Planning) {
    if let Some(object) = result.get_mut("planning").and_then(Value::as_object_mut) {
        let times = |Times { median, p99, max }: Times| json!({ "median": median, "p99": p99, "max": max });
        object.insert("time_ms".into(), times(planning.time_ms));
        object.insert("smoothing_ms".into(), times(planning.smoothing_ms));
    }
}

/// Candidates rejected by each reason.
fn rejections(planning: &Planning) -> Value {
    let counted = planning.rejections.iter();
    Value::Object(counted.map(|(why, count)| (why.code().to_owned(), json!(count))).collect())
}

/// A planning cycle with its candidates, for `--json-cycles`.
#[must_use]
pub fn cycle(cycle: &Cycle) -> Value {
    let deceleration = (cycle.plan.decision != Decision::Unproven).then_some(cycle.plan.deceleration);
    json!({
        "time_s": cycle.plan.time,
        "decision": cycle.plan.decision.name(),
        "level": cycle.plan.level.name(),
        "summary": cycle.summary(),
        "deceleration_mps2": deceleration,
        "limited_by": cycle.plan.limited_by.map(|cause| cause.to_string()),
        "stops_for": cycle.plan.stops_for.map(|cause| cause.to_string()),
        "expected_contact": cycle.plan.expected_contact.map(|c| json!({ "with": c.what.to_string(), "time_s": c.time, "speed_mps": c.speed })),
        "robust": cycle.plan.is_robust,
        "expansions": cycle.trace.expansions,
        "candidates": candidates(cycle),
    })
}

/// The candidates of a cycle in the order of their evaluation. Only the chosen one is not rejected.
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
    cycle.trace.candidates.iter().map(one).collect()
}

fn checks(run: &Run) -> Value {
    let check = |c: &crate::verdict::Check| {
        let mut check = json!({
            "name": c.name,
            "status": c.status.name(),
            "value": c.value,
            "limit": c.limit,
            "unit": c.unit,
            "at_time": c.at_time,
            "note": c.note,
            "method": c.method,
        });
        if let (Some(found), Some(check)) = (c.impact, check.as_object_mut()) {
            check.insert("impact".into(), impact(found));
        }
        check
    };
    run.verdict.checks.iter().map(check).collect()
}

/// Who ran into whom. `obstacle` is null for occupied cells; a speed is positive towards the other, along the normal.
fn impact(impact: crate::verdict::Impact) -> Value {
    use crate::verdict::{Cause, Side, Thing};
    let (obstacle, cells) = match impact.with {
        Thing::Obstacle(id) => (Some(id), None),
        Thing::Cells(at) => (None, Some([at.x, at.y])),
    };
    let vehicle_share = match impact.cause {
        Cause::Vehicle => Some(1.0),
        Cause::Other | Cause::Appeared => Some(0.0),
        Cause::Both { vehicle_share } => Some(vehicle_share),
        Cause::Start | Cause::Unknown => None,
    };
    json!({
        "cause": impact.cause.name(),
        "obstacle": obstacle,
        "occupied_cells_at_m": cells,
        "time": impact.time,
        "side": impact.side.map(Side::name),
        "vehicle_is_stopped": impact.is_stopped,
        "vehicle_speed_mps": impact.vehicle_speed,
        "other_speed_mps": impact.other_speed,
        "vehicle_share": vehicle_share,
    })
}

fn issues(run: &Run) -> Value {
    let issue = |i: &crate::map::Issue| json!({ "line": i.line, "element": i.element, "message": i.message });
    run.scenario.issues.iter().map(issue).collect()
}

/// The committed plan with its proof; null if there is none.
fn plan(run: &Run, samples: &[Sample]) -> Value {
    /// Every tenth sample is listed: one in 0.1 s.
    const EVERY: usize = 10;
    let planned = super::planned_cycle(run).filter(|c| c.plan.decision == Decision::NewPlan);
    let Some(deceleration) = planned.map(|c| c.plan.deceleration) else { return Value::Null };
    let state = |s: &Sample| {
        json!({
            "time_s": s.time,
            "x_m": s.pose.position.x,
            "y_m": s.pose.position.y,
            "yaw_rad": s.pose.yaw,
            "speed_mps": s.speed,
            "acceleration_mps2": s.acceleration,
            "steering_rad": s.steering,
            "station_m": s.reference_station,
        })
    };
    let last = samples.len().saturating_sub(1);
    let listed = samples.iter().enumerate().filter(|(i, _)| i % EVERY == 0 || *i == last);
    json!({
        "proof": { "deceleration_mps2": deceleration, "ends_at_standstill": samples.last().is_some_and(|s| s.speed == 0.0) },
        "reference_point": "rear axle",
        "states": listed.map(|(_, s)| state(s)).collect::<Vec<_>>(),
    })
}

/// SHA-256 over the canonical JSON and the bits of the states, as hexadecimal text.
pub(crate) fn hash(result: &Value, samples: &[Sample]) -> String {
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

/// The value with the keys of every object sorted, independent of the map type of serde_json.
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
#[must_use]
pub fn text(value: &Value) -> String {
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
            reference_pose: pose,
            reference_speed: 0.0,
            reference_station: 0.0,
        }
    }

    #[test]
    fn the_hash_depends_on_every_bit_of_a_state_and_not_on_the_order_of_keys() {
        let value = json!({ "a": 1, "b": { "d": [1.5, null], "c": 2 } });
        let turned: Value = serde_json::from_str(r#"{"b":{"c":2,"d":[1.5,null]},"a":1}"#).unwrap();
        assert_eq!(hash(&value, &[sample(1.0)]), hash(&turned, &[sample(1.0)]));
        assert_ne!(hash(&value, &[sample(1.0)]), hash(&value, &[sample(1.0_f64.next_up())]));
        assert_ne!(hash(&value, &[]), hash(&json!({}), &[]));
        assert_eq!(hash(&value, &[]).len(), 64);
    }

    #[test]
    fn numbers_that_are_not_finite_are_null() {
        assert_eq!(json!({ "a": f64::NAN, "b": f64::INFINITY }), json!({ "a": null, "b": null }));
    }
}
