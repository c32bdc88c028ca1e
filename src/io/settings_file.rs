//! Reads TOML files written by hand: settings and suites.
//!
//! An error names the file, the line and the key. A misspelt key or value gets the known name nearest to it by edit
//! distance (insertions, deletions, substitutions, and swaps of adjacent letters); a renamed key gets its new name.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use super::files::InputError;
use super::{renamed_keys, text};

/// Largest file, bytes: far more than anybody writes by hand.
const MAX_BYTES: u64 = 1 << 20;

/// Why a TOML file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TomlError {
    /// The file cannot be read, or is not text.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Not TOML, or an unexpected key or value.
    #[error("{}: {message}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// The reason, with the line.
        message: String,
    },
}

/// Reads the text of a file.
///
/// # Errors
/// The file cannot be read, is too large, or is not text.
pub fn text(path: &Path) -> Result<String, TomlError> {
    Ok(text::read(path, MAX_BYTES)?)
}

/// Parses TOML; `path` stands for the file in messages.
///
/// # Errors
/// The text is not TOML, or has an unexpected key or value.
pub fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T, TomlError> {
    toml::from_str(text).map_err(|e| {
        let renamed = if e.message().starts_with(UNKNOWN_KEY) { renamed_keys::messages(text) } else { Vec::new() };
        let message = if renamed.is_empty() { with_suggestion(&e) } else { renamed.join("\n") };
        TomlError::Wrong { path: path.to_owned(), message }
    })
}

/// How serde's message about an unknown key begins: "unknown field `a`, expected one of `b`, `c`".
const UNKNOWN_KEY: &str = "unknown field ";
/// The same for an unknown value of an enumeration.
const UNKNOWN_VALUE: &str = "unknown variant ";

/// How the messages of serde begin, without those of the parser: "invalid type: string \"a\", expected usize".
const OF_SERDE: [&str; 6] =
    ["invalid type: ", "invalid value: ", "invalid length ", "missing field ", UNKNOWN_KEY, UNKNOWN_VALUE];

/// Words of Rust and serde, and those for people. The first that fits is used.
const PLAIN_WORDS: [(&str, &str); 22] = [
    ("expected usize", "expected a whole number, zero or more"),
    ("expected u64", "expected a whole number, zero or more"),
    ("expected u32", "expected a whole number from 0 to 4294967295"),
    ("expected u16", "expected a whole number from 0 to 65535"),
    ("expected u8", "expected a whole number from 0 to 255"),
    ("expected i64", "expected a whole number"),
    ("expected i32", "expected a whole number"),
    ("expected f64", "expected a number"),
    ("expected a boolean", "expected true or false"),
    ("expected a string", "expected a text in quotes"),
    ("expected a sequence", "expected a list"),
    ("expected a map", "expected a table"),
    ("expected string or table", "expected a text in quotes or a table"),
    ("invalid type: string", "wrong type: text"),
    ("invalid type: sequence", "wrong type: list"),
    ("invalid type: map", "wrong type: table"),
    ("invalid type: floating point", "wrong type: number"),
    ("invalid type: integer", "wrong type: number"),
    ("invalid type: boolean", "wrong type:"),
    ("unknown field ", "unknown key "),
    ("unknown variant ", "unknown value "),
    ("missing field ", "missing key "),
];

/// The message without words of Rust. Lines that quote the file stay.
fn in_plain_words(message: &str) -> String {
    let plain = |line: &str| {
        let is_of_serde = OF_SERDE.iter().any(|start| line.starts_with(start));
        let words: &[(&str, &str)] = if is_of_serde { &PLAIN_WORDS } else { &[] };
        // only the end is about the expected type; the value before it is quoted from the file
        let (found, expected) = line.rfind(", expected ").map_or((line, ""), |at| line.split_at(at));
        let replaced = |text: &str| {
            let fits = |word: &str| text.trim_start_matches(", ").starts_with(word);
            match words.iter().find(|(word, _)| fits(word)) {
                Some((word, plain)) => text.replacen(word, plain, 1),
                None => text.to_owned(),
            }
        };
        let expected =
            if is_of_serde && expected.starts_with(", expected struct ") { ", expected a table" } else { expected };
        format!("{}{}", replaced(found), replaced(expected))
    };
    message.lines().map(plain).collect::<Vec<_>>().join("\n")
}

/// The message of a serde error. For an unknown name, it ends with the new name or with the nearest known name.
pub(crate) fn with_suggestion(error: &dyn std::fmt::Display) -> String {
    let message = error.to_string().trim_end().to_owned();
    if let Some(renamed) = renamed(&message) {
        return renamed;
    }
    let plain = in_plain_words(&message);
    match meant(&message) {
        Some(name) => format!("{plain}\ndid you mean `{name}`?"),
        None => plain,
    }
}

/// For an error without line, which names the table of an unknown key: "unknown field `a`, …\nin `b.c`".
fn renamed(message: &str) -> Option<String> {
    let (key, table) = message.strip_prefix(UNKNOWN_KEY)?.split_once("\nin `")?;
    renamed_keys::message(&format!("{}.{}", table.strip_suffix('`')?, key.split('`').nth(1)?))
}

