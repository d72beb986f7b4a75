//! Start of a text stream, which may name the columns. It is kept in a checkpoint for the next
//! process of the service.

use bus::{BusError, Publisher};
use launch::Service;
use messages::{CHECKPOINT_WORDS, Checkpoint};
use runtime::{
    RuntimeError, ServiceContext,
    service_config::{CONTROL_BUFFER, Resume},
};

const WORD_BYTES: usize = size_of::<u64>();
/// Maximum length of the preamble, in bytes. It may fill all words of a checkpoint except the
/// first, which holds the length.
pub(crate) const MAX_BYTES: usize = (CHECKPOINT_WORDS - 1) * WORD_BYTES;

/// Lines received up to the first reading of the current sender.
pub(crate) struct StreamPreamble {
    text: Vec<u8>,
    is_complete: bool,
    /// Publisher of the checkpoint; `None` without the bus.
    checkpoints: Option<Publisher<Checkpoint>>,
    incarnation: u32,
}

impl StreamPreamble {
    /// Restores the preamble of an earlier process, or creates an empty one.
    pub(crate) fn open(context: &ServiceContext) -> Result<Self, RuntimeError> {
        let previous = context.config.resume.as_ref().and_then(Resume::checkpoint).map(from_checkpoint);
        Ok(Self {
            is_complete: previous.is_some(),
            text: previous.unwrap_or_default(),
            checkpoints: Some(context.bus.publisher(CONTROL_BUFFER)?),
            incarnation: context.config.incarnation,
        })
    }

    /// Creates an empty preamble that is not published.
    pub(crate) fn unpublished() -> Self {
        Self { text: Vec::new(), is_complete: false, checkpoints: None, incarnation: 0 }
    }

    /// Returns the text of the preamble.
    pub(crate) fn text(&self) -> &[u8] {
        &self.text
    }

    /// Records received bytes. The preamble is published with the first bytes that yield a reading.
    pub(crate) fn push(&mut self, bytes: &[u8], yields_readings: bool) -> Result<(), BusError> {
        if self.is_complete {
            return Ok(());
        }
        let room = MAX_BYTES.saturating_sub(self.text.len()).min(bytes.len());
        self.text.extend_from_slice(bytes.get(..room).unwrap_or_default());
        if !yields_readings {
            return Ok(());
        }
        let complete_bytes = self.text.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        self.text.truncate(complete_bytes);
        self.is_complete = true;
        let Self { text, checkpoints, incarnation, .. } = self;
        checkpoints.iter().try_for_each(|checkpoints| checkpoints.send_checkpoint(&to_checkpoint(text, *incarnation)))
    }

    /// Discards the preamble. Called before the bytes of another sender are recorded.
    pub(crate) fn restart(&mut self) {
        self.text.clear();
        self.is_complete = false;
    }
}

fn to_checkpoint(text: &[u8], incarnation: u32) -> Checkpoint {
    let mut checkpoint = Checkpoint { service: Service::Drivers as u32, incarnation, ..bytemuck::Zeroable::zeroed() };
    checkpoint.words[0] = text.len() as u64;
    for (word, bytes) in checkpoint.words[1..].iter_mut().zip(text.chunks(WORD_BYTES)) {
        let mut padded = [0; WORD_BYTES];
        padded[..bytes.len()].copy_from_slice(bytes);
        *word = u64::from_le_bytes(padded);
    }
    checkpoint.slot_words = 1 + text.len().div_ceil(WORD_BYTES) as u32;
    checkpoint.checksum = checkpoint.compute_checksum();
    checkpoint
}

fn from_checkpoint(checkpoint: &Checkpoint) -> Vec<u8> {
    let length = usize::try_from(checkpoint.words[0]).unwrap_or(0).min(MAX_BYTES);
    checkpoint.words[1..].iter().flat_map(|word| word.to_le_bytes()).take(length).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preamble_round_trips_through_checkpoint() {
        for length in [0, 1, 8, 47, MAX_BYTES] {
            let text: Vec<u8> = (0..length).map(|i| i as u8).collect();
            let checkpoint = to_checkpoint(&text, 3);
            assert_eq!((from_checkpoint(&checkpoint), checkpoint.checksum), (text, checkpoint.compute_checksum()));
        }
    }
}
