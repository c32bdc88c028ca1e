//! `stopline bench` as a user meets it, and the page of pictures that it is measured beside.

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

/// The result of a run with `--json -`.
fn result(folder: &Path, arguments: &[&str]) -> Value {
    let output = run(folder, &[&["bench", "spirals", "--json", "-"], arguments].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn wrong_use_is_exit_2_and_writes_nothing() {
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
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(word) && output.stdout.is_empty(), "{arguments:?}: {said}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn an_output_that_cannot_be_written_is_exit_3_before_anything_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    for option in ["--json", "--csv", "--svg"] {
        // as many problems as would take minutes
        let output = run(folder.path(), &["bench", "spirals", "--problems", "1000000", option, "none/out"]);
        assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
        assert!(text(&output.stderr).contains("none/out"));
    }
}

#[test]
fn help_tells_the_exit_codes_and_the_defaults() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [["bench", "--help"].as_slice(), &["bench", "spirals", "--help"]] {
        let output = run(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(0));
        assert!(text(&output.stdout).contains("Exit codes:"), "{arguments:?}");
    }
    assert!(text(&run(folder.path(), &["bench", "spirals", "--help"]).stdout).contains("2000"));
}

#[test]
fn everything_but_the_times_is_the_same_twice() {
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
    assert_eq!(first["format"], "stopline.bench.spirals/1");
    assert_eq!((&first["seed"], &first["problems"], &first["verdict"]), (&7.into(), &60.into(), &"pass".into()));
    assert_eq!(first["hash"].as_str().unwrap().len(), 64);
    let other = timeless(&["--problems", "60", "--seed", "8"]);
    assert_ne!(first["hash"], other["hash"]);
}

#[test]
fn every_method_is_in_the_table_the_json_and_the_csv() {
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
    assert!(!headers.iter().any(|h| h.contains("_us") || h.contains("time")), "no clock in the table: {headers:?}");
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
fn the_pictures_of_the_page_are_what_the_program_draws() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let slalom = read_file(&root.join("maps/slalom.xml")).unwrap();
    let page = std::fs::read_to_string(root.join("docs/geometry.md")).unwrap();
    let drawn = pictures(&slalom, &load("bmw_320i").unwrap());
    assert_eq!(drawn.len(), 6);
    for (name, svg) in drawn {
        let kept = std::fs::read_to_string(root.join("docs/geometry").join(name)).unwrap_or_default();
        assert!(
            kept == svg,
            "docs/geometry/{name} is not what the program draws now; look at the new one and keep it: \
             cargo run --release --example geometry_page"
        );
        assert!(page.contains(&format!("(geometry/{name})")), "{name} is not on the page");
    }
}
