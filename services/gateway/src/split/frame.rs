//! Records on the wire: a head that says what they are, and runs of records, bit for bit.
//!
//! The two ends are the same program, so the layouts are compared and not translated. What comes from elsewhere is checked before
//! anything is made of it.

use launch::CACHE_TICKS_MAX;
use serde::{Deserialize, Serialize};

use super::record::{Record, header, place, places};

/// A frame at most, bytes.
pub const FRAME_BYTES_MAX: usize = 1 << 20;
/// Records of a frame stay below this, bytes; one more may begin.
pub const RECORDS_BYTES: usize = 64 * 1024;

/// What a frame says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// The run of the exporting system: its ticks are counted from its start.
    pub run: u64,
    /// Ticks per second, Hz.
    pub rate_hz: f64,
    /// The exported topics in their order, each with the fingerprint of its layout.
    pub topics: Vec<(String, u64)>,
    /// The oldest tick that the exporter still keeps.
    pub oldest_tick: u64,
    /// The tick after the newest that it has.
    pub next_tick: u64,
    /// The tick of the first record.
    pub first_tick: u64,
}

/// Contiguous records.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// What it says of itself.
    pub head: Head,
    /// From [`Head::first_tick`] on.
    pub records: Vec<Record>,
}

/// Why bytes are no frame.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// They are none.
    #[error("reading what was carried: {what}")]
    Malformed {
        /// What is wrong.
        what: &'static str,
    },
    /// The other program has another layout.
    #[error(
        "reading what was carried: the topic `{topic}` has the layout {there:016x} there and {here:016x} here; run one version of plumb on both hosts"
    )]
    Layout {
        /// The topic.
        topic: String,
        /// The fingerprint here.
        here: u64,
        /// The fingerprint there.
        there: u64,
    },
}

impl Head {
    /// The exported topics as bits.
    pub fn mask(&self) -> u8 {
        self.topics.iter().filter_map(|(topic, _)| place(topic)).fold(0, |mask, place| mask | 1 << place)
    }
}

impl Frame {
    /// The bytes of as many records as a frame takes, and the tick after the last of them.
    pub fn encode<'r>(head: &Head, records: impl Iterator<Item = &'r Record>) -> (Vec<u8>, u64) {
        // Names and numbers always serialise.
        let text = serde_json::to_vec(head).unwrap_or_default();
        let mut bytes = (text.len() as u32).to_le_bytes().to_vec();
        bytes.extend_from_slice(&text);
        let (end, mut next_tick) = (bytes.len() + RECORDS_BYTES, head.first_tick);
        for record in records {
            bytes.push(record.mask);
            bytes.extend_from_slice(&record.bytes);
            next_tick = record.tick + 1;
            if bytes.len() >= end {
                break;
            }
        }
        (bytes, next_tick)
    }

    /// The frame that the bytes are.
    pub fn decode(bytes: &[u8]) -> Result<Self, FrameError> {
        let malformed = |what| FrameError::Malformed { what };
        if bytes.len() > FRAME_BYTES_MAX {
            return Err(malformed("it is too long"));
        }
        let (length, rest) = bytes.split_first_chunk().ok_or_else(|| malformed("it has no head"))?;
        let length = u32::from_le_bytes(*length) as usize;
        let (text, mut rest) = rest.split_at_checked(length).ok_or_else(|| malformed("its head is cut off"))?;
        let head: Head = serde_json::from_slice(text).map_err(|_| malformed("its head is none"))?;
        check_layouts(&head)?;
        let mask = head.mask();
        let (mut records, mut tick) = (Vec::new(), head.first_tick);
        while let Some((its_mask, after)) = rest.split_first() {
            if its_mask & !mask != 0 {
                return Err(malformed("a tick has a topic that the head does not name"));
            }
            let length = places(*its_mask).map(|(_, topic)| topic.size).sum();
            let (messages, after) = after.split_at_checked(length).ok_or_else(|| malformed("a tick is cut off"))?;
            let record = Record { tick, mask: *its_mask, bytes: messages.to_vec() };
            check_record(&record)?;
            records.push(record);
            tick = tick.checked_add(1).ok_or_else(|| malformed("its ticks have no end"))?;
            rest = after;
        }
        let kept_ticks = head.next_tick.checked_sub(head.oldest_tick);
        let within = head.oldest_tick <= head.first_tick && tick <= head.next_tick;
        if !within || kept_ticks.is_none_or(|kept_ticks| kept_ticks > CACHE_TICKS_MAX as u64) {
            return Err(malformed("its ticks are not among those that it says are kept"));
        }
        Ok(Self { head, records })
    }
}

fn check_layouts(head: &Head) -> Result<(), FrameError> {
    for (topic, there) in &head.topics {
        let known = places(u8::MAX).find(|(_, known)| known.name == topic);
        let here = known.map_or(0, |(_, known)| known.fingerprint);
        if here != *there {
            return Err(FrameError::Layout { topic: topic.clone(), here, there: *there });
        }
    }
    Ok(())
}

/// Every message is of the record's tick, over an interval that is one.
fn check_record(record: &Record) -> Result<(), FrameError> {
    let is_one = |(_, message)| {
        header(message).is_some_and(|header| {
            let length = header.t_end_ns.checked_sub(header.t_start_ns);
            header.tick == record.tick && length.is_some_and(|length_ns| length_ns >= 0)
        })
    };
    if record.messages().all(is_one) {
        return Ok(());
    }
    Err(FrameError::Malformed { what: "a message is of another tick, or ends before it begins" })
}
