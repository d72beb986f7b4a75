//! Which messages of a topic are told: sixty a second at most.

use graph::Topic;

/// Messages of a topic in a second at most.
pub(crate) const MESSAGES_HZ: u64 = 60;
const SECOND_NS: u64 = 1_000_000_000;

/// So many messages in each span of time.
#[derive(Debug)]
pub(crate) struct Pace {
    span_ns: u64,
    count_max: u64,
    began_ns: u64,
    count: u64,
}

impl Pace {
    /// The pace of a topic; `None` where everything is told.
    pub(crate) fn of(topic: Topic) -> Option<Self> {
        let (span_ns, count_max) = match topic {
            Topic::Event => return None,
            // Several say it in turn, and none of them is to be left out again and again.
            Topic::Health | Topic::Difference => (SECOND_NS, MESSAGES_HZ),
            _ => (SECOND_NS.div_ceil(MESSAGES_HZ), 1),
        };
        Some(Self { span_ns, count_max, began_ns: 0, count: 0 })
    }

    /// Whether a message of this time is told.
    pub(crate) fn admits(&mut self, t_ns: u64) -> bool {
        // A time before the span's is that of a source that has begun anew.
        if t_ns < self.began_ns || t_ns - self.began_ns >= self.span_ns {
            (self.began_ns, self.count) = (t_ns, 0);
        }
        self.count += 1;
        self.count <= self.count_max
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
        for service in 0..8 {
            let heard = told.iter().filter(|t_ns| *t_ns % 100_000_000 == service).count();
            assert!(heard >= 70, "{service}: {heard} of 100");
        }
    }

    #[test]
    fn events_are_all_told_and_a_time_before_the_last_one_is_a_beginning() {
        assert_eq!(admitted(Topic::Event, std::iter::repeat_n(7, 1000)).len(), 1000);
        assert_eq!(admitted(Topic::Imu, [9 * SECOND_NS, SECOND_NS, SECOND_NS + 1].into_iter()).len(), 2);
    }
}
