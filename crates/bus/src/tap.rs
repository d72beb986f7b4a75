//! A topic read by its name: the bytes of its messages, whatever their type.

use std::{mem, rc::Rc};

use iceoryx2::{node::Node, prelude::ipc};

use crate::{
    BusError,
    port::{InPort, Topic},
    visit::Visit,
};

/// Messages that an observer holds at most, of what the topic does; what it is too slow for is overwritten in its own buffer and nowhere else.
const BUFFER: usize = 16_384;

/// An observer's end of a topic.
#[derive(Debug)]
pub struct Tap {
    /// Given back when the tap is dropped.
    end: Option<End>,
    visit: Rc<Visit>,
}

#[derive(Debug)]
struct End {
    topic: Topic,
    port: Box<dyn InPort>,
}

/// Who is at a topic.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Ports {
    /// Who publishes.
    pub publishers: Vec<Port>,
    /// Who reads, this observer among them.
    pub subscribers: Vec<Port>,
    /// Messages that a reader holds at most.
    pub buffer: usize,
}

/// A process at a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// The name that it joined the bus under.
    pub name: String,
    /// Its process.
    pub pid: u32,
    /// It has not been killed.
    pub alive: bool,
}

impl Tap {
    pub(crate) fn open(node: &Node<ipc::Service>, topic: graph::Topic, visit: Rc<Visit>) -> Result<Self, BusError> {
        let topic = messages::dispatch!(topic, M => Topic::open::<M>(node))?;
        // What was published before would be handed over by the publishers, on their time.
        let port = topic.subscriber(BUFFER.min(topic.buffer()), 0)?;
        Ok(Self { end: Some(End { topic, port }), visit })
    }

    /// Hands what is there to `take`, oldest first; whether messages may have been overwritten before it came to that.
    pub fn drain(&self, take: &mut dyn FnMut(&[u8])) -> Result<bool, BusError> {
        let Some(End { port, .. }) = &self.end else { return Ok(false) };
        let buffer = port.buffer();
        for taken in 0..2 * buffer {
            if !port.receive(take)? {
                return Ok(taken >= buffer);
            }
        }
        Ok(true)
    }

    /// Who is at the topic.
    pub fn ports(&self) -> Result<Ports, BusError> {
        let Some(End { topic, .. }) = &self.end else { return Ok(Ports::default()) };
        let members = self.visit.members()?;
        let unknown = || Port { name: "unknown".into(), pid: 0, alive: false };
        let port =
            |node: &u128| members.iter().find(|(id, _)| id == node).map_or_else(unknown, |(_, port)| port.clone());
        let [publishers, subscribers] = topic.nodes().map(|nodes| nodes.iter().map(port).collect());
        Ok(Ports { publishers, subscribers, buffer: topic.buffer() })
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        self.visit.leave(mem::take(&mut self.end));
    }
}
