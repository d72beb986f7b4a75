//! The supervisor: `plumb up`.
//!
//! Input: a launch file and what the command line adds to it. Output: a running system, its attitude, and how it went. Time: the
//! clock, for deadlines and for what people see. Failure: a service that ends is started again where it was; one that cannot
//! live ends the system, or stays away, as the launch file has it.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`plan`] | what is to run, checked before anything starts |
//! | [`system`] | the services as processes on the bus |
//! | [`in_process`] | the same slots in this process, without the bus |
//! | [`collector`], `out` | what becomes of the attitude: accuracy, latency; the file |
//! | [`report`] | how it went, for scripts and for people |
//! | `crew`, `lives`, `memory` | the processes; when one is started again; from where it goes on |
//! | `warm` | what outlives a stop of the whole system |
//! | `cleaner` | what killed services leave on the bus |
//! | `damage` | whether who starts can still join the bus |
//! | `urgency` | which process runs first |
//! | `exchange` | who owns a slot, and how it changes hands |
//! | `door` | the socket at which others ask |
//! | `view` | the terminal |
//! | `notify` | what the service manager is told |
mod cleaner;
pub mod collector;
mod crew;
mod damage;
mod door;
mod exchange;
pub mod in_process;
mod lives;
mod memory;
mod notify;
mod out;
pub mod plan;
pub mod report;
pub mod system;
mod urgency;
mod view;
mod warm;
mod watch;

use std::{
    io::{self, Write},
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
};

use bus::BusError;
use ingest::source::SourceError;
use launch::{LaunchError, Service};
use recording::RecordingError;
use runtime::RuntimeError;

pub use collector::Record;
pub use crew::Standing;
pub use door::{Ask, DoorError, ask};
pub use exchange::{SwapReport, Wish};
pub use plan::{Plan, Request};
pub use report::Report;
pub use swap::Outcome;

/// Runs what was asked for, to its end. What did not run is an error; of what did there is a report, which may have one too.
pub fn up(request: &Request) -> Result<Report, UpError> {
    // From here on a signal ends it with a report.
    let ends = asked_to_end()?;
    let plan = Plan::new(request)?;
    if request.in_process { in_process::run(&plan, &ends) } else { system::run(&plan, ends) }
}

/// Prints a line for people. One that nobody reads any more does not stop a system.
pub fn tell(line: impl std::fmt::Display) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Becomes true when a person or the system asks for the end.
fn asked_to_end() -> Result<Arc<AtomicBool>, UpError> {
    let asked = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, asked.clone())
            .map_err(|cause| UpError::System { doing: "catching signals".into(), cause })?;
    }
    Ok(asked)
}

/// Why a system did not run, or did not run to its end.
#[derive(Debug, thiserror::Error)]
pub enum UpError {
    /// The launch file is wrong.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The recording is wrong.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The source is wrong.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A slot could not be filled.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// A service ended by itself.
    #[error("the service {service} (process {pid}) {how}; the system was stopped{said}")]
    ServiceEnded {
        /// Which one.
        service: Service,
        /// Its process.
        pid: u32,
        /// How it ended.
        how: String,
        /// What it said last, on lines of its own.
        said: String,
    },
    /// What was asked for needs all slots on this host.
    #[error("splitting the system over hosts: {why}; run it live, from \"sim\" or \"bus\"")]
    Split {
        /// Why it cannot be.
        why: &'static str,
    },
    /// The attitude would be written over the recording.
    #[error("writing {path}: that is the recording itself; give --out another name")]
    OutIsReplay {
        /// The file.
        path: PathBuf,
    },
    /// The files of the bus were removed while the system ran.
    #[error("{path} was removed while the system ran, so nobody who starts can join it")]
    Damaged {
        /// One of them.
        path: PathBuf,
    },
    /// A process could not be started or asked.
    #[error("{doing}: {cause}")]
    System {
        /// What was being done.
        doing: String,
        /// What the system answered.
        cause: io::Error,
    },
    /// The file for the attitude cannot be made.
    #[error("writing {path}: {cause}")]
    Out {
        /// The file.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
    /// The attitude can be written no more.
    #[error(
        "writing {path}: {cause}; the file ends before its time, with a whole line, and nothing else does: make room, or give --out another place"
    )]
    OutEnds {
        /// The file.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
    /// Ticks without an attitude.
    #[error(
        "{lost} of {ticks_in} ticks never came out: a service did not answer, or came back too late for what its topics hold"
    )]
    Lost {
        /// How many.
        lost: u64,
        /// Of how many.
        ticks_in: u64,
    },
    /// Attitudes that were published and not taken by the supervisor.
    #[error(
        "{not_recorded} attitudes were published and are neither in this report's figures nor in the file of --out: the supervisor did not take them within buffer_s, as if it had been stopped"
    )]
    NotRecorded {
        /// How many.
        not_recorded: u64,
    },
}

impl UpError {
    /// The exit code of `plumb`: 3 when the configuration or an input file is wrong, 2 when the command line is, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Launch(_) | Self::Recording(_) | Self::Source(_) => 3,
            Self::OutIsReplay { .. } | Self::Split { .. } => 2,
            _ => 1,
        }
    }
}