/// The known name nearest to the unknown one in a message of serde.
fn meant(message: &str) -> Option<&str> {
    let names = [UNKNOWN_KEY, UNKNOWN_VALUE].iter().find_map(|start| message.split_once(start))?.1;
    let mut names = names.lines().next()?.split('`').skip(1).step_by(2);
    let wrong = names.next()?;
    nearest(wrong, names)
}

/// The known name nearest to a misspelt one, without regard to case and to `-` for `_`: at most a third of its letters
/// differ, or two. Otherwise the only known name that it is the beginning of.
pub(crate) fn nearest<'a>(wrong: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    /// Fewest letters that count as a beginning.
    const BEGINNING: usize = 3;
    let normal = |name: &str| name.to_lowercase().replace(['-', ' '], "_");
    let wrong = normal(wrong);
    let letters = wrong.chars().count();
    let distances: Vec<(usize, &str)> =
        known.into_iter().map(|name| (strsim::osa_distance(&wrong, &normal(name)), name)).collect();
    let (distance, name) = *distances.iter().min_by_key(|(distance, _)| *distance)?;
    if distance <= (letters / 3).max(2) {
        return Some(name);
    }
    let mut longer = distances.iter().map(|(_, name)| *name).filter(|name| normal(name).starts_with(&wrong));
    let only = longer.next().filter(|_| letters >= BEGINNING);
    if longer.next().is_none() { only } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> String {
        parse::<crate::drive::Settings>(Path::new("a.toml"), text).unwrap_err().to_string()
    }

    #[test]
    fn suggests_the_name_nearest_to_a_misspelt_one() {
        let near = read("[planner]\ncruise_sped = 3.0");
        assert!(near.starts_with("a.toml: ") && near.contains("line 2"), "{near}");
        assert!(near.ends_with("did you mean `cruise_speed`?"), "{near}");
        assert!(read("[plannner]").ends_with("did you mean `planner`?"));
        assert!(read("[planner.uncertainty]\nmode = \"of\"").ends_with("did you mean `off`?"));
        let strange = read("[planner]\nsomething_else = 3.0");
        assert!(!strange.contains("did you mean"), "{strange}");
    }

    #[test]
    fn compares_names_by_edits_case_and_beginning() {
        let known = ["bmw_320i", "ford_escort", "truck", "truck_long"];
        for (wrong, meant) in [
            ("turck", Some("truck")),
            ("BMW-320i", Some("bmw_320i")),
            ("bmw", Some("bmw_320i")),
            ("truck_lnog", Some("truck_long")),
            ("for", Some("ford_escort")),
            ("fo", None),
            ("bicycle", None),
            ("", None),
        ] {
            assert_eq!(nearest(wrong, known), meant, "{wrong}");
        }
        assert_eq!(nearest("trailer", ["trailer_short", "trailer_long"]), None, "two names begin with it");
        assert_eq!(nearest("x", []), None);
    }

    #[test]
    fn messages_have_no_words_of_rust() {
        for (text, end) in [
            (
                "[planner.lattice]\nlayers = \"many\"",
                "wrong type: text \"many\", expected a whole number, zero or more",
            ),
            ("[planner.lattice]\nlayers = -1", "invalid value: integer `-1`, expected a whole number, zero or more"),
            ("[planner.lattice]\nlayers = 1.5", "wrong type: number `1.5`, expected a whole number, zero or more"),
            ("[planner]\njerk = \"expected usize\"", "wrong type: text \"expected usize\", expected a number"),
            ("[planner]\nstandoff = [1]", "expected a number"),
            ("[simulation]\nanti_lock = 3", "wrong type: number `3`, expected true or false"),
            ("[planner.lattice]\nheadings = 0.0", "wrong type: number `0.0`, expected a list"),
            ("[planner]\nrefinement.enabled = \"yes\"", "wrong type: text \"yes\", expected true or false"),
            ("[[planner.emergency]]\nacceleration = 1.0", "missing key `deceleration`"),
            ("planner = 3", "wrong type: number `3`, expected a table"),
            ("[planner]\ncruise_sped = 3.0", "did you mean `cruise_speed`?"),
        ] {
            let message = read(text);
            assert!(message.ends_with(end), "{message}");
        }
        assert!(read("[planner]\ncruise_sped = 3.0").contains("\nunknown key `cruise_sped`, expected one of"));
        let quoted = read("[planner]\njerk = \"a\" # invalid type: expected usize");
        assert!(quoted.contains("# invalid type: expected usize"), "lines of the file stay: {quoted}");
    }

    #[test]
    fn an_old_key_is_refused_with_its_new_name() {
        assert_eq!(
            read("[planner]\nuncertainty.along = 1.0\n[run]\nrest = 2\n"),
            "a.toml: line 2: `planner.uncertainty.along` is now `planner.uncertainty.longitudinal`\n\
             line 4: `run.rest` is now `run.standstill_time`"
        );
        let table: toml::Table = toml::from_str("planner.lattice.weights.bending = 1.0").unwrap();
        let error = <crate::drive::Settings as serde::Deserialize>::deserialize(table).unwrap_err();
        assert_eq!(
            with_suggestion(&error),
            "`planner.lattice.weights.bending` is now `planner.lattice.weights.curvature`"
        );
        let both = read("[planner]\ncruise_speed = \"fast\"\nuncertainty.along = 1.0\n");
        assert!(both.contains("expected a number"), "an error of another kind comes first: {both}");
    }
}
