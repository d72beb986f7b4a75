//! Frames exchanged between the service of a slot and an external stage.
//!
//! Input, output: one request or response per packet of a `SOCK_SEQPACKET` socket pair. The program
//! uses its standard input as its end of the pair.
//!
//! Time: a program responds to each request before it reads the next one.
//!
//! Failure: an invalid frame or a payload of the wrong length is rejected.
//!
//! A frame consists of a header of 16 bytes and a payload, all little-endian:
//!
//! | bytes | contents |
//! | --- | --- |
//! | 0–1 | [`VERSION`] |
//! | 2–3 | [`RequestKind`], repeated in the response |
//! | 4–7 | 1 in a response that rejects the request, otherwise 0 |
//! | 8–15 | number of the request, repeated in the response |
//! | 16– | payload: `f64` numbers in [`Scalars`] order, or text in a response to `Describe` |

use attitude::scalars::Scalars;

/// Version of the frame format.
pub const VERSION: u16 = 2;
/// Length of the header, bytes.
pub const HEADER_BYTES: usize = 16;
/// Maximum length of a frame, bytes.
pub const MAX_FRAME_BYTES: usize = 16_384;
/// Status of a response that rejects the request.
const REJECTED: u32 = 1;

/// Kind of a request. The description of each variant ends with its payloads, request → response.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
pub enum RequestKind {
    /// Requests the [`Description`](crate::Description). Empty → text.
    Describe = 1,
    /// Sets a parameter, given by its index in the description, to a value. Two numbers → empty, or
    /// rejected.
    Set = 2,
    /// Processes one tick. Input of the slot → output of the slot.
    Step = 3,
    /// Requests the state. Empty → a fixed-length list of numbers.
    Snapshot = 4,
    /// Restores a state. Numbers of a snapshot → empty, or rejected.
    Restore = 5,
    /// Requests the common state. Empty → common state of the slot.
    Common = 6,
    /// Adopts the common state of another stage. Common state of the slot → empty, or rejected.
    Adopt = 7,
    /// Sets the attitude from which to integrate (gyro only). Attitude → empty.
    Align = 8,
    /// Re-initialises the level from the next inclination (fuser only). Empty → empty.
    Realign = 9,
}

impl RequestKind {
    const ALL: [Self; 9] = [
        Self::Describe,
        Self::Set,
        Self::Step,
        Self::Snapshot,
        Self::Restore,
        Self::Common,
        Self::Adopt,
        Self::Align,
        Self::Realign,
    ];
}

/// Error in a frame or its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The frame is shorter than a header.
    #[error("the frame has {0} bytes, expected at least {HEADER_BYTES}")]
    TooShort(usize),
    /// The frame has an unsupported version.
    #[error(
        "the frame has version {0}, expected {VERSION}; update the stage's package or header with `plumb stage new`"
    )]
    UnsupportedVersion(u16),
    /// The request kind is unknown.
    #[error("unknown request kind {0}")]
    UnknownKind(u16),
    /// The response is for a different request.
    #[error("the response is to request {found} ({kind:?}), expected {expected}")]
    RequestMismatch {
        /// Request number that the response repeats.
        found: u64,
        /// Request kind that the response repeats.
        kind: RequestKind,
        /// Number of the pending request.
        expected: u64,
    },
    /// The payload has the wrong length.
    #[error("the payload has {found} bytes, expected {expected}")]
    PayloadLength {
        /// Length of the payload, bytes.
        found: usize,
        /// Expected length, bytes.
        expected: usize,
    },
}

/// Header of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameHeader {
    /// Kind of the request.
    pub kind: RequestKind,
    /// `true` if the response rejects the request.
    pub rejected: bool,
    /// Number of the request.
    pub request_number: u64,
}

