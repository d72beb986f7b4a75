//! The samples of one instance of a topic.
//!
//! Input: messages of a log, or the log itself. Output: samples of the first instance, in the order of time, and what was left out.
//! Memory: samples that wait for whoever takes them, [`MAX_WAITING`] at most. Failure: of the file; it ends the samples.

use std::{
    io,
    path::PathBuf,
    sync::mpsc::{SyncSender, sync_channel},
    thread,
};

use px4_ulog::stream_parser::DataMessage;

use super::messages;
use crate::{ImportError, Note, error::opening, row_writer::Samples};

/// Samples that are ahead of whoever takes them.
const MAX_WAITING: usize = 4096;

/// What was taken of a topic, and what was left out.
#[derive(Debug, Clone)]
pub(super) struct Series {
    pub(super) topic: &'static str,
    what: &'static str,
    pub(super) instance: Option<u8>,
    /// The time of the newest that was taken.
    pub(super) last_ns: Option<i64>,
    pub(super) taken: u64,
    /// Messages of this instance.
    pub(super) messages: u64,
    /// Of other instances.
    others: u64,
    not_after: u64,
    refused: u64,
}

impl Series {
    /// Of the first instance that comes, or an earlier one that comes later.
    pub(super) fn new(topic: &'static str, what: &'static str) -> Self {
        let instance = None;
        Self { topic, what, instance, last_ns: None, taken: 0, messages: 0, others: 0, not_after: 0, refused: 0 }
    }

    /// The same again, now that the instance is known.
    pub(super) fn again(&self) -> Self {
        Self { instance: self.instance, ..Self::new(self.topic, self.what) }
    }

    /// The message is one of the first instance.
    pub(super) fn admits(&mut self, message: &DataMessage) -> bool {
        let found = message.multi_id.value();
        match self.instance {
            Some(instance) if found == instance => {}
            Some(instance) if found > instance => {
                self.others += 1;
                return false;
            }
            _ => {
                // An earlier one has come later.
                let others = self.others + self.messages;
                *self = Self { instance: Some(found), others, ..Self::new(self.topic, self.what) };
            }
        }
        self.messages += 1;
        true
    }

    /// The sample where it is later than the one before it; `None` is one that says nothing.
    pub(super) fn take<T>(&mut self, sample: Option<T>, t_ns: impl Fn(&T) -> i64) -> Option<T> {
        let Some(sample) = sample else {
            self.refused += 1;
            return None;
        };
        let t_ns = t_ns(&sample);
        if self.last_ns.is_some_and(|last_ns| t_ns <= last_ns) {
            self.not_after += 1;
            return None;
        }
        self.last_ns = Some(t_ns);
        self.taken += 1;
        Some(sample)
    }

    pub(super) fn notes(&self, refusal: &'static str, notes: &mut Vec<Note>) {
        let Self { topic, what, .. } = *self;
        if let (1.., Some(read)) = (self.others, self.instance) {
            notes.push(Note::OtherInstances { topic, read, others: self.others });
        }
        for (count, why) in [(self.refused, refusal), (self.not_after, "they are not later than the one before them")] {
            if count > 0 {
                notes.push(Note::LeftOut { what, count, why });
            }
        }
    }
}

/// What `decode` makes of the messages of a topic, read by a thread of its own: whoever lays them at the rows is in the same log elsewhere.
pub(super) fn streamed<T: Send + 'static>(
    path: PathBuf,
    topic: &'static str,
    mut decode: impl FnMut(&DataMessage) -> Result<Option<T>, ImportError> + Send + 'static,
) -> Samples<'static, T> {
    let (tell, samples) = sync_channel(MAX_WAITING);
    thread::spawn(move || {
        let give = |tell: &SyncSender<_>, sample| {
            // Nobody takes any more.
            tell.send(sample).map_err(|_| opening(&path, io::ErrorKind::BrokenPipe.into()))
        };
        let read = messages::read(&path, &[topic], &mut |_| {}, &mut |message| {
            decode(message)?.map_or(Ok(()), |sample| give(&tell, Ok(sample)))
        });
        if let Err(error) = read {
            let _ = give(&tell, Err(error));
        }
    });
    Box::new(samples.into_iter())
}
