//! TOML files that people write: settings, suites.
//!
//! An error names the file, the line and the key, and says what was likely meant where a name is nearly right. What is
//! near is told by the Levenshtein distance: fewest letters put in, taken out or changed.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use super::files::{self, InputError};

/// Largest file, bytes: far more than anybody writes by hand.
const MAX_BYTES: u64 = 1 << 20;

/// Why a TOML file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TomlError {
    /// Not a file that can be read.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Not UTF-8.
    #[error("{}: not UTF-8 text: {source}", path.display())]
    NotText {
        /// The file.
        path: PathBuf,
        /// Where.
        source: std::str::Utf8Error,
    },
    /// Not TOML, or not what is expected there.
    #[error("{}: {message}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// What is wrong, with the line.
        message: String,
    },
}

/// Reads a file as text.
///
/// # Errors
/// It is not there, too large, or not UTF-8.
pub fn text(path: &Path) -> Result<String, TomlError> {
    let bytes = files::read(path, MAX_BYTES)?;
    match std::str::from_utf8(&bytes) {
        Ok(text) => Ok(text.to_owned()),
        Err(source) => Err(TomlError::NotText { path: path.to_owned(), source }),
    }
}

/// Understands text as TOML; `path` stands for it in messages.
///
/// # Errors
/// It is not TOML, or has keys or values that are not expected.
pub fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T, TomlError> {
    toml::from_str(text).map_err(|e| TomlError::Wrong { path: path.to_owned(), message: with_suggestion(&e) })
}

/// A message of serde about an unknown name, with the known name that it is nearly.
pub(crate) fn with_suggestion(error: &dyn std::fmt::Display) -> String {
    let message = error.to_string().trim_end().to_owned();
    match meant(&message) {
        Some(name) => format!("{message}\ndid you mean `{name}`?"),
        None => message,
    }
}

/// The name meant in a message of serde: "unknown field `a`, expected one of `b`, `c`".
fn meant(message: &str) -> Option<&str> {
    let told = ["unknown field ", "unknown variant "].iter().find_map(|start| message.split_once(start))?.1;
    let mut names = told.lines().next()?.split('`').skip(1).step_by(2);
    let wrong = names.next()?;
    nearest(wrong, names)
}

/// The known name that a wrong one is nearly: at most a third of its letters are wrong, or two.
pub(crate) fn nearest<'a>(wrong: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let most = (wrong.chars().count() / 3).max(2);
    let near = known.into_iter().map(|name| (distance(wrong, name), name)).min_by_key(|(distance, _)| *distance)?;
    (near.0 <= most).then_some(near.1)
}

/// Levenshtein distance, row by row.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = i;
        let mut left = i + 1;
        for (cell, y) in row.iter_mut().skip(1).zip(&b) {
            let changed = diagonal + usize::from(x != *y);
            diagonal = *cell;
            left = changed.min(left + 1).min(*cell + 1);
            *cell = left;
        }
        row[0] = i + 1;
    }
    row.last().copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_is_that_of_textbooks_and_symmetric() {
        for (a, b, is) in
            [("kitten", "sitting", 3), ("", "abc", 3), ("abc", "abc", 0), ("flaw", "lawn", 2), ("é", "e", 1)]
        {
            assert_eq!((distance(a, b), distance(b, a)), (is, is), "{a} {b}");
        }
    }

    #[test]
    fn a_name_that_is_nearly_right_is_suggested_and_a_strange_one_is_not() {
        let read = |text: &str| parse::<crate::drive::Settings>(Path::new("a.toml"), text).unwrap_err().to_string();
        let near = read("[planner]\ncruise_sped = 3.0");
        assert!(near.starts_with("a.toml: ") && near.contains("line 2"), "{near}");
        assert!(near.ends_with("did you mean `cruise_speed`?"), "{near}");
        assert!(read("[plannner]").ends_with("did you mean `planner`?"));
        assert!(read("[planner.uncertainty]\nmode = \"of\"").ends_with("did you mean `off`?"));
        let strange = read("[planner]\nsomething_else = 3.0");
        assert!(!strange.contains("did you mean"), "{strange}");
    }
}
