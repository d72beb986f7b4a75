//! Frames in bytes that are cut anywhere and may be anything.
//!
//! Input: bytes. Output: what a [`Format`] makes of each frame. Failure: where no frame begins, one byte is passed over and the next is
//! looked at, so a good frame inside or behind what is none is found; what comes out depends on the bytes alone and not on how they
//! were cut.

use crate::{Counts, Decoder, Measurement};

/// How frames of a format look.
pub trait Format: Send {
    /// What the bytes from the first one on are, of which there is at least one; what a frame tells goes to `found`. Must say
    /// [`Seen::More`] for fewer bytes than a frame has at most, no more.
    fn look(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) -> Seen;

    /// So many bytes were passed over since the last call of [`Format::look`] that saw a frame.
    fn passed(&mut self, _bytes: usize) {}
}

/// What bytes are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seen {
    /// The beginning of a frame, as far as they go.
    More,
    /// A frame of so many bytes.
    Frame(usize),
    /// The first so many belong to no frame.
    Nothing(usize),
    /// The first byte begins what looks like a frame and is none: checksum, length, a number that is none.
    Refused,
    /// The first so many are a line that is none.
    RefusedLine(usize),
}

/// Bytes of one device with frames of one format in them. A new connection is a new one of these, so that no half of a frame meets
/// another half.
#[derive(Debug, Clone)]
pub struct Framed<F> {
    format: F,
    kept: Vec<u8>,
    counts: Counts,
}

impl<F: Format> Framed<F> {
    /// Nothing was sent yet.
    pub fn new(format: F) -> Self {
        Self { format, kept: Vec::new(), counts: Counts::default() }
    }

    fn pass(&mut self, bytes: usize) {
        self.counts.skipped_bytes += bytes as u64;
        self.format.passed(bytes);
    }
}

impl<F: Format> Decoder for Framed<F> {
    fn push(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) {
        self.kept.extend_from_slice(bytes);
        let mut kept = std::mem::take(&mut self.kept);
        let mut at = 0;
        while at < kept.len() {
            let length = match self.format.look(&kept[at..], found) {
                Seen::More => break,
                Seen::Frame(length) => {
                    self.counts.frames += 1;
                    length
                }
                Seen::Nothing(length) => {
                    self.pass(length);
                    length
                }
                Seen::Refused => {
                    self.counts.refused += 1;
                    self.pass(1);
                    1
                }
                Seen::RefusedLine(length) => {
                    self.counts.refused += 1;
                    self.pass(length);
                    length
                }
            };
            // A frame is at least a byte, and no longer than what was looked at.
            at = (at + length.max(1)).min(kept.len());
        }
        kept.drain(..at);
        self.kept = kept;
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}

/// The three little-endian numbers of 16 bits from `at` on; `None` beyond the end.
pub(crate) fn three_i16(bytes: &[u8], at: usize) -> Option<[f64; 3]> {
    let mut three = [0.0; 3];
    for (part, pair) in three.iter_mut().zip(bytes.get(at..at + 6)?.as_chunks::<2>().0) {
        *part = f64::from(i16::from_le_bytes(*pair));
    }
    Some(three)
}

/// The sum of bytes, as far as one holds it.
pub(crate) fn sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}
