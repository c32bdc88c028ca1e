//! Reads input files up to a size limit; writes output files atomically.
//!
//! The limit guards against inputs that never end, such as a device or a pipe: reading one is an error instead of
//! filling the memory.
//!
//! An output is written under a temporary name in the same folder, then renamed. A reader of the file never sees half of
//! it, and an interrupted program leaves the old file unchanged. Terminals, pipes and devices are written directly.

use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use super::text::TextError;

/// Why an input file could not be read, independent of its format.
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
    /// The file is larger than any valid one, or never ends.
    #[error("{}: larger than {limit} bytes, the limit for such a file", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// The limit, bytes.
        limit: u64,
    },
    /// The file is not text, or not in a known encoding.
    #[error("{}{}: {source}", path.display(), source.line().map_or_else(String::new, |line| format!(":{line}")))]
    NotText {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: TextError,
    },
}

/// Reads the bytes of a file.
///
/// # Errors
/// The file cannot be read, or has more than `limit` bytes.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>, InputError> {
    let file = std::fs::File::open(path);
    let file = file.map_err(|source| InputError::Unreadable { path: path.to_owned(), source })?;
    read_from(path, file, limit)
}

/// Reads a stream to its end; `name` stands for it in messages.
///
/// # Errors
/// The stream fails, or has more than `limit` bytes.
pub fn read_from(name: &Path, stream: impl std::io::Read, limit: u64) -> Result<Vec<u8>, InputError> {
    let mut bytes = Vec::new();
    let read = stream.take(limit.saturating_add(1)).read_to_end(&mut bytes);
    read.map_err(|source| InputError::Unreadable { path: name.to_owned(), source })?;
    if bytes.len() as u64 > limit {
        return Err(InputError::TooLarge { path: name.to_owned(), limit });
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

/// Replaces a file by new content. On an error the old file is unchanged.
///
/// # Errors
/// The folder does not exist or is not writable, the file is write-protected, or the disk is full.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
    try_write(path, bytes).map_err(|source| WriteError::new(path, source))
}

/// Checks that [`write_atomic`] can write the file, so that a long run does not fail at its end. Creates nothing.
///
/// # Errors
/// As [`write_atomic`], except for errors that occur only while writing.
pub fn check_writable(path: &Path) -> Result<(), WriteError> {
    let check = || match Target::of(path)? {
        Target::Regular(file) => temporary_beside(&file).map(drop),
        // closing a pipe would signal the end of the file to its reader
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
    std::fs::metadata(path).is_ok_and(|metadata| metadata.file_type().is_fifo())
}

#[cfg(not(unix))]
fn is_pipe(_: &Path) -> bool {
    false
}

enum Target {
    /// A regular file, existing or not, with symbolic links resolved: renaming must not replace a link.
    Regular(PathBuf),
    /// A device or pipe: renaming must not replace it.
    Special,
}

impl Target {
    fn of(path: &Path) -> std::io::Result<Self> {
        use std::io::{Error, ErrorKind};
        let metadata = match std::fs::metadata(path) {
            Ok(metadata) => metadata,
            Err(_) if path.to_string_lossy().ends_with(std::path::is_separator) => {
                return Err(Error::new(ErrorKind::IsADirectory, "is the name of a folder, expected that of a file"));
            }
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(Self::Regular(path.to_owned())),
            Err(e) => return folder_of(path).and(Err(e)),
        };
        if metadata.is_dir() {
            return Err(Error::new(ErrorKind::IsADirectory, "is a folder"));
        }
        if !metadata.is_file() {
            return Ok(Self::Special);
        }
        if metadata.permissions().readonly() {
            return Err(Error::new(ErrorKind::PermissionDenied, "is write-protected"));
        }
        path.canonicalize().map(Self::Regular)
    }
}

/// The folder of a file, if it exists.
fn folder_of(path: &Path) -> std::io::Result<&Path> {
    use std::io::{Error, ErrorKind};
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match std::fs::metadata(folder) {
        Ok(metadata) if metadata.is_dir() => Ok(folder),
        Ok(_) => Err(Error::new(ErrorKind::NotADirectory, format!("{} is not a folder", folder.display()))),
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            Err(Error::new(e.kind(), format!("there is no folder {}", folder.display())))
        }
        Err(e) => Err(e),
    }
}

/// A temporary file in the folder of `path`, with the permissions that a new file there would have.
fn temporary_beside(path: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let folder = folder_of(path)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".stopline-").suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        builder.permissions(std::fs::Permissions::from_mode(0o666)); // the umask applies
    }
    // the library's message names the temporary file, which nobody typed
    builder.tempfile_in(folder).map_err(|e| e.kind().into())
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
    fn refuses_an_input_beyond_the_limit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("in.bin");
        std::fs::write(&path, b"12345").unwrap();
        assert_eq!(read(&path, 5).unwrap(), b"12345");
        let error = read(&path, 4).unwrap_err().to_string();
        assert!(error.contains("in.bin: larger than 4 bytes"), "{error}");
        for unreadable in [folder.path().join("none"), folder.path().to_owned()] {
            let error = read(&unreadable, 5).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{}: cannot be read: ", unreadable.display())), "{error}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn refuses_an_endless_device() {
        assert!(matches!(read(Path::new("/dev/zero"), 1000), Err(InputError::TooLarge { limit: 1000, .. })));
    }

    #[test]
    fn replaces_a_file_and_leaves_no_temporary_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.json");
        check_writable(&path).unwrap();
        assert_eq!(names(folder.path()), Vec::<String>::new(), "the check leaves no file");
        write_atomic(&path, b"a long first text").unwrap();
        write_atomic(&path, b"short").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"short");
        check_writable(&path).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"short", "the check keeps the content");
        assert_eq!(names(folder.path()), ["out.json"]);
    }

    #[test]
    fn check_and_write_report_the_same_errors() {
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
        let message = |name: &str| {
            let error = check_writable(&folder.path().join(name)).unwrap_err().to_string();
            error.replace(&folder.path().join("").display().to_string(), "")
        };
        assert_eq!(message("none/out.csv"), "none/out.csv: cannot be written: there is no folder none");
        assert_eq!(message("none/too/a"), "none/too/a: cannot be written: there is no folder none/too");
        assert_eq!(message("protected/a"), "protected/a: cannot be written: protected is not a folder");
        assert_eq!(message("protected/a/b"), "protected/a/b: cannot be written: there is no folder protected/a");
        assert!(message("none/").ends_with("is the name of a folder, expected that of a file"), "{}", message("none/"));
    }

    #[cfg(unix)]
    #[test]
    fn the_check_does_not_close_a_pipe() {
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
    fn writes_through_devices_and_links() {
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
