//! Topics: typed streams in shared memory.

use std::{cell::Cell, fmt, sync::Arc, time::Duration};

use iceoryx2::{
    node::{Node, NodeBuilder},
    port::{
        publisher::Publisher as IoxPublisher, subscriber::Subscriber as IoxSubscriber,
        update_connections::UpdateConnections,
    },
    prelude::{
        AttributeVerifier, Config, LogLevel, MessagingPattern, NodeName, Service, ServiceName, SignalHandlingMode,
        ZeroCopySend, ipc, set_log_level,
    },
    service::{attribute::AttributeSet, port_factory::publish_subscribe::PortFactory},
};
use messages::Message;

use crate::{BusError, Domain, Woken, observer::OBSERVERS, place::Place, wake::TopicWord};

/// Active, candidate and injector, and as many that were killed and are not yet cleaned up.
pub(crate) const PUBLISHERS: usize = 6;
/// Services of the path, recorder, gateway, four that were killed; and the observers, each after one that was killed.
pub(crate) const SUBSCRIBERS: usize = 12 + 2 * OBSERVERS;
/// Every service says how it is and where.
pub(crate) const EVERYBODY: usize = 24;
/// The topics on which it does.
pub(crate) const OF_EVERYBODY: [&str; 3] =
    [messages::Health::TOPIC, messages::Checkpoint::TOPIC, messages::Difference::TOPIC];
pub(crate) const NODES: usize = 40 + 2 * OBSERVERS;
/// iceoryx2 holds eight attributes of 256 bytes.
pub(crate) const LAYOUT_CHUNK: usize = 250;

/// A process's place on the bus of a system.
#[derive(Debug)]
pub struct Bus {
    config: Config,
    node: Node<ipc::Service>,
    place: Arc<Place>,
}

impl Bus {
    /// Joins the system's bus as `who`.
    pub fn join(domain: &Domain, who: &str) -> Result<Self, BusError> {
        let place = Arc::new(Place::take(domain)?);
        Ok(Self { config: domain.config(), node: node(domain, who)?, place })
    }

    /// Publishes `M`; every topic holds `buffer` messages for each reader before the oldest is overwritten, and as many
    /// for readers that come later.
    pub fn publisher<M: Message>(&self, buffer: usize) -> Result<Publisher<M>, BusError> {
        let service = self.topic::<M>(buffer)?;
        let port = service
            .publisher_builder()
            .max_loaned_samples(1)
            .create()
            .map_err(|cause| BusError::Topic { topic: M::TOPIC, cause: format!("{cause:?}") })?;
        Ok(Publisher { port, word: self.word::<M>() })
    }

    /// Reads `M`, from the next message that is published.
    pub fn subscriber<M: Message>(&self, buffer: usize) -> Result<Subscriber<M>, BusError> {
        self.reader(buffer, 0)
    }

    /// Reads `M`, from the oldest message that its living publishers still hold; they hand them over when they next act.
    pub fn late_subscriber<M: Message>(&self, buffer: usize) -> Result<Subscriber<M>, BusError> {
        self.reader(buffer, buffer)
    }

    /// Wakes everybody who waits for any topic, so that a new reader is noticed.
    pub fn wake_all(&self) {
        self.place.page.wake_all();
    }

    /// The tick after the newest one that was ever about to be published on the topic.
    pub fn next_tick<M: Message>(&self) -> u64 {
        self.word::<M>().next_tick()
    }

    fn reader<M: Message>(&self, buffer: usize, history: usize) -> Result<Subscriber<M>, BusError> {
        let service = self.topic::<M>(buffer)?;
        let port = service
            .subscriber_builder()
            .buffer_size(buffer)
            .history_request(history)
            .create()
            .map_err(|cause| BusError::Topic { topic: M::TOPIC, cause: format!("{cause:?}") })?;
        let word = self.word::<M>();
        Ok(Subscriber { port, seen: Cell::new(word.look()), word })
    }

    fn word<M: Message>(&self) -> TopicWord {
        TopicWord::new(self.place.clone(), M::TOPIC)
    }

    fn topic<M: Message>(&self, buffer: usize) -> Result<PortFactory<ipc::Service, Sample<M>, ()>, BusError> {
        let failed = |cause: &dyn fmt::Debug| BusError::Topic { topic: M::TOPIC, cause: format!("{cause:?}") };
        let name = ServiceName::new(M::TOPIC).map_err(|cause| failed(&cause))?;
        let everybody = OF_EVERYBODY.contains(&M::TOPIC);
        let publishers = if everybody { EVERYBODY } else { PUBLISHERS };
        self.node
            .service_builder(&name)
            .publish_subscribe::<Sample<M>>()
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(buffer)
            .history_size(buffer)
            .subscriber_max_borrowed_samples(1)
            .max_publishers(publishers)
            .max_subscribers(SUBSCRIBERS)
            .max_nodes(NODES)
            .open_or_create_with_attributes(&layout_required::<M>()?)
            .map_err(|cause| unopened::<M>(&self.config, &name, &cause))
    }
}

/// A process's node under the prefix of the system.
pub(crate) fn node(domain: &Domain, who: &str) -> Result<Node<ipc::Service>, BusError> {
    set_log_level(LogLevel::Fatal);
    let failed = |cause: &dyn fmt::Debug| BusError::Node { name: domain.name().into(), cause: format!("{cause:?}") };
    NodeBuilder::new()
        .name(&NodeName::new(who).map_err(|cause| failed(&cause))?)
        .config(&domain.config())
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .map_err(|cause| failed(&cause))
}

