//! The supervisor, `plumb up`.
//!
//! - Input: a launch file and command-line options.
//! - Output: a running system, its attitudes and a report.
//! - Time: the system clock, for deadlines and the display.
//! - Failure: a service that exits resumes from its checkpoint. A service that fails repeatedly
//!   stops the system or is given up, according to the launch file.
//!
//! | module | contents |
//! | --- | --- |
//! | [`plan`] | the validated configuration of a run |
//! | [`system`] | services as processes on the bus, driven by the decisions of `supervision` |
//! | [`in_process`] | all slots in this process, without the bus |
//! | [`flight`] | replay of a recorded flight |
//! | [`report`] | report of a run, as JSON and as text |
//! | [`recorder`] | interface of the flight recorder |
//! | `processes` | start, termination and reaping of processes |
//! | `warm` | state kept across restarts of the whole system |
//! | `reaper` | removal of what killed services leave on the bus |
//! | `scheduling` | scheduling priorities of the processes |
//! | `view` | progress display on the terminal |
//! | `notify` | notifications to the service manager |
pub mod flight;
pub mod in_process;
mod input;
mod notify;
pub mod plan;
mod processes;
mod reaper;
pub mod recorder;
pub mod report;
mod scheduling;
pub mod system;
mod terminal;
mod view;
mod warm;

use std::{
    io,
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
};

use bus::BusError;
use control::ControlError;
use ingest::{flight_replay::FlightReplayError, source::SourceError};
use launch::LaunchError;
use pipeline::CollectorError;
use recording::RecordingError;
use runtime::RuntimeError;
use supervision::Failure;

pub use flight::Flight;
pub use plan::{Plan, Request};
pub use recorder::{Recorder, RecordingReport};
pub use report::Report;

/// Runs a system to completion and records it with `recorder`, if given.
///
/// An error after the start is part of the report.
///
/// # Errors
///
/// Returns an error if the system could not be started.
pub fn up(request: &Request, recorder: Option<&mut dyn Recorder>) -> Result<Report, UpError> {
    if request.in_process && recorder.is_some() {
        return Err(UpError::NoBus);
    }
    // Signals received after this point end the run with a report.
    let stop_requested = install_signal_handlers()?;
    let plan = Plan::new(request)?;
    // If there are external stages, all stages are created once here, so that invalid parameters
    // are rejected before any service starts. Other errors are ignored here, because the restart
    // rule handles a stage that fails to start.
    if !plan.config.launch.stages.is_empty()
        && let Err(error @ RuntimeError::Parameter { .. }) = pipeline::Path::new(&plan.config)
    {
        return Err(error.into());
    }
    if request.in_process {
        in_process::run(&plan, &stop_requested)
    } else {
        system::run(&plan, stop_requested, recorder)
    }
}

/// Replays a recorded flight to completion, in this process.
///
/// # Errors
///
/// Returns an error if the output would overwrite the recording, or if the replay could not start.
pub fn replay(request: &Request, flight: Flight) -> Result<Report, UpError> {
    if let (Some(out), Some(recording)) = (&request.out, &request.replay)
        && pipeline::is_same_file(out, recording)
    {
        return Err(UpError::OutIsReplay { path: out.clone() });
    }
    let stop_requested = install_signal_handlers()?;
    in_process::replay(&Plan::from_flight(request, &flight), flight, &stop_requested)
}

/// Prints a line to standard error.
///
/// The line is dropped if standard error is closed or stays blocked for 1 s, so that a blocked
/// terminal does not stop the system.
pub fn announce(line: impl std::fmt::Display) {
    terminal::write_line(line, terminal::WRITE_TIMEOUT);
}

/// Installs handlers for SIGTERM, SIGINT and SIGHUP and returns the flag that they set.
fn install_signal_handlers() -> Result<Arc<AtomicBool>, UpError> {
    let stop_requested = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, stop_requested.clone())
            .map_err(|cause| UpError::System { action: "installing signal handlers".into(), cause })?;
    }
    Ok(stop_requested)
}

