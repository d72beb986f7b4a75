//! A topic read by its name: the bytes of its messages, whatever their type.

use std::{fmt, mem, rc::Rc};

use iceoryx2::{
    node::Node,
    port::subscriber::Subscriber,
    prelude::{CallbackProgression, PortFactory as _, ServiceName, ipc},
    service::{builder::publish_subscribe::PublishSubscribeOpenError, port_factory::publish_subscribe::PortFactory},
};
use messages::{Message, Visitor};

use crate::{
    BusError,
    observer::Room,
    topic::{Sample, layout_required, unopened},
};

/// Messages that an observer holds at most; what it is too slow for is overwritten in its own buffer and nowhere else.
const BUFFER: usize = 1024;

/// An observer's end of a topic.
pub struct Tap {
    end: Box<dyn End>,
    room: Rc<Room>,
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
    pub(crate) fn open(node: &Node<ipc::Service>, topic: &str, room: Rc<Room>) -> Result<Self, BusError> {
        let end = messages::with_type(topic, Open(node)).ok_or_else(|| BusError::NoTopic { topic: topic.into() })??;
        Ok(Self { end, room })
    }

    /// Hands what is there to `take`, oldest first; whether messages may have been overwritten before it came to that.
    pub fn drain(&self, take: &mut dyn FnMut(&[u8])) -> Result<bool, BusError> {
        self.end.drain(take)
    }

    /// Who is at the topic.
    pub fn ports(&self) -> Result<Ports, BusError> {
        let members = self.room.members()?;
        let unknown = || Port { name: "unknown".into(), pid: 0, alive: false };
        let port =
            |node: &u128| members.iter().find(|(id, _)| id == node).map_or_else(unknown, |(_, port)| port.clone());
        let [publishers, subscribers] = self.end.nodes().map(|nodes| nodes.iter().map(port).collect());
        Ok(Ports { publishers, subscribers, buffer: self.end.buffer() })
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        self.room.leave(mem::replace(&mut self.end, Box::new(Left)));
    }
}

impl fmt::Debug for Tap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Tap").field("room", &self.room).finish_non_exhaustive()
    }
}

/// What an end does whose type is not known.
trait End {
    fn drain(&self, take: &mut dyn FnMut(&[u8])) -> Result<bool, BusError>;
    /// The nodes of publishers and subscribers.
    fn nodes(&self) -> [Vec<u128>; 2];
    fn buffer(&self) -> usize;
}

struct Typed<M: Message> {
    port: Subscriber<ipc::Service, Sample<M>, ()>,
    service: PortFactory<ipc::Service, Sample<M>, ()>,
}

/// The end that was given back.
struct Left;

impl End for Left {
    fn drain(&self, _: &mut dyn FnMut(&[u8])) -> Result<bool, BusError> {
        Ok(false)
    }

    fn nodes(&self) -> [Vec<u128>; 2] {
        Default::default()
    }

    fn buffer(&self) -> usize {
        0
    }
}

struct Open<'a>(&'a Node<ipc::Service>);

impl Visitor for Open<'_> {
    type Output = Result<Box<dyn End>, BusError>;

    fn visit<M: Message>(self) -> Self::Output {
        let failed = |cause: &dyn fmt::Debug| BusError::Topic { topic: M::TOPIC, cause: format!("{cause:?}") };
        let name = ServiceName::new(M::TOPIC).map_err(|cause| failed(&cause))?;
        let service = self
            .0
            .service_builder(&name)
            .publish_subscribe::<Sample<M>>()
            .open_with_attributes(&layout_required::<M>()?)
            .map_err(|cause| match cause {
                PublishSubscribeOpenError::DoesNotExist => BusError::Unopened { topic: M::TOPIC },
                cause => unopened::<M>(self.0.config(), &name, &cause),
            })?;
        let buffer = BUFFER.min(service.static_config().subscriber_max_buffer_size());
        // What was published before would be handed over by the publishers, on their time.
        let builder = service.subscriber_builder().buffer_size(buffer).history_request(0);
        let port = builder.create().map_err(|cause| failed(&cause))?;
        Ok(Box::new(Typed { port, service }))
    }
}

impl<M: Message> End for Typed<M> {
    fn drain(&self, take: &mut dyn FnMut(&[u8])) -> Result<bool, BusError> {
        let buffer = self.port.buffer_size();
        for taken in 0..2 * buffer {
            match self.port.receive() {
                Ok(Some(sample)) => take(bytemuck::bytes_of(&sample.payload().0)),
                Ok(None) => return Ok(taken >= buffer),
                Err(cause) => return Err(BusError::Receive { topic: M::TOPIC, cause: format!("{cause:?}") }),
            }
        }
        Ok(true)
    }

    fn nodes(&self) -> [Vec<u128>; 2] {
        let [mut publishers, mut subscribers] = [const { Vec::new() }; 2];
        let present = self.service.dynamic_config();
        present.list_publishers(|port| {
            publishers.push(port.node_id.value());
            CallbackProgression::Continue
        });
        present.list_subscribers(|port| {
            subscribers.push(port.node_id.value());
            CallbackProgression::Continue
        });
        [publishers, subscribers]
    }

    fn buffer(&self) -> usize {
        self.service.static_config().subscriber_max_buffer_size()
    }
}
