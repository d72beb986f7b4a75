//! State of the satellite receiver: its last velocity, and the time since then.

use crate::scalars::scalars;

/// Upper limit of the time since the last fix, s. Longer times make no difference.
const MAX_ELAPSED_S: f64 = 1e4;

/// State of the satellite receiver.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Aiding {
    /// `true` once a velocity has been received.
    pub(super) has_velocity: bool,
    /// Time since the last velocity, s.
    pub(super) since_fix_s: f64,
    /// Time since the last assumed velocity or fix, s.
    pub(super) since_assumed_s: f64,
    /// Last speed over ground, m/s.
    pub(super) speed_m_s: f64,
    /// Track minus course at the last fix, rad.
    pub(super) crab_rad: f64,
    /// Time for which the speed has been high enough to derive the course from the track, s.
    pub(super) track_duration_s: f64,
    pub(super) latitude_rad: f64,
    pub(super) has_latitude: bool,
}

impl Default for Aiding {
    fn default() -> Self {
        Self {
            has_velocity: false,
            since_fix_s: MAX_ELAPSED_S,
            since_assumed_s: 0.0,
            speed_m_s: 0.0,
            crab_rad: 0.0,
            track_duration_s: 0.0,
            latitude_rad: 0.0,
            has_latitude: false,
        }
    }
}

impl Aiding {
    pub(super) fn advance_time(&mut self, dt_s: f64) {
        self.since_fix_s = (self.since_fix_s + dt_s).min(MAX_ELAPSED_S);
        self.since_assumed_s = (self.since_assumed_s + dt_s).min(1.0);
    }

    pub(super) fn latitude_rad(&self) -> Option<f64> {
        self.has_latitude.then_some(self.latitude_rad)
    }
}

scalars!(Aiding:
    has_velocity, has_latitude, since_fix_s, since_assumed_s, speed_m_s, crab_rad, track_duration_s, latitude_rad
);
