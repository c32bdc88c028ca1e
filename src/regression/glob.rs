//! Files by pattern: `*` and `?` within a name, `**` for any number of folders. Sorted, so that the same folder gives the
//! same list everywhere.
//!
//! Names that begin with a dot are met only by a pattern that has the dot. What `**` passes through is folders, not
//! symbolic links to them: it always ends.

use std::path::{Path, PathBuf};

/// Most folders that `**` may pass through: a pattern at the root of a disk is a mistake.
const MOST_FOLDERS: usize = 100_000;

/// The files below `folder` that match, as paths relative to it with `/` between names, sorted. A pattern without
/// wildcards is the file of that name, if it is there.
pub(super) fn files(folder: &Path, pattern: &str) -> std::io::Result<Vec<String>> {
    if !pattern.contains(['*', '?']) || folder.join(pattern).is_file() {
        return Ok(if folder.join(pattern).is_file() { vec![pattern.to_owned()] } else { Vec::new() });
    }
    let parts: Vec<&str> = pattern.split('/').filter(|part| !part.is_empty() && *part != ".").collect();
    let start = if pattern.starts_with('/') { "/" } else { "" };
    let mut search = Search { folder, found: Vec::new(), folders: 0 };
    search.descend(start, &parts)?;
    search.found.sort();
    search.found.dedup();
    Ok(search.found)
}

/// Whether a relative path matches a pattern.
pub(super) fn matches(pattern: &str, path: &str) -> bool {
    let parts =
        |text: &'_ str| text.split('/').filter(|p| !p.is_empty() && *p != ".").map(str::to_owned).collect::<Vec<_>>();
    path_matches(&parts(pattern), &parts(path))
}

fn path_matches(pattern: &[String], path: &[String]) -> bool {
    match (pattern.split_first(), path.split_first()) {
        (None, None) => true,
        (Some((first, rest)), _) if first == "**" => {
            path_matches(rest, path) || path.split_first().is_some_and(|(_, deeper)| path_matches(pattern, deeper))
        }
        (Some((first, rest)), Some((name, deeper))) => name_matches(first, name) && path_matches(rest, deeper),
        _ => false,
    }
}

/// Whether a name matches a pattern of one name. The last `*` takes more as long as what follows does not fit.
fn name_matches(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    if name.first() == Some(&'.') && pattern.first() != Some(&'.') {
        return false;
    }
    let (mut p, mut n) = (0, 0);
    let mut star: Option<(usize, usize)> = None;
    while n < name.len() {
        match pattern.get(p) {
            Some('*') => {
                star = Some((p, n));
                p += 1;
            }
            Some(c) if *c == '?' || *c == name[n] => (p, n) = (p + 1, n + 1),
            _ => {
                let Some((at, taken)) = star else { return false };
                (p, n) = (at + 1, taken + 1);
                star = Some((at, taken + 1));
            }
        }
    }
    pattern[p..].iter().all(|c| *c == '*')
}

struct Search<'a> {
    folder: &'a Path,
    found: Vec<String>,
    folders: usize,
}

impl Search<'_> {
    fn descend(&mut self, at: &str, parts: &[&str]) -> std::io::Result<()> {
        let Some((first, rest)) = parts.split_first() else { return Ok(()) };
        if *first == ".." {
            return self.descend(&join(at, ".."), rest);
        }
        if *first == "**" {
            self.descend(at, rest)?;
        }
        for (name, kind) in self.entries(at)? {
            let path = join(at, &name);
            if *first == "**" {
                if kind.is_dir() && !name.starts_with('.') {
                    self.descend(&path, parts)?;
                }
            } else if name_matches(first, &name) {
                if !rest.is_empty() {
                    if self.folder.join(&path).is_dir() {
                        self.descend(&path, rest)?;
                    }
                } else if self.folder.join(&path).is_file() {
                    self.found.push(path);
                }
            }
        }
        Ok(())
    }

    fn entries(&mut self, at: &str) -> std::io::Result<Vec<(String, std::fs::FileType)>> {
        self.folders += 1;
        if self.folders > MOST_FOLDERS {
            return Err(std::io::Error::other(format!("the pattern passes through more than {MOST_FOLDERS} folders")));
        }
        let entries: std::io::Result<Vec<_>> = std::fs::read_dir(self.folder.join(at))?.collect();
        let mut named = Vec::new();
        for entry in entries? {
            if let Ok(name) = entry.file_name().into_string() {
                named.push((name, entry.file_type()?));
            }
        }
        named.sort_by(|a, b| a.0.cmp(&b.0));
        Ok(named)
    }
}

fn join(at: &str, name: &str) -> String {
    PathBuf::from(at).join(name).to_string_lossy().replace(std::path::MAIN_SEPARATOR, "/")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn files_come_sorted_from_every_depth_that_the_pattern_reaches() {
        let folder = tempfile::tempdir().unwrap();
        for file in ["b.xml", "a.xml", "a.txt", ".hidden.xml", "x/c.xml", "x/y/d.xml", "x/.git/e.xml"] {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        let found = |pattern: &str| files(folder.path(), pattern).unwrap().join(" ");
        assert_eq!(found("*.xml"), "a.xml b.xml");
        assert_eq!(found("./?.xml"), "a.xml b.xml");
        assert_eq!(found("**/*.xml"), "a.xml b.xml x/c.xml x/y/d.xml");
        assert_eq!(found("x/**/d.xml"), "x/y/d.xml");
        assert_eq!(found("*/*.xml"), "x/c.xml");
        assert_eq!(found("x/../*.txt"), "x/../a.txt");
        assert_eq!(found("a.xml"), "a.xml");
        assert_eq!((found("none.xml"), found("*.osm"), found("x")), (String::new(), String::new(), String::new()));
        assert!(files(&folder.path().join("none"), "*.xml").is_err());
        // a file whose name has a wildcard is itself
        std::fs::write(folder.path().join("a*.xml"), "").unwrap();
        assert_eq!(found("a*.xml"), "a*.xml");
    }

    #[test]
    fn a_path_is_matched_name_by_name() {
        for (pattern, path, is) in [
            ("*.xml", "a.xml", true),
            ("*.xml", "x/a.xml", false),
            ("**/a.xml", "a.xml", true),
            ("**/a.xml", "x/y/a.xml", true),
            ("x/**", "x/y/a.xml", true),
            ("a*b*c.xml", "aXbbYc.xml", true),
            ("a*b*c.xml", "aXcY.xml", false),
            ("?.xml", "ab.xml", false),
            ("*", ".a", false),
            (".*", ".a", true),
        ] {
            assert_eq!(matches(pattern, path), is, "{pattern} {path}");
        }
    }

    /// Every split of the name, the slow way.
    fn slowly(pattern: &[char], name: &[char]) -> bool {
        match pattern.split_first() {
            None => name.is_empty(),
            Some(('*', rest)) => (0..=name.len()).any(|n| slowly(rest, &name[n..])),
            Some((c, rest)) => {
                name.split_first().is_some_and(|(d, after)| (*c == '?' || c == d) && slowly(rest, after))
            }
        }
    }

    proptest! {
        #[test]
        fn the_quick_way_agrees_with_every_split(pattern in "[ab*?]{0,7}", name in "[ab]{0,8}") {
            let chars = |text: &str| text.chars().collect::<Vec<_>>();
            prop_assert_eq!(name_matches(&pattern, &name), slowly(&chars(&pattern), &chars(&name)));
        }
    }
}
