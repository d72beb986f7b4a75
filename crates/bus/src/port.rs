//! The ends of a topic, whatever it carries: bytes in, bytes out.
//!
//! Every payload goes through iceoryx2 as a slice of bytes of one length, so all of iceoryx2 that a program needs is compiled once,
//! in this crate, and not again for every type in every service. What the bytes are is said by the layout in the topic's attributes.

use std::fmt;

use graph::Entry;
use iceoryx2::{
    node::Node,
    port::{
        publisher::Publisher as IoxPublisher, subscriber::Subscriber as IoxSubscriber,
        update_connections::UpdateConnections,
    },
    prelude::{
        Alignment, AttributeVerifier, CallbackProgression, Config, MessagingPattern, PortFactory as _, Service,
        ServiceName, ipc,
    },
    service::{
        attribute::AttributeSet,
        builder::publish_subscribe::{Builder, PublishSubscribeOpenError},
        port_factory::publish_subscribe::PortFactory,
    },
};
use messages::Message;

use crate::{BusError, machine_limits::why};

/// Observers of a system at once.
pub const OBSERVERS: usize = 4;
/// The owner, a candidate and a tool that feeds samples, and as many killed ones that are not yet cleaned up.
const PUBLISHERS: usize = 6;
/// Two services, of each the owner, a candidate and a killed process that is not yet cleaned up; the gateway twice for that reason; the supervisor for
/// what it needs, for a recorder and for the judge; and each observer twice.
const SUBSCRIBERS: usize = 12 + 2 * OBSERVERS;
/// The same of a topic on which every service or every candidate speaks.
const EVERYBODY: usize = 24;
const NODES: usize = 40 + 2 * OBSERVERS;
/// iceoryx2 holds eight attributes of 256 bytes.
const LAYOUT_CHUNK: usize = 250;
/// Every number of a payload stands where a 64-bit processor reads it at once.
const ALIGNMENT: usize = 8;

/// A topic on the bus of a system.
#[derive(Debug)]
pub(crate) struct Topic {
    name: &'static str,
    bytes: usize,
    factory: PortFactory<ipc::Service, [u8], ()>,
}

impl Topic {
    /// Opens the topic of `M` or creates it, with room for `buffer` messages for each reader and as many for later ones.
    pub(crate) fn open_or_create<M: Message>(node: &Node<ipc::Service>, buffer: usize) -> Result<Self, BusError> {
        Self::create(node, M::TOPIC, size_of::<M>(), &M::layout().to_string(), buffer)
    }

    /// Opens the topic of `M` where there is one.
    pub(crate) fn open<M: Message>(node: &Node<ipc::Service>) -> Result<Self, BusError> {
        Self::find(node, M::TOPIC.name, size_of::<M>(), &M::layout().to_string())
    }

    /// Publishes on it.
    pub(crate) fn publisher(&self) -> Result<Box<dyn OutPort>, BusError> {
        let port = self
            .factory
            .publisher_builder()
            .max_loaned_samples(1)
            .initial_max_slice_len(self.bytes)
            .create()
            .map_err(|cause| failed(self.name, &cause))?;
        Ok(Box::new(Out { topic: self.name, port }))
    }

    /// Reads it, with the `history` newest messages that its living publishers hold.
    pub(crate) fn subscriber(&self, buffer: usize, history: usize) -> Result<Box<dyn InPort>, BusError> {
        let builder = self.factory.subscriber_builder().buffer_size(buffer).history_request(history);
        let port = builder.create().map_err(|cause| failed(self.name, &cause))?;
        Ok(Box::new(In { topic: self.name, port }))
    }

    /// Messages that a reader holds at most.
    pub(crate) fn buffer(&self) -> usize {
        self.factory.static_config().subscriber_max_buffer_size()
    }

