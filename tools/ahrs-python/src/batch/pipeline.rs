//! Passes the samples of a batch through the filter, in several threads if the batch is long.
//!
//! Input: the samples in order.
//!
//! Output: one row per sample. The rows and the state of the filter are the same bits with any number
//! of threads.
//!
//! Failure: a panic of a thread ends all threads and is passed on to the caller.
//!
//! # Threads
//!
//! The samples pass through three [parts](plumbline_ahrs::parts) of the filter in chunks. Each part
//! depends only on the parts before it, so the parts work on different chunks at the same time:
//!
//! ```text
//! empty ─► Reader ─► checked ─► AidedModel ─► ready ─► Writer ─► empty
//! ```
//!
//! No part has a thread of its own. A worker takes the last part for which a chunk is waiting, lets it
//! process the chunk, and returns both. All workers are therefore busy although the parts do not take
//! the same time. The caller is one of the workers. The number of chunks is constant, so the memory
//! does not depend on the length of the batch.
//!
//! # Samples for which the parts depend on each other
//!
//! After an outage of the gyro, the attitude decides whether the level is initialised again. An
//! invalid output resets both models. Both are rare. The workers end at such a sample. The caller
//! processes it and [`SERIAL_SAMPLES`] after it alone, and then starts workers again.
//!
//! # Short batches
//!
//! A short batch, a fuser other than `multiple-model`, and a computer with one processor use the
//! caller only.

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

/// Samples per chunk. The hand-over of a chunk takes less time than one sample.
const CHUNK_SAMPLES: usize = 128;
/// Chunks per batch: one for each part, and one before each part.
const CHUNKS: usize = 6;
/// Maximum number of workers: one for each part.
const MAX_WORKERS: usize = 3;
/// Minimum number of samples for which threads are started. The start takes as long as a few hundred
/// samples.
const MIN_SAMPLES: usize = 2000;
/// Samples that the caller processes alone after a sample for which the parts depend on each other.
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

/// Processes samples from `next` on with several workers. Returns the index of the first sample that
/// has not been processed.
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
        // If a thread cannot start, the other workers do its work.
        let start = |_| Builder::new().spawn_scoped(scope, || pipeline.work()).ok();
        let workers: Vec<_> = (1..processors().min(MAX_WORKERS)).filter_map(start).collect();
        pipeline.work();
        workers.into_iter().for_each(|worker| worker.join().unwrap_or_else(|panic| resume_unwind(panic)));
    });
    let State { reader, writer, checked, ready, .. } =
        pipeline.state.into_inner().unwrap_or_else(PoisonError::into_inner);
    let (Some(Reader { next, dependent, .. }), Some(Writer { rest: invalid, .. })) = (reader, writer) else {
        return next;
    };
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

/// Samples that the parts pass on. The memory is used again.
struct Chunk {
    samples: Vec<CheckedSample>,
    /// Outputs of the model `aided`.
    aided: Vec<AidedOutput>,
    /// Number of samples in use.
    len: usize,
}

impl Chunk {
    fn new() -> Self {
        let (samples, aided) =
            (vec![CheckedSample::default(); CHUNK_SAMPLES], vec![AidedOutput::default(); CHUNK_SAMPLES]);
        Self { samples, aided, len: 0 }
    }

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
    dependent: Option<CheckedSample>,
}

impl<S: Source> Reader<'_, '_, S> {
    fn is_finished(&self) -> bool {
        self.next == self.source.len() || self.dependent.is_some()
    }

    fn process(&mut self, chunk: &mut Chunk) {
        chunk.len = 0;
        for sample in &mut chunk.samples[..CHUNK_SAMPLES.min(self.source.len() - self.next)] {
            self.source.check(self.next, self.sensors, sample);
            self.next += 1;
            if !sample.is_independent() {
                self.dependent = Some(*sample);
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
    /// Rest of the chunk from the first sample on whose output is invalid.
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
    for (sample, output) in chunk.samples[..chunk.len].iter().zip(&mut chunk.aided) {
        aided.process(sample, output);
    }
}

/// Parts and chunks that the workers share.
struct Pipeline<'a, 's, S> {
    state: Mutex<State<'a, 's, S>>,
    /// Signals that a part and a chunk were returned.
    changed: Condvar,
}

/// Parts and chunks that no worker uses at the moment.
struct State<'a, 's, S> {
    reader: Option<Reader<'a, 's, S>>,
    aided: Option<Aided<'a>>,
    writer: Option<Writer<'a>>,
    empty: Vec<Chunk>,
    checked: VecDeque<Chunk>,
    ready: VecDeque<Chunk>,
    /// Number of workers that wait for a change.
    waiting: usize,
    has_panicked: bool,
}

/// Part with a chunk for it.
enum Task<'a, 's, S> {
    Read(Reader<'a, 's, S>, Chunk),
    Aided(Aided<'a>, Chunk),
    Write(Writer<'a>, Chunk),
}

impl<'a, 's, S: Source> State<'a, 's, S> {
    /// Removes the last part for which a chunk is waiting, with the chunk.
    fn next_task(&mut self) -> Option<Task<'a, 's, S>> {
        if self.has_panicked || self.writer.as_ref().is_some_and(|writer| !writer.rest.is_empty()) {
            return None;
        }
        if !self.ready.is_empty()
            && let Some(writer) = self.writer.take()
        {
            return self.ready.pop_front().map(|chunk| Task::Write(writer, chunk));
        }
        if !self.checked.is_empty()
            && let Some(aided) = self.aided.take()
        {
            return self.checked.pop_front().map(|chunk| Task::Aided(aided, chunk));
        }
        let reader = self.reader.take_if(|reader| !reader.is_finished() && !self.empty.is_empty())?;
        self.empty.pop().map(|chunk| Task::Read(reader, chunk))
    }

    /// Returns the part and the chunk of a task that has been run.
    fn complete(&mut self, task: Task<'a, 's, S>) {
        match task {
            Task::Read(reader, chunk) => {
                self.reader = Some(reader);
                self.checked.push_back(chunk);
            }
            Task::Aided(aided, chunk) => {
                self.aided = Some(aided);
                self.ready.push_back(chunk);
            }
            Task::Write(writer, chunk) => {
                self.writer = Some(writer);
                self.empty.push(chunk);
            }
        }
    }

    /// Returns `true` if no worker uses a part. Without a task, there will be none later.
    fn is_idle(&self) -> bool {
        self.reader.is_some() && self.aided.is_some() && self.writer.is_some()
    }
}

impl<S: Source> Task<'_, '_, S> {
    fn run(&mut self) {
        match self {
            Self::Read(reader, chunk) => reader.process(chunk),
            Self::Aided(aided, chunk) => process_aided(aided, chunk),
            Self::Write(writer, chunk) => writer.process(chunk),
        }
    }
}

impl<'a, 's, S: Source> Pipeline<'a, 's, S> {
    fn new(reader: Reader<'a, 's, S>, aided: Aided<'a>, writer: Writer<'a>) -> Self {
        let state = State {
            reader: Some(reader),
            aided: Some(aided),
            writer: Some(writer),
            empty: (0..CHUNKS).map(|_| Chunk::new()).collect(),
            checked: VecDeque::with_capacity(CHUNKS),
            ready: VecDeque::with_capacity(CHUNKS),
            waiting: 0,
            has_panicked: false,
        };
        Self { state: Mutex::new(state), changed: Condvar::new() }
    }

    /// Runs tasks until there are none.
    fn work(&self) {
        let _end = EndOnPanic(self);
        let mut state = self.lock();
        loop {
            if let Some(mut task) = state.next_task() {
                drop(state);
                task.run();
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
