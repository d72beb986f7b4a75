//! Wake-ups for subscribers: one futex word per topic in shared memory.
//!
//! A publisher increments the word and makes a system call only if a subscriber has announced that
//! it is waiting. A subscriber reads the word, drains its messages, announces that it is waiting
//! and sleeps only while the word is unchanged. This way no wake-up is lost. A subscriber that is
//! killed while waiting costs the publisher one unnecessary system call.
//!
//! A service sleeps without a timer, because setting and cancelling one for each message would take
//! a tenth of the time of a wake-up. The supervisor wakes the services that wait for an idle topic.

use std::{
    sync::{Arc, atomic::Ordering::SeqCst},
    time::Duration,
};

use graph::Entry;
use rustix::{fs::Timespec, thread::futex};

use crate::{
    process_lease::ProcessLease,
    shared_state::{SharedState, WORD_COUNT, WakeWord},
};

/// Handle to the wake word of one topic.
#[derive(Debug)]
pub(crate) struct TopicWaker {
    state: Arc<SharedState>,
    index: usize,
    /// Keeps the process's lease alive for as long as any of its ports exists.
    _lease: Option<Arc<ProcessLease>>,
}

/// Outcome of a wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WaitOutcome {
    /// A message was published since the last check.
    Published,
    /// A message was published, but the wake-up was lost: the wait timed out, or the supervisor
    /// ended it.
    LateWake,
    /// No message was published before the wait timed out or the supervisor ended it.
    Idle,
}

impl TopicWaker {
    /// Creates the handle for `topic`. The index of the topic selects the word.
    pub(crate) fn new(state: Arc<SharedState>, lease: Option<Arc<ProcessLease>>, topic: &Entry) -> Self {
        Self { state, index: topic.index.min(WORD_COUNT - 1), _lease: lease }
    }

    /// Wakes every waiting subscriber.
    #[inline]
    pub(crate) fn wake(&self) {
        self.word().wake();
    }

    /// Counts a message that has been published.
    #[inline]
    pub(crate) fn add_published(&self) {
        self.word().published.fetch_add(1, SeqCst);
    }

    /// Returns the number of messages published on the topic. It does not include delivered
    /// history, nor the last message of a publisher that was killed before it counted the message.
    #[inline]
    pub(crate) fn published(&self) -> u64 {
        self.word().published.load(SeqCst)
    }

    /// Announces that `tick` is about to be published. If a slot restarts at an earlier tick, the
    /// highest tick is kept.
    #[inline]
    pub(crate) fn set_next_tick_after(&self, tick: u64) {
        self.word().next_tick.fetch_max(tick.saturating_add(1), SeqCst);
    }

    /// Returns the next tick: one more than the highest tick announced for publication.
    pub(crate) fn next_tick(&self) -> u64 {
        self.word().next_tick.load(SeqCst)
    }

    /// Adds `count` to the number of messages sent.
    pub(crate) fn add_sent(&self, count: u64) {
        self.word().sent.fetch_add(count, SeqCst);
    }

    /// Adds `count` to the number of messages consumed.
    pub(crate) fn add_consumed(&self, count: u64) {
        self.word().consumed.fetch_add(count, SeqCst);
    }

    /// Marks all messages sent so far as consumed.
    pub(crate) fn mark_all_consumed(&self) {
        self.word().consumed.store(self.word().sent.load(SeqCst), SeqCst);
    }

    /// Returns the number of messages sent but not consumed.
    pub(crate) fn unconsumed(&self) -> u64 {
        self.word().sent.load(SeqCst).saturating_sub(self.word().consumed.load(SeqCst))
    }

    /// Returns the value of the word. Read it before draining the messages.
    #[inline]
    pub(crate) fn current(&self) -> u32 {
        self.word().wake_count.load(SeqCst)
    }

    /// Sleeps while the word equals `seen`, for at most `limit` if given.
    pub(crate) fn wait(&self, seen: u32, limit: Option<Duration>) -> WaitOutcome {
        let word = self.word();
        word.waiting.store(1, SeqCst);
        let idle_wakes = word.idle_wakes.load(SeqCst);
        let limit =
            limit.map(|limit| Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) });
        let timed_out = futex::wait(&word.wake_count, futex::Flags::empty(), seen, limit.as_ref())
            == Err(rustix::io::Errno::TIMEDOUT);
        let is_late = timed_out || word.idle_wakes.load(SeqCst) != idle_wakes;
        match (self.current() != seen, is_late) {
            (true, false) => WaitOutcome::Published,
            (true, true) => WaitOutcome::LateWake,
            (false, _) => WaitOutcome::Idle,
        }
    }

    #[inline]
    fn word(&self) -> &WakeWord {
        self.state.word(self.index)
    }
}
