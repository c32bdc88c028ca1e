//! JUnit XML, as CI systems read it: `failure` is a verdict or an expectation, `error` a tool or an input.
//!
//! A drive that fails as expected is `skipped`, with the reason: that is how the format's readers show it. Figures are
//! properties of the test case. There is no `time`: reports of equal runs are equal.

use quick_junit::{NonSuccessKind, Property, Report, TestCase, TestCaseStatus, TestSuite};

use crate::regression::{DriveReport, Status, Summary};

/// All suites as one document; one `testsuite` each.
///
/// # Errors
/// The document cannot be made: a fault of the program.
pub fn junit(suites: &[Summary]) -> Result<String, quick_junit::SerializeError> {
    let mut report = Report::new("stopline check");
    for summary in suites {
        let mut suite = TestSuite::new(summary.name.as_str());
        suite.add_property(Property::new("file", summary.file.to_string_lossy()));
        if let Some(shard) = summary.shard {
            suite.add_property(Property::new("shard", shard.to_string()));
        }
        suite.add_test_cases(summary.drives.iter().map(|d| case(summary, d)));
        report.add_test_suite(suite);
    }
    report.to_string()
}

fn case(summary: &Summary, drive: &DriveReport) -> TestCase {
    let complaints = drive.complaints();
    let first = complaints.first().cloned().unwrap_or_default();
    let status = match drive.status {
        Status::Pass => TestCaseStatus::success(),
        Status::ExpectedFail => {
            let mut skipped = TestCaseStatus::skipped();
            skipped.set_message(format!("expected to fail: {}", drive.expected_fail.as_deref().unwrap_or_default()));
            skipped
        }
        Status::Fail | Status::UnexpectedPass | Status::Error => {
            let is_error = drive.status == Status::Error;
            let kind = if is_error { NonSuccessKind::Error } else { NonSuccessKind::Failure };
            let class = drive.error.as_ref().map(|e| e.kind.name());
            let class = class.or_else(|| drive.failures.first().map(|f| f.kind.name())).unwrap_or_default();
            let mut status = TestCaseStatus::non_success(kind);
            status.set_message(first).set_type(class).set_description(complaints.join("\n"));
            status
        }
    };
    let mut case = TestCase::new(drive.id.as_str(), status);
    case.set_classname(summary.name.as_str());
    let text = |name: &str, value: &str| Property::new(name, value);
    case.add_properties([text("scenario", &drive.scenario), text("vehicle", &drive.vehicle)]);
    case.add_property(text("seed", &drive.seed.to_string()));
    case.add_properties(drive.outcome().map(|outcome| text("outcome", outcome)));
    case.add_properties(drive.hash().map(|hash| text("hash", hash)));
    let figures = drive.figures().into_iter().filter_map(|(name, value)| Some((name, value?)));
    case.add_properties(figures.map(|(name, value)| text(&name, &value.to_string())));
    case
}
