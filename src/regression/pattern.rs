//! Files by pattern: `*` and `?` within a name, `**` for any number of folders.
//!
//! The `glob` crate matches, `walkdir` lists. `glob` can also list files, but its `**` follows symbolic links, also links
//! to a parent folder; here `**` never follows a link to a folder. Only `*` and `?` are wildcards: brackets are
//! characters of a name. A name that begins with a dot matches only a pattern that has the dot.

use std::path::Path;

use ::glob::{MatchOptions, Pattern, PatternError};
use walkdir::{DirEntry, WalkDir};

/// The largest number of folders that a pattern may search: a pattern at the root of a disk is a mistake.
const MAX_FOLDERS: usize = 100_000;

const OPTIONS: MatchOptions =
    MatchOptions { case_sensitive: true, require_literal_separator: true, require_literal_leading_dot: true };

/// A pattern of file paths with `/` between names.
pub(super) struct FilePattern {
    /// As the suite has it.
    text: String,
    pattern: Pattern,
}

impl FilePattern {
    /// Reads a pattern.
    ///
    /// # Errors
    /// `**` is only a part of a name.
    pub(super) fn new(text: &str) -> Result<Self, PatternError> {
        let pattern = Pattern::new(&normalized(text).replace('[', "[[]"))?;
        Ok(Self { text: text.to_owned(), pattern })
    }

    /// Whether a relative path matches.
    pub(super) fn matches(&self, path: &str) -> bool {
        self.pattern.matches_with(&normalized(path), OPTIONS)
    }

    /// The files below `folder` that match, as sorted paths relative to it. The name of an existing file matches that file
    /// only, also if it contains a wildcard.
    ///
    /// # Errors
    /// A folder cannot be read, or the pattern searches more than [`MAX_FOLDERS`] folders.
    pub(super) fn files(&self, folder: &Path) -> std::io::Result<Vec<String>> {
        if folder.join(&self.text).is_file() {
            return Ok(vec![self.text.clone()]);
        }
        let text = normalized(&self.text);
        let parts: Vec<&str> = text.split('/').collect();
        let Some(first_wild) = parts.iter().position(|part| part.contains(['*', '?'])) else { return Ok(Vec::new()) };
        let start = parts[..first_wild].iter().map(|part| format!("{part}/")).collect::<String>();
        let is_recursive = parts.contains(&"**");
        let depth = parts.len() - first_wild;
        let mut walk = WalkDir::new(folder.join(&start)).min_depth(1).follow_links(!is_recursive);
        if !is_recursive {
            walk = walk.max_depth(depth);
        }
        let has_hidden = parts[first_wild..].iter().any(|part| part.starts_with('.'));
        let is_searched = |entry: &DirEntry| {
            has_hidden || entry.depth() == 0 || !entry.file_name().as_encoded_bytes().starts_with(b".")
        };
        let mut folders = 0;
        let mut found = Vec::new();
        for entry in walk.into_iter().filter_entry(is_searched) {
            let entry = match entry {
                Ok(entry) => entry,
                Err(e) if is_dangling_or_circular(&e) => continue,
                Err(e) => return Err(e.into()),
            };
            folders += usize::from(entry.file_type().is_dir());
            if folders > MAX_FOLDERS {
                return Err(std::io::Error::other(format!("the pattern searches more than {MAX_FOLDERS} folders")));
            }
            let Some(path) = relative(&entry) else { continue };
            let path = format!("{start}{path}");
            if self.matches(&path) && entry.path().is_file() {
                found.push(path);
            }
        }
        found.sort();
        Ok(found)
    }
}

/// The path below the folder where the search began, with `/` between names; none if it is not Unicode.
fn relative(entry: &DirEntry) -> Option<String> {
    let depth = entry.path().components().count() - entry.depth();
    let names = entry.path().components().skip(depth).map(|name| name.as_os_str().to_str());
    names.collect::<Option<Vec<_>>>().map(|names| names.join("/"))
}

/// Whether an entry is a link to nothing or to one of its parents. Such entries are no files.
fn is_dangling_or_circular(error: &walkdir::Error) -> bool {
    let is_missing = error.io_error().is_some_and(|e| e.kind() == std::io::ErrorKind::NotFound);
    error.loop_ancestor().is_some() || (is_missing && error.depth() > 0)
}

