//! Writes files atomically: the target is either complete or unchanged.
//!
//! Input: text.
//!
//! Output: a file with the given permissions, compressed with gzip if the name ends in `.gz`.
//!
//! Failure: the operating system error is returned, and the temporary file is removed.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, BufWriter, ErrorKind, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
};

use flate2::{Compression, write::GzEncoder};

use crate::RecordingError;

/// Permissions of recordings: only their owner may read them.
pub(crate) const OWNER_ONLY: u32 = 0o600;
const BUFFER_BYTES: usize = 1 << 16;

pub(crate) struct AtomicFile {
    path: PathBuf,
    /// Path of the temporary file; `None` once it has been renamed to the target.
    temporary: Option<PathBuf>,
    sink: Encoder,
}

enum Encoder {
    Plain(BufWriter<File>),
    Gzip(GzEncoder<BufWriter<File>>),
}

impl AtomicFile {
    /// Creates a file with the permissions `mode`, reduced by the umask.
    pub(crate) fn create(path: &Path, mode: u32) -> Result<Self, RecordingError> {
        let write_error = |cause| RecordingError::Write { path: path.to_owned(), cause };
        // A symbolic link is accepted, because the final rename replaces it instead of following
        // it.
        if let Ok(existing) = fs::symlink_metadata(path)
            && !existing.is_file()
            && !existing.is_symlink()
        {
            return Err(write_error(io::Error::other("the target exists and is not a regular file")));
        }
        let temporary = temporary_path(path);
        // Removes the remains of a writer that was killed.
        match fs::remove_file(&temporary) {
            Err(cause) if cause.kind() != ErrorKind::NotFound => return Err(write_error(cause)),
            _ => {}
        }
        let file = OpenOptions::new().write(true).create_new(true).mode(mode).open(&temporary).map_err(write_error)?;
        let file = BufWriter::with_capacity(BUFFER_BYTES, file);
        let sink = if path.extension().is_some_and(|end| end == "gz") {
            Encoder::Gzip(GzEncoder::new(file, Compression::default()))
        } else {
            Encoder::Plain(file)
        };
        Ok(Self { path: path.to_owned(), temporary: Some(temporary), sink })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn write(&mut self, text: &str) -> Result<(), RecordingError> {
        let written = match &mut self.sink {
            Encoder::Plain(file) => file.write_all(text.as_bytes()),
            Encoder::Gzip(file) => file.write_all(text.as_bytes()),
        };
        written.map_err(|cause| self.write_error(cause))
    }

    /// Flushes the file and renames it to its target.
    pub(crate) fn finish(mut self) -> Result<(), RecordingError> {
        self.commit().map_err(|cause| self.write_error(cause))
    }

    fn commit(&mut self) -> io::Result<()> {
        let file = match &mut self.sink {
            Encoder::Plain(file) => file,
            Encoder::Gzip(file) => {
                file.try_finish()?;
                file.get_mut()
            }
        };
        file.flush()?;
        file.get_ref().sync_all()?;
        if let Some(temporary) = &self.temporary {
            fs::rename(temporary, &self.path)?;
            self.temporary = None;
        }
        let folder = self.path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder)?.sync_all()
    }

    fn write_error(&self, cause: io::Error) -> RecordingError {
        RecordingError::Write { path: self.path.clone(), cause }
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        if let Some(temporary) = &self.temporary {
            // A file that cannot be removed now is removed by the next writer.
            let _ = fs::remove_file(temporary);
        }
    }
}

/// Writes a file atomically, with the permissions `mode` reduced by the umask. On failure the
/// target is unchanged.
///
/// # Errors
///
/// Returns [`RecordingError::Write`] if the file cannot be created, written or renamed.
pub fn write_atomic(path: &Path, text: &str, mode: u32) -> Result<(), RecordingError> {
    let mut output = AtomicFile::create(path, mode)?;
    output.write(text)?;
    output.finish()
}

/// Returns the temporary path used while `path` is written. The writer removes any file that exists
/// there.
pub fn temporary_path(path: &Path) -> PathBuf {
    let mut temporary = path.as_os_str().to_owned();
    temporary.push(".new");
    temporary.into()
}

/// Returns the shortest decimal text that parses to the same number.
pub(crate) fn decimal(value: f64) -> Decimal {
    Decimal(value)
}

pub(crate) struct Decimal(f64);

impl std::fmt::Display for Decimal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self(value) = self;
        let magnitude = value.abs();
        let is_plain = magnitude == 0.0 || (1e-5..1e16).contains(&magnitude) || !magnitude.is_finite();
        if is_plain { write!(f, "{value}") } else { write!(f, "{value:e}") }
    }
}
