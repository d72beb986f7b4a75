//! A topic that programs outside the system publish on, joined again when the system begins anew.

use std::time::Instant;

use bus::{BusError, Feeder, SystemName};
use messages::Message;

use crate::{DriverError, LOOK_INTERVAL};

/// The publishing end of `M` in a system.
#[derive(Debug)]
pub(crate) struct Feed<M: Message> {
    system: SystemName,
    joined: Option<Feeder<M>>,
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
            if !self.joined.as_ref().is_some_and(Feeder::is_running) {
                self.join()?;
            }
        }
        let gone = || BusError::NotRunning { name: self.system.name().into() };
        self.joined.as_ref().ok_or_else(gone).and_then(|joined| joined.send(message)).map_err(DriverError::Bus)
    }

    pub(crate) fn holds(&self) -> usize {
        self.holds
    }

    /// Joins the system that has the name now, in place of the one that had it.
    fn join(&mut self) -> Result<(), DriverError> {
        match Feeder::join(&self.system, "driver") {
            Ok(joined) => {
                self.holds = joined.holds();
                self.joined = Some(joined);
                Ok(())
            }
            // It runs on with what it has open, and so does this.
            Err(BusError::FilesRemoved { .. }) if self.joined.is_some() => Ok(()),
            Err(error) => {
                self.joined = None;
                Err(match error {
                    BusError::Unopened { topic } => DriverError::NotTaken { system: self.system.name().into(), topic },
                    error => DriverError::Bus(error),
                })
            }
        }
    }
}
