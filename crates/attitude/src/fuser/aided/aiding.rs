//! The state of the aiding by the satellite receiver.

use crate::numbers::Numbers;

/// Time beyond which the last fix is of no matter, s.
const LONG_S: f64 = 1e4;

/// What is known of the receiver.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Aiding {
    /// A velocity was told at least once.
    pub(super) seen: bool,
    /// Since the last one, s.
    pub(super) since_fix_s: f64,
    /// Since the last assumed velocity or fix, s.
    pub(super) since_assumed_s: f64,
    /// Its speed over ground, m/s.
    pub(super) speed_m_s: f64,
    /// Its track less the course then, rad.
    pub(super) crab_rad: f64,
    /// How long the track has been told fast enough to make a course, s.
    pub(super) tracked_s: f64,
    pub(super) latitude_rad: f64,
    pub(super) latitude_told: bool,
}

impl Default for Aiding {
    fn default() -> Self {
        Self {
            seen: false,
            since_fix_s: LONG_S,
            since_assumed_s: 0.0,
            speed_m_s: 0.0,
            crab_rad: 0.0,
            tracked_s: 0.0,
            latitude_rad: 0.0,
            latitude_told: false,
        }
    }
}

impl Aiding {
    pub(super) fn advance(&mut self, dt_s: f64) {
        self.since_fix_s = (self.since_fix_s + dt_s).min(LONG_S);
        self.since_assumed_s = (self.since_assumed_s + dt_s).min(1.0);
    }

    pub(super) fn latitude_rad(&self) -> Option<f64> {
        self.latitude_told.then_some(self.latitude_rad)
    }
}

impl Numbers for Aiding {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.seen.visit(visit);
        self.latitude_told.visit(visit);
        [
            &mut self.since_fix_s,
            &mut self.since_assumed_s,
            &mut self.speed_m_s,
            &mut self.crab_rad,
            &mut self.tracked_s,
            &mut self.latitude_rad,
        ]
        .into_iter()
        .for_each(|number| number.visit(visit));
    }
}
