//! The program as a user meets it: exit codes one by one, bad inputs one at a time, outputs.

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;

/// A road of 100 m, 50 km/h, and nothing on it.
const ROAD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/maps/straight_100m.xml");

/// A folder of its own, in which the program runs.
struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file and gives its name.
    fn file(&self, name: &str, text: impl AsRef<[u8]>) -> String {
        std::fs::write(self.path(name), text).unwrap();
        name.to_owned()
    }

    fn run(&self, arguments: &[&str]) -> Output {
        Command::cargo_bin("stopline").unwrap().current_dir(self.folder.path()).args(arguments).output().unwrap()
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(self.folder.path())
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// It ended with that code, said all the words on stderr, and nothing on stdout; nothing panicked.
fn complains(output: &Output, code: i32, words: &[&str]) {
    let said = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{said}");
    for word in words {
        assert!(said.contains(word), "does not say \"{word}\": {said}");
    }
    assert_eq!(stdout(output), "", "a complaint belongs on stderr");
    assert!(!said.contains("panicked"), "{said}");
}

/// The road with one text replaced, which must occur.
fn road_with(from: &str, to: &str) -> String {
    let road = std::fs::read_to_string(ROAD).unwrap();
    assert!(road.contains(from), "{ROAD} has no {from}");
    road.replacen(from, to, 1)
}

/// The text between two marks, both included.
fn part<'a>(text: &'a str, from: &str, to: &str) -> &'a str {
    let start = text.find(from).unwrap();
    let end = start + text[start..].find(to).unwrap() + to.len();
    &text[start..end]
}

#[test]
fn help_and_version_are_no_failures_and_tell_the_exit_codes() {
    let place = Place::new();
    for arguments in [["--help"].as_slice(), &["drive", "--help"], &["plan", "-h"]] {
        let output = place.run(arguments);
        assert_eq!(output.status.code(), Some(0));
        let text = stdout(&output);
        for line in ["Exit codes:", "0  ", "1  ", "2  ", "3  ", "4  "] {
            assert!(text.contains(line), "{arguments:?} does not tell {line}");
        }
    }
    let version = place.run(&["--version"]);
    assert_eq!(
        (version.status.code(), stdout(&version).trim()),
        (Some(0), concat!("stopline ", env!("CARGO_PKG_VERSION")))
    );
}

#[test]
fn exit_2_is_wrong_use() {
    let place = Place::new();
    complains(&place.run(&[]), 2, &["Usage"]);
    complains(&place.run(&["fly"]), 2, &["fly"]);
    complains(&place.run(&["drive"]), 2, &["SCENARIO"]);
    complains(&place.run(&["drive", ROAD, "--fast"]), 2, &["--fast"]);
    complains(&place.run(&["drive", ROAD, "--seed=-1"]), 2, &["--seed"]);
    complains(&place.run(&["drive", ROAD, "--inject", "rain=1"]), 2, &["--inject", "`rain` is no fault", "delay"]);
    complains(&place.run(&["drive", ROAD, "--inject", "mass=-1"]), 2, &["mass is -1", "from 0.1 to 10"]);
    complains(&place.run(&["plan", ROAD, "--inject", "mass=1.2"]), 2, &["--inject", "not driven"]);
    complains(&place.run(&["drive", ROAD, "--comfort", "iso"]), 2, &["--comfort", "iso15622"]);
    complains(&place.run(&["drive", ROAD, "--fallbacks", "often"]), 2, &["--fallbacks"]);
    complains(&place.run(&["drive", ROAD, "--fallbacks", "0"]), 2, &["verdict.fallbacks.interval"]);
    for threads in ["0", "many", "100000"] {
        complains(&place.run(&["drive", ROAD, "--threads", threads]), 2, &["--threads"]);
    }
    complains(&place.run(&["drive", ROAD, "--csv", "a", "--svg", "a"]), 2, &["a", "twice"]);
    complains(&place.run(&["plan", ROAD, "--csv", "a", "--svg", "./a"]), 2, &["./a", "twice"]);
    complains(&place.run(&["plan", ROAD, "--json", "-", "--csv", "-"]), 2, &["stdout"]);
    assert_eq!(place.names(), Vec::<String>::new());
}

