//! Which messages of a topic are told: sixty a second at most.

use std::collections::VecDeque;

use graph::Topic;

/// Messages of a topic in a second at most.
const MAX_MESSAGES: usize = 60;
const SECOND_NS: u64 = 1_000_000_000;

/// So many messages in any span of time.
#[derive(Debug)]
pub(crate) struct Pace {
    span_ns: u64,
    count_max: usize,
    /// The times of the last messages that were told.
    told_ns: VecDeque<u64>,
}

impl Pace {
    /// The pace of a topic; `None` where everything is told.
    pub(crate) fn of(topic: Topic) -> Option<Self> {
        let (span_ns, count_max) = match topic {
            Topic::Event => return None,
            // Several say it in turn, and none of them is to be left out again and again.
            Topic::Health | Topic::Difference => (SECOND_NS, MAX_MESSAGES),
            _ => (SECOND_NS.div_ceil(MAX_MESSAGES as u64), 1),
        };
        Some(Self { span_ns, count_max, told_ns: VecDeque::new() })
    }

    /// Whether a message of this time is told.
    pub(crate) fn admits(&mut self, t_ns: u64) -> bool {
        if self.told_ns.len() == self.count_max {
            match self.told_ns.front() {
                Some(oldest_ns) if t_ns.saturating_sub(*oldest_ns) < self.span_ns => return false,
                _ => self.told_ns.pop_front(),
            };
        }
        self.told_ns.push_back(t_ns);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn admitted(topic: Topic, times_ns: impl Iterator<Item = u64>) -> Vec<u64> {
        let mut pace = Pace::of(topic);
        times_ns.filter(|t_ns| pace.as_mut().is_none_or(|pace| pace.admits(*t_ns))).collect()
    }

    #[test]
    fn of_a_fast_topic_sixty_a_second_are_told_evenly() {
        let told = admitted(Topic::Attitude, (0..10_000).map(|tick| 5 * SECOND_NS + tick * 1_000_000));
        assert!((580..=600).contains(&told.len()), "{}", told.len());
        assert!(told.windows(2).all(|pair| pair[1] - pair[0] == 17_000_000), "every seventeenth of 1 kHz");
        let slow = admitted(Topic::Imu, (0..100).map(|tick| tick * 20_000_000));
        assert_eq!(slow.len(), 100, "of a slow one all");
    }

    #[test]
    fn whoever_says_it_in_turn_is_heard_and_sixty_a_second_are_told() {
        // Eight services, ten times a second each, in the same order.
        let said = (0..800_u64).map(|n| SECOND_NS + n / 8 * 100_000_000 + n % 8);
        let told = admitted(Topic::Health, said);
        assert_eq!(told.len(), 600);
        assert!(told.windows(61).all(|span| span[60] - span[0] >= SECOND_NS), "in any second");
        for service in 0..8 {
            let heard = told.iter().filter(|t_ns| *t_ns % 100_000_000 == service).count();
            assert!(heard >= 70, "{service}: {heard} of 100");
        }
    }

    #[test]
    fn events_are_all_told() {
        assert_eq!(admitted(Topic::Event, std::iter::repeat_n(7, 1000)).len(), 1000);
    }
}
