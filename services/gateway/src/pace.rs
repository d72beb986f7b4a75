//! When to look at the bus again.
//!
//! A path that is no faster than messages may go is waited for, so that each tick goes out when it is there: the call of the kernel that
//! wakes the next reader of the topic wakes the gateway too. A faster path is looked at as often as messages may go, and never has to
//! wake anybody for it. What comes from another host is waited for in any case.

use std::{
    thread,
    time::{Duration, Instant},
};

use launch::Gateway;
use runtime::ServiceConfig;

/// Longest time between two looks.
const LOOK_LIMIT: Duration = Duration::from_millis(50);

/// The time between looks.
pub(crate) struct Pace {
    waits: bool,
    interval: Duration,
    looked: Instant,
}

impl Pace {
    pub(crate) fn of(config: &ServiceConfig) -> Self {
        let Gateway { messages_hz, import, .. } = &config.launch.gateway;
        let waits = import.is_some() || (!config.lockstep() && config.rate_hz <= *messages_hz);
        // Ticks that are waited for come unevenly, or many at once after a stall: half an interval is for those.
        let interval_s = if waits { 0.5 } else { 1.0 } / messages_hz;
        Self { waits, interval: Duration::from_secs_f64(interval_s).min(LOOK_LIMIT), looked: Instant::now() }
    }

    /// Rests until the next look is due: `wait` sleeps until there is something, no longer than it is told.
    pub(crate) fn rest(&mut self, wait: impl FnOnce(Duration)) {
        if self.waits {
            wait(LOOK_LIMIT);
        }
        thread::sleep(self.interval.saturating_sub(self.looked.elapsed()));
        self.looked = Instant::now();
    }
}

#[cfg(test)]
mod tests {
    use launch::{Import, Launch};
    use runtime::{Role, service_config};

    use super::*;

    fn waits(rate_hz: f64, pace: service_config::Pace, gateway: Gateway) -> bool {
        let launch = Launch { gateway, ..Launch::default() };
        let (role, resume, ticks_max, prior) = (Role::Owner { from_tick: 0 }, None, None, None);
        let (incarnation, epoch, supervisor_pid, readings) = (1, 1, 0, false);
        let config = ServiceConfig {
            launch,
            rate_hz,
            pace,
            ticks_max,
            incarnation,
            epoch,
            role,
            prior,
            resume,
            supervisor_pid,
            readings,
        };
        Pace::of(&config).waits
    }

    #[test]
    fn a_path_that_is_faster_than_messages_may_go_never_has_to_wake_the_gateway() {
        let live = service_config::Pace::Speed(1.0);
        let gateway = |messages_hz| Gateway { messages_hz, ..Gateway::default() };
        assert!(waits(100.0, live, gateway(200.0)) && waits(1000.0, live, gateway(2000.0)));
        assert!(!waits(1000.0, live, gateway(200.0)) && !waits(100.0, service_config::Pace::Max, gateway(200.0)));
        assert!(waits(1000.0, live, Gateway { import: Some(Import::default()), ..gateway(200.0) }));
    }
}
