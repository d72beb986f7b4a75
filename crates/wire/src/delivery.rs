//! Loss accounting for the messages received under a Zenoh key.
//!
//! Input: envelopes in order of arrival.
//!
//! Output: exact counts of received and missing messages and samples.
//!
//! Failure: repeated and late messages are counted and otherwise ignored.

use std::fmt;

use crate::v1::Envelope;

/// Counts of the messages received under a Zenoh key. When the gateway restarts, `decimated` and
/// `dropped` restart from 0. All other counts continue.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DeliveryTracker {
    /// Number of messages received.
    pub messages: u64,
    /// Number of samples in the messages received.
    pub samples: u64,
    /// Number of messages lost in transit.
    pub lost_messages: u64,
    /// Number of samples in the lost messages.
    pub lost_samples: u64,
    /// Number of messages received again or too late.
    pub repeated: u64,
    /// Number of restarts of the gateway.
    pub restarts: u64,
    /// Number of samples omitted on board since the last start of the gateway, to limit the rate.
    pub decimated: u64,
    /// Number of samples dropped on board since the last start of the gateway, because the bus or
    /// the gateway's queue overflowed.
    pub dropped: u64,
    /// Expected contents of the next envelope: start time of the gateway, sequence number, and
    /// number of preceding samples.
    next: Option<(u64, u64, u64)>,
}

impl DeliveryTracker {
    /// Column headings of the `Display` output.
    pub const HEADER: &str = " messages  samples  lost messages  lost samples  decimated  dropped";

    /// Records a message. Returns `false` if it is repeated or late.
    pub fn record(&mut self, envelope: &Envelope, samples: u64) -> bool {
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
    fn tracker_counts_lost_messages_and_samples() {
        let mut tracker = DeliveryTracker::default();
        // The tracker joins mid-stream, misses two messages of five samples and receives one twice.
        for (sequence, before) in [(7, 35), (8, 40), (11, 55), (11, 55), (12, 60)] {
            tracker.record(&message(1, sequence, before), 5);
        }
        assert_eq!((tracker.messages, tracker.samples), (4, 20));
        assert_eq!((tracker.lost_messages, tracker.lost_samples, tracker.repeated), (2, 10, 1));
    }

    #[test]
    fn gateway_restart_is_not_counted_as_loss() {
        let mut tracker = DeliveryTracker::default();
        [message(1, 100, 100), message(2, 0, 0), message(1, 101, 101), message(2, 1, 1)].iter().for_each(|envelope| {
            tracker.record(envelope, 1);
        });
        assert_eq!((tracker.messages, tracker.lost_messages, tracker.restarts, tracker.repeated), (3, 0, 1, 1));
    }
}
