//! Publisher through which an external program publishes on a topic. It rejoins the system after
//! the system has restarted.

use std::time::{Duration, Instant};

use bus::{BusError, Feeder, SystemName};
use messages::Message;

use crate::error::DriverError;

/// Interval between checks that the joined system is still running.
const CHECK_INTERVAL: Duration = Duration::from_millis(100);

/// Publisher of `M` to whichever running system has the given name.
#[derive(Debug)]
pub(crate) struct Feed<M: Message> {
    system: SystemName,
    feeder: Option<Feeder<M>>,
    last_check: Instant,
    capacity: usize,
}

impl<M: Message> Feed<M> {
    pub(crate) fn open(system: &str) -> Result<Self, DriverError> {
        let system = SystemName::new(system).map_err(DriverError::Bus)?;
        let mut feed = Self { system, feeder: None, last_check: Instant::now(), capacity: 0 };
        feed.join()?;
        Ok(feed)
    }

    pub(crate) fn send(&mut self, message: &M) -> Result<(), DriverError> {
        if self.last_check.elapsed() >= CHECK_INTERVAL {
            self.last_check = Instant::now();
            if !self.feeder.as_ref().is_some_and(Feeder::is_running) {
                self.join()?;
            }
        }
        let not_running = || BusError::NotRunning { name: self.system.name().into() };
        self.feeder.as_ref().ok_or_else(not_running).and_then(|feeder| feeder.send(message)).map_err(DriverError::Bus)
    }

    pub(crate) fn capacity(&self) -> usize {
        self.capacity
    }

    /// Joins the system that currently has the name, replacing the previous connection.
    fn join(&mut self) -> Result<(), DriverError> {
        match Feeder::join(&self.system, "driver") {
            Ok(feeder) => {
                self.capacity = feeder.buffer();
                self.feeder = Some(feeder);
                Ok(())
            }
            // The running system continues to use the files it has open, and so does this
            // connection.
            Err(BusError::FilesRemoved { .. }) if self.feeder.is_some() => Ok(()),
            Err(error) => {
                self.feeder = None;
                Err(match error {
                    BusError::TopicNotOpen { topic } => {
                        DriverError::TopicNotOpen { system: self.system.name().into(), topic }
                    }
                    error => DriverError::Bus(error),
                })
            }
        }
    }
}
