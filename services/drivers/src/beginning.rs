//! The beginning of a text, which says what its columns are, for a later process of the service.

use bus::{BusError, Publisher};
use launch::Service;
use messages::{CHECKPOINT_WORDS, Checkpoint};
use runtime::{
    RuntimeError, ServiceContext,
    service_config::{BUFFER_BESIDE, Resume},
};

const WORD_BYTES: usize = size_of::<u64>();
/// The first word is the length.
const BYTES_MAX: usize = (CHECKPOINT_WORDS - 1) * WORD_BYTES;

/// What came up to the first reading, as lines.
pub(crate) struct Beginning {
    text: Vec<u8>,
    is_told: bool,
    checkpoints: Publisher<Checkpoint>,
    incarnation: u32,
}

impl Beginning {
    /// That of an earlier process, where there was one; empty where there was none.
    pub(crate) fn open(context: &ServiceContext) -> Result<Self, RuntimeError> {
        let earlier = match &context.config.resume {
            Some(Resume::Checkpoint(record)) => record.checkpoint().as_ref().map(text_of),
            _ => None,
        };
        Ok(Self {
            is_told: earlier.is_some(),
            text: earlier.unwrap_or_default(),
            checkpoints: context.bus.publisher(BUFFER_BESIDE)?,
            incarnation: context.config.incarnation,
        })
    }

    /// The lines.
    pub(crate) fn text(&self) -> &[u8] {
        &self.text
    }

    /// Takes bytes as they come; from the first that bring a reading on it is told.
    pub(crate) fn see(&mut self, bytes: &[u8], bring_readings: bool) -> Result<(), BusError> {
        if self.is_told {
            return Ok(());
        }
        let room = BYTES_MAX.saturating_sub(self.text.len()).min(bytes.len());
        self.text.extend_from_slice(bytes.get(..room).unwrap_or_default());
        if !bring_readings {
            return Ok(());
        }
        let whole = self.text.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        self.text.truncate(whole);
        self.is_told = true;
        self.checkpoints.send(&checkpoint_of(&self.text, self.incarnation))
    }
}

fn checkpoint_of(text: &[u8], incarnation: u32) -> Checkpoint {
    let mut checkpoint = Checkpoint { service: Service::Drivers as u32, incarnation, ..bytemuck::Zeroable::zeroed() };
    checkpoint.words[0] = text.len() as u64;
    for (word, bytes) in checkpoint.words[1..].iter_mut().zip(text.chunks(WORD_BYTES)) {
        let mut padded = [0; WORD_BYTES];
        padded[..bytes.len()].copy_from_slice(bytes);
        *word = u64::from_le_bytes(padded);
    }
    checkpoint.slot_words = 1 + text.len().div_ceil(WORD_BYTES) as u32;
    checkpoint.checksum = checkpoint.sum();
    checkpoint
}

fn text_of(checkpoint: &Checkpoint) -> Vec<u8> {
    let length = usize::try_from(checkpoint.words[0]).unwrap_or(0).min(BYTES_MAX);
    checkpoint.words[1..].iter().flat_map(|word| word.to_le_bytes()).take(length).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_of_any_length_comes_back_from_its_checkpoint() {
        for length in [0, 1, 8, 47, BYTES_MAX] {
            let text: Vec<u8> = (0..length).map(|i| i as u8).collect();
            let checkpoint = checkpoint_of(&text, 3);
            assert_eq!((text_of(&checkpoint), checkpoint.checksum), (text, checkpoint.sum()));
        }
    }
}
