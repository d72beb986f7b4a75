//! Waking a service: one futex word each, in a page of shared memory.
//!
//! A waker adds one to the word and calls the kernel only when somebody waits. A waiter announces itself, looks once more for
//! work, and sleeps only while the word has not changed: a wake-up cannot be lost. A count of waiters that a killed process left
//! behind costs one needless call per wake, never a wake-up.

use std::{
    fs::File,
    io,
    ptr::NonNull,
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering::SeqCst},
    },
    time::Duration,
};

use rustix::{
    fs::Timespec,
    mm::{MapFlags, ProtFlags, mmap, munmap},
    thread::futex,
};

/// Words in the page: the most services a system can have.
pub const WORDS: usize = 63;
pub(crate) const PAGE_BYTES: usize = size_of::<Layout>();

/// One service's word, alone on its cache line.
#[repr(C, align(64))]
struct Word {
    wakes: AtomicU32,
    waiting: AtomicU32,
}

#[repr(C)]
struct Layout {
    owner_pid: AtomicU32,
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

/// Wakes the services that read a topic.
#[derive(Debug, Clone)]
pub struct Waker {
    page: Arc<Page>,
    words: Vec<usize>,
}

impl Waker {
    pub(crate) fn new(page: Arc<Page>, words: &[usize]) -> Self {
        Self { page, words: words.iter().copied().filter(|word| *word < WORDS).collect() }
    }

    /// Tells every reader that there is work.
    pub fn wake(&self) {
        for &index in &self.words {
            let word = &self.page.layout().words[index];
            word.wakes.fetch_add(1, SeqCst);
            if word.waiting.load(SeqCst) != 0 {
                // It can only fail when nobody waits any more.
                let _ = futex::wake(&word.wakes, futex::Flags::empty(), i32::MAX as u32);
            }
        }
    }
}

/// How a wait ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Woken {
    /// There is work.
    Work,
    /// There is work, but nobody said so within the limit: a wake-up was lost.
    Late,
    /// The limit passed and there is none.
    Idle,
}

/// Waits for work of one service.
#[derive(Debug)]
pub struct Waiter {
    page: Arc<Page>,
    word: usize,
}

impl Waiter {
    pub(crate) fn new(page: Arc<Page>, word: usize) -> Self {
        Self { page, word: word.min(WORDS - 1) }
    }

    /// Sleeps until there is work or `limit` has passed.
    pub fn wait(&self, limit: Duration, mut has_work: impl FnMut() -> bool) -> Woken {
        let word = &self.page.layout().words[self.word];
        let seen = word.wakes.load(SeqCst);
        word.waiting.store(1, SeqCst);
        let ready = has_work();
        let timed_out = !ready && {
            let limit = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) };
            futex::wait(&word.wakes, futex::Flags::empty(), seen, Some(&limit)) == Err(rustix::io::Errno::TIMEDOUT)
        };
        word.waiting.store(0, SeqCst);
        match (ready || has_work(), timed_out) {
            (true, false) => Woken::Work,
            (true, true) => Woken::Late,
            (false, _) => Woken::Idle,
        }
    }
}
