//! A file that is there whole or not at all.
//!
//! Input: text. Output: the file, gzip where its name ends in `.gz`, that only this user may read. Failure: what the system said;
//! what had been written is taken away.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, BufWriter, ErrorKind, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
};

use flate2::{Compression, write::GzEncoder};

use crate::RecordingError;

const BUFFER_BYTES: usize = 1 << 16;

pub(crate) struct Output {
    path: PathBuf,
    /// Where it is written until it is whole; `None` once that has been put in place.
    beside: Option<PathBuf>,
    sink: Sink,
}

enum Sink {
    Plain(BufWriter<File>),
    Gzip(GzEncoder<BufWriter<File>>),
}

impl Output {
    pub(crate) fn create(path: &Path) -> Result<Self, RecordingError> {
        let failed = |cause| RecordingError::Write { path: path.to_owned(), cause };
        // A link is replaced and never followed: who planted it gets nothing.
        if let Ok(found) = fs::symlink_metadata(path)
            && !found.is_file()
            && !found.is_symlink()
        {
            return Err(failed(io::Error::other("something is there that is no file")));
        }
        let beside = unfinished(path);
        // What a writer that was killed has left there.
        match fs::remove_file(&beside) {
            Err(cause) if cause.kind() != ErrorKind::NotFound => return Err(failed(cause)),
            _ => {}
        }
        let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&beside).map_err(failed)?;
        let file = BufWriter::with_capacity(BUFFER_BYTES, file);
        let sink = if path.extension().is_some_and(|end| end == "gz") {
            Sink::Gzip(GzEncoder::new(file, Compression::default()))
        } else {
            Sink::Plain(file)
        };
        Ok(Self { path: path.to_owned(), beside: Some(beside), sink })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn write(&mut self, text: &str) -> Result<(), RecordingError> {
        let written = match &mut self.sink {
            Sink::Plain(file) => file.write_all(text.as_bytes()),
            Sink::Gzip(file) => file.write_all(text.as_bytes()),
        };
        written.map_err(|cause| self.failed(cause))
    }

    /// Puts the file in its place.
    pub(crate) fn finish(mut self) -> Result<(), RecordingError> {
        self.put_in_place().map_err(|cause| self.failed(cause))
    }

    fn put_in_place(&mut self) -> io::Result<()> {
        let file = match &mut self.sink {
            Sink::Plain(file) => file,
            Sink::Gzip(file) => {
                file.try_finish()?;
                file.get_mut()
            }
        };
        file.flush()?;
        file.get_ref().sync_all()?;
        if let Some(beside) = &self.beside {
            fs::rename(beside, &self.path)?;
            self.beside = None;
        }
        let folder = self.path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder)?.sync_all()
    }

    fn failed(&self, cause: io::Error) -> RecordingError {
        RecordingError::Write { path: self.path.clone(), cause }
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if let Some(beside) = &self.beside {
            // The next writer takes away what cannot be taken away now.
            let _ = fs::remove_file(beside);
        }
    }
}

/// Writes a file as a whole: it is there with all of the text, that only this user may read, or as it was.
pub fn write_whole(path: &Path, text: &str) -> Result<(), RecordingError> {
    let mut output = Output::create(path)?;
    output.write(text)?;
    output.finish()
}

/// Where a file is written until it is whole. Whatever lies there is taken away.
pub fn unfinished(path: &Path) -> PathBuf {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".new");
    beside.into()
}

/// The shortest decimal that reads back to the same number.
pub(crate) fn number(number: f64) -> Decimal {
    Decimal(number)
}

pub(crate) struct Decimal(f64);

impl std::fmt::Display for Decimal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self(number) = self;
        let size = number.abs();
        let is_plain = size == 0.0 || (1e-5..1e16).contains(&size) || !size.is_finite();
        if is_plain { write!(f, "{number}") } else { write!(f, "{number:e}") }
    }
}
