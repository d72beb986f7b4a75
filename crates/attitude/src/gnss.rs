//! Fixes of a satellite receiver.

use crate::{Vector3, scalars::scalars, state_words::StateWords};

/// Largest plausible component of a vehicle's velocity over ground, m/s.
pub const MAX_SPEED_M_S: f64 = 3000.0;

/// Velocity fix. A stage receives it at the tick of its arrival.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fix {
    /// Velocity over ground (east, north, up), m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Standard deviation of each velocity component, m/s, if reported.
    pub sd_m_s: Option<f64>,
    /// Age of the velocity when it arrives, s, if known.
    pub age_s: Option<f64>,
    /// Geodetic latitude, rad, north positive, if known.
    pub latitude_rad: Option<f64>,
}

/// Fix of a satellite receiver, with longitude and altitude.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ReceiverFix {
    /// Values of the fix that stages use.
    pub fix: Fix,
    /// Longitude, rad, east positive, if known.
    pub longitude_rad: Option<f64>,
    /// Altitude as reported by the receiver, m, if known.
    pub altitude_m: Option<f64>,
}

impl From<Fix> for ReceiverFix {
    fn from(fix: Fix) -> Self {
        Self { fix, longitude_rad: None, altitude_m: None }
    }
}

impl Fix {
    /// Removes optional values that are not finite. Returns `None` if the velocity is not finite.
    pub fn finite(self) -> Option<Self> {
        let number = |value: Option<f64>| value.filter(|value| value.is_finite());
        let (sd_m_s, age_s, latitude_rad) = (number(self.sd_m_s), number(self.age_s), number(self.latitude_rad));
        let known = self.velocity_m_s.iter().all(|component| component.is_finite());
        known.then_some(Self { sd_m_s, age_s, latitude_rad, ..self })
    }

    /// Returns the speed over ground, m/s.
    pub fn speed_m_s(&self) -> f64 {
        libm::hypot(self.velocity_m_s.x, self.velocity_m_s.y)
    }

    /// Returns the track over ground, rad, clockwise from true north, (−π, π].
    pub fn track_rad(&self) -> f64 {
        libm::atan2(self.velocity_m_s.x, self.velocity_m_s.y)
    }
}

scalars!(Fix: velocity_m_s, sd_m_s, age_s, latitude_rad);

impl StateWords for Fix {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let Self { velocity_m_s, sd_m_s, age_s, latitude_rad } = self;
        velocity_m_s.visit(visit);
        [sd_m_s, age_s, latitude_rad].into_iter().for_each(|number| number.visit(visit));
    }
}

impl StateWords for ReceiverFix {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let Self { fix, longitude_rad, altitude_m } = self;
        fix.visit(visit);
        [longitude_rad, altitude_m].into_iter().for_each(|number| number.visit(visit));
    }
}
