//! `stopline bench` from the command line, and the pictures of `docs/geometry.md`.

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;
use stopline::io::commonroad::read_file;
use stopline::plot::geometry::pictures;
use stopline::vehicle::load;

fn run(folder: &Path, arguments: &[&str]) -> Output {
    Command::cargo_bin("stopline").unwrap().current_dir(folder).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

/// A small version of the paper's experiment: two start speeds, 20 m.
const SMALL: [&str; 6] = ["bench", "safetlp", "--every", "13", "--length", "20"];

#[test]
fn writes_the_papers_experiment_in_every_format_with_equal_hashes() {
    let folder = tempfile::tempdir().unwrap();
    let with = |more: &[&str]| run(folder.path(), &[&SMALL, more].concat());
    let printed = with(&["--csv", "a.csv", "--svg", "a.svg", "--json", "a.json"]);
    assert_eq!(printed.status.code(), Some(0), "{}", text(&printed.stderr));
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let value: Value = serde_json::from_str(&read("a.json")).unwrap();
    assert_eq!((&value["instances"], &value["verdict"]), (&8.into(), &"pass".into()));
    assert!(text(&printed.stdout).contains(value["hash"].as_str().unwrap()));
    // one row for each of six methods and eight instances
    let (csv, svg) = (read("a.csv"), read("a.svg"));
    assert_eq!(csv.lines().count(), 1 + 6 * 8);
    assert!(csv.lines().all(|line| line.split(',').count() == 15), "{csv}");
    for panel in ["expansions", "times", "speeds"] {
        assert!(svg.contains(&format!("id=\"{panel}\"")), "{panel}");
    }
    // only times may differ between two runs
    let again = with(&["--json", "-", "--quiet"]);
    let again: Value = serde_json::from_slice(&again.stdout).unwrap();
    assert_eq!(again["hash"], value["hash"]);
}

/// `bench fallbacks --json -` with more arguments: its result, and the exit code.
fn fallbacks(folder: &Path, more: &[&str]) -> (Value, Option<i32>) {
    let output = run(folder, &[&["bench", "fallbacks", "--json", "-", "--quiet"], more].concat());
    let value = serde_json::from_slice(&output.stdout);
    (value.unwrap_or_else(|e| panic!("{e}: {}", text(&output.stderr))), output.status.code())
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A wall before one vehicle on three surfaces, and two maps.
#[test]
fn fallbacks_are_reported_in_every_format_with_equal_hashes() {
    let folder = tempfile::tempdir().unwrap();
    let maps = folder.path().join("maps");
    std::fs::create_dir(&maps).unwrap();
    for name in ["straight_100m.xml", "lane_blocked.xml"] {
        std::fs::copy(root().join("maps").join(name), maps.join(name)).unwrap();
    }
    let small = ["--scenes", "1", "--vehicle", "bmw_320i"];
    let with = |more: &[&str]| run(folder.path(), &[&["bench", "fallbacks"], &small[..], more].concat());
    let printed = with(&["--csv", "a.csv", "--json", "a.json"]);
    assert_eq!(printed.status.code(), Some(0), "{}{}", text(&printed.stdout), text(&printed.stderr));
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let value: Value = serde_json::from_str(&read("a.json")).unwrap();
    let scenes = value["scenes"].as_array().unwrap();
    let named: Vec<(&str, &str)> =
        scenes.iter().map(|s| (s["surface"].as_str().unwrap(), s["scene"].as_str().unwrap())).collect();
    let expected =
        ["dry", "wet", "ice"].iter().flat_map(|s| ["wall", "lane_blocked.xml", "straight_100m.xml"].map(|n| (*s, n)));
    assert_eq!(named, expected.collect::<Vec<_>>());
    assert!(scenes.iter().all(|s| s["cycles"].as_u64() > Some(0) && s["branches"].as_u64() > Some(0)), "{value:#}");
    assert_eq!((&value["verdict"], &value["broken"]), (&"pass".into(), &0.into()));
    assert_eq!(read("a.csv").lines().count(), 1 + 3 * 3);
    let report = text(&printed.stdout);
    let total = format!("proven stops executed: {}, broken: 0", value["branches"]);
    for part in ["broken_proofs", "short", &total] {
        assert!(report.contains(part), "{part}: {report}");
    }
    assert_eq!(fallbacks(folder.path(), &small).0["hash"], value["hash"]);
    // without maps the same random scenes remain
    let (without, _) = fallbacks(folder.path(), &[&small[..], &["--maps", "off"]].concat());
    let walls: Vec<&Value> = scenes.iter().filter(|s| s["scene"] == "wall").collect();
    assert_eq!(without["scenes"].as_array().unwrap().iter().collect::<Vec<_>>(), walls);
    // refused before anything is measured
    for (wrong, code, word) in [
        (&["--inject", "wind=3"][..], 2, "wind"),
        (&["--scenes", "0", "--maps", "off"], 2, "nothing to run"),
        (&["--vehicle", "bwm_320i"], 3, "--vehicle bwm_320i: no such vehicle"),
        (&["--maps", "none"], 3, "--maps none: cannot be read: "),
        (&["--maps", "none"], 3, "expected a folder of scenarios (*.xml), or off"),
        (&["--maps", "."], 3, "--maps .: has no scenario; expected a folder of scenarios (*.xml), or off"),
    ] {
        let output = run(folder.path(), &[&["bench", "fallbacks"], wrong].concat());
        let error = text(&output.stderr);
        assert!(output.status.code() == Some(code) && error.contains(word), "{wrong:?}: {error}");
    }
}

/// Two files, one of them in a subfolder, and a broken one.
#[test]
fn a_folder_of_scenarios_has_a_score() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(folder.path().join("set/more")).unwrap();
    let copy = |map: &str, to: &str| {
        std::fs::copy(root().join("maps").join(map), folder.path().join("set").join(to)).unwrap();
    };
    copy("lane_blocked.xml", "b.xml");
    copy("straight_100m.xml", "more/a.xml");
    let bench = |more: &[&str]| run(folder.path(), &[&["bench", "commonroad"], more].concat());
    let printed = bench(&["set", "--json", "s.json", "--csv", "s.csv"]);
    assert_eq!(printed.status.code(), Some(0), "{}", text(&printed.stderr));
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let value: Value = serde_json::from_str(&read("s.json")).unwrap();
    let runs = value["runs"].as_array().unwrap();
    let ended: Vec<(&Value, &Value)> = runs.iter().map(|r| (&r["scenario"], &r["outcome"])).collect();
    assert_eq!(ended, [(&"b".into(), &"stopped_safely".into()), (&"a".into(), &"goal_reached".into())]);
    assert_eq!((&value["problems"], &value["reached"], &value["contacts"]), (&2.into(), &1.into(), &0.into()));
    let cycles: u64 = runs.iter().filter_map(|r| r["cycles"].as_u64()).sum();
    assert_eq!(value["cycles"], cycles);
    let ms = |key: &str| value["time"][key].as_f64().unwrap();
    assert!(0.0 < ms("median_ms") && ms("median_ms") <= ms("p99_ms") && ms("p99_ms") <= ms("slowest_ms"));
    assert!(text(&printed.stdout).contains(value["hash"].as_str().unwrap()));
    assert_eq!(read("s.csv").lines().count(), 3);
    // times alone depend on the number of files at a time
    let again: Value = serde_json::from_slice(&bench(&["set", "--jobs", "1", "--json", "-"]).stdout).unwrap();
    assert_eq!((&again["hash"], &again["runs"]), (&value["hash"], &value["runs"]));
    // a list picks by name; a name without a file and a file that cannot be read are named, and the others are measured
    std::fs::write(folder.path().join("list"), "# names\na.xml\nnowhere\n").unwrap();
    let one = bench(&["set", "--list", "list", "--json", "-"]);
    let value: Value = serde_json::from_slice(&one.stdout).unwrap();
    let problems = (&value["problems"], &value["missing"][0]);
    assert_eq!((one.status.code(), problems), (Some(3), (&1.into(), &"nowhere".into())));
    std::fs::write(folder.path().join("set/c.xml"), "<commonRoad/>").unwrap();
    let broken = bench(&["set", "--json", "-"]);
    let value: Value = serde_json::from_slice(&broken.stdout).unwrap();
    assert_eq!((broken.status.code(), &value["problems"]), (Some(3), &2.into()));
    assert!(text(&broken.stderr).contains("c.xml"), "{}", text(&broken.stderr));
    for (wrong, word) in [
        (&["nowhere"][..], "nowhere: "),
        (&["set/more", "--list", "nowhere"], "--list nowhere: cannot be read"),
        (&["set/more", "--list", "s.json"], "none of its"),
    ] {
        let output = bench(wrong);
        assert!(output.status.code() == Some(3) && text(&output.stderr).contains(word), "{}", text(&output.stderr));
    }
}

/// Some hundreds of stops: a random scene and a map, with all vehicles and surfaces. The whole benchmark takes minutes.
#[test]
fn no_proven_stop_breaks() {
    let folder = tempfile::tempdir().unwrap();
    let maps = folder.path().join("maps");
    std::fs::create_dir(&maps).unwrap();
    std::fs::copy(root().join("maps/parked_car.xml"), maps.join("parked_car.xml")).unwrap();
    let (value, exit) = fallbacks(folder.path(), &["--scenes", "1", "--first", "1"]);
    let scenes = value["scenes"].as_array().unwrap();
    let failed: Vec<&Value> = scenes.iter().filter(|s| s["worst"].is_string()).collect();
    let branches: u64 = scenes.iter().filter_map(|s| s["branches"].as_u64()).sum();
    assert_eq!((scenes.len(), &value["branches"]), (4 * 3 * 2, &branches.into()));
    assert!(branches > 400, "{branches}");
    let unproven: Vec<&Value> = scenes.iter().filter(|s| s["proven_cycles"] == 0).collect();
    assert!(unproven.is_empty(), "{unproven:#?}");
    assert_eq!(value["broken"], 0, "{failed:#?}");
    for check in value["checks"].as_array().unwrap() {
        assert_eq!((&check["status"], &check["value"]), (&"pass".into(), &0.0.into()), "{failed:#?}");
    }
    assert_eq!(exit, Some(0));
}

/// The benchmark can fail: a road far more slippery than believed and a long dead time break proofs.
#[test]
fn strong_faults_break_proven_stops() {
    let folder = tempfile::tempdir().unwrap();
    // a gap between two posts
    let small = ["--scenes", "1", "--first", "2", "--interval", "1", "--vehicle", "bmw_320i"];
    for fault in ["friction=0.3", "delay=0.8"] {
        let (value, exit) = fallbacks(folder.path(), &[&small[..], &["--inject", fault]].concat());
        assert!(value["broken"].as_u64() > Some(0), "{fault}: {value:#}");
        assert_eq!((&value["verdict"], exit), (&"fail".into(), Some(1)), "{fault}");
        let scenes = value["scenes"].as_array().unwrap().iter();
        let mut broken = scenes.filter(|s| s["broken"].as_u64() > Some(0)).peekable();
        assert!(broken.peek().is_some() && broken.all(|s| s["worst"].is_string()), "{fault}");
    }
}

#[test]
fn reports_exhausted_budgets_with_exit_1() {
    let folder = tempfile::tempdir().unwrap();
    let road = ["bench", "safetlp", "--every", "13", "--length", "60"];
    // plan-to-stop counts expansions until its memory is exhausted, but has no plan and no average speed
    for (bound, line, ratio) in [
        (["--memory", "1"], "exhausted the memory budget of 1 MiB", "PASS"),
        (["--time-limit", "0"], "plan-to-stop: 8 of 8 searches omitted after the time limit of 0 s", "N/A"),
    ] {
        let output = run(folder.path(), &[&road[..], &bound].concat());
        let report = text(&output.stdout);
        assert_eq!(output.status.code(), Some(1), "{report}");
        assert!(report.contains(line), "{report}");
        assert!(!report.contains("NaN"), "{report}");
        let status = |check: &str| {
            let row = report.lines().find(|l| l.starts_with(check)).expect("the check is listed");
            row.split_whitespace().nth(1).expect("a status").to_owned()
        };
        assert_eq!(["expansion_ratio", "average_speed", "all_proven"].map(status), [ratio, "N/A", "PASS"], "{report}");
    }
}

#[test]
fn rejects_an_invalid_road_with_exit_2() {
    let folder = tempfile::tempdir().unwrap();
    for (option, value, word) in [
        ("--step", "0", "step"),
        ("--step", "101", "step of 101 m on a road of 100 m"),
        ("--step=-1", "", "step"),
        ("--length", "nan", "0.001 to 10000"),
        ("--length", "-5", "0.001 to 10000"),
        ("--length", "inf", "0.001 to 10000"),
        ("--time-bin", "0", "0.001 to 10"),
        ("--time-limit", "nan", "--time-limit"),
        ("--every", "0", "--every"),
        ("--memory", "0", "--memory"),
    ] {
        let arguments = ["bench", "safetlp", option, value];
        let output = run(folder.path(), &arguments[..if value.is_empty() { 3 } else { 4 }]);
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{option} {value}: {error}");
        assert!(error.contains(word) && output.stdout.is_empty(), "{option} {value}: {error}");
    }
}

/// Compares the table in `docs/` with a new run of the quick methods.
#[test]
fn experiment_csv_in_the_docs_is_up_to_date() {
    let documented = include_str!("../docs/speed/experiment.csv");
    let of = |table: &str, method: &str| -> Vec<String> {
        let rows = table.lines().filter(|line| line.starts_with(&format!("{method},")));
        // all columns but the time
        rows.filter_map(|line| line.rsplit_once(',').map(|(row, _)| row.to_owned())).collect()
    };
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), &["bench", "safetlp", "--time-limit", "0", "--csv", "a.csv", "--quiet"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let fresh = std::fs::read_to_string(folder.path().join("a.csv")).unwrap();
    for method in ["naive", "safetlp", "safetlp_planner", "safe_rts"] {
        assert_eq!(of(documented, method).len(), 104);
        assert_eq!(of(documented, method), of(&fresh, method), "{method}: see docs/speed.md for the command");
    }
    assert!(of(documented, "plan_to_stop").iter().all(|row| row.contains(",proven,") && row.ends_with(",1")));
}

/// The result of a run with `--json -`.
fn result(folder: &Path, arguments: &[&str]) -> Value {
    let output = run(folder, &[&["bench", "spirals", "--json", "-"], arguments].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn wrong_use_exits_with_2_and_writes_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let wrong: [(&[&str], &str); 16] = [
        (&["bench"], "spirals"),
        (&["bench", "splines"], "splines"),
        (&["bench", "spirals", "extra"], "extra"),
        (&["bench", "spirals", "--problems", "0"], "--problems"),
        (&["bench", "spirals", "--problems", "many"], "--problems"),
        (&["bench", "spirals", "--problems", "1000001"], "--problems"),
        (&["bench", "spirals", "--seed", "-1"], "'--seed <N>': expected a whole number from 0 to 18446744073709551615"),
        (&["bench", "spirals", "--problems", "-1"], "expected a whole number from 1 to 1000000"),
        (&["bench", "safetlp", "--every", "-1"], "expected a whole number from 1"),
        (&["bench", "safetlp", "--memory", "-1"], "expected a whole number from 1 to 65536"),
        (&["bench", "safetlp", "--step", "-1"], "'--step <M>': expected a length in metres above 0"),
        (&["bench", "safetlp", "--time-limit", "-1"], "expected a time in seconds of at least 0"),
        (&["bench", "fallbacks", "--scenes", "-1"], "expected a whole number from 0 to 1000000"),
        (&["bench", "fallbacks", "--interval", "-1"], "'--interval <S>': expected an interval from 0.05 to 3600 s"),
        (&["bench", "spirals", "--csv", "a", "--svg", "./a"], "twice"),
        (&["bench", "spirals", "--csv", "-"], "stdout"),
    ];
    for (arguments, word) in wrong {
        let output = run(folder.path(), arguments);
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {error}");
        assert!(error.contains(word) && output.stdout.is_empty(), "{arguments:?}: {error}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn rejects_an_unwritable_output_with_exit_3_before_measuring() {
    let folder = tempfile::tempdir().unwrap();
    for option in ["--json", "--csv", "--svg"] {
        // a comparison of a million problems would take minutes
        let output = run(folder.path(), &["bench", "spirals", "--problems", "1000000", option, "none/out"]);
        assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
        assert!(text(&output.stderr).contains("none/out"));
    }
}

#[test]
fn help_shows_exit_codes_and_defaults() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [["bench", "--help"].as_slice(), &["bench", "spirals", "--help"]] {
        let output = run(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(0));
        assert!(text(&output.stdout).contains("Exit codes:"), "{arguments:?}");
    }
    assert!(text(&run(folder.path(), &["bench", "spirals", "--help"]).stdout).contains("2000"));
}

#[test]
fn repeated_runs_differ_only_in_time() {
    let folder = tempfile::tempdir().unwrap();
    let timeless = |arguments: &[&str]| {
        let mut value = result(folder.path(), arguments);
        let times = value.as_object_mut().unwrap().remove("time").unwrap();
        for method in value["methods"].as_array().unwrap() {
            let time = &times[method["name"].as_str().unwrap()];
            assert!(time["median_us"].as_f64().unwrap() > 0.0 && time["p99_us"].is_number(), "{method}");
        }
        value
    };
    let first = timeless(&["--problems", "60"]);
    assert_eq!(first, timeless(&["--problems", "60"]));
    assert_eq!(first["format"], "stopline.bench.spirals/2");
    assert_eq!((&first["seed"], &first["problems"], &first["verdict"]), (&7.into(), &60.into(), &"pass".into()));
    assert_eq!(first["hash"].as_str().unwrap().len(), 64);
    let other = timeless(&["--problems", "60", "--seed", "8"]);
    assert_ne!(first["hash"], other["hash"]);
}

#[test]
fn table_json_and_csv_contain_every_method() {
    let folder = tempfile::tempdir().unwrap();
    let outputs = ["--json", "b.json", "--csv", "b.csv", "--svg", "b.svg"];
    let output = run(folder.path(), &[&["bench", "spirals", "--problems", "60"], outputs.as_slice()].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let table = text(&output.stdout);
    let json: Value = serde_json::from_slice(&std::fs::read(folder.path().join("b.json")).unwrap()).unwrap();
    let methods = json["methods"].as_array().unwrap();
    assert!(methods.len() >= 5);
    let mut reader = csv::Reader::from_path(folder.path().join("b.csv")).unwrap();
    let headers = reader.headers().unwrap().clone();
    let column = |name: &str| headers.iter().position(|h| h == name).unwrap();
    let (method_column, solved_column) = (column("method"), column("solved"));
    assert!(!headers.iter().any(|h| h.contains("_us") || h.contains("time")), "the CSV contains times: {headers:?}");
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    for method in methods {
        let (name, label) = (method["name"].as_str().unwrap(), method["label"].as_str().unwrap());
        assert!(table.contains(label), "{label} is missing in {table}");
        let of_method: Vec<_> = rows.iter().filter(|r| &r[method_column] == name).collect();
        assert_eq!(of_method.len() as u64, method["problems"].as_u64().unwrap(), "{name}");
        let solved = of_method.iter().filter(|r| &r[solved_column] == "1").count();
        assert_eq!(solved as u64, method["solved"].as_u64().unwrap(), "{name}");
    }
    assert!(std::fs::read_to_string(folder.path().join("b.svg")).unwrap().trim_end().ends_with("</svg>"));
    let quiet = run(folder.path(), &["bench", "spirals", "--problems", "3", "--quiet"]);
    assert_eq!((quiet.status.code(), quiet.stdout.len(), quiet.stderr.len()), (Some(0), 0, 0));
}

#[test]
fn pictures_of_the_geometry_page_are_up_to_date() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let slalom = read_file(&root.join("maps/slalom.xml")).unwrap();
    let page = std::fs::read_to_string(root.join("docs/geometry.md")).unwrap();
    let drawn = pictures(&slalom, &load("bmw_320i").unwrap());
    assert_eq!(drawn.len(), 6);
    for (name, svg) in drawn {
        let documented = std::fs::read_to_string(root.join("docs/geometry").join(name)).unwrap_or_default();
        assert!(
            documented == svg,
            "docs/geometry/{name} is out of date; draw it again and inspect it: cargo run --release --example geometry_page"
        );
        assert!(page.contains(&format!("(geometry/{name})")), "the page does not show {name}");
    }
}
