//! Readings and fixes that come over the bus: from the service `drivers`, or from programs of the user's own.

use bus::{BusError, Subscriber};
use launch::Service;
use messages::{Health, ReceiverReading, SensorReading, State};
use runtime::{RuntimeError, ServiceContext, service_config::CONTROL_BUFFER};

use crate::source::{Reading, fix_of};

/// The topics `sensor` and `receiver`.
pub(crate) struct Feed {
    pub(crate) sensor: Subscriber<SensorReading>,
    receiver: Subscriber<ReceiverReading>,
    /// What the drivers say of themselves; none of programs of the user's own.
    drivers: Option<Subscriber<Health>>,
    has_ended: bool,
}

impl Feed {
    pub(crate) fn open(context: &ServiceContext) -> Result<Self, RuntimeError> {
        let is_driven = context.config.launch.ingest.source.needs_drivers();
        let buffer = context.config.buffer_ticks();
        let bus = &context.bus;
        let (sensor, receiver) = match (is_driven, context.config.resume.is_some()) {
            // The drivers do not wait until this service has started.
            (true, false) => (bus.late_subscriber(buffer)?, bus.late_subscriber(buffer)?),
            // What the drivers still hold has been taken, but for a little.
            (true, true) => (bus.subscriber(buffer)?, bus.subscriber(buffer)?),
            (false, _) => (context.subscriber()?, context.subscriber()?),
        };
        if context.config.resume.is_some() {
            sensor.mark_all_consumed();
        }
        let drivers = is_driven.then(|| bus.subscriber(CONTROL_BUFFER)).transpose()?;
        Ok(Self { sensor, receiver, drivers, has_ended: false })
    }

    /// The drivers are at the end of what they read: nothing comes that is not there by now.
    pub(crate) fn has_ended(&mut self) -> Result<bool, BusError> {
        let Self { drivers, has_ended, .. } = self;
        let is_last = |health: &Health| health.service == Service::Drivers as u32 && health.state == State::FINISHED;
        if let Some(drivers) = drivers {
            drivers.drain(CONTROL_BUFFER, |health| *has_ended |= is_last(&health))?;
        }
        Ok(*has_ended)
    }

    /// Hands what is there to `take`, oldest first, at most `limit` readings, each with the fix that came before it.
    pub(crate) fn drain(&self, limit: usize, mut take: impl FnMut(Reading)) -> Result<(), BusError> {
        let (mut fix, mut taken) = (None, 0);
        self.receiver.drain(limit, |reading| fix = Some(fix_of(reading)))?;
        self.sensor.drain(limit, |reading| {
            taken += 1;
            take(Reading { fix: fix.take(), ..reading.into() });
        })?;
        self.sensor.add_consumed(taken);
        Ok(())
    }
}
