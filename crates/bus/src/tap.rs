//! Untyped access to a topic that is chosen at run time. Messages are read as bytes.

use std::{mem, rc::Rc};

use iceoryx2::{node::Node, prelude::ipc};

use crate::{
    BusError,
    port::{BusTopic, InPort},
    session::{ObserverSession, Port},
};

/// Maximum number of messages buffered for an observer. If the observer is too slow, messages are
/// overwritten in its own buffer only.
const MAX_BUFFER: usize = 16_384;

/// Subscription of an observer to a topic.
#[derive(Debug)]
pub struct Tap {
    /// Port and topic, released when the tap is dropped.
    endpoint: Option<Endpoint>,
    session: Rc<ObserverSession>,
}

#[derive(Debug)]
struct Endpoint {
    topic: BusTopic,
    port: Box<dyn InPort>,
}

/// Processes connected to a topic.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Ports {
    /// Publishing processes.
    pub publishers: Vec<Port>,
    /// Subscribing processes, including this observer.
    pub subscribers: Vec<Port>,
    /// Maximum number of messages buffered per subscriber.
    pub buffer: usize,
}

impl Tap {
    pub(crate) fn open(
        node: &Node<ipc::Service>,
        topic: graph::Topic,
        session: Rc<ObserverSession>,
    ) -> Result<Self, BusError> {
        let topic = messages::dispatch!(topic, M => BusTopic::open::<M>(node))?;
        // History is not requested, because its delivery would cost the publishers time.
        let port = topic.subscriber(MAX_BUFFER.min(topic.buffer()), 0)?;
        Ok(Self { endpoint: Some(Endpoint { topic, port }), session })
    }

    /// Passes the buffered messages to `handle`, oldest first.
    ///
    /// Returns `true` if messages may have been overwritten before they were read.
    pub fn drain(&self, handle: &mut dyn FnMut(&[u8])) -> Result<bool, BusError> {
        let Some(Endpoint { port, .. }) = &self.endpoint else { return Ok(false) };
        let buffer = port.buffer();
        for count in 0..2 * buffer {
            if !port.receive(handle)? {
                return Ok(count >= buffer);
            }
        }
        Ok(true)
    }

    /// Returns the processes connected to the topic.
    pub fn ports(&self) -> Result<Ports, BusError> {
        let Some(Endpoint { topic, .. }) = &self.endpoint else { return Ok(Ports::default()) };
        let processes = self.session.processes()?;
        let unknown = || Port { name: "unknown".into(), pid: 0, alive: false };
        let port =
            |node: &u128| processes.iter().find(|(id, _)| id == node).map_or_else(unknown, |(_, port)| port.clone());
        let [publishers, subscribers] = topic.nodes().map(|nodes| nodes.iter().map(port).collect());
        Ok(Ports { publishers, subscribers, buffer: topic.buffer() })
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        self.session.release(mem::take(&mut self.endpoint));
    }
}
