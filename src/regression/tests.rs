//! Tests of suites with the public interface: folders with one road, drives of one second.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use super::report::{html, json, junit, markdown};
use super::*;

const ROAD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/maps/straight_100m.xml");

/// A drive that ends after one second, as expected.
const SECOND: &str = "settings.run.longest = 1.0\nexpect = \"timed_out\"\nchecks = [\"no_contact\", \"stop_proven\"]\n";

/// A folder with `a.xml` and `b.xml`, both the road.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        for name in ["a.xml", "b.xml"] {
            std::fs::copy(ROAD, place.path(name)).unwrap();
        }
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) -> PathBuf {
        std::fs::write(self.path(name), text).unwrap();
        self.path(name)
    }

    fn load(&self, text: &str) -> Result<Suite, SuiteError> {
        Suite::load(self.write("suite.toml", text))
    }

    fn suite(&self, text: &str) -> Suite {
        self.load(text).unwrap_or_else(|e| panic!("{e}\n{text}"))
    }

    fn run(&self, text: &str) -> Summary {
        self.suite(text).run(&Options::default()).unwrap()
    }

    /// The error of an invalid suite.
    fn error(&self, text: &str) -> String {
        match self.load(text) {
            Err(error) => error.to_string(),
            Ok(suite) => panic!("accepted with {:?}:\n{text}", suite.ids().collect::<Vec<_>>()),
        }
    }
}

fn all_reports(summary: &Summary) -> [String; 4] {
    let all = std::slice::from_ref(summary);
    [json(all), junit(all).unwrap(), markdown(all), html(all)]
}

#[test]
fn errors_name_the_cause_and_the_line() {
    let place = Place::new();
    place.write("wrong.toml", "[planner]\n\ncruise_sped = 3.0\n");
    place.write("range.toml", "[run]\nlongest = -1.0\n");
    let drive = "[[drive]]\nscenarios = \"a.xml\"\n";
    let cases: &[(&str, &[&str])] = &[
        ("", &["missing key `drive`"]),
        ("drive = []", &["no [[drive]]"]),
        ("[[drive]\n", &["line 1"]),
        ("\nbaselin = \"x\"\n[[drive]]\nscenarios = \"a.xml\"", &["line 2", "`baselin`", "did you mean `baseline`?"]),
        ("[[drive]]\nscenario = \"a.xml\"", &["line 2", "did you mean `scenarios`?"]),
        ("[[drive]]\nscenarios = 3", &["line 2", "a text or a list of texts"]),
        ("[[drive]]\nscenarios = []", &["line 2", "at least one"]),
        ("[[drive]]\nvehicle = \"truck\"", &["suite.toml:1:", "`scenarios`"]),
        ("\n[[drive]]\nscenarios = \"*.osm\"", &["suite.toml:2:", "`*.osm` matches no file"]),
        ("[[drive]]\nscenarios = [\"a.xml\", \"c.xml\"]", &["suite.toml:1:", "`c.xml` matches no file"]),
        ("[[drive]]\nscenarios = \"none/*.xml\"", &["suite.toml:1:", "none/*.xml"]),
        ("[[drive]]\nscenarios = \"*.xml\"\nexclude = \"c.xml\"", &["`exclude`", "`c.xml` matches none"]),
        ("[[drive]]\nscenarios = \"*.xml\"\nexclude = \"*\"", &["leaves no scenario"]),
        ("[defaults]\nname = \"x\"\n[[drive]]\nscenarios = \"a.xml\"", &["suite.toml:1:", "belong to a [[drive]]"]),
        (&format!("{drive}vehicle = \"truk\""), &["suite.toml:1:", "no vehicle", "did you mean `truck`?"]),
        (&format!("{drive}vehicle = \"my/car\""), &["suite.toml:1:", "no vehicle"]),
        (&format!("{drive}expect = \"goal\""), &["line 3", "`goal`", "goal_reached"]),
        (&format!("{drive}expect = [\"goal_reachd\"]"), &["line 3", "did you mean `goal_reached`?"]),
        (&format!("{drive}expected_failure = true"), &["line 3", "expected a text in quotes"]),
        (&format!("{drive}expected_fail = \"x\""), &["line 3", "`expected_fail`", "did you mean `expected_failure`?"]),
        (&format!("{drive}problem = \"1\""), &["line 3"]),
        (&format!("{drive}repetitions = 0"), &["line 3", "0 repetitions, expected 1 to 1000"]),
        (&format!("{drive}seeds = []"), &["`seeds` is empty"]),
        (&format!("{drive}seeds = [-1]"), &["line 3"]),
        (&format!("{drive}limits = {{ tracking = \"0.2\" }}"), &["line 3", "a number (the maximum)"]),
        (&format!("{drive}limits = {{ tracking = nan }}"), &["line 3", "nan"]),
        (&format!("{drive}limits = {{ tracking = {{ mn = 1 }} }}"), &["line 3", "`mn`", "did you mean `min`?"]),
        (&format!("{drive}limits = {{ tracking = {{}} }}"), &["line 3", "empty table"]),
        (&format!("{drive}limits = {{ tracking = {{ min = 2, max = 1 }} }}"), &["`min` 2 is above `max` 1"]),
        (&format!("{drive}tolerances = {{ tracking = -1 }}"), &["line 3", "below zero"]),
        (&format!("{drive}tolerances = {{ tracking = 1 }}"), &["a.xml@bmw_320i", "no `baseline`"]),
        (
            &format!("\n{drive}checks = [\"stops\", \"no_contcat\"]"),
            &[
                "suite.toml:2:",
                "`checks`: there is no check `no_contcat`, expected one of simulation, no_contact, stays_on_road, ",
                "; did you mean `no_contact`?",
            ],
        ),
        (&format!("{drive}checks = [\"distance_m\"]"), &["`checks`: there is no check `distance_m`"]),
        (
            &format!("{drive}limits = {{ distanc_m = 1 }}"),
            &[
                "suite.toml:1:",
                "`limits`: there is no metric `distanc_m`, expected a check, or a number in `metrics` or `planning`",
                "; did you mean `distance_m`?",
            ],
        ),
        (
            &format!("baseline = \"b.json\"\n[defaults]\ntolerances = {{ \"smoothing.fim\" = 1 }}\n{drive}"),
            &["suite.toml:2:", "`tolerances`: there is no metric `smoothing.fim`, ", "did you mean `smoothing.firm`?"],
        ),
        (&format!("{drive}settings.planner.cruise_sped = 1.0"), &["line 3", "did you mean `cruise_speed`?"]),
        (&format!("{drive}[drive.settings.run]\nlongest = true"), &["line 4"]),
        (&format!("{drive}settings.run.longest = -1.0"), &["suite.toml:1:", "`settings`", "run.longest"]),
        (
            &format!("{drive}matrix = {{ \"run.longst\" = [1.0] }}"),
            &["`matrix` run.longst=1.0", "did you mean `longest`?"],
        ),
        (&format!("{drive}matrix = {{ \"run.longest\" = [] }}"), &["`run.longest` has no values"]),
        (
            &format!("{drive}matrix = {{ \"run.longest\" = [1.0, -1.0] }}"),
            &["`matrix` run.longest=-1.0", "run.longest"],
        ),
        (&format!("{drive}config = \"none.toml\""), &["suite.toml:1:", "none.toml: cannot be read"]),
        (&format!("{drive}config = \"wrong.toml\""), &["wrong.toml", "line 3", "did you mean `cruise_speed`?"]),
        (&format!("{drive}config = \"range.toml\""), &["suite.toml:1:", "run.longest"]),
        (&format!("{drive}{drive}"), &["suite.toml:3:", "`a.xml@bmw_320i` exists already, from line 1", "`name`"]),
        (&format!("{drive}seeds = [1, 1]"), &["`a.xml@bmw_320i,seed=1` exists already"]),
    ];
    for (text, words) in cases {
        let message = place.error(text);
        assert!(message.contains("suite.toml") || message.contains("wrong.toml"), "lacks the file: {message}");
        for word in *words {
            assert!(message.contains(word), "lacks \"{word}\": {message}\n{text}");
        }
    }
    let missing = Suite::load(place.path("none.toml")).unwrap_err().to_string();
    assert!(missing.contains("none.toml: cannot be read"), "{missing}");
    std::fs::write(place.path("suite.toml"), b"name = \"\xe9\"").unwrap();
    assert!(
        Suite::load(place.0.path()).unwrap_err().to_string().contains("not UTF-8"),
        "a folder stands for its suite.toml"
    );
}

