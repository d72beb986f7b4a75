//! The limit: a ring in shared memory for each topic, one producer, one or two consumers, and a futex word to wake those that wait.
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
    chain::{self, Input, Join, Outlet, Part, Place, TOPIC_SAMPLES, WAIT_LIMIT},
};

/// The payload that has 128 bytes.
type Sample = AccelPoint;
const SAMPLE_WORDS: usize = 16;
const _: () = assert!(size_of::<Sample>() == 8 * SAMPLE_WORDS);

/// Consumers of a topic at most.
const READERS: usize = 2;
const IMU: usize = 0;
const GYRO: usize = 1;
const ACCEL: usize = 2;
const FUSED: usize = 3;

/// One topic. The counters only grow; each is written by one side, on its own cache line.
#[repr(C, align(64))]
struct Ring {
    sent: Line<AtomicU64>,
    received: [Line<AtomicU64>; READERS],
    wake: Line<Wake>,
    slots: [Line<[AtomicU64; SAMPLE_WORDS]>; TOPIC_SAMPLES],
}

#[repr(C, align(64))]
struct Line<T>(T);

#[repr(C)]
struct Wake {
    wakes: AtomicU32,
    waiting: AtomicU32,
}

type Rings = [Ring; FUSED + 1];

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

/// The producer of a topic that has so many consumers.
struct Out<'a> {
    ring: &'a Ring,
    readers: usize,
}

/// A consumer of a topic.
struct In<'a> {
    ring: &'a Ring,
    reader: usize,
}

impl Outlet for Out<'_> {
    type Sample = Sample;

    fn send(&mut self, sample: &Sample) -> Result<(), Failure> {
        let Ring { sent, received, slots, .. } = self.ring;
        let next = sent.0.load(Relaxed);
        let oldest = received[..self.readers].iter().map(|received| received.0.load(Acquire)).min().unwrap_or(next);
        if next - oldest < TOPIC_SAMPLES as u64 {
            let words: [u64; SAMPLE_WORDS] = bytemuck::cast(*sample);
            let slot = &slots[next as usize % TOPIC_SAMPLES].0;
            slot.iter().zip(words).for_each(|(place, word)| place.store(word, Relaxed));
            sent.0.store(next + 1, Release);
        }
        Ok(())
    }

    fn wake(&mut self) {
        let Wake { wakes, waiting } = &self.ring.wake.0;
        wakes.fetch_add(1, SeqCst);
        if waiting.load(SeqCst) != 0 {
            // It can only fail when nobody waits any more.
            let _ = futex::wake(wakes, futex::Flags::empty(), READERS as u32);
        }
    }
}

impl Input for In<'_> {
    type Sample = Sample;

    fn receive(&mut self) -> Result<Option<Sample>, Failure> {
        let Ring { sent, received, slots, .. } = self.ring;
        let next = received[self.reader].0.load(Relaxed);
        if next == sent.0.load(Acquire) {
            return Ok(None);
        }
        let slot = &slots[next as usize % TOPIC_SAMPLES].0;
        let words: [u64; SAMPLE_WORDS] = std::array::from_fn(|i| slot[i].load(Relaxed));
        received[self.reader].0.store(next + 1, Release);
        Ok(Some(bytemuck::cast(words)))
    }

    fn wait(&mut self) {
        let Ring { sent, received, wake, .. } = self.ring;
        let Wake { wakes, waiting } = &wake.0;
        let seen = wakes.load(SeqCst);
        waiting.fetch_add(1, SeqCst);
        if received[self.reader].0.load(SeqCst) == sent.0.load(SeqCst) {
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
    let to = |topic: usize, readers| Out { ring: &rings[topic], readers };
    let of = |topic: usize, reader| In { ring: &rings[topic], reader };
    match part.place {
        Place::Source => chain::source(part, to(IMU, 2)),
        Place::Gyro => chain::relay(part, of(IMU, 0), to(GYRO, 1), |sample| *sample),
        Place::Accel => chain::relay(part, of(IMU, 1), to(ACCEL, 1), |sample| *sample),
        Place::Fuser => chain::relay(part, Join::new(of(GYRO, 0), of(ACCEL, 0)), to(FUSED, 1), |sample| *sample),
        Place::Sink => chain::sink(part, of(FUSED, 0)),
    }
}
