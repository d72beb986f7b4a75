//! What the supervisor decides, as one value without clock, bus, processes or threads.
//!
//! Input: events, each with the time since the supervisor began. Output: actions, in the order in which they are to be done. Time:
//! told with each event; grows. Failure: a service that fails is an event like any other; what ends the system is said in
//! [`Action::Finish`], and nothing is asked for after it.
//!
//! The service `supervisor` turns signals, processes, topics and the control socket into events and does the actions; the simulator does
//! the same with a simulated bus, simulated processes and a simulated clock.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`event`] | what is told, what is asked for |
//! | [`request`] | what people and programs ask of a running system, and what they are answered |
//! | [`process`] | the services and their processes |
//! | `restart_policy`, `restart` | when a service is started again, and when no more |
//! | `checkpoint_store` | from where it goes on |
//! | `swaps`, `pending_swaps` | who fills a slot; the requests to change that |
//! | `watch` | stages that take over by themselves |
//! | `flow` | readiness, credit for the source, the end |
//! | `history` | what is told of it all while the system runs |
//! | `renewal` | what is done when the bus of the running system was removed |
#![forbid(unsafe_code)]

mod checkpoint_store;
pub mod event;
mod flow;
mod history;
mod pending_swaps;
pub mod process;
mod renewal;
pub mod request;
mod restart;
mod restart_policy;
mod swaps;
mod watch;

use std::time::Duration;

use launch::{Launch, Service};
use messages::{Checkpoint, Health};

use {
    checkpoint_store::CheckpointStore, flow::Flow, pending_swaps::PendingSwaps, renewal::Renewals, swaps::Swaps,
    watch::Watch,
};

pub use event::{Action, Config, Event, Failure, OutputProgress, Reply, Resume, Spawn};
pub use process::{ProcessEntry, ProcessTable};
pub use request::{ControlRequest, RecordStatus, ServiceStatus, SwapReport, SwapRequest, Trouble};

/// All that the supervisor of one system knows and decides.
#[derive(Debug)]
pub struct Supervision {
    config: Config,
    now: Duration,
    table: ProcessTable,
    checkpoints: CheckpointStore,
    /// The tick after the newest one that each service has published.
    published: [u64; Service::ALL.len()],
    output: OutputProgress,
    swaps: Swaps,
    pending: PendingSwaps,
    watches: Vec<Watch>,
    flow: Flow,
    renewals: Renewals,
    actions: Vec<Action>,
}

impl Supervision {
    /// A system that begins now: the first event is answered with the start of every service.
    pub fn new(config: Config, now: Duration) -> Self {
        let mut supervision = Self {
            watches: watch::watches(&config.launch),
            checkpoints: CheckpointStore::new(&config.launch),
            config,
            now,
            table: ProcessTable::new(now),
            published: [0; Service::ALL.len()],
            output: OutputProgress::default(),
            swaps: Swaps::default(),
            pending: PendingSwaps::default(),
            flow: Flow::new(now),
            renewals: Renewals::default(),
            actions: Vec::new(),
        };
        for service in supervision.config.launch.services.clone() {
            supervision.spawn_owner(service, None);
        }
        supervision.fill_slots();
        supervision
    }

    /// Takes an event; what is to be done comes in order. Every [`Action::Spawn`] is answered before any other event is told.
    pub fn handle(&mut self, now: Duration, event: Event) -> Vec<Action> {
        self.now = self.now.max(now);
        if !self.flow.has_ended() {
            let held_from = self.held_from();
            self.checkpoints.on_positions(self.table.positions(held_from), held_from);
            let alone = self.table.entries().filter(|(_, entry)| entry.candidate.is_none());
            alone.for_each(|(service, _)| self.checkpoints.forget_candidate(service));
            self.apply(event);
        }
        std::mem::take(&mut self.actions)
    }

    fn apply(&mut self, event: Event) {
        match event {
            Event::Time => self.poll(),
            Event::Spawned { incarnation, pid } => self.on_spawned(incarnation, pid),
            Event::SpawnFailed { incarnation, cause } => self.on_spawn_failed(incarnation, cause),
            Event::Exited { incarnation, how, stderr } => self.on_exit(incarnation, how, stderr),
            Event::Health(health) => self.table.on_health(health, self.now),
            Event::Checkpoint(checkpoint) => self.on_checkpoint(*checkpoint),
            Event::Difference(difference) => self.on_difference(&difference),
            Event::Published { service, next_tick } => self.on_published(service, next_tick),
            Event::Output(output) => self.on_output(output),
            Event::Request { caller, request } => self.on_request(caller, request),
            Event::CallerGone { caller } => self.on_caller_gone(caller),
            Event::EndAsked => self.flow.ask_to_end(),
            Event::FilesRemoved { path } => self.on_files_removed(path),
            Event::BusRenewed => self.on_bus_renewed(),
        }
    }

