//! Rate limit per topic: a client receives at most 60 messages of a topic per second.

use std::collections::VecDeque;

use graph::Topic;

/// Maximum number of messages of a topic per second.
const MAX_MESSAGES: usize = 60;
const SECOND_NS: u64 = 1_000_000_000;

/// Limit on the number of messages in a sliding time window.
#[derive(Debug)]
pub(crate) struct RateLimit {
    window_ns: u64,
    max_count: usize,
    /// Times of the most recently admitted messages.
    admitted_ns: VecDeque<u64>,
}

impl RateLimit {
    /// Returns the limit of a topic, or `None` if the topic is not limited.
    pub(crate) fn for_topic(topic: Topic) -> Option<Self> {
        if topic == Topic::Event {
            return None;
        }
        // For a topic with several publishers, a minimum interval between messages could
        // permanently exclude one of them. Instead, the number of messages per second is limited.
        let (window_ns, max_count) = if topic.entry().publisher.is_many() {
            (SECOND_NS, MAX_MESSAGES)
        } else {
            (SECOND_NS.div_ceil(MAX_MESSAGES as u64), 1)
        };
        Some(Self { window_ns, max_count, admitted_ns: VecDeque::new() })
    }

    /// Returns `true` if a message at `t_ns` is within the limit, and counts it.
    pub(crate) fn admit(&mut self, t_ns: u64) -> bool {
        if self.admitted_ns.len() == self.max_count {
            match self.admitted_ns.front() {
                Some(oldest_ns) if t_ns.saturating_sub(*oldest_ns) < self.window_ns => return false,
                _ => self.admitted_ns.pop_front(),
            };
        }
        self.admitted_ns.push_back(t_ns);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn admitted(topic: Topic, times_ns: impl Iterator<Item = u64>) -> Vec<u64> {
        let mut limit = RateLimit::for_topic(topic);
        times_ns.filter(|t_ns| limit.as_mut().is_none_or(|limit| limit.admit(*t_ns))).collect()
    }

    #[test]
    fn fast_topic_is_limited_to_60_evenly_spaced_messages() {
        let fast = admitted(Topic::Attitude, (0..10_000).map(|tick| 5 * SECOND_NS + tick * 1_000_000));
        assert!((580..=600).contains(&fast.len()), "{}", fast.len());
        assert!(fast.windows(2).all(|pair| pair[1] - pair[0] == 17_000_000), "every 17th message of 1 kHz");
        let slow = admitted(Topic::Imu, (0..100).map(|tick| tick * 20_000_000));
        assert_eq!(slow.len(), 100, "a slow topic is not reduced");
    }

    #[test]
    fn limit_of_shared_topic_serves_all_publishers() {
        // Eight services each publish ten times a second, always in the same order.
        let published = (0..800_u64).map(|n| SECOND_NS + n / 8 * 100_000_000 + n % 8);
        let sent = admitted(Topic::Health, published);
        assert_eq!(sent.len(), 600);
        assert!(sent.windows(61).all(|window| window[60] - window[0] >= SECOND_NS), "60 in any second");
        for service in 0..8 {
            let count = sent.iter().filter(|t_ns| *t_ns % 100_000_000 == service).count();
            assert!(count >= 70, "service {service}: {count} of 100");
        }
    }

    #[test]
    fn events_are_not_limited() {
        assert_eq!(admitted(Topic::Event, std::iter::repeat_n(7, 1000)).len(), 1000);
    }
}
