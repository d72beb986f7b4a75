//! Progress of the system from start to shutdown.

use std::time::Duration;

/// Progress of the system from start to shutdown.
#[derive(Debug)]
pub(crate) struct Flow {
    pub(crate) phase: Phase,
    pub(crate) stop_requested: bool,
    /// Time when every service was ready for the first time.
    pub(crate) first_ready: Option<Duration>,
    pub(crate) granted_ticks: u64,
    pub(crate) next_tick: u64,
    /// Time of the newest output tick.
    pub(crate) last_progress: Duration,
    /// Most recent time at which a service was starting.
    pub(crate) last_starting: Duration,
    /// Time of the most recent extra window of credit. Extra windows are granted while ticks are
    /// missing from the output.
    pub(crate) last_extra_window: Duration,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    /// A service has not opened its topics yet and could miss messages published now.
    Starting,
    Running,
    /// The source publishes no new ticks.
    Stopping,
    Ended,
}

impl Flow {
    pub(crate) fn new(now: Duration) -> Self {
        let (phase, stop_requested, first_ready) = (Phase::Starting, false, None);
        let (granted_ticks, next_tick) = (0, 0);
        Self {
            phase,
            stop_requested,
            first_ready,
            granted_ticks,
            next_tick,
            last_progress: now,
            last_starting: now,
            last_extra_window: now,
        }
    }

    pub(crate) fn request_stop(&mut self) {
        self.stop_requested = true;
    }

    /// Returns `true` from the first credit until the end, except while the bus is being renewed.
    pub(crate) fn is_running(&self) -> bool {
        matches!(self.phase, Phase::Running | Phase::Stopping)
    }

    pub(crate) fn has_ended(&self) -> bool {
        self.phase == Phase::Ended
    }

    /// Returns to the starting phase, because every service starts again on the new bus.
    pub(crate) fn restart(&mut self) {
        self.phase = Phase::Starting;
    }

    /// Extends the deadlines for output by the duration of a stall.
    pub(crate) fn extend_deadlines(&mut self, stall: Duration) {
        self.last_progress += stall;
    }
}