#[test]
fn drives_are_ordered_and_have_unique_ids() {
    let place = Place::new();
    std::fs::create_dir(place.path("sub")).unwrap();
    std::fs::copy(ROAD, place.path("sub/c.xml")).unwrap();
    let text = "[[drive]]\nscenarios = [\"b.xml\", \"**/*.xml\"]\nexclude = \"sub/*\"\nvehicle = [\"truck\", \"bmw_320i\"]\n\
                [[drive]]\nname = \"wet\"\nscenarios = \"sub/c.xml\"\nproblem = 1\nseeds = [7, 3]\n\
                matrix = { \"simulation.friction_scale\" = [1.0, 0.6], \"planner.uncertainty.mode\" = [\"off\"] }\n";
    let ids = ["a.xml@truck", "a.xml@bmw_320i", "b.xml@truck", "b.xml@bmw_320i"].map(String::from).into_iter();
    let wet = ["1.0,seed=7", "1.0,seed=3", "0.6,seed=7", "0.6,seed=3"]
        .map(|t| format!("wet:sub/c.xml#1@bmw_320i,planner.uncertainty.mode=off,simulation.friction_scale={t}"));
    assert_eq!(place.suite(text).ids().collect::<Vec<_>>(), ids.chain(wet).collect::<Vec<_>>());
}

