//! A page for people: self-contained, with pictures of what failed.
//!
//! It has no script and fetches nothing; its own policy forbids both. A picture is an image inside the page, as data,
//! so that the ids and styles of one cannot meet those of another. The page is well-formed XML, too: any XML reader can
//! check it.

use std::fmt::Write as _;

use super::SHOWN;
use crate::regression::{DriveReport, Status, Summary};

const STYLE: &str = "\
:root{color-scheme:light dark;--fine:#1a7f37;--alarm:#cf222e;--known:#9a6700;--line:#8884}\
body{font:15px/1.45 system-ui,sans-serif;max-width:78rem;margin:2rem auto;padding:0 1rem}\
h1{font-size:1.4rem}h2{font-size:1.2rem;margin-top:2.5rem}\
.counts{color:GrayText}table{border-collapse:collapse;width:100%;font-size:.9rem}\
th,td{padding:.25rem .6rem;border-bottom:1px solid var(--line);text-align:right;font-variant-numeric:tabular-nums}\
th:first-child,td:first-child,td.word,th.word{text-align:left;overflow-wrap:anywhere}\
.scroll{overflow-x:auto}.pass{color:var(--fine)}.fail,.unexpected_pass,.error{color:var(--alarm);font-weight:600}\
.expected_fail{color:var(--known)}section.drive{border-left:4px solid var(--alarm);padding:.2rem 1rem;margin:1.2rem 0}\
section.drive h3{font-size:1rem;margin:.3rem 0;overflow-wrap:anywhere}img{max-width:100%;height:auto;background:#fff}\
code,pre{font-size:.85rem}pre{overflow-x:auto}li{overflow-wrap:anywhere}";

/// What the page may do: nothing but show itself.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:";

/// All suites on one page.
#[must_use]
pub fn html(suites: &[Summary]) -> String {
    let fine = suites.iter().all(Summary::is_success);
    let title = if fine { "stopline check: pass" } else { "stopline check: FAIL" };
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
         <link rel=\"icon\" href=\"data:,\"/>\n<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n"
    );
    for summary in suites {
        suite(&mut page, summary);
    }
    page.push_str("</body>\n</html>\n");
    page
}

fn suite(page: &mut String, summary: &Summary) {
    // Writing to a String cannot fail.
    let (name, counts) = (escape(&summary.name), escape(&summary.counts()));
    let _ = writeln!(page, "<h2>{name}</h2>\n<p class=\"counts\">{counts}</p>");
    for drive in summary.drives.iter().filter(|d| d.status.is_failure() || d.status == Status::Error) {
        failed(page, summary, drive);
    }
    if !summary.stale_in_baseline.is_empty() {
        let stale = escape(&summary.stale_in_baseline.join(", "));
        let _ = writeln!(page, "<p>In the baseline, but not in the suite: {stale}</p>");
    }
    let heads: String = SHOWN.iter().map(|(_, head)| format!("<th>{head}</th>")).collect();
    let _ = writeln!(
        page,
        "<div class=\"scroll\"><table>\n<tr><th>drive</th><th class=\"word\">status</th><th class=\"word\">outcome</th>{heads}</tr>"
    );
    for drive in &summary.drives {
        let (class, status) = (drive.status.name(), drive.status.name().replace('_', " "));
        let outcome = drive.outcome().unwrap_or("–").replace('_', " ");
        let cells: String = SHOWN.iter().map(|(name, _)| format!("<td>{}</td>", drive.told(name))).collect();
        let id = escape(&drive.id);
        let _ = writeln!(
            page,
            "<tr><td>{id}</td><td class=\"word {class}\">{status}</td><td class=\"word\">{}</td>{cells}</tr>",
            escape(&outcome)
        );
    }
    page.push_str("</table></div>\n");
}

/// A drive that is not as expected: what is wrong, its picture, how to see it again.
fn failed(page: &mut String, summary: &Summary, drive: &DriveReport) {
    let (class, status) = (drive.status.name(), drive.status.name().replace('_', " "));
    let _ = writeln!(
        page,
        "<section class=\"drive\">\n<h3>{} <span class=\"{class}\">{status}</span></h3>\n<ul>",
        escape(&drive.id)
    );
    for complaint in drive.complaints() {
        let _ = writeln!(page, "<li>{}</li>", escape(&complaint));
    }
    page.push_str("</ul>\n");
    if let Some(picture) = &drive.picture {
        let _ = writeln!(page, "<img alt=\"{}\" src=\"{}\"/>", escape(&drive.id), data(picture));
    }
    let (file, id) = (summary.file.to_string_lossy(), drive.id.replace('\'', "'\\''"));
    let _ = writeln!(page, "<p><code>stopline check {} --replay '{}'</code></p>", escape(&file), escape(&id));
    if let Some(hash) = drive.hash() {
        let _ = writeln!(page, "<p>seed {}, hash <code>{}</code></p>", drive.seed, escape(hash));
    }
    let _ = writeln!(
        page,
        "<details><summary>settings</summary><pre>{}</pre></details>\n</section>",
        escape(&drive.config)
    );
}

/// A picture as a data URL: what could end the attribute or the URL is written as bytes.
fn data(svg: &str) -> String {
    let mut url = String::with_capacity(svg.len() + svg.len() / 4);
    url.push_str("data:image/svg+xml;charset=utf-8,");
    for byte in svg.bytes() {
        match byte {
            b'a'..=b'z'
            | b'A'..=b'Z'
            | b'0'..=b'9'
            | b' '
            | b'.'
            | b','
            | b'-'
            | b'_'
            | b'='
            | b'/'
            | b':'
            | b';'
            | b'('
            | b')' => url.push(char::from(byte)),
            other => drop(write!(url, "%{other:02X}")),
        }
    }
    url
}

/// Text that is no markup, in content and in quoted attributes.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;").replace('\'', "&#39;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_in_a_text_is_markup() {
        assert_eq!(escape("<script>\"&'"), "&lt;script&gt;&quot;&amp;&#39;");
        assert_eq!(data("<a b=\"é\">#%</a>"), "data:image/svg+xml;charset=utf-8,%3Ca b=%22%C3%A9%22%3E%23%25%3C/a%3E");
    }
}
