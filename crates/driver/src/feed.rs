//! A topic that programs outside the system publish on, joined again when the system begins anew.

use std::time::Instant;

use bus::{Bus, BusError, Publisher, SystemName};
use messages::Message;

use crate::{DriverError, LOOK_INTERVAL};

/// The publishing end of `M` in a system.
#[derive(Debug)]
pub(crate) struct Feed<M: Message> {
    system: SystemName,
    /// The port is dropped before the place on the bus that it belongs to.
    joined: Option<(Publisher<M>, Bus)>,
    looked: Instant,
    holds: usize,
}

impl<M: Message> Feed<M> {
    pub(crate) fn open(system: &str) -> Result<Self, DriverError> {
        let system = SystemName::new(system).map_err(DriverError::Bus)?;
        let mut feed = Self { system, joined: None, looked: Instant::now(), holds: 0 };
        feed.join()?;
        Ok(feed)
    }

    pub(crate) fn send(&mut self, message: &M) -> Result<(), DriverError> {
        if self.looked.elapsed() >= LOOK_INTERVAL {
            self.looked = Instant::now();
            self.joined.take_if(|(_, bus)| !bus.is_running());
            if self.joined.is_none() {
                self.join()?;
            }
        }
        let Some((publisher, _)) = &self.joined else {
            return Err(DriverError::Bus(BusError::NotRunning { name: self.system.name().into() }));
        };
        publisher.send(message).map_err(DriverError::Bus)?;
        publisher.wake();
        Ok(())
    }

    pub(crate) fn holds(&self) -> usize {
        self.holds
    }

    fn join(&mut self) -> Result<(), DriverError> {
        let bus = Bus::join(&self.system, "driver").map_err(DriverError::Bus)?;
        let (publisher, holds) = bus.publisher_of_open::<M>().map_err(|error| match error {
            BusError::Unopened { topic } => DriverError::NotTaken { system: self.system.name().into(), topic },
            error => DriverError::Bus(error),
        })?;
        self.holds = holds;
        self.joined = Some((publisher, bus));
        Ok(())
    }
}
