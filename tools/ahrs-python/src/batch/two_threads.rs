//! Passes the samples of a batch through the filter, in two threads if the batch is long.
//!
//! Input: the samples in order.
//!
//! Output: one row per sample. The rows and the state of the filter have the same bits with one
//! thread and with two.
//!
//! Failure: a panic of the second thread is passed on to the caller.
//!
//! # Threads
//!
//! The model `aided` does not depend on the other [parts](plumbline_ahrs::parts) of the fuser. It
//! therefore runs in a second thread, ahead of the caller:
//!
//! ```text
//! samples ─► Sensors (copy) ─► Aided ──┐                    second thread
//!                                      │ outputs
//! samples ─► Sensors ────────────► Output ─► rows           caller
//! ```
//!
//! Both threads check the samples and run the stages of gyro and accelerometer. Passing on the
//! checked samples takes longer between processors that do not share a cache. Most outputs of
//! `aided` are not needed and are not passed on.
//!
//! The second thread has less to do. It therefore also provides the memory of the rows. While it
//! starts, the caller provides the memory of the first rows.
//!
//! # Samples for which the parts depend on each other
//!
//! After an outage of the gyro, the fused attitude decides whether the level is initialised again.
//! An invalid output resets both models of the fuser. Both cases are rare. Both threads end at such
//! a sample. The caller processes it and the next [`SERIAL_SAMPLES`] alone, then starts a thread
//! again.
//!
//! # Batches without a second thread
//!
//! The caller processes a batch alone if the batch is short, if the fuser is not `multiple-model`,
//! or if the process may use only one processor.

