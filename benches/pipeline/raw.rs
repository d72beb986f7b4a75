//! The limit: a ring in shared memory for each hop, one producer, one consumer, and a futex word to wake the consumer.
//!
//! A full ring refuses the sample; nothing is checked that a bus has to check.

use std::{
    fs::{File, OpenOptions},
    io,
    ptr::NonNull,
    sync::atomic::{
        AtomicU32, AtomicU64,
        Ordering::{Acquire, Relaxed, Release, SeqCst},
    },
};

use messages::AccelPoint;
use rustix::{
    fs::Timespec,
    mm::{MapFlags, ProtFlags, mmap, munmap},
    thread::futex,
};
use tempfile::NamedTempFile;

use crate::{
    Cost, Failure, Variant,
    chain::{self, Inlet, LINK_SAMPLES, Outlet, PLACES, Part, WAIT_LIMIT},
};

/// The payload that has 128 bytes.
type Sample = AccelPoint;
const SAMPLE_WORDS: usize = 16;
const _: () = assert!(size_of::<Sample>() == 8 * SAMPLE_WORDS);

/// One hop. The counters only grow; each is written by one side, on its own cache line.
#[repr(C, align(64))]
struct Ring {
    sent: Line<AtomicU64>,
    received: Line<AtomicU64>,
    wake: Line<Wake>,
    slots: [Line<[AtomicU64; SAMPLE_WORDS]>; LINK_SAMPLES],
}

#[repr(C, align(64))]
struct Line<T>(T);

#[repr(C)]
struct Wake {
    wakes: AtomicU32,
    waiting: AtomicU32,
}

type Rings = [Ring; PLACES - 1];

/// The rings of a chain, mapped.
struct Mapping(NonNull<Rings>);

impl Mapping {
    fn of(file: &File) -> io::Result<Self> {
        if file.metadata()?.len() < size_of::<Rings>() as u64 {
            return Err(io::Error::other("the file of the rings is too short"));
        }
        let (bytes, access) = (size_of::<Rings>(), ProtFlags::READ | ProtFlags::WRITE);
        #[allow(unsafe_code)]
        // SAFETY: a fresh shared mapping of a file that is long enough, of atomics only, for which every bit pattern is valid.
        let address = unsafe { mmap(std::ptr::null_mut(), bytes, access, MapFlags::SHARED, file, 0)? };
        NonNull::new(address.cast()).map(Self).ok_or_else(|| io::Error::other("mapped at zero"))
    }

    fn rings(&self) -> &Rings {
        #[allow(unsafe_code)]
        // SAFETY: mapped in `of` with this layout, unmapped only in `drop`.
        unsafe {
            self.0.as_ref()
        }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        #[allow(unsafe_code)]
        // SAFETY: the mapping made in `of`; no reference outlives `self`.
        let unmapped = unsafe { munmap(self.0.as_ptr().cast(), size_of::<Rings>()) };
        debug_assert!(unmapped.is_ok());
    }
}

impl Outlet for &Ring {
    type Sample = Sample;

    fn send(&mut self, sample: &Sample) -> Result<(), Failure> {
        let sent = self.sent.0.load(Relaxed);
        if sent - self.received.0.load(Acquire) < LINK_SAMPLES as u64 {
            let words: [u64; SAMPLE_WORDS] = bytemuck::cast(*sample);
            let slot = &self.slots[sent as usize % LINK_SAMPLES].0;
            slot.iter().zip(words).for_each(|(place, word)| place.store(word, Relaxed));
            self.sent.0.store(sent + 1, Release);
        }
        Ok(())
    }

    fn wake(&mut self) {
        let Wake { wakes, waiting } = &self.wake.0;
        wakes.fetch_add(1, SeqCst);
        if waiting.load(SeqCst) != 0 {
            // It can only fail when nobody waits any more.
            let _ = futex::wake(wakes, futex::Flags::empty(), 1);
        }
    }
}

impl Inlet for &Ring {
    type Sample = Sample;

    fn receive(&mut self) -> Result<Option<Sample>, Failure> {
        let received = self.received.0.load(Relaxed);
        if received == self.sent.0.load(Acquire) {
            return Ok(None);
        }
        let slot = &self.slots[received as usize % LINK_SAMPLES].0;
        let words: [u64; SAMPLE_WORDS] = std::array::from_fn(|i| slot[i].load(Relaxed));
        self.received.0.store(received + 1, Release);
        Ok(Some(bytemuck::cast(words)))
    }

    fn wait(&mut self) {
        let Wake { wakes, waiting } = &self.wake.0;
        let seen = wakes.load(SeqCst);
        waiting.fetch_add(1, SeqCst);
        if self.received.0.load(SeqCst) == self.sent.0.load(SeqCst) {
            let limit = Timespec { tv_sec: 0, tv_nsec: WAIT_LIMIT.as_nanos() as i64 };
            // Woken, timed out or too late to sleep: the caller looks for samples again.
            let _ = futex::wait(wakes, futex::Flags::empty(), seen, Some(&limit));
        }
        waiting.fetch_sub(1, SeqCst);
    }
}

/// Measures the variant.
pub(crate) fn run(rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let file = NamedTempFile::with_prefix_in("plumbline-bench.", "/dev/shm")?;
    file.as_file().set_len(size_of::<Rings>() as u64)?;
    let path = file.path().to_str().ok_or("the name of the rings is not text")?;
    chain::run(Variant::Raw, path, rate_hz, seconds)
}

/// One process of the variant.
pub(crate) fn be(part: &Part) -> Result<(), Failure> {
    chain::end_with_parent()?;
    let mapping = Mapping::of(&OpenOptions::new().read(true).write(true).open(&part.share)?)?;
    let rings = mapping.rings();
    match part.place {
        0 => chain::source(part, &rings[0]),
        place if place + 1 < PLACES => chain::relay(part, &rings[place - 1], &rings[place], |sample| *sample),
        place => chain::sink(part, &rings[place - 1]),
    }
}