impl FrameHeader {
    /// Splits a frame into header and payload.
    ///
    /// # Errors
    ///
    /// Returns a [`FrameError`] if the frame is too short, has an unsupported version or has an
    /// unknown kind.
    pub fn parse(frame: &[u8]) -> Result<(Self, &[u8]), FrameError> {
        let Some((&[v0, v1, k0, k1, s0, s1, s2, s3, ref number @ ..], payload)) =
            frame.split_first_chunk::<HEADER_BYTES>()
        else {
            return Err(FrameError::TooShort(frame.len()));
        };
        let (version, kind) = (u16::from_le_bytes([v0, v1]), u16::from_le_bytes([k0, k1]));
        if version != VERSION {
            return Err(FrameError::UnsupportedVersion(version));
        }
        let kind =
            RequestKind::ALL.into_iter().find(|known| *known as u16 == kind).ok_or(FrameError::UnknownKind(kind))?;
        let rejected = u32::from_le_bytes([s0, s1, s2, s3]) == REJECTED;
        Ok((Self { kind, rejected, request_number: u64::from_le_bytes(*number) }, payload))
    }

    /// Replaces the contents of `bytes` with this header.
    pub fn start_frame(self, bytes: &mut Vec<u8>) {
        bytes.clear();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend((self.kind as u16).to_le_bytes());
        bytes.extend(if self.rejected { REJECTED } else { 0 }.to_le_bytes());
        bytes.extend(self.request_number.to_le_bytes());
    }
}

/// Appends a value to a frame.
pub fn write_value(bytes: &mut Vec<u8>, mut value: impl Scalars) {
    value.visit(&mut |number| bytes.extend(number.to_le_bytes()));
}

/// Reads a value that occupies the entire payload.
///
/// # Errors
///
/// Returns [`FrameError::PayloadLength`] if the payload is shorter or longer than the value.
pub fn read_value<T: Scalars + Default>(payload: &[u8]) -> Result<T, FrameError> {
    let (mut value, mut next) = (T::default(), 0);
    let (numbers, rest) = payload.as_chunks();
    value.visit(&mut |number| {
        *number = numbers.get(next).map_or(f64::NAN, |bytes| f64::from_le_bytes(*bytes));
        next += 1;
    });
    let expected = 8 * next;
    if rest.is_empty() && payload.len() == expected {
        Ok(value)
    } else {
        Err(FrameError::PayloadLength { found: payload.len(), expected })
    }
}

/// Returns the numbers of a payload, or `None` if its length is not a multiple of 8.
pub fn read_numbers(payload: &[u8]) -> Option<impl Iterator<Item = f64>> {
    let (numbers, rest) = payload.as_chunks();
    rest.is_empty().then(|| numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use attitude::fuser::{Estimate, FuserInput};

    #[test]
    fn frame_round_trips() {
        let header = FrameHeader { kind: RequestKind::Adopt, rejected: true, request_number: u64::MAX - 1 };
        let mut bytes = vec![9; 3];
        header.start_frame(&mut bytes);
        write_value(&mut bytes, Estimate::UNKNOWN);
        assert_eq!(bytes[..8], [2, 0, 7, 0, 1, 0, 0, 0]);
        let (found, payload) = FrameHeader::parse(&bytes).unwrap();
        assert_eq!((found, read_value::<Estimate>(payload)), (header, Ok(Estimate::UNKNOWN)));
    }

    #[test]
    fn invalid_frame_is_rejected_with_its_error() {
        let mut bytes = Vec::new();
        FrameHeader { kind: RequestKind::Step, rejected: false, request_number: 1 }.start_frame(&mut bytes);
        assert_eq!(FrameHeader::parse(&bytes[..15]), Err(FrameError::TooShort(15)));
        let with = |index: usize, byte: u8| {
            let mut bytes = bytes.clone();
            bytes[index] = byte;
            FrameHeader::parse(&bytes).map(|_| ())
        };
        assert_eq!(with(0, 1), Err(FrameError::UnsupportedVersion(1)));
        assert_eq!(with(2, 77), Err(FrameError::UnknownKind(77)));
        for found in [0, 7, 8, 1000] {
            let short = read_value::<FuserInput>(&vec![0; found]);
            assert!(
                matches!(short, Err(FrameError::PayloadLength { found: length, .. }) if length == found),
                "{short:?}"
            );
        }
    }
}
