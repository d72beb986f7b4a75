//! Decides whether and when a service is restarted, independently of processes and clocks.

use std::time::Duration;

use launch::{OnLimit, Restart};

/// Response to the exit of a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RestartVerdict {
    /// Restart the service after this pause.
    Restart(Duration),
    /// Give up the service; the others continue.
    GiveUp,
    /// Stop the system.
    StopSystem,
}

/// Longest allowed time from the start of a process to its first health report, for any service.
pub(crate) const FIRST_HEALTH_TIMEOUT: Duration = Duration::from_secs(10);

/// Restart policy of one service, based on its past exits.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct RestartPolicy {
    pub(crate) restarts: u32,
    failures: u64,
    /// Number of consecutive exits without any health report.
    silent_exits: u32,
    /// Shortest time from start to first health report among all processes so far.
    min_start: Option<Duration>,
}

impl RestartPolicy {
    /// Handles the exit of a service's first process before that process was ready. The exit counts
    /// as if the restart limit had been reached.
    pub(crate) fn on_failed_first_start(&mut self, rule: &Restart) -> RestartVerdict {
        self.failures = rule.limit;
        self.on_exit(None, rule)
    }

    /// Records the time from the start of a process to its first health report.
    pub(crate) fn on_first_health(&mut self, start: Duration) {
        self.min_start = Some(self.min_start.map_or(start, |min_start| min_start.min(start)));
    }

    /// Returns the timeout for the first health report of the newest process.
    ///
    /// The first process has the full [`FIRST_HEALTH_TIMEOUT`], because nothing is published before
    /// every service is ready. A later process has only `min_timeout`, or twice the shortest start
    /// time if that is longer, because ticks are waiting for it. Its timeout doubles with each
    /// consecutive exit without a health report, in case the machine is slow.
    pub(crate) fn first_health_timeout(&self, min_timeout: Duration) -> Duration {
        if self.restarts == 0 {
            return FIRST_HEALTH_TIMEOUT;
        }
        let needed = 2 * self.min_start.unwrap_or_default();
        let limit = needed.max(min_timeout);
        limit.saturating_mul(1 << self.silent_exits.min(20)).min(FIRST_HEALTH_TIMEOUT)
    }

    /// Resets the failure counters after another stage has taken over the slot.
    pub(crate) fn reset(&mut self) {
        (self.failures, self.silent_exits) = (0, 0);
    }

    /// Returns `true` if the number of consecutive failures exceeds the limit of the rule.
    pub(crate) fn exceeds_limit(&self, rule: &Restart) -> bool {
        self.failures > rule.limit
    }

