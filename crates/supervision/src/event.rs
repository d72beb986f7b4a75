//! What is told to [`Supervision`](crate::Supervision), and what it asks for.

use std::{path::PathBuf, time::Duration};

use launch::{Launch, Service, Stage};
use messages::{Checkpoint, Control, Difference, Health, SystemEvent};
use swap::Role;

use crate::request::{ControlRequest, ServiceStatus, SwapReport};

/// What a system is, as far as its supervisor has to know.
#[derive(Debug, Clone)]
pub struct Config {
    /// What runs.
    pub launch: Launch,
    /// Samples per second of the source's time.
    pub rate_hz: f64,
    /// The source waits for the slowest reader.
    pub lockstep: bool,
    /// How far the source may then be ahead of the last reader, ticks.
    pub window_ticks: u64,
    /// How many messages a topic of the path holds.
    pub buffer_ticks: u64,
    /// After how much time a source without an end is stopped.
    pub stop_after: Option<Duration>,
    /// What is wrong with the stage that fills this slot, for people.
    pub validate: fn(&Launch, Service) -> Result<(), String>,
}

/// What has happened.
#[derive(Debug, Clone)]
pub enum Event {
    /// Time has passed; at the latest after [`poll_interval`](crate::Supervision::poll_interval), and after the other events of a round.
    Time,
    /// A process was started: the answer to [`Action::Spawn`].
    Spawned {
        /// Its incarnation.
        incarnation: u32,
        /// The process.
        pid: u32,
    },
    /// A process could not be started: the other answer.
    SpawnFailed {
        /// Its incarnation.
        incarnation: u32,
        /// Why, for people.
        cause: String,
    },
    /// A process has ended. What it had published, [`Event::Published`], is told before.
    Exited {
        /// Its incarnation.
        incarnation: u32,
        /// How it ended, for people: "was ended by signal 9".
        how: String,
        /// The end of what it said on standard error.
        stderr: String,
    },
    /// A service says how it is.
    Health(Health),
    /// A service says from where it could go on.
    Checkpoint(Box<Checkpoint>),
    /// A shadow says how far it is from the stage that owns its slot.
    Difference(Difference),
    /// A service has published.
    Published {
        /// Which one.
        service: Service,
        /// The tick after its newest one.
        next_tick: u64,
    },
    /// Attitudes were taken.
    Output(OutputProgress),
    /// Somebody asks for something.
    Request {
        /// Who is to be answered.
        caller: u64,
        /// What for.
        request: ControlRequest,
    },
    /// Who asked waits no more.
    CallerGone {
        /// Who it was.
        caller: u64,
    },
    /// The system is to end.
    EndAsked,
    /// Files of the running system's bus were removed.
    FilesRemoved {
        /// One of them.
        path: PathBuf,
    },
    /// There is a new bus: the answer to [`Action::RenewBus`].
    BusRenewed,
}

/// The attitudes taken so far.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OutputProgress {
    /// The tick that comes next.
    pub next_tick: u64,
    /// Ticks before it without an attitude.
    pub lost: u64,
    /// Attitudes before it that were published and not taken while the topic held them.
    pub not_taken: u64,
    /// Attitudes that came again.
    pub duplicated: u64,
    /// The longest time between two publications since this was told last, ns.
    pub gap_ns: u64,
    /// The last tick at which a stage of another kind took over, and by how much the attitude jumped there, rad.
    pub swapped: Option<(u64, f64)>,
}

/// What is to be done.
#[derive(Debug, Clone)]
pub enum Action {
    /// Start a process.
    Spawn(Box<Spawn>),
    /// Ask a process to end.
    Terminate {
        /// Its incarnation.
        incarnation: u32,
    },
    /// End a process.
    Kill {
        /// Its incarnation.
        incarnation: u32,
    },
    /// Tell every service who owns a slot.
    PublishControl(Control),
    /// Allow the source to publish the ticks before this one.
    GrantCredit {
        /// The tick.
        ticks: u64,
        /// The source publishes nothing new any more, and stays for readers that are started again.
        ends: bool,
    },
    /// Answer who asked.
    Answer {
        /// Who.
        caller: u64,
        /// What.
        reply: Reply,
    },
    /// Tell whoever listens on the topic `event`; number and time are the shell's.
    Tell(Box<SystemEvent>),
    /// Say something to people.
    Announce(String),
    /// Every service runs.
    Ready,
    /// The end has begun: the source publishes nothing new.
    Stopping,
    /// Kill every process, without a word of it, and make a new bus of the same name; answered by [`Event::BusRenewed`].
    RenewBus,
    /// The system is at its end. Of what was asked for before and has not been done, only the answers still are.
    Finish(Option<Failure>),
}

/// A process to be started.
#[derive(Debug, Clone)]
pub struct Spawn {
    /// Its number, which no other process of the system has.
    pub incarnation: u32,
    /// The service that it is.
    pub service: Service,
    /// What fills its slot, if it has one.
    pub stage: Option<Stage>,
    /// Whether it owns the slot.
    pub role: Role,
    /// The decision about the slot that is in force.
    pub epoch: u32,
    /// From where it goes on; `None` for the first start.
    pub resume: Option<Resume>,
}

/// From where a service goes on.
#[derive(Debug, Clone)]
pub enum Resume {
    /// From the beginning of what its inputs still hold: no checkpoint was made.
    Fresh,
    /// From this state.
    Checkpoint(Box<Checkpoint>),
    /// The source, from this tick on.
    Source {
        /// The tick.
        next_tick: u64,
        /// When the first tick was due, CLOCK_MONOTONIC, ns; 0 when none has been.
        start_ns: u64,
        /// Time of the samples less the sensor's, ns.
        offset_ns: i64,
    },
}

/// What somebody is answered.
#[derive(Debug, Clone)]
pub enum Reply {
    /// How a swap went.
    Swap(Box<SwapReport>),
    /// How the services are.
    Status(Vec<ServiceStatus>),
    /// What runs, which whoever runs it knows.
    ServiceConfig,
    /// What the report lacks, which whoever makes it knows.
    Record,
    /// That it is done.
    Done,
}

/// Why a system ended before its time.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// A service ended by itself.
    #[error("the service {service} (process {pid}) {how}; the system was stopped{stderr}")]
    ServiceEnded {
        /// Which one.
        service: Service,
        /// Its process.
        pid: u32,
        /// How it ended.
        how: String,
        /// What it said last, on lines of its own.
        stderr: String,
    },
    /// A service could not be started.
    #[error("{cause}")]
    NotStarted {
        /// What was being done, and what the system answered.
        cause: String,
    },
    /// The files of the bus are removed again and again.
    #[error(
        "{path} was removed while the system ran, as its files have been {times} times within {within_s} s: somebody removes them again and again. \
         Is it logind, when its user logs out? RemoveIPC=no in /etc/systemd/logind.conf, or let a system user run it",
        path = path.display()
    )]
    RemovedAgain {
        /// One of them.
        path: PathBuf,
        /// How often.
        times: usize,
        /// In which time, s.
        within_s: u64,
    },
}