use std::{
    num::NonZero,
    panic::resume_unwind,
    sync::{
        OnceLock,
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::{self, Builder},
};

use plumbline_ahrs::{
    Ahrs,
    attitude::fuser::Fuser,
    parts::{Aided, AidedOutput, CheckedSample, Output, Parts, Sensors},
};

use super::rows::{Memory, Rows};

/// Samples per chunk. They fit into the nearest cache of a processor.
///
/// A part processes a whole chunk before the next part begins, because the code of all parts
/// together does not fit into the nearest cache.
const CHUNK_SAMPLES: usize = 64;
/// Maximum number of chunks by which `aided` is ahead. It limits the memory for the outputs.
const MAX_CHUNKS_AHEAD: usize = 64;
/// Number of rows for which memory is provided at a time.
const PROVIDED_ROWS: usize = 4096;
/// Minimum number of samples for which a thread is started.
///
/// The start of a thread takes as long as a few hundred samples.
const MIN_SAMPLES: usize = 2000;
/// Samples that the caller processes alone after the second thread has ended.
const SERIAL_SAMPLES: usize = 1000;

/// Samples of a batch.
pub(super) trait Source: Sync {
    /// Returns the number of samples.
    fn len(&self) -> usize;

    /// Passes the sample at `index` to the sensors.
    fn check(&self, index: usize, sensors: &mut Sensors<'_>, sample: &mut CheckedSample);
}

/// Passes all samples through the filter and appends one row for each.
pub(super) fn run(ahrs: &mut Ahrs<Fuser>, source: &impl Source, rows: &mut Rows) {
    let mut next = 0;
    while next < source.len() {
        if source.len() - next >= MIN_SAMPLES && processors() > 1 {
            next = run_two_threads(ahrs, source, next, rows);
        }
        let last = source.len().min(next + SERIAL_SAMPLES);
        let Parts { mut sensors, mut fusion } = ahrs.parts();
        let mut sample = CheckedSample::default();
        rows.memory().provide(next..last);
        for index in next..last {
            source.check(index, &mut sensors, &mut sample);
            rows.push(fusion.process(&sample));
        }
        fusion.finish();
        next = last;
    }
}

/// Returns the number of processors that the program may use.
///
/// The number is determined once, because that takes as long as a hundred samples.
fn processors() -> usize {
    static PROCESSORS: OnceLock<usize> = OnceLock::new();
    *PROCESSORS.get_or_init(|| thread::available_parallelism().map_or(1, NonZero::get))
}

/// Processes samples from `next` on with a second thread.
///
/// Returns the index of the first sample that has not been processed.
fn run_two_threads(ahrs: &mut Ahrs<Fuser>, source: &impl Source, next: usize, rows: &mut Rows) -> usize {
    if ahrs.parts().fusion.divide().is_none() {
        return next;
    }
    let memory = rows.memory();
    let (sender, outputs) = sync_channel(MAX_CHUNKS_AHEAD);
    // The second thread uses a copy of the filter, so that the threads do not write to the same
    // cache lines. It starts while the filter is copied.
    let (copy_sender, copies) = sync_channel::<Box<Ahrs<Fuser>>>(1);
    let run_aided = move || {
        let mut copy = copies.recv().ok()?;
        let Parts { sensors, mut fusion } = copy.parts();
        let (aided, _) = fusion.divide()?;
        process_aided(aided, Reader::new(sensors, source, next), memory, &sender);
        Some(copy)
    };
    thread::scope(|scope| {
        // If the thread cannot start, the channels are closed.
        let thread = Builder::new().spawn_scoped(scope, run_aided).ok();
        let _ = copy_sender.send(Box::new(ahrs.clone()));
        memory.provide(next..next + PROVIDED_ROWS);
        let Parts { sensors, mut fusion } = ahrs.parts();
        let Some((_, output)) = fusion.divide() else { return next };
        let mut reader = Reader::new(sensors, source, next);
        let end = append_rows(output, &mut reader, outputs, rows);
        let copy = thread.map_or(Ok(None), |thread| thread.join()).unwrap_or_else(|panic| resume_unwind(panic));
        if let Some(mut copy) = copy
            && let (Some((mut aided, _)), Some((copied_aided, _))) = (fusion.divide(), copy.parts().fusion.divide())
        {
            aided.copy_from(&copied_aided);
        }
        for (number, sample) in reader.samples()[end.processed..].iter().enumerate() {
            let is_invalid = number == 0 && end.is_invalid;
            rows.push(if is_invalid { fusion.reset_and_process(sample) } else { fusion.process(sample) });
        }
        fusion.finish();
        reader.next
    })
}

/// Checks the samples in chunks.
struct Reader<'s, 'a, S> {
    sensors: Sensors<'s>,
    source: &'a S,
    /// Index of the sample after the chunk.
    next: usize,
    chunk: Vec<CheckedSample>,
    /// Number of samples in the chunk.
    len: usize,
}

impl<'s, 'a, S: Source> Reader<'s, 'a, S> {
    fn new(sensors: Sensors<'s>, source: &'a S, next: usize) -> Self {
        Self { sensors, source, next, chunk: vec![CheckedSample::default(); CHUNK_SAMPLES], len: 0 }
    }

    /// Returns the next samples.
    ///
    /// A sample that depends on the attitude is the last one. After the last sample of the batch,
    /// the result is empty.
    fn read(&mut self) -> &[CheckedSample] {
        self.len = 0;
        for sample in self.chunk.iter_mut().take(self.source.len() - self.next) {
            self.source.check(self.next, &mut self.sensors, sample);
            self.next += 1;
            self.len += 1;
            if !sample.is_independent() {
                break;
            }
        }
        self.samples()
    }

    /// Returns the samples of the last [`read`](Self::read).
    fn samples(&self) -> &[CheckedSample] {
        &self.chunk[..self.len]
    }
}

/// Outputs of the model `aided` that are needed, each with the number of its sample in the chunk.
type Outputs = Vec<(usize, AidedOutput)>;

/// Processes samples with the model `aided`, until one depends on the attitude or the receiver is
/// closed. Provides the memory of the rows after the first [`PROVIDED_ROWS`].
fn process_aided<S: Source>(
    mut aided: Aided<'_>,
    mut reader: Reader<'_, '_, S>,
    memory: Memory,
    sender: &SyncSender<Outputs>,
) {
    let mut is_independent = true;
    let mut provided = reader.next + PROVIDED_ROWS;
    while is_independent {
        if provided <= reader.next {
            memory.provide(reader.next..reader.next + PROVIDED_ROWS);
            provided = reader.next + PROVIDED_ROWS;
        }
        let samples = reader.read();
        if samples.is_empty() {
            return;
        }
        let mut outputs = Outputs::new();
        for (number, sample) in samples.iter().enumerate() {
            is_independent = sample.is_independent();
            if is_independent {
                outputs.extend(aided.process(sample).map(|output| (number, output)));
            }
        }
        if sender.send(outputs).is_err() {
            return;
        }
    }
}

/// End of [`append_rows`].
struct End {
    /// Number of samples of the last chunk that have been processed.
    processed: usize,
    /// Set if the next sample has made the output of the fuser invalid.
    is_invalid: bool,
}

/// Processes samples until the batch ends, a sample depends on the attitude, the output is invalid
/// or the sender is closed. Appends their rows.
fn append_rows<S: Source>(
    mut output: Output<'_>,
    reader: &mut Reader<'_, '_, S>,
    outputs: Receiver<Outputs>,
    rows: &mut Rows,
) -> End {
    loop {
        let samples = reader.read();
        if samples.is_empty() {
            return End { processed: 0, is_invalid: false };
        }
        let Ok(outputs) = outputs.recv() else { return End { processed: 0, is_invalid: false } };
        let mut outputs = outputs.iter().peekable();
        for (number, sample) in samples.iter().enumerate() {
            if !sample.is_independent() {
                return End { processed: number, is_invalid: false };
            }
            let aided = outputs.next_if(|output| output.0 == number).map(|output| &output.1);
            match output.process(sample, aided) {
                Some(attitude) => rows.push(attitude),
                None => return End { processed: number, is_invalid: true },
            }
        }
    }
}
