//! Expands the entries of a suite to drives: scenarios × vehicles × settings × seeds.
//!
//! Drives keep the order of the file. Within an entry, scenarios are sorted and lists keep their order. The id of a drive
//! depends on its own entry only, so that it stays the same when other entries are added, removed or moved: the baseline
//! stores metrics by id.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize as _;
use toml::Spanned;

use super::SuiteError;
use super::names;
use super::pattern::FilePattern;
use super::suite::{Bound, Entry, Expect, OneOrMore, SuiteFile, Tolerance, folder_of};
use crate::drive::Settings;
use crate::io::settings_file;
use crate::vehicle::{self, Vehicle};

/// The vehicle of an entry that names none.
const DEFAULT_VEHICLE: &str = "bmw_320i";

/// The largest number of drives of a suite: a larger one is a mistake in a matrix.
const MAX_DRIVES: usize = 100_000;

/// A drive of a suite, with all its inputs except the content of the scenario.
#[derive(Debug)]
pub(super) struct Case {
    pub(super) id: String,
    /// Line of its entry in the suite.
    pub(super) line: usize,
    /// The scenario's path relative to the suite.
    pub(super) scenario_name: String,
    /// The scenario's file.
    pub(super) scenario: PathBuf,
    pub(super) problem: Option<i64>,
    /// The value for `--vehicle`.
    pub(super) vehicle_name: String,
    pub(super) vehicle: Arc<Vehicle>,
    pub(super) config_file: Option<PathBuf>,
    pub(super) settings: Arc<Settings>,
    /// All settings, as TOML for `--config`.
    pub(super) config: Arc<str>,
    pub(super) seed: u64,
    pub(super) repetitions: u32,
    pub(super) expected: Arc<Expected>,
}

/// The expectations of a drive.
#[derive(Debug, Default)]
pub(super) struct Expected {
    /// Accepted outcomes; `goal_reached` and `stopped_safely` if empty.
    pub(super) outcomes: Vec<Expect>,
    /// Checks that have to apply and to pass; if not given, all checks that apply.
    pub(super) checks: Option<Vec<String>>,
    /// Why the drive is expected to fail, if it is.
    pub(super) failure: Option<String>,
    pub(super) limits: BTreeMap<String, Bound>,
    pub(super) tolerances: BTreeMap<String, Tolerance>,
}

/// All drives of a suite.
pub(super) fn cases(file: &Path, text: &str, read: SuiteFile<toml::Table>) -> Result<Vec<Case>, SuiteError> {
    let line_of = |at: usize| 1 + text.bytes().take(at).filter(|b| *b == b'\n').count();
    let wrong = |line: usize, message: String| SuiteError::Wrong { file: file.to_owned(), line: Some(line), message };
    let defaults = read.defaults.map(|d| (line_of(d.span().start), d.into_inner()));
    if let Some((line, Entry { name, scenarios, .. })) = &defaults
        && (name.is_some() || scenarios.is_some())
    {
        return Err(wrong(*line, "`name` and `scenarios` belong to a [[drive]], not to [defaults]".into()));
    }
    if let Some((line, entry)) = &defaults {
        names::validate(entry).map_err(|message| wrong(*line, message))?;
    }
    let defaults = defaults.map_or_else(Entry::default, |(_, entry)| entry);
    let mut expansion = Expansion { folder: folder_of(file), vehicles: BTreeMap::new(), cases: Vec::new() };
    for entry in read.drive {
        let line = line_of(entry.span().start);
        let entry = with_defaults(Spanned::into_inner(entry), &defaults);
        names::validate(&entry).map_err(|message| wrong(line, message))?;
        expansion.add(line, &entry).map_err(|message| wrong(line, message))?;
    }
    let mut lines: BTreeMap<&str, usize> = BTreeMap::new();
    for case in &expansion.cases {
        if let Some(before) = lines.insert(&case.id, case.line) {
            let message = format!("the drive `{}` exists already, from line {before}: give one a `name`", case.id);
            return Err(wrong(case.line, message));
        }
    }
    if expansion.cases.is_empty() {
        return Err(SuiteError::Wrong {
            file: file.to_owned(),
            line: None,
            message: "the suite has no [[drive]]".into(),
        });
    }
    Ok(expansion.cases)
}

impl<S> Default for Entry<S> {
    fn default() -> Self {
        Self {
            name: None,
            scenarios: None,
            exclude: None,
            problem: None,
            vehicle: None,
            config: None,
            settings: None,
            matrix: None,
            seeds: None,
            repetitions: None,
            expect: None,
            checks: None,
            expected_failure: None,
            limits: None,
            tolerances: None,
        }
    }
}