#[test]
fn settings_are_merged_by_priority() {
    let place = Place::new();
    place.write("c.toml", "[run]\nlongest = 2.0\nstandstill_time = 3.0\n[planner]\njerk = 2.0\ncruise_speed = 5.0\n");
    let suite = place.suite(
        "[defaults]\nconfig = \"c.toml\"\nsettings = { run.standstill_time = 4.0, planner.jerk = 3.0 }\n\
         [[drive]]\nscenarios = \"a.xml\"\nsettings.planner.jerk = 4.0\nmatrix = { \"planner.jerk\" = [5.0] }\n",
    );
    let settings = &suite.cases[0].settings;
    let values =
        [settings.run.longest, settings.run.standstill_time, settings.planner.jerk, settings.planner.cruise_speed];
    assert_eq!(values, [2.0, 4.0, 5.0, 5.0]);
    assert_eq!(settings.simulation, Default::default());
    // the TOML contains all settings, also infinite ones
    assert!(settings.planner.uncertainty.max_lateral_deviation.is_infinite());
    assert_eq!(toml::from_str::<crate::drive::Settings>(&suite.cases[0].config).unwrap(), **settings);
}

#[test]
fn reports_do_not_depend_on_jobs_or_resumption() {
    let place = Place::new();
    let text = format!(
        "[[drive]]\nscenarios = \"*.xml\"\nrepetitions = 2\nmatrix = {{ \"simulation.friction_scale\" = [1.0, 0.7] }}\n{SECOND}\
         [[drive]]\nname = \"fails\"\nscenarios = \"a.xml\"\nsettings.run.longest = 1.0\n"
    );
    let suite = place.suite(&text);
    let options = |jobs, resume: Option<&str>| Options {
        jobs: NonZeroUsize::new(jobs),
        resume: resume.map(|name| place.path(name)),
        pictures: 3,
        ..Options::default()
    };
    let one = all_reports(&suite.run(&options(1, None)).unwrap());
    assert_eq!(all_reports(&suite.run(&options(7, Some("state"))).unwrap()), one);
    assert_eq!(all_reports(&suite.run(&options(2, Some("state"))).unwrap()), one, "all results from the state file");
    assert!(one[3].contains("data:image/svg+xml"), "a picture of the failed drive");
    assert!(!one[3].contains("=\"http") && !one[3].contains("url(http"), "no network");
}

#[test]
fn resumes_from_the_last_complete_line() {
    let place = Place::new();
    let text = format!(
        "[[drive]]\nscenarios = \"a.xml\"\nseeds = [0, 1]\nvehicle = [\"bmw_320i\", \"ford_escort\"]\n{SECOND}"
    );
    let suite = place.suite(&text);
    let state = place.path("state");
    let options = Options { resume: Some(state.clone()), jobs: NonZeroUsize::new(1), ..Options::default() };
    let whole = all_reports(&suite.run(&options).unwrap());
    let bytes = std::fs::read(&state).unwrap();
    let ends: Vec<usize> = bytes.iter().enumerate().filter(|(_, b)| **b == b'\n').map(|(i, _)| i + 1).collect();
    assert_eq!(ends.len(), 5, "a header and four drives");
    for cut in [0, 5, ends[0] - 1, ends[0], ends[2] + 7, ends[3] - 1, ends[4] - 1] {
        std::fs::write(&state, &bytes[..cut]).unwrap();
        let lines_before = bytes[..cut].iter().filter(|b| **b == b'\n').count().max(1);
        assert_eq!(all_reports(&suite.run(&options).unwrap()), whole, "cut at {cut}");
        let again = std::fs::read(&state).unwrap();
        assert_eq!(again.len(), bytes.len(), "cut at {cut}: every drive once, {lines_before} lines remain");
        assert!(
            cut < ends[0] || again.starts_with(&bytes[..ends[lines_before - 1]]),
            "cut at {cut}: complete lines stay"
        );
    }
    // another text of the same length as a cut header
    std::fs::write(&state, "something else").unwrap();
    assert!(suite.run(&options).unwrap_err().to_string().contains("not a state file of `stopline check`"));
    // an invalid line in the middle
    let mut broken = bytes.clone();
    broken[ends[1] + 3] = b'}';
    std::fs::write(&state, &broken).unwrap();
    let message = suite.run(&options).unwrap_err().to_string();
    assert!(message.contains("state: line 3"), "{message}");
    assert_eq!(std::fs::read(&state).unwrap(), broken, "the file is unchanged");
    // another kind of file
    std::fs::copy(ROAD, &state).unwrap();
    assert!(suite.run(&options).unwrap_err().to_string().contains("not a state file of `stopline check`"));
    assert_eq!(std::fs::read(&state).unwrap(), std::fs::read(ROAD).unwrap());
    // the state of another build
    let head = String::from_utf8(bytes[..ends[0]].to_vec()).unwrap();
    let other = head.replacen("\"program\":\"", "\"program\":\"other ", 1);
    std::fs::write(&state, [other.as_bytes(), &bytes[ends[0]..]].concat()).unwrap();
    assert_eq!(all_reports(&suite.run(&options).unwrap()), whole);
    assert_eq!(std::fs::read(&state).unwrap().len(), bytes.len());
}

