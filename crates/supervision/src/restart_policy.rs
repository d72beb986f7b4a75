//! When a service that ended is started again: the rule, without processes and without a clock.

use std::time::Duration;

use launch::{OnLimit, Restart};

/// What is to be done about a service that ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// It is started again after this pause.
    Again(Duration),
    /// It stays away and the others go on.
    Away,
    /// The system ends.
    Stop,
}

/// A process that has said nothing so long after its start has failed in any case.
pub(crate) const FIRST_HEALTH_LIMIT: Duration = Duration::from_secs(10);

/// How the processes of one service have fared, and what follows from it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct RestartPolicy {
    /// Times it was started again.
    pub(crate) restarts: u32,
    failures: u64,
    /// Processes in a row that never said anything.
    mute: u32,
    /// From the start to the first health, the least that any process took.
    quickest_start: Option<Duration>,
}

impl RestartPolicy {
    /// The first process has never begun to work: it is as if the limit were reached.
    pub(crate) fn never_began(&mut self, rule: &Restart) -> Verdict {
        self.failures = rule.limit;
        self.on_exit(None, rule)
    }

    /// A process has said its first health so long after its start.
    pub(crate) fn on_first_health(&mut self, start: Duration) {
        self.quickest_start = Some(self.quickest_start.map_or(start, |quickest| quickest.min(start)));
    }

    /// How long the process that began last may take to its first health. Nothing is published before every service has said it once, so
    /// the first process may take its time. Ticks wait for a later one: it has no longer than one that falls silent, or twice what its
    /// service needs; twice as long again after each that did not manage it, for the machine may be slow.
    pub(crate) fn first_health_limit(&self, rule: &Restart) -> Duration {
        if self.restarts == 0 {
            return FIRST_HEALTH_LIMIT;
        }
        let needed = 2 * self.quickest_start.unwrap_or_default();
        let limit = needed.max(Duration::from_secs_f64(rule.silence_s));
        limit.saturating_mul(1 << self.mute.min(20)).min(FIRST_HEALTH_LIMIT)
    }

    /// Another stage fills the slot: what the one before did does not count.
    pub(crate) fn reset(&mut self) {
        (self.failures, self.mute) = (0, 0);
    }

    /// It has failed more often in a row than the rule bears.
    pub(crate) fn has_failed(&self, rule: &Restart) -> bool {
        self.failures > rule.limit
    }

    /// A process that lived so long has ended; one that never said anything, `None`, has failed however long it took.
    pub(crate) fn on_exit(&mut self, lived: Option<Duration>, rule: &Restart) -> Verdict {
        self.mute = if lived.is_none() { self.mute + 1 } else { 0 };
        let settled = lived.is_some_and(|lived| lived.as_secs_f64() >= rule.settled_s);
        self.failures = if settled { 0 } else { self.failures + 1 };
        let longest = Duration::from_secs_f64(rule.backoff_max_s);
        if self.has_failed(rule) {
            return match rule.on_limit {
                OnLimit::Stop => Verdict::Stop,
                OnLimit::Degrade => Verdict::Away,
                OnLimit::Hold => Verdict::Again(longest),
            };
        }
        // Whoever is killed once or twice is back at once; whoever cannot live does not take the machine from the others.
        let doublings = self.failures.saturating_sub(2).min(20) as i32;
        let pause_s = if self.failures < 2 { 0.0 } else { rule.backoff_s * 2f64.powi(doublings) };
        Verdict::Again(Duration::from_secs_f64(pause_s).min(longest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: Restart = Restart {
        silence_s: 1.0,
        settled_s: 1.0,
        backoff_s: 0.1,
        backoff_max_s: 0.5,
        limit: 6,
        on_limit: OnLimit::Stop,
    };

    fn pauses_ms(rule: Restart, lived_s: f64, deaths: usize) -> Vec<Option<u128>> {
        let mut policy = RestartPolicy::default();
        let mut end = || match policy.on_exit(Some(Duration::from_secs_f64(lived_s)), &rule) {
            Verdict::Again(pause) => Some(pause.as_millis()),
            Verdict::Away | Verdict::Stop => None,
        };
        (0..deaths).map(|_| end()).collect()
    }

    #[test]
    fn a_crash_loop_is_slowed_down_and_given_up() {
        let pauses = [Some(0), Some(100), Some(200), Some(400), Some(500), Some(500), None];
        assert_eq!(pauses_ms(RULE, 0.1, 7), pauses);
    }

    #[test]
    fn a_service_that_lived_long_is_back_at_once_however_often_it_dies() {
        assert_eq!(pauses_ms(RULE, 1.5, 50), vec![Some(0); 50]);
    }

    #[test]
    fn one_that_never_began_is_given_up_at_once() {
        assert_eq!(RestartPolicy::default().never_began(&RULE), Verdict::Stop);
        let hold = Restart { on_limit: OnLimit::Hold, ..RULE };
        assert_eq!(RestartPolicy::default().never_began(&hold), Verdict::Again(Duration::from_millis(500)));
    }

    #[test]
    fn a_later_life_has_as_long_to_its_first_word_as_one_that_falls_silent() {
        let ms = |policy: &RestartPolicy| policy.first_health_limit(&RULE).as_millis();
        let mut policy = RestartPolicy::default();
        policy.on_first_health(Duration::from_millis(300));
        assert_eq!(ms(&policy), 10_000, "a first incarnation may take its time");
        policy.restarts = 1;
        assert_eq!(ms(&policy), 1000);
        policy.on_first_health(Duration::from_secs(3));
        assert_eq!(ms(&policy), 1000, "it has been quicker");
        let limits: Vec<_> = (0..4).map(|_| (policy.on_exit(None, &RULE), ms(&policy)).1).collect();
        assert_eq!(limits, [2000, 4000, 8000, 10_000]);
        policy.on_exit(Some(Duration::from_millis(1)), &RULE);
        assert_eq!(ms(&policy), 1000, "one has spoken");
        let slow =
            RestartPolicy { restarts: 1, quickest_start: Some(Duration::from_millis(700)), ..RestartPolicy::default() };
        assert_eq!(ms(&slow), 1400, "it needs its time");
    }

    #[test]
    fn one_that_never_spoke_has_failed_however_little_a_life_must_last() {
        let rule = Restart { settled_s: 0.0, limit: 1, ..RULE };
        let mut policy = RestartPolicy::default();
        assert_eq!(policy.on_exit(None, &rule), Verdict::Again(Duration::ZERO));
        assert_eq!(policy.on_exit(None, &rule), Verdict::Stop);
        assert_eq!(RestartPolicy::default().on_exit(Some(Duration::ZERO), &rule), Verdict::Again(Duration::ZERO));
    }

    #[test]
    fn what_happens_at_the_limit_is_a_choice() {
        let at_limit = |on_limit| {
            let mut policy = RestartPolicy { failures: 6, ..RestartPolicy::default() };
            policy.on_exit(Some(Duration::ZERO), &Restart { on_limit, ..RULE })
        };
        assert_eq!(at_limit(OnLimit::Stop), Verdict::Stop);
        assert_eq!(at_limit(OnLimit::Degrade), Verdict::Away);
        assert_eq!(at_limit(OnLimit::Hold), Verdict::Again(Duration::from_millis(500)));
    }
}
