//! Receives readings and fixes over the bus, from the service `drivers` or from user programs.

use bus::{BusError, Subscriber};
use launch::Service;
use messages::{Health, ReceiverReading, SensorReading, State};
use runtime::{RuntimeError, ServiceContext, service_config::CONTROL_BUFFER};

use readings::source::{Reading, receiver_fix};

/// Subscriptions to the topics `sensor` and `receiver`.
pub(crate) struct BusFeed {
    pub(crate) sensor: Subscriber<SensorReading>,
    receiver: Subscriber<ReceiverReading>,
    /// Subscriber to the health reports of the drivers; `None` if user programs publish the
    /// readings.
    drivers: Option<Subscriber<Health>>,
    has_ended: bool,
    overwritten: u64,
}

impl BusFeed {
    pub(crate) fn open(context: &ServiceContext) -> Result<Self, RuntimeError> {
        let has_drivers = context.config.launch.ingest.source.needs_drivers();
        let buffer = context.config.buffer_ticks();
        let bus = &context.bus;
        let (sensor, receiver) = match (has_drivers, context.config.resume.is_some()) {
            // The drivers may publish before this service has started, so the messages they still
            // hold are received, too.
            (true, false) => (bus.late_subscriber(buffer)?, bus.late_subscriber(buffer)?),
            // The previous incarnation has processed nearly everything that the drivers still hold,
            // so only new messages are received.
            (true, true) => (bus.subscriber(buffer)?, bus.subscriber(buffer)?),
            (false, _) => (context.subscriber()?, context.subscriber()?),
        };
        if context.config.resume.is_some() {
            sensor.mark_all_consumed();
        }
        let drivers = has_drivers.then(|| bus.subscriber(CONTROL_BUFFER)).transpose()?;
        Ok(Self { sensor, receiver, drivers, has_ended: false, overwritten: 0 })
    }

    /// Returns `true` if the drivers have finished, so that no further readings will be published.
    pub(crate) fn has_ended(&mut self) -> Result<bool, BusError> {
        let Self { drivers, has_ended, .. } = self;
        let is_finished =
            |health: &Health| health.service == Service::Drivers as u32 && health.state == State::FINISHED;
        if let Some(drivers) = drivers {
            drivers.drain(CONTROL_BUFFER, |health| *has_ended |= is_finished(&health))?;
        }
        Ok(*has_ended)
    }

    /// Passes at most `limit` queued readings to `handle`, oldest first. The first one carries the
    /// newest fix.
    pub(crate) fn drain(&mut self, limit: usize, mut handle: impl FnMut(Reading)) -> Result<(), BusError> {
        let (mut fix, mut count, unconsumed) = (None, 0, self.sensor.unconsumed());
        self.receiver.drain(limit, |reading| fix = Some(receiver_fix(reading)))?;
        self.sensor.drain(limit, |reading| {
            count += 1;
            handle(Reading { fix: fix.take(), ..reading.into() });
        })?;
        self.sensor.add_consumed(count);
        if count < limit as u64 {
            // The topic is empty, so readings that were sent before this drain but not received are
            // lost.
            self.overwritten = self.overwritten.max(unconsumed.saturating_sub(count));
        }
        Ok(())
    }

    /// Returns the number of readings of the drivers that were overwritten before they were
    /// received.
    pub(crate) fn overwritten(&self) -> u64 {
        self.overwritten
    }
}
