//! Bounded queue between bus and network. A full queue drops the oldest batch, since the newest
//! data matter most.
//!
//! The thread that fills the queue also sends the batches. While the network thread is using the
//! publisher, that thread is woken to send the batches instead.

use std::{
    collections::VecDeque,
    sync::{Condvar, Mutex, PoisonError},
    time::Duration,
};

use crate::locked::locked;

/// Capacity of the queue between bus and network. It holds the batches of all topics for more than
/// a second.
pub(crate) const MAX_QUEUED_BATCHES: usize = 512;

/// Encoded samples of a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Batch {
    /// Index of the topic in the table of [`graph`].
    pub topic_index: usize,
    /// Samples, encoded as fields of a batch message.
    pub bytes: Vec<u8>,
    /// Number of samples.
    pub samples: u64,
    /// Number of samples of the topic omitted so far to limit the rate.
    pub decimated: u64,
    /// Number of samples of the topic overwritten on the bus so far.
    pub overwritten: u64,
}

/// Queue of batches with a count of dropped samples for each topic.
#[derive(Debug)]
pub struct Queue {
    inner: Mutex<Inner>,
    not_empty: Condvar,
    capacity: usize,
}

#[derive(Debug)]
struct Inner {
    batches: VecDeque<Batch>,
    dropped: Vec<u64>,
}

impl Queue {
    /// Creates an empty queue of `capacity` batches for a number of topics.
    pub fn new(capacity: usize, topics: usize) -> Self {
        let inner = Inner { batches: VecDeque::with_capacity(capacity), dropped: vec![0; topics] };
        Self { inner: Mutex::new(inner), not_empty: Condvar::new(), capacity }
    }

    /// Appends a batch without blocking on the consumer. A full queue drops its oldest batch.
    pub fn push(&self, batch: Batch) {
        let mut inner = locked(&self.inner);
        if inner.batches.len() >= self.capacity
            && let Some(oldest) = inner.batches.pop_front()
            && let Some(dropped) = inner.dropped.get_mut(oldest.topic_index)
        {
            *dropped += oldest.samples;
        }
        inner.batches.push_back(batch);
    }

    /// Wakes the thread that waits for a batch.
    pub fn wake(&self) {
        self.not_empty.notify_one();
    }

    /// Waits up to `limit` for a batch.
    pub fn wait(&self, limit: Duration) {
        let waited = self.not_empty.wait_timeout_while(locked(&self.inner), limit, |inner| inner.batches.is_empty());
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }

    /// Removes and returns the oldest batch, with the number of samples of its topic dropped so
    /// far.
    pub fn pop(&self) -> Option<(Batch, u64)> {
        let mut inner = locked(&self.inner);
        let batch = inner.batches.pop_front()?;
        let dropped = inner.dropped.get(batch.topic_index).copied().unwrap_or(0);
        Some((batch, dropped))
    }

    /// Returns the number of queued batches and the capacity.
    pub fn depth(&self) -> (usize, usize) {
        (locked(&self.inner).batches.len(), self.capacity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn batch(topic_index: usize, samples: u64) -> Batch {
        Batch { topic_index, bytes: Vec::new(), samples, decimated: 0, overwritten: 0 }
    }

    #[test]
    fn full_queue_drops_oldest_and_counts_by_topic() {
        let queue = Queue::new(3, 2);
        (1..=5).for_each(|samples| queue.push(batch(samples as usize % 2, samples)));
        assert_eq!(queue.depth(), (3, 3));
        let pop = || queue.pop().map(|(batch, dropped)| (batch.samples, dropped));
        assert_eq!([pop(), pop(), pop(), pop()], [Some((3, 1)), Some((4, 2)), Some((5, 1)), None]);
    }

    #[test]
    fn push_never_blocks_without_consumer() {
        let queue = Queue::new(8, 1);
        (0..100_000).for_each(|_| queue.push(batch(0, 1)));
        assert_eq!(queue.pop().map(|(_, dropped)| dropped), Some(100_000 - 8));
    }
}