#[test]
fn an_output_never_replaces_an_input() {
    let place = Place::new();
    let road = std::fs::read(ROAD).unwrap();
    let name = place.file("road.xml", &road);
    // what an input is read from is an input: a vehicle's files, a grid's image
    let vehicle = place.path("v");
    std::fs::create_dir(&vehicle).unwrap();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("vehicles/f1tenth");
    for file in ["vehicle.urdf", "dynamics.toml", "body.obj"] {
        std::fs::copy(folder.join(file), vehicle.join(file)).unwrap();
    }
    for file in ["v/dynamics.toml", "v/body.obj"] {
        complains(&place.run(&["plan", ROAD, "--vehicle", "v", "--json", file]), 2, &[file, "twice"]);
    }
    std::fs::write(place.path("g.pgm"), "P2 1 1 255 255").unwrap();
    let yaml = "image: g.pgm\nresolution: 1\norigin: [0, 900, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n";
    std::fs::write(place.path("g.yaml"), yaml).unwrap();
    complains(&place.run(&["plan", ROAD, "--grid", "g.yaml", "--json", "g.pgm"]), 2, &["g.pgm", "twice"]);
    complains(&place.run(&["plan", &name, "--json", "./road.xml"]), 2, &["twice"]);
    assert_eq!(std::fs::read(place.path("road.xml")).unwrap(), road);
}

#[cfg(not(feature = "rerun"))]
#[test]
fn a_recording_without_the_feature_is_wrong_use() {
    complains(&Place::new().run(&["plan", ROAD, "--rrd", "run.rrd"]), 2, &["--rrd", "rerun"]);
}

#[test]
fn exit_3_is_a_scenario_that_cannot_be_read() {
    let place = Place::new();
    let road = std::fs::read_to_string(ROAD).unwrap();
    let problem = part(&road, "<planningProblem", "</planningProblem>");
    let bad = [
        ("empty.xml", String::new(), "not XML"),
        ("text.xml", "once upon a time".into(), "not XML"),
        ("half.xml", road[..road.len() / 2].into(), "not XML"),
        ("osm.xml", "<osm version=\"0.6\"></osm>".into(), "<osm>"),
        ("old.xml", road.replacen("2020a", "2017a", 1), "2017a"),
        ("goalless.xml", road.replace(problem, ""), "planningProblem"),
        (
            "several.xml",
            road.replace(problem, &format!("{problem}{}", problem.replacen("id=\"", "id=\"9", 1))),
            "--problem",
        ),
        ("nan.xml", road_with("<exact>", "<exact>NaN</exact><exact>"), "NaN"),
        ("infinite.xml", road_with("<x>", "<x>1e999"), "1e999"),
        ("dt.xml", road.replacen(part(&road, "timeStepSize=\"", "\" "), "timeStepSize=\"0\" ", 1), "timeStepSize"),
    ];
    for (name, text, word) in bad {
        let name = place.file(name, text);
        complains(&place.run(&["drive", &name]), 3, &[&name, word]);
    }
    complains(&place.run(&["drive", "missing.xml"]), 3, &["missing.xml"]);
    complains(&place.run(&["drive", "."]), 3, &["."]);
    let name = place.file("latin.xml", b"<commonRoad>\xe9</commonRoad>");
    complains(&place.run(&["drive", &name]), 3, &["latin.xml:1", "UTF-8"]);
}

