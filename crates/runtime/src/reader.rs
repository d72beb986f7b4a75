//! A topic as a slot reads it: each tick once, in order, whoever publishes.

use std::{cell::RefCell, time::Duration};

use bus::{BusError, Subscriber, Woken};
use messages::{Message, Ticked};
use swap::Inlet;

use crate::{orders::Orders, service::FIRST_EPOCH};

/// A topic that a slot reads.
pub trait Input<I> {
    /// Hands what is there to `take`, at most `limit` messages.
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<(), BusError>;
    /// Sleeps until something is published, no longer than `limit`.
    fn wait(&self, limit: Duration) -> Woken;
    /// The tick after the newest one that was ever about to be published.
    fn next_tick(&self) -> u64;
    /// Messages left out because they came again: by fault, and because another life said them again.
    fn repeated(&self) -> [u64; 2] {
        [0; 2]
    }
}

/// One stream out of all that fill a slot.
#[derive(Debug)]
pub struct Reader<M: Ticked> {
    subscriber: Subscriber<M>,
    inlet: RefCell<Inlet<M>>,
}

impl<M: Ticked> Reader<M> {
    /// Begins with `next_tick`.
    pub fn new(subscriber: Subscriber<M>, next_tick: u64, orders: &Orders) -> Self {
        let inlet = Inlet::starting(next_tick, FIRST_EPOCH, orders.lateness_ticks() / 2);
        Self { subscriber, inlet: RefCell::new(inlet) }
    }

    /// Hands over what still waits for ticks before it: nothing more comes.
    pub fn finish(&self, take: &mut dyn FnMut(M)) {
        self.inlet.borrow_mut().finish(&mut |message, _| take(message));
    }
}

impl<I: From<M>, M: Ticked> Input<I> for Reader<M> {
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<(), BusError> {
        let mut inlet = self.inlet.borrow_mut();
        self.subscriber.drain(limit, |message| inlet.offer(message, &mut |message, _| take(message.into())))
    }

    fn wait(&self, limit: Duration) -> Woken {
        self.subscriber.wait(limit)
    }

    fn next_tick(&self) -> u64 {
        self.subscriber.next_tick()
    }

    fn repeated(&self) -> [u64; 2] {
        let counts = *self.inlet.borrow().counts();
        [counts.duplicated, counts.repeated + counts.superseded]
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
