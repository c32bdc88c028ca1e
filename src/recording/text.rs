//! What was decided, and the verdict, in words.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use rerun::{TextDocument, TextLog, TextLogLevel};

use super::{Context, RecordingError};
use crate::drive::Run;
use crate::planner::{Cycle, Decision, Rejection};
use crate::verdict::Check;

/// Two decelerations nearer than this are one decision, m/s².
const SAME_DECELERATION: f64 = 0.05;

/// Logs the decisions and the verdict.
pub(super) fn log(context: &Context) -> Result<(), RecordingError> {
    for line in lines(context.run) {
        context.set_time(line.time);
        context.log("decisions", &TextLog::new(line.text).with_level(line.level))?;
    }
    let document = TextDocument::from_markdown(document(context.run));
    context.log_static("verdict", &document)
}

struct Line {
    time: f64,
    level: &'static str,
    text: String,
}

/// A line for each change of decision, for a contact or a break of the physics, and for the end.
fn lines(run: &Run) -> Vec<Line> {
    let mut lines = Vec::new();
    let mut last = None;
    for cycle in &run.cycles {
        let decision = summary(run, cycle);
        if last != Some(decision) {
            let by_choice = cycle.rejections(Rejection::BelowSwitchingThreshold) > 0;
            let fine = by_choice || matches!(cycle.decision, Decision::NewPlan { .. });
            let level = if fine { TextLogLevel::INFO } else { TextLogLevel::WARN };
            lines.push(Line { time: cycle.time, level, text: describe(cycle, decision) });
            last = Some(decision);
        }
    }
    let log = &run.log;
    if let Some(contact) = log.contact {
        let text = format!("contact with {} at {:.2} m/s", contact.with, contact.speed);
        lines.push(Line { time: contact.time, level: TextLogLevel::ERROR, text });
    }
    if let Some(time) = log.broke_at {
        lines.push(Line { time, level: TextLogLevel::ERROR, text: "the physics broke: a number that is none".into() });
    }
    if let Some(end) = log.samples.last() {
        let verdict = if run.verdict.pass() { "pass" } else { "fail" };
        let level = if run.verdict.pass() { TextLogLevel::INFO } else { TextLogLevel::ERROR };
        let text = format!("{}: {verdict}", ending(run));
        lines.push(Line { time: end.time, level, text });
    }
    lines
}

/// How it ended, and why where that is known.
fn ending(run: &Run) -> String {
    let reason = run.reason.map_or_else(String::new, |r| format!(" ({r})"));
    format!("{}{reason}", run.outcome.name()).replace('_', " ")
}

/// A decision without its numbers: what must change for a new line.
fn summary(run: &Run, cycle: &Cycle) -> &'static str {
    match &cycle.decision {
        Decision::NewPlan { deceleration } => {
            let comfortable = *deceleration <= run.vehicle.comfort.deceleration + SAME_DECELERATION;
            if comfortable { "new plan" } else { "new plan, proven by hard braking" }
        }
        Decision::KeepPrevious if cycle.rejections(Rejection::BelowSwitchingThreshold) > 0 => {
            "last plan goes on to its stop"
        }
        Decision::KeepPrevious => "last plan goes on: no new one is proven",
        Decision::Unproven => "emergency braking: no plan was ever proven",
    }
}

fn describe(cycle: &Cycle, decision: &str) -> String {
    let mut text = decision.to_owned();
    if let Decision::NewPlan { deceleration } = cycle.decision {
        let plan = &cycle.committed;
        let ahead = plan.profile.last().station - plan.at(cycle.time).station;
        let _ = write!(text, ": stops in {ahead:.1} m, at {:.1} s, with {deceleration:.1} m/s²", plan.end_time());
        if cycle.is_robust {
            text += ", whatever the traffic does within its bounds";
        }
    }
    let rejected = rejections(cycle);
    let total = cycle.candidates.len();
    if total > 0 {
        let _ = write!(text, "; {total} candidates");
    }
    if !rejected.is_empty() {
        let parts: Vec<String> = rejected.iter().map(|(reason, count)| format!("{reason} {count}")).collect();
        let _ = write!(text, ", rejected: {}", parts.join(", "));
    }
    text
}

/// How often each reason for a rejection was given.
fn rejections(cycle: &Cycle) -> BTreeMap<&'static str, usize> {
    let mut counts = BTreeMap::new();
    for reason in cycle.candidates.iter().filter_map(|c| c.rejected) {
        *counts.entry(reason.code()).or_insert(0) += 1;
    }
    counts
}

/// The verdict as Markdown.
fn document(run: &Run) -> String {
    let outcome = ending(run);
    let mut text =
        format!("### {}\n\n{} · problem {}\n\n", plain(&run.scenario.id), plain(&run.vehicle.name), run.problem.id);
    if run.verdict.checks.is_empty() {
        let _ = writeln!(text, "**{outcome}** (one planning cycle, nothing driven)");
        return text;
    }
    let verdict = if run.verdict.pass() { "pass" } else { "fail" };
    let _ = write!(text, "**{outcome} · {verdict}**\n\n| check | | value | limit | at |\n|---|---|---:|---:|---:|\n");
    for check in &run.verdict.checks {
        text.push_str(&row(check));
    }
    let failures: Vec<&Check> = run.verdict.failures().collect();
    if !failures.is_empty() {
        text.push_str("\n#### What failed\n\n");
    }
    for check in failures {
        let _ = writeln!(text, "- **{}**: {}", check.name, plain(&check.note));
    }
    text
}

fn row(check: &Check) -> String {
    let mark = if check.failed() { "**FAIL**".to_owned() } else { check.status.to_string() };
    let number = |v: f64| if v.is_finite() { format!("{v:.2}") } else { "–".into() };
    let at = check.at_time.map_or_else(String::new, |t| format!("{t:.2} s"));
    let name = check.name.replace('_', " ");
    format!("| {name} | {mark} | {} | {} {} | {at} |\n", number(check.value), number(check.limit), check.unit)
}

/// Text from outside, without the signs that would mean something in Markdown.
fn plain(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).fold(String::new(), |mut out, c| {
        if matches!(c, '|' | '*' | '_' | '`' | '[' | ']' | '<' | '>' | '#' | '\\') {
            out.push('\\');
        }
        out.push(c);
        out
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::example::Example;

    #[test]
    fn a_line_for_each_change_of_decision_and_for_the_end() {
        let example = Example::new();
        let run = example.run();
        let lines = lines(&run);
        let kinds: Vec<&str> = lines.iter().map(|l| l.text.split(':').next().unwrap()).collect();
        // the example keeps its last plan in one cycle out of twenty
        let expected = [
            "new plan, proven by hard braking",
            "last plan goes on",
            "new plan, proven by hard braking",
            "stopped safely",
        ];
        assert_eq!(kinds, expected);
        assert!(
            lines[0].text.contains("no_proof 1, blocked_at_start 1, curve_speed_infeasible 1"),
            "{}",
            lines[0].text
        );
    }

    #[test]
    fn the_verdict_names_every_check_and_what_failed() {
        let example = Example::new();
        let run = example.run();
        let text = document(&run);
        assert!(run.verdict.checks.iter().all(|c| text.contains(&c.name.replace('_', " "))), "{text}");
        assert!(text.contains("stopped safely · fail") && text.contains("**FAIL**"));
        assert!(text.contains("\\<all \\| any\\>"), "text from outside is escaped: {text}");
    }
}
