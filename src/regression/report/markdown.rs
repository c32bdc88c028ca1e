//! A summary for a comment on a change: counts, failures, a table of all drives.

use std::fmt::Write as _;

use super::COLUMNS;
use crate::regression::{Status, Summary};

/// All suites, one section each.
#[must_use]
pub fn markdown(suites: &[Summary]) -> String {
    let mut text = String::new();
    for summary in suites {
        // Writing to a String cannot fail.
        let mark = if summary.is_success() { "PASS" } else { "FAIL" };
        let _ = writeln!(text, "## {}: {mark}\n\n{}\n", escape(&summary.name), escape(&summary.counts()));
        for drive in summary.drives.iter().filter(|d| d.status.is_failure() || d.status == Status::Error) {
            let _ = writeln!(text, "- **{}**: {}", escape(&drive.id), drive.status.label());
            for problem in drive.problems() {
                let _ = writeln!(text, "  - {}", escape(&problem));
            }
        }
        if !summary.stale_in_baseline.is_empty() {
            let stale = escape(&summary.stale_in_baseline.join(", "));
            let _ = writeln!(text, "- in the baseline, but not in the suite: {stale}");
        }
        let head = COLUMNS.map(|(_, head)| head).join(" | ");
        let _ = write!(
            text,
            "\n<details><summary>All drives</summary>\n\n| drive | status | outcome | {head} |\n|---|---|---|"
        );
        let _ = writeln!(text, "{}", "--:|".repeat(COLUMNS.len()));
        for drive in &summary.drives {
            let status = drive.status.label();
            let metrics = COLUMNS.map(|(name, _)| drive.metric(name)).join(" | ");
            let outcome = drive.outcome().unwrap_or("–").replace('_', " ");
            let _ = writeln!(text, "| {} | {status} | {outcome} | {metrics} |", escape(&drive.id));
        }
        text.push_str("\n</details>\n\n");
    }
    text
}

/// Escapes text so that it contains no markup and ends no cell or line.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '\n' | '\r' => escaped.push(' '),
            '\\' | '`' | '*' | '_' | '[' | ']' | '|' | '~' | '#' | '!' | '@' => escaped.extend(['\\', c]),
            c => escaped.push(c),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escapes_markup() {
        assert_eq!(escape("a|b_c*d`e<f>\n&g"), "a\\|b\\_c\\*d\\`e&lt;f&gt; &amp;g");
    }
}