/// The entry, with the defaults for missing keys. Tables are merged key by key.
fn with_defaults(entry: Entry<toml::Table>, defaults: &Entry<toml::Table>) -> Entry<toml::Table> {
    fn both<V: Clone>(d: &Option<BTreeMap<String, V>>, e: Option<BTreeMap<String, V>>) -> Option<BTreeMap<String, V>> {
        let mut all = d.clone().unwrap_or_default();
        all.extend(e.unwrap_or_default());
        Some(all)
    }
    let mut settings = defaults.settings.clone().unwrap_or_default();
    merge(&mut settings, entry.settings.unwrap_or_default());
    Entry {
        name: entry.name,
        scenarios: entry.scenarios,
        exclude: entry.exclude.or_else(|| defaults.exclude.clone()),
        problem: entry.problem.or(defaults.problem),
        vehicle: entry.vehicle.or_else(|| defaults.vehicle.clone()),
        config: entry.config.or_else(|| defaults.config.clone()),
        settings: Some(settings),
        matrix: both(&defaults.matrix, entry.matrix),
        seeds: entry.seeds.or_else(|| defaults.seeds.clone()),
        repetitions: entry.repetitions.or(defaults.repetitions),
        expect: entry.expect.or_else(|| defaults.expect.clone()),
        checks: entry.checks.or_else(|| defaults.checks.clone()),
        expected_failure: entry.expected_failure.or_else(|| defaults.expected_failure.clone()),
        limits: both(&defaults.limits, entry.limits),
        tolerances: both(&defaults.tolerances, entry.tolerances),
    }
}

/// Merges `overrides` into `table`, recursively.
fn merge(table: &mut toml::Table, overrides: toml::Table) {
    for (key, value) in overrides {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(table)), toml::Value::Table(overrides)) => merge(table, overrides),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

struct Expansion<'a> {
    folder: &'a Path,
    /// Vehicles already read, by their value for `--vehicle`.
    vehicles: BTreeMap<String, Arc<Vehicle>>,
    cases: Vec<Case>,
}

impl Expansion<'_> {
    fn add(&mut self, line: usize, entry: &Entry<toml::Table>) -> Result<(), String> {
        let scenarios = self.scenarios(entry)?;
        let default_vehicle = OneOrMore(vec![DEFAULT_VEHICLE.to_owned()]);
        let vehicles = &entry.vehicle.as_ref().unwrap_or(&default_vehicle).0;
        let variants = seeded(self.variants(entry)?, entry.seeds.as_deref())?;
        let count = scenarios.len().saturating_mul(vehicles.len() * variants.len());
        if self.cases.len().saturating_add(count) > MAX_DRIVES {
            return Err(format!("this entry has {count} drives; a suite can have {MAX_DRIVES} at most"));
        }
        let expected = Arc::new(Expected {
            outcomes: entry.expect.clone().map_or_else(Vec::new, |e| e.0),
            checks: entry.checks.clone(),
            failure: entry.expected_failure.clone(),
            limits: entry.limits.clone().unwrap_or_default(),
            tolerances: entry.tolerances.clone().unwrap_or_default(),
        });
        for scenario in &scenarios {
            for name in vehicles {
                let (vehicle_name, vehicle) = self.vehicle(name)?;
                for variant in &variants {
                    self.cases.push(Case {
                        id: id(entry, scenario, name, &variant.labels),
                        line,
                        scenario_name: scenario.clone(),
                        scenario: self.folder.join(scenario),
                        problem: entry.problem,
                        vehicle_name: vehicle_name.clone(),
                        vehicle: Arc::clone(&vehicle),
                        config_file: entry.config.as_ref().map(|c| self.folder.join(c)),
                        settings: Arc::clone(&variant.settings),
                        config: Arc::clone(&variant.config),
                        seed: variant.settings.faults.seed,
                        repetitions: entry.repetitions.map_or(1, |r| r.0),
                        expected: Arc::clone(&expected),
                    });
                }
            }
        }
        Ok(())
    }

    /// The scenarios of the entry. A pattern without a match is an error: a suite without drives must not pass.
    fn scenarios(&self, entry: &Entry<toml::Table>) -> Result<Vec<String>, String> {
        let patterns = entry.scenarios.as_ref().ok_or("a [[drive]] needs `scenarios`: a file, a pattern, or a list")?;
        let mut files = BTreeSet::new();
        for pattern in &patterns.0 {
            let folder = self.folder.display();
            let files_of = FilePattern::new(pattern).map_err(|e| format!("`{pattern}`: {e}"))?;
            let found = files_of.files(self.folder).map_err(|e| format!("`{pattern}` in {folder}: {e}"))?;
            if found.is_empty() {
                return Err(format!("`{pattern}` matches no file in {folder}"));
            }
            files.extend(found);
        }
        for pattern in entry.exclude.iter().flat_map(|e| &e.0) {
            let before = files.len();
            let excluded = FilePattern::new(pattern).map_err(|e| format!("`exclude`: `{pattern}`: {e}"))?;
            files.retain(|file| !excluded.matches(file));
            if files.len() == before {
                return Err(format!("`exclude`: `{pattern}` matches none of the scenarios"));
            }
        }
        if files.is_empty() {
            return Err("`exclude` leaves no scenario".into());
        }
        Ok(files.into_iter().collect())
    }

    /// A vehicle with its value for `--vehicle`. A name that is not built in is a folder relative to the suite.
    fn vehicle(&mut self, name: &str) -> Result<(String, Arc<Vehicle>), String> {
        let is_builtin = vehicle::builtin_names().contains(&name);
        let argument = if is_builtin { name.to_owned() } else { self.folder.join(name).to_string_lossy().into_owned() };
        if let Some(vehicle) = self.vehicles.get(&argument) {
            return Ok((argument, Arc::clone(vehicle)));
        }
        let vehicle = vehicle::load(&argument).map_err(|e| e.to_string())?;
        let vehicle = Arc::new(vehicle);
        self.vehicles.insert(argument.clone(), Arc::clone(&vehicle));
        Ok((argument, vehicle))
    }

    /// The settings of an entry. The file has the lowest priority, then come the inline table and the matrix.
    fn variants(&self, entry: &Entry<toml::Table>) -> Result<Vec<Variant>, String> {
        let mut base = toml::Table::new();
        if let Some(config) = &entry.config {
            let file = self.folder.join(config);
            let text = settings_file::text(&file).map_err(|e| e.to_string())?;
            settings_file::parse::<Settings>(&file, &text).map_err(|e| e.to_string())?;
            base = settings_file::parse(&file, &text).map_err(|e| e.to_string())?;
        }
        merge(&mut base, entry.settings.clone().unwrap_or_default());
        let mut combinations: Vec<Vec<(&str, &toml::Value)>> = vec![Vec::new()];
        for (key, values) in entry.matrix.iter().flatten() {
            if values.is_empty() {
                return Err(format!("`matrix`: `{key}` has no values"));
            }
            if combinations.len().saturating_mul(values.len()) > MAX_DRIVES {
                return Err(format!("`matrix` has more than {MAX_DRIVES} combinations"));
            }
            let extended =
                |c: &Vec<_>| values.iter().map(move |v| [c.clone(), vec![(key.as_str(), v)]].concat()).collect();
            combinations = combinations.iter().flat_map(|c| -> Vec<Vec<_>> { extended(c) }).collect();
        }
        combinations.iter().map(|combination| Variant::new(&base, combination)).collect()
    }
}

