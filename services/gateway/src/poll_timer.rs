//! Schedule for polling the bus.
//!
//! If the tick rate does not exceed the message rate, the gateway waits for each tick and sends it
//! immediately. This needs no additional system call by the publisher, because the call that wakes
//! the next service on the data path also wakes the gateway.
//!
//! If ticks are faster, or in lockstep, the bus is polled at the message rate, so that publishers
//! on the bus need no system call to wake the gateway.
//!
//! The gateway always waits for ticks from another host.

use std::{
    thread,
    time::{Duration, Instant},
};

use launch::Gateway;
use runtime::ServiceConfig;

/// Longest interval between two polls.
const MAX_POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Timer that paces the main loop.
pub(crate) struct PollTimer {
    is_event_driven: bool,
    interval: Duration,
    polled: Instant,
}

impl PollTimer {
    pub(crate) fn new(config: &ServiceConfig) -> Self {
        let Gateway { messages_hz, import, .. } = &config.launch.gateway;
        let is_event_driven = import.is_some() || (!config.is_lockstep() && config.rate_hz <= *messages_hz);
        // Awaited ticks arrive unevenly, and in bursts after a stall. The minimum interval between
        // two polls is therefore only half a message interval.
        let interval_s = if is_event_driven { 0.5 } else { 1.0 } / messages_hz;
        Self {
            is_event_driven,
            interval: Duration::from_secs_f64(interval_s).min(MAX_POLL_INTERVAL),
            polled: Instant::now(),
        }
    }

    /// Waits until the next poll is due.
    ///
    /// If the timer waits for each tick, `wait` is called first. It must wait for data, but no
    /// longer than the given time.
    pub(crate) fn wait(&mut self, wait: impl FnOnce(Duration)) {
        if self.is_event_driven {
            wait(MAX_POLL_INTERVAL);
        }
        thread::sleep(self.interval.saturating_sub(self.polled.elapsed()));
        self.polled = Instant::now();
    }
}

#[cfg(test)]
mod tests {
    use launch::{Import, Launch};
    use runtime::service_config;

    use super::*;

    fn is_event_driven(rate_hz: f64, pace: service_config::Pace, gateway: Gateway) -> bool {
        let launch = Launch { gateway, ..Launch::default() };
        let config = ServiceConfig::standalone(launch, rate_hz, pace);
        PollTimer::new(&config).is_event_driven
    }

    #[test]
    fn gateway_polls_paths_faster_than_message_rate() {
        let live = service_config::Pace::Speed(1.0);
        let gateway = |messages_hz| Gateway { messages_hz, ..Gateway::default() };
        assert!(is_event_driven(100.0, live, gateway(200.0)) && is_event_driven(1000.0, live, gateway(2000.0)));
        assert!(
            !is_event_driven(1000.0, live, gateway(200.0))
                && !is_event_driven(100.0, service_config::Pace::Max, gateway(200.0))
        );
        assert!(is_event_driven(1000.0, live, Gateway { import: Some(Import::default()), ..gateway(200.0) }));
    }
}
