//! A topic as a slot reads it: each tick once, in order, whoever publishes.

use std::{cell::RefCell, collections::VecDeque, time::Duration};

use bus::{BusError, Subscriber, Woken};
use messages::{Message, Ticked};
use swap::{ReorderBuffer, Role, Sequence};

use crate::service_config::{FIRST_EPOCH, ServiceConfig};

/// Publishers of a topic whose messages may wait at once: an owner that has ended, one that has been swapped, the next.
const PUBLISHERS_MAX: usize = 3;

/// A topic that a slot reads.
pub trait Input<I> {
    /// Hands what is there to `take`, at most `limit` messages.
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<(), BusError>;
    /// Sleeps until something is published, no longer than `limit`.
    fn wait(&self, limit: Duration) -> Woken;
    /// The tick after the newest one that was ever about to be published.
    fn next_tick(&self) -> u64;
    /// Messages left out because they came again: by fault, and because another incarnation said them again.
    fn repeated(&self) -> [u64; 2] {
        [0; 2]
    }
}

/// One stream out of all that fill a slot.
#[derive(Debug)]
pub struct Reader<M: Ticked> {
    subscriber: Subscriber<M>,
    /// Messages read at a time: what the buffers of its publishers hold.
    read_max: usize,
    stream: RefCell<Stream<M>>,
}

/// One stream out of what several publishers have sent, whatever the order in which it is read.
///
/// A reader that was away finds the messages of one publisher before those of another. What is there is brought into the order of ticks
/// before any of it counts as missing.
#[derive(Debug, Clone)]
pub struct Stream<M> {
    reorder_buffer: ReorderBuffer<M>,
    staged: VecDeque<M>,
}

impl<M: Ticked> Stream<M> {
    /// Begins with `next_tick`; before `expected_until` everything has been published, and is on its way. Nobody waits for a candidate, so
    /// it may wait for that as long as a topic surely holds what comes meanwhile.
    pub fn new(next_tick: u64, expected_until: u64, config: &ServiceConfig) -> Self {
        let lateness_ticks = config.lateness_ticks() / 2;
        let patience_ticks = match config.role {
            Role::Owner { .. } => lateness_ticks,
            Role::Candidate => config.buffer_ticks() as u64 / 2,
        };
        let mut reorder_buffer = ReorderBuffer::starting(next_tick, FIRST_EPOCH, lateness_ticks);
        reorder_buffer.expect_until(expected_until, patience_ticks.max(lateness_ticks));
        Self { reorder_buffer, staged: VecDeque::new() }
    }

    /// Takes all that is there from `read`, and hands what has its turn of at most `limit` messages to `take`. What comes again, as from a
    /// publisher that was started again, does not count: nobody else has to wait for it.
    pub fn advance<E>(
        &mut self,
        limit: usize,
        read: impl FnOnce(&mut dyn FnMut(M)) -> Result<(), E>,
        take: &mut dyn FnMut(M),
    ) -> Result<(), E> {
        let Self { reorder_buffer, staged } = self;
        let mut in_order = true;
        let result = read(&mut |message| {
            in_order &= staged.back().is_none_or(|last| last.header().tick <= message.header().tick);
            staged.push_back(message);
        });
        if !in_order {
            staged.make_contiguous().sort_by_key(|message| message.header().tick);
        }
        let mut left = limit;
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

    /// Hands over what still waits for ticks before it: nothing more comes.
    pub fn finish(&mut self, take: &mut dyn FnMut(M)) {
        let Self { reorder_buffer, staged } = self;
        staged.drain(..).for_each(|message| reorder_buffer.offer(message, &mut |message, _| take(message)));
        reorder_buffer.finish(&mut |message, _| take(message));
    }

    /// There is something that was not handed over yet.
    pub fn is_staged(&self) -> bool {
        !self.staged.is_empty()
    }

    /// The stream so far.
    pub fn sequence(&self) -> &Sequence {
        self.reorder_buffer.sequence()
    }
}

impl<M: Ticked> Reader<M> {
    /// Begins with `next_tick`.
    pub fn new(subscriber: Subscriber<M>, next_tick: u64, config: &ServiceConfig) -> Self {
        let read_max = PUBLISHERS_MAX * config.buffer_ticks();
        let stream = Stream::new(next_tick, subscriber.next_tick(), config);
        Self { subscriber, read_max, stream: RefCell::new(stream) }
    }

    /// Hands over what still waits for ticks before it: nothing more comes.
    pub fn finish(&self, take: &mut dyn FnMut(M)) {
        self.stream.borrow_mut().finish(take);
    }
}

impl<I: From<M>, M: Ticked> Input<I> for Reader<M> {
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<(), BusError> {
        let read = |stage: &mut dyn FnMut(M)| self.subscriber.drain(self.read_max, stage);
        self.stream.borrow_mut().advance(limit, read, &mut |message| take(message.into()))
    }

    fn wait(&self, limit: Duration) -> Woken {
        if self.stream.borrow().is_staged() { Woken::Work } else { self.subscriber.wait(limit) }
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

impl<I: From<M>, M: Message> Input<I> for Subscriber<M> {
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<(), BusError> {
        Subscriber::drain(self, limit, |message| take(message.into()))
    }

    fn wait(&self, limit: Duration) -> Woken {
        Subscriber::wait(self, limit)
    }

    fn next_tick(&self) -> u64 {
        Subscriber::next_tick(self)
    }
}

#[cfg(test)]
mod tests {
    use messages::{GyroStep, Header};

    use super::*;

    #[test]
    fn what_is_said_again_does_not_keep_what_is_new_waiting() {
        let mut stream =
            Stream { reorder_buffer: ReorderBuffer::starting(40, FIRST_EPOCH, 10), staged: VecDeque::new() };
        let step = |tick| GyroStep {
            header: Header { tick, epoch: FIRST_EPOCH, incarnation: 7, ..bytemuck::Zeroable::zeroed() },
            ..bytemuck::Zeroable::zeroed()
        };
        let mut taken = Vec::new();
        let mut advance = |ticks: std::ops::Range<u64>| {
            let read = |stage: &mut dyn FnMut(GyroStep)| -> Result<(), BusError> {
                ticks.map(step).for_each(stage);
                Ok(())
            };
            stream.advance(8, read, &mut |step| taken.push(step.header.tick)).is_ok()
        };
        assert!(advance(0..60) && advance(60..60));
        assert_eq!(taken, Vec::from_iter(40..56));
    }
}
