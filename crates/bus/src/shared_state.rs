//! State shared by all processes of a system: a wake word per topic, the process ID of the
//! owner and the identifier of the run.

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

/// Number of wake words. It exceeds the number of topics.
pub(crate) const WORD_COUNT: usize = 63;
const _: () = assert!(Topic::ALL.len() < WORD_COUNT);
pub(crate) const SHARED_STATE_BYTES: usize = size_of::<Layout>();

/// Wake word of one topic, on its own cache line.
#[repr(C, align(64))]
pub(crate) struct WakeWord {
    pub(crate) wake_count: AtomicU32,
    pub(crate) waiting: AtomicU32,
    /// Next tick of the topic: one more than the highest tick announced for publication.
    pub(crate) next_tick: AtomicU64,
    /// Number of messages published on the topic.
    ///
    /// A subscriber compares this number with the number of messages that it has read. Checking
    /// iceoryx2 for a message would cost several hundred instructions.
    pub(crate) published: AtomicU64,
    /// Number of messages sent on a topic with flow control, which has a single subscriber.
    pub(crate) sent: AtomicU64,
    /// Number of messages consumed by the single subscriber of a topic with flow control.
    pub(crate) consumed: AtomicU64,
    /// Number of times that the supervisor has woken the subscribers of the idle topic.
    pub(crate) idle_wakes: AtomicU32,
}

#[repr(C)]
struct Layout {
    owner_pid: AtomicU32,
    /// Start time of the run on CLOCK_MONOTONIC, ns. It identifies the run.
    run: AtomicU64,
    words: [WakeWord; WORD_COUNT],
}

/// Memory mapping of the shared state.
#[derive(Debug)]
pub(crate) struct SharedState(NonNull<Layout>);

impl SharedState {
    pub(crate) fn map(file: &File) -> io::Result<Self> {
        if file.metadata()?.len() < SHARED_STATE_BYTES as u64 {
            return Err(io::Error::other("the file of the shared state is too short"));
        }
        #[allow(unsafe_code)]
        // SAFETY: a new shared mapping of a file that is long enough. It holds only atomics, for
        // which every bit pattern is valid.
        let address = unsafe {
            mmap(
                std::ptr::null_mut(),
                SHARED_STATE_BYTES,
                ProtFlags::READ | ProtFlags::WRITE,
                MapFlags::SHARED,
                file,
                0,
            )?
        };
        NonNull::new(address.cast()).map(Self).ok_or_else(|| io::Error::other("mapped at zero"))
    }

    pub(crate) fn owner_pid(&self) -> u32 {
        self.layout().owner_pid.load(SeqCst)
    }

    pub(crate) fn set_owner_pid(&self, pid: u32) {
        self.layout().owner_pid.store(pid, SeqCst);
    }

    /// Returns the identifier of the run, which is different for each run of a system.
    pub(crate) fn run(&self) -> u64 {
        self.layout().run.load(SeqCst)
    }

    /// Starts a new run: resets the tick and message counts of all topics.
    pub(crate) fn start_run(&self) {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        self.layout().run.store(now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64, SeqCst);
        for WakeWord { next_tick, sent, consumed: taken, .. } in &self.layout().words {
            [next_tick, sent, taken].into_iter().for_each(|count| count.store(0, SeqCst));
        }
    }

    /// Copies the next tick of each topic from the state of a finished run.
    pub(crate) fn copy_ticks_from(&self, previous: &Self) {
        for (word, previous_word) in self.layout().words.iter().zip(&previous.layout().words) {
            word.next_tick.store(previous_word.next_tick.load(SeqCst), SeqCst);
        }
    }

    /// Wakes the subscribers of all topics.
    pub(crate) fn wake_all(&self) {
        self.layout().words.iter().for_each(WakeWord::wake);
    }

    /// Wakes the subscribers of each topic with the wake count in `seen`, and updates `seen`.
    pub(crate) fn wake_idle(&self, seen: &mut [u32; Topic::ALL.len()]) {
        for (word, seen) in self.layout().words.iter().zip(seen) {
            let wake_count = word.wake_count.load(SeqCst);
            if std::mem::replace(seen, wake_count) == wake_count {
                word.wake_idle();
            }
        }
    }

    /// Wakes the subscribers of all topics, whether or not the flag `waiting` is set.
    pub(crate) fn wake_unannounced(&self) {
        self.layout().words.iter().for_each(WakeWord::wake_idle);
    }

    /// Returns the wake word of the topic with this index.
    #[inline]
    pub(crate) fn word(&self, index: usize) -> &WakeWord {
        &self.layout().words[index]
    }

    #[inline]
    fn layout(&self) -> &Layout {
        #[allow(unsafe_code)]
        // SAFETY: the state was mapped in `map` with this layout and is unmapped only in `drop`.
        unsafe {
            self.0.as_ref()
        }
    }
}

impl Drop for SharedState {
    fn drop(&mut self) {
        #[allow(unsafe_code)]
        // SAFETY: the mapping was created in `map`, and no reference outlives `self`.
        let unmapped = unsafe { munmap(self.0.as_ptr().cast(), SHARED_STATE_BYTES) };
        debug_assert!(unmapped.is_ok());
    }
}

#[allow(unsafe_code)]
// SAFETY: the mapping holds only atomics, which any thread may use.
unsafe impl Send for SharedState {}
#[allow(unsafe_code)]
// SAFETY: see `Send`.
unsafe impl Sync for SharedState {}

impl WakeWord {
    /// Wakes all waiting subscribers.
    #[inline]
    pub(crate) fn wake(&self) {
        self.wake_count.fetch_add(1, SeqCst);
        if self.waiting.load(SeqCst) != 0 && self.waiting.swap(0, SeqCst) != 0 {
            self.wake_sleeping();
        }
    }

    /// Wakes the subscribers although no message was published.
    ///
    /// Ignores the flag `waiting`, because a publisher that cleared it may have been killed before
    /// it woke the subscribers.
    fn wake_idle(&self) {
        self.idle_wakes.fetch_add(1, SeqCst);
        self.wake_sleeping();
    }

    fn wake_sleeping(&self) {
        // Waking fails only if no subscriber is waiting any more.
        let _ = futex::wake(&self.wake_count, futex::Flags::empty(), i32::MAX as u32);
    }
}
