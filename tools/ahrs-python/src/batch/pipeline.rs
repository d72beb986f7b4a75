//! Passes the samples of a batch through the filter, in several threads if the batch is long.
//!
//! Input: the samples in order.
//!
//! Output: one row per sample. The rows and the state of the filter have the same bits with any
//! number of threads.
//!
//! Failure: a panic of a thread ends all threads and is passed on to the caller.
//!
//! # Threads
//!
//! The samples pass through three [parts](plumbline_ahrs::parts) of the filter in chunks. Each part
//! depends only on the parts before it, so the parts process different chunks at the same time:
//!
//! ```text
//! samples ─► Reader ─► chunks ─► Aided ─► chunks ─► Writer ─► rows
//!              ▲                                      │
//!              └─────────────── chunks ◄──────────────┘
//! ```
//!
//! A part is not tied to a thread. A worker takes a part for which a chunk is waiting, lets the
//! part process the chunk, and returns both. All workers are therefore busy, although the parts do
//! not take the same time. The caller is one of the workers. The number of chunks is constant, so
//! the memory does not depend on the length of the batch.
//!
//! # Samples for which the parts depend on each other
//!
//! After an outage of the gyro, the fused attitude decides whether the level is initialised again.
//! An invalid output resets both models of the fuser. Both cases are rare. The workers end at such
//! a sample. The caller processes it and the next [`SERIAL_SAMPLES`] alone, then starts workers
//! again.
//!
//! # Batches without threads
//!
//! The caller processes a batch alone if the batch is short, if the fuser is not `multiple-model`,
//! or if the process may use only one processor.

use std::{
    collections::VecDeque,
    num::NonZero,
    panic::resume_unwind,
    sync::{Condvar, Mutex, MutexGuard, OnceLock, PoisonError},
    thread::{self, Builder},
};

use plumbline_ahrs::{
    Ahrs,
    attitude::fuser::FuserStage,
    parts::{Aided, AidedOutput, CheckedSample, Fusion, Output, Parts, Sensors},
};

use super::rows::Rows;

/// Samples per chunk. The hand-over of a chunk takes about as long as one sample.
const CHUNK_SAMPLES: usize = 64;
/// Chunks of a pipeline. They allow each part to be some chunks ahead of the next, so that a worker
/// rarely waits.
const CHUNKS: usize = 12;
/// Minimum number of samples for which threads are started.
///
/// The start of a thread takes as long as a few hundred samples.
const MIN_SAMPLES: usize = 2000;
/// Samples that the caller processes alone after the workers have ended.
const SERIAL_SAMPLES: usize = 1000;

/// Samples of a batch.
pub(super) trait Source: Sync {
    /// Returns the number of samples.
    fn len(&self) -> usize;

