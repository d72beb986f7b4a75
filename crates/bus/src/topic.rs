//! Typed publishers and subscribers of topics in shared memory.

use std::{
    cell::Cell,
    fmt,
    marker::PhantomData,
    sync::{Arc, atomic::AtomicBool},
    time::Duration,
};

use graph::{Entry, Topic};
use iceoryx2::{
    node::{Node, NodeBuilder},
    prelude::{LogLevel, NodeName, SignalHandlingMode, ipc, set_log_level},
};
use messages::{Checkpoint, Message};

use crate::{
    BusError, SystemName, WaitOutcome,
    machine_limits::{describe_cause, grow_file_table, raise_open_file_limit},
    port::{BusTopic, InPort, OutPort},
    process_lease::ProcessLease,
    shared_state::SharedState,
    wake::TopicWaker,
};

/// Interval between full drains, in calls of [`Subscriber::drain`].
///
/// A full drain also reads messages that were not counted when they were published.
const FULL_DRAIN_INTERVAL: u32 = 16;
/// Number of initial calls of [`Subscriber::drain`] that are full drains. History is delivered
/// during these calls.
const FULL_DRAINS_AT_START: u32 = 64;

/// Connection of a process to the bus of a system.
#[derive(Debug)]
pub struct Bus {
    node: Node<ipc::Service>,
    lease: Arc<ProcessLease>,
}

impl Bus {
    /// Joins the bus of a system under `process_name`.
    ///
    /// # Errors
    ///
    /// Fails if the system is not running, its files are not owned by this user, or a limit of the
    /// machine is exceeded.
    pub fn join(system_name: &SystemName, process_name: &str) -> Result<Self, BusError> {
        let place = Arc::new(ProcessLease::acquire(system_name)?);
        Ok(Self { node: create_node(system_name, process_name)?, lease: place })
    }

    /// Creates a publisher of `M`.
    ///
    /// The topic buffers `buffer` messages per subscriber before the oldest is overwritten. It
    /// keeps the same number for late subscribers.
    pub fn publisher<M: Message>(&self, buffer: usize) -> Result<Publisher<M>, BusError> {
        let port = BusTopic::open_or_create::<M>(&self.node, buffer)?.publisher()?;
        Ok(Publisher { port, waker: self.waker(M::TOPIC), payload_type: PhantomData })
    }

    /// Creates a subscriber of `M` that receives messages published from now on.
    pub fn subscriber<M: Message>(&self, buffer: usize) -> Result<Subscriber<M>, BusError> {
        self.subscribe(buffer, 0)
    }

    /// Creates a subscriber of `M` that also receives the messages that its publishers still hold.
    ///
    /// Each publisher delivers them when it next sends a message or delivers its history.
    pub fn late_subscriber<M: Message>(&self, buffer: usize) -> Result<Subscriber<M>, BusError> {
        self.subscribe(buffer, buffer)
    }

    /// Wakes the waiting processes of all topics, so that publishers notice a new subscriber.
    pub fn wake_all(&self) {
        self.lease.state.wake_all();
    }

    /// Returns a handle that wakes the waiting processes, for use by another thread.
    pub fn wake_handle(&self) -> WakeHandle {
        WakeHandle { state: self.lease.state.clone() }
    }

    /// Returns a handle that wakes the subscribers of idle topics.
    pub fn idle_waker(&self) -> IdleWaker {
        IdleWaker { state: self.lease.state.clone(), seen: [0; Topic::ALL.len()] }
    }

    /// Returns the flag that this process sets when it is notified of the owner's death.
    ///
    /// The flag is needed because children of the owner are notified before the owner's death is
    /// visible in `/proc`. If the flag is set, the last process to leave removes the system's
    /// files.
    pub fn owner_exited(&self) -> Arc<AtomicBool> {
        self.lease.owner_exited.clone()
    }

    /// Returns `true` as long as the run that this process joined is in progress.
    pub fn is_running(&self) -> bool {
        self.lease.is_current_run()
    }

    /// Returns the next tick of `topic`: one more than the highest tick announced for publication.
    pub fn next_tick(&self, topic: &Entry) -> u64 {
        self.waker(topic).next_tick()
    }

    fn subscribe<M: Message>(&self, buffer: usize, history: usize) -> Result<Subscriber<M>, BusError> {
        let port = BusTopic::open_or_create::<M>(&self.node, buffer)?.subscriber(buffer, history)?;
        let waker = self.waker(M::TOPIC);
        let (wake_count, published) = (waker.current(), waker.published());
        Ok(Subscriber {
            port,
            waker,
            observed: Cell::new(wake_count),
            read: Cell::new(published),
            drains: Cell::new(0),
            drained_at: Cell::new(wake_count),
            payload_type: PhantomData,
        })
    }

    fn waker(&self, topic: &Entry) -> TopicWaker {
        TopicWaker::new(self.lease.state.clone(), Some(self.lease.clone()), topic)
    }
}

