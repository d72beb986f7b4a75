//! Captures a slot's state between two ticks as a checkpoint, and resumes from it in another
//! process.
//!
//! - Input: a slot, or a checkpoint from any origin.
//! - Output: a checkpoint, or a slot with the restored state.
//! - Failure: checkpoints are not trusted. If one is invalid, the slot is left unchanged and the
//!   cause is returned.

use attitude::{
    stage::{MAX_STATE_VALUES, RestoreError, Snapshot, Stage},
    state_words::StateWords,
};
use graph::Service;
use messages::{CHECKPOINT_WORDS, Checkpoint};

use crate::slot::SlotProcessor;

/// Part of the state that was restored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Resumed {
    /// The complete state was restored. Later outputs are bit-identical to those of an
    /// uninterrupted run.
    Complete,
    /// Only the state common to all stages of the slot was restored, because the checkpoint belongs
    /// to another stage.
    Common,
}

/// Cause of a failed resumption.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ResumeError {
    /// The checkpoint belongs to another slot.
    #[error("the checkpoint belongs to another slot")]
    OtherSlot,
    /// The checksum or the number of words is wrong.
    #[error("the checkpoint is damaged or of another version")]
    Damaged,
    /// The slot's own state is invalid.
    #[error("the checkpoint holds {0}")]
    Invalid(&'static str),
    /// The stage rejected its state.
    #[error(transparent)]
    Stage(#[from] RestoreError),
}

/// Captures the state of a slot in `record`, which is either all zeros or an earlier checkpoint of
/// the same slot.
///
/// A checkpoint takes 13 kB, so it is written in place. Pass `swapped` as `true` until an output
/// with the flag `SWAPPED` has been published.
pub fn capture<S: SlotProcessor>(slot: &mut S, incarnation: u32, swapped: bool, record: &mut Checkpoint) {
    let used = [record.slot_words, record.common_words, record.stage_words].map(|len| len as usize).iter().sum();
    record.next_tick = slot.sequence().next_tick;
    record.service = Service::from(S::SLOT) as u32;
    record.incarnation = incarnation;
    record.swapped = swapped.into();
    record.stage = Default::default();
    for (character, byte) in record.stage.iter_mut().zip(slot.stage().name().bytes()) {
        *character = byte;
    }
    let mut words = WordWriter { words: &mut record.words, len: 0 };
    slot.visit_own_state(&mut |word| words.push(*word));
    record.slot_words = words.len as u32;
    slot.stage().common().visit(&mut |word| words.push(*word));
    record.common_words = words.len as u32 - record.slot_words;
    let stage_start = words.len;
    slot.stage().visit_values(&mut |value| words.push(value.to_bits()));
    let len = words.len;
    record.stage_words = (len - stage_start) as u32;
    // The words after the state must be zero.
    if let Some(unused) = record.words.get_mut(len..used) {
        unused.fill(0);
    }
    record.checksum = record.compute_checksum();
}

/// Resumes from a checkpoint.
///
/// The complete state is restored if the checkpoint belongs to the same stage, else the common
/// state.
///
/// # Errors
///
/// Fails if the checkpoint is damaged, belongs to another slot, or is rejected by the slot or its
/// stage. The slot is then unchanged.
pub fn resume<S: SlotProcessor>(slot: &mut S, record: &Checkpoint) -> Result<Resumed, ResumeError> {
    if record.service != Service::from(S::SLOT) as u32 {
        return Err(ResumeError::OtherSlot);
    }
    let mut before = Vec::new();
    slot.visit_own_state(&mut |word| before.push(*word));
    let resumed = restore_checkpoint(slot, record);
    if resumed.is_err() {
        // The number of words has just been read from the same slot, so this cannot fail.
        write_words(&before, |visit| slot.visit_own_state(visit))?;
    }
    resumed
}

/// Restores the slot's own state and the state of its stage.
///
/// After an error the slot's own state may have changed. The stage is unchanged, because it is
/// restored last and does not change if it rejects a state.
fn restore_checkpoint<S: SlotProcessor>(slot: &mut S, record: &Checkpoint) -> Result<Resumed, ResumeError> {
    let [own, common, numbers] = sections(record)?;
    write_words(own, |visit| slot.visit_own_state(visit))?;
    if slot.sequence().next_tick != record.next_tick {
        return Err(ResumeError::Damaged);
    }
    if let Some(fault) = slot.validation_error() {
        return Err(ResumeError::Invalid(fault));
    }
    if record.stage() == slot.stage().name() {
        let record = snapshot(slot.stage().name(), numbers)?;
        slot.stage_mut().restore(&record)?;
        return Ok(Resumed::Complete);
    }
    let mut shared = slot.stage().common();
    write_words(common, |visit| shared.visit(visit))?;
    if slot.is_initialised() {
        slot.stage_mut().adopt(&shared)?;
    }
    Ok(Resumed::Common)
}

/// Returns `common` with its words replaced by those of the common state in a checkpoint.
///
/// # Errors
///
/// Fails if the checkpoint is damaged.
pub fn common<C: StateWords>(record: &Checkpoint, mut common: C) -> Result<C, ResumeError> {
    let [_, words, _] = sections(record)?;
    write_words(words, |visit| common.visit(visit))?;
    Ok(common)
}

/// Splits a checkpoint into the words of the slot, of the common state and of the stage.
fn sections(record: &Checkpoint) -> Result<[&[u64]; 3], ResumeError> {
    let lens = [record.slot_words, record.common_words, record.stage_words].map(|len| len as usize);
    if record.checksum != record.compute_checksum() || lens.iter().any(|len| *len > CHECKPOINT_WORDS) {
        return Err(ResumeError::Damaged);
    }
    let (own, rest) = record.words.split_at_checked(lens[0]).ok_or(ResumeError::Damaged)?;
    let (common, rest) = rest.split_at_checked(lens[1]).ok_or(ResumeError::Damaged)?;
    Ok([own, common, rest.get(..lens[2]).ok_or(ResumeError::Damaged)?])
}

fn snapshot(stage: &'static str, numbers: &[u64]) -> Result<Snapshot, ResumeError> {
    let mut record = Snapshot { stage, values: [0.0; MAX_STATE_VALUES], len: numbers.len(), checksum: 0 };
    let values = record.values.get_mut(..numbers.len()).ok_or(ResumeError::Damaged)?;
    values.iter_mut().zip(numbers).for_each(|(value, word)| *value = f64::from_bits(*word));
    record.checksum = record.compute_checksum();
    Ok(record)
}

/// Replaces the words that `visit` passes to its callback with those in `words`. Fails if the two
/// numbers of words differ.
fn write_words(words: &[u64], visit: impl FnOnce(&mut dyn FnMut(&mut u64))) -> Result<(), ResumeError> {
    let mut next = 0;
    visit(&mut |word| {
        *word = words.get(next).copied().unwrap_or(*word);
        next += 1;
    });
    if next == words.len() { Ok(()) } else { Err(ResumeError::Damaged) }
}

/// Writer that drops words beyond its capacity, but still counts them.
struct WordWriter<'a> {
    words: &'a mut [u64; CHECKPOINT_WORDS],
    len: usize,
}

impl WordWriter<'_> {
    fn push(&mut self, word: u64) {
        if let Some(target) = self.words.get_mut(self.len) {
            *target = word;
        }
        self.len += 1;
    }
}
