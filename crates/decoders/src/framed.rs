//! Search for frames in a byte stream that may be split anywhere and may contain garbage.
//!
//! Input: bytes.
//!
//! Output: the measurements that a [`Format`] extracts from each frame. The result does not depend
//! on how the bytes were split.
//!
//! Failure: if no frame starts at a byte, that byte is skipped and the search continues at the next
//! one. A valid frame inside or after an invalid one is therefore still found.

use std::time::Duration;

use crate::{Counts, Decoder, Measurement};

/// Frame format of a device.
pub trait Format: Send {
    /// Parses the frame at the start of `bytes`, which is not empty, and appends its measurements.
    ///
    /// Must return [`ParseOutcome::Incomplete`] only if `bytes` is shorter than the longest
    /// possible frame.
    fn parse(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) -> ParseOutcome;

    /// Sets the arrival time of the bytes that follow, relative to any fixed instant.
    fn set_time(&mut self, _now: Duration) {}

    /// Notifies the format that `bytes` bytes were skipped between two frames.
    fn on_skipped(&mut self, _bytes: usize) {}
}

/// Result of [`Format::parse`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ParseOutcome {
    /// The bytes are the start of a frame that is not complete yet.
    Incomplete,
    /// The bytes start with a complete frame of the given length.
    Frame(usize),
    /// The bytes start with a complete frame of the given length. Its measurement is not used,
    /// because it comes from a sender that is not decoded.
    Foreign(usize),
    /// The given number of leading bytes belongs to no frame.
    Skip(usize),
    /// The bytes start like a frame, but its checksum, length or content is invalid. One byte is
    /// skipped.
    Rejected,
    /// The given number of leading bytes forms one invalid line or record, which is skipped.
    RejectedUnit(usize),
    /// The given number of leading bytes forms a line that is skipped, because the first number of
    /// its date may be the month or the day.
    AmbiguousDate(usize),
}

/// Decoder of the frames of one format from one device.
///
/// Create a new instance for each connection, so that no partial frames of two connections are
/// joined.
#[derive(Debug, Clone)]
pub struct Framed<F> {
    format: F,
    buffer: Vec<u8>,
    counts: Counts,
}

impl<F: Format> Framed<F> {
    /// Creates a decoder with an empty buffer.
    pub fn new(format: F) -> Self {
        Self { format, buffer: Vec::new(), counts: Counts::default() }
    }

    fn skip(&mut self, bytes: usize) {
        self.counts.skipped_bytes += bytes as u64;
        self.format.on_skipped(bytes);
    }
}

impl<F: Format> Decoder for Framed<F> {
    fn push(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) {
        self.buffer.extend_from_slice(bytes);
        let mut buffer = std::mem::take(&mut self.buffer);
        let mut position = 0;
        while position < buffer.len() {
            let length = match self.format.parse(&buffer[position..], measurements) {
                ParseOutcome::Incomplete => break,
                ParseOutcome::Frame(length) => {
                    self.counts.frames += 1;
                    length
                }
                ParseOutcome::Foreign(length) => {
                    self.counts.frames += 1;
                    self.counts.foreign += 1;
                    length
                }
                ParseOutcome::Skip(length) => {
                    self.skip(length);
                    length
                }
                ParseOutcome::Rejected => {
                    self.counts.rejected += 1;
                    self.skip(1);
                    1
                }
                ParseOutcome::RejectedUnit(length) => {
                    self.counts.rejected += 1;
                    self.skip(length);
                    length
                }
                ParseOutcome::AmbiguousDate(length) => {
                    self.counts.rejected += 1;
                    self.counts.ambiguous_dates += 1;
                    self.skip(length);
                    length
                }
            };
            // A faulty length must neither stall the loop nor exceed the buffer.
            position = (position + length.max(1)).min(buffer.len());
        }
        buffer.drain(..position);
        self.buffer = buffer;
    }

    fn set_time(&mut self, now: Duration) {
        self.format.set_time(now);
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}

/// Returns three little-endian `i16` values starting at `offset`, or `None` if `bytes` is too
/// short.
pub(crate) fn three_i16(bytes: &[u8], offset: usize) -> Option<[f64; 3]> {
    let mut three = [0.0; 3];
    for (part, pair) in three.iter_mut().zip(bytes.get(offset..offset + 6)?.as_chunks::<2>().0) {
        *part = f64::from(i16::from_le_bytes(*pair));
    }
    Some(three)
}

/// Returns the sum of `bytes` modulo 256.
pub(crate) fn wrapping_sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}