/// Reason why a system did not start or did not end normally.
#[derive(Debug, thiserror::Error)]
pub enum UpError {
    /// The launch file is invalid.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The recording is invalid.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The source is invalid or failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The recorded flight cannot be replayed.
    #[error("{0}")]
    Flight(String),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A stage failed or could not be created.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The system stopped prematurely.
    #[error(transparent)]
    Failed(#[from] Failure),
    /// The launch file lists a service that this executable lacks.
    #[error(
        "{file}: services lists {service:?}, which needs the feature `{feature}`, which this build lacks; remove {service:?}, or rebuild plumb with --features {feature}"
    )]
    AbsentService {
        /// Path of the launch file.
        file: PathBuf,
        /// Name of the service.
        service: &'static str,
        /// Missing feature.
        feature: &'static str,
    },
    /// The configuration requires all slots on this host.
    #[error("cannot split the system over hosts: {reason}; run it live from \"sim\", \"bus\" or a device")]
    Split {
        /// Conflicting setting.
        reason: &'static str,
    },
    /// Standard input is the source but is a terminal.
    #[error(
        "cannot read samples from standard input: it is a terminal; pipe a program or a file into it: PROGRAM | plumb up --source stdin"
    )]
    Terminal,
    /// A receiver was given for a source that includes fixes.
    #[error(
        "--receiver needs a device as source, because simulations and recordings contain their own fixes; add for example --source serial:/dev/ttyUSB0"
    )]
    Receiver,
    /// A repeatable source has no date for the magnetic declination.
    #[error(
        "cannot compute true north: a repeatable source needs a fixed date; set its date in [course] of the launch file, for example date = 2026-11-23"
    )]
    NoDate,
    /// The current date is outside the validity period of the magnetic model.
    #[error(
        "cannot compute true north: the system clock shows {today}, but the magnetic model is valid from {} to {}; set the clock, or date in [course] of the launch file",
        launch::MODEL_YEARS.start(),
        launch::MODEL_YEARS.end()
    )]
    NoModel {
        /// Current date.
        today: String,
    },
    /// The output file is the recording being read.
    #[error("cannot write {path}: it is the recording itself; choose another file with --out")]
    OutIsReplay {
        /// Path of the file.
        path: PathBuf,
    },
    /// A recording was requested for a run without a bus.
    #[error("cannot record the flight: --in-process has no bus to record; omit --in-process or --record")]
    NoBus,
    /// The recording could not be started.
    #[error("{0}")]
    Recorder(String),
    /// A system call failed.
    #[error("{action}: {cause}")]
    System {
        /// Attempted action.
        action: String,
        /// Operating system error.
        cause: io::Error,
    },
    /// The attitudes could not be collected or written.
    #[error(transparent)]
    Collector(#[from] CollectorError),
    /// The control socket could not be opened.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// Some ticks have no attitude.
    #[error(
        "{lost} of {ticks_in} ticks were lost: a service did not respond, or restarted too late for the buffer of its topics"
    )]
    Lost {
        /// Number of lost ticks.
        lost: u64,
        /// Number of ticks received.
        ticks_in: u64,
    },
    /// The supervisor did not collect some of the published attitudes.
    #[error(
        "{} published but missing from the report's figures and the --out file: the supervisor did not collect them within buffer_s; check whether it was stopped or starved",
        launch::pluralize(*not_recorded, "attitude")
    )]
    NotRecorded {
        /// Number of attitudes not collected.
        not_recorded: u64,
    },
    /// Some lines of the output file lack the values of the fused state.
    #[error(
        "{} of the --out file without u, v, z and bias: the supervisor did not collect the fused states within buffer_s",
        launch::pluralize(*without_fused, "line")
    )]
    WithoutFused {
        /// Number of lines.
        without_fused: u64,
    },
}

impl From<FlightReplayError> for UpError {
    fn from(error: FlightReplayError) -> Self {
        match error {
            FlightReplayError::MissingReadings(lost) => Self::Flight(lost.to_string()),
            FlightReplayError::Source(error) => Self::Source(error),
        }
    }
}

impl UpError {
    /// Returns the exit code of `plumb`.
    ///
    /// It is 3 for an invalid configuration or input file, 2 for an invalid command line, otherwise
    /// 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Launch(_) | Self::Recording(_) | Self::Source(_) | Self::Flight(_) => 3,
            Self::AbsentService { .. } | Self::NoDate | Self::NoModel { .. } => 3,
            Self::OutIsReplay { .. } | Self::Split { .. } | Self::Terminal | Self::Receiver | Self::NoBus => 2,
            _ => 1,
        }
    }
}
