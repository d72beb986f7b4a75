//! Between bus and network: a queue with an end. When it is full the oldest goes, for the newest is what counts.
//!
//! Whoever fills it empties it as well where he can; only what he cannot send is left to the other thread, which is then woken.

use std::{
    collections::VecDeque,
    sync::{Condvar, Mutex, PoisonError},
    time::Duration,
};

use crate::locked;

/// Samples of a topic on their way out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Batch {
    /// The topic's place in the table of [`graph`].
    pub topic: usize,
    /// The samples as they stand in a batch.
    pub bytes: Vec<u8>,
    /// How many there are.
    pub samples: u64,
    /// Samples of the topic left out by its rate so far.
    pub decimated: u64,
    /// Samples of the topic overwritten on the bus so far.
    pub overwritten: u64,
}

/// The queue.
#[derive(Debug)]
pub struct Queue {
    inner: Mutex<Inner>,
    filled: Condvar,
    max: usize,
}

#[derive(Debug)]
struct Inner {
    batches: VecDeque<Batch>,
    dropped: Vec<u64>,
}

impl Queue {
    /// An empty queue for `max` batches of so many topics.
    pub fn new(max: usize, topics: usize) -> Self {
        let inner = Inner { batches: VecDeque::with_capacity(max), dropped: vec![0; topics] };
        Self { inner: Mutex::new(inner), filled: Condvar::new(), max }
    }

    /// Puts a batch in; never waits for whoever takes it.
    pub fn push(&self, batch: Batch) {
        let mut inner = locked(&self.inner);
        if inner.batches.len() >= self.max
            && let Some(oldest) = inner.batches.pop_front()
            && let Some(dropped) = inner.dropped.get_mut(oldest.topic)
        {
            *dropped += oldest.samples;
        }
        inner.batches.push_back(batch);
    }

    /// Wakes who waits for a batch.
    pub fn wake(&self) {
        self.filled.notify_one();
    }

    /// Waits for a batch, no longer than `limit`.
    pub fn wait(&self, limit: Duration) {
        let filled = self.filled.wait_timeout_while(locked(&self.inner), limit, |inner| inner.batches.is_empty());
        drop(filled.unwrap_or_else(PoisonError::into_inner));
    }

    /// The oldest batch, and how many samples of its topic were dropped so far.
    pub fn take(&self) -> Option<(Batch, u64)> {
        let mut inner = locked(&self.inner);
        let batch = inner.batches.pop_front()?;
        let dropped = inner.dropped.get(batch.topic).copied().unwrap_or(0);
        Some((batch, dropped))
    }

    /// How many batches wait, and how many may.
    pub fn depth(&self) -> (usize, usize) {
        (locked(&self.inner).batches.len(), self.max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn batch(topic: usize, samples: u64) -> Batch {
        Batch { topic, bytes: Vec::new(), samples, decimated: 0, overwritten: 0 }
    }

    #[test]
    fn the_newest_win_and_what_they_drove_out_is_counted_by_topic() {
        let queue = Queue::new(3, 2);
        (1..=5).for_each(|samples| queue.push(batch(samples as usize % 2, samples)));
        assert_eq!(queue.depth(), (3, 3));
        let take = || queue.take().map(|(batch, dropped)| (batch.samples, dropped));
        assert_eq!([take(), take(), take(), take()], [Some((3, 1)), Some((4, 2)), Some((5, 1)), None]);
    }

    #[test]
    fn whoever_puts_in_does_not_wait_for_whoever_takes_out() {
        let queue = Queue::new(8, 1);
        (0..100_000).for_each(|_| queue.push(batch(0, 1)));
        assert_eq!(queue.take().map(|(_, dropped)| dropped), Some(100_000 - 8));
    }
}
