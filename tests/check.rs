//! `stopline check` on the command line: exit codes, reports, interruptions, replays; and the bundled suite.

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;
use stopline::regression::{Options, Suite};

const ROAD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/maps/straight_100m.xml");

/// A drive that ends after one second, as expected.
const SECOND: &str = "settings.run.longest = 1.0\nexpect = \"timed_out\"\nchecks = [\"no_contact\"]\n";

struct Place(tempfile::TempDir);

impl Place {
    /// A folder with the road as `a.xml` and the suite.
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

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The exit code is `code`, and the output contains all words.
fn says(output: &Output, code: i32, words: &[&str]) {
    let printed = text(&output.stdout) + &text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{printed}");
    for word in words {
        assert!(printed.contains(word), "lacks \"{word}\": {printed}");
    }
    assert!(!printed.contains("panicked"), "{printed}");
}

/// The bundled suite passes, including its baseline.
#[test]
fn a_file_of_another_kind_is_named_with_its_reader() {
    let place = Place::new("");
    std::fs::write(place.path("map.osm"), "<osm/>").unwrap();
    says(&place.run(&["check", "a.xml"]), 3, &["a.xml: this is a CommonRoad scenario", "`stopline drive`"]);
    says(&place.run(&["check", "suite.toml", "--html", "page.png"]), 2, &["--html writes HTML", "page.html"]);
    says(&place.run(&["check", "map.osm"]), 3, &["map.osm: this is a Lanelet2", "expected a regression suite"]);
}

#[test]
fn the_bundled_suite_passes() -> Result<(), Box<dyn std::error::Error>> {
    let suite = Suite::load(Path::new(env!("CARGO_MANIFEST_DIR")).join("maps"))?;
    let summary = suite.run(&Options::default())?;
    assert!(summary.drives.len() >= 12, "{}", summary.counts());
    assert_eq!(summary.stale_in_baseline, Vec::<String>::new());
    Ok(summary.into_result()?)
}

/// The benchmark suite is valid and has a thousand drives.
#[test]
fn the_benchmark_suite_has_a_thousand_drives() {
    let suite = Suite::load(Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/suite_1000.toml")).unwrap();
    assert!(suite.ids().count() >= 1000, "{}", suite.ids().count());
}

#[test]
fn exit_0_if_all_drives_pass_with_every_report() {
    let place = Place::new(&format!("[[drive]]\nscenarios = \"a.xml\"\n{SECOND}"));
    let reports = ["--json", "r.json", "--junit", "r.xml", "--markdown", "r.md", "--html", "r.html"];
    says(&place.check(&reports), 0, &["suite: 1 drive: 1 PASS"]);
    assert_eq!(place.names(), ["a.xml", "r.html", "r.json", "r.md", "r.xml", "suite.toml"], "no temporary files");
    let report: Value = serde_json::from_str(&place.read("r.json")).unwrap();
    let drive = &report["suites"][0]["drives"][0];
    assert_eq!((&report["format"], &drive["status"]), (&Value::from("stopline.check/2"), &Value::from("pass")));
    assert_eq!(drive["result"]["format"], "stopline.drive/2");
    assert_eq!((drive["inputs"].as_str().unwrap().len(), drive["seed"].as_u64()), (64, Some(0)));
    assert!(report["configs"][drive["config"].as_str().unwrap()].as_str().unwrap().contains("longest = 1.0"));
    assert!(place.read("r.xml").contains("<testcase name=\"a.xml@bmw_320i\""));
    assert!(place.read("r.md").contains("1 drive: 1 PASS"));
    assert!(place.read("r.html").starts_with("<!DOCTYPE html>"));
    let quiet = place.check(&["--quiet"]);
    assert_eq!((quiet.status.code(), quiet.stdout.len(), quiet.stderr.len()), (Some(0), 0, 0));
    let output = place.check(&["--json", "-"]);
    assert_eq!(serde_json::from_slice::<Value>(&output.stdout).unwrap(), report, "one object only");
}

#[test]
fn an_empty_shard_passes_and_says_so() {
    let place = Place::new(&format!("[[drive]]\nscenarios = \"*.xml\"\n{SECOND}"));
    let warning = "shard 9/9 has no drives: the suite has 1, in the shard 1/9";
    says(&place.check(&["--shard", "9/9"]), 0, &["0 drives (shard 9/9)", warning]);
    let quiet = place.check(&["--shard", "9/9", "--quiet"]);
    assert_eq!(quiet.status.code(), Some(0));
    assert!(text(&quiet.stderr).contains(warning), "also with --quiet: {quiet:?}");
}

#[test]
fn a_misspelt_check_or_metric_is_an_error_of_the_suite_and_nothing_is_driven() {
    for (wrong, words) in [
        (
            "checks = [\"no_contcat\"]",
            ["suite.toml:2: ", "`checks`: there is no check `no_contcat`, expected", "`no_contact`?"],
        ),
        (
            "limits = { distanc_m = 1 }",
            ["suite.toml:2: ", "`limits`: there is no metric `distanc_m`, expected", "`distance_m`?"],
        ),
    ] {
        let place = Place::new(&format!("# roads\n[[drive]]\nscenarios = \"*.xml\"\n{wrong}\n"));
        let output = place.check(&["--json", "-"]);
        says(&output, 3, &words);
        assert!(output.stdout.is_empty(), "no report: {output:?}");
    }
}

#[test]
fn exit_1_if_a_drive_fails() {
    let place = Place::new("[[drive]]\nscenarios = \"*.xml\"\nsettings.run.longest = 1.0\n");
    says(&place.check(&["--html", "r.html"]), 1, &["1 FAIL", "outcome: timed_out, expected goal_reached"]);
    assert!(place.read("r.html").contains("data:image/svg+xml"), "a picture of the failed drive");
    std::fs::write(
        place.path("suite.toml"),
        format!("[[drive]]\nscenarios = \"*.xml\"\nexpected_failure = \"x\"\n{SECOND}"),
    )
    .unwrap();
    says(&place.check(&[]), 1, &["1 unexpected PASS"]);
}

#[test]
fn exit_2_for_wrong_use() {
    let place = Place::new(&format!("[[drive]]\nscenarios = \"*.xml\"\n{SECOND}"));
    says(&place.run(&["check"]), 2, &["SUITE"]);
    for shard in ["0/3", "4/3", "1", "a/b"] {
        says(&place.check(&["--shard", shard]), 2, &["--shard", "1 ≤ I ≤ N"]);
    }
    says(&place.check(&["--jobs", "0"]), 2, &["--jobs"]);
    says(&place.check(&["--replay", "a.xml@bmw_320"]), 2, &["--replay", "no drive", "did you mean `a.xml@bmw_320i`?"]);
    says(&place.check(&["--replay", "a.xml"]), 2, &["--replay", "did you mean `a.xml@bmw_320i`?"]);
    says(&place.check(&["--replay", "aa"]), 2, &["--replay", "did you mean `a.xml@bmw_320i`?"]);
    says(&place.check(&["--replay", "x", "--update-baseline"]), 2, &["--update-baseline"]);
    says(&place.check(&["--bless"]), 2, &["--bless is now --update-baseline"]);
    says(&place.check(&["--report", "x"]), 2, &["--replay"]);
    for (flag, input) in [("--json", "suite.toml"), ("--junit", "a.xml")] {
        says(&place.check(&[flag, input]), 2, &[flag, input, "twice"]);
    }
    says(&place.check(&["--json", "r", "--junit", "./r"]), 2, &["--junit", "twice"]);
    says(&place.check(&["--html", "-"]), 2, &["--html", "only --json"]);
    assert_eq!(place.names(), ["a.xml", "suite.toml"]);
}

#[test]
fn exit_3_for_unreadable_files() {
    let place = Place::new("[[drive]]\nscenarios = \"*.osm\"\n");
    says(&place.check(&[]), 3, &["suite.toml:1: `*.osm` matches no file"]);
    says(&place.run(&["check", "none.toml"]), 3, &["none.toml", "cannot be read"]);
    let write = |text: &str| std::fs::write(place.path("suite.toml"), text).unwrap();
    write("[[drive]]\nscenarios = \"*.xml\"\nvehicle = \"truk\"\n");
    says(&place.check(&[]), 3, &["suite.toml:1", "truk", "did you mean `truck`?"]);
    write("[[drive]]\nscenarios = \"*.xml\"\nvehicl = \"truck\"\n");
    says(&place.check(&[]), 3, &["line 3", "vehicl", "did you mean `vehicle`?"]);
    write(&format!(
        "baseline = \"baseline.json\"\n[[drive]]\nscenarios = \"*.xml\"\ntolerances.duration_s = 0.1\n{SECOND}"
    ));
    says(&place.check(&[]), 3, &["baseline.json", "--update-baseline"]);
    std::fs::write(place.path("baseline.json"), "{\"format\"").unwrap();
    says(&place.check(&[]), 3, &["baseline.json", "not a baseline"]);
    // one unreadable scenario: the other drives run, and the reports are written
    write(&format!("[[drive]]\nscenarios = \"*.xml\"\n{SECOND}"));
    std::fs::write(place.path("b.xml"), "<osm/>").unwrap();
    says(&place.check(&["--junit", "r.xml"]), 3, &["1 PASS, 1 ERROR", "b.xml"]);
    assert!(place.read("r.xml").contains("<error"));
    std::fs::remove_file(place.path("r.xml")).unwrap();
    let quiet = place.check(&["--quiet"]);
    assert_eq!(text(&quiet.stdout), "");
    says(&quiet, 3, &["error: b.xml@bmw_320i", "<osm>"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error_and_other_reports_are_written() {
    let place = Place::new(&format!("[[drive]]\nscenarios = \"*.xml\"\n{SECOND}"));
    for report in ["--json", "--junit", "--markdown", "--html"] {
        let other = if report == "--markdown" { "--html" } else { "--markdown" };
        says(&place.check(&[report, "/dev/full", other, "other"]), 3, &[report, "/dev/full: cannot be written"]);
        assert!(place.read("other").contains("1 drive"), "{other}");
        std::fs::remove_file(place.path("other")).unwrap();
    }
    says(
        &place.check(&["--resume", "none/state"]),
        3,
        &["--resume none/state: cannot be written: there is no folder none"],
    );
    says(&place.check(&["--resume", "/dev/full"]), 3, &["--resume /dev/full", "not a regular file"]);
    says(&place.check(&["--json", "none/r.json"]), 3, &["--json none/r.json", "cannot be written"]);
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

/// A run of 24 drives of two seconds, one at a time, that is interrupted after some drives.
#[cfg(unix)]
struct Interrupted {
    place: Place,
    child: std::process::Child,
}

#[cfg(unix)]
impl Interrupted {
    fn start(options: &[&str]) -> Self {
        use std::process::{Command, Stdio};
        let seeds: Vec<u32> = (0..24).collect();
        let suite = format!("[[drive]]\nscenarios = \"*.xml\"\nseeds = {seeds:?}\n{}", SECOND.replace("1.0", "2.0"));
        let place = Place::new(&suite);
        let child = Command::new(assert_cmd::cargo::cargo_bin("stopline"))
            .current_dir(place.0.path())
            .args(["check", "suite.toml", "--jobs", "1"])
            .args(options)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self { place, child }
    }

    /// The number of lines in the state file.
    fn lines(&self) -> usize {
        std::fs::read(self.place.path("state")).map_or(0, |b| b.iter().filter(|b| **b == b'\n').count())
    }

    /// Waits until the condition is met or the process has ended.
    fn wait_until(&mut self, is_met: impl Fn(&Self) -> bool) {
        while !is_met(self) && self.child.try_wait().unwrap().is_none() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
    }

    /// Whether the process has installed its handler of SIGINT.
    #[cfg(target_os = "linux")]
    fn handles_interrupts(&self) -> bool {
        const SIGINT_BIT: u64 = 1 << 1;
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap_or_default();
        let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
        caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & SIGINT_BIT != 0)
    }

    /// Sends SIGINT, as Ctrl-C does.
    fn interrupt(&self) {
        let sent = std::process::Command::new("kill").args(["-INT", &self.child.id().to_string()]).status().unwrap();
        assert!(sent.success(), "the process has ended already");
    }

    fn output(self) -> (Place, Output) {
        (self.place, self.child.wait_with_output().unwrap())
    }
}

/// Ctrl-C prints the results so far and the command to continue. The next run drives the remaining cases only, with the
/// same report as an uninterrupted run.
#[cfg(unix)]
#[test]
fn an_interrupted_run_can_be_resumed() {
    let options = ["--resume", "state", "--json", "r.json"];
    let mut run = Interrupted::start(&options);
    run.wait_until(|run| run.lines() >= 4);
    run.interrupt();
    let (place, output) = run.output();
    says(&output, 130, &["24 drives: ", " not driven", " of 24 drives finished, 0 failed", "no report was written"]);
    let printed = text(&output.stderr);
    let command = printed.lines().find_map(|line| line.strip_prefix("continue with: ")).unwrap();
    assert!(command.ends_with("check suite.toml --jobs 1 --resume state --json r.json"), "{command}");
    assert_eq!(place.names(), ["a.xml", "state", "suite.toml"], "no report, no temporary file");
    let before = place.read("state");
    assert!(before.ends_with('\n') && before.lines().count() < 25, "{} of 25 lines", before.lines().count());

    let mut words = command.split(' ');
    let resumed = Command::new(words.next().unwrap()).current_dir(place.0.path()).args(words).output().unwrap();
    says(&resumed, 0, &["24 drives: 24 PASS"]);
    assert!(place.read("state").starts_with(&before), "finished drives stay");
    assert_eq!(place.read("state").lines().count(), 25, "a header, and every drive once");
    let resumed = place.read("r.json");
    says(&place.check(&["--json", "r.json"]), 0, &["24 PASS"]);
    assert!(place.read("r.json") == resumed, "the report differs from that of an uninterrupted run");
}

#[cfg(target_os = "linux")]
#[test]
fn an_interrupted_run_without_a_state_file_names_the_flag() {
    use std::io::Read as _;
    let mut run = Interrupted::start(&["--html", "r.html", "--quiet"]);
    run.wait_until(Interrupted::handles_interrupts);
    run.interrupt();
    let mut stdout = String::new();
    run.child.stdout.take().unwrap().read_to_string(&mut stdout).unwrap();
    assert_eq!(stdout, "", "no drive failed");
    let (place, output) = run.output();
    says(&output, 130, &["interrupted: ", " of 24 drives finished", "with --resume STATE"]);
    assert_eq!(place.names(), ["a.xml", "suite.toml"], "no report, no temporary file");
}

/// The second Ctrl-C does not wait for the running drive.
#[cfg(unix)]
#[test]
fn a_second_interrupt_stops_at_once() {
    use std::io::{BufRead as _, BufReader};
    let mut run = Interrupted::start(&["--resume", "state"]);
    run.wait_until(|run| run.lines() >= 2);
    run.interrupt();
    let mut stderr = BufReader::new(run.child.stderr.take().unwrap());
    let mut line = String::new();
    stderr.read_line(&mut line).unwrap();
    assert!(line.starts_with("interrupted: finishing the running drives"), "{line}");
    run.interrupt();
    let (place, output) = run.output();
    assert_eq!(output.status.code(), Some(130));
    assert_eq!(place.names(), ["a.xml", "state", "suite.toml"], "no temporary file");
    says(&place.check(&["--resume", "state"]), 0, &["24 PASS"]);
}

#[test]
fn quiet_prints_one_line_per_failed_drive() {
    let place = Place::new("[[drive]]\nscenarios = \"*.xml\"\nsettings.run.longest = 1.0\n");
    let failed = "a.xml@bmw_320i: FAIL: outcome: timed_out, expected goal_reached or stopped_safely; ";
    let output = place.check(&["--quiet"]);
    says(&output, 1, &[]);
    let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
    assert!(stdout.starts_with(failed) && stdout.lines().count() == 1 && stderr.is_empty(), "{stdout}{stderr}");
    // the JSON has stdout for itself
    let output = place.check(&["--quiet", "--json", "-"]);
    assert!(serde_json::from_slice::<Value>(&output.stdout).is_ok());
    assert!(text(&output.stderr).starts_with(failed), "{}", text(&output.stderr));
}

#[test]
fn replays_a_drive_of_a_report() {
    let place = Place::new(&format!("[[drive]]\nscenarios = \"*.xml\"\nseeds = [3]\n{SECOND}"));
    says(&place.check(&["--json", "r.json"]), 0, &[]);
    let id = "a.xml@bmw_320i";
    let replay = ["--replay", id, "--report", "r.json", "--save-config", "c.toml", "--svg", "p.svg"];
    let output = place.check(&replay);
    says(&output, 0, &["the hash equals that of the report", "timed_out", "the same drive: stopline drive"]);
    assert!(place.read("p.svg").starts_with("<svg"));
    let report: Value = serde_json::from_str(&place.read("r.json")).unwrap();
    let hash = &report["suites"][0]["drives"][0]["result"]["hash"];
    let printed = text(&output.stderr);
    let command = printed.lines().find_map(|line| line.split_once("the same drive: stopline ")).unwrap().1;
    let drive = place.run(&[&command.split(' ').collect::<Vec<_>>()[..], &["--json", "-"]].concat());
    let drive: Value = serde_json::from_slice(&drive.stdout).unwrap();
    assert_eq!(&drive["hash"], hash);
    // without a report, the exit code is that of the drive
    says(&place.check(&["--replay", id]), 1, &["timed_out"]);
    // a report with another hash
    let other = place.read("r.json").replace(hash.as_str().unwrap(), &"0".repeat(64));
    std::fs::write(place.path("r.json"), other).unwrap();
    says(&place.check(&["--replay", id, "--report", "r.json"]), 1, &["the hash is", "the inputs are the same"]);
    std::fs::write(place.path("r.json"), "{}").unwrap();
    says(&place.check(&["--replay", id, "--report", "r.json"]), 3, &["--report r.json", "not a report"]);
}

#[test]
fn two_suites_cannot_update_one_baseline() {
    let suite = format!(
        "baseline = \"baseline.json\"\n[[drive]]\nscenarios = \"a.xml\"\n{SECOND}tolerances.distance_m = {{ absolute = 1.0 }}\n"
    );
    let place = Place::new(&suite);
    std::fs::write(place.path("other.toml"), suite.replace("[[drive]]", "[[drive]]\nname = \"b\"")).unwrap();
    says(&place.check(&["other.toml", "--update-baseline"]), 2, &["suite.toml", "other.toml", "baseline.json"]);
    says(&place.check(&["./suite.toml"]), 2, &["named twice"]);
    assert!(!place.path("baseline.json").exists());
}
