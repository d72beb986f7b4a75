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
            if !self.joined.as_ref().is_some_and(|(_, bus)| bus.is_running()) {
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

    /// Joins the system that has the name now, in place of the one that had it.
    fn join(&mut self) -> Result<(), DriverError> {
        let bus = match Bus::join(&self.system, "driver") {
            Ok(bus) => bus,
            // It runs on with what it has open, and so does this.
            Err(BusError::FilesRemoved { .. }) if self.joined.is_some() => return Ok(()),
            Err(error) => {
                self.joined = None;
                return Err(DriverError::Bus(error));
            }
        };
        // Closed first: its topics have the names of the new ones.
        self.joined = None;
        let (publisher, holds) = bus.publisher_of_open::<M>().map_err(|error| match error {
            BusError::Unopened { topic } => DriverError::NotTaken { system: self.system.name().into(), topic },
            error => DriverError::Bus(error),
        })?;
        self.holds = holds;
        self.joined = Some((publisher, bus));
        Ok(())
    }
}
