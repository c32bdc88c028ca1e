//! `stopline bench safetlp`: table, JSON, CSV and picture of the paper's experiment.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::{Map, Value, json};

use super::{all_pass, check_json, check_table};
use crate::bench::safetlp::{Comparison, LIMIT_SETS, Method, Settings, TIME_LIMIT, compare, searches};
use crate::cli::args::SafeTlpArgs;
use crate::cli::job::Outputs;
use crate::cli::{Exit, Failure, json as result, print, progress, report};
use crate::io::files;

/// One MiB in bytes.
const MIB: usize = 1 << 20;

/// Runs the comparison and writes its outputs.
pub(super) fn run(args: SafeTlpArgs) -> Result<Exit, Failure> {
    let outputs = Outputs { json: args.json, csv: args.csv, svg: args.svg, ..Outputs::default() };
    outputs.check(&[])?;
    let settings = Settings {
        length: args.length,
        step: args.step,
        time_bin: args.time_bin,
        every: args.every,
        memory: args.memory as usize * MIB,
        time_limit: args.time_limit,
        ..Settings::default()
    };
    let bar = progress::bar(!args.quiet);
    let all = searches(&settings);
    bar.set_length(all as u64);
    bar.set_message(format!("of {all} searches"));
    let comparison = compare(&settings, || bar.inc(1));
    bar.finish_and_clear();
    let comparison = comparison.map_err(|e| Failure::Use(e.to_string()))?;
    let value = to_json(&comparison);
    if let Some(path) = outputs.json.as_ref().filter(|_| !outputs.json_on_stdout()) {
        files::write_atomic(path, result::text(&value).as_bytes()).map_err(Failure::file)?;
    }
    if let Some(path) = &outputs.csv {
        files::write_atomic(path, to_csv(&comparison).as_bytes()).map_err(Failure::file)?;
    }
    if let Some(path) = &outputs.svg {
        files::write_atomic(path, crate::plot::safetlp::experiment(&comparison).as_bytes()).map_err(Failure::file)?;
    }
    if outputs.json_on_stdout() {
        print(&result::text(&value))?;
    } else if !args.quiet {
        print(&text(&comparison, &value))?;
    }
    Ok(if all_pass(&comparison.checks()) { Exit::Pass } else { Exit::CheckFailed })
}

/// The result. Its hash excludes the times.
fn to_json(comparison: &Comparison) -> Value {
    let checks = comparison.checks();
    let s = &comparison.settings;
    let mut value = Map::new();
    let mut put = |key: &str, v: Value| value.insert(key.to_owned(), v);
    put("format", json!("stopline.bench.safetlp/2"));
    put("road_m", json!(s.length));
    put("step_m", json!(s.step));
    put("time_bin_s", json!(s.time_bin));
    put("instances", json!(comparison.instances.len()));
    put("verdict", json!(if all_pass(&checks) { "pass" } else { "fail" }));
    put("checks", checks.iter().map(check_json).collect());
    put("methods", Method::ALL.iter().map(|m| method_json(comparison, *m)).collect());
    let hash = result::hash(&Value::Object(value.clone()), &[]);
    let time = |m: &Method| {
        let seconds = comparison.group(*m, None).summary().time;
        (m.name().to_owned(), json!({ "median_us": 1e6 * seconds }))
    };
    value.insert("time".into(), Value::Object(Method::ALL.iter().map(time).collect()));
    value.insert("hash".into(), json!(hash));
    Value::Object(value)
}

fn method_json(comparison: &Comparison, method: Method) -> Value {
    let set = |set: usize| {
        let summary = comparison.group(method, Some(set)).summary();
        json!({
            "acceleration_mps2": LIMIT_SETS[set].0,
            "aggressive_deceleration_mps2": LIMIT_SETS[set].1,
            "proven": summary.proven,
            "median_expansions": summary.expansions,
            "mean_average_speed_mps": summary.average_speed,
        })
    };
    let all = comparison.group(method, None).summary();
    json!({
        "name": method.name(),
        "label": method.label(),
        "instances": all.instances,
        "proven": all.proven,
        "median_expansions": all.expansions,
        "mean_average_speed_mps": all.average_speed,
        "largest_memory_bytes": all.bytes,
        "ended": ended(comparison, method),
        "limit_sets": (0..LIMIT_SETS.len()).map(set).collect::<Vec<_>>(),
    })
}

/// Number of searches of a method by outcome.
fn ended(comparison: &Comparison, method: Method) -> BTreeMap<&'static str, usize> {
    let mut counts = BTreeMap::new();
    for measured in comparison.group(method, None).measurements {
        *counts.entry(measured.ended).or_insert(0) += 1;
    }
    counts
}

