//! Feeders: external programs that publish on a topic of a running system, for ingest to read.

use iceoryx2::{node::Node, prelude::ipc};
use messages::Message;

use crate::{BusError, Publisher, SystemName, port::BusTopic, session::ObserverSession, topic};

/// Publisher of `M` that is connected to one run of a system without being part of the system.
#[derive(Debug)]
pub struct Feeder<M: Message> {
    session: ObserverSession,
    /// Publisher and its node, released when the feeder is dropped. The publisher comes first, so
    /// that it is dropped before the node.
    endpoint: Option<(Publisher<M>, Node<ipc::Service>)>,
    buffer: usize,
}

impl<M: Message> Feeder<M> {
    /// Joins the running system and publishes on the topic of `M`.
    ///
    /// `process_name` is the name under which the port is listed.
    ///
    /// # Errors
    ///
    /// Fails if the system is not running, the topic is not open or its layout differs.
    pub fn join(system_name: &SystemName, process_name: &str) -> Result<Self, BusError> {
        let (session, lock) = ObserverSession::open(system_name)?;
        if let Some(path) = system_name.incomplete_segment() {
            return Err(BusError::IncompleteSegment { name: system_name.name().into(), path });
        }
        let node = topic::create_node(system_name, process_name)?;
        let topic = BusTopic::open::<M>(&node)?;
        let publisher = Publisher::for_session(&topic, session.state())?;
        let buffer = topic.buffer();
        drop((topic, lock));
        Ok(Self { session, endpoint: Some((publisher, node)), buffer })
    }

    /// Publishes a message and wakes the subscribers, without blocking.
    pub fn send(&self, message: &M) -> Result<(), BusError> {
        let Some((publisher, _)) = &self.endpoint else { return Err(self.session.system_name().absence_error()) };
        publisher.send(message)?;
        publisher.wake();
        Ok(())
    }

    /// Returns the number of messages that the topic buffers per subscriber.
    pub fn buffer(&self) -> usize {
        self.buffer
    }

    /// Returns `true` while the run that the feeder joined continues.
    pub fn is_running(&self) -> bool {
        self.session.is_running()
    }
}

impl<M: Message> Drop for Feeder<M> {
    fn drop(&mut self) {
        self.session.release(self.endpoint.take());
    }
}
