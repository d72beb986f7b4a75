//! Errors when evaluating or writing attitudes.

use std::{io, path::PathBuf};

use hdrhistogram::CreationError;

/// Error when evaluating or writing attitudes.
#[derive(Debug, thiserror::Error)]
pub enum CollectorError {
    /// The latency histogram could not be created.
    #[error("creating the latency histogram: {0}")]
    Histogram(#[from] CreationError),
    /// The file could not be created.
    #[error("writing {path}: {cause}", path = foreign::path(path))]
    Create {
        /// Path of the file.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
    /// The file can no longer be written.
    #[error(
        "writing {path}: {cause}; the file ends early with a complete line and the run continues: free disk space or set --out to another path", path = foreign::path(path)
    )]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
}