    /// Looks at every deadline, and at what follows from all that was told since the last time.
    fn poll(&mut self) {
        self.renewals.set_unjoined(false);
        self.forgive_standstill();
        self.poll_flow();
        if self.flow.has_ended() || self.renewals.is_under_way() {
            return;
        }
        self.kill_silent();
        self.restart_due();
        self.poll_swaps();
        self.poll_watches();
    }

    fn on_checkpoint(&mut self, checkpoint: Checkpoint) {
        let Checkpoint { service, incarnation, next_tick, .. } = checkpoint;
        if !self.swaps.admits(service, incarnation, next_tick) {
            return;
        }
        if self.table.is_candidate(service, incarnation) {
            self.checkpoints.keep_candidate(checkpoint);
        } else {
            self.checkpoints.keep(checkpoint);
        }
    }

    fn on_request(&mut self, caller: u64, request: ControlRequest) {
        let reply = match request {
            ControlRequest::Swap(request) => return self.on_swap_request(caller, request),
            ControlRequest::Cancel { slot } => {
                if let Some(slot) = Service::named(&slot) {
                    self.notify_slot(slot, swap::Event::Cancel);
                }
                Reply::Done
            }
            ControlRequest::Ps => Reply::Status(self.status()),
            ControlRequest::ServiceConfig => Reply::ServiceConfig,
            ControlRequest::Record => Reply::Record,
            ControlRequest::Tell { service, what } => {
                self.announce(format!("{service}: {what}"));
                Reply::Done
            }
            ControlRequest::Troubles { service, troubles } => {
                self.table.has_troubles(&service, troubles);
                Reply::Done
            }
            ControlRequest::At { service, at } => {
                self.announce(format!("{service}: {at}"));
                // What stands behind `#` gives rights to whoever reads it: it is for people at the terminal, and not for all who ask.
                let place = at.split('#').next().unwrap_or_default();
                self.table.found(&service, place.into());
                Reply::Done
            }
        };
        self.actions.push(Action::Answer { caller, reply });
    }

    /// How the services are.
    fn status(&self) -> Vec<ServiceStatus> {
        let silence = Duration::from_secs_f64(self.config.launch.restart.silence_s);
        let status = |(service, entry): (Service, &ProcessEntry)| {
            let health = entry.health();
            let told = |number: fn(&Health) -> u64| health.map_or(0, number);
            ServiceStatus {
                service: service.name().into(),
                stage: self.config.launch.slot(service).map(|slot| slot.stage.clone()),
                state: entry.state(self.now, silence).into(),
                pid: entry.pid(),
                restarts: entry.restarts(),
                incarnation: entry.incarnation(),
                epoch: self.swaps.epoch(service).unwrap_or(health.map_or(0, |health| health.epoch)),
                ticks: told(|health| health.ticks),
                lost: told(|health| health.lost),
                at: entry.address().map(str::to_owned),
                troubles: entry.troubles().to_vec(),
            }
        };
        self.entries().map(status).collect()
    }

    /// What runs, with the stages that fill the slots by now.
    pub fn launch(&self) -> &Launch {
        &self.config.launch
    }

    /// The services that are to run here.
    pub fn entries(&self) -> impl Iterator<Item = (Service, &ProcessEntry)> {
        self.table.entries().filter(|(service, _)| self.config.launch.services.contains(service))
    }

    /// Those that every tick passes through: of the data path, and the gateway of a split system.
    fn path(&self) -> impl Iterator<Item = (Service, &ProcessEntry)> {
        self.entries().filter(|(service, _)| self.config.launch.follows(*service))
    }

    /// The newest checkpoint of whoever owns a slot.
    pub fn newest_checkpoint(&self, service: Service) -> Option<&Checkpoint> {
        self.checkpoints.newest(service)
    }

    /// After how long it wants to be told that time has passed.
    pub fn poll_interval(&self) -> Duration {
        if !self.flow.is_running() {
            Duration::from_millis(1)
        } else if self.is_swapping() {
            Duration::from_millis(2)
        } else {
            Duration::from_millis(20)
        }
    }

    fn announce(&mut self, line: impl Into<String>) {
        self.actions.push(Action::Announce(line.into()));
    }
}
