//! Feeding a running system without being part of it: a program of somebody's own that publishes on a topic which ingest reads.

use iceoryx2::{node::Node, prelude::ipc};
use messages::Message;

use crate::{BusError, Publisher, SystemName, port::Topic, topic, visit::Visit};

/// The publishing end of `M` in one run of a system.
#[derive(Debug)]
pub struct Feeder<M: Message> {
    visit: Visit,
    /// Given back when the feeder is dropped; the port before the node that it belongs to.
    end: Option<(Publisher<M>, Node<ipc::Service>)>,
    holds: usize,
}

impl<M: Message> Feeder<M> {
    /// Publishes on a topic that is open in the system that runs; `who` is the name under which the port is seen.
    pub fn join(system_name: &SystemName, who: &str) -> Result<Self, BusError> {
        let (visit, inside) = Visit::begin(system_name)?;
        if let Some(path) = system_name.half_made() {
            return Err(BusError::HalfMade { name: system_name.name().into(), path });
        }
        let node = topic::node(system_name, who)?;
        let topic = Topic::open::<M>(&node)?;
        let publisher = Publisher::visiting(&topic, visit.page())?;
        let holds = topic.buffer();
        drop((topic, inside));
        Ok(Self { visit, end: Some((publisher, node)), holds })
    }

    /// Publishes a message and wakes whoever reads it; never waits.
    pub fn send(&self, message: &M) -> Result<(), BusError> {
        let Some((publisher, _)) = &self.end else { return Err(self.visit.system_name().absent()) };
        publisher.send(message)?;
        publisher.wake();
        Ok(())
    }

    /// Messages that the topic holds for each reader.
    pub fn holds(&self) -> usize {
        self.holds
    }

    /// The run that was joined goes on.
    pub fn is_running(&self) -> bool {
        self.visit.is_running()
    }
}

impl<M: Message> Drop for Feeder<M> {
    fn drop(&mut self) {
        self.visit.leave(self.end.take());
    }
}
