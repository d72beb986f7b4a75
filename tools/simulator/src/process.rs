//! Simulated service process, which starts, runs, freezes and exits.

use launch::Service;
use runtime::ServiceConfig;

use crate::{
    bus::Bus,
    flight::Flight,
    slots::{PollContext, SlotProcess},
    source::Source,
};

/// Simulated service process.
pub(crate) struct Process {
    pub(crate) incarnation: u32,
    pub(crate) service: Service,
    /// Set if the process was started as a candidate for its slot.
    pub(crate) candidate: bool,
    pub(crate) state: ProcessState,
    /// Time of the next poll, ms.
    pub(crate) wake_ms: u64,
    pub(crate) frozen_until_ms: u64,
    /// Set once the supervisor has requested termination.
    pub(crate) terminate_requested: bool,
    /// Number of deliveries that the process can make in the next poll before it is killed; `None`
    /// if it is not to be killed.
    pub(crate) deliveries_left: Option<u32>,
    /// First tick with an invalid output; `None` if all outputs are valid.
    pub(crate) invalid_from_tick: Option<u64>,
    /// Exit status; `None` while the process runs.
    pub(crate) exit_status: Option<&'static str>,
}

/// Execution state of a process.
pub(crate) enum ProcessState {
    /// The process has not opened its topics yet. If `fails` is set, it exits before it opens them.
    Starting { config: Box<ServiceConfig>, fails: bool },
    /// The process runs as the source.
    Source(Box<Source>),
    /// The process runs a slot.
    Slot(SlotProcess),
    /// The process hangs, or is the only one on its bus.
    Unresponsive,
}

/// Exit status of a killed process.
pub(crate) const KILLED: &str = "was killed by signal 9";
impl ProcessState {
    /// Opens the topics and starts the service.
    pub(crate) fn start(service: Service, config: &ServiceConfig, bus: &mut Bus) -> Result<Self, String> {
        match service.slot() {
            Some(slot) => SlotProcess::start(slot, config, bus).map(Self::Slot),
            None if service == Service::Ingest => Ok(Self::Source(Box::new(Source::start(config, bus)))),
            None => Err(format!("the service {service} is not simulated")),
        }
    }

    /// Polls the process once. Returns `false` if it is killed.
    pub(crate) fn poll(&mut self, flight: &Flight, context: &mut PollContext<'_>) -> bool {
        match self {
            Self::Source(source) => source.poll(flight, context),
            Self::Slot(slot) => slot.poll(context),
            Self::Starting { .. } | Self::Unresponsive => context.deliveries_left.is_none(),
        }
    }
}

impl Process {
    /// Returns the time of the next poll, ms. It is 0 for an exited process, so that the process is
    /// removed immediately.
    pub(crate) fn next_poll_ms(&self) -> u64 {
        if self.exit_status.is_some() { 0 } else { self.wake_ms.max(self.frozen_until_ms) }
    }

    /// Kills the process, either immediately or in its next poll after `deliveries_left`
    /// deliveries.
    pub(crate) fn kill(&mut self, deliveries_left: Option<u32>) {
        match deliveries_left {
            Some(left) if self.frozen_until_ms <= self.wake_ms => self.deliveries_left = Some(left),
            _ => self.exit_status = Some(KILLED),
        }
    }
}
