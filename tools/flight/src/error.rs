//! Why a flight is not recorded, or not read.

use std::{
    io,
    path::{Path, PathBuf},
};

/// Why a flight is not recorded, or not read.
#[derive(Debug, thiserror::Error)]
pub enum FlightError {
    /// The file would replace another, or a link is there.
    #[error(
        "recording to {path}: there is something of that name already, and it stays; give the recording another name"
    )]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file or its folder cannot be made.
    #[error("recording to {path}: {cause}")]
    Create {
        /// The file.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
    /// The file can be written no more.
    #[error(
        "recording to {path}: {cause}; the file ends before its time, with a whole chunk, and nothing else does: make room, or record to another place"
    )]
    Ends {
        /// The file.
        path: PathBuf,
        /// What the system answered.
        cause: String,
    },
    /// The thread that writes does not answer.
    #[error("recording to {path}: the disk took nothing for {limit_s} s, and what it has not taken is not waited for")]
    Stuck {
        /// The file.
        path: PathBuf,
        /// How long it was waited for.
        limit_s: u64,
    },
    /// What was published and is not in the file.
    #[error(
        "recording to {path}: published, but not in the file: {}; the recorder did not take them in time, as on a machine with too much to do",
        launch::pluralize(*missed, "message")
    )]
    Missed {
        /// The file.
        path: PathBuf,
        /// How many, at least.
        missed: u64,
    },
    /// The file cannot be read.
    #[error("reading {path}: {cause}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
    /// It has no launch file.
    #[error("reading {path}: no launch file is attached to it; name one: plumb up LAUNCH.toml --replay {path}")]
    NoLaunchFile {
        /// The file.
        path: PathBuf,
    },
    /// A message that is none.
    #[error("reading {path}: {cause}")]
    Message {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        cause: wire::DecodeError,
    },
    /// It is an MCAP file whose content makes no sense.
    #[error("reading {path}: it is no MCAP file that can be read: {cause}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        cause: mcap::McapError,
    },
}

/// What the system answered when the file at `path` was to be made.
pub(crate) fn creating(path: &Path, cause: io::Error) -> FlightError {
    let path = path.to_owned();
    if cause.kind() == io::ErrorKind::AlreadyExists {
        FlightError::Exists { path }
    } else {
        FlightError::Create { path, cause }
    }
}
