//! The supervisor: `plumb up`.
//!
//! Input: a launch file and what the command line adds to it. Output: a running system, its attitude, and how it went. Time: the
//! clock, for deadlines and for what people see. Failure: a service that ends is started again where it was; one that cannot
//! live ends the system, or stays away, as the launch file has it.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`plan`] | what is to run, checked before anything starts |
//! | [`system`] | the services as processes on the bus: the shell around `supervision`, which decides |
//! | [`in_process`] | the same slots in this process, without the bus |
//! | [`flight`] | a flight that is flown again |
//! | [`report`] | how it went, for scripts and for people |
//! | [`recorder`] | who takes down what flows |
//! | `processes` | the processes: started, ended, reaped |
//! | `warm` | what outlives a stop of the whole system |
//! | `reaper` | what killed services leave on the bus |
//! | `scheduling` | which process runs first |
//! | `view` | the terminal |
//! | `notify` | what the service manager is told |
pub mod flight;
pub mod in_process;
mod input;
mod notify;
mod people;
pub mod plan;
mod processes;
mod reaper;
pub mod recorder;
pub mod report;
mod scheduling;
pub mod system;
mod view;
mod warm;

use std::{
    io,
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
};

use bus::BusError;
use control::ControlError;
use ingest::{retaken::RetakeError, source::SourceError};
use launch::LaunchError;
use pipeline::CollectorError;
use recording::RecordingError;
use runtime::RuntimeError;
use supervision::Failure;

pub use flight::Flight;
pub use plan::{Plan, Request};
pub use recorder::{Recorder, RecordingReport};
pub use report::Report;

/// Runs what was asked for, to its end, and has it taken down by `recorder`. What did not run is an error; of what did there is a
/// report, which may have one too.
pub fn up(request: &Request, recorder: Option<&mut dyn Recorder>) -> Result<Report, UpError> {
    if request.in_process && recorder.is_some() {
        return Err(UpError::NoBus);
    }
    // From here on a signal ends it with a report.
    let ends = asked_to_end()?;
    let plan = Plan::new(request)?;
    // A program says what is wrong with its parameters before anything starts; one that does not start is a matter of the rule for restarts.
    if !plan.config.launch.stages.is_empty()
        && let Err(error @ RuntimeError::Parameter { .. }) = pipeline::Path::new(&plan.config)
    {
        return Err(error.into());
    }
    if request.in_process { in_process::run(&plan, &ends) } else { system::run(&plan, ends, recorder) }
}

/// Flies a flight again, in this process, to its end.
pub fn fly_again(request: &Request, flight: Flight) -> Result<Report, UpError> {
    if let (Some(out), Some(recording)) = (&request.out, &request.replay)
        && pipeline::is_same_file(out, recording)
    {
        return Err(UpError::OutIsReplay { path: out.clone() });
    }
    let ends = asked_to_end()?;
    in_process::replay(&Plan::of_flight(request, &flight), flight, &ends)
}

/// Prints a line for people. One that nobody reads any more does not stop a system, and one that nobody takes is left out.
pub fn announce(line: impl std::fmt::Display) {
    people::say(line, people::LIMIT);
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
    /// A flight that cannot be flown again.
    #[error("{0}")]
    Flight(String),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A slot could not be filled.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// It was ended before its time.
    #[error(transparent)]
    Failed(#[from] Failure),
    /// What was asked for needs all slots on this host.
    #[error("splitting the system over hosts: {why}; run it live, from \"sim\", \"bus\" or a device")]
    Split {
        /// Why it cannot be.
        why: &'static str,
    },
    /// A terminal would be read as a sensor.
    #[error("reading standard input: it is a terminal; give it a program or a file: PROGRAM | plumb up --source stdin")]
    Terminal,
    /// A receiver beside what has fixes of its own.
    #[error(
        "--receiver: a simulation and a recording bring their own fixes; name a device, too, as --source serial:/dev/ttyUSB0"
    )]
    Receiver,
    /// The declination of an unknown day.
    #[error(
        "counting the course from true north: what is read again must give the same course on any day; set its date in [course] of the launch file, as date = 2026-11-23"
    )]
    NoDate,
    /// The clock on the wall is not set, or the magnetic model has been superseded.
    #[error(
        "counting the course from true north: the clock says {today}, and the magnetic model holds from {} to {}; set the clock, or date in [course] of the launch file",
        launch::MODEL_YEARS.start(),
        launch::MODEL_YEARS.end()
    )]
    NoModel {
        /// The day.
        today: String,
    },
    /// The attitude would be written over the recording.
    #[error("writing {path}: that is the recording itself; give --out another name")]
    OutIsReplay {
        /// The file.
        path: PathBuf,
    },
    /// There is nothing to record.
    #[error("recording the flight: one process has no bus to record; leave out --in-process, or --record")]
    NoBus,
    /// The recording cannot be begun.
    #[error("{0}")]
    Recorder(String),
    /// A process could not be started or asked.
    #[error("{doing}: {cause}")]
    System {
        /// What was being done.
        doing: String,
        /// What the system answered.
        cause: io::Error,
    },
    /// The attitudes cannot be collected, or not be written any more.
    #[error(transparent)]
    Collector(#[from] CollectorError),
    /// The control socket cannot be opened.
    #[error(transparent)]
    Control(#[from] ControlError),
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
        "published, but neither in this report's figures nor in the file of --out: {}; the supervisor did not take them within buffer_s, as if it had been stopped",
        launch::counted(*not_recorded, "attitude")
    )]
    NotRecorded {
        /// How many.
        not_recorded: u64,
    },
    /// Lines of the file of attitudes without what only the fused state tells.
    #[error(
        "without u, v, z and bias in the file of --out: {}; the supervisor did not take the fused states of these ticks within buffer_s",
        launch::counted(*without_fused, "line")
    )]
    WithoutFused {
        /// How many.
        without_fused: u64,
    },
}

impl From<RetakeError> for UpError {
    fn from(error: RetakeError) -> Self {
        match error {
            RetakeError::Lost(lost) => Self::Flight(lost.to_string()),
            RetakeError::Source(error) => Self::Source(error),
        }
    }
}

impl UpError {
    /// The exit code of `plumb`: 3 when the configuration or an input file is wrong, 2 when the command line is, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Launch(_) | Self::Recording(_) | Self::Source(_) | Self::Flight(_) => 3,
            Self::NoDate | Self::NoModel { .. } => 3,
            Self::OutIsReplay { .. } | Self::Split { .. } | Self::Terminal | Self::Receiver | Self::NoBus => 2,
            _ => 1,
        }
    }
}