#[test]
fn a_lanelet_of_one_point_and_an_obstacle_without_a_shape_are_named_with_their_line() {
    let place = Place::new();
    let road = std::fs::read_to_string(ROAD).unwrap();
    let bound = part(&road, "<leftBound>", "</leftBound>");
    let point = part(bound, "<point>", "</point>");
    let one = place.file("one.xml", road.replacen(bound, &format!("<leftBound>{point}</leftBound>"), 1));
    let line = 1 + road[..road.find(bound).unwrap()].matches('\n').count();
    complains(&place.run(&["plan", &one]), 3, &[&format!("one.xml:{line}"), "lanelet", "leftBound", "1 point"]);

    let obstacle = "<staticObstacle id=\"900\"><type>unknown</type><initialState><position><point><x>1</x><y>1</y></point>\
                    </position><orientation><exact>0</exact></orientation><time><exact>0</exact></time></initialState></staticObstacle>";
    let shapeless =
        place.file("shapeless.xml", road.replacen("<planningProblem", &format!("{obstacle}<planningProblem"), 1));
    complains(&place.run(&["plan", &shapeless]), 3, &["staticObstacle 900", "shape"]);
}

#[test]
fn several_problems_are_chosen_by_id() {
    let place = Place::new();
    let road = std::fs::read_to_string(ROAD).unwrap();
    let problem = part(&road, "<planningProblem", "</planningProblem>");
    let id = part(problem, "id=\"", "\">").trim_start_matches("id=\"").trim_end_matches("\">");
    let second = problem.replacen(&format!("id=\"{id}\""), "id=\"7777\"", 1);
    let name = place.file("two.xml", road.replace(problem, &format!("{problem}{second}")));
    complains(&place.run(&["plan", &name]), 3, &[id, "7777", "--problem"]);
    complains(&place.run(&["plan", &name, "--problem", "5"]), 3, &["no planning problem 5", "7777"]);
    let output = place.run(&["plan", &name, "--problem", "7777", "--json", "-"]);
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(result["problem"], 7777);
}

#[test]
fn exit_3_is_a_vehicle_or_settings_that_cannot_be_read() {
    let place = Place::new();
    complains(&place.run(&["plan", ROAD, "--vehicle", "hovercraft"]), 3, &["hovercraft", "bmw_320i"]);
    std::fs::create_dir(place.path("car")).unwrap();
    complains(&place.run(&["plan", ROAD, "--vehicle", "car"]), 3, &["car"]);
    let settings = [
        ("bad.toml", "[planner\n", "bad.toml"),
        ("typo.toml", "[planner]\n\ncruise_sped = 3.0\n", "cruise_sped"),
        ("text.toml", "[planner]\ncruise_speed = \"fast\"\n", "line 2"),
        ("range.toml", "[run]\nreplan_interval = 0.0\n", "replan_interval"),
        ("nan.toml", "[planner]\ncruise_speed = nan\n", "cruise_speed"),
        ("rig.toml", "[simulation]\nfriction_scale = 0.0\n", "simulation.friction_scale"),
        ("near.toml", "[planner.collision]\nroad = -1.0\n", "planner.collision.road"),
        ("straight.toml", "[planner.lattice]\nheadings = []\n", "planner.lattice.headings"),
    ];
    for (name, text, word) in settings {
        let name = place.file(name, text);
        complains(&place.run(&["plan", ROAD, "--config", &name]), 3, &[&name, word]);
    }
    complains(&place.run(&["plan", ROAD, "--config", "missing.toml"]), 3, &["missing.toml"]);
    complains(&place.run(&["plan", ROAD, "--config", &place.file("latin.toml", b"a = \"\xe9\"")]), 3, &["latin.toml"]);
}

