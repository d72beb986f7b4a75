//! Untyped ports of a topic, which send and receive bytes.
//!
//! Every payload passes through iceoryx2 as a slice of [`Word`]s. Therefore iceoryx2's generic code
//! is compiled once, in this crate, instead of for every payload type in every service. The topic's
//! attributes describe the layout of the bytes. A checkpoint is sent without its unused words, and
//! completed with zeros when it is received.

use std::{any::TypeId, cell::RefCell, fmt, ops::RangeInclusive};

use graph::{Entry, Service, Slot};
use iceoryx2::{
    node::Node,
    port::{
        publisher::Publisher as IoxPublisher, subscriber::Subscriber as IoxSubscriber,
        update_connections::UpdateConnections,
    },
    prelude::{
        AttributeVerifier, CallbackProgression, Config, MessagingPattern, PortFactory as _, Service as _, ServiceName,
        ipc,
    },
    service::{
        attribute::AttributeSet,
        builder::publish_subscribe::{Builder, PublishSubscribeOpenError},
        port_factory::publish_subscribe::PortFactory,
    },
};
use messages::{Checkpoint, Message};

use crate::{error::BusError, limits::MAX_OBSERVERS, machine_limits::describe_cause};

/// Maximum number of publishers of a topic.
///
/// Owner, candidate and feeder may each be accompanied by a killed process that has not been
/// cleaned up yet.
const MAX_PUBLISHERS: usize = 6;
/// Maximum number of subscriptions of a service to a topic.
///
/// The subscribers are the owner, a candidate and a killed process that has not been cleaned up
/// yet.
const MAX_SERVICE_SUBSCRIPTIONS: usize = 3;
/// Maximum number of subscriptions to a topic by processes that are not services.
///
/// The subscribers are the gateway and a killed predecessor, the supervisor with its recorder and
/// input check, and the observers. Two subscriptions are spare. Before an observer attaches, it
/// removes the subscriptions of killed observers.
const MAX_OTHER_SUBSCRIPTIONS: usize = 7 + MAX_OBSERVERS;
/// Maximum number of publishers of a topic on which every service or every candidate publishes.
///
/// Each of them may be accompanied by a killed process that has not been cleaned up yet. A
/// subscriber also keeps the unread messages of publishers that have exited, up to this number.
pub(crate) const MAX_SERVICE_PORTS: usize = 2 * (Service::ALL.len() + Slot::ALL.len());
/// Maximum number of processes of a system: those of services and candidates, 16 others such as
/// feeders, and observers. It includes killed processes that have not been cleaned up yet.
const MAX_NODES: usize = MAX_SERVICE_PORTS + 16 + 2 * MAX_OBSERVERS;
/// Length in bytes of each piece into which the layout text is split. Each piece becomes an
/// attribute of the topic. iceoryx2 stores eight attributes of 256 bytes.
const LAYOUT_CHUNK_BYTES: usize = 250;
/// Element of a payload. A 64-bit processor reads aligned numbers in one access. Slices of aligned
/// bytes would occupy eight times the memory, because iceoryx2 then aligns every byte.
type Word = u64;

/// Topic on the bus of a system.
#[derive(Debug)]
pub(crate) struct BusTopic {
    name: &'static str,
    /// Permitted lengths of a message in words.
    lengths: RangeInclusive<usize>,
    factory: PortFactory<ipc::Service, [Word], ()>,
}

impl BusTopic {
    /// Opens or creates the topic of `M`. It buffers `buffer` messages per subscriber and keeps the
    /// same number as history.
    pub(crate) fn open_or_create<M: Message>(node: &Node<ipc::Service>, buffer: usize) -> Result<Self, BusError> {
        Self::open_or_create_words(node, M::TOPIC, lengths::<M>(), &M::layout().to_string(), buffer)
    }

    /// Opens the existing topic of `M`.
    pub(crate) fn open<M: Message>(node: &Node<ipc::Service>) -> Result<Self, BusError> {
        Self::open_existing(node, M::TOPIC.name, lengths::<M>(), &M::layout().to_string())
    }

    /// Creates a publishing port.
    pub(crate) fn publisher(&self) -> Result<Box<dyn OutPort>, BusError> {
        let port = self
            .factory
            .publisher_builder()
            .max_loaned_samples(1)
            .initial_max_slice_len(*self.lengths.end())
            .create()
            .map_err(|cause| failed(self.name, &cause))?;
        Ok(Box::new(IoxOutPort { topic: self.name, port }))
    }

