//! Results of an interrupted run: a file with a line of JSON per finished drive, appended as they finish.
//!
//! A line is found again by its key: a hash of everything that decides what a drive comes to ([`super::run::key`]).
//! Expectations are not in it, so they may change between two runs. The first line names the program that wrote the
//! file; another build begins anew. A last line that is cut off (the power failed, the disk was full, Ctrl-C) is taken
//! away. The file is locked while it is in use.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use super::SuiteError;
use super::run::Measured;

/// What every first line begins with, and every format of it, whatever its version.
const FIRST_BYTES: &str = "{\"format\":\"stopline.check.state/";
const FORMAT_BEFORE_VERSION: &str = "stopline.check.state/";

/// Largest file, bytes.
const MAX_BYTES: u64 = 1 << 30;

/// An open state file.
pub(super) struct State {
    path: PathBuf,
    file: Mutex<File>,
    finished: BTreeMap<String, Measured>,
}

/// The first line.
#[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
struct Header {
    format: String,
    program: String,
}

/// Every other line.
#[derive(serde::Serialize, serde::Deserialize)]
struct Line<'a> {
    key: std::borrow::Cow<'a, str>,
    measured: std::borrow::Cow<'a, Measured>,
}

impl State {
    /// Opens the file, or begins it, and reads what it has.
    pub(super) fn open(path: &Path) -> Result<Self, SuiteError> {
        let wrong = |message: String| SuiteError::State { file: path.to_owned(), message };
        let told = |what: &str, e: &dyn std::fmt::Display| wrong(format!("{what}: {e}"));
        if path.exists() && !path.is_file() {
            return Err(wrong("not a regular file".into()));
        }
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(|e| told("cannot be written", &e))?;
        file.try_lock().map_err(|e| told("in use by another run", &e))?;
        let mut bytes = Vec::new();
        (&mut file).take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(|e| told("cannot be read", &e))?;
        if bytes.len() as u64 > MAX_BYTES {
            return Err(wrong(format!("larger than {MAX_BYTES} bytes")));
        }
        let (finished, sound) = read(&bytes).map_err(wrong)?;
        file.set_len(sound as u64).map_err(|e| told("cannot be written", &e))?;
        file.seek(SeekFrom::End(0)).map_err(|e| told("cannot be written", &e))?;
        let state = Self { path: path.to_owned(), file: Mutex::new(file), finished };
        if sound == 0 {
            state.append(&Header::of_this_program())?;
        }
        Ok(state)
    }

    /// What an earlier run found.
    pub(super) fn finished(&self, key: &str) -> Option<&Measured> {
        self.finished.get(key)
    }

    /// Keeps what a drive came to.
    pub(super) fn keep(&self, key: &str, measured: &Measured) -> Result<(), SuiteError> {
        self.append(&Line { key: key.into(), measured: std::borrow::Cow::Borrowed(measured) })
    }

    /// Appends a line in one piece.
    fn append(&self, line: &impl serde::Serialize) -> Result<(), SuiteError> {
        let wrong = |e: &dyn std::fmt::Display| SuiteError::State {
            file: self.path.clone(),
            message: format!("cannot be written: {e}"),
        };
        let mut text = serde_json::to_string(line).map_err(|e| wrong(&e))?;
        text.push('\n');
        let mut file = self.file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        file.write_all(text.as_bytes()).and_then(|()| file.flush()).map_err(|e| wrong(&e))
    }
}

impl Header {
    /// Version and build: results of another build are not this one's.
    fn of_this_program() -> Self {
        let build = || {
            let about = std::fs::metadata(std::env::current_exe().ok()?).ok()?;
            let time = about.modified().ok()?.duration_since(std::time::UNIX_EPOCH).ok()?;
            Some(format!("{}-{}", about.len(), time.as_nanos()))
        };
        let program = format!("{} {}", env!("CARGO_PKG_VERSION"), build().unwrap_or_default());
        Self { format: "stopline.check.state/2".into(), program }
    }
}

/// Finished drives, and how many bytes of the text are sound.
fn read(bytes: &[u8]) -> Result<(BTreeMap<String, Measured>, usize), String> {
    let mut finished = BTreeMap::new();
    let mut sound = 0;
    for (i, line) in bytes.split_inclusive(|b| *b == b'\n').enumerate() {
        let is_last = sound + line.len() == bytes.len();
        if i == 0 {
            let is_whole = line.ends_with(b"\n");
            match serde_json::from_slice::<Header>(line) {
                Ok(header) if is_whole && header == Header::of_this_program() => {}
                Ok(header) if header.format.starts_with(FORMAT_BEFORE_VERSION) => return Ok((finished, 0)),
                // cut off while it was written
                Err(_)
                    if !is_whole && FIRST_BYTES.as_bytes().starts_with(&line[..line.len().min(FIRST_BYTES.len())]) =>
                {
                    return Ok((finished, 0));
                }
                _ => return Err("not a state of `stopline check`: it is left as it is".into()),
            }
        } else {
            match serde_json::from_slice::<Line>(line) {
                Ok(Line { key, measured }) if line.ends_with(b"\n") => {
                    finished.insert(key.into_owned(), measured.into_owned());
                }
                _ if is_last => break,
                Err(e) => return Err(format!("line {}: {e}", i + 1)),
                Ok(_) => break,
            }
        }
        sound += line.len();
    }
    Ok((finished, sound))
}
