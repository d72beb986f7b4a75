//! Choice of one sender of datagrams, with a decoder for each sender that may be chosen.
//!
//! Input: datagrams.
//!
//! Output: the measurements of the chosen sender. A sender is chosen if it sends a required
//! measurement while no other sender is chosen, see [`SenderChoice`].
//!
//! Memory: the decoders of [`MAX_SENDERS`] senders.
//!
//! Time: supplied by the caller.

use std::{net::SocketAddr, time::Duration};

use decoders::{Counts, Decoder, Measurement, SenderChoice, Value};

use crate::{error::DriversError, stream_preamble};

/// Maximum number of senders that are decoded while none is chosen. A further one replaces the
/// sender that has been silent for longest.
const MAX_SENDERS: usize = 8;
/// Newline that is appended to the text of a datagram, because its last line may lack one.
const LINE_END: &[u8] = b"\n";

/// Decoders of the senders that may be chosen.
#[derive(Default)]
pub(crate) struct SenderDecoders {
    choice: SenderChoice<SocketAddr>,
    candidates: Vec<Candidate>,
    /// Totals of the decoders that have been removed.
    removed_counts: Counts,
}

/// Sender that may be chosen.
struct Candidate {
    sender: SocketAddr,
    decoder: Box<dyn Decoder>,
    /// Beginning of the text received from this sender; empty if the format is not text.
    text: Vec<u8>,
    last_datagram: Duration,
}

/// Properties of the format of the datagrams.
pub(crate) struct DatagramFormat<'a> {
    /// Creates the decoder of a sender.
    pub(crate) make_decoder: &'a dyn Fn() -> Result<Box<dyn Decoder>, DriversError>,
    /// Returns `true` for a measurement that the device is required to provide.
    pub(crate) is_required: fn(&Value) -> bool,
    /// `true` for lines of text.
    pub(crate) is_text: bool,
}

impl SenderDecoders {
    /// Returns `true` unless another sender is chosen.
    pub(crate) fn admits(&self, sender: SocketAddr, now: Duration) -> bool {
        self.choice.admits(sender, now)
    }

    pub(crate) fn counts(&self) -> Counts {
        self.candidates.iter().fold(self.removed_counts, |sum, candidate| sum + candidate.decoder.counts())
    }

    /// Decodes a datagram of an admitted sender and appends its measurements if the sender is
    /// chosen.
    ///
    /// If the sender has just been chosen in place of another one, returns the text received from
    /// it so far.
    pub(crate) fn push(
        &mut self,
        sender: SocketAddr,
        bytes: &[u8],
        now: Duration,
        format: &DatagramFormat<'_>,
        measurements: &mut Vec<Measurement>,
    ) -> Result<Option<Vec<u8>>, DriversError> {
        let first = measurements.len();
        let is_chosen = self.choice.chosen(now) == Some(sender);
        let candidate = self.candidate(sender, now, format.make_decoder)?;
        candidate.last_datagram = now;
        candidate.decoder.set_time(now);
        candidate.decoder.push(bytes, measurements);
        if format.is_text {
            candidate.decoder.push(LINE_END, measurements);
            let room = stream_preamble::MAX_BYTES.saturating_sub(candidate.text.len());
            candidate.text.extend(bytes.iter().chain(LINE_END).take(room));
        }
        if !measurements.iter().skip(first).any(|measurement| (format.is_required)(&measurement.value)) {
            if !is_chosen {
                measurements.truncate(first);
            }
            return Ok(None);
        }
        if !self.choice.confirm(sender, now) {
            return Ok(None);
        }
        let (chosen, others) = self.candidates.drain(..).partition(|candidate| candidate.sender == sender);
        self.candidates = chosen;
        self.removed_counts = counts_of(others, self.removed_counts);
        Ok(self.candidates.first().map(|candidate| candidate.text.clone()))
    }

    /// Returns the decoder of a sender. The decoder is created when the first datagram arrives.
    fn candidate(
        &mut self,
        sender: SocketAddr,
        now: Duration,
        make_decoder: &dyn Fn() -> Result<Box<dyn Decoder>, DriversError>,
    ) -> Result<&mut Candidate, DriversError> {
        let index = match self.candidates.iter().position(|candidate| candidate.sender == sender) {
            Some(index) => index,
            None => {
                let oldest = (0..self.candidates.len()).min_by_key(|index| self.candidates[*index].last_datagram);
                if let Some(oldest) = oldest.filter(|_| self.candidates.len() >= MAX_SENDERS) {
                    self.removed_counts = self.removed_counts + self.candidates.swap_remove(oldest).decoder.counts();
                }
                self.candidates.push(Candidate {
                    sender,
                    decoder: make_decoder()?,
                    text: Vec::new(),
                    last_datagram: now,
                });
                self.candidates.len() - 1
            }
        };
        Ok(&mut self.candidates[index])
    }
}