/// Creates the iceoryx2 node of a process under the prefix of the system.
pub(crate) fn create_node(system_name: &SystemName, process_name: &str) -> Result<Node<ipc::Service>, BusError> {
    set_log_level(LogLevel::Fatal);
    raise_open_file_limit()?;
    grow_file_table();
    let failed =
        |cause: &dyn fmt::Debug| BusError::Node { name: system_name.name().into(), cause: describe_cause(cause) };
    NodeBuilder::new()
        .name(&NodeName::new(process_name).map_err(|cause| failed(&cause))?)
        .config(&system_name.config())
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .map_err(|cause| failed(&cause))
}

/// Handle that wakes the waiting processes of all topics.
#[derive(Debug)]
pub struct WakeHandle {
    state: Arc<SharedState>,
}

impl WakeHandle {
    /// Wakes the waiting processes of all topics.
    pub fn wake_all(&self) {
        self.state.wake_all();
    }
}

/// Wakes the subscribers of topics on which nothing is published.
///
/// Services wait without a timer. A woken service reports its health and checks its inputs.
#[derive(Debug)]
pub struct IdleWaker {
    state: Arc<SharedState>,
    /// Wake count of each topic at the previous call.
    seen: [u32; Topic::ALL.len()],
}

impl IdleWaker {
    /// Wakes the subscribers of every topic without a wake-up since the previous call.
    pub fn wake(&mut self) {
        self.state.wake_idle(&mut self.seen);
    }

    /// Wakes the subscribers of every topic. Must be called after a process has exited.
    ///
    /// A publisher clears the flag `waiting` of its topic before it wakes the subscribers. If it is
    /// killed between the two steps, the messages of its successor do not wake them.
    pub fn wake_after_exit(&self) {
        self.state.wake_unannounced();
    }
}

/// Publisher of a topic.
#[derive(Debug)]
pub struct Publisher<M: Message> {
    port: Box<dyn OutPort>,
    waker: TopicWaker,
    payload_type: PhantomData<M>,
}

impl<M: Message> Publisher<M> {
    /// Creates a publisher on an open topic for a process that is not part of the system.
    pub(crate) fn for_session(topic: &BusTopic, state: &Arc<SharedState>) -> Result<Self, BusError> {
        let waker = TopicWaker::new(state.clone(), None, M::TOPIC);
        Ok(Self { port: topic.publisher()?, waker, payload_type: PhantomData })
    }

    /// Writes a message to the buffer of every subscriber. It does not block and wakes no
    /// subscriber.
    pub fn send(&self, message: &M) -> Result<(), BusError> {
        self.send_words(bytemuck::cast_slice(std::slice::from_ref(message)))
    }

    /// Writes the words of a message, or of a checkpoint without its unused words, to the buffer of
    /// every subscriber.
    fn send_words(&self, words: &[u64]) -> Result<(), BusError> {
        self.port.send(words)?;
        self.waker.add_published();
        Ok(())
    }

    /// Announces that `tick` is about to be published.
    ///
    /// The next tick of the topic becomes the tick after it. From that value, a replacement can
    /// determine how far a dead publisher got.
    pub fn set_next_tick_after(&self, tick: u64) {
        self.waker.set_next_tick_after(tick);
    }

    /// Returns the next tick: one more than the highest tick announced for publication.
    pub fn next_tick(&self) -> u64 {
        self.waker.next_tick()
    }

    /// Delivers the buffered history to new subscribers.
    ///
    /// A subscriber is new if it joined after the last message was sent and after the last call of
    /// this function.
    pub fn deliver_history(&self) -> Result<(), BusError> {
        self.port.deliver_history()
    }

    /// Adds `count` to the number of messages sent.
    ///
    /// Used with [`unconsumed`](Self::unconsumed) for flow control with a single subscriber.
    pub fn add_sent(&self, count: u64) {
        self.waker.add_sent(count);
    }

    /// Returns the number of sent messages that the subscriber has not yet consumed.
    pub fn unconsumed(&self) -> u64 {
        self.waker.unconsumed()
    }

    /// Marks all messages sent by a dead predecessor as consumed, so that no publisher waits for
    /// their consumption.
    pub fn mark_all_consumed(&self) {
        self.waker.mark_all_consumed();
    }

    /// Wakes the subscribers. Call it once after sending all messages.
    pub fn wake(&self) {
        self.waker.wake();
    }
}

impl Publisher<Checkpoint> {
    /// Writes a checkpoint to the buffer of every subscriber, without copying its unused words.
    pub fn send_checkpoint(&self, checkpoint: &Checkpoint) -> Result<(), BusError> {
        self.send_words(checkpoint.used_words())
    }
}

/// Subscriber of a topic.
#[derive(Debug)]
pub struct Subscriber<M: Message> {
    port: Box<dyn InPort>,
    waker: TopicWaker,
    observed: Cell<u32>,
    /// Number of published messages that have been read.
    read: Cell<u64>,
    /// Number of times that a drain has read all messages.
    drains: Cell<u32>,
    /// Value of the wake word at the last drain that read all messages.
    drained_at: Cell<u32>,
    payload_type: PhantomData<M>,
}

