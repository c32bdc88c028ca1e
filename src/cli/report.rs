//! The report in text.

use std::fmt::Write as _;

use super::engine::Summary;
use super::job::Job;
use crate::drive::Run;
use crate::number;
use crate::result::{Planning, Times, reason_detail};
use crate::verdict::Check;

/// Issues of the scenario shown; the JSON has all.
const SHOWN_ISSUES: usize = 5;

/// The issues of the scenario, as lines for stderr.
pub(super) fn issues(job: &Job) -> Vec<String> {
    let issues = &job.scenario.issues;
    if issues.is_empty() {
        return Vec::new();
    }
    let mut lines = vec![format!("warning: {}: {} issue(s)", job.file.display(), issues.len())];
    lines.extend(issues.iter().take(SHOWN_ISSUES).map(|issue| format!("  {issue}")));
    if issues.len() > SHOWN_ISSUES {
        lines.push(format!("  … and {} more; --json lists all", issues.len() - SHOWN_ISSUES));
    }
    lines
}

/// Outcome, checks, metrics and planning, as text for stdout.
pub(super) fn text(run: &Run, summary: &Summary) -> String {
    let result = &summary.result;
    let mut text = String::new();
    // writing to a String cannot fail
    let verdict = if result.pass { "PASS" } else { "FAIL" };
    let _ = writeln!(text, "{}: {}, {verdict}", run.scenario.id, run.outcome.name());
    if let Some(reason) = reason(run) {
        let _ = writeln!(text, "reason: {reason}");
    }
    let _ = writeln!(text, "vehicle {}, planning problem {}\n", run.vehicle.name, run.problem.id);
    if !run.verdict.checks.is_empty() {
        text += &table(&checks(run));
        for failed in run.verdict.failures() {
            // a second line of the note says how the value is measured
            let _ = writeln!(text, "FAIL {}: {}", failed.name, failed.note.replace('\n', "\n  "));
        }
        text.push('\n');
    }
    if !run.log.samples.is_empty() {
        text += &table(&metrics(summary));
        text.push('\n');
    }
    text += &planning(&result.planning);
    if let Some(solution) = &summary.solution {
        let deviation = number::fixed(solution.max_deviation_m);
        let _ = writeln!(text, "solution: largest deviation from the run {deviation} m");
    }
    let _ = writeln!(text, "hash: {}", result.hash);
    text
}

/// The reason of the outcome, with the facts behind it.
fn reason(run: &Run) -> Option<String> {
    let code = run.reason?;
    let stop = run.stopping_distance.map(|m| format!("standstill takes {m:.1} m at the hardest braking allowed"));
    let facts = reason_detail(run).or(stop);
    Some(facts.map_or_else(|| code.to_owned(), |facts| format!("{code}: {facts}")))
}

fn planning(p: &Planning) -> String {
    let mut text = format!(
        "planning: {} cycle(s), {} with a proven stop, {} candidates, {} expansions\n",
        p.cycles, p.proven_cycles, p.candidates, p.expansions
    );
    let Times { median, p99, max } = p.time_ms;
    let _ = writeln!(text, "cycle time: {median:.2} ms median, {p99:.2} ms p99, {max:.2} ms max");
    if let Some(count) = p.robust_cycles {
        let _ =
            writeln!(text, "robust, proven for the reachable sets of other traffic: {count} of {} cycle(s)", p.cycles);
    }
    let counted = |counts: &mut dyn Iterator<Item = (&'static str, usize)>| {
        let counts: Vec<String> = counts.filter(|(_, n)| *n > 0).map(|(name, n)| format!("{name} {n}")).collect();
        if counts.is_empty() { "none".to_owned() } else { counts.join(", ") }
    };
    let _ = writeln!(text, "rejected: {}", counted(&mut p.rejections.iter().map(|(why, n)| (why.code(), *n))));
    let _ = writeln!(text, "lattice edges: {}", counted(&mut p.edges.named().into_iter()));
    text
}

fn checks(run: &Run) -> Vec<Vec<String>> {
    let head = ["check", "status", "value", "limit", "unit", "at"].map(str::to_owned).to_vec();
    let row = |c: &Check| {
        vec![
            c.name.to_owned(),
            c.status.to_string(),
            number::fixed(c.value),
            number::fixed(c.limit),
            c.unit.to_owned(),
            c.at_time.map_or_else(String::new, |t| format!("{t:.2} s")),
        ]
    };
    std::iter::once(head).chain(run.verdict.checks.iter().map(row)).collect()
}

fn metrics(summary: &Summary) -> Vec<Vec<String>> {
    let m = &summary.result.metrics;
    let rows = [
        ("distance", Some(m.distance_m), "m"),
        ("duration", Some(m.duration_s), "s"),
        ("mean speed", Some(m.mean_speed_mps), "m/s"),
        ("largest acceleration", Some(m.max_abs_acceleration_mps2), "m/s²"),
        ("largest lateral acceleration", Some(m.max_abs_lateral_acceleration_mps2), "m/s²"),
        ("largest jerk", Some(m.max_abs_jerk_mps3), "m/s³"),
        ("stop error", m.stop_error_m, "m"),
        ("smallest clearance", m.min_clearance_m, "m"),
        ("plan switches", Some(m.plan_switches_per_minute), "1/min"),
    ];
    let given = rows.into_iter().filter_map(|(name, value, unit)| value.map(|v| (name, v, unit)));
    given.map(|(name, value, unit)| vec![name.to_owned(), number::fixed(value), unit.to_owned()]).collect()
}

/// A table whose columns are as wide as their widest cell. Columns with a number are aligned to the right.
pub(super) fn table(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<String>, column: usize| row.get(column).map_or(0, |c| c.chars().count());
    let widths: Vec<usize> = (0..columns).map(|c| rows.iter().map(|r| cell(r, c)).max().unwrap_or(0)).collect();
    let is_number = |column: usize| rows.iter().any(|r| r.get(column).is_some_and(|c| c.parse::<f64>().is_ok()));
    let numeric: Vec<bool> = (0..columns).map(is_number).collect();
    let mut text = String::new();
    for row in rows {
        let cells = row.iter().enumerate().map(|(c, cell)| {
            let width = widths[c];
            if numeric[c] { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
        });
        let line = cells.collect::<Vec<_>>().join("  ");
        text += line.trim_end();
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_by_characters_not_bytes() {
        let rows = [["check", "value", "unit"], ["jerk", "10.5", "m/s³"], ["stop", "-2", "m"]];
        let rows: Vec<Vec<String>> = rows.iter().map(|r| r.iter().map(|c| (*c).to_owned()).collect()).collect();
        assert_eq!(table(&rows), "check  value  unit\njerk    10.5  m/s³\nstop      -2  m\n");
    }
}
