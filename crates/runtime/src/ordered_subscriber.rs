//! Subscriber to a slot's topic that delivers each tick once and in order, across all owners.

use std::{cell::RefCell, collections::VecDeque, time::Duration};

use bus::{BusError, Subscriber, WaitOutcome};
use messages::{Message, Ticked};
use swap::{ReorderBuffer, Role, Sequence};

use crate::service_config::{FIRST_EPOCH, ServiceConfig};

/// Maximum number of publishers with unread messages on a topic: an owner that exited, one that was
/// swapped out and the current one.
const MAX_PUBLISHERS: usize = 3;

/// Subscription of a slot to one of its inputs.
pub trait SlotInput<I> {
    /// Passes up to `limit` available messages to `take`. Returns `true` if there may be more.
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<bool, BusError>;
    /// Sleeps until a message is published, for at most `limit` if given, or until the supervisor
    /// wakes the services that wait for an idle topic.
    fn wait(&self, limit: Option<Duration>) -> WaitOutcome;
    /// Returns `true` if [`wait`](Self::wait) would not sleep.
    fn has_new_message(&self) -> bool;
    /// Returns the tick after the highest one announced for publication.
    fn next_tick(&self) -> u64;
    /// Returns the numbers of discarded messages: duplicates from one publisher, and ticks repeated
    /// by another incarnation.
    fn repeated(&self) -> [u64; 2] {
        [0; 2]
    }
}

/// Subscriptions of a slot, in the order in which it numbers its inputs.
pub type SlotInputs<I> = Vec<Box<dyn SlotInput<I>>>;

/// Subscriber that merges all publishers of a slot into one ordered stream.
#[derive(Debug)]
pub struct OrderedSubscriber<M: Ticked> {
    subscriber: Subscriber<M>,
    stream: RefCell<OrderedStream<M>>,
}

/// Merges the messages of several publishers in tick order.
///
/// A subscriber that was not scheduled for a while reads all messages of one publisher before those
/// of another. Therefore all available messages are sorted by tick before any tick counts as
/// missing.
#[derive(Debug, Clone)]
pub struct OrderedStream<M> {
    reorder_buffer: ReorderBuffer<M>,
    /// Messages that have been read but not delivered yet.
    staged: VecDeque<M>,
    /// Maximum number of staged messages, which is the capacity of the buffers of all publishers
    /// together.
    capacity: usize,
}

impl<M: Ticked> OrderedStream<M> {
    /// Creates a stream that starts at `next_tick`. Ticks before `backlog_end` have been published.
    ///
    /// A candidate waits longer for this backlog than an owner does, namely for half the capacity
    /// of a topic. This is possible because no subscriber waits for a candidate.
    pub fn new(next_tick: u64, backlog_end: u64, config: &ServiceConfig) -> Self {
        let lateness_ticks = config.lateness_ticks() / 2;
        let patience_ticks = match config.role {
            Role::Owner { .. } => lateness_ticks,
            Role::Candidate => config.buffer_ticks() as u64 / 2,
        };
        let mut reorder_buffer = ReorderBuffer::new(next_tick, FIRST_EPOCH, lateness_ticks);
        reorder_buffer.expect_backlog(backlog_end, patience_ticks.max(lateness_ticks));
        Self { reorder_buffer, staged: VecDeque::new(), capacity: MAX_PUBLISHERS * config.buffer_ticks() }
    }

    /// Reads the available messages with `read`, and passes up to `limit` new messages to `take` in
    /// tick order.
    ///
    /// Repeated messages, for example from a restarted publisher, do not count towards `limit`.
    /// `read` receives the maximum number of messages to read. It is lower for a service that is
    /// slower than its input: the service leaves messages on the topic, which overwrites them.
    pub fn advance<E>(
        &mut self,
        limit: usize,
        read: impl FnOnce(usize, &mut dyn FnMut(M)) -> Result<(), E>,
        take: &mut dyn FnMut(M),
    ) -> Result<(), E> {
        let Self { reorder_buffer, staged, capacity } = self;
        let (mut in_order, mut left) = (true, limit);
        let result = read(capacity.saturating_sub(staged.len()), &mut |message| {
            // A message of the next tick precedes all others, so it is delivered without staging.
            if staged.is_empty() && left > 0 && message.header().tick == reorder_buffer.sequence().next_tick {
                left -= 1;
                return reorder_buffer.offer(message, &mut |message, _| take(message));
            }
            in_order &= staged.back().is_none_or(|last| last.header().tick <= message.header().tick);
            staged.push_back(message);
        });
        if !in_order {
            staged.make_contiguous().sort_by_key(|message| message.header().tick);
        }
        while let Some(message) = staged.pop_front() {
            let is_new = message.header().tick >= reorder_buffer.sequence().next_tick;
            if is_new && left == 0 {
                staged.push_front(message);
                break;
            }
            left -= usize::from(is_new);
            reorder_buffer.offer(message, &mut |message, _| take(message));
        }
        result
    }

