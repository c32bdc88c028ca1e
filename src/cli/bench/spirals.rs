//! `stopline bench spirals`: table, JSON, CSV and picture of the comparison.

use std::fmt::Write as _;

use serde_json::{Map, Value, json};

use super::{all_pass, check_json, check_table};
use crate::bench::Check;
use crate::bench::spirals::{BOUND, Comparison, Method, Row, SOFT, Settings, compare_with_progress};
use crate::cli::args::SpiralArgs;
use crate::cli::job::Outputs;
use crate::cli::{Exit, Failure, json as result, print, progress, report};
use crate::io::files;

/// Runs the comparison and writes its outputs.
pub(super) fn run(args: SpiralArgs) -> Result<Exit, Failure> {
    let outputs = Outputs { json: args.json, csv: args.csv, svg: args.svg, ..Outputs::default() };
    outputs.check(&[])?;
    let settings = Settings { seed: args.seed, problems: args.problems as usize };
    let bar = progress::bar(!args.quiet);
    let comparison = compare_with_progress(&settings, &mut |method, done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
        bar.set_message(method.label());
    });
    bar.finish_and_clear();
    let checks = comparison.checks();
    let value = to_json(&comparison, &checks);
    if let Some(path) = outputs.json.as_ref().filter(|_| !outputs.json_on_stdout()) {
        files::write_atomic(path, result::text(&value).as_bytes()).map_err(Failure::file)?;
    }
    if let Some(path) = &outputs.csv {
        files::write_atomic(path, to_csv(&comparison).as_bytes()).map_err(Failure::file)?;
    }
    if let Some(path) = &outputs.svg {
        files::write_atomic(path, crate::plot::geometry::comparison(&comparison).as_bytes()).map_err(Failure::file)?;
    }
    if outputs.json_on_stdout() {
        print(&result::text(&value))?;
    } else if !args.quiet {
        print(&text(&comparison, &checks, &value))?;
    }
    Ok(if all_pass(&checks) { Exit::Pass } else { Exit::CheckFailed })
}

/// The result. Its hash excludes the times.
fn to_json(comparison: &Comparison, checks: &[Check]) -> Value {
    let mut value = Map::new();
    let mut put = |key: &str, v: Value| value.insert(key.to_owned(), v);
    put("format", json!("stopline.bench.spirals/2"));
    put("seed", json!(comparison.settings.seed));
    put("problems", json!(comparison.problems.len()));
    put("bound_per_m", json!(BOUND));
    put("verdict", json!(if all_pass(checks) { "pass" } else { "fail" }));
    put("checks", checks.iter().map(check_json).collect());
    put("methods", comparison.rows.iter().map(row_to_json).collect());
    let hash = result::hash(&Value::Object(value.clone()), &[]);
    let mut put = |key: &str, v: Value| value.insert(key.to_owned(), v);
    let time = |r: &Row| {
        let times = json!({ "median_us": r.time.median_us, "p99_us": r.time.p99_us });
        (r.method.name().to_owned(), times)
    };
    put("time", Value::Object(comparison.rows.iter().map(time).collect()));
    put("hash", json!(hash));
    Value::Object(value)
}

fn row_to_json(row: &Row) -> Value {
    json!({
        "name": row.method.name(),
        "label": row.method.label(),
        "problems": row.problems,
        "solved": row.solved,
        "proven_impossible": row.impossible,
        "worst_end_residual_m": row.worst_residual,
        "worst_heading_residual_rad": row.worst_heading,
        "worst_slide_m": row.worst_slide,
        "max_abs_curvature_per_m": row.max_curvature,
        "mean_bending_energy_per_m": row.mean_energy,
        "bending_energy_ratio": row.energy_ratio,
        "over_bound": row.over_bound,
    })
}