#[test]
fn the_key_of_a_drive_depends_on_every_input() {
    let place = Place::new();
    let text = |longest: &str, seed: u32| {
        format!("[[drive]]\nscenarios = \"a.xml\"\nseeds = [{seed}]\n{}", SECOND.replace("1.0", longest))
    };
    let keys = |text: &str| {
        let case = &place.suite(text).cases[0];
        super::run::key(case, &case.config).unwrap()
    };
    let base = keys(&text("1.0", 0));
    assert_eq!(base, keys(&text("1.0", 0)));
    assert_eq!(base, keys(&text("1.0", 0).replace("timed_out", "collision")), "an expectation is not an input");
    let others = [
        keys(&text("1.5", 0)),
        keys(&text("1.0", 1)),
        keys(&format!("{}vehicle = \"truck\"", text("1.0", 0))),
        keys(&format!("{}repetitions = 2", text("1.0", 0))),
        keys(&format!("{}problem = 1", text("1.0", 0))),
    ];
    assert!(others.iter().all(|key| *key != base), "{others:?}");
    let road = std::fs::read_to_string(place.path("a.xml")).unwrap();
    place.write("a.xml", &format!("{road}\n"));
    assert_ne!(keys(&text("1.0", 0)), base, "one byte of the scenario changed");
}

#[test]
fn a_state_file_in_use_is_refused() {
    let place = Place::new();
    let path = place.path("state");
    let first = super::state::State::open(&path).unwrap();
    let message = super::state::State::open(&path).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(message.contains("in use by another run"), "{message}");
    drop(first);
    assert!(super::state::State::open(&path).is_ok());
    let message = super::state::State::open(place.0.path()).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(message.contains("not a regular file"), "{message}");
}

/// A suite may name every metric that a drive has, and no other.
#[test]
fn the_names_of_all_metrics_are_known_without_a_drive() {
    let place = Place::new();
    let summary = place
        .run(&format!("[[drive]]\nscenarios = \"a.xml\"\nsettings.planner.uncertainty.mode = \"preferred\"\n{SECOND}"));
    let result = &summary.drives[0].measured.as_ref().unwrap().result;
    let mut names: Vec<String> = super::compare::metrics(result).into_keys().collect();
    names.extend(crate::verdict::CHECKS.map(str::to_owned));
    names.sort();
    names.dedup();
    assert_eq!(super::names::METRICS.iter().cloned().collect::<Vec<_>>(), names);
}

/// Shards beyond the number of drives are empty, and say so.
#[test]
fn an_empty_shard_says_so() {
    let place = Place::new();
    let suite = place.suite(&format!("[[drive]]\nscenarios = \"a.xml\"\nseeds = [0, 1]\n{SECOND}"));
    let shard = |index| suite.run(&Options { shard: Shard::new(index, 9), ..Options::default() }).unwrap();
    let empty = shard(9);
    assert!(empty.is_success() && empty.drives.is_empty());
    let warning = "shard 9/9 has no drives: the suite has 2, in the shards 1/9 to 2/9";
    assert_eq!(empty.empty_shard().as_deref(), Some(warning));
    assert!(empty.to_string().contains(warning), "{empty}");
    assert_eq!(shard(2).empty_shard(), None);
}

#[test]
fn shards_partition_the_suite() {
    let place = Place::new();
    let suite = place.suite(&format!("[[drive]]\nscenarios = \"*.xml\"\nseeds = [0, 1, 2]\n{SECOND}"));
    let mut seen: Vec<String> = Vec::new();
    for index in 1..=4 {
        let options = Options { shard: Shard::new(index, 4), ..Options::default() };
        let summary = suite.run(&options).unwrap();
        assert!((1..=2).contains(&summary.drives.len()));
        seen.extend(summary.drives.into_iter().map(|d| d.id));
    }
    let mut all: Vec<String> = suite.ids().map(str::to_owned).collect();
    seen.sort();
    all.sort();
    assert_eq!(seen, all);
    for wrong in ["0/3", "4/3", "1/0", "1", "/", "a/b", "-1/3", "1/3/5", ""] {
        assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
    }
    assert_eq!("2/3".parse::<Shard>().unwrap().to_string(), "2/3");
}