    /// Delivers all held messages, because no more will arrive.
    pub fn finish(&mut self, take: &mut dyn FnMut(M)) {
        let Self { reorder_buffer, staged, .. } = self;
        staged.drain(..).for_each(|message| reorder_buffer.offer(message, &mut |message, _| take(message)));
        reorder_buffer.finish(&mut |message, _| take(message));
    }

    /// Returns `true` if some messages have been read but not delivered yet.
    pub fn has_staged(&self) -> bool {
        !self.staged.is_empty()
    }

    /// Returns the position and counters of the stream.
    pub fn sequence(&self) -> &Sequence {
        self.reorder_buffer.sequence()
    }
}

impl<M: Ticked> OrderedSubscriber<M> {
    /// Creates a subscriber that starts at `next_tick`.
    pub fn new(subscriber: Subscriber<M>, next_tick: u64, config: &ServiceConfig) -> Self {
        let stream = OrderedStream::new(next_tick, subscriber.next_tick(), config);
        Self { subscriber, stream: RefCell::new(stream) }
    }

    /// Delivers all held messages, because no more will arrive.
    pub fn finish(&self, take: &mut dyn FnMut(M)) {
        self.stream.borrow_mut().finish(take);
    }
}

impl<I: From<M>, M: Ticked> SlotInput<I> for OrderedSubscriber<M> {
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<bool, BusError> {
        let mut stream = self.stream.borrow_mut();
        let read = |count, stage: &mut dyn FnMut(M)| self.subscriber.drain(count, stage);
        stream.advance(limit, read, &mut |message| take(message.into()))?;
        Ok(stream.has_staged())
    }

    fn wait(&self, limit: Option<Duration>) -> WaitOutcome {
        if self.stream.borrow().has_staged() { WaitOutcome::Published } else { self.subscriber.wait(limit) }
    }

    fn has_new_message(&self) -> bool {
        self.stream.borrow().has_staged() || self.subscriber.has_new_message()
    }

    fn next_tick(&self) -> u64 {
        self.subscriber.next_tick()
    }

    fn repeated(&self) -> [u64; 2] {
        let stream = self.stream.borrow();
        let Sequence { duplicated, repeated, .. } = *stream.sequence();
        [duplicated, repeated]
    }
}

impl<I: From<M>, M: Message> SlotInput<I> for Subscriber<M> {
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<bool, BusError> {
        let mut count = 0;
        Subscriber::drain(self, limit, |message| {
            count += 1;
            take(message.into());
        })?;
        Ok(count == limit)
    }

    fn wait(&self, limit: Option<Duration>) -> WaitOutcome {
        Subscriber::wait(self, limit)
    }

    fn has_new_message(&self) -> bool {
        Subscriber::has_new_message(self)
    }

    fn next_tick(&self) -> u64 {
        Subscriber::next_tick(self)
    }
}

#[cfg(test)]
mod tests {
    use messages::{GyroStep, Header};

    use super::*;

    fn stream(next_tick: u64, capacity: usize) -> OrderedStream<GyroStep> {
        let reorder_buffer = ReorderBuffer::new(next_tick, FIRST_EPOCH, 10);
        OrderedStream { reorder_buffer, staged: VecDeque::new(), capacity }
    }

    fn step(tick: u64) -> GyroStep {
        GyroStep {
            header: Header { tick, epoch: FIRST_EPOCH, incarnation: 7, ..bytemuck::Zeroable::zeroed() },
            ..bytemuck::Zeroable::zeroed()
        }
    }

    #[test]
    fn repeated_ticks_do_not_count_towards_read_limit() {
        let (mut stream, mut received) = (stream(40, 100), Vec::new());
        let mut advance = |ticks: std::ops::Range<u64>| {
            let read = |_, stage: &mut dyn FnMut(GyroStep)| -> Result<(), BusError> {
                ticks.map(step).for_each(stage);
                Ok(())
            };
            stream.advance(8, read, &mut |step| received.push(step.header.tick)).is_ok()
        };
        assert!(advance(0..60) && advance(60..60));
        assert_eq!(received, Vec::from_iter(40..56));
    }

    #[test]
    fn stream_that_falls_behind_stages_limited_messages() {
        let (mut stream, mut source, mut received) = (stream(0, 100), (0..).map(step), 0);
        for _ in 0..1000 {
            let read = |count, stage: &mut dyn FnMut(GyroStep)| -> Result<(), BusError> {
                source.by_ref().take(count).for_each(stage);
                Ok(())
            };
            assert!(stream.advance(8, read, &mut |_| received += 1).is_ok());
            assert!(stream.staged.len() <= 100, "{}", stream.staged.len());
        }
        assert_eq!(received, 8000);
    }
}