/// What a topic's creator must have written down for `M` to be read or published on it.
pub(crate) fn layout_required<M: Message>() -> Result<AttributeVerifier, BusError> {
    let failed = |cause: &dyn fmt::Debug| BusError::Topic { topic: M::TOPIC, cause: format!("{cause:?}") };
    let layout = M::layout().to_string();
    let mut attributes = AttributeVerifier::new();
    for (key, chunk) in layout_chunks(&layout) {
        let (Ok(key), Ok(value)) = (key.as_str().try_into(), chunk.try_into()) else {
            return Err(failed(&"the layout's text is too long"));
        };
        attributes = attributes.require(&key, &value).map_err(|cause| failed(&cause))?;
    }
    Ok(attributes)
}

/// Why a topic could not be opened: another layout, or what iceoryx2 answered.
pub(crate) fn unopened<M: Message>(config: &Config, name: &ServiceName, cause: &dyn fmt::Debug) -> BusError {
    let here = M::layout().to_string();
    match layout_on_bus(config, name) {
        Some(there) if there != here => BusError::Layout { topic: M::TOPIC, here, there },
        _ => BusError::Topic { topic: M::TOPIC, cause: format!("{cause:?}") },
    }
}

/// The layout that the topic's creator wrote down.
fn layout_on_bus(config: &Config, name: &ServiceName) -> Option<String> {
    let details = ipc::Service::details(name, config, MessagingPattern::PublishSubscribe).ok()??;
    let attributes: &AttributeSet = details.static_details.attributes();
    let text: String = attributes.iter().map(|attribute| attribute.value().to_string()).collect();
    (!text.is_empty()).then_some(text)
}

/// The layout's text in pieces that an attribute holds, with keys in their order.
fn layout_chunks(layout: &str) -> impl Iterator<Item = (String, &str)> {
    let chunks = layout.as_bytes().chunks(LAYOUT_CHUNK).enumerate();
    chunks.map(|(i, chunk)| (format!("layout.{i}"), std::str::from_utf8(chunk).unwrap_or_default()))
}

/// A message as iceoryx2 takes it.
#[derive(Debug, Clone, Copy)]
#[repr(transparent)]
pub(crate) struct Sample<M>(pub(crate) M);

#[allow(unsafe_code)]
// SAFETY: `Message` requires `Pod`: `repr(C)`, no pointers, no padding, every bit pattern valid, so it means the same in every
// process; that both sides define it alike is checked by the layout in the topic's attributes.
unsafe impl<M: Message> ZeroCopySend for Sample<M> {
    unsafe fn type_name() -> &'static str {
        M::TYPE
    }
}

/// Publishes on a topic.
#[derive(Debug)]
pub struct Publisher<M: Message> {
    port: IoxPublisher<ipc::Service, Sample<M>, ()>,
    word: TopicWord,
}

impl<M: Message> Publisher<M> {
    /// Puts a message into every reader's buffer; does not wake anybody and never waits.
    pub fn send(&self, message: &M) -> Result<(), BusError> {
        let failed = |cause: &dyn fmt::Debug| BusError::Send { topic: M::TOPIC, cause: format!("{cause:?}") };
        let sample = self.port.loan_uninit().map_err(|cause| failed(&cause))?;
        sample.write_payload(Sample(*message)).send().map_err(|cause| failed(&cause))?;
        Ok(())
    }

    /// Notes the tick of the message that is sent next: whoever goes on in place of a publisher that died knows how far it was.
    pub fn note(&self, tick: u64) {
        self.word.note(tick);
    }

    /// Hands what it holds to readers that have come since it last acted.
    pub fn greet(&self) -> Result<(), BusError> {
        self.port.update_connections().map_err(|cause| BusError::Send { topic: M::TOPIC, cause: format!("{cause:?}") })
    }

    /// Wakes the readers, once after all that was sent.
    pub fn wake(&self) {
        self.word.wake();
    }
}

/// Reads a topic.
#[derive(Debug)]
pub struct Subscriber<M: Message> {
    port: IoxSubscriber<ipc::Service, Sample<M>, ()>,
    word: TopicWord,
    seen: Cell<u32>,
}

impl<M: Message> Subscriber<M> {
    /// The oldest message not yet read.
    pub fn receive(&self) -> Result<Option<M>, BusError> {
        match self.port.receive() {
            Ok(sample) => Ok(sample.map(|sample| sample.payload().0)),
            Err(cause) => Err(BusError::Receive { topic: M::TOPIC, cause: format!("{cause:?}") }),
        }
    }

    /// Hands what is there to `take`, oldest first, at most `limit` messages.
    pub fn drain(&self, limit: usize, mut take: impl FnMut(M)) -> Result<(), BusError> {
        self.seen.set(self.word.look());
        for _ in 0..limit {
            match self.receive()? {
                Some(message) => take(message),
                None => return Ok(()),
            }
        }
        // There may be more: the next wait is none.
        self.seen.set(self.seen.get().wrapping_sub(1));
        Ok(())
    }

    /// The tick after the newest one that was ever about to be published.
    pub fn next_tick(&self) -> u64 {
        self.word.next_tick()
    }

    /// Sleeps until something was published since the last [`drain`](Self::drain) or wait began, no longer than `limit`.
    pub fn wait(&self, limit: Duration) -> Woken {
        let woken = self.word.wait(self.seen.get(), limit);
        self.seen.set(self.word.look());
        woken
    }
}