#[test]
fn unmet_expectations_are_failures() {
    let place = Place::new();
    let entry = |name: &str, expectations: &str| {
        format!("[[drive]]\nname = \"{name}\"\nscenarios = \"a.xml\"\nsettings.run.longest = 1.0\n{expectations}\n")
    };
    let text = [
        entry("right", "expect = [\"goal_reached\", \"timed_out\"]\nchecks = [\"no_contact\"]"),
        entry("outcome", "checks = []"),
        entry("other", "expect = \"collision\"\nchecks = []"),
        entry("goal", "expect = \"timed_out\""),
        entry(
            "limit",
            "expect = \"timed_out\"\nchecks = []\nlimits = { mean_speed_mps = 3.0, max_abs_jerk_mps3 = 9.0 }",
        ),
        entry("low", "expect = \"timed_out\"\nchecks = []\nlimits.distance_m = { min = 50, max = 60 }"),
        entry("absent", "expect = \"timed_out\"\nchecks = []\nlimits = { robust_cycles = 1.0 }"),
        entry("null", "expect = \"timed_out\"\nchecks = []\nlimits = { stop_error_m = { min = 5 } }"),
        entry("known", "expected_failure = \"too short\""),
        entry(
            "masked",
            "expect = \"timed_out\"\nchecks = []\nexpected_failure = \"a bit slow\"\nlimits = { robust_cycles = 1.0 }",
        ),
        entry("improved", "expect = \"timed_out\"\nchecks = []\nexpected_failure = \"was too short\""),
    ];
    let summary = place.run(&text.concat());
    let results: Vec<(&str, &str, String)> = (summary.drives.iter())
        .map(|d| {
            let kinds: Vec<_> = d.failures.iter().map(|f| f.kind.name()).collect();
            (d.id.split(':').next().unwrap(), d.status.name(), kinds.join(" "))
        })
        .collect();
    let expected = [
        ("right", "pass", ""),
        ("outcome", "fail", "outcome"),
        ("other", "fail", "outcome"),
        ("goal", "fail", "check"),
        ("limit", "fail", "limit"),
        ("low", "fail", "limit"),
        ("absent", "fail", "unknown_name"),
        ("null", "pass", ""),
        ("known", "expected_failure", "outcome check"),
        // an expected failure does not cover a metric that the drive does not have
        ("masked", "fail", "unknown_name unexpected_pass"),
        ("improved", "unexpected_pass", "unexpected_pass"),
    ];
    let results: Vec<(&str, &str, &str)> = results.iter().map(|(a, b, c)| (*a, *b, c.as_str())).collect();
    assert_eq!(results, expected);
    let text = summary.to_string();
    for word in [
        "11 drives: 2 PASS, 7 FAIL, 1 expected failure, 1 unexpected PASS",
        "outcome: timed_out, expected goal_reached or stopped_safely",
        "outcome: timed_out, expected collision",
        "robust_cycles: this drive has no such metric",
        "limit at most 3",
        "limit at least 50",
        "expected to fail (was too short)",
    ] {
        assert!(text.contains(word), "lacks \"{word}\": {text}");
    }
    let failed = summary.into_result().unwrap_err();
    assert_eq!(format!("{failed:?}"), text, "a test that returns the error prints it with Debug");
}

#[test]
fn an_unreadable_scenario_is_an_error_of_its_drives() {
    let place = Place::new();
    place.write("a.xml", "<osm/>");
    let road = std::fs::read_to_string(ROAD).unwrap();
    let problem = &road[road.find("<planningProblem").unwrap()..road.find("</commonRoad>").unwrap()];
    place.write("c.xml", &road.replace(problem, &format!("{problem}{}", problem.replacen("id=\"", "id=\"9", 1))));
    let summary = place.run(&format!("[[drive]]\nscenarios = \"*.xml\"\n{SECOND}"));
    assert_eq!(
        summary.drives.iter().map(|d| d.status).collect::<Vec<_>>(),
        [Status::Error, Status::Pass, Status::Error]
    );
    let message = summary.to_string();
    for word in ["input error:", "a.xml", "<osm>", "c.xml: has several planning problems"] {
        assert!(message.contains(word), "{message}");
    }
    assert!(summary.clone().into_result().is_err());
    let xml = junit(&[summary]).unwrap();
    let document = roxmltree::Document::parse(&xml).unwrap();
    let counts = |name: &str| document.root_element().attribute(name).unwrap().to_owned();
    assert_eq!((counts("tests"), counts("failures"), counts("errors")), ("3".into(), "0".into(), "2".into()));
}