/// One combination of settings.
struct Variant {
    /// `key=value` of the matrix and the seed, for the id.
    labels: Vec<String>,
    settings: Arc<Settings>,
    config: Arc<str>,
}

impl Variant {
    fn new(base: &toml::Table, combination: &[(&str, &toml::Value)]) -> Result<Self, String> {
        let mut table = base.clone();
        let mut labels = Vec::new();
        for (path, value) in combination {
            let mut nested = (*value).clone();
            for key in path.rsplit('.') {
                nested = toml::Value::Table(std::iter::once((key.to_owned(), nested)).collect());
            }
            if let toml::Value::Table(overrides) = nested {
                merge(&mut table, overrides);
            }
            labels.push(format!("{path}={}", value.to_string().trim_matches('"')));
        }
        let context = if labels.is_empty() { "`settings`".into() } else { format!("`matrix` {}", labels.join(", ")) };
        let settings =
            Settings::deserialize(table).map_err(|e| format!("{context}: {}", settings_file::with_suggestion(&e)))?;
        settings.validate().map_err(|e| format!("{context}: {e}"))?;
        Self::with_labels(labels, settings)
    }

    fn with_labels(labels: Vec<String>, settings: Settings) -> Result<Self, String> {
        let config = toml::to_string(&settings).map_err(|e| format!("settings cannot be written as TOML: {e}"))?;
        Ok(Self { labels, settings: Arc::new(settings), config: config.into() })
    }
}

/// Each variant with each random seed. The id contains the seed if there are several.
fn seeded(variants: Vec<Variant>, seeds: Option<&[u64]>) -> Result<Vec<Variant>, String> {
    let Some(seeds) = seeds else { return Ok(variants) };
    if seeds.is_empty() {
        return Err("`seeds` is empty, expected at least one".into());
    }
    let with = |variant: &Variant, seed: u64| {
        let mut settings = (*variant.settings).clone();
        settings.faults.seed = seed;
        let label = (seeds.len() > 1).then(|| format!("seed={seed}"));
        Variant::with_labels(variant.labels.iter().cloned().chain(label).collect(), settings)
    };
    variants.iter().flat_map(|variant| seeds.iter().map(move |seed| with(variant, *seed))).collect()
}

/// `name:scenario#problem@vehicle,key=value,…`. Name, problem and keys are left out if the entry does not give them.
fn id(entry: &Entry<toml::Table>, scenario: &str, vehicle: &str, labels: &[String]) -> String {
    let name = entry.name.as_ref().map_or_else(String::new, |n| format!("{n}:"));
    let problem = entry.problem.map_or_else(String::new, |p| format!("#{p}"));
    let labels: String = labels.iter().map(|label| format!(",{label}")).collect();
    format!("{name}{scenario}{problem}@{vehicle}{labels}")
}