#[test]
fn friction_is_a_factor_a_surface_or_a_file_of_regions_and_a_wrong_one_is_named() {
    let place = Place::new();
    for factor in ["-0.5", "0", "nan", "1e9"] {
        complains(&place.run(&["plan", ROAD, "--friction", factor]), 2, &["--friction", "simulation.friction_scale"]);
    }
    complains(&place.run(&["plan", ROAD, "--friction", "mud"]), 3, &["mud"]);
    let region = |factor: &str, polygon: &str| format!("[[friction]]\nfactor = {factor}\npolygon = {polygon}\n");
    let square = "[[0.0, -9.0], [200.0, -9.0], [200.0, 9.0], [0.0, 9.0]]";
    for (text, word) in [
        (region("-0.5", square), "friction[0].factor"),
        (region("0", square), "friction[0].factor"),
        (region("nan", square), "friction[0].factor"),
        (region("\"mud\"", square), "mud"),
        (region("0.5", "[[0, 0], [1, 1]]"), "friction[0].polygon"),
        (region("0.5", "[[0, 0], [1, 1], [nan, 2]]"), "friction[0].polygon"),
        (region("0.5", "[[0, 0], [1, 1], [2, 2]]"), "corners lie on a line"),
        (region("0.5", "[[-10, -10], [300, 10], [300, -10], [-10, 10]]"), "edges that do not cross"),
        (region("0.5", "[[0, 0], [1, 1], [2]]"), "polygon"),
        (format!("{}{}", region("0.5", square), region("-1", square)), "friction[1].factor"),
        (region("0.5", square).replace("factor", "faktor"), "faktor"),
    ] {
        let name = place.file("road.toml", text);
        complains(&place.run(&["plan", ROAD, "--friction", &name]), 3, &[&name, word]);
        complains(&place.run(&["plan", ROAD, "--config", &name]), 3, &[&name, word]);
    }
    complains(&place.run(&["plan", ROAD, "--friction", "road.toml", "--json", "road.toml"]), 2, &["road.toml"]);
    let hash = |arguments: &[&str]| {
        let arguments = [&["drive", ROAD, "--json", "-"], arguments].concat();
        let result: Value = serde_json::from_slice(&place.run(&arguments).stdout).unwrap();
        result["hash"].clone()
    };
    let ice = place.file("ice.toml", region("\"ice\"", square));
    let dry = hash(&[]);
    assert_eq!(dry, hash(&["--friction", "dry"]));
    assert_eq!(dry, hash(&["--friction", "1"]));
    assert_ne!(dry, hash(&["--friction", "ice"]), "ice does nothing");
    assert_ne!(dry, hash(&["--friction", &ice]), "a patch of ice does nothing");
    assert_eq!(dry, hash(&["--config", &ice, "--friction", "dry"]), "dry is for all of the road");
    let told: Value =
        serde_json::from_slice(&place.run(&["drive", ROAD, "--json", "-", "--friction", &ice]).stdout).unwrap();
    assert_eq!((&told["friction"]["scale"], &told["friction"]["patches"][0]["factor"]), (&1.0.into(), &0.15.into()));
}

#[test]
fn exit_3_is_an_output_that_cannot_be_written_and_nothing_has_run() {
    let place = Place::new();
    for option in ["--json", "--csv", "--solution", "--svg"] {
        complains(&place.run(&["drive", ROAD, option, "none/out"]), 3, &["none/out", "cannot be written"]);
        complains(&place.run(&["drive", ROAD, option, "."]), 3, &["cannot be written"]);
    }
    complains(&place.run(&["drive", ROAD, "--svg", "fine.svg", "--json", "none/out"]), 3, &["none/out"]);
    assert_eq!(place.names(), Vec::<String>::new(), "nothing is left behind");
}

