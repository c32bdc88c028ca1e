//! `stopline bench fallbacks`: the table, the JSON and the CSV of broken proofs.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::{Map, Value, json};

use super::{all_pass, check_json, check_table};
use crate::bench::fallbacks::{FallbackBench, GRAVE, Options, SURFACES, SceneResult, run as measure};
use crate::cli::args::FallbackArgs;
use crate::cli::job::Outputs;
use crate::cli::{Exit, Failure, json as result, print, progress, report};
use crate::drive::{Faults, Settings};
use crate::io::files;
use crate::vehicle;

/// Broken scenes that the report lists.
const LISTED: usize = 20;

/// Checks the outputs, measures, writes, reports.
pub(super) fn run(args: FallbackArgs) -> Result<Exit, Failure> {
    let outputs = Outputs { json: args.json, csv: args.csv, ..Outputs::default() };
    outputs.check(&[])?;
    let names: Vec<&str> = match &args.vehicle {
        Some(name) => vec![name],
        None => vehicle::builtin_names().to_vec(),
    };
    let vehicles =
        names.iter().map(|name| vehicle::load(name).map_err(Failure::file)).collect::<Result<Vec<_>, _>>()?;
    let mut faults = Faults::default();
    for fault in &args.inject {
        faults.inject(fault).map_err(|e| Failure::Use(format!("--inject: {e}")))?;
    }
    let options = Options { seed: args.seed, scenes: args.scenes, first: args.first, interval: args.interval, faults };
    let bar = progress::bar(!args.quiet);
    let all = args.scenes * (vehicles.len() * SURFACES.len()) as u64;
    bar.set_length(all);
    bar.set_message(format!("of {all} scenes"));
    let measured = measure(&vehicles, &Settings::default(), &options, &|done| bar.set_position(done as u64));
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

/// Counts over some scenes.
#[derive(Default)]
struct Sum {
    scenes: usize,
    branches: usize,
    grave: usize,
    braking: usize,
    proven_contacts: usize,
    goals: usize,
}

impl Sum {
    fn add(&mut self, scene: &SceneResult) {
        let count =
            |codes: &[&str]| scene.broken.iter().filter(|(c, _)| codes.contains(c)).map(|(_, n)| n).sum::<usize>();
        self.scenes += 1;
        self.branches += scene.branches;
        self.grave += count(&GRAVE);
        self.braking += count(&["braking"]);
        self.proven_contacts += usize::from(scene.is_proven_contact);
        self.goals += usize::from(scene.outcome == "goal_reached");
    }

    fn row(&self, name: String) -> Vec<String> {
        let counts = [self.scenes, self.goals, self.branches, self.grave, self.braking, self.proven_contacts];
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
    let head = ["", "scenes", "goals", "branches", "broken", "braking", "proven contacts"].map(str::to_owned).to_vec();
    let mut rows = vec![head];
    rows.extend(sums(bench, |s| format!("{} {}", s.vehicle, s.surface)).into_iter().map(|(name, sum)| sum.row(name)));
    rows.extend(sums(bench, |s| s.kind).into_iter().map(|(kind, sum)| sum.row(kind.name().into())));
    rows.extend(sums(bench, |_| ()).into_values().map(|sum| sum.row("all".into())));
    let mut text = report::table(&rows);
    let broken: Vec<&SceneResult> = bench.scenes.iter().filter(|s| s.worst.is_some()).collect();
    if !broken.is_empty() {
        let _ = writeln!(text, "\nscenes with a broken proof: {}", broken.len());
    }
    for scene in broken.iter().take(LISTED) {
        let event = scene.worst.as_deref().unwrap_or_default();
        let _ = writeln!(text, "{} {} {} {}: {event}", scene.vehicle, scene.surface, scene.kind.name(), scene.number);
    }
    text.push('\n');
    text.push_str(&check_table(&bench.checks()));
    text
}

fn to_json(bench: &FallbackBench, options: &Options) -> Value {
    let scene = |s: &SceneResult| {
        json!({
            "vehicle": s.vehicle,
            "surface": s.surface,
            "kind": s.kind.name(),
            "number": s.number,
            "outcome": s.outcome,
            "cycles": s.cycles,
            "proven_cycles": s.proven,
            "branches": s.branches,
            "broken": s.broken,
            "worst": s.worst,
            "proven_contact": s.is_proven_contact,
        })
    };
    let checks = bench.checks();
    let mut value = Map::new();
    let mut put = |key: &str, v: Value| value.insert(key.to_owned(), v);
    put("format", json!("stopline.bench.fallbacks/1"));
    put("seed", json!(options.seed));
    put("interval_s", json!(options.interval));
    put("injected_faults", serde_json::to_value(options.faults).unwrap_or_default());
    put("branches", json!(bench.branches()));
    put("verdict", json!(if all_pass(&checks) { "pass" } else { "fail" }));
    put("checks", checks.iter().map(check_json).collect());
    put("scenes", bench.scenes.iter().map(scene).collect());
    let hash = result::hash(&Value::Object(value.clone()), &[]);
    value.insert("hash".into(), json!(hash));
    Value::Object(value)
}

/// One row for each scene.
fn to_csv(bench: &FallbackBench) -> String {
    let mut text = String::from("vehicle,surface,kind,number,outcome,cycles,proven_cycles,branches,");
    let codes: Vec<&str> = GRAVE.iter().copied().chain(["braking", "start"]).collect();
    let _ = writeln!(text, "{},proven_contact", codes.join(","));
    for s in &bench.scenes {
        let counts: Vec<String> = codes.iter().map(|c| s.broken.get(c).copied().unwrap_or(0).to_string()).collect();
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{},{},{}",
            s.vehicle,
            s.surface,
            s.kind.name(),
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
