//! Network format of records: a header followed by contiguous records, which are copied bit for
//! bit.
//!
//! Both hosts run the same program, so layouts are only compared, not translated. Frames from the
//! network are validated before use.

use foreign::ForeignText;
use launch::MAX_CACHE_TICKS;
use serde::{Deserialize, Serialize};

use super::record::{Record, index_of, message_header, topics_in};

/// Maximum size of a frame, in bytes.
pub const MAX_FRAME_BYTES: usize = 1 << 20;
/// Size in bytes that completes a frame. Records are added until their total size reaches it, so a
/// frame may be larger.
pub const RECORDS_TARGET_BYTES: usize = 64 * 1024;

/// Header of a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameHeader {
    /// Identifier of the exporting system's run. Ticks count from the start of the run.
    pub run: u64,
    /// Tick rate, Hz.
    pub rate_hz: f64,
    /// Names of the exported topics, in the order of their messages in a record, with the
    /// fingerprints of their layouts.
    pub topics: Vec<(String, u64)>,
    /// Oldest tick that the exporter caches.
    pub oldest_tick: u64,
    /// Tick after the newest one that the exporter caches.
    pub next_tick: u64,
    /// Tick of the first record.
    pub first_tick: u64,
}

/// Header and contiguous records.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Header of the frame.
    pub header: FrameHeader,
    /// Records from [`FrameHeader::first_tick`] on.
    pub records: Vec<Record>,
}

/// Reason for rejecting bytes as a frame.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The bytes are not a valid frame.
    #[error("cannot decode carried frame: {what}")]
    Malformed {
        /// Description of the fault.
        what: &'static str,
    },
    /// A topic has a different layout on the other host.
    #[error(
        "cannot decode carried frame: topic `{topic}` has layout {remote:016x} on the other host, {local:016x} on this one; run the same version of plumb on both hosts"
    )]
    Layout {
        /// Name of the topic.
        topic: ForeignText,
        /// Fingerprint on this host; 0 if the topic is unknown.
        local: u64,
        /// Fingerprint on the other host.
        remote: u64,
    },
}

impl FrameHeader {
    /// Returns the exported topics as a mask.
    pub fn mask(&self) -> u8 {
        self.topics.iter().filter_map(|(topic, _)| index_of(topic)).fold(0, |mask, index| mask | 1 << index)
    }
}

impl Frame {
    /// Encodes as many records as fit into a frame. Returns the bytes and the tick after the last
    /// record.
    pub fn encode<'r>(header: &FrameHeader, records: impl Iterator<Item = &'r Record>) -> (Vec<u8>, u64) {
        // The header contains only strings and numbers, which can always be serialised.
        let text = serde_json::to_vec(header).unwrap_or_default();
        let mut bytes = (text.len() as u32).to_le_bytes().to_vec();
        bytes.extend_from_slice(&text);
        let (end, mut next_tick) = (bytes.len() + RECORDS_TARGET_BYTES, header.first_tick);
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

    /// Decodes and validates a frame.
    ///
    /// # Errors
    ///
    /// Returns an error if the bytes are not a valid frame or a topic has a different layout.
    pub fn decode(bytes: &[u8]) -> Result<Self, FrameError> {
        let malformed = |what| FrameError::Malformed { what };
        if bytes.len() > MAX_FRAME_BYTES {
            return Err(malformed("it exceeds the maximum size"));
        }
        let (length, rest) = bytes.split_first_chunk().ok_or_else(|| malformed("the header is missing"))?;
        let length = u32::from_le_bytes(*length) as usize;
        let (text, mut rest) = rest.split_at_checked(length).ok_or_else(|| malformed("the header is truncated"))?;
        let header: FrameHeader =
            serde_json::from_slice(text).map_err(|_| malformed("the header is not valid JSON"))?;
        check_layouts(&header)?;
        let mask = header.mask();
        let (mut records, mut tick) = (Vec::new(), header.first_tick);
        while let Some((record_mask, after)) = rest.split_first() {
            if record_mask & !mask != 0 {
                return Err(malformed("a record has a topic that the header does not list"));
            }
            let length = topics_in(*record_mask).map(|(_, topic)| topic.size).sum();
            let (messages, after) = after.split_at_checked(length).ok_or_else(|| malformed("a record is truncated"))?;
            let record = Record { tick, mask: *record_mask, bytes: messages.to_vec() };
            check_record(&record)?;
            records.push(record);
            tick = tick.checked_add(1).ok_or_else(|| malformed("the tick number overflows"))?;
            rest = after;
        }
        let cached_ticks = header.next_tick.checked_sub(header.oldest_tick);
        let is_within_cache = header.oldest_tick <= header.first_tick && tick <= header.next_tick;
        if !is_within_cache || cached_ticks.is_none_or(|ticks| ticks > MAX_CACHE_TICKS as u64) {
            return Err(malformed("the records are outside the range of cached ticks in the header"));
        }
        Ok(Self { header, records })
    }
}

fn check_layouts(header: &FrameHeader) -> Result<(), FrameError> {
    for (topic, remote) in &header.topics {
        let known = topics_in(u8::MAX).find(|(_, known)| known.name == topic);
        let local = known.map_or(0, |(_, known)| known.fingerprint);
        if local != *remote {
            return Err(FrameError::Layout { topic: topic.as_str().into(), local, remote: *remote });
        }
    }
    Ok(())
}

/// Checks that every message has the tick of the record and a non-negative interval.
fn check_record(record: &Record) -> Result<(), FrameError> {
    let is_valid = |(_, message)| {
        message_header(message).is_some_and(|header| {
            let length = header.t_end_ns.checked_sub(header.t_start_ns);
            header.tick == record.tick && length.is_some_and(|length_ns| length_ns >= 0)
        })
    };
    if record.messages().all(is_valid) {
        return Ok(());
    }
    Err(FrameError::Malformed { what: "a message has another tick or a negative interval" })
}
