//! Speed over ground of the last fix, and its derivative.

use crate::{gnss::Fix, scalars::scalars};

/// Ground speed.
///
/// The speed holds until the next fix. Its derivative holds for one fix interval only, so that each
/// speed increment is used once.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct GroundSpeed {
    /// Speed over ground V, m/s.
    speed_m_s: f64,
    /// Derivative V' of the speed, m/s².
    speed_rate_m_s2: f64,
    /// Time for which the derivative still holds, s.
    rate_remaining_s: f64,
    since_fix_s: f64,
    has_fix: bool,
}

impl GroundSpeed {
    /// Returns `true` if the last fix is at most `gap_s` old.
    pub(super) fn is_recent(&self, gap_s: f64) -> bool {
        self.has_fix && self.since_fix_s <= gap_s
    }

    /// Returns the speed V, m/s.
    pub(super) fn speed_m_s(&self) -> f64 {
        self.speed_m_s
    }

    /// Returns the derivative V' of the speed (m/s²), or zero if the derivative is no longer valid.
    pub(super) fn rate_m_s2(&self) -> f64 {
        if self.rate_remaining_s > 0.0 { self.speed_rate_m_s2 } else { 0.0 }
    }

    /// Advances the time since the last fix. Called at the start of a tick, before the tick's fix
    /// is recorded.
    pub(super) fn advance(&mut self, dt_s: f64) {
        self.since_fix_s += dt_s;
    }

    pub(super) fn record_fix(&mut self, fix: &Fix, gap_s: f64) {
        let speed_m_s = fix.speed_m_s();
        if self.is_recent(gap_s) && self.since_fix_s > 1e-3 {
            self.speed_rate_m_s2 = (speed_m_s - self.speed_m_s) / self.since_fix_s;
            self.rate_remaining_s = self.since_fix_s;
        }
        self.speed_m_s = speed_m_s;
        self.since_fix_s = 0.0;
        self.has_fix = true;
    }

    /// Ends the tick: subtracts its interval from the time for which the derivative still holds.
    pub(super) fn end_tick(&mut self, dt_s: f64) {
        self.rate_remaining_s = (self.rate_remaining_s - dt_s).max(0.0);
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let Self { speed_m_s, rate_remaining_s, since_fix_s, .. } = self;
        let negative = [speed_m_s, rate_remaining_s, since_fix_s].iter().any(|x| **x < 0.0);
        negative.then_some("a negative time or speed")
    }
}

scalars!(GroundSpeed: speed_m_s, speed_rate_m_s2, rate_remaining_s, since_fix_s, has_fix);