    /// Creates a subscribing port. It also receives up to `history` of the newest messages that
    /// publishers still hold.
    pub(crate) fn subscriber(&self, buffer: usize, history: usize) -> Result<Box<dyn InPort>, BusError> {
        let builder = self.factory.subscriber_builder().buffer_size(buffer).history_request(history);
        let port = builder.create().map_err(|cause| failed(self.name, &cause))?;
        let lengths = self.lengths.clone();
        Ok(Box::new(IoxInPort { topic: self.name, lengths, port, completed: RefCell::default() }))
    }

    /// Returns the maximum number of messages buffered per subscriber.
    pub(crate) fn buffer(&self) -> usize {
        self.factory.static_config().subscriber_max_buffer_size()
    }

    /// Returns the node identifiers of the publishers and of the subscribers.
    pub(crate) fn nodes(&self) -> [Vec<u128>; 2] {
        let [mut publishers, mut subscribers] = [const { Vec::new() }; 2];
        let ports = self.factory.dynamic_config();
        ports.list_publishers(|port| {
            publishers.push(port.node_id.value());
            CallbackProgression::Continue
        });
        ports.list_subscribers(|port| {
            subscribers.push(port.node_id.value());
            CallbackProgression::Continue
        });
        [publishers, subscribers]
    }

    fn open_or_create_words(
        node: &Node<ipc::Service>,
        topic: &'static Entry,
        lengths: RangeInclusive<usize>,
        layout: &str,
        buffer: usize,
    ) -> Result<Self, BusError> {
        let (name, builder) = builder(node, topic.name)?;
        let publishers = if topic.publisher.is_many() { MAX_SERVICE_PORTS } else { MAX_PUBLISHERS };
        // Each possible subscription makes every send slower, so only the services that subscribe
        // are counted.
        let services = Service::ALL.into_iter().filter(|service| topic.is_subscribed_by(*service)).count();
        let subscribers = MAX_SERVICE_SUBSCRIPTIONS * services + MAX_OTHER_SUBSCRIPTIONS;
        let topic = topic.name;
        let factory = builder
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(buffer)
            .history_size(buffer)
            .subscriber_max_borrowed_samples(1)
            .max_publishers(publishers)
            .max_subscribers(subscribers)
            .max_nodes(MAX_NODES)
            .open_or_create_with_attributes(&required_layout(topic, layout)?)
            .map_err(|cause| open_error(node.config(), topic, &name, layout, buffer, &cause))?;
        Ok(Self { name: topic, lengths, factory })
    }

    fn open_existing(
        node: &Node<ipc::Service>,
        topic: &'static str,
        lengths: RangeInclusive<usize>,
        layout: &str,
    ) -> Result<Self, BusError> {
        let (name, builder) = builder(node, topic)?;
        let opened = builder.open_with_attributes(&required_layout(topic, layout)?);
        let factory = opened.map_err(|cause| match cause {
            PublishSubscribeOpenError::DoesNotExist => BusError::TopicNotOpen { topic },
            cause => open_error(node.config(), topic, &name, layout, 0, &cause),
        })?;
        Ok(Self { name: topic, lengths, factory })
    }
}

/// Publishing port for bytes. It is a trait object so that iceoryx2's drop code stays in this
/// crate.
pub(crate) trait OutPort: fmt::Debug {
    /// Writes a message to the buffer of every subscriber. A checkpoint may be sent without its
    /// unused words.
    fn send(&self, message: &[Word]) -> Result<(), BusError>;
    /// Delivers the buffered history to new subscribers.
    ///
    /// A subscriber is new if it has joined since the last message was sent or this function was
    /// last called.
    fn deliver_history(&self) -> Result<(), BusError>;
}

/// Subscribing port for bytes. It is a trait object so that iceoryx2's drop code stays in this
/// crate.
pub(crate) trait InPort: fmt::Debug {
    /// Passes the oldest unread message to `handle`. Returns `false` if there was no such message.
    fn receive(&self, handle: &mut dyn FnMut(&[u8])) -> Result<bool, BusError>;
    /// Returns the maximum number of messages in the buffer.
    fn buffer(&self) -> usize;
}

#[derive(Debug)]
struct IoxOutPort {
    topic: &'static str,
    port: IoxPublisher<ipc::Service, [Word], ()>,
}

impl OutPort for IoxOutPort {
    fn send(&self, message: &[Word]) -> Result<(), BusError> {
        let failed = |cause: &dyn fmt::Debug| BusError::Send { topic: self.topic, cause: describe_cause(cause) };
        let sample = self.port.loan_slice_uninit(message.len()).map_err(|cause| failed(&cause))?;
        sample.write_from_slice(message).send().map_err(|cause| failed(&cause))?;
        Ok(())
    }

