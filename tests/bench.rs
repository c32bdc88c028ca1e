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

/// A wall before one vehicle on three surfaces. Whether the proofs hold is the subject of the benchmark, not of this test.
#[test]
fn fallbacks_are_reported_in_every_format_with_equal_hashes() {
    let folder = tempfile::tempdir().unwrap();
    let with = |more: &[&str]| {
        run(folder.path(), &[&["bench", "fallbacks", "--scenes", "1", "--vehicle", "bmw_320i"][..], more].concat())
    };
    let printed = with(&["--csv", "a.csv", "--json", "a.json"]);
    assert!([Some(0), Some(1)].contains(&printed.status.code()), "{}", text(&printed.stderr));
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let value: Value = serde_json::from_str(&read("a.json")).unwrap();
    let scenes = value["scenes"].as_array().unwrap();
    let surfaces: Vec<&str> = scenes.iter().map(|s| s["surface"].as_str().unwrap()).collect();
    assert_eq!(surfaces, ["dry", "wet", "ice"]);
    assert!(scenes.iter().all(|s| s["kind"] == "wall" && s["cycles"].as_u64() > Some(0)), "{value:#}");
    let broken: u64 =
        scenes.iter().flat_map(|s| s["broken"].as_object().unwrap().values()).filter_map(Value::as_u64).sum();
    assert_eq!(printed.status.code() == Some(0), value["verdict"] == "pass");
    assert!(broken == 0 || scenes.iter().any(|s| s["worst"].is_string()), "{value:#}");
    assert_eq!(read("a.csv").lines().count(), 1 + 3);
    assert!(text(&printed.stdout).contains("broken_proofs"));
    let again: Value = serde_json::from_slice(&with(&["--json", "-", "--quiet"]).stdout).unwrap();
    assert_eq!(again["hash"], value["hash"]);
    // a fault that does not exist is refused before anything is measured
    assert_eq!(with(&["--inject", "wind=3"]).status.code(), Some(2));
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
    let wrong: [(&[&str], &str); 9] = [
        (&["bench"], "spirals"),
        (&["bench", "splines"], "splines"),
        (&["bench", "spirals", "extra"], "extra"),
        (&["bench", "spirals", "--problems", "0"], "--problems"),
        (&["bench", "spirals", "--problems", "many"], "--problems"),
        (&["bench", "spirals", "--problems", "1000001"], "--problems"),
        (&["bench", "spirals", "--seed=-1"], "--seed"),
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