/// One row per method and applicable problem, without times. Numbers read back as the same `f64`; cells of unsolved
/// problems are empty.
fn to_csv(comparison: &Comparison) -> String {
    let mut text = String::from(
        "problem,start_curvature_per_m,end_x_m,end_y_m,end_yaw_rad,end_curvature_per_m,method,solved,\
         end_residual_m,heading_residual_rad,slide_m,max_abs_curvature_per_m,bending_energy_per_m,length_m\n",
    );
    for (i, p) in comparison.problems.iter().enumerate() {
        for (method, evaluations) in Method::ALL.iter().zip(&comparison.evaluations).filter(|(m, _)| m.is_for(p)) {
            let (at, name) = (p.end.position, method.name());
            // writing to a String cannot fail
            let _ = write!(text, "{i},{},{},{},{},{},", p.start_curvature, at.x, at.y, p.end.yaw, p.end_curvature);
            let _ = match evaluations[i] {
                Some(j) => writeln!(
                    text,
                    "{name},1,{},{},{},{},{},{}",
                    j.end_residual, j.heading_residual, j.slide, j.max_curvature, j.bending_energy, j.length
                ),
                None => writeln!(text, "{name},0,,,,,,"),
            };
        }
    }
    text
}

/// The report as text.
fn text(comparison: &Comparison, checks: &[Check], value: &Value) -> String {
    let count = comparison.problems.len();
    let mut text = format!(
        "{count} lattice problem(s), seed {}: 10…40 m longitudinally, ±8 m laterally, ±0.5 rad, curvature ±0.1 1/m at both \
         ends\n\n",
        comparison.settings.seed
    );
    let head = [
        "method",
        "problems",
        "solved",
        "infeasible",
        "median",
        "p99",
        "worst end",
        "worst",
        "largest",
        "mean",
        "energy",
        "over",
    ];
    let units =
        ["", "", "", "proven", "µs", "µs", "residual m", "slide m", "|κ| 1/m", "∫κ²ds 1/m", "to cubic", "bound %"];
    let rows = [head, units].map(|r| r.map(str::to_owned).to_vec()).into_iter();
    text += &report::table(&rows.chain(comparison.rows.iter().map(cells)).collect::<Vec<_>>());
    text += &notes();
    text.push('\n');
    text += &check_table(checks);
    let _ = writeln!(text, "\nhash: {}", value["hash"].as_str().unwrap_or_default());
    text
}

/// Explanation of the rows.
fn notes() -> String {
    format!(
        "
pinned       both poses and both end curvatures are fixed
bound        |κ| ≤ {BOUND} 1/m; active where the pinned cubic spiral violates it
soft end     the end may move laterally (slide) at a cost of {SOFT} 1/m³ · slide²; solved by Clarabel
active bound problems with the bound. The cubic spiral's end moves laterally as little as possible (second-order
             cones); the quintic spiral's end stays pinned (cutting planes)
infeasible   a branch and bound over linear relaxations proves that no such spiral exists
energy       mean bending energy as a ratio to that of the pinned cubic spiral on the same problems
quintic      pinned spiral of least bending energy, found by Clarabel
polynomial   x and y of degree five; tangents as long as the chord, or optimised for least bending energy
shooting     the lecture's method for the first row: Newton with Simpson's rule and finite differences
time         per problem, shortest of three runs; all other metrics are deterministic
"
    )
}

fn cells(row: &Row) -> Vec<String> {
    let found = |text: String| if row.solved > 0 { text } else { "-".into() };
    let share = 100.0 * row.over_bound as f64 / row.solved.max(1) as f64;
    vec![
        row.method.label().into(),
        row.problems.to_string(),
        row.solved.to_string(),
        if row.impossible > 0 { row.impossible.to_string() } else { "-".into() },
        found(format!("{:.2}", row.time.median_us)),
        found(format!("{:.2}", row.time.p99_us)),
        found(format!("{:.1e}", row.worst_residual)),
        found(format!("{:.2}", row.worst_slide)),
        found(format!("{:.4}", row.max_curvature)),
        found(format!("{:.4}", row.mean_energy)),
        found(format!("{:.3}", row.energy_ratio)),
        found(format!("{share:.1}")),
    ]
}
