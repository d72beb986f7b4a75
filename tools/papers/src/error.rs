//! Errors from reproducing a paper.

use std::{error::Error, io, path::PathBuf};

use thiserror::Error;

/// Error from reproducing a paper.
#[derive(Debug, Error)]
pub enum PaperError {
    /// A file or folder cannot be written.
    #[error("cannot write {path}: {cause}; choose another folder with --out", path = foreign::path(path))]
    Write {
        /// Path of the file or folder.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// The section of a previously reproduced paper cannot be read, so the index page cannot be
    /// composed.
    #[error("cannot read {path} for the index page: {cause}; reproduce that paper again or delete the file", path = foreign::path(path))]
    Read {
        /// Path of the section file.
        path: PathBuf,
        /// Error of the operating system, or the size limit that the file exceeds.
        cause: io::Error,
    },
    /// A figure or table cannot be drawn.
    #[error("cannot draw {picture}: {cause}")]
    Draw {
        /// Name of the figure or table.
        picture: &'static str,
        /// Error of the drawing library.
        cause: Box<dyn Error + Send + Sync>,
    },
}
