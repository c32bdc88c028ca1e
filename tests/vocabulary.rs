//! One vocabulary: the program, its docs and its code use the standard terms of the field.
//!
//! Each row of [`TERMS`] is a word that earlier versions used, with the term that replaced it. Text matches case-insensitively
//! and at word boundaries; an underscore is part of a word.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// Words that are not used, and what to write instead.
const TERMS: &[(&str, &str)] = &[
    ("dearer", "higher cost"),
    ("in_force", "below_switching_threshold (the reason), committed plan (the thing)"),
    ("in force", "committed, active"),
    ("refuted", "reverification failed"),
    ("too_sharp", "curve_speed_infeasible"),
    ("no_room", "blocked_at_start"),
    ("keep_last", "keep_previous"),
    ("rung", "level"),
    ("rungs", "levels"),
    ("wanted", "reference, setpoint, desired"),
    ("rig", "vehicle simulation"),
    ("rigs", "vehicle simulations"),
    ("at rest", "stopped, at a standstill"),
    ("to rest", "to standstill"),
    ("its rest", "its standstill"),
    ("at_rest", "standstill"),
    ("forked", "branched"),
    ("forks", "branches"),
    ("told", "reported"),
    ("tells", "reports, says"),
    ("comes to", "results in"),
    ("came to", "resulted in"),
    ("of its own", "separate, its"),
    ("of their own", "separate, their"),
    ("for ever", "forever, indefinitely"),
    ("taken as", "assumed to be"),
    ("taken for", "assumed to be"),
    ("taken to", "assumed to"),
    ("faults on purpose", "fault injection"),
    ("on purpose", "deliberately"),
    ("side by side", "in parallel"),
    ("guide_caps", "target_speed_limits"),
    ("outlook", "inevitable collision state"),
    ("doubtful", "provisional"),
];

/// Words that only the text for people is searched for: in code they have other uses.
const PROSE: &[(&str, &str)] = &[
    ("held", "passed"),
    ("bless", "update the baseline"),
    ("blessed", "updated"),
    ("way", "distance, path, road, method"),
    ("figures", "metrics, values (a picture is a figure: name it so in the allowed list)"),
];

/// Established terms that contain a word of the list.
const ALLOWED: &[&str] = &[
    "in its way",
    "in the way",
    "on the way",
    "the other way",
    "right of way",
    "right-of-way",
    "give way",
    "gives way",
    "giving way",
    "one-way",
    "by the way",
    "half way",
    "halfway",
    "three figures",
    "paper's figures",
    "figures of the safetlp paper",
    "figures of the paper",
    "either way",
    "other way round",
    "way round",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Whether the term starts and ends at word boundaries at that place.
fn is_whole(text: &str, at: usize, term: &str) -> bool {
    let in_word = |c: char| c.is_alphanumeric() || c == '_';
    let before = text[..at].chars().next_back();
    let after = text[at + term.len()..].chars().next();
    !before.is_some_and(in_word) && !after.is_some_and(in_word)
}

/// Uses of a term in the text, as `name:line: term → replacement`.
fn uses(name: &str, text: &str, terms: &[(&str, &str)]) -> Vec<String> {
    let mut found = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let mut line = line.to_lowercase();
        for allowed in ALLOWED {
            line = line.replace(allowed, "");
        }
        for (term, replacement) in terms {
            if line.match_indices(term).any(|(at, _)| is_whole(&line, at, term)) {
                found.push(format!("{name}:{}: `{term}`: write {replacement}: {}", number + 1, line.trim()));
            }
        }
    }
    found
}

/// Files below a folder with one of the extensions, sorted.
fn files(folder: &Path, extensions: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if entry.is_dir() {
            found.extend(files(&entry, extensions));
        } else if entry.extension().is_some_and(|e| extensions.iter().any(|x| e == *x)) {
            found.push(entry);
        }
    }
    found.sort();
    found
}

fn uses_in_files(files: &[PathBuf], terms: &[(&str, &str)]) -> Vec<String> {
    let name = |path: &PathBuf| path.strip_prefix(root()).unwrap().display().to_string();
    files.iter().flat_map(|path| uses(&name(path), &std::fs::read_to_string(path).unwrap(), terms)).collect()
}

fn assert_none(found: &[String]) {
    assert!(found.is_empty(), "{} uses:\n{}", found.len(), found.join("\n"));
}

fn stopline(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_stopline")).args(arguments).current_dir(root()).output().unwrap();
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn a_use_is_found_at_word_boundaries_only() {
    let terms = &[("rung", "level")];
    assert_eq!(uses("a", "the Rung,\nwrung rung_ rungs", terms).len(), 1);
    assert_eq!(uses("a", "x\nrung", terms), ["a:2: `rung`: write level: rung"]);
}

#[test]
fn the_docs_use_the_standard_terms() {
    let mut pages = files(&root().join("docs"), &["md"]);
    pages.extend(files(&root().join("maps"), &["md", "xml", "toml"]));
    pages.extend(["README.md", "ARCHITECTURE.md"].map(|name| root().join(name)));
    let mut found = uses_in_files(&pages, TERMS);
    found.extend(uses_in_files(&pages, PROSE));
    assert_none(&found);
}

#[test]
fn the_code_uses_the_standard_terms() {
    let mut sources = files(&root().join("src"), &["rs"]);
    for folder in ["examples", "benches", "vehicles"] {
        sources.extend(files(&root().join(folder), &["rs", "toml", "urdf"]));
    }
    assert_none(&uses_in_files(&sources, TERMS));
}

#[test]
fn the_help_uses_the_standard_terms() {
    for command in [
        &[][..],
        &["plan"],
        &["drive"],
        &["check"],
        &["bench"],
        &["bench", "fallbacks"],
        &["bench", "safetlp"],
        &["bench", "spirals"],
    ] {
        let help = stopline(&[command, &["--help"]].concat());
        assert!(help.contains("Exit codes"), "{command:?}: {help}");
        let name = format!("stopline {} --help", command.join(" "));
        assert_none(&[uses(&name, &help, TERMS), uses(&name, &help, PROSE)].concat());
    }
}

/// All keys and texts of a JSON value.
fn words(value: &Value, found: &mut String) {
    match value {
        Value::String(text) => found.extend([text.as_str(), "\n"]),
        Value::Array(items) => items.iter().for_each(|item| words(item, found)),
        Value::Object(map) => map.iter().for_each(|(key, item)| {
            found.extend([key.as_str(), "\n"]);
            words(item, found);
        }),
        _ => (),
    }
}

#[test]
fn the_outputs_use_the_standard_terms() {
    for map in ["maps/lane_blocked.xml", "maps/slow_lead.xml"] {
        for command in
            [&["drive", map, "--json", "-", "--json-cycles"][..], &["plan", map, "--json", "-"], &["drive", map]]
        {
            let text = stopline(command);
            let mut said = String::new();
            match serde_json::from_str(&text) {
                Ok(json) => words(&json, &mut said),
                Err(_) => said.clone_from(&text),
            }
            assert!(said.lines().count() > 10, "{command:?}: {text}");
            let name = command.join(" ");
            assert_none(&[uses(&name, &said, TERMS), uses(&name, &said, PROSE)].concat());
        }
    }
}
