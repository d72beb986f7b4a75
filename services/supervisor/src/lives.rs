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

/// The lives of a service.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Lives {
    /// Times it was started again.
    pub(crate) restarts: u32,
    failures: u64,
}

impl Lives {
    /// The first life has never begun to work: it is as if the limit were reached.
    pub(crate) fn never_began(&mut self, rule: &Restart) -> Verdict {
        self.failures = rule.limit;
        self.ended(Duration::ZERO, rule)
    }

    /// A life of this length has ended.
    pub(crate) fn ended(&mut self, lived: Duration, rule: &Restart) -> Verdict {
        self.failures = if lived.as_secs_f64() < rule.settled_s { self.failures + 1 } else { 0 };
        let longest = Duration::from_secs_f64(rule.backoff_max_s);
        if self.failures > rule.limit {
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
        let mut lives = Lives::default();
        let mut end = || match lives.ended(Duration::from_secs_f64(lived_s), &rule) {
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
        assert_eq!(Lives::default().never_began(&RULE), Verdict::Stop);
        let hold = Restart { on_limit: OnLimit::Hold, ..RULE };
        assert_eq!(Lives::default().never_began(&hold), Verdict::Again(Duration::from_millis(500)));
    }

    #[test]
    fn what_happens_at_the_limit_is_a_choice() {
        let at_limit = |on_limit| {
            let mut lives = Lives { failures: 6, restarts: 0 };
            lives.ended(Duration::ZERO, &Restart { on_limit, ..RULE })
        };
        assert_eq!(at_limit(OnLimit::Stop), Verdict::Stop);
        assert_eq!(at_limit(OnLimit::Degrade), Verdict::Away);
        assert_eq!(at_limit(OnLimit::Hold), Verdict::Again(Duration::from_millis(500)));
    }
}
