//! Whether all that was sent under a key has arrived.
//!
//! Input: envelopes in the order in which they come. Output: counts of what came and of what is missing, exact. Time: none.
//! Failure: none; what comes again, or too late, is counted and is not a new message.

use std::fmt;

use crate::v1::Envelope;

/// The messages of a key.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DeliveryTracker {
    /// Messages that came.
    pub messages: u64,
    /// The samples in them.
    pub samples: u64,
    /// Messages lost on the way.
    pub lost_messages: u64,
    /// The samples in them.
    pub lost_samples: u64,
    /// Messages that came again, or too late.
    pub repeated: u64,
    /// Lives of the gateway after the first.
    pub restarts: u64,
    /// Samples that were left out on board to keep to a rate.
    pub decimated: u64,
    /// Samples that were dropped on board because nobody took them in time.
    pub dropped: u64,
    /// The incarnation, the number and the samples before it that the next message is to have.
    next: Option<(u64, u64, u64)>,
}

impl DeliveryTracker {
    /// The heads of the columns that it is shown in; samples are decimated and dropped on board.
    pub const HEAD: &str = " messages  samples  lost messages  lost samples  decimated  dropped";

    /// Takes a message; whether it is a new one.
    pub fn take(&mut self, envelope: &Envelope, samples: u64) -> bool {
        let Envelope { sequence, start_ns, samples_before, decimated, dropped, .. } = *envelope;
        if let Some((known_start_ns, next, samples_next)) = self.next {
            if start_ns < known_start_ns || (start_ns == known_start_ns && sequence < next) {
                self.repeated += 1;
                return false;
            }
            if start_ns == known_start_ns {
                self.lost_messages = self.lost_messages.saturating_add(sequence - next);
                let lost = samples_before.saturating_sub(samples_next);
                self.lost_samples = self.lost_samples.saturating_add(lost);
            } else {
                self.restarts += 1;
            }
        }
        self.messages += 1;
        self.samples += samples;
        (self.decimated, self.dropped) = (decimated, dropped);
        self.next = Some((start_ns, sequence.saturating_add(1), samples_before.saturating_add(samples)));
        true
    }
}

impl fmt::Display for DeliveryTracker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { messages, samples, lost_messages, lost_samples, decimated, dropped, .. } = self;
        write!(f, "{messages:>9}{samples:>9}{lost_messages:>15}{lost_samples:>14}{decimated:>11}{dropped:>9}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(start_ns: u64, sequence: u64, samples_before: u64) -> Envelope {
        Envelope { start_ns, sequence, samples_before, ..Envelope::default() }
    }

    #[test]
    fn what_is_missing_is_counted_in_messages_and_samples() {
        let mut track = DeliveryTracker::default();
        // It joins a stream under way, misses two messages of five samples each, and hears one again.
        for (sequence, before) in [(7, 35), (8, 40), (11, 55), (11, 55), (12, 60)] {
            track.take(&message(1, sequence, before), 5);
        }
        assert_eq!((track.messages, track.samples), (4, 20));
        assert_eq!((track.lost_messages, track.lost_samples, track.repeated), (2, 10, 1));
    }

    #[test]
    fn a_gateway_that_was_restarted_counts_anew() {
        let mut track = DeliveryTracker::default();
        [message(1, 100, 100), message(2, 0, 0), message(1, 101, 101), message(2, 1, 1)].iter().for_each(|envelope| {
            track.take(envelope, 1);
        });
        assert_eq!((track.messages, track.lost_messages, track.restarts, track.repeated), (3, 0, 1, 1));
    }
}
