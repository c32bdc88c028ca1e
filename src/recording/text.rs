//! The decisions and the verdict as text.

use std::fmt::Write as _;

use rerun::{TextDocument, TextLog, TextLogLevel};

use super::{Context, RecordingError};
use crate::drive::Run;
use crate::planner::{Candidate, Cycle, Decision, Rejection};
use crate::verdict::Check;

/// A deceleration that exceeds the comfort limit by less than this still counts as comfortable, m/s².
const COMFORT_TOLERANCE: f64 = 0.05;

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

/// One line per change of decision, one for a contact or an invalid number in the physics, and one for the end.
fn lines(run: &Run) -> Vec<Line> {
    let mut lines = Vec::new();
    let mut last = None;
    for cycle in &run.cycles {
        let Some(kind) = Kind::of(run, cycle).filter(|kind| last != Some(*kind)) else { continue };
        lines.push(Line { time: cycle.plan.time, level: kind.level(), text: summary(cycle) });
        last = Some(kind);
    }
    let log = &run.log;
    if let Some(contact) = log.contact {
        let text = format!("contact with {} at {:.2} m/s", contact.with, contact.speed);
        lines.push(Line { time: contact.time, level: TextLogLevel::ERROR, text });
    }
    if let Some(time) = log.broke_at {
        lines.push(Line { time, level: TextLogLevel::ERROR, text: "physics error: a number is not finite".into() });
    }
    if let Some(end) = log.samples.last() {
        let verdict = if run.verdict.pass() { "PASS" } else { "FAIL" };
        let level = if run.verdict.pass() { TextLogLevel::INFO } else { TextLogLevel::ERROR };
        let text = format!("{verdict}: {}", ending(run));
        lines.push(Line { time: end.time, level, text });
    }
    lines
}

/// The outcome, with its reason if known.
fn ending(run: &Run) -> String {
    let reason = run.reason.map_or_else(String::new, |r| format!(" ({r})"));
    format!("{}{reason}", run.outcome.name()).replace('_', " ")
}

/// A decision without its numbers. A line is logged when it changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    NewPlan { lane: Option<usize>, is_comfortable: bool },
    KeepPrevious { below_threshold: bool },
    Unproven,
}

impl Kind {
    /// `None` where the previous plan continues without a decision.
    fn of(run: &Run, cycle: &Cycle) -> Option<Self> {
        Some(match cycle.plan.decision {
            Decision::NewPlan => Self::NewPlan {
                lane: chosen(cycle).map(|c| c.lane),
                is_comfortable: cycle.plan.deceleration <= run.vehicle.comfort.deceleration + COMFORT_TOLERANCE,
            },
            Decision::KeepPrevious => Self::KeepPrevious { below_threshold: is_below_threshold(cycle) },
            Decision::Continue => return None,
            Decision::Unproven => Self::Unproven,
        })
    }

    fn level(self) -> &'static str {
        match self {
            Self::NewPlan { .. } | Self::KeepPrevious { below_threshold: true } => TextLogLevel::INFO,
            Self::KeepPrevious { below_threshold: false } | Self::Unproven => TextLogLevel::WARN,
        }
    }
}

fn chosen(cycle: &Cycle) -> Option<&Candidate> {
    cycle.trace.chosen.and_then(|i| cycle.trace.candidates.get(i))
}

/// Whether the previous plan is kept although another one is proven.
fn is_below_threshold(cycle: &Cycle) -> bool {
    cycle.trace.rejections(Rejection::BelowSwitchingThreshold) > 0
}

