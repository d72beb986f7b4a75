//! Errors of the bus.

use std::{io, path::PathBuf};

use crate::limits::{MAX_OBSERVERS, Mib, OPEN_FILES_REMEDY, REQUIRED_OPEN_FILES, SHARED_MEMORY_REMEDY, SharedMemory};

/// Error of a bus operation.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The name cannot be part of a file name.
    #[error("invalid system name {name:?}: use 1 to 32 characters of a-z, 0-9, - and _")]
    InvalidName {
        /// Requested name.
        name: String,
    },
    /// Another supervisor holds the name.
    #[error(
        "starting the system {name:?}: a system of this name is already running{hint} or set another `name` in launch.toml"
    )]
    NameInUse {
        /// Requested name.
        name: String,
        /// The running process, if known, and how to stop it.
        hint: String,
    },
    /// Services of an earlier run are still running.
    #[error(
        "starting the system {name:?}: services of an earlier run are still running; end them (pkill -KILL -f 'plumb service')"
    )]
    Lingering {
        /// Requested name.
        name: String,
    },
    /// A file of the system belongs to another user or is accessible to others.
    #[error(
        "using {path:?}: {why}; it was left unchanged: {hint}remove it if it is not needed (sudo rm -r {path:?}), or set another `name` in launch.toml"
    )]
    ForeignFile {
        /// Path of the file or folder.
        path: PathBuf,
        /// Problem with the file.
        why: String,
        /// Advice if another user's system may be running; empty if the file belongs to this user.
        hint: String,
    },
    /// A file or folder of the bus could not be used.
    #[error("{doing} {path:?}: {cause}; check that it belongs to this user and that there is free space")]
    File {
        /// Operation that failed.
        doing: &'static str,
        /// Path of the file or folder.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
    /// The system is not running.
    #[error("joining the system {name:?}: it is not running; start it with `plumb up`")]
    NotRunning {
        /// System name.
        name: String,
    },
    /// The shared state of the system was truncated or overwritten.
    #[error(
        "the shared state of the system was damaged ({path:?}), so its ticks are unknown; restart the system with `plumb up`"
    )]
    SharedStateDamaged {
        /// Path of the shared state.
        path: PathBuf,
    },
    /// The system is running, but its files were removed, so no process can join.
    #[error(
        "joining the system {name:?}: its files were removed while it is running (processes {pids:?}); it recovers by itself when a service ends or is swapped"
    )]
    FilesRemoved {
        /// System name.
        name: String,
        /// Process IDs of the system.
        pids: Vec<u32>,
    },
    /// The limit on open files is too low.
    #[error(
        "joining a system: its processes need up to {} open files, but only {allowed} are allowed; {}",
        REQUIRED_OPEN_FILES,
        OPEN_FILES_REMEDY
    )]
    OpenFileLimit {
        /// Open-file limit of this process.
        allowed: u64,
    },
    /// Not enough shared memory is free.
    #[error(
        "starting the system {name:?}: its topics need {needed} of shared memory, but {memory}; {}, or lower buffer_s in launch.toml",
        SHARED_MEMORY_REMEDY
    )]
    SharedMemory {
        /// System name.
        name: String,
        /// Required memory.
        needed: Mib,
        /// Available memory.
        memory: SharedMemory,
    },
    /// iceoryx2 could not create a node or list the existing ones.
    #[error("joining the bus of {name:?}: {cause}")]
    Node {
        /// System name.
        name: String,
        /// iceoryx2 error.
        cause: String,
    },
    /// The system has the maximum number of observers.
    #[error(
        "observing the system {name:?}: {} observers are attached already, which is the maximum; end one (`plumb top`, `plumb topic`): processes {pids:?}",
        MAX_OBSERVERS
    )]
    TooManyObservers {
        /// System name.
        name: String,
        /// Process IDs of the observers that belong to this user.
        pids: Vec<u32>,
    },
    /// A process was killed or has stalled while creating a segment, so the segment cannot be
    /// opened.
    #[error(
        "observing the system {name:?}: {path:?} is incomplete: its creator was killed or has stalled; restart the system"
    )]
    IncompleteSegment {
        /// System name.
        name: String,
        /// Path of the incomplete segment.
        path: PathBuf,
    },
    /// The topic has no publisher and no subscriber.
    #[error("opening the topic `{topic}`: no service of the system has opened it")]
    TopicNotOpen {
        /// Topic name.
        topic: &'static str,
    },
    /// The topic was created by a different version of the program, with a different payload
    /// layout.
    #[error(
        "opening the topic `{topic}`: the layout on the bus differs\n  here:  {here}\n  there: {there}\nrun a single version of plumb"
    )]
    LayoutMismatch {
        /// Topic name.
        topic: &'static str,
        /// Layout that this program expects.
        here: String,
        /// Layout with which the topic was created.
        there: String,
    },
    /// The topic was created with a smaller buffer than requested.
    #[error(
        "opening the topic `{topic}`: it was created with a buffer of {there} messages per subscriber, but {here} are requested; every publisher and subscriber of a path topic must request buffer_s x rate_hz of the launch file, rounded up, and at least 256"
    )]
    BufferMismatch {
        /// Topic name.
        topic: &'static str,
        /// Number of buffered messages that this process requested.
        here: usize,
        /// Number of messages that the topic buffers.
        there: usize,
    },
    /// The topic could not be opened.
    #[error("opening the topic `{topic}`: {cause}")]
    Topic {
        /// Topic name.
        topic: &'static str,
        /// iceoryx2 error.
        cause: String,
    },
    /// A message could not be sent.
    #[error("publishing on the topic `{topic}`: {cause}")]
    Send {
        /// Topic name.
        topic: &'static str,
        /// iceoryx2 error.
        cause: String,
    },
    /// A message could not be received.
    #[error("reading the topic `{topic}`: {cause}")]
    Receive {
        /// Topic name.
        topic: &'static str,
        /// iceoryx2 error.
        cause: String,
    },
}