    /// Passes the sample at `index` to the sensors.
    fn check(&self, index: usize, sensors: &mut Sensors<'_>, sample: &mut CheckedSample);
}

/// Passes all samples through the filter and appends one row for each.
pub(super) fn run<F: FuserStage>(ahrs: &mut Ahrs<F>, source: &impl Source, rows: &mut Rows) {
    let Parts { mut sensors, mut fusion } = ahrs.parts();
    let mut sample = CheckedSample::default();
    let mut next = 0;
    while next < source.len() {
        if source.len() - next >= MIN_SAMPLES && processors() > 1 {
            next = run_workers(&mut sensors, &mut fusion, source, next, rows);
        }
        let last = source.len().min(next + SERIAL_SAMPLES);
        for index in next..last {
            source.check(index, &mut sensors, &mut sample);
            rows.push(fusion.process(&sample));
        }
        next = last;
    }
    fusion.finish();
}

/// Returns the number of processors that the program may use.
///
/// The number is determined once, because that takes as long as a hundred samples.
fn processors() -> usize {
    static PROCESSORS: OnceLock<usize> = OnceLock::new();
    *PROCESSORS.get_or_init(|| thread::available_parallelism().map_or(1, NonZero::get))
}

/// Processes samples from `next` on with several workers.
///
/// Returns the index of the first sample that has not been processed.
fn run_workers<F: FuserStage>(
    sensors: &mut Sensors<'_>,
    fusion: &mut Fusion<'_, F>,
    source: &impl Source,
    next: usize,
    rows: &mut Rows,
) -> usize {
    let Some((aided, output)) = fusion.divide() else { return next };
    let reader = Reader { sensors, source, next, dependent: None };
    let writer = Writer { output, rows: &mut *rows, rest: Vec::new() };
    let pipeline = Pipeline::new(reader, aided, writer);
    thread::scope(|scope| {
        let pipeline = &pipeline;
        // If a thread cannot start, the other workers do its work.
        let start = |worker| Builder::new().spawn_scoped(scope, move || pipeline.work(worker)).ok();
        let workers: Vec<_> = (1..processors().min(PARTS)).filter_map(start).collect();
        pipeline.work(0);
        workers.into_iter().for_each(|worker| worker.join().unwrap_or_else(|panic| resume_unwind(panic)));
    });
    let State { parts, chunks: [_, checked, ready], .. } =
        pipeline.state.into_inner().unwrap_or_else(PoisonError::into_inner);
    let [Some(Part::Reader(reader)), _, Some(Part::Writer(writer))] = parts else { return next };
    let (next, dependent, invalid) = (reader.next, reader.dependent, writer.rest);
    if let [first, others @ ..] = &invalid[..] {
        rows.push(fusion.reset_and_process(first));
        let chunks = ready.iter().chain(&checked).flat_map(Chunk::samples);
        others.iter().chain(chunks).for_each(|sample| rows.push(fusion.process(sample)));
    }
    if let Some(sample) = dependent {
        rows.push(fusion.process(&sample));
    }
    next
}

/// Samples that the parts pass on. The memory is allocated at the first use, and used again.
#[derive(Default)]
struct Chunk {
    samples: Vec<CheckedSample>,
    /// Outputs of the model `aided`.
    aided: Vec<AidedOutput>,
    /// Number of samples in use.
    len: usize,
}

impl Chunk {
    fn samples(&self) -> &[CheckedSample] {
        &self.samples[..self.len]
    }
}

/// First part: fills chunks with checked samples.
struct Reader<'a, 's, S> {
    sensors: &'a mut Sensors<'s>,
    source: &'a S,
    /// Index of the next sample.
    next: usize,
    /// Last sample, if it depends on the attitude before it.
    dependent: Option<Box<CheckedSample>>,
}

impl<S: Source> Reader<'_, '_, S> {
    fn is_finished(&self) -> bool {
        self.next == self.source.len() || self.dependent.is_some()
    }

    fn process(&mut self, chunk: &mut Chunk) {
        chunk.samples.resize_with(CHUNK_SAMPLES, CheckedSample::default);
        chunk.len = 0;
        for sample in &mut chunk.samples[..CHUNK_SAMPLES.min(self.source.len() - self.next)] {
            self.source.check(self.next, self.sensors, sample);
            self.next += 1;
            if !sample.is_independent() {
                self.dependent = Some(Box::new(*sample));
                return;
            }
            chunk.len += 1;
        }
    }
}

/// Last part: computes the attitudes and appends their rows.
struct Writer<'a> {
    output: Output<'a>,
    rows: &'a mut Rows,
    /// Rest of a chunk, beginning with a sample that has made the output invalid.
    rest: Vec<CheckedSample>,
}

impl Writer<'_> {
    fn process(&mut self, chunk: &Chunk) {
        for (index, (sample, aided)) in chunk.samples().iter().zip(&chunk.aided).enumerate() {
            match self.output.process(sample, aided) {
                Some(attitude) => self.rows.push(attitude),
                None => return self.rest.extend(&chunk.samples()[index..]),
            }
        }
    }
}

/// Processes the samples of a chunk with the model `aided`.
fn process_aided(aided: &mut Aided<'_>, chunk: &mut Chunk) {
    chunk.aided.resize_with(CHUNK_SAMPLES, AidedOutput::default);
    for (sample, output) in chunk.samples[..chunk.len].iter().zip(&mut chunk.aided) {
        aided.process(sample, output);
    }
}

/// Number of parts. A chunk passes through the parts in order and returns to the first.
const PARTS: usize = 3;