/// The committed plan and the reason for it: decision, fallback stop, cost by terms, rejections.
fn summary(cycle: &Cycle) -> String {
    let plan = &cycle.plan.trajectory;
    let ahead = plan.profile.last().station - plan.at(cycle.plan.time).station;
    let stop = format!("fallback stop at {ahead:.1} m");
    let mut text = match cycle.plan.decision {
        Decision::NewPlan => {
            let deceleration = cycle.plan.deceleration;
            let lane = chosen(cycle).map_or_else(String::new, |c| format!(" on route lane {}", c.lane));
            let robust = if cycle.plan.is_robust { ", robust" } else { "" };
            let level = cycle.plan.level;
            format!("new plan{lane}, level {level}: {stop} with at most {deceleration:.1} m/s²{robust}")
        }
        Decision::KeepPrevious if is_below_threshold(cycle) => {
            format!("keep previous plan: the best candidate is below the switching threshold; {stop}")
        }
        Decision::KeepPrevious => format!("keep previous plan: no candidate has a proven stop; {stop}"),
        Decision::Continue => format!("continue: the plan was compared with others a moment ago; {stop}"),
        Decision::Unproven => match &cycle.plan.expected_contact {
            Some(contact) => format!("unproven: {contact}"),
            None => "unproven: no contact expected".into(),
        },
    };
    if let Some(cause) = cycle.plan.limited_by {
        let _ = write!(text, "; limited by {cause}");
    }
    if let Some(cause) = cycle.plan.stops_for {
        let what = if cycle.plan.decision == Decision::Unproven { "in the way" } else { "will stop for" };
        let _ = write!(text, "; {what}: {cause}");
    }
    if let Some(candidate) = chosen(cycle) {
        let _ = write!(text, "; cost {}", cost_by_terms(candidate));
    }
    if !cycle.trace.candidates.is_empty() {
        let _ = write!(text, "; {} candidates", cycle.trace.candidates.len());
    }
    let counts = Rejection::ALL.map(|reason| (reason, cycle.trace.rejections(reason)));
    let rejected = counts.iter().filter(|(_, count)| *count > 0).map(|(reason, count)| format!("{count} {reason}"));
    let rejected: Vec<String> = rejected.collect();
    if !rejected.is_empty() {
        let _ = write!(text, ", rejected: {}", rejected.join(", "));
    }
    text
}

/// The cost, and its terms in descending order.
pub(super) fn cost_by_terms(candidate: &Candidate) -> String {
    /// Smaller terms are omitted.
    const SMALLEST: f64 = 0.05;
    let mut terms: Vec<(&str, f64)> = candidate.terms.named().into_iter().filter(|(_, v)| *v >= SMALLEST).collect();
    terms.sort_by(|a, b| b.1.total_cmp(&a.1));
    let terms: Vec<String> = terms.iter().map(|(name, value)| format!("{name} {value:.1}")).collect();
    let equals = if terms.is_empty() { "" } else { " = " };
    format!("{:.1}{equals}{}", candidate.cost, terms.join(" + "))
}

/// The verdict as Markdown.
fn document(run: &Run) -> String {
    let outcome = ending(run);
    let mut text =
        format!("### {}\n\n{} · problem {}\n\n", plain(&run.scenario.id), plain(&run.vehicle.name), run.problem.id);
    if run.verdict.checks.is_empty() {
        let _ = writeln!(text, "**{outcome}** (one planning cycle, not driven)");
        return text;
    }
    let verdict = if run.verdict.pass() { "PASS" } else { "FAIL" };
    let _ = write!(
        text,
        "**{outcome} · {verdict}**\n\n| check | status | value | limit | at |\n|---|---|---:|---:|---:|\n"
    );
    for check in &run.verdict.checks {
        text.push_str(&row(check));
    }
    let failures: Vec<&Check> = run.verdict.failures().collect();
    if !failures.is_empty() {
        text.push_str("\n#### Failed checks\n\n");
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

/// Escapes text from files, so that it has no meaning in Markdown.
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
    fn logs_a_line_per_change_of_decision_and_one_for_the_end() {
        let example = Example::new();
        let run = example.run();
        let lines = lines(&run);
        let kinds: Vec<&str> = lines.iter().map(|l| l.text.split(':').next().unwrap()).collect();
        // the example keeps its previous plan in one cycle out of twenty
        let expected = [
            "new plan on route lane 0, level comfort",
            "keep previous plan",
            "new plan on route lane 0, level comfort",
            "FAIL",
        ];
        assert_eq!(kinds, expected);
        for part in
            ["m with at most 3.5 m/s²; cost 0.0;", "rejected: 1 curve_speed_infeasible, 1 blocked_at_start, 1 no_proof"]
        {
            assert!(lines[0].text.contains(part), "{part} in {}", lines[0].text);
        }
        assert_eq!(lines[3].text, "FAIL: stopped safely");
    }

    #[test]
    fn the_verdict_lists_every_check_and_the_failed_ones() {
        let example = Example::new();
        let run = example.run();
        let text = document(&run);
        assert!(run.verdict.checks.iter().all(|c| text.contains(&c.name.replace('_', " "))), "{text}");
        assert!(text.contains("stopped safely · FAIL") && text.contains("**FAIL**"));
        assert!(text.contains("\\<all \\| any\\>"), "text from files is escaped: {text}");
    }
}