    fn deliver_history(&self) -> Result<(), BusError> {
        let updated = self.port.update_connections();
        updated.map_err(|cause| BusError::Send { topic: self.topic, cause: describe_cause(&cause) })
    }
}

#[derive(Debug)]
struct IoxInPort {
    topic: &'static str,
    /// Permitted lengths of a message in words. The last is that of a complete message.
    lengths: RangeInclusive<usize>,
    port: IoxSubscriber<ipc::Service, [Word], ()>,
    /// Buffer in which a message is completed.
    completed: RefCell<Vec<Word>>,
}

impl InPort for IoxInPort {
    fn receive(&self, handle: &mut dyn FnMut(&[u8])) -> Result<bool, BusError> {
        match self.port.receive() {
            Ok(Some(sample)) if (*self.lengths.start()..*self.lengths.end()).contains(&sample.payload().len()) => {
                let mut completed = self.completed.take();
                completed.clear();
                completed.extend_from_slice(sample.payload());
                completed.resize(*self.lengths.end(), 0);
                handle(bytemuck::cast_slice(&completed));
                self.completed.replace(completed);
            }
            Ok(Some(sample)) => handle(bytemuck::cast_slice(sample.payload())),
            Ok(None) => return Ok(false),
            Err(cause) => return Err(BusError::Receive { topic: self.topic, cause: describe_cause(&cause) }),
        }
        Ok(true)
    }

    fn buffer(&self) -> usize {
        self.port.buffer_size()
    }
}

/// Returns the permitted lengths of a payload in words. Only a checkpoint may be sent without its
/// last words.
fn lengths<M: Message>() -> RangeInclusive<usize> {
    const { assert!(size_of::<M>().is_multiple_of(size_of::<Word>()) && align_of::<M>() >= align_of::<Word>()) };
    let words = size_of::<M>() / size_of::<Word>();
    if TypeId::of::<M>() == TypeId::of::<Checkpoint>() { Checkpoint::HEAD_WORDS..=words } else { words..=words }
}

type TopicBuilder = Builder<[Word], (), ipc::Service>;

fn builder(node: &Node<ipc::Service>, topic: &'static str) -> Result<(ServiceName, TopicBuilder), BusError> {
    let name = ServiceName::new(topic).map_err(|cause| failed(topic, &cause))?;
    let builder = node.service_builder(&name).publish_subscribe::<[Word]>();
    Ok((name, builder))
}

fn failed(topic: &'static str, cause: &dyn fmt::Debug) -> BusError {
    BusError::Topic { topic, cause: describe_cause(cause) }
}

/// Returns the layout attributes that an existing topic must have.
fn required_layout(topic: &'static str, layout: &str) -> Result<AttributeVerifier, BusError> {
    let mut attributes = AttributeVerifier::new();
    for (key, chunk) in layout_chunks(layout) {
        let (Ok(key), Ok(value)) = (key.as_str().try_into(), chunk.try_into()) else {
            return Err(failed(topic, &"the layout text is too long"));
        };
        attributes = attributes.require(&key, &value).map_err(|cause| failed(topic, &cause))?;
    }
    Ok(attributes)
}

/// Explains why a topic cannot be opened: different layout, smaller buffer or another cause.
fn open_error(
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
    let buffer_on_bus = details.static_details.publish_subscribe().subscriber_max_buffer_size();
    match layout_on_bus(details.static_details.attributes()) {
        Some(there) if there != layout => BusError::LayoutMismatch { topic, here: layout.into(), there },
        _ if buffer_on_bus < buffer => BusError::BufferMismatch { topic, here: buffer, there: buffer_on_bus },
        _ => failed(topic, cause),
    }
}

/// Returns the layout stored by the creator of the topic.
fn layout_on_bus(attributes: &AttributeSet) -> Option<String> {
    let text: String = attributes.iter().map(|attribute| attribute.value().to_string()).collect();
    (!text.is_empty()).then_some(text)
}

/// Splits the layout text into attribute-sized pieces with ordered keys.
fn layout_chunks(layout: &str) -> impl Iterator<Item = (String, &str)> {
    let chunks = layout.as_bytes().chunks(LAYOUT_CHUNK_BYTES).enumerate();
    chunks.map(|(i, chunk)| (format!("layout.{i}"), std::str::from_utf8(chunk).unwrap_or_default()))
}