/// Part of the filter.
enum Part<'a, 's, S> {
    Reader(Reader<'a, 's, S>),
    Aided(Aided<'a>),
    Writer(Writer<'a>),
}

impl<S: Source> Part<'_, '_, S> {
    fn process(&mut self, chunk: &mut Chunk) {
        match self {
            Self::Reader(reader) => reader.process(chunk),
            Self::Aided(aided) => process_aided(aided, chunk),
            Self::Writer(writer) => writer.process(chunk),
        }
    }
}

/// Parts and chunks that the workers share.
struct Pipeline<'a, 's, S> {
    state: Mutex<State<'a, 's, S>>,
    /// Signals that a part and a chunk were returned.
    changed: Condvar,
}

/// Parts and chunks that are not in use at the moment.
struct State<'a, 's, S> {
    parts: [Option<Part<'a, 's, S>>; PARTS],
    /// Chunks that wait for each part.
    chunks: [VecDeque<Chunk>; PARTS],
    /// Worker that has used each part last. Its processor holds the state of the part.
    last_workers: [usize; PARTS],
    /// Number of workers that wait for a change.
    waiting: usize,
    has_panicked: bool,
}

/// Part with a chunk for it.
struct Task<'a, 's, S> {
    index: usize,
    part: Part<'a, 's, S>,
    chunk: Chunk,
}

impl<'a, 's, S: Source> State<'a, 's, S> {
    /// Removes a part for which a chunk is waiting, with the chunk.
    ///
    /// The parts that the worker has used last are preferred, and then the later parts.
    fn next_task(&mut self, worker: usize) -> Option<Task<'a, 's, S>> {
        let mut candidates = (0..PARTS).rev().filter(|index| self.can_run(*index));
        let first = candidates.next()?;
        let own = [first].into_iter().chain(candidates).find(|index| self.last_workers[*index] == worker);
        let index = own.unwrap_or(first);
        self.last_workers[index] = worker;
        let (part, chunk) = self.parts[index].take().zip(self.chunks[index].pop_front())?;
        Some(Task { index, part, chunk })
    }

    /// Returns `true` if a part and a chunk for it are present, unless the work ends.
    fn can_run(&self, index: usize) -> bool {
        let is_present = match &self.parts[index] {
            None => false,
            Some(Part::Reader(reader)) => !reader.is_finished(),
            Some(Part::Aided(_) | Part::Writer(_)) => true,
        };
        let is_invalid = matches!(&self.parts[PARTS - 1], Some(Part::Writer(writer)) if !writer.rest.is_empty());
        is_present && !is_invalid && !self.has_panicked && !self.chunks[index].is_empty()
    }

    /// Returns the part of a task that has been run, and passes on the chunk.
    fn complete(&mut self, task: Task<'a, 's, S>) {
        let Task { index, part, chunk } = task;
        self.parts[index] = Some(part);
        self.chunks[(index + 1) % PARTS].push_back(chunk);
    }

    /// Returns `true` if all parts are present. If no task can run, the work is then complete.
    fn is_idle(&self) -> bool {
        self.parts.iter().all(Option::is_some)
    }
}

impl<'a, 's, S: Source> Pipeline<'a, 's, S> {
    fn new(reader: Reader<'a, 's, S>, aided: Aided<'a>, writer: Writer<'a>) -> Self {
        let state = State {
            parts: [Some(Part::Reader(reader)), Some(Part::Aided(aided)), Some(Part::Writer(writer))],
            chunks: [(0..CHUNKS).map(|_| Chunk::default()).collect(), VecDeque::new(), VecDeque::new()],
            last_workers: [0; PARTS],
            waiting: 0,
            has_panicked: false,
        };
        Self { state: Mutex::new(state), changed: Condvar::new() }
    }

    /// Runs tasks until the work is complete.
    fn work(&self, worker: usize) {
        let _end = EndOnPanic(self);
        let mut state = self.lock();
        loop {
            if let Some(mut task) = state.next_task(worker) {
                drop(state);
                task.part.process(&mut task.chunk);
                state = self.lock();
                state.complete(task);
                if state.waiting > 0 {
                    self.changed.notify_all();
                }
            } else if state.is_idle() || state.has_panicked {
                self.changed.notify_all();
                return;
            } else {
                state.waiting += 1;
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                state.waiting -= 1;
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, State<'a, 's, S>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Ends all workers if the thread panics, because its part is lost.
struct EndOnPanic<'a, 'p, 's, S: Source>(&'a Pipeline<'p, 's, S>);

impl<S: Source> Drop for EndOnPanic<'_, '_, '_, S> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.lock().has_panicked = true;
            self.0.changed.notify_all();
        }
    }
}
