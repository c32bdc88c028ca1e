//! Suites as a user of the library meets them: small folders with a road, drives of a second.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use super::report::{html, json, junit, markdown};
use super::*;

const ROAD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/maps/straight_100m.xml");

/// A drive of one second that is right: it drives on when its time is over.
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

    /// What is said of a suite that is refused.
    fn complaint(&self, text: &str) -> String {
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
fn one_wrong_thing_in_a_suite_is_named_with_its_line() {
    let place = Place::new();
    place.write("wrong.toml", "[planner]\n\ncruise_sped = 3.0\n");
    place.write("range.toml", "[run]\nlongest = -1.0\n");
    let drive = "[[drive]]\nscenarios = \"a.xml\"\n";
    let cases: &[(&str, &[&str])] = &[
        ("", &["missing field `drive`"]),
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
        (&format!("{drive}expected_fail = true"), &["line 3", "expected a string"]),
        (&format!("{drive}problem = \"1\""), &["line 3"]),
        (&format!("{drive}repetitions = 0"), &["line 3", "0 repetitions, expected 1 to 1000"]),
        (&format!("{drive}seeds = []"), &["`seeds` is empty"]),
        (&format!("{drive}seeds = [-1]"), &["line 3"]),
        (&format!("{drive}limits = {{ tracking = \"0.2\" }}"), &["line 3", "a number (the most)"]),
        (&format!("{drive}limits = {{ tracking = nan }}"), &["line 3", "nan"]),
        (&format!("{drive}limits = {{ tracking = {{ mn = 1 }} }}"), &["line 3", "`mn`", "did you mean `min`?"]),
        (&format!("{drive}limits = {{ tracking = {{}} }}"), &["line 3", "empty table"]),
        (&format!("{drive}limits = {{ tracking = {{ min = 2, max = 1 }} }}"), &["`min` 2 is above `max` 1"]),
        (&format!("{drive}tolerances = {{ tracking = -1 }}"), &["line 3", "below zero"]),
        (&format!("{drive}tolerances = {{ tracking = 1 }}"), &["a.xml@bmw_320i", "no `baseline`"]),
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
        (&format!("{drive}{drive}"), &["suite.toml:3:", "`a.xml@bmw_320i` is there already, from line 1", "`name`"]),
        (&format!("{drive}seeds = [1, 1]"), &["`a.xml@bmw_320i,seed=1` is there already"]),
    ];
    for (text, words) in cases {
        let said = place.complaint(text);
        assert!(said.contains("suite.toml") || said.contains("wrong.toml"), "names no file: {said}");
        for word in *words {
            assert!(said.contains(word), "does not say \"{word}\": {said}\n{text}");
        }
    }
    let missing = Suite::load(place.path("none.toml")).unwrap_err().to_string();
    assert!(missing.contains("none.toml: cannot be read"), "{missing}");
    std::fs::write(place.path("suite.toml"), b"name = \"\xe9\"").unwrap();
    assert!(Suite::load(place.0.path()).unwrap_err().to_string().contains("not UTF-8"), "a folder is its suite.toml");
}

#[test]
fn drives_come_in_order_under_ids_that_tell_them_apart() {
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
fn settings_are_laid_over_each_other_from_the_farthest_to_the_nearest() {
    let place = Place::new();
    place.write("c.toml", "[run]\nlongest = 2.0\nrest = 3.0\n[planner]\njerk = 2.0\ncruise_speed = 5.0\n");
    let suite = place.suite(
        "[defaults]\nconfig = \"c.toml\"\nsettings = { run.standstill_time = 4.0, planner.jerk = 3.0 }\n\
         [[drive]]\nscenarios = \"a.xml\"\nsettings.planner.jerk = 4.0\nmatrix = { \"planner.jerk\" = [5.0] }\n",
    );
    let settings = &suite.cases[0].settings;
    let found =
        [settings.run.longest, settings.run.standstill_time, settings.planner.jerk, settings.planner.cruise_speed];
    assert_eq!(found, [2.0, 4.0, 5.0, 5.0]);
    assert_eq!(settings.simulation, Default::default());
    // what is told of them is all of them, infinities too
    assert!(settings.planner.uncertainty.max_lateral_deviation.is_infinite());
    assert_eq!(toml::from_str::<crate::drive::Settings>(&suite.cases[0].config).unwrap(), **settings);
}

#[test]
fn reports_have_the_same_bytes_for_every_number_of_jobs_and_for_resumed_runs() {
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
    assert_eq!(all_reports(&suite.run(&options(2, Some("state"))).unwrap()), one, "from the state alone");
    assert!(one[3].contains("data:image/svg+xml"), "a failed drive has its picture");
    assert!(!one[3].contains("=\"http") && !one[3].contains("url(http"), "fetches nothing");
}

#[test]
fn an_interrupted_run_goes_on_from_its_last_whole_line() {
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
    assert_eq!(ends.len(), 5, "a head and four drives");
    for cut in [0, 5, ends[0] - 1, ends[0], ends[2] + 7, ends[3] - 1, ends[4] - 1] {
        std::fs::write(&state, &bytes[..cut]).unwrap();
        let lines_before = bytes[..cut].iter().filter(|b| **b == b'\n').count().max(1);
        assert_eq!(all_reports(&suite.run(&options).unwrap()), whole, "cut at {cut}");
        let again = std::fs::read(&state).unwrap();
        assert_eq!(again.len(), bytes.len(), "cut at {cut}: every drive once, {lines_before} lines kept");
        assert!(cut < ends[0] || again.starts_with(&bytes[..ends[lines_before - 1]]), "cut at {cut}: kept lines stay");
    }
    // a head that is cut off is not told from a new file by its length alone
    std::fs::write(&state, "something else").unwrap();
    assert!(suite.run(&options).unwrap_err().to_string().contains("not a state of `stopline check`"));
    // a line in the middle that makes no sense is not guessed at
    let mut broken = bytes.clone();
    broken[ends[1] + 3] = b'}';
    std::fs::write(&state, &broken).unwrap();
    let said = suite.run(&options).unwrap_err().to_string();
    assert!(said.contains("state: line 3"), "{said}");
    assert_eq!(std::fs::read(&state).unwrap(), broken, "and is left as it is");
    // neither is another file taken for one
    std::fs::copy(ROAD, &state).unwrap();
    assert!(suite.run(&options).unwrap_err().to_string().contains("not a state of `stopline check`"));
    assert_eq!(std::fs::read(&state).unwrap(), std::fs::read(ROAD).unwrap());
    // another build begins anew
    let head = String::from_utf8(bytes[..ends[0]].to_vec()).unwrap();
    let other = head.replacen("\"program\":\"", "\"program\":\"other ", 1);
    std::fs::write(&state, [other.as_bytes(), &bytes[ends[0]..]].concat()).unwrap();
    assert_eq!(all_reports(&suite.run(&options).unwrap()), whole);
    assert_eq!(std::fs::read(&state).unwrap().len(), bytes.len());
}

#[test]
fn a_state_knows_when_an_input_has_changed() {
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
    assert_eq!(base, keys(&text("1.0", 0).replace("timed_out", "collision")), "an expectation is no input");
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
    assert_ne!(keys(&text("1.0", 0)), base, "a byte of the scenario");
}

#[test]
fn a_state_in_use_is_not_shared() {
    let place = Place::new();
    let path = place.path("state");
    let first = super::state::State::open(&path).unwrap();
    let said = super::state::State::open(&path).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(said.contains("in use by another run"), "{said}");
    drop(first);
    assert!(super::state::State::open(&path).is_ok());
    let said = super::state::State::open(place.0.path()).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(said.contains("not a regular file"), "{said}");
}

#[test]
fn shards_part_the_suite() {
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
fn outcomes_checks_and_limits_that_are_not_as_expected_are_failures() {
    let place = Place::new();
    let entry = |name: &str, rest: &str| {
        format!("[[drive]]\nname = \"{name}\"\nscenarios = \"a.xml\"\nsettings.run.longest = 1.0\n{rest}\n")
    };
    let text = [
        entry("right", "expect = [\"goal_reached\", \"timed_out\"]\nchecks = [\"no_contact\"]"),
        entry("outcome", "checks = []"),
        entry("other", "expect = \"collision\"\nchecks = []"),
        entry("goal", "expect = \"timed_out\""),
        entry("check", "expect = \"timed_out\"\nchecks = [\"no_contcat\"]"),
        entry(
            "limit",
            "expect = \"timed_out\"\nchecks = []\nlimits = { mean_speed_mps = 3.0, max_abs_jerk_mps3 = 9.0 }",
        ),
        entry("low", "expect = \"timed_out\"\nchecks = []\nlimits.distance_m = { min = 50, max = 60 }"),
        entry("typo", "expect = \"timed_out\"\nchecks = []\nlimits = { distanc_m = 1.0 }"),
        entry("null", "expect = \"timed_out\"\nchecks = []\nlimits = { stop_error_m = { min = 5 } }"),
        entry("known", "expected_fail = \"too short\""),
        entry(
            "masked",
            "expect = \"timed_out\"\nchecks = []\nexpected_fail = \"a bit slow\"\nlimits = { distanc_m = 1.0 }",
        ),
        entry("better", "expect = \"timed_out\"\nchecks = []\nexpected_fail = \"was too short\""),
    ];
    let summary = place.run(&text.concat());
    let told: Vec<(&str, &str, String)> = (summary.drives.iter())
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
        ("check", "fail", "unknown_name"),
        ("limit", "fail", "limit"),
        ("low", "fail", "limit"),
        ("typo", "fail", "unknown_name"),
        ("null", "pass", ""),
        ("known", "expected_fail", "outcome check"),
        // a misspelt name is no failure that anybody expects
        ("masked", "fail", "unknown_name unexpected_pass"),
        ("better", "unexpected_pass", "unexpected_pass"),
    ];
    let told: Vec<(&str, &str, &str)> = told.iter().map(|(a, b, c)| (*a, *b, c.as_str())).collect();
    assert_eq!(told, expected);
    let text = summary.to_string();
    for word in [
        "12 drives: 2 pass, 8 fail, 1 expected fail, 1 unexpected pass",
        "ended as timed_out, expected goal_reached or stopped_safely",
        "ended as timed_out, expected collision",
        "no_contcat: this drive has no such check; did you mean `no_contact`?",
        "distanc_m: this drive has no such figure; did you mean `distance_m`?",
        "limit at most 3",
        "limit at least 50",
        "expected to fail (was too short)",
    ] {
        assert!(text.contains(word), "does not say \"{word}\": {text}");
    }
    let failed = summary.into_result().unwrap_err();
    assert_eq!(format!("{failed:?}"), text, "what a test prints that returns it");
}

#[test]
fn a_scenario_that_cannot_be_read_is_an_error_and_the_others_are_driven() {
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
    let said = summary.to_string();
    for word in ["input error:", "a.xml", "<osm>", "c.xml: has several planning problems"] {
        assert!(said.contains(word), "{said}");
    }
    assert!(summary.clone().into_result().is_err());
    let xml = junit(&[summary]).unwrap();
    let document = roxmltree::Document::parse(&xml).unwrap();
    let counts = |name: &str| document.root_element().attribute(name).unwrap().to_owned();
    assert_eq!((counts("tests"), counts("failures"), counts("errors")), ("3".into(), "0".into(), "2".into()));
}

#[test]
fn a_baseline_is_kept_compared_and_not_lost() {
    let place = Place::new();
    let text = |tolerances: &str| {
        format!("baseline = \"kept.json\"\n[[drive]]\nscenarios = \"*.xml\"\n{SECOND}tolerances = {{ {tolerances} }}\n")
    };
    let tight = text("distance_m = 0.01, duration_s = { relative = 0.1 }, stop_error_m = 1.0");
    let kept = place.path("kept.json");
    let said = place.suite(&tight).run(&Options::default()).unwrap_err().to_string();
    assert!(said.contains("kept.json") && said.contains("--bless"), "{said}");

    let bless = Options { bless: true, ..Options::default() };
    assert!(place.suite(&tight).run(&bless).unwrap().is_success());
    let first = std::fs::read_to_string(&kept).unwrap();
    assert!(first.ends_with("}\n") && first.contains("\"stop_error_m\": null"), "{first}");
    assert!(place.run(&tight).is_success());
    place.suite(&tight).run(&bless).unwrap();
    assert_eq!(std::fs::read_to_string(&kept).unwrap(), first, "canonical");

    // a figure that has changed, on both sides; with more tolerance it has not
    let read: serde_json::Value = serde_json::from_str(&first).unwrap();
    let was = read["drives"]["a.xml@bmw_320i"]["figures"]["distance_m"].as_f64().unwrap();
    for change in [0.02, -0.02] {
        let mut changed = read.clone();
        changed["drives"]["a.xml@bmw_320i"]["figures"]["distance_m"] = (was + change).into();
        place.write("kept.json", &changed.to_string());
        let summary = place.run(&tight);
        assert_eq!(summary.drives.iter().map(|d| d.status).collect::<Vec<_>>(), [Status::Fail, Status::Pass]);
        assert!(summary.to_string().contains("baseline: distance_m"), "{summary}");
        assert!(place.run(&tight.replace("0.01", "0.03")).is_success());
    }
    // outcome, something where nothing was, drives that it does not have or that are gone
    let mut changed = read.clone();
    changed["drives"]["a.xml@bmw_320i"]["outcome"] = "goal_reached".into();
    changed["drives"]["a.xml@bmw_320i"]["figures"]["stop_error_m"] = 0.5.into();
    let gone = changed["drives"].as_object_mut().unwrap().remove("b.xml@bmw_320i").unwrap();
    changed["drives"]["gone.xml@bmw_320i"] = gone;
    place.write("kept.json", &changed.to_string());
    let said = place.run(&tight).to_string();
    for word in [
        "ended as timed_out, before as goal_reached",
        "stop_error_m: none, before 0.5",
        "it is not in the baseline",
        "in the baseline, but not in the suite: gone.xml@bmw_320i",
    ] {
        assert!(said.contains(word), "does not say \"{word}\": {said}");
    }
    // a part of the suite blesses its part
    let part = Options { shard: Shard::new(2, 2), ..bless.clone() };
    place.suite(&tight).run(&part).unwrap();
    let read = std::fs::read_to_string(&kept).unwrap();
    assert!(!read.contains("gone.xml") && read.contains("b.xml@") && read.contains("\"stop_error_m\": 0.5"), "{read}");
    place.suite(&tight).run(&bless).unwrap();
    assert_eq!(std::fs::read_to_string(&kept).unwrap(), first);

    // a corrupt one is an error, blessed or not, and stays
    for (corrupt, word) in [
        (&first[..first.len() / 2], "not a baseline"),
        ("", "not a baseline"),
        ("{\"format\": \"stopline.baseline/2\", \"drives\": {}, \"x\": 1}", "unknown field `x`"),
        ("{\"format\": \"stopline.baseline/9\", \"drives\": {}}", "stopline.baseline/9"),
        ("{\"format\": \"stopline.baseline/2\", \"drives\": {\"a\": {\"outcome\": 1, \"figures\": {}}}}", "line 1"),
    ] {
        place.write("kept.json", corrupt);
        for options in [&bless, &Options::default()] {
            let said = place.suite(&tight).run(options).unwrap_err().to_string();
            assert!(said.contains("kept.json") && said.contains(word), "{said}");
        }
        assert_eq!(std::fs::read_to_string(&kept).unwrap(), corrupt);
    }
    let without = format!("[[drive]]\nscenarios = \"*.xml\"\n{SECOND}");
    assert!(place.suite(&without).run(&bless).unwrap_err().to_string().contains("needs a `baseline`"));
}

#[test]
fn repetitions_that_differ_are_not_deterministic() {
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

#[test]
fn no_text_of_a_file_is_markup_in_a_report() {
    let place = Place::new();
    let name = "<b>&\"'`|_]]>.xml";
    std::fs::copy(ROAD, place.path(name)).unwrap();
    let quoted = name.replace('\\', "\\\\").replace('"', "\\\"");
    let summary = place.run(&format!(
        "name = \"<i>&\"\n[[drive]]\nscenarios = \"{quoted}\"\nsettings.run.longest = 1.0\nexpect = \"collision\"\n"
    ));
    let all = std::slice::from_ref(&summary);
    let page = html(all);
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let parsed = roxmltree::Document::parse_with_options(&page, options).unwrap_or_else(|e| panic!("{e}: {page}"));
    assert!(parsed.descendants().all(|n| !n.has_tag_name("b") && !n.has_tag_name("i") && !n.has_tag_name("script")));
    assert!(parsed.descendants().any(|n| n.has_tag_name("h3") && n.text().is_some_and(|t| t.contains(name))));
    let xml = junit(all).unwrap();
    let case = roxmltree::Document::parse(&xml).unwrap();
    let case = case.descendants().find(|n| n.has_tag_name("testcase")).unwrap();
    assert_eq!(case.attribute("name").unwrap(), format!("{name}@bmw_320i"));
    assert!(case.children().any(|n| n.has_tag_name("failure") && n.attribute("type") == Some("outcome")));
    let figure = |n: &roxmltree::Node| n.attribute("name") == Some("distance_m") && n.attribute("value").is_some();
    assert!(case.descendants().any(|n| figure(&n)), "{xml}");
    assert!(!markdown(all).contains(name) && markdown(all).contains("&lt;b&gt;&amp;"));
    let told: serde_json::Value = serde_json::from_str(&json(all)).unwrap();
    assert_eq!(told["suites"][0]["drives"][0]["scenario"], name);
}

/// A browser shows the page as it is meant, and has nothing to complain about.
#[test]
fn a_browser_shows_the_page_without_complaint() {
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
    let (dom, said) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(dom.contains("a.xml@bmw_320i") && dom.contains("<img alt=") && dom.contains("</table>"), "{dom}\n{said}");
    assert!(!said.contains("CONSOLE"), "{said}");
}

/// A Chromium, if there is one.
fn browser() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("CHROMIUM") {
        return Some(named.into());
    }
    let names = ["chromium", "chromium-browser", "google-chrome", "chrome", "headless_shell"];
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).flat_map(|folder| names.map(|name| folder.join(name))).find(|p| p.is_file())
}

#[test]
fn a_replay_takes_the_settings_of_the_report_and_comes_to_the_same() {
    let place = Place::new();
    let text = format!("[[drive]]\nscenarios = \"a.xml\"\nseeds = [4]\n{SECOND}");
    let suite = place.suite(&text);
    let summary = suite.run(&Options::default()).unwrap();
    let hash = summary.drives[0].hash().unwrap().to_owned();
    let report = place.write("report.json", &json(&[summary]));
    // the suite has changed since
    let suite = place.suite(&text.replace("1.0", "1.5"));
    let replayed = |replay: &Replay| replay.drive(|_, result| result.hash).unwrap();
    let replay = suite.replay("a.xml@bmw_320i").unwrap();
    assert_eq!((replay.reported_hash(), replay.has_reported_inputs().unwrap()), (None, true));
    assert_ne!(replayed(&replay), hash);
    let replay = replay.as_reported(&report).unwrap();
    assert_eq!((replay.reported_hash(), replay.has_reported_inputs().unwrap()), (Some(hash.as_str()), true));
    assert_eq!(replayed(&replay), hash);
    assert!(replay.command(Path::new("my settings.toml")).ends_with("--config 'my settings.toml' --seed 4"));
    // the scenario has changed since
    let road = std::fs::read_to_string(place.path("a.xml")).unwrap();
    place.write("a.xml", &format!("{road}\n"));
    assert!(!replay.has_reported_inputs().unwrap());

    let said = suite.replay("b.xml@bmw_320i").unwrap_err().to_string();
    assert!(said.contains("did you mean `a.xml@bmw_320i`?"), "{said}");
    for (text, word) in [("{}", "not a report"), ("{", "EOF"), ("{\"format\": \"stopline.check/2\"}", "has no drive")] {
        let file = place.write("broken.json", text);
        let said = suite.replay("a.xml@bmw_320i").unwrap().as_reported(&file).unwrap_err().to_string();
        assert!(said.contains("broken.json") && said.contains(word), "{said}");
    }
}

#[test]
fn a_panic_is_the_error_of_its_drive_and_a_fault_of_the_program() {
    let place = Place::new();
    let suite = place.suite(&format!("[[drive]]\nscenarios = \"a.xml\"\n{SECOND}"));
    let case = &suite.cases[0];
    let error = case.with_run(&case.settings, |_, _| -> () { panic!("a test of what a panic gives") }).unwrap_err();
    assert_eq!(error.kind, ErrorKind::Fault);
    assert!(error.message.contains("a test of what a panic gives"), "{error}");
}

/// What `docs/suites.md` shows is what the program reads.
#[test]
fn the_suites_of_the_docs_can_be_read() {
    let docs = include_str!("../../docs/suites.md");
    let suites: Vec<&str> = docs.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
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
        "`expected_fail`",
        "`limits`",
        "`tolerances`",
        "`baseline`",
    ] {
        assert!(docs.contains(&format!("| {key} |")), "the docs do not tell {key}");
    }
}
