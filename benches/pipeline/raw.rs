//! Variant `raw`, without a bus: each topic is a ring in shared memory, with one producer, one or
//! two consumers, and a futex that wakes waiting consumers.
//!
//! If a ring is full, the sample is dropped. Nothing is validated.

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
    chain::{self, ChainRole, Input, Join, MAX_WAIT, Output, ProcessSettings, TOPIC_SAMPLES},
};

/// Sample with a size of 128 bytes.
type Sample = AccelPoint;
const SAMPLE_WORDS: usize = 16;
const _: () = assert!(size_of::<Sample>() == 8 * SAMPLE_WORDS);

/// Maximum number of consumers of a topic.
const MAX_READERS: usize = 2;
const IMU: usize = 0;
const GYRO: usize = 1;
const ACCEL: usize = 2;
const FUSED: usize = 3;

/// Ring buffer of a topic.
///
/// The counters only increase. Each has one writer and its own cache line.
#[repr(C, align(64))]
struct Ring {
    sent: CacheLine<AtomicU64>,
    received: [CacheLine<AtomicU64>; MAX_READERS],
    wake: CacheLine<Wake>,
    slots: [CacheLine<[AtomicU64; SAMPLE_WORDS]>; TOPIC_SAMPLES],
}

#[repr(C, align(64))]
struct CacheLine<T>(T);

#[repr(C)]
struct Wake {
    wakes: AtomicU32,
    waiting: AtomicU32,
}

type Rings = [Ring; FUSED + 1];

/// Memory mapping that contains the rings of a chain.
struct Mapping(NonNull<Rings>);

impl Mapping {
    fn from_file(file: &File) -> io::Result<Self> {
        if file.metadata()?.len() < size_of::<Rings>() as u64 {
            return Err(io::Error::other("the shared file is too short for the rings"));
        }
        let (bytes, access) = (size_of::<Rings>(), ProtFlags::READ | ProtFlags::WRITE);
        #[allow(unsafe_code)]
        // SAFETY: this creates a new shared mapping of a file that is long enough. The mapping
        // contains only atomics, for which every bit pattern is valid.
        let address = unsafe { mmap(std::ptr::null_mut(), bytes, access, MapFlags::SHARED, file, 0)? };
        NonNull::new(address.cast()).map(Self).ok_or_else(|| io::Error::other("mmap returned a null address"))
    }

    fn rings(&self) -> &Rings {
        #[allow(unsafe_code)]
        // SAFETY: the address was mapped in `from_file` with this layout and is unmapped only in
        // `drop`.
        unsafe {
            self.0.as_ref()
        }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        #[allow(unsafe_code)]
        // SAFETY: the mapping comes from `from_file`, and no reference outlives `self`.
        let unmapped = unsafe { munmap(self.0.as_ptr().cast(), size_of::<Rings>()) };
        debug_assert!(unmapped.is_ok());
    }
}

/// Producer of a topic with `readers` consumers.
struct RingOutput<'a> {
    ring: &'a Ring,
    readers: usize,
}

/// Consumer of a topic.
struct RingInput<'a> {
    ring: &'a Ring,
    reader: usize,
}

impl Output for RingOutput<'_> {
    type Sample = Sample;

    fn send(&mut self, sample: &Sample) -> Result<(), Failure> {
        let Ring { sent, received, slots, .. } = self.ring;
        let next = sent.0.load(Relaxed);
        let oldest = received[..self.readers].iter().map(|received| received.0.load(Acquire)).min().unwrap_or(next);
        if next - oldest < TOPIC_SAMPLES as u64 {
            let words: [u64; SAMPLE_WORDS] = bytemuck::cast(*sample);
            let slot = &slots[next as usize % TOPIC_SAMPLES].0;
            slot.iter().zip(words).for_each(|(target, word)| target.store(word, Relaxed));
            sent.0.store(next + 1, Release);
        }
        Ok(())
    }

    fn wake(&mut self) {
        let Wake { wakes, waiting } = &self.ring.wake.0;
        wakes.fetch_add(1, SeqCst);
        if waiting.load(SeqCst) != 0 {
            // A failure means that no consumer is waiting any more.
            let _ = futex::wake(wakes, futex::Flags::empty(), MAX_READERS as u32);
        }
    }
}

impl Input for RingInput<'_> {
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
        let wakes_before = wakes.load(SeqCst);
        waiting.fetch_add(1, SeqCst);
        if received[self.reader].0.load(SeqCst) == sent.0.load(SeqCst) {
            let timeout = Timespec { tv_sec: 0, tv_nsec: MAX_WAIT.as_nanos() as i64 };
            // The result is not needed, because the caller polls for samples after a wake-up, a
            // timeout or a changed counter.
            let _ = futex::wait(wakes, futex::Flags::empty(), wakes_before, Some(&timeout));
        }
        waiting.fetch_sub(1, SeqCst);
    }
}

/// Measures the variant `raw`.
pub(crate) fn run(rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let file = NamedTempFile::with_prefix_in("plumbline-bench.", "/dev/shm")?;
    file.as_file().set_len(size_of::<Rings>() as u64)?;
    let path = file.path().to_str().ok_or("the path of the shared file is not valid UTF-8")?;
    chain::run(Variant::Raw, path, rate_hz, seconds)
}

/// Runs one process of the variant `raw`.
pub(crate) fn run_process(settings: &ProcessSettings) -> Result<(), Failure> {
    chain::die_with_parent()?;
    let mapping = Mapping::from_file(&OpenOptions::new().read(true).write(true).open(&settings.shared_name)?)?;
    let rings = mapping.rings();
    let output = |topic: usize, readers| RingOutput { ring: &rings[topic], readers };
    let input = |topic: usize, reader| RingInput { ring: &rings[topic], reader };
    match settings.role {
        ChainRole::Source => chain::source(settings, output(IMU, 2)),
        ChainRole::Gyro => chain::relay(settings, input(IMU, 0), output(GYRO, 1), |sample| *sample),
        ChainRole::Accel => chain::relay(settings, input(IMU, 1), output(ACCEL, 1), |sample| *sample),
        ChainRole::Fuser => {
            chain::relay(settings, Join::new(input(GYRO, 0), input(ACCEL, 0)), output(FUSED, 1), |sample| *sample)
        }
        ChainRole::Sink => chain::sink(settings, input(FUSED, 0)),
    }
}
