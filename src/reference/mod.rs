//! Reference lines.

#[cfg(test)]
pub(crate) mod tests {
    use crate::map::Scenario;
    use std::path::{Path, PathBuf};

    /// The folder of real files, if it is there; says so if not.
    pub(crate) fn real_data(kind: &str) -> Option<PathBuf> {
        let root = std::env::var_os("STOPLINE_DATA")
            .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
        let folder = root.join(kind);
        if !folder.is_dir() {
            println!("skipped: no {kind} files (set STOPLINE_DATA)");
            return None;
        }
        Some(folder)
    }

    /// All scenarios that can be read, in order of their names.
    pub(crate) fn real_scenarios(folder: &Path) -> Vec<(String, Scenario)> {
        let mut paths: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
        paths.retain(|p| p.extension().is_some_and(|e| e == "xml"));
        paths.sort();
        let name = |p: &Path| p.file_stem().unwrap().to_string_lossy().into_owned();
        paths.iter().filter_map(|p| crate::io::commonroad::read_file(p).ok().map(|s| (name(p), s))).collect()
    }
}
