//! The command line: each exit code, each wrong input by itself, each output.

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;

/// An empty road of 100 m, 50 km/h.
const ROAD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/maps/straight_100m.xml");

/// A temporary folder in which the program runs.
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

    /// Runs the program with a text on standard input.
    fn run_with(&self, arguments: &[&str], stdin: impl Into<Vec<u8>>) -> Output {
        let mut program = Command::cargo_bin("stopline").unwrap();
        program.current_dir(self.folder.path()).args(arguments).write_stdin(stdin).output().unwrap()
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

/// Asserts the exit code and an error on stderr with all the words; stdout is empty and nothing panicked.
#[track_caller]
fn fails(output: &Output, code: i32, words: &[&str]) {
    let message = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{message}");
    for word in words {
        assert!(message.contains(word), "\"{word}\" is missing in: {message}");
    }
    assert_eq!(stdout(output), "", "errors go to stderr");
    assert!(!message.contains("panicked"), "{message}");
    assert!(message.lines().all(|line| line.len() < 400), "a number is printed with all its digits: {message}");
}

/// The road with the first occurrence of a text replaced.
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
fn help_lists_the_exit_codes() {
    let place = Place::new();
    for arguments in [["--help"].as_slice(), &["drive", "--help"], &["plan", "-h"]] {
        let output = place.run(arguments);
        assert_eq!(output.status.code(), Some(0));
        let text = stdout(&output);
        for line in ["Exit codes:", "0  ", "1  ", "2  ", "3  ", "4  "] {
            assert!(text.contains(line), "{arguments:?} does not list {line}");
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
    fails(&place.run(&[]), 2, &["Usage"]);
    fails(&place.run(&["fly"]), 2, &["fly"]);
    fails(&place.run(&["drive"]), 2, &["SCENARIO"]);
    fails(&place.run(&["drive", ROAD, "--fast"]), 2, &["--fast"]);
    fails(&place.run(&["drive", ROAD, "--seed=-1"]), 2, &["--seed"]);
    for threads in ["0", "many", "100000"] {
        fails(&place.run(&["drive", ROAD, "--threads", threads]), 2, &["--threads"]);
    }
    fails(&place.run(&["drive", ROAD, "--csv", "a", "--svg", "a"]), 2, &["a", "twice"]);
    fails(&place.run(&["plan", ROAD, "--csv", "a", "--svg", "./a"]), 2, &["./a", "twice"]);
    fails(&place.run(&["plan", ROAD, "--json", "-", "--csv", "-"]), 2, &["stdout"]);
    assert_eq!(place.names(), Vec::<String>::new());
}

#[test]
fn a_value_out_of_range_names_its_flag() {
    let place = Place::new();
    let wrong = [
        ("--inject", "rain=1", "delay, friction, mass, noise, missed_cycles"),
        ("--inject", "mas=1", "did you mean `mass`?"),
        ("--inject", "mass=-1", "mass must be from 0.1 to 10"),
        ("--inject", "friction=-1", "friction must be from 0.01 to 2"),
        ("--inject", "delay=1e300", "delay must be from 0 to 2 s"),
        ("--comfort", "iso", "iso15622"),
        ("--comfort", "iso1562", "did you mean `iso15622`?"),
        ("--fallbacks", "often", "from 0.05 to 3600 s, or off"),
        ("--fallbacks", "0", "from 0.05 to 3600 s, or off"),
        ("--fallbacks", "0.001", "from 0.05 to 3600 s, or off"),
        ("--fallbacks", "1e300", "from 0.05 to 3600 s, or off"),
        ("--seed", "-1", "a whole number from 0 to 18446744073709551615"),
        ("--seed", "18446744073709551616", "a whole number from 0 to 18446744073709551615"),
        ("--seed", "1e300", "a whole number from 0"),
        ("--threads", "-1", "a whole number from 1 to 1024"),
        ("--threads", "1.5", "a whole number from 1 to 1024"),
        ("--problem", "first", "the id of a planning problem"),
        ("--inject", "missed_cycles=99999999999", "a whole number from 0 to 10000"),
        ("--sensor", "seed=-1", "a whole number from 0 to 18446744073709551615"),
        ("--sensor", "fov=400", "fov must be from 0 to 360 degrees"),
        ("--sensor", "range=10,range=20", "`range` is given twice; expected each name once"),
        ("--sensor", "occlusion,fov=90,occlusion=off", "`occlusion` is given twice"),
    ];
    for (flag, value, expected) in wrong {
        for arguments in [vec![format!("{flag}={value}")], vec![flag.to_owned(), value.to_owned()]] {
            let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
            fails(&place.run(&[&["drive", ROAD], arguments.as_slice()].concat()), 2, &[flag, value, expected]);
        }
        let output = place.run(&["drive", ROAD, &format!("{flag}={value}")]);
        assert!(!stderr(&output).contains("verdict."), "names a key: {}", stderr(&output));
    }
}

#[test]
fn a_fault_that_is_given_twice_is_wrong_use() {
    let place = Place::new();
    let twice = ["--inject", "mass=1.1", "--inject", "delay=0.1", "--inject", "mass=1.2"];
    for command in [["drive", ROAD].as_slice(), &["bench", "fallbacks", "--maps", "off", "--scenes", "1"]] {
        fails(
            &place.run(&[command, &twice].concat()),
            2,
            &["--inject: `mass` is given twice; expected each name once"],
        );
    }
}

#[test]
fn plan_refuses_the_flags_of_the_simulation() {
    let place = Place::new();
    let simulation: [&[&str]; 6] = [
        &["--inject", "mass=1.2"],
        &["--friction", "ice"],
        &["--fallbacks", "off"],
        &["--comfort", "r157"],
        &["--seed", "1"],
        &["--json", "a.json", "--json-cycles"],
    ];
    let help = stdout(&place.run(&["plan", "--help"]));
    for arguments in simulation {
        let flag = arguments.iter().rfind(|a| a.starts_with("--")).unwrap();
        let tip = format!("{flag} is a flag of `stopline drive`");
        fails(&place.run(&[&["plan", ROAD], arguments].concat()), 2, &[flag, &tip, "runs no simulation"]);
        assert!(!help.contains(flag), "the help of plan lists {flag}");
    }
    fails(&place.run(&["drive", ROAD, "--junit", "a"]), 2, &["--junit is a flag of `stopline check`"]);
    fails(&place.run(&["drive", ROAD, "--maps", "a"]), 2, &["--maps is a flag of `stopline bench fallbacks`"]);
    assert_eq!(place.names(), Vec::<String>::new());
}

#[test]
fn an_output_with_the_extension_of_another_format_is_wrong_use() {
    let place = Place::new();
    for (flag, name, expected) in [
        ("--svg", "x.png", "--svg writes SVG, not .png; did you mean x.svg?"),
        ("--svg", "x.PDF", "--svg writes SVG"),
        ("--json", "x.csv", "--json writes JSON"),
        ("--csv", "x.xlsx", "--csv writes CSV"),
        ("--solution", "x.json", "--solution writes XML"),
        ("--rrd", "x.svg", "--rrd writes a Rerun recording"),
    ] {
        for command in ["plan", "drive"] {
            fails(&place.run(&[command, ROAD, flag, name]), 2, &[flag, name, expected]);
        }
    }
    assert_eq!(place.names(), Vec::<String>::new());
    // other names are the user's choice
    let output = place.run(&["plan", ROAD, "--svg", "picture.of.run", "--csv", "states.txt"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(place.names(), ["picture.of.run", "states.txt"]);
}

#[test]
fn an_output_never_replaces_an_input() {
    let place = Place::new();
    let road = std::fs::read(ROAD).unwrap();
    let name = place.file("road.xml", &road);
    // the files that an input refers to are inputs: those of a vehicle, the image of a grid
    let vehicle = place.path("v");
    std::fs::create_dir(&vehicle).unwrap();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("vehicles/f1tenth");
    for file in ["vehicle.urdf", "dynamics.toml", "body.obj"] {
        std::fs::copy(folder.join(file), vehicle.join(file)).unwrap();
    }
    for file in ["v/dynamics.toml", "v/body.obj"] {
        fails(&place.run(&["plan", ROAD, "--vehicle", "v", "--json", file]), 2, &[file, "twice"]);
    }
    std::fs::write(place.path("g.pgm"), "P2 1 1 255 255").unwrap();
    let yaml = "image: g.pgm\nresolution: 1\norigin: [0, 900, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n";
    std::fs::write(place.path("g.yaml"), yaml).unwrap();
    fails(&place.run(&["plan", ROAD, "--grid", "g.yaml", "--json", "g.pgm"]), 2, &["g.pgm", "twice"]);
    fails(&place.run(&["plan", &name, "--solution", "./road.xml"]), 2, &["--solution ./road.xml", "twice"]);
    assert_eq!(std::fs::read(place.path("road.xml")).unwrap(), road);
}

#[cfg(not(feature = "rerun"))]
#[test]
fn a_recording_without_the_feature_is_wrong_use() {
    fails(&Place::new().run(&["plan", ROAD, "--rrd", "run.rrd"]), 2, &["--rrd", "rerun"]);
}

#[test]
fn exit_3_is_an_invalid_scenario() {
    let place = Place::new();
    let road = std::fs::read_to_string(ROAD).unwrap();
    let problem = part(&road, "<planningProblem", "</planningProblem>");
    let bad = [
        ("empty.xml", String::new(), "not XML"),
        ("text.xml", "once upon a time".into(), "not XML"),
        ("half.xml", road[..road.len() / 2].into(), "not XML"),
        ("note.xml", "<note></note>".into(), "<note>"),
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
        fails(&place.run(&["drive", &name]), 3, &[&name, word]);
    }
    fails(&place.run(&["drive", "missing.xml"]), 3, &["missing.xml"]);
    fails(&place.run(&["drive", "."]), 3, &["."]);
    let name = place.file("latin.xml", b"<commonRoad>\xe9</commonRoad>");
    fails(&place.run(&["drive", &name]), 3, &["latin.xml:1", "UTF-8"]);
}

#[test]
fn errors_name_the_line_and_the_element() {
    let place = Place::new();
    let road = std::fs::read_to_string(ROAD).unwrap();
    let bound = part(&road, "<leftBound>", "</leftBound>");
    let point = part(bound, "<point>", "</point>");
    let one = place.file("one.xml", road.replacen(bound, &format!("<leftBound>{point}</leftBound>"), 1));
    let line = 1 + road[..road.find(bound).unwrap()].matches('\n').count();
    fails(&place.run(&["plan", &one]), 3, &[&format!("one.xml:{line}"), "lanelet", "leftBound", "1 point"]);

    let obstacle = "<staticObstacle id=\"900\"><type>unknown</type><initialState><position><point><x>1</x><y>1</y></point>\
                    </position><orientation><exact>0</exact></orientation><time><exact>0</exact></time></initialState></staticObstacle>";
    let shapeless =
        place.file("shapeless.xml", road.replacen("<planningProblem", &format!("{obstacle}<planningProblem"), 1));
    fails(&place.run(&["plan", &shapeless]), 3, &["staticObstacle 900", "shape"]);
}

#[test]
fn a_file_of_another_kind_names_the_flag_or_command_that_reads_it() {
    let place = Place::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let in_repository = |path: &str| root.join(path).display().to_string();
    let suite = in_repository("maps/suite.toml");
    let osm = place.file("town.osm", "<?xml version=\"1.0\"?>\n<osm version=\"0.6\"></osm>");
    let opendrive = place.file("town.xodr", "<OpenDRIVE/>");
    let grid = place.file("g.yaml", "image: g.pgm\nresolution: 0.05\n");
    let image = place.file("g.pgm", "P2 1 1 255 255");
    let settings = place.file("settings.toml", "[planner]\ncruise_speed = 10.0\n");
    let patches = place.file("ice.toml", "[[friction]]\nfactor = 0.2\npolygon = [[0, 0], [1, 0], [1, 1]]\n");
    for (scenario, words) in [
        (suite.as_str(), ["a regression suite", "`stopline check` reads it"]),
        (&in_repository("maps"), ["folder of a regression suite", "`stopline check` reads it"]),
        (&in_repository("vehicles/truck"), ["folder of a vehicle", "--vehicle reads its folder"]),
        (&osm, ["a Lanelet2 or OpenStreetMap file", "no command of this version reads it"]),
        (&opendrive, ["an OpenDRIVE map", "no command of this version reads it"]),
        (&grid, ["an occupancy grid of ROS", "--grid reads it"]),
        (&image, ["a PGM image", "--grid reads the YAML file"]),
        (&settings, ["a settings file", "--config reads it"]),
        (&patches, ["friction patches", "with --friction"]),
    ] {
        for command in ["plan", "drive"] {
            fails(
                &place.run(&[command, scenario]),
                3,
                &[scenario, words[0], words[1], "expected a CommonRoad scenario"],
            );
        }
    }
    for (flag, file, words) in [
        ("--config", suite.as_str(), ["a regression suite", "expected settings in TOML"]),
        ("--config", ROAD, ["a CommonRoad scenario", "read it as SCENARIO"]),
        ("--config", &in_repository("vehicles/truck/dynamics.toml"), ["dynamics of a vehicle", "--vehicle"]),
        ("--grid", &image, ["a PGM image", "expected the YAML file"]),
        ("--grid", ROAD, ["a CommonRoad scenario", "expected the YAML file"]),
        ("--friction", &settings, ["a settings file", "--config reads it"]),
        ("--vehicle", ROAD, ["a CommonRoad scenario", "expected a built-in name"]),
    ] {
        fails(&place.run(&["drive", ROAD, flag, file]), 3, &[flag, file, words[0], words[1]]);
    }
}

#[test]
fn a_dash_reads_the_scenario_from_standard_input() {
    let place = Place::new();
    let road = std::fs::read(ROAD).unwrap();
    let of_file = place.run(&["plan", ROAD, "--json", "-"]);
    let of_stdin = place.run_with(&["plan", "-", "--json", "-"], road.clone());
    let hash = |output: &Output| -> Value {
        let result: Value =
            serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", stderr(output)));
        result["hash"].clone()
    };
    assert_eq!(hash(&of_file), hash(&of_stdin));
    let driven = place.run_with(&["drive", "-", "--quiet"], road.clone());
    assert_eq!(driven.status.code(), Some(0), "{}", stderr(&driven));
    fails(&place.run_with(&["plan", "-"], &road[..road.len() / 2]), 3, &["<stdin>:", "not XML"]);
    // the same encodings as those of a file
    let utf16: Vec<u8> = [0xfeff]
        .into_iter()
        .chain(String::from_utf8(road.clone()).unwrap().encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    assert_eq!(hash(&place.run_with(&["plan", "-", "--json", "-"], utf16)), hash(&of_file));
    fails(&place.run_with(&["drive", "-"], b"\x89PNG\r\n".as_slice()), 3, &["<stdin>", "a PNG image"]);
    fails(&place.run_with(&["drive", "-"], ""), 3, &["<stdin>", "not XML"]);
    fails(&place.run_with(&["plan", "-"], "<osm/>"), 3, &["<stdin>", "a Lanelet2 or OpenStreetMap file"]);
    fails(&place.run_with(&["plan", "-"], b"<commonRoad>\xe9".as_slice()), 3, &["<stdin>", "UTF-8"]);
}

#[test]
fn a_start_off_the_road_and_an_unreachable_goal_say_where() {
    let place = Place::new();
    let road = std::fs::read_to_string(ROAD).unwrap();
    let problem = part(&road, "<planningProblem", "</planningProblem>");
    let (start, goal) =
        (part(problem, "<initialState>", "</initialState>"), part(problem, "<goalState>", "</goalState>"));
    let y = |state: &str, y: f64| state.replacen(part(state, "<y>", "</y>"), &format!("<y>{y}</y>"), 1);
    let region = "<position><rectangle><length>4</length><width>2</width><center><x>50</x><y>300</y></center></rectangle></position>";
    let far_goal = goal.replacen(part(goal, "<position>", "</position>"), region, 1);
    for (name, text, code, words) in [
        (
            "start.xml",
            road.replacen(start, &y(start, -40.0), 1),
            "start_off_road",
            ["the start at (", "m from the nearest lanelet"],
        ),
        (
            "goal.xml",
            road.replacen(goal, &far_goal, 1),
            "goal_unreachable",
            ["the goal at (50.0, 300.0)", "nearest is lanelet"],
        ),
    ] {
        let name = place.file(name, text);
        for command in ["plan", "drive"] {
            let output = place.run(&[command, &name]);
            let report = stdout(&output);
            assert_eq!(output.status.code(), Some(1), "{report}{}", stderr(&output));
            assert!(report.lines().next().unwrap().ends_with(": no_safe_plan, FAIL"), "{report}");
            assert!(report.contains(&format!("reason: {code}: {}", words[0])) && report.contains(words[1]), "{report}");
            let output = place.run(&[command, &name, "--json", "-"]);
            let result: Value = serde_json::from_slice(&output.stdout).unwrap();
            assert_eq!(result["reason"], code);
            assert!(report.contains(result["reason_detail"].as_str().unwrap()), "{result:#}");
        }
    }
}

#[test]
fn one_of_several_problems_is_chosen_by_id() {
    let place = Place::new();
    let road = std::fs::read_to_string(ROAD).unwrap();
    let problem = part(&road, "<planningProblem", "</planningProblem>");
    let id = part(problem, "id=\"", "\">").trim_start_matches("id=\"").trim_end_matches("\">");
    let second = problem.replacen(&format!("id=\"{id}\""), "id=\"7777\"", 1);
    let name = place.file("two.xml", road.replace(problem, &format!("{problem}{second}")));
    fails(&place.run(&["plan", &name]), 3, &[id, "7777", "--problem"]);
    fails(&place.run(&["plan", &name, "--problem", "5"]), 3, &["--problem 5", "no planning problem 5", "7777"]);
    let output = place.run(&["plan", &name, "--problem", "7777", "--json", "-"]);
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(result["problem"], 7777);
}

/// A recording that contains the recorded vehicle: it is named, and left out if asked for. A car two metres ahead is none.
#[test]
fn the_recorded_ego_is_named_and_left_out() {
    let place = Place::new();
    let state = |x: f64, step: u32| {
        format!(
            "<position><point><x>{x}</x><y>0</y></point></position><orientation><exact>0</exact></orientation>\
             <time><exact>{step}</exact></time><velocity><exact>5</exact></velocity>"
        )
    };
    let with_car = |x: f64| {
        let (first, then) = (state(x, 0), state(x + 50.0, 100));
        let car = format!(
            "<dynamicObstacle id=\"14503\"><type>car</type><shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>\
             <initialState>{first}</initialState><trajectory><state>{then}</state></trajectory></dynamicObstacle>"
        );
        road_with("<planningProblem", &format!("{car}<planningProblem"))
    };
    let (ego, other) = (place.file("ego.xml", with_car(10.0)), place.file("other.xml", with_car(12.0)));
    let run = |arguments: &[&str]| {
        let output = place.run(&[arguments, &["--json", "-"]].concat());
        let result: Value = serde_json::from_slice(&output.stdout).unwrap();
        (result["reason"].clone(), stderr(&output))
    };
    let named = "dynamicObstacle 14503: is exactly where problem 1 starts: the recorded ego?";
    for command in ["plan", "drive"] {
        let (reason, warnings) = run(&[command, &ego]);
        assert_eq!(reason, "start_in_collision", "{command}");
        assert!(warnings.contains(named), "{command}: {warnings}");
        for flags in [&["--without-recorded-ego"][..], &["--without", "14503"]] {
            let (reason, warnings) = run(&[&[command, ego.as_str()], flags].concat());
            assert_eq!(reason, Value::Null, "{command} {flags:?}");
            assert!(warnings.contains("obstacle 14503: left out as asked for"), "{command} {flags:?}: {warnings}");
        }
        let (reason, warnings) = run(&[command, &other, "--without-recorded-ego"]);
        assert_eq!(reason, "start_in_collision", "{command}: a car that is not the ego stays");
        assert!(!warnings.contains("14503"), "{command}: {warnings}");
    }
    fails(&place.run(&["plan", &ego, "--without", "7"]), 3, &["--without 7", "ego.xml has no obstacle 7"]);
    fails(&place.run(&["plan", &ego, "--without", "x"]), 2, &["--without", "the id of an obstacle"]);
}

#[test]
fn exit_3_is_an_invalid_vehicle_or_settings_file() {
    let place = Place::new();
    fails(&place.run(&["plan", ROAD, "--vehicle", "hovercraft"]), 3, &["--vehicle hovercraft", "bmw_320i"]);
    for (typed, meant) in
        [("bmw320i", "bmw_320i"), ("BMW_320i", "bmw_320i"), ("Truck", "truck"), ("f1tenht", "f1tenth")]
    {
        let expected = format!("did you mean `{meant}`?");
        fails(&place.run(&["plan", ROAD, "--vehicle", typed]), 3, &["--vehicle", typed, &expected]);
    }
    std::fs::create_dir(place.path("car")).unwrap();
    fails(&place.run(&["plan", ROAD, "--vehicle", "car"]), 3, &["car"]);
    let settings = [
        ("bad.toml", "[planner\n", "bad.toml"),
        ("typo.toml", "[planner]\n\ncruise_sped = 3.0\n", "cruise_sped"),
        ("text.toml", "[planner]\ncruise_speed = \"fast\"\n", "line 2"),
        ("range.toml", "[run]\nreplan_interval = 0.0\n", "replan_interval"),
        ("nan.toml", "[planner]\ncruise_speed = nan\n", "cruise_speed"),
        ("friction.toml", "[simulation]\nfriction_scale = 0.0\n", "simulation.friction_scale"),
        ("huge.toml", "[run]\nlongest = 1e300\n", "`run.longest` is 1e300"),
        ("near.toml", "[planner.collision]\nroad = -1.0\n", "planner.collision.road"),
        (
            "straight.toml",
            "[planner.lattice]\nheadings = []\n",
            "`planner.lattice.headings` has 0 entries, it must have from 1 to 9",
        ),
    ];
    for (name, text, word) in settings {
        let name = place.file(name, text);
        fails(&place.run(&["plan", ROAD, "--config", &name]), 3, &["--config", &name, word]);
    }
    for (flag, name) in [("--config", "missing.toml"), ("--grid", "missing.yaml")] {
        fails(&place.run(&["plan", ROAD, flag, name]), 3, &[&format!("{flag} {name}"), "cannot be read"]);
    }
    fails(&place.run(&["plan", ROAD, "--config", &place.file("latin.toml", b"a = \"\xe9\"")]), 3, &["latin.toml"]);
}

#[test]
fn friction_is_a_surface_a_factor_or_a_file_of_patches() {
    let place = Place::new();
    for (value, hint) in [
        ("-0.5", ""),
        ("0", ""),
        ("nan", ""),
        ("1e300", ""),
        ("snow", ""),
        ("60%", "60% is the factor 0.6"),
        ("wett", "did you mean `wet`?"),
        ("Ice", "did you mean `ice`?"),
    ] {
        let allowed = ["--friction", value, "dry, wet, ice", "a factor above 0 and at most 10", "a TOML file", hint];
        fails(&place.run(&["drive", ROAD, "--friction", value]), 2, &allowed);
    }
    for missing in ["missing.toml", "roads/ice"] {
        let output = place.run(&["drive", ROAD, "--friction", missing]);
        fails(&output, 3, &[&format!("--friction {missing}"), "cannot be read"]);
    }
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
        fails(&place.run(&["drive", ROAD, "--friction", &name]), 3, &["--friction", &name, word]);
        fails(&place.run(&["plan", ROAD, "--config", &name]), 3, &[&name, word]);
    }
    fails(&place.run(&["drive", ROAD, "--friction", "road.toml", "--json", "road.toml"]), 2, &["road.toml"]);
    let hash = |arguments: &[&str]| {
        let arguments = [&["drive", ROAD, "--json", "-"], arguments].concat();
        let result: Value = serde_json::from_slice(&place.run(&arguments).stdout).unwrap();
        result["hash"].clone()
    };
    let ice = place.file("ice.toml", region("\"ice\"", square));
    let dry = hash(&[]);
    assert_eq!(dry, hash(&["--friction", "dry"]));
    assert_eq!(dry, hash(&["--friction", "1"]));
    assert_ne!(dry, hash(&["--friction", "ice"]), "ice has no effect");
    assert_ne!(dry, hash(&["--friction", &ice]), "a patch of ice has no effect");
    assert_eq!(dry, hash(&["--config", &ice, "--friction", "dry"]), "dry applies to the whole road");
    let result: Value =
        serde_json::from_slice(&place.run(&["drive", ROAD, "--json", "-", "--friction", &ice]).stdout).unwrap();
    let friction = &result["friction"];
    assert_eq!((&friction["scale"], &friction["patches"][0]["factor"]), (&1.0.into(), &0.15.into()));
}

#[test]
fn exit_3_is_an_output_that_cannot_be_written() {
    let place = Place::new();
    for option in ["--json", "--csv", "--solution", "--svg"] {
        let named = format!("{option} none/out");
        let missing = [&named, "cannot be written: there is no folder none"];
        fails(&place.run(&["drive", ROAD, option, "none/out"]), 3, &missing);
        fails(&place.run(&["plan", ROAD, option, "out/"]), 3, &[option, "out/", "is the name of a folder"]);
        fails(&place.run(&["drive", ROAD, option, "."]), 3, &[option, "cannot be written"]);
    }
    fails(&place.run(&["drive", ROAD, "--svg", "fine.svg", "--json", "none/out"]), 3, &["none/out"]);
    assert_eq!(place.names(), Vec::<String>::new(), "no file is left behind");
}

/// Asserts the documented keys of a JSON result.
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
            ("status", ["pass", "fail", "not_applicable"].iter().any(|s| check["status"] == *s)),
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
fn exit_0_is_a_drive_that_passes() {
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
    let report = stdout(&output);
    assert!(report.lines().next().unwrap().ends_with(": goal_reached, PASS"), "{report}");
    for part in ["no_contact            PASS", "distance  ", "planning: ", "solution: ", "hash: "] {
        assert!(report.contains(part), "\"{part}\" is missing in: {report}");
    }
    assert!(!report.contains("FAIL"), "{report}");
    assert_eq!(place.names(), ["run.csv", "run.json", "run.svg", "run.xml"], "and no temporary files");

    let result: Value = serde_json::from_slice(&std::fs::read(place.path("run.json")).unwrap()).unwrap();
    is_sound_result(&result, "stopline.drive/2");
    assert_eq!((&result["verdict"], &result["seed"]), (&Value::from("pass"), &Value::from(5)));
    assert!(result["checks"].as_array().unwrap().iter().all(|c| c["status"] != "fail"));
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
fn json_on_stdout_is_one_object() {
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
    assert_eq!(stderr(&output), "", "no progress bar without a terminal");
}

/// Asserts the documented keys of a list of candidates; returns their number in each state.
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
            "missed_target",
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
fn robust_cycles_are_counted_only_if_reachable_sets_are_enabled() {
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
    assert!(planned("preferred").1.contains("robust, proven for the reachable sets of other traffic: 1 of 1"));
    assert!(!planned("off").1.contains("reachable sets"));
}

#[test]
fn plan_lists_candidates_with_cost_terms_and_rejections() {
    let place = Place::new();
    let parked = concat!(env!("CARGO_MANIFEST_DIR"), "/maps/parked_car.xml");
    let output = place.run(&["plan", parked, "--json", "-"]);
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    let states = are_sound_candidates(&result["candidates"]);
    assert_eq!(states["chosen"], 1, "{states:?}");
    for (code, count) in result["planning"]["rejections"].as_object().unwrap() {
        assert_eq!(states.get(code).copied().unwrap_or(0), count.as_u64().unwrap(), "{code} of {states:?}");
    }
    let chosen = result["candidates"].as_array().unwrap().iter().find(|c| c["rejected"].is_null()).unwrap();
    let cost = |c: &Value| c["cost"].as_f64().unwrap();
    let higher = result["candidates"].as_array().unwrap().iter().filter(|c| c["rejected"] == "higher_cost");
    assert!(higher.clone().count() > 0 && higher.clone().all(|c| cost(c) >= cost(chosen) - 1e-6));
}

/// At 19.6 m/s, 20 m before an obstacle that covers half of the lane: no stop is proven, the vehicle evades.
#[test]
fn higher_cost_has_a_cheaper_candidate_in_the_same_attempt_also_without_a_proof() {
    let place = Place::new();
    let obstacle = "<staticObstacle id=\"900\"><type>unknown</type><shape><rectangle><length>1</length><width>2.67</width></rectangle>\
                    </shape><initialState><position><point><x>29.7</x><y>-1.97</y></point></position><orientation><exact>0</exact>\
                    </orientation><time><exact>0</exact></time></initialState></staticObstacle><planningProblem";
    let road = road_with("<planningProblem", obstacle).replacen("<velocity><exact>5<", "<velocity><exact>19.6<", 1);
    let name = place.file("evade.xml", road);
    let output = place.run(&["drive", &name, "--fallbacks", "off", "--json", "-", "--json-cycles"]);
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut evading = 0;
    for cycle in result["cycles"].as_array().unwrap() {
        let candidates = cycle["candidates"].as_array().unwrap();
        let summary = cycle["summary"].as_str().unwrap();
        for higher in candidates.iter().filter(|c| c["rejected"] == "higher_cost") {
            let is_cheaper = |c: &&Value| {
                let is_best = c["rejected"].is_null() || c["rejected"] == "below_switching_threshold";
                is_best && c["attempt"] == higher["attempt"] && c["cost"].as_f64() <= higher["cost"].as_f64()
            };
            assert!(candidates.iter().any(|c| is_cheaper(&c)), "{summary}: {higher}");
            if cycle["decision"] == "unproven" {
                evading += 1;
                assert!(summary.contains("evades on lane 0") && !summary.contains("higher_cost"), "{summary}");
            }
        }
    }
    assert!(evading > 0, "no cycle evades without a proof");
}

#[test]
fn json_cycles_lists_every_cycle_and_keeps_the_hash() {
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
        assert!(["new_plan", "keep_previous", "continue", "unproven"].contains(&decision), "{decision}");
        assert_eq!(
            states.get("chosen").copied().unwrap_or(0),
            u64::from(decision == "new_plan"),
            "{decision} {states:?}"
        );
        assert_eq!(cycle["deceleration_mps2"].is_number(), decision != "unproven");
        assert!(cycle["time_s"].is_number() && cycle["expansions"].is_u64());
        total += states.values().sum::<u64>();
        rejected += states.iter().filter(|(state, _)| *state != "chosen").map(|(_, n)| n).sum::<u64>();
    }
    assert_eq!(total, long["planning"]["candidates"].as_u64().unwrap());
    let counted: u64 = long["planning"]["rejections"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(rejected, counted);
    fails(&place.run(&["drive", ROAD, "--json-cycles"]), 2, &["--json"]);
}

#[test]
fn quiet_prints_nothing() {
    let place = Place::new();
    let output = place.run(&["plan", ROAD, "--quiet"]);
    assert_eq!((output.status.code(), stdout(&output), stderr(&output)), (Some(0), String::new(), String::new()));
}

#[test]
fn issues_of_the_scenario_are_on_stderr_and_in_the_json() {
    let place = Place::new();
    let name = place.file("odd.xml", road_with("<lanelet ", "<weather/><lanelet "));
    let output = place.run(&["plan", &name, "--json", "-"]);
    assert!(stderr(&output).contains("odd.xml: 1 issue") && stderr(&output).contains("weather"), "{}", stderr(&output));
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(result["issues"][0]["element"].as_str().unwrap().contains("weather"));
    assert!(result["issues"][0]["line"].as_u64().unwrap() > 0);
}

#[test]
fn a_grid_beside_the_road_is_an_issue() {
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
        let message = stderr(&output);
        assert_eq!(message.contains("occupancy grid g.yaml: lies beside the road"), issues == 1, "{message}");
    }
}

/// The hash of a run of the road.
fn hash(place: &Place, arguments: &[&str]) -> String {
    let output = place.run(&[&["drive", ROAD, "--json", "-"], arguments].concat());
    let result: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", stderr(&output)));
    result["hash"].as_str().unwrap().to_owned()
}

#[test]
fn the_hash_does_not_depend_on_threads_or_outputs() {
    let place = Place::new();
    let first = hash(&place, &["--threads", "1"]);
    assert_eq!(hash(&place, &["--threads", "2"]), first);
    assert_eq!(hash(&place, &["--svg", "run.svg", "--solution", "run.xml"]), first, "outputs do not change the hash");
    assert_ne!(hash(&place, &["--seed", "1"]), first, "the seed is part of the result");
}

#[test]
fn faults_comfort_and_fallbacks_are_in_the_json() {
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
    assert_eq!(check(&missed, "fallback_stops").unwrap()["status"], "not_applicable");
    let strict = result(&["--comfort", "iso11270", "--fallbacks", "5"]);
    assert_eq!(check(&strict, "comfort_lateral_jerk").unwrap()["limit"], 5.0);
    assert!(check(&strict, "comfort_jerk").unwrap()["note"].as_str().unwrap().contains("iso11270"));
}

#[test]
fn exit_1_is_a_check_that_failed() {
    let place = Place::new();
    let road = std::fs::read_to_string(ROAD).unwrap();
    // a wall across the road, 1.7 m ahead of the bumper: the vehicle cannot stop before it from its initial speed
    let start = part(&road, "<planningProblem", "</planningProblem>");
    let x: f64 = part(start, "<x>", "</x>").trim_start_matches("<x>").trim_end_matches("</x>").parse().unwrap();
    let wall = format!(
        "<staticObstacle id=\"900\"><type>unknown</type><shape><rectangle><length>1</length><width>40</width></rectangle></shape>\
         <initialState><position><point><x>{}</x><y>0</y></point></position><orientation><exact>0</exact></orientation>\
         <time><exact>0</exact></time></initialState></staticObstacle>",
        x + 4.5
    );
    let name = place.file("wall.xml", road.replacen("<planningProblem", &format!("{wall}<planningProblem"), 1));
    for command in ["plan", "drive"] {
        let output = place.run(&[command, &name, "--json", "-"]);
        assert_eq!(output.status.code(), Some(1), "{command}: {}{}", stdout(&output), stderr(&output));
        let result: Value = serde_json::from_slice(&output.stdout).unwrap();
        is_sound_result(&result, &format!("stopline.{command}/2"));
        assert_eq!(result["verdict"], "fail");
        let report = stdout(&place.run(&[command, &name]));
        assert!(report.lines().next().unwrap().ends_with(", FAIL"), "{report}");
        for check in result["checks"].as_array().unwrap().iter().filter(|c| c["status"] == "fail") {
            let (check, note) = (check["name"].as_str().unwrap(), check["note"].as_str().unwrap());
            let line = note.lines().next().unwrap_or_default();
            assert!(report.contains(&format!("FAIL {check}: {line}")), "{report}");
        }
    }
}

#[test]
fn completions_are_printed_for_every_shell() {
    let place = Place::new();
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let output = place.run(&["completions", shell]);
        let script = stdout(&output);
        assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
        for word in ["stopline", "drive", "friction", "completions"] {
            assert!(script.contains(word), "{shell} has no {word}");
        }
    }
    fails(&place.run(&["completions", "tcsh"]), 2, &["tcsh", "bash", "zsh"]);
}

#[test]
fn manual_pages_have_the_flags_of_each_command() {
    let place = Place::new();
    let page = stdout(&place.run(&["man"]));
    assert!(page.contains(".TH stopline 1") && page.contains("drive") && page.contains("Exit codes"), "{page}");
    let output = place.run(&["man", "--out", "pages/man1"]);
    assert_eq!((output.status.code(), stdout(&output)), (Some(0), String::new()), "{}", stderr(&output));
    let read = |name: &str| std::fs::read_to_string(place.path("pages/man1").join(name)).unwrap();
    assert_eq!(read("stopline.1"), page);
    assert!(read("stopline-drive.1").contains("\\-\\-friction"));
    assert!(!read("stopline-plan.1").contains("\\-\\-friction"));
    assert!(read("stopline-bench-spirals.1").contains("\\-\\-problems"));
    let file = place.file("file", "");
    fails(&place.run(&["man", "--out", &file]), 3, &["--out file"]);
}

#[cfg(unix)]
#[test]
fn a_closed_pipe_is_no_fault() {
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
fn a_device_takes_several_outputs() {
    if Path::new("/dev/null").exists() {
        let output = Place::new().run(&["plan", ROAD, "--csv", "/dev/null", "--svg", "/dev/null"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    }
}
