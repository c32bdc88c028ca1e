//! `stopline check` as a user meets it: exit codes, reports, interruptions, replays; and the bundled suite.

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;
use stopline::regression::{Options, Suite};

const ROAD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/maps/straight_100m.xml");

/// A drive of one second that is right.
const SECOND: &str = "settings.run.longest = 1.0\nexpect = \"timed_out\"\nchecks = [\"no_contact\"]\n";

struct Place(tempfile::TempDir);

impl Place {
    /// A folder with the road as `a.xml` and a suite of this text.
    fn new(suite: &str) -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        std::fs::copy(ROAD, place.path("a.xml")).unwrap();
        std::fs::write(place.path("suite.toml"), suite).unwrap();
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    fn run(&self, arguments: &[&str]) -> Output {
        Command::cargo_bin("stopline").unwrap().current_dir(self.0.path()).args(arguments).output().unwrap()
    }

    fn check(&self, arguments: &[&str]) -> Output {
        self.run(&[&["check", "suite.toml"], arguments].concat())
    }

    fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.path()).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

fn told(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// It ended with that code and said all the words.
fn says(output: &Output, code: i32, words: &[&str]) {
    let said = told(&output.stdout) + &told(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{said}");
    for word in words {
        assert!(said.contains(word), "does not say \"{word}\": {said}");
    }
    assert!(!said.contains("panicked"), "{said}");
}

/// The suite that comes with the program holds, baseline and all.
#[test]
fn the_bundled_suite_is_as_expected() -> Result<(), Box<dyn std::error::Error>> {
    let suite = Suite::load(Path::new(env!("CARGO_MANIFEST_DIR")).join("maps"))?;
    let summary = suite.run(&Options::default())?;
    assert!(summary.drives.len() >= 12, "{}", summary.counts());
    assert_eq!(summary.stale_in_baseline, Vec::<String>::new());
    Ok(summary.into_result()?)
}

/// The suite for the figures can be read, and is as large as it says.
#[test]
fn the_suite_of_a_thousand_drives_has_as_many() {
    let suite = Suite::load(Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/suite_1000.toml")).unwrap();
    assert!(suite.ids().count() >= 1000, "{}", suite.ids().count());
}

#[test]
fn exit_0_and_every_report_where_all_is_as_expected() {
    let place = Place::new(&format!("[[drive]]\nscenarios = \"a.xml\"\n{SECOND}"));
    let reports = ["--json", "r.json", "--junit", "r.xml", "--markdown", "r.md", "--html", "r.html"];
    says(&place.check(&reports), 0, &["suite: 1 drive: 1 pass"]);
    assert_eq!(place.names(), ["a.xml", "r.html", "r.json", "r.md", "r.xml", "suite.toml"], "and no temporary files");
    let report: Value = serde_json::from_str(&place.read("r.json")).unwrap();
    let drive = &report["suites"][0]["drives"][0];
    assert_eq!((&report["format"], &drive["status"]), (&Value::from("stopline.check/2"), &Value::from("pass")));
    assert_eq!(drive["result"]["format"], "stopline.drive/2");
    assert_eq!((drive["inputs"].as_str().unwrap().len(), drive["seed"].as_u64()), (64, Some(0)));
    assert!(report["configs"][drive["config"].as_str().unwrap()].as_str().unwrap().contains("longest = 1.0"));
    assert!(place.read("r.xml").contains("<testcase name=\"a.xml@bmw_320i\""));
    assert!(place.read("r.md").contains("1 drive: 1 pass"));
    assert!(place.read("r.html").starts_with("<!DOCTYPE html>"));
    let quiet = place.check(&["--quiet"]);
    assert_eq!((quiet.status.code(), quiet.stdout.len(), quiet.stderr.len()), (Some(0), 0, 0));
    let output = place.check(&["--json", "-"]);
    assert_eq!(serde_json::from_slice::<Value>(&output.stdout).unwrap(), report, "one object and nothing else");
}

#[test]
fn exit_1_is_a_drive_that_is_not_as_expected() {
    let place = Place::new("[[drive]]\nscenarios = \"*.xml\"\nsettings.run.longest = 1.0\n");
    says(&place.check(&["--html", "r.html"]), 1, &["1 fail", "outcome: ended as timed_out"]);
    assert!(place.read("r.html").contains("data:image/svg+xml"), "with its picture");
    std::fs::write(
        place.path("suite.toml"),
        format!("[[drive]]\nscenarios = \"*.xml\"\nexpected_fail = \"x\"\n{SECOND}"),
    )
    .unwrap();
    says(&place.check(&[]), 1, &["1 unexpected pass"]);
}

#[test]
fn exit_2_is_wrong_use() {
    let place = Place::new(&format!("[[drive]]\nscenarios = \"*.xml\"\n{SECOND}"));
    says(&place.run(&["check"]), 2, &["SUITE"]);
    for shard in ["0/3", "4/3", "1", "a/b"] {
        says(&place.check(&["--shard", shard]), 2, &["--shard", "1 ≤ I ≤ N"]);
    }
    says(&place.check(&["--jobs", "0"]), 2, &["--jobs"]);
    says(&place.check(&["--replay", "a.xml@bmw_320"]), 2, &["no drive", "did you mean `a.xml@bmw_320i`?"]);
    says(&place.check(&["--replay", "x", "--bless"]), 2, &["--bless"]);
    says(&place.check(&["--report", "x"]), 2, &["--replay"]);
    for input in ["suite.toml", "a.xml"] {
        says(&place.check(&["--json", input]), 2, &[input, "twice"]);
    }
    says(&place.check(&["--json", "r", "--junit", "./r"]), 2, &["twice"]);
    says(&place.check(&["--html", "-"]), 2, &["only --json goes to stdout"]);
    assert_eq!(place.names(), ["a.xml", "suite.toml"]);
}

#[test]
fn exit_3_is_an_input_that_cannot_be_read() {
    let place = Place::new("[[drive]]\nscenarios = \"*.osm\"\n");
    says(&place.check(&[]), 3, &["suite.toml:1: `*.osm` matches no file"]);
    says(&place.run(&["check", "none.toml"]), 3, &["none.toml", "cannot be read"]);
    let write = |text: &str| std::fs::write(place.path("suite.toml"), text).unwrap();
    write("[[drive]]\nscenarios = \"*.xml\"\nvehicle = \"truk\"\n");
    says(&place.check(&[]), 3, &["suite.toml:1", "truk", "did you mean `truck`?"]);
    write("[[drive]]\nscenarios = \"*.xml\"\nvehicl = \"truck\"\n");
    says(&place.check(&[]), 3, &["line 3", "vehicl", "did you mean `vehicle`?"]);
    write(&format!(
        "baseline = \"kept.json\"\n[[drive]]\nscenarios = \"*.xml\"\ntolerances.duration_s = 0.1\n{SECOND}"
    ));
    says(&place.check(&[]), 3, &["kept.json", "--bless"]);
    std::fs::write(place.path("kept.json"), "{\"format\"").unwrap();
    says(&place.check(&[]), 3, &["kept.json", "not a baseline"]);
    // one scenario that cannot be read: the others are driven, and the reports are written
    write(&format!("[[drive]]\nscenarios = \"*.xml\"\n{SECOND}"));
    std::fs::write(place.path("b.xml"), "<osm/>").unwrap();
    says(&place.check(&["--junit", "r.xml"]), 3, &["1 pass, 1 error", "b.xml"]);
    assert!(place.read("r.xml").contains("<error"));
    std::fs::remove_file(place.path("r.xml")).unwrap();
    let quiet = place.check(&["--quiet"]);
    assert_eq!(told(&quiet.stdout), "");
    says(&quiet, 3, &["error: b.xml@bmw_320i", "<osm>"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_told_and_takes_no_other_report_with_it() {
    let place = Place::new(&format!("[[drive]]\nscenarios = \"*.xml\"\n{SECOND}"));
    for report in ["--json", "--junit", "--markdown", "--html"] {
        let other = if report == "--markdown" { "--html" } else { "--markdown" };
        says(&place.check(&[report, "/dev/full", other, "other"]), 3, &["/dev/full: cannot be written"]);
        assert!(place.read("other").contains("1 drive"), "{other}");
        std::fs::remove_file(place.path("other")).unwrap();
    }
    says(&place.check(&["--resume", "/dev/full"]), 3, &["/dev/full", "not a regular file"]);
    says(&place.check(&["--json", "none/r.json"]), 3, &["none/r.json", "cannot be written"]);
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let status = std::process::Command::new(assert_cmd::cargo::cargo_bin("stopline"))
        .current_dir(place.0.path())
        .args(["check", "suite.toml", "--json", "-"])
        .stdout(full)
        .stderr(std::process::Stdio::null())
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(3));
}

/// Ctrl-C in the middle: no half report, and the next run drives only what is missing and comes to the same bytes.
#[cfg(unix)]
#[test]
fn a_run_that_is_interrupted_goes_on_where_it_was() {
    use std::os::unix::process::ExitStatusExt as _;
    let seeds: Vec<u32> = (0..24).collect();
    let suite = format!("[[drive]]\nscenarios = \"*.xml\"\nseeds = {seeds:?}\n{}", SECOND.replace("1.0", "2.0"));
    let place = Place::new(&suite);
    let arguments = ["check", "suite.toml", "--jobs", "1", "--resume", "state", "--json", "r.json"];
    let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin("stopline"))
        .current_dir(place.0.path())
        .args(arguments)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let lines = || std::fs::read(place.path("state")).map_or(0, |b| b.iter().filter(|b| **b == b'\n').count());
    while lines() < 4 && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let interrupted = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let status = child.wait().unwrap();
    assert!(interrupted.success() && status.signal() == Some(2), "{status:?}: it had ended already");
    assert_eq!(place.names(), ["a.xml", "state", "suite.toml"], "no report, no temporary file");
    let before = place.read("state");
    assert!(lines() < 24, "{} of 25 lines", lines());

    says(&place.run(&arguments), 0, &["24 drives: 24 pass"]);
    let whole: String = before.split_inclusive('\n').filter(|line| line.ends_with('\n')).collect();
    assert!(place.read("state").starts_with(&whole), "what was finished stays");
    assert_eq!(lines(), 25, "a head, and every drive once");
    let resumed = place.read("r.json");
    says(&place.check(&["--json", "r.json"]), 0, &["24 pass"]);
    assert!(place.read("r.json") == resumed, "another result than without the interruption");
}

#[test]
fn a_drive_of_a_report_is_replayed_and_made_by_itself() {
    let place = Place::new(&format!("[[drive]]\nscenarios = \"*.xml\"\nseeds = [3]\n{SECOND}"));
    says(&place.check(&["--json", "r.json"]), 0, &[]);
    let id = "a.xml@bmw_320i";
    let replay = ["--replay", id, "--report", "r.json", "--save-config", "c.toml", "--svg", "p.svg"];
    let output = place.check(&replay);
    says(&output, 0, &["the hash is that of the report", "timed_out", "the same by itself: stopline drive"]);
    assert!(place.read("p.svg").starts_with("<svg"));
    let report: Value = serde_json::from_str(&place.read("r.json")).unwrap();
    let hash = &report["suites"][0]["drives"][0]["result"]["hash"];
    let said = told(&output.stderr);
    let command = said.lines().find_map(|line| line.split_once("by itself: stopline ")).unwrap().1;
    let by_itself = place.run(&[&command.split(' ').collect::<Vec<_>>()[..], &["--json", "-"]].concat());
    let by_itself: Value = serde_json::from_slice(&by_itself.stdout).unwrap();
    assert_eq!(&by_itself["hash"], hash);
    // without a report it is judged as a drive is
    says(&place.check(&["--replay", id]), 1, &["timed_out"]);
    // a report that says otherwise
    let other = place.read("r.json").replace(hash.as_str().unwrap(), &"0".repeat(64));
    std::fs::write(place.path("r.json"), other).unwrap();
    says(&place.check(&["--replay", id, "--report", "r.json"]), 1, &["the hash is", "with the same inputs"]);
    std::fs::write(place.path("r.json"), "{}").unwrap();
    says(&place.check(&["--replay", id, "--report", "r.json"]), 3, &["r.json", "not a report"]);
}

#[test]
fn suites_that_would_throw_out_each_others_figures_are_refused() {
    let suite = format!(
        "baseline = \"kept.json\"\n[[drive]]\nscenarios = \"a.xml\"\n{SECOND}tolerances.distance_m = {{ absolute = 1.0 }}\n"
    );
    let place = Place::new(&suite);
    std::fs::write(place.path("other.toml"), suite.replace("[[drive]]", "[[drive]]\nname = \"b\"")).unwrap();
    says(&place.check(&["other.toml", "--bless"]), 2, &["suite.toml", "other.toml", "kept.json"]);
    says(&place.check(&["./suite.toml"]), 2, &["named twice"]);
    assert!(!place.path("kept.json").exists());
}