/// One row per method and instance. Only the last column depends on the clock.
fn to_csv(comparison: &Comparison) -> String {
    let mut text = String::from(
        "method,comfortable_acceleration_mps2,aggressive_deceleration_mps2,start_speed_mps,ended,expansions,closed,\
         proofs_tried,proof_succeeded,memory_bytes,average_speed_mps,top_speed_mps,end_speed_mps,proved_again,time_s\n",
    );
    for (method, measured) in Method::ALL.iter().zip(&comparison.measurements) {
        for (instance, m) in comparison.instances.iter().zip(measured) {
            let (comfortable, aggressive) = LIMIT_SETS[instance.set];
            let succeeded = m.proof_succeeded.map(|n| n.to_string()).unwrap_or_default();
            // writing to a String cannot fail
            let _ = write!(
                text,
                "{},{comfortable},{aggressive},{},{},{},{},{},{succeeded},{},",
                method.name(),
                instance.start_speed,
                m.ended,
                m.expansions,
                m.closed,
                m.proofs_tried,
                m.bytes
            );
            let _ = match m.plan {
                Some(p) => {
                    let proved = u8::from(p.proved_again);
                    write!(text, "{},{},{},{proved},", p.average_speed, p.top_speed, p.end_speed)
                }
                None => write!(text, ",,,,"),
            };
            let _ = writeln!(text, "{}", m.time);
        }
    }
    text
}

/// A length to a tenth of a millimetre, without trailing zeros.
fn rounded(length: f64) -> f64 {
    (length * 1e4).round() / 1e4
}

/// The report as text.
fn text(comparison: &Comparison, value: &Value) -> String {
    let s = &comparison.settings;
    let mut text = format!(
        "{} instances: a stop after {} m in steps of {} m, at most 15 m/s, from 0…{:.1} m/s, four limit sets; time bins {} s\n\n",
        comparison.instances.len(),
        s.length,
        rounded(s.step),
        comparison.fastest_start(),
        s.time_bin
    );
    let head = ["method", "proven", "expansions", "time", "memory", "average speed, m/s, by limit set", "", "", ""];
    let units = ["", "", "median", "median µs", "peak MiB", "0.8/1.6", "1.0/1.8", "1.2/2.0", "1.5/2.2"];
    let rows = [head, units].map(|r| r.map(str::to_owned).to_vec()).into_iter();
    let rows = rows.chain(Method::ALL.iter().map(|m| cells(comparison, *m)));
    text += &report::table(&rows.collect::<Vec<_>>());
    text.push('\n');
    text += &exhausted_budgets(comparison);
    text += &check_table(&comparison.checks());
    let _ = writeln!(text, "\nhash: {}", value["hash"].as_str().unwrap_or_default());
    text
}

/// One line for each method and exhausted budget.
fn exhausted_budgets(comparison: &Comparison) -> String {
    let s = &comparison.settings;
    let budgets = [
        ("memory_budget", format!("exhausted the memory budget of {} MiB", s.memory / MIB)),
        ("expansion_budget", "exhausted the expansion budget".to_owned()),
        (TIME_LIMIT, format!("omitted after the time limit of {} s", s.time_limit)),
    ];
    let mut text = String::new();
    for method in Method::ALL {
        let all = comparison.group(method, None).measurements;
        for (code, reason) in &budgets {
            let count = all.iter().filter(|m| m.ended == *code).count();
            if count > 0 {
                // writing to a String cannot fail
                let _ = writeln!(text, "{}: {count} of {} searches {reason}", method.label(), all.len());
            }
        }
    }
    if !text.is_empty() {
        text.push('\n');
    }
    text
}

fn cells(comparison: &Comparison, method: Method) -> Vec<String> {
    let all = comparison.group(method, None).summary();
    let mut cells = vec![
        method.label().to_owned(),
        format!("{}/{}", all.proven, all.instances),
        number(all.expansions, 0),
        number(1e6 * all.time, 1),
        format!("{:.2}", all.bytes as f64 / MIB as f64),
    ];
    cells.extend(
        (0..LIMIT_SETS.len()).map(|set| number(comparison.group(method, Some(set)).summary().average_speed, 3)),
    );
    cells
}

/// A number with fixed decimals; a dash for NaN.
fn number(value: f64, decimals: usize) -> String {
    if value.is_finite() { format!("{value:.decimals$}") } else { "-".into() }
}
