//! The supervision of one system: its state, and the entry point for events.
//!
//! The decisions on the events are in `decisions`.

use std::time::Duration;

use control::{ControlRequest, ServiceStatus};
use launch::{Launch, Service, Slot};
use messages::{Checkpoint, Health};

use crate::{
    Action, Config, Event, OutputProgress, ProcessEntry, Reply,
    state::{
        checkpoint_store::CheckpointStore,
        flow::Flow,
        pending_swaps::PendingSwaps,
        process::ProcessTable,
        promotion::{self, WatchRunner},
        renewal::Renewals,
        swaps::Swaps,
    },
};

/// State and decision logic of one system's supervisor.
#[derive(Debug)]
pub struct Supervision {
    pub(crate) config: Config,
    pub(crate) now: Duration,
    pub(crate) table: ProcessTable,
    pub(crate) checkpoints: CheckpointStore,
    /// Tick after the newest one published, per service.
    pub(crate) published: [u64; Service::ALL.len()],
    pub(crate) output: OutputProgress,
    pub(crate) swaps: Swaps,
    pub(crate) pending: PendingSwaps,
    pub(crate) watches: Vec<WatchRunner>,
    pub(crate) flow: Flow,
    pub(crate) renewals: Renewals,
    pub(crate) actions: Vec<Action>,
}

