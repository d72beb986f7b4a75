//! Events that [`Supervision`](crate::Supervision) handles and actions that it returns.

use std::{fmt, path::PathBuf, time::Duration};

use control::{ControlRequest, ServiceStatus, SwapReport};
use foreign::ForeignText;
use launch::{Launch, Service, Slot, StageConfig};
use messages::{Checkpoint, Control, Difference, Health, SystemEvent};
use swap::{Resume, Role};

/// Configuration of the [`Supervision`](crate::Supervision) of one system.
#[derive(Debug, Clone)]
pub struct Config {
    /// Launch file of the system.
    pub launch: Launch,
    /// Sample rate in the source's time, Hz.
    pub rate_hz: f64,
    /// Lockstep mode: the source waits for its slowest subscriber.
    pub lockstep: bool,
    /// Maximum lead of the source over the slowest subscriber in lockstep, in ticks.
    pub window_ticks: u64,
    /// Number of messages a topic of the data path holds.
    pub buffer_ticks: u64,
    /// Run time after which an endless source is stopped.
    pub stop_after: Option<Duration>,
    /// Checks the stage that fills a slot. The error text is shown to the user.
    pub validate: fn(&Launch, Slot) -> Result<(), String>,
}

/// Input of [`Supervision::handle`](crate::Supervision::handle).
#[derive(Debug, Clone)]
pub enum Event {
    /// Time has passed. This event must be sent after the other events of a round, and no later
    /// than [`poll_interval`](crate::Supervision::poll_interval) after the previous timer event.
    Timer,
    /// A process was started, in response to [`Action::Spawn`].
    Spawned {
        /// Incarnation of the process.
        incarnation: u32,
        /// Process ID.
        pid: u32,
    },
    /// A process could not be started, in response to [`Action::Spawn`].
    SpawnFailed {
        /// Incarnation of the process.
        incarnation: u32,
        /// Cause, shown to the user.
        cause: String,
    },
    /// A process has exited. Before this event, [`Event::Published`] with the last tick of the
    /// process must be sent.
    Exited {
        /// Incarnation of the process.
        incarnation: u32,
        /// Exit status, shown to the user, such as "was killed by signal 9".
        exit_status: String,
        /// Last output of the process on standard error.
        stderr: ForeignText,
    },
    /// A service has reported its health.
    Health(Health),
    /// A service has published a checkpoint.
    Checkpoint(Box<Checkpoint>),
    /// A shadow has published the difference between its attitude and that of the slot's owner.
    Difference(Difference),
    /// A service has published messages.
    Published {
        /// Service that has published.
        service: Service,
        /// Tick after the newest published one.
        next_tick: u64,
    },
    /// The supervisor has collected attitudes.
    Output(OutputProgress),
    /// A client has sent a request.
    Request {
        /// Client that expects the reply.
        client: u64,
        /// Request from the client.
        request: ControlRequest,
    },
    /// A client has disconnected before it received its reply.
    ClientDisconnected {
        /// Disconnected client.
        client: u64,
    },
    /// A user or the operating system has requested the shutdown.
    StopRequested,
    /// Files of the running system's bus were removed or damaged, so new processes cannot join.
    FilesUnusable {
        /// One of the removed or damaged files.
        path: PathBuf,
        /// Kind of damage.
        fault: FileFault,
    },
    /// A new bus exists, in response to [`Action::RenewBus`].
    BusRenewed,
}

/// Fault of a file of the running system's bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileFault {
    /// The file was removed.
    Removed,
    /// The file was truncated or overwritten.
    Damaged,
}

impl fmt::Display for FileFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Removed => "removed",
            Self::Damaged => "damaged",
        })
    }
}

/// Progress of the supervisor in collecting attitudes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OutputProgress {
    /// Tick of the next attitude.
    pub next_tick: u64,
    /// Number of ticks before `next_tick` that have no attitude.
    pub lost: u64,
    /// Number of attitudes before `next_tick` that were overwritten in the topic before the
    /// supervisor read them.
    pub not_recorded: u64,
    /// Number of attitudes published more than once.
    pub duplicated: u64,
    /// Longest interval in ns between the publications of two consecutive attitudes since the
    /// previous report.
    pub max_gap_ns: u64,
    /// Last tick at which a different stage took over, and the attitude jump in rad at that tick.
    pub last_swap: Option<(u64, f64)>,
}

