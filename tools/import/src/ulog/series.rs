//! Samples of one instance of a topic.
//!
//! Input: messages of a log, or the log itself.
//!
//! Output: samples of the instance in log order, and counts of skipped samples.
//!
//! Memory: up to [`MAX_QUEUED`] samples between the reading thread and the consumer.
//!
//! Failure: a file error ends the samples.

use std::{
    io,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{SyncSender, sync_channel},
    },
    thread,
};

use px4_ulog::stream_parser::DataMessage;

use super::messages;
use crate::{ImportError, error::open_error, row_writer::Samples, sensor_state::SensorState};

/// Maximum number of samples that the reading thread may be ahead of the consumer.
const MAX_QUEUED: usize = 4096;

/// Counts of the messages of one instance of a topic, and the state of its sensor.
#[derive(Debug, Clone, Default)]
pub(super) struct Series {
    pub(super) messages: u64,
    pub(super) accepted: u64,
    pub(super) rejected: u64,
    /// Time of the newest accepted sample, ns.
    pub(super) last_ns: Option<i64>,
    pub(super) state: SensorState,
}

/// Streams the samples that `decode` extracts from the messages of a topic.
///
/// The log is read in a separate thread, because the ULog parser returns messages only through a
/// callback.
pub(super) fn stream<T: Send + 'static>(
    path: PathBuf,
    topic: &'static str,
    read_bytes: Arc<AtomicU64>,
    mut decode: impl FnMut(&DataMessage) -> Result<Option<T>, ImportError> + Send + 'static,
) -> Samples<'static, T> {
    let (sender, samples) = sync_channel(MAX_QUEUED);
    thread::spawn(move || {
        let send = |sender: &SyncSender<_>, sample| {
            // Sending fails only if the consumer has stopped. In that case, the returned error
            // merely ends this thread.
            sender.send(sample).map_err(|_| open_error(&path, io::ErrorKind::BrokenPipe.into()))
        };
        let mut progress = |bytes| read_bytes.store(bytes, Ordering::Relaxed);
        let read = messages::read(&path, &[topic], &mut progress, &mut |message| {
            decode(message)?.map_or(Ok(()), |sample| send(&sender, Ok(sample)))
        });
        if let Err(error) = read {
            let _ = send(&sender, Err(error));
        }
    });
    Box::new(samples.into_iter())
}
