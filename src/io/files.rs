//! Input files that end, and output files that are whole or not there.
//!
//! Inputs are read up to a limit: what never ends (a device, a pipe) is told, not read until the memory is full.
//!
//! Outputs are written under a temporary name in the same folder, then renamed. A reader of the file never sees half of
//! it, and a program that is stopped leaves the old file as it was. What is not a regular file (a terminal, a pipe, the
//! null device) is written to directly.

use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

/// Why an input file could not be read, whatever is in it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InputError {
    /// The operating system refused.
    #[error("{}: cannot be read: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: std::io::Error,
    },
    /// The file is larger than any sound one, or never ends.
    #[error("{}: larger than {limit} bytes, expected no more of such a file", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// The limit, bytes.
        limit: u64,
    },
}

/// The bytes of an input file.
///
/// # Errors
/// The file cannot be read, or has more than `limit` bytes.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>, InputError> {
    let unreadable = |source| InputError::Unreadable { path: path.to_owned(), source };
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(unreadable)?;
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > limit {
        return Err(InputError::TooLarge { path: path.to_owned(), limit });
    }
    Ok(bytes)
}

/// Why a file could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: cannot be written: {source}", path.display())]
pub struct WriteError {
    /// The file.
    pub path: PathBuf,
    /// The reason.
    pub source: std::io::Error,
}

impl WriteError {
    fn new(path: &Path, source: std::io::Error) -> Self {
        Self { path: path.to_owned(), source }
    }
}

/// Writes the file whole, or leaves what was there.
///
/// # Errors
/// The folder does not exist or is not writable, the file is write-protected, the disk is full.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
    try_write(path, bytes).map_err(|source| WriteError::new(path, source))
}

/// Whether [`write_atomic`] would find its way, so that a run of minutes does not fail at its end.
///
/// # Errors
/// As [`write_atomic`], but for what happens only while writing.
pub fn check_writable(path: &Path) -> Result<(), WriteError> {
    let check = || match Target::of(path)? {
        Target::Regular(file) => temporary_beside(&file).map(drop),
        // opening a pipe and closing it again would be the end of the text to its reader
        Target::Special if is_pipe(path) => Ok(()),
        Target::Special => std::fs::OpenOptions::new().write(true).open(path).map(drop),
    };
    check().map_err(|source| WriteError::new(path, source))
}

fn try_write(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    match Target::of(path)? {
        Target::Regular(file) => {
            let mut temporary = temporary_beside(&file)?;
            temporary.write_all(bytes)?;
            temporary.as_file().sync_all()?;
            temporary.persist(&file).map(drop).map_err(|e| e.error)
        }
        Target::Special => std::fs::OpenOptions::new().write(true).open(path)?.write_all(bytes),
    }
}

#[cfg(unix)]
fn is_pipe(path: &Path) -> bool {
    use std::os::unix::fs::FileTypeExt as _;
    std::fs::metadata(path).is_ok_and(|about| about.file_type().is_fifo())
}

#[cfg(not(unix))]
fn is_pipe(_: &Path) -> bool {
    false
}

enum Target {
    /// A file, there or not yet, with symbolic links followed: renaming must not replace the link.
    Regular(PathBuf),
    /// A device or pipe: renaming must not replace it.
    Special,
}

impl Target {
    fn of(path: &Path) -> std::io::Result<Self> {
        use std::io::{Error, ErrorKind};
        let about = match std::fs::metadata(path) {
            Ok(about) => about,
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(Self::Regular(path.to_owned())),
            Err(e) => return Err(e),
        };
        if about.is_dir() {
            return Err(Error::new(ErrorKind::IsADirectory, "is a folder"));
        }
        if !about.is_file() {
            return Ok(Self::Special);
        }
        if about.permissions().readonly() {
            return Err(Error::new(ErrorKind::PermissionDenied, "is write-protected"));
        }
        path.canonicalize().map(Self::Regular)
    }
}

/// A temporary file in the folder of `path`, with the permissions that a new file there would have.
fn temporary_beside(path: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".stopline-").suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        builder.permissions(std::fs::Permissions::from_mode(0o666)); // less what the user's mask takes away
    }
    builder.tempfile_in(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn an_input_is_read_up_to_its_limit_and_named_beyond_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("in.bin");
        std::fs::write(&path, b"12345").unwrap();
        assert_eq!(read(&path, 5).unwrap(), b"12345");
        let error = read(&path, 4).unwrap_err().to_string();
        assert!(error.contains("in.bin: larger than 4 bytes"), "{error}");
        for none in [folder.path().join("none"), folder.path().to_owned()] {
            let error = read(&none, 5).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{}: cannot be read: ", none.display())), "{error}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_device_that_never_ends_is_told() {
        assert!(matches!(read(Path::new("/dev/zero"), 1000), Err(InputError::TooLarge { limit: 1000, .. })));
    }

    #[test]
    fn a_file_is_replaced_whole_and_nothing_else_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.json");
        check_writable(&path).unwrap();
        assert_eq!(names(folder.path()), Vec::<String>::new(), "the check leaves nothing");
        write_atomic(&path, b"a long first text").unwrap();
        write_atomic(&path, b"short").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"short");
        check_writable(&path).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"short", "the check changes nothing");
        assert_eq!(names(folder.path()), ["out.json"]);
    }

    #[test]
    fn what_cannot_be_written_is_named_by_check_and_write_alike() {
        let folder = tempfile::tempdir().unwrap();
        let protected = folder.path().join("protected");
        std::fs::write(&protected, "old").unwrap();
        let mut permissions = std::fs::metadata(&protected).unwrap().permissions();
        permissions.set_readonly(true);
        std::fs::set_permissions(&protected, permissions).unwrap();
        let cases =
            [folder.path().join("none/out.csv"), folder.path().to_owned(), protected.clone(), protected.join("x")];
        for path in cases {
            let (check, write) = (check_writable(&path).unwrap_err(), write_atomic(&path, b"new").unwrap_err());
            assert!(check.to_string().contains(&path.display().to_string()), "{check}");
            assert_eq!(check.source.kind(), write.source.kind(), "{}", path.display());
        }
        assert_eq!(std::fs::read(&protected).unwrap(), b"old");
    }

    #[cfg(unix)]
    #[test]
    fn the_check_of_a_pipe_is_not_the_end_of_it_to_its_reader() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = {
            let pipe = pipe.clone();
            std::thread::spawn(move || std::fs::read(pipe).unwrap())
        };
        check_writable(&pipe).unwrap();
        write_atomic(&pipe, b"all of it").unwrap();
        assert_eq!(reader.join().unwrap(), b"all of it");
    }

    #[cfg(unix)]
    #[test]
    fn devices_and_links_are_written_through_never_replaced() {
        use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _, symlink};
        write_atomic(Path::new("/dev/null"), b"gone").unwrap();
        assert!(std::fs::metadata("/dev/null").unwrap().file_type().is_char_device());
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        std::fs::write(&real, "old").unwrap();
        symlink(&real, &link).unwrap();
        write_atomic(&link, b"new").unwrap();
        assert!(std::fs::symlink_metadata(&link).unwrap().file_type().is_symlink());
        assert_eq!(std::fs::read(&real).unwrap(), b"new");
        assert_eq!(std::fs::metadata(&real).unwrap().permissions().mode() & 0o400, 0o400);
    }
}
