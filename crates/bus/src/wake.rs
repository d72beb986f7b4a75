//! Waking the readers of a topic: one futex word each, in a page of shared memory.
//!
//! A waker adds one to the word and calls the kernel only when somebody has said that he waits. A reader looks at the word, reads
//! what is there, says that he waits, and sleeps only while the word is as he saw it: a wake-up cannot be lost. What a killed reader
//! said costs one needless call.

use std::{
    sync::{Arc, atomic::Ordering::SeqCst},
    time::Duration,
};

use graph::Entry;
use rustix::{fs::Timespec, thread::futex};

use crate::{
    membership::Membership,
    page::{Page, WORDS, Word},
};

/// The word of one topic.
#[derive(Debug)]
pub(crate) struct TopicWord {
    page: Arc<Page>,
    index: usize,
    /// Whoever is part of the system is so until the last of its ports is gone.
    _place: Option<Arc<Membership>>,
}

/// How a wait ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Woken {
    /// Something was published since the last look.
    Work,
    /// The same, but the limit had to pass: a wake-up was lost.
    Late,
    /// Nothing was published within the limit.
    Idle,
}

impl TopicWord {
    /// The word of a topic: that of its place in the table.
    pub(crate) fn new(page: Arc<Page>, place: Option<Arc<Membership>>, topic: &Entry) -> Self {
        Self { page, index: topic.place.min(WORDS - 1), _place: place }
    }

    /// Wakes every reader that waits.
    pub(crate) fn wake(&self) {
        self.word().wake();
    }

    /// Notes the tick that is about to be published. A slot may begin at an earlier one again; the newest stays.
    pub(crate) fn set_next_tick_after(&self, tick: u64) {
        self.word().next_tick.fetch_max(tick.saturating_add(1), SeqCst);
    }

    /// The tick after the newest one that was ever about to be published on the topic.
    pub(crate) fn next_tick(&self) -> u64 {
        self.word().next_tick.load(SeqCst)
    }

    /// Notes so many messages sent.
    pub(crate) fn note_sent(&self, count: u64) {
        self.word().sent.fetch_add(count, SeqCst);
    }

    /// Notes so many messages taken.
    pub(crate) fn note_taken(&self, count: u64) {
        self.word().taken.fetch_add(count, SeqCst);
    }

    /// Nothing that was sent so far is waited for.
    pub(crate) fn note_all_taken(&self) {
        self.word().taken.store(self.word().sent.load(SeqCst), SeqCst);
    }

    /// Messages sent that have not been taken.
    pub(crate) fn untaken(&self) -> u64 {
        self.word().sent.load(SeqCst).saturating_sub(self.word().taken.load(SeqCst))
    }

    /// What the word is now: to be asked before reading.
    pub(crate) fn look(&self) -> u32 {
        self.word().wakes.load(SeqCst)
    }

    /// Sleeps while the word is as it was `seen`, no longer than `limit`.
    pub(crate) fn wait(&self, seen: u32, limit: Duration) -> Woken {
        let word = self.word();
        word.waiting.store(1, SeqCst);
        let limit = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) };
        let timed_out =
            futex::wait(&word.wakes, futex::Flags::empty(), seen, Some(&limit)) == Err(rustix::io::Errno::TIMEDOUT);
        match (self.look() != seen, timed_out) {
            (true, false) => Woken::Work,
            (true, true) => Woken::Late,
            (false, _) => Woken::Idle,
        }
    }

    fn word(&self) -> &Word {
        self.page.word(self.index)
    }
}