    /// The nodes of publishers and subscribers.
    pub(crate) fn nodes(&self) -> [Vec<u128>; 2] {
        let [mut publishers, mut subscribers] = [const { Vec::new() }; 2];
        let present = self.factory.dynamic_config();
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

    fn create(
        node: &Node<ipc::Service>,
        topic: &'static Entry,
        bytes: usize,
        layout: &str,
        buffer: usize,
    ) -> Result<Self, BusError> {
        let (name, builder) = builder(node, topic.name)?;
        let publishers = if topic.publisher.is_many() { EVERYBODY } else { PUBLISHERS };
        let topic = topic.name;
        let factory = builder
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(buffer)
            .history_size(buffer)
            .subscriber_max_borrowed_samples(1)
            .max_publishers(publishers)
            .max_subscribers(SUBSCRIBERS)
            .max_nodes(NODES)
            .open_or_create_with_attributes(&layout_required(topic, layout)?)
            .map_err(|cause| unopened(node.config(), topic, &name, layout, buffer, &cause))?;
        Ok(Self { name: topic, bytes, factory })
    }

    fn find(node: &Node<ipc::Service>, topic: &'static str, bytes: usize, layout: &str) -> Result<Self, BusError> {
        let (name, builder) = builder(node, topic)?;
        let opened = builder.open_with_attributes(&layout_required(topic, layout)?);
        let factory = opened.map_err(|cause| match cause {
            PublishSubscribeOpenError::DoesNotExist => BusError::Unopened { topic },
            cause => unopened(node.config(), topic, &name, layout, 0, &cause),
        })?;
        Ok(Self { name: topic, bytes, factory })
    }
}

/// Publishes the bytes of messages. Behind a trait, so that what iceoryx2 does when it is dropped is compiled here, too.
pub(crate) trait OutPort: fmt::Debug {
    /// Puts a message into every reader's buffer.
    fn send(&self, message: &[u8]) -> Result<(), BusError>;
    /// Hands what it holds to readers that have come since it last acted.
    fn deliver_history(&self) -> Result<(), BusError>;
}

/// Reads the bytes of messages; behind a trait for the same reason.
pub(crate) trait InPort: fmt::Debug {
    /// Hands the oldest message not yet read to `take`; whether there was one.
    fn receive(&self, take: &mut dyn FnMut(&[u8])) -> Result<bool, BusError>;
    /// Messages that it holds at most.
    fn buffer(&self) -> usize;
}

#[derive(Debug)]
struct Out {
    topic: &'static str,
    port: IoxPublisher<ipc::Service, [u8], ()>,
}

impl OutPort for Out {
    fn send(&self, message: &[u8]) -> Result<(), BusError> {
        let failed = |cause: &dyn fmt::Debug| BusError::Send { topic: self.topic, cause: why(cause) };
        let sample = self.port.loan_slice_uninit(message.len()).map_err(|cause| failed(&cause))?;
        sample.write_from_slice(message).send().map_err(|cause| failed(&cause))?;
        Ok(())
    }

    fn deliver_history(&self) -> Result<(), BusError> {
        let updated = self.port.update_connections();
        updated.map_err(|cause| BusError::Send { topic: self.topic, cause: why(&cause) })
    }
}

#[derive(Debug)]
struct In {
    topic: &'static str,
    port: IoxSubscriber<ipc::Service, [u8], ()>,
}

impl InPort for In {
    fn receive(&self, take: &mut dyn FnMut(&[u8])) -> Result<bool, BusError> {
        match self.port.receive() {
            Ok(Some(sample)) => take(sample.payload()),
            Ok(None) => return Ok(false),
            Err(cause) => return Err(BusError::Receive { topic: self.topic, cause: why(&cause) }),
        }
        Ok(true)
    }

    fn buffer(&self) -> usize {
        self.port.buffer_size()
    }
}

/// What a topic is opened with.
type Opening = Builder<[u8], (), ipc::Service>;

fn builder(node: &Node<ipc::Service>, topic: &'static str) -> Result<(ServiceName, Opening), BusError> {
    let name = ServiceName::new(topic).map_err(|cause| failed(topic, &cause))?;
    let alignment = Alignment::new(ALIGNMENT).ok_or_else(|| failed(topic, &"an alignment that is no power of two"))?;
    let builder = node.service_builder(&name).publish_subscribe::<[u8]>().payload_alignment(alignment);
    Ok((name, builder))
}

fn failed(topic: &'static str, cause: &dyn fmt::Debug) -> BusError {
    BusError::Topic { topic, cause: why(cause) }
}

/// What a topic's creator must have written down for it to be read or published.
fn layout_required(topic: &'static str, layout: &str) -> Result<AttributeVerifier, BusError> {
    let mut attributes = AttributeVerifier::new();
    for (key, chunk) in layout_chunks(layout) {
        let (Ok(key), Ok(value)) = (key.as_str().try_into(), chunk.try_into()) else {
            return Err(failed(topic, &"the layout's text is too long"));
        };
        attributes = attributes.require(&key, &value).map_err(|cause| failed(topic, &cause))?;
    }
    Ok(attributes)
}

/// Why a topic could not be opened to hold `buffer` messages: another layout, less room, or what iceoryx2 answered.
fn unopened(
    config: &Config,
    topic: &'static str,
    name: &ServiceName,
    layout: &str,
    buffer: usize,
    cause: &dyn fmt::Debug,
) -> BusError {
    let Ok(Some(details)) = ipc::Service::details(name, config, MessagingPattern::PublishSubscribe) else {
        return failed(topic, cause);
    };
    let held = details.static_details.publish_subscribe().subscriber_max_buffer_size();
    match layout_on_bus(details.static_details.attributes()) {
        Some(there) if there != layout => BusError::Layout { topic, here: layout.into(), there },
        _ if held < buffer => BusError::Buffer { topic, here: buffer, there: held },
        _ => failed(topic, cause),
    }
}

/// The layout that the topic's creator wrote down.
fn layout_on_bus(attributes: &AttributeSet) -> Option<String> {
    let text: String = attributes.iter().map(|attribute| attribute.value().to_string()).collect();
    (!text.is_empty()).then_some(text)
}

/// The layout's text in pieces that an attribute holds, with keys in their order.
fn layout_chunks(layout: &str) -> impl Iterator<Item = (String, &str)> {
    let chunks = layout.as_bytes().chunks(LAYOUT_CHUNK).enumerate();
    chunks.map(|(i, chunk)| (format!("layout.{i}"), std::str::from_utf8(chunk).unwrap_or_default()))
}