#[test]
fn stores_and_compares_a_baseline() {
    let place = Place::new();
    let text = |tolerances: &str| {
        format!(
            "baseline = \"baseline.json\"\n[[drive]]\nscenarios = \"*.xml\"\n{SECOND}tolerances = {{ {tolerances} }}\n"
        )
    };
    let tight = text("distance_m = 0.01, duration_s = { relative = 0.1 }, stop_error_m = 1.0");
    let file = place.path("baseline.json");
    let message = place.suite(&tight).run(&Options::default()).unwrap_err().to_string();
    assert!(message.contains("baseline.json") && message.contains("--update-baseline"), "{message}");

    let update = Options { update_baseline: true, ..Options::default() };
    assert!(place.suite(&tight).run(&update).unwrap().is_success());
    let first = std::fs::read_to_string(&file).unwrap();
    assert!(first.ends_with("}\n") && first.contains("\"stop_error_m\": null"), "{first}");
    assert!(place.run(&tight).is_success());
    place.suite(&tight).run(&update).unwrap();
    assert_eq!(std::fs::read_to_string(&file).unwrap(), first, "canonical");

    // a changed metric, above and below; within a larger tolerance it passes
    let read: serde_json::Value = serde_json::from_str(&first).unwrap();
    let was = read["drives"]["a.xml@bmw_320i"]["metrics"]["distance_m"].as_f64().unwrap();
    for change in [0.02, -0.02] {
        let mut changed = read.clone();
        changed["drives"]["a.xml@bmw_320i"]["metrics"]["distance_m"] = (was + change).into();
        place.write("baseline.json", &changed.to_string());
        let summary = place.run(&tight);
        assert_eq!(summary.drives.iter().map(|d| d.status).collect::<Vec<_>>(), [Status::Fail, Status::Pass]);
        assert!(summary.to_string().contains("baseline: distance_m"), "{summary}");
        assert!(place.run(&tight.replace("0.01", "0.03")).is_success());
    }
    // a changed outcome, a value that was null, a drive that is not in the baseline or not in the suite
    let mut changed = read.clone();
    changed["drives"]["a.xml@bmw_320i"]["outcome"] = "goal_reached".into();
    changed["drives"]["a.xml@bmw_320i"]["metrics"]["stop_error_m"] = 0.5.into();
    let gone = changed["drives"].as_object_mut().unwrap().remove("b.xml@bmw_320i").unwrap();
    changed["drives"]["gone.xml@bmw_320i"] = gone;
    place.write("baseline.json", &changed.to_string());
    let message = place.run(&tight).to_string();
    for word in [
        "outcome timed_out, baseline goal_reached",
        "stop_error_m: none, baseline 0.5",
        "the drive is not in the baseline",
        "in the baseline, but not in the suite: gone.xml@bmw_320i",
    ] {
        assert!(message.contains(word), "lacks \"{word}\": {message}");
    }
    // a shard updates only its own drives
    let part = Options { shard: Shard::new(2, 2), ..update.clone() };
    place.suite(&tight).run(&part).unwrap();
    let read = std::fs::read_to_string(&file).unwrap();
    assert!(!read.contains("gone.xml") && read.contains("b.xml@") && read.contains("\"stop_error_m\": 0.5"), "{read}");
    place.suite(&tight).run(&update).unwrap();
    assert_eq!(std::fs::read_to_string(&file).unwrap(), first);

    // a corrupt baseline is an error and stays as it is, also when it should be updated
    for (corrupt, word) in [
        (&first[..first.len() / 2], "not a baseline"),
        ("", "not a baseline"),
        ("{\"format\": \"stopline.baseline/2\", \"drives\": {}, \"x\": 1}", "unknown field `x`"),
        ("{\"format\": \"stopline.baseline/9\", \"drives\": {}}", "stopline.baseline/9"),
        (
            "{\"format\": \"stopline.baseline/1\", \"drives\": {\"a\": {\"outcome\": \"x\", \"figures\": {}}}}",
            "expected `stopline.baseline/2`: remove the file",
        ),
        ("{\"format\": \"stopline.baseline/2\", \"drives\": {\"a\": {\"outcome\": 1, \"metrics\": {}}}}", "line 1"),
    ] {
        place.write("baseline.json", corrupt);
        for options in [&update, &Options::default()] {
            let message = place.suite(&tight).run(options).unwrap_err().to_string();
            assert!(message.contains("baseline.json") && message.contains(word), "{message}");
        }
        assert_eq!(std::fs::read_to_string(&file).unwrap(), corrupt);
    }
    let without = format!("[[drive]]\nscenarios = \"*.xml\"\n{SECOND}");
    assert!(place.suite(&without).run(&update).unwrap_err().to_string().contains("needs a `baseline`"));
}

#[test]
fn different_repetitions_are_a_failure() {
    let place = Place::new();
    let suite = place.suite(&format!("[[drive]]\nscenarios = \"a.xml\"\nrepetitions = 3\n{SECOND}"));
    let mut measured = suite.run(&Options::default()).unwrap().drives.remove(0).measured.unwrap();
    assert_eq!(measured.hashes.len(), 3);
    assert_eq!(super::compare::failures(&suite.cases[0], &measured, None), []);
    measured.hashes[2] = "0".repeat(64);
    let failures = super::compare::failures(&suite.cases[0], &measured, None);
    assert_eq!(failures.iter().map(|f| f.kind).collect::<Vec<_>>(), [FailureKind::Deterministic]);
    assert!(failures[0].message.starts_with("repetition 3 of 3"), "{}", failures[0].message);
}

/// A drive whose result has these checks.
fn measured_with(suite: &Suite, checks: serde_json::Value) -> super::run::Measured {
    let mut measured = suite.run(&Options::default()).unwrap().drives.remove(0).measured.unwrap();
    measured.result.insert("checks".into(), checks);
    measured
}

#[test]
fn a_required_check_has_to_apply() {
    let place = Place::new();
    let suite = |expectations: &str| {
        place.suite(&format!(
            "[[drive]]\nscenarios = \"a.xml\"\nsettings.run.longest = 1.0\nexpect = \"timed_out\"\n{expectations}\n"
        ))
    };
    let checks = serde_json::json!([
        { "name": "no_contact", "status": "pass", "value": 0.0, "limit": 0.01, "unit": "m", "at_time": null, "note": "" },
        { "name": "stops", "status": "not_applicable", "value": null, "limit": null, "unit": "m", "at_time": null,
          "note": "the vehicle did not stop" },
    ]);
    let all = suite("");
    let measured = measured_with(&all, checks);
    let failures = |suite: &Suite| -> Vec<(FailureKind, String)> {
        let failures = super::compare::failures(&suite.cases[0], &measured, None);
        failures.into_iter().map(|f| (f.kind, f.message)).collect()
    };
    assert_eq!(failures(&all), [], "all checks that apply pass");
    assert_eq!(failures(&suite("checks = [\"no_contact\"]")), []);
    let message = "stops: required, but N/A in this drive: the vehicle did not stop";
    assert_eq!(failures(&suite("checks = [\"stops\"]")), [(FailureKind::Check, message.into())]);
    assert_eq!(failures(&suite("limits = { stops = 0.3 }")), [(FailureKind::Limit, message.into())]);
    // a known check that the result does not list
    let message = "goal: required, but N/A in this drive";
    assert_eq!(failures(&suite("checks = [\"goal\"]")), [(FailureKind::Check, message.into())]);
    assert!(!super::compare::metrics(&measured.result).contains_key("stops"));
}

