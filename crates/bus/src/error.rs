use std::{io, path::PathBuf};

use crate::machine_limits::{FILES, MORE_FILES, MORE_MEMORY, Mib, SharedMemory};

/// Why the bus could not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The name cannot be part of a file's name.
    #[error("naming a system: {name:?} is not a name; use 1 to 32 of a-z, 0-9, - and _")]
    Name {
        /// The name asked for.
        name: String,
    },
    /// Another supervisor holds the name.
    #[error("starting the system {name:?}: one of that name already runs{owner}, or set another `name` in launch.toml")]
    Taken {
        /// The name asked for.
        name: String,
        /// Who holds it, and how to stop it.
        owner: String,
    },
    /// Services of an earlier run still live.
    #[error(
        "starting the system {name:?}: services of an earlier run still live; end them (pkill -KILL -f 'plumb service')"
    )]
    Lingering {
        /// The name asked for.
        name: String,
    },
    /// Something that carries the name of a system is not this user's alone.
    #[error(
        "using {path}: {why}; it is left as it is: {their_own}remove it where nobody needs it (sudo rm -r {path}), or set another `name` in launch.toml"
    )]
    NotOurs {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
        /// What to do where another user's system runs; empty where it is this user's.
        their_own: String,
    },
    /// The page of wake words, or the folder of the bus.
    #[error("{doing} {path}: {cause}; check that it belongs to this user and that there is space")]
    File {
        /// What was being done.
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
    /// A service was started without its system.
    #[error("joining the system {name:?}: it does not run; start it with `plumb up`")]
    NotRunning {
        /// The system's name.
        name: String,
    },
    /// It runs, and nobody can join it.
    #[error(
        "joining the system {name:?}: somebody removed its files while it runs (processes {pids:?}); it starts anew by itself once a service ends or is swapped"
    )]
    FilesRemoved {
        /// The system's name.
        name: String,
        /// Its processes.
        pids: Vec<u32>,
    },
    /// Too few files may be open.
    #[error(
        "joining a system: a process of it has up to {} files open, this one may have {allowed}; {}",
        FILES,
        MORE_FILES
    )]
    Files {
        /// The limit.
        allowed: u64,
    },
    /// Too little shared memory is free.
    #[error(
        "starting the system {name:?}: its topics need {needed} of shared memory, {memory}; {}, or lower buffer_s in launch.toml",
        MORE_MEMORY
    )]
    Memory {
        /// The system's name.
        name: String,
        /// What it needs.
        needed: Mib,
        /// What there is.
        memory: SharedMemory,
    },
    /// The node could not be made.
    #[error("joining the bus of {name:?}: {cause}")]
    Node {
        /// The system's name.
        name: String,
        /// What iceoryx2 answered.
        cause: String,
    },
    /// Every place of an observer is taken.
    #[error(
        "observing the system {name:?}: {} observers look at it already, more could crowd out its services; end one (`plumb top`, `plumb topic`): processes {pids:?}",
        crate::OBSERVERS
    )]
    Crowded {
        /// The system's name.
        name: String,
        /// The observers, as far as they are this user's.
        pids: Vec<u32>,
    },
    /// A process was killed while it made a segment; nobody can open it.
    #[error("observing the system {name:?}: a process was killed while it made {path}; start the system anew")]
    HalfMade {
        /// The system's name.
        name: String,
        /// The segment.
        path: PathBuf,
    },
    /// Nobody publishes or reads the topic.
    #[error("opening the topic `{topic}`: no service of the system has opened it")]
    Unopened {
        /// The topic.
        topic: &'static str,
    },
    /// Both sides of a topic were built from different sources.
    #[error(
        "opening the topic `{topic}`: another layout is on the bus\n  here:  {here}\n  there: {there}\nrun one version of plumb only"
    )]
    Layout {
        /// The topic.
        topic: &'static str,
        /// Our layout.
        here: String,
        /// The layout of whoever created the topic.
        there: String,
    },
    /// Whoever opened the topic first had it hold less.
    #[error(
        "opening the topic `{topic}`: it was opened first with room for {there} messages for each reader, here {here} are asked for; every program that publishes or reads a topic of the path asks for buffer_s x rate_hz of the launch file, rounded up, and for 256 at least"
    )]
    Buffer {
        /// The topic.
        topic: &'static str,
        /// Messages asked for here.
        here: usize,
        /// Messages that the topic holds.
        there: usize,
    },
    /// The topic could not be opened.
    #[error("opening the topic `{topic}`: {cause}")]
    Topic {
        /// The topic.
        topic: &'static str,
        /// What iceoryx2 answered.
        cause: String,
    },
    /// A message could not be sent.
    #[error("publishing on the topic `{topic}`: {cause}")]
    Send {
        /// The topic.
        topic: &'static str,
        /// What iceoryx2 answered.
        cause: String,
    },
    /// A message could not be received.
    #[error("reading the topic `{topic}`: {cause}")]
    Receive {
        /// The topic.
        topic: &'static str,
        /// What iceoryx2 answered.
        cause: String,
    },
}
