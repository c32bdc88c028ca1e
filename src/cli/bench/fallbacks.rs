//! `stopline bench fallbacks`: the table, the JSON and the CSV of broken proofs.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::{all_pass, check_json, check_table};
use crate::bench::fallbacks::{FallbackBench, GRAVE, LESSER, Map, Options, SURFACES, SceneResult, run as measure};
use crate::cli::args::FallbackArgs;
use crate::cli::job::{Outputs, wrong_vehicle};
use crate::cli::{Exit, Failure, json as result, print, progress, report};
use crate::drive::{Faults, Settings};
use crate::io::{commonroad, files};
use crate::number::Short;
use crate::vehicle;

/// Scenes with a failed branch that the report lists.
const LISTED: usize = 20;
/// Where the bundled maps are, from the folder of the project.
const MAPS: &str = "maps";

/// Checks the outputs, measures, writes, reports.
pub(super) fn run(args: FallbackArgs) -> Result<Exit, Failure> {
    let outputs = Outputs { json: args.json, csv: args.csv, ..Outputs::default() };
    outputs.check(&[])?;
    let names: Vec<&str> = match &args.vehicle {
        Some(name) => vec![name],
        None => vehicle::builtin_names().to_vec(),
    };
    let load = |name: &&str| vehicle::load(name).map_err(|e| wrong_vehicle(name, &e));
    let vehicles = names.iter().map(load).collect::<Result<Vec<_>, _>>()?;
    let maps = maps(args.maps.as_deref())?;
    let problems: usize = maps.iter().map(|map| map.scenario.problems.len()).sum();
    let each = args.scenes + problems as u64;
    if each == 0 {
        return Err(Failure::Use("nothing to run: --scenes is 0, and there are no maps (--maps FOLDER)".into()));
    }
    let mut faults = Faults::default();
    faults.inject_all(&args.inject).map_err(|e| Failure::Use(format!("--inject: {e}")))?;
    let options = Options { seed: args.seed, scenes: args.scenes, first: args.first, interval: args.interval, faults };
    let bar = progress::bar(!args.quiet);
    let all = each * (vehicles.len() * SURFACES.len()) as u64;
    bar.set_length(all);
    bar.set_message(format!("of {all} scenes"));
    let measured = measure(&vehicles, &maps, &Settings::default(), &options, &|done| bar.set_position(done as u64));
    bar.finish_and_clear();
    let measured = measured.map_err(|e| Failure::Use(e.to_string()))?;
    let value = to_json(&measured, &options);
    if let Some(path) = outputs.json.as_ref().filter(|_| !outputs.json_on_stdout()) {
        files::write_atomic(path, result::text(&value).as_bytes()).map_err(Failure::file)?;
    }
    if let Some(path) = &outputs.csv {
        files::write_atomic(path, to_csv(&measured).as_bytes()).map_err(Failure::file)?;
    }
    if outputs.json_on_stdout() {
        print(&result::text(&value))?;
    } else if !args.quiet {
        print(&text(&measured))?;
    }
    Ok(if all_pass(&measured.checks()) { Exit::Pass } else { Exit::CheckFailed })
}

/// The maps of a folder by name, by default those in [`MAPS`] if there is such a folder.
fn maps(folder: Option<&Path>) -> Result<Vec<Map>, Failure> {
    let folder = match folder {
        Some(off) if off == Path::new("off") => return Ok(Vec::new()),
        Some(folder) => folder,
        None if Path::new(MAPS).is_dir() => Path::new(MAPS),
        None => return Ok(Vec::new()),
    };
    let wrong = |what: &dyn std::fmt::Display| {
        let expected = "expected a folder of scenarios (*.xml), or off";
        Failure::File(format!("--maps {}: {what}; {expected}", folder.display()))
    };
    let unreadable = |e| wrong(&format!("cannot be read: {e}"));
    let entries = std::fs::read_dir(folder).map_err(unreadable)?;
    let mut paths: Vec<PathBuf> = entries.map(|e| e.map(|e| e.path())).collect::<Result<_, _>>().map_err(unreadable)?;
    paths.retain(|path| path.extension().is_some_and(|e| e.eq_ignore_ascii_case("xml")));
    paths.sort();
    if paths.is_empty() {
        return Err(wrong(&"has no scenario"));
    }
    let read = |path: PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Map { name, scenario: commonroad::read_file(&path).map_err(Failure::file)? })
    };
    paths.into_iter().map(read).collect()
}

/// Counts over some scenes.
#[derive(Default)]
struct Sum {
    scenes: usize,
    branches: usize,
    grave: usize,
    short: usize,
    braking: usize,
    proven_contacts: usize,
    goals: usize,
}

impl Sum {
    fn add(&mut self, scene: &SceneResult) {
        self.scenes += 1;
        self.branches += scene.branches;
        self.grave += scene.failed(&GRAVE);
        self.short += scene.failed(&["short"]);
        self.braking += scene.failed(&["braking"]);
        self.proven_contacts += usize::from(scene.is_proven_contact);
        self.goals += usize::from(scene.outcome == "goal_reached");
    }

    fn row(&self, name: String) -> Vec<String> {
        let Self { scenes, goals, branches, grave, short, braking, proven_contacts } = self;
        let counts = [scenes, goals, branches, grave, short, braking, proven_contacts];
        std::iter::once(name).chain(counts.map(|n| n.to_string())).collect()
    }
}

