//! Errors while recording and reading flights.

use std::{
    io,
    path::{Path, PathBuf},
};

use foreign::ForeignText;

/// Error while recording or reading a flight.
#[derive(Debug, thiserror::Error)]
pub enum FlightError {
    /// The file already exists, possibly as a symbolic link.
    #[error("recording to {path}: the file already exists; choose another name", path = foreign::path(path))]
    Exists {
        /// Path of the file.
        path: PathBuf,
    },
    /// The file or its folder cannot be created.
    #[error("recording to {path}: {cause}", path = foreign::path(path))]
    Create {
        /// Path of the file or folder.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
    /// Writing to the file failed.
    #[error(
        "recording to {path}: {cause}; the file ends early with a complete chunk and the system continues: free disk space or record to another path",
        path = foreign::path(path)
    )]
    WriteFailed {
        /// Path of the file.
        path: PathBuf,
        /// Error from the operating system or the MCAP library.
        cause: String,
    },
    /// The writer thread made no progress before the timeout.
    #[error("recording to {path}: no progress of the disk for {limit_s} s, pending data is lost; check the disk", path = foreign::path(path))]
    DiskTimeout {
        /// Path of the file.
        path: PathBuf,
        /// Timeout, s.
        limit_s: u64,
    },
    /// Published messages are missing from the file.
    #[error(
        "recording to {path}: {} published but not recorded, because the recorder was too slow; reduce the load of the machine",
        launch::pluralize(*missed, "message"),
        path = foreign::path(path)
    )]
    MissedMessages {
        /// Path of the file.
        path: PathBuf,
        /// Lower bound on the number of missing messages.
        missed: u64,
    },
    /// The file cannot be read.
    #[error("reading {path}: {cause}", path = foreign::path(path))]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
    /// No launch file is attached to the flight.
    #[error("reading {path}: no launch file attached; pass one: plumb up --launch LAUNCH.toml --replay {path}", path = foreign::path(path))]
    NoLaunchFile {
        /// Path of the file.
        path: PathBuf,
    },
    /// A message cannot be decoded.
    #[error("reading {path}: {cause}", path = foreign::path(path))]
    InvalidMessage {
        /// Path of the file.
        path: PathBuf,
        /// Decoding error.
        cause: wire::DecodeError,
    },
    /// The file is not a readable MCAP file.
    #[error("reading {path}: not a readable MCAP file: {cause}", path = foreign::path(path))]
    Malformed {
        /// Path of the file.
        path: PathBuf,
        /// Error from the MCAP library.
        cause: ForeignText,
    },
}

/// Returns the error for a file that cannot be created at `path`.
pub(crate) fn create_error(path: &Path, cause: io::Error) -> FlightError {
    let path = path.to_owned();
    if cause.kind() == io::ErrorKind::AlreadyExists {
        FlightError::Exists { path }
    } else {
        FlightError::Create { path, cause }
    }
}