    /// Handles the exit of a process. `lifetime` is `None` if the process never reported its
    /// health.
    ///
    /// An exit without any health report is a failure regardless of the lifetime.
    pub(crate) fn on_exit(&mut self, lifetime: Option<Duration>, rule: &Restart) -> RestartVerdict {
        self.silent_exits = if lifetime.is_none() { self.silent_exits + 1 } else { 0 };
        let was_stable = lifetime.is_some_and(|lifetime| lifetime.as_secs_f64() >= rule.min_uptime_s);
        self.failures = if was_stable { 0 } else { self.failures + 1 };
        let max_pause = Duration::from_secs_f64(rule.backoff_max_s);
        if self.exceeds_limit(rule) {
            return match rule.on_limit {
                OnLimit::Stop => RestartVerdict::StopSystem,
                OnLimit::Degrade => RestartVerdict::GiveUp,
                OnLimit::Retry => RestartVerdict::Restart(max_pause),
            };
        }
        // After an occasional exit, the service restarts immediately. In a crash loop the pause
        // grows, so that the loop does not starve other services.
        let doublings = self.failures.saturating_sub(2).min(20) as i32;
        let pause_s = if self.failures < 2 { 0.0 } else { rule.backoff_s * 2f64.powi(doublings) };
        RestartVerdict::Restart(Duration::from_secs_f64(pause_s).min(max_pause))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: Restart = Restart {
        silence_s: 1.0,
        min_uptime_s: 1.0,
        backoff_s: 0.1,
        backoff_max_s: 0.5,
        limit: 6,
        on_limit: OnLimit::Stop,
    };

    fn pauses_ms(rule: Restart, lifetime_s: f64, exits: usize) -> Vec<Option<u128>> {
        let mut policy = RestartPolicy::default();
        let mut end = || match policy.on_exit(Some(Duration::from_secs_f64(lifetime_s)), &rule) {
            RestartVerdict::Restart(pause) => Some(pause.as_millis()),
            RestartVerdict::GiveUp | RestartVerdict::StopSystem => None,
        };
        (0..exits).map(|_| end()).collect()
    }

    #[test]
    fn crash_loop_backs_off_and_is_given_up() {
        let pauses = [Some(0), Some(100), Some(200), Some(400), Some(500), Some(500), None];
        assert_eq!(pauses_ms(RULE, 0.1, 7), pauses);
    }

    #[test]
    fn stable_service_restarts_immediately_every_time() {
        assert_eq!(pauses_ms(RULE, 1.5, 50), vec![Some(0); 50]);
    }

    #[test]
    fn failed_first_start_exhausts_the_limit() {
        assert_eq!(RestartPolicy::default().on_failed_first_start(&RULE), RestartVerdict::StopSystem);
        let hold = Restart { on_limit: OnLimit::Retry, ..RULE };
        assert_eq!(
            RestartPolicy::default().on_failed_first_start(&hold),
            RestartVerdict::Restart(Duration::from_millis(500))
        );
    }

    #[test]
    fn first_health_timeout_of_restarts_follows_its_minimum() {
        let ms = |policy: &RestartPolicy| policy.first_health_timeout(Duration::from_secs(1)).as_millis();
        let mut policy = RestartPolicy::default();
        policy.on_first_health(Duration::from_millis(300));
        assert_eq!(ms(&policy), 10_000, "the first process has the full timeout");
        policy.restarts = 1;
        assert_eq!(ms(&policy), 1000);
        policy.on_first_health(Duration::from_secs(3));
        assert_eq!(ms(&policy), 1000, "the shortest start counts");
        let limits: Vec<_> = (0..4).map(|_| (policy.on_exit(None, &RULE), ms(&policy)).1).collect();
        assert_eq!(limits, [2000, 4000, 8000, 10_000]);
        policy.on_exit(Some(Duration::from_millis(1)), &RULE);
        assert_eq!(ms(&policy), 1000, "a health report resets the timeout");
        let slow =
            RestartPolicy { restarts: 1, min_start: Some(Duration::from_millis(700)), ..RestartPolicy::default() };
        assert_eq!(ms(&slow), 1400, "twice the shortest start");
    }

    #[test]
    fn exit_without_health_is_a_failure_even_without_min_uptime() {
        let rule = Restart { min_uptime_s: 0.0, limit: 1, ..RULE };
        let mut policy = RestartPolicy::default();
        assert_eq!(policy.on_exit(None, &rule), RestartVerdict::Restart(Duration::ZERO));
        assert_eq!(policy.on_exit(None, &rule), RestartVerdict::StopSystem);
        assert_eq!(
            RestartPolicy::default().on_exit(Some(Duration::ZERO), &rule),
            RestartVerdict::Restart(Duration::ZERO)
        );
    }

    #[test]
    fn on_limit_selects_the_verdict() {
        let at_limit = |on_limit| {
            let mut policy = RestartPolicy { failures: 6, ..RestartPolicy::default() };
            policy.on_exit(Some(Duration::ZERO), &Restart { on_limit, ..RULE })
        };
        assert_eq!(at_limit(OnLimit::Stop), RestartVerdict::StopSystem);
        assert_eq!(at_limit(OnLimit::Degrade), RestartVerdict::GiveUp);
        assert_eq!(at_limit(OnLimit::Retry), RestartVerdict::Restart(Duration::from_millis(500)));
    }
}
