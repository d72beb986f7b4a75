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
//! | [`replayed_flight`] | replay of a recorded flight |
//! | [`report`] | report of a run, as JSON and as text |
//! | `recorder` | recording of a run |
//! | `processes` | start, termination and reaping of processes |
//! | `orphans` | end of processes that killed services leave behind |
//! | `warm` | state kept across restarts of the whole system |
//! | `reaper` | removal of what killed services leave on the bus |
//! | `scheduling` | scheduling priorities of the processes |
//! | `view` | progress display on the terminal |
//! | `last_run` | record of a run in a file, from which its end is reported |
//! | `notify` | notifications to the service manager |
mod error;
pub mod in_process;
mod input;
mod kernel_state;
mod last_run;
mod notify;
mod orphans;
pub mod plan;
mod processes;
mod reaper;
mod recorder;
pub mod replayed_flight;
pub mod report;
mod scheduling;
pub mod system;
mod terminal;
mod view;
mod warm;

use std::sync::{
    Arc, OnceLock,
    atomic::{AtomicBool, Ordering},
};

use runtime::RuntimeError;

use orphans::Orphans;

pub use error::UpError;
pub use last_run::{EndReason, LastRun};
pub use plan::{Plan, Request};
pub use replayed_flight::Flight;
pub use report::{RecordingReport, Report};
pub use terminal::announce;

/// Runs a system to completion.
///
/// An error after the start is part of the report.
///
/// # Errors
///
/// Returns an error if the system could not be started.
pub fn up(request: &Request) -> Result<Report, UpError> {
    if request.in_process && request.record.is_some() {
        return Err(UpError::NoBus);
    }
    // While files are read, a signal ends the process immediately, because reading blocks if the
    // launch file is a pipe without a writer. Later signals end the run with a report.
    let plan = Plan::new(request)?;
    let stop_requested = install_signal_handlers()?;
    // Dropped last, so that processes started by an external stage end with the run.
    let _orphans = Orphans::default();
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
        system::run(&plan, request, stop_requested)
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
    let _orphans = Orphans::default();
    in_process::replay(&Plan::from_flight(request, &flight), flight, &stop_requested)
}

/// Flag that the signal handlers set.
static STOP_REQUESTED: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Returns `true` if a signal has requested the end of the run. Signals are not observed before a
/// run starts.
pub fn is_stop_requested() -> bool {
    STOP_REQUESTED.get().is_some_and(|flag| flag.load(Ordering::SeqCst))
}

/// Installs handlers for SIGTERM, SIGINT and SIGHUP and returns the flag that they set.
///
/// # Errors
///
/// Returns an error if the operating system refuses a handler.
pub fn install_signal_handlers() -> Result<Arc<AtomicBool>, UpError> {
    let stop_requested = STOP_REQUESTED.get_or_init(Arc::default).clone();
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, stop_requested.clone())
            .map_err(|cause| UpError::System { action: "installing signal handlers".into(), cause })?;
    }
    Ok(stop_requested)
}