impl<M: Message> Subscriber<M> {
    /// Returns the oldest unread message, or `None` if all messages have been read.
    pub fn receive(&self) -> Result<Option<M>, BusError> {
        let mut message = None;
        self.receive_with(&mut |received| message = Some(received))?;
        Ok(message)
    }

    /// Passes the oldest unread message to `handle`. Returns `false` if all messages have been
    /// read.
    fn receive_with(&self, handle: &mut impl FnMut(M)) -> Result<bool, BusError> {
        let mut is_valid = true;
        let received = self.port.receive(&mut |bytes| match bytemuck::try_pod_read_unaligned(bytes) {
            Ok(message) => handle(message),
            Err(_) => is_valid = false,
        })?;
        if is_valid {
            return Ok(received);
        }
        let cause = format!("the message does not have {} bytes", size_of::<M>());
        Err(BusError::Receive { topic: M::TOPIC.name, cause })
    }

    /// Passes up to `limit` unread messages to `handle`, oldest first.
    ///
    /// A message that was not counted when it was published is passed after at most 16 calls. This
    /// concerns the history of a topic and the last message of a publisher that was killed.
    /// `handle` must not receive from this subscriber.
    pub fn drain(&self, limit: usize, mut handle: impl FnMut(M)) -> Result<(), BusError> {
        let wake_count = self.waker.current();
        self.observed.set(wake_count);
        let published = self.waker.published();
        let drains = self.drains.get();
        // A publisher that is not part of the system wakes the subscribers without counting its
        // messages.
        let is_uncounted_wake = published == self.read.get() && wake_count != self.drained_at.get();
        let is_full = is_uncounted_wake || drains < FULL_DRAINS_AT_START || drains.is_multiple_of(FULL_DRAIN_INTERVAL);
        let unread = if is_full { u64::MAX } else { published.wrapping_sub(self.read.get()) };
        let limit = limit as u64;
        let mut is_empty = unread <= limit;
        for _ in 0..unread.min(limit) {
            if !self.receive_with(&mut handle)? {
                is_empty = true;
                break;
            }
        }
        if is_empty {
            self.read.set(published);
            self.drained_at.set(wake_count);
            self.drains.set(drains.wrapping_add(1));
        } else {
            // Messages may remain, so the next wait must return immediately.
            self.read.set(self.read.get().wrapping_add(limit));
            self.observed.set(self.observed.get().wrapping_sub(1));
        }
        Ok(())
    }

    /// Returns the number of messages sent but not consumed. It includes messages that were
    /// overwritten before they were received.
    pub fn unconsumed(&self) -> u64 {
        self.waker.unconsumed()
    }

    /// Adds `count` to the number of consumed messages. The publisher may wait for this number to
    /// rise.
    pub fn add_consumed(&self, count: u64) {
        self.waker.add_consumed(count);
    }

    /// Marks all messages sent to a dead predecessor as consumed.
    pub fn mark_all_consumed(&self) {
        self.waker.mark_all_consumed();
    }

    /// Returns the next tick: one more than the highest tick announced for publication.
    pub fn next_tick(&self) -> u64 {
        self.waker.next_tick()
    }

    /// Waits up to `limit` for a message. Returns immediately if one was published since the last
    /// [`drain`](Self::drain) began or the last wait ended.
    ///
    /// With `None`, only the supervisor ends the wait of a topic without messages, by
    /// [`IdleWaker::wake`].
    pub fn wait(&self, limit: impl Into<Option<Duration>>) -> WaitOutcome {
        let outcome = self.waker.wait(self.observed.get(), limit.into());
        self.observed.set(self.waker.current());
        outcome
    }

    /// Returns `true` if [`wait`](Self::wait) would return immediately.
    pub fn has_new_message(&self) -> bool {
        self.waker.current() != self.observed.get()
    }
}

#[cfg(test)]
mod tests {
    use messages::ImuSample;

    use super::*;

    /// Returns the result of receiving a message of `words` words.
    fn receive<M: Message>(words: usize) -> Result<Option<M>, BusError> {
        let name = SystemName::new(&format!("test-length-{}-{}-{words}", std::process::id(), M::TOPIC.name)).unwrap();
        let _claim = name.claim().unwrap();
        let bus = Bus::join(&name, "test").unwrap();
        let (publisher, subscriber) = (bus.publisher::<M>(4).unwrap(), bus.subscriber::<M>(4).unwrap());
        publisher.port.send(&vec![0; words]).unwrap();
        subscriber.receive()
    }

    #[test]
    fn only_checkpoints_may_be_shorter() {
        let complete = size_of::<ImuSample>() / 8;
        assert!(matches!(receive::<ImuSample>(complete), Ok(Some(_))));
        for words in [0, complete - 1] {
            assert!(matches!(receive::<ImuSample>(words), Err(BusError::Receive { .. })), "{words}");
        }
        assert!(matches!(receive::<Checkpoint>(Checkpoint::HEAD_WORDS), Ok(Some(_))));
        assert!(matches!(receive::<Checkpoint>(Checkpoint::HEAD_WORDS - 1), Err(BusError::Receive { .. })));
    }
}