/// Output of [`Supervision::handle`](crate::Supervision::handle).
#[derive(Debug, Clone)]
pub enum Action {
    /// Start a process.
    Spawn(Box<Spawn>),
    /// Request a process to exit.
    Terminate {
        /// Incarnation of the process.
        incarnation: u32,
    },
    /// Kill a process.
    Kill {
        /// Incarnation of the process.
        incarnation: u32,
    },
    /// Publish a decision about the owner of a slot.
    PublishControl(Control),
    /// Allow the source to publish the ticks before `ticks`.
    GrantCredit {
        /// First tick that must not be published yet.
        ticks: u64,
        /// `true` for the final credit. The source then publishes no new ticks, but keeps running
        /// for restarted subscribers.
        is_final: bool,
    },
    /// Reply to a client.
    Reply {
        /// Client that sent the request.
        client: u64,
        /// Reply to the request.
        reply: Reply,
    },
    /// Publish an event on the topic `event`. The caller adds its number and time.
    PublishEvent(Box<SystemEvent>),
    /// Show a line to the user.
    Announce(String),
    /// Report to the service manager that every service runs.
    Ready,
    /// Shutdown has started: the source publishes no new ticks.
    Stopping,
    /// Kill every process without reporting the exits, then create a new bus of the same name. The
    /// response is [`Event::BusRenewed`].
    RenewBus,
    /// Stop the system. Of the actions that follow, only replies are performed.
    Finish(Option<Failure>),
}

/// Process to start.
#[derive(Debug, Clone)]
pub struct Spawn {
    /// Incarnation, unique in the system.
    pub incarnation: u32,
    /// Service to run.
    pub service: Service,
    /// Stage that fills the slot; `None` for services without a slot.
    pub stage: Option<StageConfig>,
    /// Role of the process: owner or candidate of the slot.
    pub role: Role,
    /// Current epoch of the slot.
    pub epoch: u32,
    /// State to resume from; `None` for the first start.
    pub resume: Option<Resume>,
}

/// Reply to a client.
#[derive(Debug, Clone)]
pub enum Reply {
    /// Outcome of a swap.
    Swap(Box<SwapReport>),
    /// Status of every service.
    Status(Vec<ServiceStatus>),
    /// Service configuration. The caller of `handle` fills it in.
    ServiceConfig,
    /// Recording status. The caller of `handle` fills it in.
    RecordStatus,
    /// Acknowledgement without data.
    Done,
}

/// Formats the last output on standard error, preceded by a colon. Each line carries the mark of
/// foreign text. The result is empty if there was no output.
pub(crate) fn after_colon(stderr: &ForeignText) -> String {
    if stderr.raw().is_empty() {
        return String::new();
    }
    ForeignText::from(format!(":\n{}", stderr.raw())).with_lines().to_string()
}

/// Reason why the system stopped prematurely.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// A service has exited and is not restarted.
    #[error("service {service} (process {pid}) {exit_status}; the system was stopped{}", after_colon(stderr))]
    ServiceExited {
        /// Service that exited.
        service: Service,
        /// Process ID.
        pid: u32,
        /// Exit status.
        exit_status: String,
        /// Last output on standard error; empty if there was none.
        stderr: ForeignText,
    },
    /// A service could not be started.
    #[error("{cause}")]
    SpawnFailed {
        /// Attempted action and the operating system's error.
        cause: String,
    },
    /// Bus files have been removed or damaged repeatedly.
    #[error(
        "{path} was {fault} while the system ran; files of the running system were removed or damaged {count} times within {within_s} s. \
         If systemd-logind removes them at logout, set RemoveIPC=no in /etc/systemd/logind.conf or run the system as a system user",
        path = foreign::path(path)
    )]
    FilesUnusableRepeatedly {
        /// One of the removed or damaged files.
        path: PathBuf,
        /// Fault of the file.
        fault: FileFault,
        /// Number of times that files were removed or damaged.
        count: usize,
        /// Length of the period in which the faults were counted, s.
        within_s: u64,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hostile_output_of_service_is_escaped_and_marked() {
        let exit_status = "exited with code 1".into();
        let failure = |stderr: &str| {
            let (service, exit_status, stderr) = (Service::Fuser, String::clone(&exit_status), stderr.into());
            Failure::ServiceExited { service, pid: 7, exit_status, stderr }.to_string()
        };
        let head = "service fuser (process 7) exited with code 1; the system was stopped";
        assert_eq!(failure(""), head);
        assert_eq!(failure("\x1b[2Jone\nforged"), format!("{head}:\n  | \\u{{1b}}[2Jone\n  | forged"));
    }
}
