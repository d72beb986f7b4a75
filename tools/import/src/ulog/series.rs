//! Samples of one instance of a topic.
//!
//! Input: messages of a log, or the log itself.
//!
//! Output: samples of the first instance in log order, and counts of skipped samples.
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
use crate::{ImportError, Note, error::open_error, row_writer::Samples};

/// Maximum number of samples queued for the consumer.
const MAX_QUEUED: usize = 4096;

/// Selected instance of a topic, with message counts.
#[derive(Debug, Clone)]
pub(super) struct Series {
    pub(super) topic: &'static str,
    what: &'static str,
    pub(super) instance: Option<u8>,
    /// Time of the newest accepted sample.
    pub(super) last_ns: Option<i64>,
    pub(super) accepted: u64,
    /// Number of messages of the selected instance.
    pub(super) messages: u64,
    /// Number of messages of other instances.
    other_messages: u64,
    rejected: u64,
}

impl Series {
    /// Creates a series for the lowest instance that occurs in the log.
    pub(super) fn new(topic: &'static str, what: &'static str) -> Self {
        let instance = None;
        Self { topic, what, instance, last_ns: None, accepted: 0, messages: 0, other_messages: 0, rejected: 0 }
    }

    /// Returns an empty series for the same instance.
    pub(super) fn restarted(&self) -> Self {
        Self { instance: self.instance, ..Self::new(self.topic, self.what) }
    }

    /// Returns `true` if the message belongs to the selected instance.
    ///
    /// A lower instance replaces the selected one.
    pub(super) fn accept_instance(&mut self, message: &DataMessage) -> bool {
        let found = message.multi_id.value();
        match self.instance {
            Some(instance) if found == instance => {}
            Some(instance) if found > instance => {
                self.other_messages += 1;
                return false;
            }
            _ => {
                // The messages counted so far are from a higher instance and now count as other
                // messages.
                let others = self.other_messages + self.messages;
                *self = Self { instance: Some(found), other_messages: others, ..Self::new(self.topic, self.what) };
            }
        }
        self.messages += 1;
        true
    }

    /// Returns the sample and notes its time.
    ///
    /// A `sample` of `None` is invalid and is counted as rejected.
    pub(super) fn push<T>(&mut self, sample: Option<T>, t_ns: impl Fn(&T) -> i64) -> Option<T> {
        let Some(sample) = sample else {
            self.reject();
            return None;
        };
        self.last_ns = Some(t_ns(&sample));
        self.accepted += 1;
        Some(sample)
    }

    /// Counts an invalid sample.
    pub(super) fn reject(&mut self) {
        self.rejected += 1;
    }

    pub(super) fn notes(&self, rejection_reason: &'static str, notes: &mut Vec<Note>) {
        let Self { topic, what, .. } = *self;
        if let (1.., Some(read)) = (self.other_messages, self.instance) {
            notes.push(Note::OtherInstances { topic, read, others: self.other_messages });
        }
        if self.rejected > 0 {
            notes.push(Note::Skipped { what, count: self.rejected, reason: rejection_reason });
        }
    }
}

/// Returns the decoded messages of a topic.
///
/// A separate thread reads the log, independently of the pass that merges the samples into the
/// rows. The number of bytes read is stored in `read_bytes`.
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