/// What is promised of every JSON result.
fn is_sound_result(result: &Value, format: &str) {
    assert_eq!(result["format"], format);
    for key in ["scenario", "vehicle", "outcome", "verdict", "hash"] {
        assert!(result[key].is_string(), "{key} of {result:#}");
    }
    assert_eq!(result["hash"].as_str().unwrap().len(), 64);
    for key in ["cycles", "proven_cycles", "expansions", "candidates"] {
        assert!(result["planning"][key].is_u64(), "planning.{key}");
    }
    let codes = stopline::planner::Rejection::ALL.map(|why| why.code());
    let rejections = result["planning"]["rejections"].as_object().unwrap();
    assert!(rejections.len() == codes.len() && codes.iter().all(|code| rejections[*code].is_u64()), "{rejections:?}");
    let rejected: u64 = rejections.values().map(|n| n.as_u64().unwrap()).sum();
    assert!(rejected <= result["planning"]["candidates"].as_u64().unwrap());
    let edges = result["planning"]["edges"].as_object().unwrap();
    for key in ["tried", "off_road", "no_spiral", "curvature_bound", "detour", "obstacle", "road_edge", "free"] {
        assert!(edges[key].is_u64(), "planning.edges.{key}");
    }
    for key in ["median", "p99", "max"] {
        assert!(result["planning"]["time_ms"][key].is_number(), "planning.time_ms.{key}");
    }
    for key in ["distance_m", "duration_s", "mean_speed_mps", "max_abs_acceleration_mps2", "max_abs_jerk_mps3"] {
        assert!(result["metrics"][key].is_number(), "metrics.{key}");
    }
    assert!(result["issues"].is_array());
    for check in result["checks"].as_array().unwrap() {
        for (key, ok) in [
            ("name", check["name"].is_string()),
            ("pass", check["pass"].is_boolean()),
            ("value", check["value"].is_number() || check["value"].is_null()),
            ("limit", check["limit"].is_number() || check["limit"].is_null()),
            ("unit", check["unit"].is_string()),
            ("at_time", check["at_time"].is_number() || check["at_time"].is_null()),
        ] {
            assert!(ok, "{key} of {check}");
        }
    }
}

#[test]
fn exit_0_a_drive_that_holds_tells_it_in_every_output() {
    let place = Place::new();
    let arguments = [
        "drive",
        ROAD,
        "--json",
        "run.json",
        "--csv",
        "run.csv",
        "--solution",
        "run.xml",
        "--svg",
        "run.svg",
        "--seed",
        "5",
    ];
    let output = place.run(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}{}", stdout(&output), stderr(&output));
    assert!(stdout(&output).contains("pass") && stdout(&output).contains("no_contact"), "{}", stdout(&output));
    assert_eq!(place.names(), ["run.csv", "run.json", "run.svg", "run.xml"], "and no temporary files");

    let result: Value = serde_json::from_slice(&std::fs::read(place.path("run.json")).unwrap()).unwrap();
    is_sound_result(&result, "stopline.drive/2");
    assert_eq!((&result["verdict"], &result["seed"]), (&Value::from("pass"), &Value::from(5)));
    assert!(result["checks"].as_array().unwrap().iter().all(|c| c["pass"] == true));
    assert!(result["solution"]["max_deviation_m"].as_f64().unwrap() < 0.5);

    let rows = csv::Reader::from_path(place.path("run.csv")).unwrap().into_records().map(Result::unwrap).count();
    let duration = result["metrics"]["duration_s"].as_f64().unwrap();
    assert!(rows as f64 >= 100.0 * duration, "{rows} rows in {duration} s");
    let solution = std::fs::read_to_string(place.path("run.xml")).unwrap();
    assert!(roxmltree_like(&solution, "CommonRoadSolution") && solution.contains("benchmark_id=\"KS2:SM1:"));
    assert!(roxmltree_like(&std::fs::read_to_string(place.path("run.svg")).unwrap(), "svg"));
}

/// Whether the text looks like XML with that root.
fn roxmltree_like(text: &str, root: &str) -> bool {
    text.contains(&format!("<{root}")) && text.trim_end().ends_with(&format!("</{root}>"))
}