#[test]
fn a_failed_check_names_the_event_first() {
    let place = Place::new();
    let suite = place.suite("[[drive]]\nscenarios = \"a.xml\"\nsettings.run.longest = 1.0\nexpect = \"timed_out\"\n");
    let measured = measured_with(
        &suite,
        serde_json::json!([{ "name": "comfort_longitudinal", "status": "fail", "value": 3.9712345, "limit": 2.42,
            "unit": "m/s²", "at_time": 3.26, "note": "braked hard" }]),
    );
    let failures = super::compare::failures(&suite.cases[0], &measured, None);
    let message = "comfort_longitudinal: braked hard (3.97123 m/s² at 3.26 s, limit 2.42)";
    assert_eq!(failures.iter().map(|f| f.message.as_str()).collect::<Vec<_>>(), [message]);
}

#[test]
fn already_at_goal_has_to_be_expected() {
    let place = Place::new();
    let suite = |expect: &str| {
        place.suite(&format!("[[drive]]\nscenarios = \"a.xml\"\nsettings.run.longest = 1.0\nchecks = []\n{expect}\n"))
    };
    let mut measured = measured_with(&suite(""), serde_json::json!([]));
    measured.result.insert("outcome".into(), "already_at_goal".into());
    let messages = |suite: &Suite| -> Vec<String> {
        super::compare::failures(&suite.cases[0], &measured, None).into_iter().map(|f| f.message).collect()
    };
    assert_eq!(messages(&suite("")), ["already_at_goal, expected goal_reached or stopped_safely"]);
    assert_eq!(messages(&suite("expect = \"goal_reached\"")), ["already_at_goal, expected goal_reached"]);
    assert!(messages(&suite("expect = [\"goal_reached\", \"already_at_goal\"]")).is_empty());
}

#[test]
fn a_cancelled_run_reports_its_finished_drives() {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    let place = Place::new();
    let suite = place.suite(&format!(
        "baseline = \"baseline.json\"\n[[drive]]\nscenarios = \"*.xml\"\nseeds = [0, 1]\n{SECOND}tolerances.distance_m = 1\n"
    ));
    let cancel = Arc::new(AtomicBool::new(false));
    let options = Options {
        jobs: NonZeroUsize::new(1),
        update_baseline: true,
        cancel: Some(Arc::clone(&cancel)),
        ..Options::default()
    };
    let summary = suite.run_watched(&options, &|_| cancel.store(true, Ordering::Relaxed)).unwrap();
    assert_eq!((summary.drives.len(), summary.not_driven), (1, 3));
    assert!(summary.counts().ends_with("3 not driven") && !summary.is_success(), "{}", summary.counts());
    assert!(!place.path("baseline.json").exists(), "an incomplete run updates no baseline");
}

#[test]
fn reports_escape_text_of_files() {
    let place = Place::new();
    let name = "<b>&\"'`|_]]>.xml";
    std::fs::copy(ROAD, place.path(name)).unwrap();
    let quoted = name.replace('\\', "\\\\").replace('"', "\\\"");
    let summary = place.run(&format!(
        "name = \"<i>&\"\n[[drive]]\nscenarios = \"{quoted}\"\nsettings.run.longest = 1.0\nexpect = \"collision\"\n"
    ));
    let all = std::slice::from_ref(&summary);
    let page = closed(&html(all));
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let parsed = roxmltree::Document::parse_with_options(&page, options).unwrap_or_else(|e| panic!("{e}: {page}"));
    assert!(parsed.descendants().all(|n| !n.has_tag_name("b") && !n.has_tag_name("i") && !n.has_tag_name("script")));
    assert!(parsed.descendants().any(|n| n.has_tag_name("h3") && n.text().is_some_and(|t| t.contains(name))));
    let xml = junit(all).unwrap();
    let case = roxmltree::Document::parse(&xml).unwrap();
    let case = case.descendants().find(|n| n.has_tag_name("testcase")).unwrap();
    assert_eq!(case.attribute("name").unwrap(), format!("{name}@bmw_320i"));
    assert!(case.children().any(|n| n.has_tag_name("failure") && n.attribute("type") == Some("outcome")));
    let is_metric = |n: &roxmltree::Node| n.attribute("name") == Some("distance_m") && n.attribute("value").is_some();
    assert!(case.descendants().any(|n| is_metric(&n)), "{xml}");
    assert!(!markdown(all).contains(name) && markdown(all).contains("&lt;b&gt;&amp;"));
    let report: serde_json::Value = serde_json::from_str(&json(all)).unwrap();
    assert_eq!(report["suites"][0]["drives"][0]["scenario"], name);
}

/// The page as XML: void elements are closed.
fn closed(page: &str) -> String {
    let void = |tag: &str| ["<meta ", "<link ", "<img "].iter().any(|start| tag.starts_with(start));
    page.split_inclusive('>')
        .map(|piece| {
            let tag = piece.find('<').map_or("", |at| &piece[at..]);
            if void(tag) { piece.replacen('>', "/>", 1) } else { piece.to_owned() }
        })
        .collect()
}

