//! JUnit XML for CI systems: `failure` is an expectation that is not met, `error` an input or a fault of the program.
//!
//! An expected failure is `skipped`, with its reason, as in other tools. Metrics are properties of the test case. There is
//! no `time`: reports of equal runs are equal.

use quick_junit::{NonSuccessKind, Property, Report, TestCase, TestCaseStatus, TestSuite};

use crate::regression::{DriveReport, Status, Summary};

/// All suites as one document with a `testsuite` each.
///
/// # Errors
/// The document cannot be written: a fault of the program.
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
    let problems = drive.problems();
    let first = problems.first().cloned().unwrap_or_default();
    let status = match drive.status {
        Status::Pass => TestCaseStatus::success(),
        Status::ExpectedFailure => {
            let mut skipped = TestCaseStatus::skipped();
            skipped.set_message(format!("expected failure: {}", drive.expected_failure.as_deref().unwrap_or_default()));
            skipped
        }
        Status::Fail | Status::UnexpectedPass | Status::Error => {
            let is_error = drive.status == Status::Error;
            let kind = if is_error { NonSuccessKind::Error } else { NonSuccessKind::Failure };
            let class = drive.error.as_ref().map(|e| e.kind.name());
            let class = class.or_else(|| drive.failures.first().map(|f| f.kind.name())).unwrap_or_default();
            let mut status = TestCaseStatus::non_success(kind);
            status.set_message(first).set_type(class).set_description(problems.join("\n"));
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
    let metrics = drive.metrics().into_iter().filter_map(|(name, value)| Some((name, value?)));
    case.add_properties(metrics.map(|(name, value)| text(&name, &value.to_string())));
    case
}
