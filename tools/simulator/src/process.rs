//! A simulated process: it starts, works, freezes, and dies.

use launch::Service;
use runtime::ServiceConfig;

use crate::{
    bus::Bus,
    flight::Flight,
    slots::{SlotProcess, Turn},
    source::Source,
};

/// A process that has not been seen to end.
pub(crate) struct Process {
    pub(crate) incarnation: u32,
    pub(crate) service: Service,
    /// It was started beside the owner of its slot.
    pub(crate) candidate: bool,
    pub(crate) body: Body,
    /// When its next turn is.
    pub(crate) wake_ms: u64,
    pub(crate) frozen_until_ms: u64,
    /// It was asked to end.
    pub(crate) asked: bool,
    /// It dies in its next turn, after so many deliveries.
    pub(crate) deliveries: Option<u32>,
    pub(crate) flawed_from: Option<u64>,
    /// How it has ended.
    pub(crate) how: Option<&'static str>,
}

/// What a process does.
pub(crate) enum Body {
    /// It has not opened its topics yet, or dies before it does.
    Starting { config: Box<ServiceConfig>, dies: bool },
    /// The source.
    Source(Box<Source>),
    /// A slot.
    Slot(SlotProcess),
    /// It hangs, or is on a bus that nobody else is on.
    Deaf,
}

impl Body {
    /// The topics are open.
    pub(crate) fn begin(service: Service, config: &ServiceConfig, bus: &mut Bus) -> Result<Self, String> {
        Ok(match service {
            Service::Ingest => Self::Source(Box::new(Source::begin(config, bus))),
            service => Self::Slot(SlotProcess::begin(service, config, bus)?),
        })
    }

    /// One turn; whether it lives to its end.
    pub(crate) fn poll(&mut self, flight: &Flight, turn: &mut Turn<'_>) -> bool {
        match self {
            Self::Source(source) => source.poll(flight, turn),
            Self::Slot(slot) => slot.poll(turn),
            Self::Starting { .. } | Self::Deaf => turn.deliveries.is_none(),
        }
    }
}

impl Process {
    /// When it does something next. The dead are seen at once.
    pub(crate) fn next_turn_ms(&self) -> u64 {
        if self.how.is_some() { 0 } else { self.wake_ms.max(self.frozen_until_ms) }
    }

    /// It dies, at once or in the midst of its next turn.
    pub(crate) fn kill(&mut self, deliveries: Option<u32>) {
        match deliveries {
            Some(left) if self.frozen_until_ms <= self.wake_ms => self.deliveries = Some(left),
            _ => self.how = Some("was ended by signal 9"),
        }
    }
}
