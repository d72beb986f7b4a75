//! The state of a slot between two ticks, and how another process goes on from it.
//!
//! Input: a slot, or a checkpoint from anywhere. Output: a checkpoint, or a slot that goes on. Time: none. Failure: a checkpoint is
//! not trusted: one that does not fit leaves the slot as it was, with the reason.

use attitude::stage::{RestoreError, STATE_LIMIT, Snapshot, Stage};
use launch::Service;
use messages::{CHECKPOINT_WORDS, Checkpoint};

use crate::{slot::Slot, state_words::Words};

/// How much a slot took over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Resumed {
    /// Everything: it goes on bit for bit.
    Whole,
    /// What every stage of the slot can go on with: the checkpoint is of another stage.
    Common,
}

/// Why a slot did not go on from a checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ResumeError {
    /// It belongs to another slot.
    #[error("it is of another slot")]
    OtherSlot,
    /// Its words are not those that were recorded, or too many, or too few.
    #[error("its words are damaged or of another version")]
    Damaged,
    /// What the slot keeps beside its stage cannot be.
    #[error("it holds {0}")]
    Flaw(&'static str),
    /// The stage refuses the numbers.
    #[error(transparent)]
    Stage(#[from] RestoreError),
}

/// The checkpoint of a slot; `swapped` while its first output is to come that says that another stage than before has made it.
pub fn checkpoint<S: Slot>(slot: &mut S, service: Service, incarnation: u32, swapped: bool) -> Checkpoint {
    let mut record = Checkpoint {
        next_tick: slot.sequence().next_tick,
        service: service as u32,
        incarnation,
        swapped: swapped.into(),
        ..bytemuck::Zeroable::zeroed()
    };
    for (place, byte) in record.stage.iter_mut().zip(slot.stage().name().bytes()) {
        *place = byte;
    }
    let mut words = Writer { words: &mut record.words, len: 0 };
    slot.visit_own(&mut |word| words.push(*word));
    record.slot_words = words.len as u32;
    slot.stage().common().visit(&mut |word| words.push(*word));
    record.common_words = words.len as u32 - record.slot_words;
    let Snapshot { values, len, .. } = slot.stage().snapshot();
    values[..len].iter().for_each(|value| words.push(value.to_bits()));
    record.stage_words = len as u32;
    record.checksum = record.sum();
    record
}

/// Goes on from a checkpoint: bit for bit if it is of the same stage, else with what every stage can take over.
pub fn resume<S: Slot>(slot: &mut S, service: Service, record: &Checkpoint) -> Result<Resumed, ResumeError> {
    if record.service != service as u32 {
        return Err(ResumeError::OtherSlot);
    }
    let mut before = Vec::new();
    slot.visit_own(&mut |word| before.push(*word));
    let resumed = take_over(slot, record);
    if resumed.is_err() {
        // They are as many as were read.
        fill(&before, |visit| slot.visit_own(visit))?;
    }
    resumed
}

/// The same, but for the slot's own words, which stay where the stage or they themselves refuse. The stage comes last: a stage that refuses is as
/// it was.
fn take_over<S: Slot>(slot: &mut S, record: &Checkpoint) -> Result<Resumed, ResumeError> {
    let [own, common, numbers] = parts(record)?;
    fill(own, |visit| slot.visit_own(visit))?;
    if slot.sequence().next_tick != record.next_tick {
        return Err(ResumeError::Damaged);
    }
    if let Some(flaw) = slot.own_flaw() {
        return Err(ResumeError::Flaw(flaw));
    }
    if record.stage() == slot.stage().name() {
        let record = snapshot(slot.stage().name(), numbers)?;
        slot.stage_mut().restore(&record)?;
        return Ok(Resumed::Whole);
    }
    let mut shared = slot.stage().common();
    fill(common, |visit| shared.visit(visit))?;
    if slot.has_begun() {
        slot.stage_mut().adopt(&shared)?;
    }
    Ok(Resumed::Common)
}

/// What every stage of the slot can go on with, in the place of what `common` holds.
pub fn common<C: Words>(record: &Checkpoint, mut common: C) -> Result<C, ResumeError> {
    let [_, words, _] = parts(record)?;
    fill(words, |visit| common.visit(visit))?;
    Ok(common)
}

/// The words of the slot's own, those that are common to its stages, and those of the stage.
fn parts(record: &Checkpoint) -> Result<[&[u64]; 3], ResumeError> {
    let lens = [record.slot_words, record.common_words, record.stage_words].map(|len| len as usize);
    if record.checksum != record.sum() || lens.iter().any(|len| *len > CHECKPOINT_WORDS) {
        return Err(ResumeError::Damaged);
    }
    let (own, rest) = record.words.split_at_checked(lens[0]).ok_or(ResumeError::Damaged)?;
    let (common, rest) = rest.split_at_checked(lens[1]).ok_or(ResumeError::Damaged)?;
    Ok([own, common, rest.get(..lens[2]).ok_or(ResumeError::Damaged)?])
}

fn snapshot(stage: &'static str, numbers: &[u64]) -> Result<Snapshot, ResumeError> {
    let mut record = Snapshot { stage, values: [0.0; STATE_LIMIT], len: numbers.len(), checksum: 0 };
    let values = record.values.get_mut(..numbers.len()).ok_or(ResumeError::Damaged)?;
    values.iter_mut().zip(numbers).for_each(|(value, word)| *value = f64::from_bits(*word));
    record.checksum = record.sum();
    Ok(record)
}

/// Puts words into what `visit` visits; they must be as many.
fn fill(words: &[u64], visit: impl FnOnce(&mut dyn FnMut(&mut u64))) -> Result<(), ResumeError> {
    let mut next = 0;
    visit(&mut |word| {
        *word = words.get(next).copied().unwrap_or(*word);
        next += 1;
    });
    if next == words.len() { Ok(()) } else { Err(ResumeError::Damaged) }
}

/// Writes words as far as there is room.
struct Writer<'a> {
    words: &'a mut [u64; CHECKPOINT_WORDS],
    len: usize,
}

impl Writer<'_> {
    fn push(&mut self, word: u64) {
        if let Some(place) = self.words.get_mut(self.len) {
            *place = word;
        }
        self.len += 1;
    }
}
