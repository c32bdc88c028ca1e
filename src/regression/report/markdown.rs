//! A summary for comments on changes: counts, what is wrong, and a table of all drives.

use std::fmt::Write as _;

use super::SHOWN;
use crate::regression::{Status, Summary};

/// All suites, one section each.
#[must_use]
pub fn markdown(suites: &[Summary]) -> String {
    let mut text = String::new();
    for summary in suites {
        // Writing to a String cannot fail.
        let mark = if summary.is_success() { "pass" } else { "FAIL" };
        let _ = writeln!(text, "## {}: {mark}\n\n{}\n", escape(&summary.name), escape(&summary.counts()));
        for drive in summary.drives.iter().filter(|d| d.status.is_failure() || d.status == Status::Error) {
            let _ = writeln!(text, "- **{}**: {}", escape(&drive.id), drive.status.name().replace('_', " "));
            for complaint in drive.complaints() {
                let _ = writeln!(text, "  - {}", escape(&complaint));
            }
        }
        if !summary.stale_in_baseline.is_empty() {
            let stale = escape(&summary.stale_in_baseline.join(", "));
            let _ = writeln!(text, "- in the baseline, but not in the suite: {stale}");
        }
        let head = SHOWN.map(|(_, head)| head).join(" | ");
        let _ = write!(
            text,
            "\n<details><summary>All drives</summary>\n\n| drive | status | outcome | {head} |\n|---|---|---|"
        );
        let _ = writeln!(text, "{}", "--:|".repeat(SHOWN.len()));
        for drive in &summary.drives {
            let status = drive.status.name().replace('_', " ");
            let figures = SHOWN.map(|(name, _)| drive.told(name)).join(" | ");
            let outcome = drive.outcome().unwrap_or("–").replace('_', " ");
            let _ = writeln!(text, "| {} | {status} | {outcome} | {figures} |", escape(&drive.id));
        }
        text.push_str("\n</details>\n\n");
    }
    text
}

/// Text that is shown as it is: nothing in it is markup, nor the end of a cell or line.
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
    fn nothing_in_a_text_is_markup() {
        assert_eq!(escape("a|b_c*d`e<f>\n&g"), "a\\|b\\_c\\*d\\`e&lt;f&gt; &amp;g");
    }
}
