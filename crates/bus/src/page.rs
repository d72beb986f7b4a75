//! The page of shared memory that everybody of a system maps: a wake word for each topic, who owns the name, and which run it is.

use std::{
    fs::File,
    io,
    ptr::NonNull,
    sync::atomic::{AtomicU32, AtomicU64, Ordering::SeqCst},
};

use graph::Topic;
use rustix::{
    mm::{MapFlags, ProtFlags, mmap, munmap},
    thread::futex,
};

/// Words in the page: more than there are topics.
pub(crate) const WORDS: usize = 63;
const _: () = assert!(Topic::ALL.len() < WORDS);
pub(crate) const PAGE_BYTES: usize = size_of::<Layout>();

/// One topic's word, alone on its cache line.
#[repr(C, align(64))]
pub(crate) struct Word {
    pub(crate) wakes: AtomicU32,
    pub(crate) waiting: AtomicU32,
    /// The tick after the newest one on the topic.
    pub(crate) next_tick: AtomicU64,
    /// Messages sent by a publisher that waits for its one reader, and taken by that.
    pub(crate) sent: AtomicU64,
    pub(crate) taken: AtomicU64,
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
        for Word { next_tick, sent, taken, .. } in &self.layout().words {
            [next_tick, sent, taken].into_iter().for_each(|count| count.store(0, SeqCst));
        }
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

    /// The word of a topic, by its place.
    pub(crate) fn word(&self, index: usize) -> &Word {
        &self.layout().words[index]
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

impl Word {
    /// Wakes whoever waits.
    pub(crate) fn wake(&self) {
        self.wakes.fetch_add(1, SeqCst);
        if self.waiting.load(SeqCst) != 0 && self.waiting.swap(0, SeqCst) != 0 {
            // It can only fail when nobody waits any more.
            let _ = futex::wake(&self.wakes, futex::Flags::empty(), i32::MAX as u32);
        }
    }
}
