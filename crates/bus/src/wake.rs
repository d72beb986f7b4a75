//! Waking the readers of a topic: one futex word each, in a page of shared memory.
//!
//! A waker adds one to the word and calls the kernel only when somebody has said that he waits. A reader looks at the word, reads
//! what is there, says that he waits, and sleeps only while the word is as he saw it: a wake-up cannot be lost. What a killed reader
//! said costs one needless call.

use std::{
    fs::File,
    io,
    ptr::NonNull,
    sync::{
        Arc,
        atomic::{AtomicU32, AtomicU64, Ordering::SeqCst},
    },
    time::Duration,
};

use rustix::{
    fs::Timespec,
    mm::{MapFlags, ProtFlags, mmap, munmap},
    thread::futex,
};

use crate::place::Place;

/// Words in the page: more than there are topics.
const WORDS: usize = 63;
pub(crate) const PAGE_BYTES: usize = size_of::<Layout>();
/// From one word to the next, and from the page's start to the first.
pub(crate) const WORD_BYTES: usize = size_of::<Word>();
const _: () = assert!(core::mem::offset_of!(Layout, words) == WORD_BYTES);

/// One topic's word, alone on its cache line.
#[repr(C, align(64))]
struct Word {
    wakes: AtomicU32,
    waiting: AtomicU32,
    /// The tick after the newest one on the topic.
    next_tick: AtomicU64,
}

#[repr(C)]
struct Layout {
    owner_pid: AtomicU32,
    /// When the run began, CLOCK_MONOTONIC, ns: no other run has the same.
    run: AtomicU64,
    words: [Word; WORDS],
}

/// The page of wake words, mapped.
#[derive(Debug)]
pub(crate) struct Page(NonNull<Layout>);

impl Page {
    pub(crate) fn map(file: &File) -> io::Result<Self> {
        if file.metadata()?.len() < PAGE_BYTES as u64 {
            return Err(io::Error::other("the page of wake words is too short"));
        }
        #[allow(unsafe_code)]
        // SAFETY: a fresh shared mapping of a file that is long enough, of atomics only, for which every bit pattern is valid.
        let address = unsafe {
            mmap(std::ptr::null_mut(), PAGE_BYTES, ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED, file, 0)?
        };
        NonNull::new(address.cast()).map(Self).ok_or_else(|| io::Error::other("mapped at zero"))
    }

    pub(crate) fn owner_pid(&self) -> u32 {
        self.layout().owner_pid.load(SeqCst)
    }

    pub(crate) fn set_owner_pid(&self, pid: u32) {
        self.layout().owner_pid.store(pid, SeqCst);
    }

    /// The number of the run: another one is another system under the same name.
    pub(crate) fn run(&self) -> u64 {
        self.layout().run.load(SeqCst)
    }

    /// A new run begins: no topic has had a tick.
    pub(crate) fn begin_run(&self) {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        self.layout().run.store(now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64, SeqCst);
        self.layout().words.iter().for_each(|word| word.next_tick.store(0, SeqCst));
    }

    /// The topics go on from the ticks that they had on an earlier page, whose run is over.
    pub(crate) fn go_on_from(&self, earlier: &Self) {
        for (word, was) in self.layout().words.iter().zip(&earlier.layout().words) {
            word.next_tick.store(was.next_tick.load(SeqCst), SeqCst);
        }
    }

    /// Wakes whoever waits for any topic.
    pub(crate) fn wake_all(&self) {
        self.layout().words.iter().for_each(Word::wake);
    }

    fn layout(&self) -> &Layout {
        #[allow(unsafe_code)]
        // SAFETY: mapped in `map` with this layout, unmapped only in `drop`.
        unsafe {
            self.0.as_ref()
        }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        #[allow(unsafe_code)]
        // SAFETY: the mapping made in `map`; no reference outlives `self`.
        let unmapped = unsafe { munmap(self.0.as_ptr().cast(), PAGE_BYTES) };
        debug_assert!(unmapped.is_ok());
    }
}

#[allow(unsafe_code)]
// SAFETY: the page holds atomics only, which any thread may use.
unsafe impl Send for Page {}
#[allow(unsafe_code)]
// SAFETY: as above.
unsafe impl Sync for Page {}

/// The word of one topic.
#[derive(Debug)]
pub(crate) struct TopicWord {
    place: Arc<Place>,
    index: usize,
}

impl Word {
    fn wake(&self) {
        self.wakes.fetch_add(1, SeqCst);
        if self.waiting.load(SeqCst) != 0 && self.waiting.swap(0, SeqCst) != 0 {
            // It can only fail when nobody waits any more.
            let _ = futex::wake(&self.wakes, futex::Flags::empty(), i32::MAX as u32);
        }
    }
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
    /// The word of a topic; topics that are not of this system's own share the last.
    pub(crate) fn new(place: Arc<Place>, topic: &str) -> Self {
        let index = messages::TOPICS.iter().position(|known| *known == topic).unwrap_or(WORDS - 1);
        Self { place, index }
    }

    /// Wakes every reader that waits.
    pub(crate) fn wake(&self) {
        self.word().wake();
    }

    /// Notes the tick that is about to be published. A slot may begin at an earlier one again; the newest stays.
    pub(crate) fn note(&self, tick: u64) {
        self.word().next_tick.fetch_max(tick.saturating_add(1), SeqCst);
    }

    /// The tick after the newest one that was ever about to be published on the topic.
    pub(crate) fn next_tick(&self) -> u64 {
        self.word().next_tick.load(SeqCst)
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
        &self.place.page.layout().words[self.index]
    }
}
