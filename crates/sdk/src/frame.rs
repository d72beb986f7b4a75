//! The frames between a slot's service and a stage that is a program of its own.
//!
//! Input, output: one request or answer is one packet of a `SOCK_SEQPACKET` pair; the program has its end as standard input. Time: none; a
//! program answers each request before the next. Failure: what is not a frame, or not as long as its kind says, is refused.
//!
//! A frame is a head of 16 bytes and a payload, all of it little-endian:
//!
//! | bytes | what |
//! | --- | --- |
//! | 0–1 | [`VERSION`] |
//! | 2–3 | the [`Kind`]; an answer has that of its request |
//! | 4–7 | 0, or in an answer 1: refused |
//! | 8–15 | which request this is, or which it answers |
//! | 16– | the payload: numbers as `f64`, in the order of [`Scalars`]; of an answer to `Describe`, text |

use attitude::scalars::Scalars;

/// The version of all that is said here.
pub const VERSION: u16 = 2;
/// Bytes before the payload.
pub const HEAD_BYTES: usize = 16;
/// Bytes of a frame at most.
pub const MAX_FRAME_BYTES: usize = 16_384;
/// The status of an answer that takes nothing over.
const REFUSED: u32 = 1;

/// What a request asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
pub enum Kind {
    /// What the stage is: see [`Description`](crate::Description). Nothing → text.
    Describe = 1,
    /// Sets a parameter, by its place in the description and its value. Two numbers → nothing, or refused.
    Set = 2,
    /// One tick. The slot's input → its output.
    Step = 3,
    /// The state. Nothing → always as many numbers.
    Snapshot = 4,
    /// Takes a state over. Numbers of a snapshot → nothing, or refused.
    Restore = 5,
    /// What every stage of the slot can go on with. Nothing → the slot's common state.
    Common = 6,
    /// Goes on from where another stage was. The slot's common state → nothing, or refused.
    Adopt = 7,
    /// Of a gyro: integrates from here on. An attitude → nothing.
    Align = 8,
    /// Of a fuser: the next inclination sets the level anew. Nothing → nothing.
    Realign = 9,
}

impl Kind {
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

/// What is wrong with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// It has no head.
    #[error("{0} bytes, and a frame has at least {HEAD_BYTES}")]
    Short(usize),
    /// It is of another version.
    #[error("frames of version {0}, this is version {VERSION}; write the stage's package or header anew")]
    Version(u16),
    /// There is no such kind.
    #[error("a frame of the kind {0}, which is none")]
    Kind(u16),
    /// It answers something else.
    #[error("an answer to the request {found} of the kind {kind:?}, expected {expected}")]
    Other {
        /// What it answers.
        found: u64,
        /// Of which kind.
        kind: Kind,
        /// What it should have answered.
        expected: u64,
    },
    /// It has another number of numbers.
    #[error("a payload of {found} bytes, expected {expected}")]
    Length {
        /// Bytes.
        found: usize,
        /// Bytes that the kind has.
        expected: usize,
    },
}

/// The head of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Head {
    /// What is asked for.
    pub kind: Kind,
    /// The answer takes nothing over.
    pub refused: bool,
    /// Which request this is.
    pub number: u64,
}

impl Head {
    /// Takes a frame apart.
    pub fn of(frame: &[u8]) -> Result<(Self, &[u8]), FrameError> {
        let Some((&[v0, v1, k0, k1, s0, s1, s2, s3, ref number @ ..], payload)) =
            frame.split_first_chunk::<HEAD_BYTES>()
        else {
            return Err(FrameError::Short(frame.len()));
        };
        let (version, kind) = (u16::from_le_bytes([v0, v1]), u16::from_le_bytes([k0, k1]));
        if version != VERSION {
            return Err(FrameError::Version(version));
        }
        let kind = Kind::ALL.into_iter().find(|known| *known as u16 == kind).ok_or(FrameError::Kind(kind))?;
        let refused = u32::from_le_bytes([s0, s1, s2, s3]) == REFUSED;
        Ok((Self { kind, refused, number: u64::from_le_bytes(*number) }, payload))
    }

    /// Begins a frame in `bytes`, in the place of what was there.
    pub fn begin(self, bytes: &mut Vec<u8>) {
        bytes.clear();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend((self.kind as u16).to_le_bytes());
        bytes.extend(if self.refused { REFUSED } else { 0 }.to_le_bytes());
        bytes.extend(self.number.to_le_bytes());
    }
}

/// Puts a value at the end of a frame.
pub fn put(bytes: &mut Vec<u8>, mut value: impl Scalars) {
    value.visit(&mut |number| bytes.extend(number.to_le_bytes()));
}

/// The value that a payload is.
pub fn value<T: Scalars + Default>(payload: &[u8]) -> Result<T, FrameError> {
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
        Err(FrameError::Length { found: payload.len(), expected })
    }
}

/// The numbers that a payload is; `None` where it is none.
pub fn numbers(payload: &[u8]) -> Option<impl Iterator<Item = f64>> {
    let (numbers, rest) = payload.as_chunks();
    rest.is_empty().then(|| numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use attitude::fuser::{Estimate, FuserInput};

    #[test]
    fn a_frame_comes_apart_into_what_it_was_made_of() {
        let head = Head { kind: Kind::Adopt, refused: true, number: u64::MAX - 1 };
        let mut bytes = vec![9; 3];
        head.begin(&mut bytes);
        put(&mut bytes, Estimate::UNKNOWN);
        assert_eq!(bytes[..8], [2, 0, 7, 0, 1, 0, 0, 0]);
        let (found, payload) = Head::of(&bytes).unwrap();
        assert_eq!((found, value::<Estimate>(payload)), (head, Ok(Estimate::UNKNOWN)));
    }

    #[test]
    fn what_is_no_frame_is_refused_with_what_is_wrong() {
        let mut bytes = Vec::new();
        Head { kind: Kind::Step, refused: false, number: 1 }.begin(&mut bytes);
        assert_eq!(Head::of(&bytes[..15]), Err(FrameError::Short(15)));
        let with = |place: usize, byte: u8| {
            let mut bytes = bytes.clone();
            bytes[place] = byte;
            Head::of(&bytes).map(|_| ())
        };
        assert_eq!(with(0, 1), Err(FrameError::Version(1)));
        assert_eq!(with(2, 77), Err(FrameError::Kind(77)));
        for found in [0, 7, 8, 1000] {
            let short = value::<FuserInput>(&vec![0; found]);
            assert!(matches!(short, Err(FrameError::Length { found: there, .. }) if there == found), "{short:?}");
        }
    }
}