/// A path without `.` and empty names.
fn normalized(path: &str) -> String {
    let root = if path.starts_with('/') { "/" } else { "" };
    let names: Vec<&str> = path.split('/').filter(|name| !name.is_empty() && *name != ".").collect();
    format!("{root}{}", names.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn matches(pattern: &str, path: &str) -> bool {
        FilePattern::new(pattern).unwrap().matches(path)
    }

    #[test]
    fn lists_matching_files_sorted() {
        let folder = tempfile::tempdir().unwrap();
        for file in ["b.xml", "a.xml", "a.txt", ".hidden.xml", "x/c.xml", "x/y/d.xml", "x/.git/e.xml"] {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        let found = |pattern: &str| FilePattern::new(pattern).unwrap().files(folder.path()).unwrap().join(" ");
        assert_eq!(found("*.xml"), "a.xml b.xml");
        assert_eq!(found("./?.xml"), "a.xml b.xml");
        assert_eq!(found("**/*.xml"), "a.xml b.xml x/c.xml x/y/d.xml");
        assert_eq!(found("x/**/d.xml"), "x/y/d.xml");
        assert_eq!(found("x/**"), "x/c.xml x/y/d.xml");
        assert_eq!(found("*/*.xml"), "x/c.xml");
        assert_eq!(found("x/.*/*.xml"), "x/.git/e.xml");
        assert_eq!(found("x/../*.txt"), "x/../a.txt");
        assert_eq!(found("a.xml"), "a.xml");
        let absolute = |name: &str| format!("{}/{name}", folder.path().display());
        assert_eq!(found(&absolute("*.txt")), absolute("a.txt"));
        assert_eq!((found("none.xml"), found("*.osm"), found("x")), (String::new(), String::new(), String::new()));
        assert!(FilePattern::new("*.xml").unwrap().files(&folder.path().join("none")).is_err());
        // the name of a file, with a wildcard in it
        std::fs::write(folder.path().join("a*.xml"), "").unwrap();
        assert_eq!(found("a*.xml"), "a*.xml");
    }

    #[cfg(unix)]
    #[test]
    fn recursive_patterns_do_not_follow_links_to_folders() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("x")).unwrap();
        std::fs::write(folder.path().join("x/a.xml"), "").unwrap();
        symlink("..", folder.path().join("x/parent")).unwrap();
        symlink("x", folder.path().join("link")).unwrap();
        symlink("nowhere", folder.path().join("dangling.xml")).unwrap();
        symlink("x/a.xml", folder.path().join("file.xml")).unwrap();
        let found = |pattern: &str| FilePattern::new(pattern).unwrap().files(folder.path()).unwrap().join(" ");
        assert_eq!(found("**/*.xml"), "file.xml x/a.xml");
        assert_eq!(found("*/*.xml"), "link/a.xml x/a.xml");
        assert_eq!(found("*.xml"), "file.xml");
    }

    #[test]
    fn matches_paths_name_by_name() {
        for (pattern, path, is) in [
            ("*.xml", "a.xml", true),
            ("*.xml", "x/a.xml", false),
            ("**/a.xml", "a.xml", true),
            ("**/a.xml", "x/y/a.xml", true),
            ("x/**", "x/y/a.xml", true),
            ("a*b*c.xml", "aXbbYc.xml", true),
            ("a*b*c.xml", "aXcY.xml", false),
            ("?.xml", "ab.xml", false),
            ("?.xml", "é.xml", true),
            ("[ab]*.xml", "a.xml", false),
            ("[ab]*.xml", "[ab]c.xml", true),
            ("*", ".a", false),
            (".*", ".a", true),
        ] {
            assert_eq!(matches(pattern, path), is, "{pattern} {path}");
        }
        assert!(FilePattern::new("a**b").is_err());
    }

    /// Every split of the name.
    fn reference(pattern: &[char], name: &[char]) -> bool {
        match pattern.split_first() {
            None => name.is_empty(),
            Some(('*', tail)) => (0..=name.len()).any(|n| reference(tail, &name[n..])),
            Some((c, tail)) => {
                name.split_first().is_some_and(|(d, name)| (*c == '?' || c == d) && reference(tail, name))
            }
        }
    }

    proptest! {
        #[test]
        fn agrees_with_the_reference(pattern in "[ab?]{0,3}(\\*[ab?]{1,2}){0,2}\\*?", name in "[ab]{1,8}") {
            let chars = |text: &str| text.chars().collect::<Vec<_>>();
            prop_assert_eq!(matches(&pattern, &name), reference(&chars(&pattern), &chars(&name)));
        }
    }
}