#[test]
fn json_on_stdout_is_one_object_and_nothing_else() {
    let place = Place::new();
    let output = place.run(&["plan", ROAD, "--json", "-"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    is_sound_result(&result, "stopline.plan/2");
    assert_eq!(result["outcome"], "planned");
    let plan = &result["plan"];
    assert!(plan["proof"]["deceleration_mps2"].as_f64().unwrap() > 0.0);
    assert_eq!(plan["proof"]["ends_at_standstill"], true);
    let states = plan["states"].as_array().unwrap();
    assert!(states.len() > 10);
    assert_eq!(states[states.len() - 1]["speed_mps"], 0.0);
    assert_eq!(place.names(), Vec::<String>::new(), "no file is called -");
    assert_eq!(stderr(&output), "", "no progress bar where nobody watches");
}

/// What is promised of a list of candidates; how many there are of each state.
fn are_sound_candidates(candidates: &Value) -> std::collections::BTreeMap<String, u64> {
    let codes = stopline::planner::Rejection::ALL.map(|why| why.code());
    let mut states = std::collections::BTreeMap::new();
    for candidate in candidates.as_array().unwrap() {
        for key in ["lane", "attempt"] {
            assert!(candidate[key].is_u64(), "{key} of {candidate}");
        }
        for key in ["length_m", "end_x_m", "end_y_m", "cost"] {
            assert!(candidate[key].is_f64(), "{key} of {candidate}");
        }
        let terms = candidate["terms"].as_object().unwrap();
        let names = [
            "offset",
            "curvature",
            "clearance",
            "lane_deviation",
            "progress_shortfall",
            "plan_change",
            "lane_change",
            "travel_time",
            "curve_slowdown",
        ];
        assert!(terms.len() == names.len() && names.iter().all(|n| terms[*n].as_f64().unwrap() >= 0.0), "{terms:?}");
        let sum: f64 = terms.values().map(|v| v.as_f64().unwrap()).sum();
        assert!((sum - candidate["cost"].as_f64().unwrap()).abs() < 1e-9, "the cost is the sum of its terms");
        let state = candidate["rejected"].as_str().unwrap_or("chosen");
        assert!(candidate["rejected"].is_null() || codes.contains(&state), "{state}");
        *states.entry(state.to_owned()).or_insert(0) += 1;
    }
    states
}

#[test]
fn proofs_against_sets_of_motions_are_counted_only_where_they_are_asked_for() {
    let place = Place::new();
    let slow_lead = concat!(env!("CARGO_MANIFEST_DIR"), "/maps/slow_lead.xml");
    let planned = |mode: &str| -> (Value, String) {
        let file = place.file("sets.toml", format!("[planner.uncertainty]\nmode = \"{mode}\"\n"));
        let output = place.run(&["plan", slow_lead, "--config", &file, "--json", "-"]);
        let text = place.run(&["plan", slow_lead, "--config", &file]);
        (serde_json::from_slice(&output.stdout).unwrap(), String::from_utf8(text.stdout).unwrap())
    };
    let counted = |mode: &str| planned(mode).0["planning"]["robust_cycles"].as_u64();
    assert_eq!((counted("off"), counted("preferred"), counted("required")), (None, Some(1), Some(1)));
    assert!(planned("preferred").1.contains("proven against all motions within the bounds: 1 of 1"));
    assert!(!planned("off").1.contains("all motions"));
}

#[test]
fn a_plan_lists_its_candidates_with_terms_and_reasons() {
    let place = Place::new();
    let parked = concat!(env!("CARGO_MANIFEST_DIR"), "/maps/parked_car.xml");
    let output = place.run(&["plan", parked, "--json", "-"]);
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    let states = are_sound_candidates(&result["candidates"]);
    assert_eq!(states["chosen"], 1, "{states:?}");
    let told = result["planning"]["rejections"].as_object().unwrap();
    for (code, count) in told {
        assert_eq!(states.get(code).copied().unwrap_or(0), count.as_u64().unwrap(), "{code} of {states:?}");
    }
    let chosen = result["candidates"].as_array().unwrap().iter().find(|c| c["rejected"].is_null()).unwrap();
    let cost = |c: &Value| c["cost"].as_f64().unwrap();
    let passed = result["candidates"].as_array().unwrap().iter().filter(|c| c["rejected"] == "higher_cost");
    assert!(passed.clone().count() > 0 && passed.clone().all(|c| cost(c) >= cost(chosen) - 1e-6));
}

#[test]
fn a_drive_tells_its_cycles_only_if_asked_and_its_hash_does_not_see_them() {
    let place = Place::new();
    let drive = |arguments: &[&str]| -> Value {
        let output = place.run(&[&["drive", ROAD, "--json", "-"], arguments].concat());
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let (short, long) = (drive(&[]), drive(&["--json-cycles"]));
    assert!(short["cycles"].is_null() && short["candidates"].is_null());
    assert_eq!(short["hash"], long["hash"]);
    let cycles = long["cycles"].as_array().unwrap();
    assert_eq!(cycles.len() as u64, long["planning"]["cycles"].as_u64().unwrap());
    let (mut total, mut rejected) = (0, 0);
    for cycle in cycles {
        let states = are_sound_candidates(&cycle["candidates"]);
        let decision = cycle["decision"].as_str().unwrap();
        assert!(["new_plan", "keep_previous", "unproven"].contains(&decision), "{decision}");
        assert_eq!(
            states.get("chosen").copied().unwrap_or(0),
            u64::from(decision == "new_plan"),
            "{decision} {states:?}"
        );
        assert_eq!(cycle["deceleration_mps2"].is_number(), decision == "new_plan");
        assert!(cycle["time_s"].is_number() && cycle["expansions"].is_u64());
        total += states.values().sum::<u64>();
        rejected += states.iter().filter(|(state, _)| *state != "chosen").map(|(_, n)| n).sum::<u64>();
    }
    assert_eq!(total, long["planning"]["candidates"].as_u64().unwrap());
    let told: u64 = long["planning"]["rejections"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(rejected, told);
    complains(&place.run(&["drive", ROAD, "--json-cycles"]), 2, &["--json"]);
}

#[test]
fn quiet_says_nothing_and_still_judges() {
    let place = Place::new();
    let output = place.run(&["plan", ROAD, "--quiet"]);
    assert_eq!((output.status.code(), stdout(&output), stderr(&output)), (Some(0), String::new(), String::new()));
}

#[test]
fn issues_of_the_file_are_told_on_stderr_and_in_the_json() {
    let place = Place::new();
    let name = place.file("odd.xml", road_with("<lanelet ", "<weather/><lanelet "));
    let output = place.run(&["plan", &name, "--json", "-"]);
    assert!(stderr(&output).contains("odd.xml: 1 issue") && stderr(&output).contains("weather"), "{}", stderr(&output));
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(result["issues"][0]["element"].as_str().unwrap().contains("weather"));
    assert!(result["issues"][0]["line"].as_u64().unwrap() > 0);
}

#[test]
fn a_grid_beside_the_road_is_an_issue_and_one_on_it_is_none() {
    let place = Place::new();
    place.file("g.pgm", "P2 2 2 255 255 255 255 255");
    for (y, issues) in [("900", 1), ("0", 0)] {
        let yaml = format!(
            "image: g.pgm\nresolution: 1\norigin: [20, {y}, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
        );
        let name = place.file("g.yaml", yaml);
        let output = place.run(&["plan", ROAD, "--grid", &name, "--json", "-"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let result: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(result["issues"].as_array().unwrap().len(), issues, "y = {y}: {}", result["issues"]);
        let told = stderr(&output);
        assert_eq!(told.contains("occupancy grid g.yaml: lies beside the road"), issues == 1, "{told}");
    }
}

/// The hash of a run of the road.
fn hash(place: &Place, arguments: &[&str]) -> String {
    let output = place.run(&[&["drive", ROAD, "--json", "-"], arguments].concat());
    let result: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", stderr(&output)));
    result["hash"].as_str().unwrap().to_owned()
}

#[test]
fn the_hash_is_the_same_for_every_repetition_and_number_of_threads() {
    let place = Place::new();
    let first = hash(&place, &["--threads", "1"]);
    assert_eq!(hash(&place, &["--threads", "2"]), first);
    assert_eq!(hash(&place, &["--svg", "run.svg", "--solution", "run.xml"]), first, "outputs change nothing");
    assert_ne!(hash(&place, &["--seed", "1"]), first, "the seed is part of the result");
}

#[test]
fn faults_limits_and_forks_are_told_in_the_json() {
    let place = Place::new();
    let result = |arguments: &[&str]| -> Value {
        let all = [&["drive", ROAD, "--quiet", "--json", "-"], arguments].concat();
        serde_json::from_str(&stdout(&place.run(&all))).unwrap()
    };
    let check =
        |result: &Value, name: &str| result["checks"].as_array().unwrap().iter().find(|c| c["name"] == name).cloned();
    let plain = result(&[]);
    assert!(plain.get("faults").is_none() && check(&plain, "fallback_stops").is_some());
    let missed = result(&["--inject", "missed_cycles=3", "--inject", "mass=1.1", "--seed", "7", "--fallbacks", "off"]);
    assert_eq!((&missed["faults"]["missed_cycles"], &missed["faults"]["mass"]), (&3.into(), &1.1.into()));
    assert_eq!((&missed["faults"]["seed"], &missed["seed"]), (&7.into(), &7.into()));
    assert!(check(&missed, "fallback_stops").is_none());
    let strict = result(&["--comfort", "iso11270", "--fallbacks", "5"]);
    assert_eq!(check(&strict, "comfort_lateral_jerk").unwrap()["limit"], 5.0);
    assert!(check(&strict, "comfort_jerk").unwrap()["note"].as_str().unwrap().contains("limits of iso11270"));
}

#[test]
fn exit_1_is_a_check_that_failed() {
    let place = Place::new();
    let road = std::fs::read_to_string(ROAD).unwrap();
    // A wall across the road, a car's length ahead: no way to stop before it at the initial speed.
    let start = part(&road, "<planningProblem", "</planningProblem>");
    let x: f64 = part(start, "<x>", "</x>").trim_start_matches("<x>").trim_end_matches("</x>").parse().unwrap();
    let wall = format!(
        "<staticObstacle id=\"900\"><type>unknown</type><shape><rectangle><length>1</length><width>40</width></rectangle></shape>\
         <initialState><position><point><x>{}</x><y>0</y></point></position><orientation><exact>0</exact></orientation>\
         <time><exact>0</exact></time></initialState></staticObstacle>",
        x + 5.0
    );
    let name = place.file("wall.xml", road.replacen("<planningProblem", &format!("{wall}<planningProblem"), 1));
    for command in ["plan", "drive"] {
        let output = place.run(&[command, &name, "--json", "-"]);
        assert_eq!(output.status.code(), Some(1), "{command}: {}{}", stdout(&output), stderr(&output));
        let result: Value = serde_json::from_slice(&output.stdout).unwrap();
        is_sound_result(&result, &format!("stopline.{command}/2"));
        assert_eq!(result["verdict"], "fail");
    }
}

#[cfg(unix)]
#[test]
fn a_reader_that_closes_the_pipe_is_no_fault() {
    use std::process::{Command as Plain, Stdio};
    let program = assert_cmd::cargo::cargo_bin("stopline");
    let mut child = Plain::new(program)
        .args(["plan", ROAD, "--json", "-"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

#[test]
fn devices_can_be_written_to_more_than_once() {
    if Path::new("/dev/null").exists() {
        let output = Place::new().run(&["plan", ROAD, "--csv", "/dev/null", "--svg", "/dev/null"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    }
}