/// Sums by a key, in the order of the keys.
fn sums<K: Ord>(bench: &FallbackBench, key: impl Fn(&SceneResult) -> K) -> BTreeMap<K, Sum> {
    let mut sums: BTreeMap<K, Sum> = BTreeMap::new();
    bench.scenes.iter().for_each(|scene| sums.entry(key(scene)).or_default().add(scene));
    sums
}

fn text(bench: &FallbackBench) -> String {
    let head = ["", "scenes", "goals", "branches", "broken", "short", "braking", "proven contacts"];
    let head = head.map(str::to_owned).to_vec();
    let mut rows = vec![head];
    rows.extend(sums(bench, |s| format!("{} {}", s.vehicle, s.surface)).into_iter().map(|(name, sum)| sum.row(name)));
    rows.extend(sums(bench, |s| s.source.clone()).into_iter().map(|(source, sum)| sum.row(source.name().into())));
    rows.extend(sums(bench, |_| ()).into_values().map(|sum| sum.row("all".into())));
    let mut text = report::table(&rows);
    let failed = |is_broken: bool| {
        let of = move |s: &&SceneResult| s.worst.is_some() && (s.failed(&GRAVE) > 0) == is_broken;
        bench.scenes.iter().filter(of).collect::<Vec<_>>()
    };
    list(&mut text, "scenes with a broken proof", &failed(true), |s| s.worst.as_deref().unwrap_or_default());
    let lesser = "scenes with a stop that was short, braked harder than planned or began beside the vehicle";
    list(&mut text, lesser, &failed(false), |s| s.worst.as_deref().unwrap_or_default());
    let not_run: Vec<&SceneResult> = bench.scenes.iter().filter(|s| s.cycles == 0).collect();
    list(&mut text, "scenes without a planning cycle", &not_run, |s| &s.outcome);
    let (broken, lesser) = (bench.failed(&GRAVE), LESSER.map(|code| bench.failed(&[code])));
    let [short, braking, start] = lesser;
    let _ = write!(text, "\nproven stops executed: {}, broken: {broken}", bench.branches());
    let _ = writeln!(text, "; short: {short}, braking: {braking}, start: {start}");
    if let Some(farthest) = bench.scenes.iter().filter_map(|s| s.farthest_stop).reduce(f64::max) {
        let _ = writeln!(text, "farthest stop beyond the planned one: {:.2} m", Short(farthest.max(0.0)));
    }
    text.push('\n');
    text.push_str(&check_table(&bench.checks()));
    text
}

/// Lists scenes, each with a sentence, under a title with their number.
fn list<'a>(text: &mut String, title: &str, scenes: &[&'a SceneResult], event: impl Fn(&'a SceneResult) -> &'a str) {
    if scenes.is_empty() {
        return;
    }
    let _ = writeln!(text, "\n{title}: {}", scenes.len());
    for scene in scenes.iter().take(LISTED) {
        let SceneResult { vehicle, surface, source, number, .. } = scene;
        let _ = writeln!(text, "{vehicle} {surface} {} {number}: {}", source.name(), event(scene));
    }
    if scenes.len() > LISTED {
        let _ = writeln!(text, "… {} more, see --csv or --json", scenes.len() - LISTED);
    }
}

fn to_json(bench: &FallbackBench, options: &Options) -> Value {
    let scene = |s: &SceneResult| {
        json!({
            "vehicle": s.vehicle,
            "surface": s.surface,
            "scene": s.source.name(),
            "number": s.number,
            "outcome": s.outcome,
            "cycles": s.cycles,
            "proven_cycles": s.proven,
            "branches": s.branches,
            "broken": s.failed(&GRAVE),
            "failed": s.failed,
            "worst": s.worst,
            "farthest_stop_m": s.farthest_stop,
            "proven_contact": s.is_proven_contact,
        })
    };
    let checks = bench.checks();
    let mut value = serde_json::Map::new();
    let mut put = |key: &str, v: Value| value.insert(key.to_owned(), v);
    put("format", json!("stopline.bench.fallbacks/2"));
    put("seed", json!(options.seed));
    put("interval_s", json!(options.interval));
    put("injected_faults", serde_json::to_value(options.faults).unwrap_or_default());
    put("branches", json!(bench.branches()));
    put("broken", json!(bench.failed(&GRAVE)));
    put("verdict", json!(if all_pass(&checks) { "pass" } else { "fail" }));
    put("checks", checks.iter().map(check_json).collect());
    put("scenes", bench.scenes.iter().map(scene).collect());
    let hash = result::hash(&Value::Object(value.clone()), &[]);
    value.insert("hash".into(), json!(hash));
    Value::Object(value)
}

/// One row for each scene.
fn to_csv(bench: &FallbackBench) -> String {
    let mut text = String::from("vehicle,surface,scene,number,outcome,cycles,proven_cycles,branches,");
    let codes: Vec<&str> = GRAVE.iter().copied().chain(LESSER).collect();
    let _ = writeln!(text, "{},proven_contact", codes.join(","));
    for s in &bench.scenes {
        let counts: Vec<String> = codes.iter().map(|c| s.failed.get(c).copied().unwrap_or(0).to_string()).collect();
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{},{},{}",
            s.vehicle,
            s.surface,
            s.source.name().replace(',', ";"),
            s.number,
            s.outcome.replace(',', ";"),
            s.cycles,
            s.proven,
            s.branches,
            counts.join(","),
            s.is_proven_contact
        );
    }
    text
}
