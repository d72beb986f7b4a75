//! Topics: typed streams in shared memory.

use std::{
    cell::Cell,
    fmt,
    marker::PhantomData,
    sync::{Arc, atomic::AtomicBool},
    time::Duration,
};

use graph::Entry;
use iceoryx2::{
    node::{Node, NodeBuilder},
    prelude::{LogLevel, NodeName, SignalHandlingMode, ipc, set_log_level},
};
use messages::Message;

use crate::{
    BusError, SystemName, Woken,
    machine_limits::{allow_files, why},
    membership::Membership,
    page::Page,
    port::{InPort, OutPort, Topic},
    wake::TopicWord,
};

/// A process's place on the bus of a system.
#[derive(Debug)]
pub struct Bus {
    node: Node<ipc::Service>,
    place: Arc<Membership>,
}

impl Bus {
    /// Joins the system's bus as `who`.
    pub fn join(system_name: &SystemName, who: &str) -> Result<Self, BusError> {
        let place = Arc::new(Membership::take(system_name)?);
        Ok(Self { node: node(system_name, who)?, place })
    }

    /// Publishes `M`; every topic holds `buffer` messages for each reader before the oldest is overwritten, and as many
    /// for readers that come later.
    pub fn publisher<M: Message>(&self, buffer: usize) -> Result<Publisher<M>, BusError> {
        let port = Topic::open_or_create::<M>(&self.node, buffer)?.publisher()?;
        Ok(Publisher { port, word: self.word(M::TOPIC), carries: PhantomData })
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

    /// To be set when the owner of the name has died, which shows only some time after its children are told: whoever is the last to leave then
    /// removes what is left of the system.
    pub fn owner_has_died(&self) -> Arc<AtomicBool> {
        self.place.owner_has_died.clone()
    }

    /// The system is still the one that was joined.
    pub fn is_running(&self) -> bool {
        self.place.is_of_this_run()
    }

    /// The tick after the newest one that was ever about to be published on the topic.
    pub fn next_tick(&self, topic: &Entry) -> u64 {
        self.word(topic).next_tick()
    }

    fn reader<M: Message>(&self, buffer: usize, history: usize) -> Result<Subscriber<M>, BusError> {
        let port = Topic::open_or_create::<M>(&self.node, buffer)?.subscriber(buffer, history)?;
        let word = self.word(M::TOPIC);
        Ok(Subscriber { port, seen: Cell::new(word.look()), word, carries: PhantomData })
    }

    fn word(&self, topic: &Entry) -> TopicWord {
        TopicWord::new(self.place.page.clone(), Some(self.place.clone()), topic)
    }
}

/// A process's node under the prefix of the system.
pub(crate) fn node(system_name: &SystemName, who: &str) -> Result<Node<ipc::Service>, BusError> {
    set_log_level(LogLevel::Fatal);
    allow_files()?;
    let failed = |cause: &dyn fmt::Debug| BusError::Node { name: system_name.name().into(), cause: why(cause) };
    NodeBuilder::new()
        .name(&NodeName::new(who).map_err(|cause| failed(&cause))?)
        .config(&system_name.config())
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .map_err(|cause| failed(&cause))
}

/// Publishes on a topic.
#[derive(Debug)]
pub struct Publisher<M: Message> {
    port: Box<dyn OutPort>,
    word: TopicWord,
    carries: PhantomData<M>,
}

impl<M: Message> Publisher<M> {
    /// On a topic that somebody has opened.
    pub(crate) fn visiting(topic: &Topic, page: &Arc<Page>) -> Result<Self, BusError> {
        let word = TopicWord::new(page.clone(), None, M::TOPIC);
        Ok(Self { port: topic.publisher()?, word, carries: PhantomData })
    }

    /// Puts a message into every reader's buffer; does not wake anybody and never waits.
    pub fn send(&self, message: &M) -> Result<(), BusError> {
        self.port.send(bytemuck::bytes_of(message))
    }

    /// The message that is sent next is of this tick: whoever goes on in place of a publisher that died knows how far it was.
    pub fn set_next_tick_after(&self, tick: u64) {
        self.word.set_next_tick_after(tick);
    }

    /// The tick after the newest one that was ever about to be published.
    pub fn next_tick(&self) -> u64 {
        self.word.next_tick()
    }

    /// Hands what it holds to readers that have come since it last acted.
    pub fn deliver_history(&self) -> Result<(), BusError> {
        self.port.deliver_history()
    }

    /// Counts messages as sent, for a publisher that waits for its one reader: see [`untaken`](Self::untaken).
    pub fn note_sent(&self, count: u64) {
        self.word.note_sent(count);
    }

    /// Messages counted as sent that the reader has not counted as taken.
    pub fn untaken(&self) -> u64 {
        self.word.untaken()
    }

    /// A publisher begins in the place of one that died: what that had sent is not waited for.
    pub fn note_all_taken(&self) {
        self.word.note_all_taken();
    }

    /// Wakes the readers, once after all that was sent.
    pub fn wake(&self) {
        self.word.wake();
    }
}

/// Reads a topic.
#[derive(Debug)]
pub struct Subscriber<M: Message> {
    port: Box<dyn InPort>,
    word: TopicWord,
    seen: Cell<u32>,
    carries: PhantomData<M>,
}

impl<M: Message> Subscriber<M> {
    /// The oldest message not yet read.
    pub fn receive(&self) -> Result<Option<M>, BusError> {
        let mut message = None;
        if !self.port.receive(&mut |bytes| message = bytemuck::try_pod_read_unaligned(bytes).ok())? {
            return Ok(None);
        }
        let cause = || format!("a message that is not of {} bytes", size_of::<M>());
        message.map(Some).ok_or_else(|| BusError::Receive { topic: M::TOPIC.name, cause: cause() })
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

    /// Counts messages as taken, for a publisher that waits for this reader.
    pub fn note_taken(&self, count: u64) {
        self.word.note_taken(count);
    }

    /// A reader begins in the place of one that died: what was sent before is not waited for.
    pub fn note_all_taken(&self) {
        self.word.note_all_taken();
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