/// The page has its content in a browser and logs no error.
#[test]
fn a_browser_shows_the_page_without_errors() {
    let Some(browser) = browser() else {
        eprintln!("skipped: no Chromium (set CHROMIUM to its program)");
        return;
    };
    let place = Place::new();
    let suite = place.suite("[[drive]]\nscenarios = \"*.xml\"\nsettings.run.longest = 1.0\n");
    let page = place.write("page.html", &html(&[suite.run(&Options { pictures: 1, ..Options::default() }).unwrap()]));
    let output = std::process::Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--dump-dom"])
        .arg(format!("--user-data-dir={}", place.path("profile").display()))
        .arg(format!("file://{}", page.display()))
        .output()
        .unwrap();
    let (dom, log) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(dom.contains("a.xml@bmw_320i") && dom.contains("<img alt=") && dom.contains("</table>"), "{dom}\n{log}");
    assert!(!log.contains("CONSOLE"), "{log}");
}

/// An installed Chromium.
fn browser() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("CHROMIUM") {
        return Some(named.into());
    }
    let names = ["chromium", "chromium-browser", "google-chrome", "chrome", "headless_shell"];
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).flat_map(|folder| names.map(|name| folder.join(name))).find(|p| p.is_file())
}

#[test]
fn a_replay_reproduces_the_reported_hash() {
    let place = Place::new();
    let text = format!("[[drive]]\nscenarios = \"a.xml\"\nseeds = [4]\n{SECOND}");
    let suite = place.suite(&text);
    let summary = suite.run(&Options::default()).unwrap();
    let hash = summary.drives[0].hash().unwrap().to_owned();
    let report = place.write("report.json", &json(&[summary]));
    // the suite changed after the report
    let suite = place.suite(&text.replace("1.0", "1.5"));
    let replayed = |replay: &Replay| replay.drive(|_, result| result.hash).unwrap();
    let replay = suite.replay("a.xml@bmw_320i").unwrap();
    assert_eq!((replay.reported_hash(), replay.has_reported_inputs().unwrap()), (None, true));
    assert_ne!(replayed(&replay), hash);
    let replay = replay.as_reported(&report).unwrap();
    assert_eq!((replay.reported_hash(), replay.has_reported_inputs().unwrap()), (Some(hash.as_str()), true));
    assert_eq!(replayed(&replay), hash);
    assert!(replay.command(Path::new("my settings.toml")).ends_with("--config 'my settings.toml' --seed 4"));
    // the scenario changed after the report
    let road = std::fs::read_to_string(place.path("a.xml")).unwrap();
    place.write("a.xml", &format!("{road}\n"));
    assert!(!replay.has_reported_inputs().unwrap());

    let message = suite.replay("b.xml@bmw_320i").unwrap_err().to_string();
    assert!(message.contains("did you mean `a.xml@bmw_320i`?"), "{message}");
    let message = suite.replay("a.xml").unwrap_err().to_string();
    assert!(message.contains("did you mean `a.xml@bmw_320i`?"), "the id contains the text: {message}");
    assert_eq!(suite.replay("something_else").unwrap_err().to_string(), "no drive `something_else`");
    for (text, word) in [("{}", "not a report"), ("{", "EOF"), ("{\"format\": \"stopline.check/2\"}", "has no drive")] {
        let file = place.write("broken.json", text);
        let message = suite.replay("a.xml@bmw_320i").unwrap().as_reported(&file).unwrap_err().to_string();
        assert!(message.contains("broken.json") && message.contains(word), "{message}");
    }
}

#[test]
fn a_panic_is_a_fault_of_the_program() {
    let place = Place::new();
    let suite = place.suite(&format!("[[drive]]\nscenarios = \"a.xml\"\n{SECOND}"));
    let case = &suite.cases[0];
    let error = case.with_run(&case.settings, |_, _| -> () { panic!("a test panic") }).unwrap_err();
    assert_eq!(error.kind, ErrorKind::Fault);
    assert!(error.message.contains("a test panic"), "{error}");
}

/// The program reads every suite in `docs/suites.md`.
#[test]
fn suites_in_the_docs_are_valid() {
    let docs = include_str!("../../docs/suites.md");
    let suites: Vec<&str> = docs.split("```toml\n").skip(1).filter_map(|block| block.split("```").next()).collect();
    assert!(suites.len() >= 2, "the docs show no suites");
    for text in suites {
        let read = crate::io::settings_file::parse::<super::suite::SuiteFile<crate::drive::Settings>>;
        assert!(read(Path::new("docs/suites.md"), text).is_ok(), "{:?}\n{text}", read(Path::new("x"), text).err());
    }
    for key in [
        "`scenarios`",
        "`exclude`",
        "`problem`",
        "`vehicle`",
        "`config`",
        "`settings`",
        "`matrix`",
        "`seeds`",
        "`repetitions`",
        "`expect`",
        "`checks`",
        "`expected_failure`",
        "`limits`",
        "`tolerances`",
        "`baseline`",
    ] {
        assert!(docs.contains(&format!("| {key} |")), "the docs lack {key}");
    }
}