fn counts_of(candidates: Vec<Candidate>, sum: Counts) -> Counts {
    candidates.into_iter().fold(sum, |sum, candidate| sum + candidate.decoder.counts())
}

#[cfg(test)]
mod tests {
    use decoders::{
        Framed,
        lines::{LineSettings, Lines},
        rvc::Rvc,
    };

    use super::*;

    const READING: &[u8] = b"0.1,0,0,0.1,0,0,9.81";

    fn address(port: u16) -> SocketAddr {
        ([127, 0, 0, 1], port).into()
    }

    fn is_imu(value: &Value) -> bool {
        matches!(value, Value::Imu { .. })
    }

    fn lines() -> Result<Box<dyn Decoder>, DriversError> {
        let settings = LineSettings { starts_at_line_start: true, ..LineSettings::default() };
        Ok(Box::new(Framed::new(Lines::new(&settings)?)))
    }

    /// Returns the number of measurements of a text datagram, or `None` if it is not admitted.
    fn pushed(senders: &mut SenderDecoders, port: u16, bytes: &[u8], ms: u64) -> Option<usize> {
        let (sender, now) = (address(port), Duration::from_millis(ms));
        let mut found = Vec::new();
        let format = DatagramFormat { make_decoder: &lines, is_required: is_imu, is_text: true };
        senders.admits(sender, now).then(|| senders.push(sender, bytes, now, &format, &mut found).unwrap())?;
        Some(found.len())
    }

    #[test]
    fn sender_without_measurements_holds_no_place() {
        let mut senders = SenderDecoders::default();
        assert_eq!(pushed(&mut senders, 1, b"\0", 0), Some(0));
        assert_eq!(pushed(&mut senders, 2, READING, 5), Some(1), "the stranger came first");
        assert_eq!(pushed(&mut senders, 1, READING, 10), None);
        assert_eq!(pushed(&mut senders, 2, b"\0", 1_500), Some(0), "no measurement");
        assert_eq!(pushed(&mut senders, 1, READING, 2_005), Some(1), "2 s after the last measurement");
        assert_eq!(pushed(&mut senders, 2, READING, 2_010), None);
    }

    #[test]
    fn columns_of_one_sender_do_not_apply_to_another() {
        let mut senders = SenderDecoders::default();
        assert_eq!(pushed(&mut senders, 1, b"t_s,ax,ay,az,gx,gy,gz", 0), Some(0), "exchanged columns");
        assert_eq!(pushed(&mut senders, 2, READING, 5), Some(1));
        assert_eq!(senders.candidates.len(), 1);
        assert_eq!(senders.candidates[0].text, [READING, LINE_END].concat());
    }

    #[test]
    fn parts_of_frames_of_two_senders_are_not_joined() {
        let mut senders = SenderDecoders::default();
        let frame = {
            let mut frame = vec![0xaa, 0xaa, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xe8, 3, 0, 0, 0];
            let sum = frame[2..].iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
            [&frame.split_off(0)[..], &[0, sum]].concat()
        };
        let format = DatagramFormat {
            make_decoder: &|| Ok(Box::new(Framed::new(Rvc::default()))),
            is_required: is_imu,
            is_text: false,
        };
        let mut found = Vec::new();
        for (port, part) in [(1, &frame[..7]), (2, &frame[..]), (1, &frame[7..])] {
            senders.push(address(port), part, Duration::ZERO, &format, &mut found).unwrap();
        }
        assert_eq!((senders.counts().frames, senders.counts().rejected), (2, 0));
    }

    #[test]
    fn number_of_candidates_is_limited() {
        let mut senders = SenderDecoders::default();
        for port in 1..=100 {
            assert_eq!(pushed(&mut senders, port, b"x", port.into()), Some(0));
        }
        assert_eq!((senders.candidates.len(), senders.counts().rejected), (MAX_SENDERS, 100));
        assert_eq!(pushed(&mut senders, 7, READING, 200), Some(1));
        assert_eq!((senders.candidates.len(), senders.counts().rejected), (1, 100));
    }
}
