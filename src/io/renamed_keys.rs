//! Settings keys that have a new name or are gone. A file with an old key is refused with the new one, or with what replaced it.
//!
//! To rename a key, add a row to [`RENAMED`]; to remove one, to [`REMOVED`]. A test checks that new keys exist and old ones do not.

use toml::de::{DeTable, DeValue};

/// Old and new dotted keys below the root of the settings. A row for a table applies to all keys in it.
const RENAMED: &[(&str, &str)] = &[
    ("planner.emergency_speed", "planner.emergency_speed_factor"),
    ("planner.lattice.longest_edge", "planner.lattice.max_edge_length"),
    ("planner.lattice.most_turn", "planner.lattice.max_turn"),
    ("planner.lattice.shortest_edge", "planner.lattice.min_edge_length"),
    ("planner.lattice.steepest", "planner.lattice.max_slope"),
    ("planner.lattice.weights.bending", "planner.lattice.weights.curvature"),
    ("planner.lattice.weights.clearance_wanted", "planner.lattice.weights.desired_clearance"),
    ("planner.lattice.weights.delay", "planner.lattice.weights.travel_time"),
    ("planner.lattice.weights.lane", "planner.lattice.weights.lane_deviation"),
    ("planner.lattice.weights.missing", "planner.lattice.weights.progress_shortfall"),
    ("planner.lattice.weights.slowing", "planner.lattice.weights.curve_slowdown"),
    ("planner.lattice.weights.switching", "planner.lattice.weights.plan_change"),
    ("planner.longest_horizon", "planner.max_horizon"),
    ("planner.refinement.least_gain", "planner.refinement.min_gain"),
    ("planner.shortest_horizon", "planner.min_horizon"),
    ("planner.uncertainty.across", "planner.uncertainty.lateral"),
    ("planner.uncertainty.along", "planner.uncertainty.longitudinal"),
    ("planner.uncertainty.most_across", "planner.uncertainty.max_lateral_deviation"),
    ("run.rest", "run.standstill_time"),
];

/// Dotted keys that are gone, and what replaced them.
const REMOVED: &[(&str, &str)] = &[
    ("planner.restart_lateral", "the tracking tube of the vehicle: [tracking] in its dynamics.toml"),
    ("planner.restart_longitudinal", "the tracking tube of the vehicle: [tracking] in its dynamics.toml"),
];

/// Tables of a suite that contain settings: `drive.settings.planner`, `drive.matrix."planner.horizon"`.
const SETTINGS_TABLES: [&str; 2] = ["settings.", "matrix."];

/// The message for an old key: "`old` is now `new`", or what replaced it. `path` is the dotted key in the file; `None` if it is not an old
/// key.
pub(super) fn message(path: &str) -> Option<String> {
    let key = SETTINGS_TABLES.iter().find_map(|table| path.split_once(table)).map_or(path, |(_, key)| key);
    let find = |keys: &[(&'static str, &'static str)]| keys.iter().find(|(old, _)| *old == key).copied();
    let renamed = find(RENAMED).map(|(old, new)| format!("`{old}` is now `{new}`"));
    renamed.or_else(|| find(REMOVED).map(|(old, by)| format!("`{old}` is no setting any more; it follows from {by}")))
}

/// The messages for all old keys of a file, each with its line, in order of the lines.
pub(super) fn messages(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    if let Ok(table) = DeTable::parse(text) {
        find_in_table(table.get_ref(), "", &mut found);
    }
    found.sort();
    let line = |position: usize| 1 + text[..position].matches('\n').count();
    found.into_iter().map(|(position, message)| format!("line {}: {message}", line(position))).collect()
}

fn find_in_table(table: &DeTable<'_>, prefix: &str, found: &mut Vec<(usize, String)>) {
    for (key, value) in table {
        let path = if prefix.is_empty() { key.get_ref().to_string() } else { format!("{prefix}.{}", key.get_ref()) };
        match message(&path) {
            Some(message) => found.push((key.span().start, message)),
            None => find_in_value(value.get_ref(), &path, found),
        }
    }
}

fn find_in_value(value: &DeValue<'_>, path: &str, found: &mut Vec<(usize, String)>) {
    match value {
        DeValue::Table(table) => find_in_table(table, path, found),
        DeValue::Array(values) => values.iter().for_each(|value| find_in_value(value.get_ref(), path, found)),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether the settings have the key.
    fn exists(key: &str) -> bool {
        let (tables, last) = key.rsplit_once('.').unwrap();
        // no setting has an array of arrays as its value, so the value is refused only after the key
        let error = toml::from_str::<crate::drive::Settings>(&format!("{tables}.{last} = [[]]")).unwrap_err();
        !error.message().starts_with("unknown field")
    }

    #[test]
    fn new_keys_exist_and_old_keys_do_not() {
        for (old, new) in RENAMED {
            assert!(exists(new), "{new}");
            assert!(!exists(old), "{old}");
        }
        for (old, _) in REMOVED {
            assert!(!exists(old), "{old}");
            assert!(message(old).is_some_and(|m| m.contains("follows from")), "{old}");
        }
        assert!(RENAMED.is_sorted_by(|a, b| a.0 < b.0), "rows in order, each old key once");
    }

    #[test]
    fn finds_old_keys_in_settings_and_suites() {
        let text = "[planner.uncertainty]\nmode = \"off\"\nalong = 1\n[run]\nrest = 2\nalong = 3\n";
        assert_eq!(
            messages(text),
            [
                "line 3: `planner.uncertainty.along` is now `planner.uncertainty.longitudinal`",
                "line 5: `run.rest` is now `run.standstill_time`"
            ]
        );
        let suite = "[defaults]\nsettings.run.rest = 1\n[[drive]]\n[[drive]]\nsettings = { run = { rest = 2 } }\n\
                     matrix = { \"planner.uncertainty.along\" = [1] }\n";
        let lines: Vec<String> = messages(suite).iter().map(|m| m.chars().take(6).collect()).collect();
        assert_eq!(lines, ["line 2", "line 5", "line 6"]);
        assert_eq!(messages("rest = 1\n[other.run]\nrest = 2\n"), [""; 0]);
        assert_eq!(messages("not TOML"), [""; 0]);
    }
}
