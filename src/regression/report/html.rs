//! A page with pictures of failed drives.
//!
//! The page is self-contained: no script, no network; its content security policy forbids both. A picture is an image with
//! a data URL, so that ids and styles of two pictures do not meet. Maud escapes all text.

use maud::{DOCTYPE, Markup, PreEscaped, html as markup};
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};

use super::COLUMNS;
use crate::regression::{DriveReport, Status, Summary, shell_command};

const STYLE: &str = "\
:root{color-scheme:light dark;--fine:#1a7f37;--alarm:#cf222e;--known:#9a6700;--line:#8884}\
body{font:15px/1.45 system-ui,sans-serif;max-width:78rem;margin:2rem auto;padding:0 1rem}\
h1{font-size:1.4rem}h2{font-size:1.2rem;margin-top:2.5rem}\
.counts{color:GrayText}table{border-collapse:collapse;width:100%;font-size:.9rem}\
th,td{padding:.25rem .6rem;border-bottom:1px solid var(--line);text-align:right;font-variant-numeric:tabular-nums}\
th:first-child,td:first-child,td.word,th.word{text-align:left;overflow-wrap:anywhere}\
.scroll{overflow-x:auto}.pass{color:var(--fine)}.fail,.unexpected_pass,.error{color:var(--alarm);font-weight:600}\
.expected_failure{color:var(--known)}section.drive{border-left:4px solid var(--alarm);padding:.2rem 1rem;margin:1.2rem 0}\
section.drive h3{font-size:1rem;margin:.3rem 0;overflow-wrap:anywhere}img{max-width:100%;height:auto;background:#fff}\
code,pre{font-size:.85rem}pre{overflow-x:auto}li{overflow-wrap:anywhere}";

/// The content security policy: the page shows only itself.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:";

/// Characters of a picture that need no percent encoding in a data URL in an attribute.
const ENCODED: &AsciiSet = &NON_ALPHANUMERIC
    .remove(b' ')
    .remove(b'.')
    .remove(b',')
    .remove(b'-')
    .remove(b'_')
    .remove(b'=')
    .remove(b'/')
    .remove(b':')
    .remove(b';')
    .remove(b'(')
    .remove(b')');

/// All suites on one page.
#[must_use]
pub fn html(suites: &[Summary]) -> String {
    let is_success = suites.iter().all(Summary::is_success);
    let title = if is_success { "stopline check: PASS" } else { "stopline check: FAIL" };
    let page = markup! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="viewport" content="width=device-width, initial-scale=1";
                link rel="icon" href="data:,";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (title) }
                @for summary in suites { (suite(summary)) }
            }
        }
    };
    page.into_string() + "\n"
}

fn suite(summary: &Summary) -> Markup {
    let failed = summary.drives.iter().filter(|d| d.status.is_failure() || d.status == Status::Error);
    markup! {
        h2 { (summary.name) }
        p class="counts" { (summary.counts()) }
        @for drive in failed { (failed_drive(summary, drive)) }
        @if !summary.stale_in_baseline.is_empty() {
            p { "In the baseline, but not in the suite: " (summary.stale_in_baseline.join(", ")) }
        }
        div class="scroll" {
            table {
                tr {
                    th { "drive" }
                    th class="word" { "status" }
                    th class="word" { "outcome" }
                    @for (_, heading) in COLUMNS { th { (heading) } }
                }
                @for drive in &summary.drives {
                    tr {
                        td { (drive.id) }
                        td class={ "word " (drive.status.name()) } { (drive.status.label()) }
                        td class="word" { (drive.outcome().unwrap_or("–").replace('_', " ")) }
                        @for (name, _) in COLUMNS { td { (drive.metric(name)) } }
                    }
                }
            }
        }
    }
}

/// A failed drive: the reasons, a picture, the command that replays it.
fn failed_drive(summary: &Summary, drive: &DriveReport) -> Markup {
    let file = summary.file.to_string_lossy();
    markup! {
        section class="drive" {
            h3 { (drive.id) " " span class=(drive.status.name()) { (drive.status.label()) } }
            ul {
                @for problem in drive.problems() { li { (problem) } }
            }
            @if let Some(picture) = &drive.picture {
                img alt=(drive.id) src=(data_url(picture));
            }
            p { code { (shell_command(["stopline", "check", &file, "--replay", &drive.id])) } }
            @if let Some(hash) = drive.hash() {
                p { "seed " (drive.seed) ", hash " code { (hash) } }
            }
            details {
                summary { "settings" }
                pre { (drive.config) }
            }
        }
    }
}

fn data_url(svg: &str) -> String {
    format!("data:image/svg+xml;charset=utf-8,{}", utf8_percent_encode(svg, ENCODED))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodes_markup_in_a_data_url() {
        assert_eq!(
            data_url("<a b=\"é\">#%</a>"),
            "data:image/svg+xml;charset=utf-8,%3Ca b=%22%C3%A9%22%3E%23%25%3C/a%3E"
        );
    }
}
