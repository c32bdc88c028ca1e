//! The state of a run: a file with a line of JSON per finished drive, appended when the drive finishes.
//!
//! The key of a line is the hash of all inputs of the drive ([`super::run::key`]). Expectations are not a part of it, so
//! they may change between two runs. The first line names the program that wrote the file; another build starts a new
//! file. An incomplete last line (power failure, full disk, killed process) is removed. The file is locked while it is in
//! use.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use super::SuiteError;
use super::run::Measured;
use crate::io::files;

/// The start of the first line, for every version of the format.
const FIRST_BYTES: &str = "{\"format\":\"stopline.check.state/";
/// The format without its version.
const FORMAT_PREFIX: &str = "stopline.check.state/";

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

/// The line of a finished drive.
#[derive(serde::Serialize, serde::Deserialize)]
struct Line<'a> {
    key: std::borrow::Cow<'a, str>,
    measured: std::borrow::Cow<'a, Measured>,
}

impl State {
    /// Opens or creates the file and reads the finished drives.
    pub(super) fn open(path: &Path) -> Result<Self, SuiteError> {
        let wrong = |message: String| SuiteError::State { file: path.to_owned(), message };
        let failed = |what: &str, e: &dyn std::fmt::Display| wrong(format!("{what}: {e}"));
        if path.exists() && !path.is_file() {
            return Err(wrong("not a regular file".into()));
        }
        files::check_writable(path).map_err(|e| failed("cannot be written", &e.source))?;
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(|e| failed("cannot be written", &e))?;
        file.try_lock().map_err(|e| failed("in use by another run", &e))?;
        let mut bytes = Vec::new();
        (&mut file).take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(|e| failed("cannot be read", &e))?;
        if bytes.len() as u64 > MAX_BYTES {
            return Err(wrong(format!("larger than {MAX_BYTES} bytes")));
        }
        let (finished, valid) = read(&bytes).map_err(wrong)?;
        file.set_len(valid as u64).map_err(|e| failed("cannot be written", &e))?;
        file.seek(SeekFrom::End(0)).map_err(|e| failed("cannot be written", &e))?;
        let state = Self { path: path.to_owned(), file: Mutex::new(file), finished };
        if valid == 0 {
            state.append(&Header::of_this_program())?;
        }
        Ok(state)
    }

    /// The stored result of a drive.
    pub(super) fn finished(&self, key: &str) -> Option<&Measured> {
        self.finished.get(key)
    }

    /// Stores the result of a drive.
    pub(super) fn append_drive(&self, key: &str, measured: &Measured) -> Result<(), SuiteError> {
        self.append(&Line { key: key.into(), measured: std::borrow::Cow::Borrowed(measured) })
    }

    /// Appends a line with one write.
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
    /// Version and build: the results of another build may differ.
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

/// The finished drives and the number of valid bytes.
fn read(bytes: &[u8]) -> Result<(BTreeMap<String, Measured>, usize), String> {
    let mut finished = BTreeMap::new();
    let mut valid = 0;
    for (i, line) in bytes.split_inclusive(|b| *b == b'\n').enumerate() {
        let is_last = valid + line.len() == bytes.len();
        if i == 0 {
            let is_whole = line.ends_with(b"\n");
            match serde_json::from_slice::<Header>(line) {
                Ok(header) if is_whole && header == Header::of_this_program() => {}
                Ok(header) if header.format.starts_with(FORMAT_PREFIX) => return Ok((finished, 0)),
                // the write of the first line was interrupted
                Err(_)
                    if !is_whole && FIRST_BYTES.as_bytes().starts_with(&line[..line.len().min(FIRST_BYTES.len())]) =>
                {
                    return Ok((finished, 0));
                }
                _ => return Err("not a state file of `stopline check`; the file is unchanged".into()),
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
        valid += line.len();
    }
    Ok((finished, valid))
}