impl Supervision {
    /// Creates the supervision of a system that starts at `now`.
    ///
    /// The first call of [`handle`](Self::handle) returns the actions that start every service.
    pub fn new(config: Config, now: Duration) -> Self {
        let mut supervision = Self {
            watches: promotion::from_launch(&config.launch),
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
        supervision.init_slots();
        supervision
    }

    /// Handles an event and returns the actions to perform, in order.
    ///
    /// Each [`Action::Spawn`] must be followed by [`Event::Spawned`] or [`Event::SpawnFailed`]
    /// before any other event.
    pub fn handle(&mut self, now: Duration, event: Event) -> Vec<Action> {
        self.now = self.now.max(now);
        if !self.flow.has_ended() {
            let held_from = self.held_from();
            self.checkpoints.on_positions(self.table.positions(held_from), held_from);
            let without_candidate = self.table.entries().filter(|(_, entry)| entry.candidate.is_none());
            without_candidate.for_each(|(service, _)| self.checkpoints.clear_candidate(service));
            self.apply(event);
        }
        std::mem::take(&mut self.actions)
    }

    fn apply(&mut self, event: Event) {
        match event {
            Event::Timer => self.poll(),
            Event::Spawned { incarnation, pid } => self.on_spawned(incarnation, pid),
            Event::SpawnFailed { incarnation, cause } => self.on_spawn_failed(incarnation, cause),
            Event::Exited { incarnation, exit_status, stderr } => self.on_exit(incarnation, exit_status, stderr),
            Event::Health(health) => self.on_health(health),
            Event::Checkpoint(checkpoint) => self.on_checkpoint(checkpoint),
            Event::Difference(difference) => self.on_difference(&difference),
            Event::Published { service, next_tick } => self.on_published(service, next_tick),
            Event::Output(output) => self.on_output(output),
            Event::Request { client, request } => self.on_request(client, request),
            Event::ClientDisconnected { client } => self.on_client_disconnected(client),
            Event::StopRequested => self.flow.request_stop(),
            Event::FilesUnusable { path, fault } => self.on_files_unusable(path, fault),
            Event::BusRenewed => self.on_bus_renewed(),
        }
    }

    /// Checks every deadline and acts on the events received since the previous call.
    fn poll(&mut self) {
        self.renewals.set_join_failed(false);
        self.extend_deadlines_after_stall();
        self.poll_flow();
        if self.flow.has_ended() || self.renewals.is_under_way() {
            return;
        }
        self.kill_silent();
        self.restart_due();
        self.poll_swaps();
        self.poll_watches();
    }

    fn on_checkpoint(&mut self, checkpoint: Box<Checkpoint>) {
        let Checkpoint { service, incarnation, next_tick, .. } = *checkpoint;
        if !self.swaps.accepts_checkpoint(service, incarnation, next_tick) {
            return;
        }
        if self.table.is_candidate(service, incarnation) {
            self.checkpoints.record_candidate(checkpoint);
        } else {
            self.checkpoints.record(checkpoint);
        }
    }

    fn on_request(&mut self, client: u64, request: ControlRequest) {
        let reply = match request {
            ControlRequest::Swap(request) => return self.on_swap_request(client, request),
            ControlRequest::Cancel { slot } => {
                if let Some(slot) = Slot::from_name(&slot) {
                    self.notify_slot(slot, swap::Event::Cancel);
                }
                Reply::Done
            }
            ControlRequest::Status => Reply::Status(self.status()),
            ControlRequest::ServiceConfig => Reply::ServiceConfig,
            ControlRequest::RecordStatus => Reply::RecordStatus,
            ControlRequest::Announce { service, line } => {
                self.announce(format!("{service}: {line}"));
                Reply::Done
            }
            ControlRequest::Diagnostics { service, diagnostics } => {
                self.table.set_diagnostics(&service, diagnostics);
                Reply::Done
            }
            ControlRequest::Address { service, address } => {
                self.announce(format!("{service}: {address}"));
                // The fragment after `#` grants access. Only the terminal shows it; status replies
                // omit it.
                let public_part = address.split('#').next().unwrap_or_default();
                self.table.set_address(&service, public_part.into());
                Reply::Done
            }
        };
        self.actions.push(Action::Reply { client, reply });
    }

    fn status(&self) -> Vec<ServiceStatus> {
        let silence = Duration::from_secs_f64(self.config.launch.restart.silence_s);
        let status = |(service, entry): (Service, &ProcessEntry)| {
            let health = entry.health();
            let slot = service.slot();
            let counter = |number: fn(&Health) -> u64| health.map_or(0, number);
            ServiceStatus {
                service: service.name().into(),
                stage: slot.map(|slot| self.config.launch.stage(slot).stage.as_str().into()),
                state: entry.state(self.now, silence).into(),
                pid: entry.pid(),
                restarts: entry.restarts(),
                incarnation: entry.incarnation(),
                epoch: slot.and_then(|slot| self.swaps.epoch(slot)).unwrap_or(health.map_or(0, |health| health.epoch)),
                ticks: counter(|health| health.ticks),
                lost: counter(|health| health.lost),
                address: entry.address().map(Into::into),
                diagnostics: entry.diagnostics().to_vec(),
            }
        };
        self.entries().map(status).collect()
    }

    /// Returns the launch file, with the stages that currently fill the slots.
    pub fn launch(&self) -> &Launch {
        &self.config.launch
    }

    /// Returns the services that run on this host.
    pub fn entries(&self) -> impl Iterator<Item = (Service, &ProcessEntry)> {
        self.table.entries().filter(|(service, _)| self.config.launch.services.contains(service))
    }

    /// Returns the services that every tick passes through: those of the data path, and the gateway
    /// of a split system.
    pub(crate) fn path(&self) -> impl Iterator<Item = (Service, &ProcessEntry)> {
        self.entries().filter(|(service, _)| self.config.launch.consumes_ticks(*service))
    }

    /// Returns the newest checkpoint of the service. If the service has a slot, this is the newest
    /// checkpoint of the owner.
    pub fn newest_checkpoint(&self, service: Service) -> Option<&Checkpoint> {
        self.checkpoints.newest(service)
    }

    /// Returns the longest allowed time until the next [`Event::Timer`].
    pub fn poll_interval(&self) -> Duration {
        if !self.flow.is_running() {
            Duration::from_millis(1)
        } else if self.is_swapping() {
            Duration::from_millis(2)
        } else if self.path().all(|(_, entry)| entry.is_settled()) {
            // Every round costs time on the processors of the data path. An exit ends the wait.
            Duration::from_millis(50)
        } else {
            Duration::from_millis(20)
        }
    }

    pub(crate) fn announce(&mut self, line: impl Into<String>) {
        self.actions.push(Action::Announce(line.into()));
    }
}
